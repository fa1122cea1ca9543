"""Words in the names of a robot's columns: the quantity and the joint of each column."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from leastaction.data.formats.units import normal
from leastaction.data.validation import listed
from leastaction.errors import InputError

__all__ = ["QUANTITIES", "columns_of", "tokens_of", "told_joints"]

QUANTITIES: dict[str, tuple[str, ...]] = {
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


def tokens_of(name: str) -> tuple[str, ...]:
    """Words and numbers of a name, in lower case: ``("tau", "j", "0")`` for ``tau_J[0]``."""
    split = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", normal(name))
    return tuple(str(int(t)) if t.isdigit() else t.lower() for t in re.findall(r"[A-Za-z]+|[0-9]+", split))


def told_joints(
    header: Sequence[str], rows: Sequence[Sequence[str]], named: Mapping[str, tuple[str, ...]]
) -> dict[str, tuple[str, ...]]:
    """Number -> words of its joint, from columns such as ``/joint_states/name[0]``."""
    pairs = zip(header, rows[0] if rows else (), strict=False)
    return {
        named[name][-1]: tokens_of(cell)
        for name, cell in pairs
        if named[name][-2:-1] == ("name",) and named[name][-1].isdigit() and cell
    }


def columns_of(
    kind: str,
    named: Mapping[str, tuple[str, ...]],
    joints: Sequence[str],
    told: Mapping[str, tuple[str, ...]],
    source: str,
) -> dict[str, str]:
    """Joint -> column of one quantity; empty if there is none."""
    groups: dict[tuple[str, ...], dict[str, str]] = {}
    for name, tokens in named.items():
        said = ((k, w) for k, words in QUANTITIES.items() for w in words if w in tokens)
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
    rank = {stem: (not _MEASURED & {*stem}, QUANTITIES[kind].index(stem[0])) for stem in whole}
    best = [columns for stem, columns in whole.items() if rank[stem] == min(rank.values())]
    if len(best) > 1:
        raise InputError(
            f"{source}: the {kind} of {joints[0]} may be {listed([c[joints[0]] for c in best])}; name the "
            "columns of coordinates, forces and velocities"
        )
    return best[0] if best else {}


def _parted_joint(tokens: tuple[str, ...], joints: Sequence[str]) -> tuple[tuple[str, ...], str]:
    """A name without its joint, or else without its last number; and the joint or the number."""
    for joint in sorted(joints, key=lambda j: -len(tokens_of(j))):
        part = tokens_of(joint)
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
        unknown = [joint for joint in joints if tokens_of(joint) not in numbers]
        if unknown:
            names = ["_".join(words) for words in told.values()]
            raise InputError(
                f"{source} has the joints {listed(names)}, and the arm {listed(joints)}; rename one of them"
            )
        places = [numbers[tokens_of(joint)] for joint in joints]
    else:
        if len(group) > len(joints):
            raise InputError(
                f"{source} has the {len(group)} columns {listed([*group.values()])} for the {len(joints)} "
                f"joints {listed(joints)}; describe the whole arm, or name the columns of these joints"
            )
        start = 0 if "0" in group else 1
        places = [str(start + k) for k in range(len(joints))]
    return {j: group[k] for j, k in zip(joints, places, strict=True)} if {*places} <= {*group} else None
