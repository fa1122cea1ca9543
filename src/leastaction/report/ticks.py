"""Scales of an axis, positions of values and ticks: linear, logarithmic, and logarithmic for either sign."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from leastaction.report.text import in_powers, typeset

__all__ = ["Folded", "Linear", "Log", "Scale", "Ticks", "folded", "written"]

_SMALLEST = 1e-300  # smaller steps could underflow in a division
_LINEAR = 10.0  # a folded axis is linear within this and logarithmic beyond


@dataclass(frozen=True)
class Ticks:
    """Ticks from low to high: positions on the axis, texts, and the power of ten that the texts omit."""

    places: Sequence[float]
    texts: Sequence[str]
    power: int = 0


class Scale(Protocol):
    """Maps values to positions on an axis; limits and margins are lengths on it."""

    @property
    def room(self) -> float:
        """Space of one tick in pixels."""
        ...

    def place(self, values: np.ndarray) -> np.ndarray:
        """Positions of values; the map is increasing."""
        ...

    def margin(self, low: float, high: float) -> float:
        """Margin of the axis at either end of the data."""
        ...

    def ticks(self, low: float, high: float, most: int) -> Ticks:
        """At most `most` steps between the positions `low` and `high`."""
        ...


@dataclass(frozen=True)
class Linear:
    """Equal lengths for equal differences; ticks at multiples of 1, 2 or 5 (`steps`) times a power of ten.

    Parameters
    ----------
    room, share : float
        Space of one tick in pixels, and margin at either end as a share of the range of the data.
    steps : sequence of float
        Increasing, from 1 to less than 10.
    whole : bool
        Ticks at integers only.
    """

    room: float = 80.0
    share: float = 0.01
    steps: Sequence[float] = (1.0, 2.0, 5.0)
    whole: bool = False

    def place(self, values: np.ndarray) -> np.ndarray:
        return values

    def margin(self, low: float, high: float) -> float:
        return self.share * (high - low)

    def ticks(self, low: float, high: float, most: int) -> Ticks:
        """The smallest round step of at least (high − low) / most; a shorter one if it gives fewer than two.

        Examples
        --------
        >>> Linear().ticks(-0.3, 7.9, 5)
        Ticks(places=[0.0, 2.0, 4.0, 6.0], texts=['0', '2', '4', '6'], power=0)
        >>> Linear().ticks(-1e-6, 2e-6, 4)
        Ticks(places=[-1e-06, 0.0, 1e-06, 2e-06], texts=['−1', '0', '1', '2'], power=-6)
        """
        least = 1.0 if self.whole else 0.0
        raw = max((high - low) / most, least, _SMALLEST)
        exponent = math.floor(math.log10(raw))
        # From the text of the number, which is exact; a product of floats may not be.
        rising = [float(f"{step}e{exponent + k}") for k in (-1, 0, 1) for step in self.steps]
        fitting = next(k for k, step in enumerate(rising) if step >= raw * (1 - 1e-9))
        slack = 1e-9 * (high - low)
        places: list[float] = []
        for step in reversed(rising[: fitting + 1]):
            first, last = math.ceil((low - slack) / step), math.floor((high + slack) / step)
            places = [k * step for k in range(first, last + 1)]
            if len(places) >= 2 or step <= least:
                break
        return Ticks(places, *written(places))


def written(places: Sequence[float]) -> tuple[list[str], int]:
    """Texts with the decimals that the step requires, and the power of ten that long texts omit."""
    largest = max((abs(v) for v in places), default=0.0)
    power = math.floor(math.log10(largest) + 1e-9) if largest > 0 else 0
    power = 0 if -3 <= power < 5 else power
    scaled = [v / float(f"1e{power}") for v in places]
    step = min((b - a for a, b in pairwise(scaled)), default=1.0)
    decimals = next((d for d in range(12) if abs(round(step, d) - step) <= 1e-3 * step), 12)
    return [f"{v + 0.0:.{decimals}f}".replace("-", "−") for v in scaled], power


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
