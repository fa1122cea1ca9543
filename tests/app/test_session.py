"""The app's worker process and its session: cancelling, failures, uploads, from a file to the downloads."""

from __future__ import annotations

import gzip
import io
import json
import math
import time
import zipfile
from dataclasses import replace

import pytest

import leastaction as la
import page_helpers
from leastaction import InputError
from leastaction.app import files as _files
from leastaction.app import session as _session
from leastaction.app.candidates import Choice
from leastaction.app.columns import (
    ANGLE,
    COORDINATE,
    DEGREES,
    FORCE,
    MILLISECONDS,
    TIME,
    TRIAL,
    UNUSED,
    VELOCITY,
)
from leastaction.app.session import EXAMPLES, Session, in_words
from leastaction.app.worker import Worker
from leastaction.exporters.formats import FORMATS
from leastaction.model.model import ModelTerm


def wait(job, seconds: float = 60.0):
    end = time.monotonic() + seconds
    while job.state == "running" and time.monotonic() < end:
        time.sleep(0.02)
    return job


@pytest.fixture(scope="module")
def worker():
    """One for all tests: a process takes a second to start, and none may spoil it for the next job."""
    worker = Worker()
    yield worker
    worker.close()


@pytest.fixture
def session():
    session = Session()
    yield session
    session.close()
    assert not session.folder.exists()


# worker


def test_a_job_reports_and_returns(worker):
    job = wait(worker.start(page_helpers.count_to, 5))
    assert (job.state, job.result, job.stage, job.details) == ("done", 5, "count", {"terms": 4.0})
    assert [name for name, _ in job.stages] == ["count"]
    first = worker._process.pid
    assert wait(worker.start(page_helpers.count_to, 2)).result == 2
    assert worker._process.pid == first


def test_cancel_stops_the_process_at_once_and_the_next_job_runs(worker):
    job = worker.start(page_helpers.sleep, 600.0)
    while job.stage != "asleep":
        time.sleep(0.02)
    process = worker._process
    began = time.monotonic()
    worker.cancel()
    assert time.monotonic() - began < 5.0
    assert job.state == "cancelled"
    assert not worker.busy
    assert not process.is_alive()
    assert wait(worker.start(page_helpers.count_to, 3)).result == 3
    assert job.state == "cancelled"


def test_a_new_job_replaces_the_old_one(worker):
    first = worker.start(page_helpers.sleep, 600.0)
    second = wait(worker.start(page_helpers.count_to, 1))
    assert (first.state, second.state) == ("cancelled", "done")


@pytest.mark.parametrize(
    ("function", "arguments", "text"),
    [
        (page_helpers.fail, ("no such\ncolumn",), "no such column"),
        (page_helpers.break_down, (), "a fault of leastaction itself: KeyError"),
        (page_helpers.die, (), "stopped unexpectedly"),
        (page_helpers.count_to, (lambda: None,), "a fault of leastaction itself"),
    ],
)
def test_failures_are_one_line(worker, function, arguments, text):
    job = wait(worker.start(function, *arguments))
    assert job.state == "failed"
    assert text in job.message
    assert "\n" not in job.message
    assert wait(worker.start(page_helpers.count_to, 1)).result == 1


# session


def swing(start: float, rows: int = 60, name: str = "x") -> bytes:
    lines = [f"t,{name},{name}_dot"] + [
        f"{0.02 * k:.2f},{start * math.cos(0.06 * k)!r},{-3 * start * math.sin(0.06 * k)!r}"
        for k in range(rows)
    ]
    return "\n".join(lines).encode()


def test_several_files_are_trials_of_one_system(session):
    given = [("b.csv", swing(0.5)), ("a.csv", swing(1.0)), ("sub/a.csv", swing(2.0))]
    session.open_uploads(given)
    assert list(session.data.names) == ["a", "a_2", "b"]
    assert [run.q[0, 0] for run in session.data] == [1.0, 2.0, 0.5]
    assert session.title == "a.csv and 2 more"
    with pytest.raises(InputError, match=r"c\.csv has other columns than b\.csv"):
        session.open_uploads([("b.csv", swing(0.5)), ("c.csv", swing(0.5, name="y"))])
    assert len(session.data) == 3  # what was open is still open


