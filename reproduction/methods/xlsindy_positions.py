"""xL-SINDy with what a user has: velocities and accelerations from smoothed positions."""

from __future__ import annotations

import time

import numpy as np

import leastaction as la
from reproduction.methods._xlsindy import solve_from
from reproduction.problem import Answer, Problem

TITLE = "xL-SINDy (positions only)"
REFERENCE = "Purnomo & Hayashibe 2023, Sci Rep 13:7919; splines by la.smooth"


def solve(problem: Problem) -> Answer:
    started = time.perf_counter()
    motions = la.smooth(problem.data)
    states = [
        (np.stack([motion.q, motion.qdot, motion.qddot], axis=1), measured.forces)
        for motion, measured in zip(motions, problem.data, strict=True)
    ]
    return solve_from(problem, states, started)
