"""How objects show themselves: cards in notebooks and terminals, plots, data frames."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import leastaction as la
from leastaction.findings import Finding, find
from leastaction.model.diagnostics import PathPoint, TradeOff
from leastaction.model.groups import GroupDifference, Groups
from leastaction.model.mathml import Notation
from leastaction.model.model import FitSummary, ModelTerm
from leastaction.shown import Card, Display, Panel, Series, Typeset
from page_helpers import Page, spring

HOSTILE = '<script>alert("1")</script>'
T = np.linspace(0.0, 4.0, 201)


@pytest.fixture(autouse=True)
def _no_figure_stays():
    yield
    plt.close("all")


def run(name="a", **given):
    return la.Trajectory(T, np.cos(2.0 * T), coordinates=["theta1"], name=name, **given)


def doubtful() -> la.LagrangianModel:
    findings = [
        Finding("an-aside", "note", message="all is calm"),
        Finding("a-doubt", "warning", message=f"too slow {HOSTILE}", remedy="swing more"),
    ]
    return replace(spring(friction=0.1), fit=FitSummary("doubtful", 1.1, [1e6], findings=findings))


def cells(html: str) -> list[list[str]]:
    """Rows of the only table, as a reader of the page sees them."""
    (table,) = Page(html).root.all("table")
    return [[cell.text for cell in row.all("th", "td")] for row in table.all("tr")]


# ------------------------------------------------------------------------------------------------- cards
HOSTILE_THINGS = {
    "trajectory": lambda: run(HOSTILE),
    "trajectories": lambda: la.Trajectories([run(HOSTILE), run("b")]),
    "finding of data": lambda: run(findings=[Finding.of_text(HOSTILE, "note")]),
    "model": doubtful,
    "fit": lambda: doubtful().fit,
    "simulation": lambda: replace(
        spring().simulate([1.0], [0.0], T), reason=HOSTILE, status="stopped", coordinates=(HOSTILE,)
    ),
    "forecast": lambda: replace(
        spring().validate(la.Trajectory(T, np.cos(2 * T), coordinates=["x"])), skipped=((HOSTILE, HOSTILE),)
    ),
    "trade-off": lambda: TradeOff([PathPoint((HOSTILE,), 0.0, 0.0, True)]),
    "group": lambda: replace(
        spring(),
        groups=Groups(["a", HOSTILE], [GroupDifference("x**2", HOSTILE, 0.1, 0.01)]),
    ),
}


@pytest.mark.parametrize("name", HOSTILE_THINGS)
def test_what_users_write_is_escaped(name):
    html = HOSTILE_THINGS[name]()._repr_html_()
    assert "<script" not in html
    assert "&lt;script&gt;alert(" in html
    assert 'title="<' not in html


def test_a_model_shows_status_formula_terms_and_warnings_first():
    html = doubtful()._repr_html_()
    page = Page(html)
    assert html.index("fit: doubtful") < html.index("<math") < html.index("<table") < html.index("too slow")
    assert html.index("warning: too slow") < html.index("all is calm")
    formulas = page.root.all("span", class_="formula")
    assert [re.sub(r"\s", "", f.text)[:2] for f in formulas] == ["L=", "ψ="]
    assert "±" in formulas[0].text
    assert "known" in formulas[0].text
    assert 'title="x_dot**2"' in html  # what to type, where the mouse rests


def test_colours_are_those_of_the_notebook():
    html = doubtful()._repr_html_()
    (style,) = re.findall(r"<style>(.*?)</style>", html)
    assert not re.findall(r"#[0-9a-f]{3,6}|(?<!-)background:(?!none)|(?<![-\w])color:(?!inherit)", style)
    assert all(rule.lstrip().startswith(".leastaction") for rule in re.findall(r"([^{}]+)\{", style))
    assert not re.search(r"src=|href=|url\(|@import", html)


def test_cards_hold_the_figures():
    data = la.Trajectories([run("a", forces=np.ones((201, 1))), run("b", velocities=np.ones(201))])
    text = data._card().text()
    lines = text.splitlines()
    assert lines[0] == "2 trajectories of theta1"
    assert lines[1:3] == ["402 samples, 8 s", "with known forces and measured velocities"]
    assert lines[4].split() == ["a", "201", "4", "s", "0.02", "s", "-1", "…", "1"]
    motion = spring().simulate([1.0], [0.0], np.linspace(0.0, math.pi, 5))
    assert motion._card().rows[1] == ("x", "1", "1", "-1", "1")
    result = spring().validate(la.Trajectory(T, np.cos(2 * T), coordinates=["x"]), horizon=1.0)
    assert result._card().rows == result.format_rows()
    assert f"{result.n_starts} starts in 1 trial, 0 diverged" in result._repr_html_()
    fit = FitSummary("doubtful", 1.02, warnings=["bent"])._card()
    assert (fit.title, fit.notes) == ("fit: doubtful", ["warning: bent"])
    assert "chi2 per sample: 1.02, 1 is expected" in fit.lines
    library = la.Library(["x_dot**2", "x**2", "2*x**2"], ["x"], angles=["x"]).reduced()
    assert "left out: 1 repeated" in library._repr_html_()


def test_a_missing_coordinate_and_a_single_time_can_be_shown():
    empty = la.Trajectory([0.0, 1.0], [[math.nan, 1.0], [math.nan, 2.0]], coordinates=["x", "y"])
    assert empty._card().rows[1] == ("", "2", "1 s", "1 s", "2", "not measured", "1 … 2")
    assert "q1" in la.SimulationResult(T[:1], T[:1, None], T[:1, None], "stopped")._repr_html_()


def test_long_tables_end():
    card = Card("many", rows=[("n",), *((str(k),) for k in range(50))])
    assert card.text().splitlines()[-2:] == ["19", "and 30 more"]
    assert len(cells(card.html())) == 21
    assert "and 30 more" in card.html()


# -------------------------------------------------------------------------------------------------- show
def test_show_prints_text_in_a_terminal(capsys):
    la.show(doubtful(), 3)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "LagrangianModel of x"
    assert "L = 0.25*x_dot**2 - 1.0000*x**2" in lines
    assert lines[-3:-1] == [f"warning: too slow {HOSTILE}: swing more", "all is calm"]
    assert lines[-1] == "3"
    assert any(line.split()[:2] == ["x**2", "lagrangian"] for line in lines)


@pytest.mark.parametrize("kernel", [True, False])
def test_show_displays_in_a_notebook_only(monkeypatch, capsys, kernel):
    shown = []
    shell = SimpleNamespace(kernel=object()) if kernel else SimpleNamespace()
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=shown.append))
    model = spring()
    la.show(model)
    assert shown == ([model] if kernel else [])
    assert bool(capsys.readouterr().out) is not kernel


# ------------------------------------------------------------------------------------------------- plots
def test_plot_of_trajectories():
    data = la.Trajectories([run("a"), run("b")])
    display = data.plot(angles="theta1", color="black")
    assert isinstance(display, Display)
    assert display.ax_.get_xlabel() == "time (s)"
    assert display.ax_.get_ylabel() == "θ₁ (rad)"
    assert [line.get_label() for line in display.lines_[0]] == ["a", "b"]
    assert [text.get_text() for text in display.ax_.get_legend().get_texts()] == ["a", "b"]
    assert {line.get_color() for line in display.lines_[0]} == {"black"}
    np.testing.assert_array_equal(display.lines_[0][1].get_xydata(), np.column_stack([T, data[1].q[:, 0]]))
    with pytest.raises(la.InputError, match="angle 'x' is not a coordinate"):
        data.plot(angles=["x"])


def test_units_that_are_known_are_on_the_axes():
    note = find("converted-units", "theta1", quantity="position", unit="deg", to="rad", instead_of="")
    assert run(findings=[note]).plot().ax_.get_ylabel() == "θ₁ (rad)"
    wrapped = la.Trajectory(T, np.angle(np.exp(3j * T)), coordinates=["phi"])
    assert wrapped.plot().ax_.get_ylabel() == "φ"
    assert la.Trajectories([wrapped]).unwrap("phi").plot().ax_.get_ylabel() == "φ (rad)"


def test_axes_that_are_given_are_drawn_on():
    two = la.Trajectory(T, np.column_stack([np.cos(T), np.sin(T)]), coordinates=["x", "theta"])
    _, ax = plt.subplots()
    display = two.plot(ax)
    assert display.ax_ is ax
    assert display.figure_ is ax.figure
    assert [line.get_label() for line in ax.lines] == ["x", "θ"]
    assert ax.get_ylabel() == ""
    figure, axes = plt.subplots(2, 1)
    display = two.plot(axes, angles=["theta"])
    assert [axis.get_ylabel() for axis in axes] == ["x", "θ (rad)"]
    assert [len(axis.lines) for axis in axes] == [1, 1]
    assert list(display.axes_) == list(axes)
    assert len(plt.get_fignums()) == 2
    for wrong in (axes[:1], [1, 2], "ax"):
        with pytest.raises(la.InputError, match="one Axes for all, or one for each of 2"):
            two.plot(wrong)
    assert display.plot().figure_ is not figure  # the same again in a new figure


def test_a_new_figure_has_a_panel_for_each_coordinate():
    two = la.Trajectory(T, np.column_stack([np.cos(T), np.sin(T)]), coordinates=["x", "theta"], name="first")
    display = two.plot()
    assert [axis.get_xlabel() for axis in display.axes_] == ["", "time (s)"]
    assert display.ax_.get_title() == "first"


def test_plot_of_simulation_and_forecast_know_angles():
    model = spring()  # x is an angle there
    assert model.simulate([1.0], [0.0], T).plot().ax_.get_ylabel() == "x (rad)"
    data = la.Trajectories(
        [la.Trajectory(T, np.cos(2 * T), coordinates=["x"], name=name) for name in ("one", "two")]
    )
    result = model.validate(data, horizon=1.0)
    display = result.plot(trial="two")
    measured, run = display.lines_[0]
    assert (measured.get_label(), run.get_label()) == ("measured", "forecast")
    assert display.ax_.get_ylabel() == "x (rad)"
    traces = result.by_trial()["two"].traces
    assert np.isnan(run.get_ydata()).sum() == len(traces)  # a gap after each run
    np.testing.assert_array_equal(run.get_ydata()[: len(traces[0].t)], traces[0].forecast[:, 0])
    with pytest.raises(la.InputError, match="trial 'three' has no forecast; choose among"):
        result.plot(trial="three")
    assert result.by_trial()["one"].plot().ax_.get_title() == "one"


def test_plot_of_diagnostics_draws_the_curve():
    model = spring(name="first")
    display = model.diagnostics.plot(trial="first")
    measured, fitted = display.lines_[0]
    np.testing.assert_array_equal(measured.get_ydata(), model.diagnostics.trajectories[0].q[:, 0])
    np.testing.assert_array_equal(fitted.get_ydata(), model.diagnostics.curve()[0][:, 0])
    with pytest.raises(la.InputError, match="lost"):
        model.diagnostics.plot(trial="lost")


def test_plot_of_coefficients():
    model = replace(
        spring(),
        terms=(ModelTerm("x_dot**2", 0.25, known=True), ModelTerm("x**2", -2.0, 0.1)),
        covariance=None,
    )
    display = model.plot()
    labels = [label.get_text() for label in display.ax_.get_yticklabels()]
    assert labels == ["0.25 · x_dot**2", "-2.00(10) · x**2"]
    interval, given = display.lines_[0]
    (ends,) = (bars.get_segments() for bars in interval[2])
    assert np.asarray(ends)[0, :, 0] == pytest.approx([-9.8, 9.8], abs=0.01)
    assert np.asarray(ends)[0, :, 1].tolist() == [1, 1]
    assert given.get_ydata().tolist() == [0]
    low, high = display.ax_.get_ylim()
    assert low > high  # the first term is on top


def test_trade_off():
    curve = spring().diagnostics.trade_off
    display = curve.plot()
    every, chosen = display.lines_[0]
    assert every.get_xydata().tolist() == [[1, 900], [2, 0], [3, -1.5], [2, 400]]
    assert chosen.get_xydata().tolist() == [[2, 0]]
    assert display.ax_.get_xlabel() == "free terms"
    frame = curve.to_frame()
    assert frame["terms"].tolist()[1] == "x_dot**2; x**2"
    assert frame["chosen"].tolist() == [False, True, False, False]
    long = TradeOff([PathPoint(("x",), 0.0, 0.0, True, length=12.5)])
    assert long.plot().ax_.get_xlabel() == "description length (bits)"
    assert long._card().rows[1] == ("12.5", "0", "x (chosen)")


def test_a_panel_without_a_unit_has_no_brackets():
    series = [Series([0.0, 1.0], [2.0, 3.0])]
    assert Panel("x", "", series).y_label == "x"
    assert Panel("x", "m", series).y_label == "x (m)"


# ------------------------------------------------------------------------------------------- data frames
def test_frames_of_trajectories_are_read_again():
    gaps = np.where(T > 2.0, np.nan, 0.3)
    data = la.Trajectories(
        [
            run("a", forces=np.sin(T)[:, None], velocities=gaps),
            run("b"),
        ]
    )
    frame = data.to_frame()
    assert list(frame) == ["trial", "t", "theta1", "theta1_force", "theta1_dot"]
    again = la.from_frame(
        frame,
        ["theta1"],
        trial="trial",
        forces={"theta1": "theta1_force"},
        velocities={"theta1": "theta1_dot"},
    )
    assert again.names == data.names
    assert again.digest() == data.digest()


def test_frames_of_models_and_motions():
    model = spring(friction=0.1)
    assert model.to_frame().equals(model.table())
    motion = model.simulate([1.0], [0.0], T)
    frame = motion.to_frame()
    assert list(frame) == ["t", "x", "x_dot"]
    np.testing.assert_array_equal(frame["x_dot"], motion.qdot[:, 0])
    result = model.validate(la.Trajectory(T, np.cos(2 * T), coordinates=["x"], name="one"), horizon=1.0)
    frame = result.to_frame()
    assert list(frame) == ["trial", "origin", "t", "x", "x_forecast"]
    first = frame[frame.origin == result.traces[0].origin]
    np.testing.assert_array_equal(first["x_forecast"], result.traces[0].forecast[:, 0])
    assert set(frame["trial"]) == {result.traces[0].trial}
    library = la.Library(["x_dot**2"], ["x"], dissipation=["x_dot**2/2"]).to_frame()
    assert library[["expression", "kind"]].to_numpy().tolist() == [
        ["x_dot**2", "lagrangian"],
        ["x_dot**2/2", "dissipation"],
    ]


def test_missing_packages_are_named_with_the_cure(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    monkeypatch.setitem(sys.modules, "pandas", None)
    for thing in (run(), spring(), spring().simulate([1.0], [0.0], T), spring().diagnostics):
        with pytest.raises(ImportError, match=r"plot\(\) needs Matplotlib; .*'leastaction\[plot\]'"):
            thing.plot()
    for thing in (run(), spring(), spring().simulate([1.0], [0.0], T), spring().diagnostics.trade_off):
        with pytest.raises(la.InputError, match=r"to_frame\(\) needs pandas; .*'leastaction\[pandas\]'"):
            thing.to_frame()


# --------------------------------------------------------------------------------------- what people read
def test_formula_is_rounded_and_lagrangian_is_not():
    model = la.LagrangianModel("x", [ModelTerm("x_dot**2", 1 / 3, 0.002), ModelTerm("x**2", -2.0)])
    assert model.formula() == "L = 0.3333*x_dot**2 - 2*x**2"
    assert model.formula(digits=2) == "L = 0.33*x_dot**2 - 2.0*x**2"
    assert model.formula(uncertainty=True).startswith("L = 0.3333(20)*x_dot**2")
    assert model.lagrangian.coeff("x_dot") == 0
    assert 1 / 3 in map(float, model.lagrangian.atoms())
    with pytest.raises(la.InputError, match="digits is 0"):
        model.formula(digits=0)
    friction = spring(friction=0.1).formula().splitlines()
    assert friction[1] == "psi = 0.0500*x_dot**2"


def test_typeset_reads_as_text_and_as_html():
    card = Card("t", [Typeset("x^2", Notation(["x"]).term("x**2"))])
    assert card.text().splitlines()[1] == "x^2"
    assert "<msup>" in card.html()
