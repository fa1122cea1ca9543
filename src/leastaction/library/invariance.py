r"""Conditions on the λ_k under which a change of variables leaves L = Σ λ_k φ_k unchanged, up to null terms.

A change q' = G q + c, which may reverse the velocities, maps φ to φ∘g with

.. math:: E_i[φ∘g](q, q̇, q̈) = \sum_j G_{ji} E_j[φ](g(q, q̇, q̈)).

L is unchanged if Σ λ_k (E[φ_k∘g] − E[φ_k]) vanishes everywhere. This is linear in the coefficients and does
not depend on the form of the terms. The rank of the columns at random states is the number of independent
conditions A λ = 0. One generic element, such as a rotation by 0.73, represents a whole group of translations
or rotations.

A shift that adds a constant to L (x in a uniform field) is rejected, because its momentum is not conserved.
The values at rest, where total derivatives vanish, must therefore agree as well.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from leastaction.library.jets import Jets, Points
from leastaction.library.term import Term

__all__ = ["Change", "Invariance", "exchanges", "reversal", "translations", "turns"]

_RANK = 1e-8  # of columns of size one; rounding is far below
_MARGIN = 5
_SPARE_POINTS = 40
_SHIFT, _ANGLE = 0.7351, 0.7351  # generic
_FEW = 4  # coordinates for which every combination is tested


@dataclass(frozen=True, eq=False)
class Change:
    """q' = `matrix` q + `shift`; with `reverse`, the velocities change their sign.

    `text` describes the change, and `names` are the coordinates that change. Its field is ξ = `turn` q +
    `direction`, zero for a discrete change.
    """

    text: str
    names: tuple[str, ...]
    matrix: np.ndarray
    shift: np.ndarray
    turn: np.ndarray
    direction: np.ndarray
    reverse: bool = False

    @classmethod
    def of_field(cls, text: str, names: tuple[str, ...], turn: np.ndarray, direction: np.ndarray) -> Change:
        """An element of the group of a translation or of turns in planes that do not share a coordinate."""
        matrix = np.eye(len(turn)) + math.sin(_ANGLE) * turn + (1.0 - math.cos(_ANGLE)) * turn @ turn
        return cls(text, names, matrix, _SHIFT * direction, turn, direction)

    def __call__(self, points: Points) -> Points:
        """The states after the change."""
        sign = -1.0 if self.reverse else 1.0
        q = self.matrix @ points.q + self.shift[:, None]
        return Points(q, sign * self.matrix @ points.qdot, self.matrix @ points.qddot)

    @property
    def field(self) -> np.ndarray:
        """Turn and direction as one vector."""
        return np.concatenate([self.turn.ravel(), self.direction])


def reversal(coordinates: Sequence[str]) -> Change:
    """Reversal of time."""
    n = len(coordinates)
    none = np.zeros((n, n)), np.zeros(n)
    return Change("t -> -t", tuple(coordinates), np.eye(n), np.zeros(n), *none, reverse=True)


def translations(coordinates: Sequence[str], groups: Sequence[Sequence[str]]) -> Iterator[Change]:
    """Shifts of single coordinates, then of several together, to the same or to opposite sides.

    Parameters
    ----------
    coordinates
    groups
        Coordinates of one kind, which may be shifted together. Of more than four, only pairs, all together,
        and those with one name for several bodies are shifted.

    Examples
    --------
    >>> [change.text for change in translations(["x", "y"], [["x", "y"]])]
    ['x + c', 'y + c', 'x + c, y + c', 'x + c, y - c']
    """
    n = len(coordinates)
    signs: dict[tuple[int, ...], None] = {}
    for group in groups:
        places = [coordinates.index(name) for name in group]
        for some in _few_signs(len(places)) if len(places) <= _FEW else _many_signs(group):
            sign = np.zeros(n, dtype=int)
            sign[places] = some
            signs[tuple(sign.tolist())] = None
    for sign in sorted(signs, key=lambda s: (sum(map(abs, s)), s.count(-1))):
        names = tuple(c for c, x in zip(coordinates, sign, strict=True) if x)
        text = ", ".join(
            f"{c} {'+' if x > 0 else '-'} c" for c, x in zip(coordinates, sign, strict=True) if x
        )
        yield Change.of_field(text, names, np.zeros((n, n)), np.array(sign, dtype=float))


def _few_signs(n: int) -> Iterator[tuple[int, ...]]:
    """Every combination of 0, 1 and −1 whose first number is 1."""
    for some in product((1, 0, -1), repeat=n):
        if next((x for x in some if x), 0) == 1:
            yield some


def _many_signs(names: Sequence[str]) -> Iterator[tuple[int, ...]]:
    n = len(names)
    for i in range(n):
        yield tuple(int(k == i) for k in range(n))
    for (i, j), sign in product(combinations(range(n), 2), (1, -1)):
        yield tuple(int(k == i) + sign * int(k == j) for k in range(n))
    for some in (*(row for grid in _grids(names) for row in grid), names):
        yield tuple(int(name in some) for name in names)


def turns(coordinates: Sequence[str], positions: Sequence[str]) -> Iterator[Change]:
    """Rotations in the plane of two positions, then in several planes at once.

    Several planes are tested for four positions. If names refer to bodies, such as x1, y1, x2, y2, their
    planes are used.

    Examples
    --------
    >>> [change.text for change in turns(["x", "y", "phi"], ["x", "y"])]
    ['turn of (x, y)']
    >>> names = ["x1", "y1", "x2", "y2"]
    >>> [change.text for change in turns(names, names)][4]
    'turn of (x1, y1) and of (x2, y2)'
    """
    grids = _grids(positions)
    rows = [row for grid in grids for row in grid] or [tuple(positions)]
    sets = [(plane,) for row in rows for plane in combinations(row, 2)]
    for grid in grids:
        sets += [tuple((row[i], row[j]) for row in grid) for i, j in combinations(range(len(grid[0])), 2)]
    if len(positions) == _FEW and not grids:
        for one, other in _pairings(positions):
            sets += [(one, other), (one, (other[1], other[0]))]
    for planes in sets:
        turn = np.zeros((len(coordinates),) * 2)
        for x, y in planes:
            i, j = coordinates.index(x), coordinates.index(y)
            turn[i, j], turn[j, i] = -1.0, 1.0
        names = tuple(name for plane in planes for name in plane)
        text = "turn of " + " and of ".join(f"({x}, {y})" for x, y in planes)
        yield Change.of_field(text, names, turn, np.zeros(len(coordinates)))


def exchanges(coordinates: Sequence[str], groups: Sequence[Sequence[str]]) -> Iterator[Change]:
    """Exchanges of bodies, if names refer to bodies, otherwise of two coordinates; and reflections.

    Examples
    --------
    >>> [change.text for change in exchanges(["x1", "x2", "x3"], [["x1", "x2", "x3"]])]
    ['x1 <-> x2', 'x1 <-> x3', 'x2 <-> x3']
    >>> names = ["x1", "y1", "x2", "y2"]
    >>> [change.text for change in exchanges(names, [names])][0]
    'x1 <-> x2, y1 <-> y2'
    """
    swaps: dict[tuple[tuple[str, str], ...], None] = {}
    for grid in _grids(coordinates):
        swaps |= {tuple(zip(*rows, strict=True)): None for rows in combinations(grid, 2)}
    for group in groups if not swaps else ():
        swaps |= {(pair,): None for pair in combinations(group, 2)}
        if len(group) == _FEW:
            swaps |= dict.fromkeys(_pairings(group))
        if len(group) > _FEW:
            swaps[tuple((group[k], group[-1 - k]) for k in range(len(group) // 2))] = None
    n = len(coordinates)
    for pairs in swaps:
        order = list(range(n))
        for x, y in pairs:
            i, j = coordinates.index(x), coordinates.index(y)
            order[i], order[j] = j, i
        names = tuple(name for pair in pairs for name in pair)
        text = ", ".join(f"{x} <-> {y}" for x, y in pairs)
        yield Change(text, names, np.eye(n)[order], np.zeros(n), np.zeros((n, n)), np.zeros(n))


def _pairings(names: Sequence[str]) -> Iterator[tuple[tuple[str, str], tuple[str, str]]]:
    """Four names as two pairs."""
    a, b, c, d = names
    yield from (((a, b), (c, d)), ((a, c), (b, d)), ((a, d), (b, c)))


def _grids(names: Sequence[str]) -> list[list[tuple[str, ...]]]:
    """Names of bodies, a row each: x1, y1 and x2, y2, or x1, x2 and y1, y2; empty if there are none."""
    matches = [re.fullmatch(r"(.*?)_?(\d+)", name) for name in names]
    parts = {(match[2], match[1]): match[0] for match in matches if match}
    numbers, heads = (list(dict.fromkeys(key[k] for key in parts)) for k in (0, 1))
    if min(len(numbers), len(heads)) < 2 or len(parts) < len(numbers) * len(heads):
        return []
    grid = [tuple(parts[number, head] for head in heads) for number in numbers]
    return [grid, list(zip(*grid, strict=True))]


class Invariance:
    """Conditions of a change of variables on the coefficients of some terms, all of L or all of ψ.

    Parameters
    ----------
    terms
        Without shape parameters.
    coordinates
        Names of the coordinates.

    Examples
    --------
    >>> from leastaction.library.term import make_term
    >>> names = ["x", "y", "x_dot", "y_dot"]
    >>> terms = [make_term(text, names) for text in ("x_dot**2", "y_dot**2", "1/sqrt(x**2+y**2)")]
    >>> (turn,) = turns(["x", "y"], ["x", "y"])
    >>> rows = Invariance(terms, ["x", "y"]).conditions(turn)  # the first two must be equal
    >>> rows.shape, np.allclose(rows @ [0.5, 0.5, 3.0], 0.0), np.allclose(rows @ [0.5, 0.6, 3.0], 0.0)
    ((1, 3), True, False)
    """

    def __init__(self, terms: Sequence[Term], coordinates: Sequence[str]) -> None:
        self.terms: tuple[Term, ...] = tuple(terms)
        self.coordinates: tuple[str, ...] = tuple(coordinates)
        n_points = 2 * len(terms) + _SPARE_POINTS
        self.points: Points = Points.draw(np.random.default_rng(0), len(coordinates), n_points)
        self._effects, self._rest = self._at(self.points)
        finite = np.where(np.isfinite(self._effects), np.abs(self._effects), 0.0)
        self._sizes = finite.max(axis=(1, 2))
        self._sizes[self._sizes == 0.0] = 1.0

    def conditions(self, change: Change) -> np.ndarray | None:
        """A such that A λ = 0 if the change leaves the sum unchanged, shape (n_conditions, n_terms).

        The rows are orthonormal for coefficients in units of the sizes of the terms. None if too few states
        are in the domain of all terms before and after the change.
        """
        moved, rest = self._at(change(self.points))
        rows = np.einsum("ji,kjp->kip", change.matrix, moved) - self._effects
        rows = np.concatenate([rows, (rest - self._rest)[:, None]], axis=1)
        inside = np.isfinite(rows).all(axis=(0, 1))
        if inside.sum() < len(self.terms) + _MARGIN:
            return None
        columns = (rows[:, :, inside] / self._sizes[:, None, None]).reshape(len(self.terms), -1)
        left, singular, _ = np.linalg.svd(columns, full_matrices=False)
        there = singular > _RANK * np.sqrt(columns.shape[1])
        return left.T[there] * self._sizes

    @np.errstate(all="ignore")  # states outside the domain of a term are left out
    def _at(self, points: Points) -> tuple[np.ndarray, np.ndarray]:
        """Contribution of each term to the equations, (n_terms, n_dof, n_points), and its values at rest."""
        still = Points(points.q, np.zeros_like(points.q), np.zeros_like(points.q))
        jets, rest = Jets(self.coordinates, points), Jets(self.coordinates, still)
        effects = np.array([jets.effect(term) for term in self.terms])
        values = [rest.jet(term.expr)[0] * (term.kind == "lagrangian") for term in self.terms]
        return effects, np.array(values)
