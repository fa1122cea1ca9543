"""Comparison of an arm with another log: torques predicted from angles, angles simulated from torques.

Free runs integrate M(q) q̈ = τ − h(q, q̇) under the measured torques.  Dry friction that follows the sign of
the velocity makes these equations stiff.  Each step is therefore implicit in the friction (W-method of order
two: Verwer, Spee, Blom & Hundsdorfer 1999, SIAM Journal on Scientific Computing 20:1456).  Friction that
reverses over a distance δ has a state z of its own, with dz/dt = |q̇| (sgn q̇ − z)/δ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import butter, sosfiltfilt

from leastaction.data.trajectories import Trajectories
from leastaction.errors import DataError, InputError
from leastaction.mechanics.arm_columns import presliding

if TYPE_CHECKING:
    from leastaction.arms.model import ArmModel

__all__ = ["BANDS", "SHORTEST", "FreeRuns", "TorqueErrors", "TorqueRun", "free_runs", "torque_errors"]

BANDS = (5.0, 10.0)
"""Cut-off frequencies of comparisons, in Hz."""
_TRIM = 0.3  # s at each end, where filters and splines lack data on one side
SHORTEST = 4.0 * _TRIM
"""Duration in s above which the torques of a run are compared."""
_STEP = 1e-3  # s, the longest step of a free run
_GAMMA = 1.0 - np.sqrt(0.5)  # makes the W-method L-stable


@dataclass(frozen=True, eq=False)
class TorqueRun:
    """Torques along one run of a log.

    Attributes
    ----------
    name : str
    t : (n_times,) array
    q, qdot, qddot : (n_times, n_dof) arrays
        The smoothed motion.
    predicted, measured : (n_times, n_dof) arrays
        Torques from the motion, and those of the log, on time and in N m (N); NaN where it holds none.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    predicted: np.ndarray
    measured: np.ndarray


@dataclass(frozen=True)
class TorqueErrors:
    """Errors of predicted torques.

    Attributes
    ----------
    coordinates : tuple of str
    bands : tuple of float or None
        Cut-off frequency of the filter of measured and predicted torques, in Hz; None: unfiltered.
    rms : (n_bands, n_dof) array
        Root mean square of the error; NaN for a joint without a measured torque.
    torque_rms, torque_std : (n_bands, n_dof) arrays
        Root mean square and standard deviation of the measured torque.
    """

    coordinates: tuple[str, ...]
    bands: tuple[float | None, ...]
    rms: np.ndarray
    torque_rms: np.ndarray
    torque_std: np.ndarray

    @property
    def by_joint(self) -> np.ndarray:
        """(n_bands, n_dof) error relative to the torque of the joint, both as root mean squares."""
        return self.rms / np.maximum(self.torque_rms, 1e-300)

    @property
    def overall(self) -> np.ndarray:
        """(n_bands,) error relative to the torque, both as root mean squares over all measured joints."""
        return _length(self.rms) / _length(self.torque_rms)

    @property
    def of_spread(self) -> np.ndarray:
        """(n_bands,) error relative to the standard deviation of the torques."""
        return _length(self.rms) / _length(self.torque_std)

    def __str__(self) -> str:
        width = max(8, *map(len, self.coordinates)) + 1
        lines = ["error of torques  " + "".join(f"{name:>{width}}" for name in (*self.coordinates, "all"))]
        for band, each, every in zip(self.bands, self.by_joint, self.overall, strict=True):
            label = "all frequencies" if band is None else f"below {band:g} Hz"
            texts = ("–" if np.isnan(x) else f"{100 * x:.2f} %" for x in (*each, every))
            lines.append(f"{label:18}" + "".join(f"{text:>{width}}" for text in texts))
        return "\n".join(lines)


def _length(rows: np.ndarray) -> np.ndarray:
    """Norm of each row, without missing values."""
    return np.sqrt(np.nansum(rows**2, axis=1))


