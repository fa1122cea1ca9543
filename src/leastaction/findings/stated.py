"""The three statements of a verdict, on structure, equations and forecast, and statements of figures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, Protocol, SupportsFloat

from leastaction.findings.finding import UNDECIDED, Finding, fill

__all__ = [
    "STRUCTURES",
    "calibration_open",
    "calibration_remedy",
    "failed",
    "followed",
    "groups_differ",
    "not_converged_remedy",
    "reach",
    "stated_error",
    "statements",
    "usability",
    "with_held_out",
    "worst_share",
]

STRUCTURES: dict[str, tuple[str, ...]] = {
    "not found": ("not-converged", "stopped-early", "mass-matrix-not-finite", "mass-matrix-not-positive"),
    "not among the candidates": (
        *("missing-term", "time-dependent", "form-imitated", "simpler-form", "wrong-known-coefficient"),
        *("energy-fed-in", "negative-dissipation", "swapped-forces"),
    ),
    "not determined by these data": (
        *("hardly-determined", "scale-open", "form-open", "motion-in-noise"),
        *("shape-undetermined", "shape-at-bound", "shape-not-settled"),
    ),
    "one of several that explain the data": ("competing-structures", "another-structure"),
}
"""What findings imply for the structure, the worst first."""
_LITTLE = 1e-3  # of the forces: smaller equation errors have no finding


def statements(findings: Iterable[Finding]) -> dict[str, str]:
    """Summarise findings in a statement each on structure, equations and forecast.

    Examples
    --------
    >>> statements([])
    {'structure': 'determined', 'equations': 'hold to 0.1 % of the forces', 'forecast': 'not tested'}
    """
    found = tuple(findings)
    codes = {finding.code for finding in found}
    structure = next((words for words, some in STRUCTURES.items() if codes & {*some}), "determined")
    runs = _values(found, "forecasts", "forecasts-fail")
    if structure == "determined" and "equations-off" in codes and "forecasts" not in codes:
        structure = "in doubt, since the equations do not hold"
    left = [
        fill("{equation_error:.2g%} of the forces (", finding.values) + ", ".join(finding.subject) + ")"
        for finding in found
        if "equation_error" in finding.values
    ]
    forecast = "not tested"
    if runs is not None:
        forecast = "simulations over " + off_by(runs)
    elif (far := _values(found, "forecast-reach")) is not None:
        forecast = reach(far) + " (by its intervals, not tested)"
    equations = ", ".join(left) or fill("{left:g%} of the forces", {"left": _LITTLE})
    return {"structure": structure, "equations": f"hold to {equations}", "forecast": forecast}


def usability(findings: Iterable[Finding]) -> str:
    """Return what a usable model does and what it leaves open, as the end of a sentence.

    Examples
    --------
    >>> from leastaction.findings import find
    >>> usability([find("forecasts", horizon=0.5, error=0.04)])
    'forecasts over 0.5 s, but its equations hold only to a few per cent'
    """
    found = tuple(findings)
    runs = _values(found, "forecasts")
    over = "" if runs is None else fill(" over {horizon:.2g} s", runs)
    undecided = any(finding.code in UNDECIDED for finding in found)
    more = " and other structures explain the data as well" if undecided else ""
    return f"forecasts{over}, but its equations hold only to a few per cent{more}"


class HeldOut(Protocol):
    """What a statement on held-out trials needs; a `ForecastResult` has it."""

    @property
    def rms_over_std(self) -> Iterable[SupportsFloat]: ...
    @property
    def horizon(self) -> float: ...
    @property
    def n_starts(self) -> int: ...
    @property
    def n_diverged(self) -> int: ...


def worst_share(forecast: HeldOut) -> float:
    """Return the largest error of a coordinate over its spread; NaN if none was measured."""
    return max((share for share in map(float, forecast.rms_over_std) if share == share), default=math.nan)


def with_held_out(said: Mapping[str, str], forecast: HeldOut | None) -> dict[str, str]:
    """Return the statements of a fit with the errors of held-out trials, if these were forecast."""
    if forecast is None:
        return dict(said)
    if forecast.n_diverged:
        starts = "forecast" if forecast.n_starts == 1 else "forecasts"
        text = f"{forecast.n_diverged} of {forecast.n_starts} {starts} of held-out trials diverge"
    else:
        figures = {"off": worst_share(forecast), "horizon": forecast.horizon}
        text = fill("held-out trials are off by {off:.2g%} of the spread over {horizon:.3g} s", figures)
    return {**said, "forecast": text}


def _values(found: Iterable[Finding], *codes: str) -> dict[str, Any] | None:
    return next(({**finding.values} for finding in found if finding.code in codes), None)


def stated_error(f: dict[str, Any]) -> tuple[str, str, str]:
    """Return which trials a simulation error is of, and the names of its figures: of all, of the worst."""
    if f.get("left_out") is None:
        return "fitted trials", "error", "worst"
    return "trials left out of the fit", "left_out", "worst_left_out"


def off_by(f: dict[str, Any]) -> str:
    """State how far simulations are off, of trials left out of the fit where that is known."""
    trials, error, worst = stated_error(f)
    text = f"{{horizon:.2g}} s of {trials} are off by {{{error}:.2g%}} of the spread"
    return fill(text + (f", {{{worst}:.2g%}} in the worst trial" if f.get("trials", 0) > 1 else ""), f)


def followed(f: dict[str, Any]) -> str:
    """State how well simulations follow the data."""
    return "simulations started from states along the data, over " + off_by(f)


def failed(f: dict[str, Any]) -> str:
    """State that coefficients from some trials do not forecast the others."""
    return "the law forecasts only trials that it was fitted to: simulations over " + off_by(f)


def reach(f: dict[str, Any]) -> str:
    """State how far ahead the model forecasts, according to its intervals."""
    within = "forecasts are off by less than {share:.0f%} of the spread for "
    return fill(within + ("{seconds:.2g} s and more" if f["to_the_end"] else "{seconds:.2g} s"), f)


def groups_differ(f: dict[str, Any]) -> str:
    """State which coefficients differ between groups, and by how much."""
    numbers = zip(f["terms"], f["differences"], f["standard_errors"], strict=True)
    changes = ", ".join(f"{term} by {value:+.3g} ± {error:.2g}" for term, value, error in numbers)
    others = len(f["alike"])
    same = "; one other does not" if others == 1 else f"; {others} others do not" if others else ""
    what = (
        "the coefficient of {subject} differs"
        if len(f["subject"]) == 1
        else "the coefficients of {subject} differ"
    )
    return fill(
        what + " between the groups {groups} ({changes}){same}", {**f, "changes": changes, "same": same}
    )


def not_converged_remedy(f: Mapping[str, Any]) -> str:
    """What helps a solver that does not converge; with measurement functions, start values, too."""
    if f.get("calibrated"):
        return "give start values of the calibration numbers, such as {s=800}, or try fewer candidates"
    return "try fewer candidates or a longer recording"


def calibration_open(f: Mapping[str, Any]) -> str:
    """State that a calibration number is open, or where it was when the solver stopped."""
    if f.get("stopped_at") is not None:
        return fill("the calibration number {subject} was {stopped_at:.3g} when the solver stopped", f)
    return fill("the data do not determine the calibration number {subject} (standard error {error:.2g})", f)


def calibration_remedy(f: Mapping[str, Any]) -> str:
    """What makes a calibration number determined, or helps the solver to find it."""
    if f.get("stopped_at") is not None:
        return fill("give a start value near what you expect, such as {{{subject}=1}}, or a range", f)
    return "give it as a number, leave out a candidate that does the same, or offer fewer numbers"
