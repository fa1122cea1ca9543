"""Laws that these data support as well: other structures, and other scales of the modes."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np

from leastaction.diagnosis.effects import Effects
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.estimation.settings import ESTIMATION
from leastaction.estimation.structure import Structure
from leastaction.estimation.volume import positive_definite
from leastaction.findings import Finding, find
from leastaction.library import time_symbol
from leastaction.mechanics.euler_lagrange import Points
from leastaction.selection.alternatives import Alternative
from leastaction.selection.significance import chi_square_cutoff

__all__ = ["free_scales", "rival_warnings"]

_MOST = 3  # rivals that are named
_STATES = 400  # along the motion, at which they are compared
_REACH = (1.0, 2.0, 3.0)  # times the recorded states
_EXACT = 1e-8  # relative: what rounding leaves of equal matrices


def rival_warnings(effects: Effects, alternatives: Sequence[Alternative]) -> list[Finding]:
    """One finding for each rival, the most likely first; a note where terms that hardly matter compete.

    A rival R is a structure that the data do not exclude as the law.  Were it the law, the chosen structure S
    would be the likelier by chance only: by no more than S ∪ R is, whose further |S ∖ R| terms were taken
    from the candidates outside of R.  So R stays in play as long as it loses less than that test allows.

    Rivals have as many terms as S, or one more: where the motion shows little, the law itself may lose by the
    price of a term.  It is then likelier than S with any further term, which follows the noise only.  Not
    where the library is inexact: there a further term always helps.
    """
    fit = effects.fit
    chosen = fit.structure
    same = [a for a in alternatives if len(a.structure) == len(chosen) and a.structure != chosen]
    outside = fit.problem.free.size - len(chosen)
    rivals = [a for a in same if a.cost < _excluded(chosen, a.structure, outside)]
    if np.all(fit.weights.slack < ESTIMATION.slack_left):
        larger = [a for a in alternatives if len(a.structure) == len(chosen) + 1]
        extended = min((a.cost for a in larger if chosen <= a.structure), default=0.0)
        rivals += [a for a in larger if a.cost < min(0.0, extended)]
    texts = [term.text for term in fit.problem.terms]
    out: list[Finding] = []
    for rival in rivals[:_MOST]:
        mine = [texts[m] for m in chosen if m not in rival.structure]
        theirs = [texts[m] for m in rival.structure if m not in chosen]
        state = _where_they_differ(fit, rival.coefficients)
        figures = {"others": theirs, "at_names": list(state), "at_values": list(state.values())}
        minor = effects.minor(list(chosen.without(rival.structure)))
        out.append(
            find("slight-rival", mine, **figures) if minor else find("competing-structures", mine, **figures)
        )
    return out


def _excluded(chosen: Structure, rival: Structure, outside: int) -> float:
    """−2 log likelihood by which a rival has to lose to be excluded."""
    more = len(chosen.without(rival))
    return chi_square_cutoff(more, comb(outside, more))


def _where_they_differ(fit: Fit, second: np.ndarray) -> dict[str, float]:
    """The state, up to three times as far out as recorded, at which the accelerations differ most.

    Empty if they differ nowhere, or are laws of groups of trials.
    """
    if fit.problem.candidates.grouped:
        return {}
    spline = fit.grid.spline
    some = slice(None, None, max(1, spline.n_intervals // _STATES))
    q, qdot, qddot = (s[:, 0] for s in spline.at_quadrature(fit.control_points, some))
    middle = q.mean(axis=0)
    states = np.concatenate([np.stack([middle + reach * (q - middle), reach * qdot]) for reach in _REACH], 1)
    times = np.tile(spline.points[some, 0], len(_REACH))
    points = Points(states[0], states[1], np.zeros_like(states[0]), times)
    with np.errstate(all="ignore"):
        apart = _acceleration(fit, points, fit.coefficients) - _acceleration(fit, points, second)
    size = np.sqrt((qddot**2).mean(axis=0))
    apart = np.linalg.norm(apart / np.maximum(size, 1e-300), axis=1)
    if not np.isfinite(apart).any():
        return {}
    worst = int(np.nanargmax(np.where(np.isfinite(apart), apart, np.nan)))
    names = fit.problem.trajectories.coordinates
    return dict(zip([*names, *(f"{n}_dot" for n in names)], states[:, worst].ravel().tolist(), strict=True))


def _acceleration(fit: Fit, at_rest: Points, coefficients: np.ndarray) -> np.ndarray:
    """(n_points, n_dof) free accelerations at (q, q̇); NaN where the mass matrix is not positive definite."""
    bias = np.tensordot(coefficients, fit.problem.candidates.strong(at_rest), 1).T
    mass = fit.problem.candidates.mass_matrix(at_rest, coefficients)
    usable = positive_definite(mass) & np.isfinite(bias).all(axis=1)
    out = np.full(bias.shape, np.nan)
    out[usable] = -np.linalg.solve(mass[usable], bias[usable][:, :, None])[:, :, 0]
    return out


def free_scales(fit: Fit) -> list[Finding]:
    """Whether the motion is so nearly linear that scales of its modes are open.

    M q̈ + C q̇ + K q = f and S (M q̈ + C q̇ + K q) = f have the same solutions where S f = f. Both have a
    Lagrangian if S M and S K are symmetric: S = Σ_r s_r M φ_r φ_rᵀ with the shapes φ_r of the modes
    (φ_rᵀ M φ_r = 1). S M, S K and S C must be sums of candidates, with the known coefficients in place. The
    forces that drive a mode, and what is nonlinear, decide about these directions: a scale is open if its
    logarithm has a standard error above `indistinct` by the quadratic model of the likelihood.
    """
    problem = fit.problem
    names = [name for i, name in enumerate(problem.coordinates) if i not in problem.prescribed]
    present = np.flatnonzero(fit.coefficients)
    timed = any(time_symbol in problem.terms[k].expr.free_symbols for k in present)
    if len(names) < 2 or timed or not fit.converged:
        return []
    offered = [k for k in problem.free.tolist() if k not in problem.excluded]
    parts = _linear_parts(fit)
    found = _scale_directions(fit, parts, offered)
    if not found.size:
        return []
    rise = fit.score(problem.candidates.subset(offered)).matrix
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
    mean = np.array([[np.mean(column) for column in along[:n]]])
    spread = np.array([np.std(column) for column in along]).reshape(3, n)
    sizes = np.where(spread > 0.0, spread, 1.0)
    rest = Points(mean, np.zeros((1, n)), np.zeros((1, n)), np.zeros(1))
    parts = np.zeros((len(problem.candidates), n, 3 * n + 1))
    parts[:, :, -1] = problem.candidates.strong(rest)[:, :, 0]
    for k, unit in enumerate(np.eye(len(problem.candidates))):
        for (nu, i, j), value in problem.candidates.jacobian(rest, unit).items():
            parts[k, i, nu * n + j] = sizes[nu, j] * float(np.ravel(value)[0])
    parts[~np.isfinite(parts)] = 0.0
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
