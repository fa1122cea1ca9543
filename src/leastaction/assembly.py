"""From what a search has found to the model that the user keeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from leastaction.data.trajectories import Trajectory
from leastaction.data.trajectory import common_units
from leastaction.diagnosis.verdict import Verdict
from leastaction.errors import InputError
from leastaction.estimation.build import Setup
from leastaction.estimation.error_spectrum import error_spectrum
from leastaction.estimation.fit import Fit
from leastaction.estimation.groups import GroupedColumns, GroupTerm, laws
from leastaction.findings import Finding, find, status_of
from leastaction.hidden.band import curve_errors
from leastaction.model.calibration import Calibration
from leastaction.model.diagnostics import Diagnostics, HiddenMotion, PathPoint, pareto
from leastaction.model.gravity import gravity_findings
from leastaction.model.groups import GroupDifference, Groups
from leastaction.model.model import LagrangianModel
from leastaction.model.term import FitSummary, ModelTerm, ShapeParameter
from leastaction.selection.alternatives import Alternative
from leastaction.selection.search_state import Search

__all__ = ["assemble_model"]

_NEAR = 0.05  # of the spread: within it, a forecast is said to be near the motion
_PERIODS = (1.0, 10.0)  # that forecasts last; trials, samples a period, and coordinates bound their cost
_MOST_TRIALS, _SAMPLES_A_PERIOD, _MOST_COORDINATES = 6, 30, 4
_NO_RATES = {"velocities": None, "accelerations": None}


def assemble_model(
    setup: Setup,
    search: Search,
    verdict: Verdict,
    alternatives: Sequence[Alternative],
    options: Mapping[str, Any],
    timings: dict[str, float],
) -> LagrangianModel:
    """The model of a search's fit; ``options`` and ``timings`` are kept as they are."""
    fit, grid = search.found, search.found.grid
    density = fit.weights.physics.copy()
    density[list(setup.problem.prescribed)] = np.nan
    noise = _rate_noise(fit)
    findings = (
        *setup.findings,
        *verdict.findings,
        *search.findings,
        *search.bias.findings(),
        *(find("rate-noise", name, quantity=quantity, noise=x) for (quantity, name), x in noise.items()),
    )
    points = _points(fit, alternatives)
    diagnostics = Diagnostics(
        fit.problem.trajectories,
        grid.spline,
        fit.control_points,
        fit.position_std,
        density,
        verdict.equation_error,
        _path(points),
        setup.library.dropped,
        timings=timings,
        rate_noise_std={f"{quantity} of {name}": x for (quantity, name), x in noise.items()},
        force_offset=search.bias.found(),
        prepared=setup.findings,
        pareto=pareto(points),
        angles=tuple(options.get("angles", ())),
        hidden_motion=_hidden_motion(fit),
    )
    terms, units = _terms(fit), common_units(setup.problem.trajectories)
    unknown = bool(np.isnan(fit.covariance).any())
    model = LagrangianModel(
        setup.library.coordinates,
        tuple(term for kind, term in terms if kind == "lagrangian"),
        tuple(term for kind, term in terms if kind == "dissipation"),
        None if unknown else _covariance(fit),
        fit.position_std,
        FitSummary(
            status_of(findings),
            verdict.chi2_per_sample,
            density.tolist(),
            findings=findings,
            error_spectrum=[] if unknown else error_spectrum(fit).rows(),
        ),
        {
            "version": _version(),
            "options": options,
            "data": setup.problem.trajectories.digest(),
            "n_samples": int(grid.observations.counts.sum()),
            "n_candidates": len(setup.problem.terms),
            "knots_per_second": float(grid.knots_per_second),
            **({"units": units} if units else {}),
        },
        diagnostics,
        _shapes(fit),
        _groups(fit, unknown),
        _calibration(fit),
    )
    return _with_outlook(model, options.get("lengths", {}), search.scales.period)


def _with_outlook(model: LagrangianModel, lengths: Mapping[str, float], period: float) -> LagrangianModel:
    """The model with findings that need one: on gravity, and on how far it forecasts."""
    findings = [*model.fit.findings, *gravity_findings(model, lengths)]
    if status_of(findings) == "ok":
        findings += _reach(model, period)
    return replace(model, fit=replace(model.fit, status=status_of(findings), findings=tuple(findings)))


