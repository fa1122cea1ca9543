"""Checks of a robot's log (names, units, standstill, clock), facts of its fit, and notes.

Programs that poll a controller log the time of the poll, not that of the state. A state appears twice or is
missing, and time stamps scatter by a period or more.  If velocities are logged, positions give the true time
between two samples, Δt = Δq·v̄/v̄², and controllers tick at a constant rate.

Each note (a contact, currents in place of torques) compares an identified arm with its log or with the
inertias of the tree.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from leastaction.arms.base import TREE_SHARE, BaseParameters, inertial_prior
from leastaction.arms.columns import JointColumns, joint_columns
from leastaction.arms.signals import idle_notes
from leastaction.data.formats.atomic import StrPath
from leastaction.data.formats.bags import is_bag
from leastaction.data.formats.dispatch import listed_paths, peek
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import DataError, InputError
from leastaction.identifiers import TIME
from leastaction.io import read
from leastaction.library.tree import KinematicTree
from leastaction.mechanics import Points
from leastaction.mechanics.rigid_bodies import Motion, inverse_dynamics

__all__ = [
    "PUSHED",
    "FitFacts",
    "contact_notes",
    "load_notes",
    "log_columns",
    "prepared",
    "read_log",
    "scale_notes",
]

_FEWEST = 200  # samples
_MOST_TURNS = 12.0 * np.pi  # rad; a joint that spans more is in degrees
_BEYOND = 2.0  # a joint that spans more than this multiple of the range of its limits is in degrees
_STILL = 1e-3  # rad or m: a joint that spans less stands still
_SLOW = 0.02  # of the mean square velocity; in slower motion, positions do not determine the time
_AGREES = 0.02  # of a tick: if half of the time stamps scatter by less, they are kept
_ON_TICK = 0.1  # of a tick: half of the samples must be nearer to one


def read_log(
    path: StrPath | Iterable[StrPath], tree: KinematicTree, *, currents: bool = False
) -> Trajectories:
    """Read a log of joint angles and torques, whose columns are recognised by their names.

    Recognises joint states of ROS and ROS 2 in tables, libfranka, the RTDE of Universal Robots, and bags of
    ROS 2 (``.mcap``, ``.db3`` or their directory; needs ``pip install 'leastaction[ros]'``). For other logs,
    `leastaction.read` takes the names of columns.

    Parameters
    ----------
    path : path, or iterable of paths
        Several files are runs of one arm, with the same columns.
    tree : KinematicTree
        Its joints are found by name, or else by number: the first joint has the lowest.
    currents : bool
        Whether the log may hold motor currents in place of torques. Give a gain to `identify` then:
        ``Recording(gains=...)``.

    Returns
    -------
    Trajectories
        `log_columns` says which columns they are.

    Raises
    ------
    InputError
        If the columns are not recognised, or the log has currents, or neither torques nor currents.
    """
    columns = log_columns(path, tree)
    if not columns.torques:
        raise InputError(
            f"{listed_paths(path)[0]} seems to have neither torques nor motor currents; name their columns: "
            "leastaction.read(path, coordinates, forces=...)"
        )
    if columns.currents and not currents:
        raise InputError(
            f"{', '.join(columns.torques.values())} seem to be motor currents; pass currents=True, and the "
            "torque per ampere of at least one joint to identify: recording=Recording(gains={...})"
        )
    return read(
        path,
        columns.positions,
        columns.time,
        columns.torques,
        velocities=columns.velocities or None,
        time_unit=columns.time_unit,
    )


def log_columns(path: StrPath | Iterable[StrPath], tree: KinematicTree) -> JointColumns:
    """The columns that `read_log` takes: time, and positions, velocities and torques by joint."""
    first = listed_paths(path)[0]
    if is_bag(first):
        joints = {name: name for name in tree.coordinates}
        return JointColumns(TIME, None, joints, {}, dict.fromkeys(joints, "effort"), False)
    seen = peek(first)
    return joint_columns(seen.header, seen.rows, tree.coordinates, str(first))


def prepared(
    data: Trajectories, tree: KinematicTree, unmeasured: Sequence[int] = ()
) -> tuple[Trajectories, list[str]]:
    """The log with its coordinates in the sequence of the tree, and notes on changes.

    The forces of unmeasured joints are zero.

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
        forces = run.forces[:, order]
        forces[:, list(unmeasured)] = 0.0
        ready, said = _on_clock(
            Trajectory(run.t, run.q[:, order], forces, tree.coordinates, run.name, velocities=rates)
        )
        notes += [said] if said else []
        out.append(ready)
    ready = Trajectories(out)
    _check(ready, tree)
    return ready, notes + idle_notes(ready, tree, unmeasured)


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
class FitFacts:
    """How a model was found.

    Attributes
    ----------
    trials : tuple of str
        Names of the trajectories.
    noise_std : tuple of float
        Standard deviation of the noise of each coordinate.
    torque_density : tuple of float
        Spectral density of the error of each equation, in torque² seconds.
    knots_per_second : float
    status : str
        Outcome of the solver.
    notes : tuple of str
        Changes to the log, and checks that failed.
    delays, delay_errors : tuple of float
        Delay of the recorded torque of each joint in s, and its standard error. Empty: no delay.
    gains, gain_errors : tuple of float
        Torque per unit of the log, and its standard error: zero for a known gain. Empty: torques.
    unmeasured : tuple of str
        Joints whose torque the log does not hold.
    """

    trials: tuple[str, ...]
    noise_std: tuple[float, ...]
    torque_density: tuple[float, ...]
    knots_per_second: float
    status: str
    notes: tuple[str, ...] = ()
    delays: tuple[float, ...] = ()
    delay_errors: tuple[float, ...] = ()
    gains: tuple[float, ...] = ()
    gain_errors: tuple[float, ...] = ()
    unmeasured: tuple[str, ...] = ()


