"""Jobs of the worker: a discovery, a refit, and forecasts of their models; and what they return."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from leastaction.app.candidates import Task
from leastaction.errors import DataError, InputError
from leastaction.findings import because

if TYPE_CHECKING:
    from leastaction import LagrangianModel, Trajectories
    from leastaction.model.diagnostics import HiddenMotion, PathPoint
    from leastaction.simulation.forecast import ForecastResult

__all__ = ["Found", "Motion", "Walk", "derive", "filled", "forecast", "longest", "refine", "search"]

_LONGEST = 20.0  # seconds of a forecast that is shown
_SHARE = 0.6  # of a trial
_FRAMES = 1500


@dataclass(frozen=True, eq=False)
class Motion:
    """One long forecast beside the measurement.

    Attributes
    ----------
    trial : str
    held_out : bool
        Whether the trial was held out of the fit.
    t, measured, forecast : arrays, shapes (n_times,), (n_times, n_dof), (n_times, n_dof)
        NaN if not measured, or after the forecast has diverged.
    valid_time : float
        Seconds until the error of the forecast exceeds the tolerance.
    note : str
        Reason why the forecast ends early; empty if it does not.
    unseen : tuple of int
        Indices of the coordinates that have no sensor in the trial.
    estimated : dict of int to HiddenMotion
        Those of them whose motion the fit has estimated -> that motion at the times `t`.
    """

    trial: str
    held_out: bool
    t: np.ndarray
    measured: np.ndarray
    forecast: np.ndarray
    valid_time: float
    note: str = ""
    unseen: tuple[int, ...] = ()
    estimated: dict[int, HiddenMotion] = field(default_factory=dict)

    @property
    def observed(self) -> np.ndarray:
        """Measured motion without gaps, (n_times, n_dof), completed by what is estimated; otherwise NaN."""
        out = filled(self.measured)
        for i, motion in self.estimated.items():
            out[:, i] = motion.q
        return out


@dataclass(frozen=True, eq=False)
class Found:
    """A model and its forecasts, for the page.

    Attributes
    ----------
    model : LagrangianModel
    stage : {"provisional", "fitted", "forecast"}
        Progress: coefficients from the quadratic model of the likelihood, fitted, or fitted and forecast.
    validation, motion
        Forecasts; None before the last stage, and if there is none.
    motion_fault : str
        Reason why there is no `motion`.
    """

    model: LagrangianModel
    stage: Literal["provisional", "fitted", "forecast"]
    validation: ForecastResult | None = None
    motion: Motion | None = None
    motion_fault: str = ""


@dataclass(frozen=True)
class Walk:
    """The best structure of each size, by increasing size; the chosen one for its own size.

    Attributes
    ----------
    points : tuple of PathPoint
    relevance : float or None
        Share of the equation error that a term had to remove to stay.
    """

    points: tuple[PathPoint, ...]
    relevance: float | None = None

    @classmethod
    def of(cls, model: LagrangianModel) -> Walk:
        """The curve of a discovered model; without points if there are no diagnostics."""
        best: dict[int, PathPoint] = {}
        for point in model.diagnostics.path if model.diagnostics else ():
            finite = math.isfinite(point.bic) and math.isfinite(point.cost)
            if finite and (point.chosen or point.n_terms not in best):
                best[point.n_terms] = point
        relevance = model.provenance.get("options", {}).get("relevance")
        return cls(tuple(best[size] for size in sorted(best)), relevance)

    @property
    def chosen(self) -> int:
        """Position of the chosen structure."""
        return next((k for k, point in enumerate(self.points) if point.chosen), 0)

    def difference(self, place: int) -> tuple[list[str], list[str]]:
        """Terms that a structure has in addition to, and that it lacks relative to, the chosen one."""
        here, there = self.points[place].written, self.points[self.chosen].written
        return [e for e in here if e not in there], [e for e in there if e not in here]

    def verdict(self, place: int) -> str:
        """Comparison of a structure with the chosen one by the criterion, and reason, in words."""
        point = self.points[place]
        if point.chosen:
            return "This is the structure that leastaction chose."
        size, why = f"{abs(point.bic):.3g}", because(point.reason, self.relevance)
        if point.bic >= 0:
            text = f"The criterion prefers the chosen structure by {size}; 10 is already a strong preference."
        else:
            text = f"By the criterion alone, this structure is better by {size}."
        if not why:
            return text
        hint = " On hardware, such terms imitate missing ones." if point.reason == "irrelevant" else ""
        return f"{text} It was not chosen because {why}.{hint}"


def search(progress: Callable[[str, dict], None], task: Task) -> Found:
    """Discover a model and forecast with it."""
    import leastaction as la

    task = task.shifted()
    model = la.discover(
        task.fitted,
        task.library,
        task.known,
        force_offset=task.forces.offsets,
        prescribed=task.forces.prescribed,
        hidden=task.hidden,
        lengths=task.lengths,
        relevance=task.relevance,
        progress=lambda s, d: progress(s, _plain(d)),
    )
    derive(model)
    return forecast(progress, task, model)


def derive(model: LagrangianModel) -> None:
    """Compute properties of the law for the page; they are cached with the model."""
    _ = model.symmetries, model.simple_constants, model.small_motions


def refine(progress: Callable[[str, dict], None], model: LagrangianModel, point: PathPoint) -> Found:
    """Fit a structure of the trade-off curve of a model."""
    from leastaction.refit import refit

    found = refit(model, point, lambda s, d: progress(s, _plain(d)))
    derive(found)
    return Found(found, "fitted")


def forecast(progress: Callable[[str, dict], None], task: Task, model: LagrangianModel) -> Found:
    """Forecast with a model."""
    task = task.shifted()
    progress("forecast", {})
    validation = None
    if task.held_out is not None:
        try:
            validation = model.validate(task.held_out)
        except (InputError, DataError):
            validation = None  # the trials are too short; this is not a fault of the model
    try:
        motion, fault = _motion(model, task), ""
    except (InputError, DataError) as error:
        motion, fault = None, str(error)
    return Found(model, "forecast", validation, motion, fault)


def longest(data: Trajectories) -> int:
    """The first of the longest trials, which an animation shows."""
    most = max(run.duration for run in data)
    return next(k for k, run in enumerate(data) if run.duration >= 0.99 * most)


def filled(q: np.ndarray) -> np.ndarray:
    """A copy in which a missing sample repeats the previous one, and the first ones repeat the next."""
    out = q.copy()
    for column in out.T:
        there = np.flatnonzero(np.isfinite(column))
        if there.size:
            place = np.searchsorted(there, np.arange(column.size), side="right") - 1
            column[:] = column[there[np.maximum(place, 0)]]
    return out


def _motion(model: LagrangianModel, task: Task) -> Motion:
    hidden = model.diagnostics.hidden_motion if model.diagnostics else {}
    # Only in trials of the fit is the motion of a coordinate without a sensor estimated.
    held_out = None if hidden else task.held_out
    data: Trajectories = task.fitted if held_out is None else held_out
    place = longest(data)
    run = data.select(place)
    result = model.validate(run, horizon=min(_SHARE * run.duration, _LONGEST))
    trace, names = result.traces[0], model.coordinates
    keep = slice(None, None, -(-trace.t.size // _FRAMES))
    t, forecast = trace.t[keep], (trace.forecast if trace.motion is None else trace.motion)[keep].copy()
    measured = np.full_like(forecast, np.nan)
    for column, name in enumerate(result.coordinates):
        if name in names:
            measured[:, names.index(name)] = trace.measured[keep, column]
    estimated = {names.index(name): _at(t, motions[place]) for name, motions in hidden.items()}
    unseen = tuple(i for i, name in enumerate(names) if name not in result.coordinates)
    for i in unseen:
        if names[i] in model.angles:  # whole turns are not known
            start = estimated[i].q[0] if i in estimated else 0.0
            forecast[:, i] -= 2 * np.pi * np.round((forecast[0, i] - start) / (2 * np.pi))
    return Motion(
        data.names[place],
        held_out is not None,
        t,
        measured,
        forecast,
        trace.valid_time,
        trace.reason,
        unseen,
        estimated,
    )


def _at(t: np.ndarray, motion: HiddenMotion) -> HiddenMotion:
    q, error = (np.interp(t, motion.t, values) for values in (motion.q, motion.standard_error))
    return motion._replace(t=t, q=q, standard_error=error)


def _plain(details: dict) -> dict:
    """The numbers and the law so far; other details of a stage are not sent."""
    numbers = {k: float(v) for k, v in details.items() if isinstance(v, (int, float, np.number))}
    law = details.get("coefficients")
    return numbers if not isinstance(law, dict) else {**numbers, "coefficients": law}
