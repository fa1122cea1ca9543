"""Export to Julia and Modelica, which share the same scalar code: powers with ^, arrays from 1."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from leastaction.exporters.shared import MathPrinter, about, assignments, clock, equations
from leastaction.model.model import LagrangianModel

__all__ = ["write_julia", "write_modelica"]


_FUNCTIONS = """
"Accelerations of one state; forces are optional."
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


def write_julia(model: LagrangianModel) -> str:
    """Return the module, which needs the standard library only."""
    n, mechanics, t = model.n_dof, model.mechanics, clock(model.mechanics)

    def body(expressions):
        return assignments(expressions, mechanics, MathPrinter().doprint, "{array}[{i}]", 1)

    lines = [
        *(f"# {line}" for line in about(model, "q[{i}]", 1)),
        "module LeastactionModel",
        "",
        "using LinearAlgebra",
        "",
        "export acceleration, energy, mass_matrix, state_derivative!",
        "",
        f"const N_DOF = {n}",
        "",
    ]
    first, values = body(equations(mechanics))
    # Column by column with commas, because a blank separates entries, as in [a -b].
    columns = ", ".join(values[j * n + i] for i in range(n) for j in range(n))
    lines += [
        f"function _equations(q, qdot{t})",
        *(f"    {name} = {value}" for name, value in first),
        f"    mass = reshape([{columns}], {n}, {n})",
        f"    right = [{', '.join(values[n * n :])}]",
        "    return float(mass), float(right)",
        "end",
        "",
        '"Energy: the sum of qdot * dL/dqdot, minus L."',
        f"function energy(q, qdot{t})",
    ]
    first, values = body([mechanics.energy_expression])
    lines += [*(f"    {name} = {value}" for name, value in first), f"    return {values[0]}", "end"]
    return "\n".join(lines) + "\n" + _FUNCTIONS.format(n=n, first=n + 1, last=2 * n, t=t)


_MOTION = """
  model Motion "The equations of motion; connect or set forces, and give the initial state"
    parameter Real q_start[{n}] = zeros({n}) "initial coordinates";
    parameter Real qdot_start[{n}] = zeros({n}) "initial velocities";
    input Real forces[{n}](start = zeros({n})) "generalised forces";
    Real q[{n}](start = q_start, each fixed = true);
    Real qdot[{n}](start = qdot_start, each fixed = true);
    Real qddot[{n}];
    Real stored "energy";
  equation
    der(q) = qdot;
    der(qdot) = qddot;
    mass_matrix(q, qdot{t}) * qddot = right_side(q, qdot{t}) + forces;
    stored = energy(q, qdot{t});
  end Motion;
end LeastactionModel;
"""


def write_modelica(model: LagrangianModel) -> str:
    """Return the package: functions of the state, and a model of the motion."""
    n, mechanics = model.n_dof, model.mechanics
    entries = equations(mechanics)
    lines = [
        *(f"// {line}" for line in about(model, "q[{i}]", 1)),
        'package LeastactionModel "A Lagrangian that leastaction found"',
    ]
    parts = (
        ("mass_matrix", "mass matrix", f"mass[{n}, {n}]", entries[: n * n]),
        (
            "right_side",
            "mass matrix times accelerations, without forces",
            f"right[{n}]",
            entries[n * n :],
        ),
        ("energy", "sum of qdot * dL/dqdot, minus L", "stored", [mechanics.energy_expression]),
    )
    for name, text, result, expressions in parts:
        lines += _function(model, name, text, result, expressions)
    t = ", time" if mechanics.timed else ""
    return "\n".join(lines) + "\n" + _MOTION.format(n=n, t=t)


def _function(
    model: LagrangianModel, name: str, text: str, result: str, expressions: Sequence[sp.Expr]
) -> list[str]:
    n, mechanics = model.n_dof, model.mechanics
    first, values = assignments(expressions, mechanics, MathPrinter().doprint, "{array}[{i}]", 1)
    array, _, size = result.partition("[")
    if not size:
        given = values[0]
    elif "," in size:
        given = "{" + ", ".join(f"{{{', '.join(values[i * n : (i + 1) * n])}}}" for i in range(n)) + "}"
    else:
        given = "{" + ", ".join(values) + "}"
    return [
        "",
        f'  function {name} "{text}"',
        f"    input Real q[{n}];",
        f"    input Real qdot[{n}];",
        *(["    input Real t;"] if mechanics.timed else []),
        f"    output Real {result};",
        *(["  protected"] if first else []),
        *(f"    Real {variable};" for variable, _ in first),
        "  algorithm",
        *(f"    {variable} := {code};" for variable, code in first),
        f"    {array} := {given};",
        f"  end {name};",
    ]
