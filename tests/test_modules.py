"""Modules that are loaded on first use: systems of python-control, units of coefficients, late forces."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import leastaction as la
from helpers import MODELS, finite_difference, states
from leastaction.delay import estimate, shift_forces
from leastaction.errors import DataError, InputError
from leastaction.model.model import LagrangianModel, ModelTerm

try:
    import control
except ImportError:
    control = None

needs_control = pytest.mark.skipif(control is None, reason="python-control is not installed")


@needs_control
@pytest.mark.parametrize("name", MODELS)
def test_dynamics_are_those_of_the_model(name):
    model = MODELS[name]()
    system = la.control.state_space(model, name="found")
    assert system.name == "found"
    for q, v, f in states(model):
        rates = system.dynamics(0.0, np.concatenate([q, v]), f)
        np.testing.assert_array_equal(rates, np.concatenate([v, model.acceleration(q, v, f)]))
        np.testing.assert_array_equal(system.output(0.0, np.concatenate([q, v]), f), np.concatenate([q, v]))


@needs_control
def test_labels_and_actuated_coordinates():
    model = MODELS["driven"]()
    system = la.control.state_space(model, actuated=["theta2"])
    assert system.input_labels == ["theta2_force"]
    assert system.state_labels == system.output_labels == ["theta1", "theta2", "theta1_dot", "theta2_dot"]
    x = np.array([0.3, 0.1, -0.2, 0.5])
    expected = model.acceleration(x[:2], x[2:], [0.0, 1.5])
    np.testing.assert_array_equal(system.dynamics(0.0, x, [1.5])[2:], expected)


@needs_control
def test_response_is_the_simulation():
    model = MODELS["driven"]()
    t = np.linspace(0.0, 2.0, 201)
    push = np.column_stack([np.sin(3.0 * t), 0.5 * np.cos(2.0 * t)])
    tight = {"rtol": 1e-10, "atol": 1e-10}
    response = control.input_output_response(
        la.control.state_space(model), t, push.T, [0.5, -0.3, 0.0, 0.0], solve_ivp_kwargs=tight
    )
    # The package joins the samples of the input by straight lines.
    straight = lambda time: np.array([np.interp(time, t, column) for column in push.T])  # noqa: E731
    run = model.simulate([0.5, -0.3], [0.0, 0.0], t, straight)
    np.testing.assert_allclose(response.outputs.T, np.hstack([run.q, run.qdot]), atol=1e-5)


def differences(model, q, qdot, forces):
    """A and B by central differences of the acceleration."""
    n = model.n_dof
    rates = lambda z: model.acceleration(z[:n], z[n : 2 * n], z[2 * n :])  # noqa: E731
    slopes = finite_difference(rates, np.concatenate([q, qdot, forces]), 1e-3)
    a = np.vstack([np.eye(2 * n)[n:], slopes[:, : 2 * n]])
    return a, np.vstack([np.zeros((n, n)), slopes[:, 2 * n :]])


@needs_control
@pytest.mark.parametrize("name", ["driven", "passive", "chaotic", "magnetic", "swapped"])
def test_linearisation_agrees_with_finite_differences(name):
    model = MODELS[name]()
    for q, v, f in states(model):
        system = la.control.linearize(model, q, v, f)
        a, b = differences(model, q, v, f)
        np.testing.assert_allclose(system.A, a, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(system.B, b, rtol=1e-6, atol=1e-6)


@needs_control
@pytest.mark.parametrize("q", [[0.0, 0.0], [np.pi, 0.0], [np.pi, np.pi]])
def test_linearisation_at_the_equilibria_of_the_double_pendulum(q):
    model = MODELS["driven"]()
    system = la.control.linearize(model, q, actuated=["theta1"])
    assert np.abs(model.acceleration(q, [0.0, 0.0])).max() < 1e-12
    a, b = differences(model, np.array(q), np.zeros(2), np.zeros(2))
    np.testing.assert_allclose(system.A, a, atol=2e-5)
    np.testing.assert_allclose(system.B, b[:, :1], atol=1e-9)
    of_package = la.control.state_space(model, actuated=["theta1"]).linearize([*q, 0.0, 0.0], 0.0)
    np.testing.assert_allclose(system.A, of_package.A, atol=1e-4)
    assert system.input_labels == ["theta1_force"]
    assert (system.poles().real.max() < 0) == (q == [0.0, 0.0])


@needs_control
def test_feedback_found_on_the_linear_system_holds_the_nonlinear_one():
    """The use that the wrapper is made for: stand a cart's pendulum on its head."""
    terms = {"x_dot**2": 1.0, "theta_dot**2": 0.5, "x_dot*theta_dot*cos(theta)": 1.0, "cos(theta)": 9.81}
    model = LagrangianModel(["x", "theta"], [ModelTerm(k, c) for k, c in terms.items()])
    linear = la.control.linearize(model, [0.0, np.pi], actuated="x")
    gain = control.place(linear.A, linear.B, [-2.0, -2.5, -3.0, -3.5])
    target = np.array([0.0, np.pi, 0.0, 0.0])

    def force(time, state):
        return np.array([float((-gain @ (state - target))[0]), 0.0])

    state = target + np.array([0.05, 0.1, 0.0, 0.0])
    for _ in range(400):  # held over 20 ms, as a controller would
        push = force(0.0, state)
        run = model.simulate(state[:2], state[2:], [0.0, 0.02], lambda time, push=push: push)
        state = np.concatenate([run.q[-1], run.qdot[-1]])
    np.testing.assert_allclose(state, target, atol=1e-3)


