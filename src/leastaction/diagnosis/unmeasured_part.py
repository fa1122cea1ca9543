"""Does a part that no sensor measures act on the coordinates?  Resonators of every frequency are tried.

With such a part, a load that swings or a shaft that twists, the equation error depends on the past of the
motion.  About its rest the part is a mass m on a spring and a damper.  Its deviation z from the place g(q)
that carries it obeys

    z̈ + 2ζω ż + ω² z = −d²g/dt²,    and its force is  m (ω² z + 2ζω ż) ∂g/∂q.

g is a coordinate or, for an angle, its sine or cosine.  Parts that move far obey other laws (`far_parts`).
Driven by the measured motion they are simulated, with ω, ζ, a number b of their form and their first states
fitted.  The equation error along the curve is regressed on such forces, with m ≥ 0, beside all common terms,
late forces, and free oscillations of each trial.  A part is reported if it explains most of what those leave
below some frequency, and the quarters of the recordings agree on it.  Two resonators, or one where another
form of L explains as much, have to explain nearly all of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from heapq import nlargest
from itertools import islice, product

import numpy as np
from scipy.linalg import block_diag
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize, nnls

from leastaction.diagnosis.far_parts import FINE, LOAD, RINGS, SECOND, SLIDE, FarPart, Form, Trial, basis
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
_MOST = np.array([np.inf, 0.0])  # of log ω and log ζ
_HALF = 0.5  # of what a resonator leaves: a part that moves far and leaves less describes it better


@dataclass(frozen=True, eq=False)
class _Part:
    """One or two parts on coordinate ``carrier``, in whose equation they act.

    ``resonances`` are (n, 2) ω and ζ.  ``errors`` are (2, n_rows) what everything else leaves of that
    equation, and what they explain of it.
    """

    carrier: int
    errors: np.ndarray
    resonances: np.ndarray
    form: Form | None = None

    @property
    def left(self) -> float:
        whole, part = self.errors
        return float(np.sum((whole - part) ** 2) / max(np.sum(whole**2), 1e-300))

    @property
    def size(self) -> float:
        """In the quarter of the recordings where it is smallest, over that in all."""
        quarters = np.array_split(self.errors, 4, axis=1)
        return min(float(np.sum(w * p) / max(np.sum(p * p), 1e-300)) for w, p in quarters)

    def holds(self, band: tuple[float, float], seconds: float, contested: bool) -> bool:
        """Whether it explains enough in recordings that last some ``seconds`` together."""
        omega, damping = self.resonances.T
        frequency = omega / (2.0 * np.pi)
        rings = np.all((band[0] < frequency) & (frequency < band[1]) & (damping < RINGS))
        few = frequency.min() * seconds <= DIAGNOSIS.part_turns
        least = DIAGNOSIS.part_few_turns if few else DIAGNOSIS.part_explains
        if contested or len(omega) > 1:
            least = DIAGNOSIS.part_certain
        return bool(rings) and self.size > DIAGNOSIS.part_agrees and 1.0 - self.left > least


@dataclass(frozen=True, eq=False)
class _Motion:
    """The motion of a trial on the grid of the fit: its step, values, places, and coordinates.

    ``values`` are (1 + n_columns, n_dof, n_times), the equation error and what may explain it otherwise.
    """

    step: float
    values: np.ndarray
    places: list[tuple[int, np.ndarray, np.ndarray]]  # coordinate, d²g/dt² and ∂g/∂q (n_times,)
    coordinates: np.ndarray  # (3, n_dof, n_times)


def unmeasured_part(search: Search, suspect: bool = False) -> list[Finding]:
    """Frequency and damping of a part that explains most of what no other term explains, if there is one.

    Noise of the accelerations grows with the square of the frequency, so that it hides a part in one band of
    the equation error and not in another.  The first band in which a part is found decides.

    Parameters
    ----------
    search : Search
    suspect : bool
        Whether the terms of the fit may have bent its curve, as those of a fit that did not converge.  A
        smooth curve through the samples is then taken.
    """
    fit, high = search.found, DIAGNOSIS.part_fastest / search.scales.period
    if suspect and fit.problem.sensors is None:
        fit = replace(fit, control_points=fit.grid.smooth().control_points)
    doubts = doubts_about_the_form(search.found, DIAGNOSIS.part_of_error)
    contested = any(doubt.code == "form-imitated" for doubt in doubts)
    motions = list(_motions(fit))
    tried = (_in_band(fit, motions, share * high, contested) for share in _BANDS)
    return list(islice(filter(None, tried), 1))


def _in_band(fit: Fit, motions: list[_Motion], high: float, contested: bool) -> Finding | None:
    """A part that explains the equation error below a frequency."""
    names, trials = fit.problem.coordinates, [_below(high, motion) for motion in motions]
    used = [i for i in range(len(names)) if i not in fit.problem.prescribed]
    others = [basis(np.concatenate([t.others[:, i] for t in trials], axis=1).T) for i in used]
    lengths = [float(np.ptp(space.breakpoints)) for space in fit.grid.spline.spaces]
    band = _FEWEST_TURNS / max(lengths), high
    if band[0] >= high or len(others[0]) < _ROWS * (others[0].shape[1] + 2 * len(trials)):
        return None
    single = [_resonators(trials, i, other, band) for i, other in zip(used, others, strict=True)]
    k = int(np.argmin([part.left for part in single]))
    i, other, parts = used[k], others[k], list(single)
    forms = (SECOND, SLIDE) if names[i] in fit.problem.candidates.turning else (LOAD,)
    for form in forms if fit.grid.forces is not None else ():  # motion of its own says too little of b
        far = FarPart(form, trials, i, other)
        best = far.fitted(band)
        errors = far.driven(np.concatenate([far.at(best), far.swinging(best)]))
        parts.append(_Part(i, errors, np.exp(best[None, :2]), form))

    def holding(some: list[_Part]) -> list[_Part]:
        return [part for part in some if part.holds(band, sum(lengths), contested)]

    passing = holding(parts) or holding([_resonators(trials, i, other, band, single[k])])
    best = min(passing, key=lambda p: p.left * (_HALF if p.form is None else 1.0), default=None)
    return None if best is None else _described(best, fit)


def _described(part: _Part, fit: Fit) -> Finding:
    """The finding, with candidates to declare each part."""
    carrier, taken = fit.problem.coordinates[part.carrier], {*fit.problem.coordinates, *fit.problem.ranges}
    hidden, terms, friction = list[str](), list[str](), list[str]()
    for _ in part.resonances:
        hidden.append(name := free_name("h", {*taken, *hidden}))
        if part.form is None:  # position of its mass, on a spring to the carrier
            terms += [f"{name}_dot**2", f"({carrier}-{name})**2"]
            friction.append(f"({carrier}_dot-{name}_dot)**2/2")
        else:
            terms += [text.format(q=carrier, h=name) for text in part.form.terms]
            friction.append(f"{name}_dot**2/2")
    # without known forces, another spring on the coordinate goes with another resonance
    seen: dict[str, object] = {}
    if fit.grid.forces is not None:
        frequencies, dampings = part.resonances[:, 0] / (2.0 * np.pi), part.resonances[:, 1]
        seen = {"frequency": float(frequencies[0]), "damping_ratio": float(dampings[0])}
        if len(frequencies) > 1:
            seen |= {"second_frequency": float(frequencies[1]), "second_damping_ratio": float(dampings[1])}
    seen |= {"explained": 1.0 - part.left, "hidden": ", ".join(hidden)}
    return find("unmeasured-part", carrier, **seen, terms=terms, friction=", ".join(friction))


def _resonators(
    trials: list[Trial], i: int, other: np.ndarray, band: tuple[float, float], beside: _Part | None = None
) -> _Part:
    """The resonator on coordinate ``i`` that explains most; with one ``beside`` it, the two that do."""
    begun = np.zeros(0) if beside is None else np.log(beside.resonances.ravel())

    def left(logs: np.ndarray) -> float:
        return _Part(i, _errors(trials, i, other, logs), np.zeros((0, 2))).left

    added = np.log([*product(2.0 * np.pi * np.geomspace(*band, _FREQUENCIES), _DAMPING)])
    start = min((np.concatenate([begun, one]) for one in added), key=left)
    steps = _STEPS * start.size // 2
    best = minimize(left, start, method="Nelder-Mead", options={"maxfev": steps}).x
    return _Part(i, _errors(trials, i, other, best), np.exp(np.minimum(best.reshape(-1, 2), _MOST)))


def _motions(fit: Fit) -> Iterator[_Motion]:
    """The longest trials."""
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
        values = np.nan_to_num(np.concatenate([residual[None], *others]), posinf=0.0, neginf=0.0)
        step, motion = float(np.diff(space.breakpoints[:2])[0]), np.array(points.columns[: 3 * n])
        yield _Motion(step, values, list(_places(points, problem)), motion.reshape(3, n, -1))


def _below(high: float, motion: _Motion) -> Trial:
    """The part of a motion below a frequency."""
    step = motion.step
    stride, width = max(1, int(1.0 / (FINE * _RATE * high * step))), 1.0 / (2.0 * np.pi * high * step)
    every = stride * max(1, int(1.0 / (_RATE * high * step * stride)))
    rows = gaussian_filter1d(motion.values, width)[..., ::every]
    places = [(i, gaussian_filter1d(a, width), s[::every]) for i, a, s in motion.places]
    q, v, a = motion.coordinates
    slow = np.array([q, v, gaussian_filter1d(a, width)]).transpose(2, 0, 1)[::stride]
    times: np.ndarray = step * np.arange(len(q[0]))[::every]
    return Trial(step, every, stride, width, times, places, slow, rows[0], rows[1:])


def _places(points: Points, problem: Problem) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Coordinate, d²g/dt² and ∂g/∂q of each place to which a part may be attached."""
    n = points.n_dof
    for i, name in enumerate(problem.coordinates):
        q, v, a = points.columns[i], points.columns[n + i], points.columns[2 * n + i]
        yield i, a, np.ones(q.size)
        if name in problem.candidates.turning:
            yield i, np.cos(q) * a - np.sin(q) * v**2, np.cos(q)
            yield i, -np.sin(q) * a - np.cos(q) * v**2, -np.sin(q)


