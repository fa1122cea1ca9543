"""Selection of a stick figure for a model, and its frames."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from leastaction import LagrangianModel
    from leastaction.app.jobs import Motion

__all__ = ["Kind", "effective_length", "frames", "hanging_angles", "stick_kind"]


Kind = Literal["links", "cart", "plane", "blocks", ""]
"""Kind of drawing: links from a fixed joint or on a cart, a point in a plane, blocks on a rail; or none."""

_REACH = 98.0  # px: length of all links together, or half the range of sliding bodies
_MOST_LINKS, _MOST_BLOCKS = 7, 4


def stick_kind(coordinates: Sequence[str], angles: Sequence[str]) -> Kind:
    """The figure for a motion.

    Examples
    --------
    >>> stick_kind(["theta"], ["theta"]), stick_kind(["x", "theta"], ["theta"])
    ('links', 'cart')
    >>> stick_kind(["x", "y"], []), stick_kind(["x1", "x2"], []), stick_kind(["x", "y", "theta"], ["theta"])
    ('plane', 'blocks', '')
    """
    turning = [name in angles for name in coordinates]
    if all(turning):
        return "links" if len(turning) <= _MOST_LINKS else ""
    if any(turning):
        return "cart" if turning in ([False, True], [False, True, True]) else ""
    across, up = coordinates if len(coordinates) == 2 else ("", "")
    if across.endswith("x") and up.endswith("y") and across[:-1] == up[:-1]:
        return "plane"
    return "blocks" if len(turning) <= _MOST_BLOCKS else ""


def hanging_angles(model: LagrangianModel, links: Sequence[str] = ()) -> tuple[list[float] | None, bool]:
    """Angle at which each link points down, and whether each angle is relative to the previous link.

    For a link in a uniform field, L = T − V contains a cos q + b sin q = R cos(q − δ) with R > 0. V has its
    minimum at q = δ, where the link points down.

    Parameters
    ----------
    model : LagrangianModel
    links : sequence of str
        The angles of the links; all coordinates by default.

    Returns
    -------
    list of float, or None
        δ for each link; None if the model has no such field.
    bool
    """
    names = tuple(links) or model.coordinates
    values = {term.expression.replace(" ", ""): term.coefficient for term in model.terms}
    joined = len(names) > 1 and any(_has_sum(text, names) for text in values if "_dot" not in text)
    down = []
    for k, name in enumerate(names):
        chain = names[: k + 1]
        inside = [name] if not joined or k == 0 else ["+".join(chain), "+".join(reversed(chain))]
        a, b = (sum(values.get(f"{f}({text})", 0.0) for text in inside) for f in ("cos", "sin"))
        down.append(math.atan2(b, a) if math.hypot(a, b) > 0 else 0.0)
        if k == 0 and math.hypot(a, b) == 0:
            return None, joined
    if joined:  # δ of each sum, minus that of the previous one
        down = [down[0], *(after - before for before, after in pairwise(down))]
    return down, joined


def _has_sum(text: str, names: Sequence[str]) -> bool:
    first, second = map(re.escape, names[:2])
    return re.search(rf"\((?:{first}\+{second}|{second}\+{first})", text) is not None


def effective_length(model: LagrangianModel, slide: str, link: str) -> float | None:
    """Length of a link on a cart in units of the cart's position: twice its inertia over its coupling; or
    None.

    Examples
    --------
    >>> from leastaction import LagrangianModel
    >>> from leastaction.model.term import ModelTerm
    >>> terms = [ModelTerm("a_dot**2", 0.25), ModelTerm("x_dot*a_dot*cos(a)", -1.0)]
    >>> effective_length(LagrangianModel(["x", "a"], terms), "x", "a")
    0.5
    """
    coupling = _coupling(model, slide, link)
    inertia = sum(t.coefficient for t in model.terms if t.expression.replace(" ", "") == f"{link}_dot**2")
    return 2.0 * inertia / abs(coupling) if coupling and inertia > 0.0 else None


def _coupling(model: LagrangianModel, slide: str, link: str) -> float:
    """Coefficient of the product of both velocities and the cosine; positive if the link points forward."""
    texts = {f"{a}_dot*{b}_dot*cos({link})" for a, b in ((slide, link), (link, slide))}
    return sum(term.coefficient for term in model.terms if term.expression.replace(" ", "") in texts)


def frames(motion: Motion, model: LagrangianModel, most: int = 900, kind: Kind = "links") -> dict[str, Any]:
    """Times and frames, as JSON types.

    Links are given by their directions from down, anticlockwise; sliding bodies in pixels to the right, and
    in a plane also upwards. A missing sample repeats the previous one; after the end of the forecast there is
    null.
    """
    step = -(-motion.t.size // most)
    t = motion.t[::step]
    slides = {"links": 0, "cart": 1}.get(kind, model.n_dof)
    measured, forecast = _filled(motion.measured), motion.forecast
    middle = np.nan_to_num(np.nanmean(measured, axis=0))
    down, joined = (
        hanging_angles(model, model.coordinates[slides:]) if slides < model.n_dof else (None, False)
    )
    offset = middle.copy()
    if down is not None:
        offset[slides:] = down
    way = max(float(np.nanmax(np.abs(measured - middle)[:, :slides], initial=0.0)), 1e-12)
    length = effective_length(model, *model.coordinates[:2]) if kind == "cart" else None
    # Links on a cart are drawn to scale if both remain visible.
    scale = _REACH / way if length is None else min(_REACH / way, max(_REACH / (3.0 * way), 60.0 / length))

    turn = 1.0
    if kind == "cart" and down is not None:
        # The coupling gives the direction in which a link leans for a positive angle.
        turn = math.copysign(1.0, _coupling(model, *model.coordinates[:2]) * math.cos(down[0]))

    def places(q: np.ndarray) -> np.ndarray:
        shifted = q[::step] - offset
        shifted[:, :slides] *= scale
        if joined:
            shifted[:, slides:] = np.cumsum(shifted[:, slides:], axis=1)
        shifted[:, slides:] *= turn
        return shifted

    drawn = {"measured": _rows(places(measured)), "forecast": _rows(places(forecast))}
    return {
        "kind": kind,
        "t": [round(float(x - t[0]), 5) for x in t],
        **drawn,
        "down": down is not None,
        "length": None if length is None else round(length * scale, 2),
    }


def _filled(q: np.ndarray) -> np.ndarray:
    filled = q.copy()
    for column in filled.T:
        there = np.flatnonzero(np.isfinite(column))
        if there.size:
            place = np.searchsorted(there, np.arange(column.size), side="right") - 1
            column[:] = column[there[np.maximum(place, 0)]]
    return filled


def _rows(q: np.ndarray) -> list[list[float] | None]:
    return [[round(float(x), 4) for x in row] if np.isfinite(row).all() else None for row in q]
