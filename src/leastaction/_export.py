"""A model as text for other programs: SymPy, LaTeX, Python and C."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from difflib import get_close_matches

import sympy as sp
from sympy.printing.c import C99CodePrinter
from sympy.printing.pycode import PythonCodePrinter, SymPyPrinter

from leastaction._errors import InputError
from leastaction._library import format_expression
from leastaction._model import LagrangianModel
from leastaction._names import quoted
from leastaction.io import write_text

__all__ = ["FORMATS", "export"]


def export(model: LagrangianModel, format: str, path: str | os.PathLike[str] | None = None) -> str:
    """Write a model as text that needs nothing of leastaction.

    ============  =========================================================================================
    format        content
    ============  =========================================================================================
    ``"sympy"``   a Python script that makes ``lagrangian`` and ``dissipation_function`` with SymPy, over real
                  symbols with the names of the coordinates and ``<coordinate>_dot``; all digits are kept
    ``"latex"``   L and ψ as a displayed formula (needs the package amsmath), rounded to their errors
    ``"python"``  a module that imports only `math`: ``acceleration(q, qdot, forces=None)`` -> list and
                  ``energy(q, qdot)`` -> float of plain sequences
    ``"c"``       C99 that needs only ``math.h``: ``void leastaction_acceleration(q, qdot, forces, qddot)``,
                  ``double leastaction_energy(q, qdot)`` of arrays; ``forces`` may be ``NULL``
    ============  =========================================================================================

    Where the mass matrix is exactly singular the accelerations are NaN; where a function is not defined
    (logarithm of a negative number), C returns NaN and Python raises what `math` raises.

    Parameters
    ----------
    model : LagrangianModel
    format : {"sympy", "latex", "python", "c"}
    path : path, optional
        File to write the text to.

    Returns
    -------
    str
        The text.

    Raises
    ------
    InputError
        If there is no such format, or the file cannot be written.

    Examples
    --------
    >>> from leastaction._model import LagrangianModel, ModelTerm
    >>> spring = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
    >>> print(export(spring, "sympy"))
    # Written by leastaction.
    import sympy
    <BLANKLINE>
    x, x_dot = sympy.symbols("x x_dot", real=True)
    lagrangian = -2.0*x**2 + 0.5*x_dot**2
    dissipation_function = sympy.Integer(0)
    <BLANKLINE>
    >>> namespace = {}
    >>> exec(export(spring, "python"), namespace)
    >>> namespace["acceleration"]([1.0], [0.0], [3.0])
    [-1.0]
    """
    if not isinstance(model, LagrangianModel):
        raise InputError(f"model is of type {type(model).__name__}; expected a LagrangianModel")
    if not isinstance(format, str) or format not in _WRITERS:
        near = get_close_matches(str(format)[:40].lower(), FORMATS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"format is {quoted(format)}; expected one of {', '.join(FORMATS)}{hint}")
    text = _WRITERS[format](model)
    if path is not None:
        write_text(path, text)
    return text


def _sympy(model: LagrangianModel) -> str:
    names = [*model.coordinates, *(f"{c}_dot" for c in model.coordinates)]
    # A coordinate may have the name of anything else in the script.
    module, lagrangian, dissipation = (
        _unused(name, names) for name in ("sympy", "lagrangian", "dissipation_function")
    )
    printer = _SymPyPrinter(module)
    psi = printer.doprint(model.dissipation_function) if model.dissipation else f"{module}.Integer(0)"
    return (
        "# Written by leastaction.\n"
        f"import sympy{'' if module == 'sympy' else f' as {module}'}\n\n"
        f'{", ".join(names)} = {module}.symbols("{" ".join(names)}", real=True)\n'
        f"{lagrangian} = {printer.doprint(model.lagrangian)}\n"
        f"{dissipation} = {psi}\n"
    )


def _unused(name: str, taken: Sequence[str]) -> str:
    while name in taken:
        name += "_"
    return name


class _SymPyPrinter(SymPyPrinter):
    def __init__(self, module: str) -> None:
        super().__init__({"fully_qualified_modules": True})
        self.module = module

    def _module_format(self, fqn, register=True):
        return f"{self.module}.{fqn.rpartition('.')[2]}"

    def _print_Float(self, expr):
        return repr(float(expr))

    def _print_Rational(self, expr):
        return f"{self.module}.Rational({expr.p}, {expr.q})"

    def _print_Pi(self, expr):
        return f"{self.module}.pi"

    def _print_Exp1(self, expr):
        return f"{self.module}.E"


def _latex(model: LagrangianModel) -> str:
    return f"% Written by leastaction; needs amsmath.\n\\[\n{model.latex()}\n\\]\n"


def _about(model: LagrangianModel) -> list[str]:
    """What the file holds, for its comments: plain ASCII, whatever the coordinates are called."""
    lines = ["Equations of motion  d/dt dL/dqdot - dL/dq = forces - dpsi/dqdot, written by leastaction."]
    lines += [f"q[{i}]: {name}" for i, name in enumerate(model.coordinates)]
    groups = (
        ("L", model.terms, model.expressions),
        ("psi", model.dissipation, model.dissipation_expressions),
    )
    for name, terms, expressions in groups:
        for k, (term, expr) in enumerate(zip(terms, expressions, strict=True)):
            start = f"{name} = " if k == 0 else " " * len(name) + " + "
            lines.append(f"{start}{term.coefficient!r} * ({format_expression(expr)})")
    return [line.encode("ascii", "backslashreplace").decode().replace("*/", "* /") for line in lines]


def _assignments(
    expressions: Sequence[sp.Expr], model: LagrangianModel, write: Callable[[sp.Expr], str]
) -> tuple[list[tuple[str, str]], list[str]]:
    """Return (name, code) for what has to be computed first, and the code of the expressions."""
    shared, reduced = sp.cse(
        [sp.sympify(e) for e in expressions], symbols=sp.numbered_symbols("c_", real=True)
    )
    used = set().union(*(e.free_symbols for e in [*reduced, *(e for _, e in shared)]))
    mechanics = model.mechanics
    lines = []
    for array, symbols in (("q", mechanics.q), ("qdot", mechanics.qdot)):
        lines += [(str(symbol), f"{array}[{i}]") for i, symbol in enumerate(symbols) if symbol in used]
    lines += [(str(symbol), write(expr)) for symbol, expr in shared]
    return lines, [write(expr) for expr in reduced]


def _equations(model: LagrangianModel) -> list[sp.Expr]:
    """Mass matrix row by row, then the right-hand side."""
    mechanics = model.mechanics
    return [*(entry for row in mechanics.mass for entry in row), *mechanics.right]


class _CodeMixin:
    """What the printers of Python and C have in common."""

    def _print_Float(self, expr):
        return repr(float(expr))

    def _print_NumberSymbol(self, expr):
        return repr(float(expr))

    _print_Pi = _print_Exp1 = _print_NumberSymbol

    def _print_RealSign(self, expr):
        argument = self._print(expr.args[0])  # type: ignore[attr-defined]
        return f"(({argument} > 0) - ({argument} < 0))"


class _PythonPrinter(_CodeMixin, PythonCodePrinter):
    def __init__(self) -> None:
        super().__init__({"fully_qualified_modules": True})  # type: ignore[call-arg]

    def _print_RealAbs(self, expr):
        return f"abs({self._print(expr.args[0])})"

    def _print_Pow(self, expr, rational=False):
        if expr.exp.is_Integer or abs(expr.exp) == sp.S.Half:
            return super()._print_Pow(expr, rational)
        # A negative number to such a power must not become complex.
        return f"math.pow({self._print(expr.base)}, {self._print(expr.exp)})"


class _CPrinter(_CodeMixin, C99CodePrinter):
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


_PYTHON_SOLVE = '''

def _solve(a, b):
    """Gaussian elimination with partial pivoting; NaN if the matrix is singular."""
    n = len(b)
    for k in range(n):
        p = max(range(k, n), key=lambda i: abs(a[i][k]))
        if a[p][k] == 0:
            return [math.nan] * n
        a[k], a[p], b[k], b[p] = a[p], a[k], b[p], b[k]
        for i in range(k + 1, n):
            factor = a[i][k] / a[k][k]
            for j in range(k + 1, n):
                a[i][j] -= factor * a[k][j]
            b[i] -= factor * b[k]
    for i in reversed(range(n)):
        b[i] = (b[i] - sum(a[i][j] * b[j] for j in range(i + 1, n))) / a[i][i]
    return b
'''


def _python(model: LagrangianModel) -> str:
    n = model.n_dof
    write = _PythonPrinter().doprint
    lines = [*(f"# {line}" for line in _about(model)), "import math", "", f"N_DOF = {n}", "", ""]
    first, values = _assignments(_equations(model), model, write)
    rows = ", ".join(f"[{', '.join(values[i * n : (i + 1) * n])}]" for i in range(n))
    lines += [
        "def acceleration(q, qdot, forces=None):",
        f'    """Accelerations, a list; q, qdot and forces are sequences of length {n}."""',
        *(f"    {name} = {code}" for name, code in first),
        f"    mass = [{rows}]",
        f"    right = [{', '.join(values[n * n :])}]",
        "    if forces is not None:",
        "        right = [r + f for r, f in zip(right, forces)]",
        "    return _solve(mass, right)",
        "",
        "",
    ]
    first, values = _assignments([model.mechanics.energy_expression], model, write)
    lines += [
        "def energy(q, qdot):",
        '    """Energy, the sum of qdot * dL/dqdot, less L."""',
        *(f"    {name} = {code}" for name, code in first),
        f"    return {values[0]}",
    ]
    return "\n".join(lines) + "\n" + _PYTHON_SOLVE


_C_SOLVE = """
    /* Gaussian elimination with partial pivoting. */
    for (int k = 0; k < n; k++) {
        int p = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i][k]) > fabs(a[p][k])) p = i;
        if (a[p][k] == 0.0) {
            for (int i = 0; i < n; i++) qddot[i] = NAN;
            return;
        }
        for (int j = k; j < n; j++) {
            const double swap = a[k][j];
            a[k][j] = a[p][j];
            a[p][j] = swap;
        }
        const double swap = b[k];
        b[k] = b[p];
        b[p] = swap;
        for (int i = k + 1; i < n; i++) {
            const double factor = a[i][k] / a[k][k];
            for (int j = k + 1; j < n; j++) a[i][j] -= factor * a[k][j];
            b[i] -= factor * b[k];
        }
    }
    for (int i = n - 1; i >= 0; i--) {
        double sum = b[i];
        for (int j = i + 1; j < n; j++) sum -= a[i][j] * qddot[j];
        qddot[i] = sum / a[i][i];
    }
}
"""


def _c(model: LagrangianModel) -> str:
    n = model.n_dof
    write = _CPrinter().doprint
    lines = ["/*", *(f" * {line}" for line in _about(model)), " * C99; link with -lm.", " */"]
    lines += ["#include <math.h>", "#include <stddef.h>", ""]
    first, values = _assignments(_equations(model), model, write)
    rows = ",\n        ".join(f"{{{', '.join(values[i * n : (i + 1) * n])}}}" for i in range(n))
    lines += [
        "/* Accelerations qddot; forces may be NULL. NaN where the mass matrix is singular. */",
        f"void leastaction_acceleration(const double q[{n}], const double qdot[{n}],",
        f"                              const double forces[{n}], double qddot[{n}])",
        "{",
        f"    enum {{ n = {n} }};",
        *(f"    const double {name} = {code};" for name, code in first),
        f"    double a[n][n] = {{\n        {rows}}};",
        f"    double b[n] = {{{', '.join(values[n * n :])}}};",
        "    (void)q;",
        "    (void)qdot;",
        "    if (forces != NULL)",
        "        for (int i = 0; i < n; i++) b[i] += forces[i];",
    ]
    first, values = _assignments([model.mechanics.energy_expression], model, write)
    energy = [
        "",
        "/* Energy: the sum of qdot * dL/dqdot, less L. */",
        f"double leastaction_energy(const double q[{n}], const double qdot[{n}])",
        "{",
        *(f"    const double {name} = {code};" for name, code in first),
        "    (void)q;",
        "    (void)qdot;",
        f"    return {values[0]};",
        "}",
    ]
    return "\n".join(lines) + _C_SOLVE + "\n".join(energy) + "\n"


_WRITERS: dict[str, Callable[[LagrangianModel], str]] = {
    "sympy": _sympy,
    "latex": _latex,
    "python": _python,
    "c": _c,
}

FORMATS = tuple(_WRITERS)
"""Names of the formats."""
