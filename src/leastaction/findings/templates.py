"""How a finding reads: a severity, and templates over its subject and figures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from string import Formatter
from typing import Any, Literal

from leastaction.findings.finding import Severity

__all__ = ["Audience", "Message", "Text", "fill"]

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
