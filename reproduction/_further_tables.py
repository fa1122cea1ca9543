"""Tables beside those of the paper: seconds against ours, and methods that are given no candidate terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from reproduction._results import GIVEN, NAMES, UDSR, Column, Group, Results, best, competes, complete
from reproduction._tables import Cell, Table, number, published
from reproduction.scoring import NEAR_BEST

# ------------------------------------------------------------- seconds of the methods against seconds of ours
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
        if own.get("course") and _l2(theirs) is not None:
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


def _l2(result: Mapping) -> float | None:
    """A method's own smallest error: on its way, where it tells, or at its end."""
    return result["l2"] if result["best_l2"] is None else result["best_l2"]


def _level(theirs: Mapping, own: Mapping) -> float | None:
    """Ratio of the times to the error that they reach; None if ours never does."""
    enough = NEAR_BEST * _l2(theirs)
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


# ----------------------------------------- without candidates: symbolic regression, and ours from names alone
RIGHT = 0.001  # equation error of an expression, without noise, below which its form is called right
LONGEST = 160  # characters of an expression that are printed

_HEADS: dict[Column, str] = {
    ("ours", ""): "leastaction, compact candidates",
    ("ours", NAMES): "leastaction, names alone",
    ("operon", ""): "Operon, positions",
    ("operon", GIVEN): "Operon, given q̇, q̈",
    (UDSR, ""): "uDSR as released",
    (UDSR, "poly"): "uDSR as released, polynomial",
    (UDSR, "repaired"): "uDSR repaired",
    (UDSR, "repaired-poly"): "uDSR repaired, polynomial",
}
_ASKED = [column for column in _HEADS if column not in (("ours", ""), ("operon", ""))]

_NOTE = (
    "Relative rms error of q̈ along two new motions, each coordinate in units of its own rms, mean over "
    "the trials; in brackets, the horizon of a simulation in seconds, as in the other tables, and the "
    "status of the result unless it is “ok”. The form of a Lagrangian is right if its terms are the true "
    f"ones. The form of an expression is judged on data without noise, by an error below {100 * RIGHT:g} %: "
    "with noise, a right form with inaccurate numbers cannot be distinguished from an imitation. All "
    "methods have the same trials. Operon and uDSR search an expression q̈ᵢ(q, q̇, f) for each "
    "coordinate; ours searches a Lagrangian, from the compact candidates or from candidates generated "
    "from the names of the coordinates (--library symbolic). Operon has rates smoothed from the "
    "positions, or is given exact velocities and accelerations plus noise of the level, as uDSR always "
    "is. uDSR is the authors' code (PyTorch port), stopped after 45 s of processor time per coordinate. "
    "As released, its genetic programming changes nothing; repaired, it does; polynomial: with its token "
    "of a cubic polynomial. An empty cell was not run. In italics, ℓ2 × 10⁻² and precision / recall that "
    "the paper publishes for uDSR. It states neither the target of the regression nor the settings, and "
    "expressions of q̈ have no coefficients of a Lagrangian, so these numbers cannot be checked here."
)
_COST_NOTE = (
    "Mean over the trials, all coordinates together, one thread, including processes that a method starts."
)
_FOUND_NOTE = (
    "First trial of each system at the smallest noise; for ours, the terms of L that are not given. Long "
    "expressions are cut; the records have the complete ones."
)


def without_candidates(results: Results, group: Group, paper: Mapping) -> list[Table]:
    """Return error, cost and laws of the runs without candidates; nothing if a group has none."""
    runs = results.of(group).where(lambda c: c["missing"] == 0 and (c["method"], c["variant"]) in _HEADS)
    asked = runs.where(lambda c: (c["method"], c["variant"]) in _ASKED)
    if not asked.records:
        return []
    pairs = {(c["system"], c["noise"], c["trial"]) for c in (r["config"] for r in asked.records)}
    runs = runs.where(lambda c: (c["system"], c["noise"], c["trial"]) in pairs)
    columns = [column for column in _HEADS if runs.column(column).records]
    return [_errors(runs, columns, group, paper), _cost(runs, columns), _found(asked)]


