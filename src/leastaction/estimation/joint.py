"""The joint least-squares problem in spline and coefficients, and its banded normal equations.

    cost(P, λ) = Σ_c ‖y_c − N_c P_i‖² / σ_c² + Σ_i w_i ∫ r_i² dt,      r = Σ_k λ_k E[φ_k] − f

with one channel c for the positions of each coordinate i, N_c = N, and one for every velocity and
acceleration that is measured, N_c = Ṅ and N̈, each with a noise of its own.  A coordinate that is prescribed
has no equation of motion; r_i = q̈_i stands in its place, as for a free mass that white noise pushes, which
makes its curve a smoothing spline (Wahba 1978, J. R. Stat. Soc. B 40:364).

Unknowns of the curve are numbered control point by control point (coordinate fastest), so that the
Gauss–Newton matrix of P is banded and λ forms a dense border.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from leastaction.curve.bspline import SplineGrid
from leastaction.curve.smoothing import banded_gram
from leastaction.data.trajectories import Rate
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

__all__ = ["Linearisation", "Observations", "Physics", "Weights", "linearise", "positive_definite"]

_RELATIVE_FLOOR = 1e-6
_VOLUME_POINTS = 512
_CHUNK = 4096  # knot intervals handled at once: bounds memory, large enough for numpy


@dataclass(frozen=True, eq=False)
class Weights:
    """Noise of each channel, equation weight w_i, and degrees of freedom left to the equation error.

    The first n_dof channels are the positions; ``physics`` and ``slack`` have shape (n_dof,). ``slack``
    vanishes when the equations hold exactly, and where a coordinate has none. ``force_density`` is the
    spectral density of the noise of the given forces.
    """

    noise_std: np.ndarray
    physics: np.ndarray
    slack: np.ndarray
    force_density: np.ndarray | float = 0.0

    @property
    def volume(self) -> np.ndarray:
        """(n_dof,) weight of the volume term: degrees of freedom of what really pushes (see ``_add_volume``).

        The noise of measured forces is in the equations, too, but pushes nothing.
        """
        return self.slack * (1.0 - np.clip(self.physics * self.force_density, 0.0, 1.0))

    @property
    def position_std(self) -> np.ndarray:
        """(n_dof,) noise of the positions."""
        return self.noise_std[: self.physics.size]


@dataclass(frozen=True, eq=False)
class _Channel:
    """Valid samples of one coordinate, or of one of its derivatives, and the basis at their times."""

    coordinate: int
    design: sp.csr_array
    transposed: sp.csr_array
    gram: np.ndarray
    y: np.ndarray


class Observations:
    """Measured coordinates, and rates, against a spline grid; NaN samples are left out channel by channel.

    Attributes
    ----------
    counts : (n_channels,) int array
        Samples of each channel: positions of the coordinates in order, then ``rates``.
    coordinates : (n_channels,) int array
        The coordinate of each channel.
    floors, noise_floor : (n_channels,) and (n_dof,) arrays
        No sensor is better than a millionth of its range; below that rounding and the data's own
        integration errors would count as physics.
    """

    def __init__(
        self,
        grid: SplineGrid,
        times: Sequence[np.ndarray],
        values: Sequence[np.ndarray],
        rates: Sequence[Rate] = (),
    ) -> None:
        stacked = np.concatenate(values)
        self.grid, self.n_dof = grid, stacked.shape[1]
        measured = [(i, 0, column) for i, column in enumerate(stacked.T)]
        measured += [(r.coordinate, r.derivative, np.concatenate(r.values)) for r in rates]
        designs = {nu: grid.design(times, nu) for nu in dict.fromkeys(nu for _, nu, _ in measured)}
        whole: dict[int, _Channel] = {}  # complete columns share basis and Gram matrix, by derivative
        self._channels: list[_Channel] = []
        for i, nu, y in measured:
            keep = np.isfinite(y)
            complete = bool(keep.all())
            if complete and nu in whole:
                self._channels.append(replace(whole[nu], coordinate=i, y=y[keep]))
                continue
            design = designs[nu] if complete else designs[nu][keep]
            gram = banded_gram(design, grid.degree)
            self._channels.append(_Channel(i, design, design.T.tocsr(), gram, y[keep]))
            if complete:
                whole[nu] = self._channels[-1]
        self.counts = np.array([c.y.size for c in self._channels])
        self.coordinates = np.array([c.coordinate for c in self._channels])
        spread = [*np.nanstd(stacked, axis=0), *(np.nanstd(y) for _, nu, y in measured if nu)]
        self.floors = _RELATIVE_FLOOR * np.array(spread)
        self.noise_floor = self.floors[: self.n_dof]

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]:
        """y − N P for each channel, valid samples only."""
        return [
            c.y - c.design @ np.ascontiguousarray(control_points[:, c.coordinate]) for c in self._channels
        ]

    def gradient(self, control_points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """−Nᵀ(y − N P), (n_ctrl, n_channels), and Σ (y − N P)² of each channel."""
        residuals = self.residuals(control_points)
        gradient = [-(c.transposed @ r) for c, r in zip(self._channels, residuals, strict=True)]
        return np.stack(gradient, axis=1), np.array([r @ r for r in residuals])

    def gram(self, channel: int) -> np.ndarray:
        """NᵀN of a channel in lower banded storage, (degree + 1, n_ctrl)."""
        return self._channels[channel].gram

    def add_band(self, banded: np.ndarray, noise_std: np.ndarray) -> None:
        """Add NᵀN / σ² of every channel to lower banded storage."""
        for c, sigma in zip(self._channels, noise_std, strict=True):
            banded[:: self.n_dof, c.coordinate :: self.n_dof] += c.gram / sigma**2


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
class Linearisation:
    """The problem linearised at one point, free of the weights: equation by equation.

    J_i is the Jacobian of equation i in the control points and e_i its columns; ``border`` columns may be
    the free ones or any other candidates.

    Attributes
    ----------
    bands : (n_dof, bandwidth + 1, n_ctrl · n_dof) array
        ∫ J_iᵀJ_i dt in lower banded storage.
    borders : (n_dof, n_ctrl · n_dof, n_border) array
        ∫ J_iᵀe_i dt.
    corners : (n_dof, n_border, n_border) array
        ∫ e_iᵀe_i dt.
    curve_gradients, coefficient_gradients : (n_dof, …) arrays
        ∫ J_iᵀr_i dt and ∫ e_iᵀr_i dt.
    data_gradient : (n_ctrl, n_channels) array
        −Nᵀ(y − N P).
    channels : (n_channels,) int array
        The coordinate of each channel.
    squares, equation : (n_channels,) and (n_dof,) arrays
        Σ (y − N P)² of each channel and ∫ r_i² dt of each equation.
    volume : (n_dof, n_border) array
        Mean over time of (∂M/∂λ_k M⁻¹)_ii.
    volume_corner : (n_border, n_border) array
        Mean over time of tr(∂M/∂λ_k M⁻¹ ∂M/∂λ_l M⁻¹).
    terms : (n_dof,) array
        ∫ Σ_k (λ_k e_ik)² dt of each equation, computed only where a coordinate is prescribed.
    prescribed : tuple of int
        Coordinates without an equation of motion.
    log_volume, regular : float
        Mean of log |det M|, and share of the motion along which M is positive definite.
    """

    bands: np.ndarray
    borders: np.ndarray
    corners: np.ndarray
    curve_gradients: np.ndarray
    coefficient_gradients: np.ndarray
    data_gradient: np.ndarray
    channels: np.ndarray
    squares: np.ndarray
    equation: np.ndarray
    volume: np.ndarray
    volume_corner: np.ndarray
    terms: np.ndarray
    prescribed: tuple[int, ...] = ()
    log_volume: float = 0.0
    regular: float = 0.0

    def misfit(self, weights: Weights) -> float:
        """Data and equation parts of the cost."""
        return float(np.sum(self.squares / weights.noise_std**2) + np.sum(weights.physics * self.equation))

    def cost(self, weights: Weights) -> float:
        """Misfit and volume term −2 Σ_i volume_i ⟨log |det M|⟩ / (number of equations)."""
        return self.misfit(weights) - 2.0 * self.mean(weights.volume) * self.log_volume

    def mean(self, values: np.ndarray) -> float:
        """Mean over the equations of motion of what is zero where a coordinate has none."""
        return float(values.sum()) / (self.equation.size - len(self.prescribed))

    def gradients(self, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
        """Half gradients of the cost in the control points and in the border's coefficients."""
        curve = np.tensordot(weights.physics, self.curve_gradients, 1)
        scaled, n = self.data_gradient / weights.noise_std**2, self.equation.size
        for i, more in zip(self.channels[n:], scaled.T[n:], strict=True):
            scaled[:, i] += more
        curve += scaled[:, :n].ravel()
        return curve, weights.physics @ self.coefficient_gradients - weights.volume @ self.volume


