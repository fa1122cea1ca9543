"""Models: what they hold and say, their files; how objects show themselves in notebooks and plots."""

from __future__ import annotations

import copy
import json
import math
import os
import pickle
import re
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import sympy as sp

import leastaction as la
from leastaction import io, systems
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.findings import Finding, find
from leastaction.model.diagnostics import PathPoint, TradeOff
from leastaction.model.file import MAX_BYTES, MAX_TERMS, load
from leastaction.model.groups import GroupDifference, Groups
from leastaction.model.mathml import Notation
from leastaction.model.model import FitSummary, LagrangianModel, ModelTerm
from leastaction.model.notation import rounded
from leastaction.shown import Card, Display, Panel, Series, Typeset
from page_helpers import Page
from page_helpers import spring as spring_with_curve


def model_of(system, dissipation=()):
    terms = [ModelTerm(k, c, known=k in system.known) for k, c in system.lagrangian.items()]
    return LagrangianModel(system.coordinates, terms, dissipation)


def spring(**options):
    terms = [ModelTerm("x_dot**2", 0.5, known=True), ModelTerm("x**2", -2.0, 0.01)]
    return LagrangianModel(["x"], terms, **options)


def states(system, n_points):
    rng = np.random.default_rng(1)
    return np.moveaxis(np.array([system.initial(rng) for _ in range(n_points)]), 1, 0)


