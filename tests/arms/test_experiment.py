"""Exciting motions: gradients, limits, and what they are worth for an identification."""

from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from arm_helpers import WRIST, recorded, truth
from leastaction import arms, experiment
from leastaction.arms.planning import Bounds, Limits, Plan, Series
from leastaction.mechanics.rigid_bodies import Motion

WIDE = Limits(angle=[[-2.0] * 3, [2.0] * 3], speed=2.0, acceleration=10.0)


def plan_of(tree: arms.KinematicTree, limits: Limits) -> Plan:
    return Plan.of(tree, Bounds.of(limits, tree), Series(5.0, 4), np.full(len(tree), 0.1), 500.0)


def test_the_gradient_is_a_finite_difference(rng):
    tree = truth(WRIST, rng).tree
    boxes = ([[0.0, -0.3, 0.0], [0.3, 0.3, 0.4]],)
    inside, tool = [[-0.1] * 3, [0.2] * 3], (0.0, 0.1, 0.1)
    limits = Limits([[-1.0] * 3, [1.0] * 3], 1.0, 2.0, 3.0, inside, boxes, tool)
    plan = plan_of(tree, limits)
    x = rng.normal(0.0, 0.4, (3, plan.series.size))
    _, gradient = plan._value(x, 30.0)
    for _ in range(5):
        way = rng.normal(size=x.shape)
        ends = [plan._value(x + step * way, 30.0)[0] for step in (1e-5, -1e-5)]
        assert gradient @ way.ravel() == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3)


def test_a_series_starts_and_ends_at_rest(rng):
    series = Series(5.0, 4)
    x = rng.normal(size=(3, series.size))
    for nu in (1, 2):
        np.testing.assert_allclose(series.states(x, np.array([0.0, 5.0, 10.0]))[nu], 0.0, atol=1e-9)
    t, step = np.linspace(0.0, 5.0, 7), 1e-6
    ends = [series.states(x, t + sign * step) for sign in (1.0, -1.0)]
    np.testing.assert_allclose((ends[0] - ends[1])[:2] / (2.0 * step), series.states(x, t)[1:], atol=1e-5)


@pytest.mark.thorough
def test_the_motion_shrinks_the_volume_and_keeps_every_limit(rng):
    tree = truth(WRIST, rng).tree
    inside, block = np.array([[-0.6] * 3, [0.6] * 3]), np.array([[0.1, -0.1, 0.0], [0.5, 0.1, 0.6]])
    tool = np.array([0.0, 0.0, 0.15])
    limits = Limits(WIDE.angle, 2.0, 8.0, 6.0, inside, [block], tool)
    plan = experiment.excite(tree, limits, 6.0, rate=200.0)
    assert plan.log_volume[1] < plan.log_volume[0] - 5.0
    assert plan.condition[1] < plan.condition[0]
    assert np.abs(plan.q).max() <= 2.0
    assert np.abs(plan.qdot).max() <= 2.0
    assert np.abs(plan.qddot).max() <= 8.0
    assert np.abs(plan.qdot[[0, -1]]).max() < 1e-9
    rigid = arms.ArmModel.of_tree(tree)
    assert np.abs(rigid.torques(plan.q, plan.qdot, plan.qddot)).max() <= 6.0 * 1.001
    motion = Motion.at(tree, plan.q, plan.qdot, plan.qddot)
    hand = motion.origins[-1] + motion.rotations[-1] @ tool
    assert (hand >= inside[0] - 1e-3).all()
    assert (hand <= inside[1] + 1e-3).all()
    for point in (hand, *motion.origins):
        assert not ((point > block[0] + 1e-3) & (point < block[1] - 1e-3)).all(axis=1).any()
    again = experiment.excite(tree, limits, 6.0, rate=200.0)
    np.testing.assert_array_equal(again.q, plan.q)


def test_what_a_motion_cannot_show_is_named():
    """Without gravity and at a crawl, first moments and inertias hide in the noise."""
    plan = experiment.excite(WRIST, Limits([[-0.1] * 3, [0.1] * 3], 0.02), 5.0, noise=1.0, harmonics=3)
    assert any("Izz" in name for name in plan.unseen)
    assert "not shown" in str(plan)
    assert plan.trajectory.coordinates == WRIST.coordinates
    fast = experiment.excite(WRIST, WIDE, 5.0, noise=0.01, harmonics=3)
    assert fast.unseen == ()


@pytest.mark.thorough
def test_identification_gains_what_the_plan_promises():
    """Standard errors of an identification follow those expected, white noise as planned."""
    rng = np.random.default_rng(1)
    true = truth(WRIST, rng, viscous=[0.5, 0.3, 0.1], dry=[0.4, 0.3, 0.2])
    plan = experiment.excite(WRIST, WIDE, 10.0, noise=0.05, rate=200.0)
    torques = true.torques(plan.q, plan.qdot, plan.qddot, successive=True)
    log = la.Trajectory(plan.t, plan.q, torques + rng.normal(0.0, 0.05, torques.shape), WRIST.coordinates)
    found = arms.identify(log, WRIST)
    expected = {plan.base.text(row): error for row, error in enumerate(plan.errors)}
    ratios = [
        error / expected[row.parameter]
        for row, error in zip(found.rows(), found.standard_errors, strict=True)
        if row.parameter in expected
    ]
    assert 0.4 < np.median(ratios) < 2.5
    other = arms.identify(recorded(true, rng, 10.0, 200.0, 0.03), WRIST)
    assert len(other.coefficients) == len(found.coefficients)


def test_limits_come_from_the_file(file):
    text = """<mujoco><worldbody><body><joint range="-90 90" axis="0 1 0"/>
      <inertial pos="0.2 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>"""
    tree = la.Library.from_mjcf(file(text, "a.xml"))
    with pytest.raises(la.InputError, match="no limits of speed"):
        experiment.excite(tree)
    plan = experiment.excite(tree, Limits.of_tree(tree, speed=1.5), 4.0)
    assert np.abs(plan.q).max() <= np.pi / 2
    assert np.abs(plan.qdot).max() <= 1.5
    assert plan.log_volume[1] < plan.log_volume[0]
    again = experiment.excite(tree, Limits.of_tree(tree, speed=1.5), 4.0)
    np.testing.assert_array_equal(again.q, plan.q)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"angle": [[0.0] * 3, [0.0] * 3]}, "lowest"),
        ({"angle": [0.0, 1.0, 2.0, 3.0]}, "shape"),
        ({"speed": [1.0, -1.0, 1.0]}, "positive"),
        ({"speed": np.inf}, "not finite"),
        ({"torque": 3.0}, "inertias"),
        ({"inside": [[5.0] * 3, [6.0] * 3]}, "no motion within the limits"),
    ],
)
def test_bad_limits_are_refused_in_one_line(change, words):
    given = {"angle": WIDE.angle, "speed": WIDE.speed, **change}
    with pytest.raises((la.InputError, la.DataError)) as caught:
        experiment.excite(WRIST, Limits(**given), 3.0)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
