"""A text file: its encoding, header, row of units, and number format."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import zlib
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import NamedTuple

from leastaction.data.formats.atomic import read_bytes
from leastaction.data.formats.layout import MIN_SAMPLES, Layout
from leastaction.data.formats.units import Clock, is_units_row, parted
from leastaction.errors import InputError
from leastaction.findings import find
from leastaction.identifiers import quoted

__all__ = [
    "MISSING",
    "NUMBER",
    "Peek",
    "Text",
    "opened",
    "peek_csv",
    "refuse_one_column",
    "text_of",
    "text_pieces",
    "without_data",
]

_PIECE = 8_000_000  # characters of a long file that are read at once
_DELIMITERS = (",", ";", "\t")
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_FRACTION = re.compile(r"[+-]?\d*([.,])\d*(?:[eE][+-]?\d+)?", re.ASCII)
MISSING = ("", "NA", "na", "Na", "NaN", "nan", "NAN", "Nan")
_CURE = "save the table as CSV text in UTF-8"
_SPREADSHEET = f"it begins like a workbook of a spreadsheet: name it .xlsx if it is one, or {_CURE}"
_MAGIC = {
    b"PK\x03\x04": _SPREADSHEET,
    b"\xd0\xcf\x11\xe0": f"it begins like an old workbook (.xls): save it as .xlsx, or {_CURE}",
    b"%PDF": f"it is a PDF: {_CURE}",
}
_OTHER_TEXT = {
    "a web page": re.compile(r"\s*<(?:!doctype html|html|head)\b", re.IGNORECASE),
    "XML": re.compile(r"\s*<\?xml\b", re.IGNORECASE),
    "JSON": re.compile(r"\s*(?:\{\s*[\"}]|\[\s*[\[{])"),
}
_PREAMBLE = 50  # lines above the header that are looked through
_ENCODINGS = {"utf-16": "UTF-16", "cp1252": "Windows-1252"}


@dataclass(frozen=True)
class Text:
    """The data lines of a file, its header and its number format.

    Attributes
    ----------
    source : str
    body : str
    first_line : int
        Number of the first line of `body` in the file, from 1.
    delimiter : str
    header : tuple of str
    units : tuple of str
        Cells of the row below the header, if it holds units.
    decimal : str
        Decimal sign: "." or ",".
    spaced : bool
        Whether runs of spaces separate the cells in the file; `body` has tabs instead.
    """

    source: str
    body: str
    first_line: int
    delimiter: str
    header: tuple[str, ...]
    units: tuple[str, ...] = ()
    decimal: str = "."
    spaced: bool = False

    def further(self, body: str, first_line: int) -> Text:
        """The same layout with other lines of the file."""
        return replace(self, body=_tabbed(body) if self.spaced else body, first_line=first_line)


def text_of(path: Path) -> tuple[str, str]:
    """Return the content of a file, compressed or not, and its encoding, a name that Python knows.

    Raises
    ------
    InputError
        If it cannot be read, or is not text.
    """
    data = _content(path)
    encoding = _encoding(data, whole=True)
    nul = data.find(b"\0")
    if nul >= 0 and encoding != "utf-16":
        line = data.count(b"\n", 0, nul) + 1
        cure = next((text for magic, text in _MAGIC.items() if data.startswith(magic)), _CURE)
        raise InputError(f"{path}, line {line}: the file holds binary data, not text; {cure}")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        line, byte = data.count(b"\n", 0, error.start) + 1, data[error.start]
        raise InputError(
            f"{path}, line {line}: byte 0x{byte:02x} is neither UTF-8 text nor Windows-1252; {_CURE}"
        ) from None
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text, encoding


def text_pieces(path: Path) -> tuple[str, Iterator[str]]:
    """The encoding, and runs of whole lines; a quoted cell with line breaks stays whole."""
    compressed = read_bytes(path, 2) == b"\x1f\x8b"
    with _readable(path), gzip.open(path, "rb") if compressed else path.open("rb") as file:
        start = file.read(_PIECE)
        encoding = _encoding(start, whole=len(start) < _PIECE)

    def pieces() -> Iterator[str]:
        with _readable(path), gzip.open(path, "rb") if compressed else path.open("rb") as file:
            stream = io.TextIOWrapper(file, encoding=encoding)
            while body := stream.read(_PIECE):
                body += stream.readline()
                while body.count('"') % 2 and (more := stream.readline()):
                    body += more
                yield body

    return encoding, pieces()


@contextmanager
def _readable(path: Path) -> Generator[None]:
    try:
        yield
    except UnicodeDecodeError:
        raise InputError(f"{path} changes its encoding within the file; {_CURE}") from None
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path} cannot be read to its end ({error}); copy it again") from None


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


def _encoding(data: bytes, *, whole: bool) -> str:
    """UTF-16 with a byte order mark, UTF-8 if valid, otherwise Windows-1252."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    try:
        # a piece of a long file may end within a character
        codecs.getincrementaldecoder("utf-8")().decode(data, final=whole)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def opened(content: str, encoding: str, source: str, layout: Layout) -> tuple[Text, Layout]:
    """Data lines, and the layout with the names and units of the file.

    Raises
    ------
    InputError
        If there is no header or no data, a column is missing, or units contradict each other.
    """
    text = _split_header(content, source, layout)
    refuse_one_column(text.header, f"{source}, line {text.first_line - 1}")
    found = layout.find(text.header, source, row=dict(zip(text.header, text.units, strict=False)))
    if not text.body.strip():
        raise without_data(source)
    text = _with_decimal(text, [text.header.index(name) for name in found.numbers])
    notes = list(found.findings)
    if encoding in _ENCODINGS:
        notes.append(find("text-encoding", encoding=_ENCODINGS[encoding]))
    if text.decimal == ",":
        notes.append(find("decimal-comma"))
    found = replace(found, findings=tuple(notes))
    first = next(_rows(text), list[str]())
    place = text.header.index(found.time)
    clock = Clock.of(first[place]) if place < len(first) else None
    return text, found if clock is None else found.dated(clock, source)


