"""Checks of a robot's log (names, units, standstill, clock), errors of predicted torques, and notes.

Programs that poll a controller log the time of the poll, not that of the state. A state appears twice or is
missing, and time stamps scatter by a period or more.  If velocities are logged, positions give the true time
between two samples, Δt = Δq·v̄/v̄², and controllers tick at a constant rate.

Each note (a contact, currents in place of torques) compares an identified arm with its log or with the
inertias of the tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import DataError, InputError
from leastaction.library.tree import KinematicTree
from leastaction.mechanics import Points
from leastaction.mechanics.rigid_bodies import Motion, inverse_dynamics

__all__ = ["TorqueErrors", "contact_notes", "prepared", "scale_notes", "torque_errors"]

_TRIM = 0.3  # s at each end, where filters and splines lack data on one side
_FEWEST = 200  # samples
_MOST_TURNS = 12.0 * np.pi  # rad; a joint that spans more is in degrees
_BEYOND = 2.0  # a joint that spans more than this multiple of the range of its limits is in degrees
_STILL = 1e-3  # rad or m: a joint that spans less stands still
_SLOW = 0.02  # of the mean square velocity; in slower motion, positions do not determine the time
_AGREES = 0.02  # of a tick: if half of the time stamps scatter by less, they are kept
_ON_TICK = 0.1  # of a tick: half of the samples must be nearer to one


def prepared(data: Trajectories, tree: KinematicTree) -> tuple[Trajectories, list[str]]:
    """The log with its coordinates in the sequence of the tree, and notes on changes.

    Raises
    ------
    InputError, DataError
    """
    missing = sorted(set(tree.coordinates) ^ set(data.coordinates))
    if missing:
        raise InputError(
            f"the log has the coordinates {', '.join(data.coordinates)} and the tree the joints "
            f"{', '.join(tree.coordinates)}; rename one of them, for example with "
            f"tree.renamed([{', '.join(map(repr, data.coordinates[:2]))}, ...])"
        )
    order = [data.coordinates.index(name) for name in tree.coordinates]
    notes: list[str] = []
    out: list[Trajectory] = []
    for run in data:
        if run.forces is None or not run.driven:
            raise InputError(
                f"trajectory {run.name!r} holds no torques; give the joint torques as its forces, one column "
                "for each joint"
            )
        rates = None if run.velocities is None else run.velocities[:, order]
        ready, said = _on_clock(
            Trajectory(
                run.t, run.q[:, order], run.forces[:, order], tree.coordinates, run.name, velocities=rates
            )
        )
        notes += [said] if said else []
        out.append(ready)
    ready = Trajectories(out)
    _check(ready, tree)
    return ready, notes


def _check(data: Trajectories, tree: KinematicTree) -> None:
    stacked = np.concatenate([run.q for run in data])
    if len(stacked) < _FEWEST:
        raise DataError(f"the log has {len(stacked)} samples; at least {_FEWEST} are needed")
    spans = np.nanmax(stacked, axis=0) - np.nanmin(stacked, axis=0)
    for joint, span in zip(tree.joints, spans, strict=True):
        if joint.kind == "revolute" and span > _MOST_TURNS:
            raise InputError(
                f"joint {joint.name!r} spans {span:.0f} rad, which looks like degrees; convert the angles to "
                "radians"
            )
        room = np.nan if joint.limits is None else joint.limits[1] - joint.limits[0]
        if joint.kind == "revolute" and span > _BEYOND * room:
            raise InputError(
                f"joint {joint.name!r} spans {span:.3g}, but its limits are {room:.3g} rad apart; convert "
                "angles in degrees to radians, or correct the limits"
            )
    still = [joint.name for joint, span in zip(tree.joints, spans, strict=True) if span < _STILL]
    if len(still) == len(tree):
        raise DataError(
            "the arm stands still in this log; move every joint, fast enough that its inertia shows"
        )


def _on_clock(run: Trajectory) -> tuple[Trajectory, str]:
    """The run at the times of the robot's clock, without repeated samples."""
    steps = np.diff(run.q, axis=0)
    ticks = _ticks(run, steps)
    if ticks is None:
        return run, ""
    count, tick = ticks
    times = run.t[0] + tick * np.concatenate([[0.0], np.cumsum(count)])
    kept = np.concatenate([[True], count > 0])
    said = (
        f"the stamps of the log scatter about a clock of {1.0 / tick:.4g} Hz, which positions and velocities "
        f"show: times were taken from the clock, and {int(np.sum(~kept))} repeated samples left out"
    )
    return run.rows(kept).changed(t=times[kept]), said


