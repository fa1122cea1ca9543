"""Run a study; what has a record in studies/results/ is not run again.

    python -m studies.run structure --jobs 2
    python -m studies.run faults --setup friction-5 --noise 0.01 --trials 1

The same command goes on where it was interrupted.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

from studies._pool import Options, solved
from studies._record import ROOT, record, write
from studies.case import Case
from studies.plans import PLANS, cases

RESULTS = ROOT / "studies" / "results"
_PLAIN = {"markup": False, "highlight": False, "soft_wrap": True}  # one line is one line


def path_of(case: Case, results: Path) -> Path:
    return results / f"{case.key}.json"


def open_cases(all_cases: Sequence[Case], results: Path, retry_failed: bool = False) -> list[Case]:
    """Return the cases without a record, or, if wished, also those whose record is of a failure."""

    def is_open(case: Case) -> bool:
        path = path_of(case, results)
        if not path.exists():
            return True
        return retry_failed and not json.loads(path.read_text(encoding="utf-8"))["result"]["finished"]

    return [case for case in all_cases if is_open(case)]


def run(wanted: Sequence[Case], results: Path, options: Options, console: Console) -> int:
    """Run cases, write their records as they come, and return how many failed."""
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "left", TimeRemainingColumn())
    failed = 0
    with Progress(*columns, console=console, speed_estimate_period=3600.0) as progress:
        task = progress.add_task("", total=len(wanted))
        for case, result in solved(wanted, options):
            write(path_of(case, results), record(case, result, options.jobs))
            failed += not result["finished"]
            progress.console.print(_line(case, result), **_PLAIN)
            progress.advance(task)
    return failed


def _line(case: Case, result: dict) -> str:
    if not result["finished"]:
        return f"{case.key}: {result['status']}: {result['reason']}"
    if result["status"] == "no model":
        return f"{case.key}: no model: {result['reason']}"
    verdict = "exact" if result["exact"] else "wrong"
    return f"{case.key}: {verdict}, {result['status']}, l2 {result['l2']:.2e}, {result['wall_s']:.1f} s"


@click.command(help=__doc__.split("\n\n")[0])
@click.argument("study", type=click.Choice(list(PLANS)))
@click.option("--system", multiple=True, help="Only these; default: all of the study.")
@click.option("--noise", multiple=True, type=float)
@click.option("--setup", multiple=True)
@click.option("--library", multiple=True, type=click.Choice(["compact", "large"]))
@click.option("--rate", multiple=True, type=float)
@click.option("--trials", type=click.IntRange(1), help="Data sets a case; default: those of the study.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Runs at a time.")
@click.option("--timeout", type=float, help="Seconds a run may take; default: that of the study.")
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), default=RESULTS)
@click.option("--retry-failed", is_flag=True, help="Run those again that failed or took too long.")
@click.option("--dry-run", is_flag=True, help="Say what would be run.")
def main(study, trials, jobs, timeout, results, retry_failed, dry_run, **chosen) -> None:
    console = Console()
    everything = cases(study, trials, **chosen)
    if not everything:
        raise click.UsageError(f"the study {study!r} has no such case; see --dry-run without other options")
    wanted = open_cases(everything, results, retry_failed)
    console.print(f"{len(everything)} cases, {len(everything) - len(wanted)} of them done already")
    if dry_run:
        for case in wanted:
            console.print(case.key, **_PLAIN)
        return
    try:
        failed = run(wanted, results, Options(jobs, timeout or PLANS[study].timeout), console)
    except KeyboardInterrupt:
        left = len(open_cases(everything, results, retry_failed))
        console.print(f"interrupted; {left} cases are left: the same command goes on")
        sys.exit(130)
    console.print(f"{len(wanted) - failed} finished, {failed} failed; records in {results / study}", **_PLAIN)


if __name__ == "__main__":
    main()
