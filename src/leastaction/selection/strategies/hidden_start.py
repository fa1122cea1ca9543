"""Start values where some coordinates have no samples: shooting, then the joint fit.

Cost: some thousand short motions for each set of coefficients that is tried, 5 to 20 s.
Without it there is no curve to begin with.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from leastaction.curve.knots import lay_knots
from leastaction.curve.smoothing import Smooth
from leastaction.data.trajectories import Trajectories
from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.problem import Structure
from leastaction.estimation.protocols import Measurements
from leastaction.estimation.weights import Start, evidence, update_weights
from leastaction.findings import find
from leastaction.hidden.gauge import simpler_forms
from leastaction.hidden.start import HiddenStart, find_start, follow_again
from leastaction.selection.likelihood_refinement import refine, value
from leastaction.selection.search_state import Search, equations_hold

__all__ = ["in_simplest_form", "joined", "run"]

_ATTEMPTS = 2  # most searches for a law
_MOTIONS = 3  # most searches for the motion with the law of a fit
_SMOOTH = 0.05  # largest jump of a motion that is on the right branches, in scales of the hidden state
_VISIBLE = 2.0  # degrees of freedom of the equation error, below which none is visible
_LIKELIER = 1.0  # gain in log evidence that makes one more search worth while
_FORMS = 3  # forms of a law that are fitted, at most
_SAME = 1.0  # log likelihood by which two fits of one law in two forms may differ
_HELD = 2  # number of the step in which coefficients are released early
_FACTOR = 10.0  # by which the weights change in a step
_MOST_STEPS = 12  # limit on steps
_WORSE = 3  # successive steps of lower evidence that end a loop
_FINER = 3.0  # largest factor by which knots exceed those for the measured motion


class _Fitted(NamedTuple):
    """A fit with what it began with: the curve through samples and motion, and the jump of the motion."""

    fit: Fit
    curve: Smooth
    jump: float


def run(search: Search) -> Search:
    """The best structure on the first grid, from that of all candidates at a start that is searched for.

    If the fit does not converge, its equations do not hold, or its motion jumped, some trials may be on a
    wrong branch of the hidden coordinate. The motion is then searched for again, with the law of the fit. If
    the equations still do not hold, the law is, too, from other draws, and has to follow the measured motion
    for longer. The likeliest fit stays.
    """
    problem, period = search.problem, search.scales.period
    structure = Structure(problem.free)
    best, confirmed = None, False
    for attempt in range(_ATTEMPTS):
        seed, strict = search.seed + attempt, attempt > 0
        found = find_start(problem, structure, search.curve, period, seed, strict=strict)
        confirmed = confirmed or found.confirmed
        best = _followed(search, structure, _likelier(best, _fitted(search, structure, found, best)))
        if _holds(best.fit):
            break
    assert best is not None
    fit, curve = refine(best.fit, search.report), best.curve
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


def _followed(search: Search, structure: Structure, best: _Fitted) -> _Fitted:
    """The likeliest fit, from motions of the law of the fit before, as long as that makes it likelier.

    A fit whose equations hold is followed, too, if its motion jumped and some equation error is visible: its
    curve may still change branches at an instant.
    """
    problem, period = search.problem, search.scales.period
    for _ in range(_MOTIONS):
        sure = best.jump <= _SMOOTH or bool(np.all(best.fit.weights.slack < _VISIBLE))
        if sure and _holds(best.fit):
            break
        again = follow_again(problem, structure, search.curve, period, best.fit.coefficients)
        before, best = best, _likelier(best, _fitted(search, structure, again, best))
        if not best.fit.evidence > before.fit.evidence + _LIKELIER:
            break
    return best


def _holds(fit: Fit) -> bool:
    """Whether a fit converged and its equations hold, not because their coefficients are about to vanish."""
    return fit.converged and bool(np.isfinite(fit.evidence)) and equations_hold(fit)


def _likelier(one: _Fitted | None, other: _Fitted) -> _Fitted:
    """The fit of higher evidence; both are on one grid."""
    if one is None or not one.fit.usable:
        return other
    return other if other.fit.usable and other.fit.evidence > one.fit.evidence else one


def _fitted(search: Search, structure: Structure, found: HiddenStart, before: _Fitted | None) -> _Fitted:
    """The joint fit from a start, on the grid of the one before: evidence compares on one grid only."""
    problem = search.problem
    completed = found.in_place(problem)
    if before is not None:
        grid = before.fit.grid
    else:  # a hidden coordinate may be faster than what is measured
        wanted, least = lay_knots(completed, problem.degree).per_second, search.scales.per_second
        grid = Grid.lay(search.searched, min(max(wanted, least), _FINER * least))
    curve = _smoothed(grid, completed)
    start = grid.start(structure, curve.control_points, found.coefficients, curve.noise_std)
    best: _Fitted | None = None
    for begun in joined(grid, structure, start):
        best = _likelier(best, _Fitted(grid.fit(structure, begun), curve, found.jump))
        if _holds(best.fit):
            break
    assert best is not None  # there is at least one start
    return best


@np.errstate(over="ignore", invalid="ignore")  # a motion of a wrong law may be huge
def _smoothed(grid: Grid, completed: Trajectories) -> Smooth:
    """The smooth curve through samples and motion; the latter has no noise that could be known."""
    curve = grid.posed(grid.problem.on(completed)).smooth()
    unseen = np.isin(np.arange(curve.noise_std.size), grid.problem.hidden)
    return replace(curve, noise_std=np.where(unseen, 1.0, curve.noise_std))


def joined(grid: Grid, structure: Structure, start: Start) -> Iterator[Start]:
    """Join the motions of single windows to one that obeys the law, by raising the weight of the equations.

    The motion in windows has jumps. With weights estimated from it, the equations look inexact, and
    coefficients fitted with these weights diverge. Coefficients are therefore held while the weights rise.
    For the first start they are released early, and the weights go on rising: this corrects a law that is far
    off. For the second they are released where the curve follows no further, and the weights fall again: by
    then most jumps are gone.

    Parameters
    ----------
    grid : Grid
    structure : Structure
    start : Start
        Coefficients of a law, and the curve through samples and motion.
    """
    physics, index = grid.physics(structure)
    held = Physics(physics.columns, np.zeros_like(physics.free), physics.forces)
    values = grid.problem.completed(start.coefficients)[index]
    rising = _rising(grid.observations, held, start, values)
    for step, factor in ((_HELD, _FACTOR), (len(rising) - 1, 1.0 / _FACTOR)):
        if 0 <= step < len(rising):
            best = _released(grid.observations, (held, physics), rising[step], values, factor)
            coefficients = start.coefficients.copy()
            coefficients[index] = best.coefficients
            yield Start(best.control_points, coefficients, best.weights)
    if not rising:
        yield start


def _rising(observations: Measurements, held: Physics, start: Start, values: np.ndarray) -> list[JointFit]:
    """Fits of the curve to a law whose weight rises from one to the next, as far as it follows."""
    fits: list[JointFit] = []
    followed, highest, worse = 0, -np.inf, 0
    points, weights = start.control_points, start.weights
    for _ in range(_MOST_STEPS):
        found = fit_joint(observations, held, weights, points, values, tolerance=1.0)
        if not found.usable:
            break
        fits.append(found)
        followed = len(fits) if found.converged or not followed else followed
        value = evidence(observations, found)
        highest, worse = (value, 0) if value > highest else (highest, worse + 1)
        if worse == _WORSE:
            break
        points, weights = found.control_points, replace(weights, physics=_FACTOR * weights.physics)
    return fits[:followed]


def _released(
    observations: Measurements,
    laws: tuple[Physics, Physics],
    begun: JointFit,
    values: np.ndarray,
    factor: float,
) -> JointFit:
    """The fit of the highest evidence with free coefficients, while the weight of the equations changes.

    ``laws`` are the equations with held and with free coefficients, ``begun`` is a fit with held ones.
    """
    held, physics = laws
    found, weights = begun, begun.weights
    best, highest, worse = begun, -np.inf, 0
    for _ in range(_MOST_STEPS):
        own = _with_slack(observations, found)
        free = fit_joint(observations, physics, own, found.control_points, values, tolerance=1.0)
        found = free if free.usable else found
        value, worse = evidence(observations, found), worse + 1
        if value > highest:
            best, highest, worse = found, value, 0
        if worse == _WORSE:
            break
        values, weights = found.coefficients, replace(weights, physics=factor * weights.physics)
        found = fit_joint(observations, held, weights, found.control_points, values, tolerance=1.0)
        if not found.usable:
            break
    return best


def _with_slack(observations: Measurements, found: JointFit) -> Weights:
    """The weights of a fit, with the degrees of freedom that it leaves to the equation error."""
    try:
        return replace(found.weights, slack=update_weights(observations, found).slack)
    except np.linalg.LinAlgError:
        return found.weights
