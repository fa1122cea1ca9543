"""RK4-SINDy: sparse equations of motion whose Runge–Kutta step leads from sample to sample.

Reference: P. Goyal, P. Benner, "Discovery of nonlinear dynamical systems using a Runge-Kutta inspired
dictionary-based sparse regression approach", Proc. R. Soc. A 478, 20210883 (2022).

The state is (q, q̇), with q̈ = Θ(q, q̇, f) ξ.  ξ minimises the squared difference between each next state and
one classical Runge–Kutta step from the present one; coefficients below a cutoff are set to zero and the rest
is fitted again, until no more fall below it.

As documented there: states are denoised first (here by smoothing splines of the positions), known inputs
enter as functions of time, the dictionary is built from knowledge of the field, the cutoff is fixed.

Chosen in its favour:

* Instead of gradient descent with automatic differentiation, each sweep solves the linear least-squares
  problem that remains when the stages are held at the last ξ.  The neglected part of the derivative is of the
  order of the sampling interval; some sweeps settle it, without a learning rate.
* Only velocities are compared: positions depend on ξ by half a sampling interval as much.
* Columns and increments are divided by their root mean squares, so that a cutoff means a share of the
  acceleration.  That one of `CUTOFFS` is taken whose steps on held-out data are best; then everything is
  fitted again to all data.
* The dictionary has what mechanical systems are made of: harmonics of angles and of their sums and
  differences, powers of other coordinates, products of velocities, forces, and their products.

It gives no Lagrangian, and no rational functions (q̈ of coupled pendulums is rational; the paper's rational
variant needs the denominators' dictionary, which here would be the mass matrix).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product

import numpy as np
from scipy.interpolate import CubicSpline

import leastaction as la
from reproduction.problem import Answer, Problem

TITLE = "RK4-SINDy"
REFERENCE = "Goyal & Benner 2022, Proc. R. Soc. A 478:20210883"

CUTOFFS = (0.003, 0.01, 0.02, 0.05, 0.1, 0.2)
EXACT = 1e-9  # relative mean squared error of a step that counts as none
RIDGE = 1e-10  # on a unit diagonal; the dictionary has nearly dependent candidates
SWEEPS = 3  # one to choose the cutoff
MAX_HARMONIC = 2
DEGREE_WITH_ANGLES, DEGREE_WITHOUT = 3, 7


@dataclass(frozen=True, eq=False)
class Steps:
    """Pairs of samples: (n, n_dof) arrays of states and forces at both ends and of forces in the middle."""

    q: np.ndarray
    qdot: np.ndarray
    q_next: np.ndarray
    qdot_next: np.ndarray
    forces: tuple[np.ndarray, np.ndarray, np.ndarray] | tuple[None, None, None]
    dt: np.ndarray

    def part(self, rows: np.ndarray) -> Steps:
        forces = self.forces if self.forces[0] is None else tuple(f[rows] for f in self.forces)
        states = (self.q, self.qdot, self.q_next, self.qdot_next)
        return Steps(*(a[rows] for a in states), forces, self.dt[rows])

    @property
    def rates(self) -> np.ndarray:
        """Mean acceleration between the samples."""
        return (self.qdot_next - self.qdot) / self.dt


def solve(problem: Problem) -> Answer:
    steps, lengths = _steps(problem)
    dictionary = _dictionary(problem)
    judge = np.zeros(sum(lengths), dtype=bool)
    judge[-lengths[-1] if len(lengths) > 1 else -(lengths[-1] // 5) :] = True
    train, test = steps.part(~judge), steps.part(judge)
    errors = np.array([_error(dictionary, xi, test) for xi in _fit(dictionary, train, CUTOFFS, 1)])
    errors[~np.isfinite(errors)] = np.inf
    cutoff = CUTOFFS[int(np.flatnonzero(errors <= errors.min() + EXACT)[-1])]
    (xi,) = _fit(dictionary, steps, (cutoff,), SWEEPS)
    return Answer(
        coefficients=None,
        acceleration=_acceleration(dictionary, xi),
        status="ok" if xi.any() else "no term was found",
        settings={
            "cutoff": cutoff,
            "cutoffs": list(CUTOFFS),
            "held_out_error": dict(zip(map(str, CUTOFFS), errors.tolist(), strict=True)),
            "candidates": len(dictionary),
            "terms": int(np.count_nonzero(xi)),
            "sweeps": SWEEPS,
        },
        expression=_expression(dictionary, xi),
    )


def _dictionary(problem: Problem) -> Dictionary:
    system = problem.system
    degree = DEGREE_WITH_ANGLES if system.angles else DEGREE_WITHOUT
    forced = problem.data[0].forces is not None
    return Dictionary(system.coordinates, system.angles, forced, MAX_HARMONIC, degree)


def _steps(problem: Problem) -> tuple[Steps, list[int]]:
    """Steps between neighbouring samples of all trajectories, and their number in each."""
    parts = []
    for motion, measured in zip(la.smooth(problem.data), problem.data, strict=True):
        t, f = motion.t, measured.forces
        forces = (None, None, None)
        if f is not None:
            forces = (f[:-1], CubicSpline(t, f)((t[:-1] + t[1:]) / 2.0), f[1:])
        states = (motion.q[:-1], motion.qdot[:-1], motion.q[1:], motion.qdot[1:])
        parts.append((*states, forces, np.diff(t)[:, None]))
    *states, forces, dt = zip(*parts, strict=True)
    joined = (None, None, None)
    if forces[0][0] is not None:
        joined = tuple(np.concatenate(f) for f in zip(*forces, strict=True))
    steps = Steps(*(np.concatenate(a) for a in states), joined, np.concatenate(dt))
    return steps, [len(d) for d in dt]


def _mean_features(dictionary: Dictionary, steps: Steps, xi: np.ndarray, select: np.ndarray) -> np.ndarray:
    """Selected candidates averaged over the four stages of a step under ξ, (n_steps, n_selected)."""
    q, v, h = steps.q, steps.qdot, steps.dt
    start, middle, end = steps.forces
    moving = xi[select]
    k1 = dictionary(q, v, start, select)
    a1 = k1 @ moving
    k2 = dictionary(q + h / 2 * v, v + h / 2 * a1, middle, select)
    a2 = k2 @ moving
    k3 = dictionary(q + h / 2 * (v + h / 2 * a1), v + h / 2 * a2, middle, select)
    a3 = k3 @ moving
    k4 = dictionary(q + h * (v + h / 2 * a2), v + h * a3, end, select)
    return (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0


def _fit(dictionary: Dictionary, steps: Steps, cutoffs: tuple[float, ...], sweeps: int) -> list[np.ndarray]:
    """Coefficients, (n_candidates, n_dof), for each cutoff."""
    # the ends of a step, for want of stages
    ends = dictionary(steps.q, steps.qdot, steps.forces[0])
    ends += dictionary(steps.q_next, steps.qdot_next, steps.forces[2])
    first = _Reduced(ends / 2.0, steps.rates)
    out = []
    for cutoff in cutoffs:
        xi = first.thresholded(cutoff)
        for _ in range(sweeps):
            select = np.flatnonzero(xi.any(axis=1))
            reduced = _Reduced(_mean_features(dictionary, steps, xi, select), steps.rates)
            xi = np.zeros_like(xi)
            xi[select] = reduced.thresholded(cutoff)
        out.append(xi)
    return out


class _Reduced:
    """Normal equations of a least-squares problem whose columns and targets have unit root mean squares."""

    def __init__(self, columns: np.ndarray, targets: np.ndarray) -> None:
        rms = np.sqrt(np.mean(columns**2, axis=0))
        rms[rms == 0.0] = 1.0
        unit = np.sqrt(np.mean(targets**2, axis=0))
        gram = columns.T @ columns / (len(columns) * np.outer(rms, rms))
        self.gram = gram + RIDGE * np.eye(len(gram))
        self.moments = columns.T @ targets / (len(columns) * np.outer(rms, unit))
        self.scale = unit / rms[:, None]

    def thresholded(self, cutoff: float) -> np.ndarray:
        """Sequentially thresholded least squares for each target, (n_columns, n_targets)."""
        out = np.zeros(self.moments.shape)
        for i, moment in enumerate(self.moments.T):
            kept = np.arange(len(moment))
            while kept.size:
                x = np.linalg.solve(self.gram[np.ix_(kept, kept)], moment[kept])
                large = np.abs(x) >= cutoff
                if large.all():
                    out[kept, i] = x
                    break
                kept = kept[large]
        return out * self.scale


def _error(dictionary: Dictionary, xi: np.ndarray, steps: Steps) -> float:
    """Mean squared error of the steps, relative to the squared changes of the velocities."""
    select = np.flatnonzero(xi.any(axis=1))
    found = _mean_features(dictionary, steps, xi, select) @ xi[select]
    return float(np.mean(np.mean((steps.rates - found) ** 2, axis=0) / np.mean(steps.rates**2, axis=0)))


def _acceleration(dictionary: Dictionary, xi: np.ndarray):
    select = np.flatnonzero(xi.any(axis=1))

    def acceleration(q, qdot, forces=None):
        # a law that holds near the data only can run away
        with np.errstate(over="ignore", invalid="ignore"):
            return dictionary(q, qdot, forces, select) @ xi[select]

    return acceleration


def _expression(dictionary: Dictionary, xi: np.ndarray) -> str:
    lines = []
    for name, column in zip(dictionary.coordinates, xi.T, strict=True):
        terms = [f"{column[k]:+.6g}*{dictionary.names[k]}" for k in np.flatnonzero(column)]
        lines.append(f"{name}_dot_dot = {' '.join(terms) or '0'}")
    return "\n".join(lines)


# ---------------------------------------------------- candidate functions of (q, q̇, f) for the accelerations
class Dictionary:
    """Products of harmonics of the angles and monomials of everything else.

    Harmonics are 1, cos(n·θ) and sin(n·θ) for whole numbers n with Σ|nᵢ| ≤ ``max_harmonic``, so that
    differences of angles are among them.  Monomials are those of the other coordinates and the velocities up
    to ``max_degree``, quadratic in the velocities at most, and each force alone.

    Parameters
    ----------
    coordinates, angles : sequence of str
    forced : bool
        Whether forces act.
    max_harmonic, max_degree : int
    """

    def __init__(
        self,
        coordinates: Sequence[str],
        angles: Sequence[str],
        forced: bool,
        max_harmonic: int,
        max_degree: int,
    ) -> None:
        self.coordinates = tuple(coordinates)
        self._angles = [i for i, c in enumerate(coordinates) if c in angles]
        others = [i for i in range(len(coordinates)) if i not in self._angles]
        self._waves = _whole_numbers(len(self._angles), max_harmonic)
        n = len(coordinates)
        # places in (q, q̇, f)
        rates = [n + i for i in range(n)]
        self._monomials: list[tuple[int, ...]] = []
        for fast in (w for k in range(3) for w in combinations_with_replacement(rates, k)):
            for k in range(max(max_degree - len(fast), 0) + 1):
                self._monomials += [(*m, *fast) for m in combinations_with_replacement(others, k)]
        if forced:
            self._monomials += [(2 * n + i,) for i in range(n)]
        n_harmonics = 1 + 2 * len(self._waves)
        self._pairs = np.array(list(product(range(n_harmonics), range(len(self._monomials)))))
        self.names = tuple(self._name(h, m) for h, m in self._pairs)

    def __len__(self) -> int:
        return len(self._pairs)

    def __call__(self, q, qdot, forces=None, select: np.ndarray | None = None) -> np.ndarray:
        """Values of the selected candidates, (n_times, n_selected)."""
        pairs = self._pairs if select is None else self._pairs[select]
        state = [*np.transpose(q), *np.transpose(qdot)]
        state += [*np.transpose(np.zeros_like(qdot) if forces is None else forces)]
        phases = [sum(n * state[i] for n, i in zip(w, self._angles, strict=True)) for w in self._waves]
        one = np.ones(len(q))
        harmonics = [one, *(f(phase) for phase in phases for f in (np.cos, np.sin))]
        used = dict.fromkeys(pairs[:, 1].tolist(), one)
        for m in used:
            for place in self._monomials[m]:
                used[m] = used[m] * state[place]
        out = np.empty((len(q), len(pairs)), order="F")
        for column, (h, m) in enumerate(pairs):
            np.multiply(harmonics[h], used[m], out=out[:, column])
        return out

    def _name(self, harmonic: int, monomial: int) -> str:
        names = [*self.coordinates, *(f"{c}_dot" for c in self.coordinates)]
        names += [f"f_{c}" for c in self.coordinates]
        factors = [names[place] for place in self._monomials[monomial]]
        if harmonic:
            wave = self._waves[(harmonic - 1) // 2]
            terms = [f"{n:+d}*{names[i]}" for n, i in zip(wave, self._angles, strict=True) if n]
            phase = "".join(terms).replace("1*", "").removeprefix("+")
            factors.append(f"{'cos' if harmonic % 2 else 'sin'}({phase})")
        return "*".join(factors) or "1"


def _whole_numbers(n: int, limit: int) -> list[tuple[int, ...]]:
    """Tuples with sum of absolute values from 1 to limit, one of each pair ±w."""
    every = product(range(-limit, limit + 1), repeat=n)
    return [w for w in every if 0 < sum(map(abs, w)) <= limit and next(k for k in w if k) > 0]
