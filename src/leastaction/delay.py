r"""Delay between the channels of the coordinates and those of the forces.

Sensors filter, drives buffer, and clocks differ. A force recorded at time t often acts at t + τ of the clock
of the coordinates. With a wrong τ the equations do not hold, and the likelihood of the data decreases. The
estimate is

    τ̂ = argmax_τ max_{q, λ, σ, w} p(y | q, σ) p(q | λ, w, f(t − τ)),

where terms and knots are fixed while τ varies, and are determined again at the best τ until nothing changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from leastaction.api import discover
from leastaction.curve.knots import excerpt
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import DataError, InputError
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Structure
from leastaction.estimation.weights import Start
from leastaction.library import Library
from leastaction.model.model import LagrangianModel
from leastaction.selection.significance import chi_square_cutoff
from leastaction.threads import single_threaded

__all__ = ["DelayEstimate", "estimate", "shift_forces"]

_MOST_SAMPLES = 50_000
_SHARE = 0.25  # of a trial that may be lost to the widest delay at both ends
_STEPS_PER_PERIOD = 12  # of the forces
_FEWEST, _MOST = 9, 61  # delays on the first grid
_ROUNDS = 3
_HELD = 3
_SETTLED = 2.0
_MOST_SECTIONS = 30
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True, eq=False)
class DelayEstimate:
    """An estimate of the delay of the forces.

    Attributes
    ----------
    delay : float
        Seconds by which the forces act later than recorded. The most likely value, even if it is not
        determined.
    standard_error : float
        From the curvature of the likelihood; infinite if the delay is not determined.
    determined : bool
        Whether the data determine the delay.
    reason : str
        If not, the reason, and what would help.
    delays, log_likelihood : (n_tried,) arrays
        Delays tried, in seconds, and their log likelihood relative to the best.
    trajectories : Trajectories
        The data with the forces shifted by `delay`, without the ends at which no force is known. The original
        data if the delay is not determined.
    model : LagrangianModel
        Model found with the forces shifted by `delay`.
    """

    delay: float
    standard_error: float
    determined: bool
    reason: str
    delays: np.ndarray
    log_likelihood: np.ndarray
    trajectories: Trajectories
    model: LagrangianModel

    def __repr__(self) -> str:
        if not self.determined:
            return f"<DelayEstimate: not determined, {self.reason}>"
        return f"<DelayEstimate: {1e3 * self.delay:.3g} ± {1e3 * self.standard_error:.2g} ms>"


def shift_forces(
    trajectories: Trajectory | Trajectories | Iterable[Trajectory], delay: float, margin: float | None = None
) -> Trajectories:
    """Shift the forces in time, f(t − delay), by cubic splines through their samples.

    Parameters
    ----------
    trajectories : Trajectory, Trajectories or iterable of Trajectory
    delay : float
        In seconds; negative: earlier.
    margin : float, optional
        Time to cut off at both ends, in seconds. By default, the samples at which no force is known.

    Returns
    -------
    Trajectories
        With the same names.

    Raises
    ------
    InputError
        If a delay is not finite, or longer than a trial.

    Examples
    --------
    >>> run = Trajectory([0.0, 1.0, 2.0, 3.0], [0.0] * 4, [[0.0], [1.0], [2.0], [3.0]])
    >>> shift_forces(run, 0.5)[0].forces[:, 0].round(9).tolist()
    [0.5, 1.5, 2.5]
    """
    data = Trajectories.coerce(trajectories)
    if not np.isfinite(delay):
        raise InputError(f"the delay is {delay!r}; expected a finite number of seconds")
    out = []
    for name, item in zip(data.names, data, strict=True):
        first = item.t[0] + (max(delay, 0.0) if margin is None else margin)
        last = item.t[-1] + (min(delay, 0.0) if margin is None else -margin)
        kept = (item.t >= first) & (item.t <= last)
        if kept.sum() < 2:
            raise InputError(
                f"a delay of {delay:g} s leaves nothing of trial {name!r}, which has {item.duration:g} s"
            )
        forces = None if item.forces is None else CubicSpline(item.t, item.forces)(item.t[kept] - delay)
        out.append(item.rows(kept).changed(forces=forces, name=name))
    return Trajectories(out)


@single_threaded()
def estimate(
    trajectories: Trajectory | Trajectories | Iterable[Trajectory],
    library: Library | Iterable[str],
    known: Mapping[str, float] | None = None,
    dissipation: Iterable[str] = (),
    *,
    max_delay: float = 0.1,
    angles: Iterable[str] | None = None,
    prescribed: Iterable[str] = (),
    progress: Callable[[str, dict], None] | None = None,
) -> DelayEstimate:
    """Estimate by how much the forces act later than recorded.

    Parameters
    ----------
    trajectories, library, known, dissipation, angles, prescribed, progress
        As for `leastaction.discover`; the trajectories must have forces.
    max_delay : float
        Delays from −max_delay to max_delay are tried, in seconds. This time is cut off at both ends of every
        trial while delays are compared.

    Returns
    -------
    DelayEstimate
        Check ``determined`` before using it.

    Raises
    ------
    InputError
        If `max_delay` is not positive, or the arguments are not as for `discover`.
    DataError
        If no force acts, or the trials are too short for `max_delay`.

    Notes
    -----
    There is one delay for all forces and trials. Not guaranteed: that an apparent delay is a delay. A filter
    of the force or an elastic drive also lags, and a shift may compensate for a missing term. ``model.fit``
    tells whether the equations hold with the delay. The standard error assumes the terms of ``model``.

    Examples
    --------
    >>> from leastaction import systems
    >>> data = systems.generate("single_pendulum", noise=0.01, trials=2, duration=8.0, seed=0)
    >>> late = shift_forces(data, -0.02)  # recorded 20 ms before they act
    >>> found = estimate(late, ["theta_dot**2", "cos(theta)", "sin(theta)"], max_delay=0.05)
    >>> found.determined, bool(abs(found.delay - 0.02) < 5 * found.standard_error)
    (True, True)
    """
    data = Trajectories.coerce(trajectories)
    if isinstance(max_delay, bool) or not np.isfinite(max_delay) or max_delay <= 0:
        raise InputError(f"max_delay is {max_delay!r}; expected a positive number of seconds, e.g. 0.1")
    if not data.driven:
        raise DataError("no force acts: a delay of the forces has no meaning; read them with forces=...")
    shortest = min(item.duration for item in data)
    if 2.0 * max_delay > _SHARE * shortest:
        raise DataError(
            f"the shortest trial has {shortest:g} s; with max_delay={max_delay:g} too little of it is left: "
            f"at most {0.5 * _SHARE * shortest:.2g} s can be tried, or record longer"
        )
    pieces = excerpt(data, _MOST_SAMPLES)
    candidates = library if isinstance(library, Library) else Library(library, data.coordinates)
    dissipation = [dissipation] if isinstance(dissipation, str) else list(dissipation)
    prescribed = [prescribed] if isinstance(prescribed, str) else list(prescribed)

    def find(delay: float) -> LagrangianModel:
        return discover(
            shift_forces(pieces, delay, max_delay),
            candidates,
            known,
            dissipation,
            angles=angles,
            prescribed=prescribed,
            progress=progress,
        )

    delay = 0.0
    model = find(delay)
    for _ in range(_ROUNDS):
        profile = _Profile(pieces, model, delay, max_delay)
        delay = profile.maximise()
        again = find(delay)
        same = _terms(again) == _terms(model)
        model = again
        if same:
            break
    reason = profile.doubt()
    shifted = data if reason else shift_forces(data, delay)
    error = np.inf if reason else profile.standard_error()
    tried, values = profile.table()
    below = values - values.max() if np.isfinite(values).any() else values
    return DelayEstimate(delay, error, not reason, reason, tried, below, shifted, model)


def _terms(model: LagrangianModel) -> set[str]:
    return {term.expression for term in (*model.terms, *model.dissipation)}


class _Profile:
    """Log likelihood of a delay, with the terms and knots of a model."""

    def __init__(self, pieces: Trajectories, model: LagrangianModel, delay: float, max_delay: float) -> None:
        self.max_delay = max_delay
        inner = shift_forces(pieces, 0.0, max_delay)
        fixed = {
            term.expression: term.coefficient for term in (*model.terms, *model.dissipation) if term.known
        }
        library = Library([term.expression for term in model.terms], model.coordinates)
        options = model.provenance["options"]
        request = Request(
            library,
            fixed,
            [t.expression for t in model.dissipation],
            options["angles"],
            options["degree"],
            prescribed=model.prescribed,
        )
        setup = build_problem(inner, request)
        self.grid = Grid.lay(setup.problem, float(model.provenance["knots_per_second"]))
        self.structure = Structure(setup.problem.free)
        curve = self.grid.smooth(setup.scales.smooth.penalty)
        values = {t.expression: t.coefficient for t in (*model.terms, *model.dissipation)}
        coefficients = np.array([values.get(term.text, 0.0) for term in setup.problem.terms])
        self._curves = [None if item.forces is None else CubicSpline(item.t, item.forces) for item in pieces]
        self._fits: dict[float, tuple[float, Start]] = {}
        self._found_at = delay
        grid = self._delayed(delay)
        self._start = grid.start(self.structure, curve.control_points, coefficients, curve.noise_std)
        # As in a discovery: with free coefficients a rough curve would lose the scale of L.
        for _ in range(_HELD):
            self._start, evidence = grid.fit_curve(self.structure, self._start)
            if not np.isfinite(evidence):
                break
        self.step = 2.0 * max_delay / (self._n_steps(pieces) - 1)

    def _n_steps(self, pieces: Trajectories) -> int:
        """Delays that resolve how fast the forces change; the same on both sides of zero."""
        size = rate = 0.0
        for item in pieces:
            if item.forces is not None:
                slopes = np.diff(item.forces, axis=0) / np.diff(item.t)[:, None]
                size += float(np.mean((item.forces - item.forces.mean(axis=0)) ** 2))
                rate += float(np.mean(slopes**2))
        period = 2.0 * np.pi * np.sqrt(size / rate) if rate > 0 else np.inf
        wanted = 2.0 * self.max_delay / (period / _STEPS_PER_PERIOD) + 1
        return int(np.clip(wanted, _FEWEST, _MOST)) // 2 * 2 + 1

    def _delayed(self, delay: float) -> Grid:
        """The grid with forces that act later."""
        pairs = zip(self._curves, self.grid.times, strict=True)
        return self.grid.pushed([None if curve is None else curve(t - delay) for curve, t in pairs])

    def value(self, delay: float) -> float:
        """Log likelihood, up to a constant."""
        if delay not in self._fits:
            nearest = min(self._fits, key=lambda other: abs(other - delay), default=None)
            start = self._start if nearest is None else self._fits[nearest][1]
            found = self._delayed(delay).fit(self.structure, start)
            good = found.converged and np.isfinite(found.evidence)
            after = found.start if good else start
            self._fits[delay] = (found.evidence if good else -np.inf, after)
        return self._fits[delay][0]

    def maximise(self) -> float:
        """Try a grid, from where the model was found outwards, as every fit begins near one; narrow it."""
        count = round(self.max_delay / self.step)
        grid = self.step * np.arange(-count, count + 1)
        for delay in sorted(grid.tolist(), key=lambda tau: abs(tau - self._found_at)):
            self.value(delay)
        tried, values = self.table()
        best = float(tried[np.argmax(values)])
        low, high = max(best - self.step, -self.max_delay), min(best + self.step, self.max_delay)
        for _ in range(_MOST_SECTIONS):
            inside = [high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)]
            left, right = (self.value(delay) for delay in inside)
            low, high = (low, inside[1]) if left > right else (inside[0], high)
            ends = [self.value(end) for end in (low, high)]
            if max(left, right) - min(ends) < _SETTLED:
                break
        return self._top()[0]

    def _top(self) -> tuple[float, float]:
        """Vertex and curvature of the parabola through what was tried near the best."""
        tried, values = self.table()
        best = float(tried[np.argmax(values)])
        near = np.argsort(-values)[: max(5, int(np.sum(values > values.max() - 8.0 * _SETTLED)))]
        near = near[np.isfinite(values[near]) & (np.abs(tried[near] - best) <= self.step)]
        if near.size < 3:
            return best, 0.0
        scale = float(np.abs(tried[near] - best).max()) or 1.0
        # Far from the top the likelihood is no parabola: those values count less.
        weight = 1.0 / (1.0 + values.max() - values[near])
        a, b, _ = np.polyfit((tried[near] - best) / scale, values[near], 2, w=weight)
        if a >= 0:
            return best, 0.0
        vertex = np.clip(best - scale * b / (2 * a), tried[near].min(), tried[near].max())
        return float(vertex), float(-2.0 * a / scale**2)

    def standard_error(self) -> float:
        """In seconds."""
        curvature = self._top()[1]
        return float(1.0 / np.sqrt(curvature)) if curvature > 0 else np.inf

    def table(self) -> tuple[np.ndarray, np.ndarray]:
        """Delays in rising sequence, and their log likelihood."""
        tried = np.array(sorted(self._fits))
        return tried, np.array([self._fits[delay][0] for delay in tried])

    def doubt(self) -> str:
        """Why the delay is not determined; empty if it is."""
        tried, values = self.table()
        if not np.isfinite(values).any():
            return "no delay lets the equations be solved: check the library and the signs of the forces"
        best = float(tried[np.argmax(values)])
        chance = 0.5 * chi_square_cutoff()  # of log likelihood
        if np.nanmin(values) > values.max() - chance:
            return (
                "the likelihood hardly depends on it: forces that change faster, or larger ones "
                "against the noise, would show it"
            )
        if abs(best) > self.max_delay - 0.5 * self.step:
            return f"the best one, {best:g} s, is at the end of the range: raise max_delay"
        error = self.standard_error()
        if not np.isfinite(error):
            return "the likelihood has no maximum of which one could take the width"
        rivals = [
            float(tried[k])
            for k in range(1, tried.size - 1)
            if values[k] >= max(values[k - 1], values[k + 1], values.max() - chance)
            and abs(tried[k] - best) > max(2.0 * self.step, 5.0 * error)
        ]
        if rivals:
            return f"{best:g} s and {rivals[0]:g} s explain the data alike: record forces that do not repeat"
        return ""
