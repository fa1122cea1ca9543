"""Columns of candidates with shape parameters: those of the plain candidates with the numbers typed."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import leastaction as la
from helpers import terms
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

TWO = ["x", "y"]
CASES = [
    ("exp(-{a}*x)", "lagrangian"),
    ("x**{a}*y", "lagrangian"),
    ("x_dot**2*cos({a}*x-{b})", "lagrangian"),
    ("x_dot*y_dot/(x+{a}**2)", "lagrangian"),
    ("1/sqrt((x-{b})**2+(y-{a})**2)", "lagrangian"),
    ("y_dot*exp(-(x-{a})**2)", "lagrangian"),
    ("exp({b}*y)*x_dot**2/2", "dissipation"),
    ("sqrt(x_dot**2+{a}**2)", "dissipation"),
]
NUMBERS = [{"a": 0.7, "b": 1.3}, {"a": -1.1, "b": 0.25}, {"a": 2.0, "b": -3.0}]


def points(rng: np.random.Generator) -> Points:
    """Positive coordinates: powers are defined."""
    return Points(rng.uniform(0.3, 1.4, (9, 2)), rng.uniform(-2, 2, (9, 2)), rng.uniform(-3, 3, (9, 2)))


def assert_close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("at", NUMBERS, ids=str)
@pytest.mark.parametrize(("text", "kind"), CASES)
def test_numbers_in_place_are_numbers_typed(text, kind, at, rng):
    (template,) = terms([text], TWO, kind)
    put = template.at(at)
    numbered, plain = EulerLagrange([put], TWO), EulerLagrange(terms([put.text], TWO, kind), TWO)
    assert plain.terms[0].template is None
    here = points(rng)
    assert_close(numbered.weak(here), plain.weak(here))
    assert_close(numbered.strong(here), plain.strong(here))
    assert_close(numbered.mass_of(0, here), plain.mass_of(0, here))
    slopes, expected = (c.jacobian(here, np.array([1.7])) for c in (numbered, plain))
    for key in {*slopes, *expected}:
        assert_close(slopes.get(key, 0.0) + np.zeros(9), expected.get(key, 0.0) + np.zeros(9))


def test_several_numbers_at_the_same_points_do_not_mix(rng):
    """Points keep shared parts such as √(…); those of other numbers are other parts."""
    (template,) = terms(["exp(-{a}*x)"], TWO)
    here = points(rng)
    both = [template.at({"a": a}) for a in (0.5, 2.0)]
    together = EulerLagrange(both, TWO).strong(here)
    assert_close(together[:, 0], [a * np.exp(-a * here.columns[0]) for a in (0.5, 2.0)])


def test_numbered_columns_travel_between_processes(rng):
    (template,) = terms(["x_dot**2*exp(-{a}*x)"], TWO)
    columns = EulerLagrange([template.at({"a": 0.5})], TWO)
    here = points(rng)
    assert_close(pickle.loads(pickle.dumps(columns)).strong(here), columns.strong(here))


def test_the_public_operator_needs_numbers():
    library = la.Library(["x_dot**2/2", "exp(-{a}*x)"], ["x"])
    with pytest.raises(la.InputError, match="no number for the shape parameter 'a'"):
        la.euler_lagrange(library, [[0.5]], [[1.0]], [[2.0]])
    found = la.euler_lagrange(library.at({"a": 2.0}), [[0.5]], [[1.0]], [[2.0]])
    assert_close(found, [[[2.0, 2.0 * np.exp(-1.0)]]])
