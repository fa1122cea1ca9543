"""A model as a Modelica package: functions of the state, and a model that moves."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from leastaction.exporters.julia import CaretPrinter
from leastaction.exporters.shared import about, assignments, equations
from leastaction.model.model import LagrangianModel

__all__ = ["write"]

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


def write(model: LagrangianModel) -> str:
    """Return the package."""
    n, mechanics = model.n_dof, model.mechanics
    entries = equations(mechanics)
    rows = [entries[i * n : (i + 1) * n] for i in range(n)]
    lines = [
        *(f"// {line}" for line in about(model, "q[{i}]", 1)),
        'package LeastactionModel "A Lagrangian that leastaction found"',
    ]
    parts = (
        ("mass_matrix", "mass matrix", f"mass[{n}, {n}]", [e for row in rows for e in row]),
        (
            "right_side",
            "what the accelerations times the mass matrix are without forces",
            f"right[{n}]",
            entries[n * n :],
        ),
        ("energy", "sum of qdot * dL/dqdot, less L", "stored", [mechanics.energy_expression]),
    )
    for name, text, result, expressions in parts:
        lines += _function(model, name, text, result, expressions)
    t = ", time" if mechanics.timed else ""
    return "\n".join(lines) + "\n" + _MOTION.format(n=n, t=t)


def _function(
    model: LagrangianModel, name: str, text: str, result: str, expressions: Sequence[sp.Expr]
) -> list[str]:
    n, mechanics = model.n_dof, model.mechanics
    first, values = assignments(expressions, mechanics, CaretPrinter().doprint, "{array}[{i}]", 1)
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
