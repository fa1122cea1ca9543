"""One BLAS thread while leastaction computes.

The matrices of a fit are small or banded: a second thread gains nothing on a quiet machine, and on a busy
one the threads wait for each other. The demonstration took three times longer with two threads than with one.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

__all__ = ["single_threaded"]

_limiting = threading.Lock()  # held by the outermost call that has set the limit


@lru_cache(maxsize=1)
def _controller() -> Any:
    """The BLAS libraries of this process. To find them takes milliseconds, so it is done once.

    NumPy and SciPy bring one each; both must have been loaded to be found.
    """
    import numpy.linalg  # noqa: F401
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    with _interrupts_later():
        return ThreadpoolController()


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Hold Ctrl-C back: the search for libraries calls back from C, where an exception would be lost."""
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[tuple] = []
    signal.signal(signal.SIGINT, lambda *given: arrived.append(given))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if arrived:
        before(*arrived[0])


@contextmanager
def single_threaded() -> Iterator[None]:
    """Compute with one BLAS thread; the user's setting returns afterwards.

    A context manager and a decorator, ``@single_threaded()``. Entering and leaving takes a tenth of a
    millisecond. Without a BLAS library that threadpoolctl knows nothing happens.

    The number of threads belongs to the process. Calls may nest, and overlap in several Python threads: the
    first one sets the limit and restores what it found, so that the user's number cannot get lost. A call
    that outlives it goes on with that number, which costs time only.

    Examples
    --------
    >>> import numpy as np
    >>> with single_threaded():
    ...     float(np.ones(3) @ np.ones(3))
    3.0
    """
    if not _limiting.acquire(blocking=False):
        yield
        return
    try:
        with _controller().limit(limits=1, user_api="blas"):
            yield
    finally:
        _limiting.release()
