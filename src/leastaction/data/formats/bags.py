"""Joint states in ROS 2 bags (MCAP, SQLite, or a directory of either) to a table.

Of the messages only those of type ``sensor_msgs/msg/JointState`` are looked at, and they are taken apart
with the definition that rosbags brings along: the definitions that a bag holds itself
would have to be compiled.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from leastaction.data.formats.atomic import StrPath, read_bytes
from leastaction.data.formats.dispatch import combined_trajectories
from leastaction.data.formats.layout import Coordinates, Forces, Layout, Table
from leastaction.data.trajectories import Trajectories
from leastaction.data.validation import FloatArray, listed
from leastaction.errors import DataWarning, InputError, MissingPackageError
from leastaction.identifiers import quoted

__all__ = ["is_bag", "read_bag_table", "read_mcap"]

_TYPE = "sensor_msgs/msg/JointState"
_EFFORT = "effort"
_VELOCITY = "velocity"
_LONGEST_STEP_BACK = 1_000_000_000  # ns; beyond, the clock was set back, not a message late


@dataclass(frozen=True)
class _Message:
    """Values by joint; the times are in nanoseconds."""

    stamp: int
    logged: int
    position: Mapping[str, float]
    effort: Mapping[str, float]
    velocity: Mapping[str, float] = field(default_factory=dict[str, float])


def is_bag(path: Path) -> bool:
    """Whether a path is a bag, by its suffix or, of a directory, by what is in it."""
    return path.suffix.lower() in (".mcap", ".db3") or (path / "metadata.yaml").is_file()


def read_mcap(
    path: StrPath | Iterable[StrPath],
    *,
    topic: str | None = None,
    joints: Iterable[str] | None = None,
    coordinates: Coordinates | None = None,
    forces: Forces = None,
    time: str = "t",
    angles: Iterable[str] = (),
    velocities: Forces = None,
) -> Trajectories:
    """Read joint states from a ROS 2 bag; needs ``pip install 'leastaction[ros]'``.

    Positions in messages of type ``sensor_msgs/msg/JointState`` are coordinates. Joints may be in any order.
    If a message lacks a joint, its sample is missing. Messages with the same time are merged.

    Parameters
    ----------
    path : path, or iterable of paths
        ``.mcap``, ``.db3``, or the directory of a bag. Several bags are trials of one system.
    topic : str, optional
        By default, the only topic with joint states.
    joints : sequence of str, optional
        Joints of the coordinates, in order. By default, they have the names of the coordinates.
    coordinates : sequence of str, or mapping of str to str, optional
        Coordinates; or coordinate -> joint. By default the names of `joints`.
    forces : mapping of str to str, or sequence of str, optional
        As for `read_csv`. The column ``<joint>.effort`` is the effort of a joint, ``effort`` that of the
        coordinate's own joint, and ``forces="effort"`` takes those of all coordinates.
    time : {"t", "log"}
        Time stamps of the headers, or of the recording. Times start at zero.
    angles : sequence of str
        Coordinates to unwrap.
    velocities : mapping of str to str, or sequence of str, optional
        Columns of measured velocities, ``<joint>.velocity`` or ``velocity``, in the same form as `forces`;
        ``velocities="velocity"`` takes those of all coordinates. Not used by default: many drivers fill the
        field with differences of the positions, which add no information but would count as a second sensor.

    Returns
    -------
    Trajectories

    Raises
    ------
    InputError, DataError
        If the bag cannot be used. InputError if rosbags is not installed.

    Warns
    -----
    DataWarning
        If the headers have no time stamps (the recording times are used), messages repeat a time with other
        values (the first are kept), or efforts are missing (they are interpolated).
    """
    columns = _joint_columns(joints, coordinates)
    if forces == "effort":
        forces = dict.fromkeys(columns, "effort")
    if velocities == "velocity":
        velocities = {coordinate: f"{joint}.velocity" for coordinate, joint in columns.items()}
    layout = Layout.of(columns, time, forces, None, angles, velocities)
    return combined_trajectories(path, layout, partial(read_bag_table, topic=topic))


def read_bag_table(path: Path, layout: Layout, topic: str | None = None) -> tuple[Layout, Table]:
    """Read the joints of `layout` from a bag.

    Columns are ``t`` (stamps of the headers, from the first one on), ``log`` (when messages were recorded),
    the joints, ``<joint>.effort`` and ``<joint>.velocity``; the force ``effort`` and the velocity
    ``velocity`` are those of the coordinate's own joint. A column may name its topic,
    ``/arm/joint_states:shoulder``.

    Raises
    ------
    InputError
        If rosbags is missing, the bag cannot be read, or a topic, joint or effort is not there.
    """
    layout, topic = _split_topic(layout, topic)
    fields = ("position", _EFFORT, _VELOCITY) if layout.velocities else ("position", _EFFORT)
    topic, messages = _messages(path, topic, fields)
    source = f"{path}, topic {topic}"
    joints = tuple(dict.fromkeys(joint for message in messages for joint in message.position))
    if layout.accelerations:
        raise InputError(f"{source}: joint states hold no accelerations; leave accelerations out")
    kinds = {"forces": (_EFFORT, "force on"), "velocities": (_VELOCITY, "velocity of")}
    named = {
        kind: {
            coordinate: f"{layout.coordinates[coordinate]}.{word}" if column == word else column
            for coordinate, column in getattr(layout, kind).items()
        }
        for kind, (word, _) in kinds.items()
    }
    columns = ["t", "log", *joints, *(f"{joint}.{word}" for word, _ in kinds.values() for joint in joints)]
    if layout.asked:
        raise InputError(
            f"{source}: joint states have the units of SI by definition; leave out time_unit and units"
        )
    found = replace(layout, as_written=True, **named).find(columns, source)
    for kind, (word, role) in kinds.items():
        for coordinate, column in getattr(found, kind).items():
            if not column.endswith(f".{word}"):
                joint = column.removesuffix(f".{_EFFORT}").removesuffix(f".{_VELOCITY}")
                article = "an" if word == _EFFORT else "a"
                raise InputError(
                    f"{source}: the {role} {coordinate} is the column {quoted(column)}, which is not "
                    f"{article} {word}; write {quoted(f'{joint}.{word}')}"
                )
    times = _times(messages, found.time, source)
    numbers = _numbers(messages, found, source)
    times, numbers = _in_sequence(times, numbers, source)
    _fill_forces(times, numbers, found, source)
    measured = [*found.coordinates.values(), *found.velocities.values()]
    moving = np.any([np.isfinite(numbers[name]) for name in measured], axis=0)
    numbers = {name: values[moving] for name, values in numbers.items()}
    numbers[found.time] = 1e-9 * (times[moving] - times[moving][:1])
    return found, Table(source, numbers, None, lambda row: f"sample {row} (counted from 0)")


def _split_topic(layout: Layout, topic: str | None) -> tuple[Layout, str | None]:
    """Take the topic off the names of columns; all must have the same."""
    topics = {} if topic is None else {topic: None}

    def plain(column: str) -> str:
        before, colon, name = column.rpartition(":")
        if not colon or not before.startswith("/"):
            return column
        topics[before] = None
        return name

    kinds = ("coordinates", "forces", "velocities")
    plainly = {
        kind: {name: plain(column) for name, column in getattr(layout, kind).items()} for kind in kinds
    }
    if len(topics) > 1:
        raise InputError(
            f"joints of the topics {listed(topics)} have times of their own; take those of one topic"
        )
    return replace(layout, **plainly), next(iter(topics), None)


def _messages(path: Path, topic: str | None, fields: tuple[str, ...]) -> tuple[str, list[_Message]]:
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingPackageError(f"{path}: reading ROS 2 bags", "rosbags", "ros") from None
    if not path.is_dir():
        read_bytes(path, 1)  # missing and empty files, in our words
    types = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with Reader(path) as reader:
            kinds = {connection.topic: connection.msgtype for connection in reader.connections}
            topic = _choose(topic, kinds, str(path))
            chosen = [connection for connection in reader.connections if connection.topic == topic]
            messages = [
                _message(types.deserialize_cdr(data, _TYPE), logged, number, f"{path}, topic {topic}", fields)
                for number, (_, logged, data) in enumerate(reader.messages(connections=chosen))
            ]
    except InputError:
        raise
    except Exception as error:  # a damaged bag can fail in many ways
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{path} is a damaged bag, or of another kind ({quoted(reason)}); a recording that was cut off "
            "can be repaired with mcap recover or ros2 bag reindex"
        ) from None
    if not messages:
        raise InputError(f"{path}, topic {topic}: there is no message")
    return topic, messages


def _choose(topic: str | None, kinds: Mapping[str, str], path: str) -> str:
    """Return the topic asked for, or the only one with joint states."""
    states = [name for name, kind in kinds.items() if kind == _TYPE]
    if topic is None:
        if len(states) == 1:
            return states[0]
        if not states:
            there = f"its topics are {listed(kinds)}" if kinds else "it has no topics"
            raise InputError(f"{path} has no topic of type {_TYPE}; {there}")
        raise InputError(
            f"{path} has joint states in the topics {listed(states)}; name one: topic=... in read_mcap, or "
            f"{quoted(states[0] + ':JOINT')} as the column of a coordinate"
        )
    if topic not in kinds:
        raise InputError(
            f"{path} has no topic {quoted(topic)}; with joint states it has {listed(states) or 'none'}"
        )
    if kinds[topic] != _TYPE:
        raise InputError(f"{path}: topic {quoted(topic)} is of type {kinds[topic]}; expected {_TYPE}")
    return topic


def _message(state: Any, logged: int, number: int, source: str, fields: tuple[str, ...]) -> _Message:
    names: list[str] = list(state.name)
    if len(set(names)) < len(names):
        raise InputError(f"{source}, message {number}: a joint is named twice among {listed(names)}")
    values: dict[str, dict[str, float]] = {}
    for kind in fields:
        array = getattr(state, kind)
        # The message definition allows an array to be empty: then there is nothing to report of this kind.
        if len(array) not in (0, len(names)):
            raise InputError(
                f"{source}, message {number}: there are {len(array)} values of {kind} for "
                f"{len(names)} joint(s)"
            )
        values[kind] = dict(zip(names, array.tolist(), strict=False))
    # Joints are known by name even where only their velocity is reported.
    values["position"] = dict.fromkeys(names, np.nan) | values["position"]
    stamp = state.header.stamp
    return _Message(stamp.sec * 1_000_000_000 + stamp.nanosec, logged, **values)


def _times(messages: list[_Message], column: str, source: str) -> np.ndarray:
    """Return the times in nanoseconds: stamps, or when the messages were logged where there are no stamps."""
    stamps = np.array([message.stamp for message in messages], dtype=np.int64)
    logged = np.array([message.logged for message in messages], dtype=np.int64)
    if column == "log":
        return logged
    empty = np.flatnonzero(stamps == 0)
    if empty.size == stamps.size:
        _note(f"{source}: the headers have no stamps; times are those of recording, which lag and vary")
        return logged
    # The first stamp of a simulated clock may be zero.
    if empty.size and (empty.size > 1 or empty[0] > 0):
        raise InputError(
            f"{source}, message {empty[-1]}: the header has no stamp, but others have; use the times of "
            "recording (time: log)"
        )
    back = np.flatnonzero(np.diff(stamps) < -_LONGEST_STEP_BACK)
    if back.size:
        step = 1e-9 * float(stamps[back[0]] - stamps[back[0] + 1])
        raise InputError(
            f"{source}, message {back[0] + 1}: the stamp is {step:.3g} s before that of the message before "
            "it; the clock was set back: split the bag there, or use the times of recording (time: log)"
        )
    return stamps


def _numbers(messages: list[_Message], layout: Layout, source: str) -> dict[str, FloatArray]:
    numbers: dict[str, FloatArray] = {}
    for kind, word in (("coordinates", "position"), ("forces", _EFFORT), ("velocities", _VELOCITY)):
        for column in dict.fromkeys(getattr(layout, kind).values()):
            joint = column if kind == "coordinates" else column.removesuffix(f".{word}")
            values = (getattr(message, word).get(joint, np.nan) for message in messages)
            numbers[column] = np.fromiter(values, dtype=np.float64, count=len(messages))
    for column in layout.velocities.values():
        if not np.isfinite(numbers[column]).any():
            raise InputError(f"{source}: there is no velocity in column {quoted(column)}; leave it out")
    return numbers


def _in_sequence(
    times: np.ndarray, numbers: dict[str, FloatArray], source: str
) -> tuple[np.ndarray, dict[str, FloatArray]]:
    """Sort by time and merge what has the same time, as the messages of two controllers of one arm do."""
    order = np.argsort(times, kind="stable")
    times = times[order]
    first = np.flatnonzero(np.diff(times, prepend=times[0] - 1) > 0)
    group = np.cumsum(np.diff(times, prepend=times[0] - 1) > 0) - 1
    repeats = np.setdiff1d(np.arange(times.size), first)
    merged: dict[str, FloatArray] = {}
    conflicts = np.zeros(times.size, dtype=bool)
    for name, values in numbers.items():
        values = values[order]
        kept = values[first]
        for row in repeats:
            target = group[row]
            if np.isnan(kept[target]):
                kept[target] = values[row]
            elif np.isfinite(values[row]) and values[row] != kept[target]:
                conflicts[row] = True
        merged[name] = kept
    if conflicts.any():
        _note(
            f"{source}: {conflicts.sum()} message(s) repeat a time with other values; the first ones are kept"
        )
    return times[first], merged


def _fill_forces(times: np.ndarray, numbers: dict[str, FloatArray], layout: Layout, source: str) -> None:
    """Interpolate efforts where a message lacks the joint: equations need a force at every time."""
    for column in dict.fromkeys(layout.forces.values()):
        there = np.isfinite(numbers[column])
        if not there.any():
            raise InputError(f"{source}: there is no effort in column {quoted(column)}; leave out its force")
        if there.all():
            continue
        # Relative times: nanoseconds since 1970 are more than a float can hold.
        since = 1e-9 * (times - times[0])
        numbers[column][~there] = np.interp(since[~there], since[there], numbers[column][there])
        _note(
            f"{source}: {(~there).sum()} of {there.size} values of {column} are missing and were interpolated"
        )


def _note(text: str) -> None:
    warnings.warn(text, DataWarning, stacklevel=2)


def _joint_columns(joints: Iterable[str] | None, coordinates: Coordinates | None) -> dict[str, str]:
    """Coordinate -> joint."""
    if joints is not None:
        joints = [joints] if isinstance(joints, str) else list(joints)
        if isinstance(coordinates, Mapping):
            raise InputError("coordinates already say which joint each one is; leave out joints")
        if coordinates is None:
            coordinates = joints
    if coordinates is None:
        raise InputError('name the joints, e.g. coordinates={"theta": "shoulder"} or joints=["shoulder"]')
    columns = Layout.of(coordinates, "t", None, None, ()).coordinates
    if joints is None:
        return columns
    if len(joints) != len(columns):
        raise InputError(
            f"there are {len(joints)} joints for {len(columns)} coordinates ({', '.join(columns)})"
        )
    return dict(zip(columns, joints, strict=True))
