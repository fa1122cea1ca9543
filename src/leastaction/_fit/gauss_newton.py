"""Gauss–Newton with Levenberg–Marquardt damping on the joint problem.

The control points are eliminated by a banded Cholesky factorisation H = RᵀR; the coefficients solve
the dense Schur complement

    (A − Cᵀ H⁻¹ C) Δλ = −(g_λ − Cᵀ H⁻¹ g_P),

whose inverse is the covariance of λ (Golub & Pereyra 2003, Inverse Problems 19:R1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from leastaction._euler_lagrange import EulerLagrange
from leastaction._fit.problem import Normal, Observations, Physics, Weights, linearise

__all__ = ["JointFit", "Quadratic", "condense", "fit_joint"]


@dataclass(frozen=True, eq=False)
class JointFit:
    """Optimum of the joint problem at given weights.

    Attributes
    ----------
    control_points : (n_ctrl, n_dof) array
    coefficients : (n_columns,) array
        Known ones included.
    covariance : (n_free, n_free) array
    cost, misfit : float
        With and without the volume term.
    log_volume : float
        Mean over time of log |det M|.
    regular : float
        Share of the motion along which M is positive definite.
    squares, equation : (n_dof,) arrays
        Σ (y − N P)² and ∫ r_i² dt.
    logdet : float
        log |H|, for the marginal likelihood.
    weights : Weights
    status : str
        "converged", "stalled", "step limit" or "not finite".
    n_steps : int
    """

    control_points: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    cost: float
    misfit: float
    log_volume: float
    regular: float
    squares: np.ndarray
    equation: np.ndarray
    logdet: float
    weights: Weights
    status: str
    n_steps: int

    @property
    def converged(self) -> bool:
        return self.status in ("converged", "stalled")


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The cost as a function of the coefficients alone, the curve eliminated: ½-gradient and matrix."""

    gradient: np.ndarray
    matrix: np.ndarray
    curve_shift: np.ndarray
    curve_response: np.ndarray
    logdet: float


def factorise(observations: Observations, normal: Normal, weights: Weights, damping: float = 0.0) -> np.ndarray:
    """Banded Cholesky factor of H; raises LinAlgError when H is not positive definite."""
    banded = np.tensordot(weights.physics, normal.equation_bands, 1)
    observations.add_band(banded, weights.noise_std)
    banded[0] *= 1.0 + damping + 1e-14
    return cholesky_banded(banded, overwrite_ab=True, lower=True, check_finite=False)


def logdet(factor: np.ndarray) -> float:
    """log |H| from its Cholesky factor."""
    return 2.0 * float(np.log(factor[0]).sum())


def condense(observations: Observations, normal: Normal, weights: Weights, damping: float = 0.0) -> Quadratic:
    """Eliminate the control points.

    Raises
    ------
    numpy.linalg.LinAlgError
        When H is not positive definite.
    """
    factor = factorise(observations, normal, weights, damping)
    right = np.column_stack([normal.gradient_curve, normal.border])
    solved = cho_solve_banded((factor, True), right, overwrite_b=True, check_finite=False)
    shift, response = solved[:, 0], solved[:, 1:]
    matrix = normal.corner - normal.border.T @ response
    return Quadratic(
        normal.gradient_coefficients - normal.border.T @ shift,
        0.5 * (matrix + matrix.T),
        shift,
        response,
        logdet(factor),
    )


def symmetric_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a positive semi-definite matrix, scaled first so that units do not matter.

    Directions that the data cannot see get a huge, finite variance.
    """
    scale = np.sqrt(np.clip(np.diag(matrix), 1e-300, None))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    values = np.clip(values, 1e-13 * max(values[-1], 1e-300), None) if values.size else values
    return (vectors / values) @ vectors.T / np.outer(scale, scale)


def fit_joint(
    observations: Observations,
    physics: Physics,
    weights: Weights,
    control_points: np.ndarray,
    coefficients: np.ndarray,
    *,
    tolerance: float = 1e-2,
    max_steps: int = 30,
) -> JointFit:
    """Minimise the joint cost from a start.

    Parameters
    ----------
    tolerance : float
        Stop when the step is predicted to lower the cost by less than this (a χ² of 0.01 is a
        tenth of a standard error).

    Returns
    -------
    JointFit
        Never raises for numerical failure: see ``status``.
    """
    shape, damping, status = control_points.shape, 0.0, "step limit"
    normal = linearise(observations, physics, weights, control_points, coefficients)
    if not np.isfinite(normal.cost):
        return _failed(control_points, coefficients, physics, weights, normal)
    step = 0
    for step in range(1, max_steps + 1):
        try:
            quadratic = condense(observations, normal, weights, damping)
        except np.linalg.LinAlgError:
            damping = max(10.0 * damping, 1e-8)
            if damping > 1e8:
                status = "not finite"
                break
            continue
        matrix = quadratic.matrix + damping * np.diag(np.diag(quadratic.matrix))
        delta = -symmetric_inverse(matrix) @ quadratic.gradient
        shift = -(quadratic.curve_shift + quadratic.curve_response @ delta)
        predicted = -(normal.gradient_curve @ shift + normal.gradient_coefficients @ delta)
        trial_coefficients = coefficients.copy()
        trial_coefficients[physics.free] += delta
        trial = linearise(observations, physics, weights, control_points + shift.reshape(shape), trial_coefficients)
        if np.isfinite(trial.cost) and trial.cost <= normal.cost + 1e-9 * abs(normal.cost):
            control_points, coefficients, normal = (
                control_points + shift.reshape(shape),
                trial_coefficients,
                trial,
            )
            damping = damping / 10.0 if damping > 1e-6 else 0.0
            if predicted < tolerance and damping < 1e-3:
                status = "converged"
                break
        else:
            if predicted < tolerance:  # no measurable progress is left: rounding decides
                status = "stalled"
                break
            damping = max(10.0 * damping, 1e-4)
            if damping > 1e8:
                status = "stalled"
                break
    try:
        quadratic = condense(observations, normal, weights)
    except np.linalg.LinAlgError:
        return _failed(control_points, coefficients, physics, weights, normal)
    # the weights are estimated too: what the volume term seems to know of the scale, they forget
    slack = np.where(weights.slack > 0, weights.slack, np.inf)
    covariance = symmetric_inverse(quadratic.matrix - 2.0 * (normal.volume.T / slack) @ normal.volume)
    return JointFit(
        control_points,
        coefficients,
        covariance,
        normal.cost,
        normal.misfit,
        normal.log_volume,
        normal.regular,
        normal.squares,
        normal.equation,
        quadratic.logdet,
        weights,
        status,
        step,
    )


def _failed(control_points, coefficients, physics, weights, normal) -> JointFit:
    n = physics.n_free
    nothing = np.full((n, n), np.nan)
    return JointFit(
        control_points,
        coefficients,
        nothing,
        np.inf,
        np.inf,
        0.0,
        0.0,
        normal.squares,
        normal.equation,
        np.nan,
        weights,
        "not finite",
        0,
    )


def score_candidates(
    observations: Observations, physics: Physics, fit: JointFit, candidates: EulerLagrange
) -> Quadratic:
    """Quadratic model of the cost in the coefficients of *all* candidates about a fit."""
    normal = linearise(observations, physics, fit.weights, fit.control_points, fit.coefficients, candidates)
    return condense(observations, normal, fit.weights)
