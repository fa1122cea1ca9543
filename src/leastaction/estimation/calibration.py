"""Curves and calibration numbers that fit the measured columns, without a law of motion.

The model of the motion is q̈ = w with white noise w, so that the curve is a smoothing spline. Its smoothness
follows from the likelihood. If there are more columns than coordinates, they determine most calibration
numbers κ. Undetermined ones, such as the angle between a camera and the vertical, keep their start value
until the law of motion determines them.

Each draw of κ gives coordinates sample by sample, from which the joint fit of curve and κ starts. A number
that is added to a column starts at the mean of the column. A factor of a function of the coordinates starts
near the spread of the column, any other number near 0. Starts and ranges of the user take precedence.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy as sp

from leastaction.curve.bspline import SplineGrid, uniform_grid
from leastaction.curve.knots import FEWEST_SAMPLES, lay_knots
from leastaction.curve.outliers import leave_out_outliers
from leastaction.curve.smoothing import smooth
from leastaction.data.coerce import arranged
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import DataError, InputError
from leastaction.estimation.by_sample import by_sample, directions, misfit, newton_step
from leastaction.estimation.gauss_newton import JointFit
from leastaction.estimation.joint import Physics
from leastaction.estimation.sensors import SensorFunctions, SensorObservations, Sensors
from leastaction.estimation.shape_ranges import check_numbers
from leastaction.estimation.weights import Start, evidence, fit_weights, start_weights
from leastaction.findings import Finding
from leastaction.identifiers import check_coordinate_names, measured_columns, quoted
from leastaction.library import Library, make_term, shape_symbol
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["Calibrated", "calibrate", "from_columns", "plausible_sizes"]

_DRAWS = 16  # of calibration numbers without a start value from the user
_KEPT = 4  # draws for which a curve is fitted
_SAMPLES = 600  # of each column, for these fits
_SCREENED = 60  # of each column, for the comparison of all draws
_SPREAD = 0.5  # standard deviation of the logarithm of drawn factors
_OTHERS = 0.5  # standard deviation of other drawn numbers


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Coordinates and calibration that follow from the columns alone.

    Attributes
    ----------
    trajectories : Trajectories
        Coordinates computed from the columns, sample by sample, with the noise of the columns.
    sensors : Sensors
        With start values of the calibration numbers.
    findings : tuple of Finding
    """

    trajectories: Trajectories
    sensors: Sensors
    findings: tuple[Finding, ...]

    @property
    def computed(self) -> tuple[str, ...]:
        """Coordinates that have no samples of their own."""
        seen = np.isfinite(np.concatenate(self.sensors.direct))
        return tuple(n for i, n in enumerate(self.trajectories.coordinates) if not seen[:, i].any())


def from_columns(
    table: Trajectories,
    measure: Iterable[str],
    library: Library | Iterable[str],
    hidden: Iterable[str],
    angles: Iterable[str] | None,
    degree: int,
    shapes: Mapping[str, tuple[float, float]],
    robust: bool,
) -> Calibrated:
    """Coordinates from a table of measured columns, in the sequence of the library if it gives one.

    The parameters are those of `leastaction.discover`. Columns on the left of ``measure`` are not
    coordinates; ``hidden`` names coordinates without a column if the library does not.

    Raises
    ------
    InputError, DataError
    """
    texts = [measure] if isinstance(measure, str) else list(measure)
    columns = measured_columns(texts)
    if isinstance(library, Library):
        names, taken = library.coordinates, tuple(library.shapes)
        turning = library.angles if angles is None else tuple(angles)
    else:
        names, taken = dict.fromkeys(n for n in (*table.coordinates, *hidden) if n not in columns), ()
        turning = () if angles is None else tuple(angles)
    functions = SensorFunctions.parse(texts, check_coordinate_names(names))
    unknown = [name for name in table.coordinates if name not in (*columns, *names)]
    if unknown:
        raise InputError(
            f"the data have a column {quoted(unknown[0])} that is neither a coordinate of the library nor "
            "measured by a function; leave it out"
        )
    for name in functions.names:
        if name in taken:
            raise InputError(f"{{{name}}} occurs in a candidate and in a measurement function; rename one")
    ranges = {name: ends for name, ends in shapes.items() if name in functions.names}
    check_numbers(functions.starts, ranges)
    return calibrate(table, functions, turning, degree, ranges, robust=robust)


