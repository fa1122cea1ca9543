"""`read_mcap`: which joints of a bag are coordinates, and which efforts are forces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial

from leastaction.data.formats.bags import read_bag_table
from leastaction.data.formats.dispatch import StrPath, combined_trajectories
from leastaction.data.formats.layout import Coordinates, Forces, Layout
from leastaction.data.trajectories import Trajectories
from leastaction.errors import InputError

__all__ = ["read_mcap"]


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

    Positions of the messages ``sensor_msgs/msg/JointState`` are coordinates. Joints may come in any sequence,
    and where a message lacks a joint its sample is missing. Messages with the same time are merged.

    Parameters
    ----------
    path : path, or iterable of paths
        ``.mcap``, ``.db3``, or the directory of a bag; several are trials of one system.
    topic : str, optional
        By default the only topic with joint states.
    joints : sequence of str, optional
        Joints of the coordinates, in order; by default they have the coordinates' names.
    coordinates : sequence of str, or mapping of str to str, optional
        Coordinates; or coordinate -> joint. By default the names of `joints`.
    forces : mapping of str to str, or sequence of str, optional
        As for `read_csv`. The column ``<joint>.effort`` is the effort of a joint, ``effort`` that of the
        coordinate's own joint, and ``forces="effort"`` takes those of all coordinates.
    time : {"t", "log"}
        Stamps of the headers, or when the messages were recorded. Times start at zero.
    angles : sequence of str
        Coordinates to unwrap.
    velocities : mapping of str to str, or sequence of str, optional
        Columns of measured velocities, ``<joint>.velocity`` or ``velocity``, in the same form as `forces`;
        ``velocities="velocity"`` takes those of all coordinates. Not used unless asked for: many drivers fill
        the field with differences of the positions, which say nothing new and would count as a second sensor.

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
        Where the headers have no stamps (times are then those of recording), messages repeat a time with
        other values (the first are kept), or efforts are missing (they are interpolated).
    """
    columns = _joint_columns(joints, coordinates)
    if forces == "effort":
        forces = dict.fromkeys(columns, "effort")
    if velocities == "velocity":
        velocities = {coordinate: f"{joint}.velocity" for coordinate, joint in columns.items()}
    layout = Layout.of(columns, time, forces, None, angles, velocities)
    return combined_trajectories(path, layout, partial(read_bag_table, topic=topic))


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
