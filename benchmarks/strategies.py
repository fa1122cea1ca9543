"""Two searches on the quadratic model of the likelihood, alone and together, on the same cases.

    python benchmarks/strategies.py

"local" exchanges terms one at a time from the present support, "relevance" begins where all candidates
compete at once, "both" is what discover() does.  Generated libraries; one line for each run.
"""

from __future__ import annotations

import time
from itertools import product

import click

import leastaction as la
from leastaction import _selection, _subsets, systems

_FURTHER = ("toda_chain", "double_well", "henon_heiles", "kepler_orbit")


def _local(model, start, penalty, width=6):
    return _subsets._search_from(model, start, penalty, width)


def _relevance(model, start, penalty, width=6):
    chosen = _subsets.relevant(model, penalty) or start
    return {len(c): model.best({c}, 1) for c in {chosen, start}}


STRATEGIES = {"local": _local, "relevance": _relevance, "both": _subsets.search_subsets}


@click.command()
@click.option("--noise", "levels", multiple=True, type=float, default=(0.1, 0.3), show_default=True)
@click.option("--seeds", default=2, show_default=True, help="Data sets a case.")
@click.option("--first-seed", default=400, show_default=True)
def main(levels, seeds: int, first_seed: int) -> None:
    """Print every run, and the table."""
    counts = {name: {"exact": 0, "ok and wrong": 0, "s": 0.0} for name in STRATEGIES}
    names = (*systems.names(), *_FURTHER)
    for name, noise, seed in product(names, levels, range(first_seed, first_seed + seeds)):
        system = systems.get(name)
        data = systems.generate(system, noise=noise, trials=5, duration=20.0, seed=seed)
        library = systems.large_library(system)
        truth = set(systems.truth_for(system, library))
        line = [f"{name} {noise:g} {seed}:"]
        for strategy, search in STRATEGIES.items():
            _selection.search_subsets = search
            started = time.process_time()
            model = la.discover(data, library, known=system.known)
            spent = time.process_time() - started
            exact = {library.index(t.expression) for t in model.terms} == truth
            count = counts[strategy]
            count["exact"] += exact
            count["ok and wrong"] += not exact and model.fit.status == "ok"
            count["s"] += spent
            line.append(f"{strategy} {'exact' if exact else 'wrong'} {model.fit.status} {spent:.1f} s;")
        click.echo(" ".join(line))
    runs = len(names) * len(levels) * seeds
    for strategy, count in counts.items():
        click.echo(
            f"{strategy}: {count['exact']}/{runs} exact, {count['ok and wrong']} ok and wrong, "
            f"{count['s'] / runs:.1f} s of processor time a run"
        )


if __name__ == "__main__":
    main()
