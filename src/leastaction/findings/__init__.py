"""What checks say: a code and figures for programs, sentences for people."""

from leastaction.findings.finding import (
    INEXACT,
    SEVERITIES,
    STATED,
    TEXT,
    UNDECIDED,
    Audience,
    Figures,
    Finding,
    Severity,
    Status,
    doubtful,
    inexact,
    status_of,
)
from leastaction.findings.messages import CODES
from leastaction.findings.sentences import alike, as_given, find, sentence, smoothing_widths
from leastaction.findings.stated import stated_error, statements, usability, with_held_out, worst_share
from leastaction.findings.templates import REASONS, because

__all__ = [
    "CODES",
    "INEXACT",
    "REASONS",
    "SEVERITIES",
    "STATED",
    "TEXT",
    "UNDECIDED",
    "Audience",
    "Figures",
    "Finding",
    "Severity",
    "Status",
    "alike",
    "as_given",
    "because",
    "doubtful",
    "find",
    "inexact",
    "sentence",
    "smoothing_widths",
    "stated_error",
    "statements",
    "status_of",
    "usability",
    "with_held_out",
    "worst_share",
]
