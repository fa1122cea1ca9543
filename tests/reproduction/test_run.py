"""The runner, the figures and the peers of reproduction/: records, right pictures, files that repeat."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import redirect_stdout
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from scipy.integrate import solve_ivp

from leastaction import systems
from reproduction import (
    _figure_ablation,
    _figure_basins,
    _figure_magnetic,
    figures,
    methods,
    problem,
    search_adam,
)
from reproduction._execute import Options, launch
from reproduction._figure_basins import (
    MAGNETS,
    UNDECIDED,
    Basins,
    agreement,
    centres,
    damping,
    field_of,
    lagrangian_of,
    map_basins,
)
from reproduction._plots import label, solved, write_png, write_svg
from reproduction._results import store_of
from reproduction.methods import load
from reproduction.problem import Answer, Case, pose
from reproduction.run import build_cases, main, settings
from runner.machine import ROOT
from runner.store import open_cases, to_line

PEERS = all(find_spec(name) for name in ("pysindy", "cvxpy", "pyoperon"))
peers = pytest.mark.skipif(not PEERS, reason="PySINDy and Operon are extras")
if PEERS:
    import pysindy as ps

    from reproduction.methods import _pysindy as shared
    from reproduction.methods import operon, sindy, sindy_pi


# A stand-in for reproduction.methods: it notes when a run begins and ends. "gated" waits for a file from the
# second trial on, so that a test decides what is under way when it kills something.
FAKE = """
import os, signal, time
from pathlib import Path
from reproduction import problem
from reproduction.problem import Answer

problem.DURATION = 0.5  # the motions do not matter here
NAMES = ("gated", "slow", "raises", "dies", "absent")
HERE = Path(__file__).parent


def note(event, key):
    with open(HERE / event, "a") as file:
        file.write(key + "\\n")


class Method:
    TITLE, REFERENCE = "Fake", "none"

    def __init__(self, name):
        self.name = name

    def solve(self, problem):
        note("started", problem.case.key)
        (HERE / f"parent-{problem.case.trial}").write_text(str(os.getppid()))
        if self.name == "raises":
            raise ValueError("no luck")
        if self.name == "dies":
            os.kill(os.getpid(), signal.SIGSEGV)
        while self.name == "slow" or problem.case.trial >= 1 and not (HERE / "gate").exists():
            time.sleep(0.02)
        note("done", problem.case.key)
        return Answer(None, None, settings={"threads": os.environ["OMP_NUM_THREADS"]})


def load(name):
    if name == "absent":
        raise ImportError("No module named 'nowhere'")
    return Method(name)
"""
COMMAND = ["--methods-from", "fake_methods", "--system", "single_pendulum", "--noise", "0"]
COMMAND += ["--trajectories", "1"]


class Fake:
    """The stand-in's folder, and what it has noted."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.results = folder, folder / "results"
        (folder / "fake_methods.py").write_text(FAKE)

    def noted(self, event: str) -> Counter[str]:
        path = self.folder / event
        return Counter(path.read_text().split() if path.exists() else [])

    def open_gate(self) -> None:
        (self.folder / "gate").touch()

    def start(self, *options: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "reproduction.run", *COMMAND, "--method", "gated", *options]
        command += ["--results", str(self.results)]
        return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)

    def records(self) -> dict[str, dict]:
        """Read every record, which fails on a half-written one."""
        store = replace(store_of(self.results), say=pytest.fail)
        return {store.key(record): record for record in store.read()}


@pytest.fixture
def fake(tmp_path, monkeypatch) -> Fake:
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(problem, "DURATION", problem.DURATION)  # the stand-in changes it where it is imported
    monkeypatch.delitem(sys.modules, "fake_methods", raising=False)
    return Fake(tmp_path)


