"""The search for a structure, as a list of strategies.

Each strategy is one file of `leastaction.selection.strategies` with a function ``run(search) -> search``; it
decides itself whether it has anything to do, and says in its docstring what it costs. The order is that of
the lists below, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from leastaction.errors import StopSearch
from leastaction.estimation.fit import Fit
from leastaction.findings import find
from leastaction.selection.search_state import Search
from leastaction.selection.strategies import (
    all_data,
    calibration_start,
    coarse_restart,
    exact_equations,
    feeding_friction,
    finer_knots,
    force_bias,
    force_sampling,
    frequency_scan,
    grown_families,
    hidden_start,
    irrelevant_terms,
    kinetic_restart,
    shape_fit,
    shape_start,
    shortest_form,
    simulation_error,
    terms_again,
    weak_start,
    whole_turns,
)

__all__ = ["ON_ONE_GRID", "WITH_HIDDEN", "find_on_data", "find_structure", "run_search"]

ON_ONE_GRID = (
    shape_start,
    whole_turns,
    weak_start,
    shape_fit,
    finer_knots,
    whole_turns,
    frequency_scan,
    kinetic_restart,
    grown_families,
    terms_again,
    irrelevant_terms,
    feeding_friction,
    shape_fit,
)
"""Strategies that find a structure on a first grid, in order."""


def _settled(search: Search) -> Search:
    """Finer knots once more, where the fit at the start had too many terms to converge."""
    return search if search.knots_settled else finer_knots.run(search)


WITH_HIDDEN = (
    hidden_start.run,
    finer_knots.run,
    terms_again.run,
    irrelevant_terms.run,
    feeding_friction.run,
    hidden_start.in_simplest_form,
    irrelevant_terms.run,
    _settled,
    exact_equations.run,
)
"""Strategies where some coordinates have no samples, in order.

A start with many terms may not show the simplest form, and may not converge; the terms that are left do.
"""


def find_structure(search: Search) -> Search:
    """Run the strategies that find a structure, from the grid of the search."""
    for strategy in ON_ONE_GRID:
        search = _attempt(strategy.run, search)
    return search


def run_search(search: Search) -> Search:
    """Run every strategy."""
    if search.problem.hidden:
        search.report("search", {})
        for strategy in WITH_HIDDEN:
            search = _attempt(strategy, search)
        return search
    search = _attempt(calibration_start.run, search)
    found = force_bias.run(search, find_on_data)
    found = _attempt(partial(force_sampling.run, again=find_on_data), found)
    found = _attempt(simulation_error.run, found)
    return _attempt(shape_start.against_others, found)


def find_on_data(search: Search) -> Search:
    """Find a structure on pieces of long recordings, then on all data."""
    search.report("search", {})
    search = find_structure(search)
    restart = partial(coarse_restart.run, again=find_structure)
    runs: tuple[Callable[[Search], Search], ...] = (
        restart,
        all_data.run,
        shortest_form.run,
        exact_equations.run,
        shape_fit.run,
    )
    for run in runs:
        search = _attempt(run, search)
    return search


def _attempt(run: Callable[[Search], Search], search: Search) -> Search:
    """Run a strategy, or keep the best fit so far if the user has stopped the search."""
    if search.stopped:
        return search
    try:
        return run(search)
    except StopSearch as stop:
        fit = search.fit or stop.fit
        if not isinstance(fit, Fit):
            raise
        return replace(search.now(fit), stopped=True, findings=(*search.findings, find("stopped-early")))
