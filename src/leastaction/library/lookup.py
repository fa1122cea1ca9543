"""Search for a term in a library, and display of a library."""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import sympy

from leastaction.errors import InputError
from leastaction.identifiers import counted, names_in_terms
from leastaction.library.reduction import same_functions
from leastaction.library.term import Candidate, Kind, Term, make_term
from leastaction.shown import Card, Display, Panel, Series, Shown, data_frame

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from leastaction.library.library import Library

__all__ = ["ShownLibrary", "listing_of", "place_among_all", "place_of", "place_within"]

_SHOWN = 6
_DOTS = {"linestyle": "none", "marker": "o", "markersize": 4}
_REASONS = {"null": "without effect", "duplicate": "repeated", "dependent": "equal to others in effect"}


class ShownLibrary(Shown):
    """Display of a library."""

    def to_frame(self) -> pd.DataFrame:
        """Return the candidates as a data frame of pandas.

        Returns
        -------
        pandas.DataFrame
            Columns ``expression``, ``kind`` ("lagrangian" or "dissipation") and ``length``, the description
            length in nats, NaN if there is none.

        Raises
        ------
        InputError
            If pandas is not installed (extra ``pandas``); it is an ImportError, too.

        Examples
        --------
        >>> from leastaction import Library
        >>> Library(["x_dot**2", "x"], ["x"], dissipation=["x_dot**2"]).to_frame().kind.tolist()
        ['lagrangian', 'lagrangian', 'dissipation']
        """
        terms, lengths = self._listed()
        columns: dict[str, Any] = {"expression": [t.text for t in terms], "kind": [t.kind for t in terms]}
        return data_frame({**columns, "length": [float("nan") if x is None else x for x in lengths]})

    def plot(self, ax: Axes | Sequence[Axes] | None = None, **kwargs: Any) -> Display:
        """Plot which coordinates and velocities each candidate contains.

        Candidates are numbered along x in their sequence, first those of L, then those of dissipation. A
        coordinate in few of them, or a pair that no candidate couples, is seen at once.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            By default a new figure.
        **kwargs
            Properties of Matplotlib's lines, such as ``color``.

        Returns
        -------
        Display
            With ``figure_``, ``ax_``, ``axes_`` and ``lines_``: candidates with velocities, potentials, and
            dissipation, as far as there are any.

        Raises
        ------
        InputError
            If `ax` holds several axes; also, as an ImportError too, if Matplotlib is not installed (extra
            ``plot``).

        Examples
        --------
        >>> from leastaction import Library
        >>> display = Library(["x_dot**2", "x", "x*y"], ["x", "y"], dissipation=["x_dot**2"]).plot()
        >>> [line.get_label() for line in display.lines_[0]]
        ['with velocities', 'potentials', 'dissipation']
        """
        library = cast("Library", self)
        names = [*library.coordinates, *library.velocities]
        symbols = [sympy.Symbol(name, real=True) for name in names]
        kinds: dict[str, tuple[list[int], list[int]]] = {}
        for number, term in enumerate(self._listed()[0], start=1):
            held = [row for row, symbol in enumerate(symbols) if symbol in term.expr.free_symbols]
            kind = "with velocities" if max(held, default=0) >= library.n_dof else "potentials"
            kind = "dissipation" if term.kind == "dissipation" else kind
            numbers, rows = kinds.setdefault(kind, ([], []))
            numbers += [number] * len(held)
            rows += held
        series = [Series(numbers, rows, kind, style=_DOTS) for kind, (numbers, rows) in kinds.items()]
        panel = Panel("", "", series, "candidate", rows=names)
        return Display([panel], self._title).plot(ax, **kwargs)

    def summary(self) -> str:
        """One line with the number of terms of each kind.

        Examples
        --------
        >>> from leastaction import Library
        >>> Library(["x_dot**2", "x"], ["x"]).summary()
        '2 terms in x: 1 with velocities, 1 without'
        """
        library = cast("Library", self)
        velocities = {sympy.Symbol(name, real=True) for name in library.velocities}
        moving = sum(not velocities.isdisjoint(term.expr.free_symbols) for term in library.terms)
        angles = f" (angles: {', '.join(library.angles)})" if library.angles else ""
        text = f"{len(library)} terms in {', '.join(library.coordinates)}{angles}: "
        text += f"{moving} with velocities, {len(library) - moving} without"
        if library.dissipation:
            text += f"; {len(library.dissipation)} of dissipation"
        return text + (f"; {len(library.dropped)} left out" if library.dropped else "")

    def _listed(self) -> tuple[list[Term], list[float | None]]:
        """Candidates of both kinds, and their lengths."""
        library = cast("Library", self)
        terms = [*library.terms, *library.dissipation]
        return terms, [*library.lengths, *[None] * (len(terms) - len(library.lengths))]

    @property
    def _title(self) -> str:
        library = cast("Library", self)
        return f"Library of {', '.join(library.coordinates)}: {counted(len(library), 'term')}"

    def _card(self) -> Card:
        library = cast("Library", self)
        terms, lengths = self._listed()
        rows: list[tuple[str, ...]] = [("term", "kind", "length")]
        for term, length in zip(terms, lengths, strict=True):
            rows.append((term.text, term.kind, "" if length is None else f"{length:.1f}"))
        if all(length is None for length in lengths):
            rows = [row[:2] for row in rows]
        friction = f", {len(library.dissipation)} of dissipation" if library.dissipation else ""
        found = Counter(d.reason for d in library.dropped)
        notes = [f"left out: {n} {_REASONS.get(reason, reason)}" for reason, n in found.items()]
        angles = [f"angles: {', '.join(library.angles)}"] if library.angles else []
        return Card(self._title + friction, angles, rows, notes)


