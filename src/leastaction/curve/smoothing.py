"""Penalised B-spline smoothing with the penalty chosen by restricted maximum likelihood (REML).

Each coordinate is modelled as a spline whose third derivative is white noise of unknown strength,
seen through white measurement noise of unknown strength; both are estimated from the data
(Wood 2011, J. R. Stat. Soc. B 73:3; Eilers & Marx 1996).  Banded throughout: the cost is linear in
the number of samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar

from leastaction.curve.bspline import SplineGrid
from leastaction.data.trajectories import Rate
from leastaction.data.validation import FloatArray

__all__ = ["Smooth", "banded_gram", "smooth"]

_PENALTY_DERIVATIVE = 3  # of the curve, whose square is penalised
_SMALLEST = 1e-6  # noise over range
_LOG_STEP = 0.05  # of a numerical derivative, in the logarithm
_MOST_ROUNDS = 12  # of the fixed point for the noise of rates
_NEARLY_EXACT = 0.01  # noise over spread, from which the fixed point begins the second time
_SETTLED = 0.1  # relative change of the noise of a rate at which its fixed point ends

_Block = tuple[sp.csr_array, np.ndarray]
"""Design and samples of one kind of measurement."""
_One = tuple[np.ndarray, float, float, np.ndarray]
"""Control points of one coordinate, noise, penalty, and the factor of the normal matrix."""


@dataclass(frozen=True, eq=False)
class Smooth:
    """Result of :func:`smooth`.

    Attributes
    ----------
    grid : SplineGrid
    control_points : (n_ctrl, n_dof) array
    noise_std : (n_dof,) array
        Estimated standard deviation of the measurement noise.
    penalty : (n_dof,) array
        Penalty κ chosen for ∫ (d³q/dt³)² dt, relative to 1/σ².
    rate_std : (n_rates,) array
        Estimated noise of the measured velocities and accelerations.
    """

    grid: SplineGrid
    control_points: np.ndarray
    noise_std: np.ndarray
    penalty: np.ndarray
    rate_std: np.ndarray
    _times: Sequence[np.ndarray]
    _seen: tuple[tuple[_Rows, ...], ...]

    def replicates(self, count: int, rng: np.random.Generator, floor: np.ndarray) -> list[np.ndarray]:
        """Curves that the same smoothing gives for the smoothed curve measured again, with new noise.

        The noise is at least ``floor``, (n_dof,).
        """
        noise_std = np.maximum(self.noise_std, floor)
        roughness = _penalty_matrix(self.grid)
        systems: list[_Block] = []
        for rows, kappa in zip(self._seen, self.penalty, strict=True):
            design = _design(self.grid, self._times, rows)
            gram = banded_gram(design, self.grid.degree)
            systems.append((design, _factor(gram, float(kappa), roughness)))
        out: list[np.ndarray] = []
        for _ in range(count):
            points = np.empty_like(self.control_points)
            for i, (design, factor) in enumerate(systems):
                clean = design @ np.ascontiguousarray(self.control_points[:, i])
                again = clean + noise_std[i] * rng.standard_normal(clean.size)
                points[:, i] = cho_solve_banded((factor, True), design.T @ again, check_finite=False)
            out.append(points)
        return out

    @classmethod
    def joined(cls, grid: SplineGrid, parts: Sequence[Smooth]) -> Smooth:
        """The result for a grid from those for runs of its trajectories, smoothed with one penalty."""
        sizes = np.array([[part._freedom(i) for i in range(part.noise_std.size)] for part in parts])
        noise = np.sqrt(np.sum(sizes * [part.noise_std**2 for part in parts], axis=0) / sizes.sum(axis=0))
        rates = np.sqrt(np.mean([part.rate_std**2 for part in parts], axis=0))
        seen = tuple(
            tuple(_Rows.joined(rows) for rows in zip(*channels, strict=True))
            for channels in zip(*(part._seen for part in parts), strict=True)
        )
        times = [t for part in parts for t in part._times]
        points = np.concatenate([part.control_points for part in parts])
        return cls(grid, points, noise, parts[0].penalty, rates, times, seen)

    @classmethod
    def beside(cls, parts: Sequence[Smooth]) -> Smooth:
        """The result for all coordinates from those for some of them each, on one grid."""
        points = np.concatenate([part.control_points for part in parts], axis=1)
        noise, penalty, rates = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("noise_std", "penalty", "rate_std")
        )
        seen = tuple(channel for part in parts for channel in part._seen)
        return cls(parts[0].grid, points, noise, penalty, rates, parts[0]._times, seen)

    def _freedom(self, coordinate: int) -> int:
        """Number of samples of a coordinate, less the dimension of the null space of the penalty."""
        return max(self._seen[coordinate][0].count - _PENALTY_DERIVATIVE * len(self.grid.spaces), 1)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of a design: which derivative, by how much they are scaled, and which samples there are."""

    derivative: int
    scale: float
    seen: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[_Rows]) -> _Rows:
        """The rows of successive trajectories."""
        return cls(parts[0].derivative, parts[0].scale, np.concatenate([part.seen for part in parts]))

    @property
    def count(self) -> int:
        return int(self.seen.sum())


