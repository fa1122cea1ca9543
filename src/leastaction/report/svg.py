"""Paths and texts as short SVG with CSS variables as colours, for light and dark pages and paper."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from itertools import pairwise
from math import asin, atan2, hypot
from typing import Literal, get_args

import numpy as np

__all__ = [
    "COLOURS",
    "Colour",
    "corners",
    "dot_path",
    "line_path",
    "number",
    "path",
    "sample_path",
    "stroke",
    "text",
]

Colour = Literal["paper", "ink", "muted", "grid", "measured", "fit", "forecast", "shade"]
COLOURS: tuple[Colour, ...] = get_args(Colour)
"""Names of the CSS variables that a page with figures must define."""

_SEEN = 0.06  # px: tolerance of a line, below the last written digit
_FAR = 1e4  # px: limit of coordinates outside of the figure


def line_path(x: np.ndarray, y: np.ndarray, *, close: bool = False) -> str:
    """The ``d`` of a line through points in pixels.

    NaN interrupts the line, and a point between two interruptions becomes a dot. Points within `_SEEN` of the
    line are left out.

    Examples
    --------
    >>> line_path(np.array([0.0, 1.0, 2.0, 2.0]), np.array([5.0, 5.0, 5.0, 7.5]))
    'M0 5h2v2.5'
    """
    there = np.isfinite(x) & np.isfinite(y)
    ends = np.flatnonzero(np.diff(there, prepend=False, append=False)).reshape(-1, 2)
    points = np.clip(np.column_stack([x, y]), -_FAR, _FAR)
    pieces = (points[start:stop] for start, stop in ends)
    return "".join(_piece(_tenths(part[corners(part)])) + ("z" if close else "") for part in pieces)


def dot_path(x: np.ndarray, y: np.ndarray) -> str:
    """The ``d`` of many dots as strokes of length zero with round caps, a tenth of the markup of circles.

    Examples
    --------
    >>> dot_path(np.array([1.0, 2.5]), np.array([3.0, 2.0]))
    'M1 3h0m1.5-1h0'
    """
    there = np.isfinite(x) & np.isfinite(y)
    spots = _tenths(np.clip(np.column_stack([x[there], y[there]]), -_FAR, _FAR))
    if not spots:
        return ""
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(spots)]
    return f"M{_joined(spots[0])}h0" + "".join(f"m{_joined(step)}h0" for step in steps)


def sample_path(x: np.ndarray, y: np.ndarray) -> str:
    """The ``d`` of any number of samples: one vertical stroke for each pixel, from the lowest to the highest.

    No sample is left out, and the markup grows with the width of the plot, not with the data.

    Examples
    --------
    >>> sample_path(np.array([1.0, 1.1, 1.2, 4.0]), np.array([3.0, 7.0, 5.0, 2.0]))
    'M1.1 3v4m2.9-5h0'
    """
    there = np.isfinite(x) & np.isfinite(y)
    points = np.clip(np.column_stack([x[there], y[there]]), -_FAR, _FAR)
    if not len(points):
        return ""
    points = points[np.argsort(points[:, 0], kind="stable")]
    column = np.rint(points[:, 0])
    starts = np.flatnonzero(np.diff(column, prepend=-2 * _FAR))
    across = np.add.reduceat(points[:, 0], starts) / np.diff(starts, append=len(points))
    low, high = (extreme.reduceat(points[:, 1], starts) for extreme in (np.minimum, np.maximum))
    ends = np.rint(np.column_stack([across, low, high]) * 10).astype(int).tolist()
    parts, at = [], (0, 0)
    for k, (along, top, bottom) in enumerate(ends):
        step = (along, top) if k == 0 else (along - at[0], top - at[1])
        upright = f"v{_short(bottom - top)}" if bottom > top else "h0"
        parts.append(f"{'m' if k else 'M'}{_joined(step)}{upright}")
        at = (along, bottom)
    return "".join(parts)


def corners(points: np.ndarray) -> list[int]:
    """Indices of the points between which straight lines pass all others within `_SEEN` pixels.

    From each corner, the range of admissible directions narrows with every point. The line bends if the next
    point is outside of this range or nearer than the last.
    """
    places = points.tolist()
    kept, last = [0], 0
    towards, low, high, far = None, 0.0, 0.0, 0.0
    k = 1
    while k < len(places):
        (x0, y0), (x1, y1) = places[kept[-1]], places[k]
        dx, dy = x1 - x0, y1 - y0
        distance = hypot(dx, dy)
        if towards is None:
            # The first point that differs from the corner gives the direction.
            if distance > _SEEN:
                half = asin(_SEEN / distance)
                towards, low, high, far = (dx, dy), -half, half, distance
        else:
            turn = atan2(towards[0] * dy - towards[1] * dx, towards[0] * dx + towards[1] * dy)
            if distance < far or not low <= turn <= high:
                kept.append(last)
                towards = None
                continue
            half = asin(_SEEN / distance)
            low, high, far = max(low, turn - half), min(high, turn + half), distance
        last = k
        k += 1
    if kept[-1] != len(places) - 1:
        kept.append(len(places) - 1)
    return kept


def stroke(colour: Colour, width: float, *, dashes: str = "", cap: str = "", opacity: float = 1.0) -> str:
    """Style of a line: width and dashes in pixels."""
    parts = ["fill:none", f"stroke:var(--{colour})", f"stroke-width:{width:g}"]
    parts += [f"stroke-dasharray:{dashes}"] if dashes else []
    parts += [f"stroke-linecap:{cap}"] if cap else []
    parts += ["stroke-linejoin:round"] if cap == "round" else []
    parts += [f"opacity:{opacity:g}"] if opacity < 1.0 else []
    return ";".join(parts)


def path(d: str, style: str) -> str:
    """A ``<path>``; empty without content."""
    return f'<path d="{d}" style="{style}"/>' if d else ""


def text(words: str, x: float, y: float, kind: str, anchor: str = "start") -> str:
    """A ``<text>`` of one CSS class, whose size and colour come from the style sheet."""
    where = f' text-anchor="{anchor}"' if anchor != "start" else ""
    return f'<text x="{number(x)}" y="{number(y)}" class="{kind}"{where}>{escape(words)}</text>'


def number(value: float) -> str:
    """A length in pixels, to a tenth."""
    return _short(round(value * 10))


def _tenths(points: np.ndarray) -> list[list[int]]:
    return np.rint(points * 10).astype(int).tolist()


def _piece(points: list[list[int]]) -> str:
    """Relative steps between rounded positions, so that errors do not accumulate."""
    out, letter = [f"M{_joined(points[0])}"], ""
    for (x0, y0), (x1, y1) in pairwise(points):
        dx, dy = x1 - x0, y1 - y0
        if dx and dy:
            step = _joined((dx, dy))
            # The letter applies to all following pairs.
            out.append(step if letter == "l" and step.startswith("-") else f"{' ' if letter else 'l'}{step}")
            letter = "l"
        elif dx or dy:
            out.append(f"h{_short(dx)}" if dx else f"v{_short(dy)}")
            letter = ""
    return "".join(out) if len(out) > 1 else f"{out[0]}h0"


def _joined(pair: Iterable[int]) -> str:
    first, second = (_short(value) for value in pair)
    return f"{first}{second}" if second.startswith("-") else f"{first} {second}"


def _short(tenths: int) -> str:
    """A number of tenths without zeros that SVG does not need."""
    sign, whole, part = "-" if tenths < 0 else "", *divmod(abs(tenths), 10)
    return f"{sign}{whole or ''}.{part}" if part else f"{sign}{whole}"
