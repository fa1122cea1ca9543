"""Groups of trials: which coefficients differ between them; and structures that are fitted again."""

from __future__ import annotations

import ast
import json
from dataclasses import replace

import numpy as np
import pytest

import leastaction as la
from helpers import DUFFING_LIBRARY, KINETIC, SMALL, duffing, euler_lagrange, findings_of, pendulum, record
from leastaction import systems
from leastaction.curve.bspline import uniform_grid
from leastaction.errors import DataError, InputError
from leastaction.estimation.groups import GroupedColumns, GroupTerm
from leastaction.estimation.intervals import first_points, points_at
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
