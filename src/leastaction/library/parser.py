"""Reads and writes expressions, by a whitelist of Python's syntax tree; text is never evaluated.

The grammar is ``+ - * / **``, parentheses, ``sin cos tan exp log sqrt abs`` of one argument, numbers,
``pi`` and the names that the caller allows.  Everything stands for a real number.
"""

from __future__ import annotations

import ast
import math
import unicodedata
from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import Final

import sympy

from leastaction.errors import InputError
from leastaction.identifiers import TIME
from leastaction.library.scanner import MAX_DEPTH, Source, scan

__all__ = [
    "MAX_EXPONENT",
    "canonical_number",
    "format_expression",
    "is_constant",
    "normalise",
    "parse_expression",
    "shape_symbol",
    "time_symbol",
]

MAX_EXPONENT = 32
MAX_NUMBER = 10**12
MIN_NUMBER = Fraction(1, 10**30)
_MAX_EXP_ARGUMENT = 70  # |log| of the smallest and largest number that are allowed
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_PARTS = (sympy.Add, sympy.Mul, sympy.Pow, sympy.Symbol, sympy.Number, type(sympy.pi), type(sympy.E))
_ALLOWED_HEADS = (*_PARTS, sympy.Abs, sympy.log, sympy.sin, sympy.cos, sympy.tan, sympy.exp)


