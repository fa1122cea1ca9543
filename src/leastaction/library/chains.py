"""Candidates for chains of many links, few enough for a search.

A planar chain has the kinetic energy Σ_ij m_ij ω_i ω_j cos(φ_i − φ_j) with the angles φ and rates ω of the
links.  If the coordinates are these angles, the factors of q̇_i q̇_j are cos(q_i − q_j).  If each q_i is
measured from the previous link, φ_i = q_1 + … + q_i, and the factors of q̇_i q̇_j are the cosines of sums of
neighbouring angles after the first of i and j: q_2, q_3, q_2 + q_3, … for q̇_1².  This family contains both.

=============  =================================================================================
pair           factors of q̇_i q̇_j; σ is a sum of neighbouring angles, one angle included
=============  =================================================================================
two angles     1, cos σ for the σ after the first of i and j, cos(q_i−q_j), sin(q_i−q_j); x, x²
angle, x       1, cos σ, sin σ
x, y           1
=============  =================================================================================

Potentials are cos σ, sin σ, θ, θ², (θ−φ)² of neighbours, x cos σ, x sin σ, powers of each x and of the
differences x − y of neighbours.  Centres of mass off the line through two joints are in ``standard`` only.
Names must be given in the order of the links, from the base to the end of the chain.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations_with_replacement, pairwise

__all__ = ["chain_kinetic", "chain_potentials", "runs", "runs_after"]


def runs(names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield every run of neighbouring names.

    Examples
    --------
    >>> list(runs(["a", "b", "c"]))
    [('a',), ('b',), ('c',), ('a', 'b'), ('b', 'c'), ('a', 'b', 'c')]
    """
    for length in range(1, len(names) + 1):
        for start in range(len(names) - length + 1):
            yield tuple(names[start : start + length])


def runs_after(a: str, b: str, angles: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield the runs of angles on which the element of the mass matrix for two coordinates may depend.

    If both are angles, these are the angles after the first of them. If one is, they are all angles. If none
    is, there are none, because a mass that only translates is constant.

    Examples
    --------
    >>> list(runs_after("b", "a", ["a", "b", "c"]))
    [('b',), ('c',), ('b', 'c')]
    """
    turning = [list(angles).index(name) for name in (a, b) if name in angles]
    if turning:
        yield from runs(angles[min(turning) + 1 if len(turning) == 2 else 0 :])


def chain_kinetic(coordinates: Sequence[str], angles: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield pairs of coordinates, whose velocities are multiplied, each with one factor."""
    lengths = [name for name in coordinates if name not in angles]
    for a, b in combinations_with_replacement(coordinates, 2):
        turning = (a in angles) + (b in angles)
        yield a, b, "1"
        for run in runs_after(a, b, angles):
            yield a, b, f"cos({'+'.join(run)})"
            if turning == 1:
                yield a, b, f"sin({'+'.join(run)})"
        if turning == 2:
            for wave in ("cos", "sin") if a != b else ():
                yield a, b, f"{wave}({a}-{b})"
            for x in lengths:
                yield from ((a, b, x), (a, b, f"{x}**2"))


def chain_potentials(lengths: Sequence[str], angles: Sequence[str], degree: int) -> Iterator[str]:
    """Yield the potentials."""
    for run in runs(angles):
        total = "+".join(run)
        yield from (f"cos({total})", f"sin({total})")
        yield from (f"{x}*{wave}({total})" for x in lengths for wave in ("cos", "sin"))
    for a in angles:
        yield from (a, f"{a}**2")
    yield from (f"({a}-{b})**2" for a, b in pairwise(angles))
    for x in lengths:
        yield from (x if power == 1 else f"{x}**{power}" for power in range(1, degree + 1))
    for x, y in pairwise(lengths):
        yield from (f"({x}-{y})**{power}" for power in range(2, degree + 1))
