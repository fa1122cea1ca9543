"""Kinetic energies to grow a support from: one diagonal term for each coordinate, nowhere negative.

A kinetic energy is positive whatever the velocities, so its mass matrix has a positive diagonal; nearly
every Lagrangian of mechanics therefore holds, for each coordinate, a candidate q̇_i² g(q) with g ≥ 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from heapq import heappop, heappush
from itertools import islice

import numpy as np
import sympy as sp

from leastaction.curve.smoothing import Smooth
from leastaction.estimation.grid import Grid
from leastaction.estimation.intervals import first_points

__all__ = ["Option", "cheapest_combinations", "kinetic_bases"]

Option = tuple[int, tuple[int, ...]]
"""Number of operations of an expression, and the position of its column (none if a known term serves)."""

_MOST_BASES = 60  # each with a beam of its own
_MOST_EACH = 8  # candidates for the mass of one coordinate
_POINTS = 400  # along the motion
_TINY = 1e-9  # relative: rounding


def kinetic_bases(grid: Grid, smooth: Smooth) -> list[tuple[int, ...]]:
    """Positions among the free columns, the simplest expressions first; at least the empty set."""
    problem = grid.problem
    stride = max(1, grid.spline.n_intervals // _POINTS)
    points = first_points(grid.spline, smooth.control_points, slice(None, None, stride))
    n = problem.trajectories.n_dof
    options: list[list[Option]] = [[] for _ in range(n)]
    fixed = problem.completed(np.zeros(len(problem.candidates)))
    given = problem.candidates.mass_matrix(points, fixed)
    for i in range(n):
        if np.all(given[:, i, i] > 0.0):  # a known term already makes it positive
            options[i].append((0, ()))
    velocities = {sp.Symbol(f"{name}_dot", real=True) for name in problem.coordinates}
    for position, k in enumerate(problem.free):
        if velocities.isdisjoint(problem.terms[int(k)].expr.free_symbols):
            continue  # a potential has no mass
        mass = problem.candidates.mass_of(int(k), points)
        size = np.abs(mass).max(axis=0)
        (touched,) = np.nonzero(np.diag(size) > _TINY * size.max(initial=1e-300))
        diagonal = size.sum() - np.trace(size) <= _TINY * size.sum()
        if len(touched) == 1 and diagonal:
            values = mass[:, touched[0], touched[0]]
            if values.min() >= -_TINY * values.max():
                operations = int(problem.terms[int(k)].expr.count_ops())
                options[int(touched[0])].append((operations, (position,)))
    options = [sorted(each)[:_MOST_EACH] or [(0, ())] for each in options]
    return [tuple(sorted(members)) for members in islice(cheapest_combinations(options), _MOST_BASES)]


def cheapest_combinations(options: Sequence[Sequence[Option]]) -> Iterator[tuple[int, ...]]:
    """Yield the members of all combinations, one option of each coordinate, the cheapest first.

    Best-first: each combination but the first has one parent, in which its last option that is not a cheapest
    one is the option before.  No child is cheaper than its parent, so a heap that holds the children of what
    was yielded has the next one on top: seven coordinates cost no more than two.

    Parameters
    ----------
    options
        For each coordinate, in rising sequence; none empty.

    Examples
    --------
    >>> list(cheapest_combinations([[(1, (0,)), (3, (1,))], [(1, (2,)), (2, (3,))]]))
    [(0, 2), (0, 3), (1, 2), (1, 3)]
    """

    def entry(choice: tuple[int, ...]) -> tuple[int, tuple[int, ...], tuple[int, ...]]:
        parts = [each[c] for each, c in zip(options, choice, strict=True)]
        return sum(cost for cost, _ in parts), sum((m for _, m in parts), ()), choice

    heap = [entry((0,) * len(options))]
    while heap:
        _, members, choice = heappop(heap)
        yield members
        last = max((i for i, c in enumerate(choice) if c), default=0)
        for i in range(last, len(options)):
            if choice[i] + 1 < len(options[i]):
                heappush(heap, entry((*choice[:i], choice[i] + 1, *choice[i + 1 :])))
