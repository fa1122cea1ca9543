"""Groups of trials whose laws differ in some coefficients: a payload, a temperature, other springs.

    λ_k in group g = λ_k + δ_kg,      δ_k0 = 0 in the first group.

δ_kg is the coefficient of one more column of the joint problem: the column of term k along the trials of
group g, and zero along all others.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from leastaction.data.trajectories import Trajectories
from leastaction.data.validation import listed
from leastaction.errors import InputError
from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Problem
from leastaction.identifiers import quoted
from leastaction.kinds import is_mapping
from leastaction.library import Term
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

__all__ = ["GroupTerm", "GroupedColumns", "Grouping", "group_labels", "grouped", "laws"]

_ONE_EACH = "give one for each trajectory, e.g. groups=['empty', 'empty', 'payload']"


@dataclass(frozen=True)
class Grouping:
    """Assignment of trials to groups.

    Attributes
    ----------
    names : tuple of str
        Of the groups, in the sequence of their first trials. All others are compared with the first group.
    places : tuple of int
        Index of the group of each trajectory.

    Examples
    --------
    >>> from leastaction import Trajectory
    >>> runs = Trajectories([Trajectory([0.0, 1.0], [0.1, 0.2], name=name) for name in "abc"])
    >>> Grouping.of(["empty", "payload", "empty"], runs)
    Grouping(names=('empty', 'payload'), places=(0, 1, 0))
    """

    names: tuple[str, ...]
    places: tuple[int, ...]

    @classmethod
    def of(cls, given: Mapping[str, object] | Iterable[object], trajectories: Trajectories) -> Grouping:
        """Check groups, one for each trajectory in a row, or by the trajectories' names.

        Raises
        ------
        InputError
            If a trajectory has none, a name is not that of a trajectory, or there is only one group.
        """
        labels = group_labels(given, trajectories)
        names = tuple(dict.fromkeys(labels))
        if len({*names}) < 2:
            raise InputError(
                f"every trajectory is in the group {quoted(names[0])}; give at least two groups, or leave "
                "groups out"
            )
        return cls(names, tuple(names.index(label) for label in labels))

    def members(self, group: int) -> list[int]:
        """The trajectories of a group."""
        return [n for n, place in enumerate(self.places) if place == group]


def group_labels(
    given: Mapping[str, object] | Iterable[object], trajectories: Trajectories
) -> tuple[str, ...]:
    """The name of the group of each trajectory, from a sequence or a mapping by name.

    Raises
    ------
    InputError
        If a trajectory has none, or a name is not that of a trajectory.

    Examples
    --------
    >>> from leastaction import Trajectory
    >>> runs = Trajectories([Trajectory([0.0, 1.0], [0.1, 0.2], name=name) for name in "ab"])
    >>> group_labels({"b": "payload", "a": "empty"}, runs)
    ('empty', 'payload')
    """
    labels = _by_name(given, trajectories.names) if is_mapping(given) else _in_a_row(given)
    if len(labels) != len(trajectories):
        raise InputError(
            f"groups has {len(labels)} entries, but there are {len(trajectories)} trajectories; {_ONE_EACH}"
        )
    return tuple(labels)


def _in_a_row(given: object) -> list[str]:
    if isinstance(given, (str, bytes)) or not isinstance(given, Iterable):
        raise InputError(f"groups is {quoted(given)}; {_ONE_EACH}")
    return [_label(item) for item in cast("Iterable[object]", given)]


def _by_name(given: Mapping[Any, object], names: Sequence[str]) -> list[str]:
    for name in given:
        if name not in names:
            raise InputError(
                f"groups names {quoted(name)}, which is not a trajectory; they are {listed(names)}"
            )
    lacking = [name for name in names if name not in given]
    if lacking:
        raise InputError(f"groups has no entry for the trajectory {quoted(lacking[0])}; give it one")
    return [_label(given[name]) for name in names]


def _label(value: object) -> str:
    text = str(value).strip()
    if value is None or not text:
        raise InputError("the name of a group is empty; give every trajectory a group")
    return text


@dataclass(frozen=True)
class GroupTerm(Term):
    """A term that acts in the trials of one group alone; make one by :meth:`of`.

    Attributes
    ----------
    group : int
        Number of the group.
    """

    group: int = 0
    whole: Term = field(default=None, compare=False, repr=False)  # type: ignore[assignment]

    @property
    def offered(self) -> str:
        """See :attr:`Term.offered`; with the name of the group."""
        return self.whole.offered + self.text.removeprefix(self.whole.text)

    @classmethod
    def of(cls, term: Term, group: int, name: str) -> GroupTerm:
        """A term in a group of that number and name."""
        return cls(f"{term.text} in {name}", term.expr, term.kind, term.template, group, term)


def _whole(term: Term) -> Term:
    return term.whole if isinstance(term, GroupTerm) else term


class GroupedColumns(EulerLagrange):
    """Columns, of which those of a `GroupTerm` act in one group of trials alone.

    They can be evaluated only along the motion, where the trial of each point is known.

    Parameters
    ----------
    terms, coordinates, prescribed
        As of `EulerLagrange`.
    names : sequence of str
        Of the groups.
    labels : (n_intervals,) array
        The group of each knot interval, by number.
    """

    grouped = True

    def __init__(
        self,
        terms: Sequence[Term],
        coordinates: Sequence[str],
        prescribed: Sequence[int],
        names: Sequence[str],
        labels: np.ndarray,
    ) -> None:
        super().__init__([_whole(term) for term in terms], coordinates, prescribed)
        self.terms: tuple[Term, ...] = tuple(terms)
        self.names: tuple[str, ...] = tuple(names)
        self.labels: np.ndarray = labels

    @cached_property
    def _groups(self) -> list[int | None]:
        """The group of each column; None: it acts in all groups."""
        return [term.group if isinstance(term, GroupTerm) else None for term in self.terms]

    def _group_at(self, points: Points) -> np.ndarray:
        """(n_points,) the group of each point."""
        if points.intervals is None:
            raise ValueError("groups of trials are known along a motion only")
        here = self.labels[points.intervals]
        return np.tile(here, points.n_points // max(here.size, 1))

    def strong(self, points: Points, select: Sequence[int] | None = None) -> np.ndarray:
        chosen = list(range(len(self)) if select is None else select)
        first: dict[Term, int] = {}  # each term is evaluated once
        for k in chosen:
            first.setdefault(_whole(self.terms[k]), k)
        values = super().strong(points, list(first.values()))
        row = {term: n for n, term in enumerate(first)}
        groups = [self._groups[k] for k in chosen]
        if all(group is None for group in groups):
            return values
        out = values[[row[_whole(self.terms[k])] for k in chosen]]
        at = self._group_at(points)
        for n, group in enumerate(groups):
            if group is not None:
                out[n][:, at != group] = 0.0
        return out

    def jacobian(self, points: Points, coefficients: np.ndarray) -> dict[tuple[int, int, int], np.ndarray]:
        out: dict[tuple[int, ...], Any] = {}
        for k, size in self._sizes(points, coefficients):
            for key, value in self._columns[k].get("jacobian")(points):
                if key[1] not in self.prescribed:
                    out[key] = out.get(key, 0.0) + size * value
        return out  # type: ignore[return-value]

    def mass_matrix(self, points: Points, coefficients: np.ndarray) -> np.ndarray:
        out = np.zeros((self.n_dof, self.n_dof, points.n_points))
        for k, size in self._sizes(points, coefficients):
            for (i, j), value in self._columns[k].get("mass")(points):
                out[i, j] += size * value
        out[self.prescribed, :] = out[:, self.prescribed] = 0.0
        out[self.prescribed, self.prescribed] = 1.0
        return np.ascontiguousarray(out.transpose(2, 0, 1))

    def _sizes(self, points: Points, coefficients: np.ndarray) -> Iterator[tuple[int, Any]]:
        """Columns of terms that differ, with the coefficient at all points or at each."""
        sizes: dict[Term, Any] = {}
        columns: dict[Term, int] = {}
        for k, (group, coefficient) in enumerate(zip(self._groups, coefficients.tolist(), strict=True)):
            if coefficient != 0.0:
                term = _whole(self.terms[k])
                here = coefficient
                if group is not None:
                    here = np.where(self._group_at(points) == group, coefficient, 0.0)
                sizes[term] = sizes.get(term, 0.0) + here
                columns.setdefault(term, k)
        return ((columns[term], size) for term, size in sizes.items())

    def mass_of(self, k: int, points: Points) -> np.ndarray:
        out, group = super().mass_of(k, points), self._groups[k]
        if group is not None:
            out[self._group_at(points) != group] = 0.0
        return out

    def masses(self, points: Points) -> tuple[list[int], np.ndarray]:
        moving, out = super().masses(points)
        for row, k in enumerate(moving):
            group = self._groups[k]
            if group is not None:
                out[self._group_at(points) != group, row] = 0.0
        return moving, out

    def weak(self, points: Points) -> np.ndarray:
        if any(group is not None for group in self._groups):
            raise ValueError("the weak form knows no groups of trials")
        return super().weak(points)

    def within(self, intervals: slice) -> EulerLagrange:
        return self._with(self.terms, self.labels[intervals])

    def of(self, terms: Sequence[Term], values: Sequence[Mapping[str, float]] | None = None) -> EulerLagrange:
        if values is not None:  # equal terms are evaluated once, so their numbers must distinguish them
            terms = [term.at(given) if given else term for term, given in zip(terms, values, strict=True)]
        return self._with(terms, self.labels)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.terms, self.coordinates, self.prescribed, self.names, self.labels)

    def _with(self, terms: Sequence[Term], labels: np.ndarray) -> GroupedColumns:
        return GroupedColumns(terms, self.coordinates, self.prescribed, self.names, labels)


def grouped(problem: Problem, grouping: Grouping, owner: np.ndarray, members: Iterable[int]) -> Problem:
    """A problem with further candidates: copies of some candidates for every group except the first.

    The copies follow the other candidates, group by group for each of ``members``.

    Parameters
    ----------
    problem : Problem
        If its last candidates are such copies already, they are replaced.
    grouping : Grouping
    owner : (n_intervals,) array
        The trajectory of each knot interval.
    members : iterable of int
        The candidates that may differ.
    """
    terms = [term for term in problem.terms if not isinstance(term, GroupTerm)]
    places = np.array(grouping.places, dtype=np.int16)
    columns = GroupedColumns(terms, problem.coordinates, problem.prescribed, grouping.names, places[owner])
    count = len(terms)
    lengths = None if problem.lengths is None else problem.lengths[:count]
    excluded = frozenset(k for k in problem.excluded if k < count)
    whole = replace(
        problem, candidates=columns, known=problem.known[:count], lengths=lengths, excluded=excluded
    )
    names = list(enumerate(grouping.names))[1:]
    return whole.wider([GroupTerm.of(terms[k], group, name) for k in members for group, name in names])


def laws(fit: Fit) -> list[tuple[list[int], tuple[Term, ...], list[float]]]:
    """Trajectories that obey one law, its terms, and their coefficients; one entry without groups.

    Terms that are not in the law have the coefficient zero.
    """
    problem, spline = fit.problem, fit.grid.spline
    columns, coefficients = problem.candidates, fit.coefficients
    everywhere = list(range(len(problem.trajectories)))
    if not isinstance(columns, GroupedColumns):
        return [(everywhere, problem.terms, coefficients.tolist())]
    starts = np.cumsum([0, *(space.n_intervals for space in spline.spaces[:-1])])
    place = columns.labels[starts]
    out: list[tuple[list[int], tuple[Term, ...], list[float]]] = []
    for group in sorted({*place.tolist()}):
        sizes: dict[Term, float] = {}
        for term, value in zip(problem.terms, coefficients.tolist(), strict=True):
            if not isinstance(term, GroupTerm) or term.group == group:
                sizes[_whole(term)] = sizes.get(_whole(term), 0.0) + value
        out.append((np.flatnonzero(place == group).tolist(), tuple(sizes), list(sizes.values())))
    return out
