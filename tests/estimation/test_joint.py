"""The joint fit against brute force and known answers; columns that are functions of the coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.optimize
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline

import leastaction as la
from helpers import euler_lagrange, finite_difference, interpolate, record, uniform_grid
from leastaction import systems
from leastaction.curve.bspline import SplineGrid
from leastaction.data.trajectories import Rate
from leastaction.diagnosis.hidden import about_sensors
from leastaction.diagnosis.wider_search import perhaps_degrees
from leastaction.errors import DataError, InputError
from leastaction.estimation import joint as problem_module
from leastaction.estimation import protocols
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.calibration import from_columns
from leastaction.estimation.constraints import circle_of
from leastaction.estimation.error_spectrum import error_spectrum
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights, linearise
from leastaction.estimation.observations import Observations
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.sensors import SensorFunctions
from leastaction.findings import find
from leastaction.findings.sentences import sentence
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
        return self.linearise().normal(self.weights).eliminate()


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


def test_an_error_that_is_not_finite_has_no_spectrum():
    grid, start = duffing_grid(0.03, 8.0)
    fit = grid.fit(MEMBERS, start)
    assert len(error_spectrum(fit).begins) > 3
    control = fit.control_points.copy()
    control[5] = np.inf
    spectrum = error_spectrum(replace(fit, control_points=control))
    np.testing.assert_allclose(spectrum.density, 1.0 / fit.weights.physics[None])


def test_score_predicts_the_gain_of_a_candidate():
    """The quadratic model at a fit foretells the cost of the refit with one term more."""
    grid, start = duffing_grid(0.03, 8.0, "x**6", "cos(x)")
    fit = grid.fit(MEMBERS, start)
    quadratic = fit.quadratic
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
    quadratic = grid.fit(MEMBERS, start).quadratic
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


# ------------------------------------------------------ columns that are functions of the coordinates
STIFFNESS = 9.81 / 0.62  # g/l
CAMERA = ["u = {u0} + {a}*sin(theta + {tilt})", "v = {v0} + {a}*cos(theta + {tilt})"]
TRUTH = {"u0": 320.0, "v0": 100.0, "a": 200.0, "tilt": -0.03}
LIBRARY = la.Library(["theta_dot**2", "cos(theta)"], ["theta"], angles=["theta"])
GIVEN = {"theta_dot**2": 0.5}


def swing(amplitude: float, seconds: float, rate: float = 60.0):
    """Times, angle, rate, and acceleration of a pendulum."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    motion = solve_ivp(
        lambda _, s: [s[1], -STIFFNESS * np.sin(s[0])],
        (0.0, seconds),
        [amplitude, 0.0],
        t_eval=t,
        rtol=1e-11,
        atol=1e-11,
    )
    return t, motion.y[0], motion.y[1], -STIFFNESS * np.sin(motion.y[0])


def recorded(columns, names, noise, seconds: float = 6.0, amplitudes=(0.9, 0.5), seed: int = 0):
    """What sensors measure of two swings."""
    rng = np.random.default_rng(seed)
    runs = []
    for amplitude in amplitudes:
        t, *motion = swing(amplitude, seconds)
        exact = np.column_stack(columns(*motion))
        runs.append(
            la.Trajectory(t, exact + np.asarray(noise) * rng.standard_normal(exact.shape), coordinates=names)
        )
    return la.Trajectories(runs)


def pixels(q, *_):
    seen = q + TRUTH["tilt"]
    return TRUTH["u0"] + TRUTH["a"] * np.sin(seen), TRUTH["v0"] + TRUTH["a"] * np.cos(seen)


def filmed(noise: float, **more):
    return recorded(pixels, ["u", "v"], noise, **more)


def deviations(model: la.LagrangianModel, truth: dict[str, float]) -> np.ndarray:
    """Calibration numbers less the truth, in standard errors."""
    numbers = {n.name: n for n in model.calibration.numbers}
    return np.array([(numbers[k].value - x) / numbers[k].standard_error for k, x in truth.items()])


