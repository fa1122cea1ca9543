"""The weak form (integration by parts, exact solutions, units), and searches on it against brute force."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import scipy.linalg
from scipy.interpolate import CubicSpline

from helpers import euler_lagrange, interpolate, uniform_grid
from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.curve.smoothing import smooth
from leastaction.mechanics.euler_lagrange import Points
from leastaction.selection import weak_form
from leastaction.selection.likelihood_search import (
    QuadraticModel,
    relevant,
    search_subsets,
    term_penalty,
    trade_off,
)
from leastaction.selection.shape_profile import _Rows
from leastaction.selection.weak_form import WeakForm, WeakGram
from leastaction.selection.weak_search import (
    ScaledGram,
    beam_search,
    choose,
    grow_bases,
    solve_support,
    support_score,
)
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


# ------------------------------------------------- searches for supports against brute force over all of them
N = 8


def weak_problem(seed: int, members=(), noise: float = 0.0, n: int = N, correlation: float = 0.5):
    """Random I and V parts; with members, (I + V) λ = 0 for coefficients on them and the known column."""
    rng = np.random.default_rng([seed, n])
    n_rows = 120
    common = rng.standard_normal((n_rows, 1))
    inertial, potential = (
        (1 - correlation) * rng.standard_normal((n_rows, n + 1)) + correlation * common for _ in range(2)
    )
    inertial *= rng.uniform(0.3, 3.0, n + 1)
    truth = np.zeros(n)
    if members:
        truth[list(members)] = rng.choice([-1.0, 1.0], len(members)) * rng.uniform(0.5, 2.0, len(members))
        potential[:, -1] = -inertial[:, -1] - (inertial + potential)[:, :-1] @ truth
        potential[:, -1] += noise * rng.standard_normal(n_rows)
    return gram_from(inertial, potential), truth


def gram_from(inertial, potential) -> WeakGram:
    rows = inertial + potential
    nothing = np.zeros((rows.shape[1], rows.shape[1]))
    parts = 0.5 * (inertial.T @ inertial + potential.T @ potential)
    return WeakGram(rows.T @ rows, nothing, parts, len(rows))


def changed(gram: WeakGram, function) -> WeakGram:
    """All matrices put through a function."""
    return replace(
        gram, residual=function(gram.residual), noise=function(gram.noise), size=function(gram.size)
    )


def levels_of(gram: WeakGram, width: int = 8, error: float = 1.0):
    """All levels: with a very low price of terms the search has no reason to stop early."""
    return beam_search(gram, error, -1e6, 1.0, width)


def solve(gram: WeakGram, members, error: float = 1.0) -> np.ndarray:
    return solve_support(gram, error, members)


def ratio_oracle(gram: WeakGram, members, error: float = 1.0) -> float:
    index = np.ix_([*members, -1], [*members, -1])
    reference = gram.noise + error * gram.size
    return float(scipy.linalg.eigh(gram.residual[index], reference[index], eigvals_only=True)[0])


def brute_force(gram: WeakGram, size: int):
    return min((ratio_oracle(gram, s), s) for s in combinations(range(gram.residual.shape[0] - 1), size))


# ------------------------------------------------------------------------------- weak search
@pytest.mark.parametrize("seed", range(4))
def test_ratio_is_the_smallest_generalised_eigenvalue(seed):
    gram, _ = weak_problem(seed, (1, 4, 6), noise=0.1)
    for level in levels_of(gram):
        for support in level:
            assert support.ratio == pytest.approx(ratio_oracle(gram, support.members), rel=1e-6, abs=1e-11)


@pytest.mark.parametrize("seed", range(4))
def test_wide_search_equals_brute_force(seed):
    gram, _ = weak_problem(seed, (0, 3, 5) if seed % 2 else (), noise=0.3)
    for size, level in enumerate(levels_of(gram, width=70), start=1):
        best, members = brute_force(gram, size)
        assert level[0].members == members
        assert level[0].ratio == pytest.approx(best, rel=1e-6)
        assert [s.ratio for s in level] == sorted(s.ratio for s in level)
        assert len({s.members for s in level}) == len(level)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("error", [1e-4, 1e-2, 1.0])
def test_no_support_explains_what_all_candidates_do_not(seed, error):
    """What lets searches be left out: ρ of a support is at least that of the supports that hold it."""
    gram, _ = weak_problem(seed, (0, 3, 5) if seed % 2 else (), noise=0.3)
    everything = ScaledGram(gram, error).ratio(tuple(range(N)))
    assert all(s.ratio >= everything * (1 - 1e-9) for level in levels_of(gram, error=error) for s in level)


@pytest.mark.parametrize("seed", range(8))
def test_default_width_finds_the_planted_support(seed):
    members = tuple(sorted(np.random.default_rng(seed).choice(20, 5, replace=False).tolist()))
    gram, _ = weak_problem(seed, members, noise=0.02, n=20, correlation=0.7)
    levels = levels_of(gram)[:8]
    assert levels[4][0].members == members
    # a sharp elbow at the true size
    falls = -np.diff(np.log([level[0].ratio for level in levels]))
    assert np.argmax(falls) == 3
    assert falls[3] > 5.0 * falls[4:].max()


@pytest.mark.parametrize("seed", range(6))
def test_choice_among_the_last_columns_equals_brute_force(seed):
    gram, _ = weak_problem(seed, correlation=0.2)
    chosen = choose(ScaledGram(gram, 1.0), (0, 1), [(range(3, N), 2)], width=N)[0]
    best = min((ratio_oracle(gram, (0, 1, *s)), (0, 1, *s)) for s in combinations(range(3, N), 2))
    assert chosen.members == best[1]
    assert chosen.ratio == pytest.approx(best[0], rel=1e-6)


def with_noise_level(gram: WeakGram, members, truth) -> WeakGram:
    """The same with a noise matrix that makes ρ of the truth equal to one."""
    vector = np.append(truth, 1.0)
    level = vector @ gram.residual @ vector / (vector @ gram.size @ vector)
    return replace(gram, noise=level * gram.size)


def test_price_of_a_term_ends_the_search():
    gram, truth = weak_problem(1, (2, 5), noise=0.05, n=20)
    gram = with_noise_level(gram, (2, 5), truth)
    penalty = term_penalty(120, 20)
    levels = beam_search(gram, 0.0, penalty, 120.0)
    best = min((s for level in levels for s in level), key=lambda s: support_score(s, penalty, 120.0))
    assert best.members == (2, 5)
    assert len(levels) < 20


def test_better_than_noise_is_not_better():
    gram, truth = weak_problem(1, (2, 5), noise=0.05, n=20)
    gram = with_noise_level(gram, (2, 5), truth)
    price = 3.0
    scores = [support_score(level[0], price, 120.0) for level in beam_search(gram, 0.0, price, 120.0)]
    np.testing.assert_allclose(np.diff(scores[2:]), price)


@pytest.mark.parametrize("seed", range(4))
def test_coefficients_of_a_planted_support(seed):
    members = (1, 2, 6)
    gram, truth = weak_problem(seed, members)
    np.testing.assert_allclose(solve(gram, members), truth, rtol=1e-5, atol=1e-7)
    gram, truth = weak_problem(seed, members, noise=0.01)
    np.testing.assert_allclose(solve(gram, members), truth, rtol=0.05, atol=1e-2)


def test_units_of_columns_do_not_matter():
    gram, _ = weak_problem(2, (0, 4, 7), noise=0.05)
    units = 10.0 ** np.random.default_rng(3).uniform(-4, 4, N + 1)
    outer = np.outer(units, units)
    scaled = changed(gram, lambda m: m * outer)
    for a, b in zip(levels_of(gram), levels_of(scaled), strict=True):
        assert [s.members for s in a] == [s.members for s in b]
        np.testing.assert_allclose([s.ratio for s in a], [s.ratio for s in b], rtol=1e-6, atol=1e-11)
    plain, other = solve(gram, (0, 4, 7)), solve(scaled, (0, 4, 7))
    np.testing.assert_allclose(other * units[:-1] / units[-1], plain, rtol=1e-6, atol=1e-12)


def test_sequence_of_candidates_does_not_matter():
    gram, _ = weak_problem(3, (1, 3), noise=0.1)
    order = np.random.default_rng(4).permutation(N)
    index = np.ix_([*order, N], [*order, N])
    turned = changed(gram, lambda m: m[index])
    for a, b in zip(levels_of(gram), levels_of(turned), strict=True):
        back = [tuple(sorted(int(order[m]) for m in s.members)) for s in b]
        assert back[0] == a[0].members
        np.testing.assert_allclose(b[0].ratio, a[0].ratio, rtol=1e-6)


def test_cancelling_the_known_term_does_not_pay():
    """½q̇² against −½q̇² g(q) with g ≈ 1: the residual vanishes with the inertia, ρ does not."""
    rng = np.random.default_rng(5)
    known = rng.standard_normal(200)
    copy = known + 0.01 * rng.standard_normal(200)  # nearly the known column itself
    spring = -known + 0.02 * rng.standard_normal(200)  # what truly balances it, in the potential part
    zero = np.zeros(200)
    inertial, potential = np.column_stack([copy, zero, known]), np.column_stack([zero, spring, zero])
    gram = gram_from(inertial, potential)
    residuals = [np.linalg.lstsq((inertial + potential)[:, [k]], known, rcond=None)[1][0] for k in (0, 1)]
    assert residuals[0] < residuals[1]  # least squares would take the copy
    assert levels_of(gram, 1)[0][0].members == (1,)


def test_duplicate_columns_do_no_harm():
    gram, _ = weak_problem(6, (0, 2), noise=0.02, n=5)
    index = np.ix_([0, 1, 2, 3, 4, 2, 5], [0, 1, 2, 3, 4, 2, 5])
    doubled = changed(gram, lambda m: m[index])
    levels = levels_of(doubled, 6)
    assert levels[1][0].members in ((0, 2), (0, 5))
    assert all(np.isfinite(s.ratio) for level in levels for s in level)


# ----------------------------------------------------------------------------- best subsets
def regression(seed: int, n: int = N, truth_size: int = 3, n_rows: int = 60):
    rng = np.random.default_rng([seed, n, 1])
    x = rng.standard_normal((n_rows, n)) + 0.8 * rng.standard_normal((n_rows, 1))
    x *= 10.0 ** rng.uniform(-3, 3, n)
    truth = np.zeros(n)
    members = rng.choice(n, truth_size, replace=False)
    truth[members] = rng.uniform(0.4, 1.5, truth_size) / np.sqrt((x[:, members] ** 2).mean(axis=0))
    y = x @ truth + rng.standard_normal(n_rows)
    about = rng.standard_normal(n) / np.sqrt((x**2).mean(axis=0))  # any point will do to expand about
    model = QuadraticModel(x.T @ x, x.T @ (x @ about - y), about)
    here = float(np.sum((y - x @ about) ** 2))

    def cost(support) -> float:
        """Least-squares cost relative to the point of expansion, by QR of the columns."""
        q, _ = np.linalg.qr(x[:, list(support)])
        return float(np.sum((y - q @ (q.T @ y)) ** 2)) - here

    return model, x, y, tuple(sorted(members.tolist())), cost


def test_costs_are_least_squares_costs():
    model, *_, cost = regression(0)
    for size in range(N + 1):
        supports = np.array(list(combinations(range(N), size)), dtype=int)
        expected = [cost(s) for s in supports]
        np.testing.assert_allclose(model.costs(supports), expected, rtol=1e-6, atol=1e-6)


def test_solution_minimises_the_cost():
    model, x, y, *_ = regression(1)
    for members in [(), (3,), (0, 2, 7), tuple(range(N))]:
        expected = np.zeros(N)
        expected[list(members)] = np.linalg.lstsq(x[:, list(members)], y, rcond=1e-15)[0]
        np.testing.assert_allclose(model.solution(members), expected, rtol=1e-6)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("start", [(), (0, 1), tuple(range(N))])
def test_local_search_equals_brute_force(seed, start):
    model, *_, cost = regression(seed)
    penalty = term_penalty(60, N)
    levels = search_subsets(model, start, penalty)
    costs = {s: cost(s) + penalty * size for size in range(N + 1) for s in combinations(range(N), size)}
    best = min((level[0] for level in levels.values()), key=lambda c: c.criterion(penalty))
    assert best.criterion(penalty) == pytest.approx(min(costs.values()), rel=1e-6)
    assert best.members == min(costs, key=costs.__getitem__)
    for size, level in levels.items():
        # every level met is the best of its size, in rising cost, without repetition
        truth = min(value for s, value in costs.items() if len(s) == size)
        assert level[0].criterion(penalty) == pytest.approx(truth, rel=1e-6)
        assert all(len(c.members) == size and list(c.members) == sorted(c.members) for c in level)
        assert [c.cost for c in level] == sorted(c.cost for c in level)
        assert len({c.members for c in level}) == len(level)


@pytest.mark.parametrize("seed", range(5))
def test_larger_search_finds_the_planted_support(seed):
    model, _, _, planted, cost = regression(seed, n=40, truth_size=6, n_rows=400)
    penalty = term_penalty(400, 40)
    levels = search_subsets(model, (0, 1, 2), penalty)
    best = min((level[0] for level in levels.values()), key=lambda c: c.criterion(penalty))
    assert best.members == planted
    assert best.cost == pytest.approx(cost(planted), rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_group_is_exchanged_for_another_at_once(seed):
    """Exponentials of a chain against their Taylor series: swaps of one or two terms cannot get there."""
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(-0.8, 0.8, (2, 3000))
    groups = [np.exp(-a), np.exp(a - b), np.exp(b)]
    powers = [a**i * b**j for i in range(5) for j in range(5) if 0 < i + j < 5]
    x = np.column_stack([*groups, *powers, np.ones_like(a)])
    y = x[:, :3].sum(axis=1) + 0.05 * rng.standard_normal(a.size)
    everything = x.T @ x
    penalty = term_penalty(a.size, x.shape[1])
    model = QuadraticModel(everything, -x.T @ y, np.zeros(x.shape[1]))
    levels = search_subsets(model, tuple(range(3, 15)), penalty)
    best = min((level[0] for level in levels.values()), key=lambda c: c.criterion(penalty))
    assert best.members == (0, 1, 2)
    assert relevant(model, penalty) == (0, 1, 2)


def test_relevance_with_a_matrix_that_is_singular_but_for_rounding():
    """A negative eigenvalue cancels the priors; the inverse is then anything, and its diagonal no share."""
    n = 8
    matrix = np.eye(n)
    matrix[0, 1] = matrix[1, 0] = 1.0 + 1e-6 + 1e-15
    gradient = np.r_[np.zeros(2), np.full(n - 2, -10.0)]
    assert set(range(2, n)) <= set(relevant(QuadraticModel(matrix, gradient, np.zeros(n)), 10.0))


@pytest.mark.parametrize("seed", range(5))
def test_a_pair_that_one_term_stands_for_is_found(seed):
    """Near-twins of another term fill the ranks, and what the sum lacks is first made up by decoys."""
    rng = np.random.default_rng(seed)
    p, q, c, rest = rng.standard_normal((4, 1000))
    twins = [c + 0.01 * rng.standard_normal(1000) for _ in range(6)]
    decoys = [0.1 * rest + 0.05 * rng.standard_normal(1000) for _ in range(3)]
    x = np.column_stack([p + q + 0.1 * rest, c, p, q, *twins, *decoys])
    y = p + q + c
    model = QuadraticModel(x.T @ x, -x.T @ y, np.zeros(x.shape[1]))
    levels = trade_off(model, (0, 1))
    assert levels[3][0].members == (1, 2, 3)


def test_rounding_does_not_keep_a_term_in_a_fit_without_noise():
    """The whole cost is some 1e16 there, and its last digits are worth more than a term."""
    rng = np.random.default_rng(0)
    x = 1e8 * rng.standard_normal((500, 4))
    found = np.array([1.5, -0.5, 1.0, 3e-13])
    gradient = x.T @ x @ np.array([0.0, 0.0, 0.0, 1e-14])
    model = QuadraticModel(x.T @ x, gradient, found)
    (without,) = model.costs(np.array([[0, 1, 2]]))
    (all_four,) = model.costs(np.array([[0, 1, 2, 3]]))
    q, _ = np.linalg.qr(x[:, :3])
    rest = x[:, 3] - q @ (q.T @ x[:, 3])
    assert without - all_four == pytest.approx((2.9e-13) ** 2 * (rest @ rest), rel=1e-3)


def test_price_of_a_term_is_the_extended_bic():
    assert term_penalty(1000, 1) == pytest.approx(np.log(1000.0))
    assert term_penalty(1000, 50) == pytest.approx(np.log(1000.0) + 2.0 * np.log(50.0))
    assert np.isfinite(term_penalty(0, 0))


def test_search_ends_where_no_cost_is_a_number():
    """Noise instead of a motion can do that; the search once ran for ever."""
    model = QuadraticModel(np.full((4, 4), np.nan), np.zeros(4), np.ones(4))
    levels = search_subsets(model, (0, 1), 1.0)
    assert np.isnan(levels[2][0].cost)


def test_columns_whose_squares_overflow_count_as_undefined():
    rows = np.ones((5, 3))
    large = rows * [1.0, 1e200, 1.0]
    assert _Rows(rows, large, [rows]).defined().tolist() == [True, False, True]
    assert _Rows(rows, rows, [rows, large]).defined().tolist() == [True, False, True]


def test_a_base_of_all_candidates_is_a_support(rng):
    rows = rng.normal(size=(40, 3))
    gram = WeakGram(rows.T @ rows, np.zeros((3, 3)), np.eye(3), len(rows))
    ((support,),) = grow_bases(gram, 1.0, 1.0, 40.0, [(0, 1)])
    assert support.members == (0, 1)
    assert support.ratio == pytest.approx(ScaledGram(gram, 1.0).ratio((0, 1)))
