"""A model as a function file for MATLAB and Octave."""

from __future__ import annotations

import re

from leastaction.errors import InputError
from leastaction.exporters.shared import MathPrinter, about, assignments, clock, equations
from leastaction.identifiers import quoted
from leastaction.model.model import LagrangianModel

__all__ = ["write"]

_KEYWORD = re.compile(
    "break|case|catch|classdef|continue|else|elseif|end|for|function|global|if|otherwise|parfor|persistent"
    "|return|spmd|switch|try|while"
)


class _MatlabPrinter(MathPrinter):
    """Scalar code. Without a real result, the real* functions stop; others return complex numbers."""

    def _print_log(self, expr):
        return f"reallog({self._print(expr.args[0])})"

    def _print_Pow(self, expr):
        base, exponent = self._print(expr.base), self._print(expr.exp)
        if abs(expr.exp) == 0.5:
            return f"realsqrt({base})" if expr.exp > 0 else f"(1/realsqrt({base}))"
        if expr.exp.is_Integer:
            return f"(({base})^({exponent}))"
        return f"realpow({base}, {exponent})"


_FUNCTIONS = """
function qddot = acceleration(q, qdot{t}, forces)
[mass, right] = equations(q, qdot{t});
if nargin > {given}
    right = right + forces(:);
end
qddot = mass \\ right;
end

function xdot = state_derivative(t, x, forces)
q = x(1:{n});
qdot = x({first}:{last});
qdot = qdot(:);
if nargin < 3
    xdot = [qdot; acceleration(q, qdot{t})];
elseif isa(forces, 'function_handle')
    xdot = [qdot; acceleration(q, qdot{t}, forces(t))];
else
    xdot = [qdot; acceleration(q, qdot{t}, forces)];
end
end

function mass = mass_matrix(q, qdot{t})
if nargin < 2
    qdot = zeros({n}, 1);
end
[mass, right] = equations(q, qdot{t});
end
"""


def write(model: LagrangianModel, file: str | None = None) -> str:
    """Return the file; its name is that of the function.

    Raises
    ------
    InputError
        If MATLAB could not call a file of this name.
    """
    name = "leastaction_model" if file is None else _function_name(file)
    n, mechanics, t = model.n_dof, model.mechanics, clock(model.mechanics)
    lines = [
        f"function model = {name}()",
        *(f"% {line}" for line in about(model, "q({i})", 1)),
        "%",
        f"% model = {name}();",
        f"% qddot = model.acceleration(q, qdot{t}, forces)    forces are optional",
        "% xdot  = model.state_derivative(t, x, forces)   x = [q; qdot]; forces may be a function of t",
        f"% E     = model.energy(q, qdot{t})",
        f"% M     = model.mass_matrix(q, qdot{t})",
        "% [t, x] = ode45(@(t, x) model.state_derivative(t, x), [0 10], [q0; qdot0]);",
        "model.acceleration = @acceleration;",
        "model.state_derivative = @state_derivative;",
        "model.energy = @energy;",
        "model.mass_matrix = @mass_matrix;",
        "end",
    ]
    functions = _FUNCTIONS.format(n=n, first=n + 1, last=2 * n, t=t, given=3 if t else 2)

    def body(expressions):
        return assignments(expressions, mechanics, _MatlabPrinter().doprint, "{array}({i})", 1)

    first, values = body(equations(mechanics))
    rows = "; ".join(", ".join(values[i * n : (i + 1) * n]) for i in range(n))
    more = [
        "",
        f"function [mass, right] = equations(q, qdot{t})",
        *(f"{variable} = {value};" for variable, value in first),
        f"mass = [{rows}];",
        f"right = [{'; '.join(values[n * n :])}];",
        "end",
    ]
    first, values = body([mechanics.energy_expression])
    more += [
        "",
        f"function E = energy(q, qdot{t})",
        *(f"{variable} = {value};" for variable, value in first),
        f"E = {values[0]};",
        "end",
    ]
    return "\n".join(lines) + "\n" + functions + "\n".join(more) + "\n"


def _function_name(file: str) -> str:
    stem, dot, suffix = file.rpartition(".")
    if not (dot and suffix == "m"):
        raise InputError(f"{quoted(file)} does not end in .m, as MATLAB requires; use e.g. pendulum.m")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", stem) or _KEYWORD.fullmatch(stem):
        raise InputError(
            f"{quoted(file)} is not a name of a MATLAB function; use a letter, then letters, digits and "
            "underscores, at most 63, and not a keyword, e.g. pendulum.m"
        )
    return stem
