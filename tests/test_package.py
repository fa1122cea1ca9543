"""The package as a whole: data, thresholds, release files, missing extras; modules loaded on first use."""

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
import leastaction as la
import page_helpers
from benchmarks import ablations, run, thresholds
from helpers import MODELS, finite_difference, states
from leastaction import InputError, LagrangianModel
from leastaction.curve.settings import CURVE
from leastaction.delay import estimate, shift_forces
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.errors import DataError, MissingPackageError
from leastaction.estimation.settings import ESTIMATION
from leastaction.hidden.settings import HIDDEN
from leastaction.model.model import ModelTerm
from leastaction.selection.settings import SELECTION

try:
    import control
except ImportError:
    control = None

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
    assert "MIT License\n\nCopyright (c) 2022 dynamicslab" in (DATA / "README.md").read_text(encoding="utf-8")


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


@pytest.mark.thorough
def test_benchmarks_of_settings_and_strategies_judge_a_search():
    case = thresholds.QUICK[0]
    assert thresholds.outcome(case, thresholds._searched(case)).status in ("ok", "usable", "doubtful")
    found = ablations.outcome("systems", "double_well, large library")
    assert found.status in ("ok", "usable", "doubtful")


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


# --------------------------------------------------- figures of the first minute: benchmarks.run first-minute
def test_the_core_install_is_what_the_package_needs_without_extras(project):
    found = {distribution.name.lower() for distribution in run.core_distributions()}
    required = {re.match(r"[\w-]+", line)[0].lower() for line in project["project"]["dependencies"]}
    assert required | {"leastaction", "mpmath", "markupsafe"} <= found  # two that others need
    assert not found & {"nicegui", "pandas", "matplotlib", "pytest", "packaging"}
    size, with_bytecode = (values[0] for _, values in run.installed())
    assert 100.0 < size <= with_bytecode < 350.0


def test_a_figure_is_the_median_beside_its_limit():
    row = run.figure_row("leastaction --help, ms", [121.0, 90.0, 95.0])
    assert " ".join(row.split()) == "leastaction --help, ms 95 limit 100 90 to 121 in 3"
    assert "limit" not in run.figure_row("leastaction demo, s", [10.0])


def test_figures_of_pages_are_left_out_without_a_browser(monkeypatch, tmp_path):
    monkeypatch.setattr(page_helpers, "chromium", lambda: None)
    rows = [run.figure_row(name, values) for name, values in run.pages(tmp_path / "report.html")]
    assert len(rows) == 3
    assert all("left out: needs Chromium" in row for row in rows)


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


# ---------------- modules that are loaded on first use: systems of python-control, units, late forces
needs_control = pytest.mark.skipif(control is None, reason="python-control is not installed")


@needs_control
@pytest.mark.parametrize("name", MODELS)
def test_dynamics_are_those_of_the_model(name):
    model = MODELS[name]()
    system = la.control.state_space(model, name="found")
    assert system.name == "found"
    for q, v, f in states(model):
        rates = system.dynamics(0.0, np.concatenate([q, v]), f)
        np.testing.assert_array_equal(rates, np.concatenate([v, model.acceleration(q, v, f)]))
        np.testing.assert_array_equal(system.output(0.0, np.concatenate([q, v]), f), np.concatenate([q, v]))


@needs_control
def test_labels_and_actuated_coordinates():
    model = MODELS["driven"]()
    system = la.control.state_space(model, actuated=["theta2"])
    assert system.input_labels == ["theta2_force"]
    assert system.state_labels == system.output_labels == ["theta1", "theta2", "theta1_dot", "theta2_dot"]
    x = np.array([0.3, 0.1, -0.2, 0.5])
    expected = model.acceleration(x[:2], x[2:], [0.0, 1.5])
    np.testing.assert_array_equal(system.dynamics(0.0, x, [1.5])[2:], expected)


