"""Equation weights of nearly exact equations: as large as the data allow.

An exact library leaves no equation error, and its weight w_i = 1/(spectral density of the error) has no
maximum. The marginal likelihood is flat over decades of w, while the coefficients still change by some tenths
of a standard error.  The iteration of fits and weights ends at an arbitrary point of this plateau.  Therefore
the largest of the weights that the data cannot distinguish is used,

    w = max { w : log L(w) ≥ max log L − 1 },

that is, equations are taken as exact unless the data contradict.  At the end of the plateau the splines can
no longer follow exact equations, and the likelihood falls steeply.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.protocols import Linearised
from leastaction.estimation.settings import ESTIMATION
from leastaction.estimation.weights import evidence

__all__ = ["towards_exact"]

_STEP = 3.0  # of w
_MOST_STEPS = 8  # of _STEP each: nearly four decades
_TOLERANCE = 1e-3  # of −2 log likelihood: a thirtieth of a standard error
_LAST_TOLERANCE = 1e-4  # the same of the fit that is returned


class _Here(NamedTuple):
    """Weights, start values of a fit with them, and its log likelihood."""

    weights: Weights
    control_points: np.ndarray
    coefficients: np.ndarray
    linearisation: Linearised
    value: float


def towards_exact(fit: Fit) -> Fit:
    """The fit at the largest weights that are as likely as its own; equations with visible error keep theirs.

    The weights are raised one after the other, because their ratio is arbitrary on the plateau, too. Each may
    lower the likelihood by its share of the tolerance. The fit itself is returned if every equation has a
    visible error, or if no larger weight is as likely.
    """
    cost = fit.linearisation.equation * fit.weights.physics
    hardly = np.maximum(fit.weights.slack, cost) < ESTIMATION.slack_left
    hardly[list(fit.problem.prescribed)] = False
    if not fit.converged or not hardly.any() or not np.isfinite(fit.evidence):
        return fit
    physics, index = fit.grid.physics(fit.structure)
    trial = _Trial(fit, physics)
    here = _Here(fit.weights, fit.control_points, fit.coefficients[index], fit.linearisation, fit.evidence)
    best, share = fit.evidence, ESTIMATION.as_likely / np.count_nonzero(hardly)
    for count, equation in enumerate(np.flatnonzero(hardly), start=1):
        here, best = _raise(trial, here, int(equation), best, count * share)
    found, value = trial.at(here.weights, here, _LAST_TOLERANCE)
    if not np.isfinite(value):
        return fit
    coefficients = fit.coefficients.copy()
    coefficients[index] = found.coefficients
    return Fit.of(fit.grid, fit.structure, coefficients, found, value)


@dataclass(frozen=True, eq=False)
class _Trial:
    """Fits of one structure at given weights."""

    fit: Fit
    physics: Physics

    def at(self, weights: Weights, start: _Here, tolerance: float) -> tuple[JointFit, float]:
        observations = self.fit.grid.observations
        found = fit_joint(
            observations,
            self.physics,
            weights,
            start.control_points,
            start.coefficients,
            linearisation=start.linearisation,
            tolerance=tolerance,
        )
        return found, evidence(observations, found) if found.converged else -np.inf


def _raise(trial: _Trial, here: _Here, equation: int, best: float, allowed: float) -> tuple[_Here, float]:
    """Raise the weight of one equation until the log likelihood is ``allowed`` below the best one met."""
    for _ in range(_MOST_STEPS):
        higher = _raised(here.weights, equation, _STEP)
        found, next_value = trial.at(higher, here, _TOLERANCE)
        if next_value >= best - allowed:
            best = max(best, next_value)
            here = _Here(higher, found.control_points, found.coefficients, found.linearisation, next_value)
            continue
        if np.isfinite(next_value):  # interpolate to the likelihood that is allowed
            fallen = max(here.value - next_value, 1e-300)
            part = np.clip((here.value - best + allowed) / fallen, 0.0, 1.0)
            weights = _raised(here.weights, equation, _STEP ** float(part))
            here = here._replace(weights=weights, value=best - allowed)
        break
    return here, best


def _raised(weights: Weights, equation: int, factor: float) -> Weights:
    """Weights with that of one equation raised; its slack falls in proportion."""
    rise = np.ones(weights.physics.size)
    rise[equation] = factor
    return replace(weights, physics=rise * weights.physics, slack=weights.slack / rise)
