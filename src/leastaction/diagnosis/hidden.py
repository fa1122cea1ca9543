"""What is known of coordinates without a sensor, and of sensors that measure functions of coordinates."""

from __future__ import annotations

import numpy as np

from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.calibration import plausible_sizes
from leastaction.estimation.fit import Fit
from leastaction.estimation.sensors import SensorObservations, Sensors
from leastaction.findings import Finding, find
from leastaction.hidden.band import curve_errors, errors_with_sensor
from leastaction.hidden.gauge import open_changes, open_scales, reflections
from leastaction.selection.search_state import Search

__all__ = ["about_hidden", "about_sensors"]

# of the spread of a column: an error of a calibration number that changes the column by less is acceptable
_SHARE = 0.5
# of a calibration number, as in an expression: beyond, it has run away
_LARGEST = 1e12


def about_sensors(fit: Fit, residual_ratio: np.ndarray) -> list[Finding]:
    """Calibration numbers that are open, and columns that the model does not explain.

    Parameters
    ----------
    fit : Fit
    residual_ratio : (n_channels,) array
        Residuals of each channel over its noise, those of columns last.
    """
    sensors, numbers = fit.problem.sensors, fit.weights.calibration
    if sensors is None or numbers is None:
        return []
    columns, names = sensors.functions.columns, sensors.functions.names
    ratios = zip(columns, residual_ratio[-len(columns) :].tolist(), strict=True)
    out = [find("column-unexplained", c, residual_ratio=x) for c, x in ratios if x > DIAGNOSIS.noise_ratio]
    if fit.joint is not None and np.isfinite(fit.joint).all():
        stops = [None] * len(names) if fit.converged else numbers.tolist()
        errors = np.sqrt(np.clip(np.diag(fit.joint)[len(fit.structure) :], 0.0, None))
        wide = np.where(np.abs(numbers) < _LARGEST, _acceptable(fit, sensors, numbers), 0.0)
        out += [
            find("calibration-open", name, error=error, stopped_at=stop)
            for name, error, most, stop in zip(names, errors, wide, stops, strict=True)
            if not error <= most
        ]
    return out


def _acceptable(fit: Fit, sensors: Sensors, numbers: np.ndarray) -> np.ndarray:
    """(n_numbers,) standard errors above which the data do not determine a calibration number.

    A start value says little about this: it may lie near zero because of where zero was chosen. An error is
    acceptable at least if it changes no column by more than a share of the motion that the column shows.
    """
    sizes, seen = plausible_sizes(sensors.at(numbers)), fit.grid.observations
    if not isinstance(seen, SensorObservations):
        return sizes
    spread = np.nanstd(np.concatenate(sensors.samples), axis=0)
    slopes = seen.at(fit.control_points, numbers).slopes / np.maximum(spread, 1e-300)[:, None]
    ranged = np.isin(sensors.functions.names, list(sensors.ranges))  # an error must be smaller than the range
    least = _SHARE / np.maximum(slopes.max(axis=0), 1e-300)
    return np.where(ranged, sizes, np.maximum(sizes, least))


def about_hidden(search: Search) -> list[Finding]:
    """One finding for each hidden coordinate, and one for what is open of it."""
    fit = search.found
    names, hidden = fit.problem.coordinates, list(fit.problem.hidden)
    times = [t.t for t in fit.problem.trajectories]
    errors = [np.sqrt(np.mean(e**2, axis=0)) for e in curve_errors(fit, hidden, times)]
    spread = np.sqrt(np.mean([np.var(curve[:, hidden], axis=0) for curve in fit.curves()], axis=0))
    changes = open_changes(fit) if fit.usable else {}
    if fit.usable and not fit.converged:
        changes |= open_scales(fit)  # a fit that does not converge may have lost the terms that show it
    discrete = reflections(fit.problem, list(fit.structure))
    out: list[Finding] = []
    for column, i in enumerate(hidden):
        own = [float(e[column]) for e in errors]
        kinds = [change.kind for change in discrete if change.coordinate == i]
        typical = float(np.median(own))
        sensor = _gain_of_sensor(fit, i)
        out.append(find("hidden-coordinate", names[i], standard_error=typical, gauge=kinds, **sensor))
        if names[i] in changes:
            out.append(find("hidden-gauge", names[i], changes=list(changes[names[i]])))
        loose = [
            t
            for t, e in zip(fit.problem.trajectories.names, own, strict=True)
            if not e < DIAGNOSIS.indistinct * spread[column]
        ]
        if loose:
            out.append(find("hidden-motion-open", names[i], trials=len(loose), of=len(own), error=typical))
    return out


def _gain_of_sensor(fit: Fit, coordinate: int) -> dict[str, str | float]:
    """The coefficient whose standard error a sensor would reduce most, and by which factor."""
    if not fit.usable:
        return {}
    with_it = errors_with_sensor(fit, coordinate)
    if not np.isfinite(with_it).all() or not with_it.all():
        return {}
    factors = fit.standard_errors / with_it
    most = int(np.argmax(factors))
    return {"term": fit.problem.terms[fit.structure.members[most]].offered, "factor": float(factors[most])}
