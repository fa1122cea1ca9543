"""The delay between coordinates and forces, on simulated delays and where it cannot be known."""

import numpy as np
import pytest

import leastaction as la
from leastaction import DataError, InputError
from leastaction.delay import estimate, shift_forces
from leastaction.model.model import LagrangianModel, ModelTerm

PENDULUM = ["theta_dot**2", "cos(theta)", "sin(theta)", "theta_dot**4"]


def pendulum(noise, seed=0):
    return la.systems.generate("single_pendulum", noise=noise, trials=2, duration=10.0, seed=seed)


@pytest.mark.parametrize("delay", [0.0, 0.02, pytest.param(0.05, marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    ("noise", "width"), [(0.01, 0.001), pytest.param(0.1, 0.008, marks=pytest.mark.thorough)]
)
def test_simulated_delays(delay, noise, width):
    recorded = shift_forces(pendulum(noise), -delay)
    found = estimate(recorded, PENDULUM)
    assert found.determined
    assert found.reason == ""
    assert 0.1 * width < found.standard_error < width
    assert abs(found.delay - delay) < 3.5 * found.standard_error
    assert {term.expression for term in found.model.terms} == {"theta_dot**2", "cos(theta)"}
    assert found.log_likelihood.max() == 0.0
    assert np.all(np.diff(found.delays) > 0)
    # The shifted data are those that a discovery needs.
    expected = shift_forces(recorded, found.delay)
    assert found.trajectories.digest() == expected.digest()
    assert f"{1e3 * found.delay:.3g} ±" in repr(found)


@pytest.mark.slow
def test_standard_error_covers_the_truth():
    """Eight data sets: the errors in units of their standard errors are of size one."""
    delays = np.linspace(-0.04, 0.04, 8)
    z = []
    for seed, delay in enumerate(delays):
        found = estimate(shift_forces(pendulum(0.02, seed), -delay), PENDULUM, max_delay=0.06)
        assert found.determined
        z.append((found.delay - delay) / found.standard_error)
    # The 99.9 % range of a mean of eight squares.
    assert 0.05 < np.mean(np.square(z)) < 3.3


def test_a_delay_beyond_the_range_is_not_believed():
    found = estimate(shift_forces(pendulum(0.01), -0.08), PENDULUM, max_delay=0.05)
    assert not found.determined
    assert "raise max_delay" in found.reason
    assert found.standard_error == np.inf
    assert "not determined" in repr(found)


def test_a_constant_force_tells_nothing(rng):
    """The honest answer to a flat likelihood; the data come back as they were."""
    model = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
    t = np.arange(0.0, 8.0, 0.01)
    motion = model.simulate([1.0], [0.0], t, forces=lambda _: np.array([0.7])).q
    noisy = motion + 0.01 * rng.standard_normal(motion.shape)
    data = la.Trajectories([la.Trajectory(t, noisy, np.full_like(noisy, 0.7), ["x"])])
    found = estimate(data, ["x_dot**2", "x**2", "x**4"])
    assert not found.determined
    assert "hardly depends on it" in found.reason
    assert np.ptp(found.log_likelihood) < 4.0
    assert found.trajectories.digest() == data.digest()


@pytest.mark.thorough
def test_a_periodic_force_fits_at_several_delays(rng):
    model = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -20.0)])
    t = np.arange(0.0, 4.0, 0.005)

    def force(time):
        return 200.0 * np.sin(2 * np.pi * np.asarray(time) / 0.15)

    motion = model.simulate([0.1], [0.0], t, forces=lambda time: np.array([force(time)])).q
    noisy = motion + 0.001 * rng.standard_normal(motion.shape)
    data = la.Trajectory(t, noisy, force(t)[:, np.newaxis], ["x"])
    found = estimate(data, ["x_dot**2", "x**2"], max_delay=0.2)
    assert not found.determined
    assert "explain the data alike" in found.reason
    one_period = estimate(data, ["x_dot**2", "x**2"], max_delay=0.06)
    assert one_period.determined
    assert abs(one_period.delay) < 4.0 * one_period.standard_error


def test_bad_arguments():
    data = pendulum(0.01)
    for wrong in (0.0, -0.1, np.nan, True):
        with pytest.raises(InputError, match="max_delay is"):
            estimate(data, PENDULUM, max_delay=wrong)
    with pytest.raises(DataError, match=r"the shortest trial has 10 s.*at most 1.2 s"):
        estimate(data, PENDULUM, max_delay=2.0)
    passive = [la.Trajectory(run.t, run.q, None, run.coordinates) for run in data]
    with pytest.raises(DataError, match="no force acts"):
        estimate(passive, PENDULUM, {"theta_dot**2": 0.5})


def test_shifted_forces_are_those_of_another_time():
    t = np.sort(np.r_[0.0, 2.0, np.linspace(0.003, 1.997, 200)])
    forces = np.column_stack([np.sin(3 * t), np.zeros(t.size)])
    q = np.column_stack([t, -t])
    runs = la.Trajectories(
        [la.Trajectory(t, q, forces, ["a", "b"], "driven"), la.Trajectory(t, q, None, ["a", "b"])]
    )
    for delay in (0.0, 0.13, -0.13):
        shifted = shift_forces(runs, delay)
        assert shifted.names == ("driven", "1")
        there = shifted[0].t
        np.testing.assert_allclose(shifted[0].forces[:, 0], np.sin(3 * (there - delay)), atol=1e-6)
        np.testing.assert_array_equal(shifted[0].q[:, 0], there)
        assert shifted[1].forces is None
        assert there[0] >= max(delay, 0.0)
        assert there[-1] <= 2.0 + min(delay, 0.0)
    cut = shift_forces(runs, 0.05, margin=0.2)
    assert cut[0].t[0] >= 0.2
    assert cut[0].t[-1] <= 1.8
    with pytest.raises(InputError, match="leaves nothing of trial 'driven'"):
        shift_forces(runs, 5.0)
    with pytest.raises(InputError, match="expected a finite number"):
        shift_forces(runs, np.nan)
