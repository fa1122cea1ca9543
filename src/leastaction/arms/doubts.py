"""Doubts about a log, in words: a contact, or currents in place of torques.

Each test compares an identified arm with its log or with what the tree says, and returns notes of one line.
"""

from __future__ import annotations

import numpy as np

from leastaction.library.tree import KinematicTree
from leastaction.mechanics import Points
from leastaction.mechanics.rigid_bodies import Motion, inverse_dynamics

__all__ = ["contact_notes", "scale_notes"]

_WINDOW = 0.1  # s, over which residuals are averaged
_PUSHED = 4.0  # times the usual size of these averages, above which something pushes
_LASTING = 3  # windows that it must last, in one direction; a measured arm without contact reached 3.2
_SCALE = 3.0  # factor by which torques may differ from those of the tree's inertias
_ALIKE = 0.9  # correlation of both, above which they differ by a factor
_NORMAL = 1.4826  # standard deviation over median absolute deviation, of normal numbers


def contact_notes(
    tree: KinematicTree, times: np.ndarray, owners: np.ndarray, residuals: np.ndarray, names: tuple[str, ...]
) -> list[str]:
    """Stretches in which the torques of a joint are off by far more than usual.

    Parameters
    ----------
    times, owners : (n_intervals,) arrays
        Middle of each knot interval in s, and number of its trial.
    residuals : (n_intervals, n_dof) array
        Mean error of each equation.
    names : tuple of str
        Of the trials.

    Notes
    -----
    A push of less than about a third of a second, or one that the parameters absorb, is not seen.
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
    """Joints whose torques are another quantity than what the tree's inertias need.

    The measured torque of each joint is compared with that of the tree by least squares, beside friction, a
    rotor and a constant torque.

    Parameters
    ----------
    points : Points
        States along the motion.
    torques : (n_dof, n_points) array
        Measured.
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
