"""The joint fit against dense brute force, finite differences, and problems with known answers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.optimize
from scipy.interpolate import BSpline

from helpers import euler_lagrange, finite_difference, interpolate, record, uniform_grid
from leastaction.curve.bspline import SplineGrid
from leastaction.data.trajectories import Rate
from leastaction.estimation import joint as problem_module
from leastaction.estimation.gauss_newton import condense, fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights, linearise
from leastaction.estimation.observations import Observations
from leastaction.estimation.problem import Problem
from leastaction.estimation.structure import Structure
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

COORDINATES = ["x", "theta"]
LAGRANGIAN = {
    "x_dot**2": 1.5,
    "theta_dot**2": 0.6,
    "x_dot*theta_dot*cos(theta)": 1.1,
    "cos(theta)": 9.81,
    "x**2": -5.0,
    "x": 2.0,
}
DISSIPATION = {"x_dot**2/2": 0.3}
KNOWN = "cos(theta)"


def curve(t: np.ndarray) -> np.ndarray:
    return np.column_stack([0.5 * np.sin(2.3 * t) + 0.2, 0.7 * np.cos(3.1 * t)])


@dataclass(frozen=True, eq=False)
class Tiny:
    """Two trajectories, two coordinates, seven columns, missing samples, forces."""

    grid: SplineGrid
    times: list[np.ndarray]
    values: list[np.ndarray]
    physics: Physics
    weights: Weights
    control: np.ndarray
    coefficients: np.ndarray
    rates: tuple[Rate, ...] = ()

    @property
    def observations(self) -> Observations:
        return Observations(self.grid, self.times, self.values, self.rates)

    @property
    def here(self) -> np.ndarray:
        """All unknowns: control points, coordinate fastest, then free coefficients."""
        return np.concatenate([self.control.ravel(), self.coefficients[self.physics.free]])

    def split(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        coefficients = self.coefficients.copy()
        coefficients[self.physics.free] = z[self.control.size :]
        return z[: self.control.size].reshape(self.control.shape), coefficients

    def residuals(self, z: np.ndarray) -> np.ndarray:
        """Everything whose squares add up to the cost, from SciPy's splines and the strong form."""
        control, coefficients = self.split(z)
        out = []
        for k, (t, y) in enumerate(zip(self.times, self.values, strict=True)):
            space, part = self.grid.spaces[k], self.grid.split(control)[k]
            spline = BSpline(space.knots, part, space.degree)
            scaled = (y - spline(t)) / self.weights.position_std
            out.append(scaled[np.isfinite(y)])
            for rate, sigma in zip(self.rates, self.weights.noise_std[2:], strict=True):
                y_dot = rate.values[k]
                scaled = (y_dot - spline(t, nu=rate.derivative)[:, rate.coordinate]) / sigma
                out.append(scaled[np.isfinite(y_dot)])
            mine = self.grid.owner == k
            x = self.grid.points[mine].ravel()
            strong = self.physics.columns.strong(Points(*(spline(x, nu=nu) for nu in range(3))))
            r = np.tensordot(coefficients, strong, 1)
            if self.physics.forces is not None:
                r = r - self.physics.forces[mine].reshape(-1, r.shape[0]).T
            out.append((np.sqrt(self.weights.physics[:, None] * self.grid.weights[mine].ravel()) * r).ravel())
        return np.concatenate(out)

    def log_volume(self) -> float:
        """Mean over time of log |det M|."""
        total = 0.0
        for k, space in enumerate(self.grid.spaces):
            spline = BSpline(space.knots, self.grid.split(self.control)[k], space.degree)
            mine = self.grid.owner == k
            x = self.grid.points[mine].ravel()
            mass = self.physics.columns.mass_matrix(Points(spline(x), spline(x, nu=1)), self.coefficients)
            total += self.grid.weights[mine].ravel() @ np.linalg.slogdet(mass)[1]
        return total / self.grid.weights.sum()

    def dense(self) -> tuple[np.ndarray, np.ndarray]:
        """Half gradient and Gauss–Newton matrix by finite differences."""
        jacobian = finite_difference(self.residuals, self.here, 1e-3)
        return jacobian.T @ self.residuals(self.here), jacobian.T @ jacobian

    def linearise(self, coefficients=None):
        coefficients = self.coefficients if coefficients is None else coefficients
        return linearise(self.observations, self.physics, self.control, coefficients)

    def condense(self):
        return condense(self.observations, self.linearise(), self.weights)