@needs_control
def test_wrong_use():
    model = MODELS["driven"]()
    with pytest.raises(InputError, match="'theta3' is not a coordinate of the model; it has theta1, theta2"):
        la.control.state_space(model, actuated=["theta3"])
    with pytest.raises(InputError, match="expected a LagrangianModel"):
        la.control.state_space("model.json")
    with pytest.raises(InputError, match=r"q is .* expected 2 finite number"):
        la.control.linearize(model, [0.0])
    singular = LagrangianModel(["x", "y"], [ModelTerm("x**2*x_dot**2", 1.0), ModelTerm("y_dot**2", 1.0)])
    with pytest.raises(InputError, match=r"cannot be linearised at q = \[0.0, 0.0\].*singular"):
        la.control.linearize(singular, [0.0, 0.0])


# ----------------------------- units of coefficients against those known from physics, and what does not fit
CART = la.Library(
    ["x_dot**2", "theta_dot**2", "x_dot*theta_dot*cos(theta)", "x**2", "x", "cos(theta)"], ["x", "theta"]
)
SI = {"x": "m", "theta": "rad"}


def units(what, *args, **options):
    return {item.expression: item.unit for item in la.units.check(what, *args, **options)}


def same(text, other):
    """Whether two texts mean the same unit."""
    import pint

    registry = pint.UnitRegistry()
    return abs((1 * registry.Unit(text) / registry.Unit(other)).to("").magnitude - 1.0) < 1e-12


def test_mechanics_in_si():
    found = units(CART, SI)
    expected = {
        "x_dot**2": "kg",
        "theta_dot**2": "kg*m**2",
        "x_dot*theta_dot*cos(theta)": "kg*m",
        "x**2": "N/m",
        "x": "N",
        "cos(theta)": "J",
    }
    assert set(found) == set(expected)
    for expression, unit in expected.items():
        assert same(found[expression].replace("·", "*"), unit), expression


def test_the_units_of_the_data_are_kept():
    """In mm, N and ms no factor hides in a coefficient."""
    library = la.Library(["x_dot**2", "x**2", "sqrt(x**2+4)"], ["x"]).with_dissipation(
        ["x_dot**2/2", "abs(x_dot)"]
    )
    found = units(library, {"x": "mm"}, {"x": "N"}, time="ms")
    assert found == {
        "x_dot**2": "N·ms²/mm",
        "x**2": "N/mm",
        "sqrt(x**2+4)": "N",
        "x_dot**2/2": "N·ms/mm",
        "abs(x_dot)": "N",
    }


def test_model_with_a_scale_of_its_own():
    model = LagrangianModel(
        ["theta"],
        [ModelTerm("theta_dot**2", 1.0, known=True), ModelTerm("cos(theta)", 9.8, 0.1)],
        [ModelTerm("sqrt(theta_dot**2+9/10000)", 0.2, 0.01)],
    )
    # L over half the inertia: the coefficient of the cosine is 2 g / l, that of Coulomb friction alike.
    found = la.units.check(model, {"theta": "rad"}, energy="rad**2/s**2")
    assert [(item.kind, item.unit) for item in found] == [
        ("lagrangian", "1"),
        ("lagrangian", "1/s²"),
        ("dissipation", "1/s²"),
    ]
    assert found[0].expression == "theta_dot**2"


