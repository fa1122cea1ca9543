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
import sympy as sp
from numpy.typing import ArrayLike

from leastaction.errors import InputError
from leastaction.identifiers import TIME, check_coordinate_names, names_in_terms, quoted
from leastaction.library.collect import collect
from leastaction.library.term import Term

__all__ = ["GRAVITY", "INERTIAL", "Joint", "KinematicTree", "axis_rotation", "rpy_matrix"]

GRAVITY = (0.0, 0.0, -9.81)
INERTIAL = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""Mass, mass times centre of mass, and inertia about the origin of the link's frame."""

_STATES = 20  # velocities at which terms are compared
_ALIKE = 1e-9  # relative difference of terms that act alike
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
    extra : tuple of Term
        Candidates beside those of links and joints; see `with_terms`.
    """

    joints: tuple[Joint, ...]
    gravity: np.ndarray = field(default_factory=lambda: np.array(GRAVITY))
    name: str = "arm"
    extra: tuple[Term, ...] = ()

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

    def with_terms(self, terms: Iterable[str] = (), dissipation: Iterable[str] = ()) -> KinematicTree:
        """The tree with further candidates, for what acts beside rigid links and single joints.

        Examples are a transmission that couples two motors, a spring that compensates gravity, and a cable.
        The coefficient of each is estimated.

        Parameters
        ----------
        terms : iterable of str
            Expressions of joint coordinates q and velocities q_dot that are added to L: kinetic energies, and
            potential energies with a negative coefficient.
        dissipation : iterable of str
            Expressions of the velocities that are added to the dissipation function.

        Raises
        ------
        InputError
            If a term is not an expression of coordinates and velocities, is not defined everywhere, or is a
            dissipation that acts like the friction of single joints, which `identify` selects itself.

        Examples
        --------
        >>> tree = KinematicTree.from_dh([{}, {"a": 0.3}], modified=True)
        >>> coupled = tree.with_terms(["q1_dot*q2_dot"], dissipation=["(q1_dot+q2_dot)**2/2"])
        >>> [term.text for term in coupled.extra]
        ['q1_dot*q2_dot', '(q1_dot+q2_dot)**2/2']
        """
        names = names_in_terms(self.coordinates)
        known = [term for term in self.extra if term.kind == "lagrangian"]
        lost = [term for term in self.extra if term.kind == "dissipation"]
        energies = collect([*known, *terms], names, None, "lagrangian")[0]
        losses = collect([*lost, *dissipation], names, None, "dissipation")[0]
        for term in (*energies, *losses):
            if term.shapes:
                raise InputError(f"{term.text} has the shape parameter {term.shapes[0]}; give it as a number")
            lacking = (TIME,) if term.kind == "lagrangian" else (TIME, *self.coordinates)
            others = [name for name in lacking if name in map(str, term.expr.free_symbols)]
            if others:
                raise InputError(
                    f"{term.text} contains {quoted(others[0])}; terms of L may contain coordinates and "
                    "velocities of the joints, dissipation only velocities"
                )
        _check_terms((*energies, *losses), self.coordinates)
        return replace(self, extra=(*energies, *losses))

    def renamed(self, names: Sequence[str]) -> KinematicTree:
        """The tree with other names for its joints."""
        pairs = list(zip(self.joints, names, strict=True))
        every = [(joint.name + end, name + end) for joint, name in pairs for end in ("", "_dot")]
        return replace(
            self,
            joints=tuple(replace(joint, name=name) for joint, name in pairs),
            extra=tuple(term.renamed(dict(every)) for term in self.extra),
        )


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


def _check_terms(terms: Sequence[Term], coordinates: Sequence[str]) -> None:
    """Raise InputError unless each term is defined everywhere, and each dissipation acts like no other.

    What a dissipation ψ does beside the friction of single joints is ψ(v) − Σ_i ψ(v_i e_i) + (n − 1) ψ(0).
    """
    n, rng = len(coordinates), np.random.default_rng(0)
    states = rng.uniform(-3.0, 3.0, (_STATES + 2 * len(terms), 2 * n))
    still = states * np.repeat([1.0, 0.0], n)
    alone = [still + states * np.eye(2 * n)[n + i] for i in range(n)]
    symbols = [sp.Symbol(name + end, real=True) for end in ("", "_dot") for name in coordinates]
    rows = np.zeros((0, len(states)))
    for term in terms:
        function: Any = sp.lambdify(symbols, term.expr, modules="numpy", dummify=True)
        with np.errstate(all="ignore"):
            values = [function(*x.T) * np.ones(len(x)) for x in (states, *alone, still)]
        if not np.isfinite(values).all():
            raise InputError(f"{term.text} is not defined at all coordinates and velocities")
        if term.kind == "dissipation":
            row = values[0] - np.sum(values[1:-1], axis=0) + (n - 1) * values[-1]
            rows = np.vstack([rows, row / max(np.linalg.norm(values[0]), 1e-300)])
            if np.linalg.matrix_rank(rows, tol=_ALIKE) < len(rows):
                raise InputError(
                    f"the dissipation {term.text} acts like the friction of single joints, which is selected "
                    "without it, or like other terms beside that; leave it out"
                )


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
