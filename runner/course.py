"""From cases to records: what is done already, what is run, and what is said of it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from typing import TypeVar

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

from leastaction import InputError
from runner.store import Case, RecordError, Store

__all__ = ["carry_out", "open_cases", "say"]

C = TypeVar("C", bound=Case)
Outcomes = Generator[tuple[C, dict], None, None]  # a case and its record


def say(console: Console, text: str) -> None:
    """Print a line as it is: without colours, in one piece."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def open_cases(cases: Sequence[C], store: Store, retry_failed: bool = False) -> list[C]:
    """Return the cases without a record, or, if wished, also those whose record is of a failure."""
    parts = dict.fromkeys(case.part for case in cases)
    records = store.read(*parts) if parts else []
    done = {store.key(r) for r in records if r["result"]["finished"] or not retry_failed}
    return [case for case in cases if case.key not in done]


def carry_out(
    cases: Sequence[C],
    store: Store,
    outcomes: Callable[[list[C]], Outcomes],
    line: Callable[[C, dict], str],
    console: Console,
    retry_failed: bool = False,
    dry_run: bool = False,
) -> list[dict]:
    """Run the cases that are open, keep their records as they come, and return them.

    Parameters
    ----------
    outcomes : callable
        Runs cases and yields each with its record when it has ended; when closed, ends those under way.
    line : callable
        ``line(case, result)`` is printed of each run.
    dry_run : bool
        Only print the names of the open cases.

    An interrupt and a disk that cannot be written end the program, with exit codes 130 and 2.
    """
    try:
        if not dry_run:
            store.tidy(*dict.fromkeys(case.part for case in cases))
        wanted = open_cases(cases, store, retry_failed)
        console.print(f"{len(cases)} cases, {len(cases) - len(wanted)} of them done already")
        if dry_run:
            for case in wanted:
                say(console, case.key)
            return []
        records = _kept(wanted, store, outcomes, line, console)
    except KeyboardInterrupt:
        left = len(open_cases(cases, store, retry_failed))
        console.print(f"interrupted; {left} cases are left: the same command goes on")
        sys.exit(130)
    except (OSError, InputError) as error:
        say(console, f"the runs have ended early: {error}; the same command goes on")
        sys.exit(2)
    except RecordError as error:
        raise click.ClickException(str(error)) from None
    failed = sum(not r["result"]["finished"] for r in records)
    say(console, f"{len(records) - failed} finished, {failed} failed; records in {store.folder}")
    return records


def _kept(
    wanted: list[C],
    store: Store,
    outcomes: Callable[[list[C]], Outcomes],
    line: Callable[[C, dict], str],
    console: Console,
) -> list[dict]:
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "left", TimeRemainingColumn())
    records = []
    try:
        with (
            Progress(*columns, console=console, speed_estimate_period=3600.0) as progress,
            closing(outcomes(wanted)) as ended,
        ):
            task = progress.add_task("", total=len(wanted))
            for case, record in ended:
                store.append(record)
                records.append(record)
                say(progress.console, line(case, record["result"]))
                progress.advance(task)
    finally:
        store.tidy(*dict.fromkeys(case.part for case in wanted))
    return records
