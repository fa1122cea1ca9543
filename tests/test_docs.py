"""Documentation: no public name is missing, its code runs, the check of its pages sees what it must.

The scripts of examples/ run as they are, draw, and stay short: ``make gallery`` runs that slow part.
"""

from __future__ import annotations

import ast
import contextlib
import importlib.util
import inspect
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import pytest
from click.testing import CliRunner

import leastaction as la
from benchmarks import pages
from helpers import folding
from leastaction import systems
from leastaction.cli.program import program
from leastaction.findings import CODES, REASONS, TEXT, because

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))


def _load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name.replace("/", "_"), DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module
    spec.loader.exec_module(module)
    return module


CHECK = _load("check_pages")


def _documented() -> set[str]:
    pages = "".join(page.read_text(encoding="utf-8") for page in DOCS.glob("api/*.rst"))
    return set(
        re.findall(r"^\.\. auto(?:function|class|exception)::\s+leastaction\.(\S+)", pages, re.MULTILINE)
    )


def _public() -> set[str]:
    names = set()
    for name in la.__all__:
        thing = getattr(la, name)
        if not inspect.ismodule(thing):
            # a reader of files is documented where it is defined
            names.add(f"io.{name}" if name in la.io.__all__ else name)
            continue
        own = [n for n, x in vars(thing).items() if getattr(x, "__module__", "") == thing.__name__]
        listed = getattr(thing, "__all__", None) or [n for n in own if not n.startswith("_")]
        names.update(f"{name}.{inner}" for inner in listed)
    return names


def test_every_public_name_is_in_the_reference() -> None:
    assert _public() - _documented() == set()


def test_the_reference_names_nothing_that_is_not_there() -> None:
    for name in _documented():
        thing: object = la
        *modules, last = name.split(".")
        for part in modules:
            thing = (
                importlib.import_module(f"leastaction.{part}")
                if part.startswith("_")
                else getattr(thing, part)
            )
        assert hasattr(thing, last), name


def test_the_reference_would_miss_a_new_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(systems, "__all__", [*systems.__all__, "brand_new"])
    assert _public() - _documented() == {"systems.brand_new"}


def test_every_command_is_on_its_page() -> None:
    page = (DOCS / "cli.md").read_text(encoding="utf-8")
    assert isinstance(program, click.Group)
    for name in program.commands:
        assert f"```{{program-output}} leastaction {name} --help\n" in page


def _explained(title: str) -> dict[str, set[str]]:
    """Code → values in one of the tables of report.md."""
    page = (DOCS / "report.md").read_text(encoding="utf-8").split("## The findings")[1].split("\n## ")[0]
    rows = re.findall(
        r"^\| `([a-z-]+)` \|[^|]*\|([^|]*)\|", page.split(f"### {title}")[1].split("### ")[0], re.M
    )
    return {code: set(re.findall(r"`([a-z_]+)`", values)) for code, values in rows}


@pytest.mark.parametrize(("title", "severity"), [("Warnings", "warning"), ("Notes", "note")])
def test_every_code_is_explained(title, severity) -> None:
    codes = {code for code, row in CODES.items() if row.severity == severity}
    assert set(_explained(title)) == codes | ({TEXT} if severity == "warning" else set())


def test_every_reason_of_the_trade_off_curve_has_words_and_is_explained() -> None:
    page = (
        (DOCS / "report.md").read_text(encoding="utf-8").split("## The trade-off curve")[1].split("\n## ")[0]
    )
    assert re.findall(r"^\| `([a-z-]+)` \|", page, re.M) == list(REASONS)
    # the selection gives these and no others
    source = (ROOT / "src/leastaction/selection/alternatives.py").read_text(encoding="utf-8")
    texts = {n.value for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Constant)}
    assert set(REASONS) <= texts
    assert all(because(reason, 0.05) for reason in REASONS if reason != "chosen")
    assert because("of a later version") == ""


