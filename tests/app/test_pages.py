"""The pages and the server without a browser: NiceGUI's simulated user, and the guards on their own."""

from __future__ import annotations

import asyncio
import json
import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from urllib.parse import urlsplit

import numpy as np
import pytest

import page_helpers
from leastaction import InputError, LagrangianModel
from page_helpers import ASKED, SOCKET, UPGRADE, ask, parts_of, upload

with warnings.catch_warnings():
    # What other packages say about each other while they are imported is not ours to mend.
    warnings.simplefilter("ignore")
    pytest.importorskip("nicegui", reason="the app needs NiceGUI: pip install 'leastaction[app]'")
    from nicegui.testing.user_simulation import user_simulation

import socket

from leastaction.app import page as _page
from leastaction.app import server as _server
from leastaction.app.columns import ANGLE, MILLISECONDS
from leastaction.app.data_view import labels
from leastaction.app.jobs import Found, Motion
from leastaction.app.parts import Stick
from leastaction.app.remedies import proposed, take
from leastaction.app.result_view import compared
from leastaction.app.worker import Job
from leastaction.data.coerce import arranged
from leastaction.model.diagnostics import HiddenMotion
from leastaction.model.mathml import Notation
from leastaction.model.term import ModelTerm

_PATIENCE = 200
"""How often a page is looked at, a tenth of a second apart, before something is missing on it."""


def simulate(script) -> None:
    """Run a script with a simulated user, who waits for what shall appear, on a page of the app."""

    async def main() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            async with user_simulation(_page.root) as user:
                user.should_see = partial(user.should_see, retries=_PATIENCE)
                user.should_not_see = partial(user.should_not_see, retries=_PATIENCE)
                try:
                    await user.open("/")
                    await user.should_see("Or a measured example")
                    await script(user)
                finally:
                    _page.close_sessions()

    asyncio.run(main())


def session_of_page():
    (session,) = _page._sessions.values()
    return session


async def open_candidates(user, example: str):
    """From the first page to the candidates of an example; returns the session."""
    user.find(marker=f"example-{example}").click()
    await user.should_see("What was measured")
    user.find(marker="continue").click()
    return session_of_page()


async def until(condition, seconds: float = 60.0) -> None:
    for _ in range(round(seconds / 0.05)):
        if condition():
            return
        await asyncio.sleep(0.05)
    raise AssertionError("this has not happened in time")


@pytest.mark.thorough
def test_from_an_example_to_a_result_and_along_the_curve():
    """A step shows a provisional model, and then the refined one."""

    async def script(user) -> None:
        await open_candidates(user, "single")
        await user.should_see("8 candidates, 2 for friction; 3 trials fitted, 1 held out")
        user.find(marker="discover").click()
        session = session_of_page()
        await until(lambda: session.found)
        await user.should_see("How many terms?")
        await user.should_see("5 free terms. This is the structure that leastaction chose.")
        await user.should_see("Natural frequency about θ")
        user.find(marker="report").click()
        response = await user.download.next(timeout=30)
        assert response.content.startswith(b"<!DOCTYPE html>")
        user.find(marker="model").click()
        response = await user.download.next(timeout=30)
        assert b'"schema"' in response.content
        await until(lambda: session.current.stage == "forecast")
        user.find(marker="fewer").click()
        await user.should_see("4 free terms. The criterion prefers the chosen structure by")
        await user.should_see("It was not chosen because it fits the data worse.")
        if session.current.stage == "provisional":  # it is, unless the refit was faster than this line
            await user.should_see("from the quadratic model of the likelihood about the chosen structure")
            await user.should_see("refining…")
            await user.should_see("It follows when the model is refined.")
            assert not next(iter(user.find(marker="report").elements)).enabled
            assert not next(iter(user.find(marker="model").elements)).enabled
        await until(lambda: session.current.stage == "forecast")
        await user.should_see("taken from the trade-off curve by hand")
        await user.should_see("Simulated for")
        names = session.data.names
        short = labels(names)[names.index(session.current.motion.trial)]
        await user.should_see(f"along trial {short},")
        await user.should_not_see("provisional")
        await until(lambda: session.job is None)
        user.find(marker="report").click()
        response = await user.download.next(timeout=30)
        assert b"taken from the curve by hand" in response.content
        assert b"inf %" not in response.content
        # one click does what a finding proposes
        user.find(marker="more").click()
        await until(lambda: session.current.stage == "forecast" and session.place == session.walk.chosen)
        await user.should_see("Search again with one change:")
        before = session.current.model
        user.find(marker="keep").click()
        await user.should_see("Kept: the next result will be compared with this one.")
        user.find(marker="remedy").click()
        await until(lambda: session.found and session.current.model is not before)
        assert session.choice.more_friction == "abs(theta_dot)**3/3"
        friction = [term.expression for term in session.current.model.dissipation]
        assert any(text.startswith("theta_dot**2*sqrt(") for text in friction)  # drag of the air
        await until(lambda: session.current.stage == "forecast")
        await user.should_see("Compared with the kept model")
        notation = Notation(["theta"])
        rows = compared(session.current, session.kept, notation)
        assert rows[0] == ("verdict", session.current.model.fit.status, "ok")
        cells = {str(name): (here, there) for name, here, there in rows[3:]}
        drag, viscous = (str(notation.term(text)) for text in (friction[-1], "theta_dot**2/2"))
        assert cells[drag][1] == "–"
        assert cells[viscous][0] == "–"

    simulate(script)


