"""Steps of the joint fit where the equations are nearly exact."""

from __future__ import annotations

import numpy as np
import pytest

from helpers import euler_lagrange
from leastaction import systems
from leastaction.curve.bspline import uniform_grid
from leastaction.curve.smoothing import smooth
from leastaction.estimation.forces import forces_on
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.observations import Observations


@pytest.mark.parametrize("off", [0.001, 0.003])
def test_a_step_that_leaves_nearly_exact_equations_is_corrected_and_not_refused(off):
    """By their curvature the cost rises, although the step is good; small steps would never arrive."""
    law = systems.get("double_pendulum").lagrangian
    data = systems.generate("double_pendulum", noise=0.05, trials=2, duration=10.0, seed=0)
    times, values = [x.t for x in data], [x.q for x in data]
    grid = uniform_grid(times, 50.0, 5, 2)
    curve = smooth(grid, times, values)
    forces = forces_on(grid, times, [x.forces for x in data]).values
    truth = np.array(list(law.values()))
    columns = euler_lagrange(list(law), data.coordinates)
    free, held = (Physics(columns, np.full(len(law), given), forces) for given in (True, False))
    weights = Weights(curve.noise_std, np.full(2, 1e6), np.ones(2))
    seen = Observations(grid, times, values)
    start = truth * (1.0 + off * (-1.0) ** np.arange(len(law)))
    points = fit_joint(seen, held, weights, curve.control_points, start, tolerance=1.0).control_points
    fit = fit_joint(seen, free, weights, points, start)
    assert fit.status == "converged"
    assert fit.n_steps <= 8
    again = fit_joint(seen, free, weights, fit.control_points, fit.coefficients, tolerance=1e-6)
    assert again.converged
    assert fit.linearisation.cost(weights) - again.linearisation.cost(weights) < 1e-2
