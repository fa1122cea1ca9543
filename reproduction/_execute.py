"""A run: what happens inside its process, and how processes are started here or on a Dask cluster."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType

from reproduction.problem import Case, pose
from reproduction.scoring import score
from runner.machine import ROOT, commit, end, environment, failure, last_words, machine, versions

# ------------------------------------------ inside the process: pose, solve, score, and say where it was done
__all__ = ["Options", "end_with_parent", "execute", "launch", "launched", "record"]

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


# ------------------------------------------------------------------ processes of their own, with a time limit
@dataclass(frozen=True)
class Options:
    """How cases are run.

    Attributes
    ----------
    jobs : int
        Runs at a time on this machine; noted in the records only, with a cluster.
    scheduler : str
        Address of a Dask scheduler; "": this machine.
    timeout : float
        Seconds from the start to the end of a run's process.
    methods : str
        Module with ``NAMES`` and ``load(name)``.
    """

    jobs: int = 1
    scheduler: str = ""
    timeout: float = 3600.0
    methods: str = "reproduction.methods"


class _Running:
    """The processes that this one has started, so that an interrupt can end them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._processes: set[subprocess.Popen] = set()
        self._stopped = False

    @contextmanager
    def start(self, command: list[str], **how) -> Iterator[subprocess.Popen]:
        with self._lock:
            if self._stopped:
                raise InterruptedError("interrupted before the run began")
            process = subprocess.Popen(command, **how)
            self._processes.add(process)
        try:
            yield process
        finally:
            end(process)
            with self._lock:
                self._processes.discard(process)

    def stop(self) -> None:
        with self._lock:
            self._stopped = True
            for process in self._processes:
                end(process)


def launch(case: Case, options: Options, running: _Running | None = None) -> dict:
    """Run one case in a fresh process and return its record, also if it crashes or takes too long."""
    with tempfile.TemporaryDirectory(prefix="reproduction-") as folder:
        target, log = Path(folder) / "record.json", Path(folder) / "log.txt"
        command = [sys.executable, "-m", "reproduction.run", "--one", json.dumps(asdict(case))]
        command += ["--record", str(target), "--methods-from", options.methods, "--jobs", str(options.jobs)]
        with log.open("wb") as stream:
            how = {"cwd": ROOT, "env": environment(), "stdout": stream, "stderr": stream}
            how |= {"stdin": subprocess.PIPE, "start_new_session": True}
            with (running or _Running()).start(command, **how) as process:
                try:
                    process.wait(options.timeout)
                    late = False
                except subprocess.TimeoutExpired:
                    late = True
        if target.exists():
            return json.loads(target.read_text(encoding="utf-8"))
        if late:
            result = failure("timed out", f"no result after {options.timeout:g} s")
        else:
            result = failure("failed", last_words(process.returncode, log))
    return record(case.as_dict(), result, None, options.jobs)


def launched(cases: Sequence[Case], options: Options) -> Generator[tuple[Case, dict], None, None]:
    """Run cases and yield (case, record) as they end; every case once.

    A Dask worker that dies gives its cases to the others; a case that takes several workers with it becomes a
    record of a failure. Leaving the iteration early ends the runs that are under way on this machine.
    """
    running = _Running()
    with _executor(options) as executor:
        if options.scheduler:
            futures = {executor.submit(launch, case, options): case for case in cases}
        else:
            futures = {executor.submit(launch, case, options, running): case for case in cases}
        try:
            for future in as_completed(futures):
                case = futures.pop(future)
                outcome = _outcome(future, case, options)
                # A result that nobody refers to is not computed again when the worker that holds it dies.
                del future
                yield case, outcome
        finally:
            for future in futures:
                future.cancel()
            running.stop()


def _outcome(future: Future, case: Case, options: Options) -> dict:
    if future.cancelled():
        raise ConnectionError("the scheduler has gone away")
    error = future.exception()
    if error is None:
        return future.result()
    result = failure("failed", f"{type(error).__name__}: {error}".splitlines()[0])
    return record(case.as_dict(), result, None, options.jobs)


@contextmanager
def _executor(options: Options) -> Iterator[Executor]:
    """Threads that wait for processes here, or on the workers of a cluster: one interface for both."""
    if not options.scheduler:
        with ThreadPoolExecutor(options.jobs) as executor:
            yield executor
        return
    from distributed import Client

    with Client(options.scheduler, set_as_default=False) as client:
        yield client.get_executor(pure=False)
