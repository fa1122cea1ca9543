"""Observations cut into blocks of successive trials.

A `Recipe` says how the observations of a block are made, and is what travels to another process or machine.
Cuts do not depend on who computes: sums are added in the same sequence whatever the number of workers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.data.trajectories import Rate
from leastaction.estimation.crew import Crew
from leastaction.estimation.observations import Observations

__all__ = ["InBlocks", "Recipe", "cut", "observed"]

_NUMBERS = 2**17
"""Evaluated at once in the Jacobian of a block, 1 MB: 2730 knot intervals with two coordinates. A step costs
3 % more than in one piece, with blocks of half the size 9 % more; larger ones can be shared out less."""

Samples = tuple[Sequence[np.ndarray], Sequence[np.ndarray], Sequence[Rate]]
"""Times and coordinates of each trial, and rates."""


@dataclass(frozen=True, eq=False)
class Recipe:
    """What the observations of some successive trials are made from.

    No tuple, although it could be one: Dask would look for tasks in every array of it.

    Attributes
    ----------
    spaces : tuple of SplineSpace
        Of the trials.
    n_quadrature, total : int
        Of the whole grid: quadrature points a knot interval, and knot intervals.
    points, intervals : slice
        Control points and knot intervals of the part within the whole.
    samples : Samples
    floors : (n_channels,) array
        Of the whole; see `Observations`.
    """

    spaces: tuple[SplineSpace, ...]
    n_quadrature: int
    total: int
    points: slice
    intervals: slice
    samples: Samples
    floors: np.ndarray

    def observe(self) -> Observations:
        """The observations."""
        grid = SplineGrid(self.spaces, self.n_quadrature, before=self.intervals.start, total=self.total)
        return Observations(grid, *self.samples, self.floors)


def observed(recipe: Recipe) -> Observations:
    """The observations of a recipe, for another process or machine."""
    return recipe.observe()


class InBlocks:
    """What observations in blocks have in common; see `Observations`.

    Attributes
    ----------
    points, intervals : tuple of slice
        Control points and knot intervals of each block.
    """

    def __init__(self, grid: SplineGrid, recipes: Sequence[Recipe], counts: np.ndarray, crew: Crew) -> None:
        values, rates = recipes[0].samples[1:]
        self.grid, self.crew, self.counts, self.n_dof = grid, crew, counts, values[0].shape[1]
        self.floors = recipes[0].floors
        self.noise_floor = self.floors[: self.n_dof]
        self.coordinates = np.array([*range(self.n_dof), *(rate.coordinate for rate in rates)])
        self.points = tuple(recipe.points for recipe in recipes)
        self.intervals = tuple(recipe.intervals for recipe in recipes)


def cut(grid: SplineGrid, samples: Samples, floors: np.ndarray) -> tuple[Recipe, ...]:
    """Blocks that are as large as they may be, or one trial: its control points couple all along."""
    times, values, rates = samples
    ends = np.concatenate([[0], np.cumsum([space.n_intervals for space in grid.spaces])]).tolist()
    most = _NUMBERS // (grid.n_quadrature * values[0].shape[1] ** 2 * (grid.degree + 1))
    starts = [0]
    for k in range(1, len(grid.spaces)):
        if ends[k + 1] - ends[starts[-1]] > most:
            starts.append(k)
    return tuple(
        Recipe(
            grid.spaces[a:b],
            grid.n_quadrature,
            grid.n_intervals,
            slice(int(grid.offsets[a]), int(grid.offsets[b])),
            slice(ends[a], ends[b]),
            (times[a:b], values[a:b], [replace(rate, values=rate.values[a:b]) for rate in rates]),
            floors,
        )
        for a, b in zip(starts, [*starts[1:], len(grid.spaces)], strict=True)
    )
