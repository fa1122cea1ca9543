r"""Known forces at the quadrature points, limited to the frequencies that the curve can follow.

Samples of torques contain ripple, steps of a converter and noise, which the coordinates do not follow.  If
the coordinates do follow (a force with three samples a period moves a light body), removing the fast part
leaves accelerations without a force, and the estimated masses are too small.  The forces then act unfiltered,
and their course between samples matters: band-limited, f(t); a straight line between samples, or the last
sample held, whose slow parts are

.. math:: \frac{1}{h^2}\int_{-h}^{h} (h - |s|) f(t - s)\,ds, \qquad \frac{1}{h}\int_0^h f(t - s)\,ds

with the sampling interval h. Images above the sampling rate have hardly any effect and are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.linalg import solveh_banded

from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.curve.settings import CURVE
from leastaction.curve.smoothing import banded_gram
from leastaction.data.validation import FloatArray
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

__all__ = [
    "Between",
    "GridForces",
    "Pushes",
    "WithPushes",
    "curve_between",
    "fast_forces_act",
    "force_rates",
    "forces_along",
    "forces_on",
]

Between = Literal["slow", "band-limited", "linear", "held"]

_FEWEST = 4  # intervals; shorter records are interpolated
_INTERPOLATED = 0.7  # knot intervals a sample: on finer grids, forces are not filtered
_DENSE = 4  # points in a knot interval, at which they are projected onto coarser knots
_BAND_LIMITED = 11  # degree of the interpolating spline: off by 2e-4 at three samples a period
_EVEN = 0.01  # by which sampling intervals may differ
_ROUNDING = 1e-6  # of the forces: error of a spline through slow forces
_LAGS = 2  # samples, by which a coordinate may follow a force


@dataclass(frozen=True, eq=False)
class GridForces:
    """Forces on a grid.

    Attributes
    ----------
    values : (n_intervals, n_quadrature, n_dof) array
        At the quadrature points.
    density : (n_dof,) array
        Spectral density of the fast part, in force² seconds: the equation error, 1/w, that forces with white
        noise would cause. Zero if it cannot be determined.
    """

    values: np.ndarray
    density: np.ndarray


def forces_on(
    grid: SplineGrid,
    times: Sequence[np.ndarray],
    forces: Sequence[np.ndarray | None],
    dtype: type[np.floating[Any]] = np.float64,
    between: Between = "slow",
) -> GridForces | None:
    """Return the slow part of forces, from their samples; None if nothing acts anywhere.

    Each trajectory's samples are fitted by least squares with a spline on the knots of its curve. The curve
    cannot follow faster forces (ripple, steps of a converter, noise). They would count as equation error and
    bias the scale of L upwards.

    Parameters
    ----------
    grid : SplineGrid
    times : sequence of (n_times,) arrays
    forces : sequence of (n_times, n_dof) arrays
        None where nothing acts.
    dtype : type
        Of the values.
    between : {"slow", "band-limited", "linear", "held"}
        How the forces act between their samples. Except for "slow", their fast part acts, too, and the
        density is zero.

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
        if between != "slow":
            values[own] = _projected(space, t, samples, between)(grid.points_of(k))
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
    """The curve, and its number of parameters in each coordinate."""
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


def _projected(
    space: SplineSpace, t: np.ndarray, samples: np.ndarray, between: Between
) -> Callable[[np.ndarray], np.ndarray]:
    """The part of the forces that the knots can follow."""
    curve = curve_between(t, samples, between)
    if space.n_intervals >= _INTERPOLATED * t.size:
        return curve
    even = np.linspace(float(t[0]), float(t[-1]), _DENSE * space.n_intervals + 1)
    design = space.basis(even)
    control_points = solveh_banded(banded_gram(design, space.degree), design.T @ curve(even), lower=True)
    return BSpline(space.knots, control_points, space.degree)


def curve_between(t: np.ndarray, samples: np.ndarray, between: Between) -> Callable[[np.ndarray], np.ndarray]:
    """Forces as a function of time.

    Examples
    --------
    >>> t = np.arange(400) / 100.0
    >>> wave = np.sin(2.0 * np.pi * 10.0 * t)[:, None]
    >>> middle = np.arange(1.0, 2.0, 0.003)
    >>> held = curve_between(t, wave, "held")(middle)[:, 0]
    >>> share = np.sinc(0.1)  # a tenth of a period is held
    >>> bool(np.allclose(held, share * np.sin(2.0 * np.pi * 10.0 * (middle - 0.005)), atol=1e-3))
    True
    """
    if between == "slow" or t.size <= _BAND_LIMITED:
        return CubicSpline(t, samples)
    curve = make_interp_spline(t, samples, _BAND_LIMITED)
    if between == "band-limited":
        return curve
    h = float(np.median(np.diff(t)))
    whole = _Antiderivative(curve, 1 if between == "held" else 2)
    if between == "held":
        return lambda times: (whole(times) - whole(times - h)) / h
    return lambda times: (whole(times + h) - 2.0 * whole(times) + whole(times - h)) / h**2


