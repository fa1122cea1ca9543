"""Known forcing: a sum of two sines in each coordinate, with random frequencies and phases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Sines:
    """fᵢ(t) = Σⱼ amplitude[j, i] sin(frequency[j, i] t + phase[j, i]); arrays of shape (n_sines, n_dof)."""

    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def __call__(self, t) -> np.ndarray:
        """Return the forces at times of any shape, (..., n_dof)."""
        t = np.asarray(t, dtype=float)[..., None, None]
        return (self.amplitude * np.sin(self.frequency * t + self.phase)).sum(axis=-2)


@dataclass(frozen=True)
class TwoSines:
    """Draws the forcing of one motion: two sines a coordinate whose amplitudes add up to about `total`.

    Each amplitude is uniform in total·[0.3, 0.7], each frequency uniform in `band` (rad/s), each phase
    uniform on the circle.
    """

    total: tuple[float, ...]
    band: tuple[float, float] = (1.0, 5.0)

    def __call__(self, rng: np.random.Generator) -> Sines:
        shape = (2, len(self.total))
        return Sines(
            amplitude=np.array(self.total) * rng.uniform(0.3, 0.7, shape),
            frequency=rng.uniform(*self.band, shape),
            phase=rng.uniform(0.0, 2.0 * np.pi, shape),
        )
