"""Motions of a law in many windows at once, and their fit to the measured motion.

A motion obeys the law and starts in each window from an unknown state (q, q̇) of all coordinates.
The Levenberg–Marquardt method minimises its deviations from the smoothed motion in the measured coordinates.
The unknowns are the initial states alone, or also the coefficients λ, which are common to all windows:

    Σ_w log(1 + χ_w²(x_w, λ) / s),       χ_w² = mean ((q(t; x_w, λ) − q_measured(t)) / scale)²,

with s four times the median of χ_w². The logarithm bounds the influence of windows whose motion is on a
wrong branch of the hidden coordinate. The states are eliminated window by window (variable projection;
Golub & Pereyra 2003, Inverse Problems 19:R1). Many sets of coefficients run side by side: each step
integrates one batch by RK4.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from leastaction.hidden.settings import HIDDEN
from leastaction.hidden.windows import Solutions, Windows
from leastaction.mechanics.equations import Mechanics, solve
from leastaction.simulation.integrate import rk4

__all__ = ["Shooter"]

_LOST = 1e6  # deviation of a motion that diverges
_STEEPEST = 1e11  # slope of a deviation; steeper ones are those of motions that diverge
_FIRST_DAMPING = 1e-2  # relative to the diagonal
_MOST_NUMBERS = 2**20  # in the motions of one batch: its arrays stay in the cache of a processor
_MOST_CHANGE = 0.5  # of a coefficient, in one step
_ROUNDING = 1e-2  # largest error of a coordinate in single precision, in its scale
_GAIN = 1e-3  # share of its objective that a fit has to gain,
_IDLE = 8  # at least once in so many steps
_TINY = 1e-300  # added to divisors that may vanish
_LEAST_VARIANCE = 1e-2  # of deviations, in their scale; smaller ones are rounding
_INDEPENDENT = 8.0  # independent values in a window; deviations are correlated


class _Point(NamedTuple):
    """Sets of coefficients and states in a fit; the first axis of each array is that of the sets."""

    coefficients: np.ndarray
    states: np.ndarray
    error: np.ndarray
    slopes: np.ndarray
    deviation: np.ndarray

    def of(self, sets: np.ndarray) -> _Point:
        """Some of the sets."""
        return _Point(*(values[sets] for values in self))

    def where(self, moved: np.ndarray, trial: _Point) -> _Point:
        """The trial for sets that moved."""
        pairs = zip(trial, self, strict=True)
        return _Point(*(np.where(moved.reshape(-1, *[1] * (old.ndim - 1)), new, old) for new, old in pairs))


class Shooter:
    """Motions of the laws of a structure in given windows.

    Parameters
    ----------
    mechanics : Mechanics
        With the free coefficients as parameters.
    windows : Windows
    unit : (2 n_dof,) array
        Scales of coordinates and rates.
    """

    def __init__(self, mechanics: Mechanics, windows: Windows, unit: np.ndarray) -> None:
        self.mechanics: Mechanics = mechanics
        self.windows: Windows = windows
        self.unit: np.ndarray = unit
        self.n_dof: int = mechanics.n_dof
        self.precision: type[np.floating] = _precision(windows)

    def on(self, windows: Windows) -> Shooter:
        """The same laws in other windows."""
        return Shooter(self.mechanics, windows, self.unit)

    def motions(self, states: np.ndarray, coefficients: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """(n_nodes, n_runs, 2 n_dof) states, from (n_runs, 2 n_dof) initial ones.

        ``coefficients`` has the shape (n_members, n_runs), ``owner`` is the window of each run.
        """
        n, forces = self.n_dof, self.windows.forces
        if forces is not None:
            forces = forces[:, owner]
        with np.errstate(over="ignore"):
            states, coefficients = (x.astype(self.precision) for x in (states, coefficients))
        q, qdot = rk4(
            partial(self.mechanics.acceleration, parameters=coefficients),
            states[..., :n],
            states[..., n:],
            self.windows.nodes,
            substeps=1,
            forces=None if forces is None else (lambda times: forces),
            clock=self.windows.begin[owner] if self.mechanics.timed else None,
        )
        return np.concatenate([q, qdot], axis=-1)

    def deviations(self, states: np.ndarray, coefficients: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """(n_runs, n_values) deviations of the motions in the measured coordinates, over their scale."""
        return self._compared(self.motions(states, coefficients, owner), owner)

    def _compared(self, motions: np.ndarray, owner: np.ndarray) -> np.ndarray:
        measured = list(self.windows.measured)
        target = self.windows.q[owner][..., measured].transpose(1, 0, 2)
        with np.errstate(all="ignore"):
            error = (motions[..., measured] - target) / self.windows.scale[measured]
        error = np.clip(np.where(np.isfinite(error), error, _LOST), -_LOST, _LOST)
        return error.transpose(1, 0, 2).reshape(owner.size, -1)

    def linearised(
        self, states: np.ndarray, coefficients: np.ndarray, owner: np.ndarray, sizes: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Deviations of motions, and their slopes in initial states and, with ``sizes``, in coefficients.

        Slopes are per unit of each state, and per size of each coefficient. They follow from the variational
        equations, the linear ones of small changes of a motion, integrated along it.

        Returns
        -------
        (n_runs, n_values) array, (n_runs, n_values, n_unknowns) array
        """
        measured = list(self.windows.measured)
        motions = self.motions(states, coefficients, owner)
        error = self._compared(motions, owner)
        with np.errstate(all="ignore"):
            across = self._variations(*self._varied(motions, coefficients, owner, sizes))
            slopes = across[..., measured, :] / self.windows.scale[measured][:, None]
        slopes = slopes.transpose(1, 0, 2, 3).reshape(*error.shape, -1)
        lost = (np.abs(error) == _LOST)[..., None] | ~(np.abs(slopes) < _STEEPEST)
        return error, np.where(lost, 0.0, slopes)

    def _varied(
        self, motions: np.ndarray, coefficients: np.ndarray, owner: np.ndarray, sizes: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """∂q̈/∂(q, q̇), (n_nodes, n_runs, n_dof, 2 n_dof), and ∂q̈/∂λ times the sizes, along motions."""
        n, windows, mechanics = self.n_dof, self.windows, self.mechanics
        coefficients = coefficients.astype(motions.dtype)
        q, qdot = motions[..., :n], motions[..., n:]
        clock = windows.begin[owner] + windows.nodes[:, None] if mechanics.timed else None
        mass, right = mechanics.mass_and_right(q, qdot, coefficients, clock)
        if windows.forces is not None:
            right += windows.forces[::2, owner].astype(right.dtype)
        qddot = solve(mass, right[..., None])[..., 0]
        shared = sizes is not None
        pushed = mechanics.slopes(q, qdot, qddot, clock, coefficients, of_parameters=shared)
        if shared:
            pushed[..., 2 * n :] *= sizes.astype(pushed.dtype)
        pushed = solve(mass, pushed)
        return pushed[..., : 2 * n], pushed[..., 2 * n :]

    def _variations(self, turning: np.ndarray, pushing: np.ndarray) -> np.ndarray:
        """(n_nodes, n_runs, n_dof, n_unknowns) changes of the coordinates, by Heun's method."""
        n, nodes = self.n_dof, self.windows.nodes
        count = 2 * n + pushing.shape[-1]
        pushed = np.zeros((*pushing.shape[:-1], count), pushing.dtype)
        pushed[..., 2 * n :] = pushing
        state = np.zeros((turning.shape[1], 2 * n, count), pushing.dtype)
        state[:, range(2 * n), range(2 * n)] = self.unit
        out = np.empty((nodes.size, turning.shape[1], n, count), pushing.dtype)
        out[0] = state[:, :n]

        def rates(at: int, state: np.ndarray) -> np.ndarray:
            return np.concatenate([state[:, n:], turning[at] @ state + pushed[at]], axis=1)

        for k, step in enumerate(np.diff(nodes).tolist()):
            first = rates(k, state)
            second = rates(k + 1, state + step * first)
            state = state + 0.5 * step * (first + second)
            out[k + 1] = state[:, :n]
        return out

    def screen(
        self, coefficients: np.ndarray, begins: np.ndarray, kept: int, rounds: int, doublings: int = 0
    ) -> Solutions:
        """The best of many start values of every window, each with its own fit.

        Over a long window, only start values close to the true ones lead to the measured motion. They are
        therefore tried and fitted at the start of the window. Then the horizon doubles, and the better half
        stays, until it is the whole window.

        Parameters
        ----------
        coefficients : (n_sets, n_members) array
        begins : (n_sets, n_starts, 2 n_hidden) array
            Hidden coordinates and rates at the start of a window.
        kept : int
            Number of start values of each window that are fitted over its whole length.
        rounds : int
            Steps of the fit for each horizon.
        doublings : int
            How often the horizon doubles.

        Returns
        -------
        Solutions
            With ``kept`` · n_windows windows: the kept ones of the first window, then of the second, …; fewer
            if there are fewer start values.
        """
        shape = (*begins.shape[:2], 2 * self.n_dof)
        states = np.empty((shape[0], len(self.windows), *shape[1:]))
        states[..., : self.n_dof] = self.windows.q[:, 0][None, :, None]
        states[..., self.n_dof :] = self.windows.qdot[:, 0][None, :, None]
        states[..., self._hidden] = begins[:, None]
        for further in range(doublings, 0, -1):
            part = self.on(self.windows.until(0.5**further))
            found = part._fit_best(coefficients, states, kept * 2**further, rounds)
            states = found.states.reshape(*states.shape[:2], -1, states.shape[-1])
        return self._fit_best(coefficients, states, kept, rounds)

    def _fit_best(self, coefficients: np.ndarray, states: np.ndarray, kept: int, rounds: int) -> Solutions:
        """Fit the best of (n_sets, n_windows, n_starts, 2 n_dof) states."""
        n_sets, n_windows, n_starts, size = states.shape
        kept = min(kept, n_starts)
        found = np.empty(states.shape[:-1])
        at_once = max(1, _MOST_NUMBERS // (self.windows.nodes.size * size * n_windows * n_starts))
        owner = np.repeat(np.arange(n_windows), n_starts)
        for a in range(0, n_sets, at_once):
            part = slice(a, a + at_once)
            count = len(coefficients[part])
            given = np.repeat(coefficients[part], n_windows * n_starts, axis=0).T
            error = self.deviations(states[part].reshape(-1, size), given, np.tile(owner, count))
            found[part] = (error**2).mean(axis=-1).reshape(count, n_windows, n_starts)
        first = np.argsort(found, axis=-1, kind="stable")[..., :kept]
        states = np.take_along_axis(states, first[..., None], axis=2).reshape(n_sets, -1, size)
        return self.fit_states(coefficients, states, np.repeat(np.arange(n_windows), kept), rounds)

    @property
    def _hidden(self) -> list[int]:
        """Indices of hidden coordinates and rates in a state."""
        return [*self.windows.hidden, *(self.n_dof + i for i in self.windows.hidden)]

    def fit_states(
        self, coefficients: np.ndarray, states: np.ndarray, owner: np.ndarray, rounds: int
    ) -> Solutions:
        """Fit the initial states with fixed coefficients; ``owner`` is the window of each state of a set."""
        n_sets, n_runs, size = states.shape
        given = np.repeat(coefficients, n_runs, axis=0).T
        owner, flat = np.tile(owner, n_sets), states.reshape(-1, size)

        def linearised(at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            error, slopes = self.linearised(at, given, owner)
            return error, slopes, (error**2).mean(axis=-1)

        damping = np.full(len(flat), _FIRST_DAMPING)
        error, slopes, cost = linearised(flat)
        for _ in range(rounds):
            matrix, diagonal = _normal(slopes)
            matrix = matrix + _ridge(damping, diagonal)
            move = -np.linalg.solve(matrix, np.einsum("rmi,rm->ri", slopes, error)[..., None])[..., 0]
            trial = flat + move * self.unit
            new = linearised(trial)
            better = new[2] < cost
            flat = np.where(better[:, None], trial, flat)
            error = np.where(better[:, None], new[0], error)
            slopes = np.where(better[:, None, None], new[1], slopes)
            cost = np.where(better, new[2], cost)
            damping = np.where(better, 0.1 * damping, 10.0 * damping)
        return Solutions(coefficients, flat.reshape(states.shape), cost.reshape(n_sets, n_runs))

    def fit(self, start: Solutions, sizes: np.ndarray, rounds: int, *, race: bool = False) -> Solutions:
        """Fit coefficients and initial states of every set together.

        A normal prior of standard deviation ``sizes`` draws coefficients of little effect to zero. The
        variance of the deviations is the median of χ².

        Parameters
        ----------
        start : Solutions
            One state for each window.
        sizes : (n_members,) array
            Standard deviations of the coefficients in the prior.
        rounds : int
            Steps of the fit.
        race : bool
            Give up sets whose cost falls too slowly to come near the lowest one.
        """
        point = self._at(start.states, start.coefficients, sizes)
        found = Solutions(point.coefficients.copy(), point.states.copy(), point.deviation.copy())
        going = np.arange(len(point.coefficients))
        damping, idle = np.full(going.size, _FIRST_DAMPING), np.zeros(going.size, dtype=int)
        costs = [found.cost]
        for left in range(rounds - 1, -1, -1):
            trial, gain = self._tried(point, damping, sizes)
            better = gain > 0.0
            point = point.where(better, trial)
            found.coefficients[going], found.states[going] = point.coefficients, point.states
            found.deviation[going] = point.deviation
            damping = np.where(better, np.maximum(0.5 * damping, 1e-8), 4.0 * damping)
            idle = np.where(gain > _GAIN, 0, idle + 1)
            costs = [*costs[-_IDLE:], found.cost]
            kept = idle < _IDLE
            if race and len(costs) > _IDLE:
                kept &= _competing(costs, left / _IDLE)[going]
            if not kept.all():
                going, damping, idle, point = going[kept], damping[kept], idle[kept], point.of(kept)
            if not going.size:
                break
        return found

    def _at(self, states: np.ndarray, coefficients: np.ndarray, sizes: np.ndarray) -> _Point:
        """Sets of coefficients and states, with the deviations there and their slopes."""
        n_sets, n_windows, size = states.shape
        given = np.repeat(coefficients, n_windows, axis=0).T
        owner = np.tile(np.arange(n_windows), n_sets)
        error, slopes = self.linearised(states.reshape(-1, size), given, owner, sizes)
        error, slopes = (x.reshape(n_sets, n_windows, *x.shape[1:]) for x in (error, slopes))
        return _Point(coefficients, states, error, slopes, (error**2).mean(axis=-1))

    def _tried(self, point: _Point, damping: np.ndarray, sizes: np.ndarray) -> tuple[_Point, np.ndarray]:
        """Each set after a step, and (n_sets,) how much this lowers its objective, as a share of it."""
        count, here = point.error.shape[-1], point.coefficients / sizes
        typical = np.maximum(np.median(point.deviation, axis=1), _TINY)
        prior = np.maximum(typical, _LEAST_VARIANCE) * count / _INDEPENDENT
        weight = 1.0 / (1.0 + point.deviation / (4.0 * typical[:, None]))
        move, shift = self._step(point, weight, damping, prior, here)
        limit = _MOST_CHANGE * np.maximum(np.abs(here), _MOST_CHANGE)
        share = np.minimum(1.0, limit / np.maximum(np.abs(shift), _TINY)).min(axis=1)
        trial = self._at(
            point.states + share[:, None, None] * move * self.unit,
            point.coefficients + share[:, None] * shift * sizes,
            sizes,
        )
        before, after = (
            _cost(at.deviation, at.coefficients / sizes, typical, prior, count) for at in (point, trial)
        )
        return trial, 1.0 - after / np.maximum(before, _TINY)

    def _step(
        self, point: _Point, weight: np.ndarray, damping: np.ndarray, prior: np.ndarray, here: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Steps of states (n_sets, n_windows, 2 n_dof) and coefficients (n_sets, n_members), in units.

        ``prior`` is the precision of the coefficients, ``here`` their values, in units, too.
        """
        size, error = 2 * self.n_dof, point.error
        own, shared = point.slopes[..., :size], point.slopes[..., size:]
        matrix, diagonal = _normal(own)
        matrix = matrix + _ridge(np.broadcast_to(damping[:, None], diagonal.shape[:-1]), diagonal, 1e-9)
        border = np.swapaxes(own, -1, -2) @ shared
        gradient = np.einsum("swmi,swm->swi", own, error)
        held = np.linalg.solve(matrix, gradient[..., None])[..., 0]
        follow = np.linalg.solve(matrix, border)
        corner = np.einsum("sw,swij->sij", weight, _normal(shared)[0])
        corner = corner + prior[:, None, None] * np.eye(here.shape[1])
        right = np.einsum("sw,swmi,swm->si", weight, shared, error) + prior[:, None] * here
        schur = corner - np.einsum("sw,swij,swik->sjk", weight, border, follow)
        right = right - np.einsum("sw,swij,swi->sj", weight, border, held)
        schur = schur + _ridge(damping, np.einsum("sii->si", corner), 1e-9)
        shift = -np.linalg.solve(schur, right[..., None])[..., 0]
        return -held - np.einsum("swij,sj->swi", follow, shift), shift


def _precision(windows: Windows) -> type[np.floating]:
    """Single precision, unless deviations of coordinates far from zero are not much larger than its rounding.

    Its functions take a quarter of the time, and start values need no more.
    """
    measured = list(windows.measured)
    largest = np.abs(windows.q[..., measured]).max(axis=(0, 1))
    rounding = np.finfo(np.float32).eps * largest
    return np.float32 if np.all(rounding < _ROUNDING * windows.scale[measured]) else np.float64


def _competing(costs: list[np.ndarray], further: float) -> np.ndarray:
    """Which sets come near the lowest cost if each falls on as before, for ``further`` times as long."""
    first, last = costs[0], costs[-1]
    falls = np.minimum(last / (first + _TINY), 1.0)
    return last * falls**further <= HIDDEN.stands_out * last.min()


def _cost(
    found: np.ndarray, coefficients: np.ndarray, typical: np.ndarray, prior: np.ndarray, count: int
) -> np.ndarray:
    """(n_sets,) objective of a fit: deviations of ``count`` values in a window, and the prior."""
    scale = 4.0 * typical
    bounded = np.log1p(found / scale[:, None]).sum(axis=1)
    return count * scale * bounded + prior * (coefficients**2).sum(axis=1)


def _normal(slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """JᵀJ over the values, and its diagonal."""
    matrix = np.swapaxes(slopes, -1, -2) @ slopes
    return matrix, np.einsum("...ii->...i", matrix)


def _ridge(damping: np.ndarray, diagonal: np.ndarray, least: float = 1e-12) -> np.ndarray:
    """Diagonal matrices that damp a step."""
    values = damping[..., None] * diagonal + least * diagonal.max(axis=-1, keepdims=True) + _TINY
    return values[..., None] * np.eye(diagonal.shape[-1])
