"""Make a well-posed problem from the user's arguments: match names, unwrap angles, reduce the library."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import sympy as sp

from leastaction.curve.knots import FEWEST_SAMPLES, Knots, excerpt, lay_knots
from leastaction.curve.outliers import leave_out_outliers
from leastaction.data.coerce import arranged, joined
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import DataError, InputError
from leastaction.estimation.calibration import Calibrated, from_columns
from leastaction.estimation.crew import Crew
from leastaction.estimation.domains import undefined_along
from leastaction.estimation.forces import fast_forces_act
from leastaction.estimation.hidden import (
    anchored,
    check_hidden_terms,
    knots_of_all,
    refuse_prescribed,
    with_every_sensor,
    with_hidden,
)
from leastaction.estimation.problem import Problem
from leastaction.estimation.settings import ESTIMATION
from leastaction.estimation.shape_ranges import shape_ranges
from leastaction.findings import Finding, find
from leastaction.identifiers import TIME, quoted
from leastaction.library import Library, Term, smooth_abs
from leastaction.library.tree import KinematicTree
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["ENOUGH_SAMPLES", "Request", "Setup", "build_problem", "states_along"]

ENOUGH_SAMPLES = 50_000  # bounds time
"""Samples of a search; longer recordings enter when the structure is confirmed."""

# of data: the squares of a force from x**4 reach 1e180, and further products remain finite
_LARGEST = 1e30
_NEAR, _ROUNDED = 0.1, 1e-3  # radians
_FIRST = 0.55  # of the range of a shape parameter, before the search; not a round number


@dataclass(frozen=True, eq=False)
class Request:
    """The arguments of :func:`leastaction.discover` beside the data."""

    library: Library | Iterable[str]
    known: Mapping[str, float] = field(default_factory=dict[str, float])
    dissipation: Iterable[str] = ()
    angles: Iterable[str] | None = None
    degree: int = 5
    force_offset: Iterable[str] = ()
    prescribed: Iterable[str] = ()
    robust: bool = True
    shapes: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    hidden: Iterable[str] = ()
    measure: Iterable[str] = ()
    lengths: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True, eq=False)
class Setup:
    """A problem that can be searched.

    Attributes
    ----------
    problem : Problem
        With all data.
    searched : Problem
        The problem for the search of a structure: with pieces of long recordings, otherwise with all data.
    library : Library
        Reduced: no null, duplicate or dependent candidates.
    scales : Knots
        Time scales of the searched motion, and the smooth curve through it.
    findings : tuple of Finding
        Changes to the data and the library, and doubts about them.
    """

    problem: Problem
    searched: Problem
    library: Library
    scales: Knots
    findings: tuple[Finding, ...]

    def computed_by(self, crew: Crew | None) -> Setup:
        """The setup with a crew that computes."""
        problem, searched = (replace(p, crew=crew) for p in (self.problem, self.searched))
        return replace(self, problem=problem, searched=searched)


def build_problem(
    trajectories: Trajectory | Iterable[Trajectory], request: Request, most_samples: int | None = None
) -> Setup:
    """Check the arguments and build the problem of a search.

    Parameters
    ----------
    trajectories : Trajectory, Trajectories or iterable of Trajectory
    request : Request
    most_samples : int, optional
        Search on pieces of longer recordings.

    Raises
    ------
    InputError, DataError
    """
    trajectories = Trajectories.coerce(trajectories)
    seen_by = _seen_by_sensors(trajectories, request)
    columns, absent = (trajectories, request.hidden) if seen_by is None else (seen_by.trajectories, ())
    trajectories, hidden = with_hidden(columns, absent, request.library)
    library = _library(request.library, trajectories.coordinates)
    check_hidden_terms(library, [trajectories.coordinates[i] for i in hidden])
    angles = library.angles if request.angles is None else tuple(request.angles)
    measured = [name for i, name in enumerate(trajectories.coordinates) if i not in hidden]
    trajectories = trajectories.unwrap([name for name in angles if name in measured])
    _check_data(trajectories, hidden)
    places = _prescribed(request.prescribed, trajectories.coordinates)
    refuse_prescribed(trajectories.coordinates, hidden, places)
    trajectories, unused_forces = _without_forces_on(places, trajectories)
    library = _with_offsets(library.with_dissipation(request.dissipation), request.force_offset)
    known = _resolve_known(library, dict(request.known or {}))
    _check_scale(trajectories, library, known)
    findings, turning = _about_angles(trajectories, angles, () if seen_by is None else seen_by.computed)
    findings += [*unused_forces, *(find("undeclared-angle", name, jumps=n) for name, n in turning.items())]
    trajectories = trajectories.unwrap(turning)
    seen = arranged(trajectories, measured)
    if seen_by is not None:
        findings += seen_by.findings
    elif request.robust:
        seen, left_out = leave_out_outliers(seen, request.degree, most_samples)
        findings += left_out
    trajectories = anchored(joined(seen, trajectories), library, hidden)
    searched = trajectories if hidden or seen_by is not None else with_every_sensor(trajectories)
    searched = searched if most_samples is None else excerpt(searched, most_samples)
    scales = knots_of_all(lay_knots(arranged(searched, measured), request.degree), hidden)
    library, known, smoothed = _smooth_friction(library, known, scales.rates)
    states = states_along(library.coordinates, scales)
    undefined = undefined_along(library, states, known)
    if undefined:
        library = library.replace(terms=[term for term in library.terms if term not in undefined])
        findings.append(find("undefined-candidates", [term.text for term in undefined]))
    library = library.reduced(keep=list(known), prescribed=[library.coordinates[i] for i in places])
    terms = (*library.terms, *library.dissipation)
    coefficients = _coefficients(terms, known)
    of_sensors = () if seen_by is None else seen_by.sensors.functions.names
    given = {name: ends for name, ends in request.shapes.items() if name not in of_sensors}
    ranges = shape_ranges(terms, states, given, of_sensors)
    numbers = {name: where.at(_FIRST) for name, where in ranges.items()}
    candidates = EulerLagrange([term.at(numbers) for term in terms], library.coordinates, places)
    problem = Problem(
        trajectories,
        candidates,
        coefficients,
        request.degree,
        ranges=ranges,
        lengths=_lengths(library),
        forms=tuple(form for form in library.dropped if form.length is not None and form.combination),
        between="band-limited" if _fast_forces_act(searched) else "slow",
        hidden=hidden,
        sensors=None if seen_by is None else seen_by.sensors,
        angles=angles,
    )
    return Setup(problem, problem.on(searched), library, scales, (*findings, *smoothed))


def _seen_by_sensors(trajectories: Trajectories, request: Request) -> Calibrated | None:
    """Coordinates from measured columns that are functions of them, if there are any."""
    if not request.measure:
        return None
    whose = request.library, request.hidden, request.angles
    return from_columns(trajectories, request.measure, *whose, request.degree, request.shapes, request.robust)


def _check_scale(trajectories: Trajectories, library: Library, known: Mapping[Term, float]) -> None:
    """Refuse a problem without forces and known coefficients."""
    if not known and not trajectories.driven:
        raise InputError(
            "no force acts and no coefficient is known, so that L = 0 solves every equation; give the "
            "coefficient of at least one term, e.g. known={'"
            + library.terms[0].text
            + "': 1.0}, which sets the units of L"
        )


def _fast_forces_act(data: Trajectories) -> bool:
    parts = [(t.t, t.q, t.forces) for t in data]
    return data.driven and fast_forces_act(*zip(*parts, strict=True))


def _lengths(library: Library) -> np.ndarray | None:
    """Description lengths of all candidates; those of the dissipation have none."""
    lengths = [*library.lengths, *(None for _ in library.dissipation)]
    if all(length is None for length in lengths):
        return None
    return np.array([np.nan if length is None else length for length in lengths])


def states_along(names: Sequence[str], scales: Knots) -> dict[str, np.ndarray]:
    """Coordinates, their derivatives and time along the smooth curve, one (n_points,) array each."""
    grid = scales.smooth.grid
    out = {TIME: grid.points[:, 0]}
    for nu, values in enumerate(grid.at_quadrature(scales.smooth.control_points)):
        out |= {name + nu * "_dot": values[:, 0, i] for i, name in enumerate(names)}
    return out


def _library(given: Library | Iterable[str], coordinates: tuple[str, ...]) -> Library:
    if isinstance(given, KinematicTree):
        raise InputError(
            "a kinematic tree determines the form of the equations, so that no discovery is needed; use "
            "leastaction.arms.identify(trajectories, tree)"
        )
    library = given if isinstance(given, Library) else Library(given, coordinates)
    if library.coordinates != coordinates:
        raise InputError(
            f"the library has the coordinates {', '.join(library.coordinates)}, but the data have "
            f"{', '.join(coordinates)}; give both the same names in the same order"
        )
    return library


def _smooth_friction(
    library: Library, known: dict[Term, float], rates: np.ndarray
) -> tuple[Library, dict[Term, float], list[Finding]]:
    """The library with |v| smoothed near zero velocity, and a note that gives the width."""
    narrow = {s.name for term in library.dissipation if term.shapes for s in term.expr.free_symbols}
    smoothing: dict[str, float] = {}
    for name, rate in zip(library.velocities, rates, strict=True):
        width = ESTIMATION.stribeck_width if name in narrow else ESTIMATION.dry_width
        smoothing[name] = _round_to_one_digit(width * rate)
    softened = smooth_abs(library, smoothing)
    if softened is library:
        return library, known, []
    terms = (*library.terms, *library.dissipation)
    changed = {v: e for v, e in smoothing.items() if any(_is_smoothed(t, v) for t in terms)}
    note = find("friction-smoothed", changed, widths=list(changed.values()))
    return softened, {smooth_abs(term, smoothing): value for term, value in known.items()}, [note]


def _coefficients(terms: tuple[Term, ...], known: dict[Term, float]) -> np.ndarray:
    """(n_candidates,) known coefficients, NaN where free."""
    missing = [term.text for term in known if term not in terms]
    if missing:
        raise InputError(
            f"the known term {missing[0]!r} has no effect on the equations of motion (or repeats another "
            "known term); give the coefficient of a term that has"
        )
    coefficients = np.array([known.get(term, np.nan) for term in terms])
    if not np.isnan(coefficients).any():
        raise InputError(
            "no candidate is free: every candidate is known, or is a constant or total time derivative"
        )
    return coefficients


def _prescribed(names: Iterable[str], coordinates: tuple[str, ...]) -> tuple[int, ...]:
    """Indices of the prescribed coordinates."""
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
    """Drop known forces on prescribed coordinates, which have no equation."""
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
    """The library with the term q for each constant force: a force c on q is the term c q of L."""
    present = {str(term.expr) for term in library.terms}
    added = [name for name in coordinates if name not in present]
    return library.replace(terms=[*library.terms, *added]) if added else library


def _is_smoothed(term: Term, velocity: str) -> bool:
    return any(velocity in {s.name for s in part.free_symbols} for part in term.expr.atoms(sp.Abs))


def _check_data(trajectories: Trajectories, hidden: tuple[int, ...]) -> None:
    for i, name in enumerate(trajectories.coordinates):
        if i in hidden:
            continue
        parts = [t.q[:, i] for t in trajectories]
        count = sum(int(np.isfinite(part).sum()) for part in parts)
        if count < FEWEST_SAMPLES:
            raise DataError(
                f"coordinate {name!r} has {count} samples; at least {FEWEST_SAMPLES} are needed, "
                "which should cover a few periods of the motion"
            )
        _check_range(parts, f"coordinate {name!r}")
        seen = [part for part in parts if np.isfinite(part).any()]
        low, high = (float(f([f(part) for part in seen])) for f in (np.nanmin, np.nanmax))
        if high - low <= 1e-12 * max(abs(low), abs(high)):
            raise DataError(
                f"coordinate {name!r} is constant ({low:g}), so that no equation of it can be found; "
                "leave it out or record a run in which it moves"
            )
        if trajectories.driven:
            forces = [t.forces[:, i] for t in trajectories if t.forces is not None]
            _check_range(forces, f"the force on {name!r}")
    _check_range([np.array(trajectories.sampling_interval)], "the sampling interval")
    for rate in trajectories.rates:
        _check_range(rate.values, f"the {rate.quantity} of {trajectories.coordinates[rate.coordinate]!r}")


def _check_range(parts: Sequence[np.ndarray], what: str) -> None:
    """Refuse numbers whose powers and squares would overflow or underflow."""
    size = max(np.abs(part[np.isfinite(part)]).max(initial=0.0) for part in parts)
    if size > _LARGEST or 0.0 < size < 1.0 / _LARGEST:
        raise DataError(
            f"{what} is of the size {size:.1g}; use a unit in which it lies between {1.0 / _LARGEST:g} and "
            f"{_LARGEST:g}"
        )


def _resolve_known(library: Library, known: Mapping[str, float]) -> dict[Term, float]:
    out: dict[Term, float] = {}
    for text, value in known.items():
        if isinstance(value, (bool, str)) or not np.isscalar(value) or not np.isfinite(value):  # type: ignore[arg-type]
            raise InputError(f"the known coefficient of {text!r} is {value!r}; expected a finite number")
        number = float(value)  # type: ignore[arg-type]
        if number and not 1.0 / _LARGEST**2 <= abs(number) <= _LARGEST**2:
            raise InputError(
                f"the known coefficient of {text!r} is {number:g}; use units in which it lies between "
                f"{1.0 / _LARGEST**2:g} and {_LARGEST**2:g}"
            )
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
        out[(library.terms if kind == "lagrangian" else library.dissipation)[position]] = number
    if out and all(value == 0.0 for value in out.values()):
        raise InputError("all known coefficients are zero; at least one must set the scale of L")
    return out


def _round_to_one_digit(value: float) -> float:
    return float(f"{value:.0e}")


def _about_angles(
    trajectories: Trajectories, angles: tuple[str, ...], computed: tuple[str, ...]
) -> tuple[list[Finding], dict[str, int]]:
    """Notes on unwrapped measured angles, and jumps of coordinates that may be wrapped angles."""
    notes = [
        find("angle-unwrapped", name, jumps=count)
        for name, count in trajectories.wraps_removed.items()
        if count and name in angles and name not in computed
    ]
    turning: dict[str, int] = {}
    for i, name in enumerate(trajectories.coordinates):
        if name in angles or not any(np.isfinite(t.q[1:, i]).any() for t in trajectories):
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
