"""Results of simulations and forecasts: motions and errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from leastaction.data.shown import written_names
from leastaction.data.trajectories import Trajectories
from leastaction.data.validation import listed
from leastaction.errors import InputError
from leastaction.identifiers import counted, quoted
from leastaction.shown import Card, Display, Panel, Series, Shown, data_frame

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from leastaction.simulation.forecast import ForecastTrace

__all__ = ["ForecastResult", "SimulationResult"]

_MEASURED = {"color": "0.55", "marker": ".", "markersize": 3, "linestyle": "none"}


@dataclass(frozen=True, eq=False, repr=False)
class SimulationResult(Shown):
    """Motion at the requested times, up to the end of the integration.

    Attributes
    ----------
    t : ndarray, shape (n_times,)
        Times reached, in seconds: the requested times or the first part of them.
    q, qdot : ndarray, shape (n_times, n_dof)
        Coordinates and rates.
    status : {"complete", "stopped"}
    reason : str
        Why it stopped: "step limit ...", "blow-up ...", "event ..." or "singular mass matrix ..."; empty if
        complete.
    n_evaluations : int
        Number of calls of the acceleration.
    stop_time : float
        Time that the integration reached; for an event, the time of the event.
    coordinates, angles : tuple of str
        Names of the coordinates and of the angles among them, if known.
    std : ndarray, shape (n_times, n_dof), optional
        Standard deviation of q, if requested; see `LagrangianModel.simulate`.
    """

    t: np.ndarray
    q: np.ndarray
    qdot: np.ndarray
    status: str
    reason: str = ""
    n_evaluations: int = 0
    stop_time: float = float("nan")
    coordinates: tuple[str, ...] = ()
    angles: tuple[str, ...] = ()
    std: np.ndarray | None = None

    @property
    def complete(self) -> bool:
        """Whether the motion reaches the last requested time."""
        return self.status == "complete"

    def plot(self, ax: Axes | Sequence[Axes] | None = None, **kwargs: Any) -> Display:
        """Plot the coordinates over time.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, or sequence of them, optional
            One for all coordinates, or one for each. By default a new figure.
        **kwargs
            Properties of Matplotlib's lines, such as ``color`` and ``linewidth``.

        Returns
        -------
        Display
            With ``figure_``, ``ax_``, ``axes_`` and ``lines_``.

        Raises
        ------
        InputError
            If the number of axes is wrong, or Matplotlib is not installed (then an ImportError, too).

        Examples
        --------
        >>> from leastaction import LagrangianModel
        >>> from leastaction.model.model import ModelTerm
        >>> spring = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
        >>> display = spring.simulate([1.0], [0.0], np.linspace(0.0, 2.0, 21)).plot()
        >>> display.ax_.get_ylabel(), display.lines_[0][0].get_ydata().shape
        ('x', (21,))
        """
        names = self._names
        written = written_names(names)
        panels = [
            Panel(written[c], "rad" if c in self.angles else "", [Series(self.t, self.q[:, i])])
            for i, c in enumerate(names)
        ]
        return Display(panels, "" if self.complete else self.reason).plot(ax, **kwargs)

    def to_frame(self) -> pd.DataFrame:
        """Return the motion as a pandas data frame, one row per time.

        Returns
        -------
        pandas.DataFrame
            Columns ``t``, the coordinates, ``<coordinate>_dot``, and ``<coordinate>_std`` if known.

        Raises
        ------
        InputError
            If pandas is not installed (extra ``pandas``); it is an ImportError, too.

        Examples
        --------
        >>> from leastaction import LagrangianModel
        >>> from leastaction.model.model import ModelTerm
        >>> spring = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
        >>> spring.simulate([1.0], [0.0], [0.0, 0.5, 1.0]).to_frame().columns.tolist()
        ['t', 'x', 'x_dot']
        """
        columns = {"t": self.t}
        parts = {"": self.q, "_dot": self.qdot, **({} if self.std is None else {"_std": self.std})}
        for ending, values in parts.items():
            columns |= {f"{c}{ending}": values[:, i] for i, c in enumerate(self._names)}
        return data_frame(columns)

    @property
    def _names(self) -> tuple[str, ...]:
        return self.coordinates or tuple(f"q{i + 1}" for i in range(self.q.shape[1]))

    def _card(self) -> Card:
        rows = [("coordinate", "first", "last", "least", "greatest")]
        for name, values in zip(self._names, self.q.T, strict=True):
            first, last, least, greatest = (
                f"{x:.4g}" for x in (values[0], values[-1], values.min(), values.max())
            )
            rows.append((name, first, last, least, greatest))
        title = f"Simulation of {', '.join(self._names)}: {self.status}"
        reach = f"{counted(len(self.t), 'time')} from {self.t[0]:g} s to {self.t[-1]:g} s"
        return Card(title, list(filter(None, (reach, self.reason))), rows)


@dataclass(frozen=True, eq=False)
class ForecastResult(Shown):
    """Forecast errors on held-out trials, as `LagrangianModel.validate` returns them.

    Attributes
    ----------
    coordinates : tuple of str
    horizon, window, tolerance : float
        Values used; in seconds, in seconds, and as a fraction of the standard deviation.
    noise_std, std : ndarray, shape (n_dof,)
        Noise of the measurement, and standard deviation of the data over all trials.
    traces : tuple of ForecastTrace
        One per start, in the order of the trials.
    skipped : tuple of (str, str)
        Trials without a start, and why.
    angles : tuple of str
        Coordinates that are angles, as far as known.

    Examples
    --------
    >>> from leastaction.data.trajectories import Trajectory
    >>> from leastaction.simulation.forecast import forecast
    >>> from leastaction.simulation.law import Law
    >>> t = np.linspace(0.0, 10.0, 201)
    >>> data = Trajectories([Trajectory(t, np.cos(t), coordinates=["x"])])
    >>> spring = forecast(Law(lambda q, qdot, forces: -q), data, np.array([0.01]))
    >>> spring.n_starts, spring.valid_time, bool(spring.rms_over_std < 0.001)
    (9, 1.0, True)
    >>> free = forecast(Law(lambda q, qdot, forces: 0 * q), data, np.array([0.01]))
    >>> bool(free.rms > 10 * free.expected_rms)
    True
    """

    coordinates: tuple[str, ...]
    horizon: float
    window: float
    tolerance: float
    noise_std: np.ndarray
    std: np.ndarray
    traces: tuple[ForecastTrace, ...]
    skipped: tuple[tuple[str, str], ...] = ()
    angles: tuple[str, ...] = ()

    @cached_property
    def rms(self) -> np.ndarray:
        """Error of each coordinate over all starts, shape (n_dof,); inf if one diverged."""
        return _rms([trace.rms for trace in self.traces])

    @cached_property
    def expected_rms(self) -> np.ndarray:
        """Expected `rms` of an exact model; starts that diverged are left out."""
        return _rms([trace.expected_rms for trace in self.traces])

    @property
    def rms_over_noise(self) -> np.ndarray:
        """`rms` in units of the measurement noise."""
        return self.rms / self.noise_std

    @property
    def rms_over_std(self) -> np.ndarray:
        """`rms` in units of the standard deviation of the data; 1 is the error of the mean as a forecast."""
        return self.rms / self.std

    @property
    def valid_time(self) -> float:
        """Median valid time of the starts, in seconds."""
        return float(np.median([trace.valid_time for trace in self.traces]))

    @cached_property
    def coverage(self) -> np.ndarray:
        """Share of samples within 1.96 `std` of the forecast, (n_dof,); 95 % for correct standard errors."""
        known = [(t, t.reach) for t in self.traces if t.reach is not None]
        parts = [(abs(t.forecast - t.measured) <= reach, t.measured) for t, reach in known]
        if not parts:
            return np.full(len(self.coordinates), np.nan)
        inside, measured = (np.concatenate(x) for x in zip(*parts, strict=True))
        with np.errstate(invalid="ignore"):
            return inside.sum(axis=0) / np.isfinite(measured).sum(axis=0)

    @property
    def n_starts(self) -> int:
        """Number of forecasts."""
        return len(self.traces)

    @property
    def n_diverged(self) -> int:
        """Number of forecasts that diverged or had no initial state."""
        return sum(trace.status in ("diverged", "failed") for trace in self.traces)

    def by_trial(self) -> dict[str, ForecastResult]:
        """The result for each trial."""
        names = dict.fromkeys(trace.trial for trace in self.traces)
        return {
            name: replace(self, traces=tuple(t for t in self.traces if t.trial == name), skipped=())
            for name in names
        }

    def with_(self, others: Sequence[ForecastResult], data: Trajectories) -> ForecastResult:
        """These forecasts and those of other laws, in the order of the trials in ``data``."""
        place = {name: k for k, name in enumerate(data.names)}
        every = [self, *others]
        traces = sorted((t for part in every for t in part.traces), key=lambda t: place[t.trial])
        skipped = sorted((s for part in every for s in part.skipped), key=lambda s: place[s[0]])
        std = np.sqrt(np.nanvar(np.concatenate([trial.q for trial in data]), axis=0))
        return replace(
            self, std=np.fmax(std, np.finfo(float).tiny), traces=tuple(traces), skipped=tuple(skipped)
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as JSON types, without the traces; null stands for inf and NaN."""
        return {
            "coordinates": list(self.coordinates),
            "horizon": self.horizon,
            "window": self.window,
            "tolerance": self.tolerance,
            "noise_std": _plain(self.noise_std),
            "std": _plain(self.std),
            **self._scores(),
            "trials": [{"trial": name, **part._scores()} for name, part in self.by_trial().items()],
            "starts": [
                {
                    "trial": trace.trial,
                    "origin": trace.origin,
                    "rms": _plain(trace.rms),
                    "expected_rms": _plain(trace.expected_rms),
                    "valid_time": trace.valid_time,
                    "status": trace.status,
                    "reason": trace.reason,
                }
                for trace in self.traces
            ],
            "skipped": [{"trial": name, "reason": reason} for name, reason in self.skipped],
        }

    def _scores(self) -> dict[str, Any]:
        return {
            "rms": _plain(self.rms),
            "expected_rms": _plain(self.expected_rms),
            "rms_over_noise": _plain(self.rms_over_noise),
            "rms_over_std": _plain(self.rms_over_std),
            "coverage": _plain(self.coverage),
            "valid_time": self.valid_time,
            "n_starts": self.n_starts,
            "n_diverged": self.n_diverged,
        }

    def format_rows(self) -> list[tuple[str, ...]]:
        """Rows of text for a table: the header, then one row per coordinate."""
        rows = [("coordinate", "rms error", "if exact", "/ noise", "/ std")]
        numbers = (self.rms, self.expected_rms, self.rms_over_noise, self.rms_over_std)
        rows += [(c, *(f"{x[i]:.3g}" for x in numbers)) for i, c in enumerate(self.coordinates)]
        return rows

    def plot(
        self, ax: Axes | Sequence[Axes] | None = None, *, trial: str | None = None, **kwargs: Any
    ) -> Display:
        """Plot one trial: measured samples, and the simulations from their starts to the horizon.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, or sequence of them, optional
            One for all coordinates, or one for each. By default a new figure.
        trial : str, optional
            Name of the trial; by default the first.
        **kwargs
            Properties of Matplotlib's lines, such as ``linewidth``, for samples and runs.

        Returns
        -------
        Display
            With ``figure_``, ``ax_``, ``axes_`` and ``lines_``: the samples first.

        Raises
        ------
        InputError
            If there is no such trial, or the number of axes is wrong; also, as an ImportError too, if
            Matplotlib is not installed (extra ``plot``).
        """
        trials = self.by_trial()
        chosen = next(iter(trials)) if trial is None else trial
        if chosen not in trials:
            raise InputError(f"trial {quoted(trial)} has no forecast; choose among {listed(tuple(trials))}")
        traces, written = trials[chosen].traces, written_names(self.coordinates)
        panels: list[Panel] = []
        t = _joined([trace.t for trace in traces])
        for i, c in enumerate(self.coordinates):
            measured = _joined([trace.measured[:, i] for trace in traces])
            run = _joined([trace.forecast[:, i] for trace in traces])
            series = [Series(t, measured, "measured", style=_MEASURED), Series(t, run, "forecast")]
            panels.append(Panel(written[c], "rad" if c in self.angles else "", series))
        return Display(panels, chosen).plot(ax, **kwargs)

    def to_frame(self) -> pd.DataFrame:
        """Return simulations and measurements as a pandas data frame, one row per time.

        Returns
        -------
        pandas.DataFrame
            Columns ``trial``, ``origin`` (start of the simulation, in seconds), ``t``, the measured
            coordinates, and ``<coordinate>_forecast``. NaN: not measured, or diverged.

        Raises
        ------
        InputError
            If pandas is not installed (extra ``pandas``); it is an ImportError, too.
        """
        columns: dict[str, Any] = {
            "trial": [trace.trial for trace in self.traces for _ in trace.t],
            "origin": [trace.origin for trace in self.traces for _ in trace.t],
            "t": np.concatenate([trace.t for trace in self.traces]),
        }
        for ending, field in (("", "measured"), ("_forecast", "forecast")):
            whole = np.concatenate([getattr(trace, field) for trace in self.traces])
            columns |= {f"{c}{ending}": whole[:, i] for i, c in enumerate(self.coordinates)}
        return data_frame(columns)

    def _card(self) -> Card:
        trials = counted(len(self.by_trial()), "trial")
        line = (
            f"{counted(self.n_starts, 'start')} in {trials}, {self.n_diverged} diverged; "
            f"within tolerance for {self.valid_time:.3g} s (median)"
        )
        notes = [f"trial {name} skipped, {reason}" for name, reason in self.skipped]
        title = f"Forecasts of {', '.join(self.coordinates)} over {self.horizon:g} s"
        return Card(title, [line], self.format_rows(), notes)

    def __repr__(self) -> str:
        errors = ", ".join(f"{c} {x:.3g}" for c, x in zip(self.coordinates, self.rms, strict=True))
        return (
            f"<ForecastResult over {self.horizon:g} s, {self.n_starts} starts ({self.n_diverged} diverged): "
            f"rms error {errors}; valid for {self.valid_time:.3g} s>"
        )


def _joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Parts joined with gaps, to be drawn as one line."""
    return np.concatenate([piece for part in parts for piece in (part, [np.nan])])


def _rms(values: Sequence[np.ndarray]) -> np.ndarray:
    """Root mean square down the rows; NaN ("not available") is left out."""
    stacked = np.array(values)
    there = ~np.isnan(stacked)
    total = np.where(there, stacked, 0.0) ** 2
    with np.errstate(invalid="ignore"):
        return np.sqrt(total.sum(axis=0) / there.sum(axis=0))


def _plain(values: np.ndarray) -> list[float | None]:
    return [float(x) if math.isfinite(x) else None for x in values]
