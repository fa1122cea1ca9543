"""B-splines against the textbook recursion, SciPy, and the laws that define them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from helpers import euler_lagrange, interpolate, naive_basis, random_breakpoints, record
from leastaction.curve.bspline import SplineGrid, SplineSpace, uniform_space
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Problem
from leastaction.estimation.structure import Structure

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
