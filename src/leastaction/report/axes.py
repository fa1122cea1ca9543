"""One small plot with limits, ticks and labels, as an inline ``<svg>``.

It covers only the figures of the report. A plotting library would be a quarter of the installation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from leastaction.report.svg import Colour, dot_path, line_path, number, path, sample_path, stroke, text
from leastaction.report.text import with_power
from leastaction.report.ticks import Linear, Scale, Ticks

__all__ = ["HALF", "THIRD", "Axes", "Frame", "shortened", "thin_line"]

HALF, THIRD = (520.0, 220.0), (340.0, 210.0)
"""Width and height in pixels of a panel, for two or three in a row."""

_UPRIGHT = Linear(room=45.0, share=0.06, steps=(1.0, 2.0, 2.5, 5.0))
"""The default scale of y."""

# Space for text that the style sheet enlarges on narrow screens and paper.
_TOP, _RIGHT, _BOTTOM, _LEFT = 28.0, 12.0, 42.0, 44.0
_UNDER = 18.0  # part of the bottom for the label of the horizontal axis
_DIGIT, _LETTER = 9.8, 10.5
_SPARSE = 16.0  # px between samples: from this distance on, dots do not hide the line below them
_WIDER = {"−": 1.35, ".": 0.5}  # in digits
_LINE_POINTS = 900
_BEHIND, _GRID, _FILL, _DOTS, _LINES, _ABOVE = range(6)  # in the sequence of drawing

Ends = tuple[float | None, float | None]


@dataclass(frozen=True)
class Frame:
    """The rectangle of a plot in pixels, and the map from data into it."""

    left: float
    right: float
    top: float
    bottom: float
    x_scale: Scale
    y_scale: Scale
    x_ends: tuple[float, float]
    y_ends: tuple[float, float]

    def x(self, values: np.ndarray) -> np.ndarray:
        """Pixels from the left."""
        return self.across(self.x_scale.place(np.asarray(values, dtype=float)))

    def y(self, values: np.ndarray) -> np.ndarray:
        """Pixels from above."""
        return self.down(self.y_scale.place(np.asarray(values, dtype=float)))

    def across(self, places: np.ndarray) -> np.ndarray:
        low, high = self.x_ends
        return self.left + (places - low) / (high - low) * (self.right - self.left)

    def down(self, places: np.ndarray) -> np.ndarray:
        low, high = self.y_ends
        return self.bottom - (places - low) / (high - low) * (self.bottom - self.top)


class Axes:
    """A plot; its limits follow from its content, unless `limit` sets them.

    Parameters
    ----------
    size : tuple of float
        Width and height in pixels.
    x, y : Scale
    """

    def __init__(
        self, size: tuple[float, float] = THIRD, *, x: Scale | None = None, y: Scale | None = None
    ) -> None:
        self.width: float = size[0]
        self.height: float = size[1]
        self._scales: tuple[Scale, Scale] = (x or Linear(), y or _UPRIGHT)
        self._parts: list[tuple[int, Callable[[Frame], str]]] = []
        self._spans: tuple[list[float], list[float]] = ([], [])
        self._given: list[Ends] = [(None, None), (None, None)]
        self._floor: float | None = None
        self._labels = ("", "", "", "")
        self._left = _LEFT

    def line(
        self,
        x: np.ndarray,
        y: np.ndarray,
        colour: Colour,
        width: float = 1.5,
        *,
        dashes: str = "",
        cap: str = "round",
    ) -> None:
        """Draw a line; NaN interrupts it."""
        self._know(x, y)
        # Round caps would close the gaps between dashes.
        style = stroke(colour, width, dashes=dashes, cap="" if dashes else cap)
        self._add(_LINES, lambda frame: path(line_path(frame.x(x), frame.y(y)), style))

    def dots(
        self,
        x: np.ndarray,
        y: np.ndarray,
        colour: Colour,
        size: float,
        *,
        opacity: float = 1.0,
        above: bool = False,
    ) -> None:
        """Draw dots of this diameter; `above` draws them over the lines, with a rim."""
        self._know(x, y)
        styles = [stroke(colour, size, cap="round", opacity=opacity)]
        if above:
            styles.insert(0, stroke("paper", size + 1.2, cap="round"))

        def draw(frame: Frame) -> str:
            d = dot_path(frame.x(x), frame.y(y))
            return "".join(path(d, style) for style in styles)

        self._add(_ABOVE if above else _DOTS, draw)

    def samples(self, x: np.ndarray, y: np.ndarray, size: float) -> None:
        """Draw every sample: few samples as dots above the lines, many as strokes of this width below.

        Samples that share a pixel become one stroke from the lowest to the highest.
        """
        there = np.isfinite(x) & np.isfinite(y)
        x, y = x[there], y[there]
        if x.size * _SPARSE < self.width:
            self.dots(x, y, "measured", 1.3 * size, above=True)
            return
        self._know(x, y)
        style = stroke("measured", size, cap="round")
        self._add(_DOTS, lambda frame: path(sample_path(frame.x(x), frame.y(y)), style))

    def bars(self, heights: np.ndarray, edges: np.ndarray, colour: Colour, opacity: float) -> None:
        """Fill a histogram: one bar from zero between each two edges."""
        x = np.repeat(np.asarray(edges, dtype=float), 2)
        y = np.concatenate([[0.0], np.repeat(heights, 2), [0.0]])
        self._know(x, y)
        style = f"fill:var(--{colour});opacity:{opacity:g}"
        self._add(_FILL, lambda frame: path(line_path(frame.x(x), frame.y(y), close=True), style))

    def band(self, *, x: tuple[float, float] | None = None, y: tuple[float, float] | None = None) -> None:
        """Shade a range of x, of y, or of both."""
        self._know(np.array(x or ()), np.array(y or ()))

        def draw(frame: Frame) -> str:
            left, right = (frame.left, frame.right) if x is None else frame.x(np.array(x)).tolist()
            bottom, top = (frame.bottom, frame.top) if y is None else frame.y(np.array(y)).tolist()
            corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
            return path(line_path(*corners.T, close=True), "fill:var(--shade)")

        self._add(_BEHIND, draw)

    def strip(self, x: np.ndarray, low: np.ndarray, high: np.ndarray, colour: Colour) -> None:
        """Shade the area between two lines where both are known, without effect on the limits."""
        there = np.isfinite(low) & np.isfinite(high)
        ends = np.concatenate([x[there], x[there][::-1]]), np.concatenate([low[there], high[there][::-1]])

        def draw(frame: Frame) -> str:
            far = 4.0 * self.height  # clips lines that leave the plot
            y = np.clip(frame.y(ends[1]), -far, far)
            return path(line_path(frame.x(ends[0]), y, close=True), f"fill:var(--{colour});opacity:.22")

        self._add(_FILL, draw)

    def words(self, x: float, y: float, words: str, gap: float) -> None:
        """Write a short text beside a point, by pixels to its right, or left of it if `gap` is negative."""
        self._know(np.array([x]), np.array([y]))

        def draw(frame: Frame) -> str:
            across, down = float(frame.x(np.array(x))), float(frame.y(np.array(y)))
            return text(words, across + gap, down + 4.0, "label", "end" if gap < 0.0 else "start")

        self._add(_ABOVE, draw)

    def align(self, other: Axes) -> None:
        """Give two plots, one below the other, the same left end."""
        self._left = other._left = max(self.frame().left, other.frame().left)

    def same_scale(self) -> None:
        """Give both axes the same scale, with the content in the middle."""
        for _ in range(3):  # the left margin depends on the ticks
            frame = self.frame()
            sides = ((frame.right - frame.left, frame.x_ends), (frame.bottom - frame.top, frame.y_ends))
            per_pixel = max((high - low) / pixels for pixels, (low, high) in sides)
            for k, (pixels, (low, high)) in enumerate(sides):
                middle, half = (low + high) / 2.0, 0.5 * per_pixel * pixels
                self._given[k] = (middle - half, middle + half)

    def rule(self, y: float, colour: Colour, width: float, *, dashes: str = "") -> None:
        """Draw a line across the plot."""
        self._know(np.array([]), np.array([y]))
        style = stroke(colour, width, dashes=dashes)

        def draw(frame: Frame) -> str:
            return path(line_path(np.array([frame.left, frame.right]), frame.y(np.array([y, y]))), style)

        self._add(_LINES, draw)

    def column(self, x: float, width: float) -> None:
        """Shade a column of this width in pixels about x."""
        self._know(np.array([x]), np.array([]))

        def draw(frame: Frame) -> str:
            ends = np.array([frame.bottom, frame.top])
            return path(line_path(frame.x(np.array([x, x])), ends), stroke("shade", width))

        self._add(_BEHIND, draw)

    def limit(self, *, x: Ends = (None, None), y: Ends = (None, None), y_from: float | None = None) -> None:
        """Set ends of the axes (None: from the data); `y_from` is included, and all values above it."""
        for k, ends in enumerate((x, y)):
            low, high = (old if new is None else new for old, new in zip(self._given[k], ends, strict=True))
            self._given[k] = (low, high)
        self._floor = self._floor if y_from is None else y_from

    def label(self, x: str, y: str, x_unit: str = "", y_unit: str = "") -> None:
        """Label the axes: y above the vertical axis, x below the horizontal one; long ones are cut."""
        self._labels = (x, y, x_unit, y_unit)

    def frame(self) -> Frame:
        """The rectangle of the plot, from its present content."""
        return self._layout()[0]

    def svg(self, name: str, title: str, description: str) -> Markup:
        """Return the plot as an ``<svg>`` element.

        Parameters
        ----------
        name : str
            Unique on the page: prefix of the identifiers.
        title, description : str
            Title and content of the figure, for screen readers.
        """
        frame, x_ticks, y_ticks = self._layout()
        drawn = [*self._parts, (_GRID, lambda frame: _grid(frame, y_ticks))]
        body = "".join(draw(frame) for _, draw in sorted(drawn, key=lambda part: part[0]))
        width, height = number(frame.right - frame.left), number(frame.bottom - frame.top)
        clip = f'<rect x="{number(frame.left)}" y="{number(frame.top)}" width="{width}" height="{height}"/>'
        ground = path(_across(frame, frame.bottom), stroke("muted", 0.8))
        return Markup(
            f'<svg viewBox="0 0 {number(self.width)} {number(self.height)}" role="img" '
            f'aria-labelledby="{name}-t {name}-d"><title id="{name}-t">{escape(title)}</title>'
            f'<desc id="{name}-d">{escape(description)}</desc><clipPath id="{name}-c">{clip}</clipPath>'
            f'<g clip-path="url(#{name}-c)">{body}</g>{ground}{self._texts(frame, x_ticks, y_ticks)}</svg>'
        )

    def _texts(self, frame: Frame, x_ticks: Ticks, y_ticks: Ticks) -> str:
        along, up = frame.across(np.array(x_ticks.places)), frame.down(np.array(y_ticks.places))
        parts = [
            text(words, at, frame.bottom + 15.4, "tick", "middle")
            for at, words in zip(along, x_ticks.texts, strict=True)
        ]
        parts += [
            text(words, frame.left - 7, at + 4.2, "tick", "end")
            for at, words in zip(up, y_ticks.texts, strict=True)
        ]
        x, y, x_unit, y_unit = self._labels
        room = int(self.width / _LETTER)
        x, y = shortened(x, room - len(x_unit)), shortened(y, room - len(y_unit))
        parts.append(text(with_power(y, y_ticks.power, y_unit), 2, 15.2, "label"))
        if x:
            x = with_power(x, x_ticks.power, x_unit)
            parts.append(text(x, frame.right, self.height - 4.9, "label", "end"))
        return "".join(parts)

    def _layout(self) -> tuple[Frame, Ticks, Ticks]:
        """Limits, then the vertical ticks, whose texts determine the left margin, then the others."""
        x_scale, y_scale = self._scales
        x_ends, y_ends = self._ends(0), self._ends(1)
        y_ticks = y_scale.ticks(*y_ends, max(3, int(self.height / y_scale.room)))
        left = max(self._left, _widest(y_ticks) + 8)
        below = _BOTTOM if self._labels[0] else _BOTTOM - _UNDER
        right, bottom = self.width - _RIGHT, self.height - below
        frame = Frame(left, right, _TOP, bottom, x_scale, y_scale, x_ends, y_ends)
        for most in range(max(4, int(self.width / x_scale.room)), 0, -1):
            x_ticks = x_scale.ticks(*x_ends, most)
            apart = np.diff(frame.across(np.array(x_ticks.places)))
            if _widest(x_ticks) + 0.5 * _DIGIT <= apart.min(initial=np.inf):
                break
        return frame, x_ticks, y_ticks

    def _ends(self, k: int) -> tuple[float, float]:
        """Both ends of an axis, as positions on its scale."""
        scale, span = self._scales[k], self._spans[k]
        low, high = (min(span), max(span)) if span else (0.0, 0.0)
        margin = scale.margin(low, high)
        low, high = (low - margin, high + margin) if high > low else (low, high)
        if k == 1 and self._floor is not None:
            low = min(low, float(scale.place(np.array(self._floor))))
        given = [None if end is None else float(scale.place(np.array(end))) for end in self._given[k]]
        low, high = (old if new is None else new for old, new in zip((low, high), given, strict=True))
        size = max(abs(low), abs(high))
        if not high - low > max(1e-12 * size, 1e-290):
            # A range of zero: add a margin around the value.
            room = 0.05 * size if size > 1e-280 else 0.05
            low, high = low - room, high + room
        return low, high

    def _know(self, x: np.ndarray, y: np.ndarray) -> None:
        """Extend the limits to include points with two finite coordinates."""
        x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        if x.size == y.size:
            there = np.isfinite(x) & np.isfinite(y)
            x, y = x[there], y[there]
        for scale, span, values in zip(self._scales, self._spans, (x, y), strict=True):
            places = scale.place(np.clip(values, -1e290, 1e290))
            places = places[np.isfinite(places)]
            if places.size:
                span.extend((float(places.min()), float(places.max())))

    def _add(self, layer: int, draw: Callable[[Frame], str]) -> None:
        self._parts.append((layer, draw))


def _widest(ticks: Ticks) -> float:
    """Width in pixels of the longest text at the largest size in the style sheet."""
    return _DIGIT * max((sum(_WIDER.get(c, 1.0) for c in words) for words in ticks.texts), default=0.0)


def _grid(frame: Frame, ticks: Ticks) -> str:
    lines = (_across(frame, at) for at in frame.down(np.array(ticks.places)).tolist())
    return path("".join(lines), stroke("grid", 0.8))


def _across(frame: Frame, y: float) -> str:
    return line_path(np.array([frame.left, frame.right]), np.array([y, y]))


def shortened(words: str, limit: int) -> str:
    """Shorten a long text in the middle.

    Examples
    --------
    >>> shortened("dθ₁/dt", 16), shortened("dshoulder_flexion,left/dt", 16)
    ('dθ₁/dt', 'dshould…,left/dt')
    """
    if len(words) <= limit:
        return words
    head = (limit - 1) // 2
    return f"{words[:head]}…{words[len(words) - (limit - 1 - head) :]}"


def thin_line(t: np.ndarray, y: np.ndarray, n_points: int = _LINE_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Keep the lowest and highest point of each of `n_points` / 2 stretches, so that no peak is lost."""
    if t.size <= n_points:
        return t, y
    edges = np.linspace(0, t.size, n_points // 2 + 1).astype(int)
    keep = {0, t.size - 1}
    for a, b in pairwise(edges):
        part = y[a:b]
        if np.isfinite(part).any():
            keep |= {a + int(np.nanargmin(part)), a + int(np.nanargmax(part))}
    index = np.array(sorted(keep))
    return t[index], y[index]
