"""What the model of a record says of itself."""

from __future__ import annotations

from collections.abc import Mapping

from leastaction.findings import Finding, Severity
from studies import old_records
from studies.faults import causes_named

__all__ = ["causes_in", "codes_in", "findings_in", "sentences_in"]


def findings_in(result: Mapping) -> tuple[Finding, ...]:
    """Return the findings of a run; none where there was no model."""
    if "findings" not in result:
        return old_records.findings_of(result)
    return tuple(Finding.from_dict(entry) for entry in result["findings"])


def causes_in(result: Mapping, severity: Severity) -> list[str]:
    """Return the causes that warnings, or notes, name."""
    return causes_named(finding for finding in findings_in(result) if finding.severity == severity)


def codes_in(result: Mapping) -> list[str]:
    """Return the codes of all findings, each once."""
    return list(dict.fromkeys(finding.code for finding in findings_in(result)))


def sentences_in(result: Mapping, severity: Severity) -> list[str]:
    """Return the warnings, or notes, in words, each once."""
    found = (str(finding) for finding in findings_in(result) if finding.severity == severity)
    return list(dict.fromkeys(found))
