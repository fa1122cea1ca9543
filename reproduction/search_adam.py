"""Search for the best settings of the paper's method, system by system and noise level by noise level.

    python -m reproduction.search_adam --tries 12

The defaults, a higher threshold, then random draws of the settings that matter, the same for every system, on
a data set of its own (trial 500, which no table uses).  Chosen is the setting with the smallest ℓ2 error
against the truth.  Every try is one file; an interrupted search goes on where it stopped.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict
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
    "knots_per_second": (None, 40.0),
}
_TRIAL = 500


def draws(count: int) -> list[la.AdamOptions]:
    """The first ``count`` settings to try; more tries keep those that were there."""
    rng = np.random.default_rng(0)
    out = [la.AdamOptions(), la.AdamOptions(threshold=0.15)]
    while len(out) < count:
        chosen = {name: values[rng.integers(len(values))] for name, values in _CHOICES.items()}
        out.append(la.AdamOptions(**chosen))
    return out[:count]


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
    names = {t.expression: problem.library[problem.library.index(t.expression)].text for t in model.terms}
    found = {names[t.expression]: t.coefficient for t in model.terms}
    left_out = list(problem.known)
    return {
        "l2": la.metrics.l2_error(found, problem.true_coefficients, exclude=left_out),
        "exact": la.metrics.exact_support(found, problem.true_coefficients, exclude=left_out),
        "status": model.fit.status,
        "wall_s": time.perf_counter() - started,
    }


def _run(folder: Path, system: str, noise: float, number: int, options: la.AdamOptions) -> dict:
    path = folder / f"{system}-{noise:g}-{number}.json"
    if not path.exists():
        result = attempt(Case(system, noise, "adam", trial=_TRIAL), options)
        record = {"system": system, "noise": noise, "options": asdict(options), "result": result}
        la.io.write_text(path, json.dumps(record, indent=1))
    return json.loads(path.read_text())


@click.command()
@click.option("--tries", default=12, show_default=True)
@click.option("--system", "names", multiple=True, help="Default: all seven.")
@click.option("--noise", "levels", multiple=True, type=float, default=(0.0, 0.01, 0.1), show_default=True)
@click.option("--jobs", default=1, show_default=True)
@click.option("--folder", type=click.Path(path_type=Path), default=Path("build/search-adam"))
def main(tries: int, names, levels, jobs: int, folder: Path) -> None:
    """Try the settings that have not been tried and write the best of each system and level."""
    chosen = list(enumerate(draws(tries)))
    cases = [(s, n, k, o) for k, o in chosen for s in names or systems.names() for n in levels]
    progress = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
        joblib.delayed(_run)(folder, *case) for case in cases
    )
    for done, record in enumerate(progress, 1):
        result = record["result"]
        click.echo(
            f"{done}/{len(cases)} {record['system']} {record['noise']:g}: l2 {result['l2']:.4f} "
            f"{'exact' if result['exact'] else ''} {result['wall_s']:.0f} s",
            err=True,
        )
    la.io.write_text(SETTINGS, json.dumps(best(folder), indent=1) + "\n")


def best(folder: Path) -> dict:
    """System → noise → the options with the smallest error, and that error, of all tries in the folder."""
    out: dict = {}
    for path in sorted(folder.glob("*.json")):
        record = json.loads(path.read_text())
        table, level = out.setdefault(record["system"], {}), f"{record['noise']:g}"
        entry = {"options": record["options"], "l2": record["result"]["l2"], "tries": 1}
        if level in table:
            entry["tries"] += table[level]["tries"]
            if table[level]["l2"] <= entry["l2"]:
                entry = {**table[level], "tries": entry["tries"]}
        table[level] = entry
    return out


if __name__ == "__main__":
    main()
