"""The peers that are packages of their own: PySINDy (explicit, implicit, weak form) and Operon."""

from __future__ import annotations

import io
from contextlib import redirect_stdout

import numpy as np
import pytest

ps = pytest.importorskip("pysindy")
pytest.importorskip("cvxpy")
pytest.importorskip("pyoperon")

from reproduction.methods import _pysindy as shared  # noqa: E402
from reproduction.methods import load, operon, sindy, sindy_pi  # noqa: E402
from reproduction.problem import Case, pose  # noqa: E402


def problem_of(system: str, noise: float = 0.0, **options):
    return pose(Case(system, noise, "sindy", **{"trajectories": 2, **options}))


def acceleration_error(acceleration, problem) -> float:
    """Relative to the size of the true accelerations, along the true motions."""
    wrong = [acceleration(m.q, m.qdot, m.forces) - m.qddot for m in problem.truth]
    return np.linalg.norm(np.concatenate(wrong)) / np.linalg.norm(
        np.concatenate([m.qddot for m in problem.truth])
    )


@pytest.mark.parametrize("name", ["sindy", "sindy_pi", "sindy_weak"])
def test_pysindy_finds_the_driven_pendulum(name, monkeypatch):
    problem = problem_of("single_pendulum")
    monkeypatch.setattr(sindy, "HALF_WIDTHS", (0.1,))
    answer = load(name).solve(problem)
    assert acceleration_error(answer.acceleration, problem) < 1e-5
    assert answer.coefficients is None
    assert answer.status == "ok"
    assert "theta_ddot" in answer.expression
    assert "sin(1 theta)" in answer.expression
    assert "f_theta" in answer.expression


def test_pysindy_is_told_the_magnets():
    problem = problem_of("magnetic_pendulum", trajectories=1)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    library, features, targets = shared.regression(problem, motions)
    found = np.linalg.lstsq(features, targets, rcond=None)[0].T
    assert acceleration_error(shared.model_acceleration(library, found), problem) < 1e-3


def test_implicit_equations_are_exactly_the_true_ones():
    problem = problem_of("double_pendulum", trajectories=5)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    features = sindy_pi._features(problem, motions)
    regression = sindy_pi.Regression("l1, refitted", 1e-5)
    settings = [sindy_pi.Setting(i, 0, "all", regression) for i in range(2)]
    with redirect_stdout(io.StringIO()):
        found = sindy_pi._regress(features, settings)
    rows = np.array([found[setting] for setting in settings])
    np.testing.assert_array_equal(np.count_nonzero(rows, axis=1), [5, 5])
    acceleration = sindy_pi._acceleration(features, rows)
    assert acceleration_error(acceleration, problem) < 1e-3
    lines = sindy_pi._equations(problem, features, settings, rows).splitlines()
    assert "theta2_ddot cos(1 theta1-1 theta2)" in lines[0]
    lost = acceleration(np.full((1, 2), np.nan), np.zeros((1, 2)), np.zeros((1, 2)))
    assert np.isnan(lost).all()


def test_smoothing_follows_the_noise():
    quiet, loud = (
        shared.choose_smoothers(problem_of("single_pendulum", noise).data)[0] for noise in (0.0, 0.1)
    )
    assert quiet.window <= 11
    assert loud.window >= 41


def test_missing_samples_are_filled():
    problem = problem_of("single_pendulum", missing=0.05)
    assert np.isnan(problem.data[0].q).any()
    smoothers = shared.choose_smoothers(problem.data)
    motion = shared.differentiate(problem.data, smoothers)[0]
    truth = problem.truth[0]
    here = np.searchsorted(truth.t, motion.t)
    assert np.abs(motion.q - truth.q[here]).max() < 1e-4
    assert np.abs(motion.qdot - truth.qdot[here]).max() < 1e-2


def test_forecasts_tell_good_models_from_bad_ones():
    problem = problem_of("single_pendulum", 0.02, missing=0.05)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    true = shared.forecast_error(problem.system.acceleration, motions)
    wrong = shared.forecast_error(lambda q, v, f: 0.5 * problem.system.acceleration(q, v, f), motions)
    none = shared.forecast_error(lambda q, v, f: np.full(q.shape, np.nan), motions)
    assert true < 0.1 < wrong < none
    assert none == pytest.approx(10.0)


def test_many_forecasts_at_once_are_the_same():
    problem = problem_of("double_pendulum", 0.02)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    library, features, targets = shared.regression(problem, motions)
    assert len(library.get_feature_names(shared.names(problem))) == features.shape[1]
    models = np.array([np.linalg.lstsq(features[a::3], targets[a::3], rcond=None)[0].T for a in range(3)])
    one_by_one = [shared.forecast_error(shared.model_acceleration(library, m), motions[:1]) for m in models]
    np.testing.assert_allclose(shared.forecast_errors(library, models, motions[:1]), one_by_one, rtol=1e-6)


def test_compressed_data_have_the_same_solution():
    rng = np.random.default_rng(0)
    features = rng.standard_normal((400, 12))
    targets = features[:, :2] @ rng.standard_normal((2, 3)) + 0.1 * rng.standard_normal((400, 3))
    full, small = (
        ps.STLSQ(threshold=0.05, alpha=0.5, normalize_columns=True, unbias=False).fit(*data).coef_
        for data in ((features, targets), shared.compress(features, targets))
    )
    assert np.count_nonzero(full) > 0
    np.testing.assert_allclose(small, full, atol=1e-10)


def test_simplest_model_of_the_best():
    assert shared.simplest(np.array([1.0, 1.005, 1.2]), np.array([9, 3, 1])) == 1


def test_one_trajectory_is_split_into_fifths():
    problem = problem_of("single_pendulum", trajectories=1)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    for train, test in shared.folds(motions):
        assert len(train) == 4
        assert not set(test[0].t) & set(np.concatenate([m.t for m in train]))


def test_operon_finds_the_driven_pendulum_and_repeats_itself():
    problem = problem_of("single_pendulum")
    options = {"population_size": 300, "generations": 15}
    first, second = (operon.solve(problem, **options) for _ in range(2))
    assert acceleration_error(first.acceleration, problem) < 0.05
    assert first.expression == second.expression
    assert first.expression.startswith("theta_ddot = ")
    assert first.coefficients is None
    lost = first.acceleration(np.array([[np.nan]]), np.zeros((1, 1)), np.zeros((1, 1)))
    assert np.isnan(lost).all()


def test_operon_with_given_rates():
    options = {"population_size": 300, "generations": 15}
    given = operon.solve(problem_of("single_pendulum", 0.01, variant="given-rates"), **options)
    assert given.settings["generations"] == 15
    assert acceleration_error(given.acceleration, problem_of("single_pendulum")) < 0.05
    with pytest.raises(ValueError, match="variant 'other' is unknown; use given-rates"):
        operon.solve(problem_of("single_pendulum", variant="other"))


def test_operon_is_given_a_root_when_the_library_has_one():
    problem = problem_of("magnetic_pendulum", trajectories=1)
    answer = operon.solve(problem, population_size=20, generations=1)
    assert answer.settings["allowed_symbols"].endswith(",sqrt")
