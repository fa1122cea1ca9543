"""Forecasts of measured motions: starts, errors and expected errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from leastaction.curve.bspline import SplineGrid, uniform_space
from leastaction.curve.smoothing import smooth
from leastaction.data.trajectories import Trajectories
from leastaction.errors import InputError
from leastaction.simulation.batch import Channels, Observe, Start, StartResult, nearest_states, run_starts
from leastaction.simulation.law import Law
from leastaction.simulation.results import ForecastResult

__all__ = ["ForecastResult", "ForecastTrace", "Sight", "forecast", "lengths_of"]

Curve = Callable[[np.ndarray, int], np.ndarray]  # derivative of a motion, (n_times, n_dof), at times

# A coordinate needs this many samples in the window to determine the initial state.
_LEAST_SAMPLES = 4
# A window is followed if residuals are smaller, in units of the noise and of a share of the signal, by which
# a machine differs from its law. Where it is not, so many states are tried, in so many rounds.
_FOLLOWED, _NEAR, _DRAWS, _ROUNDS = 1.5, 0.005, 16, 4
_SHARE = 0.5  # of the horizon: length of a window
_Z95 = 1.96


@dataclass(frozen=True, eq=False)
class ForecastTrace:
    """One simulation and the measurements.

    Attributes
    ----------
    trial : str
    origin : float
        Time at which the simulation starts, in seconds.
    t : ndarray, shape (n_times,)
        Measured times after the origin, up to the horizon.
    measured, forecast : ndarray, shape (n_times, n_dof)
        NaN if a sample is missing or the forecast has diverged.
    rms : ndarray, shape (n_dof,)
        Root mean square of forecast − measured; inf if diverged, NaN if nothing was measured.
    expected_rms : ndarray, shape (n_dof,)
        First-order estimate of `rms` for an exact model: measurement noise and the propagated error of the
        initial state.
    valid_time : float
        Seconds from the origin until the tolerance is first exceeded, or the horizon.
    status : {"ok", "diverged", "unresolved", "failed"}
        ``"unresolved"``: the integration has not converged at the smallest step; ``"failed"``: no motion of
        the model could be fitted to the window.
    reason : str
        Empty if ok.
    std : ndarray, shape (n_times, n_dof), optional
        Standard deviation of measured − forecast according to the model: noise and the propagated errors of
        initial state, coefficients and equations. None if the model has no standard errors; inf where more
        than one drawn motion in twenty diverges.
    motion : ndarray, shape (n_times, n_dof), optional
        Simulated coordinates of the model, if the columns are not these: the trial lacks a coordinate, or has
        columns of the `calibration`. None if `forecast` holds them.
    """

    trial: str
    origin: float
    t: np.ndarray
    measured: np.ndarray
    forecast: np.ndarray
    rms: np.ndarray
    expected_rms: np.ndarray
    valid_time: float
    status: str
    reason: str = ""
    std: np.ndarray | None = None
    motion: np.ndarray | None = None

    @property
    def reach(self) -> np.ndarray | None:
        """Half of the 95 % band, 1.96 `std`."""
        return None if self.std is None else _Z95 * self.std


@dataclass(frozen=True, eq=False)
class Sight:
    """How channels that are not all coordinates see the motion.

    ``motion`` holds the coordinates, as far as the channels tell them, and the forces of each trial;
    ``extent`` and ``angles``, (n_dof,), are the size of each coordinate and whether it is an angle;
    ``window`` is the length of the window by default, as a multiple of the horizon.
    """

    motion: Trajectories
    observe: Observe
    extent: np.ndarray
    angles: np.ndarray
    window: float = _SHARE


def forecast(
    law: Law,
    data: Trajectories,
    noise_std: np.ndarray,
    horizon: float | None = None,
    window: float | None = None,
    tolerance: float = 0.4,
    sight: Sight | None = None,
) -> ForecastResult:
    """Run the forecasts of `LagrangianModel.validate`, which describes the arguments.

    ``data`` hold the coordinates, or other channels with a ``sight``. Forces on coordinates that are
    prescribed are the accelerations of their smoothed measurements.
    """
    motion = data if sight is None else sight.motion
    horizon, window = lengths_of(data, horizon, window, _SHARE if sight is None else sight.window)
    if not _positive(tolerance):
        raise InputError(f"tolerance is {tolerance!r}; expected a positive number, e.g. 0.4")
    starts, skipped = _plan(data, motion, horizon, window)
    if not starts:
        raise InputError(
            f"a forecast over {horizon:g} s from a window of {window:g} s needs {_LEAST_SAMPLES} samples of "
            "each coordinate in the window and some after it; no trial has them (the longest lasts "
            f"{max(trial.duration for trial in data):g} s). Choose a shorter horizon or window"
        )
    std = np.sqrt(np.nanvar(np.concatenate([trial.q for trial in data]), axis=0))
    curves, estimated = _smoothed(motion, starts)
    state = np.full((len(starts), 2 * motion.n_dof), np.nan)
    if curves:
        begins = [(curves[start.trial], np.array([start.begin])) for start in starts]
        state = np.array([np.concatenate([curve(t, nu)[0] for nu in (0, 1)]) for curve, t in begins])
    if curves and law.prescribed:
        starts = [_moved(start, curves[start.trial], list(law.prescribed)) for start in starts]
    sigma = np.where(noise_std > 0, noise_std, estimated if sight is None else 0.0)
    # Avoids division by zero for data without noise, or a coordinate at rest.
    tiny = np.finfo(float).tiny
    sigma = np.fmax(np.fmax(sigma, 1e-6 * std), tiny)
    scale = np.fmax(std, sigma)
    channels = Channels(sigma, scale, scale)
    if sight is not None:
        channels = Channels(sigma, scale, sight.extent, sight.observe)
    results = run_starts(law, starts, state, channels, window, horizon)
    if sight is not None:
        results = _from_elsewhere(law, starts, state, results, channels, sight.angles, window, horizon)
    limit = tolerance * std + 3.0 * sigma
    traces = [_trace(data, s, r, sigma, limit, window, horizon) for s, r in zip(starts, results, strict=True)]
    std = np.fmax(std, tiny)
    return ForecastResult(
        data.coordinates, horizon, window, float(tolerance), sigma, std, tuple(traces), tuple(skipped)
    )


def _positive(value: Any) -> bool:
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    return number and bool(0 < value < math.inf)


def lengths_of(
    data: Trajectories, horizon: float | None, window: float | None, share: float = _SHARE
) -> tuple[float, float]:
    """Horizon and window; by default those of `LagrangianModel.validate`, with a share of the horizon."""
    steps = np.concatenate([np.diff(trial.t) for trial in data])
    if not steps.size:
        raise InputError("no trial has more than one time; a forecast needs a motion")
    step = float(np.median(steps))
    for label, value in (("horizon", horizon), ("window", window)):
        if value is not None and not _positive(value):
            raise InputError(f"{label} is {value!r}; expected a positive number of seconds")
    shortest = min(trial.duration for trial in data if trial.n_times > 1)
    if horizon is None:
        horizon = min(max(1.0, 20 * step), 0.5 * shortest)
    if window is None:
        window = max(min(share * horizon, shortest - horizon), 8 * step)
    return float(horizon), float(window)


def _plan(
    data: Trajectories, motion: Trajectories, horizon: float, window: float
) -> tuple[list[Start], list[tuple[str, str]]]:
    starts, skipped = [], []
    # Rounding of times such as 0.1 + 0.2 must not remove the last start.
    slack = 1e-9 * (horizon + window)
    for k, trial in enumerate(data):
        count = math.floor((trial.duration - window + slack) / horizon)
        before = len(starts)
        for m in range(max(count, 0)):
            begin = trial.t[0] + m * horizon
            first, last = np.searchsorted(trial.t, [begin - slack, begin + window + horizon + slack])
            t = np.maximum(trial.t[first:last] - begin, 0.0)
            q = trial.q[first:last]
            seen = np.isfinite(q)
            enough = seen[t <= window + slack].sum(axis=0) >= _LEAST_SAMPLES
            if enough.all() and seen[t > window + slack].any():
                known = motion[k].forces if motion[k].driven else None
                forces = None if known is None else CubicSpline(trial.t, known)
                starts.append(Start(k, float(begin), t, q, forces))
        if len(starts) == before:
            reason = "too short" if count < 1 else "too few samples"
            skipped.append(
                (data.names[k], f"{reason} for a window of {window:g} s and a horizon of {horizon:g} s")
            )
    return starts, skipped


def _smoothed(data: Trajectories, starts: list[Start]) -> tuple[dict[int, Curve], np.ndarray]:
    """Smoothing splines of the trials with starts, and the noise; no spline if smoothing fails."""
    used = sorted({start.trial for start in starts})
    trials = [data[k] for k in used]
    spaces = [
        uniform_space(trial.t[0], trial.t[-1], 0.25 * trial.n_times / trial.duration) for trial in trials
    ]
    grid = SplineGrid(spaces)
    try:
        fitted = smooth(grid, [trial.t for trial in trials], [trial.q for trial in trials])
    except np.linalg.LinAlgError:
        return {}, np.full(data.n_dof, np.nan)
    parts = zip(spaces, grid.split(fitted.control_points), strict=True)
    curves = [partial(space.evaluate, control) for space, control in parts]
    return dict(zip(used, curves, strict=True)), fitted.noise_std


def _from_elsewhere(
    law: Law,
    starts: Sequence[Start],
    state: np.ndarray,
    results: Sequence[StartResult],
    channels: Channels,
    angles: np.ndarray,
    window: float,
    horizon: float,
) -> list[StartResult]:
    """Results whose window is not followed, begun again from other states; the best of each.

    Channels may determine the coordinates in more than one way: a sine, for example, has two angles.
    """
    out, rng = list(results), np.random.default_rng(0)
    allowed = np.hypot(channels.sigma, _NEAR * channels.scale)
    off = [_misfit(s, r, allowed, window) for s, r in zip(starts, out, strict=True)]
    wide = np.concatenate([np.where(angles, np.pi, 2.0 * channels.extent), 4.0 * channels.extent / window])
    for _ in range(_ROUNDS):
        lost = [k for k, value in enumerate(off) if not value < _FOLLOWED]
        if not lost:
            break
        again = [starts[k] for k in lost]
        begun = state[lost] + wide * rng.uniform(-1.0, 1.0, (_DRAWS, len(lost), wide.size))
        nearest = nearest_states(law, again, begun, channels, window)
        for k, result in zip(lost, run_starts(law, again, nearest, channels, window, horizon), strict=True):
            value = _misfit(starts[k], result, allowed, window)
            if not value >= off[k]:
                out[k], off[k] = result, value
    return out


def _misfit(start: Start, result: StartResult, allowed: np.ndarray, window: float) -> float:
    """Root mean square of the residuals in the window of a start, relative to what is allowed."""
    inside = start.t <= window * (1 + 1e-9)
    error = ((result.q - start.q) / allowed)[inside]
    seen = np.isfinite(start.q[inside])
    return float(np.sqrt(np.mean(np.where(np.isfinite(error), error, np.inf)[seen] ** 2)))


def _moved(start: Start, curve: Curve, prescribed: Sequence[int]) -> Start:
    """The same start, its forces on some coordinates replaced by the accelerations of a curve."""

    def forces(times: np.ndarray) -> np.ndarray:
        accelerations = curve(times, 2)
        out = np.zeros_like(accelerations) if start.forces is None else start.forces(times)
        out[:, prescribed] = accelerations[:, prescribed]
        return out

    return replace(start, forces=forces)


def _trace(
    data, start: Start, result: StartResult, sigma, limit, window: float, horizon: float
) -> ForecastTrace:
    after = start.t > window * (1 + 1e-9)
    t, measured, run = start.t[after], start.q[after], result.q[after]
    seen = np.isfinite(measured)
    error = np.where(seen, run - measured, 0.0)
    count = np.where(seen.any(axis=0), seen.sum(axis=0), np.nan)
    diverged = result.status in ("diverged", "failed")
    if diverged:
        rms, expected = np.where(np.isnan(count), np.nan, np.inf), np.full(count.shape, np.nan)
    else:
        rms = np.sqrt((error**2).sum(axis=0) / count)
        expected = np.sqrt(np.where(seen, result.variance[after] + 1.0, 0.0).sum(axis=0) / count) * sigma
    bad = np.flatnonzero((seen & ~(np.abs(error) <= limit)).any(axis=1))
    valid = horizon if not bad.size else float(t[bad[0] - 1] - window) if bad[0] else 0.0
    return ForecastTrace(
        trial=data.names[start.trial],
        origin=start.begin + window,
        t=t + start.begin,
        measured=measured,
        forecast=run,
        rms=rms,
        expected_rms=expected,
        valid_time=0.0 if result.status == "failed" else valid,
        status=result.status,
        reason=result.reason,
        std=None if result.spread is None else np.hypot(result.spread[after], sigma),
        motion=None if result.motion is None else result.motion[after],
    )
