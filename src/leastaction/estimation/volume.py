"""The log-determinant term: the change of variables from the equation error to the curve."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np

from leastaction.curve.bspline import SplineGrid
from leastaction.estimation.intervals import first_points
from leastaction.mechanics import Columns

__all__ = ["Volume", "add_volumes", "positive_definite", "volume_term"]

_VOLUME_POINTS = 512  # in a chunk, at which |M| is computed
_CHUNK = 4096  # knot intervals handled at once


@dataclass(frozen=True, eq=False)
class Volume:
    """The log-determinant term at one point; see :func:`volume_term`.

    Attributes
    ----------
    log_mean, regular : float
        Mean of log |det M|, and share of the motion along which M is positive definite.
    slope : (n_dof, n_border) array
        Mean over time of (∂M/∂λ_k M⁻¹)_ii.
    corner : (n_border, n_border) array
        Mean over time of tr(∂M/∂λ_k M⁻¹ ∂M/∂λ_l M⁻¹).
    """

    log_mean: float
    regular: float
    slope: np.ndarray
    corner: np.ndarray


def volume_term(
    grid: SplineGrid,
    columns: Columns,
    control_points: np.ndarray,
    coefficients: np.ndarray,
    border: Columns,
) -> Volume:
    """The log-determinant term −2 Σ_i volume_i ⟨log |det M|⟩ of the cost: its value and derivatives in λ.

    The probability model is on the equation error r. The change of variables to the curve contributes the
    factor |∂r/∂q̈| = |det M| for every degree of freedom of the equation error.  Without it the cost rewards
    small coefficients, and large equation errors shrink all of them (errors-in-variables bias).
    """
    k, n = len(border), control_points.shape[1]
    log_mean = regular = 0.0
    slope, corner = np.zeros((n, k)), np.zeros((k, k))
    for some, share in _volume_samples(grid):
        points = first_points(grid, control_points, some)
        mass = columns.mass_matrix(points, coefficients)
        usable = positive_definite(mass)
        regular += share * np.count_nonzero(usable)
        if not usable.any():
            continue
        log_mean += share * float(np.linalg.slogdet(mass[usable])[1].sum())
        moving, each = border.masses(points)
        if not moving:
            continue
        each = each[usable]
        parts = each.reshape(len(each), -1, n) @ np.linalg.inv(mass[usable])
        parts = parts.reshape(each.shape).transpose(1, 0, 2, 3)
        slope[:, moving] += share * np.einsum("kpii->ik", parts)
        turned = parts.transpose(0, 1, 3, 2).reshape(len(moving), -1)
        corner[np.ix_(moving, moving)] += share * (parts.reshape(len(moving), -1) @ turned.T)
    return Volume(log_mean, regular, slope, corner)


def _volume_samples(grid: SplineGrid) -> Iterator[tuple[slice, float]]:
    """Knot intervals of a mean over time, run by run, and the weight of each.

    A part of a grid uses the same knot intervals as the whole grid, so that sums over parts are sums over the
    whole.
    """
    begin, end = grid.before, grid.before + grid.n_intervals
    for start in range(begin - begin % _CHUNK, end, _CHUNK):
        stop = min(start + _CHUNK, grid.total)
        stride = max(1, (stop - start) // _VOLUME_POINTS)  # enough for a mean over time
        share = (stop - start) / len(range(start, stop, stride)) / grid.total
        first = max(start, begin)
        sample = slice(first - begin + -(first - start) % stride, min(stop, end) - begin, stride)
        if sample.start < sample.stop:
            yield sample, share


def add_volumes(parts: Iterable[Volume]) -> Volume:
    """The log-determinant term of a motion, from the terms of its parts."""
    return reduce(
        lambda a, b: Volume(
            a.log_mean + b.log_mean, a.regular + b.regular, a.slope + b.slope, a.corner + b.corner
        ),
        parts,
    )


def positive_definite(matrices: np.ndarray) -> np.ndarray:
    """Which of many small symmetric matrices are positive definite: all leading minors are positive."""
    out = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    safe = np.where(out[:, None, None], matrices, 0.0)
    for k in range(1, matrices.shape[1] + 1):
        out &= np.linalg.det(safe[:, :k, :k]) > 0.0
    return out
