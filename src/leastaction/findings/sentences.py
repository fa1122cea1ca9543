"""A finding made from its code and figures, and as a text for Python, command line or app."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import Any

from leastaction.findings.finding import TEXT, Audience, Finding, Text, fill
from leastaction.findings.messages import CODES

__all__ = ["alike", "find", "sentence"]


def find(code: str, subject: str | Iterable[str] = (), /, **values: Any) -> Finding:
    """Return a finding with its message and remedy.

    Parameters
    ----------
    code : str
        A key of `CODES`.
    subject : str or iterable of str
        The coordinates or terms concerned.
    **values
        The figures that its texts need, and any others worth keeping.

    Examples
    --------
    >>> print(find("motion-in-noise", "x", motion=0.011, noise=0.05))
    the motion of x (0.011) barely exceeds its noise (0.05): record larger motions
    """
    row = CODES[code]
    about = (subject,) if isinstance(subject, str) else tuple(subject)
    fields = {"subject": about, **values}
    return Finding(code, row.severity, about, values, fill(row.message, fields), fill(row.remedy, fields))


def sentence(finding: Finding, audience: Audience = "python") -> str:
    """Return a finding as text, with the remedy worded for the command line or the app.

    Examples
    --------
    >>> print(sentence(find("undeclared-angle", "theta", jumps=3), "command line"))
    theta jumps by about 2π 3 times; the jumps were removed: if it is an angle, declare it with --angles ...
    """
    remedy = _other_remedies(audience).get(finding.code)
    if not remedy:
        return str(finding)
    try:
        return f"{finding.message}: {fill(remedy, {**finding.values, 'subject': finding.subject})}"
    except (KeyError, TypeError, ValueError):  # figures of another version, from a file
        return str(finding)


def alike(findings: Iterable[Finding]) -> Iterator[list[Finding]]:
    """Successive findings with the same statement about several subjects.

    Examples
    --------
    >>> unused = [find("forces-unused", name) for name in ("x", "y")]
    >>> [len(group) for group in alike([*unused, find("undeclared-angle", "theta", jumps=3)])]
    [2, 1]
    """
    for _, group in groupby(findings, key=lambda f: (f.code, f.remedy if f.code != TEXT else id(f))):
        yield list(group)


def _other_remedies(audience: Audience) -> dict[str, Text]:
    if audience == "python":
        return {}
    rows = CODES.items()
    return {code: row.on_command_line if audience == "command line" else row.on_page for code, row in rows}
