"""Blocks of successive trials: how a motion is cut, and what the observations of a part are made from.

A recipe is what travels, to another thread or another machine; who computes has no say in where the cuts are,
so that sums are added in the same sequence and results do not depend on the number of workers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.data.trajectories import Rate
from leastaction.estimation.observations import Observations

__all__ = ["Recipe", "Samples", "cut"]

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
