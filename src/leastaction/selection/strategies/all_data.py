"""Fit and select again on all data, from a structure that was found on a part of them.

That part is made of pieces of long recordings, or of the recordings in which no sensor is missing. In the
others the law that was found gives the motion of the coordinate without a sensor.

The knots stay: with a factor of 1.4 between grids and errors that fall with a high power of the spacing,
what still moves by a tenth of a standard error leaves a bias of some hundredths.

Cost: some joint fits on all data. Skipped where the search saw all of them.
Without it terms are lost that only the whole recording shows; none on two recordings whose pieces show all
(`docs/ablations.md`).
"""

from __future__ import annotations

from dataclasses import replace

from leastaction.estimation.grid import Grid
from leastaction.estimation.weights import Start
from leastaction.hidden.start import completed
from leastaction.selection.search_state import Search
from leastaction.selection.strategies import feeding_friction, irrelevant_terms

__all__ = ["run"]

_ROUNDS = 4  # at most, each with fits


def run(search: Search) -> Search:
    """Fit the structure on all data, and select its terms again."""
    found = search.found
    if search.searched.trajectories is search.problem.trajectories or not found.converged:
        return search
    search.report("confirm", {})
    grid = Grid.lay(search.problem, found.grid.knots_per_second)
    fit = grid.fit(found.structure, _start(search, grid))
    on_all = irrelevant_terms.refined(replace(search, feeding=()).now(fit), _ROUNDS)
    return feeding_friction.run(irrelevant_terms.run(on_all))


def _start(search: Search, grid: Grid) -> Start:
    """The law on the curve through all samples, which are smoothed as strongly as the pieces were."""
    found = search.found
    data = completed(grid.problem, found.structure, search.scales.period, found.coefficients)
    points = grid.posed(grid.problem.on(data)).smooth(search.scales.smooth.penalty).control_points
    longer = grid.spline.n_ctrl / len(found.control_points)
    # w is that of the pieces: equations whose error hardly shows there may show it in all data
    weights = replace(found.weights, slack=longer * found.weights.slack)
    return grid.fit_curve(found.structure, Start(points, found.coefficients, weights))[0]