def wait_for(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def fake_case(method: str, trial: int = 0) -> Case:
    return Case("single_pendulum", 0.0, method, trial, trajectories=1)


@pytest.mark.thorough
def test_killed_run_goes_on_without_loss_or_repetition(fake):
    first = fake.start("--trials", "3", "--jobs", "2")
    wait_for(lambda: len(fake.records()) == 1 and len(fake.noted("started")) == 3)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    before = fake.records()
    assert len(before) == 1
    time.sleep(0.5)  # the processes of the runs end with the runner: what they would do now, they do not
    fake.open_gate()
    time.sleep(0.5)
    assert set(fake.noted("done")) == set(before)

    second = fake.start("--trials", "3", "--jobs", "2")
    output, _ = second.communicate(timeout=60)
    assert second.returncode == 0
    assert "3 cases, 1 of them done already" in output
    after = fake.records()
    assert len(after) == 3
    assert {key: after[key] for key in before} == before
    assert set(fake.noted("done").values()) == {1}
    assert {fake.noted("started")[key] for key in before} == {1}
    assert not list(fake.results.glob(".*"))


def test_interrupt_ends_the_runs_and_says_what_is_left(fake):
    process = fake.start("--trials", "3", "--jobs", "1")
    wait_for(lambda: len(fake.noted("started")) == 2)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "2 cases are left" in output
    fake.open_gate()
    time.sleep(0.3)
    assert set(fake.noted("done")) == set(fake.records())
    assert len(fake.records()) == 1


@pytest.mark.thorough
def test_worker_of_a_cluster_is_killed(fake):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as c:
        process = fake.start("--trials", "3", "--scheduler", c.scheduler_address)
        wait_for(lambda: len(fake.noted("started")) == 3 and len(fake.records()) == 1)
        # the worker that has run the first case, whose record is there, and is now at another one
        os.kill(int((fake.folder / "parent-0").read_text()), signal.SIGKILL)
        wait_for(lambda: max(fake.noted("started").values()) == 2)  # the case begins anew
        fake.open_gate()
        process.communicate(timeout=60)
    assert process.returncode == 0
    records = fake.records()
    assert len(records) == 3
    assert all(record["result"]["finished"] for record in records.values())
    assert fake.noted("done") == dict.fromkeys(records, 1)


@pytest.mark.parametrize(
    ("method", "timeout", "status", "reason"),
    [
        ("raises", 60, "failed", "ValueError: no luck"),
        ("dies", 60, "failed", "the process ended by signal SIGSEGV"),
        ("slow", 1, "timed out", "no result after 1 s"),
    ],
)
def test_failures_become_records(fake, method, timeout, status, reason):
    record = launch(fake_case(method), Options(timeout=timeout, methods="fake_methods"))
    assert record["config"] == fake_case(method).as_dict()
    assert not record["result"]["finished"]
    assert (record["result"]["status"], record["result"]["reason"]) == (status, reason)
    assert str(ROOT) not in to_line(record)


def test_record_says_how_the_run_was_done(fake):
    record = launch(fake_case("gated"), Options(jobs=3, methods="fake_methods"))
    assert {"config", "result", "versions", "machine", "commit", "date"} <= set(record)
    assert {"python", "numpy", "scipy", "sympy", "leastaction"} <= set(record["versions"])
    assert set(record["machine"]) == {"processor", "cores", "system", "parallel_runs"}
    assert record["machine"]["parallel_runs"] == 3
    result = record["result"]
    assert result["settings"] == {"threads": "1"}
    assert result["wall_s"] < 0.5  # of solve() alone: the process takes longer to import anything
    assert 30 < result["start_mb"] <= result["peak_mb"] < 400


def test_absent_methods_and_dry_run(fake):
    options = [*COMMAND, "--trials", "1", "--dry-run", "--results", str(fake.results)]
    answer = CliRunner().invoke(main, options)
    assert answer.exit_code == 0
    assert "absent is left out: No module named 'nowhere'\n" in answer.output
    assert "4 cases, 0 of them done already" in answer.output
    assert fake_case("dies").key in answer.output
    assert not fake.results.exists()


def test_unknown_method_is_named():
    answer = CliRunner().invoke(main, ["--method", "magic", "--dry-run"])
    assert answer.exit_code == 2
    assert "'magic' is unknown" in answer.output


def test_failed_runs_are_open_only_if_asked(tmp_path):
    cases = [fake_case("gated", trial) for trial in range(3)]
    documents = [
        {"config": case.as_dict(), "result": {"finished": finished}}
        for case, finished in zip(cases, (True, False), strict=False)
    ]
    # the two former layouts
    (tmp_path / f"{cases[0].key}.json").write_text(json.dumps(documents[0]))
    (tmp_path / "gated.jsonl").write_text(json.dumps(documents[1]) + "\n")
    store = store_of(tmp_path)
    assert open_cases(cases, store) == cases[2:]
    assert open_cases(cases, store, retry_failed=True) == cases[1:]
    store.append({"config": cases[1].as_dict(), "result": {"finished": True}})
    assert open_cases(cases, store, retry_failed=True) == cases[2:]
    assert (tmp_path / "runs.jsonl").read_text().count("\n") == 1


def test_cases_of_the_tables():
    methods = [("ours", ""), ("adam", ""), ("sindy", "")]
    table = settings("2", methods, [0.0])
    assert len(table) == 5  # A and B by both, C by Adam alone
    assert (("adam", "no-regularisation"), 0.0) in table
    assert not any(method[0] == "sindy" for method, _ in table)
    assert settings("2", [*methods, ("adam", "no-regularisation")], [0.0]) == table
    cases = build_cases(table, ["single_pendulum", "magnetic_pendulum"], [0.0, 0.1], trials=3)
    assert len({case.key for case in cases}) == len(cases) == 5 * 2 * 2 * 3
    assert [case.trial for case in cases] == sorted(case.trial for case in cases)
    assert len(settings("1", methods, [0.0])) == 3


# ------------------------------------------------------------------------------------ the search for settings
def test_more_tries_keep_those_before():
    few, many = search_adam.draws(9), search_adam.draws(14)
    assert many[:9] == few
    assert len({repr(draw) for draw in many}) == 14


def record(options, l2, trial=500, system="single_pendulum"):
    return {
        "config": {"system": system, "noise": 0.1, "trial": trial},
        "options": options,
        "result": {"l2": l2},
    }


def test_best_is_the_smallest_geometric_mean_over_data_sets():
    steady, lucky = {"threshold": 0.1}, {"threshold": 0.2}
    found = search_adam.best(
        [record(steady, 0.02), record(lucky, 0.001), record(steady, 0.02, 501), record(lucky, 1.0, 501)]
    )
    entry = found["single_pendulum"]["0.1"]
    assert entry["options"] == steady
    assert entry["l2"] == pytest.approx(0.02)
    assert (entry["tries"], entry["data_sets"]) == (2, 2)


def test_search_resumes_and_keeps_the_settings_of_other_cells(tmp_path, monkeypatch):
    settings, runs = tmp_path / "settings.json", []
    settings.write_text(
        json.dumps({"double_pendulum": {"0": {"l2": 1.0}}, "single_pendulum": {"0": {"l2": 2.0}}})
    )

    def attempt(case, options):
        runs.append(options)
        error = abs(options.threshold - 0.15) + (0.1 if options.knots_per_second else 0.2)
        return {"l2": error, "exact": False, "status": "ok", "wall_s": 0.0}

    monkeypatch.setattr(search_adam, "SETTINGS", settings)
    monkeypatch.setattr(search_adam, "attempt", attempt)
    monkeypatch.setattr(search_adam, "_default_knots", lambda system, noise: 10.0)
    for tries in (4, 6):
        arguments = [
            "--tries",
            str(tries),
            "--data-sets",
            "2",
            "--system",
            "single_pendulum",
            "--noise",
            "0.1",
        ]
        done = CliRunner().invoke(search_adam.main, [*arguments, "--folder", str(tmp_path / "tries")])
        assert done.exit_code == 0, done.output
    assert len(runs) == 12
    found = json.loads(settings.read_text())
    assert found["double_pendulum"] == {"0": {"l2": 1.0}}
    assert set(found["single_pendulum"]) == {"0", "0.1"}
    chosen = found["single_pendulum"]["0.1"]["options"]
    assert (chosen["threshold"], chosen["knots_per_second"]) == (0.15, 20.0)


# ---------- the figures of reproduction/: right basins, right forecasts, right errors, and files that repeat
MAGNETIC = Case("magnetic_pendulum", 0.01, "ours")
DAMPING = 0.2


@pytest.fixture
def posed(monkeypatch):
    monkeypatch.setattr(problem, "DURATION", 1.0)
    return pose(MAGNETIC)


@pytest.fixture
def field(posed):
    return field_of(posed.system.lagrangian_expression, damping(posed, DAMPING), posed)


def _states(n=50):
    return np.random.default_rng(3).uniform(-2.0, 2.0, (4, n))


def test_the_field_of_a_discovered_model_is_the_model_s_own_acceleration(monkeypatch):
    monkeypatch.setattr(problem, "DURATION", 4.0)
    posed, answer = pose(MAGNETIC), methods.load("ours").solve(pose(MAGNETIC))
    field = field_of(lagrangian_of(posed, answer), damping(posed, 0.15), posed)
    x, y, vx, vy = _states()
    q, qdot = np.stack([x, y], axis=1), np.stack([vx, vy], axis=1)
    expected = answer.acceleration(q, qdot, -0.15 * qdot)
    np.testing.assert_allclose(np.stack(field.acceleration(x, y, vx, vy), axis=1), expected, rtol=1e-12)


def test_terms_that_couple_the_velocities_reach_the_field(posed):
    found = {**posed.true_coefficients, "x_dot*y_dot": 0.2, "x*y_dot": 0.3, "x_dot**2": 0.5}
    system = replace(posed.system, lagrangian=found).with_dissipation({"x_dot**2": 0.1, "y_dot**2": 0.1})
    lagrangian = lagrangian_of(posed, Answer({k: found[k] for k in found if k != "x_dot**2"}, None))
    field = field_of(lagrangian, damping(posed, 0.2), posed)
    x, y, vx, vy = _states()
    q, qdot = np.stack([x, y], axis=1), np.stack([vx, vy], axis=1)
    got = np.stack(field.acceleration(x, y, vx, vy), axis=1)
    np.testing.assert_allclose(got, system.acceleration(q, qdot), rtol=1e-12)
    np.testing.assert_allclose(field.energy(x, y, vx, vy), system.energy(q, qdot), rtol=1e-12)


def test_a_method_without_a_lagrangian_has_no_basins(posed):
    with pytest.raises(ValueError, match="gave no Lagrangian"):
        lagrangian_of(posed, Answer(None, None))


def test_motions_end_where_an_adaptive_integrator_finds_them(field):
    found = map_basins(field, pixels=4)
    side = centres(4, 2.0)
    for row, column in ((0, 0), (0, 2), (1, 0), (2, 3), (3, 1)):
        start = (side[column], side[row], 0.0, 0.0)
        run = solve_ivp(
            lambda _, s: [*s[2:], *field.acceleration(*s)], (0, 40), start, "DOP853", rtol=1e-8, atol=1e-8
        )
        distance = np.hypot(*(MAGNETS - run.y[:2, -1]).T)
        assert distance.min() < 0.1
        assert found.magnet[row, column] == distance.argmin()


def test_steps_converge_with_the_fourth_power_of_their_length(field):
    start = np.array([1.3, 0.9, 0.5, -0.5])
    run = solve_ivp(
        lambda _, s: [*s[2:], *field.acceleration(*s)], (0, 1), start, "DOP853", rtol=1e-12, atol=1e-13
    )
    errors = [
        np.abs(_figure_basins._advance(field, start[:, None], h, round(1 / h))[:, 0] - run.y[:, -1]).max()
        for h in (0.02, 0.01)
    ]
    assert errors[0] < 1e-5
    assert errors[0] / errors[1] > 14


def test_the_true_map_has_the_symmetry_of_the_magnets(field):
    found = map_basins(field, pixels=40).magnet
    mirrored = np.array([0, 2, 1])[found[::-1]]
    assert np.mean(found == mirrored) > 0.99
    assert set(np.unique(found)) == {0, 1, 2}


def test_a_start_at_a_magnet_is_captured_at_once_and_far_starts_are_not(field):
    found = map_basins(field, pixels=41)  # 41: a pixel's centre lies at the middle of the square
    side = centres(41, 2.0)
    for k, (x, y) in enumerate(MAGNETS):
        here = np.argmin(np.abs(side - y)), np.argmin(np.abs(side - x))
        assert found.magnet[here] == k
        assert found.time[here] == 0.0
    assert found.time[0, 0] > 1.0


def test_the_size_of_the_working_set_does_not_matter(field, monkeypatch):
    whole = map_basins(field, pixels=8)
    monkeypatch.setattr(_figure_basins, "_AT_ONCE", 7)
    pieces = map_basins(field, pixels=8)
    np.testing.assert_array_equal(pieces.magnet, whole.magnet)
    np.testing.assert_array_equal(pieces.time, whole.time)


def test_without_damping_nothing_settles_from_afar(posed, monkeypatch):
    monkeypatch.setattr(_figure_basins, "_LONGEST", 5.0)
    field = field_of(posed.system.lagrangian_expression, damping(posed, 0.0), posed)
    found = map_basins(field, pixels=4)
    assert found.magnet[0, 0] == UNDECIDED
    assert np.isinf(found.time[0, 0])


def test_undecided_motions_agree_with_nothing():
    def basin(*magnets):
        return Basins(np.array(magnets).reshape(2, 2), np.zeros((2, 2)), 2.0, 0.01)

    assert agreement(basin(0, 1, 2, -1), basin(0, 1, 1, -1)) == 0.5


def test_following_a_motion():
    t = np.linspace(0.0, 10.0, 101)
    spring = _figure_magnetic.follow(lambda q, qdot, f: -q, np.array([1.0, 2.0]), np.zeros(2), t)
    np.testing.assert_allclose(spring, np.outer(np.cos(t), [1.0, 2.0]), atol=1e-9)


@pytest.mark.parametrize(
    ("acceleration", "reached"),
    [
        (None, 0.0),
        (lambda q, qdot, f: np.nan * q, 0.0),
        (lambda q, qdot, f: 4.0 * q, 2.3),
    ],
    ids=["no model", "not a number", "diverges past 100"],
)
def test_following_stops_where_a_model_fails(acceleration, reached):
    t = np.linspace(0.0, 10.0, 101)
    path = _figure_magnetic.follow(acceleration, np.ones(2), np.zeros(2), t)
    last = t[np.isfinite(path).all(axis=1)][-1]
    assert last == pytest.approx(reached, abs=0.11)


@pytest.fixture
def fakes(monkeypatch):
    """Methods that know the truth: "ours" to a thousandth, "adam" to a twentieth; short data."""
    solved.cache_clear()
    load = methods.load

    def answer(posed, error):
        found = {k: c * (1 + error) for k, c in posed.true_coefficients.items() if k not in posed.known}
        system = replace(posed.system, lagrangian={**found, **posed.known})
        return Answer(found, system.acceleration)

    def with_curve(posed):
        wobble = 0.5 if posed.case.variant else 0.1
        shifted = [(m.t, m.q + wobble * m.q.std(), m.qdot, (1 + wobble) * m.qddot) for m in posed.truth]
        return answer(posed, 0.05), shifted

    modules = {
        "ours": SimpleNamespace(solve=lambda posed: answer(posed, 0.001)),
        "adam": SimpleNamespace(solve=lambda posed: answer(posed, 0.05), solve_with_curve=with_curve),
    }
    monkeypatch.setattr(methods, "load", lambda name: modules.get(name) or load(name))
    monkeypatch.setattr(problem, "DURATION", 4.0)
    monkeypatch.setattr(_figure_ablation, "WINDOW", (1.0, 3.0))
    monkeypatch.setattr(_figure_ablation, "STARTS", ((0.01, ""),))
    monkeypatch.setattr(_figure_magnetic, "LONG", 6.0)
    monkeypatch.setattr(_figure_basins, "OTHER_DAMPINGS", (0.2,))
    monkeypatch.setattr(_figure_basins, "STEP", 0.05)
    yield
    solved.cache_clear()


def test_the_ablation_reports_errors_over_the_spread_of_the_truth(fakes):
    (study,) = _figure_ablation.compute([(0.01, "")])
    q = np.concatenate([m.q for m in study.problem.truth])
    shift = 0.1 * np.sqrt(np.mean([m.q.std() ** 2 for m in study.problem.truth])) / q[:, 1].std()
    errors = study.fits["adam"].errors
    assert errors[0] == pytest.approx(shift, rel=0.01)
    assert errors[1] < 1e-12
    assert errors[2] == pytest.approx(0.1, rel=0.01)
    assert study.fits["no-regularisation"].errors[2] == pytest.approx(0.5, rel=0.01)
    assert max(study.fits["ours"].errors) < 0.05


@pytest.mark.thorough
def test_a_worse_model_forecasts_for_a_shorter_time(fakes):
    forecast = _figure_magnetic.compute(duration=12.0)
    assert 0.0 < forecast.horizons["adam"] < forecast.horizons["ours"] <= 12.0
    assert "leastaction holds for" in _figure_magnetic.caption(forecast)


def test_the_share_of_equal_pixels_is_what_the_maps_say(fakes):
    study = _figure_basins.compute(24, others=())
    for one, share in zip(study.maps, study.equal, strict=True):
        assert share == np.mean(one.magnet == study.truth.magnet)
    assert study.equal[-1] < study.equal[0] < 1.0
    assert _figure_basins.numbers(study)["equal"][label("ours", 0.01)] == study.equal[0]
    titles = [ax.get_title() for ax in _figure_basins.draw(study).axes]
    assert f"{100 * study.equal[0]:.1f} % of pixels equal" in titles


def test_png_files_have_a_pixel_for_every_start(fakes, tmp_path):
    study = _figure_basins.compute(20, models=(("ours", 0.01),), others=())
    write_png(_figure_basins.draw(study), tmp_path / "map.png", _figure_basins.dpi(20))
    with Image.open(tmp_path / "map.png") as image:
        assert image.mode == "P"
        assert image.width > 2 * 400


@pytest.mark.thorough
def test_main_writes_figures_numbers_and_captions(fakes, tmp_path, capsys):
    assert figures.main(["--output", str(tmp_path), "--pixels", "10"]) == 0
    files = sorted(p.name for p in tmp_path.iterdir())
    assert files == ["ablation.svg", "basins.png", "figures.json", "magnetic.svg"]
    records = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert list(records) == ["ablation", "magnetic", "basins"]
    share = records["basins"]["numbers"]["equal"][label("adam", 0.1)]
    assert f"{100 * share:.1f} %" in records["basins"]["caption"]
    assert records["basins"]["title"] == "Basins of attraction"
    assert "basins: " in capsys.readouterr().err


def test_the_same_numbers_give_the_same_bytes(fakes, tmp_path):
    forecast = _figure_magnetic.compute(duration=6.0)
    study = _figure_basins.compute(8, models=(("ours", 0.01),), others=())
    for folder in (tmp_path / "one", tmp_path / "two"):
        folder.mkdir()
        write_svg(_figure_magnetic.draw(forecast), folder / "a.svg")
        write_png(_figure_basins.draw(study), folder / "b.png", 200)
    for name in ("a.svg", "b.png"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert ElementTree.parse(tmp_path / "one" / "a.svg").getroot().tag.endswith("svg")


def test_one_figure_alone_leaves_the_records_of_the_others(fakes, tmp_path):
    (tmp_path / "figures.json").write_text('{"ablation": {"file": "a.svg", "caption": "old", "numbers": {}}}')
    assert figures.main(["--only", "basins", "--pixels", "4", "--output", str(tmp_path)]) == 0
    records = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert list(records) == ["ablation", "basins"]
    assert records["ablation"]["caption"] == "old"


def test_numbers_that_json_cannot_hold_become_null(fakes, tmp_path, monkeypatch):
    monkeypatch.setattr(
        _figure_magnetic, "solved", lambda case: (None, Answer({}, None, status="found nothing"))
    )
    assert figures.main(["--only", "magnetic", "--output", str(tmp_path)]) == 0
    models = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))["magnetic"]["numbers"][
        "models"
    ]
    assert models["ours"]["largest_error_first_5_s_m"] is None
    assert models["ours"]["horizon_s"] == 0.0


