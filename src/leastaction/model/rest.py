"""A law at rest: its equations as functions of coordinates and coefficients, and its equilibria."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike
from scipy.optimize import root

from leastaction.errors import InputError
from leastaction.findings import as_given
from leastaction.identifiers import names_in_terms, quoted
from leastaction.kinds import is_list
from leastaction.library import make_term, shape_symbol
from leastaction.mechanics.equations import Mechanics, state_symbols
from leastaction.model.checks import checked_start
from leastaction.model.modes import Matrices
from leastaction.model.numbers import covariance_of, principal, values_of
from leastaction.model.term import as_float

if TYPE_CHECKING:
    from leastaction.model.model import LagrangianModel

__all__ = ["RestLaw", "checked_forces", "find_rests", "periodic"]

_STEP = 0.01  # standard errors: derivatives along the principal directions of the covariance
_LAST_STEP = 1e-12  # last step of Newton's method, relative


class RestLaw:
    """M, C, K and r at rest, as functions of coordinates, coefficients and shape parameters.

    Parameters
    ----------
    model : LagrangianModel

    Raises
    ------
    InputError
        If the law depends on time.
    """

    def __init__(self, model: LagrangianModel) -> None:
        if model.timed:
            raise InputError(
                "the law depends on time, so it has no equilibria and no modes; "
                "leastaction.control.linearize with t gives the linear system of one instant"
            )
        self.names: tuple[str, ...] = model.coordinates
        self.free: list[int] = [i for i, name in enumerate(self.names) if name not in model.prescribed]
        self.numbers: np.ndarray = values_of(model)
        both = (*model.terms, *model.dissipation)
        lacking = any(math.isnan(x.standard_error) for x in (*both, *model.shapes))
        self.directions: np.ndarray | None = (
            None if lacking and model.covariance is None else principal(covariance_of(model))
        )
        names, n_lagrangian = names_in_terms(self.names), len(model.terms)
        v = state_symbols(self.names)[1]
        widths = model.fit.smoothing_widths
        swap = {shape_symbol(s.name): sp.Symbol(f"s_{k}", real=True) for k, s in enumerate(model.shapes)}
        self._kinks: list[tuple[str, sp.Expr]] = []
        self.left_out: tuple[str, ...] = ()
        parts: list[sp.Expr] = [sp.Integer(0), sp.Integer(0)]
        coefficients = [sp.Symbol(f"c_{k}", real=True) for k in range(len(both))]
        for k, (term, coefficient) in enumerate(zip(both, coefficients, strict=True)):
            expr = make_term(term.template or term.expression, names).expr.xreplace(swap)
            if k >= n_lagrangian:
                smooth = [part for part in sp.Add.make_args(sp.expand(expr)) if not _dry(part, v, widths)]
                if len(smooth) < len(sp.Add.make_args(sp.expand(expr))):
                    self.left_out += (as_given(term.written, widths),)
                expr = sp.Add(*smooth)
            self._kinks += [(term.written, expr)] if k < n_lagrangian and expr.has(sp.Abs) else []
            parts[k >= n_lagrangian] += coefficient * expr
        fixed = [self.names.index(name) for name in model.prescribed]
        self._shapes = list(swap.values())
        self.mechanics: Mechanics = Mechanics(
            parts[0], parts[1], self.names, [*coefficients, *self._shapes], fixed
        )

    def check_smooth(self, q: np.ndarray) -> None:
        """Refuse a state in which L has a kink."""
        symbols, rates, _ = state_symbols(self.names)
        numbers = self.numbers[len(self.numbers) - len(self._shapes) :]
        point = {**dict(zip(symbols, q.tolist(), strict=True)), **dict.fromkeys(rates, 0.0)}
        for text, expr in self._kinks:
            if _jumps(expr.xreplace(dict(zip(self._shapes, numbers.tolist(), strict=True))), symbols, point):
                raise InputError(
                    f"the equations cannot be linearised at q = {quoted(q.tolist())}: {text} has a kink "
                    "there; choose another state"
                )

    def right(self, q: np.ndarray, numbers: np.ndarray | None = None) -> np.ndarray:
        """r at rest, shape (..., n_free), for q of shape (..., n_dof)."""
        numbers = self.numbers if numbers is None else numbers
        return self.mechanics.mass_and_right(q, np.zeros_like(q), numbers)[1][..., self.free]

    def matrices(self, q: np.ndarray, numbers: np.ndarray | None = None) -> Matrices:
        """M, C and K of the free coordinates at rest, each (..., n_free, n_free)."""
        numbers = self.numbers if numbers is None else numbers
        rest, n, rows = np.zeros_like(q), q.shape[-1], np.array(self.free)
        mass = self.mechanics.mass_and_right(q, rest, numbers)[0]
        slopes = 0.0 - self.mechanics.slopes(q, rest, rest, parameters=numbers)
        at = (..., rows[:, None], rows)
        return mass[at], slopes[(..., rows[:, None], rows + n)], slopes[at]

    def settled(self, q: np.ndarray, forces: np.ndarray, numbers: np.ndarray | None = None) -> np.ndarray:
        """The equilibrium near a state, by Newton's method; NaN if it does not converge."""
        q = q.copy()
        for _ in range(30):
            missing = self.right(q, numbers) + forces[self.free]
            stiffness = self.matrices(q, numbers)[2]
            if not (np.isfinite(missing).all() and np.isfinite(stiffness).all()):
                break
            step = np.linalg.lstsq(stiffness, missing, rcond=1e-10)[0]
            q[self.free] += step
            if np.all(np.abs(step) <= _LAST_STEP * (1.0 + np.abs(q[self.free]))):
                return np.where(np.abs(q) <= _LAST_STEP, 0.0, q)  # less is rounding
        return np.full_like(q, np.nan)

    def changes(self, q: np.ndarray, forces: np.ndarray) -> list[list[np.ndarray]] | None:
        """Derivatives of M, C, K and of an equilibrium along each principal direction of the covariance.

        None without standard errors.
        """
        if self.directions is None:
            return None
        out: list[list[np.ndarray]] = []
        for direction in self.directions.T:
            ends: list[list[np.ndarray]] = []
            for sign in (1.0, -1.0):
                numbers = self.numbers + sign * _STEP * direction
                at = self.settled(q, forces, numbers)
                ends.append([*self.matrices(at, numbers), at])
            *matrices, moved = (a - b for a, b in zip(*ends, strict=True))
            moved[np.abs(moved) <= _LAST_STEP * (1.0 + np.abs(q))] = 0.0
            out.append([change / (2.0 * _STEP) for change in (*matrices, moved)])
        return out


