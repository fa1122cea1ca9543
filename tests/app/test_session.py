"""The app's choices, its worker process and its session: files, downloads, cancelling, failures."""

from __future__ import annotations

import gzip
import io
import itertools
import json
import math
import re
import time
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import leastaction as la
import page_helpers
from leastaction import InputError, arms
from leastaction.app import candidates as _candidates
from leastaction.app import columns as _columns
from leastaction.app import files as _files
from leastaction.app import jobs as _jobs
from leastaction.app import motion as _motion
from leastaction.app import remedies as _remedies
from leastaction.app import session as _session
from leastaction.app.arm import motion_of
from leastaction.app.candidates import Choice, friction_choices, split_trials
from leastaction.app.columns import (
    ANGLE,
    COORDINATE,
    DATES,
    DEGREES,
    FORCE,
    MICROSECONDS,
    MILLISECONDS,
    TIME,
    TRIAL,
    UNUSED,
    VELOCITY,
)
from leastaction.app.figures import forecast_figure, unseen_words
from leastaction.app.jobs import Found, Motion, Walk
from leastaction.app.motion import frames, hanging_angles, link_lengths, stick_kind, stick_words
from leastaction.app.remedies import proposed
from leastaction.app.session import Session
from leastaction.app.worker import Worker, in_words
from leastaction.data.coerce import arranged
from leastaction.exporters import FORMATS
from leastaction.findings import CODES, Finding
from leastaction.library import format_expression
from leastaction.mechanics.equations import state_symbols
from leastaction.model.diagnostics import HiddenMotion, PathPoint
from leastaction.model.term import ModelTerm
from page_helpers import spring, upload


def table(header: str, *rows: str) -> _columns.Columns:
    return _columns.Columns(tuple(header.split(",")), tuple(tuple(row.split(",")) for row in rows))


# columns


@pytest.mark.parametrize(
    ("header", "roles"),
    [
        ("t,theta1,theta2,tau1,tau2", [TIME, ANGLE, ANGLE, FORCE + "theta1", FORCE + "theta2"]),
        ("Time (s),x,y,Fx,u_y", [TIME, COORDINATE, COORDINATE, COORDINATE, FORCE + "y"]),
        ("frame,x,phi_deg,omega,x_dot", [TIME, COORDINATE, DEGREES, UNUSED, UNUSED]),
        ("trial,t,q,q_force", [TRIAL, TIME, COORDINATE, FORCE + "q"]),
        ("time,angle,torque", [TIME, ANGLE, FORCE + "angle"]),
        (
            "Time [s],Upper arm [deg],Lower arm [deg],Torque 1 (N m),Torque 2 (N m)",
            [TIME, DEGREES, DEGREES, FORCE + "Upper_arm", FORCE + "Lower_arm"],
        ),
        ("t,theta1,theta2,tau3", [TIME, ANGLE, ANGLE, UNUSED]),
        (
            "Time [s],Upper arm [deg],Fore arm [deg],Shoulder torque,Elbow motor [Nm]",
            [TIME, DEGREES, DEGREES, FORCE + "Upper_arm", FORCE + "Fore_arm"],
        ),
    ],
)
def test_roles_are_guessed(header, roles):
    rows = [",".join(f"{k + 0.1 * i if i else k}" for i in range(header.count(",") + 1)) for k in range(4)]
    guessed = _columns.guess_roles(table(header, *rows))
    if header.startswith("frame"):
        # Nothing is called a time: a count of frames is none either.
        roles = [UNUSED, TIME, *roles[2:]]
    assert list(guessed.values()) == roles


@pytest.mark.parametrize(
    ("header", "units", "roles"),
    [
        ("Zeit [ms],Winkel / °,tau [Nm]", "", [MILLISECONDS, DEGREES, FORCE + "Winkel"]),
        ("t_us,x (mm),gyro [deg/s]", "", [MICROSECONDS, COORDINATE, UNUSED]),
        ("t,q1,q2", "s,deg,rad", [TIME, DEGREES, ANGLE]),
        ("millis,position_deg", "", [MILLISECONDS, DEGREES]),
    ],
)
def test_units_decide_roles(header, units, roles):
    rows = [",".join(f"{k + 0.1 * i}" for i in range(header.count(",") + 1)) for k in range(4)]
    columns = replace(table(header, *rows), units=tuple(units.split(",")))
    assert list(_columns.guess_roles(columns).values()) == roles


def test_the_app_reads_what_people_write(tmp_path):
    """By the reader of the package: decimal commas, a row of units, dates; a role wins over the header."""
    path = tmp_path / "run.csv"
    rows = "".join(f"{20 * k};{10 * k},5;{k},5\n" for k in range(8))
    path.write_bytes(f"Zeit;phi;x_mm\nms;°;mm\n{rows}".encode("cp1252"))
    columns = _columns.peek(path)
    assert columns.sample("phi") == "0.5, 10.5, 20.5"
    roles = _columns.guess_roles(columns)
    assert roles == {"Zeit": MILLISECONDS, "phi": DEGREES, "x_mm": COORDINATE}
    data = _columns.read(path, roles)
    assert data.coordinates == ("phi", "x")
    assert np.allclose(data[0].t, 0.02 * np.arange(8))
    assert np.allclose(data[0].q[:, 0], np.radians(10.0 * np.arange(8) + 0.5))
    assert np.allclose(data[0].q[:, 1], (np.arange(8) + 0.5) / 1e3)
    said = [finding.code for finding in data.findings]
    assert said == ["units-row", "time-unit", *["converted-units"] * 2, "text-encoding", "decimal-comma"]
    other = _columns.read(path, roles | {"Zeit": TIME, "phi": ANGLE})
    assert other[0].t[-1] == 140.0
    assert other.findings[1].values["instead_of"] == "ms"
    dates = tmp_path / "dates.csv"
    dates.write_text("when,x\n" + "".join(f"2024-05-01T12:00:0{k},{k}\n" for k in range(8)))
    roles = _columns.guess_roles(_columns.peek(dates))
    assert roles == {"when": DATES, "x": COORDINATE}
    assert _columns.read(dates, roles)[0].t[-1] == 7.0
    with pytest.raises(InputError, match="are dates"):
        _columns.read(dates, roles | {"when": TIME})


def test_text_is_no_coordinate():
    guessed = _columns.guess_roles(table("t,x,remark", "0,1,good", "1,2,bad", "2,2,good"))
    assert guessed == {"t": TIME, "x": COORDINATE, "remark": UNUSED}


def test_a_column_with_a_bad_cell_is_still_a_coordinate():
    guessed = _columns.guess_roles(table("t,x", "0,1", "1,", "2,oops", "3,4"))
    assert guessed == {"t": TIME, "x": COORDINATE}


def test_any_column_gets_a_name_that_the_grammar_accepts():
    columns = ["θ 1 (rad)", "2nd", "sin", "x_dot", "x", "x (m)", "t", "", "class", "a-b", "€"]
    names = _columns.coordinate_names(columns)
    assert len(set(names.values())) == len(columns)
    la.Library([f"{name}_dot**2" for name in names.values()], list(names.values()))


def test_degrees_become_radians_and_are_unwrapped(tmp_path):
    angle = np.degrees(np.linspace(0.0, 12.0, 60))
    wrapped = (angle + 180.0) % 360.0 - 180.0
    path = tmp_path / "run.csv"
    path.write_text("t,phi\n" + "\n".join(f"{0.1 * k},{x!r}" for k, x in enumerate(wrapped.tolist())))
    data = _columns.read(path, {"t": TIME, "phi": DEGREES})
    assert np.allclose(data[0].q[:, 0], np.linspace(0.0, 12.0, 60))
    assert data.wraps_removed == {"phi": 2}


@pytest.mark.parametrize(
    ("roles", "text"),
    [
        ({"time": TIME, "theta": UNUSED}, "no column is a coordinate"),
        ({"time": UNUSED, "theta": ANGLE}, "no column is the time"),
        ({"time": TIME, "run": TIME, "theta": ANGLE}, "both marked as time"),
        ({"time": TIME, "theta": ANGLE, "tau": FORCE + "phi"}, "not a coordinate any more"),
        ({"time": TIME, "theta": ANGLE}, r"\(trial=\.\.\.\)"),
    ],
)
def test_roles_that_cannot_be_read_say_why(tmp_path, roles, text):
    path = page_helpers.driven_pendulum(tmp_path / "run.csv")
    with pytest.raises(InputError, match=text):
        _columns.read(path, roles)


