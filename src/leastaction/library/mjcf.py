"""Read the kinematic tree of a MuJoCo model (MJCF), and write a tree as one.

Elements are read by a whitelist: ``compiler``, ``option gravity``, classes of ``default``, and in
``worldbody`` bodies with pose, inertial and joints.  Other elements that affect the mechanics are refused.
Geoms, sites, actuators and similar elements are ignored.  A body with several joints becomes a chain of
links, of which the last has the mass of the body.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from leastaction.data.formats.atomic import write_bytes
from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.library.robot_xml import (
    Compiler,
    Defaults,
    about_centre,
    identifier,
    joint_attributes,
    moved,
    numbers,
    parse_robot,
    pose,
    read_inertial,
    written,
)
from leastaction.library.tree import Joint, KinematicTree, axis_rotation, rpy_matrix

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["read_mjcf", "write_mjcf"]

_KINDS = {"hinge": "revolute", "slide": "prismatic"}
_LEFT_ALONE = frozenset({"geom", "site", "camera", "light"})
_DYNAMICS = {"rotor": "armature", "viscous": "damping", "dry": "frictionloss", "spring": "stiffness"}


class _Place(NamedTuple):
    """A frame of the file in the moving link it is fixed to (-1 is the base), and the class for children."""

    body: int
    rotation: np.ndarray
    origin: np.ndarray
    childclass: str | None

    def holding(self, rotation: np.ndarray, origin: np.ndarray, childclass: str | None) -> _Place:
        turned = self.rotation @ rotation
        return _Place(self.body, turned, self.origin + self.rotation @ origin, childclass or self.childclass)


@dataclass(eq=False)
class _Reader:
    """Walks through the bodies of a file and collects its joints."""

    path: str
    compiler: Compiler
    defaults: Defaults
    moving: set[str] | None
    joints: list[Joint]
    inertias: list[np.ndarray]
    names: list[str]
    bodies: dict[str, int]

    def walk(self, world: ET.Element) -> None:
        """Every body, parents first, in the sequence of the file."""
        at_rest = _Place(-1, np.eye(3), np.zeros(3), world.get("childclass"))
        waiting: list[tuple[ET.Element, _Place]] = [(world, at_rest)]
        while waiting:  # no recursion: files may nest deeply
            element, place = waiting.pop()
            if element.tag == "body":
                place = self.body(element, place)
            elif element.tag == "frame":
                place = place.holding(*pose(element, self.compiler, self.where(element)), _class(element))
            inside = [child for child in element if self.checked(child, element)]
            waiting += [(child, place) for child in reversed(inside)]

    def checked(self, child: ET.Element, parent: ET.Element) -> bool:
        """Whether an element contains bodies."""
        if child.tag in ("body", "frame"):
            return True
        known = {"body": {"inertial", "joint", "freejoint"}}.get(parent.tag, set())
        if child.tag not in _LEFT_ALONE | known:
            raise InputError(
                f"{self.where(parent)} holds <{quoted(child.tag)[1:-1]}>, which is not supported; load "
                "the file in MuJoCo, save the compiled model (mj_saveLastXML) and read that, or remove it"
            )
        return False

    def where(self, element: ET.Element) -> str:
        name = element.get("name")
        return f"{self.path}, {element.tag}" + (f" {quoted(name)}" if name else "")

    def body(self, element: ET.Element, above: _Place) -> _Place:
        """Add the joints and the mass of a body, and return its frame."""
        where = self.where(element)
        if numbers(element.get("gravcomp", "0"), f"{where}, gravcomp", 1)[0] != 0.0:
            raise InputError(
                f"{where} has gravcomp, by which MuJoCo cancels its weight; remove the attribute"
            )
        name = element.get("name") or f"body{len(self.bodies) + 1}"
        here = above.holding(*pose(element, self.compiler, where), _class(element))
        own = element.findall("joint")
        if self.moving is None and element.find("freejoint") is not None:
            raise InputError(f"{where} floats (<freejoint>); remove it to fix the base, or name the joints")
        for number, joint in enumerate(own):
            given = joint_attributes(joint, self.defaults, here.childclass, self.where(joint))
            called = joint.get("name") or f"joint{len(self.joints) + 1}"
            if self.moving is not None and called not in self.moving:
                continue
            last = number == len(own) - 1
            here = self.joint(called, given, here, identifier(name if last else f"{name}_{called}"))
        row = read_inertial(element, self.compiler, where)
        if here.body >= 0:
            if row is None:
                shaped = element.find("geom") is not None  # MuJoCo takes the mass from geoms
                row = np.full(10, np.nan) if shaped else np.zeros(10)
            added = moved(row, here.rotation, here.origin)
            self.inertias[here.body] = self.inertias[here.body] + added
        self.bodies[name] = here.body
        return here

    def joint(self, name: str, given: Mapping[str, str], here: _Place, link: str) -> _Place:
        """Add a joint, and return the frame of its body."""
        where = f"{self.path}, joint {quoted(name)}"
        if name in self.names:
            raise InputError(f"{self.path} has two joints {quoted(name)}; give each a name of its own")
        kind = given.get("type", "hinge")
        if kind not in _KINDS:
            raise InputError(
                f"{where} is of type {quoted(kind)}; hinge and slide are supported: replace it, or name the "
                "joints that move (joints=[...]), and the others stay"
            )
        axis = numbers(given.get("axis", "0 0 1"), f"{where}, axis")
        if not np.linalg.norm(axis) > 0.0:
            raise InputError(f"{where} has an axis without length; write for example axis='0 0 1'")
        axis = axis / np.linalg.norm(axis)
        at = numbers(given.get("pos", "0 0 0"), f"{where}, pos")
        unit = self.compiler.unit if kind == "hinge" else 1.0
        zero = unit * numbers(given.get("ref", "0"), f"{where}, ref", 1)[0]
        rotation, origin = here.rotation, here.origin + here.rotation @ at
        if kind == "hinge":
            rotation = rotation @ axis_rotation(axis, -zero)
        else:
            origin = origin - zero * (rotation @ axis)
        limits = self.compiler.limits(given, unit, where)
        dynamics = self.dynamics(given, unit, where)
        self.names.append(name)
        self.joints.append(
            Joint(
                identifier(name),
                link,
                _KINDS[kind],
                here.body,
                rotation,
                origin,
                axis,
                None,
                limits,
                dynamics,
            )
        )
        self.inertias.append(np.zeros(10))
        return _Place(len(self.joints) - 1, np.eye(3), -at, here.childclass)

    def dynamics(self, given: Mapping[str, str], unit: float, where: str) -> dict[str, float]:
        if np.any(numbers(given.get("springdamper", "0 0"), f"{where}, springdamper", 2)):
            raise InputError(f"{where} has springdamper; give stiffness and damping instead")
        out = {
            kind: float(numbers(given[key], f"{where}, {key}", 1)[0])
            for kind, key in _DYNAMICS.items()
            if key in given
        }
        rest = unit * float(numbers(given.get("springref", "0"), f"{where}, springref", 1)[0])
        if rest and out.get("spring"):
            out["offset"] = -out["spring"] * rest
        return {kind: value for kind, value in out.items() if value}


def read_mjcf(
    path: str | Path,
    *,
    joints: list[str] | None = None,
    gravity: ArrayLike | None = None,
    base_rpy: ArrayLike = (0.0, 0.0, 0.0),
) -> KinematicTree:
    """Read the kinematic tree of a MuJoCo model.

    Parameters
    ----------
    path : str or Path
    joints : list of str, optional
        Joints that move; all others stay where the file places them. By default all.
    gravity : array_like, shape (3,), optional
        In the frame of the world, in m/s²; by default that of the file.
    base_rpy : array_like, shape (3,)
        As of `KinematicTree.from_dh`.

    Returns
    -------
    KinematicTree
        In names, ``_`` replaces characters that are not allowed. Bodies without joints belong to the link
        that they are fixed to. If the mass of a body would come from geoms, the inertia of its link is
        unknown.

    Raises
    ------
    InputError
        If the file is not an MJCF, or has unsupported elements.
    """
    root = parse_robot(path, "mujoco", "MJCF")
    if next(root.iter("include"), None) is not None:
        raise InputError(
            f"{path} includes other files; load it in MuJoCo, save the compiled model "
            "(mj_saveLastXML) and read that"
        )
    compiler = Compiler.of(root, str(path))
    reader = _Reader(
        str(path),
        compiler,
        Defaults.of(root, str(path)),
        None if joints is None else set(joints),
        [],
        [],
        [],
        {},
    )
    for world in root.findall("worldbody"):
        reader.walk(world)
    for name in joints or ():
        if name not in reader.names:
            raise InputError(f"{path} has no joint {quoted(name)}; give names of the file's joints")
    _check_couplings(root, reader)
    made = [
        replace(joint, inertia=None if np.isnan(row).any() else row)
        for joint, row in zip(reader.joints, reader.inertias, strict=True)
    ]
    given = compiler.gravity if gravity is None else np.array(gravity, dtype=float)
    return KinematicTree(tuple(made), rpy_matrix(base_rpy).T @ given, root.get("model", "arm"))


def _class(element: ET.Element) -> str | None:
    return element.get("childclass")


def _check_couplings(root: ET.Element, reader: _Reader) -> None:
    """Refuse loops, and joints that move together."""
    for element in (each for part in root.findall("equality") for each in part):
        if element.get("active") == "false":
            continue
        where = f"{reader.path}, equality <{quoted(element.tag)[1:-1]}>"
        ends = [element.get(key) for key in ("joint1", "joint2", "body1", "body2")]
        if element.tag == "joint" and not {end for end in ends if end} & set(reader.names):
            continue
        one, two = (reader.bodies.get(end, -1) if end else -1 for end in ends[2:])
        if element.tag in ("connect", "weld") and ends[2] and one == two:
            continue  # both ends stay on one link
        raise InputError(
            f"{where} couples joints or closes a loop; name the joints that move (joints=[...]) without "
            "those, or remove it"
        )
    for element in (each for part in root.findall("tendon") for each in part):
        for key in ("stiffness", "damping", "frictionloss", "armature"):
            if np.any(np.array((element.get(key) or "0").split(), dtype=object) != "0"):
                raise InputError(f"{reader.path}, tendon: {key} is not supported; remove the tendon")


def write_mjcf(
    tree: KinematicTree, path: str | Path, dynamics: Mapping[str, ArrayLike] | None = None
) -> None:
    """Write a tree as a MuJoCo model: bodies, joints and inertias, without shapes.

    Parameters
    ----------
    tree : KinematicTree
        With inertias for every link, of a model's ``bodies()``.
    path : str or Path
    dynamics : mapping of str to array_like, shape (n_dof,), optional
        Coefficients of the joints: "rotor", "viscous", "dry" and "spring"; by default `tree.dynamics`. Other
        kinds have no counterpart in MuJoCo and are left out.
    """
    if np.isnan(tree.inertias).any():
        raise InputError("the tree has links without inertia; take the tree of model.bodies()")
    given = tree.dynamics if dynamics is None else dynamics
    acting = {kind: np.broadcast_to(np.asarray(v, float), len(tree)) for kind, v in given.items()}
    root = ET.Element("mujoco", model=tree.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", gravity=written(tree.gravity))
    world = ET.SubElement(root, "worldbody")
    bodies = {-1: world}
    parents = [joint.parent for joint in tree.joints]
    chain: list[int] = []
    for k, row in enumerate(tree.inertias):
        chain = [*chain, k]
        if not row.any() and parents.count(k) == 1 and parents[k + 1 :][:1] == [k]:
            continue  # a link without mass: its joint belongs to the next body
        bodies[k] = _body(bodies[parents[chain[0]]], tree, chain, acting)
        chain = []
    ET.indent(root)
    write_bytes(path, ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _body(
    parent: ET.Element, tree: KinematicTree, chain: list[int], acting: Mapping[str, np.ndarray]
) -> ET.Element:
    """A body with the joints of a chain of links, of which the last has mass."""
    rotation, origin = np.eye(3), np.zeros(3)
    poses: list[tuple[np.ndarray, np.ndarray]] = []
    for k in chain:
        joint = tree.joints[k]
        rotation, origin = rotation @ joint.rotation, origin + rotation @ joint.origin
        poses.append((rotation, origin))
    body = ET.SubElement(parent, "body", name=tree.links[chain[-1]], pos=written(origin))
    body.set("quat", written(_quaternion(rotation)))
    for k, (turned, at) in zip(chain, poses, strict=True):
        joint = tree.joints[k]
        kind = "hinge" if joint.kind == "revolute" else "slide"
        own = ET.SubElement(body, "joint", name=joint.name, type=kind)
        own.set("pos", written(rotation.T @ (at - origin)))
        own.set("axis", written(rotation.T @ turned @ joint.axis))
        for acts, key in _DYNAMICS.items():
            if acts in acting and acting[acts][k]:
                own.set(key, written(acting[acts][k]))
        if joint.limits is not None and np.isfinite(joint.limits[:2]).all():
            own.set("range", written(joint.limits[:2]))
        if joint.limits is not None and np.isfinite(joint.limits[3]):
            own.set("actuatorfrcrange", written(joint.limits[3] * np.array([-1.0, 1.0])))
    row = tree.inertias[chain[-1]]
    if row[0] > 0.0:
        centre, about = about_centre(row)
        xx, xy, xz, yy, yz, zz = about[np.triu_indices(3)]
        full = written(np.array([xx, yy, zz, xy, xz, yz]))
        ET.SubElement(body, "inertial", pos=written(centre), mass=written(row[:1]), fullinertia=full)
    return body


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """(4,) w, x, y, z: the eigenvector of Bar-Itzhack 2000, Journal of Guidance 23:1085."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    upper = np.array(
        [
            [xx - yy - zz, yx + xy, zx + xz, zy - yz],
            [yx + xy, yy - xx - zz, zy + yz, xz - zx],
            [zx + xz, zy + yz, zz - xx - yy, yx - xy],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    x, y, z, w = np.linalg.eigh(upper)[1][:, -1]
    return np.array([w, x, y, z]) * (1.0 if w >= 0.0 else -1.0)
