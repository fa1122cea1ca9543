"""Poles and modes of M δ̈ + C δ̇ + K δ = 0, and their derivatives with respect to M, C and K."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from leastaction.model.notation import rounded
from leastaction.model.term import Z95

__all__ = ["ZERO", "Estimate", "Matrices", "Mode", "find_modes", "state_matrix"]

Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]
"""M, C and K."""

ZERO = 1e-7
"""Share of the largest pole: a double pole at zero is computed as the root of the rounding error."""

_IN_STEP = 1e-3  # imaginary part of a shape: less is a phase below a tenth of a degree
_ROUNDING = 1e-12  # of the largest eigenvalue: smaller changes within a standard error are rounding
_ALIKE = 1e-3  # shapes that differ by less are one; those of a double pole do by a root of the rounding
_SAME = 1e-6  # relative: smaller differences of sizes are rounding


@dataclass(frozen=True)
class Estimate:
    """A number with its standard error.

    Attributes
    ----------
    value, standard_error : float
        The error is NaN if it is not available.
    lower, upper : float
        95 % interval, value ± 1.96 standard errors.

    Examples
    --------
    >>> found = Estimate(3.1321, 0.0024)
    >>> print(found, round(found.lower, 4))
    3.1321(24) 3.1274
    """

    value: float
    standard_error: float

    @property
    def lower(self) -> float:
        """Lower end of the 95 % interval."""
        return self.value - Z95 * self.standard_error

    @property
    def upper(self) -> float:
        """Upper end of the 95 % interval."""
        return self.value + Z95 * self.standard_error

    def __float__(self) -> float:
        return self.value

    def __str__(self) -> str:
        return rounded(self.value, self.standard_error, uncertainty=True)


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode of small motion around an equilibrium: a pair of poles, or a real pole.

    Attributes
    ----------
    pole : complex
        In 1/s; for a pair, the pole above the real axis.
    natural_frequency : Estimate
        Magnitude of the pole in rad/s; for a real pole, its rate in 1/s.
    frequency : Estimate
        The same over 2π, in Hz.
    damping_ratio : Estimate
        −Re(pole) over the magnitude of the pole: 1 for a decaying real pole, −1 for a growing one, NaN for a
        pole at zero.
    shape : ndarray, shape (n_free,), complex
        Deflections of the coordinates relative to the largest, each in its own unit. The imaginary part is
        zero without damping and gyroscopic terms. Otherwise the argument is the phase of a coordinate.
    shape_standard_error : ndarray, shape (n_free,), complex
        Standard errors of the real and imaginary parts; NaN if several modes share a pole.
    """

    pole: complex
    natural_frequency: Estimate
    frequency: Estimate
    damping_ratio: Estimate
    shape: np.ndarray
    shape_standard_error: np.ndarray

    @property
    def pace(self) -> str:
        """Frequency and damping ratio, or the rate of a non-oscillating mode, as text.

        Examples
        --------
        >>> from leastaction import LagrangianModel
        >>> from leastaction.model.term import ModelTerm
        >>> terms = [ModelTerm("x_dot**2", 0.5), ModelTerm("cos(x)", 9.81, 0.04)]
        >>> model = LagrangianModel("x", terms)
        >>> [mode.pace for q in ([0.0], [3.1416]) for mode in model.linearise(q).modes]
        ['0.4985(10) Hz', 'decays at 3.1321(64) 1/s', 'grows at 3.1321(64) 1/s']
        """
        if self.pole == 0.0:
            return "moves freely"
        if self.pole.imag == 0.0:
            return f"{'grows' if self.pole.real > 0.0 else 'decays'} at {self.natural_frequency} 1/s"
        ratio = f", damping ratio {self.damping_ratio}" if self.pole.real else ""
        return f"{self.frequency} Hz{ratio}"

    def deviations(self, names: Sequence[str]) -> list[str]:
        """The shape as text, with the phase of coordinates that do not move in phase.

        Examples
        --------
        >>> from leastaction import LagrangianModel
        >>> from leastaction.model.term import ModelTerm
        >>> terms = [ModelTerm("x_dot**2+y_dot**2", 0.5), ModelTerm("cos(x)+cos(y-x)", 1.0)]
        >>> model = LagrangianModel(["x", "y"], terms)
        >>> [mode.deviations(model.coordinates) for mode in model.linearise([0.0, 0.0]).modes]
        [['x 0.618034', 'y 1'], ['x 1', 'y -0.618034']]
        """
        out: list[str] = []
        both = zip(names, self.shape.tolist(), self.shape_standard_error.tolist(), strict=True)
        for name, part, error in both:
            if abs(part.imag) > _IN_STEP:
                out.append(f"{name} {abs(part):.3g} at {math.degrees(math.atan2(part.imag, part.real)):.0f}°")
            else:
                out.append(f"{name} {rounded(part.real, error.real, uncertainty=True)}")
        return out


