"""From the user's arguments to a well-posed problem: names matched, angles unwrapped, library reduced."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy as sp

from leastaction.curve.knots import FEWEST_SAMPLES, Knots, excerpt, lay_knots
from leastaction.curve.outliers import leave_out_outliers
from leastaction.curve.smoothing import Smooth, smooth
from leastaction.data.trajectories import Trajectories
from leastaction.errors import DataError, InputError
from leastaction.estimation.workspace import Workspace
from leastaction.findings import Finding, find
from leastaction.identifiers import quoted
from leastaction.library import Library, Term, smooth_abs
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["Prepared", "prepare"]

_COULOMB_SCALE = 0.01  # |v| is smoothed below this fraction of the rms velocity
_NEAR, _ROUNDED = 0.1, 1e-3  # radians


@dataclass(frozen=True, eq=False)
class Prepared:
    """A problem that can be searched.

    Attributes
    ----------
    trajectories : Trajectories
    searched : Trajectories
        Those that the structure is searched on: pieces of long recordings, otherwise all.
    library : Library
        Reduced: no null, duplicate or dependent candidates.
    columns : tuple of Term
        Candidates of L, then of the dissipation function.
    known : (n_columns,) array
        Known coefficients, NaN where free.
    prescribed : tuple of int
        Coordinates whose equations are not used.
    knots : Knots
        Of ``searched``.
    degree : int
    findings : tuple of Finding
        What was done to the data or the library on the user's behalf, and what is doubtful about them.
    """

    trajectories: Trajectories
    searched: Trajectories
    library: Library
    columns: tuple[Term, ...]
    known: np.ndarray
    prescribed: tuple[int, ...]
    knots: Knots
    degree: int
    findings: tuple[Finding, ...]

    @property
    def euler_lagrange(self) -> EulerLagrange:
        """All candidates, as functions."""
        return EulerLagrange(self.columns, self.library.coordinates, self.prescribed)

    def workspace(self, columns) -> Workspace:
        """To search in."""
        return Workspace(self.searched, columns, self.known, self.knots.per_second, self.degree)

    def pushed(self, forces: Sequence[np.ndarray]) -> Prepared:
        """The same problem with other forces, (n_times, n_dof) in each trajectory; not for pieces."""
        trajectories = self.trajectories.with_forces(forces)
        return replace(self, trajectories=trajectories, searched=trajectories)

    def whole_workspace(self, columns, knots_per_second: float) -> tuple[Workspace, Smooth]:
        """All data on a grid, and the curve through them, smoothed as strongly as those searched."""
        workspace = Workspace(self.trajectories, columns, self.known, knots_per_second, self.degree)
        penalty = self.knots.smooth.penalty
        return workspace, smooth(workspace.grid, workspace.times, workspace.values, penalty, workspace.rates)


def prepare(
    trajectories,
    library: Library | Iterable[str],
    known: Mapping[str, float] | None,
    dissipation: Iterable[str],
    angles: Iterable[str] | None,
    degree: int,
    most_samples: int | None = None,
    force_offset: Iterable[str] = (),
    robust: bool = True,
    prescribed: Iterable[str] = (),
) -> Prepared:
    """Check and complete everything that a search needs.

    Parameters
    ----------
    most_samples : int, optional
        Search on pieces of longer recordings.
    robust : bool
        Leave out outliers.

    Raises
    ------
    InputError, DataError
    """
    trajectories = Trajectories.coerce(trajectories)
    if not isinstance(library, Library):
        library = Library(library, trajectories.coordinates)
    if library.coordinates != trajectories.coordinates:
        raise InputError(
            f"the library is written for the coordinates {', '.join(library.coordinates)}, but the data have "
            f"{', '.join(trajectories.coordinates)}; give both the same names in the same sequence"
        )
    angles = library.angles if angles is None else tuple(angles)
    trajectories = trajectories.unwrap(angles)
    _check_data(trajectories)
    places = _prescribed(prescribed, trajectories.coordinates)
    trajectories, unused_forces = _without_forces_on(places, trajectories)
    library = _with_offsets(library.with_dissipation(dissipation), force_offset)
    known_terms = _resolve_known(library, dict(known or {}))
    if not known_terms and not trajectories.driven:
        raise InputError(
            "no force acts and no coefficient is known: then L = 0 solves every equation. Give the "
            "coefficient of at least one term, e.g. known={'"
            + library.terms[0].text
            + "': 1.0}, which sets the units of L"
        )
    findings, turning = _about_angles(trajectories, angles)
    findings += unused_forces
    findings += [find("undeclared-angle", name, jumps=count) for name, count in turning.items()]
    trajectories = trajectories.unwrap(turning)
    if robust:
        trajectories, left_out = leave_out_outliers(trajectories, degree)
        findings += left_out
    searched = trajectories if most_samples is None else excerpt(trajectories, most_samples)
    knots = lay_knots(searched, degree)
    smoothing = {
        f"{c}_dot": _round_to_one_digit(_COULOMB_SCALE * r)
        for c, r in zip(library.coordinates, knots.rates, strict=True)
    }
    softened = smooth_abs(library, smoothing)
    if softened is not library:
        known_terms = {smooth_abs(term, smoothing): value for term, value in known_terms.items()}
        terms = (*library.terms, *library.dissipation)
        changed = {v: e for v, e in smoothing.items() if any(_is_smoothed(t, v) for t in terms)}
        findings.append(find("friction-smoothed", changed, widths=list(changed.values())))
    driven = [library.coordinates[i] for i in places]
    reduced = softened.reduced(keep=list(known_terms), prescribed=driven)
    columns = (*reduced.terms, *reduced.dissipation)
    coefficients = np.array([known_terms.get(term, np.nan) for term in columns])
    missing = [term.text for term in known_terms if term not in columns]
    if missing:
        raise InputError(
            f"the known term {missing[0]!r} has no effect on the equations of motion (or repeats another "
            "known term); give the coefficient of a term that has"
        )
    if not np.isnan(coefficients).any():
        raise InputError(
            "nothing is left to find: every candidate is known, or is a constant or total time derivative"
        )
    return Prepared(
        trajectories,
        searched,
        reduced,
        columns,
        coefficients,
        places,
        knots,
        degree,
        tuple(findings),
    )


def _prescribed(names: Iterable[str], coordinates: tuple[str, ...]) -> tuple[int, ...]:
    """Places of the prescribed coordinates."""
    names = list(names)
    for name in names:
        if name not in coordinates:
            raise InputError(
                f"prescribed names {quoted(name)}, which is not a coordinate; the coordinates are "
                f"{', '.join(coordinates)}"
            )
    if set(names) == set(coordinates):
        raise InputError(
            "every coordinate is prescribed, so that no equation of motion is left; leave out those that "
            "known forces move, or none"
        )
    return tuple(i for i, name in enumerate(coordinates) if name in names)


def _without_forces_on(
    places: tuple[int, ...], trajectories: Trajectories
) -> tuple[Trajectories, list[Finding]]:
    """What is known of the forces on prescribed coordinates is of no use."""
    names = [
        trajectories.coordinates[i]
        for i in places
        if any(t.forces is not None and np.any(t.forces[:, i]) for t in trajectories)
    ]
    if not names:
        return trajectories, []
    rest = np.array([i not in places for i in range(trajectories.n_dof)])
    left = [np.zeros(t.q.shape) if t.forces is None else t.forces * rest for t in trajectories]
    return trajectories.with_forces(left), [find("forces-unused", names)]


def _with_offsets(library: Library, coordinates: Iterable[str]) -> Library:
    """A constant force c on q is the term c q of L."""
    present = {str(term.expr) for term in library.terms}
    added = [name for name in coordinates if name not in present]
    return library.replace(terms=[*library.terms, *added]) if added else library


def _is_smoothed(term: Term, velocity: str) -> bool:
    return any(velocity in {s.name for s in part.free_symbols} for part in term.expr.atoms(sp.Abs))


def _check_data(trajectories: Trajectories) -> None:
    for i, name in enumerate(trajectories.coordinates):
        values = np.concatenate([t.q[:, i] for t in trajectories])
        values = values[np.isfinite(values)]
        if values.size < FEWEST_SAMPLES:
            raise DataError(
                f"coordinate {name!r} has {values.size} samples; at least {FEWEST_SAMPLES} are needed, "
                "and a few periods of the motion to find anything"
            )
        if np.ptp(values) <= 1e-12 * np.abs(values).max():
            raise DataError(
                f"coordinate {name!r} is constant ({values[0]:g}): nothing about its motion can be learnt; "
                "leave it out or record a run in which it moves"
            )


def _resolve_known(library: Library, known: Mapping[str, float]) -> dict[Term, float]:
    out: dict[Term, float] = {}
    for text, value in known.items():
        if isinstance(value, (bool, str)) or not np.isscalar(value) or not np.isfinite(value):  # type: ignore[arg-type]
            raise InputError(f"the known coefficient of {text!r} is {value!r}; expected a finite number")
        kind = "lagrangian"
        if library.dissipation:
            try:
                library.index(text)
            except InputError:
                kind = "dissipation"
        try:
            position = library.index(text, kind)
        except InputError:
            position, kind = library.index(text), "lagrangian"  # its message speaks of the Lagrangian
        out[(library.terms if kind == "lagrangian" else library.dissipation)[position]] = float(value)  # type: ignore[arg-type]
    if out and all(value == 0.0 for value in out.values()):
        raise InputError("all known coefficients are zero; at least one must set the scale of L")
    return out


def _round_to_one_digit(value: float) -> float:
    return float(f"{value:.0e}")


def _about_angles(trajectories: Trajectories, angles) -> tuple[list[Finding], dict[str, int]]:
    """What was unwrapped, and coordinates that seem to be wrapped angles with the number of their jumps."""
    notes = [
        find("angle-unwrapped", name, jumps=count)
        for name, count in trajectories.wraps_removed.items()
        if count and name in angles
    ]
    turning = {}
    for i, name in enumerate(trajectories.coordinates):
        if name in angles:
            continue
        steps = np.concatenate([np.diff(t.q[:, i][np.isfinite(t.q[:, i])]) for t in trajectories])
        wraps = int(np.sum(np.abs(np.abs(steps) - 2 * np.pi) < 0.5))
        quiet = np.quantile(np.abs(steps), 0.99) < np.pi / 2
        if wraps and (quiet or _fills_one_turn(np.concatenate([t.q[:, i] for t in trajectories]))):
            turning[name] = wraps
    return notes, turning


def _fills_one_turn(q: np.ndarray) -> bool:
    """Whether all values lie in [−π, π] or [0, 2π], close to both ends: noise alone would not stop there."""
    low, high = np.nanmin(q), np.nanmax(q)
    return any(
        -_ROUNDED < low - start < _NEAR and -_ROUNDED < start + 2 * np.pi - high < _NEAR
        for start in (-np.pi, 0.0)
    )
