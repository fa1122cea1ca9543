"""Distances between the links of an arm, with gradients, by Pinocchio (extra ``robots``).

With the nearest points p₁ and p₂ of two bodies, the normal n from the first to the second, and the velocities
Jᵢ q̇ of the points as parts of their bodies, the distance d changes by ∂d/∂q = nᵀ (J₂ − J₁).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from leastaction.data.formats.atomic import check_path, read_bytes
from leastaction.data.validation import listed
from leastaction.errors import InputError, MissingPackageError
from leastaction.identifiers import quoted
from leastaction.library.tree import KinematicTree
from leastaction.mechanics.rigid_bodies import Motion

__all__ = ["Collisions"]

_POSES = 200  # random ones; shapes that touch in all of them touch by design
_SAME_TURN = 1e-6  # of the trace of a rotation


@dataclass(frozen=True, eq=False)
class Collisions:
    """Which links must keep a distance. Make one by `of_urdf`.

    Attributes
    ----------
    clearance : float
        Least distance, in m.
    pairs : tuple of (str, str)
        Names of the shapes that are compared.
    """

    clearance: float
    pairs: tuple[tuple[str, str], ...]
    _model: Any
    _shapes: Any
    _columns: np.ndarray

    @classmethod
    def of_urdf(
        cls,
        path: str | Path,
        tree: KinematicTree,
        *,
        packages: Sequence[str | Path] = (),
        clearance: float = 0.01,
    ) -> Collisions:
        """The collision shapes of a URDF; a mesh counts as its convex hull.

        Shapes of one link and of links that share a joint are not compared, nor are pairs that touch in
        every one of 200 random poses. Joints that the tree does not have stay at zero.

        Parameters
        ----------
        path : str or Path
        tree : KinematicTree
            Its joints must have the names that they have in the file.
        packages : sequence of str or Path
            Folders in which ``package://`` addresses of meshes are looked up.
        clearance : float
            Least distance between two links, in m.

        Raises
        ------
        InputError
            If the file cannot be read, holds another arm than the tree, or states shapes of one link only;
            if `clearance` is negative; if Pinocchio is not installed.
        """
        if not (np.isfinite(clearance) and clearance >= 0.0):
            raise InputError(f"clearance is {clearance!r}; give a distance in m, zero or more")
        pin, model, shapes = _read(path, packages)
        names = [joint.name for joint in tree.joints]
        if unknown := [name for name in names if not model.existJointName(name)]:
            raise InputError(
                f"{path} has no joint {listed(unknown)}; give the file that the tree was read from"
            )
        joints = [model.getJointId(name) for name in names]
        columns = np.array([model.joints[k].idx_v for k in joints])
        _check_same(pin, model, tree, joints, columns, path)
        links = [_link(model, shape.parentJoint, joints) for shape in shapes.geometryObjects]
        may_meet = [
            (a, b)
            for a, b in combinations(range(len(links)), 2)
            if links[a] != links[b] and not _share_a_joint(tree, links[a], links[b])
        ]
        everything = cls._of(may_meet, clearance, model, shapes, columns)
        furthest = everything.distances(_random_poses(tree)).max(axis=1).tolist()
        apart = [pair for pair, most in zip(may_meet, furthest, strict=True) if most > 0.0]
        if not apart:
            raise InputError(f"{path} has no collision shapes of links that can meet; give a file that does")
        return cls._of(apart, clearance, model, shapes, columns)

    @classmethod
    def _of(
        cls, pairs: Sequence[tuple[int, int]], clearance: float, model: Any, shapes: Any, columns: np.ndarray
    ) -> Collisions:
        own = shapes.copy()
        own.removeAllCollisionPairs()
        for pair in pairs:
            own.addCollisionPair(_pinocchio().CollisionPair(*pair))
        names = [shape.name for shape in shapes.geometryObjects]
        return cls(clearance, tuple((names[a], names[b]) for a, b in pairs), model, own, columns)

    def distances(self, q: np.ndarray) -> np.ndarray:
        """(n_pairs, n_times) distances in m at (n_times, n_dof) coordinates; negative: shapes overlap."""
        return self._evaluated(q, -np.inf)[0]

    def excess(self, q: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
        """What lacks to the clearance and a margin, in m.

        Parameters
        ----------
        q : (n_times, n_dof) array
        margin : float
            In m.

        Returns
        -------
        lacking : (n_pairs, n_times) array
            Zero where the links are further apart.
        slopes : (n_pairs, n_dof, n_times) array
            Its derivatives with respect to the coordinates.
        """
        least = self.clearance + margin
        distances, slopes = self._evaluated(q, least)
        return np.maximum(least - distances, 0.0), -slopes

    def _evaluated(self, q: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
        """Distances, and the slopes of those below the least."""
        pin, shapes = _pinocchio(), self._shapes
        data, placed = self._model.createData(), shapes.createData()
        bodies = [
            [shapes.geometryObjects[k].parentJoint for k in (pair.first, pair.second)]
            for pair in shapes.collisionPairs
        ]
        out, slopes = np.zeros((len(bodies), len(q))), np.zeros((len(bodies), q.shape[1], len(q)))
        for time, pose in enumerate(_poses(pin, self._model, self._columns, q)):
            pin.computeJointJacobians(self._model, data, pose)
            pin.updateGeometryPlacements(self._model, data, shapes, placed)
            pin.computeDistances(shapes, placed)
            for k, (found, (one, other)) in enumerate(zip(placed.distanceResults, bodies, strict=True)):
                out[k, time] = found.min_distance
                if found.min_distance < least:
                    first = self._velocities(pin, data, one, found.getNearestPoint1())
                    second = self._velocities(pin, data, other, found.getNearestPoint2())
                    slopes[k, :, time] = np.ravel(found.normal) @ (second - first)
        return out, slopes

    def _velocities(self, pin: Any, data: Any, body: int, point: np.ndarray) -> np.ndarray:
        """(3, n_dof) velocity of a point of a body for each joint at unit speed."""
        spatial = pin.getJointJacobian(self._model, data, body, pin.ReferenceFrame.WORLD)[:, self._columns]
        return spatial[:3] + np.cross(spatial[3:], np.ravel(point), axis=0)


def _pinocchio() -> Any:
    try:
        return import_module("pinocchio")
    except ImportError:
        raise MissingPackageError("a check of collisions", "pin", "robots", "leave it out") from None


def _read(path: str | Path, packages: Sequence[str | Path]) -> tuple[Any, Any, Any]:
    """Pinocchio, the model, and its shapes, convex."""
    pin = _pinocchio()
    text, folders = read_bytes(check_path(path)).decode("utf-8", "replace"), [str(f) for f in packages]
    try:
        model = pin.buildModelFromXML(text)
        shapes = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION, package_dirs=folders)
    except (ValueError, RuntimeError) as error:
        reason = quoted(" ".join(str(error).split()))
        raise InputError(
            f"Pinocchio cannot read the collision shapes of {path}: {reason}; for meshes that it does not "
            "find, give packages=[the folder that holds them]"
        ) from None
    for shape in shapes.geometryObjects:
        if hasattr(shape.geometry, "buildConvexRepresentation"):
            shape.geometry.buildConvexRepresentation(False)
            shape.geometry = shape.geometry.convex
    return pin, model, shapes


def _poses(pin: Any, model: Any, columns: np.ndarray, q: np.ndarray) -> Iterator[Any]:
    """Pinocchio's coordinates; joints without limits have two of them, cosine and sine."""
    moved = np.zeros(model.nv)
    for row in q:
        moved[columns] = row
        yield pin.integrate(model, pin.neutral(model), moved)


