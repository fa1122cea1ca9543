"""What decides about knots and outliers.

Each value says its unit, where it comes from, and what happens at half and at twice the value (of a ratio:
at half and twice its distance from one). That is measured by `benchmarks/thresholds.py` on 8 set-ups that
no rule was made for, four right and four wrong ones (30 where other findings are spoken of), and outliers
on six recordings. What concerns fast motion was tried on five resonators at nine samples a period
(`tests/selection/test_search.py`), too, all of which get the right structure. "No effect": no structure
and no finding changes.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CURVE", "CurveSettings"]


@dataclass(frozen=True)
class CurveSettings:
    """Settings of `leastaction.curve`."""

    knots_per_radian: float = 4.0
    """Knots while the q̈ of the fastest coordinate turns by one radian, on the first grid. A sine at four
    knots a radian is followed by quintic splines to 10⁻⁵; finer grids follow if needed. Half: one of two
    frictions is not named; twice: no effect."""

    most_over_slower: float = 3.5
    """Knots that the third derivative may ask for, over those that the second asks for. Simulated motions ask
    for 1 to 3 times as many; noise and vibration for many more. Half, twice: no effect."""

    knots_settled: float = 0.25
    """Share by which the knots that the motion asks for may differ from those that show it. Half, twice:
    other findings about one wrong result."""

    drifts: float = 3.0
    """Knots that swings about a steady drift ask for, over those that the whole motion asks for, above which
    the grids begin with the former: 26 to 33 of angles that turn some 20 times, 1.0 to 1.2 of all other
    coordinates of seven simulated systems. Half, twice: no effect."""

    samples_per_knot: float = 2.5
    """Samples in a knot interval where noise has to be told from what is measured: about outliers, in
    forces. Half (of its distance from one): no effect; twice: other findings about one wrong result."""

    much_left: float = 0.1
    """Share of the spread that a smoother leaves, above which it is asked whether that is motion. Half,
    twice: no effect."""

    foreseen: float = 0.5
    """Share of the squares that a smoother leaves, which two samples have to predict of the next, if that
    is motion: none of white noise, 0.9 and more of a sine at nine samples a period. Half: no effect; twice,
    which is impossible: all five resonators are taken for noise and lost."""

    fewest_samples: float = 7.0
    """Samples a period, with fewer of which motion is not told from noise. Half: no effect; twice: all five
    resonators are taken for noise and lost."""

    unknown_noise: float = 0.01
    """Noise over spread that a fit begins with where a curve on finer knots than samples tells none. Half,
    twice: no effect."""

    follows_forces: float = 0.1
    """Share of the fast second differences of a coordinate that fast forces have to explain if they act.
    Where they do 0.37 to 0.99, on two measured arms and five simulated machines 0.0005 to 0.008. Half,
    twice: no effect."""

    outlier: float = 5.0
    """Standard deviations. One good sample in two million is further off. Half: 383 good samples of 12 000
    are left out instead of 30 (of heavy-tailed noise); twice: 0 of 139 outliers instead of 138."""

    outlier_alone: float = 3.0
    """Times the residuals of the neighbours. A curve that is too smooth is off for many samples in a row.
    Half: 139 of 139 outliers; twice: 131."""

    most_outliers: float = 0.05
    """Share of the samples. More are noise with heavy tails: encoders off by one count in twenty samples.
    Half: 112 of 139 outliers; twice: no effect."""


CURVE = CurveSettings()
