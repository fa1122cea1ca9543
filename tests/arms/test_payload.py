"""Payloads: known bodies are found within their errors, wherever they hang and however they are given."""

from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from arm_helpers import SEVEN, WRIST, recorded, truth
from leastaction import arms
from leastaction.arms.base import find_base
from leastaction.library.tree import rpy_matrix

FRICTION = {"viscous": [0.5, 0.3, 0.1], "dry": [0.4, 0.3, 0.2], "rotor": [0.2, 0.1, 0.05]}
WARMER = {**FRICTION, "viscous": [0.45, 0.25, 0.09], "offset": [0.2, 0.0, -0.1]}
MASS, CENTRE = 1.2, np.array([0.05, -0.02, 0.1])
INERTIA = np.array([[0.004, 0.0005, 0.0], [0.0005, 0.006, -0.001], [0.0, -0.001, 0.005]])


def parameters(mass: float = MASS, centre: np.ndarray = CENTRE, inertia: np.ndarray = INERTIA) -> np.ndarray:
    """(10,) inertial parameters about the origin of the link."""
    about = inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.array([mass, *(mass * centre), *about[np.triu_indices(3)]])


def values(mass: float = MASS, centre: np.ndarray = CENTRE, inertia: np.ndarray = INERTIA) -> np.ndarray:
    return np.array([mass, *centre, *inertia[np.triu_indices(3)]])


def pair(seed: int) -> tuple[arms.ArmModel, arms.ArmModel]:
    """A wrist without and with a payload, with warmer bearings the second time, both identified."""
    rng = np.random.default_rng(seed)
    empty = truth(WRIST, rng, **FRICTION)
    inertias = empty.tree.inertias.copy()
    inertias[-1] += parameters()
    heavy = arms.ArmModel.of_tree(WRIST.with_inertias(inertias), WARMER, distance=2e-3)
    one, two = (arms.identify(recorded(model, rng, 8.0, 200.0), WRIST) for model in (empty, heavy))
    return one, two


@pytest.fixture(scope="module")
def logs() -> tuple[arms.ArmModel, arms.ArmModel]:
    return pair(3)


def test_a_payload_is_found_within_its_errors(logs):
    found = arms.payload(*logs)
    assert found.mass == pytest.approx(MASS, abs=0.03)
    assert np.abs((found.values - values()) / found.standard_errors).max() < 4.0
    assert found.notes == ()
    assert found.n_degrees > 0
    lower, upper = found.intervals(0.9).T
    np.testing.assert_allclose((upper - lower) / found.standard_errors, 2.0 * 1.6449, rtol=1e-3)
    assert "kg" in str(found)
    assert found.inertia == pytest.approx(INERTIA, abs=0.005)


@pytest.mark.thorough
def test_intervals_of_payloads_hold():
    z = np.array(
        [(f.values - values()) / f.standard_errors for f in (arms.payload(*pair(k)) for k in range(8))]
    )
    assert np.mean(np.abs(z) < 1.96) > 0.88
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.3


def test_the_frame_is_that_of_the_flange(logs):
    origin, rpy = np.array([0.0, 0.1, 0.2]), (0.3, -0.4, 1.0)
    plain, moved = arms.payload(*logs), arms.payload(*logs, origin=origin, rpy=rpy)
    turned = rpy_matrix(rpy).T
    np.testing.assert_allclose(moved.centre, turned @ (plain.centre - origin), atol=1e-12)
    np.testing.assert_allclose(moved.inertia, turned @ plain.inertia @ turned.T, atol=1e-12)
    assert moved.standard_errors[0] == pytest.approx(plain.standard_errors[0])


def test_a_consistent_payload_can_exist(logs):
    plain, body = arms.payload(*logs), arms.payload(*logs, consistent=True)
    assert np.linalg.eigvalsh(body.inertia).min() > 0.0
    assert "chi-squared rises" in body.notes[-1]
    assert np.abs((body.values - plain.values) / plain.standard_errors).max() < 4.0


def exact(tree: arms.KinematicTree, inertias: np.ndarray) -> arms.ArmModel:
    """A model with small errors, without a log."""
    model = arms.ArmModel.of_tree(tree.with_inertias(inertias))
    size = len(model.coefficients)
    return arms.ArmModel(tree, model.base, model.coefficients, 1e-8 * np.eye(size), inertias, model.facts)


def test_any_link_may_carry(rng):
    inertias = truth(SEVEN, rng).tree.inertias
    for link in ("link5", "link7"):
        loaded = inertias.copy()
        loaded[SEVEN.links.index(link)] += parameters()
        found = arms.payload(exact(SEVEN, inertias), exact(SEVEN, loaded), link=link)
        np.testing.assert_allclose(found.values, values(), atol=1e-9)


def test_what_torques_do_not_show_is_open():
    """A pendulum about one axis feels one moment of inertia and two first moments of its load."""
    swing = arms.KinematicTree.from_joints([{"axis": (0, 1, 0)}])
    one = np.array([[1.0, 0.1, 0.0, 0.2, 0.1, 0.0, 0.0, 0.1, 0.0, 0.1]])
    arm, loaded = exact(swing, one), exact(swing, one + parameters())
    assert len(find_base(swing, arm.base.terms).members) == 3
    found = arms.payload(arm, loaded)
    shown = np.isfinite(found.parameters)
    np.testing.assert_array_equal(np.flatnonzero(shown), [1, 3, 7])
    np.testing.assert_allclose(found.parameters[shown], parameters()[shown], atol=1e-9)
    assert "do not determine m, my" in found.notes[0]


def test_an_arm_that_has_changed_elsewhere_is_no_payload(rng):
    inertias = truth(SEVEN, rng).tree.inertias
    changed = inertias.copy()
    changed[2] += parameters()
    found = arms.payload(exact(SEVEN, inertias), exact(SEVEN, changed))
    assert "not that of one body" in found.notes[0]


def test_bad_requests_are_refused_in_one_line(logs):
    arm, loaded = logs
    other = exact(SEVEN, np.ones((7, 10)))
    for call, words in [
        (lambda: arms.payload(arm, loaded, link="hand"), "link1, link2, link3"),
        (lambda: arms.payload(arm, other), "different base parameters"),
        (lambda: arms.payload(arms.ArmModel.of_tree(arm.bodies().tree, FRICTION), loaded), "has no errors"),
        (lambda: arms.payload(*logs).intervals(2.0), "probability"),
    ]:
        with pytest.raises(la.InputError) as caught:
            call()
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)
