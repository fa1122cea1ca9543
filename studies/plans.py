"""Which cases make up a study; the first trial of everything comes before the second of anything."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

from leastaction import systems
from studies.case import Case
from studies.faults import SETUPS
from studies.laws import LAWS
from studies.noises import FORCE_KINDS, KINDS
from studies.shapes import SHAPED

__all__ = ["PLANS", "Plan", "cases"]


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
