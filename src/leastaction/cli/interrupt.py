"""The first Ctrl-C ends a search with the best law so far, the second one the program."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from leastaction.cli.show import warn
from leastaction.errors import StopSearch

__all__ = ["stoppable"]

_SEARCHING = frozenset({"search", "select", "knots", "coarse", "confirm", "drift"})


@contextmanager
def stoppable(progress: Callable[[str, dict], None]) -> Iterator[Callable[[str, dict], None]]:
    """Give a progress function that ends the search once the user has pressed Ctrl-C."""
    asked = False

    def on_interrupt(signum, frame) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        warn("stopping with the best law so far; press Ctrl-C again to give up")

    def report(stage: str, details: dict) -> None:
        if asked and stage in _SEARCHING:
            raise StopSearch
        progress(stage, details)

    if threading.current_thread() is not threading.main_thread():  # only there can signals be handled
        yield progress
        return
    before = signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield report
    except StopSearch:  # before there was a law
        raise KeyboardInterrupt from None
    finally:
        signal.signal(signal.SIGINT, before)