def _ticks(run: Trajectory, steps: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Number of ticks before each sample, and their length; None if there is no such clock."""
    if run.velocities is None or not (np.isfinite(run.velocities).all() and np.isfinite(run.q).all()):
        return None
    mean = (run.velocities[1:] + run.velocities[:-1]) / 2.0
    squares = np.sum(mean**2, axis=1)
    fast = squares > _SLOW * squares.mean()
    stamps = np.diff(run.t)
    passed = np.sum(steps * mean, axis=1) / np.where(fast, squares, 1.0)
    moving = fast & (passed > 0.3 * np.median(stamps))
    if moving.sum() < _FEWEST:
        return None
    tick = float(np.median(passed[moving]))
    scatter = np.abs(stamps / tick - np.rint(stamps / tick))
    off = np.abs(passed / tick - np.rint(passed / tick))[fast]
    # time stamps that agree with the clock are kept
    if np.median(off) > _ON_TICK or np.median(scatter) < max(2.0 * np.median(off), _AGREES):
        return None
    ticks = np.rint(np.where(fast, passed, stamps) / tick)
    # prefer a round number of ticks a second if the time stamps agree with it
    rate = float(np.sum(ticks) / (run.t[-1] - run.t[0]))
    whole = round(rate, -1)
    return np.maximum(ticks, 0.0), 1.0 / (whole if whole and abs(rate / whole - 1.0) < 2e-3 else rate)


@dataclass(frozen=True)
class TorqueErrors:
    """Errors of predicted torques.

    Attributes
    ----------
    coordinates : tuple of str
    bands : tuple of float or None
        Cut-off frequency of the filter of measured and predicted torques, in Hz; None: unfiltered.
    rms : (n_bands, n_dof) array
        Root mean square of the error.
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
        """(n_bands,) error relative to the torque, both as root mean squares over all joints."""
        return np.linalg.norm(self.rms, axis=1) / np.linalg.norm(self.torque_rms, axis=1)

    @property
    def of_spread(self) -> np.ndarray:
        """(n_bands,) error relative to the standard deviation of the torques."""
        return np.linalg.norm(self.rms, axis=1) / np.linalg.norm(self.torque_std, axis=1)

    def __str__(self) -> str:
        width = max(8, *map(len, self.coordinates)) + 1
        lines = ["error of torques  " + "".join(f"{name:>{width}}" for name in (*self.coordinates, "all"))]
        for band, each, every in zip(self.bands, self.by_joint, self.overall, strict=True):
            label = "all frequencies" if band is None else f"below {band:g} Hz"
            lines.append(f"{label:18}" + "".join(f"{100 * x:>{width - 2}.2f} %" for x in (*each, every)))
        return "\n".join(lines)


def torque_errors(
    coordinates: tuple[str, ...],
    pairs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    bands: Sequence[float],
) -> TorqueErrors:
    """Compare torques of several runs; each gives times, predicted and measured torques.

    Raises
    ------
    DataError
        If a run is too short.
    """
    frequencies = (*bands, None)
    sums, count = np.zeros((3, len(frequencies), len(coordinates))), 0
    for t, predicted, measured in pairs:
        if t[-1] - t[0] <= 4.0 * _TRIM:
            raise DataError(f"a run lasts {t[-1] - t[0]:.3g} s; to compare torques takes {4.0 * _TRIM:g} s")
        step = float(np.median(np.diff(t)))
        times = np.arange(t[0], t[-1], step)
        ours, theirs = (_at(times, t, values) for values in (predicted, measured))
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


#                                                       notes on a contact, or on currents in place of torques
_WINDOW = 0.1  # s, over which residuals are averaged
_PUSHED = 4.0  # times the usual size of these averages: above this, a contact is reported
_LASTING = 3  # windows that it must last, in one direction; a measured arm without contact reached 3.2
_SCALE = 3.0  # factor by which torques may differ from those of the tree's inertias
_ALIKE = 0.9  # correlation above which torques differ by a factor alone
_NORMAL = 1.4826  # standard deviation over median absolute deviation, of normal numbers


def contact_notes(
    tree: KinematicTree, times: np.ndarray, owners: np.ndarray, residuals: np.ndarray, names: tuple[str, ...]
) -> list[str]:
    """Stretches in which the torque error of a joint is much larger than usual.

    Parameters
    ----------
    times, owners : (n_intervals,) arrays
        Middle of each knot interval in s, and index of its trial.
    residuals : (n_intervals, n_dof) array
        Mean error of each equation.
    names : tuple of str
        Names of the trials.

    Notes
    -----
    A push of less than about a third of a second, or one that the parameters absorb, is not detected.
    """
    starts = np.floor((times - times.min()) / _WINDOW).astype(int) + owners * (int(1e6))
    windows, where = np.unique(starts, return_inverse=True)
    counts = np.bincount(where)
    sums = np.stack([np.bincount(where, weights=column) for column in residuals.T], axis=1)
    means = sums / counts[:, None]
    usual = _NORMAL * np.median(np.abs(means), axis=0)
    ratios = means / np.maximum(usual, 1e-300)
    loud = np.where(np.abs(ratios) > _PUSHED, np.sign(ratios), 0.0)
    notes: list[str] = []
    for joint, row in enumerate(loud.T):
        begin = 0
        while begin < len(windows):
            end = begin + 1
            while end < len(windows) and row[begin] and row[end] == row[begin]:
                if windows[end] != windows[end - 1] + 1:
                    break
                end += 1
            if end - begin >= _LASTING:
                inside = (where >= begin) & (where < end)
                size, name = np.abs(ratios[begin:end, joint]).max(), names[int(owners[inside][0])]
                notes.append(
                    f"from {times[inside].min():.2f} to {times[inside].max():.2f} s of {name!r} the torque "
                    f"of {tree.coordinates[joint]} is off by {size:.0f} times its usual error, as in a "
                    "contact; leave that stretch out and identify again"
                )
            begin = end
    return notes[:5]


def scale_notes(tree: KinematicTree, points: Points, torques: np.ndarray) -> list[str]:
    """Joints whose logged torques differ by a factor from those that the tree's inertias need.

    The measured torque of each joint is compared with that of the tree by least squares, beside friction, a
    rotor and a constant torque.

    Parameters
    ----------
    points : Points
        States along the motion.
    torques : (n_dof, n_points) array
        Measured torques.
    """
    if np.isnan(tree.inertias).any():
        return []
    said, n = inverse_dynamics(Motion.of(tree, points), tree.inertias), len(tree)
    notes: list[str] = []
    for i, name in enumerate(tree.coordinates):
        qdot, qddot = points.columns[n + i], points.columns[2 * n + i]
        beside = np.stack([np.ones_like(qdot), qdot, np.sign(qdot), qddot], axis=1)
        basis: np.ndarray = np.linalg.qr(beside)[0]
        ours, theirs = torques[i] - basis @ (basis.T @ torques[i]), said[i] - basis @ (basis.T @ said[i])
        shared, square = float(ours @ theirs), float(theirs @ theirs)
        if square == 0.0 or abs(shared) < _ALIKE * np.sqrt(float(ours @ ours) * square):
            continue
        factor = shared / square
        if not 1.0 / _SCALE < factor < _SCALE:
            notes.append(
                f"the torques of {name} are {factor:.3g} times those that the inertias of the tree need: if "
                "they are currents or motor torques, multiply by the torque constant and the gear ratio"
            )
    return notes
