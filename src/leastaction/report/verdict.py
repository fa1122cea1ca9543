"""The head of the report: status, warnings, reservations, remedies, and the key figures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from leastaction.findings import (
    STATED,
    Finding,
    alike,
    as_given,
    stated_error,
    with_held_out,
    worst_share,
)
from leastaction.model.mathml import Notation
from leastaction.model.model import LagrangianModel
from leastaction.model.term import as_float
from leastaction.report.captions import departures
from leastaction.report.series import Series
from leastaction.report.text import listed, percent, plain, plural
from leastaction.simulation.forecast import ForecastResult

__all__ = ["contradictions", "in_symbols", "not_noise", "terms_in", "unlike_noise", "verdict"]

_HELD = 0.9
"""Share of held-out samples in the 95 % band below which forecasts contradict the standard errors."""
_FAR = 0.2
"""Forecast error over spread above which a forecast without a band contradicts a fit that is ok."""
_LETTERS = frozenset("bcdefghijklmnopqrstuvwxyzABCDEFGHJKLMNOPQRSTUVWXYZ")
"""Names of one letter, except the words "a" and "I"."""
_PREPARED = frozenset(
    {
        *(
            "time-unit",
            "dates",
            "converted-units",
            "units-row",
            "decimal-comma",
            "first-sheet",
            "text-encoding",
        ),
        *("angle-unwrapped", "forces-unused", "rates-unused", "outliers-left-out"),
        *("friction-smoothed", "undefined-candidates", "rate-noise", "groups-alike", "text"),
    }
)
"""Notes on changes to the data; all other notes qualify the result."""


def verdict(model: LagrangianModel, validation: ForecastResult | None, notation: Notation) -> dict[str, Any]:
    """Content of the first section."""
    findings = model.fit.findings
    notes = [f for f in findings if f.severity == "note"]
    words = terms_in(model, findings)
    ok = model.fit.status == "ok"
    against = contradictions(validation) if ok else []
    deviating = unlike_noise(model)
    said: dict[str, list[Markup]] = {
        key: [_in_words(group, notation, words) for group in alike(some)]
        for key, some in {
            "reservations": [f for f in notes if f.code not in _PREPARED and f.code not in STATED],
            "prepared": [f for f in notes if f.code in _PREPARED],
        }.items()
    }
    coloured = [f for f in notes if f.code == "correlated-residuals" and f.values["quantity"] == "position"]
    noted = {name for f in coloured for name in f.subject}
    if unsaid := [name for name in deviating if name not in noted]:
        said["reservations"].append(in_symbols(not_noise(unsaid), notation, words))
    return {
        "status": model.fit.status,
        "tone": "doubtful" if against else "usable" if ok and deviating else model.fit.status,
        "against": against,
        "deviating": bool(deviating),
        "warnings": [
            (in_symbols(f.message, notation, words), in_symbols(f.remedy, notation, words))
            for f in findings
            if f.severity == "warning"
        ],
        **said,
        "statements": [
            (name.capitalize(), in_symbols(text, notation, words))
            for name, text in with_held_out(model.fit.statements, validation).items()
        ],
        "forecast": validation is not None,
        "forecasts": _free_runs(model),
        "facts": [*_forecast_facts(validation), *_fit_facts(model, notation), *_size_facts(model)],
    }


def in_symbols(text: str, notation: Notation, terms: Iterable[str] = ()) -> Markup:
    """A sentence with its coordinates, velocities and terms as mathematics.

    Text in quotes or after an equals sign is code and is not changed. Neither is a name that is a word, such
    as ``angle``. A coordinate with a plain name of its own (`Notation`) has this name.

    Examples
    --------
    >>> in_symbols("q < 1", Notation(["q"])).endswith("</math> &lt; 1")
    True
    >>> print(in_symbols("angles=['theta']", Notation(["theta"])))
    angles=[&#39;theta&#39;]
    >>> print(in_symbols("offer '(x-h)**2'", Notation(["x"])))
    offer &#39;(x-h)**2&#39;
    >>> print(in_symbols("the force on a_1", Notation(["a_1"], written={"a_1": "arm (1)"})))
    the force on arm (1)
    """
    names = [name for name in notation.coordinates if notation.text(name) != name or name in _LETTERS]
    rates = [f"{name}{ending}" for name in notation.coordinates for ending in ("_dot_dot", "_dot")]
    words = sorted({*terms, *rates, *names}, key=len, reverse=True)
    code = r"(?<!\w)(['\"])[^'\"\s]+\1"
    pattern = re.compile(rf"{code}|(?<![\w'\"=.])(?:{'|'.join(map(re.escape, words))})(?![\w'\"=(]|\*\*)")
    parts, at = [], 0
    for found in pattern.finditer(text):
        if found[1]:
            continue
        name = notation.written.get(found[0])
        parts += [escape(text[at : found.start()]), notation.term(found[0]) if name is None else escape(name)]
        at = found.end()
    return Markup("").join([*parts, escape(text[at:])])


def terms_in(model: LagrangianModel, findings: Iterable[Finding]) -> set[str]:
    """Terms that a sentence may name: of the law, of competing structures, and subjects of findings."""
    path = () if model.diagnostics is None else model.diagnostics.path
    texts = {t.written for t in (*model.terms, *model.dissipation)}
    texts |= {text for point in path for text in point.written}
    texts |= {text for finding in findings for text in finding.subject if re.search(r"[*(]", text)}
    widths = model.fit.smoothing_widths
    return texts | {as_given(text, widths) for text in texts}


def _in_words(findings: list[Finding], notation: Notation, terms: Iterable[str]) -> Markup:
    message, remedy = "; ".join(f.message for f in findings), findings[0].remedy
    return in_symbols(f"{message}: {remedy}" if remedy else message, notation, terms)


def contradictions(result: ForecastResult | None) -> list[str]:
    """Contradictions between a fit that is ok and forecasts of held-out trials."""
    if result is None:
        return []
    if result.n_diverged:
        starts = plural(result.n_starts, "forecast", "forecasts")
        return [f"{result.n_diverged} of {starts} of held-out trials diverged"]
    inside = result.coverage[np.isfinite(result.coverage)]
    if inside.size and inside.min() < _HELD:
        share = percent(float(inside.min()))
        return [f"only {share} of the samples of held-out trials lie in the band that should hold 95 %"]
    ratios = (result.rms / result.expected_rms)[np.isfinite(result.rms)]
    if not inside.size and worst_share(result) > _FAR and ratios.size and ratios.max() > 2.0:
        return [f"forecasts of held-out trials are off by {percent(worst_share(result))} of the spread"]
    return []


def unlike_noise(model: LagrangianModel) -> list[str]:
    """Coordinates with residuals that the report does not call white, normal noise; none without data."""
    if model.diagnostics is None:
        return []
    series = Series(model)
    return [name for i, name in enumerate(model.coordinates) if departures(series, i)]


def not_noise(names: list[str]) -> str:
    """The reservation about the residuals of some coordinates.

    Examples
    --------
    >>> not_noise(["x", "theta"])
    'the residuals of x, theta are not white, normal noise: intervals may be too narrow or too wide'
    """
    what = "are not white, normal noise: intervals may be too narrow or too wide"
    return f"the residuals of {listed(names)} {what}"


def _free_runs(model: LagrangianModel) -> str:
    """Error of free runs, in words; empty if not computed."""
    for finding in model.fit.findings:
        if finding.code == "forecasts":
            _, *names = stated_error(dict(finding.values))
            error, worst = (finding.values.get(name) for name in names)
            horizon = plain(as_float(finding.values["horizon"], "horizon"))
            several = worst is not None and finding.values.get("trials") != 1
            more = f" ({percent(as_float(worst, 'worst'))} in the worst trial)" if several else ""
            return f"an error of {percent(as_float(error, 'error'))} of the spread over {horizon} s{more}"
    return ""


def _forecast_facts(result: ForecastResult | None) -> list[dict[str, Any]]:
    if result is None:
        return []
    return [
        {
            "name": "Forecast error",
            "value": percent(worst_share(result)),
            "note": f"of the spread, over {plain(result.horizon)} s",
        }
    ]


def _fit_facts(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    fit = model.fit
    facts = [{"name": "χ² per sample", "value": plain(fit.chi2_per_sample), "note": fit.chi2_note}]
    free = [
        t
        for t in (*model.terms, *model.dissipation)
        if t.standard_error > 0 and t.coefficient and not math.isnan(t.z)
    ]
    if free:
        weakest = min(free, key=lambda t: abs(t.z))
        share = 1.0 / abs(weakest.z)
        value = f"± {percent(share)}" if share < 5 else "open"
        text = as_given(weakest.written, notation.widths)
        note = text if notation.is_long(text) else notation.term(text)
        facts.append({"name": "Least precise coefficient", "value": value, "note": note})
    return facts


def _size_facts(model: LagrangianModel) -> list[dict[str, Any]]:
    diagnostics = model.diagnostics
    assert diagnostics is not None
    data = diagnostics.trajectories
    free = sum(not t.known for t in (*model.terms, *model.dissipation))
    candidates = model.provenance.get("n_candidates")
    note = "" if candidates is None else f"of {candidates} candidates"
    samples = plural(data.n_samples, "sample", "samples")
    number, _, noun = samples.partition(" ")
    trials = plural(len(data), "trial", "trials")
    return [
        {"name": "Terms found", "value": str(free), "note": note},
        {
            "name": "Data",
            "value": number,
            "note": f"{noun} in {trials}, {plain(data.duration)}\N{NO-BREAK SPACE}s",
        },
    ]
