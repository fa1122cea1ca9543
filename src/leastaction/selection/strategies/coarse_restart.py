"""A second search on a coarse grid, for hardware with motion that the library cannot express.

Belts and joints vibrate, clocks jitter, motors ripple.  A fine spline follows all of it, and the equations
then fight accelerations of the wrong origin.  Where the first search leaves a large equation error, another
one begins on the coarsest grid that shows the motion; simulation errors along the data judge which of them is
right.

Cost: that of the first search, on fewer knots, and two rounds of simulation.
Without it (`docs/ablations.md`) one of nine machines and one of nine further systems are wrong, and the
coefficients of the other machines are off by 0.38 instead of 0.14 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from leastaction.curve.settings import CURVE
from leastaction.errors import StopSearch
from leastaction.estimation.grid import Grid
from leastaction.selection.forecast_error import forecast_error
from leastaction.selection.search_state import Search, equations_hold
from leastaction.selection.settings import SELECTION

__all__ = ["horizon", "run"]


def run(search: Search, again: Callable[[Search], Search]) -> Search:
    """Search again from the coarsest grid if an equation is off by more than one per cent.

    Parameters
    ----------
    search : Search
    again : callable
        The strategies that find a structure on one grid.

    Returns
    -------
    Search
        That of the better forecasts.
    """
    fine, knots = search.found, search.scales.coarse
    if not search.thorough or equations_hold(fine) or not knots < fine.grid.knots_per_second:
        return search
    grid = Grid.lay(search.searched, knots)
    other = again(replace(search, grid=grid, curve=grid.smooth(), fit=None, feeding=(), thorough=False))
    coarse = other.found
    if other.stopped:
        raise StopSearch
    if not coarse.converged:
        return search
    first, second = (forecast_error(fit, horizon(knots)) for fit in (fine, coarse))
    search.report("coarse", {"forecast_error": second, "before": first})
    # if its equations hold, the first search failed for another reason than vibration
    better = second < (first if equations_hold(coarse) else SELECTION.clearly * first)
    return replace(other, curve=search.curve, thorough=search.thorough) if better else search


def horizon(knots_per_second: float) -> float:
    """Length in seconds of the simulations that decide."""
    return SELECTION.horizon * 2.0 * np.pi * CURVE.knots_per_radian / knots_per_second
