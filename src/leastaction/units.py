r"""Units of the coefficients, and whether a library is consistent with the units of the data.

L is an energy, so λ_k has the unit of energy divided by that of φ_k. The dissipation function is a power.
Numbers inside an expression are pure, except that a number added to a quantity has the unit of that quantity,
such as the 0.01 in ``sqrt(x_dot**2 + 0.01)``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import sympy as sp

from leastaction.data.validation import close_match, listed
from leastaction.errors import InputError, MissingPackageError
from leastaction.findings import as_given
from leastaction.identifiers import quoted
from leastaction.library import Library, time_symbol
from leastaction.model.model import LagrangianModel

__all__ = ["CoefficientUnit", "check"]

# Names, small whole numbers, products, quotients and powers of names: what pint then computes is small.
_SAFE = re.compile(r"(?:[A-Za-zµμΩΩ°Å_]+|(?<![\d.])\d{1,2}(?![\d.])|\*\*|[\s*/^·()\-])+")
_POWER_OF_NUMBER = re.compile(r"[\d)]\s*(?:\*\*|\^)|(?:\*\*|\^)\s*-?\s*[^\d\s-]")
_LONGEST = 60
_CURE = "measure it in units of a length (or time, …) of the system, and give it the unit '1'"


class CoefficientUnit(NamedTuple):
    """Unit of the coefficient of one term.

    Attributes
    ----------
    expression : str
        The term.
    kind : {"lagrangian", "dissipation"}
    unit : str
        Such as ``"N·s²/m"``; ``"1"`` for a pure number.
    """

    expression: str
    kind: str
    unit: str


def check(
    what: LagrangianModel | Library,
    units: Mapping[str, str],
    forces: Mapping[str, str] | None = None,
    *,
    time: str = "s",
    energy: str | None = None,
) -> tuple[CoefficientUnit, ...]:
    """Check the units of a model or library, and return the unit of every coefficient.

    Needs ``pip install 'leastaction[units]'``.

    Parameters
    ----------
    what : LagrangianModel or Library
    units : mapping of str to str
        Unit of every coordinate, e.g. ``{"x": "m", "theta": "rad"}``; ``"1"`` for a pure number.
    forces : mapping of str to str, optional
        Units of the generalised forces by coordinate; some may be omitted.
    time : str
        Unit of the times; "1" for pure numbers.
    energy : str, optional
        Unit of L. By default, force times coordinate if forces are given, otherwise joule. If L is known only
        up to a factor, `known` sets its unit: with ``known={"theta_dot**2": 1}`` it is
        ``"rad**2/s**2"``.

    Returns
    -------
    tuple of CoefficientUnit
        Terms of L, then of the dissipation function. Radians are left out.

    Raises
    ------
    InputError
        If a unit is unknown or missing; if a sine, cosine, tangent, exponential or logarithm has an argument
        with a unit (including degrees: functions take radians); if quantities of different units are added;
        if force times coordinate differs from the energy, even by a factor (N·mm is not J); or if pint is not
        installed.

    Examples
    --------
    >>> import leastaction as la
    >>> library = la.Library(["x_dot**2", "theta_dot**2", "x", "cos(theta)"], ["x", "theta"])
    >>> library = library.with_dissipation(["x_dot**2/2"])
    >>> for item in la.units.check(library, {"x": "m", "theta": "rad"}, {"x": "N"}):
    ...     print(item.expression, "|", item.unit)
    x_dot**2 | N·s²/m
    theta_dot**2 | N·m·s²
    x | N
    cos(theta) | N·m
    x_dot**2/2 | N·s/m
    >>> la.units.check(library, {"x": "m", "theta": "deg"})
    Traceback (most recent call last):
    ...
    leastaction.errors.InputError: cos(theta): the argument theta has the unit deg; functions ...
    """
    registry = _registry()
    terms = _terms(what)
    coordinates = what.coordinates
    for name in (*units, *(forces or {})):
        if name not in coordinates:
            hint = close_match(name, coordinates) if isinstance(name, str) else ""
            raise InputError(
                f"{quoted(name)} is not a coordinate; the coordinates are {listed(coordinates)}{hint}"
            )
    missing = [name for name in coordinates if name not in units]
    if missing:
        raise InputError(f"the unit of {missing[0]} is missing; give one for each of {listed(coordinates)}")
    second = _unit(registry, time, "time")
    if time.strip() != "1" and not _same(second, registry.Unit("s"), scale=False):
        raise InputError(
            f"the unit of time is {quoted(time)}, which is not a time; expected one such as 's' or 'ms'"
        )
    known = {sp.Symbol(c, real=True): _unit(registry, units[c], c) for c in coordinates}
    known |= {sp.Symbol(f"{c}_dot", real=True): known[sp.Symbol(c, real=True)] / second for c in coordinates}
    known[time_symbol] = second
    total = _energy(registry, {c: known[sp.Symbol(c, real=True)] for c in coordinates}, forces or {}, energy)
    out = []
    for text, kind, expression in terms:
        own = _Walk(registry, known, text).unit(expression) or registry.Unit("")
        whole = total if kind == "lagrangian" else total / second
        out.append(CoefficientUnit(text, kind, _text(registry, whole / own)))
    return tuple(out)


def _terms(what: LagrangianModel | Library) -> list[tuple[str, str, sp.Expr]]:
    if isinstance(what, Library):
        return [(term.text, term.kind, term.expr) for term in (*what.terms, *what.dissipation)]
    if isinstance(what, LagrangianModel):
        parts = (
            ("lagrangian", what.terms, what.expressions),
            ("dissipation", what.dissipation, what.dissipation_expressions),
        )
        widths = what.fit.smoothing_widths
        return [
            (as_given(t.expression, widths), kind, e)
            for kind, ts, es in parts
            for t, e in zip(ts, es, strict=True)
        ]
    raise InputError(f"{quoted(what)} has no units to check; pass a model or a Library")


def _energy(
    registry: Any, coordinates: Mapping[str, Any], forces: Mapping[str, str], energy: str | None
) -> Any:
    """Return the unit of L, after comparing it with force times coordinate."""
    total = None if energy is None else _unit(registry, energy, "energy")
    origin = f"the energy in {energy}"
    for name, text in forces.items():
        product = _unit(registry, text, f"the force on {name}") * coordinates[name]
        if total is None:
            total, origin = product, f"force times coordinate of {name}, {_text(registry, product)}"
        elif not _same(product, total):
            factor = ", but for a factor" if _same(product, total, scale=False) else ""
            raise InputError(
                f"the force on {name} in {text} times {name} is {_text(registry, product)}, not "
                f"{origin}{factor}; check the units, or convert the data"
            )
    return registry.Unit("J") if total is None else total


class _Walk:
    """Units of the parts of one term; None stands for a pure number, which fits everywhere."""

    def __init__(self, registry: Any, known: Mapping[sp.Symbol, Any], term: str) -> None:
        self.registry, self.known, self.term = registry, known, term

    def unit(self, e: sp.Expr) -> Any:
        if not e.free_symbols:
            return None
        if isinstance(e, sp.Symbol):
            return self.known[e]
        if isinstance(e, sp.Mul):
            out = self.registry.Unit("")
            for part in e.args:
                own = self.unit(part)
                out = out if own is None else out * own
            return out
        if isinstance(e, sp.Add):
            return self._sum(e)
        if isinstance(e, sp.Abs):
            return self.unit(e.args[0])
        if isinstance(e, sp.Pow) and not e.exp.free_symbols and e.base is not sp.E:
            return self.unit(e.base) ** float(e.exp)
        # sin, cos, tan, exp, log
        for part in e.args:
            self._pure(part)
        return self.registry.Unit("")

    def _sum(self, e: sp.Expr) -> Any:
        parts = [part for part in e.args if part.free_symbols]
        first = self.unit(parts[0])
        for part in parts[1:]:
            own = self.unit(part)
            if not _same(own, first):
                raise InputError(
                    f"{self.term}: adds {parts[0]} ({_text(self.registry, first)}) and {part} "
                    f"({_text(self.registry, own)}); what is added must have one unit"
                )
        return first

    def _pure(self, part: sp.Expr) -> None:
        own = self.unit(part)
        pure = self.registry.Unit("")
        if own is None or _same(own, pure):
            return
        if _same(own, pure, scale=False):
            cure = "functions take radians, or pure numbers: convert the data"
        else:
            cure = f"expected a pure number: {_CURE}"
        raise InputError(f"{self.term}: the argument {part} has the unit {_text(self.registry, own)}; {cure}")


def _same(a: Any, b: Any, *, scale: bool = True) -> bool:
    """Whether two units have the same dimension, and with `scale` also the same size."""
    ratio = 1 * (a / b)
    if not ratio.dimensionless:
        return False
    return not scale or abs(ratio.to_base_units().magnitude - 1.0) < 1e-12


def _text(registry: Any, unit: Any) -> str:
    """Return a unit as people write it, mass or force first and time last, without radians."""
    parts = []
    for name, power in (1 * unit).unit_items():
        if name != "radian" and power:
            dimensions = dict(registry.Unit(name).dimensionality)
            rank = 0 if "[mass]" in dimensions else 2 if set(dimensions) == {"[time]"} else 1
            parts.append((rank, f"{registry.Unit(name):~P}", power))
    above = "·".join(symbol + _power(power) for _, symbol, power in sorted(parts) if power > 0)
    below = "/".join(symbol + _power(-power) for _, symbol, power in sorted(parts) if power < 0)
    return f"{above or '1'}/{below}" if below else above or "1"


def _power(power: float) -> str:
    if power == 1:
        return ""
    if float(power).is_integer():
        return str(int(power)).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"^{power:g}"


def _unit(registry: Any, text: object, of: str) -> Any:
    form = "expected a unit such as 'm', 'rad', 'N*m' or 'kg*m**2/s**2'"
    if not isinstance(text, str) or not text.strip():
        raise InputError(f"the unit of {of} is {quoted(text)}; {form}, or '1' for a pure number")
    if text.strip() == "1":
        return registry.Unit("")
    import pint

    bad = len(text) > _LONGEST or not _SAFE.fullmatch(text) or _POWER_OF_NUMBER.search(text)
    try:
        if bad:
            raise InputError
        unit = registry.Unit(text)
        (1 * unit).to_base_units()
    except pint.UndefinedUnitError as error:
        raise InputError(f"the unit of {of} is {quoted(text)}, but {error}; {form}") from None
    except Exception:  # whatever a foreign parser makes of a foreign text
        raise InputError(f"the unit of {of} is {quoted(text)}; {form}") from None
    return unit


@lru_cache(maxsize=1)
def _registry() -> Any:
    try:
        import pint
    except ImportError:
        raise MissingPackageError("checking units", "pint", "units") from None
    return pint.UnitRegistry()
