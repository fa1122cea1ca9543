"""Does a part that no sensor measures act on the coordinates?  Resonators of every frequency are tried.

With such a part, a load that swings or a shaft that twists, the equation error depends on the past of the
motion.  About its rest the part is a mass m on a spring and a damper.  Its deviation z from the place g(q)
that carries it obeys

    z̈ + 2ζω ż + ω² z = −d²g/dt²,    and its force is  m (ω² z + 2ζω ż) ∂g/∂q.

g is a coordinate or, for an angle, its sine or cosine.  The equation error along the curve is regressed on
such forces, with m ≥ 0, beside all common terms, late forces, and free oscillations of each trial.  A part is
reported if it explains most of what those leave, or half and the quarters of the recordings agree on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from heapq import nlargest
from itertools import product

import numpy as np
from scipy.linalg import block_diag, orth
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize, nnls

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

_FREQUENCIES, _DAMPING = 40, (0.003, 0.01, 0.03, 0.1, 0.3)  # of the resonators that are tried
_FEWEST_TURNS, _RATE = 1.5, 8.0  # turns in the longest trial; rows in a period of the highest frequency
_STEPS, _ROWS, _TRIALS = 60, 3, 12  # of the simplex; for each column, at least; the longest ones
_MOST, _RINGS, _RANK = np.array([np.inf, 0.0]), 0.5, 1e-7  # of log ω, log ζ; ζ of a resonance; singular value


def unmeasured_part(search: Search) -> list[Finding]:
    """Frequency and damping of a part that explains most of what no other term explains, if there is one."""
    fit, high = search.found, DIAGNOSIS.part_fastest / search.scales.period
    names, trials = fit.problem.coordinates, list(_trials(fit, high))
    used = [i for i in range(len(names)) if i not in fit.problem.prescribed]
    others = [_basis(np.concatenate([t.others[:, i] for t in trials], axis=1).T) for i in used]
    low = _FEWEST_TURNS / max(lengths := [float(np.ptp(s.breakpoints)) for s in fit.grid.spline.spaces])
    if low >= high or len(others[0]) < _ROWS * (others[0].shape[1] + 2 * len(trials)):
        return []

    def errors(logs: np.ndarray) -> np.ndarray:  # (2, n_used, n_rows), what nothing else explains, and a part
        found = [_errors(trials, i, other, logs) for i, other in zip(used, others, strict=True)]
        return np.sqrt(fit.weights.physics[used, None]) * np.transpose(found, (1, 0, 2))

    def left(logs: np.ndarray) -> float:
        whole, part = errors(logs)
        return float(np.sum((whole - part) ** 2) / max(np.sum(whole**2), 1e-300))

    starts = np.log([*product(2.0 * np.pi * np.geomspace(low, high, _FREQUENCIES), _DAMPING)])
    best = minimize(left, min(starts, key=left), method="Nelder-Mead", options={"maxfev": _STEPS})
    (omega, damping), found = np.exp(np.minimum(best.x, _MOST)), errors(best.x)
    frequency, explained = omega / (2.0 * np.pi), 1.0 - best.fun
    size = min(float(np.sum(w * p) / max(np.sum(p * p), 1e-300)) for w, p in np.array_split(found, 4, axis=2))
    forms = {doubt.code for doubt in doubts_about_the_form(fit, DIAGNOSIS.part_of_error)}
    enough = size > DIAGNOSIS.part_agrees and frequency * sum(lengths) > DIAGNOSIS.part_turns
    least = DIAGNOSIS.part_likely if enough and "form-imitated" not in forms else DIAGNOSIS.part_explains
    if not (explained > least and low < frequency < high and damping < _RINGS):
        return []
    carrier = names[used[int(np.argmax(np.sum(found[1] * (2.0 * found[0] - found[1]), axis=1)))]]
    hidden = free_name("h", {*names, *fit.problem.ranges})  # position of its mass, on a spring to the carrier
    terms, friction = [f"{hidden}_dot**2", f"({carrier}-{hidden})**2"], f"({carrier}_dot-{hidden}_dot)**2/2"
    # without known forces, another spring on the coordinate goes with another resonance
    seen = {} if fit.grid.forces is None else {"frequency": frequency, "damping_ratio": damping}
    seen |= {"explained": explained, "hidden": hidden, "terms": terms, "friction": friction}
    return [find("unmeasured-part", carrier, **seen)]


@dataclass(frozen=True, eq=False)
class _Trial:
    """The slow part of the motion of a trial, and rows of the regression, which are ``every`` so many."""

    step: float
    every: int
    times: np.ndarray  # (n_rows,)
    places: list[tuple[int, np.ndarray, np.ndarray]]  # coordinate, d²g/dt² (n_times,), ∂g/∂q (n_rows,)
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
        every, width = max(1, int(1.0 / (_RATE * high * step))), 1.0 / (2.0 * np.pi * high * step)
        values = np.nan_to_num(np.concatenate([residual[None], *others]), posinf=0.0, neginf=0.0)
        rows = gaussian_filter1d(values, width)[..., ::every]
        places = [(i, gaussian_filter1d(a, width), s[::every]) for i, a, s in _places(points, problem)]
        yield _Trial(step, every, step * np.arange(space.n_intervals)[::every], places, rows[0], rows[1:])


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


def _basis(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns with the same span."""
    sizes = np.linalg.norm(columns, axis=0)
    return orth(columns / np.where(sizes > 0.0, sizes, 1.0), rcond=_RANK)
