"""Equation weights where hardly any equation error is left: as close to exact as the data allow.

An exact library leaves no equation error, and its weight w_i = 1/(spectral density of the error) has no
maximum: the marginal likelihood is flat over decades of w, while the coefficients still creep by some tenths
of a standard error.  Where on this plateau an alternation of fits and weights ends is chance.  Of the weights
that the data cannot tell apart the largest is taken,

    w = max { w : log L(w) ≥ max log L − 1 },

that is, equations are taken as exact unless the data speak against it.  The plateau ends where the splines
cannot follow exact equations any more, and the likelihood falls steeply.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.joint import Weights
from leastaction.estimation.weights import SLACK_LEFT, evidence

__all__ = ["towards_exact"]

_INDISTINCT = 1.0  # log likelihood
_STEP = 3.0  # of w
_MOST_STEPS = 8
_TOLERANCE = 1e-3  # of −2 log likelihood: a thirtieth of a standard error
_LAST_TOLERANCE = 1e-4


def towards_exact(fit: Fit) -> Fit:
    """The fit at the largest weights that are as likely as its own; those of visible errors stay.

    The fit itself where every equation shows an error, or where no larger weight is as likely.
    """
    hardly = fit.weights.slack < SLACK_LEFT
    hardly[list(fit.problem.prescribed)] = False
    if not fit.converged or not hardly.any() or not np.isfinite(fit.evidence):
        return fit
    physics, index = fit.grid.physics(fit.structure)

    def at(factor: float, start: JointFit | None, tolerance: float) -> tuple[JointFit, float]:
        weights = _raised(fit.weights, hardly, factor)
        points, values = (
            (fit.control_points, fit.coefficients[index])
            if start is None
            else (start.control_points, start.coefficients)
        )
        found = fit_joint(fit.grid.observations, physics, weights, points, values, tolerance=tolerance)
        value = evidence(fit.grid.observations, found) if found.converged else -np.inf
        return found, value

    best, factor, last, value = fit.evidence, 1.0, None, fit.evidence
    for _ in range(_MOST_STEPS):
        trial, next_value = at(factor * _STEP, last, _TOLERANCE)
        if not next_value >= best - _INDISTINCT:
            break
        best = max(best, next_value)
        factor, last, value = factor * _STEP, trial, next_value
    else:
        next_value = -np.inf
    if np.isfinite(next_value):  # where between the two the likelihood has fallen by one
        share = (value - best + _INDISTINCT) / max(value - next_value, 1e-300)
        factor *= _STEP ** float(np.clip(share, 0.0, 1.0))
    found, value = at(factor, last, _LAST_TOLERANCE)
    if not np.isfinite(value):
        return fit
    coefficients = fit.coefficients.copy()
    coefficients[index] = found.coefficients
    return Fit.of(fit.grid, fit.structure, coefficients, found, value)


def _raised(weights: Weights, which: np.ndarray, factor: float) -> Weights:
    """Weights with those of some equations raised; what is left to their errors falls alike."""
    rise = np.where(which, factor, 1.0)
    return replace(weights, physics=rise * weights.physics, slack=weights.slack / rise)
