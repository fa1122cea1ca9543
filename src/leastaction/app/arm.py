"""A job of the worker: the identification of a robot arm from its log and the file of the robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from leastaction.app.files import title_of
from leastaction.app.jobs import filled, longest
from leastaction.errors import InputError

if TYPE_CHECKING:
    from leastaction import Trajectories
    from leastaction.arms import KinematicTree
    from leastaction.arms.columns import JointColumns

__all__ = ["ROBOTS", "ArmFound", "ArmLog", "ArmMotion", "identify", "motion_of"]

ROBOTS = (".urdf", ".xml")
"""Suffixes of a file that describes a robot."""

_REACH = 98.0  # px: from the base to the farthest point
_LONGEST = 30.0  # s of a log that are shown
_FLAT = 0.01  # of the motion: with less in a direction, a view along that direction shows all of it


@dataclass(frozen=True, eq=False)
class ArmLog:
    """A log of an arm, and the file that describes the arm.

    Attributes
    ----------
    paths : tuple of Path
    robot : Path
    joints : tuple of str
    columns : JointColumns
        Recognised by their names.
    hold_out : str
        Share of the log that is predicted, not fitted; empty for none.
    gains : str
        Torque per ampere of some joints, if the log has currents.
    terms, dissipation : str
        What acts beside links and single joints, as expressions.
    """

    paths: tuple[Path, ...]
    robot: Path
    joints: tuple[str, ...]
    columns: JointColumns
    hold_out: str = "20%"
    gains: str = ""
    terms: str = ""
    dissipation: str = ""

    @property
    def title(self) -> str:
        """Names of the log and the robot."""
        return f"{title_of(self.paths)}, {self.robot.name}"

    @classmethod
    def of(cls, paths: Sequence[Path], robot: Path) -> ArmLog:
        """Read the robot, and the header of the log.

        Raises
        ------
        InputError
            If one of them cannot be read, or the columns of the joints are not recognised.
        """
        from leastaction.arms import log_columns

        tree = _tree(robot)
        columns = log_columns(paths, tree)
        if not columns.torques:
            raise InputError(
                f"{paths[0].name} seems to have neither torques nor motor currents; give their columns names "
                "such as tau1, or use the command: leastaction arm ... --forces"
            )
        return cls(tuple(paths), robot, tree.coordinates, columns)


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """The arm along the longest trial of its log.

    Attributes
    ----------
    trial : str
        Empty if the log has only one.
    duration : float
        Of the trial, in s; the frames may show less.
    frames : dict
        For stick.js, as JSON types. A row holds the points of each view, in pixels to the right and upwards:
        the base, the joints, and the centre of mass of each link that carries no other. ``limbs`` holds the
        indices of the points that are joined.
    """

    trial: str
    duration: float
    frames: dict[str, Any]


@dataclass(frozen=True, eq=False)
class ArmFound:
    """An identified arm.

    Attributes
    ----------
    report : str
        As HTML.
    files : dict of str to bytes
        By name.
    motion : ArmMotion or None
        None if nothing in the drawing would move.
    """

    report: str
    files: dict[str, bytes]
    motion: ArmMotion | None = None


def identify(progress: Callable[[str, dict], None], given: ArmLog) -> ArmFound:
    """Identify an arm from its log, and write it for other programs."""
    from leastaction import arms, write_arm_report
    from leastaction.cli.arm import arm_files
    from leastaction.cli.values import assignments, expression_list

    progress("read", {})
    gains = assignments(given.gains) if given.gains.strip() else None
    added = [expression_list(text) if text.strip() else [] for text in (given.terms, given.dissipation)]
    tree = _tree(given.robot).with_terms(*added)
    log = arms.read_log(given.paths, tree, currents=gains is not None)
    fitted, rest = log.hold_out(given.hold_out) if given.hold_out else (log, None)
    progress("fit", {})
    found = arms.identify(fitted, tree, recording=arms.Recording(gains))
    progress("links", {})
    solid, urdf = found.bodies(), _is_urdf(given.robot)
    writers = arm_files(solid, urdf=str(given.robot) if urdf else None, mjcf=not urdf)
    progress("report", {})
    with TemporaryDirectory() as folder:
        report = write_arm_report(found, Path(folder) / "report.html", fitted, held_out=rest)
        for name, write in writers.items():
            write(Path(folder) / name)
        files = {name: (Path(folder) / name).read_bytes() for name in writers}
        return ArmFound(report.read_text(encoding="utf-8"), files, motion_of(log, solid.tree))


def motion_of(log: Trajectories, tree: KinematicTree, most: int = 900) -> ArmMotion | None:
    """The frames of an animation; None if nothing in it would move.

    Parameters
    ----------
    log : Trajectories
        Its longest trial is shown. Missing samples repeat the previous one.
    tree : KinematicTree
        With the inertias of its links.
    most : int
        Largest number of frames.
    """
    place = longest(log)
    run = log[place]
    n_times = int(np.searchsorted(run.t, run.t[0] + _LONGEST, side="right"))
    kept = slice(None, n_times, -(-n_times // most))
    t, q = run.t[kept], filled(run.q[:, [run.coordinates.index(name) for name in tree.coordinates]])[kept]
    points, limbs = _points(tree, q)
    there = np.asarray(np.isfinite(points).all(axis=(0, 2)))
    if not there.any() or not np.ptp(points[:, there], axis=1).max() > 0.0:
        return None
    scale = _REACH / np.linalg.norm(points[:, there], axis=2).max()
    views = _views(points[:, there], tree.gravity)
    seen = np.stack([scale * points @ plane for _, plane in views], axis=1)  # point, view, time, component
    rows = np.round(seen.transpose(2, 1, 0, 3).reshape(len(t), len(views), -1), 1).tolist()
    frames = {
        "kind": "arm",
        "t": [round(float(x - t[0]), 5) for x in t],
        "measured": [row if full else None for row, full in zip(rows, there, strict=True)],
        "forecast": [],
        "views": [name for name, _ in views],
        "limbs": limbs,
    }
    return ArmMotion(log.names[place] if len(log) > 1 else "", run.duration, frames)


def _points(tree: KinematicTree, q: np.ndarray) -> tuple[np.ndarray, list[list[int]]]:
    """(n_points, n_times, 3) base, joints and centres of mass of the last links; and which are joined."""
    from leastaction.mechanics.rigid_bodies import Motion

    poses = Motion.at(tree, q, np.zeros_like(q), np.zeros_like(q))
    points = [np.zeros((len(q), 3)), *poses.origins]
    limbs = [[joint.parent + 1, i + 1] for i, joint in enumerate(tree.joints)]
    for i in sorted({*range(len(tree))} - {joint.parent for joint in tree.joints}):
        mass, first = tree.inertias[i, 0], tree.inertias[i, 1:4]
        limbs.append([i + 1, len(points)])
        points.append(poses.origins[i] + poses.rotations[i] @ (first / mass))
    return np.array(points), limbs


def _views(points: np.ndarray, gravity: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Names, and (3, 2) directions to the right and upwards: as in the report, or the one that shows all."""
    from leastaction.report.figures_arm import sides

    names, across, (up, _) = zip(*sides(gravity), strict=True)
    spread = np.array([np.std(points @ along, axis=1).max() for along in (*across, up)])
    flat = spread <= _FLAT * spread.max()
    if flat[2] and not flat[:2].any():
        return [
            (f"{names[0]} to the right, from above", np.column_stack([across[0], np.cross(up, across[0])]))
        ]
    kept = [k for k in (0, 1) if not flat[k]] or [0]
    return [(f"{names[k]} to the right, height upwards", np.column_stack([across[k], up])) for k in kept]


def _tree(robot: Path) -> KinematicTree:
    from leastaction import arms

    return arms.read_urdf(robot) if _is_urdf(robot) else arms.read_mjcf(robot)


def _is_urdf(robot: Path) -> bool:
    return robot.suffix == ROBOTS[0]