#                                                       notes on a contact, or on currents in place of torques
_WINDOW = 0.1  # s, over which residuals are averaged
PUSHED = {1: 6.0, 2: 5.0, 3: 4.0}  # windows in a row, and times the usual size that each of them exceeds
# Errors of friction at reversals are short.  Without contact, 28 simulated logs reached 4.4, 3.6 and 2.1
# times, and a measured arm 4.3, 3.7 and 3.1.  Of 640 pushes, 580 are found; with half of the first number
# 628, and every log without a push is reported; with twice that number 558 (benchmarks.arms --thresholds).
_SCALE = 3.0  # factor by which torques may differ from those of the tree's inertias
_ALIKE = 0.9  # correlation above which torques differ by a factor alone
_LOADED = 1e-3  # p-value below which a load is reported
_NORMAL = 1.4826  # standard deviation over median absolute deviation, of normal numbers


def contact_notes(
    tree: KinematicTree,
    times: np.ndarray,
    owners: np.ndarray,
    residuals: np.ndarray,
    names: tuple[str, ...],
    least: Mapping[int, float] = PUSHED,
) -> list[str]:
    """The stretch in which the torque error of a joint is largest, if it is much larger than usual.

    Parameters
    ----------
    times, owners : (n_intervals,) arrays
        Middle of each knot interval in s, and index of its trial.
    residuals : (n_intervals, n_dof) array
        Mean error of each equation; zero where it is unknown.
    names : tuple of str
        Names of the trials.
    least : mapping of int to float
        Windows in a row, and the error in each of them from which on it is reported.

    Notes
    -----
    Errors are averaged over windows of 0.1 s and compared with the median of these averages.  The shorter a
    push, the larger it must be.  A weak push, or one that the parameters absorb, is not detected.
    """
    starts = np.floor((times - times.min()) / _WINDOW).astype(int) + owners * (int(1e6))
    windows, where = np.unique(starts, return_inverse=True)
    sums = np.stack([np.bincount(where, weights=column) for column in residuals.T], axis=1)
    means = sums / np.bincount(where)[:, None]
    usual = np.array([np.median(size[size > 0.0]) if size.any() else 0.0 for size in np.abs(means).T])
    ratios = means / np.maximum(_NORMAL * usual, 1e-300)
    largest, begin, joint = 1.0, -1, 0
    for length, ratio in least.items():
        places = np.flatnonzero(windows[length - 1 :] - windows[: len(windows) - length + 1] == length - 1)
        run = np.stack([ratios[places + k] for k in range(length)])
        smallest = np.maximum(run.min(axis=0), -run.max(axis=0)) / ratio  # negative where signs differ
        if smallest.size and smallest.max() > largest:
            largest, (row, joint) = smallest.max(), np.unravel_index(int(smallest.argmax()), smallest.shape)
            begin = int(places[row])
    if begin < 0:
        return []
    side, edge = ratios[:, joint] * np.sign(ratios[begin, joint]), min(least.values())
    end = begin + 1
    while begin > 0 and side[begin - 1] > edge and windows[begin - 1] == windows[begin] - 1:
        begin -= 1
    while end < len(windows) and side[end] > edge and windows[end] == windows[end - 1] + 1:
        end += 1
    inside = (where >= begin) & (where < end)
    name, size = names[int(owners[inside][0])], side[begin:end].max()
    return [
        f"from {times[inside].min():.2f} to {times[inside].max():.2f} s of {name!r} the torque of "
        f"{tree.coordinates[joint]} is off by {size:.0f} times its usual error, as in a contact; leave that "
        "stretch out and identify again"
    ]


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
        if square == 0.0 or abs(shared) <= _ALIKE * np.sqrt(float(ours @ ours) * square):
            continue
        factor = shared / square
        if not 1.0 / _SCALE < factor < _SCALE:
            notes.append(
                f"the torques of {name} are {factor:.3g} times those that the inertias of the tree need: if "
                "they are currents or motor torques, give the gain (torque constant times gear ratio) in "
                "Recording(gains=...) or --gains"
            )
    return notes


