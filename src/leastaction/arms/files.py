"""Files of an identified arm: JSON, and its inverse dynamics as Python, C and CasADi code.

The code uses the recursive algorithm of Luh, Walker & Paul 1980 (Journal of Dynamic Systems, Measurement, and
Control 102:69): velocities and accelerations outwards, forces inwards.  Dry friction follows the sign of the
velocity, because a single state does not contain the position of the last reversal.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import numpy as np

from leastaction.arms.base import find_base
from leastaction.arms.log import FitFacts
from leastaction.arms.model import ArmModel
from leastaction.arms.signals import Recording
from leastaction.data.formats.atomic import check_path, read_bytes, write_bytes
from leastaction.errors import InputError, MissingPackageError
from leastaction.identifiers import quoted
from leastaction.library.tree import Joint, KinematicTree
from leastaction.mechanics.arm_columns import ArmTerm

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
_Local = tuple[str, int, float, float, float]


def _parts(model: ArmModel) -> tuple[np.ndarray, list[_Local]]:
    """(n_links, 10) inertial parameters; kind, joint, coefficient, smoothing and Stribeck speed of others.

    Raises
    ------
    InputError
        If friction depends on the load of the joint.
    """
    inertial, local = np.zeros((len(model.tree), 10)), list[_Local]()
    for term, value in zip(model.terms, model.coefficients.tolist(), strict=True):
        if term.kind == "load":
            raise InputError(
                'friction that depends on load is not written as code; leave out "load" in friction'
            )
        if term.kind == "inertia":
            inertial[term.place, term.component] = value
        else:
            local.append((term.kind, term.place, value, term.width, term.speed))
    return inertial, local


def write_python(model: ArmModel, path: str | Path) -> None:
    """Write a module with functions ``torques``, ``gravity`` and ``friction``, in NumPy alone."""
    inertial, local = _parts(model)
    columns = [
        (j.parent, j.kind == "revolute", j.rotation.tolist(), j.origin.tolist(), j.axis.tolist())
        for j in model.tree.joints
    ]
    text = _PYTHON.format(
        joints=", ".join(model.coordinates),
        tree=",\n    ".join(map(repr, columns)),
        gravity=model.tree.gravity.tolist(),
        inertial=",\n    ".join(map(repr, inertial.tolist())),
        local=",\n    ".join(map(repr, local)),
    )
    write_bytes(path, text.encode())


def write_c(model: ArmModel, path: str | Path) -> None:
    """Write C99 code with ``arm_torques``, ``arm_gravity`` and ``arm_friction``; it needs math.h alone."""
    inertial, local = _parts(model)
    joints = model.tree.joints
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
    acting = [f"{{{kinds.index(kind)}, {k}, {v!r}, {w!r}, {s!r}}}" for kind, k, v, w, s in local]
    text = files("leastaction.arms").joinpath("inverse_dynamics.c").read_text(encoding="utf-8")
    for name, value in {
        "JOINTS_IN_WORDS": ", ".join(model.coordinates),
        "N_JOINTS": str(len(joints)),
        "N_ACTING": str(len(acting)),
        "TREE_ROWS": ",\n    ".join(f"{{{row}}}" for row in rows),
        "GRAVITY_VECTOR": _braces(model.tree.gravity),
        "LINK_ROWS": ",\n    ".join(map(_braces, inertial)),
        "ACTING_ROWS": ",\n    ".join(acting or ["{2, 0, 0.0, 0.0, 0.0}"]),
    }.items():
        text = text.replace(f"@{name}@", value)
    write_bytes(path, text.encode())


def _braces(values: np.ndarray) -> str:
    return "{" + ", ".join(map(repr, np.ravel(values).tolist())) + "}"


def casadi_functions(model: ArmModel) -> dict[str, Any]:
    """``torques(q, qdot, qddot)``, ``gravity(q)`` and ``friction(qdot)`` as ``casadi.Function``."""
    try:
        import casadi
    except ImportError:
        raise MissingPackageError("to_casadi()", "casadi", "casadi", "use to_python()") from None
    ca: Any = casadi
    inertial, local = _parts(model)
    n = len(model.tree)
    q, v, a = (ca.SX.sym(name, n) for name in ("q", "qdot", "qddot"))
    rest = ca.SX.zeros(n)
    joints = [_acting(ca, local, q, v, a, friction_only=only) for only in (False, True)]
    return {
        "torques": ca.Function("torques", [q, v, a], [_rigid(ca, model, inertial, q, v, a) + joints[0]]),
        "gravity": ca.Function("gravity", [q], [_rigid(ca, model, inertial, q, rest, rest)]),
        "friction": ca.Function("friction", [v], [joints[1]]),
    }


def _acting(ca: Any, local: list[_Local], q: Any, v: Any, a: Any, *, friction_only: bool) -> Any:
    out = ca.SX.zeros(q.shape[0])
    for kind, k, value, width, speed in local:
        if friction_only and kind in ("rotor", "spring", "offset"):
            continue
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


def _rigid(ca: Any, model: ArmModel, inertial: np.ndarray, q: Any, v: Any, a: Any) -> Any:
    frames: list[Any] = []
    for k, joint in enumerate(model.tree.joints):
        axis = ca.DM(joint.axis)
        turned, shift = ca.SX(ca.DM(joint.rotation)), ca.SX(ca.DM(joint.origin))
        if joint.parent < 0:
            w, dw, acc = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX(ca.DM(-model.tree.gravity))
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
    for (_, _, w, dw, acc), (m, mx, my, mz, xx, xy, xz, yy, yz, zz) in zip(frames, inertial, strict=True):
        first, inertia = ca.DM([mx, my, mz]), ca.DM([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        force = m * acc + ca.cross(dw, first) + ca.cross(w, ca.cross(w, first))
        forces.append([force, inertia @ dw + ca.cross(w, inertia @ w) + ca.cross(first, acc)])
    out = ca.SX.zeros(len(frames))
    for k in reversed(range(len(frames))):
        joint, (force, moment) = model.tree.joints[k], forces[k]
        out[k] = ca.dot(ca.DM(joint.axis), moment if joint.kind == "revolute" else force)
        if joint.parent >= 0:
            turned, shift = frames[k][:2]
            forces[joint.parent][0] += turned @ force
            forces[joint.parent][1] += turned @ moment + ca.cross(shift, turned @ force)
    return out


_PYTHON = '''"""Inverse dynamics of an arm with the joints {joints}, written by leastaction. Needs NumPy.

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
    return rigid_body(q, qdot, qddot) + joint_torques(q, qdot, qddot)


def gravity(q):
    """Return the torques that hold the links still."""
    return rigid_body(q, np.zeros(len(TREE)), np.zeros(len(TREE)))


def friction(qdot):
    """Return the friction of every joint, to be compensated."""
    still = np.zeros(len(TREE))
    return joint_torques(still, qdot, still, ("viscous", "dry", "stribeck", "quadratic", "asymmetric"))


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
