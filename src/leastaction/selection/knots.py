"""Finer knots, until they no longer matter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from leastaction.estimation.weights import SLACK_LEFT
from leastaction.estimation.workspace import StructureFit, Workspace

__all__ = ["BETTER", "EXPLAINED", "RELEVANT", "Progress", "equations_hold", "refine_knots", "silent"]

Progress = Callable[[str, dict], None]

EXPLAINED = 0.01  # equation error relative to the forces: exact libraries leave 0.0002 at most
# what warnings propose has to explain the motion so much better: −2 log likelihood beyond the price of every
# term, and a share of the equation error's variance, as in the selection
BETTER, RELEVANT = 10.0, 0.05
_FINER = 1.4  # between one grid and the next
_CONVERGENCE = 4.0  # errors fall with this power of the knot spacing (measured: docs/method.md)
_MOST_MOVED = 0.1  # standard errors
_MOST_SHRUNK = 0.03
_DIGITS = 1e-6
_FASTEST_GROWTH = 10.0
_GROWN = 1.1


def silent(stage: str, details: dict) -> None:
    """For searches that nobody follows."""


def equations_hold(workspace: Workspace, structure: StructureFit) -> bool:
    """Whether every equation holds to one per cent of its terms."""
    return bool(np.all(workspace.equation_error(structure)[0] <= EXPLAINED))


def refine_knots(
    workspace: Workspace,
    structure: StructureFit,
    progress: Progress,
    max_rounds: int = 6,
) -> tuple[StructureFit, bool, bool]:
    """Refine until still finer knots would move coefficients by less than a tenth of a standard error,
    and standard errors by less than 3 %.

    Where the library is not exact, finer splines may follow vibrations that it knows nothing of: refinement
    ends when it makes a large equation error larger.

    Returns
    -------
    StructureFit
    bool
        Whether finer knots would change nothing any more, or should not be laid.
    bool
        Whether that is so because they made a large equation error larger.
    """
    rate = max(t.size / (t[-1] - t[0]) for t in workspace.times)
    growth, factor = np.ones(workspace.observations.n_dof), _FINER
    for done in range(max_rounds):
        before = workspace.knots_per_second
        if not structure.fit.converged or before > 3.0 * rate:
            return structure, False, False
        left = workspace.equation_error(structure)[0]
        start = workspace.refine_knots(factor, structure, growth)
        progress("knots", {"knots_per_second": workspace.knots_per_second})
        finer = workspace.fit(structure.members, start)
        if not finer.fit.converged or not np.isfinite(finer.evidence):
            workspace.set_knots(before)
            return structure, False, False
        off = workspace.equation_error(finer)[0]
        if np.any((off > EXPLAINED) & (off > _GROWN * left)):
            workspace.set_knots(before)
            return structure, True, True
        if done and np.any(off > EXPLAINED):  # not for want of knots
            return finer, False, False
        # finer splines leave a smaller equation error, by nearly the same factor in every round, until
        # hardly any of it is left and its weight no longer matters
        growth = np.clip(finer.fit.weights.physics / structure.fit.weights.physics, 1.0, _FASTEST_GROWTH)
        growth[finer.fit.weights.slack < SLACK_LEFT] = 1.0
        ahead = _change_ahead(structure, finer, 1.0 / (factor**_CONVERGENCE - 1.0))
        structure = finer
        if ahead < 1.0:
            return structure, True, False
        skip = ahead > _FINER**_CONVERGENCE and np.all(off <= EXPLAINED)  # the next round would not do
        factor = _FINER**2 if skip else _FINER
    return structure, False, False


def _change_ahead(structure: StructureFit, finer: StructureFit, share: float) -> float:
    """By how much still finer knots will change a fit, relative to what is allowed.

    Where errors fall with a power of the spacing, that is a fixed share of what the last round changed.
    """
    # without noise standard errors are tiny: digits that nobody needs do not ask for finer knots
    least = np.maximum(_DIGITS * np.abs(finer.estimates), 1e-150)
    before, now = (np.maximum(s.standard_errors, least) for s in (structure, finer))
    move = share * np.abs(finer.estimates - structure.estimates) / now
    shrink = np.minimum(share * (before - now), now - least) / now
    return float(max((move / _MOST_MOVED).max(), (shrink / _MOST_SHRUNK).max()))
