"""A likely cause, and by how much it would explain the motion better."""

from __future__ import annotations

from dataclasses import dataclass

from leastaction.findings import Finding

__all__ = ["Cause"]


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
