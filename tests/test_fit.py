"""The joint fit against dense brute force, finite differences, and problems with known answers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.optimize
from scipy.interpolate import BSpline

from helpers import euler_lagrange, finite_difference, interpolate, record, uniform_grid
from leastaction._euler_lagrange import EulerLagrange, Points
from leastaction._fit import problem as problem_module
from leastaction._fit.evidence import Start, evidence, fit_weights
from leastaction._fit.gauss_newton import condense, factorise, fit_joint, logdet, score_candidates
from leastaction._fit.problem import Observations, Physics, Weights, linearise
from leastaction._fit.workspace import Workspace
from leastaction._spline import SplineGrid

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

    @property
    def observations(self) -> Observations:
        return Observations(self.grid, self.times, self.values)

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
            scaled = (y - spline(t)) / self.weights.noise_std
            out.append(scaled[np.isfinite(y)])
            mine = self.grid.owner == k
            x = self.grid.points[mine].ravel()
            strong = self.physics.columns.strong(Points(*(spline(x, nu=nu) for nu in range(3))))
            r = np.tensordot(coefficients, strong, 1)
            if self.physics.forces is not None:
                r = r - self.physics.forces[mine].reshape(-1, r.shape[0]).T
            out.append((np.sqrt(self.weights.physics[:, None] * self.grid.weights[mine].ravel()) * r).ravel())
        return np.concatenate(out)

    def volume(self, z: np.ndarray) -> float:
        """2 slack · mean over the knot intervals of log |det M|, at their middle."""
        control, coefficients = self.split(z)
        states = []
        for k, space in enumerate(self.grid.spaces):
            x = self.grid.points[self.grid.owner == k]
            x = x[:, x.shape[1] // 2]
            spline = BSpline(space.knots, self.grid.split(control)[k], space.degree)
            states.append([spline(x), spline(x, nu=1)])
        points = Points(*(np.concatenate(s) for s in zip(*states, strict=True)))
        mass = self.physics.columns.mass_matrix(points, coefficients)
        return float(2.0 * self.weights.slack.mean() * np.mean(np.linalg.slogdet(mass)[1]))

    def dense(self) -> tuple[np.ndarray, np.ndarray]:
        """Half gradient and Gauss–Newton matrix by finite differences."""
        jacobian = finite_difference(self.residuals, self.here, 1e-3)
        return jacobian.T @ self.residuals(self.here), jacobian.T @ jacobian

    def linearise(self):
        return linearise(self.observations, self.physics, self.weights, self.control, self.coefficients)


def tiny(
    degree: int = 3, n_quadrature: int = 3, slack: float = 0.0, forced: bool = True, seed: int = 0
) -> Tiny:
    rng = np.random.default_rng(seed)
    columns = euler_lagrange(LAGRANGIAN, COORDINATES, DISSIPATION)
    grid = uniform_grid([1.0, 0.8], 5.0, degree, n_quadrature)
    times = [np.sort(rng.uniform(0.0, d, 30)) for d in (1.0, 0.8)]
    values = [curve(t) + 0.02 * rng.standard_normal((t.size, 2)) for t in times]
    values[0][3:6, 1] = np.nan
    values[1][10, 0] = np.nan
    free = np.array([term.text != KNOWN for term in columns.terms])
    forces = rng.standard_normal((grid.n_intervals, n_quadrature, 2)) if forced else None
    control = interpolate(grid, [curve, curve]) + 0.01 * rng.standard_normal((grid.n_ctrl, 2))
    truth = np.array([*LAGRANGIAN.values(), *DISSIPATION.values()])
    coefficients = truth * np.where(free, rng.uniform(0.9, 1.1, truth.size), 1.0)
    weights = Weights(np.array([0.02, 0.03]), np.array([4.0, 9.0]), np.full(2, slack))
    return Tiny(grid, times, values, Physics(columns, free, forces), weights, control, coefficients)


# --------------------------------------------------------------------------- normal equations
@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("n_quadrature", [2, 3])
@pytest.mark.parametrize("forced", [True, False])
def test_cost_gradient_and_matrix_equal_brute_force(degree, n_quadrature, forced):
    case = tiny(degree, n_quadrature, forced=forced)
    normal = case.linearise()
    residuals = case.residuals(case.here)
    assert normal.cost == pytest.approx(residuals @ residuals, rel=1e-12)
    assert normal.misfit == normal.cost
    gradient, matrix = case.dense()
    n = case.control.size
    np.testing.assert_allclose(
        normal.gradient_curve, gradient[:n], rtol=1e-6, atol=1e-8 * np.abs(gradient).max()
    )
    np.testing.assert_allclose(normal.gradient_coefficients, gradient[n:], rtol=1e-6)
    scale = np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
    factor = np.tril(dense_factor(case, normal))
    np.testing.assert_allclose(
        factor @ factor.T / scale[:n, :n], matrix[:n, :n] / scale[:n, :n], rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(
        normal.border / scale[:n, n:], matrix[:n, n:] / scale[:n, n:], rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(
        normal.corner / scale[n:, n:], matrix[n:, n:] / scale[n:, n:], rtol=0, atol=1e-8
    )


def dense_factor(case: Tiny, normal) -> np.ndarray:
    """Lower triangular R of H = R Rᵀ from its banded storage."""
    banded = factorise(case.observations, normal, case.weights)
    n = banded.shape[1]
    return sum(np.diag(banded[k, : n - k], -k) for k in range(min(len(banded), n)))


def test_gradient_is_that_of_the_cost():
    case = tiny(5, 3)
    normal = case.linearise()

    def half_cost(z):
        return 0.5 * np.sum(case.residuals(z) ** 2)

    expected = finite_difference(half_cost, case.here, 1e-4)
    found = np.concatenate([normal.gradient_curve, normal.gradient_coefficients])
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())


def test_volume_term_and_its_gradient_in_the_coefficients():
    case = tiny(5, 3, slack=11.0)
    normal = case.linearise()
    residuals = case.residuals(case.here)
    assert normal.misfit == pytest.approx(residuals @ residuals, rel=1e-12)
    assert normal.cost == pytest.approx(residuals @ residuals - case.volume(case.here), rel=1e-12)

    def half_cost(z):
        return 0.5 * (np.sum(case.residuals(z) ** 2) - case.volume(z))

    n = case.control.size
    expected = finite_difference(half_cost, case.here, 1e-4)[n:]
    np.testing.assert_allclose(normal.gradient_coefficients, expected, rtol=1e-6)


def test_volume_curvature_is_that_of_the_cost():
    """log |det M| is concave in the coefficients: its second derivative joins the corner as it is."""
    with_, without = (tiny(5, 3, slack=s) for s in (11.0, 0.0))
    n = with_.control.size

    def half_volume(coefficients):
        return -0.5 * with_.volume(np.concatenate([with_.control.ravel(), coefficients]))

    def gradient(coefficients):
        return finite_difference(half_volume, coefficients, 1e-3)

    expected = finite_difference(gradient, with_.here[n:], 1e-3)
    found = with_.linearise().corner - without.linearise().corner
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def test_schur_complement_covariance_and_determinant_equal_dense():
    case = tiny(5, 3)
    normal = case.linearise()
    _, matrix = case.dense()
    n = case.control.size
    quadratic = condense(case.observations, normal, case.weights)
    schur = matrix[n:, n:] - matrix[n:, :n] @ np.linalg.solve(matrix[:n, :n], matrix[:n, n:])
    np.testing.assert_allclose(quadratic.matrix, schur, rtol=1e-5, atol=1e-6 * np.abs(schur).max())
    assert quadratic.logdet == pytest.approx(np.linalg.slogdet(matrix[:n, :n])[1], abs=1e-6)
    assert logdet(factorise(case.observations, normal, case.weights)) == pytest.approx(
        quadratic.logdet, abs=1e-9
    )
    newton = np.linalg.solve(matrix, case.dense()[0])
    delta = np.linalg.solve(quadratic.matrix, quadratic.gradient)
    np.testing.assert_allclose(delta, newton[n:], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(
        quadratic.curve_shift - quadratic.curve_response @ delta,
        newton[:n],
        rtol=1e-4,
        atol=1e-5 * np.abs(newton[:n]).max(),
    )


def test_long_recordings_are_assembled_in_chunks(monkeypatch):
    case = tiny(5, 2, slack=3.0)
    at_once = case.linearise()
    monkeypatch.setattr(problem_module, "_CHUNK", 4)
    in_chunks = case.linearise()
    for name in (
        "equation_bands",
        "border",
        "corner",
        "gradient_curve",
        "gradient_coefficients",
        "equation",
        "volume",
    ):
        a, b = getattr(at_once, name), getattr(in_chunks, name)
        np.testing.assert_allclose(b, a, rtol=1e-10, atol=1e-10 * np.abs(a).max(), err_msg=name)
    assert in_chunks.cost == pytest.approx(at_once.cost, rel=1e-12)


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
@pytest.mark.parametrize("seed", [0, 1])
def test_fit_finds_the_minimum_that_dense_least_squares_finds(seed):
    case = tiny(5, 3, seed=seed)
    fit = fit_joint(
        case.observations, case.physics, case.weights, case.control, case.coefficients, tolerance=1e-9
    )
    assert fit.converged, fit.status
    dense = scipy.optimize.least_squares(
        case.residuals, case.here, method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12
    )
    control, coefficients = case.split(dense.x)
    assert fit.cost == pytest.approx(2.0 * dense.cost, rel=1e-6)
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
    assert other.cost == pytest.approx(plain.cost, rel=1e-8)
    spread, scale = np.sqrt(np.diag(plain.covariance)), units[case.physics.free]
    np.testing.assert_allclose(
        (other.coefficients * units - plain.coefficients)[case.physics.free] / spread, 0, atol=1e-3
    )
    np.testing.assert_allclose(np.sqrt(np.diag(other.covariance)) * scale, spread, rtol=1e-3)


# ----------------------------------------------------------------------------------- evidence
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


def restricted_likelihood(grid, times, values, operator, noise, weight) -> float:
    """Log marginal likelihood of one coordinate by dense algebra on the covariance of the data.

    The curve has the improper Gaussian prior exp(−½ w ∫ (operator applied to it)² dt); its two directions
    without a penalty (initial position and rate of each trajectory) are projected out.
    """
    design = grid.design(times).toarray()
    y = np.concatenate(values)[:, 0]
    n_null = 2 * len(grid.spaces)
    basis = [np.zeros((grid.points.size, grid.n_ctrl)) for _ in range(3)]
    for k, space in enumerate(grid.spaces):
        rows = np.flatnonzero(np.repeat(grid.owner == k, grid.points.shape[1]))
        for nu in range(3):
            block = BSpline(space.knots, np.eye(space.n_ctrl), space.degree)(grid.points.ravel()[rows], nu=nu)
            basis[nu][rows, grid.offsets[k] : grid.offsets[k + 1]] = block
    residual = sum(c * b for c, b in zip(operator, basis, strict=True))
    penalty = residual.T @ (grid.weights.ravel()[:, None] * residual)
    values_, vectors = np.linalg.eigh(penalty)
    root = design @ vectors[:, n_null:] / np.sqrt(values_[n_null:])
    null = design @ vectors[:, :n_null]
    covariance = noise**2 * np.eye(y.size) + root @ root.T / weight
    inverse = np.linalg.inv(covariance)
    information = null.T @ inverse @ null
    projected = inverse - inverse @ null @ np.linalg.solve(information, null.T @ inverse)
    return -0.5 * (y @ projected @ y + np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1])


def held_fit(grid, times, values, noise, weight, scale=1.0):
    """Curve of the oscillator with its true coefficients held."""
    physics, coefficients = oscillator_physics(scale)
    held = Physics(physics.columns, np.zeros(3, dtype=bool), None)
    observations = Observations(grid, times, values)
    weights = Weights(np.array([noise]), np.array([weight]), np.zeros(1))
    fit = fit_joint(observations, held, weights, np.zeros((grid.n_ctrl, 1)), coefficients, tolerance=1e-8)
    return observations, fit


def test_evidence_equals_the_marginal_likelihood():
    """The problem is linear in the curve, so Laplace's approximation is exact: differences must agree."""
    times, values = oscillator(np.random.default_rng(0), duration=3.0, rate=20.0, spectral_density=0.02)
    grid = uniform_grid([3.0, 3.0], 6.0, 5, 3)
    cases = [(0.05, 30.0), (0.05, 300.0), (0.08, 30.0), (0.03, 5.0)]
    found, expected = [], []
    for noise, weight in cases:
        observations, fit = held_fit(grid, times, values, noise, weight)
        found.append(evidence(observations, fit))
        expected.append(restricted_likelihood(grid, times, values, (4.0, 0.4, 1.0), noise, weight))
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-4, atol=1e-2)


