"""Rows of the tables in the report: rounded numbers, and terms as mathematics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from leastaction.findings import because
from leastaction.model.constants import Offer
from leastaction.model.diagnostics import PathPoint
from leastaction.model.mathml import Notation, number_parts
from leastaction.model.model import LagrangianModel
from leastaction.model.notation import interval_text
from leastaction.model.symmetries import Symmetry
from leastaction.model.term import ModelTerm
from leastaction.model.text import CONSERVED, outcome, reach, shown_quantity
from leastaction.report.captions import placed
from leastaction.report.figures_model import whisker
from leastaction.report.series import Series
from leastaction.report.text import aligned, listed, percent, plain, signed, typeset, typeset_all
from leastaction.simulation.forecast import ForecastResult

__all__ = [
    "coefficient_groups",
    "coordinate_rows",
    "dropped_rows",
    "forecast_rows",
    "forecast_trials",
    "motion_rows",
    "option_rows",
    "pareto_rows",
    "path_rows",
    "residual_rows",
    "simple_rows",
    "symmetry_rows",
    "trial_rows",
]

_MOST_RESTS = 12  # equilibria that are listed
_REASONS = {
    "null": "no effect on the motion",
    "duplicate": "same as another",
    "dependent": "combination of others",
}


def coefficient_groups(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    """The rows of L, then those of ψ."""
    kinds = (("L", "Lagrangian", model.terms), ("ψ", "friction", model.dissipation))
    return [
        {
            "symbol": symbol,
            "name": name,
            "rows": [_coefficient_row(term, notation, f"{name}{k}") for k, term in enumerate(terms)],
        }
        for symbol, name, terms in kinds
        if terms
    ] + [*_shape_group(model, notation), *_differences(model, notation)]


def _shape_group(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    """Rows of shape parameters and calibration numbers, in the columns of coefficients."""
    calibrated = model.calibration.numbers if model.calibration else ()
    out: list[dict[str, Any]] = []
    for name, numbers in (("shape parameters", model.shapes), ("calibration numbers", calibrated)):
        terms = enumerate(number.as_term() for number in numbers)
        rows = [{**_coefficient_row(t, notation, f"{name[:5]}{k}"), "z": ""} for k, t in terms]
        out += [{"symbol": "", "name": name, "rows": rows}] if rows else []
    return out


def _differences(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    """Rows of the differences of each further group of trials."""
    if model.groups is None:
        return []
    first, *others = model.groups.names
    out: list[dict[str, Any]] = []
    for n, name in enumerate(others):
        terms = [ModelTerm(d.expression, d.difference, d.standard_error) for d in model.groups.of(name)]
        rows = [_coefficient_row(term, notation, f"group{n}-{k}") for k, term in enumerate(terms)]
        if rows:
            out.append({"symbol": "", "name": f"differences of {name} from {first}", "rows": rows})
    return out


def _coefficient_row(term: ModelTerm, notation: Notation, key: str) -> dict[str, Any]:
    error = term.standard_error
    number = number_parts(term.coefficient, error)
    return {
        "term": notation.term(term.written),
        "text": term.written,
        "value": number.text,
        "error": number.error_text,
        "whisker": whisker(term, key),
        "interval": " … ".join(map(typeset, interval_text(term).split(" … "))),
        "z": _z_text(term.z),
        "known": term.known,
    }


def _z_text(z: float) -> str:
    if math.isnan(z):
        return ""
    text = f"{z:.1f}" if abs(z) < 100 else f"{z:.0f}" if abs(z) < 1e6 else f"{z:.2e}"
    return typeset(text if float(text) else text.lstrip("-"))


def simple_rows(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    """Simple numbers inside intervals."""
    return [
        {
            "subject": _offered(offer, notation),
            "value": typeset(offer.written),
            "number": notation.term(offer.text),
            "chance": percent(offer.chance),
        }
        for offer in model.simple_constants.offers
    ]


def _offered(offer: Offer, notation: Notation) -> Markup:
    subject = notation.term(offer.subject)
    return Markup("{} to {}").format(subject, notation.term(offer.reference)) if offer.reference else subject


def symmetry_rows(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    """Symmetries of L, and their conserved quantities."""
    return [
        {
            "name": _symmetry_name(symmetry, notation),
            "reach": reach(symmetry),
            "quantity": _quantity(symmetry, notation),
            "outcome": outcome(symmetry),
        }
        for symmetry in model.symmetries
    ]


def motion_rows(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    """Equilibria, each with the modes about it."""
    names = [notation.text(name) for name in model.coordinates]
    rows: list[dict[str, Any]] = []
    for rest, system in model.small_motions[:_MOST_RESTS]:
        free = () if system is None else [names[model.coordinates.index(c)] for c in system.coordinates]
        modes = [(m.pace, ", ".join(m.deviations(free))) for m in (() if system is None else system.modes)]
        rows.append(
            {
                "place": placed(rest.place(names)),
                "standing": rest.standing,
                "modes": [tuple(map(typeset_all, mode)) for mode in modes],
            }
        )
    return rows


def _quantity(symmetry: Symmetry, notation: Notation) -> Markup:
    """The conserved quantity: its name, then each addend with its sign, with line breaks between."""
    addends = (part for pair in _sum(shown_quantity(symmetry), notation) for part in pair)
    return Markup(" ").join(filter(None, (CONSERVED.get(symmetry.kind), *addends)))


def _sum(text: str, notation: Notation) -> list[tuple[str, Markup]]:
    """Sign and mathematics of each addend."""
    parts: list[tuple[str, str]] = []
    depth = 0
    for word in text.split():
        if word in "+-" and depth == 0:
            parts.append(("−" if word == "-" else "+", ""))
            continue
        sign, body = parts.pop() if parts else ("", "")
        parts.append((sign, f"{body} {word}"))
        depth += word.count("(") - word.count(")")
    return [(sign, notation.term(body.strip())) for sign, body in parts]


def _symmetry_name(symmetry: Symmetry, notation: Notation) -> str:
    names = [notation.text(name) for name in symmetry.coordinates]
    pairs = list(zip(names[::2], names[1::2], strict=False))
    if symmetry.kind == "rotation":
        return "rotation of " + " and of ".join(f"({x}, {y})" for x, y in pairs)
    if symmetry.kind == "exchange":
        return "exchange " + ", ".join(f"{x} ↔ {y}" for x, y in pairs)
    if symmetry.kind == "translation":
        signs = ("−" if part.endswith("- c") else "+" for part in symmetry.change.split(", "))
        return "translation " + ", ".join(f"{x} {sign} c" for x, sign in zip(names, signs, strict=True))
    return f"cyclic coordinate {names[0]}" if symmetry.kind == "cyclic" else symmetry.kind


def coordinate_rows(series: Series, notation: Notation, units: Sequence[str]) -> list[dict[str, Any]]:
    """Range, noise and equation error of each coordinate."""
    model, data = series.model, series.trajectories
    diagnostics = model.diagnostics
    assert diagnostics is not None
    values = np.concatenate([trial.q for trial in data])
    rows = []
    for i, name in enumerate(model.coordinates):
        there = np.isfinite(values[:, i]) & (i in series.measured)
        seen = values[there, i]
        if i not in series.measured:  # the range of its estimated motion
            seen = np.concatenate([motion.q for motion in diagnostics.hidden_motion[name]])
        spread, sigma = float(np.std(seen)), float(model.noise_std[i])
        rows.append(
            {
                "symbol": notation.heading(name),
                "name": name,
                "unit": units[i],
                "range": f"{plain(seen.min())} … {plain(seen.max())}",
                "samples": int(there.sum()),
                "missing": int((~there).sum()),
                "wraps": data.wraps_removed[name],
                "noise": plain(sigma, full=True) if i in series.measured else "not measured",
                "relative": percent(sigma / spread) if spread > 0 and i in series.measured else "–",
                "equation": "prescribed"
                if name in model.prescribed
                else plain(float(diagnostics.equation_error[i]), full=True),
            }
        )
    return rows


def residual_rows(series: Series, notation: Notation, units: Sequence[str]) -> list[dict[str, Any]]:
    """Measures of correlation and normality of the residuals."""
    rows = []
    for i, name in enumerate(series.model.coordinates):
        if i not in series.measured:
            continue
        sigma = max(float(series.model.noise_std[i]), 1e-300)
        residuals = series.all_residuals(i)
        lags = series.correlation(i)
        rms = float(np.sqrt(np.mean(residuals**2)))
        rows.append(
            {
                "symbol": notation.heading(name),
                "noise": plain(sigma, full=True),
                "rms": plain(rms, full=True),
                "unit": units[i],
                "ratio": f"{rms / sigma:.2f}",
                "lag": f"{lags[0]:+.2f}".replace("-", "−") if lags.size and np.isfinite(lags[0]) else "–",
                "outside": f"{100 * float(np.mean(np.abs(residuals) > 3 * sigma)):.2f} %",
            }
        )
    return rows


def path_rows(
    path: Sequence[PathPoint],
    notation: Notation,
    limit: int = 9,
    *,
    shown: PathPoint | None = None,
    relevance: float | None = None,
) -> list[dict[str, Any]]:
    """Structures of the path, differences from the chosen one, and reasons; distant sizes are left out.

    ``shown`` is the structure of the model, if that is not the chosen one.
    """
    chosen = next(point for point in path if point.chosen)

    def distance(point: PathPoint) -> tuple[bool, int, float]:
        return not (point.chosen or point is shown), abs(point.n_terms - chosen.n_terms), point.bic

    near = sorted(path, key=distance)[:limit]
    return [
        {
            "n_terms": point.n_terms,
            "bic": "0" if point.chosen else signed(point.bic),
            "cost": "0" if point.chosen else signed(point.cost),
            "added": [notation.term(e) for e in point.written if e not in chosen.written],
            "removed": [notation.term(e) for e in chosen.written if e not in point.written],
            "chosen": point.chosen,
            "shown": point is shown,
            "because": because(point.reason, relevance),
        }
        for point in sorted(near, key=lambda p: (p.n_terms, p.bic))
    ]


def pareto_rows(points: Sequence[PathPoint], notation: Notation, limit: int = 9) -> list[dict[str, Any]]:
    """Structures on the curve of length against likelihood; distant lengths are left out."""
    chosen = next(point for point in points if point.chosen)
    near = sorted(points, key=lambda p: abs(p.length - chosen.length))[:limit]
    return [
        {
            "bits": f"{point.length:.1f}",
            "cost": "0" if point.chosen else signed(point.cost),
            "terms": [notation.term(e) for e in point.written],
            "chosen": point.chosen,
        }
        for point in sorted(near, key=lambda p: p.length)
    ]


def trial_rows(series: Series) -> list[dict[str, Any]]:
    """Length and sampling of the trials; equal ones share a row."""
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
            "names": listed(names),
        }
        for key, names in rows.items()
    ]


def forecast_rows(result: ForecastResult, notation: Notation, units: Sequence[str]) -> list[dict[str, Any]]:
    """Forecast error of each coordinate."""
    return [
        {
            "symbol": notation.heading(name),
            "unit": units[i],
            "rms": plain(float(result.rms[i]), full=True),
            "expected": plain(float(result.expected_rms[i]), full=True),
            "noise": plain(float(result.rms_over_noise[i])),
            "std": percent(float(result.rms_over_std[i])),
            "inside": percent(float(result.coverage[i])),
        }
        for i, name in enumerate(result.coordinates)
    ]


def forecast_trials(result: ForecastResult) -> list[dict[str, Any]]:
    """Forecast error of each trial."""
    parts = result.by_trial()
    columns = [
        aligned([float(part.rms[i]) for part in parts.values()]) for i in range(len(result.coordinates))
    ]
    return [
        {
            "name": name,
            "starts": part.n_starts,
            "diverged": part.n_diverged,
            "rms": [column[k] for column in columns],
            "valid": plain(part.valid_time),
        }
        for k, (name, part) in enumerate(parts.items())
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
        rows.append((str(name).replace("_", " "), text or "none"))
    return rows
