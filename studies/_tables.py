"""Records → tables, as title, head and rows of texts; nothing here reads or writes files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import binomtest

from studies.said import sentences_in

__all__ = ["Table", "cells", "failures", "median", "number", "percent", "share", "support_table"]

Records = Sequence[dict]


@dataclass(frozen=True)
class Table:
    """What one Markdown table shows."""

    title: str
    head: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    note: str = ""

    def markdown(self) -> str:
        """Return the table under its title."""
        lines = [f"## {self.title}", ""]
        if self.note:
            lines += [self.note, ""]
        lines.append("| " + " | ".join(self.head) + " |")
        lines.append("|" + "---|" * len(self.head))
        lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in self.rows]
        return "\n".join(lines)


def number(value: float | None, form: str = ".2g") -> str:
    return "–" if value is None or not np.isfinite(value) else format(value, form)


def median(values: Iterable[float | None]) -> float | None:
    """Median of what is there."""
    there = [v for v in values if v is not None]
    return float(np.median(there)) if there else None


def percent(level: float) -> str:
    return f"{100 * level:g} %"


def share(hits: Iterable[bool]) -> str:
    """Return "hits/all"."""
    hits = list(hits)
    return f"{sum(hits)}/{len(hits)}"


def binomial(hits: int, n: int) -> str:
    """A share in percent with its 95 % interval (Wilson)."""
    if not n:
        return "–"
    interval = binomtest(hits, n).proportion_ci(method="wilson")
    return f"{100 * hits / n:.1f} ({100 * interval.low:.1f}–{100 * interval.high:.1f})"


def cells(records: Records, key: Callable[[dict], tuple]) -> dict[tuple, list[dict]]:
    """Group records by a key of their configuration, in the sequence in which the keys first come."""
    groups: dict[tuple, list[dict]] = {}
    for r in records:
        groups.setdefault(key(r["config"]), []).append(r)
    return groups


def results(records: Records) -> list[dict]:
    """Return the results of runs with a model; the others have no scores."""
    return [r["result"] for r in records if r["result"]["finished"] and r["result"]["status"] != "no model"]


def title_of(name: str) -> str:
    return name.replace("_", " ")


_SUPPORT = (
    *("system", "noise", "exact", "precision %", "recall %", "median ℓ2", "median ℓ2 / CRB", "covered"),
    *("ok", "ok and wrong", "no model", "failed", "median s", "longest s", "median CPU s"),
)


def support_table(title: str, records: Records, note: str = "") -> Table:
    """One row a system and noise level, and one for all of them."""
    rows = [
        (title_of(system), percent(noise), *_support_row(group))
        for (system, noise), group in cells(records, lambda c: (c["system"], c["noise"])).items()
    ]
    rows.append(("all", "", *_support_row(records)))
    return Table(title, _SUPPORT, rows, note)


def _support_row(records: Records) -> tuple[str, ...]:
    found = results(records)
    run = [r["result"] for r in records]
    seconds = [r["wall_s"] for r in run if "wall_s" in r]
    return (
        share(r.get("exact", False) for r in run),
        number(100 * np.mean([r["precision"] for r in found]) if found else None, ".1f"),
        number(100 * np.mean([r["recall"] for r in found]) if found else None, ".1f"),
        number(median(r["l2"] for r in found)),
        number(median(r.get("l2_over_crb") for r in found), ".2f"),
        f"{sum(r['covered'] for r in found)}/{sum(len(r['terms']) for r in found)}",
        share(r["status"] == "ok" for r in run),
        str(sum(r["status"] == "ok" and not r["exact"] for r in run)),
        str(sum(r["status"] == "no model" for r in run)),
        str(sum(not r["finished"] for r in run)),
        number(median(seconds), ".1f"),
        number(max(seconds, default=None), ".1f"),
        number(median(r.get("cpu_s") for r in run), ".1f"),
    )


def failures(records: Records) -> Table:
    """Every run whose support is not exact, with what is wrong."""
    rows = []
    for r in records:
        config, result = r["config"], r["result"]
        if result.get("exact", False):
            continue
        rows.append(
            (
                title_of(config["system"]),
                percent(config["noise"]),
                config["setup"],
                f"{config['library']}, {config['rate']:g} Hz",
                str(config["seed"]),
                result["status"],
                ", ".join(f"`{p}`" for p in result.get("spurious", {})) or "–",
                ", ".join(f"`{p}`" for p in result.get("missed", {})) or "–",
                number(result.get("wall_s"), ".0f"),
                "; ".join(short(text) for text in sentences_in(result, "warning"))
                or result.get("reason", ""),
            )
        )
    head = ("system", "noise", "set-up", "library", "seed", "status", "spurious", "missed", "s", "warnings")
    return Table(f"Runs whose support is not exact ({len(rows)} of {len(records)})", head, rows)


def short(text: str, length: int = 90) -> str:
    """Return the beginning of a text."""
    return text if len(text) <= length else text[: length - 1].rstrip() + "…"
