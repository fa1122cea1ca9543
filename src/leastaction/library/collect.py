"""Reads the candidates of a library: from a list, each once, and from a text file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.library.shapes import check_shapes
from leastaction.library.term import Candidate, Dropped, Kind, Term, make_term

__all__ = ["collect", "read_terms"]

_MAX_BYTES = 2_000_000  # of a file


def collect(
    sources: Iterable[Candidate] | Candidate,
    names: Sequence[str],
    parameters: Mapping[str, float] | None,
    kind: Kind,
) -> tuple[tuple[Term, ...], tuple[Dropped, ...]]:
    """Terms in the given order, and dropped repetitions.

    Raises
    ------
    InputError
        If a value is not a list, or a term cannot be read.

    Examples
    --------
    >>> terms, repeated = collect(["x", "2*x/2"], ["x"], None, "lagrangian")
    >>> [term.text for term in terms], [str(dropped) for dropped in repeated]
    (['x'], ['2*x/2: equals x'])
    """
    if not isinstance(sources, Iterable) or isinstance(sources, Candidate):
        raise InputError(f"expected a list of {kind} terms, got {quoted(sources)}")
    found: dict[object, Term] = {}
    repeated: list[Dropped] = []
    for source in sources:
        term = make_term(source, names, parameters, kind)
        check_shapes(term)
        if term.expr in found:
            repeated.append(Dropped(term, "duplicate", f"equals {found[term.expr].text}"))
        else:
            found[term.expr] = term
    return tuple(found.values()), tuple(repeated)


def read_terms(
    path: str | os.PathLike[str], names: Iterable[str], parameters: Mapping[str, float] | None = None
) -> list[Term]:
    """Return the terms of a file in its order, repeated ones included.

    A file holds one expression a line; ``#`` starts a comment.

    Parameters
    ----------
    path
        UTF-8 text file.
    names
        Coordinates and velocities that may occur.
    parameters
        Values of further names.

    Raises
    ------
    InputError
        With file and line, if a line cannot be read; also if the file cannot be read or has no term.
    """
    shown = os.fspath(path)
    names = list(names)
    terms: list[Term] = []
    for number, line in enumerate(_read_lines(path), start=1):
        text = line.split("#", 1)[0].strip()
        if text:
            try:
                terms.append(make_term(text, names, parameters))
            except InputError as error:
                raise InputError(f"{shown}:{number}: {error}") from None
    if not terms:
        raise InputError(f"{shown}: no expressions found; write one expression a line")
    return terms


def _read_lines(path: str | os.PathLike[str]) -> list[str]:
    shown = os.fspath(path)
    try:
        with Path(path).open("rb") as file:
            raw = file.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{shown!r}: cannot read the library ({reason}); check the path") from None
    if len(raw) > _MAX_BYTES:
        raise InputError(f"{shown}: more than {_MAX_BYTES} bytes is too large for a library of terms")
    try:
        return raw.decode("utf-8-sig").split("\n")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise InputError(f"{shown}:{line}: not UTF-8 text; save the file as UTF-8") from None
