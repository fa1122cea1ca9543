"""The study of laws from names alone."""

from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from leastaction import systems
from studies import names
from studies.case import Case
from studies.names import is_exact, pose
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
