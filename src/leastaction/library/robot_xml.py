"""Common parts of URDF and MJCF files (XML, numbers, names, inertias), and the settings of an MJCF.

Document types and entities are refused, so that the parser never expands or fetches anything.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import numpy as np

from leastaction.data.formats.atomic import check_path, read_bytes
from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.library.tree import GRAVITY, axis_rotation

__all__ = [
    "Compiler",
    "Defaults",
    "about_centre",
    "identifier",
    "joint_attributes",
    "moved",
    "numbers",
    "parse_robot",
    "pose",
    "read_inertial",
    "symmetric",
    "written",
]

_MOST = 20_000_000  # bytes
_NAME = re.compile(r"[^\W\d]\w*\Z")


def parse_robot(path: str | Path, tag: str, what: str) -> ET.Element:
    """The root of an XML file, which must have this tag.

    Raises
    ------
    InputError
        If the file is too large, is not XML, declares entities, or has another root.
    """
    data = read_bytes(check_path(path), _MOST + 1)
    if len(data) > _MOST:
        raise InputError(f"{path} has more than {_MOST} bytes, too many for a {what}; give another file")

    def refuse(*_: object) -> int:
        raise InputError(f"{path} declares a document type or entities; remove them, a {what} needs none")

    # expat runs first to find declarations, which ElementTree cannot refuse
    guard = expat.ParserCreate()
    guard.StartDoctypeDeclHandler = guard.EntityDeclHandler = guard.ExternalEntityRefHandler = refuse
    try:
        guard.Parse(data, True)
        root = ET.fromstring(data)
    except (expat.ExpatError, ET.ParseError) as error:
        raise InputError(
            f"{path} is not XML: {error}; if it is a xacro file, run xacro on it first"
        ) from None
    if root.tag != tag:
        other = {"robot": "a URDF, for from_urdf", "mujoco": "an MJCF, for from_mjcf"}.get(root.tag)
        found = f"it looks like {other}" if other else "give another file"
        raise InputError(
            f"{path} holds <{quoted(root.tag)[1:-1]}>; expected a {what}, whose root is <{tag}>: {found}"
        )
    return root


def numbers(text: str, where: str, count: int = 3) -> np.ndarray:
    """``count`` finite numbers, separated by blanks."""
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.size != count or not np.isfinite(values).all():
        raise InputError(f"{where} is {quoted(text)}; expected {count} finite number{'s' * (count > 1)}")
    return values


def identifier(name: str) -> str:
    """The name with ``_`` for characters that expressions do not allow."""
    text = re.sub(r"\W", "_", name)
    return text if _NAME.match(text) else f"_{text}"


def moved(row: np.ndarray, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Inertial parameters, transformed from a frame with this pose."""
    mass, first = row[0], rotation @ row[1:4]
    own = rotation @ symmetric(row[4:]) @ rotation.T
    cross = origin @ first * np.eye(3) * 2.0 - np.outer(origin, first) - np.outer(first, origin)
    own = own + cross + mass * (origin @ origin * np.eye(3) - np.outer(origin, origin))
    return np.concatenate([[mass], first + mass * origin, own[np.triu_indices(3)]])


def symmetric(six: np.ndarray) -> np.ndarray:
    """(3, 3) from xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def about_centre(row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass, and (3, 3) inertia about it, from the ten inertial parameters."""
    mass, centre = row[0], row[1:4] / row[0]
    return centre, symmetric(row[4:]) - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))


def written(values: np.ndarray) -> str:
    """Numbers as the text of an attribute."""
    return " ".join(f"{x:.12g}" for x in np.ravel(values).tolist())


