"""Content of the template, and rendering of the page."""

from __future__ import annotations

import math
import platform
from collections.abc import Container, Mapping, Sequence
from datetime import date
from importlib.metadata import version
from importlib.resources import files
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from leastaction.errors import InputError
from leastaction.findings import as_given, because, usability
from leastaction.identifiers import quoted
from leastaction.model.mathml import Notation
from leastaction.model.model import LagrangianModel
from leastaction.report import captions, law, tables
from leastaction.report import figures_model as figures
from leastaction.report.figures_data import DataFigures
from leastaction.report.series import Energy, Series
from leastaction.report.text import percent, plain, plural
from leastaction.report.verdict import verdict
from leastaction.simulation.forecast import ForecastResult, ForecastTrace

__all__ = ["render", "rendered"]

_MOST_DRAWN = 6  # coordinates with figures
_MOST_ROWS = 30  # trials listed
_MOST_ENERGIES = 60
_TITLES = {
    "ok": "This model holds along the data",
    "usable": "This model {does}",
    "doubtful": "Do not rely on these coefficients yet",
}


def render(
    model: LagrangianModel,
    validation: ForecastResult | None,
    command: str | None,
    names: Mapping[str, str],
) -> str:
    """Return the page as text; the model has diagnostics, and `names` are for sentences and figures.

    Raises
    ------
    InputError
        If `names` has anything but texts of coordinates.
    """
    _check_names(names, model.coordinates)
    notation = Notation.of_fit(model.coordinates, model.fit.findings, names)
    return rendered("page.html.j2", _context(model, validation, command, notation))


def _check_names(names: object, coordinates: Sequence[str]) -> None:
    if not isinstance(names, Mapping) or not all(isinstance(text, str) for text in names.values()):
        raise InputError(f"names is {quoted(names)}; expected a mapping of coordinates to texts")
    for name in names:
        if name not in coordinates:
            raise InputError(
                f"names has {quoted(name)}, which is no coordinate; the coordinates are "
                f"{', '.join(coordinates)}"
            )


def rendered(template: str, context: dict[str, Any]) -> str:
    """A template of this package with its content and the style sheet."""
    here = files("leastaction.report")

    def source(name: str) -> str:
        return here.joinpath(name).read_text(encoding="utf-8")

    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=jinja2.FunctionLoader(source),
    )
    today = date.today()
    common = {
        "date": f"{today.day} {today:%B %Y}",
        "plain": plain,
        "plural": plural,
        "versions": _versions(),
        "style": Markup(source("style.css")),
    }
    return environment.get_template(template).render(**common, **context)


def _context(
    model: LagrangianModel, validation: ForecastResult | None, command: str | None, notation: Notation
) -> dict[str, Any]:
    diagnostics = model.diagnostics
    assert diagnostics is not None
    series = Series(model)
    widths = notation.widths
    options = {name: _as_given(value, widths) for name, value in _options(model).items()}
    angles = options.get("angles") or ()
    units = _units(model.coordinates, angles)
    groups = tables.coefficient_groups(model, notation)
    return {
        "model": model,
        "symbols": [notation.heading(c) for c in model.coordinates],
        "names": [notation.text(c) for c in model.coordinates],
        "title": _TITLES[model.fit.status].format(does=usability(model.fit.findings)),
        "widths": " and ".join(map(plain, sorted({*widths}))),
        "equations": law.equations(model, notation),
        "correlations": law.correlations(model, notation),
        "driven": series.trajectories.driven,
        "verdict": verdict(model, validation, notation),
        "formulas": _formulas(model, notation),
        "law_text": as_given(str(model.lagrangian), widths),
        "friction_text": as_given(str(model.dissipation_function), widths),
        "groups": groups,
        **_constants(model, notation),
        **_motions(model, notation),
        "stacked": any(notation.is_long(row["text"]) for group in groups for row in group["rows"]),
        "whisker_axis": figures.whisker_axis(),
        **_profiles(model),
        **_data(series, notation, units),
        **_selection(model, notation),
        **_energy(series),
        **_forecast(validation, notation, angles),
        "dropped": tables.dropped_rows(diagnostics.dropped, notation),
        "has_units": "units" in units,
        "has_angles": "rad" in units,
        "command": command or _call(options),
        "given_command": command is not None,
        "options": tables.option_rows(options),
        "provenance": model.provenance,
        "timings": diagnostics.timings,
        "total_time": sum(diagnostics.timings.values()),
    }