@pytest.mark.parametrize("name", systems.names())
def test_mechanics_agree_with_the_systems_own(name):
    system = systems.get(name)
    model = model_of(system)
    q, v = states(system, 6)
    f = np.cos(q)
    np.testing.assert_allclose(
        model.acceleration(q, v, f), system.acceleration(q, v, f), rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(model.energy(q, v), system.energy(q, v), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(model.mass_matrix(q), system.mass_matrix(q), rtol=1e-12)
    np.testing.assert_array_equal(model.acceleration(q[2], v[2]), model.acceleration(q, v)[2])


def test_leading_dimensions_are_kept_and_broadcast():
    model = model_of(systems.get("double_pendulum"))
    q, v = np.random.default_rng(0).normal(size=(2, 3, 4, 2))
    assert model.acceleration(q, v).shape == (3, 4, 2)
    assert model.energy(q, v).shape == (3, 4)
    assert model.mass_matrix(q).shape == (3, 4, 2, 2)
    np.testing.assert_array_equal(model.acceleration(q, [0.0, 0.0]), model.acceleration(q, np.zeros_like(q)))
    assert model.acceleration(q[:0], v[:0]).shape == (0, 4, 2)


def test_dissipation_acts_against_the_velocity():
    drag = [ModelTerm("x_dot**2/2", 0.3, 0.01), ModelTerm("abs(x_dot)", 0.2, 0.01)]
    model = spring(dissipation=drag)
    x, v = np.array([[0.5], [0.5], [0.5]]), np.array([[2.0], [-2.0], [0.0]])
    np.testing.assert_allclose(model.acceleration(x, v), -4 * x - 0.3 * v - 0.2 * np.sign(v), rtol=1e-14)
    assert model.dissipation_function.free_symbols == {sp.Symbol("x_dot", real=True)}


def test_abs_of_anything_real_can_be_differentiated_twice():
    model = LagrangianModel("x", [ModelTerm("abs(sqrt(x)*x_dot**3)", 1.0)])
    np.testing.assert_allclose(model.mass_matrix([4.0], [-0.5])[0, 0], 2.0 * 6 * 0.5)


def test_names_of_coordinates_do_not_meet_names_in_generated_code():
    names = ("sign", "numpy", "x0", "v_0", "θ1", "abs1")
    plain = ("a", "b", "c", "d", "e", "g")
    text = "{0}_dot**2+{1}_dot**2+{2}_dot**2+{3}_dot**2+{4}_dot**2+{5}_dot**2"
    other = "abs({0})*sin({1}-{2})*cos({3}*{4})*abs({5}) + sin({1}-{2})**2*cos({3}*{4})**2"
    models = [
        LagrangianModel(n, [ModelTerm(text.format(*n), 0.5), ModelTerm(other.format(*n), 1.0)])
        for n in (names, plain)
    ]
    q = np.linspace(-1.0, 1.0, 12).reshape(2, 6)
    a, b = (m.acceleration(q, q[::-1]) for m in models)
    np.testing.assert_allclose(a, b, rtol=1e-13)


def test_a_singular_point_does_not_spoil_the_others():
    model = LagrangianModel(["x", "y"], [ModelTerm("x**2*x_dot**2", 0.5), ModelTerm("y_dot**2+y", 0.5)])
    a = model.acceleration([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]])
    assert np.isnan(a[0]).all()
    np.testing.assert_allclose(a[1], [0.0, 0.5])
    one = LagrangianModel("x", [ModelTerm("x*x_dot**2", 0.5)])
    assert np.isnan(one.acceleration([[0.0], [1.0]], [[1.0], [1.0]])).tolist() == [[True], [False]]


@pytest.mark.parametrize("name", ["single_pendulum", "chaotic_pendulum", "spherical_spring_pendulum"])
def test_equations_of_motion_are_solved_for_the_accelerations(name):
    system = systems.get(name)
    model = model_of(system)
    (q,), (v,) = states(system, 1)
    f = np.arange(1.0, system.n_dof + 1)
    values = {sp.Symbol(c, real=True): x for c, x in zip(model.coordinates, q, strict=True)}
    values |= {sp.Symbol(f"{c}_dot", real=True): x for c, x in zip(model.coordinates, v, strict=True)}
    values |= {sp.Symbol(f"{c}_force", real=True): x for c, x in zip(model.coordinates, f, strict=True)}
    equations = model.equations_of_motion(forces=True)
    assert [str(e.lhs) for e in equations] == [f"{c}_dot_dot" for c in model.coordinates]
    solved = [float(e.rhs.subs(values)) for e in equations]
    np.testing.assert_allclose(solved, model.acceleration(q, v, f), rtol=1e-10)


def test_many_equations_stay_implicit():
    names = ("a", "b", "c", "d")
    model = LagrangianModel(names, [ModelTerm(f"{n}_dot**2-{n}**2", 0.5) for n in names])
    equation = model.equations_of_motion()[3]
    assert (str(equation.lhs), str(equation.rhs)) == ("1.0*d_dot_dot", "-1.0*d")


def test_lagrangian_keeps_every_digit():
    model = LagrangianModel("x", [ModelTerm("x_dot**2", 1 / 3), ModelTerm("cos(x)", 0.1)])
    floats = {float(x) for x in model.lagrangian.atoms(sp.Float)}
    assert floats == {1 / 3, 0.1}
    assert model.energy([0.0], [1.0]) == 1 / 3 - 0.1
    assert model.dissipation_function == 0


def test_table():
    model = spring(dissipation=[ModelTerm("x_dot**2/2", 0.3, 0.1), ModelTerm("abs(x_dot)", 0.1, np.nan)])
    table = model.table()
    assert table.index.name == "expression"
    assert list(table.columns) == ["kind", "coefficient", "standard_error", "lower", "upper", "z", "known"]
    assert table.kind.tolist() == ["lagrangian"] * 2 + ["dissipation"] * 2
    assert table.known.tolist() == [True, False, False, False]
    assert table.loc["x**2", "z"] == -200
    assert table.loc["x_dot**2/2", ["lower", "upper"]].tolist() == pytest.approx(
        [0.3 - 0.196, 0.3 + 0.196], abs=1e-4
    )
    assert table.loc["x_dot**2", "lower"] == table.loc["x_dot**2", "upper"] == 0.5
    assert np.isnan(table.loc[["x_dot**2", "abs(x_dot)"], "z"]).all()


def test_text():
    model = spring(
        fit=FitSummary("doubtful", 1.0, [2.0], ["noise <b>"]), dissipation=[ModelTerm("x_dot**2", 0.25, 0.1)]
    )
    assert repr(model) == (
        "<LagrangianModel of x: L = 0.5*x_dot**2 - 2.000*x**2, psi = 0.25*x_dot**2; fit doubtful>"
    )
    assert repr(model.fit) == "<fit: doubtful>"
    table = model.fit.to_frame()
    assert table[["severity", "message"]].to_numpy().tolist() == [["warning", "noise <b>"]]
    motion = model.simulate([0.1], [0.0], np.linspace(0.0, 1.0, 300))
    assert repr(motion) == "<Simulation of x: complete>"
    lines = str(model).splitlines()
    assert lines[2].split() == ["x**2", "lagrangian", "-2.000", "0.01", "-2.020", "…", "-1.980", "-200"]
    assert lines[-2:] == ["fit: doubtful", "warning: noise <b>"]
    assert "noise &lt;b&gt;" in model._repr_html_()
    assert len({len(row) for row in model.format_rows()}) == 1


def test_latex():
    terms = [ModelTerm("theta1_dot**2", 1.0, known=True), ModelTerm("x_cart*cos(theta1-θ)", -0.55771, 0.0012)]
    model = LagrangianModel(["theta1", "x_cart", "θ"], terms)
    formula = r"L = \dot{\theta}_{1}^{2} - %s \, x_{\mathrm{cart}} \cos{\left(\theta_{1} - \theta \right)}"
    assert model.latex() == formula % "0.5577"
    assert model.latex(uncertainty=True) == formula % "0.5577(12)"
    assert model.latex(digits=2) == formula.replace(r"\dot", r"1.0 \, \dot", 1) % "0.56"
    assert model._repr_latex_() == rf"$\displaystyle {formula % '0.5577'}$"
    with pytest.raises(InputError, match="digits is 0"):
        model.latex(digits=0)


def test_latex_of_names_that_look_alike_and_of_small_numbers():
    model = LagrangianModel(
        ["q1", "q_1"], [ModelTerm("q1_dot**2", 1.5e-7)], [ModelTerm("q1_dot+q_1_dot", 2.0)]
    )
    assert model.latex().splitlines()[1:3] == [
        r"L &= 1.5 \times 10^{-7} \, \dot{\mathrm{q1}}^{2} \\",
        r"\psi &= 2 \, \left(\dot{\mathrm{q1}} + \dot{\mathrm{q\_1}}\right)",
    ]


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.0, 0.001, "0.0000(10)"),
        (1e-9, 0.001, "0.0000(10)"),
        (-3.14159, 0.5, "-3.14(50)"),
        (123456789.0, 200.0, "1.2345679(20)e+08"),
        (1e-6, 1e-8, "1.000(10)e-06"),
        (5e-9, 1e-6, "0.0(10)e-06"),
        (2.5, np.nan, "2.5"),
    ],
)
def test_rounding(value, error, text):
    assert rounded(value, error, uncertainty=True) == text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(coordinates=["x_dot"]), "velocity"),
        (dict(terms=[]), "terms is empty"),
        (dict(terms=["x**2"]), r"terms\[0\] is 'x\*\*2'; expected a ModelTerm"),
        (dict(terms=[ModelTerm("y**2", 1.0)]), r"terms\[0\]: .*unknown name 'y'"),
        (
            dict(terms=[ModelTerm("x**2", 1.0), ModelTerm("x*x", 1.0)]),
            r"terms\[1\] 'x\*x' is the same as terms\[0\]",
        ),
        (dict(covariance=np.eye(3)), r"covariance has shape \(3, 3\); expected \(1, 1\)"),
        (dict(covariance=[[-1.0]]), "diagonal"),
        (dict(covariance=[[np.nan]]), "finite"),
        (dict(noise_std=[1.0, 2.0]), r"noise_std has shape \(2,\)"),
        (dict(noise_std=[-1.0]), "at least 0"),
        (dict(fit="ok"), "expected a FitSummary"),
        (dict(fit=FitSummary("ok", 1.0, [1.0, 2.0])), "physics_weight has 2"),
        (dict(provenance=3), "dictionary"),
    ],
)
def test_wrong_parts_are_refused(change, message):
    arguments = {"coordinates": ["x"], "terms": [ModelTerm("x_dot**2", 0.5, 0.1)]} | change
    with pytest.raises(InputError, match=message):
        LagrangianModel(**arguments)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ModelTerm("", 1.0), "expression"),
        (lambda: ModelTerm("x", float("nan")), "finite"),
        (lambda: ModelTerm("x", "1"), "expected a number"),
        (lambda: ModelTerm("x", True), "expected a number"),
        (lambda: ModelTerm("x", 10**400), "finite"),
        (lambda: ModelTerm("x", 1.0, -0.1), "at least 0"),
        (lambda: ModelTerm("x", 1.0, 0.1, known=True), "known coefficient"),
        (lambda: ModelTerm("x", 1.0, 0.1, known="no"), "True or False"),
        (lambda: FitSummary("good"), "'ok', 'usable' or 'doubtful'"),
        (lambda: FitSummary(warnings="text"), "sequence"),
        (lambda: FitSummary(physics_weight=3.0), "sequence"),
        (lambda: FitSummary(warnings=[3]), "expected text"),
        (lambda: FitSummary(findings="text"), "sequence"),
        (lambda: FitSummary(findings=["text"]), "expected a Finding"),
        (lambda: FitSummary(warnings=["a"], findings=[Finding.of_text("b")]), "give one of the two"),
    ],
)
def test_wrong_terms_and_summaries_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.acceleration(1.0, 2.0), r"q has shape \(\); expected \(..., 1\)"),
        (lambda m: m.acceleration([1.0, 2.0], [1.0]), r"the last axis for x"),
        (
            lambda m: m.acceleration([[1.0]] * 2, [[1.0]] * 3),
            r"cannot be broadcast: q \(2, 1\), qdot \(3, 1\)",
        ),
        (lambda m: m.acceleration([1.0], [1.0], forces=[1.0, 2.0]), "forces has shape"),
        (lambda m: m.energy(["a"], [1.0]), "real numbers"),
        (lambda m: m.mass_matrix([[1.0, 2.0]]), "q has shape"),
        (lambda m: m.simulate([1.0, 2.0], [0.0], [0.0, 1.0]), "q0 is"),
        (lambda m: m.simulate([1.0], [np.inf], [0.0, 1.0]), "qdot0 is"),
        (lambda m: m.simulate([1.0], [0.0], [1.0, 0.0]), "increasing"),
        (
            lambda m: m.simulate([1.0], [0.0], [0.0, 1.0], lambda t: [1.0, 2.0]),
            r"forces\(time\) has shape \(2,\)",
        ),
    ],
)
def test_wrong_states_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call(spring())


