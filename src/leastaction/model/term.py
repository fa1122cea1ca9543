"""Parts of a model: terms with coefficients, shape parameters, and the summary of the fit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np

from leastaction.errors import InputError
from leastaction.findings import (
    STATED,
    Audience,
    Finding,
    Severity,
    Status,
    as_given,
    sentence,
    smoothing_widths,
    statements,
)
from leastaction.identifiers import quoted
from leastaction.kinds import is_number
from leastaction.shown import Card, Shown, data_frame

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["INTERVAL_RISE", "Z95", "FitSummary", "ModelTerm", "ShapeParameter", "as_float"]

_THROUGH = 1e-3  # chi2 per sample; with less, hardly a sample is off the curve
Z95 = 1.959963984540054
"""Half width of a central 95 % interval of a normal distribution, in standard errors."""
INTERVAL_RISE = Z95**2
"""Increase of −2 log likelihood at the ends of a 95 % interval."""


def as_float(value: object, label: str, *, missing: bool = False, least: float = -math.inf) -> float:
    """Return a real number as float; not finite is refused, or with `missing` NaN ("not available")."""
    if value is None and missing:
        return math.nan
    if not is_number(value):
        raise InputError(f"{label} is {quoted(value)}; expected a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        if missing:
            return math.nan
        raise InputError(f"{label} is {quoted(value)}; expected a finite number")
    if number < least:
        raise InputError(f"{label} is {number:g}; expected at least {least:g}")
    return number


@dataclass(frozen=True)
class ModelTerm:
    """One term of a model: coefficient times expression.

    Parameters
    ----------
    expression : str
        Function of coordinates and velocities, e.g. ``"theta_dot**2"``.
    coefficient : float
    standard_error : float
        0.0 for a known coefficient; NaN if not available.
    known : bool
        Whether the user gave the coefficient.
    template : str
        The expression with its shape parameters in braces, e.g. ``"exp(-{a}*x)"``; ``expression`` has their
        values instead. Empty without shape parameters.

    Raises
    ------
    InputError
        If a value is of the wrong type, not finite, or a known coefficient has an error.

    Examples
    --------
    >>> term = ModelTerm("cos(theta)", 9.8, 0.1)
    >>> round(term.lower, 3), round(term.upper, 3), round(term.z)
    (9.604, 9.996, 98)
    """

    expression: str
    coefficient: float
    standard_error: float = 0.0
    known: bool = False
    template: str = ""

    def __post_init__(self) -> None:
        _check_text(self.template, "the template of a term")
        _check_expression(self.expression)
        where = f"term {quoted(self.expression)}: "
        _check_known(self.known, where)
        error = as_float(self.standard_error, f"{where}the standard error", missing=True, least=0.0)
        if self.known and error != 0.0:
            raise InputError(f"{where}a known coefficient has the standard error {error:g}; expected 0")
        object.__setattr__(self, "coefficient", as_float(self.coefficient, f"{where}the coefficient"))
        object.__setattr__(self, "standard_error", error)
        object.__setattr__(self, "known", bool(self.known))

    @property
    def written(self) -> str:
        """The expression for display, with shape parameters by name."""
        return self.template or self.expression

    @property
    def lower(self) -> float:
        """Lower end of the 95 % interval; the coefficient itself if it is known."""
        return self.coefficient - Z95 * self.standard_error

    @property
    def upper(self) -> float:
        """Upper end of the 95 % interval."""
        return self.coefficient + Z95 * self.standard_error

    @property
    def z(self) -> float:
        """Coefficient over standard error; NaN if it is known or has no standard error."""
        return self.coefficient / self.standard_error if self.standard_error > 0 else math.nan


def _check_expression(expression: object) -> None:
    if not isinstance(expression, str) or not expression.strip():
        raise InputError(
            f"the expression of a term is {quoted(expression)}; expected text such as 'cos(theta)'"
        )


def _check_text(value: object, what: str) -> None:
    if not isinstance(value, str):
        raise InputError(f"{what} is {quoted(value)}; expected text")


def _check_known(known: object, where: str) -> None:
    if not isinstance(known, (bool, np.bool_)):
        raise InputError(f"{where}known is {quoted(known)}; expected True or False")


@dataclass(frozen=True)
class ShapeParameter:
    """An estimated number inside terms.

    Parameters
    ----------
    name : str
        The name in the braces of the templates.
    value : float
    standard_error : float
        NaN if not available.
    profile : sequence of (float, float)
        Profile likelihood: increasing values, and the increase of −2 log likelihood from `value` with
        everything else refitted. Empty if not computed.

    Raises
    ------
    InputError
        If a value is of the wrong type or not finite.

    Notes
    -----
    `lower` and `upper` are the ends of the 95 % interval, where the profile has risen by 3.84. If it does not
    rise that far on one side, or there is no profile, they are 1.96 standard errors from `value`.

    Examples
    --------
    >>> decay = ShapeParameter("a", 0.8, 0.1)
    >>> round(decay.lower, 3), round(decay.upper, 3)
    (0.604, 0.996)
    >>> decay = ShapeParameter("a", 0.8, 0.1, [(0.6, 4.0), (0.7, 1.0), (0.8, 0.0), (1.0, 2.25), (1.2, 9.0)])
    >>> round(decay.lower, 3), round(decay.upper, 3)
    (0.604, 1.061)
    """

    name: str
    value: float
    standard_error: float = math.nan
    profile: tuple[tuple[float, float], ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        _check_text(self.name, "the name of a shape parameter")
        if not self.name.isidentifier():
            raise InputError(f"a shape parameter has the name {quoted(self.name)}; expected one such as 'a'")
        where = f"shape parameter {quoted(self.name)}: "
        error = as_float(self.standard_error, f"{where}the standard error", missing=True, least=0.0)
        object.__setattr__(self, "value", as_float(self.value, f"{where}the value"))
        object.__setattr__(self, "standard_error", error)
        object.__setattr__(self, "profile", _profile(self.profile, where))

    @property
    def lower(self) -> float:
        """Lower end of the 95 % interval."""
        return self._end([(x, rise) for x, rise in reversed(self.profile) if x <= self.value], -1.0)

    @property
    def upper(self) -> float:
        """Upper end of the 95 % interval."""
        return self._end([(x, rise) for x, rise in self.profile if x >= self.value], 1.0)

    def _end(self, side: list[tuple[float, float]], sign: float) -> float:
        """Value at which the square root of the profile, which is nearly linear, reaches its bound."""
        for (x, low), (y, high) in pairwise(side):
            if low < INTERVAL_RISE <= high:
                a, b = math.sqrt(low), math.sqrt(high)
                return x + (y - x) * (Z95 - a) / (b - a)
        return self.value + sign * Z95 * self.standard_error

    def as_term(self) -> ModelTerm:
        """Name and value as a row of a table of terms.

        Examples
        --------
        >>> ShapeParameter("a", 0.8, 0.1).as_term().written
        '{a}'
        """
        return _Row(f"{{{self.name}}}", self.value, self.standard_error, ends=(self.lower, self.upper))


@dataclass(frozen=True)
class _Row(ModelTerm):
    """A term whose interval is not that of its standard error."""

    ends: tuple[float, float] = (math.nan, math.nan)

    @property
    def lower(self) -> float:
        return self.ends[0]

    @property
    def upper(self) -> float:
        return self.ends[1]


def _profile(given: object, where: str) -> tuple[tuple[float, float], ...]:
    """Pairs of numbers, sorted by the first."""
    refused = InputError(f"{where}the profile is {quoted(given)}; expected pairs of numbers")
    if not isinstance(given, Iterable):
        raise refused
    numbers: list[tuple[float, float]] = []
    for pair in cast("Iterable[object]", given):
        if not isinstance(pair, (tuple, list)) or len(cast("Sequence[object]", pair)) != 2:
            raise refused
        place, rise = cast("Sequence[object]", pair)
        place = as_float(place, f"{where}a number of the profile")
        numbers.append((place, as_float(rise, f"{where}a rise of the profile", least=0.0)))
    if any(b <= a for (a, _), (b, _) in pairwise(numbers)):
        raise InputError(f"{where}the values of the profile do not increase; sort them")
    return tuple(numbers)


@dataclass(frozen=True, init=False, repr=False)
class FitSummary(Shown):
    """The verdict on a model, and the findings behind it.

    Parameters
    ----------
    status : {"ok", "usable", "doubtful"}
        ``"usable"``: the equations hold only to a few per cent, but simulations follow the data; see the
        finding ``forecasts``. ``"doubtful"``: for example, the library does not explain the data, the data do
        not distinguish the terms, the mass matrix is not positive definite, or the solver did not converge. A
        warning states the reason.
    chi2_per_sample : float
        Mean of the squared data residuals in units of the noise; about 1 for a good fit. NaN: not available.
    physics_weight : sequence of float
        Inverse spectral density of the equation error, one per coordinate; empty or NaN: not available.
    warnings : sequence of str, optional
        Sentences in place of `findings`. They become findings with the code ``"text"``.
    findings : sequence of Finding
        Results of all checks: codes and figures for programs, sentences for people. `warnings` and `notes`
        derive from them.
    error_spectrum : sequence of sequences of float, optional
        Spectral density of the equation error over bands of frequencies, for the bands of forecasts: rows of
        a frequency in Hz, the first zero, and of each coordinate's density from there to the next row.
        Empty: the error counts as white.

    Examples
    --------
    >>> FitSummary("ok", 1.02, [1e6]).physics_weight
    (1000000.0,)
    >>> fit = FitSummary("doubtful", warnings=["the shaft is bent"])
    >>> [finding.code for finding in fit.findings], fit.warnings
    (['text'], ('the shaft is bent',))
    """

    status: Status
    chi2_per_sample: float
    physics_weight: tuple[float, ...]
    findings: tuple[Finding, ...]
    error_spectrum: tuple[tuple[float, ...], ...]

    def __init__(
        self,
        status: Status = "ok",
        chi2_per_sample: float = math.nan,
        physics_weight: Iterable[float] = (),
        warnings: Iterable[str] | None = None,
        findings: Iterable[Finding] = (),
        error_spectrum: Iterable[Iterable[float]] = (),
    ) -> None:
        if status not in get_args(Status):
            raise InputError(f"fit: the status is {quoted(status)}; expected 'ok', 'usable' or 'doubtful'")
        weights = _items(physics_weight, "fit: physics_weight", "numbers, one per coordinate")
        found = _each(findings, Finding, "finding", "a Finding")
        if warnings is not None:
            if found:
                raise InputError("fit: warnings follow from the findings; give one of the two")
            found = tuple(map(Finding.of_text, _each(warnings, str, "warning", "text")))
        values = {
            "status": status,
            "chi2_per_sample": as_float(chi2_per_sample, "fit: chi2_per_sample", missing=True, least=0.0),
            "physics_weight": tuple(
                as_float(w, "fit: a physics weight", missing=True, least=0.0) for w in weights
            ),
            "findings": found,
            "error_spectrum": _spectrum(error_spectrum),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings as sentences: the problem and a remedy."""
        return self.sentences("warning")

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes as sentences: changes made to data and library, and further information."""
        return self.sentences("note")

    @property
    def statements(self) -> dict[str, str]:
        """Summaries of ``"structure"``, ``"equations"`` and ``"forecast"`` in words.

        Empty if nothing was fitted.
        """
        return statements(self.findings) if math.isfinite(self.chi2_per_sample) else {}

    @property
    def smoothing_widths(self) -> tuple[float, ...]:
        """The widths in which absolute values of velocities were smoothed; empty if none were.

        Examples
        --------
        >>> FitSummary("ok").smoothing_widths
        ()
        """
        return smoothing_widths(self.findings)

    def sentences(self, severity: Severity, audience: Audience = "python") -> tuple[str, ...]:
        """Return the findings of a severity as text, with remedies for Python, command line or app.

        Findings on forecasts that `statements` covers are not repeated. Terms are written as they were given.

        Examples
        --------
        >>> FitSummary("doubtful", warnings=["the shaft is bent"]).sentences("warning", "page")
        ('the shaft is bent',)
        """
        widths, said = self.smoothing_widths, STATED if self.statements else frozenset[str]()
        found = (f for f in self.findings if f.code not in said and f.severity == severity)
        return tuple(as_given(sentence(f, audience), widths) for f in found)

    @property
    def chi2_note(self) -> str:
        """What `chi2_per_sample` compares with; it tells nothing if the curve passes through the samples."""
        through = self.chi2_per_sample < _THROUGH
        return "the curve passes through the samples" if through else "1 is expected"

    def to_frame(self) -> pd.DataFrame:
        """Return the findings, one a row: their code, severity and subject, the sentence and the remedy."""
        columns = ("code", "severity", "subject", "message", "remedy")
        return data_frame({name: [getattr(one, name) for one in self.findings] for name in columns})

    def _card(self) -> Card:
        lines = [f"{name}: {text}" for name, text in self.statements.items()]
        if math.isfinite(self.chi2_per_sample):
            lines.append(f"chi2 per sample: {self.chi2_per_sample:.3g}, {self.chi2_note}")
        notes = [*(f"warning: {text}" for text in self.warnings), *self.notes]
        return Card(f"fit: {self.status}", lines, notes=notes)


def _spectrum(value: Iterable[Iterable[object]]) -> tuple[tuple[float, ...], ...]:
    label, expected = "fit: error_spectrum", "rows of a frequency and a density for each coordinate"
    rows = [_items(row, label, expected) for row in _items(value, label, expected)]
    numbers = tuple(tuple(as_float(x, label, least=0.0) for x in row) for row in rows)
    begins = [row[0] for row in numbers if row]
    rising = all(a < b for a, b in pairwise(begins)) and begins[:1] in ([], [0.0])
    if not rising or len({len(row) for row in numbers}) > 1 or len(begins) < len(numbers):
        raise InputError(f"{label} is not a table; expected {expected}, the frequencies rising from zero")
    return numbers


def _each(value: Iterable[object], kind: type, one: str, expected: str) -> tuple[Any, ...]:
    for item in (items := _items(value, f"fit: {one}s", f"{one}s")):
        if not isinstance(item, kind):
            raise InputError(f"fit: a {one} is {quoted(item)}; expected {expected}")
    return tuple(items)


def _items(value: Iterable[Any], label: str, expected: str) -> list[Any]:
    if isinstance(value, (str, bytes)):
        raise InputError(f"{label} is {quoted(value)}; expected a sequence of {expected}")
    try:
        return list(value)
    except TypeError:
        raise InputError(f"{label} is {quoted(value)}; expected a sequence of {expected}") from None
