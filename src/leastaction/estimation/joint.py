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

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp

from leastaction.curve.bspline import SplineGrid
from leastaction.curve.smoothing import banded_gram
from leastaction.data.trajectories import Rate
from leastaction.estimation.banded import BandedFactor, trace_product
from leastaction.estimation.elimination import NormalEquations
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

__all__ = [
    "Costs",
    "Equations",
    "Linearisation",
    "NormalEquations",
    "Observations",
    "Physics",
    "Volume",
    "Weights",
    "by_interval",
    "linearise",
    "noise_floors",
    "points_at",
    "positive_definite",
    "volume_term",
]

Scored = TypeVar("Scored")

_RELATIVE_FLOOR = 1e-6
_VOLUME_POINTS = 512
_CHUNK = 4096  # knot intervals handled at once: bounds memory, large enough for numpy
_TRANSPOSED = 128
# numbers in J and [r, e] of a grid that are kept, 64 MB; where there are more they are computed again, which
# takes 10 to 20 % more time, and every fit that is held takes as much less memory
_KEPT = 2**23
_PIECE = 2**17  # numbers in the local Gram matrices of one piece: 1 MB


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
        floors: np.ndarray | None = None,
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
            self._channels.append(_Channel(i, design, gram, y[keep]))
            if complete:
                whole[nu] = self._channels[-1]
        self.counts = np.array([c.y.size for c in self._channels])
        self.coordinates = np.array([c.coordinate for c in self._channels])
        self.floors = noise_floors(values, rates) if floors is None else floors
        self.noise_floor = self.floors[: self.n_dof]

    def linearise(
        self, physics: Physics, control_points: np.ndarray, coefficients: np.ndarray
    ) -> Linearisation:
        """The joint problem linearised; see :func:`linearise`."""
        return linearise(self, physics, control_points, coefficients)

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]:
        """y − N P for each channel, valid samples only."""
        return [
            c.y - c.design @ np.ascontiguousarray(control_points[:, c.coordinate]) for c in self._channels
        ]

    def gradient(self, control_points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """−Nᵀ(y − N P), (n_ctrl, n_channels), and Σ (y − N P)² of each channel."""
        residuals = self.residuals(control_points)
        gradient = [-(c.design.T @ r) for c, r in zip(self._channels, residuals, strict=True)]
        return np.stack(gradient, axis=1), np.array([r @ r for r in residuals])

    def gram(self, channel: int) -> np.ndarray:
        """NᵀN of a channel in lower banded storage, (degree + 1, n_ctrl)."""
        return self._channels[channel].gram

    def add_gram(self, rows: np.ndarray, noise_std: np.ndarray) -> None:
        """Add NᵀN / σ² of every channel to (n_ctrl, n_dof, …) block rows."""
        for c, sigma in zip(self._channels, noise_std, strict=True):
            rows[:, c.coordinate, c.coordinate :: self.n_dof] += c.gram.T / sigma**2


def noise_floors(values: Sequence[np.ndarray], rates: Sequence[Rate] = ()) -> np.ndarray:
    """(n_channels,) a millionth of the spread of each channel."""
    spread = [*np.nanstd(np.concatenate(values), axis=0)]
    spread += [np.nanstd(np.concatenate(rate.values)) for rate in rates]
    return _RELATIVE_FLOOR * np.array(spread)


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


@dataclass(frozen=True, eq=False)
class Equations:
    """The equations of motion at the quadrature points of a run of knot intervals, times √(their weight).

    Attributes
    ----------
    chunk : slice
        The knot intervals.
    jacobian : (n_intervals, n_dof, n_quadrature, n_local) array
        J_i in the control points that matter in each interval, coordinate fastest.
    right : (n_intervals, n_dof, n_quadrature, 1 + n_border) array
        r_i, then e_i.
    terms : (n_dof,) array
        ∫ Σ_k (λ_k e_ik)² dt of each equation, computed only where a coordinate is prescribed.
    """

    chunk: slice
    jacobian: np.ndarray
    right: np.ndarray
    terms: np.ndarray


@dataclass(frozen=True, eq=False)
class Volume:
    """The volume term at one point; see :func:`volume_term`.

    Attributes
    ----------
    log_mean, regular : float
        Mean of log |det M|, and share of the motion along which M is positive definite.
    slope : (n_dof, n_border) array
        Mean over time of (∂M/∂λ_k M⁻¹)_ii.
    corner : (n_border, n_border) array
        Mean over time of tr(∂M/∂λ_k M⁻¹ ∂M/∂λ_l M⁻¹).
    """

    log_mean: float
    regular: float
    slope: np.ndarray
    corner: np.ndarray


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
        """Misfit and volume term −2 Σ_i volume_i ⟨log |det M|⟩ / (number of equations)."""
        return self.misfit(weights) - 2.0 * self.mean(weights.volume) * self.log_volume

    def mean(self, values: np.ndarray) -> float:
        """Mean over the equations of motion of what is zero where a coordinate has none."""
        return float(values.sum()) / (self.equation.size - len(self.prescribed))


@dataclass(frozen=True, eq=False)
class Linearisation(Costs):
    """The problem linearised at one point, free of the weights.

    J_i is the Jacobian of equation i in the control points and e_i its free columns.  They are kept point by
    point, which takes less memory than ∫ J_iᵀJ_i dt of every equation; products are formed on demand.
    Along long motions not even that: they are computed anew.

    Attributes
    ----------
    observations : Observations
    parts : iterable of Equations
        Kept, or computed anew whenever they are asked for where they would take much memory.
    data_gradient : (n_ctrl, n_channels) array
        −Nᵀ(y − N P).
    squares, equation, terms, at_mass, prescribed
        See `Costs`.
    """

    observations: Observations
    parts: Iterable[Equations]
    data_gradient: np.ndarray
    squares: np.ndarray
    equation: np.ndarray
    terms: np.ndarray
    at_mass: Volume
    prescribed: tuple[int, ...] = ()

    def gradients(self, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
        """Half gradients of the cost in the control points and in the border's coefficients."""
        normal = self.normal(weights)
        return normal.border[:, 0], normal.gradient

    def normal(self, weights: Weights) -> NormalEquations:
        """The Gauss–Newton system."""
        grid, n = self.observations.grid, self.observations.n_dof
        k = 1 + self.at_mass.slope.shape[1]
        rows = np.zeros((grid.n_ctrl, n, (grid.degree + 1) * n))
        border = np.zeros((grid.n_ctrl, n, k))
        moments = np.zeros((k, k))
        for chunk, jacobian, right in self._pieces():
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
        return NormalEquations(
            rows,
            border.reshape(-1, k),
            moments[1:, 0] - weights.volume @ self.at_mass.slope,
            moments[1:, 1:] + self.mean(weights.volume) * self.at_mass.corner,
        )

    def data_part(self, weights: Weights) -> np.ndarray:
        """(n_ctrl, n_dof) half gradient of the data's part of the cost in the control points."""
        n = self.equation.size
        scaled = self.data_gradient / weights.noise_std**2
        out = scaled[:, :n].copy()
        for i, more in zip(self.observations.coordinates[n:], scaled.T[n:], strict=True):
            out[:, i] += more
        return out

    def traces(self, weights: Weights, inverse_rows: np.ndarray) -> np.ndarray:
        """(n_dof,) w_i tr(H⁻¹ ∫ J_iᵀJ_i dt), from the block rows of H⁻¹."""
        grid, n = self.observations.grid, self.observations.n_dof
        out = np.zeros(n)
        for chunk, jacobian, _ in self._pieces():
            flat = jacobian.reshape(len(jacobian), -1, jacobian.shape[3])
            local = grid.local_gram(inverse_rows, chunk)
            for a in range(0, local.shape[1], n):  # each pair of different control points counts twice
                local[:, a : a + n, a + n :] *= 2.0
            out += np.einsum("miql,miql->i", (flat @ local).reshape(jacobian.shape), jacobian)
        return weights.physics * out

    def freedom(self, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
        """γ_i = ∂ log|H| / ∂ log w_i of each equation, η_c = ∂ log|H| / ∂ log σ_c⁻² of each channel.

        Raises
        ------
        numpy.linalg.LinAlgError
            When H is not positive definite.
        """
        inverse = BandedFactor.of(self.normal(weights).rows).inverse_rows()
        seen = self.observations
        used = [
            trace_product(inverse, i, seen.gram(c)) / weights.noise_std[c] ** 2
            for c, i in enumerate(seen.coordinates)
        ]
        return self.traces(weights, inverse), np.array(used)

    def scored(self, score: Callable[..., Scored], *given: Any) -> Scored:
        """Apply a function of the linearisation; where it is in blocks, to each of them, and add up."""
        return score(self, *given)

    def _pieces(self) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Knot intervals, J and [r, e] in pieces whose products stay in the processor's cache."""
        for part in self.parts:
            m, size = part.jacobian.shape[0], part.jacobian.shape[3]
            length = max(16, min(_PIECE // size**2, m))
            for a in range(0, m, length):
                b = min(a + length, m)
                chunk = slice(part.chunk.start + a, part.chunk.start + b)
                yield chunk, part.jacobian[a:b], part.right[a:b]


def linearise(
    observations: Observations, physics: Physics, control_points: np.ndarray, coefficients: np.ndarray
) -> Linearisation:
    """Linearise the joint problem at (P, λ).

    Parameters
    ----------
    control_points : (n_ctrl, n_dof) array
    coefficients : (n_columns,) array
        Known ones included.
    """
    grid, n = observations.grid, observations.n_dof
    gradient, squares = observations.gradient(control_points)
    equations = _Along(observations, physics, control_points, coefficients)
    kept = grid.total * equations.numbers <= _KEPT
    parts = tuple(equations) if kept else equations
    terms, equation = np.zeros(n), np.zeros(n)
    for part in parts if kept else equations.residuals():
        equation += np.einsum("miq,miq->i", part.right[..., 0], part.right[..., 0])
        terms += part.terms
    free = physics.columns.subset(np.flatnonzero(physics.free).tolist())
    return Linearisation(
        observations,
        parts,
        gradient,
        squares,
        equation,
        terms,
        volume_term(grid, physics.columns, control_points, coefficients, free),
        physics.columns.prescribed,
    )


@dataclass(frozen=True, eq=False)
class _Along:
    """The equations of motion along a curve, run by run: computed whenever they are iterated over."""

    observations: Observations
    physics: Physics
    control_points: np.ndarray
    coefficients: np.ndarray

    @property
    def numbers(self) -> int:
        """Of J and [r, e], in each knot interval."""
        grid, n = self.observations.grid, self.observations.n_dof
        return n * grid.points.shape[1] * ((grid.degree + 1) * n + 1 + self.physics.n_free)

    def __iter__(self) -> Iterator[Equations]:
        return self._runs(whole=True)

    def residuals(self) -> Iterator[Equations]:
        """The same without J and e."""
        return self._runs(whole=False)

    def _runs(self, whole: bool) -> Iterator[Equations]:
        grid = self.observations.grid
        for chunk in grid.chunks(_CHUNK):
            points = points_at(grid, self.control_points, chunk)
            yield _equations(self.observations, self.physics, points, self.coefficients, whole)


def points_at(grid: SplineGrid, control_points: np.ndarray, chunk: slice) -> Points:
    """States at the quadrature points of a run of knot intervals: quadrature point, then interval."""
    states = grid.at_quadrature(control_points, chunk)
    n = control_points.shape[1]
    return Points(*(s.transpose(1, 0, 2).reshape(-1, n) for s in states), intervals=chunk)


def by_interval(values: np.ndarray, out: np.ndarray) -> None:
    """Copy (n_columns, n_dof, n_points) values to (n_intervals, n_dof, n_quadrature, n_columns)."""
    n_columns, n, _ = values.shape
    m, n_quad = out.shape[0], out.shape[2]
    values = values.reshape(n_columns, n, n_quad, m)
    for a in range(0, m, _TRANSPOSED):  # in pieces that fit the processor's cache: five times faster
        out[a : a + _TRANSPOSED] = values[..., a : a + _TRANSPOSED].transpose(3, 1, 2, 0)


def _equations(
    observations: Observations, physics: Physics, points: Points, coefficients: np.ndarray, whole: bool
) -> Equations:
    """One run of knot intervals; J and e are left empty unless the ``whole`` is asked for."""
    grid, n, chunk = observations.grid, observations.n_dof, points.intervals
    assert chunk is not None
    n_quad, prescribed = grid.weights.shape[1], physics.columns.prescribed
    root = np.sqrt(grid.weights[chunk])
    strong = physics.columns.strong(points)  # (n_columns, n_dof, n_points)
    residual = np.tensordot(coefficients, strong, 1)
    if physics.forces is not None:
        residual -= physics.forces[chunk].transpose(2, 1, 0).reshape(n, -1)
    terms = np.zeros(n)
    if prescribed:
        weight = grid.weights[chunk].T.ravel()
        terms = np.einsum("kip,p->i", (coefficients[:, None, None] * strong) ** 2, weight)
    for i in prescribed:
        residual[i] = points.columns[2 * n + i]
    right = np.empty((len(root), n, n_quad, 1 + (physics.n_free if whole else 0)))
    by_interval(residual[None], right[..., :1])
    if not whole:
        right *= root[:, None, :, None]
        return Equations(chunk, np.empty((len(root), n, n_quad, 0)), right, terms)
    by_interval(strong if physics.free.all() else strong[physics.free], right[..., 1:])
    right *= root[:, None, :, None]
    jacobian = physics.columns.jacobian(points, coefficients)
    for i in prescribed:
        jacobian[2, i, i] = 1.0
    return Equations(chunk, _local_jacobian(grid, jacobian, root.T.ravel(), chunk, n), right, terms)


def volume_term(
    grid: SplineGrid,
    columns: EulerLagrange,
    control_points: np.ndarray,
    coefficients: np.ndarray,
    border: EulerLagrange,
) -> Volume:
    """The volume term −2 Σ_i volume_i ⟨log |det M|⟩ of the cost: its value and derivatives in λ.

    The equation error r is what is random, not the curve: the density of the curve carries the factor
    |∂r/∂q̈| = |det M| for every degree of freedom of the equation error.  Without it the cost rewards
    small coefficients, and large equation errors shrink all of them (errors-in-variables bias).
    """
    k, n = len(border), control_points.shape[1]
    log_mean = regular = 0.0
    slope, corner = np.zeros((n, k)), np.zeros((k, k))
    for sample, share in _volume_samples(grid):
        q, qdot, _ = (s[:, 0] for s in grid.at_quadrature(control_points, sample))
        points = Points(q, qdot)
        mass = columns.mass_matrix(points, coefficients)
        usable = positive_definite(mass)
        regular += share * np.count_nonzero(usable)
        if not usable.any():
            continue
        log_mean += share * float(np.linalg.slogdet(mass[usable])[1].sum())
        if not k:
            continue
        inverse = np.linalg.inv(mass[usable])
        parts = np.stack([border.mass_of(j, points)[usable] @ inverse for j in range(k)])
        slope += share * np.einsum("kpii->ik", parts)
        turned = parts.transpose(0, 1, 3, 2).reshape(k, -1)
        corner += share * (parts.reshape(k, -1) @ turned.T)
    return Volume(log_mean, regular, slope, corner)


def _volume_samples(grid: SplineGrid) -> Iterator[tuple[slice, float]]:
    """Knot intervals that a mean over time is taken from, run by run, and the share of each.

    Those of a part of a grid are those that the whole grid takes in its range: the sums over parts are the
    sums over the whole.
    """
    begin, end = grid.before, grid.before + grid.n_intervals
    for start in range(begin - begin % _CHUNK, end, _CHUNK):
        stop = min(start + _CHUNK, grid.total)
        stride = max(1, (stop - start) // _VOLUME_POINTS)  # a mean over time needs no more
        share = (stop - start) / len(range(start, stop, stride)) / grid.total
        first = max(start, begin)
        sample = slice(first - begin + -(first - start) % stride, min(stop, end) - begin, stride)
        if sample.start < sample.stop:
            yield sample, share


def positive_definite(matrices: np.ndarray) -> np.ndarray:
    """Which of many small symmetric matrices are positive definite: all leading minors are positive."""
    out = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    safe = np.where(out[:, None, None], matrices, 0.0)
    for k in range(1, matrices.shape[1] + 1):
        out &= np.linalg.det(safe[:, :k, :k]) > 0.0
    return out


def _local_jacobian(grid: SplineGrid, jacobian: dict, root: np.ndarray, chunk: slice, n: int) -> np.ndarray:
    """∂(scaled residual)/∂(local control points): (n_intervals, n_dof, n_quadrature, (degree + 1) n_dof)."""
    basis = [grid.quadrature_basis(chunk, nu) for nu in range(3)]
    m, n_quad, n_basis = basis[0].shape
    local = np.zeros((m, n, n_quad, n_basis, n))
    for (nu, i, j), value in jacobian.items():
        scaled = (root * value).reshape(n_quad, m).T
        local[:, i, :, :, j] += scaled[:, :, None] * basis[nu]
    return local.reshape(m, n, n_quad, n_basis * n)
