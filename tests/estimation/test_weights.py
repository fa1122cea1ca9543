"""The weights: evidence against dense marginal likelihoods, known noise, large weights of the equations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from helpers import euler_lagrange, interpolate, uniform_grid
from leastaction import systems
from leastaction.curve import bspline
from leastaction.curve.smoothing import smooth
from leastaction.data.trajectories import Rate
from leastaction.estimation.forces import forces_on
from leastaction.estimation.gauss_newton import fit_joint, score_candidates
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.observations import Observations
from leastaction.estimation.weights import (
    Start,
    _secant,
    evidence,
    fit_weights,
    start_weights,
    update_weights,
)


def oscillator(rng, *, duration=20.0, rate=50.0, noise=0.05, spectral_density=0.0, trials=2):
    """ẍ + 0.4 ẋ + 4 x = ξ(t), sampled: exact steps, white ξ of the given (two-sided) spectral density."""
    times, values = [], []
    fine = 8
    h = 1.0 / (rate * fine)
    for _ in range(trials):
        n = round(duration * rate) * fine
        kick = np.sqrt(spectral_density / h) * rng.standard_normal(n)
        state, path = rng.uniform(0.5, 1.5, 2), np.empty((n + 1, 2))
        path[0] = state
        for k in range(n):  # semi-implicit midpoint: error h², far below the noise
            v = (state[1] * (1 - 0.2 * h) + h * (kick[k] - 4.0 * state[0]) - h * h * state[1]) / (
                1 + 0.2 * h + h * h
            )
            state = np.array([state[0] + 0.5 * h * (v + state[1]), v])
            path[k + 1] = state
        times.append(np.arange(0, n + 1, fine) * h)
        values.append(path[::fine, :1] + noise * rng.standard_normal((n // fine + 1, 1)))
    return times, values


def oscillator_physics(scale: float = 1.0) -> tuple[Physics, np.ndarray]:
    columns = euler_lagrange(["x_dot**2/2", "x**2/2"], ["x"], ["x_dot**2/2"])
    return Physics(columns, np.array([False, True, True]), None), scale * np.array([1.0, -4.0, 0.4])


def two_curves(t: np.ndarray) -> np.ndarray:
    return np.column_stack([0.5 * np.sin(2.3 * t) + 0.2, 0.7 * np.cos(3.1 * t)])


def restricted_likelihood(grid, times, values, operator, noise, weights, rates=()) -> float:
    """Log marginal likelihood of linear equations K q + C q̇ + M q̈ = 0 by dense algebra on the data.

    The curve has the improper Gaussian prior exp(−½ Σ_i w_i ∫ r_i² dt); its directions without a penalty
    (initial positions and rates of each trajectory) are projected out.
    """
    n = len(weights)
    basis = [np.zeros((grid.points.size, grid.n_ctrl)) for _ in range(3)]
    for k, space in enumerate(grid.spaces):
        rows = np.flatnonzero(np.repeat(grid.owner == k, grid.points.shape[1]))
        for nu in range(3):
            block = BSpline(space.knots, np.eye(space.n_ctrl), space.degree)(grid.points.ravel()[rows], nu=nu)
            basis[nu][rows, grid.offsets[k] : grid.offsets[k + 1]] = block
    # rows and columns run over time and control point first, then coordinate
    residual = sum(np.kron(matrix, b) for matrix, b in zip(operator, basis, strict=True))
    penalty = residual.T @ (np.kron(weights, grid.weights.ravel())[:, None] * residual)
    values_, vectors = np.linalg.eigh(penalty)
    n_null = 2 * n * len(grid.spaces)
    design = np.kron(np.eye(n), grid.design(times).toarray())
    y = np.concatenate(values).T.ravel()
    variance = np.repeat(np.square(noise[:n]), y.size // n)
    for rate, sigma in zip(rates, noise[n:], strict=True):
        more = np.kron(np.eye(n)[rate.coordinate], grid.design(times, rate.derivative).toarray())
        design, y = np.vstack([design, more]), np.concatenate([y, *rate.values])
        variance = np.append(variance, np.full(len(more), sigma**2))
    root = design @ vectors[:, n_null:] / np.sqrt(values_[n_null:])
    null = design @ vectors[:, :n_null]
    covariance = np.diag(variance) + root @ root.T
    inverse = np.linalg.inv(covariance)
    information = null.T @ inverse @ null
    projected = inverse - inverse @ null @ np.linalg.solve(information, null.T @ inverse)
    return -0.5 * (y @ projected @ y + np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1])


def held_evidence(grid, times, values, physics, coefficients, noise, weights, rates=()) -> float:
    """Evidence with all coefficients held: then the problem is linear in the curve."""
    held = Physics(physics.columns, np.zeros_like(physics.free), None)
    observations = Observations(grid, times, values, rates)
    n = len(weights)
    weights = Weights(np.array(noise), np.array(weights), np.zeros(n))
    fit = fit_joint(observations, held, weights, np.zeros((grid.n_ctrl, n)), coefficients, tolerance=1e-8)
    return evidence(observations, fit)


def test_evidence_equals_the_marginal_likelihood():
    """Laplace's approximation is exact for linear equations: differences over the weights must agree."""
    times, values = oscillator(np.random.default_rng(0), duration=3.0, rate=20.0, spectral_density=0.02)
    grid = uniform_grid([3.0, 3.0], 6.0, 5, 3)
    physics, coefficients = oscillator_physics()
    operator = [np.array([[c]]) for c in (4.0, 0.4, 1.0)]
    cases = [([0.05], [30.0]), ([0.05], [300.0]), ([0.08], [30.0]), ([0.03], [5.0])]
    found = [held_evidence(grid, times, values, physics, coefficients, *case) for case in cases]
    expected = [restricted_likelihood(grid, times, values, operator, *case) for case in cases]
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-4, atol=1e-2)


