"""Measurements, candidates and the current spline grid, and fits of single structures on them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from leastaction.curve.bspline import uniform_grid
from leastaction.data.trajectories import Trajectories
from leastaction.estimation.forces import forces_on
from leastaction.estimation.gauss_newton import JointFit, Quadratic, score_candidates
from leastaction.estimation.joint import Observations, Physics, positive_definite
from leastaction.estimation.weights import Start, evidence, fit_curve, fit_weights, start_weights
from leastaction.library import Term
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

__all__ = ["StructureFit", "Workspace", "greville_sites"]


@dataclass(frozen=True, eq=False)
class StructureFit:
    """A support with its joint fit.

    Attributes
    ----------
    members : tuple of int
        Numbers of the free columns that are in the structure.
    coefficients : (n_columns,) array
        Of all columns: known ones in place, zero for those not in the structure.
    fit : JointFit
        ``fit.covariance`` follows ``members``.
    evidence : float
    """

    members: tuple[int, ...]
    coefficients: np.ndarray
    fit: JointFit
    evidence: float

    @property
    def standard_errors(self) -> np.ndarray:
        """(n_members,)"""
        return np.sqrt(np.clip(np.diag(self.fit.covariance), 0.0, None))

    @property
    def start(self) -> Start:
        """Where a fit of another structure may begin."""
        return Start(self.fit.control_points, self.coefficients, self.fit.weights)

    @property
    def estimates(self) -> np.ndarray:
        """(n_members,) coefficients of the members."""
        return self.coefficients[list(self.members)]


class Workspace:
    """What all fits of one discovery share.

    Parameters
    ----------
    trajectories : Trajectories
    columns : EulerLagrange
        All candidates.
    known : (n_columns,) array
        Known coefficients, NaN where free.
    knots_per_second : float
    degree : int
    """

    def __init__(
        self,
        trajectories: Trajectories,
        columns: EulerLagrange,
        known: np.ndarray,
        knots_per_second: float,
        degree: int = 5,
    ) -> None:
        self.trajectories = trajectories
        self.columns = columns
        self.known = known
        self.degree = degree
        # with a prescribed coordinate there are more curves than equations; compared at two points an
        # interval they would lock: a spline that meets both must be smoother than the motion
        self.n_quadrature = 1 if columns.prescribed else 2
        self.times = [trajectory.t for trajectory in trajectories]
        self.values = [trajectory.q for trajectory in trajectories]
        self.rates = trajectories.rates
        self.set_knots(knots_per_second)

    @property
    def free(self) -> np.ndarray:
        """Numbers of the columns that are not known."""
        return np.flatnonzero(np.isnan(self.known))

    def named(self, coefficients: np.ndarray) -> dict[str, float]:
        """Coefficients of all columns by the texts of their terms; zeros are left out."""
        texts = [term.text for term in self.columns.terms]
        return {k: v for k, v in zip(texts, coefficients.tolist(), strict=True) if v != 0.0}

    def changed(self, known: np.ndarray) -> Workspace:
        """The same data on the same grid with other known coefficients."""
        other = copy.copy(self)
        other.known = known
        return other

    def wider(self, terms: Sequence[Term]) -> Workspace:
        """The same data on the same grid with further candidates, behind the others."""
        other = self.changed(np.append(self.known, np.full(len(terms), np.nan)))
        other.columns = self.columns.of([*self.columns.terms, *terms])
        return other

    def set_knots(self, knots_per_second: float) -> None:
        """Lay a new spline grid."""
        self.knots_per_second = knots_per_second
        self.grid = uniform_grid(self.times, knots_per_second, self.degree, self.n_quadrature)
        self.observations = Observations(self.grid, self.times, self.values, self.rates)
        self.set_forces([trajectory.forces for trajectory in self.trajectories])

    def set_forces(self, samples: Sequence[np.ndarray | None]) -> None:
        """Lay known forces on the grid: (n_times, n_dof) for each trajectory, None where nothing acts."""
        on_grid = forces_on(self.grid, self.times, samples) if self.trajectories.driven else None
        self.forces = None if on_grid is None else on_grid.values
        self.force_rates = None if on_grid is None else on_grid.rates
        self.force_density = np.zeros(self.observations.n_dof) if on_grid is None else on_grid.density

    def force_at(self, trajectory: int, times: np.ndarray) -> np.ndarray:
        """(n_times, n_dof) known forces on one trajectory, between their samples; zero where none act."""
        given = self.trajectories[trajectory]
        if given.forces is None:
            return np.zeros((*times.shape, given.n_dof))
        return CubicSpline(given.t, given.forces)(times)

    def refine_knots(self, factor: float, fit: StructureFit, growth: np.ndarray) -> Start:
        """Lay a finer grid and carry a fit over to it, equation weights raised by ``growth``, (n_dof,)."""
        old, control_points = self.grid, fit.fit.control_points
        before = self.knots_per_second
        self.set_knots(before * factor)
        moved = np.empty((self.grid.n_ctrl, control_points.shape[1]))
        for k, (space, part) in enumerate(zip(self.grid.spaces, old.split(control_points), strict=True)):
            sites = greville_sites(space.knots, self.degree)
            values = old.spaces[k].evaluate(part, sites)
            matrix = space.basis(sites).tocsc()
            moved[self.grid.offsets[k] : self.grid.offsets[k + 1]] = _banded_solve(
                matrix, values, self.degree
            )
        weights = replace(fit.fit.weights, physics=growth * fit.fit.weights.physics)
        return Start(moved, fit.coefficients, weights)

    def physics(self, members: tuple[int, ...]) -> tuple[Physics, list[int]]:
        """The equations of a structure, and the columns that they hold: free members, then known ones."""
        index = [*members, *(int(k) for k in np.flatnonzero(~np.isnan(self.known)))]
        is_free = np.arange(len(index)) < len(members)
        return Physics(self.columns.subset(index), is_free, self.forces), index

    def start(self, members: tuple[int, ...], control_points, coefficients: np.ndarray, noise_std) -> Start:
        """Starting weights for a structure at given curve and coefficients of all columns."""
        physics, index = self.physics(members)
        weights = start_weights(self.observations, physics, noise_std, control_points, coefficients[index])
        return Start(control_points, coefficients, weights)

    def _begin(self, start: Start, index: list[int]) -> Start:
        """A start for some of the columns; the noise of the forces is that on the present grid."""
        weights = replace(start.weights, force_density=self.force_density)
        return Start(start.control_points, start.coefficients[index], weights)

    def fit_curve(self, members: tuple[int, ...], start: Start) -> tuple[Start, float]:
        """Fit the curve with the coefficients held; see :func:`leastaction.estimation.weights.fit_curve`."""
        physics, index = self.physics(members)
        begin = self._begin(start, index)
        moved, value = fit_curve(self.observations, physics, begin)
        return Start(moved.control_points, start.coefficients, moved.weights), value

    def fit(self, members: tuple[int, ...], start: Start, max_rounds: int = 25) -> StructureFit:
        """Fit a structure; ``start.coefficients`` covers all columns."""
        physics, index = self.physics(members)
        begin = self._begin(start, index)
        fit = fit_weights(self.observations, physics, begin, max_rounds=max_rounds)
        coefficients = np.zeros(len(self.columns))
        coefficients[index] = fit.coefficients
        return StructureFit(members, coefficients, fit, evidence(self.observations, fit))

    def regular(self, coefficients: np.ndarray, control_points: np.ndarray) -> float:
        """Share of the motion along which the mass matrix of all columns is positive definite."""
        states = self.grid.at_quadrature(control_points)
        stride = max(1, self.grid.n_intervals // 200)
        points = Points(*(s[::stride, 0] for s in states))
        return float(np.mean(positive_definite(self.columns.mass_matrix(points, coefficients))))

    def equation_error(self, structure: StructureFit) -> tuple[np.ndarray, np.ndarray]:
        """Root mean square of the equation residual, relative to the terms of each equation, and absolute.

        Where a coordinate has no equation: zero, and NaN.
        """
        physics, index = self.physics(structure.members)
        states = self.grid.at_quadrature(structure.fit.control_points)
        points = Points(*(s[:, 0] for s in states))
        coefficients = structure.coefficients[index]
        size = ((physics.columns.strong(points) * coefficients[:, None, None]) ** 2).sum(axis=0)
        # a conserved momentum is one candidate whose parts cancel: M q̈ shows their size
        mass = physics.columns.mass_matrix(points, coefficients)
        size += np.einsum("pij,pj->ip", mass**2, states[2][:, 0] ** 2)
        if self.forces is not None:
            size += self.forces[:, 0].T ** 2
        rms = np.sqrt(structure.fit.linearisation.equation / self.grid.weights.sum())
        share = rms / np.sqrt(np.maximum(size.mean(axis=1), 1e-300))
        none = list(physics.columns.prescribed)
        share[none], rms[none] = 0.0, np.nan
        return share, rms

    def score(self, structure: StructureFit) -> Quadratic:
        """Quadratic model of the cost in all free columns about a structure's fit."""
        physics, _ = self.physics(structure.members)
        candidates = self.columns.subset([int(k) for k in self.free])
        return score_candidates(self.observations, physics, structure.fit, candidates)


def greville_sites(knots: np.ndarray, degree: int) -> np.ndarray:
    """Averages of ``degree`` successive knots: interpolation there is well conditioned."""
    sums = np.concatenate([[0.0], np.cumsum(knots)])
    sites = (sums[degree + 1 : -1] - sums[1 : -degree - 1]) / degree
    return np.clip(sites, knots[0], knots[-1])


def _banded_solve(matrix, values: np.ndarray, degree: int) -> np.ndarray:
    from scipy.sparse.linalg import splu

    return splu(matrix).solve(values)