# candidates


def test_faults_name_the_line():
    found = _candidates.faults("x_dot**2\n# all right\nsin(y)\n\n__import__('os')\nx**", ["x"])
    assert [text.partition(":")[0] for text in found] == ["line 3", "line 5", "line 6"]
    assert "unknown name 'y'" in found[0]


def test_too_many_lines_are_not_read():
    (text,) = _candidates.faults("x\n" * 2000, ["x"])
    assert "2000 lines" in text


def test_friction_candidates_can_be_read():
    texts = [text for _, text in friction_choices(["theta1", "x", "phi"])]
    library = la.Library(["x"], ["theta1", "x", "phi"], dissipation=texts)
    assert len(library.dissipation) == len(texts) == 10


def test_a_passive_system_needs_a_scale():
    data = la.systems.generate("cart_spring_pendulum", trials=1, duration=2.0)
    choice = Choice.default(data)
    assert choice.known == "x_dot**2 = 1"
    choice.known = ""
    with pytest.raises(InputError, match="L = 0 solves"):
        choice.task(data, ["theta"])


def test_a_driven_system_needs_none():
    data = la.systems.generate("single_pendulum", trials=2, duration=2.0)
    choice = Choice.default(data)
    assert choice.known == ""
    task = choice.task(data, ["theta"])
    assert task.known == {}
    assert len(task.fitted) == 1
    assert task.held_out is not None


def given_to_discover(task, monkeypatch):
    given = {}

    def discover(trajectories, library, known, **options):
        given.update(options, trajectories=trajectories)
        raise InputError("enough")

    monkeypatch.setattr(la, "discover", discover)
    with pytest.raises(InputError, match="enough"):
        _jobs.search(lambda stage, details: None, task)
    return given


def test_what_is_said_of_forces_is_told_to_the_discovery(monkeypatch):
    data = la.systems.generate("cart_spring_pendulum", trials=1, duration=2.0)
    choice = Choice(known="theta_dot**2 = 1", prescribed=["x", "gone"], offsets=["theta"], delay=0.1)
    task = choice.task(data, ["theta"])
    given = given_to_discover(task, monkeypatch)
    assert (given["prescribed"], given["force_offset"]) == (("x",), ("theta",))
    assert given["trajectories"] is task.fitted  # nothing to shift
    choice.prescribed = ["theta"]
    with pytest.raises(InputError, match="select only one"):
        choice.task(data, ["theta"])
    choice.prescribed, choice.offsets = ["theta", "x"], []
    with pytest.raises(InputError, match="no equation is left"):
        choice.task(data, ["theta"])


def test_lengths_of_links_are_told_to_the_discovery(monkeypatch):
    data = la.systems.generate("single_pendulum", trials=1, duration=2.0)
    choice = Choice(lengths="theta = 0.3  # m\n")
    assert given_to_discover(choice.task(data, ["theta"]), monkeypatch)["lengths"] == {"theta": 0.3}
    for text, problem in (
        ("0.3", "COORDINATE = METRES"),
        ("phi = 0.3", "'phi', which is not a coordinate"),
        ("theta = -1", "expected metres"),
        ("theta = a", "not a finite number"),
    ):
        choice.lengths = text
        with pytest.raises(InputError, match=problem):
            choice.task(data, ["theta"])


def test_forces_are_shifted_to_when_they_act(monkeypatch):
    data = la.systems.generate("single_pendulum", trials=2, duration=2.0)
    choice = Choice(held_out=1, delay=0.05)
    given = given_to_discover(choice.task(data, ["theta"]), monkeypatch)
    kept = given["trajectories"][0]
    assert np.allclose(kept.forces, data[0].forces[:-5])
    assert np.allclose(kept.q, data[0].q[5:])
    choice.delay = -1.5
    with pytest.raises(InputError, match="-1500 ms leaves too little of a trial of 2 s"):
        choice.task(data, ["theta"])


def test_terms_linear_in_the_velocities_can_be_offered():
    plain, turning = (Choice(gyroscopic=on).library(["x", "y"], []) for on in (False, True))
    assert "x*y_dot" in [term.text for term in turning]
    assert {term.text for term in plain} < {term.text for term in turning}


@pytest.mark.parametrize("names", ["a", "abc", "abcd", "abcdefg"])
@pytest.mark.parametrize("turning", [True, False])
def test_the_size_is_the_one_that_a_discovery_takes_by_itself(names, turning):
    names = list(names)
    angles = names if turning else []
    assert list(Choice().generated(names, angles)) == list(la.Library.mechanical(names, angles))
    choice = Choice()
    sizes = choice.sizes(names, angles)
    assert sizes[choice.size_for(names, angles)] == la.Library.mechanical_size(names, angles)
    choice.size = "compact"
    assert choice.size_for(names, angles) == "compact"
    assert list(choice.generated(names, angles)) == list(la.Library.mechanical(names, angles, size="compact"))


def test_a_known_term_that_is_no_candidate_is_refused():
    choice = Choice(written=True, text="x_dot**2\nx**2", known="x**3 = 1")
    with pytest.raises(InputError, match="is not among"):
        choice.known_terms(choice.library(["x"], []), False)


def test_known_friction_is_found_among_the_friction():
    choice = Choice(written=True, text="x_dot**2\nx**2", friction=["x_dot**2/2"], known="x_dot**2/2 = 0.5")
    assert choice.known_terms(choice.library(["x"], []), False) == {"x_dot**2/2": 0.5}


@pytest.mark.parametrize(
    ("held_out", "every_third", "names"), [(0, False, None), (2, False, "34"), (9, False, "1234")]
)
def test_trials_are_held_out(held_out, every_third, names):
    data = la.Trajectories(la.Trajectory([0.0, 1.0], [0.0, 1.0], name=name) for name in "01234")
    fitted, held = split_trials(data, held_out, every_third)
    assert len(fitted) + (len(held) if held else 0) == 5
    assert (held and "".join(held.names)) == names


def test_every_third_trial_is_held_out():
    data = la.Trajectories(la.Trajectory([0.0, 1.0], [0.0, 1.0], name=name) for name in "01234567")
    fitted, held = split_trials(data, 0, True)
    assert held is not None
    assert ("".join(fitted.names), "".join(held.names)) == ("013467", "25")


# path and motion


def test_walk_has_one_structure_of_each_size():
    walk = Walk.of(spring())
    assert [p.n_terms for p in walk.points] == [1, 2, 3]
    assert walk.chosen == 1
    assert walk.points[1].expressions == ("x_dot**2", "x**2")
    assert walk.difference(2) == (["x**4"], [])
    assert walk.difference(0) == ([], ["x**2"])
    assert "chose" in walk.verdict(1)
    assert "prefers the chosen structure by 893" in walk.verdict(0)


@pytest.mark.parametrize(
    ("reason", "bic", "text"),
    [
        (
            "irrelevant",
            -40.0,
            "better by 40. It was not chosen because each of its additional terms removes less than 5 %",
        ),
        ("fit-is-worse", -7.0, "better by 7. It was not chosen because its own fit does not confirm"),
        (
            "not-worth-its-terms",
            8.0,
            "the chosen structure by 8; 10 is already a strong preference. It was not",
        ),
        ("fits-worse", 900.0, "It was not chosen because it fits the data worse."),
        ("", 900.0, "10 is already a strong preference."),
    ],
)
def test_walk_says_why_a_structure_was_not_chosen(reason, bic, text):
    points = (PathPoint(("x",), 0.0, 0.0, True), PathPoint(("x", "x**2"), -50.0, bic, reason=reason))
    words = Walk(points, 0.05).verdict(1)
    assert text in words
    assert words.endswith(".")


