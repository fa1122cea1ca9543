"""The joint least-squares problem in spline and coefficients, and its banded normal equations.

    cost(P, λ) = Σ_i ‖y_i − N P_i‖² / σ_i² + Σ_i w_i ∫ r_i² dt,      r = Σ_k λ_k E[φ_k] − f

Unknowns of the curve are numbered control point by control point (coordinate fastest), so that the
Gauss–Newton matrix of P is banded and λ forms a dense border.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leastaction._euler_lagrange import EulerLagrange, Points
from leastaction._smoothing import banded_gram
from leastaction._spline import SplineGrid

__all__ = ["Normal", "Observations", "Physics", "Weights", "linearise"]

_RELATIVE_FLOOR = 1e-6
_CHUNK = 4096  # knot intervals handled at once: bounds memory, large enough for numpy


@dataclass(frozen=True, eq=False)
class Weights:
    """Noise σ_i, equation weight w_i, and degrees of freedom left to the equation error, each (n_dof,).

    ``slack`` weighs the volume term (see ``_volume``); it vanishes when the equations hold exactly.
    """

    noise_std: np.ndarray
    physics: np.ndarray
    slack: np.ndarray


class Observations:
    """Measured coordinates against a spline grid; NaN samples are left out coordinate by coordinate."""

    def __init__(self, grid: SplineGrid, times: Sequence[np.ndarray], values: Sequence[np.ndarray]) -> None:
        stacked = np.concatenate(values)
        design = grid.design(times)
        self.grid = grid
        self.valid = np.isfinite(stacked)
        self.counts = self.valid.sum(axis=0)
        self.n_dof = stacked.shape[1]
        # no sensor is better than a millionth of its range; below that rounding and the data's own
        # integration errors would count as physics
        self.noise_floor = _RELATIVE_FLOOR * np.nanstd(stacked, axis=0)
        complete = bool(self.valid.all())
        self._designs, self._y, self._grams = [], [], []
        for i in range(self.n_dof):
            keep = self.valid[:, i]
            self._designs.append(design if complete else design[keep])
            self._y.append(stacked[keep, i])
            shared = complete and i > 0
            self._grams.append(self._grams[0] if shared else banded_gram(self._designs[i], grid.degree))

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]:
        """y − N P for each coordinate, valid samples only."""
        return [
            y - d @ control_points[:, i] for i, (d, y) in enumerate(zip(self._designs, self._y, strict=True))
        ]

    def add_gradient(self, gradient: np.ndarray, control_points: np.ndarray, noise_std: np.ndarray) -> np.ndarray:
        """Add the data's half gradient; return Σ residual² of each coordinate."""
        squares = np.empty(self.n_dof)
        for i, residual in enumerate(self.residuals(control_points)):
            gradient[i :: self.n_dof] -= self._designs[i].T @ residual / noise_std[i] ** 2
            squares[i] = residual @ residual
        return squares

    def add_band(self, banded: np.ndarray, noise_std: np.ndarray) -> None:
        """Add NᵀN / σ² of every coordinate to lower banded storage."""
        for i, gram in enumerate(self._grams):
            banded[:: self.n_dof, i :: self.n_dof] += gram / noise_std[i] ** 2


@dataclass(frozen=True, eq=False)
class Physics:
    """The equations of motion: columns, which coefficients are free, forces at the quadrature points.

    Attributes
    ----------
    columns : EulerLagrange
    free : (n_columns,) bool array
        Coefficients to estimate; the others are known.
    forces : (n_intervals, n_quadrature, n_dof) array or None
    """

    columns: EulerLagrange
    free: np.ndarray
    forces: np.ndarray | None

    @property
    def n_free(self) -> int:
        return int(self.free.sum())


@dataclass(eq=False)
class Normal:
    """Normal equations at one point: H, C, A, gradients, and the parts of the cost.

    Attributes
    ----------
    equation_bands : (n_dof, bandwidth + 1, n_ctrl · n_dof) array
        Lower storage of ∫ J_iᵀJ_i dt for each equation i; H is the data's part plus Σ w_i of these.
    border : (n_ctrl · n_dof, n_border) array
        C, the block between control points and coefficients.
    corner : (n_border, n_border) array
        A, the block of the coefficients.
    gradient_curve, gradient_coefficients
        Half gradients of the cost.
    squares : (n_dof,) array
        Σ (y − N P)² of each coordinate.
    equation : (n_dof,) array
        ∫ r_i² dt of each equation.
    volume : (n_dof, n_border) array
        slack_i · mean over time of (∂M/∂λ_k M⁻¹)_ii, the gradient of the volume term.
    log_volume : float
        Mean over time of log |det M|.
    regular : float
        Share of the motion along which M is positive definite.
    misfit : float
        Data and equation parts of the cost.
    cost : float
        The same plus the volume term.
    """

    equation_bands: np.ndarray
    border: np.ndarray
    corner: np.ndarray
    gradient_curve: np.ndarray
    gradient_coefficients: np.ndarray
    squares: np.ndarray
    equation: np.ndarray
    volume: np.ndarray
    log_volume: float = 0.0
    regular: float = 0.0
    misfit: float = 0.0
    cost: float = 0.0


