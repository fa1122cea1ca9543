"""Normal equations of the joint problem, and the curve eliminated from them.

    ( H   C ) (ΔP)     (g_P)
    ( Cᵀ  A ) (Δλ) = − (g_λ)      →      (A − CᵀH⁻¹C) Δλ = −(g_λ − CᵀH⁻¹g_P)

H is banded and belongs to the control points of the curve, A is small and belongs to the coefficients.
Unknowns are numbered control point by control point, coordinate fastest: H = LLᵀ.  In blocks of at least the
bandwidth L is block bidiagonal, and the blocks of Z = H⁻¹ on and beside the diagonal follow from it backwards
(Takahashi, Fagan & Chin 1973),

    Z_kk = L_kk⁻ᵀL_kk⁻¹ + G_kᵀ Z_{k+1,k+1} G_k,    Z_{k+1,k} = −Z_{k+1,k+1} G_k,    G_k = L_{k+1,k} L_kk⁻¹,

which are all that traces such as tr(H⁻¹ ∂H/∂w) = ∂ log|H|/∂w need.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg import lapack

__all__ = [
    "BandedFactor",
    "Condensed",
    "CurveFactor",
    "Eliminated",
    "NormalEquations",
    "Quadratic",
    "trace_product",
]

_GROUP = 256  # blocks whose inverses are held at once


@dataclass(frozen=True, eq=False)
class BandedFactor:
    """Lower Cholesky factor in banded storage: ``band[c, d]`` = L[c + d, c].

    Examples
    --------
    >>> rows = np.zeros((4, 1, 2))  # a tridiagonal matrix: its diagonal, and the entries beside it
    >>> rows[:, 0, 0], rows[:3, 0, 1] = 2.0, -1.0
    >>> factor = BandedFactor.of(rows)
    >>> factor.solve(np.array([1.0, 0.0, 0.0, 1.0]))
    array([1., 1., 1., 1.])
    >>> bool(np.isclose(factor.logdet, np.log(5.0)))
    True
    """

    band: np.ndarray
    n_dof: int

    @classmethod
    def of(cls, rows: np.ndarray, damping: float = 0.0) -> BandedFactor:
        """Factorise (n_ctrl, n_dof, width) block rows, the diagonal raised by a share ``damping``.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the matrix is not positive definite.
        """
        n_ctrl, n, width = rows.shape
        band = np.zeros((n_ctrl, n, width))
        for i in range(n):
            band[:, i, : width - i] = rows[:, i, i:]
        band = band.reshape(n_ctrl * n, width)
        # one rounding error is added, because exact equations leave tiny pivots
        band[:, 0] *= (1.0 + 1e-14) * (1.0 + damping)
        factor, info = lapack.dpbtrf(band.T, lower=1, overwrite_ab=1)
        if info:
            raise np.linalg.LinAlgError(f"leading minor {info} is not positive definite")
        return cls(factor.T, n)

    @property
    def logdet(self) -> float:
        """log |H|"""
        return 2.0 * float(np.log(self.band[:, 0]).sum())

    def forward(self, right: np.ndarray, start: int = 0, before: np.ndarray | None = None) -> np.ndarray:
        """L⁻¹B for the rows from ``start`` on.

        Parameters
        ----------
        right : (n_rows, n_columns) array
        before : (n_before, n_columns) array, optional
            The result in the rows just before ``start``, at least as many as the bandwidth.
        """
        reach = min(self.band.shape[1] - 1, start)
        if reach and before is not None:
            right = np.array(right, order="F")
            below = self._below(start, reach)[: len(right)]
            right[: len(below)] -= below @ before[len(before) - reach :]
        part = self.band[start : start + len(right)]
        return self._triangular(part, right, "N")

    def solve(self, right: np.ndarray) -> np.ndarray:
        """H⁻¹b for one (size,) right-hand side."""
        half = self._triangular(self.band, right[:, None], "N")
        return self._triangular(self.band, half, "T")[:, 0]

    def backward(self, right: np.ndarray) -> np.ndarray:
        """L⁻ᵀB for (size, n_columns) right-hand sides."""
        return self._triangular(self.band, right, "T")

    @staticmethod
    def _triangular(band: np.ndarray, right: np.ndarray, transposed: str) -> np.ndarray:
        found, info = lapack.dtbtrs(band.T, right, uplo="L", trans=transposed)
        if info:
            raise np.linalg.LinAlgError(f"pivot {info} vanishes")
        return found

    def _below(self, start: int, reach: int) -> np.ndarray:
        """(bandwidth, reach) rows of L from ``start`` on, in the columns before it."""
        width = self.band.shape[1]
        out = np.zeros((width - 1, reach))
        for column in range(reach):
            entries = self.band[start - reach + column, reach - column :]
            out[: entries.size, column] = entries
        return out

    def inverse_rows(self) -> np.ndarray:
        """(n_ctrl, n_dof, width) block rows of H⁻¹, as far as those of H reach."""
        size, width = self.band.shape
        n_ctrl, n, points = size // self.n_dof, self.n_dof, width // self.n_dof
        count = -(-n_ctrl // points)
        out = np.empty((count, points, n, width))
        below = np.zeros((width, width))
        for group in reversed(range(0, count, _GROUP)):
            stop = min(group + _GROUP, count)
            diagonal, beside = self._blocks(group, stop)
            inverse = np.linalg.inv(diagonal)
            onward = beside @ inverse
            own = inverse.transpose(0, 2, 1) @ inverse
            panels = np.empty((stop - group, width, 2 * width))
            for k in reversed(range(stop - group)):
                turned = below @ onward[k]
                below = onward[k].T @ turned
                below += own[k]
                panels[k, :, :width] = below
                panels[k, :, width:] = -turned.T
            block, step, entry = panels.strides
            # from the columns of each control point on
            strides = (block, n * (step + entry), step, entry)
            out[group:stop] = as_strided(panels, (stop - group, points, n, width), strides)
        return out.reshape(count * points, n, width)[:n_ctrl]

    def _blocks(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """(n_blocks, width, width) blocks of L on and below the diagonal; the last one is filled up."""
        width = self.band.shape[1]
        rows = np.zeros(((stop - start) * width, width))
        own = self.band[start * width : stop * width]
        rows[: len(own)] = own
        rows[len(own) :, 0] = 1.0
        columns = np.zeros((stop - start, width, 2 * width))
        block, step, entry = columns.strides
        skewed = as_strided(columns, (stop - start, width, width), (block, step + entry, entry))
        skewed[...] = rows.reshape(stop - start, width, width)
        columns = columns.transpose(0, 2, 1)
        return columns[:, :width], columns[:, width:]


def trace_product(inverse_rows: np.ndarray, coordinate: int, gram: np.ndarray) -> float:
    """tr(H⁻¹D) for D that couples one coordinate with itself: ``gram`` in lower banded storage."""
    part = inverse_rows[:, coordinate, coordinate :: inverse_rows.shape[1]].T * gram
    return float(2.0 * part.sum() - part[0].sum())


#                                                                      normal equations, the curve eliminated
class CurveFactor(Protocol):
    """Interface of a factorisation of H, held here or by workers."""

    @property
    def logdet(self) -> float:
        """log |H|"""
        ...

    def solve(self, right: np.ndarray) -> np.ndarray:
        """H⁻¹b for one right-hand side."""
        ...


class Eliminated(Protocol):
    """Interface of a system with the curve eliminated, made here or by workers; see `Quadratic`."""

    @property
    def gradient(self) -> np.ndarray: ...
    @property
    def matrix(self) -> np.ndarray: ...
    @property
    def factor(self) -> CurveFactor: ...
    def curve_step(self, step: np.ndarray) -> np.ndarray: ...
    def predicted(self, shift: np.ndarray, step: np.ndarray) -> float: ...


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The cost as a function of the coefficients alone, with the curve eliminated.

    Attributes
    ----------
    gradient, matrix : (n_border,) and (n_border, n_border) arrays
        Half gradient, and half second derivative.
    factor : CurveFactor
        Of H.
    curve_gradient : (n_ctrl · n_dof,) array
        Half gradient in the control points.
    border : callable
        (n_border,) step → C · step.
    held : (n_border,) array, optional
        Half gradient in the coefficients for a fixed curve, g_λ.
    """

    gradient: np.ndarray
    matrix: np.ndarray
    factor: CurveFactor
    curve_gradient: np.ndarray
    border: Callable[[np.ndarray], np.ndarray]
    held: np.ndarray | None = None

    @property
    def logdet(self) -> float:
        """log |H|"""
        return self.factor.logdet

    def curve_step(self, step: np.ndarray) -> np.ndarray:
        """H⁻¹(g_P + C · step), flat: subtract it from the control points as λ moves by the step."""
        return self.factor.solve(self.curve_gradient + self.border(step))

    def predicted(self, shift: np.ndarray, step: np.ndarray) -> float:
        """Predicted decrease of the cost by steps of curve and coefficients."""
        assert self.held is not None
        return -float(self.curve_gradient @ shift + self.held @ step)


