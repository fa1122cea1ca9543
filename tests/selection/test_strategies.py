"""Steps of a search: where shape parameters begin, and which of several equal laws is reported."""

from __future__ import annotations

import math

import numpy as np
import pytest

import leastaction as la
from helpers import findings_of, record
from leastaction import systems
from leastaction.cli.values import force_offsets
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.structure import Structure
from leastaction.library import Library
from leastaction.selection.likelihood_refinement import value
from leastaction.selection.search_state import Search, begin_search
from leastaction.selection.strategies import shape_start, shortest_form

# ---------------------------------------------------- shape_start: an anchor beside a generated library
ANCHOR = np.array([0.3, -0.4])
DISTANCE = "sqrt((x-{p})**2+(y-{r})**2)"


def acceleration(q, v, f):
    """A spring of rest length one about the anchor, and gravity."""
    away = q - ANCHOR
    distance = np.hypot(*away)
    return -4.0 * (distance - 1.0) * away / distance + np.array([0.0, -1.0])


@pytest.fixture(scope="module")
def search() -> Search:
    """Motions around the anchor, on all sides of it."""
    starts = [([1.6, 0.2], [0.3, 1.5]), ([-0.7, -1.1], [1.2, -0.6]), ([0.4, 1.2], [-1.3, 0.2])]
    data = record(acceleration, starts, ["x", "y"], duration=8.0, rate=40.0, noise=0.005, seed=4)
    q = np.concatenate([run.q for run in data])
    assert np.all((q.min(axis=0) < ANCHOR) & (q.max(axis=0) > ANCHOR))
    library = Library([*Library.mechanical(["x", "y"]), DISTANCE], ["x", "y"])
    return begin_search(build_problem(data, Request(library, {"x_dot**2": 0.5})))


@pytest.fixture(scope="module")
def started(search) -> Search:
    return shape_start.run(search)


@pytest.mark.thorough
def test_the_anchor_is_found_inside_the_data(started):
    found = started.problem.shape_values
    np.testing.assert_allclose([found["p"], found["r"]], ANCHOR, atol=0.05)


@pytest.mark.thorough
def test_every_problem_of_the_search_has_the_numbers(search, started):
    found = started.problem.shape_values
    assert started.searched.shape_values == found
    assert started.grid.problem.shape_values == found
    assert started.fit is None  # nothing was fitted yet
    texts = [term.text for term in started.problem.terms]
    assert texts.index(DISTANCE.format(p=found["p"], r=found["r"]).replace("--", "+")) == len(texts) - 1
    assert search.problem.shape_values != found  # values are not changed in place


@pytest.mark.thorough
def test_the_same_start_every_time(search, started):
    assert shape_start.run(search).problem.shape_values == started.problem.shape_values


def test_a_problem_without_shapes_is_left_alone():
    data = record(lambda q, v, f: -q, [([1.0], [0.0])], ["x"], duration=4.0, noise=0.01)
    plain = begin_search(build_problem(data, Request(["x_dot**2", "x**2"], {"x_dot**2": 0.5})))
    assert shape_start.run(plain) is plain
    assert plain.problem.ranges == {}


# ------------------------------------------- shape_start: candidates that differ in names alone
CENTRES, WIDTH = (-0.6, 0.9), 0.35
CENTRE = "1/sqrt((x-{{{}}})**2+{{h}}**2)"


def between_centres(q, v, f):
    """A mass in a bowl, and two centres that attract it."""
    return -q - sum((q - c) / ((q - c) ** 2 + WIDTH**2) ** 1.5 for c in CENTRES)


@pytest.mark.parametrize("noise", [0.002, pytest.param(0.02, marks=pytest.mark.thorough)])
def test_two_centres_are_found_together(noise):
    """One by itself goes between them, or to a sample whose noise explains all that is left."""
    starts = [([2.0], [0.0]), ([-1.9], [0.5]), ([0.1], [2.2]), ([0.6], [0.1]), ([-0.7], [1.2])]
    data = record(between_centres, starts, ["x"], duration=10.0, rate=60.0, noise=noise, seed=2)
    texts = ["x_dot**2", "x", "x**2", CENTRE.format("p"), CENTRE.format("q")]
    begun = begin_search(build_problem(data, Request(texts, {"x_dot**2": 0.5})))
    found = shape_start.places(begun)[0].values
    assert sorted((found["p"], found["q"])) == pytest.approx(CENTRES, abs=0.01 + noise)
    assert abs(found["h"]) == pytest.approx(WIDTH, abs=0.01 + noise)


def test_what_the_user_bounds_apart_keeps_its_bounds():
    """Ranges that differ say which is which."""
    data = record(between_centres, [([2.0], [0.0])], ["x"], duration=6.0, rate=40.0, noise=0.01)
    texts = ["x_dot**2", "x**2", CENTRE.format("p"), CENTRE.format("q")]
    request = Request(texts, {"x_dot**2": 0.5}, shapes={"p": (0.5, 1.5), "q": (-1.5, -0.2)})
    for point in shape_start.places(begin_search(build_problem(data, request))):
        assert 0.5 <= point.values["p"] <= 1.5
        assert -1.5 <= point.values["q"] <= -0.2


