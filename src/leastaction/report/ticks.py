"""Scales of an axis: positions of values, and ticks; the linear scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

__all__ = ["Linear", "Scale", "Ticks", "written"]

_SMALLEST = 1e-300  # smaller steps could underflow in a division


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
