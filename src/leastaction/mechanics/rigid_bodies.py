"""Equations of motion of kinematic trees, numerically, at many states at once.

All quantities are in the frame of the base.  A joint has the screw S_i = (axis, velocity of the point at the
origin of the base frame), a link the motion v_i of the same kind; with the parent λ,

    v_i = v_λ + S_i q̇_i,    Ṡ_i = v_i × S_i,    a_i = a_λ + S_i q̈_i + Ṡ_i q̇_i,    a_base = −g,
    f_i = I_i a_i + v_i ×* I_i v_i,    τ_i = S_i · Σ_{k beyond i} f_k.

f_k is linear in the ten inertial parameters of link k, which gives the columns.  The derivatives follow
Singh, Russell & Wensing 2022, IEEE Robotics and Automation Letters 7:1776. They are exact and cost a few
evaluations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leastaction.library.tree import INERTIAL, KinematicTree
from leastaction.mechanics import Points

__all__ = ["Motion", "inverse_dynamics", "mass_matrix", "regressor", "slopes"]

_N = len(INERTIAL)


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses and screws of a tree at many states; arrays end with the three or six components.

    Attributes
    ----------
    tree : KinematicTree
    qdot, qddot : (n_points, n_dof) arrays
    rotations, origins : lists of (n_points, 3, 3) and (n_points, 3) arrays
        Pose of each link in the frame of the base.
    screws : list of (n_points, 6) arrays
        S of each joint, angular part first.
    """

    tree: KinematicTree
    qdot: np.ndarray
    qddot: np.ndarray
    rotations: list[np.ndarray]
    origins: list[np.ndarray]
    screws: list[np.ndarray]

    @classmethod
    def at(cls, tree: KinematicTree, q: np.ndarray, qdot: np.ndarray, qddot: np.ndarray) -> Motion:
        """The motion at states of shape (n_points, n_dof) each."""
        rotations: list[np.ndarray] = []
        origins: list[np.ndarray] = []
        screws: list[np.ndarray] = []
        for i, joint in enumerate(tree.joints):
            if joint.parent < 0:
                base, origin = joint.rotation, np.broadcast_to(joint.origin, (len(q), 3))
            else:
                above = rotations[joint.parent]
                base, origin = above @ joint.rotation, origins[joint.parent] + above @ joint.origin
            axis = np.broadcast_to(base @ joint.axis, (len(q), 3))
            if joint.kind == "revolute":
                rotations.append(base @ _turned(joint.axis, q[:, i]))
                screws.append(np.concatenate([axis, _cross(origin, axis)], axis=1))
            else:
                rotations.append(np.broadcast_to(base, (len(q), 3, 3)))
                origin = origin + q[:, i, None] * axis
                screws.append(np.concatenate([np.zeros_like(axis), axis], axis=1))
            origins.append(origin)
        return cls(tree, qdot, qddot, rotations, origins, screws)

    @classmethod
    def of(cls, tree: KinematicTree, points: Points) -> Motion:
        """The motion at points; cached with the points."""

        def make() -> Motion:
            states = np.stack(points.columns, axis=1).reshape(points.n_points, -1, points.n_dof)
            rest = np.zeros((points.n_points, points.n_dof))
            return cls.at(tree, states[:, 0], states[:, 1], states[:, 2] if states.shape[1] > 2 else rest)

        return points.kept(tree, make)

    @property
    def parents(self) -> list[int]:
        return [joint.parent for joint in self.tree.joints]

    @cached_property
    def velocities(self) -> list[np.ndarray]:
        """v_i."""
        out: list[np.ndarray] = []
        for i, parent in enumerate(self.parents):
            own = self.screws[i] * self.qdot[:, i, None]
            out.append(own if parent < 0 else out[parent] + own)
        return out

    @cached_property
    def screw_rates(self) -> list[np.ndarray]:
        """Ṡ_i: the axis moves with the parent."""
        zero = np.zeros_like(self.screws[0])
        return [
            zero if parent < 0 else cross_motion(self.velocities[parent], self.screws[i])
            for i, parent in enumerate(self.parents)
        ]

    @cached_property
    def accelerations(self) -> list[np.ndarray]:
        """a_i, gravity included."""
        out: list[np.ndarray] = []
        for i, parent in enumerate(self.parents):
            own = self.screws[i] * self.qddot[:, i, None] + self.screw_rates[i] * self.qdot[:, i, None]
            out.append(own + (self.base_acceleration if parent < 0 else out[parent]))
        return out

    @property
    def base_acceleration(self) -> np.ndarray:
        """(6,) −g."""
        return np.concatenate([np.zeros(3), -self.tree.gravity])

    def inertias(self, parameters: np.ndarray) -> Iterator[np.ndarray]:
        """(n_points, 6, 6) of each link, from its (10,) parameters."""
        for rotation, origin, row in zip(self.rotations, self.origins, parameters, strict=True):
            mass, first = row[0], rotation @ row[1:4]
            xx, xy, xz, yy, yz, zz = row[4:]
            own = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ _transposed(rotation)
            # from the link's origin to that of the base: first moments h + m p
            total = first + mass * origin
            p, h = _skew(origin), _skew(first)
            out = np.empty((len(origin), 6, 6))
            out[:, :3, :3] = own - p @ h - h @ p - mass * (p @ p)
            out[:, :3, 3:] = _skew(total)
            out[:, 3:, :3] = -out[:, :3, 3:]
            out[:, 3:, 3:] = mass * np.eye(3)
            yield out

    def in_link(self, i: int, vectors: np.ndarray) -> np.ndarray:
        """Screws or motions in the frame of link i: its axes, and the velocity of its own origin."""
        angular, linear = vectors[:, :3], vectors[:, 3:] + _cross(vectors[:, :3], self.origins[i])
        back = _transposed(self.rotations[i])
        parts = [(back @ part[:, :, None])[:, :, 0] for part in (angular, linear)]
        return np.concatenate(parts, axis=1)


