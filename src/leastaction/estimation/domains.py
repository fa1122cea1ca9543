"""Generated candidates that are undefined along the data, or nearly so: log x for negative x, 1/0."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np
import sympy as sp

from leastaction.library import Library, Term

__all__ = ["undefined_along"]

_PEAKED = 5.0  # crest factor of a singular candidate's force, over that of the accelerations


def undefined_along(
    library: Library, states: Mapping[str, np.ndarray], keep: Collection[Term] = ()
) -> tuple[Term, ...]:
    """Generated terms (with a description length) whose domain the motion leaves.

    A denominator must not change its sign along the motion. The argument of a root or logarithm must be
    positive. If accelerations are given, the force of a term with one of these must not peak far more
    sharply than they do: a few samples near the singularity would decide about its coefficient.

    Parameters
    ----------
    library : Library
    states : mapping of str to (n_points,) array
        Coordinates, velocities and, as ``x_dot_dot``, accelerations along a motion.
    keep : collection of Term
        Terms that the user wrote.

    Examples
    --------
    >>> motion = {"x": np.linspace(-1.0, 1.0, 5), "x_dot": np.ones(5)}
    >>> [term.text for term in undefined_along(Library.symbolic(["x"]), motion)]
    ['1/x', 'log(x)', 'sqrt(x)', '1/x**2']
    >>> motion |= {"x": np.linspace(0.01, 1.0, 500), "x_dot_dot": np.linspace(-1.0, 1.0, 500)}
    >>> [term.text for term in undefined_along(Library.symbolic(["x"]), motion)]
    ['1/x', 'log(x)', '1/x**2']
    """
    grown = [t for t, length in zip(library.terms, library.lengths, strict=True) if length is not None]
    cache: dict[sp.Expr, tuple[float, float]] = {}

    def span(inside: sp.Expr) -> tuple[float, float]:
        if inside not in cache:
            (values,) = _along(inside, [inside], states)
            cache[inside] = float(values.min()), float(values.max())
        return cache[inside]

    rates = [states[f"{name}_dot_dot"] for name in library.coordinates if f"{name}_dot_dot" in states]
    sharpest = _PEAKED * _crest(rates) if rates else np.inf

    def defined(term: Term) -> bool:
        spans = [(span(inside), positive) for inside, positive in _conditions(term.expr)]
        if not all(low > 0.0 or (high < 0.0 and not positive) for (low, high), positive in spans):
            return False
        return not (spans and rates) or _crest(_slopes(term.expr, states)) < sharpest

    return tuple(term for term in grown if term not in keep and not defined(term))


def _slopes(expr: sp.Expr, states: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Derivatives of an expression along a motion."""
    return _along(expr, [sp.diff(expr, name) for name in sorted(expr.free_symbols, key=str)], states)


def _along(expr: sp.Expr, values: Sequence[sp.Expr], states: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Values along a motion, in the symbols of an expression: (n_points,) each, or a number."""
    names = sorted(expr.free_symbols, key=str)
    function = sp.lambdify(names, values, modules="numpy", dummify=True)
    with np.errstate(all="ignore"):
        return [np.asarray(value) for value in function(*(states[str(name)] for name in names))]


@np.errstate(all="ignore")
def _crest(vectors: Sequence[np.ndarray]) -> float:
    """Largest length of some vectors over its root mean square; NaN if one is not finite."""
    squares = np.asarray(sum(np.square(part) for part in vectors))
    return float(np.sqrt(squares.max() / max(squares.mean(), np.finfo(float).tiny)))


def _conditions(expr: sp.Expr) -> Iterator[tuple[sp.Expr, bool]]:
    """Expressions that must not vanish, and whether they must be positive."""
    for part in sp.preorder_traversal(expr):
        if isinstance(part, sp.log):
            yield part.args[0], True
        elif isinstance(part, sp.Pow) and not (part.exp.is_Integer and int(part.exp) > 0):
            yield part.base, not part.exp.is_Integer
