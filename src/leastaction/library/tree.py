"""Kinematic trees: links connected by joints of one degree of freedom.

The frame of a link moves with it, and its origin lies on the axis of the joint that carries it.  With the
pose (R₀, p₀) of the joint in the frame of the parent link, its axis a, and its coordinate q, the link has

    revolute:   R = R_parent R₀ exp(q [a]),     p = p_parent + R_parent p₀,
    prismatic:  R = R_parent R₀,                p = p_parent + R_parent (p₀ + q R₀ a).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from leastaction.errors import InputError
from leastaction.identifiers import check_coordinate_names, quoted

__all__ = ["GRAVITY", "INERTIAL", "Joint", "KinematicTree", "axis_rotation", "rpy_matrix"]

GRAVITY = (0.0, 0.0, -9.81)
INERTIAL = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""Mass, mass times centre of mass, and inertia about the origin of the link's frame."""

_DH_KEYS = frozenset({"a", "d", "alpha", "theta", "kind", "name", "link"})
_JOINT_KEYS = frozenset({"origin", "rpy", "axis", "kind", "parent", "name", "link"})


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint and the link that it carries.

    Attributes
    ----------
    name, link : str
        Names of the joint and of the link.
    kind : str
        "revolute" or "prismatic".
    parent : int
        Index of the joint that carries the parent link; -1 for the base. Less than its own index.
    rotation, origin : (3, 3) and (3,) arrays
        Pose of the joint in the parent link's frame at coordinate zero.
    axis : (3,) array
        Unit vector in the frame of the joint.
    inertia : (10,) array or None
        Nominal inertial parameters of the link, see `INERTIAL`, in kg, kg m and kg m².
    limits : (4,) array or None
        Lowest and highest coordinate (rad, m), speed (rad/s, m/s) and torque (N m, N); NaN if the file gives
        none.
    dynamics : mapping of str to float
        Nominal coefficients of the joint: "rotor", "viscous", "dry", "spring" and "offset".
    """

    name: str
    link: str
    kind: str
    parent: int
    rotation: np.ndarray
    origin: np.ndarray
    axis: np.ndarray
    inertia: np.ndarray | None = None
    limits: np.ndarray | None = None
    dynamics: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True, eq=False)
class KinematicTree:
    """The geometry of an arm: joints in sequence, parents first, and the direction of gravity.

    Make one by `from_dh` or `from_joints`, or from a file by ``Library.from_urdf`` or ``Library.from_mjcf``.

    Attributes
    ----------
    joints : tuple of Joint
    gravity : (3,) array
        In the frame of the base, in m/s².
    name : str
    """

    joints: tuple[Joint, ...]
    gravity: np.ndarray = field(default_factory=lambda: np.array(GRAVITY))
    name: str = "arm"

    def __post_init__(self) -> None:
        gravity = _vector(self.gravity, "gravity")
        gravity.flags.writeable = False
        object.__setattr__(self, "gravity", gravity)
        if not self.joints:
            raise InputError("the tree has no movable joint; give a revolute or prismatic joint")
        check_coordinate_names(self.coordinates)
        for k, joint in enumerate(self.joints):
            if not -1 <= joint.parent < k:
                raise InputError(
                    f"the parent of joint {quoted(joint.name)} is number {joint.parent}; give parents first, "
                    f"by their number from 0 to {k - 1}, or -1 for the base"
                )

    @classmethod
    def from_dh(
        cls,
        rows: Iterable[Mapping[str, Any]],
        *,
        modified: bool,
        gravity: ArrayLike = GRAVITY,
        base_rpy: ArrayLike = (0.0, 0.0, 0.0),
        name: str = "arm",
    ) -> KinematicTree:
        """A serial chain from its Denavit–Hartenberg table.

        Parameters
        ----------
        rows : iterable of mappings
            One for each joint: ``a`` and ``d`` in m, ``alpha`` and ``theta`` (at coordinate zero) in rad,
            zero by default; ``kind`` ("revolute", or "prismatic", whose coordinate adds to ``d``), ``name``
            and ``link``.
        modified : bool
            Craig's convention, in which a row is Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d); otherwise a row is
            Rot_z(θ) Trans_z(d) Trans_x(a) Rot_x(α).
        gravity : array_like, shape (3,)
            In the world, in m/s².
        base_rpy : array_like, shape (3,)
            Roll, pitch and yaw of the base in the world, in rad, for the mounting of the arm.
        name : str

        Notes
        -----
        In the unmodified convention a frame lies at the far end of its link. The inertial parameters here
        refer to a frame whose origin lies on the joint's own axis, in both conventions.

        Examples
        --------
        >>> arm = KinematicTree.from_dh([{"a": 0.3}, {"a": 0.2}], modified=False, gravity=(0.0, -9.81, 0.0))
        >>> arm
        <KinematicTree 'arm': q1, q2>
        """
        joints: list[Joint] = []
        rotation, origin = np.eye(3), np.zeros(3)
        for k, row in enumerate(rows):
            where = f"row {k + 1} of the table"
            _check_keys(row, _DH_KEYS, where)
            a, d, alpha, theta = (_number(row, key, where) for key in ("a", "d", "alpha", "theta"))
            turn, tilt = rpy_matrix((0.0, 0.0, theta)), rpy_matrix((alpha, 0.0, 0.0))
            if modified:
                pose = tilt @ turn, np.array([a, 0.0, 0.0]) + tilt @ (0.0, 0.0, d)
            else:
                pose = rotation @ turn, origin
                rotation, origin = tilt, np.array([a, 0.0, d])
                if row.get("kind") == "prismatic":  # the coordinate follows d
                    pose = pose[0], pose[1] + pose[0] @ (0.0, 0.0, d)
                    origin = np.array([a, 0.0, 0.0])
            joints.append(_joint(k, row, k - 1, *pose, np.array([0.0, 0.0, 1.0])))
        return cls(tuple(joints), rpy_matrix(base_rpy).T @ _vector(gravity, "gravity"), name)

    @classmethod
    def from_joints(
        cls,
        joints: Iterable[Mapping[str, Any]],
        *,
        gravity: ArrayLike = GRAVITY,
        base_rpy: ArrayLike = (0.0, 0.0, 0.0),
        name: str = "arm",
    ) -> KinematicTree:
        """A tree from axes and offsets.

        Parameters
        ----------
        joints : iterable of mappings
            One for each joint, parents first: ``axis`` (3 numbers, in the frame of the joint), ``origin``
            (m) and ``rpy`` (rad) of the joint in the frame of its parent link; ``kind``; ``parent`` (name of
            the parent joint, None for the base; by default the previous joint), ``name`` and ``link``.
        gravity, base_rpy, name
            As of `from_dh`.

        Examples
        --------
        >>> gantry = KinematicTree.from_joints([
        ...     {"name": "x", "kind": "prismatic", "axis": (1, 0, 0)},
        ...     {"name": "theta", "axis": (0, 1, 0), "origin": (0.0, 0.0, 0.1)}])
        >>> gantry.coordinates
        ('x', 'theta')
        """
        made: list[Joint] = []
        for k, row in enumerate(joints):
            where = f"joint {k + 1}"
            _check_keys(row, _JOINT_KEYS, where)
            axis = _vector(row.get("axis", (0.0, 0.0, 1.0)), f"the axis of {where}")
            parent = k - 1
            if row.get("parent", "") != "":
                names = [joint.name for joint in made]
                if row["parent"] is not None and row["parent"] not in names:
                    raise InputError(
                        f"{where} hangs on {quoted(row['parent'])}, which does not come before it; it may "
                        f"hang on {', '.join(names) or 'the base (None)'}"
                    )
                parent = -1 if row["parent"] is None else names.index(row["parent"])
            rotation = rpy_matrix(row.get("rpy", (0.0, 0.0, 0.0)))
            origin = _vector(row.get("origin", (0.0, 0.0, 0.0)), f"the origin of {where}")
            made.append(_joint(k, row, parent, rotation, origin, axis))
        return cls(tuple(made), rpy_matrix(base_rpy).T @ _vector(gravity, "gravity"), name)

    def __repr__(self) -> str:
        return f"<KinematicTree {self.name!r}: {', '.join(self.coordinates)}>"

    def __len__(self) -> int:
        return len(self.joints)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links, in the sequence of the joints that carry them."""
        return tuple(joint.link for joint in self.joints)

    @cached_property
    def ancestors(self) -> tuple[tuple[int, ...], ...]:
        """For each joint, itself and the joints between it and the base."""
        found: list[tuple[int, ...]] = []
        for k, joint in enumerate(self.joints):
            found.append((k,) if joint.parent < 0 else (k, *found[joint.parent]))
        return tuple(found)

    @cached_property
    def inertias(self) -> np.ndarray:
        """(n_links, 10) nominal inertial parameters of the links; NaN if unknown."""
        unknown = np.full(len(INERTIAL), np.nan)
        return np.array([unknown if j.inertia is None else j.inertia for j in self.joints])

    @cached_property
    def limits(self) -> np.ndarray:
        """(n_dof, 4) lowest and highest coordinate, speed and torque of each joint; NaN if unknown."""
        unknown = np.full(4, np.nan)
        return np.array([unknown if j.limits is None else j.limits for j in self.joints])

    @property
    def dynamics(self) -> dict[str, np.ndarray]:
        """Kind of friction, rotor or spring → (n_dof,) nominal coefficients; for `ArmModel.of_tree`."""
        kinds = dict.fromkeys(kind for joint in self.joints for kind in joint.dynamics)
        return {kind: np.array([j.dynamics.get(kind, 0.0) for j in self.joints]) for kind in kinds}

    def with_inertias(self, inertias: np.ndarray) -> KinematicTree:
        """The tree with other inertial parameters, (n_links, 10)."""
        given = zip(self.joints, np.asarray(inertias, dtype=float), strict=True)
        joints = [replace(j, inertia=None if np.isnan(row).any() else row.copy()) for j, row in given]
        return replace(self, joints=tuple(joints))

    def renamed(self, names: Sequence[str]) -> KinematicTree:
        """The tree with other names for its joints."""
        pairs = zip(self.joints, names, strict=True)
        return replace(self, joints=tuple(replace(joint, name=name) for joint, name in pairs))