def refuse_one_column(header: Sequence[str], place: str) -> None:
    """Raise InputError if a table cannot hold both times and a coordinate."""
    if len(header) == 1:
        raise InputError(
            f"{place}: there is only the column {quoted(header[0])}; "
            "separate columns by comma, semicolon, tab or spaces: one for the time, one for each coordinate"
        )


def without_data(source: object) -> InputError:
    """The error of a table that ends with its header."""
    return InputError(f"{source} has a header, but no data lines; at least {MIN_SAMPLES} samples are needed")


class Peek(NamedTuple):
    """The beginning of a table as text; no column has a meaning yet.

    Attributes
    ----------
    header, units : tuple of str
        Names, and units from a row below them; empty without one.
    rows : list of tuple of str
        Numbers have a decimal point, whatever the decimal sign of the file.
    """

    header: tuple[str, ...]
    rows: list[tuple[str, ...]]
    units: tuple[str, ...] = ()


def peek_csv(path: Path, n_rows: int = 50) -> Peek:
    """Return the header of a CSV file and its first rows.

    Raises
    ------
    InputError
        If the file cannot be read or is not a table with a header.
    """
    nothing = Layout(time="", coordinates={}, forces={}, trial=None, angles=())
    content, _ = text_of(path)
    text = _split_header(content, str(path), nothing)
    text = replace(text, body=text.body[: 400 * n_rows * len(text.header)])
    text = _with_decimal(text, range(len(text.header)))
    rows = [tuple(_pointed(cell, text.decimal) for cell in row) for row in islice(_rows(text), n_rows)]
    return Peek(text.header, [row for row in rows if len(row) == len(text.header)], text.units)


def _pointed(cell: str, decimal: str) -> str:
    return cell.replace(",", ".") if decimal == "," and _FRACTION.fullmatch(cell) else cell


def _rows(text: Text) -> Iterator[list[str]]:
    """Cells of the rows that are not blank, as far as quotes can be understood."""
    reader = csv.reader(io.StringIO(text.body, newline=""), delimiter=text.delimiter, skipinitialspace=True)
    with suppress(csv.Error):  # the reader of the table reports the error
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells):
                yield cells


def _with_decimal(text: Text, places: Sequence[int]) -> Text:
    """The text with the decimal sign of the first number that has one."""
    if text.delimiter == "," or "," not in text.body:
        return text
    for row in _rows(text):
        for place in places:
            found = _FRACTION.fullmatch(row[place]) if place < len(row) else None
            if found:
                return replace(text, decimal=found[1])
    return text