def test_systems_agree_on_where_the_magnets_are():
    system = systems.get("magnetic_pendulum")
    at_rest = np.zeros(2)
    for magnet in MAGNETS:
        pull = [np.linalg.norm(system.acceleration(s * magnet, at_rest)) for s in (0.97, 0.7)]
        assert pull[0] < 0.2 * pull[1]


# ------------------------- the peers that are packages of their own: PySINDy and Operon
def problem_of(system: str, noise: float = 0.0, **options):
    return pose(Case(system, noise, "sindy", **{"trajectories": 2, **options}))


def acceleration_error(acceleration, problem) -> float:
    """Relative to the size of the true accelerations, along the true motions."""
    wrong = [acceleration(m.q, m.qdot, m.forces) - m.qddot for m in problem.truth]
    return np.linalg.norm(np.concatenate(wrong)) / np.linalg.norm(
        np.concatenate([m.qddot for m in problem.truth])
    )


@peers
@pytest.mark.parametrize("name", ["sindy", "sindy_pi", "sindy_weak"])
def test_pysindy_finds_the_driven_pendulum(name, monkeypatch):
    problem = problem_of("single_pendulum")
    monkeypatch.setattr(sindy, "HALF_WIDTHS", (0.1,))
    answer = load(name).solve(problem)
    assert acceleration_error(answer.acceleration, problem) < 1e-5
    assert answer.coefficients is None
    assert answer.status == "ok"
    assert "theta_ddot" in answer.expression
    assert "sin(1 theta)" in answer.expression
    assert "f_theta" in answer.expression


