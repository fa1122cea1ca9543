"""Values at the quadrature points, laid out by knot interval.

Terms are evaluated at all points of a run at once. Normal equations sum matrices interval by interval. The
transposition in between runs in pieces that fit the processor's cache.
"""

from __future__ import annotations

import numpy as np

from leastaction.curve.bspline import SplineGrid
from leastaction.mechanics import Columns
from leastaction.mechanics.euler_lagrange import Points

__all__ = [
    "by_interval",
    "by_point",
    "column_products",
    "column_sums",
    "first_points",
    "local_jacobian",
    "points_at",
]

_TRANSPOSED, _STRIPE = 128, 256  # knot intervals of a piece
_CHUNK = 512  # knot intervals whose columns are in memory at once


def points_at(grid: SplineGrid, control_points: np.ndarray, chunk: slice) -> Points:
    """States at the quadrature points of a run of knot intervals: quadrature point, then interval."""
    n = control_points.shape[1]
    states = grid.at_quadrature(control_points, chunk)
    q, qdot, qddot = (s.transpose(1, 0, 2).reshape(-1, n) for s in states)
    return Points(q, qdot, qddot, lambda: grid.points[chunk].T.ravel(), intervals=chunk)


def first_points(grid: SplineGrid, control_points: np.ndarray, chunk: slice = slice(None)) -> Points:
    """States at the first quadrature point of each of some knot intervals."""
    q, qdot, qddot = (s[:, 0] for s in grid.at_quadrature(control_points, chunk))
    return Points(q, qdot, qddot, lambda: grid.points[chunk, 0], intervals=chunk)


def by_interval(values: np.ndarray, out: np.ndarray) -> None:
    """Copy (n_columns, n_dof, n_points) values to (n_intervals, n_dof, n_quadrature, n_columns)."""
    n_columns, n, _ = values.shape
    m, n_quad = out.shape[0], out.shape[2]
    values = values.reshape(n_columns, n, n_quad, m)
    for a in range(0, m, _TRANSPOSED):  # in pieces that fit the processor's cache: five times faster
        out[a : a + _TRANSPOSED] = values[..., a : a + _TRANSPOSED].transpose(3, 1, 2, 0)


def local_jacobian(
    grid: SplineGrid, jacobian: dict[tuple[int, int, int], np.ndarray], root: np.ndarray, chunk: slice, n: int
) -> np.ndarray:
    """∂(scaled residual)/∂(local control points): (n_intervals, n_dof, n_quadrature, (degree + 1) n_dof)."""
    basis = [grid.quadrature_basis(chunk, nu) for nu in range(3)]
    m, n_quad, n_basis = basis[0].shape
    local = np.empty((m, n, n_quad, n_basis, n))
    scaled = {key: (root * value).reshape(n_quad, 1, m) for key, value in jacobian.items()}
    for a in range(0, m, _STRIPE):  # in pieces that fit the processor's cache, intervals innermost
        run = slice(a, min(a + _STRIPE, m))
        parts = [np.ascontiguousarray(values[run].transpose(1, 2, 0)) for values in basis]
        sums, product = np.zeros((n, n_quad, n, *parts[0].shape[1:])), np.empty_like(parts[0])
        for (nu, i, j), value in scaled.items():
            sums[i, :, j] += np.multiply(value[:, :, run], parts[nu], out=product)
        local[run] = sums.transpose(4, 0, 1, 3, 2)
    return local.reshape(m, n, n_quad, n_basis * n)


def by_point(values: np.ndarray) -> np.ndarray:
    """(n, n_intervals, n_quadrature, n_dof) → (n, n_dof, n_points), in the sequence of `Points`."""
    return values.transpose(0, 3, 2, 1).reshape(len(values), values.shape[3], -1)


def column_sums(
    grid: SplineGrid, control_points: np.ndarray, columns: Columns, coefficients: np.ndarray
) -> np.ndarray:
    """(n_intervals, n_quadrature, n_dof) columns times their coefficients, summed."""
    parts: list[np.ndarray] = []
    for chunk in grid.chunks(_CHUNK):
        sums = np.tensordot(coefficients, columns.strong(points_at(grid, control_points, chunk)), 1)
        parts.append(sums.reshape(len(sums), grid.n_quadrature, -1).transpose(2, 1, 0))
    return np.concatenate(parts)


def column_products(
    grid: SplineGrid, control_points: np.ndarray, columns: Columns, more: np.ndarray, used: np.ndarray
) -> np.ndarray:
    """Integrals of the products of columns, and of given values after them, in each equation.

    Parameters
    ----------
    more : (n_more, n_intervals, n_quadrature, n_dof) array
    used : (n_intervals, n_dof) array
        1 where an equation is used, else 0.

    Returns
    -------
    (n_dof, n, n) array
    """
    n, k, size = control_points.shape[1], len(columns), len(columns) + len(more)
    out = np.zeros((n, size, size))
    for chunk in grid.chunks(_CHUNK):
        points = points_at(grid, control_points, chunk)
        rows = np.empty((size, n, int(points.n_points)))
        rows[:k] = columns.strong(points)
        rows[k:] = by_point(more[:, chunk])
        rows *= np.sqrt(grid.weights[chunk].T.ravel())
        rows *= np.tile(used[chunk], (grid.n_quadrature, 1)).T
        for i in range(n):
            out[i] += rows[:, i] @ rows[:, i].T
    return out
