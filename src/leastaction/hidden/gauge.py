"""Changes of a hidden coordinate that the data cannot detect.

A change q_h → Q(q) of a hidden coordinate h does not affect the measured motion. If the candidates can
express the new law, the data cannot distinguish the two. Continuous changes δq_h = g(q) are tested by
their generators

    δφ = (∂φ/∂q_h) g + (∂φ/∂q̇_h) ġ,      g = 1, q_h, or a measured coordinate:

A change is undetectable if the equations of Σ_k λ_k δφ_k are a linear combination of those of the free terms
and, without known forces, of Σ_k λ_k φ_k itself, because L then describes the same motion on any scale.
Two discrete changes, the reflection q_h → −q_h and half a turn q_h → q_h + π, are tested term by term.

Where the zero of q_h is open, the law can be written about any: q_h = q_h' + c has coefficients λ'(c). The
zero at which most of them vanish gives the law of fewest terms. Half way to the half turn, sines take the
place of cosines; of two laws with as many terms we choose the one with more terms that a mirror leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import sympy as sp

from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Problem
from leastaction.library import Term
from leastaction.mechanics import Points
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["Reflection", "Rewritten", "canonical", "open_changes", "reflections", "simplest_zero"]

_STATES = 200  # along the motion, at which equations are compared
_MATTERS = 0.2  # of the largest coefficient of the same kind
_ZEROS = 72  # shifts that are compared; between them the coefficients are interpolated
_VANISHES = 0.05  # of the largest value of a coefficient over all zeros
_REACH = 3.0  # of the spread of a hidden length: its zero is looked for up to here
_TINY = 1e-300  # added to divisors that may vanish
_EXACT = 1e-7  # relative residual by rounding of equations that are a linear combination of others

OFFSET, SCALE, MIXING = "offset", "scale", "mixing"
SIGN, HALF_TURN = "sign", "half a turn"


@dataclass(frozen=True, eq=False)
class Reflection:
    """A discrete change of a hidden coordinate that maps a law to one with the same terms.

    Attributes
    ----------
    coordinate : int
    kind : {"sign", "half a turn"}
    signs : (n_candidates,) array
        Factor of each coefficient: 1, -1, or NaN for a candidate that becomes one outside the library.
    """

    coordinate: int
    kind: str
    signs: np.ndarray

    def moved(self, values: np.ndarray) -> np.ndarray:
        """The hidden coordinate after the change."""
        return -values if self.kind == SIGN else values + np.pi


def reflections(problem: Problem, members: Sequence[int]) -> list[Reflection]:
    """Discrete changes that map the known terms and the terms of a structure to themselves."""
    held = [*members, *np.flatnonzero(np.nan_to_num(problem.known)).tolist()]
    out: list[Reflection] = []
    for i in problem.hidden:
        for kind in (SIGN, HALF_TURN):
            if kind == HALF_TURN and problem.coordinates[i] not in problem.candidates.turning:
                continue
            if kind == SIGN and _pushed(problem, i):
                continue
            signs = np.array([_sign(term, problem.coordinates[i], kind) for term in problem.terms])
            known = np.flatnonzero(problem.is_known & (problem.known != 0.0))
            if np.isfinite(signs[held]).all() and np.all(signs[known] == 1.0):
                out.append(Reflection(i, kind, signs))
    return out


def canonical(problem: Problem, members: Sequence[int], coefficients: np.ndarray) -> list[Reflection]:
    """Changes that make positive the first coefficient that is large enough and whose sign they change."""
    out: list[Reflection] = []
    for change in reflections(problem, members):
        moved = [k for k in sorted(members) if change.signs[k] == -1.0 and coefficients[k] != 0.0]
        kinetic = [k for k in moved if _is_kinetic(problem, k)] or moved
        if not kinetic:
            continue
        largest = max(abs(coefficients[k]) for k in kinetic)
        first = next(k for k in kinetic if abs(coefficients[k]) > _MATTERS * largest)
        if coefficients[first] < 0.0:
            out.append(change)
            coefficients = coefficients * np.where(change.signs == -1.0, -1.0, 1.0)
    return out


def _is_kinetic(problem: Problem, k: int) -> bool:
    """Whether a term of L holds a velocity."""
    names = {symbol.name for symbol in problem.terms[k].expr.free_symbols}
    return problem.terms[k].kind == "lagrangian" and any(name.endswith("_dot") for name in names)


def open_changes(fit: Fit) -> dict[str, tuple[str, ...]]:
    """Hidden coordinate → kinds of continuous changes that cannot be detected with these candidates."""
    problem = fit.problem
    names = problem.coordinates
    out: dict[str, tuple[str, ...]] = {}
    points = _states_about(fit)
    for i in problem.hidden:
        q = sp.Symbol(names[i], real=True)
        generators: list[tuple[str, sp.Expr]] = [(OFFSET, sp.S.One)]
        if not _pushed(problem, i):
            generators.append((SCALE, q))
            others = [names[k] for k in range(len(names)) if k != i]
            generators += [(f"{MIXING} with {other}", sp.Symbol(other, real=True)) for other in others]
        found = tuple(kind for kind, g in generators if _is_open(fit, names[i], g, points))
        if found:
            out[names[i]] = found
    return out


def _pushed(problem: Problem, coordinate: int) -> bool:
    """Whether a known force acts on a coordinate."""
    data = problem.trajectories
    return any(t.forces is not None and bool(np.any(t.forces[:, coordinate])) for t in data)


def _sign(term: Term, name: str, kind: str) -> float:
    """Factor of a term under a discrete change; NaN if it becomes another term."""
    q, rate = sp.Symbol(name, real=True), sp.Symbol(f"{name}_dot", real=True)
    if not term.expr.free_symbols & {q, rate}:
        return 1.0
    swap = {q: -q, rate: -rate} if kind == SIGN else {q: q + sp.pi}
    changed = term.expr.xreplace(swap)
    for sign in (1, -1):
        if sp.expand(sp.expand_trig(changed - sign * term.expr)) == 0:
            return float(sign)
    return np.nan


def _is_open(fit: Fit, name: str, generator: sp.Expr, points: Points) -> bool:
    """Whether a continuous change gives another law with the same free terms; symmetries do not count."""
    problem, members = fit.problem, list(fit.structure)
    held = [*members, *np.flatnonzero(problem.is_known).tolist()]
    change = _variation(name, generator, problem.coordinates)
    places = {k: column for column, k in enumerate(members)}
    varied: list[np.ndarray] = []
    allowed: list[np.ndarray] = []
    for kind in ("lagrangian", "dissipation"):
        own = [k for k in held if problem.terms[k].kind == kind]
        if not own:
            continue
        values, found = problem.candidates.strong(points, own).reshape(len(own), -1), fit.coefficients[own]
        whole = np.sqrt(np.mean((np.abs(found) @ np.abs(values)) ** 2)) + _TINY
        columns = np.zeros((values.shape[1], len(members) + 1))
        for k, value in zip(own, values, strict=True):
            if k in places:
                columns[:, places[k]] = value
        if not problem.trajectories.driven:  # without forces, all coefficients together have any scale
            columns[:, -1] = found @ values
        expression = sp.Add(
            *(sp.Float(float(c)) * change(problem.terms[k].expr) for k, c in zip(own, found, strict=True))
        )
        law = EulerLagrange([Term("change", expression, kind)], problem.coordinates, problem.prescribed)
        varied.append(law.strong(points).ravel() / whole)
        allowed.append(columns / whole)
    target, matrix = np.concatenate(varied), np.concatenate(allowed)
    matrix = matrix / (np.sqrt(np.mean(matrix**2, axis=0)) + _TINY)
    left = target - matrix @ np.linalg.lstsq(matrix, target, rcond=1e-10)[0]
    symmetric, possible = (np.sqrt(np.mean(part**2)) <= _EXACT for part in (target, left))
    return bool(possible and not symmetric)


def _variation(name: str, generator: sp.Expr, names: Sequence[str]) -> Callable[[sp.Expr], sp.Expr]:
    """φ → (∂φ/∂q_h) g + (∂φ/∂q̇_h) ġ."""
    q, rate = sp.Symbol(name, real=True), sp.Symbol(f"{name}_dot", real=True)
    pairs = [(sp.Symbol(n, real=True), sp.Symbol(f"{n}_dot", real=True)) for n in names]
    along = sp.Add(*(sp.diff(generator, x) * v for x, v in pairs))
    return lambda expr: sp.diff(expr, q) * generator + sp.diff(expr, rate) * along


def _states_about(fit: Fit) -> Points:
    """Random states of the size of the motion, with independent components."""
    rng = np.random.default_rng(0)
    n = fit.problem.trajectories.n_dof
    along = np.array(fit.points(_STATES).columns).reshape(3, n, -1)
    parts = [rng.permuted(block, axis=1).T for block in along]
    return Points(parts[0], parts[1], parts[2], np.zeros(along.shape[2]))


class Rewritten(NamedTuple):
    """A law about another zero of a hidden coordinate.

    Attributes
    ----------
    shift : float
        The new zero, in the old coordinate.
    coefficients : (n_candidates,) array
    members : tuple of int
        Free candidates whose coefficients do not vanish.
    """

    shift: float
    coefficients: np.ndarray
    members: tuple[int, ...]


def simplest_zero(fit: Fit, coordinate: int) -> Rewritten | None:
    """The law about the zero of a hidden coordinate with which it has fewest terms.

    None if the candidates cannot write it about other zeros, or if none has fewer terms.
    """
    problem, known = fit.problem, np.nan_to_num(fit.problem.known)
    shifts, found, sizes = _about_zeros(fit, coordinate)
    if not found.size:
        return None
    largest = np.abs(found).max(axis=0)
    matters = largest * sizes > _EXACT * (largest * sizes).max()
    laws: list[Rewritten] = []
    for k in np.flatnonzero(matters):
        for n in np.flatnonzero(found[:-1, k] * found[1:, k] < 0.0):
            there = found[n, k] / (found[n, k] - found[n + 1, k])
            values = found[n] + there * (found[n + 1] - found[n])
            kept = matters & (np.abs(values) > _VANISHES * largest)
            coefficients = known.copy()
            coefficients[problem.free[kept]] = values[kept]
            shift = float(shifts[n] + there * (shifts[n + 1] - shifts[n]))
            laws.append(Rewritten(shift, coefficients, tuple(problem.free[kept].tolist())))
    laws = [law for law in laws if len(law.members) < len(fit.structure)]

    mirrored = [_is_mirrored(term, problem.coordinates) for term in problem.terms]

    def length(law: Rewritten) -> tuple[int, int, int]:
        signs = len(canonical(problem, law.members, law.coefficients))
        return len(law.members), sum(not mirrored[k] for k in law.members), signs

    return min(laws, key=length, default=None)


def _is_mirrored(term: Term, names: Sequence[str]) -> bool:
    """Whether a term stays as it is where all coordinates change their signs, as a cosine does."""
    swap = {s: -s for n in names for s in (sp.Symbol(n, real=True), sp.Symbol(f"{n}_dot", real=True))}
    return sp.expand(term.expr.xreplace(swap) - term.expr) == 0


def _about_zeros(fit: Fit, coordinate: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shifts; (n_shifts, n_free) coefficients of the law after them; (n_free,) root mean square of each term.

    No coefficients where the candidates cannot write the shifted law.
    """
    problem, points = fit.problem, _states_about(fit)
    free, known = problem.free, np.nan_to_num(problem.known)
    if problem.coordinates[coordinate] in problem.candidates.turning:
        shifts = np.linspace(-np.pi, np.pi, _ZEROS + 1)
    else:
        spread = float(np.mean([curve[:, coordinate].std() for curve in fit.curves()]))
        shifts = spread * np.linspace(-_REACH, _REACH, _ZEROS + 1)
    columns = problem.candidates.strong(points).reshape(len(problem.candidates), -1)
    sizes = np.sqrt((columns[free] ** 2).mean(axis=1)) + 1e-300
    solve = np.linalg.pinv((columns[free] / sizes[:, None]).T, rcond=1e-10) / sizes[:, None]
    laws = np.array([_law_about(fit, points, coordinate, shift) for shift in shifts])
    moved = laws - known @ columns
    found = moved @ solve.T
    left = np.sqrt(np.mean((moved - found @ columns[free]) ** 2))
    if not left <= _EXACT * np.sqrt(np.mean(laws**2)):
        return shifts, np.zeros((0, len(free))), sizes
    return shifts, found, sizes


def _law_about(fit: Fit, points: Points, coordinate: int, shift: float) -> np.ndarray:
    """The equations of the law with the coordinate shifted."""
    q, qdot, qddot = (part.T.copy() for part in np.array(points.columns).reshape(3, points.n_dof, -1))
    q[:, coordinate] += shift
    strong = fit.problem.candidates.strong(Points(q, qdot, qddot, np.zeros(len(q))))
    return np.tensordot(fit.coefficients, strong, 1).ravel()