def test_a_running_search_shows_its_stages_and_the_law_so_far():
    """The search is one that the test leads: a real one may be over before the page is looked at."""

    async def script(user) -> None:
        session = await open_candidates(user, "single")
        await user.should_see("8 candidates, 2 for friction")
        job = session.job = Job()
        user.find(marker="step-data").click()  # the steps follow
        await user.should_see("What was measured")
        user.find(marker="step-result").click()
        await user.should_see("Searching")
        await user.should_see("Starting")
        job._report("prepare", {})
        job._report("select", {"terms": 2.0, "coefficients": {"theta_dot**2": 0.5, "cos(theta)": 9.81}})
        await user.should_see("Choosing terms: 2 so far")
        await user.should_see("Preparing the data and the candidates: ")
        await user.should_see("Terms so far")
        await user.should_not_see("more")
        job._report("knots", {"knots_per_second": 40.0})
        await user.should_see("Refining the spline: 40 knots per second")
        await user.should_see("Terms so far")  # the last ones that were reported
        job._end("failed", message="no candidate was left")
        await user.should_see("no candidate was left")

    simulate(script)


@pytest.mark.thorough
def test_a_step_whose_refit_fails_keeps_the_provisional_model_and_says_why():
    async def script(user) -> None:
        await open_candidates(user, "single")
        await user.should_see("3 trials fitted, 1 held out")
        user.find(marker="discover").click()
        await until(lambda: session_of_page().found)
        await user.should_see("5 free terms. This is the structure")
        session = session_of_page()
        points = list(session.walk.points)
        place = session.place - 1
        expressions = ("sqrt(theta-99)", *points[place].expressions[1:])
        points[place] = replace(points[place], expressions=expressions)
        session.walk = replace(session.walk, points=tuple(points))
        user.find(marker="fewer").click()
        await user.should_see(
            "Refining them failed: the fit of this structure does not converge", retries=100
        )
        await user.should_see("provisional")
        await user.should_see("Only refined models are forecast.")
        assert session.current.stage == "provisional"
        assert not next(iter(user.find(marker="report").elements)).enabled
        await user.should_not_see("Symmetries")
        user.find(marker="more").click()
        await user.should_see("5 free terms. This is the structure")
        await user.should_see("Symmetries")
        await user.should_not_see("provisional")

    simulate(script)


