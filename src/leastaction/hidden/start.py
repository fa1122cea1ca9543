"""Start values of a fit with hidden coordinates.

1. Many sets of coefficients are drawn. Each is tried in short windows, from many hidden states. Then
   coefficients and states are fitted together.
2. The best sets are fitted in more and longer windows, in which fewer of them follow the measured motion.
3. More sets are drawn until the best law follows the measured motion closely, or two sets end at it. If
   several follow closely, longer windows tell them apart. A strict search goes on until a law follows there.
4. The best law is fitted in windows that cover every trajectory, and their motions are chained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp

from leastaction.curve.knots import lay_knots
from leastaction.curve.smoothing import Smooth
from leastaction.data.coerce import arranged
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.estimation.hidden import knots_of_all, lacking
from leastaction.estimation.problem import Problem
from leastaction.estimation.structure import Structure
from leastaction.hidden.chain import Chained, chain, continued, preceding
from leastaction.hidden.draws import draw_begins, draw_coefficients, scales_of, signs_without, term_sizes
from leastaction.hidden.gauge import canonical
from leastaction.hidden.settings import HIDDEN
from leastaction.hidden.shooting import Shooter
from leastaction.hidden.windows import Solutions, Windows, cut_windows
from leastaction.mechanics.equations import Mechanics

__all__ = ["HiddenStart", "completed", "find_start", "follow_again", "law_of"]


@dataclass(frozen=True, eq=False)
class HiddenStart:
    """Start values of coefficients and motion.

    Attributes
    ----------
    coefficients : (n_candidates,) array
        Of all candidates, known ones included.
    motions : list of (n_times, n_hidden) arrays
        Hidden coordinates at the samples of each trajectory.
    confirmed : bool
        Whether two independent draws led to the same law, or one law stands out.
    jump : float
        Largest jump of the motion between windows, in scales of the hidden state.
    """

    coefficients: np.ndarray
    motions: list[np.ndarray]
    confirmed: bool
    jump: float

    def in_place(self, problem: Problem) -> Trajectories:
        """The data, with this motion for the hidden coordinates."""
        items: list[Trajectory] = []
        for trajectory, motion in zip(problem.trajectories, self.motions, strict=True):
            q = trajectory.q.copy()
            q[:, list(problem.hidden)] = motion
            items.append(trajectory.changed(q=q))
        return Trajectories(items)


def find_start(
    problem: Problem,
    structure: Structure,
    smooth: Smooth,
    period: float,
    seed: int = 0,
    *,
    strict: bool = False,
) -> HiddenStart:
    """Search for coefficients of a structure and for the motion of the hidden coordinates.

    Parameters
    ----------
    problem : Problem
    structure : Structure
        Its members have unknown coefficients; dissipation starts at zero.
    smooth : Smooth
        The smooth curve through the samples; its hidden coordinates are not used.
    period : float
        Period of the measured motion, in seconds.
    seed : int
    strict : bool
        Draw more sets unless a law follows the measured motion in longer windows, too.
    """
    hunt = _Hunt(problem, list(structure), smooth, period, np.random.default_rng(seed))
    pool, batches = hunt.drawn(), hunt.batches
    spare: list[Solutions] = []
    for attempt in range(batches):
        found = hunt.fitted(pool, *hunt.larger(HIDDEN.last))
        close = found.following(HIDDEN.closely)
        follow = bool(found.best(1).typical[0] <= HIDDEN.follows)
        agree = follow and _agree(problem, hunt.members, found, hunt.sizes)
        tested = _tested(hunt, close) if strict or _several(hunt, close) else close
        passed = tested.following(HIDDEN.closely)
        confirmed = bool(len(passed)) or agree or (bool(len(close)) and not strict)
        if confirmed:
            break
        if len(close):
            spare.append(tested.best(1))
        if attempt < batches - 1:
            pool = _joined(found, hunt.drawn())
    confirmed = confirmed or (follow and _stands_out(found))
    if not len(passed):
        passed = found if agree or not spare else min(spare, key=lambda laws: laws.cost[0])
    return _started(hunt, passed.best(1).coefficients, confirmed)


def _tested(hunt: _Hunt, laws: Solutions) -> Solutions:
    """Laws fitted in longer windows, which grow while several of them follow.

    Over 1.3 periods, another law may follow as closely as the right one.
    """
    factor, *numbers = hunt.larger(HIDDEN.last)
    tested = laws
    for further in range(HIDDEN.doublings if len(laws) else 0):
        factor *= 2.0
        longer = hunt.fitted(laws, factor, *numbers)
        laws = longer.following(HIDDEN.closely)
        if len(laws) or not further:
            tested = longer
        if not _several(hunt, laws):
            break
    return tested


def _several(hunt: _Hunt, laws: Solutions) -> bool:
    return len(laws) > 1 and not _agree(hunt.problem, hunt.members, laws, hunt.sizes)


def follow_again(
    problem: Problem, structure: Structure, smooth: Smooth, period: float, coefficients: np.ndarray
) -> HiddenStart:
    """Chain the motions of a law again, because some trials of its fit may be on a wrong branch.

    Parameters
    ----------
    problem, structure, smooth, period
        As for `find_start`.
    coefficients : (n_candidates,) array
        Coefficients of the law.
    """
    hunt = _Hunt(problem, list(structure), smooth, period, np.random.default_rng(1))
    return _started(hunt, coefficients[None, hunt.members], confirmed=True)


def completed(
    problem: Problem, structure: Structure, period: float, coefficients: np.ndarray
) -> Trajectories:
    """The data, with the motion of a given law for coordinates that have a sensor in other trials only.

    Parameters
    ----------
    problem : Problem
    structure : Structure
    period : float
        Of the motion, in seconds.
    coefficients : (n_candidates,) array
    """
    if not any(map(lacking, problem.trajectories)):
        return problem.trajectories
    items: list[Trajectory] = []
    for item in problem.trajectories:
        missing = lacking(item)
        alone, q = Trajectories([item]), item.q.copy()
        if missing and len(missing) < item.n_dof:
            seen = arranged(alone, [name for i, name in enumerate(item.coordinates) if i not in missing])
            knots = knots_of_all(lay_knots(seen, problem.degree), missing)
            one = replace(problem.on(alone), hidden=missing)
            hunt = _Hunt(one, list(structure), knots.smooth, period, np.random.default_rng(1))
            q[:, list(missing)] = hunt.followed(coefficients[None, list(structure)]).values[0]
        items.append(item.changed(q=q))
    return Trajectories(items)


def _started(hunt: _Hunt, given: np.ndarray, confirmed: bool) -> HiddenStart:
    """The motion of one law, (1, n_members) coefficients, with the conventional signs and zeros."""
    problem, nothing = hunt.problem, np.zeros((1, 0))
    values, chained = hunt.everywhere(Solutions(given, nothing, nothing))
    coefficients, motions = problem.completed(values), chained.values
    for change in canonical(problem, hunt.members, coefficients):
        coefficients = coefficients * np.where(change.signs == -1.0, -1.0, 1.0)
        column = problem.hidden.index(change.coordinate)
        for motion in motions:
            motion[:, column] = change.moved(motion[:, column])
    return HiddenStart(coefficients, motions, confirmed, chained.jump)


class _Hunt:
    """A search for one structure: its law, scales of the motion, and windows of any length."""

    def __init__(
        self, problem: Problem, members: list[int], smooth: Smooth, period: float, rng: np.random.Generator
    ) -> None:
        self.problem, self.smooth, self.period, self.rng = problem, smooth, period, rng
        self.all_members = members
        self.members = [k for k in members if problem.terms[k].kind == "lagrangian"]
        self.mechanics = law_of(problem, self.members)
        self.first = self.windows(*HIDDEN.stages[0][:2])
        self.scales = scales_of(problem, self.first, period)
        self.sizes = term_sizes(problem, self.first, self.scales, rng)

    @cached_property
    def signs(self) -> np.ndarray:
        """(n_members,) signs that a regression gives; only draws need them."""
        return signs_without(self.problem, self.members, self.windows(*HIDDEN.last[:2]))

    def windows(self, factor: float, most: int | None) -> Windows:
        """Windows of ``factor`` times the first length."""
        seconds = factor * HIDDEN.first_window * self.period
        most = None if most is None else int(most * self._growth)
        step = HIDDEN.step if factor >= HIDDEN.last[0] else HIDDEN.coarse_step
        return cut_windows(self.problem, self.smooth, seconds, step * self.period, most)

    @property
    def _growth(self) -> float:
        return max(1.0, len(self.members) / HIDDEN.few_terms)

    @property
    def batches(self) -> int:
        """Largest number of draws."""
        least, most = HIDDEN.batches
        return max(least, int(most / self._growth**2))

    def larger(self, stage: tuple[float, int, int, int]) -> tuple[float, int, int, int]:
        """A stage with the numbers of sets and steps for all terms."""
        factor, most, sets, rounds = stage
        return factor, most, int(sets * self._growth), int(rounds * self._growth)

    def drawn(self) -> Solutions:
        """The best of many draws after all stages except the last."""
        sizes = self.sizes[self.members]
        given = draw_coefficients(
            self.problem, self.members, sizes, self.signs, self.first, self.scales, self.rng
        )
        nothing = np.zeros((len(given), 0))
        found = self.fitted(Solutions(given, nothing, nothing), *HIDDEN.stages[0])
        for stage in HIDDEN.stages[1:]:
            found = self.fitted(found, *self.larger(stage))
        return found

    def fitted(self, given: Solutions, factor: float, most: int, sets: int, rounds: int) -> Solutions:
        """The best sets, started again and fitted in other windows."""
        shooter = Shooter(self.mechanics, self.windows(factor, most), self.scales.unit)
        coefficients = given.best(sets).coefficients
        begins = np.stack([self._begins()] * len(coefficients))
        screened = shooter.screen(coefficients, begins, HIDDEN.kept, HIDDEN.state_rounds, _doublings(factor))
        return shooter.fit(screened.of_windows(len(shooter.windows)), self.sizes[self.members], rounds)

    def everywhere(self, given: Solutions) -> tuple[np.ndarray, Chained]:
        """(n_candidates,) coefficients of one set, and its motion along every trajectory.

        Motions are chained, fitted with all coefficients including dissipation, and chained again.
        """
        members, shooter = self.all_members, self._shooter()
        values = np.zeros(len(self.problem.candidates))
        values[self.members] = given.coefficients[0]
        found = self._branches(shooter, values[None, members])
        fitted = shooter.fit(self._chained(shooter, found).chosen, self.sizes[members], HIDDEN.last[3])
        values[members] = fitted.coefficients[0]
        return values, self._along(shooter, replace(found, coefficients=fitted.coefficients))

    def followed(self, coefficients: np.ndarray) -> Chained:
        """The motion of a law along every trajectory, its (1, n_members) coefficients held."""
        shooter = self._shooter()
        return self._along(shooter, self._branches(shooter, coefficients))

    def _along(self, shooter: Shooter, near: Solutions) -> Chained:
        """The motion of a law, from solutions near its own; if it jumps, more are searched for."""
        n_windows = len(shooter.windows)
        best = near.of_windows(n_windows, HIDDEN.branches)
        owner = np.repeat(np.arange(n_windows), best.deviation.shape[1] // n_windows)
        found = shooter.fit_states(best.coefficients, best.states, owner, _ROUNDS)
        found = found.beside(preceding(shooter, found, _ROUNDS, _DOUBLINGS), n_windows)
        chained = self._chained(shooter, found)
        if chained.jump > HIDDEN.jump:
            found = found.beside(self._branches(shooter, best.coefficients), n_windows)
            best = found.of_windows(n_windows, HIDDEN.branches)
            found = found.beside(continued(shooter, best, _ROUNDS), n_windows)
            found = found.beside(preceding(shooter, best, _ROUNDS, _DOUBLINGS), n_windows)
            chained = self._chained(shooter, found)
        return chained

    def _branches(self, shooter: Shooter, coefficients: np.ndarray) -> Solutions:
        """Motions of a law in every window: from many start values, and from the end of the one before."""
        begins = self._begins()[None]
        found = shooter.screen(coefficients, begins, HIDDEN.branches, _ROUNDS, _DOUBLINGS)
        return found.beside(continued(shooter, found, _ROUNDS), len(shooter.windows))

    def _chained(self, shooter: Shooter, found: Solutions) -> Chained:
        return chain(shooter, found, self.scales, [t.t for t in self.problem.trajectories])

    def _shooter(self) -> Shooter:
        """Motions of all terms, in windows that cover every trajectory."""
        law = law_of(self.problem, self.all_members)
        return Shooter(law, self.windows(HIDDEN.last[0], None), self.scales.unit)

    def _begins(self) -> np.ndarray:
        return draw_begins(self.scales, self.problem.hidden, self.rng)


def law_of(problem: Problem, members: Sequence[int]) -> Mechanics:
    """The equations of some candidates with free coefficients, and of the known terms."""
    symbols = [sp.Dummy(real=True) for _ in members]
    values: list[sp.Expr] = [sp.Float(float(value)) for value in np.nan_to_num(problem.known)]
    for k, symbol in zip(members, symbols, strict=True):
        values[k] = symbol
    candidates = problem.candidates
    return Mechanics.of_terms(
        candidates.terms, values, candidates.coordinates, symbols, candidates.prescribed
    )


def _doublings(factor: float) -> int:
    """How often the first horizon doubles to be ``factor`` times as long."""
    return round(np.log2(factor))


_ROUNDS = 2 * HIDDEN.state_rounds  # steps of a fit of states where motions are chained
_DOUBLINGS = _doublings(HIDDEN.last[0])  # of their horizon


def _joined(one: Solutions, other: Solutions) -> Solutions:
    """The coefficients of both, ranked by their own costs."""
    coefficients = np.concatenate([one.coefficients, other.coefficients])
    cost = np.concatenate([one.cost, other.cost])
    return Solutions(coefficients, np.zeros((len(cost), 0)), np.expm1(cost)[:, None])


def _stands_out(found: Solutions) -> bool:
    """Whether the cost of the best set is clearly the lowest."""
    first, *others = found.best(2).cost
    return bool(others) and bool(HIDDEN.stands_out * first < others[0])


def _agree(problem: Problem, members: Sequence[int], found: Solutions, sizes: np.ndarray) -> bool:
    """Whether the two best sets are the same law up to the choice of a sign or zero."""
    if len(found) < 2:
        return False
    laws: list[np.ndarray] = []
    for coefficients in found.best(2).coefficients:
        values = np.zeros(len(problem.candidates))
        values[list(members)] = coefficients
        for change in canonical(problem, members, values):
            values = values * np.where(change.signs == -1.0, -1.0, 1.0)
        laws.append(values)
    size = np.maximum(np.abs(laws[0]), np.abs(laws[1]))
    own = [k for k in members if size[k] > 0.0]
    return bool(np.all(np.abs(laws[0] - laws[1])[own] <= HIDDEN.same * np.maximum(size, sizes)[own]))
