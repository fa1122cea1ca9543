"""Measurement noise that is not white Gaussian noise of one size: what real sensors add.

Each kind gets exact positions, shape (n_times, n_dof), the standard deviation σ of each coordinate's noise
and a generator, and returns noisy positions.  Forces are measured, too: some kinds add noise to them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.signal import lfilter

import leastaction as la
from leastaction import systems

__all__ = ["FORCE_KINDS", "KINDS", "measured"]

_COLOUR = 0.8  # correlation from sample to sample
_OUTLIERS, _OUTLIER_SIZE = 0.02, 10.0  # share, and size in standard deviations
_RATIO = 10.0  # of the noises of neighbouring coordinates

Noise = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


def _gaussian(q, sigma, rng):
    return q + sigma * rng.standard_normal(q.shape)


def _quantised(q, sigma, rng):
    """An encoder with step σ and no other noise: the error is σ/√12 where the motion crosses many steps."""
    return sigma * np.round(q / sigma)


def _outliers(q, sigma, rng):
    out = _gaussian(q, sigma, rng)
    hit = rng.random(q.shape) < _OUTLIERS
    return out + hit * _OUTLIER_SIZE * sigma * rng.choice((-1.0, 1.0), q.shape)


def _student(q, sigma, rng):
    """Student's t with three degrees of freedom, whose variance is 3."""
    return q + sigma / np.sqrt(3.0) * rng.standard_t(3, q.shape)


def _unequal(q, sigma, rng):
    """The first coordinate √10 times noisier, the next one √10 times less, and so on."""
    factor = np.sqrt(_RATIO) ** np.where(np.arange(q.shape[1]) % 2, -1.0, 1.0)
    return q + factor * sigma * rng.standard_normal(q.shape)


def _coloured(q, sigma, rng):
    """First-order autoregressive noise with the variance of the white one."""
    white = rng.standard_normal((200 + len(q), q.shape[1]))
    noise = lfilter([np.sqrt(1.0 - _COLOUR**2)], [1.0, -_COLOUR], white, axis=0)
    return q + sigma * noise[200:]


KINDS: dict[str, Noise] = {
    "gaussian": _gaussian,
    "quantised": _quantised,
    "outliers": _outliers,
    "student3": _student,
    "unequal": _unequal,
    "coloured": _coloured,
}

# White noise of the given forces beside that of the positions, relative to the rms of the forces.
FORCE_KINDS = {"forces 10 %": 0.1, "forces 30 %": 0.3, "forces 100 %": 1.0}


def measured(kind: str, truth: Sequence[systems.TrueMotion], sigma, coordinates, seed: int):
    """Return recordings of exact motions with noise of a kind, and the rms noise of each coordinate."""
    rngs = [np.random.default_rng(s) for s in np.random.SeedSequence((seed, 77)).spawn(len(truth))]
    noise = _gaussian if kind in FORCE_KINDS else KINDS[kind]
    noisy = [noise(m.q, sigma, rng) for m, rng in zip(truth, rngs, strict=True)]
    error = np.concatenate([q - m.q for q, m in zip(noisy, truth, strict=True)])
    recordings = [
        la.Trajectory(m.t, q, m.forces, coordinates, name=f"{k}")
        for k, (m, q) in enumerate(zip(truth, noisy, strict=True))
    ]
    data = la.Trajectories(recordings)
    if kind in FORCE_KINDS:
        size = FORCE_KINDS[kind] * np.sqrt(np.mean(np.concatenate([m.forces for m in truth]) ** 2, axis=0))
        pairs = zip(truth, rngs, strict=True)
        data = data.with_forces([m.forces + size * rng.standard_normal(m.q.shape) for m, rng in pairs])
    return data, np.sqrt(np.mean(error**2, axis=0))
