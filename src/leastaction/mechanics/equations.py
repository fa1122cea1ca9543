"""Equations of motion of one Lagrangian and one dissipation function: symbolic, and compiled for arrays.

The Euler–Lagrange equations d/dt ∂L/∂q̇ − ∂L/∂q + ∂ψ/∂q̇ = f are M(q, q̇, t) q̈ = r(q, q̇, t) + f with

    M_ij = ∂²L/∂q̇_i∂q̇_j,    r_i = ∂L/∂q_i − ∂ψ/∂q̇_i − Σ_j (∂²L/∂q̇_i∂q_j) q̇_j − ∂²L/∂q̇_i∂t.

If the motion of a coordinate is prescribed, q̈_i = f_i replaces its equation: its "force" is its acceleration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import sympy as sp
from sympy.printing.numpy import NumPyPrinter

from leastaction.library import Term, time_symbol

__all__ = ["Mechanics", "RealAbs", "RealSign", "solve", "state_symbols"]


# SymPy's derivative of |u| contains re() and im() unless u is known to be real, and its second derivative a
# delta function. Here u is real, and the second derivative is taken as zero.
class RealSign(sp.Function):
    """Sign of a real number; its derivative is taken as zero."""

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sp.Integer(0)


class RealAbs(sp.Function):
    """|u| of a real number u."""

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return RealSign(self.args[0])


class _Printer(NumPyPrinter):
    """NumPy code with all digits of the numbers: lambdify's own printer keeps 15."""

    def _print_Float(self, expr: sp.Float) -> str:
        return repr(float(expr))

    def _print_RealAbs(self, expr: sp.Expr) -> str:
        return f"abs({self._print(expr.args[0])})"

    def _print_RealSign(self, expr: sp.Expr) -> str:
        return f"sign({self._print(expr.args[0])})"


def state_symbols(coordinates: Sequence[str]) -> tuple[list[sp.Symbol], list[sp.Symbol], list[sp.Symbol]]:
    """Real symbols of coordinates, velocities (``x_dot``) and accelerations (``x_dot_dot``)."""
    q = [sp.Symbol(c, real=True) for c in coordinates]
    qdot = [sp.Symbol(f"{c}_dot", real=True) for c in coordinates]
    return q, qdot, [sp.Symbol(f"{c}_dot_dot", real=True) for c in coordinates]