def tiny(
    degree: int = 3,
    n_quadrature: int = 3,
    slack: float = 0.0,
    forced: bool = True,
    seed: int = 0,
    rated: bool = False,
) -> Tiny:
    rng = np.random.default_rng(seed)
    columns = euler_lagrange(LAGRANGIAN, COORDINATES, DISSIPATION)
    grid = uniform_grid([1.0, 0.8], 5.0, degree, n_quadrature)
    times = [np.sort(rng.uniform(0.0, d, 30)) for d in (1.0, 0.8)]
    values = [curve(t) + 0.02 * rng.standard_normal((t.size, 2)) for t in times]
    values[0][3:6, 1] = np.nan
    values[1][10, 0] = np.nan
    free = np.array([term.text != KNOWN for term in columns.terms])
    truth = np.array([*LAGRANGIAN.values(), *DISSIPATION.values()])
    exact = interpolate(grid, [curve, curve])
    control = exact + 0.01 * rng.standard_normal((grid.n_ctrl, 2))
    coefficients = truth * np.where(free, rng.uniform(0.9, 1.1, truth.size), 1.0)
    forces = None
    if forced:  # those under which the curve is a motion of the system, and an equation error on top
        states = grid.at_quadrature(exact)
        strong = columns.strong(Points(*(s.reshape(-1, 2) for s in states)))
        forces = np.tensordot(truth, strong, 1).T.reshape(states[0].shape)
        forces = forces + 0.1 * rng.standard_normal(forces.shape)
    rates, noise = (), [0.02, 0.03]
    if rated:  # acceleration of x; velocity of theta, now and then, and not in the second trajectory
        h = 1e-4
        velocity, acceleration = (
            [(curve(t + h) - curve(t - h)) / (2 * h) for t in times],
            [(curve(t + h) - 2 * curve(t) + curve(t - h)) / h**2 for t in times],
        )
        seen = np.where(np.arange(30) % 3 == 0, np.nan, velocity[0][:, 1] + 0.1 * rng.standard_normal(30))
        rates = (
            Rate(1, 1, (seen, np.full(30, np.nan))),
            Rate(0, 2, tuple(a[:, 0] + rng.standard_normal(30) for a in acceleration)),
        )
        noise += [0.1, 1.0]
    weights = Weights(np.array(noise), np.array([4.0, 9.0]), np.full(2, slack))
    return Tiny(grid, times, values, Physics(columns, free, forces), weights, control, coefficients, rates)


def curve_steps(quadratic) -> tuple[np.ndarray, np.ndarray]:
    """H⁻¹g_P, and H⁻¹C from steps of one coefficient each."""
    size = quadratic.gradient.size
    rest = quadratic.curve_step(np.zeros(size))
    return rest, np.stack([quadratic.curve_step(unit) - rest for unit in np.eye(size)], axis=1)


# --------------------------------------------------------------------------- normal equations
@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("n_quadrature", [2, 3])
@pytest.mark.parametrize("forced", [True, False])
@pytest.mark.parametrize("rated", [True, False])
def test_cost_and_gradient_equal_brute_force(degree, n_quadrature, forced, rated):
    case = tiny(degree, n_quadrature, forced=forced, rated=rated)
    here = case.linearise()
    residuals = case.residuals(case.here)
    assert here.cost(case.weights) == pytest.approx(residuals @ residuals, rel=1e-12)

    def half_cost(z):
        return 0.5 * np.sum(case.residuals(z) ** 2)

    expected = finite_difference(half_cost, case.here, 1e-4)
    found = np.concatenate(here.gradients(case.weights))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("n_quadrature", [2, 3])
