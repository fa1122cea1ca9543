"""Run a study; what has a record in studies/results/ is not run again.

    python -m studies.run structure --jobs 2
    python -m studies.run faults --setup friction-5 --noise 0.01 --trials 1

The same command goes on where it was interrupted.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path

import click
from rich.console import Console

from runner.course import carry_out
from runner.machine import ROOT, commit, machine, versions
from runner.store import Store
from studies._pool import Options, solved
from studies._tables import number
from studies.case import Case
from studies.plans import PLANS, cases

RESULTS = ROOT / "studies" / "results"
_CODE = ":(glob)studies/*.py"


@cache
def _origin() -> dict:
    # of the moment when the first run ended: a study should not be run while its code is being changed
    return {"versions": versions(), "machine": machine(), "commit": commit(_CODE)}


def record(case: Case, result: Mapping, parallel: int) -> dict:
    """Return what is kept of a run."""
    origin = _origin()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "config": case.as_dict(),
        "result": dict(result),
        **origin,
        "machine": origin["machine"] | {"parallel_runs": parallel, "load_after": load},
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def recorded(wanted: Sequence[Case], options: Options) -> Generator[tuple[Case, dict], None, None]:
    """Yield (case, record) as runs end."""
    for case, result in solved(wanted, options):
        yield case, record(case, result, options.jobs)


def _line(case: Case, result: dict) -> str:
    if not result["finished"]:
        return f"{case.key}: {result['status']}: {result['reason']}"
    if result["status"] == "no model":
        return f"{case.key}: no model: {result['reason']}"
    if case.study in ("unlisted", "names"):
        error = number(result["acceleration_error"], ".2e")
        return f"{case.key}: {result['status']}, accelerations off by {error}, {result['cpu_s']:.1f} CPU s"
    verdict = "exact" if result["exact"] else "wrong"
    return f"{case.key}: {verdict}, {result['status']}, l2 {result['l2']:.2e}, {result['wall_s']:.1f} s"


@click.command(help=__doc__.split("\n\n")[0])
@click.argument("study", type=click.Choice(list(PLANS)))
@click.option("--system", multiple=True, help="Only these; default: all of the study.")
@click.option("--noise", multiple=True, type=float)
@click.option("--setup", multiple=True)
@click.option("--library", multiple=True, type=click.Choice(["compact", "large", "auto", "symbolic"]))
@click.option("--rate", multiple=True, type=float)
@click.option("--trajectories", multiple=True, type=int)
@click.option("--trials", type=click.IntRange(1), help="Data sets a case; default: those of the study.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Runs at a time.")
@click.option("--timeout", type=float, help="Seconds a run may take; default: that of the study.")
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), default=RESULTS)
@click.option("--retry-failed", is_flag=True, help="Run those again that failed or took too long.")
@click.option("--dry-run", is_flag=True, help="Say what would be run.")
def main(study, trials, jobs, timeout, results, retry_failed, dry_run, **chosen) -> None:
    everything = cases(study, trials, **chosen)
    if not everything:
        raise click.UsageError(f"the study {study!r} has no such case; see --dry-run without other options")
    options = Options(jobs, timeout or PLANS[study].timeout)
    store = Store(results, Case.from_dict)
    carry_out(everything, store, partial(recorded, options=options), _line, Console(), retry_failed, dry_run)


if __name__ == "__main__":
    main()