def test_numbers_that_are_added_fit():
    library = la.Library(
        ["sqrt(x_dot**2+0.01)", "log(1+theta**2)", "(x+1)**2", "exp(-theta)"], ["x", "theta"]
    )
    assert units(library, SI)["(x+1)**2"] == units(CART, SI)["x**2"]


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (
            "cos(x)",
            r"cos\(x\): the argument x has the unit m; expected a pure number: measure it in units of",
        ),
        ("exp(-x)", r"exp\(-x\): the argument -x has the unit m"),
        ("log(x**2)", r"the argument .* has the unit m"),
        ("cos(theta_dot)", r"the argument theta_dot has the unit 1/s"),
        ("sin(theta*x)", r"has the unit m"),
        ("log(1+x**2)", r"has the unit m²"),
        (
            "(x+theta)**2",
            r"adds (theta \(1\) and x \(m\)|x \(m\) and theta \(1\)); what is added must have one unit",
        ),
    ],
)
def test_terms_that_make_no_sense(term, message):
    library = la.Library(["x_dot**2", term], ["x", "theta"])
    with pytest.raises(InputError, match=message):
        la.units.check(library, SI)
    # In units of a length of the system the same terms are right.
    assert len(la.units.check(library, {"x": "1", "theta": "1"}, time="1", energy="1")) == 2


def test_degrees_are_refused():
    with pytest.raises(InputError, match=r"theta has the unit (deg|°); functions take radians"):
        la.units.check(CART, {"x": "m", "theta": "degree"})
    with pytest.raises(InputError, match="functions take radians"):
        la.units.check(CART, {"x": "m", "theta": "turn"})


def test_forces_have_to_agree_with_the_energy():
    assert units(CART, SI, {"x": "N", "theta": "N*m"}) == units(CART, SI, {"x": "N"})
    for forces, energy, message in [
        (
            {"x": "N", "theta": "N"},
            None,
            "the force on theta in N times theta is N, not force times coordinate",
        ),
        ({"x": "N", "theta": "N*mm"}, None, "but for a factor"),
        ({"x": "N"}, "mJ", "is N·m, not the energy in mJ, but for a factor"),
        ({"x": "N*m"}, "J", "not the energy in J; check the units"),
    ]:
        with pytest.raises(InputError, match=message):
            la.units.check(CART, SI, forces, energy=energy)


@pytest.mark.parametrize(
    "text",
    [
        "",
        " ",
        "meters!",
        "foo",
        "m**99**99",
        "2**2**9",
        "(9)**9",
        "m**(2)",
        "10000*m",
        "__import__('os')",
        "m;s",
        "m" * 200,
        3,
        None,
        "m**-",
        "kg*(m",
        "lambda: 1",
        "nan",
        "9**9*m",
    ],
)
def test_texts_that_are_no_units(text):
    with pytest.raises(InputError, match="the unit of x is") as caught:
        la.units.check(CART, {"x": text, "theta": "rad"})
    assert "\n" not in str(caught.value)


def test_bad_arguments(monkeypatch):
    with pytest.raises(InputError, match="the unit of theta is missing"):
        la.units.check(CART, {"x": "m"})
    with pytest.raises(InputError, match="'phi' is not a coordinate"):
        la.units.check(CART, SI | {"phi": "rad"})
    with pytest.raises(InputError, match="'y' is not a coordinate"):
        la.units.check(CART, SI, {"y": "N"})
    with pytest.raises(InputError, match="which is not a time"):
        la.units.check(CART, SI, time="m")
    with pytest.raises(InputError, match="pass a model or a Library"):
        la.units.check("x**2", SI)
    la.units._registry.cache_clear()
    monkeypatch.setitem(sys.modules, "pint", None)
    with pytest.raises(ImportError, match=r"pip install 'leastaction\[units\]'"):
        la.units.check(CART, SI)


# ----------------- the delay between coordinates and forces, on simulated delays and where it cannot be known
PENDULUM = ["theta_dot**2", "cos(theta)", "sin(theta)", "theta_dot**4"]


def pendulum(noise, seed=0):
    return la.systems.generate("single_pendulum", noise=noise, trials=2, duration=10.0, seed=seed)


