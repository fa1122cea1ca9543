"""Joins the motions of single windows to one that obeys the law, by raising the weight of the equations.

The motion in windows has jumps. With weights estimated from it, the equations look inexact, and coefficients
fitted with these weights diverge. The coefficients are therefore held in the first steps. The weights rise
tenfold from step to step, and the curve follows. The joint fit starts at the step of the highest evidence.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.structure import Structure
from leastaction.estimation.weights import Start, evidence, update_weights

__all__ = ["drawn_together"]

_FACTOR = 10.0  # by which the weights rise in a step
_HELD = 2  # first steps, in which coefficients are held
_MOST_STEPS = 12  # limit on steps
_WORSE = 3  # successive steps of lower evidence that end the loop


def drawn_together(grid: Grid, structure: Structure, start: Start) -> Start:
    """The curve, coefficients and weights of the step of the highest evidence."""
    physics, index = grid.physics(structure)
    held = Physics(physics.columns, np.zeros_like(physics.free), physics.forces)
    values = grid.problem.completed(start.coefficients)[index]
    best, highest, worse = start, -np.inf, 0
    weights, points = start.weights, start.control_points
    for step in range(_MOST_STEPS):
        found = fit_joint(grid.observations, held, weights, points, values, tolerance=1.0)
        if not found.usable:
            break
        if step >= _HELD:
            free = fit_joint(
                grid.observations, physics, _at_rest(grid, found), found.control_points, values, tolerance=1.0
            )
            found = free if free.usable else found
        points, values, value = found.control_points, found.coefficients, evidence(grid.observations, found)
        worse = 0 if value > highest else worse + 1
        if value > highest:
            coefficients = start.coefficients.copy()
            coefficients[index] = values
            best, highest = Start(points, coefficients, found.weights), value
        if worse == _WORSE:
            break
        weights = replace(weights, physics=_FACTOR * weights.physics)
    return best


def _at_rest(grid: Grid, found: JointFit) -> Weights:
    """The weights of a fit, with the degrees of freedom that it leaves to the equation error."""
    try:
        return replace(found.weights, slack=update_weights(grid.observations, found).slack)
    except np.linalg.LinAlgError:
        return found.weights
