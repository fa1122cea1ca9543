"""Simulation error of a fit on the data that it was fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy as sp

from leastaction.curve.knots import excerpt
from leastaction.data.trajectories import Trajectories
from leastaction.errors import InputError
from leastaction.estimation.fit import Fit
from leastaction.estimation.groups import laws
from leastaction.mechanics.equations import Mechanics
from leastaction.selection.settings import SELECTION
from leastaction.simulation.forecast import forecast
from leastaction.simulation.law import Law

__all__ = ["forecast_error"]

_WINDOW_STEPS = 8  # fewest sampling intervals from which an initial state is estimated
_JUDGED = 12_000  # samples of a simulation


def forecast_error(fit: Fit, horizon: float) -> float:
    """Rms simulation error relative to the standard deviation; a diverged run counts as one."""
    apart = laws(fit)
    most = _JUDGED // len(apart)
    try:
        parts = [
            _errors(fit, horizon, excerpt(fit.completed_data().select(t), most), law) for t, *law in apart
        ]
    except InputError:  # too short for a simulation
        return np.inf
    errors = np.concatenate(parts)
    return float(np.sqrt(np.mean(np.minimum(errors, 1.0) ** 2)))


def _errors(fit: Fit, horizon: float, data: Trajectories, law: Sequence[Any]) -> np.ndarray:
    """Those of every simulation along data that obey one law."""
    (terms, coefficients), problem = law, fit.problem
    values = [sp.Float(float(value)) for value in coefficients]
    mechanics = Mechanics.of_terms(terms, values, data.coordinates, prescribed=problem.prescribed)
    shortest = min(trajectory.duration for trajectory in data)
    horizon = min(horizon, 0.4 * shortest)
    window = max(SELECTION.window * horizon, _WINDOW_STEPS * data.sampling_interval)
    run = Law(mechanics.acceleration, problem.prescribed, mechanics.timed)
    noise, seen = fit.position_std, [i for i in range(data.n_dof) if i not in problem.hidden]
    if problem.hidden:  # the estimated curve replaces the samples, with the same weight
        spread = np.nanstd(np.concatenate([t.q for t in data]), axis=0)
        noise[list(problem.hidden)] = spread[list(problem.hidden)] * (noise / spread)[seen].mean()
    result = forecast(run, data, noise, horizon, window)
    errors = np.array([(trace.rms / result.std)[seen] for trace in result.traces])
    return errors[~np.isnan(errors)]
