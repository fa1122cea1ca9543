"""A likely cause, and by how much it would explain the motion better."""

from __future__ import annotations

from dataclasses import dataclass

from leastaction.findings import Finding

__all__ = ["BETTER", "Cause"]

# what warnings propose has to explain the motion so much better: −2 log likelihood beyond the price of every
# term; to it comes the relevant share of the equation error's variance, as in the selection
BETTER = 10.0


@dataclass(frozen=True)
class Cause:
    """What would explain the motion better.

    Attributes
    ----------
    finding : Finding
    gain : float
        By how much it lowers −2 log likelihood, the price of every term included.
    holds : bool
        Whether the equations hold with it.
    """

    finding: Finding
    gain: float
    holds: bool
