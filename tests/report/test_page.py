from __future__ import annotations

import re
from dataclasses import replace
from importlib.resources import files
from itertools import pairwise

import numpy as np
import pytest
from markupsafe import escape

from leastaction import (
    InputError,
    LagrangianModel,
    Trajectories,
    Trajectory,
    discover,
    load,
    systems,
    write_report,
)
from leastaction.curve.bspline import SplineGrid
from leastaction.findings import Finding, find
from leastaction.library import Dropped, make_term
from leastaction.model.diagnostics import HiddenMotion
from leastaction.model.mathml import number_parts
from leastaction.model.term import FitSummary, ModelTerm
from leastaction.report.text import percent
from leastaction.simulation.forecast import ForecastResult, ForecastTrace
from page_helpers import Page, spring

HOSTILE = '</title><script>alert(1)</script>"><img src=x onerror=alert(2)>$\\frac{1}{$'


def written(tmp_path, model, **options) -> str:
    path = write_report(model, tmp_path / "report.html", **options)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pendulum() -> tuple[LagrangianModel, ForecastResult]:
    """A driven double pendulum, as a user would find it, and forecasts of a held-out trial."""
    data = systems.generate("double_pendulum", noise=0.05, trials=3, duration=6.0, seed=3)
    model = discover(data[:2], systems.get("double_pendulum").library, angles=["theta1", "theta2"])
    return model, model.validate(data[2:])


@pytest.fixture(scope="module")
def source(pendulum, tmp_path_factory) -> str:
    model, validation = pendulum
    path = tmp_path_factory.mktemp("report") / "new" / "report.html"
    assert write_report(model, path, validation=validation, command="leastaction discover a.csv") == path
    return path.read_text(encoding="utf-8")


def test_page_is_self_contained(source):
    page = Page(source)
    assert not {"script", "link", "img", "iframe", "object", "audio", "video"} & {tag for tag, _ in page.tags}
    assert page.attributes("src") == []
    identifiers = page.attributes("id")
    assert len(identifiers) == len(set(identifiers))
    assert {link.removeprefix("#") for link in page.attributes("href")} <= set(identifiers)
    assert set(re.findall(r"url\(#([^)]*)\)", source)) <= set(identifiers)
    assert "http:" not in source
    assert "https" not in source
    assert "@import" not in source
    assert "default-src 'none'" in source
    assert not [name for _, attributes in page.tags for name in attributes if name.startswith("on")]
    assert len(source.encode()) < 300_000


def test_sections_follow_the_reading_sequence(source, pendulum):
    model, validation = pendulum
    page = Page(source)
    main = page.root.one("main")
    assert " ".join(str(s.attributes["id"]) for s in main.all("section")) == (
        "verdict lagrangian coefficients symmetries motions forecast curve residuals energy selection data "
        "dropped reproduce"
    )
    linked = [a.attributes["href"] for a in page.root.one("nav").all("a")]
    assert linked == [f"#{s.attributes['id']}" for s in main.all("section")[2:]]
    assert "leastaction discover a.csv" in page.by_id("reproduce").one("pre").text
    assert model.provenance["data"] in page.by_id("reproduce").text
    assert "double_pendulum-0" in page.by_id("data").text
    for section in ("curve", "residuals", "energy"):
        assert "rial double_pendulum-0" in page.by_id(section).text
    rows = page.by_id("symmetries").one("tbody").all("tr")
    cells = [[cell.text.strip() for cell in row.all("th", "td")] for row in rows]
    assert cells[0] == ["time reversal", "in form", "", ""]
    assert cells[1][2:] == ["energy", "not conserved because of the known forces"]
    facts = {d.one("dt").text: d.all("dd")[0].text for d in page.by_id("lagrangian").one("dl").all("div")}
    assert facts["Terms found"] == str(len(model.terms))
    assert facts["Forecast error"] == percent(float(validation.rms_over_std.max()))