def test_walk_names_shape_parameters():
    """Their numbers change with every refit."""
    terms, templates = ("x_dot**2", "exp(-0.8*x)"), ("", "exp(-{a}*x)")
    points = (
        PathPoint(terms, 0.0, 0.0, True, templates=templates),
        PathPoint(("x_dot**2",), 5.0, 5.0, templates=("",)),
    )
    assert Walk(points).difference(1) == ([], ["exp(-{a}*x)"])


def test_walk_leaves_out_what_is_not_finite():
    model = spring()
    path = (*model.diagnostics.path, PathPoint(("x",) * 4, math.inf, math.inf))
    model = replace(model, diagnostics=replace(model.diagnostics, path=path))
    assert [p.n_terms for p in Walk.of(model).points] == [1, 2, 3]
    assert Walk.of(la.LagrangianModel(["x"], [ModelTerm("x_dot**2", 1.0)])).points == ()


def pendulum(*terms: tuple[str, float]) -> la.LagrangianModel:
    names = ["a", "b"] if any("b" in text.replace("abs", "") for text, _ in terms) else ["a"]
    kinetic = [ModelTerm(f"{name}_dot**2", 1.0) for name in names]
    return la.LagrangianModel(names, [*kinetic, *(ModelTerm(text, value) for text, value in terms)])


@pytest.mark.parametrize(
    ("terms", "down", "joined"),
    [
        ([("cos(a)", 9.8)], [0.0], False),
        ([("cos(a)", -9.8)], [math.pi], False),
        ([("sin(a)", 9.8)], [math.pi / 2], False),
        ([("cos(a)", -9.8), ("cos(b)", 5.0), ("a_dot*b_dot*cos(a-b)", 0.5)], [math.pi, 0.0], False),
        ([("cos(a)", 9.8), ("cos(a+b)", 5.0), ("a_dot*b_dot*cos(b)", 0.5)], [0.0, 0.0], True),
        ([("a**2", -1.0)], None, False),
    ],
)
def test_down_is_where_the_potential_is_lowest(terms, down, joined):
    found, relative = hanging_angles(pendulum(*terms))
    assert relative == joined
    assert found == (down if down is None else pytest.approx(down))


def test_a_chain_of_relative_angles_hangs_straight():
    names = ["a", "b", "c"]
    texts = ["a_dot**2", "b_dot**2", "c_dot**2", "cos(a)", "cos(a+b)", "cos(c+b+a)"]
    model = la.LagrangianModel(names, [ModelTerm(text, -1.0 if "cos" in text else 1.0) for text in texts])
    down, joined = hanging_angles(model)
    assert joined
    assert down == pytest.approx([math.pi, 0.0, 0.0])
    t = np.linspace(0.0, 1.0, 50)
    rest = np.tile([math.pi, 0.0, 0.0], (50, 1))
    assert np.abs(frames(Motion("one", True, t, rest, rest, 1.0), model)["measured"]).max() < 1e-4


@pytest.mark.parametrize("down", [0.0, math.pi])
@pytest.mark.parametrize("ahead", [1.0, -1.0])
def test_a_link_on_a_cart_leans_the_way_it_does(down, ahead):
    """The bob is at x + ahead l sin(theta), l = 0.5, whatever the zero of the angle."""
    texts = {
        "x_dot**2": 1.0,
        "theta_dot**2": 0.25,
        "x_dot*theta_dot*cos(theta)": ahead,
        "cos(theta)": math.cos(down),
    }
    model = la.LagrangianModel(["x", "theta"], [ModelTerm(text, value) for text, value in texts.items()])
    t = np.linspace(0.0, 6.0, 200)
    q = np.column_stack([0.3 * np.sin(t), down + 0.4 * np.cos(t)])
    shown = frames(Motion("one", True, t, q, q, 1.0), model, kind="cart")
    rows, scale = np.array(shown["measured"]), shown["lengths"][0] / 0.5
    bob = rows[:, 0] + shown["lengths"][0] * np.sin(rows[:, 1])
    expected = scale * (q[:, 0] + ahead * 0.5 * np.sin(q[:, 1]))
    np.testing.assert_allclose(bob - bob.mean(), expected - expected.mean(), atol=0.02 * scale)


def chain(masses, lengths, *, relative=False, gravity=9.81, cart=None, given=None):
    """L of point masses at the ends of the links, perhaps on a cart of this mass."""
    n = len(masses)
    names = [*(["x"] if cart else []), *"abc"[:n]]
    q, rates, _ = state_symbols(names)
    angles, speeds = (list(itertools.accumulate(s[-n:])) if relative else s[-n:] for s in (q, rates))
    law = (cart + sum(masses)) * rates[0] ** 2 / 2 if cart else sp.Integer(0)
    for i, j in itertools.product(range(n), repeat=2):
        beyond = sum(masses[max(i, j) :])
        first, last = angles[min(i, j)], angles[max(i, j)]
        between = last - first if relative else first - last
        law += beyond * lengths[i] * lengths[j] * speeds[i] * speeds[j] * sp.cos(between) / 2
    for i in range(n):
        law += sum(masses[i:]) * lengths[i] * gravity * sp.cos(angles[i])
        law += sum(masses[i:]) * lengths[i] * rates[0] * speeds[i] * sp.cos(angles[i]) if cart else 0
    parts = [addend.as_coeff_Mul() for addend in sp.expand(law).as_ordered_terms()]
    terms = [ModelTerm(format_expression(rest), float(number)) for number, rest in parts]
    return la.LagrangianModel(names, terms, provenance={"options": {"lengths": given or {}}})


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("gravity", [9.81, 0])
@pytest.mark.parametrize("cart", [None, 2.0])
def test_links_are_drawn_to_scale(relative, gravity, cart):
    """Positions in the drawing against positions from the geometry, whatever the angles are relative to."""
    lengths = (0.5, 0.2, 0.4) if cart is None else (0.5, 0.2)
    model = chain((0.3, 0.5, 0.2)[: len(lengths)], lengths, relative=relative, gravity=gravity, cart=cart)
    n = model.n_dof
    t = np.linspace(0.0, 3.0, 100)
    q = np.sin(np.outer(t, np.arange(1, n + 1))) * 0.7
    kind = "cart" if cart else "links"
    shown = frames(Motion("one", True, t, q, q, 1.0), model, kind=kind)
    drawn = np.array(shown["lengths"]) / sum(shown["lengths"])
    np.testing.assert_allclose(drawn, np.array(lengths) / sum(lengths), atol=2e-4)
    assert shown["down"] == (gravity > 0)
    turned = np.array(shown["measured"])[:, n - len(lengths) :]
    angles = np.cumsum(q[:, -len(lengths) :], axis=1) if relative else q[:, -len(lengths) :]
    off = turned - angles
    np.testing.assert_allclose(off, np.broadcast_to(off[:1, :1], off.shape), atol=2e-4)
    if gravity:
        np.testing.assert_allclose(off, 0.0, atol=2e-4)
    if cart:
        scale = shown["lengths"][0] / lengths[0]
        np.testing.assert_allclose(
            np.ptp(np.array(shown["measured"])[:, 0]), scale * np.ptp(q[:, 0]), rtol=1e-3
        )
    words = stick_words(kind, model, shown)
    expected = (
        "the scale of the cart's position"
        if cart
        else "0.5 m, 0.2 m and 0.4 m, for g"
        if gravity
        else "1 : 0.4 : 0.8"
    )
    assert expected in words


def test_given_lengths_are_drawn():
    assert link_lengths(chain((1, 1), (0.5, 0.2), given={"a": 0.25}), [0, 0]).values == pytest.approx(
        (0.25, 0.1)
    )
    both = link_lengths(chain((1, 1), (0.5, 0.2), given={"a": 0.5, "b": 0.3}), [0, 0])
    assert (both.values, both.last_given) == ((0.5, 0.3), True)
    # Two pendulums on a common spring are no chain.
    texts = {"a_dot**2": 0.5, "b_dot**2": 0.5, "cos(a)": 9.0, "cos(b)": 9.0, "(a-b)**2": -1.0}
    terms = [ModelTerm(text, value) for text, value in texts.items()]
    assert link_lengths(la.LagrangianModel(["a", "b"], terms), [0, 0]) is None
    options = {"options": {"lengths": {"a": 0.5, "b": 0.3}}}
    assert link_lengths(la.LagrangianModel(["a", "b"], terms, provenance=options), [0, 0]).values == (
        0.5,
        0.3,
    )
    t = np.linspace(0.0, 1.0, 50)
    q = np.outer(np.sin(t), [1.0, 1.0])
    model = la.LagrangianModel(["a", "b"], terms)
    shown = frames(Motion("one", True, t, q, q, 1.0), model)
    assert shown["lengths"] == [49.0, 49.0]
    assert "equally long" in stick_words("links", model, shown)


