from __future__ import annotations

import re
from dataclasses import replace
from importlib.resources import files

import matplotlib
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
from leastaction._forecast import ForecastResult, ForecastTrace
from leastaction._library import Dropped, make_term
from leastaction._model_parts import FitSummary, ModelTerm
from leastaction._report._mathml import number_parts
from leastaction._report._svg import COLOURS
from leastaction._spline import SplineGrid
from report_helpers import Page, spring

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
    assert len(source.encode()) < 1_000_000


def test_page_has_every_section(source, pendulum):
    page = Page(source)
    sections = [attributes["id"] for tag, attributes in page.tags if tag == "section"]
    assert " ".join(map(str, sections)) == (
        "coefficients curve residuals selection energy forecast data dropped reproduce"
    )
    assert "leastaction discover a.csv" in page.text
    assert pendulum[0].provenance["data"] in page.text
    assert "double_pendulum-0" in page.text
    for term in pendulum[0].terms:
        value, error, _ = number_parts(term.coefficient, term.standard_error)
        assert value in page.text
        assert f"± {error}" in page.text


def test_figures_have_alternative_text_and_theme_colours(source):
    page = Page(source)
    figures = [attributes for tag, attributes in page.tags if tag == "svg"]
    assert len(figures) >= 2 * (1 + 3 + 3) + 1 + 2 + 2 * 3
    assert all(f["role"] == "img" and len(f["aria-label"] or "") > 10 for f in figures)
    for colour in COLOURS.values():
        assert colour not in source
    assert not re.search(r"stroke: ?#|fill: ?#", source)
    assert source.count("prefers-color-scheme: dark") == 1
    styled = set(re.findall(r"--([\w-]+):", source))
    assert set(re.findall(r"var\(--([\w-]+)\)", source)) <= styled


def test_same_model_same_page(source, pendulum, tmp_path):
    model, validation = pendulum
    again = written(tmp_path, model, validation=validation, command="leastaction discover a.csv")
    assert again == source


def test_settings_of_the_user_neither_matter_nor_change(source, pendulum, tmp_path):
    model, validation = pendulum
    theirs = {"text.usetex": True, "lines.linewidth": 9.0, "svg.fonttype": "path", "axes.grid": False}
    with matplotlib.rc_context(theirs):
        before = dict(matplotlib.rcParams)
        again = written(tmp_path, model, validation=validation, command="leastaction discover a.csv")
        assert dict(matplotlib.rcParams) == before
    assert again == source


def test_everything_untrusted_is_escaped(tmp_path):
    model = spring(name=HOSTILE)
    diagnostics = replace(
        model.diagnostics,
        notes=(HOSTILE,),
        dropped=(Dropped(make_term("x", ["x", "x_dot"]), "null", HOSTILE),),
        timings={HOSTILE: 1.0},
    )
    model = replace(
        model,
        diagnostics=diagnostics,
        fit=FitSummary("doubtful", 1.0, [1.0], [HOSTILE]),
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


def test_status_and_warnings(tmp_path):
    model = spring()
    assert 'class="badge">ok<' in written(tmp_path, model)
    doubtful = replace(model, fit=FitSummary("doubtful", 2.0, [1.0], ["the library cannot explain x"]))
    source = written(tmp_path, doubtful)
    assert (
        source.index('class="badge">doubtful<')
        < source.index("the library cannot explain x")
        < source.index("<nav")
    )


def test_units_known_terms_and_friction(tmp_path):
    page = Page(written(tmp_path, spring(friction=0.1)))
    assert "known, not estimated" in page.text
    assert "x (rad)" in page.text
    assert "dx/dt (rad/s)" in page.text
    assert "Friction takes energy, so the total falls" in page.text
    assert "expected from friction" in page.text
    assert "keep some trials back" in page.text
    model = spring()
    page = Page(written(tmp_path, replace(model, provenance={})))
    assert "d²x/dt² (units/s²)" in page.text
    assert "should stay constant" in page.text
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
    assert len([tag for tag, _ in page.tags if tag == "svg"]) == 6 * 7 + 1


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


def test_misuse_is_explained(tmp_path, pendulum):
    model, validation = pendulum
    model.save(tmp_path / "model.json")
    with pytest.raises(InputError, match=r"no diagnostics.*Run discover"):
        write_report(load(tmp_path / "model.json"), tmp_path / "report.html")
    with pytest.raises(InputError, match="expected a LagrangianModel"):
        write_report("model.json", tmp_path / "report.html")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"result of model\.validate"):
        write_report(model, tmp_path / "report.html", validation={})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="the coordinates theta1, theta2, but the model has x"):
        write_report(spring(), tmp_path / "report.html", validation=validation)
    with pytest.raises(InputError, match="command is 3"):
        write_report(model, tmp_path / "report.html", command=3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="is a directory"):
        write_report(spring(), tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_template_and_style_are_in_the_package():
    here = files("leastaction._report")
    assert {"template.html.j2", "style.css"} <= {item.name for item in here.iterdir()}
