"""Which terms are in the model: supports from the weak form, refined on the likelihood.

1. Beam search on the weak form at several test-function widths proposes supports.
2. Each is fitted jointly with curve and weights; a quadratic model of the likelihood in *all*
   candidates then proposes a better support, which is fitted in turn, until nothing changes.
3. Knots are refined until coefficients and standard errors stop moving, and step 2 is repeated there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from leastaction.curve.smoothing import Smooth
from leastaction.estimation.weights import Start
from leastaction.estimation.workspace import StructureFit, Workspace
from leastaction.selection.kinetic_seeds import kinetic_bases
from leastaction.selection.knots import Progress, equations_hold, refine_knots
from leastaction.selection.likelihood_search import (
    Choice,
    QuadraticModel,
    search_subsets,
    term_penalty,
    trade_off,
)
from leastaction.selection.weak_form import WeakForm, WeakGram
from leastaction.selection.weak_search import beam_search, grow_bases, solve_support, support_score

__all__ = [
    "Refiner",
    "Selection",
    "best_structure",
    "confirm_structure",
    "propose_supports",
    "select_structure",
]

_WIDTHS = (1.0, 0.5, 2.0)  # of the test functions, in periods of the fastest coordinate
_REPLICATES = 8
_EQUATION_ERRORS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # squared, relative to the rows
_EXPLAINED = 3.0
_MAX_SIZE = 24  # largest support that the weak search proposes; the likelihood may add to it
_LOST = 5.0
_PROPOSED = 2  # supports fitted a round, at most
_TRIED = 60  # supports whose mass matrix is looked at
_REGULAR = 0.999
_MOSTLY_REGULAR = 0.9
_NEGATIVE = -3.0  # standard errors
_OVERLAP = 3.0  # neighbouring test functions share data: rows count for less than one sample each


@dataclass(frozen=True, eq=False)
class Selection:
    """The chosen structure, and the supports of every size about it.

    Attributes
    ----------
    structure : StructureFit
    levels : dict
        Number of free terms → supports (numbers of columns) with cost, best first.
    penalty : float
        Price of a term in units of χ².
    knots_settled : bool
        Whether finer knots changed nothing any more.
    feeding : tuple of int
        Columns of dissipation that were left out because they would have fed energy in.
    """

    structure: StructureFit
    levels: dict[int, list[Choice]]
    penalty: float
    knots_settled: bool
    feeding: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Proposal:
    """A support with a start for its joint fit, and the evidence there."""

    members: tuple[int, ...]
    start: Start
    evidence: float


def propose_supports(
    workspace: Workspace, smooth: Smooth, progress: Progress, seed: int = 0, thorough: bool = False
) -> list[Proposal]:
    """Proposals of several test-function widths, distinct, best first; stops when two widths agree.

    Where no proposal has equations that can be solved for q̈, supports are grown again from kinetic energies
    that can: with much noise, near-identities of a large library explain the rows as well as the law does.
    A thorough search does so in any case.
    """
    _, qdot, qddot = workspace.grid.at_quadrature(smooth.control_points)
    rates, accelerations = ((s**2).mean(axis=(0, 1)) for s in (qdot, qddot))
    period = float(2.0 * np.pi * np.sqrt((rates / np.maximum(accelerations, 1e-300)).min()))
    widths = [factor * period for factor in _WIDTHS]
    form = WeakForm(
        workspace.grid, workspace.columns, workspace.known, workspace.forces, widths, np.sqrt(rates)
    )
    floor = workspace.observations.noise_floor
    replicates = smooth.replicates(_REPLICATES, np.random.default_rng(seed), floor)
    found: list[Proposal] = []
    grams = form.grams(smooth.control_points, replicates)
    for from_bases in (False, True):
        bases = kinetic_bases(workspace, smooth) if from_bases else None
        for gram in grams:
            proposal = _settle(workspace, smooth, *_best_support(workspace, smooth, gram, bases))
            progress("search", _details(workspace, proposal.start.coefficients, proposal.evidence))
            if any(proposal.members == p.members for p in found):
                break
            found.append(proposal)
        if not thorough and any(np.isfinite(p.evidence) for p in found):
            break
    return sorted(found, key=lambda p: -p.evidence)


def _details(workspace: Workspace, coefficients: np.ndarray, evidence: float) -> dict:
    """What a user may see of a structure on the way, known terms included in the coefficients only."""
    free = np.count_nonzero(coefficients[workspace.free])
    return {"terms": free, "evidence": evidence, "coefficients": workspace.named(coefficients)}


def _best_support(
    workspace: Workspace, smooth: Smooth, gram: WeakGram, bases: list[tuple[int, ...]] | None
) -> tuple[tuple[int, ...], np.ndarray]:
    """Best support of one width whose mass matrix is positive definite, and coefficients of all columns."""
    free = workspace.free
    n_rows = max(gram.n_rows / _OVERLAP, 4.0)
    penalty = term_penalty(int(n_rows), free.size)
    first = None
    for error in _EQUATION_ERRORS:  # the smallest that lets some support explain the rows
        most = min(free.size, _MAX_SIZE)
        if bases is None:
            levels = beam_search(gram, error, penalty, n_rows, most)
        else:
            levels = grow_bases(gram, error, penalty, n_rows, most, bases)
        ranked = sorted(
            (s for level in levels for s in level), key=lambda s: support_score(s, penalty, n_rows)
        )
        if ranked[0].ratio < _EXPLAINED:
            break
    for support in ranked[:_TRIED]:
        coefficients = np.where(np.isnan(workspace.known), 0.0, workspace.known)
        coefficients[free] = solve_support(gram, error, support.members)
        answer = tuple(int(free[m]) for m in support.members), coefficients
        if workspace.regular(coefficients, smooth.control_points) > _MOSTLY_REGULAR:
            return answer
        first = first or answer
    assert first is not None
    return first


def _settle(
    workspace: Workspace, smooth: Smooth, members: tuple[int, ...], coefficients: np.ndarray
) -> Proposal:
    """Curve and weights for the proposed coefficients, held.

    At small weights the scale of L is hardly determined; in a joint fit it would drift away.
    """
    start = workspace.start(members, smooth.control_points, coefficients, smooth.noise_std)
    value = -np.inf
    for _ in range(3):
        start, value = workspace.fit_curve(members, start)
        if not np.isfinite(value):
            break
    return Proposal(members, start, value)


class Refiner:
    """Alternates fits and searches on the quadratic model of the likelihood."""

    def __init__(self, workspace: Workspace, progress: Progress) -> None:
        self.workspace = workspace
        self.progress = progress
        self.penalty = term_penalty(int(workspace.observations.counts.sum()), workspace.free.size)

    def value(self, structure: StructureFit) -> float:
        """Evidence less the price of the terms; −inf for a fit that failed or has lost its scale.

        A fit that is still moving counts: the next structure is begun from it.
        """
        if not structure.fit.usable or not np.isfinite(structure.evidence):
            return -np.inf
        # candidates that imitate the known term let the scale of L run away from it
        if np.all(np.abs(structure.estimates) < _LOST * structure.standard_errors):
            return -np.inf
        return structure.evidence - 0.5 * self.penalty * len(structure.members)

    def refine(self, structure: StructureFit, rounds: int = 8) -> StructureFit:
        for _ in range(rounds):
            self._tell(structure)
            if not structure.fit.usable:
                break
            better = self._better(structure)
            if better is None:
                break
            structure = better
        return structure

    def _better(self, structure: StructureFit) -> StructureFit | None:
        """The first proposal that converges to a higher value; else the best that is still moving."""
        value, moving = self.value(structure), None
        for members, start in self._propose(structure):
            fit = self.workspace.fit(members, start)
            if self.value(fit) <= value:
                continue
            if fit.fit.converged:
                return fit
            if moving is None or self.value(fit) > self.value(moving):
                moving = fit
        return moving

    def prune(self, structure: StructureFit, relevance: float) -> StructureFit:
        """Drop terms that hardly lower the equation error.

        On real hardware the library is never exact, and with enough data every candidate becomes
        significant because it mimics a little of what is missing.  A term has to lower the variance of
        the equation error by the share ``relevance``; for an exact library there is no equation error
        (``slack`` vanishes) and nothing is asked beyond significance.
        """
        while structure.fit.converged and len(structure.members) > 1:
            threshold = self.penalty + relevance * float(structure.fit.weights.slack.sum())
            model, current = self._model(structure)
            cost = model.best({current}, 1)[0].cost
            members = current
            while len(members) > 1:
                smaller = model.best({tuple(m for m in members if m != out) for out in members}, 1)[0]
                if smaller.cost - cost > threshold:
                    break
                members, cost = smaller.members, smaller.cost
            if members == current:
                break
            there = model.solution(members)
            start = self._start(structure, there)
            structure = self.workspace.fit(self._columns(members), start)
            self._tell(structure)
        return structure

    def dissipate(self, structure: StructureFit) -> tuple[StructureFit, tuple[int, ...]]:
        """Leave out dissipation with a negative coefficient: friction cannot feed energy in.

        Returns
        -------
        StructureFit
        tuple of int
            Columns left out, those significantly negative.
        """
        out: list[int] = []
        terms = self.workspace.columns.terms
        while structure.fit.usable:
            z = structure.estimates / np.maximum(structure.standard_errors, 1e-300)
            is_friction = [terms[m].kind == "dissipation" for m in structure.members]
            negative = [m for m, s, f in zip(structure.members, z, is_friction, strict=True) if f and s < 0]
            if not negative:
                break
            out += [m for m, s in zip(structure.members, z, strict=True) if m in negative and s < _NEGATIVE]
            self.workspace.known = self.workspace.known.copy()
            self.workspace.known[negative] = 0.0
            members = tuple(m for m in structure.members if m not in negative)
            structure = self.refine(self.workspace.fit(members, structure.start), rounds=4)
        return structure, tuple(out)

    def levels(self, structure: StructureFit) -> dict[int, list[Choice]]:
        """Supports of every size about a structure, by the quadratic model there."""
        if not structure.fit.converged:
            return {}
        model, current = self._model(structure)
        return {
            size: [Choice(self._columns(c.members), c.cost) for c in level]
            for size, level in trade_off(model, current).items()
        }

    def _tell(self, structure: StructureFit) -> None:
        details = _details(self.workspace, structure.coefficients, structure.evidence)
        self.progress("select", details)

    def _propose(self, structure: StructureFit) -> Iterator[tuple[tuple[int, ...], Start]]:
        """Better supports by the quadratic model, with their starts: the best, one near by, the second best.

        Far from the law the best may be a heap of terms whose fit fails; then the best with one term more
        than now, at most, is a step on firmer ground, and after it the best with none more.
        """
        model, current = self._model(structure)
        levels = search_subsets(model, current, self.penalty)
        regular = (self._first_regular(model, structure, level) for level in levels.values())
        ranked = sorted(filter(None, regular), key=lambda c: c.criterion(self.penalty))
        here = next((n for n, choice in enumerate(ranked) if choice.members == current), len(ranked))
        better = ranked[:here]
        near = [c for c in better if len(c.members) <= len(current) + 1]
        no_larger = [c for c in better if len(c.members) <= len(current)]
        for members in dict.fromkeys(
            c.members for c in (*better[:1], *near[:1], *better[1:_PROPOSED], *no_larger[:1])
        ):
            yield self._columns(members), self._start(structure, model.solution(members))

    def _first_regular(
        self, model: QuadraticModel, structure: StructureFit, level: list[Choice]
    ) -> Choice | None:
        """The best support of one size whose equations can be solved for q̈ along the motion."""
        coefficients = structure.coefficients.copy()
        for choice in level:
            coefficients[self.workspace.free] = model.solution(choice.members)
            if self.workspace.regular(coefficients, structure.fit.control_points) > _MOSTLY_REGULAR:
                return choice
        return None

    def _model(self, structure: StructureFit) -> tuple[QuadraticModel, tuple[int, ...]]:
        """Quadratic model over the free columns about a fit, and where its members are among them."""
        free = self.workspace.free
        self._quadratic = self.workspace.score(structure)
        model = QuadraticModel(self._quadratic.matrix, self._quadratic.gradient, structure.coefficients[free])
        position = {int(k): p for p, k in enumerate(free)}
        return model, tuple(sorted(position[m] for m in structure.members))

    def _columns(self, positions: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(int(self.workspace.free[p]) for p in positions)

    def _start(self, structure: StructureFit, there: np.ndarray) -> Start:
        """Curve and coefficients after the step of the quadratic model to new free coefficients."""
        free, quadratic = self.workspace.free, self._quadratic
        step = there - structure.coefficients[free]
        shift = quadratic.curve_step(step)
        points = structure.fit.control_points
        coefficients = structure.coefficients.copy()
        coefficients[free] = there
        return Start(points - shift.reshape(points.shape), coefficients, structure.fit.weights)


def select_structure(
    workspace: Workspace,
    smooth: Smooth,
    progress: Progress,
    relevance: float = 0.05,
    seed: int = 0,
    thorough: bool = True,
) -> Selection:
    """Run the search; the workspace ends with the knots of the result.

    Parameters
    ----------
    relevance : float
        Share of the equation error's variance that a term has to remove; see :meth:`Refiner.prune`.
    thorough : bool
        Search once more where the equations do not hold.
    """
    refiner = Refiner(workspace, progress)
    first = workspace.knots_per_second
    best = best_structure(refiner, propose_supports(workspace, smooth, progress, seed), None)
    structure, settled, vibrates = refine_knots(workspace, best, progress)
    if thorough and not vibrates and not _explains(refiner, structure):
        fine = workspace.knots_per_second
        workspace.set_knots(first)
        proposals = propose_supports(workspace, smooth, progress, seed + 1, thorough=True)
        other = best_structure(refiner, proposals, best)
        if other is best:
            workspace.set_knots(fine)
        else:
            structure, settled, _ = refine_knots(workspace, other, progress)
    again = refiner.refine(structure, rounds=4)
    if again.members != structure.members:
        again, settled, _ = refine_knots(workspace, again, progress)
    pruned, feeding = refiner.dissipate(refiner.prune(again, relevance))
    return Selection(pruned, refiner.levels(pruned), refiner.penalty, settled, feeding)


def best_structure(refiner: Refiner, proposals: list[Proposal], best: StructureFit | None) -> StructureFit:
    """Refine the proposals, the best first, until two of them lead to the same structure."""
    for proposal in proposals:
        if best is not None and not np.isfinite(proposal.evidence):
            continue
        structure = refiner.refine(refiner.workspace.fit(proposal.members, proposal.start))
        agreed = best is not None and structure.members == best.members
        if best is None or refiner.value(structure) > refiner.value(best):
            best = structure
        if agreed:
            break
    assert best is not None
    return best


def _explains(refiner: Refiner, structure: StructureFit) -> bool:
    """Whether the equations hold to one per cent and can be solved; if not, look for a better structure."""
    if not structure.fit.converged or not np.isfinite(refiner.value(structure)):
        return False
    return equations_hold(refiner.workspace, structure) and structure.fit.linearisation.regular > _REGULAR


def confirm_structure(
    workspace: Workspace, smooth: Smooth, found: Selection, progress: Progress, relevance: float
) -> Selection:
    """Refit and select again on all data, from a structure that was found on pieces of them.

    The knots stay: with a factor of 1.4 between grids and errors that fall with a high power of the spacing,
    what still moves by a tenth of a standard error leaves a bias of some hundredths.
    """
    structure, refiner = found.structure, Refiner(workspace, progress)
    there = structure.fit.weights
    longer = workspace.grid.n_ctrl / len(structure.fit.control_points)
    weights = replace(there, slack=longer * there.slack)
    start, _ = workspace.fit_curve(
        structure.members, Start(smooth.control_points, structure.coefficients, weights)
    )
    refined = refiner.refine(workspace.fit(structure.members, start), rounds=4)
    pruned, feeding = refiner.dissipate(refiner.prune(refined, relevance))
    return Selection(pruned, refiner.levels(pruned), refiner.penalty, found.knots_settled, feeding)
