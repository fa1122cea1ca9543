"""A text with gaps for figures, and the texts of one code."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from string import Formatter
from typing import Any, Literal

from leastaction.findings.finding import Severity

__all__ = ["Audience", "Message", "Text", "fill"]

Audience = Literal["python", "command line", "page"]
Text = str | Callable[[dict[str, Any]], str]


@dataclass(frozen=True)
class Message:
    """The severity and the texts of one code.

    Attributes
    ----------
    severity : Severity
    message, remedy : str or callable
        The statement, and what to do about it in Python.
    on_command_line, on_page : str or callable
        What to do about it on the command line or in the app, if that differs from `remedy`.
    """

    severity: Severity
    message: Text
    remedy: Text = ""
    on_command_line: Text = ""
    on_page: Text = ""


class _Template(Formatter):
    """``str.format`` that joins lists with commas and writes fractions in per cent: ``{share:.1f%}``."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, (list, tuple)):
            return ", ".join(str(item) for item in value)
        if format_spec.endswith("%"):
            if not math.isfinite(value):
                return "an unknown share"
            if abs(value) >= 1.0:  # never 2e+02 %
                format_spec = ".0f%"
            return f"{format(100.0 * value, format_spec[:-1])} %"
        return super().format_field(value, format_spec)


def fill(text: Text, fields: Mapping[str, Any]) -> str:
    """A text with its fields filled in."""
    return text(dict(fields)) if callable(text) else _Template().vformat(text, (), fields)