def test_evidence_equals_the_marginal_likelihood_with_two_coordinates():
    rng = np.random.default_rng(4)
    times = [np.sort(rng.uniform(0.0, 2.5, 60)), np.sort(rng.uniform(0.0, 2.0, 50))]
    values = [two_curves(t) + 0.05 * rng.standard_normal((t.size, 2)) for t in times]
    grid = uniform_grid([2.5, 2.0], 6.0, 5, 3)
    columns = euler_lagrange(
        ["x_dot**2/2", "theta_dot**2/2", "x_dot*theta_dot", "x**2/2", "theta**2/2", "x*theta"],
        ["x", "theta"],
        ["x_dot**2/2"],
    )
    coefficients = np.array([2.0, 1.0, 0.5, -8.0, -9.0, 1.0, 0.4])
    operator = [[[8.0, -1.0], [-1.0, 9.0]], [[0.4, 0.0], [0.0, 0.0]], [[2.0, 0.5], [0.5, 1.0]]]
    operator = [np.array(matrix) for matrix in operator]
    physics = Physics(columns, np.zeros(7, dtype=bool), None)
    cases = [
        ([0.05, 0.05], [10.0, 30.0]),
        ([0.05, 0.05], [100.0, 30.0]),
        ([0.08, 0.05], [10.0, 30.0]),
        ([0.05, 0.03], [2.0, 300.0]),
    ]
    found = [held_evidence(grid, times, values, physics, coefficients, *case) for case in cases]
    expected = [restricted_likelihood(grid, times, values, operator, *case) for case in cases]
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-4, atol=2e-2)


