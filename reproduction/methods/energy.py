"""Lagrangian-SINDy: the Lagrangian from the balance of energy.

Reference: H. K. Chu, M. Hayashibe, "Discovering interpretable dynamics by sparsity promotion on energy and
the Lagrangian", IEEE Robotics and Automation Letters 5, 2154-2160 (2020).

There, the time derivative of a sparse sum of candidate energies equals the power of the known forces, or
zero; terms that are known to occur are kept, combinations of further ones are tried until the residual
vanishes, and L follows from the energy found.  Here the same is done with the candidates φ_k of L, whose
energies are E_k = q̇·∂φ_k/∂q̇ − φ_k, so that the last step is not needed:

    Σ_k λ_k E_k(q, q̇) = constant of the motion + ∫ f·q̇ dt.

Chosen in its favour:

* The balance is integrated over time, with one constant for each trajectory, so that no accelerations are
  needed (there they are given, with a noise of some 1e-9).  q and q̇ are smoothing splines of the measured
  positions.
* Combinations are grown by one term at a time, the best `WIDTH` of each size being kept, and pruned by one
  term at a time from the whole library; to try all of them, as there, would take too long.
* Residuals of noisy data do not vanish.  The number of terms is chosen by leaving out each trajectory in
  turn: each term has to lower the mean squared residual by `WORTH_ONE`, and together they may give away
  `WORTH_ALL` of what the best size explains.

Energy does not see everything: terms linear in q̇ have none and cannot be found.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
import sympy as sp
from scipy.integrate import cumulative_simpson

import leastaction as la
from reproduction.problem import Answer, Problem, acceleration_of

TITLE = "Lagrangian-SINDy (energy)"
REFERENCE = "Chu & Hayashibe 2020, IEEE RA-L 5(2):2154-2160"

WIDTH = 50
MAX_SIZE = 12
WORTH_ONE, WORTH_ALL = 0.15, 0.05
EXACT = 1e-8  # relative mean squared residual that counts as none


def solve(problem: Problem) -> Answer:
    texts, pieces, scale = _balances(problem)
    normals = [Normal.of(columns, target) for columns, target in pieces]
    size, misfits = _choose_size(normals)
    whole = reduce(add, normals)
    support = best_supports(whole, size, WIDTH)[-1]
    values = scale * whole.solve(support)
    coefficients = {texts[k]: float(values[k]) for k in support}
    return Answer(
        coefficients=coefficients,
        acceleration=acceleration_of(problem.library, {**problem.known, **coefficients}),
        settings={
            "width": WIDTH,
            "max_size": MAX_SIZE,
            "worth_one": WORTH_ONE,
            "worth_all": WORTH_ALL,
            "held_out_misfit_by_size": misfits.tolist(),
        },
    )


def _energies(library: la.Library) -> list:
    """Functions of (*q, *q̇): q̇·∂φ/∂q̇ − φ of each term."""
    names = (*library.coordinates, *library.velocities)
    symbols = [sp.Symbol(name, real=True) for name in names]
    rates = symbols[library.n_dof :]
    energies = [sum(v * sp.diff(term.expr, v) for v in rates) - term.expr for term in library.terms]
    return [sp.lambdify(symbols, energy, "numpy", dummify=True) for energy in energies]


def _balances(problem: Problem) -> tuple[list[str], list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """Free terms; energies (n_times, n_terms) and target of each piece, in units of their root mean
    squares; what turns their coefficients into those of L.
    """
    functions = _energies(problem.library)
    texts = [term.text for term in problem.library.terms]
    energies, targets = [], []
    for motion, measured in zip(la.smooth(problem.data), problem.data, strict=True):
        state = [*motion.q.T, *motion.qdot.T]
        columns = np.stack([np.broadcast_to(f(*state), motion.t.shape) for f in functions], axis=1)
        target = -sum(value * columns[:, texts.index(text)] for text, value in problem.known.items())
        if measured.forces is not None:
            power = np.sum(measured.forces * motion.qdot, axis=1)
            target = target + cumulative_simpson(power, x=motion.t, initial=0.0)
        parts = [slice(None)] if len(problem.data) > 1 else np.array_split(np.arange(len(target)), 5)
        energies += [columns[part] - columns[part].mean(axis=0) for part in parts]
        targets += [target[part] - target[part].mean() for part in parts]
    rms = np.sqrt(np.mean(np.concatenate(energies) ** 2, axis=0))
    unit = np.sqrt(np.mean(np.concatenate(targets) ** 2))
    # a term without energy leaves rounding errors
    free = [k for k, t in enumerate(texts) if t not in problem.known and rms[k] > 1e-12 * rms.max()]
    pieces = [(e[:, free] / rms[free], y / unit) for e, y in zip(energies, targets, strict=True)]
    return [texts[k] for k in free], pieces, unit / rms[free]


def _choose_size(normals: list[Normal]) -> tuple[int, np.ndarray]:
    """Return the number of terms, and the mean held-out misfit of each size."""
    folds = []
    for k, judge in enumerate(normals):
        rest = reduce(add, normals[:k] + normals[k + 1 :])
        folds.append([judge.misfit(rest.solve(support)) for support in best_supports(rest, MAX_SIZE, WIDTH)])
    misfits = np.mean(folds, axis=0)
    good = misfits <= misfits.min() + WORTH_ALL * max(1.0 - misfits.min(), 0.0)
    price = np.log(np.maximum(misfits, 0.0) + EXACT) + np.log1p(WORTH_ONE) * np.arange(len(misfits))
    return int(np.argmin(np.where(good, price, np.inf))) + 1, misfits


# --------------------------------- best supports of a linear least-squares problem, from its normal equations
_RIDGE = 1e-13  # relative; keeps nearly singular supports solvable
_AT_ONCE = 4096  # supports solved in one go


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of ``columns @ x = target``; those of several data sets can be added.

    Attributes
    ----------
    gram : (n, n) array
    moment : (n,) array
        ``columns.T @ target``.
    square : float
        ``target @ target``.
    """

    gram: np.ndarray
    moment: np.ndarray
    square: float

    @classmethod
    def of(cls, columns: np.ndarray, target: np.ndarray) -> Normal:
        return cls(columns.T @ columns, columns.T @ target, float(target @ target))

    def __add__(self, other: Normal) -> Normal:
        return Normal(self.gram + other.gram, self.moment + other.moment, self.square + other.square)

    def misfit(self, x: np.ndarray) -> float:
        """Squared residual as a share of the squared target."""
        return float((self.square - 2.0 * x @ self.moment + x @ self.gram @ x) / self.square)

    def solve(self, support: tuple[int, ...]) -> np.ndarray:
        """Least-squares x that is zero outside the support."""
        x = np.zeros(len(self.moment))
        x[list(support)] = self._solutions(np.array([support]))[0]
        return x

    def gains(self, supports: np.ndarray) -> np.ndarray:
        """By how much each row of supports, (n_supports, size), lowers the squared residual."""
        parts = [supports[k : k + _AT_ONCE] for k in range(0, len(supports), _AT_ONCE)]
        return np.concatenate([np.sum(self._solutions(p) * self.moment[p], axis=1) for p in parts])

    def _solutions(self, supports: np.ndarray) -> np.ndarray:
        gram = self.gram[supports[:, :, None], supports[:, None, :]]
        diagonal = np.arange(supports.shape[1])
        gram[:, diagonal, diagonal] *= 1.0 + _RIDGE
        return np.linalg.solve(gram, self.moment[supports][..., None])[..., 0]


