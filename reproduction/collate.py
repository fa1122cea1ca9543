"""Records of runs → the tables, as Markdown.

    python -m reproduction.collate --results reproduction/results --output reproduction/tables

Everything is computed from the records, the paper's numbers (``paper.json``) and, where a reason needs
judgement, its ``remarks``: key of a finding, or its beginning up to a slash → text.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import click
import numpy as np

import leastaction as la
from reproduction._further_tables import speed, without_candidates
from reproduction._results import Column, Group, Results, complete, read
from reproduction._tables import Cell, Table, ablation, experiments, group_tables, number, place, published

__all__ = ["Finding", "findings"]

# ---------------------------------------- a sentence for every cell that is not as one would wish
MISSED = 2.0  # times its published error: the paper's method has not been reproduced in that cell
PAPERS = "the paper's method"


@dataclass(frozen=True)
class Finding:
    """What is to be said of a cell; `remark` is what a person has written about it under `key`."""

    key: str
    text: str
    remark: str = ""


def findings(results: Results, group: Group, paper: Mapping, remarks: Mapping[str, str]) -> list[Finding]:
    """Return where ours is not the best, and where the paper's method, run by us, misses its own numbers.

    Keys are ``ours/<system>/<noise>/<convention>/<library>/<trajectories>``, and the same with ``adam``; a
    remark under a shorter key, cut at a slash, holds for all cells that begin with it.
    """
    chosen = results.of(group).comparable
    found = []
    told = results.of(group).where(method="adam", variant="true-terms", missing=0)
    for system, noise in chosen.cells:
        cell = chosen.where(system=system, noise=noise)
        papers = _papers(cell, group, paper)
        if papers:
            papers += _told(told.where(system=system, noise=noise))
        for method, text in (("ours", _ours(cell, group, paper)), ("adam", papers)):
            if text:
                key = f"{method}/{system}/{noise:g}/{group.convention}/{group.library}/{group.trajectories}"
                found.append(Finding(key, f"{place(system, noise)}: {text}", _remark(key, remarks)))
    return found


def _remark(key: str, remarks: Mapping[str, str]) -> str:
    parts = key.split("/")
    keys = ("/".join(parts[:k]) for k in range(len(parts), 0, -1))
    return next((remarks[k] for k in keys if k in remarks), "")


OURS, ADAM = ("ours", ""), ("adam", "")


def _ours(cell: Results, group: Group, paper: Mapping) -> str:
    """Say by whom ours is beaten, among those that were run and the published; "" if by nobody."""
    own = cell.column(OURS)
    (system, noise) = cell.cells[0]
    columns = [OURS, *(c for c in cell.columns if c != OURS)]
    ran = [cell.column(c) for c in columns]
    full = dict(zip(columns, complete(ran), strict=True))
    errors = {cell.title(c): cell.column(c).mean("l2") for c in columns[1:] if full[c]}
    others = {name: 100 * error for name, error in errors.items() if error is not None}
    rows = {name: published(paper, group, name, system, noise) for name in paper["table1"]["methods"]}
    others |= {f"{name} (published)": row[0] for name, row in rows.items() if row}
    if not own.records or not others:
        return ""
    name = min(others, key=others.__getitem__)
    best = f"{name} has ℓ2 {number(others[name])} × 10⁻²"
    if not full[OURS]:
        return f"{_lost(own, OURS, max(len(r.records) for r in ran))}; {best}."
    error = 100 * own.mean("l2")
    if error <= others[name]:
        return ""
    return (
        f"{_scores(own, OURS)} is not the best: {best}, {number(error / others[name])} times less."
        f"{_against_bound(own)}"
    )


def _papers(cell: Results, group: Group, paper: Mapping) -> str:
    """Say by how much the paper's method, run by us, misses its published error; "" if by less than twice."""
    runs = cell.column(ADAM)
    (system, noise) = cell.cells[0]
    row = published(paper, group, PAPERS, system, noise)
    if not runs.records or not row:
        return ""
    printed = f"{row[0]:.2f} × 10⁻² ({row[1]:g} %, {row[2]:g} %)"
    if not runs.finished:
        return f"{_lost(runs, ADAM, len(runs.records))}; published {printed}."
    error = 100 * runs.mean("l2")
    if error <= MISSED * row[0]:
        return ""
    return (
        f"{_scores(runs, ADAM)}, run here, is {number(error / row[0])} times the published {printed}."
        f"{_spread([100 * r['l2'] for r in runs.finished], MISSED * row[0])}"
    )


def _spread(errors: Sequence[float], reproduced: float) -> str:
    """A mean over runs of which some have lost the law says little of the others."""
    if len(errors) < 2:
        return ""
    good = sum(error <= reproduced for error in errors)
    median, least = number(float(np.median(errors))), number(min(errors))
    return (
        f" Median of the runs {median} × 10⁻², smallest {least} × 10⁻²; {good} of {len(errors)} runs are "
        f"within {MISSED:g} times the published error."
    )


def _told(runs: Results) -> str:
    """Say what the paper's method finds without false candidates."""
    if not runs.finished:
        return ""
    count = f"{len(runs.finished)} run{'s' * (len(runs.finished) != 1)}"
    return f" With the true terms as its only candidates: {number(100 * runs.mean('l2'))} × 10⁻² ({count})."


