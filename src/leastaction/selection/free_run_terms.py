"""Which terms free runs ask for, where equations hold to some per cent only.

What vibration and gears leave in the equations is fast.  A likelihood that takes the equation error as white
asks friction to explain a share of all of it, and takes small terms that imitate a little of it for certain.
Free runs are moved by slow forces only.  About the coefficients that minimise their errors, these errors are
linear in the coefficients of all candidates, so that

    S_i(C) = min over the coefficients of C of  Σ_r Σ_n ρ(e_rni),

the sum of squares that a set of candidates leaves in coordinate i, costs a small linear problem.  A friction
is added if it removes the relevant share of S_i from one coordinate at least, with a coefficient that is
positive beyond chance (of either sign, where it tells by how much directions differ); it is dropped if it
does not.  A term of L is dropped if its coefficient may be zero
and S_i hardly rises without it.  Chance is judged run by run (White 1982, Econometrica 50:1), for as many
looks as there are candidates to be looked at (:mod:`leastaction.selection.significance`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leastaction.curve.smoothing import Smooth
from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Structure
from leastaction.estimation.simulation_error import (
    LinearChoice,
    LinearRuns,
    SimulationFit,
    linear_runs,
    minimise_simulation_error,
)
from leastaction.library import has_direction
from leastaction.selection.significance import normal_cutoff

__all__ = ["FreeRunTerms", "terms_of_free_runs"]

_ROUNDS = 4  # fits of the coefficients, at most
_STATES = 2000  # along the motion, at which a candidate is measured
_SMALL = 0.01  # of the terms of an equation: unit of a coefficient that is zero


@dataclass(frozen=True, eq=False)
class FreeRunTerms:
    """What free runs choose, with the coefficients that minimise their errors.

    Attributes
    ----------
    structure : Structure
    coefficients : (n_candidates,) array
    found : SimulationFit
    """

    structure: Structure
    coefficients: np.ndarray
    found: SimulationFit


def terms_of_free_runs(
    fit: Fit, where: Grid, curve: Smooth, horizons: tuple[float, float], relevance: float
) -> FreeRunTerms | None:
    """Add friction and drop terms until free runs ask for no change.

    Parameters
    ----------
    fit : Fit
        To begin with.
    where : Grid
        That of ``curve``.
    curve : Smooth
    horizons : (float, float)
        Seconds of the free runs that give the coefficients, and of those that choose terms: where vibration
        pushes, longer ones tell more.
    relevance : float
        Share of the squared errors in a coordinate that a term has to remove.

    Returns
    -------
    FreeRunTerms or None
        None where there are too few runs, or they cannot be followed.
    """
    structure, units = fit.structure, _units(fit)
    coefficients, tried = fit.coefficients.copy(), set[Structure]()
    while True:
        found = minimise_simulation_error(where, curve, structure, coefficients, horizons[0])
        if found is None:
            return None
        coefficients[list(structure)] = found.estimates
        here = FreeRunTerms(structure, coefficients.copy(), found)
        tried.add(structure)
        linear = linear_runs(where, curve, coefficients, _scaled(units, coefficients), horizons[1])
        if linear is None or len(tried) == _ROUNDS:
            return here
        chosen, values = _chosen(fit, linear, structure, list(units), relevance)
        if chosen in tried:
            return here
        structure = chosen
        coefficients = fit.problem.completed(values)


def _units(fit: Fit) -> dict[int, float]:
    """Members and offered friction → unit of a coefficient that is zero."""
    problem = fit.problem
    free = set[int](problem.free.tolist())
    offered = {k for k, term in enumerate(problem.terms) if term.kind == "dissipation"}
    columns = sorted({*fit.structure, *(offered & free)})
    points = fit.points(_STATES)
    sizes = np.sqrt(np.square(problem.candidates.subset(columns).strong(points)).mean(axis=2)).max(axis=1)
    terms = problem.candidates.strong(points) * fit.coefficients[:, None, None]
    whole = np.sqrt(np.square(terms).sum(axis=0).mean(axis=1)).max()
    return {k: _SMALL * float(whole / max(size, 1e-300)) for k, size in zip(columns, sizes, strict=True)}


def _scaled(units: dict[int, float], coefficients: np.ndarray) -> dict[int, float]:
    """Units as large as the coefficients, where there are any."""
    return {k: abs(float(coefficients[k])) or unit for k, unit in units.items()}


def _chosen(
    fit: Fit, linear: LinearRuns, structure: Structure, columns: Sequence[int], relevance: float
) -> tuple[Structure, np.ndarray]:
    """The structure after adding and dropping on the linear problem, and its coefficients."""
    terms = [fit.problem.terms[k] for k in columns]
    is_friction = np.array([term.kind == "dissipation" for term in terms])
    choice = _Choice(linear, is_friction, relevance, np.array(list(map(has_direction, terms))))
    members = [n for n, k in enumerate(columns) if k in structure]
    seen: set[tuple[int, ...]] = set()
    while tuple(members) not in seen:
        seen.add(tuple(members))
        members = choice.dropped(choice.added(members))
    values = np.zeros_like(fit.coefficients)
    values[[columns[n] for n in members]] = linear.with_columns(members).estimates
    return Structure(columns[n] for n in members), values


@dataclass(frozen=True, eq=False)
class _Choice:
    """Steps to a neighbouring set of columns; sets are lists of columns in rising order."""

    linear: LinearRuns
    is_friction: np.ndarray
    relevance: float
    has_direction: np.ndarray

    @property
    def certain(self) -> float:
        """Standard errors that count: every column is looked at."""
        return normal_cutoff(self.is_friction.size)

    def needed(self, members: list[int], column: int, best: LinearChoice) -> float:
        """By which share the squares rise without a column, in the coordinate that needs it most.

        Not a number that counts, but −1, where its coefficient may be zero, or friction is not positive.
        """
        z = float(best.z[members.index(column)])
        rest = self.linear.with_columns([n for n in members if n != column])
        share = float(np.max(1.0 - best.squares / np.maximum(rest.squares, 1e-300)))
        if self.is_friction[column]:
            size = abs(z) if self.has_direction[column] else z
            return share if size > self.certain else -1.0
        return max(share, self.relevance) if abs(z) > self.certain else share

    def added(self, members: list[int]) -> list[int]:
        """With the friction that removes most, if it is needed then."""
        best, most = members, self.relevance
        for column in np.flatnonzero(self.is_friction).tolist():
            if column not in members:
                larger = sorted([*members, column])
                share = self.needed(larger, column, self.linear.with_columns(larger))
                best, most = (larger, share) if share > most else (best, most)
        return best

    def dropped(self, members: list[int]) -> list[int]:
        """Without the columns that are not needed, the least needed first."""
        while len(members) > 1:
            best = self.linear.with_columns(members)
            shares = [self.needed(members, column, best) for column in members]
            least = int(np.argmin(shares))
            if shares[least] >= self.relevance:
                break
            members = [n for n in members if n != members[least]]
        return members
