"""Files of an identified arm: JSON, and its inverse dynamics as Python, C and CasADi code.

The code uses the recursive algorithm of Luh, Walker & Paul 1980 (Journal of Dynamic Systems, Measurement, and
Control 102:69): velocities and accelerations outwards, forces inwards.  Dry friction follows the sign of the
velocity, because a single state does not contain the position of the last reversal.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import numpy as np
import sympy as sp

from leastaction.arms.base import find_base
from leastaction.arms.log import FitFacts
from leastaction.arms.model import ArmModel
from leastaction.arms.signals import Recording
from leastaction.casadi import arm_functions
from leastaction.data.formats.atomic import check_path, read_bytes, write_bytes
from leastaction.errors import InputError
from leastaction.exporters.shared import CPrinter
from leastaction.identifiers import quoted
from leastaction.library.tree import Joint, KinematicTree
from leastaction.mechanics.arm_columns import Acting, ArmParts, entries
from leastaction.mechanics.arm_terms import EXTRA, ArmTerm
from leastaction.mechanics.equations import Mechanics
from leastaction.simulation.law import PythonPrinter

__all__ = ["casadi_functions", "from_dict", "load", "save", "to_dict", "write_c", "write_python"]

_SCHEMA = 1


def to_dict(model: ArmModel) -> dict[str, Any]:
    """The model as plain data."""
    tree = model.tree
    return {
        "schema": _SCHEMA,
        "kind": "arm",
        "tree": {
            "name": tree.name,
            "gravity": tree.gravity.tolist(),
            "joints": [_plain(joint) for joint in tree.joints],
            "extra": {
                name: [term.text for term in tree.extra if term.kind == kind]
                for name, kind in (("terms", "lagrangian"), ("dissipation", "dissipation"))
            },
        },
        "terms": [asdict(term) for term in model.base.terms],
        "members": list(model.base.members),
        "coefficients": model.coefficients.tolist(),
        "covariance": model.covariance.tolist(),
        "reference": model.reference.tolist(),
        "fit": asdict(model.facts),
    }


def from_dict(given: Mapping[str, Any]) -> ArmModel:
    """The model of `to_dict`.

    Raises
    ------
    InputError
        If the data do not have that form.
    """
    if given.get("schema") != _SCHEMA or given.get("kind") != "arm":
        raise InputError(
            f"the file holds {quoted(given.get('kind'))} of schema {quoted(given.get('schema'))}; expected "
            f"an arm of schema {_SCHEMA}, as `leastaction arm` writes it"
        )
    try:
        parts = given["tree"]
        joints = tuple(Joint(**{key: _array(value) for key, value in row.items()}) for row in parts["joints"])
        tree = KinematicTree(joints, np.array(parts["gravity"], float), str(parts["name"]))
        tree = tree.with_terms(**parts.get("extra", {}))  # older files have none
        terms = tuple(ArmTerm(**row) for row in given["terms"])
        facts = cast(Any, {key: _tuple(value) for key, value in given["fit"].items()})
        coefficients, covariance, reference = (
            np.array(given[key], float) for key in ("coefficients", "covariance", "reference")
        )
        none = Recording(unmeasured=facts.get("unmeasured", ())).places(tree)
        base = find_base(tree, terms, none).subset(given["members"])
        size = len(base.members)
        if coefficients.shape != (size,) or covariance.shape != (size, size):
            raise ValueError("the number of coefficients")
        return ArmModel(tree, base, coefficients, covariance, reference, FitFacts(**facts))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"the file holds no arm: {quoted(str(error))} is not as expected") from None


def save(model: ArmModel, path: str | Path) -> None:
    """Write a model to a JSON file."""
    write_bytes(path, (json.dumps(to_dict(model), indent=1) + "\n").encode())


def load(path: str | Path) -> ArmModel:
    """Read a model that `ArmModel.save` has written.

    Raises
    ------
    InputError
        If the file cannot be read or holds no arm.
    """
    try:
        given: Any = json.loads(read_bytes(check_path(path)))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path} is not JSON: {error}; give a file that ArmModel.save has written") from None
    if not isinstance(given, dict):
        raise InputError(f"{path} holds no arm; give a file that ArmModel.save has written")
    return from_dict(cast(dict[str, Any], given))


def _list(values: Any) -> Any:
    return values.tolist()


def _plain(joint: Joint) -> dict[str, Any]:
    given: dict[str, Any] = vars(joint)
    out = {key: _list(value) if hasattr(value, "tolist") else value for key, value in given.items()}
    if joint.limits is not None:  # JSON has no NaN
        out["limits"] = [None if np.isnan(x) else x for x in joint.limits.tolist()]
    return out


def _array(value: Any) -> Any:
    return np.array(value, float) if isinstance(value, list) else value


def _tuple(value: Any) -> Any:
    return tuple(cast(list[Any], value)) if isinstance(value, list) else value


#                                                        inverse dynamics as code: Python, C and CasADi
def _parts(model: ArmModel) -> ArmParts:
    """What the code consists of.

    Raises
    ------
    InputError
        If friction depends on the load of the joint.
    """
    inertial, local = np.zeros((len(model.tree), 10)), list[Acting]()
    for term, value in zip(model.terms, model.coefficients.tolist(), strict=True):
        if term.kind == "load":
            raise InputError(
                'friction that depends on load is not written as code; leave out "load" in friction'
            )
        if term.kind == "inertia":
            inertial[term.place, term.component] = value
        elif term.kind not in EXTRA:
            local.append(Acting(term.kind, term.place, value, term.width, term.speed))
    return ArmParts(model.tree, inertial, local, *(_added(model, kind) for kind in EXTRA))


def _added(model: ArmModel, kind: str) -> list[sp.Expr]:
    """Torques of the expressions of one kind; the symbols are the entries of the arrays q, qdot and qddot."""
    own = [
        (model.tree.extra[term.place], value)
        for term, value in zip(model.terms, model.coefficients.tolist(), strict=True)
        if term.kind == kind
    ]
    law = Mechanics.of_terms([term for term, _ in own], [value for _, value in own], model.coordinates)
    q, qdot, qddot = (entries(array, law.n_dof) for array in ("q", "qdot", "qddot"))
    swap = dict(zip([*law.q, *law.qdot], [*q, *qdot], strict=True))
    return [
        (sp.Add(*(mass * a for mass, a in zip(row, qddot, strict=True))) - right).xreplace(swap)
        for row, right in zip(law.mass, law.right, strict=True)
    ]


def _written(expressions: Sequence[sp.Expr], printer: Any) -> list[str]:
    return [printer.doprint(expression) for expression in expressions]


def write_python(model: ArmModel, path: str | Path) -> None:
    """Write a module with functions ``torques``, ``gravity`` and ``friction``, in NumPy alone."""
    parts = _parts(model)
    columns = [
        (j.parent, j.kind == "revolute", j.rotation.tolist(), j.origin.tolist(), j.axis.tolist())
        for j in model.tree.joints
    ]
    law, loss = (",\n        ".join(_written(own, PythonPrinter())) for own in (parts.law, parts.loss))
    text = _PYTHON.format(
        joints=", ".join(model.coordinates),
        tree=",\n    ".join(map(repr, columns)),
        gravity=model.tree.gravity.tolist(),
        inertial=",\n    ".join(map(repr, parts.inertial.tolist())),
        local=",\n    ".join(map(repr, map(tuple, parts.local))),
        law=law,
        loss=loss,
    )
    write_bytes(path, text.encode())


def write_c(model: ArmModel, path: str | Path) -> None:
    """Write C99 code with ``arm_torques``, ``arm_gravity`` and ``arm_friction``; it needs math.h alone."""
    parts, joints = _parts(model), model.tree.joints
    rows = [
        ", ".join(
            [
                str(j.parent),
                str(int(j.kind == "revolute")),
                _braces(j.rotation),
                _braces(j.origin),
                _braces(j.axis),
            ]
        )
        for j in joints
    ]
    kinds = ("rotor", "spring", "offset", "viscous", "dry", "stribeck", "quadratic", "asymmetric")
    acting = [f"{{{kinds.index(kind)}, {k}, {v!r}, {w!r}, {s!r}}}" for kind, k, v, w, s in parts.local]
    law, loss = (enumerate(_written(own, CPrinter())) for own in (parts.law, parts.loss))
    text = files("leastaction.arms").joinpath("inverse_dynamics.c").read_text(encoding="utf-8")
    for name, value in {
        "JOINTS_IN_WORDS": ", ".join(model.coordinates),
        "N_JOINTS": str(len(joints)),
        "N_ACTING": str(len(acting)),
        "TREE_ROWS": ",\n    ".join(f"{{{row}}}" for row in rows),
        "GRAVITY_VECTOR": _braces(model.tree.gravity),
        "LINK_ROWS": ",\n    ".join(map(_braces, parts.inertial)),
        "LAW": "\n    ".join(f"tau[{k}] += {code};" for k, code in law),
        "LOSS": "\n    ".join(f"tau[{k}] += {code};" for k, code in loss),
        "ACTING_ROWS": ",\n    ".join(acting or ["{2, 0, 0.0, 0.0, 0.0}"]),
    }.items():
        text = text.replace(f"@{name}@", value)
    write_bytes(path, text.encode())


def casadi_functions(model: ArmModel) -> dict[str, Any]:
    """``torques(q, qdot, qddot)``, ``gravity(q)`` and ``friction(qdot)`` as ``casadi.Function``."""
    return arm_functions(_parts(model))


def _braces(values: np.ndarray) -> str:
    return "{" + ", ".join(map(repr, np.ravel(values).tolist())) + "}"


_PYTHON = '''"""Inverse dynamics of an arm with the joints {joints}, written by leastaction. Needs NumPy.