def test_simulate():
    t = np.linspace(0.0, 5.0, 51)
    run = spring().simulate([1.0], [0.0], t)
    np.testing.assert_allclose(run.q[:, 0], np.cos(2 * t), atol=1e-7)
    driven = spring().simulate([0.0], [0.0], t, forces=np.full((51, 1), 4.0))
    np.testing.assert_allclose(driven.q[:, 0], 1 - np.cos(2 * t), atol=1e-7)
    again = spring().simulate([0.0], [0.0], t, forces=lambda time: np.array([4.0]))
    np.testing.assert_allclose(again.q, driven.q, atol=1e-7)


def test_simulation_stops_with_a_reason():
    t = np.linspace(0.0, 5.0, 51)
    fleeing = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**4", 1.0)])
    assert "blow-up" in fleeing.simulate([1.0], [1.0], t).reason
    empty = LagrangianModel(["x", "y"], [ModelTerm("x_dot**2", 0.5), ModelTerm("y**2", 1.0)])
    assert "singular mass matrix" in empty.simulate([1.0, 1.0], [0.0, 0.0], t).reason
    assert spring().simulate([1.0], [0.0], t, max_steps=3).reason.startswith("step limit")


def test_pickle_and_arrays_are_read_only():
    model = spring(covariance=[[0.01]], noise_std=[0.1])
    model.acceleration([1.0], [0.0])
    law = repr((model.symmetries, model.simple_constants))  # a drift may be NaN
    copy = pickle.loads(pickle.dumps(model))
    assert copy.terms == model.terms
    # not computed again
    assert repr((copy.__dict__["symmetries"], copy.__dict__["simple_constants"])) == law
    np.testing.assert_array_equal(copy.acceleration([1.0], [0.0]), [-4.0])
    with pytest.raises(ValueError, match="read-only"):
        model.covariance[0, 0] = 1.0


