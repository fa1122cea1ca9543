"""Every primitive of a figure by what is in its SVG: positions, gaps, what is cut off, colours, texts."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leastaction.report.axes import HALF, THIRD, Axes
from leastaction.report.svg import COLOURS, corners, dot_path, line_path, number
from leastaction.report.ticks import Folded, Linear
from report_helpers import Figure, pieces

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