@pytest.mark.parametrize("delay", [0.0, 0.02, pytest.param(0.05, marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    ("noise", "width"), [(0.01, 0.001), pytest.param(0.1, 0.008, marks=pytest.mark.thorough)]
)
def test_simulated_delays(delay, noise, width):
    recorded = shift_forces(pendulum(noise), -delay)
    found = estimate(recorded, PENDULUM)
    assert found.determined
    assert found.reason == ""
    assert 0.1 * width < found.standard_error < width
    assert abs(found.delay - delay) < 3.5 * found.standard_error
    assert {term.expression for term in found.model.terms} == {"theta_dot**2", "cos(theta)"}
    assert found.log_likelihood.max() == 0.0
    assert np.all(np.diff(found.delays) > 0)
    # The shifted data are those that a discovery needs.
    expected = shift_forces(recorded, found.delay)
    assert found.trajectories.digest() == expected.digest()
    assert f"{1e3 * found.delay:.3g} ±" in repr(found)


@pytest.mark.slow
def test_standard_error_covers_the_truth():
    """Eight data sets: the errors in units of their standard errors are of size one."""
    delays = np.linspace(-0.04, 0.04, 8)
    z = []
    for seed, delay in enumerate(delays):
        found = estimate(shift_forces(pendulum(0.02, seed), -delay), PENDULUM, max_delay=0.06)
        assert found.determined
        z.append((found.delay - delay) / found.standard_error)
    # The 99.9 % range of a mean of eight squares.
    assert 0.05 < np.mean(np.square(z)) < 3.3


def test_a_delay_beyond_the_range_is_not_believed():
    found = estimate(shift_forces(pendulum(0.01), -0.08), PENDULUM, max_delay=0.05)
    assert not found.determined
    assert "raise max_delay" in found.reason
    assert found.standard_error == np.inf
    assert "not determined" in repr(found)


def test_a_constant_force_tells_nothing(rng):
    """The honest answer to a flat likelihood; the data come back as they were."""
    model = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
    t = np.arange(0.0, 8.0, 0.01)
    motion = model.simulate([1.0], [0.0], t, forces=lambda _: np.array([0.7])).q
    noisy = motion + 0.01 * rng.standard_normal(motion.shape)
    data = la.Trajectories([la.Trajectory(t, noisy, np.full_like(noisy, 0.7), ["x"])])
    found = estimate(data, ["x_dot**2", "x**2", "x**4"])
    assert not found.determined
    assert "hardly depends on it" in found.reason
    assert np.ptp(found.log_likelihood) < 4.0
    assert found.trajectories.digest() == data.digest()


@pytest.mark.thorough
def test_a_periodic_force_fits_at_several_delays(rng):
    model = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -20.0)])
    t = np.arange(0.0, 4.0, 0.005)

    def force(time):
        return 200.0 * np.sin(2 * np.pi * np.asarray(time) / 0.15)

    motion = model.simulate([0.1], [0.0], t, forces=lambda time: np.array([force(time)])).q
    noisy = motion + 0.001 * rng.standard_normal(motion.shape)
    data = la.Trajectory(t, noisy, force(t)[:, np.newaxis], ["x"])
    found = estimate(data, ["x_dot**2", "x**2"], max_delay=0.2)
    assert not found.determined
    assert "explain the data alike" in found.reason
    one_period = estimate(data, ["x_dot**2", "x**2"], max_delay=0.06)
    assert one_period.determined
    assert abs(one_period.delay) < 4.0 * one_period.standard_error


def test_bad_arguments_of_delays():
    data = pendulum(0.01)
    for wrong in (0.0, -0.1, np.nan, True):
        with pytest.raises(InputError, match="max_delay is"):
            estimate(data, PENDULUM, max_delay=wrong)
    with pytest.raises(DataError, match=r"the shortest trial has 10 s.*at most 1.2 s"):
        estimate(data, PENDULUM, max_delay=2.0)
    passive = [la.Trajectory(run.t, run.q, None, run.coordinates) for run in data]
    with pytest.raises(DataError, match="no force acts"):
        estimate(passive, PENDULUM, {"theta_dot**2": 0.5})


def test_shifted_forces_are_those_of_another_time():
    t = np.sort(np.r_[0.0, 2.0, np.linspace(0.003, 1.997, 200)])
    forces = np.column_stack([np.sin(3 * t), np.zeros(t.size)])
    q = np.column_stack([t, -t])
    runs = la.Trajectories(
        [la.Trajectory(t, q, forces, ["a", "b"], "driven"), la.Trajectory(t, q, None, ["a", "b"])]
    )
    for delay in (0.0, 0.13, -0.13):
        shifted = shift_forces(runs, delay)
        assert shifted.names == ("driven", "1")
        there = shifted[0].t
        np.testing.assert_allclose(shifted[0].forces[:, 0], np.sin(3 * (there - delay)), atol=1e-6)
        np.testing.assert_array_equal(shifted[0].q[:, 0], there)
        assert shifted[1].forces is None
        assert there[0] >= max(delay, 0.0)
        assert there[-1] <= 2.0 + min(delay, 0.0)
    cut = shift_forces(runs, 0.05, margin=0.2)
    assert cut[0].t[0] >= 0.2
    assert cut[0].t[-1] <= 1.8
    with pytest.raises(InputError, match="leaves nothing of trial 'driven'"):
        shift_forces(runs, 5.0)
    with pytest.raises(InputError, match="expected a finite number"):
        shift_forces(runs, np.nan)
