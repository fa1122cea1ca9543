"""Run cases of the tables, one process each; what has a record in reproduction/results/ is not run again.

    python -m reproduction.run --table 1 --jobs 2
    python -m reproduction.run --system double_pendulum --method ours --method adam:short --trials 1
    python -m reproduction.run --table 2 --scheduler tcp://localhost:8786

The same command goes on where it was interrupted. With ``--scheduler`` the runs go to the workers of a Dask
cluster, as many at a time as they have threads; each needs this folder and the packages.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from functools import partial
from importlib import import_module
from itertools import product
from pathlib import Path

import click
from rich.console import Console

import leastaction as la
from leastaction import systems
from reproduction._execute import Options, end_with_parent, execute, launched
from reproduction._results import store_of
from reproduction.problem import Case
from runner.machine import ROOT
from runner.store import carry_out, say, to_line

RESULTS = ROOT / "reproduction" / "results"
# Table 2: A complete data, B with missing samples, C without the regularisation that only Adam's loss has
TABLE2_METHODS = ("ours", "adam")
TABLE2_MISSING = 0.05
TABLE2_PLAIN = ("adam", "no-regularisation")

_LEVELS = {"1": (0.0, 0.01, 0.1), "2": (0.0, 0.1)}

Method = tuple[str, str]  # name, variant


def settings(table: str, methods: Sequence[Method], missing: Sequence[float]) -> list[tuple[Method, float]]:
    """Return the (method, variant), share of missing samples of a table."""
    if table == "1":
        return list(product(methods, missing))
    complete = [m for m in methods if m[0] in TABLE2_METHODS and m != TABLE2_PLAIN]
    plain = [(TABLE2_PLAIN, 0.0)] if any(name == TABLE2_PLAIN[0] for name, _ in methods) else []
    return [(m, share) for share in (0.0, TABLE2_MISSING) for m in complete] + plain


def build_cases(
    chosen: Iterable[tuple[Method, float]],
    names: Sequence[str],
    levels: Sequence[float],
    libraries: Sequence[str] = ("compact",),
    conventions: Sequence[str] = ("relative",),
    trials: int = 5,
    trajectories: int = 5,
) -> list[Case]:
    """Return all combinations; the first trial of everything comes before the second of anything."""
    chosen = list(chosen)
    sweep = product(range(trials), conventions, libraries, levels, names, chosen)
    return [
        Case(system, noise, method, trial, convention, library, variant, trajectories, missing)
        for trial, convention, library, noise, system, ((method, variant), missing) in sweep
    ]


def usable(cases: Sequence[Case], methods: str, console: Console) -> list[Case]:
    """Leave out the cases of methods whose file or package is not there, and say so in one line each."""
    home = import_module(methods)
    absent: dict[str, str] = {}
    for name in dict.fromkeys(case.method for case in cases):
        try:
            home.load(name)
        except Exception as error:  # a broken package may raise anything when it is imported
            absent[name] = f"{error}".split("\n")[0] or type(error).__name__
    for name, reason in absent.items():
        say(console, f"{name} is left out: {reason}")
    return [case for case in cases if case.method not in absent]


def _line(case: Case, result: dict) -> str:
    if not result["finished"]:
        return f"{case.key}: {result['status']}: {result['reason']}"
    error = "no coefficients" if result["l2"] is None else f"l2 {result['l2']:.2e}"
    return f"{case.key}: {error}, {result['wall_s']:.1f} s, {result['status']}"


def _methods(given: Sequence[str], variant: str, home: str) -> list[Method]:
    """Return (name, variant) of options such as "adam" or "adam:short"; by default every method."""
    pairs = [text.partition(":") for text in given or import_module(home).NAMES]
    names = import_module(home).NAMES
    for name, _, _ in pairs:
        if name not in names:
            raise click.UsageError(f"method {name!r} is unknown; choose from {', '.join(names)}")
    return [(name, own or variant) for name, _, own in pairs]


@click.command(help=__doc__.split("\n\n")[0])
@click.option("--table", type=click.Choice(["1", "2"]), default="1", show_default=True)
@click.option(
    "--method", "methods", multiple=True, metavar="NAME[:VARIANT]", help="Default: all of the table."
)
@click.option("--variant", default="", help="Of the methods that are named without one.")
@click.option("--system", "names", multiple=True, type=click.Choice(systems.names()), help="Default: all.")
@click.option("--noise", "levels", multiple=True, type=float, help="Default: those of the table.")
@click.option(
    "--convention", multiple=True, type=click.Choice(["relative", "absolute"]), default=["relative"]
)
@click.option("--library", multiple=True, type=click.Choice(["compact", "large"]), default=["compact"])
@click.option("--trials", type=click.IntRange(1), default=5, show_default=True)
@click.option("--trajectories", type=click.IntRange(1), default=5, show_default=True)
@click.option("--missing", multiple=True, type=click.FloatRange(0, 1, max_open=True), default=[0.0])
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Runs at a time, here.")
@click.option("--scheduler", default="", help="Address of a Dask scheduler.")
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), default=RESULTS)
@click.option("--timeout", type=float, default=3600.0, show_default=True, help="Seconds a run may take.")
@click.option("--retry-failed", is_flag=True, help="Run those again that failed or took too long.")
@click.option("--strict", is_flag=True, help="Exit with 1 if a run fails or a method is left out.")
@click.option("--dry-run", is_flag=True, help="Say what would be run.")
@click.option("--one", "config", default="", hidden=True, help="Run this case (JSON) in this process.")
@click.option("--record", type=click.Path(path_type=Path), hidden=True, help="Its record's file.")
@click.option("--methods-from", "home", default="reproduction.methods", hidden=True)
def main(
    table, methods, variant, names, levels, convention, library, trials, trajectories, missing,
    jobs, scheduler, results, timeout, retry_failed, strict, dry_run, config, record, home,
) -> None:  # fmt: skip
    if config:
        end_with_parent()
        case = Case(**json.loads(config))
        done = execute(case, import_module(home).load(case.method), jobs)
        la.io.write_text(record, to_line(done))
        return
    console = Console()
    chosen = settings(table, _methods(methods, variant, home), missing)
    shape = (library, convention, trials, trajectories)
    everything = build_cases(chosen, names or systems.names(), levels or _LEVELS[table], *shape)
    here = usable(everything, home, console)
    options = Options(jobs, scheduler, timeout, home)
    store = store_of(results)
    records = carry_out(
        here, store, partial(launched, options=options), _line, console, retry_failed, dry_run
    )
    failed = any(not r["result"]["finished"] for r in records)
    sys.exit(int(strict and not dry_run and (failed or len(here) < len(everything))))


if __name__ == "__main__":
    main()
