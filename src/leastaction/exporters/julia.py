"""A model as a Julia module that needs the standard library only."""

from __future__ import annotations

import sympy as sp

from leastaction.exporters.shared import CPrinter, about, assignments, clock, equations
from leastaction.model.model import LagrangianModel

__all__ = ["CaretPrinter", "write"]


class CaretPrinter(CPrinter):
    """Scalar code of the languages that write powers with ``^``."""

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


_FUNCTIONS = """
"Accelerations of one state; forces may be left out."
function acceleration(q, qdot{t}, forces = nothing)
    mass, right = _equations(q, qdot{t})
    return mass \\ (forces === nothing ? right : right .+ forces)
end

"Mass matrix at a state."
mass_matrix(q, qdot{t}) = _equations(q, qdot{t})[1]

"Derivative of x = [q; qdot] in place, as ODEProblem calls it; p: nothing, forces, or a function of t."
function state_derivative!(dx, x, p, t)
    q, qdot = view(x, 1:{n}), view(x, {first}:{last})
    dx[1:{n}] .= qdot
    dx[{first}:{last}] .= acceleration(q, qdot{t}, p isa Function ? p(t) : p)
    return nothing
end

end
"""


def write(model: LagrangianModel) -> str:
    """Return the module."""
    n, mechanics, t = model.n_dof, model.mechanics, clock(model.mechanics)

    def body(expressions):
        return assignments(expressions, mechanics, CaretPrinter().doprint, "{array}[{i}]", 1)

    lines = [
        *(f"# {line}" for line in about(model, "q[{i}]", 1)),
        "module LeastactionModel",
        "",
        "export acceleration, energy, mass_matrix, state_derivative!",
        "",
        f"const N_DOF = {n}",
        "",
    ]
    first, values = body(equations(mechanics))
    # Column by column with commas: in [a -b] a blank would begin another entry.
    columns = ", ".join(values[j * n + i] for i in range(n) for j in range(n))
    lines += [
        f"function _equations(q, qdot{t})",
        *(f"    {name} = {value}" for name, value in first),
        f"    mass = reshape([{columns}], {n}, {n})",
        f"    right = [{', '.join(values[n * n :])}]",
        "    return float(mass), float(right)",
        "end",
        "",
        '"Energy: the sum of qdot * dL/dqdot, less L."',
        f"function energy(q, qdot{t})",
    ]
    first, values = body([mechanics.energy_expression])
    lines += [*(f"    {name} = {value}" for name, value in first), f"    return {values[0]}", "end"]
    return "\n".join(lines) + "\n" + _FUNCTIONS.format(n=n, first=n + 1, last=2 * n, t=t)
