"""A job of the worker: the identification of a robot arm from its log and the file of the robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from leastaction.app.files import title_of
from leastaction.errors import InputError

if TYPE_CHECKING:
    from leastaction.arms import KinematicTree
    from leastaction.arms.columns import JointColumns

__all__ = ["ROBOTS", "ArmFound", "ArmLog", "identify"]

ROBOTS = (".urdf", ".xml")
"""Suffixes of a file that describes a robot."""


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
class ArmFound:
    """An identified arm.

    Attributes
    ----------
    report : str
        As HTML.
    files : dict of str to bytes
        By name.
    """

    report: str
    files: dict[str, bytes]


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
    urdf = _is_urdf(given.robot)
    writers = arm_files(found.bodies(), urdf=str(given.robot) if urdf else None, mjcf=not urdf)
    progress("report", {})
    with TemporaryDirectory() as folder:
        report = write_arm_report(found, Path(folder) / "report.html", fitted, held_out=rest)
        for name, write in writers.items():
            write(Path(folder) / name)
        return ArmFound(
            report.read_text(encoding="utf-8"), {name: (Path(folder) / name).read_bytes() for name in writers}
        )


def _tree(robot: Path) -> KinematicTree:
    from leastaction import arms

    return arms.read_urdf(robot) if _is_urdf(robot) else arms.read_mjcf(robot)


def _is_urdf(robot: Path) -> bool:
    return robot.suffix == ROBOTS[0]
