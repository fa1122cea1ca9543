"""xL-SINDy as published: it is given exact velocities and accelerations, plus noise."""

from __future__ import annotations

import time

import numpy as np

from reproduction.methods._xlsindy import States, solve_from
from reproduction.problem import Answer, Problem

TITLE = "xL-SINDy (given q̇, q̈)"
REFERENCE = "Purnomo & Hayashibe 2023, Sci Rep 13:7919"


def solve(problem: Problem) -> Answer:
    started = time.perf_counter()
    return solve_from(problem, states(problem), started)


def states(problem: Problem) -> States:
    """Measured positions with exact rates whose noise is of the case's level, as the authors give them.

    The level is relative to the standard deviation of each rate over all trajectories, or absolute (in
    units of the rate), as for the positions.  Samples without all positions are left out.
    """
    case, rng = problem.case, np.random.default_rng([problem.case.seed, 0])
    sigma = {}
    for name in ("qdot", "qddot"):
        spread = np.concatenate([getattr(motion, name) for motion in problem.truth]).std(axis=0)
        sigma[name] = case.noise * (spread if case.noise_convention == "relative" else 1.0)
    states = []
    for motion, measured in zip(problem.truth, problem.data, strict=True):
        rates = [
            exact + sigma[name] * rng.standard_normal(exact.shape)
            for name, exact in (("qdot", motion.qdot), ("qddot", motion.qddot))
        ]
        whole = np.isfinite(measured.q).all(axis=1)
        stacked = np.stack([measured.q, *rates], axis=1)[whole]
        states.append((stacked, None if motion.forces is None else motion.forces[whole]))
    return states
