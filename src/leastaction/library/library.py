"""The library: an ordered set of candidate terms over named coordinates."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, overload

from leastaction.errors import InputError
from leastaction.identifiers import FUNCTION_NAMES, check_coordinate_names, names_in_terms
from leastaction.library.collect import collect, read_terms
from leastaction.library.families import check_angles, check_count, mechanical_terms
from leastaction.library.friction import with_families
from leastaction.library.geometry import FromGeometry
from leastaction.library.grammar import description_lengths, grown_terms
from leastaction.library.lookup import ShownLibrary, listing_of, place_among_all, place_within
from leastaction.library.parser import normalise
from leastaction.library.reduction import find_redundant
from leastaction.library.shapes import check_numbers, shape_names, term_somewhere
from leastaction.library.term import Candidate, Dropped, Kind, Term

__all__ = ["Library"]


class Library(FromGeometry, ShownLibrary, Sequence[Term]):
    """Candidate terms of the Lagrangian, L = Σ_k λ_k φ_k, and of the dissipation function.

    Immutable: every method returns a new library.

    Parameters
    ----------
    terms
        Candidates φ_k as text, SymPy expressions or terms. Text may use ``+ - * / **``, brackets,
        sin cos tan exp log sqrt abs, numbers, pi, the coordinates, their velocities
        ``<coordinate>_dot``, the time ``t`` in seconds and the parameters.
    coordinates
        Names of the generalised coordinates.
    angles
        The coordinates that are angles, in radians.
    parameters
        Numbers that the texts may use by name. They are inserted immediately.
    dissipation
        Candidates ψ_k of the dissipation function; the force is −∂ψ/∂q̇ₙ. Families by name, also among
        others: ``"auto"`` (viscous and dry), ``"viscous"``, ``"dry"``, ``"stribeck"``, ``"quadratic"``,
        ``"load"``, ``"asymmetric"``.

    Attributes
    ----------
    terms, dissipation : tuple of Term
        The candidates, in the order given. Repeated expressions are left out.
    coordinates, velocities, angles : tuple of str
    dropped : tuple of Dropped
        Candidates that were left out, and why.

    Raises
    ------
    InputError
        When a term cannot be read, or a name is unknown or not allowed.

    Examples
    --------
    >>> library = Library(["theta_dot**2", "cos(theta)"], ["theta"], angles=["theta"])
    >>> len(library), library[1].text, library.index("cos(-theta)")
    (2, 'cos(theta)', 1)
    """

    def __init__(
        self,
        terms: Iterable[Candidate],
        coordinates: Iterable[str] | str,
        *,
        angles: Iterable[str] | str = (),
        parameters: Mapping[str, float] | None = None,
        dissipation: Iterable[Candidate] = (),
    ) -> None:
        self._coordinates = check_coordinate_names(coordinates)
        self._angles = check_angles(angles, self._coordinates)
        names = names_in_terms(self._coordinates)
        clash = {normalise(str(name)) for name in parameters or ()} & {*names, *FUNCTION_NAMES, "pi"}
        if clash:
            raise InputError(f"parameter {min(clash)!r} has the name of something else; rename it")
        self._terms, repeated = collect(terms, names, parameters, "lagrangian")
        friction = with_families(dissipation, self._coordinates, self._angles)
        self._dissipation, again = collect(friction, names, parameters, "dissipation")
        self._dropped: tuple[Dropped, ...] = (*repeated, *again)
        self._lengths: Mapping[Term, float] = {}
        if not self._terms:
            raise InputError("the library has no terms; give expressions such as 'theta_dot**2'")

    @classmethod
    def from_file(
        cls,
        path: str | os.PathLike[str],
        coordinates: Iterable[str] | str,
        *,
        angles: Iterable[str] | str = (),
        parameters: Mapping[str, float] | None = None,
        dissipation: Iterable[Candidate] = (),
    ) -> Library:
        r"""Read a library from a text file: one expression a line, ``#`` starts a comment.

        Parameters
        ----------
        path
            UTF-8 text file.
        coordinates, angles, parameters, dissipation
            As for `Library`.

        Raises
        ------
        InputError
            With file and line, when a line cannot be read; also when the file cannot.

        Examples
        --------
        >>> import tempfile, pathlib
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "library.txt")
        ...     _ = path.write_text("theta_dot**2  # kinetic\n\ncos(theta)\n", encoding="utf-8")
        ...     Library.from_file(path, ["theta"])
        Library(['theta_dot**2', 'cos(theta)'], coordinates=['theta'])
        """
        checked = check_coordinate_names(coordinates)
        terms = read_terms(path, names_in_terms(checked), parameters)
        return cls(terms, checked, angles=angles, parameters=parameters, dissipation=dissipation)

    @classmethod
    def mechanical(
        cls,
        coordinates: Iterable[str] | str,
        angles: Iterable[str] | str = (),
        *,
        size: str | None = "auto",
        degree: int | None = None,
        gyroscopic: bool = False,
        dissipation: Iterable[Candidate] = (),
    ) -> Library:
        """Generate candidates that are common in mechanical systems.

        These are products of two velocities times functions of the coordinates, and potentials: sines and
        cosines of angles, of their sums and differences; powers of other coordinates; products of both.

        Parameters
        ----------
        coordinates, angles
            Names; the angles are some of the coordinates.
        size
            ``"compact"``, ``"standard"`` (1, 2, 3 coordinates: at most 12, 60, 150 terms), ``"large"`` (also
            1/x and log(x), for x > 0) or ``"chain"`` (planar links, from the base on).  ``"auto"`` or None:
            ``"standard"`` up to 250 terms; beyond, ``"chain"`` with two angles or more, else ``"compact"``.
        degree
            Maximum total degree of monomials in coordinates that are not angles; by default 2, 4 or 6.
        gyroscopic
            Whether to add terms linear in the velocities: spinning rotors, rotating frames, magnetic fields.
        dissipation
            Candidates of the dissipation function, as for `Library`.

        Raises
        ------
        InputError
            If the size or degree is unknown, or there would be more than 1500 terms.

        Examples
        --------
        >>> Library.mechanical(["theta1", "theta2"], angles=["theta1", "theta2"]).summary()
        '42 terms in theta1, theta2 (angles: theta1, theta2): 27 with velocities, 15 without'
        """
        names = check_coordinate_names(coordinates)
        terms = mechanical_terms(names, check_angles(angles, names), size, degree, gyroscopic)
        check_count(len(terms), f"the {size} library over {len(names)} coordinates", "choose a smaller size")
        return cls(terms, names, angles=angles, dissipation=dissipation)

    @staticmethod
    def mechanical_size(
        coordinates: Iterable[str] | str,
        angles: Iterable[str] | str = (),
        *,
        size: str | None = "auto",
        degree: int | None = None,
        gyroscopic: bool = False,
    ) -> int:
        """Return the number of terms that `mechanical` would generate.

        Examples
        --------
        >>> Library.mechanical_size(["x", "theta"], angles=["theta"])
        38
        """
        names = check_coordinate_names(coordinates)
        return len(mechanical_terms(names, check_angles(angles, names), size, degree, gyroscopic))

    @classmethod
    def symbolic(cls, coordinates: Iterable[str] | str, angles: Iterable[str] | str = ()) -> Library:
        """Generate candidates from the names of the coordinates by a grammar.

        There are more kinds of terms than in `mechanical` (at most 1500), with `lengths`, so that short ones
        are preferred.  `discover` leaves out terms that are undefined along the data, and reports them.

        Examples
        --------
        >>> Library.symbolic(["r", "phi"], angles=["phi"]).reduced().summary()
        '69 terms in r, phi (angles: phi): 45 with velocities, 24 without; 36 left out'
        """
        names = check_coordinate_names(coordinates)
        library = cls(grown_terms(names, check_angles(angles, names)), names, angles=angles)
        library._lengths = description_lengths(library.terms)
        return library

    @property
    def lengths(self) -> tuple[float | None, ...]:
        """Description length of each term in nats; None except for terms from `symbolic`."""
        return tuple(self._lengths.get(term) for term in self._terms)

    @property
    def terms(self) -> tuple[Term, ...]:
        """Candidates of the Lagrangian."""
        return self._terms

    @property
    def dissipation(self) -> tuple[Term, ...]:
        """Candidates of the dissipation function."""
        return self._dissipation

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self._coordinates

    @property
    def velocities(self) -> tuple[str, ...]:
        """Names of the velocities, ``<coordinate>_dot``."""
        return tuple(f"{name}_dot" for name in self._coordinates)

    @property
    def angles(self) -> tuple[str, ...]:
        """Names of the coordinates that are angles."""
        return self._angles

    @property
    def shapes(self) -> tuple[str, ...]:
        """Names of the shape parameters: unknown numbers inside terms, written in braces.

        Examples
        --------
        >>> Library(["x_dot**2", "exp(-{a}*x)", "exp(-2*{a}*x)"], ["x"]).shapes
        ('a',)
        """
        return shape_names((*self._terms, *self._dissipation))

    @property
    def n_dof(self) -> int:
        """Number of coordinates."""
        return len(self._coordinates)

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        """Candidates that were left out, and why."""
        return self._dropped

    def __len__(self) -> int:
        return len(self._terms)

    @overload
    def __getitem__(self, key: int) -> Term: ...
    @overload
    def __getitem__(self, key: slice) -> tuple[Term, ...]: ...
    def __getitem__(self, key: int | slice) -> Term | tuple[Term, ...]:
        return self._terms[key]

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Library) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        return self._terms, self._dissipation, self._coordinates, self._angles

    def __repr__(self) -> str:
        return listing_of(self)

    def index(self, expression: Candidate, kind: Kind = "lagrangian") -> int:  # type: ignore[override]
        """Return the index of an expression in the library. Equal functions match, however they are written.

        Parameters
        ----------
        expression
        kind
            Search the terms of the Lagrangian or of the dissipation function.

        Raises
        ------
        InputError
            When no term is equal; the message lists near matches.

        Examples
        --------
        >>> Library(["x_dot**2", "(x-1)**2"], ["x"]).index("x**2 - 2*x + 1")
        1
        """
        return place_within(self, expression, kind)

    def replace(
        self,
        *,
        terms: Iterable[Candidate] | None = None,
        dissipation: Iterable[Candidate] | None = None,
    ) -> Library:
        """Return a library over the same coordinates with other terms or another dissipation.

        Examples
        --------
        >>> Library(["x_dot**2", "x"], ["x"]).replace(terms=["x**2"])
        Library(['x**2'], coordinates=['x'])
        """
        new = Library(
            self._terms if terms is None else terms,
            self._coordinates,
            angles=self._angles,
            dissipation=self._dissipation if dissipation is None else dissipation,
        )
        new._dropped = self._dropped + new._dropped
        new._lengths = self._lengths
        return new

    def with_dissipation(self, expressions: Iterable[Candidate]) -> Library:
        """Return a library with more candidates of the dissipation function.

        Examples
        --------
        >>> library = Library(["x_dot**2", "x"], ["x"]).with_dissipation("auto")
        >>> [term.text for term in library.dissipation]
        ['x_dot**2/2', 'abs(x_dot)']
        """
        more = Library(self._terms, self._coordinates, angles=self._angles, dissipation=expressions)
        return self.replace(dissipation=[*self._dissipation, *more._dissipation])

    def reduced(self, keep: Iterable[Candidate] | str = (), *, prescribed: Iterable[str] = ()) -> Library:
        """Return the library without terms that do not change the equations of motion.

        It omits null terms (constants and total time derivatives), multiples of another term, and sums of
        other terms, also up to a null term. `dropped` lists them with reasons. Terms of L and of the
        dissipation are examined together.

        Parameters
        ----------
        keep
            Terms that stay if there is a choice. Otherwise, earlier terms stay.
        prescribed
            Coordinates moved by unknown forces. Their equations are ignored.

        Raises
        ------
        InputError
            When a term to keep is not in the library, or no term is left.

        Examples
        --------
        >>> library = Library(["x_dot**2", "1", "x*x_dot", "x", "2*x"], ["x"]).reduced()
        >>> [term.text for term in library], [str(dropped) for dropped in library.dropped]
        (['x_dot**2', 'x'], ['1: constant', 'x*x_dot: total time derivative', '2*x: equals 2*x'])
        """
        both = (*self._terms, *self._dissipation)
        held = {place_among_all(self, k) for k in ((keep,) if isinstance(keep, Candidate) else keep)}
        places = [self._coordinates.index(name) for name in prescribed]
        found = find_redundant([term_somewhere(t) for t in both], self._coordinates, held, places)
        left = [term for k, term in enumerate(both) if k not in found]
        terms = [term for term in left if term.kind == "lagrangian"]
        if not terms:
            raise InputError("no term of the library has an effect on the motion; add kinetic terms")
        new = self.replace(terms=terms, dissipation=[term for term in left if term.kind == "dissipation"])
        lengths = ((d, both[k], self._lengths.get(both[k])) for k, d in found.items())
        new._dropped = self._dropped + tuple(replace(d, term=t, length=length) for d, t, length in lengths)
        return new

    def at(self, values: Mapping[str, float]) -> Library:
        """Return the library with numbers for its shape parameters, by name.

        Raises
        ------
        InputError
            When a shape parameter has no number.

        Examples
        --------
        >>> Library(["x_dot**2", "exp(-{a}*x)"], ["x"]).at({"a": 0.5})
        Library(['x_dot**2', 'exp(-0.5*x)'], coordinates=['x'])
        """
        check_numbers((*self._terms, *self._dissipation), values)
        terms, dissipation = ([t.at(values) for t in part] for part in (self._terms, self._dissipation))
        return self.replace(terms=terms, dissipation=dissipation)
