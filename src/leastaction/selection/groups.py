"""In which terms do groups of trials differ?  A structure, and the terms whose coefficients are not shared.

With coefficients that are shared a law of several groups is wrong, and terms of all kinds make up for it.  So
the structure is searched in one group alone, where a law holds as it is.  On all data it is then fitted with
every coefficient in every group by itself, and the quadratic model of the likelihood about that fit prices
what is asked: which terms there are, P each, and which of them differ, χ² of as many numbers as there are
further groups,

    cost(terms, differing) + P |terms| + Q |differing|.

A term differs in every group or in none.  The choice is fitted, and priced again about its own fit.

Cost: a search on one group, and a few fits of all data; one more search, on all data, where the equations do
not hold in all groups with the terms of the one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leastaction.curve.knots import lay_knots
from leastaction.data.trajectories import Trajectories
from leastaction.errors import InputError
from leastaction.estimation.build import ENOUGH_SAMPLES, Setup
from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.groups import Grouping, GroupTerm, grouped
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.weights import Start
from leastaction.selection.likelihood_refinement import penalty, value
from leastaction.selection.likelihood_search import QuadraticModel
from leastaction.selection.progress import silent
from leastaction.selection.search import find_on_data
from leastaction.selection.search_state import Search, begin_search, explains, restarted
from leastaction.selection.significance import chi_square_cutoff
from leastaction.selection.strategies import exact_equations, weak_start
from leastaction.selection.weak_proposals import settled

__all__ = ["compared", "law_alone", "search_groups"]

_ROUNDS = 5  # choices that are fitted, at most
_MOST_COLUMNS = 400  # candidates in all groups: of more only terms found may differ, which bounds memory


def search_groups(setup: Setup, search: Search, grouping: Grouping) -> Search:
    """The structure of several groups of trials, and what differs between them.

    Parameters
    ----------
    setup : Setup
    search : Search
        That has not found anything yet, of all data.
    grouping : Grouping

    Returns
    -------
    Search
        Whose fit is of a problem with a `GroupTerm` for what differs.

    Raises
    ------
    InputError
        If the candidates hold shape parameters.
    """
    if setup.problem.ranges:
        raise InputError(
            "groups cannot be compared with shape parameters in the candidates; give numbers in their place"
        )
    alone = find_on_data(_in_one_group(setup, search, grouping))
    best = compared(search, grouping, alone)
    if not alone.stopped and not (best.converged and explains(best, best.evidence)):
        together = find_on_data(search)
        other = compared(search, grouping, together)
        if _worth(other, search.relevance) > _worth(best, search.relevance):
            alone, best = together, other
    done = search.now(best, knots_settled=alone.knots_settled, feeding=alone.feeding, stopped=alone.stopped)
    problem = best.problem
    done = replace(done, problem=problem, searched=problem, findings=alone.findings)
    return done if done.stopped else exact_equations.run(done)


def _in_one_group(setup: Setup, search: Search, grouping: Grouping) -> Search:
    """A search in the group with the most samples, of those in which something sets the scale of L."""
    data = setup.problem.trajectories
    parts = [data.select(grouping.members(group)) for group in range(len(grouping.names))]
    fixed = bool(np.any(np.nan_to_num(setup.problem.known)))
    parts = [part for part in parts if fixed or part.driven]
    problem = setup.problem.on(max(parts, key=lambda part: part.n_samples))
    searched = problem.excerpt(ENOUGH_SAMPLES)
    scales = lay_knots(searched.trajectories, problem.degree)
    one = Setup(problem, searched, setup.library, scales, ())
    return begin_search(
        one, relevance=search.relevance, seed=search.seed, thorough=search.thorough, report=search.report
    )


def compared(search: Search, grouping: Grouping, found: Search, laws: Sequence[Fit] | None = None) -> Fit:
    """What a search has found, on all data and in every group: which terms differ.

    ``laws`` are those of the groups by themselves, if they are known.
    """
    fit = found.found
    faster = max(1.0, search.scales.per_second / found.scales.per_second)
    problem = fit.problem.on(search.problem.trajectories)
    grid = Grid.lay(problem, fit.grid.knots_per_second * faster)
    search.report("confirm", {})
    if laws is None:
        own = fit.problem.trajectories
        parts = [problem.trajectories.select(grouping.members(g)) for g in range(len(grouping.names))]
        laws = [fit if [*part] == [*own] else law_alone(found, part, grid.knots_per_second) for part in parts]
    groups = _Groups(grid, grouping)
    best, terms = groups.apart(laws)
    for _ in range(_ROUNDS):
        if not best.usable:
            break
        chosen = groups.chosen(best, terms, search.relevance)
        if chosen.terms == terms:
            break
        other = groups.fitted(chosen)
        prices = groups.prices(best, search.relevance)
        if not _value(other, chosen.terms, prices) > _value(best, terms, prices):
            break
        best, terms = other, chosen.terms
    return best


def law_alone(found: Search, data: Trajectories, knots_per_second: float) -> Fit:
    """The law of some trials with the terms that a search has found, and more if it does not hold."""
    problem = found.found.problem.on(data).excerpt(ENOUGH_SAMPLES)
    others = [k for k in problem.free.tolist() if k not in found.found.structure]
    grid = Grid.lay(problem.excluding(others), knots_per_second)
    begun = replace(restarted(found, grid), report=silent)
    fit = weak_start.run(begun).found.posed(problem)
    if explains(fit, fit.evidence):
        return fit
    other = weak_start.run(replace(begun, problem=problem, searched=problem, grid=grid.posed(problem))).found
    return max(fit, other, key=value)


def _value(fit: Fit, terms: _Terms, prices: _Prices) -> float:
    """Evidence less the price of the terms, −∞ for a fit that failed."""
    return fit.evidence - 0.5 * prices.of(terms) if fit.usable and np.isfinite(fit.evidence) else -np.inf


def _worth(fit: Fit, relevance: float) -> float:
    """The same of a fit by itself."""
    if not (fit.converged and np.isfinite(fit.evidence)):
        return -np.inf
    return fit.evidence - 0.5 * (penalty(fit.grid) + fit.relevant_gain(relevance)) * len(fit.structure)


@dataclass(frozen=True)
class _Terms:
    """Candidates in the first group, and those whose coefficients differ."""

    shared: frozenset[int]
    differing: frozenset[int]

    @property
    def every(self) -> frozenset[int]:
        return self.shared | self.differing

    def near(self, offered: frozenset[int]) -> Iterator[_Terms]:
        """Choices one step away: a term more or fewer, one that differs or not, one exchanged for another."""
        for k in offered:
            if k not in self.every:
                yield _Terms(self.shared | {k}, self.differing)
                yield _Terms(self.shared | {k}, self.differing | {k})
        for k in self.every:
            yield _Terms(self.shared - {k}, self.differing - {k})
            if k not in self.differing:
                yield _Terms(self.shared, self.differing | {k})
                yield from (_Terms(self.shared, self.differing - {j} | {k}) for j in self.differing)
            elif k in self.shared:
                yield _Terms(self.shared, self.differing - {k})
                yield _Terms(self.shared - {k}, self.differing)
            else:
                yield _Terms(self.shared | {k}, self.differing)


@dataclass(frozen=True)
class _Prices:
    """What a term, a term that differs, and a coefficient in the first group cost, in units of χ²."""

    term: float
    differing: float
    first: float

    def of(self, terms: _Terms) -> float:
        absent = len(terms.every) - len(terms.shared)
        return self.term * len(terms.every) + self.differing * len(terms.differing) - self.first * absent


@dataclass(frozen=True)
class _Choice:
    """Terms, and where their fit begins: coefficients by candidate and group (0: in the first), curve."""

    terms: _Terms
    start: Start
    coefficients: dict[tuple[int, int], float]


class _Groups:
    """Fits of all data on one grid, with coefficients that differ between groups."""

    def __init__(self, grid: Grid, grouping: Grouping) -> None:
        self.grid, self.grouping = grid, grouping
        self.n_groups = len(grouping.names)

    def _posed(self, members: list[int]) -> Problem:
        return grouped(self.grid.problem, self.grouping, self.grid.spline.owner, members)

    def _places(self, terms: _Terms, members: list[int]) -> list[tuple[int, int]]:
        """Candidate and group of every column of a structure, in its sequence; 0 is all groups."""
        further = [(k, g) for k in members if k in terms.differing for g in range(1, self.n_groups)]
        return [*((k, 0) for k in sorted(terms.shared)), *further]

    def _number(self, place: tuple[int, int], members: list[int]) -> int:
        """The number of a column among the candidates of a problem whose ``members`` may differ."""
        k, group = place
        if group == 0:
            return k
        return len(self.grid.problem.terms) + members.index(k) * (self.n_groups - 1) + group - 1

    def apart(self, laws: Sequence[Fit]) -> tuple[Fit, _Terms]:
        """The terms of all groups, with every coefficient in every group by itself."""
        members = sorted({k for law in laws if law.usable for k in law.structure})
        terms = _Terms(frozenset(members), frozenset(members))
        problem = self._posed(members)
        sizes = [law.coefficients if np.isfinite(law.evidence) else laws[0].coefficients for law in laws]
        coefficients = np.zeros(len(problem.terms))
        for k in members:
            for group, size in enumerate(sizes):
                coefficients[self._number((k, group), members)] = size[k] - (group > 0) * sizes[0][k]
        structure = Structure(self._number(place, members) for place in self._places(terms, members))
        grid, curve = self.grid.posed(problem), self.grid.smooth()
        return grid.fit(structure, settled(grid, curve, structure, coefficients).start), terms

    def fitted(self, choice: _Choice) -> Fit:
        """A choice with its coefficients fitted; only terms of the structure may differ in its problem."""
        members = sorted(choice.terms.every)
        problem = self._posed(members)
        coefficients = np.zeros(len(problem.terms))
        for place, size in choice.coefficients.items():
            coefficients[self._number(place, members)] = size
        structure = Structure(self._number(p, members) for p in self._places(choice.terms, members))
        return self.grid.posed(problem).fit(structure, replace(choice.start, coefficients=coefficients))

    def prices(self, fit: Fit, relevance: float) -> _Prices:
        """A difference has to pass chance, and to explain the relevant share of what is unexplained."""
        share = fit.relevant_gain(relevance)
        numbers, terms = (
            self.n_groups - 1,
            max(sum(k < len(self.grid.problem.terms) for k in fit.structure), 1),
        )
        return _Prices(
            penalty(self.grid) + share, chi_square_cutoff(numbers, terms) + share, chi_square_cutoff()
        )

    def chosen(self, fit: Fit, now: _Terms, relevance: float) -> _Choice:
        """The cheapest terms on the quadratic model about a fit."""
        free = self.grid.problem.free.tolist()
        few = len(free) * self.n_groups <= _MOST_COLUMNS
        members = free if few else sorted(now.every)
        offered = frozenset(free if few else members)
        wide = self._posed(members)
        places = [*((k, 0) for k in free), *((k, g) for k in members for g in range(1, self.n_groups))]
        numbers = [self._number(place, members) for place in places]
        quadratic = fit.score(wide.candidates.subset(numbers))
        here = np.array([self._coefficient(fit, place) for place in places])
        model = _Priced(QuadraticModel(quadratic.matrix, quadratic.gradient, here), places, self.n_groups)
        prices = self.prices(fit, relevance)
        starts = [now, _Terms(now.shared, frozenset())] if now.differing == now.every else [now]
        terms = min(
            (model.descended(s, offered, prices) for s in starts), key=lambda t: model.price(t, prices)
        )
        solution = model.quadratic.solution(model.support(terms))
        shift = quadratic.curve_step(solution - here)
        points = fit.control_points - shift.reshape(fit.control_points.shape)
        found = {place: float(x) for place, x in zip(places, solution, strict=True) if x != 0.0}
        return _Choice(terms, Start(points, fit.coefficients, fit.weights), found)

    def _coefficient(self, fit: Fit, place: tuple[int, int]) -> float:
        k, group = place
        if group == 0:
            return float(fit.coefficients[k])
        for number in fit.structure:
            term = fit.problem.terms[number]
            if (
                isinstance(term, GroupTerm)
                and term.group == group
                and term.whole == self.grid.problem.terms[k]
            ):
                return float(fit.coefficients[number])
        return 0.0


class _Priced:
    """The quadratic model, asked for terms that differ or not."""

    def __init__(self, quadratic: QuadraticModel, places: list[tuple[int, int]], n_groups: int) -> None:
        self.quadratic, self.n_groups = quadratic, n_groups
        self.at = {place: n for n, place in enumerate(places)}
        self._costs: dict[_Terms, float] = {}

    def support(self, terms: _Terms) -> tuple[int, ...]:
        further = ((k, g) for k in terms.differing for g in range(1, self.n_groups))
        return tuple(sorted(self.at[place] for place in (*((k, 0) for k in terms.shared), *further)))

    def price(self, terms: _Terms, prices: _Prices) -> float:
        if terms not in self._costs:
            self._costs[terms] = self.quadratic.best({self.support(terms)}, 1)[0].cost
        return self._costs[terms] + prices.of(terms)

    def descended(self, terms: _Terms, offered: frozenset[int], prices: _Prices) -> _Terms:
        """The cheapest choice that steps lead to."""
        while True:
            near = (t for t in terms.near(offered) if t.every)
            best = min(near, key=lambda t: self.price(t, prices), default=terms)
            if not self.price(best, prices) < self.price(terms, prices):
                return terms
            terms = best
