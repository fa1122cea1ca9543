"""A search that is stopped returns the best law so far."""

from __future__ import annotations

import pytest

import leastaction as la
from helpers import PENDULUM_LIBRARY, pendulum
from leastaction import systems


def stops_at(stage: str, count: int = 1):
    seen = 0

    def progress(now: str, details: dict) -> None:
        nonlocal seen
        seen += now == stage
        if seen == count:
            raise la.StopSearch

    return progress


@pytest.mark.parametrize(("stage", "count"), [("select", 1), ("select", 2), ("knots", 1)])
def test_the_best_law_so_far_comes_back(stage, count):
    data = systems.generate("cart_spring_pendulum", noise=0.01, trials=2, duration=6.0, seed=0)
    cart = systems.get("cart_spring_pendulum")
    model = la.discover(data, cart.library, known=cart.known, progress=stops_at(stage, count))
    assert model.fit.status == "doubtful"
    assert "stopped-early" in [finding.code for finding in model.fit.findings]
    assert {"x_dot**2", "theta_dot**2"} <= {term.expression for term in model.terms}


def test_nothing_comes_back_before_there_is_a_law():
    with pytest.raises(la.StopSearch):
        la.discover(pendulum(), PENDULUM_LIBRARY, progress=stops_at("prepare"))
