"""What decides about a verdict.

Each value says its unit and where it comes from. What half and twice of it do is measured by
``benchmarks/thresholds.py``, on set-ups that no rule was made for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["DIAGNOSIS", "DiagnosisSettings"]


@dataclass(frozen=True)
class DiagnosisSettings:
    """Settings of `leastaction.diagnosis`."""

    half_a_sample: float = 0.15
    """Sampling intervals by which a delay may differ from half of one, to be called forces that are held."""

    certain: float = 20.0
    """Standard errors of every term of a search begun anew. Laws had 170 and more, what imitates them terms
    of 4 to 8."""

    force_share: float = 0.3
    """Share of the residual's sum of squares that forces of another scale have to explain."""

    rate_factor: float = 0.05
    """Share by which the calibration of a sensor may be off."""

    rate_follows: float = 0.25
    """Squared correlation below which a channel has nothing to do with its coordinate."""

    rate_clear: float = 3.0
    """Motion over noise in a channel, below which nothing is said about it."""

    worth_knowing: float = 0.001
    """Equation error relative to the terms of the equation. Less is neither noted nor explained: exact
    libraries leave 0.0002 at most."""

    noise_ratio: float = 1.15
    """Residual of a fit over that of the smoothing: more is motion that the equations do not explain."""

    indistinct: float = 0.3
    """Relative standard error above which a coefficient is hardly determined."""

    visible: float = 0.3
    """Motion over noise, below which any equations hold."""

    much_noise: float = 0.2
    """Noise over spread, above which fast motion may have been taken for noise."""

    part_of_it: float = 0.3
    """Share of the largest relative change, above which a term belongs to a combination that is open."""

    few_samples: float = 7.0
    """Samples a period of the fastest motion."""

    band: float = 12.0
    """Frequencies of the fastest coordinate, up to which the spectral density of an equation error counts."""

    of_forces: float = 4.0
    """Spectral density of an equation error over that of the scatter of the forces. Noise of forces gives 0.2
    to 3, a missing term 30 and more."""

    lag_one: float = 0.1
    """Correlation of neighbouring residuals that is noted, beyond four standard errors of it."""

    two_turns: float = 4.0 * math.pi
    """Radians that an angle covers within a recording, above which it may be in degrees."""

    small_offset: float = 0.05
    """Radians, about. A smaller sine beside a cosine is an offset of the angle's zero."""


DIAGNOSIS = DiagnosisSettings()
