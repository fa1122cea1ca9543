"""Draws of initial conditions and of known forcing, and acceptance rules, as small picklable objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Uniform:
    """Initial conditions uniform in a box; ``q`` and ``qdot`` hold one (low, high) per coordinate.

    Coordinates in ``mirrored`` (indices) get a rate of random sign, so that a range away from zero
    covers both senses of rotation.
    """

    q: tuple[tuple[float, float], ...]
    qdot: tuple[tuple[float, float], ...]
    mirrored: tuple[int, ...] = ()

    def __call__(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        q0 = rng.uniform(*np.transpose(self.q))
        qdot0 = rng.uniform(*np.transpose(self.qdot))
        for i in self.mirrored:
            qdot0[i] *= rng.choice((-1.0, 1.0))
        return q0, qdot0


@dataclass(frozen=True)
class Within:
    """Takes a motion if every coordinate stays strictly inside its (low, high); ``None`` leaves it free."""

    bounds: tuple[tuple[float, float] | None, ...]

    def __call__(self, q: np.ndarray) -> bool:
        if not np.isfinite(q).all():
            return False
        return all(
            bound is None or (q[:, i].min() > bound[0] and q[:, i].max() < bound[1])
            for i, bound in enumerate(self.bounds)
        )


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
    """Draws the known forcing of one motion: two sines a coordinate whose amplitudes add up to about `total`.

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