def parse_expression(
    text: str, names: Iterable[str], parameters: Mapping[str, float] | None = None, *, shapes: bool = False
) -> sympy.Expr:
    """Parse text into a SymPy expression over real symbols; the text is never evaluated.

    Parameters
    ----------
    text
        Expression in Python's notation, for example ``"theta_dot**2*sin(theta)"``: at most 2000
        characters, 500 nodes and 60 levels of nesting.
    names
        Names that may occur: the coordinates, their velocities ``<coordinate>_dot`` and the time ``t``.
    parameters
        Values of further names.
    shapes
        Whether shape parameters, named in braces, are allowed: ``"exp(-{a}*x)"``. They become symbols whose
        names keep the braces.

    Returns
    -------
    sympy.Expr
        Symbols are ``sympy.Symbol(name, real=True)``; short decimal numbers become exact fractions.

    Raises
    ------
    InputError
        With the text, the position, what was expected and a close match for a misspelt name.

    Examples
    --------
    >>> parse_expression("m*x_dot**2/2 + 0.5*cos(x)", ["x", "x_dot"], {"m": 3})
    3*x_dot**2/2 + cos(x)/2
    >>> parse_expression("cos(y)", ["x", "x_dot"])
    Traceback (most recent call last):
    leastaction.errors.InputError: cannot read 'cos(y)' at column 5: unknown name 'y'; expected ...
    """
    symbols = {normalise(name): sympy.Symbol(normalise(name), real=True) for name in names}
    values = {normalise(name): _parameter(name, value) for name, value in (parameters or {}).items()}
    source = scan(text, symbols, values, shapes=shapes)
    try:
        tree = ast.parse(source.text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = getattr(error, "msg", None) or "it is nested too deeply"
        raise source.error(0, f"it is not a valid expression ({reason})") from None
    return _Converter(source, {**symbols, **values}).expression(tree)


def format_expression(expr: sympy.Expr) -> str:
    """Write an expression in the grammar of `parse_expression`, which reads it back as an equal one.

    Parameters
    ----------
    expr
        Expression over real symbols.

    Returns
    -------
    str
        For example ``"x_dot**2*abs(sin(x))/2"``.

    Raises
    ------
    InputError
        When the expression has functions or numbers that the grammar cannot write.

    Examples
    --------
    >>> x = sympy.Symbol("x", real=True)
    >>> format_expression(abs(x) / 2 + sympy.exp(1))
    'abs(x)/2 + exp(1)'
    """
    expr = _with_canonical_numbers(sympy.sympify(expr))
    problem = _unsupported(expr)
    if problem:
        raise InputError(f"cannot write the expression {str(expr)[:80]!r}: {problem}")
    return _Printer().doprint(expr)


def shape_symbol(name: str) -> sympy.Symbol:
    """Return the symbol of a shape parameter; the braces keep it apart from coordinates of that name.

    Examples
    --------
    >>> shape_symbol("a").name
    '{a}'
    """
    return sympy.Symbol(f"{{{name}}}", real=True)


time_symbol: Final = sympy.Symbol(TIME, real=True)
"""The time in expressions, in seconds, as the time column of the data has it."""


def is_constant(expr: sympy.Expr) -> bool:
    """Tell whether an expression holds only numbers and shape parameters: no coordinate, velocity or time.

    Examples
    --------
    >>> is_constant(shape_symbol("n") - 1), is_constant(sympy.Symbol("x", real=True))
    (True, False)
    """
    return all(symbol.name.startswith("{") for symbol in expr.free_symbols)  # type: ignore[attr-defined]


def normalise(text: str) -> str:
    """Return the text with compatibility characters replaced (Unicode NFKC), as Python does for names."""
    return unicodedata.normalize("NFKC", text)


def canonical_number(value: Fraction) -> sympy.Number:
    """Return an exact Rational where numerator and denominator are short, and a 53-bit Float elsewhere.

    Examples
    --------
    >>> canonical_number(Fraction("0.5")), canonical_number(Fraction("0.12345678901234567"))
    (1/2, 0.123456789012346)
    """
    short = max(abs(value.numerator), value.denominator) <= MAX_NUMBER
    return sympy.Rational(value.numerator, value.denominator) if short else sympy.Float(float(value))


def _parameter(name: str, value: float) -> sympy.Number:
    """Return a user parameter as a number; refuses values that are not finite, real and of sensible size."""
    try:
        exact = Fraction(repr(value)) if isinstance(value, float) else Fraction(value)
        sizes_ok = exact == 0 or MIN_NUMBER <= abs(exact) <= MAX_NUMBER
    except (TypeError, ValueError, OverflowError):
        try:
            exact = Fraction(repr(float(value)))  # NumPy and SymPy scalars
            sizes_ok = exact == 0 or MIN_NUMBER <= abs(exact) <= MAX_NUMBER
        except (TypeError, ValueError, OverflowError):
            exact, sizes_ok = Fraction(0), False
    if not sizes_ok:
        raise InputError(
            f"parameter {name!r} is {value!r}; expected a finite number, 0 or with 1e-30 <= |value| <= 1e12"
        )
    return canonical_number(exact)


class _Converter:
    """Walks the syntax tree; each numeric intermediate result is checked before it can grow."""

    def __init__(self, source: Source, meaning: Mapping[str, sympy.Expr]):
        self.source = source
        self.meaning = meaning

    def expression(self, tree: ast.expr) -> sympy.Expr:
        expr = _with_canonical_numbers(self._convert(tree, 0))
        problem = _unsupported(expr)
        if problem:
            raise self.source.error(0, problem)
        return expr

    def _error(self, node: ast.expr, problem: str) -> InputError:
        return self.source.error(self.source.position(node.col_offset), problem)

    def _convert(self, node: ast.expr, depth: int) -> sympy.Expr:
        if depth > MAX_DEPTH:
            raise self._error(node, f"it is nested more than {MAX_DEPTH} levels deep; split it")
        if isinstance(node, ast.Constant):
            return self._constant(node)
        if isinstance(node, ast.Name):
            return self.meaning.get(node.id, sympy.pi)  # the scanner has refused every other name
        if isinstance(node, ast.Set) and len(node.elts) == 1 and isinstance(node.elts[0], ast.Name):
            return shape_symbol(node.elts[0].id)  # the scanner has checked that it is allowed
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.UAdd, ast.USub)):
            value = self._convert(node.operand, depth + 1)
            return -value if isinstance(node.op, ast.USub) else value
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) == 1:
            return self._call(node, node.func.id, depth)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            return self._power(node, depth)
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            return self._chain(node, depth)
        raise self._error(node, "expected numbers, names, functions and the operators + - * / **")

    def _constant(self, node: ast.Constant) -> sympy.Expr:
        try:
            value = Fraction(self.source.numbers[self.source.position(node.col_offset)])
        except (KeyError, ValueError):
            raise self._error(node, "expected a decimal number") from None
        if value and not MIN_NUMBER <= abs(value) <= MAX_NUMBER:
            raise self._error(node, "the number is out of range; expected 0 or 1e-30 <= |number| <= 1e12")
        return canonical_number(value)

    def _chain(self, node: ast.BinOp, depth: int) -> sympy.Expr:
        """Convert a sum or a product with all its operands at once, without recursion for long sums."""
        additive = isinstance(node.op, (ast.Add, ast.Sub))
        family = (ast.Add, ast.Sub) if additive else (ast.Mult, ast.Div)
        operands: list[sympy.Expr] = []
        start: ast.expr = node
        while isinstance(start, ast.BinOp) and isinstance(start.op, family):
            value = self._convert(start.right, depth + 1)
            if isinstance(start.op, ast.Sub):
                value = -value
            elif isinstance(start.op, ast.Div):
                if value.is_zero:
                    raise self._error(start.right, "division by zero")
                value = 1 / value
            operands.append(value)
            start = start.left
        if not additive:
            # -a/b is parsed as (-a)/b; a separate sign is not multiplied into a sum a.
            while isinstance(start, ast.UnaryOp) and isinstance(start.op, (ast.UAdd, ast.USub)):
                operands.append(sympy.Integer(-1 if isinstance(start.op, ast.USub) else 1))
                start = start.operand
        operands.append(self._convert(start, depth + 1))
        operands.reverse()
        return self._checked(node, sympy.Add(*operands) if additive else sympy.Mul(*operands))

    def _power(self, node: ast.BinOp, depth: int) -> sympy.Expr:
        base = self._convert(node.left, depth + 1)
        exponent = self._convert(node.right, depth + 1)
        if not is_constant(exponent):
            raise self._error(node.right, "the exponent must be a number; write exp(...) for other powers")
        if _is_too_high(exponent):
            raise self._error(node.right, f"the exponent is out of range; expected |n| <= {MAX_EXPONENT}")
        if base.is_zero and exponent.is_negative:
            raise self._error(node, "division by zero (zero to a negative power)")
        return self._checked(node, base**exponent)

    def _call(self, node: ast.Call, name: str, depth: int) -> sympy.Expr:
        argument = self._convert(node.args[0], depth + 1)
        if name == "exp" and _explodes(argument):
            raise self._error(node.args[0], "the argument of exp is out of range; expected |number| < 70")
        if name == "abs":
            return self._checked(node, _absolute(argument))
        result = getattr(sympy, name)(argument)
        # SymPy rewrites tan(x + pi/2) as -cot(x), which is not in the grammar.
        cotangents = {c: 1 / sympy.tan(c.args[0]) for c in result.atoms(sympy.cot)}
        return self._checked(node, result.xreplace(cotangents) if cotangents else result)

    def _checked(self, node: ast.expr, expr: sympy.Expr) -> sympy.Expr:
        if not expr.free_symbols:
            value = _value(expr)
            if not math.isfinite(value):
                raise self._error(node, "this is not a finite real number")
            # tiny numbers are written as 1/n with huge n; only rational numbers become literals
            if abs(value) > (MAX_NUMBER if expr.is_Rational else 1 / MIN_NUMBER):
                raise self._error(node, "this number is out of range; expected |number| <= 1e12")
        elif expr.is_Mul and abs(_value(expr.as_coeff_Mul()[0])) > MAX_NUMBER:
            raise self._error(node, "a number in this product is out of range; expected |number| <= 1e12")
        elif isinstance(expr, sympy.Pow) and _is_too_high(expr.exp):
            raise self._error(node, f"this power is out of range; expected |exponent| <= {MAX_EXPONENT}")
        return expr


