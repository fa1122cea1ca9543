"""Checks the characters of an expression before Python's parser: names, limits, positions.

It refuses text outside the grammar early, with the column and the cure, and keeps deep or huge input away
from the recursive parser.
"""

from __future__ import annotations

import difflib
import re
import unicodedata
from collections.abc import Collection
from dataclasses import dataclass

from leastaction.errors import InputError
from leastaction.identifiers import FUNCTION_NAMES, TIME

__all__ = ["FUNCTIONS", "MAX_DEPTH", "MAX_LENGTH", "MAX_NODES", "Source", "scan"]

FUNCTIONS = tuple(sorted(FUNCTION_NAMES))
MAX_LENGTH = 2000
MAX_DEPTH = 60
MAX_NODES = 500
_MAX_POWER_CHAIN = 4

_TOKEN = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[^\W\d]\w*)|(?P<operator>\*\*|[-+*/])|(?P<bracket>[()])|(?P<space>\s+)"
    r"|(?P<shape>\{\s*[^\W\d]\w*\s*\})"
)
_HINTS = {
    "^": "use ** for powers",
    ",": "every function takes one argument",
    "=": "write an expression, not an equation",
    "[": "use round brackets ( )",
    "{": "use round brackets ( ); braces hold the name of a shape parameter, as in exp(-{a}*x)",
    "\u2212": "use - for minus",
    "\u2013": "use - for minus",
    "\u00d7": "use * to multiply",
    "\u00b7": "use * to multiply",
    "\u22c5": "use * to multiply",
    "\u00f7": "use / to divide",
    "\u221a": "use sqrt(...)",
    "'": "write a velocity as <coordinate>_dot",
    "\u0307": "write a velocity as <coordinate>_dot",
    ".": "write plain names such as cos(x), and numbers such as 0.5",
    "|": "use abs(...)",
}
_ALIASES = {"ln": "log", "arg": "abs", "fabs": "abs", "sec": "1/cos", "csc": "1/sin", "cot": "1/tan"}


@dataclass(frozen=True)
class Source:
    """The normalised text of one expression and the positions of its numbers."""

    text: str
    numbers: dict[int, str]

    def position(self, byte_offset: int) -> int:
        """Return the character index of a position that Python's parser gives in UTF-8 bytes."""
        return len(self.text.encode()[:byte_offset].decode(errors="ignore"))

    def error(self, position: int, problem: str) -> InputError:
        """Return the error that quotes the text around a position (0-based) and states the problem."""
        return _error(self.text, position, problem)


def _error(text: str, position: int, problem: str) -> InputError:
    start = max(0, position - 40) if len(text) > 80 else 0
    shown = ("..." if start else "") + text[start : start + 80] + ("..." if len(text) > start + 80 else "")
    return InputError(f"cannot read {shown!r} at column {position + 1}: {problem}")


def scan(
    text: object, names: Collection[str], parameters: Collection[str] = (), *, shapes: bool = False
) -> Source:
    """Check the tokens of one expression and return its normalised text (Unicode NFKC).

    Parameters
    ----------
    text
        The expression.
    names, parameters
        Names that may occur besides the functions and ``pi``.
    shapes
        Whether shape parameters such as ``{a}`` may occur.

    Raises
    ------
    InputError
        At the first misplaced token.

    Examples
    --------
    >>> scan("2*x ", ["x"]).numbers
    {0: '2'}
    """
    if not isinstance(text, str):
        raise InputError(f"expected an expression as text such as 'cos(x)', got {type(text).__name__}")
    if len(text) > MAX_LENGTH:
        raise _error(text, MAX_LENGTH, f"it has {len(text)} characters; at most {MAX_LENGTH} are allowed")
    for position, character in enumerate(text):
        if unicodedata.decomposition(character).startswith(("<super>", "<sub>")):
            raise _error(text, position, f"unexpected {character!r}; use ** for powers, as in x**2")
    normal = unicodedata.normalize("NFKC", text)
    normal = " ".join(normal.split()) if len(normal) <= MAX_LENGTH else normal[:MAX_LENGTH]
    if not normal:
        raise InputError("cannot read an empty expression; expected for example 'theta_dot**2'")
    return _Scanner(normal, names, parameters, shapes).run()