class Condensed(NamedTuple):
    """The system of a part of a motion after its curve is eliminated.

    Attributes
    ----------
    gradient, matrix, held
        As of `Quadratic`.
    reach : (1 + n_border,) array
        gᵀH⁻¹[g, C], g the half gradient in the control points.
    solution : (n_ctrl · n_dof, 1 + n_border) array
        H⁻¹[g, C].
    logdet : float
        log |H|
    """

    gradient: np.ndarray
    matrix: np.ndarray
    held: np.ndarray
    reach: np.ndarray
    solution: np.ndarray
    logdet: float


class NormalEquations(NamedTuple):
    """The Gauss–Newton system at given weights.

    Attributes
    ----------
    rows : (n_ctrl, n_dof, n_local) array
        H by block rows; see :meth:`leastaction.curve.bspline.SplineGrid.add_gram`.
    border : (n_ctrl · n_dof, 1 + n_border) array
        Half gradient in the control points, then C.
    gradient : (n_border,) array
        Half gradient in the coefficients.
    corner : (n_border, n_border) array
        A, the log-determinant term included.
    """

    rows: np.ndarray
    border: np.ndarray
    gradient: np.ndarray
    corner: np.ndarray

    def eliminate(self, damping: float = 0.0) -> Quadratic:
        """A − CᵀH⁻¹C and g_λ − CᵀH⁻¹g_P from the triangular factor alone.

        Raises
        ------
        numpy.linalg.LinAlgError
            When H is not positive definite, or not finite.
        """
        factor, _, products = self._halves(damping)
        return Quadratic(
            self.gradient - products[1:, 0],
            self.corner - products[1:, 1:],
            factor,
            self.border[:, 0],
            self.border[:, 1:].dot,
            self.gradient,
        )

    def condense(self, damping: float = 0.0) -> Condensed:
        """As `eliminate`, with the solutions that later steps need instead of the factor.

        Raises
        ------
        numpy.linalg.LinAlgError
            When H is not positive definite, or not finite.
        """
        factor, half, products = self._halves(damping)
        return Condensed(
            self.gradient - products[1:, 0],
            self.corner - products[1:, 1:],
            self.gradient,
            products[0],
            factor.backward(half),
            factor.logdet,
        )

    def lean(self) -> NormalEquations:
        """Itself: nothing was computed ahead."""
        return self

    def _halves(self, damping: float) -> tuple[BandedFactor, np.ndarray, np.ndarray]:
        """L, X = L⁻¹[g, C], and XᵀX."""
        factor = BandedFactor.of(self.rows, damping)
        if not np.isfinite(factor.logdet):  # LAPACK may factorise NaN without an error
            raise np.linalg.LinAlgError("the normal matrix is not finite")
        half = factor.forward(self.border)
        return factor, half, half.T @ half
