"""Groups of trials, and motions from outside: prescribed coordinates, forces with noise and steps."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from importlib.resources import as_file, files

import numpy as np
import pytest
import sympy as sp
from click.testing import CliRunner

import leastaction as la
from helpers import DUFFING_LIBRARY, KINETIC, SMALL, duffing, euler_lagrange, findings_of, pendulum, record
from leastaction import systems
from leastaction.cli import program
from leastaction.cli.demo import DEMOS
from leastaction.curve.bspline import uniform_grid
from leastaction.errors import DataError, InputError
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.forces import forces_on
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.groups import GroupedColumns, GroupTerm
from leastaction.estimation.intervals import first_points, points_at
from leastaction.estimation.problem import Structure
from leastaction.estimation.weights import evidence, fit_weights
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points
from leastaction.model.diagnostics import PathPoint
from leastaction.model.term import ModelTerm
from leastaction.refit import provisional, refit
from leastaction.report.series import Energy, Series

PAYLOAD = {"theta_dot**2": 1.0, "cos(theta)": 19.62}
HEAVY = {"theta_dot**2 in loaded": 0.5, "cos(theta) in loaded": 9.81}


def pendulums(*changed, trials=2, noise=0.02, seed=0):
    """Recordings of a pendulum, and of the same with other coefficients, one group after another."""
    system = systems.get("single_pendulum")
    runs = []
    for n, change in enumerate(changed):
        other = replace(system, lagrangian={**system.lagrangian, **change})
        data = systems.generate(other, noise, trials=trials, duration=8.0, seed=seed + 10 * n)
        runs += [run.changed(name=f"{n}{k}") for k, run in enumerate(data)]
    return la.Trajectories(runs)


def found(data, groups, **options):
    return la.discover(data, systems.get("single_pendulum").library, groups=groups, **options)


@pytest.fixture(scope="module")
def payload():
    return pendulums({}, PAYLOAD)


@pytest.fixture(scope="module")
def model(payload):
    return found(payload, ["empty", "empty", "loaded", "loaded"])


def differences(model):
    return {d.written: (d.difference, d.standard_error) for d in model.groups.differences}


def test_a_payload_is_named_and_weighed(model):
    assert model.groups.names == ("empty", "loaded")
    assert set(model.groups.terms) == {"theta_dot**2", "cos(theta)"}
    for written, truth in HEAVY.items():
        value, error = differences(model)[written]
        assert abs(value - truth) < 4.0 * error < 0.2 * truth
    assert model.fit.status == "ok"
    (finding,) = (f for f in model.fit.findings if f.code == "groups-differ")
    assert finding.subject == ("theta_dot**2", "cos(theta)")
    assert finding.values["alike"] == ()


def test_a_group_has_the_law_that_it_has_alone(model, payload):
    for name, trials in (("empty", [0, 1]), ("loaded", [2, 3])):
        own = la.discover(payload.select(trials), systems.get("single_pendulum").library)
        law = model.of_group(name)
        assert [t.expression for t in law.terms] == [t.expression for t in own.terms]
        for a, b in zip(law.terms, own.terms, strict=True):
            assert abs(a.coefficient - b.coefficient) < 0.5 * b.standard_error
            assert a.standard_error == pytest.approx(b.standard_error, rel=0.25)
        np.testing.assert_allclose(np.sqrt(np.diag(law.covariance)), [t.standard_error for t in law.terms])
        assert law.groups is None
        assert law.validate(payload.select(trials), 1.0).n_diverged == 0


@pytest.mark.thorough
def test_where_nothing_differs_none_is_named():
    """At most one false alarm in a thousand for each question: none in five recordings."""
    named = 0
    for seed in range(5):
        model = found(pendulums({}, {}, seed=100 * seed), ["a", "a", "b", "b"])
        named += len(model.groups.terms)
        assert {f.code for f in model.fit.findings} >= {"groups-alike"} or named
    assert named == 0


def test_names_and_sequence_of_groups_do_not_matter(model, payload):
    turned = found(payload.select([3, 2, 1, 0]), ["B", "B", "A", "A"])
    assert turned.groups.names == ("B", "A")
    for name, (value, error) in differences(model).items():
        other, its_error = differences(turned)[name.replace("loaded", "A")]
        assert other == pytest.approx(-value, abs=0.05 * error)
        assert its_error == pytest.approx(error, rel=0.02)
    for a, b in zip(model.of_group("loaded").terms, turned.of_group("B").terms, strict=True):
        assert a.coefficient == pytest.approx(b.coefficient, abs=0.05 * a.standard_error)


def test_a_table_of_two_machines_is_noticed_and_the_advice_works(payload, model):
    mixed = la.discover(payload, systems.get("single_pendulum").library)
    assert mixed.fit.status == "doubtful"
    (finding,) = findings_of(mixed, "trials-differ")
    assert finding.subject == ("theta_dot**2", "cos(theta)")
    assert finding.values["trials"] == ("00", "01", "10", "11")
    assert finding.values["places"] == (0, 0, 1, 1)
    advised = ast.literal_eval(finding.remedy.partition("groups=")[2].partition("}")[0] + "}")
    again = found(payload, advised)
    assert again.fit.status == "ok"
    for name, (value, error) in differences(model).items():
        assert differences(again)[name.replace("loaded", "B")][0] == pytest.approx(value, abs=0.05 * error)
    told = dict(zip(finding.values["terms"], finding.values["differences"], strict=True))
    for name, (value, error) in differences(again).items():
        assert told[name] == pytest.approx(value, abs=error)


@pytest.mark.parametrize(
    "amplitudes",
    [
        *(pytest.param(x, marks=pytest.mark.thorough) for x in ((0.4, 0.7, 1.0, 1.3), (0.4, 0.4, 1.3, 1.3))),
        None,
    ],
)
def test_another_fault_is_not_a_difference_between_trials(amplitudes):
    """An imitated law needs other coefficients for every amplitude, and missing friction the same for all."""
    if amplitudes:
        starts = [([x], [0.0]) for x in amplitudes]
        data = record(lambda q, v, f: -4.0 * np.sin(2.0 * q), starts, ["x"], duration=12.0, noise=0.002)
        candidates, known = la.Library(["x_dot**2", "x**2"], ["x"]), {"x_dot**2": 0.5}
    else:
        data, known = pendulum(viscous=0.6, trials=3), {}
        candidates = la.Library(["theta_dot**2", "cos(theta)"], ["theta"], angles=["theta"])
    model = la.discover(data, candidates, known=known)
    assert findings_of(model, "equations-off")
    assert not findings_of(model, "trials-differ")


def test_groups_may_be_given_by_the_names_of_trajectories(model, payload):
    names = dict(zip(payload.names, ["empty", "empty", "loaded", "loaded"], strict=True))
    same = found(payload, dict(reversed(names.items())))
    assert differences(same) == differences(model)


@pytest.mark.thorough
def test_a_group_of_one_trial():
    data = pendulums({}, PAYLOAD)[:3]
    model = found(data, ["empty", "empty", "loaded"])
    assert set(differences(model)) == set(HEAVY)
    for written, truth in HEAVY.items():
        value, error = differences(model)[written]
        assert abs(value - truth) < 4.0 * error


def test_a_term_of_one_group_alone():
    """A spring that only one group has: none in the first, and there in the other."""
    data = pendulums({}, {"theta**2": -4.0}, noise=0.01)
    library = [*systems.get("single_pendulum").lagrangian, "theta**2", "sin(theta)", "theta_dot*theta**2"]
    model = la.discover(data, library, groups=["free", "free", "sprung", "sprung"])
    assert model.groups.terms == ("theta**2",)
    assert "theta**2" not in {t.expression for t in model.terms}
    spring = next(t for t in model.of_group("sprung").terms if t.expression == "theta**2")
    assert abs(spring.coefficient + 4.0) < 4.0 * spring.standard_error < 0.4


@pytest.mark.thorough
def test_more_than_two_groups_and_friction():
    system = systems.get("single_pendulum")
    runs = [
        run
        for n, friction in enumerate((0.2, 0.5, 0.9))
        for run in systems.generate(
            system.with_dissipation({"theta_dot**2/2": friction}), 0.01, trials=2, duration=8.0, seed=n
        )
    ]
    runs = [run.changed(name=f"{n}") for n, run in enumerate(runs)]
    groups = [20, 20, 40, 40, 60, 60]
    model = la.discover(runs, system.library, dissipation=["theta_dot**2/2"], groups=groups)
    assert model.groups.terms == ("theta_dot**2/2",)
    assert {d.kind for d in model.groups.differences} == {"dissipation"}
    for name, truth in (("20", 0.2), ("40", 0.5), ("60", 0.9)):
        (psi,) = model.of_group(name).dissipation
        assert abs(psi.coefficient - truth) < 4.0 * psi.standard_error < 0.1


@pytest.mark.thorough
def test_known_coefficients_and_no_force_are_said_to_set_the_scale():
    system = systems.get("cart_spring_pendulum")
    other = replace(system, lagrangian={**system.lagrangian, "x**2": -7.0, "x": 7.0})
    pairs = [(system, 3), (other, 4)]
    runs = [r for s, seed in pairs for r in systems.generate(s, 0.01, trials=2, duration=8.0, seed=seed)]
    runs = [run.changed(name=f"{n}") for n, run in enumerate(runs)]
    model = la.discover(runs, system.library, system.known, groups=["soft", "soft", "stiff", "stiff"])
    assert set(model.groups.terms) == {"x**2", "x"}
    (finding,) = (f for f in model.fit.findings if f.code == "groups-known")
    assert finding.subject == ("cos(theta)",)
    assert finding.values["groups"] == ("soft", "stiff")


def test_a_model_with_groups_is_saved_shown_and_tabulated(model, tmp_path):
    model.save(tmp_path / "model.json")
    again = la.load(tmp_path / "model.json")
    assert again.to_dict() == model.to_dict()
    assert again.groups.differences == model.groups.differences
    for a, b in zip(again.of_group("loaded").terms, model.of_group("loaded").terms, strict=True):
        assert a == b
    table = model.table()
    rows = table[table["kind"] == "difference"]
    assert set(rows.index) == set(HEAVY)
    assert "theta_dot**2 in loaded" in str(model)
    document = json.loads((tmp_path / "model.json").read_text())
    del document["groups"]
    assert la.LagrangianModel.from_dict(document).groups is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"names": ["empty"]}, "names"),
        ({"differences": [{"expression": "x"}]}, "expected an object"),
        ({"covariance": [[1.0]]}, "covariance"),
        ({"more": 1}, "groups"),
        ({"names": 3}, "lists"),
    ],
)
def test_groups_in_a_file_are_checked(model, change, says):
    document = model.to_dict()
    with pytest.raises(InputError, match=says):
        la.LagrangianModel.from_dict({**document, "groups": {**document["groups"], **change}})


@pytest.mark.parametrize(
    ("groups", "says"),
    [
        (["a", "b"], "2 entries, but there are 4 trajectories"),
        (["a"] * 4, "at least two groups"),
        (["a", "a", "b", None], "empty"),
        ("aabb", "one for each trajectory"),
        (4, "one for each trajectory"),
        ({"00": "a", "01": "a", "10": "b"}, "no entry for the trajectory '11'"),
        ({"nobody": "a"}, "'nobody', which is not a trajectory"),
    ],
)
def test_wrong_groups_are_refused(payload, groups, says):
    with pytest.raises(InputError, match=says):
        found(payload, groups)


@pytest.mark.parametrize(
    "options", [{"method": "adam"}, {"force_offset": {"theta": 5.0}}], ids=["adam", "slow force"]
)
def test_what_cannot_be_compared_is_refused(payload, options):
    with pytest.raises(InputError, match="groups cannot be compared with"):
        found(payload, ["a", "a", "b", "b"], **options)


def test_shape_parameters_are_refused(payload):
    with pytest.raises(InputError, match="shape parameters"):
        la.discover(payload, ["theta_dot**2", "cos({k}*theta)"], groups=["a", "a", "b", "b"])


def test_forecasts_of_groups_are_those_of_their_laws(model, payload):
    """Forecasts of all trials at once, of each by the law of its group."""
    together = model.validate(payload, 1.0, groups=["empty", "empty", "loaded", "loaded"])
    parts = [
        model.of_group(name).validate(payload.select(trials), 1.0, window=together.window)
        for name, trials in (("empty", [0, 1]), ("loaded", [2, 3]))
    ]
    assert [t.trial for t in together.traces] == [t.trial for part in parts for t in part.traces]
    for a, b in zip(together.traces, (t for part in parts for t in part.traces), strict=True):
        np.testing.assert_array_equal(a.rms, b.rms)
    assert np.all(together.rms < 1.5 * together.expected_rms)
    wrong = model.validate(payload.select([2, 3]), 1.0)  # taken for trials of the first group
    assert np.all(wrong.rms > 2.0 * wrong.expected_rms)
    with pytest.raises(InputError, match="no group 'full'"):
        model.validate(payload, 1.0, groups=["full"] * 4)


def test_the_energy_of_each_trial_is_that_of_its_law(model, payload):
    assert [model.of_trial(k).provenance.get("group") for k in range(4)] == ["empty"] * 2 + ["loaded"] * 2
    assert model.of_trial(3) is model.of_trial(2)
    assert model.own_trials(4) == [0, 1]
    energies = [Energy.of(Series(model), k) for k in range(4)]
    assert max(e.imbalance for e in energies) < 0.01


def test_the_report_shows_what_differs(model, tmp_path):
    la.write_report(model, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "differences of loaded from empty" in page
    assert "differ between the groups empty, loaded" in page


def test_a_model_without_groups_has_no_law_of_one(model):
    with pytest.raises(InputError, match="no group 'full'"):
        model.of_group("full")
    with pytest.raises(InputError, match="groups of trials"):
        model.of_group("empty").of_group("empty")


def test_trials_in_blocks_say_the_same(model, payload, monkeypatch):
    monkeypatch.setattr("leastaction.estimation.recipes._NUMBERS", SMALL)
    other = found(payload, ["empty", "empty", "loaded", "loaded"])
    for name, (value, error) in differences(model).items():
        assert differences(other)[name][0] == pytest.approx(value, abs=1e-3 * error)
        assert differences(other)[name][1] == pytest.approx(error, rel=1e-3)


def test_streamed_recordings_say_the_same(model, payload, monkeypatch):
    monkeypatch.setattr("leastaction.estimation.streamed._LONG", 1000)
    other = found(payload, ["empty", "empty", "loaded", "loaded"])
    assert set(differences(other)) == set(HEAVY)
    for name, (value, error) in differences(model).items():
        assert differences(other)[name][0] == pytest.approx(value, abs=0.1 * error)


def test_columns_of_groups_are_those_of_each_law(rng):
    """In every group the equations, their Jacobian and the mass matrix are those of that group's law."""
    names, texts = ["x", "y"], ["x_dot**2", "y_dot**2", "x_dot*y_dot*cos(y)", "cos(y)", "x**2"]
    plain = euler_lagrange(texts, names)
    labels = np.repeat([0, 1, 2], [4, 7, 5])
    more = [GroupTerm.of(plain.terms[k], g, f"g{g}") for k in (1, 2, 3) for g in (1, 2)]
    columns = GroupedColumns([*plain.terms, *more], names, (), ("g0", "g1", "g2"), labels)
    sizes = rng.normal(size=len(columns))
    grid = uniform_grid([np.linspace(0.0, d, 9) for d in (0.8, 1.4, 1.0)], 5.0, 5, 2)
    grid_labels = np.repeat([0, 1, 2], [space.n_intervals for space in grid.spaces])
    columns = GroupedColumns(columns.terms, names, (), columns.names, grid_labels)
    control = rng.normal(size=(grid.n_ctrl, 2))
    for points, each in (
        (points_at(grid, control, slice(2, None)), np.tile(grid_labels[2:], 2)),
        (first_points(grid, control, slice(None, None, 3)), grid_labels[::3]),
    ):
        strong = np.tensordot(sizes, columns.strong(points), 1)
        mass = columns.mass_matrix(points, sizes)
        of_each = sum(c * columns.mass_of(k, points) for k, c in enumerate(sizes))
        jacobian = columns.jacobian(points, sizes)
        for group in range(3):
            own = sizes[:5].copy()
            own[1:4] += [sizes[5 + 2 * k + group - 1] if group else 0.0 for k in range(3)]
            here = each == group
            expected = np.tensordot(own, plain.strong(points), 1)
            np.testing.assert_allclose(strong[:, here], expected[:, here], atol=1e-12)
            np.testing.assert_allclose(mass[here], plain.mass_matrix(points, own)[here], atol=1e-12)
            np.testing.assert_allclose(of_each[here], mass[here], atol=1e-12)
            for key, value in plain.jacobian(points, own).items():
                both = [np.broadcast_to(v, points.n_points)[here] for v in (jacobian[key], value)]
                np.testing.assert_allclose(*both, atol=1e-12)
        moving, masses = columns.masses(points)
        np.testing.assert_allclose(np.tensordot(sizes[moving], masses, (0, 1)), mass, atol=1e-12)


