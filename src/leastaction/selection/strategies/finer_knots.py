"""Finer knots, until they no longer matter.

On a grid coarser than the motion asks for, what the spline cannot follow counts as noise. A fit that is
carried to finer knots may go on counting it as noise although the finer spline follows it: the likelihood has
two maxima, exact equations with much noise, and little noise with an equation error. Both are fitted there,
and the likelier one stays.

Cost: one joint fit for each grid, two or three as a rule; two for each grid that is coarser than the motion
asks for.
Without it (`docs/ablations.md`) coefficients of machines are off by 1.4 instead of 0.13 %, and one of
nine further systems is wrong.
"""

from __future__ import annotations

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.settings import ESTIMATION
from leastaction.selection.search_state import Search, equations_exact
from leastaction.selection.settings import SELECTION

__all__ = ["run"]

_DIGITS = 1e-6  # of an estimate: finer knots are not worth a smaller change
_FASTEST_GROWTH = 10.0  # of a weight from one grid to the next: only where a start begins
_ROUNDING = 1.5e-8  # relative equation error whose square is lost in the normal equations
_MOST_ROUNDS = 6  # grids, at most


def run(search: Search) -> Search:
    """Refine until still finer knots would move coefficients by less than a tenth of a standard error,
    and standard errors by less than 3 %.

    Where the library is not exact, finer splines may follow vibrations that it knows nothing of: refinement
    ends when it makes a large equation error larger.
    """
    fit = search.found
    rate = max(t.size / (t[-1] - t[0]) for t in fit.grid.times)
    growth, factor = np.ones(fit.grid.observations.n_dof), SELECTION.finer
    for done in range(_MOST_ROUNDS):
        before = fit.grid.knots_per_second
        if not fit.converged or before > SELECTION.most_knots * rate:
            return search.now(fit, knots_settled=False, vibrates=False)
        left = fit.equation_error()[0]
        grid = Grid.lay(fit.problem, before * factor)
        search.report("knots", {"knots_per_second": grid.knots_per_second})
        finer = grid.fit(fit.structure, grid.carried(fit, growth))
        if before < search.scales.per_second:
            finer = _likelier(finer, _from_samples(grid, fit))
        if not finer.converged or not np.isfinite(finer.evidence):
            return search.now(fit, knots_settled=False, vibrates=False)
        off = finer.equation_error()[0]
        if np.any((off > SELECTION.holds) & (off > SELECTION.grown * left)):
            return search.now(fit, knots_settled=True, vibrates=True)
        if done and np.any(off > SELECTION.holds):  # not caused by too few knots
            return search.now(finer, knots_settled=False, vibrates=False)
        if (np.any(off < _ROUNDING) and _stands_still(fit, finer)) or _has_all_information(fit, finer):
            return search.now(fit, knots_settled=True, vibrates=False)
        # finer splines leave a smaller equation error, by nearly the same factor in every round, until
        # hardly any of it is left and its weight no longer matters
        growth = np.clip(finer.weights.physics / fit.weights.physics, 1.0, _FASTEST_GROWTH)
        growth[finer.weights.slack < ESTIMATION.slack_left] = 1.0
        ahead = _change_ahead(fit, finer, 1.0 / (factor**SELECTION.convergence - 1.0))
        fit = finer
        if ahead < 1.0:
            return search.now(fit, knots_settled=True, vibrates=False)
        # as many as should do, where the equations hold
        needed = (
            min(ahead ** (1.0 / SELECTION.approach), SELECTION.finest)
            if np.all(off <= SELECTION.holds)
            else 1.0
        )
        factor = max(needed, SELECTION.finer)
    return search.now(fit, knots_settled=False, vibrates=False)


def _from_samples(grid: Grid, coarser: Fit) -> Fit:
    """The structure of a coarser fit, begun from the smoothed samples and their noise on this grid."""
    curve = grid.smooth()
    start = grid.start(coarser.structure, curve.control_points, coarser.coefficients, curve.noise_std)
    return grid.fit(coarser.structure, start)


def _likelier(carried: Fit, other: Fit) -> Fit:
    """The fit of higher evidence on one grid; the first where they are the same."""
    if not other.converged or not np.isfinite(other.evidence):
        return carried
    return (
        other
        if not carried.converged or other.evidence > carried.evidence + ESTIMATION.as_likely
        else carried
    )


def _stands_still(coarser: Fit, finer: Fit) -> bool:
    """Whether the intervals narrow although the estimates stay where they were.

    Of two efficient estimates the difference has the variance by which that of the first exceeds that of the
    second (Hausman 1978).  Estimates that move much less say that rounding has narrowed the intervals, not
    information.
    """
    before, now = (np.maximum(fit.standard_errors, _least(finer)) for fit in (coarser, finer))
    narrowed = np.sqrt(np.maximum(before**2 - now**2, 0.0))
    much = now < (1.0 - SELECTION.narrowed) * before
    moved = np.abs(finer.estimates - coarser.estimates)
    return bool(much.any() and np.all(moved <= SELECTION.still * narrowed))


def _has_all_information(coarser: Fit, finer: Fit) -> bool:
    """Whether a fit with a hidden coordinate has all information, although finer knots narrow intervals.

    Where hardly any equation error is left, finer knots cannot lower it further.  The curve of a hidden
    coordinate has no samples, so that rounding of the normal equations, which grows with weights and knots,
    looks like information on it.
    """
    exact = equations_exact(coarser) and equations_exact(finer)
    moved = np.abs(finer.estimates - coarser.estimates)
    still = moved <= SELECTION.biased * np.maximum(coarser.standard_errors, _least(finer))
    return bool(coarser.problem.hidden and exact and np.all(still))


def _least(fit: Fit) -> np.ndarray:
    """Standard errors below which nobody needs more digits: without noise they are tiny."""
    return np.maximum(_DIGITS * np.abs(fit.estimates), 1e-150)


def _change_ahead(coarser: Fit, finer: Fit, share: float) -> float:
    """By how much still finer knots will change a fit, relative to what is allowed.

    Where errors fall with a power of the spacing, that is a fixed share of what the last round changed.
    """
    least = _least(finer)
    before, now = (np.maximum(fit.standard_errors, least) for fit in (coarser, finer))
    move = share * np.abs(finer.estimates - coarser.estimates) / now
    shrink = np.minimum(share * (before - now), now - least) / now
    return float(max((move / SELECTION.most_moved).max(), (shrink / SELECTION.most_shrunk).max()))
