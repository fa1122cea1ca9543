"""Data frames (pandas, polars, Arrow and others that narwhals knows), Parquet and Excel files to a table."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leastaction.data.formats.atomic import read_bytes
from leastaction.data.formats.layout import MIN_SAMPLES, Layout, Table
from leastaction.data.formats.text import MISSING, NUMBER, Peek
from leastaction.data.formats.units import Clock, Unit, is_units_row
from leastaction.data.validation import FloatArray
from leastaction.errors import InputError, MissingPackageError
from leastaction.findings import find
from leastaction.identifiers import quoted

__all__ = [
    "frame_table",
    "parquet_tables",
    "peek_excel",
    "read_excel_table",
    "read_parquet_table",
    "trial_name",
]


def frame_table(
    frame: Any, layout: Layout, source: str = "data frame", before: int = 0
) -> tuple[Layout, Table]:
    """Take the columns of `layout` from a data frame, whose rows are numbered from ``before``.

    Raises
    ------
    InputError
        If `frame` is not a data frame, lacks a column, or a column does not hold numbers.
    """
    import narwhals.stable.v1 as nw

    if hasattr(frame, "iloc") and hasattr(frame, "columns"):
        # pandas allows a duplicate name, narwhals does not; report it here.
        layout.find(list(frame.columns), source)
    try:
        wrapped = nw.from_native(frame)
        table = wrapped.collect() if isinstance(wrapped, nw.LazyFrame) else wrapped
    except Exception as error:  # other libraries may raise anything for unknown objects
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{type(frame).__name__} is not a usable data frame: {reason}") from None
    if not isinstance(table, nw.DataFrame):
        raise InputError(f"{type(frame).__name__} is not a data frame; pass a pandas or polars DataFrame")
    found = layout.find(table.columns, source)
    if found.clock is None:
        found = _dated(found, table.get_column(found.time), source)

    def place(row: int) -> str:
        return f"row {before + row} (counted from 0)"

    numbers = {
        name: _numbers(table.get_column(name), name, found, lambda row: f"{source}, {place(row)}")
        for name in found.numbers
    }
    trials = None
    if found.trial is not None:
        column = table.get_column(found.trial)
        missing = column.is_null().to_list()
        trials = [
            "" if gone else trial_name(value) for value, gone in zip(column.to_list(), missing, strict=True)
        ]
    return found, Table(source, numbers, trials, place)


def read_parquet_table(path: Path, layout: Layout) -> tuple[Layout, Table]:
    """Read the columns of `layout` from a Parquet file.

    Raises
    ------
    InputError
        If pyarrow is not installed, the file cannot be read, or as `frame_table`.
    """
    with _parquet(path) as file:
        found = layout.find(file.schema_arrow.names, str(path))
        table = file.read(columns=_wanted(found))
    return frame_table(table, layout, str(path))


def parquet_tables(path: Path, layout: Layout) -> tuple[Layout, Iterator[Table]]:
    """The same by row groups; only one of them is in memory.

    Raises
    ------
    InputError
        As `read_parquet_table`; errors in a row group are raised when it is reached.
    """
    import narwhals.stable.v1 as nw

    with _parquet(path) as file:
        found = layout.find(file.schema_arrow.names, str(path))
        if file.num_row_groups:
            first = nw.from_native(file.read_row_group(0, columns=[found.time]), eager_only=True)
            found = _dated(found, first.get_column(found.time), str(path))

    def tables() -> Iterator[Table]:
        before = 0
        with _parquet(path) as file:
            for k in range(file.num_row_groups):
                group = file.read_row_group(k, columns=_wanted(found))
                table = frame_table(group, replace(layout, clock=found.clock), str(path), before)[1]
                before += group.num_rows
                if group.num_rows:
                    yield table

    return found, tables()


def _wanted(layout: Layout) -> list[str]:
    return [*layout.numbers, *([] if layout.trial is None else [layout.trial])]


@contextmanager
def _parquet(path: Path) -> Generator[Any]:
    """An open Parquet file."""
    try:
        parquet: Any = import_module("pyarrow.parquet")
    except ImportError:
        raise MissingPackageError(f"{path}: reading Parquet", "pyarrow", "parquet") from None
    if read_bytes(path, 4) != b"PAR1":
        raise InputError(f"{path} is not a Parquet file; check what wrote it")
    try:
        with parquet.ParquetFile(path) as file:
            yield file
    except (InputError, GeneratorExit):
        raise
    except Exception as error:  # a damaged file can fail in many ways
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path} is a damaged Parquet file ({reason}); write it again") from None


def read_excel_table(path: Path, layout: Layout) -> tuple[Layout, Table]:
    """Read the columns of `layout` from the first sheet of an Excel file.

    Raises
    ------
    InputError
        If openpyxl is not installed, the file cannot be read, has no header, lacks a column, or a cell is not
        a number.
    """
    sheet = _Sheet.of(path)
    found = layout.find(sheet.header, str(path), row=dict(zip(sheet.header, sheet.units, strict=False)))
    if sheet.others:
        note = find("first-sheet", sheet=sheet.name, others=sheet.others)
        found = replace(found, findings=(note, *found.findings))
    if not sheet.rows:
        raise InputError(
            f"{path} has a header, but no rows below it; at least {MIN_SAMPLES} samples are needed"
        )

    def place(row: int) -> str:
        return f"row {sheet.lines[row]}"

    columns = {name: sheet.column(name) for name in found.numbers}
    first = next((cell for cell in columns[found.time] if cell is not None), None)
    clock = Clock.of(first)
    found = found if clock is None else found.dated(clock, str(path))
    numbers = {
        name: _numbers_from_objects(
            cells,
            [cell is None for cell in cells],
            name,
            lambda row: f"{path}, {place(row)}",
            found.clock if name == found.time else None,
        )
        for name, cells in columns.items()
    }
    trials = None
    if found.trial is not None:
        trials = ["" if cell is None else trial_name(cell) for cell in sheet.column(found.trial)]
    return found, Table(str(path), numbers, trials, place)


def peek_excel(path: Path, n_rows: int = 50) -> Peek:
    """Return the header of the first sheet of an Excel file and its first rows.

    Raises
    ------
    InputError
        As `read_excel_table`.
    """
    sheet = _Sheet.of(path)
    rows = [tuple("" if cell is None else _text(cell) for cell in row) for row in sheet.rows[:n_rows]]
    return Peek(sheet.header, rows, sheet.units)


def _text(cell: Any) -> str:
    return cell.isoformat() if hasattr(cell, "isoformat") else str(cell).strip()


@dataclass(frozen=True)
class _Sheet:
    """Rows of a sheet that are not blank, and the number of each, from 1; None is an empty cell."""

    name: str
    others: tuple[str, ...]
    header: tuple[str, ...]
    units: tuple[str, ...]
    rows: list[tuple[Any, ...]]
    lines: list[int]

    @classmethod
    def of(cls, path: Path) -> _Sheet:
        name, others, cells = _cells_of(path)
        lines = [k for k, row in enumerate(cells, start=1) if any(cell is not None for cell in row)]
        while lines and _text(next(c for c in cells[lines[0] - 1] if c is not None)).startswith("#"):
            lines = lines[1:]
        if not lines:
            raise InputError(
                f"{path}: the sheet {quoted(name)} is empty; it must begin with names of columns"
            )
        first = cells[lines[0] - 1]
        width = max(k for k, cell in enumerate(first, start=1) if cell is not None)
        header = tuple("" if cell is None else _text(cell) for cell in first[:width])
        if not any(isinstance(cell, str) for cell in first):
            raise InputError(
                f"{path}, row {lines[0]}: there are numbers where the header is expected; add a first row "
                "that names the columns"
            )
        rows = [(*cells[k - 1][:width], *[None] * (width - len(cells[k - 1]))) for k in lines[1:]]
        units = tuple("" if cell is None else _text(cell) for cell in rows[0]) if rows else ()
        if not is_units_row(units):
            return cls(name, others, header, (), rows, lines[1:])
        return cls(name, others, header, units, rows[1:], lines[2:])

    def column(self, name: str) -> list[Any]:
        """Cells of a column; numbers that Excel keeps as text are numbers."""
        place = self.header.index(name)
        return [_plain_cell(row[place]) for row in self.rows]


def _plain_cell(cell: Any) -> Any:
    if not isinstance(cell, str):
        return cell
    text = cell.strip()
    if text in MISSING or text == "#N/A":
        return None
    return float(text) if NUMBER.fullmatch(text) else text


def _cells_of(path: Path) -> tuple[str, tuple[str, ...], list[tuple[Any, ...]]]:
    """Name and cells of the first visible sheet, and the names of the others."""
    try:
        openpyxl: Any = import_module("openpyxl")
    except ImportError:
        what = f"{path}: reading Excel files"
        raise MissingPackageError(what, "openpyxl", "excel", "save the sheet as CSV") from None
    start = read_bytes(path, 4)
    if start[:2] != b"PK":
        old = " (an old one, or one with a password)" if start == b"\xd0\xcf\x11\xe0" else ""
        raise InputError(
            f"{path} is not an Excel file in the form .xlsx{old}; save it in this form, or as CSV"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about features that do not affect the cells
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            try:
                shown = [sheet for sheet in book.worksheets if sheet.sheet_state == "visible"]
                first = shown[0]
                first.reset_dimensions()  # some programs write them wrongly
                cells = [tuple(row) for row in first.iter_rows(values_only=True)]
                return str(first.title), tuple(str(sheet.title) for sheet in shown[1:]), cells
            finally:
                book.close()
    except Exception as error:  # a damaged file can fail in many ways
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path} is a damaged Excel file ({reason}); save it again") from None


def trial_name(value: object) -> str:
    """Return the text for one entry of a trial column; 3 and 3.0 are the same trial."""
    if isinstance(value, Real) and not isinstance(value, Integral):
        number = float(value)
        return str(int(number)) if number.is_integer() else "" if np.isnan(number) else repr(number)
    return str(value).strip()


def _dated(layout: Layout, times: Any, source: str) -> Layout:
    """The layout of a table whose times are dates, durations, or numbers."""
    import narwhals.stable.v1 as nw

    if times.dtype == nw.Duration:
        unit = Unit("timedelta", "time", "s", 1.0, 1e9)
        layout.refuse_time_unit("durations, which have units of their own", source)
        note = find("time-unit", column=layout.time, unit=unit.text, instead_of=None)
        others = (item for item in layout.findings if item.code != "time-unit")
        conversions = layout.conversions | {layout.time: unit}
        return replace(layout, conversions=conversions, findings=(note, *others))
    if times.dtype.is_numeric():
        return layout
    first = next((item for item in times.drop_nulls().head(1).to_list()), None)
    clock = Clock.of(first.strip() if isinstance(first, str) else first)
    return layout if clock is None else layout.dated(clock, source)


def _numbers(column: Any, name: str, layout: Layout, place: Callable[[int], str]) -> FloatArray:
    import narwhals.stable.v1 as nw

    clock = layout.clock if name == layout.time else None
    if column.dtype.is_numeric():
        return np.array(column.cast(nw.Float64).to_numpy(), dtype=np.float64)
    missing = np.array(column.is_null().to_list(), dtype=bool)
    if name == layout.time and column.dtype == nw.Duration:
        return _whole(column.dt.total_nanoseconds(), missing, 0)
    if clock is not None and isinstance(column.dtype, nw.Datetime):
        # one type, one zone or none
        return _whole(column.dt.timestamp("ns"), missing, clock.origin) / 1e9
    return _numbers_from_objects(column.to_list(), missing, name, place, clock)


def _whole(column: Any, missing: NDArray[np.bool_], origin: int) -> FloatArray:
    """Integers minus the origin, NaN if missing; before the subtraction, floats could not hold them."""
    values = np.full(missing.size, np.nan)
    present = np.array(column.drop_nulls().to_list(), dtype=np.int64)
    values[~missing] = present - origin
    return values


def _numbers_from_objects(
    items: Sequence[Any],
    missing: Iterable[bool],
    name: str,
    place: Callable[[int], str],
    clock: Clock | None,
) -> FloatArray:
    """Convert a column of mixed or unknown type: numbers only, neither text nor truth values; or dates."""
    values = np.full(len(items), np.nan)
    for row, (item, gone) in enumerate(zip(items, missing, strict=True)):
        if gone:
            continue
        if clock is not None:
            try:
                values[row] = clock.seconds(item.strip() if isinstance(item, str) else item)
            except ValueError:
                raise InputError(
                    f"{place(row)}, column {quoted(name)}: {quoted(item)} is not a date like the first one; "
                    "write all times in the same form"
                ) from None
            continue
        if isinstance(item, bool) or not isinstance(item, Real):
            raise InputError(
                f"{place(row)}, column {quoted(name)}: {quoted(item)} is not a number; convert the column to "
                "numbers (times to seconds)"
            )
        values[row] = float(item)
    return values
