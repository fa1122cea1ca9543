"""leastaction with every option at its default."""

from __future__ import annotations

import time

import leastaction as la
from reproduction.problem import Answer, Problem

TITLE = "leastaction"
REFERENCE = "this package"


def solve(problem: Problem) -> Answer:
    course: list = []
    started = time.perf_counter()

    def watch(stage: str, details: dict) -> None:
        if "coefficients" in details:
            course.append((time.perf_counter() - started, details["coefficients"]))

    model = la.discover(problem.data, problem.library, known=problem.known, progress=watch)
    course.append((time.perf_counter() - started, {t.expression: t.coefficient for t in model.terms}))
    found = problem.free(course[-1][1])
    return Answer(
        coefficients=found,
        acceleration=model.acceleration,
        status=model.fit.status,
        errors=problem.free({t.expression: t.standard_error for t in model.terms}),
        history=[(seconds, problem.free(values)) for seconds, values in course],
    )
