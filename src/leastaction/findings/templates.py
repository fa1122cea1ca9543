"""How a finding reads, a severity and templates over its subject and figures; and words for reasons."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from string import Formatter
from typing import Any, Literal

from leastaction.findings.finding import Severity

__all__ = [
    "REASONS",
    "UNITS",
    "Audience",
    "Message",
    "Text",
    "another_structure",
    "because",
    "converted_units",
    "fill",
    "rate_scaled",
    "time_unit",
    "zero_offset",
]

Audience = Literal["python", "command line", "page"]
Text = str | Callable[[dict[str, Any]], str]


@dataclass(frozen=True)
class Message:
    """How the findings of one code read.

    Attributes
    ----------
    severity : Severity
    message, remedy : str or callable
        What is so, and what to do, for those who call Python.
    on_command_line, on_page : str
        What to do, for those who use the command line or the app; empty: the same.
    """

    severity: Severity
    message: Text
    remedy: Text = ""
    on_command_line: str = ""
    on_page: str = ""


class _Template(Formatter):
    """``str.format`` that joins lists by commas and writes shares in per cent: ``{share:.1f%}``."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, (list, tuple)):
            return ", ".join(str(item) for item in value)
        if format_spec.endswith("%"):
            if not math.isfinite(value):
                return "an unknown share"
            return f"{format(100.0 * value, format_spec[:-1])} %"
        return super().format_field(value, format_spec)


def fill(text: Text, fields: dict[str, Any]) -> str:
    """A text with its fields filled in."""
    return text(fields) if callable(text) else _Template().vformat(text, (), fields)


def time_unit(f: dict[str, Any]) -> str:
    """Words for times that were not in seconds."""
    if f["unit"] == "s":
        return f"the times in {f['column']!r} were taken to be in seconds" + _instead(f)
    return f"the times in {f['column']!r} were converted from {f['unit']} to seconds" + _instead(f)


def converted_units(f: dict[str, Any]) -> str:
    """Words for a column whose numbers were converted."""
    what = "" if f["quantity"] == "position" else f"{f['quantity']} of "
    if f["unit"] == f["to"]:
        return fill(f"{what}{{subject}} was taken to be in {{unit}}", f) + _instead(f)
    return fill(f"{what}{{subject}} was converted from {{unit}} to {{to}}", f) + _instead(f)


def _instead(f: dict[str, Any]) -> str:
    return f", as asked for, not in {f['instead_of']}" if f["instead_of"] else ""


# words of the units in which a rate may have been recorded
UNITS = {
    "deg/s": "degrees per second",
    "rpm": "revolutions per minute",
    "rev/s": "revolutions per second",
    "deg/s^2": "degrees per second squared",
    "g": "multiples of g",
    "1/1000": "thousandths of the coordinate's unit",
    "1/100": "hundredths of the coordinate's unit",
}

REASONS = {
    "chosen": "",
    "fits-worse": "it fits the data worse",
    "not-worth-its-terms": "its further terms improve the fit by less than their price",
    "irrelevant": "its further terms remove less than {share} of the equation error each",
    "no-fit": "its own fit does not converge",
    "fit-is-worse": "its own fit does not bear out what the quadratic model promises",
    "fit-is-better": "the search ended before it: by its own fit it is the better one",
    "not-fitted": "only the quadratic model prefers it, and its own fit was not made",
}
"""Why a structure of the trade-off curve was not chosen: code → words, as they follow "because".

The codes are those of `leastaction.selection.alternatives.Alternative`.
"""


def because(reason: str, relevance: float | None = None) -> str:
    """Words for a reason; empty for a code that nobody knows.

    Parameters
    ----------
    reason : str
        One of `REASONS`.
    relevance : float, optional
        Share of the equation error that a term had to remove to stay.

    Examples
    --------
    >>> because("fits-worse")
    'it fits the data worse'
    >>> because("irrelevant", 0.05)
    'its further terms remove less than 5 % of the equation error each'
    """
    share = "the relevant share"
    if relevance is not None and math.isfinite(relevance):
        share = f"{100.0 * relevance:g} %"
    return REASONS.get(reason, "").format(share=share)


def another_structure(f: dict[str, Any]) -> str:
    """Words for a structure that was taken by hand."""
    why = because(f["reason"], f["relevance"])
    return "this structure was taken from the trade-off curve by hand; it was not chosen" + (
        f", because {why}" if why else ""
    )


def rate_scaled(f: dict[str, Any]) -> str:
    """Words for a rate that was recorded in another unit."""
    text = "the measured {quantity} of {subject} is {factor:.3g} times the derivative of its coordinate"
    opposite = f["factor"] < 0.0
    if f["unit"] in UNITS:
        text += f" ({UNITS[f['unit']]}{', with the opposite sign' if opposite else ''}?)"
    elif opposite:
        text += " (the opposite sign?)" if f["unit"] == "1" else " (with the opposite sign?)"
    return fill(text, f)


def zero_offset(f: dict[str, Any]) -> str:
    """Words for an angle whose zero is off."""
    size = "large" if f["offset"] > 0 else "small"
    text = f"{{term}} with its sine reads as a zero offset: {{subject}} is too {size} by "
    return fill(text, f) + f"{1e3 * abs(f['offset']):.2g} mrad"
