"""Records of runs before checks had codes: the sentences that they hold, read back here and nowhere else.

Such a record has the texts of ``warnings`` and ``notes``, a newer one ``findings``.  The wording is that of
the versions that made the records, so it does not follow `leastaction.findings.messages`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from leastaction.findings import Finding, Severity

__all__ = ["code_of", "findings_of"]

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


def findings_of(result: Mapping) -> tuple[Finding, ...]:
    """Return what an old record says, without subjects; of the figures only what tells causes apart."""
    severities: tuple[tuple[str, Severity], ...] = (("warnings", "warning"), ("notes", "note"))
    return tuple(_finding(text, severity) for entry, severity in severities for text in result.get(entry, ()))


def _finding(text: str, severity: Severity) -> Finding:
    forces = re.search(r"or the forces are (\S+) times too large", text)
    values = {"force_factor": float(forces[1])} if forces else {}
    return Finding(code_of(text), severity, values=values, message=text)