# ---------------------------------------------------------------- functions
def test_slopes_are_those_of_differences() -> None:
    functions = SensorFunctions.parse(
        ["u = {s=3}*x*sin(theta) + {o}", "g = {k}*theta_ddot + x_dot**2*{s}"], ["x", "theta"]
    )
    assert functions.names == ("s", "o", "k")
    assert functions.starts == {"s": 3.0}
    assert functions.degrees == (0, 2)
    rng = np.random.default_rng(1)
    states, times, numbers = rng.normal(size=(3, 4, 2)), np.zeros(4), rng.normal(size=3)
    h, slopes, own = functions.evaluate(states, times, numbers)
    assert np.allclose(h, functions.values(states, times, numbers), rtol=1e-14)
    step = 1e-6
    for nu, i in np.ndindex(3, 2):
        moved = states.copy()
        moved[nu, :, i] += step
        there, back = (functions.values(s, times, numbers) for s in (moved, 2.0 * states - moved))
        assert np.allclose((there - back) / (2 * step), slopes[:, nu, i], atol=1e-7)
    for k in range(3):
        move = step * np.eye(3)[k]
        there, back = (functions.values(states, times, numbers + m) for m in (move, -move))
        assert np.allclose((there - back) / (2 * step), own[:, k], atol=1e-7)


@pytest.mark.parametrize(
    ("measure", "message"),
    [
        (["u"], "expected a column"),
        (["theta = {s}*theta"], "is a coordinate"),
        (["u = theta", "u = {s}*theta"], "two functions"),
        (["u = {s}*phi"], "unknown name 'phi'"),
        (["u = {s}"], "holds no coordinate"),
        (["u = {s=1e}*theta"], "expected a number"),
        (["w = {s}*theta", "u = theta", "v = theta"], "not a column of the data"),
        (["u = {s}*theta"], "neither a coordinate"),
        (["u = {s}*__import__('os')", "v = theta"], "cannot read"),
        (["u = {s}*thetta", "v = theta"], "function of 'u': cannot read .* did you mean 'theta'"),
        (["u = {s}*theta", "v = sqrt(theta-10)"], "function of 'v' has no finite value at any sample"),
    ],
)
def test_misuse_is_refused(measure, message) -> None:
    with pytest.raises(InputError, match=message):
        la.discover(filmed(1.0, seconds=1.0), LIBRARY, GIVEN, measure=measure)


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        ({"zz": (0.0, 1.0)}, r"'zz', which is neither .* nor one of the calibration numbers \(u0, a, v0\)"),
        ({"a": (100.0, 150.0)}, r"start value of \{a\} is 200; expected a value in its range, 100 to 150"),
        ({"u0": (2.0, 1.0)}, "range of the calibration number 'u0'"),
    ],
)
def test_ranges_of_calibration_numbers_are_checked(shapes, message) -> None:
    measure = ["u = {u0} + {a=200}*sin(theta)", "v = {v0} + {a}*cos(theta)"]
    with pytest.raises(InputError, match=message):
        build_problem(filmed(1.0, seconds=1.0), Request(LIBRARY, GIVEN, measure=measure, shapes=shapes))


def test_a_constant_column_is_refused_by_name() -> None:
    data = recorded(lambda q, *_: (q, 0.0 * q + 1.5), ["enc", "gyro"], [0.01, 0.0], seconds=1.0)
    with pytest.raises(DataError, match=r"column 'gyro' is 1\.5 in all samples"):
        la.discover(data, LIBRARY, GIVEN, measure=["enc = theta + {z}", "gyro = theta_dot + {b}"])


def test_a_computed_angle_has_no_notes_on_units_and_jumps() -> None:
    """It has no column whose unit could be wrong; its turns come from the search along the samples."""
    data = recorded(pixels, ["u", "v"], 1.0, seconds=2.0, amplitudes=(0.5,))
    turning = la.Trajectories([run.changed(q=np.column_stack(pixels(9.0 * run.t))) for run in data])
    setup = build_problem(turning, Request(LIBRARY, GIVEN, measure=CAMERA))
    assert not {f.code for f in setup.findings} & {"angle-unwrapped", "undeclared-angle"}
    grid, structure = Grid.lay(setup.problem, 12.0), Structure(setup.problem.free)
    fit = grid.fit(structure, grid.start(structure, grid.smooth().control_points, np.ones(2), np.ones(1)))
    assert np.ptp(fit.control_points) > 4.0 * np.pi
    assert not perhaps_degrees(fit, 1.0, np.ones(1), [])


