"""Logarithmic scales of an axis: of positive values, and of values of either sign."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from leastaction.report.text import in_powers, typeset
from leastaction.report.ticks import Ticks, written

__all__ = ["Folded", "Log", "folded"]

_LINEAR = 10.0  # a folded axis is linear within this and logarithmic beyond


@dataclass(frozen=True)
class Folded:
    """Linear within ±10 and logarithmic beyond, for differences of any size and sign."""

    room: float = 36.0

    def place(self, values: np.ndarray) -> np.ndarray:
        return folded(values)

    def margin(self, low: float, high: float) -> float:
        return 0.3

    def ticks(self, low: float, high: float, most: int) -> Ticks:
        """Zero and powers of ten; every second, third, … of many; 1, 2 and 5 times them if there is only one.

        Examples
        --------
        >>> Folded().ticks(-1.2, 2.9, 5).texts
        ['−10', '0', '10', '100']
        >>> Folded().ticks(-0.3, 0.8, 5).texts
        ['−2', '−1', '0', '1', '2', '5']
        """
        levels = range(math.floor(low), math.ceil(high) + 1)
        every = max(1, len(levels) // max(most, 1))
        there = [k for k in levels if k % every == 0 and low <= k <= high]
        if len(there) >= 2:
            return Ticks([float(k) for k in there], [in_powers(k) for k in there])
        sizes = [m * 10.0**k for k in range(max(abs(k) for k in levels) + 1) for m in (1.0, 2.0, 5.0)]
        values = np.array([*(-size for size in reversed(sizes)), 0.0, *sizes])
        values = values[(folded(values) >= low) & (folded(values) <= high)]
        return Ticks(folded(values).tolist(), *written(values.tolist()))


@dataclass(frozen=True)
class Log:
    """Equal lengths for equal ratios of positive values; others have no position."""

    room: float = 45.0
    share: float = 0.02

    def place(self, values: np.ndarray) -> np.ndarray:
        return np.log10(np.where(values > 0.0, values, np.nan))

    def margin(self, low: float, high: float) -> float:
        return self.share * (high - low)

    def ticks(self, low: float, high: float, most: int) -> Ticks:
        """Powers of ten; every second, third, … of many; 1, 2 and 5 times them if there is only one.

        Examples
        --------
        >>> Log().ticks(-1.2, 2.9, 5).texts
        ['0.1', '1', '10', '100']
        >>> Log().ticks(-5.3, 0.2, 3).texts
        ['10⁻⁴', '0.01', '1']
        >>> Log().ticks(0.1, 0.9, 5).texts
        ['2', '5']
        """
        levels = range(math.ceil(low), math.floor(high) + 1)
        every = max(1, math.ceil(len(levels) / max(most, 1)))
        there = [k for k in levels if k % every == 0]
        if len(there) >= 2:
            return Ticks([float(k) for k in there], [_power(k) for k in there])
        sizes = [float(f"{m}e{k}") for k in range(math.floor(low), math.ceil(high) + 1) for m in (1, 2, 5)]
        sizes = [size for size in sizes if low <= math.log10(size) <= high]
        return Ticks([math.log10(size) for size in sizes], [f"{size:g}" for size in sizes])


def folded(values: np.ndarray) -> np.ndarray:
    """±1 for ±10, ±2 for ±100, …; linear in between."""
    size = np.abs(values)
    beyond = 1.0 + np.log10(np.maximum(size, _LINEAR) / _LINEAR)
    return np.sign(values) * np.where(size <= _LINEAR, size / _LINEAR, beyond)


def _power(level: int) -> str:
    """10 to an integer power."""
    return f"{10.0**level:g}" if -3 <= level <= 3 else typeset(f"1e{level}").removeprefix("1 × ")
