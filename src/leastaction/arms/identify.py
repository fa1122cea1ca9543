"""identify(): parameters with standard errors, from a torque log and a kinematic tree.

The tree determines the form of the equations. Only the friction is selected.
1. A smoothing spline is fitted to the angles. Least squares along it, weighted by joint, select the friction
   of each joint, the distance over which it reverses, and start values.
2. Curve, parameters, noise and the equation error of each joint are fitted together
   (:mod:`leastaction.estimation.weights`).  Friction that is not significant is left out, and the others are
   fitted again. The friction of a joint that rests when a run begins is a column of its own.
3. Residuals of the torques are rarely white.  Standard errors are corrected for their correlation in time
   (Newey & West 1987, Econometrica 55:703).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from leastaction.arms.base import BaseParameters, find_base
from leastaction.arms.log import FitFacts, contact_notes, load_notes, prepared, scale_notes
from leastaction.arms.model import ArmModel
from leastaction.arms.regression import Choice, Regression
from leastaction.arms.signals import Recording, Signals, bounded_starts, predicted, starts
from leastaction.curve.bspline import SplineGrid, uniform_grid
from leastaction.curve.knots import lay_knots
from leastaction.curve.smoothing import Smooth, smooth
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import DataError, InputError
from leastaction.estimation.crew import Alone, Crew, employ
from leastaction.estimation.forces import GridForces, forces_along, forces_on
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.intervals import points_at
from leastaction.estimation.joint import Physics
from leastaction.estimation.observations import Observations
from leastaction.estimation.stretches import SharedObservations
from leastaction.estimation.weights import Start, fit_weights, start_weights
from leastaction.identifiers import quoted
from leastaction.library.tree import KinematicTree
from leastaction.mechanics.arm_columns import ArmColumns
from leastaction.mechanics.arm_terms import FRICTION, parameter_terms
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.threads import single_threaded

__all__ = ["identify"]

_DEGREE = 5
_CHUNK = 1024  # knot intervals handled at once
_ALWAYS = ("viscous", "dry")
_ASIDE = ("turn", "delay", "gain", "start")  # columns that are not parameters of the arm
_FALSE_ALARM = 0.01  # probability that an arm without friction keeps any
_MOST_KNOTS = 100.0  # a second; above 30 Hz, links bend and gears vibrate, which the model does not describe
_CALIBRATIONS = 5  # most corrections of delays and gains
_TORQUES = Recording()
_RESTS, _SPOILED = 0.02, 2.0  # of the rms velocity, below which a joint may rest; of errors of least squares
_QUIETER = 1.1  # factor by which doubling the knots must lower the noise of some joint


@dataclass(frozen=True, eq=False)
class _Laid:
    """A log on spline knots."""

    grid: SplineGrid
    smoothed: Smooth
    observations: SharedObservations
    forces: GridForces

    def under(self, data: Trajectories) -> _Laid:
        """The same motion under other torques."""
        forces = forces_on(self.grid, [t.t for t in data], [t.forces for t in data])
        assert forces is not None
        return replace(self, forces=forces)


@single_threaded()
def identify(
    trajectories: Trajectory | Trajectories | Iterable[Trajectory],
    tree: KinematicTree,
    *,
    friction: Sequence[str] = FRICTION,
    rotors: bool = True,
    offsets: bool = True,
    springs: bool = False,
    recording: Recording = _TORQUES,
    knots_per_second: float | None = None,
    workers: int | Any = None,
) -> ArmModel:
    """Find the inertial parameters and the friction of an arm.

    Parameters
    ----------
    trajectories : Trajectory, Trajectories or iterable of Trajectory
        Joint coordinates (rad, m) and, as forces, joint torques (N m, N). Names are those of the tree, in any
        order. Velocities serve to recover the clock of the robot; see `leastaction.arms.log`.
    tree : KinematicTree
    friction : sequence of str
        Kinds that may be selected: "viscous", "dry", "stribeck", "load", "quadratic" and "asymmetric".
    rotors, offsets, springs : bool
        Whether rotors, constant torques and springs may act in every joint. Rotors and offsets are kept even
        if they are not significant.
    recording : Recording
        Gains and delays of the recorded torques. By default the log holds torques, and delays are estimated
        if the joints agree that there are any.
    knots_per_second : float, optional
        Knots of the spline; by default determined from the data.
    workers : int or distributed.Client, optional
        Number of processes (default: 1), or a Dask client. Results agree to rounding.

    Returns
    -------
    ArmModel

    Raises
    ------
    InputError
        If names, torques or options do not agree with the tree.
    DataError
        If the log is too short, or the arm stands still.
    """
    for kind in friction:
        if kind not in FRICTION:
            raise InputError(f"friction holds {quoted(kind)}; expected {', '.join(FRICTION)}")
    data, notes = prepared(Trajectories.coerce(trajectories), tree, recording.places(tree))
    always = [kind for kind in _ALWAYS if kind in friction]
    fixed = [k for k, wanted in (("rotor", rotors), ("spring", springs), ("offset", offsets)) if wanted]
    kinds = fixed, always, [kind for kind in friction if kind not in _ALWAYS]
    with employ(workers, joins=True) as crew:
        laid = _lay(data, knots_per_second, crew or Alone())
        laid, choice, signals, changes = _calibrated(data, tree, recording, kinds, laid)
        begins, remains = starts(laid.grid, laid.smoothed.control_points, data, choice.friction)
        terms = (
            *parameter_terms(tree, fixed, choice.scales, signals.unmeasured),
            *choice.friction,
            *signals.terms(tree),
            *begins,
        )
        base = find_base(tree, terms, signals.unmeasured)
        extra = EulerLagrange(tree.extra, tree.coordinates)
        further = forces_along(extra, laid.grid, laid.smoothed.control_points, [t.t for t in data])
        history = np.concatenate([choice.history, changes, remains, further])
        members = [terms[k] for k in base.members]
        columns = ArmColumns(tree, members, choice.reference, signals.unmeasured, history)
        base, columns, fit = _fitted(laid, columns, base, choice)
        fit = _weighted(laid, columns, fit)
        scores, errors = laid.observations.scores(fit)
    notes += _doubts(laid, columns, fit, errors, choice, tuple(data.names))
    values, covariance = bounded_starts(columns.terms, fit.coefficients, _corrected(fit, scores, errors))
    fit = replace(fit, coefficients=values)
    signals = signals.found(columns.terms, values, covariance)
    notes += signals.notes(tree)
    base, coefficients, covariance = _turned(base, columns, fit, covariance)
    notes += load_notes(tree, base, coefficients, covariance)
    facts = FitFacts(
        tuple(data.names),
        tuple(fit.weights.position_std.tolist()),
        tuple((1.0 / fit.weights.physics).tolist()),
        laid.grid.n_intervals / laid.grid.duration,
        fit.status,
        tuple(notes),
        **signals.facts(tree),
    )
    return ArmModel(tree, base, coefficients, covariance, choice.reference, facts)


class _Calibrated(NamedTuple):
    """A log with torques on time and in N m, the selected friction, and columns of remaining errors."""

    laid: _Laid
    choice: Choice
    signals: Signals
    changes: np.ndarray


def _calibrated(
    data: Trajectories,
    tree: KinematicTree,
    recording: Recording,
    kinds: tuple[list[str], list[str], list[str]],
    laid: _Laid,
) -> _Calibrated:
    """Select friction, and shift and scale the torques, until both stay the same."""
    signals = Signals.of(tree, recording)

    def regress() -> Regression:
        corrected, points = signals.torques(data), laid.smoothed.control_points
        crew = laid.observations.crew
        forces, none = laid.forces.values, signals.unmeasured
        return Regression.of(tree, laid.grid, points, forces, corrected, kinds, none, crew)

    if signals.unknown:
        signals = signals.first_gains(regress())
        laid = laid.under(signals.torques(data))
    undecided = recording.delays is None
    for left in reversed(range(_CALIBRATIONS)):
        choice = regress().chosen(_FALSE_ALARM)
        changes = signals.changes(choice)
        steps, errors = signals.steps(choice, changes)
        if undecided and not signals.common(steps, errors):
            steps, signals = steps[len(steps) - len(signals.unknown) :], replace(signals, late=False)
        undecided = False
        if not (left and signals.far(steps, data.sampling_interval)):
            return _Calibrated(laid, choice, signals, changes)
        signals = signals.moved(steps, data.sampling_interval)
        laid = laid.under(signals.torques(data))
    raise AssertionError  # the last round returns


def _lay(data: Trajectories, knots_per_second: float | None, crew: Crew) -> _Laid:
    times, values = [t.t for t in data], [t.q for t in data]
    if knots_per_second is None:
        smoothed = _resolved(data, crew)
    else:
        smoothed = _smoothed(data, knots_per_second, crew)
    grid = smoothed.grid
    forces = forces_on(grid, times, [t.forces for t in data])
    assert forces is not None
    observations = SharedObservations(Observations(grid, times, values), crew)
    return _Laid(grid, smoothed, observations, forces)


def _resolved(data: Trajectories, crew: Crew) -> Smooth:
    """The smoothed log on knots that resolve reversals.

    Dry friction jumps at a reversal, and the acceleration changes within milliseconds. If knots are too
    coarse, the misfit counts as noise. The knots are doubled until the noise stops falling.
    """
    most = min(_MOST_KNOTS, 0.25 / data.sampling_interval)
    laid = lay_knots(data, _DEGREE, lambda knots: _smoothed(data, knots, crew))
    knots, smoothed = laid.per_second, laid.smooth
    if knots > most:
        knots, smoothed = most, _smoothed(data, most, crew)
    while knots < most:
        knots = min(2.0 * knots, most)
        finer = _smoothed(data, knots, crew)
        quieter = smoothed.noise_std / np.maximum(finer.noise_std, 1e-300)
        if quieter.max() < _QUIETER:
            break
        smoothed = finer
    return smoothed


def _smoothed(data: Trajectories, knots: float, crew: Crew) -> Smooth:
    """The smoothed log on some knots a second; workers share the joints."""
    times = [t.t for t in data]
    grid, shares = uniform_grid(times, knots, _DEGREE), np.array_split(np.arange(data.n_dof), crew.size)
    tasks = [crew.task(smooth, grid, times, [t.q[:, own] for t in data]) for own in shares if own.size]
    return Smooth.beside(crew.results(tasks))


def _fitted(
    laid: _Laid, columns: ArmColumns, base: BaseParameters, choice: Choice
) -> tuple[BaseParameters, ArmColumns, JointFit]:
    """The joint fit without friction that is not significant."""
    points = laid.smoothed.control_points
    start_values = np.array([choice.values.get(term.text, 0.0) for term in columns.terms])
    physics = Physics(columns, np.ones(len(columns), bool), laid.forces.values)
    weights = start_weights(laid.observations, physics, laid.smoothed.noise_std, points, start_values)
    start = Start(points, start_values, replace(weights, force_density=laid.forces.density))
    fit = fit_weights(laid.observations, physics, start)
    if not fit.usable:
        raise DataError(
            "the fit has no finite result; look for jumps and gaps in the log, and check its units"
        )
    kept = _significant(columns, fit, _corrected(fit, *laid.observations.scores(fit)))
    if len(kept) == len(columns):
        return base, columns, fit
    columns = columns.of([columns.terms[k] for k in kept])
    start = replace(Start.of(fit), coefficients=fit.coefficients[kept])
    physics = Physics(columns, np.ones(len(columns), bool), laid.forces.values)
    members = [base.members[k] for k in kept]
    return base.subset(members), columns, fit_weights(laid.observations, physics, start)


def _doubts(
    laid: _Laid,
    columns: ArmColumns,
    fit: JointFit,
    errors: np.ndarray,
    choice: Choice,
    names: tuple[str, ...],
) -> list[str]:
    """Notes on effects that the arm does not explain, from the mean errors of its equations.

    A strong contact may spoil the joint fit; least squares along the log then leaves much smaller errors.
    """
    others = (predicted(choice) - laid.forces.values).mean(axis=1)
    if np.any(errors.std(axis=0) > _SPOILED * others.std(axis=0)):
        errors = others
    left = _unexplained(laid, columns, fit, errors, choice)
    notes = contact_notes(columns.tree, laid.grid.points.mean(axis=1), laid.grid.owner, left, names)
    points = points_at(laid.grid, fit.control_points, slice(0, _CHUNK))
    torques = laid.forces.values[:_CHUNK].transpose(2, 1, 0).reshape(columns.n_dof, -1)
    return notes + scale_notes(columns.tree, points, torques)


def _unexplained(
    laid: _Laid, columns: ArmColumns, fit: JointFit, residuals: np.ndarray, choice: Choice
) -> np.ndarray:
    """Errors that are not those of a joint at rest, which friction of unknown size holds."""
    speed = np.abs(laid.grid.at_quadrature(fit.control_points, most=1)[1]).min(axis=1)
    rests = speed < _RESTS * np.sqrt(np.mean(speed**2, axis=0))
    dry = np.zeros(len(columns.tree))
    for term, value in zip(columns.terms, fit.coefficients.tolist(), strict=True):
        if term.kind == "dry":
            dry[term.place] = abs(value)
    most = 2.0 * dry * rests
    return (residuals - np.clip(residuals, -most, most)) * choice.regression.moved


def _weighted(laid: _Laid, columns: ArmColumns, fit: JointFit) -> JointFit:
    """The fit with equations weighted by their slow errors.

    Low frequencies determine the parameters. If the error of an equation is larger there than on average over
    the frequencies that the knots resolve, its weight falls by that ratio.
    """
    _, residuals = laid.observations.scores(fit)
    ratios = np.maximum([_slow_share(r) for r in residuals.T], 1.0)
    weights = replace(fit.weights, physics=fit.weights.physics / ratios)
    physics = Physics(columns, np.ones(len(columns), bool), laid.forces.values)
    again = fit_joint(laid.observations, physics, weights, fit.control_points, fit.coefficients)
    return again if again.usable else fit


def _slow_share(residual: np.ndarray) -> float:
    """Spectral density at frequency zero (Bartlett's window), divided by its mean."""
    length = _correlated(residual[:, None])
    sums = np.cumsum(np.concatenate([[0.0], residual]))
    windows = sums[length:] - sums[:-length]
    return float(np.mean(windows**2) / length / max(np.mean(residual**2), 1e-300))


def _turned(
    base: BaseParameters, columns: ArmColumns, fit: JointFit, covariance: np.ndarray
) -> tuple[BaseParameters, np.ndarray, np.ndarray]:
    """Correct distances and widths by the columns of their errors, and remove these columns."""
    shifts = {
        t.place: value for t, value in zip(columns.terms, fit.coefficients, strict=True) if t.kind == "turn"
    }
    kept = [k for k, term in enumerate(columns.terms) if term.kind not in _ASIDE]
    terms = list(base.terms)
    for k, number in enumerate(base.members):
        term = terms[number]
        if term.kind == "dry" and term.place in shifts:
            ratio = float(np.clip(shifts[term.place] / fit.coefficients[k], -0.5, 0.5))
            grown = "distance" if term.distance else "width"
            terms[number] = replace(term, **{grown: getattr(term, grown) * float(np.exp(ratio))})
    base = replace(base, terms=tuple(terms)).subset([base.members[k] for k in kept])
    return base, fit.coefficients[kept], covariance[np.ix_(kept, kept)]


def _significant(columns: ArmColumns, fit: JointFit, covariance: np.ndarray) -> list[int]:
    """Columns that stay. Friction is removed one term at a time, and the others are updated."""
    kinds = [term.kind for term in columns.terms]
    kept = list(range(len(columns)))
    values, spread = fit.coefficients.copy(), covariance.copy()
    cut = chi2.isf(_FALSE_ALARM / max(sum(kind in FRICTION for kind in kinds), 1), 1)
    while True:
        seen = [k for k in kept if kinds[k] in FRICTION]
        # a term that feeds energy in is not friction
        squares = [
            0.0 if values[k] < 0.0 and kinds[k] in ("viscous", "dry") else values[k] ** 2 / spread[k, k]
            for k in seen
        ]
        if not seen or min(squares) >= cut:
            return kept
        worst = seen[int(np.argmin(squares))]
        along = spread[:, worst] / spread[worst, worst]
        values -= along * values[worst]
        spread -= np.outer(along, spread[worst])
        kept.remove(worst)
        if kinds[worst] == "dry":  # remove what belongs to it as well
            place = columns.terms[worst].place
            own = ("turn", "start")
            kept = [k for k in kept if kinds[k] not in own or columns.terms[k].place != place]


def _corrected(fit: JointFit, scores: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """The covariance, corrected for the correlation of the residuals in time."""
    length = _correlated(residuals)
    sums = np.cumsum(
        np.vstack([np.zeros((length, scores.shape[1])), scores, np.zeros((length, scores.shape[1]))]), 0
    )
    windows = sums[length:] - sums[:-length]
    variance = windows.T @ windows / length
    sandwich = fit.covariance @ variance @ fit.covariance
    ratio = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(fit.covariance), 1.0))
    return ratio[:, None] * fit.covariance * ratio


def _correlated(residuals: np.ndarray) -> int:
    """Number of knot intervals over which residuals are correlated: Andrews' plug-in rule for one lag."""
    before, after = residuals[:-1], residuals[1:]
    each = np.sum(before * after, axis=0) / np.maximum(np.sum(before**2, axis=0), 1e-300)
    shared = min(max(float(each.sum()) / max(np.count_nonzero(each), 1), 0.0), 0.97)
    alpha = 4.0 * shared**2 / ((1.0 - shared) * (1.0 + shared)) ** 2
    length = 1.1447 * (alpha * len(residuals)) ** (1.0 / 3.0)
    return max(1, min(int(length), len(residuals) // 10))
