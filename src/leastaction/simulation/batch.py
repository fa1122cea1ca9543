"""Many short motions at once: fit the initial state of each in its window, then simulate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from leastaction.simulation.integrate import rk4
from leastaction.simulation.law import MEMBERS, Drawn, Law, standard_deviation

__all__ = ["Channels", "Observe", "Start", "StartResult", "nearest_states", "run_starts"]

# Bounds the memory of one batch.
_MAX_BATCH = 400
_MAX_HALVINGS = 4
# A motion that leaves the range of its data by this factor has diverged.
_FAR = 1e6
# Larger numbers are cut off before they are squared.
_HUGE = 1e100
# A compiled step is faster than arrays for at most so many motions, and pays from so many steps on.
_FEW, _LONG = 10, 200
# Bounds the memory of the drawn motions.
_MOST_DRAWN = 2**21
# A step that is expected to lower χ² by less ends the fit of a start.
_SETTLED = 1e-3
# Finite differences: step relative to the size of the motion.
_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class Start:
    """One window and the free run after it: index of the trial, start of the window, samples.

    `t` (n_samples,) counts from the start of the window; `q` (n_samples, n_channels) may contain NaN;
    `forces` is a function of the time in the trial, or None.
    """

    trial: int
    begin: float
    t: np.ndarray
    q: np.ndarray
    forces: Callable[[np.ndarray], np.ndarray] | None = None


Observe = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Channels:
    """What is measured of a motion: the coordinates themselves, or functions of them.

    Attributes
    ----------
    sigma, scale : ndarray, shape (n_channels,)
        Noise, and size of the signals.
    extent : ndarray, shape (n_dof,)
        Size of the motion of each coordinate.
    observe : callable, optional
        ``observe(q, qdot, t)`` with q, q̇ of the shape (..., n_dof) and times of the shape (...) ->
        (..., n_channels). By default, the channels are the coordinates.
    """

    sigma: np.ndarray
    scale: np.ndarray
    extent: np.ndarray
    observe: Observe | None = None


@dataclass(frozen=True, eq=False)
class StartResult:
    """Channels `q` at the samples of a start, the `variance` (in σ²) of its state error, and how it ended.

    ``spread``, (n_samples, n_channels), is the standard deviation from all uncertainties of the law; None if
    unknown. ``motion``, (n_samples, n_dof), are the coordinates; None if these are the channels.
    """

    q: np.ndarray
    variance: np.ndarray
    status: str
    reason: str
    spread: np.ndarray | None = None
    motion: np.ndarray | None = None


def run_starts(
    law: Law,
    starts: Sequence[Start],
    state: np.ndarray,
    channels: Channels,
    window: float,
    horizon: float,
) -> list[StartResult]:
    """Fit and run all starts.

    Parameters
    ----------
    law : Law
    starts : sequence of Start
    state : ndarray, shape (n_starts, 2 n_dof)
        First guess of q, q̇ at the start of the windows.
    channels : Channels
    window, horizon : float
        In seconds.
    """
    out: list[StartResult] = []
    for a in range(0, len(starts), _MAX_BATCH):
        chunk = slice(a, a + _MAX_BATCH)
        batch = _Batch(law, starts[chunk], channels, window, horizon)
        # A motion that diverges is a valid result: it must not warn or affect the others.
        with np.errstate(all="ignore"):
            out += batch.run(state[chunk])
    return out


def nearest_states(
    law: Law, starts: Sequence[Start], states: np.ndarray, channels: Channels, window: float
) -> np.ndarray:
    """The fitted states that follow the windows best, (n_starts, 2 n_dof).

    ``states``, (n_guesses, n_starts, 2 n_dof), are several guesses for each start.
    """
    n, out = len(states), np.empty(states.shape[1:])
    together = max(1, _MAX_BATCH // n)
    for first in range(0, len(starts), together):
        chunk = slice(first, first + together)
        own = [start for _ in range(n) for start in starts[chunk]]
        with np.errstate(all="ignore"):
            batch = _Batch(law, own, channels, window, 0.0)
            fitted = batch.begun(states[:, chunk].reshape(len(own), -1))
            cost = batch.linearised(fitted, 1.0)[1].reshape(n, -1)
        best = np.argmin(cost, axis=0)
        out[chunk] = fitted.reshape(n, cost.shape[1], -1)[best, np.arange(cost.shape[1])]
    return out


class _Batch:
    def __init__(self, law: Law, starts, channels: Channels, window: float, horizon: float) -> None:
        self.clock = np.array([start.begin for start in starts]) if law.timed else None
        self.law, self.starts = law, starts
        self.sigma, self.scale = channels.sigma, channels.scale
        self.extent, self.observe = channels.extent, channels.observe
        self.window, self.horizon = window, horizon
        self.n_dof = channels.extent.size
        longest = max(start.t.size for start in starts)
        self.t = np.zeros((len(starts), longest))
        self.q = np.full((len(starts), longest, self.sigma.size), np.nan)
        for s, start in enumerate(starts):
            self.t[s, : start.t.size] = start.t
            self.q[s, : start.t.size] = start.q
        self.driven = any(start.forces is not None for start in starts)
        self._force_tables: dict[tuple[int, float], np.ndarray] = {}
        spacing = np.median(np.concatenate([np.diff(start.t) for start in starts]))
        self.n_steps = int(np.clip(np.ceil(window / (2.0 * spacing)), 16, 2000))

    def run(self, state: np.ndarray) -> list[StartResult]:
        """Fit and run free, with the step halved until another halving would not change the motions."""
        alive = np.asarray(np.isfinite(state).all(axis=1))
        state = np.where(alive[:, None], state, 0.0)
        guess = state
        state = self.begun(guess)
        coarse = self._flow(state[None], 1.0 + self.horizon / self.window)
        resolved = np.zeros(len(self.starts), dtype=bool)
        before = np.zeros(len(self.starts))
        for _ in range(_MAX_HALVINGS):
            self.n_steps *= 2
            far = self._far(coarse[0])
            # A motion may have diverged only because its steps were too long: start again.
            state = np.where(far[:, None], guess, state)
            state = self._grow(state) if far.any() else self._fit(state, 1.0, rounds=2)
            fine = self._flow(state[None], 1.0 + self.horizon / self.window)
            change = np.abs(fine - coarse)[0] / (0.02 * self.sigma + 1e-4 * self.scale)
            change = np.where(np.isfinite(self.q), change, 0.0).max(axis=(1, 2))
            # as the last change is to the one before, the next would be to the last: by RK4, a 16th
            shrinks = np.clip(change / before, 1 / 16, 1.0)
            resolved = change * np.where(before > 0.0, shrinks, 1.0) <= 1.0
            coarse, before = fine, change
            if resolved.all():
                break
        return self._results(state, coarse[0], alive, resolved)

    def begun(self, state: np.ndarray) -> np.ndarray:
        """Fit from first guesses, which tell the size of the rates."""
        speed = np.sqrt((state[:, self.n_dof :] ** 2).mean(axis=0))
        self.unit = np.concatenate([self.extent, np.fmax(speed, self.extent / self.window)])
        return self._grow(state)

    def _grow(self, state: np.ndarray) -> np.ndarray:
        """Fit on growing windows, so that a poor first guess can follow a long motion."""
        for share in (0.25, 0.5, 1.0):
            state = self._fit(state, share)
        return state

    def _results(self, state, q, alive, resolved) -> list[StartResult]:
        share = 1.0 + self.horizon / self.window
        motion = None if self.observe is None else self._flow(state[None], share, observed=False)[0]
        self.n_steps //= 2  # fewer steps suffice for differences of motions
        covariance, jacobian = self._state_error(state)
        motions = self._flow(self._variants(state), share)
        variance = self._variance(motions, covariance)
        spread = self._spread(state, motions[0], covariance, jacobian)
        far = self._far(q)
        out = []
        for s, start in enumerate(self.starts):
            size = start.t.size
            status, reason = "ok", ""
            if not alive[s] or not np.isfinite(self._residual(q[None], self.window)[s, 0]).all():
                status, reason = "failed", "no motion of the model fits the data before the start"
            elif far[s]:
                status, reason = "diverged", "the free run leaves the range of the data or is not finite"
            elif not resolved[s]:
                status, reason = "unresolved", "the integration has not converged at the smallest step"
            values = np.where(np.abs(q[s, :size]) <= _FAR * self._range(), q[s, :size], np.nan)
            wide = None if spread is None else spread[s, :size]
            full = np.isfinite(values).all(axis=1, keepdims=True)
            whole = None if motion is None else np.where(full, motion[s, :size], np.nan)
            out.append(StartResult(values, variance[s, :size], status, reason, wide, whole))
        return out

    def _range(self) -> np.ndarray:
        return np.nanmax(np.abs(self.q), axis=(0, 1)) + self.scale

    def _far(self, q: np.ndarray) -> np.ndarray:
        """Whether a motion (n_starts, n_samples, n_dof) diverges within its samples."""
        valid = np.arange(self.t.shape[1]) < np.array([start.t.size for start in self.starts])[:, None]
        return np.asarray((valid[..., None] & ~(np.abs(q) <= _FAR * self._range())).any(axis=(1, 2)))

    def _flow(
        self, state: np.ndarray, share: float, drawn: Drawn | None = None, *, observed: bool = True
    ) -> np.ndarray:
        """Channels (n_variants, n_starts, n_samples, n_channels) from (n_variants, n_starts, 2 n_dof).

        They are integrated over `share` of the window by RK4 with common steps. Cubic Hermite interpolation
        gives the values between them.  Each variant obeys the law, or one of the `drawn` laws.  The channels
        are the coordinates if these are not `observed`.
        """
        n, h = self.n_dof, self.window / self.n_steps
        n_steps = int(np.ceil(self.n_steps * share - 1e-9))
        nodes = h * np.arange(n_steps + 1)
        forces = (lambda times: self._forces(times)[:, None]) if self.driven else None
        begin = state[..., :n], state[..., n:]
        run, step = self.law.acceleration, None
        if drawn is None and state[..., 0].size <= _FEW and n_steps >= _LONG:
            step = self.law.step
        if drawn is not None:
            run, known = drawn.acceleration, forces
            forces = lambda times: drawn.errors[: times.size] + (known(times) if known else 0.0)  # noqa: E731
        q, v = rk4(run, *begin, nodes, 1, forces, self.clock, step)
        k = np.clip((self.t / h).astype(int), 0, n_steps - 1)
        u = np.clip(self.t / h - k, 0.0, 1.0)[..., None, None]
        start = np.arange(len(self.starts))[:, None]
        # Advanced indices come first: (n_starts, n_samples, n_variants, n_dof).
        q0, q1, v0, v1 = (x[j, :, start] for x in (q, v) for j in (k, k + 1))
        d = q1 - q0
        values = q0 + u * (h * v0 + u * (3 * d - h * (2 * v0 + v1) + u * (h * (v0 + v1) - 2 * d)))
        values = np.moveaxis(values, 2, 0)
        if self.observe is None or not observed:
            return values
        rates = v0 + u * (6.0 * d / h - 4.0 * v0 - 2.0 * v1 + u * (3.0 * (v0 + v1) - 6.0 * d / h))
        times = self.t + np.array([start.begin for start in self.starts])[:, None]
        return self.observe(values, np.moveaxis(rates, 2, 0), np.broadcast_to(times, values.shape[:-1]))

    def _forces(self, times: np.ndarray) -> np.ndarray:
        """Forces (n_times, n_starts, n_dof), cached because the same times recur."""
        key = (times.size, float(times[-1]))
        if key not in self._force_tables:
            zero = np.zeros((times.size, self.n_dof))
            tables = [
                zero if s.forces is None else s.forces(np.minimum(s.begin + times, s.begin + s.t[-1]))
                for s in self.starts
            ]
            self._force_tables[key] = np.stack(tables, axis=1)
        return self._force_tables[key]

    def _residual(self, q: np.ndarray, upto: float) -> np.ndarray:
        """(n_starts, n_variants, n_samples · n_dof) residuals in σ, zero where there is no sample."""
        inside = np.isfinite(self.q) & (self.t <= upto * (1 + 1e-9))[..., None]
        r = np.where(inside, (q - np.where(inside, self.q, 0.0)) / self.sigma, 0.0)
        return np.moveaxis(r.reshape(*r.shape[:2], -1), 0, 1)

    def _variants(self, state: np.ndarray) -> np.ndarray:
        """The states, followed by the states with one component shifted."""
        return np.concatenate([state[None], state[None] + _STEP * np.diag(self.unit)[:, None, :]])

    def linearised(self, state: np.ndarray, share: float):
        """Residual (n_starts, m), cost (n_starts,), and Jacobian (n_starts, m, 2 n_dof) in `unit`."""
        r = self._residual(self._flow(self._variants(state), share), self.window * share)
        jacobian = np.moveaxis((r[:, 1:] - r[:, :1]) / _STEP, 1, 2)
        cost = (r[:, 0] ** 2).sum(axis=1)
        bad = ~((cost < _HUGE) & (np.abs(jacobian) < _HUGE).all(axis=(1, 2)))
        return (
            np.where(bad[:, None], 0.0, r[:, 0]),
            np.where(bad, np.inf, cost),
            np.where(bad[:, None, None], 0.0, jacobian),
        )

    def _fit(self, state: np.ndarray, share: float, rounds: int = 8) -> np.ndarray:
        """Levenberg–Marquardt for all starts side by side; one batch of motions per round."""
        damping = np.full(len(state), 1e-3)
        residual, cost, jacobian = self.linearised(state, share)
        for _ in range(rounds):
            normal = np.swapaxes(jacobian, 1, 2) @ jacobian
            gradient = np.einsum("smi,sm->si", jacobian, residual)
            diagonal = np.einsum("sii->si", normal)
            ridge = damping[:, None] * diagonal + 1e-12 * diagonal.max(axis=1, keepdims=True) + 1e-300
            damped = normal + ridge[:, :, None] * np.eye(self.unit.size)
            move = -np.linalg.solve(damped, gradient[..., None])[..., 0]
            settled = (damping < 1.0) & (-np.sum(gradient * move, axis=1) < _SETTLED)
            if (settled | (damping > 1e6) | ~np.isfinite(cost)).all():
                break
            trial = state + move * self.unit
            new = self.linearised(trial, share)
            better = new[1] < cost
            state = np.where(better[:, None], trial, state)
            residual = np.where(better[:, None], new[0], residual)
            jacobian = np.where(better[:, None, None], new[2], jacobian)
            cost = np.where(better, new[1], cost)
            damping = np.where(better, damping * 0.1, damping * 10.0)
        return state

    def _state_error(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Covariance (n_starts, 2 n_dof, 2 n_dof), in `unit`, of the fitted states, and the Jacobian."""
        *_, jacobian = self.linearised(state, 1.0)
        normal = np.swapaxes(jacobian, 1, 2) @ jacobian
        diagonal = np.einsum("sii->si", normal)
        ridge = 1e-10 * diagonal.max(axis=1, keepdims=True) + 1e-300
        return np.linalg.inv(normal + ridge[:, :, None] * np.eye(self.unit.size)), jacobian

    def _variance(self, motions: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Variance (n_starts, n_samples, n_dof) in σ² from the error of the fitted state."""
        # (n_starts, n_samples, n_dof, 2 n_dof)
        slope = np.moveaxis((motions[1:] - motions[:1]) / (_STEP * self.sigma), 0, -1)
        return np.einsum("spij,sjk,spik->spi", slope, covariance, slope)

    def _spread(
        self, state: np.ndarray, q: np.ndarray, covariance: np.ndarray, jacobian: np.ndarray
    ) -> np.ndarray | None:
        """Standard deviation (n_starts, n_samples, n_dof) of the motion from all uncertainties of the law.

        Motions are drawn: coefficients by their covariance, errors of the equations, noise of the samples in
        the window.  The state of each is fitted as for the forecast, to first order, and simulated with the
        full equations, which bound large deviations. ``q`` is the motion without any.
        """
        openness = self.law.openness
        if openness is None:
            return None
        share, rng = 1.0 + self.horizon / self.window, np.random.default_rng(0)
        gain = covariance @ np.swapaxes(jacobian, 1, 2)
        seen = np.isfinite(self.q) & (self.t <= self.window * (1 + 1e-9))[..., None]
        squares, lost = np.zeros_like(self.q), np.zeros(self.q.shape)
        n_steps = int(np.ceil(self.n_steps * share - 1e-9))
        steps = np.full(n_steps, self.window / self.n_steps)
        at_once = max(1, _MOST_DRAWN // (n_steps * q[:, 0].size))
        for first in range(0, MEMBERS, at_once):
            drawn = openness.draw(min(at_once, MEMBERS - first), steps, len(self.starts), rng)
            begun = np.broadcast_to(state, (drawn.size, *state.shape))
            noise = rng.standard_normal((drawn.size, *q.shape))
            off = (self._flow(begun, 1.0, drawn) - q) / self.sigma + noise
            off = np.where(seen, np.nan_to_num(off), 0.0).reshape(drawn.size, len(state), -1)
            shifts = np.einsum("sjm,ksm->ksj", gain, off) * self.unit
            away = self._flow(begun - shifts, share, drawn) - q
            near = np.isfinite(away)
            squares += (np.where(near, away, 0.0) ** 2).sum(axis=0)
            lost += (~near).sum(axis=0)
        return standard_deviation(squares, lost, MEMBERS)