class Mechanics:
    """Mass matrix, right-hand side, energy and acceleration of one system.

    Parameters
    ----------
    lagrangian, dissipation : sympy.Expr
        L and ψ with their numbers, over the symbols of `state_symbols`.
    coordinates : sequence of str
    parameters : sequence of sympy.Symbol
        Coefficients that stay symbols; `acceleration` takes their values.
    prescribed : sequence of int
        Coordinates whose motion is prescribed.

    Notes
    -----
    `mass`, `right` and `energy_expression` use the neutral symbols `q` and `qdot`, so that no name of a
    coordinate clashes with a name in generated code, and `t`, which is not allowed as a coordinate.

    Attributes
    ----------
    timed : bool
        Whether L or ψ contains the time; every method then needs `t`.
    """

    def __init__(
        self,
        lagrangian: sp.Expr,
        dissipation: sp.Expr,
        coordinates: Sequence[str],
        parameters: Sequence[sp.Symbol] = (),
        prescribed: Sequence[int] = (),
    ) -> None:
        self.prescribed: tuple[int, ...] = tuple(prescribed)
        self.n_dof: int = len(coordinates)
        self.parameters: tuple[Any, ...] = tuple(parameters)
        self._named = state_symbols(coordinates)
        self.q: list[Any] = [sp.Symbol(f"q_{i}", real=True) for i in range(self.n_dof)]
        self.qdot: list[Any] = [sp.Symbol(f"v_{i}", real=True) for i in range(self.n_dof)]
        self._lagrangian, self._dissipation = self._neutral(lagrangian), self._neutral(dissipation)
        self.timed: bool = time_symbol in self._lagrangian.free_symbols | self._dissipation.free_symbols

    @classmethod
    def of_terms(
        cls,
        terms: Sequence[Term],
        values: Sequence[sp.Expr],
        coordinates: Sequence[str],
        parameters: Sequence[sp.Symbol] = (),
        prescribed: Sequence[int] = (),
    ) -> Mechanics:
        """The mechanics of terms of L and ψ, with numbers or parameters as coefficients."""
        parts: dict[str, sp.Expr] = {"lagrangian": sp.Integer(0), "dissipation": sp.Integer(0)}
        for term, value in zip(terms, values, strict=True):
            parts[term.kind] += value * term.expr
        return cls(parts["lagrangian"], parts["dissipation"], coordinates, parameters, prescribed)

    def _neutral(self, expr: sp.Expr) -> sp.Expr:
        """An expression in the symbols of the coordinates, in those of `q` and `qdot`."""
        swap = dict(zip([*self._named[0], *self._named[1]], [*self.q, *self.qdot], strict=True))
        return expr.replace(sp.Abs, RealAbs).xreplace(swap)

    @property
    def state(self) -> list[sp.Symbol]:
        """The symbols `q` and `qdot`, and the time if the law depends on it."""
        return [*self.q, *self.qdot, *([time_symbol] if self.timed else [])]

    @cached_property
    def momentum(self) -> list[sp.Expr]:
        """∂L/∂q̇_i."""
        return [sp.diff(self._lagrangian, v) for v in self.qdot]

    @cached_property
    def mass(self) -> list[list[sp.Expr]]:
        """M_ij, symmetric except for the rows of prescribed coordinates."""
        n = self.n_dof
        upper = {(i, j): sp.diff(self.momentum[i], self.qdot[j]) for i in range(n) for j in range(i, n)}
        rows = [[upper[min(i, j), max(i, j)] for j in range(n)] for i in range(n)]
        for i in self.prescribed:
            rows[i] = [sp.Integer(int(i == j)) for j in range(n)]
        return rows

    @cached_property
    def right(self) -> list[sp.Expr]:
        """r_i, multiplied out where many products of ∂L/∂q and dp/dt cancel.

        Where few do, as along a chain of relative angles, the factors are shared and cost less.
        """
        right = [
            sp.diff(self._lagrangian, self.q[i])
            - sp.diff(self._dissipation, self.qdot[i])
            - sp.Add(*(sp.diff(self.momentum[i], x) * v for x, v in zip(self.q, self.qdot, strict=True)))
            - sp.diff(self.momentum[i], time_symbol)
            if i not in self.prescribed
            else sp.Integer(0)
            for i in range(self.n_dof)
        ]
        multiplied = [sp.expand_mul(r) for r in right]
        operations, fewer = (sum(map(sp.count_ops, form)) for form in (right, multiplied))
        return multiplied if fewer < 0.8 * operations else right

    @cached_property
    def energy_expression(self) -> sp.Expr:
        """Σ_i q̇_i ∂L/∂q̇_i − L, without products that cancel."""
        return sp.expand_mul(
            sp.Add(*(v * p for v, p in zip(self.qdot, self.momentum, strict=True))) - self._lagrangian
        )

    def equations(self, forces: bool) -> tuple[sp.Eq, ...]:
        """Equations in the symbols of the coordinates: solved for q̈ up to three coordinates.

        Prescribed coordinates have no equation; their accelerations remain in the other equations.
        """
        q, qdot, qddot = self._named
        back = dict(zip([*self.q, *self.qdot], [*q, *qdot], strict=True))

        def named(expr: sp.Expr) -> sp.Expr:
            return expr.replace(RealAbs, sp.Abs).replace(RealSign, sp.sign).xreplace(back)

        free = [i for i in range(self.n_dof) if i not in self.prescribed]
        mass = sp.Matrix(len(free), len(free), lambda i, j: named(self.mass[free[i]][free[j]]))
        right = sp.Matrix(
            [
                named(self.right[i]) - sp.Add(*(named(self.mass[i][j]) * qddot[j] for j in self.prescribed))
                for i in free
            ]
        )
        if forces:
            right += sp.Matrix([sp.Symbol(f"{q[i].name}_force", real=True) for i in free])
        accelerations = [qddot[i] for i in free]
        if len(free) > 3:
            left = mass * sp.Matrix(accelerations)
            return tuple(sp.Eq(a, b, evaluate=False) for a, b in zip(left, right, strict=True))
        if mass.is_diagonal():
            solved = [right[i] / mass[i, i] for i in range(len(free))]
        else:
            solved = list(mass.adjugate() * right / mass.det())
        return tuple(
            sp.Eq(a, sp.sympify(b), evaluate=False) for a, b in zip(accelerations, solved, strict=True)
        )

    @cached_property
    def _equations_function(self) -> Callable[..., list[Any]]:
        return self.compile([*(entry for row in self.mass for entry in row), *self.right], self.parameters)

    @cached_property
    def _slopes_function(self) -> Callable[..., list[Any]]:
        return self._compiled_slopes([*self.q, *self.qdot])

    @cached_property
    def _all_slopes_function(self) -> Callable[..., list[Any]]:
        return self._compiled_slopes([*self.q, *self.qdot, *self.parameters])

    def _compiled_slopes(self, symbols: Sequence[sp.Symbol]) -> Callable[..., list[Any]]:
        held = [sp.Symbol(f"a_{i}", real=True) for i in range(self.n_dof)]
        rows = [
            right - sp.Add(*(m * a for m, a in zip(row, held, strict=True)))
            for row, right in zip(self.mass, self.right, strict=True)
        ]
        return self.compile([sp.diff(row, x) for row in rows for x in symbols], [*held, *self.parameters])

    @cached_property
    def _energy_function(self) -> Callable[..., list[Any]]:
        return self.compile([self.energy_expression])

    @cached_property
    def _friction_power_function(self) -> Callable[..., list[Any]]:
        return self.compile([sp.Add(*(v * sp.diff(self._dissipation, v) for v in self.qdot))])

    def compile(
        self, expressions: Sequence[sp.Expr], more: Sequence[sp.Symbol] = ()
    ) -> Callable[..., list[Any]]:
        """Return a function of the entries of `state`, and `more`, to a list of values."""
        printer = _Printer(
            {"fully_qualified_modules": False, "inline": True, "allow_unknown_functions": True}
        )
        return sp.lambdify(
            [*self.state, *more], list(expressions), modules="numpy", printer=printer, cse=True
        )

    def _columns(self, q: np.ndarray, qdot: np.ndarray, t: Any) -> list[Any]:
        """Values of the symbols of `state`; each has the shape (...) or is broadcast to it."""
        columns = [x[..., i] for x in (q, qdot) for i in range(self.n_dof)]
        if not self.timed:
            return columns
        if t is None:
            raise ValueError("the law depends on the time; give t")
        return [*columns, t]

    def mass_and_right(
        self, q: np.ndarray, qdot: np.ndarray, parameters: Iterable[np.ndarray] = (), t: Any = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return M, shape (..., n_dof, n_dof), and r, shape (..., n_dof), of float arrays of one shape.

        ``parameters`` and ``t`` have values of a shape that can be broadcast to (...).
        """
        n = self.n_dof
        with np.errstate(all="ignore"):
            values = iter(self._equations_function(*self._columns(q, qdot, t), *parameters))
        mass, right = np.empty((*q.shape, n), _real(q)), np.empty(q.shape, _real(q))
        for i, j in product(range(n), repeat=2):
            mass[..., i, j] = next(values)
        for i in range(n):
            right[..., i] = next(values)
        return mass, right

    def slopes(
        self,
        q: np.ndarray,
        qdot: np.ndarray,
        qddot: np.ndarray,
        t: Any = None,
        parameters: Iterable[np.ndarray] = (),
        *,
        of_parameters: bool = False,
    ) -> np.ndarray:
        """Return ∂(r − M q̈)/∂(q, q̇) at constant q̈, shape (..., n_dof, 2 n_dof).

        With ``of_parameters``, those in the parameters follow: (..., n_dof, 2 n_dof + n_parameters).
        """
        held = [qddot[..., i] for i in range(self.n_dof)]
        function = self._all_slopes_function if of_parameters else self._slopes_function
        with np.errstate(all="ignore"):
            values = function(*self._columns(q, qdot, t), *held, *parameters)
        out = np.empty((*q.shape, len(values) // self.n_dof), _real(q))
        for k, value in enumerate(values):
            out[(..., *divmod(k, out.shape[-1]))] = value
        return out

    def mass_matrix(self, q: np.ndarray, qdot: np.ndarray, t: Any = None) -> np.ndarray:
        """Return M, shape (..., n_dof, n_dof)."""
        return self.mass_and_right(q, qdot, t=t)[0]

    def acceleration(
        self,
        q: np.ndarray,
        qdot: np.ndarray,
        forces: np.ndarray | None = None,
        t: Any = None,
        parameters: Iterable[np.ndarray] = (),
    ) -> np.ndarray:
        """Return q̈; NaN where the mass matrix is exactly singular."""
        if self.n_dof > 2:
            mass, right = self.mass_and_right(q, qdot, parameters, t)
            return solve(mass, (right if forces is None else right + forces)[..., None])[..., 0]
        # Simulations call this for few states at a time; columns then take half the time of matrices.
        out = np.empty(q.shape if forces is None else np.broadcast(q, forces).shape, _real(q))
        with np.errstate(all="ignore"):
            values = self._equations_function(*self._columns(q, qdot, t), *parameters)
            right = values[self.n_dof**2 :]
            if forces is not None:
                right = [r + forces[..., i] for i, r in enumerate(right)]
            if self.n_dof == 1:
                solved, pivot = right, values[0]
            else:
                a, b, c, d = values[:4]
                solved, pivot = [d * right[0] - b * right[1], a * right[1] - c * right[0]], a * d - b * c
            if np.count_nonzero(pivot) < np.size(pivot):
                pivot = np.where(np.equal(pivot, 0), np.nan, pivot)
            for i, value in enumerate(solved):
                out[..., i] = value / pivot
        return out

    def energy(self, q: np.ndarray, qdot: np.ndarray, t: Any = None) -> np.ndarray:
        """Return q̇·∂L/∂q̇ − L, shape (...)."""
        return self._values(self._energy_function, q, qdot, t)[0]

    def friction_power(self, q: np.ndarray, qdot: np.ndarray, t: Any = None) -> np.ndarray:
        """Return q̇·∂ψ/∂q̇, shape (...): the rate at which friction takes energy."""
        return self._values(self._friction_power_function, q, qdot, t)[0]

    def evaluate(
        self, expressions: Iterable[sp.Expr], q: np.ndarray, qdot: np.ndarray, t: Any = None
    ) -> np.ndarray:
        """Return values of expressions in the symbols of the coordinates, shape (n_expressions, ...)."""
        return self._values(self.compile([self._neutral(expr) for expr in expressions]), q, qdot, t)

    def _values(
        self, function: Callable[..., list[Any]], q: np.ndarray, qdot: np.ndarray, t: Any
    ) -> np.ndarray:
        with np.errstate(all="ignore"):
            values = function(*self._columns(q, qdot, t))
        return np.array([np.broadcast_to(value, q.shape[:-1]) for value in values], dtype=float)


def _real(values: np.ndarray) -> type[np.floating]:
    """Single precision for values in it, double precision for other numbers."""
    return np.float32 if values.dtype == np.float32 else np.float64


def solve(mass: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return M⁻¹ times a matrix, for stacks of both; not finite where M is exactly singular."""
    if mass.shape[-1] == 2:  # by columns, which is ten times as fast as by matrices
        (a, b), (c, d) = np.moveaxis(mass, (-2, -1), (0, 1))[..., None]
        one, two = np.moveaxis(right, -2, 0)
        with np.errstate(all="ignore"):
            return np.stack([d * one - b * two, a * two - c * one], axis=-2) / (a * d - b * c)[..., None]
    try:
        return np.linalg.solve(mass, right)
    except np.linalg.LinAlgError:
        # A singular matrix must not affect the others.
        singular = np.linalg.det(mass)[..., None, None] == 0
        safe = np.where(singular, np.eye(mass.shape[-1]), mass)
        return np.where(singular, np.nan, np.linalg.solve(safe, right))
