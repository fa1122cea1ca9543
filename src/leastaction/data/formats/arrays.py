"""Conversion of NPZ and MAT files, whose named arrays are columns, to a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from leastaction.data.formats.atomic import read_bytes
from leastaction.data.formats.frames import trial_name
from leastaction.data.formats.layout import Layout, Table
from leastaction.data.formats.units import Clock
from leastaction.data.validation import FloatArray, real_array
from leastaction.errors import InputError, MissingPackageError
from leastaction.identifiers import quoted

__all__ = ["arrays_table", "read_mat_table", "read_npz_table"]

_MATRIX = "q"


def read_npz_table(path: Path, layout: Layout) -> tuple[Layout, Table]:
    """Read the variables of `layout` from an NPZ file; pickled objects are refused."""
    if read_bytes(path, 4)[:2] != b"PK":
        raise InputError(f"{path} is not an NPZ file; write it with numpy.savez")
    with ExitStack() as stack:
        try:
            # Opened here, because NumPy leaves a damaged file open.
            stream = stack.enter_context(path.open("rb"))
            file = stack.enter_context(np.load(stream, allow_pickle=False))
            names = list(file.files)
        except Exception as error:  # a damaged file can fail in many ways
            raise _damaged(path, "NPZ", error) from None

        def get(name: str) -> Any:
            try:
                return file[name]
            except Exception as error:
                if "allow_pickle" in str(error):
                    raise InputError(
                        f"{path}, variable {quoted(name)}: it holds pickled objects, which are not loaded "
                        "because they could run code; save plain numbers"
                    ) from None
                raise _damaged(path, "NPZ", error) from None

        return arrays_table(names, get, layout, str(path))


def read_mat_table(path: Path, layout: Layout) -> tuple[Layout, Table]:
    """Read the variables of `layout` from a MATLAB file: version 4 to 7 with SciPy, 7.3 with h5py."""
    start = read_bytes(path, 128)
    if start[:8] == b"\x89HDF\r\n\x1a\n" or start.startswith(b"MATLAB 7.3"):
        return _read_mat73(path, layout)
    from scipy.io import loadmat, whosmat

    try:
        names = [name for name, _, _ in whosmat(path)]
    except Exception as error:  # a damaged file can fail in many ways
        raise _damaged(path, "MAT", error) from None

    def get(name: str) -> Any:
        try:
            value = loadmat(path, variable_names=[name])[name]
        except Exception as error:
            raise _damaged(path, "MAT", error) from None
        return value.toarray() if hasattr(value, "toarray") else value

    return arrays_table(names, get, layout, str(path))


def _read_mat73(path: Path, layout: Layout) -> tuple[Layout, Table]:
    try:
        h5py: Any = import_module("h5py")
    except ImportError:
        what = f"{path}: reading MAT files of version 7.3"
        raise MissingPackageError(what, "h5py", "mat73", "save with -v7 in MATLAB") from None
    with ExitStack() as stack:
        try:
            file = stack.enter_context(h5py.File(path, "r"))
            names = [name for name, item in file.items() if isinstance(item, h5py.Dataset)]
        except Exception as error:
            raise _damaged(path, "MAT 7.3", error) from None

        def get(name: str) -> Any:
            try:
                return _matlab_value(file, file[name])
            except Exception as error:
                raise _damaged(path, "MAT 7.3", error) from None

        return arrays_table(names, get, layout, str(path))


def _matlab_value(file: Any, item: Any) -> Any:
    """Return a dataset as MATLAB shows it: columns first, text as text, a cell array as a list of texts."""
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if "MATLAB_empty" in item.attrs:
        return np.empty(0)
    values = np.asarray(item[()])
    if kind == "cell":
        return np.array(
            [_matlab_value(file, file[reference]) for reference in values.ravel(order="F")], dtype=object
        )
    if kind == "char":
        return "".join(map(chr, values.ravel().tolist()))
    return values.T


def arrays_table(
    names: Sequence[str], get: Callable[[str], Any], layout: Layout, source: str
) -> tuple[Layout, Table]:
    """Take the variables of `layout` from named arrays.

    Every coordinate, the time and every force is a variable with n_times values. If no coordinate is found,
    the columns of a matrix ``q`` of shape (n_times, n_dof) are the coordinates in order.

    Raises
    ------
    InputError
        If a variable is missing, has another length than the time, or does not hold real numbers.
    """
    matrix = not set(layout.coordinates.values()) & set(names) and _MATRIX in names
    columns = {_MATRIX: get(_MATRIX)} if matrix else {}
    available = [*names, *layout.coordinates.values()] if matrix else names
    found = layout.find(available, source, "variable")
    times = get(found.time)
    if getattr(times, "dtype", np.dtype(float)).kind == "M":
        found, times = _dated(found, np.ravel(times), source)
    numbers = {
        name: _vector(times if name == found.time else get(name), name, source)
        for name in found.numbers
        if not (matrix and name in found.coordinates.values())
    }
    n_times = numbers[found.time].size
    if matrix:
        numbers.update(_split_matrix(columns[_MATRIX], found.coordinates, n_times, source))
    for name, values in numbers.items():
        if values.size != n_times:
            raise InputError(
                f"{source}, variable {quoted(name)}: it has {values.size} values, but the time "
                f"{quoted(found.time)} has {n_times}; all must have the same length"
            )
    trials = None if found.trial is None else _trials(get(found.trial), found.trial, n_times, source)
    return found, Table(source, numbers, trials, lambda row: f"row {row} (counted from 0)")


def _dated(layout: Layout, times: Any, source: str) -> tuple[Layout, FloatArray]:
    """Dates as seconds from the first one, NaN if missing; and the layout with this clock."""
    missing = np.isnat(times)
    moments = times.astype("datetime64[ns]").astype(np.int64)
    clock = Clock(int(moments[~missing][0]) if not missing.all() else 0, zoned=False)
    return layout.dated(clock, source), np.where(missing, np.nan, (moments - clock.origin) / 1e9)


def _vector(value: Any, name: str, source: str) -> FloatArray:
    array = real_array(value, f"{source}, variable {quoted(name)}")
    # MATLAB has no vectors: a single column or row counts as one.
    if array.ndim > 2 or (array.ndim == 2 and 1 not in array.shape and array.size):
        raise InputError(
            f"{source}, variable {quoted(name)}: it has shape {array.shape}, but one value for each time "
            "is expected"
        )
    return array.ravel()


def _split_matrix(
    value: Any, coordinates: Mapping[str, str], n_times: int, source: str
) -> dict[str, FloatArray]:
    matrix = real_array(value, f"{source}, variable '{_MATRIX}'")
    expected = (n_times, len(coordinates))
    if matrix.size == n_times and len(coordinates) == 1:
        matrix = matrix.reshape(expected)
    if matrix.shape != expected:
        cure = "; it looks transposed: save its transpose" if matrix.shape == expected[::-1] else ""
        raise InputError(
            f"{source}, variable '{_MATRIX}': it has shape {matrix.shape}, but (n_times, n_dof) = {expected} "
            f"is expected{cure}"
        )
    return {column: matrix[:, index].copy() for index, column in enumerate(coordinates.values())}


def _trials(value: Any, name: str, n_times: int, source: str) -> list[str]:
    items = [item.item() if getattr(item, "size", 0) == 1 else item for item in np.ravel(value).tolist()]
    trials = [trial_name(item) for item in items]
    if len(trials) == 1:
        return trials * n_times
    if len(trials) != n_times:
        raise InputError(
            f"{source}, variable {quoted(name)}: it has {len(trials)} values, but there are {n_times} times; "
            "it must name the trial of each time"
        )
    return trials


def _damaged(path: Path, kind: str, error: Exception) -> InputError:
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    return InputError(f"{path} is a damaged {kind} file, or of another kind ({reason}); write it again")
