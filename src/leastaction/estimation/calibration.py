"""Curves and calibration numbers that explain measured columns, before any law.

The law is that of free masses that white noise pushes, q̈ = w, which makes the curve a smoothing spline whose
smoothness the likelihood finds. Columns that outnumber the coordinates then determine most calibration numbers
κ. What they leave open, such as the angle of a camera with the vertical, stays as it was drawn; the law of
motion determines it later.

Each draw of κ gives coordinates sample by sample (Levenberg–Marquardt from a grid of angles), and from these
the joint fit of curve and κ begins. A number that only adds to a column begins at its mean, one that multiplies
a function of the coordinates about its spread, any other about 0; starts and ranges of the user go first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import sympy as sp

from leastaction.curve.bspline import uniform_grid
from leastaction.curve.knots import FEWEST_SAMPLES, lay_knots
from leastaction.curve.outliers import leave_out_outliers
from leastaction.curve.smoothing import smooth
from leastaction.data.columns import arranged
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import DataError, InputError
from leastaction.estimation.gauss_newton import JointFit
from leastaction.estimation.joint import Physics
from leastaction.estimation.sensors import SensorFunctions, SensorObservations, Sensors
from leastaction.estimation.weights import Start, evidence, fit_weights, start_weights
from leastaction.findings import Finding
from leastaction.identifiers import quoted
from leastaction.library import make_term, shape_symbol
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["Calibrated", "calibrate", "directions", "moved", "sizes"]

_DRAWS = 16  # of calibration numbers, where the user gave no start
_KEPT = 4  # of these, that curves are fitted to
_SAMPLES = 600  # of each column, that draws are tried on
_SCREENED = 60  # of these, that all draws are tried on
_ANGLES = 12  # equally spaced, at which an angle begins
_BRANCHES = 4  # values of the coordinates that fit one sample, at most
_JUMP = 0.1  # rad: between samples, of no concern
_STEPS = 30  # of the fit of the coordinates, sample by sample
_SPREAD = 0.5  # natural logarithm: of drawn numbers that multiply
_OPEN = 1e-6  # of the information of a sample on a number, its coordinates known: less is none
_OTHERS = 0.5  # standard deviation of drawn numbers of any other kind


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What the columns alone determine.

    Attributes
    ----------
    trajectories : Trajectories
        Coordinates that follow from the columns, sample by sample, with the columns' noise.
    sensors : Sensors
        With calibration numbers to begin with.
    findings : tuple of Finding
    """

    trajectories: Trajectories
    sensors: Sensors
    findings: tuple[Finding, ...]


def calibrate(
    table: Trajectories,
    functions: SensorFunctions,
    angles: Sequence[str],
    degree: int,
    ranges: Mapping[str, tuple[float, float]],
    *,
    robust: bool = True,
    seed: int = 0,
) -> Calibrated:
    """Find curve and calibration numbers that explain the columns.

    Parameters
    ----------
    table : Trajectories
        The columns, and coordinates that are measured themselves.
    functions : SensorFunctions
    angles : sequence of str
        Coordinates that are angles.
    degree : int
        Of the splines.
    ranges : mapping of str to (float, float)
        Where the user expects a number.
    robust : bool
        Leave out outliers of the columns.
    seed : int
        Of the draws.

    Raises
    ------
    InputError, DataError
    """
    columns, findings = _columns(table, functions), []
    if robust:
        columns, findings = leave_out_outliers(columns, degree)
    knots = lay_knots(columns, degree)
    own = arranged(table, functions.coordinates)
    noise = np.maximum(knots.smooth.noise_std, 1e-6 * np.nanstd(np.concatenate([t.q for t in columns]), axis=0))
    sensors = Sensors(functions, [t.q for t in columns], [t.q for t in own], noise, np.zeros(len(functions.names)), ranges)
    _check_observed(functions, own)
    hunt = _Hunt(own, _centred(sensors), np.isin(functions.coordinates, list(angles)), knots.per_second, degree)
    draws = _draws(sensors, np.random.default_rng(seed))
    if len(draws) > 1:
        short = hunt.shortened()
        fits = [short.fitted(numbers, 4) for numbers in sorted(draws, key=short.misfit)[:_KEPT]]
        draws = [max(fits, key=lambda fit: fit[1])[0].weights.calibration]
    fit, _ = hunt.fitted(np.asarray(draws[0]))
    return Calibrated(hunt.sighted(fit), sensors.at(np.asarray(fit.weights.calibration)), tuple(findings))


