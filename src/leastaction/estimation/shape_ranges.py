"""Where to look for shape parameters: ranges from the user, or from the part that a parameter plays.

In ``exp(-{a}*x)`` a is compared with 1/x, in ``(x-{p})**2`` p with x, in ``x**2+{h}**2`` h with |x|, and in
``r**{n}`` n is an exponent.  So the data give a range wherever the user gives none.  It says where starts are
tried; bounds are only a range from the user, and that of the speeds of Stribeck friction.

In ``cos({w}*t)`` w is a frequency, and its likelihood is a comb: A cos wt looks like A₀ cos w₀t as long as
(w − w₀) t stays below a quarter of a turn at all times.  So starts are a quarter of a turn apart at the
latest time, from half a turn over the recording to what the knots of the curve resolve.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import sympy as sp
from scipy.stats import qmc

from leastaction.errors import InputError
from leastaction.estimation.settings import ESTIMATION
from leastaction.identifiers import quoted
from leastaction.library import Term, is_constant, shape_names, shape_symbol, time_symbol

__all__ = ["ShapeRange", "frequency_range", "shape_ranges", "shape_starts"]

_QUARTER = np.pi / 2.0  # of a turn
_MOST_FREQUENCIES = 4000  # bounds time
_PHASES = 4  # numbers of other parameters beside each frequency
# tried as starts: the powers of laws
_EXPONENTS = (-12.0, -9.0, -6.0, -4.0, -3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.5, 1.5, 2.5, 3.0, 4.0, 5.0, 6.0)


@dataclass(frozen=True)
class ShapeRange:
    """Where starts of a shape parameter are tried.

    Attributes
    ----------
    low, high : float
        In the units of the parameter.
    spacing : {"linear", "log", "exponent", "frequency"}
        Of the starts.
    bounded : bool
        Whether the parameter has to stay there, because the user said so, or the data tell no other.
    apart : float
        How far apart the starts of a frequency are.
    """

    low: float
    high: float
    spacing: Literal["linear", "log", "exponent", "frequency"]
    bounded: bool = False
    apart: float = 0.0

    def starts(self, count: int) -> np.ndarray:
        """About ``count`` numbers over the range, rising; as many frequencies as it takes."""
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
        """The number at a share of the range, between 0 and 1."""
        if self.spacing == "log":
            return float(self.low ** (1.0 - share) * self.high**share)
        return float(self.low + share * (self.high - self.low))

    def share(self, number: float) -> float:
        """Where a number lies in the range; the inverse of `at` inside it."""
        if self.spacing == "log":
            return float(np.log(max(number, 1e-300) / self.low) / np.log(self.high / self.low))
        return (number - self.low) / (self.high - self.low)

    def stepped(self, value: float, step: float) -> float:
        """The value after a step, no farther than half of it (or of a quarter of a linear range).

        A frequency goes no farther than its starts are apart.

        What the user has bounded stays within its bounds.
        """
        size = abs(value) if self.spacing == "log" else max(abs(value), 0.25 * (self.high - self.low))
        most = self.apart if self.spacing == "frequency" else ESTIMATION.shape_step * size
        moved = value + float(np.clip(step, -most, most))
        return float(np.clip(moved, self.low, self.high)) if self.bounded else moved


def shape_starts(ranges: Mapping[str, ShapeRange], count: int) -> Iterator[dict[str, float]]:
    """About ``count`` numbers over the ranges: even for one parameter, a Sobol sequence for several.

    Beside each frequency a few numbers of the others.

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
    shares = qmc.Sobol(len(ranges), seed=0).random_base2(int(np.ceil(np.log2(count))))
    for row in shares[:count]:
        yield {name: r.at(x) for (name, r), x in zip(ranges.items(), row.tolist(), strict=True)}


