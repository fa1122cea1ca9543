"""Calibration numbers that the measured columns leave open: those with which the weak form holds best.

Columns alone do not tell the angle of a camera with the vertical, or the zero of an encoder; the law does.
Along the open directions of κ, coordinates follow from the columns sample by sample, and the smallest
generalised eigenvalue

    ρ(κ) = min over λ of λᵀ R λ / λᵀ S λ

of squared row residuals R and the size S of the rows says how well any law of the library holds. It does not
depend on units or on the scale of L. Many starts are tried, and the best are improved by Gauss–Newton.

Cost: 30 to 200 weak forms of one width, 1 to 10 s. Skipped where the columns leave nothing open. Without it
the joint fit begins at numbers that were drawn, and ends in wrong laws where these are far off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import least_squares

from leastaction.curve.knots import lay_knots
from leastaction.curve.smoothing import Smooth, smooth
from leastaction.data.trajectories import Trajectories
from leastaction.estimation.by_sample import directions, moved
from leastaction.estimation.calibration import plausible_sizes
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Problem
from leastaction.estimation.sensors import Sensors
from leastaction.selection.search_state import Search
from leastaction.selection.weak_form import WeakForm, weak_form

__all__ = ["run"]

_DRAWS = 24  # beside the start
_IMPROVED = 3  # of these
_EVALUATIONS = 12  # of the rows and their slopes, for each
_DIFFERENCE = 1e-4  # of the size of a direction
_RIDGE = 1e-12  # relative, of S


def run(search: Search) -> Search:
    """The search with the calibration numbers at which the weak form holds best."""
    sensors = search.problem.sensors
    if sensors is None:
        return search
    free, _ = directions(sensors, search.problem.trajectories)
    if not free.size:
        return search
    profile = _Profile.of(search, free)
    size = free.shape[1]
    rng = np.random.default_rng(search.seed)
    begins = [np.zeros(size), *rng.standard_normal((_DRAWS, size))]
    ranked = sorted(begins, key=lambda step: float(np.sum(profile.rows(step) ** 2)))[:_IMPROVED]
    found = [least_squares(profile.rows, z, profile.slopes, max_nfev=_EVALUATIONS) for z in ranked]
    best = min(found, key=lambda one: one.cost).x
    data = profile.motion(best)[0]
    numbers = profile.numbers(best)

    def sighted(problem: Problem) -> Problem:
        return replace(problem.on(data), sensors=sensors.at(numbers))

    search = search.posed(sighted)
    scales = lay_knots(data, search.problem.degree)
    return replace(
        search, grid=Grid.lay(search.problem, scales.per_second), curve=scales.smooth, scales=scales
    )


@dataclass(frozen=True, eq=False)
class _Profile:
    """How well the weak form holds after steps along the open directions, each in units of its size."""

    search: Search
    sensors: Sensors
    free: np.ndarray
    form: WeakForm

    @classmethod
    def of(cls, search: Search, free: np.ndarray) -> _Profile:
        """The profile about the motion of a search."""
        problem = search.problem
        assert problem.sensors is not None
        unit = 1.0 / np.sqrt(((free / plausible_sizes(problem.sensors)[:, None]) ** 2).sum(axis=0))
        form = weak_form(search.grid, search.curve, problem.candidates, problem.completed(np.nan), (1.0,))
        return cls(search, problem.sensors, free * unit, form)

    def numbers(self, step: np.ndarray) -> np.ndarray:
        """Calibration numbers after a step."""
        return self.sensors.numbers + self.free @ step

    def motion(self, step: np.ndarray) -> tuple[Trajectories, Smooth]:
        """Coordinates after a step, and the smooth curve through them."""
        data = moved(self.sensors, self.search.problem.trajectories, self.numbers(step))
        grid, times = self.search.grid.spline, [t.t for t in data]
        return data, smooth(grid, times, [t.q for t in data], self.search.curve.penalty, data.rates)

    def rows(self, step: np.ndarray) -> np.ndarray:
        """(n_rows,) residuals of the weak form with the best law, over the size of its rows."""
        states = self.form.states(self.motion(step)[1].control_points)
        ((inertial, potential),) = self.form.rows(states)
        row = inertial + potential
        if not np.isfinite(row).all():
            return np.ones(len(row))
        size = 0.5 * (inertial.T @ inertial + potential.T @ potential)
        scale = 1.0 / np.sqrt(np.diag(size) + 1e-300)
        size = size * np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
        law = eigh((row * scale).T @ (row * scale), size, subset_by_index=[0, 0])[1][:, 0]
        return (row * scale) @ law * np.sign(law[int(np.abs(law).argmax())])

    def slopes(self, step: np.ndarray) -> np.ndarray:
        """(n_rows, n_directions) by differences."""
        here, moves = self.rows(step), _DIFFERENCE * np.eye(step.size)
        return np.stack([(self.rows(step + move) - here) / _DIFFERENCE for move in moves], axis=1)
