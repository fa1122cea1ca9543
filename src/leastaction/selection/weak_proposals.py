"""Structures proposed by the weak form, which needs no accelerations and no start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leastaction.curve.smoothing import Smooth
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Structure
from leastaction.estimation.settings import ESTIMATION
from leastaction.estimation.weights import Start
from leastaction.selection.likelihood_search import term_penalty
from leastaction.selection.progress import Progress, law_so_far
from leastaction.selection.settings import SELECTION
from leastaction.selection.weak_backward import backward_search
from leastaction.selection.weak_form import WeakGram, weak_grams
from leastaction.selection.weak_search import (
    ScaledGram,
    Support,
    beam_search,
    grow_bases,
    kinetic_bases,
    noise_ratio,
    solve_support,
    support_score,
)

__all__ = ["Proposal", "explicable", "propose_structures", "settled", "unexplained"]

_EQUATION_ERRORS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # squared, relative to the rows
_TRIED = 60  # structures whose mass matrix is looked at


@dataclass(frozen=True, eq=False)
class Proposal:
    """A structure with a start for its joint fit on a grid, and the evidence there."""

    grid: Grid
    structure: Structure
    start: Start
    evidence: float


def propose_structures(
    grid: Grid, curve: Smooth, report: Progress, seed: int = 0, thorough: bool = False
) -> list[Proposal]:
    """Proposals of several test-function widths, distinct, best first; stops when two widths agree.

    Where no proposal has equations that can be solved for q̈, structures are grown again from kinetic
    energies that can: with much noise, near-identities of a large library explain the rows as well as the
    law does. A thorough search does so in any case.
    """
    problem, grams = grid.problem, weak_grams(grid, curve, seed)
    found: list[Proposal] = []
    for from_bases in (False, True):
        bases = kinetic_bases(grid, curve) if from_bases else None
        for gram in grams:
            proposal = settled(grid, curve, *_best_support(grid, curve, gram, bases))
            report("search", law_so_far(problem, proposal.start.coefficients, proposal.evidence))
            if any(proposal.structure == p.structure for p in found):
                break
            found.append(proposal)
        if not thorough and any(np.isfinite(p.evidence) for p in found):
            break
    return sorted(found, key=lambda p: -p.evidence)


def explicable(grid: Grid, curve: Smooth, seed: int = 0) -> bool:
    """Whether all candidates together explain the rows of some width, to one per cent of their terms.

    Where they do not, no structure of them has equations that hold.
    """
    return bool(np.any(unexplained(grid, curve, seed) < SELECTION.rows_explained))


def unexplained(grid: Grid, curve: Smooth, seed: int = 0) -> np.ndarray:
    """What all candidates together leave of the rows, for each width: the ratio ρ at one per cent."""
    return np.array([_of_all(gram, SELECTION.holds**2) for gram in weak_grams(grid, curve, seed)])


def _of_all(gram: WeakGram, error: float) -> float:
    """The ratio ρ of all candidates, which no structure of them falls below."""
    return ScaledGram(gram, error).ratio(tuple(range(gram.residual.shape[0] - 1)))


def _best_support(
    grid: Grid, curve: Smooth, gram: WeakGram, bases: list[tuple[int, ...]] | None
) -> tuple[Structure, np.ndarray]:
    """Best structure of one width whose mass matrix is positive definite, and all coefficients."""
    problem, free = grid.problem, grid.problem.free
    *smaller, largest = _EQUATION_ERRORS
    # where not even all candidates explain the rows, no structure does
    promising = [e for e in smaller if _of_all(gram, e) < SELECTION.rows_explained]
    error, ranked = largest, list[Support]()
    for error in (*promising, largest):  # the smallest that lets some structure explain the rows
        ranked = _ranked(gram, error, bases, problem.surcharges[free])
        if ranked[0].ratio < SELECTION.rows_explained:
            break
    answers: list[tuple[Structure, np.ndarray]] = []
    for support in ranked[:_TRIED]:
        coefficients = problem.completed(0.0)
        coefficients[free] = solve_support(gram, error, support.members)
        answers.append((Structure(free[list(support.members)]), coefficients))
        if grid.regular(coefficients, curve.control_points) > ESTIMATION.mostly_regular:
            return answers[-1]
    return answers[0]


def _ranked(
    gram: WeakGram, error: float, bases: list[tuple[int, ...]] | None, surcharges: np.ndarray
) -> list[Support]:
    """Supports in rising score.

    Backward from the whole library where rows outnumber the candidates, so that it leaves noise; else
    forward, and forward from bases where some are given.
    """
    size, noise = surcharges.size, 1.0
    n_rows = max(gram.n_rows / SELECTION.overlap, 4.0)
    price = term_penalty(int(n_rows), size)
    if bases is not None:
        levels = grow_bases(gram, error, price, n_rows, bases)
    elif n_rows < SELECTION.rows_each * size:
        levels = beam_search(gram, error, price, n_rows)
    else:
        levels = backward_search(gram, error, price, n_rows)
        noise = noise_ratio(levels[-1][0].ratio, size, n_rows)

    def score(support: Support) -> float:
        return support_score(support, price, n_rows, noise) + float(surcharges[list(support.members)].sum())

    return sorted((s for level in levels for s in level), key=score)


def settled(grid: Grid, curve: Smooth, structure: Structure, coefficients: np.ndarray) -> Proposal:
    """Curve and weights for the proposed coefficients, held.

    At small weights the scale of L is hardly determined; in a joint fit it would drift away.
    """
    start = grid.start(structure, curve.control_points, coefficients, curve.noise_std)
    evidence = -np.inf
    for _ in range(3):
        start, evidence = grid.fit_curve(structure, start)
        if not np.isfinite(evidence):
            break
    return Proposal(grid, structure, start, evidence)
