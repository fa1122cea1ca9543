"""What would explain the motion better than the model does."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BETTER", "Cause"]

# what warnings propose has to explain the motion so much better: −2 log likelihood beyond the price of every
# term; to it comes the relevant share of the equation error's variance, as in the selection
BETTER = 10.0


@dataclass(frozen=True)
class Cause:
    """What would explain the motion better, in words.

    Attributes
    ----------
    words : str
    gain : float
        By how much it lowers −2 log likelihood, the price of every term included.
    holds : bool
        Whether the equations hold with it.
    """

    words: str
    gain: float
    holds: bool
