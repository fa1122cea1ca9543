"""Common parts of the formats: equations with common subexpressions, and comments."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import sympy as sp
from sympy.printing.c import C99CodePrinter

from leastaction.findings import as_given
from leastaction.library import format_expression
from leastaction.mechanics.equations import Mechanics
from leastaction.model.model import LagrangianModel
from leastaction.model.text import smoothing_notes
from leastaction.simulation.law import CodeMixin

__all__ = ["CPrinter", "MathPrinter", "about", "assignments", "clock", "equations", "unused"]


def unused(name: str, taken: Sequence[str]) -> str:
    """Return the name, with underscores behind it if it is taken."""
    while name in taken:
        name += "_"
    return name


def about(model: LagrangianModel, element: str = "q[{i}]", base: int = 0) -> list[str]:
    """Description of the file for its comments, in plain ASCII for any names of coordinates."""
    lines = ["Equations of motion  d/dt dL/dqdot - dL/dq = forces - dpsi/dqdot, written by leastaction."]
    for i, name in enumerate(model.coordinates):
        driven = (
            "; its motion is prescribed: its force is its acceleration" if name in model.prescribed else ""
        )
        lines.append(f"{element.format(i=base + i)}: {name}{driven}")
    if model.timed:
        lines.append("t: time in seconds, as in the data")
    groups = (
        ("L", model.terms, model.expressions),
        ("psi", model.dissipation, model.dissipation_expressions),
    )
    widths = model.fit.smoothing_widths
    for name, terms, expressions in groups:
        for k, (term, expr) in enumerate(zip(terms, expressions, strict=True)):
            start = f"{name} = " if k == 0 else " " * len(name) + " + "
            lines.append(f"{start}{term.coefficient!r} * ({as_given(format_expression(expr), widths)})")
    # the code has the root that the note is about
    lines += smoothing_notes(model)
    return [line.encode("ascii", "backslashreplace").decode().replace("*/", "* /") for line in lines]


def clock(mechanics: Mechanics, name: str = "t") -> str:
    """The time as an argument after q and qdot; empty if the law does not depend on it."""
    return f", {name}" if mechanics.timed else ""


def equations(mechanics: Mechanics) -> list[sp.Expr]:
    """Mass matrix row by row, then the right-hand side."""
    return [*(entry for row in mechanics.mass for entry in row), *mechanics.right]


def assignments(
    expressions: Sequence[sp.Expr],
    mechanics: Mechanics,
    write: Callable[[sp.Expr], str],
    element: str = "{array}[{i}]",
    base: int = 0,
) -> tuple[list[tuple[str, str]], list[str]]:
    """Return (name, code) of common subexpressions, and the code of the expressions.

    `element` is the notation of an entry of the arrays q and qdot, and `base` its first index.
    """
    shared, reduced = sp.cse(
        [sp.sympify(e) for e in expressions], symbols=sp.numbered_symbols("c_", real=True)
    )
    used = set().union(*(e.free_symbols for e in [*reduced, *(e for _, e in shared)]))
    lines = []
    for array, symbols in (("q", mechanics.q), ("qdot", mechanics.qdot)):
        lines += [
            (str(symbol), element.format(array=array, i=base + i))
            for i, symbol in enumerate(symbols)
            if symbol in used
        ]
    lines += [(str(symbol), write(expr)) for symbol, expr in shared]
    return lines, [write(expr) for expr in reduced]


class CPrinter(CodeMixin, C99CodePrinter):
    def __init__(self) -> None:
        # The macros such as M_SQRT2 are not in the standard.
        super().__init__({"math_macros": {}})  # type: ignore[call-arg]

    def _print_RealAbs(self, expr):
        return f"fabs({self._print(expr.args[0])})"

    def _print_Integer(self, expr):
        return str(int(expr)) if abs(int(expr)) < 2**31 else repr(float(expr))

    def _print_Pow(self, expr):
        if expr.base.is_Symbol and expr.exp.is_Integer and 2 <= abs(expr.exp) <= 4:
            product = "*".join([self._print(expr.base)] * abs(int(expr.exp)))
            return f"({product})" if expr.exp > 0 else f"(1.0/({product}))"
        return super()._print_Pow(expr)


class MathPrinter(CPrinter):
    """Scalar code of languages with ``^`` for powers: Julia, Modelica, MATLAB."""

    def _print_RealAbs(self, expr):
        return f"abs({self._print(expr.args[0])})"

    def _print_RealSign(self, expr):
        return f"sign({self._print(expr.args[0])})"

    def _print_Pow(self, expr):
        base = self._print(expr.base)
        if abs(expr.exp) == sp.S.Half:
            return f"sqrt({base})" if expr.exp > 0 else f"(1.0/sqrt({base}))"
        if expr.exp.is_Integer and expr.exp < 0:
            return f"(1.0/({base})^{-expr.exp})"
        return f"(({base})^{self._print(expr.exp) if expr.exp.is_Integer else f'({self._print(expr.exp)})'})"