@pytest.mark.parametrize("rated", [True, False])
def test_elimination_of_the_curve_equals_dense_algebra(degree, n_quadrature, rated):
    """H, C, A of the Gauss–Newton matrix by finite differences; then log |H|, H⁻¹C, H⁻¹g, A − CᵀH⁻¹C."""
    case = tiny(degree, n_quadrature, rated=rated)
    gradient, matrix = case.dense()
    n = case.control.size
    found = case.condense()
    assert found.logdet == pytest.approx(np.linalg.slogdet(matrix[:n, :n])[1], abs=1e-6)
    response = np.linalg.solve(matrix[:n, :n], matrix[:n, n:])
    shift = np.linalg.solve(matrix[:n, :n], gradient[:n])
    curve_shift, curve_response = curve_steps(found)
    np.testing.assert_allclose(curve_response, response, rtol=0, atol=1e-6 * np.abs(response).max())
    np.testing.assert_allclose(curve_shift, shift, rtol=0, atol=1e-6 * np.abs(shift).max())
    schur = matrix[n:, n:] - matrix[n:, :n] @ response
    np.testing.assert_allclose(found.matrix, schur, rtol=1e-5, atol=1e-6 * np.abs(schur).max())
    reduced = gradient[n:] - matrix[n:, :n] @ shift
    np.testing.assert_allclose(found.gradient, reduced, rtol=1e-5, atol=1e-6 * np.abs(reduced).max())
    # both together are one Newton step of the whole problem
    newton = np.linalg.solve(matrix, gradient)
    step = np.linalg.solve(found.matrix, found.gradient)
    np.testing.assert_allclose(step, newton[n:], rtol=1e-4, atol=1e-6)
    whole = found.curve_step(-step)
    np.testing.assert_allclose(whole, newton[:n], rtol=0, atol=1e-5 * np.abs(newton[:n]).max())


