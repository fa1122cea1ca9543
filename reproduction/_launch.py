"""Runs in processes of their own, on this machine or on a Dask cluster, with a time limit."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import threading
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from reproduction._execute import record
from reproduction.problem import Case
from runner.machine import ROOT, end, environment, failure, last_words

__all__ = ["Options", "launch", "launched"]


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