def test_the_result_shows_simple_numbers_and_symmetries():
    async def script(user) -> None:
        session = await open_candidates(user, "single")
        await user.should_see("8 expressions, all readable")
        terms = [
            ModelTerm("x_dot**2", 0.5003, 0.0004),
            ModelTerm("y_dot**2", 0.5001, 0.0004),
            ModelTerm("x**2", -0.2371, 0.0002),
            ModelTerm("y**2", -0.2372, 0.0002),
        ]
        covariance = np.diag([term.standard_error**2 for term in terms])
        found = Found(LagrangianModel(["x", "y"], terms, covariance=covariance), "fitted")
        session.found, session.faults = {0: found}, {0: "it was cancelled"}
        user.find(marker="step-candidates").click()
        await asyncio.sleep(0.1)
        user.find(marker="step-result").click()
        await user.should_see("Simple numbers inside the intervals")
        await user.should_see("0.50030(40)")
        await user.should_see("All together: χ²")
        await user.should_see("Symmetries and conserved quantities")
        await user.should_see("rotation of (x, y)")
        await user.should_see("within the error bars (0.")
        await user.should_see("angular momentum")
        await user.should_see("Equilibria and small motions")
        await user.should_see("None within the recorded range")
        # A law that holds the time, with coefficients that are no simple numbers.
        terms = [ModelTerm("x_dot**2", 0.5421, 0.0004), ModelTerm("x*cos(3*t)", 0.237, 0.0002)]
        session.found = {0: Found(LagrangianModel(["x"], terms), "fitted")}
        user.find(marker="step-result").click()
        await user.should_see("Not computed if the law depends on time.")
        await user.should_not_see("Simple numbers")

    simulate(script)


def test_a_session_can_be_saved_from_the_moment_that_data_are_open():
    async def script(user) -> None:
        await user.should_not_see(marker="save")
        session = await open_candidates(user, "single")
        await user.should_see("8 expressions, all readable")
        user.find(marker="save").click()
        response = await user.download.next(timeout=30)
        assert response.content.startswith(b"PK")
        # With a model, the result is there when the file is opened, and its forecasts follow.
        terms = [ModelTerm("theta_dot**2", 1.0, known=True), ModelTerm("cos(theta)", -128.1, 0.02)]
        options = {"options": {"angles": ["theta"]}}
        model = LagrangianModel(["theta"], terms, covariance=[[4e-4]], provenance=options)
        session.found, session.searched = {0: Found(model, "fitted")}, session.choice
        content = session.save()
        session.open_example("double")
        assert not session.found
        upload(session, "mine.leastaction", content)
        user.find(marker="step-data").click()
        await user.should_see("What was measured")
        user.find(marker="step-result").click()
        await user.should_see("Coefficients")
        await user.should_see("A session does not store the search.")
        # Another page of the session, such as one before a reload, may take the result first.
        await until(lambda: session.collect() or session.current.stage == "forecast")
        await user.should_see("Simulated for")
        assert session.current.validation is not None
        assert not next(iter(user.find(marker="report").elements)).enabled
        for marker in ("model", "all", "save"):
            assert next(iter(user.find(marker=marker).elements)).enabled
        user.find(marker="model").click()
        response = await user.download.next(timeout=30)
        assert LagrangianModel.from_dict(json.loads(response.content)).to_dict() == model.to_dict()

    simulate(script)


def test_the_verdict_states_the_forecast_of_held_out_trials():
    model = page_helpers.spring()
    tried = model.validate(model.diagnostics.trajectories)
    off = replace(tried, traces=tuple(replace(trace, status="diverged") for trace in tried.traces))
    louder = replace(model, noise_std=[0.3 * sigma for sigma in model.noise_std])  # than the stated noise

    async def script(user) -> None:
        session = await open_candidates(user, "single")
        for shown, validation, expected in (
            (model, None, "Forecast: not tested."),
            (model, tried, "Forecast: held-out trials are off by"),
            (model, off, "but its forecasts contradict it"),
            (louder, None, "The equations hold along the data, with a reservation:"),
            (louder, None, "not white, normal noise: intervals may be too narrow or too wide"),
        ):
            session.found = {0: Found(shown, "fitted", validation)}
            session.faults = {0: "it was cancelled"}
            user.find(marker="step-candidates").click()
            await asyncio.sleep(0.1)
            user.find(marker="step-result").click()
            await user.should_see(expected)

    simulate(script)


