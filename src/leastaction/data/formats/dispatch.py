"""From paths to trajectories: the reader for a suffix, and several files as one set."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from leastaction.data.formats.arrays import read_mat_table, read_npz_table
from leastaction.data.formats.atomic import check_path
from leastaction.data.formats.bags import is_bag, read_bag_table
from leastaction.data.formats.csv import read_csv_table
from leastaction.data.formats.frames import read_parquet_table
from leastaction.data.formats.layout import Layout, Table, to_trajectories
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.identifiers import quoted

__all__ = ["StrPath", "combined_trajectories", "listed_paths", "reader_for", "stem", "trial_name"]

StrPath = str | os.PathLike[str]
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
}


def reader_for(path: Path) -> TableReader:
    """Return the reader for the suffix of `path`, or raise InputError."""
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


def stem(path: Path) -> str:
    """Return the name of a file without its suffix: ``"run"`` for ``run.csv.gz``."""
    name = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return Path(name).stem


def combined_trajectories(
    path: StrPath | Iterable[StrPath], layout: Layout, reader: TableReader | None = None
) -> Trajectories:
    """Read one file, or several as trials of one system, with names that differ.

    Parameters
    ----------
    reader : callable, optional
        Of all files; by default the one for the suffix of each.

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
    # Unwrapped together at the end: the set then counts the wraps of all files.
    wrapped = replace(layout, angles=())
    for file in paths:
        found, table = (reader or reader_for(file))(file, wrapped)
        for item in to_trajectories(found, table):
            items.append(item.changed(name=trial_name(file, table, item, taken)))
    together = Trajectories(items)
    return together.unwrap(layout.angles) if layout.angles else together


def trial_name(file: Path, table: Table, item: Trajectory, taken: set[str]) -> str:
    """Name a trial of one file of several, and add the name to those taken.

    Where the name of the file is taken, a number follows it.
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