@pytest.mark.parametrize(
    "name", ["double_pendulum", pytest.param("spherical_spring_pendulum", marks=pytest.mark.thorough)]
)
def test_forecast_errors_of_the_true_model_are_those_expected(name):
    system = systems.get(name)
    data = systems.generate(name, noise=0.05, trials=3, duration=12.0, seed=2, missing=0.1, irregular=True)
    result = model_of(system).validate(data)
    assert result.n_starts == 33
    assert {trace.status for trace in result.traces} == {"ok"}
    np.testing.assert_allclose(result.rms, result.expected_rms, rtol=0.12)
    assert (result.rms_over_noise < 1.5).all()
    assert result.valid_time == 1.0


def test_forecast_of_a_wrong_model_is_worse():
    data = systems.generate("single_pendulum", noise=0.02, trials=2, duration=8.0, seed=1)
    terms = [ModelTerm("theta_dot**2", 0.5), ModelTerm("cos(theta)", 9.81 * 0.7)]
    result = LagrangianModel(["theta"], terms).validate(data, horizon=2.0)
    assert (result.rms > 3 * result.expected_rms).all()
    assert result.by_trial().keys() == {"single_pendulum-0", "single_pendulum-1"}


def test_forecast_starts_where_the_documentation_says():
    t = np.arange(0.0, 5.01, 0.01)
    result = spring().validate(Trajectory(t, np.cos(2 * t), coordinates=["x"]), horizon=2.0, window=0.5)
    assert [trace.origin for trace in result.traces] == pytest.approx([0.5, 2.5])
    trace = result.traces[0]
    assert (trace.t > 0.5).all()
    assert trace.t[-1] == pytest.approx(2.5)
    np.testing.assert_allclose(trace.forecast, trace.measured, atol=1e-4)


def test_divergence_is_recorded_not_raised():
    t = np.arange(0.0, 6.0, 0.02)
    data = Trajectory(t, np.cos(2 * t), coordinates=["x"])
    fleeing = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**4", 50.0)])
    singular = LagrangianModel("x", [ModelTerm("x", 0.5)])
    for model in (fleeing, singular):
        result = model.validate(data)
        assert result.n_diverged == result.n_starts > 0
        assert np.isinf(result.rms).all()
        text = json.dumps(result.to_dict(), allow_nan=False)
        assert json.loads(text)["rms"] == [None]
        assert result.traces[0].reason


def test_angles_of_the_discovery_are_unwrapped():
    t = np.arange(0.0, 4.0, 0.01)
    wrapped = np.mod(3.0 * t + np.pi, 2 * np.pi) - np.pi
    model = LagrangianModel(
        "phi", [ModelTerm("phi_dot**2", 0.5)], provenance={"options": {"angles": ["phi"]}}
    )
    result = model.validate(Trajectory(t, wrapped, coordinates=["phi"]))
    assert result.rms[0] < 1e-6


def test_forecasts_that_are_not_possible():
    t = np.arange(0.0, 3.0, 0.01)
    good = Trajectory(t, np.cos(2 * t), coordinates=["x"], name="good")
    short = Trajectory(t[:20], np.cos(2 * t[:20]), coordinates=["x"], name="short")
    result = spring().validate([good, short], horizon=1.0)
    assert [name for name, reason in result.skipped if "too short" in reason] == ["short"]
    with pytest.raises(InputError, match=r"the longest lasts 2\.99 s"):
        spring().validate(good, horizon=30.0)
    with pytest.raises(InputError, match="horizon is -1"):
        spring().validate(good, horizon=-1)
    with pytest.raises(InputError, match="tolerance is nan"):
        spring().validate(good, tolerance=float("nan"))
    with pytest.raises(InputError, match="coordinates y; the model has x"):
        spring().validate(Trajectory(t, t, coordinates=["y"]))


def test_measured_double_pendulum_is_forecast_in_seconds():
    from importlib.resources import files

    path = files("leastaction") / "datasets" / "double_pendulum.csv.gz"
    data = Trajectories(io.read_csv(str(path), ["theta1", "theta2"]))
    coefficients = {
        "theta1_dot**2": 1.0,
        "theta2_dot**2": 0.5568,
        "theta1_dot*theta2_dot*cos(theta1-theta2)": 0.9827,
        "cos(theta1)": -117.92,
        "cos(theta2)": -55.81,
    }
    model = LagrangianModel(data.coordinates, [ModelTerm(k, c) for k, c in coefficients.items()])
    start = time.perf_counter()
    result = model.validate(data)
    assert time.perf_counter() - start < 20
    assert result.n_starts == 52
    assert (result.rms < 0.02).all()


