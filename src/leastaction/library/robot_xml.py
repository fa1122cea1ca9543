"""What URDF and MJCF files share: XML read without surprises, numbers, names, and inertias in other frames.

Document types and entities are refused, so that no file can make the parser expand or fetch anything.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

import numpy as np

from leastaction.data.formats.atomic import check_path, read_bytes
from leastaction.errors import InputError
from leastaction.identifiers import quoted

__all__ = ["about_centre", "identifier", "moved", "numbers", "parse_robot", "symmetric", "written"]

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
        raise InputError(f"{path} has more than {_MOST} bytes; a {what} has less")

    def refuse(*_: object) -> int:
        raise InputError(f"{path} declares a document type or entities; remove them, a {what} needs none")

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
    if root.tag != tag:
        other = {"robot": "a URDF, for from_urdf", "mujoco": "an MJCF, for from_mjcf"}.get(root.tag)
        found = f"it looks like {other}" if other else "give another file"
        raise InputError(
            f"{path} holds <{quoted(root.tag)[1:-1]}>; expected a {what}, whose root is <{tag}>: {found}"
        )
    return root


def numbers(text: str, where: str, count: int = 3) -> np.ndarray:
    """So many finite numbers, separated by blanks."""
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.size != count or not np.isfinite(values).all():
        raise InputError(f"{where} is {quoted(text)}; expected {count} finite number{'s' * (count > 1)}")
    return values


def identifier(name: str) -> str:
    """The name with ``_`` for signs that expressions cannot hold."""
    text = re.sub(r"\W", "_", name)
    return text if _NAME.match(text) else f"_{text}"


def moved(row: np.ndarray, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Inertial parameters in a frame in which their own frame has this pose."""
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