# -------------- structures of the trade-off curve as models: provisional at once, and fitted without a search
def free_terms(model: la.LagrangianModel) -> dict[tuple[str, str], tuple[float, float]]:
    """(Kind, expression) → coefficient and standard error."""
    groups = (("lagrangian", model.terms), ("dissipation", model.dissipation))
    return {
        (kind, t.expression): (t.coefficient, t.standard_error)
        for kind, terms in groups
        for t in terms
        if not t.known
    }


def assert_alike(model: la.LagrangianModel, other: la.LagrangianModel, errors: float) -> None:
    first, second = free_terms(model), free_terms(other)
    assert first.keys() == second.keys()
    for key, (value, error) in first.items():
        assert abs(value - second[key][0]) <= errors * error, key
        assert second[key][1] == pytest.approx(error, rel=0.05)


@pytest.fixture(scope="module")
def braked() -> la.LagrangianModel:
    """A driven pendulum, with one expression that is a candidate of L and of friction."""
    data = la.systems.generate("single_pendulum", noise=0.01, trials=2, duration=6.0, rate=50.0, seed=3)
    library = ["theta_dot**2", "cos(theta)", "cos(2*theta)", "theta_dot**2*cos(theta)"]
    friction = ["theta_dot**2", "theta_dot**4"]
    return la.discover(data, library, dissipation=friction)


