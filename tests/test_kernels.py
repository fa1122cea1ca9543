"""Run the numeric tests under other kernels of OpenBLAS than the one that this processor gets by itself.

    python tests/test_kernels.py Haswell Sandybridge -- -n 2 -q

The kernels round differently, so results that depend on rounding change with the processor.  The tests
marked ``thorough``, which ``make test`` leaves out, run too.  A kernel that cannot run here is left out, and
so is the processor's own; the output says which.

Tested here: which are left out, and why; and that numerics use one BLAS thread, and the user's number after.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import leastaction as la
from leastaction import systems
from leastaction.threads import _interrupts_later, single_threaded

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ["api", "curve", "diagnosis", "estimation", "hidden", "library", "mechanics", "model"]
FOLDERS += ["selection", "simulation", "systems"]
MODULES = ["kernels", "package", "sklearn"]
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


def test_every_thorough_test_runs_somewhere():
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\ntest-kernels:")[2]
    once = [word for word in recipe.partition("\n\n")[0].split() if word.startswith("tests/")]
    run = {f"tests/{name}" for name in FOLDERS} | {f"tests/test_{name}.py" for name in MODULES} | {*once}
    for path in (ROOT / "tests").rglob("test_*.py"):
        if "pytest.mark.thorough" in path.read_text(encoding="utf-8") and path != Path(__file__):
            name = path.relative_to(ROOT).as_posix()
            assert name in run or path.parent.relative_to(ROOT).as_posix() in run, name


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))


# ------------------------------------------------ one BLAS thread inside, the user's number again afterwards
def blas_threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


@pytest.fixture
def two():
    """BLAS with two threads, which the tests must find again."""
    if not blas_threads():
        pytest.skip("no BLAS that threadpoolctl knows")
    with threadpool_limits(2, user_api="blas"):
        if set(blas_threads()) != {2}:
            pytest.skip("this BLAS has one thread only")
        yield
        assert set(blas_threads()) == {2}


@pytest.mark.usefixtures("two")
def test_nested():
    with single_threaded():
        with single_threaded():
            assert set(blas_threads()) == {1}
        assert set(blas_threads()) == {1}
    assert set(blas_threads()) == {2}


@pytest.mark.usefixtures("two")
def test_left_by_an_error():
    @single_threaded()
    def fails():
        raise ZeroDivisionError(blas_threads())

    with pytest.raises(ZeroDivisionError) as raised:
        fails()
    assert set(raised.value.args[0]) == {1}
    assert set(blas_threads()) == {2}


@pytest.mark.usefixtures("two")
@pytest.mark.parametrize("outlives", [False, True])
def test_calls_that_overlap_leave_the_number_of_the_user(outlives):
    entered, leave = threading.Event(), threading.Event()

    @single_threaded()
    def other():
        entered.set()
        leave.wait(10)

    thread = threading.Thread(target=other)
    with single_threaded():
        thread.start()
        assert entered.wait(10)
        if not outlives:
            leave.set()
            thread.join()
        assert set(blas_threads()) == {1}
    assert set(blas_threads()) == {2}
    leave.set()
    thread.join()


@pytest.mark.usefixtures("two")
def test_discover_and_simulate_compute_with_one_thread():
    data = systems.generate("single_pendulum", noise=0.01, trials=1, duration=3.0, rate=50.0)
    seen = {}
    model = la.discover(
        data,
        ["theta_dot**2", "cos(theta)"],
        progress=lambda stage, details: seen.setdefault(stage, blas_threads()),
    )
    assert {"prepare", "search", "verify"} <= seen.keys()
    assert all(set(threads) == {1} for threads in seen.values())
    inside: list[int] = []

    def forces(t):
        inside.extend(blas_threads())
        return np.zeros(1)

    model.simulate([0.3], [0.0], np.linspace(0.0, 0.1, 3), forces)
    assert set(inside) == {1}


def test_the_decorated_function_keeps_its_name_and_signature():
    assert la.discover.__name__ == "discover"
    assert "trajectories" in la.discover.__wrapped__.__code__.co_varnames


@pytest.fixture
def interruptible():
    """Ctrl-C raises KeyboardInterrupt, even where whoever started the tests ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_is_held_back_and_not_lost():
    """The search for BLAS libraries calls back from C: an exception raised there would be ignored."""
    before, steps = signal.getsignal(signal.SIGINT), []

    def interrupted() -> None:
        with _interrupts_later():
            signal.raise_signal(signal.SIGINT)
            steps.append("inside")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert steps == ["inside"]
    assert signal.getsignal(signal.SIGINT) is before
