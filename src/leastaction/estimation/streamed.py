"""Long recordings: blocks of trials that are recomputed for every sum over them, and not kept.

The sums are those of :mod:`leastaction.estimation.blocks`.  A Gauss–Newton step is one pass along the motion:
block by block, the basis is evaluated at the samples, the equations are linearised, and the curve is
eliminated. For a block k, the pass keeps its share of the sums and

    X_k = H_k⁻¹ [g_k, C_k],

from which the step of its control points follows, −X_k (1, δ), as soon as the step δ of the coefficients is
known.  X is the largest array and is stored in temporary files.  Memory holds the samples, the control
points, and one block for each worker.  The blocks, and therefore the results, do not depend on the number of
workers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from leastaction.curve.bspline import SplineGrid
from leastaction.estimation.candidates import CandidateBorder
from leastaction.estimation.crew import Alone, Crew
from leastaction.estimation.elimination import BandedFactor, Condensed
from leastaction.estimation.files import Held, Shelf, opened
from leastaction.estimation.gauss_newton import nearer
from leastaction.estimation.joint import Costs, Linearisation, Physics, Weights, linearise
from leastaction.estimation.observations import Observations
from leastaction.estimation.recipes import InBlocks, Recipe, observed
from leastaction.estimation.volume import Volume, add_volumes
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["StreamedObservations", "is_long"]

_LONG = 100_000  # samples; structures are searched on fewer
_KEPT = 1_000_000  # samples whose basis is kept, some 200 MB; with workers it would have to be sent
_TOGETHER = 8  # blocks of one task: sending each by itself took 5 % of the time of two workers
_FAR = 0.01  # a sample: a block is improved if its own step should lower the cost by more
_HELD = 1e-4  # damping of a block whose own step promises what the cost does not keep
_LEAST_TASKS = 32  # so that workers finish at about the same time


def is_long(times: Sequence[np.ndarray], n_dof: int) -> bool:
    """Whether data are streamed."""
    return n_dof * sum(len(t) for t in times) > _LONG


_Block = Recipe | Observations | Held
"""A block as an argument of a task: its observations, or their recipe."""


class _Point(NamedTuple):
    """The point at which a block is linearised; the forces are separate, because they do not change."""

    physics: Physics
    forces: np.ndarray | Held | None
    control_points: np.ndarray
    coefficients: np.ndarray


class _Passed(NamedTuple):
    """The results of a pass for a block; without a system if H is not positive definite, or none is needed.

    ``shelf`` holds the solution of the system if it is on disk; ``control_points`` are new ones. ``damping``
    is what this block needs beside that of all blocks.
    """

    squares: np.ndarray
    equation: np.ndarray
    terms: np.ndarray
    volume: Volume
    system: Condensed | None
    shelf: Shelf | None = None
    control_points: np.ndarray | None = None
    damping: float = 0.0


class StreamedObservations(InBlocks):
    """Observations that are formed block by block whenever they are needed; see `Observations`."""

    calibration: np.ndarray | None = None

    def __init__(self, grid: SplineGrid, recipes: Sequence[Recipe], counts: np.ndarray, crew: Crew) -> None:
        super().__init__(grid, recipes, counts, crew)
        # on a cluster, samples are sent once and the workers keep the observations in their own memory
        if isinstance(crew, Alone) and counts.sum() < _KEPT:
            self._blocks: list[Any] = [recipe.observe() for recipe in recipes]
        else:
            self._blocks = [crew.task(observed, r) if crew.keeps else crew.held(r) for r in recipes]
        self._forces: tuple[np.ndarray | None, list[Any]] = None, []

    def each(self, function: Callable[..., Any], given: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Apply a function to every block, with the arguments of that block."""
        every = [(block, *own) for block, own in zip(self._blocks, given, strict=True)]
        size = max(1, min(_TOGETHER, len(every) // _LEAST_TASKS))
        batches = [every[k : k + size] for k in range(0, len(every), size)]
        tasks = deque(self.crew.task(_in_turn, function, len(b), *chain.from_iterable(b)) for b in batches)
        del every, batches
        out: list[Any] = []
        while tasks:  # frees a finished task with its arguments
            out += self.crew.results([tasks.popleft()])[0]
        return out

    def passed(self, given: Sequence[tuple[Any, ...]]) -> list[_Passed]:
        """One pass; the X of the blocks stay on disk if all workers share it."""
        shelves = [self.crew.shelf() for _ in self.points]
        parts = self.each(_pass, [(*g, shelf) for g, shelf in zip(given, shelves, strict=True)])
        # the result holds a copy of the shelf; the file is removed with the original, made here
        return [p._replace(shelf=p.shelf and own) for p, own in zip(parts, shelves, strict=True)]

    def _forces_of(self, physics: Physics) -> list[Any]:
        """The forces on each block, cached from step to step."""
        forces = physics.forces
        if forces is not None and forces is not self._forces[0]:
            self._forces = forces, [self.crew.held(forces[intervals]) for intervals in self.intervals]
        return [None] * len(self.intervals) if forces is None else self._forces[1]

    def linearise(
        self,
        physics: Physics,
        control_points: np.ndarray,
        coefficients: np.ndarray,
        weights: Weights | None = None,
    ) -> StreamedLinearisation:
        """The joint problem linearised, and with weights its system eliminated, in one pass.

        The worst block limits the length of a step: one trial of thousands whose curve was far from its
        optimum held up all others.  With weights, the curve of such a block is improved by itself. If its own
        step still promises a lower cost, the quadratic does not describe the cost, and the block is damped.
        """
        at = self._points_of(physics, control_points, coefficients)
        found = self.passed([(point, weights, 0.0, True) for point in at])
        led = {k: part.control_points for k, part in enumerate(found) if part.control_points is not None}
        if led:
            control_points = control_points.copy()
            for k, points in led.items():
                control_points[self.points[k]] = points
            at = self._points_of(physics, control_points, coefficients)
            found = [part._replace(control_points=None) for part in found]
        return StreamedLinearisation(
            self,
            at,
            control_points,
            _total(part.squares for part in found),
            _total(part.equation for part in found),
            _total(part.terms for part in found),
            add_volumes(part.volume for part in found),
            physics.columns.prescribed,
            tuple(part.damping for part in found),
            None if weights is None else (weights, tuple(found)),
        )

    def _points_of(
        self, physics: Physics, control_points: np.ndarray, coefficients: np.ndarray
    ) -> tuple[_Point, ...]:
        """The point at which each block is linearised."""
        unforced = replace(physics, forces=None)
        return tuple(
            _Point(unforced.within(intervals), forces, control_points[points], coefficients)
            for points, intervals, forces in zip(
                self.points, self.intervals, self._forces_of(physics), strict=True
            )
        )

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]:
        """y − N P for each channel, valid samples only."""
        parts = self.each(_residuals, [(control_points[points],) for points in self.points])
        return [np.concatenate(channel) for channel in zip(*parts, strict=True)]


@dataclass(frozen=True, eq=False)
class StreamedLinearisation(Costs):
    """The problem linearised at one point: its sums, and the inputs of the rest; see `Linearisation`.

    ``dampings`` are those of single blocks, and ``ahead`` the eliminated blocks at weights known in advance.
    """

    observations: StreamedObservations
    at: tuple[_Point, ...]
    control_points: np.ndarray
    squares: np.ndarray
    equation: np.ndarray
    terms: np.ndarray
    at_mass: Volume
    prescribed: tuple[int, ...]
    dampings: tuple[float, ...]
    ahead: tuple[Weights, tuple[_Passed, ...]] | None = None

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

    def scored(self, score: Callable[..., Any], weights: Weights, candidates: EulerLagrange) -> Any:
        """All candidates about a fit, summed over the blocks."""
        seen = self.observations
        own = [candidates.within(intervals) for intervals in seen.intervals]
        parts = seen.each(_score, [(point, score, weights, c) for point, c in zip(self.at, own, strict=True)])

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
    """The Gauss–Newton system of a streamed recording; see `NormalEquations`."""

    at: StreamedLinearisation
    weights: Weights
    ready: tuple[_Passed, ...] | None = None

    def lean(self) -> StreamedSystem:
        """The same without what was computed ahead."""
        return replace(self, ready=None)

    def eliminate(self, damping: float = 0.0) -> StreamedQuadratic:
        """See :meth:`NormalEquations.eliminate`."""
        parts = None if damping else self.ready
        if parts is None:
            own = (max(damping, each) for each in self.at.dampings)
            given = [(p, self.weights, d, False) for p, d in zip(self.at.at, own, strict=True)]
            parts = tuple(self.at.observations.passed(given))
        whole = [part.system for part in parts if part.system is not None]
        if len(whole) < len(parts):
            raise np.linalg.LinAlgError("the normal matrix of a block is not positive definite")
        gradient, matrix = _total(p.gradient for p in whole), _total(p.matrix for p in whole)
        held, reach = _total(p.held for p in whole), _total(p.reach for p in whole)
        factor = StreamedFactor(self.at, self.weights, damping, sum(part.logdet for part in whole))
        solutions = tuple(p.shelf or s.solution for p, s in zip(parts, whole, strict=True))
        return StreamedQuadratic(gradient, matrix, held, reach, factor, solutions)


@dataclass(frozen=True, eq=False)
class StreamedQuadratic:
    """The cost as a function of the coefficients alone; see `Quadratic`.

    ``reach`` is gᵀH⁻¹[g, C], and ``solutions`` are the X of the blocks or their files.
    """

    gradient: np.ndarray
    matrix: np.ndarray
    held: np.ndarray
    reach: np.ndarray
    factor: StreamedFactor
    solutions: tuple[np.ndarray | Shelf, ...]

    def curve_step(self, step: np.ndarray) -> np.ndarray:
        """See :meth:`Quadratic.curve_step`."""
        both, seen = np.concatenate([[1.0], step]), self.factor.at.observations
        out = np.empty(seen.grid.n_ctrl * seen.n_dof)
        for solution, points in zip(self.solutions, seen.points, strict=True):
            own = slice(points.start * seen.n_dof, points.stop * seen.n_dof)
            np.matmul(solution.array() if isinstance(solution, Shelf) else solution, both, out=out[own])
        return out

    def predicted(self, shift: np.ndarray, step: np.ndarray) -> float:
        """See :meth:`Quadratic.predicted`."""
        return float(self.reach[0] + (self.reach[1:] - self.held) @ step)


@dataclass(frozen=True, eq=False)
class StreamedFactor:
    """The factor of H, recomputed when needed."""

    at: StreamedLinearisation
    weights: Weights
    damping: float
    logdet: float

    def solve(self, right: np.ndarray) -> np.ndarray:
        """H⁻¹b for one right-hand side."""
        seen = self.at.observations
        n = seen.n_dof
        given = [
            (point, self.weights, max(self.damping, own), right[part.start * n : part.stop * n])
            for point, own, part in zip(self.at.at, self.at.dampings, seen.points, strict=True)
        ]
        return np.concatenate(seen.each(_solve, given))


def _total(parts: Iterable[np.ndarray]) -> np.ndarray:
    return np.sum(list(parts), axis=0)


#                                                                                 computations with one block
def _in_turn(function: Callable[..., Any], count: int, *given: Any) -> list[Any]:
    """Apply a function to ``count`` blocks, whose arguments follow each other in ``given``."""
    size = len(given) // count
    return [function(*given[k * size : (k + 1) * size]) for k in range(count)]


def _seen(block: _Block) -> Observations:
    given: Recipe | Observations = opened(block)
    return given.observe() if isinstance(given, Recipe) else given


def _linearised(block: _Block, point: _Point) -> Linearisation:
    physics = replace(point.physics, forces=opened(point.forces))
    return linearise(_seen(block), physics, point.control_points, point.coefficients)


def _pass(
    block: _Block, point: _Point, weights: Weights | None, damping: float, lead: bool, shelf: Shelf | None
) -> _Passed:
    at = _linearised(block, point)
    found = _summed(at, weights, damping, shelf)
    if not lead or weights is None or not _is_far(at, found.system):
        return found
    there = nearer(at, weights)
    if there is not None:
        at, found = there, _summed(there, weights, damping, shelf)
    if damping < _HELD and _is_far(at, found.system):
        found = _summed(at, weights, _HELD, shelf)._replace(damping=_HELD)
    return found if there is None else found._replace(control_points=there.control_points)


def _summed(at: Linearisation, weights: Weights | None, damping: float, shelf: Shelf | None) -> _Passed:
    found = _Passed(at.squares, at.equation, at.terms, at.at_mass, None)
    try:
        system = None if weights is None else at.normal(weights).condense(damping)
    except np.linalg.LinAlgError:
        return found
    if system is None:
        return found
    # single precision: a step needs no more
    solution = system.solution.astype(np.float32)
    shelf = shelf if shelf is not None and shelf.put(solution) else None
    system = system._replace(solution=np.empty((0, 0)) if shelf else solution)  # a view would keep the array
    return found._replace(system=system, shelf=shelf)


def _is_far(at: Linearisation, system: Condensed | None) -> bool:
    """Whether the curve, for fixed coefficients, is far from its optimum."""
    return system is None or system.reach[0] > _FAR * at.observations.counts.sum()


def _residuals(block: _Block, points: np.ndarray) -> list[np.ndarray]:
    return _seen(block).residuals(points)


def _freedom(block: _Block, point: _Point, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
    return _linearised(block, point).freedom(weights)


def _score(
    block: _Block,
    point: _Point,
    score: Callable[..., Any],
    weights: Weights,
    candidates: EulerLagrange,
) -> Any:
    part = score(_linearised(block, point), weights, candidates)
    return replace(part, factor=part.factor.logdet, border=None)


def _border(
    block: _Block, point: _Point, weights: Weights, candidates: EulerLagrange, step: np.ndarray
) -> np.ndarray:
    return CandidateBorder(_linearised(block, point), weights, candidates)(step)


def _solve(block: _Block, point: _Point, weights: Weights, damping: float, right: np.ndarray) -> np.ndarray:
    return BandedFactor.of(_linearised(block, point).normal(weights).rows, damping).solve(right)