@peers
def test_pysindy_is_told_the_magnets():
    problem = problem_of("magnetic_pendulum", trajectories=1)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    library, features, targets = shared.regression(problem, motions)
    found = np.linalg.lstsq(features, targets, rcond=None)[0].T
    assert acceleration_error(shared.model_acceleration(library, found), problem) < 1e-3


@peers
def test_implicit_equations_are_exactly_the_true_ones():
    problem = problem_of("double_pendulum", trajectories=5)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    features = sindy_pi._features(problem, motions)
    regression = sindy_pi.Regression("l1, refitted", 1e-5)
    settings = [sindy_pi.Setting(i, 0, "all", regression) for i in range(2)]
    with redirect_stdout(io.StringIO()):
        found = sindy_pi._regress(features, settings)
    rows = np.array([found[setting] for setting in settings])
    np.testing.assert_array_equal(np.count_nonzero(rows, axis=1), [5, 5])
    acceleration = sindy_pi._acceleration(features, rows)
    assert acceleration_error(acceleration, problem) < 1e-3
    lines = sindy_pi._equations(problem, features, settings, rows).splitlines()
    assert "theta2_ddot cos(1 theta1-1 theta2)" in lines[0]
    lost = acceleration(np.full((1, 2), np.nan), np.zeros((1, 2)), np.zeros((1, 2)))
    assert np.isnan(lost).all()


