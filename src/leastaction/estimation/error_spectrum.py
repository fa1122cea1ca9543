"""How the error of the equations is distributed over frequencies.

The fit takes the equation errors e_i as white, of density 1/w_i.  What a missing term, late forces or
friction leave is slow, and what belts and gears add is fast: a forecast integrates the slow part.  With the
residual r_i along the fitted curve, the density of a band b of frequencies is what one step of
expectation-maximisation from the white error makes of it,

    S_i(b) = Σ_b |r_i(f)|² / Σ_b (1 − h_i(f)) + (1 − η_i(b)) / w_i,        η_i = (1/w_i) / (1/w_i + N_i),

r_i(f) the Fourier transform of the tapered residual of a trial over the root of its duration.  Free
coefficients take the share h_i(f) from it, the leverage of their columns.  The share 1 − η_i is hidden by the
noise of the samples, whose density in the equation is N_i(f) = Σ_j M_ij² (2π f)⁴ σ_j² Δ_j.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.simulation.law import Spectrum

__all__ = ["error_spectrum"]

_LONGEST = 4096  # knot intervals of a transform
_RATIO = 1.4  # of the ends of a band, at least
_FEWEST = 8  # numbers that a density comes from: its standard error is half of it
_LEAST = 0.1  # share of a band that the coefficients leave, at least
_POINTS = 500  # along the curve, for the mass matrix


def error_spectrum(fit: Fit) -> Spectrum:
    """Spectral density of the equation errors of a fit; zero where a coordinate has no equation.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    Spectrum
        Above the frequencies that the knots can follow it is that of the fit, 1/w; at all frequencies if the
        residual is not finite.
    """
    weights, prescribed = fit.weights.physics, list(fit.problem.prescribed)
    white = np.divide(1.0, weights, out=np.zeros(weights.size), where=weights > 0.0)
    white[prescribed] = 0.0
    edges = _bands([np.fft.rfftfreq(chunk.stop - chunk.start, step) for chunk, step in _stretches(fit)])
    if edges[-1] == 0.0:  # a single interval of knots has no spectrum
        return Spectrum.white(white)
    share = _visible(fit, white, edges)
    left, squares = _powers(fit, edges, share)
    if not (np.isfinite(left).all() and np.isfinite(squares).all()):
        return Spectrum.white(white)
    density = squares / left + (1.0 - share[:-1]) * white
    density[:, prescribed] = 0.0
    return Spectrum(edges, np.concatenate([density, white[None]]))


def _stretches(fit: Fit) -> Iterator[tuple[slice, float]]:
    """Parts of the trials that are transformed by themselves: knot intervals and the time between them."""
    begin = 0
    for space in fit.grid.spline.spaces:
        step = float(np.diff(space.breakpoints[:2])[0])
        pieces = -(-space.n_intervals // _LONGEST)
        for part in np.array_split(np.arange(begin, begin + space.n_intervals), pieces):
            yield slice(int(part[0]), int(part[-1]) + 1), step
        begin += space.n_intervals


def _transforms(fit: Fit) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Frequencies, and the scaled transforms of residual (n_freq, n_dof) and of the free columns.

    Their squares, summed over frequencies of either sign, are the integrals over the time. They take ten
    times the memory of the samples, and are therefore computed anew for each sum over the trials.
    """
    for chunk, step in _stretches(fit):
        _, columns, residual = fit.equations(chunk)
        size: int = columns.shape[-1]
        both = np.concatenate([residual[None], columns[: len(fit.structure)]])
        taper = np.sqrt(2.0) * np.sin(np.pi * (np.arange(size) + 0.5) / size)
        values = np.fft.rfft(both * taper, axis=-1) * np.sqrt(step / size)
        values[..., 1 : (size + 1) // 2] *= np.sqrt(2.0)  # for those of the other sign
        yield np.fft.rfftfreq(size, step), values[0].T, np.moveaxis(values[1:], -1, 0)


def _bands(frequencies: list[np.ndarray]) -> np.ndarray:
    """Lower ends of the bands, and the highest frequency; each band has some transforms at least."""
    highest = min(f[-1] for f in frequencies)
    every, counts = np.unique(np.concatenate(frequencies), return_counts=True)
    numbers = counts * np.where(every > 0.0, 2, 1)
    ends, inside = [0.0], 0
    middles = 0.5 * (every[:-1] + every[1:])
    below = np.flatnonzero(every[:-1] < highest)  # what lies at the highest frequency is in no band
    for middle, more in zip(middles[below], numbers[below], strict=True):
        inside += int(more)
        if inside >= _FEWEST and _RATIO * ends[-1] <= middle < highest:
            ends.append(float(middle))
            inside = 0
    if inside < _FEWEST and len(ends) > 1:
        ends.pop()
    return np.array([*ends, highest])


def _visible(fit: Fit, white: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(n_bands + 1, n_dof) share of the error in the middle of a band that samples show; none beyond."""
    data = fit.problem.trajectories
    physics, index = fit.grid.physics(fit.structure)
    mass = physics.columns.mass_matrix(fit.points(_POINTS), fit.coefficients[index])
    interval = fit.grid.spline.duration / np.maximum(fit.grid.observations.counts[: data.n_dof], 1)
    noise = np.where(np.isnan(fit.position_std), np.inf, fit.position_std) ** 2 * interval
    square = np.mean(
        mass**2, axis=0
    )  # a coordinate that does not act has a share of zero, even if it is hidden
    noise = np.multiply(square, noise, out=np.zeros_like(square), where=square > 0.0).sum(axis=1)
    middle = 0.5 * (edges[:-1] + edges[1:])
    hidden = (2.0 * np.pi * middle[:, None]) ** 4 * noise
    share = np.where(white > 0.0, white / np.maximum(white + hidden, 1e-300), 0.0)
    return np.concatenate([share, np.zeros((1, white.size))])


@np.errstate(over="ignore", invalid="ignore")
def _powers(fit: Fit, edges: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each band and equation the numbers that coefficients leave, and the squares of the residual."""
    weights, n_bands = fit.weights.physics, len(edges) - 1

    def transforms() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        for f, residual, columns in _transforms(fit):
            band = np.minimum(np.searchsorted(edges, f, "right") - 1, n_bands)
            yield f, band, residual, columns * np.sqrt(weights * share[band])[:, None, :]

    normal = np.zeros((len(fit.structure), len(fit.structure)))
    for *_, x in transforms():
        normal += np.einsum("fmi,fni->mn", x.conj(), x).real
    inverse = np.linalg.pinv(np.nan_to_num(normal, posinf=0.0), rcond=1e-12, hermitian=True)
    counts, left, squares = (np.zeros((n_bands + 1, weights.size)) for _ in range(3))
    for f, band, residual, x in transforms():
        leverage = np.einsum("fmi,mn,fni->fi", x.conj(), inverse, x).real
        numbers = np.where(f > 0.0, 2.0, 1.0)[:, None]
        np.add.at(counts, band, np.broadcast_to(numbers, residual.shape))
        np.add.at(left, band, numbers - leverage)
        np.add.at(squares, band, np.abs(residual) ** 2)
    return np.maximum(left, _LEAST * counts)[:-1], squares[:-1]