def test_evidence_equals_dense_determinants_with_two_coordinates():
    case = tiny(5, 3)
    fit = fit_joint(
        case.observations, case.physics, case.weights, case.control, case.coefficients, tolerance=1e-9
    )
    z = np.concatenate([fit.control_points.ravel(), fit.coefficients[case.physics.free]])
    jacobian = finite_difference(case.residuals, z, 1e-3)[:, : case.control.size]
    sigma, w = case.weights.noise_std, case.weights.physics
    assert fit.logdet == pytest.approx(np.linalg.slogdet(jacobian.T @ jacobian)[1], abs=1e-5)
    # derivatives in the weights at a fixed curve show every exponent of the formula
    rank = case.grid.n_ctrl - 2 * len(case.grid.spaces)
    value = evidence(case.observations, fit)
    rest = value + 0.5 * fit.misfit + 0.5 * fit.logdet + case.observations.counts @ np.log(sigma)
    assert rest == pytest.approx(rank * (0.5 * np.log(w).sum() + fit.log_volume), rel=1e-10, abs=1e-8)


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


# ---------------------------------------------------------------------------------- workspace
def duffing(noise: float, rate: float = 60.0, seed: int = 0):
    """ẍ = −x − 0.8 x³."""
    starts = [([1.2], [0.0]), ([0.4], [1.5])]
    return record(
        lambda q, v, f: -q - 0.8 * q**3, starts, ["x"], duration=6.0, rate=rate, noise=noise, seed=seed
    )