def _design(grid: SplineGrid, times: Sequence[np.ndarray], rows: Sequence[_Rows]) -> sp.csr_array:
    """The design of some kinds of samples of one coordinate, one below the other."""
    parts: list[sp.csr_array] = []
    for kind in rows:
        whole = grid.design(times, kind.derivative)
        parts.append(kind.scale * (whole if kind.seen.all() else whole[kind.seen]))
    return parts[0] if len(parts) == 1 else sp.csr_array(sp.vstack(parts, "csr"))


def _factor(gram: np.ndarray, kappa: float, penalty: np.ndarray) -> np.ndarray:
    """Banded Cholesky factor of NᵀN + κD."""
    banded = gram + kappa * penalty
    # a gap longer than a knot interval leaves tiny pivots at small kappa
    banded[0] *= 1.0 + 1e-13
    return cholesky_banded(banded, lower=True, check_finite=False)


def banded_gram(design: sp.csr_array, bandwidth: int) -> np.ndarray:
    """NᵀN in lower banded storage, for rows of ``bandwidth`` + 1 neighbouring entries each."""
    values = design.data.reshape(-1, bandwidth + 1)
    first = design.indices[:: bandwidth + 1]
    n = design.shape[1]
    banded = np.zeros((bandwidth + 1, n))
    for a in range(bandwidth + 1):
        for b in range(a, bandwidth + 1):
            sums = np.bincount(first, values[:, a] * values[:, b], n)
            banded[b - a, a:] += sums[: n - a]
    return banded


def _penalty_matrix(grid: SplineGrid) -> np.ndarray:
    """∫ B‴ B‴ᵀ dt in lower banded storage: exact, the integrand is a polynomial in each knot interval."""
    nodes, weights = np.polynomial.legendre.leggauss(max(1, grid.degree - _PENALTY_DERIVATIVE + 1))
    rows = np.zeros((grid.n_ctrl, 1, grid.degree + 1))
    start = 0
    for space in grid.spaces:
        width = np.diff(space.breakpoints)[:, None]
        x = space.breakpoints[:-1, None] + 0.5 * width * (nodes + 1.0)
        _, values = space.local_basis(x.ravel(), _PENALTY_DERIVATIVE)
        values = values.reshape(*x.shape, -1)
        scaled = (0.5 * width * weights)[:, :, None] * values
        blocks = values.transpose(0, 2, 1) @ scaled
        grid.add_gram(rows, blocks, slice(start, start + space.n_intervals))
        start += space.n_intervals
    return np.ascontiguousarray(rows[:, 0].T)


