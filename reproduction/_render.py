"""Tables and findings as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from reproduction._findings import Finding
from reproduction._tables import Cell, Table

__all__ = ["Page", "Section", "markdown"]


@dataclass(frozen=True)
class Section:
    """Tables of one group of runs, and what is to be said of them."""

    title: str
    tables: Sequence[Table]
    findings: Sequence[Finding] = ()


@dataclass(frozen=True)
class Page:
    """Everything that is printed."""

    title: str
    lead: str
    sections: Sequence[Section]
    origin: Sequence[tuple[str, str]] = field(default_factory=list)


FINDINGS = "Cells that fall short"
NOTHING = (
    "None: ours is the best among the methods run here and the published numbers, and the paper's method is "
    "within twice its published error."
)


def markdown(page: Page) -> str:
    """The page as GitHub shows it."""
    lines = [f"# {page.title}", "", page.lead, ""]
    for section in page.sections:
        lines += [f"## {section.title}", ""]
        for table in section.tables:
            lines += [f"### {table.title}", "", table.note, "", *_markdown_rows(table), ""]
        if section.tables and section.tables[0].title == "Accuracy":
            lines += [f"### {FINDINGS}", ""]
            lines += [f"- {f.text} {f.remark}".rstrip() for f in section.findings] or [NOTHING]
            lines += [""]
    lines += ["## Origin", "", *(f"- {name}: {value}" for name, value in page.origin), ""]
    return "\n".join(lines)


def _markdown_rows(table: Table) -> list[str]:
    n = len(table.head)
    head = [f"*{h}*" if k >= n - table.borrowed else h for k, h in enumerate(table.head)]
    rows = [[_markdown_cell(cell) for cell in row] for row in table.rows]
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * n, *rows)]


def _markdown_cell(cell: Cell) -> str:
    text = f"**{cell.text}**" if cell.best else cell.text
    whole = f"{text} ({cell.detail})" if cell.detail and text else text + cell.detail
    return whole.replace("|", "\\|")
