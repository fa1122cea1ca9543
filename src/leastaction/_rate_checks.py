"""Is a measured velocity the derivative of its coordinate?  A wrong unit, sign or offset, in words.

The channel y is compared with the rate of the curve through the positions alone, y = a q̇ + b, robustly.  What
a and b would be of a channel that is right, and how they scatter, is found by measuring the curve again: new
noise, smoothed alike.
"""

from __future__ import annotations

import numpy as np

from leastaction._smoothing import smooth
from leastaction._spline import SplineGrid
from leastaction._trajectory import Trajectories

__all__ = ["doubts_about_rates"]

_REPLICATES = 16
_SURE = 5.0  # standard deviations
_FACTOR = 0.05  # a sensor's calibration may be off by less
_FEWEST = 20
_HUBER = 1.5
_ROUNDS = 20
_FOLLOWS = 0.5  # share of the channel's variance
_NEAR = 0.03
_UNITS = {
    1: {
        180.0 / np.pi: "degrees per second",
        30.0 / np.pi: "revolutions per minute",
        0.5 / np.pi: "revolutions per second",
    },
    2: {180.0 / np.pi: "degrees per second squared", 1.0 / 9.81: "multiples of g"},
}
_PREFIXES = {1000.0: "thousandths of the coordinate's unit", 100.0: "hundredths of the coordinate's unit"}


def doubts_about_rates(trajectories: Trajectories, grid: SplineGrid) -> list[str]:
    """A sentence for each channel that is not the derivative of its coordinate."""
    if not trajectories.rates:
        return []
    times = [t.t for t in trajectories]
    alone = smooth(grid, times, [t.q for t in trajectories])
    again = alone.replicates(_REPLICATES, np.random.default_rng(0), 0.0 * alone.noise_std)
    designs = {nu: grid.design(times, nu) for nu in {rate.derivative for rate in trajectories.rates}}
    doubts = []
    for rate in trajectories.rates:
        y = np.concatenate(rate.values)
        seen = np.isfinite(y)
        if seen.sum() < _FEWEST:
            continue
        design = designs[rate.derivative][seen]
        curve, *others = (
            design @ np.ascontiguousarray(points[:, rate.coordinate])
            for points in (alone.control_points, *again)
        )
        text = _about(rate.derivative, y[seen], curve, others)
        if text:
            doubts.append(f"the {rate.label(trajectories.coordinates)} {text}")
    return doubts


def _about(derivative: int, y: np.ndarray, curve: np.ndarray, others: list[np.ndarray]) -> str:
    """What is wrong with the samples y of a derivative, given that of the curve and of its replicates."""
    factor, offset, noise = _line(curve, y)
    rng = np.random.default_rng(0)
    scatter = noise / max(abs(factor), 1.0) * rng.standard_normal((len(others), y.size))
    usual = np.array([_line(c, curve + e)[:2] for c, e in zip(others, scatter, strict=True)])
    bias, spread = usual.mean(axis=0) - [1.0, 0.0], usual.std(axis=0, ddof=1)
    factor, offset = factor - bias[0], offset - bias[1] * factor
    size = float(np.std(curve))
    if abs(factor - 1.0) > max(_FACTOR, _SURE * spread[0]):
        explained = 1.0 - noise**2 / max(noise**2 + (factor * size) ** 2, 1e-300)
        if explained < _FOLLOWS:
            return (
                "hardly follows the derivative of its coordinate: check that the columns belong together, and "
                "their times"
            )
        return (
            f"is {factor:.3g} times the derivative of its coordinate{_unit(derivative, factor)}: convert it, or "
            "leave it out"
        )
    if abs(offset) > max(_SURE * spread[1], min(_FACTOR * size, noise)):
        return (
            f"has an offset of {offset:.3g} from the derivative of its coordinate: subtract it, it is what the "
            "sensor shows at rest"
        )
    return ""


def _unit(derivative: int, factor: float) -> str:
    """Which unit a factor points to, as a question."""
    known = {1.0: "the opposite sign", **_UNITS[derivative], **_PREFIXES}
    for value, text in known.items():
        if abs(abs(factor) / value - 1.0) < _NEAR:
            sign = ", with the opposite sign" if factor < 0.0 and value != 1.0 else ""
            return f" ({text}{sign}?)"
    return " (with the opposite sign?)" if factor < 0.0 else ""


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Slope, intercept and scatter of y = a x + b, by Huber's weights: spikes of a sensor count little."""
    columns, weight = np.stack([x, np.ones_like(x)]), np.ones_like(x)
    solution, scatter = np.zeros(2), 0.0
    for _ in range(_ROUNDS):
        weighted = columns * weight
        before = solution
        solution = np.linalg.lstsq(weighted @ columns.T, weighted @ y, rcond=None)[0]
        left = y - solution @ columns
        scatter = 1.4826 * float(np.median(np.abs(left)))
        weight = np.minimum(1.0, _HUBER * scatter / np.maximum(np.abs(left), 1e-300))
        if np.allclose(solution, before, rtol=1e-6, atol=0.0) or scatter == 0.0:
            break
    return float(solution[0]), float(solution[1]), scatter
