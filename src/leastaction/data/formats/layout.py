"""Which column of a file means what, and how checked columns become trajectories."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.data.validation import FloatArray, close_match, listed, time_fault
from leastaction.errors import DataError, InputError
from leastaction.identifiers import check_coordinate_names, quoted

__all__ = ["MIN_SAMPLES", "Coordinates", "Forces", "Layout", "Table", "to_trajectories"]

MIN_SAMPLES = 5
"""Fewest measured samples of a coordinate in a trial with which anything can be done."""

Coordinates = Sequence[str] | Mapping[str, str] | str
Forces = Mapping[str, str] | Sequence[str | None] | str | None

_BESIDE = {"forces": "force on", "velocities": "velocity of", "accelerations": "acceleration of"}
"""What there may be for each coordinate, in words."""


@dataclass(frozen=True)
class Layout:
    """The columns that hold time, coordinates, forces and trial.

    Attributes
    ----------
    time : str
        Column of the times.
    coordinates : dict
        Coordinate -> its column.
    forces : dict
        Coordinate -> column of its force; only coordinates that are driven.
    trial : str or None
        Column of the names of trials.
    angles : tuple of str
        Coordinates to unwrap.
    velocities, accelerations : dict
        Coordinate -> column of its measured velocity, acceleration; only those that are measured.
    """

    time: str
    coordinates: dict[str, str]
    forces: dict[str, str]
    trial: str | None
    angles: tuple[str, ...]
    velocities: dict[str, str] = field(default_factory=dict[str, str])
    accelerations: dict[str, str] = field(default_factory=dict[str, str])

    @classmethod
    def of(
        cls,
        coordinates: Coordinates,
        time: str,
        forces: Forces,
        trial: str | None,
        angles: Iterable[str],
        velocities: Forces = None,
        accelerations: Forces = None,
    ) -> Layout:
        """Check the arguments of a reader and return them as a Layout."""
        columns = _coordinate_columns(coordinates)
        known = tuple(columns)
        given_columns = {"forces": forces, "velocities": velocities, "accelerations": accelerations}
        beside = {kind: _columns_for(kind, given, known) for kind, given in given_columns.items()}
        for role, column in (("time", time), ("trial", trial)):
            _check_column(role, column)
        given = (angles,) if isinstance(angles, str) else tuple(angles)
        turning = check_coordinate_names(given) if given else ()
        for name in turning:
            if name not in known:
                raise InputError(
                    f"angle {quoted(name)} is not a coordinate; the coordinates are {listed(known)}"
                )
        layout = cls(time, columns, trial=trial, angles=turning, **beside)
        layout._check_uses()
        return layout

    def find(self, available: Sequence[object], source: str, kind: str = "column") -> Layout:
        """Return this layout with the names as they stand in the file, the column ``trial`` included.

        Raises
        ------
        InputError
            If a needed column is missing, or a name occurs twice in the file.
        """
        present: dict[str, str] = {}
        for name in available:
            if isinstance(name, str) and name:
                if name in present.values():
                    raise InputError(
                        f"{source}: two {kind}s are called {quoted(name)}; give each its own name"
                    )
                present.setdefault(_normal(name), name)

        def where(role: str, name: str) -> str:
            if name in present.values():
                return name
            if _normal(name) in present:
                return present[_normal(name)]
            names = list(present.values())
            there = (
                f"its {kind}s are {listed(names)}{close_match(name, names)}"
                if names
                else f"it has no named {kind}s"
            )
            raise InputError(f"{source} has no {kind} {quoted(name)} ({role}); {there}")

        found = replace(
            self,
            time=where("time", self.time),
            coordinates={c: where(f"coordinate {c}", name) for c, name in self.coordinates.items()},
            trial=None if self.trial is None else where("trial", self.trial),
            **{
                kind: {c: where(f"{word} {c}", name) for c, name in getattr(self, kind).items()}
                for kind, word in _BESIDE.items()
            },
        )
        if found.trial is None and "trial" in present and present["trial"] not in found.numbers:
            found = replace(found, trial=present["trial"])
        found._check_uses()
        return found

    @property
    def numbers(self) -> tuple[str, ...]:
        """The columns that hold numbers, each once."""
        beside = [column for kind in _BESIDE for column in getattr(self, kind).values()]
        return tuple(dict.fromkeys([self.time, *self.coordinates.values(), *beside]))

    def role(self, column: str) -> str:
        """What a column of numbers means, in words; samples may be missing."""
        if column == self.time:
            return "time"
        return "force" if column in self.forces.values() else "sample"

    def _check_uses(self) -> None:
        uses = [("time", self.time), *((f"coordinate {c}", name) for c, name in self.coordinates.items())]
        if self.trial is not None:
            uses.append(("trial", self.trial))
        seen: dict[str, str] = {}
        for role, column in uses:
            if column in seen:
                raise InputError(f"column {quoted(column)} is used twice, as {seen[column]} and as {role}")
            seen[column] = role
        for kind, word in _BESIDE.items():
            for coordinate, column in getattr(self, kind).items():
                role = f"{word} {coordinate}"
                if column in seen:
                    raise InputError(
                        f"column {quoted(column)} is used twice, as {seen[column]} and as {role}"
                    )
                if kind != "forces":
                    seen[column] = role
            # One force may act on two coordinates, but it cannot be anything else.
            seen |= {column: f"{word} {c}" for c, column in getattr(self, kind).items()}


@dataclass(frozen=True)
class Table:
    """Columns read from a file.

    Attributes
    ----------
    source : str
        The file, for messages.
    numbers : dict
        Column -> float64 values, shape (n_rows,); NaN where the file has none.
    trials : sequence of str, or None
        The trial of each row.
    place : callable
        Number of a row, from 0 -> where the user finds it, e.g. ``"line 7"``.
    """

    source: str
    numbers: dict[str, FloatArray]
    trials: Sequence[str] | None
    place: Callable[[int], str]


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
        In the order of the table, unwrapped where `layout` has angles.

    Raises
    ------
    InputError
        If a value is infinite, a time or a force is missing, the rows of a trial are not together, or times
        do not increase.
    DataError
        If a coordinate has fewer than `MIN_SAMPLES` samples in a trial.
    """
    _check_values(layout, table)
    trajectories: list[Trajectory] = []
    for label, rows in _trial_rows(layout, table, name):
        _check_times(layout, table, label, rows)
        q = np.column_stack([table.numbers[column][rows] for column in layout.coordinates.values()])
        _check_enough(layout, table, label, q)
        beside = {kind: _matrix(layout, table, kind, rows, q.shape) for kind in _BESIDE}
        t = table.numbers[layout.time][rows]
        trajectories.append(Trajectory(t, q, coordinates=tuple(layout.coordinates), name=label, **beside))
    result = Trajectories(trajectories)
    return result.unwrap(layout.angles) if layout.angles else result