def _value(number: sympy.Expr) -> float:
    """Return a constant expression as a float; NaN if it is not a real number."""
    try:
        if isinstance(number, sympy.Rational):
            return math.inf if number.q == 0 else number.p / number.q
        value = sympy.N(number, 15)
        return float(value) if value.is_Float or value.is_Rational else math.nan
    except OverflowError:
        return math.inf
    except (TypeError, ValueError):
        return math.nan


def _is_too_high(exponent: sympy.Expr) -> bool:
    """Tell whether a numeric exponent is out of range; shape parameters have no value yet."""
    return not exponent.free_symbols and abs(_value(exponent)) > MAX_EXPONENT


def _explodes(argument: sympy.Expr) -> bool:
    """Tell whether exp(argument) could make SymPy compute an astronomical power such as 2**(10**12)."""
    for addend in sympy.Add.make_args(argument):
        constant, rest = addend.as_independent(*addend.free_symbols, as_Add=False)
        limit = MAX_EXPONENT if rest.has(sympy.log) else MAX_NUMBER
        if not addend.free_symbols:
            constant, limit = addend, _MAX_EXP_ARGUMENT
        if not abs(_value(constant)) <= limit:
            return True
    return False


def _absolute(argument: sympy.Expr) -> sympy.Expr:
    """Return |argument|; exponentials are positive, for which SymPy may introduce re()."""
    factors = sympy.Mul.make_args(argument)
    positive = [f for f in factors if isinstance(f, sympy.exp | sympy.Abs)]
    return sympy.Mul(*positive, sympy.Abs(sympy.Mul(*(f for f in factors if f not in positive))))


