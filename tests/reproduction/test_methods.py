"""The paper's method, and peers written afresh: xL-SINDy, Lagrangian-SINDy by energy, RK4-SINDy; and uDSR."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import leastaction as la
from leastaction import systems
from reproduction._execute import execute
from reproduction.methods import _symbolic, adam, load, xlsindy
from reproduction.methods.energy import Normal, best_supports
from reproduction.methods.rk4_sindy import Dictionary
from reproduction.problem import Case, acceleration_of, pose
from reproduction.run import main


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
    monkeypatch.setattr(xlsindy, "EPOCHS", 100)
    monkeypatch.setattr(xlsindy, "PENALTIES", (1e-4, 1e-2))
    monkeypatch.setattr(xlsindy, "THRESHOLDS", (0.1,))


@pytest.mark.parametrize("name", ["double_pendulum", "cart_spring_pendulum"])
def test_acceleration_of_true_coefficients(name):
    problem = posed("energy", name)
    q, qdot, forces, qddot = true_states(problem)
    acceleration = acceleration_of(problem.library, problem.true_coefficients)
    assert acceleration(q, qdot, forces) == pytest.approx(qddot, rel=1e-8, abs=1e-8)


def test_acceleration_is_nan_only_where_the_mass_matrix_is_singular():
    library = la.Library(["x_dot**2*x", "x**2"], ["x"])
    acceleration = acceleration_of(library, {"x_dot**2*x": 1.0, "x**2": -1.0})
    found = acceleration([[0.0], [2.0], [np.inf]], [[1.0], [0.0], [0.0]], None)
    # 2 x ẍ + ẋ² + 2 x = 0
    assert np.isnan(found[[0, 2]]).all()
    assert found[1] == pytest.approx(-1.0)
    empty = acceleration_of(library, {})
    assert np.isnan(empty([[1.0]], [[1.0]])).all()


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(
    "name", ["single_pendulum", pytest.param("magnetic_pendulum", marks=pytest.mark.thorough)]
)
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
@pytest.mark.thorough
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
    normal = Normal.of(columns[:40], target[:40]) + Normal.of(columns[40:], target[40:])
    for size, found in enumerate(best_supports(normal, 4, width=20), 1):

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
    dictionary = Dictionary(["x"], [], False, 1, 1)
    xi = np.zeros((len(dictionary), 1))
    xi[dictionary.names.index("x")] = -1.0
    x, v = np.array([[0.7]]), np.array([[-0.2]])
    steps = module.Steps(x, v, x, v, (None, None, None), np.array([[h]]))
    found = module._mean_features(dictionary, steps, xi, np.arange(len(dictionary))) @ xi
    taylor = (v * (-(h**2) / 2 + h**4 / 24) - x * (h - h**3 / 6)) / h
    assert found == pytest.approx(taylor, rel=1e-12)


def test_dictionary_values_agree_with_their_names():
    coordinates = ["theta", "phi", "x"]
    dictionary = Dictionary(coordinates, ["theta", "phi"], True, 2, 2)
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


# --------------------------- uDSR behind its adapter: a stand-in for its package, and the package where it is

# A stand-in for the package: each step uses the processor for a while and adds programs, the true law among
# them only if variation changes the tokens of an individual.
FAKE = {
    "__init__.py": """
        import time
        import numpy as np
        from dso.gp.utils import Individual
        from dso.program import Program, Token

        class Trainer:
            done, nevals, p_r_best = False, 0, None

        class DeepSymbolicOptimizer:
            def __init__(self, config):
                self.config = config

            def setup(self):
                X, y = self.config["task"]["dataset"]
                assert X.ndim == 2 and y.shape == (len(X),)
                assert self.config["training"]["epsilon"] == 0.05 and self.config["gp_meld"]["run_gp_meld"]
                assert "sin" in self.config["task"]["function_set"]
                self.trainer = Trainer()

            def train_one_step(self):
                end = time.process_time() + 0.3
                while time.process_time() < end:
                    pass
                if self.config["experiment"]["seed"] == 1002:
                    raise ValueError("no luck")
                f, theta = Token("x3", 2), Token("x1", 0)
                law = [Token("sub"), f, Token("mul"), Token("const", value=[9.81]), Token("sin"), theta]
                cubic = Token("poly", exponents=[(0, 0, 0), (1, 0, 2)], coef=np.array([1.0, 2.0]))
                poor = [Token("mul"), cubic, f]
                programs = [Program([f], 1, 0.3), Program(poor, 3, 0.2), Program(poor, 9, 0.99, invalid=True)]
                programs += [Program(poor, 4, 0.4), Program(law, 5, None)]
                if Individual().tokenized_repr == "varied":
                    programs.append(Program(law, 6, 0.9))
                Program.cache.update(enumerate(programs))
                rated = [p for p in programs if "r" in p.__dict__ and not p.invalid]
                self.trainer.p_r_best = max(rated, key=lambda p: p.r)
                self.trainer.nevals += len(programs)
        """,
    "config.py": """
        from collections import Mapping  # as the released code does

        def load_config(config):
            assert isinstance(config, Mapping)
            parts = ("task", "training", "gp_meld", "experiment")
            return {part: {"epsilon": 0.05, **config.get(part, {})} for part in parts}
        """,
    "program.py": """
        class Token:
            def __init__(self, name, input_var=None, **more):
                self.name, self.input_var = name, input_var
                self.__dict__.update(more)

        class Program:
            cache = {}

            def __init__(self, traversal, complexity, r, invalid=False):
                self.traversal, self.complexity, self.invalid = traversal, complexity, invalid
                if r is not None:
                    self.r = r
        """,
    "gp/__init__.py": "",
    "gp/utils.py": """
        class Individual:
            tokenized_repr = "as it was made"

        def DEAP_to_tokens(individual):
            return "varied"
        """,
}


@pytest.fixture
def udsr(tmp_path, monkeypatch):
    """The adapter, with a Python that has the stand-in."""
    for name, text in FAKE.items():
        path = tmp_path / "dso" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(text))
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{tmp_path}" exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    return loaded(monkeypatch, str(python))


def loaded(monkeypatch, python: str | None):
    monkeypatch.delitem(sys.modules, "reproduction.methods.udsr", raising=False)
    if python is None:
        monkeypatch.delenv("UDSR_PYTHON", raising=False)
    else:
        monkeypatch.setenv("UDSR_PYTHON", python)
    return load("udsr")


def pendulum(variant: str = "", **more):
    return pose(Case("single_pendulum", 0.0, "udsr", variant=variant, **{"trajectories": 2, **more}))


def test_the_repaired_variant_finds_what_variation_finds(udsr):
    answers = {variant: udsr.solve(pendulum(variant), seconds=0.1) for variant in ("", "repaired")}
    assert answers["repaired"].expression == "theta_ddot = (f_theta - (9.81 * sin(theta)))"
    assert answers["repaired"].settings["held_out_error"] == pytest.approx([0.0], abs=1e-12)
    assert answers[""].settings["held_out_error"][0] > 0.5
    motion = pendulum().truth[0]
    found = answers["repaired"].acceleration(motion.q, motion.qdot, motion.forces)
    assert found == pytest.approx(motion.qddot, abs=1e-12)
    lost = answers["repaired"].acceleration(np.array([[np.nan]]), np.zeros((1, 1)), np.zeros((1, 1)))
    assert np.isnan(lost).all()
    assert answers[""].coefficients is None


def test_training_goes_on_for_the_seconds_given(udsr):
    (inputs, targets), _ = _symbolic.samples(pendulum(), given=True)
    done = [udsr._regress(inputs, targets[:, 0], udsr._settings(pendulum(), s)) for s in (0.1, 0.5)]
    assert [d["steps"] for d in done] == [1, 2]  # of 0.3 s each
    assert [member["reward"] for member in done[0]["front"]] == [0.3, 0.4]
    assert done[0]["front"][0]["tokens"] == [{"input": 2}]
    assert done[0]["best"] == done[0]["front"][-1]
    assert done[0]["versions"]["python"] == sys.version.split()[0]


def test_time_and_memory_of_the_child_are_counted(udsr, monkeypatch):
    monkeypatch.setattr(udsr, "solve", lambda problem, solve=udsr.solve: solve(problem, 0.1))
    result = execute(Case("single_pendulum", 0.0, "udsr", trajectories=1), udsr)["result"]
    assert result["finished"]
    assert result["cpu_s"] > 0.3
    assert result["peak_mb"] > result["start_mb"] + 10
    assert result["equation_error"] > 0.1
    assert result["l2"] is None


def test_a_failure_has_the_last_words_of_the_child(udsr):
    with pytest.raises(RuntimeError, match="uDSR: the process ended with exit code 1: ValueError: no luck"):
        udsr.solve(pendulum(trial=2), seconds=0.1)
    with pytest.raises(ValueError, match="variant 'other' is unknown; use repaired, poly, repaired-poly"):
        udsr.solve(pendulum("other"))


@pytest.mark.thorough
def test_functions_follow_the_variant_and_the_library(udsr):
    assert udsr._settings(pendulum(), 1.0)["config"]["task"]["function_set"] == list(udsr.FUNCTIONS)
    magnets = pose(Case("magnetic_pendulum", 0.0, "udsr", variant="repaired-poly", trajectories=1))
    settings = udsr._settings(magnets, 1.0)
    assert settings["config"]["task"]["function_set"] == [*udsr.FUNCTIONS, "sqrt", "poly"]
    assert settings["repair"]
    assert settings["config"]["experiment"]["seed"] == 1000


def test_expressions_are_evaluated_and_written(udsr):
    x, y = np.random.default_rng(0).uniform(1, 2, (2, 5))
    inputs, labels = np.stack([x, y], axis=1), ["x", "y"]
    polynomial = {"exponents": [[0, 0], [2, 1]], "coefficients": [0.5, -3.0]}
    tokens = ["add", "div", "sqrt", {"input": 0}, "cos", {"input": 1}, "sin", polynomial]
    expected = np.sqrt(x) / np.cos(y) + np.sin(0.5 - 3 * x**2 * y)
    assert udsr.evaluate(tokens, inputs) == pytest.approx(expected)
    assert udsr.infix(tokens, labels) == "((sqrt(x) / cos(y)) + sin((0.5 + -3*x**2*y)))"
    assert udsr.evaluate([2.5], inputs).tolist() == [2.5] * 5
    assert not np.isfinite(udsr.evaluate(["div", 1.0, "sub", {"input": 0}, {"input": 0}], inputs)).any()


def test_a_worker_ends_with_the_process_that_started_it(udsr, tmp_path):
    waits = "import time\n\ndef load_config(config):\n    (open('began', 'w')).close()\n    time.sleep(600)\n"
    (tmp_path / "dso" / "config.py").write_text(waits)
    np.savez(tmp_path / "task.npz", X=np.zeros((3, 1)), y=np.zeros(3))
    (tmp_path / "settings.json").write_text('{"repair": false}')
    command = [udsr.PYTHON, str(udsr.WORKER), str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, cwd=tmp_path) as process:
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(60) == 1


def test_it_is_left_out_where_it_is_not_installed(monkeypatch):
    for python, reason in ((None, "names no Python with uDSR"), ("/nowhere/python", "names no Python")):
        with pytest.raises(ImportError, match=reason):
            loaded(monkeypatch, python)
    bare = Path(sys.executable)
    with pytest.raises(
        ImportError, match=f"the Python that UDSR_PYTHON names, {bare.name}, has no package dso"
    ):
        loaded(monkeypatch, str(bare))
    said = CliRunner().invoke(main, ["--method", "udsr", "--trials", "1", "--noise", "0", "--dry-run"]).output
    assert "udsr is left out: the Python that UDSR_PYTHON names" in said
    assert "0 cases" in said


@pytest.mark.skipif(not os.environ.get("UDSR_PYTHON"), reason="UDSR_PYTHON names no Python with uDSR")
def test_the_package_itself_finds_the_pendulum(monkeypatch):
    real = loaded(monkeypatch, os.environ["UDSR_PYTHON"])
    answer = real.solve(pendulum("repaired", trajectories=5), seconds=30.0)
    assert answer.settings["held_out_error"][0] < 1e-3
    assert (
        "torch" in answer.settings["runs"][0]["versions"]
        or "tensorflow" in answer.settings["runs"][0]["versions"]
    )


# ------------------------------------------------------------------------------------------ what is given


def test_given_rates_are_exact_without_noise():
    problem = pose(Case("double_pendulum", 0.0, "udsr", trajectories=2))
    (inputs, targets), (unseen, wanted) = _symbolic.samples(problem, given=True)
    first, last = problem.truth
    assert inputs == pytest.approx(np.hstack([first.q, first.qdot, first.forces])[:: _symbolic.STRIDE])
    assert targets == pytest.approx(first.qddot[:: _symbolic.STRIDE])
    assert unseen == pytest.approx(np.hstack([last.q, last.qdot, last.forces]))
    assert wanted == pytest.approx(last.qddot)
    assert _symbolic.names(problem)[-1] == "f_theta2"
    assert len(_symbolic.names(problem)) == inputs.shape[1] == 6


def test_a_single_trajectory_is_judged_by_its_last_fifth():
    problem = pose(Case("single_pendulum", 0.1, "udsr", trajectories=1))
    for given in (False, True):
        (inputs, targets), (unseen, wanted) = _symbolic.samples(problem, given)
        assert len(unseen) == len(wanted) == pytest.approx(0.2 * len(problem.truth[0].t), abs=1)
        assert len(inputs) == len(targets) == -(-(len(problem.truth[0].t) - len(unseen)) // _symbolic.STRIDE)


def test_the_shortest_of_the_best_is_chosen():
    target = np.array([0.0, 1.0, 2.0])
    predictions = [target + 0.5, target + 0.1, target + 0.1005, np.full(3, np.nan)]
    assert _symbolic.choose(predictions, [1, 5, 3, 2], target)[0] == 2
    assert _symbolic.choose(predictions, [1, 5, 7, 2], target) == (1, pytest.approx(0.1 / target.std()))


def test_ours_from_names_alone():
    problem = pose(Case("single_pendulum", 0.01, "ours", variant="names", trajectories=1))
    answer = load("ours").solve(problem)
    assert set(answer.coefficients) == set(problem.true_coefficients)
    with pytest.raises(ValueError, match="variant 'other' is unknown; use names"):
        load("ours").solve(pose(Case("single_pendulum", 0.01, "ours", variant="other", trajectories=1)))
