"""The weak form: integration by parts, exact solutions, null terms, known columns, units."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy.interpolate import CubicSpline

from helpers import euler_lagrange, interpolate, uniform_grid
from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.curve.smoothing import smooth
from leastaction.mechanics.euler_lagrange import Points
from leastaction.selection import weak_form
from leastaction.selection.weak_form import WeakForm
from leastaction.simulation.integrate import rk4

TWO = ["x", "theta"]
LAGRANGIAN = [
    "x_dot**2",
    "theta_dot**2",
    "x_dot*theta_dot*cos(theta)",
    "x**2*theta_dot**2",
    "cos(theta)",
    "x**2",
    "x*cos(theta)",
    "x_dot**4",
    "exp(-x)*theta_dot*x_dot",
]
DISSIPATION = ["x_dot**2/2", "theta_dot**4", "x**2*theta_dot**2"]


def curve(t: np.ndarray) -> np.ndarray:
    """A smooth motion that solves nothing in particular."""
    return np.column_stack([np.sin(1.3 * t) + 0.4 * np.cos(2.9 * t), 0.8 * np.cos(1.7 * t) - 0.1 * t])


def gram_of(grid, control, columns, known=None, forces=None, width=1.5, scale=None, replicates=None):
    """Gram matrices of one width: ``residual`` of I + V, ``size`` of the parts, ``noise``.

    This is the only place that knows the call.  Without replicates the curve is taken as exact.
    """
    known = np.full(len(columns), np.nan) if known is None else np.asarray(known, dtype=float)
    scale = np.ones(columns.n_dof) if scale is None else np.asarray(scale, dtype=float)
    form = WeakForm(grid, columns, known, forces, [width], scale)
    return form.grams(control, [control, control] if replicates is None else replicates)[0]


def strong_at_quadrature(grid, control, columns) -> np.ndarray:
    """(n_columns, n_intervals, n_quadrature, n_dof)."""
    states = grid.at_quadrature(control)
    values = columns.strong(Points(*(s.reshape(-1, s.shape[2]) for s in states)))
    return values.transpose(0, 2, 1).reshape(len(columns), *states[0].shape)


def ratio(gram, coefficients) -> float:
    """‖(I + V) λ‖² over ½ (‖I λ‖² + ‖V λ‖²)."""
    c = np.asarray(coefficients, dtype=float)
    return float(c @ gram.residual @ c / (c @ gram.size @ c))


@pytest.mark.parametrize("which", range(len(LAGRANGIAN) + len(DISSIPATION)))
def test_integration_by_parts(which):
    """Along any curve ∫ (χ̇ p + χ ∂φ/∂q) dt = −∫ χ E[φ] dt: E[φ] as the force balances the column."""
    columns = euler_lagrange(LAGRANGIAN, TWO, DISSIPATION).subset([which])
    grid = uniform_grid([6.0, 4.0], 25.0, 5)
    control = interpolate(grid, [curve, lambda t: curve(t + 2.0)])
    forces = strong_at_quadrature(grid, control, columns)[0]
    gram = gram_of(grid, control, columns, forces=forces)
    size = np.trace(gram.size)
    assert np.ones(2) @ gram.residual @ np.ones(2) < 1e-13 * size
    assert (
        np.array([1.0, 0.5]) @ gram.residual @ np.array([1.0, 0.5]) > 1e-3 * size
    )  # the wrong force does not


def test_forced_motion_is_solved_by_the_true_coefficients_only():
    """Manufactured solution: choose curve and coefficients, compute the force."""
    columns = euler_lagrange(LAGRANGIAN, TWO, DISSIPATION)
    truth = np.random.default_rng(0).uniform(0.5, 2.0, len(columns))
    grid = uniform_grid([12.0, 12.0, 12.0], 25.0, 5)
    control = interpolate(grid, [lambda t, k=k: curve(t + 5.0 * k) * (1.0 + 0.3 * k) for k in range(3)])
    forces = np.tensordot(truth, strong_at_quadrature(grid, control, columns), 1)
    gram = gram_of(grid, control, columns, forces=forces)
    values, vectors = scipy.linalg.eigh(gram.residual, gram.size)
    assert values[0] < 1e-12
    assert values[1] > 1e5 * abs(values[0])
    np.testing.assert_allclose(vectors[:-1, 0] / vectors[-1, 0], truth, rtol=1e-4)


def oscillator_gram(knots_per_second, degree, frequency=2.0):
    grid = uniform_grid([8.0], knots_per_second, degree)
    control = interpolate(grid, [lambda t: np.cos(frequency * t)[:, None]])
    columns = euler_lagrange(["x_dot**2/2", "x**2/2", "x**4"], ["x"])
    return gram_of(grid, control, columns, known=[1.0, np.nan, np.nan], width=2.0)


@pytest.mark.parametrize(("degree", "least_order"), [(3, 3.0), (5, 3.7)])
def test_residual_of_an_exact_solution_falls_with_the_knot_spacing(degree, least_order):
    truth = [-4.0, 0.0, 1.0]  # x²/2, x⁴, the known kinetic energy
    residuals = np.sqrt([ratio(oscillator_gram(k, degree), truth) for k in (2.0, 4.0, 8.0)])
    orders = np.log2(residuals[:-1] / residuals[1:])
    assert residuals[-1] < 1e-3
    assert np.all(orders > least_order), (residuals, orders)


def test_wrong_coefficients_leave_a_residual():
    gram = oscillator_gram(10.0, 5)
    right = ratio(gram, [-4.0, 0.0, 1.0])
    for wrong in ([4.0, 0.0, 1.0], [-4.1, 0.0, 1.0], [-4.0, 0.05, 1.0], [0.0, 0.0, 1.0]):
        assert ratio(gram, wrong) > 1e4 * right


def test_null_terms_give_zero():
    """Total time derivatives: both parts are there, and cancel; constants have no parts at all."""
    null = [
        "x*x_dot",
        "cos(theta)*theta_dot",
        "x*theta_dot+theta*x_dot",
        "exp(x)*x_dot*theta+exp(x)*theta_dot",
    ]
    columns = euler_lagrange([*null, "x_dot", "1", "x_dot**2"], TWO)
    grid = uniform_grid([6.0], 25.0, 5)
    control = interpolate(grid, [curve])
    gram = gram_of(grid, control, columns)
    total, parts = np.diag(gram.residual), np.diag(gram.size)
    typical = parts[6]
    assert np.all(parts[: len(null)] > 1e-3 * typical)
    assert np.all(total[:5] < 1e-12 * typical)
    assert total[5] == parts[5] == 0.0
    assert total[6] > 1e-3 * typical


def test_known_terms_and_forces_share_the_last_column():
    columns = euler_lagrange(LAGRANGIAN[:5], TWO, DISSIPATION[:1])
    grid = uniform_grid([5.0], 20.0, 4)
    control = interpolate(grid, [curve])
    everything = gram_of(grid, control, columns)
    np.testing.assert_array_equal(everything.residual[-1], 0.0)  # nothing is known, no force acts
    known = np.array([np.nan, 2.0, np.nan, np.nan, -3.0, 0.7])
    gram = gram_of(grid, control, columns, known)
    mixing = np.zeros((6, 4))
    mixing[[0, 2, 3], [0, 1, 2]] = 1.0
    mixing[:, 3] = np.nan_to_num(known)
    for name in ("residual", "size"):
        free = getattr(everything, name)[:-1, :-1]
        np.testing.assert_allclose(getattr(gram, name), mixing.T @ free @ mixing, rtol=1e-10, atol=1e-10)
    # a force enters with weight one, in the potential part: here the known columns' own residual, negated
    forces = np.tensordot(np.nan_to_num(known), strong_at_quadrature(grid, control, columns), 1)
    balanced = gram_of(grid, control, columns, known, forces=forces)
    assert balanced.residual[-1, -1] < 1e-12 * gram.residual[-1, -1]


def test_gram_matrices_add_over_trajectories_and_bound_each_other():
    columns = euler_lagrange(LAGRANGIAN, TWO, DISSIPATION)
    both = uniform_grid([6.0, 3.0], 20.0, 5)
    control = interpolate(both, [curve, lambda t: curve(t + 1.0)])
    together = gram_of(both, control, columns)
    parts = [
        gram_of(uniform_grid([d], 20.0, 5), c, columns)
        for d, c in zip((6.0, 3.0), both.split(control), strict=True)
    ]
    for name in ("residual", "size"):
        matrix = getattr(together, name)
        np.testing.assert_allclose(matrix, sum(getattr(p, name) for p in parts), rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(matrix, matrix.T, rtol=1e-12, atol=1e-12)
        assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * np.linalg.eigvalsh(matrix)[-1]
    assert together.n_rows == sum(p.n_rows for p in parts)
    # ‖I + V‖² ≤ 2‖I‖² + 2‖V‖²
    assert np.linalg.eigvalsh(4.0 * together.size - together.residual)[0] > -1e-9 * np.trace(together.size)


@pytest.mark.parametrize("block", [1, 7, 100, 130, 331, 539, 540, 541])
def test_long_recordings_are_worked_off_in_blocks(monkeypatch, block):
    columns = euler_lagrange(LAGRANGIAN[:4], TWO)
    grid = uniform_grid([9.0, 2.0], 20.0, 5)
    control = interpolate(grid, [curve, curve])
    forces = np.random.default_rng(2).standard_normal((grid.n_intervals, 3, 2))
    at_once = gram_of(grid, control, columns, forces=forces)
    monkeypatch.setattr(weak_form, "_BLOCK", block)
    in_blocks = gram_of(grid, control, columns, forces=forces)
    np.testing.assert_allclose(in_blocks.residual, at_once.residual, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(in_blocks.size, at_once.size, rtol=1e-10, atol=1e-10)
    assert in_blocks.n_rows == at_once.n_rows


@pytest.mark.parametrize("unit", [1e-3, 30.0])
def test_units_of_time_and_length_only_rescale_columns(unit):
    """The generalised eigenvalues, and with them every ratio ρ, keep their values."""
    columns = euler_lagrange(["x_dot**2", "x**2", "x**4", "x**2*x_dot**2"], ["x"])
    space = SplineSpace(5, np.linspace(0.0, 6.0, 121))
    control = interpolate(SplineGrid([space]), [lambda t: curve(t)[:, :1]])
    base = gram_of(SplineGrid([space]), control, columns, known=[1.0, np.nan, np.nan, np.nan])
    stretched = SplineGrid([SplineSpace(5, unit * space.breakpoints)])
    in_time = gram_of(stretched, control, columns, known=[1.0, np.nan, np.nan, np.nan], width=1.5 * unit)
    in_length = gram_of(SplineGrid([space]), unit * control, columns, known=[1.0, np.nan, np.nan, np.nan])
    expected = generalised_eigenvalues(base)
    np.testing.assert_allclose(generalised_eigenvalues(in_time), expected, rtol=1e-6)
    np.testing.assert_allclose(generalised_eigenvalues(in_length), expected, rtol=1e-6)


def generalised_eigenvalues(gram) -> np.ndarray:
    scale = 1.0 / np.sqrt(np.diag(gram.size))
    outer = np.outer(scale, scale)
    return scipy.linalg.eigh(gram.residual * outer, gram.size * outer, eigvals_only=True)


def test_scale_weighs_the_equations():
    columns = euler_lagrange(LAGRANGIAN, TWO)
    grid = uniform_grid([5.0], 20.0, 5)
    control = interpolate(grid, [curve])
    first, second = (gram_of(grid, control, columns, scale=s) for s in ([1.0, 0.0], [0.0, 1.0]))
    mixed = gram_of(grid, control, columns, scale=[2.0, 3.0])
    np.testing.assert_allclose(
        mixed.residual, 4.0 * first.residual + 9.0 * second.residual, rtol=1e-10, atol=1e-10
    )
    # cos θ does not enter the equation of x, nor x² that of θ
    k, m = LAGRANGIAN.index("cos(theta)"), LAGRANGIAN.index("x**2")
    assert first.residual[k, k] == second.residual[m, m] == 0.0


def test_recording_shorter_than_the_test_function():
    gram = gram_of(
        grid := uniform_grid([1.0], 30.0, 5),
        interpolate(grid, [lambda t: np.cos(5.0 * t)[:, None]]),
        euler_lagrange(["x_dot**2/2", "x**2/2"], ["x"]),
        known=[1.0, np.nan],
        width=50.0,
    )
    assert gram.n_rows >= 1
    assert ratio(gram, [-25.0, 1.0]) < 1e-10


def test_several_widths_at_once_equal_one_by_one():
    columns = euler_lagrange(LAGRANGIAN, TWO)
    grid = uniform_grid([9.0, 2.0], 20.0, 5)
    control = interpolate(grid, [curve, curve])
    widths = [1.5, 0.6, 3.0]
    form = WeakForm(grid, columns, np.full(len(columns), np.nan), None, widths, np.ones(2))
    for width, gram in zip(widths, form.grams(control, [control, control]), strict=True):
        alone = gram_of(grid, control, columns, width=width)
        np.testing.assert_allclose(gram.residual, alone.residual, rtol=1e-10, atol=1e-12)
        assert gram.n_rows == alone.n_rows


@pytest.mark.parametrize(("uneven", "alike"), [(False, True), (True, False)])
def test_only_even_distances_confuse_a_force_with_one_of_another_frequency(uneven, alike):
    """With h between test functions, x cos ωt and x cos (2π/h − ω)t have rows in proportion."""
    hop = 1.5 / 6  # the width over the test functions in it
    texts = [f"x*{wave}({w}*t)" for w in (1.2, 2.0 * np.pi / hop - 1.2) for wave in ("cos", "sin")]
    columns = euler_lagrange(texts, ["x"])
    grid = uniform_grid([20.0], 40.0, 5)
    control = interpolate(grid, [lambda t: np.sin(t)[:, None]])
    form = WeakForm(grid, columns, np.full(4, np.nan), None, [1.5], np.ones(1), uneven)
    ((_, rows),) = form.rows(form.states(control))
    low, high = rows[:, :2], rows[:, 2:4]
    left = high - low @ np.linalg.lstsq(low, high)[0]
    assert (np.linalg.norm(left) < 0.02 * np.linalg.norm(high)) == alike
    assert alike or np.linalg.norm(left) > 0.5 * np.linalg.norm(high)


# --------------------------------------------------------------------------------------- noise
def pendulum_curve() -> CubicSpline:
    """θ̈ = −9.81 sin θ, finely sampled."""
    t = np.linspace(0.0, 8.0, 4001)
    q, _ = rk4(lambda q, v, f: -9.81 * np.sin(q), [1.2], [0.5], t)
    return CubicSpline(t, q)


@pytest.mark.parametrize("noise", [0.003, 0.03])
def test_noise_explains_the_residual_of_the_truth(noise):
    """Σ r² is on average what the replicates say: ρ of the true coefficients is about one."""
    exact, truth = pendulum_curve(), np.array([9.81, 0.0, 1.0])
    columns = euler_lagrange(["theta_dot**2/2", "cos(theta)", "theta**2"], ["theta"])
    grid = uniform_grid([8.0], 8.0, 5)
    t = np.linspace(0.0, 8.0, 401)
    ratios, wrong = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        smoothed = smooth(grid, [t], [exact(t) + noise * rng.standard_normal((t.size, 1))])
        replicates = smoothed.replicates(8, rng, np.zeros(1))
        gram = gram_of(grid, smoothed.control_points, columns, [1.0, np.nan, np.nan], replicates=replicates)
        ratios.append(truth @ gram.residual @ truth / (truth @ gram.noise @ truth))
        other = np.array([8.5, 0.0, 1.0])
        wrong.append(other @ gram.residual @ other / (other @ gram.noise @ other))
    assert 0.6 < np.mean(ratios) < 1.5, np.mean(ratios)
    assert np.mean(wrong) > 5.0 * np.mean(ratios)


def test_exact_curve_has_no_noise():
    gram = oscillator_gram(5.0, 5)
    np.testing.assert_allclose(gram.noise, 0.0, rtol=0, atol=1e-12 * np.abs(gram.size).max())
