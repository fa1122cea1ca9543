"""Remedies for findings that one click applies, and the search that follows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from leastaction.app import columns
from leastaction.app.candidates import Choice, lines

if TYPE_CHECKING:
    from leastaction import Library
    from leastaction.app.session import Session
    from leastaction.findings import Finding

__all__ = ["Offer", "offers", "proposed", "take"]


@dataclass(frozen=True)
class Offer:
    """A button: its label, the new choices, and coordinates with a new role.

    `roles` maps coordinates to roles of their columns; a column of times is mapped by its own name.
    """

    words: str
    choice: Choice
    roles: Mapping[str, str] = field(default_factory=dict[str, str])


def offers(session: Session) -> list[Offer]:
    """Remedies for the findings on the model that is shown."""
    if session.task is None or session.data is None:
        return []
    findings = session.current.model.fit.findings
    every = (proposed(f, session.choice, session.task.library, session.data.driven) for f in findings)
    return list({offer.words: offer for some in every for offer in some}.values())


def take(session: Session, offer: Offer) -> None:
    """Search again with the new choices.

    Raises
    ------
    InputError
        If the table cannot be read with the new roles, or the choice is incomplete.
    """
    if offer.roles:
        named = {name: column for column, name in columns.coordinate_names(session.moving).items()}
        session.roles |= {named.get(name, name): role for name, role in offer.roles.items()}
        session.read()
    session.choice = offer.choice
    session.discover()


def proposed(finding: Finding, choice: Choice, library: Library, driven: bool = False) -> list[Offer]:
    """Remedies for a finding; none if the user has to decide.

    `library` has the candidates of that discovery; `driven`: known forces act.
    """
    found = list(_OFFERS[finding.code](finding, choice, library)) if finding.code in _OFFERS else []
    if finding.code == "wrong-known-coefficient":
        kept = [line for line in lines(choice.known) if _term(line) not in finding.subject]
        if (kept or driven) and len(kept) < len(lines(choice.known)):  # the scale of L must remain fixed
            words = f"Leave {', '.join(finding.subject)} free"
            found.append(Offer(words, replace(choice, known="\n".join(kept))))
    return found


def _term(line: str) -> str:
    return line.rpartition("=")[0].replace(" ", "")


def _add_terms(finding: Finding, choice: Choice, library: Library) -> Iterable[Offer]:
    family = finding.code in ("form-imitated", "simpler-form")
    lacking = finding.values.get("family") if family else finding.subject
    if isinstance(lacking, (list, tuple)) and lacking:
        new = [str(text) for text in lacking]
        pushed = finding.values.get("constant_force")
        offsets = [*choice.offsets, pushed] if isinstance(pushed, str) and pushed else choice.offsets
        text = "\n".join([*(term.text for term in library), *new])
        yield Offer(f"Add {', '.join(new)}", replace(choice, written=True, text=text, offsets=offsets))
    angles = finding.values.get("angles")
    if isinstance(angles, (list, tuple)) and angles:
        yield _as_angles([str(name) for name in angles], choice)


def _remove_terms(finding: Finding, choice: Choice, library: Library) -> Iterable[Offer]:
    kept = [term.text for term in library if term.text not in finding.subject]
    if kept and len(kept) < len(library):
        words = f"Remove {', '.join(finding.subject)} from the candidates"
        yield Offer(words, replace(choice, written=True, text="\n".join(kept)))


def _add_friction(finding: Finding, choice: Choice, library: Library) -> Iterable[Offer]:
    size, subject = finding.values.get("coefficient"), list(finding.subject)
    if isinstance(size, float) and size > 0.0:  # a negative one would supply energy
        more = "\n".join(filter(None, [choice.more_friction.strip(), *subject]))
        yield Offer(f"Add {', '.join(subject)} to the friction", replace(choice, more_friction=more))


def _hide(finding: Finding, choice: Choice, library: Library) -> Iterable[Offer]:
    name, terms, friction = (finding.values.get(key) for key in ("hidden", "terms", "friction"))
    if isinstance(name, str) and isinstance(terms, (list, tuple)):
        text = "\n".join([*(term.text for term in library), *map(str, terms)])
        more = "\n".join([choice.more_friction, *str(friction).split(", ")]).strip()
        part = replace(choice, hidden=name, written=True, text=text, more_friction=more)
        several = "parts" if ", " in name else "a part"
        yield Offer(f"Add {several} {name} without a sensor", part)


def _shift_forces(finding: Finding, choice: Choice, library: Library) -> Iterable[Offer]:
    delay = finding.values.get("delay")
    if isinstance(delay, float):
        later = choice.delay + delay
        yield Offer(f"Let the forces act {1e3 * later:.2g} ms later", replace(choice, delay=later))


def _as_angles(names: list[str], choice: Choice) -> Offer:
    return Offer(f"{', '.join(names)}: an angle", choice, dict.fromkeys(names, columns.ANGLE))


def _in_degrees(finding: Finding, choice: Choice, library: Library) -> Iterable[Offer]:
    names = list(finding.subject)
    yield Offer(f"{', '.join(names)}: in degrees", choice, dict.fromkeys(names, columns.DEGREES))


def _in_milliseconds(finding: Finding, choice: Choice, library: Library) -> Iterable[Offer]:
    column = finding.values.get("column")
    if isinstance(column, str):
        yield Offer("Times in ms", choice, {column: columns.MILLISECONDS})


def _move(finding: Finding, choice: Choice, library: Library) -> Iterable[Offer]:
    moved = [name for name in finding.subject if name not in choice.prescribed]
    if finding.values.get("may_be_prescribed") and not finding.values.get("cause_named") and moved:
        words = f"{', '.join(moved)}: moved by unmeasured forces"
        yield Offer(words, replace(choice, prescribed=[*choice.prescribed, *moved]))


_OFFERS: dict[str, Callable[[Finding, Choice, Library], Iterable[Offer]]] = {
    **dict.fromkeys(("missing-term", "time-dependent", "form-imitated", "simpler-form"), _add_terms),
    "slight-terms": _remove_terms,
    **dict.fromkeys(("unmodelled-friction", "slight-friction"), _add_friction),
    "unmeasured-part": _hide,
    **dict.fromkeys(("late-forces", "slight-delay"), _shift_forces),
    **dict.fromkeys(("perhaps-angle", "undeclared-angle"), lambda f, c, _: [_as_angles([*f.subject], c)]),
    "angle-in-degrees": _in_degrees,
    "long-time-step": _in_milliseconds,
    "equations-off": _move,
}
