"""Arms: base parameters, identification from simulated logs, files; reports; exciting motions; payloads."""

from __future__ import annotations

import ctypes
import importlib.util
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import leastaction as la
from helpers import assert_refused_in_one_line, folding
from leastaction import arms, experiment
from leastaction.arms import compare
from leastaction.arms.base import can_exist, find_base, fit_bodies
from leastaction.arms.log import contact_notes, load_notes, prepared
from leastaction.arms.planning import Bounds, Limits, Plan, Series
from leastaction.arms.signals import bounded_starts
from leastaction.cli.program import program
from leastaction.data.trajectories import Trajectories
from leastaction.library.tree import rpy_matrix
from leastaction.mechanics import Points
from leastaction.mechanics.arm_columns import ArmColumns
from leastaction.mechanics.arm_terms import ArmTerm, JointScales, inertial_terms, joint_terms
from leastaction.mechanics.rigid_bodies import Motion
from leastaction.report.axes import Axes
from leastaction.report.figures_arm import ArmFigures, density, sides
from page_helpers import Page

PI = np.pi
WRIST = arms.KinematicTree.from_dh(
    [{"d": 0.3}, {"alpha": -PI / 2, "a": 0.05}, {"a": 0.25, "alpha": PI / 2}], modified=True
)
SEVEN = arms.KinematicTree.from_dh(
    [
        {"d": 0.34},
        {"alpha": -PI / 2},
        {"alpha": PI / 2, "d": 0.4},
        {"alpha": PI / 2},
        {"alpha": -PI / 2, "d": 0.4},
        {"alpha": -PI / 2},
        {"alpha": PI / 2, "d": 0.126},
    ],
    modified=True,
)


