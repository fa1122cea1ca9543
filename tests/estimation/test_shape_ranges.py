"""Where shape parameters are looked for: the part that each plays, and what the user says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers import terms
from leastaction.errors import InputError
from leastaction.estimation.shape_ranges import ShapeRange, shape_ranges

COORDINATES = ["x", "y"]


def states(size: float = 1.0, shift: float = 0.0) -> dict[str, np.ndarray]:
    """x between shift ± size, y between ± 3."""
    t = np.linspace(0.0, 40.0, 400)
    return {
        "x": shift + size * np.sin(t),
        "y": 3.0 * np.cos(0.7 * t),
        "x_dot": size * np.cos(t),
        "y_dot": -2.1 * np.sin(0.7 * t),
    }


def range_of(text: str, data=None, given=None) -> ShapeRange:
    found = shape_ranges(terms([text], COORDINATES), data or states(), given or {})
    return next(iter(found.values()))


@pytest.mark.parametrize("size", [0.01, 1.0, 300.0])
@pytest.mark.parametrize("text", ["exp(-{a}*x)", "cos({a}*x)", "x_dot**2*sin({a}*x)"])
def test_a_rate_is_compared_with_one_over_the_coordinate(text, size):
    found = range_of(text, states(size))
    assert found.spacing == "log"
    assert not found.bounded
    assert found.high / found.low == pytest.approx(100.0)
    assert np.sqrt(found.low * found.high) * size == pytest.approx(np.sqrt(2.0), rel=0.3)


@pytest.mark.parametrize("shift", [-40.0, 0.0, 7.0])
@pytest.mark.parametrize(("text", "sign"), [("(x-{p})**3", 1), ("cos(x+{p})", -1), ("1/(1+({p}-x)**2)", 1)])
def test_a_location_is_looked_for_where_the_coordinate_is(text, sign, shift):
    found = range_of(text, states(2.0, shift))
    assert found.spacing == "linear"
    assert not found.bounded
    assert (found.low, found.high) == pytest.approx((sign * shift - 4.0, sign * shift + 4.0), abs=0.05)


def test_the_coordinates_of_a_point_have_a_range_each():
    found = shape_ranges(terms(["sqrt((x-{p})**2+(y-{r})**2)"], COORDINATES), states(1.0, 5.0), {})
    assert (found["p"].low, found["p"].high) == pytest.approx((3.0, 7.0), abs=0.05)
    assert (found["r"].low, found["r"].high) == pytest.approx((-6.0, 6.0), abs=0.05)


@pytest.mark.parametrize("size", [0.02, 1.0, 50.0])
@pytest.mark.parametrize("text", ["sqrt(x**2+{h}**2)", "1/(x**2+{h}**2)"])
def test_a_length_in_squares_is_no_longer_than_the_coordinate(text, size):
    found = range_of(text, states(size))
    assert found.spacing == "log"
    assert found.high == pytest.approx(size, rel=0.15)
    assert 0.0 < found.low < 0.1 * found.high


@pytest.mark.parametrize("text", ["x**{n}", "(x**2+y**2)**(-{n}/2)", "x_dot**2*x**{n}"])
def test_an_exponent_is_an_exponent(text):
    found = range_of(text, states(0.2, 1.0))
    assert found.low < -6.0 < 6.0 <= found.high or found.spacing == "log"
    if text == "x**{n}":
        assert found.spacing == "exponent"
        assert {-6.0, -12.0, -1.0, 3.0} <= {*found.starts(5).tolist()}


def test_a_range_of_the_user_is_a_bound():
    found = range_of("exp(-{a}*x)", given={"a": (0.1, 10)})
    assert (found.low, found.high, found.spacing, found.bounded) == (0.1, 10.0, "log", True)
    assert range_of("exp(-{a}*x)", given={"a": (-1, 1)}).spacing == "linear"
    assert range_of("exp(-{a}*x)", given={"a": (2, 3)}).spacing == "linear"
    assert range_of("x**{n}", given={"n": (-3, 2)}).starts(9).tolist() == [
        -3.0,
        -2.5,
        -2.0,
        -1.5,
        -1.0,
        -0.5,
        0.5,
        1.5,
    ]
    narrow = range_of("x**{n}", given={"n": (1.6, 2.2)})
    assert np.all((narrow.starts(4) > 1.6) & (narrow.starts(4) < 2.2))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"b": (0, 1)}, r"shapes names 'b', which is no shape parameter of the library \(it has a\)"),
        ({"a": (1, 0)}, "expected \\(low, high\\) with low < high"),
        ({"a": (1, 1)}, "low < high"),
        ({"a": (0, np.inf)}, "low < high"),
        ({"a": (0, np.nan)}, "low < high"),
        ({"a": 3.0}, "low < high"),
        ({"a": (1, 2, 3)}, "low < high"),
        ({"a": ("one", "two")}, "low < high"),
    ],
)
def test_what_is_no_range_is_refused(given, message):
    with pytest.raises(InputError, match=message):
        range_of("exp(-{a}*x)", given=given)


def test_a_library_without_shapes_says_how_to_write_one():
    with pytest.raises(InputError, match=r"it has none; write one as exp\(-\{a\}\*x\)"):
        shape_ranges(terms(["x**2"], COORDINATES), states(), {"a": (0, 1)})
    assert shape_ranges(terms(["x**2"], COORDINATES), states(), {}) == {}


RANGES = [
    ShapeRange(0.1, 10.0, "log"),
    ShapeRange(-2.0, 5.0, "linear"),
    ShapeRange(-12.0, 6.0, "exponent"),
    ShapeRange(0.1, 10.0, "log", bounded=True),
    ShapeRange(-2.0, 5.0, "linear", bounded=True),
]


@pytest.mark.parametrize("where", RANGES, ids=str)
@settings(max_examples=30)
@given(share=st.floats(0.0, 1.0), step=st.floats(-1e6, 1e6))
def test_starts_shares_and_steps(where, share, step):
    starts = where.starts(9)
    assert np.all(np.diff(starts) > 0.0)
    slack = 1e-12 * (where.high - where.low)
    assert where.low - slack <= starts.min() <= starts.max() <= where.high + slack
    value = where.at(share)
    assert where.low - 1e-9 <= value <= where.high + 1e-9
    moved = where.stepped(value, step)
    if where.bounded:
        assert where.low <= moved <= where.high
    if where.spacing == "log":
        assert moved > 0.0  # a positive number stays positive
    assert abs(moved - value) <= max(abs(value), 0.25 * (where.high - where.low)) + 1e-9
    assert where.stepped(value, 1e-9) == pytest.approx(value, abs=1e-8)
