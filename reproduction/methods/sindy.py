"""SINDy (Brunton, Proctor & Kutz, PNAS 113, 3932, 2016) by its authors' package, PySINDy.

q̈ = Ξ Θ(q, q̇, f): explicit in the accelerations, so that a mass matrix that depends on q is approximated.
STLSQ, the package's default optimizer, with and without normalised columns (the threshold is then on what a
term contributes, as a share of the accelerations), ridge 0.05 (default) and nearly none; at the best of
these also bagging (`EnsembleOptimizer`, 20 models, median: Fasel et al., Proc. R. Soc. A 478, 2022), kept if
it forecasts better by one per cent.  States, candidates and the choice among settings: see `_pysindy.py`.

In weak form (`sindy_weak`; Messenger & Bortz, Multiscale Model. Simul. 19, 1474, 2021), by `WeakPDELibrary`
with time as its only axis: every candidate and q̇ are integrated against test functions (1 − x²)ᵖ, p = 4
(default), on 500 intervals a trajectory, so that q̈ is never formed.  Velocities are still needed as states;
they come from smoothing.  The half width of the intervals is chosen with the thresholds of STLSQ.  The
coefficients are those of the equation itself, so accelerations are predicted without integration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from types import SimpleNamespace

import numpy as np
import pysindy as ps

from reproduction.methods import _pysindy as shared
from reproduction.problem import Answer, Problem

TITLE = "SINDy"
REFERENCE = "PySINDy 2.1, STLSQ; Brunton, Proctor & Kutz, PNAS 113 (2016) 3932"


@dataclass(frozen=True)
class Setting:
    """Options of STLSQ; with normalised columns the threshold is a share of the accelerations."""

    threshold: float
    normalised: bool
    alpha: float
    bagging: bool = False

    def optimizer(self, size: float, n_samples: int) -> ps.BaseOptimizer:
        """Return the optimizer; `size` is the 2-norm of the accelerations of one coordinate."""
        plain = ps.STLSQ(
            threshold=self.threshold * (size if self.normalised else 1.0),
            alpha=self.alpha,
            normalize_columns=self.normalised,
        )
        if not self.bagging:
            return plain
        return ps.EnsembleOptimizer(plain, bagging=True, n_models=20, n_subset=n_samples // 4)


SETTINGS = (
    *(Setting(threshold, False, 0.05) for threshold in (0.1, 1.0)),
    *(
        Setting(threshold, True, alpha)
        for threshold in (0.001, 0.003, 0.01, 0.03, 0.1)
        for alpha in (1e-5, 0.05)
    ),
)


def solve(problem: Problem) -> Answer:
    smoothers = shared.choose_smoothers(problem.data)
    motions = shared.differentiate(problem.data, smoothers)
    with shared.seeded(problem.case.seed), shared.quiet():
        setting, error = _choose(problem, motions)
        model = _fit(problem, motions, setting)
    coefficients = np.asarray(model.coefficients())
    return Answer(
        coefficients=None,
        acceleration=shared.model_acceleration(model.feature_library, coefficients),
        status="ok" if error < 1 else "its forecasts are no better than no forecast",
        settings={
            "smoothers": shared.describe(smoothers),
            **asdict(setting),
            "held_out_error": error,
            "n_candidates": coefficients.shape[1],
            "n_terms": int(np.count_nonzero(coefficients)),
        },
        expression=shared.equations(problem, model.equations(6)),
    )


def _choose(problem: Problem, motions: Sequence[shared.Motion]) -> tuple[Setting, float]:
    """Return the setting with the best forecasts of trajectories that were left out, and its error."""
    errors, n_terms = np.zeros(len(SETTINGS)), np.zeros(len(SETTINGS))
    parts = list(shared.folds(motions))
    for train, test in parts:
        library, features, targets = shared.regression(problem, train)
        size = np.linalg.norm(targets) / np.sqrt(targets.shape[1])
        rows, right = shared.compress(features, targets)
        found = np.array([s.optimizer(size, len(rows)).fit(rows, right).coef_ for s in SETTINGS])
        n_terms += np.count_nonzero(found, axis=(1, 2))
        errors += shared.forecast_errors(library, found, test) / len(parts)
    k = shared.simplest(errors, n_terms)
    best = SETTINGS[k]
    bagged = Setting(best.threshold, best.normalised, best.alpha, bagging=True)
    error = 0.0
    for train, test in parts:
        model = _fit(problem, train, bagged)
        acceleration = shared.model_acceleration(model.feature_library, model.coefficients())
        error += shared.forecast_error(acceleration, test) / len(parts)
    return (bagged, error) if error < 0.99 * errors[k] else (best, float(errors[k]))


def _fit(problem: Problem, motions: Sequence[shared.Motion], setting: Setting) -> ps.SINDy:
    accelerations = [motion.qddot for motion in motions]
    size = np.linalg.norm(np.concatenate(accelerations)) / np.sqrt(problem.system.n_dof)
    n_samples = sum(len(a) for a in accelerations)
    model = ps.SINDy(setting.optimizer(size, n_samples), shared.feature_library(problem))
    driven = motions[0].forces is not None
    return model.fit(
        [shared.inputs(motion.q, motion.qdot, None) for motion in motions],
        t=[motion.t for motion in motions],
        x_dot=accelerations,
        u=[motion.forces for motion in motions] if driven else None,
        feature_names=shared.names(problem),
    )


# ----------------------------------------------------------------------------------------------- weak form
HALF_WIDTHS = (0.05, 0.1, 0.2, 0.4)  # seconds; more than a swing cannot be told from noise
N_DOMAINS = 500


class _Rows(ps.feature_library.base.BaseFeatureLibrary):
    """A feature library that can also be fitted to one sample without an axis of time.

    `WeakPDELibrary.fit` does that to its function library; libraries made of others cannot take it.
    """

    def __init__(self, library: ps.GeneralizedLibrary) -> None:
        self.library = library

    def fit(self, x, y=None) -> _Rows:
        self.library.fit(np.atleast_2d(np.asarray(x)))
        self.n_features_in_ = self.library.n_features_in_
        self.n_output_features_ = self.library.n_output_features_
        return self

    def transform(self, x):
        return self.library.transform(x)

    def get_feature_names(self, input_features=None) -> list[str]:
        return self.library.get_feature_names(input_features)


def _solve_weak(problem: Problem) -> Answer:
    smoothers = shared.choose_smoothers(problem.data)
    motions = shared.differentiate(problem.data, smoothers)
    with shared.seeded(problem.case.seed), shared.quiet():
        half_width, setting, error = _choose_weak(problem, motions)
        model = _fit_weak(problem, motions, half_width, setting)
    n = problem.system.n_dof
    coefficients = np.asarray(model.coefficients())[n:]
    return Answer(
        coefficients=None,
        acceleration=shared.model_acceleration(model.feature_library.function_library, coefficients),
        status="ok" if error < 1 else "its forecasts are no better than no forecast",
        settings={
            "smoothers": shared.describe(smoothers),
            "half_width": half_width,
            "n_domains": N_DOMAINS,
            **asdict(setting),
            "held_out_error": error,
            "n_candidates": coefficients.shape[1],
            "n_terms": int(np.count_nonzero(coefficients)),
        },
        expression=shared.equations(problem, model.equations(6)[n:]),
    )


def _same_length(motions: Sequence[shared.Motion]) -> list[shared.Motion]:
    """Cut to the shortest: the library has one grid of times for all trajectories."""
    length = min(motion.t.size for motion in motions)
    return [motion.part(slice(0, length)) for motion in motions]


def _library(problem: Problem, motions: Sequence[shared.Motion], half_width: float) -> ps.WeakPDELibrary:
    times = motions[0].t - motions[0].t[0]
    return ps.WeakPDELibrary(
        function_library=_Rows(shared.feature_library(problem)),
        spatiotemporal_grid=times,
        K=N_DOMAINS,
        H_xt=half_width,
    )


def _choose_weak(problem: Problem, motions: Sequence[shared.Motion]) -> tuple[float, Setting, float]:
    """Return half width and setting with the best forecasts of trajectories that were left out."""
    tried = [(half_width, setting) for half_width in HALF_WIDTHS for setting in SETTINGS]
    errors, n_terms = np.zeros(len(tried)), np.zeros(len(tried))
    parts = list(shared.folds(motions))
    for train, test in parts:
        for h, half_width in enumerate(HALF_WIDTHS):
            library, rows, right, size = _integrals(problem, _same_length(train), half_width)
            found = np.array([s.optimizer(size, len(rows)).fit(rows, right).coef_ for s in SETTINGS])
            block = slice(h * len(SETTINGS), (h + 1) * len(SETTINGS))
            n_terms[block] += np.count_nonzero(found, axis=(1, 2))
            errors[block] += shared.forecast_errors(library.function_library, found, test) / len(parts)
    k = shared.simplest(errors, n_terms)
    return *tried[k], float(errors[k])


def _integrals(problem: Problem, motions: Sequence[shared.Motion], half_width: float):
    """Return the fitted library, compressed integrals of candidates and q̈, and the size of the latter."""
    library = _library(problem, motions, half_width)
    columns = [shared.inputs(motion.q, motion.qdot, motion.forces) for motion in motions]
    features = np.concatenate([np.asarray(part) for part in library.fit(columns).transform(columns)])
    targets = np.concatenate([library.convert_u_dot_integral(motion.qdot) for motion in motions])
    size = float(np.linalg.norm(targets) / np.sqrt(targets.shape[1]))
    return library, *shared.compress(features, targets), size


def _fit_weak(
    problem: Problem, motions: Sequence[shared.Motion], half_width: float, setting: Setting
) -> ps.SINDy:
    motions = _same_length(motions)
    library = _library(problem, motions, half_width)
    velocities = np.concatenate([library.convert_u_dot_integral(motion.qdot) for motion in motions])
    size = float(np.linalg.norm(velocities) / np.sqrt(problem.system.n_dof))
    model = ps.SINDy(setting.optimizer(size, len(velocities)), library)
    driven = motions[0].forces is not None
    return model.fit(
        [shared.inputs(motion.q, motion.qdot, None) for motion in motions],
        t=[motion.t for motion in motions],
        u=[motion.forces for motion in motions] if driven else None,
        feature_names=shared.names(problem),
    )


sindy_weak = SimpleNamespace(
    TITLE="weak SINDy",
    REFERENCE="PySINDy 2.1, WeakPDELibrary; Messenger & Bortz, Multiscale Model. Simul. 19 (2021) 1474",
    solve=_solve_weak,
)
