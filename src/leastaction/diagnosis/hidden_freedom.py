r"""Is there a degree of freedom that no sensor sees?

A mass m on a spring that moves with h(q) q̇ of a measured coordinate leaves in the equations

.. math:: r_i = -m\,h_i(q)\,(\omega^2 z + 2\zeta\omega\dot z),\qquad
          \ddot z + 2\zeta\omega\dot z + \omega^2 z = -\frac{d}{dt}\bigl(h_i(q)\,\dot q_i\bigr),

so that the transfer from q̈ to the residual has a pole at ω (and the motion under a force a notch there).
Frequencies, dampings and h = 1, cos q, sin q are tried.

Three other causes leave such residuals, too:

* Forces that depend on the state: a wrong library, friction. Polynomials in the state are removed from the
  residual first, and with them the terms of the law and the rates of the known forces, which a delay leaves.
* Vibration from outside. The motion follows it, so that filtered motion explains it. Only the part of the
  motion that the known forces cause is therefore compared with the residual (instrumental variables;
  Söderström & Stoica 2002, Circuits Syst. Signal Process. 21:1). That part is estimated in other stretches of
  the recording than those in which it is used.
* Chance. The stretches have to agree.

A machine that nothing drives is not tested: nothing distinguishes a mass from vibration there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement, count, pairwise

import numpy as np

from leastaction.data.validation import FloatArray
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.findings import Finding, find
from leastaction.mechanics import Points
from leastaction.selection.search_state import Search
from leastaction.selection.significance import normal_cutoff

__all__ = ["hidden_freedom"]

_MOST_POINTS = 8000  # along the motion, each with all columns
_PIECES = 8  # stretches that have to agree, at least
_FREQUENCIES, _DAMPINGS = 32, (0.02, 0.1, 0.3, 0.6)  # tried first
_CLOSER = np.linspace(-0.3, 0.3, 25)  # of log ω: about the best of these
_CLOSER_DAMPINGS = (0.01, 0.03, 0.07, 0.15, 0.25, 0.4, 0.6)  # with these dampings
_BANK = 14  # frequencies of the filters that the known forces are passed through
_BANK_DAMPINGS = (0.1, 0.6)  # and their dampings
_FULL_DEGREE, _OWN_DEGREE = 2, 3  # of polynomials in all states, in those of one coordinate
_RIDGE, _NULL = 1e-3, 1e-6  # relative: of filtered forces; rounding


@dataclass(frozen=True, eq=False)
class _Motion:
    """States at equal steps along the fitted curve, trial by trial.

    Attributes
    ----------
    t : (n_points,) array
    q, qdot, qddot : (n_points, n_dof) arrays
    inputs : (n_inputs, n_points) array
        Known forces, and accelerations of prescribed coordinates.
    force_rates : (n_points, n_dof) array
    residual : (n_equations, n_points) array
        What the terms of the law lack, times the root of the weight of each equation.
    terms : (n_members, n_equations, n_points) array
        The terms of the structure, with the same weight.
    equations : list of int
        Coordinates with an equation of motion.
    trials : list of slice
    piece : (n_points,) int array
        To which stretch of the recording a point belongs.
    """

    t: np.ndarray
    q: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    inputs: np.ndarray
    force_rates: np.ndarray
    residual: np.ndarray
    terms: np.ndarray
    equations: list[int]
    root: np.ndarray
    trials: list[slice]
    piece: np.ndarray


@dataclass(frozen=True, eq=False)
class _Drive:
    """What moves the mass: h(q) of one equation, and the derivative of h(q) q̇."""

    equation: int
    factor: str
    h: np.ndarray
    rate: np.ndarray


def hidden_freedom(search: Search) -> list[Finding]:
    """Say whether a mass on a spring that the motion drives would explain much of the equation error.

    Cost: some hundred filters along the motion; a tenth of a fit.
    """
    fit = search.found
    if not fit.converged:
        return []
    motion = _motion(fit)
    if not len(motion.inputs):
        return []
    scan = _Scan(motion, _residue_of_states(fit, motion))
    frequencies = _frequencies(fit, motion)
    drives = list(_drives(fit, motion))
    sums = np.stack([scan.sums(drive, frequencies, _DAMPINGS) for drive in drives])
    best = np.unravel_index(int(np.argmax(_gain(sums.sum(axis=-2)))), sums.shape[:3])
    drive, middle = drives[best[0]], frequencies[best[1]]
    closer = middle * np.exp(_CLOSER)
    finer = scan.sums(drive, closer, _CLOSER_DAMPINGS)
    at = np.unravel_index(int(np.argmax(_gain(finer.sum(axis=-2)))), finer.shape[:2])
    explained = float(_gain(finer[at].sum(axis=0))) / scan.whole
    z = _agreement(finer[at])
    if explained < DIAGNOSIS.freedom_share or z < normal_cutoff(len(drives)):
        return []
    hertz = float(closer[at[0]]) / (2.0 * np.pi)
    name = fit.problem.coordinates[motion.equations[drive.equation]]
    new, terms = _proposed(fit, name, drive)
    figures = {"frequency": hertz, "error": hertz * _jackknife(finer, closer), "share": explained}
    return [find("hidden-freedom", name, hidden=new, terms=terms, standard_errors=z, **figures)]


def _proposed(fit: Fit, name: str, drive: _Drive) -> tuple[str, list[str]]:
    """A name that is not taken, and candidates for a coordinate of that name."""
    taken = set(fit.problem.coordinates)
    new = next(text for k in count() if (text := f"z{k or ''}") not in taken)
    factor = "" if drive.factor == "1" else f"*{drive.factor}({name})"
    return new, [f"{new}_dot**2", f"{name}_dot*{new}_dot{factor}", f"{new}**2"]


def _motion(fit: Fit) -> _Motion:
    """The fitted motion, and what is left of the equations along it."""
    problem, spline = fit.problem, fit.grid.spline
    data, n = problem.trajectories, problem.trajectories.n_dof
    stride = 1 + data.n_samples // _MOST_POINTS
    equations = [i for i in range(n) if i not in problem.prescribed]
    parts: list[list[np.ndarray]] = []
    for k, (space, points) in enumerate(zip(spline.spaces, spline.split(fit.control_points), strict=True)):
        given, at = data[k].forces, data[k].t
        times = np.linspace(float(at[0]), float(at[-1]), max(2 * _PIECES, at.size // stride))
        forces: FloatArray = np.zeros((times.size, n))
        if given is not None:
            forces = np.array([np.interp(times, at, given[:, i]) for i in range(n)]).T
        states = [space.evaluate(points, times, nu) for nu in range(3)]
        parts.append([times, *states, forces, np.gradient(forces, times, axis=0)])
    t, q, qdot, qddot, pushes, force_rates = map(np.concatenate, zip(*parts, strict=True))
    ends = np.cumsum([0, *(part[0].size for part in parts)]).tolist()
    trials = [slice(a, b) for a, b in pairwise(ends)]
    each = max(1, -(-_PIECES // len(trials)))
    lengths = [s.stop - s.start for s in trials]
    owners: list[int] = [each * k + j * each // m for k, m in enumerate(lengths) for j in range(m)]
    strong = problem.candidates.strong(Points(q, qdot, qddot, t))[:, equations]
    root = np.sqrt(fit.weights.physics[equations])[:, None]
    residual = pushes.T[equations] - np.tensordot(fit.coefficients, strong, 1)
    pushed = [*pushes.T[equations], *(qddot[:, i] for i in problem.prescribed)]
    inputs = np.array([u for u in pushed if np.any(u)]).reshape(-1, t.size)
    terms = strong[list(fit.structure)] * root
    return _Motion(
        t,
        q,
        qdot,
        qddot,
        inputs,
        force_rates,
        residual * root,
        terms,
        equations,
        root,
        trials,
        np.array(owners),
    )


def _frequencies(fit: Fit, motion: _Motion) -> np.ndarray:
    """Frequencies to try, in rad/s: those that the stretches and the knots of the curve can resolve."""
    stretch = min(motion.t[s.stop - 1] - motion.t[s.start] for s in motion.trials)
    stretch *= len(motion.trials) / (motion.piece[-1] + 1)
    step = fit.grid.spline.duration / fit.grid.spline.n_intervals
    step = max(motion.t[1] - motion.t[0], 0.5 * step)
    slowest, fastest = 3.0 * np.pi / stretch, np.pi / (3.0 * step)
    return _spaced(slowest, max(fastest, 3.0 * slowest), _FREQUENCIES)


def _spaced(slowest: float, fastest: float, number: int) -> FloatArray:
    return slowest * (fastest / slowest) ** (np.arange(number) / (number - 1))


def _drives(fit: Fit, motion: _Motion) -> Iterator[_Drive]:
    """Motions that may move a mass: of each coordinate, and of angles their horizontal and vertical parts."""
    for row, i in enumerate(motion.equations):
        q, v, a = motion.q[:, i], motion.qdot[:, i], motion.qddot[:, i]
        yield _Drive(row, "1", np.ones_like(q), a)
        if fit.problem.coordinates[i] in fit.problem.candidates.turning:
            yield _Drive(row, "cos", np.cos(q), np.cos(q) * a - np.sin(q) * v**2)
            yield _Drive(row, "sin", np.sin(q), np.sin(q) * a + np.cos(q) * v**2)


def _residue_of_states(fit: Fit, motion: _Motion) -> np.ndarray:
    """(n_columns, n_equations · n_points) orthonormal: what no mass is needed for.

    Terms of the law, the rates of known forces, and polynomials in the state in every equation.
    """
    n = len(motion.equations)
    features: list[list[np.ndarray]] = []
    for i, name in enumerate(fit.problem.coordinates):
        q, v = motion.q[:, i], motion.qdot[:, i]
        place = [np.sin(q), np.cos(q)] if name in fit.problem.candidates.turning else [_scaled(q)]
        features.append([*place, _scaled(v)])
    together = [column for own in features for column in own]
    columns = [*motion.terms]
    for row, i in enumerate(motion.equations):
        own = [motion.force_rates[:, i]]
        own += list(_monomials(together, _FULL_DEGREE)) + list(_monomials(features[i], _OWN_DEGREE))
        columns += [np.outer(np.arange(n) == row, column) for column in own]
    return _orthonormal(np.array(columns).reshape(len(columns), -1))


def _scaled(values: np.ndarray) -> np.ndarray:
    return (values - values.mean()) / max(float(values.std()), 1e-300)


def _monomials(factors: list[np.ndarray], degree: int) -> Iterator[np.ndarray]:
    for d in range(degree + 1):
        for chosen in combinations_with_replacement(factors, d):
            yield np.prod(chosen, axis=0) if chosen else np.ones_like(factors[0])


def _orthonormal(rows: np.ndarray) -> np.ndarray:
    """Orthonormal rows of the same span."""
    size = np.linalg.norm(rows, axis=1)
    rows = rows[np.isfinite(size) & (size > 0.0)]
    rows = rows / np.linalg.norm(rows, axis=1)[:, None]
    values, vectors = np.linalg.eigh(rows @ rows.T)
    kept = values > _NULL * values[-1]
    return (vectors[:, kept] / np.sqrt(values[kept])).T @ rows


class _Scan:
    """The residual beside filtered motions, in every stretch of the recording."""

    def __init__(self, motion: _Motion, states: np.ndarray) -> None:
        self.motion, self.states = motion, states
        law = _orthonormal(motion.terms.reshape(len(motion.terms), -1))
        raw = motion.residual.ravel()
        self.whole = float(np.sum((raw - (raw @ law.T) @ law) ** 2))
        self.residual = self._free(raw[None])[0].reshape(motion.residual.shape)
        self.pieces = [motion.piece == p for p in range(int(motion.piece[-1]) + 1)]
        self.bank = self._filtered_inputs()
        grams = [self.bank[:, own] @ self.bank[:, own].T for own in self.pieces]
        ridge = _RIDGE * np.eye(len(self.bank))
        self.others = [np.linalg.inv(sum(grams) - gram + ridge) for gram in grams]

    def sums(self, drive: _Drive, frequencies: np.ndarray, dampings: tuple[float, ...]) -> np.ndarray:
        """(n_frequencies, n_dampings, n_pieces, 2) Σ r ĉ and Σ ĉ² of unit masses, in every stretch."""
        motion = self.motion
        poles = np.repeat(frequencies, len(dampings)), np.tile(dampings, len(frequencies))
        columns = _unit_forces(motion, drive, *poles)
        whole = np.zeros((len(columns), *motion.residual.shape))
        whole[:, drive.equation] = columns * motion.root[drive.equation]
        free = self._free(whole.reshape(len(columns), -1)).reshape(whole.shape)
        parts = [free[..., own] @ self.bank[:, own].T for own in self.pieces]
        total, out = sum(parts), np.empty((len(columns), len(parts), 2))
        for p, (own, inverse) in enumerate(zip(self.pieces, self.others, strict=True)):
            caused = (total - parts[p]) @ inverse @ self.bank[:, own]
            out[:, p, 0] = np.einsum("cip,ip->c", caused, self.residual[:, own])
            out[:, p, 1] = np.einsum("cip,cip->c", caused, caused)
        return out.reshape(len(frequencies), len(dampings), len(parts), 2)

    def _free(self, rows: np.ndarray) -> np.ndarray:
        return rows - (rows @ self.states.T) @ self.states

    def _filtered_inputs(self) -> np.ndarray:
        """(n_columns, n_points) orthonormal: known forces after many oscillators."""
        motion = self.motion
        span = np.array([s.stop - s.start for s in motion.trials]).min() / len(self.pieces)
        step = motion.t[1] - motion.t[0]
        frequencies = _spaced(np.pi / (span * step), np.pi / (3.0 * step), _BANK)
        poles = _poles(np.repeat(frequencies, len(_BANK_DAMPINGS)), np.tile(_BANK_DAMPINGS, _BANK))
        states = [_filtered(motion, values, poles) for values in motion.inputs]
        return _orthonormal(np.vstack([motion.inputs, *map(np.real, states), *map(np.imag, states)]))


def _unit_forces(motion: _Motion, drive: _Drive, omega: np.ndarray, zeta: np.ndarray) -> np.ndarray:
    """(n_poles, n_points) what unit masses leave in the equation, from rest."""
    poles = _poles(omega, zeta)
    factor = (omega**2 + 2.0 * zeta * omega * poles) / np.imag(poles)
    return drive.h * np.imag(factor[:, None] * _filtered(motion, drive.rate, poles))


def _poles(omega: np.ndarray, zeta: np.ndarray) -> np.ndarray:
    return omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))


def _filtered(motion: _Motion, push: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """(n_poles, n_points) s with ṡ = p s + u from rest, exact for u that is linear between the points.

    The motion of a mass is z = −Im s / Im p.
    """
    longest = max(s.stop - s.start for s in motion.trials)
    inputs = np.zeros((longest, len(motion.trials)))
    for k, s in enumerate(motion.trials):
        inputs[: s.stop - s.start, k] = push[s]
    turn = poles[:, None] * np.array([motion.t[s.start + 1] - motion.t[s.start] for s in motion.trials])
    whole = np.exp(turn)
    held, ramp = (whole - 1.0) / poles[:, None], (whole - 1.0 - turn) / (turn * poles[:, None])
    state = np.zeros(whole.shape, complex)
    out = np.zeros((longest, *whole.shape), complex)
    for m in range(1, longest):
        state = whole * state + (held - ramp) * inputs[m - 1] + ramp * inputs[m]
        out[m] = state
    parts = [out[: s.stop - s.start, :, k] for k, s in enumerate(motion.trials)]
    return np.concatenate(parts).T


def _gain(sums: np.ndarray) -> np.ndarray:
    """By how much a mass, which is positive, lowers the sum of squares."""
    return np.maximum(sums[..., 0], 0.0) ** 2 / np.maximum(sums[..., 1], 1e-300)


def _agreement(sums: np.ndarray) -> float:
    """The mass that all stretches give together, over its standard error from their scatter."""
    products, squares = sums.T
    scatter = products - products.sum() / squares.sum() * squares
    count = len(products)
    return float(products.sum() / np.sqrt(np.sum(scatter**2) * count / (count - 1)))


def _jackknife(sums: np.ndarray, frequencies: np.ndarray) -> float:
    """Relative standard error of the frequency, from leaving out each stretch in turn."""
    total, count = sums.sum(axis=-2), sums.shape[-2]
    left = [_gain(total - sums[..., p, :]).max(axis=1) for p in range(count)]
    peaks = np.array([np.log(frequencies[int(np.argmax(gains))]) for gains in left])
    width = np.log(frequencies[1] / frequencies[0])  # no finer than the frequencies that are tried
    return float(np.sqrt((count - 1) * np.var(peaks) + width**2 / 12.0))
