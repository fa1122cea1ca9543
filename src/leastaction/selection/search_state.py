"""Where a search stands: what every strategy takes and returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leastaction.curve.knots import Knots
from leastaction.curve.smoothing import Smooth
from leastaction.estimation.build import Setup
from leastaction.estimation.fit import Fit
from leastaction.estimation.force_bias import ForceBias, no_bias
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Problem
from leastaction.estimation.settings import ESTIMATION
from leastaction.findings import Finding
from leastaction.selection.progress import Progress, silent
from leastaction.selection.settings import SELECTION

__all__ = ["Search", "begin_search", "equations_exact", "equations_hold", "explains", "restarted"]


@dataclass(frozen=True, eq=False)
class Search:
    """A search for a structure; strategies return it with a better fit.

    Attributes
    ----------
    problem, searched : Problem
        As asked: on all data, and on those of the search (pieces of long recordings, otherwise all).
    scales : Knots
        Time scales of the searched motion.
    grid : Grid
        On which the next fit is made: of pieces of long recordings until all data are taken.
    curve : Smooth
        The smooth curve on that grid, or through the pieces of long recordings.
    bias : ForceBias
        Slow forces that were found beside the known ones.
    fit, first : Fit or None
        The best so far, and the best on the first grid.
    relevance : float
        Share of the equation error's variance that a term has to remove to stay.
    seed : int
    thorough : bool
        Search longer where the equations do not hold.
    knots_settled, vibrates : bool
        Whether finer knots changed nothing any more, or made a large equation error larger.
    feeding : tuple of int
        Candidates of dissipation that were left out because they would have fed energy in.
    others : tuple of Fit
        Laws found from other starts of the shape parameters, on the grid of ``fit`` at the end.
    stopped : bool
        Whether the user ended the search before its last strategy.
    findings : tuple of Finding
        What a strategy did that the user should know.
    report : callable
        See :mod:`leastaction.selection.progress`.
    """

    problem: Problem
    searched: Problem
    scales: Knots
    grid: Grid
    curve: Smooth
    bias: ForceBias
    fit: Fit | None = None
    first: Fit | None = None
    relevance: float = 0.05
    seed: int = 0
    thorough: bool = True
    knots_settled: bool = False
    vibrates: bool = False
    feeding: tuple[int, ...] = ()
    others: tuple[Fit, ...] = ()
    stopped: bool = False
    findings: tuple[Finding, ...] = ()
    report: Progress = silent

    @property
    def found(self) -> Fit:
        """The best fit so far, which there is after the first strategy."""
        assert self.fit is not None
        return self.fit

    def now(self, fit: Fit, **changes: Any) -> Search:
        """The search with another fit, its grid, and its numbers of the shape parameters."""
        new = replace(self, fit=fit, grid=fit.grid, **changes)
        return new.at(fit.problem.shape_values) if fit.problem.ranges else new

    def posed(self, change: Callable[[Problem], Problem]) -> Search:
        """The same search for a problem that is changed, on all of its data."""
        whole, searched, gridded = map(change, (self.problem, self.searched, self.grid.problem))
        return replace(self, problem=whole, searched=searched, grid=self.grid.posed(gridded))

    def at(self, shapes: Mapping[str, float]) -> Search:
        """The search with other numbers for its shape parameters."""
        return self.posed(lambda problem: problem.at(shapes))


def begin_search(
    setup: Setup,
    slow: Mapping[int, float] | None = None,
    *,
    relevance: float = 0.05,
    seed: int = 0,
    thorough: bool = True,
    report: Progress = silent,
) -> Search:
    """A search that has not found anything yet, on the grid that the motion asks for.

    Parameters
    ----------
    setup : Setup
    slow : mapping of int to float, optional
        Coordinates with a slow force of unknown size → seconds within which it may change.
    """
    return Search(
        setup.problem,
        setup.searched,
        setup.scales,
        Grid.lay(setup.searched, setup.scales.per_second),
        setup.scales.smooth,
        no_bias(setup.problem.trajectories, slow or {}),
        relevance=relevance,
        seed=seed,
        thorough=thorough,
        report=report,
    )


def restarted(search: Search, grid: Grid, curve: Smooth | None = None) -> Search:
    """The search before it found anything, for the problem of another grid, with its smooth ``curve``."""
    curve, problem = curve or grid.smooth(), grid.problem
    return replace(search, problem=problem, searched=problem, grid=grid, curve=curve, fit=None, feeding=())


def equations_hold(fit: Fit) -> bool:
    """Whether every equation holds to one per cent of its terms."""
    return bool(np.all(fit.equation_error()[0] <= SELECTION.holds))


def equations_exact(fit: Fit) -> bool:
    """Whether hardly any equation error is visible."""
    return bool(np.all(fit.weights.slack < ESTIMATION.slack_left))


def explains(fit: Fit, value: float) -> bool:
    """Whether the equations hold to one per cent and can be solved; if not, look for a better structure."""
    if not fit.converged or not np.isfinite(value):
        return False
    return equations_hold(fit) and fit.linearisation.regular > SELECTION.solvable
