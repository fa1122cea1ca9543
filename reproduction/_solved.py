"""Cases solved once, whichever of the figures need them."""

from __future__ import annotations

from functools import lru_cache

from reproduction import methods
from reproduction.problem import Answer, Case, Problem, pose

__all__ = ["TITLES", "label", "solved"]

TITLES = {"ours": "leastaction", "adam": "paper's method"}


@lru_cache(maxsize=8)
def solved(case: Case) -> tuple[Problem, Answer]:
    """Pose a case and solve it by its method."""
    problem = pose(case)
    return problem, methods.load(case.method).solve(problem)


def label(method: str, noise: float) -> str:
    return f"{TITLES[method]}, {100 * noise:g} % noise"
