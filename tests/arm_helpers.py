"""Arms to identify, and logs of them."""

from __future__ import annotations

import numpy as np

import leastaction as la
from leastaction import arms

PI = np.pi
WRIST = arms.KinematicTree.from_dh(
    [{"d": 0.3}, {"alpha": -PI / 2, "a": 0.05}, {"a": 0.25, "alpha": PI / 2}], modified=True
)
SEVEN = arms.KinematicTree.from_dh(
    [
        {"d": 0.34},
        {"alpha": -PI / 2},
        {"alpha": PI / 2, "d": 0.4},
        {"alpha": PI / 2},
        {"alpha": -PI / 2, "d": 0.4},
        {"alpha": -PI / 2},
        {"alpha": PI / 2, "d": 0.126},
    ],
    modified=True,
)


def bodies(n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 10) inertial parameters of ellipsoids, lighter towards the hand."""
    out = []
    for k in range(n):
        mass, centre = 4.0 * 0.72**k * rng.uniform(0.8, 1.2), rng.normal(0.0, 0.05, 3)
        turn, size = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.uniform(0.04, 0.1, 3)
        second = mass * (turn @ np.diag(size**2) @ turn.T + np.outer(centre, centre))
        inertia = np.trace(second) * np.eye(3) - second
        out.append([mass, *(mass * centre), *inertia[np.triu_indices(3)]])
    return np.array(out)


def motion(n: int, duration: float, rate: float, rng: np.random.Generator) -> list[np.ndarray]:
    """Times and a sum of sines with its derivatives."""
    t = np.arange(0.0, duration, 1.0 / rate)
    out = np.zeros((3, t.size, n))
    for j in range(n):
        for k in range(1, 9):
            (a, b), w = rng.normal(0.0, 0.5 / np.sqrt(k) / (1.0 + 0.15 * k), 2), 2.0 * PI * 0.15 * k
            wave, slope = a * np.sin(w * t) + b * np.cos(w * t), w * (a * np.cos(w * t) - b * np.sin(w * t))
            out[:, :, j] += wave, slope, -(w**2) * wave
    return [t, *out]


def recorded(
    model: arms.ArmModel,
    rng: np.random.Generator,
    duration: float = 10.0,
    rate: float = 250.0,
    noise: float = 0.02,
) -> la.Trajectory:
    """A log of the model: encoder steps, noisy torques."""
    t, *states = motion(len(model.tree), duration, rate, rng)
    torques = model.torques(*states, successive=True)
    torques += noise * torques.std(axis=0) * rng.normal(size=torques.shape)
    step = 2.0 * PI / 2**18
    return la.Trajectory(t, np.rint(states[0] / step) * step, torques, model.coordinates)


def truth(tree: arms.KinematicTree, rng: np.random.Generator, **joints: list[float]) -> arms.ArmModel:
    return arms.ArmModel.of_tree(tree.with_inertias(bodies(len(tree), rng)), joints, distance=2e-3)
