"""Weak Euler–Lagrange form: the action principle tried against compact test functions.

For a test function χ that vanishes with its derivative at both ends,

    ∫ (χ̇ ∂L/∂q̇_i + χ ∂L/∂q_i − χ ∂ψ/∂q̇_i + χ f_i) dt = 0,

which is linear in the coefficients and needs no q̈.  Every column splits into an inertial part
I = ∫ χ̇ ∂φ/∂q̇ dt and a potential part V = ∫ χ (…) dt; their Gram matrices are all that the search needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from leastaction._euler_lagrange import EulerLagrange, Points
from leastaction._spline import SplineGrid

__all__ = ["WeakGram", "weak_gram"]

_BLOCK = 16384  # quadrature points handled at once


@dataclass(frozen=True, eq=False)
class WeakGram:
    """Gram matrices over all test functions, coordinates and trajectories.

    Attributes
    ----------
    total : (n, n) array
        (I + V)ᵀ(I + V).
    parts : (n, n) array
        ½ (IᵀI + VᵀV).
    n_rows : int
        The last column, n − 1, is the known one: known terms with their coefficients, and the forces.
    """

    total: np.ndarray
    parts: np.ndarray
    n_rows: int


def _test_functions(
    points: np.ndarray, weights: np.ndarray, width: float, hop: float
) -> tuple[np.ndarray, ...]:
    """χ = (1 − x²)⁴ and χ̇ times quadrature weights, one row a window, as two sparse matrices."""
    start, stop = points[0], points[-1]
    n_windows = max(1, int((stop - start - width) / hop) + 1)
    centres = start + 0.5 * width + hop * np.arange(n_windows)
    low = np.searchsorted(points, centres - 0.5 * width)
    high = np.searchsorted(points, centres + 0.5 * width)
    lengths = high - low
    rows = np.repeat(np.arange(n_windows), lengths)
    columns = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths) + low[rows]
    x = (points[columns] - centres[rows]) / (0.5 * width)
    inside = np.clip(1.0 - x**2, 0.0, None)
    shape = (n_windows, points.size)
    chi = sp.csr_array((inside**4 * weights[columns], (rows, columns)), shape=shape)
    chi_dot = sp.csr_array(
        (-8.0 * x * inside**3 / (0.5 * width) * weights[columns], (rows, columns)), shape=shape
    )
    return chi, chi_dot, low, high


def weak_gram(
    grid: SplineGrid,
    control_points: np.ndarray,
    columns: EulerLagrange,
    known: np.ndarray,
    forces: np.ndarray | None,
    width: float,
    scale: np.ndarray,
) -> WeakGram:
    """Gram matrices of the weak form along a smoothed curve.

    Parameters
    ----------
    known : (n_columns,) array
        Known coefficients, NaN where free.
    forces : (n_intervals, n_quadrature, n_dof) array or None
    width : float
        Support of a test function in seconds.
    scale : (n_dof,) array
        Typical rate of each coordinate: turns each equation into a power, so that units do not matter.
    """
    is_free = np.isnan(known)
    n = int(is_free.sum()) + 1
    total, parts, n_rows = np.zeros((n, n)), np.zeros((n, n)), 0
    for k in range(len(grid.spaces)):
        mine = grid.owner == k
        index = np.flatnonzero(mine)
        chunk = slice(index[0], index[-1] + 1)
        q, qdot, _ = (s.reshape(-1, s.shape[2]) for s in grid.at_quadrature(control_points, chunk))
        f = None if forces is None else forces[chunk].reshape(-1, q.shape[1])
        times, weights = grid.points[chunk].ravel(), grid.weights[chunk].ravel()
        span = times[-1] - times[0]
        size = min(width, 0.9 * span)
        chi, chi_dot, low, high = _test_functions(times, weights, size, size / 6.0)
        row = 0
        while row < low.size:
            last = max(row + 1, int(np.searchsorted(high, low[row] + _BLOCK)))
            here = slice(low[row], high[last - 1])
            values = columns.weak(Points(q[here], qdot[here]))
            inertial = _apply(chi_dot[row:last, here], values[0])
            potential = _apply(chi[row:last, here], values[1])
            push = None if f is None else np.asarray(chi[row:last, here] @ f[here])
            i_part, v_part = _with_known(inertial, potential, push, known, is_free)
            i_part *= scale[None, :, None]
            v_part *= scale[None, :, None]
            i_flat, v_flat = i_part.reshape(-1, n), v_part.reshape(-1, n)
            total += (i_flat + v_flat).T @ (i_flat + v_flat)
            parts += 0.5 * (i_flat.T @ i_flat + v_flat.T @ v_flat)
            n_rows += i_flat.shape[0]
            row = last
    return WeakGram(total, parts, n_rows)


def _apply(matrix: sp.csr_array, values: np.ndarray) -> np.ndarray:
    """(n_windows, n_dof, n_columns) integrals of (n_columns, n_dof, n_points) values."""
    n_columns, n_dof, n_points = values.shape
    flat = matrix @ values.reshape(-1, n_points).T
    return np.asarray(flat).reshape(-1, n_columns, n_dof).transpose(0, 2, 1)


def _with_known(inertial, potential, push, known, is_free):
    """Free columns, then one column of everything known."""
    fixed = np.where(is_free, 0.0, known)
    i_known, v_known = inertial @ fixed, potential @ fixed
    if push is not None:
        v_known = v_known + push
    i_part = np.concatenate([inertial[..., is_free], i_known[..., None]], axis=2)
    v_part = np.concatenate([potential[..., is_free], v_known[..., None]], axis=2)
    return i_part, v_part
