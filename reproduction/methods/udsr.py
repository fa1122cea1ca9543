"""Symbolic regression by uDSR (Landajuela et al., NeurIPS 2022): the authors' code, in a Python of its own.

The environment variable ``UDSR_PYTHON`` names a Python that has the package ``dso``: the code of
dso-org/deep-symbolic-optimization (Python 3.7, TensorFlow 1.14) or of its port
deep-symbolic-optimization-pytorch (Python 3.11, NumPy below 2.3), set up as their README says. Where there is
none, the method is left out. The records were made with the port, commit 85f88fa.

* For each coordinate an expression q̈ᵢ(q, q̇, f), as for Operon: every tenth sample of all trajectories but
  one, and the shortest expression of the Pareto front whose error on the trajectory left out is within one
  per cent of the smallest. Velocities and accelerations are given: exact ones plus noise of the case's level.
* Functions add, sub, mul, div, sin, cos, const, and sqrt if the Lagrangian library has one. The package's own
  defaults, with genetic programming as in its example, batches of 500, and 45 s of the processor for each
  coordinate, after which the step under way is finished.
* As released, genetic programming changes nothing: an individual's reward is that of the tokens with which it
  was made. The variant "repaired" replaces that property when the program runs; "poly" adds the token of a
  cubic polynomial in all inputs; "repaired-poly" does both.

What both regressions of accelerations are given, and how one expression of many is chosen, stands here, too.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

import leastaction as la
from reproduction.methods.xlsindy import exact_states
from reproduction.problem import Acceleration, Answer, Problem, inputs, names
from runner.machine import environment, last_words

STRIDE = 10  # every tenth sample is learned from
GIVEN = "given-rates"  # the variant that is told velocities and accelerations
NEAR = 1.01  # times the smallest error: a shorter expression is then preferred

Samples = tuple[np.ndarray, np.ndarray]  # inputs, accelerations

TITLE = "uDSR"
REFERENCE = "dso; Landajuela et al., A Unified Framework for Deep Symbolic Regression, NeurIPS 2022"

WORKER = Path(__file__).with_name("_udsr_worker.py")
VARIANTS = ("", "repaired", "poly", "repaired-poly")
SECONDS = 45.0  # of the processor, for each coordinate
FUNCTIONS = ("add", "sub", "mul", "div", "sin", "cos", "const")
GENETIC = {
    "run_gp_meld": True,
    "population_size": 100,
    "generations": 20,
    "crossover_operator": "cxOnePoint",
    "p_crossover": 0.5,
    "mutation_operator": "multi_mutate",
    "p_mutate": 0.5,
    "tournament_size": 5,
    "train_n": 50,
    "mutate_tree_max": 3,
    "parallel_eval": False,
    "verbose": False,
}
TRAINING = {"batch_size": 500, "n_samples": 10**9, "n_cores_batch": 1, "verbose": False}

_BINARY = {"add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide}
_UNARY = {"sin": np.sin, "cos": np.cos, "sqrt": np.sqrt}
_SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}

Token = str | float | dict


def _environment() -> dict[str, str]:
    """One BLAS thread, and none of this Python's packages."""
    return {name: value for name, value in environment().items() if name != "PYTHONPATH"}


def _python() -> str:
    """Return the Python that has uDSR; ImportError says what is missing."""
    name = os.environ.get("UDSR_PYTHON", "")
    found = shutil.which(name) if name else None
    if found is None:
        raise ImportError("the environment variable UDSR_PYTHON names no Python with uDSR (package dso)")
    look = "import importlib.util, sys; sys.exit(importlib.util.find_spec('dso') is None)"
    if subprocess.run([found, "-c", look], env=_environment()).returncode:
        raise ImportError(f"the Python that UDSR_PYTHON names, {Path(found).name}, has no package dso")
    return found


PYTHON = _python()


def solve(problem: Problem, seconds: float = SECONDS) -> Answer:
    """`seconds` of the processor are spent on each coordinate."""
    settings = _settings(problem, seconds)
    (inputs, targets), (unseen, wanted) = samples(problem, given=True)
    chosen, errors, runs = [], [], []
    for i in range(problem.system.n_dof):
        done = _regress(inputs, targets[:, i], settings)
        fronts = done["front"]
        with np.errstate(all="ignore"):
            predictions = [evaluate(member["tokens"], unseen) for member in fronts]
        k, error = choose(predictions, [member["complexity"] for member in fronts], wanted[:, i])
        chosen.append(fronts[k]["tokens"])
        errors.append(error)
        runs.append(
            {key: done[key] for key in ("steps", "evaluated", "versions")} | {"peak_mb": done["peak_mb"]}
        )
    texts = [infix(tokens, names(problem)) for tokens in chosen]
    lines = [f"{c}_ddot = {text}" for c, text in zip(problem.system.coordinates, texts, strict=True)]
    return Answer(
        coefficients=None,
        acceleration=acceleration_of([partial(evaluate, tokens) for tokens in chosen]),
        status="ok" if all(error < 1 for error in errors) else "no better than the mean",
        settings={**settings, "stride": STRIDE, "held_out_error": errors, "runs": runs},
        expression="\n".join(lines),
        child_mb=max(run["peak_mb"] for run in runs),
    )


