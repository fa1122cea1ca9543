"""The columns of a robot's log, by the names of common loggers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from leastaction.arms.column_names import QUANTITIES, columns_of, tokens_of, told_joints
from leastaction.data.formats.columns import TIME_NAMES
from leastaction.data.formats.units import normal, parted
from leastaction.data.validation import listed
from leastaction.errors import InputError
from leastaction.identifiers import TIME

__all__ = ["JointColumns", "joint_columns"]

_STAMPS = (("time",), ("rosbagtimestamp",), ("header", "stamp"), ("stamp",))
_EPOCH = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))  # dates since 1970 exceed these numbers


class JointColumns(NamedTuple):
    """The columns of a robot's log, by joint; as text, for a note.

    Attributes
    ----------
    time : str
    time_unit : str or None
        If the file does not say it, but numbers or neighbours do.
    positions, velocities, torques : dict of str to str
        Joint -> column; velocities and torques may be empty.
    currents : bool
        Whether the torques are motor currents.
    """

    time: str
    time_unit: str | None
    positions: dict[str, str]
    velocities: dict[str, str]
    torques: dict[str, str]
    currents: bool

    def __str__(self) -> str:
        kinds = [("position", self.positions), ("velocity", self.velocities)]
        kinds += [("current" if self.currents else "torque", self.torques)]
        parts = [f"time = {self.time}{f' in {self.time_unit}' if self.time_unit else ''}"]
        for joint in self.positions:
            own = [f"{word} {columns[joint]}" for word, columns in kinds if columns]
            parts.append(f"{joint} = {', '.join(own)}")
        return "; ".join(parts)


def joint_columns(
    header: Sequence[str], rows: Sequence[Sequence[str]], joints: Sequence[str], source: str
) -> JointColumns:
    """Find the columns of joints by the names that common loggers give them.

    Recognises joint states of ROS (``/joint_states/position[0]``, ``joint1/position``,
    ``position.panda_joint1``), libfranka (``state.q[0]``, ``state.tau_J[0]``; times in ms), the RTDE of
    Universal Robots (``actual_q_0``, ``actual_current_0``), and plain names (``q1``, ``tau1``). Columns
    belong to a joint by its name, or else by their numbers, in the order of the joints; columns such as
    ``name[0]`` say which number is which joint. Targets and external torques are left out.

    Parameters
    ----------
    header, rows
        Names of the columns, and the first rows as text.
    joints : sequence of str
    source : str
        For messages.

    Raises
    ------
    InputError
        If there are no positions of the joints, or several.

    Examples
    --------
    >>> columns = joint_columns(
    ...     ["timestamp", "target_q_0", "actual_q_0", "actual_q_1", "actual_current_0", "actual_current_1"],
    ...     [["0.0"] * 6], ["shoulder", "elbow"], "log.csv")
    >>> columns.positions, columns.currents
    ({'shoulder': 'actual_q_0', 'elbow': 'actual_q_1'}, True)
    """
    named = {name: tokens_of(name) for name in header}
    told = told_joints(header, rows, named)
    found = {kind: columns_of(kind, named, joints, told, source) for kind in QUANTITIES}
    exact = {joint: name for joint in joints for name in header if named[name] == tokens_of(joint)}
    positions = exact if len(exact) == len(joints) else found["positions"]
    if not positions:
        raise InputError(
            f"{source}: no columns seem to be the positions of the joints {listed(joints)}; its columns are "
            f"{listed(header)}; name the columns of coordinates and forces"
        )
    torques = found["torques"] or found["currents"]
    currents = bool(torques) and not found["torques"]
    return JointColumns(*_time(header, rows, named), positions, found["velocities"], torques, currents)


def _time(
    header: Sequence[str], rows: Sequence[Sequence[str]], named: Mapping[str, tuple[str, ...]]
) -> tuple[str, str | None]:
    """The column of times and its unit, if the numbers show it; TIME is left to `Names.where`."""
    usual = [name for name in header if normal(parted(name, time=True)[0]).casefold() in TIME_NAMES]
    others = [name for stamp in _STAMPS for name in header if named[name][-len(stamp) :] == stamp]
    if not usual and not others:
        return TIME, None
    name = (usual or others)[0]
    if parted(name, time=True)[1] is not None:
        return name, None
    if any("success" in tokens and "rate" in tokens for tokens in named.values()):
        return name, "ms"  # libfranka
    try:
        first = abs(float(rows[0][list(header).index(name)])) if rows else 0.0
    except (ValueError, IndexError):
        return name, None
    return name, next((unit for least, unit in _EPOCH if first > least), None)
