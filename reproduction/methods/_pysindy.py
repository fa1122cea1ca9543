"""What the three PySINDy methods share: states from positions, candidate functions, the choice of settings.

A second-order system is given to PySINDy in the way its maintainers answer when asked: states (q, q̇), and
derivatives of the positions taken beforehand by its own differentiation classes and passed as ``x_dot``;
forces are control inputs ``u``.

* Derivatives: `SmoothedFiniteDifference` (its documentation: for noisy data) applied twice, finite
  differences of order 4.  Window and degree of the Savitzky-Golay filter are those with the smallest
  leave-one-out error of the positions, for each coordinate; no smoothing is one choice.
* Missing samples are filled by a cubic spline through the measured ones, end values are held.
* Candidates: polynomials of degree 2 in the velocities, times polynomials of degree 2 in coordinates that are
  not angles, times sines and cosines of angles, double angles, sums and differences of two angles; also of
  a − 2b and 2a − 2b if all coordinates are angles, as for the double pendulum of the SINDy-PI paper.  Without
  angles: polynomials of degree 3 in all states.  Forces: linear, times the same sines and cosines.
* Terms of the given Lagrangian library that are neither polynomials nor sines and cosines give their
  gradients, so that PySINDy is told as much as we are.
* Choice of thresholds and of everything else: forecasts over half a second from many states of a trajectory
  that was left out (of a fifth of the time, if there is only one), against its measured positions, for three
  trajectories in turn; the model with the fewest terms of those within one per cent of the best.  No exact
  value is used.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np
import pysindy as ps
import sympy as sp
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_coeffs, savgol_filter
from sklearn.exceptions import ConvergenceWarning

import leastaction as la
from reproduction.problem import Acceleration, Problem, inputs, names

__all__ = [
    "SMOOTHERS",
    "Motion",
    "Smoother",
    "choose_smoothers",
    "compress",
    "describe",
    "differentiate",
    "equations",
    "feature_library",
    "folds",
    "forecast_error",
    "forecast_errors",
    "inputs",
    "model_acceleration",
    "names",
    "position_library",
    "quiet",
    "regression",
    "seeded",
    "simplest",
]

HORIZON = 0.5  # seconds
_LARGEST_ERROR = 10.0  # in units of the motion during the horizon; more is as bad


@dataclass(frozen=True)
class Smoother:
    """Window (samples) and degree of a Savitzky-Golay filter; window 0: no smoothing."""

    window: int
    degree: int = 3

    def __call__(self) -> ps.FiniteDifference:
        if not self.window:
            return ps.FiniteDifference(order=4)
        options = {"window_length": self.window, "polyorder": self.degree}
        return ps.SmoothedFiniteDifference(smoother_kws=options, order=4)


_WINDOWS = (11, 15, 21, 31, 41, 51, 61, 81, 101)
SMOOTHERS = (Smoother(0), *(Smoother(window, degree) for window in _WINDOWS for degree in (3, 5)))


@dataclass(frozen=True, eq=False)
class Motion:
    """A measured trajectory and what differentiation made of it; all arrays (n_times, n_dof)."""

    t: np.ndarray
    measured: np.ndarray
    q: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    forces: np.ndarray | None

    def part(self, samples: slice) -> Motion:
        """Return some of the samples."""
        arrays = (self.t, self.measured, self.q, self.qdot, self.qddot, self.forces)
        return Motion(*(None if array is None else array[samples] for array in arrays))


def choose_smoothers(trajectories: Sequence[la.Trajectory]) -> tuple[Smoother, ...]:
    """Return the smoother of each coordinate with the smallest leave-one-out error of the positions.

    The filter is linear: what it says of a sample without using that sample differs from the measurement by
    its residual over one minus the sample's own weight.
    """
    filled = [_filled(run.t, run.q) for run in trajectories]
    errors = []
    for smoother in SMOOTHERS:
        # without smoothing: interpolation by the two neighbours on either side, which is this filter's
        window, degree = (smoother.window, smoother.degree) if smoother.window else (5, 3)
        own = savgol_coeffs(window, degree)[window // 2]
        inner = slice(window // 2, -(window // 2))
        residuals = [
            (savgol_filter(q, window, degree, axis=0) - run.q)[inner]
            for q, run in zip(filled, trajectories, strict=True)
        ]
        errors.append(np.nanmean(np.concatenate(residuals) ** 2, axis=0) / (1 - own) ** 2)
    return tuple(SMOOTHERS[k] for k in np.argmin(errors, axis=0))


def differentiate(trajectories: Sequence[la.Trajectory], smoothers: Sequence[Smoother]) -> list[Motion]:
    """Return positions, velocities and accelerations; half a window at either end is dropped."""
    edge = max(2, *(smoother.window // 2 for smoother in smoothers))
    motions = []
    for run in trajectories:
        columns = []
        for x, smoother in zip(_filled(run.t, run.q).T, smoothers, strict=True):
            method = smoother()
            velocity = np.asarray(method(x[:, None], run.t))
            q = np.asarray(method.smoothed_x_)
            acceleration = np.asarray(method(velocity, run.t))
            columns.append([q, np.asarray(method.smoothed_x_), acceleration])
        states = (np.hstack(parts) for parts in zip(*columns, strict=True))
        motions.append(Motion(run.t, run.q, *states, run.forces).part(slice(edge, -edge)))
    return motions


def _filled(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    columns = []
    for column in q.T:
        known = np.isfinite(column)
        inside = np.clip(t, t[known][0], t[known][-1])
        columns.append(column if known.all() else CubicSpline(t[known], column[known])(inside))
    return np.column_stack(columns)


def folds(motions: Sequence[Motion]) -> Iterator[tuple[list[Motion], list[Motion]]]:
    """Yield motions to learn from and motions to choose by: up to three trajectories, or fifths of one."""
    if len(motions) == 1:
        borders = np.linspace(0, motions[0].t.size, 6).astype(int)
        motions = [motions[0].part(slice(a, b)) for a, b in pairwise(borders)]
    for k in sorted({0, len(motions) // 2, len(motions) - 1}):
        yield [m for i, m in enumerate(motions) if i != k], [motions[k]]


def feature_library(problem: Problem) -> ps.GeneralizedLibrary:
    """Return the candidate functions of coordinates, velocities and forces."""
    system, n = problem.system, problem.system.n_dof
    angles, lengths = _kinds(problem)
    rates = list(range(n, 2 * n))
    if not angles:
        libraries, columns = [ps.PolynomialLibrary(degree=3)], [lengths + rates]
    else:
        factors = [_harmonics(len(angles), not lengths), ps.PolynomialLibrary(degree=2)]
        parts = [angles, rates]
        if lengths:
            factors.append(ps.PolynomialLibrary(degree=2))
            parts.append(lengths)
        libraries, columns = [ps.TensoredLibrary(factors, inputs_per_library=parts)], [list(range(2 * n))]
    if problem.data[0].forces is not None:
        forces = list(range(2 * n, 3 * n))
        factors, parts = [ps.PolynomialLibrary(degree=1, include_bias=False)], [forces]
        if angles:
            factors.append(_harmonics(len(angles), not lengths))
            parts.append(angles)
        libraries.append(ps.TensoredLibrary(factors, inputs_per_library=parts))
        columns.append(list(range(3 * n)))
    given = _gradients(problem)
    if given:
        libraries.append(_custom(given, system.symbols[0]))
        columns.append(list(range(n)))
    return ps.GeneralizedLibrary(libraries, inputs_per_library=columns)


def position_library(problem: Problem) -> ps.TensoredLibrary:
    """Return functions of the coordinates alone, by which accelerations are multiplied in implicit models."""
    angles, lengths = _kinds(problem)
    factors, parts = [], []
    if angles:
        factors.append(_harmonics(len(angles), not lengths))
        parts.append(angles)
    if lengths:
        factors.append(ps.PolynomialLibrary(degree=2))
        parts.append(lengths)
    return ps.TensoredLibrary(factors, inputs_per_library=parts)


def _kinds(problem: Problem) -> tuple[list[int], list[int]]:
    system = problem.system
    angles = [i for i, c in enumerate(system.coordinates) if c in system.angles]
    return angles, [i for i in range(system.n_dof) if i not in angles]


def _harmonics(n_angles: int, rich: bool) -> ps.ConcatLibrary:
    """Return 1 and the sines and cosines; the combinations with two double angles only if rich."""
    libraries = [ps.PolynomialLibrary(degree=0), ps.FourierLibrary(n_frequencies=2)]
    if n_angles > 1:
        weights = [(1, 1), (1, -1)] + ([(1, -2), (2, -1), (2, -2)] if rich else [])
        functions, texts = [], []
        for a, b in weights:
            functions += [_wave(np.sin, a, b), _wave(np.cos, a, b)]
            texts += [_text("sin", a, b), _text("cos", a, b)]
        libraries.append(ps.CustomLibrary(functions, texts))
    return ps.ConcatLibrary(libraries)


# PySINDy counts the arguments of these functions, so they take exactly two.
def _wave(function, a: int, b: int):
    return lambda x, y: function(a * x + b * y)


def _text(name: str, a: int, b: int):
    return lambda x, y: f"{name}({a} {x}{b:+d} {y})"


def _gradients(problem: Problem) -> list[sp.Expr]:
    """Gradients of the potentials in the Lagrangian library that no polynomial or sine can express."""
    coordinates, velocities = problem.system.symbols
    found: dict[sp.Expr, None] = {}
    for term in problem.library:
        expression = problem.system.parse(term.text)
        bare = expression.replace(lambda e: e.func in (sp.sin, sp.cos), lambda e: sp.Dummy())
        if expression.has(*velocities) or bare.is_polynomial(*coordinates):
            continue
        for q in coordinates:
            slope = sp.diff(expression, q)
            if slope.free_symbols:
                found.setdefault(slope)
    return list(found)


def _custom(expressions: Sequence[sp.Expr], symbols: Sequence[sp.Symbol]) -> ps.CustomLibrary:
    functions = [sp.lambdify(symbols, e, "numpy") for e in expressions]
    texts = [lambda *_, text=f"({e})": text for e in expressions]
    return ps.CustomLibrary(functions, texts)


def forecast_error(acceleration: Acceleration, motions: Sequence[Motion]) -> float:
    """Return the error of forecasts over `HORIZON`, relative to how far the coordinates move in that time."""
    return float(_forecast_errors(acceleration, motions, 1)[0])


def forecast_errors(library, coefficients: np.ndarray, motions: Sequence[Motion]) -> np.ndarray:
    """Return the same for many models at once: coefficients (n_models, n_dof, n_features)."""
    weights = np.swapaxes(coefficients, 1, 2)

    def acceleration(q, qdot, forces):
        features = np.asarray(library.transform(inputs(q, qdot, forces)))
        return (features.reshape(len(weights), -1, features.shape[1]) @ weights).reshape(q.shape)

    return _forecast_errors(acceleration, motions, len(weights))


def _forecast_errors(acceleration: Acceleration, motions: Sequence[Motion], n_models: int) -> np.ndarray:
    squares, count = np.zeros(n_models), 0
    for motion in motions:
        dt = motion.t[1] - motion.t[0]
        length = 4 * max(1, int(HORIZON / (4 * dt)))
        starts = np.arange(0, motion.t.size - length, length // 2)
        moved = motion.measured[starts + length] - motion.measured[starts]
        scale = np.sqrt(np.nanmean(moved**2, axis=0))
        for k, q in _forecast(acceleration, motion, np.tile(starts, n_models), length, dt):
            measured = motion.measured[starts + k]
            known = np.isfinite(measured)
            error = np.abs(q.reshape(n_models, *measured.shape) - measured) / scale
            error = np.minimum(np.nan_to_num(error, nan=np.inf), _LARGEST_ERROR)
            squares += np.sum(np.where(known, error, 0.0) ** 2, axis=(1, 2))
            count += np.sum(known)
    return np.sqrt(squares / count)


def _forecast(acceleration, motion: Motion, starts, length: int, dt: float) -> Iterator:
    """Runge-Kutta steps of four samples, so that the forces are known in the middle of a step."""

    def slope(q, v, k):
        return acceleration(q, v, None if motion.forces is None else motion.forces[starts + k])

    q, v, h = motion.q[starts], motion.qdot[starts], 4 * dt
    for k in range(0, length, 4):
        with np.errstate(all="ignore"):
            a1 = slope(q, v, k)
            v2 = v + h / 2 * a1
            a2 = slope(q + h / 2 * v, v2, k + 2)
            v3 = v + h / 2 * a2
            a3 = slope(q + h / 2 * v2, v3, k + 2)
            v4 = v + h * a3
            a4 = slope(q + h * v3, v4, k + 4)
            q = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        yield k + 4, q


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed NumPy's global generator, the only one PySINDy uses, and put it back afterwards."""
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002