@pytest.mark.parametrize("size", [pytest.param(0.4, marks=pytest.mark.thorough), 1.2])
def test_candidates_of_two_kinds_are_found_together(size):
    """A centre by itself takes up what a wave does, and lies elsewhere."""
    starts = [([2.0], [0.0]), ([-1.9], [0.5]), ([0.1], [2.2])]

    def force(q, v, f):
        return -q - (q - 0.9) / ((q - 0.9) ** 2 + WIDTH**2) ** 1.5 - size * np.sin(4.0 * q)

    data = record(force, starts, ["x"], duration=8.0, rate=60.0, noise=0.005, seed=2)
    texts = ["x_dot**2", "x**2", CENTRE.format("p"), "cos({w}*x)"]
    found = shape_start.places(begin_search(build_problem(data, Request(texts, {"x_dot**2": 0.5}))))[0].values
    assert found["p"] == pytest.approx(0.9, abs=0.03)
    assert abs(found["w"]) == pytest.approx(4.0, abs=0.1)


# ------------------------------------------------- shortest_form: the fewest terms, then the shortest
SPHERICAL = systems.get("spherical_pendulum")
LAW = {"theta_dot**2", "cos(theta)", "phi_dot**2*sin(theta)**2"}
# the search knows cos 2θ and not sin² θ: earlier terms stay
LONG = ["theta_dot**2", "cos(theta)", "phi_dot**2", "phi_dot**2*cos(2*theta)", "phi_dot**2*sin(theta)**2"]


def library(texts: list[str], system=SPHERICAL) -> la.Library:
    """Some terms of the grammar in a sequence of our own."""
    grown = la.Library.symbolic(system.coordinates, system.angles)
    return grown.replace(terms=[grown[grown.index(text)] for text in texts])


@pytest.fixture(scope="module")
def data() -> la.Trajectories:
    return systems.generate(SPHERICAL, noise=0.02, trials=2, duration=6.0, seed=3)


def test_two_terms_that_are_one_are_written_as_one(data):
    model = la.discover(data, library(LONG))
    assert {term.expression for term in model.terms} == LAW
    assert all(
        abs(t.coefficient - SPHERICAL.lagrangian[t.expression]) < 4.5 * t.standard_error for t in model.terms
    )
    # the model is that of its own terms
    again = la.discover(data, library([*LONG[:2], LONG[-1]]))
    of = {term.expression: term for term in again.terms}
    for term in model.terms:
        assert term.coefficient == pytest.approx(
            of[term.expression].coefficient, abs=0.05 * term.standard_error
        )
        assert term.standard_error == pytest.approx(of[term.expression].standard_error, rel=0.02)
    assert model.fit.status == "ok"


def test_a_product_of_sines_is_two_cosines():
    """The arm on a turning base, its masses along the joints given: sin α sin β stands for two cosines."""
    texts = ["a_dot**2*cos(a-b)", "a_dot**2*cos(a+b)", "a_dot**2*sin(a)*sin(b)", "a_dot**2*cos(a)*cos(b)"]
    small = la.Library.symbolic(["a", "b"], ["a", "b"]).reduced()
    forms = {d.term.text: {t.text: c for c, t in d.combination} for d in small.dropped if d.combination}
    assert forms["a_dot**2*sin(a)*sin(b)"] == pytest.approx({texts[0]: 0.5, texts[1]: -0.5})
    assert forms["a_dot**2*cos(a)*cos(b)"] == pytest.approx({texts[0]: 0.5, texts[1]: 0.5})
    assert all(form.length is not None for form in small.dropped if form.combination)


def test_libraries_without_lengths_are_left_alone(data):
    setup = build_problem(data, Request(LONG, {}))
    search = begin_search(setup)
    fit = search.grid.fit(*_start(search))
    search = search.now(fit)
    assert shortest_form.run(search) is search


def test_the_candidates_stay_independent_and_the_value_rises(data):
    """In the place of a member is a form; what could be written before can be written still."""
    setup = build_problem(data, Request(library([*LONG, "phi_dot**2*cos(theta)**2"]), {}))
    search = begin_search(setup)
    search = search.now(search.grid.fit(*_start(search)))
    assert {form.term.text for form in search.problem.forms} == {
        "phi_dot**2*sin(theta)**2",
        "phi_dot**2*cos(theta)**2",
    }
    after = shortest_form.run(search)
    assert value(after.found) > value(search.found)
    assert {after.problem.terms[m].text for m in after.found.structure} == LAW
    assert len(after.problem.terms) == len(search.problem.terms)
    texts = [term.text for term in after.problem.terms]
    assert len(la.Library(texts, SPHERICAL.coordinates).reduced()) == len(texts)
    assert after.problem.surcharges.shape == after.problem.known.shape
    assert after.grid.problem is after.found.problem


