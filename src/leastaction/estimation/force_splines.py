"""Splines for forces of unknown size that change slowly, as columns beside those of the terms.

The force on coordinate i of a trajectory is b_i(t) = Σ_m B_m(t) β_m, a cubic spline with knots some seconds
apart.  In the equations of motion

    Σ_k λ_k E_i[φ_k] − Σ_m B_m β_m = f_i

β enters as λ does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from leastaction.curve.bspline import SplineSpace
from leastaction.estimation.forces import WithPushes
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.joint import Physics
from leastaction.estimation.workspace import StructureFit, Workspace
from leastaction.mechanics.euler_lagrange import Points

__all__ = ["SlowForces", "fit_with_forces", "slow_forces"]

_DEGREE = 3
_RIDGE = 1e-10


class SlowForces:
    """The splines of the slow forces, and their basis at the quadrature points of a grid.

    Attributes
    ----------
    equations : (n_slow,) int array
        The coordinate of each basis function.
    basis : (n_slow, n_intervals · n_quadrature) sparse array
    """

    def __init__(self, workspace: Workspace, seconds: Mapping[int, float]) -> None:
        self.times = workspace.times
        self.spaces = {
            (i, k): SplineSpace(_DEGREE, np.linspace(t[0], t[-1], 1 + max(1, round((t[-1] - t[0]) / every))))
            for i, every in seconds.items()
            for k, t in enumerate(workspace.times)
        }
        grid = workspace.grid
        self.n_quadrature = grid.points.shape[1]
        self.equations = np.concatenate([np.full(s.n_ctrl, i) for (i, _), s in self.spaces.items()])
        rows = []
        for (_, k), space in self.spaces.items():
            own = np.flatnonzero(grid.owner == k)
            values = space.basis(grid.points[own].ravel()).T.tocoo()
            functions, points = values.coords
            columns = own[0] * self.n_quadrature + points  # the intervals of a trajectory are successive
            shape = (space.n_ctrl, grid.points.size)
            rows.append(sp.csr_array((values.data, (functions, columns)), shape=shape))
        self.basis = sp.vstack(rows).tocsc()

    def __len__(self) -> int:
        return self.equations.size

    def on(self, intervals: slice, n_dof: int) -> np.ndarray:
        """(n_slow, n_dof, n_points) −B_m on its equation, in the sequence of `Points`."""
        n = self.n_quadrature
        start, stop, _ = intervals.indices(self.basis.shape[1] // n)
        part = self.basis[:, start * n : stop * n].toarray()
        out = np.zeros((len(self), n_dof, part.shape[1]))
        in_sequence = part.reshape(len(self), -1, n).transpose(0, 2, 1).reshape(len(self), -1)
        out[np.arange(len(self)), self.equations] = -in_sequence
        return out

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


def slow_forces(
    workspace: Workspace, structure: StructureFit, seconds: Mapping[int, float]
) -> list[np.ndarray]:
    """What is missing beside the forces so far, by least squares along the fitted curve.

    Returns
    -------
    list of (n_times, n_dof) arrays
        At the samples, one for each trajectory; zero on the other coordinates.
    """
    slow, n = SlowForces(workspace, seconds), workspace.trajectories.n_dof
    states = [s[:, 0] for s in workspace.grid.at_quadrature(structure.fit.control_points)]
    strong = workspace.columns.strong(Points(*states))
    residual = -np.tensordot(structure.coefficients, strong, 1)
    if workspace.forces is not None:
        residual += workspace.forces[:, 0].T
    root = np.sqrt(structure.fit.weights.physics)
    first = slow.basis[:, :: slow.n_quadrature].T
    blocks = []
    for i in range(n):
        members = sp.csr_array(strong[list(structure.members), i].T)
        blocks.append(root[i] * sp.hstack([members, -first * (slow.equations == i)]))
    design = sp.vstack(blocks).tocsr()
    found = _least_squares(design, (root[:, None] * residual).ravel())
    return slow.at_samples(found[len(structure.members) :], n)


def _least_squares(design: sp.csr_array, right: np.ndarray) -> np.ndarray:
    scale = 1.0 / np.sqrt(np.maximum(design.multiply(design).sum(axis=0), 1e-300))
    scaled = design @ sp.diags_array(scale)
    normal = scaled.T @ scaled + _RIDGE * sp.eye_array(design.shape[1])
    return scale * splu(normal.tocsc()).solve(scaled.T @ right)


def fit_with_forces(
    workspace: Workspace, structure: StructureFit, seconds: Mapping[int, float]
) -> tuple[JointFit, list[np.ndarray], dict[int, float]]:
    """Fit curve, coefficients and slow forces together, at the weights of a structure.

    Returns
    -------
    JointFit
        Its covariance begins with the members of the structure.
    list of (n_times, n_dof) arrays
        What the slow forces add at the samples of each trajectory.
    dict
        Coordinate → standard error of its slow force.
    """
    slow = SlowForces(workspace, seconds)
    physics, index = workspace.physics(structure.members)
    extended = Physics(
        WithPushes(physics.columns, slow),
        np.append(physics.free, np.ones(len(slow), bool)),
        workspace.forces,
    )
    start = np.append(structure.coefficients[index], np.zeros(len(slow)))
    fit = fit_joint(
        workspace.observations, extended, structure.fit.weights, structure.fit.control_points, start
    )
    more = slow.at_samples(fit.coefficients[len(index) :], workspace.trajectories.n_dof)
    n = len(structure.members)
    return fit, more, slow.errors(fit.covariance[n:, n:])
