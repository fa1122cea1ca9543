"""What a discovery leaves behind besides the model: curve, path, what was dropped, where time went."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from leastaction.curve.bspline import SplineGrid
from leastaction.data.trajectories import Trajectories
from leastaction.findings import Finding
from leastaction.library import Dropped, Kind

__all__ = ["Diagnostics", "PathPoint", "pareto"]

_NOT_BORNE_OUT = ("no-fit", "fit-is-worse")


@dataclass(frozen=True)
class PathPoint:
    """One structure on the selection path.

    Attributes
    ----------
    expressions : tuple of str
        Free terms of the structure.
    cost : float
        −2 log likelihood, relative to the best structure seen.
    bic : float
        ``cost`` + (number of free terms) · log(number of samples), relative to the chosen structure.
    chosen : bool
    reason : str
        Why it was not chosen; see `leastaction.selection.alternatives.Alternative`.
    coefficients, standard_errors : tuple of float
        Of the expressions, as the quadratic model of the likelihood about the chosen structure expects them.
    kinds : tuple of {"lagrangian", "dissipation"}
        Of the expressions.
    length : float
        Bits that it takes to name the expressions; NaN where the library has no description lengths.
    templates : tuple of str
        Of the expressions, with their shape parameters in braces; "" for one without. Empty: none has any.
    shapes : tuple of (str, float)
        The shape parameters of the structure and of known terms, with the numbers that the expressions have.
    """

    expressions: tuple[str, ...]
    cost: float
    bic: float
    chosen: bool = False
    reason: str = ""
    coefficients: tuple[float, ...] = ()
    standard_errors: tuple[float, ...] = ()
    kinds: tuple[Kind, ...] = ()
    length: float = math.nan
    templates: tuple[str, ...] = ()
    shapes: tuple[tuple[str, float], ...] = ()

    @property
    def written(self) -> tuple[str, ...]:
        """The expressions as people read them: shape parameters by name."""
        pairs = zip(self.expressions, self.templates, strict=True) if self.templates else ()
        return tuple(template or expression for expression, template in pairs) or self.expressions

    @property
    def n_terms(self) -> int:
        """Number of free terms."""
        return len(self.expressions)


def pareto(points: Sequence[PathPoint]) -> tuple[PathPoint, ...]:
    """The structures that no shorter one explains as well, in rising length, and the chosen one.

    Empty where there are no description lengths. What its own fit does not bear out is left out.

    Examples
    --------
    >>> points = [PathPoint(("x",), 9.0, 9.0, length=3.0), PathPoint(("y",), 12.0, 12.0, length=5.0),
    ...           PathPoint(("x", "y"), 0.0, 0.0, chosen=True, length=8.0)]
    >>> [point.length for point in pareto(points)]
    [3.0, 8.0]
    """
    usable = [p for p in points if math.isfinite(p.length) and math.isfinite(p.cost)]
    ranked = sorted(usable, key=lambda p: (p.length, p.cost, not p.chosen))
    kept: list[PathPoint] = []
    lowest = math.inf
    for point in ranked:
        better = point.cost < lowest and point.reason not in _NOT_BORNE_OUT
        if better or point.chosen:
            kept.append(point)
            lowest = min(lowest, point.cost)
    return tuple(kept)


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """Everything that the report shows and the model file does not keep.

    Attributes
    ----------
    trajectories : Trajectories
        As used: angles unwrapped.
    grid, control_points
        The fitted curve; see :meth:`curve`.
    noise_std, physics_weight, equation_error : (n_dof,) arrays
        σ_i; w_i, the inverse spectral density of the equation error; root mean square of the equation
        residual in the units of a generalised force.
    path : tuple of PathPoint
        Best structure of each size, in rising size; runners-up of the chosen size come last.
    pareto : tuple of PathPoint
        Length against likelihood, where the library has description lengths (`Library.symbolic`): structures
        that no shorter one explains as well, in rising length, and the chosen one.
    dropped : tuple of Dropped
        Candidates removed before the fit, and for which others.
    findings : tuple of Finding
        Those of the fit; the model to which the diagnostics belong sets them.
    prepared : tuple of Finding
        Those of them that speak of data and library, before any fit.
    timings : dict
        Stage → seconds.
    rate_noise_std : dict
        Measured velocity or acceleration, ``"velocity of theta"`` → its noise.
    force_offset : dict
        Coordinate → the slowly changing force that was found there, one (n_times,) array a trajectory at its
        times, where ``discover(force_offset={coordinate: seconds})`` asked for it.
    """

    trajectories: Trajectories
    grid: SplineGrid
    control_points: np.ndarray
    noise_std: np.ndarray
    physics_weight: np.ndarray
    equation_error: np.ndarray
    path: tuple[PathPoint, ...] = ()
    dropped: tuple[Dropped, ...] = ()
    timings: dict[str, float] = field(default_factory=dict[str, float])
    rate_noise_std: dict[str, float] = field(default_factory=dict[str, float])
    force_offset: dict[str, tuple[np.ndarray, ...]] = field(default_factory=dict[str, tuple[np.ndarray, ...]])
    findings: tuple[Finding, ...] = ()
    prepared: tuple[Finding, ...] = ()
    pareto: tuple[PathPoint, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to data and library on the user's behalf, and what else is worth knowing."""
        return tuple(str(finding) for finding in self.findings if finding.severity == "note")

    def curve(self, times: Sequence[np.ndarray] | None = None, nu: int = 0) -> list[np.ndarray]:
        """Derivative ``nu`` of the fitted curve, one (n_times, n_dof) array a trajectory.

        ``times`` defaults to the measured ones.
        """
        times = [trajectory.t for trajectory in self.trajectories] if times is None else times
        return self.grid.evaluate(self.control_points, times, nu)
