"""What decides in the fit: which equation errors count, when a fit can be used.

Each value says its unit, where it comes from, and what happens at half and at twice the value (of a
ratio: at half and twice its distance from one). That is measured by `benchmarks/thresholds.py` on 8
set-ups that no rule was made for, four right and four wrong ones, or 30 (weights and corrections); six with
prescribed coordinates, two recordings each of three laws with shape parameters, nine of a pendulum with slow
forces or without. "No effect": no structure and no finding changes.
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

    weights_settled: float = 0.05
    """Standard errors by which a round of new weights may move a coefficient at the end. Half, twice: one
    note is another."""

    evidence_settled: float = 0.5
    """Log likelihood by which such a round may raise it at the end, and may lower it on the way: noise in
    data moves it by as much for every coefficient. More than 100,000 samples share it. Half: one rival
    more, of a wrong law; twice: no effect."""

    correction_saves: float = 0.5
    """Share of the fall of the cost that a step promised, which its second-order correction has to save.
    Half, twice: no effect."""

    correction_moves: float = 0.1
    """Share of what a step promised by moving coefficients, which its correction may promise: it is one
    of the curve. Half, twice: no effect."""

    small_error: float = 1e-3
    """Equation error relative to its terms that is as good as none beside a prescribed coordinate, where
    it is lost among the directions of the curve. Half, twice: no effect."""

    no_error: float = 1e-5
    """The same, below which w no longer grows: a curve can meet an equation at all points. Half, twice:
    no effect."""

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
    """Ratio to the scale of the data, up and down, of rates and lengths that a search begins with. Half: one
    wrong result of six is no longer ok; twice: no effect."""

    shape_beyond: float = 0.5
    """Share of the spread of the data by which places lie beyond them that a search begins with. Half,
    twice: no structure or status changes."""

    shape_smallest: float = 0.03
    """Share of the coordinate of the smallest length that a search begins with, where it is added in
    squares: less is as good as none. Half, twice: no effect."""

    stribeck_width: float = 0.003
    """Share of the rms velocity, as `dry_width`, where Stribeck friction is offered: with 0.01 that makes up
    for what the smoothing of dry friction leaves out, in three of three pendulums."""

    stribeck_scales: tuple[float, float] = (0.02, 0.5)
    """Least and greatest scale of Stribeck friction over the rms velocity. Less is lost in the smoothing;
    more is nearly a straight line, which viscous friction is already."""

    bias_settled: float = 0.02
    """Share of a slow force that one more round may change. Half: no effect; twice: forces off by 0.0070
    instead of 0.0071 N m."""

    bias_stalled: float = 0.5
    """Share of the change of the round before: a change that is hardly smaller follows the noise. Half,
    twice: no effect."""

    no_bias: float = 1.5
    """Standard errors. A slow force that is smaller on average is reported as hardly any. Half: two of three
    pendulums without one are said to have one; twice: no effect."""


ESTIMATION = EstimationSettings()