def test_coefficients_are_shown_twice_and_alike(source, pendulum):
    model, _ = pendulum
    page = Page(source)
    formula = page.by_id("lagrangian").all("p", class_="formula")[0]
    rows = [
        r for r in page.by_id("coefficients").one("table", class_="coefficients").all("tr") if r.all("td")
    ]
    assert len(rows) == len(model.terms) == len(formula.all("math"))
    for term, row, addend in zip(model.terms, rows, formula.all("math"), strict=True):
        number = number_parts(term.coefficient, term.standard_error)
        assert [cell.text for cell in row.all("td")[:2]] == [number.text, f"± {number.error_text}"]
        assert number.value.removeprefix("−") in addend.text
        assert addend.one("mtext").text == f"± {number.error}"
        assert "the 95 % interval ends" in row.one("svg").one("title").text


def test_landmarks_headings_and_tables_can_be_heard(source):
    page = Page(source)
    assert page.root.one("html").attributes["lang"] == "en"
    for landmark in ("header", "main", "nav", "footer", "h1"):
        assert page.root.one(landmark).text.strip()
    assert page.root.one("head").one("title").text == "Lagrangian of θ₁, θ₂ (ok)"
    for section in page.root.all("section"):
        heading = page.by_id(str(section.attributes["aria-labelledby"]))
        assert heading.tag == "h2"
        assert heading.text.strip()
    levels = [int(e.tag[1]) for e in page.root.all("h1", "h2", "h3", "h4")]
    assert all(after <= before + 1 for before, after in pairwise(levels))
    for table in page.root.all("table"):
        assert table.all("caption") or table.attributes["aria-labelledby"]
        assert all(th.attributes["scope"] in ("col", "row", "rowgroup") for th in table.all("th"))
        assert all(row.all("th") for row in table.all("tr"))
    for region in page.root.all(class_="scroll"):
        assert region.attributes["tabindex"] == "0"
        assert region.attributes["role"] == "region"
        assert region.attributes["aria-label"]
    assert all(d.children and d.one("summary").text for d in page.root.all("details"))


def test_every_drawing_has_title_and_description(source):
    page = Page(source)
    drawings = [s for s in page.root.all("svg") if s.attributes.get("aria-hidden") != "true"]
    panels = [s for s in drawings if "whisker" not in (s.attributes.get("class") or "")]
    assert len(panels) == 2 * (4 + 3) + 1 + 2 + 2 * 2 * 2
    for drawing in drawings:
        assert drawing.attributes["role"] == "img"
        said = [page.by_id(name).text for name in str(drawing.attributes["aria-labelledby"]).split()]
        assert len(said) == (2 if drawing in panels else 1)
        assert all(len(text) > 10 for text in said)
    for panel in panels:
        (figure,) = [a for a in panel.ancestors if a.tag == "figure"]
        assert len(figure.one("figcaption").one("p", class_="seen").text) > 20
        labels = [t.text for t in panel.all("text", class_="label")]
        # A forecast shares the axis of time with its errors below it.
        assert len(labels) == (1 if panel.one("title").text.endswith("forecast and samples") else 2)
        assert all(
            "(" in t or t.startswith(("density", "autocorr", "residual", "number", "differ")) for t in labels
        )


def test_figures_take_their_colours_from_the_style_sheet(source):
    page = Page(source)
    for drawing in page.root.all("svg"):
        for element in drawing.elements():
            assert not re.search(r"(?:stroke|fill): ?#", element.attributes.get("style") or "")
    styled = set(re.findall(r"--([\w-]+):", source))
    assert set(re.findall(r"var\(--([\w-]+)[,)]", source)) <= styled


def test_same_model_same_page(source, pendulum, tmp_path):
    model, validation = pendulum
    again = written(tmp_path, model, validation=validation, command="leastaction discover a.csv")
    assert again == source


