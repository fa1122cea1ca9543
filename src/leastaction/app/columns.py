"""Roles of the columns of an uploaded table: guesses, and the call of the reader."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from leastaction.data.formats import dispatch
from leastaction.data.formats.columns import TIME_NAMES
from leastaction.data.formats.units import Clock, Unit, parted, unit_of
from leastaction.errors import InputError
from leastaction.identifiers import ANGLE_NAMES, FUNCTION_NAMES, check_coordinate_names

if TYPE_CHECKING:
    from leastaction import Trajectories

__all__ = [
    "ACCELERATION",
    "ANGLE",
    "COORDINATE",
    "DATES",
    "DEGREES",
    "FORCE",
    "MICROSECONDS",
    "MILLISECONDS",
    "TIME",
    "TIMES",
    "TRIAL",
    "UNUSED",
    "VELOCITY",
    "Columns",
    "guess_roles",
    "peek",
    "read",
    "written_names",
]

UNUSED, TIME, TRIAL = "not used", "time (s)", "trial"
MILLISECONDS, MICROSECONDS, DATES = "time (ms)", "time (µs)", "time (dates)"
COORDINATE, ANGLE, DEGREES = "coordinate", "angle (rad)", "angle (degrees)"
FORCE, VELOCITY, ACCELERATION = "force on ", "velocity of ", "acceleration of "
"""A role is one of these, or one of the last three followed by the name of a coordinate."""

TIMES: dict[str, str | None] = {TIME: "s", MILLISECONDS: "ms", MICROSECONDS: "us", DATES: None}
"""Role of the times -> their unit; dates have none."""

_MOVING = (COORDINATE, ANGLE, DEGREES)
_TRIALS = {"trial", "run", "id", "experiment", "episode", "segment", "recording", "trajectory", "versuch"}
_IGNORED = {"", "index", "frame", "row", "sample", "n", "unnamed_0"}
_EFFORTS = {"force", "torque", "moment", "kraft", "drehmoment", "effort"}  # anywhere in the name
_FORCES = ("tau", "u", "f", "input", "τ")  # at its beginning
_RATES = ("_dot", "dot", "_vel", "_velocity", "_rate", "_acc", "_ddot", "_speed")
_RATE_STARTS = ("omega", "vel", "acc", "dtheta", "dphi", "dx", "dy", "dq", "ω")


@dataclass(frozen=True)
class Columns:
    """Header and first rows of a table, as text."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    units: tuple[str, ...] = ()

    def unit(self, column: str, time: bool = False) -> str | None:
        """The unit in the name or in the row below the header; None if there is none."""
        unit = self._unit(column, time)
        return None if unit is None else unit.text

    def effort(self, column: str) -> bool:
        """Whether a column is in a unit of forces or torques."""
        unit = self._unit(column)
        return unit is not None and unit.kind in ("force", "torque")

    def _unit(self, column: str, time: bool = False) -> Unit | None:
        place = self.header.index(column)
        by_row = unit_of(self.units[place]) if place < len(self.units) else None
        return by_row or parted(column, time)[1]

    def dated(self, column: str) -> bool:
        """Whether the first value of a column is a date."""
        place = self.header.index(column)
        return bool(self.rows) and Clock.of(self.rows[0][place]) is not None

    def sample(self, column: str, count: int = 3) -> str:
        """The first values of a column, for display."""
        place = self.header.index(column)
        return ", ".join((row[place] or "–")[:12] for row in self.rows[:count])

    def numbers(self, column: str) -> np.ndarray | None:
        """The first values as numbers (NaN: not a number); None if most are not numbers.

        A single wrong cell does not turn a column of numbers into text; the reader reports it.
        """
        place = self.header.index(column)
        cells = [row[place] for row in self.rows if row[place]]
        values = np.array([_number(cell) for cell in cells])
        return values if np.isfinite(values).sum() > len(cells) / 2 else None


def peek(path: Path) -> Columns:
    """Read the header and the first rows of a file."""
    header, rows, units = dispatch.peek(path)
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise InputError(f"{path}: two columns are called {twice[0]!r}; give each its own name")
    return Columns(header, tuple(rows), units)