def _settings(problem: Problem, seconds: float) -> dict:
    """Return what the worker is told beside the data."""
    variant = problem.case.variant
    if variant not in VARIANTS:
        raise ValueError(f"variant {variant!r} is unknown; use {', '.join(v for v in VARIANTS if v)}")
    functions = list(FUNCTIONS)
    functions += ["sqrt"] if any("sqrt" in term.text for term in problem.library) else []
    functions += ["poly"] if "poly" in variant else []
    config = {
        "experiment": {"logdir": None, "seed": problem.case.seed},
        "task": {"function_set": functions},
        "training": TRAINING,
        "gp_meld": GENETIC,
    }
    return {"seconds": seconds, "repair": "repaired" in variant, "config": config}


def _regress(inputs: np.ndarray, target: np.ndarray, settings: dict) -> dict:
    """Run the worker on one target and return its result; RuntimeError has its last words if it fails."""
    with tempfile.TemporaryDirectory(prefix="udsr-") as name:
        folder = Path(name)
        np.savez(folder / "task.npz", X=inputs, y=target)
        (folder / "settings.json").write_text(json.dumps(settings), encoding="utf-8")
        log = folder / "log.txt"
        with log.open("wb") as stream:
            command = [PYTHON, str(WORKER), str(folder)]
            # an open pipe as its input: the worker ends when this process does
            how = {"cwd": folder, "env": _environment(), "stdout": stream, "stderr": stream}
            with subprocess.Popen(command, stdin=subprocess.PIPE, **how) as process:
                process.wait()
        if process.returncode:
            raise RuntimeError(f"uDSR: {last_words(process.returncode, log)}")
        return json.loads((folder / "result.json").read_text(encoding="utf-8"))


def evaluate(tokens: Sequence[Token], inputs: np.ndarray) -> np.ndarray:
    """Return the values of an expression in prefix order at (n, n_inputs) points; NaN or ∞ where it fails."""
    rest = iter(tokens)

    def value() -> np.ndarray | float:
        token = next(rest)
        if isinstance(token, dict):
            return inputs[:, token["input"]] if "input" in token else _polynomial(token, inputs)
        if isinstance(token, str):
            if token in _UNARY:
                return _UNARY[token](value())
            return _BINARY[token](value(), value())
        return float(token)

    with np.errstate(all="ignore"):
        return np.broadcast_to(value(), len(inputs)).astype(float)


def _polynomial(token: dict, inputs: np.ndarray) -> np.ndarray:
    powers = np.array(token["exponents"], dtype=int).reshape(-1, inputs.shape[1])
    return np.prod(inputs[:, None, :] ** powers, axis=2) @ np.array(token["coefficients"], dtype=float)


def infix(tokens: Sequence[Token], labels: Sequence[str]) -> str:
    """Return an expression as people write it."""
    rest = iter(tokens)

    def text() -> str:
        token = next(rest)
        if isinstance(token, dict):
            return (
                labels[token["input"]] if "input" in token else f"({' + '.join(_monomials(token, labels))})"
            )
        if isinstance(token, str):
            return f"{token}({text()})" if token in _UNARY else f"({text()} {_SIGNS[token]} {text()})"
        return f"{token:.6g}"

    return text()


def _monomials(token: dict, labels: Sequence[str]) -> Iterator[str]:
    for coefficient, powers in zip(token["coefficients"], token["exponents"], strict=True):
        factors = [f"{label}**{p}" if p > 1 else label for label, p in zip(labels, powers, strict=True) if p]
        yield "*".join([f"{coefficient:.6g}", *factors])


def samples(problem: Problem, given: bool) -> tuple[Samples, Samples]:
    """Return what to learn from, and what to choose by: one trajectory, or the last fifth of a single one.

    Parameters
    ----------
    problem : Problem
    given : bool
        Exact velocities and accelerations plus noise of the case's level; else rates smoothed from positions.
    """
    if given:
        pairs = [(inputs(*s.swapaxes(0, 1)[:2], f), s[:, 2]) for s, f in exact_states(problem)]
    else:
        pairs = [
            (inputs(motion.q, motion.qdot, run.forces), motion.qddot)
            for motion, run in zip(la.smooth(problem.data), problem.data, strict=True)
        ]
    if len(pairs) == 1:
        border = int(0.8 * len(pairs[0][0]))
        pairs = [tuple(a[:border] for a in pairs[0]), tuple(a[border:] for a in pairs[0])]
    columns, targets = (np.concatenate([pair[k][::STRIDE] for pair in pairs[:-1]]) for k in range(2))
    return (columns, targets), pairs[-1]


def choose(
    predictions: Sequence[np.ndarray], lengths: Sequence[float], target: np.ndarray
) -> tuple[int, float]:
    """Return the place of the best expression and its error relative to the target's deviation.

    The best is the shortest of those whose error is within one per cent of the smallest.
    """
    with np.errstate(all="ignore"):
        errors = [np.sqrt(np.mean((p - target) ** 2)) / np.std(target) for p in predictions]
    errors = np.nan_to_num(errors, nan=np.inf)
    close = np.flatnonzero(errors <= NEAR * errors.min())
    k = min(close, key=lambda j: lengths[j])
    return int(k), float(errors[k])


def acceleration_of(functions: Sequence[Callable[[np.ndarray], np.ndarray]]) -> Acceleration:
    """Return q̈(q, q̇, f) of one function of the inputs a coordinate; NaN where the inputs are not finite."""

    def acceleration(q, qdot, forces=None):
        columns = inputs(q, qdot, forces)
        good = np.isfinite(columns).all(axis=1)  # Operon accepts finite numbers only
        result = np.full((len(columns), len(functions)), np.nan)
        if good.any():
            result[good] = np.column_stack([function(columns[good]) for function in functions])
        return result

    return acceleration
