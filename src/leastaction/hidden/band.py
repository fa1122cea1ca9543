"""Posterior standard deviation of the coordinates of a fitted curve, and what a further sensor would add.

With the curve's block H of the normal matrix, its border C and the covariance Σ of the coefficients,

    cov(P) = H⁻¹ + H⁻¹C Σ CᵀH⁻¹,

so that the variance of q_i(t) = b(t)ᵀP_i needs the band of H⁻¹ and one solution for each coefficient.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leastaction.curve.bspline import SplineSpace
from leastaction.estimation.blocks import observe
from leastaction.estimation.elimination import BandedFactor, NormalEquations
from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.joint import linearise
from leastaction.estimation.recipes import Recipe

__all__ = ["curve_errors", "errors_with_sensor", "normal_of"]


def curve_errors(fit: Fit, coordinates: Sequence[int], times: Sequence[np.ndarray]) -> list[np.ndarray]:
    """(n_times, n_coordinates) standard deviations of the fitted curve, trajectory by trajectory.

    NaN in a trajectory whose normal matrix is not positive definite.
    """
    return [_errors_of(fit, k, list(coordinates), t) for k, t in enumerate(times)]


def _errors_of(fit: Fit, trial: int, coordinates: list[int], times: np.ndarray) -> np.ndarray:
    normal, space = normal_of(fit, trial), fit.grid.spline.spaces[trial]
    try:
        factor = BandedFactor.of(normal.rows)
    except np.linalg.LinAlgError:
        return np.full((times.size, len(coordinates)), np.nan)
    inverse, n_dof = factor.inverse_rows(), fit.control_points.shape[1]
    half = factor.forward(normal.border[:, 1:])
    follow = factor.backward(half).reshape(len(inverse), n_dof, -1)
    out = np.empty((times.size, len(coordinates)))
    for column, i in enumerate(coordinates):
        own = _band(space, inverse[:, i, i::n_dof], times)
        first, basis = space.local_basis(times, 0)
        slope = np.einsum("ta,tak->tk", basis, follow[first[:, None] + np.arange(basis.shape[1]), i])
        out[:, column] = own + np.einsum("tk,kl,tl->t", slope, fit.covariance, slope)
    return np.sqrt(np.clip(out, 0.0, None))


def _band(space: SplineSpace, inverse: np.ndarray, times: np.ndarray) -> np.ndarray:
    """b(t)ᵀ H⁻¹ b(t), from the rows of H⁻¹ from each control point on."""
    first, basis = space.local_basis(times, 0)
    out, width = np.zeros(times.size), basis.shape[1]
    for a in range(width):
        for d in range(width - a):
            out += (2.0 if d else 1.0) * basis[:, a] * basis[:, a + d] * inverse[first + a, d]
    return out


def errors_with_sensor(fit: Fit, coordinate: int) -> np.ndarray:
    """(n_members,) standard errors of the coefficients, had a hidden coordinate been measured.

    Its samples are those of the fitted curve, at all times, with noise of the same share of the spread as
    that of the other coordinates (median). Weights of the equations stay as they are.
    """
    data = fit.problem.trajectories
    curves = list(fit.curves())
    spread = np.sqrt(np.mean([np.var(curve, axis=0) for curve in curves], axis=0))
    noise = fit.weights.noise_std.copy()
    noise[coordinate] = float(np.nanmedian(fit.position_std / spread)) * spread[coordinate]
    own = np.arange(data.n_dof) == coordinate
    values = [np.where(own, curve, t.q) for t, curve in zip(data, curves, strict=True)]
    seen = observe(fit.grid.spline, [t.t for t in data], values, data.rates, fit.problem.crew)
    physics, index = fit.grid.physics(fit.structure)
    weights = replace(fit.weights, noise_std=noise)
    there = fit_joint(seen, physics, weights, fit.control_points, fit.coefficients[index], max_steps=0)
    return np.sqrt(np.clip(np.diag(there.covariance), 0.0, None))


def normal_of(fit: Fit, trial: int) -> NormalEquations:
    """The normal equations of one trajectory alone."""
    grid, problem = fit.grid, fit.problem
    spline, data = grid.spline, problem.trajectories
    counts = np.cumsum([0, *(space.n_intervals for space in spline.spaces)]).tolist()
    points = slice(int(spline.offsets[trial]), int(spline.offsets[trial + 1]))
    intervals = slice(counts[trial], counts[trial + 1])
    rates = [replace(rate, values=rate.values[trial : trial + 1]) for rate in data.rates]
    given = data[trial]
    samples = ([given.t], [given.q], rates)
    recipe = Recipe(
        (spline.spaces[trial],),
        spline.n_quadrature,
        counts[-1],
        points,
        intervals,
        samples,
        grid.observations.floors,
    )
    physics, index = grid.physics(fit.structure)
    at = linearise(
        recipe.observe(), physics.within(intervals), fit.control_points[points], fit.coefficients[index]
    )
    return at.normal(fit.weights)
