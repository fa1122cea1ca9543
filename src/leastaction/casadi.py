"""A model as CasADi functions, for optimal control and moving-horizon estimation.

Needs ``pip install 'leastaction[casadi]'``. The same functions as a file that is independent of leastaction:
``leastaction.export(model, "casadi")``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import sympy as sp

from leastaction.errors import InputError
from leastaction.exporters.casadi import CasadiPrinter
from leastaction.exporters.shared import equations
from leastaction.model.model import LagrangianModel

if TYPE_CHECKING:
    import casadi

__all__ = ["CasadiFunctions", "functions"]


class CasadiFunctions(NamedTuple):
    """What `functions` returns: three ``casadi.Function`` of columns of length n_dof.

    Those of a law that holds the time take it behind qdot: ``acceleration(q, qdot, t, forces)``.

    Attributes
    ----------
    acceleration : casadi.Function
        ``acceleration(q, qdot, forces)`` -> q̈.
    energy : casadi.Function
        ``energy(q, qdot)``.
    mass_matrix : casadi.Function
        ``mass_matrix(q, qdot)`` -> (n_dof, n_dof).
    """

    acceleration: casadi.Function
    energy: casadi.Function
    mass_matrix: casadi.Function


def functions(model: LagrangianModel) -> CasadiFunctions:
    """Acceleration, energy and mass matrix as CasADi functions that can be differentiated.

    Parameters
    ----------
    model : LagrangianModel

    Returns
    -------
    CasadiFunctions
        NaN or infinite where the mass matrix is singular, NaN where a function is not defined.

    Raises
    ------
    InputError
        If casadi is not installed, or `model` is not a model.

    Examples
    --------
    >>> from leastaction.model.model import LagrangianModel, ModelTerm
    >>> spring = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
    >>> functions(spring).acceleration([1.0], [0.0], [3.0])
    DM(-1)
    """
    try:
        import casadi
    except ImportError:
        raise InputError("this needs casadi; install it with: pip install 'leastaction[casadi]'") from None
    if not isinstance(model, LagrangianModel):
        raise InputError(f"model is of type {type(model).__name__}; expected a LagrangianModel")
    n, mechanics = model.n_dof, model.mechanics
    compiled: Any = sp.lambdify(
        mechanics.state,
        [*equations(mechanics), mechanics.energy_expression],
        modules=[{"casadi": casadi}],
        printer=CasadiPrinter(),
        cse=True,
    )
    q, qdot, forces = (casadi.SX.sym(name, n) for name in ("q", "qdot", "forces"))
    t = [casadi.SX.sym("t")] if model.timed else []
    values = compiled(*casadi.vertsplit(q), *casadi.vertsplit(qdot), *t)
    rows = [casadi.horzcat(*values[i * n : (i + 1) * n]) for i in range(n)]
    mass = casadi.sparsify(casadi.SX(casadi.vertcat(*rows)))
    right = casadi.SX(casadi.vertcat(*values[n * n : n * n + n])) + forces
    singular = casadi.sprank(mass) < n
    qddot = casadi.SX.nan(n, 1) if singular else casadi.solve(mass, right)
    state, names = [q, qdot, *t], ["q", "qdot", *("t" for _ in t)]
    return CasadiFunctions(
        casadi.Function("acceleration", [*state, forces], [qddot], [*names, "forces"], ["qddot"]),
        casadi.Function("energy", state, [casadi.SX(values[-1])], names, ["energy"]),
        casadi.Function("mass_matrix", state, [casadi.densify(mass)], names, ["mass"]),
    )
