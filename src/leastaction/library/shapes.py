"""Shape parameters: unknown numbers inside candidates, written in braces, as in ``exp(-{a}*x)``.

With values κ, a candidate φ(q, q̇; κ) is a term like any other, and so is ∂φ/∂κ_j. The estimation needs no
more.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np
import sympy

from leastaction.errors import InputError
from leastaction.library.parser import is_constant, shape_symbol
from leastaction.library.term import Template, Term

__all__ = ["alike", "check_numbers", "check_shapes", "exchanges", "shape_names", "tangent", "term_somewhere"]

_NAME = re.compile(r"\{(\w+)\}")
_PROPORTIONAL = 1e-9
_POINTS = 12


def shape_names(terms: Sequence[Term]) -> tuple[str, ...]:
    """Names of the shape parameters of some terms, sorted."""
    return tuple(sorted({name for term in terms for name in term.shapes}))


def exchanges(terms: Sequence[Term]) -> list[dict[str, str]]:
    """Exchanges of names, each with another, after which the terms are the same: m and n of xᵐ and xⁿ.

    Parameters
    ----------
    terms : sequence of Term
        All terms that contain some of the names.

    Examples
    --------
    >>> from leastaction.library.term import make_term
    >>> exchanges([make_term(text, ["x"]) for text in ("x**{m}", "x**{n}", "exp(-{a}*x)")])
    [{'m': 'n', 'n': 'm'}]
    """
    found: list[dict[str, str]] = []
    for one, other in combinations([k for k, term in enumerate(terms) if term.shapes], 2):
        exchange = _exchange(terms, one, other)
        if exchange and exchange not in found:
            found.append(exchange)
    return found


def alike(terms: Sequence[Term]) -> list[dict[int, dict[str, str]]]:
    """Candidates that can be exchanged: of xᵐ, xⁿ and e^(−ax), the first two.

    Parameters
    ----------
    terms : sequence of Term
        As for `exchanges`.

    Returns
    -------
    list of dict
        For each class, the indices of its terms, and their names for the parameters of the first of them.

    Examples
    --------
    >>> from leastaction.library.term import make_term
    >>> alike([make_term(text, ["x"]) for text in ("x**{m}", "x**{n}", "exp(-{a}*x)")])
    [{0: {'m': 'm'}, 1: {'m': 'n'}}, {2: {}}]
    """
    out: list[dict[int, dict[str, str]]] = []
    left = [k for k, term in enumerate(terms) if term.shapes]
    while left:
        first, *left = left
        found = {
            k: {a: b for a, b in _exchange(terms, first, k).items() if a in terms[first].shapes} for k in left
        }
        others = {k: names for k, names in found.items() if names}
        own = {name: name for names in list(others.values())[:1] for name in names}
        out.append({first: own, **others})
        left = [k for k in left if k not in others]
    return out


def _exchange(terms: Sequence[Term], one: int, other: int) -> dict[str, str]:
    """The exchange of names that turns a term into another and preserves the set; empty if there is none."""
    templates = [term if term.template is None else term.template.term for term in terms]
    a, b = templates[one], templates[other]
    names, others = (list(dict.fromkeys(_NAME.findall(t.text))) for t in (a, b))
    if a.kind != b.kind or len(names) != len(others) or _NAME.sub("{}", a.text) != _NAME.sub("{}", b.text):
        return {}
    pairs = [pair for pair in zip(names, others, strict=True) if pair[0] != pair[1]]
    exchange = {**dict(pairs), **{b: a for a, b in pairs}}
    symbols = {shape_symbol(a): shape_symbol(b) for a, b in exchange.items()}
    whole = {(template.expr, template.kind) for template in templates}
    return exchange if {(expr.xreplace(symbols), kind) for expr, kind in whole} == whole else {}


def _somewhere(names: Sequence[str]) -> dict[str, float]:
    """Generic values, different for each name and reproducible."""
    seeds = {name: list(name.encode()) for name in names}
    return {name: round(np.random.default_rng(seeds[name]).uniform(0.3, 2.2), 9) for name in names}


def term_somewhere(term: Term) -> Term:
    """The term with generic values under its own text; unchanged without shape parameters.

    Examples
    --------
    >>> from leastaction.library.term import make_term
    >>> some = term_somewhere(make_term("exp(-{a}*x)", ["x"]))
    >>> some.text, some.expr.free_symbols
    ('exp(-{a}*x)', {x})
    """
    if term.template is not None:
        return term
    return replace(term.at(_somewhere(term.shapes)), text=term.text)


def tangent(terms: Sequence[Term], coefficients: Sequence[float], name: str) -> Term:
    """Σ_k λ_k ∂φ_k/∂κ over terms with values: the term whose coefficient is a step of κ.

    All terms are of one kind. The coefficients are parameters of the template, so that its compiled functions
    serve every step.

    Examples
    --------
    >>> from leastaction.library.term import make_term
    >>> decay = make_term("exp(-{a}*x)", ["x"]).at({"a": 0.5})
    >>> tangent([decay], [3.0], "a").expr
    -3.0*x*exp(-0.5*x)
    """
    parts: list[sympy.Expr] = []
    values: dict[str, float] = {}
    for k, (term, coefficient) in enumerate(zip(terms, coefficients, strict=True)):
        if term.template is None or name not in term.shapes:
            continue
        weight = f"_weight{k}"
        parts.append(shape_symbol(weight) * sympy.diff(term.template.term.expr, shape_symbol(name)))
        values |= {weight: float(coefficient), **dict(term.template.values)}
    expr = sympy.Add(*parts)
    numbers = {shape_symbol(n): sympy.Float(x) for n, x in values.items()}
    text = f"d/d{name}"  # never shown
    whole = Term(text, expr, terms[0].kind)
    return Term(text, expr.xreplace(numbers), whole.kind, Template(whole, tuple(values.items())))


def check_numbers(terms: Sequence[Term], values: Mapping[str, float]) -> None:
    """Check that all shape parameters have values.

    Raises
    ------
    InputError
    """
    lacking = set(shape_names([term for term in terms if term.template is None])) - set(values)
    if lacking:
        raise InputError(f"the shape parameter {min(lacking)!r} of the library has no value; give one")


@lru_cache(maxsize=1024)  # libraries are often made again from the same terms
def check_shapes(term: Term) -> None:
    """Refuse a shape parameter that only scales its term, as the coefficient does.

    Raises
    ------
    InputError

    Examples
    --------
    >>> from leastaction.library.term import make_term
    >>> check_shapes(make_term("cos({k}*x)", ["x"]))
    """
    if term.template is not None or not term.shapes:
        return
    numbers = {shape_symbol(n): sympy.Float(x) for n, x in _somewhere(term.shapes).items()}
    symbols = sorted((s for s in term.expr.free_symbols if not is_constant(s)), key=str)
    states = np.random.default_rng(1).uniform(0.3, 2.2, (len(symbols), _POINTS))
    for name in term.shapes:
        pair = [e.xreplace(numbers) for e in (term.expr, sympy.diff(term.expr, shape_symbol(name)))]
        functions = sympy.lambdify(symbols, pair, modules="numpy", dummify=True)
        with np.errstate(all="ignore"):
            values, slopes = (np.broadcast_to(v, _POINTS) for v in functions(*states))
        usable = np.isfinite(values) & np.isfinite(slopes) & (values != 0.0)
        ratio = slopes[usable] / values[usable]
        if usable.sum() > 1 and np.ptp(ratio) <= _PROPORTIONAL * np.abs(ratio).max():
            raise InputError(
                f"the shape parameter {{{name}}} only scales the term {term.text!r}, as its coefficient "
                f"does; leave {{{name}}} out"
            )
