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

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from leastaction.curve.bspline import SplineGrid
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

__all__ = ["WeakForm", "WeakGram", "weak_gram"]

_BLOCK = 16384  # quadrature points handled at once
_HOPS = 6  # test functions a width
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
        self.grid, self.forces = grid, forces
        self.equations = np.setdiff1d(np.arange(columns.n_dof), columns.prescribed)
        self.scale = scale[self.equations]
        self._take(columns, known)
        self.widths = tuple(widths)
        owners = [np.flatnonzero(grid.owner == k) for k in range(len(grid.spaces))]
        self._chunks = [slice(index[0], index[-1] + 1) for index in owners]
        self._tests = [
            [
                _TestFunctions(grid.points[c].ravel(), grid.weights[c].ravel(), width, uneven)
                for width in self.widths
            ]
            for c in self._chunks
        ]

    def _take(self, columns: EulerLagrange, known: np.ndarray) -> None:
        self.columns = columns
        self.is_free = np.isnan(known)
        self.fixed = np.where(self.is_free, 0.0, known)

    def of(self, columns: EulerLagrange, known: np.ndarray) -> WeakForm:
        """The same test functions for other columns, without forces."""
        other = copy(self)
        other.forces = None
        other._take(columns, known)
        return other

    def grams(self, control_points: np.ndarray, replicates: Sequence[np.ndarray]) -> list[WeakGram]:
        """Quadratic forms of each width along a curve, with replicates of it for the noise."""
        here = self.rows(control_points)
        totals = [np.zeros_like(inertial) for inertial, _ in here]
        squares = [np.zeros((t.shape[1], t.shape[1])) for t in totals]
        for curve in replicates:
            for total, square, (inertial, potential) in zip(totals, squares, self.rows(curve), strict=True):
                again = inertial + potential
                total += again
                square += again.T @ again
        return [
            weak_gram(*parts, total / len(replicates), square, len(replicates))
            for parts, total, square in zip(here, totals, squares, strict=True)
        ]

    def rows(self, control_points: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each width the two parts of the rows, inertial and potential, (n_rows, n_columns) each."""
        rows: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in self.widths]
        for chunk, tests in zip(self._chunks, self._tests, strict=True):
            q, qdot, _ = (s.reshape(-1, s.shape[2]) for s in self.grid.at_quadrature(control_points, chunk))
            times = self.grid.points[chunk].ravel()
            forces = None if self.forces is None else self.forces[chunk].reshape(-1, q.shape[1])
            overlap = max(test.overlap for test in tests)
            for start in range(0, max(1, len(q) - overlap), _BLOCK):
                here = slice(start, min(start + _BLOCK + overlap, len(q)))
                values = self.columns.weak(Points(q[here], qdot[here], times=times[here]))
                force = None if forces is None else forces[here]
                for w, test in enumerate(tests):
                    rows[w].append(test.apply(values, force, here, _BLOCK, self))
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


class _TestFunctions:
    """χ = (1 − x²)⁴ and χ̇ times quadrature weights on one trajectory, one window a row."""

    def __init__(self, points: np.ndarray, weights: np.ndarray, width: float, uneven: bool) -> None:
        span = float(points[-1] - points[0])
        width = min(width, 0.9 * span)
        hop = width / _HOPS
        n_windows = max(1, int((span - width) / hop) + 1)
        places: np.ndarray = np.arange(n_windows, dtype=float)
        if uneven:  # each up to half a distance earlier, the first where it is
            places = places - 0.5 * np.mod(_GOLDEN * places, 1.0)
        centres: np.ndarray = points[0] + 0.5 * width + hop * places
        self.low = np.searchsorted(points, centres - 0.5 * width)
        self.high = np.searchsorted(points, centres + 0.5 * width)
        lengths = self.high - self.low
        self.overlap = int(lengths.max())
        rows = np.repeat(np.arange(n_windows), lengths)
        columns = (
            np.arange(int(lengths.sum())) - np.repeat(np.cumsum(lengths) - lengths, lengths) + self.low[rows]
        )
        x = (points[columns] - centres[rows]) / (0.5 * width)
        inside = np.clip(1.0 - x**2, 0.0, None)
        shape = (n_windows, points.size)
        self.chi = sp.csr_array((inside**4 * weights[columns], (rows, columns)), shape=shape)
        slope = -8.0 * x * inside**3 / (0.5 * width) * weights[columns]
        self.chi_dot = sp.csr_array((slope, (rows, columns)), shape=shape)

    def apply(
        self, values: np.ndarray, forces: np.ndarray | None, here: slice, block: int, form: WeakForm
    ) -> tuple[np.ndarray, np.ndarray]:
        """Both parts of the rows of the windows that begin in the block."""
        mine = np.flatnonzero(
            (self.low >= here.start) & (self.low < here.start + block) & (self.high <= here.stop)
        )
        chi, chi_dot = self.chi[mine][:, here], self.chi_dot[mine][:, here]
        push = None if forces is None else np.asarray(chi @ forces)
        return form.join_known(_integrals(chi_dot, values[0]), _integrals(chi, values[1]), push)


def _integrals(matrix: sp.csr_array, values: np.ndarray) -> np.ndarray:
    """(n_windows, n_dof, n_columns) integrals of (n_columns, n_dof, n_points) values."""
    n_columns, n_dof, n_points = values.shape
    flat = matrix @ values.reshape(-1, n_points).T
    return np.asarray(flat).reshape(-1, n_columns, n_dof).transpose(0, 2, 1)
