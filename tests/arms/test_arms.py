"""Arms: base parameters, identification from simulated logs, files, and what is refused."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import leastaction as la
from arm_helpers import PI, SEVEN, WRIST, bodies, motion, recorded, truth
from leastaction import arms
from leastaction.arms.base import can_exist, find_base, fit_bodies
from leastaction.arms.log import prepared
from leastaction.cli.program import program
from leastaction.data.trajectories import Trajectories
from leastaction.mechanics import Points
from leastaction.mechanics.arm_columns import ArmColumns, JointScales, inertial_terms, joint_terms

URDF = """<?xml version="1.0"?>
<robot name="two">
  <link name="base"><inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0 0 0.1" rpy="0.3 0 0.2"/><mass value="2"/>
    <inertia ixx="0.03" ixy="0.001" ixz="0" iyy="0.02" iyz="0.002" izz="0.01"/></inertial>
    <visual><geometry><mesh filename="missing.stl"/></geometry></visual></link>
  <link name="lower"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.02" izz="0.02"/></inertial></link>
  <link name="tool"><inertial><mass value="0.5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3"/></inertial></link>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 0.4" rpy="1.5 0 0"/><axis xyz="0 0 2"/></joint>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.2"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="3"/></joint>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/>
    <origin xyz="0.1 0 0.3" rpy="0 0.5 0"/></joint>
