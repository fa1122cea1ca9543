"""Where shape parameters begin: an anchor beside a generated library, from the weak form alone."""

from __future__ import annotations

import numpy as np
import pytest

from helpers import record
from leastaction.estimation.build import Request, build_problem
from leastaction.library import Library
from leastaction.selection.search_state import Search, begin_search
from leastaction.selection.strategies import shape_start

ANCHOR = np.array([0.3, -0.4])
DISTANCE = "sqrt((x-{p})**2+(y-{r})**2)"


def acceleration(q, v, f):
    """A spring of rest length one about the anchor, and gravity."""
    away = q - ANCHOR
    distance = np.hypot(*away)
    return -4.0 * (distance - 1.0) * away / distance + np.array([0.0, -1.0])


@pytest.fixture(scope="module")
def search() -> Search:
    """Motions around the anchor, on all sides of it."""
    starts = [([1.6, 0.2], [0.3, 1.5]), ([-0.7, -1.1], [1.2, -0.6]), ([0.4, 1.2], [-1.3, 0.2])]
    data = record(acceleration, starts, ["x", "y"], duration=8.0, rate=40.0, noise=0.005, seed=4)
    q = np.concatenate([run.q for run in data])
    assert np.all((q.min(axis=0) < ANCHOR) & (q.max(axis=0) > ANCHOR))
    library = Library([*Library.mechanical(["x", "y"]), DISTANCE], ["x", "y"])
    return begin_search(build_problem(data, Request(library, {"x_dot**2": 0.5})))


@pytest.fixture(scope="module")
def started(search) -> Search:
    return shape_start.run(search)


def test_the_anchor_is_found_inside_the_data(started):
    found = started.problem.shape_values
    np.testing.assert_allclose([found["p"], found["r"]], ANCHOR, atol=0.05)


def test_every_problem_of_the_search_has_the_numbers(search, started):
    found = started.problem.shape_values
    assert started.searched.shape_values == found
    assert started.grid.problem.shape_values == found
    assert started.fit is None  # nothing was fitted yet
    texts = [term.text for term in started.problem.terms]
    assert texts.index(DISTANCE.format(p=found["p"], r=found["r"]).replace("--", "+")) == len(texts) - 1
    assert search.problem.shape_values != found  # values are not changed in place


def test_the_same_start_every_time(search, started):
    assert shape_start.run(search).problem.shape_values == started.problem.shape_values


def test_a_problem_without_shapes_is_left_alone():
    data = record(lambda q, v, f: -q, [([1.0], [0.0])], ["x"], duration=4.0, noise=0.01)
    plain = begin_search(build_problem(data, Request(["x_dot**2", "x**2"], {"x_dot**2": 0.5})))
    assert shape_start.run(plain) is plain
    assert plain.problem.ranges == {}
