"""Samples far off the motion: glitches of a camera, lost counts of an encoder.

A least-squares fit gives one sample at ten standard deviations the weight of a hundred good ones, and the
noise that is estimated from all of them hides the law behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leastaction.curve.bspline import uniform_grid
from leastaction.curve.knots import FEWEST_SAMPLES, excerpt
from leastaction.curve.settings import CURVE
from leastaction.curve.smoothing import smooth
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.findings import Finding, find

__all__ = ["leave_out_outliers"]

_ABOUT = 3  # samples on either side that a sample is compared with
_ROUNDS = 10  # of smoothing without outliers, at most
_DIGITS = 1e-5  # of the spread: what a curve through noiseless samples is off by


@dataclass(frozen=True, eq=False)
class _Motion:
    """Smoothness of a motion, and noise of its samples.

    Attributes
    ----------
    knots_per_second : float
    penalty : (n_dof,) array or None
        Of the smoothing; None as long as nothing was found.
    scale : (n_dof,) array
        Standard deviation of its residuals.
    heavy : (n_dof,) bool array
        Coordinates whose noise has heavy tails.
    """

    knots_per_second: float
    penalty: np.ndarray | None
    scale: np.ndarray
    heavy: np.ndarray


def leave_out_outliers(
    trajectories: Trajectories, degree: int, most_samples: int | None = None
) -> tuple[Trajectories, list[Finding]]:
    """Replace outliers by NaN, and say how many.

    Smooths all samples, leaves out those that are far off and alone there, and smooths again without them
    until nothing changes.  Far off is measured against all residuals of samples not yet left out: encoders
    that are often off by one count have noise with heavy tails, which is no reason to leave anything out.

    Parameters
    ----------
    trajectories : Trajectories
    degree : int
        Of the splines.
    most_samples : int, optional
        From how many samples of longer recordings smoothness and noise are found; each trajectory is then
        looked at by itself.

    Returns
    -------
    Trajectories
        The same when there are none.
    list of Finding
        One note for each coordinate with outliers.
    """
    rate = 1.0 / trajectories.sampling_interval / CURVE.samples_per_knot
    first = _Motion(rate, None, np.ones(trajectories.n_dof), np.zeros(trajectories.n_dof, dtype=bool))
    part = trajectories if most_samples is None else excerpt(trajectories, most_samples)
    out, motion = _outliers(part, degree, first)
    if part is not trajectories:
        out = [_outliers_of(one, degree, motion) for one in trajectories]
    counts = np.sum([o.sum(axis=0) for o in out], axis=0)
    share = counts / np.sum([np.isfinite(t.q).sum(axis=0) for t in trajectories], axis=0)
    if np.any(share > CURVE.most_outliers):  # more outliers than in the pieces
        out = [o & (share <= CURVE.most_outliers) for o in out]
        counts = np.where(share > CURVE.most_outliers, 0, counts)
    if not np.any(counts):
        return trajectories, []
    notes = [
        find("outliers-left-out", name, count=count, share=part, far=CURVE.outlier)
        for name, count, part in zip(trajectories.coordinates, counts, share, strict=True)
        if count
    ]
    return trajectories.without(out), notes


def _outliers(trajectories: Trajectories, degree: int, motion: _Motion) -> tuple[list[np.ndarray], _Motion]:
    """(n_times, n_dof) mask for each trajectory, and what was found of the motion on the way."""
    times, values = [t.t for t in trajectories], [t.q for t in trajectories]
    grid = uniform_grid(times, motion.knots_per_second, degree)
    learnt, out = motion, [np.zeros(q.shape, dtype=bool) for q in values]
    for _ in range(_ROUNDS):
        kept = [np.where(o, np.nan, q) for q, o in zip(values, out, strict=True)]
        curve = smooth(grid, times, kept, motion.penalty)
        residuals = [
            q - c for q, c in zip(values, grid.evaluate(curve.control_points, times, 0), strict=True)
        ]
        if motion.penalty is None:
            used = [np.where(o, np.nan, r) for r, o in zip(residuals, out, strict=True)]
            least = _DIGITS * np.nanstd(np.concatenate(values), axis=0)
            scale = np.maximum(np.nanstd(np.concatenate(used), axis=0), least)
            learnt = replace(motion, penalty=curve.penalty, scale=scale)
        found = [_far_and_alone(np.abs(r) / learnt.scale) for r in residuals]
        if motion.penalty is None:
            measured = np.isfinite(np.concatenate(values)).sum(axis=0)
            share = np.sum([f.sum(axis=0) for f in found], axis=0) / measured
            learnt = replace(learnt, heavy=share > CURVE.most_outliers)
        for f in found:
            f[:, learnt.heavy] = False
        unchanged = all(np.array_equal(f, o) for f, o in zip(found, out, strict=True))
        out = found
        if unchanged:
            break
    return out, learnt


def _outliers_of(one: Trajectory, degree: int, motion: _Motion) -> np.ndarray:
    """(n_times, n_dof) mask for a trajectory of a motion that is known; none where samples are few."""
    if np.isfinite(one.q).sum(axis=0).min() < FEWEST_SAMPLES:
        return np.zeros(one.q.shape, dtype=bool)
    return _outliers(Trajectories([one]), degree, motion)[0][0]


def _far_and_alone(sizes: np.ndarray) -> np.ndarray:
    """(n_times, n_dof) mask of relative residuals that are large, and larger than those about them."""
    out = np.zeros(sizes.shape, dtype=bool)
    for i in range(sizes.shape[1]):
        measured = np.flatnonzero(np.isfinite(sizes[:, i]))
        size = sizes[measured, i]
        if size.size <= 2 * _ABOUT:
            continue
        padded = np.pad(size, _ABOUT, mode="reflect")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _ABOUT + 1)
        about = np.median(np.delete(windows, _ABOUT, axis=1), axis=1)
        out[measured, i] = (size > CURVE.outlier) & (size > CURVE.outlier_alone * about)
    return out
