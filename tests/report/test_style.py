"""What figures are drawn with: colours, for all kinds of vision, and ticks with their texts."""

from __future__ import annotations

import math
import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from leastaction.report.svg import COLOURS
from leastaction.report.ticks import Folded, Linear, Ticks, folded, in_powers

STYLE = files("leastaction.report").joinpath("style.css").read_text(encoding="utf-8")
DATA = ("ink", "measured", "fit", "forecast")

# Machado, Oliveira & Fernandes (2009), severity 1, for linear RGB.
VISION = {
    "full": np.eye(3),
    "no red cones": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "no green cones": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "no blue cones": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
# Ottosson's OKLab: linear RGB to cones, their cube roots to lightness and two opponent axes.
_CONES = np.array(
    [
        [0.41222147, 0.53633254, 0.05144599],
        [0.21190350, 0.68069955, 0.10739696],
        [0.08830246, 0.28171884, 0.62997870],
    ]
)
_OPPONENT = np.array(
    [
        [0.21045426, 0.79361779, -0.00407205],
        [1.97799850, -2.42859221, 0.45059371],
        [0.02590404, 0.78277177, -0.80867577],
    ]
)


def themes() -> dict[str, dict[str, str]]:
    """Variables of each theme; dark and print override those of light."""
    blocks = re.findall(r"(@media[^{]*\{\s*)?:root \{(.*?)\}", STYLE, re.S)
    found = {}
    for media, body in blocks:
        name = "dark" if "dark" in media else "print" if "print" in media else "light"
        found[name] = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", body))
    return found


THEMES = themes()


def linear(colour: str) -> np.ndarray:
    rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """Ratio of WCAG 2.2."""
    bright, dim = sorted((float(linear(c) @ [0.2126, 0.7152, 0.0722]) for c in (one, other)), reverse=True)
    return (bright + 0.05) / (dim + 0.05)


def seen(colour: str, vision: str) -> np.ndarray:
    return _OPPONENT @ np.cbrt(_CONES @ np.clip(VISION[vision] @ linear(colour), 0.0, 1.0))


def test_the_measures_are_right():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)
    for vision in VISION:  # white has no hue, whoever looks
        assert seen("#ffffff", vision) == pytest.approx([1.0, 0.0, 0.0], abs=2e-3)
    red_green = [np.linalg.norm(seen("#ff0000", v) - seen("#7a7a00", v)) for v in ("full", "no green cones")]
    assert red_green[1] < 0.6 * red_green[0]


def test_every_theme_sets_the_same_colours():
    assert set(THEMES) == {"light", "dark", "print"}
    assert set(THEMES["light"]) == set(THEMES["dark"]) == set(THEMES["print"])
    assert set(COLOURS) <= set(THEMES["light"])


@pytest.mark.parametrize("theme", THEMES)
def test_text_has_enough_contrast(theme):
    colours = THEMES[theme]
    grounds = {"paper": ("ink", "muted", "link"), "soft": ("ink", "muted")}
    grounds |= {f"{status}-soft": ("ink", "muted", status) for status in ("ok", "doubt")}
    for ground, texts in grounds.items():
        for text in texts:
            assert contrast(colours[text], colours[ground]) >= 4.5, (text, ground)


@pytest.mark.parametrize("theme", THEMES)
def test_lines_and_dots_stand_out(theme):
    colours = THEMES[theme]
    for name in DATA:
        assert contrast(colours[name], colours["paper"]) >= 3.0, name
    for name in ("ink", "fit"):  # what is drawn on the shaded stretch
        assert contrast(colours[name], colours["shade"]) >= 3.0, name


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("theme", THEMES)
def test_the_colours_of_figures_stay_apart(theme, vision):
    colours = THEMES[theme]
    for one, other in combinations(DATA, 2):
        apart = np.linalg.norm(seen(colours[one], vision) - seen(colours[other], vision))
        assert apart > 0.12, (one, other, apart)  # 0.02 is just noticeable


def test_paper_is_white_and_its_text_black():
    paper = THEMES["print"]
    assert (paper["paper"], paper["ink"], paper["soft"]) == ("#ffffff", "#000000", "#ffffff")
    rules = STYLE[STYLE.rindex("@media print") :]
    assert re.search(r"figure, tr,[^{]*\{ break-inside: avoid; \}", rules)
    assert re.search(r"h2, h3,[^{]*\{ break-after: avoid; \}", rules)


def test_colours_are_named_in_one_place_only():
    rules = re.sub(r":root \{.*?\}", "", STYLE, flags=re.S)
    assert not re.search(r"#[0-9a-f]{3,8}\b(?![^{}]*\{)", rules)
    named = set(re.findall(r"var\(--([\w-]+)", rules)) - {"colour", "zoom"}
    assert named <= set(re.findall(r"--([\w-]+):", STYLE))


# laws of the ticks: where they are, how many, and that their texts are the numbers

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