def state_matrix(mass: np.ndarray, damping: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """A of ẋ = A x + B δf with x = (δ, δ̇)."""
    n = len(mass)
    lower = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    return np.block([[np.zeros((n, n)), np.eye(n)], [lower]])


def find_modes(here: Matrices, changes: list[list[np.ndarray]] | None) -> tuple[tuple[Mode, ...], np.ndarray]:
    """Modes in rising frequency, and all poles."""
    mass, damping, stiffness = here
    still = [damping, *(change[1] for change in changes or ())]
    if not any(part.any() for part in still) and _conservative(mass, stiffness):
        squares, right = eigh(stiffness, mass)
        squares[np.abs(squares) <= ZERO**2 * np.abs(squares).max()] = 0.0
        inverse = np.linalg.inv(mass)
        slopes = [inverse @ (k - m @ inverse @ stiffness) for m, _, k in changes or ()]
        moves = _perturbed(squares, right, mass @ right, slopes)
        upper = np.sqrt(np.abs(squares)) * np.where(squares > 0.0, 1j, 1.0)  # i ω, or the growing pole
        moves = [(_divided(-move, 2.0 * upper), shape) for move, shape in moves]
        falling = np.flatnonzero(squares < 0.0).tolist()
        sides = [(i, 1.0) for i in range(len(upper))] + [(i, -1.0) for i in falling]
        poles = np.concatenate([upper, -upper])
    else:
        n, whole = len(mass), state_matrix(*here)
        upper, right = np.linalg.eig(whole)
        left = np.linalg.pinv(right).conj().T
        upper[np.abs(upper) <= ZERO * np.abs(upper).max()] = 0.0
        slopes = [_state_slope(here, change) for change in changes or ()]
        moves = [(m, v[:n]) for m, v in _perturbed(upper, right, left, slopes)]
        right, poles = right[:n], upper
        repeated = _repeated(right, upper == 0.0)
        sides = [(i, 1.0) for i in np.flatnonzero((np.imag(upper) >= 0.0) & ~repeated).tolist()]
    sides.sort(key=lambda side: (abs(upper[side[0]]), side[1] * np.real(upper[side[0]])))
    known = changes is not None
    modes = [
        _mode(
            complex(sign * upper[i]),
            right[:, i],
            [sign * m[i] for m, _ in moves],
            [v[:, i] for _, v in moves],
            known,
        )
        for i, sign in sides
    ]
    return tuple(modes), np.array(
        sorted(poles, key=lambda p: (abs(p), np.real(p), np.imag(p))), dtype=complex
    )


def _repeated(shapes: np.ndarray, resting: np.ndarray) -> np.ndarray:
    """Which poles at zero have the shapes of others: where nothing damps a mode, its pole is double."""
    kept = np.zeros((len(shapes), 0))
    repeated = np.zeros(resting.size, dtype=bool)
    for i in np.flatnonzero(resting):
        wider = np.column_stack([kept, shapes[:, i] / np.linalg.norm(shapes[:, i])])
        repeated[i] = np.linalg.svd(wider, compute_uv=False)[-1] < _ALIKE
        kept = kept if repeated[i] else wider
    return repeated


def _conservative(mass: np.ndarray, stiffness: np.ndarray) -> bool:
    symmetric = all(np.allclose(x, x.T, rtol=1e-9, atol=1e-12 * np.abs(x).max()) for x in (mass, stiffness))
    return symmetric and bool(np.linalg.eigvalsh(mass).min() > 0.0)


def _state_slope(here: Matrices, change: Sequence[np.ndarray]) -> np.ndarray:
    """Change of the state matrix with M, C and K."""
    mass, damping, stiffness = here
    lower = [part - change[0] @ np.linalg.solve(mass, x) for part, x in
             zip((change[2], change[1]), (stiffness, damping), strict=True)]  # fmt: skip
    n = len(mass)
    return np.vstack([np.zeros((n, 2 * n)), -np.linalg.solve(mass, np.hstack(lower))])


def _divided(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """a/b; NaN where b is zero."""
    return np.where(below != 0.0, above / np.where(below != 0.0, below, 1.0), np.nan)


def _perturbed(
    values: np.ndarray, right: np.ndarray, left: np.ndarray, slopes: Sequence[np.ndarray]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """First-order changes of eigenvalues and right eigenvectors (up to their length) with the matrix.

    NaN for vectors of equal eigenvalues, for equal eigenvalues that the change separates, and if left and
    right vectors are orthogonal.
    """
    sizes = np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0)
    overlap = np.einsum("ki,ki->i", left.conj(), right)
    overlap = np.where(np.abs(overlap) > _SAME * sizes, overlap, 0.0)
    scale = np.abs(values).max(initial=0.0)
    gaps = values[None, :] - values[:, None]
    equal = np.abs(gaps) <= _SAME * scale
    gaps = np.where(equal, 0.0, gaps)
    np.fill_diagonal(gaps, 1.0)
    out: list[tuple[np.ndarray, np.ndarray]] = []
    for slope in slopes:
        mixed = _divided(left.conj().T @ slope @ right, overlap[:, None])
        alone = np.diag(mixed).copy()
        apart = np.maximum(np.abs(mixed - np.diag(alone)), np.abs(alone[:, None] - alone[None, :]))
        parted = np.where(equal, apart, 0.0)
        alone[~np.all(parted <= _ROUNDING * scale, axis=0)] = np.nan
        share = _divided(mixed, gaps)
        np.fill_diagonal(share, 0.0)
        out.append((alone, right @ share))
    return out


def _mode(
    pole: complex, shape: np.ndarray, moves: Sequence[complex], bends: Sequence[np.ndarray], known: bool
) -> Mode:
    sizes = np.abs(shape)
    k = int(np.flatnonzero(sizes >= (1.0 - _SAME) * sizes.max())[0])
    size, none = abs(pole), math.nan
    scaled = (shape / shape[k]).astype(complex)
    bent = np.array([b / shape[k] - scaled * b[k] / shape[k] for b in bends]).reshape(-1, len(shape))
    bent[:, k] = 0.0
    turned = np.sqrt(np.sum(np.real(bent) ** 2, axis=0)) + 1j * np.sqrt(np.sum(np.imag(bent) ** 2, axis=0))
    if size > 0.0:
        rates = [(pole.conjugate() * complex(m)).real / size for m in moves]
        ratios = [
            -complex(m).real / size + pole.real * r / size**2 for m, r in zip(moves, rates, strict=True)
        ]
    else:
        rates, ratios = [none] * len(moves), [none] * len(moves)
    error, ratio_error = (math.hypot(*x) if known else none for x in (rates, ratios))
    return Mode(
        pole,
        Estimate(size, error),
        Estimate(size / math.tau, error / math.tau),
        Estimate(-pole.real / size + 0.0 if size > 0.0 else none, ratio_error),
        scaled,
        turned if known else np.full(len(shape), none + 1j * none),
    )
