"""Laws of the ticks: where they are, how many, and that their texts are the numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from leastaction.report.ticks import Folded, Linear, Ticks, folded, in_powers

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−", "0123456789--")


def read(ticks: Ticks) -> np.ndarray:
    """The numbers that the texts say."""
    values = []
    for words in ticks.texts:
        sign, size = (-1.0, words[1:]) if words.startswith("−") else (1.0, words)
        assert "-" not in size
        raised = size[2:].translate(_SUPERSCRIPTS) if size[:2] == "10" else ""
        is_power = bool(raised) and not size[2:].isascii()
        values.append(sign * (10.0 ** int(raised) if is_power else float(size)))
    return np.array(values) * 10.0**ticks.power


@given(
    low=st.floats(-1e6, 1e6),
    span=st.floats(1e-9, 1e9),
    most=st.integers(2, 13),
    steps=st.sampled_from([(1.0, 2.0, 5.0), (1.0, 2.0, 2.5, 5.0)]),
)
def test_linear_ticks(low, span, most, steps):
    assume(span > 1e-7 * abs(low))  # closer, and no text of a dozen digits would tell the ticks apart
    high = low + span
    ticks = Linear(steps=steps).ticks(low, high, most)
    places = np.array(ticks.places)
    # Some, not too many; rising, inside, and no room for one more at either end.
    assert 2 <= places.size <= max(most + 1, 2 * len(steps))
    step = np.diff(places)
    assert (step > 0).all()
    np.testing.assert_allclose(step, step[0], rtol=1e-6)
    slack = 1e-6 * span
    assert low - slack <= places[0] < low + step[0] + slack
    assert high - step[0] - slack < places[-1] <= high + slack
    # Round: the step is one of these times a power of ten, and every tick a multiple of the step.
    mantissa = step[0] / 10.0 ** math.floor(math.log10(step[0] * (1 + 1e-6)))
    assert min(abs(mantissa - s) for s in steps) < 1e-6
    np.testing.assert_allclose(places / step[0], np.rint(places / step[0]), atol=1e-6)
    # The texts are the numbers.
    assert len(set(ticks.texts)) == places.size
    np.testing.assert_allclose(read(ticks), places, atol=1e-3 * step[0])


@given(low=st.floats(-50, 50), span=st.floats(1.0, 500.0), most=st.integers(2, 13))
def test_counts_have_whole_ticks(low, span, most):
    ticks = Linear(whole=True).ticks(low, low + span, most)
    assert len(ticks.places) >= 1
    assert all(place == round(place) for place in ticks.places)
    assert all("." not in words for words in ticks.texts)


@pytest.mark.parametrize(
    ("low", "high", "texts", "power"),
    [
        (0.0, 1.0, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"], 0),
        (2.6, 3.6, ["2.6", "2.8", "3.0", "3.2", "3.4", "3.6"], 0),
        (-130000.0, 80000.0, ["−1.0", "−0.5", "0.0", "0.5"], 5),
        (0.0, 99999.0, ["0", "20000", "40000", "60000", "80000"], 0),
        (0.0021, 0.0044, ["0.0025", "0.0030", "0.0035", "0.0040"], 0),
        (0.0, 4e-4, ["0", "1", "2", "3", "4"], -4),
    ],
)
def test_texts_of_ticks(low, high, texts, power):
    ticks = Linear().ticks(low, high, 5)
    assert (list(ticks.texts), ticks.power) == (texts, power)


@pytest.mark.parametrize("end", [1e-290, 1e-200, 1e200, 1e290])
def test_sizes_at_the_ends_of_the_numbers(end):
    ticks = Linear().ticks(0.0, end, 5)
    assert len(ticks.places) >= 5
    assert ticks.places[-1] == pytest.approx(end)
    assert ticks.power == round(math.log10(end))


@given(st.floats(-1e12, 1e12), st.floats(-1e12, 1e12))
def test_the_folded_scale_rises_and_is_odd(one, other):
    assume(abs(one - other) > 1e-6 * max(abs(one), abs(other), 1.0))
    a, b = folded(np.array([one, other]))
    assert (a < b) == (one < other)
    assert folded(np.array(-one)) == -a


def test_the_folded_scale_is_logarithmic_beyond_ten():
    np.testing.assert_allclose(folded(np.array([10.0, 100.0, -1e5, 5.0, 0.0])), [1.0, 2.0, -5.0, 0.5, 0.0])
    just = np.array([10.0 - 1e-9, 10.0 + 1e-9])
    assert np.ptp(folded(just)) < 1e-9  # without a jump where it changes
    decade = folded(np.array([1e3, 2e3, 5e3, 1e4])) - 3.0
    np.testing.assert_allclose(decade, np.log10([1.0, 2.0, 5.0, 10.0]))


@given(low=st.floats(-12.0, 0.0), span=st.floats(0.81, 14.0), most=st.integers(3, 9))
def test_folded_ticks(low, span, most):
    # 5, 10 and 20 lie 0.5 and 0.301 apart, which is the widest: 0.81 holds two of them wherever it begins.
    ticks = Folded().ticks(low, low + span, most)
    places = np.array(ticks.places)
    assert 2 <= places.size <= max(2 * most, 10)
    assert (np.diff(places) > 0).all()
    assert low <= places[0] < places[-1] <= low + span
    assert ticks.power == 0 or places.size < 10
    # The place of the number in the text is the place of the tick.
    np.testing.assert_allclose(folded(read(ticks)), places, atol=1e-9)
    values = np.abs(read(ticks))
    values = values[values > 0]
    mantissas = values / 10.0 ** np.floor(np.log10(values * (1 + 1e-9)))
    assert np.abs(mantissas[:, None] - [1.0, 2.0, 5.0]).min(axis=1).max() < 1e-9


def test_powers_are_written_out_while_they_are_short():
    assert [in_powers(k) for k in (-4, -3, 0, 1, 12)] == ["−10⁴", "−1000", "0", "10", "10¹²"]
