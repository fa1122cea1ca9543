"""The studies of laws from names alone, and of numbers inside terms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import leastaction as la
from leastaction import systems
from leastaction.model.term import ModelTerm, ShapeParameter
from studies import names, shapes
from studies.case import Case
from studies.laws import LAWS, motions
from studies.names import is_exact, pose
from studies.shapes import SHAPED
from studies.solve import solve


def case(system, noise=0.01, **shape):
    return Case("names", system, noise, library="symbolic", **shape)


def test_a_case_asks_with_names_alone():
    truth, data, library = pose(case("rotary_pendulum", 0.05, trajectories=2, duration=2.0))
    grown = la.Library.symbolic(["phi", "theta"], ["phi", "theta"])
    assert library.terms == grown.terms
    assert {t.text for t in library.dissipation} >= {"phi_dot**2/2", "theta_dot**2/2", "abs(theta_dot)"}
    noise = np.concatenate([t.q - m.q for t, m in zip(data, truth, strict=True)])
    spread = np.concatenate([m.q for m in truth]).std(axis=0)
    assert np.allclose(noise.std(axis=0), 0.05 * spread, rtol=0.1)
    assert pose(case("single_pendulum"))[2].dissipation == ()


def test_a_pendulum_is_exact():
    result = solve(case("single_pendulum", trajectories=2, duration=8.0))
    assert is_exact(result)
    assert (result["status"], result["n_terms"], result["n_terms_of_law"]) == ("ok", 2, 2)
    assert set(result["terms"]) == {*systems.get("single_pendulum").lagrangian}


def test_a_refused_question_is_an_answer():
    result = solve(case("single_pendulum", trajectories=1, duration=0.05))
    assert result["status"] == "no model"
    assert not is_exact(result)


@pytest.mark.parametrize(
    ("error", "terms", "exact"), [(0.009, 4, True), (0.011, 4, False), (None, 4, False), (0.001, 5, False)]
)
def test_exact_means_right_and_short(error, terms, exact):
    assert is_exact({"acceleration_error": error, "n_terms": terms, "n_terms_of_law": 4}) is exact


def entry(system, status, error, terms=3, noise=0.1):
    said = {"finished": True, "status": status, "acceleration_error": error, "findings": [], "cpu_s": 2.0}
    law = {"n_terms": terms, "n_terms_of_law": 3, "terms": {"x**2": 1.5}, "n_candidates": 50}
    return {"config": {"system": system, "noise": noise, "seed": 1000}, "result": said | law}


def test_the_tables_count_what_is_ok_and_not_exact():
    records = [
        *(entry("a_law", "ok", 0.001), entry("a_law", "ok", 0.2), entry("a_law", "doubtful", None)),
        entry("another", "ok", 0.001, terms=4),
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
