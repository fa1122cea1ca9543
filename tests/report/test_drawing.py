"""Figures: every primitive by what is in its SVG; colours for all kinds of vision; ticks with their texts."""

from __future__ import annotations

import math
import re
from importlib.resources import files
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leastaction.report.axes import HALF, THIRD, Axes
from leastaction.report.svg import COLOURS, corners, dot_path, line_path, number
from leastaction.report.text import in_powers
from leastaction.report.ticks import Folded, Linear, Ticks, folded
from page_helpers import Figure, pieces

_DIGIT = 0.051  # px: half of the last digit that is written


def drawn(axes: Axes) -> Figure:
    return Figure(str(axes.svg("a", "a title", "a description")))


def distance(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distance of each point, (n, 2), from the nearest piece of a polygonal line, (m, 2)."""
    starts, chords = line[:-1], np.diff(line, axis=0)
    away = points[:, None] - starts
    length = np.maximum((chords**2).sum(axis=1), 1e-30)
    share = np.clip((away * chords).sum(axis=2) / length, 0.0, 1.0)
    return np.linalg.norm(away - share[:, :, None] * chords, axis=2).min(axis=1)


def ends(outline: np.ndarray) -> list[float]:
    """Left, top, right and bottom."""
    return [*outline.min(axis=0), *outline.max(axis=0)]


# Paths


@given(st.integers(-100_000, 100_000))
def test_numbers_are_short_and_read_back(tenths):
    words = number(tenths / 10)
    assert float(words) == tenths / 10
    assert not re.search(r"^-?0.|\.0$|^-0$", words)


@given(arrays(float, st.tuples(st.integers(2, 60), st.just(2)), elements=st.floats(-300, 300, width=32)))
def test_lines_pass_all_their_points(points):
    """Whatever the line does: what is left out lies within a tenth of a pixel of what is drawn."""
    kept = corners(points)
    assert kept[0] == 0
    assert kept[-1] == len(points) - 1
    assert (np.diff(kept) > 0).all()
    assert distance(points, points[kept]).max() < 0.06 + 1e-6
    (line,) = pieces(line_path(*points.T))
    line = np.vstack([line, line[-1:]])
    assert distance(points, line).max() < 0.06 + 2 * _DIGIT


def test_points_that_nobody_would_miss_are_left_out():
    x = np.linspace(0.0, 300.0, 3001)
    assert len(corners(np.column_stack([x, 0.5 * x]))) == 2
    assert len(corners(np.column_stack([x, 50 * np.sin(x / 20)]))) < 200
    spike = np.where(np.arange(3001) == 1500, 90.0, 0.0)
    assert {0, 1500, 3000} <= set(corners(np.column_stack([x, spike])))
    back = np.concatenate([x, x[::-1]])  # there and back on one line: the tip is kept
    assert len(corners(np.column_stack([back, 0 * back]))) in (3, 4)


@pytest.mark.parametrize("gap", [np.nan, np.inf, -np.inf])
def test_gaps_interrupt_lines_and_single_points_are_dots(gap):
    y = np.array([gap, 1.0, 5.0, gap, gap, 7.0, gap, 2.0, 3.0, 9.0])
    found = pieces(line_path(np.arange(10.0), y))
    assert [piece.tolist() for piece in found] == [
        [[1.0, 1.0], [2.0, 5.0]],
        [[5.0, 7.0], [5.0, 7.0]],
        [[7.0, 2.0], [8.0, 3.0], [9.0, 9.0]],
    ]
    dots = pieces(dot_path(np.arange(10.0), y))
    assert [piece[0].tolist() for piece in dots] == [[k, y[k]] for k in np.flatnonzero(np.isfinite(y))]
    nothing = np.full(3, gap)
    assert line_path(nothing, nothing) == dot_path(nothing, nothing) == ""


@given(arrays(float, st.tuples(st.integers(1, 40), st.just(2)), elements=st.floats(-500, 900, width=32)))
def test_dots_are_where_they_should_be(points):
    """Steps from dot to dot: their rounding does not add up."""
    found = pieces(dot_path(*points.T))
    assert all((piece[0] == piece[1]).all() for piece in found)
    np.testing.assert_allclose([piece[0] for piece in found], points, atol=_DIGIT)


# Positions


def test_lines_and_dots_lie_where_the_axes_say():
    """Read with nothing but ticks: the straight map that they give takes data to pixels."""
    x = np.linspace(2.0, 9.0, 23)
    y = 40 * np.cos(x) - 15
    axes = Axes(HALF)
    axes.line(x, y, "fit")
    axes.dots(x, y, "measured", 3.0)
    axes.label("t (s)", "q", y_unit="rad")
    figure, frame = drawn(axes), axes.frame()
    maps = []
    for place, words in ((0, figure.texts("tick", "middle")), (1, figure.texts("tick", "end"))):
        at = [text[place] for text in words]
        values = [float(text[2].replace("−", "-")) for text in words]
        maps.append(np.polyfit(values, at, 1))
    expected = np.column_stack([np.polyval(maps[0], x), np.polyval(maps[1], y) - 4.2])
    dots = np.array([piece[0] for piece in figure.path("stroke:var(--measured)")])
    np.testing.assert_allclose(dots, expected, atol=0.25)
    np.testing.assert_allclose(dots, np.column_stack([frame.x(x), frame.y(y)]), atol=_DIGIT)
    (line,) = figure.path("stroke:var(--fit)")
    assert distance(dots, line).max() < 0.25
    # Everything is inside, and fills the frame but for the margins.
    left, top, right, bottom = figure.clip
    assert left < dots[:, 0].min() < left + 10
    assert right - 10 < dots[:, 0].max() < right
    assert top < dots[:, 1].min() < top + 15
    assert bottom - 15 < dots[:, 1].max() < bottom
    assert figure.box == [0.0, 0.0, *HALF]


def test_grid_lines_run_through_their_ticks():
    axes = Axes()
    axes.line(np.array([0.0, 1.0]), np.array([-3.0, 8.0]), "fit")
    figure = drawn(axes)
    left, _, right, bottom = figure.clip
    grid = figure.path("stroke:var(--grid)")
    ticks = figure.texts("tick", "end")
    assert len(grid) == len(ticks) == 2  # 0 and 5
    for line, (x, y, _) in zip(grid, ticks, strict=True):
        np.testing.assert_allclose(line, [[left, y - 4.2], [right, y - 4.2]], atol=2 * _DIGIT)
        assert x == pytest.approx(left - 7)
    (ground,) = figure.path("stroke:var(--muted)")
    np.testing.assert_allclose(ground, [[left, bottom], [right, bottom]], atol=_DIGIT)


def test_a_logarithmic_axis_has_equal_decades():
    sizes = np.arange(1.0, 8.0)
    values = np.array([0.0, 10.0, 100.0, 1000.0, 1e4, -10.0, -100.0])
    axes = Axes((520.0, 320.0), x=Linear(whole=True), y=Folded())
    axes.dots(sizes, values, "fit", 4.0)
    figure = drawn(axes)
    height = {float(v): piece[0][1] for v, piece in zip(values, figure.path("--fit"), strict=True)}
    down = [height[v] for v in (1e4, 1000.0, 100.0, 10.0, 0.0, -10.0, -100.0)]
    np.testing.assert_allclose(np.diff(down), np.diff(down)[0], atol=2 * _DIGIT)
    ticks = {words: y - 4.2 for _, y, words in figure.texts("tick", "end")}
    assert {"10⁴": 1e4, "1000": 1e3, "0": 0.0, "−100": -100.0}.keys() <= ticks.keys()
    assert ticks["10⁴"] == pytest.approx(height[1e4], abs=2 * _DIGIT)
    assert ticks["−100"] == pytest.approx(height[-100.0], abs=2 * _DIGIT)


def test_bars_stand_on_zero_between_their_edges():
    heights, edges = np.array([1.0, 4.0, 0.0, 2.0]), np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    axes = Axes()
    axes.bars(heights, edges, "measured", 0.45)
    axes.limit(y=(0.0, None))
    figure, frame = drawn(axes), axes.frame()
    (outline,) = figure.path("fill:var(--measured)", "opacity:0.45")
    corners_expected = [
        [frame.x(edges[k + side]).item(), frame.y(height).item()]
        for k, height in enumerate(heights)
        for side in (0, 1)
    ]
    assert distance(np.array(corners_expected), outline).max() < 2 * _DIGIT
    assert outline[:, 1].max() == pytest.approx(figure.clip[3], abs=_DIGIT)
    x, y = outline.T
    area = 0.5 * abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])))
    unit = (frame.x(1.0) - frame.x(0.0)) * (frame.y(0.0) - frame.y(1.0))
    assert area == pytest.approx(heights.sum() * float(unit), rel=5e-3)


def test_bands_rules_and_columns():
    axes = Axes()
    axes.dots(np.array([0.0, 10.0]), np.array([-1.0, 1.0]), "measured", 2.0)
    axes.band(x=(2.0, 5.0))
    axes.band(y=(-0.25, 0.5))
    axes.rule(3.0, "fit", 1.0, dashes="4 3")
    axes.column(7.0, 14.0)
    figure, frame = drawn(axes), axes.frame()
    left, top, right, bottom = figure.clip
    (upright,), (level,) = figure.paths("fill:var(--shade)")
    assert ends(upright) == pytest.approx([*frame.x([2.0]), top, *frame.x([5.0]), bottom], abs=_DIGIT)
    assert ends(level) == pytest.approx([left, *frame.y([0.5]), right, *frame.y([-0.25])], abs=_DIGIT)
    (rule,) = figure.path("stroke:var(--fit)", "stroke-dasharray:4 3")
    assert rule[:, 1] == pytest.approx(frame.y([3.0, 3.0]), abs=_DIGIT)
    assert rule[0, 1] > top  # a rule above the data moves the end of the axis
    assert rule[:, 0].tolist() == pytest.approx([left, right])
    (column,) = figure.path("stroke:var(--shade)", "stroke-width:14")
    assert column[:, 0] == pytest.approx(frame.x([7.0, 7.0]), abs=_DIGIT)
    assert sorted(column[:, 1]) == pytest.approx([top, bottom])


# Layers, limits, what is cut off


def test_what_is_above_covers_what_is_below():
    x = np.array([0.0, 1.0, 2.0])
    axes = Axes()
    axes.dots(x, x, "forecast", 5.0, above=True)
    axes.line(x, x, "fit")
    axes.dots(x, x, "measured", 2.0, opacity=0.5)
    axes.bars(np.array([1.0]), np.array([0.0, 1.0]), "ink", 0.5)
    axes.band(x=(0.0, 1.0))
    order = re.findall(r"(?:fill|stroke):var\(--(\w+)\)", str(axes.svg("a", "b", "c")))
    assert order == ["shade", "grid", "ink", "measured", "fit", "paper", "forecast", "muted"]


def test_given_limits_hold_and_the_rest_is_cut_off():
    x, y = np.linspace(0.0, 10.0, 50), np.linspace(-5.0, 5.0, 50)
    axes = Axes()
    axes.line(x, y, "fit")
    axes.dots(x, 1e30 * y, "measured", 2.0)
    axes.limit(x=(2.0, 4.0))
    axes.limit(y=(-1.0, None))
    axes.limit(y=(None, 3.0))
    source, frame = str(axes.svg("b7", "t", "d")), axes.frame()
    figure = Figure(source)
    assert (frame.x_ends, frame.y_ends) == ((2.0, 4.0), (-1.0, 3.0))
    np.testing.assert_allclose(figure.clip, [frame.left, frame.top, frame.right, frame.bottom], atol=_DIGIT)
    (clip,) = figure.root.iter("clipPath")
    (group,) = figure.root.iter("g")
    assert group.attrib["clip-path"] == f"url(#{clip.attrib['id']})"
    inside = list(group.iter("path"))
    assert len(inside) == 3  # grid, dots and line: only the ground is drawn outside
    assert len(list(figure.root.iter("path"))) == 4
    numbers = [float(n) for n in re.findall(r"-?\d*\.?\d+", " ".join(e.attrib["d"] for e in inside))]
    assert max(map(abs, numbers)) <= 2e4  # a number that is far out stays short
    for _, at, _ in figure.texts("tick", "end"):
        assert frame.top <= at - 4.2 <= frame.bottom


@pytest.mark.parametrize(("low", "high", "begins"), [(68.0, 75.0, 0.0), (-3.0, 5.0, -3.48)])
def test_an_axis_may_have_to_show_zero(low, high, begins):
    axes = Axes()
    axes.line(np.array([0.0, 1.0]), np.array([low, high]), "fit")
    axes.limit(y_from=0.0)
    assert axes.frame().y_ends == pytest.approx((begins, high + 0.06 * (high - low)))


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ([], []),
        ([1.0], [5.0]),
        ([0.0, 1.0], [np.nan, np.nan]),
        ([0.0, 1.0, 2.0], [7.0, 7.0, 7.0]),
        ([0.0, 1.0], [1e280, -1e280]),
        ([0.0, 1.0], [0.0, 5e-324]),
        ([1.7e9, 1.7e9 + 10.0], [1.0, 1.0 + 1e-15]),
        ([3.0, 3.0], [np.inf, 2.0]),
    ],
)
def test_any_data_make_a_figure(x, y):
    axes = Axes()
    axes.line(np.array(x), np.array(y), "fit")
    axes.dots(np.array(x), np.array(y), "measured", 3.0, above=True)
    axes.label("t (s)", "q")
    figure, frame = drawn(axes), axes.frame()
    for low, high in (frame.x_ends, frame.y_ends):
        assert np.isfinite([low, high]).all()
        assert low < high
    source = str(axes.svg("a", "b", "c"))
    assert not re.search(r"nan|inf\b|e[+-]?\d", re.sub(r"<text.*?</text>|viewBox", "", source))
    left, top, right, bottom = figure.clip
    there = np.isfinite(x) & np.isfinite(y)
    for piece in figure.paths("stroke:var(--measured)")[0] if there.any() else []:
        assert left - _DIGIT <= piece[0][0] <= right + _DIGIT
        assert top - _DIGIT <= piece[0][1] <= bottom + _DIGIT


# Texts


@pytest.mark.parametrize("size", [THIRD, HALF, (1080.0, 190.0), (350.0, 200.0)])
@pytest.mark.parametrize("start", [0.0, 12345.5, 1.7e9])
@pytest.mark.parametrize("span", [1e-3, 0.7, 40.0])
@pytest.mark.parametrize("low", [-1e-7, -0.2, 0.01, 2e-6])
def test_ticks_do_not_touch(size, start, span, low):
    """On a telephone text of 11 px is 1.4 times as large; widths are those of DejaVu Sans, a wide font."""

    def width(words: str) -> float:
        ems = {"−": 0.838, ".": 0.318}
        return 11 * 1.4 * sum(ems.get(c, 0.636) for c in words)

    axes = Axes(size)
    axes.line(start + np.array([0.0, span]), np.array([low, 4e5 * abs(low)]), "fit")
    figure = drawn(axes)
    below = figure.texts("tick", "middle")
    assert below
    for (x0, _, one), (x1, _, other) in pairwise(below):
        assert x1 - x0 > 0.5 * (width(one) + width(other)) + 3
    beside = sorted(figure.texts("tick", "end"), key=lambda text: text[1])
    assert all(lower[1] - upper[1] > 11 * 1.4 for upper, lower in pairwise(beside))
    assert all(x - width(words) >= 0 for x, _, words in beside)


def test_texts_are_escaped_named_and_classed():
    hostile = '</title><script>alert(1)</script>&"'
    axes = Axes(HALF)
    axes.line(np.array([0.0, 1.0]), np.array([0.0, 3e-6]), "fit")
    axes.label(hostile, "角 <q>", y_unit="rad & more")
    figure = Figure(str(axes.svg("f3", hostile, hostile)))
    assert figure.root.attrib["role"] == "img"
    title, description = (figure.root.find(tag) for tag in ("title", "desc"))
    assert title is not None
    assert description is not None
    assert title.text == description.text == hostile
    names = [e.attrib["id"] for e in figure.root.iter() if "id" in e.attrib]
    assert figure.root.attrib["aria-labelledby"].split() == names[:2]
    assert len(set(names)) == len(names)
    assert all(name.startswith("f3-") for name in names)
    assert [text[2] for text in figure.texts("label")] == ["角 <q> (10⁻⁶ rad & more)"]
    assert [text[2] for text in figure.texts("label", "end")] == [hostile]
    # Size, colour and font of texts are the style sheet's.
    for text in figure.root.iter("text"):
        assert set(text.attrib) <= {"x", "y", "class", "text-anchor"}
        assert text.attrib["class"] in ("tick", "label")


def test_colours_are_variables_of_the_page():
    x = np.array([0.0, 1.0])
    axes = Axes()
    for colour in COLOURS:
        axes.line(x, x, colour)
        axes.dots(x, x, colour, 3.0, above=True)
    source = str(axes.svg("a", "b", "c"))
    assert set(re.findall(r"var\(--(\w+)\)", source)) == set(COLOURS)
    assert not re.search(r"(?:fill|stroke):(?!none|var\()", source)
    assert "#" not in source.replace("url(#a-c)", "")


def test_many_dots_are_little_markup():
    x = np.linspace(0.0, 1.0, 3000)
    axes = Axes()
    axes.dots(x, np.sin(9 * x), "measured", 2.0)
    axes.dots(x * np.nan, x, "measured", 2.0)
    source = str(axes.svg("a", "b", "c"))
    assert source.count("h0") == 3000
    assert source.count("--measured") == 1
    assert len(source) < 35_000


@pytest.mark.parametrize("n", [20, 300, 30_000])
def test_every_sample_is_inside_what_is_drawn(n, rng):
    t = np.sort(rng.uniform(0.0, 1.0, n))
    y = rng.standard_normal(n)
    y[n // 2] = 9.0
    axes = Axes()
    axes.samples(t, y, 2.0)
    frame = axes.frame()
    source = str(axes.svg("a", "b", "c"))
    assert len(source) < 16_000
    strokes = drawn(axes).paths("--measured")[0]
    ends = np.array([[s[0][0], s[:, 1].min(), s[:, 1].max()] for s in strokes])
    x, up = frame.x(t), frame.y(y)
    nearest = np.abs(ends[:, 0] - x[:, None]) < 1.05
    inside = (ends[:, 1] - 0.1 <= up[:, None]) & (up[:, None] <= ends[:, 2] + 0.1)
    assert (nearest & inside).any(axis=1).all()
    assert len(strokes) <= n


# ------------------------------------------------------------------------------------------ colours and ticks
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
    assert re.search(r"figure, [^{]*tr,[^{]*\{ break-inside: avoid; \}", rules)
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
