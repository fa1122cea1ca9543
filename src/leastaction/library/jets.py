"""Values and derivatives of expressions at many points, without symbolic differentiation.

A jet holds, at each point, u itself, du/dt along the motion (q̇, q̈; 1 for the time), ∂u/∂q_i, ∂u/∂q̇_i and
d/dt ∂u/∂q̇_i. Sums, products and functions of jets follow from the chain rule.  One pass over an expression
gives E_i[φ] = d/dt ∂φ/∂q̇_i − ∂φ/∂q_i, in double or in high precision.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import lru_cache, partial
from typing import Any

import mpmath
import numpy as np
import sympy

from leastaction.library.parser import time_symbol
from leastaction.library.term import Term

__all__ = ["Jets", "Points"]


@lru_cache(maxsize=8)
def _context(digits: int) -> mpmath.MPContext:
    """Return a separate mpmath context with this number of digits."""
    context = mpmath.mp.clone()
    context.dps = digits
    return context


def _lift(values: np.ndarray, digits: int) -> np.ndarray:
    number: Callable[[Any], Any] = _context(digits).mpf
    return np.frompyfunc(number, 1, 1)(values)


class Points:
    """States q, q̇, q̈, each an array (n_dof, n_points), at ``times``, an array (n_points,); zero by default.

    Floats, or numbers with this number of `digits`.
    """

    def __init__(
        self,
        q: np.ndarray,
        qdot: np.ndarray,
        qddot: np.ndarray,
        times: np.ndarray | None = None,
        digits: int | None = None,
    ) -> None:
        self.q: np.ndarray = q
        self.qdot: np.ndarray = qdot
        self.qddot: np.ndarray = qddot
        self.digits: int | None = digits
        self.times: np.ndarray = np.zeros(q.shape[1]) if times is None else times

    @classmethod
    def draw(cls, rng: np.random.Generator, n_dof: int, n_points: int) -> Points:
        """Draw points of size one away from zero; every second one has only positive coordinates."""
        signs = rng.choice([-1.0, 1.0], (2, n_dof, n_points))
        signs[0, :, ::2] = 1.0
        q, qdot = rng.uniform(0.2, 2.5, (2, n_dof, n_points)) * signs
        return cls(q, qdot, rng.normal(size=(n_dof, n_points)), rng.uniform(0.2, 2.5, n_points))

    def __getitem__(self, columns: np.ndarray | slice) -> Points:
        states = (array[:, columns] for array in (self.q, self.qdot, self.qddot))
        return Points(*states, self.times[columns], self.digits)  # type: ignore[misc]

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self.q.shape[1]

    def with_digits(self, digits: int) -> Points:
        """Return the same points as numbers with this number of digits."""
        lifted = (_lift(values, digits) for values in (self.q, self.qdot, self.qddot, self.times))
        return Points(*lifted, digits)  # type: ignore[arg-type]


def _itself(function: Any) -> Any:
    return function


class _Arithmetic:
    """The functions of the grammar on arrays, in double or in high precision."""

    def __init__(self, digits: int | None) -> None:
        self.context = _context(digits) if digits else None
        self.dtype = object if digits else float
        source = self.context or np
        lift: Callable[[Any], Callable[[np.ndarray], np.ndarray]]
        lift = partial(np.frompyfunc, nin=1, nout=1) if digits else _itself
        self.sin, self.cos, self.tan = lift(source.sin), lift(source.cos), lift(source.tan)
        self.exp, self.log, self.sign = lift(source.exp), lift(source.log), lift(source.sign)

    def number(self, expr: sympy.Expr) -> Any:
        if self.context is None:
            return float(expr)
        if isinstance(expr, sympy.Rational):
            return self.context.mpf(int(expr.p)) / int(expr.q)
        if expr.is_Float:
            return self.context.mpf(float(expr))
        return +self.context.pi if expr == sympy.pi else +self.context.e

    def power(self, u: np.ndarray, n: Any) -> np.ndarray:
        return u * u if n == 2 else u**n

    def derivatives(self, head: type, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | int]:
        """Return f(u), f'(u), f''(u)."""
        if head is sympy.sin:
            s, c = self.sin(u), self.cos(u)
            return s, c, -s
        if head is sympy.cos:
            s, c = self.sin(u), self.cos(u)
            return c, -s, -c
        if head is sympy.tan:
            t = self.tan(u)
            return t, 1 + t * t, 2 * t * (1 + t * t)
        if head is sympy.exp:
            e = self.exp(u)
            return e, e, e
        if head is sympy.log:
            return self.log(u), 1 / u, -1 / (u * u)
        if head is sympy.Abs:
            return abs(u), self.sign(u), 0  # the kink at zero is neglected
        raise TypeError(f"no derivative is known for {head}")


