"""A dot and a whisker for one coefficient: how far its 95 % interval is from zero, as a small SVG."""

from __future__ import annotations

import math
from html import escape

from markupsafe import Markup

from leastaction.model.notation import rounded
from leastaction.model.term import ModelTerm

__all__ = ["axis", "whisker"]

_WIDTH, _HEIGHT = 240, 20
_ZERO, _FOUND = 20.0, 120.0  # px: the coefficient is found at 1, in units of itself
_LOW, _HIGH = 4.0, 236.0


def whisker(term: ModelTerm, key: str) -> Markup:
    """Draw the interval in units of the coefficient, so that every row shares one axis from zero.

    Parameters
    ----------
    term : ModelTerm
    key : str
        Unlike that of every other figure of the page.

    Returns
    -------
    Markup
        One ``<svg>``: without a standard error only the dot, for a known coefficient a hollow square.
    """
    half = term.upper - term.coefficient
    share = half / abs(term.coefficient) if term.coefficient else math.inf
    middle = _HEIGHT / 2
    parts = [f'<path class="zero" d="M{_ZERO:g} 0v{_HEIGHT}"/>']
    if term.known:
        text, kind = "given, not estimated", "given"
        parts.append(f'<rect class="dot" x="{_FOUND - 4:g}" y="{middle - 4:g}" width="8" height="8"/>')
    else:
        text, kind = _in_words(share), "weak" if share >= 1.0 else "sure"
        if not math.isnan(share):
            parts.append(f'<path class="bar" d="{_bar(share, middle)}"/>')
        parts.append(f'<circle class="dot" cx="{_FOUND:g}" cy="{middle:g}" r="3.5"/>')
    return Markup(
        f'<svg class="whisker {kind}" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-labelledby="{key}">'
        f'<title id="{key}">{escape(text)}</title>{"".join(parts)}</svg>'
    )


def axis() -> Markup:
    """Words for the two marks of the axis; the table says the same in its heading."""
    return Markup(
        f'<svg class="whisker" viewBox="0 0 {_WIDTH} {_HEIGHT}" aria-hidden="true">'
        f'<text class="tick" text-anchor="middle" x="{_ZERO:g}" y="15">0</text>'
        f'<text class="tick" text-anchor="middle" x="{_FOUND:g}" y="15">coefficient</text></svg>'
    )


def _bar(share: float, y: float) -> str:
    """Path of the whisker; an arrow head at an end that is out of the picture."""
    reach = share * (_FOUND - _ZERO) if math.isfinite(share) else math.inf
    path = ""
    for edge, side in ((_LOW, -1), (_HIGH, 1)):
        x = _FOUND + side * reach
        if (x - edge) * side > 0:
            path += f"M{_FOUND:g} {y:g}H{edge:g}m{-side * 5} -4l{side * 5} 4l{-side * 5} 4"
        else:
            path += f"M{_FOUND:g} {y:g}H{x:.1f}"
    return path


def _in_words(share: float) -> str:
    if math.isnan(share):
        return "no standard error"
    if share >= 1.0:
        return "the 95 % interval includes zero"
    return f"95 % interval: ±{rounded(100 * share, digits=2)} % of the coefficient"
