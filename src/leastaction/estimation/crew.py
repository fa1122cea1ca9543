"""Workers: this thread, further processes, or the workers of a Dask cluster.

A *task* is a function and its arguments, some of which may be other tasks. Its result stays where it was
computed until it is requested. A task keeps its function and arguments. If a result is lost with its worker,
another worker or this process computes it again. Functions are pure, so the result is the same.
"""

from __future__ import annotations

import asyncio
import gc
import itertools
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from leastaction.errors import InputError
from leastaction.estimation.files import Folder, Held, Shelf, read, write
from leastaction.threads import single_threaded

__all__ = ["Alone", "Crew", "DaskCrew", "ProcessCrew", "Task", "employ"]

_PATIENCE = 10.0  # seconds without any worker, after which this process computes everything
_IDLE = 300.0  # seconds, after which an idle child ends
_MEMORY_STAYS = {"MALLOC_TRIM_THRESHOLD_": str(2**28), "MALLOC_MMAP_THRESHOLD_": str(2**25)}
"""For glibc in a child: keep freed memory. Returning it after each block took 15 % of the time."""
_MOST_STARTS = 3  # of the children of one discovery, after which this process computes everything
_FEEDER_ENDS = 5.0  # seconds to wait for the thread that feeds the children
_LOOK = 1.0  # seconds between two checks of the cluster or of the parent


@dataclass(eq=False)
class Task:
    """A function of arguments that may be tasks, and the future of its result.

    Attributes
    ----------
    function : callable
        Pure.
    given : tuple
        Its arguments.
    future : object or None
        Of the executor; None if this process computes the result.
    """

    function: Callable[..., Any]
    given: tuple[Any, ...]
    future: Any = None
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)
    _done: list[Any] = field(default_factory=list[Any], repr=False)

    def here(self) -> Any:
        """Compute the result and the tasks that it depends on in this process; cached."""
        with self._lock:
            if not self._done:
                given = [x.here() if isinstance(x, Task) else x for x in self.given]
                self._done.append(_quietly(self.function, *given))
            return self._done[0]


class Crew(Protocol):
    """Computes tasks; ``size`` is the number of workers."""

    keeps: bool
    size: int

    def task(self, function: Callable[..., Any], *given: Any) -> Task:
        """Start a task; arguments may be other tasks of this crew."""
        ...

    def results(self, tasks: Sequence[Task]) -> list[Any]:
        """Wait for results. Exceptions of the functions are raised here."""
        ...

    def held(self, value: Any) -> Any:
        """A handle of a value that many tasks take as an argument."""
        ...

    def shelf(self) -> Shelf | None:
        """A file for an array that a task writes; None if the workers do not share a disk."""
        ...


class Alone:
    """The calling thread: a task is computed when its result is requested."""

    keeps: bool = False
    size: int = 1

    def __init__(self) -> None:
        self._folder = Folder()

    def task(self, function: Callable[..., Any], *given: Any) -> Task:
        return Task(function, given)

    def results(self, tasks: Sequence[Task]) -> list[Any]:
        return [task.here() for task in tasks]

    def held(self, value: Any) -> Any:
        return value

    def shelf(self) -> Shelf | None:
        return Shelf.of(self._folder.new_path())


class ProcessCrew:
    """Processes on this machine, started with the first task.

    Threads would wait for each other: an operation on a block takes 20 to 100 µs, as long as passing on the
    lock of the interpreter. A child imports only `leastaction`, not the user's program, which therefore needs
    no ``if __name__ == "__main__"`` guard. If a child is killed, this process computes the missing results,
    and the next task starts new children.

    Large arguments and results pass through files in a temporary folder, which takes a fraction of the time
    of a pipe. No task is an argument of another one.

    Parameters
    ----------
    workers : int
    joins : bool
        Whether this process is one of them. It then takes tasks in turn, and there is one child less. Until a
        child has begun, which takes a second, it takes all tasks.

    Attributes
    ----------
    keeps : bool
        Whether workers keep blocks of long recordings, because they have memory of their own.
    """

    keeps = False

    def __init__(self, workers: int, joins: bool = False) -> None:
        self.size, self._starts_left, self._children = workers, _MOST_STARTS, workers - joins
        self._joins, self._turns = joins, itertools.cycle([joins, *[False] * (workers - 1)])
        self._pool: Any = None  # of loky, which has no types
        self._begun: Any = None  # if this process joins: a future that is done once a child has begun
        self._folder = Folder()

    def task(self, function: Callable[..., Any], *given: Any) -> Task:
        task = Task(function, given)
        if next(self._turns):
            return task
        try:
            pool = self._started()
            if pool is not None and (self._begun is None or self._begun.done()):
                path = self._folder.new_path()
                task.future = pool.submit(_to_file, path, function, *given), path
        except (RuntimeError, OSError, ImportError):  # a child was killed, or the system allows no processes
            self._pool = None
        return task

    def results(self, tasks: Sequence[Task]) -> list[Any]:
        for task in tasks:  # the own ones first: the children compute theirs meanwhile
            if task.future is None:
                task.here()
        return [self._result(task) for task in tasks]

    def held(self, value: Any) -> Any:
        return Held.write(value, self._folder.new_path()) if self._starts_left else value

    def shelf(self) -> Shelf | None:
        return Shelf.of(self._folder.new_path())

    def close(self) -> None:
        """End the processes. Older fits then compute in this process."""
        if self._pool is not None:
            feeder = getattr(getattr(self._pool, "_call_queue", None), "_thread", None)
            self._pool.shutdown(wait=True, kill_workers=True)
            if feeder is not None:  # the end of the program would cut it off and report a leaked semaphore
                feeder.join(_FEEDER_ENDS)
        self._folder.close()
        self._pool, self._starts_left = None, 0

    def _started(self) -> Any:
        if self._pool is None and self._starts_left:
            self._starts_left -= 1
            self._pool = import_module("loky").ProcessPoolExecutor(
                self._children,
                timeout=_IDLE,
                initializer=_begin_child,
                initargs=(os.getpid(),),
                env=_MEMORY_STAYS,
            )
            self._begun = self._pool.submit(int) if self._joins else None
        return self._pool

    def begin(self) -> None:
        """Start the children, which import while this process prepares the data."""
        with suppress(RuntimeError, OSError, ImportError):
            self._started()

    def _result(self, task: Task) -> Any:
        if task.future is None:
            return task.here()
        future, path = task.future
        try:
            future.result()
            out = read(path)
        except (BrokenExecutor, OSError):
            self._pool = None
            return task.here()
        path.unlink()
        return out


