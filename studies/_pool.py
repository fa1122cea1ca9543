"""Worker processes that are replaced when they crash or take too long; no case is lost or run twice."""

from __future__ import annotations

import gc
import json
import os
import queue
import selectors
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from runner.machine import ROOT, end, environment, failure, last_words, stop
from runner.store import to_line
from studies.case import Case

__all__ = ["Options", "serve", "solved"]


@dataclass(frozen=True)
class Options:
    """How cases are run.

    Attributes
    ----------
    jobs : int
        Worker processes.
    timeout : float
        Seconds that one run may take.
    renew : int
        Runs after which a worker is replaced by a fresh one: SymPy's caches grow.
    worker : str
        Module that is run as a worker.
    """

    jobs: int = 1
    timeout: float = 900.0
    renew: int = 40
    worker: str = "studies._pool"


class Worker:
    """One process, started when it is first needed and again after it has ended."""

    def __init__(self, options: Options, folder: Path) -> None:
        self._options, self._log = options, folder / f"log-{id(self)}.txt"
        self._process: subprocess.Popen | None = None
        self._runs = 0
        self._lock = threading.Lock()
        self._closed = False

    def _started(self) -> subprocess.Popen:
        if self._process is not None and self._runs >= self._options.renew:
            self.end()
        return self._process or self._start()

    def _start(self) -> subprocess.Popen:
        with self._lock:
            if self._closed:
                raise InterruptedError("interrupted before the run began")
            with self._log.open("wb") as log:
                process = subprocess.Popen(
                    [sys.executable, "-m", self._options.worker],
                    cwd=ROOT,
                    env=environment(),
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    start_new_session=True,
                )
            self._process, self._runs = process, 0
        return process

    def run(self, case: Case) -> dict:
        """Return the result of a case, a failure if the process ended or took too long."""
        process = self._started()
        assert process.stdin is not None
        self._runs += 1
        try:
            process.stdin.write(json.dumps(asdict(case)).encode() + b"\n")
            process.stdin.flush()
            line = self._answer(process)
        except OSError:
            line = b""
        if line is None:
            self.end()
            return failure("timed out", f"no result after {self._options.timeout:g} s")
        if not line.endswith(b"\n"):
            code = process.wait()
            self.end()
            return failure("failed", last_words(code, self._log))
        return json.loads(line)

    def _answer(self, process: subprocess.Popen) -> bytes | None:
        """Return a line, what there is of one if the process has ended, None if it takes too long."""
        assert process.stdout is not None
        end, kept = time.monotonic() + self._options.timeout, b""
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while not kept.endswith(b"\n"):
                if not selector.select(max(0.0, end - time.monotonic())):
                    return None
                chunk = os.read(process.stdout.fileno(), 1 << 20)
                if not chunk:
                    break
                kept += chunk
        return kept

    def close(self) -> None:
        """End the process for good.

        The thread that runs it closes the pipes: one that waits for a pipe closed by another waits forever.
        """
        with self._lock:
            self._closed = True
            process = self._process
        if process is not None:
            stop(process)

    def end(self) -> None:
        """End the process and what it has started."""
        process, self._process = self._process, None
        if process is not None:
            end(process)


def solved(cases: Sequence[Case], options: Options) -> Iterator[tuple[Case, dict]]:
    """Yield (case, result) as runs end. Leaving the iteration early ends those under way."""
    waiting: queue.SimpleQueue[Case] = queue.SimpleQueue()
    for case in cases:
        waiting.put(case)
    done: queue.SimpleQueue[tuple[Case, dict]] = queue.SimpleQueue()
    stop = threading.Event()

    def attend(worker: Worker) -> None:
        while not stop.is_set():
            try:
                case = waiting.get_nowait()
            except queue.Empty:
                break
            try:
                result = worker.run(case)
            except Exception as error:  # a full disk, no more processes: a record, not a runner that hangs
                result = failure("failed", f"{type(error).__name__}: {error}")
            done.put((case, result))
        worker.end()

    with tempfile.TemporaryDirectory(prefix="studies-") as folder:
        workers = [Worker(options, Path(folder)) for _ in range(min(options.jobs, len(cases)))]
        threads = [threading.Thread(target=attend, args=(w,), daemon=True) for w in workers]
        for thread in threads:
            thread.start()
        try:
            for _ in cases:
                yield done.get()
        finally:
            stop.set()
            for worker in workers:
                worker.close()
            for thread in threads:
                thread.join()


# ------------------------------------------------------------------------------------------------- the worker
def _read(lines: queue.SimpleQueue) -> None:
    """Pass lines on, and end the process when there are no more."""
    kept = b""
    # not sys.stdin: its lock would be held when the interpreter ends
    while chunk := os.read(0, 65536):
        *whole, kept = (kept + chunk).split(b"\n")
        for line in whole:
            lines.put(line)
    os._exit(0)


def _run(case: Case) -> dict:
    from studies.solve import solve

    try:
        return {"finished": True, **solve(case)}
    except Exception as error:  # whatever a discovery raises is worth a record
        frames = traceback.extract_tb(error.__traceback__)
        where = [f"{Path(f.filename).name}:{f.lineno}" for f in frames]
        return failure("failed", f"{type(error).__name__}: {error}") | {"where": where}


def serve() -> None:
    """Run one case after another in this process: a line of JSON comes in for each, and one goes back.

    Importing SymPy takes a second, so a process serves many runs. It ends when its input does, also in the
    middle of a run: then the process that started it is gone. What a run prints goes to the error stream.
    """
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    lines: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_read, args=(lines,), daemon=True).start()
    while True:
        case = Case(**json.loads(lines.get()))
        print(f"case {case.key}", file=sys.stderr, flush=True)
        answers.write(to_line(_run(case)) + "\n")
        answers.flush()
        gc.collect()


if __name__ == "__main__":
    serve()
