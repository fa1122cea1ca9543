"""Gauss–Newton with Levenberg–Marquardt damping on the joint problem.

The control points are eliminated by a banded Cholesky factorisation H = LLᵀ; the coefficients solve
the dense Schur complement

    (A − Cᵀ H⁻¹ C) Δλ = −(g_λ − Cᵀ H⁻¹ g_P),

whose inverse is the covariance of λ (Golub & Pereyra 2003, Inverse Problems 19:R1).

Nearly exact equations act like constraints. A step that is right to first order violates them to second
order, and the cost rises although the step is good (Maratos effect). A second-order correction (Nocedal &
Wright 2006, Numerical Optimization, sec. 15.4) then adds the next step if it should lower the cost, and both
steps are accepted or rejected together.

A trial step may overflow, with exp(x) or a high power far from the data. NumPy's warnings are off there and
the numbers are tested instead. Such a step is rejected, and a fit that cannot leave this region ends as "not
finite".
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from leastaction.estimation import joint
from leastaction.estimation.candidates import score
from leastaction.estimation.elimination import CurveFactor, Quadratic
from leastaction.estimation.joint import Linearisation, Physics, Weights
from leastaction.estimation.protocols import Linearised, Measurements, System, linearise
from leastaction.estimation.sensors import SensorObservations
from leastaction.estimation.settings import ESTIMATION
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = [
    "JointFit",
    "Quadratic",
    "fit_joint",
    "nearer",
    "normal_solution",
    "score_candidates",
    "shared",
    "symmetric_inverse",
]

_REGULAR = 1e-5  # of Cholesky pivots: root of the share of a column that the others do not explain
_LARGEST_DAMPING = 1e8  # relative to the diagonal: steps vanish
_LEAST_DAMPING = 1e-10  # relative to the diagonal: holds undetermined unknowns
_SAMPLES = 1e5  # above this, the tolerance grows in proportion: 0.01 for 10⁷ samples took over 15 steps
_FIRST_SHARE, _LEAST_SHARE = 0.25, 1e-3  # of an undamped step
_MOST_IDLE = 3  # successive steps that gain less than the tolerance
_RISING = (1e-4, 1e-2, 1.0)  # shares of the equation weights, raised in steps if a curve does not converge


@dataclass(frozen=True, eq=False)
class JointFit:
    """Optimum of the joint problem at given weights.

    Attributes
    ----------
    control_points : (n_ctrl, n_dof) array
    coefficients : (n_columns,) array
        Known ones included.
    covariance : (n_free, n_free) array
    linearisation : Linearisation
        At the optimum.
    logdet : float
        log |H|, for the marginal likelihood.
    weights : Weights
    status : str
        "converged", "stalled", "step limit" or "not finite".
    n_steps : int
    factor : CurveFactor or None
        Of H at the optimum; None if it is not positive definite, or was not formed.
    joint : (n_free + n_numbers,) * 2 array or None
        Covariance of the free coefficients and of the calibration numbers of sensors, if there are any.
    refused : float
        Decrease of the cost that the last undamped step promised, if it was rejected; otherwise 0.
    """

    control_points: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    linearisation: Linearised
    logdet: float
    weights: Weights
    status: str
    n_steps: int
    factor: CurveFactor | None = None
    joint: np.ndarray | None = None
    refused: float = 0.0

    @property
    def converged(self) -> bool:
        return self.status in ("converged", "stalled")

    @property
    def usable(self) -> bool:
        """Whether the result is finite, converged or not."""
        return self.status != "not finite"


def normal_solution(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of normal equations: by Cholesky factors, or by `symmetric_inverse` where columns depend.

    Eigenvalues take ten times as long.
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    factor, failed = dpotrf(matrix / np.outer(scale, scale))
    if failed or np.diag(factor).min(initial=1.0) < _REGULAR:
        return symmetric_inverse(matrix) @ right
    return dpotrs(factor, right / scale)[0] / scale


def symmetric_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a positive semi-definite matrix, scaled first so that the result does not depend on units.

    Directions that the data do not determine get a huge, finite variance. Raises LinAlgError for a matrix
    that is not finite.
    """
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("the matrix is not finite")
    diagonal = np.diag(matrix)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    values = np.clip(values, 1e-13 * max(1.0, *values), None) if values.size else values
    return (vectors / values) @ vectors.T / np.outer(scale, scale)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def fit_joint(
    observations: Measurements,
    physics: Physics,
    weights: Weights,
    control_points: np.ndarray,
    coefficients: np.ndarray,
    *,
    linearisation: Linearised | None = None,
    tolerance: float = 1e-2,
    max_steps: int = 30,
    in_valley: bool = False,
) -> JointFit:
    """Minimise the joint cost from a start.

    Parameters
    ----------
    linearisation : Linearisation, optional
        At the start, if it is available.
    tolerance : float
        Stop when a step is predicted to lower the cost by less than this (a χ² of 0.01 is a tenth of a
        standard error). Above 100,000 samples the tolerance grows in proportion.  The step of the
        coefficients alone is tested by itself.
    in_valley : bool
        Take shares of undamped steps rather than damped ones. At the step limit, the status is "stalled".

    Returns
    -------
    JointFit
        Never raises for numerical failure: see ``status``.
    """
    here = linearisation or linearise(observations, physics, control_points, coefficients, weights)
    control_points = here.control_points
    control = _Control(share=_FIRST_SHARE, in_valley=True) if in_valley else _Control()
    cost, status, step, idle = here.cost(weights), "step limit", 0, 0
    if not np.isfinite(cost):
        return _fitted(coefficients, here, None, weights, "not finite", 0)
    in_all = tolerance * shared(observations)
    moved = partial(_moved, observations, physics)
    normal, here = here.normal(weights), here.lean()
    while step < max_steps:
        step += 1
        try:
            found = _step(normal, control.damping, weights)
        except np.linalg.LinAlgError:
            control.damp(1e-8)
            if control.damping > _LARGEST_DAMPING:
                status = "not finite"
                break
            continue
        normal = normal.lean()
        shift, delta, predicted, own = control.shortened(found)
        new, there = moved((control_points, coefficients, weights), shift, delta)
        risen = there.cost(weights) - cost
        if not control.damping and risen > 0.0:
            correction = _correction(there.normal(weights), risen, predicted, own, control.share)
            if correction is not None:
                step += 1
                del there
                new, there = moved(new, *correction)
        new_cost = there.cost(weights)
        *_, whole, whole_own = found
        small = whole_own < tolerance and whole < in_all
        if np.isfinite(new_cost) and new_cost <= cost + 1e-9 * abs(cost):
            idle = idle + 1 if cost - new_cost < in_all else 0
            (control_points, coefficients, weights), cost = new, new_cost
            normal, here = there.normal(weights), there.lean()
            del there
            control.accept()
            if small and control.damping < 1e-3:
                status = "converged"
                break
            if idle == _MOST_IDLE:  # the predicted decrease is rounding
                status = "stalled"
                break
        else:
            del there
            control.reject(predicted)
            # below the tolerance, progress is not measurable because of rounding
            if small or control.damping > _LARGEST_DAMPING or control.share < _LEAST_SHARE:
                status = "stalled"
                break
    if status == "step limit" and control.in_valley:
        status = "stalled"  # other weights may widen the valley
    return replace(_fitted(coefficients, here, normal, weights, status, step), refused=control.refused)