# ------ the settings of an MJCF file: units, classes of attributes, orientations and inertias of its elements
# fmt: off
_JOINT = frozenset((
    "name", "class", "type", "group", "pos", "axis", "springdamper", "limited", "actuatorfrclimited",
    "solreflimit", "solimplimit", "solreffriction", "solimpfriction", "stiffness", "range",
    "actuatorfrcrange", "actuatorgravcomp", "margin", "ref", "springref", "armature", "damping",
    "frictionloss", "user",
))
# fmt: on
_CHANGES_MASSES = ("settotalmass", "boundmass", "boundinertia", "balanceinertia", "inertiagrouprange")
_ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")


class Compiler(NamedTuple):
    """Settings of ``compiler`` and ``option``.

    Attributes
    ----------
    unit : float
        Of angles, in rad.
    sequence : str
        Of Euler angles: small letters turn with the body.
    autolimits, from_geoms : bool
        Whether a range implies a limit; whether every mass comes from geoms.
    gravity : (3,) array
    """

    unit: float
    sequence: str
    autolimits: bool
    from_geoms: bool
    gravity: np.ndarray

    @classmethod
    def of(cls, root: ET.Element, path: str) -> Compiler:
        """The settings of a file; a later element overrides an earlier one."""
        given: dict[str, str] = {}
        for element in root.findall("compiler"):
            given.update(element.attrib)
        if given.get("coordinate", "local") != "local":
            raise InputError(f"{path} uses global coordinates; save it with a newer MuJoCo, in local ones")
        for key in _CHANGES_MASSES:
            if given.get(key) not in (None, "0", "-1", "false", "0 5"):
                raise InputError(f"{path}: {key} changes masses; remove it, or read the saved compiled model")
        angle, sequence = given.get("angle", "degree"), given.get("eulerseq", "xyz")
        if angle not in ("degree", "radian"):
            raise InputError(f"{path}: angle is {quoted(angle)}; expected degree or radian")
        if len(sequence) != 3 or set(sequence) - set("xyzXYZ"):
            raise InputError(f"{path}: eulerseq is {quoted(sequence)}; expected three of x, y, z, X, Y, Z")
        gravity = np.array(GRAVITY)
        for element in root.findall("option"):
            gravity = numbers(element.get("gravity", " ".join(map(str, gravity))), f"{path}, gravity")
        return cls(
            np.pi / 180.0 if angle == "degree" else 1.0,
            sequence,
            given.get("autolimits", "true") == "true",
            given.get("inertiafromgeom", "auto") == "true",
            gravity,
        )

    def limits(self, given: Mapping[str, str], unit: float, where: str) -> np.ndarray:
        """(4,) lowest and highest coordinate, speed and torque of a joint; NaN without a limit."""
        out = np.full(4, np.nan)
        limited = given.get("limited", "auto")
        if "range" in given and (limited == "true" or (limited == "auto" and self.autolimits)):
            out[:2] = unit * numbers(given["range"], f"{where}, range", 2)
        if "actuatorfrcrange" in given:
            out[3] = np.abs(numbers(given["actuatorfrcrange"], f"{where}, actuatorfrcrange", 2)).min()
        return out


class Defaults(NamedTuple):
    """Attributes of joints by class; the first class applies to elements without one."""

    main: str
    joints: Mapping[str, Mapping[str, str]]

    @classmethod
    def of(cls, root: ET.Element, path: str) -> Defaults:
        """The defaults of a file; a class inherits from the enclosing one."""
        main, found = "main", dict[str, dict[str, str]]()
        waiting: list[tuple[ET.Element, dict[str, str], bool]] = [
            (element, {}, True) for element in reversed(root.findall("default"))
        ]
        while waiting:
            element, above, outermost = waiting.pop()
            name = element.get("class")
            if name is None and not outermost:
                raise InputError(f"{path} has a <default> without class inside another; give it one")
            if outermost:
                main = name = name or main
                above = found.get(name, {})
            own = dict(above)
            for joint in element.findall("joint"):
                own.update(joint.attrib)
            found[str(name)] = own
            waiting += [(child, own, False) for child in reversed(element.findall("default"))]
        return cls(main, found)


