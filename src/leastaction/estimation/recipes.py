"""Observations cut into blocks of successive trials.

A `Recipe` holds the inputs of the observations of a block and is sent to another process or machine. Cuts do
not depend on the workers, so that sums are added in the same sequence whatever their number.
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
"""Numbers in the Jacobian of a block, 1 MB: 2730 knot intervals with two coordinates. A step costs 3 % more
than in one piece, with blocks of half the size 9 % more. Larger blocks distribute less evenly."""

Samples = tuple[Sequence[np.ndarray], Sequence[np.ndarray], Sequence[Rate]]
"""Times and coordinates of each trial, and rates."""


@dataclass(frozen=True, eq=False)
class Recipe:
    """Inputs of the observations of some successive trials.

    Not a tuple, because Dask would search every array of it for tasks.

    Attributes
    ----------
    spaces : tuple of SplineSpace
        Spline spaces of the trials.
    n_quadrature, total : int
        Quadrature points in a knot interval, and knot intervals of the whole grid.
    points, intervals : slice
        Control points and knot intervals of the block within the grid.
    samples : Samples
    floors : (n_channels,) array
        Of the whole grid; see `Observations`.
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
    """Common base of observations in blocks; see `Observations`.

    Attributes
    ----------
    points, intervals : tuple of slice
        Control points and knot intervals of each block.
    """

    def __init__(self, grid: SplineGrid, recipes: Sequence[Recipe], counts: np.ndarray, crew: Crew) -> None:
        values, rates = recipes[0].samples[1:]
        self.grid: SplineGrid = grid
        self.crew: Crew = crew
        self.counts: np.ndarray = counts
        self.n_dof: int = values[0].shape[1]
        self.floors: np.ndarray = recipes[0].floors
        self.noise_floor: np.ndarray = self.floors[: self.n_dof]
        self.coordinates: np.ndarray = np.array([*range(self.n_dof), *(rate.coordinate for rate in rates)])
        self.points: tuple[slice, ...] = tuple(recipe.points for recipe in recipes)
        self.intervals: tuple[slice, ...] = tuple(recipe.intervals for recipe in recipes)


def cut(grid: SplineGrid, samples: Samples, floors: np.ndarray) -> tuple[Recipe, ...]:
    """The largest blocks allowed; each has at least one trial, which cannot be cut."""
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
