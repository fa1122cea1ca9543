"""Kinematic trees in place of a library: MJCF against hand and round trip, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from leastaction import arms

MJCF = """<mujoco model="pair"><compiler eulerseq="zyX"/><option gravity="0 1 -9"/>
<default><joint damping="0.2"/>
  <default class="slow"><joint armature="0.3" axis="0 1 0"/></default></default>
<worldbody><body name="stand" pos="0 0 1" euler="10 20 30"><geom size="0.1"/>
  <body name="upper" pos="0.1 0.2 0.3" axisangle="1 2 0 40" childclass="slow">
    <inertial pos="0.1 0 0" mass="2" diaginertia="0.02 0.03 0.025" quat="1 0.2 0.1 0.3"/>
    <joint name="j 1" pos="0.05 0 0.1" ref="25" range="-90 80" actuatorfrcrange="-9 8"/>
    <joint name="j2" type="slide" axis="1 1 0" ref="0.2" class="main" stiffness="3" springref="0.1"/>
    <body name="plate" pos="0.3 0 0" xyaxes="0 1 0 1 0 1">
      <inertial pos="0 0.1 0" mass="0.5" fullinertia="0.01 0.012 0.011 0.001 0.002 -0.001"/>
      <frame pos="0 0.1 0" euler="0 0 15"><body name="hand" zaxis="1 1 0.5">
        <joint name="j3" axis="1 0 0.2"/><site/>
        <inertial pos="0 0 0.2" mass="1" diaginertia="0.01 0.01 0.01"/></body></frame></body></body>
  <body name="side" pos="0 0.4 0"><joint name="j4" frictionloss="0.1" axis="1 0 0" damping="0"/>
    <inertial pos="0.2 0 0.1" mass="1.2" diaginertia="0.01 0.02 0.015"/></body>
