"""Processes of runs: what they are started with, how they are ended, what they said last."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

from runner.origin import ROOT

__all__ = ["end", "environment", "last_words", "stop"]

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


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
