"""A problem: data, candidates, known coefficients and excluded candidates; and sets of its candidates.

The equations of motion are

    Σ_k λ_k E_i[φ_k] + Σ_k c_k ∂ψ_k/∂q̇_i = f_i      for every coordinate i that is not prescribed,

and a problem holds the candidates φ_k, ψ_k, the known coefficients, the excluded candidates, the data and the
known forces f.  It never changes; a step that adds information returns a new problem.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from leastaction.curve.knots import excerpt
from leastaction.data.trajectories import Trajectories
from leastaction.estimation.crew import Crew
from leastaction.estimation.forces import Between
from leastaction.estimation.sensors import Sensors
from leastaction.estimation.shape_ranges import ShapeRange
from leastaction.library import Dropped, Term, shape_names
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["Problem", "Structure"]


@dataclass(frozen=True, init=False)
class Structure:
    """A set of free candidates of one problem.

    Attributes
    ----------
    members : tuple of int
        Their indices among the candidates, in rising order. Known candidates belong to every structure and
        are not listed.

    Examples
    --------
    >>> Structure([4, 1]).members
    (1, 4)
    >>> Structure([4, 1]).without([4])
    Structure(members=(1,))
    """

    members: tuple[int, ...]

    def __init__(self, members: Iterable[int] = ()) -> None:
        object.__setattr__(self, "members", tuple(sorted(int(m) for m in members)))

    def __len__(self) -> int:
        return len(self.members)

    def __iter__(self) -> Iterator[int]:
        return iter(self.members)

    def __contains__(self, member: object) -> bool:
        return member in self.members

    def __le__(self, other: Structure) -> bool:
        """Whether every member is in the other structure, too."""
        return set(self.members) <= set(other.members)

    def without(self, members: Iterable[int]) -> Structure:
        """The structure with some members left out."""
        out = set(members)
        return Structure(m for m in self.members if m not in out)

    def with_(self, members: Iterable[int]) -> Structure:
        """The structure with further members."""
        return Structure({*self.members, *members})


@dataclass(frozen=True, eq=False)
class Problem:
    """Data, candidates, known coefficients and excluded candidates.

    Attributes
    ----------
    trajectories : Trajectories
        Measured coordinates (rad, m, …) and rates, known forces.
    candidates : EulerLagrange
        All candidates of L and of the dissipation function, as functions; they also hold the prescribed
        coordinates.
    known : (n_candidates,) array
        Known coefficients; NaN where a coefficient is free.
    degree : int
        Of the splines.
    excluded : frozenset of int
        Free candidates that no structure may contain, such as friction that would feed energy in.
    crew : Crew or None
        Workers; None is this thread. The result does not depend on them.
    ranges : mapping of str to ShapeRange
        Range in which each shape parameter is sought. The candidates hold the present values.
    lengths : (n_candidates,) array or None
        Description lengths of the candidates in nats; NaN for a candidate with the usual length, None if all
        have it.
    forms : tuple of Dropped
        Terms with a description length that are not candidates but sums of candidates, up to null terms.
    between : {"slow", "band-limited", "linear", "held"}
        Course of the known forces between their samples; ``"slow"``: only their slow part acts
        (:mod:`leastaction.estimation.forces`).
    hidden : tuple of int
        Coordinates without a single measured position.
    sensors : Sensors or None
        Measured columns that are functions of the coordinates. The fit uses these columns. The trajectories
        then hold start values of the coordinates, computed from the columns.
    angles : tuple of str
        Coordinates that the user calls angles.
    """

    trajectories: Trajectories
    candidates: EulerLagrange
    known: np.ndarray
    degree: int = 5
    excluded: frozenset[int] = frozenset()
    crew: Crew | None = None
    ranges: Mapping[str, ShapeRange] = field(default_factory=dict[str, ShapeRange])
    lengths: np.ndarray | None = None
    forms: tuple[Dropped, ...] = ()
    between: Between = "slow"
    hidden: tuple[int, ...] = ()
    sensors: Sensors | None = None
    angles: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = np.array(self.known, dtype=float)
        if known.shape != (len(self.candidates),):
            raise ValueError(f"{known.size} known coefficients for {len(self.candidates)} candidates")
        known.flags.writeable = False
        object.__setattr__(self, "known", known)

    @property
    def terms(self) -> tuple[Term, ...]:
        """The candidates."""
        return self.candidates.terms

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self.trajectories.coordinates

    @property
    def prescribed(self) -> tuple[int, ...]:
        """Coordinates whose equations are not used."""
        return self.candidates.prescribed

    @cached_property
    def pushed(self) -> tuple[int, ...]:
        """Coordinates on which a known force acts."""
        data = self.trajectories
        forces = [t.forces for t in data if t.forces is not None]
        return tuple(i for i in range(data.n_dof) if any(np.any(f[:, i]) for f in forces))

    @cached_property
    def is_known(self) -> np.ndarray:
        """(n_candidates,) truth values."""
        return ~np.isnan(self.known)

    @cached_property
    def free(self) -> np.ndarray:
        """Indices of the candidates that a structure may contain."""
        allowed = ~self.is_known
        allowed[list(self.excluded)] = False
        return np.flatnonzero(allowed)

    @cached_property
    def surcharges(self) -> np.ndarray:
        """(n_candidates,) penalty of each in a search beyond the usual log n + 2 log K, in units of χ²."""
        return np.zeros(self.known.size) if self.lengths is None else self.surcharges_of(self.lengths)

    def surcharges_of(self, lengths: Iterable[float | None]) -> np.ndarray:
        """2 (ℓ − log K) for terms of description length ℓ; 0 for NaN or None."""
        found = np.array([np.nan if length is None else length for length in lengths])
        return np.where(np.isnan(found), 0.0, 2.0 * (found - self._alike))

    @property
    def bits(self) -> np.ndarray:
        """(n_candidates,) description length of each in bits; NaN without description lengths."""
        if self.lengths is None:
            return np.full(self.known.size, np.nan)
        return np.where(np.isnan(self.lengths), self._alike, self.lengths) / np.log(2.0)

    @property
    def _alike(self) -> float:
        """Description length of a term without one of its own, in nats: log K for K candidates."""
        return float(np.log(max(np.count_nonzero(~self.is_known), 1)))

    @cached_property
    def shape_values(self) -> dict[str, float]:
        """The numbers of all shape parameters."""
        templates = (term.template for term in self.terms)
        return {name: value for t in templates if t is not None for name, value in t.values}

    def shapes_of(self, structure: Iterable[int]) -> tuple[str, ...]:
        """Names of the shape parameters in a structure and in known terms, sorted."""
        held = [self.terms[k] for k in (*structure, *np.flatnonzero(self.is_known).tolist())]
        return shape_names(held)

    def parameters_of(self, structure: Structure) -> int:
        """The number of free numbers in a structure: coefficients and shape parameters."""
        return len(structure) + len(self.shapes_of(structure))

    def unreached(self, structure: Iterable[int]) -> tuple[str, ...]:
        """Coordinates for which the scale of L is not identifiable in a structure.

        The equations of coordinates that terms couple, directly or through others, share one scale of L. It
        is identifiable if a known force acts on one of them, or a coefficient is known.
        """
        names = [n for i, n in enumerate(self.coordinates) if i not in self.prescribed]
        group = {name: name for name in names}
        fixed = {self.coordinates[i] for i in self.pushed}

        def root(name: str) -> str:
            return name if group[name] == name else root(group[name])

        known = np.flatnonzero(np.nan_to_num(self.known)).tolist()
        for k in (*structure, *known):
            symbols = {str(symbol) for symbol in self.terms[k].expr.free_symbols}
            own = [name for name in names if symbols & {name, f"{name}_dot"}]
            for name in own[1:]:
                group[root(name)] = root(own[0])
            fixed |= {*own} if k in known else set()
        reached = {root(name) for name in fixed if name in group}
        return tuple(name for name in names if root(name) not in reached)

    def at(self, values: Mapping[str, float]) -> Problem:
        """The problem with other values of some shape parameters."""
        if not values:
            return self
        return replace(self, candidates=self.candidates.of([term.at(values) for term in self.terms]))

    def stepped(self, steps: Mapping[str, float]) -> Problem:
        """The problem with some shape parameters moved; each stays within its range."""
        here = self.shape_values
        return self.at({name: self.ranges[name].stepped(here[name], step) for name, step in steps.items()})

    def completed(self, coefficients: np.ndarray | float) -> np.ndarray:
        """Coefficients of all candidates, or one for all, with known ones in place and excluded ones zero."""
        out = np.where(self.is_known, self.known, coefficients)
        out[list(self.excluded)] = 0.0
        return out

    def named(self, coefficients: np.ndarray) -> dict[str, float]:
        """Coefficients of all candidates by the texts of their terms; zeros are left out."""
        texts = [term.text for term in self.terms]
        return {k: v for k, v in zip(texts, coefficients.tolist(), strict=True) if v != 0.0}

    def excluding(self, members: Sequence[int]) -> Problem:
        """The problem without some of its candidates."""
        return replace(self, excluded=self.excluded | {int(m) for m in members})

    def allowing(self, members: Sequence[int]) -> Problem:
        """The problem with candidates that were excluded."""
        return replace(self, excluded=self.excluded - {int(m) for m in members})

    def releasing(self, member: int) -> Problem:
        """The problem with one known coefficient made free."""
        return replace(self, known=np.where(np.arange(self.known.size) == member, np.nan, self.known))

    def wider(self, terms: Sequence[Term]) -> Problem:
        """The problem with further candidates after the others."""
        more = np.full(len(terms), np.nan)
        lengths = None if self.lengths is None else np.append(self.lengths, more)
        candidates = self.candidates.of([*self.terms, *terms])
        return replace(self, candidates=candidates, known=np.append(self.known, more), lengths=lengths)

    def exchanged(self, forms: Mapping[int, Dropped]) -> Problem:
        """The problem with some candidates replaced by forms; the other forms are dropped."""
        terms, lengths = list(self.terms), np.full(self.known.size, np.nan)
        if self.lengths is not None:
            lengths[:] = self.lengths
        for k, form in forms.items():
            terms[k], lengths[k] = form.term, np.nan if form.length is None else form.length
        return replace(self, candidates=self.candidates.of(terms), lengths=lengths, forms=())

    def on(self, trajectories: Trajectories) -> Problem:
        """The same problem for other data."""
        return replace(self, trajectories=trajectories)

    def with_forces(self, forces: Sequence[np.ndarray | None]) -> Problem:
        """The problem with other known forces, (n_times, n_dof) in each trajectory."""
        return self.on(self.trajectories.with_forces(forces))

    def excerpt(self, n_samples: int) -> Problem:
        """The problem on pieces of its data, about ``n_samples`` in all."""
        pieces = excerpt(self.trajectories, n_samples)
        return self if pieces is self.trajectories else self.on(pieces)