def test_a_solver_that_stops_asks_for_start_values(joint) -> None:
    grid, _, start = joint
    fit = grid.fit(Structure(grid.problem.free), start)
    far = replace(fit, status="step limit", joint=1e20 * np.eye(5))
    texts = [sentence(finding, "command line") for finding in about_sensors(far, np.ones(3))]
    assert len(texts) == 4
    assert (
        "u0 was 320 when the solver stopped: give a start value near what you expect, such as {u0=1}"
        in texts[0]
    )
    away = replace(fit, weights=replace(fit.weights, calibration=np.full(4, -1e149)))
    assert len(about_sensors(away, np.ones(3))) == 4
    assert "give start values of the calibration numbers" in sentence(
        find("not-converged", reason="step limit", calibrated=True)
    )


def test_a_coordinate_that_nothing_shows_is_refused() -> None:
    library = la.Library(["theta_dot**2", "cos(theta)", "x_dot**2", "x**2"], ["theta", "x"], angles=["theta"])
    with pytest.raises(InputError, match="no measurement function"):
        la.discover(filmed(1.0, seconds=1.0), library, GIVEN, measure=CAMERA)


def test_groups_and_adam_are_refused() -> None:
    data = filmed(1.0, seconds=1.0)
    for more in ({"groups": ["a", "b"]}, {"method": "adam"}):
        with pytest.raises(InputError, match="measurement functions do not go with"):
            la.discover(data, LIBRARY, GIVEN, measure=CAMERA, **more)


def test_a_column_of_few_samples_is_refused() -> None:
    short = la.Trajectories([run.rows(slice(0, 10)) for run in filmed(1.0, amplitudes=(0.9,))])
    with pytest.raises(DataError, match="10 samples"):
        la.discover(short, LIBRARY, GIVEN, measure=CAMERA)


# ---------------------------------------------------------------- the joint problem
@pytest.fixture(scope="module")
def joint():
    """Observations, physics, and a point beside the optimum of a filmed pendulum."""
    setup = build_problem(filmed(1.0, seconds=2.0), Request(LIBRARY, GIVEN, measure=CAMERA))
    grid = Grid.lay(setup.problem, 12.0)
    structure = Structure(setup.problem.free)
    curve = grid.smooth().control_points
    start = grid.start(structure, curve, np.array([0.5, 14.0]), np.ones(1))
    return grid, grid.physics(structure)[0], start


def test_gradients_are_those_of_the_cost(joint) -> None:
    grid, physics, start = joint
    rng = np.random.default_rng(2)
    weights = replace(start.weights, slack=np.zeros(1))
    coefficients = grid.problem.completed(start.coefficients)[grid.physics(Structure(grid.problem.free))[1]]

    def cost(points, lam, kappa):
        return protocols.linearise(
            grid.observations, physics, points, lam, replace(weights, calibration=kappa)
        ).cost(weights)

    here = protocols.linearise(
        grid.observations, physics, start.control_points, coefficients, weights
    ).normal(weights)
    shift = 1e-3 * rng.normal(size=start.control_points.shape)
    kappa, move = weights.calibration, 1e-4 * rng.normal(size=weights.calibration.size)
    ends = [cost(start.control_points + s * shift, coefficients, kappa + s * move) for s in (1e-2, -1e-2)]
    slope = 2.0 * (here.border[:, 0] @ shift.ravel() + here.gradient[physics.n_free :] @ move)
    assert (ends[0] - ends[1]) / 2e-2 == pytest.approx(slope, rel=1e-4)


