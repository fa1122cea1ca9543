"""Start values where some coordinates have no samples: shooting, then the joint fit.

Cost: some thousand short motions for each set of coefficients that is tried, 5 to 20 s.
Without it there is no curve to begin with.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leastaction.curve.knots import lay_knots
from leastaction.curve.smoothing import Smooth
from leastaction.data.trajectories import Trajectories
from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.protocols import Measurements
from leastaction.estimation.structure import Structure
from leastaction.estimation.weights import Start, evidence, update_weights
from leastaction.findings import find
from leastaction.hidden.gauge import simpler_forms
from leastaction.hidden.start import HiddenStart, find_start, follow_again
from leastaction.selection.likelihood_refinement import refine, value
from leastaction.selection.search_state import Search, equations_hold

__all__ = ["in_simplest_form", "run"]

_Fitted = tuple[Fit, Smooth]  # a fit, and the smooth curve through samples and motion that it began with

_ATTEMPTS = 2  # most searches for a law
_FORMS = 3  # forms of a law that are fitted, at most
_SAME = 1.0  # log likelihood by which two fits of one law in two forms may differ
_FACTOR = 10.0  # by which the weights rise in a step
_HELD = 2  # first steps, in which coefficients are held
_MOST_STEPS = 12  # limit on steps
_WORSE = 3  # successive steps of lower evidence that end the loop
_FINER = 3.0  # largest factor by which knots exceed those for the measured motion


def run(search: Search) -> Search:
    """The best structure on the first grid, from that of all candidates at a start that is searched for.

    If its equations do not hold, some trials may be on a wrong branch of the hidden coordinate. The motion is
    then searched for once more, with the law that was found; after that the law, too, from other draws. The
    likeliest fit stays.
    """
    problem, period = search.problem, search.scales.period
    structure = Structure(problem.free)
    best, confirmed = None, False
    for attempt in range(_ATTEMPTS):
        found = find_start(problem, structure, search.curve, period, search.seed + attempt)
        confirmed = confirmed or found.confirmed
        best = _likelier(best, _fitted(search, structure, found, best))
        if not _holds(best[0]):
            again = follow_again(problem, structure, search.curve, period, best[0].coefficients)
            best = _likelier(best, _fitted(search, structure, again, best))
        if _holds(best[0]):
            break
    assert best is not None
    fit, curve = refine(best[0], search.report), best[1]
    scales = search.scales._replace(smooth=curve, per_second=fit.grid.knots_per_second)
    names = [problem.coordinates[i] for i in problem.hidden]
    findings = search.findings if confirmed else (*search.findings, find("hidden-start-unconfirmed", names))
    return in_simplest_form(
        replace(search, scales=scales, curve=curve, findings=findings).now(fit, first=fit)
    )


def in_simplest_form(search: Search) -> Search:
    """The law in the choice of hidden coordinates that gives the simplest form, if it is as probable."""
    fit = search.found
    for i in fit.problem.hidden:
        forms = simpler_forms(fit, i)[:_FORMS] if fit.converged else []
        for form in forms:
            points = form.change.after(fit.control_points)
            other = fit.grid.fit(Structure(form.members), Start(points, form.coefficients, fit.weights))
            allowed = _SAME if len(form.members) == len(fit.structure) else 0.0
            if other.converged and value(other) > value(fit) - allowed:
                fit = refine(other, search.report)
                break
    return search.now(fit)


def _holds(fit: Fit) -> bool:
    """Whether the equations hold, and not because their coefficients are about to vanish."""
    return bool(np.isfinite(fit.evidence)) and equations_hold(fit)


def _likelier(one: _Fitted | None, other: _Fitted) -> _Fitted:
    """The fit of higher evidence; both are on one grid."""
    if one is None or not one[0].usable:
        return other
    return other if other[0].usable and other[0].evidence > one[0].evidence else one


def _fitted(search: Search, structure: Structure, found: HiddenStart, before: _Fitted | None) -> _Fitted:
    """The joint fit from a start, on the grid of the one before: evidence compares on one grid only."""
    problem = search.problem
    completed = found.in_place(problem)
    if before is not None:
        grid = before[0].grid
    else:  # a hidden coordinate may be faster than what is measured
        wanted, least = lay_knots(completed, problem.degree).per_second, search.scales.per_second
        grid = Grid.lay(search.searched, min(max(wanted, least), _FINER * least))
    curve = _smoothed(grid, completed)
    start = grid.start(structure, curve.control_points, found.coefficients, curve.noise_std)
    return grid.fit(structure, _drawn_together(grid, structure, start)), curve


@np.errstate(over="ignore", invalid="ignore")  # a motion of a wrong law may be huge
def _smoothed(grid: Grid, completed: Trajectories) -> Smooth:
    """The smooth curve through samples and motion; the latter has no noise that could be known."""
    curve = grid.posed(grid.problem.on(completed)).smooth()
    unseen = np.isin(np.arange(curve.noise_std.size), grid.problem.hidden)
    return replace(curve, noise_std=np.where(unseen, 1.0, curve.noise_std))


def _drawn_together(grid: Grid, structure: Structure, start: Start) -> Start:
    """Join the motions of single windows to one that obeys the law, by raising the weight of the equations.

    The motion in windows has jumps. With weights estimated from it, the equations look inexact, and
    coefficients fitted with these weights diverge. The coefficients are therefore held in the first steps.
    The weights rise tenfold from step to step, and the curve follows. The step of the highest evidence is
    returned.
    """
    observations, (physics, index) = grid.observations, grid.physics(structure)
    held = Physics(physics.columns, np.zeros_like(physics.free), physics.forces)
    values = grid.problem.completed(start.coefficients)[index]
    best, highest, worse = start, -np.inf, 0
    weights, points = start.weights, start.control_points
    for step in range(_MOST_STEPS):
        found = fit_joint(observations, held, weights, points, values, tolerance=1.0)
        if not found.usable:
            break
        if step >= _HELD:
            own = _with_slack(observations, found)
            free = fit_joint(observations, physics, own, found.control_points, values, tolerance=1.0)
            found = free if free.usable else found
        points, values, value = found.control_points, found.coefficients, evidence(observations, found)
        worse += 1
        if value > highest:
            coefficients = start.coefficients.copy()
            coefficients[index] = values
            best, highest, worse = Start(points, coefficients, found.weights), value, 0
        if worse == _WORSE:
            break
        weights = replace(weights, physics=_FACTOR * weights.physics)
    return best


def _with_slack(observations: Measurements, found: JointFit) -> Weights:
    """The weights of a fit, with the degrees of freedom that it leaves to the equation error."""
    try:
        return replace(found.weights, slack=update_weights(observations, found).slack)
    except np.linalg.LinAlgError:
        return found.weights
