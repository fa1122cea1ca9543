"""Numbers to begin with for shape parameters, from a profile of the weak form.

Of the numbers that the ranges of the parameters offer, those are taken that explain the rows of the weak form
with the cheapest support, refined by Gauss–Newton steps. Candidates are placed together: one by itself goes
where it does best without the others. Then each is looked for once more with the others in place. Where the
places are too many for that, those of frequencies, candidates are placed one after the other, twice. Numbers
that do nearly as well are compared by fits: a steep exponential, say, follows the noise of a few samples.
So are laws with numbers elsewhere that promise as much (`leastaction.selection.other_numbers`).

Cost: some tens of numbers for each candidate, a thousand where several are placed together, each a search for
a support on the weak form; a search for a structure with each of the few best, up to three more fits, and at
the end one for each law that came near. Skipped where no candidate has shape parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.shape_ranges import ShapeRange, shape_starts
from leastaction.estimation.weights import Start
from leastaction.library import alike
from leastaction.selection.likelihood_refinement import value
from leastaction.selection.other_numbers import differing_terms, laws_elsewhere
from leastaction.selection.search_state import Search, equations_hold
from leastaction.selection.settings import SELECTION
from leastaction.selection.shape_profile import Kind, Profile, ProfilePoint
from leastaction.selection.strategies import shape_fit, weak_start

__all__ = ["against_others", "places", "run"]

_STARTS = {1: 33, 2: 256}  # by the number of parameters of a candidate
_MOST_STARTS = 512  # of a candidate with more
_PLACES = {1: 33, 2: 1024}  # of candidates that are placed together, by the number of their own parameters
_MOST_PLACES = 2048  # of those with more
_SHARED_STARTS = 8  # of numbers that candidates share, beside those that are their own
_CHOSEN = 16  # of sets of places, beside all of these together
_MORE = 4  # times as many, where these lead to none that explains the rows
_TRIED = 8  # of the starts, beside each number of plain candidates
_REFINED = 4  # of the numbers that these lead to
_MOST_SHARED = 2  # numbers of several kinds that are placed together


def run(search: Search) -> Search:
    """The problem with the best numbers that a profile finds."""
    problem = search.grid.problem
    if not problem.ranges:
        return search
    search.report("shapes", {})
    begun = [search.at(point.values) for point in places(search, thorough=True)[: SELECTION.shape_compared]]
    if not begun:
        return search
    tried = [shape_fit.run(weak_start.run(at)) for at in begun]
    best = max(tried, key=lambda at: value(at.found))
    tried += [shape_fit.run(best.now(fit)) for fit in laws_elsewhere(best.found, _scanned(problem))]
    tried.sort(key=lambda at: -value(at.found))
    return replace(tried[0], others=_others([at.found for at in tried]))


def _others(fits: Sequence[Fit]) -> tuple[Fit, ...]:
    """Laws that come near the first, each once."""
    out: list[Fit] = []
    for fit in fits:
        near = value(fit) > value(fits[0]) - SELECTION.shape_lost
        if near and all(differing_terms(fit, one) or differing_terms(one, fit) for one in out):
            out.append(fit)
    return tuple(out[1:])


def against_others(search: Search) -> Search:
    """The best of the law and of those found from other starts, each fitted on the final grid.

    On a first grid, laws with other numbers may come close to each other, or lie the wrong way round.
    """
    fit = search.found
    if not search.others or not fit.converged or not equations_hold(fit):
        return replace(search, others=())
    found = [fit, *(_again(search, other) for other in search.others)]
    best = max((f for f in found if f.converged), key=value)
    return search.now(best, others=_others([best, *(f for f in found if f is not best)]))


def _again(search: Search, other: Fit) -> Fit:
    """A law of an earlier grid, fitted and improved on that of the search."""
    fit = search.found
    problem = fit.problem.at(other.problem.shape_values)
    members = [k for k in other.structure if k not in problem.excluded]
    coefficients = np.zeros(len(problem.candidates))
    coefficients[: other.coefficients.size] = other.coefficients
    start = Start(fit.control_points, coefficients, fit.weights)
    return shape_fit.run(search.now(fit.grid.posed(problem).fit(Structure(members), start))).found


def places(search: Search, most: int = _MOST_STARTS, thorough: bool = False) -> list[ProfilePoint]:
    """All shape parameters of the grid's problem, those of one candidate after those of another.

    Of each candidate with shape parameters ``most`` starts are tried. The best comes first, then what the
    last candidate may have instead; empty where one is undefined at all. Thorough, more sets of places are
    begun with where candidates are placed together and the first do not explain the rows.
    """
    problem = search.grid.problem
    profile = Profile(search.grid, search.curve, search.seed)
    values: dict[str, float] = {}
    found: list[ProfilePoint] = []
    for group in _rounds(problem):
        others = {n: v for n, v in values.items() if n not in group.names}
        bearers = _determined(problem, {*others, *group.names})
        for sets in (_CHOSEN, _MORE * _CHOSEN):
            begun = _begun(profile, group, others, bearers, most, sets)
            new = _distinct(_best(profile, bearers, begun, group), problem.ranges)
            if not (thorough and group.together) or (new and _explains(new[0])):
                break
        complete = bool(found) and set(found[0].values) == {*others, *group.names}
        if new and not (complete and found[0].score <= new[0].score):
            found, values = new, dict(new[0].values)
    return found


def _scanned(problem: Problem) -> list[tuple[str, ...]]:
    """Names of the groups of which each start can be tried: single candidates, without frequencies."""
    groups = [group for group in _groups(problem) if not group.together]
    return [group.names for group in groups if not _waves(problem, group.names)]


def _waves(problem: Problem, names: Iterable[str]) -> bool:
    """Whether there is a frequency among some shape parameters, which has too many starts to try all."""
    return any(problem.ranges[name].spacing == "frequency" for name in names)


@dataclass(frozen=True)
class _Group:
    """Shape parameters that come together.

    Attributes
    ----------
    names : tuple of str
    kinds : tuple of mapping
        Candidates that have numbers of their own, those of a kind differ in the names of these alone, see
        `leastaction.library.alike`; where there is more than one candidate, they are placed together.
    """

    names: tuple[str, ...]
    kinds: tuple[Mapping[int, Mapping[str, str]], ...]

    @property
    def together(self) -> bool:
        """Whether several candidates are placed at once."""
        return sum(map(len, self.kinds)) > 1


def _rounds(problem: Problem) -> list[_Group]:
    """All at once where that can be, then each group with the others in place; else two such rounds."""
    groups = _groups(problem)
    if len(groups) < 2:
        return groups
    kinds = tuple(kind for group in groups for kind in group.kinds)
    names = tuple(name for group in groups for name in group.names)
    whole = _Group(names, kinds)
    return (
        [*groups, *groups]
        if _waves(problem, names) or len(_shared(whole)) > _MOST_SHARED
        else [whole, *groups]
    )


def _shared(group: _Group) -> list[str]:
    """Numbers of a group that no candidate has for itself."""
    own = {name for kind in group.kinds for names in kind.values() for name in names.values()}
    return [name for name in group.names if name not in own]


def _groups(problem: Problem) -> list[_Group]:
    """Shape parameters of candidates that are alike, or else of one that none before it has."""
    free: list[int] = problem.free.tolist()
    kinds = [
        {free[k]: names for k, names in kind.items()} for kind in alike([problem.terms[k] for k in free])
    ]
    out: list[_Group] = []
    seen: set[str] = set()
    for k in range(len(problem.terms)):
        some = [kind for kind in kinds if k == next(iter(kind)) and len(kind) > 1]
        kind = some[0] if some else dict[int, dict[str, str]]()
        own = {name for names in kind.values() for name in names.values()}
        others = {name for j, t in enumerate(problem.terms) if j not in kind for name in t.shapes}
        pairs = [pair for names in kind.values() for pair in names.items()]
        apart = any(problem.ranges[a] != problem.ranges[b] for a, b in pairs)
        if own & (seen | others) or apart or _waves(problem, own):
            kind = {}
        shapes = dict.fromkeys(name for j in kind or (k,) for name in problem.terms[j].shapes)
        names = tuple(name for name in shapes if name not in seen)
        if names:
            out.append(_Group(names, tuple(filter(None, [kind or _alone(problem, k)]))))
            seen |= {*names}
    return out


def _alone(problem: Problem, k: int) -> dict[int, dict[str, str]]:
    """The names that a single candidate has for itself."""
    others = {name for j, term in enumerate(problem.terms) if j != k for name in term.shapes}
    own = {name: name for name in problem.terms[k].shapes if name not in others}
    return {k: own} if own and not problem.is_known[k] else {}


def _begun(
    profile: Profile, group: _Group, others: dict[str, float], bearers: list[int], most: int, sets: int
) -> list[list[ProfilePoint]]:
    """Numbers to begin with, beside ever more plain candidates; of places taken together, so many sets."""
    ranges = profile.problem.ranges
    if not group.together:
        count = min(_STARTS.get(len(group.names), _MOST_STARTS), most)
        starts = shape_starts({name: ranges[name] for name in group.names}, count)
        tried = (profile.point({**others, **start}, bearers) for start in starts)
        return [list(level) for level in zip(*filter(None, tried), strict=True)]
    kinds: list[Kind] = []
    for kind in group.kinds:
        own = next(iter(kind.values()))
        count = min(_PLACES.get(len(own), _MOST_PLACES), most)
        kinds.append(Kind(kind, list(shape_starts({name: ranges[name] for name in own}, count))))
    shared = {name: ranges[name] for name in _shared(group)}
    numbers = list(shape_starts(shared, _SHARED_STARTS)) if shared else [dict[str, float]()]
    chosen = [profile.chosen(kinds, {**others, **each}, bearers) for each in numbers]
    most_each, levels = sets // len(numbers), list[list[ProfilePoint]]()
    for level in zip(*filter(None, chosen), strict=True):
        points = [profile.refined(p, bearers, roughly=True) for some in level for p in some[:most_each]]
        levels.append(_distinct(sorted(points, key=lambda p: p.score), ranges))
    return levels


def _determined(problem: Problem, names: set[str]) -> list[int]:
    """Candidates all of whose shape parameters have numbers."""
    return [k for k, term in enumerate(problem.terms) if term.shapes and names.issuperset(term.shapes)]


def _best(
    profile: Profile, bearers: Sequence[int], begun: Sequence[Sequence[ProfilePoint]], group: _Group
) -> list[ProfilePoint]:
    """Supports after Gauss–Newton steps from the best few starts, beside ever more plain candidates.

    Ends beside as many plain candidates as let noise explain what is left, but not at the first level:
    without plain candidates, wrong numbers may explain nearly as much.  All of the starts are compared there:
    the first that does may be a harmonic of the numbers, which more terms make up for.  Nor at points worse
    than no law at all (their score is not negative): a steep power is left with noise because it has so much
    of its own.  Where the starts rise, those of a single number, only those are begun with that are better
    than their neighbours.
    """
    found: list[ProfilePoint] = []
    for count, level in enumerate(begun):
        lowest = _lowest(level) if len(group.names) == 1 else level
        refined: list[ProfilePoint] = []
        for start in sorted(lowest, key=lambda p: p.score)[:_TRIED]:  # many may lead to the same numbers
            refined = _distinct([*refined, profile.refined(start, bearers)], profile.problem.ranges)
            if len(refined) == _REFINED:
                break
        found += map(profile.searched, refined)
        found.sort(key=lambda p: p.score)
        unused = [p for p in found if max(p.members, default=0) < len(profile.plain)]
        found = [p for p in found if p not in unused[1:]]  # without the term, its numbers do not matter
        explained = any(map(_explains, refined))
        if count and explained and not group.together:
            break
    return found


def _explains(point: ProfilePoint) -> bool:
    """Whether noise explains what is left, at numbers that are better than no law at all."""
    return point.ratio < SELECTION.rows_explained and point.score < 0.0


def _lowest(points: Sequence[ProfilePoint]) -> list[ProfilePoint]:
    """Points that are no worse than their neighbours."""
    scores = np.array([np.inf, *(p.score for p in points), np.inf])
    low = (scores[1:-1] <= scores[:-2]) & (scores[1:-1] <= scores[2:])
    return [point for point, is_low in zip(points, low, strict=True) if is_low]


def _distinct(points: Sequence[ProfilePoint], ranges: Mapping[str, ShapeRange]) -> list[ProfilePoint]:
    """Points without those that lie near a better one, within a few per cent of the ranges."""
    kept: list[ProfilePoint] = []
    for point in points:
        if not any(_near(point, other, ranges) for other in kept):
            kept.append(point)
    return kept


def _near(one: ProfilePoint, other: ProfilePoint, ranges: Mapping[str, ShapeRange]) -> bool:
    return all(  # in the first pass, later groups have no numbers yet
        abs(ranges[name].share(number) - ranges[name].share(other.values[name])) < SELECTION.shape_apart
        for name, number in one.values.items()
    )
