import keyword

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leastaction.errors import InputError
from leastaction.identifiers import FUNCTION_NAMES, RESERVED_NAMES, check_coordinate_names, quoted


def test_good_names_come_back_in_order():
    names = ["theta1", "x", "θ", "φ_2", "größe", "x_ddot", "match", "a" * 64]
    assert check_coordinate_names(names) == tuple(names)
    assert check_coordinate_names("theta") == ("theta",)


def test_names_are_normalised():
    assert check_coordinate_names(["ϑ", "θ₁"]) == ("θ", "θ1")
    with pytest.raises(InputError, match="occurs twice"):
        check_coordinate_names(["ϑ", "θ"])


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("", "is not a name"),
        ("1x", "is not a name"),
        ("_x", "is not a name"),
        ("__class__", "is not a name"),
        ("a b", "is not a name"),
        ("a-b", "is not a name"),
        ("x;import os", "is not a name"),
        ("x'", "is not a name"),
        ('x"', "is not a name"),
        ("<script>", "is not a name"),
        ("x\n", "is not a name"),
        ("x\0", "is not a name"),
        ("q\u0307", "is not a name"),  # q with a combining dot
        ("x\u202e", "is not a name"),  # right-to-left override
        ("٣", "is not a name"),  # a digit, but no ASCII one
        ("a" * 65, "too long"),
        ("x" * 10**6, "too long"),
        ("lambda", "keyword"),
        ("None", "keyword"),
        ("sin", "function"),
        ("abs", "function"),
        ("pi", "reserved"),
        ("t", "reserved"),
        ("E", "reserved"),
        ("I", "reserved"),
        ("theta_dot", "velocity"),
        (3, "not text"),
        (None, "not text"),
    ],
)
def test_bad_names_are_refused_in_one_short_line(name, reason):
    with pytest.raises(InputError, match=reason) as caught:
        check_coordinate_names([name])
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 200


def test_no_names_and_no_sequence():
    with pytest.raises(InputError, match="is empty"):
        check_coordinate_names([])
    with pytest.raises(InputError, match="sequence of names"):
        check_coordinate_names(5)


@given(st.text(max_size=80))
def test_any_text_is_accepted_as_a_safe_identifier_or_refused(text):
    message = ""
    try:
        (name,) = check_coordinate_names([text])
    except InputError as error:
        message = str(error)
    if message:
        assert message.isprintable()
        return
    assert name.isidentifier()
    assert not keyword.iskeyword(name)
    assert name not in FUNCTION_NAMES | RESERVED_NAMES
    assert len(name) <= 64
    assert check_coordinate_names([name]) == (name,)


def test_quoted_survives_objects_that_print_badly():
    assert quoted(10**5000) == "<int>"
    assert "\n" not in quoted(np.zeros((3, 3)))


@given(st.text(), st.integers(8, 60))
def test_quoted_is_printable_and_never_longer_than_asked(text, limit):
    result = quoted(text, limit)
    assert len(result) <= limit
    assert result.isprintable()
