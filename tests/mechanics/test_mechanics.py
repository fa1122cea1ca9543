"""Mechanics: the Euler–Lagrange operator and kinematic trees, by SymPy, energy and finite differences."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest
import sympy as sp
from sympy.calculus.euler import euler_equations

import leastaction as la
from helpers import euler_lagrange, finite_difference, terms
from leastaction.errors import InputError
from leastaction.library import Library
from leastaction.library.tree import INERTIAL, KinematicTree
from leastaction.mechanics.arm_columns import ArmColumns, dry_history, presliding, remembered
from leastaction.mechanics.arm_terms import (
    FRICTION,
    JointScales,
    inertial_terms,
    joint_terms,
    parameter_terms,
)
from leastaction.mechanics.equations import Mechanics
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points
from leastaction.mechanics.euler_lagrange import euler_lagrange as la_euler_lagrange
from leastaction.mechanics.rigid_bodies import Motion, inverse_dynamics, mass_matrix

ONE = ["x"]
TWO = ["theta1", "theta2"]
THREE = ["r", "theta", "phi"]

LAGRANGIAN = {
    "x": [
        "x_dot**2",
        "x**2",
        "x",
        "x_dot",
        "x*x_dot",
        "cos(x)",
        "x_dot**4",
        "x_dot**3*x",
        "exp(-x)*x_dot**2",
        "log(2+x**2)",
        "sqrt(1+x_dot**2)",
        "1/(1+x**2)",
        "tan(x/3)*x_dot**2",
        "x**5",
        "3/2*sin(2*x)**2",
        "x_dot**2/x",
    ],
    "theta1 theta2": [
        "theta1_dot**2",
        "theta1_dot*theta2_dot",
        "theta1_dot*theta2_dot*cos(theta1-theta2)",
        "theta1_dot*theta2_dot*sin(theta1-theta2)",
        "theta1_dot**2*cos(theta2)**2",
        "cos(theta1+2*theta2)",
        "theta1*theta2_dot",
        "theta2*theta1_dot-theta1*theta2_dot",
        "theta1**2*theta2**2*theta1_dot**2",
        "1/sqrt((1-theta1)**2+theta2**2+9/100)",
        "exp(theta1*theta2)",
    ],
    "r theta phi": [
        "r_dot**2",
        "r**2*theta_dot**2",
        "r**2*sin(theta)**2*phi_dot**2",
        "r*cos(theta)",
        "r_dot*theta_dot*phi_dot",
        "sin(theta)*phi_dot**2*r_dot",
        "r*theta*phi",
        "1/r",
    ],
}
CASES = [(coordinates.split(), text) for coordinates, texts in LAGRANGIAN.items() for text in texts]
DISSIPATION = [
    (ONE, "x_dot**2/2"),
    (ONE, "x**2*x_dot**2"),
    (ONE, "x_dot**4"),
    (ONE, "sqrt(x_dot**2+1/10000)"),
    (ONE, "abs(x_dot)"),
    (ONE, "abs(x_dot)**3"),
    (TWO, "(theta1_dot-theta2_dot)**2/2"),
    (TWO, "theta1_dot*theta2_dot"),
    (THREE, "sin(theta)**2*phi_dot**2"),
]


def states(n_dof: int, n_points: int = 9, seed: int = 0) -> list[np.ndarray]:
    """q > 0 keeps powers and logarithms defined; q̇ and q̈ have both signs."""
    rng = np.random.default_rng([seed, n_dof])
    q = rng.uniform(0.3, 1.4, (n_points, n_dof))
    return [q, rng.uniform(-2.0, 2.0, (n_points, n_dof)), rng.uniform(-3.0, 3.0, (n_points, n_dof))]


def on_paths(coordinates, text):
    """The expression on unknown functions of time, and the replacement that turns a jet into symbols."""
    t = sp.Symbol("t")
    paths = [sp.Function(c)(t) for c in coordinates]
    names = {c: sp.Symbol(c, real=True) for c in coordinates}
    names |= {f"{c}_dot": sp.Symbol(f"{c}_dot", real=True) for c in coordinates}
    expr = sp.sympify(text, locals=names)
    swap = {names[c]: path for c, path in zip(coordinates, paths, strict=True)}
    swap |= {names[f"{c}_dot"]: path.diff(t) for c, path in zip(coordinates, paths, strict=True)}
    symbols = [sp.Symbol(f"s{nu}_{i}", real=True) for nu in range(3) for i in range(len(coordinates))]
    jet = [path.diff(t, nu) if nu else path for nu in (2, 1, 0) for path in paths]
    back = dict(
        zip(jet, [symbols[nu * len(paths) + i] for nu in (2, 1, 0) for i in range(len(paths))], strict=True)
    )
    return expr.xreplace(swap), paths, t, symbols, back


def to_symbols(expr, back):
    for derivative, symbol in back.items():  # highest derivatives first
        expr = expr.subs(derivative, symbol)
    return expr


@pytest.mark.parametrize(("coordinates", "text"), CASES)
def test_operator_agrees_with_sympy(coordinates, text):
    lagrangian, paths, t, symbols, back = on_paths(coordinates, text)
    # SymPy leaves out equations such as 0 = 0: a kinetic energy of its own keeps all of them there
    anchor = sum(sp.Rational(7, 10) * path.diff(t) ** 2 for path in paths)
    equations = euler_equations(lagrangian + anchor, paths, t)
    sides = [-to_symbols(e.lhs.doit(), back) for e in equations]
    q, qdot, qddot = states(len(coordinates))
    arguments = [block[:, i] for block in (q, qdot, qddot) for i in range(len(coordinates))]
    expected = [np.broadcast_to(sp.lambdify(symbols, side)(*arguments), len(q)) for side in sides]
    found = euler_lagrange([text], coordinates).strong(Points(q, qdot, qddot))[0]
    scale = max(np.abs(expected).max(), 1.0)
    np.testing.assert_allclose(found + 1.4 * qddot.T, expected, rtol=1e-10, atol=1e-12 * scale)


@pytest.mark.parametrize(("coordinates", "text"), DISSIPATION)
def test_dissipation_column_is_the_gradient_in_the_rates(coordinates, text):
    columns = euler_lagrange([], coordinates, [text])
    q, qdot, qddot = states(len(coordinates))
    names = [*coordinates, *(f"{c}_dot" for c in coordinates)]
    function = sp.lambdify([sp.Symbol(n, real=True) for n in names], on_symbols(text, names))

    def potential(rates):
        return function(*q.T, *rates.reshape(qdot.shape).T)

    steps = finite_difference(potential, qdot.ravel(), 1e-4).reshape(len(q), len(q), -1)
    expected = np.stack([steps[k, k] for k in range(len(q))])
    np.testing.assert_allclose(columns.strong(Points(q, qdot, qddot))[0].T, expected, rtol=1e-7, atol=1e-7)
    # the weak form carries the force with the other sign: ∫ (χ̇ p + χ (∂L/∂q − ∂ψ/∂q̇)) dt = 0
    weak = columns.weak(Points(q, qdot))
    np.testing.assert_array_equal(weak[0], 0.0)
    np.testing.assert_allclose(weak[1, 0].T, -expected, rtol=1e-7, atol=1e-7)
    assert not columns.mass_matrix(Points(q, qdot), np.ones(1)).any()


def on_symbols(text, names):
    return sp.sympify(text, locals={n: sp.Symbol(n, real=True) for n in names})


def everything_on(space):
    """Coordinates and all columns of one of the three configuration spaces."""
    names = space.split()
    friction = [text for c, text in DISSIPATION if c == names]
    return names, euler_lagrange(LAGRANGIAN[space], names, friction)


@pytest.mark.parametrize("space", LAGRANGIAN)
def test_jacobian_against_finite_differences(space):
    coordinates, columns = everything_on(space)
    n = len(coordinates)
    blocks = states(n, 4)
    coefficients = np.random.default_rng(1).standard_normal(len(columns))
    jacobian = columns.jacobian(Points(*blocks), coefficients)
    for k in range(len(blocks[0])):
        here = np.concatenate([b[k] for b in blocks])

        def residual(state):
            return np.tensordot(coefficients, columns.strong(Points(*state.reshape(3, 1, n))), 1)[:, 0]

        expected = finite_difference(residual, here, 1e-4)
        found = np.zeros((n, 3 * n))
        for (nu, i, j), value in jacobian.items():
            found[i, nu * n + j] = np.broadcast_to(value, len(blocks[0]))[k]
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("space", LAGRANGIAN)
def test_taylor_remainder_falls_with_the_square(space):
    coordinates, columns = everything_on(space)
    n = len(coordinates)
    blocks = states(n, 6)
    rng = np.random.default_rng(2)
    step = [rng.standard_normal(b.shape) for b in blocks]
    coefficients = rng.standard_normal(len(columns))

    def residual(h):
        moved = [b + h * s for b, s in zip(blocks, step, strict=True)]
        return np.tensordot(coefficients, columns.strong(Points(*moved)), 1)

    slope = np.zeros((n, len(blocks[0])))
    for (nu, i, j), value in columns.jacobian(Points(*blocks), coefficients).items():
        slope[i] += value * step[nu][:, j]
    remainders = [np.abs(residual(h) - residual(0.0) - h * slope).max() for h in (1e-3, 1e-4)]
    assert 1.9 < np.log10(remainders[0] / remainders[1]) < 2.1


@pytest.mark.parametrize("space", LAGRANGIAN)
def test_mass_matrix_is_what_multiplies_the_accelerations(space):
    coordinates, columns = everything_on(space)
    q, qdot, qddot = states(len(coordinates))
    coefficients = np.random.default_rng(3).standard_normal(len(columns))
    mass = columns.mass_matrix(Points(q, qdot), coefficients)
    np.testing.assert_allclose(mass, mass.transpose(0, 2, 1), rtol=1e-12, atol=1e-12)
    with_, without = (
        np.tensordot(coefficients, columns.strong(Points(q, qdot, a)), 1)
        for a in (qddot, np.zeros_like(qddot))
    )
    np.testing.assert_allclose(np.einsum("pij,pj->ip", mass, qddot), with_ - without, rtol=1e-9, atol=1e-9)
    each = np.stack([columns.mass_of(k, Points(q, qdot)) for k in range(len(columns))])
    np.testing.assert_allclose(np.tensordot(coefficients, each, 1), mass, rtol=1e-12, atol=1e-12)
    moving, some = columns.masses(Points(q, qdot))
    assert moving == [k for k in range(len(columns)) if each[k].any()]
    np.testing.assert_array_equal(some, each[moving].transpose(1, 0, 2, 3))


@pytest.mark.parametrize("space", LAGRANGIAN)
def test_strong_form_is_the_time_derivative_of_the_weak_one(space):
    """dp/dt − F along a smooth path, p and F from the weak form."""
    coordinates, columns = everything_on(space)
    n = len(coordinates)
    t0 = np.linspace(0.0, 1.0, 7)
    phase = np.arange(n)

    def path(t):
        angle = 1.3 * t[:, None] + phase
        return [1.2 + 0.4 * np.sin(angle), 0.52 * np.cos(angle), -0.676 * np.sin(angle)]

    h = 1e-4
    rate = np.zeros((len(columns), n, t0.size))
    for weight, shift in ((8.0, h), (-8.0, -h), (-1.0, 2 * h), (1.0, -2 * h)):
        q, qdot, _ = path(t0 + shift)
        rate += weight / (12.0 * h) * columns.weak(Points(q, qdot))[0]
    q, qdot, qddot = path(t0)
    expected = rate - columns.weak(Points(q, qdot))[1]
    found = columns.strong(Points(q, qdot, qddot))
    # |u| is meant to lose its kink: as a dissipation function it has none in E
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("coordinates", "gauge"),
    [
        (ONE, "x"),
        (ONE, "sin(x)*exp(x)"),
        (ONE, "log(1+x**2)"),
        (TWO, "theta1*theta2"),
        (TWO, "sin(theta1-theta2)*theta1**2"),
        (TWO, "1/sqrt((1-theta1)**2+theta2**2+9/100)"),
        (THREE, "r**2*sin(theta)*cos(phi)"),
    ],
)
def test_total_time_derivatives_have_no_effect(coordinates, gauge):
    names = [*coordinates, *(f"{c}_dot" for c in coordinates)]
    expr = on_symbols(gauge, names)
    rates = [sp.Symbol(f"{c}_dot", real=True) for c in coordinates]
    total = sum(expr.diff(sp.Symbol(c, real=True)) * v for c, v in zip(coordinates, rates, strict=True))
    columns = euler_lagrange([str(total)], coordinates)
    points = Points(*states(len(coordinates)))
    np.testing.assert_allclose(columns.strong(points), 0.0, rtol=0, atol=1e-12)
    for value in columns.jacobian(points, np.ones(1)).values():
        np.testing.assert_allclose(value, 0.0, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(columns.mass_matrix(points, np.ones(1)), 0.0)


def test_constants_have_no_effect():
    columns = euler_lagrange(["7", "x_dot**2"], ONE)
    points = Points(*states(1))
    np.testing.assert_array_equal(columns.strong(points)[0], 0.0)
    np.testing.assert_array_equal(columns.weak(Points(*states(1)[:2]))[:, 0], 0.0)
    assert not columns.subset([0]).jacobian(points, np.ones(1))


def test_absolute_values_lose_their_kink():
    """Derivatives of |u| are taken on either side of the kink: no delta function, no NaN at u = 0."""
    columns = euler_lagrange(["abs(x)", "abs(x_dot)", "x*abs(x)", "abs(x)*x_dot**2"], ONE, ["abs(x_dot)"])
    x = np.array([[-1.5], [0.0], [2.0]])
    v = np.array([[1.0], [0.0], [-2.0]])
    a = np.array([[0.5], [1.0], [3.0]])
    strong = columns.strong(Points(x, v, a))[:, 0]
    assert np.isfinite(strong).all()
    x, v, a = x[:, 0], v[:, 0], a[:, 0]
    np.testing.assert_allclose(strong[0], -np.sign(x))
    np.testing.assert_allclose(strong[1], 0.0)
    np.testing.assert_allclose(strong[2], -2.0 * np.abs(x))
    np.testing.assert_allclose(strong[3], 2.0 * np.abs(x) * a + np.sign(x) * v**2)
    np.testing.assert_allclose(strong[4], np.sign(v))
    for value in columns.jacobian(Points(*(u[:, None] for u in (x, v, a))), np.ones(5)).values():
        assert np.isfinite(value).all()


def test_undefined_candidates_give_nan_without_noise():
    columns = euler_lagrange(["log(x)*x_dot**2", "sqrt(x)", "x_dot**2"], ONE)
    q = np.array([[-1.0], [1.0]])
    strong = columns.strong(Points(q, np.ones((2, 1)), np.ones((2, 1))))
    assert np.isnan(strong[0, 0, 0])
    assert np.isnan(strong[1, 0, 0])
    assert np.isfinite(strong[:, 0, 1]).all()
    assert np.isfinite(strong[2]).all()


def test_subsets_follow_the_given_sequence():
    columns = euler_lagrange(LAGRANGIAN["theta1 theta2"], TWO, ["theta1_dot*theta2_dot"])
    points = Points(*states(2))
    everything = columns.strong(points)
    order = [11, 3, 0, 7]
    np.testing.assert_array_equal(columns.subset(order).strong(points), everything[order])
    np.testing.assert_array_equal(columns.strong(points, order), everything[order])
    assert [t.text for t in columns.subset(order).terms] == [columns.terms[k].text for k in order]


def test_columns_do_not_depend_on_the_name_or_place_of_a_coordinate():
    text = "{a}_dot*{b}_dot*cos({a}-{b})+{a}**2*{b}_dot**2"
    q, qdot, qddot = states(2)
    plain = euler_lagrange([text.format(a="a", b="b")], ["a", "b"]).strong(Points(q, qdot, qddot))
    swapped = euler_lagrange([text.format(a="y", b="x")], ["x", "y"])
    turned = swapped.strong(Points(q[:, ::-1], qdot[:, ::-1], qddot[:, ::-1]))
    np.testing.assert_allclose(turned[:, ::-1], plain, rtol=1e-12, atol=1e-12)


# ------------------------------------------------------------------------------------ the time in terms
TIMED = [
    "x*cos(3*t)",
    "x_dot**2*exp(-t/2)",
    "x*x_dot*sin(2*t)",
    "x_dot**2*x*t",
    "x_dot**3*cos(x-t)",
    "cos(x)*cos({w}*t)",
    "sqrt(1+t**2*x_dot**2)",
]


@pytest.mark.parametrize("text", TIMED)
def test_operator_with_time_is_the_gradient_of_the_action(text):
    """d/dε ∫ L(x + ε η, ẋ + ε η̇, t) dt = −∫ E η dt for every η that vanishes at the ends."""
    (term,) = terms([text], ONE)
    term = term.at({"w": 2.7})
    nodes, weights = np.polynomial.legendre.leggauss(60)
    t, weights = 0.4 + 1.5 * (nodes + 1.0), 1.5 * weights
    x, rate, turn = np.sin(1.3 * t) + 2.0, 1.3 * np.cos(1.3 * t), -1.69 * np.sin(1.3 * t)
    bump = (t - 0.4) ** 2 * (3.4 - t) ** 2 * np.cos(t)
    slope = (2 * (t - 0.4) * (3.4 - t) ** 2 - 2 * (t - 0.4) ** 2 * (3.4 - t)) * np.cos(t)
    slope -= (t - 0.4) ** 2 * (3.4 - t) ** 2 * np.sin(t)
    lagrangian = sp.lambdify([sp.Symbol(n, real=True) for n in ("x", "x_dot", "t")], term.expr)

    def action(step):
        return np.array([weights @ lagrangian(x + e * bump, rate + e * slope, t) for e in step])

    expected = float(finite_difference(action, np.zeros(1), 1e-3)[0, 0])
    columns = EulerLagrange([term], ONE)
    points = Points(x[:, None], rate[:, None], turn[:, None], t)
    assert -weights @ (columns.strong(points)[0, 0] * bump) == pytest.approx(expected, rel=1e-8)
    momentum, push = columns.weak(points)[:, 0, 0]
    assert weights @ (momentum * slope + push * bump) == pytest.approx(expected, rel=1e-8)


def test_derivatives_and_masses_with_time_are_those_of_the_operator():
    columns, coefficients = euler_lagrange([t for t in TIMED if "{" not in t], ONE), np.arange(1.0, 7.0)
    q, qdot, qddot = states(1)
    t = np.linspace(0.3, 2.0, len(q))

    def error(flat):
        parts = flat.reshape(3, -1, 1)
        return coefficients @ columns.strong(Points(*parts, times=t))[:, 0]

    flat = np.concatenate([q, qdot, qddot]).ravel()
    slopes = finite_difference(error, flat, 1e-4).reshape(len(q), 3, len(q))
    points = Points(q, qdot, qddot, t)
    found = columns.jacobian(points, coefficients)
    for nu in range(3):
        np.testing.assert_allclose(found[nu, 0, 0], np.diag(slopes[:, nu]), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(columns.mass_matrix(points, coefficients)[:, 0, 0], found[2, 0, 0])


def test_times_are_asked_for_where_a_candidate_holds_the_time():
    library = Library(["x_dot**2", "x*cos(2*t)"], "x")
    one = np.ones((3, 1))
    with pytest.raises(InputError, match=r"the candidate x\*cos\(2\*t\) depends on time; give t"):
        la_euler_lagrange(library, one, one, one)
    with pytest.raises(InputError, match=r"t has the shape \(2,\); expected \(3,\)"):
        la_euler_lagrange(library, one, one, one, t=[0.0, 1.0])
    found = la_euler_lagrange(library, one, one, one, t=[0.0, 1.0, 2.0])
    np.testing.assert_allclose(found[:, 0, 1], -np.cos([0.0, 2.0, 4.0]))
    with pytest.raises(ValueError, match="these points have none"):
        euler_lagrange(["x*cos(2*t)"], ONE).strong(Points(one, one, one))


# ----------------------------------------------------------------------------- columns with shape parameters
PLANE = ["x", "y"]
TEMPLATES = [
    ("exp(-{a}*x)", "lagrangian"),
    ("x**{a}*y", "lagrangian"),
    ("x_dot**2*cos({a}*x-{b})", "lagrangian"),
    ("x_dot*y_dot/(x+{a}**2)", "lagrangian"),
    ("1/sqrt((x-{b})**2+(y-{a})**2)", "lagrangian"),
    ("y_dot*exp(-(x-{a})**2)", "lagrangian"),
    ("exp({b}*y)*x_dot**2/2", "dissipation"),
    ("sqrt(x_dot**2+{a}**2)", "dissipation"),
]
NUMBERS = [{"a": 0.7, "b": 1.3}, {"a": -1.1, "b": 0.25}, {"a": 2.0, "b": -3.0}]


def points(rng: np.random.Generator) -> Points:
    """Positive coordinates: powers are defined."""
    return Points(rng.uniform(0.3, 1.4, (9, 2)), rng.uniform(-2, 2, (9, 2)), rng.uniform(-3, 3, (9, 2)))


def assert_close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("at", NUMBERS, ids=str)
@pytest.mark.parametrize(("text", "kind"), TEMPLATES)
def test_numbers_in_place_are_numbers_typed(text, kind, at, rng):
    (template,) = terms([text], PLANE, kind)
    put = template.at(at)
    numbered, plain = EulerLagrange([put], PLANE), EulerLagrange(terms([put.text], PLANE, kind), PLANE)
    assert plain.terms[0].template is None
    here = points(rng)
    assert_close(numbered.weak(here), plain.weak(here))
    assert_close(numbered.strong(here), plain.strong(here))
    assert_close(numbered.mass_of(0, here), plain.mass_of(0, here))
    slopes, expected = (c.jacobian(here, np.array([1.7])) for c in (numbered, plain))
    for key in {*slopes, *expected}:
        assert_close(slopes.get(key, 0.0) + np.zeros(9), expected.get(key, 0.0) + np.zeros(9))


def test_several_numbers_at_the_same_points_do_not_mix(rng):
    """Points keep shared parts such as √(…); those of other numbers are other parts."""
    (template,) = terms(["exp(-{a}*x)"], PLANE)
    here = points(rng)
    both = [template.at({"a": a}) for a in (0.5, 2.0)]
    together = EulerLagrange(both, PLANE).strong(here)
    assert_close(together[:, 0], [a * np.exp(-a * here.columns[0]) for a in (0.5, 2.0)])


def test_numbered_columns_travel_between_processes(rng):
    (template,) = terms(["x_dot**2*exp(-{a}*x)"], PLANE)
    columns = EulerLagrange([template.at({"a": 0.5})], PLANE)
    here = points(rng)
    assert_close(pickle.loads(pickle.dumps(columns)).strong(here), columns.strong(here))


def test_numbers_given_apart_are_numbers_in_place(rng):
    plain, one, two = terms(["x*y", "exp(-{a}*x)", "x_dot**2*{a}*y*cos({b}*y)"], PLANE)
    numbers = [{}, {"a": 0.5}, {"b": 2.0, "a": -1.25}]
    apart = EulerLagrange([plain], PLANE).of([plain, one, two.at({"a": 7.0, "b": 1.0})], numbers)
    put = EulerLagrange([plain, one.at(numbers[1]), two.at(numbers[2])], PLANE)
    here = points(rng)
    for columns in (apart, pickle.loads(pickle.dumps(apart))):
        np.testing.assert_array_equal(columns.strong(here), put.strong(here))
        np.testing.assert_array_equal(columns.weak(here), put.weak(here))


def test_the_public_operator_needs_numbers():
    library = la.Library(["x_dot**2/2", "exp(-{a}*x)"], ["x"])
    with pytest.raises(la.InputError, match="shape parameter 'a' of the library has no value"):
        la.euler_lagrange(library, [[0.5]], [[1.0]], [[2.0]])
    found = la.euler_lagrange(library.at({"a": 2.0}), [[0.5]], [[1.0]], [[2.0]])
    assert_close(found, [[[2.0, 2.0 * np.exp(-1.0)]]])


def test_energy_changes_by_the_power_of_friction_and_forces(rng):
    """Along free motion energy falls by q̇·∂ψ/∂q̇, and it rises by q̇·f."""
    law = ["x_dot**2/2 + (x - y)**2/3", "(2 + cos(x))*y_dot**2", "x_dot*y_dot*sin(y)/4"]
    friction = Library(["x"], PLANE, dissipation=["abs(x_dot)", "x_dot*y_dot/3 + y_dot**2", "abs(y_dot)**3"])
    parts = sp.Add(*(term.expr for term in terms(law, PLANE)))
    mechanics = Mechanics(parts, sp.Add(*(term.expr for term in friction.dissipation)), PLANE)
    q, qdot, forces = rng.standard_normal((3, 20, 2))
    qddot, step = mechanics.acceleration(q, qdot, forces), 1e-6
    states = ((q + s * (qdot + 0.5 * s * qddot), qdot + s * qddot) for s in (-step, step))
    before, after = (mechanics.energy(*state) for state in states)
    power = np.sum(qdot * forces, axis=1) - mechanics.friction_power(q, qdot)
    np.testing.assert_allclose((after - before) / (2.0 * step), power, rtol=1e-6, atol=1e-7)


def test_expressions_of_the_coordinates_are_evaluated(rng):
    x, y_dot = sp.Symbol("x", real=True), sp.Symbol("y_dot", real=True)
    mechanics = Mechanics(y_dot**2, sp.Integer(0), PLANE)
    q, qdot = rng.standard_normal((2, 5, 2))
    found = mechanics.evaluate([x * abs(y_dot), sp.Integer(3)], q, qdot)
    assert_close(found, [q[:, 0] * np.abs(qdot[:, 1]), np.full(5, 3.0)])


# -------- kinematic trees: geometry, columns and derivatives, against symbols, energy and finite differences
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

COUPLED = BRANCHED.with_terms(
    ["q1_dot*q2_dot*cos(q1)/9", "cos(2*q2)", "sqrt(2-cos(q4-q5))"],
    dissipation=["(q1_dot+q4_dot)**2/2", "sqrt((q1_dot-q5_dot)**2+0.1)"],
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


def motion(tree: KinematicTree, rng: np.random.Generator, n_points: int = 30) -> list[np.ndarray]:
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
    [(PLANAR, 1), pytest.param(SPATIAL, 4, marks=pytest.mark.thorough), (GANTRY, 1), (MJCF, 1)],
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
    q, qdot, qddot = motion(tree, rng)
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
    terms = parameter_terms(tree, ("rotor", "spring", "offset", "turn", *FRICTION), scales)
    columns = ArmColumns(tree, terms)
    return columns, np.concatenate([bodies(n, rng).ravel(), rng.uniform(0.1, 1.0, len(terms) - 10 * n)])


@pytest.mark.parametrize("tree", [SPATIAL, BRANCHED, COUPLED], ids=["spatial", "branched", "coupled"])
def test_derivatives_are_finite_differences(tree, rng):
    columns, coefficients = columns_of(tree, rng)
    kept = [k for k, t in enumerate(columns.terms) if t.kind != "load"]
    columns, coefficients = columns.subset(kept), coefficients[kept]
    given, step = motion(tree, rng), 1e-6
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


@pytest.mark.parametrize("tree", [BRANCHED, COUPLED], ids=["branched", "coupled"])
def test_masses_and_accelerations_agree(tree, rng):
    columns, coefficients = columns_of(tree, rng)
    columns.reference = bodies(5, rng)
    points = Points(*motion(tree, rng))
    mass = columns.mass_matrix(points, coefficients)
    moving, each = columns.masses(points)
    np.testing.assert_allclose(np.tensordot(each, coefficients[moving], (1, 0)), mass, atol=1e-12)
    slopes = columns.jacobian(points, coefficients)
    for i in range(5):
        for j in range(5):
            np.testing.assert_allclose(slopes.get((2, i, j), 0.0 * mass[:, 0, 0]), mass[:, i, j], atol=1e-12)
    assert np.linalg.eigvalsh(mass).min() > 0.0
    np.testing.assert_array_equal(columns.strong(points, [3, 70]), columns.strong(points)[[3, 70]])


def test_expressions_of_a_tree_are_the_columns_of_a_library(rng):
    """Three bodies of mass zero: what is left is the law of the expressions."""
    points, extra = Points(*motion(COUPLED, rng)), COUPLED.extra
    terms = parameter_terms(COUPLED, (), JointScales(*np.zeros((3, 5))))
    plain = EulerLagrange(extra, COUPLED.coordinates)
    np.testing.assert_array_equal(ArmColumns(COUPLED, terms).strong(points)[50:], plain.strong(points))
    without = ArmColumns(COUPLED, terms, prescribed=(1,)).strong(points)[50:]
    assert not without[:, 1].any()
    np.testing.assert_array_equal(without[:, [0, 2, 3, 4]], plain.strong(points)[:, [0, 2, 3, 4]])


def test_a_renamed_tree_keeps_its_expressions():
    other = COUPLED.renamed(["a", "b", "c", "d", "q1"])
    assert [str(term) for term in other.extra] == [
        *("a_dot*b_dot*cos(a)/9", "cos(2*b)", "sqrt(2 - cos(d - q1))"),
        *("(a_dot + d_dot)**2/2", "sqrt((a_dot - q1_dot)**2 + 1/10)"),
    ]
    assert [term.kind for term in other.extra] == [term.kind for term in COUPLED.extra]


@pytest.mark.parametrize(
    ("terms", "dissipation", "words"),
    [
        (["q9_dot**2"], [], "unknown name"),
        (["t*q1"], [], "contains 't'"),
        (["exp({a}*q1)"], [], "shape parameter a"),
        (["log(q1)"], [], "not defined"),
        ([], ["cos(q1)"], "dissipation only velocities"),
        ([], ["q1_dot**2/2"], "friction of single joints"),
        ([], ["abs(q1_dot)+q2_dot**4"], "friction of single joints"),
        ([], ["(q1_dot+q2_dot)**2", "(q1_dot-q2_dot)**2"], "(q1_dot-q2_dot)**2 acts like"),
    ],
)
def test_expressions_that_a_tree_cannot_have_are_refused(terms, dissipation, words):
    with pytest.raises(InputError, match=re.escape(words)):
        SPATIAL.with_terms(terms, dissipation)


def test_both_conventions_of_denavit_and_hartenberg_describe_one_arm(rng):
    """A planar arm: modified rows hold the length of the link before, the others that of their own."""
    other = KinematicTree.from_dh([{}, {"a": 0.3}], modified=True, gravity=(0.0, -9.81, 0.0))
    given, parameters = motion(PLANAR, rng), bodies(2, rng)
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


def test_a_motion_that_is_cut_goes_on_with_the_friction_that_it_had(rng):
    way = np.cumsum(rng.normal(0.0, 0.02, 400))
    whole = presliding(way, 0.1)[0]
    for cut in (1, 57, 399):
        rest = way[cut:]
        again = presliding(rest, 0.1)[0] + whole[cut] * remembered(rest, 0.1)[0]
        np.testing.assert_allclose(again, whole[cut:], atol=1e-12)


def test_dry_friction_that_begins_at_speed_is_that_of_a_longer_motion():
    t = np.linspace(0.0, 3.0, 3001)[:, None]
    terms = joint_terms(
        KinematicTree.from_dh([{}], modified=True), ["dry"], JointScales(*np.full((3, 1), 0.05))
    )
    q, qdot = np.sin(2.0 * t), 2.0 * np.cos(2.0 * t)
    whole, part = (dry_history(terms, *(a[k:] for a in (q, qdot)))[0, :, 0, 0] for k in (0, 1400))
    np.testing.assert_allclose(part, whole[1400:], atol=1e-3)
    near = []
    for step in (1e-5, -1e-5):
        scales = JointScales(*np.full((2, 1), 0.05), np.full(1, 0.05 * np.exp(step)))
        near.append(
            dry_history(joint_terms(KinematicTree.from_dh([{}], modified=True), ["dry"], scales), q, qdot)
        )
    slope = dry_history(terms, q, qdot)[1]
    np.testing.assert_allclose(slope, (near[0][0] - near[1][0]) / 2e-5, atol=1e-7)
    still = dry_history(terms, 0.0 * q[:5], 0.0 * q[:5])
    assert not still.any()


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
        (lambda: KinematicTree.from_dh([], modified=True), "no movable joint"),
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