@pytest.fixture(scope="module")
def sprung() -> la.LagrangianModel:
    return la.discover(duffing(), DUFFING_LIBRARY, KINETIC)


def test_a_point_knows_the_kind_and_the_numbers_of_its_terms(braked):
    """θ̇² is a candidate of L and of ψ here: its text alone does not say which."""
    kinds = set()
    for point in braked.diagnostics.path:
        free = free_terms(provisional(braked, point))
        keys = zip(point.kinds, point.expressions, strict=True)
        numbers = zip(point.coefficients, point.standard_errors, strict=True)
        assert free == dict(zip(keys, numbers, strict=True))
        kinds |= {kind for kind, expression in free if expression == "theta_dot**2"}
    assert kinds == {"lagrangian", "dissipation"}


def test_known_terms_stay_and_the_model_keeps_its_order(sprung):
    for point in sprung.diagnostics.path:
        model = provisional(sprung, point)
        assert [(t.expression, t.coefficient) for t in model.terms if t.known] == list(KINETIC.items())
        shared = [t.expression for t in model.terms if t.expression in {s.expression for s in sprung.terms}]
        assert shared == [s.expression for s in sprung.terms if s.expression in shared]
        assert model.fit.status == "doubtful"


def test_the_chosen_structure_comes_out_as_it_was(braked, sprung):
    for model in (braked, sprung):
        (chosen,) = (p for p in model.diagnostics.path if p.chosen)
        again = refit(model, chosen)
        assert_alike(model, again, 0.05)
        assert_alike(model, provisional(model, chosen), 0.05)
        assert again.fit.status == model.fit.status
        assert again.provenance["data"] == model.provenance["data"]
        assert again.provenance["structure"] == list(chosen.expressions)