@peers
def test_smoothing_follows_the_noise():
    quiet, loud = (
        shared.choose_smoothers(problem_of("single_pendulum", noise).data)[0] for noise in (0.0, 0.1)
    )
    assert quiet.window <= 11
    assert loud.window >= 41


@peers
def test_missing_samples_are_filled():
    problem = problem_of("single_pendulum", missing=0.05)
    assert np.isnan(problem.data[0].q).any()
    smoothers = shared.choose_smoothers(problem.data)
    motion = shared.differentiate(problem.data, smoothers)[0]
    truth = problem.truth[0]
    here = np.searchsorted(truth.t, motion.t)
    assert np.abs(motion.q - truth.q[here]).max() < 1e-4
    assert np.abs(motion.qdot - truth.qdot[here]).max() < 1e-2


@peers
def test_forecasts_tell_good_models_from_bad_ones():
    problem = problem_of("single_pendulum", 0.02, missing=0.05)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    true = shared.forecast_error(problem.system.acceleration, motions)
    wrong = shared.forecast_error(lambda q, v, f: 0.5 * problem.system.acceleration(q, v, f), motions)
    none = shared.forecast_error(lambda q, v, f: np.full(q.shape, np.nan), motions)
    assert true < 0.1 < wrong < none
    assert none == pytest.approx(10.0)


