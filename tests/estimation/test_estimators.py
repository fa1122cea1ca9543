"""Weights of the default estimator, and estimators beside it: the paper's method (Adam), simulation error."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.interpolate import BSpline
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from helpers import (
    DUFFING_LIBRARY,
    DUFFING_TRUTH,
    KINETIC,
    duffing,
    euler_lagrange,
    findings_of,
    interpolate,
    pendulum,
    record,
    uniform_grid,
)
from leastaction import systems
from leastaction.curve import bspline
from leastaction.curve.bspline import SplineGrid, uniform_space
from leastaction.curve.smoothing import smooth
from leastaction.data.trajectories import Rate
from leastaction.estimation.adam import AdamProblem, descend
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.forces import forces_on
from leastaction.estimation.gauss_newton import fit_joint, score_candidates
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights, linearise
from leastaction.estimation.observations import Observations
from leastaction.estimation.problem import Structure
from leastaction.estimation.simulation_error import minimise_simulation_error
from leastaction.estimation.weights import (
    Start,
    _secant,
    evidence,
    fit_weights,
    start_weights,
    update_weights,
)
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.selection.search_state import Search, begin_search
from leastaction.selection.strategies.simulation_error import run
from leastaction.simulation.integrate import rk4

# ------------------- the paper's method: gradients against finite differences, its options, and what it finds
QUICK = {"iterations": 2000, "threshold_from": 800, "check_every": 200, "learning_rate_coefficients": 1e-2}


def problem(force=True, missing=False, **options) -> AdamProblem:
    """Two coupled coordinates on a coarse spline, with every kind of derivative in the equations."""
    rng = np.random.default_rng(0)
    times = [np.linspace(0.0, 2.0, 41), np.linspace(1.0, 2.5, 31)]
    values = [rng.standard_normal((t.size, 2)) for t in times]
    if missing:
        values[0][5:9, 1] = np.nan
    library = la.Library(["a_dot**2", "b_dot**2", "a_dot*b_dot*cos(a-b)", "cos(a)", "a**2*b"], ["a", "b"])
    physics = Physics(
        EulerLagrange(library.terms, ("a", "b")), np.array([True, True, True, True, False]), None
    )
    grid = SplineGrid([uniform_space(t[0], t[-1], 4.0, 3) for t in times])
    push = (lambda k, t: np.column_stack([np.sin(t + k), np.cos(t)])) if force else None
    settings = la.AdamOptions(collocation=1.0, curvature_weight=0.02, physics_weight=0.3, **options)
    return AdamProblem(grid, times, values, physics, push, settings, rng)


def state(at: AdamProblem):
    rng = np.random.default_rng(1)
    return rng.standard_normal((at.grid.n_ctrl, 2)), rng.standard_normal(5)


@pytest.mark.parametrize(("force", "missing"), [(True, False), (False, True)])
def test_gradients_match_finite_differences(force, missing):
    at = problem(force, missing)
    points, values = state(at)
    everything = slice(0, at.n_collocation)
    _, by_point = at.data_part(points)
    _, more, by_value = at.equation_part(points, values, everything)
    by_point = by_point + more
    rng, h = np.random.default_rng(2), 1e-6
    for _ in range(5):
        dp, dv = rng.standard_normal(points.shape), rng.standard_normal(values.shape)
        ahead, behind = (at.loss(points + s * h * dp, values + s * h * dv) for s in (1, -1))
        predicted = np.sum(by_point * dp) + by_value @ dv
        assert (ahead - behind) / (2 * h) == pytest.approx(predicted, rel=1e-6)


def test_taylor_remainder_falls_with_the_square_of_the_step():
    at = problem()
    points, values = state(at)
    _, by_point = at.data_part(points)
    _, more, _ = at.equation_part(points, values, slice(0, at.n_collocation))
    direction = np.random.default_rng(3).standard_normal(points.shape)
    slope, here = np.sum((by_point + more) * direction), at.loss(points, values)
    remainders = [
        abs(at.loss(points + h * direction, values) - here - h * slope) for h in (1e-2, 5e-3, 2.5e-3)
    ]
    assert np.log2(remainders[0] / remainders[1]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(remainders[1] / remainders[2]) == pytest.approx(2.0, abs=0.1)


def test_regression_makes_the_gradient_vanish_and_leaves_known_coefficients():
    at = problem()
    points, values = state(at)
    best = at.regress(points, values)
    _, _, by_value = at.equation_part(points, best, slice(0, at.n_collocation))
    assert np.abs(by_value[:4]).max() < 1e-10
    assert best[4] == values[4]


def test_known_coefficients_and_pinned_ends_stay():
    at = problem(pin_ends=True, iterations=20, check_every=20)
    points, values = state(at)
    fit = descend(at, points, values, np.random.default_rng(0), lambda _: None)
    assert fit.coefficients[4] == values[4]
    ends = at.ends
    assert len(ends) == 4
    np.testing.assert_array_equal(fit.control_points[ends], points[ends])
    assert not np.array_equal(fit.control_points, points)


def test_thresholded_coefficients_stay_at_zero():
    at = problem(
        threshold=0.5, threshold_from=10, check_every=10, iterations=40, learning_rate_coefficients=1e-3
    )
    points, _ = state(at)
    start = np.array([2.0, 2.0, 0.1, 2.0, 1.0])
    seen: list[dict] = []
    fit = descend(at, points, start, np.random.default_rng(0), seen.append)
    assert fit.coefficients[2] == 0.0
    assert [s["terms"] for s in seen] == [3, 3, 3, 3]


def test_finds_the_law_without_noise():
    model = la.discover(duffing(noise=0.0), DUFFING_LIBRARY, KINETIC, method="adam", options=QUICK)
    found = {t.expression: t.coefficient for t in model.terms}
    assert set(found) == set(DUFFING_TRUTH)
    for name, value in DUFFING_TRUTH.items():
        assert found[name] == pytest.approx(value, rel=0.02)
    free = [t for t in model.terms if not t.known]
    assert all(np.isnan(t.standard_error) for t in free)


def test_finds_a_driven_pendulum_without_noise():
    library = ["theta_dot**2", "cos(theta)", "sin(theta)", "cos(2*theta)"]
    model = la.discover(pendulum(viscous=0.0, noise=0.0), library, method="adam", options=QUICK)
    found = {t.expression: t.coefficient for t in model.terms}
    assert set(found) == {"theta_dot**2", "cos(theta)"}
    assert found["cos(theta)"] == pytest.approx(9.81, rel=0.02)


def test_given_start():
    start = {"x_dot**2": 7.0, "x**2": -0.5, "x**4": -0.2}
    model = la.discover(
        duffing(noise=0.0), DUFFING_LIBRARY, KINETIC, method="adam",
        options={**QUICK, "iterations": 400, "threshold_from": 200, "start_coefficients": start},
    )  # fmt: skip
    assert {t.expression: t.coefficient for t in model.terms} == pytest.approx(DUFFING_TRUTH, rel=0.02)
    with pytest.raises(la.InputError, match="'y' is not a candidate"):
        la.discover(
            duffing(), DUFFING_LIBRARY, KINETIC, method="adam", options={"start_coefficients": {"y": 1.0}}
        )


def test_same_seed_same_answer():
    data = record(lambda q, v, f: -q, [([1.0], [0.0])], ["x"], duration=6.0, noise=0.01)
    short = {**QUICK, "iterations": 200, "check_every": 100, "threshold_from": 100}
    models = [
        la.discover(data, ["x_dot**2", "x**2"], KINETIC, method="adam", options=short, seed=s)
        for s in (1, 1, 2)
    ]
    values = [[t.coefficient for t in m.terms] for m in models]
    assert values[0] == values[1] != values[2]


@pytest.mark.parametrize("check_every", [50, 1000])  # the last iteration is checked in any case
def test_a_descent_that_was_cut_short_is_doubtful(check_every):
    short = {"iterations": 100, "check_every": check_every, "threshold": 0.0}
    model = la.discover(duffing(), DUFFING_LIBRARY, KINETIC, method="adam", options=short)
    assert model.fit.status == "doubtful"
    assert findings_of(model, "not-converged")


def test_model_without_standard_errors_can_be_saved_shown_and_reported(tmp_path):
    short = {"iterations": 200, "check_every": 100, "threshold": 0.0}
    model = la.discover(duffing(), DUFFING_LIBRARY[:4], KINETIC, method="adam", options=short)
    model.save(tmp_path / "m.json")
    again = la.load(tmp_path / "m.json")
    assert [t.coefficient for t in again.terms] == [t.coefficient for t in model.terms]
    assert again.table().shape == model.table().shape
    la.write_report(model, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "NaN" not in text
    assert ">nan<" not in text
    assert json.loads((tmp_path / "m.json").read_text())["provenance"]["options"]["adam"]["iterations"] == 200


def test_threshold_above_every_coefficient_is_explained():
    with pytest.raises(la.DataError, match=r"below the threshold 1000.*lower"):
        la.discover(
            pendulum(), ["theta_dot**2", "cos(theta)"], method="adam",
            options={"threshold": 1000.0, "threshold_from": 1, "check_every": 10, "iterations": 50},
        )  # fmt: skip


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": 1}, "option 'speed' is unknown.*learning_rate_curve"),
        ({"threshold": -1.0}, "threshold is -1.0"),
        ({"iterations": 0}, "iterations is 0"),
        ({"iterations": 2.5}, "whole number"),
        ({"batch": True}, "batch is True"),
        ({"start_curve": "straight"}, "start_curve is 'straight'.*smooth"),
        ({"physics_weight": float("nan")}, "physics_weight is nan"),
        ({"knots_per_second": 0.0}, "knots_per_second is 0"),
    ],
)
def test_bad_options(options, message):
    with pytest.raises(la.InputError, match=message):
        la.discover(duffing(), DUFFING_LIBRARY, KINETIC, method="adam", options=options)


def test_options_belong_to_adam():
    with pytest.raises(la.InputError, match="no options"):
        la.discover(duffing(), DUFFING_LIBRARY, KINETIC, options={"threshold": 0.1})


def test_command_line(tmp_path):
    from leastaction.cli import program

    la.write_csv(tmp_path / "run.csv", duffing(noise=0.0))
    (tmp_path / "library.txt").write_text("x_dot**2\nx**2\nx**4\n")
    arguments = ["discover", str(tmp_path / "run.csv"), "--coordinates", "x", "--known", "x_dot**2=0.5"]
    arguments += ["--library", str(tmp_path / "library.txt"), "--output", str(tmp_path / "out")]
    arguments += ["--trial", "trial", "--method", "adam", "--option", "iterations=400", "--option"]
    done = CliRunner().invoke(program, [*arguments, "check_every=100"])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "out" / "report.html").exists()
    done = CliRunner().invoke(program, [*arguments, "haste=1"])
    assert done.exit_code == 2
    assert "haste" in done.output


# ---------------------------------- simulation error, with and without pushes that the library cannot explain
TERMS = ["theta_dot**2", "cos(theta)"]
FRICTION = ["theta_dot**2/2"]
TRUTH = np.array([0.5, 9.81, 0.2])
STEP = 0.01


def recordings(
    seeds: Sequence[int], pushed: float = 0.0, viscous: float = 0.2, trials: int = 3
) -> list[la.Trajectories]:
    """A pendulum under a known torque, and under one that nobody measured and that is fast.

    One set of trials for each seed; all motions are integrated at once.
    """
    t = np.arange(0.0, 15.0, STEP)
    drawn = []
    for rng in map(np.random.default_rng, seeds):
        for _ in range(trials):
            known = sum(rng.normal() * np.sin(w * t + rng.uniform(0.0, 6.3)) for w in (0.7, 1.9, 2.8, 4.1))
            fast = sosfiltfilt(butter(2, [0.06, 0.2], "band", output="sos"), rng.normal(size=t.size))
            fast *= pushed / fast.std()  # 3-10 Hz
            starts = rng.normal(0.0, 1.0, 1), rng.normal(0.0, 1.0, 1)
            drawn.append((4.0 * known, 4.0 * known + fast, *starts, rng.normal(0.0, 1e-4, (t.size, 1))))

    def forces(times):
        return np.stack([np.interp(times, t, force) for _, force, *_ in drawn], axis=1)[..., None]

    def acceleration(q, v, f):
        return f - TRUTH[1] * np.sin(q) - viscous * v

    motions, _ = rk4(acceleration, [d[2] for d in drawn], [d[3] for d in drawn], t, forces=forces)
    runs = [
        la.Trajectory(t, motions[:, k] + noise, forces=known[:, None], coordinates=["theta"])
        for k, (known, *_, noise) in enumerate(drawn)
    ]
    return [la.Trajectories(runs[k : k + trials]) for k in range(0, len(runs), trials)]


def driven(seed: int, pushed: float = 0.0, viscous: float = 0.2, trials: int = 3) -> la.Trajectories:
    """Recordings of one seed."""
    return recordings([seed], pushed, viscous, trials)[0]


def setup_of(data: la.Trajectories, known=None):
    return build_problem(data, Request(TERMS, known or {}, FRICTION))


def minimise(data: la.Trajectories, start, horizon: float = 0.5, members=(0, 1, 2), known=None):
    setup = setup_of(data, known)
    grid = Grid.lay(setup.problem, setup.scales.per_second)
    curve = setup.scales.smooth
    return minimise_simulation_error(grid, curve, Structure(members), np.asarray(start), horizon)


def test_the_law_is_found_from_coefficients_that_are_off():
    found = minimise(driven(0), TRUTH * [1.2, 0.8, 0.5])
    assert np.allclose(found.estimates, TRUTH, rtol=[1e-3, 1e-3, 2e-2])


def test_the_law_is_found_where_only_one_coefficient_may_move():
    data = driven(1)
    found = minimise(data, [0.5, 8.0, 0.2], members=[1], known={"theta_dot**2": 0.5})
    assert found.estimates == pytest.approx([9.81], rel=1e-3)
    assert found.covariance.shape == (1, 1)


def test_friction_dissipates():
    found = minimise(driven(2, viscous=-0.1), TRUTH)
    assert 0.0 <= found.estimates[2] < 1e-3


@pytest.mark.thorough
def test_intervals_hold_under_pushes_that_nobody_measured():
    results = [minimise(data, TRUTH) for data in recordings(range(20, 45), pushed=2.0)]
    z = np.array([(r.estimates - TRUTH) / np.sqrt(np.diag(r.covariance)) for r in results])
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.35
    assert np.all(np.abs(z.mean(axis=0)) < 0.75)  # no bias that matters: four standard deviations of a mean


def test_nothing_comes_of_few_runs():
    assert minimise(driven(3), TRUTH, horizon=10.0) is None


def test_no_run_goes_over_a_gap():
    data = driven(4)
    holed = [t.rows(np.flatnonzero((t.t < 6.0) | (t.t > 7.0))) for t in data]
    whole, found = minimise(data, TRUTH), minimise(la.Trajectories(holed), TRUTH)
    assert np.allclose(found.estimates, TRUTH, rtol=[1e-3, 1e-3, 2e-2])
    assert np.all(np.diag(found.covariance) > 0.8 * np.diag(whole.covariance))


# ------------------------------------------------------------------------------------- in a discovery


def coarse_fit(data, factor, knots=None) -> Search:
    """What a search on a coarse grid leaves behind, its coefficients off by a factor."""
    setup = setup_of(data)
    grid = Grid.lay(setup.problem, setup.scales.coarse if knots is None else knots(setup.scales))
    curve, members = grid.smooth(setup.scales.smooth.penalty), Structure([0, 1, 2])
    fit = grid.fit(members, grid.start(members, curve.control_points, TRUTH, curve.noise_std))
    return begin_search(setup).now(replace(fit, coefficients=TRUTH * factor))


def test_a_fit_that_simulations_contradict_gives_way():
    stages = []
    search = coarse_fit(driven(7, pushed=2.0), [1.3, 1.2, 0.8])
    found = run(replace(search, report=lambda *stage: stages.append(stage)))
    better = found.found
    assert np.allclose(better.estimates, TRUTH, rtol=[0.05, 0.05, 0.2])
    assert np.all(np.abs(better.estimates - TRUTH) < 4.0 * better.standard_errors)
    assert [finding.code for finding in found.findings] == ["coefficients-of-free-runs"]
    ((stage, judged),) = stages
    assert stage == "coarse"
    assert judged["forecast_error"] < judged["before"]


def test_the_curve_follows_the_coefficients_that_are_reported():
    """What the checks see are the numbers that are returned: the equation error is that of the new ones."""
    search = coarse_fit(driven(7, pushed=2.0), [1.3, 1.2, 0.8])
    better = run(search).found
    held = better.grid.held(better, better.coefficients, better.covariance)
    for fit, again in ((better, held), (held, held)):
        physics, index = fit.grid.physics(fit.structure)
        at = linearise(fit.grid.observations, physics, fit.control_points, fit.coefficients[index])
        np.testing.assert_allclose(fit.linearisation.equation, at.equation, rtol=1e-9)
        np.testing.assert_allclose(fit.equation_error()[0], again.equation_error()[0], rtol=1e-2)


def test_a_fit_within_the_errors_of_simulations_stays():
    search = coarse_fit(driven(8, pushed=2.0), [1.0, 1.0, 1.0])
    assert run(search) is search


def test_a_fit_on_fine_knots_stays():
    search = coarse_fit(driven(9), [1.3, 1.2, 0.8], lambda scales: scales.per_second)
    assert run(search) is search


# ----- the weights: evidence against dense marginal likelihoods, known noise, large weights of the equations
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
    quadratic = score_candidates(fit.linearisation, fit.weights, columns)
    assert np.isfinite(quadratic.matrix).all()
    assert np.all(np.diag(quadratic.matrix)[2:] > 0.0)


@pytest.mark.parametrize("factor", [-0.8, -1.0, -5.0])
@pytest.mark.parametrize("first", [1.0, 0.5, 2.0])
def test_a_weight_that_swings_about_its_fixed_point_is_met(factor: float, first: float):
    """x → factor · x: with whole steps the rounds of −1 never end, and those of −5 run away."""
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
