"""Kinetic energies to grow a support from: one diagonal term for each coordinate, nowhere negative.

A kinetic energy is positive whatever the velocities, so its mass matrix has a positive diagonal; nearly
every Lagrangian of mechanics therefore holds, for each coordinate, a candidate q̇_i² g(q) with g ≥ 0.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from leastaction.curve.smoothing import Smooth
from leastaction.estimation.grid import Grid
from leastaction.mechanics.euler_lagrange import Points

__all__ = ["kinetic_bases"]

_MOST_BASES = 60
_MOST_EACH = 8
_POINTS = 400
_TINY = 1e-9


def kinetic_bases(grid: Grid, smooth: Smooth) -> list[tuple[int, ...]]:
    """Positions among the free columns, the simplest expressions first; at least the empty set."""
    problem = grid.problem
    states = grid.spline.at_quadrature(smooth.control_points)
    stride = max(1, grid.spline.n_intervals // _POINTS)
    points = Points(*(s[::stride, 0] for s in states))
    n = problem.trajectories.n_dof
    options: list[list[tuple[int, tuple[int, ...]]]] = [[] for _ in range(n)]
    fixed = problem.completed(np.zeros(len(problem.candidates)))
    given = problem.candidates.mass_matrix(points, fixed)
    for i in range(n):
        if np.all(given[:, i, i] > 0.0):  # a known term holds it up
            options[i].append((0, ()))
    for position, k in enumerate(problem.free):
        mass = problem.candidates.mass_of(int(k), points)
        size = np.abs(mass).max(axis=0)
        (touched,) = np.nonzero(np.diag(size) > _TINY * size.max(initial=1e-300))
        diagonal = size.sum() - np.trace(size) <= _TINY * size.sum()
        if len(touched) == 1 and diagonal:
            values = mass[:, touched[0], touched[0]]
            if values.min() >= -_TINY * values.max():
                operations = int(problem.candidates.terms[int(k)].expr.count_ops())
                options[touched[0]].append((operations, (position,)))
    options = [sorted(each)[:_MOST_EACH] or [(0, ())] for each in options]
    sets = sorted((sum(o for o, _ in parts), sum((m for _, m in parts), ())) for parts in product(*options))
    return [tuple(sorted(members)) for _, members in sets[:_MOST_BASES]]