def test_the_page_marks_what_no_sensor_saw_as_estimated():
    one = page_helpers.spring().diagnostics
    t = one.trajectories[0].t
    q = np.column_stack([np.sin(t), np.cos(t)])
    measured = np.column_stack([q[:, 0], np.full(t.size, np.nan)])
    guess = {1: HiddenMotion(t, q[:, 1], np.full(t.size, 0.01))}
    motion = Motion("0", False, t, measured, q, 6.0, unseen=(1,), estimated=guess)
    terms = [ModelTerm("x_dot**2", 0.5), ModelTerm("h_dot**2", 0.5), ModelTerm("(x-h)**2", -1.0)]
    diagnostics = replace(
        one,
        trajectories=arranged(one.trajectories, ["x", "h"]),
        control_points=np.tile(one.control_points, 2),
        hidden_motion={"h": (guess[1],)},
    )
    model = LagrangianModel(["x", "h"], terms, noise_std=[0.01, 0.01], diagnostics=diagnostics)

    async def script(user) -> None:
        session = await open_candidates(user, "single")

        async def show(found: Found) -> dict:
            session.found = {0: found}
            user.find(marker="step-candidates").click()
            await asyncio.sleep(0.1)
            user.find(marker="step-result").click()
            await user.should_see("Simulated for 6 s")
            (stick,) = user.find(Stick).elements
            return stick._props["frames"]

        shown = await show(Found(model, "forecast", motion=motion))
        assert shown["estimated"] == [False, True]
        assert None not in shown["measured"][0]
        await user.should_see("estimated, no sensor")
        await user.should_see("h: not measured, but estimated from the equations (95 % band: at most ± 0.02)")
        bare = replace(model, diagnostics=None)
        shown = await show(Found(bare, "forecast", motion=replace(motion, estimated={})))
        assert shown["measured"][0][1] is None
        await user.should_see("Only its forecast is drawn, because a session does not store")
        await user.should_not_see("estimated, no sensor")

    simulate(script)


def test_faults_are_lines_in_the_page():
    async def script(user) -> None:
        session = await open_candidates(user, "single")
        await user.should_see("8 expressions, all readable")
        user.find(marker="text").clear().type("theta_dot**2\ncos(nothing)")
        await user.should_see("line 2: cannot read 'cos(nothing)'")
        await user.should_see("1 line among the candidates cannot be read")
        assert session.job is None
        user.find(marker="step-data").click()
        await user.should_see("The data")
        session.roles["theta"] = "not used"
        session.read()
        user.find(marker="step-data").click()
        await user.should_see("no column is a coordinate yet")

    simulate(script)


def test_a_coordinate_may_be_moved_by_something_unmeasured():
    async def script(user) -> None:
        session = await open_candidates(user, "double")
        await user.should_see("Moved by unmeasured forces")
        first, second = session.data.coordinates
        user.find(marker=f"prescribed-{first}").click()
        await until(lambda: session.choice.prescribed)
        assert session.choice.task(session.data, session.angles).forces.prescribed == (first,)
        user.find(marker=f"prescribed-{second}").click()
        await user.should_see("no equation is left")

    simulate(script)


def test_a_coordinate_without_a_sensor_changes_candidates_and_friction():
    async def script(user) -> None:
        session = await open_candidates(user, "single")
        session.choice.written = False
        user.find(marker="step-data").click()
        await user.should_see("What was measured")
        user.find(marker="step-candidates").click()
        await user.should_see("standard: ")
        user.find(marker="hidden").type("phi")
        user.find(marker="hidden-angles").click()
        await user.should_see("viscous, φ")
        await until(lambda: session.choice.hidden_angles)
        task = session.choice.task(session.data, session.angles)
        assert task.hidden == ("phi",)
        assert "cos(phi)" in [term.text for term in task.library]
        user.find(marker="families-stribeck").click()
        await until(lambda: session.choice.families == ["stribeck"])
        user.find(marker="hidden").clear().type("theta")
        await user.should_see("theta is measured")

    simulate(script)


