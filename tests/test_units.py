"""Units of coefficients against those known from physics, and what does not fit."""

import sys

import pytest

import leastaction as la
from leastaction import InputError
from leastaction.model.model import LagrangianModel, ModelTerm

CART = la.Library(
    ["x_dot**2", "theta_dot**2", "x_dot*theta_dot*cos(theta)", "x**2", "x", "cos(theta)"], ["x", "theta"]
)
SI = {"x": "m", "theta": "rad"}


def units(what, *args, **options):
    return {item.expression: item.unit for item in la.units.check(what, *args, **options)}


def same(text, other):
    """Whether two texts mean the same unit."""
    import pint

    registry = pint.UnitRegistry()
    return abs((1 * registry.Unit(text) / registry.Unit(other)).to("").magnitude - 1.0) < 1e-12


def test_mechanics_in_si():
    found = units(CART, SI)
    expected = {
        "x_dot**2": "kg",
        "theta_dot**2": "kg*m**2",
        "x_dot*theta_dot*cos(theta)": "kg*m",
        "x**2": "N/m",
        "x": "N",
        "cos(theta)": "J",
    }
    assert set(found) == set(expected)
    for expression, unit in expected.items():
        assert same(found[expression].replace("·", "*"), unit), expression


def test_the_units_of_the_data_are_kept():
    """In mm, N and ms no factor hides in a coefficient."""
    library = la.Library(["x_dot**2", "x**2", "sqrt(x**2+4)"], ["x"]).with_dissipation(
        ["x_dot**2/2", "abs(x_dot)"]
    )
    found = units(library, {"x": "mm"}, {"x": "N"}, time="ms")
    assert found == {
        "x_dot**2": "N·ms²/mm",
        "x**2": "N/mm",
        "sqrt(x**2+4)": "N",
        "x_dot**2/2": "N·ms/mm",
        "abs(x_dot)": "N",
    }


def test_model_with_a_scale_of_its_own():
    model = LagrangianModel(
        ["theta"],
        [ModelTerm("theta_dot**2", 1.0, known=True), ModelTerm("cos(theta)", 9.8, 0.1)],
        [ModelTerm("sqrt(theta_dot**2+9/10000)", 0.2, 0.01)],
    )
    # L over half the inertia: the coefficient of the cosine is 2 g / l, that of Coulomb friction alike.
    found = la.units.check(model, {"theta": "rad"}, energy="rad**2/s**2")
    assert [(item.kind, item.unit) for item in found] == [
        ("lagrangian", "1"),
        ("lagrangian", "1/s²"),
        ("dissipation", "1/s²"),
    ]
    assert found[0].expression == "theta_dot**2"


def test_numbers_that_are_added_fit():
    library = la.Library(
        ["sqrt(x_dot**2+0.01)", "log(1+theta**2)", "(x+1)**2", "exp(-theta)"], ["x", "theta"]
    )
    assert units(library, SI)["(x+1)**2"] == units(CART, SI)["x**2"]


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (
            "cos(x)",
            r"cos\(x\): the argument x has the unit m; expected a pure number: measure it in units of",
        ),
        ("exp(-x)", r"exp\(-x\): the argument -x has the unit m"),
        ("log(x**2)", r"the argument .* has the unit m"),
        ("cos(theta_dot)", r"the argument theta_dot has the unit 1/s"),
        ("sin(theta*x)", r"has the unit m"),
        ("log(1+x**2)", r"has the unit m²"),
        (
            "(x+theta)**2",
            r"adds (theta \(1\) and x \(m\)|x \(m\) and theta \(1\)); what is added must have one unit",
        ),
    ],
)
def test_terms_that_make_no_sense(term, message):
    library = la.Library(["x_dot**2", term], ["x", "theta"])
    with pytest.raises(InputError, match=message):
        la.units.check(library, SI)
    # In units of a length of the system the same terms are right.
    assert len(la.units.check(library, {"x": "1", "theta": "1"}, time="1", energy="1")) == 2


def test_degrees_are_refused():
    with pytest.raises(InputError, match=r"theta has the unit (deg|°); functions take radians"):
        la.units.check(CART, {"x": "m", "theta": "degree"})
    with pytest.raises(InputError, match="functions take radians"):
        la.units.check(CART, {"x": "m", "theta": "turn"})


def test_forces_have_to_agree_with_the_energy():
    assert units(CART, SI, {"x": "N", "theta": "N*m"}) == units(CART, SI, {"x": "N"})
    for forces, energy, message in [
        (
            {"x": "N", "theta": "N"},
            None,
            "the force on theta in N times theta is N, not force times coordinate",
        ),
        ({"x": "N", "theta": "N*mm"}, None, "but for a factor"),
        ({"x": "N"}, "mJ", "is N·m, not the energy in mJ, but for a factor"),
        ({"x": "N*m"}, "J", "not the energy in J; check the units"),
    ]:
        with pytest.raises(InputError, match=message):
            la.units.check(CART, SI, forces, energy=energy)


@pytest.mark.parametrize(
    "text",
    [
        "",
        " ",
        "meters!",
        "foo",
        "m**99**99",
        "2**2**9",
        "(9)**9",
        "m**(2)",
        "10000*m",
        "__import__('os')",
        "m;s",
        "m" * 200,
        3,
        None,
        "m**-",
        "kg*(m",
        "lambda: 1",
        "nan",
        "9**9*m",
    ],
)
def test_texts_that_are_no_units(text):
    with pytest.raises(InputError, match="the unit of x is") as caught:
        la.units.check(CART, {"x": text, "theta": "rad"})
    assert "\n" not in str(caught.value)


def test_bad_arguments(monkeypatch):
    with pytest.raises(InputError, match="the unit of theta is missing"):
        la.units.check(CART, {"x": "m"})
    with pytest.raises(InputError, match="'phi' is no coordinate"):
        la.units.check(CART, SI | {"phi": "rad"})
    with pytest.raises(InputError, match="'y' is no coordinate"):
        la.units.check(CART, SI, {"y": "N"})
    with pytest.raises(InputError, match="which is not a time"):
        la.units.check(CART, SI, time="m")
    with pytest.raises(InputError, match="pass a model or a Library"):
        la.units.check("x**2", SI)
    la.units._registry.cache_clear()
    monkeypatch.setitem(sys.modules, "pint", None)
    with pytest.raises(ImportError, match=r"pip install 'leastaction\[units\]'"):
        la.units.check(CART, SI)
