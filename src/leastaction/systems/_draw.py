"""Draws of initial conditions and acceptance rules, as small picklable objects."""

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
