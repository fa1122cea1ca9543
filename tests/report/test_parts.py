"""Parts of the report: sentences and figures say what the numbers say, for all kinds of vision."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from importlib.resources import files
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leastaction import (
    LagrangianModel,
    Trajectories,
    Trajectory,
    write_report,
)
from leastaction.curve.bspline import SplineGrid, uniform_space
from leastaction.findings import as_given, find
from leastaction.mechanics.equations import state_symbols
from leastaction.model.diagnostics import PathPoint, pareto
from leastaction.model.mathml import Notation, number_parts
from leastaction.model.symmetries import Symmetry
from leastaction.model.term import FitSummary, ModelTerm
from leastaction.report.axes import HALF, THIRD, Axes, shortened, thin_line
from leastaction.report.captions import (
    curve_title,
    energy_title,
    forecast_title,
    motion_note,
    pareto_title,
    path_title,
    residual_title,
    symmetry_note,
)
from leastaction.report.figures_model import pareto_figure, whisker
from leastaction.report.law import contributions, correlations, equations
from leastaction.report.series import Energy, Series
from leastaction.report.svg import COLOURS, corners, dot_path, line_path, number
from leastaction.report.tables import motion_rows, pareto_rows, path_rows, symmetry_rows
from leastaction.report.text import in_powers, plain
from leastaction.report.ticks import Folded, Linear, Ticks, folded
from leastaction.report.verdict import in_symbols, unlike_noise, verdict
from leastaction.simulation.forecast import ForecastResult, ForecastTrace
from page_helpers import Figure, Page, pieces, spring


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("cos(theta1)**2", "<msup><mi>cos</mi><mrow><mn>2</mn></mrow></msup>"),
        ("-x_cart/2", '<mo form="prefix">−</mo><mfrac>'),
        ("exp(-2*{a}*theta1)", '<mo form="prefix">(</mo><mo form="prefix">−</mo><mn>2</mn>'),
        ("theta1-(-2)*x_cart", '<mo>−</mo><mrow><mo form="prefix">(</mo><mo form="prefix">−</mo><mn>2</mn>'),
        (
            "x_cart_dot**2",
            "<mo>.</mo></mrow></mover></mpadded><mtext>cart</mtext><mrow><mn>2</mn></mrow></msubsup>",
        ),
        ("(theta1 + 1)*2", '<mo form="prefix">(</mo>'),
        ("abs(theta1)", '<mo form="prefix">|</mo>'),
        ("sqrt(theta1**2)", "<msqrt>"),
        ("2*3", "<mn>2</mn><mo>·</mo><mn>3</mn>"),
        ("2**-7", '<mo form="prefix">−</mo><mn>7</mn>'),
        ("1e-7*pi", "<mn>−7</mn>"),
        ("a <b> c", "<mtext>a &lt;b&gt; c</mtext>"),
        ("theta1 if x else y", "<mtext>theta1 if x else y</mtext>"),
    ],
)
def test_terms_as_mathml(text, expected):
    page = Notation(["theta1", "x_cart"]).term(text)
    assert expected in page
    Page(str(page))


def test_smoothed_absolute_values_are_written_as_they_were_given():
    notation = Notation(["theta1", "x_cart"], [0.03, 0.5])
    for text in ("sqrt(theta1_dot**2 + 9/10000)", "sqrt((theta1_dot - x_cart_dot)**2 + 1/4)"):
        assert '<mo form="prefix">|</mo>' in notation.term(text)
        assert "abs(" in as_given(text, notation.widths)
    for text in ("sqrt(theta1_dot**2 + 1/10)", "sqrt(x_cart**3 + 1/4)", "sqrt(9/10000 + theta1)"):
        assert "<msqrt>" in notation.term(text)
        assert as_given(text, notation.widths) == text


def test_equations_of_the_report_are_those_of_the_model(rng):
    texts = ["x_dot**2", "y_dot**2*cos(x)", "x_dot*y_dot*sin(x-y)", "x**2*y", "exp(-x*y)", "x_dot*y"]
    terms = [ModelTerm(text, float(c)) for text, c in zip(texts, rng.uniform(0.5, 2.0, 6), strict=True)]
    friction = [ModelTerm("(x_dot-y_dot)**2/2", 0.3), ModelTerm("sqrt(x_dot**2+1/100)", 0.2)]
    names = ("x", "y")
    model = LagrangianModel(names, terms, friction)
    state = rng.uniform(-1.0, 1.0, (3, 2))
    values = dict(zip([s for group in state_symbols(names) for s in group], state.ravel(), strict=True))
    q, qdot, qddot = state
    # forces that the law needs for this acceleration, from its own mass matrix and acceleration without any
    forces = model.mass_matrix(q) @ (qddot - model.acceleration(q, qdot))
    for i in range(2):
        both = [(t, True) for t in terms] + [(t, False) for t in friction]
        parts = [t.coefficient * p for t, of_l in both for p in contributions(t, of_l, names, i)]
        assert sum(float(p.subs(values)) for p in parts) == pytest.approx(forces[i], rel=1e-12)
    shown = equations(model, Notation(names))
    assert [len(row["addends"]) > 5 for row in shown] == [True, True]


def test_correlations_are_those_of_the_covariance():
    covariance = np.array([[4.0, -1.8, 0.0], [-1.8, 1.0, 0.1], [0.0, 0.1, 1.0]])
    terms = [ModelTerm("x_dot**2", 1.0, known=True), ModelTerm("x", 1.0, 2.0), ModelTerm("x**2", 1.0, 1.0)]
    model = LagrangianModel("x", terms, [ModelTerm("x_dot**2/2", 1.0, 1.0)], covariance)
    found = correlations(model, Notation(["x"]))
    assert [row["cells"] for row in found["table"]] == [["−0.90", ""], ["0.00", "+0.10"]]
    assert found["strongest"]["value"] == "−0.90"
    assert correlations(replace(model, covariance=None), Notation(["x"])) == {}


def test_symmetries_in_a_table():
    names = ["x1", "y1", "x2", "y2"]
    kinetic = [ModelTerm(f"{name}_dot**2", 0.5) for name in names]
    bodies = LagrangianModel(names, [*kinetic, ModelTerm("1/sqrt((x1-x2)**2+(y1-y2)**2)", 3.0)])
    rows = symmetry_rows(bodies, Notation(names))
    assert [row["name"] for row in rows[1:4]] == [
        "translation y₁ + c, y₂ + c",
        "rotation of (x₁, y₁) and of (x₂, y₂)",
        "exchange x₁ ↔ x₂, y₁ ↔ y₂",
    ]
    signs = re.sub(r"<math>.*?</math>", "∙", rows[2]["quantity"])
    assert signs == "angular momentum ∙ − ∙ + ∙ − ∙"
    assert rows[5]["quantity"] == "energy"  # too long, and nothing but L with other signs


def test_small_motions_in_a_table():
    friction = [ModelTerm("theta1_dot**2/2", 0.4), ModelTerm("abs(theta2_dot)", 0.1)]
    terms = {"theta1_dot**2": 1.0, "theta2_dot**2": 0.5, "cos(theta1)": 9.0, "cos(theta1-theta2)": 4.0}
    made = [ModelTerm(text, c, 0.01 * c) for text, c in terms.items()]
    names = ["theta1", "theta2"]
    model = LagrangianModel(names, made, friction, np.diag([1e-4, 2.5e-5, 8.1e-3, 1.6e-3, 0.0, 0.0]))
    first, *others = motion_rows(model, Notation(names))
    assert (first["place"], first["standing"]) == ("θ₁ = 0, θ₂ = 0", "stable")
    for (pace, shape), mode in zip(first["modes"], model.linearise([0.0, 0.0]).modes, strict=True):
        assert pace == f"{mode.frequency} Hz, damping ratio {mode.damping_ratio}"
        lead = math.degrees(np.angle(mode.shape[np.argmin(np.abs(mode.shape))]))
        assert f"at {lead:.0f}°".replace("-", "−") in shape
    assert {row["standing"] for row in others} == {"unstable"}
    assert len(others) == 3
    note = motion_note(model.small_motions[0][1].left_out, Notation(names))
    assert note.endswith(f"at rest: {Notation(names).term('abs(theta2_dot)')}.")
    assert "dry friction" not in motion_note((), Notation(names)).lower()
    timed = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x*cos(t)", 1.0)])
    nowhere = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -1.0)])
    assert motion_rows(timed, Notation(["x"])) == motion_rows(nowhere, Notation(["x"])) == []


def test_numbers_inside_terms_of_a_conserved_quantity_are_short():
    """SymPy holds 0.798278123456 as a fraction of long whole numbers."""
    terms = {
        "x_dot**2": 0.5,
        "exp(-0.798278123456*x)": 4.0,
        "exp(-2*0.798278123456*x)": -2.0,
        "x**0.37512": 1.0,
    }
    energy = LagrangianModel("x", [ModelTerm(*item) for item in terms.items()]).symmetries[-1]
    assert energy.written == "-x**(0.37512) + 0.5*x_dot**2 + 2*exp(-1.5966*x) - 4*exp(-0.79828*x)"
    assert "15625" in energy.quantity  # which has all digits
    assert r"2 \, e^{- 1.5966 x} - 4 \, e^{- 0.79828 x}" in energy.latex
    assert "x^{0.37512}" in energy.latex


def test_names_that_look_alike_stay_apart():
    notation = Notation(["q1", "q_1", "phi"])
    assert [notation.text(c) for c in notation.coordinates] == ["q1", "q_1", "φ"]
    assert len({notation.symbol(c) for c in notation.coordinates}) == 3


def test_coefficients_carry_sign_error_and_power():
    notation = Notation(["x"])
    first = notation.addend("x**2", -1.234e-7, 5e-10, "", first=True)
    assert first.startswith("<math><mrow><mo>−</mo>")
    assert "<mn>1.2340</mn>" in first
    assert "± 0.0050" in first
    assert "<mn>−7</mn>" in first
    assert "known" in notation.addend("2*x", 1.0, 0.0, "known", first=False)
    assert "<mo>·</mo>" in notation.addend("2*x", 1.0, 0.0, "known", first=False)


def test_numbers_in_tables():
    assert [plain(v) for v in (0.0, 12.0, -1e-9, np.nan, -np.inf)] == ["0", "12", "−1 × 10⁻⁹", "–", "−∞"]


def test_path_rows_keep_the_chosen_one():
    path = [PathPoint(("x",) * n, 0.0, -1.0 * n) for n in range(1, 40)]
    path.append(PathPoint(("x", "x**2"), 0.0, 0.0, True))
    rows = path_rows(path, Notation(["x"]), limit=5)
    assert len(rows) == 5
    assert sum(row["chosen"] for row in rows) == 1


def test_path_rows_say_why_and_keep_the_structure_of_the_model():
    path = [PathPoint(("x",) * n, 0.0, 10.0 * n, reason="fits-worse") for n in range(3, 20)]
    shown = PathPoint(("y",), 0.0, -5.0, reason="irrelevant")
    path += [PathPoint(("x", "x**2"), 0.0, 0.0, True, "chosen"), shown]
    rows = path_rows(path, Notation(["x", "y"]), limit=3, shown=shown, relevance=0.1)
    assert [row["n_terms"] for row in rows] == [1, 2, 3]
    assert [row["shown"] for row in rows] == [True, False, False]
    assert "less than 10 % of the equation error" in rows[0]["because"]
    assert rows[1]["because"] == ""
    assert rows[2]["because"] == "it fits the data worse"


def test_thinning_keeps_peaks_and_ends():
    t = np.linspace(0.0, 1.0, 50_000)
    y = np.sin(40 * t)
    y[12_345], y[40_000] = 9.0, np.nan
    thin_t, thin_y = thin_line(t, y, 1000)
    assert thin_t.size <= 1100
    assert np.nanmax(thin_y) == 9.0
    assert (np.diff(thin_t) > 0).all()
    assert thin_t[-1] == 1.0


def test_residuals_and_their_correlation():
    series = Series(spring())
    correlation = series.correlation(0)
    assert correlation.size == 40
    assert np.abs(correlation).max() < 0.25
    assert series.all_residuals(0).std() == pytest.approx(0.01, rel=0.1)
    start, stop = series.zoom
    assert 0.0 <= start < stop <= 6.0


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_energy_balance(friction):
    energy = Energy.of(Series(spring(friction)), 0)
    assert energy.imbalance < 2e-3
    assert energy.finite
    lost = energy.total[0] - energy.total[-1]
    assert lost == pytest.approx(0.0, abs=1e-3) if friction == 0 else lost > 0.5
    assert energy.expected[-1] == pytest.approx(energy.total[-1], abs=2e-3)


def test_energy_balance_counts_known_forces():
    model = spring()
    t = np.linspace(0.0, 6.0, 601)
    # x = t² / 20 solves x_ddot / 2 + 2 x = f
    q, force = t[:, None] ** 2 / 20, 0.05 + t[:, None] ** 2 / 10
    space = uniform_space(0.0, 6.0, 5.0)
    points = np.linalg.lstsq(space.basis(t).toarray(), q, rcond=None)[0]
    driven = Trajectories([Trajectory(t, q, force, coordinates=["x"])])
    diagnostics = replace(
        model.diagnostics, trajectories=driven, grid=SplineGrid([space]), control_points=points
    )
    energy = Energy.of(Series(replace(model, diagnostics=diagnostics)), 0)
    assert energy.total[-1] > 3.0
    assert energy.imbalance < 1e-3


def test_simple_numbers_are_offered_beside_the_coefficients(tmp_path):
    model = spring()
    source = write_report(model, tmp_path / "plain.html").read_text(encoding="utf-8")
    assert "Simple numbers" not in Page(source).by_id("coefficients").text
    sure = replace(model, terms=(model.terms[0], ModelTerm("x**2", -5.001, 0.001)))
    source = write_report(sure, tmp_path / "sure.html").read_text(encoding="utf-8")
    (row,) = Page(source).by_id("coefficients").all("table")[1].one("tbody").all("tr")
    assert [cell.text for cell in row.all("td")][:2] == ["−5.0010(10)", "−5"]


def test_length_against_likelihood_is_drawn_where_there_are_lengths(tmp_path):
    model = spring()
    source = write_report(model, tmp_path / "plain.html").read_text(encoding="utf-8")
    assert "bits" not in Page(source).by_id("selection").text
    points = tuple(replace(point, length=4.0 * point.n_terms) for point in model.diagnostics.path[:3])
    longer = replace(model, diagnostics=replace(model.diagnostics, pareto=points))
    source = write_report(longer, tmp_path / "longer.html").read_text(encoding="utf-8")
    section = Page(source).by_id("selection")
    assert "The chosen law takes 8.0 bits" in section.text
    assert [row.one("th").text for row in section.all("tbody")[-1].all("tr")] == ["4.0", "8.0", "12.0"]


# ------------------------------------------------------------------------------- sentences and small drawings
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
        (forecast(0.05, 0.049), "off by 10 % of the spread (rms): as for an exact model"),
        (
            forecast(0.05, 0.005),
            "off by 10 % of the spread (rms): 10 times the error of an exact model",
        ),
        (forecast(0.05, 0.005, std=0.02), "(rms); 73 % of the samples are in the 95 % band"),
        (forecast(0.6, np.nan), "off by 120 % of the spread (rms)"),
        (forecast(np.inf, np.nan, "diverged"), "1 of 1 forecast over 1 s diverged"),
        (forecast(np.nan, np.nan), "without samples"),
    ],
)
def test_forecast_titles(result, text):
    assert text in forecast_title(result)


def test_residual_titles_tell_noise_from_pattern(rng):
    noise = 0.01 * rng.standard_normal(301)
    assert residual_title(with_residuals(noise), 0, "x").endswith(
        "the residuals resemble white, normal noise"
    )
    smooth = 0.01 * np.sqrt(2) * np.sin(np.arange(301) / 3)
    assert "correlated from sample to sample (+0.9" in residual_title(with_residuals(smooth), 0, "x")
    echo = noise.copy()
    echo[5:] += 0.8 * noise[:-5]
    assert "correlated at a lag of 5 samples (+0." in residual_title(with_residuals(echo), 0, "x")
    jumps = noise.copy()
    jumps[::20] = 0.05 * rng.choice([-1, 1], jumps[::20].size)
    assert "beyond 3 σ (0.27 % for normal noise)" in residual_title(with_residuals(jumps), 0, "x")


@pytest.mark.parametrize(
    ("scale", "text"), [(1.0, "agrees with"), (0.3, "smaller than"), (3.0, "larger than")]
)
def test_curve_titles(rng, scale, text):
    series = with_residuals(scale * 0.01 * rng.standard_normal(301))
    assert text in curve_title(series, 0, "x")
    assert "samples and fitted curve" in curve_title(Series(spring(sigma=0.0)), 0, "x")


def test_energy_and_path_titles():
    facts = {"driven": False, "friction": False, "start": "3", "stop": "2", "shown": "a", "imbalance": "1 %"}
    assert energy_title(facts).startswith("No force or friction acts: the energy should stay at 3; 1 %")
    assert energy_title(facts | {"friction": True}).startswith(
        "Friction lowers the energy from 3 to 2 on trial a"
    )
    assert energy_title(facts | {"driven": True, "imbalance": None}) == "Known forces change the energy"
    points = [
        PathPoint(("x",), 0.0, 50.0),
        PathPoint(("x", "y"), 0.0, 0.0, True),
        PathPoint(("x", "z"), 0.0, 7.0),
    ]
    assert path_title(points) == (
        "2 free terms; difference in BIC: one term less +50.0, best competing structure +7.0"
    )
    assert path_title(points[1:2]) == "2 free terms, with no alternative"


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
    assert facts["Least precise coefficient"]["value"] == "± 20 %"
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


def test_residuals_unlike_noise_are_a_reservation_in_the_verdict(rng):
    noise = 0.01 * rng.standard_normal(301)
    smooth = 0.01 * np.sqrt(2) * np.sin(np.arange(301) / 3)
    jumps = noise.copy()
    jumps[::20] = 0.05 * rng.choice([-1, 1], jumps[::20].size)
    sentence = "are not white, normal noise: intervals may be too narrow or too wide"
    for residuals, odd in ((noise, False), (smooth, True), (jumps, True)):
        series = with_residuals(residuals)
        head = verdict(series.model, None, Notation(["x"]))
        assert odd == ("are not white" in residual_title(series, 0, "x"))  # the caption and the box agree
        assert odd == any(sentence in note for note in head["reservations"])
        assert (head["status"], head["tone"]) == ("ok", "usable" if odd else "ok")
    diverged = verdict(series.model, forecast(np.inf, 0.01, "diverged"), Notation(["x"]))
    assert diverged["tone"] == "doubtful"
    # a note on the same residuals takes the place of the sentence, one on those of a velocity does not
    for quantity, said in (("position", False), ("velocity", True)):
        note = find("correlated-residuals", "x", quantity=quantity, correlation=0.9)
        model = replace(with_residuals(smooth).model, fit=FitSummary("ok", 1.0, findings=[note]))
        head = verdict(model, None, Notation(["x"]))
        assert said == any(sentence in text for text in head["reservations"])
        assert head["tone"] == "usable"
    assert unlike_noise(replace(model, diagnostics=None)) == []


def test_a_curve_without_an_equation_may_follow_the_noise():
    one = with_residuals(0.01 * np.sqrt(2) * np.sin(np.arange(301) / 3)).model.diagnostics
    trial = one.trajectories[0]
    both = Trajectories([Trajectory(trial.t, np.hstack([trial.q, trial.q]), coordinates=["x", "l"])])
    points = np.hstack([one.control_points, one.control_points])
    diagnostics = replace(one, trajectories=both, control_points=points)
    terms = [ModelTerm("x_dot**2", 0.25, known=True), ModelTerm("x**2", -1.0, 0.002), ModelTerm("x*l", 1.0)]
    model = LagrangianModel(["x", "l"], terms, noise_std=[0.01, 0.01], diagnostics=diagnostics)
    assert unlike_noise(model) == ["x", "l"]
    model = replace(model, provenance={"options": {"prescribed": ["l"]}})
    assert unlike_noise(model) == ["x"]
    assert residual_title(Series(model), 1, "l") == (
        "l: no equation constrains the curve, so it follows part of the noise"
    )


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
    assert symmetry_note([energy]).startswith("In form: for any coefficients. “Conserved to”: the rms")
    held_up = replace(energy, obstacles=("friction",))
    assert symmetry_note([held_up]) == "In form: for any coefficients."
    turn = Symmetry("rotation", ("x", "y"), "turn of (x, y)", "within errors", 1, 0.4, 0.0031)
    assert symmetry_note([turn]).startswith("Within the error bars: ")
    assert "Conserved to" not in symmetry_note([turn])
    back = Symmetry("time reversal", ("x",), "t -> -t", "in form")
    assert symmetry_note([held_up, back]).endswith(
        "A reversal of time or an exchange has no conserved quantity."
    )


# ------------------------------------- figures: every primitive by what is in its SVG; colours; ticks
_DIGIT = 0.051  # px: half of the last digit that is written


def drawn(axes: Axes) -> Figure:
    return Figure(str(axes.svg("a", "a title", "a description")))


def distance(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distance of each point, (n, 2), from the nearest piece of a polygonal line, (m, 2)."""
    starts, chords = line[:-1], np.diff(line, axis=0)
    away = points[:, None] - starts
    length = np.maximum((chords**2).sum(axis=1), 1e-30)
    share = np.clip((away * chords).sum(axis=2) / length, 0.0, 1.0)
    return np.linalg.norm(away - share[:, :, None] * chords, axis=2).min(axis=1)


