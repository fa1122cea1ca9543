"""leastaction with every option at its default; variant "names" is told no candidates, only the coordinates.

Its candidates are those of ``--library symbolic``, grown from the coordinates' names. Its law may be written
in other terms than the textbook's, and then counts as wrong where terms are compared. With unknown numbers
inside terms it is an expression, and judged as those of symbolic regression.
"""

from __future__ import annotations

import time
from dataclasses import replace

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

    library = _library(problem)
    model = la.discover(problem.data, library, known=problem.known, progress=watch)
    course.append((time.perf_counter() - started, {t.expression: t.coefficient for t in model.terms}))
    if model.shapes:
        law = " ".join(f"{value:+.6g}*{text}" for text, value in course[-1][1].items())
        return Answer(None, model.acceleration, model.fit.status, expression=f"L = {law}")
    free = replace(problem, library=library).free
    return Answer(
        coefficients=free(course[-1][1]),
        acceleration=model.acceleration,
        status=model.fit.status,
        errors=free({t.expression: t.standard_error for t in model.terms}),
        history=[(seconds, free(values)) for seconds, values in course],
    )


def _library(problem: Problem) -> la.Library:
    if problem.case.variant == "names":
        return la.Library.symbolic(problem.system.coordinates, problem.system.angles)
    if problem.case.variant:
        raise ValueError(f"variant {problem.case.variant!r} is unknown; use names")
    return problem.library
