"""How many knots the motion asks for, and pieces of long recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from leastaction.curve.bspline import uniform_grid
from leastaction.curve.settings import CURVE
from leastaction.curve.smoothing import Smooth, smooth
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.data.validation import FloatArray

__all__ = ["FEWEST_SAMPLES", "Knots", "excerpt", "lay_knots"]

FEWEST_SAMPLES = 20  # of a coordinate, at least
_MOST_GRIDS = 6  # tried in turn
_ROUNDING = 1e-6  # share of the spread: smaller swings about a steady drift may be rounding
_PIECES = 20  # at least so many pieces of a long recording are searched


class Knots(NamedTuple):
    """Time scale of the motion, and the smoothed curve from which it was estimated.

    Attributes
    ----------
    per_second, coarse : float
        Knots a second to begin with, and how few would still show the motion.
    period : float
        Of the fastest coordinate, in seconds.
    smooth : Smooth
    rates : (n_dof,) array
        Root mean square.
    """

    per_second: float
    coarse: float
    period: float
    smooth: Smooth
    rates: np.ndarray


def lay_knots(
    trajectories: Trajectories, degree: int, smoothed_on: Callable[[float], Smooth] | None = None
) -> Knots:
    """Knots a second from the data's own time scale.

    ``smoothed_on`` smooths the trajectories on some knots a second, where workers do that.

    The knot spacing h follows the fastest coordinate: h · rms(d³q/dt³)/rms(d²q/dt²) = 1/4, found by
    repeated smoothing; never finer than half a sampling interval.  It begins coarse, h · rms(dq/dt)/std(q) =
    1/4, and stays near what rms(d²q/dt²)/rms(dq/dt) asks for: fine grids admit noise and vibration, whose
    third derivative asks for finer grids still.  The turns of an angle that turns many times hide its
    swings: then it begins with what these ask for.

    Motion of few samples a period is noise to a smoother on coarse knots.  What it leaves then is
    predictable from one sample to the next, and finer knots are tried before anything is concluded.
    """
    times = [t.t for t in trajectories]
    values = [t.q for t in trajectories]
    rate = 1.0 / trajectories.sampling_interval

    def spread(nu: int) -> np.ndarray:
        curves = smoothed.grid.evaluate(smoothed.control_points, times, nu)
        return np.sqrt(
            np.mean(
                [np.mean((c - (c.mean(axis=0) if nu == 0 else 0.0)) ** 2, axis=0) for c in curves], axis=0
            )
        )

    def knots_for(nu: int) -> float:
        fastest = float(np.max(spread(nu + 1) / np.maximum(spread(nu), 1e-300)))
        return min(CURVE.knots_per_radian * fastest, 2.0 * rate)

    def smoothed_here(knots: float) -> Smooth:
        return smooth(uniform_grid(times, knots, degree), times, values, rates=trajectories.rates)

    smoothed_on = smoothed_on or smoothed_here
    first = rate / 5.0
    smoothed = smoothed_on(first)
    while first < 2.0 * rate and _hides_motion(smoothed, times, values):
        first = min(2.0 * first, 2.0 * rate)
        smoothed = smoothed_on(first)
    if first > rate / 5.0 and np.max(spread(2) / np.maximum(spread(1), 1e-300)) > 2.0 * np.pi * rate / (
        CURVE.fewest_samples
    ):
        first = rate / 5.0  # too few to follow
        smoothed = smoothed_on(first)
    coarse, swinging = knots_for(0), min(CURVE.knots_per_radian * _swing(smoothed, times), 2.0 * rate)
    if swinging > CURVE.drifts * coarse:
        coarse = swinging
    knots = coarse
    for _ in range(_MOST_GRIDS):
        smoothed = smoothed_on(knots)
        wanted = min(knots_for(2), CURVE.most_over_slower * knots_for(1))
        if abs(wanted / knots - 1.0) < CURVE.knots_settled:
            break
        knots = wanted
    else:
        smoothed = smoothed_on(knots)
    period = 2.0 * np.pi * CURVE.knots_per_radian / knots_for(1)
    if first > rate / 5.0 and smoothed.grid.n_ctrl > sum(t.size for t in times):
        # interpolation gives no estimate of the noise, and a fit that starts at zero stays there
        least = CURVE.unknown_noise * spread(0)
        smoothed = replace(smoothed, noise_std=np.maximum(smoothed.noise_std, least))
    return Knots(knots, coarse, period, smoothed, spread(1))


def _swing(smoothed: Smooth, times: list[np.ndarray]) -> float:
    """Largest ratio of std(dq/dt) to std(q) about a steady drift, in 1/s."""
    curves, slopes = (smoothed.grid.evaluate(smoothed.control_points, times, nu) for nu in (0, 1))
    size, rate = np.zeros((2, curves[0].shape[1]))
    for t, q, qdot in zip(times, curves, slopes, strict=True):
        line = np.column_stack([np.ones(t.size), t - t.mean()])
        about = q - line @ np.linalg.lstsq(line, q, rcond=None)[0]
        size += np.mean(about**2, axis=0) + _ROUNDING**2 * np.var(q, axis=0)
        rate += np.var(qdot, axis=0)
    return float(np.sqrt(np.max(rate / np.maximum(size, 1e-300))))


def _hides_motion(smoothed: Smooth, times: list[np.ndarray], values: list[np.ndarray]) -> bool:
    """Whether the residual of a smoother is motion, not noise: two samples then predict the next."""
    curves = smoothed.grid.evaluate(smoothed.control_points, times)
    for i in range(values[0].shape[1]):
        left = [(q[:, i] - c[:, i])[np.isfinite(q[:, i])] for q, c in zip(values, curves, strict=True)]
        now, last, before = (
            np.concatenate([r[k : r.size - 2 + k] for r in left if r.size > 2] or [np.zeros(1)])
            for k in (2, 1, 0)
        )
        past: FloatArray = np.column_stack([last, before])
        size = float(np.mean(now**2))
        unforeseen = float(np.mean((now - past @ np.linalg.lstsq(past, now, rcond=None)[0]) ** 2))
        seen = [q[np.isfinite(q[:, i]), i] for q in values]
        variance = float(np.mean([np.var(part) for part in seen if part.size]))  # of trials with this sensor
        if size > CURVE.much_left**2 * variance and unforeseen < (1.0 - CURVE.foreseen) * size:
            return True
    return False


def excerpt(trajectories: Trajectories, n_samples: int) -> Trajectories:
    """Pieces spread evenly over long recordings, about ``n_samples`` in all; shorter ones come back whole."""
    share = n_samples / trajectories.n_samples
    if share >= 1.0:
        return trajectories
    most = max(FEWEST_SAMPLES, n_samples // (trajectories.n_dof * _PIECES))
    pieces: list[tuple[Trajectory, slice]] = []
    for whole in trajectories:
        for rows in np.array_split(np.arange(whole.n_times), max(1, whole.n_times // most)):
            part = slice(int(rows[0]), int(rows[-1]) + 1)
            if np.isfinite(whole.q[part]).sum(axis=0).min() >= FEWEST_SAMPLES:
                pieces.append((whole, part))
    if not pieces:
        return trajectories
    count = min(len(pieces), max(1, round(share * len(pieces))))
    chosen = [pieces[int(k)] for k in np.linspace(0, len(pieces) - 1, count).round().astype(int)]
    return Trajectories([whole.rows(part).changed(name="") for whole, part in chosen])