@dataclass
class _Control:
    """How far the next step goes: damped, or in a valley a share of the undamped step."""

    damping: float = 0.0  # relative to the diagonal
    share: float = 1.0  # of an undamped step
    in_valley: bool = False
    refused: float = 0.0  # decrease of the cost that the last undamped step promised, if it was rejected

    def shortened(
        self, step: tuple[np.ndarray, np.ndarray, float, float]
    ) -> tuple[np.ndarray, np.ndarray, float, float]:
        """The share of a step, with its predicted decreases of the cost."""
        if self.damping or self.share == 1.0:
            return step
        shift, delta, predicted, own = step
        less = (2.0 - self.share) * self.share
        return self.share * shift, self.share * delta, less * predicted, less * own

    def accept(self) -> None:
        """Go further: less damping, or a larger share."""
        if not self.damping:
            self.share, self.refused = min(1.0, 2.0 * self.share), 0.0
        self.damping = self.damping / 10.0 if self.damping > 1e-6 else 0.0

    def reject(self, predicted: float) -> None:
        """Go less far, after a step of which this decrease of the cost was predicted."""
        if not self.damping:
            self.refused = predicted
        if self.in_valley:
            self.share *= 0.25
        else:
            self.damp(1e-4)

    def damp(self, least: float) -> None:
        self.damping = max(10.0 * self.damping, least)


def shared(observations: Measurements) -> float:
    """Factor of the tolerances of χ² and evidence for many samples."""
    return max(1.0, float(observations.counts.sum()) / _SAMPLES)


