"""The study of numbers inside terms: its cases can be posed, its laws are written right, its tables count."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import leastaction as la
from leastaction.model.term import ModelTerm, ShapeParameter
from studies import shapes
from studies.case import Case
from studies.laws import LAWS, motions
from studies.shapes import SHAPED


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
