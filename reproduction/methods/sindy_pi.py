"""SINDy-PI (Kaheman, Kutz & Brunton, Proc. R. Soc. A 476, 20200279, 2020) by PySINDy: implicit equations.

The library holds functions of (q, q̇, f) and accelerations times functions of q; one of the latter is taken
to the left-hand side and regressed on all others, with several weights: by the package's `SINDyPI` optimizer
(L1, cvxpy), by a least-squares refit on its support (it has no step of its own that removes the shrinkage),
and by the package's STLSQ, which is the regression of the paper.  Three kinds of right-hand side: with the
acceleration of one coordinate (as in the paper: each equation is a rational function), of all (as in the
package), and of none, because noise in the accelerations spoils both.  Left-hand sides: q̈ᵢ, times powers of
the coordinates that are not angles.  The n_dof equations found are solved for the accelerations.

* Accelerations enter the library as measured states: `PDELibrary(implicit_terms=True)` would differentiate
  the states again, and would hold q̇ twice, as a state and as the derivative of q.
* Columns are normalised, and the data compressed without changing the objective.
* States, candidates and the choice among models by forecasts of left-out trajectories: see `_pysindy.py`;
  the few models that enter it for each coordinate are those with the smallest error of its acceleration.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass, replace
from itertools import product

import numpy as np
import pysindy as ps

from reproduction.methods import _pysindy as shared
from reproduction.problem import Acceleration, Answer, Problem

TITLE = "SINDy-PI"
REFERENCE = "PySINDy 2.1, SINDyPI; Kaheman, Kutz & Brunton, Proc. R. Soc. A 476 (2020) 20200279"

SUPPORT = 1e-3  # L1 solutions: smaller coefficients of columns of norm 1 are left by the solver's tolerance
LARGE = 300  # columns; from there on every second regression is tried, on one left-out trajectory
_LARGEST_ERROR = 10.0


@dataclass(frozen=True)
class Regression:
    """Regression of a column on others, all of norm 1: ``l1``, ``l1, refitted`` or ``stlsq``."""

    kind: str
    weight: float
    alpha: float = 0.0

    def __call__(self, rows: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the coefficients of the columns of `rows`."""
        if self.kind == "stlsq":
            optimizer = ps.STLSQ(threshold=self.weight, alpha=self.alpha)
            return optimizer.fit(rows, target[:, None]).coef_[0]
        options = {"tol": 1e-6, "max_iter": 20000, "model_subset": [0]}
        optimizer = ps.SINDyPI(reg_weight_lam=self.weight, regularizer="l1", **options)
        solution = optimizer.fit(np.column_stack([target, rows]), target[:, None]).coef_[0, 1:]
        return np.where(np.abs(solution) > SUPPORT, np.nan_to_num(solution), 0.0)


L1_WEIGHTS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
THRESHOLDS = (0.001, 0.003, 0.01, 0.03, 0.1)
REGRESSIONS = (
    *(Regression("l1", weight) for weight in L1_WEIGHTS),
    *(Regression("l1, refitted", weight) for weight in L1_WEIGHTS),
    *(Regression("stlsq", threshold, alpha) for threshold in THRESHOLDS for alpha in (0.05, 1e-5)),
)


@dataclass(frozen=True)
class Setting:
    """How one equation is found: acceleration and function on its left-hand side, and the regression."""

    coordinate: int
    left: int
    right: str  # accelerations on the right: "none", "own" or "all"
    regression: Regression


