"""Laws that no generated library holds, and their exact motions.

d/dt ∂L/∂q̇ − ∂L/∂q = f − ∂ψ/∂q̇ is integrated by SciPy's DOP853 to a relative error of 10⁻¹⁰; nothing of the
package that fits takes part.  Half of the laws are driven by known forces, half are free and one coefficient
is known; a third has viscous friction.

Every second law in alphabetical order is kept aside: no rule is made, tuned or looked at on it, so that a
rule made on the others can be judged on these.  The split was written down before there was any result.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp

import leastaction as la
from leastaction import systems
from studies import _laws

__all__ = ["KEPT_ASIDE", "LAWS", "error_of_acceleration", "motions"]

LAWS = {law.name: law for law in sorted(_laws.LAWS, key=lambda law: law.name)}
KEPT_ASIDE = frozenset(tuple(LAWS)[1::2])

_DRAWS = 100


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