def best_supports(normal: Normal, max_size: int, width: int) -> list[tuple[int, ...]]:
    """Search the best support of each size from 1 on: the better of growing and of pruning.

    Parameters
    ----------
    normal : Normal
    max_size : int
    width : int
        How many supports of each size are kept to add a term to.
    """
    pairs = zip(_grown(normal, max_size, width), _pruned(normal)[:max_size], strict=True)
    return [max(pair, key=lambda support: normal.gains(np.array([support]))[0]) for pair in pairs]


def _grown(normal: Normal, max_size: int, width: int) -> list[tuple[int, ...]]:
    n_terms = len(normal.moment)
    beam: list[tuple[int, ...]] = [()]
    best = []
    for _ in range(min(max_size, n_terms)):
        children = {tuple(sorted((*s, k))) for s in beam for k in range(n_terms) if k not in s}
        supports = np.array(sorted(children))
        ranked = np.argsort(-normal.gains(supports), kind="stable")[:width]
        beam = [tuple(int(k) for k in supports[r]) for r in ranked]
        best.append(beam[0])
    return best


def _pruned(normal: Normal) -> list[tuple[int, ...]]:
    """From all terms down to one; the smallest comes first."""
    support = tuple(range(len(normal.moment)))
    path = [support]
    while len(support) > 1:
        children = np.array([[k for k in support if k != out] for out in support])
        support = tuple(int(k) for k in children[np.argmax(normal.gains(children))])
        path.append(support)
    return path[::-1]
