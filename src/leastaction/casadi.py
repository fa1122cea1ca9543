"""A model as CasADi functions, for optimal control and moving-horizon estimation.

Needs ``pip install 'leastaction[casadi]'``. The same functions as a file that is independent of leastaction:
``leastaction.export(model, "casadi")``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import sympy as sp

from leastaction.errors import InputError, MissingPackageError
from leastaction.exporters.casadi import CasadiPrinter
from leastaction.exporters.shared import equations
from leastaction.mechanics.arm_columns import Acting, ArmParts, entries
from leastaction.model.model import LagrangianModel

if TYPE_CHECKING:
    import casadi

__all__ = ["CasadiFunctions", "arm_functions", "functions"]


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


def arm_functions(parts: ArmParts) -> dict[str, casadi.Function]:
    """``torques(q, qdot, qddot)``, ``gravity(q)`` and ``friction(qdot)`` of an arm."""
    try:
        import casadi
    except ImportError:
        raise MissingPackageError("to_casadi()", "casadi", "casadi", "use to_python()") from None
    ca: Any = casadi
    n = len(parts.tree)
    q, v, a = (ca.SX.sym(name, n) for name in ("q", "qdot", "qddot"))
    rest, springs = ca.SX.zeros(n), [x for x in parts.local if x.kind == "spring"]
    rubbing = [x for x in parts.local if x.kind not in ("rotor", "spring", "offset")]
    state = [symbol for array in ("q", "qdot", "qddot") for symbol in entries(array, n)]

    def added(expressions: Sequence[sp.Expr], *arrays: Any) -> Any:
        modules: Any = [{"casadi": casadi}]
        compiled: Any = sp.lambdify(state, list(expressions), modules=modules, printer=CasadiPrinter())
        return ca.vertcat(*compiled(*(x for array in arrays for x in ca.vertsplit(array))))

    joints, lost = _acting(ca, parts.local, q, v, a), added(parts.loss, rest, v, rest)
    whole = _rigid(ca, parts, q, v, a) + joints + added(parts.law, q, v, a) + lost
    still = _rigid(ca, parts, q, rest, rest) + _acting(ca, springs, q, rest, rest)
    still += added(parts.law, q, rest, rest)
    return {
        "torques": ca.Function("torques", [q, v, a], [whole]),
        "gravity": ca.Function("gravity", [q], [still]),
        "friction": ca.Function("friction", [v], [_acting(ca, rubbing, rest, v, rest) + lost]),
    }


def _acting(ca: Any, local: Sequence[Acting], q: Any, v: Any, a: Any) -> Any:
    out = ca.SX.zeros(q.shape[0])
    for kind, k, value, width, speed in local:
        size = ca.sqrt(v[k] ** 2 + width * width)
        sign = v[k] / size if width else 0.0
        out[k] += (
            value
            * {
                "rotor": a[k],
                "spring": q[k],
                "offset": 1.0,
                "viscous": v[k],
                "dry": sign,
                "stribeck": sign * ca.exp(-((v[k] / speed) ** 2)) if speed else 0.0,
                "quadratic": v[k] * size,
                "asymmetric": size,
            }[kind]
        )
    return out


def _rigid(ca: Any, parts: ArmParts, q: Any, v: Any, a: Any) -> Any:
    frames: list[Any] = []
    for k, joint in enumerate(parts.tree.joints):
        axis = ca.DM(joint.axis)
        turned, shift = ca.SX(ca.DM(joint.rotation)), ca.SX(ca.DM(joint.origin))
        if joint.parent < 0:
            w, dw, acc = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX(ca.DM(-parts.tree.gravity))
        else:
            w, dw, acc = frames[joint.parent][2:]
        if joint.kind == "revolute":
            cross = ca.skew(axis)
            turned = turned @ (ca.DM.eye(3) + ca.sin(q[k]) * cross + (1.0 - ca.cos(q[k])) * (cross @ cross))
        else:
            shift = shift + q[k] * (turned @ axis)
        acc = turned.T @ (acc + ca.cross(dw, shift) + ca.cross(w, ca.cross(w, shift)))
        w, dw = turned.T @ w, turned.T @ dw
        if joint.kind == "revolute":
            dw = dw + axis * a[k] + ca.cross(w, axis * v[k])
            w = w + axis * v[k]
        else:
            acc = acc + axis * a[k] + 2.0 * ca.cross(w, axis * v[k])
        frames.append((turned, shift, w, dw, acc))
    forces: list[list[Any]] = []
    for (_, _, w, dw, acc), (m, mx, my, mz, xx, xy, xz, yy, yz, zz) in zip(
        frames, parts.inertial, strict=True
    ):
        first, inertia = ca.DM([mx, my, mz]), ca.DM([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        force = m * acc + ca.cross(dw, first) + ca.cross(w, ca.cross(w, first))
        forces.append([force, inertia @ dw + ca.cross(w, inertia @ w) + ca.cross(first, acc)])
    out = ca.SX.zeros(len(frames))
    for k in reversed(range(len(frames))):
        joint, (force, moment) = parts.tree.joints[k], forces[k]
        out[k] = ca.dot(ca.DM(joint.axis), moment if joint.kind == "revolute" else force)
        if joint.parent >= 0:
            turned, shift = frames[k][:2]
            forces[joint.parent][0] += turned @ force
            forces[joint.parent][1] += turned @ moment + ca.cross(shift, turned @ force)
    return out