def test_diagnostics_show_the_findings_of_the_fit():
    diagnostics = spring_with_curve().diagnostics
    assert diagnostics is not None
    assert diagnostics.notes == ()
    note = Finding.of_text("a bump", "note")
    fit = FitSummary("doubtful", findings=[Finding.of_text("the shaft is bent"), note])
    model = replace(spring_with_curve(), fit=fit)
    assert model.fit.warnings == ("the shaft is bent",)
    assert model.fit.notes == model.diagnostics.notes == ("a bump",)
    assert model.diagnostics.findings == fit.findings
    assert replace(model, fit=FitSummary()).diagnostics.notes == ()
    assert replace(fit, status="ok").findings == fit.findings


def pendulum():
    return LagrangianModel(
        ["theta", "φ"],
        [ModelTerm("theta_dot**2 + φ_dot**2", 0.1 + 0.2, 0.01), ModelTerm("cos(theta)", 9.81, known=True)],
        [ModelTerm("abs(theta_dot)", 0.02, float("nan"))],
        covariance=[[1e-4, 1e-6], [1e-6, 3e-4]],
        noise_std=[0.001, np.nan],
        fit=FitSummary("doubtful", np.inf, [1e6, np.nan], ["the library\ncannot explain the data"]),
        provenance={
            "version": "0.1.0",
            "options": {"angles": ("theta",), "seed": np.int64(3)},
            "w": np.float64("nan"),
        },
    )


@pytest.fixture
def document():
    return pendulum().to_dict()


def test_round_trip(tmp_path):
    model = pendulum()
    model.save(tmp_path / "model.json")
    again = load(tmp_path / "model.json")
    assert again.to_dict() == model.to_dict()
    assert again.terms == model.terms
    assert again.coordinates == ("theta", "φ")
    assert np.isnan(again.dissipation[0].standard_error)
    assert np.isnan(again.noise_std[1])
    assert again.diagnostics is None
    np.testing.assert_array_equal(again.covariance, model.covariance)
    assert again.provenance == {"version": "0.1.0", "options": {"angles": ["theta"], "seed": 3}, "w": None}
    assert os.listdir(tmp_path) == ["model.json"]


# as version 0.1.0 wrote it
SCHEMA_1 = """{
 "schema": 1,
 "coordinates": ["x"],
 "terms": [
  {"expression": "x_dot**2", "coefficient": 0.5, "standard_error": 0.0, "known": true},
  {"expression": "x**2", "coefficient": -2.0, "standard_error": 0.01, "known": false}
 ],
 "dissipation": [],
 "noise_std": [0.01],
 "fit": {
  "status": "doubtful",
  "chi2_per_sample": 1.4,
  "physics_weight": [1200.0],
  "warnings": ["the library seems to lack x**4: with it, 2 free terms explain the motion; add it"]
 },
 "provenance": {"version": "0.1.0"},
 "covariance": [[0.0001]]
}
"""


def test_a_file_of_schema_1_is_read_and_written_as_schema_2(tmp_path):
    (tmp_path / "old.json").write_text(SCHEMA_1, encoding="utf-8")
    old = load(tmp_path / "old.json")
    sentence = json.loads(SCHEMA_1)["fit"]["warnings"][0]
    assert old.fit.warnings == (sentence,)
    assert old.fit.findings == (Finding("text", "warning", message=sentence),)
    old.save(tmp_path / "new.json")
    new = json.loads((tmp_path / "new.json").read_text(encoding="utf-8"))
    assert new["schema"] == 2
    assert new["fit"]["warnings"] == [sentence]
    assert [finding["code"] for finding in new["fit"]["findings"]] == ["text"]
    assert load(tmp_path / "new.json").fit == old.fit
    stale = json.loads(SCHEMA_1)
    stale["fit"]["findings"] = []  # that schema has none
    with pytest.raises(InputError, match="fit has the unknown entry 'findings'"):
        LagrangianModel.from_dict(stale)


def test_findings_are_kept_in_the_file_and_warnings_are_read_off_them(tmp_path):
    findings = (find("late-forces", delay=0.03, half_a_sample=False, gain=90.0), find("knots-not-settled"))
    fit = FitSummary("doubtful", 1.0, [1.0, 1.0], findings=findings)
    replace(pendulum(), fit=fit).save(tmp_path / "model.json")
    document = json.loads((tmp_path / "model.json").read_text(encoding="utf-8"))
    assert document["fit"]["warnings"] == [str(findings[0])]
    assert document["fit"]["findings"][0]["values"] == {"delay": 0.03, "half_a_sample": False, "gain": 90.0}
    document["fit"]["warnings"] = ["changed by hand"]
    again = LagrangianModel.from_dict(document).fit
    assert again.findings == findings
    assert again.warnings == (str(findings[0]),)
    assert again.notes == (str(findings[1]),)


