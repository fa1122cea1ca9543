"""Reading of paths: the reader for a suffix, checks of columns, and several files as one set."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from leastaction.data.formats.arrays import read_mat_table, read_npz_table
from leastaction.data.formats.atomic import StrPath, check_path
from leastaction.data.formats.csv import read_csv_table
from leastaction.data.formats.frames import peek_excel, read_excel_table, read_parquet_table
from leastaction.data.formats.layout import BESIDE, MIN_SAMPLES, Layout, Table
from leastaction.data.formats.text import Peek, peek_csv, refuse_one_column, without_data
from leastaction.data.formats.units import parted
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.data.validation import FloatArray, time_fault
from leastaction.errors import DataError, InputError
from leastaction.findings import Finding, find
from leastaction.identifiers import counted, quoted

__all__ = [
    "combined_trajectories",
    "group_names",
    "listed_paths",
    "peek",
    "reader_for",
    "stem",
    "to_trajectories",
    "trial_name",
]

LONG_STEP = 1.0
"""Seconds between samples above which times without a unit may be in milliseconds. Logs of mechanical systems
are sampled faster; in milliseconds, a rate below 1 kHz exceeds this value."""

TableReader = Callable[[Path, Layout], tuple[Layout, Table]]

_READERS: dict[str, TableReader] = {
    ".csv": read_csv_table,
    ".tsv": read_csv_table,
    ".txt": read_csv_table,
    ".dat": read_csv_table,
    ".parquet": read_parquet_table,
    ".pq": read_parquet_table,
    ".npz": read_npz_table,
    ".mat": read_mat_table,
    ".xlsx": read_excel_table,
    ".xlsm": read_excel_table,
}


def reader_for(path: Path) -> TableReader:
    """Return the reader for the suffix of `path`, or raise InputError."""
    from leastaction.data.formats.bags import is_bag, read_bag_table  # circular import

    if is_bag(path):
        return read_bag_table
    name = path.name.lower()
    suffix = Path(name.removesuffix(".gz")).suffix
    reader = _READERS.get(suffix)
    if reader is None or (name.endswith(".gz") and reader is not read_csv_table):
        if path.is_dir():
            raise InputError(f"{path} is a directory; give the path of a file in it")
        raise InputError(
            f"{path}: the suffix {quoted(path.suffix)} is not known; use a file with one of "
            f"{', '.join(_READERS)} (text also with .gz), .mcap, .db3, or the reader for its kind"
        )
    return reader


def peek(path: Path) -> Peek:
    """Return the header and the first rows of a table of text or Excel, as text.

    Raises
    ------
    InputError
        If it is of another kind, or cannot be read.
    """
    reader = reader_for(path)
    if reader not in (read_csv_table, read_excel_table):
        raise InputError(f"{path} is neither a text table nor an Excel file; save it as CSV")
    table = peek_csv(path) if reader is read_csv_table else peek_excel(path)
    refuse_one_column(table.header, str(path))
    if not table.rows:
        raise without_data(path)
    return table


def stem(path: Path) -> str:
    """Return the name of a file without its suffix: ``"run"`` for ``run.csv.gz``."""
    name = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return Path(name).stem


def combined_trajectories(
    path: StrPath | Iterable[StrPath], layout: Layout, reader: TableReader | None = None
) -> Trajectories:
    """Read one file, or several as trials of one system, with different names.

    Parameters
    ----------
    reader : callable, optional
        Reader of all files; by default the one for the suffix of each.

    Raises
    ------
    InputError
        If there is no path, or two paths are the same file.
    """
    paths = listed_paths(path)
    if len(paths) == 1:
        read = reader or reader_for(paths[0])
        return to_trajectories(*read(paths[0], layout), name=stem(paths[0]))
    items: list[Trajectory] = []
    taken: set[str] = set()
    # Unwrapped together at the end, so that the set counts the wraps of all files.
    wrapped = replace(layout, angles=())
    for file in paths:
        found, table = (reader or reader_for(file))(file, wrapped)
        for item in to_trajectories(found, table):
            items.append(item.changed(name=trial_name(file, table, item, taken)))
    together = Trajectories(items)
    return together.unwrap(layout.angles) if layout.angles else together


def group_names(path: StrPath | Iterable[StrPath], layout: Layout, column: str) -> tuple[str, ...]:
    """The text of a further column for each trial, in the sequence of `combined_trajectories`.

    Raises
    ------
    InputError
        If there is no such column, or it changes within a trial or is empty there.
    """
    out: list[str] = []
    for file in listed_paths(path):
        read = reader_for(file)
        found, table = read(file, layout)
        named, again = read(file, replace(layout, trial=column))
        for label, rows in _trial_rows(found, table, stem(file)):
            texts = [*dict.fromkeys((again.trials or [])[rows])]
            place = f"{file}, column {quoted(named.trial)}, trial {quoted(label)}"
            if len(texts) > 1:
                raise InputError(
                    f"{place}: the group changes from {quoted(texts[0])} to {quoted(texts[1])}; each trial "
                    "belongs to one group"
                )
            if not texts or not texts[0]:
                raise InputError(f"{place}: the name of the group is missing; fill it in on every row")
            out.append(texts[0])
    return tuple(out)


def trial_name(file: Path, table: Table, item: Trajectory, taken: set[str]) -> str:
    """Name a trial of one of several files, and add the name to ``taken``.

    If the name of the file is taken, a number is appended.
    """
    name = stem(file) + (f"/{item.name}" if table.trials is not None else "")
    number, free = 2, name
    while free in taken:
        free, number = f"{name}-{number}", number + 1
    taken.add(free)
    return free


def listed_paths(path: StrPath | Iterable[StrPath]) -> list[Path]:
    """Return one path or several as a list.

    Raises
    ------
    InputError
        If there is no path, or two paths are the same file.
    """
    paths = [check_path(item) for item in _listed(path)]
    if not paths:
        raise InputError("there is no file to read; give at least one path")
    seen: set[str] = set()
    for file in paths:
        if os.path.realpath(file) in seen:
            raise InputError(f"{file} is given twice; give each file once")
        seen.add(os.path.realpath(file))
    return paths


def _listed(path: StrPath | Iterable[StrPath]) -> list[StrPath]:
    if isinstance(path, (str, bytes, os.PathLike)):
        return [path]  # type: ignore[list-item]
    try:
        return list(path)
    except TypeError:
        return [path]  # type: ignore[list-item]  # for check_path to refuse


def to_trajectories(layout: Layout, table: Table, name: str = "") -> Trajectories:
    """Check the values of a table and split it into trajectories.

    Parameters
    ----------
    layout : Layout
        With the names of `table`; see `Layout.find`.
    table : Table
    name : str
        Name of the trajectory of a table without trials.

    Returns
    -------
    Trajectories
        In the order of the table; the angles of `layout` are unwrapped.

    Raises
    ------
    InputError
        If a value is infinite, a time or a force is missing, the rows of a trial are not together, or times
        do not increase.
    DataError
        If a coordinate has fewer than `MIN_SAMPLES` samples in a trial.
    """
    _check_values(layout, table)
    numbers = table.numbers | {
        column: unit.convert(table.numbers[column]) for column, unit in layout.conversions.items()
    }
    _check_values(layout, replace(table, numbers=numbers))  # overflow gives infinity
    trajectories: list[Trajectory] = []
    for label, rows in _trial_rows(layout, table, name):
        _check_times(layout, table, label, rows)
        q = np.column_stack([numbers[column][rows] for column in layout.coordinates.values()])
        _check_enough(layout, table, label, q)
        q = np.column_stack([q, np.full((len(q), len(layout.unmeasured)), np.nan)])
        beside = {kind: _matrix(layout, numbers, kind, rows, q.shape) for kind in BESIDE}
        t = numbers[layout.time][rows]
        said = layout.findings + _perhaps_not_seconds(layout, t)
        names = (*layout.coordinates, *layout.unmeasured)
        run = Trajectory(t, q, coordinates=names, name=label, findings=said, **beside)
        trajectories.append(run.stating(layout.stated_units))
    result = Trajectories(trajectories)
    return result.unwrap(layout.angles) if layout.angles else result


def _matrix(
    layout: Layout, numbers: Mapping[str, FloatArray], kind: str, rows: slice, shape: tuple[int, ...]
) -> FloatArray | None:
    """Forces, velocities or accelerations of some rows; None without any column."""
    columns = getattr(layout, kind)
    if not columns:
        return None
    out = np.full(shape, 0.0 if kind == "forces" else np.nan)
    for index, coordinate in enumerate((*layout.coordinates, *layout.unmeasured)):
        if coordinate in columns:
            out[:, index] = numbers[columns[coordinate]][rows]
    return out


def _check_values(layout: Layout, table: Table) -> None:
    for column in layout.numbers:
        values, role = table.numbers[column], layout.role(column)
        bad = ~np.isfinite(values) if role != "sample" else np.isinf(values)
        if not bad.any():
            continue
        row = int(np.flatnonzero(bad)[0])
        place = f"{table.source}, {table.place(row)}, column {quoted(column)}"
        if np.isinf(values[row]):
            cure = "; leave the cell empty if the sample is missing" if role == "sample" else ""
            raise InputError(f"{place}: the value is infinite, but a finite number is expected{cure}")
        cure = "; remove the row" if role == "time" else "; put 0 where nothing acts"
        raise InputError(f"{place}: the {role} is missing{cure}")


def _trial_rows(layout: Layout, table: Table, name: str) -> list[tuple[str, slice]]:
    n_rows = table.numbers[layout.time].size
    if n_rows == 0:
        raise InputError(f"{table.source} has no data; at least {MIN_SAMPLES} samples are needed")
    if table.trials is None:
        return [(name, slice(0, n_rows))]
    trials = np.asarray(table.trials, dtype=object)
    starts = [0, *(np.flatnonzero(trials[1:] != trials[:-1]) + 1).tolist()]
    first: dict[str, int] = {}
    for start in starts:
        place = f"{table.source}, {table.place(start)}, column {quoted(layout.trial)}"
        label = trials[start]
        if not label:
            raise InputError(f"{place}: the name of the trial is missing; fill it in on every row")
        if label in first:
            raise InputError(
                f"{place}: trial {quoted(label)} continues after another trial (it started at "
                f"{table.place(first[label])}); keep the rows of a trial together"
            )
        first[label] = start
    return [(trials[a], slice(a, b)) for a, b in zip(starts, [*starts[1:], n_rows], strict=True)]


def _check_times(layout: Layout, table: Table, label: str, rows: slice) -> None:
    t = table.numbers[layout.time][rows]
    fault = time_fault(t)
    if fault is None:
        return
    index, kind = fault
    trial = f" in trial {quoted(label)}" if table.trials is not None else ""
    if kind == "repeated":
        what = f"time {float(t[index])!r} repeats the previous one{trial}"
        cure = "keep one row for each time"
        if layout.clock is not None:
            cure += ", and write fractions of a second if the samples are closer than that"
    else:
        what = f"time {float(t[index])!r} goes backwards, from {float(t[index - 1])!r}{trial}"
        cure = "sort the rows by time"
    if table.trials is None:
        cure += ", or give the column that names the trials (trial=...)"
    place = f"{table.source}, {table.place(rows.start + index)}, column {quoted(layout.time)}"
    raise InputError(f"{place}: {what}; {cure}")


def _perhaps_not_seconds(layout: Layout, t: FloatArray) -> tuple[Finding, ...]:
    """A note if the times have no unit, and samples are a second or more apart."""
    step = float(np.median(np.diff(t))) if t.size >= 20 else 0.0  # as many as a discovery needs
    told = layout.time in (*layout.asked, *layout.conversions) or layout.clock or layout.as_written
    if told or step < LONG_STEP or parted(layout.time, time=True)[1]:
        return ()
    return (find("long-time-step", column=layout.time, step=step),)


def _check_enough(layout: Layout, table: Table, label: str, q: FloatArray) -> None:
    trial = f", trial {quoted(label)}" if table.trials is not None else ""
    need = f"at least {MIN_SAMPLES} are needed; leave the trial out or record a longer one"
    if len(q) < MIN_SAMPLES:
        raise DataError(f"{table.source}{trial}: there are only {counted(len(q), 'sample')}; {need}")
    for name, count in zip(layout.coordinates, np.isfinite(q).sum(axis=0).tolist(), strict=True):
        if count < MIN_SAMPLES:
            measured = counted(count, "measured sample")
            raise DataError(f"{table.source}{trial}: {name} has only {measured}; {need}")
