"""What decides about a verdict.

Each value says its unit, its origin, and what happens at half and at twice the value (of a ratio: at half
and twice its distance from one), as `benchmarks/thresholds.py` measures on 30 right and wrong set-ups that
no rule was made for; causes on 8 wrong ones, rates on 32 channels, `cancelling` on 9 and shapes on 6
recordings, parts on 108 machines. "No effect": no finding and no status changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["DIAGNOSIS", "DiagnosisSettings"]


@dataclass(frozen=True)
class DiagnosisSettings:
    """Settings of `leastaction.diagnosis`."""

    half_a_sample: float = 0.15
    """Sampling intervals around half of one, in which a delay means held forces. Half, twice: no effect."""

    certain: float = 20.0
    """z of every term of a search begun anew. Laws had 170, imitations 4 to 8. Half, twice: no effect."""

    force_share: float = 0.3
    """Share of the squared residuals that rescaled forces have to explain. Half, twice: no effect."""

    rate_factor: float = 0.05
    """Share by which the calibration of a sensor may be off. Half: 2 of 12 right channels are doubted; twice:
    8 of 20 wrong ones are named instead of 12."""

    rate_follows: float = 0.25
    """Squared correlation below which a channel does not belong to its coordinate. Half, twice: no effect."""

    rate_clear: float = 3.0
    """Motion over noise in a channel, below which nothing is said about it. Half, twice: no effect."""

    rate_width: float = 1.25
    """Periods of a coordinate in a test function. Half: 14 of 20 wrong channels are named instead of 12;
    twice: 5."""

    worth_knowing: float = 0.001
    """Equation error relative to the terms of the equation. Less is neither noted nor explained: exact
    libraries leave 0.0002 at most. Half: 2 notes more; twice: 1 fewer."""

    slight: float = 3e-4
    """Share of the forces of an equation. A smaller effect is a note, however significant: friction of that
    size takes some 0.4 % of the energy a period. Preference. Half, twice: no effect."""

    part_of_error: float = 0.25
    """Share of the variance of the equation error. What explains less is a note: most of what is unexplained
    is something else. Half: no effect; twice: one result that lacks friction of 1 % a period is ok."""

    follows: float = 0.2
    """Error of free runs over a period, relative to the spread of the data; of trials left out of the fit
    where that is known. With less, a law whose equations hold to some per cent only is usable. Preference.
    Half: one result in coloured noise is doubtful; twice: two that lack a delay or a sign are usable."""

    noise_ratio: float = 1.15
    """Residual of a fit over that of the smoothing: more is unexplained motion. Half, twice: no effect."""

    indistinct: float = 0.3
    """Relative standard error above which a coefficient is hardly determined, a scale is open (3 to 20 for
    springs, 0.002 where a force fixes it; small motions of seven other systems had eleven above), or a hidden
    motion, relative to its spread. Half: 1 finding more, on a wrong law; twice: no effect."""

    form_matters: float = 0.01
    """Change of the accelerations, relative to them, by which a better smooth form of L is worth a doubt.
    Not from a study; five times less than what a result is called wrong for. Half, twice: no effect."""

    form_open: float = 0.05
    """Root mean square by which accelerations may be off over smooth changes of L, relative to them; what
    the study `unlisted` calls wrong. Of its seen laws 18 of 21 that were ok and wrong pass it, of 111
    correct results none. Half: 2 of 9 right results are doubtful; twice: one right result more is ok."""

    form_bound: float = 1.64
    """Standard deviations of the accelerations, over smooth changes of both energies of one coordinate, that
    stay within `form_open`; of what looks like an imitation, as for a risk of 5 %. Half, twice: no effect."""

    bumps_alone: int = 8
    """Bumps along a coordinate in smooth changes of L. Half: no effect; twice: 2 of 9 right results are
    doubtful, one wrong one is ok."""

    bumps_each: int = 5
    """The same along each of two coordinates, and of a mass. Half: 2 more right ones ok; twice: 2 fewer."""

    bump_width: float = 1.2
    """Distances between bumps. Half: one wrong result is ok; twice: one right result more is ok."""

    bump_visited: float = 0.005
    """Share of the motion near a bump, at least. Half, twice: no effect."""

    wave_share: float = 0.2
    """Share of the equation error that a function of time has to explain before it is searched with. Eight
    laws that depend on time gave 0.36 to 0.81, eight that lack a term 0.01 to 0.51. Half: 3 of these instead
    of 2 are searched with, in vain; twice: one of 15 recordings of the former is not named."""

    part_explains: float = 0.55
    """Share of what no other term explains that a part without a sensor has to explain. Of 48 machines with
    one 46 pass, of 60 without 2. Half: 46, 5 without; twice: 29, 1 without."""

    part_few_turns: float = 0.75
    """The same where the recordings hold fewer turns than `part_turns`. Half: no effect; twice: 1 without."""

    part_certain: float = 0.9
    """The same for two parts, or where another form of L explains as much. Half: 46, 4 without one; twice:
    45, 2 without."""

    part_agrees: float = 0.7
    """Size of the part in each quarter of the recordings over that in all. Half: 46, 3 without one; twice:
    none."""

    part_turns: float = 12.0
    """Turns of the part in all recordings: each quarter holds three. Half: no effect; twice: 44 of 48."""

    part_fastest: float = 4.0
    """Highest frequency of such a part over that of the fastest coordinate. Half and a quarter of it are
    tried, too, because noise of the accelerations hides parts above. It alone: 44 of 48; without it: 42."""

    cancelling: float = 5.0
    """Standard deviation of the force of a term over that of all terms of the same coordinates, beyond which
    they cancel. 147 true laws reached 1.0. Half, twice: no effect."""

    shape_far: float = 1.5
    """Ranges of a shape parameter from their middle, beyond which it is open. Half, twice: no effect."""

    shape_far_log: float = 0.6
    """The same of a logarithmic range, as of a in exp(−a x). Half, twice: no effect."""

    one_and_the_same: float = 0.99
    """Correlation above which an open shape parameter is named with another. Half, twice: no effect."""

    visible: float = 0.3
    """Motion over noise, below which any equations hold. Half: 1 finding fewer; twice: no effect."""

    much_noise: float = 0.2
    """Noise over spread, above which fast motion may have been taken for noise. Half, twice: no effect."""

    part_of_it: float = 0.3
    """Share of the largest relative change, for a term of an open combination. Half, twice: no effect."""

    few_samples: float = 7.0
    """Samples a period of the fastest motion. Half, twice: no effect."""

    band: float = 12.0
    """Frequencies of the fastest coordinate up to which an equation error counts. Half, twice: no effect."""

    of_forces: float = 4.0
    """Spectral density of an equation error over that of the scatter of the forces. Noise of forces gives 0.2
    to 3, a missing term 30 and more. Half, twice: no effect."""

    lag_one: float = 0.1
    """Correlation of neighbouring residuals that is noted, beyond 4 σ. Half: no effect; twice: 1 fewer."""

    two_turns: float = 4.0 * math.pi
    """Radians of an angle in a recording, above which it may be in degrees. Half, twice: no effect."""

    small_offset: float = 0.05
    """Radians, about: a smaller sine beside a cosine is an offset. Half: no effect; twice: 1 note more."""


DIAGNOSIS = DiagnosisSettings()
