"""Does a part that no sensor measures act on the coordinates?  Resonators of every frequency are tried.

With such a part, a load that swings or a shaft that twists, the equation error depends on the past of the
motion.  About its rest the part is a mass m on a spring and a damper.  Its deviation z from the place g(q)
that carries it obeys

    z̈ + 2ζω ż + ω² z = −d²g/dt²,    and its force is  m (ω² z + 2ζω ż) ∂g/∂q.

g is a coordinate or, for an angle, its sine or cosine.  Parts that move far obey other laws: a pendulum that
hangs from a carriage or from another pendulum, and a mass that slides on a spring across a rod that turns.
Driven by the measured motion they are simulated, with ω, ζ, a number b of their form and their first states
fitted.  The equation error along the curve is regressed on such forces, with m ≥ 0, beside all common terms,
late forces, and free oscillations of each trial.  A part is reported if it explains most of what those leave
below some frequency, the quarters of the recordings agree on it, and no other form of L explains as much.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from heapq import nlargest
from itertools import islice, product

import numpy as np
from scipy.linalg import block_diag, orth
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares, minimize, nnls

from leastaction.diagnosis.friction import rates_of_forces, usual_friction
from leastaction.diagnosis.missing_terms import common_terms
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.diagnosis.smooth_changes import doubts_about_the_form
from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Problem
from leastaction.findings import Finding, find
from leastaction.identifiers import free_name
from leastaction.mechanics import Points
from leastaction.selection.search_state import Search

__all__ = ["unmeasured_part"]

_BANDS = 0.5, 0.25, 1.0  # in this order, as shares of the highest frequency
_FREQUENCIES, _DAMPING = 40, (0.003, 0.01, 0.03, 0.1, 0.3)  # of the resonators that are tried
_FEWEST_TURNS, _RATE = 1.5, 8.0  # turns in the longest trial; rows in a period of the highest frequency
_STEPS, _ROWS, _TRIALS = 60, 3, 12  # of the simplex; for each column, at least; the longest ones
_MOST, _RINGS, _RANK = np.array([np.inf, 0.0]), 0.5, 1e-7  # of log ω, log ζ; ζ of a resonance; singular value
_FINE, _SOLVES, _STARTS = 4, 30, 3  # of parts that move far: steps a row, steps of a fit, best starts of fits
_PLACES, _LOSSES, _GAIN = 16, (0.02, 0.1), 3.0  # their ω and ζ to scan, and a usual resonance
_LEAST, _FAR, _HUGE, _NUDGE = 0.001, 1e4, 1e30, 1e-4  # ζ; b over its start; a force; difference quotient
_A = np.ndarray  # in signatures
_HALF = 0.5  # of what a resonator leaves: a part that moves far and leaves less describes it better


@dataclass(frozen=True)
class _Form:
    """A part that may move far, with a number b, at a place that q moves."""

    acceleration: Callable[[_A, _A, _A, _A, _A, _A], _A]  # of ω², b, z, q, q̇, q̈: z̈ without damping
    force: Callable[[_A, _A, _A, _A, _A, _A, _A, _A], _A]  # of ω², b, z, ż, z̈, q, q̇, q̈, but for terms of q
    first: tuple[float, ...]  # values of b to start from
    power: tuple[float, float]  # of ω² and of the deviation at resonance, in the unit of these
    terms: tuple[str, ...]  # with friction in h alone, what declares it


_LOAD = _Form(  # a pendulum under a carriage; b is 1/length, z its angle over b
    lambda w, b, z, q, v, a: -w * np.sin(b * z) / b - a * np.cos(b * z),
    lambda w, b, z, u, c, q, v, a: b * u**2 * np.sin(b * z) - c * np.cos(b * z),
    (0.1, 0.4, 1.2),
    (0.0, -1.0),
    ("{h}_dot**2", "{q}_dot*{h}_dot*cos({h})", "cos({h})"),
)
_SECOND = _Form(  # a pendulum that hangs from a pendulum; b is the ratio of the lengths, z its angle
    lambda w, b, z, q, v, a: b * (v**2 * np.sin(q - z) - a * np.cos(q - z)) - w * np.sin(z),
    lambda w, b, z, u, c, q, v, a: -c * np.cos(q - z) - u**2 * np.sin(q - z),
    (0.3, 1.0, 2.0),
    (0.0, 0.0),
    ("{h}_dot**2", "{q}_dot*{h}_dot*cos({q}-{h})", "cos({h})"),
)
_SLIDE = _Form(  # a mass that slides across a rod, on a spring; b is gravity and z the way, over the distance
    lambda w, b, z, q, v, a: (v**2 - w) * z - b * np.sin(q) - a,
    lambda w, b, z, u, c, q, v, a: -(z**2) * a - 2.0 * z * u * v - c - b * z * np.cos(q),
    (0.1, 0.4, 1.2),
    (1.0, 0.0),
    ("({q}_dot+{h}_dot)**2", "{h}**2*{q}_dot**2", "{h}*sin({q})", "{h}**2"),
)


@dataclass(frozen=True, eq=False)
class _Part:
    """A part on coordinate ``carrier``, in whose equation it acts.

    ``errors`` are (2, n_rows) what everything else leaves of that equation, and what the part explains of it.
    """

    carrier: int
    errors: np.ndarray
    omega: float
    damping: float
    form: _Form | None = None

    @property
    def left(self) -> float:
        whole, part = self.errors
        return float(np.sum((whole - part) ** 2) / max(np.sum(whole**2), 1e-300))

    @property
    def size(self) -> float:
        """In the quarter of the recordings where it is smallest, over that in all."""
        quarters = np.array_split(self.errors, 4, axis=1)
        return min(float(np.sum(w * p) / max(np.sum(p * p), 1e-300)) for w, p in quarters)


def unmeasured_part(search: Search) -> list[Finding]:
    """Frequency and damping of a part that explains most of what no other term explains, if there is one.

    Noise of the accelerations grows with the square of the frequency, so that it hides a part in one band of
    the equation error and not in another.  The first band in which a part is found decides.
    """
    fit, high = search.found, DIAGNOSIS.part_fastest / search.scales.period
    if any(doubt.code == "form-imitated" for doubt in doubts_about_the_form(fit, DIAGNOSIS.part_of_error)):
        return []  # another form of L explains as much
    return list(islice(filter(None, (_in_band(fit, share * high) for share in _BANDS)), 1))


def _in_band(fit: Fit, high: float) -> Finding | None:
    """A part that explains the equation error below a frequency."""
    names, trials = fit.problem.coordinates, list(_trials(fit, high))
    used = [i for i in range(len(names)) if i not in fit.problem.prescribed]
    others = [_basis(np.concatenate([t.others[:, i] for t in trials], axis=1).T) for i in used]
    low = _FEWEST_TURNS / max(lengths := [float(np.ptp(s.breakpoints)) for s in fit.grid.spline.spaces])
    if low >= high or len(others[0]) < _ROWS * (others[0].shape[1] + 2 * len(trials)):
        return None
    parts = [_resonator(trials, i, other, (low, high)) for i, other in zip(used, others, strict=True)]
    k = int(np.argmin([part.left for part in parts]))
    i, other = used[k], others[k]
    forms = (_SECOND, _SLIDE) if names[i] in fit.problem.candidates.turning else (_LOAD,)
    for form in forms if fit.grid.forces is not None else ():  # motion of its own says too little of b
        far = _Far(form, trials, i, other)
        best = far.fitted((low, high))
        errors = far.driven(np.concatenate([far.at(best), far.swinging(best)]))
        parts.append(_Part(i, errors, float(np.exp(best[0])), float(np.exp(best[1])), form))

    def passes(part: _Part) -> bool:
        frequency = part.omega / (2.0 * np.pi)
        rings = low < frequency < high and part.damping < _RINGS
        many = frequency * sum(lengths) > DIAGNOSIS.part_turns
        least = DIAGNOSIS.part_explains if many else DIAGNOSIS.part_few_turns
        return rings and part.size > DIAGNOSIS.part_agrees and 1.0 - part.left > least

    passing = filter(passes, parts)
    best = min(passing, key=lambda p: p.left * (_HALF if p.form is None else 1.0), default=None)
    return None if best is None else _described(best, fit)


def _described(part: _Part, fit: Fit) -> Finding:
    """The finding, with candidates to declare the part."""
    carrier = fit.problem.coordinates[part.carrier]
    hidden = free_name("h", {*fit.problem.coordinates, *fit.problem.ranges})
    if part.form is None:  # position of its mass, on a spring to the carrier
        terms = [f"{hidden}_dot**2", f"({carrier}-{hidden})**2"]
        friction = f"({carrier}_dot-{hidden}_dot)**2/2"
    else:
        terms = [text.format(q=carrier, h=hidden) for text in part.form.terms]
        friction = f"{hidden}_dot**2/2"
    # without known forces, another spring on the coordinate goes with another resonance
    numbers = {"frequency": part.omega / (2.0 * np.pi), "damping_ratio": part.damping}
    seen = numbers if fit.grid.forces is not None else {}
    seen |= {"explained": 1.0 - part.left, "hidden": hidden, "terms": terms, "friction": friction}
    return find("unmeasured-part", carrier, **seen)


def _resonator(trials: list[_Trial], i: int, other: np.ndarray, band: tuple[float, float]) -> _Part:
    """The resonator on coordinate ``i`` that explains most."""

    def part(logs: np.ndarray) -> _Part:
        omega, damping = np.exp(np.minimum(logs, _MOST))
        return _Part(i, _errors(trials, i, other, logs), float(omega), float(damping))

    def left(logs: np.ndarray) -> float:
        return part(logs).left

    starts = np.log([*product(2.0 * np.pi * np.geomspace(*band, _FREQUENCIES), _DAMPING)])
    best = minimize(left, min(starts, key=left), method="Nelder-Mead", options={"maxfev": _STEPS})
    return part(best.x)


@dataclass(frozen=True, eq=False)
class _Trial:
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


def _trials(fit: Fit, high: float) -> Iterator[_Trial]:
    problem, n = fit.problem, len(fit.problem.coordinates)
    wide = problem.wider([*common_terms(problem.candidates, "standard"), *usual_friction(problem.candidates)])
    columns = wide.candidates.subset(np.flatnonzero(~wide.is_known).tolist())  # known ones set the scale
    late, begin = None if fit.grid.forces is None else rates_of_forces(fit)[:, 0], 0
    longest = nlargest(_TRIALS, fit.grid.spline.spaces, key=lambda space: space.n_intervals)
    for space in fit.grid.spline.spaces:
        chunk = slice(begin, begin := begin + space.n_intervals)
        if space not in longest:
            continue
        points, _, residual = fit.equations(chunk)
        plain = [np.ones(space.n_intervals), *points.columns[: 3 * n if late is not None else 2 * n]]
        others = [columns.strong(points), np.repeat(np.array(plain)[:, None], n, axis=1)]
        others += [] if late is None else [late[chunk].T[None]]
        step = float(np.diff(space.breakpoints[:2])[0])
        stride, width = max(1, int(1.0 / (_FINE * _RATE * high * step))), 1.0 / (2.0 * np.pi * high * step)
        every = stride * max(1, int(1.0 / (_RATE * high * step * stride)))
        values = np.nan_to_num(np.concatenate([residual[None], *others]), posinf=0.0, neginf=0.0)
        rows = gaussian_filter1d(values, width)[..., ::every]
        places = [(i, gaussian_filter1d(a, width), s[::every]) for i, a, s in _places(points, problem)]
        motion = np.array(points.columns[: 3 * n]).reshape(3, n, -1)
        motion[2] = gaussian_filter1d(motion[2], width)
        motion = motion.transpose(2, 0, 1)[::stride]
        times = step * np.arange(space.n_intervals)[::every]
        yield _Trial(step, every, stride, width, times, places, motion, rows[0], rows[1:])


def _places(points: Points, problem: Problem) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Coordinate, d²g/dt² and ∂g/∂q of each place to which a part may be attached."""
    n = points.n_dof
    for i, name in enumerate(problem.coordinates):
        q, v, a = points.columns[i], points.columns[n + i], points.columns[2 * n + i]
        yield i, a, np.ones(q.size)
        if name in problem.candidates.turning:
            yield i, np.cos(q) * a - np.sin(q) * v**2, np.cos(q)
            yield i, -np.sin(q) * a - np.cos(q) * v**2, -np.sin(q)