def calibrate(
    table: Trajectories,
    functions: SensorFunctions,
    angles: Sequence[str],
    degree: int,
    ranges: Mapping[str, tuple[float, float]],
    *,
    robust: bool = True,
) -> Calibrated:
    """Find the curve and the calibration numbers that fit the columns.

    Parameters
    ----------
    table : Trajectories
        The columns, and coordinates that are measured directly.
    functions : SensorFunctions
    angles : sequence of str
        Coordinates that are angles.
    degree : int
        Degree of the splines.
    ranges : mapping of str to (float, float)
        Ranges of calibration numbers, from the user.
    robust : bool
        Whether to leave out outliers of the columns.

    Raises
    ------
    InputError, DataError
    """
    findings: list[Finding] = []
    columns = _columns(table, functions)
    if robust:
        columns, findings = leave_out_outliers(columns, degree)
    knots = lay_knots(columns, degree)
    own = arranged(table, functions.coordinates)
    noise = _at_least(knots.smooth.noise_std, columns)
    samples, direct, numbers = [t.q for t in columns], [t.q for t in own], np.zeros(len(functions.names))
    sensors = Sensors(functions, samples, direct, noise, _noise_of(own, degree), numbers, ranges)
    _check_observed(functions, own)
    hunt = _Hunt(
        own, _centred(sensors), np.isin(functions.coordinates, list(angles)), knots.per_second, degree
    )
    draws = _draws(sensors, np.random.default_rng(0))
    _check_defined(hunt, draws)
    if len(draws) > 1:
        short = hunt.shortened()
        fits = [short.fitted(numbers, 4) for numbers in sorted(draws, key=short.misfit_of)[:_KEPT]]
        draws = [np.asarray(max(fits, key=lambda fit: fit[1])[0].weights.calibration)]
    fit, _ = hunt.fitted(draws[0])
    return Calibrated(hunt.sighted(fit), sensors.at(np.asarray(fit.weights.calibration)), tuple(findings))


def _at_least(noise: np.ndarray, samples: Trajectories) -> np.ndarray:
    """Noise that does not vanish for samples without any."""
    return np.maximum(noise, 1e-6 * np.nanstd(np.concatenate([t.q for t in samples]), axis=0))


def _noise_of(own: Trajectories, degree: int) -> np.ndarray:
    """(n_dof,) noise of the samples of coordinates, in their units; one where there are none."""
    out = np.ones(len(own.coordinates))
    counts = np.isfinite(np.concatenate([t.q for t in own])).sum(axis=0)
    seen = np.flatnonzero(counts >= FEWEST_SAMPLES)
    if seen.size:
        some = arranged(own.without_rates(), [own.coordinates[i] for i in seen])
        noise = _at_least(lay_knots(some, degree).smooth.noise_std, some)
        out[seen] = np.where(noise > 0.0, noise, 1.0)
    return out


def _columns(table: Trajectories, functions: SensorFunctions) -> Trajectories:
    """The measured columns; refuses unknown names, and columns with too few samples."""
    for name in functions.columns:
        if name not in table.coordinates:
            raise InputError(
                f"measure names {quoted(name)}, which is not a column of the data; the columns are "
                f"{', '.join(table.coordinates)}"
            )
    columns = arranged(table.without_rates(), functions.columns)
    columns = Trajectories([t.changed(forces=None) for t in columns])
    for i, name in enumerate(functions.columns):
        count = sum(int(np.isfinite(t.q[:, i]).sum()) for t in columns)
        if count < FEWEST_SAMPLES:
            raise DataError(
                f"column {quoted(name)} has {count} samples; at least {FEWEST_SAMPLES} are needed"
            )
        values = np.concatenate([t.q[:, i] for t in columns])
        if np.nanmax(values) == np.nanmin(values):
            raise DataError(
                f"column {quoted(name)} is {np.nanmax(values):g} in all samples, so that it shows nothing of "
                "the motion; leave out the column and its measurement function"
            )
    return columns


def _check_observed(functions: SensorFunctions, own: Trajectories) -> None:
    """Refuse coordinates without samples that no measurement function contains."""
    used = {symbol.name for expr in functions.expressions for symbol in expr.free_symbols}
    for i, name in enumerate(functions.coordinates):
        seen = any(np.isfinite(t.q[:, i]).any() for t in own)
        if not seen and not used & {name, f"{name}_dot", f"{name}_ddot"}:
            raise InputError(
                f"{quoted(name)} has no samples and occurs in no measurement function; add a column that "
                "depends on it, or leave it out of the library"
            )


