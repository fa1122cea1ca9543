"""From records to tables: what stands in which cell, and which cell is the best of its row."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from reproduction._results import EXPERIMENTS, NO_REGULARISATION, Column, Group, Results, best, complete

__all__ = ["Cell", "Table", "ablation", "experiments", "group_tables", "number", "place", "published"]


@dataclass(frozen=True)
class Cell:
    """Text of a cell, a second smaller line, and whether it is the best of its row."""

    text: str
    detail: str = ""
    best: bool = False
    heading: bool = False


@dataclass(frozen=True)
class Table:
    """A table with a line that says how to read it; its last `borrowed` columns are the paper's."""

    title: str
    note: str
    head: Sequence[str]
    rows: list[list[Cell]] = field(default_factory=list)
    borrowed: int = 0


def number(value: float | None) -> str:
    """Three significant digits, for people; "–" for nothing."""
    if value is None:
        return "–"
    size = abs(value)
    if value == 0 or 1e-3 <= size < 1e4:
        digits = 2 if value == 0 else max(0, 2 - int(np.floor(np.log10(size))))
        return f"{value:.{min(digits, 4)}f}"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}".replace("-", "−")


def place(system: str, noise: float) -> str:
    return f"{system.replace('_', ' ').capitalize()}, {100 * noise:g} % noise"


def published(paper: Mapping, group: Group, method: str, system: str, noise: float) -> list[float] | None:
    """Return the paper's (ℓ2 × 10⁻², P, R) of a cell; its library is the compact one."""
    table = paper["table1"]
    if group.library != "compact" or noise not in table["noise"]:
        return None
    row = table["methods"][method].get(system)
    return row[table["noise"].index(noise)] if row else None


def group_tables(results: Results, group: Group, paper: Mapping) -> list[Table]:
    """Return the tables of one group of runs with complete data: accuracy, forecasts, cost, runs."""
    chosen = results.of(group).comparable
    if not chosen.records:
        return []
    tables = [_accuracy(chosen, group, paper)]
    tables += [_metric(chosen, kind) for kind in _KINDS if chosen.mean(kind.name) is not None]
    return [*tables, *_coverage(chosen), _runs(chosen)]


_ACCURACY_NOTE = (
    "ℓ2 error of the coefficients × 10⁻², mean over the trials; in brackets, precision / recall in per "
    "cent. Columns in italics are the paper's published numbers. If a trial is missing or failed, the "
    "number of runs is given, and the cell cannot be the best. Methods that find equations of motion "
    "without a Lagrangian have no such error; other tables include them."
)


def _exact(runs: Results) -> str:
    exact = runs.total("exact")
    return "" if exact is None else f"{exact}/{len(runs.records)} exact"


@dataclass(frozen=True)
class _Kind:
    """A table of one score."""

    title: str
    name: str
    note: str
    largest: bool = False  # the largest is the best
    detail: Callable[[Results], str] = lambda runs: ""
    average: Callable[[Results, str], float | None] = Results.mean


_KINDS = (
    _Kind(
        "Error relative to the Cramér–Rao bound",
        "l2_over_crb",
        "ℓ2 error divided by the Cramér–Rao bound of the same data (noisy positions, true terms), root mean "
        "square over the trials; in brackets, the number of runs with exactly the true terms. An estimate "
        "that reaches the bound has about 1, in five trials between 0.4 and 1.6. Methods that are also "
        "given noisy velocities and accelerations have more data than the bound assumes.",
        detail=_exact,
        average=Results.rms,
    ),
    _Kind(
        "Equation error",
        "equation_error",
        "Relative rms error of q̈ along two new motions of 20 s, each coordinate in units of its own rms; "
        "mean over the trials.",
    ),
    _Kind(
        "Forecast horizon, s",
        "forecast_horizon",
        "Time for which a simulation from the exact initial state of these motions stays within 10 % of "
        "each coordinate's standard deviation; 20 s is the whole motion; mean over the trials.",
        largest=True,
    ),
    _Kind(
        "Wall time, s",
        "wall_s",
        "Of the method only, one thread, without simulation and scoring; mean over the trials. In brackets, "
        "the processor time, which is shorter if other runs kept the machine busy.",
        detail=lambda runs: f"CPU {number(runs.mean('cpu_s'))}",
    ),
    _Kind(
        "Peak memory, MB",
        "peak_mb",
        "Of the whole process of a run, with Python and the loaded packages; mean over the trials.",
    ),
)