def ends(outline: np.ndarray) -> list[float]:
    """Left, top, right and bottom."""
    return [*outline.min(axis=0), *outline.max(axis=0)]


# Paths


@given(st.integers(-100_000, 100_000))
def test_numbers_are_short_and_read_back(tenths):
    words = number(tenths / 10)
    assert float(words) == tenths / 10
    assert not re.search(r"^-?0.|\.0$|^-0$", words)


@given(arrays(float, st.tuples(st.integers(2, 60), st.just(2)), elements=st.floats(-300, 300, width=32)))
def test_lines_pass_all_their_points(points):
    """Whatever the line does: what is left out lies within a tenth of a pixel of what is drawn."""
    kept = corners(points)
    assert kept[0] == 0
    assert kept[-1] == len(points) - 1
    assert (np.diff(kept) > 0).all()
    assert distance(points, points[kept]).max() < 0.06 + 1e-6
    (line,) = pieces(line_path(*points.T))
    line = np.vstack([line, line[-1:]])
    assert distance(points, line).max() < 0.06 + 2 * _DIGIT


def test_points_that_nobody_would_miss_are_left_out():
    x = np.linspace(0.0, 300.0, 3001)
    assert len(corners(np.column_stack([x, 0.5 * x]))) == 2
    assert len(corners(np.column_stack([x, 50 * np.sin(x / 20)]))) < 200
    spike = np.where(np.arange(3001) == 1500, 90.0, 0.0)
    assert {0, 1500, 3000} <= set(corners(np.column_stack([x, spike])))
    back = np.concatenate([x, x[::-1]])  # there and back on one line: the tip is kept
    assert len(corners(np.column_stack([back, 0 * back]))) in (3, 4)