def _split_header(text: str, source: str, layout: Layout) -> Text:
    """Find header, units and delimiter; leading lines that are blank or start with ``#`` are skipped."""
    _refuse_other_text(text, source)
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
    following = end + 1 if end >= 0 else len(text)
    delimiter, header = _sniff(line, layout)
    if not all(map(_is_number, header[0].split() if len(header) == 1 else header)):
        found = _split_units(_parted(Text(source, text[following:], number + 1, delimiter, header)))
        _refuse_preamble(found, number)
        return found
    # numpy.savetxt writes the header as a comment; the last comment then names the columns.
    delimiter, header = _sniff(comment, layout)
    named = _parted(Text(source, text[start:], number, delimiter, header))
    if len(named.header) != len(_cells(named.body.partition("\n")[0], named.delimiter)):
        raise InputError(
            f"{source}, line {number}: there are numbers where the header is expected; "
            "add a first line that names the columns"
        )
    return named


def _refuse_other_text(text: str, source: str) -> None:
    """Refuse files that a server or a program has written instead of a table."""
    for what, pattern in _OTHER_TEXT.items():
        if pattern.match(text):
            raise InputError(
                f"{source} is {what}, not a table; download or save the table itself as CSV text"
            )


def _refuse_preamble(text: Text, number: int) -> None:
    """Refuse a table below other lines, such as the name of a logger: a later line holds its header."""
    lines = text.body[:20_000].split("\n")[:_PREAMBLE]
    filled = [(k, line) for k, line in enumerate(lines, start=text.first_line) if line.strip()]
    for (place, line), (_, below) in pairwise(filled):
        for delimiter in _DELIMITERS:
            names, values = _cells(line, delimiter), _cells(below, delimiter)
            if len(names) < 2 or len(names) != len(values) or len({*names}) < len(names):
                continue
            if place == filled[0][0] and len(names) == len(text.header):
                continue  # a row of the table with text in it
            if any(map(_is_number, names)) or not all(_is_number(v) or Clock.of(v) for v in values):
                continue
            shown = ", ".join(map(quoted, names[:4]))
            raise InputError(
                f"{text.source}, line {number}: this is not the header of the table, which seems to begin at "
                f"line {place} ({shown}); delete the lines above it, or begin each of them with #"
            )


def _parted(text: Text) -> Text:
    """The text with tabs between its cells, if runs of spaces separate them."""
    names = text.header[0].split() if len(text.header) == 1 else []
    first = text.body.lstrip("\n").partition("\n")[0]
    if len(names) < 2 or '"' in first or len(first.split()) != len(names):
        return text
    return replace(text, body=_tabbed(text.body), delimiter="\t", header=tuple(names), spaced=True)


def _tabbed(body: str) -> str:
    return "\n".join("\t".join(line.split()) for line in body.split("\n"))


def _split_units(text: Text) -> Text:
    """Take off a row of units."""
    blank = re.match(r"(?:[^\S\n]*\n)*", text.body)
    start = blank.end() if blank else 0
    end = text.body.find("\n", start)
    end = len(text.body) if end < 0 else end + 1
    cells = _cells(text.body[start:end].rstrip("\n"), text.delimiter)
    if len(cells) != len(text.header) or not is_units_row(cells):
        return text
    line = text.first_line + text.body.count("\n", 0, end)
    return replace(text, body=text.body[end:], first_line=line, units=cells)


def _cells(line: str, delimiter: str) -> tuple[str, ...]:
    try:
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), list[str]())
    except csv.Error:  # a line of megabytes
        row = []
    return tuple(cell.strip() for cell in row)


def _sniff(line: str, layout: Layout) -> tuple[str, tuple[str, ...]]:
    """Return the delimiter that gives the most needed columns, then the most columns, and the columns."""
    needed = {layout.time, *layout.coordinates.values()}
    candidates = [(delimiter, _cells(line, delimiter)) for delimiter in _DELIMITERS]

    def found(cells: tuple[str, ...]) -> int:
        bare = {name for cell in cells for name in (cell, parted(cell)[0], parted(cell, time=True)[0])}
        return len(needed & bare)

    return max(candidates, key=lambda item: (found(item[1]), len(item[1])))


def _is_number(cell: str) -> bool:
    return cell in MISSING or NUMBER.fullmatch(cell.replace(",", ".")) is not None
