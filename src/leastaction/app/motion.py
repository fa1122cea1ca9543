"""Selection of a stick figure for a model, and its frames."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import sympy as sp

from leastaction.mechanics.equations import state_symbols

if TYPE_CHECKING:
    from leastaction import LagrangianModel
    from leastaction.app.jobs import Motion

__all__ = ["Kind", "Lengths", "frames", "hanging_angles", "link_lengths", "stick_kind", "stick_words"]


Kind = Literal["links", "cart", "plane", "blocks", ""]
"""Kind of drawing: links from a fixed joint or on a cart, a point in a plane, blocks on a rail; or none."""

_REACH = 98.0  # px: length of all links together, or half the range of sliding bodies
_MOST_LINKS, _MOST_BLOCKS = 7, 4
_STATES = 8  # at which the mass matrix is compared with that of a chain
_APART = 0.02  # largest difference, as a share of the row
_SHORTEST = 0.05  # of the longest link: shorter ones could not be seen
_LAST = "The last one has the length of the equivalent simple pendulum."


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


@dataclass(frozen=True)
class Lengths:
    """Lengths of the links of a chain.

    Attributes
    ----------
    values : tuple of float
        The last one is that of the equivalent simple pendulum, unless it was given.
    metres : bool
        Whether they are in metres. Otherwise only ratios count; on a cart, the unit is that of its position.
    given, last_given : bool
        Whether the user gave some of them, and the last one.
    """

    values: tuple[float, ...]
    metres: bool = False
    given: bool = False
    last_given: bool = False


def link_lengths(
    model: LagrangianModel, down: Sequence[float], *, joined: bool = False, slides: int = 0
) -> Lengths | None:
    """Lengths of links from the law and from those that the user gave; None if they are not known.

    With absolute angles, the last row of the mass matrix of a chain of n links is m a l_i cos(θ_i − θ_n), and
    I in its last column; so it is proportional to the lengths, the last one of which is I/(m a). The column
    of a cart is m a cos θ_n, so that the quotient is in the unit of its position.

    Parameters
    ----------
    model : LagrangianModel
    down : sequence of float
        As from `hanging_angles`.
    joined : bool
        Whether each angle is relative to the previous link.
    slides : int
        Number of coordinates before the links: 1 for a cart.

    Examples
    --------
    >>> from leastaction import LagrangianModel
    >>> from leastaction.model.term import ModelTerm
    >>> terms = [ModelTerm("x_dot**2", 1.0), ModelTerm("a_dot**2", 0.25)]
    >>> terms += [ModelTerm("x_dot*a_dot*cos(a)", -1.0)]
    >>> link_lengths(LagrangianModel(["x", "a"], terms), [0.0], slides=1).values
    (0.5,)
    """
    given = model.provenance.get("options", {}).get("lengths", {})
    links = model.coordinates[slides:]
    told = any(name in given for name in links), links[-1] in given
    found = _row(model, down, joined, slides)
    if found is None:
        values = tuple(given[name] for name in links if name in given)
        return Lengths(values, True, *told) if len(values) == len(links) else None
    if slides:
        return Lengths(tuple(found))
    known = {ratio.link: ratio.on_earth for ratio in model.gravity() if ratio.link != links[-1]}
    known |= {name: given[name] for name in links if name in given}
    by_law = dict(zip(links, found, strict=True))
    scale = next((known[name] / by_law[name] for name in links if name in known), None)
    if scale is None:
        return Lengths(tuple(found))
    return Lengths(tuple(given.get(name, scale * by_law[name]) for name in links), True, *told)


def _row(model: LagrangianModel, down: Sequence[float], joined: bool, slides: int) -> list[float] | None:
    """Lengths by the last row of the mass matrix; None if it is not that of a chain."""
    n = model.n_dof - slides
    q, rates, _ = state_symbols(model.coordinates)
    entries = [sp.diff(model.lagrangian, rates[-1], rate) for rate in rates]
    if {*sp.Tuple(*entries).free_symbols} - {*q} or not entries[-1]:
        return None
    row = sp.lambdify(q, entries, modules="numpy")
    # from angles of the links, measured from down, to the coordinates and their rates
    steps = np.eye(n) - (np.eye(n, k=-1) if joined else 0.0)
    change = np.block([[np.eye(slides), np.zeros((slides, n))], [np.zeros((n, slides)), steps]])

    def at(angles: np.ndarray) -> np.ndarray:
        place = np.concatenate([np.zeros(slides), steps @ angles + np.asarray(down)])
        with np.errstate(all="ignore"):
            return np.array([float(entry) for entry in row(*place)]) @ change

    hanging = at(np.zeros(n))
    if not np.isfinite(hanging).all():
        return None
    for angles in np.random.default_rng(0).uniform(-2.0, 2.0, (_STATES, n)):
        between = np.cos(np.concatenate([np.full(slides, angles[-1]), angles[-1] - angles]))
        if not np.allclose(at(angles), hanging * between, rtol=0.0, atol=_APART * abs(hanging).max()):
            return None
    lengths = hanging[slides:] / (abs(hanging[0]) if slides and hanging[0] else 1.0)
    seen = lengths.min() > _SHORTEST * lengths.max() and (hanging[0] or not slides)
    return lengths.tolist() if seen else None


def _coupling(model: LagrangianModel, slide: str, link: str) -> float:
    """Coefficient of the product of both velocities and the cosine; positive if the link points forward."""
    texts = {f"{a}_dot*{b}_dot*cos({link})" for a, b in ((slide, link), (link, slide))}
    return sum(term.coefficient for term in model.terms if term.expression.replace(" ", "") in texts)


def frames(motion: Motion, model: LagrangianModel, most: int = 900, kind: Kind = "links") -> dict[str, Any]:
    """Times and frames, as JSON types.

    Links are given by their lengths in pixels and their directions from down, anticlockwise; sliding bodies
    in pixels to the right, and in a plane also upwards. A missing sample repeats the previous one; after the
    end of the forecast there is null. ``known`` holds the fields of `Lengths`, or null.
    """
    step = -(-motion.t.size // most)
    t = motion.t[::step]
    slides = {"links": 0, "cart": 1}.get(kind, model.n_dof)
    measured, forecast = _filled(motion.measured), motion.forecast
    middle = np.nan_to_num(np.nanmean(measured, axis=0))
    down, joined, lengths = _links(model, slides)
    offset = middle.copy()
    if down is not None:
        offset[slides:] = down
    elif lengths is not None:  # only a common turn is free
        offset[slides + 1 :] = 0.0 if joined else middle[slides]
    way = max(float(np.nanmax(np.abs(measured - middle)[:, :slides], initial=0.0)), 1e-12)
    scale, drawn_lengths = _scale(lengths, model.n_dof - slides, way if slides else None)

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
        "lengths": [round(length, 2) for length in drawn_lengths],
        "known": None if lengths is None else asdict(lengths),
    }


def _links(model: LagrangianModel, slides: int) -> tuple[list[float] | None, bool, Lengths | None]:
    """What `hanging_angles` returns, and the lengths."""
    if slides >= model.n_dof:
        return None, False, None
    down, joined = hanging_angles(model, model.coordinates[slides:])
    zero = down or [0.0] * (model.n_dof - slides)
    if down is None and len(zero) > 1:
        # without gravity, the kinetic energy shows what the angles are relative to
        joined = not _row(model, zero, False, slides) and bool(_row(model, zero, True, slides))
    return down, joined, link_lengths(model, zero, joined=joined, slides=slides)


def _scale(lengths: Lengths | None, n: int, way: float | None) -> tuple[float, list[float]]:
    """Pixels of a unit of a cart's position, and of each of n links; `way` is the range of the cart."""
    if lengths is None:
        return _REACH / (way or 1.0), [_REACH / max(n, 1)] * n
    total = sum(lengths.values)
    # Links on a cart are drawn to scale if both remain visible.
    scale = _REACH / total if way is None else min(_REACH / way, max(_REACH / (3.0 * way), 60.0 / total))
    return scale, [scale * value for value in lengths.values]


