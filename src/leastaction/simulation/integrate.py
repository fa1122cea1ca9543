"""Forward integration of q̈ = a(q, q̇, f): fixed-step RK4 for many motions at once, DOP853 for one.

Both take the same ``acceleration(q, qdot, forces)``; ``forces`` is ``None`` if no force acts. If the law
depends on time, the time is the last argument.
`simulate` raises no exception for a numerical failure: it returns the motion so far, a status and a reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DOP853
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from leastaction.errors import InputError
from leastaction.simulation.results import SimulationResult

Acceleration = Callable[..., np.ndarray]
Event = Callable[[float, np.ndarray, np.ndarray], float]

# A state beyond this is taken as diverging; still far from overflow, so that products stay finite.
_BLOW_UP = 1e12
# A mass matrix whose reciprocal condition number is below this is taken as singular.
_SINGULAR = 1e-12


def check_times(t: ArrayLike) -> np.ndarray:
    times = np.array(t, dtype=float)
    if times.ndim != 1 or times.size == 0:
        raise InputError(f"t has shape {times.shape}; expected (n_times,) with at least one time")
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise InputError("t must be finite and strictly increasing; sort it and drop repeated times")
    return times


def rk4(
    acceleration: Acceleration,
    q0: ArrayLike,
    qdot0: ArrayLike,
    t: ArrayLike,
    substeps: int = 4,
    forces: Callable[[np.ndarray], np.ndarray] | None = None,
    clock: np.ndarray | None = None,
    step: Callable[..., list[float]] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate many motions at once by the classical fixed-step Runge–Kutta method of degree 4.

    Parameters
    ----------
    acceleration : callable
        ``acceleration(q, qdot, forces)`` -> array of the shape of ``q``, vectorised.
    q0, qdot0 : array_like, shape (..., n_dof)
        Start at ``t[0]``.
    t : array_like, shape (n_times,)
        Sample times, seconds, strictly increasing; strictly decreasing to integrate backward.
    substeps : int
        Equal steps in each interval of ``t``; the error falls with its fourth power.
    forces : callable, optional
        ``forces(times)`` with ``times`` of shape (m,) -> (m, ..., n_dof), broadcastable to ``q0``.
    clock : ndarray, optional
        Offset of the time of each motion from ``t``, broadcastable to (...); the acceleration then takes the
        time as its last argument.
    step : callable, optional
        The `leastaction.simulation.law.compiled_step` of the same law, used in place of ``acceleration``: one
        motion after another, which is faster for up to some ten.

    Returns
    -------
    q, qdot : ndarray, shape (n_times, ..., n_dof)
        NaN or inf after a motion diverges; no exception is raised. In single precision if the start is.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 11)
    >>> q, qdot = rk4(lambda q, qdot, forces: -q, [1.0], [0.0], t)
    >>> bool(abs(q[-1, 0] - np.cos(1.0)) < 1e-8)
    True
    """
    t = np.asarray(t, dtype=float)
    backward = t.ndim == 1 and t.size > 1 and t[-1] < t[0]
    t = -check_times(-t) if backward else check_times(t)
    if int(substeps) != substeps or substeps < 1:
        raise InputError(f"substeps={substeps!r}; expected a whole number of at least 1")
    q, v = np.broadcast_arrays(np.asarray(q0), np.asarray(qdot0))
    dtype = np.float32 if q.dtype == v.dtype == np.float32 else np.float64
    q, v = q.astype(dtype), v.astype(dtype)
    n_steps = (t.size - 1) * substeps
    edges = np.interp(np.arange(2 * n_steps + 1) / (2 * substeps), np.arange(t.size), t)
    # All forces in advance: one vectorised call costs less than four small ones in every step.
    table = None if forces is None else np.asarray(forces(edges), dtype)
    if step is not None:
        return _one_by_one(step, q, v, substeps, edges, table, clock)
    out_q, out_v = np.empty((2, t.size, *q.shape), dtype)
    out_q[0], out_v[0] = q, v
    with np.errstate(all="ignore"):
        for k in range(n_steps):
            stages = slice(2 * k, 2 * k + 3)
            times = edges[stages]
            pushes = [(None,)] * 3 if table is None else [(f,) for f in table[stages]]
            if clock is not None:
                pushes = [(*push, clock + time) for push, time in zip(pushes, times, strict=True)]
            q, v = _rk4_step(acceleration, q, v, float(times[2] - times[0]), *pushes)
            if (k + 1) % substeps == 0:
                out_q[(k + 1) // substeps], out_v[(k + 1) // substeps] = q, v
    return out_q, out_v


def _one_by_one(
    step: Callable[..., list[float]],
    q: np.ndarray,
    v: np.ndarray,
    substeps: int,
    edges: np.ndarray,
    table: np.ndarray | None,
    clock: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """The result of `rk4`, computed with numbers."""
    n, lengths = q.shape[-1], (edges[2::2] - edges[:-2:2]).tolist()
    given = [_for_each(np.zeros((edges.size, 1)) if table is None else table, q.shape)]
    if clock is not None:
        times = edges.reshape(-1, *([1] * clock.ndim)) + clock
        given.append(_for_each(times[..., None], (*q.shape[:-1], 1)))
    out = np.full((len(lengths) // substeps + 1, *q.shape[:-1], 2 * n), np.nan)
    out[0] = np.concatenate([q, v], axis=-1)
    for place in np.ndindex(q.shape[:-1]):
        own = (slice(None), *place)
        stages = [x[own][k : edges.size - 2 + k : 2] for x in given for k in range(3)]
        state: list[float] = out[(0, *place)].tolist()
        for k, pushes in enumerate(np.hstack(stages).tolist()):
            try:
                state = step(lengths[k], *state, *pushes)
                if (k + 1) % substeps == 0:
                    out[((k + 1) // substeps, *place)] = state
            except (ArithmeticError, ValueError):  # beyond the range of numbers, or of a function
                break
    return out[..., :n], out[..., n:]


def _for_each(rows: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Rows that can be broadcast to a shape, so broadcast."""
    missing = [1] * (len(shape) + 1 - rows.ndim)
    return np.broadcast_to(rows.reshape(len(rows), *missing, *rows.shape[1:]), (len(rows), *shape))


def _rk4_step(acceleration, q, v, h, at0, at1, at2):
    """One step; forces and time are those at its start, middle and end."""
    half = 0.5 * h
    a0 = acceleration(q, v, *at0)
    v1 = v + half * a0
    a1 = acceleration(q + half * v, v1, *at1)
    v2 = v + half * a1
    a2 = acceleration(q + half * v1, v2, *at1)
    v3 = v + h * a2
    a3 = acceleration(q + h * v2, v3, *at2)
    # The stage velocities in terms of the accelerations: fewer operations than the textbook form.
    return q + h * v + (h * h / 6.0) * (a0 + a1 + a2), v + (h / 6.0) * (a0 + 2.0 * (a1 + a2) + a3)


@dataclass(frozen=True)
class Limits:
    """Where and how precisely a motion is integrated.

    Attributes
    ----------
    events : callable, sequence of callables, or mapping from name to callable
        ``event(time, q, qdot)`` -> float; the motion stops where one crosses zero.
    max_steps : int
        Limit on the steps of the integrator and, times 16, on the calls of the acceleration (a step takes
        12, and 3 more where samples fall into it); it does not depend on the clock.
    rtol, atol : float
        Tolerances of the local error.

    Raises
    ------
    InputError
        If `max_steps` is below 1.
    """

    events: Event | Sequence[Event] | Mapping[str, Event] = ()
    max_steps: int = 100_000
    rtol: float = 1e-9
    atol: float = 1e-9

    def __post_init__(self) -> None:
        if self.max_steps < 1:
            raise InputError(f"max_steps={self.max_steps!r}; expected at least 1")


def simulate(
    acceleration: Acceleration,
    q0: ArrayLike,
    qdot0: ArrayLike,
    t: ArrayLike,
    forces: ArrayLike | Callable[[float], Any] | None = None,
    *,
    mass_matrix: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    timed: bool = False,
    **limits: Any,
) -> SimulationResult:
    """Integrate one motion by the adaptive Dormand–Prince method of degree 8 (DOP853).

    Parameters
    ----------
    acceleration : callable
        ``acceleration(q, qdot, forces)`` -> (n_dof,); ``forces`` is None if nothing is driven.
    q0, qdot0 : array_like, shape (n_dof,)
        Start at ``t[0]``.
    t : array_like, shape (n_times,)
        Requested times in seconds, strictly increasing.
    forces : None, array_like of shape (n_times, n_dof), or callable
        Generalised forces: samples at `t`, joined by a cubic spline, or ``forces(time)`` -> (n_dof,).
    mass_matrix : callable, optional
        ``mass_matrix(q, qdot)`` -> (n_dof, n_dof). The motion stops if it becomes singular.
    timed : bool
        Whether ``acceleration`` and ``mass_matrix`` take the time as their last argument.
    **limits
        ``events``, ``max_steps``, ``rtol`` and ``atol``: the fields of `Limits`.

    Returns
    -------
    SimulationResult
        Cut short, with ``status="stopped"`` and the reason, if the motion cannot be followed to the end.

    Raises
    ------
    InputError
        Only for wrong shapes or times.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 2.0, 21)
    >>> result = simulate(lambda q, qdot, forces: -q, [1.0], [0.0], t)
    >>> result.status, result.q.shape
    ('complete', (21, 1))
    >>> events = {"q = 0": lambda t, q, qdot: q[0]}
    >>> simulate(lambda q, qdot, forces: -q, [1.0], [0.0], t, events=events).reason
    'event q = 0 at t = 1.5708'
    """
    t = check_times(t)
    q0, qdot0 = np.array(q0, dtype=float), np.array(qdot0, dtype=float)
    if q0.ndim != 1 or q0.shape != qdot0.shape or not (np.isfinite(q0).all() and np.isfinite(qdot0).all()):
        raise InputError(
            f"q0={q0.tolist()}, qdot0={qdot0.tolist()}; expected lists of finite numbers, one per coordinate"
        )
    within = Limits(**limits)
    force = force_function(forces, t, q0.size)
    watch = _Watch(mass_matrix, _named_events(within.events), q0.size, timed)

    def accelerate(time: float, q: np.ndarray, qdot: np.ndarray) -> np.ndarray:
        return acceleration(q, qdot, force(time), *((time,) if timed else ()))

    with np.errstate(all="ignore"):
        return _integrate(accelerate, np.concatenate([q0, qdot0]), t, watch, within)


def force_function(forces: Any, t: np.ndarray, n_dof: int) -> Callable[[float], np.ndarray | None]:
    """Forces (n_dof,) at a time, from samples or a function; None without forces."""
    if forces is None:
        return lambda time: None
    if callable(forces):
        return lambda time: np.asarray(forces(time), dtype=float)
    values = np.asarray(forces, dtype=float)
    if values.shape != (t.size, n_dof) or not np.isfinite(values).all():
        raise InputError(
            f"forces has shape {values.shape}; expected finite numbers of shape {(t.size, n_dof)}, as t and q"
        )
    return CubicSpline(t, values) if t.size > 1 else (lambda time: values[0])


def _named_events(events: Event | Sequence[Event] | Mapping[str, Event]) -> list[tuple[str, Event]]:
    if isinstance(events, Mapping):
        return list(events.items())
    listed = list(events) if isinstance(events, Sequence) else [events]
    return [(str(getattr(event, "__name__", i)), event) for i, event in enumerate(listed)]


class _Watch:
    """Checks each accepted step for events and a singular mass matrix."""

    def __init__(self, mass_matrix, events, n_dof: int, timed: bool) -> None:
        self.mass_matrix, self.events, self.n_dof, self.timed = mass_matrix, events, n_dof, timed
        self.sign: float | None = None
        self.values: list[float] = []

    def start(self, time: float, y: np.ndarray) -> str:
        self.values = [float(event(time, y[: self.n_dof], y[self.n_dof :])) for _, event in self.events]
        return self.mass(time, y)

    def mass(self, time: float, y: np.ndarray) -> str:
        if self.mass_matrix is None:
            return ""
        clock = (time,) if self.timed else ()
        matrix = np.asarray(self.mass_matrix(y[: self.n_dof], y[self.n_dof :], *clock), dtype=float)
        if not np.isfinite(matrix).all():
            return f"singular mass matrix (not finite) at t = {time:.6g}"
        size = np.linalg.svd(matrix, compute_uv=False)
        sign = float(np.linalg.slogdet(matrix)[0])
        # A change of sign means that a step passed over a singular state.
        singular = size[-1] <= _SINGULAR * size[0] or (self.sign is not None and sign != self.sign)
        self.sign = sign
        return f"singular mass matrix at t = {time:.6g}" if singular else ""

    def crossing(self, solver: DOP853) -> tuple[float, str]:
        """Return the earliest zero of an event in the last step, and its reason ("" if there is none)."""
        dense, best = None, (solver.t, "")
        for k, (name, event) in enumerate(self.events):
            new = float(event(solver.t, solver.y[: self.n_dof], solver.y[self.n_dof :]))
            old, self.values[k] = self.values[k], new
            if not (old * new < 0 or (new == 0 and old != 0)):
                continue
            dense = dense or solver.dense_output()
            time = solver.t if new == 0 else self._root(event, dense, solver.t_old, solver.t, old)
            if not best[1] or time < best[0]:
                best = (time, f"event {name} at t = {time:.6g}")
        return best

    def _root(self, event, dense, low: float, high: float, old: float) -> float:
        def value(time):
            # Both ends use the values of the steps, which the dense output matches only to rounding.
            if time in (low, high):
                return old if time == low else -old
            y = dense(time)
            return float(event(time, y[: self.n_dof], y[self.n_dof :]))

        return float(brentq(value, low, high, xtol=1e-12, rtol=1e-12))


class _Stop(Exception):
    """Raised in the right-hand side to stop the integrator."""


def _integrate(accelerate, y0, t, watch, limits: Limits) -> SimulationResult:
    n_dof, calls, max_steps = y0.size // 2, 0, limits.max_steps

    def rates(time, y):
        nonlocal calls
        calls += 1
        if calls > 16 * max_steps:
            raise _Stop(f"step limit: {calls - 1} evaluations")
        try:
            a = accelerate(time, y[:n_dof], y[n_dof:])
        except np.linalg.LinAlgError:
            raise _Stop(f"singular mass matrix at t = {time:.6g}") from None
        return np.concatenate([y[n_dof:], np.reshape(a, n_dof)])

    kept, reached = [y0[None]], t[0]
    reason = watch.start(t[0], y0)
    try:
        solver = (
            None
            if reason or t.size == 1
            else DOP853(rates, t[0], y0, t[-1], rtol=limits.rtol, atol=limits.atol)
        )
        if solver is not None and not np.isfinite(solver.f).all():
            reason, solver = f"blow-up: the acceleration is not finite at t = {t[0]:.6g}", None
        steps = 0
        while solver is not None and not reason and solver.status == "running":
            if steps == max_steps:
                reason = f"step limit: {max_steps} steps at t = {solver.t:.6g}"
                break
            steps += 1
            message = solver.step()
            if solver.status == "failed":
                reason = f"blow-up at t = {solver.t:.6g}: {message}"
                break
            upto, reason = watch.crossing(solver)
            if not np.isfinite(solver.y).all() or np.abs(solver.y).max() > _BLOW_UP:
                upto, reason = solver.t_old, f"blow-up at t = {solver.t:.6g}: the state exceeds {_BLOW_UP:g}"
            elif not reason:
                reason = watch.mass(solver.t, solver.y)
                upto = solver.t_old if reason else solver.t
            new = t[(t > solver.t_old) & (t <= upto)]
            if new.size:
                kept.append(solver.dense_output()(new).T)
            reached = upto
    except _Stop as stop:
        reason = str(stop)
    y = np.concatenate(kept)
    status = "stopped" if reason else "complete"
    return SimulationResult(t[: len(y)], y[:, :n_dof], y[:, n_dof:], status, reason, calls, float(reached))
