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
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from reproduction.methods._symbolic import STRIDE, acceleration_of, choose, names, samples
from reproduction.problem import Answer, Problem
from runner.machine import environment, last_words

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
