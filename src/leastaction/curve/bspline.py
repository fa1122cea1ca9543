"""Clamped B-splines: knots, basis and derivative bases, quadrature, evaluation.

One :class:`SplineSpace` belongs to one trajectory.  A :class:`SplineGrid` holds the spaces of all
trajectories side by side: control points are numbered through, nothing couples two trajectories.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

__all__ = ["SplineGrid", "SplineSpace", "uniform_grid", "uniform_space"]


@dataclass(frozen=True, eq=False)
class SplineSpace:
    r"""Clamped B-splines of one trajectory.

    Parameters
    ----------
    degree : int
        Degree p ≥ 3 of the splines (3 = cubic).
    breakpoints : (n_intervals + 1,) array
        Strictly increasing times in seconds; the end points are repeated p more times in ``knots``.

    Notes
    -----
    The basis obeys the Cox–de Boor recursion and its derivative the recursion (de Boor 2001, ch. X;
    appendix of Zhang & Sun 2026)

    .. math:: N'_{i,p}(t) = \frac{p}{t_{i+p}-t_i} N_{i,p-1}(t)
                          - \frac{p}{t_{i+p+1}-t_{i+1}} N_{i+1,p-1}(t).

    Examples
    --------
    >>> space = SplineSpace(3, np.linspace(0.0, 1.0, 6))
    >>> space.n_ctrl
    8
    >>> bool(np.allclose(space.basis([0.0, 0.5, 1.0]).sum(axis=1), 1.0))
    True
    """

    degree: int
    breakpoints: np.ndarray

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.breakpoints, dtype=float)
        if self.degree < 3:
            raise ValueError(f"degree {self.degree} is too low: q̈ must be continuous; use 3 or more")
        if points.ndim != 1 or points.size < 2 or not np.all(np.diff(points) > 0):
            raise ValueError("breakpoints must be a strictly increasing 1-D array of at least two times")
        object.__setattr__(self, "breakpoints", points)

    @property
    def n_intervals(self) -> int:
        return self.breakpoints.size - 1

    @property
    def n_ctrl(self) -> int:
        return self.n_intervals + self.degree

    @cached_property
    def knots(self) -> np.ndarray:
        """(n_ctrl + degree + 1,) clamped knot vector."""
        ends = np.ones(self.degree)
        return np.concatenate([ends * self.breakpoints[0], self.breakpoints, ends * self.breakpoints[-1]])

    def interval_of(self, x: np.ndarray) -> np.ndarray:
        """Index of the knot interval that holds each time; the last one is closed."""
        return np.clip(np.searchsorted(self.breakpoints, x, side="right") - 1, 0, self.n_intervals - 1)

    def local_basis(self, x: np.ndarray, nu: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """The degree + 1 basis functions that live at each time.

        Parameters
        ----------
        x : (n_points,) array
            Times within the breakpoints.
        nu : int
            Derivative, 0 ≤ nu ≤ degree.

        Returns
        -------
        first : (n_points,) int array
            Number of the first control point that matters at each time.
        values : (n_points, degree + 1) array
        """
        x = np.asarray(x, dtype=float)
        first = self.interval_of(x)
        start = self.degree - nu
        t = self.knots
        position = first + self.degree  # knots[position] <= x < knots[position + 1]
        values = np.ones((x.size, 1))
        for p in range(1, start + 1):  # Cox–de Boor, raising the degree
            raised = np.zeros((x.size, p + 1))
            for j in range(p):
                left, right = t[position - p + 1 + j], t[position + 1 + j]
                share = values[:, j] / (right - left)
                raised[:, j] += (right - x) * share
                raised[:, j + 1] += (x - left) * share
            values = raised
        for p in range(start + 1, self.degree + 1):  # the derivative recursion
            raised = np.zeros((x.size, p + 1))
            for j in range(p):
                slope = p * values[:, j] / (t[position + 1 + j] - t[position - p + 1 + j])
                raised[:, j] -= slope
                raised[:, j + 1] += slope
            values = raised
        return first, values

    def basis(self, x: ArrayLike, nu: int = 0) -> sp.csr_array:
        """Design matrix N, Ṅ, N̈, … as a sparse (n_points, n_ctrl) array."""
        x = np.asarray(x, dtype=float)
        first, values = self.local_basis(x, nu)
        count = x.size * (self.degree + 1)
        kind = np.int32 if max(count, self.n_ctrl) <= np.iinfo(np.int32).max else np.int64  # half the memory
        columns = first.astype(kind)[:, None] + np.arange(self.degree + 1, dtype=kind)
        pointers = np.arange(0, count + 1, self.degree + 1, dtype=kind)
        return sp.csr_array((values.ravel(), columns.ravel(), pointers), shape=(x.size, self.n_ctrl))

    def evaluate(self, control_points: np.ndarray, x: np.ndarray, nu: int = 0) -> np.ndarray:
        """Derivative ``nu`` of the curve at times x: (n_points, n_dof)."""
        return np.asarray(BSpline(self.knots, control_points, self.degree)(x, nu=nu))


def uniform_space(start: float, stop: float, knots_per_second: float, degree: int = 5) -> SplineSpace:
    """Space with equal knot intervals on [start, stop], at least four of them."""
    n_intervals = max(4, int(np.ceil((stop - start) * knots_per_second - 1e-9)))
    return SplineSpace(degree, np.linspace(start, stop, n_intervals + 1))


class SplineGrid:
    """The spline spaces of all trajectories, numbered through.

    Parameters
    ----------
    spaces : sequence of SplineSpace
        All of one degree.
    n_quadrature : int
        Gauss–Legendre points in each knot interval; with a single one, points of collocation, which see
        every spline: the left knot for odd degrees, the midpoint for even ones.
    before, total : int, optional
        Where the grid is a part of another one: knot intervals before it, and in all.

    Attributes
    ----------
    n_ctrl, n_intervals : int
        Totals over the trajectories.
    offsets : (n_trajectories + 1,) int array
        Number of the first control point of each trajectory, and ``n_ctrl``.
    """

    def __init__(
        self,
        spaces: Sequence[SplineSpace],
        n_quadrature: int = 3,
        *,
        before: int = 0,
        total: int | None = None,
    ) -> None:
        self.spaces: tuple[SplineSpace, ...] = tuple(spaces)
        self.degree: int = self.spaces[0].degree
        self.n_quadrature: int = n_quadrature
        counts = np.array([s.n_ctrl for s in self.spaces])
        self.offsets: np.ndarray = np.concatenate([[0], np.cumsum(counts)])
        self.n_ctrl: int = int(self.offsets[-1])
        self.n_intervals: int = self.n_ctrl - self.degree * len(self.spaces)
        self.before: int = before
        self.total: int = self.n_intervals if total is None else total
        nodes, weights = np.polynomial.legendre.leggauss(n_quadrature)
        if n_quadrature == 1 and self.degree % 2:  # at midpoints the fastest spline vanishes
            nodes = nodes - 1.0
        self._rule = nodes, weights

    # What takes memory for every knot interval is made when it is asked for: of a long motion whose parts
    # are looked at one by one it never is.
    @cached_property
    def first(self) -> np.ndarray:
        """(n_intervals,) number of the first control point of each interval."""
        return np.concatenate(
            [o + np.arange(s.n_intervals) for o, s in zip(self.offsets[:-1], self.spaces, strict=True)],
            dtype=np.int32,
        )

    @cached_property
    def owner(self) -> np.ndarray:
        """(n_intervals,) trajectory of each interval."""
        return np.repeat(np.arange(len(self.spaces)), [s.n_intervals for s in self.spaces])

    @cached_property
    def points(self) -> np.ndarray:
        """(n_intervals, n_quadrature) quadrature times."""
        return np.concatenate([self.points_of(k) for k in range(len(self.spaces))])

    @cached_property
    def weights(self) -> np.ndarray:
        """(n_intervals, n_quadrature) quadrature weights, which sum to the total duration."""
        widths = np.concatenate([np.diff(s.breakpoints) for s in self.spaces])
        return 0.5 * widths[:, None] * self._rule[1]

    @property
    def duration(self) -> float:
        """Sum of the durations of all trajectories, in seconds."""
        return float(sum(s.breakpoints[-1] - s.breakpoints[0] for s in self.spaces))

    def points_of(self, trajectory: int) -> np.ndarray:
        """(n_intervals of one trajectory, n_quadrature) quadrature times."""
        breakpoints = self.spaces[trajectory].breakpoints
        return breakpoints[:-1, None] + 0.5 * np.diff(breakpoints)[:, None] * (self._rule[0] + 1.0)

    @cached_property
    def _quadrature_tables(self) -> tuple[np.ndarray, np.ndarray]:
        """Pattern of each interval, and (n_patterns, 3, n_quadrature, degree + 1) basis values of q, q̇, q̈.

        Away from the clamped ends all intervals of a uniform space look alike, so 2p + 1 patterns
        a trajectory are enough and memory does not grow with its length.
        """
        patterns: list[np.ndarray] = []
        tables: list[np.ndarray] = []
        total = 0
        for k, space in enumerate(self.spaces):
            m, p = space.n_intervals, self.degree
            points = self.points_of(k)
            keep = np.arange(m) if m <= 2 * p else np.r_[0 : p + 1, m - p : m]
            if m > 2 * p and not np.allclose(
                np.diff(space.breakpoints), space.breakpoints[1] - space.breakpoints[0]
            ):
                keep = np.arange(m)
            index = np.arange(m) if keep.size == m else np.r_[0:p, np.full(m - 2 * p, p), p + 1 : 2 * p + 1]
            patterns.append(total + index)
            total += keep.size
            values = [space.local_basis(points[keep].ravel(), nu)[1] for nu in range(3)]
            tables.append(np.stack([v.reshape(keep.size, -1, p + 1) for v in values], axis=1))
        return np.concatenate(patterns), np.concatenate(tables)

    def quadrature_basis(self, chunk: slice, nu: int) -> np.ndarray:
        """(n_intervals in chunk, n_quadrature, degree + 1) basis values at the quadrature points."""
        patterns, tables = self._quadrature_tables
        return tables[patterns[chunk], nu]

    def local_control_points(self, control_points: np.ndarray, chunk: slice) -> np.ndarray:
        """(n_intervals in chunk, degree + 1, n_dof) control points that matter in each interval."""
        return control_points[self.first[chunk, None] + np.arange(self.degree + 1)]

    def at_quadrature(
        self, control_points: np.ndarray, chunk: slice = slice(None), most: int = 2
    ) -> list[np.ndarray]:
        """q, q̇, q̈ at the quadrature points, each (n_intervals, n_quadrature, n_dof), up to one derivative."""
        patterns, tables = self._quadrature_tables
        basis = tables[patterns[chunk], : most + 1]
        # one product an interval: three would take three times as long
        basis = basis.reshape(len(basis), -1, self.degree + 1)
        return np.split(basis @ self.local_control_points(control_points, chunk), most + 1, axis=1)

    def chunks(self, size: int) -> list[slice]:
        """Runs of at most ``size`` knot intervals; one may hold several short trajectories."""
        return [slice(a, min(a + size, self.n_intervals)) for a in range(0, self.n_intervals, size)]

    def part(self, intervals: slice) -> SplineGrid:
        """Some successive knot intervals, with their control points numbered from zero.

        The basis is that of the whole grid: a trajectory may be cut, and neighbouring parts share control
        points.  The part serves sums over quadrature points; samples and curves belong to the whole grid.
        """
        out = SplineGrid(
            self.spaces, self.n_quadrature, before=self.before + intervals.start, total=self.total
        )
        patterns, tables = self._quadrature_tables
        first = self.first[intervals]
        vars(out).update(
            first=first - first[0],
            owner=self.owner[intervals],
            points=self.points[intervals],
            weights=self.weights[intervals],
            _quadrature_tables=(patterns[intervals], tables),
            n_intervals=first.size,
            n_ctrl=int(first[-1] - first[0]) + self.degree + 1,
        )
        return out

    def points_within(self, intervals: slice) -> slice:
        """The control points that matter in some successive knot intervals."""
        return slice(int(self.first[intervals.start]), int(self.first[intervals.stop - 1]) + self.degree + 1)

    def _runs(self, chunk: slice) -> list[tuple[slice, int]]:
        """Parts of a chunk within one trajectory, each with the number of its first control point."""
        owner = self.owner[chunk]
        cuts = [0, *(np.flatnonzero(np.diff(owner)) + 1), owner.size]
        return [(slice(a, b), int(self.first[chunk.start + a])) for a, b in pairwise(cuts)]

    def add_products(self, rows: np.ndarray, products: np.ndarray, chunk: slice, origin: int = 0) -> None:
        """Add what each knot interval contributes to its control points.

        Parameters
        ----------
        rows : (n_points, …) array
            One row for each control point from ``origin`` on.
        products : (n_intervals in chunk, degree + 1, …) array
        """
        for run, first in self._runs(chunk):
            start, length = first - origin, run.stop - run.start
            for a in range(self.degree + 1):
                rows[start + a : start + a + length] += products[run, a]

    def add_gram(self, rows: np.ndarray, blocks: np.ndarray, chunk: slice) -> None:
        """Add symmetric matrices over the local control points of each knot interval to block rows.

        Parameters
        ----------
        rows : (n_ctrl, n_dof, (degree + 1) n_dof) array
            ``rows[p, i]`` is the row of coordinate i of control point p, from the columns of p on.
        blocks : (n_intervals in chunk, (degree + 1) n_dof, (degree + 1) n_dof) array
        """
        n, size = rows.shape[1:]
        for run, first in self._runs(chunk):
            length = run.stop - run.start
            for a in range(self.degree + 1):
                rows[first + a : first + a + length, :, : size - a * n] += blocks[
                    run, a * n : (a + 1) * n, a * n :
                ]

    def local_gram(self, rows: np.ndarray, chunk: slice) -> np.ndarray:
        """Block rows → (n_intervals in chunk, k, k) local matrices whose lower blocks are left zero.

        The inverse of :meth:`add_gram` as far as indices go.
        """
        n, size = rows.shape[1:]
        first = self.first[chunk]
        out = np.zeros((first.size, size, size))
        for a in range(self.degree + 1):
            out[:, a * n : (a + 1) * n, a * n :] = rows[first + a, :, : size - a * n]
        return out

    def design(self, times: Sequence[np.ndarray], nu: int = 0) -> sp.csr_array:
        """Block-diagonal design matrix for one array of times per trajectory."""
        width = self.degree + 1
        total = sum(len(t) for t in times)
        index = np.int32 if total * width < 2**31 else np.int64
        values, columns = np.empty((total, width)), np.empty((total, width), dtype=index)
        start = 0
        for space, offset, t in zip(self.spaces, self.offsets, times, strict=False):
            rows = slice(start, start + len(t))
            first, values[rows] = space.local_basis(t, nu)
            columns[rows] = (offset + first)[:, None] + np.arange(width)
            start = rows.stop
        pointers = np.arange(total + 1, dtype=index) * index(width)
        return sp.csr_array((values.ravel(), columns.ravel(), pointers), shape=(total, self.n_ctrl))

    def split(self, control_points: np.ndarray) -> list[np.ndarray]:
        """Control points of each trajectory, (n_ctrl_k, n_dof) each."""
        return np.split(control_points, self.offsets[1:-1])

    def evaluate(
        self, control_points: np.ndarray, times: Sequence[np.ndarray], nu: int = 0
    ) -> list[np.ndarray]:
        """Derivative ``nu`` of every trajectory's curve at its own times."""
        parts = self.split(control_points)
        return [s.evaluate(p, t, nu) for s, p, t in zip(self.spaces, parts, times, strict=True)]


def uniform_grid(
    times: Sequence[np.ndarray], knots_per_second: float, degree: int, n_quadrature: int = 3
) -> SplineGrid:
    """One uniform spline space for the times of each trajectory."""
    return SplineGrid([uniform_space(t[0], t[-1], knots_per_second, degree) for t in times], n_quadrature)
