"""One candidate function, of the Lagrangian or of the dissipation function."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Literal, overload

import sympy

from leastaction.errors import InputError
from leastaction.library.parser import (
    canonical_number,
    format_expression,
    is_constant,
    normalise,
    parse_expression,
    shape_symbol,
)

if TYPE_CHECKING:
    from leastaction.library.library import Library

__all__ = ["Candidate", "Dropped", "Kind", "Template", "Term", "make_term", "smooth_abs"]

Kind = Literal["lagrangian", "dissipation"]

_BRACES = re.compile(r"(?P<sign>(?<![-+*/])[-+])?\{(?P<name>\w+)\}(?P<power>\*\*)?")


@dataclass(frozen=True)
class Term:
    """One candidate function of coordinates and velocities.

    Two terms are equal if expression and kind are equal. The text is ignored.

    Parameters
    ----------
    text
        Text in the grammar of the library, for example ``"theta_dot**2"``.
    expr
        The same as a SymPy expression over real symbols.
    kind
        ``"lagrangian"`` or ``"dissipation"``.
    template
        The term with shape parameters from which this one was made, and their values by name.

    Examples
    --------
    >>> term = make_term("exp(-{a}*x)", ["x", "x_dot"])
    >>> term.shapes, term.at({"a": 0.5}).text, term.at({"a": 0.5}).offered
    (('a',), 'exp(-0.5*x)', 'exp(-{a}*x)')
    """

    text: str = field(compare=False)
    expr: sympy.Expr
    kind: Kind = "lagrangian"
    template: Template | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return self.text

    @property
    def shapes(self) -> tuple[str, ...]:
        """Names of the shape parameters, with or without values."""
        expr = self.expr if self.template is None else self.template.term.expr
        return tuple(sorted(s.name[1:-1] for s in expr.free_symbols if is_constant(s)))

    @property
    def offered(self) -> str:
        """The text as it was offered: with the names of shape parameters instead of their values."""
        return self.text if self.template is None else self.template.term.text

    def renamed(self, names: Mapping[str, str]) -> Term:
        """The term with other names for coordinates and velocities."""
        swap = {sympy.Symbol(old, real=True): sympy.Symbol(new, real=True) for old, new in names.items()}
        expr = self.expr.xreplace(swap)
        return Term(format_expression(expr), expr, self.kind)

    def numbered(self, values: Mapping[str, float]) -> Template:
        """The term with the values of its shape parameters, to twelve digits; see `at`."""
        whole, had = (self, ()) if self.template is None else (self.template.term, self.template.values)
        values = {**dict(had), **values}
        return Template(whole, tuple((name, float(f"{values[name]:.12g}")) for name in self.shapes))

    def at(self, values: Mapping[str, float]) -> Term:
        """Return the term with values for its shape parameters, to twelve digits.

        Parameters
        ----------
        values
            Values by name. A term that has values keeps those that are not given.

        Raises
        ------
        KeyError
            If a value is missing.
        """
        if not self.shapes:
            return self
        template = self.numbered(values)
        whole, numbers = template.term, dict(template.values)
        # a parameter that cancels out of the expression needs no value
        text = _BRACES.sub(lambda found: _literal(found, numbers.get(found["name"], 1.0)), whole.text)
        expr = whole.expr.xreplace({shape_symbol(name): sympy.Float(x) for name, x in numbers.items()})
        return Term(text, expr, self.kind, template)


@dataclass(frozen=True)
class Template:
    """Origin of a term with values: the term with shape parameters, and (name, value) of each."""

    term: Term
    values: tuple[tuple[str, float], ...]


def _literal(found: re.Match[str], number: float) -> str:
    """A number instead of braces, merged with the sign in front of it."""
    sign, power = found["sign"] or "", found["power"] or ""
    if number >= 0:
        return f"{sign}{number!r}{power}"
    if sign and not power:
        before = found.string[: found.start()].rstrip()
        plus = "" if before.endswith("(") or not before else "+"
        return f"{plus if sign == '-' else '-'}{-number!r}"
    return f"{sign}({number!r}){power}"


Candidate = str | Term | sympy.Expr
"""Types that a user may give for a term."""


@dataclass(frozen=True)
class Dropped:
    """A candidate that was left out of a library, with the reason.

    ``reason`` is ``"null"`` (no effect on the equations of motion), ``"duplicate"`` (a multiple of one
    other term) or ``"dependent"`` (a sum of several); ``because`` explains it in words. ``combination`` holds
    the factors and terms of that sum, up to a null term. ``length`` is the description length.
    """

    term: Term
    reason: Literal["null", "duplicate", "dependent"]
    because: str
    combination: tuple[tuple[float, Term], ...] = field(default=(), compare=False, repr=False)
    length: float | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return f"{self.term.text}: {self.because}"


def make_term(
    source: Candidate,
    names: Iterable[str],
    parameters: Mapping[str, float] | None = None,
    kind: Kind = "lagrangian",
) -> Term:
    """Return a validated term from text, a SymPy expression or another term.

    Parameters
    ----------
    source
        The candidate.
    names
        Coordinates and velocities that may occur.
    parameters
        Values of further names.
    kind
        Function that the term is a candidate of.

    Raises
    ------
    InputError
        When the expression cannot be read, or a Term is of the other kind.

    Examples
    --------
    >>> make_term(" x_dot ** 2", ["x", "x_dot"])
    Term(text='x_dot**2', expr=x_dot**2, kind='lagrangian')
    """
    names = list(names)
    if isinstance(source, Term):
        if source.kind != kind:
            raise InputError(f"term {source.text!r} is a {source.kind} term; expected a {kind} term")
        used = {symbol.name for symbol in source.expr.free_symbols if not is_constant(symbol)}
        strangers = used - {normalise(n) for n in names}
        if not strangers:
            return source
        source = source.text
    source = _text_of(source)
    expr = parse_expression(source, names, parameters, shapes=True)
    # Text with a parameter could not be read back by itself (from a saved model).
    by_itself = not parameters or not _mentions(source, parameters)
    text = "".join(normalise(source).split()) if by_itself else format_expression(expr)
    return Term(text, expr, kind)


def _text_of(source: object) -> str:
    if isinstance(source, str):
        return source
    if not isinstance(source, sympy.Expr):
        raise InputError(f"expected an expression as text such as 'cos(x)', got {type(source).__name__}")
    try:
        return format_expression(source)
    except InputError as error:
        raise InputError(f"{error}; expected the functions sin cos tan exp log sqrt abs") from None


def _mentions(text: str, parameters: Mapping[str, float]) -> bool:
    words = set(re.findall(r"[^\W\d]\w*", normalise(text)))
    return not words.isdisjoint(normalise(name) for name in parameters)


@overload
def smooth_abs(source: Term, scale: Mapping[str, float]) -> Term: ...
@overload
def smooth_abs(source: Library, scale: Mapping[str, float]) -> Library: ...
def smooth_abs(source: Term | Library, scale: Mapping[str, float]) -> Term | Library:
    """Replace |u| by √(u² + ε²) wherever u contains velocities, so that friction has no kink.

    Parameters
    ----------
    source
        A term or a whole library (its terms and its dissipation).
    scale
        Velocity name → ε, in the units of that velocity. If u has several velocities, the largest ε is used.

    Returns
    -------
    Term or Library
        The same object when there is nothing to replace.

    Raises
    ------
    InputError
        When a velocity inside abs() has no positive ε.

    Examples
    --------
    >>> smooth_abs(make_term("abs(x_dot)", ["x", "x_dot"]), {"x_dot": 0.01}).text
    'sqrt(x_dot**2 + 1/10000)'
    """
    if not isinstance(source, Term):
        terms = [smooth_abs(term, scale) for term in source.terms]
        dissipation = [smooth_abs(term, scale) for term in source.dissipation]
        unchanged = (*terms, *dissipation) == (*source.terms, *source.dissipation)
        return source if unchanged else source.replace(terms=terms, dissipation=dissipation)
    changes: dict[sympy.Expr, sympy.Expr] = {}
    for part in source.expr.atoms(sympy.Abs):
        velocities = sorted(s.name for s in part.free_symbols if s.name.endswith("_dot"))
        if velocities:
            epsilon = max(_epsilon(name, scale, source) for name in velocities)
            squared = canonical_number(Fraction(repr(epsilon)) ** 2)
            changes[part] = sympy.sqrt(part.args[0] ** 2 + squared)
    if not changes:
        return source
    expr = source.expr.xreplace(changes)
    text = format_expression(expr)
    names = [symbol.name for symbol in expr.free_symbols if not is_constant(symbol)]
    return Term(text, parse_expression(text, names, shapes=True), source.kind)


def _epsilon(velocity: str, scale: Mapping[str, float], term: Term) -> float:
    epsilon = float(scale.get(velocity, 0.0))
    if not 1e-15 <= epsilon <= 1e6:
        raise InputError(
            f"smoothing {term.text!r} needs a positive scale for {velocity!r}, got {scale.get(velocity)!r}; "
            "give one in the units of that velocity, for example 1 % of its standard deviation"
        )
    return epsilon
