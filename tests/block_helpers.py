"""Five short trials as a problem for blocks, and a cluster that fails."""

from __future__ import annotations

from concurrent.futures import CancelledError, Future

import numpy as np
import pytest

from helpers import euler_lagrange, interpolate, uniform_grid
from leastaction.data.trajectories import Rate
from leastaction.estimation.joint import Physics, Weights

DURATIONS = (2.0, 1.5, 3.0, 0.8, 2.2)
TERMS = ["x_dot**2", "y_dot**2", "x_dot*y_dot*cos(y)", "cos(y)", "x**2"]
MORE = [*TERMS, "x*y", "x**4"]
VALUES = np.array([1.5, 0.6, 1.1, 9.81, -5.0])
WEIGHTS = Weights(np.array([0.02, 0.03, 0.1]), np.array([4.0, 9.0]), np.array([7.0, 3.0]), 0.01)


def motion(t):
    return np.column_stack([0.5 * np.sin(2.3 * t) + 0.2, 0.7 * np.cos(3.1 * t)])


def problem():
    """Five trials of different lengths, with missing samples, a velocity, and forces."""
    grid = uniform_grid(DURATIONS, 6.0, 5, 2)
    rng = np.random.default_rng(5)
    times = [np.sort(rng.uniform(0.0, d, 60)) for d in DURATIONS]
    values = [motion(t) + 0.02 * rng.standard_normal((t.size, 2)) for t in times]
    values[1][5:9, 0] = np.nan
    values[3][:, 1] = np.nan  # not measured at all in this trial
    rates = (Rate(1, 1, tuple(-0.7 * 3.1 * np.sin(3.1 * t) for t in times)),)
    forces = rng.standard_normal((*grid.points.shape, 2))
    physics = Physics(euler_lagrange(TERMS, ["x", "y"]), np.array([True, True, True, False, True]), forces)
    control = interpolate(grid, [motion] * len(DURATIONS)) + 0.01 * rng.standard_normal((grid.n_ctrl, 2))
    return grid, (times, values, rates), physics, control


def close(found, expected, tolerance=1e-9):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * max(float(scale), 1e-300))


SMALL = 20 * 2 * 4 * 6
"""Numbers in the Jacobian of 20 knot intervals of two coordinates: a block holds one of the trials or two."""


def assert_same(one, other, tolerance: float = 1e-6):
    """Terms, coefficients within a millionth of a standard error, and the verdict."""
    assert [t.expression for t in one.terms] == [t.expression for t in other.terms]
    for a, b in zip(one.terms, other.terms, strict=True):
        assert abs(a.coefficient - b.coefficient) <= tolerance * a.standard_error
        assert b.standard_error == pytest.approx(a.standard_error, rel=1e-5)
    assert one.fit.status == other.fit.status
    assert [f.code for f in one.fit.findings] == [f.code for f in other.fit.findings]


class Cluster:
    """The methods of Dask's client that are used, computing at once; every so often a result is lost."""

    def __init__(self, lost_every: int, gone_after: int = 10**9) -> None:
        self.lost_every, self.gone_after, self.submitted = lost_every, gone_after, 0

    def scheduler_info(self, n_workers: int = 5) -> dict:
        return {"workers": {"a": {}, "b": {}}}

    def submit(self, function, *given, pure=True) -> Future:
        self.submitted += 1
        if self.submitted > self.gone_after:
            raise OSError("the scheduler is gone")
        out: Future = Future()
        try:
            if self.submitted % self.lost_every == 0:
                raise CancelledError
            out.set_result(function(*(x.result() if isinstance(x, Future) else x for x in given)))
        except BaseException as error:
            out.set_exception(error)
        return out