def torque_errors(
    coordinates: tuple[str, ...], runs: Sequence[TorqueRun], bands: Sequence[float] = BANDS
) -> TorqueErrors:
    """Compare predicted and measured torques of several runs.

    Raises
    ------
    DataError
        If a run is too short.
    """
    frequencies = (*bands, None)
    sums, count = np.zeros((3, len(frequencies), len(coordinates))), 0
    for run in runs:
        t = run.t
        if t[-1] - t[0] <= SHORTEST:
            raise DataError(f"a run lasts {t[-1] - t[0]:.3g} s; comparing torques needs {SHORTEST:g} s")
        step = float(np.median(np.diff(t)))
        times = np.arange(t[0], t[-1], step)
        ours, theirs = (_at(times, t, values) for values in (run.predicted, run.measured))
        inside = (times > times[0] + _TRIM) & (times < times[-1] - _TRIM)
        count += int(inside.sum())
        for row, band in enumerate(frequencies):
            a, b = ours, theirs
            if band is not None:
                low = butter(4, min(2.0 * band * step, 0.99), output="sos")
                a, b = sosfiltfilt(low, ours, axis=0), sosfiltfilt(low, theirs, axis=0)
            a, b = a[inside], b[inside]
            sums[:, row] += np.sum((a - b) ** 2, axis=0), np.sum(b**2, axis=0), np.sum(b, axis=0)
    error, size, mean = sums / count
    spread = np.sqrt(np.maximum(size - mean**2, 0.0))
    return TorqueErrors(coordinates, frequencies, np.sqrt(error), np.sqrt(size), spread)


