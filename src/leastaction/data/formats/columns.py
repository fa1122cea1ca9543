"""The columns of a file, by the names that the user gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from leastaction.data.formats.units import normal, parted
from leastaction.data.validation import close_match, listed
from leastaction.errors import InputError
from leastaction.identifiers import TIME, quoted

__all__ = ["TIME_NAMES", "Names"]

TIME_NAMES = frozenset(
    {"t", "time", "times", "timestamp", "seconds", "sec", "zeit", "time_s", "t_s", "time_sec", "temps"}
)
"""Common names of the column of times, in lower case."""


@dataclass(frozen=True)
class Names:
    """The columns of a file, by name.

    Attributes
    ----------
    source, kind : str
        For messages.
    present : dict
        Normalised name -> name in the file.
    """

    source: str
    kind: str
    present: dict[str, str]

    @classmethod
    def of(cls, available: Sequence[object], source: str, kind: str) -> Names:
        """The columns of a file; InputError if two have the same name."""
        present: dict[str, str] = {}
        for name in available:
            if isinstance(name, str) and name:
                if name in present.values():
                    raise InputError(
                        f"{source}: two {kind}s are called {quoted(name)}; give each its own name"
                    )
                present.setdefault(normal(name), name)
        return cls(source, kind, present)

    def where(self, role: str, name: str, *, time: bool) -> str:
        """The column of a name: the same text, another form of Unicode, or without its unit.

        The column of times may also have a common name, such as ``time`` or ``Zeit [s]``.
        """
        names = list(self.present.values())
        if name in names:
            return name
        if normal(name) in self.present:
            return self.present[normal(name)]
        parts = ((column, *parted(column, time)) for column in names)
        meant = [column for column, bare, unit in parts if unit and bare == normal(name)]
        if len(meant) == 1:
            return meant[0]
        if not meant and time and name == TIME:
            meant = [column for column in names if normal(parted(column, time)[0]).casefold() in TIME_NAMES]
            if len(meant) == 1:
                return meant[0]
        if meant:
            raise InputError(
                f"{self.source} has no {self.kind} {quoted(name)} ({role}), but {listed(meant)}; give one of "
                "these names in full"
            )
        there = (
            f"its {self.kind}s are {listed(names)}{close_match(name, names)}"
            if names
            else f"it has no named {self.kind}s"
        )
        cure = ""
        if time and names:
            cure = "; give the name of the column of times (time=...)"
        elif role == f"coordinate {name}" and names:
            others = [c for c in names if normal(parted(c, True)[0]).casefold() not in TIME_NAMES]
            meant = others if len(others) == 1 else ["COLUMN"]
            cure = f"; give its column: coordinates={{{name!r}: {meant[0]!r}}}"
        raise InputError(f"{self.source} has no {self.kind} {quoted(name)} ({role}); {there}{cure}")
