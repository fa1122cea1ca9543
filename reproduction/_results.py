"""The records of runs, read and averaged for the tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from leastaction import systems
from reproduction import methods
from reproduction.problem import Case
from runner.store import Store

__all__ = ["Column", "Group", "Results", "best", "competes", "complete", "read", "store_of"]

NO_REGULARISATION = "no-regularisation"  # the variant that only the second table asks for
EXPERIMENTS = ("from-truth", "true-terms")  # variants of the paper's method that are told the truth
NAMES, GIVEN = "names", "given-rates"  # variants of the comparison with symbolic regression
APART = (NO_REGULARISATION, *EXPERIMENTS, NAMES, GIVEN)  # these do not compete in the tables of the paper
UDSR = "udsr"  # nor does this method, which is run for a few cases only

Column = tuple[str, str]  # method, variant


@dataclass(frozen=True)
class Group:
    """What one set of tables is about: runs that differ only in method, system, noise level and trial."""

    convention: str
    library: str
    trajectories: int

    @property
    def title(self) -> str:
        number = "one trajectory" if self.trajectories == 1 else f"{self.trajectories} trajectories"
        unit = "noise relative to each coordinate's spread"
        if self.convention == "absolute":
            unit = "noise in rad and m"
        return f"{self.library.capitalize()} library, {unit}, {number}"


def store_of(folder: Path) -> Store:
    """Return the records of a folder: ``runs.jsonl``, or one file a method as was the former layout."""
    return Store(folder, Case.from_dict, single="runs")


def read(folder: Path) -> Results:
    """Read every record of a folder; ValueError names a file, and its line, that is not one."""
    return Results(store_of(folder).read())


class Results:
    """Records, and averages over those that share what is asked for."""

    def __init__(self, records: Iterable[dict]) -> None:
        self.records = list(records)

    def where(self, keep: Callable[[dict], bool] | None = None, **wanted) -> Results:
        """Return the records with these values in their configuration."""
        return Results(
            r
            for r in self.records
            if all(r["config"][k] == v for k, v in wanted.items()) and (keep is None or keep(r["config"]))
        )

    def of(self, group: Group) -> Results:
        names = {"noise_convention": group.convention, "library": group.library}
        return self.where(trajectories=group.trajectories, **names)

    def column(self, column: Column) -> Results:
        return self.where(method=column[0], variant=column[1])

    @cached_property
    def groups(self) -> list[Group]:
        """Of the runs with complete data, the paper's setting first."""
        found = {
            Group(c["noise_convention"], c["library"], c["trajectories"])
            for c in (r["config"] for r in self.records)
        }
        return sorted(found, key=lambda g: (g.convention != "relative", g.library, -g.trajectories))

    @cached_property
    def columns(self) -> list[Column]:
        """Methods and variants that occur, in the sequence of ``methods.NAMES``."""
        place = {name: k for k, name in enumerate(methods.NAMES)}
        found = {(r["config"]["method"], r["config"]["variant"]) for r in self.records}
        return sorted(found, key=lambda c: (place.get(c[0], len(place)), c))

    @cached_property
    def cells(self) -> list[tuple[str, float]]:
        """(system, noise) that occur, in the package's sequence of systems."""
        place = {name: k for k, name in enumerate(systems.names())}
        found = {(r["config"]["system"], r["config"]["noise"]) for r in self.records}
        return sorted(found, key=lambda c: (place.get(c[0], len(place)), c))

    @property
    def comparable(self) -> Results:
        """Those of the first table: complete data, nothing left out of a method and nothing told to it."""
        return self.where(lambda c: c["missing"] == 0 and competes(c))

    @property
    def finished(self) -> list[dict]:
        return [r["result"] for r in self.records if r["result"]["finished"]]

    @property
    def failed(self) -> list[dict]:
        return [r["result"] for r in self.records if not r["result"]["finished"]]

    def mean(self, name: str) -> float | None:
        """Mean over the finished runs that have this score; None if there are none."""
        values = [r[name] for r in self.finished if r.get(name) is not None]
        return float(np.mean(values)) if values else None

    def rms(self, name: str) -> float | None:
        values = [r[name] for r in self.finished if r.get(name) is not None]
        return float(np.sqrt(np.mean(np.square(values)))) if values else None

    def total(self, name: str) -> float | None:
        values = [r[name] for r in self.finished if r.get(name) is not None]
        return sum(values) if values else None

    def title(self, column: Column) -> str:
        """A method's name as it calls itself, and its variant."""
        records = self.column(column).records
        named = (r["method"]["title"] for r in records if r["method"]["title"])
        title = next(named, column[0])
        return f"{title}, {column[1]}" if column[1] else title


def competes(config: Mapping) -> bool:
    """Tell whether a run belongs into the tables of the paper: its method is whole, and told nothing."""
    return config["variant"] not in APART and config["method"] != UDSR


def complete(runs: Sequence[Results]) -> list[bool]:
    """Tell which of the cells of a row have an answer for every trial that any of them has.

    Only these may be the best: a mean over the easier trials is no comparison.
    """
    most = max((len(r.records) for r in runs), default=0)
    return [len(r.finished) == most for r in runs]


def best(values: Sequence[float | None], largest: bool = False) -> set[int]:
    """Return the places of the best value; several if they are equal, none if there is nothing to compare."""
    there = [v for v in values if v is not None]
    if len(there) < 2:
        return set()
    top = max(there) if largest else min(there)
    return {k for k, v in enumerate(values) if v == top}
