"""Runs in the Python of uDSR, which knows nothing of this package: (X, y) in a folder → a Pareto front.

    $UDSR_PYTHON _udsr_worker.py FOLDER

reads ``task.npz`` (X, y) and ``settings.json``, and writes ``result.json``. It ends when its standard input
is closed, which is when the process that started it is gone.
"""

from __future__ import annotations

import collections
import collections.abc
import json
import os
import sys
import threading
import time
from pathlib import Path

import numpy as np


def main(folder: Path) -> None:
    end_with_parent()
    settings = json.loads((folder / "settings.json").read_text(encoding="utf-8"))
    with np.load(folder / "task.npz") as arrays:
        data = arrays["X"], arrays["y"]
    result = run(data, settings)
    (folder / "result.json").write_text(json.dumps(result), encoding="utf-8")


def run(data, settings: dict) -> dict:
    """Train step by step until it is done or has used its seconds of the processor."""
    if not hasattr(collections, "Mapping"):  # the released code uses the name that Python 3.10 took away
        collections.Mapping = collections.abc.Mapping
    from dso import DeepSymbolicOptimizer
    from dso.config import load_config
    from dso.program import Program

    if settings["repair"]:
        repair()
    config = load_config({"task": {"task_type": "regression"}})
    for part, values in settings["config"].items():
        config[part].update(values)
    config["task"]["dataset"] = data
    model = DeepSymbolicOptimizer(config)
    model.setup()
    began, steps = time.process_time(), 0
    while not model.trainer.done and time.process_time() - began < settings["seconds"]:
        model.train_one_step()
        steps += 1
    best = model.trainer.p_r_best
    return {
        "best": described(best),
        "front": [described(program) for program in front([*Program.cache.values(), best])],
        "steps": steps,
        "evaluated": int(model.trainer.nevals),
        "peak_mb": peak_mb(),
        "versions": versions(),
    }


def repair() -> None:
    """Let an individual of the genetic programming be what crossover and mutation have made of it.

    As released, its tokens are those with which it was made, so that variation changes no reward.
    """
    from dso.gp import utils

    utils.Individual.tokenized_repr = property(utils.DEAP_to_tokens)


def front(programs) -> list:
    """Return the programs of which no simpler one has as large a reward."""
    rated = [p for p in programs if "r" in p.__dict__ and not p.invalid]
    best, kept = float("-inf"), []
    for program in sorted(rated, key=lambda p: (p.complexity, -p.r)):
        if program.r > best:
            best = program.r
            kept.append(program)
    return kept


def described(program) -> dict:
    """Return reward, complexity and expression, in prefix order and with all digits of its constants."""
    tokens = [told(token) for token in program.traversal]
    return {"reward": float(program.r), "complexity": float(program.complexity), "tokens": tokens}


def told(token):
    """Return a token in JSON: the place of an input, a number, a polynomial, or the name of a function."""
    if token.input_var is not None:
        return {"input": int(token.input_var)}
    if token.name == "const":
        return float(np.ravel(token.value)[0])
    if token.name == "poly":
        exponents = np.asarray(token.exponents, dtype=int).tolist()
        return {"exponents": exponents, "coefficients": np.ravel(token.coef).astype(float).tolist()}
    return token.name


def versions() -> dict:
    """Return the versions of Python and of the packages on which the networks run."""
    there = {name: sys.modules[name] for name in ("torch", "tensorflow", "numpy") if name in sys.modules}
    found = {name: str(module.__version__) for name, module in there.items()}
    return {"python": sys.version.split()[0], **found}


def peak_mb() -> float:
    """Largest resident memory of this process so far."""
    import resource

    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(size / 1e6 if sys.platform == "darwin" else size * 1024 / 1e6, 1)


def end_with_parent() -> None:
    """As in `reproduction._execute`, which the Python of uDSR cannot import."""

    def wait() -> None:
        while os.read(0, 1024):
            pass
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