def _smoothed(expr: sp.Expr, rates: Sequence[sp.Symbol], widths: Sequence[float]) -> dict[Any, sp.Expr]:
    """√(u² + w²) → |u|, if the discovery has smoothed |u|."""
    out: dict[Any, sp.Expr] = {}
    for power in expr.atoms(sp.Pow):
        if power.exp != sp.Rational(1, 2) or not power.free_symbols & set(rates):
            continue
        number, square = power.base.as_coeff_Add()
        width = math.sqrt(max(float(number), 0.0))
        if any(math.isclose(width, w, rel_tol=1e-2) for w in widths):
            out[power] = sp.sqrt(sp.factor(square))  # of a real square: |u|
    return out


def _dry(expr: sp.Expr, rates: Sequence[sp.Symbol], widths: Sequence[float]) -> bool:
    """Whether friction does not vanish as the motion comes to rest."""
    sharp = expr.xreplace(_smoothed(expr, rates, widths))
    return _jumps(sharp, rates, dict.fromkeys(rates, sp.Integer(0)))


def _jumps(expr: sp.Expr, symbols: Sequence[sp.Symbol], point: Mapping[sp.Symbol, Any]) -> bool:
    """Whether a derivative differs on both sides of a zero of some |u| at a point."""
    at_zero = [a for a in expr.atoms(sp.Abs) if _vanishes(a.args[0].subs(point))]
    sides = [expr.xreplace({a: sign * a.args[0] for a in at_zero}) for sign in (1, -1)]
    return any(not _vanishes(sp.diff(sides[0] - sides[1], s).subs(point)) for s in symbols)


def _vanishes(expr: sp.Expr) -> bool:
    if expr.free_symbols:
        return bool(sp.expand(expr) == 0)
    try:
        return abs(float(expr)) < 1e-9
    except TypeError:  # not real
        return False


def checked_forces(law: RestLaw, forces: ArrayLike | None) -> np.ndarray:
    """Constant forces, shape (n_dof,); none on a held coordinate."""
    out = checked_start(law.names, np.zeros(len(law.names)) if forces is None else forces, "forces")
    for i, name in enumerate(law.names):
        if i not in law.free and out[i] != 0.0:
            raise InputError(
                f"forces has {out[i]:g} for {name}, which was prescribed and is held; expected 0"
            )
    return out


_STARTS, _MOST_WORK = 256, 2**14  # starts, and numbers in all; n coordinates need n² numbers a start
_SAMPLES = 64  # states at which equations are compared
_STEPS, _LEAP = 100, 0.02  # steps, and longest step as a share of the width
_CELL = 1e-4  # of a width: closer starts count as one
_CELLS = 1000  # of a single coordinate, searched for a change of sign
_EVERY = 0.7  # a shift that is not a fraction of 2π


