"""Legal data whose numbers are extreme end in a model or in a DataError or InputError, never in a warning.

Warnings are errors in all tests (pyproject.toml).
"""

from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from leastaction.errors import DataError, InputError

T = np.linspace(0.0, 8.0, 400)
LIBRARY = ["x_dot**2", "x**2", "x**4"]
KNOWN = {"x_dot**2": 0.5}


def spring(scale: float = 1.0, noise: float = 0.01, time: float = 1.0, force: float | None = None):
    """x = A cos 2t, in any units."""
    rng = np.random.default_rng(1)
    forces = None if force is None else force * np.cos(3.0 * T)[:, None]
    curves = [a * np.cos(2.0 * T) + noise * rng.standard_normal(T.size) for a in (1.0, 0.6)]
    return [la.Trajectory(time * T, scale * x[:, None], forces, ["x"]) for x in curves]


def one(*columns, names=("x",)):
    return [la.Trajectory(T, np.column_stack(columns), None, list(names))]


@pytest.mark.parametrize("scale", [1e-25, 1e-12, 1e9, 1e25])
@pytest.mark.parametrize("time", [1e-9, 1.0, 1e9])
def test_units_do_not_matter(scale, time):
    model = la.discover(spring(scale, time=time), LIBRARY, known=KNOWN)
    assert model.fit.status == "ok"
    found = {term.expression: term for term in model.terms}
    assert found.keys() == {"x_dot**2", "x**2"}
    stiffness = found["x**2"]
    assert abs(stiffness.coefficient * time**2 + 2.0) < 5.0 * stiffness.standard_error * time**2


@pytest.mark.parametrize("library", [["exp(x)"], ["x**12", "x_dot**8"]])
def test_candidates_of_huge_size_beside_the_law(library):
    scale = 100.0 if "exp(x)" in library else 1e8
    model = la.discover(spring(scale), ["x_dot**2", "x**2", *library], known=KNOWN)
    assert {term.expression for term in model.terms} == {"x_dot**2", "x**2"}
    assert model.fit.status == "ok"


@pytest.mark.parametrize(
    ("data", "library", "known", "says"),
    [
        (spring(1e60), LIBRARY, KNOWN, "coordinate 'x' is of the size 1e\\+60; use a unit"),
        (spring(1e-200), LIBRARY, KNOWN, "coordinate 'x' is of the size 1e-200; use a unit"),
        (spring(time=1e-80), LIBRARY, KNOWN, "the sampling interval is of the size 2e-82"),
        (spring(force=1e150), LIBRARY, {}, "the force on 'x' is of the size 1e\\+150"),
        (spring(force=1e-150), LIBRARY, {}, "the force on 'x' is of the size 1e-150"),
        (spring(), LIBRARY, {"x_dot**2": 1e200}, "the known coefficient of .* is 1e\\+200"),
        (spring(), LIBRARY, {"x_dot**2": 1e-200}, "the known coefficient of .* is 1e-200"),
        (spring(100.0), ["x_dot**2", "x**2", "exp(10*x)"], KNOWN, "exp\\(10\\*x\\) is undefined"),
        (spring(100.0), ["x_dot**2", "x**2", "exp(7*x)"], KNOWN, "exp\\(7\\*x\\) reaches .* overflows"),
        (one(np.full(T.size, 3.0)), LIBRARY, KNOWN, "coordinate 'x' is constant"),
    ],
)
def test_what_cannot_be_computed_is_refused_by_name(data, library, known, says):
    with pytest.raises((DataError, InputError), match=says):
        la.discover(data, library, known=known)


def rest_in_between():
    x = np.cos(2.0 * T)
    x[100:250] = x[100]
    return x


@pytest.mark.parametrize(
    "data",
    [
        one(rest_in_between()),
        one(3.0 + 1e-9 * np.random.default_rng(2).standard_normal(T.size)),
        one(1e9 + np.cos(2.0 * T)),
        one(np.random.default_rng(3).standard_normal(T.size)),
    ],
    ids=["at rest in between", "noise on a constant", "far from zero", "noise"],
)
def test_data_that_do_not_follow_the_candidates_are_doubtful(data):
    model = la.discover(data, LIBRARY, known=KNOWN)
    assert model.fit.status != "ok"
    assert all(np.isfinite(term.coefficient) for term in model.terms)


@pytest.mark.parametrize("library", [["x_dot**2", "y_dot**2", "x**2", "y**2"], ["x_dot**2", "x**2"]])
@pytest.mark.parametrize("scales", [(1.0, 1.0), (1e9, 1e-12)])
def test_a_coordinate_that_nothing_known_reaches(library, scales):
    """The scale of the equation of y is open, or it has no term at all."""
    rng = np.random.default_rng(4)
    x, y = (
        s * (np.cos(w * T) + 0.01 * rng.standard_normal(T.size))
        for s, w in zip(scales, (2.0, 3.0), strict=True)
    )
    model = la.discover(one(x, y, names="xy"), library, known=KNOWN)
    assert model.fit.status != "ok"
    assert all(np.isfinite([term.coefficient, term.standard_error]).all() for term in model.terms)
