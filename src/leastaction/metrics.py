"""Scores of a discovered Lagrangian: errors, structure, forecasts, and the smallest possible error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_triangular

from leastaction.errors import DataError, InputError
from leastaction.threads import single_threaded

if TYPE_CHECKING:
    from leastaction.data.trajectories import Trajectories
    from leastaction.systems import MechanicalSystem, TrueMotion

    Coefficients = Mapping[Any, float] | ArrayLike

# Length of the pieces a motion is cut into, in seconds: short against the growth of small differences.
_SEGMENT = 0.2
# How much more sharply than by a single sample the pieces are joined. The bound does not depend on it within
# 1e5...1e12 (tests/systems/test_systems.py); an infinite value would lose all digits on long chaotic motions.
_JOINT = 1e8


def _as_mapping(coefficients) -> dict:
    if isinstance(coefficients, Mapping):
        return {_key(k): float(c) for k, c in coefficients.items()}
    return dict(enumerate(np.asarray(coefficients, dtype=float).ravel().tolist()))


def _key(key):
    return "".join(key.split()) if isinstance(key, str) else key


def _support(coefficients, exclude: Iterable[object]) -> set:
    return {k for k, c in _as_mapping(coefficients).items() if c != 0.0} - {_key(k) for k in exclude}


def l2_error(estimated: Coefficients, true: Coefficients, exclude: Iterable[object] = ()) -> float:
    """Return ‖Λ̂ − Λ‖ / ‖Λ‖ over the union of both supports.

    Parameters
    ----------
    estimated, true : mapping or array_like
        Mapping term -> coefficient (terms as text, blanks ignored, or any hashable), or two arrays in the
        same order. A missing term counts as zero.
    exclude : iterable
        Terms left out of both norms, e.g. known ones.

    Returns
    -------
    float

    Examples
    --------
    >>> round(l2_error({"x_dot**2": 0.5, "x": 0.3}, {"x_dot**2": 0.5, "x**2": -0.4}), 4)
    0.7809
    """
    estimated, true, left_out = _as_mapping(estimated), _as_mapping(true), {_key(k) for k in exclude}
    keys = [k for k in {**true, **estimated} if k not in left_out]
    norm = float(np.linalg.norm([true.get(k, 0.0) for k in keys]))
    if norm == 0.0:
        raise InputError("the true coefficients are all zero; give at least one that is not")
    return float(np.linalg.norm([estimated.get(k, 0.0) - true.get(k, 0.0) for k in keys])) / norm


def precision(estimated: Coefficients, true: Coefficients, exclude: Iterable[object] = ()) -> float:
    """Return the fraction of the discovered terms that are true; 0 if nothing was discovered.

    Examples
    --------
    >>> precision([1.0, 0.2, 0.0], [1.0, 0.0, 3.0]), recall([1.0, 0.2, 0.0], [1.0, 0.0, 3.0])
    (0.5, 0.5)
    """
    found = _support(estimated, exclude)
    return len(found & _support(true, exclude)) / len(found) if found else 0.0


def recall(estimated: Coefficients, true: Coefficients, exclude: Iterable[object] = ()) -> float:
    """Return the fraction of the true terms that were discovered; 1 if there are none."""
    wanted = _support(true, exclude)
    return len(wanted & _support(estimated, exclude)) / len(wanted) if wanted else 1.0


def exact_support(estimated: Coefficients, true: Coefficients, exclude: Iterable[object] = ()) -> bool:
    """Return whether exactly the true terms were discovered.

    Examples
    --------
    >>> exact_support({"cos(theta)": 9.7, "theta**2": 0.0}, {"cos(theta)": 9.81})
    True
    """
    return _support(estimated, exclude) == _support(true, exclude)


def forecast_horizon(
    t: ArrayLike,
    predicted: ArrayLike,
    true: ArrayLike,
    tolerance: ArrayLike,
    periodic: Sequence[int] = (),
) -> float:
    """Return the time for which a prediction stays within a tolerance of the truth.

    Parameters
    ----------
    t : array_like, shape (n_times,)
    predicted : array_like, shape (m, n_dof)
        At the first m times. If it is shorter than `t` (a simulation that stopped) or NaN, it has failed
        there.
    true : array_like, shape (n_times, n_dof)
        NaN if unknown; those samples are skipped.
    tolerance : float or array_like, shape (n_dof,)
        Largest error of each coordinate, in its unit.
    periodic : sequence of int
        Coordinates compared modulo 2π.

    Returns
    -------
    float
        Seconds from ``t[0]`` to the last time before the first failure, or the whole duration.

    Examples
    --------
    >>> forecast_horizon([0.0, 1.0, 2.0], [[0.0], [0.1], [0.9]], [[0.0], [0.0], [0.0]], tolerance=0.5)
    1.0
    """
    t, true = np.asarray(t, dtype=float), np.asarray(true, dtype=float)
    predicted = np.asarray(predicted, dtype=float)
    if true.ndim != 2 or t.shape != true.shape[:1] or predicted.shape[1:] != true.shape[1:]:
        raise InputError(
            f"t, predicted and true have shapes {t.shape}, {predicted.shape} and {true.shape}; "
            "expected (n_times,), (m, n_dof) and (n_times, n_dof)"
        )
    reached = min(len(predicted), len(t))
    error = np.full(true.shape, np.inf)
    error[:reached] = predicted[:reached] - true[:reached]
    for i in periodic:
        error[:reached, i] = np.mod(error[:reached, i] + np.pi, 2 * np.pi) - np.pi
    failed = ~(np.abs(error) <= np.asarray(tolerance, dtype=float)) & ~np.isnan(true)
    bad = np.flatnonzero(failed.any(axis=1))
    return float(t[max(bad[0] - 1, 0)] - t[0]) if bad.size else float(t[-1] - t[0])


@dataclass(frozen=True, eq=False)
class CramerRaoBound:
    """Lower bound on the errors of any unbiased estimate of the coefficients.

    Attributes
    ----------
    terms : tuple of str
    coefficients : ndarray, shape (n_terms,)
        Their true values.
    covariance : ndarray, shape (n_terms, n_terms)
        Inverse of the Fisher information, the initial conditions projected out.
    """

    terms: tuple[str, ...]
    coefficients: np.ndarray
    covariance: np.ndarray

    @property
    def standard_errors(self) -> np.ndarray:
        """Square roots of the diagonal, shape (n_terms,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def relative(self) -> float:
        """√trace(F⁻¹) / ‖Λ‖, with Λ the true values of `terms` only: what `l2_error` can reach on them."""
        return float(np.sqrt(np.trace(self.covariance)) / np.linalg.norm(self.coefficients))


@single_threaded()
def cramer_rao_bound(
    system: MechanicalSystem,
    truth: Sequence[TrueMotion],
    noise_std: ArrayLike,
    *,
    unknown: Sequence[str] | None = None,
    observed: Trajectories | None = None,
    velocity_noise_std: ArrayLike | None = None,
) -> CramerRaoBound:
    """Return the Cramér–Rao bound for the coefficients of a system.

    Positions are measured, and velocities if their noise is given, with independent Gaussian noise of known
    size. The terms of the true model are known, but not their coefficients. The initial conditions are
    unknown and projected out. The motion depends on both through the variational equations, which are exact
    and integrated piece by piece. Orthogonal transformations join the pieces, so that the result is accurate
    for chaotic motions.

    Parameters
    ----------
    system : MechanicalSystem
    truth : sequence of TrueMotion
        As from `leastaction.systems.simulate_truth`: t, q, qdot, and the forces.
    noise_std : float or array_like, shape (n_dof,)
        Noise of each coordinate; positive.
    unknown : sequence of str, optional
        Terms (Lagrangian or dissipation) to estimate. By default, all true terms except those in
        ``system.known``.
    observed : Trajectories, optional
        The recordings; their missing samples (NaN) carry no information.
    velocity_noise_std : float or array_like, shape (n_dof,), optional
        Noise of the measured velocities, infinite if not measured. By default, positions only.

    Returns
    -------
    CramerRaoBound

    Raises
    ------
    DataError
        If the motions do not determine the coefficients (e.g. a passive system with nothing known).

    Examples
    --------
    >>> from leastaction import systems
    >>> pendulum = systems.get("single_pendulum")
    >>> truth = systems.simulate_truth(pendulum, trials=1, duration=2.0, seed=0)
    >>> bound = cramer_rao_bound(pendulum, truth, noise_std=0.01)
    >>> bound.terms
    ('theta_dot**2', 'cos(theta)')
    >>> 0.0 < bound.relative < 0.1
    True
    """
    from leastaction.systems._variational import Variational

    terms = tuple(system.free if unknown is None else unknown)
    sigma = np.broadcast_to(np.asarray(noise_std, dtype=float), (system.n_dof,))
    if not (np.isfinite(sigma).all() and (sigma > 0).all()):
        raise InputError(f"noise_std={noise_std!r}; expected positive numbers (no noise, no bound)")
    rate_sigma = np.inf if velocity_noise_std is None else np.asarray(velocity_noise_std, dtype=float)
    rate_sigma = np.broadcast_to(rate_sigma, (system.n_dof,))
    if not (rate_sigma > 0).all():
        raise InputError(f"velocity_noise_std={velocity_noise_std!r}; expected positive numbers")
    if not terms:
        raise InputError("no term is unknown; give at least one in `unknown`")
    if observed is not None and len(observed) != len(truth):
        raise InputError(f"observed has {len(observed)} trajectories and truth {len(truth)}; expected pairs")
    variational = Variational(system, terms)
    blocks = []
    for k, motion in enumerate(truth):
        seen = np.ones(motion.q.shape, dtype=bool) if observed is None else np.isfinite(observed[k].q)
        if seen.shape != motion.q.shape:
            raise InputError(f"observed trajectory {k} has shape {seen.shape}; expected {motion.q.shape}")
        rated = np.broadcast_to(np.isfinite(rate_sigma), seen.shape)
        if observed is not None and rated.any():
            rates = observed[k].velocities
            rated = rated & (np.zeros_like(seen) if rates is None else np.isfinite(rates))
        both = np.concatenate([sigma, rate_sigma]), np.concatenate([seen, rated], axis=1)
        blocks.append(_information_root(variational, motion, *both))
    coefficients = np.array([{**system.lagrangian, **system.dissipation}[k] for k in terms])
    # In units of the true values the columns are comparable.
    scale = np.where(coefficients == 0, 1.0, np.abs(coefficients))
    root = _triangle(np.concatenate(blocks) * scale)
    size = np.linalg.svd(root, compute_uv=False) if root.shape[0] == len(terms) else np.zeros(1)
    if not size[-1] > 1e-10 * size[0]:
        raise DataError(
            f"these motions do not determine the coefficients of {', '.join(terms)}; "
            "drive the system, leave one of them out of `unknown`, or take longer motions"
        )
    inverse = solve_triangular(root, np.eye(len(terms))) * scale[:, None]
    return CramerRaoBound(terms, coefficients, inverse @ inverse.T)


def _information_root(variational, motion, sigma: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return rows B with BᵀB the information of one motion on the coefficients.

    ``sigma`` and ``seen`` cover the state: positions, then velocities. Its initial value is projected out:
    the unknowns are the states at the starts of short pieces and the coefficients. Each state is tied to the
    next by its transition matrix and eliminated by a QR decomposition (a square-root information filter).
    """
    n, p = variational.n_dof, variational.n_terms
    forces = motion.drive
    if forces is None and motion.forces is not None:
        forces = CubicSpline(motion.t, motion.forces)
    steps = variational.transitions(motion.t, motion.q, motion.qdot, forces)
    length = max(1, round(_SEGMENT / float(np.mean(np.diff(motion.t)))))
    scale = np.minimum(sigma[:n], sigma[n:] * _SEGMENT)  # of what is known most exactly
    joint = _JOINT / np.concatenate([scale, scale / _SEGMENT])
    carry = np.zeros((0, 2 * n + p))
    for start in range(0, len(motion.t), length):
        size = min(length, len(motion.t) - start)
        path = np.empty((size, 2 * n, 2 * n + p))
        path[0] = np.eye(2 * n, 2 * n + p)
        for i in range(1, size):
            path[i] = _compose(steps[start + i - 1], path[i - 1], n)
        rows = (path[:, : 2 * n] / sigma[:, None])[seen[start : start + size]]
        carry = _triangle(np.concatenate([carry, rows]))
        if start + size < len(motion.t):
            across = _compose(steps[start + size - 1], path[-1], n)
            carry = _move_on(carry, across, joint)
    # A direction of the state that nothing shows (a cyclic angle that is not measured) takes nothing away.
    left, size, _ = np.linalg.svd(carry[:, : 2 * n], full_matrices=False)
    left = left[:, size > 1e-14 * size.max(initial=1.0)]
    return carry[:, 2 * n :] - left @ (left.T @ carry[:, 2 * n :])


def _triangle(rows: np.ndarray) -> np.ndarray:
    """Return R of the QR decomposition: the same information in as few rows as possible."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _compose(step: np.ndarray, path: np.ndarray, n: int) -> np.ndarray:
    out = step[:, : 2 * n] @ path
    out[:, 2 * n :] += step[:, 2 * n :]
    return out


def _move_on(carry: np.ndarray, across: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Turn information on (state, coefficients) into that on (next state, coefficients)."""
    m = len(across)
    # The heavy rows of the joint go first: Householder reflections are accurate in that arrangement.
    tie = np.concatenate([-across[:, :m], np.eye(m), -across[:, m:]], axis=1) * joint[:, None]
    rest = np.concatenate([carry[:, :m], np.zeros((len(carry), m)), carry[:, m:]], axis=1)
    return _triangle(np.concatenate([tie, rest]))[m:, m:]
