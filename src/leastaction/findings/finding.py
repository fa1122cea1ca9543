"""One result of a check: code, severity, subject and figures for programs; message and remedy for people.

`Message` holds the texts of one code, and `fill` writes figures into them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from string import Formatter
from typing import Any, Literal

from leastaction.errors import InputError
from leastaction.identifiers import quoted

__all__ = [
    "INEXACT",
    "SEVERITIES",
    "STATED",
    "TEXT",
    "UNDECIDED",
    "Audience",
    "Figures",
    "Finding",
    "Message",
    "Severity",
    "Status",
    "Text",
    "Value",
    "doubtful",
    "fill",
    "inexact",
    "status_of",
]

Severity = Literal["note", "warning"]
Status = Literal["ok", "usable", "doubtful"]
Audience = Literal["python", "command line", "page"]
Text = str | Callable[[dict[str, Any]], str]
Value = None | bool | int | float | str | tuple["Value", ...]

SEVERITIES: tuple[Severity, ...] = ("note", "warning")  # rising; a further level takes its place in this row
INEXACT = frozenset({"equations-off", "unmodelled-friction", "late-forces", "unmeasured-part"})
"""Codes of warnings that say how exactly the equations hold, which forecasts may bear."""
UNDECIDED = frozenset({"competing-structures"})
"""Codes of warnings that other structures explain the data as well. On a machine, these forecast as well."""
STATED = frozenset({"forecasts", "forecast-reach"})
"""Codes of notes that the statement on forecasts says in other words."""
TEXT = "text"  # the code of a sentence that nobody took apart: from a user, or from a file of schema 1
_CODE = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_ENTRIES = ("code", "severity", "subject", "values", "message", "remedy")


@dataclass(frozen=True, eq=False, repr=False)
class Figures(Mapping[str, Value]):
    """The figures of a finding: an immutable mapping that can be hashed, pickled and written as JSON.

    Examples
    --------
    >>> figures = Figures.of({"share": 0.25, "terms": ["x", "y"]})
    >>> figures["terms"], figures == {"share": 0.25, "terms": ("x", "y")}
    (('x', 'y'), True)
    """

    pairs: tuple[tuple[str, Value], ...] = ()

    @classmethod
    def of(cls, values: Mapping[str, Any], place: str = "values") -> Figures:
        """Check the values; lists become tuples, NumPy's numbers plain ones, and what is not finite None.

        Raises
        ------
        InputError
            If a key is no text, or a value nothing that JSON can hold.
        """
        if isinstance(values, Figures):
            return values
        if not isinstance(values, Mapping):
            raise InputError(f"{place} is {quoted(values)}; expected a mapping of names to numbers and texts")
        for key in values:
            if not isinstance(key, str):
                raise InputError(f"{place} has the key {quoted(key)}; expected text")
        return cls(tuple((str(k), _plain(v, f"{place}.{k[:40]}")) for k, v in values.items()))

    def __getitem__(self, key: str) -> Value:
        for name, value in self.pairs:
            if name == key:
                return value
        raise KeyError(key)

    def __iter__(self) -> Iterator[str]:
        return (name for name, _ in self.pairs)

    def __len__(self) -> int:
        return len(self.pairs)

    def __hash__(self) -> int:
        return hash(frozenset(self.pairs))

    def __repr__(self) -> str:
        return repr(dict(self.pairs))


def _plain(value: Any, place: str, nested: bool = False) -> Value:
    if hasattr(value, "tolist"):  # NumPy's scalars and arrays
        value = value.tolist()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (list, tuple)) and not nested:
        return tuple(_plain(item, f"{place}[{i}]", nested=True) for i, item in enumerate(value))
    raise InputError(f"{place} is {quoted(value)}; expected a number, text, or a list of these")


@dataclass(frozen=True)
class Finding:
    """The result of a check.

    Parameters
    ----------
    code : str
        Names the kind of finding, in kebab case, e.g. ``"missing-term"``. Codes keep their meaning from one
        version to the next; :doc:`/report` lists them.
    severity : {"warning", "note"}
        A warning makes the model doubtful, or usable if it only says how exactly the equations hold and
        simulations follow the data. A note changes nothing.
    subject : tuple of str
        The coordinates or terms concerned; empty: the fit as a whole.
    values : mapping of str to number, str or tuple
        The figures.
    message : str
        What is wrong, or worth knowing.
    remedy : str
        What to do about it; may be empty.

    Raises
    ------
    InputError
        If an entry is of the wrong type or form.

    Examples
    --------
    >>> finding = Finding("hardly-moves", "warning", ("x",), {"size": 0.1}, "x hardly moves", "move it more")
    >>> str(finding), finding.values["size"]
    ('x hardly moves: move it more', 0.1)
    """

    code: str
    severity: Severity
    subject: tuple[str, ...] = ()
    values: Mapping[str, Value] = field(default_factory=Figures)
    message: str = ""
    remedy: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.code, str) or not _CODE.fullmatch(self.code):
            raise InputError(f"the code is {quoted(self.code)}; expected words in small letters, as in 'a-b'")
        if self.severity not in SEVERITIES:
            expected = " or ".join(map(repr, SEVERITIES))
            raise InputError(f"the severity is {quoted(self.severity)}; expected {expected}")
        if isinstance(self.subject, (str, bytes)) or not isinstance(self.subject, Iterable):
            raise InputError(f"the subject is {quoted(self.subject)}; expected a sequence of texts")
        subject = tuple(self.subject)
        parts = [(f"subject[{i}]", text) for i, text in enumerate(subject)]
        for name, text in (*parts, ("message", self.message), ("remedy", self.remedy)):
            if not isinstance(text, str):
                raise InputError(f"{name} is {quoted(text)}; expected text")
        object.__setattr__(self, "subject", tuple(str(text) for text in subject))
        object.__setattr__(self, "values", Figures.of(self.values))
        object.__setattr__(self, "message", str(self.message))
        object.__setattr__(self, "remedy", str(self.remedy))

    @classmethod
    def of_text(cls, text: str, severity: Severity = "warning") -> Finding:
        """Create a finding from a sentence without code and figures.

        Examples
        --------
        >>> Finding.of_text("the shaft is bent").code
        'text'
        """
        return cls(TEXT, severity, message=text)

    def __str__(self) -> str:
        return f"{self.message}: {self.remedy}" if self.remedy else self.message

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as JSON types.

        Examples
        --------
        >>> Finding.of_text("the shaft is bent", "note").to_dict()["severity"]
        'note'
        """
        values = {k: list(v) if isinstance(v, tuple) else v for k, v in self.values.items()}
        return {
            "code": self.code,
            "severity": self.severity,
            "subject": list(self.subject),
            "values": values,
            "message": self.message,
            "remedy": self.remedy,
        }

    @classmethod
    def from_dict(cls, value: Any, place: str = "finding") -> Finding:
        """Create a finding from the output of `to_dict`.

        Raises
        ------
        InputError
            If an entry is missing, unknown or of the wrong type; the text names the place.

        Examples
        --------
        >>> finding = Finding.of_text("the shaft is bent")
        >>> Finding.from_dict(finding.to_dict()) == finding
        True
        """
        if not isinstance(value, Mapping):
            raise InputError(f"{place} is {quoted(value)}; expected an object with {', '.join(_ENTRIES)}")
        for name in _ENTRIES:
            if name not in value:
                raise InputError(f"{place} has no entry {name!r}; the file may be cut short")
        for name in value:
            if name not in _ENTRIES:
                raise InputError(
                    f"{place} has the unknown entry {quoted(name)}; expected {', '.join(_ENTRIES)}"
                )
        if not isinstance(value["subject"], (list, tuple)):
            raise InputError(f"{place}.subject is {quoted(value['subject'])}; expected a list")
        try:
            return cls(**value)
        except InputError as problem:
            raise InputError(f"{place}: {problem}") from None


