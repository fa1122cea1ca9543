"""Parts of the report: sentences and small drawings must say what the numbers say."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from leastaction import (
    LagrangianModel,
    Trajectories,
    Trajectory,
    write_report,
)
from leastaction.curve.bspline import SplineGrid, uniform_space
from leastaction.mechanics.equations import state_symbols
from leastaction.model.diagnostics import PathPoint, pareto
from leastaction.model.mathml import Notation, number_parts
from leastaction.model.symmetries import Symmetry
from leastaction.model.term import FitSummary, ModelTerm
from leastaction.report.axes import shortened, thin_line
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
from leastaction.report.law import contributions, correlations, equations, unsmoothed
from leastaction.report.series import Energy, Series
from leastaction.report.tables import motion_rows, pareto_rows, path_rows, symmetry_rows
from leastaction.report.text import plain
from leastaction.report.verdict import in_symbols, verdict
from leastaction.simulation.forecast import ForecastResult, ForecastTrace
from page_helpers import Page, spring


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
        assert "abs(" in unsmoothed(text, notation.widths)
    for text in ("sqrt(theta1_dot**2 + 1/10)", "sqrt(x_cart**3 + 1/4)", "sqrt(9/10000 + theta1)"):
        assert "<msqrt>" in notation.term(text)
        assert unsmoothed(text, notation.widths) == text


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
    note = motion_note(model.small_motions[0][1].left_out)
    assert note.endswith("at rest: abs(theta2_dot).")
    assert "dry friction" not in motion_note(())
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
