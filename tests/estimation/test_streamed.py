"""Long recordings in blocks that are made when they are needed: the same sums, whoever computes them."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
import tracemalloc
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import leastaction as la
from helpers import (
    MORE,
    SMALL,
    TERMS,
    VALUES,
    WEIGHTS,
    Cluster,
    assert_same,
    close,
    euler_lagrange,
    motion,
    problem,
    uniform_grid,
)
from leastaction import systems
from leastaction.diagnosis.friction import _Late
from leastaction.estimation import recipes, streamed
from leastaction.estimation.blocks import observe
from leastaction.estimation.candidates import score
from leastaction.estimation.crew import DaskCrew, ProcessCrew, employ
from leastaction.estimation.files import Held
from leastaction.estimation.forces import WithPushes
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics
from leastaction.estimation.observations import Observations
from leastaction.estimation.problem import Problem
from leastaction.estimation.protocols import linearise
from leastaction.estimation.streamed import StreamedObservations


@pytest.fixture(scope="module")
def processes():
    crew = ProcessCrew(2)
    yield crew
    crew.close()


@pytest.fixture(params=["alone", "two processes"])
def crew(request, monkeypatch, processes):
    """Whoever computes; every recording is long, and a block holds one trial or two."""
    monkeypatch.setattr(streamed, "_LONG", 1)
    monkeypatch.setattr(recipes, "_NUMBERS", SMALL)
    return None if request.param == "alone" else processes


def both(crew):
    """The same data in one piece and streamed, the physics, and a curve."""
    grid, data, physics, control = problem()
    parts = observe(grid, *data, crew)
    assert isinstance(parts, StreamedObservations)
    assert 2 <= len(parts.points) <= len(grid.spaces)
    return Observations(grid, *data), parts, physics, control


def test_a_stream_gives_the_sums_of_the_whole(crew):
    whole, parts, physics, control = both(crew)
    for name in ("counts", "coordinates"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    for name in ("floors", "noise_floor"):
        close(getattr(parts, name), getattr(whole, name), 1e-12)
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


@pytest.mark.parametrize("damping", [0.0, 0.01])
@pytest.mark.parametrize("foreseen", [True, False])
def test_a_stream_takes_the_step_of_the_whole(crew, damping, foreseen):
    whole, parts, physics, control = both(crew)
    at = linearise(parts, physics, control, VALUES, WEIGHTS if foreseen else None)
    found = at.normal(WEIGHTS).eliminate(damping)
    expected = linearise(whole, physics, at.control_points, VALUES).normal(WEIGHTS).eliminate(damping)
    for name in ("gradient", "matrix", "held"):
        close(getattr(found, name), getattr(expected, name))
    assert found.factor.logdet == pytest.approx(expected.factor.logdet, abs=1e-9)
    step = np.array([0.1, -0.2, 0.3, 0.4])
    shift = expected.curve_step(step)
    close(found.curve_step(step), shift, 1e-6)  # in single precision
    assert found.predicted(-shift, step) == pytest.approx(expected.predicted(-shift, step), rel=1e-8)
    right = np.linspace(-1.0, 1.0, shift.size)
    close(found.factor.solve(right), expected.factor.solve(right), 1e-8)


class Ramp:
    """A push that differs from interval to interval."""

    def __init__(self, begin: int = 0) -> None:
        self.begin = begin

    def __len__(self):
        return 1

    def on(self, intervals, n_dof):
        one = self.begin + np.arange(intervals.start, intervals.stop, dtype=float)
        return np.tile(one, (1, n_dof, 2))

    def within(self, intervals):
        return Ramp(self.begin + intervals.start)


@pytest.mark.parametrize("pushed", [False, True])
def test_a_stream_scores_candidates_as_the_whole(crew, pushed):
    whole, parts, physics, control = both(crew)
    more = euler_lagrange(MORE, ["x", "y"])
    step = np.arange(7.0)
    if pushed:
        more, step = WithPushes(more, Ramp()), np.arange(8.0)
    expected, found = (
        linearise(seen, physics, control, VALUES).scored(score, WEIGHTS, more) for seen in (whole, parts)
    )
    close(found.schur, expected.schur)
    close(found.volume.slope, expected.volume.slope)
    close(found.volume.corner, expected.volume.corner)
    close(found.curve_gradient, expected.curve_gradient)
    close(found.border(step), expected.border(step))
    assert found.factor.logdet == pytest.approx(expected.factor.logdet, abs=1e-9)
    right = expected.curve_gradient + expected.border(step)
    close(found.factor.solve(right), expected.factor.solve(right), 1e-8)


def test_a_fit_is_the_same_and_does_not_depend_on_who_computes(crew):
    whole, parts, physics, control = both(crew)
    near = fit_joint(whole, physics, WEIGHTS, control, VALUES)
    start = near.control_points, 1.05 * near.coefficients
    expected, found = (fit_joint(seen, physics, WEIGHTS, *start) for seen in (whole, parts))
    assert found.converged
    close(found.coefficients, expected.coefficients, 1e-5)
    close(found.covariance, expected.covariance, 1e-5)
    again = fit_joint(observe(parts.grid, *problem()[1]), physics, WEIGHTS, *start)
    np.testing.assert_array_equal(again.coefficients, found.coefficients)
    np.testing.assert_array_equal(again.control_points, found.control_points)


def test_a_curve_far_from_the_equations_is_led_on_by_itself(crew):
    whole, parts, physics, control = both(crew)
    held = Physics(physics.columns, np.zeros_like(physics.free), physics.forces)
    expected = fit_joint(whole, held, WEIGHTS, control, VALUES, tolerance=1e-8)
    cost = linearise(whole, held, control, VALUES).cost(WEIGHTS)
    reached = expected.linearisation.cost(WEIGHTS)
    assert expected.converged
    assert cost > reached + 0.5 * whole.counts.sum()
    for each in (physics, held):
        found = linearise(parts, each, control, VALUES, WEIGHTS)
        again = linearise(whole, each, found.control_points, VALUES)
        assert found.cost(WEIGHTS) == pytest.approx(reached, abs=0.05)
        assert again.cost(WEIGHTS) == pytest.approx(found.cost(WEIGHTS), rel=1e-12)
    np.testing.assert_array_equal(
        linearise(parts, physics, found.control_points, VALUES, WEIGHTS).control_points, found.control_points
    )


@pytest.mark.parametrize("seed", [10, 26, 33])
def test_a_curve_that_noise_has_bent_finds_to_equations_that_hold_exactly(crew, seed):
    """Near its upper equilibrium a pendulum falls either way: half a radian of noise hides which."""
    rng = np.random.default_rng(seed)
    angle, rate = 3.0 + 0.1 * rng.standard_normal(), 0.3 * rng.standard_normal()
    t = np.arange(0.0, 10.0, 0.02)
    swing = solve_ivp(
        lambda _, y: [y[1], -9.81 * np.sin(y[0])],
        (0.0, 10.0),
        [angle, rate],
        t_eval=t,
        rtol=1e-10,
        atol=1e-10,
    )
    noisy = swing.y[0][:, None] + 0.5 * rng.standard_normal((t.size, 1))
    grid = uniform_grid([10.0], 25.0, 5, 1)
    basis, rough = grid.design([t], 0), np.diff(np.eye(grid.n_ctrl), 3, axis=0)
    start = np.linalg.solve((basis.T @ basis).toarray() + 0.1 * rough.T @ rough, basis.T @ noisy)
    physics = Physics(euler_lagrange(["theta_dot**2", "cos(theta)"], ["theta"]), np.zeros(2, bool), None)
    seen = observe(grid, [t], [noisy], crew=crew)
    weights = WEIGHTS.__class__(np.array([0.5]), np.array([1e8]), np.array([1e-3]))
    law = np.array([0.5, 9.81])
    assert linearise(seen, physics, start, law, weights).cost(weights) < 1.2 * t.size


def test_a_stream_whose_curve_nothing_holds_fails_as_the_whole(crew):
    _, parts, physics, control = both(crew)
    broken = WEIGHTS.__class__(WEIGHTS.noise_std, np.array([np.nan, 1.0]), WEIGHTS.slack)
    for foreseen in (None, broken):
        at = linearise(parts, physics, control, VALUES, foreseen)
        with pytest.raises(np.linalg.LinAlgError):
            at.normal(broken).eliminate()
    assert fit_joint(parts, physics, broken, control, VALUES).status == "not finite"


def step_of(crew):
    """Quadratic part and step of the curve, at the same place for every crew."""
    grid, data, physics, control = problem()
    at = linearise(observe(grid, *data, crew), physics, control, VALUES, WEIGHTS)
    quadratic = at.normal(WEIGHTS).eliminate()
    return quadratic.matrix, quadratic.curve_step(np.ones(4))


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
@pytest.mark.thorough
def test_children_that_are_killed_cost_time_and_not_the_result(crew):
    expected = step_of(crew)
    doomed = ProcessCrew(2)
    for _ in range(4):  # more often than children are started again
        doomed.results([doomed.task(_die_in_a_child, os.getpid())])
        for one, other in zip(step_of(doomed), expected, strict=True):
            np.testing.assert_array_equal(one, other)
    assert doomed.results([doomed.task(os.getpid)]) == [os.getpid()]
    doomed.close()
    for one, other in zip(step_of(doomed), expected, strict=True):
        np.testing.assert_array_equal(one, other)


def _die_in_a_child(parent: int) -> None:
    if os.getpid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)


def test_what_is_held_travels_as_a_name_and_goes_with_its_last_user(tmp_path):
    held = Held.write(np.arange(10_000.0), tmp_path / "one")
    sent = pickle.dumps(held)
    assert len(sent) < 500
    np.testing.assert_array_equal(pickle.loads(sent), held.value)
    del held
    assert not any(tmp_path.iterdir())


def test_a_crew_leaves_no_files(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with employ(2) as crew:
        held = crew.held(np.arange(3.0))
        assert crew.results([crew.task(np.sum, held), crew.task(sum, (1, 2))]) == [3.0, 3]
        assert any(tmp_path.iterdir())
    assert not any(tmp_path.iterdir())
    assert crew.held(1) == 1


def files_in(folder) -> list:
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
def test_solutions_wait_on_disk_until_the_step_is_taken(crew, monkeypatch, tmp_path):
    expected = step_of(crew)[1]
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    _, parts, physics, control = both(crew)
    quadratic = linearise(parts, physics, control, VALUES, WEIGHTS).normal(WEIGHTS).eliminate()
    assert len(files_in(tmp_path)) == len(parts.points)
    np.testing.assert_array_equal(quadratic.curve_step(np.ones(4)), expected)
    del quadratic
    assert not files_in(tmp_path)
    del parts
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
def test_where_the_disk_is_full_solutions_stay_in_memory(crew, monkeypatch):
    expected = step_of(crew)[1]

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    np.testing.assert_array_equal(step_of(crew)[1], expected)


def test_of_late_forces_a_block_gets_its_own_part():
    late = WithPushes(euler_lagrange(TERMS, ["x", "y"]), _Late(np.ones((1000, 2, 2))))
    assert len(pickle.dumps(late.within(slice(0, 10)))) < 0.1 * len(pickle.dumps(late))


def test_what_fails_in_a_child_fails_here(processes):
    with pytest.raises(ZeroDivisionError):
        processes.results([processes.task(divmod, 1, 0)])


def test_a_program_needs_no_guard_for_its_children(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        "import math\n"
        "from leastaction.estimation.crew import employ\n"
        "print('begun')\n"
        "with employ(2) as crew:\n"
        "    print(*crew.results([crew.task(math.sqrt, x) for x in (4.0, 9.0)]))\n"
    )
    done = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, timeout=60)
    assert (done.stdout.split(), done.stderr) == (["begun", "2.0", "3.0"], "")


def test_children_end_with_a_program_that_is_killed(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        "import os, time\n"
        "from leastaction.estimation.crew import employ\n"
        "with employ(2) as crew:\n"
        "    first = crew.results([crew.task(os.getpid)])[0]\n"
        "    print(first, flush=True)\n"
        "    time.sleep(600)\n"
    )
    running = subprocess.Popen([sys.executable, program], stdout=subprocess.PIPE, text=True)
    assert running.stdout is not None
    child = int(running.stdout.readline())
    os.kill(child, 0)  # it is there
    running.kill()
    running.communicate()
    deadline = time.monotonic() + 60.0
    while _is_running(child) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not _is_running(child)


def _is_running(pid: int) -> bool:
    """Whether the process is there; one that has ended may still wait for whoever asks how."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def counted_looks(monkeypatch) -> list[int]:
    """First knot intervals of blocks, each time that one is laid on its splines."""
    looked: list[int] = []
    observe_block = recipes.Recipe.observe

    def counted(recipe):
        looked.append(recipe.intervals.start)
        return observe_block(recipe)

    monkeypatch.setattr(recipes.Recipe, "observe", counted)
    return looked


