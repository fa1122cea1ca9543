"""Families of terms with shape parameters that nobody offered, and searches with the best of them.

Over one position the families are exponentials, wells, barriers, softened distances and powers.  Over several
they are exponentials of all positions and of their differences, with one rate, and functions of the distance
to the origin, to one unknown point or to three.  Angles have none: their waves are in every library.

For the numbers κ of a family a profile of the weak form is computed, and the families that it finds the
simplest laws with are searched with.  Where candidates imitate a law its own terms have nothing to gain
beside them, so the profile is computed beside short candidates only.  That takes a search or two whether or
not a family helps.  A check of a law of one coordinate therefore first scores all families on the quadratic
model of the likelihood about the fit, and profiles those whose gain is worth their price.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import ModuleType

import numpy as np
import sympy as sp

from leastaction.estimation.fit import Fit
from leastaction.estimation.problem import Problem
from leastaction.estimation.shape_ranges import ShapeRange, shape_ranges, shape_starts
from leastaction.library import Term, make_term, shape_names
from leastaction.library.grammar import size_of
from leastaction.selection.likelihood_refinement import gains_beside, penalty
from leastaction.selection.progress import silent
from leastaction.selection.search_state import Search, equations_hold
from leastaction.selection.settings import SELECTION
from leastaction.selection.strategies import shape_fit, weak_start
from leastaction.selection.strategies.shape_start import places
from leastaction.selection.weak_proposals import explicable

__all__ = [
    "Offer",
    "helpful_families",
    "looks_imitated",
    "offered",
    "replacing_families",
    "searched_with",
]

_STARTS = 64  # values tried for a family with several shape parameters
_PLACES = 512  # the same where several unknown points are placed together
_PROFILED = 5  # families of one coordinate whose shape parameters are estimated on the weak form
_SEARCHED = 2  # families for which a full search is run
_CENTRES = 3  # unknown points located together
_COORDINATES = 3  # of more, a search with a family takes minutes: not where the equations hold
_SHORT = 2  # size of the candidates beside which the families of several coordinates are profiled

# of one coordinate X, in L and times X_dot**2
_LINE = (
    ("exp(-{a}*X)",),
    ("exp(-{a}*X)", "exp(-2*{a}*X)"),
    ("exp(-((X-{p})/{w})**2)",),
    ("sqrt((X-{p})**2+{h}**2)",),
    ("1/sqrt((X-{p})**2+{h}**2)",),
    ("log((X-{p})**2+{h}**2)",),
    ("cos({k}*X)", "sin({k}*X)"),
)
_EACH = _LINE[:2]  # of each of several positions
_POSITIVE = (("X**{n}",), ("X**{n}", "X**{m}"))
_BOTH_SIGNS = (("abs(X)**{n}",),)
_ORIGIN = ("(R)**{n}", "exp(-{a}*sqrt(R))", "exp(-{a}*(R))")  # of the squared distance R to the origin
# of the squared distance R to an unknown point
_CENTRE = ("1/sqrt(R+{h}**2)", "sqrt(R)", "log(R+{h}**2)", "exp(-(R)/{w}**2)")
_POINT = ("p", "r", "s")  # names of the coordinates of an unknown point


@dataclass(frozen=True)
class Offer:
    """Terms with unknown numbers that belong together.

    Attributes
    ----------
    terms : sequence of Term
        With the best of their numbers, or with some.
    ranges : mapping of str to ShapeRange
        Where to look for better ones.
    worth : float
        By how much −2 log likelihood falls with them, less what they cost or chance gives; 0: not known.
    """

    terms: Sequence[Term]
    ranges: Mapping[str, ShapeRange]
    worth: float = 0.0

    def added(self, problem: Problem) -> Problem:
        """A problem with the offer among its candidates."""
        return replace(problem.wider(self.terms), ranges={**problem.ranges, **self.ranges})


def offered(search: Search, offer: Offer) -> Search:
    """A new search on the grid of the fit, with an offer among its candidates."""
    on = replace(search, grid=search.found.grid, report=silent).posed(offer.added)
    return replace(on, curve=on.grid.smooth(), fit=None, feeding=())


def searched_with(search: Search, *strategies: ModuleType) -> Search:
    """Run a few strategies in turn."""
    for strategy in strategies:
        search = strategy.run(search)
    return search


def helpful_families(search: Search, kinetic: bool = False) -> Iterator[Search]:
    """Searches with the families that promise to help a law, each with what it found, one after another.

    Families of one coordinate are scored beside the terms of the law, those of several take the place of
    long candidates.  With ``kinetic`` they are masses that depend on the one coordinate.
    """
    fit = search.found
    if len(fit.problem.coordinates) > 1:
        yield from replacing_families(search)
    elif fit.converged and np.isfinite(fit.evidence):
        states = _states(fit)
        some = _families(fit, states, _of_one(_positions(fit), states), kinetic)
        offers = sorted((_scored(fit, *family) for family in some), key=lambda offer: -offer.worth)
        posed = [offered(search, offer) for offer in offers[:_PROFILED] if offer.worth > 0.0]
        yield from _searched(posed, fit)


def replacing_families(search: Search, alone: bool = False) -> Iterator[Search]:
    """Searches with the best families in place of the candidates that may imitate them.

    Distances to unknown points cost the most to place: they come last, and only where the equations do not
    hold.  With ``alone`` a family takes the place of all terms that hold positions only, of springs, too:
    beside these, a Morse potential fits best with two or three times its own rate.
    """
    fit = search.found
    holds, n_coordinates = equations_hold(fit), len(fit.problem.coordinates)
    if not (fit.converged and np.isfinite(fit.evidence)) or (holds and n_coordinates > _COORDINATES):
        return
    states, positions, short = _states(fit), _positions(fit), _short(fit, alone)
    rounds = [_of_one(positions, states) if n_coordinates == 1 else _of_several(positions, states)]
    if 1 < len(positions) <= len(_POINT) and not holds and not alone:
        rounds.append(_of_distances(positions))
    for texts in rounds:
        offers = [_unscored(*family) for family in _families(fit, states, texts)]
        posed = [offered(search, offer).posed(short) for offer in offers]
        # of several coordinates, the weak form hardly distinguishes a good imitation from the law
        many = holds and n_coordinates > 1 and not alone
        yield from _searched(posed, fit, 2 * _SEARCHED if many else _SEARCHED)


def looks_imitated(fit: Fit, most: int | None = None) -> bool:
    """Whether a law may imitate a shorter one: a long potential, or a mass that depends on its own position.

    A potential is long if more than ``most`` of its terms go beyond the second degree; by default, more than
    the setting ``plain_terms``.

    Products and powers imitate; sums, as in distances to a known point, somebody chose.  A law with shape
    parameters is what a family says.
    """
    if fit.problem.shapes_of(fit.structure):
        return False
    positions = {*_positions(fit)}
    terms = [fit.problem.terms[k].expr for k in fit.structure if fit.problem.terms[k].kind == "lagrangian"]
    long, moving = 0, False
    for expr in terms:
        names = {str(symbol) for symbol in expr.free_symbols}
        long += names <= positions and not expr.has(sp.Add) and not _quadratic(expr)
        # r**2*phi_dot**2 is a genuine mass term; x**2*x_dot**2 may only imitate a curved path
        bent = any({name, f"{name}_dot"} <= names for name in positions)
        moving |= bent and bool(expr.is_polynomial(*expr.free_symbols))
    return long > (SELECTION.plain_terms if most is None else most) or moving


def _quadratic(expr: sp.Expr) -> bool:
    """Whether an expression is a polynomial of the second degree at most, as springs are."""
    symbols = sorted(expr.free_symbols, key=str)
    return bool(expr.is_polynomial(*symbols)) and sp.Poly(expr, *symbols).total_degree() <= 2


def _searched(posed: Sequence[Search], fit: Fit, most: int = _SEARCHED) -> Iterator[Search]:
    """Search with the families of highest worth, where the library has equations that hold with them."""
    points = [
        (point.score, at.at(point.values)) for at in posed for point in places(at, _starts(at, fit))[:1]
    ]
    for _, at in sorted(points, key=lambda pair: pair[0])[:most]:
        whole = _with_all(at, fit)
        if explicable(whole.grid, whole.curve, whole.seed):
            yield _with_all(searched_with(at, weak_start, shape_fit), fit)


def _starts(search: Search, fit: Fit) -> int:
    """How many values to try: with few, several points end in a pattern that imitates theirs."""
    several = len(search.problem.ranges) - len(fit.problem.ranges) > len(_POINT) + 1
    return _PLACES if several else _STARTS


def _short(fit: Fit, alone: bool) -> Callable[[Problem], Problem]:
    """What leaves a problem its short candidates, and those of a structure that hold rates or angles.

    Polynomials of higher degree, roots and inverses of positions are left out: they would imitate a family.
    With ``alone``, so are all others of positions only.
    """
    problem = fit.problem
    positions = {*_positions(fit)}
    out: list[int] = []
    free: list[int] = problem.free.tolist()
    for k in free:
        expr = problem.terms[k].expr
        symbols = [symbol for symbol in expr.free_symbols if str(symbol) in positions]
        needed = k in fit.structure and len(symbols) < len(expr.free_symbols)
        still = alone and len(symbols) == len(expr.free_symbols)
        short = size_of(expr) <= _SHORT and expr.is_polynomial(*symbols) and not still
        if not (needed or short or problem.terms[k].kind == "dissipation"):
            out.append(k)
    return lambda problem: problem.excluding(out)


def _with_all(search: Search, fit: Fit) -> Search:
    """The search with all candidates restored, except those excluded from a fit."""
    whole = search.posed(lambda problem: replace(problem, excluded=fit.problem.excluded))
    return whole if whole.fit is None else replace(whole, fit=replace(whole.fit, grid=whole.grid))


def _positions(fit: Fit) -> list[str]:
    """Coordinates that are no angles."""
    return [name for name in fit.problem.coordinates if name not in fit.problem.candidates.turning]


def _states(fit: Fit) -> dict[str, np.ndarray]:
    """Coordinates and velocities along the motion, by name."""
    names = fit.problem.coordinates
    symbols = [*names, *(f"{name}_dot" for name in names)]
    return dict(zip(symbols, map(np.asarray, fit.points().columns), strict=False))


def _families(
    fit: Fit, states: Mapping[str, np.ndarray], texts: Iterable[list[str]], kinetic: bool = False
) -> Iterator[tuple[list[Term], Mapping[str, ShapeRange]]]:
    """Families as terms, with ranges of their numbers; without those whose names are taken."""
    factor = f"{fit.problem.coordinates[0]}_dot**2*" if kinetic else ""
    for family in texts:
        terms = [make_term(factor + text, list(states)) for text in family]
        if {*shape_names(terms)} & {*fit.problem.ranges}:
            continue
        ranges = shape_ranges(terms, states, {})
        if any("abs(" in text for text in family):  # infinite where the coordinate changes its sign
            least = SELECTION.lowest_exponent
            ranges = {n: replace(found, low=least, bounded=True) for n, found in ranges.items()}
        yield terms, ranges


def _of_one(positions: Sequence[str], states: Mapping[str, np.ndarray]) -> Iterator[list[str]]:
    """Families as text: of one coordinate that is not an angle."""
    for name in positions:
        powers = _POSITIVE if states[name].min() > 0.0 else _BOTH_SIGNS
        yield from ([text.replace("X", name) for text in texts] for texts in (*_LINE, *powers))


def _of_several(positions: Sequence[str], states: Mapping[str, np.ndarray]) -> Iterator[list[str]]:
    """Of each of several positions, of their distance to the origin, and exponentials with one rate."""
    for name in positions:
        powers = _POSITIVE if states[name].min() > 0.0 else ()
        yield from ([text.replace("X", name) for text in texts] for texts in (*_EACH, *powers))
    if len(positions) > 1:
        gaps = [f"({a}-{b})" for a, b in pairwise(positions)]
        yield [f"exp({sign}{{a}}*{u})" for u in (*positions, *gaps) for sign in ("", "-")]
        square = "+".join(f"{name}**2" for name in positions)
        yield from ([text.replace("R", square)] for text in _ORIGIN)


def _of_distances(positions: Sequence[str]) -> Iterator[list[str]]:
    """Of the distance to an unknown point, or to several."""
    letters = [letter if letter not in positions else f"{letter}0" for letter in _POINT]

    def distance(number: str) -> str:
        pairs = zip(positions, letters, strict=False)
        return "+".join(f"({name}-{{{letter}{number}}})**2" for name, letter in pairs)

    for text in _CENTRE:
        yield [text.replace("R", distance(""))]
    yield [_CENTRE[0].replace("R", distance(str(k + 1))) for k in range(_CENTRES)]


def _unscored(terms: list[Term], ranges: Mapping[str, ShapeRange]) -> Offer:
    """A family with numbers in the middle of their ranges."""
    middle = {name: found.at(0.5) for name, found in ranges.items()}
    return Offer([term.at(middle) for term in terms], ranges)


def _scored(fit: Fit, terms: list[Term], ranges: Mapping[str, ShapeRange]) -> Offer:
    """The numbers with which −2 log likelihood falls the most, and by how much, less what they cost."""
    starts = list(shape_starts(ranges, _STARTS))
    base = [fit.problem.terms[m] for m in fit.structure]
    plain: Mapping[str, float] = {}
    numbers = [*[plain] * len(base), *(start for start in starts for _ in terms)]
    gains = gains_beside(fit, fit.problem.candidates.of([*base, *terms * len(starts)], numbers), len(terms))
    best = int(np.argmax(gains))
    worth = float(gains[best]) - penalty(fit.grid) * (len(terms) + len(ranges))
    return Offer([term.at(starts[best]) for term in terms], ranges, worth)