</body></worldbody></mujoco>"""

# From MuJoCo 4.0.0, of the file above: mass matrix and bias (gravity, Coriolis) at this state.
STATE = [[0.3, -0.4, 0.7, 0.2], [0.5, 0.1, -0.8, 0.9]]
FROM_MUJOCO = {
    "mass": [
        [0.67083990188, -0.246330958017, 0.0238461825771, 0],
        [-0.246330958017, 3.5, -0.113323053494, 0],
        [0.0238461825771, -0.113323053494, 0.348461538462, 0],
        [0, 0, 0, 0.022],
    ],
    "bias": [5.66131131196, 0.0854191375698, 0.102970847064, -0.611848935096],
}


def axis_turn(axis, angle: float) -> np.ndarray:
    """A rotation as the exponential of its generator, by its series."""
    x, y, z = np.array(axis, float) / np.linalg.norm(axis)
    step = angle * np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out, term = np.eye(3), np.eye(3)
    for k in range(1, 40):
        term = term @ step / k
        out = out + term
    return out


def test_mjcf_agrees_with_mujoco(file):
    tree = la.Library.from_mjcf(file(MJCF, "arm.xml"))
    assert tree.coordinates == ("j_1", "j2", "j3", "j4")
    dynamics = tree.dynamics
    np.testing.assert_allclose(dynamics["rotor"], [0.3, 0.0, 0.3, 0.0])
    np.testing.assert_allclose(dynamics["viscous"], [0.2, 0.2, 0.2, 0.0])
    np.testing.assert_allclose(dynamics["offset"], [0.0, -0.3, 0.0, 0.0])
    np.testing.assert_allclose(tree.limits[0], [-np.pi / 2, np.deg2rad(80.0), np.nan, 8.0])
    model = arms.ArmModel.of_tree(tree, {"rotor": dynamics["rotor"]})
    q, qdot = np.array(STATE)
    np.testing.assert_allclose(model.mass_matrix(q)[0], FROM_MUJOCO["mass"], atol=1e-9)
    np.testing.assert_allclose(model.torques(q, qdot, 0.0 * q)[0], FROM_MUJOCO["bias"], atol=1e-9)


def test_a_joint_turns_about_its_own_point_from_its_reference(file):
    text = (
        '<mujoco><worldbody><body pos="1 0 0"><joint pos="0 2 0" axis="0 0 1" ref="30"/>'
        '<inertial pos="0.5 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    tree = arms.read_mjcf(file(text, "a.xml"), gravity=(0.0, -10.0, 0.0))
    angle = 0.9
    lever = axis_turn((0, 0, 1), angle - np.pi / 6) @ [0.5, -2.0, 0.0]
    torque = arms.ArmModel.of_tree(tree).gravity([[angle]])[0, 0]
    assert torque == pytest.approx(2.0 * 10.0 * lever[0])


def test_trees_survive_urdf_and_mjcf(file, tmp_path, rng):
    """URDF → tree → MJCF → tree: the same torques, friction and limits."""
    urdf = """<robot name="r"><link name="base"/><link name="a"><inertial>
      <origin xyz="0.1 0 0.2" rpy="1 0 2"/><mass value="2"/>
      <inertia ixx="0.03" iyy="0.02" izz="0.025"/></inertial></link>
      <link name="b"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.02" izz="0.02"/></inertial></link>
      <joint name="one" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 3 1"/>
        <origin xyz="0 0 0.2" rpy="0.3 -0.2 3"/><limit lower="-2" upper="1" effort="9" velocity="3"/>
        <dynamics damping="0.4" friction="0.1"/></joint>
      <joint name="two" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
        <origin xyz="0.3 0.1 0" rpy="3.1 0 1"/></joint></robot>"""
    first = la.Library.from_urdf(file(urdf, "r.urdf"), gravity=(0.0, 3.0, -9.0))
    arms.write_mjcf(first, tmp_path / "r.xml")
    again = la.Library.from_mjcf(tmp_path / "r.xml")
    assert (again.coordinates, again.links) == (first.coordinates, first.links)
    states = rng.normal(size=(3, 10, 2))
    smooth = [{k: v for k, v in t.dynamics.items() if k == "viscous"} for t in (first, again)]
    torques = [
        arms.ArmModel.of_tree(tree, kinds).torques(*states)
        for tree, kinds in zip((first, again), smooth, strict=True)
    ]
    np.testing.assert_allclose(*torques, atol=1e-9)
    np.testing.assert_allclose(again.dynamics["dry"], [0.1, 0.0])
    np.testing.assert_allclose(again.limits[0], [-2.0, 1.0, np.nan, 9.0])  # MuJoCo has no limit of speed
    np.testing.assert_allclose(first.limits[0, 2], 3.0)
    np.testing.assert_allclose(again.inertias, first.inertias, atol=1e-9)


def test_a_body_with_two_joints_survives_its_file(file, tmp_path, rng):
    tree = arms.read_mjcf(file(MJCF, "arm.xml"))
    arms.write_mjcf(tree, tmp_path / "out.xml")
    again = arms.read_mjcf(tmp_path / "out.xml")
    states = rng.normal(size=(3, 10, 4))
    torques = [arms.ArmModel.of_tree(t).torques(*states) for t in (tree, again)]
    np.testing.assert_allclose(*torques, atol=1e-9)


def test_named_joints_move_and_the_others_stay(file, rng):
    path = file(MJCF, "arm.xml")
    whole, part = arms.read_mjcf(path), arms.read_mjcf(path, joints=["j3", "j4"])
    assert part.coordinates == ("j3", "j4")
    q = rng.normal(size=(5, 2))
    at_reference = np.column_stack([np.full((5, 1), np.deg2rad(25.0)), np.full((5, 1), 0.2), q])
    torques = [
        arms.ArmModel.of_tree(whole).gravity(at_reference)[:, 2:],
        arms.ArmModel.of_tree(part).gravity(q),
    ]
    np.testing.assert_allclose(*torques, atol=1e-12)


def test_mass_that_geoms_would_give_is_unknown(file):
    text = MJCF.replace('<inertial pos="0 0 0.2" mass="1" diaginertia="0.01 0.01 0.01"/>', '<geom size="1"/>')
    tree = arms.read_mjcf(file(text, "arm.xml"))
    assert np.isnan(tree.inertias[2]).all()
    with pytest.raises(la.InputError, match="without inertia"):
        arms.write_mjcf(tree, "never.xml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<mujoco", "<!DOCTYPE x [<!ENTITY a 'b'>]><mujoco", "remove them"),
        ("<worldbody>", '<include file="x.xml"/><worldbody>', "mj_saveLastXML"),
        ("<site/>", "<composite/>", "holds <composite>"),
        ("<site/>", "<freejoint/>", "floats"),
        ('name="j3"', 'name="j3" type="ball"', "hinge and slide are supported"),
        ('name="j3"', 'name="j2"', "two joints 'j2'"),
        ('name="j3"', 'name="j3" class="fast"', "'fast', which no <default> defines"),
        ('name="j3"', 'name="j3" wobble="1"', "'wobble'"),
        ('name="j3"', 'name="j3" springdamper="1 2"', "stiffness and damping"),
        ('axis="1 0 0.2"', 'axis="0 0 0"', "without length"),
        ('eulerseq="zyX"', 'eulerseq="zyq"', "three of x"),
        ('eulerseq="zyX"', 'coordinate="global"', "global"),
        ('eulerseq="zyX"', 'settotalmass="3"', "changes masses"),
        ('xyaxes="0 1 0 1 0 1"', 'xyaxes="0 1 0 0 2 0"', "parallel"),
        ('zaxis="1 1 0.5"', 'zaxis="0 0 0"', "no length"),
        ('zaxis="1 1 0.5"', 'zaxis="1 1 0.5" quat="1 0 0 0"', "keep one"),
        ('mass="1"', 'mass="heavy"', "1 finite number"),
        ('name="side"', 'name="side" gravcomp="1"', "gravcomp"),
        ("</worldbody>", '</worldbody><equality><joint joint1="j3" joint2="j4"/></equality>', "couples"),
        ("</worldbody>", '</worldbody><equality><connect body1="hand"/></equality>', "closes a loop"),
        ("</worldbody>", '</worldbody><tendon><fixed stiffness="2"/></tendon>', "remove the tendon"),
        ("mujoco", "robot", "for from_urdf"),
    ],
)
def test_what_is_not_supported_is_refused_in_one_line(file, old, new, words):
    assert old in MJCF
    with pytest.raises(la.InputError) as caught:
        arms.read_mjcf(file(MJCF.replace(old, new), "arm.xml"))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_library_has_the_names_of_the_geometry():
    table = [{"a": 0.3}, {"a": 0.2, "alpha": 0.4}]
    ours = la.Library.from_joints(table, modified=True)
    theirs = arms.KinematicTree.from_dh(table, modified=True)
    for a, b in zip(ours.joints, theirs.joints, strict=True):
        np.testing.assert_array_equal(a.rotation, b.rotation)
    axes = la.Library.from_joints(
        [{"axis": (0, 1, 0)}, {"kind": "prismatic"}], base_rpy=(0.0, np.pi / 2, 0.0)
    )
    np.testing.assert_allclose(axes.gravity, [9.81, 0.0, 0.0], atol=1e-12)
    log = la.Trajectory(np.arange(5.0), np.zeros((5, 2)), coordinates=axes.coordinates)
    with pytest.raises(la.InputError, match="leastaction"):
        la.discover(log, axes)  # pyright: ignore[reportArgumentType]