def test_without_gravity_the_middle_of_the_motion_is_down():
    t = np.linspace(0.0, 2 * np.pi, 201)
    q = np.pi + 0.5 * np.sin(t)[:, None]
    shown = frames(Motion("one", True, t, q, q, 1.0), pendulum(("a**2", -1.0)))
    assert not shown["down"]
    assert np.abs(shown["measured"]).max() == pytest.approx(0.5, abs=0.01)


def test_frames_follow_the_links():
    t = np.linspace(0.0, 1.0, 2001)
    q = np.column_stack([np.pi + t, 0.5 * t])
    measured, forecast = q.copy(), q.copy()
    measured[5:9, 1] = np.nan
    forecast[1500:] = np.nan
    motion = Motion("one", True, t, measured, forecast, 1.0)
    model = pendulum(("cos(a)", -9.8), ("cos(a+b)", -2.0))
    shown = frames(motion, model)
    assert len(shown["t"]) == len(shown["measured"]) == len(shown["forecast"]) <= 900
    assert shown["down"]
    assert shown["forecast"][-1] is None
    # The second link turns with the first one.
    assert shown["forecast"][100] == pytest.approx([1.0 * shown["t"][100], 1.5 * shown["t"][100]], abs=2e-3)
    assert all(row is not None and np.isfinite(row).all() for row in shown["measured"])


@pytest.mark.parametrize(
    ("kind", "names"), [("blocks", ["x"]), ("blocks", ["u", "v"]), ("plane", ["x", "y"])]
)
def test_sliding_bodies_are_drawn_as_wide_as_they_move(kind, names):
    t = np.linspace(0.0, 2 * np.pi, 201)
    q = 3.0 + np.column_stack([0.02 / (k + 1) * np.sin(t + k) for k in range(len(names))])
    model = la.LagrangianModel(names, [ModelTerm(f"{name}_dot**2", 0.5) for name in names])
    assert stick_kind(model, []) == kind
    shown = frames(Motion("one", True, t, q, q, 1.0), model, kind=kind)
    assert np.abs(shown["measured"]).max() == pytest.approx(_motion._REACH, rel=0.01)
    assert shown["lengths"] == []
    assert not shown["down"]


def law(*terms: str) -> la.LagrangianModel:
    """A model of these terms with the coefficient 0.5; coordinates are those of the rates."""
    names = list(dict.fromkeys(re.findall(r"(\w+)_dot", " ".join(terms))))
    return la.LagrangianModel(names, [ModelTerm(text, 0.5) for text in terms])


KINDS = {
    **dict.fromkeys(("single_pendulum", "double_pendulum", "chaotic_pendulum", "triple_pendulum"), "links"),
    "cart_spring_pendulum": "cart",
    **dict.fromkeys(("kepler_orbit", "morse_molecule"), "polar"),
    **dict.fromkeys(("magnetic_pendulum", "henon_heiles"), "plane"),
    **dict.fromkeys(("spring_chain", "toda_chain", "double_well"), "blocks"),
    # motions in space, and a cart with a spring as its link
    **dict.fromkeys(("spherical_pendulum", "spherical_spring_pendulum", "rotary_pendulum"), ""),
    **dict.fromkeys(("robot_arm", "elastic_pendulum_cart"), ""),
}


def test_the_law_decides_what_is_drawn():
    systems = la.systems
    assert {*KINDS} == {*systems.names(), *systems.further_names()}
    for name, kind in KINDS.items():
        system = systems.get(name)
        terms = [ModelTerm(text, value) for text, value in system.lagrangian.items()]
        model = la.LagrangianModel(system.coordinates, terms)
        assert stick_kind(model, system.angles) == kind, name
        # A small additional term changes nothing; neither does the order of the coordinates of a point.
        slight = ModelTerm(f"{model.coordinates[-1]}_dot**4", 1e-3)
        assert stick_kind(replace(model, terms=(*terms, slight)), system.angles) == kind, name
        if kind == "polar":
            turned = replace(model, coordinates=model.coordinates[::-1], noise_std=None)
            assert stick_kind(turned, system.angles) == stick_kind(turned, []) == kind


@pytest.mark.parametrize(
    ("terms", "angles"),
    [
        (["r_dot**2", "phi_dot**2"], ["phi"]),  # no coupling: neither a cart nor a point
        (["r_dot**2", "r**2*phi_dot**2", "r_dot*phi_dot"], ["phi"]),
        (["r_dot**2", "r**2*phi_dot**2", "phi_dot**2"], ["phi"]),
        (["r_dot**2", "2*r**2*phi_dot**2"], ["phi"]),
        (["a_dot**2", "b_dot**2", "cos(a)", "cos(b)", "(a-b)**2"], ["a", "b"]),  # two pendulums and a spring
        (["a_dot**2", "b_dot**2", "a_dot*b_dot*cos(a-b)", "b_dot**2*cos(a)"], ["a", "b"]),
        (["a_dot**2", "b_dot**2", "a_dot*b_dot", "cos(a)", "cos(b)"], ["a", "b"]),
        (["a_dot**2", "abs(a_dot)"], ["a"]),
        (["x_dot**2", "a_dot**2", "x_dot*a_dot"], ["a"]),
        (["x_dot**2", "a_dot**2", "x_dot*a_dot*cos(a)*cos(3*t)"], ["a"]),
        ([f"{name}_dot**2" for name in "abcde"], []),
    ],
)
def test_what_the_law_does_not_confirm_is_not_drawn(terms, angles):
    model = law(*terms)
    assert stick_kind(model, angles) == ""
    assert "no animation" in stick_words("", model, {})


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("gravity", [9.81, 0])
@pytest.mark.parametrize("cart", [None, 2.0])
def test_chains_are_confirmed(relative, gravity, cart):
    model = chain((0.3, 0.5), (0.5, 0.2), relative=relative, gravity=gravity, cart=cart)
    assert stick_kind(model, ["a", "b"]) == ("cart" if cart else "links")
    if cart is None:
        model = chain((0.3, 0.5, 0.2), (0.5, 0.2, 0.4), relative=relative, gravity=gravity)
        assert stick_kind(model, "abc") == "links"


def test_a_polar_point_moves_where_the_coordinates_say():
    t = np.linspace(0.0, 5.0, 200)
    q = np.column_stack([1.0 + 0.3 * np.sin(2 * t), 1.3 * t])
    motion = Motion("one", True, t, q, q, 1.0)
    shown = frames(motion, law("r_dot**2", "r**2*phi_dot**2", "1/r"), kind="polar")
    scale = _motion._REACH / q[:, 0].max()
    place = scale * q[:, :1] * np.column_stack([np.cos(q[:, 1]), np.sin(q[:, 1])])
    np.testing.assert_allclose(shown["measured"], place, atol=1e-3)
    assert not shown["down"]
    assert "origin" in stick_words("polar", law("r_dot**2", "r**2*phi_dot**2"), shown)
    # the coordinates the other way round
    other = replace(motion, measured=q[:, ::-1], forecast=q[:, ::-1])
    turned = law("r**2*phi_dot**2", "r_dot**2")
    assert turned.coordinates == ("phi", "r")
    assert frames(other, turned, kind="polar")["forecast"] == shown["forecast"]


