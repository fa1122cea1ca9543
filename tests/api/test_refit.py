"""Structures of the trade-off curve as models: provisional at once, and fitted without a search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import leastaction as la
from helpers import DUFFING_LIBRARY, KINETIC, duffing, findings_of, record
from leastaction import DataError, InputError
from leastaction.model.diagnostics import PathPoint
from leastaction.model.term import ModelTerm
from leastaction.refit import provisional, refit


def free_terms(model: la.LagrangianModel) -> dict[tuple[str, str], tuple[float, float]]:
    """(Kind, expression) → coefficient and standard error."""
    groups = (("lagrangian", model.terms), ("dissipation", model.dissipation))
    return {
        (kind, t.expression): (t.coefficient, t.standard_error)
        for kind, terms in groups
        for t in terms
        if not t.known
    }


def assert_alike(model: la.LagrangianModel, other: la.LagrangianModel, errors: float) -> None:
    first, second = free_terms(model), free_terms(other)
    assert first.keys() == second.keys()
    for key, (value, error) in first.items():
        assert abs(value - second[key][0]) <= errors * error, key
        assert second[key][1] == pytest.approx(error, rel=0.05)


@pytest.fixture(scope="module")
def braked() -> la.LagrangianModel:
    """A driven pendulum, with one expression that is a candidate of L and of friction."""
    data = la.systems.generate("single_pendulum", noise=0.01, trials=2, duration=6.0, rate=50.0, seed=3)
    library = ["theta_dot**2", "cos(theta)", "cos(2*theta)", "theta_dot**2*cos(theta)"]
    friction = ["theta_dot**2", "theta_dot**4"]
    return la.discover(data, library, dissipation=friction)


@pytest.fixture(scope="module")
def sprung() -> la.LagrangianModel:
    return la.discover(duffing(), DUFFING_LIBRARY, KINETIC)


def test_a_point_knows_the_kind_and_the_numbers_of_its_terms(braked):
    """θ̇² is a candidate of L and of ψ here: its text alone does not say which."""
    kinds = set()
    for point in braked.diagnostics.path:
        free = free_terms(provisional(braked, point))
        keys = zip(point.kinds, point.expressions, strict=True)
        numbers = zip(point.coefficients, point.standard_errors, strict=True)
        assert free == dict(zip(keys, numbers, strict=True))
        kinds |= {kind for kind, expression in free if expression == "theta_dot**2"}
    assert kinds == {"lagrangian", "dissipation"}


def test_known_terms_stay_and_the_model_keeps_its_order(sprung):
    for point in sprung.diagnostics.path:
        model = provisional(sprung, point)
        assert [(t.expression, t.coefficient) for t in model.terms if t.known] == list(KINETIC.items())
        shared = [t.expression for t in model.terms if t.expression in {s.expression for s in sprung.terms}]
        assert shared == [s.expression for s in sprung.terms if s.expression in shared]
        assert model.fit.status == "doubtful"


def test_the_chosen_structure_comes_out_as_it_was(braked, sprung):
    for model in (braked, sprung):
        (chosen,) = (p for p in model.diagnostics.path if p.chosen)
        again = refit(model, chosen)
        assert_alike(model, again, 0.05)
        assert_alike(model, provisional(model, chosen), 0.05)
        assert again.fit.status == model.fit.status
        assert again.provenance["data"] == model.provenance["data"]
        assert again.provenance["structure"] == list(chosen.expressions)


def test_another_structure_is_as_a_search_for_its_terms_finds_it(sprung):
    point = next(p for p in sprung.diagnostics.path if p.n_terms == 3)
    model = refit(sprung, point)
    found = {t.expression: t for t in model.terms}
    # with the term that the data do not ask for held at its value a search keeps the others
    (extra,) = set(point.expressions) - {"x**2", "x**4"}
    held = {**KINETIC, extra: found[extra].coefficient}
    other = la.discover(duffing(), [*KINETIC, *point.expressions], held, relevance=0.0)
    compared = {t.expression: t for t in other.terms if not t.known}
    assert set(compared) == {"x**2", "x**4"}
    for expression, term in compared.items():
        assert abs(term.coefficient - found[expression].coefficient) < 0.05 * term.standard_error
    (finding,) = findings_of(model, "another-structure")
    assert finding.values["reason"] == point.reason == "not-worth-its-terms"
    assert "improve the fit by less than their penalty" in finding.message
    assert model.fit.status == "doubtful"
    assert model.diagnostics.path == sprung.diagnostics.path


def morse(q, v, f):
    """In L = ½ ẋ² + 4 e^(−0.8 x) − 2 e^(−1.6 x)."""
    return -3.2 * (np.exp(-0.8 * q) - np.exp(-1.6 * q))


MORSE = ["x_dot**2", "x", "x**2", "x**3", "exp(-{a}*x)", "exp(-2*{a}*x)"]
MORSE_KNOWN = {"x_dot**2": 0.5}


@pytest.fixture(scope="module")
def bound() -> la.LagrangianModel:
    """A law with a number inside two of its terms."""
    starts = [([2.2], [0.0]), ([1.3], [0.0]), ([0.0], [1.2])]
    data = record(morse, starts, ["x"], duration=8.0, rate=30.0, noise=0.01, seed=1)
    return la.discover(data, MORSE, MORSE_KNOWN)


def point_of(model: la.LagrangianModel, *written: str) -> PathPoint:
    return next(p for p in model.diagnostics.path if p.written == written)


def test_a_point_has_its_shape_parameters_by_name(bound):
    (found,) = bound.shapes
    kinds = set()
    for point in bound.diagnostics.path:
        held = any("{a}" in text for text in point.written)
        assert point.shapes == ((("a", found.value),) if held else ())
        assert all("{" not in text for text in point.expressions)
        model = provisional(bound, point)
        assert [(s.name, s.value) for s in model.shapes] == list(point.shapes)
        assert all(np.isnan(s.standard_error) for s in model.shapes)
        assert {t.written for t in model.terms if not t.known} == {*point.written}
        kinds.add(held)
    assert kinds == {True, False}


def test_shape_parameters_of_the_chosen_structure_come_out_as_they_were(bound):
    (chosen,) = (p for p in bound.diagnostics.path if p.chosen)
    again = refit(bound, chosen)
    assert [t.written for t in again.terms] == [t.written for t in bound.terms]
    numbers = [[*m.terms[1:], m.shapes[0].as_term()] for m in (bound, again)]
    for before, after in zip(*numbers, strict=True):
        assert abs(after.coefficient - before.coefficient) <= 0.1 * before.standard_error
        # of equations that hold this well, rounding decides which error they may have at most
        assert after.standard_error == pytest.approx(before.standard_error, rel=0.5)
    assert len(again.shapes[0].profile) > 8
    assert again.fit.status == bound.fit.status == "ok"
    assert again.provenance["structure"] == list(chosen.expressions)


def test_shape_parameters_of_another_structure_are_fitted_again(bound):
    """e^(−2ax) with a is what e^(−ax) is with 2a: from the same number both fits come to one law."""
    refitted = [refit(bound, point_of(bound, "x", text)) for text in ("exp(-2*{a}*x)", "exp(-{a}*x)")]
    doubled, single = (model.shapes[0] for model in refitted)
    assert abs(single.value - bound.shapes[0].value) > 10.0 * single.standard_error
    assert 2.0 * doubled.value == pytest.approx(single.value, abs=0.02 * single.standard_error)
    assert 2.0 * doubled.standard_error == pytest.approx(single.standard_error, rel=0.05)
    for model, shape in zip(refitted, (doubled, single), strict=True):
        (bearer,) = (t for t in model.terms if t.template)
        assert bearer.expression == bearer.template.replace("{a}", f"{shape.value:.12g}")
        assert model.covariance.shape == (3, 3)
        assert model.covariance[2, 2] == pytest.approx(shape.standard_error**2)


def test_bounds_of_shape_parameters_hold_in_a_refit():
    starts = [([2.2], [0.0]), ([1.3], [0.0]), ([0.0], [1.2])]
    data = record(morse, starts, ["x"], duration=8.0, rate=30.0, noise=0.01, seed=1)
    model = la.discover(data, MORSE, MORSE_KNOWN, shapes={"a": (0.5, 1.2)})
    again = refit(model, point_of(model, "x", "exp(-{a}*x)"))
    assert again.shapes[0].value == 1.2
    assert findings_of(again, "shape-at-bound")


def test_a_point_without_the_number_of_a_shape_parameter_says_so(bound):
    (chosen,) = (p for p in bound.diagnostics.path if p.chosen)
    strange = replace(chosen, templates=tuple(t.replace("{a}", "{b}") for t in chosen.templates))
    for function in (refit, provisional):
        with pytest.raises(InputError, match="no number for the shape parameter 'b'"):
            function(bound, strange)


def test_what_was_said_of_the_data_is_said_again():
    data = duffing()
    rng = np.random.default_rng(0)
    spoilt = []
    for run in data:
        q = run.q.copy()
        q[rng.integers(20, run.n_times - 20, 3)] += 5.0
        spoilt.append(run.changed(q=q))
    model = la.discover(spoilt, DUFFING_LIBRARY, KINETIC)
    assert findings_of(model, "outliers-left-out")
    again = refit(model, model.diagnostics.path[0])
    assert findings_of(again, "outliers-left-out") == findings_of(model, "outliers-left-out")


def test_friction_that_feeds_energy_in_is_left_out(sprung):
    point = PathPoint(
        ("x**2", "x**4", "x_dot**2"),
        0.0,
        0.0,
        reason="fits-worse",
        coefficients=(-1.0, -0.2, 0.0),
        standard_errors=(0.1, 0.1, 0.1),
        kinds=("lagrangian", "lagrangian", "dissipation"),
    )
    growing = [
        la.Trajectory(run.t, run.q * np.exp(0.02 * run.t)[:, None], coordinates=run.coordinates)
        for run in sprung.diagnostics.trajectories
    ]
    model = replace(sprung, diagnostics=replace(sprung.diagnostics, trajectories=la.Trajectories(growing)))
    again = refit(model, point)
    assert again.dissipation == ()
    assert [f.subject for f in findings_of(again, "negative-dissipation")] == [("x_dot**2",)]


def test_what_cannot_be_refitted_says_so(sprung, tmp_path):
    point = sprung.diagnostics.path[0]
    path = tmp_path / "model.json"
    sprung.save(path)
    with pytest.raises(InputError, match="no diagnostics"):
        refit(la.load(path), point)
    bare = PathPoint(("x**2",), 0.0, 0.0)
    for function in (refit, provisional):
        with pytest.raises(InputError, match="no coefficients"):
            function(sprung, bare)
    undefined = replace(point, expressions=("sqrt(x)",), coefficients=(1.0,), standard_errors=(1.0,))
    with pytest.raises(DataError, match="does not converge"):
        refit(sprung, replace(undefined, kinds=("lagrangian",)))
    potential = [ModelTerm("x**4", -0.2, known=True), ModelTerm("x**2", -0.5, 0.1)]
    massless = replace(sprung, terms=potential, covariance=None)
    with pytest.raises(DataError, match="cannot be solved"):
        refit(massless, replace(undefined, expressions=("x**2",), kinds=("lagrangian",)))