def _with_canonical_numbers(expr: sympy.Expr) -> sympy.Expr:
    """Replace long fractions by floats and short floats by fractions, so that equal text is equal."""
    for _ in range(4):
        changes: dict[sympy.Expr, sympy.Expr] = {}
        for number in expr.atoms(sympy.Float, sympy.Rational):
            if isinstance(number, sympy.Float):
                new = canonical_number(Fraction(repr(float(number))))
            else:
                new = canonical_number(Fraction(int(number.p), int(number.q)))
            if new != number or new.is_Float != number.is_Float:
                changes[number] = new
        if not changes:
            break
        expr = expr.xreplace(changes)
    return expr


def _unsupported(expr: sympy.Expr) -> str:
    """Describe the part of an expression that is not in the grammar; empty if there is none."""
    for part in sympy.preorder_traversal(expr):
        if part in (sympy.nan, sympy.zoo, sympy.oo, -sympy.oo, sympy.I):
            return "it is not a finite real number"
        if not isinstance(part, _ALLOWED_HEADS):
            return f"it contains {type(part).__name__}, which is not in the grammar"
        if part.is_Number and part != 0 and not MIN_NUMBER <= abs(Fraction(str(part))) <= MAX_NUMBER:
            return "a number in it is out of range; expected 1e-30 <= |number| <= 1e12"
        exponent = part.args[1] if isinstance(part, sympy.Pow) else None  # type: ignore
        if exponent is None or (exponent.free_symbols and is_constant(exponent)):
            continue
        if exponent.free_symbols or not abs(_value(exponent)) <= MAX_EXPONENT:
            return f"a power in it is out of range; expected a number with |exponent| <= {MAX_EXPONENT}"
    return ""


class _Printer(sympy.StrPrinter):
    """SymPy's text, adapted to this grammar."""

    def _print_Abs(self, expr: sympy.Expr) -> str:
        return f"abs({self._print(expr.args[0])})"

    def _print_Exp1(self, expr: sympy.Expr) -> str:
        return "exp(1)"

    def _print_Float(self, expr: sympy.Float) -> str:
        return repr(float(expr))
