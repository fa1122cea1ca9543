"""What decides in the fit: which equation errors count, when a fit can be used.

Each value says its unit, where it comes from, and what happens at half and at twice the value (of a
ratio: at half and twice its distance from one). That is measured by `benchmarks/thresholds.py` on 8
set-ups that no rule was made for, four right and four wrong ones. "No effect": no structure and no
finding changes. Slow forces are not among them.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ESTIMATION", "EstimationSettings"]


@dataclass(frozen=True)
class EstimationSettings:
    """Settings of `leastaction.estimation`."""

    slack_left: float = 30.0
    """Directions of the curve, of thousands, in which an equation error shows. With fewer, hardly any
    equation error is left: exact libraries leave 12 at most, inexact ones hundreds. Half: one of two
    frictions is not named; twice: one note fewer."""

    mostly_regular: float = 0.9
    """Share of the motion along which the mass matrix has to be positive definite for a structure to be
    considered at all. Preference: noise may spoil single points, a wrong sign spoils all. Half, twice: no
    effect."""

    as_likely: float = 1.0
    """Log likelihood. Larger weights of equations are as likely while it falls by no more: e^-1 of the
    maximum, a plateau that data cannot see. Half: one rival more, twice: two fewer, of wrong laws."""

    bias_settled: float = 0.02
    """Share of a slow force that one more round may change. Half, twice: not measured."""

    bias_stalled: float = 0.5
    """Share of the change of the round before: a change that is hardly smaller follows the noise. Half,
    twice: not measured."""

    no_bias: float = 1.5
    """Standard errors. A slow force that is smaller on average is reported as hardly any. Half, twice: not
    measured."""


ESTIMATION = EstimationSettings()