def test_another_structure_is_as_a_search_for_its_terms_finds_it(sprung):
    point = next(p for p in sprung.diagnostics.path if p.n_terms == 3)
    model = refit(sprung, point)
    found = {t.expression: t for t in model.terms}
    # with the term that the data do not ask for held at its value a search keeps the others
    (extra,) = set(point.expressions) - {"x**2", "x**4"}
    held = {**KINETIC, extra: found[extra].coefficient}
    other = la.discover(duffing(), [*KINETIC, *point.expressions], held, relevance=0.0)
    compared = {t.expression: t for t in other.terms if not t.known}
    assert set(compared) == {"x**2", "x**4"}
    for expression, term in compared.items():
        assert abs(term.coefficient - found[expression].coefficient) < 0.05 * term.standard_error
    (finding,) = findings_of(model, "another-structure")
    assert finding.values["reason"] == point.reason == "not-worth-its-terms"
    assert "improve the fit by less than their penalty" in finding.message
    assert model.fit.status == "doubtful"
    assert model.diagnostics.path == sprung.diagnostics.path


def morse(q, v, f):
    """In L = ½ ẋ² + 4 e^(−0.8 x) − 2 e^(−1.6 x)."""
    return -3.2 * (np.exp(-0.8 * q) - np.exp(-1.6 * q))


MORSE = ["x_dot**2", "x", "x**2", "x**3", "exp(-{a}*x)", "exp(-2*{a}*x)"]
MORSE_KNOWN = {"x_dot**2": 0.5}


@pytest.fixture(scope="module")
def bound() -> la.LagrangianModel:
    """A law with a number inside two of its terms."""
    starts = [([2.2], [0.0]), ([1.3], [0.0]), ([0.0], [1.2])]
    data = record(morse, starts, ["x"], duration=8.0, rate=30.0, noise=0.01, seed=1)
    return la.discover(data, MORSE, MORSE_KNOWN)


def point_of(model: la.LagrangianModel, *written: str) -> PathPoint:
    return next(p for p in model.diagnostics.path if p.written == written)


def test_a_point_has_its_shape_parameters_by_name(bound):
    (found,) = bound.shapes
    kinds = set()
    for point in bound.diagnostics.path:
        held = any("{a}" in text for text in point.written)
        assert point.shapes == ((("a", found.value),) if held else ())
        assert all("{" not in text for text in point.expressions)
        model = provisional(bound, point)
        assert [(s.name, s.value) for s in model.shapes] == list(point.shapes)
        assert all(np.isnan(s.standard_error) for s in model.shapes)
        assert {t.written for t in model.terms if not t.known} == {*point.written}
        kinds.add(held)
    assert kinds == {True, False}


def test_shape_parameters_of_the_chosen_structure_come_out_as_they_were(bound):
    (chosen,) = (p for p in bound.diagnostics.path if p.chosen)
    again = refit(bound, chosen)
    assert [t.written for t in again.terms] == [t.written for t in bound.terms]
    numbers = [[*m.terms[1:], m.shapes[0].as_term()] for m in (bound, again)]
    for before, after in zip(*numbers, strict=True):
        assert abs(after.coefficient - before.coefficient) <= 0.1 * before.standard_error
        # of equations that hold this well, rounding decides which error they may have at most
        assert after.standard_error == pytest.approx(before.standard_error, rel=0.5)
    assert len(again.shapes[0].profile) > 4
    assert again.fit.status == bound.fit.status == "ok"
    assert again.provenance["structure"] == list(chosen.expressions)


def test_shape_parameters_of_another_structure_are_fitted_again(bound):
    """e^(−2ax) with a is what e^(−ax) is with 2a: from the same number both fits come to one law."""
    refitted = [refit(bound, point_of(bound, "x", text)) for text in ("exp(-2*{a}*x)", "exp(-{a}*x)")]
    doubled, single = (model.shapes[0] for model in refitted)
    assert abs(single.value - bound.shapes[0].value) > 10.0 * single.standard_error
    assert 2.0 * doubled.value == pytest.approx(single.value, abs=0.02 * single.standard_error)
    assert 2.0 * doubled.standard_error == pytest.approx(single.standard_error, rel=0.05)
    for model, shape in zip(refitted, (doubled, single), strict=True):
        (bearer,) = (t for t in model.terms if t.template)
        assert bearer.expression == bearer.template.replace("{a}", f"{shape.value:.12g}")
        assert model.covariance.shape == (3, 3)
        assert model.covariance[2, 2] == pytest.approx(shape.standard_error**2)


def test_bounds_of_shape_parameters_hold_in_a_refit():
    starts = [([2.2], [0.0]), ([1.3], [0.0]), ([0.0], [1.2])]
    data = record(morse, starts, ["x"], duration=8.0, rate=30.0, noise=0.01, seed=1)
    model = la.discover(data, MORSE, MORSE_KNOWN, shapes={"a": (0.5, 1.2)})
    again = refit(model, point_of(model, "x", "exp(-{a}*x)"))
    assert again.shapes[0].value == 1.2
    assert findings_of(again, "shape-at-bound")


def test_a_point_without_the_number_of_a_shape_parameter_says_so(bound):
    (chosen,) = (p for p in bound.diagnostics.path if p.chosen)
    strange = replace(chosen, templates=tuple(t.replace("{a}", "{b}") for t in chosen.templates))
    for function in (refit, provisional):
        with pytest.raises(InputError, match="no number for the shape parameter 'b'"):
            function(bound, strange)


def test_what_was_said_of_the_data_is_said_again():
    data = duffing()
    rng = np.random.default_rng(0)
    spoilt = []
    for run in data:
        q = run.q.copy()
        q[rng.integers(20, run.n_times - 20, 3)] += 5.0
        spoilt.append(run.changed(q=q))
    model = la.discover(spoilt, DUFFING_LIBRARY, KINETIC)
    assert findings_of(model, "outliers-left-out")
    again = refit(model, model.diagnostics.path[0])
    assert findings_of(again, "outliers-left-out") == findings_of(model, "outliers-left-out")


def test_friction_that_feeds_energy_in_is_left_out(sprung):
    point = PathPoint(
        ("x**2", "x**4", "x_dot**2"),
        0.0,
        0.0,
        reason="fits-worse",
        coefficients=(-1.0, -0.2, 0.0),
        standard_errors=(0.1, 0.1, 0.1),
        kinds=("lagrangian", "lagrangian", "dissipation"),
    )
    growing = [
        la.Trajectory(run.t, run.q * np.exp(0.02 * run.t)[:, None], coordinates=run.coordinates)
        for run in sprung.diagnostics.trajectories
    ]
    model = replace(sprung, diagnostics=replace(sprung.diagnostics, trajectories=la.Trajectories(growing)))
    again = refit(model, point)
    assert again.dissipation == ()
    assert [f.subject for f in findings_of(again, "negative-dissipation")] == [("x_dot**2",)]


