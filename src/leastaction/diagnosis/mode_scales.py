"""Scales of the modes that a nearly linear motion leaves open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.findings import Finding, find
from leastaction.library import time_symbol
from leastaction.mechanics.euler_lagrange import Points

__all__ = ["free_scales"]

_STATES = 400  # along the motion
_EXACT = 1e-8  # relative: what rounding leaves of equal matrices
_STEP = 2e-4  # of the size of the motion: central differences of the fourth order
_SMOOTH = 1e-2  # relative: differences with one and two steps agree where there is a slope


def free_scales(fit: Fit, curvature: np.ndarray | None = None) -> list[Finding]:
    """Whether the motion is so nearly linear that scales of its modes are open.

    M q̈ + C q̇ + K q = f and S (M q̈ + C q̇ + K q) = f have the same solutions where S f = f. Both have a
    Lagrangian if S M and S K are symmetric: S = Σ_r s_r M φ_r φ_rᵀ with the shapes φ_r of the modes
    (φ_rᵀ M φ_r = 1). S M, S K and S C must be sums of candidates, with the known coefficients in place. The
    forces that drive a mode, and what is nonlinear, decide about these directions: a scale is open if its
    logarithm has a standard error above `indistinct` by the quadratic model of the likelihood, which
    ``curvature``, (n_free, n_free), gives if it is known.
    """
    problem = fit.problem
    names = [name for i, name in enumerate(problem.coordinates) if i not in problem.prescribed]
    present = np.flatnonzero(fit.coefficients)
    timed = any(time_symbol in problem.terms[k].expr.free_symbols for k in present)
    if len(names) < 2 or timed or not fit.converged:
        return []
    places = [p for p, k in enumerate(problem.free.tolist()) if k not in problem.excluded]
    offered = problem.free[places].tolist()
    parts = _linear_parts(fit)
    found = _scale_directions(fit, parts, offered)
    if not found.size:
        return []
    rise = (fit.quadratic.matrix if curvature is None else curvature)[np.ix_(places, places)]
    loose = _null_space(parts[offered].reshape(len(offered), -1).T)
    if loose.size:  # what else candidates can do about the nonlinear part
        inner = np.linalg.pinv(loose.T @ rise @ loose, rcond=1e-10, hermitian=True)
        found = found - loose @ (inner @ (loose.T @ (rise @ found)))
    stiff = np.linalg.eigvalsh(found.T @ rise @ found)
    n_open = int(np.count_nonzero(stiff < DIAGNOSIS.indistinct**-2))
    return [find("mode-scale", names, open=n_open, modes=len(names))] if n_open else []


def _linear_parts(fit: Fit) -> np.ndarray:
    """(n_candidates, n_free, 3 n_dof + 1) K, C, M and constant of every candidate about the mean state.

    Columns are multiplied by the size of the motion, rows divided by that of the forces of their equation.
    """
    problem, n = fit.problem, len(fit.problem.coordinates)
    along = fit.points(_STATES).columns
    rest = np.where(np.arange(3 * n) < n, np.mean(along, axis=1), 0.0)
    spread = np.std(along, axis=1)
    sizes = np.where(spread > 0.0, spread, 1.0)
    moved = rest + np.multiply.outer(np.array([1, -1, 2, -2]) * _STEP, np.diag(sizes))
    states = np.concatenate([moved.reshape(-1, 3, n), rest.reshape(1, 3, n)])
    points = Points(states[:, 0], states[:, 1], states[:, 2], np.zeros(len(states)))
    values = problem.candidates.strong(points)
    values[~np.isfinite(values)] = 0.0
    plus, minus, plus2, minus2 = np.moveaxis(values[..., :-1].reshape(*values.shape[:2], 4, -1), 2, 0)
    near, far = (plus - minus) / (2.0 * _STEP), (plus2 - minus2) / (4.0 * _STEP)
    slopes = (4.0 * near - far) / 3.0
    slopes[np.abs(near - far) > _SMOOTH * np.abs(near)] = 0.0  # dry friction has no slope at rest
    parts = np.concatenate([slopes, values[..., -1:]], axis=2)
    kept = [i for i in range(n) if i not in problem.prescribed]
    whole = np.tensordot(fit.coefficients, parts, 1)[kept]
    return parts[:, kept] / np.maximum(np.linalg.norm(whole, axis=1), 1e-300)[:, None]


def _scale_directions(fit: Fit, parts: np.ndarray, offered: Sequence[int]) -> np.ndarray:
    """(n_offered, n_directions) changes of coefficients that multiply the linear equations by 1 + dS.

    Friction is fitted as well as it can be: its coefficients are never exactly proportional to others.
    """
    _, n, width = parts.shape
    dof = (width - 1) // 3
    whole = np.tensordot(fit.coefficients, parts, 1)
    acting = np.eye(n * n).reshape(n * n, n, n) @ whole  # each entry of dS by itself
    strict = [j for j in range(width) if j // dof != 1]
    span = parts[offered][:, :, strict].reshape(len(offered), -1).T
    wanted = acting[:, :, strict].reshape(n * n, -1).T
    basis, sizes, _ = np.linalg.svd(span, full_matrices=False)
    basis = basis[:, sizes > _EXACT * sizes.max(initial=0.0)]
    entries = _null_space(wanted - basis @ (basis.T @ wanted))
    if not entries.size:
        return np.zeros((len(offered), 0))
    effect = np.tensordot(entries.T, acting, 1).reshape(entries.shape[1], -1)
    return np.linalg.pinv(parts[offered].reshape(len(offered), -1).T, rcond=_EXACT) @ effect.T


def _null_space(matrix: np.ndarray) -> np.ndarray:
    """(n_columns, n_directions), orthonormal."""
    _, sizes, rows = np.linalg.svd(matrix)
    rank = np.count_nonzero(sizes > _EXACT * max(sizes.max(initial=0.0), 1.0))
    return rows[rank:].T
