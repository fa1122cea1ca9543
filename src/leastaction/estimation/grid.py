"""A problem discretised by splines: the data that all fits on one grid share.

Refining returns a new grid; a grid never changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.sparse.linalg import splu

from leastaction.curve.bspline import SplineGrid, uniform_grid
from leastaction.curve.smoothing import Smooth, smooth
from leastaction.estimation.blocks import observe
from leastaction.estimation.crew import Alone, Task
from leastaction.estimation.fit import Fit
from leastaction.estimation.forces import Between, GridForces, curve_between, forces_on
from leastaction.estimation.gauss_newton import fit_joint, symmetric_inverse
from leastaction.estimation.intervals import first_points
from leastaction.estimation.joint import Physics
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.protocols import Measurements
from leastaction.estimation.sensors import SensorObservations
from leastaction.estimation.streamed import is_long
from leastaction.estimation.volume import positive_definite
from leastaction.estimation.weights import Start, evidence, fit_curve, fit_weights, start_weights

__all__ = ["Grid", "greville_sites"]

_POINTS = 200  # along the motion, at which the mass matrix is tested
_SMOOTHED = 50_000  # times in a run of short trajectories: bounds memory


@dataclass(frozen=True, eq=False)
class Grid:
    """A discretisation of a problem; make one by :meth:`lay`.

    Attributes
    ----------
    problem : Problem
    knots_per_second : float
    spline : SplineGrid
    observations : Measurements
    forces : GridForces or None
        Known forces at the quadrature points; None where nothing acts.
    """

    problem: Problem
    knots_per_second: float
    spline: SplineGrid
    observations: Measurements
    forces: GridForces | None

    @classmethod
    def lay(cls, problem: Problem, knots_per_second: float) -> Grid:
        """Uniform knots on every trajectory of a problem."""
        data = problem.trajectories
        times = [t.t for t in data]
        # With a prescribed coordinate there are more curves than equations. With two quadrature points an
        # interval, the curve would lock: a spline that satisfies both is smoother than the motion.
        n_quadrature = 1 if problem.prescribed else 2
        spline = uniform_grid(times, knots_per_second, problem.degree, n_quadrature)
        observations: Measurements
        if problem.sensors is None:
            observations = observe(spline, times, [t.q for t in data], data.rates, problem.crew)
        else:
            observations = SensorObservations(spline, times, problem.sensors, data.rates)
        forces = _forces(spline, problem, [t.forces for t in data])
        return cls(problem, knots_per_second, spline, observations, forces)

    def posed(self, problem: Problem) -> Grid:
        """The same discretisation for another problem on the same data."""
        return replace(self, problem=problem)

    def pushed(self, forces: Sequence[np.ndarray | None]) -> Grid:
        """The same discretisation with other known forces, (n_times, n_dof) in each trajectory."""
        problem = self.problem.with_forces(forces)
        return replace(self, problem=problem, forces=_forces(self.spline, problem, list(forces)))

    def acting(self, between: Between) -> Grid:
        """The same discretisation with another course of the forces between their samples."""
        problem = replace(self.problem, between=between)
        given = [trajectory.forces for trajectory in problem.trajectories]
        return replace(self, problem=problem, forces=_forces(self.spline, problem, given))

    @property
    def times(self) -> list[np.ndarray]:
        """Sample times of each trajectory."""
        return [trajectory.t for trajectory in self.problem.trajectories]

    @property
    def force_density(self) -> np.ndarray:
        """(n_dof,) spectral density of the scatter of the known forces."""
        return np.zeros(self.observations.n_dof) if self.forces is None else self.forces.density

    def smooth(self, penalty: np.ndarray | None = None) -> Smooth:
        """The curve through the samples on this grid, without a law; ``penalty`` fixes its smoothness."""
        data, crew = self.problem.trajectories, self.problem.crew or Alone()
        values, rates = [t.q for t in data], data.rates
        if penalty is None or not is_long(self.times, data.n_dof):
            return smooth(self.spline, self.times, values, penalty, rates)
        tasks: list[Task] = []
        for part in _runs(self.times):
            own = [replace(rate, values=rate.values[part]) for rate in rates]
            some = SplineGrid(self.spline.spaces[part], self.spline.n_quadrature)
            tasks.append(crew.task(smooth, some, self.times[part], values[part], penalty, own))
        return Smooth.joined(self.spline, crew.results(tasks))

    def force_at(self, trajectory: int, times: np.ndarray) -> np.ndarray:
        """(n_times, n_dof) known forces on one trajectory, between their samples; zero where none act."""
        given = self.problem.trajectories[trajectory]
        if given.forces is None:
            return np.zeros((*times.shape, given.n_dof))
        return curve_between(given.t, given.forces, self.problem.between)(times)

    def physics(self, structure: Structure) -> tuple[Physics, list[int]]:
        """The equations of a structure, and their candidates: members, then known ones."""
        index = [*structure, *(int(k) for k in np.flatnonzero(self.problem.is_known))]
        is_free = np.arange(len(index)) < len(structure)
        values = None if self.forces is None else self.forces.values
        return Physics(self.problem.candidates.subset(index), is_free, values), index

    def start(
        self,
        structure: Structure,
        control_points: np.ndarray,
        coefficients: np.ndarray,
        noise_std: np.ndarray,
    ) -> Start:
        """Starting weights for a structure at given curve and coefficients of all candidates."""
        physics, index = self.physics(structure)
        values = self.problem.completed(coefficients)
        weights = start_weights(self.observations, physics, noise_std, control_points, values[index])
        return Start(control_points, values, weights)

    def _begin(self, start: Start, index: list[int]) -> Start:
        """A start for some of the candidates; known coefficients come from the problem, not from it."""
        weights = replace(start.weights, force_density=self.force_density)
        return Start(start.control_points, self.problem.completed(start.coefficients)[index], weights)

    def fit_curve(self, structure: Structure, start: Start) -> tuple[Start, float]:
        """Fit the curve with the coefficients held; see :func:`leastaction.estimation.weights.fit_curve`."""
        physics, index = self.physics(structure)
        moved, value = fit_curve(self.observations, physics, self._begin(start, index))
        return Start(moved.control_points, start.coefficients, moved.weights), value

    def fit(self, structure: Structure, start: Start, max_rounds: int = 25) -> Fit:
        """Fit a structure; ``start.coefficients`` covers all candidates."""
        physics, index = self.physics(structure)
        begin = self._begin(start, index)
        solution = fit_weights(self.observations, physics, begin, max_rounds=max_rounds)
        coefficients = np.zeros(len(self.problem.candidates))
        coefficients[index] = solution.coefficients
        return Fit.of(self, structure, coefficients, solution, evidence(self.observations, solution))

    def held(self, fit: Fit, coefficients: np.ndarray, covariance: np.ndarray) -> Fit:
        """A fit of the curve with other, fixed coefficients."""
        physics, index = self.physics(fit.structure)
        rigid = Physics(physics.columns, np.zeros_like(physics.free), physics.forces)
        values = self.problem.completed(coefficients)
        solution = fit_joint(
            self.observations, rigid, fit.weights, fit.control_points, values[index], tolerance=1.0
        )
        found = Fit.of(self, fit.structure, values, solution, evidence(self.observations, solution))
        return replace(found, covariance=covariance, joint=_joined(fit, covariance, solution.joint))

    def carried(self, fit: Fit, growth: np.ndarray) -> Start:
        """A fit of another grid as a start on this one, equation weights raised by ``growth``, (n_dof,)."""
        old, degree = fit.grid.spline, self.problem.degree
        moved = np.empty((self.spline.n_ctrl, fit.control_points.shape[1]))
        for k, (space, part) in enumerate(
            zip(self.spline.spaces, old.split(fit.control_points), strict=True)
        ):
            sites = greville_sites(space.knots, degree)
            values = old.spaces[k].evaluate(part, sites)
            own = slice(self.spline.offsets[k], self.spline.offsets[k + 1])
            moved[own] = splu(space.basis(sites).tocsc()).solve(values)
        weights = replace(fit.weights, physics=growth * fit.weights.physics)
        return Start(moved, fit.coefficients, weights)

    def regular(self, coefficients: np.ndarray, control_points: np.ndarray) -> float:
        """Share of the motion along which the mass matrix of all candidates is positive definite."""
        stride = max(1, self.spline.n_intervals // _POINTS)
        points = first_points(self.spline, control_points, slice(None, None, stride))
        mass = self.problem.candidates.mass_matrix(points, coefficients)
        return float(np.mean(positive_definite(mass)))


def _joined(fit: Fit, covariance: np.ndarray, given: np.ndarray | None) -> np.ndarray | None:
    """Covariance of coefficients and calibration numbers, if the coefficients have another ``covariance``.

    ``given`` is the covariance of the numbers at fixed coefficients. How the numbers follow the coefficients
    is the regression of the numbers on them in ``fit``.
    """
    if fit.joint is None or given is None:
        return None
    n = len(covariance)
    if not (np.isfinite(fit.joint).all() and np.isfinite(covariance).all()):
        return np.full(fit.joint.shape, np.nan)
    slopes = fit.joint[n:, :n] @ symmetric_inverse(fit.joint[:n, :n])
    mixed = slopes @ covariance
    return np.block([[covariance, mixed.T], [mixed, given + mixed @ slopes.T]])


def _runs(times: Sequence[np.ndarray]) -> list[slice]:
    """Runs of trajectories that are smoothed together."""
    ends = np.cumsum([t.size for t in times])
    cuts = np.flatnonzero(np.diff(ends // _SMOOTHED)) + 1
    return [slice(int(a), int(b)) for a, b in pairwise([0, *cuts, len(times)])]


def _forces(spline: SplineGrid, problem: Problem, samples: Sequence[np.ndarray | None]) -> GridForces | None:
    data = problem.trajectories
    if not data.driven:
        return None
    times = [t.t for t in data]
    # single precision for long recordings: this array is four times as large as the samples
    dtype = np.float32 if is_long(times, data.n_dof) else np.float64
    return forces_on(spline, times, samples, dtype, problem.between)


def greville_sites(knots: np.ndarray, degree: int) -> np.ndarray:
    """Averages of ``degree`` successive knots: interpolation there is well conditioned."""
    sums = np.concatenate([[0.0], np.cumsum(knots)])
    sites = (sums[degree + 1 : -1] - sums[1 : -degree - 1]) / degree
    return np.clip(sites, knots[0], knots[-1])