def test_schema_of_the_file(tmp_path):
    path = tmp_path / "model.json"
    pendulum().save(path)

    def refuse(name):
        raise AssertionError(name)

    saved = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    expected = [
        "schema",
        "coordinates",
        "terms",
        "dissipation",
        "noise_std",
        "fit",
        "provenance",
        "covariance",
    ]
    assert list(saved) == expected
    assert saved["schema"] == 2
    term = {"expression": "cos(theta)", "coefficient": 9.81, "standard_error": 0.0, "known": True}
    assert saved["terms"][1] == term
    assert saved["dissipation"][0]["standard_error"] is None
    fit = {"status": "doubtful", "chi2_per_sample": None, "physics_weight": [1e6, None]}
    assert {k: saved["fit"][k] for k in fit} == fit


def test_covariance_is_optional(document):
    del document["covariance"]
    assert LagrangianModel.from_dict(document).covariance is None


def test_a_failing_save_leaves_the_old_file(tmp_path):
    path = tmp_path / "model.json"
    pendulum().save(path)
    before = path.read_bytes()
    bad = LagrangianModel("x", [ModelTerm("x_dot**2", 1.0)], provenance={"options": {"f": print}})
    with pytest.raises(InputError, match=r"provenance.options.f is of type builtin_function"):
        bad.save(path)
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="is a directory"):
        pendulum().save(tmp_path)


@pytest.mark.parametrize("provenance", [{1: 2}, {"a": {"b": b"bytes"}}, {"a": [[[[]]] * 3]} | {"b": 1j}])
def test_provenance_must_be_json(provenance):
    with pytest.raises(InputError, match="provenance"):
        LagrangianModel("x", [ModelTerm("x_dot**2", 1.0)], provenance=provenance).to_dict()


def put(path, value):
    def change(document):
        *parents, last = path
        for key in parents:
            document = document[key]
        document[last] = value

    return change


def drop(*path):
    def change(document):
        *parents, last = path
        for key in parents:
            document = document[key]
        del document[last]

    return change


