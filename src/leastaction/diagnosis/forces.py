"""What the residual of the equations says about the forces: scaled, or on the wrong coordinate.

The residual r of a fit is regressed on the signature of every cause, after both have been freed of what the
terms of the model could take up.  A signature that takes a large share of Σ w_i ∫ r_i² names the cause.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.findings import Finding, find
from leastaction.mechanics.euler_lagrange import Points

__all__ = ["doubts_about_forces"]

_NULL = 1e-6


def doubts_about_forces(fit: Fit) -> list[Finding]:
    """The cause that explains most of the residual; nothing if none explains much of it."""
    if fit.grid.forces is None:
        return []
    q, qdot, qddot = (s[:, 0] for s in fit.grid.spline.at_quadrature(fit.control_points))
    forces = fit.grid.forces.values[:, 0].T
    strong = fit.problem.candidates.strong(Points(q, qdot, qddot))
    root = np.sqrt(fit.weights.physics)[:, None]
    residual = (root * (np.tensordot(fit.coefficients, strong, 1) - forces)).ravel()
    members = (strong[list(fit.structure)] * root).reshape(len(fit.structure), -1)
    basis, _ = np.linalg.qr(members.T)
    best, most = None, DIAGNOSIS.force_share
    for swapped, signature in _signatures(fit, forces):
        column = (root * signature).ravel()
        size = float(column @ column)
        column = column - basis @ (basis.T @ column)
        left = float(column @ column)
        if left <= _NULL * size:  # the model's own terms can imitate it
            continue
        amount = float(column @ residual) / left
        share = amount**2 * left / float(residual @ residual)
        if share > most and (not swapped or amount > DIAGNOSIS.swapped):
            best, most = (swapped, amount, share), share
    if best is None:
        return []
    swapped, amount, share = best
    if swapped:
        return [find("swapped-forces", swapped, share=share)]
    return [find("scaled-forces", factor=1.0 + amount, share=share)]


def _signatures(fit: Fit, forces: np.ndarray) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
    """(coordinates whose forces are exchanged; none: all are scaled, residual that one unit leaves)."""
    names = fit.problem.trajectories.coordinates
    if not np.isnan(fit.problem.known).all():  # otherwise the scale of L follows that of the forces
        yield (), forces
    for i in range(len(forces)):
        for j in range(i):
            swap = np.zeros_like(forces)
            swap[i], swap[j] = forces[j] - forces[i], forces[i] - forces[j]
            yield (names[j], names[i]), swap
