"""The columns of a file: by the names that the user gives, or by the names of common loggers of robots."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from leastaction.data.formats.units import normal, parted
from leastaction.data.validation import close_match, listed
from leastaction.errors import InputError
from leastaction.identifiers import TIME, quoted

__all__ = ["TIME_NAMES", "JointColumns", "Names", "joint_columns"]

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


_WORDS = {
    "torques": ("tau", "effort", "efforts", "torque", "torques"),
    "currents": ("current", "currents"),
    "velocities": ("dq", "qd", "qdot", "velocity", "velocities", "vel", "v"),
    "positions": ("q", "position", "positions", "pos", "angle", "theta"),
}
"""Words in names of columns, for each quantity; a name with words of two has the first."""
_OTHER = frozenset(
    {"d", "des", "desired", "target", "ref", "reference", "cmd", "command", "commanded", "goal", "setpoint"}
    | {"ext", "external", "hat", "tcp", "error", "err", "name"}
)
"""Words of columns that were not measured in a joint."""
_MEASURED = frozenset({"actual", "measured", "meas"})
_STAMPS = (("time",), ("rosbagtimestamp",), ("header", "stamp"), ("stamp",))
_EPOCH = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))  # dates since 1970 exceed these numbers


class JointColumns(NamedTuple):
    """The columns of a robot's log, by joint; as text, for a note.

    Attributes
    ----------
    time : str
    time_unit : str or None
        If the file does not say it, but numbers or neighbours do.
    positions, velocities, torques : dict of str to str
        Joint -> column; velocities and torques may be empty.
    currents : bool
        Whether the torques are motor currents.
    """

    time: str
    time_unit: str | None
    positions: dict[str, str]
    velocities: dict[str, str]
    torques: dict[str, str]
    currents: bool

    def __str__(self) -> str:
        kinds = [("position", self.positions), ("velocity", self.velocities)]
        kinds += [("current" if self.currents else "torque", self.torques)]
        parts = [f"time = {self.time}{f' in {self.time_unit}' if self.time_unit else ''}"]
        for joint in self.positions:
            own = [f"{word} {columns[joint]}" for word, columns in kinds if columns]
            parts.append(f"{joint} = {', '.join(own)}")
        return "; ".join(parts)


def joint_columns(
    header: Sequence[str], rows: Sequence[Sequence[str]], joints: Sequence[str], source: str
) -> JointColumns:
    """Find the columns of joints by the names that common loggers give them.

    Known are joint states of ROS (``/joint_states/position[0]``, ``joint1/position``,
    ``position.panda_joint1``), libfranka (``state.q[0]``, ``state.tau_J[0]``; times in ms), the RTDE of
    Universal Robots (``actual_q_0``, ``actual_current_0``), and plain names (``q1``, ``tau1``). Columns
    belong to a joint by its name, or else by their numbers, in the sequence of the joints; columns such as
    ``name[0]`` say which number is which joint. Targets and external torques are left out.

    Parameters
    ----------
    header, rows
        Names of the columns, and the first rows as text.
    joints : sequence of str
    source : str
        For messages.

    Raises
    ------
    InputError
        If there are no positions of the joints, or several.

    Examples
    --------
    >>> columns = joint_columns(
    ...     ["timestamp", "target_q_0", "actual_q_0", "actual_q_1", "actual_current_0", "actual_current_1"],
    ...     [["0.0"] * 6], ["shoulder", "elbow"], "log.csv")
    >>> columns.positions, columns.currents
    ({'shoulder': 'actual_q_0', 'elbow': 'actual_q_1'}, True)
    """
    named = {name: _tokens(name) for name in header}
    told = _told(header, rows, named)
    found = {kind: _of_kind(kind, named, joints, told, source) for kind in _WORDS}
    exact = {joint: name for joint in joints for name in header if named[name] == _tokens(joint)}
    positions = exact if len(exact) == len(joints) else found["positions"]
    if not positions:
        raise InputError(
            f"{source}: no columns seem to be the positions of the joints {listed(joints)}; its columns are "
            f"{listed(header)}; name the columns of coordinates and forces"
        )
    torques = found["torques"] or found["currents"]
    currents = bool(torques) and not found["torques"]
    return JointColumns(*_time(header, rows, named), positions, found["velocities"], torques, currents)


def _tokens(name: str) -> tuple[str, ...]:
    """Words and numbers of a name, in lower case: ``("tau", "j", "0")`` for ``tau_J[0]``."""
    split = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", normal(name))
    return tuple(str(int(t)) if t.isdigit() else t.lower() for t in re.findall(r"[A-Za-z]+|[0-9]+", split))


def _told(
    header: Sequence[str], rows: Sequence[Sequence[str]], named: Mapping[str, tuple[str, ...]]
) -> dict[str, tuple[str, ...]]:
    """Number -> words of its joint, from columns such as ``/joint_states/name[0]``."""
    pairs = zip(header, rows[0] if rows else (), strict=False)
    return {
        named[name][-1]: _tokens(cell)
        for name, cell in pairs
        if named[name][-2:-1] == ("name",) and named[name][-1].isdigit() and cell
    }


def _of_kind(
    kind: str,
    named: Mapping[str, tuple[str, ...]],
    joints: Sequence[str],
    told: Mapping[str, tuple[str, ...]],
    source: str,
) -> dict[str, str]:
    """Joint -> column of one quantity; empty if there is none."""
    groups: dict[tuple[str, ...], dict[str, str]] = {}
    for name, tokens in named.items():
        said = ((k, w) for k, words in _WORDS.items() for w in words if w in tokens)
        own, word = next(said, ("", ""))
        if own != kind or _OTHER & {*tokens}:
            continue
        place = tokens.index(word)
        stem, which = _parted_joint(tokens[:place] + tokens[place + 1 :], joints)
        if which:
            groups.setdefault((word, *stem), {})[which] = name
    whole = {
        stem: columns
        for stem, group in groups.items()
        if (columns := _by_joint(group, joints, told, source)) is not None
    }
    rank = {stem: (not _MEASURED & {*stem}, _WORDS[kind].index(stem[0])) for stem in whole}
    best = [columns for stem, columns in whole.items() if rank[stem] == min(rank.values())]
    if len(best) > 1:
        raise InputError(
            f"{source}: the {kind} of {joints[0]} may be {listed([c[joints[0]] for c in best])}; name the "
            "columns of coordinates, forces and velocities"
        )
    return best[0] if best else {}


def _parted_joint(tokens: tuple[str, ...], joints: Sequence[str]) -> tuple[tuple[str, ...], str]:
    """A name without its joint, or else without its last number; and the joint or the number."""
    for joint in sorted(joints, key=lambda j: -len(_tokens(j))):
        part = _tokens(joint)
        for k in range(len(tokens) - len(part) + 1):
            if tokens[k : k + len(part)] == part:
                return tokens[:k] + tokens[k + len(part) :], joint
    for k in reversed(range(len(tokens))):
        if tokens[k].isdigit():
            return (*tokens[:k], "#", *tokens[k + 1 :]), tokens[k]
    return tokens, ""


def _by_joint(
    group: Mapping[str, str], joints: Sequence[str], told: Mapping[str, tuple[str, ...]], source: str
) -> dict[str, str] | None:
    """Joint -> column, from joints or numbers; None if some are missing."""
    if not {*joints} - {*group}:
        return {joint: group[joint] for joint in joints}
    if {*joints} & {*group} or len(group) < len(joints):
        return None
    numbers = {words: number for number, words in told.items()}
    if numbers:
        unknown = [joint for joint in joints if _tokens(joint) not in numbers]
        if unknown:
            names = ["_".join(words) for words in told.values()]
            raise InputError(
                f"{source} has the joints {listed(names)}, and the arm {listed(joints)}; rename one of them"
            )
        places = [numbers[_tokens(joint)] for joint in joints]
    else:
        start = 0 if "0" in group else 1
        places = [str(start + k) for k in range(len(joints))]
    return {j: group[k] for j, k in zip(joints, places, strict=True)} if {*places} <= {*group} else None


def _time(
    header: Sequence[str], rows: Sequence[Sequence[str]], named: Mapping[str, tuple[str, ...]]
) -> tuple[str, str | None]:
    """The column of times and its unit, if the numbers show it; TIME is left to `Names.where`."""
    usual = [name for name in header if normal(parted(name, time=True)[0]).casefold() in TIME_NAMES]
    others = [name for stamp in _STAMPS for name in header if named[name][-len(stamp) :] == stamp]
    if not usual and not others:
        return TIME, None
    name = (usual or others)[0]
    if parted(name, time=True)[1] is not None:
        return name, None
    if any("success" in tokens and "rate" in tokens for tokens in named.values()):
        return name, "ms"  # libfranka
    try:
        first = abs(float(rows[0][list(header).index(name)])) if rows else 0.0
    except (ValueError, IndexError):
        return name, None
    return name, next((unit for least, unit in _EPOCH if first > least), None)
