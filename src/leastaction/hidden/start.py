"""Start values of a fit with hidden coordinates.

1. Many sets of coefficients are drawn. Each is tried in short windows, from many hidden states. Then
   coefficients and states are fitted together.
2. The best sets are fitted in more and longer windows, in which fewer of them follow the measured motion.
3. More sets are drawn until the best law follows the measured motion closely, or two sets end at a law that
   costs clearly less than others. If several follow closely, longer windows tell them apart. A strict search
   goes on until a law follows there.
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
from leastaction.estimation.problem import Problem, Structure
from leastaction.hidden.chain import Chained, chain, continued, preceding
from leastaction.hidden.draws import (
    draw_begins,
    draw_coefficients,
    has_negative_mass,
    scales_of,
    signs_without,
    term_sizes,
)
from leastaction.hidden.gauge import Reflection, canonical, reflections
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
        Whether a law follows closely, or costs clearly less than others.
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
        Its members have unknown coefficients; those of dissipation start at zero.
    smooth : Smooth
        The smooth curve through the samples; its hidden coordinates are not used.
    period : float
        Period of the measured motion, in seconds.
    seed : int
    strict : bool
        Draw more sets unless a law follows the measured motion in longer windows, too.
    """
    hunt = _Hunt(problem, list(structure), smooth, period, np.random.default_rng(seed))
    found: Solutions | None = None
    spare: list[Solutions] = []
    for _ in range(hunt.batches):
        fitted = hunt.fitted(hunt.drawn(), *hunt.larger(HIDDEN.last))
        found = fitted if found is None else found.joined(fitted)
        close = fitted.following(HIDDEN.closely)
        stands_out, agree = hunt.compared(found)
        enough = not strict and (agree or hunt.is_clear(close))
        tested = close if enough else _tested(hunt, close)
        passed = tested.following(HIDDEN.closely)
        confirmed = bool(len(passed)) or agree
        if confirmed:
            break
        if len(close):
            spare.append(tested.best(1))
    assert found is not None  # there is at least one batch
    if not len(passed):
        passed = found if agree or not spare else min(spare, key=lambda laws: laws.cost[0])
    return _started(hunt, passed.best(1).coefficients, confirmed or stands_out)


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
        if not hunt.several(laws):
            break
    return tested


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
    problem = hunt.problem
    own, chained = hunt.everywhere(given)
    coefficients, motions = hunt.of_candidates(own), chained.values
    for change in hunt.conventional(coefficients):
        coefficients = change.flipped(coefficients)
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
        self.members = members
        self.in_lagrangian = [k for k in members if problem.terms[k].kind == "lagrangian"]
        self.mechanics = law_of(problem, self.members)
        self.first = self.windows(*HIDDEN.stages[0][:2])
        self.scales = scales_of(problem, self.first, period)
        self.sizes = term_sizes(problem, self.first, self.scales, rng)

    @cached_property
    def signs(self) -> np.ndarray:
        """Signs that a regression gives to terms of L; only draws need them."""
        return signs_without(self.problem, self.in_lagrangian, self.windows(*HIDDEN.last[:2]))

    def windows(self, factor: float, most: int | None) -> Windows:
        """Windows of ``factor`` times the first length."""
        seconds = factor * HIDDEN.first_window * self.period
        most = None if most is None else int(most * self._growth)
        step = HIDDEN.step if factor >= HIDDEN.last[0] else HIDDEN.coarse_step
        return cut_windows(self.problem, self.smooth, seconds, step * self.period, most)

    @property
    def _growth(self) -> float:
        return max(1.0, len(self.in_lagrangian) / HIDDEN.few_terms)

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
        own = self.in_lagrangian
        drawn = draw_coefficients(
            self.problem, own, self.sizes[own], self.signs, self.first, self.scales, self.rng
        )
        given = np.zeros((len(drawn), len(self.members)))  # without friction
        given[:, np.isin(self.members, own)] = drawn
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
        start, race = screened.of_windows(len(shooter.windows)), factor >= HIDDEN.last[0]
        return shooter.fit(start, self.sizes[self.members], rounds, race=race)

    def of_candidates(self, coefficients: np.ndarray) -> np.ndarray:
        """(n_candidates,) coefficients, known ones included, of (n_members,)."""
        values = np.zeros(len(self.problem.candidates))
        values[self.members] = coefficients
        return self.problem.completed(values)

    def conventional(self, coefficients: np.ndarray) -> list[Reflection]:
        """Changes to the conventional signs and zeros of a law, and to L if it is −L; of all candidates."""
        problem, members = self.problem, self.members
        negative = has_negative_mass(problem, coefficients, self.first, self.scales, self.rng)
        first = reflections(problem, members, inverted=True)[:1] if negative else []
        for change in first:
            coefficients = change.flipped(coefficients)
        return [*first, *canonical(problem, members, coefficients)]

    def several(self, found: Solutions) -> bool:
        """Whether another law costs little more than the best."""
        best = found.best(_COMPARED)
        return bool(np.any(best.cost < HIDDEN.stands_out * best.cost[:1], where=~self._alike(best)))

    def is_clear(self, found: Solutions) -> bool:
        """Whether the best law follows in nearly all windows, and no other costs little more."""
        return not self.several(found) and bool(np.all(found.best(1).cost <= np.log1p(HIDDEN.closely**2)))

    def compared(self, found: Solutions) -> tuple[bool, bool]:
        """Whether the best law follows and costs clearly less than others, and whether a second set is it."""
        best = found.best(_COMPARED)
        stands_out = best.typical[0] <= HIDDEN.follows and not self.several(found)
        return bool(stands_out), bool(stands_out and self._alike(best)[1:].any())

    def _alike(self, found: Solutions) -> np.ndarray:
        return found.alike([self.mechanics.n_dof + i for i in self.problem.hidden])

    def everywhere(self, given: np.ndarray) -> tuple[np.ndarray, Chained]:
        """(n_members,) coefficients of a law, from (1, n_members), and its motion along every trajectory.

        Motions are chained, fitted with all coefficients, and chained again.
        """
        shooter = self._shooter()
        found = self._branches(shooter, given)
        fitted = shooter.fit(self._chained(shooter, found).chosen, self.sizes[self.members], HIDDEN.last[3])
        return fitted.coefficients[0], self._along(shooter, replace(found, coefficients=fitted.coefficients))

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
        """Motions in windows that cover every trajectory."""
        return Shooter(self.mechanics, self.windows(HIDDEN.last[0], None), self.scales.unit)

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
_COMPARED = 4  # sets that are compared after each draw
