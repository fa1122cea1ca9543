"""Selection of a stick figure for a model, and its frames."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
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


Kind = Literal["links", "cart", "polar", "plane", "blocks", ""]
"""Links from a joint or on a cart, a point in polar or Cartesian coordinates, blocks on a rail; or none."""

_REACH = 98.0  # px: length of all links together, or half the range of sliding bodies
_MOST_LINKS, _MOST_BLOCKS = 7, 4
_STATES = 8  # at which the mass matrix is compared with that of a chain
_APART = 0.02  # largest difference of an entry from that of a chain, for links to scale
_SIMILAR = 0.1  # the same for the kind of drawing, which small additional terms do not change
_SHORTEST = 0.05  # of the longest link: shorter ones could not be seen
_Places = Callable[[np.ndarray], np.ndarray]
_NOTHING = (
    "There is no animation. Angles are drawn only if the kinetic energy of the law is that of a chain of up "
    "to 7 links, of a cart with one or two links, or of a point in polar coordinates; up to 4 other "
    "coordinates are drawn as positions."
)
_LAST = "The last one has the length of the equivalent simple pendulum."


def stick_kind(model: LagrangianModel, angles: Sequence[str]) -> Kind:
    """The figure for the motions of a model. Angles are drawn only if its kinetic energy confirms how.

    Examples
    --------
    >>> from leastaction import LagrangianModel
    >>> from leastaction.model.term import ModelTerm
    >>> def kind(names, angles, *terms):
    ...     return stick_kind(LagrangianModel(names, [ModelTerm(text, 0.5) for text in terms]), angles)
    >>> kind(["theta"], ["theta"], "theta_dot**2")
    'links'
    >>> kind(["r", "phi"], ["phi"], "r_dot**2", "r**2*phi_dot**2")
    'polar'
    >>> kind(["x", "y"], [], "x_dot**2"), kind(["x", "phi"], ["phi"], "x_dot**2", "phi_dot**2")
    ('plane', '')
    """
    names = model.coordinates
    if _polar(model, angles):
        return "polar"
    turning = [name in angles for name in names]
    if any(turning):
        cart = turning in ([False, True], [False, True, True])
        may = cart or (all(turning) and len(names) <= _MOST_LINKS)
        chain = _chain(model, *_pose(model, int(cart)), int(cart), _SIMILAR) if may else None
        return "" if chain is None else "cart" if cart else "links"
    across, up = names if len(names) == 2 else ("", "")
    if across.endswith("x") and up.endswith("y") and across[:-1] == up[:-1]:
        return "plane"
    return "blocks" if len(names) <= _MOST_BLOCKS else ""


def _polar(model: LagrangianModel, angles: Sequence[str] = ()) -> tuple[int, int] | None:
    """Places of r and φ if the kinetic energy is c (ṙ² + r²φ̇²); None if it is not."""
    if model.n_dof != 2:
        return None
    q, masses = _masses(model)
    for r, phi in ((0, 1), (1, 0)):
        along, around = masses[r, r], (masses[phi, phi] / q[r] ** 2).expand()
        if model.coordinates[r] in angles or masses[0, 1] or not (along.is_number and around.is_number):
            continue
        if along > 0 and abs(around - along) <= _SIMILAR * along:
            return r, phi
    return None


def _fall(model: LagrangianModel, r: int, phi: int, distance: float) -> float | None:
    """φ of the downward direction at this distance, as in `hanging_angles`; None without a cosine of φ."""
    q, rates, _ = state_symbols(model.coordinates)
    at_rest = model.lagrangian.subs(dict.fromkeys(rates, 0)).expand()
    try:
        a, b = (float(at_rest.coeff(f(q[phi])).subs(q[r], distance)) for f in (sp.cos, sp.sin))
    except TypeError:  # not a number, because the field changes with time
        return None
    return math.atan2(b, a) if math.hypot(a, b) > 0 else None


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
    model: LagrangianModel, down: Sequence[float] | None, *, joined: bool = False, slides: int = 0
) -> Lengths | None:
    """Lengths of links from the law and from those that the user gave; None if they are not known.

    With absolute angles, the last row of the mass matrix of a chain of n links is m a l_i cos(θ_i − θ_n), and
    I in its last column; so it is proportional to the lengths, the last one of which is I/(m a). The column
    of a cart is m a cos θ_n, so that the quotient is in the unit of its position.

    Parameters
    ----------
    model : LagrangianModel
    down : sequence of float, or None
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
    found = _by_law(model, down, joined, slides)
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


