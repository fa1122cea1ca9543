"""The head of the report: status, warnings, what to do, and the few numbers that decide."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from leastaction.model.mathml import Notation
from leastaction.model.model import LagrangianModel
from leastaction.model.term import as_float
from leastaction.report.text import percent, plain, plural
from leastaction.simulation.forecast import ForecastResult

__all__ = ["verdict"]


def verdict(model: LagrangianModel, validation: ForecastResult | None, notation: Notation) -> dict[str, Any]:
    """What the first section shows."""
    return {
        "status": model.fit.status,
        "warnings": [(f.message, f.remedy) for f in model.fit.findings if f.severity == "warning"],
        "statements": [(name.capitalize(), text) for name, text in _statements(model, validation).items()],
        "forecast": validation is not None,
        "forecasts": _free_runs(model),
        "facts": [*_forecast_facts(validation), *_fit_facts(model, notation), *_size_facts(model)],
    }


def _statements(model: LagrangianModel, validation: ForecastResult | None) -> dict[str, str]:
    """Structure, equations and forecast in words; held-out trials say more than the data themselves."""
    if validation is None:
        return model.fit.statements
    off = _worst(validation)
    words = f"held-out trials are off by {percent(off)} of the spread over {plain(validation.horizon)} s"
    return {**model.fit.statements, "forecast": words}


def _worst(result: ForecastResult) -> float:
    shares = result.rms_over_std
    return float(np.nanmax(shares)) if not np.isnan(shares).all() else math.nan


def _free_runs(model: LagrangianModel) -> str:
    """How far free runs are off, in words; empty where that was not asked."""
    for finding in model.fit.findings:
        if finding.code == "forecasts":
            error, horizon = (as_float(finding.values[name], name) for name in ("error", "horizon"))
            return f"an error of {percent(error)} of the spread over {plain(horizon)} s"
    return ""


def _forecast_facts(result: ForecastResult | None) -> list[dict[str, Any]]:
    if result is None:
        return []
    return [
        {
            "name": "Forecast error",
            "value": percent(_worst(result)),
            "note": f"of the spread, over {plain(result.horizon)} s",
        }
    ]


def _fit_facts(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    facts = [{"name": "χ² per sample", "value": plain(model.fit.chi2_per_sample), "note": "expected 1"}]
    free = [
        t
        for t in (*model.terms, *model.dissipation)
        if t.standard_error > 0 and t.coefficient and not math.isnan(t.z)
    ]
    if free:
        weakest = min(free, key=lambda t: abs(t.z))
        share = (weakest.upper - weakest.coefficient) / abs(weakest.coefficient)
        value = f"±{percent(share)}" if share < 10 else "open"
        text = weakest.written
        note = text if notation.is_long(text) else notation.term(text)
        facts.append({"name": "Least sure term", "value": value, "note": note})
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
        {"name": "Data", "value": number, "note": f"{noun} in {trials}, {plain(data.duration, 4)} s"},
    ]
