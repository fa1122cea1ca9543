"""What the program prints, taken when the pages are built, so that it is never older than the program.

``.. program-output:: leastaction demo --output demo`` runs the command in a folder that all pages share
(``_build/session``) and shows command and output; option ``:hide:`` runs it without showing, ``:lines: 20``
shows the first lines only, ``:fails: 2`` expects that exit code. ``.. file-content:: demo/model.json`` shows
a file of that folder, and ``:report:`text <demo>` `` links to a copy of demo/report.html.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import ReferenceRole, SphinxDirective

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


def setup(app: Sphinx) -> dict[str, object]:
    """Register the directives. Commands depend on each other, so pages are read one after the other."""
    app.add_directive("program-output", ProgramOutput)
    app.add_directive("file-content", FileContent)
    app.add_role("report", Report())
    app.connect("env-before-read-docs", read_first)
    app.connect("build-finished", copy_reports)
    return {"version": "1", "parallel_read_safe": False, "parallel_write_safe": True}
