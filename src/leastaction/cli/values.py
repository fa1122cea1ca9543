"""Reads the values of options: lists, columns, numbers, and expressions with a value."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from leastaction.errors import InputError
from leastaction.identifiers import quoted

if TYPE_CHECKING:
    from leastaction import Library

__all__ = [
    "assignments",
    "blame",
    "check_known",
    "column_map",
    "expression_list",
    "force_offsets",
    "known_coefficients",
    "method_options",
    "name_list",
    "number",
    "pairs",
]

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?")


@contextmanager
def blame(option: str) -> Iterator[None]:
    """Begin the text of an InputError with the option at fault."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{option}: {error}") from None


def number(text: str) -> float:
    """Return a finite number; only plain decimal notation counts.

    Raises
    ------
    InputError
    """
    text = text.strip()
    value = float(text) if len(text) <= 100 and _NUMBER.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise InputError(f"{quoted(text)} is not a finite number; write it as 9.81 or 1e-3")
    return value


def name_list(text: str) -> list[str]:
    """Return the parts of ``a,b``, of which none may be empty or occur twice."""
    names = [part.strip() for part in text.split(",")]
    for name in names:
        if not name:
            raise InputError(f"{quoted(text)} has an empty name; separate names by single commas, e.g. a,b")
        if names.count(name) > 1:
            raise InputError(f"{quoted(name)} is given twice")
    return names


def expression_list(text: str) -> list[str]:
    """Return the expressions of ``"EXPR, EXPR"``: no expression has a comma in it."""
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise InputError(f"{quoted(text)} has an empty expression; separate expressions by single commas")
    return parts


def column_map(text: str) -> dict[str, str] | list[str]:
    """Return ``a=column,b=other`` as a dictionary, ``a,b`` as a list whose parts may be empty."""
    parts = [part.strip() for part in text.split(",")]
    marked = ["=" in part for part in parts]
    if not any(marked):
        return parts
    if not all(marked):
        raise InputError(f"{quoted(text)} mixes 'name=column' with names alone; write all in one way")
    return dict(pairs(parts, "name=column"))


def pairs(texts: Iterable[str], form: str, *, last: bool = False) -> Iterator[tuple[str, str]]:
    """Split texts at their first ``=`` (or last one) into two sides, neither empty, no left side twice."""
    seen: set[str] = set()
    for text in texts:
        parts = text.rpartition("=") if last else text.partition("=")
        name, equals, value = (side.strip() for side in parts)
        if not name or not equals or not value:
            raise InputError(f"{quoted(text)} is not of the form {form}")
        if name in seen:
            raise InputError(f"{quoted(name)} is given twice")
        seen.add(name)
        yield name, value


def assignments(text: str) -> dict[str, float]:
    """Return the numbers of ``"theta=1, theta_dot=0"``."""
    out: dict[str, float] = {}
    for name, value in pairs((part.strip() for part in text.split(",")), "name=number, e.g. theta=1"):
        with blame(name):
            out[name] = number(value)
    return out


def known_coefficients(texts: Iterable[str]) -> dict[str, float]:
    """Return ``"EXPR=VALUE"`` as expression -> value; the last ``=`` counts."""
    return {a: number(b) for a, b in pairs(texts, "EXPR=VALUE, e.g. 'cos(theta)=9.81'", last=True)}


def check_known(known: Iterable[str], library: Library) -> None:
    """Refuse known terms that are candidates neither of L nor of friction."""
    for expression in known:
        try:
            library.index(expression)
        except InputError as error:
            try:
                library.index(expression, "dissipation")
            except InputError:
                raise error from None


def force_offsets(text: str) -> dict[str, float]:
    """Return ``"A,B=SECONDS"`` as coordinate -> seconds in which its force may change, infinite if constant.

    >>> force_offsets("x, theta=5")
    {'x': inf, 'theta': 5.0}
    """
    from leastaction.identifiers import check_coordinate_names

    parts = [part.partition("=") for part in name_list(text)]
    names = check_coordinate_names([name.strip() for name, _, _ in parts])
    seconds = [number(value) if sign else math.inf for _, sign, value in parts]
    return dict(zip(names, seconds, strict=True))


def method_options(texts: Iterable[str]) -> dict[str, object] | None:
    """Return ``NAME=VALUE`` texts as name -> number, truth value or text; None without any."""
    out: dict[str, object] = {}
    for name, value in pairs(texts, "NAME=VALUE, e.g. threshold=0.05"):
        if value.lower() in ("true", "false"):
            out[name] = value.lower() == "true"
        else:
            out[name] = number(value) if _NUMBER.fullmatch(value) else value
    return out or None