def test_what_cannot_be_refitted_says_so(sprung, tmp_path):
    point = sprung.diagnostics.path[0]
    path = tmp_path / "model.json"
    sprung.save(path)
    with pytest.raises(InputError, match="no diagnostics"):
        refit(la.load(path), point)
    bare = PathPoint(("x**2",), 0.0, 0.0)
    for function in (refit, provisional):
        with pytest.raises(InputError, match="no coefficients"):
            function(sprung, bare)
    undefined = replace(point, expressions=("sqrt(x)",), coefficients=(1.0,), standard_errors=(1.0,))
    with pytest.raises(DataError, match="does not converge"):
        refit(sprung, replace(undefined, kinds=("lagrangian",)))
    potential = [ModelTerm("x**4", -0.2, known=True), ModelTerm("x**2", -0.5, 0.1)]
    massless = replace(sprung, terms=potential, covariance=None)
    with pytest.raises(DataError, match="cannot be solved"):
        refit(massless, replace(undefined, expressions=("x**2",), kinds=("lagrangian",)))


NAMES = ("x", "theta")
KNOWN = {"theta_dot**2": 0.5}
CRANE = {"x_dot*theta_dot*cos(theta)": 1.0, "cos(theta)": 9.81}
FRICTION = {"theta_dot**2": 0.05}
PROVENANCE = {"options": {"prescribed": ["x"], "angles": ["theta"]}}


def crane(friction: bool = True) -> la.LagrangianModel:
    """A pendulum of length one below a trolley."""
    terms = [ModelTerm("theta_dot**2", 0.5, known=True), *(ModelTerm(k, v) for k, v in CRANE.items())]
    psi = [ModelTerm(k, v) for k, v in FRICTION.items()] if friction else []
    return la.LagrangianModel(NAMES, terms, psi, provenance=PROVENANCE)


def drive(seed: int):
    """Position, velocity and acceleration of the trolley as functions of time."""
    rng = np.random.default_rng(seed)
    size, rate, phase = 0.25 * rng.normal(size=4), rng.uniform(1.0, 7.0, 4), rng.uniform(0.0, 6.0, 4)
    return [
        lambda t, k=k: float((size * rate**k * np.sin(rate * t + phase + k * np.pi / 2)).sum())
        for k in range(3)
    ]


def record_crane(seed: int, noise: float, pushed: la.LagrangianModel | None = None, duration: float = 8.0):
    x, v, a = drive(seed)
    t = np.arange(0.0, duration, 0.01)
    run = (pushed or crane()).simulate([x(0.0), 0.7], [v(0.0), 0.0], t, lambda time: np.array([a(time), 0.0]))
    assert run.complete
    assert np.abs(run.q[:, 0] - [x(time) for time in t]).max() < 1e-6
    rng = np.random.default_rng(seed)
    return la.Trajectory(t, run.q + noise * run.q.std(axis=0) * rng.normal(size=run.q.shape), None, NAMES)


@pytest.fixture(scope="module")
def data():
    return [record_crane(seed, 0.01) for seed in range(3)]


@pytest.fixture(scope="module")
def pushed(data):
    library = la.Library.mechanical(NAMES, ["theta"])
    return la.discover(data, library, KNOWN, ["theta_dot**2", "x_dot**2"], prescribed=["x"])


def coefficients_of(pushed: la.LagrangianModel):
    return {t.expression: t for t in pushed.terms if not t.known}, {
        t.expression: t for t in pushed.dissipation
    }


def test_law_is_found_and_what_only_the_trolley_has_is_left_out(pushed):
    lagrangian, friction = coefficients_of(pushed)
    assert pushed.fit.status == "ok", pushed.fit.warnings
    for truth, here in ((CRANE, lagrangian), (FRICTION, friction)):
        assert set(truth) == set(here)
        for name, value in truth.items():
            assert abs(here[name].coefficient - value) < 4.0 * here[name].standard_error
            assert here[name].standard_error < 0.03 * value
    left_out = {d.term.text: d.because for d in pushed.diagnostics.dropped}
    assert "not prescribed" in left_out["x_dot**2"]
    assert np.isnan(pushed.fit.physics_weight[0])
    assert np.isnan(pushed.diagnostics.equation_error[0])
    assert np.isfinite(pushed.diagnostics.equation_error[1])


def test_equation_agrees_with_sympy_for_a_motion_put_into_the_lagrangian():
    """The oracle knows no prescribed coordinates: x(t) stands in L as a function of time."""
    t, x = sp.Symbol("t"), sp.Function("x")
    theta = sp.Function("theta")(t)
    motion = 0.3 * sp.sin(2 * t)
    lagrangian = theta.diff(t) ** 2 / 2 + x(t).diff(t) * theta.diff(t) * sp.cos(theta) + 9.81 * sp.cos(theta)
    (equation,) = sp.calculus.euler.euler_equations(lagrangian.subs(x(t), motion).doit(), theta, t)
    expected = sp.lambdify([t, theta, theta.diff(t)], sp.solve(equation, theta.diff(t, 2))[0])
    for time, angle, rate in ((0.3, 0.8, -1.0), (2.0, -2.5, 3.0)):
        place, speed, push = (float(motion.diff(t, k).subs(t, time)) for k in range(3))
        q̈ = crane(friction=False).acceleration([place, angle], [speed, rate], [push, 0.0])
        assert q̈ == pytest.approx([push, expected(time, angle, rate)], rel=1e-12)


def test_equations_name_the_acceleration_of_the_trolley_and_have_none_for_it():
    (equation,) = crane().equations_of_motion(forces=True)
    assert str(equation.lhs) == "theta_dot_dot"
    assert {str(s) for s in equation.rhs.free_symbols} == {"x_dot_dot", "theta", "theta_dot", "theta_force"}


def test_forecast_moves_the_trolley_as_it_was_measured(pushed):
    result = pushed.validate([record_crane(7, 0.01)], horizon=1.0)
    assert result.n_diverged == 0
    assert np.all(result.rms < 2.0 * result.expected_rms)


def test_forces_on_a_prescribed_coordinate_are_left_out(data, pushed):
    pushed = [la.Trajectory(d.t, d.q, np.column_stack([np.sin(d.t), 0.0 * d.t]), NAMES) for d in data]
    library = la.Library([*KNOWN, *CRANE, "sin(theta)"], NAMES)
    again = la.discover(pushed, library, KNOWN, ["theta_dot**2"], prescribed="x")
    assert [finding.subject for finding in findings_of(again, "forces-unused")] == [("x",)]
    assert again.fit.status == "ok"
    with pytest.raises(ValueError, match="no force acts and no coefficient is known"):
        la.discover(pushed, library, prescribed=["x"])


