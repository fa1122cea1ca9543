"""A separate process that computes, reports progress, and can be stopped at any moment.

A single SciPy call may hold the interpreter for seconds, so that a thread could not be stopped and would
block the page. The process is kept for the next job, because importing SymPy and SciPy takes as long as a
small discovery. Only a cancelled process is replaced.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from leastaction.app.columns import DATES
from leastaction.cli.text import one_line
from leastaction.errors import DataError, InputError
from leastaction.threads import single_threaded

__all__ = ["Job", "Worker", "explain", "in_words"]


class Job:
    """One job and its progress.

    Attributes
    ----------
    state : {"running", "done", "failed", "cancelled"}
    stage, details : str, dict
        Last report of the function.
    stages : list of (str, float)
        Stages so far with their start times, in seconds from the start of the job.
    result : object
        Result of the function, once done.
    message : str
        Reason of a failure, in one line.
    """

    def __init__(self) -> None:
        self.state = "running"
        self.stage, self.details = "", {}
        self.stages: list[tuple[str, float]] = []
        self.result: Any = None
        self.message: str = ""
        self._began, self._ended = time.monotonic(), 0.0

    @property
    def seconds(self) -> float:
        """Run time in seconds."""
        return (self._ended or time.monotonic()) - self._began

    def _report(self, stage: str, details: dict) -> None:
        if stage != self.stage:
            self.stages.append((stage, self.seconds))
        self.stage, self.details = stage, details

    def _end(self, state: str, result: Any = None, message: str = "") -> None:
        if self.state == "running":
            self.result, self.message, self._ended = result, message, time.monotonic()
            self.state = state  # last, because readers check it first


class Worker:
    """Runs one job at a time in a separate process."""

    def __init__(self) -> None:
        self.job: Job | None = None
        self._process: Any = None
        self._pipe: Connection | None = None
        self._lock = threading.Lock()

    @property
    def busy(self) -> bool:
        """Whether a job is running."""
        return self.job is not None and self.job.state == "running"

    def warm_up(self) -> None:
        """Start the process, so that the first job does not wait for its imports."""
        with self._lock:
            self._ready()

    def start(self, function: Callable[..., Any], *arguments: Any) -> Job:
        """Run ``function(progress, *arguments)``, after cancelling a running job.

        The function must belong to a module, which the process imports; arguments and result are pickled.
        """
        self.cancel()
        with self._lock:
            pipe = self._ready()
            job = self.job = Job()
            # Large arguments block the pipe until the process has started, so another thread sends them.
            threading.Thread(target=self._follow, args=(job, pipe, function, arguments), daemon=True).start()
        return job

    def cancel(self) -> None:
        """Stop the running job immediately, if there is one."""
        with self._lock:
            if self.busy:
                assert self.job is not None
                self.job._end("cancelled")
                self._stop()

    def close(self) -> None:
        """Stop the process."""
        self.cancel()
        with self._lock:
            self._stop()

    def _ready(self) -> Connection:
        if self._process is None or not self._process.is_alive():
            # "spawn", because a forked copy of a server with threads may hang.
            context = multiprocessing.get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(
                target=_serve, args=(theirs,), daemon=True, name="leastaction-worker"
            )
            self._process.start()
            theirs.close()
        assert self._pipe is not None
        return self._pipe

    def _stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.join()

    def _follow(self, job: Job, pipe: Connection, function: Callable[..., Any], arguments: tuple) -> None:
        try:
            pipe.send((function, arguments))
            while job.state == "running":
                kind, *rest = pipe.recv()
                if kind == "progress":
                    job._report(*rest)
                elif kind == "done":
                    job._end("done", result=rest[0])
                else:
                    job._end("failed", message=rest[0])
        except (EOFError, OSError):
            with self._lock:
                if self._pipe is pipe:
                    self._stop()  # otherwise a dying process could get the next job
            job._end("failed", message="the computation stopped unexpectedly, perhaps for want of memory")
        except Exception as error:
            # Pickling may fail in many ways; the page reports all of them.
            job._end("failed", message=explain(error))


def _serve(pipe: Connection) -> None:
    """Loop of the process until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server handles Ctrl-C
    warnings.simplefilter("ignore")  # the findings of the model contain everything relevant
    import leastaction.api
    import leastaction.simulation.forecast  # noqa: F401

    while True:
        try:
            function, arguments = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            with single_threaded():
                result = function(lambda stage, details: pipe.send(("progress", stage, details)), *arguments)
            pipe.send(("done", result))
        except (BrokenPipeError, ConnectionError):
            return
        except Exception as error:
            pipe.send(("failed", explain(error)))


def explain(error: BaseException) -> str:
    """One line about an error.

    Examples
    --------
    >>> explain(InputError("the file is empty"))
    'the file is empty'
    >>> explain(ZeroDivisionError("division by zero"))
    'no model could be computed (ZeroDivisionError: division by zero); try other candidates'
    """
    if isinstance(error, (InputError, DataError)):
        text = str(error)
    elif isinstance(error, MemoryError):
        text = "not enough memory for so many samples and candidates; use fewer of either"
    elif isinstance(error, OSError):
        text = f"{error.strerror or error}; check the disk and the rights to it"
    elif isinstance(error, (ArithmeticError, np.linalg.LinAlgError)):
        text = f"no model could be computed ({type(error).__name__}: {error}); try other candidates"
    else:
        text = f"a fault of leastaction itself: {type(error).__name__}: {error}; please report this"
    return one_line(text)


def in_words(text: str, folder: Path | None = None) -> str:
    """Translate messages, which name files and Python arguments, to the words of the page.

    Examples
    --------
    >>> in_words("/tmp/x/a.csv, line 3: sort the rows, or give the column (trial=...)", Path("/tmp/x"))
    'a.csv, line 3: sort the rows, or give the column (as the trial)'
    """
    if folder is not None:
        text = text.replace(f"{folder}/", "").replace(f"{folder}\\", "")
    text = text.replace("(trial=...)", "(as the trial)")
    text = text.replace("leave out time_unit", f"mark them as {DATES}")
    return explain(InputError(text))
