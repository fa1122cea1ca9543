"""What becomes of errors and of Ctrl-C: one line on stderr and an exit code, never a traceback."""

from __future__ import annotations

import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

from leastaction.cli.show import warn
from leastaction.cli.text import in_options, one_line
from leastaction.errors import DataError, InputError, StopSearch

__all__ = ["EXIT_CODES", "PIPE_CLOSED", "Interrupted", "give_up", "stoppable"]

_SEARCHING = frozenset({"search", "select", "knots", "coarse", "confirm", "drift"})
DONE, NO_MODEL, WRONG_USE, FAULT, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 70, 130, 141
EXIT_CODES = {
    DONE: "done; also if the model is doubtful, or if one Ctrl-C ended its search early",
    NO_MODEL: "the data do not support any model, or a motion cannot be followed to the end",
    WRONG_USE: "wrong use, or a file that cannot be read or written",
    FAULT: "an internal error",
    INTERRUPTED: "interrupted: nothing was written",
    PIPE_CLOSED: "the reader of the output has stopped",
}
"""Exit code of every command -> what it means, as in ``leastaction --help`` and ``docs/cli.md``."""
_NUMERICAL = ("LinAlgError", "FloatingPointError", "OverflowError", "ZeroDivisionError")


class Interrupted(Exception):
    """The user, or the reader of the output, has had enough."""

    def __init__(self, code: int = INTERRUPTED) -> None:
        super().__init__(code)
        self.code = code


def give_up(error: Exception) -> int:
    """Tell the user what went wrong, and return the exit code.

    With LEASTACTION_DEBUG=1 in the environment the traceback is shown as well.
    """
    if isinstance(error, Interrupted) and error.code != INTERRUPTED:
        # Nobody reads on; without this Python complains when it flushes stdout at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return error.code
    code, message = _explain(error)
    if os.environ.get("LEASTACTION_DEBUG", "0") not in ("", "0"):
        click.echo("".join(traceback.format_exception(error)), err=True, nl=False)
    click.secho(f"error: {one_line(message)}" if code != INTERRUPTED else message, err=True, fg="red")
    return code


def _explain(error: Exception) -> tuple[int, str]:
    name = type(error).__name__
    if isinstance(error, (Interrupted, click.Abort)):
        return INTERRUPTED, EXIT_CODES[INTERRUPTED]
    if isinstance(error, click.UsageError):
        where = error.ctx.command_path if error.ctx else "leastaction"
        return WRONG_USE, f"{error.format_message()} (see '{where} --help')"
    if isinstance(error, click.ClickException):
        return WRONG_USE, error.format_message()
    if isinstance(error, InputError):
        return WRONG_USE, in_options(str(error))
    if isinstance(error, DataError):
        return NO_MODEL, in_options(str(error))
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename is not None else ""
        return WRONG_USE, f"{where}{error.strerror or error}; check the path and the rights to it"
    if isinstance(error, MemoryError):
        return NO_MODEL, "not enough memory for so many samples and candidates; use fewer of either"
    if name in _NUMERICAL:
        return NO_MODEL, f"no model could be computed from these data ({name}: {error}); try other candidates"
    report = "please report this, with the command and LEASTACTION_DEBUG=1 for the traceback"
    return FAULT, f"a fault of leastaction itself: {name}: {error}; {report}"


@contextmanager
def stoppable(progress: Callable[[str, dict], None]) -> Iterator[Callable[[str, dict], None]]:
    """Give a progress function that ends the search, with the best law so far, after the first Ctrl-C.

    The second one ends the program.
    """
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
