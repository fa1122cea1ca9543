"""Profile likelihoods of shape parameters against fits of the same structure with the number held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import leastaction as la
from helpers import free_motions
from leastaction.estimation import profile
from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.weights import evidence


def _fitted(noise: float, terms: list[str], force, starts) -> Fit:
    """The fit whose profiles a model has."""
    held: list[Fit] = []
    real = profile.profiled
    runs = free_motions(force, starts, noise=noise)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("leastaction.api.profiled", lambda fit: (held.append(real(fit)), held[0])[1])
        model = la.discover(runs, ["x_dot**2", *terms], known={"x_dot**2": 0.5})
    assert [shape.profile for shape in model.shapes] == list(held[0].shapes.profiles)
    return held[0]


def _morse(x: float) -> float:
    return 6.0 * (np.exp(-2.4 * x) - np.exp(-1.2 * x))


@pytest.fixture(scope="module")
def morse() -> Fit:
    return _fitted(0.01, ["exp(-{a}*x)", "exp(-2*{a}*x)"], _morse, (0.5, 0.9, 1.3))


def test_it_is_a_parabola_where_the_data_are_many(morse):
    places, rise = np.array(morse.shapes.profiles[0]).T
    z = (places - morse.shapes.values[0]) / morse.shapes.standard_errors[0]
    assert z[0] < -2.0
    assert z[-1] > 2.0
    np.testing.assert_allclose(rise, z**2, atol=0.1)


def _held(fit: Fit, values: dict[str, float]) -> float:
    """The highest log likelihood with all numbers held, at the weights of a fit."""
    grid = fit.grid.posed(fit.problem.at(values))
    physics, index = grid.physics(fit.structure)
    start = fit.control_points, fit.problem.completed(fit.coefficients)[index]
    return evidence(
        grid.observations, fit_joint(grid.observations, physics, fit.weights, *start, tolerance=1e-4)
    )


def test_it_is_the_loss_of_likelihood_with_the_number_held():
    """The other number is found by trying many, without tangents."""
    terms = ["1/sqrt((x-{p})**2+{h}**2)"]
    fit = _fitted(0.05, terms, lambda x: -0.8 * x / (x * x + 0.09) ** 1.5, (0.25, 0.4))
    h, p = (fit.shapes.names.index(name) for name in "hp")
    near = fit.shapes.values[p] + np.linspace(-1.0, 1.0, 9) * fit.shapes.standard_errors[p]
    best = max(_held(fit, {"h": float(fit.shapes.values[h]), "p": float(x)}) for x in near)
    for place, rise in fit.shapes.profiles[h][:: len(fit.shapes.profiles[h]) - 1]:
        there = max(_held(fit, {"h": place, "p": float(x)}) for x in near)
        assert rise > 6.0
        assert 2.0 * (best - there) == pytest.approx(rise, abs=0.1)


def test_the_other_parameters_follow():
    """Where two numbers nearly make up for each other the profile is far below the cost of moving one."""
    terms = ["exp(-{a}*x)", "exp(-{b}*x)"]
    fit = _fitted(0.01, terms, _morse, (0.5, 0.9, 1.3))
    assert len(fit.shapes.names) == 2
    place, rise = fit.shapes.profiles[0][-1]
    alone = dict(zip(fit.shapes.names, fit.shapes.values.tolist(), strict=True)) | {
        fit.shapes.names[0]: place
    }
    other = fit.grid.posed(fit.problem.at(alone)).fit(fit.structure, fit.start)
    assert 2.0 * (fit.evidence - other.evidence) > 3.0 * rise


def test_nothing_is_profiled_where_errors_come_from_elsewhere(morse):
    bare = replace(morse, shapes=replace(morse.shapes, profiles=()))
    assert profile.profiled(replace(bare, covariance=2.0 * bare.covariance)).shapes.profiles == ()
    unsettled = replace(bare, shapes=replace(bare.shapes, settled=False))
    assert profile.profiled(unsettled).shapes.profiles == ()
    assert len(profile.profiled(bare).shapes.profiles) == 1