@pytest.mark.parametrize("gap", [np.nan, np.inf, -np.inf])
def test_gaps_interrupt_lines_and_single_points_are_dots(gap):
    y = np.array([gap, 1.0, 5.0, gap, gap, 7.0, gap, 2.0, 3.0, 9.0])
    found = pieces(line_path(np.arange(10.0), y))
    assert [piece.tolist() for piece in found] == [
        [[1.0, 1.0], [2.0, 5.0]],
        [[5.0, 7.0], [5.0, 7.0]],
        [[7.0, 2.0], [8.0, 3.0], [9.0, 9.0]],
    ]
    dots = pieces(dot_path(np.arange(10.0), y))
    assert [piece[0].tolist() for piece in dots] == [[k, y[k]] for k in np.flatnonzero(np.isfinite(y))]
    nothing = np.full(3, gap)
    assert line_path(nothing, nothing) == dot_path(nothing, nothing) == ""


@given(arrays(float, st.tuples(st.integers(1, 40), st.just(2)), elements=st.floats(-500, 900, width=32)))
def test_dots_are_where_they_should_be(points):
    """Steps from dot to dot: their rounding does not add up."""
    found = pieces(dot_path(*points.T))
    assert all((piece[0] == piece[1]).all() for piece in found)
    np.testing.assert_allclose([piece[0] for piece in found], points, atol=_DIGIT)