def nested(depth):
    value = 0
    for _ in range(depth):
        value = [value]
    return value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put(["schema"], 3), "newer version of leastaction .* upgrade"),
        (put(["schema"], True), "schema is True; expected a whole number up to 2"),
        (put(["schema"], "1"), "schema is '1'"),
        (drop("schema"), "not a leastaction model"),
        (drop("terms"), "no entry 'terms'"),
        (put(["more"], 1), "unknown entry 'more'"),
        (put(["coordinates"], "theta"), "coordinates is 'theta'; expected a list"),
        (put(["coordinates"], []), "coordinates is empty"),
        (put(["coordinates"], [1, 2]), r"coordinates\[0\] is 1; expected text"),
        (put(["coordinates"], ["__class__", "b"]), "coordinate name '__class__'"),
        (put(["coordinates"], ["theta; import os", "b"]), "is not a name"),
        (put(["coordinates"], ["a" * 10**6, "b"]), "too long"),
        (put(["coordinates"], [f"a{i}" for i in range(1000)]), "at most 64"),
        (put(["coordinates"], ["theta", "φ", "x"]), "physics_weight has 2"),
        (put(["terms"], {}), "terms is {}; expected a list"),
        (put(["terms"], []), "terms is empty"),
        (put(["terms"], [3]), r"terms\[0\] is 3; expected an object"),
        (put(["terms"], [{}] * (MAX_TERMS + 1)), "at most 1000"),
        (drop("terms", 0, "known"), r"terms\[0\] has no entry 'known'"),
        (put(["terms", 0, "extra"], 1), r"terms\[0\] has the unknown entry 'extra'"),
        (put(["terms", 0, "known"], 0), r"terms\[0\].known is 0; expected true or false"),
        (put(["terms", 1, "coefficient"], "1.0"), r"terms\[1\].coefficient is '1.0'; expected a number"),
        (put(["terms", 1, "coefficient"], None), r"terms\[1\].coefficient is None"),
        (put(["terms", 1, "coefficient"], True), r"terms\[1\].coefficient is True"),
        (put(["terms", 1, "coefficient"], float("nan")), "finite"),
        (put(["terms", 1, "coefficient"], 10**400), "finite"),
        (put(["terms", 1, "standard_error"], 0.1), r"terms\[1\]: .*known coefficient"),
        (put(["terms", 0, "standard_error"], -0.1), "at least 0"),
        (put(["terms", 0, "expression"], ["x"]), r"terms\[0\].expression is \['x'\]; expected text"),
        (put(["terms", 0, "expression"], "__import__('os').system('x')"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "theta.__class__"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "theta[0]"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "open(theta)"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "lambda: theta"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "9**9**9**9"), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "(" * 5000 + "theta" + ")" * 5000), r"terms\[0\]: cannot read"),
        (put(["terms", 0, "expression"], "cos(theta)"), "is the same as"),
        (put(["dissipation", 0, "expression"], "psi"), r"dissipation\[0\]: .*'psi'"),
        (put(["noise_std"], [0.1]), "noise_std has shape"),
        (put(["noise_std", 0], "a"), r"noise_std\[0\] is 'a'"),
        (put(["fit"], []), "fit is"),
        (put(["fit", "status"], "fine"), "'ok', 'usable' or 'doubtful'"),
        (put(["fit", "status"], ["ok"]), "'ok', 'usable' or 'doubtful'"),
        (put(["fit", "chi2_per_sample"], "1"), "fit.chi2_per_sample"),
        (put(["fit", "physics_weight"], [1.0]), "physics_weight has 1"),
        (put(["fit", "warnings"], "text"), "fit.warnings is 'text'; expected a list"),
        (put(["fit", "warnings"], [1]), r"fit.warnings\[0\] is 1; expected text"),
        (put(["fit", "findings"], "text"), "fit.findings is 'text'; expected a list"),
        (put(["fit", "findings"], ["text"]), r"fit.findings\[0\] is 'text'; expected an object with code"),
        (put(["fit", "findings", 0, "code"], "Not a code"), r"fit.findings\[0\]: the code is 'Not a code'"),
        (put(["fit", "findings", 0, "severity"], "fatal"), r"fit.findings\[0\]: the severity is 'fatal'"),
        (put(["fit", "findings", 0, "subject"], "x"), r"fit.findings\[0\].subject is 'x'; expected a list"),
        (put(["fit", "findings", 0, "subject"], [1]), r"fit.findings\[0\]: subject\[0\] is 1; expected text"),
        (
            put(["fit", "findings", 0, "values"], [1]),
            r"findings\[0\]: values is \[1\]; expected a mapping",
        ),
        (
            put(["fit", "findings", 0, "values", "a"], {}),
            r"findings\[0\]: values.a is {}; expected",
        ),
        (put(["fit", "findings", 0, "values", "a"], [[1]]), r"fit.findings\[0\]: values.a\[0\] is \[1\]"),
        (put(["fit", "findings", 0, "message"], None), r"fit.findings\[0\]: message is None; expected text"),
        (put(["fit", "findings", 0, "extra"], 1), r"fit.findings\[0\] has the unknown entry 'extra'"),
        (drop("fit", "findings"), "fit has no entry 'findings'"),
        (put(["provenance"], None), "provenance is None"),
        (put(["provenance", "deep"], nested(100)), "nested"),
        (put(["covariance"], [[1.0]]), "covariance has shape"),
        (put(["covariance"], [[1.0, 2.0], [1.0]]), r"covariance\[1\] has 1 entries"),
        (put(["covariance"], [[1.0, 0.5], [0.2, 1.0]]), "not symmetric"),
        (put(["covariance", 0, 0], None), r"covariance\[0\]\[0\] is None"),
    ],
)
def test_wrong_documents_are_refused_with_file_and_place(document, change, message, tmp_path):
    change(document)
    with pytest.raises(InputError, match=message) as caught:
        LagrangianModel.from_dict(copy.deepcopy(document), "model.json")
    assert str(caught.value).startswith("model.json: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is empty"),
        (b"[]", "not a leastaction model"),
        (b"null", "not a leastaction model"),
        (b'{"schema": 1,}', "line 1, column"),
        (b'{"schema": 1, "schema": 2}', "'schema' occurs twice"),
        (b'{"schema": NaN}', "NaN is not a number"),
        (b'{"schema": -Infinity}', "-Infinity is not a number"),
        (b'{"schema": ' + b"1" * 10_000 + b"}", "too many digits"),
        (b"[" * 100_000, "nested too deeply"),
        (b"[" * 500 + b"]" * 500, "nested too deeply"),
        (b"\xff\xfe{}", "not UTF-8"),
        (b" " * (MAX_BYTES + 1), "larger than 10 MB"),
    ],
    ids=range(12),
)
def test_wrong_files_are_refused(tmp_path, data, message):
    path = tmp_path / "model.json"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_cut_short_anywhere_is_refused(tmp_path):
    path = tmp_path / "model.json"
    pendulum().save(path)
    data = path.read_bytes()
    for size in range(0, len(data) - 2, 7):
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match=r"model\.json"):
            load(path)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load(tmp_path / "none.json")
    with pytest.raises(InputError, match="path"):
        load(3)


