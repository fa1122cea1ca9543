"""What the model of a record says of itself, and records as tables: title, head and rows of texts.

Nothing here reads or writes files.  A record has ``findings``.  One from before checks had codes has the
texts of ``warnings`` and ``notes`` instead, in the wording of its version, which does not follow
`leastaction.findings.messages`: it is read here and nowhere else.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import binomtest

from leastaction.findings import Finding, Severity
from studies.faults import causes_named

__all__ = [
    "Table",
    "causes_in",
    "cells",
    "code_of",
    "codes_in",
    "failures",
    "findings_in",
    "median",
    "number",
    "percent",
    "sentences_in",
    "share",
    "support_table",
]


def findings_in(result: Mapping) -> tuple[Finding, ...]:
    """Return the findings of a run; none where there was no model."""
    if "findings" not in result:
        return _old_findings(result)
    return tuple(Finding.from_dict(entry) for entry in result["findings"])


def causes_in(result: Mapping, severity: Severity) -> list[str]:
    """Return the causes that warnings, or notes, name."""
    return causes_named(finding for finding in findings_in(result) if finding.severity == severity)


def codes_in(result: Mapping) -> list[str]:
    """Return the codes of all findings, each once."""
    return list(dict.fromkeys(finding.code for finding in findings_in(result)))


def sentences_in(result: Mapping, severity: Severity) -> list[str]:
    """Return the warnings, or notes, in words, each once."""
    found = (str(finding) for finding in findings_in(result) if finding.severity == severity)
    return list(dict.fromkeys(found))


# ------------------------------------------------------------- records from before checks had codes

_SENTENCES = (
    ("the solver did not converge", "not-converged"),
    ("the library cannot explain the measured ", "rate-unexplained"),
    ("the library cannot explain ", "equations-off"),
    ("the library seems to lack ", "missing-term"),
    ("friction seems to act on ", "unmodelled-friction"),
    ("energy seems to be fed in along ", "energy-fed-in"),
    ("the known coefficient of ", "wrong-known-coefficient"),
    ("the forces seem to act about ", "late-forces"),
    ("the forces seem to be ", "scaled-forces"),
    ("the forces on .* seem to be swapped", "swapped-forces"),
    ("the measured .* is constant", "rate-constant"),
    ("the measured .* hardly follows", "rate-unrelated"),
    (r"the measured .* is \S+ times the derivative", "rate-scaled"),
    ("the measured .* has an offset", "rate-offset"),
    (r"\S+ % of the spread of .* looks like noise", "looks-like-noise"),
    ("sampling is slow", "slow-sampling"),
    ("the motion of .* hardly shows above its noise", "motion-in-noise"),
    ("these data hardly determine ", "hardly-determined"),
    ("these data cannot tell ", "competing-structures"),
    ("the mass matrix is not finite", "mass-matrix-not-finite"),
    ("the mass matrix is not positive definite", "mass-matrix-not-positive"),
    ("the dissipation term .* came out negative", "negative-dissipation"),
    (r"\d+ jumps of 2π removed from ", "angle-unwrapped"),
    ("forces on .* were left out: the motion there is prescribed", "forces-unused"),
    (r"\d+ samples of .* are outliers", "outliers-left-out"),
    (r"abs\(\) of velocities is smoothed", "friction-smoothed"),
    ("the equation of .* no more than the scatter of those that were given", "scatter-of-forces"),
    ("the equation of .* of its forces unexplained", "equation-error"),
    ("residuals of .* are correlated from sample to sample", "correlated-residuals"),
    ("coefficients still moved when the knots were refined", "knots-not-settled"),
    ("the equations hold to some per cent only", "coefficients-of-free-runs"),
    ("a force on .* was looked for", "slow-force"),
    (r"(velocity|acceleration) of \S+: noise ", "rate-noise"),
    (r"\S+ covers \S+ within a recording", "angle-in-degrees"),
    (r"\S+ jumps by about 2π \d+ times", "undeclared-angle"),
    (".* with its sine reads as a zero offset", "zero-offset"),
)


def code_of(text: str) -> str:
    """Return the code of an old sentence, ``"text"`` if it is none of them.

    >>> code_of("the library cannot explain x: the equation is off by 2.0 % of its forces")
    'equations-off'
    """
    return next((code for beginning, code in _SENTENCES if re.match(beginning, text)), "text")


def _old_findings(result: Mapping) -> tuple[Finding, ...]:
    """Return what an old record says, without subjects; of the figures only what tells causes apart."""
    severities: tuple[tuple[str, Severity], ...] = (("warnings", "warning"), ("notes", "note"))
    return tuple(_finding(text, severity) for entry, severity in severities for text in result.get(entry, ()))


def _finding(text: str, severity: Severity) -> Finding:
    forces = re.search(r"or the forces are (\S+) times too large", text)
    values = {"force_factor": float(forces[1])} if forces else {}
    return Finding(code_of(text), severity, values=values, message=text)


# ------------------------------------------------------------------------------------------- records → tables
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
