"""Joint fit of curve, coefficients and shape parameters.

Near values κ, a structure depends on a small step δ by

    Σ_k λ_k φ_k(κ + δ) = Σ_k λ_k φ_k(κ) + Σ_j δ_j Σ_k λ_k ∂φ_k/∂κ_j + O(δ²),

so that a step is the coefficient of one more term, the tangent Σ_k λ_k ∂φ_k/∂κ_j.  A fit of the structure
with its tangents gives λ and δ together. Then κ moves by δ, and new tangents are formed until δ vanishes
(Gauss–Newton).  The covariance of the last fit is the joint covariance of λ and κ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leastaction.estimation.fit import Fit, ShapeEstimate
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.settings import ESTIMATION
from leastaction.estimation.weights import Start
from leastaction.library import Term, tangent

__all__ = ["fit_shapes", "with_tangents"]

_MOST_STEPS = 25  # of the parameters, each a fit
_HALVINGS = 6  # of a step, before it counts as zero
_SHORTEST, _LONGEST = 0.1, 3.0  # share of a step
_DIGITS = 1e-9  # relative accuracy of a fit of noise-free data
_ROUNDS = 25  # of the weights, in each fit


def with_tangents(
    problem: Problem, structure: Structure, coefficients: np.ndarray, names: tuple[str, ...]
) -> tuple[Problem, Structure]:
    """The problem with a tangent for each shape parameter, and the structure with all tangents."""
    held = [*structure, *np.flatnonzero(problem.is_known).tolist()]
    tangents = [_tangent(problem, held, coefficients, name) for name in names]
    count = len(problem.candidates)
    return problem.wider(tangents), structure.with_(range(count, count + len(names)))


def _tangent(problem: Problem, held: list[int], coefficients: np.ndarray, name: str) -> Term:
    bearers = [k for k in held if name in problem.terms[k].shapes]
    kind = problem.terms[bearers[0]].kind
    bearers = [k for k in bearers if problem.terms[k].kind == kind]
    return tangent([problem.terms[k] for k in bearers], coefficients[bearers].tolist(), name)


def fit_shapes(fit: Fit, most_steps: int = _MOST_STEPS) -> Fit:
    """The fit with its shape parameters at their most likely values, and with their standard errors.

    The fit itself is returned if its structure has no shape parameter, or if no step from it converges.

    Notes
    -----
    A parameter that occurs both in L and in the dissipation is fitted to the terms of L.
    """
    names = fit.problem.shapes_of(fit.structure)
    if not names or not fit.usable:
        return fit
    share, before = 1.0, np.zeros(len(names))
    for left in reversed(range(most_steps)):
        trial = _tried(fit, names)
        if trial is None:
            return fit
        if trial.settled or not left:
            return trial.now  # with errors, and whether it converged
        share = _secant(share, before, trial.relative)
        moved, share = _advance(fit, trial, names, share)
        if moved is None:
            return trial.now
        fit, before = moved, trial.relative
    return fit


def _secant(share: float, before: np.ndarray, now: np.ndarray) -> float:
    """The share of a step to take so that the following step vanishes.

    A ``share`` of the step ``before`` changed the steps, in standard errors, to ``now``.  Because the weights
    depend on the parameters, steps may reverse or hardly shrink.
    """
    along = float(before @ (before - now))
    if along <= 0.0:
        return 1.0
    return float(np.clip(share * (before @ before) / along, _SHORTEST, _LONGEST))


def _tried(fit: Fit, names: tuple[str, ...]) -> _Trial | None:
    """A fit with tangents; a parameter whose step would cross its bound is held there."""
    trial = _Trial.of(fit, names, names)
    if trial is None:
        return None
    ranges, here = fit.problem.ranges, fit.problem.shape_values
    steps = dict(zip(names, trial.steps.tolist(), strict=True))
    free = tuple(n for n in names if steps[n] == 0.0 or ranges[n].stepped(here[n], steps[n]) != here[n])
    return trial if free == names else _Trial.of(fit, names, free)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A fit with tangents, at the same weights: steps δ, these in standard errors, the fit without them."""

    now: Fit
    steps: np.ndarray
    relative: np.ndarray
    start: Start

    @classmethod
    def of(cls, fit: Fit, names: tuple[str, ...], free: tuple[str, ...]) -> _Trial | None:
        """The fit with a tangent for each free name; the others have neither step nor error."""
        problem, structure = with_tangents(fit.problem, fit.structure, fit.coefficients, free)
        count = len(fit.problem.candidates)
        padded = np.append(fit.coefficients, np.zeros(len(free)))
        start = Start(fit.control_points, padded, fit.weights)
        wide = fit.grid.posed(problem).fit(structure, start, 0)
        if not wide.usable or not np.isfinite(wide.evidence):
            return None
        n = len(fit.structure)
        places = [names.index(name) for name in free]
        steps, covariance = np.zeros(len(names)), np.zeros((n + len(names),) * 2)
        steps[places] = wide.coefficients[count:]
        index = [*range(n), *(n + k for k in places)]
        covariance[np.ix_(index, index)] = wide.covariance
        values = np.array([fit.problem.shape_values[name] for name in names])
        errors = np.sqrt(np.clip(np.diag(covariance)[n:], 0.0, None))
        settled = bool(
            np.all(np.abs(steps) <= np.maximum(ESTIMATION.shape_settled * errors, _DIGITS * np.abs(values)))
        )
        estimate = ShapeEstimate(names, values, covariance, settled)
        now = replace(fit, covariance=covariance[:n, :n], shapes=estimate)
        relative = np.divide(steps, errors, out=np.zeros_like(steps), where=errors > 0.0)
        return cls(now, steps, relative, Start(wide.control_points, wide.coefficients[:count], wide.weights))

    @property
    def settled(self) -> bool:
        """Whether another step would change no parameter significantly."""
        return self.now.shapes is not None and self.now.shapes.settled


def _advance(fit: Fit, trial: _Trial, names: tuple[str, ...], share: float) -> tuple[Fit | None, float]:
    """The first fit along a share of the step, halved if needed, that is as likely; and the share."""
    for _ in range(_HALVINGS):
        moved = fit.problem.stepped(dict(zip(names, (share * trial.steps).tolist(), strict=True)))
        other = fit.grid.posed(moved).fit(fit.structure, trial.start, _ROUNDS)
        if other.usable and other.evidence >= fit.evidence - 1.2 * ESTIMATION.evidence_settled:
            return other, share
        share *= 0.5
    return None, share