@contextmanager
def quiet() -> Iterator[None]:
    """Hide what PySINDy says of settings that are tried and not chosen: too sparse, not converged."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparsity parameter is too big")
        warnings.filterwarnings("ignore", category=ConvergenceWarning)
        yield


def model_acceleration(library, coefficients: np.ndarray) -> Acceleration:
    """Return q̈(q, q̇, f) of coefficients (n_dof, n_features) of a fitted feature library."""

    def acceleration(q, qdot, forces=None):
        with np.errstate(all="ignore"):
            return np.asarray(library.transform(inputs(q, qdot, forces))) @ coefficients.T

    return acceleration


def compress(features: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return few rows (R, Qᵀy) that give least squares, ridge or not, the same solution as (Θ, y)."""
    q, r = np.linalg.qr(features)
    return r, q.T @ targets


def describe(smoothers: Sequence[Smoother]) -> list[dict[str, int]]:
    """Return the chosen filters as JSON values."""
    return [asdict(smoother) for smoother in smoothers]


def regression(
    problem: Problem, motions: Sequence[Motion]
) -> tuple[ps.GeneralizedLibrary, np.ndarray, np.ndarray]:
    """Return the fitted library, its features at all samples, and the accelerations."""
    library = feature_library(problem)
    columns = [inputs(motion.q, motion.qdot, motion.forces) for motion in motions]
    features = np.concatenate([np.asarray(part) for part in library.fit(columns).transform(columns)])
    return library, features, np.concatenate([motion.qddot for motion in motions])


def equations(problem: Problem, right: Sequence[str]) -> str:
    """Return one equation a line, as PySINDy prints them."""
    return "\n".join(f"{c}_ddot = {text}" for c, text in zip(problem.system.coordinates, right, strict=True))


def simplest(errors: np.ndarray, n_terms: np.ndarray) -> int:
    """Return the index of the model with the fewest terms among those within one per cent of the best."""
    close = np.flatnonzero(np.asarray(errors) <= 1.01 * np.min(errors))
    return int(min(close, key=lambda k: (n_terms[k], errors[k])))
