from __future__ import annotations

import warnings

import numpy as np
import pytest

from leastaction.errors import InputError
from leastaction.simulation.integrate import rk4, simulate

T = np.linspace(0.0, 2.0, 21)


def spring(q, qdot, forces):
    return -q if forces is None else forces - q


@pytest.fixture(autouse=True)
def _warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_rk4_integrates_a_batch_with_error_of_fourth_degree():
    q0 = np.array([[1.0], [2.0], [-0.5]])
    errors = []
    for substeps in (1, 2):
        q, qdot = rk4(spring, q0, 0 * q0, T, substeps)
        assert q.shape == qdot.shape == (21, 3, 1)
        errors.append(np.abs(q[..., 0] - np.cos(T)[:, None] * q0[:, 0]).max())
    assert errors[1] < 1e-6
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1)


def test_rk4_with_forces_and_uneven_times():
    t = np.sort(np.random.default_rng(0).uniform(0, 2, 30))
    q, qdot = rk4(spring, [0.0], [1.0], t, 8, forces=lambda times: np.sin(2 * times)[:, None])
    # q̈ + q = sin 2t from q(t0) = 0, q̇(t0) = 1
    s = t - t[0]
    particular, rate = -np.sin(2 * t) / 3, -2 * np.cos(2 * t) / 3
    exact = particular - particular[0] * np.cos(s) + (1 - rate[0]) * np.sin(s)
    assert np.abs(q[:, 0] - exact).max() < 1e-8
    assert qdot[0, 0] == 1.0


def test_rk4_does_not_raise_when_a_motion_diverges():
    q, _ = rk4(lambda q, v, f: q**5, [[1.0], [30.0]], [[0.0], [0.0]], np.linspace(0, 0.5, 6), 5)
    assert np.isfinite(q[:, 0]).all()
    assert not np.isfinite(q[-1, 1]).all()


@pytest.mark.parametrize("bad", [[], [0.0, 0.0], [1.0, 0.5], [0.0, np.nan], [[0.0, 1.0]]])
def test_times_are_checked(bad):
    with pytest.raises(InputError, match="t "):
        rk4(spring, [1.0], [0.0], bad)
    with pytest.raises(InputError, match="t "):
        simulate(spring, [1.0], [0.0], bad)


def test_simulate_is_accurate_and_complete():
    result = simulate(spring, [1.0], [0.0], T, rtol=1e-11, atol=1e-11)
    assert (result.status, result.reason, result.complete) == ("complete", "", True)
    assert np.abs(result.q[:, 0] - np.cos(T)).max() < 1e-9
    assert np.abs(result.qdot[:, 0] + np.sin(T)).max() < 1e-9
    assert result.stop_time == T[-1]


def test_a_single_time_returns_the_start():
    result = simulate(spring, [1.0], [0.5], [3.0], forces=[[0.0]])
    assert result.complete
    assert (result.q.tolist(), result.qdot.tolist()) == ([[1.0]], [[0.5]])


def test_force_samples_are_joined_by_a_spline():
    t = np.linspace(0.0, 2.0, 101)
    from_samples = simulate(spring, [0.0], [0.0], t, np.sin(3 * t)[:, None])
    from_function = simulate(spring, [0.0], [0.0], t, lambda time: [np.sin(3 * time)])
    assert np.abs(from_samples.q - from_function.q).max() < 1e-7


def test_blow_up_in_finite_time_stops_with_what_was_reached():
    result = simulate(lambda q, v, f: 6 * q**2, [1.0], [2.0], np.linspace(0, 2, 41))  # q = 1/(1-t)²
    assert result.status == "stopped"
    assert result.reason.startswith("blow-up")
    assert 0.9 < result.t[-1] < 1.0
    assert np.isfinite(result.q).all()
    assert len(result.t) == len(result.q) == len(result.qdot)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_acceleration_that_is_not_finite_stops(value):
    result = simulate(lambda q, v, f: np.full(1, value), [1.0], [0.0], T)
    assert result.reason.startswith("blow-up")
    assert len(result.t) == 1
    later = simulate(lambda q, v, f: np.where(q < 0, value, -q), [1.0], [0.0], T)
    assert later.reason.startswith("blow-up")
    assert later.t[-1] == pytest.approx(1.5)


