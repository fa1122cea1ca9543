"""B-splines against the textbook recursion and SciPy; smoothing against a dense mixed-model oracle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

import leastaction as la
from helpers import (
    DUFFING_LIBRARY,
    DUFFING_TRUTH,
    KINETIC,
    assert_finds,
    changed,
    dense_from_lower_band,
    duffing,
    euler_lagrange,
    findings_of,
    interpolate,
    naive_basis,
    random_breakpoints,
    record,
    uniform_grid,
)
from leastaction import systems
from leastaction.curve.bspline import SplineGrid, SplineSpace, uniform_space
from leastaction.curve.knots import lay_knots
from leastaction.curve.outliers import leave_out_outliers
from leastaction.curve.smoothing import banded_gram, smooth
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Problem, Structure

# ----------------------------------------------------------------------- B-splines: the laws that define them
DEGREES = [3, 4, 5, 6, 7]


def some_space(degree: int, n_intervals: int, kind: str, seed: int = 0) -> SplineSpace:
    rng = np.random.default_rng([seed, degree, n_intervals])
    points = np.linspace(-1.0, 2.0, n_intervals + 1)
    if kind == "random":
        points = random_breakpoints(rng, n_intervals, -1.0, 2.0)
    return SplineSpace(degree, points)


def times_in(space: SplineSpace, n: int = 23) -> np.ndarray:
    """Times across the space, every breakpoint and both ends among them."""
    inner = np.linspace(space.breakpoints[0], space.breakpoints[-1], n)
    return np.union1d(inner, space.breakpoints)


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize(
    ("n_intervals", "kind"), [(1, "uniform"), (2, "random"), (5, "uniform"), (5, "random")]
)
def test_basis_equals_textbook_recursion(degree, n_intervals, kind):
    space = some_space(degree, n_intervals, kind)
    x = times_in(space, 7)
    for nu in range(min(degree, 4)):
        expected = [[naive_basis(space.knots, degree, i, t, nu) for i in range(space.n_ctrl)] for t in x]
        scale = np.abs(expected).max()
        np.testing.assert_allclose(space.basis(x, nu).toarray(), expected, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("n_intervals", [1, 2, 3, 12, 60])
@pytest.mark.parametrize("kind", ["uniform", "random"])
def test_agrees_with_scipy(degree, n_intervals, kind):
    space = some_space(degree, n_intervals, kind)
    x = times_in(space, 101)
    oracle = BSpline.design_matrix(x, space.knots, degree).toarray()
    np.testing.assert_allclose(space.basis(x).toarray(), oracle, rtol=0, atol=1e-12)
    control = np.random.default_rng(1).standard_normal((space.n_ctrl, 2))
    for nu in (1, 2, 3):
        expected = BSpline(space.knots, control, degree).derivative(nu)(x)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(space.basis(x, nu) @ control, expected, rtol=0, atol=1e-12 * scale)
        np.testing.assert_allclose(space.evaluate(control, x, nu), expected, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("n_intervals", [1, 4, 30])
def test_partition_of_unity_and_its_derivatives(degree, n_intervals):
    space = some_space(degree, n_intervals, "random")
    x = times_in(space, 57)
    np.testing.assert_allclose(space.basis(x).sum(axis=1), 1.0, rtol=0, atol=1e-13)
    assert space.basis(x).data.min() >= 0.0
    for nu in (1, 2):
        matrix = space.basis(x, nu)
        assert np.abs(matrix.sum(axis=1)).max() <= 1e-12 * np.abs(matrix.data).max()


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("n_intervals", [1, 2, 9])
def test_clamped_ends_meet_first_and_last_control_point(degree, n_intervals):
    space = some_space(degree, n_intervals, "random")
    control = np.random.default_rng(2).standard_normal((space.n_ctrl, 3))
    ends = space.breakpoints[[0, -1]]
    np.testing.assert_allclose(space.evaluate(control, ends), control[[0, -1]], rtol=0, atol=1e-14)
    np.testing.assert_allclose(space.basis(ends) @ control, control[[0, -1]], rtol=0, atol=1e-14)
    # end rates follow from the first and the last pair of control points
    width = np.diff(space.breakpoints)[[0, -1]][:, None]
    slopes = degree * (control[[1, -1]] - control[[0, -2]]) / width
    np.testing.assert_allclose(space.basis(ends, 1) @ control, slopes, rtol=1e-12)


@pytest.mark.parametrize("degree", DEGREES)
def test_derivatives_up_to_degree_minus_one_are_continuous(degree):
    space = some_space(degree, 6, "random")
    control = np.random.default_rng(3).standard_normal((space.n_ctrl, 1))
    inner = space.breakpoints[1:-1]
    before = np.nextafter(inner, -np.inf)
    for nu in range(degree):
        jump = (space.basis(inner, nu) - space.basis(before, nu)) @ control
        size = np.abs(space.basis(inner, nu) @ control).max()
        assert np.abs(jump).max() <= 1e-10 * size
    jump = (space.basis(inner, degree) - space.basis(before, degree)) @ control
    assert np.abs(jump).min() > 1e-3  # a spline of this degree, not a polynomial


@pytest.mark.parametrize("degree", DEGREES)
def test_local_support(degree):
    space = some_space(degree, 12, "random")
    x = np.linspace(*space.breakpoints[[0, -1]], 211)
    dense = space.basis(x).toarray()
    for i in range(space.n_ctrl):
        outside = (x < space.knots[i]) | (x > space.knots[i + degree + 1])
        assert np.all(dense[outside, i] == 0.0)
        inside = (x > space.knots[i]) & (x < space.knots[i + degree + 1])
        assert np.all(dense[inside, i] > 0.0)
    first, values = space.local_basis(x)
    assert values.shape == (x.size, degree + 1)
    assert first.min() == 0
    assert first.max() == space.n_intervals - 1


@pytest.mark.parametrize("degree", DEGREES)
def test_reproduces_polynomials_and_their_derivatives(degree):
    space = some_space(degree, 7, "random")
    polynomial = np.polynomial.Polynomial(np.random.default_rng(4).standard_normal(degree + 1))
    x = times_in(space, 80)
    control, *_ = np.linalg.lstsq(space.basis(x).toarray(), polynomial(x), rcond=None)
    for nu in range(4):
        expected = polynomial.deriv(nu)(x) if nu else polynomial(x)
        np.testing.assert_allclose(
            space.basis(x, nu) @ control, expected, rtol=0, atol=1e-9 * np.abs(expected).max()
        )


@given(
    widths=st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=8),
    degree=st.integers(3, 7),
    start=st.floats(-100.0, 100.0),
    fraction=st.floats(0.0, 1.0),
    nu=st.integers(0, 2),
)
def test_random_breakpoints(widths, degree, start, fraction, nu):
    points = start + np.concatenate([[0.0], np.cumsum(widths)])
    space = SplineSpace(degree, points)
    x = np.clip(points[0] + fraction * (points[-1] - points[0]), points[0], points[-1])
    row = space.basis([x], nu).toarray()[0]
    oracle = [BSpline(space.knots, np.eye(space.n_ctrl)[i], degree)(x, nu=nu) for i in range(space.n_ctrl)]
    scale = max(np.abs(oracle).max(), 1e-300)
    np.testing.assert_allclose(row, oracle, rtol=0, atol=1e-9 * scale)
    assert abs(row.sum() - (nu == 0)) <= 1e-9 * max(scale, 1.0)


@pytest.mark.parametrize("degree", [-1, 0, 1, 2])
def test_low_degree_is_refused(degree):
    with pytest.raises(ValueError, match=rf"degree {degree} .* use 3 or more"):
        SplineSpace(degree, np.array([0.0, 1.0]))


@pytest.mark.parametrize(
    "points", [[0.0, 1.0, 0.5], [0.0, 0.0, 1.0], [0.0], [[0.0, 1.0]], [0.0, np.nan, 1.0]]
)
def test_bad_breakpoints_are_refused(points):
    with pytest.raises(ValueError, match="strictly increasing"):
        SplineSpace(3, np.array(points))


def test_uniform_space_spans_the_data_with_enough_knots():
    space = uniform_space(2.0, 5.0, 10.0, degree=5)
    assert (space.breakpoints[0], space.breakpoints[-1], space.n_intervals) == (2.0, 5.0, 30)
    assert uniform_space(0.0, 0.1, 1.0).n_intervals == 4
    assert uniform_space(0.0, 1.0, 10.01).n_intervals == 11  # never coarser than asked for


# ------------------------------------------------------------------------------------- grids
def mixed_grid(degree: int, n_quadrature: int) -> SplineGrid:
    """Trajectories of every kind the quadrature tables tell apart."""
    p = degree
    spaces = [
        SplineSpace(p, np.linspace(0.0, 1.0, 2)),
        SplineSpace(p, np.linspace(0.0, 3.0, 2 * p + 1)),  # exactly 2p intervals
        SplineSpace(p, np.linspace(1.0, 3.0, 2 * p + 2)),  # one more
        SplineSpace(p, np.linspace(-4.0, 3.0, 5 * p)),
        some_space(p, 4 * p, "random"),
    ]
    return SplineGrid(spaces, n_quadrature)


@pytest.mark.parametrize("degree", [3, 5, 6])
def test_quadrature_tables_equal_direct_evaluation(degree):
    grid = mixed_grid(degree, 3)
    control = np.random.default_rng(5).standard_normal((grid.n_ctrl, 2))
    states = grid.at_quadrature(control)
    for k, (space, part) in enumerate(zip(grid.spaces, grid.split(control), strict=True)):
        mine = grid.owner == k
        points = grid.points[mine]
        for nu in range(3):
            expected = space.evaluate(part, points.ravel(), nu).reshape(*points.shape, 2)
            scale = np.abs(expected).max()
            np.testing.assert_allclose(states[nu][mine], expected, rtol=0, atol=1e-11 * scale)
    for chunk in grid.chunks(7):
        for whole, part in zip(states, grid.at_quadrature(control, chunk), strict=True):
            np.testing.assert_array_equal(whole[chunk], part)


def test_slightly_uneven_breakpoints_do_not_share_tables():
    """Intervals that differ by a part in a thousand must not be taken for equal."""
    points = np.linspace(0.0, 1.0, 41)
    points[20] += 2.5e-5
    grid = SplineGrid([SplineSpace(3, points)], 2)
    control = np.random.default_rng(6).standard_normal((grid.n_ctrl, 1))
    direct = grid.spaces[0].evaluate(control, grid.points.ravel(), 2)
    np.testing.assert_allclose(grid.at_quadrature(control)[2].reshape(-1, 1), direct, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("n_quadrature", [2, 3, 5])
def test_quadrature_is_exact_for_polynomials(n_quadrature):
    grid = mixed_grid(3, n_quadrature)
    polynomial = np.polynomial.Polynomial(np.random.default_rng(7).standard_normal(2 * n_quadrature))
    integral = polynomial.integ()
    for k, space in enumerate(grid.spaces):
        mine = grid.owner == k
        a, b = space.breakpoints[[0, -1]]
        value = np.sum(grid.weights[mine] * polynomial(grid.points[mine]))
        np.testing.assert_allclose(value, integral(b) - integral(a), rtol=1e-12, atol=1e-12)
    total = sum(s.breakpoints[-1] - s.breakpoints[0] for s in grid.spaces)
    np.testing.assert_allclose(grid.weights.sum(), total, rtol=1e-13)


def test_quadrature_times_lie_in_their_intervals():
    grid = mixed_grid(4, 3)
    for k, space in enumerate(grid.spaces):
        points = grid.points[grid.owner == k]
        np.testing.assert_array_equal(
            space.interval_of(points.ravel()), np.repeat(np.arange(space.n_intervals), 3)
        )


def test_design_and_evaluate_keep_trajectories_apart():
    grid = mixed_grid(5, 2)
    rng = np.random.default_rng(8)
    control = rng.standard_normal((grid.n_ctrl, 2))
    times = [np.sort(rng.uniform(*s.breakpoints[[0, -1]], 15)) for s in grid.spaces]
    for nu in (0, 1, 2):
        together = grid.design(times, nu) @ control
        apart = np.concatenate(grid.evaluate(control, times, nu))
        np.testing.assert_allclose(together, apart, rtol=0, atol=1e-12 * np.abs(apart).max())
    moved = control.copy()
    moved[grid.offsets[2] : grid.offsets[3]] += 1.0
    for k, (a, b) in enumerate(zip(grid.evaluate(control, times), grid.evaluate(moved, times), strict=True)):
        np.testing.assert_allclose(b - a, 1.0 if k == 2 else 0.0, rtol=0, atol=1e-12)


# ----------------------------------------------------------------------------- refining knots
@pytest.mark.parametrize(("factor", "tolerance"), [(2.0, 1e-10), (1.4, 1e-4)])
def test_refined_knots_reproduce_the_curve(factor, tolerance):
    """Nested knots hold the old curve exactly; others interpolate it, with error O(h⁶)."""
    data = record(lambda q, v, f: -q, [([1.0], [0.0]), ([0.3], [1.2])], ["x"], duration=4.0, rate=25.0)
    columns = euler_lagrange(["x_dot**2/2", "x**2/2"], ["x"])
    coarse = Grid.lay(Problem(data, columns, np.array([1.0, np.nan])), 5.0)
    control = interpolate(coarse.spline, [lambda t: np.cos(t)[:, None], lambda t: np.sin(t)[:, None]])
    start = coarse.start(Structure([1]), control, np.array([1.0, -1.0]), np.array([0.01]))
    fit = coarse.fit(Structure([1]), start, max_rounds=1)
    times = [np.linspace(0.0, 4.0, 301)] * 2
    finer = Grid.lay(coarse.problem, factor * coarse.knots_per_second)
    refined = finer.carried(fit, np.ones(fit.control_points.shape[1]))
    assert finer.spline.n_intervals == pytest.approx(factor * coarse.spline.n_intervals)
    for nu in range(3):
        old = np.concatenate(coarse.spline.evaluate(fit.control_points, times, nu))
        new = np.concatenate(finer.spline.evaluate(refined.control_points, times, nu))
        np.testing.assert_allclose(new, old, rtol=0, atol=tolerance * 10.0**nu)
    np.testing.assert_array_equal(refined.coefficients, fit.coefficients)


# --------------------------------------------------------- smoothing: exactness, noise, units, gaps, outliers
def motion(t: np.ndarray) -> np.ndarray:
    return np.column_stack(
        [np.sin(2.0 * t) + 0.3 * np.cos(5.0 * t), 0.2 * t + np.exp(-0.3 * t) * np.cos(3.0 * t)]
    )


def noisy(times, sigma, seed=0):
    rng = np.random.default_rng(seed)
    return [motion(t) + sigma * rng.standard_normal((t.size, 2)) for t in times]


@pytest.mark.parametrize("degree", [3, 5])
def test_exact_on_quadratics(degree):
    """The penalty is blind to quadratics: they come back whatever the smoothing parameter."""
    grid = uniform_grid([3.0, 2.0], 8.0, degree)
    times = [np.linspace(0.0, 3.0, 120), np.linspace(0.0, 2.0, 77)]
    polynomials = [np.polynomial.Polynomial([1.0, -2.0, 0.7]), np.polynomial.Polynomial([-5.0, 0.1, -3.0])]
    result = smooth(grid, times, [p(t)[:, None] for p, t in zip(polynomials, times, strict=True)])
    for nu in range(3):
        curves = grid.evaluate(result.control_points, times, nu)
        for p, t, curve in zip(polynomials, times, curves, strict=True):
            expected = p.deriv(nu)(t) if nu else p(t)
            np.testing.assert_allclose(curve[:, 0], expected, rtol=0, atol=1e-5 * 10.0**nu)
    assert result.noise_std[0] < 1e-5


@pytest.mark.parametrize("sigma", [1e-4, 1e-2, 0.1, 0.5])
@pytest.mark.parametrize("degree", [3, 5])
def test_noise_is_estimated_within_five_per_cent(sigma, degree):
    grid = uniform_grid([10.0, 10.0], 12.0, degree)
    times = [np.linspace(0.0, 10.0, 1501)] * 2
    result = smooth(grid, times, noisy(times, np.array([sigma, 2.0 * sigma]), seed=3))
    np.testing.assert_allclose(result.noise_std, [sigma, 2.0 * sigma], rtol=0.05)
    # and the curve is closer to the truth than the data are
    error = np.concatenate(grid.evaluate(result.control_points, times)) - np.concatenate(
        [motion(t) for t in times]
    )
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 0.4 * np.array([sigma, 2.0 * sigma]))


def test_units_of_the_coordinate_do_not_matter():
    grid = uniform_grid([6.0], 10.0, 5)
    times = [np.linspace(0.0, 6.0, 301)]
    values = noisy(times, 0.05)
    a = smooth(grid, times, values)
    b = smooth(grid, times, [1e4 * v for v in values])
    np.testing.assert_allclose(b.control_points, 1e4 * a.control_points, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(b.noise_std, 1e4 * a.noise_std, rtol=1e-8)
    np.testing.assert_allclose(b.penalty, a.penalty, rtol=1e-5)


@pytest.mark.parametrize("unit", [1e-3, 60.0])
def test_units_of_time_do_not_matter(unit):
    grid = uniform_grid([6.0], 10.0, 5)
    times = [np.linspace(0.0, 6.0, 301)]
    values = noisy(times, 0.05)
    a = smooth(grid, times, values)
    scaled = SplineGrid([SplineSpace(5, unit * grid.spaces[0].breakpoints)])
    b = smooth(scaled, [unit * times[0]], values)
    np.testing.assert_allclose(b.control_points, a.control_points, rtol=0, atol=1e-6)
    np.testing.assert_allclose(b.noise_std, a.noise_std, rtol=1e-6)
    np.testing.assert_allclose(b.penalty, unit**5 * a.penalty, rtol=1e-4)


def test_shift_of_origin_does_not_matter():
    grid = uniform_grid([6.0], 10.0, 5)
    times = [np.linspace(0.0, 6.0, 301)]
    values = noisy(times, 0.05)
    a = smooth(grid, times, values)
    b = smooth(grid, times, [v + np.array([40.0, -7.0]) for v in values])
    np.testing.assert_allclose(b.control_points - [40.0, -7.0], a.control_points, rtol=0, atol=1e-6)
    np.testing.assert_allclose(b.noise_std, a.noise_std, rtol=1e-5)


def test_missing_samples_are_left_out():
    """NaN in one coordinate: the same as never having had the sample, and no effect on the other one."""
    grid = uniform_grid([6.0], 10.0, 5)
    times = [np.linspace(0.0, 6.0, 301)]
    values = noisy(times, 0.05)
    full = smooth(grid, times, values)
    keep = np.random.default_rng(1).random(301) > 0.3
    keep[100:121] = False  # a gap of four knot intervals
    holes = values[0].copy()
    holes[~keep, 0] = np.nan
    result = smooth(grid, times, [holes])
    fewer = smooth(grid, [times[0][keep]], [values[0][keep]])
    np.testing.assert_allclose(result.control_points[:, 0], fewer.control_points[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.noise_std[0], fewer.noise_std[0], rtol=1e-9)
    np.testing.assert_array_equal(result.control_points[:, 1], full.control_points[:, 1])
    bridged = grid.evaluate(result.control_points, times)[0][100:121, 0]
    np.testing.assert_allclose(bridged, motion(times[0][100:121])[:, 0], rtol=0, atol=0.25)


def test_a_gap_at_the_end_is_extrapolated_without_failure():
    grid = uniform_grid([6.0], 20.0, 5)
    t = np.linspace(0.0, 6.0, 301)
    values = noisy([t], 0.02)[0]
    values[280:] = np.nan
    result = smooth(grid, [t], [values])
    assert np.isfinite(result.control_points).all()
    np.testing.assert_allclose(result.noise_std, 0.02, rtol=0.15)


def reml_oracle(space: SplineSpace, t, y, kappas) -> tuple[np.ndarray, np.ndarray]:
    """−2 log restricted likelihood (σ profiled out) and σ̂, by dense algebra on the covariance of y.

    y = X β + Z b + noise with b ~ N(0, σ²/κ D⁺): the textbook mixed model, X the unpenalised directions.
    """
    n_ctrl, p = space.n_ctrl, space.degree
    nodes, weights = np.polynomial.legendre.leggauss(p)
    penalty = np.zeros((n_ctrl, n_ctrl))
    for a, b in zip(space.breakpoints[:-1], space.breakpoints[1:], strict=True):
        x = 0.5 * (a + b) + 0.5 * (b - a) * nodes
        third = BSpline(space.knots, np.eye(n_ctrl), p)(x, nu=3)
        penalty += third.T @ (0.5 * (b - a) * weights[:, None] * third)
    design = BSpline.design_matrix(t, space.knots, p).toarray()
    values, vectors = np.linalg.eigh(penalty)
    smooth_part = design @ vectors[:, 3:] / np.sqrt(values[3:])
    free_part = design @ vectors[:, :3]
    scores, sigmas = [], []
    for kappa in kappas:
        covariance = np.eye(t.size) + smooth_part @ smooth_part.T / kappa
        inverse = np.linalg.inv(covariance)
        information = free_part.T @ inverse @ free_part
        projected = inverse - inverse @ free_part @ np.linalg.solve(information, free_part.T @ inverse)
        sigma2 = y @ projected @ y / (t.size - 3)
        logdets = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1]
        scores.append((t.size - 3) * np.log(sigma2) + logdets)
        sigmas.append(np.sqrt(sigma2))
    return np.array(scores), np.array(sigmas)


@pytest.mark.parametrize(
    ("degree", "kind", "sigma"), [(3, "uniform", 0.1), (5, "random", 0.1), (5, "uniform", 0.02)]
)
def test_agrees_with_a_dense_mixed_model(degree, kind, sigma):
    rng = np.random.default_rng(11)
    points = np.linspace(0.0, 4.0, 21) if kind == "uniform" else random_breakpoints(rng, 20, 0.0, 4.0)
    space = SplineSpace(degree, points)
    t = np.sort(rng.uniform(0.0, 4.0, 90))
    y = motion(t)[:, 0] + sigma * rng.standard_normal(t.size)
    result = smooth(SplineGrid([space]), [t], [y[:, None]])
    grid = result.penalty[0] * 10.0 ** np.linspace(-2.0, 2.0, 81)
    scores, _ = reml_oracle(space, t, y, grid)
    (here,), (noise,) = reml_oracle(space, t, y, result.penalty)
    assert here <= scores.min() + 0.02  # as good as the best of the scan
    np.testing.assert_allclose(result.noise_std, noise, rtol=1e-6)
    assert abs(np.log10(grid[np.argmin(scores)] / result.penalty[0])) < 0.2


def test_banded_gram_equals_dense_product():
    grid = uniform_grid([1.0, 2.0], 5.0, 4)
    times = [np.linspace(0.0, 1.0, 30), np.linspace(0.0, 2.0, 40)]
    design = grid.design(times)
    dense = design.toarray()
    np.testing.assert_allclose(
        dense_from_lower_band(banded_gram(design, 4)), dense.T @ dense, rtol=0, atol=1e-12
    )


# --------------------------------------------------------- outliers are left out, and nothing else is
SHARE, SIZE = 0.02, 10.0


def spoiled(seed: int, noise: float = 0.02):
    """Recordings of a cart with a spring, and masks of the samples that are ten standard deviations off."""
    system = systems.get("cart_spring_pendulum")
    motions = systems.simulate_truth(system, 2, 15.0, 100.0, seed)
    sigma = systems.noise_std(system, motions, noise)
    clean = systems.measure(system, motions, sigma, seed)
    rng = np.random.default_rng(seed)
    masks = [rng.random(t.q.shape) < SHARE for t in clean]
    off = [SIZE * sigma * m * rng.choice((-1.0, 1.0), m.shape) for m in masks]
    data = [
        la.Trajectory(t.t, t.q + o, t.forces, t.coordinates, t.name) for t, o in zip(clean, off, strict=True)
    ]
    return la.Trajectories(data), masks, clean


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.thorough) for k in (1, 2))])
def test_the_outliers_are_found(seed):
    data, masks, _ = spoiled(seed)
    kept, notes = leave_out_outliers(data, 5)
    out = np.concatenate([np.isnan(t.q) for t in kept])
    planted = np.concatenate(masks)
    assert (out & planted).sum() > 0.98 * planted.sum()
    assert (out & ~planted).sum() <= 1
    assert [note.subject for note in notes] == [(name,) for name in data.coordinates]
    assert [note.values["count"] for note in notes] == out.sum(axis=0).tolist()


@pytest.mark.thorough
def test_the_outliers_of_a_long_recording_are_those_of_its_trials():
    """Smoothness and noise from pieces; where outliers are is seen trial by trial."""
    data, _, _ = spoiled(1)
    whole, _ = leave_out_outliers(data, 5)
    found, notes = leave_out_outliers(data, 5, data.n_samples // 2)
    one, other = (np.concatenate([np.isnan(t.q) for t in kept]) for kept in (whole, found))
    assert (one != other).sum() <= 2
    assert [note.values["count"] for note in notes] == other.sum(axis=0).tolist()
    clean = systems.generate("double_pendulum", noise=0.01, trials=2, duration=20.0, seed=7)
    assert leave_out_outliers(clean, 5, clean.n_samples // 2)[0] is clean


@pytest.mark.parametrize("noise", [0.0, 1e-4, 0.01, 0.3])
@pytest.mark.parametrize(
    "name",
    [
        "double_pendulum",
        *(
            pytest.param(n, marks=pytest.mark.thorough)
            for n in ("magnetic_pendulum", "spherical_spring_pendulum")
        ),
    ],
)
def test_good_samples_stay(name, noise):
    """Also where the curve through them cannot follow the fastest turns."""
    data = systems.generate(name, noise=noise, trials=2, duration=20.0, seed=7)
    kept, notes = leave_out_outliers(data, 5)
    assert sum(int(np.isnan(t.q).sum()) for t in kept) <= 1
    if not notes:
        assert kept is data


def test_heavy_tails_are_not_outliers():
    """An encoder that is off by a count in a tenth of its samples: that is its noise."""
    data = systems.generate("cart_spring_pendulum", noise=0.001, trials=2, duration=15.0, seed=0)
    rng = np.random.default_rng(0)
    count = 6.0 * 0.001 * np.std(data[0].q, axis=0)
    noisy = [
        la.Trajectory(t.t, t.q + count * (rng.random(t.q.shape) < 0.1), t.forces, t.coordinates) for t in data
    ]
    kept, notes = leave_out_outliers(la.Trajectories(noisy), 5)
    assert not notes
    assert sum(int(np.isnan(t.q).sum()) for t in kept) == 0


def test_what_was_unwrapped_is_remembered():
    t = np.arange(400) * 0.05
    rng = np.random.default_rng(0)
    q = np.mod(1.5 * t + 0.3 * np.sin(t) + 0.001 * rng.standard_normal(t.size), 2 * np.pi)
    q[100] += 0.5
    data = la.Trajectories([la.Trajectory(t, q, coordinates=["theta"])]).unwrap(["theta"])
    kept, notes = leave_out_outliers(data, 5)
    assert len(notes) == 1
    assert kept.wraps_removed == data.wraps_removed != {"theta": 0}


def test_discovery_is_as_good_as_without_them():
    def glitches(q):
        q = q.copy()
        hit = np.random.default_rng(2).random(q.shape) < SHARE
        q[hit] += 20.0 * 0.01 * np.random.default_rng(3).choice((-1.0, 1.0), int(hit.sum()))
        return q

    model = la.discover(changed(duffing(), q=glitches), DUFFING_LIBRARY, KINETIC)
    assert_finds(model, DUFFING_TRUTH)
    assert model.fit.status == "ok"
    assert findings_of(model, "outliers-left-out")
    kept = la.discover(changed(duffing(), q=glitches), DUFFING_LIBRARY, KINETIC, robust=False)
    assert not findings_of(kept, "outliers-left-out")
    assert kept.noise_std[0] > 1.3 * model.noise_std[0]


@pytest.mark.parametrize("drift", [0.0, 3.5, -3.5])
def test_turns_of_an_angle_do_not_hide_its_swings(drift):
    """The noise is a third of the swings, and a two hundredth of the turns."""
    t, rng = np.arange(0.0, 20.0, 0.01), np.random.default_rng(0)
    runs = [
        la.Trajectory(t, drift * t + 0.5 * np.sin(5.0 * t + k) + rng.normal(0.0, 0.1, t.size))
        for k in range(3)
    ]
    knots = lay_knots(la.Trajectories(runs), 5)
    assert 5.0 < knots.coarse < 100.0
    assert knots.per_second > 15.0
    assert knots.smooth.noise_std[0] == pytest.approx(0.1, rel=0.05)


def test_a_steady_turn_has_no_swings():
    """What rounding leaves of it asks for no knots."""
    t = np.arange(0.0, 20.0, 0.01)
    assert lay_knots(la.Trajectories([la.Trajectory(t, 3.5 * t)]), 5).coarse < 10.0
