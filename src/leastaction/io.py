"""Read measured data and write files. Nothing else in the package touches the disk.

Every reader returns `Trajectories` and takes the same arguments: the columns of coordinates, time, forces,
trial, and measured velocities and accelerations. Column names need not be valid coordinate names:
``coordinates`` may map one to the other, ``{"theta": "Angle (rad)"}``.

Tables (CSV, Parquet, Excel, data frames) have one row for each time. In NPZ and MAT files every column is a
separate variable, or the coordinates are the columns of one matrix ``q`` of shape (n_times, n_dof), in the
order of ``coordinates``, beside the time ``t``. A missing sample is an empty cell, NaN or NA. Times and
forces must be complete. A file without a trial column is one trial. Times increase within a trial.

A column may be named without its unit, ``theta`` for ``theta [deg]``. `Trajectories.findings` reports every
conversion.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Unpack

from leastaction.data.formats.arrays import read_mat_table, read_npz_table
from leastaction.data.formats.atomic import StrPath, write_bytes, write_text
from leastaction.data.formats.bags import read_mcap
from leastaction.data.formats.csv import read_csv_table, write_csv
from leastaction.data.formats.dispatch import combined_trajectories, group_names, to_trajectories
from leastaction.data.formats.frames import frame_table, read_parquet_table
from leastaction.data.formats.layout import Coordinates, Forces, Layout, UnitOptions
from leastaction.data.formats.streams import stream
from leastaction.data.trajectories import Trajectories

__all__ = [
    "from_frame",
    "read",
    "read_csv",
    "read_groups",
    "read_many",
    "read_mat",
    "read_mcap",
    "read_npz",
    "read_parquet",
    "stream",
    "write_bytes",
    "write_csv",
    "write_text",
]


def read_csv(
    path: StrPath | Iterable[StrPath],
    coordinates: Coordinates,
    time: str = "t",
    forces: Forces = None,
    trial: str | None = None,
    angles: Iterable[str] = (),
    velocities: Forces = None,
    accelerations: Forces = None,
    **unit_options: Unpack[UnitOptions],
) -> Trajectories:
    """Read trajectories from a CSV file.

    The first line names the columns, the second may hold their units; lines before it that begin with ``#``
    are skipped (a header written by `numpy.savetxt` is found). Cells are separated by commas, semicolons,
    tabs or spaces. If they are not separated by commas, numbers may have a decimal comma. The text is
    UTF-8, UTF-16 with its mark, or Windows-1252 (Latin-1), and may be compressed with gzip.

    Parameters
    ----------
    path : path, or iterable of paths
        File to read. Several files are trials of one system.
    coordinates : sequence of str, or mapping of str to str or None
        Coordinates that are also column names, or a mapping coordinate -> column. None stands for a
        coordinate without a column, on which forces may act; it comes after the others.
    time : str
        Column of the times: seconds, another unit that the file states, or dates
        (``2024-05-01T12:00:00.25``), which become seconds since the first date of the file. A file
        without a column ``t`` may have one called ``time``, ``timestamp``, ``Zeit [s]`` or the like.
    forces : mapping of str to str, or sequence of str, optional
        Known generalised forces: a mapping coordinate -> column, or columns for the coordinates in order,
        None for a coordinate that is not driven. The list may be shorter than that of the coordinates.
    trial : str, optional
        Column with the name of the trial. By default the column ``trial``, if there is one.
    angles : sequence of str
        Coordinates to unwrap (`Trajectories.unwrap`).
    velocities, accelerations : mapping of str to str, or sequence of str, optional
        Columns of measured q̇ and q̈, in the same form as `forces`. Samples may be missing. Use readings of
        separate sensors only: differences of the positions add no information.
    time_unit : str, optional
        Unit of the times: ``"s"``, ``"ms"``, ``"us"``, ``"ns"``, ``"min"`` or ``"h"``. It overrides the file.
    units : {"SI", "as-written"}, or mapping of str to str
        ``"SI"``: columns with a unit in their name (``angle [deg]``, ``x / mm``, ``phi_deg``) or in the row
        below the header are converted to rad, m, N, N m and their rates. ``"as-written"`` keeps all numbers
        as they are, including times. A mapping sets the unit of a coordinate or column: ``{"theta": "deg"}``.
        The default is ``"SI"``.

    Returns
    -------
    Trajectories
        In the order of the files. `Trajectories.findings` lists what was converted. The trajectory of a file
        without a trial column has the file's name without suffix. Trials of several files are called
        ``file/trial``, with a number added to equal names. Lengths and times may differ.

    Raises
    ------
    InputError
        If the file cannot be used (the message names file, line and column), or no path or one twice is
        given.
    DataError
        If a coordinate has fewer than 5 samples in a trial.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     lines = ["t,theta,tau"] + [f"{k},{k / 8},1" for k in range(6)]
    ...     path = write_text(f"{folder}/run.csv", chr(10).join(lines))
    ...     read_csv(path, ["theta"], forces={"theta": "tau"})
    <Trajectories of theta: 1 trajectory, 6 samples, 5 s, driven>
    >>> with TemporaryDirectory() as folder:
    ...     lines = ["t,theta,gyro"] + [f"{k},{k / 8},0.125" for k in range(6)]
    ...     path = write_text(f"{folder}/run.csv", chr(10).join(lines))
    ...     read_csv(path, ["theta"], velocities={"theta": "gyro"})[0]
    <Trajectory 'run': theta; 6 times, 5 s, velocities>
    >>> with TemporaryDirectory() as folder:
    ...     lines = ["time_ms;theta [deg]"] + [f"{20 * k};{k},5" for k in range(6)]
    ...     path = write_text(f"{folder}/run.csv", chr(10).join(lines))
    ...     runs = read_csv(path, ["theta"], time="time")
    >>> runs
    <Trajectories of theta: 1 trajectory, 6 samples, 0.1 s>
    >>> for finding in runs.findings:
    ...     print(finding)
    the times in 'time_ms' were converted from ms to seconds
    theta was converted from deg to rad
    numbers were read with a decimal comma
    """
    layout = Layout.of(coordinates, time, forces, trial, angles, velocities, accelerations)
    layout = layout.measured_in(**unit_options)
    return combined_trajectories(path, layout, read_csv_table)


def read_parquet(
    path: StrPath | Iterable[StrPath],
    coordinates: Coordinates,
    time: str = "t",
    forces: Forces = None,
    trial: str | None = None,
    angles: Iterable[str] = (),
    velocities: Forces = None,
    accelerations: Forces = None,
    **unit_options: Unpack[UnitOptions],
) -> Trajectories:
    """Read trajectories from a Parquet file; needs ``pip install 'leastaction[parquet]'``.

    Parameters
    ----------
    path, coordinates, time, forces, trial, angles, velocities, accelerations, time_unit, units
        As for `read_csv`.

    Returns
    -------
    Trajectories

    Raises
    ------
    InputError, DataError
        As for `read_csv`, with rows counted from 0 in place of lines; InputError if pyarrow is not installed.
    """
    layout = Layout.of(coordinates, time, forces, trial, angles, velocities, accelerations)
    layout = layout.measured_in(**unit_options)
    return combined_trajectories(path, layout, read_parquet_table)


def read_npz(
    path: StrPath | Iterable[StrPath],
    coordinates: Coordinates,
    time: str = "t",
    forces: Forces = None,
    trial: str | None = None,
    angles: Iterable[str] = (),
    velocities: Forces = None,
    accelerations: Forces = None,
    **unit_options: Unpack[UnitOptions],
) -> Trajectories:
    """Read trajectories from an NPZ file of NumPy. Pickled objects are refused.

    Parameters
    ----------
    path, coordinates, time, forces, trial, angles, velocities, accelerations, time_unit, units
        As for `read_csv`; columns are variables of shape (n_times,). If none of the coordinates is a
        variable, but ``q`` of shape (n_times, n_dof) is, its columns are the coordinates in order.

    Returns
    -------
    Trajectories

    Raises
    ------
    InputError, DataError
        As for `read_csv`, with rows counted from 0 in place of lines.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 11)
    >>> with TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/run.npz", t=t, q=np.column_stack([np.cos(t), np.sin(t)]))
    ...     trajectories = read_npz(f"{folder}/run.npz", ["x", "y"])
    >>> trajectories[0]
    <Trajectory 'run': x, y; 11 times, 1 s>
    """
    layout = Layout.of(coordinates, time, forces, trial, angles, velocities, accelerations)
    layout = layout.measured_in(**unit_options)
    return combined_trajectories(path, layout, read_npz_table)


def read_mat(
    path: StrPath | Iterable[StrPath],
    coordinates: Coordinates,
    time: str = "t",
    forces: Forces = None,
    trial: str | None = None,
    angles: Iterable[str] = (),
    velocities: Forces = None,
    accelerations: Forces = None,
    **unit_options: Unpack[UnitOptions],
) -> Trajectories:
    """Read trajectories from a MATLAB file; version 7.3 needs ``pip install 'leastaction[mat73]'``.

    Parameters
    ----------
    path, coordinates, time, forces, trial, angles, velocities, accelerations, time_unit, units
        As for `read_npz`; rows and columns count as vectors.

    Returns
    -------
    Trajectories

    Raises
    ------
    InputError, DataError
        As for `read_npz`; InputError if the file has version 7.3 and h5py is not installed.

    """
    layout = Layout.of(coordinates, time, forces, trial, angles, velocities, accelerations)
    layout = layout.measured_in(**unit_options)
    return combined_trajectories(path, layout, read_mat_table)


def from_frame(
    frame: Any,
    coordinates: Coordinates,
    time: str = "t",
    forces: Forces = None,
    trial: str | None = None,
    angles: Iterable[str] = (),
    velocities: Forces = None,
    accelerations: Forces = None,
    **unit_options: Unpack[UnitOptions],
) -> Trajectories:
    """Read trajectories from a data frame: pandas, polars, Arrow, or any other that narwhals supports.

    Parameters
    ----------
    frame : DataFrame
        One row for each time. A null is a missing sample.
    coordinates, time, forces, trial, angles, velocities, accelerations, time_unit, units
        As for `read_csv`.

    Returns
    -------
    Trajectories

    Raises
    ------
    InputError, DataError
        As for `read_csv`, with rows counted from 0 in place of lines.

    Examples
    --------
    >>> import pandas as pd
    >>> frame = pd.DataFrame({"t": range(6), "x": [0.0, 1.0, None, 3.0, 4.0, 5.0]})
    >>> from_frame(frame, ["x"]).n_samples
    5
    """
    layout = Layout.of(coordinates, time, forces, trial, angles, velocities, accelerations)
    layout = layout.measured_in(**unit_options)
    return to_trajectories(*frame_table(frame, layout))


def read(
    path: StrPath | Iterable[StrPath],
    coordinates: Coordinates,
    time: str = "t",
    forces: Forces = None,
    trial: str | None = None,
    angles: Iterable[str] = (),
    velocities: Forces = None,
    accelerations: Forces = None,
    **unit_options: Unpack[UnitOptions],
) -> Trajectories:
    r"""Read trajectories from one or several files, whose suffix determines the format.

    Parameters
    ----------
    path : path, or iterable of paths
        ``.csv``, ``.tsv``, ``.txt`` or ``.dat`` (each also with ``.gz``), ``.parquet``, ``.npz``, ``.mat``,
        ``.xlsx`` (the first sheet; needs ``pip install 'leastaction[excel]'``), or a ROS 2 bag
        (`read_mcap`): ``.mcap``, ``.db3`` or its directory.
    coordinates, time, forces, trial, angles, velocities, accelerations, time_unit, units
        As for `read_csv`.

    Returns
    -------
    Trajectories

    Raises
    ------
    InputError, DataError
        As for the reader of that format; InputError for an unknown suffix.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     paths = [
    ...         write_text(f"{folder}/{day}.csv", "t,x" + "".join(f"\n{k},{k / 8}" for k in range(n)))
    ...         for day, n in [("monday", 6), ("tuesday", 8)]
    ...     ]
    ...     runs = read(paths, ["x"])
    >>> runs.names, [run.n_times for run in runs]
    (('monday', 'tuesday'), [6, 8])
    """
    layout = Layout.of(coordinates, time, forces, trial, angles, velocities, accelerations)
    layout = layout.measured_in(**unit_options)
    return combined_trajectories(path, layout)


def read_groups(
    path: StrPath | Iterable[StrPath],
    column: str,
    coordinates: Coordinates,
    time: str = "t",
    trial: str | None = None,
) -> tuple[str, ...]:
    r"""Read the group of each trial, for the ``groups`` of `leastaction.discover`.

    Parameters
    ----------
    path, coordinates, time, trial
        As for `read`. The groups are in the order of its trajectories.
    column : str
        Column with the name of the group, constant within a trial.

    Raises
    ------
    InputError
        As for `read`; if the column changes within a trial, or is empty.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     rows = [f"\n{t},{t / 8},{trial},{load}" for trial, load in ("a0", "b1") for t in range(6)]
    ...     path = write_text(f"{folder}/runs.csv", "t,x,trial,payload" + "".join(rows))
    ...     read_groups(path, "payload", ["x"])
    ('0', '1')
    """
    return group_names(path, Layout.of(coordinates, time, None, trial, ()), column)


def read_many(
    paths: Iterable[StrPath] | StrPath,
    coordinates: Coordinates,
    time: str = "t",
    forces: Forces = None,
    trial: str | None = None,
    angles: Iterable[str] = (),
    velocities: Forces = None,
    accelerations: Forces = None,
    **unit_options: Unpack[UnitOptions],
) -> Trajectories:
    """Read several files as trials of one system: `read` under another name."""
    rest = (time, forces, trial, angles, velocities, accelerations)
    return read(paths, coordinates, *rest, **unit_options)
