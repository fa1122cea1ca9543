"""Thresholds and sizes of the search for the motion of a hidden coordinate.

Each value gives its unit and its origin. If it names none, the value was set on the measured double pendulum
and tested on the simulated systems of `docs/hidden.md`.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["HIDDEN", "HiddenSettings"]


@dataclass(frozen=True)
class HiddenSettings:
    """Settings of `leastaction.hidden`."""

    first_window: float = 1 / 3
    """Length of the first windows, in periods of the measured motion. Over this time, a motion that starts
    near the true one stays near it."""

    stages: tuple[tuple[float, int, int, int], ...] = ((1, 8, 128, 6), (2, 12, 36, 5), (2, 12, 6, 24))
    """For each stage: horizon in lengths of the first windows (a power of two), number of windows, sets of
    coefficients, steps of their fit. The first stage has all draws. In short windows most laws can follow the
    motion, so few steps rank them; in longer ones, the right law may need 60 from far away. Of 15 draws for
    three systems with 17 candidates, 12 lead to the law. With 256 draws, of which 54 are fitted in more short
    windows and 45 in longer ones, nine do, in twice the time for each law."""

    few_terms: float = 8.0
    """Number of terms for which these numbers suffice. With more, the number of windows is larger in this
    proportion, and after the first stage those of sets and steps, too."""

    last: tuple[float, int, int, int] = (4, 12, 3, 40)
    """The same for the stage in which a law has to follow the motion."""

    doublings: int = 2
    """Largest number of times that the horizon doubles after the last stage, while several laws follow. It
    doubles once even for one law that misses some windows, or in a strict search."""

    batches: tuple[int, int] = (6, 24)
    """Largest number of draws, with many terms and with few: with few, a draw takes a second."""

    same: float = 0.99
    """Smallest correlation between the hidden rates of two sets that are the same law. It is 0.997 and more
    between sets that lead to the law of three systems, and 0.63 to 0.986 with others that follow closely."""

    usual: float = 4.0
    """Largest mean squared deviation of a window whose rates are compared, as a multiple of the middle
    window's. Others may be on a wrong branch."""

    stands_out: float = 1.5
    """Smallest ratio of the costs of the second best and the best law at which the best stands out. Draws can
    also end twice at the same wrong law, but others then cost little more."""

    closely: float = 0.5
    """Largest deviation of the best law, in units of deviations, at which no more are drawn. The right law
    deviates by 0.2 to 0.4, by the error of the smoothed motion."""

    follows: float = 10.0
    """Largest deviation, in units of deviations, of a law that stands out."""

    state_rounds: int = 3
    """Steps of a fit of initial states, on each horizon."""

    branches: int = 8
    """Motions of each window from which the path is chosen, and as many from the windows before and after.
    With four or sixteen, all windows of seven data sets of five simulated systems are on the right branch,
    too."""

    jump: float = 0.2
    """Largest jump of a motion, in scales of the hidden state, at which no more are searched for. With 10 %
    noise, motions of the magnetic pendulum on the right branches jump by at most 0.2, others by up to 2."""

    step: float = 0.025
    """Longest step of the integration, in periods. Its error is far below that of the start values."""

    coarse_step: float = 0.03
    """The same in the stages before the last, which only rank laws. At the end of windows of 1.3 periods,
    without noise, its error is 0.02 to 0.04 deviations of four systems, and 0.8 between magnets."""

    fewest_steps: int = 11
    """Steps in a window."""

    counted: float = 2e-3
    """Smallest unit of deviations, as a share of the spread of a coordinate. Smaller deviations do not
    distinguish branches."""

    spread: float = 0.9
    """Standard deviation of the logarithm of drawn coefficients about their scale, a factor of 2.5."""

    over_forces: float = 50.0
    """Largest ratio of the forces in a driven motion to those that drive it."""

    active: float = 4.5
    """Number of terms of L that are drawn at their size; the others start near zero."""

    near_zero: float = 0.05
    """Size of the others, as a share of their scale."""

    angles: int = 12
    """Number of equally spaced start values of a hidden angle."""

    lengths: int = 5
    """Number of start values of any other hidden coordinate, between ± 2 of its scale."""

    rates: int = 5
    """Number of start values of a hidden rate, between ± 2 of its scale."""

    kept: int = 3
    """Number of start values of a window that are fitted over its whole length; over half of it, twice as
    many. With three, the true law follows 24 of 25 windows of 1.3 periods of the magnetic pendulum without x
    (data set 1); with as many fitted over the whole length only, one of twelve."""

    most_starts: int = 150
    """Largest number of start values of a window; if several coordinates are hidden, they are drawn."""


HIDDEN = HiddenSettings()