# Positions


def test_lines_and_dots_lie_where_the_axes_say():
    """Read with nothing but ticks: the straight map that they give takes data to pixels."""
    x = np.linspace(2.0, 9.0, 23)
    y = 40 * np.cos(x) - 15
    axes = Axes(HALF)
    axes.line(x, y, "fit")
    axes.dots(x, y, "measured", 3.0)
    axes.label("t (s)", "q", y_unit="rad")
    figure, frame = drawn(axes), axes.frame()
    maps = []
    for place, words in ((0, figure.texts("tick", "middle")), (1, figure.texts("tick", "end"))):
        at = [text[place] for text in words]
        values = [float(text[2].replace("−", "-")) for text in words]
        maps.append(np.polyfit(values, at, 1))
    expected = np.column_stack([np.polyval(maps[0], x), np.polyval(maps[1], y) - 4.2])
    dots = np.array([piece[0] for piece in figure.path("stroke:var(--measured)")])
    np.testing.assert_allclose(dots, expected, atol=0.25)
    np.testing.assert_allclose(dots, np.column_stack([frame.x(x), frame.y(y)]), atol=_DIGIT)
    (line,) = figure.path("stroke:var(--fit)")
    assert distance(dots, line).max() < 0.25
    # Everything is inside, and fills the frame but for the margins.
    left, top, right, bottom = figure.clip
    assert left < dots[:, 0].min() < left + 10
    assert right - 10 < dots[:, 0].max() < right
    assert top < dots[:, 1].min() < top + 15
    assert bottom - 15 < dots[:, 1].max() < bottom
    assert figure.box == [0.0, 0.0, *HALF]


