"""The package as a whole: its data, thresholds and files for releases, and how it does without extras."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import pickle
import re
import subprocess
import sys
import tomllib
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import leastaction
from leastaction import InputError, LagrangianModel
from leastaction.curve.settings import CURVE
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.errors import MissingPackageError
from leastaction.estimation.settings import ESTIMATION
from leastaction.hidden.settings import HIDDEN
from leastaction.model.model import ModelTerm
from leastaction.selection.settings import SELECTION

# --------------------------------------------------- measured data: whole, and what their README says
DATA = files("leastaction") / "datasets"


@pytest.mark.parametrize(
    ("name", "coordinates", "n_trials", "n_times"),
    [
        ("double_pendulum", ["theta1", "theta2"], 26, 1334),
        ("single_pendulum", ["theta"], 4, 4584),
    ],
)
def test_measured_pendulum(name, coordinates, n_trials, n_times):
    with as_file(DATA / f"{name}.csv.gz") as path:
        frame = pd.read_csv(path)
    assert list(frame.columns) == ["trial", "t", *coordinates]
    assert frame["trial"].unique().tolist() == [f"id-{k}" for k in range(n_trials)]
    for _, trial in frame.groupby("trial"):
        assert len(trial) == n_times
        np.testing.assert_allclose(np.diff(trial["t"]), 0.002, rtol=0, atol=1e-9)
        angles = trial[coordinates].to_numpy()
        # Zero is upright, so a swing stays around π; a jump between samples would be a wrapped angle.
        assert abs(angles.mean() - np.pi) < 0.1
        assert np.abs(np.diff(angles, axis=0)).max() < 0.1


def test_licence_is_beside_the_data():
    assert "dynamicslab" in (DATA / "LICENSE-MultiArm-Pendulum").read_text(encoding="utf-8")


# ------------------------- thresholds: one frozen object a package, every value documented and in use
SETTINGS = {
    "CURVE": CURVE,
    "ESTIMATION": ESTIMATION,
    "HIDDEN": HIDDEN,
    "SELECTION": SELECTION,
    "DIAGNOSIS": DIAGNOSIS,
}


def _documented(settings) -> set[str]:
    """Names of the fields that are followed by a text."""
    body = ast.parse(inspect.getsource(type(settings))).body[0].body
    return {
        field.target.id
        for field, text in itertools.pairwise(body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_are_frozen_documented_and_used(name):
    settings = SETTINGS[name]
    fields = {field.name for field in dataclasses.fields(settings)}
    assert _documented(settings) == fields
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(settings, next(iter(fields)), 0.0)
    source = "".join(path.read_text("utf-8") for path in Path(leastaction.__file__).parent.rglob("*.py"))
    assert not [field for field in fields if f"{name}.{field}" not in source]


def _undescribed(path: Path) -> list[str]:
    """Numbers at the top of a module without a comment beside or above them, or a text below."""
    text = path.read_text("utf-8")
    lines, body = text.splitlines(), ast.parse(text).body
    texts = {before for before, node in itertools.pairwise(body) if isinstance(node, ast.Expr)}
    return [
        f"{path.parent.name}/{path.name}: {lines[node.lineno - 1]}"
        for node in body
        if isinstance(node, ast.Assign)
        and node not in texts
        and any(
            isinstance(n, ast.Constant) and isinstance(n.value, (int, float)) for n in ast.walk(node.value)
        )
        and "#" not in lines[node.end_lineno - 1] + lines[node.lineno - 1]
        and not lines[node.lineno - 2].lstrip().startswith("#")
    ]


@pytest.mark.parametrize("name", SETTINGS)
def test_other_numbers_say_what_they_are(name):
    """What decides is in the settings; what is left beside the code is bookkeeping, and says of what."""
    folder = Path(leastaction.__file__).parent / name.lower()
    assert not [line for path in sorted(folder.rglob("*.py")) for line in _undescribed(path)]


# ------------------------------------------------------- files for releases: they agree with pyproject.toml
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_the_conda_recipe_has_the_same_requirements(project):
    recipe = (ROOT / "packaging/recipe.yaml").read_text(encoding="utf-8")
    run = recipe.partition("  run:\n")[2].partition("\n\n")[0]
    found = {line.strip("- ").replace(" ", "") for line in run.splitlines()}
    python = f"python{project['project']['requires-python']}"
    assert found == {*project["project"]["dependencies"], python}


def test_versions_and_licences_agree(project):
    version = project["project"]["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    recipe = (ROOT / "packaging/recipe.yaml").read_text(encoding="utf-8")
    assert f"\nversion: {version}\n" in citation
    assert f'version: "{version}"' in recipe
    assert all(name in recipe for name in project["project"]["license-files"])
    assert f"license: {project['project']['license']}" in citation


def test_release_files_name_what_exists(project):
    included = project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert not [name for name in included if not (ROOT / name.strip("/")).exists()]
    extras = project["project"]["optional-dependencies"]
    container = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert set(re.search(r"leastaction\[([\w,]+)\]", container)[1].split(",")) <= extras.keys()
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    workflow = (ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8")
    for text in (workflow, (ROOT / ".ci/run").read_text(encoding="utf-8")):
        targets = re.findall(r"^(?:.*run: )?make ([\w-]+)", text, re.M)
        assert len(targets) > 4
        assert not [name for name in targets if not re.search(rf"^{name}:", makefile, re.M)]
    tested = set(re.findall(r"\"(3\.\d+)\"", workflow))
    classified = {c.rpartition(" ")[2] for c in project["project"]["classifiers"] if " 3." in c}
    assert tested == classified


def test_the_paper_cites_what_its_bibliography_holds():
    paper = (ROOT / "paper/paper.md").read_text(encoding="utf-8")
    entries = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "paper/paper.bib").read_text(encoding="utf-8"), re.M))
    assert set(re.findall(r"@([a-z]+\d{4})", paper)) == entries
    for name in re.findall(r"\]\(([^)]+\.svg)\)", paper):
        assert (ROOT / "paper" / name).exists()


# ------------------------------------------------------------------------- without the packages of the extras
BLOCKED = ("matplotlib", "pandas", "pyarrow", "h5py", "polars", "sklearn", "pint", "rosbags", "openpyxl")

MAIN_PATH = """
import sys
from importlib.abc import MetaPathFinder
from pathlib import Path

