"""Presentation MathML of coordinates, terms and coefficients, and their names as plain Unicode text.

Terms are written from their own text, so that factors stay in the sequence in which the user wrote them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from markupsafe import Markup

from leastaction.findings import Finding, as_given, smoothing_widths
from leastaction.identifiers import split_name, split_names, written_name
from leastaction.model.notation import rounded

if TYPE_CHECKING:
    from leastaction.model.term import ModelTerm

__all__ = ["Notation", "Number", "number_parts"]

_SUPERSCRIPTS = str.maketrans("−0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_APPLY = "<mo>\N{FUNCTION APPLICATION}</mo>"
_SHORT = 16  # letters of a name
_LONGER = ' class="longer"'
_MINUS = '<mo form="prefix">−</mo>'  # unary
_THIN = '<mspace width="0.16em"/>'
# Precedence of an expression: one of lower precedence gets parentheses.
_SUM, _PRODUCT, _POWER = 1, 2, 3


class Notation:
    """Symbols of the coordinates of one model.

    Parameters
    ----------
    coordinates : sequence of str
        ``theta1`` becomes θ₁; names that would look alike are not changed.
    widths : sequence of float
        Widths ε of smoothed absolute values: √(u² + ε²) is written as abs(u), as the user wrote it.
    written : mapping of str to str
        Names of coordinates in plain text, such as ``Upper arm`` for ``Upper_arm``.
    """

    def __init__(
        self,
        coordinates: Sequence[str],
        widths: Sequence[float] = (),
        written: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.coordinates: tuple[str, ...] = tuple(coordinates)
        self.widths: tuple[float, ...] = tuple(widths)
        self.written: dict[str, str] = dict(written)
        self._parts = split_names(self.coordinates)

    @classmethod
    def of_fit(
        cls,
        coordinates: Sequence[str],
        findings: Iterable[Finding],
        written: Mapping[str, str] = MappingProxyType({}),
    ) -> Notation:
        """With the widths that a fit has smoothed its candidates by."""
        return cls(coordinates, smoothing_widths(findings), written)

    def text(self, coordinate: str, derivative: int = 0) -> str:
        """Name of a coordinate, or of its derivative, as plain text for figures.

        Dots above letters are not used, because many fonts draw them into the letter.

        Examples
        --------
        >>> notation = Notation(["theta1", "x_cart"])
        >>> notation.text("theta1"), notation.text("theta1", 1), notation.text("x_cart", 2)
        ('θ₁', 'dθ₁/dt', 'd²x_cart/dt²')
        """
        name = self.written.get(coordinate) or written_name(*self._parts[coordinate])
        return (name, f"d{name}/dt", f"d²{name}/dt²")[derivative]

    def symbol(self, coordinate: str, derivative: int = 0) -> Markup:
        """Name of a coordinate, or of its derivative with dots, as one ``<math>`` element."""
        return _math(self._symbol(coordinate, derivative))

    def heading(self, coordinate: str) -> Markup:
        """Name of a coordinate as mathematics, or as text that can be wrapped if it is long."""
        text = self.text(coordinate)
        if len(text) <= _SHORT:
            return self.symbol(coordinate)
        return Markup(f'<span class="wrap">{escape(text)}</span>')

    def term(self, text: str) -> Markup:
        """One term, for example ``theta1_dot**2``, as one ``<math>`` element."""
        return _math(self._expression(text, 0))

    def is_long(self, text: str) -> bool:
        """Whether a term needs a line of its own."""
        return _LONGER in self.term(text)

    def addend(self, text: str, coefficient: float, standard_error: float, note: str, first: bool) -> Markup:
        """Sign, coefficient with its error (or `note`) below, and the term, as one ``<math>`` element."""
        sign = "−" if coefficient < 0 else "" if first else "+"
        number = number_parts(abs(coefficient), standard_error)
        body, power = f"<mn>{escape(number.value)}</mn>", ""
        if number.power:
            power = f"<mo>×</mo><msup><mn>10</mn><mn>{number.power}</mn></msup>"
        if number.apart:
            body, power = f"<mrow>{body}{power}</mrow>", ""
        below = f"± {number.error}" if number.error else note
        if below:
            body = f'<munder><mrow>{body}</mrow><mtext class="error">{escape(below)}</mtext></munder>'
        lead = f'<mo form="infix">{sign}</mo>' if sign and not first else f"<mo>{sign}</mo>" if sign else ""
        between = "<mo>·</mo>" if re.match(r"[\d.]+(?!\d*/)", text) else _THIN
        return _math(f"{lead}{body}{power}{between}{self._expression(text, _PRODUCT)}")

    def addends(self, terms: Sequence[ModelTerm]) -> list[Markup]:
        """The addends of a law, each coefficient with its error below or marked as known."""
        return [
            self.addend(t.written, t.coefficient, t.standard_error, "known" if t.known else "", k == 0)
            for k, t in enumerate(terms)
        ]

    def _symbol(self, coordinate: str, derivative: int, power: str = "") -> str:
        head, subscript = self._parts[coordinate]
        # The style sheet makes single letters italic, because without a mathematical font MathML takes them
        # from another font. A full stop above a strut is the only dot that every browser draws above the
        # letter. An exponent is set beside the letter, not above the dot.
        tag = 'mi class="q" mathvariant="normal"' if len(head) == 1 else "mi"
        base = f"<{tag}>{escape(head)}</mi>"
        if derivative:
            dots = f'<mrow class="dot"><mspace depth="0.05em"/><mo>{"." * derivative}</mo></mrow>'
            base = f"<mover>{base}{dots}</mover>"
            base = f'<mpadded height="0.9em">{base}</mpadded>' if power else base
        if subscript:
            tag = "mn" if subscript.isdecimal() else "mtext"
            low = f"<{tag}>{escape(subscript)}</{tag}>"
            return f"<msubsup>{base}{low}{power}</msubsup>" if power else f"<msub>{base}{low}</msub>"
        return f"<msup>{base}{power}</msup>" if power else base

    def _expression(self, text: str, level: int) -> str:
        text = as_given(text, self.widths)
        try:
            return self._at(level, ast.parse(text, mode="eval").body)
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            return f"<mtext>{escape(text)}</mtext>"  # fallback: plain text

    def _at(self, level: int, node: ast.expr) -> str:
        """MathML of a node, in parentheses if it binds less tightly than `level`."""
        body, own = self._node(node)
        return _parentheses(body) if own < level else body

    def _node(self, node: ast.expr) -> tuple[str, int]:
        if isinstance(node, ast.Constant):
            return _number(
                f"{node.value:.12g}" if isinstance(node.value, float) else str(node.value)
            ), _POWER + 1
        if isinstance(node, ast.Name):
            return self._name(node.id), _POWER + 1
        if isinstance(node, ast.Set):
            return _shape(node), _POWER + 1
        if isinstance(node, ast.UnaryOp):
            sign = _MINUS if isinstance(node.op, ast.USub) else ""
            return f"{sign}{self._at(_PRODUCT, node.operand)}", _SUM
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args:
            return self._call(node.func.id, node.args[0]), _POWER
        if isinstance(node, ast.BinOp):
            return self._binary(node)
        raise ValueError("not in the grammar")

    def _name(self, name: str, power: str = "") -> str:
        for derivative, ending in enumerate(("", "_dot", "_dot_dot")):
            coordinate = name.removesuffix(ending)
            if coordinate in self._parts and name.endswith(ending):
                return self._symbol(coordinate, derivative, power)
        base = f"<mi>{escape('π' if name == 'pi' else name)}</mi>"
        return f"<msup>{base}{power}</msup>" if power else base

    def _call(self, name: str, argument: ast.expr, power: str = "") -> str:
        inner = self._at(0, argument)
        if name in ("sqrt", "abs"):
            body = f"<msqrt>{inner}</msqrt>" if name == "sqrt" else _fenced("|", inner, "|")
            return f"<msup>{body}{power}</msup>" if power else body
        function = f"<mi>{escape(name)}</mi>"
        function = f"<msup>{function}{power}</msup>" if power else function
        return f"<mrow>{function}{_APPLY}{_parentheses(inner)}</mrow>"

    def _binary(self, node: ast.BinOp) -> tuple[str, int]:
        left, right = node.left, node.right
        if isinstance(node.op, (ast.Add, ast.Sub)):
            sign = "+" if isinstance(node.op, ast.Add) else "−"
            return f"{self._at(_SUM, left)}<mo>{sign}</mo>{self._at(_PRODUCT, right)}", _SUM
        unsigned = _unsigned(node)
        if unsigned is not None:
            return f"{_MINUS}{self._at(_PRODUCT, unsigned)}", _SUM
        if isinstance(node.op, ast.Div):
            return (
                f"<mfrac><mrow>{self._at(0, left)}</mrow><mrow>{self._at(0, right)}</mrow></mfrac>",
                _PRODUCT,
            )
        if isinstance(node.op, ast.Mult):
            between = "<mo>·</mo>" if _starts_with_number(right) else _THIN
            return f"{self._at(_PRODUCT, left)}{between}{self._at(_PRODUCT, right)}", _PRODUCT
        if isinstance(node.op, ast.Pow):
            return self._power(left, f"<mrow>{self._at(0, right)}</mrow>"), _POWER
        raise ValueError("not in the grammar")

    def _power(self, base: ast.expr, power: str) -> str:
        if isinstance(base, ast.Name):
            return self._name(base.id, power)
        if isinstance(base, ast.Call) and isinstance(base.func, ast.Name) and base.args:
            return self._call(base.func.id, base.args[0], power)
        return f"<msup><mrow>{self._at(_POWER + 1, base)}</mrow>{power}</msup>"


def _shape(node: ast.Set) -> str:
    """A shape parameter, which stands in braces: {a1}."""
    head, subscript = split_name("".join(e.id for e in node.elts if isinstance(e, ast.Name)))
    base = f"<mi>{escape(head)}</mi>"
    return f"<msub>{base}<mtext>{escape(subscript)}</mtext></msub>" if subscript else base


class Number(NamedTuple):
    """A number and its error as text; empty if there is none.

    `power` is the power of ten of the number, and of the error too unless that is `apart`: an error far above
    the number is written out by itself.
    """

    value: str
    error: str
    power: str
    apart: bool = False

    @property
    def text(self) -> str:
        """The number for a table."""
        return self.value + _times_ten(self.power)

    @property
    def error_text(self) -> str:
        """The error for a table."""
        return self.error + ("" if self.apart or not self.error else _times_ten(self.power))


def number_parts(value: float, standard_error: float) -> Number:
    """Round a number to its error.

    Examples
    --------
    >>> number_parts(0.557712, 0.0012)[:3], number_parts(-1.23456e-7, 4e-10)[:3], number_parts(2.0, 0.0)[:3]
    (('0.5577', '0.0012', ''), ('−1.2346', '0.0040', '−7'), ('2', '', ''))
    >>> number_parts(0.0312, 2.3e6).text, number_parts(0.0312, 2.3e6).error_text
    ('0.031', '2.3 × 10⁶')
    """
    text = rounded(value, standard_error, uncertainty=True)
    match = re.fullmatch(r"(-?)(\d+)(?:\.(\d+))?(?:\((\d+)\))?(?:e([+-]?\d+))?", text)
    if match is None:
        return Number(text, "", "")
    minus, whole, decimals, error, power = match.groups(default="")
    if error and not float(f"{whole}.{decimals}"):
        mantissa, _, power = rounded(value, standard_error).partition("e")
        size, _, error_power = rounded(standard_error, standard_error).partition("e")
        error = size + _times_ten(_exponent(error_power))
        return Number(mantissa.replace("-", "−"), error, _exponent(power), apart=True)
    value_text = f"{'−' if minus else ''}{whole}{f'.{decimals}' if decimals else ''}"
    error_text = f"{int(error) * 10.0 ** -len(decimals):.{len(decimals)}f}" if error else ""
    return Number(value_text, error_text, _exponent(power))


def _exponent(text: str) -> str:
    return str(int(text)).replace("-", "−") if text else ""


def _times_ten(power: str) -> str:
    return f" × 10{power.translate(_SUPERSCRIPTS)}" if power else ""


def _math(body: str) -> Markup:
    # Mathematics cannot be wrapped, so long expressions are set smaller.
    length = len(re.sub(r"<[^>]*>|&#?\w+;", "", body))
    size = _LONGER if length > 44 else ' class="long"' if length > 28 else ""
    return Markup(f"<math{size}><mrow>{body}</mrow></math>")


def _number(text: str) -> str:
    mantissa, _, exponent = text.partition("e")
    number = f"<mn>{escape(mantissa)}</mn>"
    if not exponent:
        return number
    power = str(int(exponent)).replace("-", "−")
    return f"<mrow>{number}<mo>×</mo><msup><mn>10</mn><mn>{power}</mn></msup></mrow>"


def _parentheses(body: str) -> str:
    return _fenced("(", body, ")")


def _fenced(left: str, body: str, right: str) -> str:
    return f'<mrow><mo form="prefix">{left}</mo>{body}<mo form="postfix">{right}</mo></mrow>'


def _unsigned(node: ast.expr) -> ast.expr | None:
    """A product without its leading minus, which Python parses with the first factor; None without one."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return node.operand
    if isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Mult, ast.Div)):
        left = _unsigned(node.left)
        return None if left is None else ast.BinOp(left, node.op, node.right)
    return None


def _starts_with_number(node: ast.expr) -> bool:
    while isinstance(node, ast.BinOp):
        node = node.left
    return isinstance(node, ast.Constant)