def test_grid_lines_run_through_their_ticks():
    axes = Axes()
    axes.line(np.array([0.0, 1.0]), np.array([-3.0, 8.0]), "fit")
    figure = drawn(axes)
    left, _, right, bottom = figure.clip
    grid = figure.path("stroke:var(--grid)")
    ticks = figure.texts("tick", "end")
    assert len(grid) == len(ticks) == 2  # 0 and 5
    for line, (x, y, _) in zip(grid, ticks, strict=True):
        np.testing.assert_allclose(line, [[left, y - 4.2], [right, y - 4.2]], atol=2 * _DIGIT)
        assert x == pytest.approx(left - 7)
    (ground,) = figure.path("stroke:var(--muted)")
    np.testing.assert_allclose(ground, [[left, bottom], [right, bottom]], atol=_DIGIT)


def test_a_logarithmic_axis_has_equal_decades():
    sizes = np.arange(1.0, 8.0)
    values = np.array([0.0, 10.0, 100.0, 1000.0, 1e4, -10.0, -100.0])
    axes = Axes((520.0, 320.0), x=Linear(whole=True), y=Folded())
    axes.dots(sizes, values, "fit", 4.0)
    figure = drawn(axes)
    height = {float(v): piece[0][1] for v, piece in zip(values, figure.path("--fit"), strict=True)}
    down = [height[v] for v in (1e4, 1000.0, 100.0, 10.0, 0.0, -10.0, -100.0)]
    np.testing.assert_allclose(np.diff(down), np.diff(down)[0], atol=2 * _DIGIT)
    ticks = {words: y - 4.2 for _, y, words in figure.texts("tick", "end")}
    assert {"10⁴": 1e4, "1000": 1e3, "0": 0.0, "−100": -100.0}.keys() <= ticks.keys()
    assert ticks["10⁴"] == pytest.approx(height[1e4], abs=2 * _DIGIT)
    assert ticks["−100"] == pytest.approx(height[-100.0], abs=2 * _DIGIT)


def test_bars_stand_on_zero_between_their_edges():
    heights, edges = np.array([1.0, 4.0, 0.0, 2.0]), np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    axes = Axes()
    axes.bars(heights, edges, "measured", 0.45)
    axes.limit(y=(0.0, None))
    figure, frame = drawn(axes), axes.frame()
    (outline,) = figure.path("fill:var(--measured)", "opacity:0.45")
    corners_expected = [
        [frame.x(edges[k + side]).item(), frame.y(height).item()]
        for k, height in enumerate(heights)
        for side in (0, 1)
    ]
    assert distance(np.array(corners_expected), outline).max() < 2 * _DIGIT
    assert outline[:, 1].max() == pytest.approx(figure.clip[3], abs=_DIGIT)
    x, y = outline.T
    area = 0.5 * abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])))
    unit = (frame.x(1.0) - frame.x(0.0)) * (frame.y(0.0) - frame.y(1.0))
    assert area == pytest.approx(heights.sum() * float(unit), rel=5e-3)


def test_bands_rules_and_columns():
    axes = Axes()
    axes.dots(np.array([0.0, 10.0]), np.array([-1.0, 1.0]), "measured", 2.0)
    axes.band(x=(2.0, 5.0))
    axes.band(y=(-0.25, 0.5))
    axes.rule(3.0, "fit", 1.0, dashes="4 3")
    axes.column(7.0, 14.0)
    figure, frame = drawn(axes), axes.frame()
    left, top, right, bottom = figure.clip
    (upright,), (level,) = figure.paths("fill:var(--shade)")
    assert ends(upright) == pytest.approx([*frame.x([2.0]), top, *frame.x([5.0]), bottom], abs=_DIGIT)
    assert ends(level) == pytest.approx([left, *frame.y([0.5]), right, *frame.y([-0.25])], abs=_DIGIT)
    (rule,) = figure.path("stroke:var(--fit)", "stroke-dasharray:4 3")
    assert rule[:, 1] == pytest.approx(frame.y([3.0, 3.0]), abs=_DIGIT)
    assert rule[0, 1] > top  # a rule above the data moves the end of the axis
    assert rule[:, 0].tolist() == pytest.approx([left, right])
    (column,) = figure.path("stroke:var(--shade)", "stroke-width:14")
    assert column[:, 0] == pytest.approx(frame.x([7.0, 7.0]), abs=_DIGIT)
    assert sorted(column[:, 1]) == pytest.approx([top, bottom])


# Layers, limits, what is cut off


