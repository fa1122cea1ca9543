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

from leastaction.estimation.grid import Grid
from leastaction.estimation.simulation_error import SimulationFit, minimise_simulation_error
from leastaction.findings import find
from leastaction.selection.forecast_error import forecast_error
from leastaction.selection.search_state import Search
from leastaction.selection.settings import SELECTION
from leastaction.selection.significance import chi_square_cutoff
from leastaction.selection.strategies.coarse_restart import horizon

__all__ = ["run"]


def run(search: Search) -> Search:
    """The fit with coefficients by simulation error, if they contradict its own and forecast no worse."""
    fit, scales = search.found, search.scales
    if not fit.converged or fit.grid.knots_per_second >= scales.per_second:
        return search
    where = Grid.lay(search.searched, scales.per_second)
    short = SELECTION.simulated * scales.period
    found = minimise_simulation_error(where, scales.smooth, fit.structure, fit.coefficients, short)
    if found is None or not _differ(found, fit.estimates):
        return search
    coefficients = fit.coefficients.copy()
    coefficients[list(fit.structure)] = found.estimates
    better = fit.grid.held(fit, coefficients, found.covariance)
    before, after = (forecast_error(f, horizon(scales.coarse)) for f in (fit, better))
    search.report("coarse", {"forecast_error": after, "before": before})
    if after > before / SELECTION.clearly or better.regular() < fit.regular():
        return search
    note = find("coefficients-of-free-runs", horizon=short)
    return replace(search.now(better), findings=(*search.findings, note))


def _differ(found: SimulationFit, before: np.ndarray) -> bool:
    """Whether simulations contradict the fit beyond chance (Hausman 1978, Econometrica 46:1251).

    If not, both are estimates of the same, and the fit is the better one.
    """
    spread = np.sqrt(np.clip(np.diag(found.covariance), 1e-300, None))
    moved = (found.estimates - before) / spread
    correlation = found.covariance / np.outer(spread, spread)
    square = float(moved @ np.linalg.pinv(correlation, hermitian=True) @ moved)
    return square > chi_square_cutoff(before.size)
