"""The joint least-squares problem in spline and coefficients, and its banded normal equations.

    cost(P, λ) = Σ_c ‖y_c − N_c P_i‖² / σ_c² + Σ_i w_i ∫ r_i² dt,      r = Σ_k λ_k E[φ_k] − f

with one channel c for the positions of each coordinate i, N_c = N, and one for every measured velocity and
acceleration, N_c = Ṅ and N̈, each with its own noise.  A prescribed coordinate has no equation of motion. In
its place, r_i = q̈_i describes a free mass driven by white noise, which makes its curve a smoothing spline
(Wahba 1978, J. R. Stat. Soc. B 40:364).

Unknowns of the curve are numbered control point by control point (coordinate fastest), so that the
Gauss–Newton matrix of P is banded and λ forms a dense border.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from leastaction.estimation.elimination import BandedFactor, NormalEquations
from leastaction.estimation.intervals import by_interval, local_jacobian, points_at
from leastaction.estimation.observations import Observations
from leastaction.estimation.volume import Volume, volume_term
from leastaction.mechanics import Columns, Points
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = [
    "Costs",
    "Equations",
    "Linearisation",
    "NormalEquations",
    "Physics",
    "Weights",
    "linearise",
]

_CHUNK = 4096  # knot intervals handled at once: bounds memory, large enough for numpy
_MOST_KEPT = 16_000_000  # numbers in the equations of the linearisations held at once: 128 MB
_PIECE = 2**17  # numbers in the local Gram matrices of one piece: 1 MB


@dataclass(frozen=True, eq=False)
class Weights:
    """Noise of each channel, equation weight w_i, and degrees of freedom left to the equation error.

    The first n_dof channels are the positions; ``physics`` and ``slack`` have shape (n_dof,). ``slack``
    vanishes when the equations hold exactly, and where a coordinate has none. ``force_density`` is the
    spectral density of the noise of the given forces. ``calibration`` holds the calibration numbers κ of the
    sensors, which a fit moves together with the curve; None where all sensors measure coordinates.
    """

    noise_std: np.ndarray
    physics: np.ndarray
    slack: np.ndarray
    force_density: np.ndarray | float = 0.0
    calibration: np.ndarray | None = None

    @property
    def volume(self) -> np.ndarray:
        """(n_dof,) weight of the log-determinant term: degrees of freedom of unmeasured forces.

        The noise of measured forces is part of the residual, too, but it does not act. See
        `volume.volume_term`.
        """
        return self.slack * (1.0 - np.clip(self.physics * self.force_density, 0.0, 1.0))

    @property
    def position_std(self) -> np.ndarray:
        """(n_dof,) noise of the positions."""
        return self.noise_std[: self.physics.size]


@dataclass(frozen=True, eq=False)
class Physics:
    """The equations of motion: columns, which coefficients are free, forces at the quadrature points.

    Attributes
    ----------
    columns : Columns
    free : (n_columns,) bool array
        Coefficients to estimate; the others are known.
    forces : (n_intervals, n_quadrature, n_dof) array or None
    """

    columns: Columns
    free: np.ndarray
    forces: np.ndarray | None

    @property
    def n_free(self) -> int:
        return int(self.free.sum())

    def within(self, intervals: slice) -> Physics:
        """The equations for a part of the motion, given by its knot intervals."""
        forces = None if self.forces is None else self.forces[intervals]
        return Physics(self.columns.within(intervals), self.free, forces)


@dataclass(frozen=True, eq=False)
class Equations:
    """The equations of motion at the quadrature points of a run of knot intervals, times √(their weight).

    Attributes
    ----------
    chunk : slice
        The knot intervals.
    jacobian : (n_intervals, n_dof, n_quadrature, n_local) array
        J_i in the control points that each interval depends on, coordinate fastest.
    right : (n_intervals, n_dof, n_quadrature, 1 + n_border) array
        r_i, then e_i.
    """

    chunk: slice
    jacobian: np.ndarray
    right: np.ndarray


class Costs:
    """The cost at one point for any weights, from a few sums over data and motion.

    Attributes
    ----------
    squares, equation : (n_channels,) and (n_dof,) arrays
        Σ (y − N P)² of each channel and ∫ r_i² dt of each equation.
    terms : (n_dof,) array
        ∫ Σ_k (λ_k e_ik)² dt of each equation, computed only where a coordinate is prescribed.
    at_mass : Volume
    prescribed : tuple of int
        Coordinates without an equation of motion.
    """

    squares: np.ndarray
    equation: np.ndarray
    terms: np.ndarray
    at_mass: Volume
    prescribed: tuple[int, ...]

    @property
    def log_volume(self) -> float:
        """Mean of log |det M|."""
        return self.at_mass.log_mean

    @property
    def regular(self) -> float:
        """Share of the motion along which M is positive definite."""
        return self.at_mass.regular

    @property
    def volume(self) -> np.ndarray:
        """(n_dof, n_border) mean over time of (∂M/∂λ_k M⁻¹)_ii."""
        return self.at_mass.slope

    def misfit(self, weights: Weights) -> float:
        """Data and equation parts of the cost."""
        return float(np.sum(self.squares / weights.noise_std**2) + np.sum(weights.physics * self.equation))

    def cost(self, weights: Weights) -> float:
        """Misfit and log-determinant term −2 Σ_i volume_i ⟨log |det M|⟩ / (number of equations)."""
        return self.misfit(weights) - 2.0 * self.mean(weights.volume) * self.log_volume

    def mean(self, values: np.ndarray) -> float:
        """Mean over the equations of motion; values of coordinates without one are zero."""
        return float(values.sum()) / (self.equation.size - len(self.prescribed))


@dataclass(frozen=True, eq=False)
class Linearisation(Costs):
    """The problem linearised at one point, for any weights.

    J_i is the Jacobian of equation i in the control points and e_i its free columns.  They are kept point by
    point, which takes less memory than ∫ J_iᵀJ_i dt of every equation; products are formed on demand.

    Attributes
    ----------
    observations, physics, control_points, coefficients
        The point.
    kept : tuple of Equations or None
        None for long recordings, whose equations are evaluated anew each time, run by run.
    data_gradient : (n_ctrl, n_channels) array
        −Nᵀ(y − N P).
    squares, equation : (n_channels,) and (n_dof,) arrays
        Σ (y − N P)² of each channel and ∫ r_i² dt of each equation.
    terms : (n_dof,) array
        ∫ Σ_k (λ_k e_ik)² dt of each equation, computed only where a coordinate is prescribed.
    at_mass : Volume
    prescribed : tuple of int
        Coordinates without an equation of motion.
    """

    observations: Observations
    physics: Physics
    control_points: np.ndarray
    coefficients: np.ndarray
    kept: tuple[Equations, ...] | None
    data_gradient: np.ndarray
    squares: np.ndarray
    equation: np.ndarray
    terms: np.ndarray
    at_mass: Volume
    prescribed: tuple[int, ...] = ()

    def lean(self) -> Linearisation:
        """Itself: nothing was computed ahead."""
        return self

    def gradients(self, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
        """Half gradients of the cost in the control points and in the coefficients of the border."""
        normal = self.normal(weights)
        return normal.border[:, 0], normal.gradient

    def normal(self, weights: Weights) -> NormalEquations:
        """The Gauss–Newton system."""
        grid, n = self.observations.grid, self.observations.n_dof
        k = 1 + self.physics.n_free
        rows = np.zeros((grid.n_ctrl, n, (grid.degree + 1) * n))
        border = np.zeros((grid.n_ctrl, n, k))
        moments = np.zeros((k, k))
        for chunk, jacobian, right in self._small_pieces():
            weighted = (weights.physics[:, None, None] * jacobian).reshape(len(jacobian), -1, rows.shape[2])
            flat = jacobian.reshape(weighted.shape)
            grid.add_gram(rows, flat.transpose(0, 2, 1) @ weighted, chunk)
            values = right.reshape(len(right), -1, k)
            products = weighted.transpose(0, 2, 1) @ values
            grid.add_products(border, products.reshape(len(right), -1, n, k), chunk)
            scaled = (np.sqrt(weights.physics)[:, None, None] * right).reshape(-1, k)
            moments += scaled.T @ scaled
        self.observations.add_gram(rows, weights.noise_std)
        border[:, :, 0] += self.data_part(weights)
        normal = NormalEquations(
            rows,
            border.reshape(-1, k),
            moments[1:, 0] - weights.volume @ self.at_mass.slope,
            moments[1:, 1:] + self.mean(weights.volume) * self.at_mass.corner,
        )
        return self.observations.joined(normal, weights.noise_std)

    def data_part(self, weights: Weights) -> np.ndarray:
        """(n_ctrl, n_dof) half gradient of the data part of the cost in the control points."""
        n = self.equation.size
        scaled = self.data_gradient / weights.noise_std[: self.data_gradient.shape[1]] ** 2
        out = scaled[:, :n].copy()
        for i, more in zip(self.observations.coordinates[n:], scaled.T[n:], strict=True):
            out[:, i] += more
        return out

    def traces(self, weights: Weights, inverse_rows: np.ndarray) -> np.ndarray:
        """(n_dof,) w_i tr(H⁻¹ ∫ J_iᵀJ_i dt), from the block rows of H⁻¹."""
        grid, n = self.observations.grid, self.observations.n_dof
        out = np.zeros(n)
        for chunk, jacobian, _ in self._small_pieces():
            flat = jacobian.reshape(len(jacobian), -1, jacobian.shape[3])
            local = grid.local_gram(inverse_rows, chunk)
            for a in range(0, local.shape[1], n):  # each pair of different control points counts twice
                local[:, a : a + n, a + n :] *= 2.0
            out += np.einsum("miql,miql->i", (flat @ local).reshape(jacobian.shape), jacobian)
        return weights.physics * out

    def freedom(self, weights: Weights, factor: BandedFactor | None = None) -> tuple[np.ndarray, np.ndarray]:
        """γ_i = ∂ log|H| / ∂ log w_i of each equation, η_c = ∂ log|H| / ∂ log σ_c⁻² of each channel.

        ``factor`` is the factor of H, if it is available.

        Raises
        ------
        numpy.linalg.LinAlgError
            When H is not positive definite.
        """
        inverse = (factor or BandedFactor.of(self.normal(weights).rows)).inverse_rows()
        return self.traces(weights, inverse), self.observations.traces(inverse, weights.noise_std)

    def scored(self, score: Callable[..., Any], weights: Weights, candidates: EulerLagrange) -> Any:
        """Apply a function of the linearisation, or of each of its blocks, and sum the results."""
        return score(self, weights, candidates)

    def parts(self) -> Iterator[Equations]:
        """The equations, run by run of knot intervals."""
        if self.kept is not None:
            yield from self.kept
            return
        for chunk in self.observations.grid.chunks(_CHUNK):
            points = points_at(self.observations.grid, self.control_points, chunk)
            yield _equations(self.observations, self.physics, points, self.coefficients)[0]

    def pieces(self, length: int) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Knot intervals, J and [r, e], at most ``length`` intervals at once."""
        for part in self.parts():
            for a in range(0, len(part.right), length):
                b = min(a + length, len(part.right))
                chunk = slice(part.chunk.start + a, part.chunk.start + b)
                yield chunk, part.jacobian[a:b], part.right[a:b]

    def _small_pieces(self) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Pieces whose products stay in the processor's cache."""
        grid, n = self.observations.grid, self.observations.n_dof
        return self.pieces(max(16, _PIECE // ((grid.degree + 1) * n) ** 2))


def linearise(
    observations: Observations,
    physics: Physics,
    control_points: np.ndarray,
    coefficients: np.ndarray,
    calibration: np.ndarray | None = None,
    *,
    share: float = 1.0,
) -> Linearisation:
    """Linearise the joint problem at (P, λ, κ).

    Parameters
    ----------
    control_points : (n_ctrl, n_dof) array
    coefficients : (n_columns,) array
        Known ones included.
    calibration : (n_numbers,) array, optional
        Calibration numbers of sensors; by default the start values of the observations.
    share : float
        Of the memory for equations, where several linearisations are held at once.
    """
    observations = observations.at(control_points, calibration)
    grid, n = observations.grid, observations.n_dof
    gradient, squares = observations.gradient(control_points)
    numbers = grid.n_intervals * grid.n_quadrature * n * ((grid.degree + 1) * n + 1 + physics.n_free)
    kept: list[Equations] | None = [] if numbers <= share * _MOST_KEPT else None
    equation, terms = np.zeros(n), np.zeros(n)
    for chunk in grid.chunks(_CHUNK):
        points = points_at(grid, control_points, chunk)
        part, of_terms = _equations(observations, physics, points, coefficients, kept is not None)
        equation += np.einsum("miq,miq->i", part.right[..., 0], part.right[..., 0])
        terms += of_terms
        if kept is not None:
            kept.append(part)
    free = physics.columns.subset(np.flatnonzero(physics.free).tolist())
    return Linearisation(
        observations,
        physics,
        control_points,
        coefficients,
        None if kept is None else tuple(kept),
        gradient,
        squares,
        equation,
        terms,
        volume_term(grid, physics.columns, control_points, coefficients, free),
        physics.columns.prescribed,
    )


def _equations(
    observations: Observations,
    physics: Physics,
    points: Points,
    coefficients: np.ndarray,
    differentiate: bool = True,
) -> tuple[Equations, np.ndarray]:
    """One run of knot intervals, with J on demand, and optionally ∫ Σ_k (λ_k e_ik)² dt."""
    grid, n, chunk = observations.grid, observations.n_dof, points.intervals
    assert chunk is not None
    n_quad = grid.weights.shape[1]
    root = np.sqrt(grid.weights[chunk])
    strong = physics.columns.strong(points)  # (n_columns, n_dof, n_points)
    residual = np.tensordot(coefficients, strong, 1)
    if physics.forces is not None:
        residual -= physics.forces[chunk].transpose(2, 1, 0).reshape(n, -1)
    terms = np.zeros(n)
    if physics.columns.prescribed:
        weight = grid.weights[chunk].T.ravel()
        terms = np.einsum("kip,p->i", (coefficients[:, None, None] * strong) ** 2, weight)
    for i in physics.columns.prescribed:
        residual[i] = points.columns[2 * n + i]
    right = np.empty((len(root), n, n_quad, 1 + physics.n_free))
    by_interval(residual[None], right[..., :1])
    by_interval(strong if physics.free.all() else strong[physics.free], right[..., 1:])
    right *= root[:, None, :, None]
    local = np.zeros((0, n, n_quad, (grid.degree + 1) * n))
    if differentiate:
        jacobian = physics.columns.jacobian(points, coefficients)
        jacobian.update({(2, i, i): np.ones(int(points.n_points)) for i in physics.columns.prescribed})
        local = local_jacobian(grid, jacobian, root.T.ravel(), chunk, n)
    return Equations(chunk, local, right), terms
