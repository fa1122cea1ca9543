"""Terms with unknown numbers that would help are named, and lead to the law when they are added."""

from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from tests.helpers import free_motions


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
            lambda x: 6.0 * (np.exp(-2.4 * x) - np.exp(-1.2 * x)),
            (0.5, 0.9, 1.6),
            ("exp(-{a}*x)", "exp(-2*{a}*x)"),
            {"a": 1.2},
        ),
        (
            lambda x: -2.0 * x / (x**2 + 0.04) ** 1.5,
            (0.5, 0.9, 1.6),
            ("1/sqrt((x-{p})**2+{h}**2)",),
            {"p": 0.0, "h": 0.2},
        ),
    ],
    ids=["Morse", "soft Coulomb"],
)
def test_the_terms_that_are_named_lead_to_the_law(force, starts, texts, numbers):
    runs, powers = free_motions(force, starts), ["x_dot**2", "x", "x**2", "x**3", "x**4"]
    doubtful = la.discover(runs, powers, known={"x_dot**2": 0.5})
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


def test_nothing_is_named_where_no_family_helps():
    """A step in the force is none of the dictionary."""
    runs = free_motions(lambda x: -2.0 * x - 3.0 * np.tanh(30.0 * (x - 0.2)), (0.5, 0.9, 1.3))
    model = la.discover(runs, ["x_dot**2", "x", "x**2"], known={"x_dot**2": 0.5})
    assert model.fit.status == "doubtful"
    assert not _named(model)