@pytest.mark.parametrize("down", [0.0, math.pi, 0.4])
@pytest.mark.parametrize("radius", ["r*", ""])
def test_a_swinging_spring_hangs_where_its_potential_is_lowest(down, radius):
    terms = {"r_dot**2": 0.5, "r**2*a_dot**2": 0.5, "r**2": -20.0, "r": 40.0}
    terms |= {f"{radius}cos(a)": 9.81 * math.cos(down), f"{radius}sin(a)": 9.81 * math.sin(down)}
    model = la.LagrangianModel(["r", "a"], [ModelTerm(text, value) for text, value in terms.items()])
    assert stick_kind(model, ["a"]) == "polar"
    t = np.linspace(0.0, 5.0, 200)
    q = np.column_stack([1.2 + 0.1 * np.sin(5 * t), down + 0.5 * np.cos(2 * t)])
    shown = frames(Motion("one", True, t, q, q, 1.0), model, kind="polar")
    assert shown["down"]
    lean, reach = 0.5 * np.cos(2 * t), _motion._REACH / q[:, 0].max() * q[:, 0]
    place = np.column_stack([reach * np.sin(lean), -reach * np.cos(lean)])
    np.testing.assert_allclose(shown["measured"], place, atol=1e-3)


RELATIVE = chain((0.3, 0.5), (0.5, 0.2), relative=True)
ABSOLUTE = chain((0.3, 0.5), (0.5, 0.2))
CART = chain((0.3,), (0.5,), cart=2.0)


@pytest.mark.parametrize(
    ("kind", "model", "unseen", "estimated"),
    [
        ("links", ABSOLUTE, 1, [False, True]),
        ("links", ABSOLUTE, 0, [True, False]),
        ("links", RELATIVE, 0, [True, True]),  # the direction of the second link follows from both
        ("cart", CART, 0, [True, False]),
        ("cart", CART, 1, [False, True]),
        ("blocks", law("u_dot**2", "v_dot**2"), 1, [False, True]),
        ("plane", law("x_dot**2", "y_dot**2"), 1, [False, True]),
        ("polar", law("r_dot**2", "r**2*phi_dot**2"), 1, [True, True]),
    ],
)
def test_what_no_sensor_saw_is_drawn_from_its_estimate(kind, model, unseen, estimated):
    t = np.linspace(0.0, 2.0, 101)
    q = np.column_stack([1.0 + 0.2 * np.sin(3 * t), 0.3 * np.cos(2 * t)])
    measured = q.copy()
    measured[:, unseen] = np.nan
    guess = HiddenMotion(t, q[:, unseen], np.full(t.size, 0.01))
    alone = Motion("one", False, t, measured, q, 1.0, unseen=(unseen,))
    known = replace(alone, estimated={unseen: guess})
    shown, whole = (
        frames(motion, model, kind=kind) for motion in (known, replace(known, measured=q, estimated={}))
    )
    assert shown["estimated"] == estimated
    assert shown["measured"] == whole["measured"] == whole["forecast"]
    assert whole["estimated"] == [False, False]
    # Without an estimate, there is only what follows from the samples.
    left = frames(alone, model, kind=kind)
    assert left["estimated"] == [False, False]
    assert left["forecast"] == whole["forecast"]
    for row, full in zip(left["measured"], whole["measured"], strict=True):
        kept = [None if flag else x for flag, x in zip(estimated, full, strict=True)]
        assert row == (None if all(estimated) else kept)


def test_the_chart_of_what_no_sensor_saw_has_the_estimate_with_its_band():
    t = np.linspace(0.0, 2.0, 101)
    q = np.column_stack([np.sin(t), np.cos(t)])
    measured = np.column_stack([q[:, 0], np.full(t.size, np.nan)])
    guess = HiddenMotion(t, q[:, 1], 0.01 + 0.02 * t)
    assert guess.reach[-1] == pytest.approx(1.96 * 0.05)
    motion = Motion("one", False, t, measured, q, 1.0, unseen=(1,), estimated={1: guess})
    first, second = (forecast_figure(motion, i, "ab"[i], "rad") for i in (0, 1))
    only = forecast_figure(replace(motion, estimated={}), 1, "b", "rad")
    assert "estimated" not in first
    assert "the estimated motion with its 95 % band, the forecast as a line" in second
    assert ("var(--fit)" in first, "var(--fit)" in second, "var(--fit)" in only) == (False, True, False)
    assert "var(--forecast)" in only
    assert "measured" not in only
    words = unseen_words(motion, ["a", "b"], searched=True)
    assert words.startswith("b: not measured, but estimated from the equations (95 % band: at most ± 0.098)")
    words = unseen_words(replace(motion, estimated={}), ["a", "b"], searched=False)
    assert words.startswith("b: not measured. Only its forecast is drawn, because a session")
    assert unseen_words(replace(motion, unseen=()), ["a", "b"], searched=True) == ""


def test_the_forecast_of_what_no_sensor_saw_goes_with_its_estimate():
    """On a trial of the fit, whose turns it takes; without an estimate, on the trial that was held out."""
    system = la.systems.get("chaotic_pendulum")
    truth = la.systems.generate(system, noise=0.0, trials=2, duration=3.0, rate=50.0, seed=3)
    terms = [ModelTerm(text, value) for text, value in system.lagrangian.items()]
    guess = HiddenMotion(truth[0].t, truth[0].q[:, 1] + 6 * np.pi, np.full(truth[0].n_times, 0.01))
    model = la.LagrangianModel(
        system.coordinates,
        terms,
        provenance={"options": {"angles": list(system.angles)}},
        diagnostics=replace(spring().diagnostics, hidden_motion={"theta2": (guess,)}),
    )
    seen = arranged(truth, ["theta1"])
    library = la.Library(list(system.lagrangian), system.coordinates, angles=system.angles)
    task = _candidates.Task(seen.select(0), seen.select(1), library, {}, hidden=("theta2",))
    first, bare = (
        _jobs.forecast(lambda *_: None, task, known).motion
        for known in (model, replace(model, diagnostics=None))
    )
    for motion, run, held_out in ((first, truth[0], False), (bare, truth[1], True)):
        assert (motion.held_out, motion.unseen) == (held_out, (1,))
        assert np.isnan(motion.measured[:, 1]).all()
        away = motion.forecast - np.column_stack([np.interp(motion.t, run.t, q) for q in run.q.T])
        turns = 2 * np.pi * np.round(away[0] / (2 * np.pi))
        np.testing.assert_allclose(away, np.broadcast_to(turns, away.shape), atol=0.02)
    np.testing.assert_allclose(first.forecast[:, 1], first.estimated[1].q, atol=0.02)
    assert abs(bare.forecast[0, 1]) <= np.pi
    assert (first.trial, bare.trial, bare.estimated) == (*truth.names, {})


def test_what_one_click_may_do():
    library = la.Library(["theta_dot**2", "sin(theta)"], ["theta"], dissipation=["theta_dot**2/2"])
    choice = Choice(more_friction="abs(theta_dot)", delay=0.01)

    def offer(code: str, *subject: str, **values):
        return proposed(Finding(code, "warning", subject, values, "so it is", "do it"), choice, library)

    (add,) = offer("missing-term", "cos(theta)", constant_force="theta")
    assert add.words == "Add cos(theta)"
    assert add.choice.text.splitlines() == ["theta_dot**2", "sin(theta)", "cos(theta)"]
    assert add.choice.written
    assert add.choice.offsets == ["theta"]
    assert [o.words for o in offer("missing-term", "x", angles=["x"])] == ["Add x", "x: an angle"]
    (rub,) = offer("unmodelled-friction", "abs(theta_dot)**3/3", coefficient=0.2)
    assert rub.choice.more_friction.splitlines() == ["abs(theta_dot)", "abs(theta_dot)**3/3"]
    assert not rub.choice.written
    part = {"hidden": "h", "terms": ["h_dot**2", "(theta-h)**2"], "friction": "(theta_dot-h_dot)**2/2"}
    (hide,) = offer("unmeasured-part", "theta", **part)
    assert hide.choice.hidden == "h"
    assert hide.choice.text.splitlines() == ["theta_dot**2", "sin(theta)", "h_dot**2", "(theta-h)**2"]
    assert hide.choice.more_friction.splitlines() == ["abs(theta_dot)", "(theta_dot-h_dot)**2/2"]
    (both,) = offer(
        "unmeasured-part", "theta", **part | {"hidden": "h, h1", "friction": "h_dot**2, h1_dot**2"}
    )
    assert both.words == "Add parts h, h1 without a sensor"
    assert both.choice.hidden == "h, h1"
    assert both.choice.more_friction.splitlines() == ["abs(theta_dot)", "h_dot**2", "h1_dot**2"]
    for code in ("late-forces", "slight-delay"):
        (later,) = offer(code, "theta", delay=0.004)
        assert later.words == "Let the forces act 14 ms later"
        assert later.choice.delay == pytest.approx(0.014)
    for code in ("form-imitated", "simpler-form"):
        assert offer(code, "x", family=["exp(-{a}*theta)"])[0].words == "Add exp(-{a}*theta)"
        assert offer(code, "x") == []
    (fewer,) = offer("slight-terms", "sin(theta)")
    assert fewer.choice.text == "theta_dot**2"
    (moved,) = offer("equations-off", "theta", may_be_prescribed=True, cause_named=False)
    assert moved.choice.prescribed == ["theta"]
    assert offer("equations-off", "theta", may_be_prescribed=True, cause_named=True) == []
    assert offer("perhaps-angle", "theta")[0].roles == {"theta": ANGLE}
    assert offer("undeclared-angle", "theta")[0].roles == {"theta": ANGLE}
    assert offer("angle-in-degrees", "theta")[0].roles == {"theta": DEGREES}
    assert offer("long-time-step", column="time")[0].roles == {"time": MILLISECONDS}
    assert offer("slight-friction", "theta_dot**2/2", coefficient=-0.1) == []
    assert offer("motion-in-noise", "theta") == []
    assert choice == Choice(more_friction="abs(theta_dot)", delay=0.01)


