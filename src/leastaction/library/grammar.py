"""Candidates generated from the names of the coordinates alone, each with its description length.

With θ, φ for angles and x, y for other coordinates, a function g of the coordinates is one of

=============  ====================================================================================
waves          cos θ, sin θ, their products of two (also of two angles), cos 2θ, sin 2θ, cos(θ±φ),
               sin(θ±φ), cos and sin of sums of three or more neighbouring angles
monomials      1, x, x², x y, and these times a wave
=============  ====================================================================================

and a candidate is q̇_i q̇_j g for a pair i ≤ j, or a potential: any g, monomials in x, y up to degree 6 (4 from
three on), (x−y)ⁿ up to n = 4, θ, θ², θφ, (θ−φ)², and 1/x, 1/x², log x, √x, as well as the root, the
logarithm, 1/r and 1/r² of every r² = x² + y² + ….

The grammar can express one function in several ways; `Library.reduced` keeps the shortest.

The *size* of an expression is the number of its names and functions and of its powers beyond the first:
2 for θ̇², 3 for sin² θ, 7 for φ̇² x² sin² θ.  Its description length is log S + log N, with the number S of
sizes and the number N of expressions of that size.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations, combinations_with_replacement
from math import log

import sympy

from leastaction.library.chains import runs
from leastaction.library.families import check_count, monomial, velocity_product
from leastaction.library.term import Term, make_term

__all__ = ["description_lengths", "grown_terms", "size_of"]

_DEGREES = {1: 6, 2: 6}  # number of positions → degree of potentials
_DEGREE = 4  # for more positions, and for differences


def grown_terms(coordinates: Sequence[str], angles: Sequence[str]) -> list[Term]:
    """Candidates by increasing size.

    Raises
    ------
    InputError
        If there would be more than 1500.

    Examples
    --------
    >>> [term.text for term in grown_terms(["theta"], ["theta"])][:6]
    ['theta', 'theta_dot**2', 'cos(theta)', 'sin(theta)', 'theta**2', 'sin(theta)**2']
    """
    positions = [name for name in coordinates if name not in angles]
    factors = ["1", *_waves(angles)]
    monomials = ["1", *_monomials(positions, 1, 2)]
    functions = [_times(m, w) for m in monomials for w in factors]
    pairs = combinations_with_replacement(coordinates, 2)
    texts = [_times(velocity_product(a, b), g) for a, b in pairs for g in functions]
    texts += [*functions[1:], *_potentials(positions, angles)]
    check_count(
        len(texts), f"the symbolic library over {len(coordinates)} coordinates", "use Library.mechanical"
    )
    names = [*coordinates, *(f"{name}_dot" for name in coordinates)]
    return sorted((make_term(text, names) for text in texts), key=lambda term: size_of(term.expr))


def size_of(expr: sympy.Basic) -> int:
    """Names, functions and powers beyond the first; numbers that multiply or stand in powers count one.

    Examples
    --------
    >>> x, y = sympy.symbols("x y", real=True)
    >>> [size_of(e) for e in (x, x**3, sympy.cos(2 * x), sympy.sin(x) ** 2, 1 / sympy.sqrt(x**2 + y**2))]
    [1, 3, 3, 3, 6]
    """
    if expr.is_Symbol:
        return 1
    if expr.is_Number:
        return 0 if abs(expr) == 1 else 1  # type: ignore[operator]
    if isinstance(expr, sympy.Pow):
        base, power = expr.args
        if not power.is_Number:
            return size_of(base) + size_of(power) + 1
        steps = abs(int(power)) - 1 if power.is_Integer else 1
        return size_of(base) + steps + bool(power.is_negative)
    return sum(map(size_of, expr.args)) + isinstance(expr, sympy.Function)


def description_lengths(terms: Sequence[Term]) -> dict[Term, float]:
    """Code length of each term in nats: of its size, then of its choice among the terms of that size.

    exp(−length) sums to one over all terms and is a prior that favours short ones.

    Examples
    --------
    >>> lengths = description_lengths(grown_terms(["theta"], ["theta"]))
    >>> [round(length, 2) for length in lengths.values()][:3]
    [1.79, 3.18, 3.18]
    """
    sizes = {term: size_of(term.expr) for term in terms}
    counts = Counter(sizes.values())
    return {term: log(len(counts)) + log(counts[size]) for term, size in sizes.items()}


def _times(a: str, b: str) -> str:
    return b if a == "1" else a if b == "1" else f"{a}*{b}"


def _monomials(positions: Sequence[str], low: int, high: int) -> list[str]:
    degrees = range(low, high + 1)
    return [monomial(names) for d in degrees for names in combinations_with_replacement(positions, d)]


def _waves(angles: Sequence[str]) -> Iterator[str]:
    for a in angles:
        yield from (f"cos({a})", f"sin({a})", f"sin({a})**2", f"cos({a})**2", f"sin({a})*cos({a})")
        yield from (f"cos(2*{a})", f"sin(2*{a})")
    for a, b in combinations(angles, 2):
        for sign in "-+":
            yield from (f"cos({a}{sign}{b})", f"sin({a}{sign}{b})")
        yield from (f"{f}({a})*{g}({b})" for f in ("cos", "sin") for g in ("cos", "sin"))
    for run in runs(angles):
        if len(run) > 2:
            yield from (f"cos({'+'.join(run)})", f"sin({'+'.join(run)})")


def _potentials(positions: Sequence[str], angles: Sequence[str]) -> Iterator[str]:
    """Potentials beyond products of monomials and waves."""
    yield from _monomials(positions, 3, _DEGREES.get(len(positions), _DEGREE))
    for x, y in combinations(positions, 2):
        yield from (f"({x}-{y})**{n}" for n in range(2, _DEGREE + 1))
    for a in angles:
        yield from (a, f"{a}**2")
    for a, b in combinations(angles, 2):
        yield from (f"{a}*{b}", f"({a}-{b})**2")
    for x in positions:
        yield from (f"1/{x}", f"1/{x}**2", f"log({x})", f"sqrt({x})")
    for n in range(2, len(positions) + 1):
        for some in combinations(positions, n):
            square = "+".join(f"{x}**2" for x in some)
            yield from (f"sqrt({square})", f"log({square})", f"1/sqrt({square})", f"1/({square})")
