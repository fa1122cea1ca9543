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
  Vibration also shifts the coefficients of the law, so that the part of the states that is caused is removed.
* Chance. The gain has to exceed all gains in what is left after any shift in time. A shift keeps the spectra
  and nothing else.

A machine that nothing drives is not tested: nothing distinguishes a mass from vibration there. Forces that
repeat themselves make shifts look like the truth, so that nothing is said.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, count, pairwise

import numpy as np

from leastaction.data.validation import FloatArray
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.findings import Finding, find
from leastaction.mechanics import Points
from leastaction.selection.search_state import Search

__all__ = ["hidden_freedom"]

_MOST_POINTS = 8000  # along the motion, each with all columns
_PIECES = 8  # stretches, at least: what is caused in one is estimated in the others
_AWAY = 0.05  # of the data: shifts beyond this keep chance alone
_DRY = 0.1  # of the root mean square velocity: width of the step of dry friction
_FREQUENCIES, _DAMPINGS = 32, (0.02, 0.1, 0.3, 0.6)  # tried first
_CLOSER = np.linspace(-0.3, 0.3, 25)  # of log ω: about the best of these
_CLOSER_DAMPINGS = (0.01, 0.03, 0.07, 0.15, 0.25, 0.4, 0.6)  # with these dampings
_BANK = 14  # frequencies of the filters that the known forces are passed through
_BANK_DAMPINGS = (0.1, 0.6)  # and their dampings
_FULL_DEGREE, _OWN_DEGREE = 2, 3  # of polynomials in all states, in those of one coordinate
_CAUSED = 0.05  # share of a state, caused by known forces, below which it counts as nothing
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
    frequencies, drives = _frequencies(fit, motion), list(_drives(fit, motion))
    columns = [scan.columns(drive, *_paired(frequencies, _DAMPINGS)) for drive in drives]
    gains = np.array([_gains(scan.residual, own)[:, 0] for own in columns])
    which, at = np.unravel_index(int(np.argmax(gains)), gains.shape)
    share, over_chance = float(gains.max()) / scan.whole, scan.over_chance(columns, columns[which][at])
    if share < DIAGNOSIS.freedom_share or over_chance < DIAGNOSIS.freedom_chance:
        return []
    drive = drives[which]
    hertz, error = scan.frequency(drive, frequencies[at // len(_DAMPINGS)])
    name = fit.problem.coordinates[motion.equations[drive.equation]]
    new, terms = _proposed(fit, name, drive)
    figures = {"frequency": hertz, "error": error, "share": share, "over_chance": over_chance}
    return [find("hidden-freedom", name, hidden=new, terms=terms, **figures)]


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


def _paired(frequencies: np.ndarray, dampings: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Every frequency with every damping."""
    return np.repeat(frequencies, len(dampings)), np.tile(dampings, len(frequencies))


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

    Terms of the law, and in every equation the rate of its known force, dry friction, and polynomials in the
    state.
    """
    n = len(motion.equations)
    features: list[list[np.ndarray]] = []
    rubbing: list[np.ndarray] = []
    for i, name in enumerate(fit.problem.coordinates):
        q, v = motion.q[:, i], motion.qdot[:, i]
        place = [np.sin(q), np.cos(q)] if name in fit.problem.candidates.turning else [_scaled(q)]
        features.append([*place, _scaled(v)])
        rubbing.append(v / np.hypot(v, _DRY * np.sqrt(np.mean(v**2))))
    together = [column for own in features for column in own]
    columns = [*motion.terms]
    for row, i in enumerate(motion.equations):
        own = [motion.force_rates[:, i], *rubbing]
        own += list(_monomials(together, _FULL_DEGREE)) + list(_monomials(features[i], _OWN_DEGREE))
        columns += [np.outer(np.arange(n) == row, column) for column in own]
    return _orthonormal(np.array(columns).reshape(len(columns), -1))


def _scaled(values: np.ndarray) -> np.ndarray:
    return (values - values.mean()) / max(float(values.std()), 1e-300)


def _monomials(factors: list[np.ndarray], degree: int) -> Iterator[np.ndarray]:
    for d in range(degree + 1):
        for chosen in combinations_with_replacement(factors, d):
            yield np.prod(chosen, axis=0) if chosen else np.ones_like(factors[0])


def _orthonormal(rows: np.ndarray, least: float | None = None) -> np.ndarray:
    """Orthonormal rows of the same span, less those of a mean square below ``least``."""
    size = np.linalg.norm(rows, axis=1)
    if least is None:
        rows = rows[np.isfinite(size) & (size > 0.0)]
        rows = rows / np.linalg.norm(rows, axis=1)[:, None]
    values, vectors = np.linalg.eigh(rows @ rows.T)
    kept = values > (_NULL * values[-1] if least is None else least)
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
        shape = (len(states), *motion.residual.shape)
        self.caused_states = _orthonormal(self.caused(states.reshape(shape)).reshape(states.shape), _CAUSED)

    def columns(self, drive: _Drive, omega: np.ndarray, zeta: np.ndarray) -> np.ndarray:
        """(n_poles, n_equations, n_points) what unit masses leave, as far as the known forces cause it."""
        motion = self.motion
        pushed = _unit_forces(motion, drive, omega, zeta)
        whole = np.zeros((len(pushed), *motion.residual.shape))
        whole[:, drive.equation] = pushed * motion.root[drive.equation]
        free = self._free(whole.reshape(len(whole), -1)).reshape(whole.shape)
        caused = self.caused(free).reshape(len(whole), -1)
        return (caused - (caused @ self.caused_states.T) @ self.caused_states).reshape(whole.shape)

    def over_chance(self, columns: Sequence[np.ndarray], best: np.ndarray) -> float:
        """The gain of one column over the largest gain of all in what it leaves, shifted by any time."""
        product, square = np.sum(best * self.residual), np.sum(best**2)
        left = self.residual - product / square * best
        least = max(1, round(_AWAY * left.shape[-1]))
        chance = max(float(_gains(left, own)[:, least:-least].max()) for own in columns)
        return float(product**2 / square) / max(chance, 1e-300)

    def frequency(self, drive: _Drive, about: float) -> tuple[float, float]:
        """The frequency that explains most, near another one, and its jackknife error over the stretches."""
        frequencies = about * np.exp(_CLOSER)
        columns = self.columns(drive, *_paired(frequencies, _CLOSER_DAMPINGS))
        shape = (len(self.pieces), _CLOSER.size, len(_CLOSER_DAMPINGS))
        products, squares = (
            np.array([np.sum((columns * x)[..., own], axis=(1, 2)) for own in self.pieces]).reshape(shape)
            for x in (self.residual, columns)
        )

        def best(products: np.ndarray, squares: np.ndarray) -> float:
            gain = np.maximum(products, 0.0) ** 2 / np.maximum(squares, 1e-300)
            return float(frequencies[int(np.argmax(gain.max(axis=1)))])

        total = products.sum(axis=0), squares.sum(axis=0)
        left = [np.log(best(total[0] - a, total[1] - b)) for a, b in zip(products, squares, strict=True)]
        width = _CLOSER[1] - _CLOSER[0]  # no finer than the frequencies that are tried
        spread = float(np.sqrt((len(left) - 1) * np.var(left) + width**2 / 12.0))
        hertz = best(*total) / (2.0 * np.pi)
        return hertz, hertz * spread

    def caused(self, rows: np.ndarray) -> np.ndarray:
        """The part of (n_rows, n_equations, n_points) that known forces cause, by other stretches."""
        parts = [rows[..., own] @ self.bank[:, own].T for own in self.pieces]
        total, out = sum(parts), np.empty_like(rows)
        for part, own, inverse in zip(parts, self.pieces, self.others, strict=True):
            out[..., own] = (total - part) @ inverse @ self.bank[:, own]
        return out

    def _free(self, rows: np.ndarray) -> np.ndarray:
        return rows - (rows @ self.states.T) @ self.states

    def _filtered_inputs(self) -> np.ndarray:
        """(n_columns, n_points) orthonormal: known forces after many oscillators."""
        motion = self.motion
        span = np.array([s.stop - s.start for s in motion.trials]).min() / len(self.pieces)
        step = motion.t[1] - motion.t[0]
        frequencies = _spaced(np.pi / (span * step), np.pi / (3.0 * step), _BANK)
        poles = _poles(*_paired(frequencies, _BANK_DAMPINGS))
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


def _gains(residual: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(n_columns, n_points) by how much each column lowers the sum of squares, for every shift in time.

    A mass is positive: where it would have to be negative, so is the gain.
    """
    spectra = np.conj(np.fft.rfft(columns)) * np.fft.rfft(residual)
    products = np.fft.irfft(spectra.sum(axis=1), columns.shape[-1])
    squares = np.maximum(np.sum(columns**2, axis=(1, 2)), 1e-300)
    return np.abs(products) * products / squares[:, None]