class _Scanner:
    """A machine with two states: it expects an operand or an operator."""

    def __init__(self, text: str, names: Collection[str], parameters: Collection[str], shapes: bool):
        self.text = text
        self.shapes = shapes
        self.known = [*names, *parameters, "pi"]
        self.coordinates = [name for name in names if not (name.endswith("_dot") or name == TIME)]
        self.numbers: dict[int, str] = {}
        self.brackets: list[int] = []
        self.nodes = 0

    def run(self) -> Source:
        position, operand_next, unary_run, powers = 0, True, 0, [0]
        while position < len(self.text):
            match = _TOKEN.match(self.text, position)
            if match is None:
                raise self._unexpected(position)
            kind, token = match.lastgroup, match.group()
            if kind in ("number", "name", "operator", "shape"):
                self.nodes += 1
            if kind == "space":
                pass
            elif kind in ("number", "name", "shape") or token == "(":
                if not operand_next:
                    raise self._missing_operator(position, token)
                operand_next = token == "(" or self._operand(str(kind), token, position)
                unary_run = 0
                if token == "(":
                    self.brackets.append(position)
                    powers.append(0)
            elif token == ")":
                self._close(position, operand_next)
                powers.pop()
            elif operand_next:
                unary_run += 1
                if token not in "+-" or not self._operand_follows(match.end()):
                    raise _error(self.text, position, f"unexpected {token!r}; expected a name or a number")
            else:
                operand_next = True
                powers[-1] = powers[-1] + 1 if token == "**" else 0
            self._check_limits(position, unary_run, powers[-1])
            position = match.end()
        if operand_next:
            raise _error(self.text, len(self.text), "it ends too early; expected a name or a number")
        if self.brackets:
            raise _error(self.text, self.brackets[-1], "this bracket is never closed; add ')'")
        return Source(self.text, self.numbers)

    def _check_limits(self, position: int, unary_run: int, power_chain: int) -> None:
        if len(self.brackets) + unary_run > MAX_DEPTH:
            raise _error(self.text, position, f"it is nested more than {MAX_DEPTH} levels deep; split it")
        if self.nodes > MAX_NODES:
            raise _error(self.text, position, f"it has more than {MAX_NODES} numbers, names and operators")
        if power_chain > _MAX_POWER_CHAIN:
            raise _error(self.text, position, "a tower of powers is not allowed; write one number")

    def _operand_follows(self, position: int) -> bool:
        return self.text[position:].strip() != ""

    def _operand(self, kind: str, token: str, position: int) -> bool:
        """Record a number or check a name; returns True if the next token must open a bracket."""
        if kind == "number":
            if token.isdigit() and token != token.lstrip("0") and token.strip("0"):
                raise _error(self.text, position, f"write {token} without leading zeros")
            self.numbers[position] = token
            return False
        if kind == "shape":
            self._shape(token[1:-1].strip(), position)
            return False
        called = self.text[position + len(token) :].lstrip().startswith("(")
        if token in FUNCTIONS:
            if not called:
                raise _error(self.text, position, f"{token} needs an argument in brackets: {token}(...)")
            return True
        if called and token in self.known:
            raise _error(self.text, position, f"{token!r} is not a function; write * to multiply")
        if token not in self.known:
            raise _error(self.text, position, self._unknown(token, called))
        return False

    def _shape(self, name: str, position: int) -> None:
        """Check the name of a shape parameter."""
        if not self.shapes:
            problem = f"{{{name}}} is a shape parameter, which is allowed in a library only; write a number"
            raise _error(self.text, position, problem)
        if name in self.known or name in FUNCTIONS:
            raise _error(self.text, position, f"{name!r} is the name of something else; rename the parameter")

    def _unknown(self, token: str, called: bool) -> str:
        if called:
            close = _ALIASES.get(token) or _closest(token, FUNCTIONS)
            listing = "expected one of the functions " + ", ".join(FUNCTIONS)
            what = "function"
        else:
            close = _closest(token, self.known)
            names = ", ".join(self.coordinates[:8]) + (", ..." if len(self.coordinates) > 8 else "")
            listing = f"expected a coordinate ({names}), a velocity <coordinate>_dot, "
            listing += "the time t, a shape parameter in braces such as {a}, or pi"
            what = "name"
        guess = f"; did you mean {close!r}?" if close else ""
        shown = token if len(token) <= 40 else token[:40] + "..."
        return (
            f"unknown {what} {shown!r}{guess}; {listing}" if not close else f"unknown {what} {shown!r}{guess}"
        )

    def _missing_operator(self, position: int, token: str) -> InputError:
        if token in ("and", "or", "not", "if", "else", "lambda", "in", "is", "for"):
            return _error(self.text, position, f"{token!r} is not allowed; expected an operator + - * / **")
        return _error(self.text, position, "an operator is missing; write * to multiply")

    def _close(self, position: int, operand_next: bool) -> None:
        if not self.brackets:
            raise _error(self.text, position, "this bracket was never opened; remove ')'")
        if operand_next:
            raise _error(self.text, position, "unexpected ')'; expected a name or a number")
        self.brackets.pop()

    def _unexpected(self, position: int) -> InputError:
        character = self.text[position]
        hint = _HINTS.get(character, "expected numbers, names, functions and + - * / **")
        return _error(self.text, position, f"unexpected {character!r}; {hint}")


def _closest(token: str, candidates: Collection[str]) -> str:
    matches = difflib.get_close_matches(token[:80], candidates, n=1, cutoff=0.6)
    return matches[0] if matches else ""
