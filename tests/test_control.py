from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from export_models import MODELS, states
from helpers import finite_difference
from leastaction.errors import InputError
from leastaction.model.model import LagrangianModel, ModelTerm

control = pytest.importorskip("control")


@pytest.mark.parametrize("name", MODELS)
def test_dynamics_are_those_of_the_model(name):
    model = MODELS[name]()
    system = la.control.state_space(model, name="found")
    assert system.name == "found"
    for q, v, f in states(model):
        rates = system.dynamics(0.0, np.concatenate([q, v]), f)
        np.testing.assert_array_equal(rates, np.concatenate([v, model.acceleration(q, v, f)]))
        np.testing.assert_array_equal(system.output(0.0, np.concatenate([q, v]), f), np.concatenate([q, v]))


def test_labels_and_actuated_coordinates():
    model = MODELS["driven"]()
    system = la.control.state_space(model, actuated=["theta2"])
    assert system.input_labels == ["theta2_force"]
    assert system.state_labels == system.output_labels == ["theta1", "theta2", "theta1_dot", "theta2_dot"]
    x = np.array([0.3, 0.1, -0.2, 0.5])
    expected = model.acceleration(x[:2], x[2:], [0.0, 1.5])
    np.testing.assert_array_equal(system.dynamics(0.0, x, [1.5])[2:], expected)


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


@pytest.mark.parametrize("name", ["driven", "passive", "chaotic", "magnetic", "swapped"])
def test_linearisation_agrees_with_finite_differences(name):
    model = MODELS[name]()
    for q, v, f in states(model):
        system = la.control.linearize(model, q, v, f)
        a, b = differences(model, q, v, f)
        np.testing.assert_allclose(system.A, a, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(system.B, b, rtol=1e-6, atol=1e-6)


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