def _start(search):
    """All candidates, from the smooth curve and what a fit without choice makes of them."""
    structure = Structure(search.problem.free)
    guess = {"theta_dot**2": 0.5, "cos(theta)": 9.81, "phi_dot**2": 0.25, "phi_dot**2*cos(2*theta)": -0.25}
    coefficients = np.array([guess.get(term.text, 0.0) for term in search.problem.terms])
    return structure, search.grid.start(
        structure, search.curve.control_points, coefficients, search.curve.noise_std
    )


# ------------------------------------------------------------------------------------------------ force_bias
TRUTH = {"theta_dot**2": 0.5, "cos(theta)": 9.81}


def biased(seed: int, size: float = 1.5):
    """A driven pendulum, the torque recorded without a bias that drifts, and that bias."""
    data = systems.generate("single_pendulum", noise=0.01, trials=3, duration=15.0, seed=seed)
    rng = np.random.default_rng(seed)
    runs, biases = [], []
    for run in data:
        bias = size * (rng.normal() + np.sin(2.0 * np.pi * run.t / rng.uniform(10, 20) + rng.uniform(0, 6)))
        runs.append(run.changed(forces=run.forces - bias[:, None]))
        biases.append(bias)
    return la.Trajectories(runs), biases


@pytest.fixture(scope="module")
def pendulum():
    return systems.compact_library("single_pendulum")


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.thorough)])
def test_a_drifting_bias_is_found_with_the_law(pendulum, seed):
    data, biases = biased(seed)
    model = la.discover(data, pendulum, force_offset={"theta": 2.5})
    assert model.fit.status == "ok", model.fit.warnings
    assert {t.expression for t in model.terms} == set(TRUTH)
    for term in model.terms:
        assert abs(term.coefficient - TRUTH[term.expression]) < 4.0 * term.standard_error
        assert term.coefficient == pytest.approx(TRUTH[term.expression], rel=0.03)
    found = model.diagnostics.force_offset["theta"]
    assert [f.shape for f in found] == [run.t.shape for run in data]
    error = np.sqrt(np.mean((np.concatenate(found) - np.concatenate(biases)) ** 2))
    assert error < 0.05 * np.std(np.concatenate(biases))
    (slow,) = findings_of(model, "slow-force")
    assert (slow.subject, slow.values["hardly_any"]) == (("theta",), False)
    assert 0.3 * error < slow.values["standard_error"] < 3.0 * error


@pytest.mark.thorough
def test_the_same_data_taken_at_their_word_are_doubtful(pendulum):
    assert la.discover(biased(3)[0], pendulum).fit.status == "doubtful"


def test_where_nothing_drifts_nothing_is_found(pendulum):
    data, _ = biased(3, size=0.0)
    plain, followed = (
        la.discover(data, pendulum),
        la.discover(data, pendulum, force_offset={"theta": 2.5}),
    )
    assert {t.expression for t in plain.terms} == {t.expression for t in followed.terms}
    for a, b in zip(plain.terms, followed.terms, strict=True):
        assert b.coefficient == pytest.approx(a.coefficient, abs=a.standard_error)
    assert [finding.values["hardly_any"] for finding in findings_of(followed, "slow-force")] == [True]
    pushes = np.sqrt(np.mean(np.concatenate([run.forces for run in data]) ** 2))
    assert np.abs(np.concatenate(followed.diagnostics.force_offset["theta"])).max() < 0.03 * pushes


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"phi": 3.0}, "names 'phi', which is not a coordinate"),
        ({"theta": 0.0}, "expected the seconds"),
        ({"theta": "often"}, "expected the seconds"),
        ({"theta": math.nan}, "expected the seconds"),
    ],
)
def test_what_cannot_be_meant_is_refused(pendulum, given, message):
    with pytest.raises(ValueError, match=message):
        la.discover(biased(3)[0], pendulum, force_offset=given)


def test_the_papers_method_has_no_slow_forces(pendulum):
    with pytest.raises(ValueError, match="needs the default"):
        la.discover(biased(3)[0], pendulum, method="adam", force_offset={"theta": 2.5})


def test_infinite_seconds_mean_a_constant_force(pendulum):
    data, _ = biased(3, size=0.0)
    shifted = la.Trajectories([run.changed(forces=run.forces - 1.0) for run in data])
    for offset in ("theta", {"theta": math.inf}):
        model = la.discover(shifted, pendulum, force_offset=offset)
        assert {t.expression: t.coefficient for t in model.terms}["theta"] == pytest.approx(1.0, rel=0.02)


def test_command_line_notation():
    assert force_offsets("x") == {"x": math.inf}
    assert force_offsets("x, theta = 2.5") == {"x": math.inf, "theta": 2.5}
    with pytest.raises(la.InputError, match="finite number"):
        force_offsets("x=soon")
