"""leastaction with every option at its default."""

from __future__ import annotations

import time
from collections.abc import Mapping

import leastaction as la
from reproduction.problem import Answer, Problem

TITLE = "leastaction"
REFERENCE = "this package"


def solve(problem: Problem) -> Answer:
    history: list = []
    started = time.perf_counter()

    def watch(stage: str, details: dict) -> None:
        if "coefficients" in details:
            history.append((time.perf_counter() - started, _named(problem, details["coefficients"])))

    model = la.discover(problem.data, problem.library, known=problem.known, progress=watch)
    free = [term for term in model.terms if not term.known]
    coefficients = _named(problem, {term.expression: term.coefficient for term in free})
    history.append((time.perf_counter() - started, coefficients))
    return Answer(
        coefficients=coefficients,
        acceleration=model.acceleration,
        status=model.fit.status,
        errors=_named(problem, {term.expression: term.standard_error for term in free}),
        history=history,
    )


def _named(problem: Problem, values: Mapping[str, float]) -> dict[str, float]:
    """Values of the free terms by the texts of the library, which the package may write another way."""
    return {
        problem.library[problem.library.index(text)].text: value
        for text, value in values.items()
        if text not in problem.known
    }
