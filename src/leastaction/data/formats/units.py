"""Units in headers or in a row of units, and times as dates.

A unit is recognised in brackets, after a slash, or at the end of a name (``time_ms``), if it is unambiguous.
``x_cm`` may be a centre of mass and ``theta_min`` a minimum; such names are not changed.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime

import numpy as np

from leastaction.data.validation import FloatArray
from leastaction.errors import InputError
from leastaction.identifiers import quoted

__all__ = [
    "Clock",
    "Unit",
    "is_units_row",
    "known_unit",
    "normal",
    "parted",
    "parts_of_date",
    "time_unit_of",
    "unit_in_file",
    "unit_of",
]


@dataclass(frozen=True)
class Unit:
    """A unit and its conversion to SI: values × ``times`` / ``over``.

    Attributes
    ----------
    text : str
        Canonical symbol, e.g. ``"ms"``.
    kind : str
        Quantity: ``"time"``, ``"angle"``, ``"length"``, ``"force"``, ``"torque"``, or a rate, such as
        ``"angle/s"``.
    si : str
        The SI unit.
    times, over : float
        Two numbers, because 5 ms / 1000 is exactly 0.005 s, which 5 × 0.001 need not be.
    """

    text: str
    kind: str
    si: str
    times: float = 1.0
    over: float = 1.0

    @property
    def plain(self) -> bool:
        """Whether it is the unit of SI already."""
        return self.times == self.over

    def convert(self, values: FloatArray) -> FloatArray:
        """Values in SI; overflow gives infinity, which is refused like any other infinite value."""
        with np.errstate(over="ignore"):
            return values * self.times / self.over


_DEGREE = math.pi / 180.0
_BASE = {
    "time": {
        "s": (1.0, 1.0, "s sec secs second seconds sek sekunden"),
        "ms": (1.0, 1e3, "ms msec msecs millis millisecond milliseconds"),
        "us": (1.0, 1e6, "us µs usec usecs micros microsecond microseconds"),
        "ns": (1.0, 1e9, "ns nsec nanosecond nanoseconds"),
        "min": (60.0, 1.0, "min mins minute minutes"),
        "h": (3600.0, 1.0, "h hr hour hours"),
    },
    "angle": {
        "rad": (1.0, 1.0, "rad rads radian radians"),
        "mrad": (1.0, 1e3, "mrad milliradian milliradians"),
        "deg": (_DEGREE, 1.0, "deg degs degree degrees °"),
        "rev": (2.0 * math.pi, 1.0, "rev revs revolution revolutions"),
    },
    "length": {
        "m": (1.0, 1.0, "m meter meters metre metres"),
        "cm": (1.0, 1e2, "cm centimeter centimeters centimetre centimetres"),
        "mm": (1.0, 1e3, "mm millimeter millimeters millimetre millimetres"),
        "um": (1.0, 1e6, "um µm micrometer micrometers micrometre micrometres"),
    },
    "force": {
        "N": (1.0, 1.0, "N newton newtons"),
        "mN": (1.0, 1e3, "mN"),
        "kN": (1e3, 1.0, "kN"),
    },
    "torque": {
        "Nm": (1.0, 1.0, "Nm NM newtonmeter newtonmetre newtonmeters newtonmetres"),
        "mNm": (1.0, 1e3, "mNm"),
        "Nmm": (1.0, 1e3, "Nmm"),
        "Ncm": (1.0, 1e2, "Ncm"),
        "kNm": (1e3, 1.0, "kNm"),
    },
}
_SI = {"time": "s", "angle": "rad", "length": "m", "force": "N", "torque": "N m"}
_PER_SECOND = {"s": 1, "sec": 1, "second": 1, "s2": 2, "ss": 2, "sec2": 2}


def _table() -> dict[str, Unit]:
    units: dict[str, Unit] = {}
    for kind, own in _BASE.items():
        for text, (times, over, spellings) in own.items():
            for spelling in spellings.split():
                units[_plainly(spelling)] = Unit(text, kind, _SI[kind], times, over)
    units["rpm"] = Unit("rpm", "angle/s", "rad/s", 2.0 * math.pi, 60.0)
    units["dps"] = Unit("deg/s", "angle/s", "rad/s", _DEGREE)
    return units


def _plainly(text: str) -> str:
    """A unit in normal form, without spaces, dots and powers."""
    text = unicodedata.normalize("NFKC", text.replace("º", "°")).strip()
    text = re.sub(r"(?<=[^\W\d])\s*[·*.⋅]?\s*s\s*\^?[-−]([12])$", r"/s\1", text).replace("/s1", "/s")
    return re.sub(r"\*\*|[\s·⋅*.^_()-]", "", text)


_UNITS = _table()
_LONGEST = 200  # characters of a name: the time of the search for a unit grows with their square
_TIMES = ", ".join(_BASE["time"])
# after an underscore or a space; without units that are also a letter or a word of mechanics
_ENDINGS = frozenset({"rad", "mrad", "deg", "mm", "Nm", "mNm", "Nmm", "rpm", "deg/s", "rad/s", "mm/s"})
_TIME_ENDINGS = frozenset({"s", "ms", "us", "ns", "min"})


def unit_of(text: str) -> Unit | None:
    """Return the unit that a text names, in brackets or not; None if there is none of the kind.

    Examples
    --------
    >>> [unit_of(text).text for text in ("ms", "[µs]", "Degrees", "°/s", "N·m", "rad s^-2")]
    ['ms', 'us', 'deg', 'deg/s', 'Nm', 'rad/s2']
    """
    text = text.strip()
    if len(text) > _LONGEST:
        return None
    if len(text) > 2 and text[0] + text[-1] in ("[]", "()", "{}", "<>"):
        text = text[1:-1]
    plain = _plainly(text)
    name, slash, below = plain.partition("/")
    unit = _UNITS.get(name) or (_UNITS.get(name.casefold()) if len(name) > 2 and name.isalpha() else None)
    if unit is None or not slash:
        return unit
    power = _PER_SECOND.get(below)
    if power is None or unit.kind not in ("angle", "length"):
        return None
    rate = "/s" if power == 1 else "/s2"
    return replace(unit, text=unit.text + rate, kind=unit.kind + rate, si=unit.si + rate)


def time_unit_of(text: object) -> Unit:
    """Return a unit of time by its name.

    Raises
    ------
    InputError
        If it is not a unit of time.

    Examples
    --------
    >>> time_unit_of("ms").over
    1000.0
    """
    unit = unit_of(text) if isinstance(text, str) else None
    if unit is None or unit.kind != "time":
        raise InputError(f"time_unit is {quoted(text)}; expected one of {_TIMES}")
    return unit


def normal(name: str) -> str:
    """A name in normal form, for comparison."""
    return unicodedata.normalize("NFKC", name).strip()


def parted(column: str, time: bool = False) -> tuple[str, Unit | None]:
    """Return the name of a column without its unit, and the unit.

    Parameters
    ----------
    column : str
    time : bool
        Whether it is the column of times: ``t_s`` is a time in seconds, but ``theta_s`` has no unit.

    Examples
    --------
    >>> for header in ("angle [deg]", "Winkel / °", "x in mm", "phi_deg", "x_cm", "u (left)"):
    ...     name, unit = parted(header)
    ...     print(name, "|", unit and unit.text)
    angle | deg
    Winkel | deg
    x | mm
    phi | deg
    x_cm | None
    u (left) | None
    >>> parted("time_ms", time=True)[0], parted("t/us", time=True)[1].text
    ('time', 'us')
    """
    text = normal(column.replace("º", "°"))
    if len(text) > _LONGEST:
        return text, None
    name, unit = _parted(text, time)
    # a coordinate is not a time, and a quotient of units (N/mm, counts/rev) is not a unit
    return (text, None) if unit and (unit.kind == "time") != time and not (time and name) else (name, unit)


def _parted(text: str, time: bool) -> tuple[str, Unit | None]:
    bracket = re.fullmatch(r"(.*?)[\s_/]*([\[({<][^\[\](){}<>]+[\])}>])", text)
    if bracket and (unit := unit_of(bracket[2])):
        return bracket[1], unit
    inside = re.fullmatch(r"(.+?)[\s_]+in[\s_]+(\S+)", text)
    if inside and (unit := unit_of(inside[2])):
        return inside[1], unit
    for place in (k for k, letter in enumerate(text) if letter == "/" and k):
        name, unit = text[:place], unit_of(text[place + 1 :])
        if unit and not unit_of(name) and (name[-1].isspace() or unit.text not in ("rev", "h")):
            return name.rstrip(), unit
    return _without_ending(text, time)


def _without_ending(text: str, time: bool) -> tuple[str, Unit | None]:
    """As `parted`, for a unit at the end of a name."""
    allowed = _TIME_ENDINGS if time else _ENDINGS
    words = re.split(r"[_ ]+", text)
    for count in (2, 1):
        if len(words) > count and words[0]:
            unit = unit_of("/".join(words[-count:]))
            if unit and unit.text in allowed:
                ending = r"[_ ]+[^_ ]+" * count
                return re.sub(f"{ending}$", "", text), unit
    unit = unit_of(text) if time and len(text) > 1 else None
    return (text, unit) if unit and unit.kind == "time" else (text, None)


def known_unit(name: object, text: object) -> Unit:
    """Return the unit that the user gives for a coordinate or column, or raise InputError."""
    if not isinstance(name, str):
        raise InputError(f"units names {quoted(name)}; expected the name of a coordinate or column")
    unit = unit_of(text) if isinstance(text, str) else None
    if unit is None:
        raise InputError(
            f"the unit of {quoted(name)} is {quoted(text)}, which is not known; expected one such as ms, "
            "deg, mm, N, N m or deg/s, or leave it out and convert the numbers yourself"
        )
    return unit


def unit_in_file(column: str, cell: str, time: bool, source: str, *, strict: bool) -> Unit | None:
    """Return the unit of a column by its name and by its cell in a row of units.

    Raises
    ------
    InputError
        If `strict` and the two differ, or times have a unit that is not a unit of time.
    """
    by_name, by_row = parted(column, time)[1], unit_of(cell)
    if by_row is not None and not time and by_row.kind == "time":
        by_row = None
    if strict and by_name is not None and by_row is not None and by_name != by_row:
        say = "time_unit" if time else "units"
        raise InputError(
            f"{source}: the column {quoted(column)} is in {by_name.text} by its name, but in {by_row.text} "
            f"by the row below the header; correct one of them, or give the unit with {say}"
        )
    unit = by_row or by_name
    if strict and unit is not None and time and unit.kind != "time":
        raise InputError(
            f"{source}: the column {quoted(column)} is in {unit.text}, which is not a unit of time; give "
            "another column, or its unit with time_unit"
        )
    return unit


def is_units_row(cells: Sequence[str]) -> bool:
    """Whether a row holds units: at least one is known, and no cell is a number or a date.

    Examples
    --------
    >>> is_units_row(["s", "[deg]", "", "V"]), is_units_row(["a", "0.1", "m"]), is_units_row(["-", "-"])
    (True, False, False)
    """
    # a pure number may have the unit 1
    return any(map(unit_of, cells)) and not any(re.match(r"[+-]?[.,]?\d", c) for c in cells if c != "1")


# --- dates ------------------------------------------------------------------------------------------

_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9}))?\s?(Z|[+-]\d\d(?::?\d\d)?)?)?", re.ASCII
)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def parts_of_date(value: object) -> tuple[int, bool]:
    """Return nanoseconds since 1970 of a date, and whether it has a time zone.

    Parameters
    ----------
    value : str, date or datetime
        A text in the form of ISO 8601, ``2024-05-01T12:00:00.25+02:00``; without a zone it counts as UTC.

    Raises
    ------
    ValueError
        If it is not a date.

    Examples
    --------
    >>> parts_of_date("1970-01-01 00:00:01.5"), parts_of_date("1970-01-01T01:00:00+01:00")
    ((1500000000, False), (0, True))
    """
    if isinstance(value, str):
        found = _DATE.fullmatch(value)
        if found is None:
            raise ValueError
        day, clock, fraction, zone = found.groups()
        zone = "" if zone is None else zone if zone == "Z" or len(zone) > 3 else f"{zone}:00"
        whole = datetime.fromisoformat(day + (f"T{clock}{zone}" if clock else ""))
        return _nanoseconds(whole) + int((fraction or "0").ljust(9, "0")), bool(zone)
    if isinstance(value, datetime):
        return _nanoseconds(value) + getattr(value, "nanosecond", 0), value.tzinfo is not None
    if isinstance(value, date):
        return _nanoseconds(datetime(value.year, value.month, value.day)), False
    raise ValueError


def _nanoseconds(moment: datetime) -> int:
    since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH
    return 1_000_000_000 * (86_400 * since.days + since.seconds) + 1000 * since.microseconds


@dataclass(frozen=True)
class Clock:
    """Converts the dates of a file to seconds from its first sample.

    Nanoseconds since 1970 exceed the precision of a float, so they are subtracted as integers.
    """

    origin: int
    zoned: bool

    @classmethod
    def of(cls, first: object) -> Clock | None:
        """The clock of a file by its first time; None if that is not a date."""
        try:
            return cls(*parts_of_date(first))
        except ValueError:
            return None

    def seconds(self, value: object) -> float:
        """Return the seconds of a date since the first sample.

        Raises
        ------
        ValueError
            If it is not a date, or if only one of it and the first date has a time zone.
        """
        moment, zoned = parts_of_date(value)
        if zoned != self.zoned:
            raise ValueError
        return (moment - self.origin) / 1e9
