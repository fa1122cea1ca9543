"""Noise and equation error estimated by the marginal likelihood, the curve integrated out.

Given a support, the weights (σ, w) maximise (Laplace's approximation, up to a constant)

    −½ cost − Σ_i n_i log σ_i + rank (½ Σ_i log w_i + ⟨log |det M|⟩) − ½ log|H(σ, w)|.

Setting its derivatives to zero gives fixed-point updates (MacKay 1992, Neural Computation 4:415)

    w_i = (rank − γ_i) / ∫ r_i² dt,    γ_i = ∂ log|H| / ∂ log w_i,
    σ_c² = Σ (y_c − N_c P)² / (n_c − η_c),   η_c = ∂ log|H| / ∂ log σ_c⁻²,

the latter for every channel c: positions, and velocities and accelerations where they are measured.
The derivatives are traces, tr(H⁻¹ ∂H/∂ log w_i), taken exactly (:mod:`leastaction.estimation.elimination`).

An exact model lets w grow without bound; on real hardware, or with knots that are too coarse, it settles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leastaction.estimation.gauss_newton import JointFit, fit_joint, shared
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.protocols import Measurements, linearise
from leastaction.estimation.settings import ESTIMATION

__all__ = ["Start", "evidence", "fit_curve", "fit_weights", "start_weights"]

# below about the square root of the smallest number ∫ r² counts as zero: products of its reciprocal overflow
_NOTHING = 1e-150
_SHORTEST = 0.1  # of the changes of the weights, taken at once
_FARTHEST = np.log(30.0)  # that a weight goes where it turns back
_HALVINGS = 4  # of a step of the weights
_MOST_STEPS = 100  # a structure that needs more is not worth it


@dataclass(frozen=True, eq=False)
class Start:
    """Where a fit begins: curve, coefficients (known ones included), weights."""

    control_points: np.ndarray
    coefficients: np.ndarray
    weights: Weights

    @classmethod
    def of(cls, fit: JointFit) -> Start:
        return cls(fit.control_points, fit.coefficients, fit.weights)


def equation_rank(observations: Measurements) -> int:
    """Directions of one coordinate that its equation touches: all but initial position and rate.

    No more than there are points at which the equation is compared.
    """
    grid = observations.grid
    return min(grid.n_ctrl - 2 * len(grid.spaces), grid.n_intervals * grid.n_quadrature)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def evidence(observations: Measurements, fit: JointFit) -> float:
    """Log marginal likelihood of a fit, up to a constant that depends on the data and the knots only.

    −∞ when the mass matrix is not positive definite along most of the motion: such equations do not
    determine q̈, and the likelihood of the curve has no meaning.
    """
    at = fit.linearisation
    if at.regular < ESTIMATION.mostly_regular:
        return -np.inf
    weights = fit.weights
    value = -0.5 * at.misfit(weights) - float(observations.counts @ np.log(weights.noise_std))
    prior = equation_rank(observations) * (0.5 * float(np.log(weights.physics).sum()) + at.log_volume)
    unpushed = at.mean(weights.slack - weights.volume) * at.log_volume
    return value + prior - unpushed - 0.5 * fit.logdet


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def start_weights(
    observations: Measurements,
    physics: Physics,
    noise_std: np.ndarray,
    control_points: np.ndarray,
    coefficients: np.ndarray,
) -> Weights:
    """w_i = (number of samples) / ∫ r_i² dt at the start: data and physics cost alike.

    ``noise_std`` is that of the positions; what the start leaves of the other channels counts as their noise.
    An equation without any term has no error to weigh: it gets the smallest weight of the others.
    """
    at = linearise(observations, physics, control_points, coefficients)
    slack = np.full_like(noise_std, equation_rank(observations))
    slack[list(physics.columns.prescribed)] = 0.0
    n = observations.n_dof
    others = np.sqrt(at.squares[n:] / observations.counts[n:])
    noise_std = np.maximum(np.concatenate([noise_std, others]), observations.floors)
    linear = observations.coordinates.size  # channels behind these see several coordinates at once
    counts: np.ndarray = np.bincount(observations.coordinates, observations.counts[:linear])
    counts = counts + float(observations.counts[linear:].sum()) / n
    few = counts <= len(observations.grid.spaces)  # a hidden coordinate counts as any other
    counts = np.where(few, max(counts.max(), 1), counts)
    weighed = at.equation > _NOTHING
    ratio = counts / np.where(weighed, at.equation, 1.0)
    ratio[~weighed] = ratio[weighed].min() if weighed.any() else 1.0
    return Weights(noise_std, ratio, slack, calibration=observations.calibration)


def update_weights(observations: Measurements, fit: JointFit) -> Weights:
    """One fixed-point update of w (and σ), each w limited to a factor of 30, or 3 where it hardly matters.

    The weight of an equation that vanishes identically stays as it is.

    Raises
    ------
    numpy.linalg.LinAlgError
        When H is not positive definite, or not finite.
    """
    weights, at = fit.weights, fit.linearisation
    used, fitted = at.freedom(weights, fit.factor)
    n, rank = observations.n_dof, equation_rank(observations)
    new_physics, slack, new_noise = np.empty(n), np.empty(n), np.empty_like(weights.noise_std)
    for i in range(n):
        if at.equation[i] <= _NOTHING:
            slack[i], new_physics[i] = rank, weights.physics[i]
            continue
        slack[i] = max(rank - used[i], 1e-3)
        cost = max(at.equation[i] * weights.physics[i], 1e-300)
        # where hardly any equation error is left, its size is mostly rounding: do not fall for it
        left = max(slack[i], cost) > ESTIMATION.slack_left  # many samples may see an error without slack
        new_physics[i] = weights.physics[i] * np.clip(slack[i] / cost, 1 / 30 if left else 1 / 3, 30)
        if at.terms[i] > 0.0:
            # an error that small makes no difference, and steps towards none at all would end on the way
            # not while coefficients are held
            hardly = not left and fit.covariance.size > 0
            least = rank / (ESTIMATION.small_error**2 * at.terms[i]) if hardly else 0.0
            new_physics[i] = np.clip(new_physics[i], least, rank / (ESTIMATION.no_error**2 * at.terms[i]))
    for c in range(new_noise.size):
        estimate = np.sqrt(at.squares[c] / max(observations.counts[c] - fitted[c], 1.0))
        new_noise[c] = max(estimate, observations.floors[c])
    slack[list(at.prescribed)] = 0.0
    if not (np.isfinite(new_physics).all() and np.isfinite(new_noise).all()):
        raise np.linalg.LinAlgError("the weights are not finite")
    return replace(weights, noise_std=new_noise, physics=new_physics, slack=slack)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def fit_weights(
    observations: Measurements,
    physics: Physics,
    start: Start,
    *,
    max_rounds: int = 25,
) -> JointFit:
    """Fit curve, coefficients and weights together.

    Stops when the coefficients move by less than a twentieth of a standard error, and the evidence by
    less than a half, from one round to the next; of more than 100,000 samples by a half for so many.
    """
    best = fit_joint(observations, physics, start.weights, start.control_points, start.coefficients)
    best_evidence = evidence(observations, best)
    steps, stride = best.n_steps, 1.0
    taken = before = np.zeros(0)
    tolerance = ESTIMATION.evidence_settled * shared(observations)
    for _ in range(max_rounds):
        if not best.converged or steps > _MOST_STEPS:
            break
        try:
            update = update_weights(observations, best)
        except np.linalg.LinAlgError:  # at the limit of rounding H is not positive definite for other weights
            break
        change = _change(best.weights, update)
        if taken.size and float(taken @ change) < 0.0:
            update = _part_of_the_way(best.weights, update, min(1.0, _FARTHEST / np.abs(change).max()))
            change = _change(best.weights, update)
            stride = _secant(taken, before, change)
        else:  # what turns back has gone far enough
            update = _accelerate(best.weights, update)
        before = change
        for _ in range(_HALVINGS):
            weights = _part_of_the_way(best.weights, update, stride)
            fit = fit_joint(
                observations,
                physics,
                weights,
                best.control_points,
                best.coefficients,
                linearisation=best.linearisation,
            )
            steps += fit.n_steps
            value = evidence(observations, fit)
            if np.isfinite(value) and value >= best_evidence - tolerance:
                break
            # equations compete for the same error and take it from each other in turn
            stride *= 0.5
        else:
            break
        spread = np.sqrt(np.clip(np.diag(fit.covariance), 1e-300, None))
        moved = np.abs(fit.coefficients - best.coefficients)[physics.free] / spread
        settled = np.all(moved < ESTIMATION.weights_settled) and value - best_evidence < tolerance
        taken = _change(best.weights, fit.weights)
        best, best_evidence = fit, value
        if settled:
            break
    return best


def _change(old: Weights, new: Weights) -> np.ndarray:
    """By how much the logarithms of all weights change."""
    pairs = ((old.physics, new.physics), (old.noise_std, new.noise_std))
    return np.concatenate([np.log(b / a) for a, b in pairs])


def _secant(taken: np.ndarray, before: np.ndarray, change: np.ndarray) -> float:
    """The share of the changes that meets the fixed point, where a step turned them round.

    Equations that compete for one error take it from each other in turn, round after round.  Along the step,
    changes fall in proportion to it: from ``before`` to ``change``, and to none at the fixed point.
    """
    along = float(taken @ taken) / float(taken @ (before - change))
    return float(np.clip(along, _SHORTEST, 1.0))


def _part_of_the_way(old: Weights, new: Weights, share: float) -> Weights:
    """Between old and new weights, by their logarithms."""
    noise_std = old.noise_std * (new.noise_std / old.noise_std) ** share
    return replace(new, noise_std=noise_std, physics=old.physics * (new.physics / old.physics) ** share)


def _accelerate(old: Weights, new: Weights) -> Weights:
    """Square the growth of w while it is large: the plain fixed point needs many rounds for that."""
    ratio = new.physics / old.physics
    return replace(new, physics=new.physics * np.where(ratio > 1.5, np.minimum(ratio, 10.0), 1.0))


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def fit_curve(observations: Measurements, physics: Physics, start: Start) -> tuple[Start, float]:
    """Fit the curve alone, coefficients held, and update the weights once.

    Returns the new start and the evidence at the old weights; −inf when the fit failed.
    """
    held = Physics(physics.columns, np.zeros_like(physics.free), physics.forces)
    fit = fit_joint(
        observations, held, start.weights, start.control_points, start.coefficients, tolerance=1.0
    )
    if not fit.converged:
        return start, -np.inf
    try:
        weights = update_weights(observations, fit)
    except np.linalg.LinAlgError:
        return start, -np.inf
    return Start(fit.control_points, fit.coefficients, weights), evidence(observations, fit)