@needs_control
def test_response_is_the_simulation():
    model = MODELS["driven"]()
    t = np.linspace(0.0, 2.0, 201)
    push = np.column_stack([np.sin(3.0 * t), 0.5 * np.cos(2.0 * t)])
    tight = {"rtol": 1e-10, "atol": 1e-10}
    response = control.input_output_response(
        la.control.state_space(model), t, push.T, [0.5, -0.3, 0.0, 0.0], solve_ivp_kwargs=tight
    )
    # The package joins the samples of the input by straight lines.
    straight = lambda time: np.array([np.interp(time, t, column) for column in push.T])  # noqa: E731
    run = model.simulate([0.5, -0.3], [0.0, 0.0], t, straight)
    np.testing.assert_allclose(response.outputs.T, np.hstack([run.q, run.qdot]), atol=1e-5)


def differences(model, q, qdot, forces):
    """A and B by central differences of the acceleration."""
    n = model.n_dof
    rates = lambda z: model.acceleration(z[:n], z[n : 2 * n], z[2 * n :])  # noqa: E731
    slopes = finite_difference(rates, np.concatenate([q, qdot, forces]), 1e-3)
    a = np.vstack([np.eye(2 * n)[n:], slopes[:, : 2 * n]])
    return a, np.vstack([np.zeros((n, n)), slopes[:, 2 * n :]])


