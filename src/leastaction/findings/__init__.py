"""What checks say: a code and figures for programs, sentences for people."""

from leastaction.findings.finding import SEVERITIES, TEXT, Figures, Finding, Severity
from leastaction.findings.messages import CODES, Audience, find, sentence

__all__ = ["CODES", "SEVERITIES", "TEXT", "Audience", "Figures", "Finding", "Severity", "find", "sentence"]
