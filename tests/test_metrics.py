from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from leastaction import metrics as _metrics
from leastaction import systems
from leastaction.errors import DataError, InputError
from leastaction.metrics import (
    cramer_rao_bound,
    exact_support,
    forecast_horizon,
    l2_error,
    precision,
    recall,
)


@pytest.fixture(autouse=True)
def _warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_l2_error_over_the_union_of_supports():
    true = {"a": 3.0, "b": 4.0}
    assert l2_error(true, true) == 0.0
    assert l2_error({}, true) == 1.0
    assert l2_error({"a": 3.0, "c": 5.0}, true) == pytest.approx(np.sqrt(16 + 25) / 5)
    assert l2_error({"x_dot * y": 1.0}, {"x_dot*y": 2.0}) == 0.5
    assert l2_error([3.0, 0.0, 1.0], [3.0, 4.0, 0.0]) == pytest.approx(np.sqrt(17) / 5)
    assert l2_error({"a": 9.0, "b": 4.4}, true, exclude=["a"]) == pytest.approx(0.1)
    with pytest.raises(InputError, match="all zero"):
        l2_error({"a": 1.0}, {"a": 0.0})


def test_precision_and_recall():
    true = {"a": 1.0, "b": 2.0, "c": 0.0}
    found = {"a": 0.9, "c": 0.1, "d": 0.2, "e": 0.0}
    assert precision(found, true) == pytest.approx(1 / 3)
    assert recall(found, true) == 0.5
    assert (precision({}, true), recall({}, true)) == (0.0, 0.0)
    assert recall(found, {}) == 1.0
    assert precision(found, true, exclude=["d"]) == 0.5
    assert not exact_support(found, true)
    assert exact_support({"a": 5.0, "b": 1.0}, true)
    assert exact_support([0.0, 1.0], [0.0, 3.0])


def test_forecast_horizon():
    t = np.arange(5) * 0.5
    true = np.column_stack([np.zeros(5), np.arange(5.0)])
    predicted = true + np.array([[0, 0], [0.1, 0], [0, 0.3], [0, 0], [0, 0]])
    assert forecast_horizon(t, predicted, true, 0.2) == 0.5
    assert forecast_horizon(t, predicted, true, [0.05, 1.0]) == 0.0
    assert forecast_horizon(t, predicted, true, 1.0) == 2.0
    assert forecast_horizon(t, predicted[:4], true, 1.0) == 1.5  # a simulation that stopped
    unknown = true.copy()
    unknown[2, 1] = np.nan
    assert forecast_horizon(t, predicted, unknown, 0.2) == 2.0
    assert forecast_horizon(t, predicted + np.array([0, 2 * np.pi]), true, 0.4, periodic=[1]) == 2.0
    with pytest.raises(InputError, match="shapes"):
        forecast_horizon(t, predicted[:, :1], true, 1.0)


def by_differences(system, truth, sigma, terms, seen):
    """The bound from central differences of simulated motions: no variational equations, no filter."""
    n, p = system.n_dof, len(terms)
    information = np.zeros((p, p))
    for motion, mask in zip(truth, seen, strict=True):
        start = np.concatenate([motion.q[0], motion.qdot[0]])

        def positions(change, motion=motion, mask=mask, start=start):
            def moved(coefficients):
                step = dict(zip(terms, change[2 * n :], strict=True))
                return {k: c + step.get(k, 0.0) for k, c in coefficients.items()}

            other = replace(
                system, lagrangian=moved(system.lagrangian), dissipation=moved(system.dissipation)
            )
            y0 = start + change[: 2 * n]
            result = other.simulate(y0[:n], y0[n:], motion.t, motion.drive, rtol=1e-12, atol=1e-12)
            return (result.q / sigma)[mask]

        steps = 1e-5 * np.eye(2 * n + p)
        jacobian = np.stack([(positions(s) - positions(-s)) / 2e-5 for s in steps], axis=1)
        fisher = jacobian.T @ jacobian
        state, mixed = fisher[: 2 * n, : 2 * n], fisher[: 2 * n, 2 * n :]
        information += fisher[2 * n :, 2 * n :] - mixed.T @ np.linalg.pinv(state, rcond=1e-9) @ mixed
    return np.linalg.inv(information)


