"""One structure fitted on one grid, and the properties of its motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.estimation.gauss_newton import JointFit, Quadratic, score_candidates
from leastaction.estimation.intervals import first_points
from leastaction.estimation.joint import Weights
from leastaction.estimation.problem import Structure
from leastaction.estimation.protocols import Linearised
from leastaction.estimation.sensors import SensorObservations
from leastaction.estimation.weights import Start
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

if TYPE_CHECKING:
    from leastaction.estimation.grid import Grid
    from leastaction.estimation.problem import Problem

__all__ = ["Fit", "ShapeEstimate"]


@dataclass(frozen=True, eq=False)
class ShapeEstimate:
    """Shape parameters of a fit.

    Attributes
    ----------
    names : tuple of str
    values : (n_shapes,) array
    covariance : (n_members + n_shapes,) * 2 array
        Of the members' coefficients, then of the shape parameters; zero for those held at a bound.
    settled : bool
        Whether the last step was below a hundredth of a standard error.
    profiles : tuple of tuple
        For each parameter, pairs of a value and the increase of −2 log likelihood there; empty if not
        computed.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    settled: bool
    profiles: tuple[tuple[tuple[float, float], ...], ...] = ()

    @property
    def standard_errors(self) -> np.ndarray:
        """(n_shapes,)"""
        n = len(self.names)
        return np.sqrt(np.clip(np.diag(self.covariance)[-n:], 0.0, None))

    def differs(self, other: ShapeEstimate, name: str, errors: float) -> bool:
        """Whether a parameter of both differs by more than so many standard errors."""
        k, m = self.names.index(name), other.names.index(name)
        apart = abs(self.values[k] - other.values[m])
        return bool(apart > errors * np.hypot(self.standard_errors[k], other.standard_errors[m]))


_RUN = 2**16  # knot intervals that are evaluated together