def doubtful(findings: Iterable[Finding]) -> bool:
    """Whether any finding is a warning."""
    return any(finding.severity == "warning" for finding in findings)


def inexact(findings: Iterable[Finding]) -> bool:
    """Whether the equations hold only to a few per cent, and at most the structure is doubtful besides."""
    codes = {finding.code for finding in findings if finding.severity == "warning"}
    return bool(codes & INEXACT) and codes <= INEXACT | UNDECIDED


def status_of(findings: Iterable[Finding]) -> Status:
    """Return what findings leave of a result.

    ``"ok"``: nothing is doubtful. ``"usable"``: the equations hold only to a few per cent, nothing else is
    doubtful but that other structures explain the data as well, and free runs follow the data (the finding
    ``forecasts``). ``"doubtful"``: all else.

    Examples
    --------
    >>> from leastaction.findings import find
    >>> late = find("late-forces", delay=0.03, half_a_sample=False, gain=90.0)
    >>> status_of([]), status_of([late]), status_of([late, find("forecasts", horizon=0.5, error=0.04)])
    ('ok', 'doubtful', 'usable')
    """
    found = tuple(findings)
    if not doubtful(found):
        return "ok"
    followed = any(finding.code == "forecasts" for finding in found)
    return "usable" if followed and inexact(found) else "doubtful"


@dataclass(frozen=True)
class Message:
    """The severity and the texts of one code.

    Attributes
    ----------
    severity : Severity
    message, remedy : str or callable
        The statement, and what to do about it in Python.
    on_command_line, on_page : str or callable
        What to do about it on the command line or in the app, if that differs from `remedy`.
    """

    severity: Severity
    message: Text
    remedy: Text = ""
    on_command_line: Text = ""
    on_page: Text = ""


class _Template(Formatter):
    """``str.format`` that joins lists with commas and writes fractions in per cent: ``{share:.1f%}``."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, (list, tuple)):
            return ", ".join(str(item) for item in value)
        if format_spec.endswith("%"):
            if not math.isfinite(value):
                return "an unknown share"
            if abs(value) >= 1.0:  # never 2e+02 %
                format_spec = ".0f%"
            return f"{format(100.0 * value, format_spec[:-1])} %"
        return super().format_field(value, format_spec)


def fill(text: Text, fields: Mapping[str, Any]) -> str:
    """A text with its fields filled in."""
    return text(dict(fields)) if callable(text) else _Template().vformat(text, (), fields)