def test_step_limit_bounds_the_evaluations():
    result = simulate(lambda q, v, f: -1e8 * q, [1.0], [0.0], T, max_steps=50)
    assert result.reason.startswith("step limit")
    assert result.n_evaluations <= 16 * 50 + 1


def test_singular_mass_matrix_stops():
    def mass(q, qdot):
        return np.array([[0.5 - q[0]]])

    def acceleration(q, v, f):
        return np.linalg.solve(mass(q, v), np.array([1.0]))

    result = simulate(acceleration, [0.0], [1.0], T, mass_matrix=mass)
    assert result.status == "stopped"
    at_start = simulate(acceleration, [0.5], [1.0], T, mass_matrix=mass)
    assert at_start.reason.startswith("singular mass matrix")
    raised = simulate(acceleration, [0.5], [1.0], T)  # numpy raises LinAlgError inside
    assert raised.reason.startswith("singular mass matrix")
    # A step may jump over the singular place: the determinant changes its sign.
    jumped = simulate(spring, [0.0], [1.0], T, mass_matrix=mass)
    assert jumped.reason.startswith("singular mass matrix")


def test_the_earliest_event_stops_the_motion():
    def leaves(t, q, qdot):
        return q[0] - 0.5

    result = simulate(spring, [1.0], [0.0], T, events=[lambda t, q, v: q[0], leaves])
    assert result.reason == f"event leaves at t = {np.arccos(0.5):.6g}"
    assert result.stop_time == pytest.approx(np.arccos(0.5), abs=1e-8)
    assert result.t[-1] == pytest.approx(1.0)
    assert simulate(spring, [1.0], [0.0], T, events=leaves).reason == result.reason
    named = simulate(spring, [1.0], [0.0], T, events={"too far": leaves})
    assert "event too far" in named.reason


@pytest.mark.parametrize(
    ("q0", "qdot0", "forces"),
    [([1.0], [0.0, 1.0], None), ([np.nan], [0.0], None), (1.0, 0.0, None), ([1.0], [0.0], np.zeros((5, 1)))],
)
def test_wrong_shapes_are_refused(q0, qdot0, forces):
    with pytest.raises(InputError, match="expected"):
        simulate(spring, q0, qdot0, T, forces)


def test_max_steps_is_checked():
    with pytest.raises(InputError, match="max_steps"):
        simulate(spring, [1.0], [0.0], T, max_steps=0)
    with pytest.raises(InputError, match="substeps"):
        rk4(spring, [1.0], [0.0], T, substeps=0)


def forced(q, qdot, forces, t):
    """ẍ = −x + cos 2t, whatever the forces."""
    return -q + np.cos(2.0 * np.asarray(t))[..., None]


def forced_from_rest(t, begin):
    """The solution that rests at zero at the time ``begin``."""
    particular = [-np.cos(2.0 * time) / 3.0 for time in (t, begin)]
    slope = 2.0 * np.sin(2.0 * begin) / 3.0
    return particular[0] - particular[1] * np.cos(t - begin) - slope * np.sin(t - begin)


def test_simulate_passes_the_time():
    t = np.linspace(1.5, 6.0, 40)
    run = simulate(lambda *a: forced(*a), [0.0], [0.0], t, timed=True, mass_matrix=lambda q, v, t: np.eye(1))
    assert run.complete
    np.testing.assert_allclose(run.q[:, 0], forced_from_rest(t, 1.5), atol=1e-7)
    run = simulate(forced, [0.0], [0.0], t, timed=True, mass_matrix=lambda q, v, t: np.eye(1) * (t - 3.0))
    assert run.reason.startswith("singular mass matrix at t = 3.")


def test_rk4_gives_each_motion_its_own_time():
    t, begin = np.linspace(0.0, 4.0, 81), np.array([0.0, 0.7, 11.3])
    q, _ = rk4(forced, np.zeros((3, 1)), np.zeros((3, 1)), t, clock=begin)
    for k, start in enumerate(begin):
        np.testing.assert_allclose(q[:, k, 0], forced_from_rest(t + start, start), atol=1e-7)
