"""Numbers to begin with for shape parameters, from a profile of the weak form.

Candidates with shape parameters are placed one after the other: of the numbers that the range of the
parameters offers, those that explain the rows of the weak form with the cheapest support, refined by
Gauss–Newton steps. Then each is looked for once more with the others in place.

Cost: two passes over some tens of numbers for each candidate, each a search for a support on the weak form.
Skipped where no candidate has shape parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from leastaction.estimation.problem import Problem
from leastaction.estimation.shape_ranges import shape_starts
from leastaction.selection.search_state import Search
from leastaction.selection.settings import SELECTION
from leastaction.selection.shape_profile import Profile, ProfilePoint

__all__ = ["place", "run"]

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
    point = place(search)
    return search if point is None else search.at(point.values)


def place(search: Search, most: int = _MOST_STARTS) -> ProfilePoint | None:
    """All shape parameters of the grid's problem, those of one candidate after those of another.

    Of each candidate with shape parameters ``most`` starts are tried; None where it is undefined at all.
    """
    problem = search.grid.problem
    profile = Profile(search.grid, search.curve, search.seed)
    values: dict[str, float] = {}
    best: ProfilePoint | None = None
    groups = _groups(problem)
    for _ in range(_PASSES if len(groups) > 1 else 1):
        for group in groups:
            others = {n: v for n, v in values.items() if n not in group}
            bearers = _determined(problem, {*others, *group})
            count = min(_STARTS.get(len(group), _MOST_STARTS), most)
            starts = shape_starts({name: problem.ranges[name] for name in group}, count)
            found = _best(profile, bearers, others, starts)
            complete = best is not None and set(best.values) == {*others, *group}
            if found is not None and not (complete and best is not None and best.score <= found.score):
                best, values = found, dict(found.values)
    return best


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
) -> ProfilePoint | None:
    """The best support after Gauss–Newton steps from the best few starts beside simple and all candidates.

    Ends beside as many plain candidates as let noise explain what is left.  All of the starts are compared
    there: the first that does may be a harmonic of the numbers, which more terms make up for.
    """
    tried = [profile.point({**others, **start}, bearers) for start in starts]
    best: ProfilePoint | None = None
    for level in zip(*filter(None, tried), strict=True):
        for point in sorted(level, key=lambda p: p.ratio)[:_REFINED]:
            found = profile.searched(profile.refined(point, bearers))
            if best is None or found.score < best.score:
                best = found
        if best is not None and best.ratio < SELECTION.rows_explained:
            return best
    return best