def rpy_matrix(rpy: ArrayLike) -> np.ndarray:
    """(3, 3) rotation by roll, pitch and yaw about fixed axes, in rad: R_z(yaw) R_y(pitch) R_x(roll)."""
    (sr, sp, sy), (cr, cp, cy) = (f(_vector(rpy, "roll, pitch and yaw")) for f in (np.sin, np.cos))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def axis_rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) rotation by an angle in rad about a unit vector (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def _joint(
    k: int, row: Mapping[str, Any], parent: int, rotation: np.ndarray, origin: np.ndarray, axis: np.ndarray
) -> Joint:
    kind, name = row.get("kind", "revolute"), str(row.get("name", f"q{k + 1}"))
    if kind not in ("revolute", "prismatic"):
        raise InputError(f"joint {quoted(name)} is {quoted(kind)}; expected 'revolute' or 'prismatic'")
    length = float(np.linalg.norm(axis))
    if not length > 0.0:
        raise InputError(
            f"the axis of joint {quoted(name)} has no length; give a direction such as (0, 0, 1)"
        )
    return Joint(name, str(row.get("link", f"link{k + 1}")), kind, parent, rotation, origin, axis / length)


def _check_keys(row: Mapping[str, Any], known: frozenset[str], where: str) -> None:
    for key in row:
        if key not in known:
            raise InputError(f"{where} holds {quoted(key)}; expected {', '.join(sorted(known))}")


def _number(row: Mapping[str, Any], key: str, where: str) -> float:
    try:
        value = float(row.get(key, 0.0))
    except (TypeError, ValueError):
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(f"{key} in {where} is {quoted(row[key])}; expected a finite number")
    return value


def _vector(values: Any, what: str) -> np.ndarray:
    try:
        vector = np.array(values, dtype=float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{what} is {quoted(values)}; expected three finite numbers")
    return vector
