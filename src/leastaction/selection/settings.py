"""What decides in the search for a structure.

Each value says its unit, where it comes from, and what happens at half and at twice the value (of a
ratio: at half and twice its distance from one). That is measured by `benchmarks/thresholds.py` on 8
set-ups that no rule was made for, four right and four wrong ones (on 30 of them where notes are counted);
simulations on three machines, shape parameters on two recordings each of three laws, imitations on six laws
that the library lacks and three that it holds. "No effect": no structure, status or finding changes.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["SELECTION", "SelectionSettings"]


@dataclass(frozen=True)
class SelectionSettings:
    """Settings of `leastaction.selection`."""

    false_alarm: float = 1e-3
    """Probability that a check answers wrongly by chance. Every cut-off of a likelihood ratio follows from it
    (`significance`). Preference: a discovery makes about five checks, so one correct recording in 200 is
    called doubtful by chance. Half: four more rivals of doubtful results are named; twice: four fewer; no
    cause is named more or less (gains of 52 right and 42 wrong set-ups)."""

    simple_numbers: float = 0.05
    """Share of chance among the simple numbers that are offered for coefficients. Preference. Half: 92
    instead of 132 of 15 systems are offered; twice: 134; all are true. Laws of random numbers get one in 0.6,
    1.3 and 3.1 % of 1500 cases."""

    holds: float = 0.01
    """Equation error relative to the terms of the equation, above which an equation does not hold. Exact
    libraries leave 0.0002 at most, libraries without a needed term 0.004 and more. Half: one note more;
    twice: a delay is still named, its equation error only noted."""

    solvable: float = 0.999
    """Share of the motion along which the mass matrix has to be positive definite for a search to end. Half,
    twice: no effect."""

    rows_explained: float = 3.0
    """ρ of the weak form (`weak_search`), 1 for the law: with less, the equation error is taken as large
    enough, and no other numbers of shape parameters are looked for. Half, twice: no effect; on noisy friction
    (rotary pendulum) half takes the wrong one."""

    not_followed: float = 1e-6
    """Squared equation error relative to the rows, of exact equations that a curve cannot follow: a
    profile of shape parameters has to end somewhere. Half: one of four right structures is lost;
    twice: rms z of the numbers 1.35 instead of 1.31."""

    shape_compared: int = 3
    """Starts of shape parameters that are compared by fits, at most. Half, twice: no effect."""

    shape_apart: float = 0.03
    """Share of the ranges of shape parameters within which two starts lead to the same fit. Half, twice: no
    effect."""

    shape_lost: float = 50.0
    """Log evidence that a start loses on the first grid, beyond which finer ones are not tried. Half, twice:
    no effect."""

    shape_same: float = 3.0
    """Standard errors within which shape parameters of two fits are those of one law. Half, twice: no
    effect."""

    mirrored: float = 0.9999
    """Correlation of coefficients that nearly cancel, as of x⁴ and |x|ⁿ with n near 4: one is left out in
    turn. Half, or never: no effect."""

    lowest_exponent: float = 0.5
    """Lowest n of |x|ⁿ where x changes its sign. Half, twice: no effect."""

    plain_terms: int = 2
    """Terms above the second degree that a potential may have without a test for imitation. Half, twice: no
    effect."""

    plain_terms_grown: int = 1
    """The same, with which a law of grown candidates is compared with families that are the whole potential.
    Half (rounded up, none) as here; with zero, a double well and an orbit take ten times as long. Twice: two
    of three Morse molecules at 10 % noise are imitated."""

    rows_each: float = 1.6
    """Independent rows a candidate, at least, for a search backward: 1.7 sufficed and 1.4 did not on links
    with 16 to 31 candidates. Half, twice: no effect."""

    overlap: float = 3.0
    """Rows of the weak form that count as one independent row: neighbouring test functions share data. Half,
    twice: no effect."""

    irrelevant: float = 10.0
    """Prior precision at which relevance determination drops a candidate; 1 is the precision that the data
    give it, the other coefficients held. Half, twice: no effect."""

    scale_lost: float = 5.0
    """Standard errors. With no coefficient further from zero, candidates have cancelled the known term and
    the scale of L is lost. Half, twice: no effect."""

    simulated: float = 0.25
    """Periods of the simulations that are minimised. Where errors grow, long ones are biased. Half, twice: no
    effect."""

    horizon: float = 0.5
    """Periods of the simulations that judge between two fits. Half, twice: no effect."""

    window: float = 0.1
    """Share of a simulation along which its start is found. Half: one coefficient of three machines is
    off by 0.42 instead of 0.13 %; twice: no effect."""

    clearly: float = 0.95
    """Ratio of simulation errors. What is less likely, or less precise, has to forecast better by 5 %. Half,
    twice: no effect."""

    finer: float = 1.4
    """Knots of one grid over those of the grid before. Half, twice: no effect."""

    finest: float = 3.0
    """The same where much is still to come, at most. Half, twice: no effect."""

    convergence: float = 4.0
    """Power of the knot spacing with which errors fall (measured: `docs/method.md`). Half: three notes
    are others; twice: two."""

    approach: float = 3.0
    """The same of what is still to come, at least: weights follow. Half, twice: one note is another."""

    most_moved: float = 0.1
    """Standard errors by which still finer knots may move a coefficient. Half, twice: no effect."""

    most_shrunk: float = 0.03
    """Share by which still finer knots may lower a standard error. Half, twice: no effect."""

    grown: float = 1.1
    """Ratio of equation errors from one grid to the next, above which finer knots follow vibrations. Half,
    twice: no effect."""

    biased: float = 0.2
    """Standard errors by which a grid may move the estimates of a fit without equation error. Half, twice: no
    effect."""

    narrowed: float = 0.2
    """Share of a standard error that finer knots must remove before estimates that stand still tell of
    rounding. Half, twice: no effect."""

    still: float = 0.05
    """Move of a coefficient, relative to the one that its lower standard error makes likely, that counts as
    none. Half: no effect; twice: two of 130 recordings with little noise keep coarser knots."""

    most_knots: float = 3.0
    """Knots a sample, at most. Half, twice: no effect."""


SELECTION = SelectionSettings()