def joint_attributes(
    element: ET.Element, defaults: Defaults, childclass: str | None, where: str
) -> dict[str, str]:
    """The attributes of a joint, including those of its class."""
    name = element.get("class") or childclass or defaults.main
    if name not in defaults.joints and name != defaults.main:
        raise InputError(f"{where} is of class {quoted(name)}, which no <default> defines; define it")
    given = {**defaults.joints.get(name, {}), **element.attrib}
    for key in given:
        if key not in _JOINT:
            raise InputError(f"{where} has the attribute {quoted(key)}, which is not supported; remove it")
    return given


def pose(element: ET.Element, compiler: Compiler, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and origin of a body, frame or inertial."""
    origin = numbers(element.get("pos", "0 0 0"), f"{where}, pos")
    given = [key for key in _ORIENTATIONS if key in element.attrib]
    if len(given) > 1:
        raise InputError(f"{where} has both {given[0]} and {given[1]}; keep one")
    if not given:
        return np.eye(3), origin
    (key,) = given
    sizes = {"quat": 4, "axisangle": 4, "xyaxes": 6}
    values = numbers(element.attrib[key], f"{where}, {key}", sizes.get(key, 3))
    lengths = {"quat": values, "axisangle": values[:3], "zaxis": values, "xyaxes": values[:3]}
    if key in lengths and not np.linalg.norm(lengths[key]) > 0.0:
        raise InputError(
            f"{where}, {key} is {quoted(element.attrib[key])}; it has no length, give a direction"
        )
    rotation = _rotation(key, values, compiler)
    if not np.isfinite(rotation).all():
        raise InputError(f"{where}, {key} is {quoted(element.attrib[key])}; its axes are parallel")
    return rotation, origin


def _rotation(key: str, values: np.ndarray, compiler: Compiler) -> np.ndarray:
    if key == "quat":
        half = np.linalg.norm(values[1:])
        angle = 2.0 * np.arctan2(half, values[0])
        return axis_rotation(values[1:] / half, angle) if half > 0.0 else np.eye(3)
    if key == "axisangle":
        return axis_rotation(values[:3] / np.linalg.norm(values[:3]), compiler.unit * values[3])
    if key == "euler":
        out = np.eye(3)
        for letter, angle in zip(compiler.sequence, compiler.unit * values, strict=True):
            turn = axis_rotation(np.eye(3)["xyz".index(letter.lower())], float(angle))
            out = out @ turn if letter.islower() else turn @ out
        return out
    if key == "xyaxes":
        x = values[:3] / np.linalg.norm(values[:3])
        y = values[3:] - (values[3:] @ x) * x
        y = y / (np.linalg.norm(y) or np.nan)
        return np.stack([x, y, np.cross(x, y)], axis=1)
    z = values / np.linalg.norm(values)
    across = np.cross([0.0, 0.0, 1.0], z)
    sine = float(np.linalg.norm(across))
    axis = across / sine if sine > 1e-12 else np.array([1.0, 0.0, 0.0])
    return axis_rotation(axis, float(np.arctan2(sine, z[2])))


def read_inertial(body: ET.Element, compiler: Compiler, where: str) -> np.ndarray | None:
    """(10,) inertial parameters in the frame of the body; None if the file gives none."""
    element = body.find("inertial")
    if element is None or compiler.from_geoms:
        return None
    where = f"{where}, inertial"
    rotation, centre = pose(element, compiler, where)
    mass = numbers(element.get("mass", ""), f"{where}, mass", 1)
    if "fullinertia" in element.attrib:
        xx, yy, zz, xy, xz, yz = numbers(element.attrib["fullinertia"], f"{where}, fullinertia", 6)
    else:
        xx, yy, zz = numbers(element.get("diaginertia", ""), f"{where}, diaginertia")
        xy = xz = yz = 0.0
    return moved(np.array([*mass, 0.0, 0.0, 0.0, xx, xy, xz, yy, yz, zz]), rotation, centre)
