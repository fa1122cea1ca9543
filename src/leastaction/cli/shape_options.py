"""Options of the search: its candidates (``--term``, ``--shape``, ``--size``), and which of them may stay."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import click

from leastaction.cli.values import blame, number
from leastaction.errors import InputError
from leastaction.identifiers import quoted

if TYPE_CHECKING:
    from leastaction.library import Library

__all__ = [
    "length_option",
    "lengths_of_links",
    "relevance_option",
    "relevance_share",
    "shape_option",
    "shape_ranges",
    "size_option",
    "term_option",
    "with_terms",
]

_SIZES = ("auto", "compact", "chain", "standard", "large")
_RANGE = re.compile(r"\s*\{?\s*(?P<name>\w+)\s*\}?\s*=\s*(?P<low>.+?)\s*\.\.\s*(?P<high>.+?)\s*")

length_option: Final = click.option(
    "--length",
    "lengths",
    multiple=True,
    metavar="A=METRES",
    help="Length of the link of a coordinate, from joint to joint (of a simple pendulum for a single one): "
    "then the law shows g, which is wrong where times are not in seconds. May be given several times.",
)
term_option: Final = click.option(
    "--term",
    "terms",
    multiple=True,
    metavar="EXPR",
    help="An additional candidate. Repeatable. Write unknown numbers as names in braces, e.g. 'exp(-{a}*x)' "
    "or 'sqrt((x-{p})**2+(y-{r})**2)'.",
)
shape_option: Final = click.option(
    "--shape",
    "shapes",
    multiple=True,
    metavar="NAME=LOW..HIGH",
    help="Range of an unknown number in the candidates, e.g. a=0.1..10. Without one, the data suggest where "
    "to search. Repeatable.",
)
# text, not click.FLOAT, so that the error is one line that says what to do
relevance_option: Final = click.option(
    "--relevance",
    default="0.05",
    show_default=True,
    metavar="SHARE",
    help="Share of the equation error that a term must explain in order to stay. Lower it if weak friction "
    "of a real machine is left out. 0: significance alone decides.",
)
size_option: Final = click.option(
    "--size",
    type=click.Choice(_SIZES),
    metavar="NAME",
    help="With --library auto: compact, standard, large, or chain (links in a row). Default (auto): standard "
    "up to 250 candidates; beyond that, chain for angles and compact otherwise.",
)


def with_terms(library: Library, terms: Sequence[str]) -> Library:
    """Return the library with further candidates of L."""
    if not terms:
        return library
    with blame("--term"):
        return library.replace(terms=[*library.terms, *terms])


def lengths_of_links(texts: Sequence[str]) -> dict[str, float]:
    """Return ``"A=METRES"`` as coordinate -> length."""
    parts = [text.partition("=") for text in texts]
    for text, (name, _, value) in zip(texts, parts, strict=True):
        if not (name.strip() and value.strip()):
            raise InputError(f"{quoted(text)} is incomplete; write A=METRES, e.g. theta1=0.3")
    return {name.strip(): number(value) for name, _, value in parts}


def shape_ranges(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the ranges of ``--shape`` by name.

    Raises
    ------
    InputError
        If a text is no range, or a name occurs twice.

    Examples
    --------
    >>> shape_ranges(["a=0.1..10"])
    {'a': (0.1, 10.0)}
    """
    out: dict[str, tuple[float, float]] = {}
    with blame("--shape"):
        for text in texts:
            found = _RANGE.fullmatch(text)
            if found is None:
                raise InputError(f"{quoted(text)} is no range; expected NAME=LOW..HIGH, e.g. a=0.1..10")
            if found["name"] in out:
                raise InputError(f"{found['name']} has two ranges; give one")
            out[found["name"]] = (number(found["low"]), number(found["high"]))
    return out


def relevance_share(text: str) -> float:
    """Return the value of ``--relevance``, a share from 0 on and below 1.

    Raises
    ------
    InputError
    """
    with blame("--relevance"):
        value = number(text)
        if not 0.0 <= value < 1.0:
            raise InputError(f"{quoted(text)} is not a share; give a number from 0 to below 1, e.g. 0.02")
    return value