def _errors(trials: list[Trial], i: int, others: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """(2, n_rows) equation error that everything else leaves, and what parts explain of it.

    ``logs`` are log ω and log ζ of one after the other.
    """
    from scipy.signal import bilinear, lfilter  # takes half a second to import

    free, forces = list[np.ndarray](), list[np.ndarray]()
    for t in trials:
        ringing, pulls = list[np.ndarray](), list[np.ndarray]()
        for omega, damping in np.exp(np.minimum(logs.reshape(-1, 2), _MOST)):
            turn, above = omega * np.sqrt(1.0 - damping**2), [2.0 * damping * omega, omega**2]
            decay = np.exp(-damping * omega * t.times)
            ringing += [decay * np.cos(turn * t.times), decay * np.sin(turn * t.times)]
            numbers = bilinear(above, [1.0, *above], 1.0 / t.step)
            pulls += [-s * lfilter(*numbers, a)[:: t.every] for k, a, s in t.places if k == i]
        free.append(np.array(ringing))
        forces.append(np.array(pulls))
    residual, parts = np.concatenate([t.residual[i] for t in trials]), np.concatenate(forces, axis=1)
    columns = np.concatenate([residual[None], parts, block_diag(*free)]).T
    columns = columns - others @ (others.T @ columns)
    swinging = basis(columns[:, 1 + len(parts) :])
    columns = columns[:, : 1 + len(parts)] - swinging @ (swinging.T @ columns[:, : 1 + len(parts)])
    return np.array([columns[:, 0], columns[:, 1:] @ nnls(columns[:, 1:], columns[:, 0])[0]])
