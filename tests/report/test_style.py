"""Colours of the report, read from its style sheet: contrast, and vision without one kind of cone."""

from __future__ import annotations

import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest

from leastaction.report.svg import COLOURS

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
