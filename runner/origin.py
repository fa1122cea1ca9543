"""How and with what a run was made, without anything that names the machine or its folders."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path

__all__ = ["ROOT", "commit", "failure", "machine", "versions"]

ROOT = Path(__file__).resolve().parents[1]
_ALWAYS = ("numpy", "scipy", "sympy", "leastaction")


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