def _errors(trials: list[_Trial], i: int, others: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """(2, n_rows) equation error that everything else leaves, and what parts explain of it."""
    from scipy.signal import bilinear, lfilter  # takes half a second to import

    omega, damping = np.exp(np.minimum(logs, _MOST))
    turn, above = omega * np.sqrt(1.0 - damping**2), [2.0 * damping * omega, omega**2]
    free, forces = list[np.ndarray](), list[np.ndarray]()
    for t in trials:
        ringing = np.array([np.cos(turn * t.times), np.sin(turn * t.times)])
        free.append(np.exp(-damping * omega * t.times) * ringing)
        numbers = bilinear(above, [1.0, *above], 1.0 / t.step)
        forces.append(np.array([-s * lfilter(*numbers, a)[:: t.every] for k, a, s in t.places if k == i]))
    residual, parts = np.concatenate([t.residual[i] for t in trials]), np.concatenate(forces, axis=1)
    columns = np.concatenate([residual[None], parts, block_diag(*free)]).T
    columns = columns - others @ (others.T @ columns)
    basis = _basis(columns[:, 1 + len(parts) :])
    columns = columns[:, : 1 + len(parts)] - basis @ (basis.T @ columns[:, : 1 + len(parts)])
    return np.array([columns[:, 0], columns[:, 1:] @ nnls(columns[:, 1:], columns[:, 0])[0]])


@dataclass(frozen=True, eq=False)
class _Far:
    """Fits of a part of some form on coordinate ``i``: of log ω, log ζ, log b, and the first states."""

    form: _Form
    trials: list[_Trial]
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
        ends = np.log([[2.0 * np.pi * f for f in band], [_LEAST, 2.0 * _RINGS], [1.0 / _FAR, _FAR]])
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
        free = _basis(columns[4:].T)
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


def _simulated(form: _Form, trials: list[_Trial], i: int, logs: np.ndarray, states: np.ndarray) -> np.ndarray:
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


def _basis(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns with the same span."""
    sizes = np.linalg.norm(columns, axis=0)
    return orth(columns / np.where(sizes > 0.0, sizes, 1.0), rcond=_RANK)
