"""The meaning and unit of each column of a file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypedDict

from leastaction.data.formats.columns import Names
from leastaction.data.formats.units import Clock, Unit, known_unit, normal, parted, time_unit_of, unit_in_file
from leastaction.data.trajectory import Stated
from leastaction.data.validation import FloatArray, close_match, listed
from leastaction.errors import InputError
from leastaction.findings import Finding, find
from leastaction.identifiers import check_coordinate_names, quoted

__all__ = ["BESIDE", "MIN_SAMPLES", "Coordinates", "Forces", "Layout", "Table", "UnitOptions", "Units"]

MIN_SAMPLES = 5
"""Fewest measured samples of a coordinate in a trial."""

Coordinates = Sequence[str] | Mapping[str, str] | Mapping[str, str | None] | str
Forces = Mapping[str, str] | Sequence[str | None] | str | None
Units = Mapping[str, str] | str


class UnitOptions(TypedDict, total=False):
    """How a reader takes the units of a file: keyword arguments of all readers.

    Attributes
    ----------
    time_unit : str or None
        Unit of the times. It overrides the file.
    units : {"SI", "as-written"}, or mapping of str to str
        Whether columns with a unit are converted, or the units of coordinates and columns.
    """

    time_unit: str | None
    units: Units


BESIDE = {"forces": "force on", "velocities": "velocity of", "accelerations": "acceleration of"}
"""Quantities of each coordinate, in words."""


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
    asked : dict
        Coordinate or column -> its unit, from the user. It overrides the unit in the file.
    as_written : bool
        Whether units in the file are ignored.
    conversions : dict
        Column -> its unit, if numbers are converted; see `find`.
    clock : Clock or None
        Conversion of dates to seconds, if the times of the file are dates.
    findings : tuple of Finding
        Changes to the data of the file.
    stated_units : tuple of (str, str, str)
        Quantity, coordinate and unit of SI of the columns whose unit is known; see `Trajectory`.
    unmeasured : tuple of str
        Coordinates without a column, on which forces may act; after the others.
    """

    time: str
    coordinates: dict[str, str]
    forces: dict[str, str]
    trial: str | None
    angles: tuple[str, ...]
    velocities: dict[str, str] = field(default_factory=dict[str, str])
    accelerations: dict[str, str] = field(default_factory=dict[str, str])
    asked: dict[str, Unit] = field(default_factory=dict[str, Unit])
    as_written: bool = False
    conversions: dict[str, Unit] = field(default_factory=dict[str, Unit])
    clock: Clock | None = None
    findings: tuple[Finding, ...] = ()
    stated_units: Stated = ()
    unmeasured: tuple[str, ...] = ()

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
        columns, unmeasured = _coordinate_columns(coordinates)
        known = tuple(columns)
        rates = (_columns_for("velocities", velocities, known),)
        rates = (*rates, _columns_for("accelerations", accelerations, known))
        acting = _columns_for("forces", forces, (*known, *unmeasured))
        for role, column in (("time", time), ("trial", trial)):
            _check_column(role, column)
        given = (angles,) if isinstance(angles, str) else tuple(angles)
        turning = check_coordinate_names(given) if given else ()
        for name in turning:
            if name not in known:
                raise InputError(
                    f"angle {quoted(name)} is not a coordinate; the coordinates are {listed(known)}"
                )
        layout = cls(time, columns, acting, trial, turning, *rates, unmeasured=unmeasured)
        layout._check_uses()
        return layout

    def measured_in(self, time_unit: str | None = None, units: Units = "SI") -> Layout:
        """Check the `UnitOptions` of a reader, and return the layout with them.

        Raises
        ------
        InputError
            If a unit is not known, or that of the time is given twice.
        """
        if isinstance(units, str):
            if units.casefold() not in ("si", "as-written"):
                raise InputError(
                    f"units is {quoted(units)}; expected 'SI', 'as-written', or a mapping of coordinates or "
                    "columns to units"
                )
            asked: dict[str, Unit] = {}
        elif hasattr(units, "items"):
            asked = {name: known_unit(name, text) for name, text in units.items()}
        else:
            raise InputError(f"units is {quoted(units)}; expected 'SI', 'as-written', or a mapping")
        if time_unit is not None:
            if self.time in asked:
                raise InputError(f"the unit of {quoted(self.time)} is given twice, in time_unit and in units")
            asked[self.time] = time_unit_of(time_unit)
        as_written = isinstance(units, str) and units.casefold() == "as-written"
        return replace(self, asked=asked, as_written=as_written)

    def find(
        self,
        available: Sequence[object],
        source: str,
        kind: str = "column",
        row: Mapping[str, str] | None = None,
    ) -> Layout:
        """Return this layout with the names in the file, including the column ``trial``.

        A column may be named without its unit if this is unambiguous: ``t`` finds ``t [ms]``.

        Parameters
        ----------
        available : sequence
            Columns of the file.
        source, kind : str
            For messages: the file, and its word for columns.
        row : mapping, optional
            Column -> its cell in a row of units.

        Raises
        ------
        InputError
            If a needed column is missing, a name occurs twice in the file, or units contradict each other.
        """
        names = Names.of(available, source, kind)

        def where(role: str, name: str) -> str:
            return names.where(role, name, time=role == "time")

        found = replace(
            self,
            time=where("time", self.time),
            coordinates={c: where(f"coordinate {c}", name) for c, name in self.coordinates.items()},
            trial=None if self.trial is None else where("trial", self.trial),
            **{
                kind: {c: where(f"{word} {c}", name) for c, name in getattr(self, kind).items()}
                for kind, word in BESIDE.items()
            },
        )
        if found.trial is None and "trial" in names.present and names.present["trial"] not in found.numbers:
            found = replace(found, trial=names.present["trial"])
        found._check_uses()
        asked: dict[str, Unit] = {}
        for name, unit in self.asked.items():
            own = found.time if name == self.time else found.coordinates.get(name)
            own = own or names.where("units", name, time=False)
            if own not in found.numbers:
                raise InputError(f"units names {quoted(name)}, which is not a column that is read; omit it")
            if own in asked:
                raise InputError(f"units names the column {quoted(own)} twice, also as {quoted(name)}")
            asked[own] = unit
        return found._converting(asked, row or {}, source, self.time)

    def _converting(
        self, asked: Mapping[str, Unit], row: Mapping[str, str], source: str, asked_time: str
    ) -> Layout:
        """The layout of a file with conversions for its units, and a finding for each."""
        conversions: dict[str, Unit] = {}
        stated: list[tuple[str, str, str]] = []
        findings = [find("units-row", units=tuple(filter(None, row.values())))] if row else []
        for column, (coordinate, quantity) in self._roles().items():
            time, own = quantity == "time", asked.get(column)
            there = None
            if not self.as_written:
                there = unit_in_file(column, row.get(column, ""), time, source, strict=own is None)
            if own is not None and (own.kind == "time") != time:
                what = "not a time" if time else "a time"
                raise InputError(f"the unit of {quoted(column)} is {own.text}, which is {what}; correct it")
            unit = own or there
            if unit is not None and quantity in ("position", "force"):
                stated.append((quantity, coordinate, unit.si))
            if unit is None or (unit.plain and unit == (there or unit)):
                continue
            instead = there.text if there is not None and there != unit else None
            conversions[column] = unit
            if time:
                findings.append(find("time-unit", column=column, unit=unit.text, instead_of=instead))
            else:
                findings.append(
                    find(
                        "converted-units",
                        coordinate,
                        quantity=quantity,
                        column=column,
                        unit=unit.text,
                        to=unit.si,
                        instead_of=instead,
                    )
                )
        called = (normal(self.time), normal(parted(self.time, time=True)[0]))
        if self.time not in conversions and normal(asked_time) not in called:
            findings.append(find("time-column", column=self.time))
        return replace(self, conversions=conversions, findings=tuple(findings), stated_units=tuple(stated))

    def dated(self, clock: Clock, source: str) -> Layout:
        """Return the layout of a file whose times are dates.

        Raises
        ------
        InputError
            If the user gives a unit of the times.
        """
        self.refuse_time_unit("dates, which have no unit", source)
        others = tuple(item for item in self.findings if item.code not in ("time-unit", "time-column"))
        conversions = {column: unit for column, unit in self.conversions.items() if column != self.time}
        note = find("dates", column=self.time)
        return replace(self, clock=clock, conversions=conversions, findings=(note, *others))

    def refuse_time_unit(self, what: str, source: str) -> None:
        """Raise InputError if the user gives a unit for times that are not numbers."""
        if any(unit.kind == "time" for unit in self.asked.values()):
            raise InputError(f"{source}: the times in {quoted(self.time)} are {what}; leave out time_unit")

    def _roles(self) -> dict[str, tuple[str, str]]:
        """Column of numbers -> its coordinate and quantity."""
        roles = {column: (c, "position") for c, column in self.coordinates.items()}
        for kind, word in BESIDE.items():
            for coordinate, column in getattr(self, kind).items():
                roles.setdefault(column, (coordinate, word.split()[0]))
        return {self.time: ("", "time"), **roles}

    @property
    def numbers(self) -> tuple[str, ...]:
        """The columns that hold numbers, each once."""
        beside = [column for kind in BESIDE for column in getattr(self, kind).values()]
        return tuple(dict.fromkeys([self.time, *self.coordinates.values(), *beside]))

    def role(self, column: str) -> str:
        """Meaning of a column of numbers, in words; samples may be missing."""
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
        for kind, word in BESIDE.items():
            for coordinate, column in getattr(self, kind).items():
                role = f"{word} {coordinate}"
                if column in seen:
                    raise InputError(
                        f"column {quoted(column)} is used twice, as {seen[column]} and as {role}"
                    )
                if kind != "forces":
                    seen[column] = role
            # One force may act on two coordinates, but must not have another role.
            seen |= {column: f"{word} {c}" for c, column in getattr(self, kind).items()}


