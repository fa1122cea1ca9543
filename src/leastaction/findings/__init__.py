"""What checks say: a code and figures for programs, sentences for people."""

from leastaction.findings.finding import (
    INEXACT,
    SEVERITIES,
    STATED,
    TEXT,
    Figures,
    Finding,
    Severity,
    Status,
    doubtful,
    inexact,
    status_of,
)
from leastaction.findings.messages import CODES
from leastaction.findings.sentences import find, sentence
from leastaction.findings.stated import stated_error, statements
from leastaction.findings.templates import REASONS, because
from leastaction.findings.wording import Audience

__all__ = [
    "CODES",
    "INEXACT",
    "REASONS",
    "SEVERITIES",
    "STATED",
    "TEXT",
    "Audience",
    "Figures",
    "Finding",
    "Severity",
    "Status",
    "because",
    "doubtful",
    "find",
    "inexact",
    "sentence",
    "stated_error",
    "statements",
    "status_of",
]
