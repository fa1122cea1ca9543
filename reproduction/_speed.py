"""Seconds of the methods against seconds of ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from reproduction._results import Column, Results, competes
from reproduction._tables import Cell, Table, number
from reproduction.scoring import NEAR_BEST

__all__ = ["speed"]

_SPEED_NOTE = (
    "Processor time of a method divided by ours on the same data, geometric mean over noise levels, trials "
    "and libraries. Above 1, ours is faster. For iterative methods it is the time until the error first "
    "came within 5 % of its smallest value, which is unknown in practice; for others, the total. Processor "
    "time with one thread is comparable on busy machines, too. Only pairs from the same kind of machine; in "
    "brackets, their number."
)
_LEVEL_NOTE = (
    "The same time of a method, divided by the time after which the intermediate law of ours was within 5 % "
    "of that method's smallest error, or better. Ours then continues to its end. In brackets, the pairs in "
    "which ours came that far, and all pairs; the others are not in the mean (data without noise, where "
    "exact accelerations or integrals leave only rounding errors)."
)


def speed(results: Results) -> list[Table]:
    """Return how many times longer each method takes than ours, pair by pair on one kind of machine."""
    ours = {_pairing(r): r["result"] for r in results.column(("ours", "")).records if _timed(r)}
    whole, level = [], []
    for r in filter(_timed, results.records):
        config, theirs, own = r["config"], r["result"], ours.get(_pairing(r))
        if config["method"] == "ours" or not competes(config) or own is None:
            continue
        place = (config["method"], config["variant"]), config["system"]
        whole.append((*place, _own_seconds(theirs) / own["cpu_s"]))
        if own.get("course") and _error(theirs) is not None:
            level.append((*place, _level(theirs, own)))
    made = [
        _speed_table(results, "Speed relative to ours", _SPEED_NOTE, whole),
        _speed_table(results, "Time until ours is as accurate", _LEVEL_NOTE, level),
    ]
    return [table for table in made if table]


def _own_seconds(result: Mapping) -> float:
    """Seconds until a method was near its own best."""
    return _processor(result, result["seconds_to_best"] or result["wall_s"])


def _processor(result: Mapping, seconds: float) -> float:
    """Of the processor instead of the clock, which runs on while others compute."""
    return seconds * result["cpu_s"] / result["wall_s"]


def _error(result: Mapping) -> float | None:
    """A method's own smallest error: on its way, where it tells, or at its end."""
    return result["l2"] if result["best_l2"] is None else result["best_l2"]


def _level(theirs: Mapping, own: Mapping) -> float | None:
    """Ratio of the times to the error that they reach; None if ours never does."""
    enough = NEAR_BEST * _error(theirs)
    reached = next((seconds for seconds, error in own["course"] if error <= enough), None)
    return None if reached is None else _own_seconds(theirs) / _processor(own, reached)


def _speed_table(
    results: Results, title: str, note: str, ratios: list[tuple[Column, str, float | None]]
) -> Table | None:
    there = {c for c, _, _ in ratios}
    columns = [c for c in results.columns if c in there]
    if not columns:
        return None
    names = [s for s in dict.fromkeys(s for s, _ in results.cells) if any(r[1] == s for r in ratios)]
    by_place = {(c, s): [x for d, t, x in ratios if (d, t) == (c, s)] for c in columns for s in names}
    rows = [
        [Cell(name.replace("_", " "), heading=True), *(_ratio([by_place[c, name]]) for c in columns)]
        for name in names
    ]
    every = [_ratio([by_place[c, name] for name in names]) for c in columns]
    rows.append([Cell("geometric mean", heading=True), *every])
    return Table(title, note, ["system", *map(results.title, columns)], rows)


def _timed(record: Mapping) -> bool:
    return record["result"]["finished"] and record["result"]["wall_s"] > 0


def _pairing(record: Mapping) -> tuple:
    """What two runs must share to be compared by time: the problem and the machine."""
    config = {k: v for k, v in record["config"].items() if k not in ("method", "variant")}
    machine = {k: v for k, v in record["machine"].items() if k != "parallel_runs"}
    return (*sorted(config.items()), *sorted(machine.items()))


def _ratio(per_system: Sequence[Sequence[float | None]]) -> Cell:
    """Geometric mean over systems of the geometric means within each; None is counted but left out."""
    there = [[x for x in ratios if x is not None] for ratios in per_system]
    logs = [np.mean(np.log(ratios)) for ratios in there if ratios]
    n, pairs = sum(map(len, there)), sum(map(len, per_system))
    if not pairs:
        return Cell("")
    share = f"{pairs} pair{'s' * (pairs != 1)}"
    detail = share if n == pairs else f"{n} of {share}"
    return Cell(number(float(np.exp(np.mean(logs)))) if logs else "–", detail)
