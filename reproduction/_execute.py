"""What happens inside the process of one run: pose, solve, score, and say where it was done."""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from types import ModuleType

import leastaction as la
from reproduction.problem import Case, pose
from reproduction.scoring import score

__all__ = [
    "ROOT",
    "commit",
    "end_with_parent",
    "execute",
    "failure",
    "machine",
    "to_json",
    "versions",
    "write",
]

ROOT = Path(__file__).resolve().parents[1]
_ALWAYS = ("numpy", "scipy", "sympy", "leastaction")
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
    wall, cpu = time.perf_counter(), time.process_time()
    solved = False
    try:
        problem = pose(case)
        wall, cpu = time.perf_counter(), time.process_time()
        answer = method.solve(problem)
        cost = {
            "wall_s": time.perf_counter() - wall,
            "cpu_s": time.process_time() - cpu,
            "peak_mb": _peak_mb(),
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


def failure(status: str, reason: str) -> dict:
    """Return the result of a run without an answer; the reason without this machine's folders."""
    for folder in (str(ROOT), sys.prefix):
        reason = reason.replace(folder, ".")
    return {"finished": False, "status": status, "reason": reason}


def record(config: Mapping, result: Mapping, method: ModuleType | None, parallel: int) -> dict:
    """Return what is kept of a run."""
    return {
        "config": dict(config),
        "result": dict(result),
        "method": {"title": getattr(method, "TITLE", None), "reference": getattr(method, "REFERENCE", None)},
        "versions": versions(),
        "machine": machine() | {"parallel_runs": parallel},
        "commit": commit(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def versions() -> dict[str, str]:
    """Versions of Python, of our packages, and of those peers that this process has loaded."""
    peers = (package for module, package in _PEERS.items() if module in sys.modules)
    return {"python": platform.python_version()} | {
        name: metadata.version(name) for name in (*_ALWAYS, *peers)
    }


def machine() -> dict:
    """What a timing depends on; nothing that names the machine."""
    processor = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {"processor": processor, "cores": os.cpu_count(), "system": platform.system()}


def commit(code: Sequence[str] = ("src", ":(glob)reproduction/**/*.py")) -> str:
    """The checked-out commit, with "+changes" if code differs from it; "" outside a repository."""
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True)
        clean = subprocess.run(["git", "status", "--porcelain", "--", *code], cwd=ROOT, capture_output=True)
    except OSError:
        return ""
    return head.stdout.strip() + ("+changes" if clean.stdout else "")


def to_json(document: Mapping) -> str:
    """JSON text of a record; numbers that are not finite become null."""
    return json.dumps(_plain(document), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value):
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "tolist"):  # NumPy arrays and scalars
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)


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


def write(path: Path, document: Mapping) -> None:
    """Write a record, all or nothing."""
    la.io.write_text(path, to_json(document))
