"""Terms nobody wrote down: unknown numbers inside terms, and candidates grown from the coordinates' names."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

import leastaction as la
from helpers import findings_of, record
from leastaction import systems
from leastaction.cli import program
from leastaction.diagnosis.competing import rival_warnings
from leastaction.diagnosis.effects import Effects
from leastaction.errors import InputError
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Structure
from leastaction.estimation.shapes import fit_shapes
from leastaction.model.model import LagrangianModel
from leastaction.model.term import ModelTerm, ShapeParameter
from leastaction.report.captions import profile_title
from leastaction.selection.alternatives import Alternative
from leastaction.selection.search_state import begin_search
from leastaction.selection.strategies import shape_fit

DEPTH, RATE = 2.0, 0.8
LIBRARY = ["x_dot**2", "x", "x**2", "x**3", "exp(-{a}*x)", "exp(-2*{a}*x)"]
KNOWN = {"x_dot**2": 0.5}
TRUTH = {"x_dot**2": 0.5, "exp(-{a}*x)": 2 * DEPTH, "exp(-2*{a}*x)": -DEPTH}


def acceleration(q, v, f):
    return -2.0 * DEPTH * RATE * (np.exp(-RATE * q) - np.exp(-2.0 * RATE * q))


@pytest.fixture(scope="module")
def data():
    starts = [([2.2], [0.0]), ([1.3], [0.0]), ([0.0], [1.2])]
    return record(acceleration, starts, ["x"], duration=8.0, rate=30.0, noise=0.01, seed=1)


@pytest.fixture(scope="module")
def model(data):
    return la.discover(data, LIBRARY, known=KNOWN)


def test_law_and_number_are_found(model):
    assert model.fit.status == "ok", model.fit.warnings
    assert {term.written for term in model.terms} == set(TRUTH)
    for term in model.terms:
        assert abs(term.coefficient - TRUTH[term.written]) <= 4.0 * term.standard_error, term
    (rate,) = model.shapes
    assert rate.name == "a"
    assert abs(rate.value - RATE) <= 4.0 * rate.standard_error
    assert rate.standard_error < 0.02
    assert rate.lower < rate.value < rate.upper
    assert model.covariance.shape == (3, 3)
    np.testing.assert_allclose(model.covariance[2, 2], rate.standard_error**2)
    for code in ("shape-undetermined", "shape-at-bound", "shape-not-settled"):
        assert not findings_of(model, code)


def test_expressions_hold_the_number_and_templates_its_name(model):
    value = f"{model.shapes[0].value:.12g}"
    bearers = [term for term in model.terms if term.template]
    assert {term.template for term in bearers} == {"exp(-{a}*x)", "exp(-2*{a}*x)"}
    for term in bearers:
        assert term.expression == term.template.replace("{a}", value)


def test_a_file_keeps_shapes_and_templates(model, tmp_path):
    model.save(tmp_path / "model.json")
    again = la.load(tmp_path / "model.json")
    assert again.shapes == model.shapes
    assert again.terms == model.terms
    assert again.to_dict() == model.to_dict()
    np.testing.assert_array_equal(again.covariance, model.covariance)
    document = json.loads((tmp_path / "model.json").read_text(encoding="utf-8"))
    shape = model.shapes[0]
    assert document["shapes"] == [
        {
            "name": "a",
            "value": shape.value,
            "standard_error": shape.standard_error,
            "profile": [list(pair) for pair in shape.profile],
        }
    ]
    assert shape.lower == pytest.approx(shape.value - 1.96 * shape.standard_error, rel=1e-3)
    assert "template" not in document["terms"][0]


def test_it_reads_by_name(model):
    value = f"{model.shapes[0].value:.3f}"[:4]
    assert "*exp(-{a}*x)" in repr(model)
    assert f"{{a}} = {value}" in repr(model)
    table = model.format_table()
    assert "exp(-2*{a}*x)" in table
    assert any(line.split()[:2] == ["{a}", "shape"] for line in table.splitlines())
    frame = model.table()
    assert frame.index.tolist() == [*(term.written for term in model.terms), "{a}"]
    assert frame.loc["{a}", "kind"] == "shape"
    assert frame.loc["{a}", "coefficient"] == model.shapes[0].value
    latex = model.latex()
    assert "e^{- a x}" in latex
    assert f"a &= {value}" in latex
    html = model._repr_html_()
    assert "exp(-{a}*x)" in html


@pytest.mark.parametrize(
    ("template", "written"),
    [
        ("exp(-x*{a})", "e^{- a x}"),
        ("cos(x*{a})*x**2", r"x^{2} \cos{\left(a x \right)}"),
        ("x*{a}**2*cos({a}*x-{b})", r"a^{2} x \cos{\left(a x - b \right)}"),
        ("exp(-3*x*{a}/2)/(1+x**2*{a})", r"\frac{e^{- \frac{3 a x}{2}}}{a x^{2} + 1}"),
        ("2*x*(x-{b})**2", r"2 x \left(x - b\right)^{2}"),
    ],
)
def test_in_latex_numbers_come_before_coordinates(template, written):
    """Whatever the sequence in which a user wrote them; and nothing is multiplied out."""
    shapes = [ShapeParameter(name, 2.0, 0.1) for name in "ab" if f"{{{name}}}" in template]
    text = template.replace("{a}", "2.0").replace("{b}", "2.0")
    model = la.LagrangianModel("x", [ModelTerm(text, 1.0, template=template)], shapes=shapes)
    assert f"L &= {written} \\\\\n" in model.latex()


def test_it_simulates(model):
    coefficients = {term.written: term.coefficient for term in model.terms}
    one, two, rate = coefficients["exp(-{a}*x)"], coefficients["exp(-2*{a}*x)"], model.shapes[0].value

    def slope(t, state):
        force = -rate * (one * np.exp(-rate * state[0]) + 2 * two * np.exp(-2 * rate * state[0]))
        return [state[1], force]

    t = np.linspace(0.0, 10.0, 51)
    expected = solve_ivp(slope, (0.0, 10.0), [1.9, 0.1], t_eval=t, rtol=1e-11, atol=1e-11).y.T
    motion = model.simulate([1.9], [0.1], t, rtol=1e-11, atol=1e-11)
    assert motion.complete
    np.testing.assert_allclose(np.hstack([motion.q, motion.qdot]), expected, atol=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("names", ["ab", "ba"])
def test_terms_that_can_be_exchanged_have_rising_numbers(data, names):
    """Both exponentials of the law have a rate of their own; which is called a is no accident."""
    texts = [f"exp(-{{{name}}}*x)" for name in names]
    model = la.discover(data, ["x_dot**2", *texts], known=KNOWN)
    numbers = {shape.name: shape.value for shape in model.shapes}
    assert numbers == pytest.approx({"a": RATE, "b": 2 * RATE}, rel=0.1)
    weights = {term.written: term.coefficient for term in model.terms}
    assert weights["exp(-{a}*x)"] > 0.0 > weights["exp(-{b}*x)"]
    swapped = {"a": (0.7, 1.0), "b": (0.1, 10.0)}  # what the user bounds apart is no exchange
    bounded = la.discover(data, ["x_dot**2", *texts], known=KNOWN, shapes=swapped)
    assert {shape.name: shape.value for shape in bounded.shapes} == pytest.approx(numbers, rel=1e-3)


def test_a_bound_that_excludes_the_truth_is_named(data):
    model = la.discover(data, LIBRARY[:1] + LIBRARY[4:], known=KNOWN, shapes={"a": (0.9, 3.0)})
    assert model.fit.status == "doubtful"
    assert model.provenance["options"]["shapes"] == {"a": [0.9, 3.0]}
    (finding,) = findings_of(model, "shape-at-bound")
    assert finding.values["value"] == 0.9
    assert "widen the range" in str(finding)


# -------------------------------------------------------------------------------- bad input, old files
@pytest.mark.parametrize(
    ("library", "options", "message"),
    [
        (LIBRARY, {"shapes": {"b": (0, 1)}}, "shapes names 'b', which is not a shape parameter"),
        (LIBRARY, {"shapes": {"a": (1, 0)}}, "low < high"),
        (["x_dot**2", "x**2"], {"shapes": {"a": (0, 1)}}, "it has none"),
        (["x_dot**2", "{a}*x**2"], {}, r"\{a\} only scales the term"),
        (["x_dot**2", "exp(-{x}*x)"], {}, "'x' is the name of something else"),
    ],
)
def test_wrong_shapes_are_refused(data, library, options, message):
    with pytest.raises(la.InputError, match=message):
        la.discover(data, library, known=KNOWN, **options)


SCHEMA_2 = {
    "schema": 2,
    "coordinates": ["x"],
    "terms": [
        {"expression": "x_dot**2", "coefficient": 0.5, "standard_error": 0.0, "known": True},
        {"expression": "exp(-0.8*x)", "coefficient": 4.0, "standard_error": 0.1, "known": False},
    ],
    "dissipation": [],
    "noise_std": [0.01],
    "fit": {"status": "ok", "chi2_per_sample": 1.0, "physics_weight": [1.0], "findings": [], "warnings": []},
    "provenance": {},
    "covariance": [[0.01]],
}


def load(document, tmp_path):
    path = tmp_path / "m.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return la.load(path)


def without_statements(document: dict) -> dict:
    """As files were before they said what the findings leave of structure, equations and forecast."""
    fit = {name: value for name, value in document["fit"].items() if name != "statements"}
    return {**document, "fit": fit}


def test_a_file_without_shapes_still_loads(tmp_path):
    model = load(SCHEMA_2, tmp_path)
    assert model.shapes == ()
    assert [term.template for term in model.terms] == ["", ""]
    assert without_statements(model.to_dict()) == SCHEMA_2


def with_shape(**changes) -> dict:
    term = {**SCHEMA_2["terms"][1], "template": "exp(-{a}*x)"}
    shapes = [{"name": "a", "value": 0.8, "standard_error": 0.01}]
    return {**SCHEMA_2, "terms": [SCHEMA_2["terms"][0], term], "covariance": [[0.01, 0], [0, 1e-4]]} | {
        "shapes": shapes,
        **changes,
    }


def test_a_file_with_a_shape_loads(tmp_path):
    model = load(with_shape(), tmp_path)
    assert model.shapes == (ShapeParameter("a", 0.8, 0.01),)
    assert load(with_shape(shapes=[{"name": "a", "value": 0.8, "standard_error": None}]), tmp_path).shapes


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shapes": []}, "every shape parameter of the templates once"),
        ({"shapes": [{"name": "b", "value": 0.8, "standard_error": None}]}, "shapes has b"),
        ({"shapes": [{"name": "a", "value": 0.8, "standard_error": None}] * 2}, "shapes has a, a"),
        ({"shapes": [{"name": "a", "value": "0.8", "standard_error": None}]}, r"shapes\[0\]"),
        ({"shapes": [{"name": "a", "value": 0.8, "standard_error": -1.0}]}, r"shapes\[0\]"),
        ({"shapes": [{"name": "1a", "value": 0.8, "standard_error": None}]}, r"shapes\[0\]"),
        ({"shapes": [{"name": "a", "value": 0.8}]}, "standard_error"),
        ({"shapes": {}}, "shapes"),
        ({"shapes": [{"name": "a", "value": 0.8, "standard_error": None, "profile": 1}]}, "pairs of numbers"),
        ({"shapes": [{"name": "a", "value": 0.8, "standard_error": None, "profile": [[1]]}]}, "pairs"),
        ({"covariance": [[0.01]]}, "covariance"),
    ],
)
def test_wrong_files_are_refused(changes, message, tmp_path):
    with pytest.raises(la.InputError, match=message):
        load(with_shape(**changes), tmp_path)


def test_a_template_must_be_readable(tmp_path):
    document = with_shape()
    document["terms"][1]["template"] = "exp(-{a}*"
    with pytest.raises(la.InputError):
        load(document, tmp_path)
    with pytest.raises(la.InputError, match="template"):
        ModelTerm("exp(-0.8*x)", 1.0, template=3)  # type: ignore[arg-type]


def test_the_interval_is_that_of_the_profile(tmp_path):
    """An even one gives that of the standard error; one that is cut off counts on its other side only."""
    even = tuple((0.8 + 0.01 * z, z * z) for z in (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0))
    plain, shaped = ShapeParameter("a", 0.8, 0.01), ShapeParameter("a", 0.8, 0.01, even)
    assert (shaped.lower, shaped.upper) == (pytest.approx(plain.lower), pytest.approx(plain.upper))
    cut = ShapeParameter("a", 0.8, 0.01, [(0.79, 0.5), (0.8, 0.0), (0.85, 4.0)])
    assert cut.lower == plain.lower
    assert cut.upper == pytest.approx(0.8 + 0.05 * 1.959964 / 2.0)
    assert (cut.as_term().lower, cut.as_term().upper) == (cut.lower, cut.upper)
    document = with_shape()
    document["shapes"][0]["profile"] = [list(pair) for pair in cut.profile]
    model = load(document, tmp_path)
    assert model.shapes == (cut,)
    assert without_statements(model.to_dict()) == document


@pytest.mark.parametrize(
    "profile",
    [3, ["ab"], [(1.0,)], [(1.0, 2.0, 3.0)], [(1.0, -0.5)], [(1.0, np.nan)], [(2.0, 0.0), (1.0, 1.0)]],
)
def test_a_profile_is_checked(profile):
    with pytest.raises(la.InputError, match="profile"):
        ShapeParameter("a", 1.0, 0.1, profile)


@pytest.mark.parametrize(
    ("name", "value", "error"), [("", 1.0, 0.1), ("a b", 1.0, 0.1), ("a", np.inf, 0.1), ("a", 1.0, -0.1)]
)
def test_a_shape_parameter_checks_itself(name, value, error):
    with pytest.raises(la.InputError):
        ShapeParameter(name, value, error)


def test_the_report_draws_the_profile(model, tmp_path):
    page = la.write_report(model, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Profile likelihood of a" in page
    assert "is symmetric about every shape parameter" in page
    skewed = ShapeParameter("a", 1.0, 0.1, [(0.8, 3.9), (1.0, 0.0), (1.6, 4.0)])
    assert profile_title([skewed]) == "The 95 % interval of a extends 3.0 times as far up as down"


# ------------------------------------------------- the time in terms, at known and unknown frequencies
FREQUENCY = 3.217
FORCED = {"x_dot**2": 0.5, "x**2": -0.5, "x**4": -0.125}


def forced(begins, noise, *, frequency=FREQUENCY, duration=16.0, seed=1):
    """Duffing oscillators pushed by 0.8 cos(wt), recorded from different times of one clock."""
    rng, out = np.random.default_rng(seed), []
    for x0, begin in begins:
        t = begin + np.linspace(0.0, duration, int(30 * duration) + 1)

        def rates(time, state):
            return [state[1], -state[0] - 0.5 * state[0] ** 3 + 0.8 * np.cos(frequency * time)]

        x = solve_ivp(rates, (t[0], t[-1]), [x0, 0.0], t_eval=t, rtol=1e-10, atol=1e-10).y[0]
        out.append(la.Trajectory(t, x + noise * x.std() * rng.normal(size=t.size), coordinates=["x"]))
    return la.Trajectories(out)


BEGINS = [(1.0, 0.0), (0.3, 5.0)]
CANDIDATES = ["x_dot**2", "x", "x**2", "x**3", "x**4", "t*x"]


def test_a_known_frequency_is_exact_without_noise():
    waves = [f"{f}*{wave}(3.217*t)" for f in ("x", "x**2") for wave in ("cos", "sin")]
    found = la.discover(forced(BEGINS, 0.0), [*CANDIDATES, *waves], KNOWN)
    assert found.fit.status == "ok", found.fit.warnings
    truth = {**FORCED, "x*cos(3.217*t)": 0.8}
    assert {t.expression: pytest.approx(t.coefficient, abs=1e-6) for t in found.terms} == truth


@pytest.fixture(scope="module")
def rocked():
    waves = ["x*cos({w}*t)", "x*sin({w}*t)"]
    return la.discover(forced(BEGINS, 0.01), [*CANDIDATES, *waves], KNOWN)


def test_an_unknown_frequency_is_found_without_a_start(rocked):
    assert rocked.fit.status == "ok", rocked.fit.warnings
    assert {t.written for t in rocked.terms} == {*FORCED, "x*cos({w}*t)"}
    for term in rocked.terms:
        truth = FORCED.get(term.written, 0.8)
        assert abs(term.coefficient - truth) <= 4.5 * term.standard_error
    (w,) = rocked.shapes
    assert abs(w.value - FREQUENCY) <= 4.5 * w.standard_error < 0.01 * FREQUENCY


def test_a_law_that_holds_the_time_is_saved_and_computes(rocked, tmp_path):
    path = tmp_path / "model.json"
    rocked.save(path)
    again = la.load(path)
    assert again.timed
    assert not LagrangianModel("x", [ModelTerm("x_dot**2", 0.5)]).timed
    t = np.linspace(7.0, 10.0, 4)
    truth = forced([(0.4, 7.0)], 0.0, duration=3.0)[0]
    run = again.simulate([0.4], [0.0], truth.t)
    assert run.complete
    assert np.abs(run.q - truth.q).max() < 0.01
    assert np.abs(again.simulate([0.4], [0.0], truth.t - 7.0).q - truth.q).max() > 0.1
    with pytest.raises(InputError, match="the law depends on time: give t"):
        again.acceleration([[0.4]], [[0.0]])
    with pytest.raises(InputError, match="t has shape \\(4,\\); expected \\(1,\\)"):
        again.acceleration([[0.4]], [[0.0]], t=t)
    expected = -0.4 - 0.5 * 0.4**3 + 0.8 * np.cos(FREQUENCY * t)
    found = again.acceleration(np.full((4, 1), 0.4), np.zeros((4, 1)), t=t)[:, 0]
    np.testing.assert_allclose(found, expected, atol=0.02)
    assert again.symmetries == ()
    equation = again.equations_of_motion()[0].rhs
    assert {str(s) for s in equation.free_symbols} == {"x", "t"}


def test_forecasts_follow_the_clock_of_the_trial(rocked):
    held = forced([(0.7, 2.3)], 0.01, seed=9)
    result = rocked.validate(held)
    assert np.all(result.rms < 2.0 * result.expected_rms)
    shifted = la.Trajectories([held[0].changed(t=held[0].t + 1.0)])
    assert np.all(rocked.validate(shifted).rms > 3.0 * result.rms)


def test_report_of_a_law_that_holds_the_time(rocked, tmp_path):
    text = Path(la.write_report(rocked, tmp_path / "report.html")).read_text(encoding="utf-8")
    assert "No balance: the law depends on time." in text


def test_frequencies_that_would_take_too_long_are_refused():
    with pytest.raises(InputError, match=r"needs more than 4000 start values .* near zero"):
        la.discover(forced([(1.0, 1.7e5)], 0.01, duration=4.0), [*CANDIDATES, "x*cos({w}*t)"], KNOWN)


@pytest.mark.thorough
def test_a_phase_is_found_with_its_frequency():
    data = forced([(1.0, 0.0)], 0.01)
    moved = la.Trajectory(data[0].t - 0.2, data[0].q, coordinates=["x"])
    lagrangian = ["x_dot**2", "x**2", "x**4", "x*cos({w}*t+{p})"]
    found = la.discover(moved, lagrangian, KNOWN, shapes={"w": (2.5, 4.0)})
    phase, w = found.shapes
    assert abs(w.value - FREQUENCY) <= 4.5 * w.standard_error
    turns = (phase.value - 0.2 * FREQUENCY) / np.pi
    assert abs(turns - round(turns)) * np.pi <= 4.5 * phase.standard_error


# ---------------------------------------------------------- discovery from the names of the coordinates alone
@pytest.mark.parametrize(
    "name", ["single_pendulum", pytest.param("cart_spring_pendulum", marks=pytest.mark.thorough)]
)
def test_the_law_is_found_from_names_alone(name, tmp_path):
    system = systems.get(name)
    data = systems.generate(name, noise=0.02, trials=2, duration=10.0, seed=4)
    library = la.Library.symbolic(system.coordinates, system.angles)
    model = la.discover(data, library, known=system.known)
    assert {term.expression for term in model.terms} == {
        library[library.index(text)].text for text in system.lagrangian
    }
    truth = {library.index(text): value for text, value in system.lagrangian.items()}
    for term in model.terms:
        error = 4.5 * term.standard_error
        assert term.coefficient == pytest.approx(truth[library.index(term.expression)], abs=error)
    assert model.fit.status == "ok"
    curve = model.diagnostics.pareto
    (chosen,) = (point for point in curve if point.chosen)
    lengths = [library.lengths[library.index(text)] for text in chosen.expressions]
    assert chosen.length == pytest.approx(sum(lengths) / np.log(2.0))
    assert len(curve) > 1
    assert all(a.length < b.length for a, b in pairwise(curve))
    assert all(a.cost > b.cost for a, b in pairwise(curve))
    model.save(tmp_path / "model.json")
    assert la.load(tmp_path / "model.json").to_dict() == model.to_dict()


@pytest.mark.thorough
def test_a_distance_to_an_unknown_point_grows_from_names_alone():
    """1/sqrt((x-0.6)**2+(y+0.3)**2+0.25) beside a spring: no plain term of the grammar can say it."""
    t, rng, runs = np.arange(0.0, 8.0, 0.02), np.random.default_rng(3), []

    def rates(_, state):
        x, y, u, v = state
        pull = ((x - 0.6) ** 2 + (y + 0.3) ** 2 + 0.25) ** -1.5
        return [u, v, -x - pull * (x - 0.6), -y - pull * (y + 0.3)]

    for start in ([1.2, 0.0, 0.0, 0.6], [-0.8, 0.5, 0.4, -0.3], [0.1, -1.0, -0.7, 0.2]):
        q = solve_ivp(rates, (0.0, t[-1]), start, t_eval=t, rtol=1e-10, atol=1e-10).y[:2].T
        runs.append(la.Trajectory(t, q + rng.normal(0.0, 2e-3, q.shape), coordinates=["x", "y"]))
    model = la.discover(runs, la.Library.symbolic(["x", "y"]), known={"x_dot**2": 0.5})
    assert model.fit.status == "ok", model.fit.warnings
    assert len(model.terms) == 5
    found = {shape.name: shape for shape in model.shapes}
    for name, truth in {"p": 0.6, "r": -0.3, "h": 0.5}.items():
        assert abs(abs(found[name].value) - abs(truth)) < 4.5 * found[name].standard_error


@pytest.mark.thorough
def test_exponentials_take_the_place_of_the_powers_that_imitate_them():
    """A Morse oscillator: powers to the sixth degree leave the exponentials little to gain beside them."""
    t, rng, runs = np.arange(0.0, 20.0, 0.02), np.random.default_rng(5), []

    def rates(_, state):
        x, v = state
        return [v, 7.2 * (np.exp(-2.4 * x) - np.exp(-1.2 * x))]

    for start in ([1.2, 0.0], [-0.4, 0.5], [0.1, 1.6], [0.6, -1.0]):
        x = solve_ivp(rates, (0.0, t[-1]), start, t_eval=t, rtol=1e-10, atol=1e-10).y[0]
        runs.append(la.Trajectory(t, x + rng.normal(0.0, 0.004, x.size), coordinates=["x"]))
    model = la.discover(runs, la.Library.symbolic("x"), known={"x_dot**2": 0.5})
    assert model.fit.status == "ok", model.fit.warnings
    (rate,) = model.shapes
    assert rate.value == pytest.approx(1.2, abs=4.5 * rate.standard_error)
    double, single = sorted((term for term in model.terms if not term.known), key=lambda t: t.coefficient)
    assert double.coefficient == pytest.approx(-3.0, abs=4.5 * double.standard_error)
    assert single.coefficient == pytest.approx(6.0, abs=4.5 * single.standard_error)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [21, 22])
def test_exponentials_take_the_place_of_a_whole_potential(seed):
    """A Morse molecule: beside r and r**2, exponentials of three times its rate explain noisy data best."""
    system = systems.get("morse_molecule")
    data = systems.generate("morse_molecule", noise=0.1, trials=5, duration=20.0, seed=seed)
    library = la.Library.symbolic(system.coordinates, system.angles)
    model = la.discover(data, library, known=system.known)
    assert model.fit.status == "ok", model.fit.warnings
    assert len(model.terms) == len(system.lagrangian)
    (rate,) = model.shapes
    assert rate.value == pytest.approx(1.0, abs=4.5 * rate.standard_error)


@pytest.mark.parametrize(
    ("term", "noise", "law"),
    [
        ("exp(-((x-{p})/{w})**2)", 0.05, {"exp(-((x-{p})/{w})**2)"}),
        pytest.param(  # near enough at this noise
            "log((x-{p})**2+{h}**2)",
            0.02,
            {"log((x-{p})**2+{h}**2)", "x**2"},
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_a_well_is_placed_beside_powers_that_resemble_it(term, noise, law):
    """Steep wells at the edge of the motion explain noise; three terms that are alike are all weak."""
    starts = [([1.2], [0.0]), ([0.4], [0.0]), ([0.0], [2.0])]
    options = {"duration": 8.0, "rate": 100.0, "noise": noise, "seed": 3}
    runs = record(lambda q, v, f: -6.0 * q * np.exp(-(q**2)), starts, ["x"], **options)
    model = la.discover(runs, ["x_dot**2", "x", "x**2", "x**3", "x**4", term], known=KNOWN)
    assert model.fit.status == "ok", model.fit.warnings
    assert {found.written for found in model.terms if not found.known} == law
    numbers = {shape.name: shape for shape in model.shapes}
    assert abs(numbers["p"].value) <= 4.0 * numbers["p"].standard_error


def test_a_wave_is_found_beside_powers_that_imitate_it():
    """Beside x**2, x**4 and x**6 every wavelength explains the motion; alone, only the true one does."""
    starts = [([0.7], [0.3]), ([-0.4], [0.6]), ([0.9], [-0.5])]
    options = {"duration": 8.0, "noise": 0.006, "seed": 4}
    runs = record(lambda q, v, f: -2.4 * np.sin(2.4 * q), starts, ["x"], **options)
    model = la.discover(runs, ["x_dot**2", "x**2", "x**4", "x**6", "cos({k}*x)"], known=KNOWN)
    assert {found.written for found in model.terms if not found.known} == {"cos({k}*x)"}
    (number,) = model.shapes
    assert abs(number.value - 2.4) <= 4.0 * number.standard_error


def test_an_exponent_that_ran_to_that_of_another_term_comes_back():
    """Near x**4, abs(x)**{n} and x**4 stand for x**4*log(abs(x)): both are large, and neither is weak."""
    starts = [([0.7], [0.3]), ([-0.4], [0.6]), ([0.9], [-0.5])]
    options = {"duration": 8.0, "noise": 0.006}
    runs = record(lambda q, v, f: -2.5 * np.sign(q) * np.abs(q) ** 1.5, starts, ["x"], **options)
    library = la.Library(["x_dot**2", "abs(x)**{n}", "x**2", "x**4"], ["x"])
    search = begin_search(build_problem(runs, Request(library, KNOWN))).at({"n": 3.9998})
    grid = Grid.lay(search.problem, 2.0 * search.grid.knots_per_second)
    structure, curve = Structure(search.problem.free.tolist()), grid.smooth()
    start = grid.start(structure, curve.control_points, np.zeros(4), curve.noise_std)
    trapped = fit_shapes(grid.fit(structure, start))
    assert np.abs(trapped.estimates).max() > 100.0
    found = shape_fit.run(search.now(trapped)).found
    assert [found.problem.terms[k].offered for k in found.structure] == ["abs(x)**{n}"]
    assert found.problem.shape_values["n"] == pytest.approx(2.5, abs=0.01)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 3])
def test_powers_that_make_up_for_one_another_are_dropped(seed):
    """Beside a wall, x**2 is the weakest of four: without it, x and x**3 would take its place for good."""
    options = {"duration": 10.0, "rate": 100.0, "noise": 0.02, "seed": seed}
    starts = [([1.0], [0.0]), ([0.1], [0.4]), ([0.4], [1.0])]
    runs = record(lambda q, v, f: 6.0 * np.exp(-3.0 * q) - 4.0 * q, starts, ["x"], **options)
    model = la.discover(
        runs, ["x_dot**2", "x", "x**2", "x**3", "x**4", "x**2*x_dot**2", "exp(-{a}*x)"], known=KNOWN
    )
    assert {found.written for found in model.terms if not found.known} == {"x**2", "exp(-{a}*x)"}
    (rate,) = model.shapes
    assert abs(rate.value - 3.0) <= 4.0 * rate.standard_error


@pytest.fixture(scope="module")
def small_motions():
    """Of a molecule that two exponentials and a polynomial of as many numbers describe equally well."""
    starts = [([0.6], [0.2]), ([-0.3], [0.6])]
    options = {"duration": 8.0, "rate": 50.0, "noise": 0.02, "seed": 1}
    return record(lambda q, v, f: -4.0 * (np.exp(-q) - np.exp(-2.0 * q)), starts, ["x"], **options)


SMALL = ["x_dot**2", "x**2", "x**3", "x**4", "exp(-{a}*x)", "exp(-2*{a}*x)"]


def test_laws_with_and_without_numbers_that_explain_as_much_compete(small_motions):
    model = la.discover(small_motions, SMALL, known=KNOWN)
    assert model.fit.status == "doubtful"
    rivals = findings_of(model, "competing-structures")
    assert {"x**2", "x**3", "x**4"} in [{*law} for f in rivals for law in (f.subject, f.values["others"])]


def test_a_law_in_play_is_named_with_its_numbers(small_motions):
    """A larger one is not in play, and neither is one whose numbers explain less."""
    search = begin_search(build_problem(small_motions, Request(la.Library(SMALL, ["x"]), KNOWN)))
    grid, curve = search.grid, search.grid.smooth()

    def fitted(members, a=1.0):
        posed, structure = grid.posed(grid.problem.at({"a": a})), Structure(members)
        return posed.fit(
            structure, posed.start(structure, curve.control_points, np.zeros(6), curve.noise_std)
        )

    plain, law = fitted([1, 2, 3]), fit_shapes(fitted([4, 5]))
    assert abs(plain.evidence - law.evidence) < 5.0
    (rival,) = rival_warnings(
        Effects(plain, np.ones(1), np.zeros(1)), [], [law, fitted([1, 4, 5]), fitted([4, 5], 3.0)]
    )
    assert rival.subject == ("x**2", "x**3", "x**4")
    number = law.problem.shape_values["a"]
    assert rival.values["others"] == (f"exp(-{number:.3g}*x)", f"exp(-2*{number:.3g}*x)")
    assert number == pytest.approx(1.0, abs=0.1)
    assert {*rival.values["at_names"]} == {"x", "x_dot"}


@pytest.mark.parametrize(
    ("reason", "named"),
    [("fit-is-better", True), ("not-fitted", True), ("fit-is-worse", False), ("no-fit", False)],
)
def test_a_larger_rival_is_named_unless_its_own_fit_refutes_it(small_motions, reason, named):
    """Far from the fit the quadratic model may promise any gain."""
    search = begin_search(build_problem(small_motions, Request(la.Library(SMALL, ["x"]), KNOWN)))
    grid, curve = search.grid.posed(search.grid.problem.at({"a": 1.0})), search.grid.smooth()
    structure = Structure([4, 5])
    fit = grid.fit(structure, grid.start(structure, curve.control_points, np.zeros(6), curve.noise_std))
    larger = Alternative(Structure([1, 2, 4]), -50.0, -20.0, fit.coefficients, np.ones(3), reason)
    found = rival_warnings(Effects(fit, np.ones(1), np.zeros(1)), [larger], [])
    assert [(f.subject, f.values["others"]) for f in found] == named * [
        (("exp(-2*{a}*x)",), ("x**2", "x**3"))
    ]


def test_what_is_undefined_along_the_data_is_left_out_and_said():
    data = systems.generate("double_well", noise=0.01, trials=2, duration=8.0, seed=2)
    assert min(run.q.min() for run in data) < 0.0
    library = la.Library.symbolic("x").with_dissipation(list(systems.get("double_well").dissipation))
    model = la.discover(data, library)
    (left,) = findings_of(model, "undefined-candidates")
    assert left.subject == ("1/x", "log(x)", "sqrt(x)", "1/x**2")
    assert left.severity == "note"


def test_a_known_term_that_is_undefined_is_still_an_error():
    t = np.arange(0.0, 8.0, 0.02)
    data = la.Trajectory(t, np.cos(t), coordinates=["x"])
    with pytest.raises(la.DataError, match=r"sqrt\(x\) is undefined somewhere along the data"):
        la.discover(data, la.Library.symbolic("x"), known={"sqrt(x)": 1.0})


def test_on_the_command_line(tmp_path):
    data = systems.generate("single_pendulum", noise=0.01, trials=2, duration=6.0, seed=1)
    la.write_csv(tmp_path / "run.csv", data)
    options = [
        "--coordinates",
        "theta",
        "--angles",
        "theta",
        "--forces",
        "theta_force",
        "--library",
        "symbolic",
    ]
    where = ["--output", str(tmp_path / "out")]
    result = CliRunner().invoke(program, ["discover", str(tmp_path / "run.csv"), *options, *where])
    assert result.exit_code == 0, result.output
    model = la.load(tmp_path / "out" / "model.json")
    assert [term.expression for term in model.terms] == ["theta_dot**2", "cos(theta)"]
    more = [*options, "--size", "large", *where]
    result = CliRunner().invoke(program, ["discover", str(tmp_path / "run.csv"), *more])
    assert result.exit_code == 2
    assert "--size goes with --library auto; neither a file nor symbolic has sizes" in result.output