@pytest.mark.thorough
def test_a_force_on_the_other_coordinate_sets_the_scale():
    """An arm with one torque sensor: the first joint moves as it likes."""
    names = ("a", "b")
    terms = {"b_dot**2": 0.5, "a_dot*b_dot*cos(a-b)": 1.0, "cos(b)": 9.81}
    arm = la.LagrangianModel(
        names, [ModelTerm(k, v) for k, v in terms.items()], provenance={"options": {"prescribed": ["a"]}}
    )
    data, t = [], np.arange(0.0, 8.0, 0.01)
    for seed in range(3):
        x, v, a = drive(seed)
        push = np.array([[0.0, 2.0 * np.sin(5.0 * time + seed)] for time in t])
        moved = np.column_stack([[a(time) for time in t], push[:, 1]])
        q = arm.simulate([x(0.0), 0.2], [v(0.0), 0.0], t, moved).q
        rng = np.random.default_rng(seed)
        data.append(la.Trajectory(t, q + 0.01 * q.std(axis=0) * rng.normal(size=q.shape), push, names))
    result = la.discover(data, la.Library.mechanical(names, names, size="compact"), prescribed=["a"])
    assert result.fit.status == "ok", result.fit.warnings
    lagrangian, _ = coefficients_of(result)
    assert set(lagrangian) == set(terms)
    for name, value in terms.items():
        assert abs(lagrangian[name].coefficient - value) < 4.0 * lagrangian[name].standard_error


@pytest.mark.thorough
def test_either_equation_of_the_measured_double_pendulum_gives_the_published_law():
    demo = DEMOS["double"]
    with as_file(files("leastaction") / "datasets" / demo.file) as path:
        data = la.io.read_csv(path, coordinates=list(demo.coordinates), trial="trial")
    fitted = data.select([name for k, name in enumerate(data.names) if k % 3 != 2])
    library = la.Library(demo.candidates, demo.coordinates, angles=demo.coordinates)
    scale = {"theta2_dot**2": demo.published["theta2_dot**2"]}
    result = la.discover(fitted, library, scale, demo.dissipation, prescribed=["theta1"])
    assert result.fit.status == "ok", result.fit.warnings
    lagrangian, _ = coefficients_of(result)
    assert set(lagrangian) == {"theta1_dot*theta2_dot*cos(theta1-theta2)", "cos(theta2)"}
    for name, term in lagrangian.items():
        assert term.coefficient == pytest.approx(demo.published[name], rel=0.005)
        assert term.standard_error < 0.001 * abs(term.coefficient)


def test_a_missing_coupling_is_doubted(data):
    result = la.discover(data, [*KNOWN, "cos(theta)", "sin(theta)"], KNOWN, prescribed=["x"])
    assert result.fit.status == "doubtful"
    (missing,) = findings_of(result, "missing-term")
    assert missing.subject == ("x_dot*theta_dot*cos(theta)",)


@pytest.mark.thorough
def test_without_being_told_the_result_is_doubtful(data):
    library = la.Library([*KNOWN, *CRANE, "x_dot**2", "x**2"], NAMES)
    assert la.discover(data, library, KNOWN, ["theta_dot**2"]).fit.status == "doubtful"


def test_columns_have_no_rows_of_prescribed_coordinates():
    library = la.Library([*KNOWN, *CRANE, "x_dot**2"], NAMES)
    all_of_it = EulerLagrange(library.terms, NAMES)
    some = EulerLagrange(library.terms, NAMES, [0])
    rng = np.random.default_rng(0)
    states = rng.normal(size=(3, 7, 2))
    points, coefficients = Points(*states), np.arange(1.0, 5.0)
    assert np.all(some.strong(points)[:, 0] == 0.0)
    assert np.array_equal(some.strong(points)[:, 1], all_of_it.strong(points)[:, 1])
    assert np.all(some.weak(points)[:, :, 0] == 0.0)
    assert {i for _, i, _ in some.jacobian(points, coefficients)} == {1}
    mass = some.mass_matrix(points, coefficients)
    assert np.all(mass == np.array([[1.0, 0.0], [0.0, 2.0]]))
    assert some.subset([0, 1]).prescribed == (0,)


def test_terms_that_agree_in_the_equations_left_are_dependent():
    library = la.Library(
        ["theta_dot**2", "x_dot**2*cos(theta)**2", "x_dot**2*sin(theta)**2", "sin(x)"], NAMES
    )
    assert len(library.reduced()) == 4
    reduced = library.reduced(prescribed=["x"])
    assert [t.text for t in reduced] == ["theta_dot**2", "x_dot**2*cos(theta)**2"]
    reasons = {d.term.text: d.reason for d in reduced.dropped}
    assert reasons == {"x_dot**2*sin(theta)**2": "duplicate", "sin(x)": "null"}


def test_evidence_levels_off_where_the_equations_hold(data):
    """A weight that grows without bound leaves the likelihood of an exact model where it is.

    With two points an interval the equations would take more directions of the curves than there are
    equations, and the likelihood would fall by hundreds.
    """
    request = Request([*KNOWN, *CRANE], KNOWN, ["theta_dot**2"], prescribed=["x"])
    setup = build_problem(data, request)
    grid = Grid.lay(setup.problem, 30.0)
    smoothed = grid.smooth(setup.scales.smooth.penalty)
    members = Structure(setup.problem.free)
    truth = {**KNOWN, **CRANE}
    coefficients = np.array([truth[t.text] if t.kind == "lagrangian" else 0.05 for t in setup.problem.terms])
    start = grid.start(members, smoothed.control_points, coefficients, smoothed.noise_std)
    start, _ = grid.fit_curve(members, start)
    physics, index = grid.physics(members)
    begin = type(start)(start.control_points, start.coefficients[index], start.weights)
    best = fit_weights(grid.observations, physics, begin)
    values = []
    for factor in (1.0, 10.0, 100.0):
        weights = best.weights.__class__(
            best.weights.noise_std, best.weights.physics * [1.0, factor], best.weights.slack
        )
        fit = fit_joint(
            grid.observations, physics, weights, best.control_points, best.coefficients, tolerance=1e-3
        )
        values.append(evidence(grid.observations, fit))
    assert np.ptp(values) < 1.0


@pytest.mark.parametrize("degree", [3, 4, 5])
def test_points_of_collocation_see_the_fastest_spline(degree):
    grid = uniform_grid([np.linspace(0.0, 1.0, 50)], 20.0, degree, 1)
    fastest = (-1.0) ** np.arange(grid.n_ctrl)[:, None]
    inside = slice(degree, grid.n_intervals - degree)
    values = np.abs(grid.at_quadrature(fastest)[2][inside])
    assert values.min() > 0.5 * values.max() > 0.0


def test_model_file_keeps_what_is_prescribed(tmp_path, pushed):
    pushed.save(tmp_path / "crane.json")
    again = la.load(tmp_path / "crane.json")
    assert again.prescribed == ("x",)
    state = [[0.1, 0.5], [0.3, -1.0], [2.0, 0.0]]
    assert np.array_equal(again.acceleration(*state), pushed.acceleration(*state))
    for odd in (["x", "theta"], "x", 3, None, ["y"], [["x"]]):
        document = {**pushed.to_dict(), "provenance": {"options": {"prescribed": odd}}}
        assert la.LagrangianModel.from_dict(document).prescribed == ()


