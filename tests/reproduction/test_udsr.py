"""uDSR behind its adapter: with a stand-in for its package, and with the package itself where it is."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from reproduction._execute import execute
from reproduction.methods import _symbolic, load
from reproduction.problem import Case, pose
from reproduction.run import main

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