def regressor(motion: Motion) -> np.ndarray:
    """(n_links, 10, n_dof, n_points): torques for a unit of each inertial parameter."""
    n, n_points = len(motion.tree), len(motion.qdot)
    out = np.zeros((n, _N, n, n_points))
    for i in range(n):
        v, a = motion.in_link(i, motion.velocities[i]), motion.in_link(i, motion.accelerations[i])
        # acceleration of a body-fixed point at the origin
        a[:, 3:] += _cross(v[:, :3], v[:, 3:])
        wrench = _wrench_columns(v, a)
        for j in motion.tree.ancestors[i]:
            screw = motion.in_link(i, motion.screws[j])
            out[i, :, j] = (screw[:, None, :] @ wrench)[:, 0].T
    return out


def _wrench_columns(v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(n_points, 6, 10) moment and force on a link by its parameters, in its own frame."""
    omega, alpha, linear = v[:, :3], a[:, :3], a[:, 3:]
    out = np.zeros((len(v), 6, _N))
    turning = _skew(alpha) + _skew(omega) @ _skew(omega)
    out[:, 3:, 0] = linear
    out[:, 3:, 1:4] = turning
    out[:, :3, 1:4] = -_skew(linear)
    out[:, :3, 4:] = _on_inertia(alpha) + _skew(omega) @ _on_inertia(omega)
    return out


def _on_inertia(w: np.ndarray) -> np.ndarray:
    """(n_points, 3, 6) L with L (Ixx, Ixy, Ixz, Iyy, Iyz, Izz) = I w."""
    out = np.zeros((len(w), 3, 6))
    x, y, z = w.T
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = x, y, z
    out[:, 1, 1], out[:, 1, 3], out[:, 1, 4] = x, y, z
    out[:, 2, 2], out[:, 2, 4], out[:, 2, 5] = x, y, z
    return out


def inverse_dynamics(motion: Motion, parameters: np.ndarray) -> np.ndarray:
    """(n_dof, n_points) torques, from the (n_links, 10) inertial parameters."""
    forces = [
        _wrench(inertia, motion.velocities[i], motion.accelerations[i])
        for i, inertia in enumerate(motion.inertias(parameters))
    ]
    beyond = _beyond(motion, forces)
    return np.stack([np.einsum("pk,pk->p", s, f) for s, f in zip(motion.screws, beyond, strict=True)])


def mass_matrix(motion: Motion, parameters: np.ndarray) -> np.ndarray:
    """(n_points, n_dof, n_dof)."""
    n = len(motion.tree)
    composite = _beyond(motion, list(motion.inertias(parameters)))
    out = np.zeros((len(motion.qdot), n, n))
    for i in range(n):
        force = _times(composite[i], motion.screws[i])
        for j in motion.tree.ancestors[i]:
            out[:, i, j] = out[:, j, i] = np.einsum("pk,pk->p", motion.screws[j], force)
    return out


def mass_columns(motion: Motion) -> np.ndarray:
    """(n_points, n_links * 10, n_dof, n_dof): derivative of the mass matrix in each parameter."""
    n, n_points = len(motion.tree), len(motion.qdot)
    out = np.zeros((n, _N, n, n, n_points))
    rest = np.zeros((n_points, 6))
    for i in range(n):
        screws = {j: motion.in_link(i, motion.screws[j]) for j in motion.tree.ancestors[i]}
        for k, moved in screws.items():
            wrench = _wrench_columns(rest, moved)
            for j, screw in screws.items():
                if j <= k:
                    out[i, :, j, k] = out[i, :, k, j] = (screw[:, None, :] @ wrench)[:, 0].T
    return np.ascontiguousarray(out.reshape(n * _N, n, n, n_points).transpose(3, 0, 1, 2))


def slopes(motion: Motion, parameters: np.ndarray) -> dict[tuple[int, int, int], np.ndarray]:
    """(nu, i, j) → ∂τ_i/∂q_j^{(nu)}, (n_points,) each."""
    inertias = list(motion.inertias(parameters))
    forces = [
        _wrench(inertia, v, a)
        for inertia, v, a in zip(inertias, motion.velocities, motion.accelerations, strict=True)
    ]
    turnings = [_turning(inertia, v) for inertia, v in zip(inertias, motion.velocities, strict=True)]
    beyond, masses, coriolis = (_beyond(motion, parts) for parts in (forces, inertias, turnings))
    at_rest = np.zeros_like(motion.screws[0])
    accelerated: list[np.ndarray] = []
    for i, parent in enumerate(motion.parents):
        above = motion.base_acceleration + at_rest if parent < 0 else motion.accelerations[parent]
        moved = cross_motion(above, motion.screws[i])
        if parent >= 0:
            moved = moved + cross_motion(motion.velocities[parent], motion.screw_rates[i])
        accelerated.append(moved)
    out: dict[tuple[int, int, int], np.ndarray] = {}
    for i, screw in enumerate(motion.screws):
        rate = motion.screw_rates[i]
        column = {
            0: _times(coriolis[i], rate) + _times(masses[i], accelerated[i]) + cross_force(screw, beyond[i]),
            1: _times(coriolis[i], screw) + 2.0 * _times(masses[i], rate),
            2: _times(masses[i], screw),
        }
        on_rate, on_mass = ((screw[:, None, :] @ part[i])[:, 0] for part in (coriolis, masses))
        for j in motion.tree.ancestors[i]:
            for nu, force in column.items():
                out[nu, j, i] = np.einsum("pk,pk->p", motion.screws[j], force)
            if j != i:
                moving = motion.screw_rates[j]
                out[0, i, j] = _along(on_rate, moving) + _along(on_mass, accelerated[j])
                out[1, i, j] = _along(on_rate, motion.screws[j]) + 2.0 * _along(on_mass, moving)
                out[2, i, j] = out[2, j, i]
    return out


def _beyond(motion: Motion, values: list[np.ndarray]) -> list[np.ndarray]:
    """Sums over each link and its descendants."""
    out = list(values)
    for i in reversed(range(len(out))):
        parent = motion.parents[i]
        if parent >= 0:
            out[parent] = out[parent] + out[i]
    return out


def _wrench(inertia: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    return _times(inertia, a) + cross_force(v, _times(inertia, v))


def _turning(inertia: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n_points, 6, 6) (v×*) I − I (v×) + (I v) ×̄*: twice the matrix B of the reference."""
    cross = _motion_matrix(v)
    h = _times(inertia, v)
    out = -_transposed(cross) @ inertia - inertia @ cross
    # f ×̄* m = m ×* f
    n, f = _skew(h[:, :3]), _skew(h[:, 3:])
    out[:, :3, :3] -= n
    out[:, :3, 3:] -= f
    out[:, 3:, :3] -= f
    return out


def cross_motion(v: np.ndarray, m: np.ndarray) -> np.ndarray:
    """v × m of spatial motions, (n_points, 6)."""
    w = v[:, :3]
    return np.concatenate([_cross(w, m[:, :3]), _cross(w, m[:, 3:]) + _cross(v[:, 3:], m[:, :3])], axis=1)


def cross_force(v: np.ndarray, f: np.ndarray) -> np.ndarray:
    """v ×* f of a motion and a force, (n_points, 6)."""
    w = v[:, :3]
    return np.concatenate([_cross(w, f[:, :3]) + _cross(v[:, 3:], f[:, 3:]), _cross(w, f[:, 3:])], axis=1)


def _motion_matrix(v: np.ndarray) -> np.ndarray:
    out = np.zeros((len(v), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = _skew(v[:, :3])
    out[:, 3:, :3] = _skew(v[:, 3:])
    return out


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (matrices @ vectors[:, :, None])[:, :, 0]


def _along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("pk,pk->p", a, b)


def _transposed(matrices: np.ndarray) -> np.ndarray:
    return matrices.transpose(0, 2, 1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product along the last axis: np.cross takes several times as long."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _skew(a: np.ndarray) -> np.ndarray:
    """(n_points, 3, 3) matrices of a ×."""
    out = np.zeros((len(a), 3, 3))
    out[:, 2, 1], out[:, 0, 2], out[:, 1, 0] = a.T
    out[:, 1, 2], out[:, 2, 0], out[:, 0, 1] = -a.T
    return out


def _turned(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(n_points, 3, 3) rotations about an axis (Rodrigues)."""
    cross = _skew(axis[None])[0]
    sine, versine = np.sin(angle)[:, None, None], (1.0 - np.cos(angle))[:, None, None]
    return np.eye(3) + sine * cross + versine * (cross @ cross)
