"""How a finding reads, a severity and templates over its subject and figures; and words for reasons."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from string import Formatter
from typing import Any, Literal

from leastaction.findings.finding import Severity

__all__ = ["REASONS", "UNITS", "Audience", "Message", "Text", "because", "fill"]

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