def _lost(runs: Results, column: Column, most: int) -> str:
    reasons = dict.fromkeys(f"{r['status']}: {r['reason']}" for r in runs.failed)
    why = f" ({'; '.join(reasons)})" if reasons else ""
    return f"{runs.title(column)} has an answer in {len(runs.finished)} of {most} runs{why}"


def _scores(runs: Results, column: Column) -> str:
    count = f"{len(runs.finished)} of {len(runs.records)} runs"
    shares = f"precision {100 * runs.mean('precision'):.3g} %, recall {100 * runs.mean('recall'):.3g} %"
    return f"{runs.title(column)} with ℓ2 {number(100 * runs.mean('l2'))} × 10⁻² ({shares}, {count})"


def _against_bound(runs: Results) -> str:
    ratio = runs.rms("l2_over_crb")
    return "" if ratio is None else f" Its error is {number(ratio)} times the Cramér–Rao bound of the data."


# -------------------------------------------------------------------------------------- how a page is written
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


# ---------------------------------------------------------------------------------------------- what is on it
HERE = Path(__file__).resolve().parent
LEAD = (
    "The tables of Zhang & Sun, Differentiable Sparse Identification of Lagrangian Dynamics (AAAI 2026), "
    "with other methods on the same data and the paper's published numbers. The best value of each row is in "
    "bold. Generated by python -m reproduction.collate from the records of the runs."
)


def page(results: Results, paper: dict, remarks: dict[str, str]) -> Page:
    """Return all tables of all groups of runs that the records hold."""
    sections = []
    for group in results.groups:
        tables = group_tables(results, group, paper)
        if tables:
            told = experiments(results, group, paper)
            tables += [told] if told else []
            sections.append(Section(group.title, tables, findings(results, group, paper, remarks)))
    for group in results.groups:
        table = ablation(results, group, paper)
        if table:
            sections.append(Section(f"Second table. {group.title}", [table]))
    for group in results.groups:
        tables = without_candidates(results, group, paper)
        if tables:
            sections.append(Section(f"Without candidates. {group.title}", tables))
    pace = speed(results)
    if pace:
        sections.append(Section("Speed", pace))
    return Page("Reproduction: tables", LEAD, sections, origin(results))


def origin(results: Results) -> list[tuple[str, str]]:
    """Return commits, machines, versions and dates of the records."""
    records = results.records
    dates = sorted(r["date"] for r in records)
    machines = Counter(_machine(r["machine"]) for r in records)
    commits = Counter(r["commit"][:12] + r["commit"][40:] or "unknown" for r in records)
    packages: dict[str, set[str]] = {}
    for r in records:
        for name, version in r["versions"].items():
            packages.setdefault(name, set()).add(version)
    failed = len(results.failed)
    return [
        ("Runs", f"{len(records)}, of which {failed} without an answer"),
        ("Dates", dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"),
        ("Commits", _counted(commits)),
        ("Machines", _counted(machines)),
        ("Versions", ", ".join(f"{n} {'/'.join(sorted(v))}" for n, v in sorted(packages.items()))),
    ]


def _machine(machine: dict) -> str:
    cores, parallel = machine["cores"], machine["parallel_runs"]
    runs = "one run" if parallel == 1 else f"{parallel} runs"
    return f"{machine['processor']}, {cores} cores, {machine['system']}, {runs} at a time"


def _counted(counts: Counter[str]) -> str:
    return "; ".join(f"{name} ({n} run{'s' * (n != 1)})" for name, n in counts.most_common())


def unexplained(sections: tuple[Section, ...] | list[Section]) -> list[Finding]:
    """Return the findings that no remark explains."""
    return [f for section in sections for f in section.findings if not f.remark]


def mixed_settings(results: Results) -> list[str]:
    """Return the cells of the paper's method whose runs were made with different searched settings."""
    seen: dict[str, set[str]] = {}
    for r in (r for r in results.where(method="adam").records if r["result"]["finished"]):
        config = r["config"]
        name = " ".join(f"adam {config['variant']} {config['system']} {config['noise']:g}".split())
        searched = {k: v for k, v in r["result"].get("settings", {}).items() if k != "start_coefficients"}
        seen.setdefault(name, set()).add(json.dumps(searched, sort_keys=True))
    return [name for name, settings in seen.items() if len(settings) > 1]


@click.command(help=__doc__.split("\n\n")[0])
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), default=HERE / "results")
@click.option("--output", type=click.Path(file_okay=False, path_type=Path), default=HERE / "tables")
@click.option(
    "--remarks", type=click.Path(dir_okay=False, path_type=Path), help="Default: those of paper.json."
)
def main(results: Path, output: Path, remarks: Path | None) -> None:
    try:
        found = read(results)
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    if not found.records:
        raise click.ClickException(f"{results} holds no records; make some by python -m reproduction.run")
    paper = json.loads((HERE / "paper.json").read_text(encoding="utf-8"))
    words = json.loads(remarks.read_text(encoding="utf-8")) if remarks else paper["remarks"]
    whole = page(found, paper, words)
    la.io.write_text(output / "tables.md", markdown(whole))
    click.echo(output / "tables.md")
    for finding in unexplained(whole.sections):
        click.echo(f"no remark for {finding.key}", err=True)
    for name in mixed_settings(found):
        click.echo(f"runs with different settings: {name}; remove the older records and run again", err=True)


if __name__ == "__main__":
    main()