def find_rests(
    law: RestLaw,
    within: Mapping[str, Any],
    forces: np.ndarray,
    inputs: Mapping[str, float],
    ranges: np.ndarray | None,
) -> list[np.ndarray]:
    """Equilibria in a box; one for each line or surface of equilibria.

    From many starts r(q) + f = 0 is solved by Levenberg and Marquardt's method (MINPACK).
    """
    held = _held(law, inputs)
    turning = periodic(law)
    box = _box(law, within, turning, ranges)
    centre = box.mean(axis=1)
    centre[list(held)] = list(held.values())
    moved = centre + _EVERY * np.eye(len(centre)) * np.maximum(box[:, 1] - box[:, 0], 1e-300)[:, None]
    points = _drawn(box, centre, law.free, _SAMPLES)
    size = np.abs(law.right(points)).max(axis=0, initial=0.0) + np.abs(forces[law.free])
    unknown = [i for i in law.free if not _ignored(law, i, points, moved[i, i] - centre[i], size)]
    found: list[tuple[np.ndarray, np.ndarray | None]] = []
    for start in _starts(law, box, centre, unknown, forces):
        state = _solved(law, start, unknown, forces, size)
        if state is None:
            continue
        high = box[turning, 1]
        state[turning] = high - np.mod(high - state[turning], 2.0 * np.pi)
        width = box[:, 1] - box[:, 0]
        state[np.abs(state) < 1e-10 * width] = 0.0
        if np.all(np.abs(state - centre) <= (0.5 + 1e-9) * width):
            shape = _shape_of_line(law, state)
            if not any(_alike(state, shape, *other, turning, width) for other in found):
                found.append((state, shape))
    return sorted((state for state, _ in found), key=lambda q: tuple(np.round(q, 6)))


def periodic(law: RestLaw) -> np.ndarray:
    """(n_dof,) whether the equations at rest are periodic in a free coordinate, with period 2π."""
    n = len(law.names)
    points = np.random.default_rng(0).uniform(0.2, 1.4, (5, n))
    values = law.right(points)
    turns = np.array([law.right(points + 2.0 * np.pi * row) for row in np.eye(n)])
    same = np.all(np.abs(turns - values) <= 1e-9 * (np.abs(values) + np.abs(values).max()), axis=(1, 2))
    return same & np.isin(np.arange(n), law.free)


def _held(law: RestLaw, inputs: Mapping[str, float]) -> dict[int, float]:
    """Index of each prescribed coordinate → its position."""
    names = [name for i, name in enumerate(law.names) if i not in law.free]
    strangers = [name for name in inputs if name not in names]
    if strangers or len(names) > len(inputs):
        needed = f"the positions of {', '.join(names)}" if names else "nothing: no coordinate is prescribed"
        raise InputError(f"inputs gives {', '.join(map(quoted, inputs)) or 'nothing'}; expected {needed}")
    return {law.names.index(name): as_float(x, f"inputs: {name}") for name, x in inputs.items()}


def _box(
    law: RestLaw, within: Mapping[str, Any], turning: np.ndarray, ranges: np.ndarray | None
) -> np.ndarray:
    """(n_dof, 2) range of the search for each coordinate."""
    for name, ends in within.items():
        if name not in law.names:
            raise InputError(f"within: {quoted(name)} is not a coordinate; expected {', '.join(law.names)}")
        good = is_list(ends) and len(ends) == 2
        if not good or not as_float(ends[0], "within") < as_float(ends[1], "within"):
            raise InputError(f"within: {name} is {quoted(ends)}; expected two rising numbers")
    out = np.zeros((len(law.names), 2))
    for i in law.free:
        name = law.names[i]
        if name in within:
            out[i] = within[name]
        elif turning[i]:
            out[i] = -np.pi, np.pi
        elif ranges is not None:
            out[i] = ranges[i]
        else:
            raise InputError(
                f"the range of {name} is unknown, because a model from a file has no recording; give "
                f"within={{{name!r}: (low, high)}}"
            )
    return out


def _drawn(box: np.ndarray, centre: np.ndarray, free: Sequence[int], number: int) -> np.ndarray:
    """(number, n_dof) points of a box, evenly at random."""
    points = np.tile(centre, (number, 1))
    points[:, free] = np.random.default_rng(0).uniform(box[free, 0], box[free, 1], (number, len(free)))
    return points


def _ignored(law: RestLaw, i: int, points: np.ndarray, shift: float, size: np.ndarray) -> bool:
    """Whether the equations at rest do not depend on a coordinate."""
    moved = points.copy()
    moved[:, i] += shift
    return bool(np.all(np.abs(law.right(moved) - law.right(points)) <= 1e-12 * size))


