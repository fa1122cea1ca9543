"""Run a study; what has a record in studies/results/ is not run again.

    python -m studies.run structure --jobs 2
    python -m studies.run faults --setup friction-5 --noise 0.01 --trials 1

The same command goes on where it was interrupted.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache, partial
from itertools import product
from pathlib import Path

import click
from rich.console import Console

from leastaction import systems
from runner.machine import ROOT, commit, machine, versions
from runner.store import Store, carry_out
from studies._pool import Options, solved
from studies._tables import number
from studies.case import Case
from studies.faults import SETUPS
from studies.laws import LAWS
from studies.shapes import SHAPED
from studies.solve import FORCE_KINDS, KINDS


# ------------- which cases make up a study; the first trial of everything comes before the second of anything
@dataclass(frozen=True)
class Plan:
    """A study: its trials by default, the seconds a run may take, and its cases of trial 0."""

    trials: int
    timeout: float
    first: tuple[Case, ...]


def _grid(study: str, names, levels, setups=("plain",), libraries=("compact",), **shape) -> Iterator[Case]:
    for library, noise, setup, name in product(libraries, levels, setups, names):
        yield Case(study, name, noise, setup, library, **shape)


def _structure() -> Iterator[Case]:
    yield from _grid("structure", systems.names(), (0.0, 0.01, 0.1, 0.3, 0.5), libraries=("large",))
    yield from _grid("structure", systems.names(), (0.01, 0.1), rate=20.0)


def _faults() -> Iterator[Case]:
    for noise, (setup, names) in product((0.01, 0.1), SETUPS.items()):
        yield from _grid("faults", names, (noise,), (setup,))


def _noise() -> Iterator[Case]:
    yield from _grid("noise", systems.names(), (0.01, 0.05), tuple(KINDS))
    driven = [name for name in systems.names() if not systems.get(name).known]
    yield from _grid("noise", driven, (0.01, 0.05), tuple(FORCE_KINDS))


def _names() -> Iterator[Case]:
    everything = (*systems.names(), *systems.further_names())
    yield from _grid("names", everything, (0.01, 0.1), libraries=("symbolic",))


def _unlisted() -> Iterator[Case]:
    for trajectories in (1, 5):
        yield from _grid("unlisted", LAWS, (0.01, 0.05, 0.1), libraries=("auto",), trajectories=trajectories)


def _shapes() -> Iterator[Case]:
    yield from _grid("shapes", SHAPED, (0.01, 0.1))


PLANS = {
    "structure": Plan(10, 1800.0, tuple(_structure())),
    "single": Plan(10, 900.0, tuple(_grid("single", systems.names(), (0.01, 0.1), trajectories=1))),
    "calibration": Plan(200, 600.0, tuple(_grid("calibration", systems.names(), (0.01, 0.1)))),
    "faults": Plan(3, 900.0, tuple(_faults())),
    "noise": Plan(3, 900.0, tuple(_noise())),
    "further": Plan(
        3,
        1800.0,
        tuple(_grid("further", systems.further_names(), (0.01, 0.1), libraries=("compact", "large"))),
    ),
    "names": Plan(3, 900.0, tuple(_names())),
    "unlisted": Plan(3, 300.0, tuple(_unlisted())),
    "shapes": Plan(200, 600.0, tuple(_shapes())),
}


def cases(study: str, trials: int | None = None, **chosen) -> list[Case]:
    """Return the cases of a study; `chosen` maps a field of `Case` to the values that are wanted."""
    plan = PLANS[study]
    first = [c for c in plan.first if all(not v or getattr(c, k) in v for k, v in chosen.items())]
    return [replace(c, trial=k) for k in range(trials or plan.trials) for c in first]


# ------------------------------------------------------------------------------------------------ the command
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
