"""Sentences and small drawings of the report: they must say what the numbers say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leastaction import Trajectories, Trajectory
from leastaction.model.diagnostics import PathPoint, pareto
from leastaction.model.mathml import Notation, number_parts
from leastaction.model.symmetries import Symmetry
from leastaction.model.term import FitSummary, ModelTerm
from leastaction.report.axes import shortened
from leastaction.report.captions import (
    curve_title,
    energy_title,
    forecast_title,
    pareto_title,
    path_title,
    residual_title,
    symmetry_note,
)
from leastaction.report.figures_model import pareto_figure, whisker
from leastaction.report.series import Series
from leastaction.report.tables import pareto_rows
from leastaction.report.verdict import in_symbols, verdict
from leastaction.simulation.forecast import ForecastResult, ForecastTrace
from report_helpers import Page, spring


def forecast(rms: float, expected: float, status: str = "ok", std: float | None = None) -> ForecastResult:
    t = np.linspace(0.0, 1.0, 11)
    x = np.sin(t)[:, None]
    run, band = x + 0.05 * t[:, None], None if std is None else np.full((11, 1), std)
    trace = ForecastTrace("a", 0.0, t, x, run, np.array([rms]), np.array([expected]), 1.0, status, "", band)
    return ForecastResult(("x",), 1.0, 0.5, 0.4, np.array([0.01]), np.array([0.5]), (trace,))


def with_residuals(r: np.ndarray) -> Series:
    """The oscillator with these residuals in place of its own."""
    model = spring()
    diagnostics = model.diagnostics
    trial = diagnostics.trajectories[0]
    q = diagnostics.curve()[0] + r[: trial.n_times, None]
    data = Trajectories([Trajectory(trial.t, q, coordinates=["x"])])
    return Series(replace(model, diagnostics=replace(diagnostics, trajectories=data)))


@pytest.mark.parametrize(
    ("result", "text"),
    [
        (forecast(0.05, 0.049), "off by 10 % of the spread (rms): as an exact model would be"),
        (
            forecast(0.05, 0.005),
            "off by 10 % of the spread (rms): 10 times as far as an exact model would be",
        ),
        (forecast(0.05, 0.005, std=0.02), "(rms); 73 % of the samples lie in the model's 95 % band"),
        (forecast(0.6, np.nan), "off by 120 % of the spread (rms)"),
        (forecast(np.inf, np.nan, "diverged"), "1 of 1 forecast over 1 s diverged"),
        (forecast(np.nan, np.nan), "without samples"),
    ],
)
def test_forecast_titles(result, text):
    assert text in forecast_title(result)


def test_residual_titles_tell_noise_from_pattern(rng):
    noise = 0.01 * rng.standard_normal(301)
    assert residual_title(with_residuals(noise), 0, "x").endswith("looks like white, normal noise")
    smooth = 0.01 * np.sqrt(2) * np.sin(np.arange(301) / 3)
    assert "correlated from sample to sample (+0.9" in residual_title(with_residuals(smooth), 0, "x")
    echo = noise.copy()
    echo[5:] += 0.8 * noise[:-5]
    assert "correlated at a lag of 5 samples (+0." in residual_title(with_residuals(echo), 0, "x")
    jumps = noise.copy()
    jumps[::20] = 0.05 * rng.choice([-1, 1], jumps[::20].size)
    assert "beyond 3 σ, where normal noise leaves 0.27 %" in residual_title(with_residuals(jumps), 0, "x")


@pytest.mark.parametrize(("scale", "text"), [(1.0, "as far from"), (0.3, "closer to"), (3.0, "farther from")])
def test_curve_titles(rng, scale, text):
    series = with_residuals(scale * 0.01 * rng.standard_normal(301))
    assert text in curve_title(series, 0, "x")
    assert "samples and fitted curve" in curve_title(Series(spring(sigma=0.0)), 0, "x")


def test_energy_and_path_titles():
    facts = {"driven": False, "friction": False, "start": "3", "stop": "2", "shown": "a", "imbalance": "1 %"}
    assert energy_title(facts).startswith(
        "Nothing drives or brakes this motion: the energy should stay at 3; 1 %"
    )
    assert energy_title(facts | {"friction": True}).startswith(
        "Friction takes energy, from 3 to 2 on trial a"
    )
    assert energy_title(facts | {"driven": True, "imbalance": None}) == "Known forces change the energy"
    points = [
        PathPoint(("x",), 0.0, 50.0),
        PathPoint(("x", "y"), 0.0, 0.0, True),
        PathPoint(("x", "z"), 0.0, 7.0),
    ]
    assert path_title(points) == (
        "2 free terms; difference in BIC: one term less +50.0, the best rival of this size +7.0"
    )
    assert path_title(points[1:2]) == "2 free terms, without a rival"


def test_length_against_likelihood_is_put_in_words():
    points = [
        PathPoint(("x",), 900.0, 890.0, length=3.0),
        PathPoint(("x", "y"), 0.0, 0.0, True, length=7.2),
        PathPoint(("x", "z"), -2.0, 7.0, length=11.0),
        PathPoint(("x", "y", "z"), -3.0, 17.0, length=15.0),
    ]
    assert pareto_title(points) == (
        "The chosen law takes 7.2 bits; difference in −2 log-likelihood: 4.2 bits shorter +900, "
        "3.8 bits longer −2.0"
    )
    assert pareto_title(points[1:2]) == "The chosen law takes 7.2 bits"
    rows = pareto_rows(points, Notation(["x", "y", "z"]), limit=2)
    assert [(row["bits"], row["cost"], row["chosen"]) for row in rows] == [
        ("7.2", "0", True),
        ("11.0", "−2.0", False),
    ]
    drawn = str(pareto_figure(points))
    assert "description length (bits)" in drawn
    assert "the chosen structure takes 7.2 bits" in drawn
    assert "3.0 bits: +900" in drawn


def test_only_what_no_shorter_structure_explains_is_on_the_curve(rng):
    reasons = ["fits-worse", "no-fit", "fit-is-worse", "not-worth-its-terms", ""]
    points = [
        PathPoint(("x",), float(cost), 0.0, k == 7, str(rng.choice(reasons)), length=float(length))
        for k, (cost, length) in enumerate(rng.integers(0, 60, (80, 2)))
    ]
    kept = pareto(points)
    able = [p for p in points if p.chosen or p.reason not in ("no-fit", "fit-is-worse")]
    pairs = {(p.length, p.cost) for p in able}
    front = {(x, y) for x, y in pairs if not any(a <= x and b <= y and (a, b) != (x, y) for a, b in pairs)}
    assert {(p.length, p.cost) for p in kept} == front | {(points[7].length, points[7].cost)}
    assert points[7] in kept
    assert [p.length for p in kept] == sorted(p.length for p in kept)
    assert pareto([PathPoint(("x",), 0.0, 0.0, True)]) == ()


def test_least_sure_term_is_named():
    model = spring()
    model = replace(model, dissipation=(ModelTerm("x_dot**2", 0.1, 0.02),), fit=FitSummary("ok", 1.0))
    facts = {f["name"]: f for f in verdict(model, None, Notation(["x"]))["facts"]}
    assert facts["Least sure coefficient"]["value"] == "± 20 %"
    assert "Forecast error" not in facts
    assert facts["Terms found"]["value"] == "2"


@pytest.mark.parametrize(
    ("result", "against"),
    [
        (None, False),
        (forecast(0.03, 0.03), False),
        (forecast(0.3, 0.01), True),  # 60 % of the spread, and an exact model would be right
        (forecast(0.3, 0.29), False),  # chaos: an exact model would be as far off
        (forecast(np.inf, 0.01, "diverged"), True),
        (forecast(0.03, 0.01, std=0.2), False),
        (forecast(0.03, 0.01, std=0.001), True),  # outside the band that should hold 95 %
    ],
)
def test_nothing_is_green_beside_a_contradiction(result, against):
    head = verdict(spring(), result, Notation(["x"]))
    assert head["status"] == "ok"
    assert bool(head["against"]) == against
    assert head["tone"] == ("doubtful" if against else "ok")


def test_sentences_have_symbols_where_they_have_names():
    notation = Notation(["theta1", "a", "speed"])
    text = "a term with theta1_dot**2, theta1 and speed_dot: see units={'theta1': 'deg'} & speed"
    page = Page(str(in_symbols(text, notation, ["theta1_dot**2"])))
    assert len(page.root.all("math")) == 3
    assert page.text.count("θ") == 2
    assert page.text.startswith("a term with ")
    assert page.text.endswith("see units={'theta1': 'deg'} & speed")


@pytest.mark.parametrize(
    ("term", "kind", "title"),
    [
        (ModelTerm("x", -2.0, 0.1), "sure", "9.8 % of the coefficient"),
        (ModelTerm("x", 2.0, 2.0), "weak", "includes zero"),
        (ModelTerm("x", 0.0, 0.1), "weak", "includes zero"),
        (ModelTerm("x", 2.0, np.nan), "sure", "no standard error"),
        (ModelTerm("x", 2.0, known=True), "given", "given"),
    ],
)
def test_whiskers(term, kind, title):
    svg = Page(str(whisker(term, "w"))).root.one("svg")
    assert kind in str(svg.attributes["class"]).split()
    assert title in svg.one("title").text
    bars = svg.all("path", class_="bar")
    assert len(bars) == (0 if "standard" in title or kind == "given" else 1)
    if kind == "sure" and bars:
        left, right = (float(x) for x in str(bars[0].attributes["d"]).replace("M120 10", "").split("H")[1:])
        assert (120 - left) / 100 == pytest.approx(0.098, abs=1e-3)
        assert right - 120 == pytest.approx(120 - left)


@pytest.mark.parametrize("power", range(-12, 13, 3))
def test_a_number_hidden_by_its_error_can_be_read(power):
    """No row of zeros, whatever the scale, and both parts read back."""

    def read(text: str) -> float:
        mantissa, _, exponent = text.replace("−", "-").partition(" × 10")
        return float(mantissa) * 10.0 ** int(
            exponent.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0
        )

    for value, error in ((3.17, 4.2e6), (-3.17, 420.0), (3.17, 0.42)):
        number = number_parts(value * 10.0**power, error * 10.0**power)
        assert read(number.text) == pytest.approx(value * 10.0**power, rel=0.03)
        assert read(number.error_text) == pytest.approx(error * 10.0**power, rel=0.03)
        markup = Notation(["x"]).addend("x", value * 10.0**power, error * 10.0**power, "", first=True)
        assert f"± {number.error}" in Page(str(markup)).text


def test_long_names_are_shortened_in_figures_and_wrapped_in_headings():
    name = "shoulder_flexion_of_the_left_arm"
    notation = Notation([name, "x"])
    assert notation.text(name, 1) == f"d{name}/dt"
    assert len(shortened(notation.text(name, 2), 20)) == 20
    assert Page(str(notation.heading(name))).root.one("span").attributes["class"] == "wrap"
    assert Page(str(notation.heading("x"))).root.one("math")
    long, short = (Page(str(notation.term(t))).root.one("math") for t in (f"{name}*cos({name})", "x*cos(x)"))
    assert long.attributes["class"] == "longer"
    assert "class" not in short.attributes


def test_only_words_that_the_table_of_symmetries_has_are_explained():
    energy = Symmetry("time translation", ("x",), "t + c", "in form", drift=0.01)
    assert symmetry_note([energy]).startswith(
        "In form: whatever the coefficients are. “Conserved to”: the rms"
    )
    held_up = replace(energy, obstacles=("friction",))
    assert symmetry_note([held_up]) == "In form: whatever the coefficients are."
    turn = Symmetry("rotation", ("x", "y"), "turn of (x, y)", "within errors", 1, 0.4, 0.0031)
    assert symmetry_note([turn]).startswith("Within the error bars: ")
    assert "Conserved to" not in symmetry_note([turn])
    back = Symmetry("time reversal", ("x",), "t -> -t", "in form")
    assert symmetry_note([held_up, back]).endswith(
        "Nothing is conserved with a reversal of time or an exchange."
    )