def test_evidence_equals_the_marginal_likelihood_with_measured_rates():
    rng = np.random.default_rng(6)
    times, values = oscillator(rng, duration=3.0, rate=20.0, spectral_density=0.02)
    h = np.gradient(times[0])[0]
    velocity = Rate(0, 1, tuple(np.gradient(y[:, 0], h) + 0.1 * rng.standard_normal(len(y)) for y in values))
    rough = Rate(0, 2, tuple(-4.0 * y[:, 0] + rng.standard_normal(len(y)) for y in values))
    grid = uniform_grid([3.0, 3.0], 6.0, 5, 3)
    physics, coefficients = oscillator_physics()
    operator = [np.array([[c]]) for c in (4.0, 0.4, 1.0)]
    common = (grid, times, values)
    cases = [
        ([0.05, 0.8, 1.0], [30.0]),
        ([0.05, 0.2, 1.0], [30.0]),
        ([0.08, 0.8, 2.0], [300.0]),
        ([0.03, 0.8, 0.5], [5.0]),
    ]
    found = [held_evidence(*common, physics, coefficients, *case, (velocity, rough)) for case in cases]
    expected = [restricted_likelihood(*common, operator, *case, (velocity, rough)) for case in cases]
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-4, atol=1e-2)


def test_evidence_does_not_depend_on_the_scale_of_the_lagrangian():
    times, values = oscillator(np.random.default_rng(1), duration=3.0, rate=20.0, spectral_density=0.02)
    grid = uniform_grid([3.0, 3.0], 6.0, 5, 3)
    plain, scaled = (
        fit_weights(
            Observations(grid, times, values),
            oscillator_physics(s)[0],
            Start(
                interpolate(grid, [lambda t: np.cos(2.0 * t)[:, None]] * 2),
                oscillator_physics(s)[1],
                Weights(np.array([0.05]), np.array([50.0 / s**2]), np.array([40.0])),
            ),
        )
        for s in (1.0, 1e3)
    )
    np.testing.assert_allclose(scaled.coefficients, 1e3 * plain.coefficients, rtol=1e-3)
    np.testing.assert_allclose(scaled.weights.physics, 1e-6 * plain.weights.physics, rtol=1e-2)
    np.testing.assert_allclose(scaled.weights.noise_std, plain.weights.noise_std, rtol=1e-3)


def test_noise_and_equation_error_are_estimated():
    """A white force of known spectral density S: w = 1/S, σ and the coefficients come back."""
    density, noise = 0.02, 0.05
    times, values = oscillator(
        np.random.default_rng(2), duration=60.0, rate=50.0, noise=noise, spectral_density=density, trials=3
    )
    grid = uniform_grid([60.0] * 3, 12.0, 5, 2)
    physics, truth = oscillator_physics()
    observations = Observations(grid, times, values)
    weights = Weights(np.array([0.1]), np.array([5.0]), np.array([100.0]))
    start = interpolate(
        grid, [lambda t, k=k: np.interp(t, times[k], values[k][:, 0])[:, None] for k in range(3)]
    )
    fit = fit_weights(observations, physics, Start(start, truth * np.array([1.0, 0.8, 1.5]), weights))
    assert fit.converged
    np.testing.assert_allclose(fit.weights.noise_std, noise, rtol=0.05)
    np.testing.assert_allclose(fit.weights.physics, 1.0 / density, rtol=0.25)
    z = (fit.coefficients - truth)[1:] / np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(z) < 3.5), (fit.coefficients, z)


def test_weights_maximise_the_evidence():
    """At the fixed point no other weight, refitted, is more likely."""
    times, values = oscillator(np.random.default_rng(3), duration=15.0, rate=30.0, spectral_density=0.05)
    grid = uniform_grid([15.0, 15.0], 8.0, 5, 2)
    physics, truth = oscillator_physics()
    observations = Observations(grid, times, values)
    control = interpolate(
        grid, [lambda t, k=k: np.interp(t, times[k], values[k][:, 0])[:, None] for k in range(2)]
    )
    fit = fit_weights(
        observations,
        physics,
        Start(control, truth, Weights(np.array([0.05]), np.array([10.0]), np.array([50.0]))),
    )
    best = evidence(observations, fit)
    for noise, weight in ((1.3, 1.0), (0.75, 1.0), (1.0, 3.0), (1.0, 0.3)):
        weights = Weights(noise * fit.weights.noise_std, weight * fit.weights.physics, fit.weights.slack)
        other = fit_joint(observations, physics, weights, fit.control_points, fit.coefficients)
        assert evidence(observations, other) < best + 0.5