def _columns(table: Trajectories, functions: SensorFunctions) -> Trajectories:
    """The measured columns; refuses those that there are not, or that say nothing."""
    for name in functions.columns:
        if name not in table.coordinates:
            raise InputError(
                f"measure names {quoted(name)}, which is no column of the data; the columns are "
                f"{', '.join(table.coordinates)}"
            )
    columns = arranged(table.without_rates(), functions.columns)
    columns = Trajectories([t.changed(forces=None) for t in columns])
    for i, name in enumerate(functions.columns):
        count = sum(int(np.isfinite(t.q[:, i]).sum()) for t in columns)
        if count < FEWEST_SAMPLES:
            raise DataError(
                f"column {quoted(name)} has {count} samples; at least {FEWEST_SAMPLES} are needed"
            )
    return columns


def _check_observed(functions: SensorFunctions, own: Trajectories) -> None:
    """Refuse coordinates that nothing depends on."""
    used = {symbol.name for expr in functions.expressions for symbol in expr.free_symbols}
    for i, name in enumerate(functions.coordinates):
        seen = any(np.isfinite(t.q[:, i]).any() for t in own)
        if not seen and not used & {name, f"{name}_dot", f"{name}_ddot"}:
            raise InputError(
                f"{quoted(name)} has no samples and occurs in no measurement function; add a column that "
                "depends on it, or leave it out of the library"
            )


def _draws(sensors: Sensors, rng: np.random.Generator) -> list[np.ndarray]:
    """Calibration numbers to begin with; one set where the user gave all of them."""
    functions, ranges = sensors.functions, sensors.ranges
    stacked = np.concatenate(sensors.samples)
    mean, spread = np.nanmean(stacked, axis=0), np.nanstd(stacked, axis=0)
    open_numbers = [name for name in functions.names if name not in functions.starts]
    out: list[np.ndarray] = []
    for _ in range(_DRAWS if open_numbers else 1):
        values = []
        for name in functions.names:
            if name in functions.starts:
                values.append(functions.starts[name])
                continue
            if name in ranges:
                values.append(rng.uniform(*ranges[name]))
                continue
            kind, column = _kind(functions, name)
            if kind == "offset":
                values.append(mean[column])
            elif kind == "factor" and functions.degrees[column] and not _seen(sensors).all():
                values.append(1.0)
            elif kind == "factor":
                values.append(spread[column] * np.sqrt(2.0) * np.exp(_SPREAD * rng.standard_normal()))
            else:
                values.append(_OTHERS * rng.standard_normal())
        out.append(np.array(values))
    return out


def sizes(sensors: Sensors) -> np.ndarray:
    """(n_numbers,) by which each number may be off before the law is known."""
    functions, ranges, out = sensors.functions, sensors.ranges, []
    spread = np.nanstd(np.concatenate(sensors.samples), axis=0)
    for name, value in zip(functions.names, sensors.numbers.tolist(), strict=True):
        kind, column = _kind(functions, name)
        if name in ranges:
            out.append(0.5 * (ranges[name][1] - ranges[name][0]))
        elif name in functions.starts:
            out.append(0.1 * abs(value) or _OTHERS)
        else:
            out.append({"offset": spread[column], "factor": _SPREAD * abs(value)}.get(kind, _OTHERS))
    return np.array(out)


def _kind(functions: SensorFunctions, name: str) -> tuple[str, int]:
    """How a number enters the first column that holds it alone in its kind, and that column."""
    symbol = shape_symbol(name)
    found: list[tuple[str, int]] = []
    for c, expr in enumerate(functions.expressions):
        slope = sp.diff(expr, symbol)
        if slope == 0:
            continue
        states = {s for s in slope.free_symbols if not s.name.startswith("{")}
        if symbol in slope.free_symbols:
            found.append(("other", c))
        else:
            found.append(("factor" if states else "offset", c))
    order = {"offset": 0, "factor": 1, "other": 2}
    return min(found, key=lambda pair: order[pair[0]])


