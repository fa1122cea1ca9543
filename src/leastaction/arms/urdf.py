"""Read the kinematic tree of a URDF, and write identified inertias back into one.

Only what mechanics needs is read: links with their inertia, joints with origin, axis and kind.  Meshes and
everything else are left alone.  Document types and entities are refused, so that no file can make the parser
expand or fetch anything.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.parsers import expat

import numpy as np

from leastaction.data.formats.atomic import check_path, read_bytes, write_bytes
from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.mechanics.tree import GRAVITY, Joint, KinematicTree, rpy_matrix

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["read_urdf", "write_urdf"]

_MOST = 20_000_000  # bytes
_MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_NAME = re.compile(r"[^\W\d]\w*\Z")


@dataclass(frozen=True, eq=False)
class _UrdfJoint:
    name: str
    kind: str
    parent: str
    child: str
    rotation: np.ndarray
    origin: np.ndarray
    axis: np.ndarray


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
        Joints that move; all others stay where their coordinate is zero, as if they were fixed (the fingers
        of a gripper, for example). By default all joints that can move.
    gravity, base_rpy : array_like, shape (3,)
        As of `KinematicTree.from_dh`.

    Returns
    -------
    KinematicTree
        Its joints bear the names of the file, with ``_`` for signs that a name cannot hold. Links that fixed
        joints hold together are one, and their inertias are added. A link without inertia is unknown.

    Raises
    ------
    InputError
        If the file is no URDF, or has joints that are not supported.
    """
    root = _parsed(path)
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
        moved = _moved(own, link.rotation, link.origin)
        before = inertias[link.body]
        inertias[link.body] = moved if before is None else before + moved
    bodies = {link.link: link for link in placed}
    made: list[Joint] = []
    for joint, inertia in zip(sequence, inertias, strict=True):
        parent = bodies[joint.parent]
        made.append(
            Joint(
                _identifier(joint.name),
                _identifier(joint.child),
                _MOVING[joint.kind],
                parent.body,
                parent.rotation @ joint.rotation,
                parent.origin + parent.rotation @ joint.origin,
                joint.axis,
                inertia,
            )
        )
    turn = rpy_matrix(base_rpy).T
    name = root.get("name", "arm")
    return KinematicTree(tuple(made), turn @ np.array(gravity, dtype=float), name)


def write_urdf(tree: KinematicTree, source: str | Path, path: str | Path) -> None:
    """Write a URDF with the inertias of a tree in place of its own.

    The first link of every body gets them; links that are fixed to it lose theirs, because only the sum is
    known. All else stays as it is, but comments.

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
    root = _parsed(source)
    every = [element.get("name", "") for element in root.findall("joint")]
    moving = {name for name in every if _identifier(name) in tree.coordinates}
    found, _ = _contents(root, str(source), list(moving))
    placed, sequence = _placed(found, moving, str(source))
    if tuple(_identifier(joint.name) for joint in sequence) != tree.coordinates:
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


def _inertial(row: np.ndarray) -> ET.Element:
    """The element, with the inertia about the centre of mass."""
    mass, centre = row[0], row[1:4] / row[0]
    about = _matrix(row[4:]) - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=" ".join(f"{x:.9g}" for x in centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=f"{mass:.9g}")
    upper = about[np.triu_indices(3)]
    ET.SubElement(element, "inertia", {k: f"{v:.9g}" for k, v in zip(_INERTIA, upper, strict=True)})
    return element


def _parsed(path: str | Path) -> ET.Element:
    data = read_bytes(check_path(path), _MOST + 1)
    if len(data) > _MOST:
        raise InputError(f"{path} has more than {_MOST} bytes; a URDF has less")

    def refuse(*_: object) -> int:
        raise InputError(f"{path} declares a document type or entities; remove them, a URDF needs none")

    # expat first, for declarations alone: ElementTree gives no way to refuse them
    guard = expat.ParserCreate()
    guard.StartDoctypeDeclHandler = guard.EntityDeclHandler = guard.ExternalEntityRefHandler = refuse
    try:
        guard.Parse(data, True)
        root = ET.fromstring(data)
    except (expat.ExpatError, ET.ParseError) as error:
        raise InputError(
            f"{path} is not XML: {error}; if it is a xacro file, run xacro on it first"
        ) from None
    if root.tag != "robot":
        raise InputError(f"{path} holds <{quoted(root.tag)[1:-1]}>; expected a URDF, whose root is <robot>")
    if any("xacro" in element.tag for element in root.iter()):
        raise InputError(f"{path} holds xacro macros; expand them first: xacro FILE > robot.urdf")
    return root


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
        np.array([1.0, 0.0, 0.0]) if along is None else _numbers(along.get("xyz", "1 0 0"), f"{where}, axis")
    )
    length = float(np.linalg.norm(axis))
    if kind != "fixed" and length == 0.0:
        raise InputError(f"{where} has an axis without length; write for example <axis xyz='0 0 1'/>")
    return _UrdfJoint(name, kind, ends[0], ends[1], rotation, origin, axis / (length or 1.0))


def _placed(joints: list[_UrdfJoint], moving: set[str], path: str) -> tuple[list[_Placed], list[_UrdfJoint]]:
    """All links that hang on the root, and the moving joints in sequence, parents first."""
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
    """Items, also those that are added meanwhile."""
    k = 0
    while k < len(items):
        yield items[k]
        k += 1


def _mass(element: ET.Element, where: str) -> np.ndarray:
    """(10,) of an <inertial> in the frame of its link."""
    rotation, centre = _pose(element.find("origin"), where)
    mass, inertia = element.find("mass"), element.find("inertia")
    value = _numbers("" if mass is None else mass.get("value", ""), f"{where}, mass", 1)[0]
    given = {} if inertia is None else inertia.attrib
    six = np.array([_numbers(given.get(key, "0"), f"{where}, {key}", 1)[0] for key in _INERTIA])
    about = np.concatenate([[value], np.zeros(3), six])
    return _moved(about, rotation, centre)


def _moved(row: np.ndarray, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Inertial parameters in a frame in which their own has this pose."""
    mass, first = row[0], rotation @ row[1:4]
    own = rotation @ _matrix(row[4:]) @ rotation.T
    cross = origin @ first * np.eye(3) * 2.0 - np.outer(origin, first) - np.outer(first, origin)
    own = own + cross + mass * (origin @ origin * np.eye(3) - np.outer(origin, origin))
    return np.concatenate([[mass], first + mass * origin, own[np.triu_indices(3)]])


def _matrix(six: np.ndarray) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _pose(element: ET.Element | None, where: str) -> tuple[np.ndarray, np.ndarray]:
    if element is None:
        return np.eye(3), np.zeros(3)
    rpy = _numbers(element.get("rpy", "0 0 0"), f"{where}, rpy")
    return rpy_matrix(rpy), _numbers(element.get("xyz", "0 0 0"), f"{where}, xyz")


def _numbers(text: str, where: str, count: int = 3) -> np.ndarray:
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.size != count or not np.isfinite(values).all():
        raise InputError(f"{where} is {quoted(text)}; expected {count} finite number{'s' * (count > 1)}")
    return values


def _name(element: ET.Element, what: str, path: str) -> str:
    name = element.get("name")
    if not name:
        raise InputError(f"{path} has a <{what}> without a name; give it one: <{what} name='...'>")
    return name


def _identifier(name: str) -> str:
    """A name that expressions may hold."""
    text = re.sub(r"\W", "_", name)
    return text if _NAME.match(text) else f"_{text}"
