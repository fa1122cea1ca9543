"""The core does without the packages of the extras, and says which one is missing where it cannot."""

import pickle
import subprocess
import sys

import pytest

from leastaction import InputError, LagrangianModel
from leastaction.errors import MissingPackageError
from leastaction.model.model import ModelTerm

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