def _rows(results: Results, fill: Callable[[str, float], list[Cell]]) -> list[list[Cell]]:
    rows, last = [], ""
    for system, noise in results.cells:
        first = "" if system == last else system.replace("_", " ")
        rows.append(
            [Cell(first, heading=True), Cell(f"{100 * noise:g} %", heading=True), *fill(system, noise)]
        )
        last = system
    return rows


def _with_coefficients(results: Results) -> list[Column]:
    """Return the columns but those whose answers never are Lagrangians of the library's terms."""
    runs = {c: results.column(c) for c in results.columns}
    return [c for c, r in runs.items() if not r.finished or r.mean("l2") is not None]


def _accuracy(results: Results, group: Group, paper: Mapping) -> Table:
    columns, names = _with_coefficients(results), list(paper["table1"]["methods"])
    if group.library != "compact":
        names = []

    def fill(system: str, noise: float) -> list[Cell]:
        cell = results.where(system=system, noise=noise)
        ran = [cell.column(c) for c in columns]
        most = max((len(r.records) for r in ran), default=0)
        printed = [published(paper, group, name, system, noise) for name in names]
        errors = [
            _hundredfold(r.mean("l2")) if full else None for r, full in zip(ran, complete(ran), strict=True)
        ]
        top = best(errors + [p and p[0] for p in printed])
        texts = [_measured(r, most) for r in ran] + [_printed(p) for p in printed]
        return [Cell(text, detail, k in top) for k, (text, detail) in enumerate(texts)]

    head = ["system", "noise", *map(results.title, columns), *(f"{name}, published" for name in names)]
    return Table("Accuracy", _ACCURACY_NOTE, head, _rows(results, fill), len(names))


def _hundredfold(value: float | None) -> float | None:
    return None if value is None else 100 * value


def _measured(runs: Results, most: int) -> tuple[str, str]:
    """Text and detail of ℓ2 with precision and recall; or why there is no number."""
    if not runs.records:
        return "", ""
    share = f"{len(runs.finished)} of {most} runs" if len(runs.finished) < most else ""
    if not runs.finished:
        return runs.failed[0]["status"], share
    if runs.mean("l2") is None:
        return "–", share
    scores = "/".join(f"{100 * runs.mean(name):.3g}" for name in ("precision", "recall"))
    return number(100 * runs.mean("l2")), f"{scores}; {share}" if share else scores


def _printed(values: Sequence[float] | None) -> tuple[str, str]:
    return (f"{values[0]:.2f}", f"{values[1]:g}/{values[2]:g}") if values else ("", "")


def _metric(results: Results, kind: _Kind) -> Table:
    columns = [c for c in results.columns if results.column(c).mean(kind.name) is not None]

    def fill(system: str, noise: float) -> list[Cell]:
        cell = results.where(system=system, noise=noise)
        ran = [cell.column(c) for c in columns]
        values = [kind.average(r, kind.name) for r in ran]
        top = best([v if full else None for v, full in zip(values, complete(ran), strict=True)], kind.largest)
        return [
            Cell(number(v) if r.records else "", kind.detail(r) if r.finished else "", k in top)
            for k, (r, v) in enumerate(zip(ran, values, strict=True))
        ]

    there = Results([r for r in results.records if r["result"].get(kind.name) is not None])
    return Table(kind.title, kind.note, ["system", "noise", *map(results.title, columns)], _rows(there, fill))


_COVERAGE_NOTE = (
    "Share of the 95 % intervals of true terms that contain the true value, over all trials. Errors of the "
    "coefficients of a run are correlated, so these few runs say little; studies/tables.md has 200 runs of "
    "each system and level."
)


def _coverage(results: Results) -> list[Table]:
    columns = [c for c in results.columns if results.column(c).total("intervals")]
    if not columns:
        return []

    def fill(system: str, noise: float) -> list[Cell]:
        cell = results.where(system=system, noise=noise)
        sums = [(r.total("covered"), r.total("intervals")) for r in map(cell.column, columns)]
        return [Cell(f"{inside} of {n}" if n else "–") for inside, n in sums]

    head = ["system", "noise", *map(results.title, columns)]
    return [Table("Error bars", _COVERAGE_NOTE, head, _rows(results, fill))]


