"""smooth(): noisy coordinates to curves with velocities and accelerations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from leastaction.curve.knots import lay_knots
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.threads import single_threaded

__all__ = ["SmoothMotion", "smooth"]


@dataclass(frozen=True, eq=False)
class SmoothMotion:
    """A smoothed trajectory and its rates at the sample times.

    Attributes
    ----------
    t : (n_times,) array
    q, qdot, qddot : (n_times, n_dof) arrays
    noise_std : (n_dof,) array
        Estimated noise of the measured coordinates, common to all trajectories.
    """

    t: np.ndarray
    q: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    noise_std: np.ndarray


@single_threaded()
def smooth(
    trajectories: Trajectory | Trajectories | Iterable[Trajectory], *, degree: int = 5
) -> list[SmoothMotion]:
    """Smooth measured coordinates and differentiate them, without a model of the system.

    Each coordinate is a B-spline with a penalty on its third derivative. Restricted maximum likelihood (REML,
    Wood 2011) sets the strength of the penalty. Missing samples are filled in.

    Parameters
    ----------
    trajectories : Trajectory, Trajectories or iterable of Trajectory
    degree : int
        Degree of the spline, at least 3.

    Returns
    -------
    list of SmoothMotion
        One for each trajectory.

    Raises
    ------
    InputError
        If the trajectories do not belong together.

    Notes
    -----
    Not guaranteed: accelerations without bias. Any smoother flattens motion that is faster than the noise
    allows it to resolve. :func:`leastaction.discover` does not use accelerations found this way.

    Examples
    --------
    >>> import numpy as np, leastaction as la
    >>> t = np.linspace(0.0, 10.0, 501)
    >>> noisy = np.sin(t) + 0.01 * np.random.default_rng(0).standard_normal(t.size)
    >>> (motion,) = la.smooth(la.Trajectory(t, noisy, coordinates=["x"]))
    >>> bool(np.abs(motion.qdot[50:-50, 0] - np.cos(t[50:-50])).max() < 0.02)
    True
    """
    data = Trajectories.coerce(trajectories)
    smoothed = lay_knots(data, degree).smooth
    times = [trajectory.t for trajectory in data]
    q, qdot, qddot = (smoothed.grid.evaluate(smoothed.control_points, times, nu) for nu in range(3))
    states = zip(times, q, qdot, qddot, strict=True)
    return [SmoothMotion(*state, smoothed.noise_std) for state in states]
