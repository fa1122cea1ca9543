"""Data of the figures: the stretch that is shown, residuals and their correlation, and energy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.mechanics.equations import state_symbols
from leastaction.model.diagnostics import Diagnostics, HiddenMotion
from leastaction.model.model import LagrangianModel

__all__ = ["Energy", "Series"]

_ZOOM_SAMPLES = (100, 260)  # fewest and most sampling intervals of the zoom
_LAGS = 40


@dataclass(frozen=True, eq=False)
class Series:
    """Residuals of all trials, and the trial in the figures: the one with the most samples."""

    model: LagrangianModel

    @cached_property
    def trial(self) -> int:
        """Index of the trial that is shown."""
        return int(np.argmax([t.n_samples for t in self.trajectories]))

    @property
    def trajectories(self) -> Trajectories:
        return _diagnostics(self.model).trajectories

    @property
    def shown(self) -> Trajectory:
        return self.trajectories[self.trial]

    @cached_property
    def residuals(self) -> list[np.ndarray]:
        """Measured − fitted, one (n_times, n_dof) array for each trial."""
        curves = _diagnostics(self.model).curve()
        return [trial.q - curve for trial, curve in zip(self.trajectories, curves, strict=True)]

    def curve(self, t: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Fitted curve of the trial that is shown, (n_times, n_dof)."""
        return self.curve_of(self.trial, t, derivative)

    def curve_of(self, trial: int, t: np.ndarray, derivative: int = 0) -> np.ndarray:
        diagnostics = _diagnostics(self.model)
        points = diagnostics.grid.split(diagnostics.control_points)[trial]
        return diagnostics.grid.spaces[trial].evaluate(points, t, derivative)

    @cached_property
    def zoom(self) -> tuple[float, float]:
        """Stretch from the middle of the trial that shows both samples and motion."""
        t = self.shown.t
        step = self.shown.duration / max(self.shown.n_times - 1, 1)
        q_rate, q_turn = (self.curve(t, nu) for nu in (1, 2))
        period = 2 * np.pi * np.sqrt((q_rate**2).mean(axis=0) / np.maximum((q_turn**2).mean(axis=0), 1e-300))
        few, many = (n * step for n in _ZOOM_SAMPLES)
        length = min(float(np.clip(1.5 * np.median(period), few, many)), self.shown.duration)
        start = float(t[0]) + 0.5 * (self.shown.duration - length)
        return start, start + length

    @cached_property
    def measured(self) -> tuple[int, ...]:
        """Coordinates with a sensor."""
        hidden = _diagnostics(self.model).hidden_motion
        return tuple(i for i, name in enumerate(self.model.coordinates) if name not in hidden)

    def estimate(self, coordinate: int) -> HiddenMotion:
        """Motion of a coordinate without a sensor in the trial that is shown."""
        return _diagnostics(self.model).hidden_motion[self.model.coordinates[coordinate]][self.trial]

    def correlation(self, coordinate: int) -> np.ndarray:
        """Autocorrelation of the residuals at lags of 1, 2, … samples, missing ones left out."""
        parts = [r[:, coordinate] for r in self.residuals]
        lags = min(_LAGS, max(len(p) for p in parts) - 2)
        power = np.nanmean(np.concatenate(parts) ** 2)
        out = np.full(max(lags, 0), np.nan)
        for lag in range(1, lags + 1):
            products = np.concatenate([p[lag:] * p[:-lag] for p in parts if p.size > lag])
            products = products[np.isfinite(products)]
            if products.size and power > 0:
                out[lag - 1] = products.mean() / power
        return out

    def all_residuals(self, coordinate: int) -> np.ndarray:
        """Finite residuals of one coordinate, over all trials."""
        values = np.concatenate([r[:, coordinate] for r in self.residuals])
        return values[np.isfinite(values)]


@dataclass(frozen=True, eq=False)
class Energy:
    """Energy along the fitted curve of one trial, each (n_times,).

    `expected` is the initial energy plus the work of the known forces and of friction. The model does not
    explain total − expected.
    """

    t: np.ndarray
    total: np.ndarray
    potential: np.ndarray
    expected: np.ndarray

    @property
    def kinetic(self) -> np.ndarray:
        return self.total - self.potential

    @property
    def finite(self) -> bool:
        return bool(np.isfinite([self.total, self.potential, self.expected]).all())

    @property
    def imbalance(self) -> float:
        """Root mean square of total − expected, in units of the mean kinetic energy."""
        scale = float(np.abs(self.kinetic).mean())
        return float(np.sqrt(np.mean((self.total - self.expected) ** 2))) / scale if scale > 0 else np.nan

    @classmethod
    def of(cls, series: Series, trial: int, n_times: int = 3000) -> Energy:
        """Energy on equal steps, at least as fine as the samples, up to `n_times`."""
        model, data = series.model.of_trial(trial), series.trajectories[trial]
        n_times = max(min(n_times, 4 * data.n_times), 2)
        t = np.linspace(data.t[0], data.t[-1], n_times)
        q, qdot = series.curve_of(trial, t), series.curve_of(trial, t, 1)
        total, potential = model.energy(q, qdot), model.energy(q, np.zeros_like(q))
        power = -_friction_power(model, q, qdot)
        if data.forces is not None:
            for i in range(model.n_dof):
                power = power + np.interp(t, data.t, data.forces[:, i]) * qdot[:, i]
        work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))])
        return cls(t, total, potential, work + np.mean(total - work))


def _friction_power(model: LagrangianModel, q: np.ndarray, qdot: np.ndarray) -> np.ndarray:
    """Σ_i q̇_i ∂ψ/∂q̇_i, shape (n_times,)."""
    if not model.dissipation:
        return np.zeros(len(q))
    names, rates, _ = state_symbols(model.coordinates)
    # The generated code does not use the names of the coordinates.
    neutral = [sp.Dummy(real=True) for _ in (*names, *rates)]
    psi = model.dissipation_function.xreplace(dict(zip((*names, *rates), neutral, strict=True)))
    power = sp.Add(*(v * sp.diff(psi, v) for v in neutral[len(names) :]))
    function = sp.lambdify(neutral, power, modules="numpy", cse=True)
    with np.errstate(all="ignore"):
        return np.broadcast_to(np.asarray(function(*q.T, *qdot.T), dtype=float), (len(q),))


def _diagnostics(model: LagrangianModel) -> Diagnostics:
    assert model.diagnostics is not None  # write_report has checked it
    return model.diagnostics