@needs_control
@pytest.mark.parametrize("name", ["driven", "passive", "chaotic", "magnetic", "swapped"])
def test_linearisation_agrees_with_finite_differences(name):
    model = MODELS[name]()
    for q, v, f in states(model):
        system = la.control.linearize(model, q, v, f)
        a, b = differences(model, q, v, f)
        np.testing.assert_allclose(system.A, a, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(system.B, b, rtol=1e-6, atol=1e-6)


@needs_control
@pytest.mark.parametrize("q", [[0.0, 0.0], [np.pi, 0.0], [np.pi, np.pi]])
def test_linearisation_at_the_equilibria_of_the_double_pendulum(q):
    model = MODELS["driven"]()
    system = la.control.linearize(model, q, actuated=["theta1"])
    assert np.abs(model.acceleration(q, [0.0, 0.0])).max() < 1e-12
    a, b = differences(model, np.array(q), np.zeros(2), np.zeros(2))
    np.testing.assert_allclose(system.A, a, atol=2e-5)
    np.testing.assert_allclose(system.B, b[:, :1], atol=1e-9)
    of_package = la.control.state_space(model, actuated=["theta1"]).linearize([*q, 0.0, 0.0], 0.0)
    np.testing.assert_allclose(system.A, of_package.A, atol=1e-4)
    assert system.input_labels == ["theta1_force"]
    assert (system.poles().real.max() < 0) == (q == [0.0, 0.0])


@needs_control
def test_feedback_found_on_the_linear_system_holds_the_nonlinear_one():
    """The use that the wrapper is made for: stand a cart's pendulum on its head."""
    terms = {"x_dot**2": 1.0, "theta_dot**2": 0.5, "x_dot*theta_dot*cos(theta)": 1.0, "cos(theta)": 9.81}
    model = LagrangianModel(["x", "theta"], [ModelTerm(k, c) for k, c in terms.items()])
    linear = la.control.linearize(model, [0.0, np.pi], actuated="x")
    gain = control.place(linear.A, linear.B, [-2.0, -2.5, -3.0, -3.5])
    target = np.array([0.0, np.pi, 0.0, 0.0])

    def force(time, state):
        return np.array([float((-gain @ (state - target))[0]), 0.0])

    state = target + np.array([0.05, 0.1, 0.0, 0.0])
    for _ in range(400):  # held over 20 ms, as a controller would
        push = force(0.0, state)
        run = model.simulate(state[:2], state[2:], [0.0, 0.02], lambda time, push=push: push)
        state = np.concatenate([run.q[-1], run.qdot[-1]])
    np.testing.assert_allclose(state, target, atol=1e-3)


@needs_control
def test_wrong_use():
    model = MODELS["driven"]()
    with pytest.raises(InputError, match="'theta3' is not a coordinate of the model; it has theta1, theta2"):
        la.control.state_space(model, actuated=["theta3"])
    with pytest.raises(InputError, match="expected a LagrangianModel"):
        la.control.state_space("model.json")
    with pytest.raises(InputError, match=r"q is .* expected 2 finite number"):
        la.control.linearize(model, [0.0])
    singular = LagrangianModel(["x", "y"], [ModelTerm("x**2*x_dot**2", 1.0), ModelTerm("y_dot**2", 1.0)])
    with pytest.raises(InputError, match=r"cannot be linearised at q = \[0.0, 0.0\].*singular"):
        la.control.linearize(singular, [0.0, 0.0])


# ----------------------------- units of coefficients against those known from physics, and what does not fit
CART = la.Library(
    ["x_dot**2", "theta_dot**2", "x_dot*theta_dot*cos(theta)", "x**2", "x", "cos(theta)"], ["x", "theta"]
)
SI = {"x": "m", "theta": "rad"}


def units(what, *args, **options):
    return {item.expression: item.unit for item in la.units.check(what, *args, **options)}


def same(text, other):
    """Whether two texts mean the same unit."""
    import pint

    registry = pint.UnitRegistry()
    return abs((1 * registry.Unit(text) / registry.Unit(other)).to("").magnitude - 1.0) < 1e-12


def test_mechanics_in_si():
    found = units(CART, SI)
    expected = {
        "x_dot**2": "kg",
        "theta_dot**2": "kg*m**2",
        "x_dot*theta_dot*cos(theta)": "kg*m",
        "x**2": "N/m",
        "x": "N",
        "cos(theta)": "J",
    }
    assert set(found) == set(expected)
    for expression, unit in expected.items():
        assert same(found[expression].replace("·", "*"), unit), expression


def test_the_units_of_the_data_are_kept():
    """In mm, N and ms no factor hides in a coefficient."""
    library = la.Library(["x_dot**2", "x**2", "sqrt(x**2+4)"], ["x"]).with_dissipation(
        ["x_dot**2/2", "abs(x_dot)"]
    )
    found = units(library, {"x": "mm"}, {"x": "N"}, time="ms")
    assert found == {
        "x_dot**2": "N·ms²/mm",
        "x**2": "N/mm",
        "sqrt(x**2+4)": "N",
        "x_dot**2/2": "N·ms/mm",
        "abs(x_dot)": "N",
    }


def test_model_with_a_scale_of_its_own():
    model = LagrangianModel(
        ["theta"],
        [ModelTerm("theta_dot**2", 1.0, known=True), ModelTerm("cos(theta)", 9.8, 0.1)],
        [ModelTerm("sqrt(theta_dot**2+9/10000)", 0.2, 0.01)],
    )
    # L over half the inertia: the coefficient of the cosine is 2 g / l, that of Coulomb friction alike.
    found = la.units.check(model, {"theta": "rad"}, energy="rad**2/s**2")
    assert [(item.kind, item.unit) for item in found] == [
        ("lagrangian", "1"),
        ("lagrangian", "1/s²"),
        ("dissipation", "1/s²"),
    ]
    assert found[0].expression == "theta_dot**2"


def test_numbers_that_are_added_fit():
    library = la.Library(
        ["sqrt(x_dot**2+0.01)", "log(1+theta**2)", "(x+1)**2", "exp(-theta)"], ["x", "theta"]
    )
    assert units(library, SI)["(x+1)**2"] == units(CART, SI)["x**2"]


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (
            "cos(x)",
            r"cos\(x\): the argument x has the unit m; expected a pure number: measure it in units of",
        ),
        ("exp(-x)", r"exp\(-x\): the argument -x has the unit m"),
        ("log(x**2)", r"the argument .* has the unit m"),
        ("cos(theta_dot)", r"the argument theta_dot has the unit 1/s"),
        ("sin(theta*x)", r"has the unit m"),
        ("log(1+x**2)", r"has the unit m²"),
        (
            "(x+theta)**2",
            r"adds (theta \(1\) and x \(m\)|x \(m\) and theta \(1\)); what is added must have one unit",
        ),
    ],
)
def test_terms_that_make_no_sense(term, message):
    library = la.Library(["x_dot**2", term], ["x", "theta"])
    with pytest.raises(InputError, match=message):
        la.units.check(library, SI)
    # In units of a length of the system the same terms are right.
    assert len(la.units.check(library, {"x": "1", "theta": "1"}, time="1", energy="1")) == 2


