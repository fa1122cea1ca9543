"""Parts that move far, driven by the measured motion: their laws, simulated and fitted.

A pendulum that hangs from a carriage or from another pendulum, and a mass that slides on a spring across a
rod that turns, obey no linear law.  Frequency, damping, a number b of their form and their first states in
each trial are fitted, so that their force explains most of what is left of an equation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
from scipy.linalg import orth
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

__all__ = ["FINE", "LOAD", "RINGS", "SECOND", "SLIDE", "FarPart", "Form", "Trial", "basis"]

RINGS = 0.5  # highest damping ratio of a resonance
FINE = 4  # steps of a simulation between two rows
_RANK = 1e-7  # singular value, relative to the largest
_SOLVES, _STARTS = 30, 3  # steps of a fit, best starts of fits
_PLACES, _LOSSES, _GAIN = 16, (0.02, 0.1), 3.0  # their ω and ζ to scan, and a usual resonance
_LEAST, _FAR, _HUGE, _NUDGE = 0.001, 1e4, 1e30, 1e-4  # ζ; b over its start; a force; difference quotient
_A = np.ndarray  # in signatures


@dataclass(frozen=True)
class Form:
    """A part that may move far, with a number b, at a place that q moves."""

    acceleration: Callable[[_A, _A, _A, _A, _A, _A], _A]  # of ω², b, z, q, q̇, q̈: z̈ without damping
    force: Callable[[_A, _A, _A, _A, _A, _A, _A, _A], _A]  # of ω², b, z, ż, z̈, q, q̇, q̈, but for terms of q
    first: tuple[float, ...]  # values of b to start from
    power: tuple[float, float]  # of ω² and of the deviation at resonance, in the unit of these
    terms: tuple[str, ...]  # with friction in h alone, what declares it


LOAD = Form(  # a pendulum under a carriage; b is 1/length, z its angle over b
    lambda w, b, z, q, v, a: -w * np.sin(b * z) / b - a * np.cos(b * z),
    lambda w, b, z, u, c, q, v, a: b * u**2 * np.sin(b * z) - c * np.cos(b * z),
    (0.1, 0.4, 1.2),
    (0.0, -1.0),
    ("{h}_dot**2", "{q}_dot*{h}_dot*cos({h})", "cos({h})"),
)
SECOND = Form(  # a pendulum that hangs from a pendulum; b is the ratio of the lengths, z its angle
    lambda w, b, z, q, v, a: b * (v**2 * np.sin(q - z) - a * np.cos(q - z)) - w * np.sin(z),
    lambda w, b, z, u, c, q, v, a: -c * np.cos(q - z) - u**2 * np.sin(q - z),
    (0.3, 1.0, 2.0),
    (0.0, 0.0),
    ("{h}_dot**2", "{q}_dot*{h}_dot*cos({q}-{h})", "cos({h})"),
)
SLIDE = Form(  # a mass that slides across a rod, on a spring; b is gravity and z the way, over the distance
    lambda w, b, z, q, v, a: (v**2 - w) * z - b * np.sin(q) - a,
    lambda w, b, z, u, c, q, v, a: -(z**2) * a - 2.0 * z * u * v - c - b * z * np.cos(q),
    (0.1, 0.4, 1.2),
    (1.0, 0.0),
    ("({q}_dot+{h}_dot)**2", "{h}**2*{q}_dot**2", "{h}*sin({q})", "{h}**2"),
)


@dataclass(frozen=True, eq=False)
class Trial:
    """The slow part of the motion of a trial, and rows of the regression, which are ``every`` so many."""

    step: float
    every: int
    stride: int  # steps of the grid in one of a simulation
    width: float  # of the filter, in steps
    times: np.ndarray  # (n_rows,)
    places: list[tuple[int, np.ndarray, np.ndarray]]  # coordinate, d²g/dt² (n_times,), ∂g/∂q (n_rows,)
    motion: np.ndarray  # (n_times, 3, n_dof), q, q̇ and q̈
    residual: np.ndarray  # (n_dof, n_rows)
    others: np.ndarray  # (n_columns, n_dof, n_rows), what may explain it otherwise


@dataclass(frozen=True, eq=False)
class FarPart:
    """Fits of a part of some form on coordinate ``i``: of log ω, log ζ, log b, and the first states."""

    form: Form
    trials: list[Trial]
    i: int
    others: np.ndarray  # (n_rows, n_others), orthonormal

    @cached_property
    def _residual(self) -> np.ndarray:
        residual = np.concatenate([t.residual[self.i] for t in self.trials])
        return residual - self.others @ (self.others.T @ residual)

    def fitted(self, band: tuple[float, float]) -> np.ndarray:
        """The numbers with which it explains most of what neither others nor free oscillations do."""
        starts, left = self._starts(band), list[float]()
        for some in np.array_split(starts, _PLACES):
            tried = self._columns(some, np.zeros((len(some), len(self.trials), 2)))
            left += [self._left(tried[:, k]) for k in range(len(some))]
        order = np.argsort(left)
        ends = np.log([[2.0 * np.pi * f for f in band], [_LEAST, 2.0 * RINGS], [1.0 / _FAR, _FAR]])
        found = [self._solved(start, ends) for start in starts[order[:_STARTS]]]
        return min(found, key=lambda x: self._left(self.at(x)))

    def _solved(self, start: np.ndarray, ends: np.ndarray) -> np.ndarray:
        @lru_cache(maxsize=1)
        def columns(x: bytes) -> np.ndarray:  # one simulation gives the forces and the slopes of a step
            return self.at(np.frombuffer(x))

        def misfit(x: np.ndarray) -> np.ndarray:
            return self._misfit(columns(x.tobytes()))

        def slopes(x: np.ndarray) -> np.ndarray:
            return self._slopes(columns(x.tobytes()))

        states = np.tile([-np.inf, np.inf], (2 * len(self.trials), 1))
        ends = np.concatenate([ends + np.array([[0.0], [0.0], start[2:]]), states]).T
        start, bounds = np.concatenate([start, np.zeros(len(states))]), (ends[0], ends[1])
        return least_squares(misfit, start, slopes, bounds=bounds, x_scale="jac", max_nfev=_SOLVES).x

    def driven(self, columns: np.ndarray) -> np.ndarray:
        """(2, n_rows) what others and free oscillations leave, and what the part explains of it."""
        free = basis(columns[4:].T)
        whole, force = (x - free @ (free.T @ x) for x in (self._residual, columns[0]))
        return np.array([whole, _amount(whole, force) * force])

    def _left(self, columns: np.ndarray) -> float:
        whole, part = self.driven(columns)
        return float(np.sum((whole - part) ** 2))

    def _misfit(self, columns: np.ndarray) -> np.ndarray:
        return self._residual - _amount(self._residual, columns[0]) * columns[0]

    def _slopes(self, columns: np.ndarray) -> np.ndarray:
        """Of the misfit as the mass is fitted anew, but for those along the misfit."""
        force, slopes = columns[0], columns[1:]
        off = slopes - np.outer(slopes @ force / max(float(force @ force), 1e-300), force)
        return -_amount(self._residual, force) * off.T

    def at(self, x: np.ndarray) -> np.ndarray:
        """(1 + 3 + 2 n_trials, n_rows) force of the part, and slopes, but for what others explain."""
        return self._columns(x[None, :3], x[3:].reshape(1, -1, 2))[:, 0]

    def swinging(self, x: np.ndarray) -> np.ndarray:
        """(n_trials, n_rows) its force where nothing drives it; a large free oscillation proves no part."""
        still = [replace(t, motion=0.0 * t.motion) for t in self.trials]
        free = _simulated(self.form, still, self.i, x[None, :3], x[3:].reshape(1, -1, 2)) * self._place
        return free - (free @ self.others) @ self.others.T

    @cached_property
    def _place(self) -> np.ndarray:
        return np.repeat(np.eye(len(self.trials)), [t.times.size for t in self.trials], axis=1)

    def _columns(self, logs: np.ndarray, states: np.ndarray) -> np.ndarray:
        """(1 + 3 + 2 n_trials, n, n_rows) forces of n parts, and slopes, but for what others explain."""
        n = len(self.trials)
        lanes, begins = np.repeat(logs[None], 6, axis=0), np.repeat(states[None], 6, axis=0)
        for k in range(3):
            lanes[1 + k, :, k] += _NUDGE
        for k in range(2):
            begins[4 + k, ..., k] += _NUDGE
        found = _simulated(self.form, self.trials, self.i, lanes.reshape(-1, 3), begins.reshape(-1, n, 2))
        found = found.reshape(6, len(logs), -1)
        slopes = (found[1:] - found[0]) / _NUDGE
        first = np.swapaxes(slopes[3:, None] * self._place[None, :, None], 0, 1).reshape(2 * n, len(logs), -1)
        columns = np.concatenate([found[:1], slopes[:3], first])
        return columns - (columns @ self.others) @ self.others.T

    def _starts(self, band: tuple[float, float]) -> np.ndarray:
        """(n, 3) log ω, log ζ and log b to begin with."""
        size = float(np.std(np.concatenate([t.motion[:, 2, self.i] for t in self.trials])))
        omegas = 2.0 * np.pi * np.geomspace(*band, _PLACES + 2)[1:-1]
        tried = np.array([*product(omegas, _LOSSES, self.form.first)])
        square, far = self.form.power
        tried[:, 2] *= tried[:, 0] ** (2.0 * square) * (_GAIN * size / tried[:, 0] ** 2) ** far
        return np.log(tried)


def _amount(whole: np.ndarray, force: np.ndarray) -> float:
    """The mass, which is not negative."""
    return max(float(whole @ force) / max(float(force @ force), 1e-300), 0.0)


def _simulated(form: Form, trials: list[Trial], i: int, logs: np.ndarray, states: np.ndarray) -> np.ndarray:
    """(n, n_rows) forces of parts with log ω, log ζ, log b, (n, 3), from z and ż/ω, (n, n_trials, 2)."""
    omega, damping, b = np.exp(logs).T[..., None]
    step, count = np.array([t.stride * t.step for t in trials]), max(len(t.motion) for t in trials)
    padded = [np.pad(t.motion[..., i], ((0, count - len(t.motion)), (0, 0)), "edge") for t in trials]
    motion = np.stack(padded, axis=2)
    z, rate, square, loss = states[..., 0], omega * states[..., 1], omega**2, 2.0 * damping * omega
    kept, forces = np.exp(-loss * step), np.empty((count, *z.shape))
    with np.errstate(over="ignore", invalid="ignore"):  # a slide may run away where the rod turns fast
        push = form.acceleration(square, b, z, *motion[0])
        for k in range(count):
            if k > 0:
                rate = rate + 0.5 * step * push
                z = z + step * rate
                push = form.acceleration(square, b, z, *motion[k])
                rate = kept * rate + 0.5 * step * push
            forces[k] = form.force(square, b, z, rate, push - loss * rate, *motion[k])
    forces = np.clip(np.nan_to_num(forces), -_HUGE, _HUGE)
    rows = list[np.ndarray]()
    for k, t in enumerate(trials):
        slow = gaussian_filter1d(forces[: len(t.motion), :, k], t.width / t.stride, axis=0)
        rows.append(slow[:: t.every // t.stride])
    return np.concatenate(rows).T


def basis(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns with the same span."""
    sizes = np.linalg.norm(columns, axis=0)
    return orth(columns / np.where(sizes > 0.0, sizes, 1.0), rcond=_RANK)