def _calibration(fit: Fit) -> Calibration | None:
    """The measurement functions of a fit, and its calibration numbers."""
    sensors, numbers = fit.problem.sensors, fit.weights.calibration
    if sensors is None or numbers is None:
        return None
    functions, n = sensors.functions, len(fit.structure)
    errors = np.full(numbers.size, np.nan)
    if fit.joint is not None:
        errors = np.sqrt(np.clip(np.diag(fit.joint)[n:], 0.0, None))
    found = zip(functions.names, numbers.tolist(), errors.tolist(), strict=True)
    noise = fit.weights.noise_std[-len(functions.columns) :].tolist()
    covariance = fit.joint if fit.joint is not None and np.isfinite(fit.joint).all() else None
    return Calibration(
        functions.coordinates,
        functions.texts,
        tuple(noise),
        tuple(ShapeParameter(*number) for number in found),
        covariance,
    )


def _reach(model: LagrangianModel, period: float) -> list[Finding]:
    """For how long forecasts stay near the motion, by what the fit leaves open.

    Forecasts run along the fitted curve, as if it was the motion.  Their bands hold the standard errors of
    the coefficients, the equation errors, and the error of a start that is found in a period of samples.
    Long forecasts are made only where short ones stay near to their end.
    """
    found = model.diagnostics
    if found is None or model.n_dof > _MOST_COORDINATES or found.hidden_motion or model.calibration:
        return []
    data = [t.changed(q=q, **_NO_RATES) for t, q in zip(found.trajectories, found.curve(), strict=True)]
    own = model.own_trials(len(data))
    step = max(1, int(period / found.trajectories.sampling_interval / _SAMPLES_A_PERIOD))
    data = [data[k].rows(slice(0, None, step)) for k in own[:: -(-len(own) // _MOST_TRIALS)]]
    shortest = min(t.duration for t in data)
    window = min(period, 0.25 * shortest)
    horizons = sorted({min(n * period, 0.5 * (shortest - window)) for n in _PERIODS})
    seconds, to_the_end = 0.0, False
    for horizon in horizons:
        try:
            seconds, to_the_end = _stays_near(model, data, window, horizon)
        except InputError:  # too few samples for a start
            return []
        if not to_the_end:
            break
    values = {"seconds": seconds, "share": _NEAR, "to_the_end": to_the_end, "window": window}
    return [find("forecast-reach", **values)] if seconds else []


def _stays_near(
    model: LagrangianModel, data: list[Trajectory], window: float, horizon: float
) -> tuple[float, bool]:
    """For how many seconds forecasts of a length stay near, and whether to their end; 0 without a band."""
    pieces = [t.rows(slice(0, np.searchsorted(t.t, t.t[0] + window + 2.05 * horizon))) for t in data]
    runs = model.validate(pieces, horizon=horizon, window=window)
    count = min(trace.t.size for trace in runs.traces)
    if not count or any(trace.std is None for trace in runs.traces):
        return 0.0, False
    after = runs.traces[0].t[:count] - runs.traces[0].origin
    bands = np.array([trace.std[:count] ** 2 for trace in runs.traces if trace.std is not None])
    away = np.array([trace.forecast[:count] - trace.measured[:count] for trace in runs.traces])
    spread = np.nanstd(np.concatenate([t.q for t in data]), axis=0)
    squares = np.maximum(bands.mean(axis=0) - runs.noise_std**2, (away**2).mean(axis=0)) / spread**2
    free = [i for i, name in enumerate(model.coordinates) if name not in model.prescribed]
    beyond = np.flatnonzero(~(squares[:, free] <= _NEAR**2).all(axis=1))
    return float(after[max(beyond[0] - 1, 0)] if beyond.size else after[-1]), not beyond.size


def _hidden_motion(fit: Fit) -> dict[str, tuple[HiddenMotion, ...]]:
    """The curve of every coordinate without a sensor, with its standard error."""
    problem = fit.problem
    if not problem.hidden:
        return {}
    times = [t.t for t in problem.trajectories]
    errors, curves = curve_errors(fit, problem.hidden, times), list(fit.curves())
    return {
        problem.coordinates[i]: tuple(
            HiddenMotion(t, q[:, i].copy(), e[:, column])
            for t, q, e in zip(times, curves, errors, strict=True)
        )
        for column, i in enumerate(problem.hidden)
    }


def _covariance(fit: Fit) -> np.ndarray:
    """Of the members' coefficients, then of the shape parameters; not of differences between groups."""
    if fit.shapes is not None:
        return fit.shapes.covariance
    n_own = sum(not isinstance(fit.problem.terms[k], GroupTerm) for k in fit.structure)
    return fit.covariance[:n_own, :n_own]


def _groups(fit: Fit, unknown: bool) -> Groups | None:
    """What differs between groups of trials; its terms are the last of the structure."""
    columns = fit.problem.candidates
    if not isinstance(columns, GroupedColumns):
        return None
    found = zip(fit.structure, fit.estimates.tolist(), fit.standard_errors.tolist(), strict=True)
    differences = [
        GroupDifference(term.whole.text, columns.names[term.group], value, error, term.kind)
        for k, value, error in found
        if isinstance(term := fit.problem.terms[k], GroupTerm)
    ]
    names = {k: name for name, (own, *_) in zip(columns.names, laws(fit), strict=True) for k in own}
    trials = tuple(names[k] for k in sorted(names))
    return Groups(columns.names, tuple(differences), None if unknown else fit.covariance, trials)


def _shapes(fit: Fit) -> tuple[ShapeParameter, ...]:
    """The shape parameters of the structure; without errors where they were held."""
    names = fit.problem.shapes_of(fit.structure)
    values = fit.problem.shape_values
    found = fit.shapes
    if found is None:
        return tuple(ShapeParameter(n, values[n]) for n in names)
    profiles = found.profiles or ((),) * len(names)
    # one that is held at its bound has no error
    return tuple(
        ShapeParameter(n, values[n], error or np.nan, profile)
        for n, error, profile in zip(names, found.standard_errors.tolist(), profiles, strict=True)
    )


def _terms(fit: Fit) -> list[tuple[str, ModelTerm]]:
    """The kind of every term in the model, and the term with its number."""
    errors = dict(zip(fit.structure, fit.standard_errors.tolist(), strict=True))
    out = []
    for k, term in enumerate(fit.problem.terms):
        is_known = bool(fit.problem.is_known[k])
        if (is_known or k in errors) and not isinstance(term, GroupTerm):
            value = float(fit.coefficients[k])
            template = "" if term.template is None else term.offered
            out.append((term.kind, ModelTerm(term.text, value, errors.get(k, 0.0), is_known, template)))
    return out


def _rate_noise(fit: Fit) -> dict[tuple[str, str], float]:
    """(``"velocity"`` or ``"acceleration"``, coordinate) → noise of what was measured."""
    names = fit.problem.coordinates
    channels = [(rate.quantity, names[rate.coordinate]) for rate in fit.problem.trajectories.rates]
    noise = fit.weights.noise_std[len(names) : len(names) + len(channels)].tolist()
    return dict(zip(channels, noise, strict=True))


def _path(points: Sequence[PathPoint]) -> tuple[PathPoint, ...]:
    """Best structure of each size, then the runners-up of the chosen size."""
    best: dict[int, PathPoint] = {}
    for point in points:
        best.setdefault(point.n_terms, point)
    sizes = {point.n_terms for point in points if point.chosen}
    others = [p for p in points if p.n_terms in sizes and p is not best[p.n_terms]]
    return (*best.values(), *others)


def _points(fit: Fit, alternatives: Sequence[Alternative]) -> list[PathPoint]:
    """The structures about a fit, as the model keeps them."""
    problem = fit.problem
    texts, lengths, numbers = [term.text for term in problem.terms], problem.bits, problem.shape_values
    templates = ["" if t.template is None else t.offered for t in problem.terms]
    return [
        PathPoint(
            tuple(texts[m] for m in a.structure),
            a.cost,
            a.criterion,
            a.structure == fit.structure,
            a.reason,
            tuple(a.coefficients[list(a.structure)].tolist()),
            tuple(a.standard_errors.tolist()),
            tuple(problem.terms[m].kind for m in a.structure),
            float(lengths[list(a.structure)].sum()),
            tuple(templates[m] for m in a.structure) if numbers else (),
            tuple((name, numbers[name]) for name in problem.shapes_of(a.structure)),
        )
        for a in alternatives
    ]


def _version() -> str:
    try:
        return version("leastaction")
    except PackageNotFoundError:
        return "unknown"
