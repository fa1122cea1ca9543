"""Reading and writing of CSV text: NumPy's reader for speed, and an exact reader that locates errors.

The exact reader is the reference. The fast one is used only if it gives the same result. Text that it refuses
is read again by the exact reader, so that the message names line, column and text.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from leastaction.data.formats.atomic import StrPath, check_path, write_bytes
from leastaction.data.formats.layout import Layout, Table
from leastaction.data.formats.text import MISSING, NUMBER, Text, opened, text_of, text_pieces
from leastaction.data.formats.units import Clock
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.data.validation import FloatArray
from leastaction.errors import InputError
from leastaction.identifiers import quoted

__all__ = ["csv_bytes", "csv_tables", "read_csv_table", "write_csv"]

_INFINITE = re.compile(r"[+-]?inf(?:inity)?", re.IGNORECASE)
_ODD_NAN = ("+nan", "-nan", "+NaN", "-NaN", "+NAN", "-NAN", "+Nan", "-Nan")


def read_csv_table(path: Path, layout: Layout) -> tuple[Layout, Table]:
    """Read the columns of `layout` from a CSV file, gzip-compressed or not.

    Returns
    -------
    Layout, Table
        The layout with the names of the file, and the columns.

    Raises
    ------
    InputError
        If the file cannot be read, is not a table with a header, lacks a column, or a cell is not a number.
    """
    text, found = opened(*text_of(path), str(path), layout)
    return found, _table_of(text, found)


def csv_tables(path: Path, layout: Layout) -> tuple[Layout, Iterator[Table]]:
    """The same in pieces of some megabytes; only one of them is in memory.

    Raises
    ------
    InputError
        As `read_csv_table`; errors in a piece are raised when it is reached.
    """
    encoding, pieces = text_pieces(path)
    text, found = opened(next(pieces, ""), encoding, str(path), layout)

    def tables() -> Iterator[Table]:
        yield _table_of(text, found)
        line = text.first_line + text.body.count("\n")
        for body in pieces:
            if body.strip():
                yield _table_of(text.further(body, line), found)
            line += body.count("\n")

    return found, tables()


def _table_of(text: Text, layout: Layout) -> Table:
    table = _read_fast(text, layout)
    return table if table is not None else _read_slowly(text, layout)


def _read_fast(text: Text, layout: Layout) -> Table | None:
    """Read with NumPy; None if a cell is not a number or the exact reader may split rows differently."""
    if '"' in text.body:
        return None
    lines = _regular_lines(text.body.encode("utf-8"), text.delimiter, len(text.header))
    if lines is None or not _plain_missing(text.body):
        return None
    body = text.body
    if text.decimal == ",":
        if "." in body:  # numbers may be in another notation
            return None
        body = body.replace(",", ".")
    names = [name for name in layout.numbers if layout.clock is None or name != layout.time]
    try:
        values = np.loadtxt(
            io.StringIO(_fill_empty(body, text.delimiter)),
            delimiter=text.delimiter,
            usecols=[text.header.index(name) for name in names],
            comments=None,
            ndmin=2,
        )
        if len(values) != lines.size:
            return None
        numbers = {name: values[:, k].copy() for k, name in enumerate(names)}
        if layout.clock is not None:
            times = [layout.clock.seconds(cell) for cell in _column(text, layout.time)]
            numbers[layout.time] = np.array(times)
    except ValueError:
        return None
    return _table(text, numbers, None if layout.trial is None else _column(text, layout.trial), lines)


def _column(text: Text, name: str) -> list[str]:
    """Cells of a column, where no cell is in quotes."""
    place = text.header.index(name)
    filled = (line for line in text.body.split("\n") if line)
    return [line.split(text.delimiter, place + 1)[place].strip() for line in filled]


def _plain_missing(body: str) -> bool:
    """Whether every "nan" is spelled as in `MISSING`; NumPy also takes others, and signs before them."""
    spelled = sum(body.count(word) for word in MISSING if len(word) == 3)
    return spelled == body.lower().count("nan") and not any(part in body for part in _ODD_NAN)


def _fill_empty(body: str, delimiter: str) -> str:
    """Put "nan" into empty cells. The content of a filled trial column is not used."""
    for before in (delimiter, "\n"):
        for after in (delimiter, "\n"):
            if before != after:  # an empty line is not an empty cell
                body = body.replace(before + after, f"{before}nan{after}")
    # Twice, because pairs in a run of delimiters overlap.
    body = body.replace(delimiter * 2, f"{delimiter}nan{delimiter}")
    body = body.replace(delimiter * 2, f"{delimiter}nan{delimiter}")
    start = "nan" if body.startswith(delimiter) else ""
    return start + body + ("nan" if body.endswith(delimiter) else "")


def _regular_lines(data: bytes, delimiter: str, n_columns: int) -> np.ndarray | None:
    """Return the numbers of the lines that are not blank, from 0; None if one has not `n_columns` cells."""
    characters = np.frombuffer(data, dtype=np.uint8)
    ends = np.flatnonzero(characters == ord("\n"))
    if data[-1:] != b"\n":
        ends = np.append(ends, characters.size)
    delimiters = np.flatnonzero(characters == ord(delimiter))
    counts = np.diff(np.searchsorted(delimiters, ends), prepend=0)
    lengths = np.diff(ends, prepend=-1) - 1
    filled = lengths > 0
    return np.flatnonzero(filled) if (counts[filled] == n_columns - 1).all() else None


def _read_slowly(text: Text, layout: Layout) -> Table:
    """Read row by row, and raise InputError at the first cell at fault."""
    columns = [(text.header.index(name), name) for name in layout.numbers]
    trial = None if layout.trial is None else text.header.index(layout.trial)
    values: list[list[float]] = [[] for _ in columns]
    trials: list[str] = []
    lines: list[int] = []
    stream = io.StringIO(text.body, newline="")
    reader = csv.reader(stream, delimiter=text.delimiter, skipinitialspace=True, strict=True)
    try:
        for row in reader:
            if not row or (len(row) == 1 and not row[0].strip()):
                continue
            line = reader.line_num - 1
            if len(row) != len(text.header):
                _refuse_row(text, line, row)
            for (index, name), column in zip(columns, values, strict=True):
                cell = row[index].strip()
                clock = layout.clock if name == layout.time else None
                try:
                    column.append(_number(cell, text.decimal, clock))
                except ValueError:
                    _refuse_cell(text, line, name, cell, layout)
            if trial is not None:
                trials.append(row[trial].strip())
            lines.append(line)
    except csv.Error as error:
        line = text.first_line + reader.line_num - 1
        raise InputError(f"{text.source}, line {line}: {error}; check the quotes") from None
    numbers = {name: np.array(column) for (_, name), column in zip(columns, values, strict=True)}
    return _table(text, numbers, None if trial is None else trials, np.array(lines, dtype=np.intp))


def _number(cell: str, decimal: str, clock: Clock | None) -> float:
    if cell in MISSING:
        return float("nan")
    if clock is not None:
        return clock.seconds(cell)
    if decimal == "," and "." not in cell:
        cell = cell.replace(",", ".")
    elif decimal == ",":
        raise ValueError
    if NUMBER.fullmatch(cell) or _INFINITE.fullmatch(cell):
        return float(cell)
    raise ValueError


def _refuse_row(text: Text, line: int, row: Sequence[str]) -> None:
    cure = "every line must have as many cells as the header"
    if text.delimiter == "," and len(row) == 2 * len(text.header):
        cure += "; if commas are decimal signs, too, separate the cells by semicolons"
    raise InputError(
        f"{text.source}, line {text.first_line + line}: there are {len(row)} cells, but the header has "
        f"{len(text.header)}; {cure}"
    )


def _refuse_cell(text: Text, line: int, column: str, cell: str, layout: Layout) -> None:
    what, cure = "a number", "leave the cell empty if the sample is missing"
    if column == layout.time and layout.clock is not None:
        zone = "with" if layout.clock.zoned else "without"
        what = "a date"
        cure = f"the first time is a date {zone} a time zone: write all times so, as 2024-05-01T12:00:00.25"
    elif column == layout.time and re.search(r"\d[T:/]\d|\d[.-]\d+[.-]\d", cell):
        cure = "write times as numbers, or all as dates in the form 2024-05-01T12:00:00.25"
    elif re.fullmatch(r"[+-]?\d{1,3}(?:(?:[.\s']\d{3})+,\d*|(?:[,\s']\d{3})+\.\d*|(?:[\s']\d{3})+)", cell):
        cure = "remove thousands separators"
    elif text.decimal == "," and re.fullmatch(r"[+-]?\d*\.\d*(?:[eE][+-]?\d+)?", cell):
        cure = "the first fraction has a decimal comma: write all numbers in one way"
    elif re.fullmatch(r"[+-]?\d{1,3}(?:,\d{3})+", cell):
        cure = "remove the comma if it separates thousands, or write a decimal point instead"
    elif re.fullmatch(r"[+-]?\d+,\d*(?:[eE][+-]?\d+)?", cell):
        cure = "write a decimal point instead of the comma"
    raise InputError(
        f"{text.source}, line {text.first_line + line}, column {quoted(column)}: "
        f"{quoted(cell)} is not {what}; {cure}"
    )


def _table(
    text: Text, numbers: dict[str, FloatArray], trials: Sequence[str] | None, lines: np.ndarray
) -> Table:
    return Table(text.source, numbers, trials, lambda row: f"line {text.first_line + int(lines[row])}")


def csv_bytes(trajectories: Trajectories) -> bytes:
    """Return the table ``trial,t,<coordinates>[,<coordinate>_force ...][,<coordinate>_dot ...]`` as UTF-8.

    Floats are written with as few digits as give the same float again; NaN is an empty cell.

    Raises
    ------
    InputError
        If two columns would have the same name, or a trial's name would not read back.
    """
    names = trajectories.coordinates
    forces = tuple(f"{name}_force" for name in names) if trajectories.driven else ()
    rates = trajectories.rates
    rated = tuple(f"{names[rate.coordinate]}_{'d' * rate.derivative}ot" for rate in rates)
    header = ("trial", "t", *names, *forces, *rated)
    for column in header:
        if header.count(column) > 1:
            raise InputError(
                f"two columns of the CSV file would be called {quoted(column)}; rename the coordinate"
            )
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    for k, (trial, item) in enumerate(zip(trajectories.names, trajectories, strict=True)):
        if trial != trial.strip() or "\r" in trial or "\0" in trial:
            raise InputError(
                f"the trial name {quoted(trial)} cannot stand in a CSV file; remove spaces around it"
            )
        columns = [item.t[:, np.newaxis], item.q]
        if forces:
            columns.append(np.zeros_like(item.q) if item.forces is None else item.forces)
        columns += [rate.values[k][:, np.newaxis] for rate in rates]
        # The csv module writes a float as its repr, the shortest text that gives the same float.
        rows = np.hstack(columns).tolist()
        writer.writerows([trial, *("" if value != value else value for value in row)] for row in rows)
    return stream.getvalue().encode("utf-8")


def write_csv(path: StrPath, trajectories: Trajectory | Iterable[Trajectory]) -> Path:
    """Write trajectories to a CSV file that `read_csv` reads back exactly.

    The columns are ``trial``, ``t``, the coordinates, ``<coordinate>_force`` if any force is not zero, and
    ``<coordinate>_dot``, ``<coordinate>_ddot`` where they were measured. A file with the suffix
    ``.gz`` is compressed.

    Parameters
    ----------
    path : path
        Replaced in one step if it exists. Missing directories are created.
    trajectories : Trajectory, Trajectories or sequence of Trajectory
        Data to write. Trajectories without a name get their number.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If the file cannot be written, or two columns would have the same name.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> trajectory = Trajectory([0.0, 0.5], [1.0, float("nan")], coordinates=["theta"], name="first")
    >>> with TemporaryDirectory() as folder:
    ...     path = write_csv(f"{folder}/run.csv", trajectory)
    ...     print(path.read_text())
    trial,t,theta
    first,0.0,1.0
    first,0.5,
    """
    target, data = check_path(path), csv_bytes(Trajectories.coerce(trajectories))
    zipped = target.suffix.lower() == ".gz"
    return write_bytes(target, gzip.compress(data, mtime=0) if zipped else data)
