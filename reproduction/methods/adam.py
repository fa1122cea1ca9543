"""The paper's method: discover(method="adam"), with the best settings that search_adam.py found.

Settings are those of the nearest noise level searched for the system (``adam_settings.json`` beside the
search), chosen by the error against the truth on a data set that no table uses: more help than a user has.
Variants: "no-regularisation" leaves out J_reg (β = 0); "from-truth" begins at the true coefficients, an
experiment that tells a poor start from a poor optimum; "true-terms" has no other candidates than the true
terms, an experiment that tells what the choice of candidates does; "short" runs a tenth of the iterations;
"samples" begins with curves through the samples, not with smooth ones, and a stronger β;
"samples-no-regularisation" does so with β = 0.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

import leastaction as la
from reproduction.problem import Answer, Problem

TITLE = "paper's method (Adam)"
REFERENCE = "Zhang & Sun, Differentiable Sparse Identification of Lagrangian Dynamics, AAAI 2026"

SETTINGS = Path(__file__).parents[1] / "adam_settings.json"
VARIANTS = "no-regularisation, from-truth, true-terms, short, samples or samples-no-regularisation"
_ROUGH = {"samples": 1e-5, "samples-no-regularisation": 0.0}  # β; less leaves the noise in the accelerations
_FINE = 4001  # points of a curve


def solve(problem: Problem) -> Answer:
    return _solve(problem)[0]


def solve_with_curve(problem: Problem):
    """The answer, and the fitted curves: a list of (t, q, qdot, qddot), one for each trajectory."""
    answer, model = _solve(problem)
    times = [np.linspace(d.t[0], d.t[-1], _FINE) for d in problem.data]
    states = [model.diagnostics.curve(times, nu) for nu in range(3)]
    return answer, list(zip(times, *states, strict=True))


def settings_for(problem: Problem) -> la.AdamOptions:
    """The searched settings, changed as the case's variant says."""
    table = json.loads(SETTINGS.read_text())[problem.case.system]
    level = min(table, key=lambda key: abs(float(key) - problem.case.noise))
    options = la.AdamOptions(**table[level]["options"])
    if problem.case.variant == "no-regularisation":
        options = replace(options, curvature_weight=0.0)
    elif problem.case.variant == "from-truth":
        options = replace(options, start_coefficients=dict(problem.true_coefficients))
    elif problem.case.variant in _ROUGH:
        options = replace(options, start_curve="samples", curvature_weight=_ROUGH[problem.case.variant])
    elif problem.case.variant == "short":
        tenth = options.iterations // 10
        options = replace(options, iterations=tenth, threshold_from=tenth // 2, check_every=tenth // 4)
    elif problem.case.variant not in ("", "true-terms"):
        raise ValueError(f"variant {problem.case.variant!r} is unknown; use {VARIANTS}")
    return options


def discover(problem: Problem, options: la.AdamOptions, watch) -> la.LagrangianModel:
    """The model by the paper's method; ``watch`` is called with its progress."""
    library = problem.library
    if problem.case.variant == "true-terms":
        library = library.replace(terms=list(problem.true_coefficients))
    return la.discover(
        problem.data,
        library,
        known=problem.known,
        method="adam",
        options=options,
        seed=problem.case.seed,
        progress=watch,
    )


def _solve(problem: Problem):
    options = settings_for(problem)
    course: list = []
    started = time.perf_counter()

    def watch(stage: str, details: dict) -> None:
        if stage == "descent" and "coefficients" in details:
            course.append((time.perf_counter() - started, details["coefficients"]))

    model = discover(problem, options, watch)
    answer = Answer(
        coefficients=problem.free({t.expression: t.coefficient for t in model.terms}),
        acceleration=model.acceleration,
        status=model.fit.status,
        settings=asdict(options),
        history=[(seconds, problem.free(values)) for seconds, values in course],
    )
    return answer, model
