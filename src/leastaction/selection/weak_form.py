"""Weak Euler–Lagrange form: the action principle tried against compact test functions.

For a test function χ that vanishes with its derivative at both ends,

    ∫ (χ̇ ∂L/∂q̇_i + χ ∂L/∂q_i − χ ∂ψ/∂q̇_i + χ f_i) dt = 0,

which is linear in the coefficients and needs no q̈.  One row is one test function and one coordinate, one
column one candidate; the last column is everything known: known terms with their coefficients, and forces.

The noise of the measurements reaches the rows through the smoothed curve.  How, is found by measuring the
smoothed curve again: replicates of it, with new noise, smoothed alike, give the covariance of the rows'
errors, as a quadratic form in the coefficients, and their bias, which is taken off.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from leastaction.curve.bspline import SplineGrid
from leastaction.curve.smoothing import Smooth
from leastaction.estimation.grid import Grid
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

__all__ = ["WeakForm", "WeakGram", "weak_form", "weak_gram", "weak_grams", "weak_replicates"]

_BLOCK = 16384  # quadrature points handled at once
_WIDTHS = (1.0, 0.5, 2.0)  # of the test functions, in periods of the fastest coordinate
_HOPS = 6  # test functions a width
_REPLICATES = 8  # of the noise: their mean and covariance
_GOLDEN = 0.6180339887498949  # its multiples, less their integers, are spread evenly


@dataclass(frozen=True, eq=False)
class WeakGram:
    """Quadratic forms over all rows of one width.

    Attributes
    ----------
    residual : (n, n) array
        λᵀ residual λ = Σ (row residual)², λ over the free columns and the known one.
    noise : (n, n) array
        λᵀ noise λ: what noise makes of that sum on average if λ is the truth.
    size : (n, n) array
        λᵀ size λ = ½ Σ (I² + V²): the scale of the rows themselves.
    n_rows : int
    """

    residual: np.ndarray
    noise: np.ndarray
    size: np.ndarray
    n_rows: int


def weak_gram(
    inertial: np.ndarray, potential: np.ndarray, mean: np.ndarray, square: np.ndarray, count: int
) -> WeakGram:
    """Quadratic forms from the two parts of the rows along a curve, and those along replicates of it.

    Parameters
    ----------
    inertial, potential : (n_rows, n_columns) arrays
    mean : (n_rows, n_columns) array
        Of the rows of the replicates.
    square : (n_columns, n_columns) array
        Sum of their Gram matrices.
    count : int
        Replicates.
    """
    row = inertial + potential
    spread = (square - count * (mean.T @ mean)) / (count - 1)
    corrected = 2.0 * row - mean  # less the bias, mean − row
    size = 0.5 * (inertial.T @ inertial + potential.T @ potential)
    return WeakGram(corrected.T @ corrected, spread * (1.0 + 1.0 / count), size, row.shape[0])


class WeakForm:
    """Rows of the weak form for several widths of the test functions.

    Parameters
    ----------
    grid : SplineGrid
    columns : EulerLagrange
    known : (n_columns,) array
        Known coefficients, NaN where free.
    forces : (n_intervals, n_quadrature, n_dof) array or None
    widths : sequence of float
        Supports of the test functions in seconds.
    scale : (n_dof,) array
        Typical rate of each coordinate: turns each equation into a power, so that units do not matter.
    uneven : bool
        Whether the distances of the test functions differ.  At even distances h, a force cos ω t looks like
        one of frequency 2π/h − ω, and larger.
    """

    def __init__(
        self,
        grid: SplineGrid,
        columns: EulerLagrange,
        known: np.ndarray,
        forces: np.ndarray | None,
        widths: Sequence[float],
        scale: np.ndarray,
        uneven: bool = False,
    ) -> None:
        self.grid: SplineGrid = grid
        self.forces: np.ndarray | None = forces
        self.equations: np.ndarray = np.setdiff1d(np.arange(columns.n_dof), columns.prescribed)
        self.scale: np.ndarray = scale[self.equations]
        self._take(columns, known)
        self.widths: tuple[float, ...] = tuple(widths)
        owners = [np.flatnonzero(grid.owner == k) for k in range(len(grid.spaces))]
        chunks = [slice(index[0], index[-1] + 1) for index in owners]
        blocks = [
            _in_blocks(
                [_Windows.lay(points, width, uneven) for width in self.widths], grid.weights[c].ravel()
            )
            for c, points in ((c, grid.points[c].ravel()) for c in chunks)
        ]
        self._laid = _side_by_side(list(zip(chunks, blocks, strict=True)))

    def _take(self, columns: EulerLagrange, known: np.ndarray) -> None:
        self.columns = columns
        self.is_free: np.ndarray = np.isnan(known)
        self.fixed: np.ndarray = np.where(self.is_free, 0.0, known)

    def of(self, columns: EulerLagrange, known: np.ndarray) -> WeakForm:
        """The same test functions for other columns, without forces."""
        other = copy(self)
        other.forces = None
        other._take(columns, known)
        return other

    def grams(self, control_points: np.ndarray, replicates: Sequence[np.ndarray]) -> list[WeakGram]:
        """Quadratic forms of each width along a curve, with replicates of it for the noise."""
        here = self.rows(self.states(control_points))
        totals = [np.zeros_like(inertial) for inertial, _ in here]
        squares = [np.zeros((t.shape[1], t.shape[1])) for t in totals]
        for curve in replicates:
            for total, square, (inertial, potential) in zip(
                totals, squares, self.rows(self.states(curve)), strict=True
            ):
                again = inertial + potential
                total += again
                square += again.T @ again
        return [
            weak_gram(*parts, total / len(replicates), square, len(replicates))
            for parts, total, square in zip(here, totals, squares, strict=True)
        ]

    def states(self, control_points: np.ndarray) -> Iterator[Points]:
        """Points of a curve, block by block; a list of them serves for several calls of `rows`."""
        for chunk, blocks in self._laid:
            q, qdot = (
                s.reshape(-1, s.shape[2]) for s in self.grid.at_quadrature(control_points, chunk, most=1)
            )
            times = self.grid.points[chunk].ravel()
            for block in blocks:
                yield Points(q[block.here], qdot[block.here], times=times[block.here])

    def rows(self, states: Iterable[Points]) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each width the two parts of the rows, inertial and potential, (n_rows, n_columns) each."""
        rows: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in self.widths]
        blocks = ((chunk, block) for chunk, blocks in self._laid for block in blocks)
        for (chunk, block), points in zip(blocks, states, strict=True):
            values = self.columns.weak(points)
            forces = None
            if self.forces is not None:
                forces = self.forces[chunk].reshape(-1, self.columns.n_dof)[block.here]
            for w, (chi, chi_dot) in enumerate(block.tests):
                push = None if forces is None else np.asarray(chi @ forces)
                parts = _integrals(chi_dot, values[0]), _integrals(chi, values[1])
                rows[w].append(self.join_known(*parts, push))
        return [(np.concatenate([i for i, _ in r]), np.concatenate([v for _, v in r])) for r in rows]

    def join_known(
        self, inertial: np.ndarray, potential: np.ndarray, push: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Free columns, then one column of everything known; rows flattened and scaled."""
        i_known, v_known = inertial @ self.fixed, potential @ self.fixed
        if push is not None:
            v_known = v_known + push
        return self._joined(inertial, i_known), self._joined(potential, v_known)

    def _joined(self, part: np.ndarray, known: np.ndarray) -> np.ndarray:
        joined = np.concatenate([part[..., self.is_free], known[..., None]], axis=2)[:, self.equations]
        return (joined * self.scale[None, :, None]).reshape(-1, joined.shape[2])


@dataclass(frozen=True, eq=False)
class _Windows:
    """Where the test functions of one width are on one trajectory.

    Attributes
    ----------
    points : (n_points,) array
    centres : (n_windows,) array
    width : float
    low, high : (n_windows,) arrays
        The quadrature points of each window.
    """

    points: np.ndarray
    centres: np.ndarray
    width: float
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def lay(cls, points: np.ndarray, width: float, uneven: bool) -> _Windows:
        """Windows along a trajectory, of a width that leaves room for one."""
        span = float(points[-1] - points[0])
        width = min(width, 0.9 * span)
        hop = width / _HOPS
        places: np.ndarray = np.arange(max(1, int((span - width) / hop) + 1), dtype=float)
        if uneven:  # each up to half a distance earlier, the first where it is
            places = places - 0.5 * np.mod(_GOLDEN * places, 1.0)
        centres: np.ndarray = points[0] + 0.5 * width + hop * places
        low = np.searchsorted(points, centres - 0.5 * width)
        return cls(points, centres, width, low, np.searchsorted(points, centres + 0.5 * width))

    def within(self, here: slice, begin: int, weights: np.ndarray) -> tuple[sp.csr_array, sp.csr_array]:
        """χ = (1 − x²)⁴ and χ̇ times quadrature weights, one window a row, of those that begin in a block."""
        mine = (self.low >= here.start) & (self.low < begin) & (self.high <= here.stop)
        low, lengths = self.low[mine], (self.high - self.low)[mine]
        rows = np.repeat(np.arange(lengths.size), lengths)
        columns = np.arange(int(lengths.sum())) - np.repeat(np.cumsum(lengths) - lengths, lengths) + low[rows]
        x = (self.points[columns] - self.centres[mine][rows]) / (0.5 * self.width)
        inside = np.clip(1.0 - x**2, 0.0, None)
        index, shape = (rows, columns - here.start), (lengths.size, here.stop - here.start)
        slope = -8.0 * x * inside**3 / (0.5 * self.width) * weights[columns]
        return sp.csr_array((inside**4 * weights[columns], index), shape), sp.csr_array((slope, index), shape)


class _Block(NamedTuple):
    """Quadrature points that are handled at once; of each width χ and χ̇ of the windows that begin there."""

    here: slice
    tests: list[tuple[sp.csr_array, sp.csr_array]]

    @classmethod
    def of(cls, blocks: Sequence[_Block]) -> _Block:
        """Blocks of several trajectories, each of which has only one."""
        tests: list[tuple[sp.csr_array, sp.csr_array]] = []
        for width in zip(*(block.tests for block in blocks), strict=True):
            chi, chi_dot = (sp.csr_array(sp.block_diag(part)) for part in zip(*width, strict=True))
            tests.append((chi, chi_dot))
        return cls(slice(0, sum(b.here.stop for b in blocks)), tests)


def _side_by_side(laid: Sequence[tuple[slice, list[_Block]]]) -> list[tuple[slice, list[_Block]]]:
    """Knot intervals and their blocks; short trajectories that follow one another share a block."""
    runs: list[list[tuple[slice, list[_Block]]]] = []
    points = 0
    for intervals, blocks in laid:
        points += blocks[-1].here.stop
        if not runs or points > _BLOCK:
            runs.append([])
            points = blocks[-1].here.stop
        runs[-1].append((intervals, blocks))
    wholes = [slice(run[0][0].start, run[-1][0].stop) for run in runs]
    shared = [run[0][1] if len(run) == 1 else [_Block.of([block for _, (block,) in run])] for run in runs]
    return list(zip(wholes, shared, strict=True))


def _in_blocks(windows: Sequence[_Windows], weights: np.ndarray) -> list[_Block]:
    """The test functions of a trajectory, in blocks that bound memory."""
    overlap = max(int((w.high - w.low).max()) for w in windows)
    out: list[_Block] = []
    for start in range(0, max(1, weights.size - overlap), _BLOCK):
        here = slice(start, min(start + _BLOCK + overlap, weights.size))
        out.append(_Block(here, [w.within(here, start + _BLOCK, weights) for w in windows]))
    return out


def _integrals(matrix: sp.csr_array, values: np.ndarray) -> np.ndarray:
    """(n_windows, n_dof, n_columns) integrals of (n_columns, n_dof, n_points) values."""
    n_columns, n_dof, n_points = values.shape
    flat = matrix @ values.reshape(-1, n_points).T
    return np.asarray(flat).reshape(-1, n_columns, n_dof).transpose(0, 2, 1)


def weak_form(
    grid: Grid,
    curve: Smooth,
    candidates: EulerLagrange,
    known: np.ndarray,
    widths: Sequence[float],
    uneven: bool = False,
) -> WeakForm:
    """The weak form of some candidates, with widths in periods of the fastest coordinate."""
    _, qdot, qddot = grid.spline.at_quadrature(curve.control_points)
    rates, accelerations = ((s**2).mean(axis=(0, 1)) for s in (qdot, qddot))
    period = float(2.0 * np.pi * np.sqrt((rates / np.maximum(accelerations, 1e-300)).min()))
    forces = None if grid.forces is None else grid.forces.values
    seconds = [factor * period for factor in widths]
    return WeakForm(grid.spline, candidates, known, forces, seconds, np.sqrt(rates), uneven)


def weak_grams(grid: Grid, curve: Smooth, seed: int) -> list[WeakGram]:
    """The weak form of a problem along a smooth curve, for each width of test functions."""
    problem = grid.problem
    form = weak_form(grid, curve, problem.candidates, problem.completed(np.nan), _WIDTHS)
    return form.grams(curve.control_points, weak_replicates(grid, curve, seed))


def weak_replicates(grid: Grid, curve: Smooth, seed: int) -> list[np.ndarray]:
    """Curves smoothed from the smooth curve measured again."""
    return curve.replicates(_REPLICATES, np.random.default_rng(seed), grid.observations.noise_floor)