def test_what_is_above_covers_what_is_below():
    x = np.array([0.0, 1.0, 2.0])
    axes = Axes()
    axes.dots(x, x, "forecast", 5.0, above=True)
    axes.line(x, x, "fit")
    axes.dots(x, x, "measured", 2.0, opacity=0.5)
    axes.bars(np.array([1.0]), np.array([0.0, 1.0]), "ink", 0.5)
    axes.band(x=(0.0, 1.0))
    order = re.findall(r"(?:fill|stroke):var\(--(\w+)\)", str(axes.svg("a", "b", "c")))
    assert order == ["shade", "grid", "ink", "measured", "fit", "paper", "forecast", "muted"]


def test_given_limits_hold_and_the_rest_is_cut_off():
    x, y = np.linspace(0.0, 10.0, 50), np.linspace(-5.0, 5.0, 50)
    axes = Axes()
    axes.line(x, y, "fit")
    axes.dots(x, 1e30 * y, "measured", 2.0)
    axes.limit(x=(2.0, 4.0))
    axes.limit(y=(-1.0, None))
    axes.limit(y=(None, 3.0))
    source, frame = str(axes.svg("b7", "t", "d")), axes.frame()
    figure = Figure(source)
    assert (frame.x_ends, frame.y_ends) == ((2.0, 4.0), (-1.0, 3.0))
    np.testing.assert_allclose(figure.clip, [frame.left, frame.top, frame.right, frame.bottom], atol=_DIGIT)
    (clip,) = figure.root.iter("clipPath")
    (group,) = figure.root.iter("g")
    assert group.attrib["clip-path"] == f"url(#{clip.attrib['id']})"
    inside = list(group.iter("path"))
    assert len(inside) == 3  # grid, dots and line: only the ground is drawn outside
    assert len(list(figure.root.iter("path"))) == 4
    numbers = [float(n) for n in re.findall(r"-?\d*\.?\d+", " ".join(e.attrib["d"] for e in inside))]
    assert max(map(abs, numbers)) <= 2e4  # a number that is far out stays short
    for _, at, _ in figure.texts("tick", "end"):
        assert frame.top <= at - 4.2 <= frame.bottom


@pytest.mark.parametrize(("low", "high", "begins"), [(68.0, 75.0, 0.0), (-3.0, 5.0, -3.48)])
def test_an_axis_may_have_to_show_zero(low, high, begins):
    axes = Axes()
    axes.line(np.array([0.0, 1.0]), np.array([low, high]), "fit")
    axes.limit(y_from=0.0)
    assert axes.frame().y_ends == pytest.approx((begins, high + 0.06 * (high - low)))


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ([], []),
        ([1.0], [5.0]),
        ([0.0, 1.0], [np.nan, np.nan]),
        ([0.0, 1.0, 2.0], [7.0, 7.0, 7.0]),
        ([0.0, 1.0], [1e280, -1e280]),
        ([0.0, 1.0], [0.0, 5e-324]),
        ([1.7e9, 1.7e9 + 10.0], [1.0, 1.0 + 1e-15]),
        ([3.0, 3.0], [np.inf, 2.0]),
    ],
)
def test_any_data_make_a_figure(x, y):
    axes = Axes()
    axes.line(np.array(x), np.array(y), "fit")
    axes.dots(np.array(x), np.array(y), "measured", 3.0, above=True)
    axes.label("t (s)", "q")
    figure, frame = drawn(axes), axes.frame()
    for low, high in (frame.x_ends, frame.y_ends):
        assert np.isfinite([low, high]).all()
        assert low < high
    source = str(axes.svg("a", "b", "c"))
    assert not re.search(r"nan|inf\b|e[+-]?\d", re.sub(r"<text.*?</text>|viewBox", "", source))
    left, top, right, bottom = figure.clip
    there = np.isfinite(x) & np.isfinite(y)
    for piece in figure.paths("stroke:var(--measured)")[0] if there.any() else []:
        assert left - _DIGIT <= piece[0][0] <= right + _DIGIT
        assert top - _DIGIT <= piece[0][1] <= bottom + _DIGIT


# Texts


@pytest.mark.parametrize("size", [THIRD, HALF, (1080.0, 190.0), (350.0, 200.0)])
@pytest.mark.parametrize("start", [0.0, 12345.5, 1.7e9])
@pytest.mark.parametrize("span", [1e-3, 0.7, 40.0])
@pytest.mark.parametrize("low", [-1e-7, -0.2, 0.01, 2e-6])
def test_ticks_do_not_touch(size, start, span, low):
    """On a telephone text of 11 px is 1.4 times as large; widths are those of DejaVu Sans, a wide font."""

    def width(words: str) -> float:
        ems = {"−": 0.838, ".": 0.318}
        return 11 * 1.4 * sum(ems.get(c, 0.636) for c in words)

    axes = Axes(size)
    axes.line(start + np.array([0.0, span]), np.array([low, 4e5 * abs(low)]), "fit")
    figure = drawn(axes)
    below = figure.texts("tick", "middle")
    assert below
    for (x0, _, one), (x1, _, other) in pairwise(below):
        assert x1 - x0 > 0.5 * (width(one) + width(other)) + 3
    beside = sorted(figure.texts("tick", "end"), key=lambda text: text[1])
    assert all(lower[1] - upper[1] > 11 * 1.4 for upper, lower in pairwise(beside))
    assert all(x - width(words) >= 0 for x, _, words in beside)


def test_texts_are_escaped_named_and_classed():
    hostile = '</title><script>alert(1)</script>&"'
    axes = Axes(HALF)
    axes.line(np.array([0.0, 1.0]), np.array([0.0, 3e-6]), "fit")
    axes.label(hostile, "角 <q>", y_unit="rad & more")
    figure = Figure(str(axes.svg("f3", hostile, hostile)))
    assert figure.root.attrib["role"] == "img"
    title, description = (figure.root.find(tag) for tag in ("title", "desc"))
    assert title is not None
    assert description is not None
    assert title.text == description.text == hostile
    names = [e.attrib["id"] for e in figure.root.iter() if "id" in e.attrib]
    assert figure.root.attrib["aria-labelledby"].split() == names[:2]
    assert len(set(names)) == len(names)
    assert all(name.startswith("f3-") for name in names)
    assert [text[2] for text in figure.texts("label")] == ["角 <q> (10⁻⁶ rad & more)"]
    assert [text[2] for text in figure.texts("label", "end")] == [hostile]
    # Size, colour and font of texts are the style sheet's.
    for text in figure.root.iter("text"):
        assert set(text.attrib) <= {"x", "y", "class", "text-anchor"}
        assert text.attrib["class"] in ("tick", "label")


