"""Measured forces: noise, and steps of a digital controller, against laws that are known."""

from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from helpers import findings_of
from leastaction import systems
from leastaction.curve.bspline import uniform_grid
from leastaction.estimation.forces import forces_on

TRUTH = {"theta_dot**2": 0.5, "cos(theta)": 9.81}


# ------------------------------------------------------------------------------------- on the grid


def test_a_polynomial_of_the_degree_of_the_spline_is_kept():
    t = np.linspace(0.0, 4.0, 401)
    force = np.column_stack([t**5 - 3.0 * t, 2.0 - t**2])
    grid = uniform_grid([t], 5.0, 5)
    found = forces_on(grid, [t], [force])
    x = grid.points
    assert np.allclose(found.values, np.stack([x**5 - 3.0 * x, 2.0 - x**2], axis=-1), atol=1e-8)
    assert np.all(found.density < 1e-16)


@pytest.mark.parametrize("knots", [2.0, 8.0, 30.0, 200.0])
def test_density_is_that_of_white_noise(knots):
    rng = np.random.default_rng(1)
    times = [np.linspace(0.0, 20.0, 2001), np.linspace(0.0, 10.0, 501)]
    noise = [rng.normal(0.0, [0.3, 0.0], (t.size, 2)) for t in times]
    found = forces_on(uniform_grid(times, knots, 5), times, noise)
    expected = 0.3**2 * (2001 * 0.01 + 501 * 0.02) / 2502
    assert found.density[0] == pytest.approx(expected, rel=0.15)
    assert found.density[1] == 0.0


def test_noise_falls_with_the_number_of_samples_an_interval():
    t = np.linspace(0.0, 40.0, 8001)
    noise = np.random.default_rng(2).normal(0.0, 1.0, (t.size, 1))
    sizes = [np.std(forces_on(uniform_grid([t], k, 5), [t], [noise]).values) for k in (4.0, 16.0)]
    assert sizes[1] / sizes[0] == pytest.approx(2.0, rel=0.25)


def test_gaps_and_few_samples():
    t = np.concatenate([np.linspace(0.0, 4.0, 201), np.linspace(6.0, 10.0, 201)])
    grid = uniform_grid([t], 6.0, 5)
    found = forces_on(grid, [t], [np.sin(t)[:, None]]).values[..., 0]
    measured = (grid.points < 4.0) | (grid.points > 6.0)
    assert np.allclose(found[measured], np.sin(grid.points)[measured], atol=0.02)
    few = np.linspace(0.0, 1.0, 6)
    grid = uniform_grid([few], 20.0, 5)
    found = forces_on(grid, [few], [few[:, None] ** 3])
    assert np.allclose(found.values[..., 0], grid.points**3)
    assert found.density.tolist() == [0.0]


def test_nothing_acts():
    t = np.linspace(0.0, 1.0, 101)
    grid = uniform_grid([t, t], 8.0, 5)
    assert forces_on(grid, [t, t], [None, None]) is None
    found = forces_on(grid, [t, t], [None, np.ones((101, 1))])
    assert np.all(found.values[grid.owner == 0] == 0.0)
    assert np.allclose(found.values[grid.owner == 1], 1.0)


# ---------------------------------------------------------------------------------------- the law


def within(model, sigmas: float) -> bool:
    assert {t.expression for t in model.terms} == set(TRUTH)
    return all(abs(t.coefficient - TRUTH[t.expression]) < sigmas * t.standard_error for t in model.terms)


def noisy(share: float, seed: int) -> la.Trajectories:
    data = systems.generate("single_pendulum", noise=0.01, trials=5, duration=20.0, seed=seed)
    size = share * np.std(np.concatenate([run.forces for run in data]))
    rng = np.random.default_rng(seed)
    return data.with_forces([run.forces + size * rng.normal(size=run.forces.shape) for run in data])