@dataclass(frozen=True, eq=False)
class Features:
    """Library of functions of (q, q̇, f), library of functions of q, and their values with those of q̈."""

    explicit: ps.GeneralizedLibrary
    positions: ps.TensoredLibrary
    theta: np.ndarray
    multipliers: np.ndarray
    qddot: np.ndarray

    @property
    def n_columns(self) -> int:
        return self.multipliers.shape[1] * self.qddot.shape[1] + self.theta.shape[1]

    @property
    def matrix(self) -> np.ndarray:
        """Columns: all functions of q times each acceleration in turn; then the rest."""
        products = [self.multipliers * column[:, None] for column in self.qddot.T]
        return np.hstack([*products, self.theta])

    def columns(self, setting: Setting) -> tuple[int, np.ndarray]:
        """Return the left-hand column and the columns allowed on the right."""
        k, n = self.multipliers.shape[1], self.qddot.shape[1]
        left = setting.coordinate * k + setting.left
        allowed = np.ones(self.n_columns, dtype=bool)
        if setting.right != "all":
            allowed[: n * k] = False
        if setting.right == "own":
            allowed[setting.coordinate * k : (setting.coordinate + 1) * k] = True
        allowed[left] = False
        return left, np.flatnonzero(allowed)


def solve(problem: Problem) -> Answer:
    smoothers = shared.choose_smoothers(problem.data)
    motions = shared.differentiate(problem.data, smoothers)
    # SINDyPI prints the number of each model
    with shared.quiet(), warnings.catch_warnings(), redirect_stdout(io.StringIO()):
        # tried solutions compete by their forecasts, so an inexact one needs no warning
        warnings.filterwarnings("ignore", message="Solution may be inaccurate")
        warnings.filterwarnings("ignore", message="Infeasible solve")
        chosen, error = _choose(problem, motions)
        features = _features(problem, motions)
        found = _regress(features, chosen)
    rows = np.array([found[setting] for setting in chosen])
    return Answer(
        coefficients=None,
        acceleration=_acceleration(features, rows),
        status="ok" if error < 1 else "its forecasts are no better than no forecast",
        settings={
            "smoothers": shared.describe(smoothers),
            "right": [setting.right for setting in chosen],
            "regressions": [asdict(setting.regression) for setting in chosen],
            "held_out_error": error,
            "n_candidates": rows.shape[1],
            "n_terms": int(np.count_nonzero(rows)),
        },
        expression=_equations(problem, features, chosen, rows),
    )


def _features(problem: Problem, motions: Sequence[shared.Motion]) -> Features:
    explicit, theta, qddot = shared.regression(problem, motions)
    q = np.concatenate([motion.q for motion in motions])
    positions = shared.position_library(problem)
    return Features(explicit, positions, theta, np.asarray(positions.fit(q).transform(q)), qddot)


def _settings(problem: Problem, features: Features) -> list[Setting]:
    """All that is tried, for each coordinate."""
    texts = features.positions.get_feature_names(list(problem.system.coordinates))
    lefts = [k for k, text in enumerate(texts) if "sin" not in text and "cos" not in text]
    coordinates = range(problem.system.n_dof)
    rights = ("none", "own", "all") if len(coordinates) > 1 else ("none", "own")
    regressions = REGRESSIONS[::2] if features.n_columns > LARGE else REGRESSIONS
    return [Setting(*options) for options in product(coordinates, lefts, rights, regressions)]


def _regress(features: Features, settings: Sequence[Setting]) -> dict[Setting, np.ndarray]:
    """Return the coefficients c of each equation c·(columns) = 0, −1 on the left-hand side's column."""
    matrix = features.matrix
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0] = 1.0
    rows = np.linalg.qr(matrix / norms, mode="r")
    found: dict[Setting, np.ndarray] = {}
    for setting in settings:
        left, right = features.columns(setting)
        row = np.zeros(len(norms))
        if setting.regression.kind == "l1, refitted":
            shrunk = replace(setting, regression=replace(setting.regression, kind="l1"))
            if shrunk not in found:
                found |= _regress(features, [shrunk])
            support = right[found[shrunk][right] != 0]
            row[support] = np.linalg.lstsq(rows[:, support], rows[:, left], rcond=None)[0]
        else:
            row[right] = setting.regression(rows[:, right], rows[:, left])
        row[left] = -1.0
        found[setting] = row / norms
    return found


