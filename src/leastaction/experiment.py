r"""Motions that show the parameters of an arm: Fourier trajectories of least uncertainty within limits.

Every joint moves along a Fourier series (Swevers et al. 1997, IEEE Transactions on Robotics and Automation
13:730) that starts and ends at rest.  With the columns Y of the base parameters, the noise of the torques and
weak priors P, the volume of the region in which the parameters will be found is proportional to

    det(YᵀWY + P)^(−1/2).

A quasi-Newton method minimises its logarithm; see :mod:`leastaction.arms.planning`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from leastaction.arms.collisions import Collisions
from leastaction.arms.planning import Bounds, Excitation, Limits, Plan, Series, positive
from leastaction.errors import DataError, InputError
from leastaction.library.tree import KinematicTree
from leastaction.threads import single_threaded

__all__ = ["Collisions", "Excitation", "Limits", "excite"]

_PERIOD = 10.0  # s, of the series at most
_WEIGHTS = (30.0, 300.0, 3000.0)  # of penalties, one after the other


@single_threaded()
def excite(
    tree: KinematicTree,
    limits: Limits | None = None,
    duration: float = 10.0,
    *,
    noise: ArrayLike = 0.1,
    rate: float = 100.0,
    harmonics: int = 8,
    seed: int = 0,
) -> Excitation:
    """Plan a motion that determines the parameters of an arm as well as limits allow.

    Parameters
    ----------
    tree : KinematicTree
    limits : Limits, optional
        By default those that the URDF or MJCF states.
    duration : float
        In s. Motions of more than 10 s repeat a shorter period.
    noise : array_like, shape (n_dof,), or float
        Standard deviation of measured torques, in N m or N.
    rate : float
        Samples per second, of the log and of the result.
    harmonics : int
        Number of harmonics in the Fourier series of each joint.
    seed : int
        Of the start. The same seed gives the same motion.

    Returns
    -------
    Excitation
        Starts and ends at rest; all limits hold on a grid eight times as fine as the optimisation's. Not
        guaranteed: that no better motion exists and, without ``Limits(collisions=...)``, that links do not
        collide with each other.

    Raises
    ------
    InputError
        If a limit or another argument is not as expected.
    DataError
        If no motion within the limits was found.

    Examples
    --------
    >>> from leastaction.arms import KinematicTree
    >>> arm = KinematicTree.from_dh([{"a": 0.3}, {"a": 0.2}], modified=False, gravity=(0.0, -9.81, 0.0))
    >>> limits = Limits(angle=[[-1.5, -1.5], [1.5, 1.5]], speed=2.0, acceleration=10.0)
    >>> plan = excite(arm, limits, 5.0)
    >>> bool(plan.log_volume[1] < plan.log_volume[0]), plan.unseen
    (True, ())
    """
    bounds = Bounds.of(Limits.of_tree(tree) if limits is None else limits, tree)
    if not (np.isfinite(duration) and duration > 0.0 and rate > 0.0 and harmonics >= 3):
        raise InputError("duration and rate must be positive, and harmonics at least 3")
    periods = max(1, int(np.ceil(duration / _PERIOD)))
    series = Series(duration / periods, harmonics)
    plan = Plan.of(tree, bounds, series, positive(noise, len(tree), "noise"), rate * duration)
    start = plan.start(np.random.default_rng(seed))
    found = start
    for weight in _WEIGHTS:
        found = plan.improved(found, weight)
    before, after = (plan.shrunk(coefficients) for coefficients in (start, found))
    if after is None:
        raise DataError(
            "no motion within the limits was found; check that some pose between the lowest and the highest "
            "angles respects the boxes, the clearance and the torques, or try another seed"
        )
    information = [plan.information(c) for c in (start if before is None else before, after)]
    t = np.arange(0.0, duration + 0.5 / rate, 1.0 / rate)
    q, qdot, qddot = series.states(after, t)
    covariance = np.linalg.inv(information[1] + np.eye(len(plan.priors)))
    conditions = [float(np.linalg.cond(each + np.eye(len(each)))) for each in information]
    volumes = [-0.5 * float(np.linalg.slogdet(each + np.eye(len(each)))[1]) for each in information]
    return Excitation(
        tree,
        t,
        q,
        qdot,
        qddot,
        plan.base,
        plan.priors * np.sqrt(np.diag(covariance)),
        plan.priors,
        (conditions[0], conditions[1]),
        (volumes[0], volumes[1]),
    )
