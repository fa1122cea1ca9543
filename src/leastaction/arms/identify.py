"""identify(): from a torque log and a kinematic tree to parameters with error bars.

The form of the equations is given by the tree, so that no search for it is needed; friction alone is chosen.

1. A smoothing spline through the angles, and least squares along it, weighted by joint: the friction of each
   joint, over which distance it turns after a reversal, and start values.
2. Curve, parameters, noise and the equation error of each joint are fitted together
   (:mod:`leastaction.estimation.weights`).  Friction that is not significant is left out, and the rest fitted
   again.
3. What is left of the torques is rarely white.  Standard errors are raised by the ratio that the correlation
   of the residuals asks for (Newey & West 1987, Econometrica 55:703).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from leastaction.arms.base import BaseParameters, find_base
from leastaction.arms.log import contact_notes, prepared, scale_notes
from leastaction.arms.model import ArmModel, FitFacts
from leastaction.arms.regression import Choice, Regression
from leastaction.arms.signals import Signals
from leastaction.curve.bspline import SplineGrid, uniform_grid
from leastaction.curve.knots import lay_knots
from leastaction.curve.smoothing import Smooth, smooth
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import DataError, InputError
from leastaction.estimation.blocks import observe
from leastaction.estimation.forces import GridForces, forces_on
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.intervals import points_at
from leastaction.estimation.joint import Physics
from leastaction.estimation.protocols import Measurements
from leastaction.estimation.weights import Start, fit_weights, start_weights
from leastaction.identifiers import quoted
from leastaction.library.tree import KinematicTree
from leastaction.mechanics.arm_columns import FRICTION, ArmColumns, ArmTerm, inertial_terms, joint_terms
from leastaction.threads import single_threaded

__all__ = ["identify"]

_DEGREE = 5
_CHUNK = 1024  # knot intervals handled at once
_ALWAYS = ("viscous", "dry")
_FALSE_ALARM = 0.01  # that any friction of an arm without it is kept
_MOST_KNOTS = 100.0  # a second: arms bend and gears vibrate above 30 Hz, which no rigid body follows
_HEARD = 5  # times that torques are shifted or scaled
_QUIETER = 1.1  # ratio by which twice the knots must lower the noise of some joint to be worth it


@dataclass(frozen=True, eq=False)
class _Laid:
    """A log on spline knots."""

    grid: SplineGrid
    smoothed: Smooth
    observations: Measurements
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
    delays: bool | None = None,
    gains: Mapping[str, float] | None = None,
    knots_per_second: float | None = None,
) -> ArmModel:
    """Find the inertial parameters and the friction of an arm.

    Parameters
    ----------
    trajectories : Trajectory, Trajectories or iterable of Trajectory
        Joint coordinates (rad, m) and, as forces, joint torques (N m, N); names as in the tree, in any
        sequence. Velocities are used to find the clock of the robot, see `leastaction.arms.log`.
    tree : KinematicTree
    friction : sequence of str
        Kinds that may be chosen, out of "viscous", "dry", "stribeck", "load", "quadratic" and "asymmetric".
    rotors, offsets, springs : bool
        Whether rotors, constant torques and springs may act in every joint. Rotors and offsets stay in
        whether significant or not.
    delays : bool, optional
        Whether the torques of each joint are recorded earlier or later than they act, by delays that are
        found. By default, if the joints agree in that.
    gains : mapping of str to float, optional
        The log holds currents, or torques in other units: known joint → torque per unit of the log. Gains of
        the other joints are found; one must be known. By default the log holds torques.
    knots_per_second : float, optional
        Of the spline; by default what the motion asks for.

    Returns
    -------
    ArmModel

    Raises
    ------
    InputError
        If names, torques or options do not fit the tree.
    DataError
        If the log cannot determine an arm: too short, or at standstill.
    """
    for kind in friction:
        if kind not in FRICTION:
            raise InputError(f"friction holds {quoted(kind)}; expected {', '.join(FRICTION)}")
    data, notes = prepared(Trajectories.coerce(trajectories), tree)
    always = [kind for kind in _ALWAYS if kind in friction]
    fixed = [k for k, wanted in (("rotor", rotors), ("spring", springs), ("offset", offsets)) if wanted]
    extra = [kind for kind in friction if kind not in _ALWAYS]
    signals = Signals.asked(tree, gains, late=delays is not False)
    heard = _heard(data, tree, signals, delays, (fixed, always, extra), knots_per_second)
    laid, choice = heard.laid, heard.choice
    terms = (*inertial_terms(tree), *joint_terms(tree, fixed, choice.scales), *choice.friction, *heard.terms)
    base = find_base(tree, terms)
    history = np.concatenate([choice.history, heard.columns])
    columns = ArmColumns(tree, [terms[k] for k in base.members], choice.reference, (), history)
    base, columns, fit = _fitted(laid, columns, base, choice)
    fit = _weighted(laid, columns, fit)
    notes += _doubts(laid, columns, fit, tuple(data.names))
    covariance = _corrected(laid, columns, fit)
    signals = heard.signals.found(columns.terms, fit.coefficients, covariance)
    notes += signals.notes(tree)
    base, coefficients, covariance = _turned(base, columns, fit, covariance)
    weights = fit.weights
    facts = FitFacts(
        tuple(data.names),
        tuple(weights.noise_std[: len(tree)].tolist()),
        tuple((1.0 / weights.physics).tolist()),
        laid.grid.n_intervals / laid.grid.duration,
        fit.status,
        tuple(notes),
        **signals.facts(),
    )
    return ArmModel(tree, base, coefficients, covariance, choice.reference, facts)


class _Heard(NamedTuple):
    """A log whose torques are on time and in N m, with the friction that was chosen."""

    laid: _Laid
    choice: Choice
    signals: Signals
    columns: np.ndarray
    terms: tuple[ArmTerm, ...]


def _heard(
    data: Trajectories,
    tree: KinematicTree,
    signals: Signals,
    delays: bool | None,
    kinds: tuple[list[str], list[str], list[str]],
    knots_per_second: float | None,
) -> _Heard:
    """Choose friction, and shift and scale the torques, until both stay."""
    laid = _lay(data, knots_per_second)

    def regress() -> Regression:
        heard, points = signals.torques(data), laid.smoothed.control_points
        return Regression.of(tree, laid.grid, points, laid.forces.values, heard, kinds)

    if signals.unknown:
        signals = signals.first_gains(regress())
        laid = laid.under(signals.torques(data))
    undecided = delays is None
    for _ in range(_HEARD):
        choice = regress().chosen(_FALSE_ALARM)
        columns = signals.columns(choice)
        steps, errors = signals.steps(choice, columns)
        if undecided and not signals.common(steps, errors):
            steps, signals = steps[len(tree) :], replace(signals, late=False)
        undecided = False
        if not signals.far(steps, data.sampling_interval):
            break
        signals = signals.moved(steps, data.sampling_interval)
        laid = laid.under(signals.torques(data))
    terms = tuple(ArmTerm(f"{kind}[{tree.coordinates[i]}]", kind, i) for i, kind in signals.open)
    return _Heard(laid, choice, signals, columns, terms)


def _lay(data: Trajectories, knots_per_second: float | None) -> _Laid:
    times, values = [t.t for t in data], [t.q for t in data]
    if knots_per_second is None:
        smoothed = _resolved(data)
    else:
        smoothed = smooth(uniform_grid(times, knots_per_second, _DEGREE), times, values)
    grid = smoothed.grid
    forces = forces_on(grid, times, [t.forces for t in data])
    assert forces is not None
    return _Laid(grid, smoothed, observe(grid, times, values), forces)


def _resolved(data: Trajectories) -> Smooth:
    """The smoothed log on knots that resolve what happens at reversals.

    Dry friction jumps there, and the curve bends within milliseconds. Where knots are too coarse for that,
    the misfit counts as noise: they are doubled until it falls no more.
    """
    times, values = [t.t for t in data], [t.q for t in data]
    most = min(_MOST_KNOTS, 0.25 / data.sampling_interval)
    knots = min(lay_knots(data, _DEGREE).per_second, most)
    smoothed = smooth(uniform_grid(times, knots, _DEGREE), times, values)
    while knots < most:
        knots = min(2.0 * knots, most)
        finer = smooth(uniform_grid(times, knots, _DEGREE), times, values)
        quieter = smoothed.noise_std / np.maximum(finer.noise_std, 1e-300)
        if quieter.max() < _QUIETER:
            break
        smoothed = finer
    return smoothed


def _fitted(
    laid: _Laid, columns: ArmColumns, base: BaseParameters, choice: Choice
) -> tuple[BaseParameters, ArmColumns, JointFit]:
    """The joint fit, without friction that is not significant."""
    points = laid.smoothed.control_points
    start_values = np.array([choice.values.get(term.text, 0.0) for term in columns.terms])
    physics = Physics(columns, np.ones(len(columns), bool), laid.forces.values)
    weights = start_weights(laid.observations, physics, laid.smoothed.noise_std, points, start_values)
    start = Start(points, start_values, replace(weights, force_density=laid.forces.density))
    fit = fit_weights(laid.observations, physics, start)
    if not fit.usable:
        raise DataError(
            "the fit has no finite result; look for jumps and gaps in the log, and compare its units"
        )
    kept = _significant(columns, fit, _corrected(laid, columns, fit))
    if len(kept) == len(columns):
        return base, columns, fit
    columns = columns.of([columns.terms[k] for k in kept])
    start = replace(Start.of(fit), coefficients=fit.coefficients[kept])
    physics = Physics(columns, np.ones(len(columns), bool), laid.forces.values)
    members = [base.members[k] for k in kept]
    return base.subset(members), columns, fit_weights(laid.observations, physics, start)


def _doubts(laid: _Laid, columns: ArmColumns, fit: JointFit, names: tuple[str, ...]) -> list[str]:
    """Notes on what the log may hold besides the arm."""
    residuals = np.concatenate([mean for _, mean in _scores(laid, columns, fit)])
    notes = contact_notes(columns.tree, laid.grid.points.mean(axis=1), laid.grid.owner, residuals, names)
    points = points_at(laid.grid, fit.control_points, slice(0, _CHUNK))
    torques = laid.forces.values[:_CHUNK].transpose(2, 1, 0).reshape(len(columns.tree), -1)
    return notes + scale_notes(columns.tree, points, torques)


def _weighted(laid: _Laid, columns: ArmColumns, fit: JointFit) -> JointFit:
    """The fit with equations weighted by their slow errors.

    Parameters show in slow motion. Where the error of an equation is larger there than on average over all
    frequencies that the knots resolve, its weight falls by that ratio.
    """
    _, residuals = (np.concatenate(part) for part in zip(*_scores(laid, columns, fit), strict=True))
    ratios = np.maximum([_slow_share(r) for r in residuals.T], 1.0)
    weights = replace(fit.weights, physics=fit.weights.physics / ratios)
    physics = Physics(columns, np.ones(len(columns), bool), laid.forces.values)
    again = fit_joint(laid.observations, physics, weights, fit.control_points, fit.coefficients)
    return again if again.usable else fit


def _slow_share(residual: np.ndarray) -> float:
    """Spectral density at frequency zero (Bartlett's window) over its mean."""
    length = _correlated(residual[:, None])
    sums = np.cumsum(np.concatenate([[0.0], residual]))
    windows = sums[length:] - sums[:-length]
    return float(np.mean(windows**2) / length / max(np.mean(residual**2), 1e-300))


def _turned(
    base: BaseParameters, columns: ArmColumns, fit: JointFit, covariance: np.ndarray
) -> tuple[BaseParameters, np.ndarray, np.ndarray]:
    """Without the columns that stand for errors of distances and widths, which are corrected by them."""
    shifts = {
        t.place: value for t, value in zip(columns.terms, fit.coefficients, strict=True) if t.kind == "turn"
    }
    kept = [k for k, term in enumerate(columns.terms) if term.kind not in ("turn", "delay", "gain")]
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
    """Columns that stay: friction goes, one by one, while the others take its part."""
    kinds = [term.kind for term in columns.terms]
    kept = list(range(len(columns)))
    values, spread = fit.coefficients.copy(), covariance.copy()
    cut = chi2.isf(_FALSE_ALARM / max(sum(kind in FRICTION for kind in kinds), 1), 1)
    while True:
        seen = [k for k in kept if kinds[k] in FRICTION]
        squares = [values[k] ** 2 / spread[k, k] for k in seen]
        # friction that feeds energy in is none, whatever its size
        squares = [
            0.0 if values[k] < 0.0 and kinds[k] in ("viscous", "dry") else square
            for k, square in zip(seen, squares, strict=True)
        ]
        if not seen or min(squares) >= cut:
            return kept
        worst = seen[int(np.argmin(squares))]
        along = spread[:, worst] / spread[worst, worst]
        values -= along * values[worst]
        spread -= np.outer(along, spread[worst])
        kept.remove(worst)
        if kinds[worst] == "dry":  # and the distance over which it turned
            place = columns.terms[worst].place
            kept = [k for k in kept if kinds[k] != "turn" or columns.terms[k].place != place]


def _corrected(laid: _Laid, columns: ArmColumns, fit: JointFit) -> np.ndarray:
    """The covariance, raised where residuals that are correlated in time ask for it."""
    scores, residuals = (np.concatenate(p) for p in zip(*_scores(laid, columns, fit), strict=True))
    length = _correlated(residuals)
    sums = np.cumsum(
        np.vstack([np.zeros((length, scores.shape[1])), scores, np.zeros((length, scores.shape[1]))]), 0
    )
    windows = sums[length:] - sums[:-length]
    variance = windows.T @ windows / length
    sandwich = fit.covariance @ variance @ fit.covariance
    ratio = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(fit.covariance), 1.0))
    return ratio[:, None] * fit.covariance * ratio