class _Antiderivative:
    """Repeated integral of a curve, which is constant beyond its ends."""

    def __init__(self, curve: BSpline, count: int) -> None:
        self.integrals = [curve.antiderivative(n) if n else curve for n in range(count, -1, -1)]
        self.ends = float(curve.t[0]), float(curve.t[-1])

    def __call__(self, times: np.ndarray) -> np.ndarray:
        inside = np.clip(times, *self.ends)
        beyond = (times - inside)[..., None]
        factor, out = np.ones_like(beyond), 0.0
        for n, integral in enumerate(self.integrals):  # a polynomial beyond
            out = out + factor * integral(inside)
            factor = factor * beyond / (n + 1)
        return np.asarray(out)


def fast_forces_act(
    times: Sequence[np.ndarray], q: Sequence[np.ndarray], forces: Sequence[np.ndarray | None]
) -> bool:
    """Whether coordinates follow the part of the forces that is too fast for :func:`forces_on`.

    A spline on equally coarse knots is subtracted from coordinates and forces. Second differences of the
    remainder of a coordinate are compared with the remainders of the forces, shifted by at most two samples.
    """
    rows: list[np.ndarray] = []
    seen: list[np.ndarray] = []
    for t, positions, given in zip(times, q, forces, strict=True):
        steps = np.diff(t)
        if given is None or t.size < 10 * _FEWEST or np.ptp(steps) > _EVEN * np.median(steps):
            continue
        if not np.isfinite(positions).all():
            continue
        space = SplineSpace(
            3, np.linspace(float(t[0]), float(t[-1]), int(t.size / CURVE.samples_per_knot) + 1)
        )
        parts = [x - _slow_part(space, t, x)[0](t) for x in (given, positions)]
        moved = np.diff(parts[1], 2, axis=0)
        shifted = [np.roll(parts[0][1:-1], lag, axis=0) for lag in range(-_LAGS, _LAGS + 1)]
        rows.append(np.hstack(shifted)[_LAGS:-_LAGS])
        seen.append(moved[_LAGS:-_LAGS])
    if not rows:
        return False
    pushes, moved = np.concatenate(rows), np.concatenate(seen)
    scale = np.sqrt(np.mean(pushes**2, axis=0))
    acting = scale > _ROUNDING * max(float(np.abs(f).max()) for f in forces if f is not None)
    if not acting.any():
        return False
    used: FloatArray = pushes[:, acting] / scale[acting]
    share: FloatArray = np.asarray(np.linalg.lstsq(used, moved, rcond=None)[0], dtype=float)
    left = np.square(moved - used @ share).mean(axis=0)
    whole = np.square(moved).mean(axis=0)
    return bool(np.any(left < (1.0 - CURVE.follows_forces) * whole))


class Pushes(Protocol):
    """Forces of known shape and unknown size."""

    def __len__(self) -> int: ...

    def on(self, intervals: slice, n_dof: int) -> np.ndarray:
        """(n_pushes, n_dof, n_points) contribution of each to the residual, in the sequence of `Points`."""
        ...

    def within(self, intervals: slice) -> Pushes:
        """The same for a part of the motion, given by its knot intervals."""
        ...


class WithPushes(EulerLagrange):
    """Columns of a structure, then those of pushes, which depend on time, not on the state."""

    def __init__(self, columns: EulerLagrange, pushes: Pushes) -> None:
        super().__init__(columns.terms, columns.coordinates, columns.prescribed)
        self.own: EulerLagrange = columns
        self.pushes: Pushes = pushes

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

    def jacobian(self, points: Points, coefficients: np.ndarray) -> dict[tuple[int, int, int], np.ndarray]:
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
        """Some of the terms, and all pushes, which are always free."""
        return WithPushes(self.own.subset([k for k in select if k < len(self.terms)]), self.pushes)


def forces_along(
    columns: EulerLagrange, grid: SplineGrid, control_points: np.ndarray, times: Sequence[np.ndarray]
) -> np.ndarray:
    """(n_columns, n_intervals, n_quadrature, n_dof) columns along a motion, taken at the samples.

    They are interpolated and limited as recorded forces are, which matters where a column jumps.
    """
    states = zip(*(grid.evaluate(control_points, times, nu) for nu in range(3)), strict=True)
    each = [columns.strong(Points(*state)) for state in states]
    rows = (forces_on(grid, times, [strong[k].T for strong in each]) for k in range(len(columns)))
    shape = len(columns), *grid.points.shape, columns.n_dof
    return np.array([row.values for row in rows if row is not None]).reshape(shape)
