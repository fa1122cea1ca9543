"""Trials as blocks: the same sums, whoever computes them, and whoever is lost on the way."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

import leastaction as la
from helpers import euler_lagrange, uniform_grid
from leastaction import systems
from leastaction.estimation import joint, observations, volume
from leastaction.estimation.blocks import BlockedObservations, observe
from leastaction.estimation.candidates import score
from leastaction.estimation.crew import DaskCrew, employ
from leastaction.estimation.observations import Observations
from leastaction.estimation.protocols import linearise
from set_ups import MORE, SMALL, VALUES, WEIGHTS, Cluster, assert_same, close, problem


@pytest.fixture(autouse=True, scope="module")
def small_blocks():
    """Blocks as small as a trial."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(observations, "_NUMBERS", SMALL)
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
    monkeypatch.setattr(observations, "_NUMBERS", intervals * SMALL // 20)
    whole, parts = Observations(grid, *data), observe(grid, *data, crew)
    assert isinstance(parts, BlockedObservations)
    assert len(parts.blocks) == n_blocks
    for name in ("counts", "coordinates", "floors", "noise_floor"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    for mine, others in zip(parts.residuals(control), whole.residuals(control), strict=True):
        np.testing.assert_allclose(mine, others, atol=1e-12)
    here, there = (linearise(seen, physics, control, VALUES) for seen in (whole, parts))
    for name in ("squares", "equation", "volume"):
        close(getattr(there, name), getattr(here, name), 1e-12)
    assert there.log_volume == pytest.approx(here.log_volume, rel=1e-12)
    assert there.regular == pytest.approx(here.regular, rel=1e-12)
    assert there.cost(WEIGHTS) == pytest.approx(here.cost(WEIGHTS), rel=1e-12)
    for mine, others in zip(there.freedom(WEIGHTS), here.freedom(WEIGHTS), strict=True):
        close(mine, others)
    expected, found = here.normal(WEIGHTS).eliminate(0.01), there.normal(WEIGHTS).eliminate(0.01)
    for name in ("gradient", "matrix", "held", "curve_gradient"):
        close(getattr(found, name), getattr(expected, name))
    assert found.logdet == pytest.approx(expected.logdet, abs=1e-9)
    step = np.array([0.1, -0.2, 0.3, 0.4])
    close(found.curve_step(step), expected.curve_step(step), 1e-8)


def test_blocks_score_candidates_as_the_whole(crew):
    grid, data, physics, control = problem()
    more = euler_lagrange(MORE, ["x", "y"])
    expected, found = (
        linearise(seen, physics, control, VALUES).scored(
            score, WEIGHTS, (control, VALUES), physics.columns, more
        )
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
    one, other = (at.scored(score, WEIGHTS, (control, VALUES), physics.columns, more) for at in (kept, again))
    np.testing.assert_array_equal(one.schur, other.schur)


def test_one_trial_is_never_cut_and_small_data_are_not_worth_it(crew, monkeypatch):
    grid, data, _, _ = problem()
    t, q = data[0][0], data[1][0]
    assert isinstance(observe(uniform_grid([2.0], 6.0, 5, 2), [t], [q], (), crew), Observations)
    assert isinstance(observe(grid, *data, crew), BlockedObservations)
    monkeypatch.setattr(observations, "_NUMBERS", grid.n_intervals * SMALL // 20)
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
        patch.setattr(observations, "_NUMBERS", 2**40)
        return data, found(data)


@pytest.mark.parametrize("workers", [None, 2, Cluster(10**9)])
def test_neither_blocks_nor_workers_change_the_result(workers, alone):
    data, model = alone
    assert_same(model, found(data, workers=workers))


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
