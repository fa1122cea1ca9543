"""Coefficients by simulation error, where the structure is that of a coarse grid.

Where equations hold only to some per cent, what they leave is not white, and the coefficients that explain
slow motion best are those whose simulations stay with it (:mod:`leastaction.estimation.simulation_error`).

Cost: some least-squares steps on a few hundred short simulations, and two forecasts.
Without it nothing fails on nine simulated machines (`docs/ablations.md`); the measured driven double pendulum
is forecast within 0.067 instead of 0.061 rad.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.simulation_error import SimulationFit
from leastaction.findings import find
from leastaction.selection.forecast_error import forecast_error
from leastaction.selection.free_run_terms import FreeRunTerms, terms_of_free_runs
from leastaction.selection.search_state import Search, equations_hold
from leastaction.selection.settings import SELECTION
from leastaction.selection.significance import chi_square_cutoff
from leastaction.selection.strategies.coarse_restart import horizon

__all__ = ["run"]


def run(search: Search) -> Search:
    """The fit with terms and coefficients by simulation error, if they contradict its own and forecast no
    worse.
    """
    fit, scales = search.found, search.scales
    if not fit.converged or equations_hold(fit):
        return search
    where = Grid.lay(search.searched, scales.per_second)
    horizons = SELECTION.simulated * scales.period, SELECTION.horizon * scales.period
    chosen = terms_of_free_runs(fit, where, scales.smooth, horizons, search.relevance)
    if chosen is None:
        return search
    refitted = _refitted(fit, chosen)
    if refitted is None:
        return search
    moved = _differ(chosen.found, refitted.estimates)
    better = refitted.grid.held(refitted, chosen.coefficients, chosen.found.covariance) if moved else refitted
    if better is fit:
        return search
    before, after = (forecast_error(f, horizon(scales.coarse)) for f in (fit, better))
    search.report("coarse", {"forecast_error": after, "before": before})
    if after > before / SELECTION.clearly or better.regular() < fit.regular():
        return search
    note = (find("coefficients-of-free-runs", horizon=horizons[0]),) if moved else ()
    return replace(search.now(better), findings=(*search.findings, *note))


def _refitted(fit: Fit, chosen: FreeRunTerms) -> Fit | None:
    """The terms of free runs fitted to curve and equations; None where that fails."""
    if chosen.structure == fit.structure:
        return fit
    again = fit.grid.fit(chosen.structure, replace(fit.start, coefficients=chosen.coefficients))
    return again if again.converged else None


def _differ(found: SimulationFit, before: np.ndarray) -> bool:
    """Whether simulations contradict the fit beyond chance (Hausman 1978, Econometrica 46:1251).

    If not, both are estimates of the same, and the fit is the better one.
    """
    spread = np.sqrt(np.clip(np.diag(found.covariance), 1e-300, None))
    moved = (found.estimates - before) / spread
    correlation = found.covariance / np.outer(spread, spread)
    square = float(moved @ np.linalg.pinv(correlation, hermitian=True) @ moved)
    return square > chi_square_cutoff(before.size)
