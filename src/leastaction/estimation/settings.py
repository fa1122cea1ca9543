"""Thresholds of the fit: which equation errors count, and which fits are usable.

Each value gives its unit, its origin, and the effect of half and twice the value (for a ratio: of half and
twice its distance from one). `benchmarks/thresholds.py` measures this effect on 8 set-ups that no rule was
made for, four right and four wrong ones. It uses 30 set-ups for weights and corrections, six with prescribed
coordinates, two recordings each of three laws with shape parameters, and nine of a pendulum with or without
slow forces. "No effect" means that no structure and no finding changes.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ESTIMATION", "EstimationSettings"]


@dataclass(frozen=True)
class EstimationSettings:
    """Settings of `leastaction.estimation`."""

    slack_left: float = 30.0
    """Number of directions of the curve, of thousands, in which an equation error is visible. Below this,
    equations count as nearly exact: exact libraries leave 12 at most, inexact ones hundreds. Half: one of
    two frictions is not named; twice: one note fewer."""

    mostly_regular: float = 0.9
    """Share of the motion along which the mass matrix has to be positive definite for a structure to be
    considered. Chosen because noise may affect single points, and a wrong sign affects all. Half, twice: no
    effect."""

    as_likely: float = 1.0
    """Decrease of the log likelihood up to which larger equation weights count as equally likely (e^-1 of the
    maximum). Half: one more competing structure; twice: two fewer, of wrong laws."""

    weights_settled: float = 0.05
    """Standard errors by which the last round of new weights may move a coefficient, and relative change of
    the degrees of freedom of the equation error. Above 100,000 samples the change may grow in proportion to
    their number, the move with its square root. Half, twice: one note changes."""

    evidence_settled: float = 0.5
    """Log likelihood by which such a round may raise it at the end, and may lower it before: noise in the
    data changes it by as much for every coefficient. Above 100,000 samples the value grows in proportion.
    Half: one more competing structure, of a wrong law; twice: no effect."""

    correction_saves: float = 0.5
    """Smallest share of the predicted decrease of the cost that a second-order correction must recover. Half,
    twice: no effect."""

    correction_moves: float = 0.1
    """Largest share of the decrease predicted from the coefficients that a correction may add, because it
    corrects the curve. Half, twice: no effect."""

    small_error: float = 1e-3
    """Equation error, relative to its terms, that counts as none beside a prescribed coordinate, where the
    directions of the curve hide it. Half, twice: no effect."""

    no_error: float = 1e-5
    """The same, below which w no longer grows, because a curve can satisfy an equation at all points. Half,
    twice: no effect."""

    dry_width: float = 0.01
    """Share of the rms velocity below which |v| of dry friction is smoothed. Half, twice: no effect."""

    shape_settled: float = 0.01
    """Standard errors by which the last step may move a shape parameter. Half: rms z of the numbers 1.39
    instead of 1.31; twice: 1.31."""

    shape_step: float = 0.5
    """Share of a shape parameter, or of a quarter of its range, that one step may change. Half: one right
    result of four is no longer ok, rms z 1.51 instead of 1.31; twice: one of four right structures is
    lost."""

    shape_scales: float = 10.0
    """Largest ratio, up and down, between the start values of rates and lengths and the scale of the data.
    Half: one wrong result of six is no longer ok; twice: no effect."""

    shape_beyond: float = 0.5
    """Share of the spread of the data by which start values of positions may lie outside them. Half, twice:
    no structure or status changes."""

    shape_smallest: float = 0.03
    """Smallest start value of a length that is added in squares, as a share of the coordinate; smaller ones
    have no effect. Half, twice: no effect."""

    stribeck_width: float = 0.003
    """As `dry_width`, if Stribeck friction is offered. With 0.01, Stribeck friction compensated for the
    smoothing of dry friction in three of three pendulums."""

    stribeck_scales: tuple[float, float] = (0.02, 0.5)
    """Smallest and largest scale of Stribeck friction over the rms velocity. Below this range, the smoothing
    hides it; above, it is nearly a straight line, as viscous friction is."""

    bias_settled: float = 0.02
    """Share of a slow force that one more round may change. Half: no effect; twice: forces off by 0.0070
    instead of 0.0071 N m."""

    bias_stalled: float = 0.5
    """Share of the change of the previous round: a change that is hardly smaller follows the noise. Half,
    twice: no effect."""

    no_bias: float = 1.5
    """Standard errors. A slow force that is smaller on average is reported as not significant. Half: two of
    three pendulums without one are reported to have one; twice: no effect."""


ESTIMATION = EstimationSettings()
