r"""Gravity over length, from a potential and a coupling: a check of times and lengths without a mass.

In a chain of links, link i of length l_i carries all later links. With their mass m and the distance a of
their centre of mass along link j, L contains

.. math:: m a l_i \,\dot\theta_i \dot\theta_j \cos(\theta_i - \theta_j) + m g a \cos\theta_j,

so that the ratio of potential and coupling is g/l_i, whatever sets the scale of L.  If angles are measured
from the previous link, the coupling is the coefficient of q̇₁² cos(q_{i+1} + … + q_j), and the potential that
of cos(q₁ + … + q_j).
A single pendulum, ½ I θ̇² + m g a cos θ, has g/l of the equivalent simple pendulum, l = I/(m a).

If l is known, this gives g.  A wrong value means that times are not in seconds (a clock that is off by a
factor k changes g by k²), that the length is not in metres, or that the plane of motion is inclined.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from leastaction.errors import InputError
from leastaction.findings import Finding, find
from leastaction.identifiers import names_in_terms, quoted
from leastaction.library import make_term
from leastaction.model.numbers import covariance_of
from leastaction.selection.significance import normal_cutoff

if TYPE_CHECKING:
    from leastaction.model.model import LagrangianModel

__all__ = ["STANDARD_GRAVITY", "GravityRatio", "checked_lengths", "gravity_findings", "gravity_ratios"]

STANDARD_GRAVITY = 9.80665
_RANGE = 0.03  # relative deviation of g that errors of the length and the location explain
_SIZES = (1e-3, 100.0)  # metres: plausible lengths of pendulums
_ALIKE = 0.02  # largest relative difference between a factor and the factor of a unit
# factor of the clock → quantity that is not in seconds or metres
_UNITS = {
    1e-3: "times may be in milliseconds",
    1e-6: "times may be in microseconds",
    60.0: "times may be in minutes",
    10.0: "the length may be in centimetres",
    1e3**0.5: "the length may be in millimetres",
    0.0254**-0.5: "the length may be in inches",
}


@dataclass(frozen=True)
class GravityRatio:
    """g/l of one link.

    Attributes
    ----------
    link : str
        Coordinate of the link of this length.
    potential, coupling : str
        The two terms of L.
    value, standard_error : float
        g/l in 1/s², if times are in seconds.
    length : float or None
        In metres, if given.
    """

    link: str
    potential: str
    coupling: str
    value: float
    standard_error: float
    length: float | None = None

    @property
    def gravity(self) -> float | None:
        """g in m/s², if the length was given."""
        return None if self.length is None else self.value * self.length

    @property
    def on_earth(self) -> float:
        """The length in metres at standard gravity."""
        return STANDARD_GRAVITY / self.value

    @property
    def clock(self) -> float | None:
        """True seconds in a second of the recording, from g; None if g is that of the Earth.

        Also None if no length was given.
        """
        if self.gravity is None or self.length is None:
            return None
        off = abs(self.gravity / STANDARD_GRAVITY - 1.0)
        if off <= _RANGE + normal_cutoff(2) * self.standard_error / self.value:
            return None
        return math.sqrt(self.gravity / STANDARD_GRAVITY)

    @property
    def unit(self) -> str:
        """The quantity that may be in another unit, if a common unit explains g; otherwise empty."""
        clock = self.clock or 1.0
        error = self.standard_error / (2.0 * self.value)
        return next((said for k, said in _UNITS.items() if abs(clock / k - 1.0) <= _ALIKE + 2.0 * error), "")

    def __str__(self) -> str:
        error = f" ± {self.standard_error:.2g}" if self.standard_error > 0.0 else ""
        source = f"from {self.potential} over {self.coupling}"
        if self.length is None:
            kind = "of the equivalent simple pendulum" if self._single else f"of the link {self.link}"
            return f"g/l {kind} is {self.value:.5g}{error} 1/s², {source}: l = {self.on_earth:.4g} m on Earth"
        error = f" ± {self.standard_error * self.length:.2g}" if self.standard_error > 0.0 else ""
        text = f"g is {self.gravity:.5g}{error} m/s², {source} and l = {self.length:g} m for {self.link}"
        if self.clock is None:
            return text
        text = f"{text}: not that of the Earth"
        if self.unit:
            return f"{text}; {self.unit}"
        return (
            f"{text}; a second of the recording may be {self.clock:.4g} s, the length not in metres, or the "
            "plane of motion inclined"
        )

    @property
    def _single(self) -> bool:
        return self.coupling == f"{self.link}_dot**2"


def gravity_ratios(
    model: LagrangianModel, lengths: Mapping[str, float] | None = None
) -> tuple[GravityRatio, ...]:
    """g/l of every link that a model determines, in the sequence of the coordinates.

    Parameters
    ----------
    model : LagrangianModel
    lengths : mapping of str to float, optional
        Lengths of the links in metres, by coordinate: from joint to joint, or of a simple pendulum.

    Raises
    ------
    InputError
        If a length is not positive, or the model has no ratio for it.

    Examples
    --------
    >>> from leastaction.model.model import LagrangianModel, ModelTerm
    >>> model = LagrangianModel("q", [ModelTerm("q_dot**2", 0.5), ModelTerm("cos(q)", 9.81e-6, 1e-9)])
    >>> (ratio,) = gravity_ratios(model, {"q": 1.0})  # times in milliseconds
    >>> round(ratio.value, 9), round(ratio.clock, 6)
    (9.81e-06, 0.001)
    """
    given = checked_lengths(lengths or {})
    best = _best(model, given)
    missing = [name for name in given if name not in best]
    if missing:
        raise InputError(
            f"a length is given for {quoted(missing[0])}, for which the model has no g/l; it has g/l for "
            f"{', '.join(best) or 'no coordinate'}"
        )
    return tuple(best[name] for name in model.coordinates if name in best)


def gravity_findings(model: LagrangianModel, lengths: Mapping[str, float]) -> list[Finding]:
    """Findings if g with the given lengths is not that of the Earth, or a length is implausible."""
    found: list[Finding] = []
    best = _best(model, lengths)
    for link, r in best.items():
        figures = {"potential": r.potential, "coupling": r.coupling, "standard_error": r.standard_error}
        if r.clock is not None:
            more = {"gravity": r.gravity, "length": r.length, "clock": r.clock, "unit": r.unit}
            found.append(find("gravity-off", link, **figures, **more))
        elif r.length is None and not _SIZES[0] < r.on_earth < _SIZES[1]:
            found.append(find("length-implausible", link, **figures, value=r.value, on_earth=r.on_earth))
    unused = [name for name in lengths if name not in best]
    return [*found, find("length-unused", unused)] if unused else found


def _best(model: LagrangianModel, lengths: Mapping[str, float]) -> dict[str, GravityRatio]:
    """For each link, the ratio with the smallest relative error."""
    best: dict[str, GravityRatio] = {}
    for ratio in _ratios(model, lengths):
        held = best.get(ratio.link)
        if held is None or ratio.standard_error * held.value < held.standard_error * ratio.value:
            best[ratio.link] = ratio
    return best


def checked_lengths(lengths: Mapping[str, Any], coordinates: Sequence[str] = ()) -> dict[str, float]:
    """Lengths as numbers; InputError for one that is not positive, or not of one of the coordinates."""
    for name, value in lengths.items():
        if coordinates and name not in coordinates:
            raise InputError(
                f"a length is given for {name!r}, which is not a coordinate; the coordinates are "
                f"{', '.join(coordinates)}"
            )
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < math.inf:
            raise InputError(f"the length of {quoted(name)} is {value!r}; expected metres, such as 0.3")
    return {name: float(value) for name, value in lengths.items()}


def _ratios(model: LagrangianModel, lengths: Mapping[str, float]) -> Iterator[GravityRatio]:
    """Every ratio of a potential and a coupling."""
    names = names_in_terms(model.coordinates)
    places = {make_term(term.expression, names).expr: k for k, term in enumerate(model.terms)}
    covariance = covariance_of(model)
    values = np.array([term.coefficient for term in model.terms])
    for link, potential, coupling, share in _pairs(model.coordinates):
        p, c = (places.get(expr) for expr in (potential, coupling))
        if p is None or c is None or not (values[p] and values[c]):
            continue
        slope = np.array([1.0 / values[p], -1.0 / values[c]])
        relative = float(np.sqrt(max(slope @ covariance[np.ix_([p, c], [p, c])] @ slope, 0.0)))
        ratio = share * abs(float(values[p] / values[c]))
        texts = model.terms[p].expression, model.terms[c].expression
        yield GravityRatio(link, *texts, ratio, relative * ratio, lengths.get(link))


def _pairs(coordinates: tuple[str, ...]) -> Iterator[tuple[str, sp.Expr, sp.Expr, float]]:
    """Link, potential, coupling, and the factor of their ratio."""
    q = [sp.Symbol(name, real=True) for name in coordinates]
    rates = [sp.Symbol(f"{name}_dot", real=True) for name in coordinates]
    if len(q) == 1:
        yield coordinates[0], sp.cos(q[0]), rates[0] ** 2, 0.5
    for i in range(len(q)):
        for j in range(i + 1, len(q)):
            yield coordinates[i], sp.cos(q[j]), rates[i] * rates[j] * sp.cos(q[i] - q[j]), 1.0
            between, whole = sp.Add(*q[i + 1 : j + 1]), sp.Add(*q[: j + 1])
            yield coordinates[i], sp.cos(whole), rates[0] ** 2 * sp.cos(between), 1.0
