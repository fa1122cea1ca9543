"""Interfaces of data and linearisations to the solver, in one piece or in blocks of trials."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, cast

import numpy as np

from leastaction.curve.bspline import SplineGrid
from leastaction.estimation import joint
from leastaction.estimation.elimination import Eliminated
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.observations import Observations
from leastaction.estimation.volume import Volume
from leastaction.mechanics.euler_lagrange import EulerLagrange

__all__ = ["Linearised", "Measurements", "System", "linearise"]


class System(Protocol):
    """A Gauss–Newton system; see :class:`leastaction.estimation.elimination.NormalEquations`."""

    def eliminate(self, damping: float = 0.0) -> Eliminated: ...
    def lean(self) -> System: ...


class Linearised(Protocol):
    """The problem linearised at one point; see :class:`leastaction.estimation.joint.Linearisation`."""

    @property
    def control_points(self) -> np.ndarray: ...
    @property
    def squares(self) -> np.ndarray: ...
    @property
    def equation(self) -> np.ndarray: ...
    @property
    def terms(self) -> np.ndarray: ...
    @property
    def at_mass(self) -> Volume: ...
    @property
    def prescribed(self) -> tuple[int, ...]: ...
    @property
    def log_volume(self) -> float: ...
    @property
    def regular(self) -> float: ...
    @property
    def volume(self) -> np.ndarray: ...
    def misfit(self, weights: Weights) -> float: ...
    def cost(self, weights: Weights) -> float: ...
    def mean(self, values: np.ndarray) -> float: ...
    def normal(self, weights: Weights) -> System: ...
    def lean(self) -> Linearised: ...
    def freedom(self, weights: Weights, factor: Any = None) -> tuple[np.ndarray, np.ndarray]: ...
    def scored(self, score: Callable[..., Any], weights: Weights, candidates: EulerLagrange) -> Any: ...


class Measurements(Protocol):
    """Samples on a spline grid; see :class:`leastaction.estimation.joint.Observations`."""

    grid: SplineGrid
    n_dof: int
    counts: np.ndarray
    coordinates: np.ndarray
    floors: np.ndarray
    noise_floor: np.ndarray
    calibration: np.ndarray | None

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]: ...


class _InBlocks(Measurements, Protocol):
    def linearise(
        self,
        physics: Physics,
        control_points: np.ndarray,
        coefficients: np.ndarray,
        weights: Weights | None = None,
    ) -> Linearised: ...


def linearise(
    observations: Measurements,
    physics: Physics,
    control_points: np.ndarray,
    coefficients: np.ndarray,
    weights: Weights | None = None,
) -> Linearised:
    """Linearise the joint problem at (P, λ), in one piece or in blocks of trials.

    ``weights`` announces that the system at these weights follows. A stream computes it in the same pass and
    improves blocks that are far from their best curve (see ``control_points`` of the result).
    """
    if isinstance(observations, Observations):
        calibration = None if weights is None else weights.calibration
        return joint.linearise(observations, physics, control_points, coefficients, calibration)
    return cast(_InBlocks, observations).linearise(physics, control_points, coefficients, weights)