def _check_same(
    pin: Any, model: Any, tree: KinematicTree, joints: Sequence[int], columns: np.ndarray, path: str | Path
) -> None:
    """Refuse a file whose links do not turn as those of the tree; frames and base may differ."""
    q = np.stack([np.zeros(len(tree)), np.random.default_rng(0).uniform(-1.0, 1.0, len(tree))])
    data = model.createData()
    poses: list[list[np.ndarray]] = []
    for pose in _poses(pin, model, columns, q):
        pin.forwardKinematics(model, data, pose)
        poses.append([np.array(data.oMi[k].rotation) for k in joints])
    here, there = np.array(poses)
    own = [np.einsum("ij,ij", *pair) for pair in Motion.at(tree, q, 0.0 * q, 0.0 * q).rotations]
    if np.abs(np.einsum("kij,kij->k", here, there) - own).max() > _SAME_TURN:
        raise InputError(f"{path} holds another arm than the tree; give the file that the tree was read from")


def _link(model: Any, joint: int, joints: Sequence[int]) -> int:
    """Index of the joint of the tree that carries a body of the file; -1 for the base."""
    while joint and joint not in joints:
        joint = model.parents[joint]
    return joints.index(joint) if joint else -1


def _share_a_joint(tree: KinematicTree, one: int, other: int) -> bool:
    return any(k >= 0 and tree.joints[k].parent == parent for k, parent in ((one, other), (other, one)))


def _random_poses(tree: KinematicTree) -> np.ndarray:
    """(200, n_dof) coordinates within the limits, or a turn of joints without any."""
    limits = np.array([np.full(4, np.nan) if j.limits is None else j.limits for j in tree.joints])[:, :2]
    low, high = np.where(np.isfinite(limits), limits, [-np.pi, np.pi]).T
    return np.random.default_rng(0).uniform(low, high, (_POSES, len(tree)))