def test_a_cluster_keeps_its_blocks(monkeypatch):
    """They are laid on the splines once, and the numbers are those of a stream."""
    monkeypatch.setattr(streamed, "_LONG", 1)
    monkeypatch.setattr(recipes, "_NUMBERS", SMALL)
    grid, data, physics, control = problem()
    alone = fit_joint(observe(grid, *data), physics, WEIGHTS, control, 1.05 * VALUES)
    looked = counted_looks(monkeypatch)
    parts = observe(grid, *data, DaskCrew(Cluster(10**9)))
    away = fit_joint(parts, physics, WEIGHTS, control, 1.05 * VALUES)
    assert sorted(looked) == [intervals.start for intervals in parts.intervals]
    np.testing.assert_array_equal(away.coefficients, alone.coefficients)
    np.testing.assert_array_equal(away.control_points, alone.control_points)


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
def test_the_basis_of_fewer_samples_is_kept(crew, monkeypatch):
    """It is formed once, and the numbers are those of a stream."""
    _, kept, physics, control = both(crew)
    looked = counted_looks(monkeypatch)
    one = linearise(kept, physics, control, VALUES, WEIGHTS).cost(WEIGHTS)
    assert looked == []
    monkeypatch.setattr(streamed, "_KEPT", 0)
    _, parts, physics, control = both(crew)
    assert linearise(parts, physics, control, VALUES, WEIGHTS).cost(WEIGHTS) == one
    assert looked


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
def test_a_step_is_one_pass(crew, monkeypatch):
    """What a step needs of the weights that are foreseen comes from one look at every block."""
    monkeypatch.setattr(streamed, "_KEPT", 0)
    _, parts, physics, control = both(crew)
    looked = counted_looks(monkeypatch)
    at = linearise(parts, physics, control, VALUES, WEIGHTS)
    quadratic = at.normal(WEIGHTS).eliminate()
    quadratic.predicted(quadratic.curve_step(np.ones(4)), np.ones(4))
    assert np.isfinite(at.cost(WEIGHTS))
    assert sorted(looked) == [intervals.start for intervals in parts.intervals]