def smooth(
    grid: SplineGrid,
    times: list[np.ndarray],
    values: list[np.ndarray],
    penalty: np.ndarray | None = None,
    rates: Sequence[Rate] = (),
) -> Smooth:
    r"""Smooth every coordinate of every trajectory; NaN samples are left out.

    Parameters
    ----------
    grid : SplineGrid
    times : list of (n_times,) arrays, one per trajectory
    values : list of (n_times, n_dof) arrays
    penalty : (n_dof,) array, optional
        κ where it is known already; otherwise REML chooses it.
    rates : sequence of Rate, optional
        Measured velocities and accelerations, which the curve then follows too.

    Returns
    -------
    Smooth

    Notes
    -----
    With H(κ) = NᵀN + κD, n samples and M = 3 unpenalised directions a trajectory, κ minimises

    .. math:: (n - M) \log \hat\sigma^2(\kappa) + \log|H(\kappa)| - (n_{ctrl} - M) \log\kappa .

    A rate enters as more rows of N, scaled by the ratio of the positions' noise to its own, which is found by
    the fixed point of :mod:`leastaction.estimation.weights`.
    """
    roughness = _penalty_matrix(grid)
    design = grid.design(times)
    stacked = np.concatenate(values)
    n_dof = stacked.shape[1]
    results: list[_One] = []
    kinds: list[tuple[_Rows, ...]] = []
    rate_std = np.zeros(len(rates))
    derivatives = {nu: grid.design(times, nu) for nu in {rate.derivative for rate in rates}}
    for i in range(n_dof):
        valid = np.isfinite(stacked[:, i])
        rows: sp.csr_array = design if valid.all() else design[valid]
        y = stacked[valid, i]
        kappa = None if penalty is None else float(penalty[i])
        result = _smooth_one(rows, y, roughness, grid, kappa)
        own = [k for k, rate in enumerate(rates) if rate.coordinate == i]
        seen = [_Rows(0, 1.0, valid)]
        if own:
            blocks: list[_Block] = [(rows, y)]
            for k in own:
                values_k = np.concatenate(rates[k].values)
                there = np.isfinite(values_k)
                blocks.append((sp.csr_array(derivatives[rates[k].derivative][there]), values_k[there]))
                seen.append(_Rows(rates[k].derivative, 1.0, there))
            result, ratios = _smooth_together(blocks, roughness, grid, kappa, result)
            rate_std[own] = result[1] / ratios
            seen[1:] = [replace(kind, scale=float(c)) for kind, c in zip(seen[1:], ratios, strict=True)]
        kinds.append(tuple(seen))
        results.append(result)
    points = np.stack([one[0] for one in results], axis=1)
    noise, chosen = [one[1] for one in results], [one[2] for one in results]
    return Smooth(grid, points, np.array(noise), np.array(chosen), rate_std, times, tuple(kinds))


def _smooth_together(
    blocks: Sequence[_Block], penalty: np.ndarray, grid: SplineGrid, kappa: float | None, result: _One
) -> tuple[_One, np.ndarray]:
    """Smooth positions and rates of one coordinate, (design, samples) each, positions first.

    ``result`` is that of the positions alone. Returns what ``_smooth_one`` does, and the noise of the
    positions over that of each rate: the more likely of what is found from noise as the positions alone have
    it, and from rates that are nearly exact. Few positions can be interpolated, which the first would never
    give up.
    """
    alone = np.array([np.std(y - design @ result[0]) for design, y in blocks])
    spread = np.maximum([np.std(y) for _, y in blocks], alone) + 1e-300  # a dead sensor has no spread
    alone[0] = result[1]
    exact = spread * np.array([1.0] + [_NEARLY_EXACT] * (len(blocks) - 1))
    grams = [banded_gram(design, grid.degree) for design, _ in blocks]
    found = [
        _settle_noise(blocks, grams, penalty, grid, kappa, start, _SMALLEST * spread)
        for start in (alone, exact)
    ]
    return min(found, key=lambda f: f[0])[1:]


