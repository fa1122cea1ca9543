"""Rows of the report's tables: numbers rounded for people, terms as mathematics."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from leastaction._diagnostics import PathPoint
from leastaction._forecast import ForecastResult
from leastaction._model import LagrangianModel
from leastaction._notation import rounded
from leastaction._report._mathml import Notation, number_parts
from leastaction._report._series import Series

__all__ = [
    "coefficient_rows",
    "coordinate_rows",
    "dropped_rows",
    "forecast_rows",
    "forecast_trials",
    "option_rows",
    "path_rows",
    "plain",
    "residual_rows",
    "trial_rows",
]

_REASONS = {
    "null": "no effect on the motion",
    "duplicate": "same as another",
    "dependent": "combination of others",
}
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def plain(value: float, digits: int = 3, full: bool = False) -> str:
    """A number for a table, with a proper minus sign and power of ten; `full`: with its trailing zeros.

    Examples
    --------
    >>> plain(-0.00001234), plain(1234567.0), plain(0.5), plain(float("inf")), plain(12345.6, 6)
    ('−1.23 × 10⁻⁵', '1.23 × 10⁶', '0.5', '∞', '12345.6')
    >>> plain(0.5, full=True), plain(120.0, full=True)
    ('0.500', '120')
    """
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return _typeset(f"{value:#.{digits}g}".rstrip(".") if full else f"{value:.{digits}g}")


def _typeset(text: str) -> str:
    mantissa, _, exponent = text.partition("e")
    mantissa = mantissa.replace("-", "−")
    return f"{mantissa} × 10{str(int(exponent)).translate(_SUPERSCRIPTS)}" if exponent else mantissa


def coefficient_rows(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    """One row for each term of L, then of ψ."""
    rows = []
    for kind, terms in (("L", model.terms), ("ψ", model.dissipation)):
        for term in terms:
            error = term.standard_error
            value, spread, exponent = number_parts(term.coefficient, error)
            power = (
                f" × 10{exponent.translate(str.maketrans('−', '-')).translate(_SUPERSCRIPTS)}"
                if exponent
                else ""
            )
            ends = [_typeset(rounded(end, error)) for end in (term.lower, term.upper)] if error > 0 else []
            rows.append(
                {
                    "term": notation.term(term.expression),
                    "text": term.expression,
                    "kind": kind,
                    "value": value + power,
                    "error": spread + power if spread else "",
                    "interval": " … ".join(ends),
                    "z": _z_text(term.z),
                    "known": term.known,
                }
            )
    return rows


def _z_text(z: float) -> str:
    if math.isnan(z):
        return ""
    return _typeset(f"{z:.1f}" if abs(z) < 100 else f"{z:.0f}" if abs(z) < 1e6 else f"{z:.2e}")


def coordinate_rows(series: Series, notation: Notation, units: Sequence[str]) -> list[dict[str, Any]]:
    """Range, noise and equation error of each coordinate."""
    model, data = series.model, series.trajectories
    diagnostics = model.diagnostics
    assert diagnostics is not None
    values = np.concatenate([trial.q for trial in data])
    rows = []
    for i, name in enumerate(model.coordinates):
        column = values[:, i]
        there = np.isfinite(column)
        spread, sigma = float(np.std(column[there])), float(model.noise_std[i])
        rows.append(
            {
                "symbol": notation.symbol(name),
                "name": name,
                "unit": units[i],
                "range": f"{plain(column[there].min())} … {plain(column[there].max())}",
                "samples": int(there.sum()),
                "missing": int((~there).sum()),
                "wraps": data.wraps_removed[name],
                "noise": plain(sigma, full=True),
                "relative": f"{plain(100 * sigma / spread, 2)} %" if spread > 0 else "–",
                "equation": plain(float(diagnostics.equation_error[i]), full=True),
            }
        )
    return rows


def residual_rows(series: Series, notation: Notation, units: Sequence[str]) -> list[dict[str, Any]]:
    """How white and how normal the residuals are."""
    rows = []
    for i, name in enumerate(series.model.coordinates):
        sigma = max(float(series.model.noise_std[i]), 1e-300)
        residuals = series.all_residuals(i)
        lags = series.correlation(i)
        rms = float(np.sqrt(np.mean(residuals**2)))
        rows.append(
            {
                "symbol": notation.symbol(name),
                "noise": plain(sigma, full=True),
                "rms": plain(rms, full=True),
                "unit": units[i],
                "ratio": f"{rms / sigma:.2f}",
                "lag": f"{lags[0]:+.2f}".replace("-", "−") if lags.size and np.isfinite(lags[0]) else "–",
                "outside": f"{100 * float(np.mean(np.abs(residuals) > 3 * sigma)):.2f} %",
            }
        )
    return rows


def path_rows(path: Sequence[PathPoint], notation: Notation, limit: int = 14) -> list[dict[str, Any]]:
    """Structures of the path and what differs from the chosen one; sizes far from it are left out."""
    chosen = next(point for point in path if point.chosen)
    near = sorted(path, key=lambda p: (not p.chosen, abs(p.n_terms - chosen.n_terms), p.bic))[:limit]
    return [
        {
            "n_terms": point.n_terms,
            "bic": "0" if point.chosen else _signed(point.bic),
            "cost": "0" if point.chosen else _signed(point.cost),
            "added": [notation.term(e) for e in point.expressions if e not in chosen.expressions],
            "removed": [notation.term(e) for e in chosen.expressions if e not in point.expressions],
            "chosen": point.chosen,
        }
        for point in sorted(near, key=lambda p: (p.n_terms, p.bic))
    ]


def _signed(value: float) -> str:
    text = f"{value:+.1f}" if abs(value) < 100 else f"{value:+.0f}" if abs(value) < 1e6 else f"{value:+.2e}"
    return _typeset(text)


def trial_rows(series: Series) -> list[dict[str, Any]]:
    """Length and sampling of the trials; those that are alike share a row."""
    data = series.trajectories
    rows: dict[tuple, list[str]] = {}
    for name, trial in zip(data.names, data, strict=True):
        steps = np.diff(trial.t)
        step = float(np.median(steps)) if steps.size else math.nan
        uneven = " (uneven)" if steps.size and np.ptp(steps) > 0.02 * step else ""
        sampling = f"{plain(1e3 * step)} ms{uneven}"
        forces = "yes" if trial.driven else "none"
        key = (trial.n_times, plain(trial.duration, 4), sampling, trial.q.size - trial.n_samples, forces)
        rows.setdefault(key, []).append(name)
    return [
        {
            **dict(zip(("times", "duration", "step", "missing", "forces"), key, strict=True)),
            "names": _listed(names),
        }
        for key, names in rows.items()
    ]


def _listed(names: Sequence[str], limit: int = 8) -> str:
    more = len(names) - limit
    return ", ".join(names) if more <= 1 else f"{', '.join(names[:limit])} and {more} more"


def forecast_rows(result: ForecastResult, notation: Notation, units: Sequence[str]) -> list[dict[str, Any]]:
    """Forecast error of each coordinate."""
    return [
        {
            "symbol": notation.symbol(name),
            "unit": units[i],
            "rms": plain(float(result.rms[i]), full=True),
            "expected": plain(float(result.expected_rms[i]), full=True),
            "noise": plain(float(result.rms_over_noise[i])),
            "std": f"{plain(100 * float(result.rms_over_std[i]), 2)} %",
        }
        for i, name in enumerate(result.coordinates)
    ]


def forecast_trials(result: ForecastResult) -> list[dict[str, Any]]:
    """Forecast error of each trial."""
    return [
        {
            "name": name,
            "starts": part.n_starts,
            "diverged": part.n_diverged,
            "rms": [plain(float(x), full=True) for x in part.rms],
            "valid": plain(part.valid_time),
        }
        for name, part in result.by_trial().items()
    ]


def dropped_rows(dropped: Iterable[Any], notation: Notation) -> list[dict[str, Any]]:
    """Candidates that were removed before the fit."""
    return [
        {
            "term": notation.term(item.term.text),
            "text": item.term.text,
            "reason": _REASONS.get(item.reason, item.reason),
            "because": item.because,
        }
        for item in dropped
    ]


def option_rows(options: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Options of the discovery as name and value."""
    rows = []
    for name, value in options.items():
        if isinstance(value, Mapping):
            text = ", ".join(
                f"{k} = {v:g}" if isinstance(v, float) else f"{k} = {v}" for k, v in value.items()
            )
        elif isinstance(value, (list, tuple)):
            text = ", ".join(map(str, value))
        else:
            text = str(value)
        rows.append((re.sub("_", " ", str(name)), text or "none"))
    return rows