@peers
def test_many_forecasts_at_once_are_the_same():
    problem = problem_of("double_pendulum", 0.02)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    library, features, targets = shared.regression(problem, motions)
    assert len(library.get_feature_names(shared.names(problem))) == features.shape[1]
    models = np.array([np.linalg.lstsq(features[a::3], targets[a::3], rcond=None)[0].T for a in range(3)])
    one_by_one = [shared.forecast_error(shared.model_acceleration(library, m), motions[:1]) for m in models]
    np.testing.assert_allclose(shared.forecast_errors(library, models, motions[:1]), one_by_one, rtol=1e-6)


@peers
def test_compressed_data_have_the_same_solution():
    rng = np.random.default_rng(0)
    features = rng.standard_normal((400, 12))
    targets = features[:, :2] @ rng.standard_normal((2, 3)) + 0.1 * rng.standard_normal((400, 3))
    full, small = (
        ps.STLSQ(threshold=0.05, alpha=0.5, normalize_columns=True, unbias=False).fit(*data).coef_
        for data in ((features, targets), shared.compress(features, targets))
    )
    assert np.count_nonzero(full) > 0
    np.testing.assert_allclose(small, full, atol=1e-10)


@peers
def test_simplest_model_of_the_best():
    assert shared.simplest(np.array([1.0, 1.005, 1.2]), np.array([9, 3, 1])) == 1


