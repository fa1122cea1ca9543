"""Input of the candidates page, checked while it is typed, and the task made from it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

from leastaction.cli.values import check_known, known_coefficients, name_list, number, pairs
from leastaction.errors import InputError
from leastaction.identifiers import check_coordinate_names

if TYPE_CHECKING:
    from leastaction import Library, Trajectories

__all__ = ["FAMILIES", "Choice", "Task", "faults", "friction_choices", "shown_names", "split_trials"]

_MOST_LINES = 1500

FAMILIES = (
    ("Stribeck: dry friction that is larger near rest", "stribeck"),
    ("quadratic, as drag", "quadratic"),
    ("dry, growing with the load", "load"),
    ("different in the two directions", "asymmetric"),
)
"""Families of friction with more than one term for each joint: descriptions and names."""


@dataclass
class Choice:
    """The state of the page.

    Attributes
    ----------
    written : bool
        Whether the candidates are those of `text` instead of generated ones of `size`.
    size : str
        As for `leastaction.Library.mechanical`; "auto", the default, is the choice of `discover`.
    text, known, lengths, more_friction : str
        One expression a line; one "EXPR = VALUE" a line; one "COORDINATE = METRES" a line; more friction, one
        expression a line.
    friction, families : list of str
        Selected friction candidates, and selected families for all coordinates.
    gyroscopic : bool
        Whether generated candidates include terms linear in the velocities.
    delay : float
        Seconds by which the known forces act later than recorded.
    offsets, prescribed : list of str
        Selected coordinates: with an unknown constant force; moved by unmeasured forces.
    hidden : str
        Names of coordinates without a sensor, separated by commas.
    hidden_angles : bool
        Whether these are angles.
    held_out : int
        Number of trials that are forecast instead of fitted.
    every_third : bool
        Hold out every third trial instead, as the demonstration does.
    """

    written: bool = False
    size: str = "auto"
    gyroscopic: bool = False
    text: str = ""
    friction: list[str] = field(default_factory=list)
    more_friction: str = ""
    known: str = ""
    lengths: str = ""
    delay: float = 0.0
    offsets: list[str] = field(default_factory=list)
    prescribed: list[str] = field(default_factory=list)
    families: list[str] = field(default_factory=list)
    hidden: str = ""
    hidden_angles: bool = False
    held_out: int = 0
    every_third: bool = False

    @classmethod
    def default(cls, data: Trajectories) -> Choice:
        """Start with generated candidates, a known coefficient if no force acts, and some trials held out."""
        known = "" if data.driven else f"{data.coordinates[0]}_dot**2 = 1"
        return cls(known=known, held_out=len(data) // 3 or int(len(data) == 2))

    def unseen(self, coordinates: Sequence[str]) -> tuple[str, ...]:
        """Coordinates without a sensor, in addition to those of the data.

        Raises
        ------
        InputError
            If a name cannot be used, or is that of a column.
        """
        if not self.hidden.strip():
            return ()
        names = check_coordinate_names(name_list(self.hidden))
        for name in {*names} & {*coordinates}:
            raise InputError(f"{name} is measured; name only coordinates without a sensor")
        return names

    def library(self, coordinates: Sequence[str], angles: Iterable[str]) -> Library:
        """The candidates, including those with coordinates that have no sensor.

        Raises
        ------
        InputError
            Naming the line at fault.
        """
        import leastaction as la

        unseen = self.unseen(coordinates)
        coordinates, angles = (*coordinates, *unseen), [*angles, *(unseen if self.hidden_angles else ())]
        if self.written:
            bad = faults(self.text, coordinates)
            if bad:
                raise InputError(bad[0])
            library = la.Library(lines(self.text), coordinates, angles=angles)
        else:
            library = self.generated(coordinates, angles)
        friction = self.friction_terms(coordinates)
        return library.with_dissipation(friction) if friction else library

    def generated(self, coordinates: Sequence[str], angles: Iterable[str]) -> Library:
        """Candidates of L of the selected size."""
        import leastaction as la

        return la.Library.mechanical(coordinates, angles, size=self.size, gyroscopic=self.gyroscopic)

    def size_for(self, coordinates: Sequence[str], angles: Iterable[str]) -> str:
        """The selected size.

        Examples
        --------
        >>> Choice().size_for("abc", "abc"), Choice().size_for("abcd", "abcd")
        ('standard', 'chain')
        >>> Choice(size="large").size_for("a", [])
        'large'
        """
        from leastaction.library.families import choose_size

        if self.size != "auto":
            return self.size
        return choose_size(coordinates, list(angles), gyroscopic=self.gyroscopic)

    def sizes(self, coordinates: Sequence[str], angles: Iterable[str]) -> dict[str, int]:
        """Available sizes and their numbers of candidates; "chain" requires three angles."""
        import leastaction as la

        angles = list(angles)
        chain = self.size_for(coordinates, angles) == "chain" or len(angles) > 2
        return {
            size: la.Library.mechanical_size(coordinates, angles, size=size, gyroscopic=self.gyroscopic)
            for size in ("compact", *(["chain"] if chain else []), "standard", "large")
        }

    def friction_terms(self, coordinates: Sequence[str]) -> list[str]:
        """Selected and written friction candidates."""
        bad = faults(self.more_friction, coordinates)
        if bad:
            raise InputError(f"friction, {bad[0]}")
        offered = {text for _, text in friction_choices(coordinates)}
        families = [name for _, name in FAMILIES if name in self.families]
        return [text for text in self.friction if text in offered] + families + lines(self.more_friction)

    def known_terms(self, library: Library, driven: bool) -> dict[str, float]:
        """Known coefficients, each of a candidate.

        Raises
        ------
        InputError
            If a line cannot be read, its term is not a candidate, or the scale is missing.
        """
        known = known_coefficients(lines(self.known))
        check_known(known, library)
        if not known and not driven:
            raise InputError(
                "no force acts and no coefficient is known, so that L = 0 solves every equation; give one "
                f"coefficient, for example {library[0].text} = 1, which sets the scale of L"
            )
        return known

    def links(self, coordinates: Sequence[str]) -> dict[str, float]:
        """Lengths of links in metres.

        Raises
        ------
        InputError
            If a line cannot be read, or does not name a coordinate.

        Examples
        --------
        >>> Choice(lengths="theta = 0.3").links(["theta"])
        {'theta': 0.3}
        """
        from leastaction.model.gravity import checked_lengths

        given = pairs(lines(self.lengths), "COORDINATE = METRES, for example theta = 0.3")
        return checked_lengths({name: number(value) for name, value in given}, coordinates)

    def forces(self, data: Trajectories) -> Forces:
        """Assumptions on forces.

        Raises
        ------
        InputError
            If the delay leaves too little of a trial, a coordinate is selected twice or no equation is left.
        """
        offsets = tuple(name for name in data.coordinates if name in self.offsets)
        prescribed = tuple(name for name in data.coordinates if name in self.prescribed)
        both = [shown_names(offsets)[name] for name in offsets if name in prescribed]
        if both:
            raise InputError(
                f"{both[0]} is selected twice: with an unknown constant force, and as moved by unmeasured "
                "forces; select only one"
            )
        if len(prescribed) == len(data.coordinates):
            raise InputError(
                "no equation is left; at most all coordinates but one may move by unmeasured forces"
            )
        delay = self.delay if data.driven else 0.0
        shortest = min(run.duration for run in data)
        if abs(delay) >= 0.5 * shortest:
            raise InputError(f"a delay of {1e3 * delay:g} ms leaves too little of a trial of {shortest:g} s")
        return Forces(delay, offsets, prescribed)

    def task(self, data: Trajectories, angles: Iterable[str]) -> Task:
        """The arguments of a discovery."""
        library = self.library(data.coordinates, angles)
        fitted, held_out = split_trials(data, self.held_out, self.every_third)
        known, forces = self.known_terms(library, data.driven), self.forces(data)
        unseen, links = self.unseen(data.coordinates), self.links(library.coordinates)
        return Task(fitted, held_out, library, known, forces, unseen, links)


@dataclass(frozen=True)
class Forces:
    """Assumptions on known and unknown forces."""

    delay: float = 0.0
    offsets: tuple[str, ...] = ()
    prescribed: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Task:
    """A discovery that can be sent to another process."""

    fitted: Trajectories
    held_out: Trajectories | None
    library: Library
    known: dict[str, float]
    forces: Forces = Forces()
    hidden: tuple[str, ...] = ()
    lengths: dict[str, float] = field(default_factory=dict[str, float])
    relevance: float = 0.05

    def shifted(self) -> Task:
        """The task with the known forces shifted to the times at which they act."""
        from leastaction.delay import shift_forces

        if not self.forces.delay:
            return self
        parts = (self.fitted, self.held_out)
        fitted, held_out = (part and shift_forces(part, self.forces.delay) for part in parts)
        return replace(self, fitted=fitted, held_out=held_out, forces=replace(self.forces, delay=0.0))


def lines(text: str) -> list[str]:
    """The lines without comments, which start with ``#``, and without blank ones."""
    kept = (line.partition("#")[0].strip() for line in text.splitlines())
    return [line for line in kept if line]


