"""The weak form as a function of the shape parameters: how well any numbers explain the rows.

Rows of candidates without shape parameters are made once.  For numbers κ only the columns φ(κ) are made anew,
and a search for a support tells how well noise explains what is left.  About a support, tangents are columns
too, and their coefficients a step of κ (Gauss–Newton on the ratio ρ).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from leastaction.curve.smoothing import Smooth
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Problem
from leastaction.library import Term, shape_names, tangent
from leastaction.selection.likelihood_search import term_penalty
from leastaction.selection.settings import SELECTION
from leastaction.selection.weak_backward import backward_search
from leastaction.selection.weak_form import WeakForm, WeakGram, weak_form, weak_gram, weak_replicates
from leastaction.selection.weak_search import ScaledGram, Support, choose, solve_support, support_score

__all__ = ["Kind", "Profile", "ProfilePoint"]

_BEAM = 1  # supports kept of each size
_FEW = 3  # replicates, for a first look
_GROWTH = 1.5  # of the number of plain candidates from one level to the next, at least
_STEPS = 12  # Gauss–Newton, at most
_SHARES = (1.0, 0.3, 0.1, 0.03)  # of a step, tried in turn
_GAIN = 1e-3  # of log ρ: less is no progress
_COLUMNS = 128  # made at once: bounds memory
_LARGEST = 1e120  # of a column: squares, summed over the rows, remain finite
_UNEXPLAINED = 1.0  # equation error: with it, and without noise, ρ is the unexplained share of the rows


@dataclass(frozen=True)
class Kind:
    """Candidates that differ in the names of their own numbers alone, and where these may be.

    Attributes
    ----------
    alike : mapping of int to mapping
        Candidates → how each calls what the first has a name for, see `leastaction.library.alike`.
    starts : sequence of mapping
        Numbers, by the names of the first.
    """

    alike: Mapping[int, Mapping[str, str]]
    starts: Sequence[Mapping[str, float]]

    def called(self, chosen: Sequence[int]) -> dict[str, float]:
        """Some of the starts by the names of the candidates, ordered by their numbers."""
        places = sorted((self.starts[k] for k in chosen), key=lambda place: [*place.values()])
        pairs = zip(self.alike.values(), places, strict=True)
        return {names[name]: x for names, place in pairs for name, x in place.items()}


@dataclass(frozen=True, eq=False)
class ProfilePoint:
    """Numbers of shape parameters and how well they explain the rows.

    Attributes
    ----------
    values : mapping of str to float
    gram : WeakGram
        Of the plain candidates, then the free bearers.
    members : tuple of int
        Columns of the gram that are used.
    ratio : float
        ρ with these columns.
    score : float
        Of these columns, or of the best support where one was searched; less is better.
    """

    values: Mapping[str, float]
    gram: WeakGram
    members: tuple[int, ...]
    ratio: float
    score: float


@dataclass(frozen=True, eq=False)
class _Rows:
    """Two parts of the rows along the curve, and the rows along each replicate; known column last."""

    inertial: np.ndarray
    potential: np.ndarray
    replicates: list[np.ndarray]

    def beside(self, more: _Rows) -> _Rows:
        """Free columns of both, then the sum of what is known."""
        pairs = zip(self.replicates, more.replicates, strict=False)  # of few, if one has few
        return _Rows(
            _joined(self.inertial, more.inertial),
            _joined(self.potential, more.potential),
            [_joined(a, b) for a, b in pairs],
        )

    def defined(self) -> np.ndarray:
        """Whether each column, and its square, is finite everywhere."""
        parts = (self.inertial, self.potential, *self.replicates)
        return np.logical_and.reduce([(np.abs(rows) < _LARGEST).all(axis=0) for rows in parts])

    def of(self, columns: np.ndarray) -> _Rows:
        """Some of the columns."""
        replicates = [r[:, columns] for r in self.replicates]
        return _Rows(self.inertial[:, columns], self.potential[:, columns], replicates)

    def gram(self) -> WeakGram:
        """Quadratic forms over all rows; without replicates there is no noise."""
        count = len(self.replicates)
        if not count:
            row = self.inertial + self.potential
            size = 0.5 * (self.inertial.T @ self.inertial + self.potential.T @ self.potential)
            return WeakGram(row.T @ row, np.zeros_like(size), size, row.shape[0])
        mean = sum(self.replicates) / count
        square = sum(r.T @ r for r in self.replicates)
        return weak_gram(self.inertial, self.potential, mean, square, count)  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Look:
    """What ρ allows for: the squared error of the equations, and how many replicates tell of the noise."""

    error: float
    replicates: int | None

    def support(self, gram: WeakGram, members: tuple[int, ...]) -> Support:
        """Some columns and their ρ."""
        return Support(members, ScaledGram(gram, self.error).ratio(members))


def _joined(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.concatenate([a[:, :-1], b[:, :-1], a[:, -1:] + b[:, -1:]], axis=1)


def _levels(terms: Sequence[Term]) -> list[tuple[int, ...]]:
    """None of the terms, then ever more, the simplest first.

    Beside many terms, numbers that are a little off are as bad as any: the others imitate whatever the right
    ones explain, and only at these does it fit. Beside few, the way there is smooth.
    """
    size = np.array([term.expr.count_ops() for term in terms], dtype=int)
    levels: list[tuple[int, ...]] = [()]
    for limit in np.unique(size):
        inside = tuple(np.flatnonzero(size <= limit).tolist())
        if len(inside) >= _GROWTH * len(levels[-1]) or limit == size.max():
            levels.append(inside)
    return levels


class Profile:
    """The weak form of a problem with shape parameters, along one smooth curve.

    Parameters
    ----------
    grid : Grid
    curve : Smooth
    seed : int
        Of the noise of the replicates.
    """

    def __init__(self, grid: Grid, curve: Smooth, seed: int) -> None:
        self.problem: Problem = grid.problem
        terms = self.problem.terms
        free: list[int] = self.problem.free.tolist()
        self.plain: list[int] = [k for k in free if not terms[k].shapes]
        fixed = [k for k in range(len(terms)) if self.problem.is_known[k] and not terms[k].shapes]
        index = [*self.plain, *fixed]
        known = np.append(np.full(len(self.plain), np.nan), self.problem.known[fixed])
        waves = any(where.spacing == "frequency" for where in self.problem.ranges.values())
        self._form = weak_form(grid, curve, self.problem.candidates.subset(index), known, (1.0,), waves)
        curves = (curve.control_points, *weak_replicates(grid, curve, seed))
        self._states = [list(self._form.states(each)) for each in curves]
        self._rows = self._made(self._form)
        self._levels = _levels([terms[k] for k in self.plain])

    def point(self, values: Mapping[str, float], bearers: Sequence[int]) -> list[ProfilePoint]:
        """Numbers for the shape parameters of some candidates, the bearers, beside ever more plain ones.

        A first look, with few replicates of the noise. Empty where a candidate is undefined along the curve.
        """
        gram = self._gram(values, bearers, (), _FEW)
        if gram is None:
            return []
        look, first = _Look(SELECTION.not_followed, _FEW), len(self.plain)
        scaled = ScaledGram(gram, look.error)
        own = tuple(range(first, first + len(self._free(bearers))))
        supports = [(*level, *own) for level in self._levels]
        return [self._valued(values, gram, Support(m, scaled.ratio(m)), look) for m in supports if m]

    def chosen(
        self, kinds: Sequence[Kind], values: Mapping[str, float], bearers: Sequence[int]
    ) -> list[list[ProfilePoint]]:
        """Numbers for candidates of some kinds, found all at once.

        Placed one after the other, the first would go where it does best without the others.  Columns are
        made at all of the starts, and of each kind as many chosen as there are candidates.

        Parameters
        ----------
        kinds : sequence of Kind
        values : mapping of str to float
            Of all other shape parameters.
        bearers : sequence of int
            All candidates with numbers, these and those of ``values``.

        Returns
        -------
        list of list of ProfilePoint
            Beside ever more plain candidates, as from `point`, but not beside none where there are some; the
            ratios allow for what a grid misses.
        """
        beside = [k for k in bearers if not any(k in kind.alike for kind in kinds)]
        rows = self._rows.beside(self._columns(beside, values, [], [], 0)) if beside else self._rows
        if not rows.defined().all():
            return []
        edge = rows.inertial.shape[1] - 1
        own = range(len(self.plain), edge)
        defined: list[tuple[Kind, range]] = []
        for kind in kinds:
            made, starts = self._at_starts(kind, values)
            if len(starts) < len(kind.alike):
                return []
            rows = rows.beside(made)
            defined.append((replace(kind, starts=starts), range(edge, edge + len(starts))))
            edge += len(starts)
        look, scaled = _Look(_UNEXPLAINED, 0), ScaledGram(rows.gram(), _UNEXPLAINED)
        free = range(len(self.plain), len(self.plain) + len(self._free(bearers)))
        counts = [(columns, len(kind.alike)) for kind, columns in defined]
        out: list[list[ProfilePoint]] = []
        for level in self._levels[1:] or self._levels:
            out.append([])
            for support in choose(scaled, (*level, *own), counts):
                called: dict[str, float] = {}
                for kind, columns in defined:
                    called |= kind.called([m - columns.start for m in support.members if m in columns])
                gram = self._gram({**values, **called}, bearers, (), 0)
                if gram is not None:
                    same = Support((*level, *free), support.ratio)
                    out[-1].append(self._valued({**values, **called}, gram, same, look))
        return out

    def _at_starts(
        self, kind: Kind, values: Mapping[str, float]
    ) -> tuple[_Rows, Sequence[Mapping[str, float]]]:
        """Rows of the first candidate of a kind at all starts where it is defined, and these."""
        first = self.problem.terms[next(iter(kind.alike))]
        parts = [kind.starts[at : at + _COLUMNS] for at in range(0, len(kind.starts), _COLUMNS)]
        made = [self._columns([], values, [first] * len(part), part, 0) for part in parts]
        rows = reduce(_Rows.beside, made)
        defined = rows.defined()
        starts = [start for start, is_defined in zip(kind.starts, defined[:-1], strict=True) if is_defined]
        return rows.of(defined), starts

    def searched(self, point: ProfilePoint) -> ProfilePoint:
        """The point with the best support of all candidates."""
        n_rows, price = self._counts(point.gram)
        levels = backward_search(point.gram, SELECTION.not_followed, price, n_rows, _BEAM)
        best = min((s for level in levels for s in level), key=lambda s: support_score(s, price, n_rows))
        return self._valued(point.values, point.gram, best, _Look(SELECTION.not_followed, None))

    def _valued(
        self, values: Mapping[str, float], gram: WeakGram, support: Support, look: _Look
    ) -> ProfilePoint:
        """Numbers with their columns, and how well these explain the rows.

        Other numbers make the noise of the rows another, so that its size is part of their likelihood:
        a steep term at the edge of the motion explains nothing but itself, and with its own noise.  A number
        costs as much as a term.
        """
        n_rows, price = self._counts(gram)
        vector = np.append(solve_support(gram, look.error, support.members), 1.0)
        share = float(vector @ gram.residual @ vector / (vector @ gram.size @ vector))
        noise = share / support.ratio if look.replicates != 0 else 0.0
        score = np.inf  # rounding is all that is left of columns that cancel
        if share > 0.0:
            score = n_rows * float(np.log(max(share, noise))) + price * (len(support.members) + len(values))
        return ProfilePoint(dict(values), gram, support.members, support.ratio, score)

    def refined(self, point: ProfilePoint, bearers: Sequence[int], roughly: bool = False) -> ProfilePoint:
        """The point moved by Gauss–Newton steps, its columns held, with all noise accounted for.

        Roughly, only the unexplained share of the rows counts: far from the law, numbers that catch much
        noise seem to explain more.
        """
        look = _Look(_UNEXPLAINED, 0) if roughly else _Look(SELECTION.not_followed, None)
        gram = self._gram(point.values, bearers, (), look.replicates)
        if gram is None:
            return point
        point = self._valued(point.values, gram, look.support(gram, point.members), look)
        for _ in range(_STEPS):
            nearer = self._nearer(point, bearers, self._steps(point, bearers, look), look)
            if nearer is None:
                break
            gain, point = np.log(point.ratio / nearer.ratio), nearer
            if gain < _GAIN:
                break
        return point

    def _free(self, bearers: Sequence[int]) -> list[int]:
        return [k for k in bearers if not self.problem.is_known[k]]

    def _steps(self, point: ProfilePoint, bearers: Sequence[int], look: _Look) -> dict[str, float]:
        """Steps of the shape parameters, from their tangents."""
        coefficients = self.problem.completed(0.0)
        found = solve_support(point.gram, look.error, point.members)
        coefficients[[*self.plain, *self._free(bearers)]] = found
        held = [k for k in bearers if coefficients[k] != 0.0]
        terms = [self.problem.terms[k].at(point.values) for k in held]
        names = shape_names(terms)
        tangents = [tangent(terms, coefficients[held].tolist(), name) for name in names]
        wide = self._gram(point.values, bearers, tangents, look.replicates)
        if wide is None or not names:
            return {}
        first = point.gram.residual.shape[0] - 1
        members = (*point.members, *range(first, first + len(names)))
        return dict(zip(names, solve_support(wide, look.error, members)[first:].tolist(), strict=True))

    def _nearer(
        self, point: ProfilePoint, bearers: Sequence[int], steps: Mapping[str, float], look: _Look
    ) -> ProfilePoint | None:
        """The first point along the steps, shortened where needed, with a smaller ratio."""
        ranges = self.problem.ranges
        for share in _SHARES if steps else ():
            moved = {n: ranges[n].stepped(point.values[n], share * d) for n, d in steps.items()}
            values = {**point.values, **moved}
            gram = self._gram(values, bearers, (), look.replicates)
            if gram is None:
                continue
            support = look.support(gram, point.members)
            if support.ratio < point.ratio:
                return self._valued(values, gram, support, look)
        return None

    def _counts(self, gram: WeakGram) -> tuple[float, float]:
        """Independent rows, and the price of a term."""
        n_rows = max(gram.n_rows / SELECTION.overlap, 4.0)
        return n_rows, term_penalty(int(n_rows), self.problem.free.size)

    def _gram(
        self,
        values: Mapping[str, float],
        bearers: Sequence[int],
        tangents: Sequence[Term],
        most: int | None = None,
    ) -> WeakGram | None:
        """Quadratic forms over the plain candidates, the bearers and the tangents; None if undefined."""
        numbers: list[Mapping[str, float]] = [{} for _ in tangents]  # they have theirs
        rows = self._columns(bearers, values, tangents, numbers, most)
        return self._rows.beside(rows).gram() if rows.defined().all() else None

    def _columns(
        self,
        bearers: Sequence[int],
        values: Mapping[str, float],
        more: Sequence[Term],
        numbers: Sequence[Mapping[str, float]],
        most: int | None,
    ) -> _Rows:
        """Rows of the bearers, and of more terms with numbers of their own."""
        terms = [*(self.problem.terms[k] for k in bearers), *more]
        known = np.append(self.problem.known[list(bearers)], np.full(len(more), np.nan))
        each = [*[values] * len(bearers), *({**values, **own} if own else {} for own in numbers)]
        return self._made(self._form.of(self.problem.candidates.of(terms, each), known), most)

    def _made(self, form: WeakForm, most: int | None = None) -> _Rows:
        """Rows along the curve and its replicates, or the first few of them."""
        first, *others = self._states
        inertial, potential = form.rows(first)[0]
        again = (form.rows(states)[0] for states in others[:most])
        return _Rows(inertial, potential, [i + v for i, v in again])
