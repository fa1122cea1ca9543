"""What the model of a record says of itself.

A record has ``findings``.  One from before checks had codes has the texts of ``warnings`` and ``notes``
instead, in the wording of its version, which does not follow `leastaction.findings.messages`: it is read
here and nowhere else.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from leastaction.findings import Finding, Severity
from studies.faults import causes_named

__all__ = ["causes_in", "code_of", "codes_in", "findings_in", "sentences_in"]


def findings_in(result: Mapping) -> tuple[Finding, ...]:
    """Return the findings of a run; none where there was no model."""
    if "findings" not in result:
        return _old_findings(result)
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


# ------------------------------------------------------------- records from before checks had codes

_SENTENCES = (
    ("the solver did not converge", "not-converged"),
    ("the library cannot explain the measured ", "rate-unexplained"),
    ("the library cannot explain ", "equations-off"),
    ("the library seems to lack ", "missing-term"),
    ("friction seems to act on ", "unmodelled-friction"),
    ("energy seems to be fed in along ", "energy-fed-in"),
    ("the known coefficient of ", "wrong-known-coefficient"),
    ("the forces seem to act about ", "late-forces"),
    ("the forces seem to be ", "scaled-forces"),
    ("the forces on .* seem to be swapped", "swapped-forces"),
    ("the measured .* is constant", "rate-constant"),
    ("the measured .* hardly follows", "rate-unrelated"),
    (r"the measured .* is \S+ times the derivative", "rate-scaled"),
    ("the measured .* has an offset", "rate-offset"),
    (r"\S+ % of the spread of .* looks like noise", "looks-like-noise"),
    ("sampling is slow", "slow-sampling"),
    ("the motion of .* hardly shows above its noise", "motion-in-noise"),
    ("these data hardly determine ", "hardly-determined"),
    ("these data cannot tell ", "competing-structures"),
    ("the mass matrix is not finite", "mass-matrix-not-finite"),
    ("the mass matrix is not positive definite", "mass-matrix-not-positive"),
    ("the dissipation term .* came out negative", "negative-dissipation"),
    (r"\d+ jumps of 2π removed from ", "angle-unwrapped"),
    ("forces on .* were left out: the motion there is prescribed", "forces-unused"),
    (r"\d+ samples of .* are outliers", "outliers-left-out"),
    (r"abs\(\) of velocities is smoothed", "friction-smoothed"),
    ("the equation of .* no more than the scatter of those that were given", "scatter-of-forces"),
    ("the equation of .* of its forces unexplained", "equation-error"),
    ("residuals of .* are correlated from sample to sample", "correlated-residuals"),
    ("coefficients still moved when the knots were refined", "knots-not-settled"),
    ("the equations hold to some per cent only", "coefficients-of-free-runs"),
    ("a force on .* was looked for", "slow-force"),
    (r"(velocity|acceleration) of \S+: noise ", "rate-noise"),
    (r"\S+ covers \S+ within a recording", "angle-in-degrees"),
    (r"\S+ jumps by about 2π \d+ times", "undeclared-angle"),
    (".* with its sine reads as a zero offset", "zero-offset"),
)


def code_of(text: str) -> str:
    """Return the code of an old sentence, ``"text"`` if it is none of them.

    >>> code_of("the library cannot explain x: the equation is off by 2.0 % of its forces")
    'equations-off'
    """
    return next((code for beginning, code in _SENTENCES if re.match(beginning, text)), "text")


def _old_findings(result: Mapping) -> tuple[Finding, ...]:
    """Return what an old record says, without subjects; of the figures only what tells causes apart."""
    severities: tuple[tuple[str, Severity], ...] = (("warnings", "warning"), ("notes", "note"))
    return tuple(_finding(text, severity) for entry, severity in severities for text in result.get(entry, ()))


def _finding(text: str, severity: Severity) -> Finding:
    forces = re.search(r"or the forces are (\S+) times too large", text)
    values = {"force_factor": float(forces[1])} if forces else {}
    return Finding(code_of(text), severity, values=values, message=text)
