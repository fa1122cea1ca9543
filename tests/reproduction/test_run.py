"""The runner of reproduction/: one record for each case, whatever is killed; and the search for settings."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from reproduction import problem, search_adam
from reproduction._execute import Options, launch
from reproduction._results import store_of
from reproduction.problem import Case
from reproduction.run import build_cases, main, settings
from runner.course import open_cases
from runner.machine import ROOT
from runner.store import to_line

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
