"""Changes of a hidden coordinate that the data cannot detect.

A change q_h → Q(q) of a hidden coordinate h does not affect the measured motion. If the candidates can
express the new law, the data cannot distinguish the two. Continuous changes δq_h = g(q) are tested by
their generators

    δφ = (∂φ/∂q_h) g + (∂φ/∂q̇_h) ġ,      g = 1, q_h, or a measured coordinate:

A change is undetectable if the equations of Σ_k λ_k δφ_k are a linear combination of those of the free terms
and, without known forces, of Σ_k λ_k φ_k itself, because L then describes the same motion on any scale. If
known forces act on q_h alone, L(q_h) → s L(q_h / s) keeps them: then Σ_k λ_k (φ_k − δφ_k) is tested.
Three discrete changes, q_h → −q_h, q_h → q_h + π and q_h → π − q_h, are tested term by term.

A law may have a simpler form in another choice of the coordinate, q_h = s Q + c f(q) with s = ±1 and f = 1,
or a measured coordinate, or its sine or cosine. The equations of the new law follow from the old ones,

    E'_h = s E_h,      E'_i = E_i + c (∂f/∂q_i) E_h,

and its coefficients λ'(c) from a regression. The law of fewest terms is that in which most of them vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
import sympy as sp
from scipy.optimize import minimize_scalar

from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Problem, Structure
from leastaction.library import Term
from leastaction.mechanics import Points
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["Reflection", "canonical", "open_changes", "open_scales", "reflections", "simpler_forms"]

_MATTERS = 0.2  # of the largest coefficient of the same kind
_STATES = 200  # along the motion, at which equations are compared
_ZEROS = 72  # changes that are compared; between them the coefficients are interpolated
_VANISHES = 0.05  # of the largest value of a coefficient over all changes
_REACH = 3.0  # of the spread of a hidden length about its mean: changes are looked for up to here
_TINY = 1e-300  # added to divisors that may vanish
_WRITTEN = 1e-5  # share of a law that candidates may not write, after a search for the amount of the change
_EXACT = 1e-7  # relative residual by rounding of equations that are a linear combination of others

OFFSET, SCALE, MIXING = "offset", "scale", "mixing"
SIGN, HALF_TURN, BOTH = "sign", "half a turn", "sign and half a turn"


@dataclass(frozen=True, eq=False)
class Reflection:
    """A discrete change of a hidden coordinate that maps a law to one with the same terms.

    Attributes
    ----------
    coordinate : int
    kind : {"sign", "half a turn", "sign and half a turn"}
    signs : (n_candidates,) array
        Factor of each coefficient: 1, -1, or NaN for a candidate that becomes one outside the library.
    """

    coordinate: int
    kind: str
    signs: np.ndarray

    def moved(self, values: np.ndarray) -> np.ndarray:
        """The hidden coordinate after the change."""
        turned = values if self.kind == HALF_TURN else -values
        return turned if self.kind == SIGN else turned + np.pi

    def flipped(self, coefficients: np.ndarray) -> np.ndarray:
        """(n_candidates,) coefficients after the change; those of candidates that leave the library stay."""
        return np.where(self.signs == -1.0, -coefficients, coefficients)


def reflections(problem: Problem, members: Sequence[int], *, inverted: bool = False) -> list[Reflection]:
    """Discrete changes that map the known terms and the terms of a structure to themselves.

    ``inverted``: those that do so with −L in place of L, which without forces describes the same motion.
    """
    known = np.flatnonzero(np.nan_to_num(problem.known))
    out: list[Reflection] = []
    if inverted and problem.trajectories.driven:
        return out
    for i in problem.hidden:
        turning, pushed = problem.coordinates[i] in problem.candidates.turning, i in problem.pushed
        for kind in (SIGN, HALF_TURN, BOTH):
            if (kind != SIGN and not turning) or (kind != HALF_TURN and pushed):
                continue
            signs = np.array([_sign(term.expr, problem.coordinates[i], kind) for term in problem.terms])
            signs = -signs if inverted else signs
            if np.isfinite(signs[list(members)]).all() and np.all(signs[known] == 1.0):
                out.append(Reflection(i, kind, signs))
    return out


def canonical(problem: Problem, members: Sequence[int], coefficients: np.ndarray) -> list[Reflection]:
    """Changes that give the coefficients their conventional signs, at most one of each hidden coordinate.

    Kinetic terms are made positive before the others, and earlier ones before later ones. Coefficients much
    smaller than the largest of the same kind do not count.
    """
    found = reflections(problem, members)
    size = np.abs(coefficients)
    flipped = [k for k in sorted(members) if size[k] > 0.0 and any(c.signs[k] == -1.0 for c in found)]
    first: list[int] = []
    for kinetic in (True, False):
        own = [k for k in flipped if _is_kinetic(problem, k) == kinetic]
        first += [k for k in own if size[k] > _MATTERS * size[own].max()]

    def positive(changes: Sequence[Reflection | None]) -> list[bool]:
        signs = [change.signs[first] for change in changes if change is not None]
        return (np.prod([coefficients[first], *signs], axis=0) > 0.0).tolist()

    choices = [[None, *(change for change in found if change.coordinate == i)] for i in problem.hidden]
    best = max(product(*choices), key=positive)  # of equal ones the first, which changes least
    return [change for change in best if change is not None]


def _is_kinetic(problem: Problem, k: int) -> bool:
    """Whether a term of L holds a velocity."""
    names = {symbol.name for symbol in problem.terms[k].expr.free_symbols}
    return problem.terms[k].kind == "lagrangian" and any(name.endswith("_dot") for name in names)


@lru_cache(maxsize=4096)  # a search compares many laws of the same terms
def _sign(expr: sp.Expr, name: str, kind: str) -> float:
    """Factor of a term under a discrete change; NaN if it becomes another term."""
    q, rate = sp.Symbol(name, real=True), sp.Symbol(f"{name}_dot", real=True)
    if not expr.free_symbols & {q, rate}:
        return 1.0
    swaps = {SIGN: {q: -q, rate: -rate}, HALF_TURN: {q: q + sp.pi}, BOTH: {q: sp.pi - q, rate: -rate}}
    changed = expr.xreplace(swaps[kind])
    for sign in (1, -1):
        if sp.expand(sp.expand_trig(changed - sign * expr)) == 0:
            return float(sign)
    return np.nan


def open_changes(fit: Fit) -> dict[str, tuple[str, ...]]:
    """Hidden coordinate → kinds of continuous changes that cannot be detected with these candidates."""
    problem, points = fit.problem, _states_about(fit)
    names, pushed = problem.coordinates, problem.pushed
    out: dict[str, tuple[str, ...]] = {}
    for i in problem.hidden:
        q = sp.Symbol(names[i], real=True)
        generators: list[tuple[str, sp.Expr]] = [(OFFSET, sp.S.One)]
        if i not in pushed or pushed == (i,):
            generators.append((SCALE, q))
        if i not in pushed:
            generators += [(f"{MIXING} with {n}", sp.Symbol(n, real=True)) for n in names if n != names[i]]
        own = i in pushed  # a change of scale is then one of L, too
        found = tuple(k for k, g in generators if _is_open(fit, names[i], g, points, k == SCALE and own))
        if found:
            out[names[i]] = found
    return out


def open_scales(fit: Fit) -> dict[str, tuple[str, ...]]:
    """Hidden coordinates whose scale no law of the candidates fixes."""
    problem = fit.problem
    strong = problem.candidates.strong(_states_about(fit))
    values = problem.completed(1.0 / (np.sqrt((strong**2).mean(axis=(1, 2))) + _TINY))
    changes = open_changes(replace(fit, structure=Structure(problem.free), coefficients=values))
    return {name: (SCALE,) for name, kinds in changes.items() if SCALE in kinds}


def _is_open(fit: Fit, name: str, generator: sp.Expr, points: Points, scaled: bool) -> bool:
    """Whether a continuous change gives another law with the same free terms; symmetries do not count.

    ``scaled``: L and ψ grow with the coordinate, so that a force on it stays as it is.
    """
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
        whole_law = sp.Add(
            *(sp.Float(c) * problem.terms[k].expr for k, c in zip(own, found.tolist(), strict=True))
        )
        varied_law = change(whole_law) - int(scaled) * whole_law
        law = EulerLagrange([Term("change", varied_law, kind)], problem.coordinates, problem.prescribed)
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


class Change(NamedTuple):
    """Another choice of a hidden coordinate: q_h = s Q + c f(q), with f = 1, or of a measured coordinate.

    Attributes
    ----------
    coordinate : int
        The hidden one.
    sign : {1.0, -1.0}
    function : {"1", "q", "sin", "cos"}
    other : int
        The coordinate in f.
    amount : float
    """

    coordinate: int
    sign: float
    function: str
    other: int
    amount: float

    def before(self, q: np.ndarray, qdot: np.ndarray, qddot: np.ndarray) -> Points:
        """The old states of new ones, each (n_points, n_dof)."""
        f, slope, bend = _FUNCTIONS[self.function](q[:, self.other])
        own, other = qdot[:, self.other], qddot[:, self.other]
        parts = [part.copy() for part in (q, qdot, qddot)]
        moved = f, slope * own, slope * other + bend * own**2
        for part, more in zip(parts, moved, strict=True):
            part[:, self.coordinate] = self.sign * part[:, self.coordinate] + self.amount * more
        return Points(parts[0], parts[1], parts[2], np.zeros(len(q)))

    def after(self, q: np.ndarray) -> np.ndarray:
        """The new coordinates of old ones, (n_points, n_dof)."""
        out = q.copy()
        moved = q[:, self.coordinate] - self.amount * _FUNCTIONS[self.function](q[:, self.other])[0]
        out[:, self.coordinate] = self.sign * moved
        return out

    def equations(self, old: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Euler–Lagrange equations in the new coordinates, (n_dof, n_points), from those in the old ones."""
        out = old.copy()
        out[self.other] += self.amount * _FUNCTIONS[self.function](q[:, self.other])[1] * old[self.coordinate]
        out[self.coordinate] = self.sign * old[self.coordinate]
        return out


