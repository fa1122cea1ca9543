"""Random start values of coefficients and hidden states.

A coefficient is drawn about the size at which its term balances the known terms and forces, with a random
sign. Half of the draws take the signs that a regression without the hidden coordinates gives to the terms
without these. If there are many terms, most start near zero. Hidden angles start anywhere on the circle. The
scales of hidden lengths and rates are those of measured coordinates of the same kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leastaction.estimation.problem import Problem
from leastaction.hidden.settings import HIDDEN
from leastaction.hidden.windows import Windows
from leastaction.mechanics import Points

__all__ = [
    "Scales",
    "draw_begins",
    "draw_coefficients",
    "has_negative_mass",
    "scales_of",
    "signs_without",
    "term_sizes",
]

_POINTS = 64  # states at which terms are compared
_TRIED = 4000  # draws, of which those with a positive mass matrix stay
_POSITIVE = 1e-3  # smallest eigenvalue of a scaled mass matrix
_NOTHING = 1e-300  # added to a divisor that may vanish


@dataclass(frozen=True, eq=False)
class Scales:
    """Sizes of a motion.

    Attributes
    ----------
    q, qdot, qddot : (n_dof,) arrays
    angular : (n_dof,) bool array
        Coordinates that are angles: hidden ones begin anywhere on the circle.
    cyclic : (n_dof,) bool array
        Coordinates that enter only by their rate, so that their zero is arbitrary.
    """

    q: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    angular: np.ndarray
    cyclic: np.ndarray

    @property
    def unit(self) -> np.ndarray:
        """(2 n_dof,) of coordinates, then of rates."""
        return np.concatenate([self.q, self.qdot])


def scales_of(problem: Problem, windows: Windows, period: float) -> Scales:
    """Scales of measured coordinates from the data; hidden ones are assumed to have similar scales."""
    names, measured = problem.coordinates, list(windows.measured)
    angular = np.array([name in {*problem.candidates.turning, *problem.angles} for name in names])
    used = {symbol.name for term in problem.terms for symbol in term.expr.free_symbols}
    cyclic = np.array([name not in used for name in names])
    q, qdot = windows.q.reshape(-1, len(names)), windows.qdot.reshape(-1, len(names))
    size, rate = np.ones(len(names)), np.ones(len(names))
    size[measured], rate[measured] = (
        q[:, measured].std(axis=0),
        np.sqrt((qdot[:, measured] ** 2).mean(axis=0)),
    )
    frequency = 2.0 * np.pi / period
    for i in windows.hidden:
        alike = [k for k in measured if angular[k] == angular[i]]
        placed = [k for k in alike if not cyclic[k]]  # the others may turn many times
        size[i] = size[placed].mean() if placed else 1.0
        rate[i] = rate[alike].mean() if alike else frequency * size[i]
    return Scales(size, rate, frequency * rate, angular, cyclic)


def term_sizes(problem: Problem, windows: Windows, scales: Scales, rng: np.random.Generator) -> np.ndarray:
    """(n_candidates,) coefficients at which each term balances known terms and forces.

    At resonance, forces are a small part of the terms: the middle of that range counts.
    """
    points = _states(windows, scales, rng)
    strong = problem.candidates.strong(points)
    size = np.sqrt((strong**2).mean(axis=(1, 2)))
    known = np.nan_to_num(problem.known) @ strong.reshape(len(strong), -1)
    total = np.sqrt((known**2).mean())
    if windows.forces is not None:
        forces = float(np.sqrt((windows.forces**2).mean()))
        total = max(total, np.sqrt(HIDDEN.over_forces) * forces)
    usable = np.isfinite(size) & (size > 0.0)
    return np.divide(total, size, out=np.ones(size.size), where=usable)


def signs_without(problem: Problem, members: list[int], windows: Windows) -> np.ndarray:
    """(n_members,) signs of the terms without hidden coordinates by least squares; 0 for other terms.

    The equations of the measured coordinates are fitted along the windows as if the other terms were absent.
    The sizes are far off, but the signs are mostly right.
    """
    unseen = {f"{problem.coordinates[i]}{rate}" for i in windows.hidden for rate in ("", "_dot")}
    signs = np.zeros(len(members))
    own = [not unseen & {s.name for s in problem.terms[k].expr.free_symbols} for k in members]
    rows = [i for i in windows.measured if i not in problem.prescribed]
    if not (rows and any(own)):
        return signs
    n = problem.trajectories.n_dof
    times = (windows.begin[:, None] + windows.nodes).ravel()
    qddot = np.gradient(windows.qdot, windows.nodes, axis=1)
    q, qdot, qddot = (part.reshape(-1, n) for part in (windows.q, windows.qdot, qddot))
    points = Points(q, qdot, qddot, times)
    strong = problem.candidates.strong(points)[:, rows]
    given = -np.einsum("k,kip->ip", np.nan_to_num(problem.known), strong)
    if windows.forces is not None:
        given = given + windows.forces[::2].transpose(2, 1, 0).reshape(n, -1)[rows]
    columns = strong[[k for k, free in zip(members, own, strict=True) if free]]
    scale = np.sqrt((columns**2).mean(axis=(0, 2)) + (given**2).mean(axis=1))[:, None] + _NOTHING
    columns, given = (columns / scale).reshape(len(columns), -1), (given / scale).ravel()
    if np.isfinite(columns).all() and np.isfinite(given).all():
        signs[own] = np.sign(np.linalg.lstsq(columns.T, given, rcond=None)[0])
    return signs


def draw_coefficients(
    problem: Problem,
    members: list[int],
    sizes: np.ndarray,
    signs: np.ndarray,
    windows: Windows,
    scales: Scales,
    rng: np.random.Generator,
) -> np.ndarray:
    """(n_sets, n_members) coefficients whose mass matrix is positive definite at drawn states.

    If there are many terms, most start near zero. Every second draw has the signs of ``signs`` where these
    are not zero.
    """
    shape = (_TRIED, len(members))
    drawn = sizes * np.exp(HIDDEN.spread * rng.standard_normal(shape)) * rng.choice([-1.0, 1.0], shape)
    drawn[::2] = np.where(signs, signs * np.abs(drawn[::2]), drawn[::2])
    passive = rng.random(shape) >= HIDDEN.active / len(members)
    drawn *= np.where(passive, HIDDEN.near_zero, 1.0)
    if windows.forces is not None:
        drawn *= HIDDEN.over_forces ** rng.uniform(-0.5, 0.5, (_TRIED, 1))
    points = _states(windows, scales, rng)
    known = problem.candidates.mass_matrix(points, np.nan_to_num(problem.known))
    moving, masses = problem.candidates.subset(members).masses(points)
    unit = np.sqrt(np.outer(scales.qdot, scales.qdot))
    mass = known + np.einsum("sk,pkij->spij", drawn[:, moving], masses)
    lowest = np.linalg.eigvalsh(mass * unit)
    good = np.all(lowest[..., 0] > _POSITIVE * lowest[..., -1], axis=1)
    order = np.argsort(~good, kind="stable")
    return drawn[order[: HIDDEN.stages[0][2]]]


def has_negative_mass(
    problem: Problem, coefficients: np.ndarray, windows: Windows, scales: Scales, rng: np.random.Generator
) -> bool:
    """Whether the mean kinetic energy of drawn states is negative; all candidates have coefficients."""
    points = _states(windows, scales, rng)
    mass = problem.candidates.mass_matrix(points, coefficients)
    qdot = np.array(points.columns).reshape(3, scales.q.size, -1)[1]
    return float(np.einsum("ip,pij,jp->", qdot, mass, qdot)) < 0.0


def draw_begins(scales: Scales, hidden: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """(n_starts, 2 n_hidden) hidden coordinates and rates, on a grid, or drawn if the grid is too large.

    The grid of an angle has a random offset.
    """
    axes: list[np.ndarray] = []
    for i in hidden:
        if scales.cyclic[i]:
            axes.append(np.zeros(1))
        elif scales.angular[i]:
            axes.append(np.pi * (2.0 * (np.arange(HIDDEN.angles) + rng.random()) / HIDDEN.angles - 1.0))
        else:
            axes.append(scales.q[i] * np.linspace(-2.0, 2.0, HIDDEN.lengths))
    axes += [scales.qdot[i] * np.linspace(-2.0, 2.0, HIDDEN.rates) for i in hidden]
    if np.prod([axis.size for axis in axes]) <= HIDDEN.most_starts:
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    return np.stack([rng.choice(axis, HIDDEN.most_starts) for axis in axes], axis=-1)


def _states(windows: Windows, scales: Scales, rng: np.random.Generator) -> Points:
    """States along the measured motion, with hidden coordinates drawn."""
    n = scales.q.size
    q, qdot = windows.q.reshape(-1, n), windows.qdot.reshape(-1, n)
    rows = rng.choice(len(q), _POINTS)
    hidden = list(windows.hidden)
    q, qdot, qddot = q[rows].copy(), qdot[rows].copy(), scales.qddot * rng.standard_normal((_POINTS, n))
    for i in hidden:
        q[:, i] = (
            rng.uniform(-np.pi, np.pi, _POINTS)
            if scales.angular[i]
            else (scales.q[i] * rng.standard_normal(_POINTS))
        )
        qdot[:, i] = scales.qdot[i] * rng.standard_normal(_POINTS)
    return Points(q, qdot, qddot, windows.begin[rng.integers(len(windows), size=_POINTS)])