def _settle_noise(
    blocks: Sequence[_Block],
    grams: Sequence[np.ndarray],
    penalty: np.ndarray,
    grid: SplineGrid,
    kappa: float | None,
    start: np.ndarray,
    floors: np.ndarray,
) -> tuple[float, _One, np.ndarray]:
    """The fixed point from given noise; the criterion comes first, then as ``_smooth_together``."""
    noise, sizes = np.maximum(start, floors), np.array([y.size for _, y in blocks])
    rounds = 0
    while True:
        ratios = noise[0] / noise
        rows = sp.csr_array(sp.vstack([c * d for c, (d, _) in zip(ratios, blocks, strict=True)], "csr"))
        y = np.concatenate([c * y for c, (_, y) in zip(ratios, blocks, strict=True)])
        result = coefficients, sigma, chosen, factor = _smooth_one(rows, y, penalty, grid, kappa)
        whole = chosen * penalty + sum(c**2 * gram for c, gram in zip(ratios, grams, strict=True))
        new = np.empty_like(noise)
        for k, (design, samples) in enumerate(blocks):
            used = _slope(whole, ratios[k] ** 2 * grams[k])
            left = np.sum((samples - design @ coefficients) ** 2)
            new[k] = max(np.sqrt(left / max(samples.size - used, 1.0)), floors[k])
        change, noise = new / noise, new
        rounds += 1
        if rounds == _MOST_ROUNDS or np.all(np.abs(np.log(change / change[0])) < _SETTLED):
            break
    n_null = _PENALTY_DERIVATIVE * len(grid.spaces)
    score = 2.0 * (max(y.size - n_null, 1) * np.log(sigma + 1e-300) - sizes @ np.log(ratios))
    score += 2.0 * np.log(factor[0]).sum() - (grid.n_ctrl - n_null) * np.log(chosen)
    return score, result, ratios[1:]


def _slope(whole: np.ndarray, part: np.ndarray) -> float:
    """Derivative of log|H| in the logarithm of a factor of one of its parts: degrees of freedom used."""
    both: list[float] = []
    for factor in (np.expm1(_LOG_STEP), np.expm1(-_LOG_STEP)):
        moved: FloatArray = whole + factor * part
        moved[0] *= 1.0 + 1e-13
        both.append(2.0 * np.log(cholesky_banded(moved, lower=True, check_finite=False)[0]).sum())
    return float(0.5 * (both[0] - both[1]) / _LOG_STEP)


def _smooth_one(
    design: sp.csr_array, y: np.ndarray, penalty: np.ndarray, grid: SplineGrid, kappa: float | None = None
) -> _One:
    gram = banded_gram(design, grid.degree)
    moment = design.T @ y
    n_null = _PENALTY_DERIVATIVE * len(grid.spaces)
    unit = gram[0].sum() / penalty[0].sum()
    freedom = max(y.size - n_null, 1)

    def solve(log_kappa: float) -> tuple[float, np.ndarray, float, float, np.ndarray]:
        kappa = unit * 10.0**log_kappa
        factor = _factor(gram, kappa, penalty)
        coefficients = cho_solve_banded((factor, True), moment, check_finite=False)
        misfit = np.sum((y - design @ coefficients) ** 2)
        rough = penalty[0] @ coefficients**2
        for k in range(1, penalty.shape[0]):
            rough += 2.0 * penalty[k, :-k] @ (coefficients[:-k] * coefficients[k:])
        sigma2 = (misfit + kappa * max(rough, 0.0)) / freedom
        logdet = 2.0 * np.log(factor[0]).sum()
        score = freedom * np.log(sigma2 + 1e-300) + logdet - (grid.n_ctrl - n_null) * np.log(kappa)
        return score, coefficients, sigma2, kappa, factor

    def objective(log_kappa: float) -> float:
        try:
            return solve(log_kappa)[0]
        except np.linalg.LinAlgError:
            return np.inf

    if kappa is not None:
        _, coefficients, sigma2, chosen, factor = solve(np.log10(kappa / unit))
        return coefficients, float(np.sqrt(sigma2)), chosen, factor
    coarse = np.linspace(-12.0, 4.0, 9)
    scores = [objective(c) for c in coarse]
    best = coarse[int(np.argmin(scores))]
    found = minimize_scalar(
        objective, bounds=(best - 2.0, best + 2.0), method="bounded", options={"xatol": 0.05}
    )
    _, coefficients, sigma2, chosen, factor = solve(found.x if found.fun <= min(scores) else best)
    return coefficients, float(np.sqrt(sigma2)), chosen, factor