# ------------------------ how objects show themselves: cards in notebooks and terminals, plots, data frames
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
    return replace(spring_with_curve(friction=0.1), fit=FitSummary("doubtful", 1.1, [1e6], findings=findings))


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
        spring_with_curve().simulate([1.0], [0.0], T),
        reason=HOSTILE,
        status="stopped",
        coordinates=(HOSTILE,),
    ),
    "forecast": lambda: replace(
        spring_with_curve().validate(la.Trajectory(T, np.cos(2 * T), coordinates=["x"])),
        skipped=((HOSTILE, HOSTILE),),
    ),
    "trade-off": lambda: TradeOff([PathPoint((HOSTILE,), 0.0, 0.0, True)]),
    "group": lambda: replace(
        spring_with_curve(),
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
    motion = spring_with_curve().simulate([1.0], [0.0], np.linspace(0.0, math.pi, 5))
    assert motion._card().rows[1] == ("x", "1", "1", "-1", "1")
    result = spring_with_curve().validate(la.Trajectory(T, np.cos(2 * T), coordinates=["x"]), horizon=1.0)
    assert result._card().rows == result.format_rows()
    assert f"{result.n_starts} starts in 1 trial, 0 diverged" in result._repr_html_()
    fit = FitSummary("doubtful", 1.02, warnings=["bent"])._card()
    assert (fit.title, fit.notes) == ("fit: doubtful", ["warning: bent"])
    assert "chi2 per sample: 1.02, 1 is expected" in fit.lines
    through = FitSummary("usable", 2.8e-18)._card()
    assert "chi2 per sample: 2.8e-18, the curve passes through the samples" in through.lines
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
    model = spring_with_curve()
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
    model = spring_with_curve()  # x is an angle there
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
    model = spring_with_curve(name="first")
    display = model.diagnostics.plot(trial="first")
    measured, fitted = display.lines_[0]
    np.testing.assert_array_equal(measured.get_ydata(), model.diagnostics.trajectories[0].q[:, 0])
    np.testing.assert_array_equal(fitted.get_ydata(), model.diagnostics.curve()[0][:, 0])
    with pytest.raises(la.InputError, match="lost"):
        model.diagnostics.plot(trial="lost")


def test_plot_of_coefficients():
    model = replace(
        spring_with_curve(),
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


def test_plot_of_a_library_shows_what_each_candidate_contains():
    terms = ["x_dot**2", "x_dot*y_dot*cos(y)", "x**2"]
    library = la.Library(terms, ["x", "y"], dissipation=["y_dot**2"])
    display = library.plot()
    assert [label.get_text() for label in display.ax_.get_yticklabels()] == ["x", "y", "x_dot", "y_dot"]
    drawn = {line.get_label(): {*map(tuple, line.get_xydata().tolist())} for line in display.lines_[0]}
    assert drawn == {
        "with velocities": {(1, 2), (2, 1), (2, 2), (2, 3)},
        "potentials": {(3, 0)},
        "dissipation": {(4, 3)},
    }
    assert display.ax_.get_title() == "Library of x, y: 3 terms"


def test_trade_off():
    curve = spring_with_curve().diagnostics.trade_off
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
    model = spring_with_curve(friction=0.1)
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
    for thing in (
        run(),
        spring_with_curve(),
        spring_with_curve().simulate([1.0], [0.0], T),
        spring_with_curve().diagnostics,
    ):
        with pytest.raises(ImportError, match=r"plot\(\) needs Matplotlib; .*'leastaction\[plot\]'"):
            thing.plot()
    for thing in (
        run(),
        spring_with_curve(),
        spring_with_curve().simulate([1.0], [0.0], T),
        spring_with_curve().diagnostics.trade_off,
    ):
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
    friction = spring_with_curve(friction=0.1).formula().splitlines()
    assert friction[1] == "psi = 0.0500*x_dot**2"


def test_typeset_reads_as_text_and_as_html():
    card = Card("t", [Typeset("x^2", Notation(["x"]).term("x**2"))])
    assert card.text().splitlines()[1] == "x^2"
    assert "<msup>" in card.html()


# ------------------------------------------------------------------------ dry friction, as it was given
def test_dry_friction_is_shown_as_it_was_given():
    """A person reads abs(x_dot); numbers, exports and the file have the root that was fitted."""
    root = "sqrt(x_dot**2 + 1/2500)"
    friction = [ModelTerm(root, 0.15, 0.01), ModelTerm("sqrt(x_dot**2 + 1)", 0.2, 0.01)]
    findings = [
        find("friction-smoothed", ["x_dot"], widths=[0.02]),
        Finding("other", "warning", (root,), {}, f"{root} is hardly determined"),
    ]
    fit = FitSummary("doubtful", 1.0, [1.0], findings=findings)
    points = [PathPoint((root, "x**2"), 0.0, 0.0, True)]
    diagnostics = replace(spring_with_curve().diagnostics, path=tuple(points), findings=tuple(findings))
    model = replace(spring(), dissipation=tuple(friction), fit=fit, diagnostics=diagnostics)
    note = "abs() of velocities is smoothed near zero (x_dot below 0.02)"
    assert model.formula().splitlines()[1] == "psi = 0.150*abs(x_dot) + 0.200*sqrt(x_dot**2 + 1)"
    assert [row[0] for row in model.format_rows()[3:]] == ["abs(x_dot)", "sqrt(x_dot**2 + 1)"]
    assert list(model.table().index[2:]) == ["abs(x_dot)", "sqrt(x_dot**2 + 1)"]
    assert str(model).count("smoothed") == 1
    assert str(model).splitlines()[-1] == f"note: {note}"
    assert "psi = 0.150*abs(x_dot) + 0.200*sqrt" in repr(model)
    assert r"\left|{\dot{x}}\right| + 0.200 \, \sqrt{\dot{x}^{2} + 1}" in model.latex()
    page = model._repr_html_()
    assert "2500" not in page
    assert page.count(note) == 1
    labels = [label.get_text() for label in model.plot().ax_.get_yticklabels()]
    assert labels[2:] == ["0.150(10) · abs(x_dot)", "0.200(10) · sqrt(x_dot**2 + 1)"]
    assert list(model.diagnostics.trade_off.to_frame()["terms"]) == ["abs(x_dot); x**2"]
    assert "2500" not in model.diagnostics.trade_off._repr_html_()
    # what computes
    assert model.dissipation_function.has(sp.sqrt(sp.Symbol("x_dot", real=True) ** 2 + sp.Rational(1, 2500)))
    saved = model.to_dict()
    assert saved["dissipation"][0]["expression"] == root
    assert saved["fit"]["warnings"] == [f"{root} is hardly determined"]
    without = replace(model, dissipation=tuple(friction[1:]))
    assert "smoothed" not in str(without)
