"""Long recordings: blocks of trials that are computed when a sum over them is asked for, and then forgotten.

The sums are those of :mod:`leastaction.estimation.blocks`.  A Gauss–Newton step is one pass along the motion:
block by block the samples are laid on the splines, the equations linearised, and the curve eliminated.  What
stays of a block k are its share of the sums and

    X_k = H_k⁻¹ [g_k, C_k],

from which the step of its control points follows, −X_k (1, δ), as soon as that of the coefficients, δ, is
known.  Memory holds the samples, the control points and X, and beside them one block for each worker; the
blocks do not depend on the number of workers, and so neither do the results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.data.trajectories import Rate
from leastaction.estimation.banded import BandedFactor
from leastaction.estimation.candidates import CandidateBorder
from leastaction.estimation.crew import Crew
from leastaction.estimation.elimination import Condensed
from leastaction.estimation.joint import Costs, Linearisation, Physics, Weights, linearise
from leastaction.estimation.observations import RELATIVE_FLOOR, Observations
from leastaction.estimation.volume import Volume, add_volumes
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["StreamedObservations", "is_long"]

_LONG = 100_000  # samples: structures are searched on fewer
_NUMBERS = 2**20  # in the Jacobian of a block: 8 MB


def is_long(times: Sequence[np.ndarray], n_dof: int) -> bool:
    """Whether data are streamed."""
    return n_dof * sum(len(t) for t in times) > _LONG


class _Block(NamedTuple):
    """What the observations of some successive trials are made from."""

    spaces: tuple[SplineSpace, ...]
    n_quadrature: int
    before: int
    total: int
    data: tuple[Sequence[np.ndarray], Sequence[np.ndarray], Sequence[Rate]]
    floors: np.ndarray

    def observe(self) -> Observations:
        grid = SplineGrid(self.spaces, self.n_quadrature, before=self.before, total=self.total)
        return Observations(grid, *self.data, self.floors)


class _Point(NamedTuple):
    """Where a block is linearised."""

    physics: Physics
    control_points: np.ndarray
    coefficients: np.ndarray


class _Passed(NamedTuple):
    """What a pass keeps of a block; no system where H is not positive definite, or none was asked for."""

    squares: np.ndarray
    equation: np.ndarray
    terms: np.ndarray
    volume: Volume
    system: Condensed | None


class StreamedObservations:
    """Observations that are made anew, block by block, whenever they are needed; see `Observations`.

    Attributes
    ----------
    points, intervals : tuple of slice
        Control points and knot intervals of each block.
    """

    def __init__(
        self,
        grid: SplineGrid,
        times: Sequence[np.ndarray],
        values: Sequence[np.ndarray],
        rates: Sequence[Rate],
        crew: Crew,
    ) -> None:
        self.grid, self.crew, self.n_dof = grid, crew, values[0].shape[1]
        channels = [[q[:, i] for q in values] for i in range(self.n_dof)]
        channels += [list(rate.values) for rate in rates]
        self.counts, self.floors = _counts_and_floors(channels)
        self.noise_floor = self.floors[: self.n_dof]
        self.coordinates = np.array([*range(self.n_dof), *(rate.coordinate for rate in rates)])
        ends = np.concatenate([[0], np.cumsum([space.n_intervals for space in grid.spaces])])
        parts = [slice(a, b) for a, b in pairwise(_cuts(grid, self.n_dof, ends))]
        self.points = tuple(slice(int(grid.offsets[p.start]), int(grid.offsets[p.stop])) for p in parts)
        self.intervals = tuple(slice(int(ends[p.start]), int(ends[p.stop])) for p in parts)
        self._blocks = tuple(
            _Block(
                grid.spaces[p],
                grid.n_quadrature,
                int(ends[p.start]),
                grid.n_intervals,
                (times[p], values[p], [replace(rate, values=rate.values[p]) for rate in rates]),
                self.floors,
            )
            for p in parts
        )

    def each(self, function: Callable[..., Any], given: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Apply a function to every block, with what it is given there."""
        crew = self.crew
        return crew.results([crew.task(function, b, *g) for b, g in zip(self._blocks, given, strict=True)])

    def linearise(
        self,
        physics: Physics,
        control_points: np.ndarray,
        coefficients: np.ndarray,
        weights: Weights | None = None,
    ) -> StreamedLinearisation:
        """The joint problem linearised, and with weights its system eliminated, in one pass."""
        at = tuple(
            _Point(
                Physics(
                    physics.columns.from_interval(intervals.start),
                    physics.free,
                    None if physics.forces is None else physics.forces[intervals],
                ),
                control_points[points],
                coefficients,
            )
            for points, intervals in zip(self.points, self.intervals, strict=True)
        )
        found = self.each(_pass, [(point, weights, 0.0) for point in at])
        squares, equation, terms = (_total(part[k] for part in found) for k in range(3))
        out = StreamedLinearisation(
            self,
            at,
            squares,
            equation,
            terms,
            add_volumes(p.volume for p in found),
            physics.columns.prescribed,
        )
        if weights is None:
            return out
        return replace(out, ahead=(weights, tuple(part.system for part in found)))

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]:
        """y − N P for each channel, valid samples only."""
        parts = self.each(_residuals, [(control_points[points],) for points in self.points])
        return [np.concatenate(channel) for channel in zip(*parts, strict=True)]


