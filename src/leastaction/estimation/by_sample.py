"""Coordinates from measured columns, sample by sample, and the calibration that they leave undetermined.

For given calibration numbers κ the coordinates of a sample minimise Σ_c (y_c − h_c(q; κ))² / σ_c², by
Levenberg–Marquardt from a grid of angles. Columns that depend on velocities have no weight here.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from leastaction.data.trajectories import Trajectories
from leastaction.estimation.sensors import Sensors

__all__ = ["by_sample", "directions", "misfit", "moved", "newton_step"]

_ANGLES = 12  # equally spaced start values of an angle
_BRANCHES = 4  # largest number of values of the coordinates that fit one sample
_JUMP = 0.1  # rad; smaller jumps between samples cost little
_STEPS = 30  # of the fit of the coordinates, sample by sample
_EXACT = 1e8  # weight of samples of the coordinate itself, relative to the information of the columns
_OPEN = 1e-6  # of the information on a number with known coordinates: less counts as none


def by_sample(
    sensors: Sensors, trial: int, times: np.ndarray, numbers: np.ndarray, angular: np.ndarray
) -> np.ndarray:
    """(n_times, n_dof) coordinates that fit the samples; rates count as zero.

    A single sample may allow several values of an angle. The path with the smallest jumps is chosen.
    """
    sensors = sensors.static()
    turning = angular & sensors.seen
    axes = [np.arange(_ANGLES) * 2.0 * np.pi / _ANGLES - np.pi if a else np.zeros(1) for a in turning]
    begins = np.array(list(product(*axes)))
    shape = (times.size, angular.size)
    cost = np.stack([misfit(sensors, trial, np.broadcast_to(q, shape), times, numbers) for q in begins])
    mesh = cost.reshape(*(axis.size for axis in axes), times.size)
    for k in range(angular.size):  # local minima on the grid
        lowest = np.minimum(np.roll(mesh, 1, axis=k), np.roll(mesh, -1, axis=k))
        cost = np.where((mesh > lowest).reshape(cost.shape), np.inf, cost)
    n_branches = min(_BRANCHES, int(np.isfinite(cost).sum(axis=0).max()))
    first = np.argsort(cost, axis=0, kind="stable")[:n_branches]
    branches = np.stack([_improved(sensors, trial, begins[row], times, numbers) for row in first])
    cost = np.stack([misfit(sensors, trial, q, times, numbers) for q in branches])
    return _continued(branches, cost, angular)


def _continued(branches: np.ndarray, cost: np.ndarray, angular: np.ndarray) -> np.ndarray:
    """(n_times, n_dof) the path of least misfit and jumps, without jumps of 2π (dynamic programming)."""
    origins: list[np.ndarray] = []
    total = np.log1p(cost[:, 0])
    for k in range(1, branches.shape[1]):
        step = branches[None, :, k] - branches[:, None, k - 1]
        step = np.where(angular, (step + np.pi) % (2.0 * np.pi) - np.pi, 0.0)
        through = total[:, None] + np.log1p(np.sum(step**2, axis=2) / _JUMP**2)
        origins.append(through.argmin(axis=0))
        total = through.min(axis=0) + np.log1p(cost[:, k])
    path = [int(total.argmin())]
    for origin in reversed(origins):
        path.append(int(origin[path[-1]]))
    out = branches[path[::-1], np.arange(branches.shape[1])]
    out[:, angular] = np.unwrap(out[:, angular], axis=0)
    return out


def _improved(
    sensors: Sensors, trial: int, q: np.ndarray, times: np.ndarray, numbers: np.ndarray
) -> np.ndarray:
    """(n_times, n_dof) coordinates that fit each sample better (Levenberg–Marquardt)."""
    best, damping = q.copy(), np.full(times.size, 1e-3)
    cost = misfit(sensors, trial, best, times, numbers)
    for _ in range(_STEPS):
        there = best + newton_step(sensors, trial, _at_rest(best), times, numbers, damping)
        found = misfit(sensors, trial, there, times, numbers)
        better = found < cost
        best[better], settled = there[better], found >= (1.0 - 1e-6) * cost
        cost = np.where(better, found, cost)
        damping = np.where(better, 0.1 * damping, 10.0 * damping)
        if settled.all():
            break
    return best


def moved(sensors: Sensors, trajectories: Trajectories, numbers: np.ndarray) -> Trajectories:
    """Coordinates that follow from the columns with other calibration numbers near the present ones."""
    static = sensors.static()
    items = [t.changed(q=_improved(static, k, t.q, t.t, numbers)) for k, t in enumerate(trajectories)]
    return Trajectories(items)


def directions(sensors: Sensors, trajectories: Trajectories) -> tuple[np.ndarray, np.ndarray]:
    """Changes of κ that the columns cannot determine, whatever the motion, and those that they determine.

    With separate coordinates for each sample, the information on κ is K − Σ BᵀH⁻¹B. Numbers that occur only
    in columns that depend on velocities are in neither group.

    Returns
    -------
    pair of (n_numbers, n_directions) arrays
    """
    static, size = sensors.static(), len(sensors.functions.names)
    known, whole = np.zeros((size, size)), np.zeros((size, size))
    for k, t in enumerate(trajectories):
        _, jacobian, border = static.weighted(k, _at_rest(t.q), t.t, sensors.numbers)
        matrix: np.ndarray = np.swapaxes(jacobian, 1, 2) @ jacobian
        least = sensors.direct_std**-2.0
        direct = np.isfinite(sensors.direct[k]) * (_EXACT * np.einsum("sii->si", matrix) + least)
        matrix += direct[:, :, None] * np.eye(t.q.shape[1])
        cross = np.swapaxes(jacobian, 1, 2) @ border
        whole += np.einsum("sck,scl->kl", border, border)
        known += np.einsum("sik,sil->kl", cross, np.linalg.pinv(matrix, rcond=1e-10, hermitian=True) @ cross)
    (own,) = np.nonzero(np.diag(whole) > 0.0)
    scale = 1.0 / np.sqrt(np.diag(whole)[own])
    values, vectors = np.linalg.eigh((whole - known)[np.ix_(own, own)] * np.outer(scale, scale))
    wide = np.zeros((size, own.size))
    wide[own] = scale[:, None] * vectors
    return wide[:, values < _OPEN], wide[:, values >= _OPEN]


def misfit(sensors: Sensors, trial: int, q: np.ndarray, times: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """(n_times,) squared deviations of all columns, over their noise."""
    h = sensors.functions.values(_at_rest(q), times, numbers)
    error = np.nan_to_num((h.T - sensors.samples[trial]) / sensors.noise_std)
    own = np.nan_to_num((q - sensors.direct[trial]) / sensors.direct_std)
    return (error**2).sum(axis=1) + (own**2).sum(axis=1)


def _at_rest(q: np.ndarray) -> np.ndarray:
    """(3, n_times, n_dof) states without rates."""
    return np.stack([q, np.zeros_like(q), np.zeros_like(q)])


def newton_step(
    sensors: Sensors,
    trial: int,
    states: np.ndarray,
    times: np.ndarray,
    numbers: np.ndarray,
    damping: np.ndarray | float,
) -> np.ndarray:
    """(n_times, n_dof) steps of the coordinates that lower the misfit of each sample."""
    error, jacobian, _ = sensors.weighted(trial, states, times, numbers)
    direct = np.isfinite(sensors.direct[trial]) / sensors.direct_std**2
    matrix = np.swapaxes(jacobian, 1, 2) @ jacobian + direct[:, :, None] * np.eye(states.shape[2])
    gradient = np.einsum("sci,sc->si", jacobian, error)
    gradient += direct * np.nan_to_num(states[0] - sensors.direct[trial])
    diagonal = np.einsum("sii->si", matrix)
    least = 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-300
    ridge: np.ndarray = np.asarray(damping).reshape(-1, 1) * diagonal + least
    matrix = matrix + ridge[:, :, None] * np.eye(states.shape[2])
    return -np.asarray(np.linalg.solve(np.asarray(matrix), np.asarray(gradient)[..., None]))[..., 0]