def linearise(
    observations: Observations,
    physics: Physics,
    weights: Weights,
    control_points: np.ndarray,
    coefficients: np.ndarray,
    border: EulerLagrange | None = None,
) -> Normal:
    """Normal equations of the joint problem at (P, λ).

    Parameters
    ----------
    control_points : (n_ctrl, n_dof) array
    coefficients : (n_columns,) array
        Known ones included.
    border : EulerLagrange, optional
        Columns to put into the border instead of the free ones (to score candidates that are not in
        the model).
    """
    grid, n = observations.grid, observations.n_dof
    size, n_local = grid.n_ctrl * n, (grid.degree + 1) * n
    n_border = physics.n_free if border is None else len(border)
    out = Normal(
        np.zeros((n, n_local, size)),
        np.zeros((size, n_border)),
        np.zeros((n_border, n_border)),
        np.zeros(size),
        np.zeros(n_border),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, n_border)),
    )
    out.squares = observations.add_gradient(out.gradient_curve, control_points, weights.noise_std)
    for chunk in grid.chunks(_CHUNK):
        _add_physics(out, grid, physics, weights, control_points, coefficients, border, chunk)
    out.misfit = float(np.sum(out.squares / weights.noise_std**2) + np.sum(weights.physics * out.equation))
    out.cost = out.misfit - 2.0 * weights.slack.mean() * out.log_volume
    out.gradient_coefficients -= out.volume.sum(axis=0)
    return out


def _add_physics(out, grid, physics, weights, control_points, coefficients, border, chunk) -> None:
    n = control_points.shape[1]
    states = grid.at_quadrature(control_points, chunk)
    m, n_quad = states[0].shape[:2]
    points = Points(*(s.reshape(-1, n) for s in states))
    strong = physics.columns.strong(points)  # (n_columns, n_dof, n_points)
    residual = np.tensordot(coefficients, strong, 1)
    if physics.forces is not None:
        residual -= physics.forces[chunk].reshape(-1, n).T
    quadrature = grid.weights[chunk].reshape(-1)
    out.equation += (residual**2 * quadrature).sum(axis=1)

    root = np.sqrt(quadrature)
    local = _local_jacobian(grid, physics.columns.jacobian(points, coefficients), root, chunk, n)
    columns = strong[physics.free] if border is None else border.strong(points)
    for i in range(n):
        jacobian, transposed = local[i], local[i].transpose(0, 2, 1)
        r = (root * residual[i]).reshape(m, n_quad, 1)
        e = (root * columns[:, i]).reshape(-1, m, n_quad).transpose(1, 2, 0)
        weight = weights.physics[i]
        grid.scatter_band(out.equation_bands[i], transposed @ jacobian, chunk, n)
        grid.scatter_rows(out.gradient_curve[:, None], weight * (transposed @ r), chunk, n)
        grid.scatter_rows(out.border, weight * (transposed @ e), chunk, n)
        flat = e.reshape(m * n_quad, -1)
        out.corner += weight * (flat.T @ flat)
        out.gradient_coefficients += weight * (flat.T @ r.ravel())


    if weights.slack.any():  # it is zero for an exact model: nothing to add then
        _add_volume(out, grid, physics, weights.slack, states, coefficients, border)


def _add_volume(out, grid, physics, slack, states, coefficients, border) -> None:
    """The volume term −2 Σ_i slack_i ⟨log |det M|⟩ of the cost and its derivatives in λ.

    The equation error r is what is random, not the curve: the density of the curve carries the factor
    |∂r/∂q̈| = |det M| for every degree of freedom of the equation error.  Without it the cost rewards
    small coefficients, and large equation errors shrink all of them (errors-in-variables bias).
    """
    n = states[0].shape[2]
    middle = Points(*(s[:, s.shape[1] // 2] for s in states))
    share = 1.0 / grid.n_intervals
    mass = physics.columns.mass_matrix(middle, coefficients)
    usable = _positive_definite(mass)
    out.regular += share * np.count_nonzero(usable)
    if not usable.any():
        return
    out.log_volume += share * np.linalg.slogdet(mass[usable])[1].sum()
    chosen = physics.columns.subset(np.flatnonzero(physics.free)) if border is None else border
    if not len(chosen):
        return
    inverse = np.linalg.inv(mass[usable])
    parts = np.stack([chosen.mass_of(k, middle)[usable] @ inverse for k in range(len(chosen))])  # (K, points, n, n)
    out.volume += slack[:, None] * share * np.einsum("kpii->ik", parts)
    flat = parts.reshape(len(chosen), -1)
    turned = parts.transpose(0, 1, 3, 2).reshape(len(chosen), -1)
    out.corner += share * slack.mean() * (flat @ turned.T)


def _positive_definite(matrices: np.ndarray) -> np.ndarray:
    """Which of many small symmetric matrices are positive definite: all leading minors are positive."""
    out = np.isfinite(matrices).all(axis=(1, 2))
    safe = np.where(out[:, None, None], matrices, 0.0)
    for k in range(1, matrices.shape[1] + 1):
        out &= np.linalg.det(safe[:, :k, :k]) > 0.0
    return out


def _local_jacobian(grid: SplineGrid, jacobian: dict, root: np.ndarray, chunk: slice, n: int) -> list[np.ndarray]:
    """For each equation ∂(scaled residual)/∂(local control points): (n_intervals, n_quadrature, (degree + 1) · n_dof)."""
    basis = [grid.quadrature_basis(chunk, nu) for nu in range(3)]
    m, n_quad, n_basis = basis[0].shape
    local = np.zeros((n, m, n_quad, n_basis, n))
    for (nu, i, j), value in jacobian.items():
        local[i, ..., j] += (root * value).reshape(m, n_quad, 1) * basis[nu]
    return list(local.reshape(n, m, n_quad, n_basis * n))
