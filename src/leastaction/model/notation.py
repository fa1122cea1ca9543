"""Numbers rounded to their errors, and LaTeX of coordinates and terms."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from typing import Any

import sympy as sp

from leastaction.findings import as_given
from leastaction.library import is_constant, shape_symbol, time_symbol
from leastaction.mechanics.equations import state_symbols
from leastaction.model.term import ModelTerm, ShapeParameter

__all__ = [
    "coefficient_text",
    "interval_text",
    "latex_number",
    "latex_sum",
    "latex_symbols",
    "plain_sum",
    "rounded",
    "shape_symbols",
    "z_text",
]

_SMALL = """alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau
upsilon phi chi psi omega"""
_CAPITAL = "Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega"
_GREEK = frozenset(f"{_SMALL} {_CAPITAL}".split())


def rounded(
    value: float, standard_error: float = math.nan, digits: int | None = None, uncertainty: bool = False
) -> str:
    """Write a number with its significant digits.

    Parameters
    ----------
    value : float
    standard_error : float
        The number ends at the second significant digit of its error; one that would then read as zero
        keeps two digits of its own. Zero or NaN: six significant digits.
    digits : int, optional
        Significant digits, whatever the error.
    uncertainty : bool
        Append the error in units of the last digits, on the scale of the error even if the number reads zero.

    Examples
    --------
    >>> rounded(0.557712, 0.0012), rounded(0.557712, 0.0012, uncertainty=True), rounded(117.7, 0.0)
    ('0.5577', '0.5577(12)', '117.7')
    >>> rounded(-1.23456e-7, 4e-10), rounded(1234.5, 20.0), rounded(2.0, 0.1, digits=3)
    ('-1.2346e-07', '1234', '2.00')
    >>> rounded(12345.0, 1900.0, uncertainty=True)
    '12300(1900)'
    >>> rounded(0.0312, 2.3e6), rounded(-0.0312, 0.4), rounded(0.0, 2.3e6)
    ('0.031', '-0.03', '0')
    """
    known_error = math.isfinite(standard_error) and standard_error > 0
    size = _exponent(value or (standard_error if known_error else 0.0))
    if digits is None and not known_error:
        return f"{value:.6g}"
    # Position of the last digit, as a power of ten; a double has no more than 15 digits.
    last = _exponent(standard_error) - 1 if digits is None else size - digits + 1
    last = max(last, size - 14)
    if digits is None and not uncertainty and abs(value) <= 0.5 * 10.0**last:
        # A row of zeros would hide the value in use.
        decimals = -last if -6 < last < 0 else 0
        return rounded(value, digits=2) if value else f"{0.0:.{decimals}f}"
    if known_error:
        # A value far below its error is written on the scale of the error.
        size = max(size, _exponent(standard_error))
    error = f"({round(standard_error / 10.0**last)})" if uncertainty and known_error else ""
    if last > 0 or size < -4:
        # A decimal number would show digits that are not significant, or a row of zeros.
        size = max(size, last)
        if last > 0 and size < 6:
            scale = 10**last
            unit = f"({round(standard_error / scale) * scale})" if error else ""
            return f"{round(value / scale) * scale}{unit}"
        mantissa = f"{value / 10.0**size:.{size - last}f}"
        return f"{mantissa}{error}e{size:+03d}"
    return f"{value:.{-last}f}{error}"


def _exponent(value: float) -> int:
    return math.floor(math.log10(abs(value))) if value and math.isfinite(value) else 0


def coefficient_text(term: ModelTerm, digits: int | None = None, uncertainty: bool = False) -> str:
    """Coefficient of a term as text."""
    return rounded(term.coefficient, term.standard_error, digits, uncertainty)


def plain_sum(
    terms: Sequence[ModelTerm],
    expressions: Sequence[sp.Expr],
    digits: int | None = None,
    uncertainty: bool = False,
    widths: Sequence[float] = (),
) -> str:
    """The sum of the terms with rounded coefficients, e.g. ``0.5*theta_dot**2 + 9.81*cos(theta)``.

    Absolute values that were smoothed in `widths` are written as abs().
    """
    pieces: list[str] = []
    for term, expr in zip(terms, expressions, strict=True):
        written = as_given(term.written, widths)
        text = f"({written})" if expr.is_Add or written.startswith("-") else written
        pieces.append(f"{coefficient_text(term, digits, uncertainty)}*{text}")
    return " + ".join(pieces).replace("+ -", "- ") or "0"


def interval_text(term: ModelTerm) -> str:
    """Ends of the 95 % interval to the second digit of the error; empty if there is none.

    Examples
    --------
    >>> interval_text(ModelTerm("x**2", 2.0, 0.1))
    '1.80 … 2.20'
    """
    error = term.standard_error
    return " … ".join(rounded(end, error) for end in (term.lower, term.upper)) if error > 0 else ""


def z_text(z: float) -> str:
    """A coefficient in standard errors; empty for NaN.

    Examples
    --------
    >>> z_text(-3.14159), z_text(271.8), z_text(float("nan"))
    ('-3.1', '272', '')
    """
    return "" if math.isnan(z) else f"{z:.1f}" if abs(z) < 100 else f"{z:.0f}"


def latex_symbols(coordinates: Sequence[str]) -> dict[sp.Symbol, str]:
    r"""LaTeX of the symbols of the time, coordinates, velocities and accelerations.

    Examples
    --------
    >>> for text in latex_symbols(["theta1", "x_cart"]).values(): print(text)
    t
    \theta_{1}
    x_{\mathrm{cart}}
    \dot{\theta}_{1}
    \dot{x}_{\mathrm{cart}}
    \ddot{\theta}_{1}
    \ddot{x}_{\mathrm{cart}}
    """
    split = [_head_and_subscript(c) for c in coordinates]
    # q1 and q_1 would look alike.
    upright = [(rf"\mathrm{{{c}}}".replace("_", r"\_"), "") for c in coordinates]
    split = [other if split.count(one) > 1 else one for one, other in zip(split, upright, strict=True)]
    out: dict[sp.Symbol, str] = {time_symbol: "t"}
    for accent, symbols in zip(("", r"\dot", r"\ddot"), state_symbols(coordinates), strict=True):
        for symbol, (head, subscript) in zip(symbols, split, strict=True):
            out[symbol] = (f"{accent}{{{head}}}" if accent else head) + subscript
    return out


def _head_and_subscript(name: str) -> tuple[str, str]:
    head, *rest = re.findall(r"\d+|[^\W\d_]+", name)
    subscript = ",".join(_word(part) for part in rest)
    return _word(head), f"_{{{subscript}}}" if subscript else ""


def _word(word: str) -> str:
    if word.isdigit():
        return word
    name = word
    if len(word) == 1 and not word.isascii():
        words = unicodedata.name(word, "").split()
        if words[:1] == ["GREEK"] and words[2:3] == ["LETTER"] and len(words) == 4:
            name = words[3].lower() if words[1] == "SMALL" else words[3].capitalize()
            # Unicode spells it LAMDA.
            name = {"lamda": "lambda", "Lamda": "Lambda"}.get(name, name)
    if name in _GREEK:
        return f"\\{name}"
    return word if len(word) == 1 else rf"\mathrm{{{word}}}"


def shape_symbols(shapes: Iterable[ShapeParameter]) -> dict[sp.Symbol, str]:
    """LaTeX of shape parameters.

    Examples
    --------
    >>> from leastaction.model.term import ShapeParameter
    >>> list(shape_symbols([ShapeParameter("a1", 0.5)]).values())
    ['a_{1}']
    """
    return {shape_symbol(shape.name): "".join(_head_and_subscript(shape.name)) for shape in shapes}


_FIRST = "!"  # SymPy sorts factors by name: before all letters


def _in_order(expr: Any) -> Any:
    """An expression with shape parameters first in products: a x, not x a."""
    if is_constant(expr) or not any(is_constant(symbol) for symbol in expr.free_symbols):
        return expr  # nothing to change
    parts = [_in_order(part) for part in expr.args]
    if expr.is_Mul:
        parts = [_early(part) for part in parts]
    return expr.func(*parts, evaluate=False)


def _early(factor: Any) -> Any:
    """A factor with another name for its symbols if it is a power of shape parameters."""
    constant = factor.free_symbols and is_constant(factor)
    return factor.xreplace(_renamed(factor.free_symbols)) if constant else factor


def _renamed(symbols: Iterable[sp.Symbol]) -> dict[sp.Symbol, sp.Symbol]:
    return {s: sp.Symbol(f"{_FIRST}{s.name}", real=True) for s in symbols}


def latex_number(number: str) -> str:
    r"""A number as text, with its power of ten in LaTeX.

    Examples
    --------
    >>> print(latex_number("1.5e-07"))
    1.5 \times 10^{-7}
    """
    return re.sub(r"e([+-])0*(\d+)$", lambda m: rf" \times 10^{{{m[1].strip('+')}{m[2]}}}", number)


def latex_sum(
    terms: Iterable[ModelTerm],
    expressions: Iterable[sp.Expr],
    symbols: dict[sp.Symbol, str],
    digits: int | None = None,
    uncertainty: bool = False,
) -> list[str]:
    """LaTeX of the addends, each with its sign; the first without a leading plus."""
    early = _renamed(symbols)
    symbols = symbols | {early[s]: written for s, written in symbols.items()}
    pieces: list[str] = []
    for term, expr in zip(terms, expressions, strict=True):
        number = coefficient_text(term, digits, uncertainty)
        sign, number = ("-", number[1:]) if number.startswith("-") else ("+", number)
        number = latex_number(number)
        factor = sp.latex(_in_order(expr), symbol_names=symbols)
        if expr.is_Add or factor.startswith("-"):
            factor = rf"\left({factor}\right)"
        body = factor if number == "1" else number if expr == 1 else rf"{number} \, {factor}"
        pieces.append(body if not pieces and sign == "+" else f"{sign} {body}")
    return pieces or ["0"]