def test_one_click_gives_a_column_another_meaning():
    async def script(user) -> None:
        session = session_of_page()
        rows = "".join(f"{10 * k},{np.sin(k / 9):.5f},1\n" for k in range(60))
        upload(session, "run.csv", f"time,x,tau_x\n{rows}".encode())
        (offer,) = proposed(session.data.findings[-1], session.choice, session.choice.library(["x"], []))
        assert offer.words == "Times in ms"
        take(session, replace(offer, roles={**offer.roles, "x": ANGLE}))
        assert (session.roles["time"], session.angles) == (MILLISECONDS, ["x"])
        assert session.data[0].t[-1] == pytest.approx(0.59)
        assert session.job is not None

    simulate(script)


@pytest.mark.thorough
def test_an_arm_is_identified_from_currents(tmp_path):
    async def script(user) -> None:
        session = session_of_page()
        log, robot = page_helpers.arm_log(tmp_path, quantity="current")
        session.open_uploads([(path.name, path.read_bytes()) for path in (log, robot)])
        user.find(marker="step-data").click()
        await user.should_see(marker="step-arm")
        user.find(marker="step-arm").click()
        await user.should_see("Torque per ampere of one joint or more")
        user.find(marker="gains").type("shoulder=one")
        user.find(marker="identify").click()
        await user.should_see("shoulder: 'one' is not a finite number")
        user.find(marker="gains").clear().type("shoulder=1")
        user.find(marker="terms").type("sin(hip)")
        user.find(marker="identify").click()
        await user.should_see("unknown name 'hip'")
        user.find(marker="terms").clear().type("shoulder_dot*elbow_dot")
        user.find(marker="dissipation").type("(shoulder_dot+elbow_dot)**2")
        user.find(marker="identify").click()
        await user.should_see(marker="arm.urdf")
        assert "gain" in session.arm_job.result.report
        assert "L[shoulder_dot*elbow_dot]" in session.arm_job.result.report
        assert "psi[(shoulder_dot+elbow_dot)**2]" in session.arm_job.result.report
        await user.should_see("The arm moves as recorded in the log: 6 s.")
        (drawing,) = user.find(kind=Stick).elements
        assert drawing.props["frames"] == session.arm_job.result.motion.frames
        long = replace(session.arm_job.result.motion, trial="b", duration=20.0)
        session.arm_job.result = replace(session.arm_job.result, motion=long)
        user.find(marker="step-arm").click()
        await user.should_see("as recorded in trial b, the longest: the first 5.99 of 20 s.")
        session.arm_job.result = replace(session.arm_job.result, motion=None)
        user.find(marker="step-arm").click()
        await user.should_not_see("The arm moves as")
        await user.should_see(marker="arm.urdf")
        user.find(marker="change").click()
        await user.should_see(marker="identify")
        user.find(marker="identify").click()
        await user.should_see(marker="cancel")
        user.find(marker="cancel").click()
        await user.should_see(marker="identify")

    simulate(script)


def test_the_page_says_what_was_done_to_the_data():
    async def script(user) -> None:
        session = session_of_page()
        rows = "".join(f"{20 * k};{k},5\n" for k in range(40))
        upload(session, "run.csv", f"Zeit;Winkel\nms;°\n{rows}".encode("cp1252"))
        user.find(marker="step-data").click()
        await user.should_see("What was measured")
        await user.should_see("the times in &#39;Zeit&#39; were converted from ms to seconds")  # as HTML
        await user.should_see("Winkel was converted from deg to rad")
        await user.should_see("numbers were read with a decimal comma")
        await user.should_see("the text is not UTF-8 and was read as Windows-1252")

    simulate(script)


def test_coordinates_have_the_names_of_their_columns():
    async def script(user) -> None:
        session = session_of_page()
        rows = "".join(f"{0.02 * k},{40 * np.sin(k / 9)},1.0\n" for k in range(60))
        upload(session, "run.csv", f"Time [s],Upper arm [deg],Torque 1\n{rows}".encode())
        assert session.moving == ["Upper arm [deg]"]
        user.find(marker="step-data").click()
        await user.should_see("called Upper_arm where you write formulas")
        await user.should_see("Upper arm was converted from deg to rad")
        await user.should_see("velocity of Upper arm")
        model = LagrangianModel(
            ["Upper_arm"], [ModelTerm("Upper_arm_dot**2", 0.5, 0.01), ModelTerm("cos(Upper_arm)", 9.8, 0.1)]
        )
        session.found, session.faults = {0: Found(model, "fitted")}, {0: "it was cancelled"}
        user.find(marker="step-candidates").click()
        await user.should_see("viscous, Upper arm")
        user.find(marker="step-result").click()
        await user.should_see("Upper arm = 0")

    simulate(script)