@dataclass(frozen=True, eq=False)
class StreamedLinearisation(Costs):
    """The problem linearised at one point: its sums, and how to make the rest again; see `Linearisation`.

    ``ahead`` are the eliminated blocks at weights that were known beforehand.
    """

    observations: StreamedObservations
    at: tuple[_Point, ...]
    squares: np.ndarray
    equation: np.ndarray
    terms: np.ndarray
    at_mass: Volume
    prescribed: tuple[int, ...]
    ahead: tuple[Weights, tuple[Condensed | None, ...]] | None = None

    def lean(self) -> StreamedLinearisation:
        """The same without what was computed ahead."""
        return replace(self, ahead=None)

    def normal(self, weights: Weights) -> StreamedSystem:
        """The Gauss–Newton system, formed where it is eliminated."""
        ready = None if self.ahead is None or self.ahead[0] is not weights else self.ahead[1]
        return StreamedSystem(self.lean(), weights, ready)

    def freedom(self, weights: Weights, factor: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Linearisation.freedom`."""
        parts = self.observations.each(_freedom, [(point, weights) for point in self.at])
        return _total(p[0] for p in parts), _total(p[1] for p in parts)

    def scored(self, score: Callable[..., Any], *given: Any) -> Any:
        """All candidates about a fit, summed over the blocks."""
        weights, _, columns, candidates = given
        seen = self.observations
        own = [candidates.from_interval(intervals.start) for intervals in seen.intervals]
        parts = seen.each(
            _score, [(point, score, weights, columns, c) for point, c in zip(self.at, own, strict=True)]
        )

        def border(step: np.ndarray) -> np.ndarray:
            asked = [(point, weights, c, step) for point, c in zip(self.at, own, strict=True)]
            return np.concatenate(seen.each(_border, asked))

        return replace(
            parts[0],
            schur=_total(p.schur for p in parts),
            volume=add_volumes(p.volume for p in parts),
            factor=StreamedFactor(self.lean(), weights, 0.0, sum(p.factor for p in parts)),
            curve_gradient=np.concatenate([p.curve_gradient for p in parts]),
            border=border,
        )


@dataclass(frozen=True, eq=False)
class StreamedSystem:
    """The Gauss–Newton system of a streamed motion; see `NormalEquations`."""

    at: StreamedLinearisation
    weights: Weights
    ready: tuple[Condensed | None, ...] | None = None

    def lean(self) -> StreamedSystem:
        """The same without what was computed ahead."""
        return replace(self, ready=None)

    def eliminate(self, damping: float = 0.0) -> StreamedQuadratic:
        """See :meth:`NormalEquations.eliminate`."""
        parts = None if damping else self.ready
        if parts is None:
            given = [(point, self.weights, damping) for point in self.at.at]
            parts = tuple(p.system for p in self.at.observations.each(_pass, given))
        whole = [part for part in parts if part is not None]
        if len(whole) < len(parts):
            raise np.linalg.LinAlgError("the normal matrix of a block is not positive definite")
        gradient, matrix = _total(p.gradient for p in whole), _total(p.matrix for p in whole)
        held, reach = _total(p.held for p in whole), _total(p.reach for p in whole)
        factor = StreamedFactor(self.at, self.weights, damping, sum(part.logdet for part in whole))
        return StreamedQuadratic(gradient, matrix, held, reach, factor, tuple(p.solution for p in whole))


@dataclass(frozen=True, eq=False)
class StreamedQuadratic:
    """The cost as a function of the coefficients alone; see `Quadratic`.

    ``reach`` is gᵀH⁻¹[g, C], and ``solutions`` are the X of the blocks.
    """

    gradient: np.ndarray
    matrix: np.ndarray
    held: np.ndarray
    reach: np.ndarray
    factor: StreamedFactor
    solutions: tuple[np.ndarray, ...]

    def curve_step(self, step: np.ndarray) -> np.ndarray:
        """See :meth:`Quadratic.curve_step`."""
        both = np.concatenate([[1.0], step])
        return np.concatenate([solution @ both for solution in self.solutions])

    def predicted(self, shift: np.ndarray, step: np.ndarray) -> float:
        """See :meth:`Quadratic.predicted`."""
        return float(self.reach[0] + (self.reach[1:] - self.held) @ step)


@dataclass(frozen=True, eq=False)
class StreamedFactor:
    """The factor of H, made again where it is needed."""

    at: StreamedLinearisation
    weights: Weights
    damping: float
    logdet: float

    def solve(self, right: np.ndarray) -> np.ndarray:
        """H⁻¹b for one right-hand side."""
        seen = self.at.observations
        n = seen.n_dof
        given = [
            (point, self.weights, self.damping, right[part.start * n : part.stop * n])
            for point, part in zip(self.at.at, seen.points, strict=True)
        ]
        return np.concatenate(seen.each(_solve, given))


def _total(parts: Iterable[np.ndarray]) -> np.ndarray:
    return np.sum(list(parts), axis=0)


def _counts_and_floors(channels: Sequence[Sequence[np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Samples and noise floor of each channel, trial by trial; see `noise_floors`."""
    counts: list[int] = []
    floors: list[float] = []
    for parts in channels:
        seen = [part[np.isfinite(part)] for part in parts]
        count = sum(part.size for part in seen)
        mean = sum(float(part.sum()) for part in seen) / max(count, 1)
        counts.append(count)
        floors.append(np.sqrt(sum(float(((part - mean) ** 2).sum()) for part in seen) / max(count, 1)))
    return np.array(counts), RELATIVE_FLOOR * np.array(floors)


def _cuts(grid: SplineGrid, n_dof: int, ends: np.ndarray) -> list[int]:
    """The trials that blocks begin with, and the end: a block is as large as it may be, or one trial."""
    most = _NUMBERS // (grid.n_quadrature * n_dof**2 * (grid.degree + 1))
    cuts = [0]
    for k in range(1, len(grid.spaces)):
        if ends[k + 1] - ends[cuts[-1]] > most:
            cuts.append(k)
    return [*cuts, len(grid.spaces)]


# ---------------------------------------------------------------- what is computed with a block
def _linearised(block: _Block, point: _Point) -> Linearisation:
    return linearise(block.observe(), *point)


def _pass(block: _Block, point: _Point, weights: Weights | None, damping: float) -> _Passed:
    at, system = _linearised(block, point), None
    if weights is not None:
        try:
            system = at.normal(weights).condense(damping)
        except np.linalg.LinAlgError:
            system = None
    return _Passed(at.squares, at.equation, at.terms, at.at_mass, system)


def _residuals(block: _Block, points: np.ndarray) -> list[np.ndarray]:
    return block.observe().residuals(points)


def _freedom(block: _Block, point: _Point, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
    return _linearised(block, point).freedom(weights)


def _score(
    block: _Block,
    point: _Point,
    score: Callable[..., Any],
    weights: Weights,
    columns: EulerLagrange,
    candidates: EulerLagrange,
) -> Any:
    curve = point.control_points, point.coefficients
    part = score(_linearised(block, point), weights, curve, columns, candidates)
    return replace(part, factor=part.factor.logdet, border=None)


def _border(
    block: _Block, point: _Point, weights: Weights, candidates: EulerLagrange, step: np.ndarray
) -> np.ndarray:
    return CandidateBorder(_linearised(block, point), weights, point.control_points, candidates)(step)


def _solve(block: _Block, point: _Point, weights: Weights, damping: float, right: np.ndarray) -> np.ndarray:
    return BandedFactor.of(_linearised(block, point).normal(weights).rows, damping).solve(right)
