"""Unknown forces that change slowly: against forces that are known to be missing."""

from __future__ import annotations

import math

import numpy as np
import pytest

import leastaction as la
from helpers import findings_of
from leastaction import systems
from leastaction.cli.options import force_offsets

TRUTH = {"theta_dot**2": 0.5, "cos(theta)": 9.81}


def biased(seed: int, size: float = 1.5):
    """A driven pendulum, the torque recorded without a bias that drifts, and that bias."""
    data = systems.generate("single_pendulum", noise=0.01, trials=3, duration=15.0, seed=seed)
    rng = np.random.default_rng(seed)
    runs, biases = [], []
    for run in data:
        bias = size * (rng.normal() + np.sin(2.0 * np.pi * run.t / rng.uniform(10, 20) + rng.uniform(0, 6)))
        runs.append(run.changed(forces=run.forces - bias[:, None]))
        biases.append(bias)
    return la.Trajectories(runs), biases


@pytest.fixture(scope="module")
def library():
    return systems.compact_library("single_pendulum")


@pytest.mark.parametrize("seed", [3, 4])
def test_a_drifting_bias_is_found_with_the_law(library, seed):
    data, biases = biased(seed)
    model = la.discover(data, library, force_offset={"theta": 2.5})
    assert model.fit.status == "ok", model.fit.warnings
    assert {t.expression for t in model.terms} == set(TRUTH)
    for term in model.terms:
        assert abs(term.coefficient - TRUTH[term.expression]) < 4.0 * term.standard_error
        assert term.coefficient == pytest.approx(TRUTH[term.expression], rel=0.03)
    found = model.diagnostics.force_offset["theta"]
    assert [f.shape for f in found] == [run.t.shape for run in data]
    error = np.sqrt(np.mean((np.concatenate(found) - np.concatenate(biases)) ** 2))
    assert error < 0.05 * np.std(np.concatenate(biases))
    (slow,) = findings_of(model, "slow-force")
    assert (slow.subject, slow.values["hardly_any"]) == (("theta",), False)
    assert 0.3 * error < slow.values["standard_error"] < 3.0 * error


def test_the_same_data_taken_at_their_word_are_doubtful(library):
    assert la.discover(biased(3)[0], library).fit.status == "doubtful"


def test_where_nothing_drifts_nothing_is_found(library):
    data, _ = biased(3, size=0.0)
    plain, followed = la.discover(data, library), la.discover(data, library, force_offset={"theta": 2.5})
    assert {t.expression for t in plain.terms} == {t.expression for t in followed.terms}
    for a, b in zip(plain.terms, followed.terms, strict=True):
        assert b.coefficient == pytest.approx(a.coefficient, abs=a.standard_error)
    assert [finding.values["hardly_any"] for finding in findings_of(followed, "slow-force")] == [True]
    pushes = np.sqrt(np.mean(np.concatenate([run.forces for run in data]) ** 2))
    assert np.abs(np.concatenate(followed.diagnostics.force_offset["theta"])).max() < 0.03 * pushes


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"phi": 3.0}, "names 'phi', which is not a coordinate"),
        ({"theta": 0.0}, "expected the seconds"),
        ({"theta": "often"}, "expected the seconds"),
        ({"theta": math.nan}, "expected the seconds"),
    ],
)
def test_what_cannot_be_meant_is_refused(library, given, message):
    with pytest.raises(ValueError, match=message):
        la.discover(biased(3)[0], library, force_offset=given)


def test_the_papers_method_has_no_slow_forces(library):
    with pytest.raises(ValueError, match="needs the default"):
        la.discover(biased(3)[0], library, method="adam", force_offset={"theta": 2.5})


def test_infinite_seconds_mean_a_constant_force(library):
    data, _ = biased(3, size=0.0)
    shifted = la.Trajectories([run.changed(forces=run.forces - 1.0) for run in data])
    for offset in ("theta", {"theta": math.inf}):
        model = la.discover(shifted, library, force_offset=offset)
        assert {t.expression: t.coefficient for t in model.terms}["theta"] == pytest.approx(1.0, rel=0.02)


def test_command_line_notation():
    assert force_offsets("x") == {"x": math.inf}
    assert force_offsets("x, theta = 2.5") == {"x": math.inf, "theta": 2.5}
    with pytest.raises(la.InputError, match="finite number"):
        force_offsets("x=soon")
