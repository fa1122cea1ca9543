"""The runner: its store loses no record, whoever is killed or writes too; what is open is run and kept."""

from __future__ import annotations

import io
import json
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import numpy as np
import pytest
from rich.console import Console

from runner.machine import ROOT
from runner.store import RecordError, Store, carry_out, to_line
from studies.case import Case


def case(trial: int, study: str = "single") -> Case:
    return Case(study, "single_pendulum", 0.1, trial=trial)


def record(trial: int, study: str = "single", **result) -> dict:
    return {"config": case(trial, study).as_dict(), "result": {"finished": True, **result}}


def trials(records: list[dict]) -> list[int]:
    return [r["config"]["trial"] for r in records]


@pytest.fixture
def store(tmp_path) -> Store:
    return Store(tmp_path / "new", Case.from_dict, say=pytest.fail)


# ------------------------------------------------------------------------------------------ lines


def test_a_line_holds_what_json_can_hold_in_the_sequence_given():
    document = {
        "z": float("nan"),
        "b": np.float64(1.5),
        "c": np.arange(2),
        "d": np.bool_(True),
        "a": (1, None),
    }
    text = to_line(document | {"text": "θ\n\u2028é"})
    assert "\n" not in text
    back = json.loads(text)
    assert back == {"z": None, "b": 1.5, "c": [0, 1], "d": True, "a": [1, None], "text": "θ\n\u2028é"}
    assert list(back) == [*document, "text"]


def test_records_come_back_sorted_and_the_last_of_a_case_holds(store):
    for trial, value in ((2, 0), (10, 1), (2, 2), (0, 3)):
        store.append(record(trial, value=value))
    found = store.read()
    assert trials(found) == [0, 10, 2]  # by name
    assert [r["result"]["value"] for r in found] == [3, 1, 2]
    assert len(store.path("single").read_bytes().splitlines()) == 4
    store.tidy("single")
    lines = [json.loads(line) for line in store.path("single").read_text().splitlines()]
    assert lines == found == store.read()
    before = store.path("single").stat()
    store.tidy("single", "faults")  # nothing to be done, and no such file
    after = store.path("single").stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    assert [path.name for path in store.folder.iterdir()] == ["single.jsonl"]


def test_every_part_has_its_own_file(store):
    store.append(record(0))
    store.append(record(1, "faults"))
    assert trials(store.read("single")) == [0]
    assert trials(store.read("faults", "single")) == [1, 0]
    assert trials(store.read()) == [1, 0]


def test_the_former_layout_is_read_and_a_line_comes_before_it(store):
    for trial in (0, 1):
        path = store.folder / f"{case(trial).key}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(record(trial, value="file"), indent=1))
    store.append(record(1, value="line"))
    store.append(record(2, value="line"))
    for found in (store.read(), store.read("single")):
        assert [r["result"]["value"] for r in found] == ["file", "line", "line"]
    assert store.read("faults") == []


def test_one_file_holds_all_parts_and_a_file_of_one_part_is_still_read(store):
    for trial, study in ((0, "single"), (1, "single"), (1, "faults")):
        store.append(record(trial, study, value="file a part"))
    former = {path.name: path.read_bytes() for path in store.folder.iterdir()}
    together = Store(store.folder, Case.from_dict, say=pytest.fail, single="runs")
    together.append(record(2, value="one file"))
    together.append(record(1, value="one file"))
    together.tidy("single", "faults")
    assert together.path("single") == together.path("faults") == store.folder / "runs.jsonl"
    assert [r["result"]["value"] for r in together.read("single")] == ["file a part", "one file", "one file"]
    assert trials(together.read("single")) == [0, 1, 2]
    assert trials(together.read("faults")) == [1]
    assert trials(together.read()) == [1, 0, 1, 2]
    assert trials([json.loads(line) for line in together.path("").read_text().splitlines()]) == [1, 2]
    assert {name: (store.folder / name).read_bytes() for name in former} == former