def test_everything_untrusted_is_escaped(tmp_path):
    model = spring(name=HOSTILE)
    note, warning = Finding.of_text(HOSTILE, "note"), Finding("hostile", "warning", (), {}, HOSTILE, HOSTILE)
    findings = [note, warning]
    diagnostics = replace(
        model.diagnostics,
        dropped=(Dropped(make_term("x", ["x", "x_dot"]), "null", HOSTILE),),
        timings={HOSTILE: 1.0},
    )
    model = replace(
        model,
        diagnostics=diagnostics,
        fit=FitSummary("doubtful", 1.0, [1.0], findings=findings),
        provenance={
            "version": HOSTILE,
            "options": {HOSTILE: HOSTILE},
            "data": HOSTILE,
            "n_candidates": HOSTILE,
        },
    )
    source = written(tmp_path, model, command=HOSTILE)
    assert "<script" not in source
    assert "<img" not in source
    assert source.count(str(escape(HOSTILE))) >= 8
    page = Page(source)
    assert HOSTILE in page.text


def test_verdict_comes_first_and_keeps_the_words_of_the_warnings(tmp_path):
    model = spring()
    page = Page(written(tmp_path, model))
    verdict = page.by_id("verdict")
    assert verdict.attributes["class"] == "ok"
    assert verdict.one(class_="badge").text.split()[-1] == "ok"
    assert "Hold out a trial" in verdict.text
    message, remedy = "the library cannot explain x", "friction (or a force: any) is missing"
    findings = [
        Finding("missing", "warning", ("x",), {}, message, remedy),
        Finding.of_text("no colon <here>"),
    ]
    fit = FitSummary("doubtful", 2.0, [1.0], findings=findings)
    page = Page(written(tmp_path, replace(model, fit=fit)))
    main = page.root.one("main")
    verdict = next(c for c in main.children if not isinstance(c, str))
    assert verdict.attributes["class"] == "doubtful"
    assert verdict.one(class_="badge").text.split()[-1] == "doubtful"
    warnings = verdict.one(class_="warnings").all("li")
    assert [li.text for li in warnings] == [*fit.warnings]
    assert warnings[0].one("b").text == "the library cannot explain x"


def test_the_law_follows_the_verdict_which_holds_every_reservation(tmp_path):
    findings = [
        find("equation-error", "x", equation_error=0.004),
        find("decimal-comma"),
        find("text-encoding", encoding="cp1252"),
    ]
    model = replace(spring(friction=0.1), fit=FitSummary("ok", 1.0, [1.0], findings=findings))
    page = Page(written(tmp_path, model))
    first, second = page.root.one("main").all("section")[:2]
    assert first.attributes["id"] == "verdict"
    assert second.attributes["id"] == "lagrangian"
    assert "the equation of x leaves 0.4 %" in first.one(class_="reserved").text
    assert first.one("details").one("summary").text == "2 notes on the data"
    everything = page.root.text
    assert everything.index("With reservations") < everything.index("Lagrangian and friction")
    # what the page says of one standard error it says nowhere of two
    assert "±1.96" not in everything
    assert re.search(r"leastaction report, \d{1,2} [A-Z][a-z]+ \d{4}", everything)
    for section in ("curve", "residuals", "selection", "data", "reproduce"):
        assert page.by_id(section).all("details")


def test_a_usable_model_says_how_far_it_forecasts(tmp_path):
    findings = [
        find("late-forces", delay=0.02, half_a_sample=False, gain=90.0),
        find(
            "forecasts",
            **{"horizon": 0.5, "error": 0.01, "worst": 0.02, "trials": 3},
            **{"left_out": 0.031, "worst_left_out": 0.062},
        ),
    ]
    page = Page(written(tmp_path, replace(spring(), fit=FitSummary("usable", 2.0, [1.0], findings=findings))))
    verdict = next(c for c in page.root.one("main").children if not isinstance(c, str))
    assert verdict.attributes["class"] == "usable"
    assert (
        "an error of 3.1 % of the spread over 0.5 s (6.2 % in the worst trial) is good enough" in verdict.text
    )
    said = [li.text for li in verdict.one(class_="statements").all("li")]
    assert said[0] == "Structure: determined"
    assert said[2].startswith(
        "Forecast: simulations over 0.5 s of trials left out of the fit are off by 3.1 %"
    )