</robot>
"""


@pytest.fixture(scope="module")
def found() -> tuple[arms.ArmModel, arms.ArmModel]:
    """A wrist, true and identified: viscous friction in two joints, dry friction in two."""
    rng = np.random.default_rng(4)
    true = truth(
        WRIST,
        rng,
        rotor=[0.2, 0.1, 0.05],
        viscous=[0.5, 0.0, 0.1],
        dry=[0.0, 0.6, 0.2],
        offset=[0.1, 0.0, -0.1],
    )
    return true, arms.identify(recorded(true, rng), WRIST)


def test_a_motion_determines_the_known_number_of_base_parameters():
    """43 of a chain of seven revolute joints without parallel neighbours (Gautier & Khalil 1990)."""
    terms = inertial_terms(SEVEN)
    assert len(find_base(SEVEN, terms).members) == 43
    # a first joint that stands upright feels no gravity and one moment of inertia
    assert find_base(WRIST, inertial_terms(WRIST)).text(0).startswith("Izz[link1]")


def test_torques_depend_on_base_parameters_alone(rng):
    scales = JointScales(*np.full((3, 7), 0.1))
    terms = (*inertial_terms(SEVEN), *joint_terms(SEVEN, ("rotor", "offset", "viscous"), scales))
    base, x = find_base(SEVEN, terms), rng.normal(size=len(terms))
    points = Points(*rng.normal(size=(3, 20, 7)))
    columns = ArmColumns(SEVEN, terms)
    whole = np.tensordot(x, columns.strong(points), 1)
    part = np.tensordot(base.matrix @ x, columns.strong(points, base.members), 1)
    np.testing.assert_allclose(part, whole, atol=1e-10)


def test_mass_matrix_gravity_and_friction_are_found(found, rng):
    true, model = found
    q = rng.uniform(-2.0, 2.0, (100, 3))
    for name in ("mass_matrix", "gravity"):
        ours, theirs = getattr(model, name)(q), getattr(true, name)(q)
        assert np.linalg.norm(ours - theirs) < 0.01 * np.linalg.norm(theirs), name
    friction = {term.text for term in model.terms if term.kind not in ("inertia", "rotor", "offset")}
    assert friction == {"viscous[q1]", "viscous[q3]", "dry[q2]", "dry[q3]"}
    distances = [term.distance for term in model.terms if term.kind == "dry"]
    np.testing.assert_allclose(distances, 2e-3, rtol=0.3)


def test_intervals_hold_what_they_promise():
    """Over five logs; white noise, so that nothing need be corrected."""
    scores = []
    for seed in range(5):
        rng = np.random.default_rng(100 + seed)
        true = truth(WRIST, rng, rotor=[0.2, 0.1, 0.05], viscous=[0.5, 0.2, 0.1], dry=[0.5, 0.4, 0.2])
        model = arms.identify(recorded(true, rng, 8.0, 200.0, 0.05), WRIST)
        known = dict(zip([t.text for t in true.terms], true.coefficients, strict=True))
        scores += [
            (value - known.get(term.text, 0.0)) / error
            for term, value, error in zip(model.terms, model.coefficients, model.standard_errors, strict=True)
        ]
    z = np.array(scores)
    assert 0.88 < np.mean(np.abs(z) < 1.96) <= 1.0
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.3


def test_prediction_is_as_good_as_the_noise(found):
    true, model = found
    errors = model.validate(recorded(true, np.random.default_rng(9)))
    np.testing.assert_allclose(errors.rms[-1] / errors.torque_std[-1], 0.02, rtol=0.2)
    assert (errors.by_joint[0] < 0.01).all()
    assert "below 5 Hz" in str(errors)


def test_bodies_can_exist_and_cost_little_where_the_truth_does(found):
    _, model = found
    solid = model.bodies()
    assert solid.can_exist.all()
    assert np.all(np.abs(solid.coefficients - model.coefficients) < 4.0 * model.standard_errors)
    assert "chi-squared" in solid.facts.notes[-1]


def test_bodies_that_cannot_exist_are_mended(rng):
    base = find_base(WRIST, inertial_terms(WRIST))
    x = bodies(3, rng).ravel()
    x[20 + 9] = -0.02  # a negative moment of inertia of the hand
    x[20 + 4] = 0.05
    wrong = base.matrix @ x
    mended = fit_bodies(WRIST, base, wrong, 1e-4 * np.eye(len(wrong)))
    assert can_exist(mended.values.reshape(3, 10)).all()
    assert mended.price > 1.0


def test_a_prior_fills_what_the_log_leaves_open(found):
    true, _ = found
    known = true.tree.inertias
    rng = np.random.default_rng(5)
    model = arms.identify(recorded(true, rng), WRIST.with_inertias(1.2 * known))
    posterior = model.parameters(share=0.3)
    n = 30
    assert np.all(posterior.standard_errors[:n] >= 0.0)
    # what is combined with nothing else is data; the first link's mass is prior
    place = {term.text: k for k, term in enumerate(model.base.terms)}
    assert posterior.from_data[place["mx[link3]"]] > 0.95
    assert posterior.from_data[place["m[link1]"]] < 1e-6
    assert posterior.values[place["m[link1]"]] == pytest.approx(1.2 * known[0, 0])
    np.testing.assert_allclose(model.base.matrix @ posterior.values, model.coefficients, atol=0.02)
    with pytest.raises(la.InputError, match="no inertia in the tree"):
        found[1].parameters()


def test_stamps_of_a_poll_are_replaced_by_the_clock(found):
    true, _ = found
    rng = np.random.default_rng(3)
    t, *states = motion(3, 12.0, 500.0, rng)
    torques = true.torques(*states, successive=True)
    polls = np.cumsum(rng.uniform(0.001, 0.0032, 5000)) + 0.1
    polls = polls[polls < t[-1]]
    seen = np.floor(polls * 500.0).astype(int)
    log = la.Trajectory(polls, states[0][seen], torques[seen], WRIST.coordinates, velocities=states[1][seen])
    ready, notes = prepared(Trajectories([log]), WRIST)
    assert "clock of 500 Hz" in notes[0]
    assert np.all(np.diff(seen[np.concatenate([[True], np.diff(seen) > 0])]) > 0)
    elapsed = t[np.unique(seen)]
    np.testing.assert_allclose(ready[0].t - ready[0].t[0], elapsed - elapsed[0], atol=1e-9)
    # a log whose stamps are those of the clock stays as it is
    same = la.Trajectory(t, states[0], torques, WRIST.coordinates, velocities=states[1])
    assert prepared(Trajectories([same]), WRIST)[1] == []


def test_a_urdf_becomes_a_tree(file, rng):
    tree = arms.read_urdf(file(URDF, "arm.urdf"))
    assert tree.coordinates == ("shoulder", "elbow")
    assert tree.links == ("upper", "lower")
    np.testing.assert_allclose(tree.joints[1].axis, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(tree.inertias[:, 0], [2.0, 1.5])
    # the tool hangs on the lower link
    np.testing.assert_allclose(tree.inertias[1, 1:4], 0.5 * np.array([0.1, 0.0, 0.3]))
    fixed = arms.read_urdf(file(URDF, "arm.urdf"), joints=["shoulder"])
    assert fixed.coordinates == ("shoulder",)
    q = rng.uniform(-1.0, 1.0, (5, 2))
    q[:, 1] = 0.0
    both = [arms.ArmModel.of_tree(t).gravity(q[:, : len(t)])[:, 0] for t in (tree, fixed)]
    np.testing.assert_allclose(*both, atol=1e-12)


def test_a_gripper_that_mimics_may_stay(file):
    """Fingers that nobody logs count as fixed where the joints that move are named."""
    text = URDF.replace('type="fixed"', 'type="prismatic"').replace(
        '<origin xyz="0.1 0 0.3"', '<mimic joint="elbow"/><origin xyz="0.1 0 0.3"'
    )
    path = file(text, "gripper.urdf")
    with pytest.raises(la.InputError, match="joints="):
        arms.read_urdf(path)
    tree = arms.read_urdf(path, joints=["shoulder", "elbow"])
    np.testing.assert_allclose(tree.inertias[:, 0], [2.0, 1.5])


def test_identified_inertias_return_to_the_urdf(file, tmp_path, rng):
    source = file(URDF, "arm.urdf")
    tree = arms.read_urdf(source).with_inertias(bodies(2, rng))
    arms.ArmModel.of_tree(tree).to_urdf(source, tmp_path / "out.urdf")
    again = arms.read_urdf(tmp_path / "out.urdf")
    np.testing.assert_allclose(again.inertias, tree.inertias, rtol=1e-6, atol=1e-9)
    assert "missing.stl" in (tmp_path / "out.urdf").read_text()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<robot", "<!DOCTYPE x [<!ENTITY a 'b'>]><robot", "remove them"),
        ("</robot>", "", "is not XML"),
        ('name="two"', 'name="two" xmlns:xacro="x"><xacro:a/></robot><!--', "is not XML"),
        ('type="fixed"', 'type="floating"', "fixed joints are supported"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="elbow"/>', "mimics another"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1"/>', "3 finite numbers"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "without length"),
        ('<joint name="elbow"', "<joint", "give it one"),
        ('<joint name="elbow"', '<joint name="flange"', "two joints 'flange'"),
        ('<parent link="base"/>', '<parent link="floor"/>', "'floor', which is missing"),
        ('<parent link="base"/>', '<parent link="lower"/>', "loop"),
        ('<mass value="2"/>', '<mass value="heavy"/>', "1 finite number"),
        ("robot", "sdf", "whose root is <robot>"),
    ],
)
def test_bad_urdfs_are_refused_in_one_line(file, old, new, words):
    assert old in URDF
    with pytest.raises(la.InputError) as caught:
        arms.read_urdf(file(URDF.replace(old, new), "arm.urdf"))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_model_survives_its_file(found, tmp_path):
    _, model = found
    model.save(tmp_path / "arm.json")
    again = arms.load(tmp_path / "arm.json")
    assert again.rows() == model.rows()
    assert again.facts == model.facts
    states = np.random.default_rng(1).normal(size=(3, 4, 3))
    np.testing.assert_array_equal(again.torques(*states), model.torques(*states))
    for text in ("{}", "[]", "no", '{"schema": 1, "kind": "arm"}'):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(la.InputError):
            arms.load(tmp_path / "bad.json")


def test_python_code_computes_the_same_torques(found, tmp_path, rng):
    slide = arms.KinematicTree.from_joints(
        [
            {"axis": (0, 1, 0)},
            {"kind": "prismatic", "axis": (1, 0, 1), "origin": (0.1, 0.2, 0.3), "rpy": (1, 2, 3)},
        ]
    )
    kinds = {kind: [0.3, 0.2] for kind in ("rotor", "spring", "offset", "viscous", "dry", "quadratic")}
    exact = arms.ArmModel.of_tree(slide.with_inertias(bodies(2, rng)), kinds)
    for model in (found[1], exact):
        model.to_python(tmp_path / "code.py")
        spec = importlib.util.spec_from_file_location("code_of_arm", tmp_path / "code.py")
        assert spec is not None
        code = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(code)  # type: ignore[union-attr]
        states = rng.normal(size=(3, len(model.tree)))
        np.testing.assert_allclose(code.torques(*states), model.torques(*states)[0], atol=1e-10)
        np.testing.assert_allclose(code.gravity(states[0]), model.gravity(states[0])[0], atol=1e-10)
        np.testing.assert_allclose(code.friction(states[1]), model.friction(*states[:2])[0], atol=1e-10)


def test_c_and_casadi_compute_the_same_torques(tmp_path, rng):
    slide = arms.KinematicTree.from_joints(
        [
            {"axis": (0, 1, 0)},
            {"kind": "prismatic", "axis": (1, 0, 1), "origin": (0.1, 0.2, 0.3), "rpy": (1, 2, 3)},
            {"axis": (0.6, 0.0, 0.8), "origin": (0.0, 0.2, 0.1), "parent": "q1"},
        ]
    )
    kinds = {kind: [0.3, 0.2, 0.1] for kind in ("rotor", "spring", "offset", "viscous", "dry", "quadratic")}
    model = arms.ArmModel.of_tree(
        slide.with_inertias(bodies(3, rng)), {**kinds, "asymmetric": [0.1, 0.0, 0.2]}
    )
    q, v, a = rng.normal(size=(3, 3))
    expected = model.torques(q, v, a)[0], model.gravity(q)[0], model.friction(q, v)[0]
    casadi = pytest.importorskip("casadi")
    assert casadi
    functions = model.to_casadi()
    ours = functions["torques"](q, v, a), functions["gravity"](q), functions["friction"](v)
    for one, other in zip(ours, expected, strict=True):
        np.testing.assert_allclose(np.array(one).ravel(), other, atol=1e-10)
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    model.to_c(tmp_path / "arm.c")
    library = tmp_path / "arm.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, str(tmp_path / "arm.c"), "-o", str(library), "-lm"], check=True)
    code = ctypes.CDLL(str(library))
    for name, given, other in zip(
        ("torques", "gravity", "friction"), ((q, v, a), (q,), (v,)), expected, strict=True
    ):
        tau = np.zeros(3)
        pointers = [np.ascontiguousarray(x).ctypes.data_as(ctypes.c_void_p) for x in (*given, tau)]
        getattr(code, f"arm_{name}")(*pointers)
        np.testing.assert_allclose(tau, other, atol=1e-10)


def test_acceleration_inverts_torques(found, rng):
    _, model = found
    q, qdot, qddot = rng.normal(size=(3, 6, 3))
    np.testing.assert_allclose(model.acceleration(q, qdot, model.torques(q, qdot, qddot)), qddot, atol=1e-8)


def test_bad_logs_are_refused_in_one_line(found, rng):
    true, model = found
    log = recorded(true, rng, 4.0)
    still = la.Trajectory(log.t, np.zeros_like(log.q), log.forces, log.coordinates)
    cases = [
        (la.Trajectory(log.t, log.q, None, log.coordinates), "holds no torques"),
        (la.Trajectory(log.t, log.q, log.forces, ("a", "b", "c")), "tree.renamed"),
        (la.Trajectory(log.t, 57.3 * log.q, log.forces, log.coordinates), "degrees"),
        (still, "stands still"),
        (log.rows(slice(0, 100)), "at least 200"),
    ]
    for bad, words in cases:
        with pytest.raises((la.InputError, la.DataError)) as caught:
            arms.identify(bad, WRIST)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(la.InputError, match="expected viscous"):
        arms.identify(log, WRIST, friction=["sticky"])
    with pytest.raises(la.InputError, match="shape"):
        model.torques([0.0], [0.0], [0.0])


def test_a_contact_is_reported_and_a_clean_log_is_not(found):
    true, model = found
    assert not any("contact" in note for note in model.facts.notes)
    log = recorded(true, np.random.default_rng(4), 8.0, 200.0)
    pushed = log.forces.copy()
    pushed[(log.t > 3.0) & (log.t < 3.6), 1] += 2.0
    again = arms.identify(la.Trajectory(log.t, log.q, pushed, log.coordinates, "run"), WRIST)
    (note,) = [note for note in again.facts.notes if "contact" in note]
    assert note.startswith("from 3.0")
    assert "the torque of q2" in note
    assert "\n" not in note


def test_currents_are_reported_where_the_tree_has_inertias(found):
    true, _ = found
    log = recorded(true, np.random.default_rng(4), 8.0, 200.0)
    known = WRIST.with_inertias(true.tree.inertias)
    currents = la.Trajectory(log.t, log.q, log.forces / [0.9, 12.0, 1.1], log.coordinates)
    notes = [note for note in arms.identify(currents, known).facts.notes if "torque constant" in note]
    assert len(notes) == 1
    assert "torques of q2 are 0.08" in notes[0]


def test_degrees_show_by_the_limits_of_the_file(found, file):
    true, _ = found
    log = recorded(true, np.random.default_rng(4), 2.0)
    limited = replace(WRIST.joints[0], limits=np.array([-0.01, 0.01, 1.0, 1.0]))
    tree = replace(WRIST, joints=(limited, *WRIST.joints[1:]))
    with pytest.raises(la.InputError, match="degrees to radians"):
        prepared(Trajectories([log]), tree)


def test_names_may_come_in_any_sequence(found):
    true, _ = found
    log = recorded(true, np.random.default_rng(2), 3.0)
    turned = la.Trajectory(log.t, log.q[:, ::-1], log.forces[:, ::-1], log.coordinates[::-1])
    (ready,) = prepared(Trajectories([turned]), WRIST)[0]
    np.testing.assert_array_equal(ready.q, log.q)
    np.testing.assert_array_equal(ready.forces, log.forces)


def test_the_command_writes_an_arm(found, file, tmp_path):
    true, _ = found
    log = recorded(true, np.random.default_rng(6), 8.0, 200.0)
    names = [f"{kind}{i + 1}" for kind in ("q", "tau") for i in range(3)]
    rows = np.column_stack([log.t, log.q, log.forces])
    lines = [",".join(["t", *names]), *(",".join(map(repr, row)) for row in rows.tolist())]
    data = file("\n".join(lines))
    table = file(f"a,d,alpha\n0,0.3,0\n0.05,0,{-PI / 2}\n0.25,0,{PI / 2}\n", "dh.csv")
    out = tmp_path / "found"
    given = ["arm", str(data), "--dh", str(table), "--forces", "tau1,tau2,tau3", "--output", str(out)]
    runner = CliRunner()
    done = runner.invoke(program, [*given, "--convention", "modified", "--hold-out", "25%"])
    assert done.exit_code == 0, done.output
    assert "Izz[link1]" in done.output
    assert "below 5 Hz" in done.output
    assert sorted(p.name for p in out.iterdir()) == ["arm.json", "inverse_dynamics.py"]
    assert arms.load(out / "arm.json").can_exist.all()
    for wrong, words in [
        ([], "--convention is missing"),
        (["--convention", "modified", "--urdf", "x"], "one of --urdf, --mjcf and --dh"),
    ]:
        failed = runner.invoke(program, [*given, *wrong])
        assert failed.exit_code == 2
        assert words in failed.output