def test_degrees_are_refused():
    with pytest.raises(InputError, match=r"theta has the unit (deg|°); functions take radians"):
        la.units.check(CART, {"x": "m", "theta": "degree"})
    with pytest.raises(InputError, match="functions take radians"):
        la.units.check(CART, {"x": "m", "theta": "turn"})


def test_forces_have_to_agree_with_the_energy():
    assert units(CART, SI, {"x": "N", "theta": "N*m"}) == units(CART, SI, {"x": "N"})
    for forces, energy, message in [
        (
            {"x": "N", "theta": "N"},
            None,
            "the force on theta in N times theta is N, not force times coordinate",
        ),
        ({"x": "N", "theta": "N*mm"}, None, "but for a factor"),
        ({"x": "N"}, "mJ", "is N·m, not the energy in mJ, but for a factor"),
        ({"x": "N*m"}, "J", "not the energy in J; check the units"),
    ]:
        with pytest.raises(InputError, match=message):
            la.units.check(CART, SI, forces, energy=energy)


@pytest.mark.parametrize(
    "text",
    [
        "",
        " ",
        "meters!",
        "foo",
        "m**99**99",
        "2**2**9",
        "(9)**9",
        "m**(2)",
        "10000*m",
        "__import__('os')",
        "m;s",
        "m" * 200,
        3,
        None,
        "m**-",
        "kg*(m",
        "lambda: 1",
        "nan",
        "9**9*m",
    ],
)
def test_texts_that_are_no_units(text):
    with pytest.raises(InputError, match="the unit of x is") as caught:
        la.units.check(CART, {"x": text, "theta": "rad"})
    assert "\n" not in str(caught.value)


def test_bad_arguments(monkeypatch):
    with pytest.raises(InputError, match="the unit of theta is missing"):
        la.units.check(CART, {"x": "m"})
    with pytest.raises(InputError, match="'phi' is not a coordinate"):
        la.units.check(CART, SI | {"phi": "rad"})
    with pytest.raises(InputError, match="'y' is not a coordinate"):
        la.units.check(CART, SI, {"y": "N"})
    with pytest.raises(InputError, match="which is not a time"):
        la.units.check(CART, SI, time="m")
    with pytest.raises(InputError, match="pass a model or a Library"):
        la.units.check("x**2", SI)
    la.units._registry.cache_clear()
    monkeypatch.setitem(sys.modules, "pint", None)
    with pytest.raises(ImportError, match=r"pip install 'leastaction\[units\]'"):
        la.units.check(CART, SI)


# ----------------- the delay between coordinates and forces, on simulated delays and where it cannot be known
PENDULUM = ["theta_dot**2", "cos(theta)", "sin(theta)", "theta_dot**4"]


def pendulum(noise, seed=0):
    return la.systems.generate("single_pendulum", noise=noise, trials=2, duration=10.0, seed=seed)


@pytest.mark.parametrize("delay", [0.0, *(pytest.param(x, marks=pytest.mark.thorough) for x in (0.02, 0.05))])
@pytest.mark.parametrize(
    ("noise", "width"), [(0.01, 0.001), pytest.param(0.1, 0.008, marks=pytest.mark.thorough)]
)
def test_simulated_delays(delay, noise, width):
    recorded = shift_forces(pendulum(noise), -delay)
    found = estimate(recorded, PENDULUM)
    assert found.determined
    assert found.reason == ""
    assert 0.1 * width < found.standard_error < width
    assert abs(found.delay - delay) < 3.5 * found.standard_error
    assert {term.expression for term in found.model.terms} == {"theta_dot**2", "cos(theta)"}
    assert found.log_likelihood.max() == 0.0
    assert np.all(np.diff(found.delays) > 0)
    # The shifted data are those that a discovery needs.
    expected = shift_forces(recorded, found.delay)
    assert found.trajectories.digest() == expected.digest()
    assert f"{1e3 * found.delay:.3g} ±" in repr(found)


@pytest.mark.slow
def test_standard_error_covers_the_truth():
    """Eight data sets: the errors in units of their standard errors are of size one."""
    delays = np.linspace(-0.04, 0.04, 8)
    z = []
    for seed, delay in enumerate(delays):
        found = estimate(shift_forces(pendulum(0.02, seed), -delay), PENDULUM, max_delay=0.06)
        assert found.determined
        z.append((found.delay - delay) / found.standard_error)
    # The 99.9 % range of a mean of eight squares.
    assert 0.05 < np.mean(np.square(z)) < 3.3