def peak_of(run) -> int:
    """Most bytes that a call holds at once beyond what there was before."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_of_a_pass_does_not_grow_with_the_number_of_trials(monkeypatch):
    monkeypatch.setattr(streamed, "_LONG", 1)
    monkeypatch.setattr(recipes, "_NUMBERS", 2**14)
    weights = WEIGHTS.__class__(WEIGHTS.noise_std[:2], WEIGHTS.physics, WEIGHTS.slack)
    physics = Physics(euler_lagrange(MORE[:5], ["x", "y"]), np.ones(5, dtype=bool), None)
    peaks = []
    for count in (2, 6):  # the trials, and what a grid lays out for them, are there before
        times = [np.linspace(0.0, 160.0, 3201)] * count
        grid = uniform_grid([160.0] * count, 10.0, 5, 2)
        parts = observe(grid, times, [motion(t) for t in times])
        assert len(parts.points) == count
        near = linearise(parts, physics, np.ones((grid.n_ctrl, 2)), VALUES, weights).control_points
        run = partial(linearise, parts, physics, near, VALUES, weights)
        run()  # what is made once and stays
        peaks.append(peak_of(run))
    of_x = near.size // count * 6 * 4  # bytes of X of a trial: a column for the gradient and for each term
    assert peaks[0] > 40 * of_x  # what the work on a trial holds at once
    assert (peaks[1] - peaks[0]) / 4 < 0.5 * of_x


def test_a_long_recording_is_smoothed_in_runs_as_in_one_piece(monkeypatch):
    rng = np.random.default_rng(3)
    times = [np.sort(rng.uniform(0.0, 5.0, 120)) for _ in range(7)]
    q = [motion(t) + 0.02 * rng.standard_normal((t.size, 2)) for t in times]
    q[2][40:50, 1] = np.nan
    items = [la.Trajectory(t, x, coordinates=["x", "y"]) for t, x in zip(times, q, strict=True)]
    columns = euler_lagrange(TERMS, ["x", "y"])
    grid = Grid.lay(Problem(la.Trajectories(items), columns, np.full(5, np.nan)), 6.0)
    expected = grid.smooth()
    monkeypatch.setattr(streamed, "_LONG", 1)
    monkeypatch.setattr("leastaction.estimation.grid._SMOOTHED", 200)
    found = grid.smooth(expected.penalty)
    close(found.control_points, expected.control_points, 1e-7)
    close(found.noise_std, expected.noise_std, 1e-7)
    one, other = (s.replicates(2, np.random.default_rng(1), np.zeros(2)) for s in (expected, found))
    close(np.array(other), np.array(one), 1e-6)


# ------------------------------------------------------------------------------------- discover()
@pytest.fixture(scope="module")
def just_too_long():
    """A recording that is just too long to be searched in one piece, and its law found by this thread."""
    data = systems.generate("single_pendulum", noise=0.1, trials=6, duration=20.0, seed=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streamed, "_LONG", data.n_samples - 1)
        patch.setattr("leastaction.api.ENOUGH_SAMPLES", data.n_samples // 2)
        patch.setattr(recipes, "_NUMBERS", 2**11)
        yield data, la.discover(data, systems.compact_library("single_pendulum"))


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [2, Cluster(10**9)])
def test_the_law_of_a_long_recording_does_not_depend_on_who_computes(workers, just_too_long):
    data, model = just_too_long
    assert "confirm" in model.diagnostics.timings
    again = la.discover(data, systems.compact_library("single_pendulum"), workers=workers)
    assert_same(model, again, 1e-9)