# f, f′ and f″ of each function
_FUNCTIONS: dict[str, Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]] = {
    "1": lambda q: (np.ones_like(q), np.zeros_like(q), np.zeros_like(q)),
    "q": lambda q: (q, np.ones_like(q), np.zeros_like(q)),
    "sin": lambda q: (np.sin(q), np.cos(q), -np.sin(q)),
    "cos": lambda q: (np.cos(q), -np.sin(q), -np.cos(q)),
}


class Rewritten(NamedTuple):
    """A law in another choice of a hidden coordinate.

    Attributes
    ----------
    change : Change
    coefficients : (n_candidates,) array
    members : tuple of int
        Free candidates whose coefficients do not vanish.
    """

    change: Change
    coefficients: np.ndarray
    members: tuple[int, ...]


def simpler_forms(fit: Fit, coordinate: int) -> list[Rewritten]:
    """The law in other choices of a hidden coordinate that give a simpler form, simplest first.

    A form is simpler if it has fewer terms; of two with as many, the one with more terms that a mirror
    leaves, then the one with terms that come earlier among the candidates.
    """
    problem = fit.problem
    mirrored = [_is_mirrored(term, problem.coordinates) for term in problem.terms]

    def length(members: Sequence[int], coefficients: np.ndarray) -> tuple[int, int, int, int]:
        signs = len(canonical(problem, members, coefficients))
        return len(members), sum(not mirrored[k] for k in members), sum(members), signs

    here = length(list(fit.structure), fit.coefficients)
    found, writer = dict[tuple[int, int, int, int], Rewritten](), _Writer(fit)
    for law in (law for family in _families(fit, coordinate) for law in _forms(writer, family)):
        key = length(law.members, law.coefficients)
        if key < here:
            found.setdefault(key, law)
    return [found[key] for key in sorted(found)]