def test_measured_velocities_have_a_role(session):
    session.open_upload("run.csv", swing(1.0))
    assert session.roles == {"t": TIME, "x": COORDINATE, "x_dot": UNUSED}
    session.roles["x_dot"] = f"{VELOCITY}x"
    session.read()
    assert session.fault == ""
    (rate,) = session.data.rates
    assert (rate.quantity, rate.coordinate) == ("velocity", 0)
    session.roles["x"] = UNUSED
    session.read()
    assert "no column is a coordinate" in session.fault


def test_a_session_is_saved_and_opened_again(session):
    session.open_uploads([("a.csv", swing(1.0)), ("b.csv", swing(0.5))])
    session.roles["x_dot"] = f"{VELOCITY}x"
    session.read()
    session.choice.text, session.choice.written, session.choice.held_out = "x_dot**2\nx**2", True, 1
    session.choice.friction = ["x_dot**2/2"]
    content = session.save()
    other = Session()
    try:
        other.open_upload("mine.leastaction", content)
        assert (other.title, other.roles, other.choice) == (session.title, session.roles, session.choice)
        assert other.data.digest() == session.data.digest()
        assert "find the Lagrangian again" in other.hint
        other.open_example("single")
        assert other.hint == ""
    finally:
        other.close()


@pytest.mark.parametrize(
    "change",
    [
        {"choice": {"held_out": "many"}},
        {"tables": ["../../etc/passwd"]},
        {"tables": []},
        {"roles": 3},
        {"leastaction session": 99},
    ],
)
def test_a_damaged_session_is_refused(session, change):
    session.open_upload("a.csv", swing(1.0))
    with zipfile.ZipFile(io.BytesIO(session.save())) as file:
        members = {name: file.read(name) for name in file.namelist()}
    said = json.loads(members["session.json"]) | change
    members["session.json"] = json.dumps(said).encode()
    with pytest.raises(InputError, match="session cannot be opened"):
        session.open_upload("b.leastaction", _files.archive(members))
    with pytest.raises(InputError, match="session cannot be opened"):
        session.open_upload("b.leastaction", b"PK nothing")
    assert session.title == "a.csv"


def test_every_export_is_in_the_archive():
    model = la.LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
    with zipfile.ZipFile(io.BytesIO(_files.everything(model, {"note.txt": "hello"}))) as file:
        names, said = set(file.namelist()), file.read("README.txt").decode()
        assert file.read("note.txt") == b"hello"
        assert b"def acceleration" in file.read("leastaction_model.py")
    assert list(_files.ENDINGS) == list(FORMATS)
    for name, ending in _files.ENDINGS.items():
        assert f"leastaction_model{ending}" in names or f"{name}: left out, " in said


def test_from_upload_to_download(session, tmp_path):
    path = page_helpers.driven_pendulum(tmp_path / "my run.csv")
    session.open_upload("my run.csv", path.read_bytes())
    assert list(session.roles.values()) == [TRIAL, TIME, ANGLE, FORCE + "theta"]
    assert session.title == "my run.csv"
    assert session.data is not None
    assert session.data.driven
    assert session.smooth().noise_std[0] > 0
    session.choice.size = "compact"
    session.choice.friction = ["theta_dot**2/2"]
    job = wait(session.discover())
    assert job.message == ""
    assert session.collect()
    found = session.current
    assert found is session.best
    free = {t.expression: t.coefficient for t in found.model.terms}
    assert set(free) == {"theta_dot**2", "cos(theta)"}
    assert free["cos(theta)"] == pytest.approx(9.81, rel=0.02)
    assert found.motion is not None
    assert found.motion.held_out
    # what the page shows of the law was computed in the worker
    assert {"symmetries", "simple_constants"} <= found.model.__dict__.keys()
    assert session.walk.points[session.place].chosen
    assert "<!DOCTYPE html>" in session.write_report()
    (tmp_path / "model.json").write_text(session.write_model(), encoding="utf-8")
    assert la.load(tmp_path / "model.json").to_dict() == found.model.to_dict()