def test_volume_term_and_its_derivatives_in_the_coefficients():
    with_, without = (tiny(5, 3, slack=s) for s in (11.0, 0.0))
    here = with_.linearise()
    log_volume = (here.cost(without.weights) - here.cost(with_.weights)) / 22.0
    assert log_volume == pytest.approx(with_.log_volume(), abs=0.03)  # a mean over fewer points
    free = with_.physics.free

    def half_volume(coefficients):
        moved = with_.coefficients.copy()
        moved[free] = coefficients
        at = with_.linearise(moved)
        return 0.5 * (at.cost(with_.weights) - at.cost(without.weights))

    def slope(coefficients):
        return finite_difference(half_volume, coefficients, 1e-2)

    point = with_.coefficients[free]
    parts = [here.gradients(case.weights)[1] for case in (with_, without)]
    np.testing.assert_allclose(parts[0] - parts[1], slope(point), rtol=1e-6, atol=1e-6)
    # log |det M| is concave in the coefficients: minus its second derivative joins the matrix as it is
    curvature = with_.condense().matrix - without.condense().matrix
    expected = finite_difference(slope, point, 1e-2)
    np.testing.assert_allclose(curvature, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_long_recordings_are_assembled_in_chunks(monkeypatch):
    case = tiny(5, 2, slack=3.0)
    cost, at_once = case.linearise().cost(case.weights), case.condense()
    monkeypatch.setattr(problem_module, "_CHUNK", 4)
    in_chunks = case.condense()
    for name in ("gradient", "matrix", "steps", "logdet"):
        a, b = (
            np.column_stack(curve_steps(q)) if name == "steps" else getattr(q, name)
            for q in (at_once, in_chunks)
        )
        np.testing.assert_allclose(b, a, rtol=1e-8, atol=1e-8 * np.abs(a).max(), err_msg=name)
    assert case.linearise().cost(case.weights) == pytest.approx(cost, rel=1e-12)


def test_every_measured_rate_is_a_channel():
    case = tiny(5, 3, rated=True)
    observations = case.observations
    assert observations.counts.tolist() == [59, 57, 20, 60]
    assert observations.coordinates.tolist() == [0, 1, 1, 0]
    assert [r.size for r in observations.residuals(case.control)] == [59, 57, 20, 60]
    plain = Observations(case.grid, case.times, case.values)
    assert np.array_equal(plain.noise_floor, observations.noise_floor)
    for i in (0, 1):
        assert np.array_equal(plain.gram(i), observations.gram(i))


def test_missing_samples_count_for_nothing():
    case = tiny(5, 3)
    assert case.observations.counts.tolist() == [59, 57]
    residuals = case.observations.residuals(case.control)
    assert [r.size for r in residuals] == [59, 57]
    moved = [v.copy() for v in case.values]
    observations = Observations(case.grid, case.times, moved)
    moved[0][0] += 1.0  # the observations are not a view into the caller's arrays
    np.testing.assert_array_equal(observations.residuals(case.control)[0], residuals[0])


# ------------------------------------------------------------------------------- Gauss–Newton
def cost_of(fit) -> float:
    return fit.linearisation.cost(fit.weights)


@pytest.mark.parametrize(("seed", "rated"), [(0, False), (1, False), (0, True)])
def test_fit_finds_the_minimum_that_dense_least_squares_finds(seed, rated):
    case = tiny(5, 3, seed=seed, rated=rated)
    fit = fit_joint(
        case.observations, case.physics, case.weights, case.control, case.coefficients, tolerance=1e-9
    )
    assert fit.converged, fit.status
    dense = scipy.optimize.least_squares(
        case.residuals, case.here, method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12
    )
    control, coefficients = case.split(dense.x)
    assert cost_of(fit) == pytest.approx(2.0 * dense.cost, rel=1e-6)
    spread = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose((fit.coefficients - coefficients)[case.physics.free] / spread, 0.0, atol=1e-2)
    np.testing.assert_allclose(fit.control_points, control, rtol=0, atol=1e-3)
    # covariance: the coefficients' block of the inverse of the whole normal matrix
    inverse = np.linalg.inv(dense.jac.T @ dense.jac)[case.control.size :, case.control.size :]
    np.testing.assert_allclose(
        fit.covariance / np.outer(spread, spread), inverse / np.outer(spread, spread), atol=1e-2
    )
    assert fit.coefficients[~case.physics.free].tolist() == [LAGRANGIAN[KNOWN]]


def test_bad_starts_end_with_a_status_and_not_with_an_exception():
    case = tiny(3, 3)
    far = fit_joint(
        case.observations,
        case.physics,
        case.weights,
        case.control + 3.0,
        10.0 * case.coefficients,
        max_steps=3,
    )
    assert far.status in ("converged", "stalled", "step limit")
    nothing = fit_joint(
        case.observations, case.physics, case.weights, case.control * np.nan, case.coefficients
    )
    assert not nothing.converged
    assert nothing.status == "not finite"


def test_units_of_the_candidates_do_not_matter():
    """Candidates multiplied by 10^±6: coefficients and their errors follow, the cost does not change."""
    case = tiny(5, 3)
    units = 10.0 ** np.array([6.0, -6.0, 3.0, 0.0, -4.0, 5.0, -5.0])
    texts = [
        f"10**({round(np.log10(u))})*({text})"
        for u, text in zip(units, [*LAGRANGIAN, *DISSIPATION], strict=True)
    ]
    columns = euler_lagrange(texts[:-1], COORDINATES, texts[-1:])
    plain = fit_joint(
        case.observations, case.physics, case.weights, case.control, case.coefficients, tolerance=1e-6
    )
    physics = Physics(columns, case.physics.free, case.physics.forces)
    other = fit_joint(
        case.observations, physics, case.weights, case.control, case.coefficients / units, tolerance=1e-6
    )
    assert cost_of(other) == pytest.approx(cost_of(plain), rel=1e-8)
    spread, scale = np.sqrt(np.diag(plain.covariance)), units[case.physics.free]
    np.testing.assert_allclose(
        (other.coefficients * units - plain.coefficients)[case.physics.free] / spread, 0, atol=1e-3
    )
    np.testing.assert_allclose(np.sqrt(np.diag(other.covariance)) * scale, spread, rtol=1e-3)


# ---------------------------------------------------------------------------------- grid
def duffing(noise: float, rate: float = 60.0, seed: int = 0):
    """ẍ = −x − 0.8 x³."""
    starts = [([1.2], [0.0]), ([0.4], [1.5])]
    return record(
        lambda q, v, f: -q - 0.8 * q**3, starts, ["x"], duration=6.0, rate=rate, noise=noise, seed=seed
    )


DUFFING = ("x_dot**2", "x**2", "x**4")
DUFFING_TRUTH = np.array([0.5, -0.5, -0.2])
MEMBERS = Structure([1, 2])


def duffing_grid(noise, knots_per_second, *extra, degree=5, seed=0):
    columns = euler_lagrange([*DUFFING, *extra], ["x"])
    known = np.full(len(columns), np.nan)
    known[0] = 0.5
    grid = Grid.lay(Problem(duffing(noise, seed=seed), columns, known, degree), knots_per_second)
    t = [trajectory.t for trajectory in grid.problem.trajectories]
    y = [trajectory.q for trajectory in grid.problem.trajectories]
    control = interpolate(
        grid.spline, [lambda x, k=k: np.interp(x, t[k], y[k][:, 0])[:, None] for k in range(2)]
    )
    coefficients = np.zeros(len(columns))
    coefficients[:3] = DUFFING_TRUTH
    return grid, grid.start(MEMBERS, control, coefficients, np.array([max(noise, 1e-6)]))


@pytest.mark.parametrize(("degree", "order"), [(3, 1.8), (5, 3.5)])
def test_coefficients_converge_in_the_knot_spacing(degree, order):
    """Noise-free data: the error that knots leave falls with a power of their spacing."""
    errors = []
    for knots in (3.0, 6.0, 12.0):
        grid, start = duffing_grid(0.0, knots, degree=degree)
        fit = grid.fit(MEMBERS, start)
        assert fit.converged
        errors.append(np.abs(fit.coefficients - DUFFING_TRUTH).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 2e-3
    assert orders.mean() > order, (errors, orders)


def test_standard_errors_cover_the_truth():
    """z values over 24 noise seeds: about normal with unit spread."""
    z = []
    for seed in range(24):
        grid, start = duffing_grid(0.03, 8.0, seed=seed)
        fit = grid.fit(MEMBERS, start)
        z.append((fit.estimates - DUFFING_TRUTH[1:]) / fit.standard_errors)
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((rms > 0.6) & (rms < 1.45)), rms
    assert np.abs(np.mean(z, axis=0)).max() < 0.7


def test_score_predicts_the_gain_of_a_candidate():
    """The quadratic model at a fit foretells the cost of the refit with one term more."""
    grid, start = duffing_grid(0.03, 8.0, "x**6", "cos(x)")
    fit = grid.fit(MEMBERS, start)
    quadratic = fit.score()
    # free columns: x², x⁴, x⁶, cos x; members are at their minimum
    spread = 1.0 / np.sqrt(np.diag(quadratic.matrix))
    assert np.abs(quadratic.gradient[:2] * spread[:2]).max() < 0.15
    index = [0, 1, 2]
    step = np.linalg.solve(quadratic.matrix[np.ix_(index, index)], quadratic.gradient[index])
    predicted = quadratic.gradient[index] @ step
    physics, columns = grid.physics(Structure([1, 2, 3]))
    larger = fit_joint(
        grid.observations,
        physics,
        fit.weights,
        fit.control_points,
        fit.coefficients[columns],
        tolerance=1e-5,
    )
    # the log-determinant term has one more degree of freedom than the model sees: compare the whole cost
    assert cost_of(fit) - cost_of(larger) == pytest.approx(predicted, rel=0.1, abs=0.05)
    free = np.array([1, 2, 3])
    change = larger.coefficients[:3] - fit.coefficients[free]
    np.testing.assert_allclose(change, -step, rtol=0.1, atol=0.1 * spread[:3].min())


def test_structure_keeps_known_and_leaves_out_what_is_not_a_member():
    grid, start = duffing_grid(0.03, 8.0, "x**6", "cos(x)")
    fit = grid.fit(MEMBERS, start)
    assert fit.coefficients[0] == 0.5
    assert fit.coefficients[3:].tolist() == [0.0, 0.0]
    assert grid.problem.free.tolist() == [1, 2, 3, 4]
    assert fit.covariance.shape == (2, 2)
    assert isinstance(grid.problem.candidates, EulerLagrange)


def test_numbers_that_overflow_end_a_fit_and_never_enter_a_structure():
    """exp(800 x) is infinite along this motion: no warning, no step, nothing promised."""
    grid, start = duffing_grid(0.03, 8.0, "exp(800*x)")
    quadratic = grid.fit(MEMBERS, start).score()
    assert np.isfinite(quadratic.matrix).all()
    assert quadratic.gradient[2] == 0.0
    assert np.all(quadratic.matrix[2, :2] == 0.0)
    one = np.eye(quadratic.gradient.size)[2]
    np.testing.assert_array_equal(quadratic.curve_step(one), quadratic.curve_step(0.0 * one))
    coefficients = start.coefficients.copy()
    coefficients[3] = 1e-3
    lost = grid.fit(Structure([1, 2, 3]), replace(start, coefficients=coefficients))
    assert lost.status == "not finite"


@pytest.mark.parametrize("size", [1e150, 1e-170, 1e200])
def test_weights_that_leave_the_range_of_numbers(size):
    case = tiny(3, 3)
    weights = replace(case.weights, physics=size * case.weights.physics)
    coefficients = case.coefficients * 1e30
    fit = fit_joint(case.observations, case.physics, weights, case.control, coefficients, max_steps=3)
    if fit.usable:
        assert np.isfinite(cost_of(fit))
        assert np.isfinite(fit.covariance).all()
    else:
        assert size > 1.0
