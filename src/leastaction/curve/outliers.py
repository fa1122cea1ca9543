"""Samples far off the motion: glitches of a camera, lost counts of an encoder.

A least-squares fit gives one sample at ten standard deviations the weight of a hundred good ones, and the
noise that is estimated from all of them hides the law behind it.
"""

from __future__ import annotations

import numpy as np

from leastaction.curve.bspline import uniform_grid
from leastaction.curve.settings import CURVE
from leastaction.curve.smoothing import smooth
from leastaction.data.trajectories import Trajectories
from leastaction.findings import Finding, find

__all__ = ["leave_out_outliers"]

_ABOUT = 3  # samples on either side
_SAMPLES_PER_KNOT = 2.5
_ROUNDS = 10
_DIGITS = 1e-5  # of the spread: what a curve through noiseless samples is off by


def leave_out_outliers(trajectories: Trajectories, degree: int) -> tuple[Trajectories, list[Finding]]:
    """Replace outliers by NaN, and say how many.

    Smooths all samples, leaves out those that are far off and alone there, and smooths again without them
    until nothing changes.  Far off is measured against all residuals of samples not yet left out: encoders
    that are often off by one count have noise with heavy tails, which is no reason to leave anything out.

    Parameters
    ----------
    trajectories : Trajectories
    degree : int
        Of the splines.

    Returns
    -------
    Trajectories
        The same when there are none.
    list of Finding
        One note for each coordinate with outliers.
    """
    times, values = [t.t for t in trajectories], [t.q for t in trajectories]
    rate = 1.0 / trajectories.sampling_interval
    grid = uniform_grid(times, rate / _SAMPLES_PER_KNOT, degree)
    least = _DIGITS * np.nanstd(np.concatenate(values), axis=0)
    measured = np.isfinite(np.concatenate(values)).sum(axis=0)
    out = [np.zeros(q.shape, dtype=bool) for q in values]
    share = np.zeros(trajectories.n_dof)
    for _ in range(_ROUNDS):
        kept = [np.where(o, np.nan, q) for q, o in zip(values, out, strict=True)]
        curve = smooth(grid, times, kept)
        residuals = [
            q - c for q, c in zip(values, grid.evaluate(curve.control_points, times, 0), strict=True)
        ]
        used = [np.where(o, np.nan, r) for r, o in zip(residuals, out, strict=True)]
        scale = np.maximum(np.nanstd(np.concatenate(used), axis=0), least)
        found = [_far_and_alone(np.abs(r) / scale) for r in residuals]
        share = np.sum([f.sum(axis=0) for f in found], axis=0) / measured
        for f in found:
            f[:, share > CURVE.most_outliers] = False
        unchanged = all(np.array_equal(f, o) for f, o in zip(found, out, strict=True))
        out = found
        if unchanged:
            break
    counts = np.sum([o.sum(axis=0) for o in out], axis=0)
    if not np.any(counts):
        return trajectories, []
    notes = [
        find("outliers-left-out", name, count=count, share=part, far=CURVE.outlier)
        for name, count, part in zip(trajectories.coordinates, counts, share, strict=True)
        if count
    ]
    return trajectories.without(out), notes


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
