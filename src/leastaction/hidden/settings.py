"""What decides in the search for the motion of a hidden coordinate.

Each value says its unit and where it comes from. They were set on the measured double pendulum; the simulated
systems of `docs/hidden.md` judge them.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["HIDDEN", "HiddenSettings"]


@dataclass(frozen=True)
class HiddenSettings:
    """Settings of `leastaction.hidden`."""

    first_window: float = 1 / 3
    """Length of the first windows, in periods of the measured motion. A motion that begins anywhere near the
    true one stays near it for so long."""

    stages: tuple[tuple[float, int, int, int], ...] = ((1, 8, 256, 10), (1, 20, 32, 12), (2, 20, 10, 15))
    """Horizon in first windows, windows, sets of coefficients, steps of their fit. The first has all draws.
    With many terms there are more windows."""

    terms_of_windows: float = 8.0
    """Terms that the windows above suffice for."""

    last: tuple[float, int, int, int] = (4, 20, 4, 20)
    """The same of the stage in which two draws have to agree."""

    batches: int = 3
    """Of draws, at most."""

    same: float = 0.05
    """Relative difference of coefficients of the same law, after a fit of few windows."""

    stands_out: float = 1.5
    """Ratio of the costs of the second best law and of the best, from which on the best stands out."""

    state_rounds: int = 3
    """Steps of a fit of initial states."""

    branches: int = 8
    """Motions of a window among which a chain chooses."""

    step: float = 0.02
    """Periods: longest step of the integration. Errors of the method are far below those of the start."""

    fewest_steps: int = 16
    """In a window."""

    counted: float = 2e-3
    """Share of the spread of a coordinate that a deviation is counted in at least. Smaller deviations than
    this decide nothing between branches."""

    spread: float = 0.9
    """Natural logarithm: standard deviation of drawn coefficients about their scale, a factor of 2.5."""

    over_forces: float = 50.0
    """Largest ratio of the forces in a driven motion to those that drive it."""

    active: float = 4.5
    """Of the terms of L, how many are drawn at their size; the others begin near zero."""

    near_zero: float = 0.05
    """Share of their size at which these begin."""

    angles: int = 12
    """Angles of a hidden coordinate, equally spaced, at which motions begin."""

    lengths: int = 5
    """Values of a hidden coordinate that is no angle, between ± 2 of its scale."""

    rates: int = 5
    """Rates of a hidden coordinate, between ± 2 of its scale."""

    kept: int = 3
    """Of the begins of a window, how many are refined."""

    most_starts: int = 150
    """Begins of a window at most; where several coordinates are hidden, they are drawn."""


HIDDEN = HiddenSettings()
