"""What decides about knots and outliers.

Each value says its unit and where it comes from. What half and twice of it do is measured by
``benchmarks/thresholds.py``, on set-ups that no rule was made for.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CURVE", "CurveSettings"]


@dataclass(frozen=True)
class CurveSettings:
    """Settings of `leastaction.curve`."""

    knots_per_radian: float = 4.0
    """Knots while the q̈ of the fastest coordinate turns by one radian, on the first grid.

    A sine at four knots a radian is followed by quintic splines to 10⁻⁵; finer grids follow if needed."""

    most_over_slower: float = 3.5
    """Knots that the third derivative may ask for, over those that the second asks for.

    Simulated motions ask for 1 to 3 times as many; noise and vibration for many more."""

    outlier: float = 5.0
    """Standard deviations. One good sample in two million is further off."""

    outlier_alone: float = 3.0
    """Times the residuals of the neighbours. A curve that is too smooth is off for many samples in a row."""

    most_outliers: float = 0.05
    """Share of the samples. More are noise with heavy tails: encoders off by one count in twenty samples."""


CURVE = CurveSettings()