class Jets:
    """Evaluates terms at points; common parts of the expressions are computed once.

    Parameters
    ----------
    coordinates
        Names of the coordinates.
    points
        States; their numbers determine the precision.
    prescribed
        Indices of coordinates whose equations are left out.

    Examples
    --------
    >>> x, v = sympy.symbols("x x_dot", real=True)
    >>> jets = Jets(["x"], Points(np.array([[2.0]]), np.array([[3.0]]), np.array([[5.0]])))
    >>> float(jets.effect(Term("x*x_dot**2", x * v**2))[0, 0])  # 2 x q̈ + x_dot**2
    29.0
    """

    def __init__(self, coordinates: Sequence[str], points: Points, prescribed: Collection[int] = ()) -> None:
        n = len(coordinates)
        self.n_dof: int = n
        self._equations = [i for i in range(n) if i not in prescribed]
        self.n_points: int = points.n_points
        self._digits = points.digits
        self._arithmetic = _Arithmetic(points.digits)
        self._q, self._v, self._vt = slice(2, 2 + n), slice(2 + n, 2 + 2 * n), slice(2 + 2 * n, 2 + 3 * n)
        self._cache: dict[sympy.Expr, np.ndarray] = {}
        clock = self._zeros()
        clock[0], clock[1] = points.times, 1
        self._cache[time_symbol] = clock
        for i, name in enumerate(coordinates):
            for symbol, value, rate, place in (
                (name, points.q[i], points.qdot[i], 2 + i),
                (f"{name}_dot", points.qdot[i], points.qddot[i], 2 + n + i),
            ):
                jet = self._zeros()
                jet[0], jet[1], jet[place] = value, rate, 1
                self._cache[sympy.Symbol(symbol, real=True)] = jet

    def effect(self, term: Term) -> np.ndarray:
        """Return the term's part of the equations: E_i[φ] or ∂ψ/∂q̇_i, (n_equations, n_points)."""
        return self.effect_of(self.jet(term.expr), term)

    def effect_of(self, jet: np.ndarray, term: Term) -> np.ndarray:
        """Return the same from the jet of the term."""
        effect = jet[self._v] if term.kind == "dissipation" else jet[self._vt] - jet[self._q]
        return effect[self._equations]

    def lift(self, values: np.ndarray) -> np.ndarray:
        """Return floats in the precision of the points, so that products keep it."""
        return _lift(values, self._digits) if self._digits else values

    def jet(self, expr: sympy.Expr) -> np.ndarray:
        """Return the jet (2 + 3 n_dof, n_points); its first row is the value of the expression."""
        found = self._cache.get(expr)
        if found is None:
            with np.errstate(all="ignore"):  # points outside the domain are dropped later
                found = self._cache[expr] = self._evaluate(expr)
        return found

    def fresh(self, expr: sympy.Expr) -> np.ndarray:
        """Return the jet of an expression and cache only those of its parts."""
        found = self._cache.get(expr)
        if found is not None:
            return found
        with np.errstate(all="ignore"):
            return self._evaluate(expr)

    def _zeros(self) -> np.ndarray:
        return np.zeros((2 + 3 * self.n_dof, self.n_points), dtype=self._arithmetic.dtype)

    def _evaluate(self, expr: sympy.Expr) -> np.ndarray:
        if not expr.args:
            jet = self._zeros()
            jet[0] = self._arithmetic.number(expr)
            return jet
        if expr.is_Add:
            total = self.jet(expr.args[0])
            for part in expr.args[1:]:
                total = total + self.jet(part)
            return total
        if expr.is_Mul:
            factor, rest = expr.as_coeff_mul()
            product = self.jet(rest[0])
            for part in rest[1:]:
                product = self._product(product, self.jet(part))
            return product if factor == 1 else product * self._arithmetic.number(factor)
        if isinstance(expr, sympy.Pow):
            return self._power(self.jet(expr.base), expr.exp)
        u = self.jet(expr.args[0])
        return self._compose(u, *self._arithmetic.derivatives(expr.func, u[0]))

    def _product(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        out = np.empty_like(a)
        out[0] = a[0] * b[0]
        out[1:] = a[1:] * b[0] + a[0] * b[1:]
        out[self._vt] += a[self._v] * b[1] + a[1] * b[self._v]
        return out

    def _power(self, u: np.ndarray, exponent: sympy.Expr) -> np.ndarray:
        if exponent.is_Integer:
            n: Any = int(exponent)
        else:
            n = self.jet(exponent)[0, 0] if not exponent.is_Number else self._arithmetic.number(exponent)
        power = self._arithmetic.power
        return self._compose(u, power(u[0], n), n * power(u[0], n - 1), n * (n - 1) * power(u[0], n - 2))

    def _compose(self, u: np.ndarray, f: np.ndarray, df: np.ndarray, ddf: np.ndarray | int) -> np.ndarray:
        out = np.empty_like(u)
        out[0] = f
        out[1:] = df * u[1:]
        out[self._vt] += ddf * u[1] * u[self._v]
        return out