def test_a_known_coefficient_is_left_free_only_if_something_else_sets_the_scale():
    library = la.Library(["theta_dot**2", "cos(theta)"], ["theta"])
    wrong = Finding("wrong-known-coefficient", "warning", ["cos(theta)"], {}, "so it is", "do it")
    one = Choice(known="cos(theta) = 1")
    both = Choice(known="cos(theta) = 1\ntheta_dot**2 = 0.5")
    assert proposed(wrong, one, library) == []
    assert proposed(wrong, one, library, driven=True)[0].choice.known == ""
    assert proposed(wrong, both, library)[0].choice.known == "theta_dot**2 = 0.5"


def test_every_remedy_that_is_an_option_has_a_button():
    """What the command line advises as an option with a known value, the app does by a click."""
    options = re.compile(r"--(term|angles|dissipation|force-delay|units|time-unit|prescribed)\b")
    advised = {
        code for code, row in CODES.items()
        if isinstance(row.on_command_line, str) and options.search(row.on_command_line)
    }  # fmt: skip
    assert advised >= {"unmodelled-friction", "late-forces", "angle-in-degrees", "undeclared-angle"}
    person_decides = {"length-implausible"}  # which unit the times have
    assert advised - person_decides <= {*_remedies._OFFERS}


def test_coordinates_without_a_sensor_are_in_the_candidates():
    runs = la.Trajectories([la.Trajectory(np.arange(50) / 10, np.sin(np.arange(50)), coordinates=["a"])])
    choice = Choice(known="a_dot**2 = 1", hidden="b", hidden_angles=True, families=["stribeck"])
    task = choice.task(runs, ["a"])
    assert task.hidden == ("b",)
    assert (task.library.coordinates, task.library.angles) == (("a", "b"), ("a", "b"))
    assert "-{b_stribeck}*exp(-abs(b_dot)/{b_stribeck})" in [t.text for t in task.library.dissipation]
    for name, text in (("a", "is measured"), ("2b", "2b"), ("sin", "sin")):
        with pytest.raises(InputError, match=text):
            replace(choice, hidden=name).task(runs, ["a"])


# ------------------------------------------------------------------------- the worker process and the session
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


def contents(*paths) -> list[tuple[str, bytes]]:
    return [(path.name, path.read_bytes()) for path in paths]


def test_a_log_with_a_robot_is_identified(session, tmp_path):
    log, robot = page_helpers.arm_log(tmp_path)
    session.open_uploads(contents(robot, log))
    assert session.arm.joints == ("shoulder", "elbow")
    assert session.arm.columns.torques == {"shoulder": "tau1", "elbow": "tau2"}
    session.identify()
    wait(session.arm_job)
    found = session.arm_job.result
    assert {*found.files} == {"arm.json", "inverse_dynamics.py", "arm.urdf"}
    assert "held out" in found.report
    assert found.motion.duration == pytest.approx(5.995)  # the whole log, not the fitted part of it
    assert (found.motion.trial, found.motion.frames["kind"]) == ("", "arm")
    (tmp_path / "arm.json").write_bytes(found.files["arm.json"])
    rod = arms.load(tmp_path / "arm.json").tree.inertias[1]
    assert rod[3] == pytest.approx(0.15 / 1.2, rel=5e-3)  # m z of the last link; the URDF says 0.15


def two_links(horizontal: bool = False) -> arms.KinematicTree:
    """Two links of 0.4 m and 0.3 m on a column of 0.2 m, with uniform mass; they fold about y, or about z."""
    axis, along = ([0, 0, 1], [1, 0, 0]) if horizontal else ([0, 1, 0], [0, 0, 1])
    origins = [[0, 0, 0.2], [0.4 * x for x in along]]
    rows = [{"axis": axis, "origin": origin} for origin in origins]
    middles = np.outer([0.2, 0.15], along)
    links = [[2.0, *(2.0 * middle), 0.2, 0, 0, 0.2, 0, 0.2] for middle in middles]
    return arms.KinematicTree.from_joints(rows).with_inertias(links)


def folding(t: np.ndarray, name: str = "") -> la.Trajectory:
    q = np.column_stack([0.9 * np.sin(1.3 * t), 1.1 * np.cos(2.1 * t)])
    return la.Trajectory(t, q, coordinates=["q1", "q2"], name=name)


def drawn_at(motion, view: int = 0) -> np.ndarray:
    """(n_frames, n_points, 2) of an arm, in pixels."""
    rows = np.array([row[view] for row in motion.frames["measured"]])
    return rows.reshape(len(rows), -1, 2)


@pytest.mark.parametrize("horizontal", [False, True])
def test_a_planar_arm_moves_as_its_angles_say(horizontal):
    t = np.linspace(0.0, 6.0, 301)
    motion = motion_of(la.Trajectories([folding(t)]), two_links(horizontal))
    one, both = np.cumsum(folding(t).q, axis=1).T
    if horizontal:
        turned, foot = [np.column_stack([np.cos(a), np.sin(a)]) for a in (one, both)], np.zeros((301, 2))
        height = 0.2
    else:
        turned = [np.column_stack([np.sin(a), np.cos(a)]) for a in (one, both)]
        foot, height = np.tile([0.0, 0.2], (301, 1)), 0.0
    elbow = foot + 0.4 * turned[0]
    places = np.stack([np.zeros((301, 2)), foot, elbow, elbow + 0.15 * turned[1]], axis=1)
    farthest = np.sqrt((places[:, 1:] ** 2).sum(axis=2) + height**2).max()
    np.testing.assert_allclose(drawn_at(motion), 98.0 / farthest * places, atol=0.051)
    side = "x to the right, from above" if horizontal else "x to the right, height upwards"
    assert motion.frames["views"] == [side]  # it shows all of the motion
    assert motion.frames["limbs"] == [[0, 1], [1, 2], [2, 3]]
    assert motion.frames["t"] == pytest.approx(t, abs=1e-5)


def test_an_arm_that_moves_in_space_is_drawn_from_two_sides():
    t = np.linspace(0.0, 6.0, 301)
    rows = [{"axis": [0, 0, 1]}, {"axis": [0, 1, 0], "origin": [0, 0, 0.3]}]
    tree = arms.KinematicTree.from_joints(rows).with_inertias([[1, 0, 0, 0.2, 0.1, 0, 0, 0.1, 0, 0.1]] * 2)
    motion = motion_of(la.Trajectories([folding(t)]), tree)
    assert motion.frames["views"] == [f"{name} to the right, height upwards" for name in "xy"]
    across, deep = drawn_at(motion, 0), drawn_at(motion, 1)
    np.testing.assert_array_equal(across[..., 1], deep[..., 1])  # one scale, one height
    tip = np.stack([across[:, -1, 0], deep[:, -1, 0], across[:, -1, 1] - across[:, -2, 1]], axis=1)
    np.testing.assert_allclose(np.linalg.norm(tip, axis=1), np.linalg.norm(tip[0]), atol=0.2)
    assert (
        np.abs(tip[:, 0] * np.sin(0.9 * np.sin(1.3 * t)) - tip[:, 1] * np.cos(0.9 * np.sin(1.3 * t))).max()
        < 0.2
    )