def test_units_known_terms_and_friction(tmp_path):
    page = Page(written(tmp_path, spring(friction=0.1)))
    assert "known, not estimated" in page.text
    assert "x (rad)" in page.text
    assert "dx/dt (rad/s)" in page.text
    assert "Friction lowers the energy from" in page.by_id("energy").one(class_="seen").text
    assert "expected from friction" in page.text
    assert "keep some trials back" in page.text
    model = spring()
    page = Page(written(tmp_path, replace(model, provenance={})))
    assert "d²x/dt² (units/s²)" in page.text
    assert "should stay at" in page.by_id("energy").one(class_="seen").text
    assert "SHA-256 of the data" in page.text


def test_odd_data_can_be_reported(tmp_path):
    model = spring(sigma=0.0)
    diagnostics = model.diagnostics
    trial = diagnostics.trajectories[0]
    q = trial.q.copy()
    q[20:200] = np.nan
    holes = replace(
        diagnostics,
        trajectories=Trajectories([Trajectory(trial.t, q, coordinates=["x"])]),
        path=(),
        timings={},
    )
    source = written(tmp_path, replace(model, diagnostics=holes, fit=FitSummary("ok")))
    assert "keeps no path" in source
    assert "nan" not in Page(source).text.lower()
    first = Trajectory(trial.t[:6], trial.q[:6], coordinates=["x"])
    short = replace(diagnostics, trajectories=Trajectories([first]))
    assert "</html>" in written(tmp_path, replace(model, diagnostics=short))


def test_the_curve_says_why_each_structure_was_not_chosen(tmp_path):
    model = spring()
    reasons = ("fits-worse", "chosen", "irrelevant", "fits-worse")
    path = tuple(replace(p, reason=r) for p, r in zip(model.diagnostics.path, reasons, strict=True))
    path = (*path[:2], replace(path[2], bic=-3.0), path[3])
    model = replace(model, diagnostics=replace(model.diagnostics, path=path))
    source = written(tmp_path, model)
    assert "belongs to a structure with 3 terms: it was not" in source
    irrelevant = "each of its additional terms removes less than the required share of the equation error"
    assert source.count(irrelevant) == 2
    assert source.count("it fits the data worse") == 2
    assert "taken from the curve by hand" not in source
    # a model that is not the chosen one
    by_hand = replace(model, provenance={**model.provenance, "structure": ["x_dot**2", "x**2", "x**4"]})
    source = written(tmp_path, by_hand)
    assert "its 3 terms were taken from the curve by hand" in source
    assert source.count("<b>this model</b>") == 1
    assert "This gives the chosen structure" in source
    chosen = replace(model, provenance={**model.provenance, "structure": ["x_dot**2", "x**2"]})
    assert "taken from the curve by hand" not in written(tmp_path, chosen)


def test_what_is_not_finite_is_not_on_the_curve(tmp_path):
    model = spring()
    path = (*model.diagnostics.path, replace(model.diagnostics.path[0], bic=np.inf, cost=np.inf))
    source = written(tmp_path, replace(model, diagnostics=replace(model.diagnostics, path=path)))
    assert "inf %" not in source
    assert source == written(tmp_path, model)


