"""By how much would further terms explain the motion better, by the quadratic model of the likelihood?"""

from __future__ import annotations

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.selection.likelihood_search import QuadraticModel

__all__ = ["beside", "gain_of"]


def beside(fit: Fit, candidates: EulerLagrange) -> tuple[QuadraticModel, tuple[int, ...]]:
    """Quadratic model of the chosen terms and those behind them, and places of the chosen."""
    quadratic, chosen = fit.score(candidates), len(fit.structure)
    here = np.concatenate([fit.estimates, np.zeros(len(candidates) - chosen)])
    model = QuadraticModel(quadratic.matrix, quadratic.gradient, here)
    return model, tuple(range(chosen))


def gain_of(model: QuadraticModel, members: tuple[int, ...], *more: int) -> float:
    """By how much further terms lower −2 log likelihood."""
    return model.best({members}, 1)[0].cost - model.best({(*members, *more)}, 1)[0].cost