def guess_roles(columns: Columns) -> dict[str, str]:
    """Return column -> role, by name and by the first values.

    Examples
    --------
    >>> rows = (("a", "0.0", "0.5", "1.0"), ("a", "0.1", "0.6", "1.0"))
    >>> list(guess_roles(Columns(("trial", "t", "theta", "tau"), rows)).values())
    ['trial', 'time (s)', 'angle (rad)', 'force on theta']
    """
    roles: dict[str, str] = dict.fromkeys(columns.header, UNUSED)
    time = _guess_time(columns)
    forces = []
    for column in columns.header:
        word = _word(column)
        if column == time:
            roles[column] = _time_role(columns, column)
        elif word in _TRIALS and TRIAL not in roles.values():
            roles[column] = TRIAL
        elif columns.numbers(column) is None or word in _IGNORED or _is_rate(word, columns.unit(column)):
            continue
        elif columns.effort(column) or _is_force(word):
            forces.append(column)
        elif word.startswith(ANGLE_NAMES):
            roles[column] = DEGREES if "deg" in word or columns.unit(column) == "deg" else ANGLE
        else:
            roles[column] = {"deg": DEGREES, "rad": ANGLE}.get(columns.unit(column) or "", COORDINATE)
    moving = [column for column in columns.header if roles[column] in _MOVING]
    names = coordinate_names(moving)
    for place, column in enumerate(forces):
        target = _driven(column, moving, place)
        if target is not None and FORCE + names[target] not in roles.values():
            roles[column] = FORCE + names[target]
    return roles


def coordinate_names(columns: Sequence[str]) -> dict[str, str]:
    """Return column -> name of the coordinate: the column if it is a valid name, otherwise derived from it.

    Examples
    --------
    >>> coordinate_names(["theta1", "Angle 2 [deg]", "x", "x (m)"])
    {'theta1': 'theta1', 'Angle 2 [deg]': 'Angle_2', 'x': 'x', 'x (m)': 'x_2'}
    """
    names: dict[str, str] = {}
    for column in columns:
        text = re.sub(r"[\[(].*?[\])]", "", unicodedata.normalize("NFKC", parted(column)[0]))
        name = re.sub(r"\W+", "_", text).strip("_")[:40].removesuffix("_dot") or "q"
        name = name if name[0].isalpha() else f"q_{name}"
        name = f"{name}_" if name in FUNCTION_NAMES or name in ("pi", "t", "E", "I") else name
        try:
            (name,) = check_coordinate_names([name])
        except InputError:
            name = "q"
        free, number = name, 2
        while free in names.values():
            free, number = f"{name}_{number}", number + 1
        names[column] = free
    return names


def written_names(columns: Sequence[str]) -> dict[str, str]:
    """Return name of the coordinate -> its column without the unit, where they differ.

    Examples
    --------
    >>> written_names(["theta1", "Upper arm [deg]", "x [m]", "x [mm]"])
    {'Upper_arm': 'Upper arm', 'x': 'x [m]', 'x_2': 'x [mm]'}
    """
    names = coordinate_names(columns)
    short = {column: parted(column)[0].strip() for column in columns}
    texts = {c: text if list(short.values()).count(text) == 1 else c for c, text in short.items()}
    return {names[column]: text for column, text in texts.items() if text and text != names[column]}


def moving_columns(roles: Mapping[str, str]) -> list[str]:
    """Columns that are coordinates of any kind, in the order of the file."""
    return [column for column, role in roles.items() if role in _MOVING]