def test_traces_are_the_sensitivity_of_log_det_h(joint) -> None:
    grid, physics, start = joint
    coefficients = grid.problem.completed(start.coefficients)[grid.physics(Structure(grid.problem.free))[1]]
    at = protocols.linearise(grid.observations, physics, start.control_points, coefficients, start.weights)

    def logdet(channel: int, factor: float) -> float:
        noise = start.weights.noise_std.copy()
        noise[channel] *= np.exp(-0.5 * factor)
        return at.normal(replace(start.weights, noise_std=noise)).eliminate().logdet

    _, used = at.freedom(start.weights)
    for channel in (1, 2):
        slope = (logdet(channel, 1e-3) - logdet(channel, -1e-3)) / 2e-3
        assert used[channel] == pytest.approx(slope, rel=1e-4)


def test_held_coefficients_have_a_covariance_with_calibration_numbers(joint) -> None:
    """With coefficients and errors of the fit itself, its covariance returns; with wider ones, wider."""
    grid, _, start = joint
    fit = grid.fit(Structure(grid.problem.free), start)
    same = grid.held(fit, fit.coefficients, fit.covariance)
    size = np.sqrt(np.diag(fit.joint))
    assert np.allclose(same.joint / np.outer(size, size), fit.joint / np.outer(size, size), atol=0.02)
    wide = grid.held(same, fit.coefficients, 9.0 * fit.covariance)
    assert np.array_equal(wide.joint[:1, :1], wide.covariance)
    assert np.allclose(wide.joint[0, 1:], 9.0 * same.joint[0, 1:], rtol=0.02)
    assert np.all(np.diag(wide.joint) >= np.diag(same.joint))
    assert not about_sensors(wide, np.ones(3))


@pytest.mark.parametrize("start", ["", "=0.001", "=320"])
def test_a_start_near_zero_does_not_make_a_number_open(start) -> None:
    """Where zero of the picture lies says nothing about how well the place of the pivot is known."""
    measure = [f"u = {{u0{start}}} + {{a=200}}*sin(theta)", "v = {v0=100} + {a}*cos(theta)"]
    setup = build_problem(filmed(1.0, seconds=2.0), Request(LIBRARY, GIVEN, measure=measure))
    grid, structure = Grid.lay(setup.problem, 12.0), Structure(setup.problem.free)
    fit = grid.fit(structure, grid.start(structure, grid.smooth().control_points, np.ones(2), np.ones(1)))
    variances = np.diag([0.1, 2.0**2, 2.0**2, 2.0**2])
    assert not about_sensors(replace(fit, joint=variances), np.ones(3))
    assert len(about_sensors(replace(fit, joint=1e4 * variances), np.ones(3))) == 3


def test_coordinates_from_columns_do_not_depend_on_the_unit() -> None:
    """A coordinate with samples of its own counts with their noise, in metres and in millimetres."""
    t, noise = np.arange(0.0, 6.0, 0.02), 1e-3 * np.random.default_rng(3).standard_normal((300, 3))
    cart, angle = 0.3 * np.cos(2.2 * t), 0.7 * np.sin(3.1 * t)
    exact = np.column_stack([cart, cart + 0.4 * np.sin(angle), 0.4 * np.cos(angle)])
    found = []
    for unit in (1.0, 1000.0):
        data = la.Trajectory(t, unit * (exact + noise), coordinates=["x", "u", "v"])
        measure = [f"u = x + {{l={0.4 * unit}}}*sin(theta)", "v = {l}*cos(theta)"]
        library = la.Library(["x_dot**2", "theta_dot**2"], ["x", "theta"], angles=["theta"])
        found.append(from_columns(la.Trajectories([data]), measure, library, (), None, 5, {}, True))
        assert found[-1].sensors.direct_std == pytest.approx([unit * 1e-3, 1.0], rel=0.1)
    metres, millimetres = (calibrated.trajectories[0].q for calibrated in found)
    assert np.all(np.abs(millimetres - metres * [1000.0, 1.0]) < [0.02, 5e-5])  # a fiftieth of the noise


