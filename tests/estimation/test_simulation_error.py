"""Coefficients by simulation error, with and without pushes that the library cannot explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import linearise
from leastaction.estimation.simulation_error import minimise_simulation_error
from leastaction.estimation.structure import Structure
from leastaction.selection.search_state import Search, begin_search
from leastaction.selection.strategies.simulation_error import run
from leastaction.simulation.integrate import rk4

TERMS = ["theta_dot**2", "cos(theta)"]
FRICTION = ["theta_dot**2/2"]
TRUTH = np.array([0.5, 9.81, 0.2])
STEP = 0.01


def recordings(
    seeds: Sequence[int], pushed: float = 0.0, viscous: float = 0.2, trials: int = 3
) -> list[la.Trajectories]:
    """A pendulum under a known torque, and under one that nobody measured and that is fast.

    One set of trials for each seed; all motions are integrated at once.
    """
    t = np.arange(0.0, 15.0, STEP)
    drawn = []
    for rng in map(np.random.default_rng, seeds):
        for _ in range(trials):
            known = sum(rng.normal() * np.sin(w * t + rng.uniform(0.0, 6.3)) for w in (0.7, 1.9, 2.8, 4.1))
            fast = sosfiltfilt(butter(2, [0.06, 0.2], "band", output="sos"), rng.normal(size=t.size))
            fast *= pushed / fast.std()  # 3-10 Hz
            starts = rng.normal(0.0, 1.0, 1), rng.normal(0.0, 1.0, 1)
            drawn.append((4.0 * known, 4.0 * known + fast, *starts, rng.normal(0.0, 1e-4, (t.size, 1))))

    def forces(times):
        return np.stack([np.interp(times, t, force) for _, force, *_ in drawn], axis=1)[..., None]

    def acceleration(q, v, f):
        return f - TRUTH[1] * np.sin(q) - viscous * v

    motions, _ = rk4(acceleration, [d[2] for d in drawn], [d[3] for d in drawn], t, forces=forces)
    runs = [
        la.Trajectory(t, motions[:, k] + noise, forces=known[:, None], coordinates=["theta"])
        for k, (known, *_, noise) in enumerate(drawn)
    ]
    return [la.Trajectories(runs[k : k + trials]) for k in range(0, len(runs), trials)]


def driven(seed: int, pushed: float = 0.0, viscous: float = 0.2, trials: int = 3) -> la.Trajectories:
    """Recordings of one seed."""
    return recordings([seed], pushed, viscous, trials)[0]


def setup_of(data: la.Trajectories, known=None):
    return build_problem(data, Request(TERMS, known or {}, FRICTION))


def minimise(data: la.Trajectories, start, horizon: float = 0.5, members=(0, 1, 2), known=None):
    setup = setup_of(data, known)
    grid = Grid.lay(setup.problem, setup.scales.per_second)
    curve = setup.scales.smooth
    return minimise_simulation_error(grid, curve, Structure(members), np.asarray(start), horizon)


def test_the_law_is_found_from_coefficients_that_are_off():
    found = minimise(driven(0), TRUTH * [1.2, 0.8, 0.5])
    assert np.allclose(found.estimates, TRUTH, rtol=[1e-3, 1e-3, 2e-2])


def test_the_law_is_found_where_only_one_coefficient_may_move():
    data = driven(1)
    found = minimise(data, [0.5, 8.0, 0.2], members=[1], known={"theta_dot**2": 0.5})
    assert found.estimates == pytest.approx([9.81], rel=1e-3)
    assert found.covariance.shape == (1, 1)


def test_friction_dissipates():
    found = minimise(driven(2, viscous=-0.1), TRUTH)
    assert 0.0 <= found.estimates[2] < 1e-3


@pytest.mark.thorough
def test_intervals_hold_under_pushes_that_nobody_measured():
    results = [minimise(data, TRUTH) for data in recordings(range(20, 45), pushed=2.0)]
    z = np.array([(r.estimates - TRUTH) / np.sqrt(np.diag(r.covariance)) for r in results])
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.35
    assert np.all(np.abs(z.mean(axis=0)) < 0.75)  # no bias that matters: four standard deviations of a mean


def test_nothing_comes_of_few_runs():
    assert minimise(driven(3), TRUTH, horizon=10.0) is None


def test_no_run_goes_over_a_gap():
    data = driven(4)
    holed = [t.rows(np.flatnonzero((t.t < 6.0) | (t.t > 7.0))) for t in data]
    whole, found = minimise(data, TRUTH), minimise(la.Trajectories(holed), TRUTH)
    assert np.allclose(found.estimates, TRUTH, rtol=[1e-3, 1e-3, 2e-2])
    assert np.all(np.diag(found.covariance) > 0.8 * np.diag(whole.covariance))


# ------------------------------------------------------------------------------------- in a discovery


def coarse_fit(data, factor, knots=None) -> Search:
    """What a search on a coarse grid leaves behind, its coefficients off by a factor."""
    setup = setup_of(data)
    grid = Grid.lay(setup.problem, setup.scales.coarse if knots is None else knots(setup.scales))
    curve, members = grid.smooth(setup.scales.smooth.penalty), Structure([0, 1, 2])
    fit = grid.fit(members, grid.start(members, curve.control_points, TRUTH, curve.noise_std))
    return begin_search(setup).now(replace(fit, coefficients=TRUTH * factor))


def test_a_fit_that_simulations_contradict_gives_way():
    stages = []
    search = coarse_fit(driven(7, pushed=2.0), [1.3, 1.2, 0.8])
    found = run(replace(search, report=lambda *stage: stages.append(stage)))
    better = found.found
    assert np.allclose(better.estimates, TRUTH, rtol=[0.05, 0.05, 0.2])
    assert np.all(np.abs(better.estimates - TRUTH) < 4.0 * better.standard_errors)
    assert [finding.code for finding in found.findings] == ["coefficients-of-free-runs"]
    ((stage, judged),) = stages
    assert stage == "coarse"
    assert judged["forecast_error"] < judged["before"]


def test_the_curve_follows_the_coefficients_that_are_reported():
    """What the checks see are the numbers that are returned: the equation error is that of the new ones."""
    search = coarse_fit(driven(7, pushed=2.0), [1.3, 1.2, 0.8])
    better = run(search).found
    held = better.grid.held(better, better.coefficients, better.covariance)
    for fit, again in ((better, held), (held, held)):
        physics, index = fit.grid.physics(fit.structure)
        at = linearise(fit.grid.observations, physics, fit.control_points, fit.coefficients[index])
        np.testing.assert_allclose(fit.linearisation.equation, at.equation, rtol=1e-9)
        np.testing.assert_allclose(fit.equation_error()[0], again.equation_error()[0], rtol=1e-2)


def test_a_fit_within_the_errors_of_simulations_stays():
    search = coarse_fit(driven(8, pushed=2.0), [1.0, 1.0, 1.0])
    assert run(search) is search


def test_a_fit_on_fine_knots_stays():
    search = coarse_fit(driven(9), [1.3, 1.2, 0.8], lambda scales: scales.per_second)
    assert run(search) is search
