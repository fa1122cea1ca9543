"""Families of friction, by name, as candidates of the dissipation function.

With the rate v of a joint, ε the width in which |v| is smoothed, and −∂ψ/∂v the force that opposes motion:

==========  ====================================================  =======================================
family      candidates ψ                                          force −∂ψ/∂v
==========  ====================================================  =======================================
viscous     v²/2                                                  −v
dry         |v|                                                   −sgn v (Coulomb)
stribeck    |v|, −v_s exp(−|v|/v_s)                               −sgn v, −sgn v exp(−|v|/v_s)
quadratic   |v|³/3                                                −v |v|
load        |v|, |v| |cos q|, |v| |sin q|; for lengths |v| |q|    −sgn v times the size of a load
asymmetric  v²/2, |v|, v |v|/2, v                                 −|v| and −1, of either sign
==========  ====================================================  =======================================

``auto`` is viscous and dry.  A family contains the symmetric friction that it modifies, so that each can be
used alone.  Rates are those of every coordinate and, except for ``load``, differences between neighbours of
one kind: the rate of a joint between two links is a coordinate rate if angles are relative, and a difference
of two if they are measured from a fixed direction.

The excess of static friction over sliding friction decays with the velocity scale v_s of Stribeck (1902), in
the form of Tustin (1947), J. IEE 94:143; see Armstrong-Hélouvry, Dupont & Canudas de Wit (1994), Automatica
30:1083.  The scale is a shape parameter, ``{x_stribeck}`` for the rate of x.

The load depends on the position alone: gravity loads a bearing by |cos q| and a gear by |sin q|, a spring by
|q|. Friction that grows with a measured torque is not a function of q and q̇.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import sympy

from leastaction.library.term import Candidate, Term

__all__ = ["FRICTION", "friction_terms", "has_direction", "with_families"]

# of a rate v, or (v) for a difference; {s} is the name of the Stribeck scale in braces
_OF_RATES = {
    "auto": ("{(v)}**2/2", "abs({v})"),
    "viscous": ("{(v)}**2/2",),
    "dry": ("abs({v})",),
    "stribeck": ("abs({v})", "-{s}*exp(-abs({v})/{s})"),
    "quadratic": ("abs({v})**3/3",),
    "asymmetric": ("{(v)}**2/2", "abs({v})", "{(v)}*abs({v})/2", "{v}"),
}
FRICTION = (*_OF_RATES, "load")
"""Names of the families."""


def friction_terms(family: str, coordinates: Sequence[str], angles: Sequence[str] = ()) -> list[str]:
    """Return the texts of a family's candidates.

    Parameters
    ----------
    family
        One of `FRICTION`.
    coordinates, angles
        Names; the angles are some of the coordinates.

    Examples
    --------
    >>> friction_terms("auto", ["x"])
    ['x_dot**2/2', 'abs(x_dot)']
    >>> friction_terms("stribeck", ["a", "b"], ["a", "b"])[4:]
    ['abs(a_dot-b_dot)', '-{a_b_stribeck}*exp(-abs(a_dot-b_dot)/{a_b_stribeck})']
    >>> friction_terms("load", ["a", "x"], ["a"])[:3]
    ['abs(a_dot)', 'abs(a_dot)*abs(cos(a))', 'abs(a_dot)*abs(sin(a))']
    """
    if family == "load":
        return [text for name in coordinates for text in _load(name, name in angles)]
    lengths = [name for name in coordinates if name not in angles]
    pairs = [pair for kind in (angles, lengths) for pair in pairwise(kind)]
    joints = [{"v": f"{a}_dot", "(v)": f"{a}_dot", "s": f"{{{a}_stribeck}}"} for a in coordinates]
    for a, b in pairs:
        rate = f"{a}_dot-{b}_dot"
        joints.append({"v": rate, "(v)": f"({rate})", "s": f"{{{a}_{b}_stribeck}}"})
    return [text.format_map(joint) for joint in joints for text in _OF_RATES[family]]


def _load(name: str, turns: bool) -> list[str]:
    dry = f"abs({name}_dot)"
    loads = [f"abs(cos({name}))", f"abs(sin({name}))"] if turns else [f"abs({name})"]
    return [dry, *(f"{dry}*{load}" for load in loads)]


def with_families(
    given: Iterable[Candidate] | Candidate, coordinates: Sequence[str], angles: Sequence[str]
) -> Iterable[Candidate] | Candidate:
    """Candidates for friction, with the name of a family replaced by its members, each once.

    Examples
    --------
    >>> with_families(["auto", "x_dot**4"], ["x"], [])
    ['x_dot**2/2', 'abs(x_dot)', 'x_dot**4']
    """
    if isinstance(given, str) and given in FRICTION:
        given = [given]
    if not isinstance(given, Iterable) or isinstance(given, Candidate):
        return given  # the caller refuses it
    out: list[Candidate] = []
    for item in given:
        if isinstance(item, str) and item in FRICTION:
            out += [text for text in friction_terms(item, coordinates, angles) if text not in out]
        else:
            out.append(item)
    return out


def has_direction(term: Term) -> bool:
    """Tell whether friction changes sign with the direction of motion: its coefficient may be negative.

    Such a term, ψ(q, −q̇) = −ψ(q, q̇), is the difference of friction between the directions. By itself, it
    dissipates energy in one direction and supplies it in the other.

    Examples
    --------
    >>> from leastaction.library.term import make_term
    >>> names = ["x", "x_dot"]
    >>> [has_direction(make_term(t, names, kind="dissipation")) for t in ("x_dot*abs(x_dot)/2", "abs(x_dot)")]
    [True, False]
    """
    if term.kind != "dissipation":
        return False
    expr = term.expr if term.template is None else term.template.term.expr
    back = {symbol: -symbol for symbol in expr.free_symbols if str(symbol).endswith("_dot")}
    return bool(sympy.expand(expr.xreplace(back) + expr) == 0)