def test_an_equation_without_terms_has_a_weight_of_the_size_of_the_others():
    """Its error is zero, and n / ∫ r² would be 1e303: the normal equations of another candidate overflow."""
    t = np.linspace(0.0, 6.0, 200)
    grid = uniform_grid([6.0], 8.0, 5, 2)
    observations = Observations(grid, [t], [two_curves(t)])
    columns = euler_lagrange(["y_dot**2/2", "cos(y)", "x_dot**2", "x**2"], ["x", "y"])
    points, coefficients = interpolate(grid, [two_curves]), np.array([1.0, 9.81])
    physics = Physics(columns.subset([0, 1]), np.array([True, False]), None)
    weights = start_weights(observations, physics, np.full(2, 1e-2), points, coefficients)
    assert weights.physics[0] == weights.physics[1]
    fit = fit_weights(observations, physics, Start(points, coefficients, weights))
    update = update_weights(observations, fit)
    assert update.physics[0] == fit.weights.physics[0]
    assert update.physics[1] != fit.weights.physics[1]
    assert evidence(observations, fit) == -np.inf  # x is not determined
    quadratic = score_candidates(observations, physics, fit, columns)
    assert np.isfinite(quadratic.matrix).all()
    assert np.all(np.diag(quadratic.matrix)[2:] > 0.0)


@pytest.mark.parametrize("factor", [-0.8, -1.0, -5.0])
@pytest.mark.parametrize("first", [1.0, 0.5, 2.0])
def test_a_weight_that_swings_about_its_fixed_point_is_met(factor: float, first: float):
    """x → factor · x: without the shorter stride the rounds of −1 never end, and those of −5 run away."""
    x = np.array([1.0, -0.5])
    before = (factor - 1.0) * x
    taken = first * before  # a part of it, or accelerated
    x = x + taken
    stride = _secant(taken, before, (factor - 1.0) * x)
    assert np.abs(x + stride * (factor - 1.0) * x).max() < 1e-12


def test_a_stride_stays_between_a_tenth_and_all():
    one = np.array([1.0])
    assert _secant(1e-9 * one, one, -one) == 0.1
    assert _secant(one, one, -1e-12 * one) == pytest.approx(1.0)


# -------------------------------- steps of the joint fit where the weights of the equations are large
@pytest.mark.parametrize("off", [0.001, 0.003])
def test_a_step_that_leaves_nearly_exact_equations_is_corrected_and_not_refused(off):
    """By their curvature the cost rises, although the step is good; small steps would never arrive."""
    law = systems.get("double_pendulum").lagrangian
    data = systems.generate("double_pendulum", noise=0.05, trials=2, duration=10.0, seed=0)
    times, values = [x.t for x in data], [x.q for x in data]
    grid = bspline.uniform_grid(times, 50.0, 5, 2)
    curve = smooth(grid, times, values)
    forces = forces_on(grid, times, [x.forces for x in data]).values
    truth = np.array(list(law.values()))
    columns = euler_lagrange(list(law), data.coordinates)
    free, held = (Physics(columns, np.full(len(law), given), forces) for given in (True, False))
    weights = Weights(curve.noise_std, np.full(2, 1e6), np.ones(2))
    seen = Observations(grid, times, values)
    start = truth * (1.0 + off * (-1.0) ** np.arange(len(law)))
    points = fit_joint(seen, held, weights, curve.control_points, start, tolerance=1.0).control_points
    fit = fit_joint(seen, free, weights, points, start)
    assert fit.status == "converged"
    assert fit.n_steps <= 8
    again = fit_joint(seen, free, weights, fit.control_points, fit.coefficients, tolerance=1e-6)
    assert again.converged
    assert fit.linearisation.cost(weights) - again.linearisation.cost(weights) < 1e-2
