"""Accuracy on the simulated systems: support, error against the Cramér–Rao bound, coverage, processor time.

    python benchmarks/accuracy.py                      # seven systems, noise 0, 1, 10 %, three trials
    python benchmarks/accuracy.py --library large --noise 0.1
    python benchmarks/accuracy.py --missing 0.3 --irregular

One JSON file a case goes to ``--results``; cases that are there already are not run again.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import click
import numpy as np

import leastaction as la
from leastaction import systems
from leastaction.io import write_text
from leastaction.metrics import cramer_rao_bound


@click.command()
@click.option("--system", "names", multiple=True, help="Systems; default: all seven.")
@click.option("--noise", "levels", multiple=True, type=float, default=(0.0, 0.01, 0.1), show_default=True)
@click.option("--seeds", default=3, show_default=True, help="Data sets a case.")
@click.option("--first-seed", default=0, show_default=True)
@click.option("--trajectories", default=5, show_default=True)
@click.option("--duration", default=20.0, show_default=True)
@click.option("--rate", default=100.0, show_default=True)
@click.option("--library", type=click.Choice(["compact", "large"]), default="compact", show_default=True)
@click.option("--missing", default=0.0, show_default=True, help="Share of samples left out.")
@click.option("--irregular", is_flag=True, help="Jittered sampling times.")
@click.option("--results", type=click.Path(path_type=Path), default=Path("benchmarks/results/accuracy"))
def main(names, levels, seeds, first_seed, results, **options) -> None:
    """Run the cases that are missing and print the table."""
    records = []
    for name in names or systems.names():
        for noise in levels:
            for seed in range(first_seed, first_seed + seeds):
                config = {"system": name, "noise": noise, "seed": seed, **options}
                path = results / ("-".join(str(v) for v in config.values()) + ".json")
                if path.exists():
                    records.append(json.loads(path.read_text()))
                    continue
                record = {"config": config, "result": run(config)}
                write_text(path, json.dumps(record, indent=1))
                records.append(record)
                click.echo(f"{name} {noise:g} {seed}: {record['result']}", err=True)
    click.echo(table(records))


def run(config: dict) -> dict:
    """One discovery, scored against the truth."""
    system = systems.get(config["system"])
    shape = {"trials": config["trajectories"], "duration": config["duration"], "rate": config["rate"]}
    shape |= {"seed": config["seed"], "irregular": config["irregular"]}
    data = systems.generate(system, noise=config["noise"], missing=config["missing"], **shape)
    make = systems.large_library if config["library"] == "large" else systems.compact_library
    library = make(system)
    truth = systems.truth_for(system, library)
    started = time.process_time()  # wall time would tell of other programs
    model = la.discover(data, library, known=system.known)
    seconds = time.process_time() - started

    found = {library.index(term.expression): term for term in model.terms if not term.known}
    known = {library.index(text) for text in system.known}
    free = {k: value for k, value in truth.items() if k not in known}
    estimates = {k: term.coefficient for k, term in found.items()}
    size = np.sqrt(sum(v**2 for v in free.values()))
    error = np.sqrt(sum((estimates.get(k, 0.0) - free.get(k, 0.0)) ** 2 for k in {*estimates, *free})) / size
    motions = systems.simulate_truth(system, **shape)
    sigma = systems.noise_std(system, motions, config["noise"]) if config["noise"] else model.noise_std
    bound = cramer_rao_bound(system, motions, sigma, observed=data).relative
    covered = [found[k].lower <= v <= found[k].upper for k, v in free.items() if k in found]
    return {
        "exact": set(found) == set(free),
        "spurious": len(set(found) - set(free)),
        "missed": len(set(free) - set(found)),
        "l2": float(error),
        # without noise there is no bound: the one printed is for the noise that the fit assumed
        "crb_ratio": float(error / bound) if config["noise"] else None,
        "covered": int(np.sum(covered)),
        "intervals": len(covered),
        "cpu_s": seconds,
        "status": model.fit.status,
    }


def table(records: list[dict]) -> str:
    """Markdown: one row a system and noise level, medians over the data sets."""
    rows = [
        "| system | noise | exact support | median ℓ2 | median ℓ2 / Cramér–Rao | covered | ok | median s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    cases: dict[tuple, list[dict]] = {}
    for record in records:
        cases.setdefault((record["config"]["system"], record["config"]["noise"]), []).append(record["result"])
    for (name, noise), results in cases.items():
        n = len(results)
        ratios = [r["crb_ratio"] for r in results if r["crb_ratio"] is not None]
        rows.append(
            f"| {name.replace('_', ' ')} | {100 * noise:g} % | {sum(r['exact'] for r in results)}/{n} "
            f"| {np.median([r['l2'] for r in results]):.2e} "
            f"| {f'{np.median(ratios):.2f}' if ratios else '–'} "
            f"| {sum(r['covered'] for r in results)}/{sum(r['intervals'] for r in results)} "
            f"| {sum(r['status'] == 'ok' for r in results)}/{n} "
            f"| {np.median([r['cpu_s'] for r in results]):.1f} |"
        )
    return "\n".join(rows)


if __name__ == "__main__":
    main()
