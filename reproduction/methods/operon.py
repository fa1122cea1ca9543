"""Symbolic regression by Operon (Burlacu, Kronberger & Kommenda, GECCO 2020), in the place of uDSR.

The paper compares with uDSR, which needs Python 3.7 or older; Operon is set the same task: for each
coordinate an expression q̈ᵢ(q, q̇, f), from velocities and accelerations smoothed from the positions.

* Symbols add, sub, mul, div, sin, cos, and sqrt if the Lagrangian library has one; objectives R² and length
  (NSGA-II), five Levenberg–Marquardt steps on the constants of every expression, expressions of up to 50
  nodes: the package's own examples and defaults.
* Every tenth sample of all trajectories but one; of the Pareto front the expression with the smallest error
  on the trajectory left out (of the last fifth, if there is only one) is taken, or a shorter one that is
  within one per cent.  Operon's own choice, description length, needs the noise of q̈, which is not known.
* 1000 expressions, 60 generations, one thread, fixed seed: about half a minute for each coordinate.
"""

from __future__ import annotations

import warnings

import numpy as np
from pyoperon.sklearn import SymbolicRegressor

import leastaction as la
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
STRIDE = 10


def solve(problem: Problem, **options) -> Answer:
    """`options` replace those of `OPTIONS`."""
    train, test = _samples(problem)
    if any("sqrt" in term.text for term in problem.library):
        options = {"allowed_symbols": f"{OPTIONS['allowed_symbols']},sqrt", **options}
    options = {**OPTIONS, **options, "random_state": problem.case.seed}
    found = []
    for i in range(problem.system.n_dof):
        regressor = SymbolicRegressor(**options).fit(train[0], train[1][:, i])
        found.append((regressor, *_select(regressor, test[0], test[1][:, i])))
    return Answer(
        coefficients=None,
        acceleration=_acceleration([(regressor, tree) for regressor, tree, _, _ in found]),
        status="ok" if all(error < 1 for *_, error in found) else "no better than the mean",
        settings={**options, "stride": STRIDE, "held_out_error": [error for *_, error in found]},
        expression=_text(problem, [(regressor, tree) for regressor, tree, _, _ in found]),
    )


def _columns(q: np.ndarray, qdot: np.ndarray, forces: np.ndarray | None) -> np.ndarray:
    return np.column_stack([q, qdot] if forces is None else [q, qdot, forces])


def _samples(problem: Problem):
    """Return inputs and accelerations to learn from and to choose by."""
    pairs = [
        (_columns(motion.q, motion.qdot, run.forces), motion.qddot)
        for motion, run in zip(la.smooth(problem.data), problem.data, strict=True)
    ]
    if len(pairs) == 1:
        border = int(0.8 * len(pairs[0][0]))
        pairs = [tuple(a[:border] for a in pairs[0]), tuple(a[border:] for a in pairs[0])]
    train = tuple(np.concatenate([pair[k][::STRIDE] for pair in pairs[:-1]]) for k in range(2))
    return train, pairs[-1]


def _select(regressor: SymbolicRegressor, inputs: np.ndarray, target: np.ndarray):
    """Return the tree of the Pareto front, its length, and its error relative to the target's deviation."""
    front = [(member["tree"], member["length"]) for member in regressor.pareto_front_]
    errors = []
    for tree, _ in front:
        with np.errstate(all="ignore"):
            residual = regressor.evaluate_model(tree, inputs) - target
            errors.append(np.sqrt(np.mean(residual**2)) / np.std(target))
    errors = np.nan_to_num(errors, nan=np.inf)
    close = np.flatnonzero(errors <= 1.01 * errors.min())
    k = min(close, key=lambda j: front[j][1])
    return *front[k], float(errors[k])


def _acceleration(models: list):
    def acceleration(q, qdot, forces=None):
        inputs = _columns(q, qdot, forces)
        # the package accepts finite numbers only
        good = np.isfinite(inputs).all(axis=1)
        result = np.full((len(inputs), len(models)), np.nan)
        if good.any():
            columns = [regressor.evaluate_model(tree, inputs[good]) for regressor, tree in models]
            result[good] = np.column_stack(columns)
        return result

    return acceleration


def _text(problem: Problem, models: list) -> str:
    system = problem.system
    driven = () if problem.data[0].forces is None else (f"f_{c}" for c in system.coordinates)
    names = [*system.coordinates, *system.velocities, *driven]
    lines = []
    with warnings.catch_warnings():
        # a constant can be the answer
        warnings.filterwarnings("ignore", message="Model contains no variables")
        for coordinate, (regressor, tree) in zip(system.coordinates, models, strict=True):
            lines.append(f"{coordinate}_ddot = {regressor.get_model_string(tree, 6, names)}")
    return "\n".join(lines)
