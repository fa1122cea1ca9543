"""Writes a law down, integrates its motions exactly, and says how far a model is off.

d/dt ∂L/∂q̇ − ∂L/∂q = f − ∂ψ/∂q̇ is integrated by SciPy's DOP853 to a relative error of 10⁻¹⁰; nothing of the
package that fits takes part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

import leastaction as la
from leastaction import systems

__all__ = ["error_of_acceleration", "law", "left_by", "motions"]

Range = tuple[float, float]
_DRAWS = 100  # of starts and forces, until a motion keeps within its bounds


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


def motions(
    law: systems.MechanicalSystem, trajectories: int, duration: float, rate: float, seed: int
) -> tuple[systems.TrueMotion, ...]:
    """Return exact motions; the first of five is the one that ``trajectories=1`` gives."""
    t = np.arange(round(duration * rate) + 1) / rate
    streams = (np.random.SeedSequence((seed, k, 19)).spawn(2) for k in range(trajectories))
    return tuple(_motion(law, t, *map(np.random.default_rng, pair)) for pair in streams)


def _motion(law, t: np.ndarray, starts: np.random.Generator, pushes: np.random.Generator):
    """Draw starts and forces until a motion keeps within its bounds."""
    for _ in range(_DRAWS):
        drive = None if law.forcing is None else law.forcing(pushes)
        states = _integrated(law, t, np.concatenate(law.initial(starts)), drive)
        if states is None:
            continue
        q, qdot = states[:, : law.n_dof], states[:, law.n_dof :]
        if law.accept(q):
            forces = None if drive is None else drive(t)
            return systems.TrueMotion(t, q, qdot, law.acceleration(q, qdot, forces), forces, drive)
    raise RuntimeError(f"no motion of {law.name} keeps within its bounds in {_DRAWS} draws")


def _integrated(law, t: np.ndarray, start: np.ndarray, drive) -> np.ndarray | None:
    n = law.n_dof

    def rates(time: float, state: np.ndarray) -> np.ndarray:
        push = None if drive is None else drive(time)
        return np.concatenate([state[n:], law.acceleration(state[:n], state[n:], push)])

    with np.errstate(all="ignore"):
        try:
            found = solve_ivp(rates, t[[0, -1]], start, "DOP853", t, rtol=1e-10, atol=1e-12)
        except (ValueError, np.linalg.LinAlgError):  # a step out of the range of the law
            return None
    return found.y.T if found.success else None


def error_of_acceleration(
    law: systems.MechanicalSystem, model: la.LagrangianModel, truth: Sequence[systems.TrueMotion]
) -> list[float]:
    """Return rms(q̈ of the model − q̈)/rms(q̈) of each coordinate, at the exact states of the recordings."""
    q, qdot, qddot = (np.concatenate([getattr(m, name) for m in truth]) for name in ("q", "qdot", "qddot"))
    forces = np.concatenate([m.forces for m in truth]) if law.forcing is not None else None
    with np.errstate(all="ignore"):
        try:
            off = model.acceleration(q, qdot, forces) - qddot
        except np.linalg.LinAlgError:  # the mass matrix of the model is singular
            return [float("inf")] * law.n_dof
        share = np.sqrt(np.mean(off**2, axis=0) / np.mean(qddot**2, axis=0))
    return [float(x) if np.isfinite(x) else float("inf") for x in share]


def left_by(law: systems.MechanicalSystem, library: la.Library, points: int = 800) -> float:
    """Return the share of M q̈ that no coefficients of a library explain, without noise.

    Least squares of the Euler–Lagrange equations at positions, velocities and forces that motions come by,
    each drawn by itself.  A library that holds the law leaves rounding only.
    """
    truth = motions(law, 3, 5.0, 100.0, seed=1000)
    rng = np.random.default_rng(0)

    def drawn(name: str) -> np.ndarray:
        return rng.permutation(np.concatenate([getattr(m, name) for m in truth]))[:points]

    q, qdot = drawn("q"), drawn("qdot")
    forces = drawn("forces") if law.forcing is not None else np.zeros_like(q)
    qddot = law.acceleration(q, qdot, forces)
    inertia = np.einsum("nij,nj->ni", law.mass_matrix(q, qdot), qddot)
    size = np.sqrt(np.mean(inertia**2, axis=0))
    columns = (la.euler_lagrange(library, q, qdot, qddot) / size[:, None]).reshape(points * law.n_dof, -1)
    known = [library.index(text) for text in law.known]
    target = (forces / size).ravel() - columns[:, known] @ np.array(list(law.known.values()))
    columns = np.delete(columns, known, axis=1)
    columns = columns[:, np.isfinite(columns).all(axis=0)]  # log(x) where x is negative
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    best, *_ = np.linalg.lstsq(columns, target, rcond=1e-11)
    return float(np.sqrt(np.mean((target - columns @ best) ** 2)))
