"""Which stick figure a model deserves, and the frames for it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from leastaction import LagrangianModel
    from leastaction.app.jobs import Motion

__all__ = ["frames", "hanging_angles", "is_pendulum"]


def is_pendulum(coordinates: Sequence[str], angles: Sequence[str]) -> bool:
    """Whether one or two links that turn in a plane can stand for the motion.

    Examples
    --------
    >>> is_pendulum(["theta"], ["theta"]), is_pendulum(["x", "theta"], ["theta"])
    (True, False)
    """
    return 1 <= len(coordinates) <= 2 and set(coordinates) == set(angles)


def hanging_angles(model: LagrangianModel) -> tuple[list[float] | None, bool]:
    """Where each link hangs, and whether the second angle is counted from the first link.

    L = T − V holds a cos q + b sin q = R cos(q − δ) for a link in a uniform field, with its minimum of V
    at q = δ if R is counted positive: this is where the link points down.

    Returns
    -------
    list of float, or None
        δ for each coordinate; None where the model has no such field: then nothing is known to be down.
    bool
    """
    names = model.coordinates
    values = {term.expression.replace(" ", ""): term.coefficient for term in model.terms}
    joined = len(names) == 2 and any(_has_sum(text, names) for text in values if "_dot" not in text)
    down = []
    for k, name in enumerate(names):
        inside = [name] if not (joined and k == 1) else [f"{names[0]}+{name}", f"{name}+{names[0]}"]
        a, b = (sum(values.get(f"{f}({text})", 0.0) for text in inside) for f in ("cos", "sin"))
        down.append(math.atan2(b, a) if math.hypot(a, b) > 0 else 0.0)
        if k == 0 and math.hypot(a, b) == 0:
            return None, joined
    if joined:
        down[1] -= down[0]  # δ of the sum, less that of the first link
    return down, joined


def _has_sum(text: str, names: Sequence[str]) -> bool:
    first, second = map(re.escape, names)
    return re.search(rf"\((?:{first}\+{second}|{second}\+{first})\)", text) is not None


def frames(motion: Motion, model: LagrangianModel, most: int = 900) -> dict[str, Any]:
    """Times and the directions of the links, from down and anticlockwise, as JSON types.

    A missing sample repeats the one before; where the forecast has ended there is null.
    """
    step = -(-motion.t.size // most)
    t = motion.t[::step]
    down, joined = hanging_angles(model)
    middle = np.nan_to_num(np.nanmean(_filled(motion.measured), axis=0))
    offset = middle if down is None else np.array(down)

    def directions(q: np.ndarray) -> np.ndarray:
        turned = q - offset
        return np.cumsum(turned, axis=1) if joined else turned

    measured = directions(_filled(motion.measured)[::step])
    forecast = directions(motion.forecast[::step])
    return {
        "t": [round(float(x - t[0]), 5) for x in t],
        "measured": _rows(measured),
        "forecast": _rows(forecast),
        "down": down is not None,
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
