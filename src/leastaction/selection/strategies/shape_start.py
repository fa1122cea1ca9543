"""Numbers to begin with for shape parameters, from a profile of the weak form.

Candidates with shape parameters are placed one after the other: of the numbers that the range of the
parameters offers, those that explain the rows of the weak form with the cheapest support, refined by
Gauss–Newton steps. Then each is looked for once more with the others in place. Numbers that do it nearly as
well are compared by fits: a steep exponential, say, follows the noise of a few samples.

Cost: two passes over some tens of numbers for each candidate, each a search for a support on the weak form;
a search for a structure with each of the few best. Skipped where no candidate has shape parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from leastaction.estimation.problem import Problem
from leastaction.estimation.shape_ranges import ShapeRange, shape_starts
from leastaction.selection.likelihood_refinement import value
from leastaction.selection.search_state import Search
from leastaction.selection.settings import SELECTION
from leastaction.selection.shape_profile import Profile, ProfilePoint
from leastaction.selection.strategies import shape_fit, weak_start

__all__ = ["places", "run"]

_STARTS = {1: 33, 2: 256}  # by the number of parameters of a candidate
_MOST_STARTS = 512  # of a candidate with more
_REFINED = 4  # of the starts, beside each number of plain candidates
_PASSES = 2  # over the candidates


def run(search: Search) -> Search:
    """The problem with the best numbers that a profile finds."""
    problem = search.grid.problem
    if not problem.ranges:
        return search
    search.report("shapes", {})
    begun = [search.at(point.values) for point in places(search)[: SELECTION.shape_compared]]
    if len(begun) < 2:
        return begun[0] if begun else search
    return max(begun, key=lambda at: value(shape_fit.run(weak_start.run(at)).found))


def places(search: Search, most: int = _MOST_STARTS) -> list[ProfilePoint]:
    """All shape parameters of the grid's problem, those of one candidate after those of another.

    Of each candidate with shape parameters ``most`` starts are tried. The best comes first, then what the
    last candidate may have instead; empty where one is undefined at all.
    """
    problem = search.grid.problem
    profile = Profile(search.grid, search.curve, search.seed)
    values: dict[str, float] = {}
    found: list[ProfilePoint] = []
    groups = _groups(problem)
    for _ in range(_PASSES if len(groups) > 1 else 1):
        for group in groups:
            others = {n: v for n, v in values.items() if n not in group}
            bearers = _determined(problem, {*others, *group})
            ranges = {name: problem.ranges[name] for name in group}
            count = min(_STARTS.get(len(group), _MOST_STARTS), most)
            starts = shape_starts(ranges, count)
            new = _distinct(_best(profile, bearers, others, starts, rising=len(group) == 1), ranges)
            complete = bool(found) and set(found[0].values) == {*others, *group}
            if new and not (complete and found[0].score <= new[0].score):
                found, values = new, dict(new[0].values)
    return found


def _groups(problem: Problem) -> list[tuple[str, ...]]:
    """Shape parameters that come together: those of a candidate that none before it has."""
    out: list[tuple[str, ...]] = []
    seen: set[str] = set()
    for term in problem.terms:
        new = tuple(name for name in term.shapes if name not in seen)
        if new:
            out.append(new)
            seen |= {*new}
    return out


def _determined(problem: Problem, names: set[str]) -> list[int]:
    """Candidates all of whose shape parameters have numbers."""
    return [k for k, term in enumerate(problem.terms) if term.shapes and names.issuperset(term.shapes)]


def _best(
    profile: Profile,
    bearers: Sequence[int],
    others: dict[str, float],
    starts: Iterable[dict[str, float]],
    rising: bool,
) -> list[ProfilePoint]:
    """Supports after Gauss–Newton steps from the best few starts, beside ever more plain candidates.

    Ends beside as many plain candidates as let noise explain what is left.  All of the starts are compared
    there: the first that does may be a harmonic of the numbers, which more terms make up for.  Where the
    starts rise, only those are begun with that are better than their neighbours.
    """
    tried = list(filter(None, (profile.point({**others, **start}, bearers) for start in starts)))
    found: list[ProfilePoint] = []
    for level in zip(*tried, strict=True):
        begun = _lowest(level) if rising else level
        for point in sorted(begun, key=lambda p: p.ratio)[:_REFINED]:
            found.append(profile.searched(profile.refined(point, bearers)))
        found.sort(key=lambda p: p.score)
        if found[0].ratio < SELECTION.rows_explained:
            break
    return found


def _lowest(points: Sequence[ProfilePoint]) -> list[ProfilePoint]:
    """Points that are no worse than their neighbours."""
    ratios = np.array([np.inf, *(p.ratio for p in points), np.inf])
    low = (ratios[1:-1] <= ratios[:-2]) & (ratios[1:-1] <= ratios[2:])
    return [point for point, is_low in zip(points, low, strict=True) if is_low]


def _distinct(points: Sequence[ProfilePoint], ranges: Mapping[str, ShapeRange]) -> list[ProfilePoint]:
    """Points without those that lie near a better one, within a few per cent of the ranges."""
    kept: list[ProfilePoint] = []
    for point in points:
        if not any(_near(point, other, ranges) for other in kept):
            kept.append(point)
    return kept


def _near(one: ProfilePoint, other: ProfilePoint, ranges: Mapping[str, ShapeRange]) -> bool:
    return all(
        abs(where.share(one.values[name]) - where.share(other.values[name])) < SELECTION.shape_apart
        for name, where in ranges.items()
    )
