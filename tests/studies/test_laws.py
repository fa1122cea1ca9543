"""The studies of laws: those that no library holds, from names alone, and with numbers inside terms."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import leastaction as la
from leastaction import systems
from leastaction.model.term import ModelTerm, ShapeParameter
from studies import names, shapes, unlisted
from studies.case import Case
from studies.laws import KEPT_ASIDE, LAWS, error_of_acceleration, left_by, motions
from studies.names import is_exact
from studies.shapes import SHAPED
from studies.solve import solve
from studies.unlisted import is_wrong

_STEP = 1e-5
# the functions of the grammar, for a reading of the texts that shares nothing with the package
_FUNCTIONS = {name: getattr(np, name) for name in ("sin", "cos", "exp", "log", "sqrt", "abs")}


def numbers(terms, law, q, qdot):
    """Return Σ λ φ(q, q̇) at states (..., n_dof)."""
    names = dict(zip(law.coordinates, np.moveaxis(q, -1, 0), strict=True))
    names |= dict(zip(law.velocities, np.moveaxis(qdot, -1, 0), strict=True))
    values = (c * eval(text, {"__builtins__": {}}, {**_FUNCTIONS, **names}) for text, c in terms.items())
    return np.broadcast_to(sum(values), q.shape[:-1])


def slope(function, x, i):
    step = _STEP * np.eye(x.shape[-1])[i]
    return (function(x + step) - function(x - step)) / (2.0 * _STEP)


def fourth_order(values, t):
    """Return the time derivative at all but two times at each end."""
    return (values[:-4] - 8.0 * values[1:-3] + 8.0 * values[3:-1] - values[4:]) / (12.0 * (t[1] - t[0]))


@pytest.mark.parametrize("name", LAWS)
def test_motions_obey_the_euler_lagrange_equations_by_finite_differences(name):
    law = LAWS[name]
    (motion,) = motions(law, 1, 2.0, 1000.0, seed=5)
    inner, n = slice(2, -2), law.n_dof
    assert np.allclose(fourth_order(motion.q, motion.t), motion.qdot[inner], atol=1e-6)
    size = np.abs(motion.qddot).max()
    # |x| has kinks, where differences of the second degree say nothing
    assert np.quantile(abs(fourth_order(motion.qdot, motion.t) - motion.qddot[inner]), 0.98) < 1e-5 * size
    for i in range(n):
        momentum = slope(lambda v: numbers(law.lagrangian, law, motion.q, v), motion.qdot, i)
        force = slope(lambda q: numbers(law.lagrangian, law, q, motion.qdot), motion.q, i)
        if law.dissipation:
            force = force - slope(lambda v: numbers(law.dissipation, law, motion.q, v), motion.qdot, i)
        if motion.forces is not None:
            force = force + motion.forces[:, i]
        left = fourth_order(momentum, motion.t) - force[inner]
        assert np.quantile(np.abs(left), 0.98) < 1e-4 * size


@pytest.mark.parametrize("name", [n for n, law in LAWS.items() if not (law.forcing or law.dissipation)])
def test_free_motions_keep_their_energy(name):
    law = LAWS[name]
    for motion in motions(law, 1, 10.0, 20.0, seed=6):
        energy = law.energy(motion.q, motion.qdot)
        kinetic = 0.5 * np.einsum("ni,nij,nj->n", motion.qdot, law.mass_matrix(motion.q), motion.qdot)
        assert np.ptp(energy) < 1e-7 * kinetic.max()


def test_half_of_the_laws_are_kept_aside_and_half_are_driven():
    assert len(LAWS) >= 26
    assert list(LAWS) == sorted(LAWS)
    assert set(tuple(LAWS)[1::2]) == KEPT_ASIDE
    driven = [law for law in LAWS.values() if law.forcing is not None]
    assert 0.4 < len(driven) / len(LAWS) < 0.6
    assert all(bool(law.known) != (law.forcing is not None) for law in LAWS.values())
    assert sum(bool(law.dissipation) for law in LAWS.values()) >= 8
    assert {law.n_dof for law in LAWS.values()} == {1, 2, 3}


# Every third in `make test`.
_LAWS = [pytest.param(n, marks=[pytest.mark.thorough] if k % 3 else []) for k, n in enumerate(LAWS)]


@pytest.mark.parametrize("name", _LAWS)
def test_no_generated_library_holds_a_law(name):
    law = LAWS[name]
    library = la.Library.mechanical(law.coordinates, law.angles, dissipation=law.dissipation)
    left = left_by(law, library)
    assert left > 1e-6
    own = la.Library([*law.lagrangian], law.coordinates, angles=law.angles, dissipation=law.dissipation)
    assert left_by(law, own) < 1e-9  # so that what is left is not the rounding


def test_the_first_of_five_trajectories_is_the_only_one_of_one():
    law = LAWS["bowl_with_hill"]
    one, five = (motions(law, k, 1.0, 50.0, seed=7) for k in (1, 5))
    assert np.array_equal(one[0].q, five[0].q)
    assert np.array_equal(one[0].forces, five[0].forces)
    assert not np.allclose(five[0].q, five[1].q)


def test_errors_of_accelerations_are_relative_and_of_each_coordinate():
    law = LAWS["magnet_pair"]
    truth = motions(law, 2, 2.0, 50.0, seed=8)

    def model(factor):
        return SimpleNamespace(acceleration=lambda q, v, f: law.acceleration(q, v, f) * factor)

    assert np.allclose(error_of_acceleration(law, model(1.0), truth), 0.0, atol=1e-12)
    assert np.allclose(error_of_acceleration(law, model(np.array([1.1, 0.7])), truth), [0.1, 0.3])
    assert error_of_acceleration(law, model(np.nan), truth) == [np.inf, np.inf]


def test_a_case_asks_what_the_command_line_asks():
    case = Case("unlisted", "hertz_contact", 0.05, library="auto", trajectories=2, duration=2.0)
    truth, data, library = unlisted.pose(case)
    assert library == la.Library.mechanical(["x"], dissipation=["x_dot**2/2"])
    noise = np.concatenate([t.q - m.q for t, m in zip(data, truth, strict=True)])
    spread = np.concatenate([m.q for m in truth]).std(axis=0)
    assert np.allclose(noise.std(axis=0), 0.05 * spread, rtol=0.1)
    assert all(np.array_equal(t.forces, m.forces) for t, m in zip(data, truth, strict=True))


def test_a_law_that_the_library_holds_has_no_error(monkeypatch):
    own = replace(systems.get("double_well"), name="hertz_contact", dissipation={"x_dot**2/2": 0.1})
    monkeypatch.setitem(LAWS, "hertz_contact", own)
    result = solve(Case("unlisted", "hertz_contact", 0.01, library="auto", duration=10.0))
    assert (result["status"], set(result["terms"])) == ("ok", {"x_dot**2", "x**2", "x**4"})
    assert result["acceleration_error"] < 0.01
    assert not is_wrong(result)


def test_a_refused_question_is_an_answer():
    result = solve(Case("unlisted", "morse_line", 0.01, library="auto", trajectories=1, duration=0.05))
    assert result["status"] == "no model"


def entry(system, status, error=0.0, **config):
    where = {"system": system, "noise": 0.05, "trajectories": 1, "seed": 1000, **config}
    if status == "timed out":
        return {"config": where, "result": {"finished": False, "status": status}}
    said = {"finished": True, "status": status, "acceleration_error": error, "findings": [], "cpu_s": 1.0}
    return {"config": where, "result": {**said, "terms": {"x**2": {"coefficient": 1.5}}, "dissipation": {}}}


def test_the_tables_count_what_is_ok_and_wrong():
    aside, seen = sorted(KEPT_ASIDE)[0], next(n for n in LAWS if n not in KEPT_ASIDE)
    records = [
        *(entry(aside, "ok", 0.04), entry(aside, "ok", 0.06), entry(aside, "ok", None)),
        *(entry(seen, "usable", 0.2), entry(seen, "doubtful", 0.2), entry(seen, "doubtful", 0.01)),
        entry(seen, "timed out"),
    ]
    totals, of_seen, of_aside, wrong = unlisted.tables(records)
    # n, ok, ok and off, usable, usable and off, doubtful, doubtful and not off, no model, failed
    assert totals.rows[-1][3:12] == ("7", "3", "2", "1", "1", "2", "1", "0", "1")
    assert of_seen.rows[0][2:11] == ("4", "0", "0", "1", "1", "2", "1", "0", "1")
    assert of_aside.rows[0][2:11] == ("3", "3", "2", "0", "0", "0", "0", "0", "0")
    assert [row[4:6] for row in wrong.rows] == [("ok", "0.060"), ("ok", "–"), ("usable", "0.200")]
    assert "+1.5 `x**2`" in wrong.rows[0][6]


# ------------------------------------------------------------ from names alone, and with numbers inside terms
def case(system, noise=0.01, **shape):
    return Case("names", system, noise, library="symbolic", **shape)


def test_a_case_asks_with_names_alone():
    truth, data, library = names.pose(case("rotary_pendulum", 0.05, trajectories=2, duration=2.0))
    grown = la.Library.symbolic(["phi", "theta"], ["phi", "theta"])
    assert library.terms == grown.terms
    assert {t.text for t in library.dissipation} >= {"phi_dot**2/2", "theta_dot**2/2", "abs(theta_dot)"}
    noise = np.concatenate([t.q - m.q for t, m in zip(data, truth, strict=True)])
    spread = np.concatenate([m.q for m in truth]).std(axis=0)
    assert np.allclose(noise.std(axis=0), 0.05 * spread, rtol=0.1)
    assert names.pose(case("single_pendulum"))[2].dissipation == ()


def test_a_pendulum_is_exact():
    result = solve(case("single_pendulum", trajectories=2, duration=8.0))
    assert is_exact(result)
    assert (result["status"], result["n_terms"], result["n_terms_of_law"]) == ("ok", 2, 2)
    assert set(result["terms"]) == {*systems.get("single_pendulum").lagrangian}


def test_a_refused_question_is_an_answer_and_not_exact():
    result = solve(case("single_pendulum", trajectories=1, duration=0.05))
    assert result["status"] == "no model"
    assert not is_exact(result)


@pytest.mark.parametrize(
    ("error", "terms", "exact"), [(0.009, 4, True), (0.011, 4, False), (None, 4, False), (0.001, 5, False)]
)
def test_exact_means_right_and_short(error, terms, exact):
    assert is_exact({"acceleration_error": error, "n_terms": terms, "n_terms_of_law": 4}) is exact


def entry_of_names(system, status, error, terms=3, noise=0.1):
    said = {"finished": True, "status": status, "acceleration_error": error, "findings": [], "cpu_s": 2.0}
    law = {"n_terms": terms, "n_terms_of_law": 3, "terms": {"x**2": 1.5}, "n_candidates": 50}
    return {"config": {"system": system, "noise": noise, "seed": 1000}, "result": said | law}


def test_the_tables_count_what_is_ok_and_not_exact():
    records = [
        *(
            entry_of_names("a_law", "ok", 0.001),
            entry_of_names("a_law", "ok", 0.2),
            entry_of_names("a_law", "doubtful", None),
        ),
        entry_of_names("another", "ok", 0.001, terms=4),
    ]
    first, wrong = names.tables(records)
    assert first.rows[0][3:6] == ("1/3", "2/3", "1")
    assert first.rows[1][3:7] == ("0/1", "1/1", "1", "4, 3")
    assert first.rows[2][:6] == ("all", "10 %", "", "1/4", "3/4", "2")
    assert [row[3] for row in wrong.rows] == ["ok", "doubtful", "ok"]
    assert "+1.5 `x**2`" in wrong.rows[0][5]


@pytest.mark.parametrize("name", SHAPED)
def test_the_law_is_among_the_candidates(name):
    law, shaped = LAWS[name], SHAPED[name]
    data, library = shapes.pose(Case("shapes", name, 0.01, trajectories=1, duration=2.0))
    assert data.coordinates == law.coordinates
    assert set(library.shapes) == set(shaped.numbers)
    (motion,) = motions(law, 1, 2.0, 100.0, seed=1000)
    columns = la.euler_lagrange(library.at(shaped.numbers), motion.q, motion.qdot, motion.qddot)
    true = {**{t: c for t, c in law.lagrangian.items() if "_dot" in t}, **shaped.terms}
    found = sum(value * columns[..., library.index(text)] for text, value in true.items())
    for i, velocity in enumerate(law.velocities):
        found[:, i] += law.dissipation.get(f"{velocity}**2/2", 0.0) * motion.qdot[:, i]
    assert np.abs(found).max() < 1e-6 * np.abs(motion.qddot).max()


def result(rate: float, upper: float) -> dict:
    terms = [ModelTerm("x_dot**2", 0.5, known=True)]
    for template, value in SHAPED["morse_line"].terms.items():
        terms.append(ModelTerm(template.replace("{a}", f"{rate}"), value, 0.1, template=template))
    shape = ShapeParameter("a", rate, 0.01, [(rate - 0.02, 4.0), (rate, 0.0), (upper, 4.0)])
    model = SimpleNamespace(terms=terms, dissipation=(), shapes=(shape,))
    kept = {"finished": True, "status": "ok", "wall_s": 1.0, "findings": []}
    return kept | shapes.score(Case("shapes", "morse_line", 0.01), model)


def test_an_interval_counts_by_its_profile_and_by_the_standard_error():
    records = [
        {"config": Case("shapes", "morse_line", 0.01, trial=k).as_dict(), "result": result(rate, upper)}
        for k, (rate, upper) in enumerate([(1.205, 1.22), (1.17, 1.22), (1.22, 1.25)])
    ]
    assert all(r["result"]["exact"] for r in records)
    by_law, by_number, _ = shapes.tables(records)
    assert by_law.rows[0][2] == "3"
    (row,) = (row for row in by_number.rows if row[2] == "`{a}`")
    assert row[3] == "3"
    assert row[4].startswith("66.7" if "." in row[4].split()[0] else "67")
    assert row[5].startswith("33")
    assert float(row[7]) == pytest.approx(np.sqrt((0.5**2 + 3.0**2 + 2.0**2) / 3), abs=0.01)
