"""Read the kinematic tree of a URDF, and write identified inertias back into one.

The reader uses links with their inertia, and joints with origin, axis, kind, limits and dynamics.  It ignores
meshes, which need not exist, and all other elements.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from leastaction.data.formats.atomic import write_bytes
from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.library.robot_xml import about_centre, identifier, moved, numbers, parse_robot, written
from leastaction.library.tree import GRAVITY, Joint, KinematicTree, rpy_matrix

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["read_urdf", "write_urdf"]

_MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True, eq=False)
class _UrdfJoint:
    name: str
    kind: str
    parent: str
    child: str
    rotation: np.ndarray
    origin: np.ndarray
    axis: np.ndarray
    limits: np.ndarray
    dynamics: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Placed:
    """A link of the file in the frame of the moving link that it is fixed to; -1 is the base."""

    link: str
    body: int
    rotation: np.ndarray
    origin: np.ndarray


def read_urdf(
    path: str | Path,
    *,
    joints: list[str] | None = None,
    gravity: ArrayLike = GRAVITY,
    base_rpy: ArrayLike = (0.0, 0.0, 0.0),
) -> KinematicTree:
    """Read the kinematic tree of a URDF.

    Parameters
    ----------
    path : str or Path
    joints : list of str, optional
        Joints that move; all others (such as the fingers of a gripper) are fixed at coordinate zero. By
        default all movable joints.
    gravity, base_rpy : array_like, shape (3,)
        As of `KinematicTree.from_dh`.

    Returns
    -------
    KinematicTree
        Joints have the names of the file, with ``_`` for characters that are not allowed. Links connected by
        fixed joints become one, and their inertias are added. A link without inertia is unknown.

    Raises
    ------
    InputError
        If the file is not a URDF, or has unsupported joints.
    """
    root = _root(path)
    found, masses = _contents(root, str(path), joints)
    names = [joint.name for joint in found if joint.kind in _MOVING]
    for name in joints or ():
        if name not in names:
            raise InputError(f"{path} has no joint {quoted(name)} that moves; it has {', '.join(names)}")
    moving = set(names if joints is None else joints)
    placed, sequence = _placed(found, moving, str(path))
    inertias: list[np.ndarray | None] = [None] * len(sequence)
    for link in placed:
        own = masses.get(link.link)
        if link.body < 0 or own is None:
            continue
        added = moved(own, link.rotation, link.origin)
        before = inertias[link.body]
        inertias[link.body] = added if before is None else before + added
    bodies = {link.link: link for link in placed}
    made: list[Joint] = []
    for joint, inertia in zip(sequence, inertias, strict=True):
        parent = bodies[joint.parent]
        made.append(
            Joint(
                identifier(joint.name),
                identifier(joint.child),
                _MOVING[joint.kind],
                parent.body,
                parent.rotation @ joint.rotation,
                parent.origin + parent.rotation @ joint.origin,
                joint.axis,
                inertia,
                joint.limits,
                joint.dynamics,
            )
        )
    turn = rpy_matrix(base_rpy).T
    name = root.get("name", "arm")
    return KinematicTree(tuple(made), turn @ np.array(gravity, dtype=float), name)


def write_urdf(tree: KinematicTree, source: str | Path, path: str | Path) -> None:
    """Write a URDF with the inertias of a tree instead of its own.

    The first link of every body gets the inertia. Links that are fixed to it have none, because only the sum
    is known. Everything else except comments is kept.

    Parameters
    ----------
    tree : KinematicTree
        With inertias for every link, of a model's ``bodies()``.
    source : str or Path
        The URDF that the tree was read from.
    path : str or Path
    """
    if np.isnan(tree.inertias).any():
        raise InputError("the tree has links without inertia; take the tree of model.bodies()")
    root = _root(source)
    every = [element.get("name", "") for element in root.findall("joint")]
    moving = {name for name in every if identifier(name) in tree.coordinates}
    found, _ = _contents(root, str(source), list(moving))
    placed, sequence = _placed(found, moving, str(source))
    if tuple(identifier(joint.name) for joint in sequence) != tree.coordinates:
        raise InputError(f"{source} has other joints than the tree; give the file that it was read from")
    first = {joint.child: k for k, joint in enumerate(sequence)}
    elements = {link.get("name"): link for link in root.findall("link")}
    for link in placed:
        element = elements[link.link]
        if link.body < 0:
            continue
        for old in element.findall("inertial"):
            element.remove(old)
        if link.link in first:
            element.insert(0, _inertial(tree.inertias[first[link.link]]))
    ET.indent(root)
    write_bytes(path, ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _contents(
    root: ET.Element, path: str, moving: list[str] | None
) -> tuple[list[_UrdfJoint], dict[str, np.ndarray]]:
    """Joints, and inertias by link. Joints that do not move may be of any type."""
    links = [_name(link, "link", path) for link in root.findall("link")]
    masses = {
        name: _mass(inertial, f"{path}, link {quoted(name)}")
        for name, link in zip(links, root.findall("link"), strict=True)
        for inertial in link.findall("inertial")[:1]
    }
    joints = [_joint(element, path, moving) for element in root.findall("joint")]
    if not joints:
        raise InputError(f"{path} has no joints; give the whole robot, not a single link")
    known = set(links)
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in known:
                raise InputError(
                    f"{path}: joint {quoted(joint.name)} holds the link {quoted(link)}, which is missing"
                )
    names = [joint.name for joint in joints]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path} has two joints {quoted(name)}; give each a name of its own")
    return joints, masses


def _joint(element: ET.Element, path: str, moving: list[str] | None) -> _UrdfJoint:
    name = _name(element, "joint", path)
    where = f"{path}, joint {quoted(name)}"
    kind = element.get("type", "")
    free = moving is None or name in moving
    if free and kind not in (*_MOVING, "fixed"):
        raise InputError(
            f"{where} is of type {quoted(kind)}; revolute, continuous, prismatic and fixed joints are "
            "supported: replace it, or name the joints that move (joints=[...]), and the others stay"
        )
    if free and element.find("mimic") is not None:
        raise InputError(
            f"{where} mimics another; name the joints that move (joints=[...]), and the others stay, or "
            "remove <mimic> and log it as well"
        )
    ends: list[str] = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None or not end.get("link"):
            raise InputError(f"{where} has no <{tag} link=...>")
        ends.append(end.get("link", ""))
    rotation, origin = _pose(element.find("origin"), where)
    along = element.find("axis")
    axis = (
        np.array([1.0, 0.0, 0.0]) if along is None else numbers(along.get("xyz", "1 0 0"), f"{where}, axis")
    )
    length = float(np.linalg.norm(axis))
    if kind != "fixed" and length == 0.0:
        raise InputError(f"{where} has an axis without length; write for example <axis xyz='0 0 1'/>")
    dynamics = _dynamics(element.find("dynamics"), where)
    limits = _limits(element.find("limit"), kind, where)
    return _UrdfJoint(
        name, kind, ends[0], ends[1], rotation, origin, axis / (length or 1.0), limits, dynamics
    )


def _placed(joints: list[_UrdfJoint], moving: set[str], path: str) -> tuple[list[_Placed], list[_UrdfJoint]]:
    """All links connected to the root, and the moving joints in sequence, parents first."""
    children = [joint.child for joint in joints]
    for child in children:
        if children.count(child) > 1:
            raise InputError(f"{path}: link {quoted(child)} hangs on two joints; loops are not supported")
    roots = list(dict.fromkeys(j.parent for j in joints if j.parent not in children))
    if len(roots) != 1:
        raise InputError(
            f"{path} has {len(roots)} base links that joints hang on; expected one: "
            f"{', '.join(roots[:5]) or 'the joints form a loop'}"
        )
    placed, sequence = [_Placed(roots[0], -1, np.eye(3), np.zeros(3))], list[_UrdfJoint]()
    for above in _growing(placed):
        for joint in joints:
            if joint.parent != above.link:
                continue
            if joint.name in moving:
                sequence.append(joint)
                placed.append(_Placed(joint.child, len(sequence) - 1, np.eye(3), np.zeros(3)))
            else:
                rotation = above.rotation @ joint.rotation
                origin = above.origin + above.rotation @ joint.origin
                placed.append(_Placed(joint.child, above.body, rotation, origin))
    return placed, sequence


def _growing(items: list[_Placed]) -> Iterator[_Placed]:
    """Items, including those that are added during the iteration."""
    k = 0
    while k < len(items):
        yield items[k]
        k += 1


def _name(element: ET.Element, what: str, path: str) -> str:
    name = element.get("name")
    if not name:
        raise InputError(f"{path} has a <{what}> without a name; give it one: <{what} name='...'>")
    return name


def _root(path: str | Path) -> ET.Element:
    root = parse_robot(path, "robot", "URDF")
    if any("xacro" in element.tag for element in root.iter()):
        raise InputError(f"{path} holds xacro macros; expand them first: xacro FILE > robot.urdf")
    return root


def _limits(element: ET.Element | None, kind: str, where: str) -> np.ndarray:
    """(4,) lowest and highest coordinate, speed, torque; NaN without a limit."""
    given = {} if element is None else element.attrib
    keys = ("lower", "upper", "velocity", "effort")
    out = [float(numbers(given.get(key, "0"), f"{where}, {key}", 1)[0]) for key in keys]
    if kind == "continuous" or out[0] >= out[1]:
        out[:2] = np.nan, np.nan
    return np.array(out[:2] + [value if value > 0.0 else np.nan for value in out[2:]])


def _dynamics(element: ET.Element | None, where: str) -> dict[str, float]:
    given = {} if element is None else element.attrib
    pairs = (("viscous", "damping"), ("dry", "friction"))
    return {kind: float(numbers(given[key], f"{where}, {key}", 1)[0]) for kind, key in pairs if key in given}


def _pose(element: ET.Element | None, where: str) -> tuple[np.ndarray, np.ndarray]:
    if element is None:
        return np.eye(3), np.zeros(3)
    rpy = numbers(element.get("rpy", "0 0 0"), f"{where}, rpy")
    return rpy_matrix(rpy), numbers(element.get("xyz", "0 0 0"), f"{where}, xyz")


def _mass(element: ET.Element, where: str) -> np.ndarray:
    """(10,) of an <inertial> in the frame of its link."""
    rotation, centre = _pose(element.find("origin"), where)
    mass, inertia = element.find("mass"), element.find("inertia")
    value = numbers("" if mass is None else mass.get("value", ""), f"{where}, mass", 1)[0]
    given = {} if inertia is None else inertia.attrib
    six = np.array([numbers(given.get(key, "0"), f"{where}, {key}", 1)[0] for key in _INERTIA])
    about = np.concatenate([[value], np.zeros(3), six])
    return moved(about, rotation, centre)


def _inertial(row: np.ndarray) -> ET.Element:
    """The element, with the inertia about the centre of mass."""
    centre, about = about_centre(row)
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=written(centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=written(row[:1]))
    upper = about[np.triu_indices(3)]
    ET.SubElement(element, "inertia", {k: written(v) for k, v in zip(_INERTIA, upper, strict=True)})
    return element