def faults(text: str, coordinates: Sequence[str]) -> list[str]:
    r"""Messages of the parser for the lines that are not expressions.

    Examples
    --------
    >>> faults("x_dot**2\n\nsin(y)  # no such coordinate", ["x"])
    ["line 3: cannot read 'sin(y)' at column 5: unknown name 'y'; ..."]
    """
    everything = text.splitlines()
    if len(everything) > _MOST_LINES:
        return [f"there are {len(everything)} lines; give at most {_MOST_LINES} candidates"]
    found = []
    for place, line in enumerate(everything, start=1):
        line = line.partition("#")[0].strip()
        fault = _fault(line, tuple(coordinates)) if line else None
        if fault:
            found.append(f"line {place}: {fault}")
    return found


@lru_cache(maxsize=4096)
def _fault(line: str, coordinates: tuple[str, ...]) -> str | None:
    import leastaction as la

    try:
        la.Library([line], coordinates)
    except InputError as error:
        return str(error)
    return None


def friction_choices(
    coordinates: Sequence[str], written: Mapping[str, str] | None = None
) -> list[tuple[str, str]]:
    """Friction candidates for selection: description and ψ.

    Examples
    --------
    >>> friction_choices(["theta1"])
    [('viscous, θ₁', 'theta1_dot**2/2'), ('dry, θ₁', 'abs(theta1_dot)')]
    """
    shown = shown_names(coordinates, written)
    found = [(f"viscous, {shown[c]}", f"{c}_dot**2/2") for c in coordinates]
    found += [(f"dry, {shown[c]}", f"abs({c}_dot)") for c in coordinates]
    for a, b in pairwise(coordinates):
        found.append((f"viscous, {shown[a]} to {shown[b]}", f"({b}_dot-{a}_dot)**2/2"))
        found.append((f"dry, {shown[a]} to {shown[b]}", f"abs({b}_dot-{a}_dot)"))
    return found


def shown_names(coordinates: Sequence[str], written: Mapping[str, str] | None = None) -> dict[str, str]:
    """Coordinates as displayed; `written` has the names of columns that differ.

    Examples
    --------
    >>> shown_names(["theta1"])
    {'theta1': 'θ₁'}
    >>> shown_names(["Upper_arm"], {"Upper_arm": "Upper arm"})
    {'Upper_arm': 'Upper arm'}
    """
    from leastaction.model.mathml import Notation

    notation = Notation(coordinates, written=written or {})
    return {c: notation.text(c) for c in coordinates}


def split_trials(
    data: Trajectories, held_out: int, every_third: bool = False
) -> tuple[Trajectories, Trajectories | None]:
    """Trials to fit, and trials to forecast: the last ones, or every third."""
    if every_third and len(data) >= 3:
        names = list(data.names[2::3])
    else:
        count = min(max(int(held_out), 0), len(data) - 1)
        names = list(data.names[len(data) - count :]) if count else []
    if not names:
        return data, None
    return data.select([name for name in data.names if name not in names]), data.select(names)
