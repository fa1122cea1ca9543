"""The Euler–Lagrange operator applied to candidate terms, with exact symbolic derivatives.

For a candidate φ(q, q̇, t) of the Lagrangian the operator is, by the chain rule,

    E_i[φ] = Σ_j φ_{q̇i q̇j} q̈_j + Σ_j φ_{q̇i qj} q̇_j + φ_{q̇i t} − φ_{qi},

and a Rayleigh candidate ψ contributes ∂ψ/∂q̇_i on the same side, so that the equations of motion read

    Σ_k λ_k E_i[φ_k] + Σ_k c_k ∂ψ_k/∂q̇_i = f_i.

Both are linear in the coefficients.  A *column* below is one candidate, of either kind.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike

from leastaction.errors import InputError
from leastaction.library import Library, Template, Term, shape_symbol, time_symbol
from leastaction.mechanics import Points

__all__ = ["EulerLagrange", "Points", "euler_lagrange"]


def _symbols(coordinates: Sequence[str]) -> tuple[list[sp.Symbol], list[sp.Symbol], list[sp.Symbol]]:
    q = [sp.Symbol(c, real=True) for c in coordinates]
    qdot = [sp.Symbol(f"{c}_dot", real=True) for c in coordinates]
    # no clash is possible: names that end in _dot are not coordinates
    qddot = [sp.Symbol(f"{c}_dot_dot", real=True) for c in coordinates]
    return q, qdot, qddot


def _clean(expr: sp.Expr) -> sp.Expr:
    """|x| has a kink: its second derivative is taken as zero."""
    return expr.replace(sp.DiracDelta, lambda *_: sp.Integer(0)) if expr.has(sp.DiracDelta) else expr


def _gradient(expr: sp.Expr, symbols: Sequence[sp.Symbol]) -> list[sp.Expr]:
    """∂expr/∂symbol for each symbol; SymPy is called only for symbols that occur."""
    present = expr.free_symbols
    return [_clean(sp.diff(expr, s)) if s in present else sp.S.Zero for s in symbols]


class _Compiled:
    """Several expressions of (q, q̇, q̈), the time and shape parameters as one numpy function; no zeros."""

    def __init__(
        self,
        expressions: dict[tuple[int, ...], sp.Expr],
        symbols: list[sp.Symbol],
        n_dof: int,
        shapes: list[sp.Symbol],
    ) -> None:
        entries = {key: e for key, e in expressions.items() if e != 0}
        self.keys = tuple(entries)
        atoms = sorted({a for e in entries.values() for a in _shared_atoms(e)}, key=sp.default_sort_key)
        stand_ins = [sp.Symbol(f"_shared{k}", real=True) for k in range(len(atoms))]
        swap = dict(zip(atoms, stand_ins, strict=True))
        bodies = [e.xreplace(swap) for e in entries.values()]
        state = tuple(symbols[: 2 * n_dof])
        self._atoms = [(a, _atom_function(a, (*state, *_clock(a), *shapes)), bool(_clock(a))) for a in atoms]
        self._clock = _clock(sp.Tuple(*bodies))
        arguments = [*symbols, *stand_ins, *self._clock, *shapes]
        # dummify: a coordinate may have the name of a numpy function
        self._function = sp.lambdify(arguments, bodies, modules="numpy", cse=len(bodies) > 2, dummify=True)
        self._n_symbols = len(symbols)

    def __call__(
        self, points: Points, numbers: tuple[float, ...] = ()
    ) -> Iterable[tuple[tuple[int, ...], np.ndarray | float]]:
        if not self.keys:
            return ()
        shared = [points.value(*atom, numbers) for atom in self._atoms]
        with np.errstate(all="ignore"):
            clock = (points.times,) if self._clock else ()
            values = self._function(*points.columns[: self._n_symbols], *shared, *clock, *numbers)
        return zip(self.keys, values, strict=True)


def _clock(expr: sp.Basic) -> tuple[sp.Symbol, ...]:
    """The time, if an expression contains it."""
    return tuple(symbol for symbol in (time_symbol,) if symbol in expr.free_symbols)


def _shared_atoms(expr: sp.Expr) -> set[sp.Basic]:
    """Functions and roots worth computing once: sin, cos, …, and powers that are not small integers."""
    found: set[sp.Basic] = set()
    stack = [expr]
    while stack:
        node = stack.pop()
        costly_power = isinstance(node, sp.Pow) and not (node.exp.is_Integer and 0 < int(node.exp) <= 4)
        if node.free_symbols and (isinstance(node, sp.Function) or costly_power):
            found.add(node)
        else:
            stack.extend(node.args)
    return found


@lru_cache(maxsize=4096)
def _atom_function(atom: sp.Basic, symbols: tuple[sp.Symbol, ...]) -> Callable[..., Any]:
    return sp.lambdify(symbols, atom, modules="numpy", dummify=True)


_compiling = threading.RLock()


class _Column:
    """One candidate: its derivatives, compiled when first asked for. Shape parameters are arguments."""

    def __init__(self, term: Term, coordinates: tuple[str, ...]) -> None:
        self.term = term
        self.n_dof = len(coordinates)
        self.q, self.qdot, self.qddot = _symbols(coordinates)
        self.shapes = [shape_symbol(name) for name in term.shapes]
        self._compiled: dict[str, _Compiled] = {}

    def get(self, what: str) -> _Compiled:
        with _compiling:  # SymPy is not thread-safe
            return self._get(what)

    def _get(self, what: str) -> _Compiled:
        if what not in self._compiled:
            expressions = getattr(self, f"_{what}")()
            state = [*self.q, *self.qdot] if what in ("weak", "mass") else [*self.q, *self.qdot, *self.qddot]
            self._compiled[what] = _Compiled(expressions, state, self.n_dof, self.shapes)
        return self._compiled[what]

    def _weak(self) -> dict[tuple[int, ...], sp.Expr]:
        """(0, i): factor of χ̇, ∂φ/∂q̇_i; (1, i): factor of χ, ∂φ/∂q_i or −∂ψ/∂q̇_i."""
        rates = _gradient(self.term.expr, self.qdot)
        if self.term.kind == "dissipation":
            return {(1, i): -rate for i, rate in enumerate(rates)}
        slopes = _gradient(self.term.expr, self.q)
        return {(part, i): e for part, row in enumerate((rates, slopes)) for i, e in enumerate(row)}

    def _mass(self) -> dict[tuple[int, ...], sp.Expr]:
        if self.term.kind == "dissipation":
            return {}
        rows = [_gradient(p, self.qdot) for p in _gradient(self.term.expr, self.qdot)]
        return {(i, j): entry for i, row in enumerate(rows) for j, entry in enumerate(row)}

    def _strong(self) -> dict[tuple[int, ...], sp.Expr]:
        momenta = _gradient(self.term.expr, self.qdot)
        if self.term.kind == "dissipation":
            return {(i,): momentum for i, momentum in enumerate(momenta)}
        out: dict[tuple[int, ...], sp.Expr] = {}
        slopes = _gradient(self.term.expr, self.q)
        state, rates = [*self.qdot, *self.q, time_symbol], [*self.qddot, *self.qdot, sp.S.One]
        for i, (momentum, slope) in enumerate(zip(momenta, slopes, strict=True)):
            pieces = [d * rate for d, rate in zip(_gradient(momentum, state), rates, strict=True)]
            out[(i,)] = sp.Add(*pieces, -slope)
        return out

    def _jacobian(self) -> dict[tuple[int, ...], sp.Expr]:
        """(nu, i, j): ∂E_i/∂q_j^{(nu)}."""
        states = [(nu, j) for nu in range(3) for j in range(self.n_dof)]
        symbols = [*self.q, *self.qdot, *self.qddot]
        return {
            (nu, i, j): entry
            for (i,), expr in self._strong().items()
            for (nu, j), entry in zip(states, _gradient(expr, symbols), strict=True)
        }


@lru_cache(maxsize=2048)
def _column(term: Term, coordinates: tuple[str, ...]) -> _Column:
    return _Column(term, coordinates)


class _Numbered:
    """The functions of a candidate with shape parameters, at given values of these."""

    def __init__(self, term: Term, template: Template, coordinates: tuple[str, ...]) -> None:
        self._column = _column(template.term, coordinates)
        values = dict(template.values)
        # 1/0 is infinite, as for an array, not an error
        self._numbers = tuple(np.float64(values[name]) for name in term.shapes)

    def get(self, what: str) -> Callable[[Points], Iterable[tuple[tuple[int, ...], np.ndarray | float]]]:
        return partial(self._column.get(what), numbers=self._numbers)


class EulerLagrange:
    """The columns of a library as numpy functions.

    Parameters
    ----------
    terms : sequence of Term
        Candidates of L and of the dissipation function, in any mixture.
    coordinates : sequence of str
    prescribed : sequence of int
        Coordinates moved by unknown forces: their equations are empty, and the mass matrix is that of the
        other coordinates, with a one on the diagonal for each of them.
    values : sequence of mapping, optional
        Values of the shape parameters of each term; empty for a term without free ones. Evaluating them takes
        less time than substituting them into the terms (`Term.at`).
    """

    grouped = False
    """Whether some columns act in some of the trials alone."""

    def __init__(
        self,
        terms: Sequence[Term],
        coordinates: Sequence[str],
        prescribed: Sequence[int] = (),
        values: Sequence[Mapping[str, float]] | None = None,
    ) -> None:
        self.terms: tuple[Term, ...] = tuple(terms)
        self.coordinates: tuple[str, ...] = tuple(coordinates)
        self.prescribed: tuple[int, ...] = tuple(prescribed)
        self.n_dof: int = len(self.coordinates)
        self._values = values
        templates = [term.template for term in self.terms]
        if values is not None:
            pairs = zip(self.terms, values, strict=True)
            templates = [term.numbered(given) if given else term.template for term, given in pairs]
        self._columns = [
            _column(term, self.coordinates)
            if template is None
            else _Numbered(term, template, self.coordinates)
            for term, template in zip(self.terms, templates, strict=True)
        ]

    def __len__(self) -> int:
        return len(self.terms)

    def weak(self, points: Points) -> np.ndarray:
        """(2, n_terms, n_dof, n_points): factors of χ̇, ∂φ/∂q̇, and of χ, ∂φ/∂q or −∂ψ/∂q̇."""
        out = np.zeros((2, len(self), self.n_dof, points.n_points))
        for k, column in enumerate(self._columns):
            for (part, i), value in column.get("weak")(points):
                out[part, k, i] = value
        out[:, :, self.prescribed] = 0.0
        return out

    def strong(self, points: Points, select: Sequence[int] | None = None) -> np.ndarray:
        """(n_selected, n_dof, n_points): E_i[φ_k] and ∂ψ_k/∂q̇_i."""
        select = range(len(self)) if select is None else select
        out = np.zeros((len(select), self.n_dof, points.n_points))
        for row, k in enumerate(select):
            for (i,), value in self._columns[k].get("strong")(points):
                out[row, i] = value
        out[:, self.prescribed] = 0.0
        return out

    def jacobian(self, points: Points, coefficients: np.ndarray) -> dict[tuple[int, int, int], np.ndarray]:
        """Sparse dictionary (nu, i, j) → Σ_k λ_k ∂E_i[φ_k]/∂q_j^{(nu)}, each (n_points,) or a float."""
        out: dict[tuple[int, ...], np.ndarray] = {}
        for column, coefficient in zip(self._columns, coefficients, strict=True):
            if coefficient == 0.0:
                continue
            for key, value in column.get("jacobian")(points):
                if key[1] in self.prescribed:
                    continue
                product, before = coefficient * value, out.get(key)
                if isinstance(before, np.ndarray):
                    before += product
                else:
                    out[key] = product if before is None else before + product
        return out  # type: ignore[return-value]

    def mass_of(self, k: int, points: Points) -> np.ndarray:
        """(n_points, n_dof, n_dof): ∂²φ_k/∂q̇∂q̇."""
        out = np.zeros((points.n_points, self.n_dof, self.n_dof))
        for (i, j), value in self._columns[k].get("mass")(points):
            out[:, i, j] = value
        out[:, self.prescribed] = out[:, :, self.prescribed] = 0.0
        return out

    def masses(self, points: Points) -> tuple[list[int], np.ndarray]:
        """The columns with kinetic energy, and (n_points, n_of_them, n_dof, n_dof): ∂²φ_k/∂q̇∂q̇ of each."""
        entries = {k: dict(column.get("mass")(points)) for k, column in enumerate(self._columns)}
        moving = [k for k, found in entries.items() if found]
        out = np.zeros((len(moving), self.n_dof, self.n_dof, points.n_points))
        for row, k in enumerate(moving):
            for (i, j), value in entries[k].items():
                out[row, i, j] = value
        out[:, self.prescribed] = out[:, :, self.prescribed] = 0.0
        return moving, np.ascontiguousarray(out.transpose(3, 0, 1, 2))

    def mass_matrix(self, points: Points, coefficients: np.ndarray) -> np.ndarray:
        """(n_points, n_dof, n_dof): ∂²L/∂q̇∂q̇."""
        out = np.zeros((self.n_dof, self.n_dof, points.n_points))
        for column, coefficient in zip(self._columns, coefficients, strict=True):
            for (i, j), value in column.get("mass")(points):
                out[i, j] += coefficient * value
        out[self.prescribed, :] = out[:, self.prescribed] = 0.0
        out[self.prescribed, self.prescribed] = 1.0
        return np.ascontiguousarray(out.transpose(2, 0, 1))

    @property
    def turning(self) -> tuple[str, ...]:
        """Coordinates inside a sine or cosine."""
        waves = [wave for term in self.terms for wave in term.expr.atoms(sp.sin, sp.cos)]
        inside = {symbol.name for wave in waves for symbol in wave.free_symbols}
        return tuple(name for name in self.coordinates if name in inside)

    def subset(self, select: Sequence[int]) -> EulerLagrange:
        """Some of the columns, in the given sequence; compiled functions are shared."""
        return self.of([self.terms[k] for k in select])

    def within(self, intervals: slice) -> EulerLagrange:
        """The columns for a part of a motion, given by its knot intervals."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        # compiled functions cannot be pickled; the receiving process compiles them again
        return type(self), (self.terms, self.coordinates, self.prescribed, self._values)

    def of(self, terms: Sequence[Term], values: Sequence[Mapping[str, float]] | None = None) -> EulerLagrange:
        """Other terms for the same coordinates."""
        return EulerLagrange(terms, self.coordinates, self.prescribed, values)


