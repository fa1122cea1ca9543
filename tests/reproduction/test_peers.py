"""The paper's method, and peers written afresh: xL-SINDy, Lagrangian-SINDy by energy and RK4-SINDy."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

import leastaction as la
from leastaction import systems
from reproduction.methods import _dictionary, _lagrangian, _subsets, _xlsindy, adam, load
from reproduction.problem import Case, pose


def posed(method, system="single_pendulum", noise=0.0, **options):
    options.setdefault("trajectories", 2)
    return pose(Case(system, noise, method, **options))


def true_states(problem):
    motion = problem.truth[0]
    return motion.q, motion.qdot, motion.forces, motion.qddot


def l2(problem, found):
    free = {k: v for k, v in problem.true_coefficients.items() if k not in problem.known}
    difference = [free.get(k, 0.0) - found.get(k, 0.0) for k in {*free, *found}]
    return np.linalg.norm(difference) / np.linalg.norm(list(free.values()))


@pytest.fixture
def brief(monkeypatch):
    monkeypatch.setattr(_xlsindy, "EPOCHS", 100)
    monkeypatch.setattr(_xlsindy, "PENALTIES", (1e-4, 1e-2))
    monkeypatch.setattr(_xlsindy, "THRESHOLDS", (0.1,))


@pytest.mark.parametrize("name", ["double_pendulum", "cart_spring_pendulum"])
def test_acceleration_of_true_coefficients(name):
    problem = posed("energy", name)
    q, qdot, forces, qddot = true_states(problem)
    acceleration = _lagrangian.acceleration_of(problem.library, problem.true_coefficients)
    assert acceleration(q, qdot, forces) == pytest.approx(qddot, rel=1e-8, abs=1e-8)


def test_acceleration_is_nan_only_where_the_mass_matrix_is_singular():
    library = la.Library(["x_dot**2*x", "x**2"], ["x"])
    acceleration = _lagrangian.acceleration_of(library, {"x_dot**2*x": 1.0, "x**2": -1.0})
    found = acceleration([[0.0], [2.0], [np.inf]], [[1.0], [0.0], [0.0]], None)
    # 2 x ẍ + ẋ² + 2 x = 0
    assert np.isnan(found[[0, 2]]).all()
    assert found[1] == pytest.approx(-1.0)
    empty = _lagrangian.acceleration_of(library, {})
    assert np.isnan(empty([[1.0]], [[1.0]])).all()


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize("name", ["single_pendulum", "magnetic_pendulum"])
def test_xlsindy_finds_exact_motions_exactly(name):
    problem = posed("xlsindy_exact", name)
    answer = load("xlsindy_exact").solve(problem)
    assert set(answer.coefficients) | set(problem.known) == set(problem.true_coefficients)
    assert l2(problem, answer.coefficients) < 3e-3
    q, qdot, forces, qddot = true_states(problem)
    error = answer.acceleration(q, qdot, forces) - qddot
    assert np.linalg.norm(error) < 1e-2 * np.linalg.norm(qddot)


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize("name", ["xlsindy_positions", "ours"])
def test_history_ends_in_the_answer(name):
    answer = load(name).solve(posed(name))
    seconds = [t for t, _ in answer.history]
    assert len(seconds) > 3
    assert seconds == sorted(seconds)
    assert answer.history[-1][1] == answer.coefficients
    assert answer.history[0][1] != answer.coefficients


@pytest.mark.usefixtures("brief")
def test_xlsindy_ends_in_least_squares():
    problem = posed("xlsindy_exact", "magnetic_pendulum", noise=0.02)
    states = load("xlsindy_exact").states(problem)
    answer = load("xlsindy_exact").solve(problem)
    columns = np.concatenate([la.euler_lagrange(problem.library, *s.swapaxes(0, 1)) for s, _ in states])
    columns = columns.reshape(-1, len(problem.library))
    kept = [problem.library.index(text) for text in answer.coefficients]
    (known,) = problem.known.items()
    target = -known[1] * columns[:, problem.library.index(known[0])]
    expected = np.linalg.lstsq(columns[:, kept], target, rcond=None)[0]
    assert list(answer.coefficients.values()) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("convention", ["relative", "absolute"])
def test_xlsindy_exact_is_given_noise_of_the_level_on_all_channels(convention):
    problem = posed("xlsindy_exact", "double_pendulum", 0.05, noise_convention=convention, missing=0.1)
    states = np.concatenate([s for s, _ in load("xlsindy_exact").states(problem)])
    kept = [np.isfinite(measured.q).all(axis=1) for measured in problem.data]
    for place, name in ((1, "qdot"), (2, "qddot")):
        exact = [getattr(motion, name) for motion in problem.truth]
        spread = np.concatenate(exact).std(axis=0) if convention == "relative" else 1.0
        exact = np.concatenate([e[k] for e, k in zip(exact, kept, strict=True)])
        assert (states[:, place] - exact).std(axis=0) == pytest.approx(0.05 * spread * np.ones(2), rel=0.05)
    assert np.isfinite(states).all()


def test_best_supports_match_an_exhaustive_search():
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((80, 6)) @ (np.eye(6) + 0.3 * rng.standard_normal((6, 6)))
    target = columns[:, [1, 4]] @ [1.0, -2.0] + 0.3 * rng.standard_normal(80)
    normal = _subsets.Normal.of(columns[:40], target[:40]) + _subsets.Normal.of(columns[40:], target[40:])
    for size, found in enumerate(_subsets.best_supports(normal, 4, width=20), 1):

        def misfit(support):
            x = np.linalg.lstsq(columns[:, support], target, rcond=None)[0]
            return np.sum((columns[:, support] @ x - target) ** 2) / np.sum(target**2)

        best = min(itertools.combinations(range(6), size), key=lambda s: misfit(list(s)))
        assert found == best
        assert normal.misfit(normal.solve(found)) == pytest.approx(misfit(list(best)))


@pytest.mark.parametrize("name", ["double_pendulum", "cart_spring_pendulum"])
def test_energy_finds_exact_motions_exactly(name):
    problem = posed("energy", name)
    answer = load("energy").solve(problem)
    assert set(answer.coefficients) | set(problem.known) == set(problem.true_coefficients)
    assert l2(problem, answer.coefficients) < 1e-3
    q, qdot, forces, qddot = true_states(problem)
    assert answer.acceleration(q, qdot, forces) == pytest.approx(qddot, abs=2e-2)


def test_energy_balances_the_true_energy_against_the_work():
    problem = posed("energy", "double_pendulum")
    module = load("energy")
    texts, pieces, scale = module._balances(problem)
    true = np.array([problem.true_coefficients.get(text, 0.0) for text in texts]) / scale
    for columns, target in pieces:
        assert columns @ true == pytest.approx(target, abs=1e-2)
    motion = problem.truth[0]
    energies = np.stack([f(*motion.q.T, *motion.qdot.T) for f in module._energies(problem.library)], axis=1)
    weights = [problem.true_coefficients.get(term.text, 0.0) for term in problem.library]
    assert energies @ weights == pytest.approx(problem.system.energy(motion.q, motion.qdot))


def test_energy_cannot_see_terms_linear_in_the_velocities():
    texts, _, _ = load("energy")._balances(posed("energy", "magnetic_pendulum"))
    assert "x*y_dot" not in texts
    assert "x_dot*y_dot" in texts


def test_rk4_sindy_finds_the_pendulum():
    problem = posed("rk4_sindy")
    answer = load("rk4_sindy").solve(problem)
    assert answer.coefficients is None
    assert answer.settings["terms"] == 2
    assert "sin(theta)" in answer.expression
    assert "f_theta" in answer.expression
    q, qdot, forces, qddot = true_states(problem)
    assert answer.acceleration(q, qdot, forces) == pytest.approx(qddot, abs=1e-3)
    unforced = systems.get("single_pendulum").acceleration([[0.4]], [[0.0]])
    assert answer.acceleration(np.array([[0.4]]), np.zeros((1, 1)), None) == pytest.approx(unforced, abs=1e-3)


def test_rk4_sindy_steps_as_the_classical_formula():
    """ẍ = −x: one step of the stages equals the Taylor polynomial of degree four."""
    module, h = load("rk4_sindy"), 0.3
    dictionary = _dictionary.Dictionary(["x"], [], False, 1, 1)
    xi = np.zeros((len(dictionary), 1))
    xi[dictionary.names.index("x")] = -1.0
    x, v = np.array([[0.7]]), np.array([[-0.2]])
    steps = module.Steps(x, v, x, v, (None, None, None), np.array([[h]]))
    found = module._mean_features(dictionary, steps, xi, np.arange(len(dictionary))) @ xi
    taylor = (v * (-(h**2) / 2 + h**4 / 24) - x * (h - h**3 / 6)) / h
    assert found == pytest.approx(taylor, rel=1e-12)


def test_dictionary_values_agree_with_their_names():
    coordinates = ["theta", "phi", "x"]
    dictionary = _dictionary.Dictionary(coordinates, ["theta", "phi"], True, 2, 2)
    assert len(set(dictionary.names)) == len(dictionary)
    assert {"1", "x*x", "f_phi", "x_dot*x_dot*sin(theta-phi)"} <= set(dictionary.names)
    q, qdot, forces = np.random.default_rng(0).standard_normal((3, 1, 3))
    values = dictionary(q, qdot, forces)[0]
    names = [*coordinates, *(f"{c}_dot" for c in coordinates), *(f"f_{c}" for c in coordinates)]
    state = dict(zip(names, np.concatenate([q, qdot, forces], axis=1)[0], strict=True))
    for name, value in zip(dictionary.names, values, strict=True):
        expected = eval(name, {"sin": np.sin, "cos": np.cos}, state)
        assert value == pytest.approx(expected), name


def test_variants_of_the_paper_s_method(monkeypatch):
    def asked(variant):  # candidates and options
        posed = pose(Case("single_pendulum", 0.1, "adam", variant=variant, trajectories=1))
        calls = []
        monkeypatch.setattr(adam.la, "discover", lambda *a, **more: calls.append((*a, more["options"])))
        adam.discover(posed, adam.settings_for(posed), None)
        (data, library, options) = calls[0]
        assert data is posed.data
        return [term.text for term in library], options

    texts, plain = asked("")
    assert len(texts) > 2
    assert asked("true-terms") == (["theta_dot**2", "cos(theta)"], plain)
    assert asked("from-truth")[1].start_coefficients == {"theta_dot**2": 0.5, "cos(theta)": 9.81}
    assert asked("no-regularisation") == (texts, replace(plain, curvature_weight=0.0))
    assert asked("short")[1].iterations == plain.iterations // 10
    with pytest.raises(ValueError, match="variant 'other' is unknown; use no-regularisation, from-truth"):
        asked("other")