def test_colours_are_variables_of_the_page():
    x = np.array([0.0, 1.0])
    axes = Axes()
    for colour in COLOURS:
        axes.line(x, x, colour)
        axes.dots(x, x, colour, 3.0, above=True)
    source = str(axes.svg("a", "b", "c"))
    assert set(re.findall(r"var\(--(\w+)\)", source)) == set(COLOURS)
    assert not re.search(r"(?:fill|stroke):(?!none|var\()", source)
    assert "#" not in source.replace("url(#a-c)", "")


def test_many_dots_are_little_markup():
    x = np.linspace(0.0, 1.0, 3000)
    axes = Axes()
    axes.dots(x, np.sin(9 * x), "measured", 2.0)
    axes.dots(x * np.nan, x, "measured", 2.0)
    source = str(axes.svg("a", "b", "c"))
    assert source.count("h0") == 3000
    assert source.count("--measured") == 1
    assert len(source) < 35_000


@pytest.mark.parametrize("n", [20, 300, 30_000])
def test_every_sample_is_inside_what_is_drawn(n, rng):
    t = np.sort(rng.uniform(0.0, 1.0, n))
    y = rng.standard_normal(n)
    y[n // 2] = 9.0
    axes = Axes()
    axes.samples(t, y, 2.0)
    frame = axes.frame()
    source = str(axes.svg("a", "b", "c"))
    assert len(source) < 16_000
    strokes = drawn(axes).paths("--measured")[0]
    ends = np.array([[s[0][0], s[:, 1].min(), s[:, 1].max()] for s in strokes])
    x, up = frame.x(t), frame.y(y)
    nearest = np.abs(ends[:, 0] - x[:, None]) < 1.05
    inside = (ends[:, 1] - 0.1 <= up[:, None]) & (up[:, None] <= ends[:, 2] + 0.1)
    assert (nearest & inside).any(axis=1).all()
    assert len(strokes) <= n


# ------------------------------------------------------------------------------------------ colours and ticks
STYLE = files("leastaction.report").joinpath("style.css").read_text(encoding="utf-8")
DATA = ("ink", "measured", "fit", "forecast")

# Machado, Oliveira & Fernandes (2009), severity 1, for linear RGB.
VISION = {
    "full": np.eye(3),
    "no red cones": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "no green cones": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "no blue cones": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
# Ottosson's OKLab: linear RGB to cones, their cube roots to lightness and two opponent axes.
_CONES = np.array(
    [
        [0.41222147, 0.53633254, 0.05144599],
        [0.21190350, 0.68069955, 0.10739696],
        [0.08830246, 0.28171884, 0.62997870],
    ]
)
_OPPONENT = np.array(
    [
        [0.21045426, 0.79361779, -0.00407205],
        [1.97799850, -2.42859221, 0.45059371],
        [0.02590404, 0.78277177, -0.80867577],
    ]
)


def themes() -> dict[str, dict[str, str]]:
    """Variables of each theme; dark and print override those of light."""
    blocks = re.findall(r"(@media[^{]*\{\s*)?:root \{(.*?)\}", STYLE, re.S)
    found = {}
    for media, body in blocks:
        name = "dark" if "dark" in media else "print" if "print" in media else "light"
        found[name] = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", body))
    return found


THEMES = themes()


def linear(colour: str) -> np.ndarray:
    rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """Ratio of WCAG 2.2."""
    bright, dim = sorted((float(linear(c) @ [0.2126, 0.7152, 0.0722]) for c in (one, other)), reverse=True)
    return (bright + 0.05) / (dim + 0.05)


def seen(colour: str, vision: str) -> np.ndarray:
    return _OPPONENT @ np.cbrt(_CONES @ np.clip(VISION[vision] @ linear(colour), 0.0, 1.0))


def test_the_measures_are_right():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)
    for vision in VISION:  # white has no hue, whoever looks
        assert seen("#ffffff", vision) == pytest.approx([1.0, 0.0, 0.0], abs=2e-3)
    red_green = [np.linalg.norm(seen("#ff0000", v) - seen("#7a7a00", v)) for v in ("full", "no green cones")]
    assert red_green[1] < 0.6 * red_green[0]


def test_every_theme_sets_the_same_colours():
    assert set(THEMES) == {"light", "dark", "print"}
    assert set(THEMES["light"]) == set(THEMES["dark"]) == set(THEMES["print"])
    assert set(COLOURS) <= set(THEMES["light"])


@pytest.mark.parametrize("theme", THEMES)
def test_text_has_enough_contrast(theme):
    colours = THEMES[theme]
    grounds = {"paper": ("ink", "muted", "link"), "soft": ("ink", "muted")}
    grounds |= {f"{status}-soft": ("ink", "muted", status) for status in ("ok", "doubt")}
    for ground, texts in grounds.items():
        for text in texts:
            assert contrast(colours[text], colours[ground]) >= 4.5, (text, ground)


@pytest.mark.parametrize("theme", THEMES)
def test_lines_and_dots_stand_out(theme):
    colours = THEMES[theme]
    for name in DATA:
        assert contrast(colours[name], colours["paper"]) >= 3.0, name
    for name in ("ink", "fit"):  # what is drawn on the shaded stretch
        assert contrast(colours[name], colours["shade"]) >= 3.0, name


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("theme", THEMES)
def test_the_colours_of_figures_stay_apart(theme, vision):
    colours = THEMES[theme]
    for one, other in combinations(DATA, 2):
        apart = np.linalg.norm(seen(colours[one], vision) - seen(colours[other], vision))
        assert apart > 0.12, (one, other, apart)  # 0.02 is just noticeable


def test_paper_is_white_and_its_text_black():
    paper = THEMES["print"]
    assert (paper["paper"], paper["ink"], paper["soft"]) == ("#ffffff", "#000000", "#ffffff")
    rules = STYLE[STYLE.rindex("@media print") :]
    assert re.search(r"figure, [^{]*tr,[^{]*\{ break-inside: avoid; \}", rules)
    assert re.search(r"h2, h3,[^{]*\{ break-after: avoid; \}", rules)


def test_colours_are_named_in_one_place_only():
    rules = re.sub(r":root \{.*?\}", "", STYLE, flags=re.S)
    assert not re.search(r"#[0-9a-f]{3,8}\b(?![^{}]*\{)", rules)
    named = set(re.findall(r"var\(--([\w-]+)", rules)) - {"colour", "zoom"}
    assert named <= set(re.findall(r"--([\w-]+):", STYLE))


# laws of the ticks: where they are, how many, and that their texts are the numbers

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−", "0123456789--")


def read(ticks: Ticks) -> np.ndarray:
    """The numbers that the texts say."""
    values = []
    for words in ticks.texts:
        sign, size = (-1.0, words[1:]) if words.startswith("−") else (1.0, words)
        assert "-" not in size
        raised = size[2:].translate(_SUPERSCRIPTS) if size[:2] == "10" else ""
        is_power = bool(raised) and not size[2:].isascii()
        values.append(sign * (10.0 ** int(raised) if is_power else float(size)))
    return np.array(values) * 10.0**ticks.power


@given(
    low=st.floats(-1e6, 1e6),
    span=st.floats(1e-9, 1e9),
    most=st.integers(2, 13),
    steps=st.sampled_from([(1.0, 2.0, 5.0), (1.0, 2.0, 2.5, 5.0)]),
)
def test_linear_ticks(low, span, most, steps):
    assume(span > 1e-7 * abs(low))  # closer, and no text of a dozen digits would tell the ticks apart
    high = low + span
    ticks = Linear(steps=steps).ticks(low, high, most)
    places = np.array(ticks.places)
    # Some, not too many; rising, inside, and no room for one more at either end.
    assert 2 <= places.size <= max(most + 1, 2 * len(steps))
    step = np.diff(places)
    assert (step > 0).all()
    np.testing.assert_allclose(step, step[0], rtol=1e-6)
    slack = 1e-6 * span
    assert low - slack <= places[0] < low + step[0] + slack
    assert high - step[0] - slack < places[-1] <= high + slack
    # Round: the step is one of these times a power of ten, and every tick a multiple of the step.
    mantissa = step[0] / 10.0 ** math.floor(math.log10(step[0] * (1 + 1e-6)))
    assert min(abs(mantissa - s) for s in steps) < 1e-6
    np.testing.assert_allclose(places / step[0], np.rint(places / step[0]), atol=1e-6)
    # The texts are the numbers.
    assert len(set(ticks.texts)) == places.size
    np.testing.assert_allclose(read(ticks), places, atol=1e-3 * step[0])


@given(low=st.floats(-50, 50), span=st.floats(1.0, 500.0), most=st.integers(2, 13))
def test_counts_have_whole_ticks(low, span, most):
    ticks = Linear(whole=True).ticks(low, low + span, most)
    assert len(ticks.places) >= 1
    assert all(place == round(place) for place in ticks.places)
    assert all("." not in words for words in ticks.texts)


@pytest.mark.parametrize(
    ("low", "high", "texts", "power"),
    [
        (0.0, 1.0, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"], 0),
        (2.6, 3.6, ["2.6", "2.8", "3.0", "3.2", "3.4", "3.6"], 0),
        (-130000.0, 80000.0, ["−1.0", "−0.5", "0.0", "0.5"], 5),
        (0.0, 99999.0, ["0", "20000", "40000", "60000", "80000"], 0),
        (0.0021, 0.0044, ["0.0025", "0.0030", "0.0035", "0.0040"], 0),
        (0.0, 4e-4, ["0", "1", "2", "3", "4"], -4),
    ],
)
def test_texts_of_ticks(low, high, texts, power):
    ticks = Linear().ticks(low, high, 5)
    assert (list(ticks.texts), ticks.power) == (texts, power)


@pytest.mark.parametrize("end", [1e-290, 1e-200, 1e200, 1e290])
def test_sizes_at_the_ends_of_the_numbers(end):
    ticks = Linear().ticks(0.0, end, 5)
    assert len(ticks.places) >= 5
    assert ticks.places[-1] == pytest.approx(end)
    assert ticks.power == round(math.log10(end))


@given(st.floats(-1e12, 1e12), st.floats(-1e12, 1e12))
def test_the_folded_scale_rises_and_is_odd(one, other):
    assume(abs(one - other) > 1e-6 * max(abs(one), abs(other), 1.0))
    a, b = folded(np.array([one, other]))
    assert (a < b) == (one < other)
    assert folded(np.array(-one)) == -a


def test_the_folded_scale_is_logarithmic_beyond_ten():
    np.testing.assert_allclose(folded(np.array([10.0, 100.0, -1e5, 5.0, 0.0])), [1.0, 2.0, -5.0, 0.5, 0.0])
    just = np.array([10.0 - 1e-9, 10.0 + 1e-9])
    assert np.ptp(folded(just)) < 1e-9  # without a jump where it changes
    decade = folded(np.array([1e3, 2e3, 5e3, 1e4])) - 3.0
    np.testing.assert_allclose(decade, np.log10([1.0, 2.0, 5.0, 10.0]))


@given(low=st.floats(-12.0, 0.0), span=st.floats(0.81, 14.0), most=st.integers(3, 9))
def test_folded_ticks(low, span, most):
    # 5, 10 and 20 lie 0.5 and 0.301 apart, which is the widest: 0.81 holds two of them wherever it begins.
    ticks = Folded().ticks(low, low + span, most)
    places = np.array(ticks.places)
    assert 2 <= places.size <= max(2 * most, 10)
    assert (np.diff(places) > 0).all()
    assert low <= places[0] < places[-1] <= low + span
    assert ticks.power == 0 or places.size < 10
    # The place of the number in the text is the place of the tick.
    np.testing.assert_allclose(folded(read(ticks)), places, atol=1e-9)
    values = np.abs(read(ticks))
    values = values[values > 0]
    mantissas = values / 10.0 ** np.floor(np.log10(values * (1 + 1e-9)))
    assert np.abs(mantissas[:, None] - [1.0, 2.0, 5.0]).min(axis=1).max() < 1e-9


def test_powers_are_written_out_while_they_are_short():
    assert [in_powers(k) for k in (-4, -3, 0, 1, 12)] == ["−10⁴", "−1000", "0", "10", "10¹²"]