def _choose(problem: Problem, motions: Sequence[shared.Motion]) -> tuple[tuple[Setting, ...], float]:
    """Return one setting per coordinate: the best few by their own equation, then by joint forecasts."""
    parts = []
    errors: dict[Setting, float] = {}
    for train, test in shared.folds(motions):
        features = _features(problem, train)
        found = _regress(features, _settings(problem, features))
        for setting, error in _equation_errors(features, found, test).items():
            errors[setting] = errors.get(setting, 0.0) + error
        parts.append((features, found, test))
        if features.n_columns > LARGE:
            break
    n = problem.system.n_dof
    tried = list(product(*(_shortlist(errors, i, n) for i in range(n))))
    totals, n_terms = np.zeros(len(tried)), np.zeros(len(tried))
    for features, found, test in parts:
        for k, chosen in enumerate(tried):
            rows = np.array([found[setting] for setting in chosen])
            totals[k] += shared.forecast_error(_acceleration(features, rows), test) / len(parts)
            n_terms[k] += np.count_nonzero(rows)
    k = shared.simplest(totals, n_terms)
    return tried[k], float(totals[k])


def _shortlist(errors: dict[Setting, float], coordinate: int, n_dof: int) -> list[Setting]:
    """Return the best equations of each kind; all combinations of those of all coordinates are tried."""
    ranked = sorted((s for s in errors if s.coordinate == coordinate), key=errors.get)
    kept = {"none": 1, "own": 2 if n_dof < 3 else 1, "all": 1}
    return [s for right, n in kept.items() for s in [t for t in ranked if t.right == right][:n]]


def _equation_errors(features: Features, found: dict, test: Sequence[shared.Motion]) -> dict[Setting, float]:
    """Return relative errors of each equation's own acceleration, the others as measured."""
    q, qdot, qddot = (np.concatenate([getattr(m, part) for m in test]) for part in ("q", "qdot", "qddot"))
    forces = None if test[0].forces is None else np.concatenate([m.forces for m in test])
    mass, right = _linear(features, np.array(list(found.values())), q, qdot, forces)
    errors = {}
    for k, setting in enumerate(found):
        i = setting.coordinate
        residual = right[:, k] - np.einsum("tj,tj->t", mass[:, k], qddot)
        with np.errstate(all="ignore"):
            error = np.abs(residual / mass[:, k, i]) / np.std(qddot[:, i])
        bounded = np.minimum(np.nan_to_num(error, nan=np.inf), _LARGEST_ERROR)
        errors[setting] = float(np.sqrt(np.mean(bounded**2)))
    return errors


def _linear(features: Features, rows: np.ndarray, q, qdot, forces) -> tuple[np.ndarray, np.ndarray]:
    """Return M and b of the equations M q̈ = b."""
    n, k = features.qddot.shape[1], features.multipliers.shape[1]
    multipliers = np.asarray(features.positions.transform(q))
    theta = np.asarray(features.explicit.transform(shared.inputs(q, qdot, forces)))
    mass = multipliers @ rows[:, : n * k].reshape(-1, k).T
    return mass.reshape(len(q), len(rows), n), -theta @ rows[:, n * k :].T


def _acceleration(features: Features, rows: np.ndarray) -> Acceleration:
    def acceleration(q, qdot, forces=None):
        with np.errstate(all="ignore"):
            mass, right = _linear(features, rows, q, qdot, forces)
            good = np.isfinite(mass).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
            good[good] = np.abs(np.linalg.det(mass[good])) > 0
            result = np.full(right.shape, np.nan)
            result[good] = np.linalg.solve(mass[good], right[good][..., None])[..., 0]
        return result

    return acceleration


def _equations(problem: Problem, features: Features, chosen: Sequence[Setting], rows: np.ndarray) -> str:
    coordinates = list(problem.system.coordinates)
    functions = features.positions.get_feature_names(coordinates)
    texts = [f"{c}_ddot {text}" for c in coordinates for text in functions]
    texts += features.explicit.get_feature_names(shared.names(problem))
    lines = []
    for setting, row in zip(chosen, rows, strict=True):
        left, _ = features.columns(setting)
        scaled = -row / row[left]
        terms = [f"{scaled[k]:.6g} {texts[k]}" for k in np.flatnonzero(scaled) if k != left]
        lines.append(f"{texts[left]} = {' + '.join(terms) or '0'}")
    return "\n".join(lines)
