"""What each strategy of the search is worth: the same cases with all of them, and with one left out.

    python benchmarks/strategies.py --noise 0.1 --seeds 1 --variant all --variant "without kinetic_restart"

"local" and "relevance" leave out one of the two searches on the quadratic model of the likelihood: the first
exchanges terms one at a time from the present structure, the second begins where all candidates compete at
once.  Generated libraries; one line for each run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from itertools import product
from types import ModuleType

import click

import leastaction as la
from leastaction import systems
from leastaction.selection import likelihood_refinement, likelihood_search, search
from leastaction.selection.strategies import (
    all_data,
    coarse_restart,
    exact_equations,
    shortest_form,
    simulation_error,
)

_FURTHER = ("toda_chain", "double_well", "henon_heiles", "kepler_orbit")


def _local(model, start, penalty, width=6):
    return likelihood_search._search_from(model, start, penalty, width)


def _relevance(model, start, penalty, width=6):
    chosen = likelihood_search.relevant(model, penalty) or start
    return {len(c): model.best({c}, 1) for c in {chosen, start}}


@contextmanager
def _changed(owner: ModuleType, name: str, value: object) -> Iterator[None]:
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


def _without(strategy: ModuleType):
    """Leave a strategy out, wherever it is called."""
    return _changed(strategy, "run", lambda found, *again: found)


def _name(strategy: ModuleType) -> str:
    return strategy.__name__.rpartition(".")[2]


_LEFT_OUT = (
    *search.ON_ONE_GRID[1:],
    coarse_restart,
    all_data,
    shortest_form,
    exact_equations,
    simulation_error,
)
VARIANTS: dict[str, Callable] = {
    "all": nullcontext,
    "local": lambda: _changed(likelihood_refinement, "search_subsets", _local),
    "relevance": lambda: _changed(likelihood_refinement, "search_subsets", _relevance),
    **{f"without {_name(strategy)}": (lambda s=strategy: _without(s)) for strategy in _LEFT_OUT},
}


@click.command()
@click.option("--noise", "levels", multiple=True, type=float, default=(0.1, 0.3), show_default=True)
@click.option("--seeds", default=2, show_default=True, help="Data sets a case.")
@click.option("--first-seed", default=400, show_default=True)
@click.option("--system", "names", multiple=True, help="Default: the seven, and four further ones.")
@click.option("--variant", "variants", multiple=True, type=click.Choice(list(VARIANTS)), help="Default: all.")
def main(levels, seeds: int, first_seed: int, names, variants) -> None:
    """Print every run, and the table."""
    variants, names = variants or tuple(VARIANTS), names or (*systems.names(), *_FURTHER)
    counts = {variant: {"exact": 0, "ok and wrong": 0, "s": 0.0} for variant in variants}
    for name, noise, seed in product(names, levels, range(first_seed, first_seed + seeds)):
        system = systems.get(name)
        data = systems.generate(system, noise=noise, trials=5, duration=20.0, seed=seed)
        library = systems.large_library(system)
        truth = set(systems.truth_for(system, library))
        line = [f"{name} {noise:g} {seed}:"]
        for variant, count in counts.items():
            started = time.process_time()
            with VARIANTS[variant]():
                model = la.discover(data, library, known=system.known)
            spent = time.process_time() - started
            exact = {library.index(t.expression) for t in model.terms} == truth
            count["exact"] += exact
            count["ok and wrong"] += not exact and model.fit.status == "ok"
            count["s"] += spent
            line.append(f"{variant} {'exact' if exact else 'wrong'} {model.fit.status} {spent:.1f} s;")
        click.echo(" ".join(line))
    runs = len(names) * len(levels) * seeds
    for variant, count in counts.items():
        click.echo(
            f"{variant}: {count['exact']}/{runs} exact, {count['ok and wrong']} ok and wrong, "
            f"{count['s'] / runs:.1f} s of processor time a run"
        )


if __name__ == "__main__":
    main()