# ---------------------------------------------------------------- results
def test_a_filmed_pendulum_gives_its_law_and_the_camera(tmp_path) -> None:
    model = la.discover(filmed(1.0), LIBRARY, GIVEN, measure=CAMERA)
    assert model.fit.status == "ok"
    found = model.terms[1]
    assert abs(found.coefficient - STIFFNESS) < 4.0 * found.standard_error
    assert np.all(np.abs(deviations(model, TRUTH)) < 4.0)
    assert np.allclose(model.calibration.noise_std, 1.0, atol=0.15)
    assert "{tilt}" in model.format_table()
    model.save(tmp_path / "model.json")
    again = la.load(tmp_path / "model.json")
    q = np.linspace(-0.5, 0.5, 5)[:, None]
    assert np.array_equal(again.calibration.evaluate(q), model.calibration.evaluate(q))
    assert np.allclose(model.calibration.evaluate(q), np.column_stack(pixels(q[:, 0])), atol=1.0)
    assert len(model.calibration.covariance) == 1 + 4


@pytest.mark.thorough
def test_a_film_that_was_held_out_is_forecast_in_pixels(tmp_path) -> None:
    """Within its noise, and 95 % inside the bands; with one column too, although a sine has two angles."""
    model = la.discover(filmed(1.0), LIBRARY, GIVEN, measure=CAMERA)
    other = filmed(1.0, amplitudes=(0.7,), seed=5)
    result = model.validate(other)
    assert result.coordinates == ("u", "v")
    assert np.all(result.rms < 1.1 * result.expected_rms)
    assert np.all((result.coverage > 0.9) & (result.coverage < 0.99))
    one = la.Trajectories([run.changed(q=run.q * [1.0, np.nan]) for run in other])
    alone = model.validate(one)
    assert alone.coordinates == ("u",)
    assert np.all(alone.rms < 1.1 * alone.expected_rms)
    la.write_report(model, tmp_path / "report.html", validation=result)
    with pytest.raises(InputError, match=r"the model has theta, u, v"):
        model.validate(la.Trajectories([la.Trajectory(r.t, r.q[:, :1], coordinates=["w"]) for r in other]))


@pytest.mark.parametrize("terms", [["theta**2"], ["theta**2", "theta"]])
def test_films_of_a_law_that_is_not_offered_are_doubtful(terms) -> None:
    """Three films and more: groups of trials, which are tested elsewhere, have no measurement functions."""
    films = filmed(1.0, seconds=4.0, amplitudes=(1.5, 1.0, 0.5, 1.2))
    library = la.Library(["theta_dot**2", *terms], ["theta"], angles=["theta"])
    model = la.discover(films, library, GIVEN, measure=CAMERA)
    assert model.fit.status == "doubtful"


def test_without_noise_everything_is_recovered() -> None:
    model = la.discover(filmed(0.0, seconds=4.0), LIBRARY, GIVEN, measure=CAMERA)
    assert model.terms[1].coefficient == pytest.approx(STIFFNESS, rel=1e-4)
    values = {n.name: n.value for n in model.calibration.numbers}
    assert values == pytest.approx(TRUTH, rel=1e-4)


def test_the_identity_gives_the_model_of_the_column_itself() -> None:
    data = recorded(lambda q, *_: (q,), ["theta"], 0.01)
    plain = la.discover(data, LIBRARY, GIVEN)
    columns = la.Trajectories([run.changed(coordinates=("y",)) for run in data])
    seen = la.discover(columns, LIBRARY, GIVEN, measure=["y = theta"])
    a, b = plain.terms[1], seen.terms[1]
    assert abs(a.coefficient - b.coefficient) < 0.1 * a.standard_error
    assert b.standard_error == pytest.approx(a.standard_error, rel=0.05)
    assert seen.fit.status == plain.fit.status == "ok"


@pytest.mark.thorough
def test_numbers_that_only_their_product_shows_are_open() -> None:
    measure = [text.replace("{a}", "{s}*{l}") for text in CAMERA]
    model = la.discover(filmed(1.0, seconds=3.0), LIBRARY, GIVEN, measure=measure)
    open_numbers = {f.subject[0] for f in model.fit.findings if f.code == "calibration-open"}
    assert open_numbers == {"s", "l"}
    assert model.fit.status == "doubtful"


@pytest.mark.thorough
def test_a_wrong_function_is_not_ok() -> None:
    measure = ["u = {u0} + {a}*theta", "v = {v0} + {b}*theta**2"]  # for small angles only
    model = la.discover(filmed(1.0, seconds=4.0), LIBRARY, GIVEN, measure=measure)
    assert model.fit.status != "ok"