def _check_defined(hunt: _Hunt, draws: Sequence[np.ndarray]) -> None:
    """Refuse measurement functions that have a value nowhere, whatever the start values."""
    names = set(hunt.sensors.functions.columns)
    for numbers in draws:
        if not (names := names & hunt.undefined(numbers)):
            return
    raise InputError(
        f"the measurement function of {quoted(min(names))} has no finite value at any sample, with any start "
        "value tried; check its roots, logarithms and divisions, or give other start values, such as {s=800}"
    )


def _draws(sensors: Sensors, rng: np.random.Generator) -> list[np.ndarray]:
    """Start values of the calibration numbers; a single set if the user gave all of them."""
    functions, ranges = sensors.functions, sensors.ranges
    stacked = np.concatenate(sensors.samples)
    mean, spread = np.nanmean(stacked, axis=0), np.nanstd(stacked, axis=0)
    open_numbers = [name for name in functions.names if name not in functions.starts]
    out: list[np.ndarray] = []
    for _ in range(_DRAWS if open_numbers else 1):
        values: list[float] = []
        for name in functions.names:
            if name in functions.starts:
                values.append(functions.starts[name])
                continue
            if name in ranges:
                values.append(rng.uniform(*ranges[name]))
                continue
            kind, column, shared = _kind(functions, name)
            if kind == "offset":
                values.append(float(mean[column]))
            elif kind == "factor" and functions.degrees[column] and not sensors.seen.all():
                values.append(1.0)
            elif kind == "factor":
                size = float(np.sqrt(2.0) * spread[column]) ** (1.0 / shared)
                values.append(size * float(np.exp(_SPREAD * rng.standard_normal())))
            else:
                values.append(_OTHERS * rng.standard_normal())
        out.append(np.array(values))
    return out


def plausible_sizes(sensors: Sensors) -> np.ndarray:
    """(n_numbers,) plausible error of each start value, without a law of motion."""
    functions, ranges = sensors.functions, sensors.ranges
    out: list[float] = []
    spread = np.nanstd(np.concatenate(sensors.samples), axis=0)
    for name, value in zip(functions.names, sensors.numbers.tolist(), strict=True):
        kind, column, _ = _kind(functions, name)
        if name in ranges:
            out.append(0.5 * (ranges[name][1] - ranges[name][0]))
        elif name in functions.starts:
            out.append(0.1 * abs(functions.starts[name]) or _OTHERS)
        else:
            out.append({"offset": float(spread[column]), "factor": _SPREAD * abs(value)}.get(kind, _OTHERS))
    return np.array(out)


def _kind(functions: SensorFunctions, name: str) -> tuple[str, int, int]:
    """Role of a number, the column in which it enters most simply, and the number of factors there.

    Numbers with start values have these: a place in a picture is an offset where the lens bends nothing.
    """
    symbol = shape_symbol(name)
    given = {shape_symbol(n): value for n, value in functions.starts.items() if n != name}
    found: list[tuple[str, int, int]] = []
    for c, expr in enumerate(functions.expressions):
        slope = sp.diff(expr.subs(given), symbol)
        if slope == 0:
            continue
        states = {s for s in slope.free_symbols if not s.name.startswith("{")}
        if symbol in slope.free_symbols:
            found.append(("other", c, 1))
        else:
            others = [s for s in slope.free_symbols if s not in states and slope.subs(s, 0) == 0]
            found.append(("factor" if states else "offset", c, 1 + len(others)))
    order = {"offset": 0, "factor": 1, "other": 2}
    return min(found, key=lambda one: order[one[0]])


