"""Ranges of the start values of shape parameters: from the user, or from the role of a parameter in its term.

In ``exp(-{a}*x)`` a is compared with 1/x, in ``(x-{p})**2`` p with x, in ``x**2+{h}**2`` h with |x|, and in
``r**{n}`` n is an exponent.  The data therefore give a range if the user does not.  Start values are taken
from this range.  Only ranges from the user, and the range of the speeds of Stribeck friction, are bounds.

In ``cos({w}*t)`` w is a frequency, and its likelihood has many maxima: A cos wt resembles A₀ cos w₀t only
while (w − w₀) t stays below a quarter of a turn.  Start values are therefore a quarter of a turn apart at the
latest time, from half a turn over the recording to the highest frequency that the knots of the curve resolve.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import sympy as sp

from leastaction.errors import InputError
from leastaction.estimation.settings import ESTIMATION
from leastaction.identifiers import quoted
from leastaction.library import Term, is_constant, shape_names, shape_symbol, time_symbol
from leastaction.library.parser import MAX_EXPONENT

__all__ = ["ShapeRange", "check_numbers", "frequency_range", "shape_ranges", "shape_starts"]

_QUARTER = np.pi / 2.0  # of a turn
_MOST_FREQUENCIES = 4000  # bounds time
_PHASES = 4  # values of other parameters for each frequency
# start values: the powers of physical laws
_EXPONENTS = (-12.0, -9.0, -6.0, -4.0, -3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.5, 1.5, 2.5, 3.0, 4.0, 5.0, 6.0)


@dataclass(frozen=True)
class ShapeRange:
    """Range of the start values of a shape parameter.

    Attributes
    ----------
    low, high : float
        In the units of the parameter.
    spacing : {"linear", "log", "exponent", "frequency"}
        Of the start values.
    bounded : bool
        Whether the parameter must stay in the range, because the user gave it, or because the data cannot
        determine values outside.
    apart : float
        Spacing of the start values of a frequency.
    """

    low: float
    high: float
    spacing: Literal["linear", "log", "exponent", "frequency"]
    bounded: bool = False
    apart: float = 0.0

    def starts(self, count: int) -> np.ndarray:
        """About ``count`` rising values over the range; for a frequency, as many as its spacing requires."""
        if self.spacing == "frequency":
            return np.linspace(self.low, self.high, 1 + int(np.ceil((self.high - self.low) / self.apart)))
        if self.spacing == "exponent":
            inside = [x for x in _EXPONENTS if self.low <= x <= self.high]
            if len(inside) > 2:
                return np.array(inside)
        if self.spacing == "log":
            return np.geomspace(self.low, self.high, count)
        edge = 0.5 * (self.high - self.low) / count
        return np.linspace(self.low + edge, self.high - edge, count)

    def at(self, share: float) -> float:
        """The value at a share of the range, between 0 and 1."""
        if self.spacing == "log":
            return float(self.low ** (1.0 - share) * self.high**share)
        return float(self.low + share * (self.high - self.low))

    def share(self, number: float) -> float:
        """The share of the range at which a value lies; the inverse of `at` inside it."""
        if self.spacing == "log":
            return float(np.log(max(number, 1e-300) / self.low) / np.log(self.high / self.low))
        return (number - self.low) / (self.high - self.low)

    def stepped(self, value: float, step: float) -> float:
        """The value after a step, which is limited to half of the value (or of a quarter of a linear range).

        A step of a frequency is limited to the spacing of its start values. A bounded parameter stays within
        its bounds, and an exponent among those that an expression may have.
        """
        size = abs(value) if self.spacing == "log" else max(abs(value), 0.25 * (self.high - self.low))
        most = self.apart if self.spacing == "frequency" else ESTIMATION.shape_step * size
        moved = value + float(np.clip(step, -most, most))
        if self.spacing == "exponent":
            moved = float(np.clip(moved, -MAX_EXPONENT, MAX_EXPONENT))
        return float(np.clip(moved, self.low, self.high)) if self.bounded else moved


def shape_starts(ranges: Mapping[str, ShapeRange], count: int) -> Iterator[dict[str, float]]:
    """About ``count`` start values over the ranges: evenly for one parameter, a Sobol sequence for several.

    Each frequency is combined with a few values of the other parameters.

    Examples
    --------
    >>> list(shape_starts({"a": ShapeRange(1.0, 4.0, "log")}, 3))
    [{'a': 1.0}, {'a': 2.0}, {'a': 4.0}]
    """
    if len(ranges) == 1:
        ((name, only),) = ranges.items()
        yield from ({name: x} for x in only.starts(count).tolist())
        return
    frequencies = [name for name, r in ranges.items() if r.spacing == "frequency"]
    if frequencies:
        others = {name: r for name, r in ranges.items() if name != frequencies[0]}
        for x in ranges[frequencies[0]].starts(count).tolist():
            yield from ({**rest, frequencies[0]: x} for rest in shape_starts(others, _PHASES))
        return
    from scipy.stats import qmc  # takes half a second to import

    shares = qmc.Sobol(len(ranges), seed=0).random_base2(int(np.ceil(np.log2(count))))
    for row in shares[:count]:
        yield {name: r.at(x) for (name, r), x in zip(ranges.items(), row.tolist(), strict=True)}


def shape_ranges(
    terms: Sequence[Term],
    states: Mapping[str, np.ndarray],
    given: Mapping[str, tuple[float, float]],
    of_sensors: Sequence[str] = (),
) -> dict[str, ShapeRange]:
    """Range of every shape parameter of some terms.

    Parameters
    ----------
    terms : sequence of Term
    states : mapping of str to (n_points,) array
        Coordinates and velocities at points of the data.
    given : mapping of str to (low, high)
        Ranges from the user.
    of_sensors : sequence of str
        Calibration numbers, for messages.

    Raises
    ------
    InputError
        If ``given`` names something that is not a shape parameter, or a value is not a range.
    """
    names = shape_names(terms)
    for name, ends in given.items():
        if name not in names:
            listing = ", ".join(names) or "none; write one as exp(-{a}*x)"
            neither = f"a shape parameter of the library (it has {listing})"
            what = f"not {neither}"
            if of_sensors:
                what = f"neither {neither} nor one of the calibration numbers ({', '.join(of_sensors)})"
            raise InputError(f"shapes names {quoted(name)}, which is {what}")
        _check_ends(name, ends)
    out: dict[str, ShapeRange] = {}
    for name in names:
        bearers = [t for t in terms if name in t.shapes]
        found = _from_part(shape_symbol(name), [t.expr for t in bearers], states)
        if all(t.kind == "dissipation" for t in bearers):
            found = _of_speeds(shape_symbol(name), bearers, states) or found
        if name in given:
            low, high = map(float, given[name])
            if found.spacing == "frequency":
                out[name] = _checked(name, replace(found, low=low, high=high, bounded=True))
                continue
            log = low > 0.0 and found.spacing != "exponent" and high > ESTIMATION.shape_scales * low
            spacing = "log" if log else "exponent" if found.spacing == "exponent" else "linear"
            found = ShapeRange(low, high, spacing, bounded=True)
            if spacing == "exponent" and max(-low, high) > MAX_EXPONENT:
                raise InputError(
                    f"the range of the exponent {quoted(name)} is {low:g} to {high:g}; expected exponents of "
                    f"at most ±{MAX_EXPONENT}"
                )
        out[name] = _checked(name, found)
    return out


def _checked(name: str, found: ShapeRange) -> ShapeRange:
    """The range; refuses a range with too many frequencies."""
    if found.spacing == "frequency" and found.high - found.low > _MOST_FREQUENCIES * found.apart:
        raise InputError(
            f"the frequency {{{name}}} needs more than {_MOST_FREQUENCIES} start values between "
            f"{found.low:.4g} and {found.high:.4g}, {found.apart:.2g} apart; give a narrower range in "
            "shapes, or shift the times of the data so that they start near zero"
        )
    return found


def check_numbers(starts: Mapping[str, float], ranges: Mapping[str, tuple[float, float]]) -> None:
    """Refuse ranges of calibration numbers that are none, and start values outside of theirs."""
    for name, ends in ranges.items():
        _check_ends(name, ends, "calibration number")
        if name in starts and not ends[0] <= starts[name] <= ends[1]:
            raise InputError(
                f"the start value of {{{name}}} is {starts[name]:g}; expected a value in its range, "
                f"{ends[0]:g} to {ends[1]:g}; change one of them, or leave one out"
            )


def _check_ends(name: str, ends: object, what: str = "shape parameter") -> None:
    try:
        low, high = map(float, ends)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        low = high = np.nan
    if not (np.isfinite([low, high]).all() and low < high):
        raise InputError(
            f"the range of the {what} {quoted(name)} is {quoted(ends)}; expected (low, high) with low < high"
        )


def _from_part(
    symbol: sp.Symbol, expressions: Sequence[sp.Expr], states: Mapping[str, np.ndarray]
) -> ShapeRange:
    """The range of a parameter from the expression that it is added to, a factor of, or an exponent of."""
    for expr in expressions:
        chain = _ancestors(expr, symbol)
        found = _in_wave(symbol, chain, states)
        if found is not None:
            return found
        for place in range(len(chain) - 1, 0, -1):
            child, parent = chain[place], chain[place - 1]
            above = chain[place - 2] if place > 1 else None
            found = _compared(symbol, child, parent, above, states)
            if found is not None:
                return found
    return ShapeRange(1.0 / ESTIMATION.shape_scales, ESTIMATION.shape_scales, "log")


def _of_speeds(
    symbol: sp.Symbol, terms: Sequence[Term], states: Mapping[str, np.ndarray]
) -> ShapeRange | None:
    """The range of a scale of speeds v_s in exp(−|v|/v_s) that differs from dry and viscous friction.

    Far below the usual speed, the smoothing of |v| hides it. Above, exp(−|v|/v_s) is a straight line.
    """
    for decay in (part for term in terms for part in term.expr.atoms(sp.exp)):
        speed = -sp.simplify(decay.args[0] * symbol)
        if not is_constant(speed) and all(str(s).endswith("_dot") for s in speed.free_symbols):
            usual = _rms(_values(speed, states))
            low, high = (usual * share for share in ESTIMATION.stribeck_scales)
            return ShapeRange(low, high, "log", bounded=True)
    return None


def _in_wave(
    symbol: sp.Symbol, chain: Sequence[sp.Basic], states: Mapping[str, np.ndarray]
) -> ShapeRange | None:
    """The range of a frequency or phase: a factor of the time, or a summand, in a sine or cosine."""
    wave = next((part for part in chain if isinstance(part, sp.sin | sp.cos)), None)
    if wave is None or time_symbol not in wave.free_symbols:
        return None
    angle = wave.args[0]
    rate, slope = sp.diff(angle, time_symbol), sp.diff(angle, symbol)
    if symbol in rate.free_symbols and _still(rate):
        scale = abs(float(sp.diff(rate, symbol).xreplace({s: sp.Float(1.0) for s in rate.free_symbols})))
        return frequency_range(states[str(time_symbol)], scale)
    if _still(slope) and _still(angle - time_symbol * rate):
        return ShapeRange(0.0, np.pi, "linear")  # the coefficient gives the sign of the wave
    return None


def frequency_range(times: np.ndarray, scale: float = 1.0, most: float = np.inf) -> ShapeRange:
    """Frequencies that a recording determines, from half a turn over it to the resolution of its points.

    Parameters
    ----------
    times : (n_points,) array
        Of the points, trajectory by trajectory.
    scale : float
        Factor between the parameter and a frequency in rad/s.
    most : float
        Largest number of frequencies; if there are more, the highest are left out.

    Examples
    --------
    >>> found = frequency_range(np.linspace(0.0, 10.0, 101))
    >>> round(found.low, 3), round(found.high, 3), round(found.apart, 3)
    (0.314, 10.0, 0.157)
    """
    latest, steps = float(np.abs(times).max()), np.diff(times)
    resolved = 1.0 / float(np.median(steps[steps > 0.0]))
    low, apart = np.pi / float(np.ptp(times)), _QUARTER / latest
    high = min(resolved, low + most * apart)
    return ShapeRange(low / scale, high / scale, "frequency", apart=apart / scale)


def _ancestors(expr: sp.Expr, symbol: sp.Symbol) -> list[sp.Basic]:
    """From the expression down to the symbol, along its first occurrence."""
    chain: list[sp.Basic] = [expr]
    while chain[-1] != symbol:
        chain.append(next(part for part in chain[-1].args if symbol in part.free_symbols))
    return chain


def _compared(
    symbol: sp.Symbol, child: Any, parent: Any, above: Any, states: Mapping[str, np.ndarray]
) -> ShapeRange | None:
    """The range, if the parent compares the child with a quantity that varies; otherwise None."""
    if isinstance(parent, sp.Pow) and parent.exp == child:
        return None if _still(parent.base) else ShapeRange(_EXPONENTS[0], _EXPONENTS[-1], "exponent")
    others: list[Any] = [part for part in parent.args if part != child and not _still(part)]
    if not others:
        return None
    if parent.is_Add:
        against = -_values(sp.Add(*others), states)
        slope = sp.diff(child, symbol)
        if not slope.free_symbols:
            ends = np.array([against.min(), against.max()]) / float(slope)
            return _around(ends)
        size = _where(child, symbol, float(np.abs(against).max()))
        return ShapeRange(ESTIMATION.shape_smallest * size, size, "log")
    if parent.is_Mul:
        size = _rms(_values(sp.Mul(*others), states))
        around = above if above is not None and above.is_Add else sp.Add()
        moving: list[Any] = [part for part in around.args if part != parent and not _still(part)]
        scale = _rms(_values(sp.Add(*moving), states)) if moving else 1.0
        middle = _where(child, symbol, scale / max(size, 1e-300))
        return ShapeRange(middle / ESTIMATION.shape_scales, middle * ESTIMATION.shape_scales, "log")
    return None


def _still(expr: Any) -> bool:
    """Whether an expression contains neither coordinate nor velocity."""
    return is_constant(expr)


def _around(ends: np.ndarray) -> ShapeRange:
    low, high = float(ends.min()), float(ends.max())
    margin = ESTIMATION.shape_beyond * max(high - low, 1e-12 * max(abs(low), abs(high)), 1e-300)
    return ShapeRange(low - margin, high + margin, "linear")


def _where(expr: sp.Expr, symbol: sp.Symbol, size: float) -> float:
    """The positive value of the symbol at which an expression of it is nearest to a size."""
    trial = size * np.geomspace(1e-6, 1e6, 121) if size > 0.0 else np.ones(1)
    trial = np.unique(np.concatenate([trial, np.sqrt(trial), np.geomspace(1e-3, 1e3, 61)]))
    ones = {s: 1.0 for s in expr.free_symbols if s != symbol}
    function = sp.lambdify([symbol], expr.xreplace(ones), modules="numpy", dummify=True)
    with np.errstate(all="ignore"):
        reached = np.abs(np.broadcast_to(np.asarray(function(trial), dtype=float), trial.shape))
    gap = np.abs(np.log(np.maximum(reached, 1e-300) / max(size, 1e-300)))
    return float(trial[np.nanargmin(gap)])


def _values(expr: sp.Expr, states: Mapping[str, np.ndarray]) -> np.ndarray:
    """(n_points,) finite values of an expression along the data, other shape parameters at one."""
    names = sorted(states)
    ones = {s: sp.Float(1.0) for s in expr.free_symbols if is_constant(s)}
    symbols = [sp.Symbol(name, real=True) for name in names]
    function = sp.lambdify(symbols, expr.xreplace(ones), modules="numpy", dummify=True)
    points = [states[name] for name in names]
    with np.errstate(all="ignore"):
        values = np.broadcast_to(np.asarray(function(*points), dtype=float), points[0].shape)
    finite = values[np.isfinite(values)]
    return finite if finite.size else np.ones(1)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