def test_a_gyroscope_alone_gives_law_gain_and_bias() -> None:
    data = recorded(lambda q, v, w: (1.03 * v + 0.02,), ["g"], 0.02, seconds=10.0, amplitudes=(0.9, 0.5, 1.2))
    model = la.discover(data, LIBRARY, GIVEN, measure=["g = {k}*theta_dot + {b}"])
    assert model.fit.status == "ok"
    assert abs(model.terms[1].coefficient - STIFFNESS) < 4.0 * model.terms[1].standard_error
    assert np.all(np.abs(deviations(model, {"k": 1.03, "b": 0.02})) < 4.0)


@pytest.mark.thorough
def test_an_accelerometer_with_a_gyroscope_gives_its_place() -> None:
    def board(q, v, w):
        return 0.3 * w + 9.81 * np.sin(q) + 0.05, 0.3 * v**2 + 9.81 * np.cos(q) + 0.03, v + 0.01

    data = recorded(board, ["at", "ar", "g"], [0.05, 0.05, 0.02], 10.0, (0.9, 0.5, 1.2))
    measure = la.measure.imu("theta", tangential="at", radial="ar", gyroscope="g")
    model = la.discover(data, LIBRARY, GIVEN, measure=measure)
    assert model.fit.status == "ok"
    truth = {"r": 0.3, "at_bias": 0.05, "ar_bias": 0.03, "g_bias": 0.01}
    assert np.all(np.abs(deviations(model, truth)) < 4.0)


WIDE, HIGH = 800, 600  # pixels of the picture


def seen_by(camera: dict[str, float], angles: np.ndarray) -> np.ndarray:
    """Pixels of the ends of links in a row, by a plane's homography and Brown's first radial term."""
    turned = angles + camera["tilt"]
    lengths = [camera[f"l{k}"] for k in range(1, angles.shape[1] + 1)]
    across, down = (np.cumsum(lengths * wave(turned), axis=1) for wave in (np.sin, np.cos))
    rows = np.array(
        [
            [1.0, 0.0, camera["x0"]],
            [camera.get("shear", 0.0), camera.get("stretch", 1.0), camera["y0"]],
            [camera.get("px", 0.0) / (WIDE / 2), camera.get("py", 0.0) / (WIDE / 2), 1.0],
        ]
    )
    rows[:2, :2] += np.outer([camera["x0"], camera["y0"]], rows[2, :2])
    places = np.stack([across, down, np.ones_like(down)], axis=-1) @ rows.T
    middle = np.array([WIDE / 2, HIGH / 2])
    from_middle = places[..., :2] / places[..., 2:] - middle
    share = np.sum(from_middle**2, axis=-1, keepdims=True) / (WIDE / 2) ** 2
    bent = from_middle * (1.0 + camera.get("bend", 0.0) * share)
    return (bent + middle).reshape(len(angles), -1)


FACING = {"x0": 410.0, "y0": 300.0, "l1": 180.0, "l2": 150.0, "tilt": 0.6}
INCLINED = {"px": 0.3, "py": 0.06, "stretch": 1.04, "shear": -0.03, "bend": -0.1}


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("truth", "options"),
    [
        (FACING, {}),
        (
            FACING | INCLINED | {"y0": 180.0, "l1": 140.0, "l2": 110.0, "tilt": -0.2},
            {"picture": (WIDE, HIGH), "perspective": True, "lens": True},
        ),
    ],
    ids=["facing", "inclined, with a lens"],
)
def test_a_filmed_double_pendulum_gives_its_law_and_the_camera(seed, truth, options) -> None:
    pendulum = systems.get("chaotic_pendulum")
    rng = np.random.default_rng(100 + seed)
    runs = []
    for motion in systems.simulate_truth(pendulum, trials=3, duration=8.0, rate=60.0, seed=seed):
        exact = seen_by(truth, motion.q)
        noisy = exact + rng.standard_normal(exact.shape)
        runs.append(la.Trajectory(motion.t, noisy, coordinates=["u1", "v1", "u2", "v2"]))
    library = la.Library(list(pendulum.lagrangian), pendulum.coordinates, angles=pendulum.angles)
    measure = la.measure.camera(pendulum.coordinates, [("u1", "v1"), ("u2", "v2")], **options)
    model = la.discover(runs, library, pendulum.known, measure=measure)
    assert model.fit.status == "ok"
    for term in model.terms:
        if not term.known:
            exact = pendulum.lagrangian[term.expression]
            assert abs(term.coefficient - exact) < 4.0 * term.standard_error
    assert {number.name for number in model.calibration.numbers} == truth.keys()
    assert np.all(np.abs(deviations(model, truth)) < 4.0)