def test_the_values_of_every_code_are_explained() -> None:
    documented = _explained("Warnings") | _explained("Notes")
    given: dict[str, set[str]] = {}
    partly = set()  # a check that passes a mapping on
    for path in sorted((ROOT / "src/leastaction").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (
                isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "find"
            ):
                continue
            code = node.args[0].value if isinstance(node.args[0], ast.Constant) else None
            if code in CODES:
                given.setdefault(code, set()).update(k.arg for k in node.keywords if k.arg)
                partly.update(code for k in node.keywords if k.arg is None)
    assert len(given) > 25
    for code, values in given.items():
        assert values <= documented[code] if code in partly else values == documented[code], code


def _examples() -> list[tuple[str, str]]:
    found = []
    for page in PAGES:
        blocks = re.findall(
            r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
        )
        found += [(f"{page.stem}-{k}", block) for k, block in enumerate(blocks)]
    return found


# Of docs/coming_from.md: what other tools want, which are not installed.
_OTHERS = ("import pysindy", "from xlsindy", "from pysr")


def _of_page(page: str) -> list[str]:
    """The blocks of a page in sequence; later ones use the names of earlier ones."""
    blocks = [block for name, block in _examples() if name.rpartition("-")[0] == page]
    return [block for block in blocks if not any(other in block for other in _OTHERS)]


OURS = [page.stem for page in PAGES if _of_page(page.stem) and page.stem != "index"]


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One folder with the files of each page that has Python examples of ours."""
    cart, pendulum = (tmp_path_factory.mktemp(name) for name in ("cart", "pendulum"))
    data = systems.generate("cart_spring_pendulum", noise=0.01, trials=2, duration=5.0, seed=0)
    la.write_csv(cart / "run.csv", data)
    (cart / "robot.urdf").write_text(folding(), encoding="utf-8")
    driven = systems.generate("single_pendulum", noise=0.01, trials=2, duration=5.0, rate=50.0, seed=0)
    rows = ["trial,t,theta,tau"] + [
        f"{k},{t},{q},{f}"
        for k, run in enumerate(driven)
        for t, q, f in zip(run.t, run.q[:, 0], run.forces[:, 0], strict=True)
    ]
    (pendulum / "run.csv").write_text("\n".join(rows), encoding="utf-8")
    scipy_io = pytest.importorskip("scipy.io")
    run = driven[0]
    scipy_io.savemat(pendulum / "run.mat", {"t": run.t, "theta": run.q[:, 0], "tau": run.forces[:, 0]})
    return {
        "coming_from": pendulum,
        "lab": pendulum,
        **dict.fromkeys(("arms", "start", "report", "choose"), cart),
    }


_MARKS = {
    # each takes as long as all others together
    "choose": pytest.mark.thorough,
    "lab": pytest.mark.thorough,
    "arms": [
        pytest.mark.thorough,
        pytest.mark.skipif(not importlib.util.find_spec("pinocchio"), reason="needs the extra robots"),
    ],
}
_PAGES = [pytest.param(page, marks=_MARKS.get(page, ())) for page in OURS]


@pytest.mark.parametrize("page", _PAGES)
def test_examples_of_the_pages_run(
    page: str, tables: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tables.get(page, tmp_path))
    names = {"__name__": "__main__"}
    for number, block in enumerate(_of_page(page)):
        exec(compile(block, f"{page}-{number}", "exec"), names)


def _commands() -> list[str]:
    """Commands that readers copy, from README.md and the pages; what a page runs itself is not among them."""
    found = []
    for page in (ROOT / "README.md", *PAGES):
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        found += re.findall(r"^(?:    |\$ (?:\.venv/bin/)?)(leastaction [^\n]+)", text, re.M)
    return found


def test_the_home_page_shows_what_its_example_prints() -> None:
    page = (DOCS / "index.md").read_text(encoding="utf-8")
    code, shown = (re.search(rf"^```{kind}\n(.*?)^```", page, re.M | re.S)[1] for kind in ("python", "text"))
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(code, "index.md", "exec"), {"__name__": "__main__"})
    assert printed.getvalue() == shown


@pytest.mark.parametrize("command", _commands())
def test_commands_of_the_pages_have_these_options(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are read, not run: their files are the reader's."""
    name, *arguments = shlex.split(command, comments=True)[1:]
    assert isinstance(program, click.Group)
    chosen = program.commands[name]
    monkeypatch.setattr(chosen, "callback", lambda **_: None)
    chosen.main(arguments, prog_name=name, standalone_mode=False)


def test_commands_of_the_readme_run(tables: dict[str, Path], tmp_path: Path) -> None:
    """Its three files are those of three days."""
    rows = (tables["lab"] / "run.csv").read_text(encoding="utf-8").splitlines()
    trials = [[row[2:] for row in rows[1:] if row.startswith(f"{k},")] for k in (0, 1)]
    for day, trial in zip(("monday", "tuesday", "friday"), (*trials, trials[0]), strict=True):
        (tmp_path / f"{day}.csv").write_text("\n".join(["t,theta,tau", *trial]), encoding="utf-8")
    ours = [c for c in _commands() if " found/" in c or "--output found" in c][:3]
    assert [command.split()[1] for command in ours] == ["discover", "validate", "export"]
    with contextlib.chdir(tmp_path):
        for command in ours:
            short = command.replace("--horizon 9", "--horizon 2")  # these recordings are short
            done = CliRunner().invoke(program, shlex.split(short)[1:])
            assert done.exit_code == 0, done.output
    assert {"model.json", "report.html"} == {path.name for path in (tmp_path / "found").iterdir()}
    assert (tmp_path / "model.c").exists()


@pytest.mark.parametrize("page", ["README.md", "docs/start.md", "docs/choose.md"])
def test_sentences_are_short(page: str) -> None:
    assert list(CHECK.long_sentences((ROOT / page).read_text(encoding="utf-8"))) == []


def test_long_sentences_are_found() -> None:
    long = "Word " * 40
    code = f"```python\n{long}\n```"
    text = f"# {long}\n\nShort. {long}end. Short again [a link](x.md).\n\n{code}\n\n| {long} | b |\n"
    assert [words for words, _ in CHECK.long_sentences(text)] == [40, 41, 40]
    assert CHECK.main(["--sentences", str(ROOT / "docs/start.md")]) == 0


def test_large_pages_are_seen(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("x" * 500_000, encoding="utf-8")
    assert [line for line in CHECK.problems(tmp_path) if "has 500000 bytes" in line]


def test_versions_are_listed_newest_first(tmp_path: Path) -> None:
    for name in ("0.9.0", "0.10.0", "0.10.0.dev1"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "index.html").touch()
    assert CHECK.write_list(tmp_path) == ["0.10.0", "0.10.0.dev1", "0.9.0"]
    assert "url=0.10.0/index.html" in (tmp_path / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(("name", "block"), _examples(), ids=[name for name, _ in _examples()])
def test_examples_are_python(name: str, block: str) -> None:
    compile(block, name, "exec")


# -------------------------------------------------------------- README.md: what it shows is what comes out
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def first() -> tuple[str, dict[str, Any]]:
    """What the example of README.md prints, and the names that it leaves."""
    names: dict[str, Any] = {"__name__": "__main__"}
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(pages.example()[0], "README.md", "exec"), names)
    return printed.getvalue(), names


def _texts(svg: str) -> list[str]:
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_the_first_example_prints_what_the_readme_shows(first: tuple[str, dict[str, Any]]) -> None:
    assert first[0] == pages.example()[1]


def test_the_first_example_is_ten_lines() -> None:
    assert len([line for line in pages.example()[0].splitlines() if line]) <= 10
    assert "```python" not in README.replace("```python", "", 1), "pages.example() knows one block"


def test_the_first_formula_is_explained_with_the_numbers_found(first: tuple[str, dict[str, Any]]) -> None:
    model = first[1]["model"]
    for term in (*model.terms, *model.dissipation):
        reading, unit, true = pages.READINGS[term.expression]
        row = next(line for line in README.splitlines() if line.startswith(f"| `{term.expression}`"))
        assert f"| {pages.measured(term)} |" in row
        assert f"| {reading.split()[-1] if 'friction' in reading else reading}, " in row
        assert row.endswith(f"| {true:g} {unit} |")
        assert term.lower <= true <= term.upper
    assert len(first[1]["candidates"]) == 9  # "nine candidate terms"


def test_the_picture_is_that_of_the_first_example(first: tuple[str, dict[str, Any]]) -> None:
    kept = pages.PICTURE.read_text(encoding="utf-8")
    names = first[1]
    assert _texts(kept) == _texts(pages.draw(names["runs"], names["model"], names["forecast"]))
    assert len(kept.encode()) < 60_000
    assert f"]({pages.PICTURE.relative_to(ROOT).as_posix()})" in README


def test_links_of_the_readme_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)]+)\)", README)
    assert len(links) > 10
    for link in links:
        name, _, anchor = link.partition("#")
        assert (ROOT / name).exists(), link
        if anchor:
            titles = re.findall(r"^#+ (.+)$", (ROOT / name).read_text(encoding="utf-8"), re.M)
            assert anchor in {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


FOREIGN = [
    '<script src="https://cdn.example.org/a.js"></script>',
    '<script src="//cdn.example.org/a.js"></script>',
    '<link rel="stylesheet" href="https://example.org/a.css">',
    '<link rel="preconnect" href="https://fonts.example.org">',
    '<img alt="" src="here.png" srcset="here.png 1x, https://example.org/b.png 2x">',
    '<iframe src="http://example.org"></iframe>',
    '<object data="https://example.org/x.svg"></object>',
    '<p style="background: url(https://example.org/a.png)">x</p>',
    "<style>@import 'https://example.org/a.css';</style>",
    '<script>fetch("https://example.org/data.json")</script>',
    '<script>x.src = "https://example.org/a.js"</script>',
    '<meta http-equiv="refresh" content="0; url=https://example.org/">',
]


@pytest.mark.parametrize("markup", FOREIGN)
def test_what_a_page_would_fetch_is_seen(markup: str, tmp_path: Path) -> None:
    (tmp_path / "here.png").touch()
    (tmp_path / "index.html").write_text(markup, encoding="utf-8")
    assert [line for line in CHECK.problems(tmp_path) if "loads" in line]
    assert CHECK.main([str(tmp_path)]) == 1


def test_a_page_that_stands_alone_passes(tmp_path: Path) -> None:
    (tmp_path / "a.css").write_text(
        "p { background: url(data:image/png;base64,xx) } /* url(https://x.org/y) */"
    )
    (tmp_path / "a.js").write_text(
        '// see https://example.org\nconst namespace = "http://www.w3.org/2000/svg";'
    )
    (tmp_path / "index.html").write_text(
        '<link rel="stylesheet" href="a.css?v=1"><script src="a.js"></script>'
        '<link rel="canonical" href="https://example.org/"><a href="https://example.org">a link</a>'
        '<a href="#top">top</a><svg xmlns="http://www.w3.org/2000/svg"><use href="#x"/></svg>'
    )
    assert list(CHECK.problems(tmp_path)) == []
    assert CHECK.main([str(tmp_path)]) == 0


def test_styles_and_scripts_are_read_too(tmp_path: Path) -> None:
    (tmp_path / "a.css").write_text("@font-face { src: url('https://fonts.example.org/f.woff2') }")
    (tmp_path / "b.js").write_text('import("https://cdn.example.org/m.mjs")')
    (tmp_path / "index.html").write_text('<img src="lost.png"><a href="lost.html">x</a>')
    assert len(list(CHECK.problems(tmp_path))) == 4


def test_no_pages_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert CHECK.main([str(tmp_path)]) == 2
    assert "make docs" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------ the gallery
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SECONDS = 30.0  # of one core; double that ends the test on slow machines

# Counts figures where a person would look at them.
_RUN = """
import runpy, sys
import matplotlib.pyplot as plt
shown = []
plt.show = lambda: shown.extend(plt.get_fignums())
runpy.run_path(sys.argv[1], run_name="__main__")
sys.exit(0 if shown else "the script shows no figure")
"""


@pytest.mark.slow
@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_script_runs(script: Path, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource", reason="processor time of a child is a matter of POSIX")
    environment = {**os.environ, "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", _RUN, str(script)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0, done.stderr
    assert after.ru_utime - before.ru_utime < 2 * SECONDS
    assert not list(tmp_path.iterdir()), "a script must not leave files behind"


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_script_is_a_page(script: Path) -> None:
    """A title, public names only, a figure at the end, and what to learn from it."""
    text = script.read_text(encoding="utf-8")
    tree = ast.parse(text)
    title, rule = (ast.get_docstring(tree) or "").splitlines()[:2]
    assert set(rule) == {"="}
    assert len(rule) >= len(title)
    modules = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    modules += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    assert not [m for m in modules if m.startswith("leastaction.") and m.split(".")[1].startswith("_")]
    attributes = [n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)]
    assert not [a for a in attributes if a.startswith("_")]
    tail = text[text.rindex("plt.show()") :]
    assert "# **What to learn.**" in tail