def _is_mirrored(term: Term, names: Sequence[str]) -> bool:
    """Whether a term stays as it is where all coordinates change their signs, as a cosine does."""
    swap = {s: -s for n in names for s in (sp.Symbol(n, real=True), sp.Symbol(f"{n}_dot", real=True))}
    return sp.expand(term.expr.xreplace(swap) - term.expr) == 0


def _families(fit: Fit, coordinate: int) -> Iterator[list[Change]]:
    """Changes of each kind, by amount."""
    problem, curves = fit.problem, np.concatenate(list(fit.curves()))
    names, turning = problem.coordinates, problem.candidates.turning
    pushed, own = coordinate in problem.pushed, curves[:, coordinate]
    middle, spread = abs(float(own.mean())), _REACH * float(own.std())
    steps = np.linspace(-1.0, 1.0, _ZEROS + 1)
    angle = names[coordinate] in turning
    kinds = [("1", coordinate, np.pi if angle else middle + spread)]
    if not (pushed or angle):
        for i in set(range(len(names))) - {coordinate}:
            for function in ("sin", "cos") if names[i] in turning else ("q",):
                size = float(_FUNCTIONS[function](curves[:, i])[0].std())
                kinds.append((function, i, spread / (size + _TINY)))
    for sign in (1.0,) if pushed else (1.0, -1.0):
        for function, other, reach in kinds:
            yield [Change(coordinate, sign, function, other, float(reach * step)) for step in steps]


