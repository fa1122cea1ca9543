"""How well a fit forecasts the motion that it was fitted to."""

from __future__ import annotations

import numpy as np
import sympy as sp

from leastaction.curve.knots import excerpt
from leastaction.errors import InputError
from leastaction.estimation.fit import Fit
from leastaction.mechanics.equations import Mechanics
from leastaction.selection.settings import SELECTION
from leastaction.simulation.forecast import forecast

__all__ = ["forecast_error"]

_WINDOW_STEPS = 8  # sampling intervals in which a state is found, at least
_JUDGED = 12_000  # samples along which is simulated


def forecast_error(fit: Fit, horizon: float) -> float:
    """Root mean square simulation error over standard deviation, runs that are lost counted as one."""
    problem = fit.problem
    data = excerpt(problem.trajectories, _JUDGED)
    values = [sp.Float(float(value)) for value in fit.coefficients]
    mechanics = Mechanics.of_terms(problem.terms, values, data.coordinates, prescribed=problem.prescribed)
    shortest = min(trajectory.duration for trajectory in data)
    horizon = min(horizon, 0.4 * shortest)
    window = max(SELECTION.window * horizon, _WINDOW_STEPS * data.sampling_interval)
    noise = fit.weights.position_std
    try:
        result = forecast(
            mechanics.acceleration,
            data,
            noise,
            horizon,
            window,
            prescribed=problem.prescribed,
            timed=mechanics.timed,
        )
    except InputError:  # too short for a simulation
        return np.inf
    errors = np.array([trace.rms / result.std for trace in result.traces])
    errors = errors[~np.isnan(errors)]
    return float(np.sqrt(np.mean(np.minimum(errors, 1.0) ** 2)))