def until(session, condition, seconds: float = 60.0) -> None:
    """Do what the page does: look every now and then for what has arrived."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        session.collect()
        time.sleep(0.02)
    assert condition()


def free_terms(model: la.LagrangianModel) -> dict[str, float]:
    return {t.expression: t.coefficient for t in (*model.terms, *model.dissipation) if not t.known}


@pytest.fixture(scope="module")
def discovered():
    """A session with a discovery and its forecast done."""
    session = Session()
    session.open_example("single")
    session.discover()
    until(session, lambda: bool(session.found) and not session.waiting)
    yield session
    session.close()
    assert not session.folder.exists()


@pytest.fixture
def walking(discovered):
    """The session as the discovery has left it."""
    walk, best = discovered.walk, discovered.best
    yield discovered
    discovered.stop()
    discovered.job, discovered._job_place = None, None
    discovered.found, discovered.faults = {walk.chosen: best}, {}
    discovered.walk, discovered.place = walk, walk.chosen


def test_a_step_is_answered_at_once_and_refined_behind(walking):
    best, chosen = walking.best, walking.walk.chosen
    assert best.stage == "forecast"
    point = walking.walk.points[chosen + 1]
    began = time.perf_counter()
    job = walking.go_to(chosen + 1)
    assert time.perf_counter() - began < 0.5
    assert job.state == "running"
    first = walking.current
    assert (first.stage, first.motion, first.validation) == ("provisional", None, None)
    assert free_terms(first.model) == dict(zip(point.expressions, point.coefficients, strict=True))
    until(walking, lambda: walking.current.stage == "fitted")
    second = walking.current.model
    assert walking.waiting
    assert set(free_terms(second)) == set(point.expressions)
    assert second.covariance is not None
    until(walking, lambda: not walking.waiting)
    third = walking.current
    assert third.model.to_dict() == second.to_dict()
    assert third.stage == "forecast"
    assert third.motion is not None
    assert third.motion.held_out
    assert walking.job is None
    assert walking.go_to(chosen) is None
    assert walking.current is best
    assert walking.go_to(chosen + 1) is None
    assert walking.current is third


def test_who_walks_on_gets_what_is_shown_and_nothing_else(walking):
    chosen = walking.walk.chosen
    process = walking.worker._process.pid
    for place in (chosen - 1, chosen - 2, chosen + 1):
        walking.go_to(place)
        assert walking.current.stage == "provisional"
    until(walking, lambda: not walking.waiting)
    assert walking.place == chosen + 1
    assert walking.current.stage == "forecast"
    points = walking.walk.points
    for place, found in walking.found.items():
        assert set(free_terms(found.model)) == set(points[place].expressions)
    assert walking.found[chosen - 2].stage == "provisional"  # nobody waited for it
    assert walking.worker._process.pid == process  # short jobs are not worth a new process


@pytest.mark.thorough
def test_a_long_job_for_another_place_is_stopped(walking, monkeypatch):
    monkeypatch.setattr(_session, "_PATIENCE", 0.0)
    chosen = walking.walk.chosen
    first = walking.go_to(chosen - 1)
    second = walking.go_to(chosen + 1)
    assert first.state == "cancelled"
    assert second is not first
    until(walking, lambda: not walking.waiting)


def test_a_refit_that_fails_leaves_the_provisional_model_with_the_reason(walking):
    place = walking.walk.chosen - 1
    points = list(walking.walk.points)
    spoilt = replace(points[place], expressions=("sqrt(theta-99)", *points[place].expressions[1:]))
    points[place] = spoilt
    walking.walk = replace(walking.walk, points=tuple(points))
    walking.go_to(place)
    until(walking, lambda: place in walking.faults)
    assert "does not converge" in walking.faults[place]
    assert walking.current.stage == "provisional"
    assert not walking.waiting
    assert walking.job is None
    # once more when one comes back
    walking.go_to(walking.walk.chosen)
    assert walking.go_to(place) is not None
    walking.stay()
    assert "cancelled" in walking.faults[place]
    assert not walking.collect()


def test_a_bad_file_leaves_the_open_one_open(session, tmp_path):
    session.open_example("single")
    with pytest.raises(InputError, match="not a table"):
        session.open_upload("photo.png", b"\x89PNG")
    with pytest.raises(InputError, match="binary data"):
        session.open_upload("photo.csv", b"\x89PNG\0\0")
    with pytest.raises(InputError, match="damaged gzip"):
        session.open_upload("a.csv.gz", b"\x1f\x8b\x08nothing")
    assert session.title == EXAMPLES["single"][0]
    assert session.data is not None


def test_a_bad_cell_is_named_without_the_temporary_folder(session):
    session.open_upload(
        "run.csv", b"t,x\n" + b"".join(b"%d,%d\n" % (k, k * k) for k in range(60)) + b"60,oops\n"
    )
    assert session.data is None
    assert session.fault.startswith("run.csv, line 62, column 'x': 'oops' is not a number")
    session.roles["x"] = UNUSED
    session.read()
    assert "no column is a coordinate" in session.fault


@pytest.mark.parametrize("name", ["../../etc/passwd.csv", "..\\..\\a.csv", "/abs.csv", "<b>.csv", "....csv"])
def test_the_name_of_an_upload_stays_in_the_folder(session, name):
    session.open_upload(name, b"t,x\n" + b"".join(b"%d,%d\n" % (k, k * k) for k in range(9)))
    assert session._paths[0].resolve().parent == session.folder.resolve()


def test_uploads_are_limited(session, monkeypatch):
    monkeypatch.setattr(_files, "MOST_BYTES", 1_000_000)
    with pytest.raises(InputError, match="larger than 1 MB"):
        session.open_upload("a.csv", b"x" * 1_000_001)
    with pytest.raises(InputError, match="when it is unpacked"):
        session.open_upload("a.csv.gz", gzip.compress(b"0" * 3_000_000))
    assert list(session.folder.iterdir()) == []


def test_other_roles_bring_other_candidates_only_if_they_must(session, tmp_path):
    path = page_helpers.driven_pendulum(tmp_path / "run.csv")
    session.open_upload("run.csv", path.read_bytes())
    session.choice.size = "compact"
    session.roles["theta"] = COORDINATE
    session.read()
    assert session.choice.size == "compact"
    session.roles["tau"] = UNUSED
    session.read()
    assert session.choice == Choice(known="theta_dot**2 = 1", held_out=1)


def test_cancel_leaves_the_session_usable(session):
    session.open_example("double")
    job = session.discover()
    while job.stage == "":
        time.sleep(0.02)
    session.stop()
    assert job.state == "cancelled"
    assert not session.collect()
    assert session.found == {}
    session.open_example("single")
    assert wait(session.discover()).state == "done"
    assert session.collect()


def test_data_that_support_nothing_say_so(session):
    session.open_upload("still.csv", b"t,x\n" + b"".join(b"%g,1\n" % (0.01 * k) for k in range(200)))
    job = wait(session.discover())
    assert job.state == "failed"
    assert job.message
    assert "Traceback" not in job.message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("give the column (trial=...)", "give the column (as the trial)"),
        ("two\nlines\x1b[31m", "two lines [31m"),
    ],
)
def test_messages_speak_of_the_page(text, expected):
    assert in_words(text) == expected


def test_a_workbook_is_a_table(session, tmp_path, monkeypatch):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["t_ms", "theta [deg]"], *([20 * k, 10.0 * k] for k in range(8))):
        book.active.append(row)
    book.save(tmp_path / "run.xlsx")
    content = (tmp_path / "run.xlsx").read_bytes()
    session.open_upload("run.xlsx", content)
    assert session.roles == {"t_ms": MILLISECONDS, "theta [deg]": DEGREES}
    assert session.columns.sample("theta [deg]") == "0, 10, 20"
    assert session.data[0].q[-1, 0] == pytest.approx(1.2217, rel=1e-4)
    assert [finding.code for finding in session.data.findings] == ["time-unit", "converted-units"]
    monkeypatch.setattr(_files, "MOST_BYTES", 2 * len(content))
    with pytest.raises(InputError, match="when it is unpacked"):
        session.open_upload("run.xlsx", content)
