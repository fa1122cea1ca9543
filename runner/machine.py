"""The machine of a run: how and with what it was made, without naming folders; its processes."""

from __future__ import annotations

import os
import platform
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path

__all__ = [
    "ROOT",
    "commit",
    "end",
    "environment",
    "failure",
    "last_words",
    "machine",
    "stop",
    "versions",
]

ROOT = Path(__file__).resolve().parents[1]
_ALWAYS = ("numpy", "scipy", "sympy", "leastaction")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def failure(status: str, reason: str) -> dict:
    """Return the result of a run without an answer; the reason without this machine's folders."""
    for folder in (str(ROOT), sys.prefix):
        reason = reason.replace(folder, ".")
    return {"finished": False, "status": status, "reason": reason}


def versions(peers: Mapping[str, str] | None = None) -> dict[str, str]:
    """Versions of Python, of our packages, and of those peers, module → package, that are loaded."""
    loaded = (package for module, package in (peers or {}).items() if module in sys.modules)
    return {"python": platform.python_version()} | {
        name: metadata.version(name) for name in (*_ALWAYS, *loaded)
    }


def machine() -> dict:
    """What a timing depends on."""
    processor = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {"processor": processor, "cores": os.cpu_count(), "system": platform.system()}


def commit(*code: str) -> str:
    """The checked-out commit; "+changes" if this code, src/ or runner/ differs; "" outside a repository."""
    watched: Sequence[str] = ("src", "runner", *code)
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True)
        status = ["git", "status", "--porcelain", "--", *watched]
        clean = subprocess.run(status, cwd=ROOT, capture_output=True)
    except OSError:
        return ""
    return head.stdout.strip() + ("+changes" if clean.stdout else "")


def environment() -> dict[str, str]:
    """One BLAS thread, no windows, and this folder's packages."""
    path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH", "")) if p)
    return {**os.environ, **dict.fromkeys(_THREADS, "1"), "MPLBACKEND": "Agg", "PYTHONPATH": path}


def stop(process: subprocess.Popen) -> None:
    """End a process and what it has started, if it still runs. Its pipes stay open for who reads them."""
    if process.poll() is None:
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)  # it leads a group of its own
        else:
            process.kill()
        process.wait()


def end(process: subprocess.Popen) -> None:
    """End a process, and close its pipes."""
    stop(process)
    for pipe in (process.stdin, process.stdout):
        if pipe:
            pipe.close()


def last_words(code: int, log: Path) -> str:
    """Say how a process ended, and the last line that it wrote."""
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    how = f"ended by signal {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    return f"the process {how}" + (f": {last}" if last else "")
