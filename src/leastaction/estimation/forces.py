"""Known forces where the equations are compared: no faster than the curve can follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.linalg import solveh_banded

from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.curve.settings import CURVE
from leastaction.curve.smoothing import banded_gram
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

__all__ = ["GridForces", "Pushes", "WithPushes", "force_rates", "forces_on"]

_FEWEST = 4  # intervals; shorter records are interpolated


@dataclass(frozen=True, eq=False)
class GridForces:
    """Forces as a grid sees them.

    Attributes
    ----------
    values : (n_intervals, n_quadrature, n_dof) array
        At the quadrature points.
    density : (n_dof,) array
        Spectral density of what is faster, in force² seconds: the error of the equations, 1/w, that forces
        with white noise would leave. Zero where it cannot be told.
    """

    values: np.ndarray
    density: np.ndarray


def forces_on(
    grid: SplineGrid,
    times: Sequence[np.ndarray],
    forces: Sequence[np.ndarray | None],
    dtype: type[np.floating[Any]] = np.float64,
) -> GridForces | None:
    """Return the slow part of forces, from their samples; None if nothing acts anywhere.

    Each trajectory's samples are fitted by least squares with a spline on the knots of its curve: what is
    faster (ripple, steps of a converter, noise) the curve cannot follow, so it would only count as an error
    of the equations, and bias the scale of L upwards.

    Parameters
    ----------
    grid : SplineGrid
    times : sequence of (n_times,) arrays
    forces : sequence of (n_times, n_dof) arrays
        None where nothing acts.
    dtype : type
        Of the values.

    Examples
    --------
    >>> from leastaction.curve.bspline import uniform_grid
    >>> t = np.linspace(0.0, 10.0, 1001)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.1, (1001, 1))
    >>> grid = uniform_grid([t], 4.0, 5)
    >>> found = forces_on(grid, [t], [np.sin(t)[:, None] + noise])
    >>> bool(np.std(found.values[..., 0] - np.sin(grid.points)) < 0.03)
    True
    >>> found.density.round(5).tolist()  # 0.1 squared times 0.01 s
    [0.0001]
    """
    n_dof = next((f.shape[1] for f in forces if f is not None), 0)
    if not n_dof:
        return None
    values = np.zeros((grid.n_intervals, grid.n_quadrature, n_dof), dtype)
    squares, freedom, stop = np.zeros(n_dof), 0.0, 0
    for k, (space, t, samples) in enumerate(zip(grid.spaces, times, forces, strict=True)):
        own = slice(stop, stop := stop + space.n_intervals)
        if samples is None:
            continue
        slow, n_parameters = _slow_part(space, t, samples)
        values[own] = slow(grid.points_of(k))
        if n_parameters < t.size:
            squares += ((samples - slow(t)) ** 2).sum(axis=0) * (t[-1] - t[0]) / t.size
            freedom += t.size - n_parameters
    return GridForces(values, squares / max(freedom, 1.0))


def force_rates(
    grid: SplineGrid,
    times: Sequence[np.ndarray],
    forces: Sequence[np.ndarray | None],
    dtype: type[np.floating[Any]] = np.float64,
) -> np.ndarray:
    """(n_intervals, n_quadrature, n_dof) derivatives in time of what `forces_on` returns."""
    n_dof = next((f.shape[1] for f in forces if f is not None), 0)
    rates, stop = np.zeros((grid.n_intervals, grid.n_quadrature, n_dof), dtype), 0
    for k, (space, t, samples) in enumerate(zip(grid.spaces, times, forces, strict=True)):
        own = slice(stop, stop := stop + space.n_intervals)
        if samples is not None:
            rates[own] = _slow_part(space, t, samples)[0](grid.points_of(k), nu=1)
    return rates


def _slow_part(space: SplineSpace, t: np.ndarray, samples: np.ndarray) -> tuple[BSpline | CubicSpline, int]:
    """The curve, and how many parameters it has in each coordinate."""
    between = CubicSpline(t, samples)
    most = int(t.size / CURVE.samples_per_knot)
    if most < _FEWEST:
        return between, t.size
    if space.n_intervals > most:
        space = SplineSpace(space.degree, np.linspace(float(t[0]), float(t[-1]), most + 1))
    even = np.linspace(
        float(t[0]), float(t[-1]), t.size
    )  # gaps in the record must not leave an interval empty
    design = space.basis(even)
    gram = banded_gram(design, space.degree)
    control_points = solveh_banded(gram, design.T @ between(even), lower=True)
    return BSpline(space.knots, control_points, space.degree), space.n_ctrl


class Pushes(Protocol):
    """Forces of known shape and unknown size."""

    def __len__(self) -> int: ...

    def on(self, intervals: slice, n_dof: int) -> np.ndarray:
        """(n_pushes, n_dof, n_points) what each leaves in the residual, in the sequence of `Points`."""
        ...

    def within(self, intervals: slice) -> Pushes:
        """The same for a part of the motion, given by its knot intervals."""
        ...


class WithPushes(EulerLagrange):
    """Columns of a structure, then those of pushes, which depend on time, not on the state."""

    def __init__(self, columns: EulerLagrange, pushes: Pushes) -> None:
        super().__init__(columns.terms, columns.coordinates, columns.prescribed)
        self.own, self.pushes = columns, pushes

    def __len__(self) -> int:
        return len(self.terms) + len(self.pushes)

    def within(self, intervals: slice) -> EulerLagrange:
        return WithPushes(self.own.within(intervals), self.pushes.within(intervals))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.own, self.pushes)

    def strong(self, points: Points, select: Sequence[int] | None = None) -> np.ndarray:
        own = self.own.strong(points)
        if points.intervals is None:
            raise ValueError("forces are known at the quadrature points only")
        return np.concatenate([own, self.pushes.on(points.intervals, self.n_dof)])

    def jacobian(self, points: Points, coefficients: np.ndarray):
        return self.own.jacobian(points, coefficients[: len(self.terms)])

    def mass_matrix(self, points: Points, coefficients: np.ndarray) -> np.ndarray:
        return self.own.mass_matrix(points, coefficients[: len(self.terms)])

    def mass_of(self, k: int, points: Points) -> np.ndarray:
        if k < len(self.terms):
            return self.own.mass_of(k, points)
        return np.zeros((points.n_points, self.n_dof, self.n_dof))

    def masses(self, points: Points) -> tuple[list[int], np.ndarray]:
        return self.own.masses(points)

    def subset(self, select: Sequence[int]) -> EulerLagrange:
        """Terms only are left out: pushes are always free."""
        return WithPushes(self.own.subset([k for k in select if k < len(self.terms)]), self.pushes)