def bodies(n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 10) inertial parameters of ellipsoids, lighter towards the hand."""
    out = []
    for k in range(n):
        mass, centre = 4.0 * 0.72**k * rng.uniform(0.8, 1.2), rng.normal(0.0, 0.05, 3)
        turn, size = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.uniform(0.04, 0.1, 3)
        second = mass * (turn @ np.diag(size**2) @ turn.T + np.outer(centre, centre))
        inertia = np.trace(second) * np.eye(3) - second
        out.append([mass, *(mass * centre), *inertia[np.triu_indices(3)]])
    return np.array(out)


def motion(n: int, duration: float, rate: float, rng: np.random.Generator) -> list[np.ndarray]:
    """Times and a sum of sines with its derivatives."""
    t = np.arange(0.0, duration, 1.0 / rate)
    out = np.zeros((3, t.size, n))
    for j in range(n):
        for k in range(1, 9):
            (a, b), w = rng.normal(0.0, 0.5 / np.sqrt(k) / (1.0 + 0.15 * k), 2), 2.0 * PI * 0.15 * k
            wave, slope = a * np.sin(w * t) + b * np.cos(w * t), w * (a * np.cos(w * t) - b * np.sin(w * t))
            out[:, :, j] += wave, slope, -(w**2) * wave
    return [t, *out]


def recorded(
    model: arms.ArmModel,
    rng: np.random.Generator,
    duration: float = 10.0,
    rate: float = 250.0,
    noise: float = 0.02,
) -> la.Trajectory:
    """A log of the model: encoder steps, noisy torques."""
    t, *states = motion(len(model.tree), duration, rate, rng)
    torques = model.torques(*states, successive=True)
    torques += noise * torques.std(axis=0) * rng.normal(size=torques.shape)
    step = 2.0 * PI / 2**18
    return la.Trajectory(t, np.rint(states[0] / step) * step, torques, model.coordinates)


def truth(tree: arms.KinematicTree, rng: np.random.Generator, **joints: list[float]) -> arms.ArmModel:
    return arms.ArmModel.of_tree(tree.with_inertias(bodies(len(tree), rng)), joints, distance=2e-3)


# --------------------- arms: base parameters, identification from simulated logs, files, and what is refused
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


@pytest.mark.parametrize("angle", [1.5707963, 1.5708])
def test_rounded_angles_of_a_file_add_no_base_parameters(angle):
    """No log determines what depends on the rest of a right angle alone."""
    counts = []
    for right in (PI / 2, angle):
        rows = [{"d": 0.3}, {"alpha": -right, "a": 0.05}, {"a": 0.25, "alpha": right}]
        tree = arms.KinematicTree.from_dh(rows, modified=True)
        base = find_base(tree, inertial_terms(tree))
        counts.append(len(base.members))
        assert "e-0" not in " ".join(base.text(row) for row in range(len(base.members)))
    assert counts[0] == counts[1]


def test_torques_depend_on_base_parameters_alone(rng):
    scales = JointScales(*np.full((3, 7), 0.1))
    terms = (*inertial_terms(SEVEN), *joint_terms(SEVEN, ("rotor", "offset", "viscous"), scales))
    base, x = find_base(SEVEN, terms), rng.normal(size=len(terms))
    points = Points(*rng.normal(size=(3, 20, 7)))
    columns = ArmColumns(SEVEN, terms)
    whole = np.tensordot(x, columns.strong(points), 1)
    part = np.tensordot(base.matrix @ x, columns.strong(points, base.members), 1)
    np.testing.assert_allclose(part, whole, atol=1e-10)


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [2, 3])
def test_workers_do_not_change_the_result(short, workers):
    log, tree = short, WRIST
    alone, together = (arms.identify(log, tree, workers=n) for n in (None, workers))
    assert [t.text for t in together.terms] == [t.text for t in alone.terms]
    np.testing.assert_allclose(
        together.coefficients, alone.coefficients, atol=1e-6 * alone.standard_errors.min()
    )
    np.testing.assert_allclose(together.covariance, alone.covariance, rtol=1e-6, atol=1e-12)


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


@pytest.mark.thorough
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
    assert_refused_in_one_line(arms.read_urdf, file(URDF.replace(old, new), "arm.urdf"), words)


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
    more = arms.ArmModel.of_tree(exact.tree.with_terms(*ADDED[:1]), kinds, extra=0.4)
    for model in (found[1], exact, more):
        model.to_python(tmp_path / "code.py")
        spec = importlib.util.spec_from_file_location("code_of_arm", tmp_path / "code.py")
        assert spec is not None
        code = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(code)  # type: ignore[union-attr]
        states = rng.normal(size=(3, len(model.tree)))
        np.testing.assert_allclose(code.torques(*states), model.torques(*states)[0], atol=1e-10)
        np.testing.assert_allclose(code.gravity(states[0]), model.gravity(states[0])[0], atol=1e-10)
        np.testing.assert_allclose(code.friction(states[1]), model.friction(*states[:2])[0], atol=1e-10)


ADDED = (["q1_dot*q2_dot*cos(q1)", "sqrt(2-cos(q1))"], ["(q1_dot+q3_dot)**2/2", "abs(q1_dot-q2_dot)"])


@pytest.fixture(scope="module")
def coupled() -> tuple[arms.ArmModel, arms.ArmModel]:
    """A wrist whose motors are coupled, with a spring that compensates gravity: true and identified."""
    rng, tree = np.random.default_rng(8), WRIST.with_terms(*COUPLING)
    tree = tree.with_inertias(bodies(3, rng))
    true = arms.ArmModel.of_tree(tree, {"viscous": [0.5, 0.2, 0.1]}, extra=[0.05, 0.9, 0.15, 0.3])
    return true, arms.identify(recorded(true, rng), tree)


COUPLING = ["q2_dot*q3_dot", "cos(2*q2)"], ["(q2_dot+q3_dot)**2/2", "abs(q2_dot+q3_dot)"]


def test_couplings_and_compensators_are_found(coupled, rng):
    true, model = coupled
    kinds = [(term.kind, term.place) for term in model.terms]
    for k, value in zip(
        [kinds.index((kind, n)) for n, kind in enumerate(["extra"] * 2 + ["loss"] * 2)],
        [0.05, 0.9, 0.15, 0.3],
        strict=True,
    ):
        assert abs(model.coefficients[k] - value) < max(4.0 * model.standard_errors[k], 1e-9)
        assert model.standard_errors[k] < 0.05 * value
    q, v = rng.normal(size=(2, 20, 3))
    np.testing.assert_allclose(model.gravity(q), true.gravity(q), atol=0.02 * abs(true.gravity(q)).max())
    np.testing.assert_allclose(
        model.friction(q, v), true.friction(q, v), atol=0.02 * abs(true.friction(q, v)).max()
    )
    assert model.facts.unmeasured == ()
    assert not any("contact" in note for note in model.facts.notes)


def test_couplings_survive_files_and_bodies(coupled, tmp_path, rng):
    solid = coupled[1].bodies()
    solid.save(tmp_path / "arm.json")
    again = arms.load(tmp_path / "arm.json")
    assert again.rows() == solid.rows()
    states = rng.normal(size=(3, 4, 3))
    np.testing.assert_array_equal(again.torques(*states), solid.torques(*states))
    torques = solid.torques(*states)
    np.testing.assert_allclose(solid.acceleration(*states[:2], torques), states[2], atol=1e-9)


@pytest.mark.parametrize("extra", [False, True], ids=["", "with expressions"])
def test_c_and_casadi_compute_the_same_torques(tmp_path, rng, extra):
    slide = arms.KinematicTree.from_joints(
        [
            {"axis": (0, 1, 0)},
            {"kind": "prismatic", "axis": (1, 0, 1), "origin": (0.1, 0.2, 0.3), "rpy": (1, 2, 3)},
            {"axis": (0.6, 0.0, 0.8), "origin": (0.0, 0.2, 0.1), "parent": "q1"},
        ]
    )
    kinds = {kind: [0.3, 0.2, 0.1] for kind in ("rotor", "spring", "offset", "viscous", "dry", "quadratic")}
    slide = slide.with_terms(*ADDED) if extra else slide
    model = arms.ArmModel.of_tree(
        slide.with_inertias(bodies(3, rng)), {**kinds, "asymmetric": [0.1, 0.0, 0.2]}, extra=0.3
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


@pytest.mark.thorough
@pytest.mark.parametrize("size", [2.0, pytest.param(60.0, id="so strong that it spoils the joint fit")])
def test_a_contact_is_reported_and_a_clean_log_is_not(found, size):
    true, model = found
    assert not any("contact" in note for note in model.facts.notes)
    log = recorded(true, np.random.default_rng(4), 8.0, 200.0)
    pushed = log.forces.copy()
    pushed[(log.t > 3.0) & (log.t < 3.6), 1] += size
    again = arms.identify(la.Trajectory(log.t, log.q, pushed, log.coordinates, "run"), WRIST)
    (note,) = [note for note in again.facts.notes if "contact" in note]
    assert note.startswith("from 3.0")
    assert "the torque of q2" in note
    assert "\n" not in note


@pytest.mark.parametrize(("duration", "size"), [(0.15, 12.0), (0.4, 6.0), (1.0, 4.0)])
def test_contacts_of_any_duration_are_located(duration, size):
    """White errors with a push in one joint, in a random place of the second trial; none without it."""
    rng = np.random.default_rng(5)
    times, owners = np.tile(np.arange(0.01, 10.0, 0.02), 2), np.repeat([0, 1], 500)
    for _ in range(20):
        errors, begin, joint = rng.normal(size=(1000, 3)), rng.uniform(1.0, 8.0), int(rng.integers(3))
        assert contact_notes(WRIST, times, owners, errors, ("a", "b")) == []
        known = (times > 7.0) | (np.arange(3)[:, None] > 0)  # the first joint has not moved before
        assert contact_notes(WRIST, times, owners, errors * known.T, ("a", "b")) == []
        inside = (times > begin) & (times < begin + duration) & (owners == 1)
        errors[inside, joint] += size * (-1.0) ** joint
        (note,) = contact_notes(WRIST, times, owners, errors, ("a", "b"))
        first, last = map(float, re.findall(r"from ([\d.]+) to ([\d.]+) s", note)[0])
        assert abs(first - begin) < 0.25
        assert abs(last - begin - duration) < 0.25
        assert f"'b' the torque of q{joint + 1} " in note


def rested(true: arms.ArmModel, rng: np.random.Generator, rest: float) -> la.Trajectory:
    """A log that begins while friction holds the arm, after a motion that it does not show."""
    rate, begin, n = 250.0, 1.0, len(true.tree)
    t = np.arange(0.0, 8.0 + rest, 1.0 / rate)
    inside = np.clip((t - begin) / 0.5, 0.0, 1.0) - np.clip((t - begin - rest) / 0.5, 0.0, 1.0)
    speed = np.cos(np.pi / 2.0 * inside) ** 2
    clock = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2.0 / rate)])
    q, qdot, qddot = np.zeros((3, t.size, n))
    for j in range(n):
        for k in range(1, 7):
            (a, b), w = rng.normal(0.0, 0.4, 2), 2.0 * PI * 0.2 * k
            sine, cosine = np.sin(w * clock), np.cos(w * clock)
            wave, slope = a * sine + b * cosine, w * (a * cosine - b * sine)
            q[:, j] += wave
            qdot[:, j] += slope * speed
            qddot[:, j] += slope * np.gradient(speed, 1.0 / rate) - w**2 * wave * speed**2
    torques = true.torques(q, qdot, qddot, successive=True)
    torques += 0.02 * torques.std(axis=0) * rng.normal(size=torques.shape)
    kept = t > begin + 0.55
    return la.Trajectory(t[kept], q[kept], torques[kept], true.coordinates, "run")


def test_friction_at_the_start_is_bounded_by_dry_friction(rng):
    """As least squares with one more observation of each: zero, with the variance of a value within ± dry."""
    scales = JointScales(np.ones(2), np.ones(2), np.ones(2))
    tree = arms.KinematicTree.from_dh([{}, {"a": 1.0}], modified=True)
    starts = [ArmTerm("start", "start", i) for i in (1, 0)]
    terms = [*joint_terms(tree, ("dry", "viscous"), scales), *starts]
    root = rng.normal(size=(9, 6))
    information, dry = root.T @ root, np.array([0.5, -2.0])
    values = np.concatenate([dry, rng.normal(size=4)])
    found, covariance = bounded_starts(terms, values, np.linalg.inv(information))
    more = information + np.diag([0.0] * 4 + [3.0 / 4.0, 3.0 / 0.25])
    np.testing.assert_allclose(covariance, np.linalg.inv(more), atol=1e-12)
    np.testing.assert_allclose(found, np.linalg.solve(more, information @ values), atol=1e-12)
    same = bounded_starts(terms[:4], values[:4], np.eye(4))
    np.testing.assert_array_equal(same[0], values[:4])


@pytest.mark.thorough
@pytest.mark.parametrize(("rest", "seed", "copies"), [(0.7, 9, 2), (3.0, 11, 1)])
def test_friction_that_holds_the_arm_when_a_log_begins_does_not_disturb(found, rest, seed, copies):
    true, log = found[0], rested(found[0], np.random.default_rng(seed), rest)
    assert np.ptp(log.q[log.t < 1.0 + rest], axis=0).max() < 1e-9
    model = arms.identify([log.changed(name=f"run{k}") for k in range(copies)], WRIST)
    assert not any("contact" in note for note in model.facts.notes)
    masses = [one.mass_matrix(log.q[::50]) for one in (model, true)]
    assert np.linalg.norm(masses[0] - masses[1]) < 0.007 * np.linalg.norm(masses[1])
    dry = {t.text: c for t, c in zip(model.terms, model.coefficients, strict=True) if t.kind == "dry"}
    assert dry == pytest.approx({"dry[q2]": 0.6, "dry[q3]": 0.2}, rel=0.05)
    assert all(term.kind != "start" for term in model.terms)


@pytest.mark.thorough
def test_currents_are_reported_where_the_tree_has_inertias(found):
    true, _ = found
    log = recorded(true, np.random.default_rng(4), 8.0, 200.0)
    known = WRIST.with_inertias(true.tree.inertias)
    currents = la.Trajectory(log.t, log.q, log.forces / [0.9, 12.0, 1.1], log.coordinates)
    model = arms.identify(currents, known, recording=arms.Recording(delays=False))
    notes = [note for note in model.facts.notes if "torque constant" in note]
    assert len(notes) == 1
    assert "torques of q2 are 0.08" in notes[0]


def shifted(log: la.Trajectory, delays: list[float]) -> la.Trajectory:
    """Torques recorded later than they act."""
    assert log.forces is not None
    late = [np.interp(log.t - d, log.t, column) for d, column in zip(delays, log.forces.T, strict=True)]
    return la.Trajectory(log.t, log.q, np.stack(late, 1), log.coordinates)


@pytest.fixture(scope="module")
def short() -> la.Trajectory:
    rng = np.random.default_rng(4)
    true = truth(WRIST, rng, rotor=[0.2, 0.1, 0.05], viscous=[0.5, 0.2, 0.1], dry=[0.5, 0.4, 0.2])
    return recorded(true, rng, 8.0, 200.0)


@pytest.mark.thorough
def test_gains_of_currents_are_found_where_one_is_known(short):
    gains = np.array([1.0, 12.0, -0.7])
    currents = la.Trajectory(short.t, short.q, short.forces / gains, short.coordinates)
    facts = arms.identify(currents, WRIST, recording=arms.Recording(gains={"q1": 1.0})).facts
    z = (np.array(facts.gains) - gains)[1:] / facts.gain_errors[1:]
    assert np.abs(z).max() < 4.0
    assert (np.array(facts.gain_errors)[1:] < 0.03 * np.abs(gains[1:])).all()
    assert facts.gain_errors[0] == 0.0
    assert any("torque per unit of the log: q2 12" in note for note in facts.notes)


@pytest.mark.parametrize(
    ("gains", "words"),
    [({}, "determine only ratios"), ({"q9": 1.0}, "q9"), ({"q1": 0.0}, "is 0.0"), ({"q1": np.inf}, "is inf")],
)
def test_bad_gains_are_refused_in_one_line(short, gains, words):
    with pytest.raises(la.InputError, match=words) as caught:
        arms.identify(short, WRIST, recording=arms.Recording(gains=gains))
    assert "\n" not in str(caught.value)


def test_delays_that_joints_share_are_found(found, short):
    assert found[1].facts.delays == (0.0, 0.0, 0.0)  # punctual torques stay as they are
    model = arms.identify(shifted(short, [4e-3] * 3), WRIST)
    z = (np.array(model.facts.delays) - 4e-3) / model.facts.delay_errors
    assert np.abs(z).max() < 4.0
    assert any("delays of the recorded torques" in note for note in model.facts.notes)
    # and the same shift is made before another log is compared
    apart = model.validate(shifted(short, [4e-3] * 3)).overall[0]
    assert apart < 0.5 * model.validate(short).overall[0]


@pytest.mark.thorough
def test_delays_of_single_joints_are_found_on_request(short):
    delays = [0.0, 4e-3, 20e-3]
    facts = arms.identify(shifted(short, delays), WRIST, recording=arms.Recording(delays=True)).facts
    assert np.abs((np.array(facts.delays) - delays) / facts.delay_errors).max() < 4.0


@pytest.fixture(scope="module")
def missing(short) -> arms.ArmModel:
    """A wrist whose second torque was not measured."""
    return arms.identify(short, WRIST, recording=arms.Recording(unmeasured=["q2"]))


def test_what_other_joints_show_is_found_without_a_torque(short, missing):
    rng = np.random.default_rng(4)
    joints = {"rotor": [0.2, 0.1, 0.05], "viscous": [0.5, 0.2, 0.1], "dry": [0.5, 0.4, 0.2]}
    inertias = truth(WRIST, rng).tree.inertias
    true = [
        inertias[term.place, term.component]
        if term.kind == "inertia"
        else joints.get(term.kind, [0.0] * 3)[term.place]
        for term in missing.base.terms
    ]
    z = (missing.coefficients - missing.base.matrix @ true) / missing.standard_errors
    assert np.sqrt(np.mean(z**2)) < 1.5
    assert not any(term.place == 1 for term in missing.terms if term.kind != "inertia")
    errors = missing.bodies().validate(short)
    assert np.isnan(errors.by_joint[:, 1]).all()
    assert (errors.by_joint[:, [0, 2]] < 0.1).all()
    assert (errors.overall < 0.05).all()
    assert "–" in str(errors)


def test_forces_of_unmeasured_joints_have_no_effect(short, missing):
    forces = short.forces.copy()
    forces[:, 1] = 1e3 * np.sin(short.t)
    log = la.Trajectory(short.t, short.q, forces, short.coordinates)
    again = arms.identify(log, WRIST, recording=arms.Recording(unmeasured=["q2"]))
    np.testing.assert_array_equal(again.coefficients, missing.coefficients)


def test_an_arm_with_an_unmeasured_joint_survives_its_file_and_has_a_report(short, missing, tmp_path):
    missing.save(tmp_path / "arm.json")
    again = arms.load(tmp_path / "arm.json")
    assert again.facts == missing.facts
    assert str(again) == str(missing)
    page = Page(la.write_arm_report(missing, tmp_path / "arm.html", short).read_text(encoding="utf-8"))
    assert not {"torque1-t", "friction1-t"} & set(page.attributes("id"))
    assert "torque2-t" in page.attributes("id")
    assert "not measured" in page.by_id("data").text
    assert "the torque of q2 is not measured" in page.by_id("verdict").text
    assert "Shown: ." not in page.root.text
    assert "largest errors" not in page.root.text
    assert not re.search(r"\bnan\b", page.root.text)
    with pytest.raises(la.InputError, match="q2 had none"):
        missing.free_runs(short)


@pytest.mark.thorough
def test_gains_and_delays_are_found_beside_an_unmeasured_joint(short):
    gains = np.array([1.0, 5.0, -0.7])
    late = shifted(short, [4e-3] * 3)
    currents = la.Trajectory(late.t, late.q, late.forces / gains, late.coordinates)
    recording = arms.Recording(gains={"q1": 1.0}, delays=True, unmeasured=["q2"])
    facts = arms.identify(currents, WRIST, recording=recording).facts
    assert abs(facts.gains[2] + 0.7) < 4.0 * facts.gain_errors[2]
    assert np.abs((np.array(facts.delays) - 4e-3)[[0, 2]] / np.array(facts.delay_errors)[[0, 2]]).max() < 4.0
    assert facts.delay_errors[1] == facts.gain_errors[1] == 0.0


def test_a_torque_of_zero_is_reported(short):
    forces = short.forces * [1.0, 0.0, 1.0]
    log = la.Trajectory(short.t, short.q, forces, short.coordinates)
    assert "unmeasured=['q2']" in prepared(Trajectories([log]), WRIST)[1][0]
    assert not prepared(Trajectories([log]), WRIST, [1])[1]


@pytest.mark.parametrize(
    ("recording", "words"),
    [
        ({"unmeasured": ["q9"]}, "'q9'; expected joints of the tree"),
        ({"unmeasured": ["q1", "q2", "q3"]}, "no joint has a measured torque"),
        ({"unmeasured": ["q2"], "gains": {"q2": 1.0}}, "gains and unmeasured both hold 'q2'"),
    ],
)
def test_bad_unmeasured_joints_are_refused_in_one_line(short, recording, words):
    with pytest.raises(la.InputError, match=re.escape(words)) as caught:
        arms.identify(short, WRIST, recording=arms.Recording(**recording))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("distance", [pytest.param(0.0, marks=pytest.mark.thorough), 2e-3])
def test_free_runs_follow_the_motion_of_the_true_arm(rng, distance):
    """Forward dynamics undo inverse dynamics, with either kind of dry friction."""
    acting = {"rotor": [0.2, 0.1, 0.05], "dry": [0.5, 0.4, 0.2], "viscous": [0.5, 0.2, 0.1]}
    true = arms.ArmModel.of_tree(WRIST.with_inertias(bodies(3, rng)), acting, distance=distance, width=0.01)
    t, *states = motion(3, 1.25, 1000.0, rng)
    log = la.Trajectory(t, states[0], true.torques(*states, successive=True), WRIST.coordinates)
    runs = true.free_runs(log, horizon=0.2)
    assert runs.rms.shape == (3, 3)
    assert runs.by_joint.max() < 1e-3
    heavy = arms.ArmModel.of_tree(WRIST.with_inertias(1.1 * true.tree.inertias), acting, distance=distance)
    assert heavy.free_runs(log, horizon=0.2).by_joint.max() > 5.0 * runs.by_joint.max()
    assert "free runs of 0.2 s" in str(runs)
    with pytest.raises(la.DataError, match="no run is longer"):
        true.free_runs(log, horizon=5.0)
    with pytest.raises(la.InputError, match="horizon is"):
        true.free_runs(log, horizon=-1.0)


@pytest.mark.parametrize(
    ("lost", "said"),
    [([1], "error of 2 free runs of 0.2 s"), ([0, 1, 2], "all 3 free runs of 0.2 s diverge")],
)
def test_free_runs_that_diverge_are_counted(rng, monkeypatch, lost, said):
    true = arms.ArmModel.of_tree(WRIST.with_inertias(bodies(3, rng)), {"viscous": [0.5, 0.2, 0.1]})
    t, *states = motion(3, 1.25, 200.0, rng)
    log = la.Trajectory(t, states[0], true.torques(*states), WRIST.coordinates)
    real = compare._simulated

    def simulated(*given):
        out = real(*given)
        out[:, lost] = 1e200
        return out

    monkeypatch.setattr(compare, "_simulated", simulated)
    text = str(true.free_runs(log, horizon=0.2))
    assert text.startswith(said)
    assert "nan" not in text
    assert text.endswith("; 1 more diverge") == (len(lost) == 1)


def test_a_mujoco_model_keeps_rotors_that_links_hide(tmp_path, rng):
    """The rotor of a first joint and its link are one base parameter; the file needs both."""
    acting = {"rotor": [0.2, 0.1, 0.05], "spring": [1.0, 2.0, 3.0]}
    true = arms.ArmModel.of_tree(WRIST.with_inertias(bodies(3, rng)), acting)
    true.to_mjcf(tmp_path / "arm.xml")
    tree = arms.read_mjcf(tmp_path / "arm.xml")
    again = arms.ArmModel.of_tree(tree, tree.dynamics)
    q = rng.normal(size=(5, 3))
    np.testing.assert_allclose(again.mass_matrix(q), true.mass_matrix(q), rtol=1e-6, atol=1e-9)


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


def as_csv(log: la.Trajectory, coordinates: tuple[str, ...] = ("q1", "q2", "q3")) -> str:
    """A log with the columns t, the coordinates, and tau1 to tau3."""
    rows = np.column_stack([log.t, log.q, log.forces])
    head = ",".join(["t", *coordinates, "tau1", "tau2", "tau3"])
    return "\n".join([head, *(",".join(map(repr, row)) for row in rows.tolist())])


def test_the_command_writes_an_arm(found, file, tmp_path):
    true, _ = found
    data = file(as_csv(recorded(true, np.random.default_rng(6), 8.0, 200.0)))
    table = file(f"a,d,alpha\n0,0.3,0\n0.05,0,{-PI / 2}\n0.25,0,{PI / 2}\n", "dh.csv")
    out = tmp_path / "found"
    given = ["arm", str(data), "--dh", str(table), "--forces", "tau1,tau2,tau3", "--output", str(out)]
    runner = CliRunner()
    done = runner.invoke(program, [*given, "--convention", "modified", "--hold-out", "25%"])
    assert done.exit_code == 0, done.output
    assert "Izz[link1]" in done.output
    assert "below 5 Hz" in done.output
    assert sorted(p.name for p in out.iterdir()) == ["arm.json", "inverse_dynamics.py", "report.html"]
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "The model predicts held-out torques to" in report
    assert "--hold-out 25%" in report
    assert arms.load(out / "arm.json").can_exist.all()
    for wrong, words in [
        ([], "--convention is missing"),
        (["--convention", "modified", "--urdf", "x"], "one of --urdf, --mjcf and --dh"),
    ]:
        failed = runner.invoke(program, [*given, *wrong])
        assert failed.exit_code == 2
        assert words in failed.output


def test_the_command_takes_couplings(coupled, file, tmp_path):
    data = file(as_csv(recorded(coupled[0], np.random.default_rng(6), 6.0, 200.0)))
    table = file(f"a,d,alpha\n0,0.3,0\n0.05,0,{-PI / 2}\n0.25,0,{PI / 2}\n", "dh.csv")
    given = ["arm", str(data), "--dh", str(table), "--convention", "modified"]
    given += ["--term", COUPLING[0][0], "--term", COUPLING[0][1], "--output", str(tmp_path / "found")]
    done = CliRunner().invoke(program, [*given, "--dissipation", ", ".join(COUPLING[1])])
    assert done.exit_code == 0, done.output
    assert "coefficient of q2_dot*q3_dot in L" in done.output
    assert "coefficient of abs(q2_dot+q3_dot) in the dissipation function" in done.output
    report = (tmp_path / "found" / "report.html").read_text(encoding="utf-8")
    assert "psi[(q2_dot+q3_dot)**2/2]" in report
    assert "added: (q2_dot+q3_dot)**2/2, abs(q2_dot+q3_dot)" in report
    for option, text in (("--term", "q9"), ("--dissipation", "q1_dot**2")):
        failed = CliRunner().invoke(program, [*given, option, text])
        assert failed.exit_code == 2
        assert failed.output.startswith(f"error: {option}: ")
        assert len(failed.output.strip().splitlines()) == 1


def test_the_command_reads_currents_and_a_mujoco_model_without_its_meshes(found, file, tmp_path):
    true, _ = found
    true.to_mjcf(tmp_path / "arm.xml")
    text = (tmp_path / "arm.xml").read_text()
    mesh = '<asset><mesh name="m" file="missing.stl"/></asset><worldbody><geom type="mesh" mesh="m"/>'
    model = file(text.replace("<worldbody>", mesh), "arm.xml")
    log = recorded(true, np.random.default_rng(6), 5.0, 200.0)
    currents = la.Trajectory(log.t, log.q, log.forces / [1.0, 4.0, 1.0], log.coordinates)
    out = tmp_path / "found"
    given = ["arm", str(file(as_csv(currents))), "--mjcf", str(model), "--forces", "tau1,tau2,tau3"]
    given += ["--output", str(out), "--gains"]
    done = CliRunner().invoke(program, [*given, "q1=1, q3=1"])
    assert done.exit_code == 0, done.output
    assert "torque per unit of the log: q2 " in done.output
    assert sorted(p.name for p in out.iterdir()) == [
        "arm.json",
        "arm.xml",
        "inverse_dynamics.py",
        "report.html",
    ]
    tree, q = arms.read_mjcf(out / "arm.xml"), log.q[::100]
    masses = arms.ArmModel.of_tree(tree, tree.dynamics).mass_matrix(q)
    assert np.linalg.norm(masses - true.mass_matrix(q)) < 0.05 * np.linalg.norm(masses)
    for wrong, words in [("q1", "expected JOINT=NUMBER"), ("q9=1", "expected joints of the tree")]:
        failed = CliRunner().invoke(program, [*given, wrong])
        assert failed.exit_code == 2
        assert words in failed.output


@pytest.mark.parametrize(
    ("change", "names", "words"),
    [
        (1.0, ("a", "b", "c"), "q1"),
        (57.3, ("q1", "q2", "q3"), "convert the angles to radians"),
        (0.0, ("q1", "q2", "q3"), "move every joint"),
    ],
)
def test_the_command_refuses_bad_logs_in_one_line(found, file, tmp_path, change, names, words):
    log = recorded(found[0], np.random.default_rng(6), 3.0, 100.0)
    data = file(as_csv(la.Trajectory(log.t, change * log.q, log.forces, log.coordinates), names))
    table = file(f"a,d,alpha\n0,0.3,0\n0.05,0,{-PI / 2}\n0.25,0,{PI / 2}\n", "dh.csv")
    given = ["arm", str(data), "--dh", str(table), "--convention", "modified", "--forces", "tau1,tau2,tau3"]
    failed = CliRunner().invoke(program, [*given, "--output", str(tmp_path / "out")])
    assert failed.exit_code in (1, 2)
    assert words in failed.output
    assert len(failed.output.strip().splitlines()) == 1


def test_the_command_leaves_out_unmeasured_torques(found, file, tmp_path):
    data = file(as_csv(recorded(found[0], np.random.default_rng(6), 5.0, 200.0)))
    table = file(f"a,d,alpha\n0,0.3,0\n0.05,0,{-PI / 2}\n0.25,0,{PI / 2}\n", "dh.csv")
    given = ["arm", str(data), "--dh", str(table), "--convention", "modified", "--forces", "q1=tau1,q3=tau3"]
    given += ["--output", str(tmp_path / "out")]
    done = CliRunner().invoke(program, [*given, "--unmeasured", "q2"])
    assert done.exit_code == 0, done.output
    assert "viscous[q1]" in done.output
    assert "[q2]" not in done.output
    given[-1] = str(tmp_path / "another")
    for wrong, words in [("q7", "unmeasured holds 'q7'"), ("q1,,q2", "--unmeasured")]:
        failed = CliRunner().invoke(program, [*given, "--unmeasured", wrong])
        assert failed.exit_code == 2
        assert words in failed.output
        assert len(failed.output.strip().splitlines()) == 1


def test_links_without_inertia_are_named(found):
    (note,) = [note for note in found[1].bodies().facts.notes if "no inertia" in note]
    assert "link1, link2, link3" in note
    assert "with_inertias" in note


# ----------------------------------------------- columns by the names that loggers give them, and bags of ROS
NAMED = arms.KinematicTree.from_joints(
    [{"name": f"panda_joint{k}", "axis": (0, k % 2, 1 - k % 2), "origin": (0.1, 0, 0.3)} for k in (1, 2, 3)]
)
ORDER = (2, 0, 1)  # in which ROS may list the joints
EPOCH = 1_700_000_000


def ros_names(log: la.Trajectory) -> dict[str, list]:
    """A message in columns, with the joints in another order, a gripper, and stamps in ns."""
    names = [log.coordinates[i] for i in ORDER]
    table = {"%time": [EPOCH * 10**9 + round(1e9 * t) for t in log.t]}
    for k, name in enumerate([*names, "panda_finger_joint1"]):
        table[f"field.name{k}"] = [name] * log.n_times
    for word, values in (("position", log.q), ("velocity", 0.0 * log.q), ("effort", log.forces)):
        for k, i in enumerate(ORDER):
            table[f"field.{word}{k}"] = values[:, i].tolist()
        table[f"field.{word}3"] = [0.04] * log.n_times
    return table


def topics(log: la.Trajectory) -> dict[str, list]:
    table = {"__time": (EPOCH + log.t).tolist()}
    for k, name in enumerate(log.coordinates):
        for word, values in (("effort", log.forces), ("position", log.q)):
            table[f"/joint_states/{name}/{word}"] = values[:, k].tolist()
    return table


def libfranka(log: la.Trajectory) -> dict[str, list]:
    table = {"time": np.rint(1e3 * log.t).astype(int).tolist(), "success_rate": [1.0] * log.n_times}
    kinds = {"state.q": log.q, "state.q_d": 9.0 + log.q, "state.dq": 0.0 * log.q, "state.tau_J": log.forces}
    kinds |= {"state.tau_ext_hat_filtered": 7.0 * log.q, "cmd.tau_J_d": 8.0 * log.q}
    return table | {f" {n}[{k}]": v[:, k].tolist() for n, v in kinds.items() for k in range(v.shape[1])}


def rtde(log: la.Trajectory) -> dict[str, list]:
    table = {"timestamp": log.t.tolist()}
    kinds = {
        "target_q": 9.0 + log.q,
        "actual_q": log.q,
        "actual_current": log.forces,
        "actual_TCP_force": log.q,
    }
    return table | {f"{n}_{k}": v[:, k].tolist() for n, v in kinds.items() for k in range(v.shape[1])}


def table_text(table: dict[str, list], separator: str = ",") -> str:
    lines = [
        separator.join(table),
        *(separator.join(map(str, row)) for row in zip(*table.values(), strict=True)),
    ]
    return "\n".join(lines)


@pytest.fixture(scope="module")
def short_log() -> la.Trajectory:
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 2.0, 0.004)
    return la.Trajectory(t, rng.normal(size=(500, 3)), rng.normal(size=(500, 3)), NAMED.coordinates)


@pytest.mark.parametrize(
    ("columns", "separator", "currents"),
    [(ros_names, ",", False), (topics, ",", False), (libfranka, ",", False), (rtde, " ", True)],
)
def test_columns_of_common_loggers_are_recognised(short_log, file, columns, separator, currents):
    path = file(table_text(columns(short_log), separator))
    (read,) = arms.read_log(path, NAMED, currents=currents)
    np.testing.assert_allclose(read.q, short_log.q)
    np.testing.assert_allclose(read.forces, short_log.forces)
    np.testing.assert_allclose(np.diff(read.t), np.diff(short_log.t), atol=1e-6)
    found = arms.log_columns(path, NAMED)
    assert found.currents is currents
    assert "\n" not in str(found)
    assert str(found).startswith("time = ")


def test_joints_of_another_name_are_taken_by_number(short_log, file):
    path = file(table_text(topics(short_log)))
    other = NAMED.renamed(["a", "b", "c"])
    (read,) = arms.read_log(path, other)
    assert read.coordinates == ("a", "b", "c")
    np.testing.assert_allclose(read.q, short_log.q)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (lambda log: {"t": log.t, "x": log.q[:, 0]}, "no columns seem to be the positions"),
        (lambda log: rtde(log), "seem to be motor currents; pass currents=True"),
        (lambda log: {k: v for k, v in topics(log).items() if "effort" not in k}, "neither torques nor"),
        (
            lambda log: topics(log) | {k.replace("states", "other"): v for k, v in topics(log).items()},
            "may be '/joint_states/panda_joint1/effort', '/joint_other/panda_joint1/effort'",
        ),
        (
            lambda log: {k: ["x"] * 500 if "name" in k else v for k, v in ros_names(log).items()},
            "has the joints x, x, x, x, and the arm",
        ),
    ],
)
def test_unclear_columns_are_refused_in_one_line(short_log, file, table, words):
    with pytest.raises(la.InputError, match=re.escape(words)) as caught:
        arms.read_log(file(table_text(table(short_log))), NAMED)
    assert "\n" not in str(caught.value)


def test_a_log_of_more_joints_than_the_arm_has_is_refused(short_log, file):
    """The lowest numbers need not be those of the arm."""
    two = arms.KinematicTree.from_dh([{"d": 0.3}, {"alpha": -PI / 2}], modified=True)
    with pytest.raises(la.InputError, match="describe the whole arm") as caught:
        arms.read_log(file(table_text(rtde(short_log))), two, currents=True)
    assert "the 3 columns" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["MCAP", "SQLITE3"])
def test_a_bag_of_ros_is_a_log(short_log, tmp_path, kind):
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types, message = get_typestore(Stores.ROS2_HUMBLE), "sensor_msgs/msg/JointState"
    names = [short_log.coordinates[i] for i in ORDER]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin[kind]) as writer:
        connection = writer.add_connection("/joint_states", message, typestore=types)
        for t, q, forces in zip(short_log.t, short_log.q, short_log.forces, strict=True):
            nanoseconds = round(1e9 * t)
            time = types.types["builtin_interfaces/msg/Time"](
                EPOCH + nanoseconds // 10**9, nanoseconds % 10**9
            )
            header = types.types["std_msgs/msg/Header"](time, "")
            state = types.types[message](header, names, q[[*ORDER]], np.zeros(3), forces[[*ORDER]])
            writer.write(connection, EPOCH * 10**9 + nanoseconds + 10**6, types.serialize_cdr(state, message))
    (read,) = arms.read_log(tmp_path / "bag", NAMED)
    np.testing.assert_array_equal(read.q, short_log.q)
    np.testing.assert_array_equal(read.forces, short_log.forces)
    np.testing.assert_allclose(read.t, short_log.t, atol=1e-9)


def test_the_command_recognises_columns_and_refuses_currents_without_a_gain(found, file, tmp_path):
    log = recorded(found[0], np.random.default_rng(6), 5.0, 200.0)
    table = file(f"a,d,alpha\n0,0.3,0\n0.05,0,{-PI / 2}\n0.25,0,{PI / 2}\n", "dh.csv")
    given = ["--dh", str(table), "--convention", "modified", "--output", str(tmp_path / "out")]
    currents = file(table_text(rtde(log), " "), "rtde.csv")
    runner = CliRunner()
    refused = runner.invoke(program, ["arm", str(currents), *given])
    assert refused.exit_code == 2
    assert "seem to be motor currents" in refused.output
    assert len(refused.output.strip().splitlines()) == 1
    done = runner.invoke(program, ["arm", str(file(table_text(libfranka(log)))), *given])
    assert done.exit_code == 0, done.output
    assert "columns: time = time in ms; q1 = position state.q[0], velocity state.dq[0]" in done.output
    none = runner.invoke(program, ["arm", str(file("t,x\n0,1\n1,2\n")), *given])
    assert none.exit_code == 2
    assert "--forces is missing, and" in none.output
    assert len(none.output.strip().splitlines()) == 1


# ------------------------------------------------------------------------------------------- reports of arms
@pytest.fixture(scope="module")
def halves(found) -> tuple[Trajectories, Trajectories]:
    """A log of the found arm, and its end."""
    log = recorded(found[0], np.random.default_rng(8), 8.0, 200.0)
    return Trajectories([log]).hold_out("25%")


@pytest.fixture(scope="module")
def page(found, halves, tmp_path_factory) -> Page:
    path = tmp_path_factory.mktemp("report") / "arm.html"
    assert la.write_arm_report(found[1], path, halves[0], held_out=halves[1]) == path
    return Page(path.read_text(encoding="utf-8"))


def test_the_report_is_self_contained_and_complete(found, halves, page):
    model = found[1]
    assert not {"script", "link", "img", "iframe"} & {tag for tag, _ in page.tags}
    identifiers = page.attributes("id")
    assert len(identifiers) == len(set(identifiers))
    assert {link.removeprefix("#") for link in page.attributes("href")} <= set(identifiers)
    sections = [str(node.attributes["id"]) for node in page.root.one("main").all("section")]
    assert " ".join(sections) == "verdict facts torques spectra friction arm parameters data reproduce"
    for figure in ("torque", "error", "spectrum", "friction"):
        assert {f"{figure}{i}-t" for i in range(3)} <= set(identifiers)
    rows = [row for body in page.by_id("parameters").all("tbody") for row in body.all("tr")]
    assert sum("group" not in (row.attributes.get("class") or "") for row in rows) == len(model.coefficients)
    far = model.bodies().validate(halves[1]).overall
    assert f"off by {100 * far[0]:.2g} % of their rms below 5 Hz" in page.by_id("verdict").text.replace(
        "\u202f", " "
    )


def test_the_report_says_what_is_wrong_with_a_model(found, halves, tmp_path):
    model = found[1]
    turned = np.where([term.kind == "rotor" for term in model.terms], -9.0, 1.0) * model.coefficients
    parts = (model.tree, model.base, turned, model.covariance, model.reference, model.facts)
    path = la.write_arm_report(arms.ArmModel(*parts), tmp_path / "arm.html", *halves[:1])
    verdict = Page(path.read_text(encoding="utf-8")).by_id("verdict").text
    assert "Not physical: rotor[" in verdict
    assert "Consistency: if links must be able to exist" in verdict
    assert "Held-out" not in verdict


def test_names_of_links_are_escaped_in_the_report(found, halves, tmp_path):
    model, hostile = found[1], "</title><script>alert(1)</script>"
    joints = tuple(replace(joint, link=f"{hostile}{k}") for k, joint in enumerate(model.tree.joints))
    tree = arms.KinematicTree(joints, model.tree.gravity, hostile)
    parts = (tree, model.base, model.coefficients, model.covariance, model.reference, model.facts)
    path = la.write_arm_report(arms.ArmModel(*parts), tmp_path / "arm.html", halves[0], command=hostile)
    text = path.read_text(encoding="utf-8")
    assert "<script" not in text
    assert hostile in Page(text).by_id("reproduce").text


def test_the_end_of_a_log_is_drawn_beside_its_begin_and_another_log_alone(found, halves):
    model = found[1]
    runs = [model.predict(part) for part in halves]
    assert [colour for _, colour in ArmFigures(model, model, *runs).shown] == ["fit", "forecast"]
    assert [colour for _, colour in ArmFigures(model, model, runs[0], runs[0]).shown] == ["forecast"]
    assert [colour for _, colour in ArmFigures(model, model, runs[0], ()).shown] == ["fit"]


def test_shares_from_the_log_fall_with_its_errors(found):
    model = found[1]
    parts = (model.tree, model.base, model.coefficients)
    shares = [
        ArmFigures(
            arms.ArmModel(*parts, k * model.covariance, model.reference, model.facts), model, (), ()
        ).from_log
        for k in (1.0, 1e4, 1e8)
    ]
    assert all(((share >= 0.0) & (share <= 1.0)).all() for share in shares)
    assert (np.diff([share.sum() for share in shares]) < -0.5).all()
    assert shares[0][2, 1] > 0.999  # mx of the last link is a base parameter
    assert shares[0][0, 0] < 1e-6  # the first joint is vertical: no torque depends on the mass of its link


def test_predictions_do_not_depend_on_the_memory_that_they_use(found, halves, monkeypatch):
    model = found[1]
    (whole,) = model.predict(halves[1])
    monkeypatch.setattr("leastaction.arms.model._CHUNK", 17)
    (parts,) = model.predict(halves[1])
    np.testing.assert_allclose(parts.predicted, whole.predicted, rtol=1e-10, atol=1e-12)
    single = model.torques(whole.q, whole.qdot, whole.qddot)
    np.testing.assert_allclose(
        single,
        np.tensordot(model.coefficients, model.columns(whole.q, whole.qdot, whole.qddot), 1).T,
        rtol=1e-10,
        atol=1e-12,
    )


def test_the_density_of_noise_is_its_variance_over_the_band(rng):
    t = np.arange(0.0, 60.0, 0.004)
    f, amplitude = density(t, rng.normal(0.0, 3.0, t.size))
    assert f[-1] < 125.0
    np.testing.assert_allclose(np.median(amplitude[f > 5.0]) ** 2 * 125.0, 9.0, rtol=0.1)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (0.0, -9.81, 0.0), (3.0, 2.0, -5.0), (0.0, 0.0, 0.0)])
def test_the_drawing_has_gravity_downwards_and_one_scale(gravity):
    for _, along, up in sides(np.array(gravity)):
        assert abs(along @ up) < 1e-12
        assert np.linalg.norm(along) == pytest.approx(1.0)
        assert np.array(gravity) @ up == pytest.approx(-np.linalg.norm(gravity))
    axes = Axes((520.0, 300.0))
    axes.line(np.array([0.0, 0.1]), np.array([-2.0, 1.0]), "fit")
    axes.same_scale()
    frame = axes.frame()
    across, down = np.diff(frame.x(np.array([0.0, 1.0]))), np.diff(frame.y(np.array([0.0, 1.0])))
    assert across[0] == pytest.approx(-down[0], rel=1e-6)


def test_the_report_refuses_other_objects_in_one_line(found, halves, tmp_path):
    for model, command, words in [(halves[0], None, "expected an ArmModel"), (found[1], 3, "expected text")]:
        with pytest.raises(la.InputError, match=words):
            la.write_arm_report(model, tmp_path / "arm.html", halves[0], command=command)
    assert list(tmp_path.iterdir()) == []


# ------------------------ exciting motions: gradients, limits, and what they are worth for an identification
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


# -------------------- collisions: distances between shapes, by geometry; and motions that keep links apart
@pytest.fixture
def folded(file):
    """The tree, and its collisions with a clearance of 2 cm."""
    pytest.importorskip("pinocchio")
    path = file(folding(), "arm.urdf")
    tree = la.Library.from_urdf(path)
    return tree, experiment.Collisions.of_urdf(path, tree, clearance=0.02)


def test_distances_of_spheres_are_those_of_their_centres(folded, rng):
    tree, collisions = folded
    assert collisions.pairs == (("base_0", "l1_0"), ("base_0", "l2_0"), ("l0_0", "l2_0"))
    q = rng.uniform(-3.0, 3.0, (50, 3))
    ends = [p + 0.3 * r[:, :, 0] for p, r in zip(*poses(tree, q), strict=True)]
    expected = [np.linalg.norm(b - a, axis=1) - 0.1 for a, b in ((0.0, ends[1]), (0.0, ends[2]), ends[::2])]
    np.testing.assert_allclose(collisions.distances(q), expected, atol=1e-6)


def poses(tree: arms.KinematicTree, q: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    at = Motion.at(tree, q, 0.0 * q, 0.0 * q)
    return at.origins, at.rotations


def test_slopes_of_distances_are_finite_differences(folded, rng):
    _, collisions = folded
    q, step = rng.uniform(-3.0, 3.0, (200, 3)), 1e-6
    lacking, slopes = collisions.excess(q, 0.1)
    near = lacking > 1e-3
    assert near.sum() > 20
    for j, way in enumerate(step * np.eye(3)):
        ends = [collisions.excess(q + sign * way, 0.1)[0] for sign in (1.0, -1.0)]
        np.testing.assert_allclose(slopes[:, j][near], (ends[0] - ends[1])[near] / (2.0 * step), atol=1e-4)


@pytest.mark.thorough
def test_a_planned_motion_keeps_links_apart(folded):
    tree, collisions = folded
    limits = Limits(angle=[[-1.0, 0.0, 0.0], [1.0, 3.0, 3.0]], speed=6.0, acceleration=50.0)
    safe = replace(limits, collisions=collisions)
    free, kept = (experiment.excite(tree, each, 4.0) for each in (limits, safe))
    assert collisions.distances(free.q).min() < 0.0
    assert collisions.distances(kept.q).min() > 0.019
    assert kept.log_volume[1] < kept.log_volume[0] - 5.0


def test_the_gradient_of_a_plan_with_collisions_is_a_finite_difference(folded, rng):
    tree, collisions = folded
    plan = plan_of(tree, Limits.of_tree(tree, collisions=collisions))
    x = rng.normal(0.0, 1.0, (3, plan.series.size))
    x[:, 0] = 0.0, 2.0, 2.0
    _, gradient = plan._value(x, 30.0)
    assert collisions.excess(plan.series.states(x, plan.times)[0], 0.0)[0].any()
    for _ in range(3):
        way = rng.normal(size=x.shape)
        ends = [plan._value(x + step * way, 30.0)[0] for step in (1e-5, -1e-5)]
        assert gradient @ way.ravel() == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3)


def test_without_pinocchio_the_extra_is_named(file, monkeypatch):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    path = file(folding(), "arm.urdf")
    with pytest.raises(la.InputError, match=r"leastaction\[robots\]"):
        experiment.Collisions.of_urdf(path, la.Library.from_urdf(path))


def test_a_mesh_counts_as_its_convex_hull(file, tmp_path):
    """A tetrahedron with the corner of a cube cut off."""
    pytest.importorskip("pinocchio")
    corners = 0.05 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join("vertex {:g} {:g} {:g}\n".format(*corners[k]) for k in face)
        + "endloop\nendfacet\n"
        for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    )
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "end.stl").write_text(f"solid end\n{facets}endsolid end\n")
    path = file(folding('<mesh filename="package://shapes/end.stl"/>'), "arm.urdf")
    tree = la.Library.from_urdf(path)
    collisions = experiment.Collisions.of_urdf(path, tree, packages=[tmp_path])
    straight = collisions.distances(np.zeros((1, 3)))
    np.testing.assert_allclose(straight[:, 0], [0.55, 0.85, 0.55], atol=1e-6)
    with pytest.raises(la.InputError, match="packages="):
        experiment.Collisions.of_urdf(path, tree)


@pytest.mark.parametrize(
    ("text", "clearance", "words"),
    [
        (folding(), -0.01, "zero or more"),
        (folding().replace("q2", "other"), 0.01, "no joint q2"),
        (folding(axis="0 1 0").replace("0 1 0", "0 0 1", 1), 0.01, "another arm"),
        (re.sub("<collision>.*?</collision>", "", folding()), 0.01, "no collision shapes"),
        ("<robot", 0.01, "cannot read"),
    ],
)
def test_shapes_that_cannot_be_used_are_refused_in_one_line(file, text, clearance, words):
    pytest.importorskip("pinocchio")
    tree = la.Library.from_urdf(file(folding(), "arm.urdf"))
    with pytest.raises(la.InputError) as caught:
        experiment.Collisions.of_urdf(file(text, "other.urdf"), tree, clearance=clearance)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


# ------- payloads: known bodies are found within their errors, wherever they hang and however they are given
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


def test_a_load_that_is_not_in_the_tree_is_reported(rng):
    """Masses of the tree are off by up to 30 %: a load of 2 kg is reported, and nothing without a load."""
    for _ in range(6):
        true = bodies(7, rng)
        tree = SEVEN.with_inertias(true * rng.uniform(0.7, 1.3, (7, 1)))
        heavy = true.copy()
        heavy[-1] += parameters(2.0)
        for inertias, count in ((true, 0), (heavy, 1)):
            model = exact(SEVEN, inertias)
            notes = load_notes(tree, model.base, model.coefficients, model.covariance)
            assert len(notes) == count
        assert "kg heavier than the tree states" in notes[0]
        assert "\n" not in notes[0]


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