def _constants(model: LagrangianModel, notation: Notation) -> dict[str, Any]:
    """Simple numbers and symmetries."""
    return {
        "simple": tables.simple_rows(model, notation),
        "simple_title": captions.SIMPLE_TITLE,
        "simple_head": captions.SIMPLE_HEAD,
        "simple_note": captions.simple_note(model.simple_constants),
        "symmetry_summary": captions.symmetry_summary(model.symmetries),
        "symmetries": tables.symmetry_rows(model, notation),
        "no_symmetries": captions.NO_SYMMETRIES,
        "symmetry_title": captions.SYMMETRY_TITLE,
        "symmetry_head": captions.SYMMETRY_HEAD,
        "symmetry_note": captions.symmetry_note(model.symmetries),
    }


def _data(series: Series, notation: Notation, units: tuple[str, ...]) -> dict[str, Any]:
    """Curves, residuals, and the measured data."""
    names, trials = series.trajectories.coordinates, tables.trial_rows(series)
    return {
        "data": series.trajectories,
        "shown": series.trajectories.names[series.trial],
        "n_drawn": min(len(names), _MOST_DRAWN),
        "figures": DataFigures(series, notation, units),
        "panels": [
            {
                "index": i,
                "curve": captions.curve_title(series, i, notation.text(name)),
                "zoom": captions.zoom_title(series, notation.text(name)),
                "residuals": captions.residual_title(series, i, notation.text(name))
                if i in series.measured
                else "",
            }
            for i, name in enumerate(names[:_MOST_DRAWN])
        ],
        "residuals": tables.residual_rows(series, notation, units),
        "coordinates": tables.coordinate_rows(series, notation, units),
        "trials": trials[:_MOST_ROWS],
        "n_more_trials": max(len(trials) - _MOST_ROWS, 0),
    }


def _formulas(model: LagrangianModel, notation: Notation) -> list[dict[str, Any]]:
    groups = (("L", model.terms), ("ψ", model.dissipation))
    return [{"name": name, "addends": notation.addends(terms)} for name, terms in groups if terms]


def _motions(model: LagrangianModel, notation: Notation) -> dict[str, Any]:
    systems = [system for _, system in model.small_motions if system is not None]
    return {
        "motions": tables.motion_rows(model, notation),
        "n_motions": len(model.small_motions),
        "motion_summary": captions.motion_summary(model.small_motions, notation),
        "motion_title": captions.MOTION_TITLE,
        "motion_head": captions.MOTION_HEAD,
        "motion_note": captions.motion_note(systems[0].left_out if systems else (), notation),
        "no_motions": captions.NO_MOTIONS,
    }


def _profiles(model: LagrangianModel) -> dict[str, Any]:
    shapes = [shape for shape in model.shapes if len(shape.profile) > 2]
    return {
        "profiles": [figures.profile_figure(shape) for shape in shapes],
        "profile_title": captions.profile_title(shapes),
    }


def _options(model: LagrangianModel) -> Mapping[str, Any]:
    options = model.provenance.get("options")
    return options if isinstance(options, Mapping) else {}


def _as_given(value: Any, widths: tuple[float, ...]) -> Any:
    """An option with the candidates in the user's notation."""
    if isinstance(value, Mapping):
        return {as_given(str(key), widths): item for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_given(item, widths) if isinstance(item, str) else item for item in value]
    return value


def _selection(model: LagrangianModel, notation: Notation) -> dict[str, Any]:
    path = model.diagnostics.path if model.diagnostics else ()
    path = [point for point in path if math.isfinite(point.bic) and math.isfinite(point.cost)]
    if not any(point.chosen for point in path):
        return {"path": [], "runner_up": None, "by_hand": None, "pareto": ()}
    rivals = [point for point in path if not point.chosen]
    relevance = _options(model).get("relevance")
    by_hand = model.provenance.get("structure")
    shown = next((p for p in rivals if list(p.expressions) == by_hand), None)
    rows = tables.path_rows(path, notation, shown=shown, relevance=relevance)
    best = min(rivals, key=lambda p: p.bic, default=None)
    return {
        "path": rows,
        "n_hidden": len(path) - len(rows),
        "path_figure": figures.path_figure(path),
        "path_title": captions.path_title(path),
        **_pareto(model, notation),
        "by_hand": shown,
        "runner_up": None
        if best is None
        else {
            "bic": best.bic,
            "text": plain(best.bic),
            "n_terms": best.n_terms,
            "because": because(best.reason, relevance),
        },
    }