def load_notes(
    tree: KinematicTree, base: BaseParameters, estimates: np.ndarray, covariance: np.ndarray
) -> list[str]:
    """Links at the end of a chain that are heavier than the tree states.

    The difference β − B x₀ of the base parameters from those of the tree has the covariance Σ + B S Bᵀ, where
    S holds the variances of the tree's inertias x₀.  A load is reported if a body on such a link reduces χ²
    significantly, relative to what it leaves.

    Parameters
    ----------
    estimates, covariance : (n_base,) and (n_base, n_base) arrays
    """
    means, spreads = inertial_prior(tree, TREE_SHARE)
    if not np.isfinite(spreads).all():
        return []
    inertial = np.array([term.kind == "inertia" for term in base.terms])
    rows = ~base.matrix[:, ~inertial].any(axis=1)
    matrix = base.matrix[np.ix_(rows, inertial)]
    difference = estimates[rows] - matrix @ means.ravel()
    inverse = np.linalg.inv(covariance[np.ix_(rows, rows)] + (matrix * spreads.ravel() ** 2) @ matrix.T)
    carried = {joint.parent for joint in tree.joints}
    notes: list[str] = []
    for k in set(range(len(tree))) - carried:
        own = matrix[:, 10 * k : 10 * k + 10]
        spread = np.linalg.pinv(own.T @ inverse @ own, rcond=1e-12, hermitian=True)
        body = spread @ (own.T @ (inverse @ difference))
        rest = difference - own @ body
        rank = int(np.linalg.matrix_rank(own))
        left = float(rest @ inverse @ rest)
        gain = float(difference @ inverse @ difference) - left
        excess = max(left / max(len(rest) - rank, 1), 1.0)
        if body[0] > 0.0 and chi2.sf(gain / excess, rank) < _LOADED:
            notes.append(
                f"{tree.links[k]} is {body[0]:.2g} kg heavier than the tree states, as with a load that is "
                "not in the tree; add it to the inertia of the link, or see arms.payload"
            )
    return notes
