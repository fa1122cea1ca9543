"""Families of candidates that mechanical systems are made of, generated from the kinds of coordinates.

Kinetic terms are q̇_i q̇_j g(q) for every pair i ≤ j, with the factors g of the table; potential terms are
functions of q alone.  θ, φ stand for angles, x, y for other coordinates.

========  =====================================  ==================================================
size      factors g of kinetic terms             potential terms
========  =====================================  ==================================================
compact   1, cos θ, sin² θ, cos(θ−φ), x, x²,     cos θ, sin θ, cos(θ±φ), cos(θ+φ+ψ), x cos θ,
          x cos θ, x² sin² θ                     x sin θ, monomials in x, y up to degree 2
standard  also sin θ, sin(θ−φ), x sin θ, x y     also sin² θ, θ, θ², θ φ, sin(θ±φ), sin(θ+φ+ψ),
                                                 monomials up to degree 4
large     also sin θ cos θ, cos(θ+φ), sin(θ+φ),  also sin θ cos θ, x² cos θ, x² sin θ, 1/x, log x,
          x² cos θ, x² sin θ, and the            monomials up to degree 6
          gyroscopic x ẏ
========  =====================================  ==================================================

Every size can be had with the gyroscopic terms x q̇, q̇ cos θ and q̇ sin θ beside them.
No generated term is null or a sum of others: kinetic terms with one pair q̇_i q̇_j are independent when
their factors are, and potentials when they are independent beside constants.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, combinations_with_replacement, permutations

from leastaction.errors import InputError
from leastaction.library.parser import normalise

__all__ = ["MAX_TERMS", "SIZES", "check_angles", "mechanical_terms"]

SIZES = ("compact", "standard", "large")
MAX_TERMS = 1500
_DEGREES = {"compact": 2, "standard": 4, "large": 6}
_MAX_COORDINATES = 10
_MAX_DEGREE = 12


def mechanical_terms(
    coordinates: Sequence[str],
    angles: Sequence[str] = (),
    size: str = "standard",
    degree: int | None = None,
    gyroscopic: bool = False,
) -> list[str]:
    """Return the texts of the generated candidates, kinetic terms first.

    Parameters
    ----------
    coordinates, angles
        Names; the angles are some of the coordinates.
    size
        ``"compact"``, ``"standard"`` or ``"large"``.
    degree
        Greatest total degree of the monomials in coordinates that are no angles; by default 2, 4 or 6.
    gyroscopic
        Whether to add terms linear in the velocities.

    Raises
    ------
    InputError
        For an unknown size, a degree that is no small positive integer, or too many coordinates.

    Examples
    --------
    >>> mechanical_terms(["x"])
    ['x_dot**2', 'x_dot**2*x', 'x_dot**2*x**2', 'x', 'x**2', 'x**3', 'x**4']
    """
    if size not in SIZES:
        raise InputError(f"size {size!r} is unknown; expected one of {', '.join(map(repr, SIZES))}")
    degree = _DEGREES[size] if degree is None else degree
    if isinstance(degree, bool) or not isinstance(degree, int) or not 1 <= degree <= _MAX_DEGREE:
        raise InputError(f"degree {degree!r} is not possible; expected an integer from 1 to {_MAX_DEGREE}")
    if len(coordinates) > _MAX_COORDINATES:
        raise InputError(
            f"{len(coordinates)} coordinates are too many to generate a library for; expected at most "
            f"{_MAX_COORDINATES}: write the candidates down by hand"
        )
    lengths = [name for name in coordinates if name not in angles]
    factors = list(_kinetic_factors(lengths, angles, size))
    kinetic = [
        _product(a, b) if factor == "1" else f"{_product(a, b)}*{factor}"
        for a, b in combinations_with_replacement([f"{name}_dot" for name in coordinates], 2)
        for factor in factors
    ]
    turned = coordinates if gyroscopic else lengths if size == "large" else ()
    return [*kinetic, *_gyroscopic(turned, angles), *_potentials(lengths, angles, size, degree)]


def check_angles(angles: Iterable[str] | str, coordinates: tuple[str, ...]) -> tuple[str, ...]:
    """Return the angles in the order of the coordinates; each must be one of them."""
    given = (angles,) if isinstance(angles, str) else tuple(angles)
    for name in given:
        if not isinstance(name, str) or normalise(name) not in coordinates:
            raise InputError(f"angle {name!r} is not a coordinate; expected names out of {list(coordinates)}")
    wanted = {normalise(name) for name in given}
    return tuple(name for name in coordinates if name in wanted)


def _product(a: str, b: str) -> str:
    return f"{a}**2" if a == b else f"{a}*{b}"


def _kinetic_factors(lengths: Sequence[str], angles: Sequence[str], size: str) -> Iterator[str]:
    standard, large = size != "compact", size == "large"
    yield "1"
    for a in angles:
        yield from (f"cos({a})", f"sin({a})**2")
        yield from (f"sin({a})",) if standard else ()
        yield from (f"sin({a})*cos({a})",) if large else ()
    for a, b in combinations(angles, 2):
        yield f"cos({a}-{b})"
        yield from (f"sin({a}-{b})",) if standard else ()
        yield from (f"cos({a}+{b})", f"sin({a}+{b})") if large else ()
    for x in lengths:
        yield from (x, f"{x}**2")
        for a in angles:
            yield from (f"{x}*cos({a})", f"{x}**2*sin({a})**2")
            yield from (f"{x}*sin({a})",) if standard else ()
            yield from (f"{x}**2*cos({a})", f"{x}**2*sin({a})") if large else ()
    if standard:
        yield from (f"{x}*{y}" for x, y in combinations(lengths, 2))


def _gyroscopic(coordinates: Sequence[str], angles: Sequence[str]) -> list[str]:
    """Return terms linear in the velocities; of x ẏ and y ẋ, which differ by d(xy)/dt, the first."""
    out: list[str] = []
    for a, b in permutations(coordinates, 2):
        if a in angles:
            out += [f"{b}_dot*cos({a})", f"{b}_dot*sin({a})"]
        elif f"{b}*{a}_dot" not in out:
            out.append(f"{a}*{b}_dot")
    return out


def _potentials(lengths: Sequence[str], angles: Sequence[str], size: str, degree: int) -> Iterator[str]:
    standard, large = size != "compact", size == "large"
    for a in angles:
        yield from (f"cos({a})", f"sin({a})")
        yield from (f"sin({a})**2", a, f"{a}**2") if standard else ()
        yield from (f"sin({a})*cos({a})",) if large else ()
    for a, b in combinations(angles, 2):
        yield from (f"cos({a}-{b})", f"cos({a}+{b})")
        yield from (f"sin({a}-{b})", f"sin({a}+{b})", f"{a}*{b}") if standard else ()
    for triple in combinations(angles, 3):
        yield f"cos({'+'.join(triple)})"
        yield from (f"sin({'+'.join(triple)})",) if standard else ()
    for x in lengths:
        for a in angles:
            yield from (f"{x}*cos({a})", f"{x}*sin({a})")
            yield from (f"{x}**2*cos({a})", f"{x}**2*sin({a})") if large else ()
    for total in range(1, degree + 1):
        yield from (_monomial(names) for names in combinations_with_replacement(lengths, total))
    if large:
        for x in lengths:
            yield from (f"1/{x}", f"log({x})")


def _monomial(names: Sequence[str]) -> str:
    powers = {name: names.count(name) for name in names}
    return "*".join(name if n == 1 else f"{name}**{n}" for name, n in powers.items())
