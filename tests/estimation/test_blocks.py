"""The linear algebra of a fit: trials as blocks, whoever computes them; bands against dense algebra."""

from __future__ import annotations

import time
from concurrent.futures import Future
from dataclasses import replace

import numpy as np
import pytest

import leastaction as la
from helpers import (
    MORE,
    SMALL,
    VALUES,
    WEIGHTS,
    Cluster,
    assert_same,
    close,
    euler_lagrange,
    interpolate,
    linearised_alike,
    problem,
    uniform_grid,
)
from leastaction import systems
from leastaction.curve.bspline import SplineGrid
from leastaction.estimation import candidates, elimination, joint, recipes, stretches, volume
from leastaction.estimation import joint as problem_module
from leastaction.estimation.blocks import BlockedObservations, observe
from leastaction.estimation.candidates import score
from leastaction.estimation.crew import Alone, DaskCrew, employ
from leastaction.estimation.elimination import BandedFactor, trace_product
from leastaction.estimation.gauss_newton import fit_joint, score_candidates
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.observations import Observations
from leastaction.estimation.protocols import linearise
from leastaction.estimation.stretches import SharedObservations


# --------------------- trials as blocks: the same sums, whoever computes them, and whoever is lost on the way
@pytest.fixture(autouse=True, scope="module")
def small_blocks():
    """Blocks as small as a trial."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recipes, "_NUMBERS", SMALL)
        yield


@pytest.fixture(params=["alone", "a cluster"])
def crew(request):
    """Whoever computes."""
    return None if request.param == "alone" else DaskCrew(Cluster(10**9))


@pytest.mark.parametrize(("intervals", "n_blocks"), [(1, 5), (20, 4), (25, 3), (40, 2)])
def test_blocks_give_the_sums_of_the_whole(intervals, n_blocks, crew, monkeypatch):
    # runs that begin within trials, and means over time that leave points out
    monkeypatch.setattr(joint, "_CHUNK", 13)
    monkeypatch.setattr(volume, "_CHUNK", 13)
    monkeypatch.setattr(volume, "_VOLUME_POINTS", 4)
    grid, data, physics, control = problem()
    monkeypatch.setattr(recipes, "_NUMBERS", intervals * SMALL // 20)
    whole, parts = Observations(grid, *data), observe(grid, *data, crew)
    assert isinstance(parts, BlockedObservations)
    assert len(parts.blocks) == n_blocks
    for name in ("counts", "coordinates", "floors", "noise_floor"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    here, there = linearised_alike(whole, parts, physics, control)
    expected, found = here.normal(WEIGHTS).eliminate(0.01), there.normal(WEIGHTS).eliminate(0.01)
    for name in ("gradient", "matrix", "held", "curve_gradient"):
        close(getattr(found, name), getattr(expected, name))
    assert found.logdet == pytest.approx(expected.logdet, abs=1e-9)
    step = np.array([0.1, -0.2, 0.3, 0.4])
    close(found.curve_step(step), expected.curve_step(step), 1e-8)


@pytest.mark.parametrize("n_stretches", [1, 3, 200])
def test_stretches_of_a_motion_give_the_sums_of_the_whole(n_stretches, monkeypatch):
    """They cut trials, so that neighbours share control points."""
    monkeypatch.setattr(volume, "_CHUNK", 13)
    monkeypatch.setattr(volume, "_VOLUME_POINTS", 4)
    grid, data, physics, control = problem()
    whole, alone = Observations(grid, *data), Alone()
    alone.size = n_stretches
    parts = SharedObservations(whole, alone)
    assert len(parts.stretches) == min(n_stretches, grid.n_intervals)
    here, there = linearised_alike(whole, parts, physics, control)
    ahead = linearise(parts, physics, control, VALUES, WEIGHTS)
    for found in (there.normal(WEIGHTS), ahead.normal(WEIGHTS), ahead.lean().normal(WEIGHTS)):
        for mine, other in zip(found, here.normal(WEIGHTS), strict=True):
            close(mine, other)
    more = euler_lagrange(MORE, ["x", "y"])
    close(score_candidates(there, WEIGHTS, more).matrix, score_candidates(here, WEIGHTS, more).matrix)


def test_every_worker_has_as_many_stretches_of_a_long_motion(monkeypatch):
    grid, data, _, _ = problem()
    monkeypatch.setattr(stretches, "_MOST", grid.n_intervals // 3 + 1)
    crew = Alone()
    crew.size = 2
    assert len(SharedObservations(Observations(grid, *data), crew).stretches) == 4


def test_this_process_computes_its_own_tasks_before_it_waits_for_the_others(tmp_path):
    made = tmp_path / "made"

    def make() -> bool:
        made.touch()
        return True

    def see() -> bool:
        end = time.monotonic() + 10.0
        while not made.exists() and time.monotonic() < end:
            time.sleep(0.01)
        return made.exists()

    with employ(2, joins=True) as crew:
        crew._begun.result(timeout=60.0)
        crew.task(int)  # the turn of this process
        tasks = [crew.task(see), crew.task(make)]
        assert [task.future is None for task in tasks] == [False, True]
        assert crew.results(tasks) == [True, True]


def test_this_process_takes_all_tasks_until_a_child_has_begun():
    with employ(2, joins=True) as crew:
        begun, crew._begun = crew._begun, Future()
        tasks = [crew.task(int), crew.task(int)]
        assert [task.future is None for task in tasks] == [True, True]
        crew._begun = begun
        begun.result(timeout=60.0)
        tasks += [crew.task(int), crew.task(int)]
        assert [task.future is None for task in tasks[2:]] == [True, False]
        assert crew.results(tasks) == [0, 0, 0, 0]


def test_blocks_score_candidates_as_the_whole(crew):
    grid, data, physics, control = problem()
    more = euler_lagrange(MORE, ["x", "y"])
    expected, found = (
        linearise(seen, physics, control, VALUES).scored(score, WEIGHTS, more)
        for seen in (Observations(grid, *data), observe(grid, *data, crew))
    )
    close(found.schur, expected.schur)
    close(found.volume.slope, expected.volume.slope)
    close(found.volume.corner, expected.volume.corner)
    close(found.curve_gradient, expected.curve_gradient)
    close(found.border(np.arange(7.0)), expected.border(np.arange(7.0)))
    assert found.factor.logdet == pytest.approx(expected.factor.logdet, abs=1e-9)


def test_what_is_computed_again_equals_what_is_kept(monkeypatch):
    grid, data, physics, control = problem()
    more = euler_lagrange(MORE, ["x", "y"])
    kept = linearise(Observations(grid, *data), physics, control, VALUES)
    monkeypatch.setattr(joint, "_MOST_KEPT", 0)
    again = linearise(Observations(grid, *data), physics, control, VALUES)
    assert kept.kept is not None
    assert again.kept is None
    assert again.cost(WEIGHTS) == kept.cost(WEIGHTS)
    for one, other in zip(kept.normal(WEIGHTS), again.normal(WEIGHTS), strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(kept.freedom(WEIGHTS), again.freedom(WEIGHTS), strict=True):
        np.testing.assert_array_equal(one, other)
    one, other = (at.scored(score, WEIGHTS, more) for at in (kept, again))
    np.testing.assert_array_equal(one.schur, other.schur)


def test_blocks_that_are_held_at_once_share_the_memory_for_equations(monkeypatch):
    grid, data, physics, control = problem()
    parts = observe(grid, *data)
    monkeypatch.setattr(joint, "_MOST_KEPT", grid.n_intervals * 2 * 2 * (6 * 2 + 1 + physics.n_free) - 1)
    held = parts.linearise(physics, control, VALUES)
    assert all(task.here().kept is None for task in held.blocks)
    block, points = parts.blocks[0].here(), parts.points[0]  # by itself it is small
    assert joint.linearise(block, physics, control[points], VALUES).kept is not None


def test_one_trial_is_never_cut_and_small_data_are_not_worth_it(crew, monkeypatch):
    grid, data, _, _ = problem()
    t, q = data[0][0], data[1][0]
    assert isinstance(observe(uniform_grid([2.0], 6.0, 5, 2), [t], [q], (), crew), Observations)
    assert isinstance(observe(grid, *data, crew), BlockedObservations)
    monkeypatch.setattr(recipes, "_NUMBERS", grid.n_intervals * SMALL // 20)
    assert isinstance(observe(grid, *data, crew), Observations)


def test_the_cuts_do_not_depend_on_who_computes(crew):
    grid, data, _, _ = problem()
    seen = [observe(grid, *data, each) for each in (None, crew, DaskCrew(Cluster(10**9)))]
    assert all(isinstance(parts, BlockedObservations) for parts in seen)
    assert seen[0].points == seen[1].points == seen[2].points


def test_a_failure_in_a_block_is_the_failure_of_the_whole(crew):
    grid, data, physics, control = problem()
    at = linearise(observe(grid, *data, crew), physics, control, VALUES)
    broken = replace(WEIGHTS, physics=np.array([np.nan, 1.0]))
    with pytest.raises(np.linalg.LinAlgError):
        at.normal(broken).eliminate()


def test_a_crew_that_has_gone_home_leaves_results_that_can_be_used():
    grid, data, physics, control = problem()
    with employ(2) as crew:
        seen = observe(grid, *data, crew)
    expected = linearise(Observations(grid, *data), physics, control, VALUES)
    assert linearise(seen, physics, control, VALUES).cost(WEIGHTS) == pytest.approx(expected.cost(WEIGHTS))


# ------------------------------------------------------------------------------ a cluster that fails
@pytest.mark.parametrize("cluster", [Cluster(1), Cluster(2), Cluster(5), Cluster(99, gone_after=17)])
def test_what_a_lost_worker_held_is_computed_here(cluster):
    grid, data, physics, control = problem()
    crew = DaskCrew(cluster)
    there = linearise(observe(grid, *data, crew), physics, control, VALUES)
    here = linearise(Observations(grid, *data), physics, control, VALUES)
    assert there.cost(WEIGHTS) == pytest.approx(here.cost(WEIGHTS), rel=1e-12)
    expected, found = here.normal(WEIGHTS).eliminate(), there.normal(WEIGHTS).eliminate()
    close(found.matrix, expected.matrix)
    close(found.curve_step(np.ones(4)), expected.curve_step(np.ones(4)), 1e-8)


def test_what_fails_on_a_cluster_fails_here():
    grid, data, physics, control = problem()
    crew = DaskCrew(Cluster(10**9))
    at = linearise(observe(grid, *data, crew), physics, control, VALUES)
    with pytest.raises(np.linalg.LinAlgError):
        at.normal(replace(WEIGHTS, physics=np.array([np.nan, 1.0]))).eliminate()


# ------------------------------------------------------------------------------------- discover()
def recordings(trials: int = 4):
    return systems.generate("double_pendulum", noise=0.05, trials=trials, duration=8.0, seed=1)


def found(data, **more):
    return la.discover(data, systems.compact_library("double_pendulum"), **more)


@pytest.fixture(scope="module")
def alone():
    """Trials, and the law that is found in one piece."""
    data = recordings()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recipes, "_NUMBERS", 2**40)
        return data, found(data)


@pytest.mark.parametrize("workers", [None, 2, Cluster(10**9)])
def test_neither_blocks_nor_workers_change_the_result(workers, alone):
    data, model = alone
    assert_same(model, found(data, workers=workers))


@pytest.mark.thorough
def test_slow_forces_are_found_in_blocks_too():
    """Their columns depend on time, so that a block has to know where it begins."""
    pendulum = systems.generate("single_pendulum", noise=0.02, trials=4, duration=15.0, seed=3)
    library = ["theta_dot**2", "cos(theta)"]
    one, two = (
        la.discover(pendulum, library, known={"cos(theta)": 9.81}, force_offset={"theta": 6.0}, workers=n)
        for n in (None, 2)
    )
    assert_same(one, two, 1e-4)


@pytest.mark.parametrize("workers", [0, -1, True, 1.5, "two"])
def test_workers_that_make_no_sense_are_refused(workers):
    with pytest.raises(la.InputError, match="workers is"):
        found(recordings(1), workers=workers)


@pytest.fixture
def cluster():
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def swinging(data, **more):
    return la.discover(data, ["theta_dot**2", "cos(theta)", "sin(theta)"], **more)


@pytest.mark.thorough
def test_a_cluster_that_loses_a_worker_gives_the_same_result(cluster):
    """The problem is small, because every task costs the cluster some 5 ms."""
    data = systems.generate("single_pendulum", noise=0.02, trials=4, duration=5.0, seed=1)
    killed = []

    def kill(stage, details):
        if stage in ("select", "confirm", "knots") and not killed:
            killed.append(next(iter(cluster.scheduler_info(n_workers=-1)["workers"])))
            cluster.run(_die, workers=killed, wait=False, on_error="ignore")
            time.sleep(0.1)

    assert_same(swinging(data), swinging(data, workers=cluster, progress=kill))
    assert killed


def _die() -> None:
    import os
    import signal

    os.kill(os.getpid(), signal.SIGKILL)


# ---------------- banded products, factors and inverses against dense algebra; candidates scored in stretches
def dense(rows: np.ndarray) -> np.ndarray:
    """The symmetric matrix of block rows."""
    n_ctrl, n, width = rows.shape
    out = np.zeros((n_ctrl * n, n_ctrl * n))
    for p in range(n_ctrl):
        reach = min(width, (n_ctrl - p) * n)
        out[p * n : (p + 1) * n, p * n : p * n + reach] = rows[p, :, :reach]
    upper = np.triu(out)
    return upper + np.triu(upper, 1).T


def local_derivatives(grid: SplineGrid, n: int, n_rows: int = 3) -> np.ndarray:
    size = (grid.degree + 1) * n
    return np.random.default_rng(0).standard_normal((grid.n_intervals, n_rows, size))


def scattered(grid: SplineGrid, local: np.ndarray, n: int) -> np.ndarray:
    """Local derivatives as one dense matrix: one row for each of those of every interval."""
    m, n_rows, size = local.shape
    out = np.zeros((m, n_rows, grid.n_ctrl * n))
    for j in range(m):
        out[j, :, grid.first[j] * n : grid.first[j] * n + size] = local[j]
    return out.reshape(m * n_rows, -1)


def some_rows(grid: SplineGrid, n: int, ridge: float = 0.1) -> np.ndarray:
    local = local_derivatives(grid, n)
    rows = np.zeros((grid.n_ctrl, n, local.shape[2]))
    grid.add_gram(rows, local.transpose(0, 2, 1) @ local, slice(0, grid.n_intervals))
    for i in range(n):
        rows[:, i, i] += ridge
    return rows


@pytest.mark.parametrize("n", [1, 2, 3, 7])
@pytest.mark.parametrize("chunk", [1, 4, 100])
def test_gram_and_products_of_local_blocks_equal_dense_algebra(n, chunk):
    grid = uniform_grid([1.0, 0.6, 2.0], 5.0, 3, 2)
    local = local_derivatives(grid, n)
    values = np.random.default_rng(1).standard_normal((grid.n_intervals, 3, 4))
    rows, border = np.zeros((grid.n_ctrl, n, 4 * n)), np.zeros((grid.n_ctrl, n, 4))
    for part in grid.chunks(chunk):
        blocks = local[part].transpose(0, 2, 1)
        grid.add_gram(rows, blocks @ local[part], part)
        grid.add_products(border, (blocks @ values[part]).reshape(-1, 4, n, 4), part)
    matrix = scattered(grid, local, n)
    np.testing.assert_allclose(dense(rows), matrix.T @ matrix, rtol=0, atol=1e-12)
    np.testing.assert_allclose(border.reshape(-1, 4), matrix.T @ values.reshape(-1, 4), rtol=0, atol=1e-12)


def test_products_may_begin_at_any_control_point():
    grid = uniform_grid([1.0, 0.6], 5.0, 3, 2)
    products = np.random.default_rng(2).standard_normal((grid.n_intervals, 4, 2))
    whole, part = np.zeros((grid.n_ctrl, 2)), slice(5, 8)  # into the second trajectory
    grid.add_products(whole, products[part], part)
    origin = int(grid.first[5])
    later = np.zeros((grid.n_ctrl - origin, 2))
    grid.add_products(later, products[part], part, origin)
    np.testing.assert_array_equal(whole[:origin], 0.0)
    np.testing.assert_array_equal(whole[origin:], later)


@pytest.mark.parametrize("n", [1, 2, 4])
@pytest.mark.parametrize("group", [1, 2, 256])
def test_factor_equals_dense_algebra(n, group, monkeypatch):
    monkeypatch.setattr(elimination, "_GROUP", group)
    grid = uniform_grid([1.0, 0.8, 3.3], 5.0, 3, 2)
    rows = some_rows(grid, n)
    matrix, factor = dense(rows), BandedFactor.of(rows)
    right = np.random.default_rng(3).standard_normal((len(matrix), 5))
    assert factor.logdet == pytest.approx(np.linalg.slogdet(matrix)[1], abs=1e-9)
    np.testing.assert_allclose(factor.solve(right[:, 0]), np.linalg.solve(matrix, right[:, 0]), rtol=1e-8)
    lower = np.linalg.cholesky(matrix)
    expected = np.linalg.solve(lower, right)
    np.testing.assert_allclose(factor.forward(right), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(dense(BandedFactor.of(rows, 0.5).inverse_rows())[0, 0] > 0, True)
    inverse, found = np.linalg.inv(matrix), dense(factor.inverse_rows())
    inside = dense(np.ones_like(rows)) > 0
    np.testing.assert_allclose(found[inside], inverse[inside], rtol=0, atol=1e-9 * np.abs(inverse).max())


@pytest.mark.parametrize("lengths", [[5, 9, 1, 30], [40], [1, 1, 1, 60]])
def test_forward_substitution_goes_on_where_it_stopped(lengths):
    grid = uniform_grid([3.0, 2.0], 10.0, 5, 2)
    factor = BandedFactor.of(some_rows(grid, 2))
    size = grid.n_ctrl * 2
    right = np.random.default_rng(4).standard_normal((size, 3))
    start, found = 0, np.zeros((0, 3))
    for length in [*lengths, size]:
        part = right[start : start + length]
        found = np.concatenate([found, factor.forward(part, start, found)])
        start = len(found)
    np.testing.assert_allclose(found, factor.forward(right), rtol=0, atol=1e-9)


def test_damping_raises_the_diagonal():
    grid = uniform_grid([1.0], 5.0, 3, 2)
    rows = some_rows(grid, 2)
    matrix = dense(rows)
    damped = matrix + 0.3 * np.diag(np.diag(matrix))
    assert BandedFactor.of(rows, 0.3).logdet == pytest.approx(np.linalg.slogdet(damped)[1], abs=1e-9)


def test_indefinite_matrices_are_refused():
    rows = np.zeros((3, 1, 2))
    rows[:, 0, 0] = [1.0, -1.0, 1.0]
    with pytest.raises(np.linalg.LinAlgError, match="leading minor 2"):
        BandedFactor.of(rows)


# -------------------------------------------------------------------------------- a small problem
TERMS = ["x_dot**2", "y_dot**2", "x_dot*y_dot*cos(y)", "cos(y)", "x**2", "x*y", "x**4", "y_dot**2*cos(x)"]
TRUTH = np.array([1.5, 0.6, 1.1, 9.81, -5.0, 0.0, 0.0, 0.0])


def fitted(n_quadrature: int = 2):
    """A fit of the first five terms on two trajectories, and all eight as candidates."""
    grid = uniform_grid([2.0, 1.5], 6.0, 5, n_quadrature)
    rng = np.random.default_rng(5)
    times = [np.sort(rng.uniform(0.0, d, 60)) for d in (2.0, 1.5)]

    def curve(t):
        return np.column_stack([0.5 * np.sin(2.3 * t) + 0.2, 0.7 * np.cos(3.1 * t)])

    values = [curve(t) + 0.02 * rng.standard_normal((t.size, 2)) for t in times]
    observations = Observations(grid, times, values)
    columns = euler_lagrange(TERMS, ["x", "y"])
    control = interpolate(grid, [curve, curve])
    weights = Weights(np.array([0.02, 0.03]), np.array([4.0, 9.0]), np.array([7.0, 3.0]))
    physics = Physics(columns.subset(range(5)), np.array([True, True, True, False, True]), None)
    fit = fit_joint(observations, physics, weights, control, TRUTH[:5])
    assert fit.usable
    return observations, physics, fit, columns


def unblocked(observations, physics, fit, columns):
    """The same quadratic from one dense border: all columns free, at the coefficients of the fit."""
    everything = Physics(columns, np.ones(len(columns), bool), physics.forces)
    here = np.zeros(len(columns))
    here[: len(fit.coefficients)] = fit.coefficients
    at = problem_module.linearise(observations, everything, fit.control_points, here)
    return at.normal(fit.weights).eliminate()


def scored(observations, physics, fit, columns):
    return score_candidates(fit.linearisation, fit.weights, columns)


@pytest.mark.parametrize("stretch", [1, 3, 7, 512])
def test_candidates_scored_in_stretches_equal_one_dense_border(stretch, monkeypatch):
    monkeypatch.setattr(candidates, "_STRETCH", stretch)
    monkeypatch.setattr(candidates, "_NUMBERS", 10**9)
    monkeypatch.setattr(candidates, "_SHORTEST", 1)
    problem = fitted()
    expected, found = unblocked(*problem), scored(*problem)
    scale = np.sqrt(np.diag(expected.matrix))
    np.testing.assert_allclose(
        found.matrix / np.outer(scale, scale), expected.matrix / np.outer(scale, scale), atol=1e-9
    )
    np.testing.assert_allclose(found.gradient / scale, expected.gradient / scale, atol=1e-8)
    assert found.logdet == pytest.approx(expected.logdet, abs=1e-8)
    for step in (np.zeros(8), np.eye(8)[6], np.linspace(-1.0, 1.0, 8)):
        shift = expected.curve_step(step)
        np.testing.assert_allclose(found.curve_step(step), shift, rtol=0, atol=1e-9 * np.abs(shift).max())


def test_curve_step_equals_a_dense_solve():
    observations, physics, fit, columns = fitted()
    found = scored(observations, physics, fit, columns)
    normal = unblocked(observations, physics, fit, columns)
    everything = Physics(columns, np.ones(8, bool), None)
    here = np.append(fit.coefficients, np.zeros(3))
    system = problem_module.linearise(observations, everything, fit.control_points, here).normal(fit.weights)
    step = np.array([0.1, 0.0, -0.2, 0.0, 0.0, 3.0, 0.0, 0.5])
    shift = np.linalg.solve(dense(system.rows), system.border[:, 0] + system.border[:, 1:] @ step)
    for quadratic in (found, normal):
        np.testing.assert_allclose(quadratic.curve_step(step), shift, rtol=0, atol=1e-8 * np.abs(shift).max())


def test_derivatives_of_log_determinant_equal_finite_differences():
    observations, _, fit, _ = fitted()
    at, weights = fit.linearisation, fit.weights
    inverse = BandedFactor.of(at.normal(weights).rows).inverse_rows()

    def logdet(noise, physics) -> float:
        return BandedFactor.of(at.normal(Weights(noise, physics, weights.slack)).rows).logdet

    found = at.traces(weights, inverse)
    h = 1e-3
    for i in range(2):
        factor = np.exp(h * np.eye(2)[i])
        up, down = (logdet(weights.noise_std, weights.physics * f) for f in (factor, 1.0 / factor))
        assert found[i] == pytest.approx((up - down) / (2 * h), rel=1e-5)
        up, down = (logdet(weights.noise_std * f**-0.5, weights.physics) for f in (factor, 1.0 / factor))
        used = trace_product(inverse, i, observations.gram(i)) / weights.noise_std[i] ** 2
        assert used == pytest.approx((up - down) / (2 * h), rel=1e-5)
    total = found.sum() + sum(
        trace_product(inverse, i, observations.gram(i)) / weights.noise_std[i] ** 2 for i in range(2)
    )
    assert total == pytest.approx(fit.control_points.size, rel=1e-9)  # every direction is used once


def test_equations_that_are_not_kept_are_evaluated_anew(monkeypatch):
    observations, physics, fit, _ = fitted()
    kept = fit.linearisation
    monkeypatch.setattr(problem_module, "_MOST_KEPT", 0)
    monkeypatch.setattr(problem_module, "_CHUNK", 5)
    anew = problem_module.linearise(observations, physics, fit.control_points, fit.coefficients)
    assert anew.kept is None
    assert kept.kept is not None
    assert anew.misfit(fit.weights) == pytest.approx(kept.misfit(fit.weights), rel=1e-12)
    for a, b in zip(anew.normal(fit.weights), kept.normal(fit.weights), strict=True):
        # the log-determinant term is a mean over fewer points, which depend on the runs
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-2 * np.abs(b).max())
    np.testing.assert_allclose(anew.normal(fit.weights).rows, kept.normal(fit.weights).rows, rtol=1e-9)
    again = fit_joint(observations, physics, fit.weights, fit.control_points, TRUTH[:5])
    spread = np.sqrt(np.diag(fit.covariance))
    moved = (again.coefficients - fit.coefficients)[physics.free] / spread
    np.testing.assert_allclose(moved, 0.0, atol=0.1)
