"""Numbers and lists as text."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

__all__ = [
    "aligned",
    "in_powers",
    "listed",
    "percent",
    "plain",
    "plural",
    "signed",
    "typeset",
    "typeset_all",
    "with_power",
]

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:\(\d+\))?(?:e[-+]\d+)?")
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def plain(value: float, digits: int = 3, full: bool = False) -> str:
    """A number for a table, with a proper minus sign and power of ten; `full`: with its trailing zeros.

    Examples
    --------
    >>> plain(-0.00001234), plain(1234567.0), plain(0.5), plain(float("inf")), plain(12345.6, 6)
    ('−1.23 × 10⁻⁵', '1.23 × 10⁶', '0.5', '∞', '12345.6')
    >>> plain(0.5, full=True), plain(120.0, full=True)
    ('0.500', '120')
    """
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return typeset(f"{value:#.{digits}g}".rstrip(".") if full else f"{value:.{digits}g}")


def percent(share: float) -> str:
    """A share in per cent, with two digits, or three beyond 100 %.

    Examples
    --------
    >>> percent(0.0092), percent(0.04), percent(1.234), percent(float("inf")), percent(float("nan"))
    ('0.92 %', '4.0 %', '123 %', '∞', '–')
    """
    value = 100 * share
    return plain(value, 3 if abs(value) >= 100 else 2, full=True) + (" %" if math.isfinite(value) else "")


def typeset(text: str) -> str:
    """Python's ``-1.2e-05`` with a minus sign and a power of ten."""
    mantissa, _, exponent = text.partition("e")
    mantissa = mantissa.replace("-", "−")
    return f"{mantissa} × 10{str(int(exponent)).translate(_SUPERSCRIPTS)}" if exponent else mantissa


def typeset_all(text: str) -> str:
    """Every number of a text with a minus sign and a power of ten.

    Examples
    --------
    >>> typeset_all("x -0.5, y 1.2(3)e-05 1/s")
    'x −0.5, y 1.2(3) × 10⁻⁵ 1/s'
    """
    return _NUMBER.sub(lambda found: typeset(found[0]), text)


def signed(value: float, decimals: int | None = None) -> str:
    """A difference, with its sign.

    Examples
    --------
    >>> signed(3.14159), signed(-291.4), signed(2.5e7), signed(-0.456, 2), signed(-0.001, 2)
    ('+3.1', '−291', '+2.50 × 10⁷', '−0.46', '0.00')
    """
    if decimals is not None:
        text = f"{value:+.{decimals}f}"
        return typeset(text) if float(text) else text[1:]
    return typeset(
        f"{value:+.1f}" if abs(value) < 100 else f"{value:+.0f}" if abs(value) < 1e6 else f"{value:+.2e}"
    )


def aligned(values: Sequence[float], digits: int = 3) -> list[str]:
    """The numbers of one column with the same number of decimals, unless they differ too much for that.

    Examples
    --------
    >>> aligned([0.0051, 0.000995, 0.00209]), aligned([float("nan"), 1.0, 2e-9])
    (['0.00510', '0.00100', '0.00209'], ['–', '1.00', '2.00 × 10⁻⁹'])
    """
    sizes = [abs(v) for v in values if math.isfinite(v) and v]
    if not sizes or min(sizes) < 0.01 * max(sizes) or not 1e-4 <= max(sizes) < 1e5:
        return [plain(v, digits, full=True) for v in values]
    decimals = max(0, digits - 1 - math.floor(math.log10(max(sizes))))
    return [
        typeset(f"{v:.{decimals}f}") if math.isfinite(v) else plain(v) for v in map(float, np.array(values))
    ]


def plural(n: int, one: str, many: str) -> str:
    """Count and noun, with a thousands separator from five digits on.

    Examples
    --------
    >>> plural(1, "trial", "trials"), plural(9999, "sample", "samples")
    ('1 trial', '9999 samples')
    """
    count = f"{n:,}".replace(",", "\u202f") if n >= 10_000 else str(n)
    return f"{count} {one if n == 1 else many}"


def listed(names: Sequence[str], limit: int = 8) -> str:
    """Names in a row; names beyond the limit are counted."""
    more = len(names) - limit
    return ", ".join(names) if more <= 1 else f"{', '.join(names[:limit])} and {more} more"


def in_powers(level: int) -> str:
    """The value at an integer position of a folded axis.

    Examples
    --------
    >>> in_powers(2), in_powers(-4), in_powers(0)
    ('100', '−10⁴', '0')
    """
    size = str(10 ** abs(level)) if abs(level) <= 3 else f"10{str(abs(level)).translate(_SUPERSCRIPTS)}"
    return f"{'−' if level < 0 else ''}{size}" if level else "0"


def with_power(quantity: str, power: int, unit: str) -> str:
    """A quantity with the factor of its numbers and its unit.

    Examples
    --------
    >>> with_power("x", -6, "m"), with_power("x", 0, "m"), with_power("x", 3, ""), with_power("x", 0, "")
    ('x (10⁻⁶ m)', 'x (m)', 'x (10³)', 'x')
    """
    scale = f"10{str(power).translate(_SUPERSCRIPTS)}" if power else ""
    inside = f"{scale} {unit}".strip()
    return f"{quantity} ({inside})" if inside else quantity