def test_a_branched_arm_is_drawn_to_the_end_of_each_branch():
    rows = [{"axis": [0, 1, 0], "origin": [0, 0, 0.3], "name": "trunk"}]
    rows += [{"axis": [0, 1, 0], "origin": [x, 0, 0.3], "parent": "trunk"} for x in (-0.1, 0.1)]
    tree = arms.KinematicTree.from_joints(rows).with_inertias([[1, 0, 0, 0.1, 0.1, 0, 0, 0.1, 0, 0.1]] * 3)
    t = np.linspace(0.0, 6.0, 301)
    q = np.sin(np.outer(t, [1.0, 2.0, 3.0]))
    motion = motion_of(la.Trajectories([la.Trajectory(t, q, coordinates=tree.coordinates)]), tree)
    assert motion.frames["limbs"] == [[0, 1], [1, 2], [1, 3], [2, 4], [3, 5]]
    assert drawn_at(motion).shape == (301, 6, 2)


def test_a_long_log_of_an_arm_is_thinned():
    t = np.arange(0.0, 100.0, 0.001)
    one, long, same = folding(t[:5000], "one"), folding(t, "long"), folding(t, "same")
    motion = motion_of(la.Trajectories([one, long, same]), two_links())
    assert (motion.trial, motion.duration) == ("long", pytest.approx(99.999))
    shown = np.array(motion.frames["t"])
    assert 600 < len(shown) <= 900
    assert len(motion.frames["measured"]) == len(shown)
    assert 29.0 < shown[-1] <= 30.0
    elbow = drawn_at(motion)[:, 2] - drawn_at(motion)[:, 1]
    np.testing.assert_allclose(np.arctan2(elbow[:, 0], elbow[:, 1]), 0.9 * np.sin(1.3 * shown), atol=2e-3)


def test_an_arm_stays_where_a_sample_is_missing():
    run = folding(np.linspace(0.0, 6.0, 301))
    q = run.q.copy()
    q[100:110, 1] = np.nan
    gaps = la.Trajectory(run.t, q, coordinates=["q1", "q2"])
    seen, full = (drawn_at(motion_of(la.Trajectories([r]), two_links())) for r in (gaps, run))
    np.testing.assert_array_equal(seen[:100], full[:100])
    np.testing.assert_array_equal(seen[100:, :3], full[100:, :3])
    assert np.abs(seen[109] - full[109]).max() > 1.0
    np.testing.assert_array_equal(seen[110:], full[110:])


def test_a_drawing_in_which_nothing_would_move_is_left_out():
    t = np.linspace(0.0, 6.0, 301)
    still = la.Trajectory(t, np.full((301, 2), 0.3), coordinates=["q1", "q2"])
    assert motion_of(la.Trajectories([still]), two_links()) is None
    # The order of the columns is that of the log.
    run = folding(t)
    other = la.Trajectory(t, run.q[:, ::-1], coordinates=["q2", "q1"])
    first, second = (motion_of(la.Trajectories([r]), two_links()).frames for r in (run, other))
    assert first == second


def test_log_and_robot_may_come_one_after_the_other(session, tmp_path):
    log, robot = page_helpers.arm_log(tmp_path)
    with pytest.raises(InputError, match="URDF or MuJoCo file and the table of its log"):
        session.open_uploads(contents(robot))
    session.open_uploads(contents(log))
    session.open_uploads(contents(robot))
    assert session.arm.title == "log.csv, two.urdf"
    session.open_uploads([("run.csv", swing(1.0))])
    assert session.arm is None
    session.open_uploads([(f"{'Arm ' * 20}.URDF", robot.read_bytes()), *contents(log)])
    assert session.arm.robot.suffix == ".urdf"


def test_a_robot_that_does_not_fit_its_log_is_refused(session, tmp_path):
    log, robot = page_helpers.arm_log(tmp_path)
    with pytest.raises(InputError, match="neither torques nor motor currents"):
        session.open_uploads([("log.csv", log.read_bytes().replace(b"tau", b"weight")), *contents(robot)])
    with pytest.raises(InputError, match=r"two\.xml"):
        session.open_uploads([("two.xml", b"<mujoco"), *contents(log)])
    assert session.arm is None


def test_measured_velocities_have_a_role(session):
    upload(session, "run.csv", swing(1.0))
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
        upload(other, "mine.leastaction", content)
        assert (other.title, other.roles, other.choice) == (session.title, session.roles, session.choice)
        assert other.data.digest() == session.data.digest()
        assert "find the Lagrangian to see a result" in other.hint
        assert not other.found
        other.open_example("single")
        assert other.hint == ""
    finally:
        other.close()


