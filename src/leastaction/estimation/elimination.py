"""Normal equations of the joint problem, and the curve eliminated from them.

    ( H   C ) (ΔP)     (g_P)
    ( Cᵀ  A ) (Δλ) = − (g_λ)      →      (A − CᵀH⁻¹C) Δλ = −(g_λ − CᵀH⁻¹g_P)

H is banded and belongs to the control points of the curve, A is small and belongs to the coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from leastaction.estimation.banded import BandedFactor

__all__ = ["Condensed", "CurveFactor", "Eliminated", "NormalEquations", "Quadratic"]


class CurveFactor(Protocol):
    """What is needed of a factorisation of H, wherever it is held."""

    @property
    def logdet(self) -> float:
        """log |H|"""
        ...

    def solve(self, right: np.ndarray) -> np.ndarray:
        """H⁻¹b for one right-hand side."""
        ...


class Eliminated(Protocol):
    """A system without its curve, wherever it was made; see `Quadratic`."""

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
    """The cost as a function of the coefficients alone, the curve eliminated.

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
        Half gradient in the coefficients while the curve is held, g_λ.
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
        """By how much steps of curve and coefficients should lower the cost."""
        assert self.held is not None
        return -float(self.curve_gradient @ shift + self.held @ step)


class Condensed(NamedTuple):
    """What a part of a motion leaves of its system when its curve is eliminated.

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
        """The same, with all that is needed of H: no factor is kept.

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
        if not np.isfinite(factor.logdet):  # LAPACK may factorise NaN without complaint
            raise np.linalg.LinAlgError("the normal matrix is not finite")
        half = factor.forward(self.border)
        return factor, half, half.T @ half