tried = []

class Blocker(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in BLOCKED:
            tried.append(name)
            raise ImportError(f"{name} is blocked")

sys.meta_path.insert(0, Blocker())
folder = Path(sys.argv[1])

import leastaction as la
from leastaction.cli import program

def command(*words):
    try:
        program.main([str(word) for word in words])
    except SystemExit as end:
        assert not end.code, words

run = folder / "run.csv"
command("generate", "single_pendulum", "--noise", "0.01", "--trials", "2", "--duration", "8", "-o", run)
(folder / "library.txt").write_text("theta_dot**2\\ncos(theta)\\nsin(theta)")
command("discover", run, "--coordinates", "theta", "--forces", "theta_force", "--library",
        folder / "library.txt", "--hold-out", "1", "--output", folder / "found")
assert (folder / "found" / "report.html").stat().st_size > 10_000
command("validate", folder / "found" / "model.json", run, "--forces", "theta_force")
command("export", folder / "found" / "model.json", "--format", "python", "-o", folder / "model.py")

model = la.load(folder / "found" / "model.json")
assert {term.expression for term in model.terms} == {"theta_dot**2", "cos(theta)"}
assert "cos(theta)" in str(model) and "cos(theta)" in model._repr_html_()

# The figures of the app need no more than those of the report.
from leastaction.app.figures import data_figure
drawn = data_figure(la.read_csv(run, coordinates=["theta"], trial="trial")[0], None, 0, "θ", "rad")
assert drawn.count("<svg") == 2
assert tried == [], tried
try:
    model.table()
except ImportError as error:
    assert "pip install 'leastaction[pandas]'" in str(error), error
else:
    raise AssertionError("table() needs pandas")
"""


def test_main_path_without_any_extra(tmp_path):
    script = MAIN_PATH.replace("BLOCKED", repr(BLOCKED))
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr


def test_missing_package_is_both_kinds_of_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    model = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5)])
    for kind in (ImportError, InputError, ValueError):
        with pytest.raises(kind, match=r"table\(\) needs pandas; install it with: .*use format_table\(\)"):
            model.table()


def test_missing_package_survives_pickling():
    error = MissingPackageError("this", "that", "other")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )


def test_nothing_but_the_app_imports_nicegui():
    code = (
        "import sys, leastaction\n"
        "import leastaction.app\n"
        "from leastaction.cli import main\n"
        "try:\n    main(['{}'])\nexcept SystemExit:\n    pass\n"
        "assert 'nicegui' not in sys.modules, 'imported'"
    )
    for option in ("--help", "--version"):
        result = run_python(code.format(option))
        assert result.returncode == 0, result.stderr


def test_without_the_extra_one_line_says_what_to_install():
    code = "import sys; sys.modules['nicegui'] = None; from leastaction.cli import main; main(['app'])"
    result = run_python(code)
    assert result.returncode == 2
    assert (
        result.stderr.strip()
        == "error: the app needs NiceGUI; install it with: pip install 'leastaction[app]'"
    )
    assert result.stdout == ""
