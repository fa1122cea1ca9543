"""Writes a law of `laws.py` down: what moves, from where, and what the user of a discovery knows of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leastaction import systems

__all__ = ["law"]

Range = tuple[float, float]


@dataclass(frozen=True)
class _Draw:
    low: tuple[float, ...]
    high: tuple[float, ...]

    def __call__(self, rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(self.low, self.high)


@dataclass(frozen=True)
class _Push:
    """Two sines a coordinate, each 0.3 to 0.7 of the amplitude, 1 to 5 rad/s."""

    amplitudes: tuple[float, ...]

    def __call__(self, rng: np.random.Generator):
        shape = (2, len(self.amplitudes))
        size = np.array(self.amplitudes) * rng.uniform(0.3, 0.7, shape)
        rate, phase = rng.uniform(1.0, 5.0, shape), rng.uniform(0.0, 2.0 * np.pi, shape)
        return lambda t: (size * np.sin(rate * np.asarray(t, float)[..., None, None] + phase)).sum(axis=-2)


@dataclass(frozen=True)
class _Within:
    bounds: tuple[Range | None, ...]

    def __call__(self, q: np.ndarray) -> bool:
        inside = (
            b is None or (b[0] < x.min() and x.max() < b[1]) for b, x in zip(self.bounds, q.T, strict=True)
        )
        return bool(np.isfinite(q).all()) and all(inside)


@dataclass(frozen=True)
class _Start:
    q: _Draw
    qdot: _Draw

    def __call__(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return self.q(rng), self.qdot(rng)


def _draw(ranges: Sequence[Range]) -> _Draw:
    low, high = zip(*ranges, strict=True)
    return _Draw(low, high)


def law(
    name: str,
    title: str,
    coordinates: Sequence[str],
    lagrangian: Mapping[str, float],
    *,
    start: Sequence[Range],
    rates: Sequence[Range],
    within: Sequence[Range | None],
    angles: Sequence[str] = (),
    push: Sequence[float] = (),
    friction: float = 0.0,
) -> systems.MechanicalSystem:
    """Return a law as a system.

    Parameters
    ----------
    lagrangian
        Term → coefficient.  Without a push the first one, a kinetic term, is known.
    start, rates
        Ranges of the initial coordinates and velocities.
    within
        What a motion keeps within to be taken; None leaves a coordinate free.
    push
        Amplitudes of the known forces; none: a passive system.
    friction
        Coefficient of viscous friction, the same for every coordinate.
    """
    known = {} if push else dict([next(iter(lagrangian.items()))])
    return systems.MechanicalSystem(
        name=name,
        title=title,
        coordinates=tuple(coordinates),
        angles=tuple(angles),
        lagrangian=dict(lagrangian),
        known=known,
        dissipation={f"{c}_dot**2/2": friction for c in coordinates} if friction else {},
        library=(),
        initial=_Start(_draw(start), _draw(rates)),
        forcing=_Push(tuple(push)) if push else None,
        accept=_Within(tuple(within)),
    )