def test_forces_and_gyroscopic_terms_can_be_chosen(tmp_path):
    async def script(user) -> None:
        session = await open_candidates(user, "single")
        upload(session, "run.csv", page_helpers.driven_pendulum(tmp_path / "run.csv").read_bytes())
        user.find(marker="step-candidates").click()
        await user.should_see("Unknown constant force")
        user.find(marker="offsets-theta").click()
        await until(lambda: session.choice.offsets == ["theta"])
        user.find(marker="delay").clear().type("20")
        await until(lambda: session.choice.delay == pytest.approx(0.02))
        user.find(marker="delay").clear().type("20000")
        await user.should_see("a delay of 20000 ms leaves too little")
        session.open_example("double")
        session.choice.written = False
        user.find(marker="step-data").click()
        user.find(marker="step-candidates").click()
        await user.should_see("also terms linear in the velocities")
        user.find(marker="gyroscopic").click()
        await until(lambda: session.choice.gyroscopic)

    simulate(script)


def test_cancelling_keeps_the_page():
    async def script(user) -> None:
        await open_candidates(user, "double")
        await user.should_see("Which terms may the Lagrangian contain?")
        user.find(marker="discover").click()
        await user.should_see("Searching")
        user.find(marker="cancel").click()
        await user.should_see("Data and candidates are unchanged")
        assert session_of_page().job.state == "cancelled"
        user.find(marker="back").click()
        await user.should_see("16 candidates, 5 for friction; 18 trials fitted, 8 held out")

    simulate(script)


def answer(
    *messages: dict, headers: tuple[tuple[bytes, bytes], ...] = ()
) -> tuple[int, dict[bytes, bytes], int]:
    """Status, headers and number of bytes that the application behind the guard has read."""
    seen = 0
    queue, sent = list(messages), []

    async def application(scope, receive, send) -> None:
        nonlocal seen
        while True:
            message = await receive()
            if message["type"] == "http.disconnect":
                break
            seen += len(message.get("body", b""))
            if not message.get("more_body"):
                break
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def receive() -> dict:
        return queue.pop(0)

    async def send(message: dict) -> None:
        sent.append(message)

    scope = {"type": "http", "headers": list(headers)}
    asyncio.run(_server.Guard(application)(scope, receive, send))
    return sent[0]["status"], dict(sent[0]["headers"]), seen


def test_answers_forbid_other_hosts():
    status, headers, _ = answer({"type": "http.request"}, headers=((b"host", b"127.0.0.1:8137"),))
    policy = headers[b"content-security-policy"].decode()
    assert status == 200
    assert "connect-src 'self' ws://127.0.0.1:8137;" in policy
    sources = policy.replace("ws://127.0.0.1:8137", "")
    assert "//" not in sources
    assert "*" not in sources


def test_large_bodies_are_refused(monkeypatch):
    monkeypatch.setattr(_server, "MOST_BYTES", 1_000)
    assert answer(headers=((b"content-length", b"9999999"),))[0] == 413
    assert answer(headers=((b"content-length", b"-1"),))[0] == 413
    part = {"type": "http.request", "body": b"x" * 400_000, "more_body": True}
    # Without a length: reading ends as soon as it is too much.
    assert answer(*[part] * 9)[2] <= 1_001_000


