"""Reads the candidates of a library, each once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.library.shapes import check_shapes
from leastaction.library.term import Candidate, Dropped, Kind, Term, make_term

__all__ = ["collect"]


def collect(
    sources: Iterable[Candidate] | Candidate,
    names: Sequence[str],
    parameters: Mapping[str, float] | None,
    kind: Kind,
) -> tuple[tuple[Term, ...], tuple[Dropped, ...]]:
    """Terms in the order given, and those that repeat another one.

    Raises
    ------
    InputError
        For what is no list, and for a term that cannot be read.

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
