"""What symbolic regression of q̈ᵢ(q, q̇, f) is given, and how one expression of many is chosen."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

import leastaction as la
from reproduction.methods.xlsindy import exact_states
from reproduction.problem import Acceleration, Problem, inputs, names

__all__ = ["GIVEN", "STRIDE", "acceleration_of", "choose", "names", "samples"]

STRIDE = 10  # every tenth sample is learned from
GIVEN = "given-rates"  # the variant that is told velocities and accelerations
NEAR = 1.01  # times the smallest error: a shorter expression is then preferred

Samples = tuple[np.ndarray, np.ndarray]  # inputs, accelerations


def samples(problem: Problem, given: bool) -> tuple[Samples, Samples]:
    """Return what to learn from, and what to choose by: one trajectory, or the last fifth of a single one.

    Parameters
    ----------
    problem : Problem
    given : bool
        Exact velocities and accelerations plus noise of the case's level; else rates smoothed from positions.
    """
    if given:
        pairs = [(inputs(*s.swapaxes(0, 1)[:2], f), s[:, 2]) for s, f in exact_states(problem)]
    else:
        pairs = [
            (inputs(motion.q, motion.qdot, run.forces), motion.qddot)
            for motion, run in zip(la.smooth(problem.data), problem.data, strict=True)
        ]
    if len(pairs) == 1:
        border = int(0.8 * len(pairs[0][0]))
        pairs = [tuple(a[:border] for a in pairs[0]), tuple(a[border:] for a in pairs[0])]
    columns, targets = (np.concatenate([pair[k][::STRIDE] for pair in pairs[:-1]]) for k in range(2))
    return (columns, targets), pairs[-1]


def choose(
    predictions: Sequence[np.ndarray], lengths: Sequence[float], target: np.ndarray
) -> tuple[int, float]:
    """Return the place of the best expression and its error relative to the target's deviation.

    The best is the shortest of those whose error is within one per cent of the smallest.
    """
    with np.errstate(all="ignore"):
        errors = [np.sqrt(np.mean((p - target) ** 2)) / np.std(target) for p in predictions]
    errors = np.nan_to_num(errors, nan=np.inf)
    close = np.flatnonzero(errors <= NEAR * errors.min())
    k = min(close, key=lambda j: lengths[j])
    return int(k), float(errors[k])


def acceleration_of(functions: Sequence[Callable[[np.ndarray], np.ndarray]]) -> Acceleration:
    """Return q̈(q, q̇, f) of one function of the inputs a coordinate; NaN where the inputs are not finite."""

    def acceleration(q, qdot, forces=None):
        columns = inputs(q, qdot, forces)
        good = np.isfinite(columns).all(axis=1)  # Operon accepts finite numbers only
        result = np.full((len(columns), len(functions)), np.nan)
        if good.any():
            result[good] = np.column_stack([function(columns[good]) for function in functions])
        return result

    return acceleration
