"""Pages that are generated: the order of the gallery, and the pages of the reproduction.

``reproduction/tables/tables.md`` becomes one page a table in ``docs/reproduction/`` (not tracked), and
``.. reproduction-tables::`` an overview of links: a row for each kind of table, a column for each setting.
``.. reproduction-figures::`` shows the figures with the captions of ``reproduction/figures/figures.json``.
"""

from __future__ import annotations

import json
import re
import shutil
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

_ROOT = Path(__file__).resolve().parents[2]
_TABLES = _ROOT / "reproduction/tables/tables.md"
_FIGURES = _ROOT / "reproduction/figures/figures.json"
_ORDER = (
    "measured_double_pendulum",
    "cart_with_spring",
    "driven_double_pendulum",
    "robot_arm",
    "seven_joint_arm",
    "closed_loop_arm",
    "payload",
    "oscillators",
    "magnetic_pendulum",
    "unknown_anchor",
    "missing_samples",
    "hidden_pendulum",
    "camera_pixels",
    "lacking_term",
    "unmeasured_drive",
    "next_experiment",
    "controller",
)


class Sequence:
    """Sort key of sphinx-gallery: examples in reading order; unknown ones last."""

    def __init__(self, src_dir: str) -> None:
        self.src_dir = src_dir

    def __call__(self, filename: str) -> tuple[int, str]:
        name = Path(filename).stem
        return (_ORDER.index(name) if name in _ORDER else len(_ORDER), name)


# Words of headings that say little.
_COMMON = set(
    re.findall(
        r"\w+",
        "library, noise to each coordinate's spread, 5 trajectories, and the of in is not where that with "
        "against paper second table m mb their as ours method",
    )
)


@dataclass(frozen=True)
class _Page:
    setting: str  # a heading of the second level: library, noise, number of trajectories
    title: str  # a heading of the third level, such as "Accuracy"; that of the setting if there is none
    body: str

    @property
    def name(self) -> str:
        """Name of the file: the words that tell pages apart, not the long headings."""
        setting = _words(self.setting)
        return "-".join(setting if self.title == self.setting else [*setting, *_words(self.title)[:4]])

    def markdown(self) -> str:
        """Return the page, with its setting below the title."""
        below = "" if self.title == self.setting else f"*{self.setting}.* "
        return f"# {self.title}\n\n{below}[All tables](../reproduction.md)\n\n{self.body.strip()}\n"


def _words(heading: str) -> list[str]:
    plain = unicodedata.normalize("NFKD", heading.lower()).encode("ascii", "ignore").decode()
    return [word for word in re.findall(r"[a-z0-9]+", plain) if word not in _COMMON]


def pages(text: str) -> Iterator[_Page]:
    """Split the tables into pages."""
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        setting, _, rest = section.partition("\n")
        parts = re.split(r"^### ", rest, flags=re.MULTILINE)
        if parts[0].strip():
            yield _Page(setting, setting, parts[0])
        for part in parts[1:]:
            title, _, body = part.partition("\n")
            yield _Page(setting, title, body)


def _short(setting: str) -> str:
    """A heading for a column: "Compact library, noise relative to ..., 5 trajectories" is too long."""
    replaced = setting.replace("noise relative to each coordinate's spread", "relative noise")
    return replaced.replace("noise in rad and m", "absolute noise")


class ReproductionTables(SphinxDirective):
    """An overview of all tables, and the hidden list of their pages for the navigation."""

    def run(self) -> list[nodes.Node]:
        found = list(pages(_TABLES.read_text(encoding="utf-8")))
        shared = [p for p in found if sum(q.title == p.title for q in found) > 1]
        settings = list(dict.fromkeys(page.setting for page in shared))
        by_place = {(page.title, page.setting): page for page in shared}
        lines = [f"| table | {' | '.join(map(_short, settings))} |", f"|---|{'---|' * len(settings)}"]
        for title in dict.fromkeys(page.title for page in shared):
            row = [by_place.get((title, setting)) for setting in settings]
            cells = [f"[table](reproduction/{page.name}.md)" if page else "" for page in row]
            lines.append(f"| {title} | {' | '.join(cells)} |")
        single = [page for page in found if page not in shared]
        lines += ["", "Further tables:", ""]
        lines += [
            f"* [{page.title}](reproduction/{page.name}.md)"
            + (f" ({_short(page.setting)})" if page.title != page.setting else "")
            for page in single
        ]
        names = [f"reproduction/{page.name}" for page in found]
        return _parsed(self, [*lines, "", "```{toctree}", ":hidden:", "", *names, "```"])


class ReproductionFigures(SphinxDirective):
    """The figures of the reproduction with their captions."""

    def run(self) -> list[nodes.Node]:
        records = json.loads(_FIGURES.read_text(encoding="utf-8"))
        lines = []
        for record in records.values():
            title, address = record["title"], f"../reproduction/figures/{record['file']}"
            lines += [f"### {title}", "", f"![{title}]({address})", "", record["caption"], ""]
        return _parsed(self, lines)


def _parsed(directive: SphinxDirective, lines: list[str]) -> list[nodes.Node]:
    """Parse Markdown inside a page written in Markdown."""
    box = nodes.Element()
    directive.state.nested_parse(StringList(lines, source="generated"), 0, box, match_titles=1)
    return box.children


def write_pages(app: Sphinx) -> None:
    """Write the pages of the tables into the sources, where Sphinx looks for pages."""
    folder = Path(app.srcdir) / "reproduction"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for page in pages(_TABLES.read_text(encoding="utf-8")):
        (folder / f"{page.name}.md").write_text(page.markdown(), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, object]:
    """Register the directives."""
    app.add_directive("reproduction-tables", ReproductionTables)
    app.add_directive("reproduction-figures", ReproductionFigures)
    app.connect("builder-inited", write_pages)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
