"""A sentence for every cell that is not as one would wish, with its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from reproduction._results import Column, Group, Results, complete
from reproduction._tables import number, place, published

__all__ = ["Finding", "findings"]

MISSED = 2.0  # times its published error: the paper's method has not been reproduced in that cell
PAPERS = "the paper's method"


@dataclass(frozen=True)
class Finding:
    """What is to be said of a cell; `remark` is what a person has written about it under `key`."""

    key: str
    text: str
    remark: str = ""


def findings(results: Results, group: Group, paper: Mapping, remarks: Mapping[str, str]) -> list[Finding]:
    """Return where ours is not the best, and where the paper's method, run by us, misses its own numbers.

    Keys are ``ours/<system>/<noise>/<convention>/<library>/<trajectories>``, and the same with ``adam``; a
    remark under a shorter key, cut at a slash, holds for all cells that begin with it.
    """
    chosen = results.of(group).comparable
    found = []
    told = results.of(group).where(method="adam", variant="true-terms", missing=0)
    for system, noise in chosen.cells:
        cell = chosen.where(system=system, noise=noise)
        papers = _papers(cell, group, paper)
        if papers:
            papers += _told(told.where(system=system, noise=noise))
        for method, text in (("ours", _ours(cell, group, paper)), ("adam", papers)):
            if text:
                key = f"{method}/{system}/{noise:g}/{group.convention}/{group.library}/{group.trajectories}"
                found.append(Finding(key, f"{place(system, noise)}: {text}", _remark(key, remarks)))
    return found


def _remark(key: str, remarks: Mapping[str, str]) -> str:
    parts = key.split("/")
    keys = ("/".join(parts[:k]) for k in range(len(parts), 0, -1))
    return next((remarks[k] for k in keys if k in remarks), "")


OURS, ADAM = ("ours", ""), ("adam", "")


def _ours(cell: Results, group: Group, paper: Mapping) -> str:
    """Say by whom ours is beaten, among those that were run and the published; "" if by nobody."""
    own = cell.column(OURS)
    (system, noise) = cell.cells[0]
    columns = [OURS, *(c for c in cell.columns if c != OURS)]
    ran = [cell.column(c) for c in columns]
    full = dict(zip(columns, complete(ran), strict=True))
    errors = {cell.title(c): cell.column(c).mean("l2") for c in columns[1:] if full[c]}
    others = {name: 100 * error for name, error in errors.items() if error is not None}
    rows = {name: published(paper, group, name, system, noise) for name in paper["table1"]["methods"]}
    others |= {f"{name} (published)": row[0] for name, row in rows.items() if row}
    if not own.records or not others:
        return ""
    name = min(others, key=others.__getitem__)
    best = f"{name} has ℓ2 {number(others[name])} × 10⁻²"
    if not full[OURS]:
        return f"{_lost(own, OURS, max(len(r.records) for r in ran))}; {best}."
    error = 100 * own.mean("l2")
    if error <= others[name]:
        return ""
    return (
        f"{_scores(own, OURS)} is not the best: {best}, {number(error / others[name])} times less."
        f"{_against_bound(own)}"
    )


def _papers(cell: Results, group: Group, paper: Mapping) -> str:
    """Say by how much the paper's method, run by us, misses its published error; "" if by less than twice."""
    runs = cell.column(ADAM)
    (system, noise) = cell.cells[0]
    row = published(paper, group, PAPERS, system, noise)
    if not runs.records or not row:
        return ""
    printed = f"{row[0]:.2f} × 10⁻² ({row[1]:g} %, {row[2]:g} %)"
    if not runs.finished:
        return f"{_lost(runs, ADAM, len(runs.records))}; published {printed}."
    error = 100 * runs.mean("l2")
    if error <= MISSED * row[0]:
        return ""
    return (
        f"{_scores(runs, ADAM)}, run here, is {number(error / row[0])} times the published {printed}."
        f"{_spread([100 * r['l2'] for r in runs.finished], MISSED * row[0])}"
    )


def _spread(errors: Sequence[float], reproduced: float) -> str:
    """A mean over runs of which some have lost the law says little of the others."""
    if len(errors) < 2:
        return ""
    good = sum(error <= reproduced for error in errors)
    median, least = number(float(np.median(errors))), number(min(errors))
    return (
        f" Median of the runs {median} × 10⁻², smallest {least} × 10⁻²; {good} of {len(errors)} runs are "
        f"within {MISSED:g} times the published error."
    )


def _told(runs: Results) -> str:
    """Say what the paper's method finds without false candidates."""
    if not runs.finished:
        return ""
    count = f"{len(runs.finished)} run{'s' * (len(runs.finished) != 1)}"
    return f" With the true terms as its only candidates: {number(100 * runs.mean('l2'))} × 10⁻² ({count})."


def _lost(runs: Results, column: Column, most: int) -> str:
    reasons = dict.fromkeys(f"{r['status']}: {r['reason']}" for r in runs.failed)
    why = f" ({'; '.join(reasons)})" if reasons else ""
    return f"{runs.title(column)} has an answer in {len(runs.finished)} of {most} runs{why}"


def _scores(runs: Results, column: Column) -> str:
    count = f"{len(runs.finished)} of {len(runs.records)} runs"
    shares = f"precision {100 * runs.mean('precision'):.3g} %, recall {100 * runs.mean('recall'):.3g} %"
    return f"{runs.title(column)} with ℓ2 {number(100 * runs.mean('l2'))} × 10⁻² ({shares}, {count})"


def _against_bound(runs: Results) -> str:
    ratio = runs.rms("l2_over_crb")
    return "" if ratio is None else f" Its error is {number(ratio)} times the Cramér–Rao bound of the data."
