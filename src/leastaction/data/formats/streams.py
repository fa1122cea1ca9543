"""Files larger than memory, read trial by trial into a temporary file.

Text is slow to read, and a fit passes over a motion some dozens of times. Every trial is therefore read once,
checked as by the other readers, and stored as plain numbers in a temporary file that is mapped into memory.
The operating system loads the parts in use and releases them if memory is short.
"""

from __future__ import annotations

import mmap
import tempfile
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import IO, NamedTuple, Unpack

import numpy as np

from leastaction.data.formats.atomic import StrPath
from leastaction.data.formats.csv import csv_tables
from leastaction.data.formats.dispatch import listed_paths, stem, to_trajectories, trial_name
from leastaction.data.formats.frames import parquet_tables
from leastaction.data.formats.layout import Coordinates, Forces, Layout, Table, UnitOptions
from leastaction.data.trajectories import Trajectories
from leastaction.data.trajectory import FIELDS, Stated, Trajectory
from leastaction.data.validation import FloatArray
from leastaction.errors import InputError
from leastaction.findings import Finding
from leastaction.identifiers import quoted

__all__ = ["stream"]


def stream(
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
    r"""Read recordings larger than memory from CSV or Parquet.

    The files are read trial by trial and checked as by `read`. The samples are stored in a temporary file, 8
    bytes per number, in the folder of the environment variable ``TMPDIR``. It is deleted with the
    trajectories. `leastaction.discover` searches the structure on pieces and passes over all samples in each
    step of a fit.

    Parameters
    ----------
    path : path, or iterable of paths
        CSV text (each suffix also with ``.gz``), or ``.parquet``, which is read by row groups. One trial at a
        time must fit into memory: a long file needs a column of trials.
    coordinates, time, forces, trial, angles, velocities, accelerations, time_unit, units
        As for `read_csv`.

    Returns
    -------
    Trajectories
        The same as of `read`.

    Raises
    ------
    InputError, DataError
        As for `read`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from leastaction.io import write_text
    >>> with TemporaryDirectory() as folder:
    ...     rows = [f"\n{run},{k},{k / 8}" for run in "ab" for k in range(6)]
    ...     path = write_text(f"{folder}/runs.csv", "trial,t,x" + "".join(rows))
    ...     runs = stream(path, ["x"])
    >>> runs
    <Trajectories of x: 2 trajectories, 12 samples, 10 s>
    """
    layout = Layout.of(coordinates, time, forces, trial, angles, velocities, accelerations)
    layout = layout.measured_in(**unit_options)
    return _streamed(path, layout)


def _streamed(path: StrPath | Iterable[StrPath], layout: Layout) -> Trajectories:
    """Read files trial by trial and store the samples in a temporary file.

    Raises
    ------
    InputError, DataError
        As for the readers of whole files; also if the suffix cannot be read in pieces.
    """
    paths = listed_paths(path)
    taken: set[str] = set()
    with tempfile.TemporaryFile(prefix="leastaction-") as file:
        store = _Store(file)
        for source in paths:
            found, pieces = _pieces(source, layout)
            for table in _trials(pieces, found.trial):
                part = to_trajectories(found, table, name=stem(source))
                several = len(paths) > 1
                store.add(part, trial_name(source, table, part[0], taken) if several else part[0].name)
        return store.trajectories()


def _pieces(path: Path, layout: Layout) -> tuple[Layout, Iterator[Table]]:
    """The layout with the names of a file, and its rows in pieces."""
    name = path.name.lower()
    suffix = Path(name.removesuffix(".gz")).suffix
    if suffix in (".csv", ".tsv", ".txt", ".dat"):
        return csv_tables(path, layout)
    if name.endswith((".parquet", ".pq")):
        return parquet_tables(path, layout)
    raise InputError(
        f"{path}: the suffix {quoted(path.suffix)} cannot be read in pieces; use CSV text (.csv, .tsv, .txt "
        "or .dat, also with .gz) or .parquet, or read the file as a whole"
    )


def _trials(pieces: Iterable[Table], column: str | None) -> Iterator[Table]:
    """One table for each trial; its rows may be in several pieces."""
    waiting: list[Table] = []
    began: dict[str, str] = {}
    for piece in pieces:
        for part in _runs(piece):
            if waiting and _label(part) != _label(waiting[0]):
                yield _joined(waiting)
                waiting = []
            if not waiting:
                label, place = _label(part), part.place(0)
                if label in began:
                    raise InputError(
                        f"{part.source}, {place}, column {quoted(column)}: trial {quoted(label)} "
                        f"continues after another trial (it started at {began[label]}); "
                        "keep the rows of a trial together"
                    )
                began[label] = place
            waiting.append(part)
    if waiting:
        yield _joined(waiting)


def _label(table: Table) -> str:
    return "" if table.trials is None else table.trials[0]


def _runs(table: Table) -> Iterator[Table]:
    """Parts of a table that belong to one trial each."""
    size = len(next(iter(table.numbers.values())))
    cuts = [0, size]
    if table.trials is not None:
        labels = np.asarray(table.trials, dtype=object)
        cuts = [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist(), size]
    for a, b in pairwise(cuts):
        if a < b:
            yield _rows(table, a, b)


def _rows(table: Table, start: int, stop: int) -> Table:
    def place(row: int) -> str:
        return table.place(start + row)

    numbers = {name: values[start:stop] for name, values in table.numbers.items()}
    trials = None if table.trials is None else table.trials[start:stop]
    return Table(table.source, numbers, trials, place)


def _joined(tables: list[Table]) -> Table:
    """The rows of successive tables of one trial."""
    if len(tables) == 1:
        return tables[0]
    first = tables[0]
    starts = np.cumsum([0] + [len(next(iter(table.numbers.values()))) for table in tables]).tolist()

    def place(row: int) -> str:
        k = bisect_right(starts, row) - 1
        return tables[k].place(row - starts[k])

    numbers = {name: np.concatenate([table.numbers[name] for table in tables]) for name in first.numbers}
    trials = None if first.trials is None else [_label(first)] * starts[-1]
    return Table(first.source, numbers, trials, place)


class _Store:
    """Trajectories whose arrays are stored in a file."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._kept: list[_Kept] = []
        self._end = 0

    def add(self, part: Trajectories, name: str) -> None:
        """Store the arrays of a single trajectory."""
        places: dict[str, tuple[int, tuple[int, ...]]] = {}
        for field in FIELDS:
            array: FloatArray | None = getattr(part[0], field)
            if array is not None:
                self._file.write(array.tobytes())
                places[field] = (self._end, array.shape)
                self._end += array.size
        wraps = tuple(part.wraps_removed.values())
        units = part[0].stated_units
        self._kept.append(_Kept(name, part.coordinates, wraps, places, part.findings, units))

    def trajectories(self) -> Trajectories:
        """All trajectories, with memory-mapped arrays."""
        self._file.flush()
        # the arrays keep the map alive, and the map keeps the file, which is closed and unlinked
        numbers = np.frombuffer(mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ), dtype=np.float64)
        items: list[Trajectory] = []
        for kept in self._kept:
            arrays: dict[str, FloatArray] = {
                field: numbers[start : start + int(np.prod(shape))].reshape(shape)
                for field, (start, shape) in kept.places.items()
            }
            item = Trajectory.of(arrays, kept.coordinates, kept.name, kept.findings)
            items.append(item.stating(kept.stated_units))
        return Trajectories.with_wraps(items, [kept.wraps for kept in self._kept])


class _Kept(NamedTuple):
    """A trajectory stored in the file: offsets and shapes of its arrays."""

    name: str
    coordinates: tuple[str, ...]
    wraps: tuple[int, ...]
    places: dict[str, tuple[int, tuple[int, ...]]]
    findings: tuple[Finding, ...]
    stated_units: Stated
