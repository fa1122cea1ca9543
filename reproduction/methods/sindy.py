"""SINDy (Brunton, Proctor & Kutz, PNAS 113, 3932, 2016) by its authors' package, PySINDy.

q̈ = Ξ Θ(q, q̇, f): explicit in the accelerations, so that a mass matrix that depends on q is approximated.
STLSQ, the package's default optimizer, with and without normalised columns (the threshold is then on what a
term contributes, as a share of the accelerations), ridge 0.05 (default) and nearly none; at the best of
these also bagging (`EnsembleOptimizer`, 20 models, median: Fasel et al., Proc. R. Soc. A 478, 2022), kept if
it forecasts better by one per cent.  States, candidates and the choice among settings: see `_pysindy.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

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