class DaskCrew:
    """The workers of a Dask cluster, by a ``distributed.Client`` that belongs to the caller.

    Dask repeats the tasks of a lost worker. If no worker is left, or the scheduler is lost, this process
    computes the results.
    """

    keeps = True

    def __init__(self, client: Any) -> None:
        self._client, self._alone = client, False
        self.size: int = max(len(self._workers()), 1)

    def task(self, function: Callable[..., Any], *given: Any) -> Task:
        task = Task(function, given)
        away = [x.future if isinstance(x, Task) else x for x in given]
        if self._alone or any(x is None for x, y in zip(away, given, strict=True) if isinstance(y, Task)):
            return task
        try:
            with _large_arguments():
                # pure=False saves the time of hashing arrays
                task.future = self._client.submit(_quietly, function, *away, pure=False)
        except Exception:  # the client is closed, or its scheduler is lost
            self._alone = True
        return task

    def results(self, tasks: Sequence[Task]) -> list[Any]:
        return [self._result(task) for task in tasks]

    def held(self, value: Any) -> Any:
        return value

    def shelf(self) -> Shelf | None:
        return None

    def _result(self, task: Task) -> Any:
        if task.future is None:
            return task.here()
        waited = 0.0
        while not self._alone:
            try:
                return task.future.result(timeout=_LOOK)
            except TimeoutError:
                waited = 0.0 if self._anybody() else waited + _LOOK
                self._alone = waited > _PATIENCE
            except (Exception, asyncio.CancelledError) as error:
                if not _is_loss(error):
                    raise
                break
        return task.here()

    def _anybody(self) -> bool:
        """Whether the cluster has any worker."""
        try:
            return bool(self._workers())
        except Exception:
            return False

    def _workers(self) -> Any:
        return self._client.scheduler_info(n_workers=-1)["workers"]


@contextmanager
def employ(workers: Any, joins: bool = False) -> Generator[Crew | None, None, None]:
    """The crew for the argument ``workers``: None for one worker, which is this thread.

    Parameters
    ----------
    workers : int, distributed.Client or None
    joins : bool
        Whether this process is one of several workers.

    Raises
    ------
    InputError
    """
    if workers is None or (isinstance(workers, int) and not isinstance(workers, bool) and workers == 1):
        yield None
    elif isinstance(workers, int) and not isinstance(workers, bool) and workers >= 1:
        crew = ProcessCrew(min(workers, 4 * (os.cpu_count() or 1)), joins)
        if joins:
            crew.begin()
        try:
            yield crew
        finally:
            crew.close()
    elif hasattr(workers, "submit") and hasattr(workers, "scheduler_info"):
        yield DaskCrew(workers)
    else:
        raise InputError(
            f"workers is {workers!r}; expected a number of processes, 1 or more, or a Client of Dask "
            "(distributed.Client)"
        )


def _to_file(path: Path, function: Callable[..., Any], *given: Any) -> None:
    """In a child: compute the result and write it to a file."""
    write(_quietly(function, *given), path)


def _begin_child(parent: int) -> None:
    """In a child, before its first task."""
    import_module("leastaction.estimation.streamed")  # before gc.freeze
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    _always.enter_context(single_threaded())
    gc.freeze()  # loky collects garbage every second, which took a tenth of the time


def _end_with(parent: int) -> None:
    """In a child: exit when the parent has ended; otherwise a child would wait for ever within a message."""
    while os.getppid() == parent:
        time.sleep(_LOOK)
    os._exit(1)


_always = ExitStack()  # contexts that last as long as a child


def _large_arguments() -> AbstractContextManager[Any]:
    """Silence Dask's warning of arguments above 10 MB: the data of a block are larger and sent once."""
    try:
        config = import_module("dask.config")
    except ImportError:  # another client with the same methods
        return nullcontext()
    return config.set({"distributed.admin.large-graph-warning-threshold": "1 TB"})


def _quietly(function: Callable[..., Any], *given: Any) -> Any:
    """Compute with one BLAS thread and without warnings of overflow, as the solver does."""
    with single_threaded(), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return function(*given)


def _is_loss(error: BaseException) -> bool:
    """Whether Dask reports that a result is lost, and not that its function failed."""
    if isinstance(error, (asyncio.CancelledError, CancelledError, OSError)):
        return True
    return type(error).__module__.partition(".")[0] == "distributed"