def read(path: Path | Sequence[Path], roles: Mapping[str, str]) -> Trajectories:
    """Read the table, or several, as the roles say; angles are converted to radians and unwrapped.

    Raises
    ------
    InputError, DataError
        As the readers of leastaction do; also if a role is missing or given twice.
    """
    import leastaction as la

    moving = moving_columns(roles)
    names = coordinate_names(moving)
    if not moving:
        raise InputError("no column is a coordinate yet; mark the columns of positions or angles")
    times = {column: role for column, role in roles.items() if role in TIMES}
    if not times:
        raise InputError("no column is the time yet; mark the column of times")
    if len(times) > 1:
        first, second = list(times)[:2]
        raise InputError(f"{first!r} and {second!r} are both marked as time; choose one")
    ((time, time_role),) = times.items()
    time_unit, table = TIMES[time_role], peek(path if isinstance(path, Path) else path[0])
    if time_role == TIME and table.unit(time, time=True) is None and not table.dated(time):
        time_unit = None  # seconds, unless the file gives a unit
    forces = _belonging(roles, FORCE, names)
    # these roles override the units in the file
    turning = [column for column in moving if roles[column] != COORDINATE]
    units = {column: "deg" if roles[column] == DEGREES else "rad" for column in turning}
    data = la.read(
        path,
        {names[column]: column for column in moving},
        time=time,
        forces=forces or None,
        velocities=_belonging(roles, VELOCITY, names) or None,
        accelerations=_belonging(roles, ACCELERATION, names) or None,
        trial=_only(roles, TRIAL),
        time_unit=time_unit,
        units=units,
    )
    angles = [names[column] for column in turning]
    return data.unwrap(angles) if angles else data


def _belonging(roles: Mapping[str, str], kind: str, names: Mapping[str, str]) -> dict[str, str]:
    """Coordinate -> the column that is its force, or its velocity or acceleration."""
    found: dict[str, str] = {}
    for column, role in roles.items():
        if role.startswith(kind):
            target = role.removeprefix(kind)
            if target not in names.values():
                raise InputError(f"{column!r} is the {kind}{target!r}, which is not a coordinate any more")
            if target in found:
                raise InputError(f"two columns are the {kind}{target!r}; choose one")
            found[target] = column
    return found


def _only(roles: Mapping[str, str], role: str) -> str | None:
    found = [column for column, given in roles.items() if given == role]
    if len(found) > 1:
        raise InputError(f"{found[0]!r} and {found[1]!r} are both marked as {role}; choose one")
    return found[0] if found else None


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _word(column: str) -> str:
    return re.sub(r"\W+", "_", unicodedata.normalize("NFKC", column).strip().lower()).strip("_")


def _time_role(columns: Columns, column: str) -> str:
    if columns.dated(column):
        return DATES
    unit = columns.unit(column, time=True)
    return next((role for role, text in TIMES.items() if unit is not None and text == unit), TIME)


def _guess_time(columns: Columns) -> str | None:
    named = [c for c in columns.header if {_word(c), _word(parted(c, time=True)[0])} & TIME_NAMES]
    named += [c for c in columns.header if columns.dated(c) and c not in named]
    named += [c for c in columns.header if _word(c).startswith(("time", "t_")) and c not in named]
    rising = [c for c in columns.header if _rises(columns.numbers(c)) and _word(c) not in _IGNORED]
    return next(iter([*named, *rising[:1]]), None)


def _rises(values: np.ndarray | None) -> bool:
    return values is not None and values.size > 2 and bool((np.diff(values) > 0).all())


def _is_rate(word: str, unit: str | None) -> bool:
    return (
        word.endswith(_RATES) or word.startswith(_RATE_STARTS) or (unit or "").endswith(("/s", "/s2", "rpm"))
    )


def _is_force(word: str) -> bool:
    return bool(_EFFORTS & {*re.split(r"[\d_]+", word)}) or re.sub(r"[\d_].*$", "", word) in _FORCES


def _driven(column: str, moving: Sequence[str], place: int) -> str | None:
    """The probable coordinate of a force column: by name, by number, by position."""
    word = _word(column)
    by_name = [
        c for c in moving if len(_word(c)) > 0 and re.search(rf"(^|_){re.escape(_word(c))}(_|$)", word)
    ]
    if by_name:
        return by_name[0]
    number = re.search(r"\d+", word)
    if number and any(re.search(r"\d", _word(c)) for c in moving):
        same = [c for c in moving if re.findall(r"\d+", _word(c))[:1] == [number[0]]]
        return same[0] if same else None
    return moving[place] if place < len(moving) else None