def _masses(model: LagrangianModel) -> tuple[list[sp.Symbol], Any]:
    """Coordinates, and the mass matrix at rest; zero if it has no value there."""
    q, rates, _ = state_symbols(model.coordinates)
    masses = sp.hessian(model.lagrangian, rates).subs(dict.fromkeys(rates, 0))
    return q, sp.zeros(len(q)) if masses.has(sp.DiracDelta, sp.zoo, sp.oo, sp.nan) else masses


def _by_law(
    model: LagrangianModel, down: Sequence[float] | None, joined: bool, slides: int
) -> list[float] | None:
    """Lengths by the last row of the mass matrix; None if they are not known or could not be seen."""
    masses = _chain(model, down, joined, slides)
    if masses is None:
        return None
    lengths = masses[-1, slides:] / (abs(masses[-1, 0]) if slides else 1.0)
    return lengths.tolist() if lengths.min() > _SHORTEST * lengths.max() else None


def _chain(
    model: LagrangianModel, down: Sequence[float] | None, joined: bool, slides: int, apart: float = _APART
) -> np.ndarray | None:
    """Mass matrix of a hanging chain, for absolute angles; None if the model is not that of a chain.

    With absolute angles, its entries are c_ij cos(θ_i − θ_j), c_ij > 0; for a cart, θ_i = 0 and c_ij ≠ 0.
    """
    n = model.n_dof - slides
    q, entries = _masses(model)
    if entries.free_symbols - {*q}:
        return None
    masses = sp.lambdify(q, entries, modules="numpy")
    # from angles of the links, measured from down, to the coordinates and their rates
    change = np.eye(slides + n)
    change[slides:, slides:] -= np.eye(n, k=-1) if joined else 0.0
    zero = np.concatenate([np.zeros(slides), np.zeros(n) if down is None else down])

    def at(turned: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            return change.T @ np.asarray(masses(*(change @ turned + zero)), dtype=float) @ change

    hanging = at(np.zeros(slides + n))
    if not (np.isfinite(hanging).all() and hanging[slides:, slides:].min() > 0.0 and hanging[0, 1:].all()):
        return None
    for angles in np.random.default_rng(0).uniform(-2.0, 2.0, (_STATES, n)):
        turned = np.concatenate([np.zeros(slides), angles])
        expected = hanging * np.cos(turned[:, None] - turned)
        if not (abs(at(turned) - expected) <= apart * abs(hanging)).all():
            return None
    return hanging


def _coupling(model: LagrangianModel, slide: str, link: str) -> float:
    """Coefficient of the product of both velocities and the cosine; positive if the link points forward."""
    texts = {f"{a}_dot*{b}_dot*cos({link})" for a, b in ((slide, link), (link, slide))}
    return sum(term.coefficient for term in model.terms if term.expression.replace(" ", "") in texts)


def frames(motion: Motion, model: LagrangianModel, most: int = 900, kind: Kind = "links") -> dict[str, Any]:
    """Times and frames, as JSON types.

    Links are given by their lengths in pixels and their directions from down, anticlockwise; sliding bodies
    in pixels to the right, and points also upwards. A missing sample repeats the previous one; after the
    end of the forecast there is null, and in ``measured`` for what is neither measured nor estimated.
    ``estimated`` marks the entries of ``measured`` that follow from estimates. ``known`` holds the fields of
    `Lengths`, or null.
    """
    step = -(-motion.t.size // most)
    t, measured, gap = motion.t[::step], motion.observed, np.zeros((1, model.n_dof))
    basis = np.where(np.isfinite(measured), measured, motion.forecast)
    places, shown = _polar_places(model, basis) if kind == "polar" else _places(model, basis, kind)
    gap[:, list(motion.estimated)] = np.nan
    return {
        "kind": kind,
        "t": [round(float(x - t[0]), 5) for x in t],
        "measured": _rows(places(measured[::step]), parts=True),
        "estimated": np.isnan(places(gap)[0]).tolist(),
        "forecast": _rows(places(motion.forecast[::step])),
        **shown,
    }


def _places(model: LagrangianModel, measured: np.ndarray, kind: Kind) -> tuple[_Places, dict[str, Any]]:
    """Rows of the frames for coordinates, and the other entries of `frames`."""
    slides = {"links": 0, "cart": 1}.get(kind, model.n_dof)
    middle = np.nan_to_num(np.nanmean(measured, axis=0))
    linked = slides < model.n_dof
    down, joined = _pose(model, slides) if linked else (None, False)
    lengths = link_lengths(model, down, joined=joined, slides=slides) if linked else None
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
        shifted = q - offset
        shifted[:, :slides] *= scale
        if joined:
            shifted[:, slides:] = np.cumsum(shifted[:, slides:], axis=1)
        shifted[:, slides:] *= turn
        return shifted

    return places, {
        "down": down is not None,
        "lengths": [round(length, 2) for length in drawn_lengths],
        "known": None if lengths is None else asdict(lengths),
    }


def _polar_places(model: LagrangianModel, measured: np.ndarray) -> tuple[_Places, dict[str, Any]]:
    """As `_places`, for a point: to the right at φ = 0, or at the bottom where φ is downward."""
    found = _polar(model)
    assert found is not None
    r, phi = found
    distance = np.abs(measured[:, r])
    scale = _REACH / max(float(np.nanmax(distance)), 1e-12)
    down = _fall(model, r, phi, float(np.nanmedian(distance)))
    right = 0.0 if down is None else down + math.pi / 2

    def places(q: np.ndarray) -> np.ndarray:
        turned = q[:, phi] - right
        return scale * q[:, [r]] * np.column_stack([np.cos(turned), np.sin(turned)])

    return places, {"down": down is not None, "lengths": [], "known": None}


def _pose(model: LagrangianModel, slides: int) -> tuple[list[float] | None, bool]:
    """What `hanging_angles` returns; without gravity, the kinetic energy shows what the angles refer to."""
    down, joined = hanging_angles(model, model.coordinates[slides:])
    if down is None and model.n_dof - slides > 1:
        joined = _chain(model, None, False, slides) is None and _chain(model, None, True, slides) is not None
    return down, joined


def _scale(lengths: Lengths | None, n: int, way: float | None) -> tuple[float, list[float]]:
    """Pixels of a unit of a cart's position, and of each of n links; `way` is the range of the cart."""
    if lengths is None:
        return _REACH / (way or 1.0), [_REACH / max(n, 1)] * n
    total = sum(lengths.values)
    # Links on a cart are drawn to scale if both remain visible.
    scale = _REACH / total if way is None else min(_REACH / way, max(_REACH / (3.0 * way), 60.0 / total))
    return scale, [scale * value for value in lengths.values]


def stick_words(kind: Kind, model: LagrangianModel, shown: dict[str, Any]) -> str:
    """What is to scale in the drawing of `frames`, and what is not; for no drawing, the reason."""
    if not kind:
        return _NOTHING
    parts, known = list[str](), shown["known"]
    if kind == "polar":
        parts.append("The small dot is the origin of the polar coordinates. Distances are to scale.")
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


def _rows(q: np.ndarray, parts: bool = False) -> list[list[float | None] | None]:
    """Rows that are complete, or with `parts` also those with a gap; null for others, and for a gap."""
    rows = [[round(x, 4) if math.isfinite(x) else None for x in row] for row in q.tolist()]
    lacking = all if parts else any
    return [None if lacking(x is None for x in row) else row for row in rows]