def place_of(wanted: Term, terms: Sequence[Term], coordinates: Sequence[str]) -> int:
    """Return the place of a term among others; equal functions match, however they are written.

    InputError if no term is equal; the message lists near matches.
    """
    written = [term.expr for term in terms]
    if wanted.expr in written:
        return written.index(wanted.expr)
    plain = [] if wanted.shapes else [k for k, term in enumerate(terms) if not term.shapes]
    same = same_functions(wanted.expr, [written[k] for k in plain], coordinates) if plain else ()
    if same:
        return plain[same[0]]
    texts = [term.text for term in terms]
    near = difflib.get_close_matches(wanted.text, texts, n=3, cutoff=0.4) or texts[:3]
    hint = f"; near matches: {', '.join(near)}" if near else ""
    raise InputError(
        f"{wanted.text!r} is not among the {len(terms)} {wanted.kind} terms of the library{hint}"
    )


def place_within(library: Library, expression: Candidate, kind: Kind) -> int:
    """Return the place of an expression in one of the two lists of a library; a Term has its own kind."""
    names = names_in_terms(library.coordinates)
    kind = expression.kind if isinstance(expression, Term) else kind
    terms = library.terms if kind == "lagrangian" else library.dissipation
    return place_of(make_term(expression, names, kind=kind), terms, library.coordinates)


def place_among_all(library: Library, item: Candidate) -> int:
    """Return the place of a term among those of L and of the dissipation; text may mean either."""
    known_kind = item.kind if isinstance(item, Term) else None
    if known_kind != "dissipation":
        try:
            return library.index(item)
        except InputError:
            if known_kind or not library.dissipation:
                raise
    return len(library.terms) + library.index(item, "dissipation")


def listing_of(library: Library) -> str:
    """Return the first terms, coordinates, angles and dissipation in the form of a call."""
    more = len(library) > _SHOWN
    listing = ", ".join(repr(term.text) for term in library.terms[:_SHOWN]) + (", ..." if more else "")
    parts = [f"[{listing}]", f"coordinates={list(library.coordinates)}"]
    if library.angles:
        parts.append(f"angles={list(library.angles)}")
    if library.dissipation:
        parts.append(f"dissipation={[term.text for term in library.dissipation]}")
    if more:
        parts.append(f"{len(library)} terms")
    return f"Library({', '.join(parts)})"
