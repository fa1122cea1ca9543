"""Coefficients by simulation error, for machines with motion that the library does not describe.

If equations hold only to a few per cent, their residual is not white: gears, belts and drives act at some
frequencies and hardly at others. An estimate that weights all frequencies alike is dominated by vibration.
Slow disturbances alone affect a free run.  The coefficients therefore minimise

    Σ_r Σ_n Σ_i ρ((q_i(t_n; λ, run r) − q_i(t_n)) / s_i),      ρ(x) = 2 (√(1 + x²) − 1),

over runs r of a quarter period that start on the smoothed curve, with the rms s_i of these errors at the
start values.  Standard errors are those of misspecified models (Huber 1967; White 1982, Econometrica 50:1),
run by run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import sympy as sp
from scipy.optimize import least_squares

from leastaction.curve.smoothing import Smooth
from leastaction.data.trajectories import Trajectory
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Structure
from leastaction.library import has_direction
from leastaction.mechanics.equations import Mechanics
from leastaction.simulation.integrate import rk4

__all__ = ["LinearRuns", "SimulationFit", "linear_runs", "minimise_simulation_error"]

_STEPS = 64  # of a free run
_MOST_RUNS = 300  # more are thinned: bounds time
_FEWEST_RUNS = 10  # each is a score of the standard errors
_GAP = 0.05  # of a run: a longer stretch without samples is a gap
_DIFFERENCE = 1e-5  # relative
_DELAY = 1e-3  # of a run: step of a slope
_LOST = 1e6  # error of a run that diverges or has a larger one
_EVALUATIONS = 15  # limit of the optimiser


@dataclass(frozen=True, eq=False)
class LinearRuns:
    """Errors of free runs as a linear function of coefficients, about some values of them.

    Attributes
    ----------
    errors : (n_runs, n_values, n_dof) array
        Errors, divided by their root mean square in each coordinate.
    slopes : (n_runs, n_values, n_dof, n_columns) array
        Derivatives in the coefficients, in their units.
    here, units : (n_columns,) arrays
        Coefficients, and units of the slopes.
    beside : (n_runs, n_values, n_dof, n_more) array
        Slopes in further parameters that are always fitted.
    """

    errors: np.ndarray
    slopes: np.ndarray
    here: np.ndarray
    units: np.ndarray
    beside: np.ndarray

    def with_columns(self, columns: Sequence[int]) -> LinearChoice:
        """The best coefficients of some columns, the others zero."""
        columns, here = list(columns), self.here / self.units
        weight = 1.0 / np.sqrt(1.0 + self.errors**2)  # of ρ, at the present errors
        out = np.setdiff1d(np.arange(here.size), columns)
        left = self.errors - self.slopes[..., out] @ here[out]
        used = np.concatenate([self.slopes[..., columns], self.beside], axis=-1)
        weighted = (used * weight[..., None]).reshape(-1, used.shape[-1])
        hessian = np.linalg.pinv(weighted.T @ used.reshape(weighted.shape), hermitian=True)
        step = -hessian @ (weighted.T @ left.ravel())
        left = left + used @ step
        scores = np.einsum("rti,rtij->rj", weight * left, used)
        spread = np.sqrt(np.clip(np.diag(hessian @ (scores.T @ scores) @ hessian), 1e-300, None))
        estimates, spread = here[columns] + step[: len(columns)], spread[: len(columns)]
        return LinearChoice(
            (weight * left**2).sum(axis=(0, 1)), estimates * self.units[columns], estimates / spread
        )


@dataclass(frozen=True, eq=False)
class LinearChoice:
    """Errors of free runs after a fit of some columns.

    Attributes
    ----------
    squares : (n_dof,) array
        Remaining weighted sum of squares of each coordinate.
    estimates, z : (n_columns,) arrays
        Coefficients, and coefficients over their standard errors, which are those of misspecified models.
    """

    squares: np.ndarray
    estimates: np.ndarray
    z: np.ndarray


@dataclass(frozen=True, eq=False)
class SimulationFit:
    """Coefficients and covariance of the fitted members.

    Attributes
    ----------
    estimates : (n_members,) array
    covariance : (n_members, n_members) array
    """

    estimates: np.ndarray
    covariance: np.ndarray


def minimise_simulation_error(
    grid: Grid,
    curve: Smooth,
    structure: Structure,
    coefficients: np.ndarray,
    horizon: float,
) -> SimulationFit | None:
    """Minimise the errors of free runs along a smoothed curve, starting from given coefficients.

    Parameters
    ----------
    grid : Grid
        That of ``curve``.
    curve : Smooth
    structure : Structure
        Terms to fit; coefficients of dissipation stay positive, except for asymmetric friction.
    coefficients : (n_candidates,) array
    horizon : float
        Length of a run, in seconds.

    Returns
    -------
    SimulationFit or None
        None if there are fewer than ten runs, or if they diverge.
    """
    runs, members = _Runs(grid, curve, horizon), list(structure)
    if runs.n_runs < _FEWEST_RUNS:
        return None
    flow = _Flow(grid, members, coefficients, runs)
    one = np.ones(len(members))
    before = np.abs(flow.errors(one[None])[0])
    if not 0.0 < before.max() < _LOST:
        return None
    flow.scale = np.sqrt(np.mean(before**2, axis=(0, 1)))
    terms = [grid.problem.terms[k] for k in members]
    positive = [term.kind == "dissipation" and not has_direction(term) for term in terms]
    found = least_squares(
        lambda x: flow.errors(x[None]).ravel(),
        one,
        flow.slopes,
        bounds=([0.0 if bound else -np.inf for bound in positive], np.inf),
        loss="soft_l1",
        max_nfev=_EVALUATIONS,
    )
    size = coefficients[members]
    return SimulationFit(found.x * size, _sandwich(found.x, flow) * np.outer(size, size))


def linear_runs(
    grid: Grid, curve: Smooth, coefficients: np.ndarray, units: dict[int, float], horizon: float
) -> LinearRuns | None:
    """Errors of free runs at given coefficients, and their slopes in some of them.

    A delay of the forces resembles viscous friction of either sign. A common delay is therefore fitted, too.

    Parameters
    ----------
    grid, curve, coefficients, horizon
        As for :func:`minimise_simulation_error`.
    units : dict of int to float
        Index of each candidate whose slope is needed, members or not → unit of its coefficient.

    Returns
    -------
    LinearRuns or None
        Its columns are in the sequence of ``units``; None as for :func:`minimise_simulation_error`.
    """
    runs, members = _Runs(grid, curve, horizon), list(units)
    if runs.n_runs < _FEWEST_RUNS:
        return None
    flow = _Flow(grid, members, coefficients, runs)
    here = coefficients[members]
    flow.size = np.array(list(units.values()))
    errors = flow.errors((here / flow.size)[None])[0]
    flow.scale = np.sqrt(np.mean(errors**2, axis=(0, 1)))
    if not (np.all(flow.scale > 0.0) and np.abs(errors).max() < _LOST):
        return None
    slopes = flow.slopes(here / flow.size).reshape(*errors.shape, -1)
    beside = np.zeros((*errors.shape, 0))
    if grid.problem.trajectories.driven:
        flow.runs = _Runs(grid, curve, horizon, _DELAY * horizon)
        beside = ((flow.errors((here / flow.size)[None])[0] - errors / flow.scale) / _DELAY)[..., None]
    return LinearRuns(errors / flow.scale, slopes, here, flow.size, beside)


def _sandwich(x: np.ndarray, flow: _Flow) -> np.ndarray:
    """H⁻¹ Σ_r g_r g_rᵀ H⁻¹ with the gradient g_r of each run."""
    error, slopes = flow.errors(x[None])[0], flow.slopes(x)
    root = np.sqrt(1.0 + error.ravel() ** 2)
    hessian: np.ndarray = slopes.T @ (slopes / root[:, None] ** 3)  # with ρ″, not only ρ′
    gradients = (slopes * (error.ravel() / root)[:, None]).reshape(len(error), -1, x.size).sum(axis=1)
    half = np.linalg.pinv(hessian) @ gradients.T
    return half @ half.T


class _Runs:
    """Start times of free runs, the motion along them, and the forces.

    Attributes
    ----------
    begin : (n_runs,) array
        Times at which the runs start.
    nodes : (n_steps + 1,) array
        Seconds since the start.
    q : (n_runs, n_steps + 1, n_dof) array
    qdot : (n_runs, n_dof) array
        At the start.
    forces : (2 n_steps + 1, n_runs, n_dof) array or None
        At the nodes and between them.
    """

    def __init__(self, grid: Grid, curve: Smooth, horizon: float, late: float = 0.0) -> None:
        self.nodes = np.linspace(0.0, horizon, _STEPS + 1)
        begins = [_begins(trajectory, horizon) for trajectory in grid.problem.trajectories]
        owner = np.repeat(np.arange(len(begins)), [b.size for b in begins])
        keep = np.linspace(0, owner.size - 1, min(owner.size, _MOST_RUNS)).round().astype(int)
        begin, owner = np.concatenate(begins)[keep], owner[keep]
        self.begin = begin
        self.n_runs, n_dof = begin.size, grid.problem.trajectories.n_dof
        self.q = np.empty((self.n_runs, self.nodes.size, n_dof))
        self.qdot = np.empty((self.n_runs, n_dof))
        half = np.linspace(0.0, horizon, 2 * _STEPS + 1)
        prescribed = grid.problem.prescribed
        moved = grid.problem.trajectories.driven or prescribed
        self.forces = np.empty((half.size, self.n_runs, n_dof)) if moved else None
        for k, part in enumerate(grid.spline.split(curve.control_points)):
            own, space = owner == k, grid.spline.spaces[k]
            self.q[own] = space.evaluate(part, begin[own][:, None] + self.nodes)
            self.qdot[own] = space.evaluate(part, begin[own], 1)
            if self.forces is not None:
                times = half[:, None] + begin[own]
                self.forces[:, own] = grid.force_at(k, times - late)
                for i in prescribed:  # its force is its acceleration
                    self.forces[:, own, i] = space.evaluate(part, times, 2)[..., i]


def _begins(trajectory: Trajectory, horizon: float) -> np.ndarray:
    """Start times of successive runs of one trajectory; no run covers a gap."""
    t = trajectory.t[np.isfinite(trajectory.q).all(axis=1)]
    if t.size < 2:
        return np.empty(0)
    step = np.diff(t)
    gaps = np.flatnonzero(step > max(_GAP * horizon, 3.0 * float(np.median(step))))
    begins = t[0] + horizon * np.arange(int((t[-1] - t[0]) / horizon))
    ends = begins + horizon
    over = (t[gaps] < ends[:, None]) & (t[gaps + 1] > begins[:, None])
    return begins[~over.any(axis=1)]


class _Flow:
    """Free runs as a function of the members' coefficients, in units of those at the start."""

    def __init__(self, grid: Grid, members: list[int], coefficients: np.ndarray, runs: _Runs) -> None:
        self.runs, self.size = runs, coefficients[members]
        self.scale = np.ones(runs.q.shape[-1])
        candidates, symbols = grid.problem.candidates, [sp.Dummy(real=True) for _ in members]
        values: list[sp.Expr] = [sp.Float(float(value)) for value in coefficients]
        for k, symbol in zip(members, symbols, strict=True):
            values[k] = symbol
        self.mechanics = Mechanics.of_terms(
            candidates.terms, values, candidates.coordinates, symbols, candidates.prescribed
        )

    def errors(self, x: np.ndarray) -> np.ndarray:
        """(n_variants, n_runs, n_steps + 1, n_dof), over ``scale``; ``x`` is (n_variants, n_members)."""
        runs, forces = self.runs, self.runs.forces
        given = (x * self.size).T[:, :, None]
        shape = (len(x), *runs.qdot.shape)
        q, _ = rk4(
            partial(self.mechanics.acceleration, parameters=given),
            np.broadcast_to(runs.q[:, 0], shape),
            np.broadcast_to(runs.qdot, shape),
            runs.nodes,
            substeps=1,
            forces=None if forces is None else (lambda times: forces[:, None]),
            clock=runs.begin if self.mechanics.timed else None,
        )
        error = (np.moveaxis(q, 0, 2) - runs.q) / self.scale
        return np.clip(np.where(np.isnan(error), np.inf, error), -_LOST, _LOST)

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Jacobian of the errors by central differences."""
        steps = _DIFFERENCE * np.eye(x.size)
        both = self.errors(np.concatenate([x + steps, x - steps]))
        return ((both[: x.size] - both[x.size :]) / (2 * _DIFFERENCE)).reshape(x.size, -1).T
