"""Least squares along a smoothed log: selection of the friction of each joint, and start values.

The equations are weighted by joint, w_i = n / Σ r_i², so that a wrist of 1 N m counts as much as a shoulder
of 50.  All products are summed once for each block of time; the selection then works on small matrices.

Residuals of real arms are correlated. A test that assumes white residuals selects friction in every joint.
The residuals of a joint therefore count as n (1 − ρ)/(1 + ρ) independent ones, with their correlation ρ
between neighbouring knot intervals.  Friction must also predict left-out blocks no worse: a term that fits
one stretch and worsens another is rejected.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from leastaction.arms.base import find_base
from leastaction.curve.bspline import SplineGrid
from leastaction.data.trajectories import Trajectories
from leastaction.estimation.crew import Crew, Task
from leastaction.estimation.files import opened
from leastaction.estimation.forces import forces_on
from leastaction.estimation.gauss_newton import normal_solution
from leastaction.estimation.intervals import column_products, column_sums
from leastaction.library.tree import KinematicTree
from leastaction.mechanics.arm_columns import ArmColumns, dry_history
from leastaction.mechanics.arm_terms import ArmTerm, JointScales, joint_terms, parameter_terms

__all__ = ["Acting", "Choice", "Regression", "Solution", "reweighted"]

_CHUNK = 512  # knot intervals handled at once
_BLOCKS = 6  # of time, each left out once
_ROUNDS = 4  # of the weights
_WIDTH = 0.01  # ε over the rms velocity
_STRIBECK = 0.1  # v_s over the rms velocity
_WORTH = 4.0  # gain in twice the log likelihood that a distance must bring
_REFINED = 4  # steps towards the best distances and widths
_LARGEST = 0.7  # change of the logarithm of one of them in one step
_WIDTHS = (0.1, 30.0)  # over which ε may change, times its start value
# On eight simulated logs that begin at rest, half and twice of it change the mass matrix by at most 0.01 %;
# half of it reports one contact that is not there.
_MOVED = 0.02  # of the standard deviation of a joint, some times δ, by which it has moved
_FEWEST = 0.2  # of the log; a joint that moves less keeps its whole equation
_DISTANCES = np.geomspace(1e-4, 3e-2, 9)  # δ over the standard deviation of the joint


class Choice(NamedTuple):
    """Result of the regression.

    Attributes
    ----------
    scales : JointScales
    friction : tuple of ArmTerm
    values : dict
        Name of each term → start value.
    history : (2, n_intervals, n_quadrature, n_dof) array
        Dry friction that reverses over a distance, and its derivative; see `ArmColumns`.
    reference : (n_links, 10) array
        Inertial parameters from which the load of the joints is computed.
    regression : Regression
        At these scales.
    members, dry, solution
        The columns that were selected, the history that acts in each joint, and all coefficients.
    """

    scales: JointScales
    friction: tuple[ArmTerm, ...]
    values: dict[str, float]
    history: np.ndarray
    reference: np.ndarray
    regression: Regression
    members: list[int]
    dry: Acting
    solution: Solution


Acting = list[tuple[int, int]]
"""Joints, and the history that acts in each."""


class Solution(NamedTuple):
    """Coefficients, and the residual sum of squares of each equation."""

    values: np.ndarray
    squares: np.ndarray


def reweighted(local: np.ndarray, squares: np.ndarray, least: np.ndarray | float) -> Solution:
    """Least squares over all joints, each weighted by its own residuals.

    Parameters
    ----------
    local : (n_dof, n + 1, n + 1) array
        Products of the columns and, last, of the torque, for each joint.
    squares, least : (n_dof,) arrays
        Residual sums of squares to begin with, and the least that count.
    """
    values = np.zeros(local.shape[1] - 1)
    for _ in range(_ROUNDS):
        summed = np.tensordot(1.0 / squares, local, 1)
        values = normal_solution(summed[:-1, :-1], summed[:-1, -1])
        residual = np.append(values, -1.0)
        squares = np.maximum(np.einsum("a,iab,b->i", residual, local, residual), least)
    return Solution(values, squares)


@dataclass(frozen=True, eq=False)
class Regression:
    """Sums of products along a log.

    Attributes
    ----------
    grid : SplineGrid
    control_points : (n_ctrl, n_dof) array
    forces : (n_intervals, n_quadrature, n_dof) array
    columns : ArmColumns
        Of the base parameters, and of friction that may be selected.
    fixed, always, extra : tuple of int
        Columns that stay, friction that is tried first, and friction that is added if it improves the fit.
    data : Trajectories
    histories : (n_histories, n_intervals, n_quadrature, n_dof) array
        Dry friction that follows the sign of the velocity, then dry friction for each distance.
    grams : (n_blocks, n_dof, n, n) array
        Of columns, histories and forces of each joint.
    counts : (n_dof,) array
        Independent residuals of each joint.
    moved : (n_intervals, n_dof) array
        1 where a joint has moved since its run began, else 0: a joint that rests is held by friction of
        unknown size, so that its equation is not used. 0 if its torque is not measured.
    """

    grid: SplineGrid
    control_points: np.ndarray
    forces: np.ndarray
    columns: ArmColumns
    fixed: tuple[int, ...]
    always: tuple[int, ...]
    extra: tuple[int, ...]
    scales: JointScales
    spread: np.ndarray
    data: Trajectories
    histories: np.ndarray
    grams: np.ndarray
    counts: np.ndarray
    moved: np.ndarray
    crew: Crew

    @classmethod
    def of(
        cls,
        tree: KinematicTree,
        grid: SplineGrid,
        control_points: np.ndarray,
        forces: np.ndarray,
        data: Trajectories,
        kinds: tuple[Sequence[str], Sequence[str], Sequence[str]],
        unmeasured: Sequence[int],
        crew: Crew,
    ) -> Regression:
        """Sum the products along a log.

        Parameters
        ----------
        kinds, unmeasured
            Terms of every joint, friction that is tried in every joint, friction that may be added; joints
            whose equations are not used.
        """
        states = [np.concatenate(grid.evaluate(control_points, [t.t for t in data], nu)) for nu in (0, 1)]
        spread = states[0].std(axis=0)
        rms = np.maximum(np.sqrt(np.mean(states[1] ** 2, axis=0)), 1e-9)
        scales = JointScales(_WIDTH * rms, _STRIBECK * rms, np.zeros(len(tree)))
        inertial = parameter_terms(tree, kinds[0], scales, unmeasured)
        base = find_base(tree, inertial, unmeasured)
        parts = [
            [inertial[k] for k in base.members],
            joint_terms(tree, [kind for kind in kinds[1] if kind != "dry"], scales, unmeasured),
            joint_terms(tree, kinds[2], scales, unmeasured),
        ]
        terms = [term for part in parts for term in part]
        ends = np.cumsum([0, *map(len, parts)]).tolist()
        fixed, always, extra = (tuple(range(a, b)) for a, b in pairwise(ends))
        moved = _moved(grid, control_points, data, _MOVED * spread)
        moved[:, list(unmeasured)] = 0.0
        made = cls(
            *(grid, control_points, forces, ArmColumns(tree, terms, None, unmeasured)),
            *(fixed, always, extra, scales, spread, data),
            histories=np.zeros((0, *forces.shape)),
            grams=np.zeros(0),
            counts=np.zeros(0),
            moved=moved,
            crew=crew,
        )
        if "dry" in kinds[1]:
            at = [scales._replace(distance=share * np.maximum(spread, 1e-12)) for share in (0.0, *_DISTANCES)]
            made = replace(made, histories=made._turning(at, slice(1)))
        return made._begun()

    def _begun(self) -> Regression:
        """The regression with its sums; a first solution gives the load of the joints."""
        loads = [k for k, term in enumerate(self.columns.terms) if term.kind == "load"]
        others = [k for k in range(len(self.columns)) if k not in set(loads)]
        first = replace(self, columns=self.columns.subset(others))
        grams = first.summed()
        place = {k: row for row, k in enumerate(others)}
        begin = [place[k] for k in (*self.fixed, *self.always)]
        first = replace(first, grams=grams, counts=np.full(self.columns.n_dof, 1.0))
        solution = first.solved(begin, first._no_distance)
        coefficients = np.zeros(len(self.columns))
        coefficients[[*self.fixed, *self.always]] = solution.values[: len(begin)]
        reference = self.columns.parameters(coefficients)
        tree, terms, unmeasured = self.columns.tree, self.columns.terms, self.columns.prescribed
        whole = replace(self, columns=ArmColumns(tree, terms, reference, unmeasured))
        grams = whole.summed() if loads else grams
        whole = replace(whole, grams=grams)
        return replace(whole, counts=whole._independent(coefficients, solution.values[len(begin) :]))

    @property
    def _no_distance(self) -> Acting:
        """Dry friction that follows the sign of the velocity."""
        return [(i, 0) for i in range(self.columns.n_dof)] if len(self.histories) else []

    def summed(self) -> np.ndarray:
        """(n_blocks, n_dof, n, n) products of columns, histories and forces of each joint."""
        acting = np.concatenate([self.histories, self.forces[None]])
        return np.array(self._of_blocks(column_products, lambda at: (acting[:, at], self.moved[at])))

    def torques(self, coefficients: np.ndarray) -> np.ndarray:
        """(n_intervals, n_quadrature, n_dof) sum of the columns."""
        return np.concatenate(self._of_blocks(column_sums, lambda _: (coefficients,)))

    def _of_blocks(
        self, function: Callable[..., np.ndarray], more: Callable[[slice], tuple[np.ndarray, ...]]
    ) -> list[np.ndarray]:
        """A function of each block of time: its grid, control points, the columns, and what else it takes."""
        grid, edges = self.grid, np.linspace(0, self.grid.n_intervals, _BLOCKS + 1).astype(int)
        tasks: list[Task] = []
        for block in (slice(a, b) for a, b in pairwise(np.unique(edges).tolist())):
            given = grid.part(block), self.control_points[grid.points_within(block)], self.columns
            tasks.append(self.crew.task(function, *given, *more(block)))
        return self.crew.results(tasks)

    def own(self, members: Sequence[int], dry: Acting, joint: int) -> tuple[list[int], list[int]]:
        """Indices of one joint among the unknowns and the torque, and its indices in the sums."""
        k, m = len(self.columns), len(members)
        acting = [(row, d) for row, (i, d) in enumerate(dry) if i == joint]
        places = [*range(m), *(m + row for row, _ in acting), m + len(dry)]
        return places, [*members, *(k + d for _, d in acting), k + len(self.histories)]

    def solved(self, members: Sequence[int], dry: Acting, left_out: int | None = None) -> Solution:
        """Weighted least squares with the given columns and dry friction."""
        n, size = self.columns.n_dof, len(members) + len(dry) + 1
        total = self.grams.sum(axis=0)
        if left_out is not None:
            total = total - self.grams[left_out]
        local = np.zeros((n, size, size))
        for i in range(n):
            places, numbers = self.own(members, dry, i)
            local[i][np.ix_(places, places)] = total[i][np.ix_(numbers, numbers)]
        squares = np.where(local[:, -1, -1] > 0.0, local[:, -1, -1], 1.0)
        return reweighted(local, squares, 1e-12 * squares)

    def _unseen(self, members: Sequence[int], dry: Acting, squares: np.ndarray) -> float:
        """Squared errors of blocks that are predicted from the others, relative to ``squares``."""
        error = 0.0
        for block in range(len(self.grams)):
            residual = np.append(self.solved(members, dry, block).values, -1.0)
            for i, each in enumerate(squares):
                places, numbers = self.own(members, dry, i)
                part = residual[places]
                error += part @ self.grams[block, i][np.ix_(numbers, numbers)] @ part / each
        return float(error)

    def _independent(self, coefficients: np.ndarray, dry: np.ndarray) -> np.ndarray:
        """(n_dof,) n (1 − ρ)/(1 + ρ) of each joint."""
        residual = self.torques(coefficients) - self.forces
        residual += dry * self.histories[0] if dry.size else 0.0
        r = residual.mean(axis=1) * self.moved
        rho = np.sum(r[1:] * r[:-1], axis=0) / np.maximum(np.sum(r * r, axis=0), 1e-300)
        rho = np.clip(rho, 0.0, 0.999)
        return self.moved.sum(axis=0) * (1.0 - rho) / (1.0 + rho)

    def chosen(self, false_alarm: float) -> Choice:
        """Select distances, then further friction."""
        members, dry = [*self.fixed, *self.always], self._no_distance
        best = self.solved(members, dry)
        for _ in range(2 if dry else 0):
            before = list(dry)
            for row, (i, _) in enumerate(before):
                for d in range(len(self.histories)):
                    tried = [*dry[:row], (i, d), *dry[row + 1 :]]
                    found = self.solved(members, tried)
                    if self._gain(best, found) > (_WORTH if dry[row][1] == 0 and d else 0.0):
                        dry, best = tried, found
            if dry == before:
                break
        shares = np.array([0.0, *_DISTANCES])[[d for _, d in dry]] if dry else np.zeros(len(self.spread))
        distances = shares * self.spread
        if not dry:
            members, best = self._extended(members, dry, best, false_alarm)
            return self._choice(members, dry, best, self.scales)
        scales = self.scales._replace(distance=distances)
        dry = [(i, row) for row in (0, 1) for i in range(len(distances))]
        for _ in range(_REFINED):
            best = self._at(scales).solved(members, dry)
            sizes, shifts = np.split(best.values[len(members) :], 2)
            scales = self._changed(scales, shifts / np.where(sizes == 0.0, np.inf, sizes))
        refined = self._at(scales)
        members, best = refined._extended(members, dry, refined.solved(members, dry), false_alarm)
        return refined._choice(members, dry, best, scales)

    def _changed(self, scales: JointScales, ratios: np.ndarray) -> JointScales:
        """Distances, or widths of joints without a distance, after a step."""
        steps = np.exp(np.clip(ratios, -_LARGEST, _LARGEST))
        turning = scales.distance > 0.0
        low, high = (share * self.scales.width for share in _WIDTHS)
        width = np.where(turning, scales.width, np.clip(scales.width * steps, low, high))
        return scales._replace(width=width, distance=scales.distance * steps)

    def _turning(self, tried: Sequence[JointScales], orders: slice) -> np.ndarray:
        """(n, n_intervals, n_quadrature, n_dof) dry friction (order 0) and its derivative (1) at some scales.

        Workers share the joints.
        """
        motion = self.crew.held((self.grid, self.control_points, [t.t for t in self.data]))
        terms = [joint_terms(self.columns.tree, ["dry"], scales) for scales in tried]
        shares = np.array_split(np.arange(self.columns.n_dof), self.crew.size)
        tasks = [self.crew.task(_turning, motion, terms, orders, own) for own in shares if own.size]
        return np.concatenate(self.crew.results(tasks), axis=-1)

    def _at(self, scales: JointScales) -> Regression:
        """The regression with the histories at these scales only."""
        made = replace(self, histories=self._turning([scales], slice(2)))
        return replace(made, grams=made.summed())

    def _gain(self, before: Solution, after: Solution) -> float:
        """Twice the increase of the log likelihood."""
        return float(self.counts @ np.log(before.squares / after.squares))

    def _extended(
        self, members: list[int], dry: Acting, best: Solution, false_alarm: float
    ) -> tuple[list[int], Solution]:
        left = list(self.extra)
        cut = float(chi2.isf(false_alarm / max(len(left), 1), 1))
        while left:
            tries = [(self.solved([*members, k], dry), k) for k in left]
            gains = [self._gain(best, found) for found, _ in tries]
            if max(gains) < cut:
                break
            found, k = tries[int(np.argmax(gains))]
            left.remove(k)
            with_, without = (self._unseen(m, dry, best.squares) for m in ([*members, k], members))
            if with_ < without:
                members, best = [*members, k], found
        return members, best

    def _choice(self, members: list[int], dry: Acting, best: Solution, scales: JointScales) -> Choice:
        tree = self.columns.tree
        friction = [self.columns.terms[k] for k in members if k not in set(self.fixed)]
        names = [self.columns.terms[k].text for k in members]
        names += [f"{'turn' if d else 'dry'}[{tree.coordinates[i]}]" for i, d in dry]
        values = dict(zip(names, best.values.tolist(), strict=True))
        if dry:
            friction += joint_terms(tree, ["dry", "turn"], scales, self.columns.prescribed)
        coefficients = np.array([values.get(term.text, 0.0) for term in self.columns.terms])
        reference = self.columns.reference
        if reference is None:
            reference = self.columns.parameters(coefficients)
        history = self.histories if dry else np.zeros((2, *self.forces.shape))
        return Choice(scales, tuple(friction), values, history, reference, self, members, dry, best)


def _turning(motion: Any, tried: Sequence[Sequence[ArmTerm]], orders: slice, own: np.ndarray) -> np.ndarray:
    """What `Regression._turning` returns, of some joints."""
    grid, points, times = opened(motion)
    states = [grid.evaluate(points[:, own], times, nu) for nu in (0, 1)]
    histories: list[np.ndarray] = []
    for terms in tried:
        here = [replace(term, place=k) for k, i in enumerate(own) for term in terms if term.place == i]
        ways = [dry_history(here, q, qdot)[orders, :, 0] for q, qdot in zip(*states, strict=True)]
        found = forces_on(grid, times, [np.concatenate(list(way), axis=-1) for way in ways])
        assert found is not None
        histories.extend(np.split(found.values, found.values.shape[-1] // own.size, axis=-1))
    return np.array(histories)


def _moved(grid: SplineGrid, control_points: np.ndarray, data: Trajectories, least: np.ndarray) -> np.ndarray:
    """(n_intervals, n_dof) whether a joint has left the place where its run began."""
    times = [t.t for t in data]
    ways = [np.maximum.accumulate(np.abs(q - q[0])) for q in grid.evaluate(control_points, times)]
    found = forces_on(grid, times, [(way > least).astype(float) for way in ways])
    assert found is not None
    moved = (found.values.mean(axis=1) > 0.5).astype(float)
    moved[:, moved.mean(axis=0) < _FEWEST] = 1.0
    return moved