def test_forecasts_that_fail_are_shown_as_such(tmp_path):
    t = np.linspace(1.0, 2.0, 51)
    measured = np.cos(2 * t)[:, None]
    run = np.where(t < 1.5, np.exp(20 * (t - 1.0)), np.nan)[:, None]
    inf, nan = np.array([np.inf]), np.array([np.nan])
    traces = (
        ForecastTrace("a", 1.0, t, measured, run, inf, nan, 0.1, "diverged", "blow-up"),
        ForecastTrace("b", 1.0, t, measured, nan * run, inf, nan, 0.0, "failed", "no motion"),
        ForecastTrace("c", 1.0, t, nan * measured, run, nan, nan, 1.0, "ok"),
    )
    numbers = np.array([0.01]), np.array([0.7])
    result = ForecastResult(("x",), 1.0, 0.5, 0.4, *numbers, traces, (("d", "too short <for a window>"),))
    with np.errstate(invalid="ignore"):
        page = Page(written(tmp_path, spring(), validation=result))
    assert "2 of them diverged." in page.text
    assert "diverged: blow-up" in page.text
    assert "∞" in page.text
    assert "d (too short <for a window>)" in page.text


def test_a_coordinate_without_a_sensor_has_its_band(tmp_path):
    model = spring()
    motions = tuple(
        HiddenMotion(run.t, run.q[:, 0], np.linspace(0.01, 0.05, run.n_times))
        for run in model.diagnostics.trajectories
    )
    hidden = replace(model, diagnostics=replace(model.diagnostics, hidden_motion={"x": motions}))
    page = Page(written(tmp_path, hidden))
    assert "x: not measured, but estimated from the equations (95 % band: at most ± 0.098)" in page.text
    titles = [svg.one("title").text for svg in page.by_id("curve").all("svg")]
    assert titles[1] == "95 % band of x"
    assert "x not measured" in " ".join(page.by_id("data").all("p")[0].text.split())


def test_only_the_largest_error_of_several_coordinates_is_open(source, pendulum):
    section = Page(source).by_id("forecast")
    panels = {svg.one("title").text.partition(" of trial")[0]: svg for svg in section.all("svg")}
    assert set(panels) == {"θ₁", "θ₂"}
    folded = [any(a.tag == "details" for a in svg.ancestors) for svg in section.all("svg")]
    assert folded == 4 * [False] + 4 * [True]  # of each coordinate the forecast, and its errors


def test_figures_of_the_first_six_coordinates_only(tmp_path):
    model, n = spring(), 7
    names = [f"q{k}" for k in range(n)]
    trial = model.diagnostics.trajectories[0]
    data = Trajectories([Trajectory(trial.t, np.tile(trial.q, (1, n)), coordinates=names)])
    diagnostics = replace(
        model.diagnostics,
        trajectories=data,
        control_points=np.tile(model.diagnostics.control_points, (1, n)),
        noise_std=np.full(n, 0.01),
        physics_weight=np.ones(n),
        equation_error=np.ones(n),
        path=(),
    )
    terms = [ModelTerm(f"{c}_dot**2", 0.25, 0.01) for c in names]
    model = LagrangianModel(names, terms, noise_std=[0.01] * n, diagnostics=diagnostics)
    page = Page(written(tmp_path, model))
    assert "Figures show the first 6 of 7 coordinates" in page.text
    figures = page.root.all("figure")
    assert len(figures) == 6 + 6 + 6 + 1
    assert sum(len(f.all("svg")) for f in figures) == 6 * 7 + 1


def test_long_tables_are_cut(tmp_path):
    model = spring(seconds=2.0)
    diagnostics = model.diagnostics
    space, trial = diagnostics.grid.spaces[0], diagnostics.trajectories[0]
    n = 70
    many = [Trajectory(trial.t[: 20 + k], trial.q[: 20 + k], coordinates=["x"]) for k in range(n)]
    points = np.tile(diagnostics.control_points, (n, 1))
    model = replace(
        model,
        diagnostics=replace(
            diagnostics, trajectories=Trajectories(many), grid=SplineGrid([space] * n), control_points=points
        ),
    )
    source = written(tmp_path, model)
    assert "and 40 more rows" in source
    assert len(source) < 1_000_000


