"""A model as Python: a module that imports only `math`, functions for JAX, and a script for SymPy."""

from __future__ import annotations

import sympy as sp
from sympy.printing.pycode import SymPyPrinter

from leastaction.exporters.shared import about, assignments, clock, equations, unused
from leastaction.identifiers import TIME, names_in_terms
from leastaction.model.model import LagrangianModel
from leastaction.simulation.law import PythonPrinter

__all__ = ["write", "write_jax", "write_sympy"]

_SOLVE = '''

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


def write(model: LagrangianModel) -> str:
    """Return the module that imports only `math`."""
    n, mechanics = model.n_dof, model.mechanics
    code, t = PythonPrinter().doprint, clock(mechanics)
    lines = [*(f"# {line}" for line in about(model)), "import math", "", f"N_DOF = {n}", "", ""]
    first, values = assignments(equations(mechanics), mechanics, code)
    rows = ", ".join(f"[{', '.join(values[i * n : (i + 1) * n])}]" for i in range(n))
    lines += [
        f"def acceleration(q, qdot{t}, forces=None):",
        f'    """Accelerations, a list; q, qdot and forces are sequences of length {n}."""',
        *(f"    {name} = {value}" for name, value in first),
        f"    mass = [{rows}]",
        f"    right = [{', '.join(values[n * n :])}]",
        "    if forces is not None:",
        "        right = [r + f for r, f in zip(right, forces)]",
        "    return _solve(mass, right)",
        "",
        "",
    ]
    first, values = assignments([mechanics.energy_expression], mechanics, code)
    lines += [
        f"def energy(q, qdot{t}):",
        '    """Energy, the sum of qdot * dL/dqdot, minus L."""',
        *(f"    {name} = {value}" for name, value in first),
        f"    return {values[0]}",
    ]
    return "\n".join(lines) + "\n" + _SOLVE


class _JaxPrinter(PythonPrinter):
    """Python code over `jax.numpy`, with all digits of the numbers."""

    def _module_format(self, fqn, register=True):
        return f"jnp.{fqn.rpartition('.')[2]}"

    def _print_RealAbs(self, expr):
        return f"jnp.abs({self._print(expr.args[0])})"

    def _print_RealSign(self, expr):
        return f"jnp.sign({self._print(expr.args[0])})"

    def _print_Pow(self, expr, rational=False):
        if abs(expr.exp) == sp.S.Half:
            return super()._print_Pow(expr, rational)
        return f"({self._print(expr.base)})**({self._print(expr.exp)})"


_JAX = '''

def mass_matrix(q, qdot{t}):
    """Mass matrix, shape ({n}, {n})."""
    return _equations(q, qdot{t})[0]


def acceleration(q, qdot{t}, forces=None):
    """Accelerations, shape ({n},); not finite where the mass matrix is singular."""
    mass, right = _equations(q, qdot{t})
    if forces is not None:
        right = right + jnp.asarray(forces)
    return jnp.linalg.solve(mass, right)


def state_derivative(t, x, forces=None):
    """Derivative of x = [q, qdot], for integrators that call f(t, x, args)."""
    q, qdot = x[:{n}], x[{n}:]
    return jnp.concatenate([qdot, acceleration(q, qdot{t}, forces)])
'''


def write_jax(model: LagrangianModel) -> str:
    """Return the module over `jax.numpy`."""
    n, mechanics = model.n_dof, model.mechanics
    code, t = _JaxPrinter().doprint, clock(mechanics)
    lines = [
        *(f"# {line}" for line in about(model)),
        "# Functions of one state, for jax.vmap, jax.grad, jax.jacobian and jax.jit.",
        '# JAX uses single precision by default; see jax.config.update("jax_enable_x64", True).',
        "import jax.numpy as jnp",
        "",
        f"N_DOF = {n}",
        "",
        "",
    ]
    first, values = assignments(equations(mechanics), mechanics, code)
    rows = ", ".join(f"[{', '.join(values[i * n : (i + 1) * n])}]" for i in range(n))
    lines += [
        f"def _equations(q, qdot{t}):",
        *(f"    {name} = {value}" for name, value in first),
        f"    right = [{', '.join(values[n * n :])}]",
        f"    return jnp.array([{rows}], dtype=float), jnp.array(right, dtype=float)",
        "",
        "",
    ]
    first, values = assignments([mechanics.energy_expression], mechanics, code)
    lines += [
        f"def energy(q, qdot{t}):",
        '    """Energy, the sum of qdot * dL/dqdot, minus L."""',
        *(f"    {name} = {value}" for name, value in first),
        f"    return {values[0]}",
    ]
    return "\n".join(lines) + "\n" + _JAX.format(n=n, t=t)


def write_sympy(model: LagrangianModel) -> str:
    """Return the script that defines L and ψ over SymPy."""
    names = names_in_terms(model.coordinates)
    if not model.timed:
        names.remove(TIME)
    # A coordinate may have any name that the script uses.
    module, lagrangian, dissipation = (
        unused(name, names) for name in ("sympy", "lagrangian", "dissipation_function")
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
