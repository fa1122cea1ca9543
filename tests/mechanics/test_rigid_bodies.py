"""Kinematic trees: geometry, columns and derivatives, against symbols, energy and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

import leastaction as la
from leastaction.library.tree import INERTIAL, KinematicTree
from leastaction.mechanics import Points
from leastaction.mechanics.arm_columns import (
    FRICTION,
    ArmColumns,
    JointScales,
    inertial_terms,
    joint_terms,
    presliding,
)
from leastaction.mechanics.rigid_bodies import Motion, inverse_dynamics, mass_matrix

PLANAR = KinematicTree.from_dh([{"a": 0.3}, {"a": 0.2}], modified=False, gravity=(0.0, -9.81, 0.0))
SPATIAL = KinematicTree.from_dh(
    [{"d": 0.3}, {"alpha": -np.pi / 2, "a": 0.1}, {"a": 0.4, "alpha": np.pi / 2, "theta": np.pi}],
    modified=True,
)
GANTRY = KinematicTree.from_joints(
    [
        {"name": "x", "kind": "prismatic", "axis": (1.0, 0.0, 0.0)},
        {"name": "a", "axis": (0.0, 0.6, 0.8), "origin": (0.1, 0.0, 0.3), "rpy": (np.pi / 2, 0.0, 0.0)},
        {"name": "b", "axis": (0.0, 0.0, 1.0), "origin": (0.3, 0.1, 0.0), "parent": "x"},
    ],
    base_rpy=(0.2, -0.1, 0.4),
)
BRANCHED = KinematicTree.from_joints(
    [
        {"axis": (0, 0, 1)},
        {"axis": (0, 1, 0.2), "origin": (0.1, 0.0, 0.3)},
        {"axis": (1, 0, 0), "kind": "prismatic", "origin": (0.3, 0.1, 0.0)},
        {"axis": (0, 1, 0), "origin": (0.3, 0.1, 0.0), "parent": "q2"},
        {"axis": (1, 0, 1), "origin": (0.0, 0.1, 0.2), "rpy": (1.0, 0.0, -0.4)},
    ]
)


def bodies(n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 10) inertial parameters of ellipsoids."""
    out = []
    for _ in range(n):
        mass, centre, size = rng.uniform(0.5, 3.0), rng.normal(0.0, 0.1, 3), rng.uniform(0.05, 0.2, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        second = mass * (turn @ np.diag(size**2) @ turn.T + np.outer(centre, centre))
        inertia = np.trace(second) * np.eye(3) - second
        out.append([mass, *(mass * centre), *inertia[np.triu_indices(3)]])
    return np.array(out)


def states(tree: KinematicTree, rng: np.random.Generator, n_points: int = 30) -> list[np.ndarray]:
    return list(rng.normal(size=(3, n_points, len(tree))))


def symbolic_terms(tree: KinematicTree) -> list[sp.Expr]:
    """The Lagrangian's terms for the ten parameters of each link, by SymPy, from poses alone."""
    q = [sp.Symbol(n, real=True) for n in tree.coordinates]
    v = [sp.Symbol(f"{n}_dot", real=True) for n in tree.coordinates]

    def rate(expr):
        return sum((sp.diff(expr, x) * y for x, y in zip(q, v, strict=True)), sp.S.Zero)

    def exact(array):
        return sp.Matrix(np.round(array, 12).tolist()).applyfunc(sp.nsimplify)

    poses, out = [], []
    gravity = exact(tree.gravity)
    for i, joint in enumerate(tree.joints):
        rotation, origin = (sp.eye(3), sp.zeros(3, 1)) if joint.parent < 0 else poses[joint.parent]
        axis = exact(joint.axis)
        origin = origin + rotation * exact(joint.origin)
        rotation = rotation * exact(joint.rotation)
        if joint.kind == "prismatic":
            origin = origin + rotation * axis * q[i]
        else:
            cross = sp.Matrix([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
            rotation = rotation * (sp.eye(3) + sp.sin(q[i]) * cross + (1 - sp.cos(q[i])) * cross**2)
        poses.append((rotation, origin))
        moved, turned = origin.applyfunc(rate), rotation.applyfunc(rate)
        # a mass point at r in the link moves with moved + turned r; the inertia follows from Σ m r rᵀ
        second = turned.T * turned
        points = [moved.dot(moved) / 2 + gravity.dot(origin)]
        points += [moved.dot(turned[:, k]) + gravity.dot(rotation[:, k]) for k in range(3)]
        # S = (tr I / 2) 1 − I
        for a, b in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]:
            inertia = sp.zeros(3)
            inertia[a, b] = inertia[b, a] = 1
            spread = inertia.trace() / 2 * sp.eye(3) - inertia
            points.append((second * spread).trace() / 2)
        out += points
    return out


MJCF = """<mujoco><worldbody><body pos="0 0 0.5" euler="90 0 0">
  <joint name="a" pos="0.1 0 0" axis="0 0.6 0.8" ref="90"/><geom size="0.1"/>
  <body pos="0.3 0.1 0"><joint name="b" type="slide" axis="0 0 1" ref="0.2"/><geom size="0.1"/></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("tree", "stride"),
    [(PLANAR, 1), (SPATIAL, 4), (GANTRY, 1), (MJCF, 1)],
    ids=["planar", "spatial", "gantry", "mjcf"],
)
def test_columns_are_those_of_the_symbolic_lagrangian(tree, stride, rng, file):
    if isinstance(tree, str):
        tree = la.Library.from_mjcf(file(tree, "arm.xml"))
    # a term may not be longer than the parser allows; the operator is linear
    pieces = [sp.Add.make_args(sp.expand(e).evalf(17)) for e in symbolic_terms(tree)[::stride]]
    moving = [[p for p in some if p.free_symbols] for some in pieces]
    library = la.Library(sorted({str(p) for some in moving for p in some}), tree.coordinates)
    place = {term.text: k for k, term in enumerate(library)}
    q, qdot, qddot = states(tree, rng)
    each = la.euler_lagrange(library, q, qdot, qddot)
    lone = {str(p): la.Library([str(p)], tree.coordinates)[0].text for some in moving for p in some}
    symbolic = np.zeros((len(pieces), len(tree), len(q)))
    for k, some in enumerate(moving):
        for p in some:
            symbolic[k] += each[:, :, place[lone[str(p)]]].T
    numeric = ArmColumns(tree, inertial_terms(tree)[::stride]).strong(Points(q, qdot, qddot))
    np.testing.assert_allclose(numeric, symbolic, rtol=0, atol=1e-12)
    assert np.count_nonzero(abs(numeric).max(axis=(1, 2)) > 1e-9) >= 4


def columns_of(tree: KinematicTree, rng: np.random.Generator) -> tuple[ArmColumns, np.ndarray]:
    n = len(tree)
    scales = JointScales(np.full(n, 0.3), np.full(n, 0.8), np.zeros(n))
    terms = (
        *inertial_terms(tree),
        *joint_terms(tree, ("rotor", "spring", "offset", "turn", *FRICTION), scales),
    )
    columns = ArmColumns(tree, terms)
    return columns, np.concatenate([bodies(n, rng).ravel(), rng.uniform(0.1, 1.0, len(terms) - 10 * n)])


@pytest.mark.parametrize("tree", [SPATIAL, BRANCHED], ids=["spatial", "branched"])
def test_derivatives_are_finite_differences(tree, rng):
    columns, coefficients = columns_of(tree, rng)
    columns = columns.subset([k for k, t in enumerate(columns.terms) if t.kind != "load"])
    coefficients = coefficients[: len(columns)]
    given, step = states(tree, rng), 1e-6
    found = columns.jacobian(Points(*given), coefficients)
    for nu in range(3):
        for j in range(len(tree)):
            ends = []
            for sign in (1.0, -1.0):
                moved = [a.copy() for a in given]
                moved[nu][:, j] += sign * step
                ends.append(np.tensordot(coefficients, columns.strong(Points(*moved)), 1))
            slope = (ends[0] - ends[1]) / (2.0 * step)
            for i in range(len(tree)):
                np.testing.assert_allclose(found.get((nu, i, j), 0.0) + 0.0 * slope[i], slope[i], atol=2e-7)


@pytest.mark.parametrize("tree", [SPATIAL, GANTRY, BRANCHED], ids=["spatial", "gantry", "branched"])
def test_power_is_the_rate_of_energy(tree, rng):
    parameters, phases = bodies(len(tree), rng), rng.normal(size=len(tree))
    step = 1e-4

    def motion(t):
        arg = phases + t * (1.0 + phases / 3.0)
        rate = 1.0 + phases / 3.0
        return Motion.at(
            tree, np.sin(arg)[None], (rate * np.cos(arg))[None], (-(rate**2) * np.sin(arg))[None]
        )

    def energy(t):
        at = motion(t)
        kinetic = 0.5 * at.qdot[0] @ mass_matrix(at, parameters)[0] @ at.qdot[0]
        heights = [
            row[0] * p[0] + r[0] @ row[1:4]
            for r, p, row in zip(at.rotations, at.origins, parameters, strict=True)
        ]
        return kinetic - tree.gravity @ np.sum(heights, axis=0)

    at = motion(0.3)
    power = inverse_dynamics(at, parameters)[:, 0] @ at.qdot[0]
    assert power == pytest.approx((energy(0.3 + step) - energy(0.3 - step)) / (2.0 * step), rel=1e-6)


def test_masses_and_accelerations_agree(rng):
    columns, coefficients = columns_of(BRANCHED, rng)
    columns.reference = bodies(5, rng)
    points = Points(*states(BRANCHED, rng))
    mass = columns.mass_matrix(points, coefficients)
    moving, each = columns.masses(points)
    np.testing.assert_allclose(np.tensordot(each, coefficients[moving], (1, 0)), mass, atol=1e-12)
    slopes = columns.jacobian(points, coefficients)
    for i in range(5):
        for j in range(5):
            np.testing.assert_allclose(slopes.get((2, i, j), 0.0 * mass[:, 0, 0]), mass[:, i, j], atol=1e-12)
    assert np.linalg.eigvalsh(mass).min() > 0.0
    np.testing.assert_array_equal(columns.strong(points, [3, 70]), columns.strong(points)[[3, 70]])


def test_both_conventions_of_denavit_and_hartenberg_describe_one_arm(rng):
    """A planar arm: modified rows hold the length of the link before, the others that of their own."""
    other = KinematicTree.from_dh([{}, {"a": 0.3}], modified=True, gravity=(0.0, -9.81, 0.0))
    given, parameters = states(PLANAR, rng), bodies(2, rng)
    torques = [inverse_dynamics(Motion.at(tree, *given), parameters) for tree in (PLANAR, other)]
    np.testing.assert_allclose(*torques, atol=1e-12)


def test_a_tilted_base_turns_gravity(rng):
    upright = KinematicTree.from_joints([{"axis": (0, 0, 1)}])
    wall = KinematicTree.from_joints([{"axis": (0, 0, 1)}], base_rpy=(np.pi / 2, 0.0, 0.0))
    still = [np.array([[0.4]]), np.zeros((1, 1)), np.zeros((1, 1))]
    parameters = bodies(1, rng)
    assert abs(inverse_dynamics(Motion.at(upright, *still), parameters)[0, 0]) < 1e-12
    first = np.array([np.cos(0.4), -np.sin(0.4)]) @ parameters[0, 1:3]
    assert inverse_dynamics(Motion.at(wall, *still), parameters)[0, 0] == pytest.approx(9.81 * first)


def test_presliding_turns_over_its_distance():
    way = np.concatenate([np.linspace(0.0, 1.0, 101), np.linspace(1.0, 0.0, 101)[1:]])
    z, slope = presliding(way, 0.1)
    near = [presliding(way, 0.1 * np.exp(step))[0] for step in (1e-5, -1e-5)]
    np.testing.assert_allclose(slope, (near[0] - near[1]) / 2e-5, atol=1e-8)
    np.testing.assert_allclose(z[:101], 1.0 - np.exp(-way[:101] / 0.1), atol=1e-12)
    # after the reversal it starts from nearly one
    back = z[100] + 1.0
    np.testing.assert_allclose(z[100:], -1.0 + back * np.exp(-(1.0 - way[100:]) / 0.1), atol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: KinematicTree.from_dh([{"a": "long"}], modified=True), "a in row 1 of the table is 'long'"),
        (lambda: KinematicTree.from_dh([{"b": 1.0}], modified=True), "holds 'b'; expected a, alpha"),
        (lambda: KinematicTree.from_dh([], modified=True), "no joint that moves"),
        (lambda: KinematicTree.from_joints([{"axis": (0, 0, 0)}]), "has no length"),
        (lambda: KinematicTree.from_joints([{"kind": "ball"}]), "'revolute' or 'prismatic'"),
        (lambda: KinematicTree.from_joints([{"parent": "arm"}]), "the base"),
        (lambda: KinematicTree.from_joints([{}], gravity=(0, 9.81)), "three finite numbers"),
        (lambda: KinematicTree.from_joints([{"name": "a"}, {"name": "a"}]), "a"),
    ],
)
def test_bad_geometry_is_refused_in_one_line(make, words):
    with pytest.raises(la.InputError) as caught:
        make()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_links_without_inertia_are_unknown():
    assert np.isnan(SPATIAL.inertias).all()
    given = SPATIAL.with_inertias(np.ones((3, len(INERTIAL))))
    assert (given.inertias == 1.0).all()