def test_a_free_port_is_found_and_a_taken_one_named():
    with socket.socket() as taken:
        taken.bind((_server.HOST, 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} is in use"):
            _server.free_port(port)
    assert _server.free_port(port) == port
    assert _server.free_port(None) in _server._PORTS


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server as a user starts it; the address with the token."""
    with page_helpers.running_app(tmp_path_factory.mktemp("server")) as printed:
        yield printed


def test_without_the_token_or_its_cookie_nothing_is_answered(address):
    home, cookie, script = parts_of(address)
    name = cookie.partition("=")[0]
    for more in ({}, {"cookie": f"{name}=wrong"}, {"cookie": "other=" + cookie.partition("=")[2]}):
        for path, method, headers in [*ASKED, (script, "GET", {})]:
            status, _, text = ask(home + path, method, **headers, **more)
            assert status == 403, path
            assert "the complete address that it printed in the terminal" in text
            assert len(text.splitlines()) == 1
    for token in ("?token=", "?token=wrong", "?token=%C3%A9", address.partition(home)[2][:-1]):
        assert ask(home + token)[0] == 403
    assert ask(address, "POST")[0] == 403
    # NiceGUI says of its files that they may be kept for a year; not what was refused.
    assert ask(home + script)[1]["vary"] == "Cookie"


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_the_token_is_exchanged_for_a_cookie_that_opens_everything(address, host):
    address = address.replace("127.0.0.1", host)
    status, headers, _ = ask(address)
    assert (status, headers["location"]) == (303, "/")
    assert headers["referrer-policy"] == "no-referrer"
    cookie, *attributes = headers["set-cookie"].split("; ")
    assert sorted(attributes) == ["HttpOnly", "Path=/", "SameSite=Strict"]
    assert f"-{urlsplit(address).port}=" in cookie
    assert address.partition("token=")[2] not in cookie
    home, _, script = parts_of(address)
    own = {"cookie": f"other=1; {cookie}", "origin": home.rstrip("/")}
    assert ask(home, **own)[2].startswith("<!doctype html>")
    assert ask(home + script, **own)[0] == 200
    assert ask(f"{home}{SOCKET}polling", **own)[0] == 200
    assert ask(f"{home}{SOCKET}websocket", **UPGRADE, **own)[0] == 101
    assert ask(f"{home}_nicegui/client/1/upload/2", "POST", **own)[0] != 403
    # As often as one likes, also in a browser that is in already.
    assert ask(address, **own)[0] == 303


def test_pages_of_other_origins_are_refused(address):
    home, cookie, script = parts_of(address)
    port = urlsplit(address).port
    strangers = [
        "https://evil.example",
        "null",
        f"https://127.0.0.1:{port}",
        f"http://localhost:{port}",
        f"http://127.0.0.1:{port + 1}",
        "http://127.0.0.1",
        f"http://127.0.0.1:{port}.evil.example",
    ]
    for origin in strangers:
        for path, method, headers in [
            *ASKED,
            (script, "GET", {}),
            (f"{SOCKET}polling", "OPTIONS", {}),
        ]:
            status, found, text = ask(home + path, method, **headers, cookie=cookie, origin=origin)
            assert status == 403, (origin, path)
            assert "A page from another address may not use this leastaction app" in text
            assert not [name for name in found if name.startswith("access-control")]
        assert ask(address, origin=origin)[0] == 403


def test_a_link_of_another_site_is_asked_again_by_the_app_itself(address):
    home = address.partition("?")[0]
    _, headers, _ = ask(home, sec_fetch_site="cross-site")
    assert headers["refresh"] == "0; url=/"
    for site in ("none", "same-origin", "same-site"):  # or it would ask for ever
        assert "refresh" not in ask(home, sec_fetch_site=site)[1]


def test_the_browser_is_started_with_a_ticket_that_opens_once(monkeypatch):
    given = {}
    monkeypatch.setattr(_server, "install", lambda keys: None)
    monkeypatch.setattr(_server.ui, "run", lambda root, **settings: given.update(settings))
    keys = _server.Keys(8137)
    _server.serve(8137, keys, show=False)
    assert given["show"] is False
    _server.serve(8137, keys, show=True)
    token, ticket = (text.partition("token=")[2] for text in (keys.address, given["show"]))
    assert given["show"].startswith("/?token=")
    assert ticket != token
    assert [keys.opens(ticket), keys.opens(ticket)] == [True, False]
    assert [keys.opens(token), keys.opens(token), keys.opens("")] == [True, True, False]
    name, _, value = keys.cookie.partition(";")[0].partition("=")
    assert keys.fits({name: value})
    assert not keys.fits({name: token})
    # Two apps of one computer keep theirs side by side.
    assert not _server.Keys(8138).cookie.startswith(f"{name}=")