def _matrix(
    layout: Layout, table: Table, kind: str, rows: slice, shape: tuple[int, ...]
) -> FloatArray | None:
    """Forces, velocities or accelerations of some rows; None without any column."""
    columns = getattr(layout, kind)
    if not columns:
        return None
    out = np.full(shape, 0.0 if kind == "forces" else np.nan)
    for index, coordinate in enumerate(layout.coordinates):
        if coordinate in columns:
            out[:, index] = table.numbers[columns[coordinate]][rows]
    return out


def _check_column(role: str, column: object) -> None:
    if column is not None and not isinstance(column, str):
        raise InputError(f"{role} must be the name of a column, not {quoted(column)}")


def _coordinate_columns(coordinates: Mapping[str, object] | Sequence[str] | str) -> dict[str, str]:
    if isinstance(coordinates, Mapping):
        checked: dict[str, str] = {}
        for name, column in zip(check_coordinate_names(coordinates), coordinates.values(), strict=True):
            if not isinstance(column, str):
                raise InputError(f"the column of coordinate {name} must be a name, not {quoted(column)}")
            checked[name] = column
        return checked
    if not isinstance(coordinates, str):
        try:
            coordinates = list(coordinates)
        except TypeError:
            raise InputError(f"coordinates must be a sequence of names, not {quoted(coordinates)}") from None
    names = check_coordinate_names(coordinates)
    return dict(zip(names, [coordinates] if isinstance(coordinates, str) else coordinates, strict=True))


def _columns_for(
    kind: str, given: Mapping[Any, object] | Sequence[object] | str | None, coordinates: tuple[str, ...]
) -> dict[str, str]:
    """Coordinate -> column of its force, velocity or acceleration."""
    word = _BESIDE[kind]
    if given is None:
        return {}
    if isinstance(given, Mapping):
        pairs: list[tuple[Any, object]] = [
            (_normal(name) if isinstance(name, str) else name, column) for name, column in given.items()
        ]
    else:
        try:
            columns = [given] if isinstance(given, str) else list(given)
        except TypeError:
            raise InputError(f"{kind} must be names of columns, not {quoted(given)}") from None
        if len(columns) > len(coordinates):
            raise InputError(
                f"there are {len(columns)} {word.split()[0]} columns for {len(coordinates)} coordinate(s) "
                f"({', '.join(coordinates)}); give at most one for each"
            )
        pairs = [pair for pair in zip(coordinates, columns, strict=False) if pair[1] is not None]
    checked: dict[str, str] = {}
    for name, column in pairs:
        if name not in coordinates:
            hint = close_match(name, coordinates) if isinstance(name, str) else ""
            known = f"the coordinates are {listed(coordinates)}{hint}"
            raise InputError(f"the {word} {quoted(name)} belongs to no coordinate; {known}")
        if not isinstance(column, str):
            raise InputError(f"the {word} {name} must be the name of a column, not {quoted(column)}")
        checked[name] = column
    return checked


def _normal(name: str) -> str:
    return unicodedata.normalize("NFKC", name).strip()


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
                f"{place}: trial {quoted(label)} goes on after another trial (it began at "
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
        what = f"time {float(t[index])!r} repeats the one before it{trial}"
        cure = "keep one row for each time"
    else:
        what = f"time {float(t[index])!r} goes backwards, from {float(t[index - 1])!r}{trial}"
        cure = "sort the rows by time"
    if table.trials is None:
        cure += ", or give the column that tells the trials apart (trial=...)"
    place = f"{table.source}, {table.place(rows.start + index)}, column {quoted(layout.time)}"
    raise InputError(f"{place}: {what}; {cure}")


def _check_enough(layout: Layout, table: Table, label: str, q: FloatArray) -> None:
    trial = f", trial {quoted(label)}" if table.trials is not None else ""
    need = f"at least {MIN_SAMPLES} are needed; leave the trial out or record a longer one"
    if len(q) < MIN_SAMPLES:
        raise DataError(f"{table.source}{trial}: there are only {len(q)} sample(s); {need}")
    for name, count in zip(layout.coordinates, np.isfinite(q).sum(axis=0).tolist(), strict=True):
        if count < MIN_SAMPLES:
            raise DataError(f"{table.source}{trial}: {name} has only {count} measured sample(s); {need}")
