"""Which terms with unknown numbers would say what the candidates imitate?  For one coordinate, no angle.

A dictionary of families, such as exp(−a x) or 1/√((x − p)² + h²), is scored on the quadratic model of the
likelihood about a fit: numbers κ are put in from their ranges, and the gain of a family is the most by which
−2 log L falls with its terms φ(κ) beside the structure.  For the best few a profile of the weak form finds κ,
and those that it finds the simplest laws with are searched with.  One is named if its law is likelier by the
evidence, its equations hold, and it leaves no doubt about the form itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from leastaction.diagnosis.missing_terms import missing_term
from leastaction.diagnosis.smooth_changes import doubts_about_the_form
from leastaction.diagnosis.wider_search import MOST_SAMPLES, Offer, offered, searched_with
from leastaction.estimation.fit import Fit
from leastaction.estimation.shape_ranges import ShapeRange, shape_ranges, shape_starts
from leastaction.findings import Finding, find
from leastaction.library import Term, make_term, shape_names
from leastaction.selection.likelihood_refinement import gains_beside, penalty, value
from leastaction.selection.search_state import Search, equations_hold
from leastaction.selection.strategies import feeding_friction, finer_knots, shape_fit, weak_start
from leastaction.selection.strategies.shape_start import places

__all__ = ["lacking_family", "named_family"]

_STARTS = 64  # numbers tried of a family with several shape parameters
_PROFILED = 5  # families whose numbers are looked for on the weak form
_LOWEST = 0.5  # power of a coordinate that changes its sign, which a search begins with
_SEARCHED = 2  # families that are searched with

# of one coordinate x, in L and times x_dot**2
_LINE = (
    ("exp(-{a}*X)",),
    ("exp(-{a}*X)", "exp(-2*{a}*X)"),
    ("exp(-((X-{p})/{w})**2)",),
    ("sqrt((X-{p})**2+{h}**2)",),
    ("1/sqrt((X-{p})**2+{h}**2)",),
    ("log((X-{p})**2+{h}**2)",),
    ("cos({k}*X)", "sin({k}*X)"),
)
_POSITIVE = (("X**{n}",), ("X**{n}", "X**{m}"))
_BOTH_SIGNS = (("abs(X)**{n}",),)


def _offers(fit: Fit, kinetic: bool) -> Iterator[Offer]:
    """The dictionary for the one coordinate of a fit; with ``kinetic``, masses that depend on it."""
    (name,), points = fit.problem.coordinates, fit.points()
    states = dict(zip((name, f"{name}_dot"), map(np.asarray, points.columns), strict=False))
    ordinary = _POSITIVE if states[name].min() > 0.0 else _BOTH_SIGNS
    factor = f"{name}_dot**2*" if kinetic else ""
    for texts in (*_LINE, *ordinary):
        terms = [make_term(factor + text.replace("X", name), list(states)) for text in texts]
        if set(shape_names(terms)) & set(fit.problem.ranges):
            continue
        ranges = shape_ranges(terms, states, {})
        if texts in _BOTH_SIGNS:  # negative powers are infinite where the coordinate changes its sign
            ranges = {n: replace(found, low=_LOWEST, bounded=True) for n, found in ranges.items()}
        yield _offer(fit, terms, ranges)


def named_family(doubt: Finding, search: Search) -> Finding:
    """A doubt about the form of a law, with the family that would help, if one does."""
    helpful = _helpful(search, doubt.values["kind"] == "kinetic")
    if helpful is None:
        return doubt
    texts, numbers = _as_offered(*helpful)
    return find(doubt.code, **{**doubt.values, "family": texts, "numbers": numbers})


def lacking_family(search: Search) -> list[Finding]:
    """Terms with unknown numbers with which the equations hold; nothing if none are found."""
    helpful = _helpful(search, kinetic=False)
    if helpful is None:
        return []
    texts, numbers = _as_offered(*helpful)
    free = len(helpful[0].structure)
    return [missing_term(texts, search.found.problem.coordinates, free_terms=free, numbers=numbers)]


def _as_offered(found: Fit, names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Terms in use as a user writes them, and their numbers."""
    templates = [found.problem.terms[m].template for m in found.structure]
    texts = [t.term.text for t in templates if t is not None and {*t.term.shapes} & {*names}]
    return texts, [f"{name} = {found.problem.shape_values[name]:.3g}" for name in names]


def _helpful(search: Search, kinetic: bool) -> tuple[Fit, list[str]] | None:
    """The best law that is found with a family, and the shape parameters of that."""
    fit = search.found
    if len(fit.problem.coordinates) > 1 or fit.problem.candidates.turning:
        return None
    if fit.problem.trajectories.n_samples > MOST_SAMPLES:
        return None
    if not (fit.converged and np.isfinite(fit.evidence)):
        return None
    offers = sorted(_offers(fit, kinetic), key=lambda offer: -offer.worth)
    posed = [offered(search, offer) for offer in offers[:_PROFILED] if offer.worth > 0.0]
    points = [(point.score, at.at(point.values)) for at in posed for point in places(at, _STARTS)[:1]]
    begun = [at for _, at in sorted(points, key=lambda pair: pair[0])[:_SEARCHED]]
    searched = [searched_with(at, weak_start, shape_fit) for at in begun]
    for at in sorted(searched, key=lambda at: -value(at.found)):
        if value(at.found) <= value(fit):
            break
        # on knots for the motion of another law, the right one may be off
        found = searched_with(at, finer_knots, shape_fit, feeding_friction).found
        used = {*found.problem.shapes_of(found.structure)} - {*fit.problem.ranges}
        holds = found.converged and equations_hold(found)
        if used and holds and not doubts_about_the_form(found, search.relevance):
            return found, sorted(used)
    return None


def _offer(fit: Fit, terms: list[Term], ranges: Mapping[str, ShapeRange]) -> Offer:
    """The numbers with which −2 log likelihood falls the most, and by how much, less what they cost."""
    starts = list(shape_starts(ranges, _STARTS))
    base = [fit.problem.terms[m] for m in fit.structure]
    plain: Mapping[str, float] = {}
    numbers = [*[plain] * len(base), *(start for start in starts for _ in terms)]
    gains = gains_beside(fit, fit.problem.candidates.of([*base, *terms * len(starts)], numbers), len(terms))
    best = int(np.argmax(gains))
    return Offer(
        [term.at(starts[best]) for term in terms],
        ranges,
        gains[best] - penalty(fit.grid) * (len(terms) + len(ranges)),
    )
