"""Simulation error of a fit on the data that it was fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from leastaction.curve.knots import excerpt
from leastaction.data.trajectories import Trajectories
from leastaction.errors import InputError
from leastaction.estimation.elimination import Eliminated
from leastaction.estimation.fit import Fit
from leastaction.estimation.groups import laws
from leastaction.hidden.band import normal_of
from leastaction.mechanics.equations import Mechanics
from leastaction.selection.settings import SELECTION
from leastaction.simulation.forecast import forecast
from leastaction.simulation.law import Law

__all__ = ["Followed", "followed", "forecast_error", "left_out"]

_WINDOW_STEPS = 8  # fewest sampling intervals from which an initial state is estimated
_JUDGED = 12_000  # samples of a simulation
_MOST_TRIALS = 12  # of more, one matters little for the law


class Followed(NamedTuple):
    """Simulation errors relative to the spread: of all runs together, and of the trial that is off most.

    ``horizon`` is that of the runs in seconds, shorter than asked for where the trials are short.
    """

    horizon: float
    error: float
    worst: float
    trials: int


def forecast_error(fit: Fit, horizon: float) -> float:
    """Rms simulation error relative to the standard deviation; a diverged run counts as one."""
    return followed(fit, horizon).error


def followed(fit: Fit, horizon: float) -> Followed:
    """How well simulations along the fitted data follow them; all is infinite where none is possible."""
    apart = laws(fit)
    most = _JUDGED // len(apart)
    try:
        runs = [_runs(fit, horizon, excerpt(fit.completed_data().select(t), most), law) for t, *law in apart]
    except InputError:  # too short for a simulation
        return Followed(np.inf, np.inf, np.inf, 0)
    errors = [errors for part, _ in runs for errors in part if errors.size]
    worst = max(_together(part) for part in errors)
    horizon = min(length for _, length in runs)
    return Followed(horizon, _together(np.concatenate(errors)), worst, len(errors))


def left_out(fit: Fit, horizon: float) -> tuple[float, float] | None:
    """The error, and that of the worst trial, where each trial is simulated by a law fitted to the others.

    To first order: with the system A_k Δλ = −g_k of each trial, its curve eliminated, the coefficients
    without trial k differ by −(Σ_j A_j)⁻¹ Σ_j g_j over the other trials.  None where that is not to be had:
    of one trial, of many, and of groups, shape parameters, hidden coordinates and measurement functions.
    """
    data, problem = fit.completed_data(), fit.problem
    special = len(laws(fit)) > 1 or fit.shapes is not None or problem.hidden or problem.sensors is not None
    if special or not 2 <= len(data) <= _MOST_TRIALS or data.n_samples > _JUDGED:
        return None
    try:
        systems = [normal_of(fit, k).eliminate() for k in range(len(data))]
        errors: list[np.ndarray] = []
        for k in range(len(data)):
            others = [system for j, system in enumerate(systems) if j != k]
            moved = replace(fit, coefficients=_without(fit, systems, others))
            ((_, *law),) = laws(moved)
            errors += _runs(moved, horizon, data.select([k]), law)[0]
    except (np.linalg.LinAlgError, InputError):
        return None
    errors = [one for one in errors if one.size]
    return (_together(np.concatenate(errors)), max(map(_together, errors))) if errors else None


def _without(fit: Fit, every: Sequence[Eliminated], others: Sequence[Eliminated]) -> np.ndarray:
    """Coefficients that minimise the cost of the others, if those of the fit minimise that of all."""
    mean = np.mean([system.gradient for system in every], axis=0)  # of coefficients of another origin
    gradient = np.stack([system.gradient - mean for system in others]).sum(axis=0)
    matrix = np.stack([system.matrix for system in others]).sum(axis=0)
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    scaled = matrix * np.outer(scale, scale)
    out = fit.coefficients.copy()
    out[list(fit.structure)] -= scale * np.linalg.solve(scaled, scale * gradient)
    return out


def _together(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.minimum(errors, 1.0) ** 2)))


def _runs(fit: Fit, horizon: float, data: Trajectories, law: Sequence[Any]) -> tuple[list[np.ndarray], float]:
    """Errors of the simulations along each trial of data that obey one law, and their length."""
    (terms, coefficients), problem = law, fit.problem
    values = [sp.Float(float(value)) for value in coefficients]
    mechanics = Mechanics.of_terms(terms, values, data.coordinates, prescribed=problem.prescribed)
    shortest = min(trajectory.duration for trajectory in data)
    horizon = min(horizon, 0.4 * shortest)
    window = max(SELECTION.window * horizon, _WINDOW_STEPS * data.sampling_interval)
    run = Law.of(mechanics)
    noise, seen = fit.position_std, [i for i in range(data.n_dof) if i not in problem.hidden]
    if problem.hidden:  # the estimated curve replaces the samples, with the same weight
        spread = np.nanstd(np.concatenate([t.q for t in data]), axis=0)
        noise[list(problem.hidden)] = spread[list(problem.hidden)] * (noise / spread)[seen].mean()
    result = forecast(run, data, noise, horizon, window)
    errors: dict[str, list[np.ndarray]] = {}
    for trace in result.traces:
        one = (trace.rms / result.std)[seen]
        errors.setdefault(trace.trial, []).append(one[~np.isnan(one)])
    return [np.concatenate(some) for some in errors.values()], horizon