@dataclass(frozen=True, eq=False)
class _Hunt:
    """Data, sensors, and the grid on which curves are fitted."""

    own: Trajectories
    sensors: Sensors
    angular: np.ndarray
    per_second: float
    degree: int

    def shortened(self) -> _Hunt:
        """The same for the first part of every recording."""
        most = max(FEWEST_SAMPLES, _SAMPLES // len(self.own))
        items = [t.rows(slice(0, min(most, t.n_times))) for t in self.own]
        samples = [values[:most] for values in self.sensors.samples]
        sensors = replace(self.sensors, samples=samples, direct=[t.q for t in items])
        return replace(self, own=Trajectories(items), sensors=sensors)

    def misfit_of(self, numbers: np.ndarray) -> float:
        """Misfit of some samples with separate coordinates, in logarithms to bound outliers."""
        total = 0.0
        thin, times = self._thinned()
        for k, t in enumerate(times):
            q = by_sample(thin, k, t, numbers, self.angular)
            total += float(np.log1p(misfit(thin, k, q, t, numbers)).sum())
        return total

    def undefined(self, numbers: np.ndarray) -> set[str]:
        """Columns whose functions of the coordinates alone are finite at none of some samples."""
        thin, times = self._thinned()
        functions, seen = self.sensors.functions, np.array(self.sensors.functions.degrees) > 0
        for k, t in enumerate(times):
            q = np.nan_to_num(by_sample(thin, k, t, numbers, self.angular))  # one column may spoil it
            seen |= np.isfinite(functions.values(np.stack([q, 0.0 * q, 0.0 * q]), t, numbers)).any(axis=1)
        return {name for name, found in zip(functions.columns, seen, strict=True) if not found}

    def _thinned(self) -> tuple[Sensors, list[np.ndarray]]:
        """The sensors at a share of the samples, and the times of these in each trial."""
        stride = max(1, sum(t.n_times for t in self.own) // _SCREENED)
        thin = replace(
            self.sensors,
            samples=[values[::stride] for values in self.sensors.samples],
            direct=[values[::stride] for values in self.sensors.direct],
        )
        return thin, [run.t[::stride] for run in self.own]

    def fitted(self, numbers: np.ndarray, rounds: int = 8) -> tuple[JointFit, float]:
        """Curve and κ from given numbers, and their evidence."""
        times = [t.t for t in self.own]
        grid = self._grid(times)
        observations = SensorObservations(grid, times, self.sensors.at(numbers), self.own.rates)
        names = self.own.coordinates
        masses = EulerLagrange([make_term(f"{n}_dot**2/2", [f"{n}_dot"]) for n in names], names)
        physics = Physics(masses, np.zeros(len(names), dtype=bool), None)
        q = [by_sample(self.sensors, k, t, numbers, self.angular) for k, t in enumerate(times)]
        there = Trajectories([t.changed(q=values) for t, values in zip(self.own, q, strict=True)])
        observations = observations.along(self._determined(self.sensors.at(numbers), there))
        curve, ones = smooth(grid, times, q).control_points, np.ones(len(names))
        weights = start_weights(observations, physics, ones, curve, ones)
        noise = weights.noise_std.copy()
        noise[noise.size - self.sensors.noise_std.size :] = self.sensors.noise_std
        weights = replace(weights, noise_std=noise)
        fit = fit_weights(observations, physics, Start(curve, ones, weights), max_rounds=rounds)
        return fit, evidence(observations, fit)

    def _grid(self, times: list[np.ndarray]) -> SplineGrid:
        return uniform_grid(times, self.per_second, self.degree, 2)

    def _determined(self, sensors: Sensors, there: Trajectories) -> np.ndarray:
        """(n_numbers, n_directions) changes of κ that the columns determine without a law of motion."""
        free, fixed = directions(sensors, there)
        scale_open = not replace(sensors, direct=[t.q for t in self.own]).seen.all()
        kinds = [_kind(sensors.functions, name)[0] for name in sensors.functions.names]
        moving = ~np.any(np.concatenate([free, fixed], axis=1), axis=1)
        if scale_open:  # a gain and the size of the motion are not identifiable
            moving &= np.array(kinds) == "offset"
        return np.concatenate([fixed, np.eye(moving.size)[:, moving]], axis=1)

    def sighted(self, fit: JointFit) -> Trajectories:
        """The curve at the samples, moved by one step towards the columns: coordinates with noise."""
        numbers, times = np.asarray(fit.weights.calibration), [t.t for t in self.own]
        grid = self._grid(times)
        parts = [grid.evaluate(fit.control_points, times, nu) for nu in range(3)]
        items: list[Trajectory] = []
        sensors = replace(self.sensors, direct=[t.q for t in self.own])
        for k, run in enumerate(self.own):
            states = np.stack([part[k] for part in parts])
            step = newton_step(sensors, k, states, run.t, numbers, 1e-6)
            items.append(run.changed(q=states[0] + step))
        return Trajectories(items)


def _centred(sensors: Sensors) -> Sensors:
    """The sensors with pseudo-samples at zero for each coordinate that enters only by its rates.

    They determine the mean of the coordinate. Their noise is estimated and equals its spread.
    """
    unseen = ~sensors.seen
    return replace(sensors, direct=[np.where(unseen, 0.0, values) for values in sensors.direct])