def shape_ranges(
    terms: Sequence[Term], states: Mapping[str, np.ndarray], given: Mapping[str, tuple[float, float]]
) -> dict[str, ShapeRange]:
    """Range of every shape parameter of some terms.

    Parameters
    ----------
    terms : sequence of Term
    states : mapping of str to (n_points,) array
        Coordinates and velocities at points of the data.
    given : mapping of str to (low, high)
        What the user said.

    Raises
    ------
    InputError
        If what was given names no shape parameter, or is no range.
    """
    names = shape_names(terms)
    for name, ends in given.items():
        if name not in names:
            listing = ", ".join(names) or "none; write one as exp(-{a}*x)"
            raise InputError(
                f"shapes names {quoted(name)}, which is not a shape parameter of the library (it has "
                f"{listing})"
            )
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
        out[name] = _checked(name, found)
    return out


def _checked(name: str, found: ShapeRange) -> ShapeRange:
    """The range, unless it holds more frequencies than can be tried."""
    if found.spacing == "frequency" and found.high - found.low > _MOST_FREQUENCIES * found.apart:
        raise InputError(
            f"the frequency {{{name}}} would have to be tried at more than {_MOST_FREQUENCIES} numbers "
            f"between {found.low:.4g} and {found.high:.4g}, {found.apart:.2g} apart; give a narrower range "
            "in shapes, or let the times of the data begin near zero"
        )
    return found


def _check_ends(name: str, ends: object) -> None:
    try:
        low, high = map(float, ends)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        low = high = np.nan
    if not (np.isfinite([low, high]).all() and low < high):
        raise InputError(
            f"the range of the shape parameter {quoted(name)} is {quoted(ends)}; expected (low, high) with "
            "low < high"
        )


def _from_part(
    symbol: sp.Symbol, expressions: Sequence[sp.Expr], states: Mapping[str, np.ndarray]
) -> ShapeRange:
    """The range of a parameter from what it is added to, multiplied with, or an exponent of."""
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
    """The range of a scale of speeds v_s in exp(−|v|/v_s): what friction can tell from dry and viscous.

    Far below the usual speed it is lost where |v| is smoothed; above, exp(−|v|/v_s) is a line.
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
    """The range of a frequency or phase: what stands beside the time in a sine or cosine."""
    wave = next((part for part in chain if isinstance(part, sp.sin | sp.cos)), None)
    if wave is None or time_symbol not in wave.free_symbols:
        return None
    angle = wave.args[0]
    rate, slope = sp.diff(angle, time_symbol), sp.diff(angle, symbol)
    if symbol in rate.free_symbols and _still(rate):
        scale = abs(float(sp.diff(rate, symbol).xreplace({s: sp.Float(1.0) for s in rate.free_symbols})))
        return frequency_range(states[str(time_symbol)], scale)
    if _still(slope) and _still(angle - time_symbol * rate):
        return ShapeRange(0.0, np.pi, "linear")  # the sign of the wave is that of its coefficient
    return None


def frequency_range(times: np.ndarray, scale: float = 1.0, most: float = np.inf) -> ShapeRange:
    """Frequencies that a recording can tell, from half a turn over it to what its points resolve.

    Parameters
    ----------
    times : (n_points,) array
        Of the points, one trajectory after another.
    scale : float
        Turns the number into a frequency in rad/s.
    most : float
        Frequencies that are tried; with fewer than it takes, the highest are left out.

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
    """The range, where the parent compares the child with something that moves; else None."""
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
    """Whether no coordinate or velocity is in it."""
    return is_constant(expr)


def _around(ends: np.ndarray) -> ShapeRange:
    low, high = float(ends.min()), float(ends.max())
    margin = ESTIMATION.shape_beyond * max(high - low, 1e-12 * max(abs(low), abs(high)), 1e-300)
    return ShapeRange(low - margin, high + margin, "linear")


def _where(expr: sp.Expr, symbol: sp.Symbol, size: float) -> float:
    """The positive number at which an expression of the symbol alone comes nearest to a size."""
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