def _pareto(model: LagrangianModel, notation: Notation) -> dict[str, Any]:
    """Length against likelihood, if there are lengths and another structure to compare."""
    points = model.diagnostics.pareto if model.diagnostics else ()
    if len(points) < 2 or not any(point.chosen for point in points):
        return {"pareto": ()}
    return {
        "pareto": tables.pareto_rows(points, notation),
        "pareto_figure": figures.pareto_figure(points),
        "pareto_title": captions.pareto_title(points),
    }


def _energy(series: Series) -> dict[str, Any]:
    model, data = series.model, series.trajectories
    if model.prescribed:
        names = ", ".join(model.prescribed)
        return {"energy": None, "no_energy": f"No balance: the forces that move {names} are unknown."}
    if model.timed:
        return {"energy": None, "no_energy": "No balance: the law depends on time."}
    everything = [Energy.of(series, k) for k in range(min(len(data), _MOST_ENERGIES))]
    if series.trial >= len(everything):
        everything[-1] = Energy.of(series, series.trial)
    shown = everything[min(series.trial, len(everything) - 1)]
    if not all(energy.finite for energy in everything):
        return {"energy": None, "no_energy": "Not drawn: it is not finite along the whole fitted curve."}
    balance = bool(model.dissipation) or data.driven
    floor = float(shown.potential.min())
    worst = max(e.imbalance for e in everything)
    several = len(everything) > 1
    facts = {
        "friction": bool(model.dissipation),
        "driven": data.driven,
        "shown": data.names[series.trial],
        "start": plain(float(shown.expected[0]) - floor),
        "stop": plain(float(shown.expected[-1]) - floor),
        "imbalance": None if math.isnan(worst) else percent(worst),
    }
    return {
        "energy": {
            **facts,
            "title": captions.energy_title(facts),
            "trial": figures.energy_of_trial(shown, balance),
            "trials": figures.energy_of_trials(everything, everything.index(shown)) if several else None,
            "balance": balance,
        }
    }


def _units(names: Sequence[str], angles: Container[str]) -> tuple[str, ...]:
    return tuple("rad" if name in angles else "units" for name in names)


def _forecast(result: ForecastResult | None, notation: Notation, angles: Container[str]) -> dict[str, Any]:
    if result is None:
        return {"forecast": None}
    notation = Notation(result.coordinates, (), notation.written)  # columns of sensors have names, too
    units = _units(result.coordinates, angles)
    picked = _typical_starts(result)
    n_drawn = min(len(units), _MOST_DRAWN)
    panels = [
        {
            "title": title,
            "trial": trace.trial,
            "origin": plain(trace.origin, 4),
            "status": trace.status,
            "reason": trace.reason,
            "figures": [
                figures.forecast_panel(
                    trace,
                    i,
                    notation.text(result.coordinates[i]),
                    units[i],
                    f"forecast{k}-{i}",
                )
                for i in range(n_drawn)
            ],
        }
        for k, (title, trace) in enumerate(picked)
    ]
    rows = tables.forecast_trials(result)
    folds = n_drawn > 1 and len(panels) > 1  # show the largest error, and fold the median
    return {
        "forecast": {
            "result": result,
            "title": captions.forecast_title(result),
            "banded": bool(np.isfinite(result.coverage).any()),
            "shown": panels[-1:] if folds else panels,
            "folded": panels[0] if folds else None,
            "rows": tables.forecast_rows(result, notation, units),
            "trials": rows[:_MOST_ROWS],
            "n_more": max(len(rows) - _MOST_ROWS, 0),
        }
    }


def _typical_starts(result: ForecastResult) -> list[tuple[str, ForecastTrace]]:
    """Forecasts with the median and the largest error, relative to the spread."""

    def size(trace: ForecastTrace) -> tuple[float, bool]:
        relative = trace.rms / result.std
        far = float(np.nanmax(relative)) if np.isfinite(relative).any() else math.inf
        return far, trace.status != "ok"

    ranked = sorted(result.traces, key=size)
    picks = {(len(ranked) - 1) // 2: "median error", len(ranked) - 1: "largest error"}
    if len(ranked) < 3:
        picks = dict.fromkeys(range(len(ranked)), "forecast")
    return [(picks[k], ranked[k]) for k in sorted(picks)]


def _call(options: Mapping[str, Any]) -> str:
    """The call of discover() that the options describe."""
    given = [f"{name}={value!r}" for name, value in options.items() if value not in ({}, [], ())]
    return (
        "leastaction.discover(\n" + "".join(f"    {a},\n" for a in ["trajectories", "library", *given]) + ")"
    )


def _versions() -> str:
    parts = [f"{name} {version(name.lower())}" for name in ("NumPy", "SciPy", "SymPy")]
    return ", ".join([f"Python {platform.python_version()}", *parts])