def _scores(laid: _Laid, columns: ArmColumns, fit: JointFit) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Each knot interval's part of the gradient in the coefficients, and its mean residual."""
    for chunk in laid.grid.chunks(_CHUNK):
        points = points_at(laid.grid, fit.control_points, chunk)
        strong = columns.strong(points)
        residual = np.tensordot(fit.coefficients, strong, 1)
        residual -= laid.forces.values[chunk].transpose(2, 1, 0).reshape(len(residual), -1)
        shares = laid.grid.weights[chunk].T.ravel()
        scaled = fit.weights.physics[:, None] * residual * shares
        each = np.einsum("kip,ip->kp", strong, scaled).reshape(len(columns), laid.grid.n_quadrature, -1)
        mean = residual.reshape(len(residual), laid.grid.n_quadrature, -1).mean(axis=1)
        yield each.sum(axis=1).T, mean.T


def _correlated(residuals: np.ndarray) -> int:
    """Knot intervals over which residuals are correlated: the plug-in rule of Andrews for one lag."""
    before, after = residuals[:-1], residuals[1:]
    each = np.sum(before * after, axis=0) / np.maximum(np.sum(before**2, axis=0), 1e-300)
    shared = min(max(float(each.sum()) / each.size, 0.0), 0.97)
    alpha = 4.0 * shared**2 / ((1.0 - shared) * (1.0 + shared)) ** 2
    length = 1.1447 * (alpha * len(residuals)) ** (1.0 / 3.0)
    return max(1, min(int(length), len(residuals) // 10))
