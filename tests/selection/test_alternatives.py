"""Structures beside the chosen one: those whose equations can be solved, and some of the same size."""

from __future__ import annotations

import pytest

import leastaction as la
from studies import solve
from studies.case import Case


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_small_motion_leaves_rivals_although_terms_that_cancel_the_known_one_fit_best(noise):
    """With small θ cos θ₂ and cos² θ₂ are one; cos² θ₁ alone cancels the known cos θ₁."""
    case = Case("faults", "chaotic_pendulum", noise, "excitation", "compact", 0)
    question, _ = solve.pose(case)
    model = la.discover(question.data, question.library, known=question.known)
    assert model.fit.status == "doubtful"
    assert "competing-structures" in {finding.code for finding in model.fit.findings}
