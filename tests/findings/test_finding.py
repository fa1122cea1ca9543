"""A finding is a value: immutable, hashable, and the same behind pickle and JSON."""

from __future__ import annotations

import json
import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from leastaction.errors import InputError
from leastaction.findings import SEVERITIES, Figures, Finding

VALUES = {"share": 0.25, "count": 3, "named": True, "gain": None, "terms": ["x", "y"], "unit": "deg/s"}


def finding(**change) -> Finding:
    parts = {"code": "missing-term", "severity": "warning", "subject": ("x**2",), "values": VALUES}
    return Finding(**{**parts, "message": "a term is missing", "remedy": "add it", **change})


def test_it_is_a_value():
    first, second = finding(), finding(subject=["x**2"], values={**VALUES, "terms": ("x", "y")})
    assert first == second
    assert hash(first) == hash(second)
    assert len({first, second, finding(code="other")}) == 2
    assert finding(values={**VALUES, "count": 4}) != first
    assert first.subject == ("x**2",)
    assert first.values["terms"] == ("x", "y")
    with pytest.raises(FrozenInstanceError):
        first.code = "other"
    with pytest.raises(TypeError):
        first.values["count"] = 4
    with pytest.raises(FrozenInstanceError):
        first.values.pairs = ()


def test_it_survives_pickle_and_json():
    first = finding()
    assert pickle.loads(pickle.dumps(first)) == first
    text = json.dumps(first.to_dict(), allow_nan=False)
    again = Finding.from_dict(json.loads(text))
    assert again == first
    assert hash(again) == hash(first)
    assert json.loads(text)["values"] == VALUES


def test_the_sentence_is_message_and_remedy():
    assert str(finding()) == "a term is missing: add it"
    assert str(finding(remedy="")) == "a term is missing"
    assert str(Finding.of_text("it rained", "note")) == "it rained"
    assert Finding.of_text("it rained", "note").severity == "note"


def test_numbers_become_plain_and_what_is_not_finite_none():
    values = {"a": np.float64(0.5), "b": np.int64(2), "c": np.inf, "d": np.nan, "e": np.array([1.0, np.nan])}
    figures = Figures.of({**values, "f": np.bool_(True)})
    assert figures == {"a": 0.5, "b": 2, "c": None, "d": None, "e": (1.0, None), "f": True}
    assert all(type(figures[k]) in (float, int, bool, tuple, type(None)) for k in figures)
    assert len(figures) == 6
    with pytest.raises(KeyError):
        figures["g"]


@pytest.mark.parametrize("code", ["", "Missing", "missing_term", "-a", "a-", "a--b", "a b", 3, None])
def test_codes_are_kebab_case(code):
    with pytest.raises(InputError, match="the code is"):
        finding(code=code)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"severity": "fatal"}, "the severity is 'fatal'; expected 'note' or 'warning'"),
        ({"severity": ["note"]}, "the severity is"),
        ({"subject": "x"}, "the subject is 'x'; expected a sequence"),
        ({"subject": 3}, "the subject is 3"),
        ({"subject": ["x", 1]}, r"subject\[1\] is 1; expected text"),
        ({"values": [1]}, "expected a mapping"),
        ({"values": {1: 2}}, "values has the key 1"),
        ({"values": {"a": {}}}, "values.a is {}; expected a number, text"),
        ({"values": {"a": [[1]]}}, r"values.a\[0\] is \[1\]"),
        ({"message": None}, "message is None"),
        ({"remedy": 3}, "remedy is 3"),
    ],
)
def test_parts_of_the_wrong_type_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        finding(**change)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("text", "here is 'text'; expected an object with code, severity"),
        ({**finding().to_dict(), "extra": 1}, "here has the unknown entry 'extra'"),
        ({k: v for k, v in finding().to_dict().items() if k != "values"}, "here has no entry 'values'"),
        ({**finding().to_dict(), "subject": "x"}, "here.subject is 'x'; expected a list"),
        ({**finding().to_dict(), "code": "A"}, "here: the code is 'A'"),
    ],
)
def test_documents_are_checked_and_the_place_is_named(document, message):
    with pytest.raises(InputError, match=message):
        Finding.from_dict(document, "here")


def test_severities_rise():
    assert SEVERITIES.index("note") < SEVERITIES.index("warning")
