"""CSV text to a table: NumPy's reader for speed, and a slow exact reader that finds the cell at fault.

The slow reader decides what is right. The fast one is used only where it is sure to give the same, and
whatever it refuses is read again slowly, so that the message names line, column and text.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from leastaction.data.formats.atomic import read_bytes
from leastaction.data.formats.layout import Layout, Table
from leastaction.data.validation import FloatArray
from leastaction.errors import InputError
from leastaction.identifiers import quoted

__all__ = ["csv_tables", "peek_csv", "read_csv_table"]

_PIECE = 8_000_000  # characters of a long file that are read at once
_DELIMITERS = (",", ";", "\t")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_INFINITE = re.compile(r"[+-]?inf(?:inity)?", re.IGNORECASE)
_MISSING = ("", "NA", "na", "Na", "NaN", "nan", "NAN", "Nan")
_ODD_NAN = ("+nan", "-nan", "+NaN", "-NaN", "+NAN", "-NAN", "+Nan", "-Nan")


@dataclass(frozen=True)
class _Text:
    """The data lines of a file and what its header says."""

    source: str
    body: str
    first_line: int  # number of the first line of `body` in the file, from 1
    delimiter: str
    header: tuple[str, ...]


def read_csv_table(path: Path, layout: Layout) -> tuple[Layout, Table]:
    """Read the columns of `layout` from a CSV file, gzip-compressed or not.

    Returns
    -------
    Layout, Table
        The layout with the names of the file, and the columns.

    Raises
    ------
    InputError
        If the file cannot be read, is no UTF-8 table with a header, lacks a column, or a cell is no number.
    """
    text, found = _opened(_decode(_content(path), str(path)), str(path), layout)
    return found, _table_of(text, found)


def csv_tables(path: Path, layout: Layout) -> tuple[Layout, Iterator[Table]]:
    """The same in pieces of some megabytes, one after the other; only one of them is in memory.

    Raises
    ------
    InputError
        As `read_csv_table`; for what is wrong in a piece, when it is reached.
    """
    pieces = _text_pieces(path)
    text, found = _opened(next(pieces, ""), str(path), layout)

    def tables() -> Iterator[Table]:
        yield _table_of(text, found)
        line = text.first_line + text.body.count("\n")
        for body in pieces:
            if body.strip():
                yield _table_of(replace(text, body=body, first_line=line), found)
            line += body.count("\n")

    return found, tables()


def _text_pieces(path: Path) -> Iterator[str]:
    """Runs of whole lines; a line that is in quotes stays whole, too."""
    compressed = read_bytes(path, 2) == b"\x1f\x8b"
    try:
        with gzip.open(path, "rb") if compressed else path.open("rb") as file:
            stream = io.TextIOWrapper(file, encoding="utf-8-sig")
            while body := stream.read(_PIECE):
                body += stream.readline()
                while body.count('"') % 2 and (more := stream.readline()):
                    body += more
                yield body
    except UnicodeDecodeError:
        raise InputError(f"{path} is not UTF-8 text; save the table as CSV text in UTF-8") from None
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path} cannot be read to its end ({error}); copy it again") from None


def _opened(content: str, source: str, layout: Layout) -> tuple[_Text, Layout]:
    """Data lines, and the layout with the names of the header."""
    text = _split_header(content, source, layout)
    if len(text.header) == 1:
        raise InputError(
            f"{source}, line {text.first_line - 1}: there is only the column {quoted(text.header[0])}; "
            "separate columns by comma, semicolon or tab"
        )
    found = layout.find(text.header, source)
    if not text.body.strip():
        raise InputError(f"{source} has a header, but no data lines; at least 5 samples are needed")
    return text, found


def _table_of(text: _Text, layout: Layout) -> Table:
    table = _read_fast(text, layout)
    return table if table is not None else _read_slowly(text, layout)


def peek_csv(path: Path, n_rows: int = 50) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the header of a CSV file and its first rows as text: no column has a meaning yet.

    Raises
    ------
    InputError
        If the file cannot be read or is no UTF-8 table with a header.
    """
    nothing = Layout(time="", coordinates={}, forces={}, trial=None, angles=())
    text = _split_header(_decode(_content(path), str(path)), str(path), nothing)
    lines = [line for line in text.body[: 400 * n_rows * len(text.header)].split("\n") if line.strip()]
    cells = csv.reader(lines[:n_rows], delimiter=text.delimiter, skipinitialspace=True)
    try:
        rows = [tuple(cell.strip() for cell in row) for row in cells]
    except csv.Error:  # the reader proper says what is wrong, and where
        rows = []
    return text.header, [row for row in rows if len(row) == len(text.header)]


def _content(path: Path) -> bytes:
    data = read_bytes(path)
    if data[:2] != b"\x1f\x8b":
        return data
    try:
        data = gzip.decompress(data)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path} is a damaged gzip file ({error}); copy or compress it again") from None
    if not data:
        raise InputError(f"{path} is empty; a file with data is expected")
    return data