def test_exported_python_takes_the_acceleration_as_force(tmp_path, pushed):
    la.export(pushed, "python", tmp_path / "crane.py")
    source = (tmp_path / "crane.py").read_text()
    assert "its motion is prescribed: its force is its acceleration" in source
    module: dict = {}
    exec(source, module)
    state = [0.1, 0.5], [0.3, -1.0], [2.0, 0.1]
    assert module["acceleration"](*state) == pytest.approx(pushed.acceleration(*state), rel=1e-12)


def test_report_says_that_there_is_no_balance(tmp_path, pushed):
    la.write_report(pushed, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert "the forces that move x are unknown" in text
    assert "nan" not in text.lower().replace("finance", "")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"prescribed": ["y"]}, "prescribed names 'y', which is not a coordinate"),
        ({"prescribed": ["x", "theta"]}, "every coordinate is prescribed"),
        ({"prescribed": ["x"], "force_offset": ["x"]}, "force_offset names 'x', which is prescribed"),
    ],
)
def test_misuse_is_named(data, given, message):
    with pytest.raises(ValueError, match=message):
        la.discover(data, [*KNOWN, *CRANE], KNOWN, **given)


def test_a_motion_that_is_given_is_followed():
    """Samples of the trolley do what its acceleration does; forces on the rest still act."""
    x, v, a = drive(1)
    t = np.arange(0.0, 4.0, 0.01)
    pushed, push = crane(), lambda time: np.array([0.0, 0.3 * np.sin(time)])
    given = pushed.simulate([0.0, 0.7], [0.0, 0.0], t, push, inputs={"x": [x(time) for time in t]})
    forces = np.array([[a(time), push(time)[1]] for time in t])
    known = pushed.simulate([x(0.0), 0.7], [v(0.0), 0.0], t, forces)
    assert np.abs(given.q - known.q).max() < 1e-6
    with pytest.raises(la.InputError, match=r"inputs gives the motion of 'theta'; .* is allowed, here x"):
        pushed.simulate([0.0, 0.7], [0.0, 0.0], t, inputs={"theta": t})
    with pytest.raises(la.InputError, match=r"an input has shape \(3,\); expected finite numbers of shape"):
        pushed.simulate([0.0, 0.7], [0.0, 0.0], t, inputs={"x": t[:3]})


def test_a_length_that_is_reeled_in_is_an_input():
    """L = l² θ̇²/2 + g l cos θ with l measured: the terms hold an input that changes."""
    t, rng = np.linspace(0.0, 8.0, 801), np.random.default_rng(3)
    length = 1.0 + 0.3 * np.sin(1.7 * t) + 0.1 * np.sin(0.6 * t)
    terms = [ModelTerm("l**2*theta_dot**2", 0.5), ModelTerm("l*cos(theta)", 9.81)]
    law = la.LagrangianModel(("theta", "l"), terms, provenance={"options": {"prescribed": ["l"]}})
    motions = [law.simulate([start, 0.0], [0.0, 0.0], t, inputs={"l": length}) for start in (0.5, 1.0)]
    noise = 0.005 * rng.normal(size=(2, t.size, 2))
    runs = [la.Trajectory(t, m.q + e, None, ("theta", "l")) for m, e in zip(motions, noise, strict=True)]
    library = la.Library.mechanical(["theta", "l"], ["theta"], size="compact")
    pushed = la.discover(runs, library, {"l*cos(theta)": 9.81}, prescribed=["l"])
    assert pushed.fit.status == "ok"
    assert {term.expression for term in pushed.terms} == {"l*cos(theta)", "theta_dot**2*l**2"}


def test_estimator_passes_it_on(data):
    pytest.importorskip("sklearn")
    estimator = la.SparseLagrangian(
        [*KNOWN, *CRANE], KNOWN, ["theta_dot**2"], coordinates=NAMES, prescribed=["x"]
    )
    assert estimator.fit(data[:2]).model_.prescribed == ("x",)
    assert estimator.score(data[2:]) > 0.9


def test_the_papers_method_leaves_the_equation_out_too(data):
    options = {"iterations": 200, "check_every": 100, "threshold_from": 200}
    result = la.discover(data, [*KNOWN, *CRANE], KNOWN, method="adam", prescribed=["x"], options=options)
    lagrangian, _ = coefficients_of(result)
    assert lagrangian["cos(theta)"].coefficient == pytest.approx(9.81, rel=0.1)


@pytest.mark.thorough
def test_command_line(tmp_path, data):
    la.io.write_csv(tmp_path / "crane.csv", la.Trajectories(data))
    library = tmp_path / "library.txt"
    library.write_text("\n".join([*KNOWN, *CRANE, "sin(theta)"]))
    common = ["--coordinates", "x,theta", "--angles", "theta", "--trial", "trial", "--library", str(library)]
    given = ["--prescribed", "x", "--known", "theta_dot**2=0.5", "--dissipation", "theta_dot**2"]
    out = tmp_path / "out"
    ran = CliRunner().invoke(
        program, ["discover", str(tmp_path / "crane.csv"), *common, *given, "--output", str(out)]
    )
    assert ran.exit_code == 0, ran.output
    assert la.load(out / "model.json").prescribed == ("x",)
    as_input = ["--coordinates", "theta", "--input", "x", *common[2:], *given[2:]]
    ran = CliRunner().invoke(
        program, ["discover", str(tmp_path / "crane.csv"), *as_input, "--output", str(tmp_path / "other")]
    )
    assert ran.exit_code == 0, ran.output
    other = la.load(tmp_path / "other" / "model.json")
    assert (other.coordinates, other.prescribed) == (("theta", "x"), ("x",))
    written = {term.expression: term.coefficient for term in other.terms}
    for term in la.load(out / "model.json").terms:
        assert written[term.expression] == pytest.approx(term.coefficient, rel=1e-6)
    free = ["--initial", "theta=1", "--duration", "1", "--rate", "50", "-o", str(tmp_path / "run.csv")]
    ran = CliRunner().invoke(program, ["simulate", str(out / "model.json"), *free])
    assert ran.exit_code == 0
    assert "the motion of x was prescribed: it is uniform here" in ran.output


# -------------------------------------------------- measured forces: noise, and steps of a digital controller
TRUTH = {"theta_dot**2": 0.5, "cos(theta)": 9.81}


# ------------------------------------------------------------------------------------- on the grid


def test_a_polynomial_of_the_degree_of_the_spline_is_kept():
    t = np.linspace(0.0, 4.0, 401)
    force = np.column_stack([t**5 - 3.0 * t, 2.0 - t**2])
    grid = uniform_grid([t], 5.0, 5)
    coefficients_of = forces_on(grid, [t], [force])
    x = grid.points
    assert np.allclose(coefficients_of.values, np.stack([x**5 - 3.0 * x, 2.0 - x**2], axis=-1), atol=1e-8)
    assert np.all(coefficients_of.density < 1e-16)


