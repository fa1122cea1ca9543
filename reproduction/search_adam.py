"""Search for the best settings of the paper's method, system by system and noise level by noise level.

    python -m reproduction.search_adam --tries 12

The defaults, a higher threshold, both with coefficients that move faster, all four with twice the knots,
small steps for data without noise, then random draws of the settings that matter: the same for every system,
on data sets of their own (trials from 500, which no table uses).  Chosen is the setting with the smallest ℓ2
error against the truth, the geometric mean over the data sets.  Every try is one file; an interrupted search
goes on where it stopped.
"""

from __future__ import annotations

import json
import time
import zlib
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path

import click
import joblib
import numpy as np

import leastaction as la
from leastaction import systems
from reproduction.methods.adam import SETTINGS
from reproduction.problem import Case, pose

_CHOICES = {
    "physics_weight": (0.1, 0.3, 1.0, 10.0),
    "curvature_weight": (1e-7, 1e-6),
    "learning_rate_curve": (3e-5, 1e-4, 3e-4),
    "learning_rate_coefficients": (1e-3, 3e-3, 1e-2),
    "threshold": (0.01, 0.03, 0.05),
}
_KNOTS = (1.0, 2.0)  # times the default
_FIRST_TRIAL = 500


def draws(count: int) -> list[tuple[float, la.AdamOptions]]:
    """The first ``count`` settings to try, and their density of knots; more tries keep those before."""
    rng = np.random.default_rng(0)
    rates = [(3e-3, 0.03), (3e-3, 0.15), (1e-2, 0.03), (1e-2, 0.15)]
    out = [
        (knots, la.AdamOptions(learning_rate_coefficients=rate, threshold=least))
        for knots in _KNOTS
        for rate, least in rates
    ]
    out.append((2.0, la.AdamOptions(learning_rate_coefficients=3e-4, learning_rate_curve=1e-6)))
    while len(out) < count:
        chosen = {name: values[rng.integers(len(values))] for name, values in _CHOICES.items()}
        new = (_KNOTS[rng.integers(2)], la.AdamOptions(**chosen))
        out += [] if new in out else [new]
    return out[:count]


@lru_cache
def _default_knots(system: str, noise: float) -> float:
    """Knots per second that the method takes by itself on the first data set."""
    problem = pose(Case(system, noise, "adam", trial=_FIRST_TRIAL))
    short = la.AdamOptions(iterations=1)
    model = la.discover(problem.data, problem.library, known=problem.known, method="adam", options=short)
    return model.provenance["knots_per_second"]


def attempt(case: Case, options: la.AdamOptions) -> dict:
    """One try: error, support and wall time."""
    problem = pose(case)
    started = time.perf_counter()
    try:
        model = la.discover(
            problem.data, problem.library, known=problem.known, method="adam", options=options, seed=case.seed
        )
    except la.DataError as error:
        return {"l2": 1.0, "exact": False, "status": str(error), "wall_s": time.perf_counter() - started}
    found = problem.free({t.expression: t.coefficient for t in model.terms})
    left_out = list(problem.known)
    return {
        "l2": la.metrics.l2_error(found, problem.true_coefficients, exclude=left_out),
        "exact": la.metrics.exact_support(found, problem.true_coefficients, exclude=left_out),
        "status": model.fit.status,
        "wall_s": time.perf_counter() - started,
    }


def _run(folder: Path, case: Case, knots: float, options: la.AdamOptions) -> dict:
    if knots != 1.0:
        options = replace(options, knots_per_second=round(knots * _default_knots(case.system, case.noise), 1))
    settings = asdict(options)
    name = "-".join(f"{value}" for value in settings.values())  # a new sequence of tries finds the old ones
    path = folder / f"{case.system}-{case.noise:g}-{case.trial}-{zlib.crc32(name.encode()):08x}.json"
    if not path.exists():
        record = {"config": case.as_dict(), "options": settings, "result": attempt(case, options)}
        la.io.write_text(path, json.dumps(record, indent=1))
    return json.loads(path.read_text())


@click.command()
@click.option("--tries", default=12, show_default=True)
@click.option("--data-sets", default=2, show_default=True)
@click.option("--system", "names", multiple=True, help="Default: all seven.")
@click.option("--noise", "levels", multiple=True, type=float, default=(0.0, 0.01, 0.1), show_default=True)
@click.option("--jobs", default=1, show_default=True)
@click.option("--folder", type=click.Path(path_type=Path), default=Path("build/search-adam"))
def main(tries: int, data_sets: int, names, levels, jobs: int, folder: Path) -> None:
    """Try the settings that have not been tried and write the best of each system and level."""
    cases = [
        (Case(s, n, "adam", trial=_FIRST_TRIAL + k), *options)
        for k in range(data_sets)
        for options in draws(tries)
        for s in names or systems.names()
        for n in levels
    ]
    progress = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
        joblib.delayed(_run)(folder, *case) for case in cases
    )
    records = []
    for record in progress:
        records.append(record)
        result, config = record["result"], record["config"]
        click.echo(
            f"{len(records)}/{len(cases)} {config['system']} {config['noise']:g}: l2 {result['l2']:.4f} "
            f"{'exact' if result['exact'] else ''} {result['wall_s']:.0f} s",
            err=True,
        )
    settings = json.loads(SETTINGS.read_text(encoding="utf-8")) if SETTINGS.exists() else {}
    for system, levels in best(records).items():
        settings.setdefault(system, {}).update(levels)
    la.io.write_text(SETTINGS, json.dumps(settings, indent=1) + "\n")


def best(records: list[dict]) -> dict:
    """System → noise → the options with the smallest error, that error, and how much it was chosen from."""
    errors: dict = {}
    for record in records:
        config, options = record["config"], json.dumps(record["options"])
        cell = errors.setdefault(config["system"], {}).setdefault(f"{config['noise']:g}", {})
        cell.setdefault(options, []).append(record["result"]["l2"])
    return {system: {n: _chosen(cell) for n, cell in levels.items()} for system, levels in errors.items()}


def _chosen(cell: dict[str, list[float]]) -> dict:
    mean = {options: float(np.exp(np.mean(np.log(l2)))) for options, l2 in cell.items()}
    first = min(mean, key=mean.__getitem__)
    sizes = {"tries": len(cell), "data_sets": len(cell[first])}
    return {"options": json.loads(first), "l2": mean[first], **sizes}


if __name__ == "__main__":
    main()