@pytest.mark.parametrize(("share", "seed"), [(0.3, 300), (1.0, 301), (1.0, 302)])
@pytest.mark.thorough
def test_noise_of_the_forces_does_not_bias_the_scale(share, seed):
    model = la.discover(noisy(share, seed), systems.compact_library("single_pendulum"))
    assert model.fit.status == "ok", model.fit.warnings
    assert within(model, 4.0)
    gravity = next(t for t in model.terms if t.expression == "cos(theta)")
    assert gravity.coefficient == pytest.approx(9.81, rel=0.03)
    if share == 1.0:
        assert findings_of(model, "scatter-of-forces")


@pytest.mark.thorough
def test_noise_of_the_forces_excuses_no_missing_term():
    library = [t.text for t in systems.compact_library("single_pendulum").terms if t.text != "cos(theta)"]
    assert la.discover(noisy(0.3, 300), library).fit.status == "doubtful"


def held(seed: int, rate: float = 100.0, duration: float = 20.0) -> list[la.Trajectory]:
    """Pendulums whose torque jumps now and then, as a switching controller's does."""
    rng, substeps, runs = np.random.default_rng(seed), 4, []
    for _ in range(5):
        n = int(duration * rate)
        lengths = rng.uniform(0.3, 1.5, 80)
        jumps = np.searchsorted(np.cumsum(lengths), np.arange(n + 1) / rate)
        torque = rng.choice([-3.0, 0.0, 3.0], 81)[jumps]
        y, path, h = np.array([rng.uniform(-1.0, 1.0), 0.0]), [], 1.0 / rate / substeps
        for u in torque:
            path.append(y[0])

            def slope(y, u=u):
                return np.array([y[1], u - 9.81 * np.sin(y[0])])

            for _ in range(substeps):
                k1 = slope(y)
                k2 = slope(y + 0.5 * h * k1)
                k3 = slope(y + 0.5 * h * k2)
                y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + slope(y + h * k3))
        q = np.array(path)
        measured = q + 0.01 * q.std() * rng.normal(size=q.size)
        t = np.arange(n + 1) / rate
        runs.append(la.Trajectory(t, measured, torque[:, None], coordinates=["theta"]))
    return runs


@pytest.mark.parametrize("seed", [1, 2])
def test_forces_that_jump(seed):
    library = la.Library([*TRUTH, "theta_dot**4", "sin(theta)", "cos(2*theta)", "theta"], ["theta"])
    model = la.discover(held(seed), library)
    assert model.fit.status == "ok", model.fit.warnings
    assert within(model, 4.0)


def stamped_late(seed: int) -> la.Trajectories:
    """Torques stamped one sample, 10 ms, after they acted."""
    data = systems.generate("single_pendulum", noise=0.003, trials=4, duration=20.0, seed=seed)
    return la.Trajectories([run.rows(slice(1, None)).changed(forces=run.forces[:-1]) for run in data])


@pytest.mark.parametrize("seed", [4, 5])
def test_a_delay_that_friction_could_hide_is_named(seed):
    library, friction = systems.compact_library("single_pendulum"), ["theta_dot**2/2"]
    model = la.discover(stamped_late(seed), library, dissipation=friction)
    assert model.fit.status == "usable"
    (late,) = findings_of(model, "late-forces")
    assert late.values["delay"] == pytest.approx(-0.01, rel=0.2)
    assert not late.values["half_a_sample"]
    cured = la.delay.shift_forces(stamped_late(seed), -0.01)
    assert la.discover(cured, library, dissipation=friction).fit.status == "ok"


def test_a_half_sample_reads_as_held():
    data = systems.generate("single_pendulum", noise=0.001, trials=4, duration=20.0, seed=6)
    early = la.delay.shift_forces(data, -0.005)
    model = la.discover(early, systems.compact_library("single_pendulum"))
    (late,) = findings_of(model, "late-forces")
    assert late.values["half_a_sample"]