def _step(
    normal: System, damping: float, weights: Weights | None = None
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Steps of curve and coefficients, their predicted decrease of the cost, and the coefficients' share.

    Raises LinAlgError when they are not finite.
    """
    quadratic = normal.eliminate(damping)
    least = 0.0 if weights is None or weights.calibration is None else _LEAST_DAMPING
    matrix = quadratic.matrix + max(damping, least) * np.diag(np.diag(quadratic.matrix))
    delta = -symmetric_inverse(matrix) @ quadratic.gradient
    shift = quadratic.curve_step(delta)
    np.negative(shift, out=shift)
    predicted = quadratic.predicted(shift, delta)
    if not np.isfinite(predicted):
        raise np.linalg.LinAlgError("the step is not finite")
    return shift, delta, predicted, -float(quadratic.gradient @ delta)


def _moved(
    observations: Measurements,
    physics: Physics,
    start: tuple[np.ndarray, np.ndarray, Weights],
    shift: np.ndarray,
    delta: np.ndarray,
) -> tuple[tuple[np.ndarray, np.ndarray, Weights], Linearised]:
    """Curve, coefficients and weights after a step, and the problem there; ``shift`` becomes the curve."""
    shift += start[0].ravel()  # in place, because this array is large for long recordings
    points, coefficients, weights = shift.reshape(start[0].shape), start[1].copy(), start[2]
    coefficients[physics.free] += delta[: physics.n_free]
    if isinstance(observations, SensorObservations) and weights.calibration is not None:
        step = observations.directions @ delta[physics.n_free :]
        weights = replace(weights, calibration=weights.calibration + step)
    there = linearise(observations, physics, points, coefficients, weights)
    return (there.control_points, coefficients, weights), there


def _correction(
    normal: System, risen: float, predicted: float, own: float, share: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """The step from a point where the cost has risen, if it should lower it enough.

    It corrects the curve. After a whole step, the decrease predicted from moving the coefficients must
    therefore be small; after a share of one, they stay.
    """
    least = risen + ESTIMATION.correction_saves * predicted
    try:
        if share < 1.0:
            quadratic = normal.eliminate()
            delta = np.zeros_like(quadratic.gradient)
            shift = -quadratic.curve_step(delta)
            return (shift, delta) if quadratic.predicted(shift, delta) >= least else None
        shift, delta, lowered, moved = _step(normal, 0.0)
    except np.linalg.LinAlgError:
        return None
    return (shift, delta) if lowered >= least and moved <= ESTIMATION.correction_moves * own else None


def _fitted(
    coefficients: np.ndarray,
    here: Linearised,
    normal: System | None,
    weights: Weights,
    status: str,
    steps: int,
) -> JointFit:
    """The fit at its last point, with the covariance of the coefficients and the factor of H.

    If these cannot be computed, the status is "not finite". Without a normal matrix they are not computed.
    """
    # the weights are estimated, too: the log-determinant then holds no information on the scale
    known_scale = 2.0 * (here.volume.T * weights.volume) @ here.volume
    n = len(known_scale)
    joint, factor = np.full(known_scale.shape, np.nan), None
    if normal is not None:
        try:
            quadratic = normal.eliminate()
            matrix, factor = quadratic.matrix.copy(), quadratic.factor
            matrix[:n, :n] -= known_scale
            joint = symmetric_inverse(matrix)
        except np.linalg.LinAlgError:
            status = "not finite"
    log_h = np.nan if factor is None else factor.logdet
    solution = JointFit(
        here.control_points, coefficients, joint[:n, :n], here, log_h, weights, status, steps, factor
    )
    return solution if len(joint) == n else replace(solution, joint=joint)


def nearer(at: Linearisation, weights: Weights) -> Linearisation | None:
    """The same coefficients at the best curve of some trials; None if no curve of lower cost is found.

    A noisy curve may not converge to equations that hold nearly exactly.  Their weight then rises in steps.
    """
    grid, held = at.observations.grid, replace(at.physics, free=np.zeros_like(at.physics.free))
    # these trials have a share in the weight of the log-determinant term
    weights = replace(weights, slack=grid.n_intervals / grid.total * weights.slack)

    def fitted(points: np.ndarray, share: float) -> JointFit:
        eased = replace(weights, physics=share * weights.physics)
        return fit_joint(at.observations, held, eased, points, at.coefficients)

    found, points = fitted(at.control_points, 1.0), at.control_points
    for share in () if found.converged else _RISING:
        found = fitted(points, share)
        points = found.control_points if found.usable else points
    there = joint.linearise(at.observations, at.physics, found.control_points, at.coefficients)
    return there if there.cost(weights) < at.cost(weights) else None


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def score_candidates(at: Linearised, weights: Weights, candidates: EulerLagrange) -> Quadratic:
    """Quadratic model of the cost in the coefficients of *all* candidates about a fit.

    For candidates that overflow along the curve, gradient and couplings are zero.

    Raises
    ------
    numpy.linalg.LinAlgError
        When H is not positive definite.
    """
    found = at.scored(score, weights, candidates)
    gradient = found.schur[1:, 0] - weights.volume @ found.volume.slope
    matrix = found.schur[1:, 1:] + at.mean(weights.volume) * found.volume.corner
    lost = ~(np.isfinite(np.diag(matrix)) & np.isfinite(gradient))
    if lost.any():
        gradient = np.where(lost, 0.0, gradient)
        matrix = np.where(lost[:, None] | lost, np.eye(lost.size), matrix)
    return Quadratic(
        gradient,
        matrix,
        found.factor,
        found.curve_gradient,
        lambda step: found.border(np.where(lost, 0.0, step)),
    )