def members_of(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        return {name: file.read(name) for name in file.namelist()}


def test_a_session_of_an_earlier_version_still_opens(session):
    """As written before sessions held a model; choices that came later are missing."""
    said = {
        "leastaction session": 1,
        "title": "a.csv",
        "tables": ["a.csv"],
        "roles": {"t": TIME, "x": COORDINATE, "x_dot": UNUSED},
        "choice": {"written": True, "text": "x_dot**2\nx**2", "known": "x_dot**2 = 1", "held_out": 0},
    }
    content = {"session.json": json.dumps(said).encode(), "tables/a.csv": swing(1.0)}
    upload(session, "old.leastaction", _files.archive(content))
    assert (session.title, session.data.coordinates) == ("a.csv", ("x",))
    assert session.choice == Choice(written=True, text="x_dot**2\nx**2", known="x_dot**2 = 1")
    assert not session.found


def test_an_earlier_version_reads_sessions_with_a_model(session):
    """It reads these entries, and ignores others."""
    upload(session, "a.csv", swing(1.0))
    session.found = {0: Found(oscillator(), "fitted")}
    members = members_of(session.save())
    said = json.loads(members.pop("session.json"))
    assert said["leastaction session"] == 1
    assert {"title", "tables", "roles", "choice"} <= {*said}
    assert la.LagrangianModel.from_dict(json.loads(members["model.json"])).to_dict() == oscillator().to_dict()


def oscillator() -> la.LagrangianModel:
    """The law of `swing`."""
    terms = [ModelTerm("x_dot**2", 1.0, known=True), ModelTerm("x**2", -9.0, 0.1)]
    options = {"angles": [], "lengths": {}}
    return la.LagrangianModel(["x"], terms, covariance=[[0.01]], provenance={"options": options})


@pytest.mark.parametrize(
    "change",
    [
        {"choice": {"held_out": "many"}},
        {"choice": {"delay": math.nan}},
        {"searched": {"friction": "x"}},
        {"tables": ["../../etc/passwd"]},
        {"tables": ["a.csv", "a.csv"]},
        {"tables": []},
        {"roles": 3},
        {"leastaction session": 99},
        {"model.json": b"{"},
        {"model.json": b"[" * 10_000},
        {"model.json": 3},
        {"coordinates": ["y"]},
        {"terms": []},
        {
            "terms": [
                {"expression": "__import__('os')", "coefficient": 1, "standard_error": None, "known": True}
            ]
        },
        {"fit": {"status": "ok"}},
        {"provenance": {"options": 3}},
        {"provenance": {"options": {"lengths": {"x": "long"}}}},
        {"covariance": [[1.0, 0.0]]},
    ],
)
def test_a_damaged_session_is_refused(session, change):
    """In one line; what was open stays open."""
    upload(session, "a.csv", swing(1.0))
    session.found = {0: Found(oscillator(), "fitted")}
    members = members_of(session.save())
    ((entry, value),) = change.items()
    if entry == "model.json":
        members[entry] = value if isinstance(value, bytes) else json.dumps(value).encode()
    else:
        name = (
            "session.json"
            if entry in ("choice", "searched", "tables", "roles", "leastaction session")
            else "model.json"
        )
        members[name] = json.dumps(json.loads(members[name]) | change).encode()
    for content in (_files.archive(members), b"PK nothing"):
        with pytest.raises(InputError, match="session cannot be opened") as error:
            upload(session, "b.leastaction", content)
        assert "\n" not in str(error.value)
    assert session.title == "a.csv"
    assert session.found


def test_a_session_that_was_changed_on_the_way_is_refused_or_opens(session, rng):
    """Whatever byte is damaged: one line, or a session."""
    upload(session, "a.csv", swing(1.0))
    session.found = {0: Found(oscillator(), "fitted")}
    content, messages = session.save(), []
    for place in rng.integers(len(content), size=60):
        damaged = bytearray(content)
        damaged[place] ^= int(rng.integers(1, 256))
        try:
            _files.open_saved(bytes(damaged))
        except InputError as error:
            messages.append(str(error))
    assert messages
    assert all("session cannot be opened" in text and "\n" not in text for text in messages)


def test_a_model_of_other_coordinates_has_no_forecast(session):
    upload(session, "a.csv", swing(1.0))
    model = la.LagrangianModel(["y"], [ModelTerm("y_dot**2", 1.0)])
    session.found, session.searched = {0: Found(model, "fitted")}, session.choice
    upload(session, "b.leastaction", session.save())
    assert session.faults == {0: "the model of this session is of y, but its data are of x"}
    assert not session.waiting
    assert (session.task, session.job) == (None, None)


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
    upload(session, "my run.csv", path.read_bytes())
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


def test_the_result_is_saved_and_shown_again(walking):
    """The same law with the same errors at once, and the same forecasts after a while."""
    before = walking.current
    walking.choice.held_out, walking.choice.every_third = 0, False  # after the search
    content = walking.save()
    walking.choice = replace(walking.searched)
    other = Session()
    try:
        upload(other, "mine.leastaction", content)
        assert other.choice.every_third is False
        assert other.searched == walking.searched
        assert other.current.stage in ("fitted", "forecast")
        assert other.current.model.to_dict() == before.model.to_dict()
        assert other.current.model.diagnostics is None
        assert other.walk.points == ()
        until(other, lambda: not other.waiting)
        after = other.current
        assert after.motion.held_out
        np.testing.assert_allclose(after.validation.rms, before.validation.rms, rtol=1e-6)
        np.testing.assert_allclose(after.motion.forecast, before.motion.forecast, rtol=1e-6, atol=1e-9)
        assert json.loads(other.write_model()) == json.loads(walking.write_model())
        with zipfile.ZipFile(io.BytesIO(other.write_everything())) as file:
            assert "leastaction_model.py" in file.namelist()
            assert "report.html" not in file.namelist()
        with pytest.raises(InputError, match="has no diagnostics"):
            other.write_report()
        assert members_of(other.save())["model.json"] == members_of(content)["model.json"]
    finally:
        other.close()


def test_a_provisional_model_is_not_saved(walking):
    walking.go_to(walking.walk.chosen + 1)
    walking.stay()
    assert walking.current.stage == "provisional"
    model = json.loads(members_of(walking.save())["model.json"])
    assert model == json.loads(json.dumps(walking.best.model.to_dict()))


@pytest.mark.thorough
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


@pytest.mark.parametrize(
    ("name", "content", "cure"),
    [
        ("one.csv", "x\n1\n2\n", "one for the time, one for each coordinate"),
        ("header.csv", "t,x\n", "at least 5 samples are needed"),
        ("page.csv", "<html><body>Sign in</body></html>", "save the table itself as CSV"),
        ("export.csv", '{"t": [0, 1], "x": [1, 2]}', "save the table itself as CSV"),
        ("logger.csv", "Logger,7\nserial,a,b\nt,x\n0,1\n0.1,2\n", "delete the lines above it"),
        ("twice.csv", "t,x,x\n0,1,2\n", "give each its own name"),
        ("book.csv", b"PK\x03\x04" + bytes(99), "name it .xlsx"),
        ("empty.csv", "", "a file with data is expected"),
        ("numbers.csv", "0,1\n0.1,2\n", "add a first line that names the columns"),
    ],
)
def test_a_file_without_a_choice_of_roles_is_refused_with_the_cure(session, name, content, cure):
    """No list of roles could mend these, so the page must not ask for roles."""
    with pytest.raises(InputError, match=re.escape(cure)):
        upload(session, name, content.encode() if isinstance(content, str) else content)
    assert session.columns is None


def test_a_bad_file_leaves_the_open_one_open(session, tmp_path):
    session.open_example("single")
    with pytest.raises(InputError, match="not a table"):
        upload(session, "photo.png", b"\x89PNG")
    with pytest.raises(InputError, match="binary data"):
        upload(session, "photo.csv", b"\x89PNG\0\0")
    with pytest.raises(InputError, match="damaged gzip"):
        upload(session, "a.csv.gz", b"\x1f\x8b\x08nothing")
    assert session.title == _files.EXAMPLES["single"][0]
    assert session.data is not None


def test_a_bad_cell_is_named_without_the_temporary_folder(session):
    upload(session, "run.csv", b"t,x\n" + b"".join(b"%d,%d\n" % (k, k * k) for k in range(60)) + b"60,oops\n")
    assert session.data is None
    assert session.fault.startswith("run.csv, line 62, column 'x': 'oops' is not a number")
    session.roles["x"] = UNUSED
    session.read()
    assert "no column is a coordinate" in session.fault


@pytest.mark.parametrize("name", ["../../etc/passwd.csv", "..\\..\\a.csv", "/abs.csv", "<b>.csv", "....csv"])
def test_the_name_of_an_upload_stays_in_the_folder(session, name):
    upload(session, name, b"t,x\n" + b"".join(b"%d,%d\n" % (k, k * k) for k in range(9)))
    assert session._paths[0].resolve().parent == session.folder.resolve()


def test_uploads_are_limited(session, monkeypatch):
    monkeypatch.setattr(_files, "MOST_BYTES", 1_000_000)
    with pytest.raises(InputError, match="larger than 1 MB"):
        upload(session, "a.csv", b"x" * 1_000_001)
    with pytest.raises(InputError, match="when it is unpacked"):
        upload(session, "a.csv.gz", gzip.compress(b"0" * 3_000_000))
    assert list(session.folder.iterdir()) == []


def test_other_roles_bring_other_candidates_only_if_they_must(session, tmp_path):
    path = page_helpers.driven_pendulum(tmp_path / "run.csv")
    upload(session, "run.csv", path.read_bytes())
    session.choice.size = "compact"
    session.roles["theta"] = COORDINATE
    session.read()
    assert session.choice.size == "compact"
    session.roles["tau"] = UNUSED
    session.read()
    assert session.choice == Choice(known="theta_dot**2 = 1", held_out=1)


def test_cancel_leaves_the_session_usable(session, tmp_path):
    session.open_example("double")
    job = session.discover()
    while job.stage == "":
        time.sleep(0.02)
    session.stop()
    assert job.state == "cancelled"
    assert not session.collect()
    assert session.found == {}
    upload(session, "run.csv", page_helpers.driven_pendulum(tmp_path / "run.csv").read_bytes())
    session.choice.size = "compact"
    assert wait(session.discover()).state == "done"
    assert session.collect()


def test_data_that_support_nothing_say_so(session):
    upload(session, "still.csv", b"t,x\n" + b"".join(b"%g,1\n" % (0.01 * k) for k in range(200)))
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
    upload(session, "run.xlsx", content)
    assert session.roles == {"t_ms": MILLISECONDS, "theta [deg]": DEGREES}
    assert session.columns.sample("theta [deg]") == "0, 10, 20"
    assert session.data[0].q[-1, 0] == pytest.approx(1.2217, rel=1e-4)
    assert [finding.code for finding in session.data.findings] == ["time-unit", "converted-units"]
    monkeypatch.setattr(_files, "MOST_BYTES", 2 * len(content))
    with pytest.raises(InputError, match="when it is unpacked"):
        upload(session, "run.xlsx", content)
