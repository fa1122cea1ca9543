"""Test whether the forces act on the stated coordinates, with the stated size.

An exchange of the forces of two coordinates is tried where it leaves less of the weak form to all candidates:
the search begins anew, and the exchange is named if it leads to equations that hold and explain the motion
better.  What the exchange leaves in the equations of the fit is no evidence, because terms of a wrong
structure imitate it, and a force that was recorded as zero looks like one.

A scale is read from what is left of the equations of the fit: that residual is regressed on the forces, after
both have been freed of what the terms of the model could take up.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.diagnosis.wider_search import begun_anew
from leastaction.estimation.fit import Fit
from leastaction.estimation.intervals import first_points
from leastaction.findings import Finding, find
from leastaction.selection.likelihood_refinement import value
from leastaction.selection.search_state import Search
from leastaction.selection.significance import chi_square_cutoff
from leastaction.selection.weak_proposals import unexplained

__all__ = ["exchanged_forces", "scaled_forces"]

_MOST_POINTS = 200_000  # points along the motion, enough for a share
_NULL = 1e-6  # relative: rounding
_MOST_TRIED = 6  # pairs, each perhaps a search: all of up to four coordinates


def exchanged_forces(search: Search) -> list[Finding]:
    """The two coordinates whose forces, exchanged, explain the motion best; nothing if none do.

    All candidates together leave less of the weak form with the right forces.  An exchange that leaves less
    at some width costs a search on the knots of the fit, without refinement.
    """
    fit = search.found
    data = fit.problem.trajectories
    own = [i for i in range(data.n_dof) if i not in fit.problem.prescribed]
    pairs = list(combinations(own, 2))
    if not data.driven or len(pairs) > _MOST_TRIED:
        return []
    best, most = None, 0.5 * chi_square_cutoff(1, len(pairs))
    curve = fit.grid.smooth()
    before = unexplained(fit.grid, curve, search.seed)
    given = [t.forces for t in data]
    for i, j in pairs:
        order = np.arange(data.n_dof)
        order[[i, j]] = j, i
        exchanged = [None if f is None else f[:, order] for f in given]
        if all(f is None or np.array_equal(f, f[:, order]) for f in given):
            continue
        grid = fit.grid.pushed(exchanged)
        if not np.any(unexplained(grid, curve, search.seed) < before):
            continue
        found = begun_anew(search, grid, curve)
        if found is not None and value(found) - value(fit) > most:
            best, most = (i, j), value(found) - value(fit)
    if best is None:
        return []
    gain = 2.0 * most if np.isfinite(most) else None  # None: the equations of the fit cannot be solved
    return [find("swapped-forces", [data.coordinates[i] for i in best], gain=gain)]


def scaled_forces(fit: Fit) -> list[Finding]:
    """Forces that are larger or smaller than given by a factor, where it explains much of the residual."""
    if fit.grid.forces is None or np.isnan(fit.problem.known).all():
        return []  # without a known coefficient the scale of L follows that of the forces
    some = slice(None, None, 1 + fit.grid.spline.n_intervals // _MOST_POINTS)
    forces = fit.grid.forces.values[some, 0].T
    strong = fit.problem.candidates.strong(first_points(fit.grid.spline, fit.control_points, some))
    root = np.sqrt(fit.weights.physics)[:, None]
    residual = (root * (np.tensordot(fit.coefficients, strong, 1) - forces)).ravel()
    members = (strong[list(fit.structure)] * root).reshape(len(fit.structure), -1)
    basis, _ = np.linalg.qr(members.T)
    column = (root * forces).ravel()
    size = float(column @ column)
    column = column - basis @ (basis.T @ column)
    left = float(column @ column)
    if left <= _NULL * size:  # terms of the model can imitate it
        return []
    amount = float(column @ residual) / left
    share = amount**2 * left / float(residual @ residual)
    if share <= DIAGNOSIS.force_share:
        return []
    return [find("scaled-forces", factor=1.0 + amount, share=share)]