def _errors(runs: Results, columns: list[Column], group: Group, paper: Mapping) -> Table:
    def fill(system: str, noise: float, ran: list[Results]) -> list[Cell]:
        values = [r.mean("equation_error") for r in ran]
        top = best([v if full else None for v, full in zip(values, complete(ran), strict=True)])
        cells = [Cell(_error(r), _detail(r), k in top) for k, r in enumerate(ran)]
        printed = published(paper, group, "uDSR", system, noise)
        return [*cells, Cell(f"{printed[0]:.2f}", f"{printed[1]:g}/{printed[2]:g}") if printed else Cell("")]

    table = _grid("Symbolic regression, and ours from names alone", _NOTE, runs, columns, fill)
    judged = [
        [right for right in map(is_right, cells) if right is not None] for cells in _of_cells(runs, columns)
    ]
    total = [Cell(f"{sum(rights)} of {len(rights)}") for rights in judged]
    rows = [*table.rows, [Cell("right form", heading=True), Cell("", heading=True), *total, Cell("")]]
    return Table(table.title, table.note, [*table.head, "uDSR, published"], rows, 1)


def _cost(runs: Results, columns: list[Column]) -> Table:
    def fill(system: str, noise: float, ran: list[Results]) -> list[Cell]:
        return [Cell(number(r.mean("cpu_s")) if r.records else "") for r in ran]

    return _grid("Processor time of symbolic regression, s", _COST_NOTE, runs, columns, fill)


def _grid(title: str, note: str, runs: Results, columns: list[Column], fill: Callable) -> Table:
    """One row a system and noise level, one column a method."""
    rows, last = [], ""
    for system, noise in runs.cells:
        cell = runs.where(system=system, noise=noise)
        first, last = ("" if system == last else system.replace("_", " ")), system
        heading = [Cell(first, heading=True), Cell(f"{100 * noise:g} %", heading=True)]
        rows.append([*heading, *fill(system, noise, [cell.column(c) for c in columns])])
    return Table(title, note, ["system", "noise", *(_HEADS[c] for c in columns)], rows)


def _of_cells(runs: Results, columns: list[Column]) -> list[list[Results]]:
    """Return the cells of each column that were run."""
    of = [[runs.column(c).where(system=s, noise=x) for s, x in runs.cells] for c in columns]
    return [[cell for cell in cells if cell.records] for cells in of]


def is_right(runs: Results) -> bool | None:
    """Tell whether every run has found the form of the law; None where its scores do not say it.

    A Lagrangian is right if its terms are exactly the true ones. An expression is judged by its error on data
    without noise: imitations have been seen with 0.2 %, a right form has less than 0.02 %.
    """
    if len(runs.finished) < len(runs.records):
        return False
    if all(r["exact"] is not None for r in runs.finished):
        return all(r["exact"] for r in runs.finished)
    if any(r["config"]["noise"] for r in runs.records):
        return None
    errors = [r["equation_error"] for r in runs.finished]
    return all(e is not None and e < RIGHT for e in errors)


def _error(runs: Results) -> str:
    if not runs.records:
        return ""
    return number(runs.mean("equation_error")) if runs.finished else runs.failed[0]["status"]


def _detail(runs: Results) -> str:
    if not runs.finished:
        return ""
    said = [r["status"] for r in runs.finished if r["status"] != "ok"]
    parts = ["right form"] if is_right(runs) else []
    return ", ".join([*parts, f"{number(runs.mean('forecast_horizon'))} s", *dict.fromkeys(said)])


def _found(asked: Results) -> Table:
    """The laws themselves, where there is least noise: a reader sees which form is right."""
    rows, last = [], ""
    for system in dict.fromkeys(name for name, _ in asked.cells):
        noise = min(x for name, x in asked.cells if name == system)
        cell = asked.where(system=system, noise=noise)
        for column in _ASKED:
            for record in cell.column(column).records[:1]:
                first, last = ("" if system == last else system.replace("_", " ")), system
                rows.append([Cell(first, heading=True), Cell(_HEADS[column]), Cell(_law(record["result"]))])
    return Table("What they found", _FOUND_NOTE, ["system", "method", "law"], rows)


def _law(result: Mapping) -> str:
    if not result["finished"]:
        return result["status"]
    if result["coefficients"] is not None:
        terms = " ".join(f"{x:+.4g}*{text}" for text, x in result["coefficients"].items())
        return _cut(f"L = {terms.removeprefix('+')}")
    return "; ".join(map(_cut, result["expression"].split("\n")))


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} … ({len(text)} characters)"