def linearise(
    observations: Observations,
    physics: Physics,
    control_points: np.ndarray,
    coefficients: np.ndarray,
    border: EulerLagrange | None = None,
) -> Linearisation:
    """Linearise the joint problem at (P, λ).

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
    columns = physics.columns.subset(np.flatnonzero(physics.free).tolist()) if border is None else border
    k = len(columns)
    gradient, squares = observations.gradient(control_points)
    rows = np.zeros((n, size, 1 + k))  # ∫ J_iᵀ[r_i, e_i] dt
    out = Linearisation(
        bands=np.zeros((n, n_local, size)),
        borders=rows[:, :, 1:],
        corners=np.zeros((n, k, k)),
        curve_gradients=rows[:, :, 0],
        coefficient_gradients=np.zeros((n, k)),
        data_gradient=gradient,
        channels=observations.coordinates,
        squares=squares,
        equation=np.zeros(n),
        volume=np.zeros((n, k)),
        volume_corner=np.zeros((k, k)),
        terms=np.zeros(n),
        prescribed=columns.prescribed,
    )
    for chunk in grid.chunks(_CHUNK):
        states = grid.at_quadrature(control_points, chunk)
        _add_physics(out, rows, grid, physics, states, coefficients, border, chunk)
        _add_volume(out, grid, physics.columns, states, coefficients, columns)
    return out


def _add_physics(out, rows, grid, physics, states, coefficients, border, chunk) -> None:
    m, n_quad, n = states[0].shape
    # all arrays below run over quadrature point, then interval: long inner loops
    points = Points(*(s.transpose(1, 0, 2).reshape(-1, n) for s in states), intervals=chunk)
    weight = grid.weights[chunk].T.ravel()
    strong = physics.columns.strong(points)  # (n_columns, n_dof, n_points)
    residual = np.tensordot(coefficients, strong, 1)
    if physics.forces is not None:
        residual -= physics.forces[chunk].transpose(2, 1, 0).reshape(n, -1)
    jacobian = physics.columns.jacobian(points, coefficients)
    if physics.columns.prescribed:
        out.terms += np.einsum("kip,p->i", (coefficients[:, None, None] * strong) ** 2, weight)
    for i in physics.columns.prescribed:
        residual[i], jacobian[2, i, i] = points.columns[2 * n + i], 1.0
    columns = strong[physics.free] if border is None else border.strong(points)
    root = np.sqrt(weight)
    local = _local_jacobian(grid, jacobian, root, chunk, n)
    for i in range(n):
        r = root * residual[i]
        e = root * columns[:, i]
        grid.add_gram(out.bands[i], local[i], chunk, n)
        values = np.concatenate([r[None], e]).reshape(-1, n_quad, m)
        grid.add_products(rows[i], local[i], values, chunk, n)
        out.corners[i] += e @ e.T
        out.coefficient_gradients[i] += e @ r
        out.equation[i] += float(r @ r)


def _add_volume(out, grid, columns, states, coefficients, border) -> None:
    """The volume term −2 Σ_i volume_i ⟨log |det M|⟩ of the cost: its value and derivatives in λ.

    The equation error r is what is random, not the curve: the density of the curve carries the factor
    |∂r/∂q̈| = |det M| for every degree of freedom of the equation error.  Without it the cost rewards
    small coefficients, and large equation errors shrink all of them (errors-in-variables bias).
    """
    stride = max(1, states[0].shape[0] // _VOLUME_POINTS)  # a mean over time needs no more
    points = Points(*(s[::stride, 0] for s in states))
    share = states[0].shape[0] / points.n_points / grid.n_intervals
    mass = columns.mass_matrix(points, coefficients)
    usable = positive_definite(mass)
    out.regular += share * np.count_nonzero(usable)
    if not usable.any():
        return
    out.log_volume += share * float(np.linalg.slogdet(mass[usable])[1].sum())
    if not len(border):
        return
    inverse = np.linalg.inv(mass[usable])
    parts = np.stack([border.mass_of(k, points)[usable] @ inverse for k in range(len(border))])
    out.volume += share * np.einsum("kpii->ik", parts)
    flat = parts.reshape(len(border), -1)
    turned = parts.transpose(0, 1, 3, 2).reshape(len(border), -1)
    out.volume_corner += share * (flat @ turned.T)


def positive_definite(matrices: np.ndarray) -> np.ndarray:
    """Which of many small symmetric matrices are positive definite: all leading minors are positive."""
    out = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    safe = np.where(out[:, None, None], matrices, 0.0)
    for k in range(1, matrices.shape[1] + 1):
        out &= np.linalg.det(safe[:, :k, :k]) > 0.0
    return out


def _local_jacobian(grid: SplineGrid, jacobian: dict, root: np.ndarray, chunk: slice, n: int) -> np.ndarray:
    """∂(scaled residual)/∂(local control points): (n_dof, (degree + 1) n_dof, n_quadrature, n_intervals)."""
    basis = [np.ascontiguousarray(grid.quadrature_basis(chunk, nu).transpose(2, 1, 0)) for nu in range(3)]
    n_basis, n_quad, m = basis[0].shape
    local = np.zeros((n, n_basis, n, n_quad, m))
    for (nu, i, j), value in jacobian.items():
        local[i, :, j] += (root * value).reshape(n_quad, m) * basis[nu]
    return local.reshape(n, n_basis * n, n_quad, m)
