"""Coefficients by free runs: against known laws, with and without pushes that the library cannot explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction.estimation.simulation_error import minimise_free_runs
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.selection.coarse_restart import improve_coarse
from leastaction.selection.prepare import prepare
from leastaction.simulation.integrate import rk4

TERMS = ["theta_dot**2", "cos(theta)"]
FRICTION = ["theta_dot**2/2"]
TRUTH = np.array([0.5, 9.81, 0.2])
STEP = 0.01


def driven(seed: int, pushed: float = 0.0, viscous: float = 0.2, trials: int = 3) -> la.Trajectories:
    """A pendulum under a known torque, and under one that nobody measured and that is fast."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 15.0, STEP)
    out = []
    for _ in range(trials):
        known = sum(rng.normal() * np.sin(w * t + rng.uniform(0.0, 6.3)) for w in (0.7, 1.9, 2.8, 4.1))
        fast = sosfiltfilt(butter(2, [0.06, 0.2], "band", output="sos"), rng.normal(size=t.size))  # 3-10 Hz
        fast *= pushed / fast.std()
        forces = (4.0 * known + fast)[:, None]

        def acceleration(q, v, f):
            return f - TRUTH[1] * np.sin(q) - viscous * v

        table = lambda times: np.stack([np.interp(times, t, forces[:, 0])], axis=-1)  # noqa: B023, E731
        q, _ = rk4(acceleration, rng.normal(0.0, 1.0, 1), rng.normal(0.0, 1.0, 1), t, forces=table)
        q += rng.normal(0.0, 1e-4, q.shape)
        out.append(la.Trajectory(t, q, forces=4.0 * known[:, None], coordinates=["theta"]))
    return la.Trajectories(out)


def minimise(data: la.Trajectories, start, horizon: float = 0.5):
    prepared = prepare(data, TERMS, None, FRICTION, None, 5)
    workspace = prepared.workspace(EulerLagrange(prepared.columns, prepared.library.coordinates))
    return minimise_free_runs(workspace, prepared.knots.smooth, (0, 1, 2), np.asarray(start), horizon)


def test_the_law_is_found_from_coefficients_that_are_off():
    found = minimise(driven(0), TRUTH * [1.2, 0.8, 0.5])
    assert np.allclose(found.estimates, TRUTH, rtol=[1e-3, 1e-3, 2e-2])


def test_the_law_is_found_where_only_one_coefficient_may_move():
    data = driven(1)
    prepared = prepare(data, TERMS, {"theta_dot**2": 0.5}, FRICTION, None, 5)
    workspace = prepared.workspace(EulerLagrange(prepared.columns, prepared.library.coordinates))
    found = minimise_free_runs(workspace, prepared.knots.smooth, (1,), np.array([0.5, 8.0, 0.2]), 0.5)
    assert found.estimates == pytest.approx([9.81], rel=1e-3)
    assert found.covariance.shape == (1, 1)


def test_friction_dissipates():
    found = minimise(driven(2, viscous=-0.1), TRUTH)
    assert 0.0 <= found.estimates[2] < 1e-3


def test_intervals_hold_under_pushes_that_nobody_measured():
    results = [minimise(driven(seed, pushed=2.0), TRUTH) for seed in range(20, 45)]
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


def coarse_fit(data, factor):
    """What a search on a coarse grid leaves behind, its coefficients off by a factor."""
    prepared = prepare(data, TERMS, None, FRICTION, None, 5)
    columns = EulerLagrange(prepared.columns, prepared.library.coordinates)
    workspace, curve = prepared.whole_workspace(columns, prepared.knots.coarse)
    start = workspace.start((0, 1, 2), curve.control_points, TRUTH, curve.noise_std)
    structure = workspace.fit((0, 1, 2), start)
    return prepared, workspace, replace(structure, coefficients=TRUTH * factor)


def test_a_fit_that_free_runs_contradict_gives_way():
    stages = []
    prepared, workspace, structure = coarse_fit(driven(7, pushed=2.0), [1.3, 1.2, 0.8])
    better, notes = improve_coarse(prepared, workspace, structure, lambda *stage: stages.append(stage))
    assert np.allclose(better.estimates, TRUTH, rtol=[0.05, 0.05, 0.2])
    assert np.all(np.abs(better.estimates - TRUTH) < 4.0 * better.standard_errors)
    assert better.fit.control_points is structure.fit.control_points
    assert ["free runs" in note for note in notes] == [True]
    ((stage, judged),) = stages
    assert stage == "coarse"
    assert judged["forecast_error"] < judged["before"]


def test_a_fit_within_the_errors_of_free_runs_stays():
    prepared, workspace, structure = coarse_fit(driven(8, pushed=2.0), [1.0, 1.0, 1.0])
    kept, notes = improve_coarse(prepared, workspace, structure, lambda *stage: None)
    assert kept is structure
    assert notes == ()


def test_a_fit_on_fine_knots_stays():
    prepared, workspace, structure = coarse_fit(driven(9), [1.3, 1.2, 0.8])
    workspace.set_knots(prepared.knots.per_second)
    assert improve_coarse(prepared, workspace, structure, lambda *stage: None) == (structure, ())
