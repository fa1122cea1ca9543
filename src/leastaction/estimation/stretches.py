"""A motion whose equations are evaluated in stretches, which workers share.

Neighbouring control points couple, so that H is factorised in one piece.  But products of the equations and
their Jacobians are sums over knot intervals.  Where they take most of the time, as for an arm with seven
joints, each worker evaluates a stretch.  The sums do not depend on the stretches, except for rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from leastaction.curve.bspline import SplineGrid
from leastaction.estimation.crew import Crew
from leastaction.estimation.elimination import NormalEquations
from leastaction.estimation.files import opened
from leastaction.estimation.intervals import by_point, points_at
from leastaction.estimation.joint import Linearisation, Physics, Weights, linearise
from leastaction.estimation.observations import Observations
from leastaction.estimation.volume import Volume, add_volumes

__all__ = ["SharedObservations"]

_MOST, _CHUNK = 4096, 1024  # knot intervals in a stretch, and whose columns are in memory at once


class SharedObservations:
    """Observations in one piece, whose equations are evaluated in stretches; see `Observations`.

    Parameters
    ----------
    whole : Observations
    crew : Crew
        Each worker has a stretch, or several of a long motion, to bound memory.
    """

    calibration: np.ndarray | None = None

    def __init__(self, whole: Observations, crew: Crew) -> None:
        grid = whole.grid
        self.whole: Observations = whole
        self.grid: SplineGrid = grid
        self.n_dof: int = whole.n_dof
        self.counts: np.ndarray = whole.counts
        self.coordinates: np.ndarray = whole.coordinates
        self.floors: np.ndarray = whole.floors
        self.noise_floor: np.ndarray = whole.noise_floor
        self.crew: Crew = crew
        self._physics = _Held(None, [])
        rounds = -(-grid.n_intervals // (_MOST * self.crew.size))
        edges = np.linspace(0, grid.n_intervals, rounds * self.crew.size + 1)
        self.stretches: list[slice] = [
            slice(a, b) for a, b in pairwise(np.unique(edges.astype(int)).tolist())
        ]
        self.points: list[slice] = [grid.points_within(s) for s in self.stretches]
        n = len(grid.spaces)  # the samples belong to the whole motion
        nothing = [np.zeros(0)] * n, [np.zeros((0, self.n_dof))] * n, (), whole.floors
        self._parts = [self.crew.held(Observations(grid.part(s), *nothing)) for s in self.stretches]

    def each(self, function: Callable[..., Any], physics: Physics, given: Iterable[tuple[Any, ...]]) -> Any:
        """Apply a function to every stretch and its equations, with the arguments of that stretch."""
        if physics is not self._physics.physics:  # cached from step to step
            self._physics = _Held(physics, [self.crew.held(physics.within(s)) for s in self.stretches])
        every = zip(self._parts, self._physics.parts, given, strict=True)
        return self.crew.results([self.crew.task(function, *own, *more) for *own, more in every])

    def linearise(
        self,
        physics: Physics,
        control_points: np.ndarray,
        coefficients: np.ndarray,
        weights: Weights | None = None,
    ) -> SharedLinearisation:
        """The joint problem linearised, and with weights its normal equations, in one pass."""
        given = [(control_points[points], coefficients, weights) for points in self.points]
        found: list[_Evaluated] = self.each(_evaluate, physics, given)
        return SharedLinearisation(
            self.whole,
            physics,
            control_points,
            coefficients,
            None,
            *self.whole.gradient(control_points),
            np.sum([part.equation for part in found], axis=0),
            np.sum([part.terms for part in found], axis=0),
            add_volumes(part.volume for part in found),
            physics.columns.prescribed,
            shared=self,
            ahead=(weights, [part.normal for part in found]),
        )

    def scores(self, fit: Any) -> tuple[np.ndarray, np.ndarray]:
        """What each knot interval adds to the gradient in the coefficients, and its mean equation error.

        Parameters
        ----------
        fit : JointFit

        Returns
        -------
        (n_intervals, n_columns) array, (n_intervals, n_dof) array
        """
        given = [(fit.control_points[p], fit.coefficients, fit.weights.physics) for p in self.points]
        scores, means = zip(*self.each(_scores, fit.linearisation.physics, given), strict=True)
        return np.concatenate(scores), np.concatenate(means)

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]:
        """y − N P for each channel, valid samples only."""
        return self.whole.residuals(control_points)


class _Held(NamedTuple):
    """The equations of each stretch."""

    physics: Physics | None
    parts: list[Any]


class _Evaluated(NamedTuple):
    """Sums over the equations of a stretch, and its normal equations if weights are given."""

    equation: Any
    terms: Any
    volume: Volume
    normal: Any


@dataclass(frozen=True, eq=False, kw_only=True)
class SharedLinearisation(Linearisation):
    """The problem linearised at one point; ``ahead`` are normal equations at known weights."""

    shared: SharedObservations
    ahead: tuple[Weights | None, list[NormalEquations]]

    def lean(self) -> SharedLinearisation:
        """The same without what was computed ahead."""
        return replace(self, ahead=(None, []))

    def normal(self, weights: Weights) -> NormalEquations:
        """The Gauss–Newton system, summed over the stretches."""
        seen, (known, parts) = self.shared, self.ahead
        if known is not weights:
            parts = seen.linearise(self.physics, self.control_points, self.coefficients, weights).ahead[1]
        n, width = seen.n_dof, (seen.grid.degree + 1) * seen.n_dof
        rows = np.zeros((seen.grid.n_ctrl, n, width))
        border = np.zeros((seen.grid.n_ctrl * n, 1 + self.physics.n_free))
        for part, points in zip(parts, seen.points, strict=True):
            rows[points] += part.rows
            border[points.start * n : points.stop * n] += part.border
        self.observations.add_gram(rows, weights.noise_std)
        border[:, 0] += self.data_part(weights).ravel()
        gradient, corner = (np.sum([part[k] for part in parts], axis=0) for k in (2, 3))
        return NormalEquations(rows, border, gradient, corner)

    def traces(self, weights: Weights, inverse_rows: np.ndarray) -> np.ndarray:
        """See :meth:`Linearisation.traces`."""
        at = self.coefficients, weights
        given = [(self.control_points[p], *at, inverse_rows[p]) for p in self.shared.points]
        return np.sum(self.shared.each(_traces, self.physics, given), axis=0)


def _evaluate(
    seen: Any, physics: Any, points: np.ndarray, at: np.ndarray, weights: Weights | None
) -> _Evaluated:
    found = linearise(opened(seen), opened(physics), points, at)
    weights = weights and replace(weights, noise_std=weights.position_std)  # it has no other channels
    normal = None if weights is None else found.normal(weights)
    return _Evaluated(found.equation, found.terms, found.at_mass, normal)


def _scores(
    seen: Any, equations: Any, control_points: np.ndarray, at: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    grid, physics = opened(seen).grid, opened(equations)
    scores, means = list[np.ndarray](), list[np.ndarray]()
    for chunk in grid.chunks(_CHUNK):
        strong = physics.columns.strong(points_at(grid, control_points, chunk))
        residual = np.tensordot(at, strong, 1) - by_point(physics.forces[None, chunk])[0]
        scaled = weights[:, None] * residual * grid.weights[chunk].T.ravel()
        each = np.einsum("kip,ip->kp", strong, scaled).reshape(len(strong), grid.n_quadrature, -1)
        scores.append(each.sum(axis=1).T)
        means.append(residual.reshape(len(residual), grid.n_quadrature, -1).mean(axis=1).T)
    return np.concatenate(scores), np.concatenate(means)


def _traces(seen: Any, physics: Any, points: np.ndarray, at: np.ndarray, *given: Any) -> np.ndarray:
    return linearise(opened(seen), opened(physics), points, at).traces(*given)
