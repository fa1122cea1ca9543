"""Accelerations from the coefficients of a Lagrangian, for methods that give no model of their own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import leastaction as la
from reproduction.problem import Acceleration

__all__ = ["acceleration_of"]

_WORST_CONDITION = 1e12  # of a mass matrix that is still inverted


def acceleration_of(library: la.Library, coefficients: Mapping[str, float]) -> Acceleration:
    """Return ``acceleration(q, qdot, forces)`` of L = Σ_k λ_k φ_k.

    The Euler–Lagrange expression is linear in q̈: its value at q̈ = 0 is the right-hand side, and what it gains
    at unit q̈ are the columns of the mass matrix.

    Parameters
    ----------
    library : Library
    coefficients : dict
        Term text → coefficient, the known ones included.

    Returns
    -------
    callable
        Of (n, n_dof) arrays, forces None if passive; NaN where the mass matrix is singular.
    """
    terms = [library[library.index(text)] for text, value in coefficients.items() if value != 0.0]
    values = np.array([value for value in coefficients.values() if value != 0.0])
    if not terms:
        return lambda q, qdot, forces=None: np.full(np.shape(q), np.nan)
    reduced = la.Library(terms, library.coordinates)
    units = np.vstack([np.zeros(library.n_dof), np.eye(library.n_dof)])

    def acceleration(q, qdot, forces=None):
        q, qdot = np.asarray(q, dtype=float), np.asarray(qdot, dtype=float)
        n, n_dof = q.shape
        tiled = [np.tile(a, (len(units), 1)) for a in (q, qdot)]
        columns = la.euler_lagrange(reduced, *tiled, np.repeat(units, n, axis=0))
        # far from the data a term may overflow
        with np.errstate(over="ignore", invalid="ignore"):
            at_rest, *at_unit = (columns @ values).reshape(len(units), n, n_dof)
            mass = np.stack([a - at_rest for a in at_unit], axis=-1)
            force = -at_rest if forces is None else forces - at_rest
        return _solved(mass, force)

    return acceleration


def _solved(mass: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Solve M q̈ = force, (n, d, d) and (n, d); NaN where M is singular or not finite."""
    out = np.full(force.shape, np.nan)
    good = np.isfinite(mass).all(axis=(1, 2)) & np.isfinite(force).all(axis=1)
    good[good] = np.linalg.cond(mass[good]) < _WORST_CONDITION
    out[good] = np.linalg.solve(mass[good], force[good][..., None])[..., 0]
    return out
