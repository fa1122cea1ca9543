"""A second search on a coarse grid, for hardware that moves in ways the library knows nothing of.

Belts and joints vibrate, clocks jitter, motors ripple.  A fine spline follows all of it, and the equations
then fight accelerations of the wrong origin.  Where the first search leaves a large equation error, another
one begins on the coarsest grid that shows the motion; free runs along the data judge which of them is right.
If it is the coarse one, its coefficients are improved by free runs in the end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import sympy as sp
from scipy.special import chdtrc

from leastaction.curve.knots import KNOTS_PER_RADIAN, excerpt
from leastaction.curve.smoothing import smooth
from leastaction.errors import InputError
from leastaction.estimation.simulation_error import FreeRuns, minimise_free_runs
from leastaction.estimation.workspace import StructureFit, Workspace
from leastaction.findings import Finding, find
from leastaction.mechanics.equations import Mechanics
from leastaction.selection.knots import Progress, equations_hold
from leastaction.selection.prepare import Prepared
from leastaction.selection.select import Selection, select_structure
from leastaction.simulation.forecast import forecast

__all__ = ["forecast_error", "improve_coarse", "search_coarse"]

_HORIZON = 0.5  # of free runs that judge, in periods of the motion
_QUARTER = 0.25  # of a period: free runs that are minimised; where errors grow, long ones are biased
_CHANCE = 1e-3  # free runs have to contradict the fit at this level to be believed
_WINDOW = 0.1
_WINDOW_STEPS = 8
_JUDGED = 12_000  # samples that the free runs run along
_CLEARLY = 0.95  # the coarse grid has to be better by 5 %


def search_coarse(
    fine: Workspace,
    found: Selection,
    knots_per_second: float,
    progress: Progress,
    relevance: float,
    seed: int,
) -> tuple[Workspace, Selection]:
    """Search again from ``knots_per_second`` if an equation is off by more than one per cent.

    Returns
    -------
    Workspace, Selection
        Those of the better forecasts.
    """
    if equations_hold(fine, found.structure) or not knots_per_second < fine.knots_per_second:
        return fine, found
    coarse = Workspace(fine.trajectories, fine.columns, fine.known, knots_per_second, fine.degree)
    curve = smooth(coarse.grid, coarse.times, coarse.values, rates=coarse.rates)
    other = select_structure(coarse, curve, progress, relevance, seed, thorough=False)
    if not other.structure.fit.converged:
        return fine, found
    horizon = _horizon(knots_per_second)
    first, second = (forecast_error(w, s.structure, horizon) for w, s in ((fine, found), (coarse, other)))
    progress("coarse", {"forecast_error": second, "before": first})
    # where its equations hold the first search went astray, and no machine need vibrate
    better = second < (first if equations_hold(coarse, other.structure) else _CLEARLY * first)
    return (coarse, other) if better else (fine, found)


def _horizon(knots_per_second: float) -> float:
    return _HORIZON * 2.0 * np.pi * KNOTS_PER_RADIAN / knots_per_second


def improve_coarse(
    prepared: Prepared, workspace: Workspace, structure: StructureFit, progress: Progress
) -> tuple[StructureFit, tuple[Finding, ...]]:
    """Coefficients by free runs, if the structure is that of a coarse grid and they contradict its fit.

    Returns
    -------
    StructureFit
        Curve and weights unchanged.
    tuple of Finding
        What is worth knowing about it.
    """
    if not structure.fit.converged or workspace.knots_per_second >= prepared.knots.per_second:
        return structure, ()
    knots, where = prepared.knots, prepared.workspace(workspace.columns)
    short = _QUARTER * knots.period
    found = minimise_free_runs(where, knots.smooth, structure.members, structure.coefficients, short)
    if found is None or not _differ(found, structure.estimates):
        return structure, ()
    coefficients = structure.coefficients.copy()
    coefficients[list(structure.members)] = found.estimates
    fit = replace(structure.fit, covariance=found.covariance)
    better = replace(structure, coefficients=coefficients, fit=fit)
    horizon = _horizon(knots.coarse)
    before, after = (forecast_error(workspace, s, horizon) for s in (structure, better))
    progress("coarse", {"forecast_error": after, "before": before})
    regular = [workspace.regular(s.coefficients, fit.control_points) for s in (structure, better)]
    if after > before / _CLEARLY or regular[1] < regular[0]:
        return structure, ()
    return better, (find("coefficients-of-free-runs", horizon=short),)


def _differ(found: FreeRuns, before: np.ndarray) -> bool:
    """Whether free runs contradict the fit beyond chance (Hausman 1978, Econometrica 46:1251).

    If not, both are estimates of the same, and the fit is the better one.
    """
    spread = np.sqrt(np.clip(np.diag(found.covariance), 1e-300, None))
    moved = (found.estimates - before) / spread
    correlation = found.covariance / np.outer(spread, spread)
    square = float(moved @ np.linalg.pinv(correlation, hermitian=True) @ moved)
    return bool(chdtrc(before.size, square) < _CHANCE)


def forecast_error(workspace: Workspace, structure: StructureFit, horizon: float) -> float:
    """Root mean square error of free runs over standard deviation, runs that are lost counted as one."""
    data = excerpt(workspace.trajectories, _JUDGED)
    values = [sp.Float(float(value)) for value in structure.coefficients]
    columns = workspace.columns
    mechanics = Mechanics.of_terms(columns.terms, values, data.coordinates, prescribed=columns.prescribed)
    shortest = min(trajectory.duration for trajectory in data)
    horizon = min(horizon, 0.4 * shortest)
    noise = structure.fit.weights.position_std
    step = data.sampling_interval
    window = max(_WINDOW * horizon, _WINDOW_STEPS * step)
    try:
        result = forecast(mechanics.acceleration, data, noise, horizon, window, prescribed=columns.prescribed)
    except InputError:  # too short for a free run
        return np.inf
    errors = np.array([trace.rms / result.std for trace in result.traces])
    errors = errors[~np.isnan(errors)]
    return float(np.sqrt(np.mean(np.minimum(errors, 1.0) ** 2)))