def euler_lagrange(
    library: Library, q: ArrayLike, qdot: ArrayLike, qddot: ArrayLike, t: ArrayLike | None = None
) -> np.ndarray:
    """Apply the Euler–Lagrange operator to every candidate of a library at given states.

    Parameters
    ----------
    library : Library
    q, qdot, qddot : array_like, shape (n_times, n_dof)
        Coordinates, velocities (1/s) and accelerations (1/s²).
    t : array_like, shape (n_times,), optional
        Times in seconds, for candidates that depend on time.

    Returns
    -------
    (n_times, n_dof, n_terms) array
        ``E_i[φ_k] = d/dt ∂φ_k/∂q̇_i − ∂φ_k/∂q_i`` for the terms of L, then ``∂ψ_k/∂q̇_i`` for those of the
        dissipation function, so that the equations of motion read ``out @ coefficients = forces``.  NaN or
        infinite where a candidate is undefined.

    Raises
    ------
    InputError
        If the shapes do not match each other or the library, a shape parameter has no number, or a candidate
        depends on time and `t` is missing.

    Examples
    --------
    >>> import leastaction as la
    >>> pendulum = la.Library(["theta_dot**2/2", "cos(theta)"], ["theta"])
    >>> la.euler_lagrange(pendulum, q=[[0.5]], qdot=[[1.0]], qddot=[[2.0]])
    array([[[2.        , 0.47942554]]])
    """
    states = [np.asarray(a, dtype=float) for a in (q, qdot, qddot)]
    shapes = [a.shape for a in states]
    if len(set(shapes)) > 1 or len(shapes[0]) != 2 or shapes[0][1] != len(library.coordinates):
        raise InputError(
            f"q, qdot and qddot have the shapes {', '.join(map(str, shapes))}; expected one shape "
            f"(n_times, {len(library.coordinates)}) for the coordinates {', '.join(library.coordinates)}"
        )
    library = library.at({})  # raises for a shape parameter without a number
    columns = EulerLagrange((*library.terms, *library.dissipation), library.coordinates)
    points = Points(states[0], states[1], states[2], _times(columns, t, len(states[0])))
    return columns.strong(points).transpose(2, 1, 0)


def _times(columns: EulerLagrange, t: ArrayLike | None, n_times: int) -> np.ndarray | None:
    """Times for columns that need them."""
    if t is None:
        timed = [term.text for term in columns.terms if time_symbol in term.expr.free_symbols]
        if timed:
            raise InputError(f"the candidate {timed[0]} depends on time; give t, one time for each state")
        return None
    times = np.asarray(t, dtype=float)
    if times.shape != (n_times,):
        raise InputError(f"t has the shape {times.shape}; expected ({n_times},), one time for each state")
    return times
