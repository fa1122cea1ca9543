"""What checks say: a code and figures for programs, sentences for people."""

from leastaction.findings.finding import SEVERITIES, TEXT, Figures, Finding, Severity, doubtful
from leastaction.findings.messages import CODES, Audience, find, sentence
from leastaction.findings.templates import REASONS, because

__all__ = [
    "CODES",
    "REASONS",
    "SEVERITIES",
    "TEXT",
    "Audience",
    "Figures",
    "Finding",
    "Severity",
    "because",
    "doubtful",
    "find",
    "sentence",
]
