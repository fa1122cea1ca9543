"""A model as a Python module that makes CasADi functions."""

from __future__ import annotations

import sympy as sp

from leastaction.exporters.shared import about, assignments, clock, equations
from leastaction.model.model import LagrangianModel
from leastaction.simulation.law import PythonPrinter

__all__ = ["CasadiPrinter", "write"]


class CasadiPrinter(PythonPrinter):
    """Python code over `casadi`, with all digits of the numbers."""

    def _module_format(self, fqn, register=True):
        return f"casadi.{fqn.rpartition('.')[2]}"

    def _print_RealAbs(self, expr):
        return f"casadi.fabs({self._print(expr.args[0])})"

    def _print_RealSign(self, expr):
        return f"casadi.sign({self._print(expr.args[0])})"

    def _print_Pow(self, expr, rational=False):
        if expr.exp.is_Integer or abs(expr.exp) == sp.S.Half:
            return super()._print_Pow(expr, rational)
        return f"({self._print(expr.base)})**({self._print(expr.exp)})"


_FUNCTIONS = """

def _functions():
    q = casadi.SX.sym("q", N_DOF)
    qdot = casadi.SX.sym("qdot", N_DOF)
    forces = casadi.SX.sym("forces", N_DOF)
{symbol}    mass, right = _equations(q, qdot{t})
    if casadi.sprank(mass) < N_DOF:  # singular everywhere
        qddot = casadi.SX.nan(N_DOF, 1)
    else:
        qddot = casadi.solve(mass, right + forces)
    state, names = [q, qdot{t}], ["q", "qdot"{name}]
    return (
        casadi.Function("acceleration", [*state, forces], [qddot], [*names, "forces"], ["qddot"]),
        casadi.Function("energy", state, [_energy(q, qdot{t})], names, ["energy"]),
        casadi.Function("mass_matrix", state, [casadi.densify(mass)], names, ["mass"]),
    )


acceleration, energy, mass_matrix = _functions()
"""


def write(model: LagrangianModel) -> str:
    """Return the module."""
    n, mechanics = model.n_dof, model.mechanics
    code, t = CasadiPrinter().doprint, clock(mechanics)
    lines = [
        *(f"# {line}" for line in about(model)),
        f"# Functions of casadi: acceleration(q, qdot{t}, forces), energy(q, qdot{t}), "
        f"mass_matrix(q, qdot{t}).",
        "import casadi",
        "",
        f"N_DOF = {n}",
        "",
        "",
    ]
    first, values = assignments(equations(mechanics), mechanics, code)
    rows = ", ".join(f"casadi.horzcat({', '.join(values[i * n : (i + 1) * n])})" for i in range(n))
    lines += [
        f"def _equations(q, qdot{t}):",
        *(f"    {name} = {value}" for name, value in first),
        f"    mass = casadi.SX(casadi.vertcat({rows}))",
        f"    right = casadi.SX(casadi.vertcat({', '.join(values[n * n :])}))",
        "    return casadi.sparsify(mass), right",
        "",
        "",
    ]
    first, values = assignments([mechanics.energy_expression], mechanics, code)
    lines += [
        f"def _energy(q, qdot{t}):",
        *(f"    {name} = {value}" for name, value in first),
        f"    return casadi.SX({values[0]})",
    ]
    symbol = '    t = casadi.SX.sym("t")\n' if t else ""
    functions = _FUNCTIONS.format(t=t, symbol=symbol, name=clock(mechanics, '"t"'))
    return "\n".join(lines) + "\n" + functions
