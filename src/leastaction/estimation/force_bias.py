"""Splines for forces of unknown size that change slowly, as columns beside those of the terms.

The force on coordinate i of a trajectory is b_i(t) = Σ_m B_m(t) β_m, a cubic spline with knots some seconds
apart.  In the equations of motion

    Σ_k λ_k E_i[φ_k] − Σ_m B_m β_m = f_i

β enters as λ does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from leastaction.curve.bspline import SplineSpace
from leastaction.data.trajectories import Trajectories
from leastaction.estimation.fit import Fit
from leastaction.estimation.forces import WithPushes
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics
from leastaction.estimation.problem import Structure
from leastaction.estimation.settings import ESTIMATION
from leastaction.estimation.weights import Start
from leastaction.findings import Finding, find

__all__ = ["ForceBias", "SlowForces", "fit_with_forces", "no_bias", "slow_forces"]

_DEGREE = 3  # of the splines of slow forces
_RIDGE = 1e-10  # relative to a unit diagonal


@dataclass(frozen=True, eq=False)
class _Basis:
    """Basis functions of slow forces at the quadrature points of a grid.

    Attributes
    ----------
    equations : (n_slow,) int array
        The coordinate of each basis function.
    values : (n_slow, n_intervals · n_quadrature) sparse array
    n_quadrature : int
    """

    equations: np.ndarray
    values: sp.csc_array
    n_quadrature: int

    def __len__(self) -> int:
        return self.equations.size

    def on(self, intervals: slice, n_dof: int) -> np.ndarray:
        """(n_slow, n_dof, n_points) −B_m on its equation, in the sequence of `Points`."""
        part = self.within(intervals).values.toarray()
        out = np.zeros((len(self), n_dof, part.shape[1]))
        in_sequence = part.reshape(len(self), -1, self.n_quadrature).transpose(0, 2, 1)
        out[np.arange(len(self)), self.equations] = -in_sequence.reshape(len(self), -1)
        return out

    def within(self, intervals: slice) -> _Basis:
        """The same for a part of the motion, given by its knot intervals."""
        n = self.n_quadrature
        start, stop, _ = intervals.indices(self.values.shape[1] // n)
        return replace(self, values=self.values[:, start * n : stop * n])


class SlowForces:
    """The splines of the slow forces.

    Attributes
    ----------
    basis : Pushes
        Their basis functions at the quadrature points of a grid.
    """

    def __init__(self, grid: Grid, seconds: Mapping[int, float]) -> None:
        self.times: list[np.ndarray] = grid.times
        spline = grid.spline
        self.spaces: dict[tuple[int, int], SplineSpace] = {
            (i, k): SplineSpace(
                _DEGREE, np.linspace(float(t[0]), float(t[-1]), 1 + max(1, round((t[-1] - t[0]) / every)))
            )
            for i, every in seconds.items()
            for k, t in enumerate(self.times)
        }
        n = spline.n_quadrature
        equations = np.concatenate([np.full(s.n_ctrl, i) for (i, _), s in self.spaces.items()])
        rows: list[sp.csr_array] = []
        for (_, k), space in self.spaces.items():
            own = np.flatnonzero(spline.owner == k)
            values = space.basis(spline.points[own].ravel()).T.tocoo()
            functions, points = values.coords
            columns = own[0] * n + points  # the intervals of a trajectory are successive
            shape = (space.n_ctrl, spline.n_intervals * n)
            rows.append(sp.csr_array((values.data, (functions, columns)), shape=shape))
        self.basis: _Basis = _Basis(equations, sp.vstack(rows).tocsc(), n)

    def _parts(self) -> Iterator[tuple[tuple[int, int], slice]]:
        """(coordinate, trajectory) of every spline, and where its coefficients are."""
        start = 0
        for key, space in self.spaces.items():
            yield key, slice(start, start + space.n_ctrl)
            start += space.n_ctrl

    def at_samples(self, coefficients: np.ndarray, n_dof: int) -> list[np.ndarray]:
        """(n_times, n_dof) forces at the samples of each trajectory."""
        out = [np.zeros((t.size, n_dof)) for t in self.times]
        for (i, k), own in self._parts():
            out[k][:, i] = self.spaces[i, k].evaluate(coefficients[own], self.times[k])
        return out

    def errors(self, covariance: np.ndarray) -> dict[int, float]:
        """Coordinate → standard error of its force, root mean square over the samples."""
        squares: dict[int, list[np.ndarray]] = {}
        for (i, k), own in self._parts():
            basis = self.spaces[i, k].basis(self.times[k])
            squares.setdefault(i, []).append(basis.multiply(basis @ covariance[own, own]).sum(axis=1))
        return {i: float(np.sqrt(np.mean(np.concatenate(parts)))) for i, parts in squares.items()}


def slow_forces(fit: Fit, seconds: Mapping[int, float]) -> list[np.ndarray]:
    """Slow forces that the residual still contains, by least squares along the fitted curve.

    Returns
    -------
    list of (n_times, n_dof) arrays
        At the samples, one for each trajectory; zero on the other coordinates.
    """
    grid, n = fit.grid, fit.problem.trajectories.n_dof
    slow, members = SlowForces(grid, seconds), list(fit.structure)
    strong = fit.problem.candidates.strong(fit.points())
    residual = -np.tensordot(fit.coefficients, strong, 1)
    if grid.forces is not None:
        residual += grid.forces.values[:, 0].T
    root = np.sqrt(fit.weights.physics)
    first = slow.basis.values[:, :: slow.basis.n_quadrature].T
    blocks: list[sp.csr_array] = []
    for i in range(n):
        columns = sp.csr_array(strong[members, i].T)
        blocks.append(root[i] * sp.hstack([columns, -first * (slow.basis.equations == i)]))
    design: sp.csr_array = sp.vstack(blocks).tocsr()
    found = _least_squares(design, (root[:, None] * residual).ravel())
    return slow.at_samples(found[len(members) :], n)


def _least_squares(design: sp.csr_array, right: np.ndarray) -> np.ndarray:
    scale = 1.0 / np.sqrt(np.maximum(design.multiply(design).sum(axis=0), 1e-300))
    scaled = design @ sp.diags_array(scale)
    normal = scaled.T @ scaled + _RIDGE * sp.eye_array(design.shape[1])
    return scale * splu(normal.tocsc()).solve(scaled.T @ right)


def fit_with_forces(
    grid: Grid, structure: Structure, start: Start, seconds: Mapping[int, float]
) -> tuple[JointFit, list[np.ndarray], dict[int, float]]:
    """Fit curve, coefficients and slow forces together, at the weights of a start.

    Returns
    -------
    JointFit
        Its covariance begins with the members of the structure.
    list of (n_times, n_dof) arrays
        Slow forces at the samples of each trajectory.
    dict
        Coordinate → standard error of its slow force.
    """
    slow = SlowForces(grid, seconds)
    physics, index = grid.physics(structure)
    extended = Physics(
        WithPushes(grid.problem.candidates.subset(index), slow.basis),
        np.append(physics.free, np.ones(len(slow.basis), bool)),
        physics.forces,
    )
    values = grid.problem.completed(start.coefficients)
    first = np.append(values[index], np.zeros(len(slow.basis)))
    fit = fit_joint(grid.observations, extended, start.weights, start.control_points, first)
    more = slow.at_samples(fit.coefficients[len(index) :], grid.problem.trajectories.n_dof)
    n = len(structure)
    return fit, more, slow.errors(fit.covariance[n:, n:])


#                                                             slow forces found in addition to the known ones
_MOST_ROUNDS = 4  # each a search


@dataclass(frozen=True, eq=False)
class ForceBias:
    """Slow forces at the samples of the trajectories; make the first by :func:`no_bias`.

    Attributes
    ----------
    trajectories : Trajectories
        With the forces that are known.
    seconds : mapping of int to float
        Index of a coordinate → spacing of the knots of its force; empty: no slow force is sought.
    added : tuple of (n_times, n_dof) arrays
        The slow forces, one for each trajectory.
    errors : mapping of int to float
        Index of a coordinate → standard error of its slow force.
    rounds : int
        Rounds of estimation, each followed by a new search of the terms.
    last : (n_dof,) array
        Last change of the forces, root mean square.
    """

    trajectories: Trajectories
    seconds: Mapping[int, float]
    added: tuple[np.ndarray, ...]
    errors: Mapping[int, float]
    rounds: int
    last: np.ndarray

    @property
    def forces(self) -> list[np.ndarray]:
        """(n_times, n_dof) known and slow forces together, one for each trajectory."""
        given = (0.0 if t.forces is None else t.forces for t in self.trajectories)
        return [known + slow for known, slow in zip(given, self.added, strict=True)]

    @property
    def seconds_of(self) -> dict[str, float]:
        """Coordinate → seconds between the knots of its force."""
        return {self.trajectories.coordinates[i]: every for i, every in self.seconds.items()}

    @property
    def size(self) -> dict[str, float]:
        """Coordinate → root mean square of its slow force."""
        rms = _rms(self.added) if self.seconds else np.zeros(0)
        return {self.trajectories.coordinates[i]: float(rms[i]) for i in self.seconds}

    def followed(self, fit: Fit) -> ForceBias | None:
        """The forces, updated by the residual of a fit; None when they no longer change."""
        if not self.seconds or self.rounds == _MOST_ROUNDS or not fit.converged:
            return None
        more = slow_forces(fit, self.seconds)
        change = _rms(more)
        # a change that is hardly smaller than the previous one follows the noise
        small = change <= ESTIMATION.bias_settled * _rms(self.added)
        done = small | (change > ESTIMATION.bias_stalled * self.last)
        if self.rounds and np.all(done):
            return None
        return replace(self.adding(more, self.errors), rounds=self.rounds + 1, last=change)

    def adding(self, more: Sequence[np.ndarray], errors: Mapping[int, float]) -> ForceBias:
        """The sum with further forces, and new standard errors."""
        added = tuple(total + part for total, part in zip(self.added, more, strict=True))
        return replace(self, added=added, errors=dict(errors))

    def settled(self, more: Sequence[np.ndarray]) -> bool:
        """Whether the added forces are small relative to the total."""
        return bool(np.all(_rms(more) <= ESTIMATION.bias_settled * _rms(self.added)))

    def found(self) -> dict[str, tuple[np.ndarray, ...]]:
        """Coordinate → slow force at the samples of each trajectory."""
        names = self.trajectories.coordinates
        return {names[i]: tuple(part[:, i].copy() for part in self.added) for i in self.seconds}

    def findings(self) -> list[Finding]:
        """Findings on the slow forces."""
        out: list[Finding] = []
        for i, (name, parts) in zip(self.seconds, self.found().items(), strict=True):
            low, high, error = min(map(np.min, parts)), max(map(np.max, parts)), self.errors[i]
            figures = {"seconds": self.seconds[i], "lowest": low, "highest": high, "standard_error": error}
            none = bool(_rms(list(parts)) < ESTIMATION.no_bias * error)
            out.append(find("slow-force", name, hardly_any=none, **figures))
        return out


def no_bias(trajectories: Trajectories, seconds: Mapping[int, float]) -> ForceBias:
    """Slow forces before the first round: zero."""
    added = tuple(np.broadcast_to(0.0, t.q.shape) for t in trajectories)  # takes no memory
    errors = dict.fromkeys(seconds, np.nan)
    return ForceBias(trajectories, dict(seconds), added, errors, 0, np.full(trajectories.n_dof, np.inf))


def _rms(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0))
