"""Motions of the systems: exact ones, and noisy recordings of them.

Initial conditions, forcing, noise, missing samples and sampling times come from streams of their own, one
set for every trajectory. So, for one seed, all noise levels share the same motions, and the first of five
trajectories is the one that ``trials=1`` gives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly

from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.simulation.integrate import rk4
from leastaction.systems._registry import is_default, resolve
from leastaction.systems._system import Forces, MechanicalSystem

# Largest RK4 step and largest interval between kept states, in seconds (see tests/systems/).
_STEP = 0.00125
_INTERVAL = 0.01
_DRAWS = 600


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """An exact motion: t (n_times,); q, qdot, qddot, forces (n_times, n_dof); forces None if passive.

    ``drive`` is the forcing as a function of time, times of shape (m,) -> (m, n_dof).
    """

    t: np.ndarray
    q: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    forces: np.ndarray | None = None
    drive: Forces | None = None


def _streams(seed: int, trial: int) -> list[np.random.Generator]:
    """Return generators for the start, forcing, noise, missing samples and times of one trajectory."""
    return [np.random.default_rng(s) for s in np.random.SeedSequence((int(seed), trial)).spawn(5)]


def simulate_truth(
    system: str | MechanicalSystem,
    trials: int = 5,
    duration: float = 20.0,
    rate: float = 100.0,
    seed: int = 0,
    irregular: bool = False,
) -> tuple[TrueMotion, ...]:
    """Integrate motions from random initial conditions under random forcing.

    Parameters
    ----------
    system : str or MechanicalSystem
    trials : int
        Number of trajectories.
    duration, rate : float
        Seconds, and samples a second; both ends are sampled, ``round(duration * rate) + 1`` times.
    seed : int
    irregular : bool
        Move each inner time by up to 0.4 sampling intervals either way.

    Returns
    -------
    tuple of TrueMotion

    Raises
    ------
    InputError
        If an argument is invalid, or the system accepts almost no motion of that duration.

    Examples
    --------
    >>> from leastaction import systems
    >>> (motion,) = systems.simulate_truth("magnetic_pendulum", trials=1, duration=0.1)
    >>> motion.q.shape, motion.forces is None
    ((11, 2), True)
    """
    if trials < 1 or int(trials) != trials:
        raise InputError(f"trials={trials!r}; expected a whole number of at least 1")
    if not (duration > 0 and rate > 0 and math.isfinite(duration * rate) and round(duration * rate) >= 1):
        raise InputError(f"duration={duration!r}, rate={rate!r}; expected positive numbers that give samples")
    system = resolve(system)
    if is_default(system):
        return _remembered(system, int(trials), duration, rate, int(seed), irregular)
    return _simulate_truth(system, int(trials), duration, rate, int(seed), irregular)


def _simulate_truth(system, trials, duration, rate, seed, irregular) -> tuple[TrueMotion, ...]:
    kept = math.ceil(1.0 / (rate * _INTERVAL) - 1e-9)
    n_intervals = round(duration * rate) * kept
    t = np.arange(n_intervals + 1) / (rate * kept)
    streams = [_streams(seed, i) for i in range(trials)]
    found = [_first_accepted(system, t, *own[:2]) for own in streams]
    return tuple(
        _sampled(system, t, motion, kept, own[4], irregular)
        for motion, own in zip(found, streams, strict=True)
    )


# A study of noise levels asks for the same motions again and again; their arrays are read-only.
_remembered = lru_cache(maxsize=8)(_simulate_truth)


def _first_accepted(system, t, starts, drives) -> tuple[np.ndarray, np.ndarray, Forces | None]:
    """Draw motions from the two streams until one is acceptable; its q, q̇ at `t`, and its drive."""
    substeps = math.ceil((t[1] - t[0]) / _STEP - 1e-9)
    for _ in range(_DRAWS):
        q, qdot = system.initial(starts)
        drive = None if system.forcing is None else system.forcing(drives)
        q, qdot = rk4(system.acceleration, q, qdot, t, substeps, drive, step=system.step)
        if system.accept(q):
            return q, qdot, drive
    raise InputError(
        f"no acceptable motion of {system.name} of {t[-1]:g} s in {_DRAWS} draws; take a shorter duration"
    )


def _sampled(system, t, motion, kept, rng, irregular) -> TrueMotion:
    q, qdot, drive = motion
    if irregular:
        forces = None if drive is None else drive(t)
        qddot = system.acceleration(q, qdot, forces)
        times = t[::kept].copy()
        times[1:-1] += rng.uniform(-0.4, 0.4, times.size - 2) * t[kept]
        # The quintic through q, q̇, q̈ errs by some 1e-11 on intervals of 10 ms.
        path = BPoly.from_derivatives(t, np.stack([q, qdot, qddot], axis=1))
        t, q, qdot = times, path(times), path(times, 1)
    else:
        t, q, qdot = t[::kept], q[::kept], qdot[::kept]
    forces = None if drive is None else drive(t)
    qddot = system.acceleration(q, qdot, forces)
    t, q, qdot, qddot = (_frozen(array) for array in (t, q, qdot, qddot))
    return TrueMotion(t, q, qdot, qddot, None if forces is None else _frozen(forces), drive)


def _frozen(array) -> np.ndarray:
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def noise_std(
    system: str | MechanicalSystem,
    truth: Sequence[TrueMotion],
    noise: float = 0.1,
    noise_convention: str = "relative",
) -> np.ndarray:
    """Return the standard deviation σ of the noise of each coordinate, shape (n_dof,).

    Parameters
    ----------
    system : str or MechanicalSystem
    truth : sequence of TrueMotion
    noise : float
        Level of the noise.
    noise_convention : {"relative", "absolute"}
        ``relative``: σᵢ = noise · std of coordinate i over all motions, angles first wrapped to (−π, π];
        ``absolute``: σᵢ = noise, in the unit of the coordinate.

    Examples
    --------
    >>> from leastaction import systems
    >>> truth = systems.simulate_truth("magnetic_pendulum", trials=1, duration=0.1)
    >>> systems.noise_std("magnetic_pendulum", truth, 0.02, "absolute")
    array([0.02, 0.02])
    """
    system = resolve(system)
    if not (noise >= 0 and math.isfinite(noise)):
        raise InputError(f"noise={noise!r}; expected a finite number of at least 0")
    if noise_convention == "absolute":
        return np.full(system.n_dof, float(noise))
    if noise_convention != "relative":
        raise InputError(f"noise_convention={noise_convention!r}; expected 'relative' or 'absolute'")
    q = np.concatenate([motion.q for motion in truth])
    for i, name in enumerate(system.coordinates):
        if name in system.angles:
            q[:, i] = np.pi - np.mod(np.pi - q[:, i], 2.0 * np.pi)
    return noise * q.std(axis=0)


def measure(
    system: str | MechanicalSystem,
    truth: Sequence[TrueMotion],
    noise_std: ArrayLike,
    seed: int = 0,
    missing: float = 0.0,
) -> Trajectories:
    """Return noisy recordings of exact motions.

    Parameters
    ----------
    system : str or MechanicalSystem
    truth : sequence of TrueMotion
    noise_std : float or array_like, shape (n_dof,)
        Standard deviation of the Gaussian noise of each coordinate.
    seed : int
    missing : float
        Fraction of the samples of each coordinate that become NaN, at random.

    Returns
    -------
    Trajectories
        Angles are not wrapped.

    Examples
    --------
    >>> from leastaction import systems
    >>> truth = systems.simulate_truth("magnetic_pendulum", trials=1, duration=0.1)
    >>> recording = systems.measure("magnetic_pendulum", truth, noise_std=0.0)[0]
    >>> bool((recording.q == truth[0].q).all())
    True
    """
    system = resolve(system)
    if not 0 <= missing < 1:
        raise InputError(f"missing={missing!r}; expected a fraction from 0 up to (not including) 1")
    recordings = []
    for i, motion in enumerate(truth):
        _, _, noise_rng, missing_rng, _ = _streams(seed, i)
        q = motion.q + np.asarray(noise_std) * noise_rng.standard_normal(motion.q.shape)
        lost = round(missing * len(q))
        for column in q.T:
            column[missing_rng.choice(len(q), size=lost, replace=False)] = np.nan
        name = f"{system.name}-{i}"
        recordings.append(
            Trajectory(motion.t, q, forces=motion.forces, coordinates=system.coordinates, name=name)
        )
    return Trajectories(recordings)


class SamplingOptions(TypedDict, total=False):
    """Missing samples and irregular times in the recordings of `generate`.

    Attributes
    ----------
    missing : float
        Fraction of the samples of each coordinate that are NaN, at random. Default 0.
    irregular : bool
        Move each inner time by up to 0.4 sampling intervals either way. Default False.
    """

    missing: float
    irregular: bool


def generate(
    name: str | MechanicalSystem,
    noise: float = 0.1,
    noise_convention: str = "relative",
    trials: int = 5,
    duration: float = 20.0,
    rate: float = 100.0,
    seed: int = 0,
    **sampling: Unpack[SamplingOptions],
) -> Trajectories:
    """Return noisy recordings of a system, reproducible by `seed`.

    This runs `simulate_truth`, `noise_std` and `measure`.

    Parameters
    ----------
    name : str or MechanicalSystem
        One of `names()` or `further_names()`.
    noise : float
        Noise level: times the standard deviation of each coordinate over all trajectories (``"relative"``;
        angles are wrapped to (−π, π] for it), or in the unit of the coordinate (``"absolute"``).
    noise_convention : {"relative", "absolute"}
    trials : int
        Number of trajectories, each with its own initial conditions and forcing.
    duration, rate : float
        Seconds, and samples a second; both ends are sampled.
    seed : int
        With the same seed, all noise levels, missing fractions and numbers of trajectories share the same
        motions.
    **sampling
        ``missing`` and ``irregular``, see `SamplingOptions`.

    Returns
    -------
    Trajectories
        Positions (angles are not wrapped), and the known forces for active systems.

    Raises
    ------
    InputError
        If there is no such system, or an argument is invalid.
    TypeError
        If there is no such option.

    Examples
    --------
    >>> from leastaction import systems
    >>> systems.generate("single_pendulum", noise=0.05, trials=2, duration=1.0)[0].q.shape
    (101, 1)
    """
    system = resolve(name)
    missing, irregular = sampling.pop("missing", 0.0), sampling.pop("irregular", False)
    if sampling:
        raise TypeError(f"unknown option {next(iter(sampling))!r}; expected 'missing' or 'irregular'")
    truth = simulate_truth(system, trials, duration, rate, seed, irregular)
    sigma = noise_std(system, truth, noise, noise_convention)
    return measure(system, truth, sigma, seed=seed, missing=missing)
