"""The set of candidates in a model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

__all__ = ["Structure"]


@dataclass(frozen=True, init=False)
class Structure:
    """A set of free candidates of one problem.

    Attributes
    ----------
    members : tuple of int
        Their indices among the candidates, in rising order. Known candidates belong to every structure and
        are not listed.

    Examples
    --------
    >>> Structure([4, 1]).members
    (1, 4)
    >>> Structure([4, 1]).without([4])
    Structure(members=(1,))
    """

    members: tuple[int, ...]

    def __init__(self, members: Iterable[int] = ()) -> None:
        object.__setattr__(self, "members", tuple(sorted(int(m) for m in members)))

    def __len__(self) -> int:
        return len(self.members)

    def __iter__(self) -> Iterator[int]:
        return iter(self.members)

    def __contains__(self, member: object) -> bool:
        return member in self.members

    def __le__(self, other: Structure) -> bool:
        """Whether every member is in the other structure, too."""
        return set(self.members) <= set(other.members)

    def without(self, members: Iterable[int]) -> Structure:
        """The structure with some members left out."""
        out = set(members)
        return Structure(m for m in self.members if m not in out)

    def with_(self, members: Iterable[int]) -> Structure:
        """The structure with further members."""
        return Structure({*self.members, *members})
