"""Is a measured velocity the derivative of its coordinate?  A wrong unit, sign or offset, by name.

With a test function χ of compact support, ∫ χ dt = 1, a channel y = a q̇ + b obeys

    ∫ χ y dt = a (−∫ χ̇ q dt) + b,

both sides straight from the samples (q̈ and ∫ χ̈ q dt for an acceleration). Noise flattens a regression: the
line of the left side on the right one is too flat, that of the right side on the left one too steep, and the
truth lies between (Frisch 1934, Statistical Confluence Analysis). A channel is doubted where both lines do.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from leastaction.curve.smoothing import Smooth
from leastaction.data.trajectories import Trajectories
from leastaction.data.trajectory import Rate
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.findings import Finding, find
from leastaction.selection.significance import normal_cutoff

__all__ = ["doubts_about_rates"]

_FINEST = 12  # samples in a test function, for sums to stand for integrals
_FEWEST = 12  # test functions, for a line with an error
_HUBER = 1.5  # standard deviations, beyond which a residual counts less: the usual ones
_ROUNDS = 20  # of its weights
_NEAR = 0.03  # relative, of a factor to that of a unit: the wording, not whether a channel is doubted
_UNITS = {  # of one in the coordinate's unit, by the derivative
    1: {180.0 / np.pi: "deg/s", 30.0 / np.pi: "rpm", 0.5 / np.pi: "rev/s"},
    2: {180.0 / np.pi: "deg/s^2", 1.0 / 9.81: "g"},
}
_PREFIXES = {1000.0: "1/1000", 100.0: "1/100"}  # of the coordinate's unit


def doubts_about_rates(trajectories: Trajectories, smooth: Smooth) -> list[Finding]:
    """A finding for each channel that is not the derivative of its coordinate.

    The smoothed curve tells only how fast each coordinate moves, and how noisy its positions are.
    """
    if not trajectories.rates:
        return []
    states = smooth.grid.at_quadrature(smooth.control_points)
    _, qdot, qddot = (np.sqrt((s**2).mean(axis=(0, 1))) for s in states)
    widths = DIAGNOSIS.rate_width * 2.0 * np.pi * qdot / np.maximum(qddot, 1e-300)
    sure = normal_cutoff(3 * len(trajectories.rates))  # too small a factor, too large a one, an offset
    doubts: list[Finding] = []
    for rate in trajectories.rates:
        pairs, gains = _pairs(trajectories, rate, float(widths[rate.coordinate]))
        if len(pairs) < _FEWEST:
            continue
        # what the pairs would be if there were no motion, and the channel nothing but white noise
        y, name = np.concatenate(rate.values), trajectories.coordinates[rate.coordinate]
        spread = [smooth.noise_std[rate.coordinate], np.nanstd(y)]
        clear = np.all(pairs.std(axis=0) > DIAGNOSIS.rate_clear * gains * spread)
        if np.nanmax(y) == np.nanmin(y):
            doubts.append(find("rate-constant", name, quantity=rate.quantity))
        elif wrong := _about(rate.derivative, pairs, bool(clear), sure):
            doubts.append(find(wrong[0], name, quantity=rate.quantity, **wrong[1]))
    return doubts


def _pairs(trajectories: Trajectories, rate: Rate, width: float) -> tuple[np.ndarray, np.ndarray]:
    """(n_test_functions, 2) derivatives from positions and channel; (2,) how much they reduce white noise."""
    out, gains = list[tuple[float, float]](), list[tuple[float, float]]()
    sign = (-1) ** rate.derivative
    for item, values in zip(trajectories, rate.values, strict=True):
        positions = _Samples(item.t, item.q[:, rate.coordinate])
        channel = _Samples(item.t, values)
        for middle in np.arange(item.t[0] + 0.5 * width, item.t[-1] - 0.5 * width, 0.5 * width):
            derived, one = positions.average(middle, width, rate.derivative)
            measured, two = channel.average(middle, width, 0)
            if np.isfinite(derived + measured):
                out.append((sign * derived, measured))
                gains.append((one, two))
    return np.array(out).reshape(-1, 2), np.sqrt(np.mean(np.square(gains), axis=0)) if gains else np.ones(2)


class _Samples:
    """Valid samples of one column, and sums over them."""

    def __init__(self, times: np.ndarray, values: np.ndarray) -> None:
        seen = np.isfinite(values)
        self.times, self.values = times[seen], values[seen]

    def average(self, middle: float, width: float, nu: int) -> tuple[float, float]:
        """∫ χ⁽ᵛ⁾ y dt by a sum, and its scatter for unit noise; NaN where samples are too far apart."""
        half = 0.5 * width
        a, b = np.searchsorted(self.times, [middle - half, middle + half])
        t = self.times[a:b]
        gaps = np.diff(t, prepend=middle - half, append=middle + half)
        if t.size < _FINEST or gaps.max() > width / _FINEST:
            return np.nan, np.nan
        x = (t - middle) / half
        y = 1.0 - x**2  # χ ∝ y⁴, whose integral is 256/315, and its derivatives
        shape = (y**4, -8.0 * x * y**3, y**2 * (56.0 * x**2 - 8.0))[nu]
        weights = shape * np.gradient(t) * 315.0 / 256.0 / half ** (nu + 1)
        return float(weights @ self.values[a:b]), float(np.sqrt(weights @ weights))


def _about(derivative: int, pairs: np.ndarray, clear: bool, sure: float) -> tuple[str, dict[str, Any]] | None:
    """Code and figures of what is wrong with a channel, from its pairs (derived, measured).

    ``clear`` if noise is small in both; ``sure`` are the standard errors that chance does not pass.
    """
    derived, measured = pairs.T
    flat, offset, error = _line(derived, measured)
    back, _, back_error = _line(measured, derived)
    if flat * back < DIAGNOSIS.rate_follows:
        return ("rate-unrelated", {}) if clear else None
    steep = 1.0 / back
    low, high = sorted([flat, steep])
    allowed = DIAGNOSIS.rate_factor
    low, high = low - sure * error[0], high + sure * back_error[0] * steep**2
    if low > 1.0 + allowed or high < 1.0 - allowed:
        factor = 0.5 * (flat + steep)
        return "rate-scaled", {"factor": factor, "unit": _unit(derivative, factor)}
    other = offset + (flat - steep) * float(derived.mean())
    least = max(sure * error[1], allowed * float(np.std(measured)))
    if min(abs(offset), abs(other)) > least and offset * other > 0.0:
        return "rate-offset", {"offset": offset}
    return None


def _unit(derivative: int, factor: float) -> str:
    """Which unit the size of a factor points to; "1": that of the coordinate, "": none."""
    known = {1.0: "1", **_UNITS[derivative], **_PREFIXES}
    return next((unit for value, unit in known.items() if abs(abs(factor) / value - 1.0) < _NEAR), "")


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Slope and intercept of y = a x + b by Huber's weights, for spikes count little, and standard errors."""
    columns, weight = np.stack([x, np.ones_like(x)]), np.ones_like(x)
    solution, scatter, left = np.zeros(2), 0.0, y
    for _ in range(_ROUNDS):
        weighted = columns * weight
        before = solution
        solution = np.linalg.lstsq(weighted @ columns.T, weighted @ y, rcond=None)[0]
        left = y - solution @ columns
        scatter = 1.4826 * float(np.median(np.abs(left)))
        weight = np.minimum(1.0, _HUBER * scatter / np.maximum(np.abs(left), 1e-300))
        if np.allclose(solution, before, rtol=1e-6, atol=0.0) or scatter == 0.0:
            break
    gram = (columns * weight) @ columns.T
    errors = np.sqrt(np.clip(np.diag(np.linalg.pinv(gram)), 0.0, None)) * np.std(left)
    return float(solution[0]), float(solution[1]), errors