def test_a_camera_is_the_projection_of_a_plane() -> None:
    truth = FACING | INCLINED
    angles = np.array([[0.3, -0.4], [1.2, 2.0], [-2.5, 0.1]])
    options = {"picture": (WIDE, HIGH), "perspective": True, "lens": True}
    texts = la.measure.camera(["a", "b"], [("u1", "v1"), ("u2", "v2")], **options)
    functions = SensorFunctions.parse(texts, ["a", "b"])
    states = np.stack([angles, 0.0 * angles, 0.0 * angles])
    numbers = np.array([truth[name] for name in functions.names])
    found = functions.values(states, np.zeros(3), numbers)
    assert np.allclose(found.T, seen_by(truth, angles), rtol=1e-12)


@pytest.mark.parametrize(
    ("picture", "reason"),
    [
        (None, r"give picture=\(width, height\)"),
        ((800,), "a width and a height"),
        ((800, 0), "both positive"),
        ((800, float("nan")), "both positive"),
    ],
)
def test_a_camera_refuses_a_picture_without_a_size(picture, reason) -> None:
    with pytest.raises(InputError, match=reason):
        la.measure.camera(["theta"], [("u", "v")], picture=picture, lens=True)


# ---------------------------------------------------------------- linkages
TIMES = np.linspace(0.0, 8.0, 800)
SWING, OTHER, SLIDE = 0.8 * np.sin(3.0 * TIMES), 1.1 * np.sin(4.1 * TIMES + 0.4), 0.3 * np.cos(2.2 * TIMES)


def end_of(angle, length: float):
    """From the pivot to the end of a link, as a complex number: right, and down."""
    return length * (np.sin(angle) + 1j * np.cos(angle))


def rocker(crank):
    """The far joint of a four-bar linkage about pivots 0 and 0.9, by its two rods of 0.8 and 0.7."""
    away = 0.9 - crank
    middle = crank + away * (0.5 + (0.8**2 - 0.7**2) / (2.0 * abs(away) ** 2))
    return middle + 1j * away / abs(away) * np.sqrt(0.8**2 - abs(middle - crank) ** 2)


def on_line(pin, length: float, height: float, slope: float):
    """The slider on y = height + slope x at the end of a rod from a pin."""
    across = pin.imag - height - slope * pin.real
    square = 1.0 + slope**2
    x = pin.real + (slope * across + np.sqrt(square * length**2 - across**2)) / square
    return x + 1j * (height + slope * x)