Base parameters stand in place of the inertial parameters of the links: torques are right, links need not be
bodies that can exist.
"""

import math

import numpy as np

# parent, revolute, rotation and origin of the joint in the parent link, axis
TREE = [
    {tree},
]
GRAVITY = np.array({gravity})
# m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz of each link about its joint
LINKS = np.array([
    {inertial},
])
# kind, joint, coefficient, smoothing speed, Stribeck speed
JOINTS = [
    {local},
]


def torques(q, qdot, qddot):
    """Return the joint torques of one state, (n_joints,) arrays."""
    return rigid_body(q, qdot, qddot) + joint_torques(q, qdot, qddot) + added(q, qdot, qddot) + lost(qdot)


def gravity(q):
    """Return the torques of weight, springs and added potentials, which hold the arm still."""
    still = np.zeros(len(TREE))
    return rigid_body(q, still, still) + joint_torques(q, still, still, ("spring",)) + added(q, still, still)


def friction(qdot):
    """Return the friction of every joint, to be compensated."""
    still, kinds = np.zeros(len(TREE)), ("viscous", "dry", "stribeck", "quadratic", "asymmetric")
    return joint_torques(still, qdot, still, kinds) + lost(qdot)


def added(q, qdot, qddot):
    """Return the torques of terms that were added to L."""
    return np.array([
        {law},
    ])


def lost(qdot):
    """Return the torques of terms that were added to the dissipation function."""
    return np.array([
        {loss},
    ])


def rigid_body(q, qdot, qddot):
    """Return the torques of the links alone."""
    states = []
    for k, (parent, revolute, rotation, origin, axis) in enumerate(TREE):
        axis, rotation = np.array(axis), np.array(rotation)
        w, dw, a = (np.zeros(3), np.zeros(3), -GRAVITY) if parent < 0 else states[parent][2:]
        shift = np.array(origin) + (0.0 if revolute else q[k]) * (rotation @ axis)
        if revolute:
            x, y, z = axis
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            rotation = rotation @ (np.eye(3) + np.sin(q[k]) * cross + (1.0 - np.cos(q[k])) * cross @ cross)
        a = rotation.T @ (a + np.cross(dw, shift) + np.cross(w, np.cross(w, shift)))
        w, dw = rotation.T @ w, rotation.T @ dw
        if revolute:
            dw = dw + axis * qddot[k] + np.cross(w, axis * qdot[k])
            w = w + axis * qdot[k]
        else:
            a = a + axis * qddot[k] + 2.0 * np.cross(w, axis * qdot[k])
        states.append((rotation, shift, w, dw, a))
    forces = []
    for (_, _, w, dw, a), (m, mx, my, mz, xx, xy, xz, yy, yz, zz) in zip(states, LINKS):
        first, inertia = np.array([mx, my, mz]), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        force = m * a + np.cross(dw, first) + np.cross(w, np.cross(w, first))
        forces.append([force, inertia @ dw + np.cross(w, inertia @ w) + np.cross(first, a)])
    out = np.zeros(len(TREE))
    for k in reversed(range(len(TREE))):
        parent, revolute, _, _, axis = TREE[k]
        force, moment = forces[k]
        out[k] = np.dot(axis, moment if revolute else force)
        if parent >= 0:
            rotation, shift = states[k][:2]
            turned = rotation @ force
            forces[parent][0] = forces[parent][0] + turned
            forces[parent][1] = forces[parent][1] + rotation @ moment + np.cross(shift, turned)
    return out


def joint_torques(q, qdot, qddot, kinds=None):
    """Return what rotors, springs, constant torques and friction add."""
    out = np.zeros(len(TREE))
    for kind, k, value, width, speed in JOINTS:
        if kinds is not None and kind not in kinds:
            continue
        v = qdot[k]
        size = np.sqrt(v * v + width * width)
        out[k] += value * {{
            "rotor": qddot[k], "spring": q[k], "offset": 1.0, "viscous": v, "dry": v / size if width else 0.0,
            "stribeck": v / size * np.exp(-((v / speed) ** 2)) if speed else 0.0,
            "quadratic": v * size, "asymmetric": size,
        }}[kind]
    return out
'''