@pytest.mark.thorough
def test_a_delay_beyond_the_range_is_not_believed():
    found = estimate(shift_forces(pendulum(0.01), -0.08), PENDULUM, max_delay=0.05)
    assert not found.determined
    assert "raise max_delay" in found.reason
    assert found.standard_error == np.inf
    assert "not determined" in repr(found)


def test_a_constant_force_tells_nothing(rng):
    """The honest answer to a flat likelihood; the data come back as they were."""
    model = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
    t = np.arange(0.0, 8.0, 0.01)
    motion = model.simulate([1.0], [0.0], t, forces=lambda _: np.array([0.7])).q
    noisy = motion + 0.01 * rng.standard_normal(motion.shape)
    data = la.Trajectories([la.Trajectory(t, noisy, np.full_like(noisy, 0.7), ["x"])])
    found = estimate(data, ["x_dot**2", "x**2", "x**4"])
    assert not found.determined
    assert "hardly depends on it" in found.reason
    assert np.ptp(found.log_likelihood) < 4.0
    assert found.trajectories.digest() == data.digest()


@pytest.mark.thorough
def test_a_periodic_force_fits_at_several_delays(rng):
    model = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -20.0)])
    t = np.arange(0.0, 4.0, 0.005)

    def force(time):
        return 200.0 * np.sin(2 * np.pi * np.asarray(time) / 0.15)

    motion = model.simulate([0.1], [0.0], t, forces=lambda time: np.array([force(time)])).q
    noisy = motion + 0.001 * rng.standard_normal(motion.shape)
    data = la.Trajectory(t, noisy, force(t)[:, np.newaxis], ["x"])
    found = estimate(data, ["x_dot**2", "x**2"], max_delay=0.2)
    assert not found.determined
    assert "explain the data alike" in found.reason
    one_period = estimate(data, ["x_dot**2", "x**2"], max_delay=0.06)
    assert one_period.determined
    assert abs(one_period.delay) < 4.0 * one_period.standard_error


def test_bad_arguments_of_delays():
    data = pendulum(0.01)
    for wrong in (0.0, -0.1, np.nan, True):
        with pytest.raises(InputError, match="max_delay is"):
            estimate(data, PENDULUM, max_delay=wrong)
    with pytest.raises(DataError, match=r"the shortest trial has 10 s.*at most 1.2 s"):
        estimate(data, PENDULUM, max_delay=2.0)
    passive = [la.Trajectory(run.t, run.q, None, run.coordinates) for run in data]
    with pytest.raises(DataError, match="no force acts"):
        estimate(passive, PENDULUM, {"theta_dot**2": 0.5})


def test_shifted_forces_are_those_of_another_time():
    t = np.sort(np.r_[0.0, 2.0, np.linspace(0.003, 1.997, 200)])
    forces = np.column_stack([np.sin(3 * t), np.zeros(t.size)])
    q = np.column_stack([t, -t])
    runs = la.Trajectories(
        [la.Trajectory(t, q, forces, ["a", "b"], "driven"), la.Trajectory(t, q, None, ["a", "b"])]
    )
    for delay in (0.0, 0.13, -0.13):
        shifted = shift_forces(runs, delay)
        assert shifted.names == ("driven", "1")
        there = shifted[0].t
        np.testing.assert_allclose(shifted[0].forces[:, 0], np.sin(3 * (there - delay)), atol=1e-6)
        np.testing.assert_array_equal(shifted[0].q[:, 0], there)
        assert shifted[1].forces is None
        assert there[0] >= max(delay, 0.0)
        assert there[-1] <= 2.0 + min(delay, 0.0)
    cut = shift_forces(runs, 0.05, margin=0.2)
    assert cut[0].t[0] >= 0.2
    assert cut[0].t[-1] <= 1.8
    with pytest.raises(InputError, match="leaves nothing of trial 'driven'"):
        shift_forces(runs, 5.0)
    with pytest.raises(InputError, match="expected a finite number"):
        shift_forces(runs, np.nan)