@dataclass(frozen=True)
class Table:
    """Columns read from a file.

    Attributes
    ----------
    source : str
        The file, for messages.
    numbers : dict
        Column -> float64 values, shape (n_rows,); NaN if missing in the file.
    trials : sequence of str, or None
        The trial of each row.
    place : callable
        Index of a row, from 0 -> its place in the file, e.g. ``"line 7"``.
    """

    source: str
    numbers: dict[str, FloatArray]
    trials: Sequence[str] | None
    place: Callable[[int], str]


def _check_column(role: str, column: object) -> None:
    if column is not None and not isinstance(column, str):
        raise InputError(f"{role} must be the name of a column, not {quoted(column)}")


def _coordinate_columns(
    coordinates: Mapping[str, Any] | Sequence[str] | str,
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Coordinate -> its column, and coordinates that have none."""
    if isinstance(coordinates, Mapping):
        checked: dict[str, str] = {}
        names = check_coordinate_names(coordinates)
        for name, column in zip(names, coordinates.values(), strict=True):
            if not isinstance(column, str | None):
                raise InputError(f"the column of coordinate {name} must be a name, not {quoted(column)}")
            if column is not None:
                checked[name] = column
        if not checked:
            raise InputError("no coordinate has a column; name at least one, e.g. coordinates={'x': 'x [m]'}")
        return checked, tuple(name for name in names if name not in checked)
    if not isinstance(coordinates, str):
        try:
            coordinates = list(coordinates)
        except TypeError:
            raise InputError(f"coordinates must be a sequence of names, not {quoted(coordinates)}") from None
    names = check_coordinate_names(coordinates)
    given = [coordinates] if isinstance(coordinates, str) else coordinates
    return dict(zip(names, given, strict=True)), ()


def _columns_for(
    kind: str, given: Mapping[Any, object] | Sequence[object] | str | None, coordinates: tuple[str, ...]
) -> dict[str, str]:
    """Coordinate -> column of its force, velocity or acceleration."""
    word = BESIDE[kind]
    if given is None:
        return {}
    if isinstance(given, Mapping):
        pairs: list[tuple[Any, object]] = [
            (normal(name) if isinstance(name, str) else name, column) for name, column in given.items()
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
