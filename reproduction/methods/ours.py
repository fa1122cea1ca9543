"""leastaction with every option at its default."""

from __future__ import annotations

import leastaction as la
from reproduction.problem import Answer, Problem

TITLE = "leastaction"
REFERENCE = "this package"


def solve(problem: Problem) -> Answer:
    model = la.discover(problem.data, problem.library, known=problem.known)
    free = [term for term in model.terms if not term.known]
    names = {term.expression: problem.library[problem.library.index(term.expression)].text for term in free}
    return Answer(
        coefficients={names[term.expression]: term.coefficient for term in free},
        acceleration=model.acceleration,
        status=model.fit.status,
        errors={names[term.expression]: term.standard_error for term in free},
    )