@dataclass(frozen=True, eq=False)
class _Hunt:
    """Data, sensors, and the grid that curves are looked for on."""

    own: Trajectories
    sensors: Sensors
    angular: np.ndarray
    per_second: float
    degree: int

    def shortened(self) -> _Hunt:
        """The same on the beginnings of the recordings."""
        most = max(FEWEST_SAMPLES, _SAMPLES // len(self.own))
        items = [t.rows(slice(0, min(most, t.n_times))) for t in self.own]
        samples = [values[:most] for values in self.sensors.samples]
        sensors = replace(self.sensors, samples=samples, direct=[t.q for t in items])
        return replace(self, own=Trajectories(items), sensors=sensors)

    def misfit(self, numbers: np.ndarray) -> float:
        """How badly some samples are explained, each by itself: bounded, in logarithms."""
        total = 0.0
        stride = max(1, sum(t.n_times for t in self.own) // _SCREENED)
        thin = replace(
            self.sensors,
            samples=[values[::stride] for values in self.sensors.samples],
            direct=[values[::stride] for values in self.sensors.direct],
        )
        for k, run in enumerate(self.own):
            t = run.t[::stride]
            q = _by_sample(thin, k, t, numbers, self.angular)
            total += float(np.log1p(_misfit(thin, k, q, t, numbers)).sum())
        return total

    def fitted(self, numbers: np.ndarray, rounds: int = 8) -> tuple[JointFit, float]:
        """Curve and κ from given numbers, and their evidence."""
        times = [t.t for t in self.own]
        grid = uniform_grid(times, self.per_second, self.degree, 2)
        observations = SensorObservations(grid, times, self.sensors.at(numbers), self.own.rates)
        names = self.own.coordinates
        masses = EulerLagrange([make_term(f"{n}_dot**2/2", [f"{n}_dot"]) for n in names], names)
        physics = Physics(masses, np.zeros(len(names), dtype=bool), None)
        q = [_by_sample(self.sensors, k, t, numbers, self.angular) for k, t in enumerate(times)]
        there = Trajectories([t.changed(q=values) for t, values in zip(self.own, q, strict=True)])
        observations = observations.along(self._determined(self.sensors.at(numbers), there))
        curve, ones = smooth(grid, times, q).control_points, np.ones(len(names))
        weights = start_weights(observations, physics, ones, curve, ones)
        noise = weights.noise_std.copy()
        noise[noise.size - self.sensors.noise_std.size :] = self.sensors.noise_std
        weights = replace(weights, noise_std=noise)
        fit = fit_weights(observations, physics, Start(curve, ones, weights), max_rounds=rounds)
        return fit, evidence(observations, fit)

    def _determined(self, sensors: Sensors, there: Trajectories) -> np.ndarray:
        """(n_numbers, n_directions) changes of κ that the columns determine without a law."""
        free, fixed = directions(sensors, there)
        scale_open = not _seen(replace(sensors, direct=[t.q for t in self.own])).all()
        kinds = [_kind(sensors.functions, name)[0] for name in sensors.functions.names]
        moving = ~np.any(np.concatenate([free, fixed], axis=1), axis=1)
        if scale_open:  # a gain and the size of the motion cannot be told apart
            moving &= np.array(kinds) == "offset"
        return np.concatenate([fixed, np.eye(moving.size)[:, moving]], axis=1)

    def sighted(self, fit: JointFit) -> Trajectories:
        """The curve at the samples, moved by what the columns say there: coordinates with noise."""
        numbers, grid = np.asarray(fit.weights.calibration), fit.linearisation.observations.grid  # type: ignore[attr-defined]
        times = [t.t for t in self.own]
        parts = [grid.evaluate(fit.control_points, times, nu) for nu in range(3)]
        items: list[Trajectory] = []
        sensors = replace(self.sensors, direct=[t.q for t in self.own])
        for k, run in enumerate(self.own):
            states = np.stack([part[k] for part in parts])
            step = _newton_step(sensors, k, states, run.t, numbers, 1e-6)
            items.append(run.changed(q=states[0] + step))
        return Trajectories(items)


def _by_sample(
    sensors: Sensors, trial: int, times: np.ndarray, numbers: np.ndarray, angular: np.ndarray
) -> np.ndarray:
    """(n_times, n_dof) coordinates that fit the samples; rates count as zero.

    Each sample by itself may allow several values of an angle. The path is chosen that jumps least.
    """
    sensors = sensors.static()
    turning = angular & _seen(sensors)
    axes = [np.arange(_ANGLES) * 2.0 * np.pi / _ANGLES - np.pi if a else np.zeros(1) for a in turning]
    begins = np.array(list(product(*axes)))
    shape = (times.size, angular.size)
    cost = np.stack([_misfit(sensors, trial, np.broadcast_to(q, shape), times, numbers) for q in begins])
    mesh = cost.reshape(*(axis.size for axis in axes), times.size)
    for k in range(angular.size):  # local minima on the grid
        lowest = np.minimum(np.roll(mesh, 1, axis=k), np.roll(mesh, -1, axis=k))
        cost = np.where((mesh > lowest).reshape(cost.shape), np.inf, cost)
    first = np.argsort(cost, axis=0, kind="stable")[:_BRANCHES]
    there = np.isfinite(np.take_along_axis(cost, first, axis=0))
    first = first[there.any(axis=1)]
    branches = np.stack([_improved(sensors, trial, begins[row], times, numbers) for row in first])
    misfit = np.stack([_misfit(sensors, trial, q, times, numbers) for q in branches])
    return _continued(branches, misfit, angular)


def _seen(sensors: Sensors) -> np.ndarray:
    """(n_dof,) whether a coordinate has samples, or a column that depends on no rate depends on it."""
    functions = sensors.functions
    used = {
        symbol.name
        for expr, degree in zip(functions.expressions, functions.degrees, strict=True)
        for symbol in expr.free_symbols
        if not degree
    }
    direct = np.isfinite(np.concatenate(sensors.direct)).any(axis=0)
    return direct | np.isin(functions.coordinates, list(used))


def _centred(sensors: Sensors) -> Sensors:
    """The same where each coordinate that only rates tell of is measured as zero, with much noise.

    Without it nothing tells its mean. The noise is estimated, and is the spread of the coordinate.
    """
    unseen = ~_seen(sensors)
    return replace(sensors, direct=[np.where(unseen, 0.0, values) for values in sensors.direct])


def _continued(branches: np.ndarray, misfit: np.ndarray, angular: np.ndarray) -> np.ndarray:
    """(n_times, n_dof) the path of least misfit and jumps, without jumps of 2π (dynamic programming)."""
    total, origins = np.log1p(misfit[:, 0]), []
    for k in range(1, branches.shape[1]):
        step = branches[None, :, k] - branches[:, None, k - 1]
        step = np.where(angular, (step + np.pi) % (2.0 * np.pi) - np.pi, 0.0)
        through = total[:, None] + np.log1p(np.sum(step**2, axis=2) / _JUMP**2)
        origins.append(through.argmin(axis=0))
        total = through.min(axis=0) + np.log1p(misfit[:, k])
    path = [int(total.argmin())]
    for origin in reversed(origins):
        path.append(int(origin[path[-1]]))
    out = branches[path[::-1], np.arange(branches.shape[1])]
    out[:, angular] = np.unwrap(out[:, angular], axis=0)
    return out


def _improved(
    sensors: Sensors, trial: int, q: np.ndarray, times: np.ndarray, numbers: np.ndarray, steps: int = _STEPS
) -> np.ndarray:
    """(n_times, n_dof) coordinates that fit the samples better, each by itself (Levenberg–Marquardt)."""
    best, damping = q.copy(), np.full(times.size, 1e-3)
    cost = _misfit(sensors, trial, best, times, numbers)
    for _ in range(steps):
        states = np.stack([best, np.zeros_like(best), np.zeros_like(best)])
        there = best + _newton_step(sensors, trial, states, times, numbers, damping)
        found = _misfit(sensors, trial, there, times, numbers)
        better = found < cost
        best[better], settled = there[better], found >= (1.0 - 1e-6) * cost
        cost = np.where(better, found, cost)
        damping = np.where(better, 0.1 * damping, 10.0 * damping)
        if settled.all():
            break
    return best


def moved(sensors: Sensors, trajectories: Trajectories, numbers: np.ndarray) -> Trajectories:
    """Coordinates that the columns give with other calibration numbers, from those near by."""
    static = sensors.static()
    return Trajectories(
        [t.changed(q=_improved(static, k, t.q, t.t, numbers)) for k, t in enumerate(trajectories)]
    )


def directions(sensors: Sensors, trajectories: Trajectories) -> tuple[np.ndarray, np.ndarray]:
    """Changes of κ that the columns leave open, whatever the motion, and those that they determine.

    Where each sample has coordinates of its own, what is known of κ is K − Σ BᵀH⁻¹B. Numbers that stand only
    in columns that depend on velocities are in neither.

    Returns
    -------
    pair of (n_numbers, n_directions) arrays
    """
    static, size = sensors.static(), len(sensors.functions.names)
    known, whole = np.zeros((size, size)), np.zeros((size, size))
    for k, t in enumerate(trajectories):
        states = np.stack([t.q, np.zeros_like(t.q), np.zeros_like(t.q)])
        _, slopes, own = sensors.functions.evaluate(states, t.t, sensors.numbers)
        seen = np.isfinite(sensors.samples[k]) / static.noise_std
        jacobian, border = slopes[:, 0].transpose(2, 0, 1) * seen[..., None], own.transpose(2, 0, 1) * seen[..., None]
        direct = np.isfinite(sensors.direct[k])[:, :, None] / np.maximum(np.nanvar(t.q, axis=0), 1e-300) * 1e8
        matrix = np.swapaxes(jacobian, 1, 2) @ jacobian + direct * np.eye(t.q.shape[1])
        cross = np.swapaxes(jacobian, 1, 2) @ border
        whole += np.einsum("sck,scl->kl", border, border)
        known += np.einsum("sik,sil->kl", cross, np.linalg.pinv(matrix, rcond=1e-10, hermitian=True) @ cross)
    touched = np.diag(whole) > 0.0
    scale = np.where(touched, 1.0 / np.sqrt(np.where(touched, np.diag(whole), 1.0)), 1.0)
    (own,) = np.nonzero(touched)
    index = np.ix_(own, own)
    values, vectors = np.linalg.eigh((whole - known)[index] * np.outer(scale[own], scale[own]))
    wide = np.zeros((size, own.size))
    wide[own] = scale[own, None] * vectors
    return wide[:, values < _OPEN], wide[:, values >= _OPEN]


def _misfit(
    sensors: Sensors, trial: int, q: np.ndarray, times: np.ndarray, numbers: np.ndarray
) -> np.ndarray:
    h = sensors.functions.values(np.stack([q, 0.0 * q, 0.0 * q]), times, numbers)
    error = np.nan_to_num((h.T - sensors.samples[trial]) / sensors.noise_std)
    return (error**2).sum(axis=1) + np.square(np.nan_to_num(q - sensors.direct[trial])).sum(axis=1)


def _newton_step(
    sensors: Sensors,
    trial: int,
    states: np.ndarray,
    times: np.ndarray,
    numbers: np.ndarray,
    damping: np.ndarray | float,
) -> np.ndarray:
    """(n_times, n_dof) steps of the coordinates that lower the misfit of each sample."""
    h, slopes, _ = sensors.functions.evaluate(states, times, numbers)
    error = np.nan_to_num((h.T - sensors.samples[trial]) / sensors.noise_std)
    seen = np.isfinite(sensors.samples[trial]) / sensors.noise_std
    jacobian = slopes[:, 0].transpose(2, 0, 1) * seen[:, :, None]
    direct = np.isfinite(sensors.direct[trial])
    matrix = np.swapaxes(jacobian, 1, 2) @ jacobian + direct[:, :, None] * np.eye(states.shape[2])
    gradient = np.einsum("sci,sc->si", jacobian, error) + np.nan_to_num(states[0] - sensors.direct[trial])
    diagonal = np.einsum("sii->si", matrix)
    ridge = np.reshape(damping, (-1, 1)) * diagonal + 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-300
    return -np.linalg.solve(matrix + ridge[:, :, None] * np.eye(states.shape[2]), gradient[..., None])[..., 0]
