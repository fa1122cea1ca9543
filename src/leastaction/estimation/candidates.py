"""Scores of all candidates about a fit with the curve eliminated, in one pass along the motion.

With H = LLᵀ from the fit and Y = L⁻¹[g_P, C] with the columns C of all candidates, the Schur complement

    A − CᵀH⁻¹C = A − YᵀY,    g_λ − CᵀH⁻¹g_P = g_λ − Yᵀy_g

is a sum over the rows of Y.  L is banded, so the rows of one stretch of the motion follow from those of the
last few control points before it. No array of the size candidates × control points is held.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from leastaction.estimation.elimination import BandedFactor, CurveFactor, NormalEquations
from leastaction.estimation.intervals import by_interval, points_at
from leastaction.estimation.joint import Linearisation, Weights
from leastaction.estimation.volume import Volume, volume_term
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["CandidateBorder", "Scores", "schur_complement", "score"]

_STRETCH, _SHORTEST = 512, 16  # knot intervals
_NUMBERS = 2_000_000  # in the columns of one stretch, at most: 16 MB


@dataclass(frozen=True, eq=False)
class CandidateBorder:
    """The columns of candidates along the motion of a fit.  Called: C · step, without C."""

    linearisation: Linearisation
    weights: Weights
    candidates: EulerLagrange

    def __call__(self, step: np.ndarray) -> np.ndarray:
        at = self.linearisation
        out, grid = np.zeros_like(at.control_points), at.observations.grid
        (moved,) = np.nonzero(step)
        if moved.size:
            moving = replace(self, candidates=self.candidates.subset(moved.tolist()))
            for chunk, jacobian, columns in moving.stretches():
                values = columns[:, :, 1:] @ step[moved]
                products = (jacobian.transpose(0, 2, 1) @ values[:, :, None])[:, :, 0]
                grid.add_products(out, products.reshape(len(values), -1, out.shape[1]), chunk)
        return out.ravel()

    def stretches(self) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Runs of knot intervals with √w J and √w [r, e], (m, n_equations, n_local or 1 + n) each."""
        at, size = self.linearisation, 1 + len(self.candidates)
        grid = at.observations.grid
        n, n_quad = at.control_points.shape[1], grid.weights.shape[1]
        root = np.sqrt(self.weights.physics)[:, None, None]
        length = int(np.clip(_NUMBERS // (n * n_quad * size), _SHORTEST, _STRETCH))
        for chunk, jacobian, right in at.pieces(length):
            columns = np.empty((len(right), n, n_quad, size))
            columns[..., 0] = root[..., 0] * right[..., 0]
            by_interval(self.candidates.strong(points_at(grid, at.control_points, chunk)), columns[..., 1:])
            columns[..., 1:] *= root * np.sqrt(grid.weights[chunk])[:, None, :, None]
            shape = (len(columns), n * n_quad, -1)
            yield chunk, (root * jacobian).reshape(shape), columns.reshape(shape)


@dataclass(frozen=True, eq=False)
class Scores:
    """All candidates about a fit, before the log-determinant term.

    Attributes
    ----------
    schur : (1 + n, 1 + n) array
        See :func:`schur_complement`.
    volume : Volume
        Its derivatives in the candidates' coefficients.
    factor, curve_gradient : CurveFactor, (n_ctrl · n_dof,) array
        Of H; half the gradient in the control points.
    border : callable
        (n,) step → C · step.
    """

    schur: np.ndarray
    volume: Volume
    factor: CurveFactor
    curve_gradient: np.ndarray
    border: Callable[[np.ndarray], np.ndarray]


def score(at: Linearisation, weights: Weights, candidates: EulerLagrange) -> Scores:
    """Score candidates about a fit.

    Raises
    ------
    numpy.linalg.LinAlgError
        When H is not positive definite.
    """
    normal = at.normal(weights)
    curve_gradient = normal.border[:, 0].copy()
    factor = BandedFactor.of(normal.rows)
    border = CandidateBorder(at, weights, candidates)
    curve = at.observations.grid, at.physics.columns, at.control_points
    volume = volume_term(*curve, at.coefficients, candidates)
    schur = schur_complement(border, factor, curve_gradient)
    if normal.border.shape[1] > 1 + at.physics.n_free:
        schur -= _calibrated(border, factor, normal)
    return Scores(schur, volume, factor, curve_gradient, border)


def _calibrated(border: CandidateBorder, factor: BandedFactor, normal: NormalEquations) -> np.ndarray:
    """(1 + n, 1 + n) reduction of the Schur complement by the calibration numbers, which are refitted.

    With their border B, their corner K and Z = H⁻¹B, it is RᵀS⁻¹R, where S = K − BᵀZ and
    R = [g_κ − Zᵀg_P, −ZᵀC].
    """
    begin = border.linearisation.physics.n_free
    own = normal.border[:, 1 + begin :]
    follow = factor.backward(factor.forward(own.copy()))
    matrix = normal.corner[begin:, begin:] - own.T @ follow
    reach = np.zeros((len(matrix), 1 + len(border.candidates)))
    grid, n = border.linearisation.observations.grid, border.linearisation.control_points.shape[1]
    for chunk, jacobian, columns in border.stretches():
        local = grid.local_control_points(follow.reshape(grid.n_ctrl, n, -1), chunk)
        seen = jacobian @ local.reshape(len(jacobian), jacobian.shape[2], -1)
        reach -= np.einsum("mqk,mqc->kc", seen, columns)
    reach[:, 0] = normal.gradient[begin:] - follow.T @ normal.border[:, 0]
    return reach.T @ np.linalg.pinv(matrix, rcond=1e-12, hermitian=True) @ reach


def schur_complement(border: CandidateBorder, factor: BandedFactor, curve_gradient: np.ndarray) -> np.ndarray:
    """(1 + n, 1 + n): moments of [r, e] less those of [y_g, Y]."""
    grid, n = border.linearisation.observations.grid, border.linearisation.control_points.shape[1]
    size = 1 + len(border.candidates)
    out, carried, solved = np.zeros((size, size)), np.zeros((0, n, size)), np.zeros((0, size))
    for chunk, jacobian, columns in border.stretches():
        out += (flat := columns.reshape(-1, size)).T @ flat
        start, last = int(grid.first[chunk.start]), int(grid.first[chunk.stop - 1])
        rows = np.zeros((last + grid.degree + 1 - start, n, size))
        rows[: len(carried)] = carried
        products = jacobian.transpose(0, 2, 1) @ columns
        grid.add_products(rows, products.reshape(len(columns), -1, n, size), chunk, start)
        # control points that no later interval reaches
        stop = len(rows) if chunk.stop == grid.n_intervals else int(grid.first[chunk.stop]) - start
        right = rows[:stop].reshape(-1, size)
        right[:, 0] = curve_gradient[start * n : (start + stop) * n]
        carried = rows[stop:].copy()
        # L reaches back over `degree` control points, more than a short stretch may have
        fresh = factor.forward(right, start * n, solved)
        out -= fresh.T @ fresh
        solved = np.concatenate([solved, fresh])[-(grid.degree + 1) * n :]
    return out
