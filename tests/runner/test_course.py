"""The course of runs: what is open is run, what ends is kept, and what stops the runs is said."""

from __future__ import annotations

import io
import json

import click
import pytest
from rich.console import Console

from runner.course import carry_out
from runner.store import Store
from studies.case import Case

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
