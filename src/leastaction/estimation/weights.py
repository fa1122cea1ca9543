"""Noise and equation error estimated by the marginal likelihood, with the curve integrated out.

For a given structure, the weights (σ, w) maximise (Laplace's approximation, up to a constant)

    −½ cost − Σ_i n_i log σ_i + rank (½ Σ_i log w_i + ⟨log |det M|⟩) − ½ log|H(σ, w)|.

Setting its derivatives to zero gives fixed-point updates (MacKay 1992, Neural Computation 4:415)

    w_i = (rank − γ_i) / ∫ r_i² dt,    γ_i = ∂ log|H| / ∂ log w_i,
    σ_c² = Σ (y_c − N_c P)² / (n_c − η_c),   η_c = ∂ log|H| / ∂ log σ_c⁻²,

the latter for every channel c: positions, and measured velocities and accelerations.  The derivatives are
traces, tr(H⁻¹ ∂H/∂ log w_i), computed exactly (:mod:`leastaction.estimation.elimination`).

For an exact model, w grows without bound. On real hardware, or with knots that are too coarse, it converges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leastaction.estimation.gauss_newton import JointFit, fit_joint, shared, symmetric_inverse
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.protocols import Measurements, linearise
from leastaction.estimation.settings import ESTIMATION

__all__ = ["Start", "evidence", "fit_curve", "fit_weights", "start_weights"]

# of ∫ r²: smaller values count as zero, because products of their reciprocals overflow
_NOTHING = 1e-150
_FARTHEST = np.log(30.0)  # largest change of log w in an update, and after a reversal
_FARTHEST_DOWN = np.log(3.0)  # of a nearly exact equation
_HALVINGS = 4  # of a step of the weights
_SHORTEST = 0.1  # smallest share of a change of the weights in one step
_MOST_STEPS = 100  # limit for a structure
_REFUSED = 0.1  # decrease of χ² promised by a rejected step, above which a settled fit goes on


@dataclass(frozen=True, eq=False)
class Start:
    """Start values of a fit: curve, coefficients (known ones included), weights."""

    control_points: np.ndarray
    coefficients: np.ndarray
    weights: Weights

    @classmethod
    def of(cls, fit: JointFit) -> Start:
        return cls(fit.control_points, fit.coefficients, fit.weights)


def equation_rank(observations: Measurements) -> int:
    """Directions of one coordinate that its equation constrains: all but initial position and rate.

    At most the number of quadrature points.
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

    ``noise_std`` is the noise of the positions. The residual of the start serves as the noise of other
    channels. An equation without any term has no error; it gets the smallest weight of the others.
    """
    at = linearise(observations, physics, control_points, coefficients)
    slack = np.full_like(noise_std, equation_rank(observations))
    slack[list(physics.columns.prescribed)] = 0.0
    n = observations.n_dof
    others = np.sqrt(at.squares[n:] / observations.counts[n:])
    noise_std = np.maximum(np.concatenate([noise_std, others]), observations.floors)
    linear = observations.coordinates.size  # later channels depend on several coordinates
    counts: np.ndarray = np.bincount(observations.coordinates, observations.counts[:linear])
    counts = counts + float(observations.counts[linear:].sum()) / n
    few = counts <= len(observations.grid.spaces)  # a hidden coordinate counts as any other
    counts = np.where(few, max(counts.max(), 1), counts)
    weighed = at.equation > _NOTHING
    ratio = counts / np.where(weighed, at.equation, 1.0)
    ratio[~weighed] = ratio[weighed].min() if weighed.any() else 1.0
    return Weights(noise_std, ratio, slack, calibration=observations.calibration)


def update_weights(observations: Measurements, fit: JointFit) -> Weights:
    """One fixed-point update of w (and σ), each w limited to a factor of 30.

    A nearly exact equation loses a factor of 3 at most, because the size of its error is mostly rounding. The
    weight of an equation that vanishes identically does not change.

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
        left = max(slack[i], cost) > ESTIMATION.slack_left  # many samples may show an error without slack
        ratio = (rank - used[i]) / cost  # negative where an equation uses more directions than its rank
        change = np.log(ratio) if ratio > 1.0 else ratio - 1.0
        change = np.clip(change, -_FARTHEST if left else -_FARTHEST_DOWN, _FARTHEST)
        new_physics[i] = weights.physics[i] * np.exp(change)
        if at.terms[i] > 0.0:
            # an error this small has no effect, and steps towards zero would be cut off by the step limit
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

    Stops when, from one round to the next, the coefficients move by less than a twentieth of a standard
    error, the degrees of freedom of the equation error by less than a twentieth, and the evidence by less
    than a half. If a rejected step still promised a likelier law, the fit goes on along the valley of the
    cost that it points to. Above 100,000 samples these limits grow in proportion to their number, and that
    of the coefficients, whose standard errors become smaller, with its square root. A round is then omitted
    if its effect is predicted to be below them, because each of its steps is a pass over the recording.
    """
    best = fit_joint(observations, physics, start.weights, start.control_points, start.coefficients)
    best_evidence = evidence(observations, best)
    steps, stride = best.n_steps, 1.0
    taken = before = np.zeros(0)
    share = shared(observations)
    tolerance = ESTIMATION.evidence_settled * share
    for _ in range(max_rounds):
        if not best.converged or steps > _MOST_STEPS:
            break
        try:
            update = update_weights(observations, best)
        except np.linalg.LinAlgError:  # near the limit of rounding, H may not be positive definite for others
            break
        change = _change(best.weights, update)
        if _is_idle(observations, physics, best, update):
            break
        if taken.size and float(taken @ change) < 0.0:
            update = _part_of_the_way(best.weights, update, min(1.0, _FARTHEST / np.abs(change).max()))
            change = _change(best.weights, update)
            stride = _secant(taken, before, change)
        else:  # a reversal needs no further acceleration
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
            stride *= 0.5  # two equations compete for the same error, and the weights oscillate
        else:
            break
        step = (fit.coefficients - best.coefficients)[physics.free]
        settled = _hardly_moves(step, fit.covariance, share)
        settled = settled and value - best_evidence < tolerance
        settled = settled and _have_settled(weights.slack, best.weights.slack, share)
        taken = _change(best.weights, fit.weights)
        best, best_evidence = fit, value
        if settled:
            if best.refused <= _REFUSED * share:
                break
            fit = _along_valley(observations, physics, best)
            value = evidence(observations, fit)
            if not value > best_evidence + 0.5 * _REFUSED * share:
                break
            steps, best, best_evidence = steps + fit.n_steps, fit, value
    return best


def _along_valley(observations: Measurements, physics: Physics, fit: JointFit) -> JointFit:
    """Go on where damped steps stand still although the undamped one promises a decrease of the cost."""
    start = fit.control_points, fit.coefficients
    return fit_joint(
        observations, physics, fit.weights, *start, linearisation=fit.linearisation, in_valley=True
    )


def _is_idle(observations: Measurements, physics: Physics, fit: JointFit, update: Weights) -> bool:
    """Whether an update would change evidence and coefficients by less than the limits of `fit_weights`.

    Half the slope of the evidence times the step is what a step to its maximum gains. On short recordings,
    rounds cost little and are not predicted.
    """
    share, n = shared(observations), fit.weights.physics.size
    if share <= 1.0:
        return False
    change = _change(fit.weights, update)
    slopes = 0.5 * (update.slack - fit.weights.physics * fit.linearisation.equation)
    gain = 0.5 * float(slopes @ change[:n]) + float(observations.counts @ change[n:] ** 2)
    settled = abs(gain) < ESTIMATION.evidence_settled * share
    settled = settled and _have_settled(update.slack, fit.weights.slack, share)
    if not settled or not physics.n_free:
        return settled
    try:
        quadratic = fit.linearisation.normal(update).eliminate()
        step = -symmetric_inverse(quadratic.matrix) @ quadratic.gradient
    except np.linalg.LinAlgError:
        return False
    return _hardly_moves(step[: physics.n_free], fit.covariance, share)


def _hardly_moves(step: np.ndarray, covariance: np.ndarray, share: float) -> bool:
    """Whether a step of the coefficients is small beside their standard errors."""
    spread = np.sqrt(np.clip(np.diag(covariance), 1e-300, None))
    return bool(np.all(np.abs(step) / spread < ESTIMATION.weights_settled * np.sqrt(share)))


def _change(old: Weights, new: Weights) -> np.ndarray:
    """Changes of the logarithms of all weights."""
    pairs = ((old.physics, new.physics), (old.noise_std, new.noise_std))
    return np.concatenate([np.log(b / a) for a, b in pairs])


def _secant(taken: np.ndarray, before: np.ndarray, change: np.ndarray) -> float:
    """The share of the changes that reaches the fixed point, after a step that reversed them.

    The weights of equations that compete for one error oscillate.  Along the step, changes fall linearly,
    from ``before`` to ``change``, and to zero at the fixed point.
    """
    along = float(taken @ taken) / float(taken @ (before - change))
    return float(np.clip(along, _SHORTEST, 1.0))


def _have_settled(slack: np.ndarray, before: np.ndarray, share: float) -> bool:
    """Whether the degrees of freedom of equations that are not nearly exact have settled.

    The log-determinant term moves coefficients with them, and each round uses those of the last one.
    """
    inexact = slack > ESTIMATION.slack_left
    change = np.linalg.norm((slack - before)[inexact])
    return bool(change <= share * ESTIMATION.weights_settled * np.linalg.norm(slack[inexact]))


def _part_of_the_way(old: Weights, new: Weights, share: float) -> Weights:
    """Weights between old and new ones, interpolated by their logarithms."""
    noise_std = old.noise_std * (new.noise_std / old.noise_std) ** share
    return replace(new, noise_std=noise_std, physics=old.physics * (new.physics / old.physics) ** share)


def _accelerate(old: Weights, new: Weights) -> Weights:
    """Square the growth of w while it is large, because the plain fixed point needs many rounds."""
    ratio = new.physics / old.physics
    return replace(new, physics=new.physics * np.where(ratio > 1.5, np.minimum(ratio, 10.0), 1.0))


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def fit_curve(observations: Measurements, physics: Physics, start: Start) -> tuple[Start, float]:
    """Fit the curve alone with fixed coefficients, and update the weights once if that has an effect.

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
    if _is_idle(observations, held, fit, weights):
        weights = fit.weights
    return Start(fit.control_points, fit.coefficients, weights), evidence(observations, fit)
