"""Trials as independent blocks of the joint problem, which workers compute in parallel.

Control points of two trials never couple, so H is block diagonal over the trials, and the system of the
coefficients is a sum over blocks k,

    Σ_k (A_k − C_kᵀH_k⁻¹C_k),    Σ_k (g_k − C_kᵀH_k⁻¹g_Pk),    Σ_k log|H_k|,

as are costs, equation errors and traces.  A worker keeps the data, basis, Jacobian and factor of a block. For
a step, it receives λ, weights and control points, and returns small matrices and the step of the control
points.

The classes here replace `Observations`, `Linearisation`, `NormalEquations` and `BandedFactor`.  A single
trial is never cut, because neighbouring control points couple.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leastaction.curve.bspline import SplineGrid
from leastaction.data.trajectories import Rate
from leastaction.estimation.crew import Alone, Crew, Task
from leastaction.estimation.elimination import NormalEquations, Quadratic
from leastaction.estimation.joint import Costs, Linearisation, Physics, Weights, linearise
from leastaction.estimation.observations import Observations, counts_and_floors
from leastaction.estimation.recipes import InBlocks, Recipe, cut, observed
from leastaction.estimation.streamed import StreamedObservations, is_long
from leastaction.estimation.volume import Volume, add_volumes
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["BlockedObservations", "observe"]


def observe(
    grid: SplineGrid,
    times: Sequence[np.ndarray],
    values: Sequence[np.ndarray],
    rates: Sequence[Rate] = (),
    crew: Crew | None = None,
) -> Observations | BlockedObservations | StreamedObservations:
    """Observations in one piece, in blocks of trials, or streamed, whatever the number of workers."""
    counts, floors = counts_and_floors(values, rates)
    recipes = cut(grid, (times, values, rates), floors)
    crew = crew or Alone()
    if is_long(times, values[0].shape[1]):
        return StreamedObservations(grid, recipes, counts, crew)
    if len(recipes) == 1:
        return Observations(grid, times, values, rates, floors)
    # computing a block of a short recording takes less time than sending it
    return BlockedObservations(grid, recipes, counts, crew if crew.keeps else Alone())


class BlockedObservations(InBlocks):
    """Observations in blocks of successive trials; see `Observations`.

    Attributes
    ----------
    blocks : tuple of Task
        Of the `Observations` of each block.
    """

    calibration: np.ndarray | None = None

    def __init__(self, grid: SplineGrid, recipes: Sequence[Recipe], counts: np.ndarray, crew: Crew) -> None:
        super().__init__(grid, recipes, counts, crew)
        self.blocks: tuple[Task, ...] = tuple(crew.task(observed, recipe) for recipe in recipes)

    def linearise(
        self,
        physics: Physics,
        control_points: np.ndarray,
        coefficients: np.ndarray,
        weights: Weights | None = None,
    ) -> BlockedLinearisation:
        """The joint problem linearised, block by block."""
        blocks = tuple(
            self.crew.task(
                _linearise,
                seen,
                physics.within(intervals),
                control_points[points],
                coefficients,
            )
            for seen, points, intervals in zip(self.blocks, self.points, self.intervals, strict=True)
        )
        costs = self.crew.results([self.crew.task(_costs, block) for block in blocks])
        squares, equation, terms = (_sum(c[k] for c in costs) for k in range(3))
        volume = add_volumes(c[3] for c in costs)
        return BlockedLinearisation(
            self, blocks, control_points, squares, equation, terms, volume, physics.columns.prescribed
        )

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]:
        """y − N P for each channel, valid samples only."""
        tasks = [
            self.crew.task(_residuals, seen, control_points[points])
            for seen, points in zip(self.blocks, self.points, strict=True)
        ]
        return [np.concatenate(parts) for parts in zip(*self.crew.results(tasks), strict=True)]


@dataclass(frozen=True, eq=False)
class BlockedLinearisation(Costs):
    """The problem linearised at one point, block by block; see `Linearisation`."""

    observations: BlockedObservations
    blocks: tuple[Task, ...]
    control_points: np.ndarray
    squares: np.ndarray
    equation: np.ndarray
    terms: np.ndarray
    at_mass: Volume
    prescribed: tuple[int, ...]

    def lean(self) -> BlockedLinearisation:
        """Itself: nothing was computed ahead."""
        return self

    def normal(self, weights: Weights) -> BlockedNormal:
        """The Gauss–Newton system, block by block."""
        crew = self.observations.crew
        blocks = tuple(crew.task(_normal, block, weights) for block in self.blocks)
        return BlockedNormal(self.observations, blocks)

    def freedom(self, weights: Weights, factor: BlockedFactor | None = None) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Linearisation.freedom`."""
        crew = self.observations.crew
        found = [None] * len(self.blocks) if factor is None else factor.parts
        tasks = [crew.task(_freedom, at, weights, part) for at, part in zip(self.blocks, found, strict=True)]
        parts = crew.results(tasks)
        return _sum(p[0] for p in parts), _sum(p[1] for p in parts)

    def scored(self, score: Callable[..., Any], weights: Weights, candidates: EulerLagrange) -> Any:
        """All candidates about a fit, summed over the blocks."""
        crew, seen = self.observations.crew, self.observations
        tasks = [
            crew.task(_score, score, block, weights, candidates.within(intervals))
            for block, intervals in zip(self.blocks, seen.intervals, strict=True)
        ]
        small = crew.results([crew.task(_small_scores, task) for task in tasks])
        steps = BlockedFactor(seen, tuple(tasks), _sum(s[2] for s in small))
        found = small[0][0]
        return replace(
            found,
            schur=_sum(s[0].schur for s in small),
            volume=add_volumes(s[0].volume for s in small),
            factor=steps,
            curve_gradient=np.concatenate([s[1] for s in small]),
            border=steps.border,
        )