@pytest.mark.parametrize("knots", [2.0, 8.0, 30.0, 200.0])
def test_density_is_that_of_white_noise(knots):
    rng = np.random.default_rng(1)
    times = [np.linspace(0.0, 20.0, 2001), np.linspace(0.0, 10.0, 501)]
    noise = [rng.normal(0.0, [0.3, 0.0], (t.size, 2)) for t in times]
    coefficients_of = forces_on(uniform_grid(times, knots, 5), times, noise)
    expected = 0.3**2 * (2001 * 0.01 + 501 * 0.02) / 2502
    assert coefficients_of.density[0] == pytest.approx(expected, rel=0.15)
    assert coefficients_of.density[1] == 0.0


def test_noise_falls_with_the_number_of_samples_an_interval():
    t = np.linspace(0.0, 40.0, 8001)
    noise = np.random.default_rng(2).normal(0.0, 1.0, (t.size, 1))
    sizes = [np.std(forces_on(uniform_grid([t], k, 5), [t], [noise]).values) for k in (4.0, 16.0)]
    assert sizes[1] / sizes[0] == pytest.approx(2.0, rel=0.25)


def test_gaps_and_few_samples():
    t = np.concatenate([np.linspace(0.0, 4.0, 201), np.linspace(6.0, 10.0, 201)])
    grid = uniform_grid([t], 6.0, 5)
    coefficients_of = forces_on(grid, [t], [np.sin(t)[:, None]]).values[..., 0]
    measured = (grid.points < 4.0) | (grid.points > 6.0)
    assert np.allclose(coefficients_of[measured], np.sin(grid.points)[measured], atol=0.02)
    few = np.linspace(0.0, 1.0, 6)
    grid = uniform_grid([few], 20.0, 5)
    coefficients_of = forces_on(grid, [few], [few[:, None] ** 3])
    assert np.allclose(coefficients_of.values[..., 0], grid.points**3)
    assert coefficients_of.density.tolist() == [0.0]


def test_nothing_acts():
    t = np.linspace(0.0, 1.0, 101)
    grid = uniform_grid([t, t], 8.0, 5)
    assert forces_on(grid, [t, t], [None, None]) is None
    coefficients_of = forces_on(grid, [t, t], [None, np.ones((101, 1))])
    assert np.all(coefficients_of.values[grid.owner == 0] == 0.0)
    assert np.allclose(coefficients_of.values[grid.owner == 1], 1.0)


# ---------------------------------------------------------------------------------------- the law


def within(pushed, sigmas: float) -> bool:
    assert {t.expression for t in pushed.terms} == set(TRUTH)
    return all(abs(t.coefficient - TRUTH[t.expression]) < sigmas * t.standard_error for t in pushed.terms)


def noisy(share: float, seed: int) -> la.Trajectories:
    data = systems.generate("single_pendulum", noise=0.01, trials=5, duration=20.0, seed=seed)
    size = share * np.std(np.concatenate([run.forces for run in data]))
    rng = np.random.default_rng(seed)
    return data.with_forces([run.forces + size * rng.normal(size=run.forces.shape) for run in data])


@pytest.mark.parametrize(("share", "seed"), [(0.3, 300), (1.0, 301), (1.0, 302)])
@pytest.mark.thorough
def test_noise_of_the_forces_does_not_bias_the_scale(share, seed):
    pushed = la.discover(noisy(share, seed), systems.compact_library("single_pendulum"))
    assert pushed.fit.status == "ok", pushed.fit.warnings
    assert within(pushed, 4.0)
    gravity = next(t for t in pushed.terms if t.expression == "cos(theta)")
    assert gravity.coefficient == pytest.approx(9.81, rel=0.03)
    if share == 1.0:
        assert findings_of(pushed, "scatter-of-forces")


@pytest.mark.thorough
def test_noise_of_the_forces_excuses_no_missing_term():
    library = [t.text for t in systems.compact_library("single_pendulum").terms if t.text != "cos(theta)"]
    assert la.discover(noisy(0.3, 300), library).fit.status == "doubtful"


def held(seed: int, rate: float = 100.0, duration: float = 20.0) -> list[la.Trajectory]:
    """Pendulums whose torque jumps now and then, as a switching controller's does."""
    rng, substeps, runs = np.random.default_rng(seed), 4, []
    for _ in range(5):
        n = int(duration * rate)
        lengths = rng.uniform(0.3, 1.5, 80)
        jumps = np.searchsorted(np.cumsum(lengths), np.arange(n + 1) / rate)
        torque = rng.choice([-3.0, 0.0, 3.0], 81)[jumps]
        y, path, h = np.array([rng.uniform(-1.0, 1.0), 0.0]), [], 1.0 / rate / substeps
        for u in torque:
            path.append(y[0])

            def slope(y, u=u):
                return np.array([y[1], u - 9.81 * np.sin(y[0])])

            for _ in range(substeps):
                k1 = slope(y)
                k2 = slope(y + 0.5 * h * k1)
                k3 = slope(y + 0.5 * h * k2)
                y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + slope(y + h * k3))
        q = np.array(path)
        measured = q + 0.01 * q.std() * rng.normal(size=q.size)
        t = np.arange(n + 1) / rate
        runs.append(la.Trajectory(t, measured, torque[:, None], coordinates=["theta"]))
    return runs


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_forces_that_jump(seed):
    library = la.Library([*TRUTH, "theta_dot**4", "sin(theta)", "cos(2*theta)", "theta"], ["theta"])
    pushed = la.discover(held(seed), library)
    assert pushed.fit.status == "ok", pushed.fit.warnings
    assert within(pushed, 4.0)


def stamped_late(seed: int) -> la.Trajectories:
    """Torques stamped one sample, 10 ms, after they acted."""
    data = systems.generate("single_pendulum", noise=0.003, trials=4, duration=20.0, seed=seed)
    return la.Trajectories([run.rows(slice(1, None)).changed(forces=run.forces[:-1]) for run in data])


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [4, 5])
def test_a_delay_that_friction_could_hide_is_named(seed):
    library, friction = systems.compact_library("single_pendulum"), ["theta_dot**2/2"]
    pushed = la.discover(stamped_late(seed), library, dissipation=friction)
    assert pushed.fit.status == "usable"
    (late,) = findings_of(pushed, "late-forces")
    assert late.values["delay"] == pytest.approx(-0.01, rel=0.2)
    assert not late.values["half_a_sample"]
    cured = la.delay.shift_forces(stamped_late(seed), -0.01)
    assert la.discover(cured, library, dissipation=friction).fit.status == "ok"


@pytest.mark.thorough
def test_a_half_sample_reads_as_held():
    data = systems.generate("single_pendulum", noise=0.001, trials=4, duration=20.0, seed=6)
    early = la.delay.shift_forces(data, -0.005)
    pushed = la.discover(early, systems.compact_library("single_pendulum"))
    (late,) = findings_of(pushed, "late-forces")
    assert late.values["half_a_sample"]