def test_sentences_and_figures_have_the_names_of_the_user(tmp_path):
    plain, named = (
        written(tmp_path, spring()),
        written(tmp_path, spring(), names={"x": "Position of the <cart>"}),
    )
    words = "Position of the &lt;cart&gt;"
    assert words not in plain
    assert f">{words} (rad)<" in named
    assert f"Residuals of {words} over" in named
    assert "<cart>" not in named
    assert named.count("</math>") >= plain.count("</math>") / 2  # the formulas stay


def test_misuse_is_explained(tmp_path, pendulum):
    model, validation = pendulum
    model.save(tmp_path / "model.json")
    with pytest.raises(InputError, match=r"no diagnostics.*run discover"):
        write_report(load(tmp_path / "model.json"), tmp_path / "report.html")
    with pytest.raises(InputError, match="expected a LagrangianModel"):
        write_report("model.json", tmp_path / "report.html")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"result of model\.validate"):
        write_report(model, tmp_path / "report.html", validation={})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="the coordinates theta1, theta2, but the model has x"):
        write_report(spring(), tmp_path / "report.html", validation=validation)
    with pytest.raises(InputError, match="command is 3"):
        write_report(model, tmp_path / "report.html", command=3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="names has 'y', which is no coordinate"):
        write_report(spring(), tmp_path / "report.html", names={"y": "cart"})
    with pytest.raises(InputError, match="expected a mapping"):
        write_report(spring(), tmp_path / "report.html", names=["cart"])  # type: ignore[arg-type]
    with pytest.raises(InputError, match="is a directory"):
        write_report(spring(), tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_template_and_style_are_in_the_package():
    here = files("leastaction.report")
    parts = {f"{name}.html.j2" for name in ("page", "macros", "evidence")}
    assert parts | {"style.css"} <= {item.name for item in here.iterdir()}


def test_forty_terms_of_long_names_can_wrap_or_scroll(tmp_path):
    """What cannot be broken into lines lies in a box that scrolls; the rest may break anywhere."""
    model = spring()
    diagnostics = model.diagnostics
    names = ["shoulder_flexion_of_the_left_arm_measured", "elbow_flexion_of_the_left_arm_measured"]
    trial = diagnostics.trajectories[0]
    a, b = names
    texts = [f"{a}_dot**2", f"{b}_dot**2"]
    texts += [f"{x}**{k}*cos({m}*{a}-{b})" for x in names for k in range(1, 6) for m in (1, 2, 3, 4)][:38]
    data = Trajectories([Trajectory(trial.t, np.tile(trial.q, (1, 2)), coordinates=names, name="n" * 90)])
    diagnostics = replace(
        diagnostics,
        trajectories=data,
        control_points=np.tile(diagnostics.control_points, (1, 2)),
        noise_std=np.full(2, 0.01),
        physics_weight=np.ones(2),
        equation_error=np.ones(2),
        dropped=tuple(Dropped(make_term("x", ["x", "x_dot"]), "null", a * 3) for _ in range(40)),
        path=(),
    )
    terms = [ModelTerm(text, 1.0 / (k + 1), 0.3) for k, text in enumerate(texts)]
    source = written(tmp_path, LagrangianModel(names, terms, noise_std=[0.01] * 2, diagnostics=diagnostics))
    assert len(source.encode()) < 300_000
    page = Page(source)
    assert len(page.by_id("coefficients").all("svg", class_="whisker")) == 40 + 1
    assert [s.text for s in page.root.one("h1").all(class_="wrap")] == names
    boxes = {"scroll", "formula", "term", "small"}
    for element in page.root.all("math", "table"):
        around = {c for e in element.ancestors for c in (e.attributes.get("class") or "").split()}
        assert around & boxes or element.attributes.get("class") == "bars"
    fold = page.by_id("dropped").one("details")
    assert fold.one("summary").text.startswith("40 candidates")
    for text in page.root.all("text", class_="label"):
        (svg,) = [e for e in text.ancestors if e.tag == "svg"]
        assert 7 * len(text.text) < float(str(svg.attributes["viewbox"]).split()[2])