@dataclass(frozen=True, eq=False)
class BlockedNormal:
    """The Gauss–Newton system in blocks; see `NormalEquations`."""

    observations: BlockedObservations
    blocks: tuple[Task, ...]

    def lean(self) -> BlockedNormal:
        """Itself: nothing was computed ahead."""
        return self

    def eliminate(self, damping: float = 0.0) -> Quadratic:
        """See :meth:`NormalEquations.eliminate`."""
        seen = self.observations
        tasks = [seen.crew.task(_eliminate, block, damping) for block in self.blocks]
        small = seen.crew.results([seen.crew.task(_small, task) for task in tasks])
        gradient, matrix, held, logdet = (_sum(s[k] for s in small) for k in range(4))
        factor = BlockedFactor(seen, tuple(tasks), float(logdet))
        curve_gradient = np.concatenate([s[4] for s in small])
        return Quadratic(gradient, matrix, factor, curve_gradient, factor.border, held)


@dataclass(frozen=True, eq=False)
class BlockedFactor:
    """Factors of the blocks of H, and their borders, held by the workers."""

    observations: BlockedObservations
    parts: tuple[Task, ...]
    logdet: float

    def solve(self, right: np.ndarray) -> np.ndarray:
        """H⁻¹b for one right-hand side."""
        n, crew = self.observations.n_dof, self.observations.crew
        tasks = [
            crew.task(_solve, part, right[points.start * n : points.stop * n])
            for part, points in zip(self.parts, self.observations.points, strict=True)
        ]
        return np.concatenate(crew.results(tasks))

    def border(self, step: np.ndarray) -> np.ndarray:
        """C · step."""
        crew = self.observations.crew
        return np.concatenate(crew.results([crew.task(_border, part, step) for part in self.parts]))


#                                                                                 computations with one block
def _linearise(
    seen: Observations, physics: Physics, points: np.ndarray, coefficients: np.ndarray
) -> Linearisation:
    # all blocks of the motion are held until the step is made
    return linearise(seen, physics, points, coefficients, share=seen.grid.n_intervals / seen.grid.total)


def _residuals(seen: Observations, points: np.ndarray) -> list[np.ndarray]:
    return seen.residuals(points)


def _costs(at: Linearisation) -> tuple[Any, ...]:
    return at.squares, at.equation, at.terms, at.at_mass


def _freedom(at: Linearisation, weights: Weights, found: Any) -> tuple[np.ndarray, np.ndarray]:
    return at.freedom(weights, None if found is None else found.factor)


def _normal(at: Linearisation, weights: Weights) -> NormalEquations:
    return at.normal(weights)


def _eliminate(normal: NormalEquations, damping: float) -> Quadratic:
    return normal.eliminate(damping)


def _small(part: Quadratic) -> tuple[Any, ...]:
    return part.gradient, part.matrix, part.held, part.logdet, part.curve_gradient


def _score(score: Callable[..., Any], at: Linearisation, *given: Any) -> Any:
    return score(at, *given)


def _small_scores(part: Any) -> tuple[Any, np.ndarray, float]:
    small = replace(part, factor=None, curve_gradient=None, border=None)
    return small, part.curve_gradient, part.factor.logdet


def _solve(part: Any, right: np.ndarray) -> np.ndarray:
    return part.factor.solve(right)


def _border(part: Any, step: np.ndarray) -> np.ndarray:
    return part.border(step)


def _sum(parts: Iterable[Any]) -> Any:
    return sum(parts)