@dataclass(frozen=True, eq=False)
class Fit:
    """A structure on a grid: one vector of coefficients, their covariance, weights, curve, and the outcome.

    Attributes
    ----------
    grid : Grid
        With the problem.
    structure : Structure
    coefficients : (n_candidates,) array
        Of all candidates: known ones included, zero for those not in the structure.
    covariance : (n_members, n_members) array
        Of the members' coefficients.
    control_points : (n_ctrl, n_dof) array
        The curve.
    weights : Weights
    linearisation : Linearised
        At the curve and these coefficients.
    logdet : float
        log |H| of the curve's block.
    status : str
        "converged", "stalled", "step limit" or "not finite".
    n_steps : int
    evidence : float
        Log marginal likelihood, up to a constant that depends on data and grid only.
    shapes : ShapeEstimate or None
        Shape parameters and their errors; None if there are none, or if they were held.
    joint : (n_members + n_numbers,) * 2 array or None
        Covariance of the members' coefficients and of the calibration numbers of sensors, if there are any.
    """

    grid: Grid
    structure: Structure
    coefficients: np.ndarray
    covariance: np.ndarray
    control_points: np.ndarray
    weights: Weights
    linearisation: Linearised
    logdet: float
    status: str
    n_steps: int
    evidence: float
    shapes: ShapeEstimate | None = None
    joint: np.ndarray | None = None

    @classmethod
    def of(
        cls, grid: Grid, structure: Structure, coefficients: np.ndarray, solution: JointFit, evidence: float
    ) -> Fit:
        """The solution of the joint problem for a structure, with the coefficients of all candidates."""
        return cls(
            grid,
            structure,
            coefficients,
            solution.covariance,
            solution.control_points,
            solution.weights,
            solution.linearisation,
            solution.logdet,
            solution.status,
            solution.n_steps,
            evidence,
            joint=solution.joint,
        )

    @property
    def problem(self) -> Problem:
        """The problem that was fitted."""
        return self.grid.problem

    @property
    def converged(self) -> bool:
        """Whether the solver converged."""
        return self.status in ("converged", "stalled")

    @property
    def usable(self) -> bool:
        """Whether the result is finite, converged or not."""
        return self.status != "not finite"

    @property
    def estimates(self) -> np.ndarray:
        """(n_members,) coefficients of the members."""
        return self.coefficients[list(self.structure)]

    @property
    def standard_errors(self) -> np.ndarray:
        """(n_members,)"""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))

    @property
    def z(self) -> np.ndarray:
        """(n_members,) estimates over standard errors."""
        return self.estimates / np.maximum(self.standard_errors, 1e-300)

    @property
    def position_std(self) -> np.ndarray:
        """(n_dof,) noise of the positions; NaN where there are none."""
        counts = self.grid.observations.counts[: self.problem.trajectories.n_dof]
        return np.where(counts > 0, self.weights.position_std, np.nan)

    def residuals(self) -> list[np.ndarray]:
        """Samples minus the curve, channel by channel, valid samples only."""
        seen = self.grid.observations
        if isinstance(seen, SensorObservations):
            seen = seen.at(self.control_points, self.weights.calibration)
        return seen.residuals(self.control_points)

    @property
    def start(self) -> Start:
        """Start values of a fit of another structure."""
        return Start(self.control_points, self.coefficients, self.weights)

    def posed(self, problem: Problem) -> Fit:
        """The same fit for another problem, which may have further candidates after the others."""
        more = len(problem.candidates) - self.coefficients.size
        coefficients = np.append(self.coefficients, np.zeros(more))
        return replace(self, grid=self.grid.posed(problem), coefficients=coefficients)

    def points(self, most: int | None = None) -> Points:
        """States of the fitted curve, one in each knot interval, or about ``most`` of them."""
        stride = 1 if most is None else max(1, self.grid.spline.n_intervals // most)
        return first_points(self.grid.spline, self.control_points, slice(None, None, stride))

    def along(self) -> Iterator[tuple[slice, Points]]:
        """States in each knot interval, in runs of intervals that bound memory."""
        for chunk in self.grid.spline.chunks(_RUN):
            yield chunk, first_points(self.grid.spline, self.control_points, chunk)

    def equations(self, chunk: slice) -> tuple[Points, np.ndarray, np.ndarray]:
        """States in each of some knot intervals, columns of the equations there, and their residual.

        Columns are (n_columns, n_dof, n_points): those of the members, then known ones.
        """
        physics, index = self.grid.physics(self.structure)
        points = first_points(self.grid.spline, self.control_points, chunk)
        columns = physics.columns.strong(points)
        residual = np.tensordot(self.coefficients[index], columns, 1)
        if self.grid.forces is not None:
            residual = residual - self.grid.forces.values[chunk, 0].T
        return points, columns, residual

    def curves(self) -> Iterator[np.ndarray]:
        """(n_times, n_dof) the fitted curve at the samples, trajectory by trajectory."""
        spline = self.grid.spline
        parts = spline.split(self.control_points)
        for space, part, times in zip(spline.spaces, parts, self.grid.times, strict=True):
            yield space.evaluate(part, times)

    def completed_data(self) -> Trajectories:
        """The data, with the fitted curve for hidden coordinates."""
        hidden, data = list(self.problem.hidden), self.problem.trajectories
        if not hidden:
            return data
        items: list[Trajectory] = []
        for trajectory, curve in zip(data, self.curves(), strict=True):
            q = trajectory.q.copy()
            q[:, hidden] = curve[:, hidden]
            items.append(trajectory.changed(q=q))
        return Trajectories(items)

    def regular(self, coefficients: np.ndarray | None = None) -> float:
        """Share of the motion along which the mass matrix is positive definite."""
        values = self.coefficients if coefficients is None else coefficients
        return self.grid.regular(values, self.control_points)

    def mass_matrix(self, points: Points) -> np.ndarray:
        """(n_points, n_dof, n_dof) at some states."""
        physics, index = self.grid.physics(self.structure)
        return physics.columns.mass_matrix(points, self.coefficients[index])

    def mass_matrices(self) -> Iterator[np.ndarray]:
        """(n_points, n_dof, n_dof) along the curve, run by run."""
        physics, index = self.grid.physics(self.structure)
        for _, points in self.along():
            yield physics.columns.mass_matrix(points, self.coefficients[index])

    def equation_error(self) -> tuple[np.ndarray, np.ndarray]:
        """Root mean square of the equation residual, relative to the terms of each equation, and absolute.

        A coordinate without an equation has zero, and NaN.
        """
        physics, index = self.grid.physics(self.structure)
        spline, coefficients = self.grid.spline, self.coefficients[index]
        squares = np.zeros(self.control_points.shape[1])
        for chunk, points in self.along():
            size = ((physics.columns.strong(points) * coefficients[:, None, None]) ** 2).sum(axis=0)
            # the parts of a single candidate may cancel (conserved momentum): M q̈ gives their size
            mass = physics.columns.mass_matrix(points, coefficients)
            size += np.einsum("pij,jp->ip", mass**2, np.square(points.columns[2 * squares.size :]))
            if self.grid.forces is not None:
                size += self.grid.forces.values[chunk, 0].T ** 2
            squares += size.sum(axis=1)
        rms = np.sqrt(self.linearisation.equation / spline.duration)
        share = rms / np.sqrt(np.maximum(squares / spline.n_intervals, 1e-300))
        none = list(physics.columns.prescribed)
        share[none], rms[none] = 0.0, np.nan
        return share, rms

    def relevant_gain(self, relevance: float) -> float:
        """Gain in 2 log likelihood of a term that explains a share ``relevance`` of the equation error."""
        return relevance * float(self.weights.slack.sum())

    @cached_property
    def quadratic(self) -> Quadratic:
        """Quadratic model of the cost in all free candidates about this fit.

        Refinement, the selection of terms and the alternatives ask for it in turn, and on a long recording
        it takes as long as two Gauss–Newton steps.
        """
        return self.score(self.problem.candidates.subset(self.problem.free.tolist()))

    def score(self, candidates: EulerLagrange) -> Quadratic:
        """Quadratic model of the cost in some candidates about this fit."""
        return score_candidates(self.linearisation, self.weights, candidates)
