"""Run the numeric tests under other kernels of OpenBLAS than the one that this processor gets by itself.

    python tests/test_kernels.py Haswell Sandybridge -- -n 2 -q

The kernels round differently, so results that depend on rounding change with the processor.  The tests
marked ``thorough``, which ``make test`` leaves out, run too.  A kernel that cannot run here is left out, and
so is the processor's own; the output says which.
Which are left out, and why, is tested below.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ["api", "curve", "diagnosis", "estimation", "library", "mechanics", "model"]
FOLDERS += ["selection", "simulation", "systems"]
MODULES = ["control", "delay", "sklearn", "threads"]
_PROBE = """
import json, numpy.linalg, scipy.linalg, threadpoolctl
blas = [item for item in threadpoolctl.threadpool_info() if item["user_api"] == "blas"]
print(json.dumps([item.get("architecture") if item["internal_api"] == "openblas" else None for item in blas]))
"""


def kernels_in_use(environment: Mapping[str, str]) -> set[str | None]:
    """Kernels that the libraries of NumPy and SciPy choose; None for a BLAS that is not OpenBLAS."""
    done = subprocess.run([sys.executable, "-c", _PROBE], env=environment, capture_output=True, text=True)
    return set(json.loads(done.stdout)) if done.returncode == 0 else set()


def reason_to_skip(kernel: str, usual: set[str | None], now: set[str | None]) -> str:
    """Why a kernel is left out, given those in use without and with the choice; empty: it is not."""
    if None in usual or not usual:
        return "this NumPy or SciPy does not use OpenBLAS"
    if now != {kernel}:
        instead = ", ".join(sorted(str(name) for name in now)) or "nothing"
        return f"OpenBLAS uses {instead} instead on this processor"
    return "this processor uses it without being asked" if now == usual else ""


def main(arguments: list[str]) -> int:
    """Test every kernel; 1 if a test failed."""
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    plain = {name: value for name, value in os.environ.items() if name != "OPENBLAS_CORETYPE"}
    usual, failed = kernels_in_use(plain), []
    tests = [f"tests/{name}" for name in FOLDERS] + [f"tests/test_{name}.py" for name in MODULES]
    for kernel in arguments[:cut]:
        environment = {**plain, "OPENBLAS_CORETYPE": kernel}
        reason = reason_to_skip(kernel, usual, kernels_in_use(environment))
        if reason:
            print(f"kernel {kernel}: skipped, {reason}", flush=True)
            continue
        print(f"kernel {kernel}: numeric tests", flush=True)
        command = [sys.executable, "-m", "pytest", "-m", "not slow", *arguments[cut + 1 :], *tests]
        if subprocess.run(command, env=environment, cwd=ROOT).returncode:
            failed.append(kernel)
    if failed:
        print(f"failed under {', '.join(failed)}", flush=True)
    return int(bool(failed))


@pytest.mark.parametrize(
    ("kernel", "usual", "now", "says"),
    [
        ("Haswell", {"SkylakeX"}, {"Haswell"}, ""),
        ("Haswell", {"Haswell"}, {"Haswell"}, "without being asked"),
        ("Zen", {"SkylakeX"}, {"Haswell"}, "uses Haswell instead"),
        ("SkylakeX", {"Haswell"}, set(), "uses nothing instead"),
        ("Haswell", {None}, {None}, "does not use OpenBLAS"),
        ("Haswell", {None, "Haswell"}, {None, "Haswell"}, "does not use OpenBLAS"),
        ("Haswell", set(), set(), "does not use OpenBLAS"),
    ],
)
def test_why_a_kernel_is_left_out(kernel, usual, now, says):
    reason = reason_to_skip(kernel, usual, now)
    assert (says in reason) if says else not reason


def test_a_kernel_that_nobody_has_is_skipped_and_runs_no_test(capfd):
    assert main(["Abacus", "--", "--no-such-option"]) == 0
    assert "kernel Abacus: skipped" in capfd.readouterr().out


def test_the_kernel_asked_for_is_the_one_in_use():
    usual = kernels_in_use(os.environ)
    if None in usual or not usual:
        pytest.skip("no OpenBLAS")
    (name,) = usual
    assert kernels_in_use({**os.environ, "OPENBLAS_CORETYPE": str(name)}) == usual


def test_what_is_listed_exists():
    listed = [ROOT / "tests" / name for name in FOLDERS]
    listed += [ROOT / "tests" / f"test_{name}.py" for name in MODULES]
    assert [path for path in listed if not path.exists()] == []


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
