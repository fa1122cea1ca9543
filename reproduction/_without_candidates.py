"""Methods that are given no candidate terms, side by side: symbolic regression, and ours from names alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from reproduction._results import GIVEN, NAMES, UDSR, Column, Group, Results, best, complete
from reproduction._tables import Cell, Table, number, published

__all__ = ["is_right", "without_candidates"]

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
