"""Simple numbers inside intervals: offered where they are true, hardly ever by chance."""

from __future__ import annotations

import math

import numpy as np
import pytest

from leastaction import LagrangianModel, discover, systems
from leastaction.model.constants import Offer
from leastaction.model.term import ModelTerm, ShapeParameter
from leastaction.model.text import simple_lines


def law(terms, errors, covariance=None, coordinates=("x", "y"), **fields):
    made = [ModelTerm(text, c, e, known=e == 0.0) for (text, c), e in zip(terms.items(), errors, strict=True)]
    return LagrangianModel(coordinates, made, covariance=covariance, **fields)


def offered(model) -> dict[str, str]:
    found = model.simple_constants.offers
    return {f"{o.subject} : {o.reference}" if o.reference else o.subject: o.text for o in found}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.5001, "1/2"),
        (-2.0002, "-2"),
        (6.2829, "2*pi"),
        (-1.41433, "-sqrt(2)"),
        (0.33335, "1/3"),
        (0.51, None),
    ],
)
def test_a_simple_number_is_offered_and_the_estimate_stays(value, text):
    model = law({"x_dot**2": value}, [2e-4 * abs(value)], coordinates=["x"])
    assert list(offered(model).values()) == ([] if text is None else [text])
    assert model.terms[0].coefficient == value
    for offer in model.simple_constants.offers:
        assert offer.lower < offer.number < offer.upper
        assert offer.chance < 0.025


def test_a_wide_interval_offers_nothing():
    narrow = law({"x_dot**2": 2.0}, [0.002], coordinates=["x"])
    wide = law({"x_dot**2": 2.0}, [0.02], coordinates=["x"])
    assert offered(narrow) == {"x_dot**2": "2"}
    assert offered(wide) == {}
    (offer,) = narrow.simple_constants.offers
    near = [4 / 3, 3 / 2, 2, 3, math.pi / 2, math.pi, math.sqrt(2)]
    assert offer.chance == pytest.approx(len(near) * math.log(offer.upper / offer.lower) / math.log(4))


def test_numbers_without_meaning_are_rarely_offered(rng):
    found = 0
    for _ in range(400):
        values = np.exp(rng.uniform(-1.5, 2.5, 6)) * rng.choice([-1.0, 1.0], 6)
        errors = np.abs(values) * 10.0 ** rng.uniform(-5.0, -2.0, 6)
        names = ("x_dot**2", "y_dot**2", "x**2", "y**2", "x**4", "exp(-x)")
        found += bool(offered(law(dict(zip(names, values.tolist(), strict=True)), errors)))
    assert found <= 20  # 5 %; 1.9 % of 3000 are


def test_ratios_do_not_depend_on_the_scale_of_the_law():
    errors = np.array([0.0137, 0.0274, 0.05])
    sizes = np.array([1.37, 2.74, 4.7])
    terms = dict(zip(("x_dot**2", "y_dot**2", "x**2"), sizes.tolist(), strict=True))
    common = np.outer(sizes, sizes) * 0.01**2 + np.diag(1e-8 * sizes**2)  # one per cent of scale in common
    model = law(terms, np.sqrt(np.diag(common)), common)
    assert offered(model) == {"y_dot**2 : x_dot**2": "2"}
    assert model.simple_constants.freedom == 1
    assert offered(law(terms, errors)) == {}
    known = law({**terms, "x_dot**2": 1.37}, [0.0, 0.0003, 0.05])
    assert offered(known) == {"y_dot**2 : x_dot**2": "2"}
    assert offered(law({"x_dot**2": 0.5, "y_dot**2": 1.0001}, [0.0, 1e-4])) == {"y_dot**2": "1"}


@pytest.mark.parametrize(
    ("one", "other"), [("x_dot**2", "x**2"), ("exp(-x)", "exp(-2*x)"), ("x**2", "x**3"), ("x", "cos(y)")]
)
def test_terms_of_other_units_have_no_ratio(one, other):
    assert offered(law({"x_dot**2+y_dot**2": 0.77, one: 1.37, other: 2.74}, [1e-4] * 3)) == {}


def test_angles_have_no_unit():
    options = {"provenance": {"options": {"angles": ["x", "y"]}}}
    terms = {"x_dot**2": 1.37, "x_dot*y_dot*cos(x-y)": 2.74}
    assert offered(law(terms, [1e-4] * 2, **options)) == {"x_dot**2 : x_dot*y_dot*cos(x-y)": "1/2"}


def test_offers_that_exclude_each_other_are_said_to():
    terms = {"x_dot**2": 1.0004, "y_dot**2": 0.9996}
    close = 0.00021**2 * np.array([[1.0, 0.999], [0.999, 1.0]])  # their difference is known far better
    found = law(terms, np.sqrt(np.diag(close)), close).simple_constants
    assert {o.text for o in found.offers} == {"1"}
    assert not found.compatible
    assert found.chi2 > 100.0
    assert "does not fit" in simple_lines(law(terms, np.sqrt(np.diag(close)), close))[-1]
    apart = law(terms, [0.00021] * 2).simple_constants
    assert apart.compatible
    assert apart.chi2 == pytest.approx(2 * (4 / 2.1) ** 2, rel=1e-6)


def test_shape_parameters():
    terms = [
        ModelTerm("x_dot**2", 0.77, 0.001),
        ModelTerm("abs(x)**3.0006", -2.31, 0.004, template="abs(x)**{n}"),
    ]
    shapes = [ShapeParameter("n", 3.0006, 0.0008)]
    model = LagrangianModel("x", terms, shapes=shapes)
    (offer,) = model.simple_constants.offers
    assert str(offer) == "{n} = 3.00060(80): 3"
    at_zero = LagrangianModel("x", terms, shapes=[ShapeParameter("n", 1e-5, 0.0008)])
    assert at_zero.simple_constants.offers == ()


def test_no_errors_no_offers():
    system = systems.get("kepler_orbit")
    exact = LagrangianModel(system.coordinates, [ModelTerm(k, c) for k, c in system.lagrangian.items()])
    assert exact.simple_constants.offers == ()
    assert simple_lines(exact) == []
    vague = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5, math.nan)])
    assert vague.simple_constants.offers == ()


def test_a_found_law():
    system = systems.get("double_pendulum")
    data = systems.generate("double_pendulum", noise=0.01, trials=3, duration=8.0, seed=1)
    model = discover(data, system.library, angles=system.angles)
    assert {o.text for o in model.simple_constants.offers} <= {"1", "2", "1/2"}
    assert "cos(theta1) : cos(theta2)" in offered(model)
    assert model.simple_constants.compatible
    assert all(isinstance(o, Offer) for o in model.simple_constants.offers)
