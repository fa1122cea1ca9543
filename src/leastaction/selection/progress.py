"""Progress reports of a search, and the time of each stage."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from leastaction.errors import StopSearch
from leastaction.estimation.problem import Problem

__all__ = ["Clock", "Progress", "law_so_far", "silent"]

Progress = Callable[[str, dict[str, Any]], None]
"""Called with a stage and its details: plain numbers, and dictionaries of them, as JSON has them."""


def silent(stage: str, details: dict[str, Any]) -> None:
    """Ignore progress reports."""


def law_so_far(problem: Problem, coefficients: np.ndarray, evidence: float) -> dict[str, Any]:
    """What a user may see of a structure on the way; known terms are in the coefficients only."""
    free = int(np.count_nonzero(coefficients[problem.free]))
    return {"terms": free, "evidence": float(evidence), "coefficients": problem.named(coefficients)}


class Clock:
    """Seconds of each stage, passed on to the user's progress display."""

    def __init__(self, progress: Progress | None) -> None:
        self.timings: dict[str, float] = {}
        self._progress = progress
        self._stage, self._since = "", 0.0

    def _tell(self, stage: str, details: dict[str, Any]) -> None:
        """Pass it on, until the user has stopped the search."""
        if self._progress is None:
            return
        try:
            self._progress(stage, details)
        except StopSearch:
            self._progress = None
            raise

    def start(self, stage: str) -> None:
        self.stop()
        self._stage, self._since = stage, time.perf_counter()
        self._tell(stage, {})

    def report(self, stage: str, details: dict[str, Any]) -> None:
        if stage != self._stage:
            self.stop()
            self._stage, self._since = stage, time.perf_counter()
        self._tell(stage, details)

    def stop(self) -> None:
        if self._stage:
            spent = time.perf_counter() - self._since
            self.timings[self._stage] = self.timings.get(self._stage, 0.0) + spent
        self._stage = ""