def _decode(data: bytes, source: str) -> str:
    cure = "save the table as CSV text in UTF-8"
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(f"{source} is UTF-16 text, not UTF-8; {cure}")
    nul = data.find(b"\0")
    if nul >= 0:
        line = data.count(b"\n", 0, nul) + 1
        raise InputError(f"{source}, line {line}: the file holds binary data, not text; {cure}")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, byte = data.count(b"\n", 0, error.start) + 1, data[error.start]
        raise InputError(f"{source}, line {line}: byte 0x{byte:02x} is not UTF-8 text; {cure}") from None
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _split_header(text: str, source: str, layout: Layout) -> _Text:
    """Find header and delimiter: leading lines that are blank or begin with ``#`` do not count."""
    start, number, comment = 0, 1, ""
    while True:
        end = text.find("\n", start)
        line = text[start : end if end >= 0 else len(text)]
        if line.strip() and not line.lstrip().startswith("#"):
            break
        comment = line.strip().lstrip("#") or comment
        if end < 0:
            raise InputError(f"{source} has no header line; the first line must name the columns")
        start, number = end + 1, number + 1
    delimiter, header = _sniff(line, layout)
    following = end + 1 if end >= 0 else len(text)
    if not all(map(_is_number, header)):
        return _Text(source, text[following:], number + 1, delimiter, header)
    # numpy.savetxt writes the header as a comment: then the last comment names the columns.
    delimiter, header = _sniff(comment, layout)
    if len(header) != len(_sniff(line, layout)[1]):
        raise InputError(
            f"{source}, line {number}: there are numbers where the header is expected; "
            "add a first line that names the columns"
        )
    return _Text(source, text[start:], number, delimiter, header)


def _sniff(line: str, layout: Layout) -> tuple[str, tuple[str, ...]]:
    """Return the delimiter that gives most of the needed columns, then most columns, and the columns."""
    needed = {layout.time, *layout.coordinates.values()}

    def cells(delimiter: str) -> tuple[str, ...]:
        try:
            row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), list[str]())
        except csv.Error:  # a line of megabytes
            row = []
        return tuple(cell.strip() for cell in row)

    candidates = [(delimiter, cells(delimiter)) for delimiter in _DELIMITERS]
    return max(candidates, key=lambda item: (len(needed.intersection(item[1])), len(item[1])))


def _read_fast(text: _Text, layout: Layout) -> Table | None:
    """Read with NumPy; None where a cell is not a number or the rows may be taken apart differently."""
    if '"' in text.body:
        return None
    lines = _regular_lines(text.body.encode("utf-8"), text.delimiter, len(text.header))
    if lines is None or not _plain_missing(text.body):
        return None
    columns = [text.header.index(name) for name in layout.numbers]
    try:
        values = np.loadtxt(
            io.StringIO(_fill_empty(text.body, text.delimiter)),
            delimiter=text.delimiter,
            usecols=columns,
            comments=None,
            ndmin=2,
        )
    except ValueError:
        return None
    if len(values) != lines.size:
        return None
    numbers = {name: values[:, k].copy() for k, name in enumerate(layout.numbers)}
    trials = None
    if layout.trial is not None:
        place = text.header.index(layout.trial)
        filled = (line for line in text.body.split("\n") if line)
        trials = [line.split(text.delimiter, place + 1)[place].strip() for line in filled]
    return _table(text, numbers, trials, lines)


def _plain_missing(body: str) -> bool:
    """Whether every "nan" is spelled as in `_MISSING`; NumPy also takes others, and signs before them."""
    spelled = sum(body.count(word) for word in _MISSING if len(word) == 3)
    return spelled == body.lower().count("nan") and not any(part in body for part in _ODD_NAN)


def _fill_empty(body: str, delimiter: str) -> str:
    """Put "nan" into empty cells. What a filled trial column holds does not matter."""
    for before in (delimiter, "\n"):
        for after in (delimiter, "\n"):
            if before != after:  # an empty line is not an empty cell
                body = body.replace(before + after, f"{before}nan{after}")
    # Twice: in a run of delimiters every second pair is hidden by the one before.
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


def _read_slowly(text: _Text, layout: Layout) -> Table:
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
                try:
                    column.append(_number(cell))
                except ValueError:
                    _refuse_cell(text, line, name, cell)
            if trial is not None:
                trials.append(row[trial].strip())
            lines.append(line)
    except csv.Error as error:
        line = text.first_line + reader.line_num - 1
        raise InputError(f"{text.source}, line {line}: {error}; check the quotes") from None
    numbers = {name: np.array(column) for (_, name), column in zip(columns, values, strict=True)}
    return _table(text, numbers, None if trial is None else trials, np.array(lines, dtype=np.intp))


def _number(cell: str) -> float:
    if _NUMBER.fullmatch(cell) or _INFINITE.fullmatch(cell):
        return float(cell)
    if cell in _MISSING:
        return float("nan")
    raise ValueError


def _is_number(cell: str) -> bool:
    return cell in _MISSING or _NUMBER.fullmatch(cell) is not None


def _refuse_row(text: _Text, line: int, row: Sequence[str]) -> None:
    raise InputError(
        f"{text.source}, line {text.first_line + line}: there are {len(row)} cells, but the header has "
        f"{len(text.header)}; every line must have as many cells as the header"
    )


def _refuse_cell(text: _Text, line: int, column: str, cell: str) -> None:
    cure = "leave the cell empty if the sample is missing"
    if re.fullmatch(r"[+-]?\d+,\d*(?:[eE][+-]?\d+)?", cell):
        cure = "write a decimal point instead of the comma"
    raise InputError(
        f"{text.source}, line {text.first_line + line}, column {quoted(column)}: "
        f"{quoted(cell)} is not a number; {cure}"
    )


def _table(
    text: _Text, numbers: dict[str, FloatArray], trials: Sequence[str] | None, lines: np.ndarray
) -> Table:
    return Table(text.source, numbers, trials, lambda row: f"line {text.first_line + int(lines[row])}")