DUFFING = ("x_dot**2", "x**2", "x**4")
DUFFING_TRUTH = np.array([0.5, -0.5, -0.2])


def duffing_workspace(noise, knots_per_second, *extra, degree=5, seed=0):
    columns = euler_lagrange([*DUFFING, *extra], ["x"])
    known = np.full(len(columns), np.nan)
    known[0] = 0.5
    workspace = Workspace(duffing(noise, seed=seed), columns, known, knots_per_second, degree)
    t = [trajectory.t for trajectory in workspace.trajectories]
    y = [trajectory.q for trajectory in workspace.trajectories]
    control = interpolate(
        workspace.grid, [lambda x, k=k: np.interp(x, t[k], y[k][:, 0])[:, None] for k in range(2)]
    )
    coefficients = np.zeros(len(columns))
    coefficients[:3] = DUFFING_TRUTH
    return workspace, workspace.start((1, 2), control, coefficients, np.array([max(noise, 1e-6)]))


@pytest.mark.parametrize(("degree", "order"), [(3, 1.8), (5, 3.5)])
def test_coefficients_converge_in_the_knot_spacing(degree, order):
    """Noise-free data: the error that knots leave falls with a power of their spacing."""
    errors = []
    for knots in (3.0, 6.0, 12.0):
        workspace, start = duffing_workspace(0.0, knots, degree=degree)
        structure = workspace.fit((1, 2), start)
        assert structure.fit.converged
        errors.append(np.abs(structure.coefficients - DUFFING_TRUTH).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 2e-3
    assert orders.mean() > order, (errors, orders)


def test_standard_errors_cover_the_truth():
    """z values over 24 noise seeds: about normal with unit spread."""
    z = []
    for seed in range(24):
        workspace, start = duffing_workspace(0.03, 8.0, seed=seed)
        structure = workspace.fit((1, 2), start)
        z.append((structure.estimates - DUFFING_TRUTH[1:]) / structure.standard_errors)
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((rms > 0.6) & (rms < 1.45)), rms
    assert np.abs(np.mean(z, axis=0)).max() < 0.7


def test_score_predicts_the_gain_of_a_candidate():
    """The quadratic model at a fit foretells the cost of the refit with one term more."""
    workspace, start = duffing_workspace(0.03, 8.0, "x**6", "cos(x)")
    structure = workspace.fit((1, 2), start)
    quadratic = workspace.score(structure)
    # free columns: x², x⁴, x⁶, cos x; members are at their minimum
    spread = 1.0 / np.sqrt(np.diag(quadratic.matrix))
    assert np.abs(quadratic.gradient[:2] * spread[:2]).max() < 0.15
    index = [0, 1, 2]
    step = np.linalg.solve(quadratic.matrix[np.ix_(index, index)], quadratic.gradient[index])
    predicted = quadratic.gradient[index] @ step
    physics, columns = workspace.physics((1, 2, 3))
    fit = structure.fit
    larger = fit_joint(
        workspace.observations,
        physics,
        fit.weights,
        fit.control_points,
        structure.coefficients[columns],
        tolerance=1e-5,
    )
    # the volume term has one more degree of freedom than the model sees: compare the whole cost
    assert fit.cost - larger.cost == pytest.approx(predicted, rel=0.1, abs=0.05)
    free = np.array([1, 2, 3])
    change = larger.coefficients[:3] - structure.coefficients[free]
    np.testing.assert_allclose(change, -step, rtol=0.1, atol=0.1 * spread[:3].min())


def test_scores_of_members_agree_with_the_fit_itself():
    workspace, start = duffing_workspace(0.03, 8.0, "x**6")
    structure = workspace.fit((1, 2), start)
    physics, _ = workspace.physics((1, 2))
    own = score_candidates(workspace.observations, physics, structure.fit, workspace.columns.subset([1, 2]))
    everything = workspace.score(structure)
    np.testing.assert_allclose(everything.matrix[:2, :2], own.matrix, rtol=1e-9)
    np.testing.assert_allclose(everything.gradient[:2], own.gradient, rtol=1e-6, atol=1e-6)


def test_structure_keeps_known_and_leaves_out_what_is_not_a_member():
    workspace, start = duffing_workspace(0.03, 8.0, "x**6", "cos(x)")
    structure = workspace.fit((1, 2), start)
    assert structure.coefficients[0] == 0.5
    assert structure.coefficients[3:].tolist() == [0.0, 0.0]
    assert workspace.free.tolist() == [1, 2, 3, 4]
    assert structure.fit.covariance.shape == (2, 2)
    assert isinstance(workspace.columns, EulerLagrange)
