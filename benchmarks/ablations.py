"""Every strategy left out in turn, on set-ups that it was not made for.

    python -m benchmarks.ablations [--variant "without finer_knots"] [--group machines]
    python -m benchmarks.ablations --group generated --variant local --variant relevance

Three groups: further systems with generated libraries and single short trials; wrong set-ups and such with
absent friction; machines, a driven pendulum with friction that is pushed by what nobody measured. A fourth,
which takes hours and runs only when asked for, has generated libraries of the seven systems and of four more.
One row for each variant: exact structures, ok, ok and wrong, root mean square of the relative error of the
coefficients where the structure is exact, and processor time.

"local" and "relevance" leave out one of the two searches on the quadratic model of the likelihood: the first
exchanges terms one at a time from the present structure, the second begins where all candidates compete at
once.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from time import process_time
from types import ModuleType

import click
import numpy as np

import leastaction as la
from leastaction import systems
from leastaction.assembly import assemble_model
from leastaction.diagnosis.verdict import verify
from leastaction.estimation.build import Request, build_problem
from leastaction.selection import likelihood_refinement, likelihood_search, search
from leastaction.selection.alternatives import find_alternatives
from leastaction.selection.search_state import begin_search
from leastaction.selection.strategies import (
    all_data,
    coarse_restart,
    exact_equations,
    shortest_form,
    simulation_error,
)
from leastaction.threads import single_threaded
from studies.case import Case
from studies.solve import pose, score

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from helpers import _machine, _pendulum

_SEED = 700


# ---------------------------------------------------------------------------------- what is left out
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


# ------------------------------------------------------------------------------------- the set-ups


@dataclass(frozen=True)
class SetUp:
    """Data, what is asked, how many samples are searched, and what says exact or wrong and how far off."""

    data: la.Trajectories
    request: Request
    judge: Callable[[la.LagrangianModel], tuple[bool, float]]
    searched: int | None = None


def _case(
    name: str,
    noise: float,
    setup: str = "plain",
    size: str = "compact",
    trials: int = 2,
    seed: int = _SEED,
    times: tuple[float, float] = (10.0, 50.0),
) -> SetUp:
    """A case of the studies with another seed; `times` are seconds of a trial and samples a second."""
    case = Case("faults", name, noise, setup, size, seed, trials, *times)
    question, _ = pose(case)

    def judge(model: la.LagrangianModel) -> tuple[bool, float]:
        judged = score(case, question, model)
        return judged["exact"], judged["l2"]

    return SetUp(question.data, Request(question.library, question.known), judge)


def _long(name: str, noise: float, trials: int, pieces: int) -> SetUp:
    """A recording that is searched in pieces."""
    found = _case(name, noise, trials=trials)
    return replace(found, searched=found.data.n_samples // pieces)


def _absent(name: str, noise: float) -> SetUp:
    """Friction among the candidates, and none in the motion."""
    found = _case(name, noise)
    rates = [f"{c}_dot" for c in found.data.coordinates]
    more = [text for v in rates for text in (f"{v}**2/2", f"abs({v})")]
    return replace(found, request=replace(found.request, dissipation=more))


def _pushed(seed: int, viscous: float = 0.0, dry: float = 0.0, **more: float) -> SetUp:
    data, request, _ = _machine(_pendulum(_SEED + seed, viscous=viscous, dry=dry, **more))
    law = {"theta_dot**2": 0.5, "cos(theta)": 9.81, "theta_dot**2/2": viscous, "abs(theta_dot)": dry}
    true = {text: value for text, value in law.items() if value}

    def judge(model: la.LagrangianModel) -> tuple[bool, float]:
        found = {_plain(t.expression): t.coefficient for t in (*model.terms, *model.dissipation)}
        exact = found.keys() == true.keys()
        return exact, la.metrics.l2_error(found, true) if exact else np.nan

    return SetUp(data, request, judge)


GROUPS: dict[str, dict[str, Callable[[], SetUp]]] = {
    "systems": {
        **{
            f"{name}, large library": lambda name=name: _case(name, 0.1, size="large")
            for name in ("double_well", "morse_molecule", "kepler_orbit")
        },
        **{
            f"{name}, large library, one trial": lambda name=name: _case(name, 0.01, size="large", trials=1)
            for name in ("morse_molecule", "double_well")
        },
        "rotary_pendulum": lambda: _case("rotary_pendulum", 0.1),
        "elastic_pendulum_cart": lambda: _case("elastic_pendulum_cart", 0.01),
        "henon_heiles, in pieces": lambda: _long("henon_heiles", 0.1, 6, 6),
        "kepler_orbit, in pieces": lambda: _long("kepler_orbit", 0.1, 6, 6),
    },
    "faults": {
        "cos missing": lambda: _case("single_pendulum", 0.1, "term-missing"),
        "known 1.2": lambda: _case("single_pendulum", 0.1, "known-1.2"),
        "forces late": lambda: _case("double_pendulum", 0.1, "force-delay"),
        "friction not modelled": lambda: _case("double_pendulum", 0.1, "friction-1"),
        "one force reversed": lambda: _case("double_pendulum", 0.1, "force-sign-one"),
        **{
            f"{name}, absent friction": lambda name=name: _absent(name, 0.1)
            for name in ("morse_molecule", "henon_heiles")
        },
    },
    "machines": {
        "pushed a little": lambda: _pushed(1, viscous=0.2, pushed=0.3),
        "pushed": lambda: _pushed(2, viscous=0.2, pushed=2.0, noise=1e-4),
        "pushed hard": lambda: _pushed(3, viscous=0.2, pushed=5.0, noise=1e-4),
        "pushed, dry friction": lambda: _pushed(4, dry=0.5, pushed=2.0, noise=1e-4),
        "pushed, no friction": lambda: _pushed(5, pushed=2.0, noise=1e-4),
        "pushed very hard": lambda: _pushed(8, viscous=0.2, pushed=8.0, noise=1e-4),
        "pushed hard, dry friction": lambda: _pushed(9, dry=0.5, pushed=5.0, noise=1e-4),
        "energy fed in": lambda: _pushed(6, viscous=-0.15),
        "forces reversed": lambda: _pushed(7, viscous=0.2, sign=-1.0),
    },
    "generated": {
        f"{name}, {100 * noise:g} %, {seed}": lambda name=name, noise=noise, seed=seed: _case(
            name, noise, size="large", trials=5, seed=seed, times=(20.0, 100.0)
        )
        for name, noise, seed in product(
            (*systems.names(), "toda_chain", "double_well", "henon_heiles", "kepler_orbit"),
            (0.1, 0.3),
            (400, 401),
        )
    },
}


@dataclass(frozen=True)
class Outcome:
    """What a discovery found."""

    exact: bool
    status: str
    error: float
    seconds: float


@cache
def _posed(group: str, name: str) -> SetUp:
    return GROUPS[group][name]()


def outcome(group: str, name: str) -> Outcome:
    """Search a set-up, and judge what is found."""
    posed = _posed(group, name)
    begun = process_time()
    setup = build_problem(posed.data, posed.request, posed.searched)
    found = search.run_search(begin_search(setup))
    seconds = process_time() - begun
    alternatives, curvature = find_alternatives(found.found, found.relevance)
    # causes say what to do, not whether to doubt what a strategy left: most of the time, and no difference
    judged = verify(found, alternatives, curvature, look_for_causes=False)
    model = assemble_model(setup, found, judged, alternatives, {}, {})
    exact, error = posed.judge(model)
    return Outcome(exact, model.fit.status, error if exact else np.nan, seconds)


def _plain(text: str) -> str:
    return "abs(theta_dot)" if "sqrt(theta_dot**2" in text else text.replace(" ", "")


@click.command()
@click.option("--variant", "variants", multiple=True, type=click.Choice(list(VARIANTS)), help="Default: all.")
@click.option(
    "--group", "groups", multiple=True, type=click.Choice(list(GROUPS)), help="Default: all but generated."
)
@single_threaded()
def main(variants, groups) -> None:
    """Print what differs, and a row for each group and variant."""
    for group in groups or [name for name in GROUPS if name != "generated"]:
        before: dict[str, Outcome] = {}
        for variant in dict.fromkeys(("all", *(variants or VARIANTS))):
            found = {}
            for name in GROUPS[group]:
                with VARIANTS[variant]():
                    found[name] = outcome(group, name)
                one, other = found[name], before.get(name)
                if other is None or (one.exact, one.status) != (other.exact, other.status):
                    state = "exact" if one.exact else "wrong"
                    click.echo(
                        f"  {variant}, {name}: {state} {one.status} {one.error:.2g} {one.seconds:.1f} s"
                    )
            before = before or found
            ok = [one for one in found.values() if one.status == "ok"]
            both = [name for name in found if found[name].exact and before[name].exact]
            error = np.sqrt(np.mean([found[name].error ** 2 for name in both])) if both else np.nan
            was = np.sqrt(np.mean([before[name].error ** 2 for name in both])) if both else np.nan
            click.echo(
                f"{group}, {variant}: {sum(one.exact for one in found.values())}/{len(found)} exact, "
                f"{len(ok)} ok, {sum(not one.exact for one in ok)} ok and wrong, error {100 * error:.3g} % "
                f"(all: {100 * was:.3g} %), {sum(one.seconds for one in found.values()):.1f} s"
            )


if __name__ == "__main__":
    main()