def _at(times: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values interpolated between the samples of a run."""
    out = np.empty((times.size, values.shape[1]))
    for k, column in enumerate(values.T):
        out[:, k] = np.interp(times, t, column)
    return out


@dataclass(frozen=True)
class FreeRuns:
    """Errors of simulated angles.

    Attributes
    ----------
    coordinates : tuple of str
    horizon : float
        Length of a run in s.
    rms : (n_runs, n_dof) array
        Root mean square of the error of each run, in rad or m; not finite where the run diverges.

    Examples
    --------
    A pendulum under the torque of its own inverse dynamics:

    >>> import numpy as np
    >>> import leastaction as la
    >>> from leastaction import arms
    >>> tree = arms.KinematicTree.from_dh([{}], modified=True, gravity=(9.81, 0.0, 0.0))
    >>> rod = tree.with_inertias([[1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1 / 3, 0.0, 1 / 3]])
    >>> model = arms.ArmModel.of_tree(rod, {"viscous": [0.1]})
    >>> t = np.arange(0.0, 0.8, 0.002)
    >>> q, qdot, qddot = np.sin(5.0 * t), 5.0 * np.cos(5.0 * t), -25.0 * np.sin(5.0 * t)
    >>> torques = model.torques(q[:, None], qdot[:, None], qddot[:, None])
    >>> runs = model.free_runs(la.Trajectory(t, q, torques, ("q1",)), horizon=0.05)
    >>> runs.rms.shape, bool(runs.by_joint.max() < 1e-5)
    ((3, 1), True)
    """

    coordinates: tuple[str, ...]
    horizon: float
    rms: np.ndarray

    @property
    def by_joint(self) -> np.ndarray:
        """(n_dof,) root mean squares over all runs."""
        return np.sqrt(np.mean(self.rms**2, axis=0))

    def __str__(self) -> str:
        kept = self.rms[np.isfinite(self.rms).all(axis=1)]
        lost, runs = len(self.rms) - len(kept), f"free runs of {self.horizon:g} s"
        if not len(kept):
            return f"all {lost} {runs} diverge"
        errors = replace(self, rms=kept).by_joint
        parts = ", ".join(f"{n} {1e3 * x:.3g}" for n, x in zip(self.coordinates, errors, strict=True))
        more = f"; {lost} more diverge" if lost else ""
        return f"error of {len(kept)} {runs}, in mrad or mm: {parts}{more}"


def free_runs(
    model: ArmModel, data: Trajectories, smoothed: Sequence[Sequence[np.ndarray]], horizon: float
) -> FreeRuns:
    """Simulate the pieces of a log, all at once.

    Parameters
    ----------
    data : Trajectories
        With torques.
    smoothed : sequence
        q, q̇ and q̈ of each run, (n_times, n_dof) each.
    horizon : float
        Length of a piece in s.

    Raises
    ------
    InputError, DataError
        If the horizon is not positive, every run is shorter, or torques were not measured.
    """
    if model.facts.unmeasured:
        raise InputError(
            f"free runs need the torques of all joints, but {', '.join(model.facts.unmeasured)} had none in "
            "the fitted log; compare torques instead (validate)"
        )
    if not (np.isfinite(horizon) and horizon > 0.0):
        raise InputError(f"horizon is {horizon}; give the length of a free run in s, such as 0.5")
    most = min(_STEP, data.sampling_interval)
    n_steps = int(np.ceil(horizon / most))
    step, n = horizon / n_steps, len(model.tree)
    distance = np.zeros(n)
    for term in model.terms:
        if term.kind == "dry":
            distance[term.place] = term.distance
    starts: list[np.ndarray] = []
    torques: list[np.ndarray] = []
    measured: list[np.ndarray] = []
    for run, (q, qdot, _) in zip(data, smoothed, strict=True):
        assert run.forces is not None
        way = np.stack(
            [presliding(c, d)[0] if d else np.zeros_like(c) for c, d in zip(q.T, distance, strict=True)],
            axis=1,
        )
        states = np.hstack([q, qdot, way])
        begin = np.arange(run.t[0] + _TRIM, run.t[-1] - _TRIM - horizon, horizon)
        for start in begin.tolist():
            times = start + step * np.arange(n_steps + 1)
            starts.append(_at(times[:1], run.t, states)[0])
            torques.append(_at(times, run.t, run.forces))
            measured.append(_at(times, run.t, q))
    if not starts:
        raise DataError(
            f"no run is longer than {horizon + 2.0 * _TRIM:g} s, as free runs of {horizon:g} s need"
        )
    simulated = _simulated(model, np.array(starts), np.array(torques).transpose(1, 0, 2), step, distance)
    with np.errstate(over="ignore", invalid="ignore"):  # of runs that diverge
        error = simulated - np.array(measured).transpose(1, 0, 2)
        return FreeRuns(model.coordinates, horizon, np.sqrt(np.mean(error**2, axis=0)))


@np.errstate(all="ignore")  # a run may diverge
def _simulated(
    model: ArmModel, states: np.ndarray, torques: np.ndarray, step: float, distance: np.ndarray
) -> np.ndarray:
    """(n_steps + 1, n_runs, n_dof) coordinates."""
    n = states.shape[1] // 3
    q, v, z = states[:, :n], states[:, n : 2 * n], states[:, 2 * n :]
    turning = distance > 0.0
    per_length = np.where(turning, 1.0 / np.where(turning, distance, 1.0), 0.0)
    dry, damping, width, own = np.zeros(n), np.zeros((2, n)), np.ones(n), np.ones(n)
    for term, value in zip(model.terms, model.coefficients.tolist(), strict=True):
        if term.kind == "dry" and term.distance:
            dry[term.place], own[term.place] = value, term.width
        elif term.kind in ("dry", "stribeck", "viscous"):
            damping[int(term.kind == "viscous"), term.place] += abs(value)
            width[term.place] = term.width or 1.0

    def accelerations(q: np.ndarray, v: np.ndarray, z: np.ndarray, torque: np.ndarray) -> np.ndarray:
        # friction with a state z replaces that of the model, which follows the sign of the velocity
        sign = v / np.sqrt(v * v + own**2)
        return model.acceleration(q, v, torque + np.where(turning, dry * (sign - z), 0.0))

    out = [q]
    for k in range(len(torques) - 1):
        slope = damping[0] * width**2 / (v * v + width**2) ** 1.5 + damping[1]
        inverse: np.ndarray = np.linalg.inv(model.mass_matrix(q))
        system: np.ndarray = np.eye(n) + _GAMMA * step * inverse * slope[:, None, :]
        solve: np.ndarray = np.linalg.inv(system)
        rigid = 1.0 / (1.0 + _GAMMA * step * np.abs(v) * per_length)
        a1 = np.einsum("rij,rj->ri", solve, accelerations(q, v, z, torques[k]))
        s1 = rigid * per_length * np.abs(v) * (np.sign(v) - z)
        v1, z1 = v + step * a1, z + step * s1
        a2 = accelerations(q + step * v, v1, z1, torques[k + 1]) - 2.0 * a1
        s2 = rigid * (per_length * np.abs(v1) * (np.sign(v1) - z1) - 2.0 * s1)
        q = q + step * (0.5 * v + 0.5 * v1)
        v = v + step * (1.5 * a1 + 0.5 * np.einsum("rij,rj->ri", solve, a2))
        z = np.clip(z + step * (1.5 * s1 + 0.5 * s2), -1.0, 1.0)
        out.append(q)
    return np.array(out)