@pytest.mark.parametrize(
    "line", ["{}", "no json", '{"config": {"colour": 1}, "result": {"finished": true}}', ""]
)
def test_a_line_that_is_no_record_is_named(store, line):
    store.append(record(0))
    with store.path("single").open("a") as file:
        file.write(line + "\n")
    before = store.path("single").read_bytes()
    for action in (store.read, store.tidy):
        with pytest.raises(RecordError, match=r"single\.jsonl, line 2, is not the record of a run: "):
            action("single")
    assert store.path("single").read_bytes() == before


# ------------------------------------------------------------------------------------------ bad moments


def test_an_unfinished_line_is_dropped_wherever_it_ends(tmp_path):
    said: list[str] = []
    store = Store(tmp_path, Case.from_dict, said.append)
    path = store.path("single")
    store.append(record(0))
    whole = path.read_bytes()
    store.append(record(1, text="θ"))
    both = path.read_bytes()
    for length in (*range(len(whole) + 1, len(both) - 12, 7), *range(len(both) - 12, len(both))):
        said.clear()
        path.write_bytes(both[:length])
        assert trials(store.read()) == [0]
        assert said == [f"{path}: its last line is unfinished and is left out"]
        store.append(record(2))
        assert trials(store.read()) == [0, 2]
        path.write_bytes(both[:length])
        store.tidy("single")
        assert path.read_bytes() == whole
        assert said[1:] == [f"{path}: its last line is unfinished and is dropped; that run is made again"] * 2
    path.write_bytes(both[: len(whole) // 2])  # there was no line before it
    store.append(record(1, text="θ"))
    assert path.read_bytes() == both[len(whole) :]


def test_a_full_disk_leaves_whole_lines(store):
    store.append(record(0))
    before = store.path("single").read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 100, hard))
    try:
        with pytest.raises(OSError, match="No space left"):
            store.append(record(1, text="x" * 1000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert store.path("single").read_bytes() == before


# Adds long records, sorts after every third, and says which have been added.
WRITER = """
import sys
from pathlib import Path
from runner.store import Store
from studies.case import Case

folder, first, last, length = sys.argv[1], *map(int, sys.argv[2:])
store = Store(Path(folder), Case.from_dict, say=lambda text: None)
for trial in range(first, last):
    config = Case("single", "single_pendulum", 0.1, trial=trial).as_dict()
    store.append({"config": config, "result": {"finished": True, "text": f"{trial} " * length}})
    print(trial, flush=True)
    if trial % 3 == 0:
        store.tidy("single")
"""


def writer(folder: Path, first: int, last: int, length: int) -> subprocess.Popen:
    command = [sys.executable, "-c", WRITER, *map(str, (folder, first, last, length))]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)


def test_a_killed_writer_loses_nothing_that_it_has_added(tmp_path, rng):
    store = Store(tmp_path, Case.from_dict, say=lambda text: None)
    added: list[int] = []
    for first in range(0, 3000, 1000):
        process = writer(tmp_path, first, first + 1000, 20_000)
        added += [int(process.stdout.readline()) for _ in range(5)]  # it also sorts meanwhile
        time.sleep(rng.uniform(0.0, 0.1))
        process.send_signal(signal.SIGKILL)
        added += map(int, process.communicate()[0].split())
        store.tidy("single")
        found = store.read()
        assert set(added) <= set(trials(found))
        assert len(found) <= len(added) + 1 + first // 1000  # the one that was not yet said, each time
        assert all(set(r["result"]["text"].split()) == {str(r["config"]["trial"])} for r in found)
    assert len(added) >= 15
    assert [path.name for path in tmp_path.iterdir()] == ["single.jsonl"]


def test_writers_at_the_same_time_keep_each_other_s_records(tmp_path):
    processes = [writer(tmp_path, first, first + 60, 500) for first in (0, 100, 200)]
    added = [int(trial) for process in processes for trial in process.communicate(timeout=60)[0].split()]
    assert [process.returncode for process in processes] == [0, 0, 0]
    assert len(added) == 180
    store = Store(tmp_path, Case.from_dict, say=pytest.fail)
    store.tidy("single")
    assert sorted(trials(store.read())) == sorted(added)
    assert [path.name for path in tmp_path.iterdir()] == ["single.jsonl"]


# ----------------------------------------------------------------------------------------- the course of runs
CASES = [Case("single", "single_pendulum", 0.1, trial=trial) for trial in (2, 0, 1)]


class Course:
    """A stand-in for the processes of runs: what it raises at a trial, and what was asked of it."""

    def __init__(self, folder, stop: dict[int, BaseException] | None = None) -> None:
        self.store, self.stop = Store(folder, Case.from_dict), stop or {}
        self.asked: list[list[int]] = []
        self.closed = 0
        self.console = Console(file=io.StringIO(), width=200)

    def outcomes(self, cases):
        self.asked.append([c.trial for c in cases])
        try:
            for case in cases:
                if case.trial in self.stop:
                    raise self.stop[case.trial]
                yield case, {"config": case.as_dict(), "result": {"finished": case.trial != 0}}
        finally:
            self.closed += 1

    def run(self, **options) -> list[dict]:
        def line(case, result):
            return f"trial {case.trial}: {result['finished']}"

        return carry_out(CASES, self.store, self.outcomes, line, self.console, **options)

    @property
    def said(self) -> str:
        return self.console.file.getvalue()

    def lines(self) -> list[int]:
        text = self.store.path("single").read_text()
        return [json.loads(line)["config"]["trial"] for line in text.splitlines()]


def test_records_are_kept_and_sorted_and_nothing_is_run_twice(tmp_path):
    course = Course(tmp_path)
    assert [r["config"]["trial"] for r in course.run()] == [2, 0, 1]
    assert course.lines() == [0, 1, 2]
    for part in ("3 cases, 0 of them done", "trial 0: False", "2 finished, 1 failed; records in"):
        assert part in course.said
    assert course.run() == []
    course.run(retry_failed=True)
    assert course.asked == [[2, 0, 1], [], [0]]
    assert course.lines() == [0, 1, 2]


def test_a_dry_run_names_the_cases_and_changes_nothing(tmp_path):
    course = Course(tmp_path / "none")
    assert course.run(dry_run=True) == []
    assert [line.strip() for line in course.said.splitlines()[1:]] == [case.key for case in CASES]
    assert not course.asked
    assert not (tmp_path / "none").exists()
    path = Store(tmp_path, Case.from_dict).path("single")
    path.write_text("half a li")
    Course(tmp_path).run(dry_run=True)
    assert path.read_text() == "half a li"


@pytest.mark.parametrize(
    ("stop", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "interrupted; 1 cases are left: the same command goes on"),
        (
            ConnectionError("the scheduler has gone away"),
            2,
            "ended early: the scheduler has gone away; the same",
        ),
    ],
)
def test_what_stops_the_runs_is_said_and_what_has_ended_is_kept(tmp_path, stop, code, said):
    course = Course(tmp_path, {1: stop})
    with pytest.raises(SystemExit) as end:
        course.run()
    assert end.value.code == code
    assert said in course.said
    assert course.lines() == [0, 2]
    assert course.closed == 1
    again = Course(tmp_path)
    again.run()
    assert again.asked == [[1]]
    assert course.lines() == [0, 1, 2]


def test_runs_end_when_a_record_cannot_be_written(tmp_path, monkeypatch):
    course = Course(tmp_path)

    def full(self, record):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Store, "append", full)
    with pytest.raises(SystemExit) as end:
        course.run()
    assert end.value.code == 2
    assert "No space left on device" in course.said
    assert course.closed == 1


def test_a_file_that_holds_something_else_is_named_before_anything_is_run(tmp_path):
    course = Course(tmp_path)
    course.store.path("single").write_text("{}\n")
    with pytest.raises(click.ClickException, match=r"single\.jsonl, line 1, is not the record of a run"):
        course.run()
    assert not course.asked