def _starts(
    law: RestLaw, box: np.ndarray, centre: np.ndarray, unknown: Sequence[int], forces: np.ndarray
) -> np.ndarray:
    """Starts: the middle, random points, and, for a single coordinate, changes of sign of the force."""
    if not unknown:
        return centre[None]
    number = min(_STARTS * 4 ** (len(unknown) - 1), _MOST_WORK // len(unknown) ** 2)
    width = (box[:, 1] - box[:, 0])[unknown]
    ends = _walked(law, _drawn(box, centre, unknown, number), unknown, forces, _LEAP * width)
    places = np.unique(np.round(ends[:, unknown] / (_CELL * width)), axis=0, return_index=True)[1]
    out = [centre[None], ends[places]]
    if len(unknown) == 1:
        (i,) = unknown
        grid = np.tile(centre, (_CELLS + 1, 1))
        grid[:, i] = np.linspace(box[i, 0], box[i, 1], _CELLS + 1)
        force = (law.right(grid) + forces[law.free])[:, law.free.index(i)]
        out.append(0.5 * (grid[:-1] + grid[1:])[force[:-1] * force[1:] < 0.0])
    return np.concatenate(out)


def _walked(
    law: RestLaw, points: np.ndarray, unknown: Sequence[int], forces: np.ndarray, longest: np.ndarray
) -> np.ndarray:
    """Ends of Newton's method in short steps; of three points, one descends and one ascends the potential.

    Newton's method alone finds a narrow well only from within; from outside it leads to the saddles around
    it.
    """
    points, way = points.copy(), np.arange(len(points)) % 3
    inner = np.array([law.free.index(i) for i in unknown])
    step = np.zeros((len(points), len(unknown)))
    for _ in range(_STEPS):
        missing = (law.right(points) + forces[law.free])[:, inner]
        slope = law.matrices(points)[2][:, inner[:, None], inner]
        usable = np.isfinite(missing).all(axis=-1) & np.isfinite(slope).all(axis=(-1, -2))
        points, way, missing, slope = (x[usable] for x in (points, way, missing, slope))
        values, vectors = np.linalg.eigh(0.5 * (slope + np.swapaxes(slope, -1, -2)))
        least = np.maximum(1e-9 * np.abs(values).max(axis=-1, initial=0.0, keepdims=True), 1e-300)
        signs = np.where(way[:, None] == 0, np.where(values < 0.0, -1.0, 1.0), 3.0 - 2.0 * way[:, None])
        along = (np.swapaxes(vectors, -1, -2) @ missing[..., None])[..., 0]
        step = (vectors @ (signs * along / np.maximum(np.abs(values), least))[..., None])[..., 0]
        step /= np.maximum(1.0, np.abs(step / longest).max(axis=-1, keepdims=True))
        points[:, unknown] += step
    return points[np.abs(step / longest).max(axis=-1, initial=0.0) < _CELL]


def _solved(
    law: RestLaw, start: np.ndarray, unknown: Sequence[int], forces: np.ndarray, size: np.ndarray
) -> np.ndarray | None:
    """The equilibrium reached from a start."""

    def placed(x: np.ndarray) -> np.ndarray:
        state = start.copy()
        state[unknown] = x
        return state

    inner = [law.free.index(i) for i in unknown]
    if unknown:
        solution = root(
            lambda x: law.right(placed(x)) + forces[law.free],
            start[unknown],
            jac=lambda x: -law.matrices(placed(x))[2][:, inner],
            method="lm",
        )
        if not np.isfinite(solution.x).all():
            return None
        start = placed(solution.x)
    state = law.settled(start, forces)
    if not np.isfinite(state).all() or np.any(
        np.abs(state - start)[unknown] > 1e-3 * (1 + np.abs(start)[unknown])
    ):
        return None
    off = np.abs(law.right(state) + forces[law.free])
    return state if np.all(off <= 1e-9 * np.maximum(size, 1e-300)) else None


def _shape_of_line(law: RestLaw, state: np.ndarray) -> np.ndarray | None:
    """Eigenvalues of K if some vanish, so that equilibria may form a line."""
    stiffness = law.matrices(state)[2]
    sizes = np.linalg.svd(stiffness, compute_uv=False)
    if sizes.size and sizes.min() > 1e-7 * sizes.max():
        return None
    return np.sort_complex(np.linalg.eigvals(stiffness))


def _alike(
    state: np.ndarray,
    shape: np.ndarray | None,
    other: np.ndarray,
    other_shape: np.ndarray | None,
    turning: np.ndarray,
    width: np.ndarray,
) -> bool:
    """Whether two equilibria are the same, or lie on one line."""
    if shape is not None and other_shape is not None:
        return bool(np.abs(shape - other_shape).max() <= 1e-5 * max(np.abs(shape).max(), 1e-300))
    apart = np.abs(state - other)
    apart[turning] = np.abs(np.mod(apart[turning] + np.pi, 2.0 * np.pi) - np.pi)
    return bool(np.all(apart <= 1e-6 * np.maximum(width, 1e-300)))