def stick_words(kind: Kind, model: LagrangianModel, shown: dict[str, Any]) -> str:
    """What is to scale in the drawing of `frames`, and what is not."""
    parts = []
    known = shown["known"]
    if kind == "links" and model.n_dof > 1:
        parts.append(
            _words_of_lengths(Lengths(**known))
            if known
            else "All links are drawn equally long, because the law does not determine their lengths."
        )
    if kind == "cart":
        many = model.n_dof > 2
        if not known:
            parts.append("The lengths of links are not to the scale of the cart's position.")
        elif many:
            parts.append(f"The links are drawn to the scale of the cart's position. {_LAST}")
        else:
            parts.append("The link has its effective length, to the scale of the cart's position.")
    if kind in ("links", "cart") and not shown["down"]:
        parts.append("The model has no gravity term: the middle of the motion is drawn downwards.")
    if kind == "blocks" and model.n_dof > 1:
        parts.append("The distance between the blocks is not to scale; their motions are.")
    return " ".join(parts)


def _words_of_lengths(lengths: Lengths) -> str:
    if lengths.metres:
        *first, last = (f"{value:.3g} m" for value in lengths.values)
        text = f"The links are drawn to scale: {', '.join(first)} and {last}"
        text += "" if lengths.given else ", for g = 9.81 m/s²"
    else:
        text = "The links are drawn to scale: " + " : ".join(
            f"{value / lengths.values[0]:.3g}" for value in lengths.values
        )
    return f"{text}." if lengths.last_given else f"{text}. {_LAST}"


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
