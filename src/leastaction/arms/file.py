"""Models of arms as files: JSON, and Python code that needs NumPy alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import numpy as np

from leastaction.arms.base import find_base
from leastaction.arms.model import ArmModel, FitFacts
from leastaction.data.formats.atomic import check_path, read_bytes, write_bytes
from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.library.tree import Joint, KinematicTree
from leastaction.mechanics.arm_columns import ArmTerm

__all__ = ["from_dict", "load", "save", "to_dict", "write_python"]

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
        If the data are not of that form.
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
        terms = tuple(ArmTerm(**row) for row in given["terms"])
        facts = cast(Any, {key: _tuple(value) for key, value in given["fit"].items()})
        coefficients, covariance, reference = (
            np.array(given[key], float) for key in ("coefficients", "covariance", "reference")
        )
        base = find_base(tree, terms).subset(given["members"])
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


def write_python(model: ArmModel, path: str | Path) -> None:
    """Write a module with ``torques(q, qdot, qddot)`` of one state, in NumPy alone.

    Dry friction follows the sign of the velocity in it: one state does not tell where the arm came from.

    Raises
    ------
    InputError
        If friction depends on the load of the joint.
    """
    if any(term.kind == "load" for term in model.terms):
        raise InputError(
            'friction that depends on load is not written as Python; leave out "load" in friction'
        )
    columns = [
        (
            joint.parent,
            joint.kind == "revolute",
            _list(joint.rotation),
            _list(joint.origin),
            _list(joint.axis),
        )
        for joint in model.tree.joints
    ]
    inertial = np.zeros((len(model.tree), 10))
    local: list[tuple[str, int, float, float, float]] = []
    for term, value in zip(model.terms, model.coefficients.tolist(), strict=True):
        if term.kind == "inertia":
            inertial[term.place, term.component] = value
        else:
            local.append((term.kind, term.place, value, term.width, term.speed))
    text = _CODE.format(
        joints=", ".join(model.coordinates),
        tree=",\n    ".join(map(repr, columns)),
        gravity=_list(model.tree.gravity),
        inertial=",\n    ".join(map(repr, _list(inertial))),
        local=",\n    ".join(map(repr, local)),
    )
    write_bytes(path, text.encode())


_CODE = '''"""Inverse dynamics of an arm with the joints {joints}, written by leastaction. Needs NumPy.

Base parameters stand in place of the inertial parameters of the links: torques are right, links need not be
bodies that can exist.
"""

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
    for kind, k, value, width, speed in JOINTS:
        v = qdot[k]
        size = np.sqrt(v * v + width * width)
        out[k] += value * {{
            "rotor": qddot[k], "spring": q[k], "offset": 1.0, "viscous": v, "dry": v / size if width else 0.0,
            "stribeck": v / size * np.exp(-((v / speed) ** 2)) if speed else 0.0,
            "quadratic": v * size, "asymmetric": size,
        }}[kind]
    return out
'''


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