@peers
def test_one_trajectory_is_split_into_fifths():
    problem = problem_of("single_pendulum", trajectories=1)
    motions = shared.differentiate(problem.data, shared.choose_smoothers(problem.data))
    for train, test in shared.folds(motions):
        assert len(train) == 4
        assert not set(test[0].t) & set(np.concatenate([m.t for m in train]))


@peers
def test_operon_finds_the_driven_pendulum_and_repeats_itself():
    problem = problem_of("single_pendulum")
    options = {"population_size": 300, "generations": 15}
    first, second = (operon.solve(problem, **options) for _ in range(2))
    assert acceleration_error(first.acceleration, problem) < 0.05
    assert first.expression == second.expression
    assert first.expression.startswith("theta_ddot = ")
    assert first.coefficients is None
    lost = first.acceleration(np.array([[np.nan]]), np.zeros((1, 1)), np.zeros((1, 1)))
    assert np.isnan(lost).all()


@peers
def test_operon_with_given_rates():
    options = {"population_size": 300, "generations": 15}
    given = operon.solve(problem_of("single_pendulum", 0.01, variant="given-rates"), **options)
    assert given.settings["generations"] == 15
    assert acceleration_error(given.acceleration, problem_of("single_pendulum")) < 0.05
    with pytest.raises(ValueError, match="variant 'other' is unknown; use given-rates"):
        operon.solve(problem_of("single_pendulum", variant="other"))


@peers
def test_operon_is_given_a_root_when_the_library_has_one():
    problem = problem_of("magnetic_pendulum", trajectories=1)
    answer = operon.solve(problem, population_size=20, generations=1)
    assert answer.settings["allowed_symbols"].endswith(",sqrt")
