"""Equilibria, linear systems and modes, against formulas, motions, draws of coefficients and other scales."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

import leastaction as la
from helpers import MODELS, record
from leastaction import LagrangianModel, systems
from leastaction.errors import InputError
from leastaction.findings import find
from leastaction.model.linear import Linearisation
from leastaction.model.modes import Estimate
from leastaction.model.term import FitSummary, ModelTerm, ShapeParameter


def law(coordinates, terms, dissipation=(), covariance=None, **fields):
    """A model with the coefficients of `terms`; errors are those of the covariance."""
    both = [*dict(terms).items(), *dict(dissipation).items()]
    errors = np.zeros(len(both)) if covariance is None else np.sqrt(np.diag(covariance))[: len(both)]
    made = [ModelTerm(text, c, error) for (text, c), error in zip(both, errors.tolist(), strict=True)]
    n = len(dict(terms))
    return LagrangianModel(coordinates, made[:n], made[n:], covariance, **fields)


def true_law(name, **fields):
    system = systems.get(name)
    return law(system.coordinates, system.lagrangian, system.dissipation, **fields)


def spread(rng, values, relative=1e-4):
    """A covariance with correlations, small enough for the delta method."""
    mixed = rng.normal(size=(len(values), len(values))) * relative
    return np.outer(values, values) * (mixed @ mixed.T)


def errors_of(system: Linearisation):
    """Every number of the modes, and the standard error of each."""
    numbers, errors = [], []
    for mode in system.modes:
        for found in (mode.natural_frequency, mode.frequency, mode.damping_ratio):
            numbers.append(found.value)
            errors.append(found.standard_error)
        for part in (np.real, np.imag):
            numbers += part(mode.shape).tolist()
            errors += part(mode.shape_standard_error).tolist()
    return np.array(numbers), np.array(errors)


def drawn(rng, values, covariance, modes, number=4000):
    """Standard deviations of what `modes` makes of drawn coefficients."""
    draws = rng.multivariate_normal(values, covariance, number, method="eigh")
    return np.std([modes(draw) for draw in draws], axis=0)


def assert_errors(system, values, errors):
    found, estimated = errors_of(system)
    np.testing.assert_allclose(found, values, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(estimated, errors, rtol=0.07, atol=1e-9)


SPRINGS = {"x_dot**2": 0.5, "y_dot**2": 1.0, "x_dot*y_dot": 0.2, "x**2": -4.0, "(x-y)**2": -3.0}


def spring_modes(c):
    """By hand, without friction."""
    mass = np.array([[2 * c[0], c[2]], [c[2], 2 * c[1]]])
    stiffness = -2 * np.array([[c[3] + c[4], -c[4]], [-c[4], c[4]]])
    squares, shapes = eigh(stiffness, mass)
    out = []
    for square, shape in zip(squares, shapes.T, strict=True):
        shape = shape / shape[np.argmax(np.abs(shape))]
        out += [np.sqrt(square), np.sqrt(square) / (2 * np.pi), 0.0, *shape, 0.0, 0.0]
    return np.array(out)


def test_errors_of_springs_are_those_of_drawn_coefficients(rng):
    values = np.array([*SPRINGS.values()])
    covariance = spread(rng, values)
    system = law(["x", "y"], SPRINGS, covariance=covariance).linearise([0.0, 0.0])
    assert_errors(system, spring_modes(values), drawn(rng, values, covariance, spring_modes))
    assert system.stability == "stable"


# a spring that hangs, damped: the exponential moves the equilibrium, and so the stiffness
HANGING = {"x_dot**2": 0.5, "y_dot**2": 0.7, "exp({a}*x)": -1.0, "x": 2.0, "(x-y)**2": -3.0, "y*x_dot": 0.8}
DAMPED = {"x_dot**2/2": 0.3, "(x_dot-y_dot)**2/2": 0.2}


def hanging_modes(c):
    """By hand: exp(a x) pulls with −c₂ a exp(a x) = c₃, where x − y = 0."""
    a = c[8]
    mass = np.diag([2 * c[0], 2 * c[1]])
    pull = a * c[3]  # −∂²L/∂x² of the exponential, at the equilibrium
    stiffness = np.array([[pull - 2 * c[4], 2 * c[4]], [2 * c[4], -2 * c[4]]])
    friction = np.array([[c[6] + c[7], -c[7]], [-c[7], c[7]]])
    turning = c[5] * np.array([[0.0, 1.0], [-1.0, 0.0]])  # of y ẋ: d/dt y − 0 and −ẋ
    inverse = np.linalg.inv(mass)
    whole = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ (friction + turning)]])
    poles, vectors = np.linalg.eig(whole)
    out = []
    for k in sorted(np.flatnonzero(poles.imag > 0), key=lambda k: abs(poles[k])):
        shape = vectors[:2, k] / vectors[np.argmax(np.abs(vectors[:2, k])), k]
        out += [abs(poles[k]), abs(poles[k]) / (2 * np.pi), -poles[k].real / abs(poles[k])]
        out += [*shape.real, *shape.imag]
    return np.array(out)


def hanging(covariance):
    shapes = [ShapeParameter("a", 0.9, float(np.sqrt(covariance[-1, -1])))]
    model = law(
        ["x", "y"],
        {k.format(a=0.9): c for k, c in HANGING.items()},
        DAMPED,
        np.diag(np.diag(covariance)[:-1]),
    )
    first = replace(model.terms[2], template="exp({a}*x)")
    return replace(
        model, terms=(*model.terms[:2], first, *model.terms[3:]), covariance=covariance, shapes=shapes
    )


def test_errors_with_friction_rotation_and_a_shape_parameter_are_those_of_drawn_numbers(rng):
    values = np.array([*HANGING.values(), *DAMPED.values(), 0.9])
    covariance = spread(rng, values)
    model = hanging(covariance)
    (rest,) = model.equilibria(within={"x": (-3.0, 3.0), "y": (-3.0, 3.0)})
    x = np.log(2.0 / 0.9) / 0.9
    np.testing.assert_allclose(rest.q, [x, x], rtol=1e-10)
    assert (rest.stability, rest.isolated, rest.recorded) == ("stable", True, None)
    system = model.linearise(rest.q)
    assert_errors(system, hanging_modes(values), drawn(rng, values, covariance, hanging_modes))
    places = drawn(rng, values, covariance, lambda c: np.log(-c[3] / (c[8] * c[2])) / c[8])
    np.testing.assert_allclose(system.standard_error, [places, places], rtol=0.07)


def test_small_motions_are_those_of_the_modes():
    model = hanging(np.zeros((9, 9)))
    system = model.linearise([np.log(2.0 / 0.9) / 0.9] * 2)
    t = np.linspace(0.0, 4.0, 41)
    for mode in system.modes:
        assert np.abs(mode.shape.imag).max() > 0.1  # rotation: the coordinates are out of step
        expected = 1e-5 * (mode.shape * np.exp(mode.pole * t)[:, None]).real
        speed = 1e-5 * (mode.pole * mode.shape).real
        run = model.simulate(system.q + expected[0], speed, t, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(run.q - system.q, expected, atol=2e-9)


@pytest.mark.parametrize("factor", [-3.0, 0.01])
def test_the_scale_of_the_law_does_not_matter(rng, factor):
    values = np.array([*SPRINGS.values(), 0.1, 0.2])
    covariance = spread(rng, values)
    friction = {"x_dot**2/2": 0.1, "(x_dot-y_dot)**2/2": 0.2}
    one = law(["x", "y"], SPRINGS, friction, covariance).linearise([0.0, 0.0])
    scaled = [{k: factor * c for k, c in part.items()} for part in (SPRINGS, friction)]
    other = law(["x", "y"], *scaled, factor**2 * covariance).linearise([0.0, 0.0])
    np.testing.assert_allclose(errors_of(other), errors_of(one), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(other.mass, factor * one.mass)


def test_scales_of_modes_do_not_matter(rng):
    mass, stiffness = np.array([[1.0, 0.2], [0.2, 2.0]]), np.array([[14.0, -6.0], [-6.0, 6.0]])
    shapes = eigh(stiffness, mass)[1]
    other = mass @ shapes @ np.diag([1.0, 3.0]) @ np.linalg.inv(shapes)  # S M with S M = M Φ diag Φ⁻¹
    more = stiffness @ shapes @ np.diag([1.0, 3.0]) @ np.linalg.inv(shapes)

    def model(m, k):
        terms = {"x_dot**2": m[0, 0] / 2, "y_dot**2": m[1, 1] / 2, "x_dot*y_dot": m[0, 1]}
        return law(["x", "y"], {**terms, "x**2": -k[0, 0] / 2, "y**2": -k[1, 1] / 2, "x*y": -k[0, 1]})

    one, two = model(mass, stiffness).linearise([0, 0]), model(other, more).linearise([0, 0])
    assert np.abs(one.mass - two.mass).max() > 0.5
    np.testing.assert_allclose(errors_of(two)[0], errors_of(one)[0], rtol=1e-9, atol=1e-12)


def test_a_passive_system_has_the_same_modes_whatever_is_known():
    def pull(q, v, f):
        return np.stack([-8.0 * q[0] + 3.0 * q[1], 3.0 * q[0] - 3.0 * q[1]]) - 0.1 * v

    data = record(pull, [([1.0, -0.5], [0.0, 0.0]), ([0.2, 1.0], [1.0, 0.0])], ["x", "y"])
    library = la.Library(["x_dot**2", "y_dot**2", "x**2", "y**2", "x*y"], ["x", "y"], dissipation=FRICTION)
    one, other = (la.discover(data, library, known={"x_dot**2": c}) for c in (0.5, 40.0))
    found = [model.linearise([0.0, 0.0]) for model in (one, other)]
    first, second = (errors_of(system) for system in found)
    np.testing.assert_allclose(second[0], first[0], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(second[1], first[1], rtol=0.02, atol=1e-6)
    poles = np.linalg.eigvals([[0, 0, 1, 0], [0, 0, 0, 1], [-8, 3, -0.1, 0], [3, -3, 0, -0.1]])
    truth = np.sort(np.abs(poles))[::2]
    for mode, value in zip(found[0].modes, truth, strict=True):
        assert abs(mode.natural_frequency.value - value) < 4.0 * mode.natural_frequency.standard_error
        assert mode.natural_frequency.standard_error < 0.01 * value
        ratio = 0.05 / value
        assert abs(mode.damping_ratio.value - ratio) < 4.0 * mode.damping_ratio.standard_error
    (rest,) = one.equilibria()
    assert (rest.q.tolist(), rest.recorded, rest.stability) == ([0.0, 0.0], True, "stable")


FRICTION = ["x_dot**2/2", "y_dot**2/2"]


def test_a_damped_pendulum():
    model = law(["theta"], {"theta_dot**2": 0.5, "cos(theta)": 9.81}, {"theta_dot**2/2": 0.4})
    below, above = model.equilibria()
    np.testing.assert_allclose([below.q, above.q], [[0.0], [np.pi]])
    assert [below.stability, above.stability] == ["stable", "unstable"]
    (mode,) = model.linearise([0.0]).modes
    assert mode.natural_frequency.value == pytest.approx(np.sqrt(9.81))
    assert mode.damping_ratio.value == pytest.approx(0.2 / np.sqrt(9.81))
    falling = model.linearise([3.1416])  # π, as people write it
    assert falling.q[0] == pytest.approx(np.pi, rel=1e-12)
    np.testing.assert_allclose([mode.pole for mode in falling.modes], np.roots([1.0, 0.4, -9.81])[::-1])
    assert [mode.damping_ratio.value for mode in falling.modes] == [-1.0, 1.0]
    np.testing.assert_allclose(falling.poles, [mode.pole for mode in falling.modes])


def test_a_double_pendulum():
    model = true_law("double_pendulum")
    found = {tuple((rest.q / np.pi).round(9)): rest.stability for rest in model.equilibria()}
    assert found == {(0, 0): "stable", (1, 0): "unstable", (0, 1): "unstable", (1, 1): "unstable"}
    frequencies = [mode.natural_frequency.value for mode in model.linearise([0.0, 0.0]).modes]
    np.testing.assert_allclose(np.square(frequencies), 9.81 * np.array([2 - np.sqrt(2), 2 + np.sqrt(2)]))
    shapes = np.array([mode.shape for mode in model.linearise([0.0, 0.0]).modes])
    np.testing.assert_allclose(shapes, [[np.sqrt(0.5), 1.0], [-np.sqrt(0.5), 1.0]], atol=1e-12)


def test_wells_and_saddles_between_magnets():
    model = true_law("magnetic_pendulum")
    found = model.equilibria(within={"x": (-5.0, 5.0), "y": (-5.0, 5.0)})
    wells = np.array([rest.q for rest in found if rest.stability == "stable"])
    assert (len(found), len(wells)) == (7, 3)
    for rest in found:  # the magnets stand at the corners of a triangle
        turned = [[-0.5, -np.sqrt(0.75)], [np.sqrt(0.75), -0.5]] @ rest.q
        assert np.abs([other.q - turned for other in found]).max(axis=1).min() < 1e-9


def test_a_force_moves_the_equilibrium():
    model = law(["theta"], {"theta_dot**2": 0.5, "cos(theta)": 9.81}, covariance=np.diag([0.0, 1e-4]))
    lower, upper = model.equilibria(forces=[5.0])
    np.testing.assert_allclose([lower.q[0], upper.q[0]], [np.arcsin(5 / 9.81), np.pi - np.arcsin(5 / 9.81)])
    system = model.linearise(lower.q, forces=[5.0])
    assert system.modes[0].pole.imag == pytest.approx((9.81**2 - 25.0) ** 0.25)
    # sin θ = f/k: dθ = −f dk/(k² cos θ)
    assert system.standard_error[0] == pytest.approx(5.0 * 0.01 / (9.81**2 * np.cos(lower.q[0])), rel=1e-5)
    assert model.equilibria(forces=[12.0]) == ()


def test_wells_are_looked_for_where_asked():
    model = law(["x"], {"x_dot**2": 0.5, "x**2": 0.5, "x**4": -0.25})
    everywhere = model.equilibria(within={"x": (-2.0, 2.0)})
    assert [round(float(rest.q[0]), 9) for rest in everywhere] == [-1.0, 0.0, 1.0]
    assert [rest.stability for rest in everywhere] == ["stable", "unstable", "stable"]
    assert [rest.q[0] for rest in model.equilibria(within={"x": (0.5, 2.0)})] == pytest.approx([1.0])


def test_lines_of_equilibria_give_one():
    pair = law(["x", "y"], {"x_dot**2": 0.5, "y_dot**2": 0.5, "(x-y)**2": -2.0})
    (rest,) = pair.equilibria(within={"x": (-1.0, 1.0), "y": (-1.0, 1.0)})
    assert (rest.isolated, rest.stability) == (False, "neutral")
    assert np.isnan(rest.standard_error).all()
    assert rest.q[0] == pytest.approx(rest.q[1])
    free, swing = pair.linearise(rest.q).modes
    assert (free.natural_frequency.value, swing.natural_frequency.value) == (0.0, pytest.approx(np.sqrt(8.0)))
    hat = law(["x", "y"], {"x_dot**2+y_dot**2": 0.5, "x**2+y**2": 1.0, "(x**2+y**2)**2": -0.5})
    found = hat.equilibria(within={"x": (-2.0, 2.0), "y": (-2.0, 2.0)})
    assert sorted((round(float(np.hypot(*r.q)), 6), r.isolated) for r in found) == [(0.0, True), (1.0, False)]
    drifting = law(["x", "phi"], {"x_dot**2": 0.5, "phi_dot**2": 0.5, "x**2": -1.0})
    (rest,) = drifting.equilibria(within={"x": (-1.0, 1.0)})
    np.testing.assert_array_equal(rest.q, [0.0, 0.0])
    np.testing.assert_array_equal(np.isnan(rest.standard_error), [False, True])


def test_where_the_coordinates_fail_nothing_is_decided():
    model = true_law("spherical_pendulum")
    assert {rest.stability for rest in model.equilibria()} == {"undecided"}
    with pytest.raises(InputError, match="mass matrix is singular"):
        model.linearise([0.0, 0.0])


def test_equal_modes_have_no_shape_of_their_own():
    bowl = law(["x", "y"], {"x_dot**2+y_dot**2": 0.5, "x**2+y**2": -2.0}, covariance=np.diag([1e-6, 1e-6]))
    for mode in bowl.linearise([0.0, 0.0]).modes:
        # ω² = k/m: half of both relative errors
        assert mode.natural_frequency.standard_error == pytest.approx(np.hypot(2e-3, 0.5e-3), rel=1e-6)
        assert np.isnan(mode.shape_standard_error).any()
    # here the errors part the frequencies, and each is the lower one or the upper one
    terms = {"x_dot**2": 0.5, "y_dot**2": 0.5, "x**2": -2.0, "y**2": -2.0}
    apart = law(["x", "y"], terms, covariance=1e-6 * np.eye(4))
    assert np.isnan([m.natural_frequency.standard_error for m in apart.linearise([0.0, 0.0]).modes]).all()
    critical = law(["x"], {"x_dot**2": 0.5, "x**2": -0.5}, {"x_dot**2/2": 2.0}, 1e-6 * np.eye(3))
    assert np.isnan([m.natural_frequency.standard_error for m in critical.linearise([0.0]).modes]).all()


def test_without_errors_there_are_none():
    terms = [ModelTerm("x_dot**2", 0.5, known=True), ModelTerm("x**2", -2.0, float("nan"))]
    (mode,) = LagrangianModel("x", terms).linearise([0.0]).modes
    assert mode.natural_frequency.value == 2.0
    assert np.isnan([mode.natural_frequency.standard_error, mode.damping_ratio.standard_error]).all()
    assert str(Estimate(2.0, float("nan"))) == "2"


DRY = {"theta_dot**2/2 + abs(theta_dot)": 0.4, "abs(theta_dot)*theta_dot**2/3": 0.2}


def test_dry_friction_is_left_out():
    terms = {"theta_dot**2": 0.5, "cos(theta)": 9.81}
    system = law(["theta"], terms, DRY).linearise([0.0])
    assert system.left_out == ("theta_dot**2/2 + abs(theta_dot)",)
    assert system.damping.tolist() == [[0.4]]  # drag has none at rest
    rounded_off = {"sqrt(theta_dot**2 + 1/10000)": 0.2}
    noted = FitSummary(findings=[find("friction-smoothed", ["theta_dot"], widths=[0.01])])
    assert law(["theta"], terms, rounded_off, fit=noted).linearise([0.0]).left_out == tuple(rounded_off)
    written = law(["theta"], terms, rounded_off).linearise([0.0])  # nobody says what it stands for
    assert (written.left_out, written.damping.tolist()) == ((), [[pytest.approx(20.0)]])


def test_a_kink_of_the_potential_is_refused():
    model = law(["x"], {"x_dot**2": 0.5, "abs(x)": -1.0, "abs(x-1)**3": -1.0})
    with pytest.raises(InputError, match=r"abs\(x\) has a kink"):
        model.linearise([0.0])
    wedge = law(["x"], {"x_dot**2": 0.5, "abs(x)": -1.0, "x**2": -1.0})
    assert [rest.stability for rest in wedge.equilibria(within={"x": (-1.0, 1.0)})] == ["undecided"]
    smooth = law(["x"], {"x_dot**2": 0.5, "abs(x)**3": -1.0})
    assert smooth.linearise([0.0]).stiffness.tolist() == [[0.0]]


def test_prescribed_coordinates_are_held():
    model = true_law("cart_spring_pendulum", provenance={"options": {"prescribed": ["x"]}})
    rests = model.equilibria(inputs={"x": 0.3})
    assert [rest.q.round(9).tolist() for rest in rests] == [[0.3, 0.0], [0.3, round(np.pi, 9)]]
    system = model.linearise([0.3, 0.0])
    assert system.coordinates == ("theta",)
    assert system.modes[0].pole == pytest.approx(1j * np.sqrt(9.81))
    with pytest.raises(InputError, match="expected the positions of x"):
        model.equilibria()
    with pytest.raises(InputError, match="x, which was prescribed and is held; expected 0"):
        model.linearise([0.3, 0.0], forces=[1.0, 0.0])


@pytest.mark.parametrize("name", ["driven", "magnetic", "swapped", "single"])
def test_state_matrices_are_those_of_the_control_package(name):
    pytest.importorskip("control")
    model = MODELS[name]()
    rest = np.zeros(model.n_dof)
    system, other = model.linearise(rest), la.control.linearize(model, rest)
    np.testing.assert_allclose(system.a, other.A, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(system.b, other.B, rtol=1e-12, atol=1e-12)
    expected = np.linalg.eigvals(other.A)
    assert np.abs(expected[:, None] - system.poles).min(axis=0).max() < 1e-7


def test_wrong_use():
    model = law(["x", "y"], {**SPRINGS, "x": 1.0})
    with pytest.raises(InputError, match=r"is not an equilibrium; equilibria\(\).*forces = \[-1.0, 0.0\]"):
        model.linearise([0.0, 0.0])
    np.testing.assert_allclose(model.linearise([0.0, 0.0], forces=[-1.0, 0.0]).q, 0.0, atol=1e-12)
    with pytest.raises(InputError, match=r"the range of x is unknown.*give within=\{'x': \(low, high\)\}"):
        model.equilibria()
    with pytest.raises(InputError, match="'z' is not a coordinate; expected x, y"):
        model.equilibria(within={"z": (0.0, 1.0)})
    with pytest.raises(InputError, match="expected two rising numbers"):
        model.equilibria(within={"x": (1.0, 0.0)})
    with pytest.raises(InputError, match="expected nothing: no coordinate is prescribed"):
        model.equilibria(within={"x": (0, 1), "y": (0, 1)}, inputs={"x": 0.0})
    with pytest.raises(InputError, match="expected 2 finite number"):
        model.linearise([0.0])
    timed = law(["x"], {"x_dot**2": 0.5, "x*cos(t)": 1.0})
    for ask in (timed.equilibria, lambda: timed.linearise([0.0])):
        with pytest.raises(InputError, match=r"depends on time.*control\.linearize"):
            ask()
