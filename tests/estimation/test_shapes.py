"""The joint fit of coefficients and shape parameters on a Morse potential, L = ½ẋ² − D (1 − exp(−a x))²."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers import interpolate, record, terms
from leastaction.diagnosis.shapes import doubts_about_shapes
from leastaction.estimation.fit import Fit, ShapeEstimate
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Problem
from leastaction.estimation.shape_ranges import ShapeRange
from leastaction.estimation.shapes import fit_shapes
from leastaction.estimation.structure import Structure
from leastaction.mechanics.euler_lagrange import EulerLagrange

DEPTH, RATE = 2.0, 0.8
MORSE = ["x_dot**2", "exp(-{a}*x)", "exp(-2*{a}*x)"]
TRUTH = np.array([0.5, 2 * DEPTH, -DEPTH])
FREE = ShapeRange(0.05, 5.0, "log")


@cache
def data(seed: int, noise: float):
    def acceleration(q, v, f):
        return -2.0 * DEPTH * RATE * (np.exp(-RATE * q) - np.exp(-2.0 * RATE * q))

    starts = [([1.6], [0.0]), ([0.5], [1.0])]
    return record(acceleration, starts, ["x"], duration=6.0, rate=30.0, noise=noise, seed=seed)


def plain_fit(at: float, seed: int = 0, noise: float = 0.01, where=FREE, texts=(), coefficients=None) -> Fit:
    """A fit of the coefficients with the rate held."""
    put = [term.at({"a": at, "b": at}) for term in terms(texts or MORSE, ["x"])]
    known = np.full(len(put), np.nan)
    known[0] = 0.5
    trajectories = data(seed, noise)
    grid = Grid.lay(
        Problem(trajectories, EulerLagrange(put, ["x"]), known, 5, ranges={"a": where, "b": FREE}), 5.0
    )
    curves = [lambda t, run=run: np.interp(t, run.t, run.q[:, 0])[:, None] for run in trajectories]
    control = interpolate(grid.spline, curves)
    members = Structure(range(1, len(put)))
    truth = TRUTH if coefficients is None else np.asarray(coefficients)
    return grid.fit(members, grid.start(members, control, truth, np.array([max(noise, 1e-6)])))


def test_the_start_does_not_matter():
    there = fit_shapes(plain_fit(RATE))
    assert there.shapes is not None
    assert there.shapes.settled
    for start in (0.5, 1.15):
        fit = fit_shapes(plain_fit(start))
        assert fit.shapes is not None
        assert fit.shapes.names == ("a",)
        assert fit.shapes.settled
        apart = fit.shapes.values - there.shapes.values
        assert np.abs(apart) <= 0.05 * there.shapes.standard_errors
        np.testing.assert_array_less(np.abs(fit.estimates - there.estimates), 0.05 * there.standard_errors)
        np.testing.assert_allclose(fit.shapes.covariance, there.shapes.covariance, rtol=0.05)
        assert fit.problem.shape_values == {"a": pytest.approx(float(fit.shapes.values[0]))}


def test_exact_data_give_exact_numbers():
    fit = fit_shapes(plain_fit(0.7, noise=0.0))
    assert fit.shapes is not None
    assert fit.shapes.values == pytest.approx([RATE], rel=2e-3)
    np.testing.assert_allclose(fit.coefficients, TRUTH, rtol=5e-3)


def test_errors_cover_the_truth():
    """z of two coefficients and the rate over 12 noise seeds: about normal with unit spread."""
    z = []
    for seed in range(12):
        fit = fit_shapes(plain_fit(RATE, seed, 0.02))
        assert fit.shapes is not None
        off = np.concatenate([fit.estimates - TRUTH[1:], fit.shapes.values - RATE])
        z.append(off / np.sqrt(np.diag(fit.shapes.covariance)))
        np.testing.assert_array_equal(fit.covariance, fit.shapes.covariance[:2, :2])
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((rms > 0.5) & (rms < 1.6)), rms
    assert np.abs(np.mean(z, axis=0)).max() < 1.0


def test_free_numbers_widen_the_errors_of_coefficients():
    held = plain_fit(RATE)
    fit = fit_shapes(held)
    assert np.all(fit.standard_errors > held.standard_errors)


def test_a_bounded_number_ends_at_its_bound_and_says_so():
    fit = fit_shapes(plain_fit(1.2, where=ShapeRange(1.0, 2.0, "linear", bounded=True)))
    assert fit.shapes is not None
    assert fit.shapes.values.tolist() == [1.0]
    (finding,) = doubts_about_shapes(fit)
    assert finding.code == "shape-at-bound"
    assert finding.subject == ("a",)
    assert finding.values == {"value": 1.0, "low": 1.0, "high": 2.0}


def test_beside_a_number_at_its_bound_the_others_settle():
    """They end where they would with that number typed."""
    bounded = ShapeRange(0.9, 2.0, "linear", bounded=True)
    fit = fit_shapes(plain_fit(1.0, where=bounded, texts=["x_dot**2", "exp(-{a}*x)", "exp(-2*{b}*x)"]))
    typed = fit_shapes(plain_fit(1.0, texts=["x_dot**2", "exp(-0.9*x)", "exp(-2*{b}*x)"]))
    assert fit.shapes is not None
    assert typed.shapes is not None
    assert fit.shapes.settled
    assert fit.shapes.values[0] == 0.9
    assert fit.shapes.standard_errors[0] == 0.0
    assert abs(fit.shapes.values[1] - typed.shapes.values[0]) <= 0.05 * typed.shapes.standard_errors[0]
    np.testing.assert_allclose(fit.shapes.standard_errors[1], typed.shapes.standard_errors[0], rtol=0.05)
    assert [(d.code, d.subject) for d in doubts_about_shapes(fit)] == [("shape-at-bound", ("a",))]


def test_a_number_that_is_found_raises_no_doubt():
    assert doubts_about_shapes(fit_shapes(plain_fit(RATE))) == []
    assert doubts_about_shapes(plain_fit(RATE)) == []


def test_too_few_steps_are_not_settled():
    fit = fit_shapes(plain_fit(0.5), most_steps=1)
    assert fit.shapes is not None
    assert not fit.shapes.settled
    assert [d.code for d in doubts_about_shapes(fit)] == ["shape-not-settled"]


@pytest.mark.parametrize(
    ("error", "together", "codes", "partner"),
    [
        (0.01, 0.0, [], None),
        (2.0, 0.5, ["shape-undetermined"], ""),
        (2.0, 0.999999, ["shape-undetermined"], "exp(-0.8*x)"),
        (np.nan, 0.0, ["shape-undetermined"], ""),
    ],
)
def test_a_number_as_large_as_its_error_is_undetermined(error, together, codes, partner):
    fit = plain_fit(RATE)
    spread = np.array([1.0, 1.0, error])
    mixed = np.eye(3)
    mixed[0, 2] = mixed[2, 0] = together
    estimate = ShapeEstimate(("a",), np.array([RATE]), mixed * np.outer(spread, spread), True)
    found = doubts_about_shapes(replace(fit, shapes=estimate))
    assert [finding.code for finding in found] == codes
    if partner is not None:
        assert found[0].values["with_it"] == partner
        assert partner in found[0].remedy


def test_nothing_to_fit_gives_the_fit_back():
    put = ["x_dot**2", "exp(-0.8*x)", "exp(-1.6*x)"]
    fit = plain_fit(RATE, texts=put)
    assert fit_shapes(fit) is fit