def _runs(results: Results) -> Table:
    """Trials and failures of each method, and what the failures say."""
    rows = []
    for column in results.columns:
        runs = results.column(column)
        reasons = list(dict.fromkeys(f"{f['status']}: {f['reason']}" for f in runs.failed))
        doubts = [r["status"] for r in runs.finished if r["status"] != "ok"]
        rows.append(
            [
                Cell(results.title(column), heading=True),
                Cell(str(len({r["config"]["trial"] for r in runs.records}))),
                Cell(str(len(runs.finished))),
                Cell(str(len(runs.failed))),
                Cell(str(len(doubts))),
                Cell("; ".join(reasons[:3])),
            ]
        )
    note = "A run is not “ok” in the method's own words if it returned an answer and a warning with it."
    return Table("Runs", note, ["method", "trials", "finished", "failed", "not “ok”", "reasons"], rows)


def ablation(results: Results, group: Group, paper: Mapping) -> Table | None:
    """Return table 2: A complete data, B samples missing at random, C without the regularisation J_reg."""
    chosen = results.of(group)
    shares = sorted({c["missing"] for c in (r["config"] for r in chosen.records) if c["missing"] > 0})
    parts = {"A": ("", 0.0), "C": (NO_REGULARISATION, 0.0)}
    parts |= {f"B {100 * share:g} %" if len(shares) > 1 else "B": ("", share) for share in shares}
    pick: list[tuple[Column, str, float]] = [
        ((method, variant), part, share)
        for method in ("ours", "adam")
        for part, (variant, share) in sorted(parts.items())
        if chosen.where(method=method, variant=variant, missing=share).records
    ]
    if all(part == "A" for _, part, _ in pick):
        return None
    extra = chosen.where(
        lambda c: any((c["method"], c["variant"]) == p[0] and c["missing"] == p[2] for p in pick)
    )
    asked = {
        (c["system"], c["noise"])
        for c in (r["config"] for r in extra.records)
        if c["missing"] or c["variant"]
    }
    shown = extra.where(lambda c: (c["system"], c["noise"]) in asked)
    names = list(paper["table2"]["parts"]) if group.library == "compact" else []

    def fill(system: str, noise: float) -> list[Cell]:
        cell = shown.where(system=system, noise=noise)
        runs = [cell.column(c).where(missing=share) for c, _, share in pick]
        ran = [_measured(r, max(len(x.records) for x in runs)) for r in runs]
        same = noise == paper["table2"]["noise"]
        printed = [_printed(paper["table2"]["parts"][n].get(system) if same else None) for n in names]
        return [Cell(*pair) for pair in (*ran, *printed)]

    own = {method: results.title((method, "")) for method in ("ours", "adam")}
    head = [f"{own[column[0]]}: {part}" for column, part, _ in pick] + [f"published: {n}" for n in names]
    note = (
        "ℓ2 error × 10⁻² and precision / recall: A complete data, B "
        f"{', '.join(f'{100 * s:g} %' for s in shares) or 'some'} of the samples missing at random, "
        "C complete data without the term J_reg of the paper's loss, which only that method has."
    )
    return Table(
        "Missing samples, and no regularisation",
        note,
        ["system", "noise", *head],
        _rows(shown, fill),
        len(names),
    )


_EXPERIMENTS_NOTE = (
    "ℓ2 error × 10⁻² and precision / recall of the paper's method, mean over the trials: as in the other "
    "tables, and with information that a user does not have. from-truth starts at the true coefficients; "
    "true-terms has only the true terms as candidates. The settings are the same."
)


def experiments(results: Results, group: Group, paper: Mapping) -> Table | None:
    """Return what the paper's method finds when it is told the truth: what keeps it from its own numbers."""
    runs = results.of(group).where(lambda c: c["missing"] == 0, method="adam")
    told = [v for v in EXPERIMENTS if runs.where(variant=v).records]
    if not told:
        return None
    asked = {(c["system"], c["noise"]) for c in (r["config"] for r in runs.records) if c["variant"] in told}
    shown = runs.where(lambda c: (c["system"], c["noise"]) in asked and c["variant"] in ("", *told))

    def fill(system: str, noise: float) -> list[Cell]:
        cell = shown.where(system=system, noise=noise)
        ran = [cell.where(variant=v) for v in ("", *told)]
        most = max(len(r.records) for r in ran)
        printed = _printed(published(paper, group, "the paper's method", system, noise))
        return [Cell(*pair) for pair in (*(_measured(r, most) for r in ran), printed)]

    head = ["system", "noise", "as in the tables", *told, "published"]
    return Table("Experiments with the paper's method", _EXPERIMENTS_NOTE, head, _rows(shown, fill), 1)
