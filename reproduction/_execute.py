"""What happens inside the process of one run: pose, solve, score, and say where it was done."""

from __future__ import annotations

import os
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType

from reproduction.problem import Case, pose
from reproduction.scoring import score
from runner.machine import commit, failure, machine, versions

__all__ = ["end_with_parent", "execute", "record"]

_CODE = ":(glob)reproduction/**/*.py"
# module → package whose version is noted if the run has loaded it
_PEERS = {
    "pysindy": "pysindy",
    "pyoperon": "pyoperon",
    "sklearn": "scikit-learn",
    "torch": "torch",
    "jax": "jax",
    "pysr": "pysr",
}


def execute(case: Case, method: ModuleType, parallel: int = 1) -> dict:
    """Solve one case and return its record; whatever a method raises becomes a record too."""
    before = {"load_before": _load(), "start_mb": _peak_mb()}
    wall, cpu = time.perf_counter(), _cpu()
    solved = False
    try:
        problem = pose(case)
        wall, cpu = time.perf_counter(), _cpu()
        answer = method.solve(problem)
        cost = {
            "wall_s": time.perf_counter() - wall,
            "cpu_s": _cpu() - cpu,
            "peak_mb": round(_peak_mb() + answer.child_mb, 1),
        }
        solved = True
        scores = score(problem, answer)
    except Exception as error:
        result = failure("failed", f"{type(error).__name__}: {error}".splitlines()[0])
        frames = traceback.extract_tb(error.__traceback__)
        result |= {"where": [f"{Path(f.filename).name}:{f.lineno}" for f in frames]}
        result |= cost if solved else {"wall_s": time.perf_counter() - wall, "peak_mb": _peak_mb()}
        return record(case.as_dict(), before | result, method, parallel)
    found = {
        "coefficients": answer.coefficients,
        "errors": answer.errors,
        "expression": answer.expression,
        "settings": answer.settings,
    }
    result = {"finished": True, "status": answer.status, **scores, **cost, **before, **found}
    return record(case.as_dict(), result, method, parallel)


def record(config: Mapping, result: Mapping, method: ModuleType | None, parallel: int) -> dict:
    """Return what is kept of a run."""
    return {
        "config": dict(config),
        "result": dict(result),
        "method": {"title": getattr(method, "TITLE", None), "reference": getattr(method, "REFERENCE", None)},
        "versions": versions(_PEERS),
        "machine": machine() | {"parallel_runs": parallel},
        "commit": commit(_CODE),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _peak_mb() -> float:
    """Largest resident memory of this process so far, in MB.

    On Linux from the kernel's record of the program itself: ru_maxrss also counts what the starting process
    held before it became this one.
    """
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        kilobytes = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        import resource

        size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        kilobytes = size / 1024 if sys.platform == "darwin" else size
    return round(kilobytes * 1024 / 1e6, 1)


def _cpu() -> float:
    """Seconds of the processor that this process has used, and those that it started and that have ended."""
    spent = os.times()
    return time.process_time() + spent.children_user + spent.children_system


def _load() -> float | None:
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def end_with_parent() -> None:
    """End this process when the one that started it is gone, however it went: its pipe is then closed."""

    def wait() -> None:
        # not sys.stdin: its lock would be held when the interpreter ends
        while os.read(0, 1024):
            pass
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