class _Writer:
    """A law in the candidates, in other choices of a hidden coordinate."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        points = _states_about(fit)
        self.states = np.array(points.columns).reshape(3, points.n_dof, -1).transpose(0, 2, 1)
        candidates = fit.problem.candidates
        self.columns = candidates.strong(points).reshape(len(candidates), -1)
        self.sizes = np.sqrt((self.columns**2).mean(axis=1)) + _TINY
        scaled = (self.columns / self.sizes[:, None]).T
        self.solve = np.linalg.pinv(scaled, rcond=1e-10) / self.sizes[:, None]

    def law(self, change: Change) -> tuple[np.ndarray, float]:
        """Coefficients of all candidates, and the share of the law that they cannot write."""
        strong = self.fit.problem.candidates.strong(change.before(*self.states))
        new = change.equations(np.tensordot(self.fit.coefficients, strong, 1), self.states[0]).ravel()
        found = self.solve @ new
        return found, float(np.linalg.norm(new - found @ self.columns) / (np.linalg.norm(new) + _TINY))


def _forms(writer: _Writer, family: list[Change]) -> Iterator[Rewritten]:
    """The laws of a family that the candidates can write with the known terms as given.

    If they can write all, those in which another coefficient vanishes. Between two changes, coefficients are
    interpolated to find where one does.
    """
    problem, law, sizes = writer.fit.problem, writer.law, writer.sizes
    laws, left = (np.array(part) for part in zip(*map(law, family), strict=True))
    amounts = np.array([change.amount for change in family])
    largest, known = np.abs(laws).max(axis=0), np.nan_to_num(problem.known)
    matters = largest * sizes > _EXACT * (largest * sizes).max()
    places = [0.0, float(amounts[-1])]  # a change of sign alone, or with half a turn
    if left.max() <= _EXACT:
        varies = np.abs(laws - known).max(axis=0) > _EXACT * largest  # by more than rounding
        off = np.where(matters & varies, laws - known, 0.0)
        for n, k in np.argwhere(off[:-1] * off[1:] < 0.0):
            there = off[n, k] / (off[n, k] - off[n + 1, k])
            places.append(float(amounts[n] + there * (amounts[n + 1] - amounts[n])))
    else:
        for n in np.flatnonzero((left[1:-1] < left[:-2]) & (left[1:-1] < left[2:])):
            about = tuple(amounts[n : n + 3])
            found = minimize_scalar(lambda c: law(family[0]._replace(amount=c))[1], about, tol=_EXACT)
            places.append(float(found.x))
    for amount in sorted(places):
        if family[0].sign > 0.0 and abs(amount) < _VANISHES * amounts[-1] / _ZEROS:
            continue  # nothing changes
        change = family[0]._replace(amount=float(amount))
        coefficients, remains = law(change)
        given = problem.is_known & matters
        off = np.abs(coefficients - known)[given]
        if remains > _WRITTEN or np.any(off > _VANISHES * largest[given]):
            continue
        kept = matters & ~problem.is_known & (np.abs(coefficients) > _VANISHES * largest)
        yield Rewritten(change, np.where(kept, coefficients, known), tuple(np.flatnonzero(kept).tolist()))
