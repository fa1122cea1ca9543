"""The form of the law: terms with unknown numbers that would help, and smooth changes of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import leastaction as la
from helpers import free_motions
from leastaction.diagnosis import families, smooth_changes
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.fit import Fit
from leastaction.findings import find
from leastaction.selection.search import run_search
from leastaction.selection.search_state import begin_search

POWERS = ["x_dot**2", "x", "x**2", "x**3", "x**4"]
STARTS = (0.5, 0.9, 1.6)


def morse(x):
    return 6.0 * (np.exp(-2.4 * x) - np.exp(-1.2 * x))


# ------------------------------ families: they are named, and lead to the law when they are added
def _named(model: la.LagrangianModel) -> tuple[str, ...]:
    """Candidates with unknown numbers that the findings propose."""
    for finding in model.fit.findings:
        texts = finding.subject if finding.code == "missing-term" else finding.values.get("family", ())
        if any("{" in text for text in texts):
            return tuple(texts)
    return ()


@pytest.mark.parametrize(
    ("force", "starts", "texts", "numbers"),
    [
        (
            morse,
            STARTS,
            ("exp(-{a}*x)", "exp(-2*{a}*x)"),
            {"a": 1.2},
        ),
        (
            lambda x: -2.0 * x / (x**2 + 0.04) ** 1.5,
            STARTS,
            ("1/sqrt((x-{p})**2+{h}**2)",),
            {"p": 0.0, "h": 0.2},
        ),
    ],
    ids=["Morse", "soft Coulomb"],
)
@pytest.mark.thorough
def test_the_terms_that_are_named_lead_to_the_law(force, starts, texts, numbers):
    runs = free_motions(force, starts)
    doubtful = la.discover(runs, POWERS, known={"x_dot**2": 0.5})
    assert doubtful.fit.status == "doubtful"
    assert _named(doubtful) == texts
    assert all(text in " ".join(doubtful.fit.warnings) for text in texts)
    model = la.discover(runs, ["x_dot**2", "x", *texts], known={"x_dot**2": 0.5})
    # what the data leave open beyond the law may still be told
    assert {f.code for f in model.fit.findings if f.severity == "warning"} <= {"form-open"}
    assert {shape.name for shape in model.shapes} == {*numbers}
    for shape in model.shapes:
        assert abs(abs(shape.value) - numbers[shape.name]) < 4.0 * shape.standard_error
    assert {term.written for term in model.terms} == {"x_dot**2", *texts}


@pytest.fixture(scope="module")
def helped():
    """What a search of powers for a Morse oscillator was asked for, and what it tried."""
    asked: list[tuple[Any, ...]] = []
    tried: dict[str, list[Any]] = {"best_families": [], "searched_with": []}
    real = families._helpful
    with pytest.MonkeyPatch.context() as patch:

        def helpful(search, kinetic):
            asked.append((search, kinetic))
            return real(search, kinetic)

        patch.setattr(families, "_helpful", helpful)
        for name, kept in tried.items():
            patch.setattr(families, name, recorded(getattr(families, name), kept))
        model = la.discover(free_motions(morse, STARTS), POWERS, known={"x_dot**2": 0.5})
    assert _named(model)
    return asked[-1], tried


def recorded(function, kept: list[Any]):
    """A function that keeps its answers; families come one after another and are listed."""
    all_at_once = function is families.best_families

    def run(*args):
        found = function(*args)
        kept.append(list(found) if all_at_once else found)
        return kept[-1]

    return run


@pytest.mark.parametrize(
    ("condition", "answer"),
    [
        (None, None),
        ("equations_hold", lambda fit: False),
        ("doubts_about_the_form", lambda *_, **__: [find("form-open", kind="potential", open=0.2)]),
        ("value", lambda fit: 0.0),
    ],
    ids=["all are met", "equations do not hold", "form still open", "no likelier"],
)
def test_nothing_is_named_where_no_family_helps(condition, answer, helped, monkeypatch):
    """Each condition by itself keeps a family from being named that is named otherwise."""
    asked, tried = helped
    for name, kept in tried.items():  # the same again, in the same sequence
        again, real = iter(kept), getattr(families, name)
        monkeypatch.setattr(families, name, lambda *args, _a=again, _r=real: next(_a, None) or _r(*args))
    if condition is not None:
        monkeypatch.setattr(families, condition, answer)
    assert (families._helpful(*asked) is None) == (condition is not None)


# -------------------------------------- several coordinates: a short law instead of its long imitation
def orbits(potential_slope, starts, noise: float = 1e-3) -> la.Trajectories:
    """Motions of a point of mass one in the plane under a central force."""
    t, rng, out = np.arange(0.0, 8.0, 0.02), np.random.default_rng(5), []

    def rates(_, state):
        r = np.hypot(state[0], state[1])
        return [state[2], state[3], *(-potential_slope(r) * state[:2] / r)]

    for start in starts:
        states = solve_ivp(rates, (0.0, t[-1]), start, t_eval=t, rtol=1e-10, atol=1e-10).y.T
        out.append(
            la.Trajectory(t, states[:, :2] + rng.normal(0.0, noise, (t.size, 2)), coordinates=["x", "y"])
        )
    return la.Trajectories(out)


@pytest.mark.thorough
def test_a_long_law_of_several_coordinates_is_compared_with_a_short_one():
    """A well, 3 exp(-r**2/2) in L, that many powers imitate."""
    starts = [(1.1, 0.0, 0.2, 0.9), (0.4, 0.6, -1.0, 0.4), (-0.9, 0.8, 0.3, 0.1)]
    runs = orbits(lambda r: 3.0 * r * np.exp(-0.5 * r**2), starts)
    library = la.Library.mechanical(["x", "y"])
    search = run_search(begin_search(build_problem(runs, Request(library, {"x_dot**2": 0.5}))))
    (finding,) = families.simpler_form(search)
    assert finding.values["family"] == ("exp(-{a}*(x**2+y**2))",)
    assert finding.values["free_terms"] < finding.values["instead_of"]
    (number,) = finding.values["numbers"]
    assert float(number.removeprefix("a = ")) == pytest.approx(0.5, rel=0.05)


# ---------------------------- time: a law that depends on it is named as such, and only such a law
@pytest.mark.parametrize(
    ("force", "texts", "numbers"),
    [
        (lambda x, t: -4.0 * x + 1.5 * np.cos(3.3 * t), {"x*cos({w}*t)"}, {"w": 3.3}),
        (lambda x, t: -4.0 * x * (1.0 + 0.3 * np.sin(3.1 * t)), {"x**2*sin({w}*t)"}, {"w": 3.1}),
        (lambda x, t: -4.0 * x * np.exp(-0.05 * t), {"x**2*exp(-{a}*t)"}, {"a": 0.05}),
        (
            lambda x, t: -4.0 * x + np.cos(3.3 * t) + 0.8 * np.cos(5.2 * t),
            {"x*cos({w}*t)", "x*cos({w1}*t)"},
            {"w": 3.3, "w1": 5.2},
        ),
    ],
    ids=["forced", "parametric", "softening", "two frequencies"],
)
@pytest.mark.thorough
def test_a_law_that_depends_on_time_is_named(force, texts, numbers):
    runs = free_motions(force, STARTS, timed=True)
    doubtful = la.discover(runs, POWERS, known={"x_dot**2": 0.5})
    (finding,) = [f for f in doubtful.fit.findings if f.code == "time-dependent"]
    found = dict(pair.split(" = ") for pair in finding.values["numbers"])
    # the frequencies are named in the sequence in which they are found
    assert sorted(map(float, found.values())) == pytest.approx(sorted(numbers.values()), rel=0.01)
    assert {*finding.subject} == texts
    model = la.discover(runs, ["x_dot**2", "x**2", *texts], known={"x_dot**2": 0.5})
    assert {term.written for term in model.terms if "t)" in term.written} == texts


@pytest.mark.thorough
def test_a_law_that_lacks_a_term_is_not_said_to_depend_on_time():
    """What is missing repeats with the motion, and so does a wave; it leaves a doubt about the form."""
    runs = free_motions(lambda x: -9.0 * x**3 * np.exp(-x * x) - 2.0 * np.sin(3.0 * x), (0.6, 1.0, 1.6))
    model = la.discover(runs, POWERS, known={"x_dot**2": 0.5})
    assert model.fit.status == "doubtful"
    assert "time-dependent" not in {f.code for f in model.fit.findings}


# ------------------- smooth changes: right laws pass, and laws that the library cannot write do not
def _codes(model: la.LagrangianModel) -> list[str]:
    return [f.code for f in model.fit.findings if f.code.startswith("form-")]


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_a_right_law_passes(noise):
    runs = free_motions(lambda x: -2.0 * x - 4.0 * x**3, noise=noise)
    model = la.discover(runs, la.Library.mechanical("x"), known={"x_dot**2": 0.5})
    assert {t.expression for t in model.terms} == {"x_dot**2", "x**2", "x**4"}
    assert model.fit.status == "ok", model.fit.warnings


def test_an_imitation_is_not_ok():
    """√|x| cannot be written by powers: they imitate it."""
    runs = free_motions(lambda x: -4.5 * np.sign(x) * np.sqrt(abs(x)), noise=0.03)
    model = la.discover(runs, ["x_dot**2", "x**2", "x**4"], known={"x_dot**2": 0.5})
    assert model.fit.status == "doubtful"


def test_data_that_leave_the_form_open_are_told(monkeypatch: pytest.MonkeyPatch):
    """The whole motion is within the noise of a parabola: what the force is beyond it, nobody knows."""
    runs = free_motions(lambda x: -np.sin(3.0 * x), noise=0.1, starts=(0.9,))
    held: list[Fit] = []
    real = smooth_changes.smooth_changes
    monkeypatch.setattr(smooth_changes, "smooth_changes", lambda fit: (held.append(fit), real(fit))[1])
    la.discover(runs, ["x_dot**2", "cos(3*x)"], known={"x_dot**2": 0.5})
    few = real(held[0])[0]
    held.clear()
    la.discover(
        free_motions(lambda x: -np.sin(3.0 * x), noise=0.001, starts=(0.5, 0.7, 0.9)),
        ["x_dot**2", "cos(3*x)"],
        known={"x_dot**2": 0.5},
    )
    many = real(held[0])[0]
    assert many.spread < 0.05 * few.spread


def test_for_the_true_law_the_gain_is_no_more_than_chance():
    """−2 log likelihood falls by χ² with the degrees of freedom of the change, or by less."""
    gains, freedom = [], []
    held: list[Fit] = []
    for seed in range(6):
        runs = free_motions(lambda x: -2.0 * x, noise=0.05, starts=(1.0,), seed=seed)
        held.clear()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                "leastaction.diagnosis.verdict.doubts_about_the_form",
                lambda fit, *_, **__: held.append(fit) or [],
            )
            la.discover(runs, ["x_dot**2", "x**2"], known={"x_dot**2": 0.5})
        for change in smooth_changes.smooth_changes(held[0]):
            gains.append(change.gain)
            freedom.append(change.freedom)
    ratio = sum(gains) / sum(freedom)
    assert 0.1 < ratio < 1.6  # above: five standard deviations of a mean over 78 degrees of freedom
    assert all(gain < 35.0 for gain in gains)


def test_a_shape_parameter_takes_up_a_change_of_its_own_kind():
    """With the right family no smooth change is left, however many bumps are offered."""
    runs = free_motions(lambda x: -3.0 * (np.exp(-x) - np.exp(-2.0 * x)), noise=0.03)
    terms = ["x_dot**2", "exp(-{a}*x)", "exp(-2*{a}*x)"]
    model = la.discover(runs, terms, known={"x_dot**2": 0.5})
    assert model.fit.status == "ok", model.fit.warnings
    assert not _codes(model)
