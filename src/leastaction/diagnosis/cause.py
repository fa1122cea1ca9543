"""A likely cause, and by how much it, or further terms, would explain the motion better."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.findings import Finding
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.selection.likelihood_search import QuadraticModel

__all__ = ["Cause", "beside", "gain_of"]


@dataclass(frozen=True)
class Cause:
    """What would explain the motion better.

    Attributes
    ----------
    finding : Finding
    gain : float
        By how much it lowers −2 log likelihood, the price of every term included.
    holds : bool
        Whether the equations hold with it.
    """

    finding: Finding
    gain: float
    holds: bool


def beside(fit: Fit, candidates: EulerLagrange) -> tuple[QuadraticModel, tuple[int, ...]]:
    """Quadratic model of the likelihood: chosen terms, those behind them; and places of the chosen."""
    quadratic, chosen = fit.score(candidates), len(fit.structure)
    here = np.concatenate([fit.estimates, np.zeros(len(candidates) - chosen)])
    model = QuadraticModel(quadratic.matrix, quadratic.gradient, here)
    return model, tuple(range(chosen))


def gain_of(model: QuadraticModel, members: tuple[int, ...], *more: int) -> float:
    """By how much further terms lower −2 log likelihood."""
    return model.best({members}, 1)[0].cost - model.best({(*members, *more)}, 1)[0].cost
