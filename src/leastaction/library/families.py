"""Families of candidates of mechanical systems, generated from the kinds of coordinates.

Kinetic terms are q̇_i q̇_j g(q) for every pair i ≤ j, with the factors g of the table; potential terms are
functions of q alone.  θ, φ stand for angles, x, y for other coordinates.

========  =====================================  ==================================================
size      factors g of kinetic terms             potential terms
========  =====================================  ==================================================
compact   1, cos θ, sin² θ, cos(θ−φ), x, x²,     cos θ, sin θ, cos(θ±φ), cos(θ+φ+ψ), x cos θ,
          x cos θ, x² sin² θ                     x sin θ, monomials in x, y up to degree 2
standard  also sin θ, sin(θ−φ), x sin θ, x y,    also sin² θ, θ, θ², θ φ, sin(θ±φ), sin(θ+φ+ψ),
          cos σ, sin σ, sin² σ, cos σ cos τ      cos σ, sin σ, x cos σ, x sin σ,
                                                 monomials up to degree 4
large     also sin θ cos θ, cos(θ+φ), sin(θ+φ),  also sin θ cos θ, x² cos θ, x² sin θ, 1/x, log x,
          x² cos θ, x² sin θ, and the            monomials up to degree 6
          gyroscopic x ẏ
========  =====================================  ==================================================

σ and τ are sums of two or more neighbouring angles. In a chain of links with relative angles, they are the
angles between links that do not touch.  The element m_ij of the mass matrix depends only on the joints after
the first of i and j, so q̇_i q̇_j is combined with the sums of these; if one coordinate is not an angle, with
all sums. sin² σ and cos σ cos τ (τ starts where σ does, and may be one angle) are factors of q̇_i²: an arm on
a turning base.  With these terms, ``standard`` contains every planar chain with absolute or relative angles.

The fourth family, ``chain``, is for many coordinates; see `leastaction.library.chains`.  ``auto`` takes
``standard`` if that has at most 250 candidates.  Otherwise it takes ``chain`` if at least two coordinates are
angles, and ``compact`` if not.  If that has more than 250 candidates, too, it takes the smallest of the
three.

The gyroscopic terms x q̇, q̇ cos θ and q̇ sin θ can be added to every size.  No generated term is null or a sum
of others: kinetic terms with one pair q̇_i q̇_j are independent if their factors are, and potentials if they
are independent up to constants.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, combinations_with_replacement, permutations

from leastaction.errors import InputError
from leastaction.library.chains import chain_kinetic, chain_potentials, runs, runs_after
from leastaction.library.parser import normalise

__all__ = [
    "ALL_SIZES",
    "MAX_TERMS",
    "SIZES",
    "check_angles",
    "check_count",
    "choose_size",
    "mechanical_terms",
    "monomial",
    "velocity_product",
]

SIZES = ("compact", "standard", "large")
ALL_SIZES = ("auto", "compact", "chain", "standard", "large")
MAX_TERMS = 1500
_SEARCHABLE = 250  # candidates that "auto" offers
_DEGREES = {"compact": 2, "chain": 4, "standard": 4, "large": 6}
_MAX_COORDINATES = 10
_MAX_DEGREE = 12


def mechanical_terms(
    coordinates: Sequence[str],
    angles: Sequence[str] = (),
    size: str | None = "auto",
    degree: int | None = None,
    gyroscopic: bool = False,
) -> list[str]:
    """Return the texts of the generated candidates, kinetic terms first.

    Parameters
    ----------
    coordinates, angles
        Names; the angles are some of the coordinates.
    size
        ``"compact"``, ``"standard"``, ``"large"`` or ``"chain"``; ``"auto"`` or None: see `choose_size`.
    degree
        Greatest total degree of the monomials in coordinates that are not angles; by default 2, 4 or 6.
    gyroscopic
        Whether to add terms linear in the velocities.

    Raises
    ------
    InputError
        If the size is unknown, the degree is not a small positive integer, or there are too many coordinates.

    Examples
    --------
    >>> mechanical_terms(["x"])
    ['x_dot**2', 'x_dot**2*x', 'x_dot**2*x**2', 'x', 'x**2', 'x**3', 'x**4']
    """
    size = "auto" if size is None else size
    if size not in ALL_SIZES:
        raise InputError(f"size {size!r} is unknown; expected one of {', '.join(map(repr, ALL_SIZES))}")
    if degree is not None:
        _check_degree(degree)
    if len(coordinates) > _MAX_COORDINATES:
        raise InputError(
            f"{len(coordinates)} coordinates are too many to generate a library for; expected at most "
            f"{_MAX_COORDINATES}: write the candidates down by hand"
        )
    if size == "auto":
        size = choose_size(coordinates, angles, degree, gyroscopic)
    degree = _DEGREES[size] if degree is None else degree
    lengths = [name for name in coordinates if name not in angles]
    kinetic = [
        velocity_product(a, b) + ("" if factor == "1" else f"*{factor}")
        for a, b, factor in _kinetic(coordinates, lengths, angles, size)
    ]
    turned = coordinates if gyroscopic else lengths if size == "large" else ()
    potentials = (
        chain_potentials(lengths, angles, degree)
        if size == "chain"
        else _potentials(lengths, angles, size, degree)
    )
    return [*kinetic, *_gyroscopic(turned, angles), *potentials]


def _check_degree(degree: object) -> None:
    if isinstance(degree, bool) or not isinstance(degree, int) or not 1 <= degree <= _MAX_DEGREE:
        raise InputError(f"degree {degree!r} is not possible; expected an integer from 1 to {_MAX_DEGREE}")


def choose_size(
    coordinates: Sequence[str],
    angles: Sequence[str] = (),
    degree: int | None = None,
    gyroscopic: bool = False,
) -> str:
    """Return the size that ``"auto"`` stands for: the first with at most 250 candidates, or the smallest.

    Examples
    --------
    >>> choose_size("xyz"), choose_size("abc", "abc"), choose_size("abcd", "abcd"), choose_size("uvwxy")
    ('standard', 'standard', 'chain', 'compact')
    """
    others = ("chain", "compact") if len(angles) > 1 else ("compact", "chain")
    counts: dict[str, int] = {}
    for size in ("standard", *others):
        counts[size] = len(mechanical_terms(coordinates, angles, size, degree, gyroscopic))
        if counts[size] <= _SEARCHABLE:
            return size
    return min(counts, key=counts.__getitem__)


def check_angles(angles: Iterable[object] | str, coordinates: tuple[str, ...]) -> tuple[str, ...]:
    """Return the angles in the order of the coordinates; each must be one of them."""
    given = (angles,) if isinstance(angles, str) else tuple(angles)
    wanted: set[str] = set()
    for name in given:
        if not isinstance(name, str) or normalise(name) not in coordinates:
            raise InputError(f"angle {name!r} is not a coordinate; expected names out of {list(coordinates)}")
        wanted.add(normalise(name))
    return tuple(name for name in coordinates if name in wanted)


def check_count(count: int, library: str, cure: str) -> None:
    """Refuse a generated library that is too large to search.

    Raises
    ------
    InputError
    """
    if count > MAX_TERMS:
        raise InputError(
            f"{library} would have {count} terms; expected at most {MAX_TERMS}: {cure}, or write the "
            "candidates down by hand"
        )


def velocity_product(a: str, b: str) -> str:
    """The velocities of two coordinates, multiplied."""
    return f"{a}_dot**2" if a == b else f"{a}_dot*{b}_dot"


def _kinetic(
    coordinates: Sequence[str], lengths: Sequence[str], angles: Sequence[str], size: str
) -> Iterator[tuple[str, str, str]]:
    """Pairs of coordinates whose velocities are multiplied, with the factor g."""
    if size == "chain":
        yield from chain_kinetic(coordinates, angles)
        return
    factors = list(_kinetic_factors(lengths, angles, size))
    for a, b in combinations_with_replacement(coordinates, 2):
        given = [*factors, *(_sum_factors(a, b, angles) if size != "compact" else ())]
        for factor in dict.fromkeys(given):  # "large" repeats some sums of two
            yield a, b, factor


def _sum_factors(a: str, b: str, angles: Sequence[str]) -> Iterator[str]:
    """Functions of sums of angles after the first of two coordinates."""
    after = list(runs_after(a, b, angles))
    sums = ["+".join(run) for run in after if len(run) > 1]
    for total in sums:
        yield from (f"cos({total})", f"sin({total})")
    if a == b:
        yield from (f"sin({total})**2" for total in sums)
        for short, long in combinations(after, 2):
            if short[0] == long[0]:
                yield f"cos({'+'.join(short)})*cos({'+'.join(long)})"


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
    """Return terms linear in the velocities; only the first of x ẏ and y ẋ, which differ by d(xy)/dt."""
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
    sums = ["+".join(run) for run in runs(angles) if len(run) > 1] if standard else []
    for total in sums:
        if total.count("+") > 2:
            yield from (f"cos({total})", f"sin({total})")
    for x in lengths:
        for a in angles:
            yield from (f"{x}*cos({a})", f"{x}*sin({a})")
            yield from (f"{x}**2*cos({a})", f"{x}**2*sin({a})") if large else ()
        for total in sums:
            yield from (f"{x}*cos({total})", f"{x}*sin({total})")
    for total in range(1, degree + 1):
        yield from (monomial(names) for names in combinations_with_replacement(lengths, total))
    if large:
        for x in lengths:
            yield from (f"1/{x}", f"log({x})")


def monomial(names: Sequence[str]) -> str:
    """The product of names, repeated ones as a power."""
    powers = {name: names.count(name) for name in names}
    return "*".join(name if n == 1 else f"{name}**{n}" for name, n in powers.items())
