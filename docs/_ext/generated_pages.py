"""What is generated with the pages: output of the program, pages of the reproduction, order of the examples.

``.. program-output:: leastaction demo --output demo`` runs the command in a folder that all pages share
(``_build/session``) and shows command and output, so that it is never older than the program; option
``:hide:`` runs it without showing, ``:lines: 20`` shows the first lines only, ``:fails: 2`` expects that exit
code. ``.. file-content:: demo/model.json`` shows a file of that folder, and ``:report:`text <demo>` `` links
to a copy of demo/report.html.

``reproduction/tables/tables.md`` becomes one page a table in ``docs/reproduction/`` (not tracked), and
``.. reproduction-tables::`` an overview of links: a row for each kind of table, a column for each setting.
``.. reproduction-figures::`` shows the figures with the captions of ``reproduction/figures/figures.json``.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import ReferenceRole, SphinxDirective

_MENU = """
(() => {
  const root = document.documentElement.dataset.content_root || "./";
  const list = document.createElement("script");
  list.src = root + "../versions.js";
  list.onload = () => {
    const menu = document.createElement("select");
    menu.setAttribute("aria-label", "Version of the documentation");
    menu.className = "form-select form-select-sm w-auto";
    for (const version of window.documentedVersions) {
      menu.add(new Option(version, version, false, version === "%s"));
    }
    menu.onchange = () => { location.href = root + "../" + menu.value + "/index.html"; };
    document.querySelector(".navbar-header-items__end")?.prepend(menu);
  };
  document.head.append(list);
})();
"""
_COLUMNS = "96"  # of the terminal that the program sees
_WIDTH = 100  # of what the page shows


class ProgramOutput(SphinxDirective):
    """Runs ``leastaction …`` and shows what it prints."""

    required_arguments = 1
    final_argument_whitespace = True
    option_spec = {  # noqa: RUF012  docutils reads it from the class
        "hide": directives.flag,
        "lines": directives.positive_int,
        "fails": directives.positive_int,
    }

    def run(self) -> list[nodes.Node]:
        command = " ".join(self.arguments[0].split())
        text = run_program(session(self.env.app), command, self.options.get("fails", 0))
        if "hide" in self.options:
            return []
        lines = text.rstrip().splitlines()
        shown = [part for line in lines[: self.options.get("lines", len(lines))] for part in _folded(line)]
        if self.options.get("lines", len(lines)) < len(lines):
            shown.append("...")
        block = "\n".join([*_typed(command), *shown])
        return [nodes.literal_block(block, block, language="console")]


def _folded(line: str) -> list[str]:
    """Break a long line of text as a terminal would; tables, which have columns, stay as they are."""
    is_table = "  " in line.strip()
    return [line] if is_table or len(line) <= _WIDTH else textwrap.wrap(line, _WIDTH)


def _typed(command: str) -> list[str]:
    """Break a long command before its options, so that it can still be copied and run."""
    lines, line = [], "$"
    for part in re.split(r" (?=--?\w)", command):
        if len(line) + len(part) > _WIDTH - 3:
            lines.append(f"{line} \\")
            line = "   "
        line += f" {part}"
    return [*lines, line]


class FileContent(SphinxDirective):
    """Shows a file that an earlier command of the same page has written."""

    required_arguments = 1
    option_spec = {"lines": directives.positive_int, "language": directives.unchanged}  # noqa: RUF012

    def run(self) -> list[nodes.Node]:
        lines = (session(self.env.app) / self.arguments[0]).read_text(encoding="utf-8").splitlines()
        shown = lines[: self.options.get("lines", len(lines))]
        text = "\n".join([*shown, "..."] if len(shown) < len(lines) else shown)
        return [nodes.literal_block(text, text, language=self.options.get("language", "text"))]


class Report(ReferenceRole):
    """Links to the report that a command has written into a folder of the session."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        if not (session(self.env.app) / self.target / "report.html").exists():
            raise ExtensionError(f"{self.env.docname}: no command has written {self.target}/report.html")
        up = "../" * self.env.docname.count("/")
        address = f"{up}reports/{self.target}.html"
        return [nodes.reference("", self.title, refuri=address, internal=True)], []


def read_first(app: Sphinx, env: object, docnames: list[str]) -> None:
    """Read the start page first: other pages show what its commands have written."""
    docnames.sort(key=lambda name: (name != "start", name))


def copy_reports(app: Sphinx, error: Exception | None) -> None:
    """Put the reports beside the pages."""
    if error is None and app.builder.format == "html":
        target = Path(app.outdir) / "reports"
        target.mkdir(exist_ok=True)
        for report in sorted(session(app).glob("*/report.html")):
            shutil.copyfile(report, target / f"{report.parent.name}.html")


def session(app: Sphinx) -> Path:
    """Return the folder in which the commands of all pages run."""
    folder = Path(app.outdir).parent / "session"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def run_program(folder: Path, command: str, code: int = 0) -> str:
    """Return stdout and stderr of a command; one that ran before, unchanged, is not run again."""
    program, *arguments = shlex.split(command)
    if program != "leastaction":
        raise ExtensionError(f"program-output runs leastaction only, not {program!r}")
    key = hashlib.sha256(command.encode()).hexdigest()[:16]
    kept = folder / f".{key}.txt"
    if kept.exists():
        return kept.read_text(encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "leastaction", *arguments],
        cwd=folder,
        env={**os.environ, "COLUMNS": _COLUMNS, "PYTHONIOENCODING": "utf-8"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        check=False,
    )
    if done.returncode != code:
        raise ExtensionError(f"{command}: exit code {done.returncode}, expected {code}:\n{done.stdout}")
    kept.write_text(done.stdout, encoding="utf-8")
    return done.stdout


# -------------------------------------------------- order of the examples, pages of the reproduction
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
    """Register the directives. Commands depend on each other, so pages are read one after the other."""
    app.add_directive("program-output", ProgramOutput)
    app.add_directive("file-content", FileContent)
    app.add_role("report", Report())
    app.connect("env-before-read-docs", read_first)
    app.connect("build-finished", copy_reports)
    app.add_directive("reproduction-tables", ReproductionTables)
    app.add_directive("reproduction-figures", ReproductionFigures)
    app.connect("builder-inited", write_pages)
    if os.environ.get("DOCS_SITE"):  # a menu, where the pages will lie beside those of other versions
        app.add_js_file(None, body=_MENU % app.config.version)
    return {"version": "1", "parallel_read_safe": False, "parallel_write_safe": True}
