"""Matplotlib axes as small inline SVG: colours from the page's style sheet, text as text.

Colours are drawn as stand-ins and replaced by CSS variables afterwards, so that one figure serves light,
dark and paper.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, ScalarFormatter

__all__ = ["COLOURS", "HALF", "THIRD", "dots", "drawing", "inline", "label", "panel"]

HALF, THIRD = (520.0, 220.0), (340.0, 210.0)
"""Width and height in pixels of a panel of which two, or three, stand beside each other."""

_NAMES = ("paper", "ink", "muted", "grid", "measured", "fit", "forecast", "shade")
COLOURS = {name: f"#01{k:02d}fe" for k, name in enumerate(_NAMES)}
"""Name of a CSS variable of the page -> the colour that stands for it in Matplotlib."""

_VARIABLES = {value: f"var(--{name})" for name, value in COLOURS.items()}
_COLOUR = re.compile("|".join(_VARIABLES))
_NUMBER = re.compile(r"-?\d+\.\d+")
_TICK, _LABEL = 11.0, 12.0  # px
# Room for text that the style sheet enlarges where panels shrink: narrow screens and paper.
_TOP, _RIGHT, _BOTTOM, _LEFT = 28.0, 12.0, 42.0, 44.0
_DIGIT, _LETTER = 8.5, 10.5
_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "leastaction",
    "text.parse_math": False,
    "figure.dpi": 72,  # one unit of the drawing is one pixel of the page
    "font.size": _TICK,
    "axes.edgecolor": COLOURS["muted"],
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.spines.left": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": COLOURS["grid"],
    "grid.linewidth": 0.8,
    "xtick.color": COLOURS["muted"],
    "ytick.color": COLOURS["muted"],
    "xtick.bottom": False,
    "ytick.left": False,
    "lines.linewidth": 1.5,
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
    "path.simplify_threshold": 0.05,
}


@contextmanager
def drawing() -> Iterator[None]:
    """Draw with our own settings, whatever the user's are; they come back afterwards."""
    with matplotlib.rc_context(), warnings.catch_warnings():
        # The browser chooses the font; Matplotlib's own need not have every letter.
        warnings.filterwarnings("ignore", "Glyph .* missing")
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def panel(size: tuple[float, float] = THIRD) -> Axes:
    """Axes that fill a new figure of this size in pixels."""
    width, height = size
    figure = Figure(figsize=(width / 72, height / 72))
    FigureCanvasSVG(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.xaxis.set_major_locator(MaxNLocator(max(4, int(width / 80)), steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(max(3, int(height / 45)), steps=[1, 2, 2.5, 5, 10]))
    axes.tick_params(length=0, pad=7)
    axes.grid(visible=False, axis="x")
    axes.margins(x=0.01, y=0.06)
    return axes


def dots(
    axes: Axes,
    x: np.ndarray,
    y: np.ndarray,
    colour: str,
    size: float,
    alpha: float = 1.0,
    above: bool = False,
) -> None:
    """Scatter as one path of round caps: a tenth of the markup of markers."""
    there = np.isfinite(x) & np.isfinite(y)
    points = np.column_stack([x[there], y[there]])
    if not points.size:
        return
    path = Path(np.repeat(points, 2, axis=0), np.tile([Path.MOVETO, Path.LINETO], len(points)))
    path.should_simplify = False
    style = {
        "edgecolor": COLOURS[colour],
        "lw": size,
        "alpha": alpha,
        "capstyle": "round",
        "zorder": 3 if above else 1.9,
    }
    if above:
        rim = style | {"edgecolor": COLOURS["paper"], "lw": size + 1.2}
        axes.add_patch(PathPatch(path, fill=False, snap=False, **rim))
    axes.add_patch(PathPatch(path, fill=False, snap=False, **style))
    axes.update_datalim(points)
    axes.autoscale_view()


def label(axes: Axes, x: str, y: str, x_unit: str = "", y_unit: str = "") -> None:
    """Write the quantity above the upright axis and below the other, a common power of ten with the unit."""
    y_power = _power_of_ten(axes.yaxis)
    x_power = _power_of_ten(axes.xaxis)
    figure = axes.figure
    assert isinstance(figure, Figure)
    width, height = figure.get_size_inches() * 72
    ticks = axes.yaxis.get_major_formatter().format_ticks(list(axes.get_yticks()))
    longest = max(map(len, ticks), default=0)
    left = max(_LEFT, _DIGIT * longest + 12)
    axes.set_position(
        (left / width, _BOTTOM / height, (width - left - _RIGHT) / width, (height - _TOP - _BOTTOM) / height)
    )
    style = {"fontsize": _LABEL, "color": COLOURS["ink"], "transform": None}
    room = int(width / _LETTER)
    x, y = shortened(x, room - len(x_unit)), shortened(y, room - len(y_unit))
    axes.text(2, height - 12, _with_unit(y, y_power, y_unit), ha="left", va="center", **style)
    axes.text(width - _RIGHT, 8, _with_unit(x, x_power, x_unit), ha="right", va="center", **style)


def _power_of_ten(axis) -> int:
    """Write the ticks of an axis with a common power of ten where numbers would be long, and return it."""
    if not isinstance(axis.get_major_formatter(), ScalarFormatter):
        return 0
    low, high = sorted(axis.get_view_interval())
    slack = 1e-9 * (high - low)
    ticks = [float(v) for v in axis.get_majorticklocs() if low - slack <= v <= high + slack]
    largest = max((abs(v) for v in ticks), default=0.0)
    power = math.floor(math.log10(largest) + 1e-9) if largest > 0 else 0
    power = 0 if -3 <= power < 5 else power
    scaled = [v / 10.0**power for v in ticks]
    step = min((b - a for a, b in pairwise(scaled)), default=1.0)
    decimals = next((d for d in range(10) if abs(round(step, d) - step) <= 1e-3 * step), 10)
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FixedFormatter([f"{v + 0.0:.{decimals}f}".replace("-", "−") for v in scaled]))
    return power


def _with_unit(quantity: str, power: int, unit: str) -> str:
    digits = str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    scale = f"10{digits}" if power else ""
    inside = f"{scale} {unit}".strip()
    return f"{quantity} ({inside})" if inside else quantity


def shortened(text: str, limit: int) -> str:
    """Leave out the middle of a long text.

    Examples
    --------
    >>> shortened("dθ₁/dt", 16), shortened("dshoulder_flexion,left/dt", 16)
    ('dθ₁/dt', 'dshould…,left/dt')
    """
    if len(text) <= limit:
        return text
    head = (limit - 1) // 2
    return f"{text[:head]}…{text[len(text) - (limit - 1 - head) :]}"


def inline(axes: Axes, name: str, title: str, description: str) -> Markup:
    """The figure of these axes as an ``<svg>`` element.

    Parameters
    ----------
    axes : Axes
    name : str
        Unlike that of every other figure of the page: prefix of its identifiers.
    title, description : str
        What the figure shows and what is seen in it, for those who cannot see it.
    """
    figure = axes.figure
    assert isinstance(figure, Figure)
    stream = io.BytesIO()
    figure.savefig(
        stream, format="svg", transparent=True, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type"))
    )
    root = ElementTree.fromstring(stream.getvalue())
    _tidy(root, {}, name)
    box = root.get("viewBox", "")
    body = "".join(ElementTree.tostring(child, encoding="unicode") for child in root)
    return Markup(
        f'<svg viewBox="{box}" role="img" aria-labelledby="{name}-t {name}-d"><title id="{name}-t">'
        f'{escape(title)}</title><desc id="{name}-d">{escape(description)}</desc>{body}</svg>'
    )


def _tidy(element: ElementTree.Element, names: dict[str, str], prefix: str) -> None:
    """Strip namespaces and unused identifiers, shorten numbers, put CSS variables for colours."""
    for parent in element.iter():
        for child in list(parent):
            if child.tag.endswith(("}metadata", "}style")):
                parent.remove(child)
    for node in element.iter():
        node.tag = node.tag.rpartition("}")[2]
        node.tail = None
        if node.tag != "text":
            node.text = None
        if node.tag == "clipPath":
            names[node.get("id", "")] = f"{prefix}-{len(names)}"
    for node in element.iter():
        for key, value in list(node.attrib.items()):
            node.attrib.pop(key)
            value = _attribute(node.tag, key.rpartition("}")[2], value, names)
            if value:
                node.set(key.rpartition("}")[2], value)
        if node.tag == "text":
            _classify(node)
    _drop_empty(element)


def _classify(text: ElementTree.Element) -> None:
    """Leave size and colour of a text to the style sheet, which knows the width of the page."""
    style = text.attrib.pop("style", "")
    text.set("class", "tick" if f"font-size:{_TICK:g}px" in style else "label")
    anchor = re.search(r"text-anchor:(middle|end)", style)
    if anchor:
        text.set("text-anchor", anchor[1])


def _attribute(tag: str, key: str, value: str, names: dict[str, str]) -> str:
    if key == "id":
        return names.get(value, "")
    if key == "clip-path":
        return f"url(#{names[value[5:-1]]})"
    if key == "style":
        value = re.sub(
            r"font-family: [^;]*;? ?|stroke-linejoin: miter;? ?|stroke-linecap: square;? ?", "", value
        )
        return _COLOUR.sub(lambda m: _VARIABLES[m[0]], value).replace("; ", ";").replace(": ", ":")
    if key == "transform" and value.startswith("rotate(-0 "):
        return ""
    if key in ("d", "x", "y", "transform", "width", "height"):
        value = _NUMBER.sub(lambda m: f"{float(m[0]):.1f}".removesuffix(".0"), value)
        if key == "d":
            value = re.sub(r"\s+", " ", value).strip()
            # Dots: a move and a line to the same place.
            value = re.sub(r"M (\S+ \S+) L \1(?= |$)", r"M\1h0", value)
            return re.sub(r" ?([MLCQz]) ?", r"\1", value)
    return value


def _drop_empty(element: ElementTree.Element) -> None:
    for child in list(element):
        _drop_empty(child)
        empty_group = child.tag in ("g", "defs") and not len(child)
        nothing_drawn = child.tag == "path" and child.get("style") in ("fill:none", "fill:none;")
        if empty_group or nothing_drawn:
            element.remove(child)
