"""Symbolic regression by Operon (Burlacu, Kronberger & Kommenda, GECCO 2020), beside uDSR (``udsr.py``).

The paper compares with uDSR; Operon is set the same task: for each coordinate an expression q̈ᵢ(q, q̇, f),
from velocities and accelerations smoothed from the positions.

* Symbols add, sub, mul, div, sin, cos, and sqrt if the Lagrangian library has one; objectives R² and length
  (NSGA-II), five Levenberg–Marquardt steps on the constants of every expression, expressions of up to 50
  nodes: the package's own examples and defaults.
* Every tenth sample of all trajectories but one; of the Pareto front the expression with the smallest error
  on the trajectory left out (of the last fifth, if there is only one) is taken, or a shorter one that is
  within one per cent.  Operon's own choice, description length, needs the noise of q̈, which is not known.
* 1000 expressions, 60 generations, one thread, fixed seed: about 15 s for each coordinate.

Variant "given-rates" is told the exact velocities and accelerations plus noise of the case's level, and runs
for 180 generations, about a minute for each coordinate.  Of a double pendulum without noise that is in no
table, four times the generations or four times the expressions halve the error (0.16 to 0.06 and 0.07).
"""

from __future__ import annotations

import warnings
from functools import partial

import numpy as np
from pyoperon.sklearn import SymbolicRegressor

from reproduction.methods._symbolic import GIVEN, STRIDE, acceleration_of, choose, names, samples
from reproduction.problem import Answer, Problem

TITLE = "Operon"
REFERENCE = "pyoperon; Burlacu, Kronberger & Kommenda, GECCO Companion (2020) 1562"

OPTIONS = {
    "allowed_symbols": "add,sub,mul,div,sin,cos,constant,variable",
    "objectives": ["r2", "length"],
    "optimizer_iterations": 5,
    "max_length": 50,
    "population_size": 1000,
    "generations": 60,
    "max_evaluations": 10_000_000,
    "n_threads": 1,
}
LONG = {"generations": 180}  # with given rates


def solve(problem: Problem, **options) -> Answer:
    """`options` replace those of `OPTIONS`."""
    given = problem.case.variant == GIVEN
    if problem.case.variant not in ("", GIVEN):
        raise ValueError(f"variant {problem.case.variant!r} is unknown; use {GIVEN}")
    train, test = samples(problem, given)
    if any("sqrt" in term.text for term in problem.library):
        options = {"allowed_symbols": f"{OPTIONS['allowed_symbols']},sqrt", **options}
    options = {**OPTIONS, **(LONG if given else {}), **options, "random_state": problem.case.seed}
    found = []
    for i in range(problem.system.n_dof):
        regressor = SymbolicRegressor(**options).fit(train[0], train[1][:, i])
        found.append((regressor, *_select(regressor, test[0], test[1][:, i])))
    models = [(regressor, tree) for regressor, tree, _, _ in found]
    return Answer(
        coefficients=None,
        acceleration=acceleration_of([partial(regressor.evaluate_model, tree) for regressor, tree in models]),
        status="ok" if all(error < 1 for *_, error in found) else "no better than the mean",
        settings={**options, "stride": STRIDE, "held_out_error": [error for *_, error in found]},
        expression=_text(problem, models),
    )


def _select(regressor: SymbolicRegressor, inputs: np.ndarray, target: np.ndarray):
    """Return the chosen tree of the Pareto front, its length, and its error on the trajectory left out."""
    front = [(member["tree"], member["length"]) for member in regressor.pareto_front_]
    with np.errstate(all="ignore"):
        predictions = [regressor.evaluate_model(tree, inputs) for tree, _ in front]
    k, error = choose(predictions, [length for _, length in front], target)
    return *front[k], error


def _text(problem: Problem, models: list) -> str:
    lines = []
    with warnings.catch_warnings():
        # a constant can be the answer
        warnings.filterwarnings("ignore", message="Model contains no variables")
        for coordinate, (regressor, tree) in zip(problem.system.coordinates, models, strict=True):
            lines.append(f"{coordinate}_ddot = {regressor.get_model_string(tree, 6, names(problem))}")
    return "\n".join(lines)