@pytest.mark.parametrize(
    ("name", "friction"),
    [
        ("single_pendulum", {"theta_dot**2/2": 0.1}),
        ("cart_spring_pendulum", {}),
        ("magnetic_pendulum", {"(x_dot**2+y_dot**2)/2": 0.05}),
    ],
)
def test_bound_agrees_with_finite_differences(name, friction):
    system = systems.get(name).with_dissipation(friction)
    truth = systems.simulate_truth(system, trials=2, duration=2.0, rate=50.0, seed=1)
    sigma = systems.noise_std(system, truth, 0.1)
    observed = systems.measure(system, truth, sigma, seed=1, missing=0.2)
    bound = cramer_rao_bound(system, truth, sigma, observed=observed)
    seen = [np.isfinite(trajectory.q) for trajectory in observed]
    expected = by_differences(system, truth, sigma, system.free, seen)
    assert bound.terms == system.free
    assert not set(bound.terms) & set(system.known)
    assert np.allclose(bound.covariance, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())
    scale = np.linalg.norm([{**system.lagrangian, **friction}[k] for k in system.free])
    assert bound.relative == pytest.approx(np.sqrt(np.trace(expected)) / scale, rel=1e-4)
    assert np.allclose(bound.standard_errors**2, np.diag(expected), rtol=1e-3)


def test_bound_when_a_cyclic_angle_is_not_measured():
    system = systems.get("spherical_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=4.0, rate=50.0, seed=2)
    observed = systems.measure(system, truth, 0.05)
    blind = [replace_q(observed[0], [1.0, np.nan])]
    bound = cramer_rao_bound(system, truth, 0.05, observed=blind)
    expected = by_differences(system, truth, 0.05, system.free, [np.isfinite(blind[0].q)])
    assert np.allclose(bound.covariance, expected, rtol=1e-3)


def replace_q(trajectory, factor):
    return type(trajectory)(
        trajectory.t,
        trajectory.q * factor,
        forces=trajectory.forces,
        coordinates=trajectory.coordinates,
    )


def test_bound_scales_with_noise_and_falls_with_data():
    system = systems.get("single_pendulum")
    truth = systems.simulate_truth(system, trials=3, duration=4.0, seed=0)
    small, large = (cramer_rao_bound(system, truth, s).relative for s in (0.01, 0.02))
    assert large == pytest.approx(2 * small)
    assert cramer_rao_bound(system, truth[:1], 0.01).relative > small
    holes = systems.generate("single_pendulum", trials=3, duration=4.0, seed=0, missing=0.5)
    assert cramer_rao_bound(system, truth, 0.01, observed=holes).relative > 1.2 * small


@pytest.mark.parametrize("name", ["double_pendulum", "magnetic_pendulum"])
def test_bound_survives_chaos(name, monkeypatch):
    truth = systems.simulate_truth(name, trials=1, duration=20.0, seed=0)
    bound = cramer_rao_bound(systems.get(name), truth, 0.05).relative
    for joint, segment in ((1e5, 0.2), (1e12, 0.2), (1e8, 0.05), (1e8, 0.5)):
        monkeypatch.setattr(_metrics, "_JOINT", joint)
        monkeypatch.setattr(_metrics, "_SEGMENT", segment)
        other = cramer_rao_bound(systems.get(name), truth, 0.05).relative
        assert other == pytest.approx(bound, rel=2e-3)


def test_bound_says_when_data_do_not_determine_the_terms():
    system = systems.get("magnetic_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=2.0, seed=0)
    with pytest.raises(DataError, match="do not determine"):
        cramer_rao_bound(system, truth, 0.1, unknown=tuple(system.lagrangian))
    assert cramer_rao_bound(system, truth, 0.1, unknown=["x**2"]).covariance.shape == (1, 1)


@pytest.mark.parametrize(
    "options",
    [
        {"noise_std": 0.0},
        {"noise_std": [0.1, np.nan]},
        {"unknown": []},
        {"unknown": ["x**7"]},
        {"observed": []},
    ],
)
def test_bound_refuses_wrong_arguments(options):
    system = systems.get("magnetic_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=0.1, seed=0)
    with pytest.raises(InputError):
        cramer_rao_bound(system, truth, **{"noise_std": 0.1, **options})
