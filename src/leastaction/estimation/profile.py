"""Profile likelihood of shape parameters.

    rise(κ) = 2 (log L(κ̂) − max log L(κ)),

where the maximum is over the curve, the coefficients and the other shape parameters, at the weights of the
fit.  The log likelihood is not quadratic in such parameters. The interval κ̂ ± 1.96 standard errors may differ
much from the interval in which rise(κ) is below 3.84 (Wilks 1938, Ann. Math. Stat. 9:60).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.shapes import with_tangents
from leastaction.estimation.weights import evidence

__all__ = ["profiled"]

_FIRST = 1.0  # standard errors from the most likely value
_FARTHEST = 6.0  # standard errors
_END = 2.0  # square root of the rise at which a side ends; the 95 % interval ends at 1.96
_AIM = 2.2  # square root of the rise at which a place is meant to lie
_LEAST, _MOST = 1.25, 2.5  # ratio of a distance to the last one
_STEPS = 6  # of the other shape parameters at each place
_SETTLED = 0.02  # standard errors
_TOLERANCE = 1e-3  # of −2 log likelihood


def profiled(fit: Fit) -> Fit:
    """The fit with the profile of every shape parameter that has a standard error.

    Cost: some four fits at fixed weights for each parameter. No profile is computed if the parameters have
    not converged, or if the errors of the fit do not come from its likelihood.
    """
    found, n = fit.shapes, len(fit.structure)
    if found is None or not found.settled or not np.array_equal(found.covariance[:n, :n], fit.covariance):
        return fit
    best = _Profile(fit, found.names[0]).best()
    if best is None:
        return fit
    errors = found.standard_errors.tolist()
    profiles = tuple(
        _Profile(fit, name).both_sides(float(value), error, best) if error > 0.0 else ()
        for name, value, error in zip(found.names, found.values, errors, strict=True)
    )
    return replace(fit, shapes=replace(found, profiles=profiles))


class _Profile:
    """Fits with one shape parameter held."""

    def __init__(self, fit: Fit, name: str) -> None:
        assert fit.shapes is not None
        self.fit, self.name = fit, name
        self.others = tuple(other for other in fit.shapes.names if other != name)
        n, place = len(fit.structure), len(fit.structure) + fit.shapes.names.index(name)
        column = fit.shapes.covariance[:, place]
        # slopes of coefficients and other parameters in this one
        follow = column / max(column[place], 1e-300)
        self.coefficients_follow = follow[:n]
        self.shapes_follow = dict(zip(fit.shapes.names, follow[n:].tolist(), strict=True))

    def best(self) -> float | None:
        """The log likelihood at the values of the fit, as exactly as at other values."""
        found = self._value_at(self.fit.problem, self._moved(0.0), self.fit.control_points)
        return None if found is None else found[0]

    def both_sides(self, value: float, error: float, best: float) -> tuple[tuple[float, float], ...]:
        """Values in rising order, and the rise at each."""
        sides = [self._side(value, sign * error, best) for sign in (-1.0, 1.0)]
        # zero at the value of the fit, although this is the maximum only up to rounding
        return (*reversed(sides[0]), (value, 0.0), *sides[1])

    def _side(self, value: float, error: float, best: float) -> list[tuple[float, float]]:
        """Each place is where the square root of the rise, which is nearly linear, should end the side."""
        out: list[tuple[float, float]] = []
        where, curve = self.fit.problem.ranges[self.name], self.fit.control_points
        places, root = _FIRST, 0.0
        while root < _END and places <= _FARTHEST:
            step = places * error
            if where.bounded and not where.low <= value + step <= where.high:
                break
            problem = self._expected(step).at({self.name: value + step})
            found = self._value_at(problem, self._moved(step), curve)
            if found is None:
                break
            rise, curve = max(2.0 * (best - found[0]), 0.0), found[1]
            out.append((value + step, rise))
            root = float(np.sqrt(rise))
            places *= min(max(_AIM / max(root, 1e-9), _LEAST), _MOST)
        return out

    def _expected(self, step: float) -> Problem:
        """The problem with the other shape parameters at their expected values."""
        return self.fit.problem.stepped({name: self.shapes_follow[name] * step for name in self.others})

    def _moved(self, step: float) -> np.ndarray:
        """The coefficients at their expected values."""
        out = self.fit.coefficients.copy()
        out[list(self.fit.structure)] += step * self.coefficients_follow
        return out

    def _value_at(
        self, problem: Problem, coefficients: np.ndarray, curve: np.ndarray
    ) -> tuple[float, np.ndarray] | None:
        """The highest log likelihood with the parameter held, and its curve; None if no fit converges."""
        count = len(problem.candidates)
        for _ in range(_STEPS):
            wide, structure = with_tangents(problem, self.fit.structure, coefficients, self.others)
            padded = np.append(coefficients, np.zeros(len(self.others)))
            found, index = self._joint(wide, structure, padded, curve)
            if not found.converged:
                return None
            values = padded.copy()
            values[index] = found.coefficients
            coefficients, steps, curve = values[:count], values[count:], found.control_points
            places = [len(self.fit.structure) + k for k in range(len(self.others))]
            errors = np.sqrt(np.clip(np.diag(found.covariance)[places], 1e-300, None))
            if np.all(np.abs(steps) <= _SETTLED * errors):
                value = evidence(self.fit.grid.observations, found)
                return (value, curve) if np.isfinite(value) else None
            problem = problem.stepped(dict(zip(self.others, steps.tolist(), strict=True)))
        return None

    def _joint(
        self, problem: Problem, structure: Structure, coefficients: np.ndarray, curve: np.ndarray
    ) -> tuple[JointFit, list[int]]:
        grid = self.fit.grid.posed(problem)
        physics, index = grid.physics(structure)
        values = problem.completed(coefficients)[index]
        found = fit_joint(grid.observations, physics, self.fit.weights, curve, values, tolerance=_TOLERANCE)
        return found, index