CRANK = end_of(2.0 * TIMES - 8.0, 0.3)
LINKAGES = {
    "double pendulum": (
        [0.3 + end_of(SWING, 0.5), 0.3 + end_of(SWING, 0.5) + end_of(OTHER, 0.4)],
        {"theta": SWING, "theta2": OTHER},
        ["turns", "turns"],
    ),
    "marks on one link": (
        [end_of(SWING, 0.5), end_of(SWING + 0.2, 0.8), end_of(SWING, 0.3)],
        {"theta": SWING},
        ["turns", "turns with", "turns with"],
    ),
    "cart, mark beside the pivot": (
        [SLIDE + 0.2j, SLIDE + 0.1 + 0.3j + end_of(OTHER, 0.4)],
        {"x0": SLIDE, "theta": OTHER},
        ["slides", "turns"],
    ),
    "inclined slider": (
        [SLIDE * (1.0 + 0.5j) + 0.2j, SLIDE * (1.0 + 0.5j) + 0.2j + end_of(OTHER, 0.4)],
        {"x0": SLIDE, "theta": OTHER},
        ["slides", "turns"],
    ),
    "four-bar linkage": (
        [CRANK, rocker(CRANK)],
        {"theta": 2.0 * TIMES - 8.0},
        ["turns", "closes"],
    ),
    "slider-crank": (
        [CRANK, on_line(CRANK, 0.8, 0.05, 0.0)],
        {"theta": 2.0 * TIMES - 8.0},
        ["turns", "slides"],
    ),
    "slider before its crank": (
        [on_line(CRANK, 0.8, 0.1, 0.5), CRANK],
        {"theta": 2.0 * TIMES - 8.0},
        ["turns", "slides"],
    ),
    "two carts on a track": (
        [SLIDE + 0.2j, 0.7 * SWING + 0.2j],
        {"x0": SLIDE, "x1": 0.7 * SWING},
        ["slides", "slides"],
    ),
    "two marks on a cart": (
        [SLIDE + 0.2j, SLIDE + 0.1 + 0.5j],
        {"x0": SLIDE},
        ["slides", "slides"],
    ),
    "rod that flies": (
        [SLIDE + 1j * SWING, SLIDE + 1j * SWING + end_of(OTHER, 0.4)],
        {"x0": SLIDE, "y0": SWING, "theta": OTHER},
        ["turns"],
    ),
    "support": ([0.1 + 0.0j * SWING, 0.1 + end_of(SWING, 0.5)], {"theta": SWING}, ["fixed", "turns"]),
}


@pytest.mark.parametrize("name", LINKAGES)
def test_a_linkage_is_found_and_its_functions_give_the_tracks(name) -> None:
    points, motion, kinds = LINKAGES[name]
    noise, rng = 1e-3, np.random.default_rng(2)
    exact = np.column_stack([part for p in points for part in (p.real, p.imag)])
    names = [f"{axis}{k}" for k in range(len(points)) for axis in "xy"]
    run = la.Trajectory(TIMES, exact + noise * rng.standard_normal(exact.shape), coordinates=names)
    found = la.measure.linkage(run, [(f"x{k}", f"y{k}") for k in range(len(points))])
    assert [constraint.kind for constraint in found.constraints] == kinds
    assert all(0.7 < constraint.deviation < 1.5 for constraint in found.constraints)
    assert set(found.coordinates) == set(motion)
    assert found.loops == 0
    if not found.measure:
        return
    functions = SensorFunctions.parse(found.measure, found.coordinates)
    assert {*functions.columns, *found.coordinates, *found.constant} >= set(names)
    q = np.column_stack([motion[c] for c in found.coordinates])
    numbers = np.array([functions.starts[n] for n in functions.names])
    seen = functions.values(np.stack([q, 0.0 * q, 0.0 * q]), TIMES, numbers)
    there = np.array([names.index(column) for column in functions.columns])
    assert np.abs(seen - exact.T[there]).max() < 5.0 * noise


def test_noise_does_not_bias_a_radius() -> None:
    """The radius of the best algebraic circle is too small by noise² / arc², unless corrected."""
    rng, noise = np.random.default_rng(0), 0.05
    angle = rng.uniform(-0.6, 0.6, 40_000)
    track = np.column_stack([np.sin(angle), np.cos(angle)]) + noise * rng.standard_normal((angle.size, 2))
    design = np.column_stack([track, np.ones(angle.size)])
    a, b, c = np.linalg.lstsq(design, (track**2).sum(axis=1), rcond=None)[0]
    assert np.sqrt(c + (a**2 + b**2) / 4.0) < 0.9
    found = circle_of((), track, np.full(2, noise**2), given=False)
    assert found.radius == pytest.approx(1.0, abs=0.03)
    assert found.excess == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ([], "empty"),
        ([("u",)], "two"),
        ([("u", "w")], "not a column"),
        ([("u", "u")], "twice"),
    ],
)
def test_bodies_that_are_no_pairs_of_columns_are_refused(bodies, message) -> None:
    with pytest.raises(InputError, match=message):
        la.measure.linkage(filmed(1.0, seconds=1.0), bodies)
