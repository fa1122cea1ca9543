"""Structures of the trade-off curve as models: provisional at once, and fitted without a search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import leastaction as la
from helpers import DUFFING_LIBRARY, KINETIC, duffing, findings_of
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
    assert "improve the fit by less than their price" in finding.message
    assert model.fit.status == "doubtful"
    assert model.diagnostics.path == sprung.diagnostics.path


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
