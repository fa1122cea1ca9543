"""A finding made from its code and figures, and as a text for Python, command line or app.

`as_given` shows candidates as the user wrote them, with abs() in place of the root that smooths it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import groupby
from typing import Any

from leastaction.findings.finding import TEXT, Audience, Finding, Text, fill
from leastaction.findings.messages import CODES

__all__ = ["alike", "as_given", "find", "sentence", "smoothing_widths"]

_INSIDE = r"(?:[^()]|\((?:[^()]|\([^()]*\))*\))*"  # brackets with two levels of others inside
_FACTOR = rf"(?:\w*\({_INSIDE}\)|\w+)"  # such as x_dot, cos(x) or (x_dot - y_dot)
_SQUARES = rf"{_FACTOR}\*\*2(?:\*{_FACTOR}\*\*2)*"  # u² of any of the forms that terms are written in
_NUMBER = r"([0-9]+(?:\.[0-9]*)?(?:e-?[0-9]+)?(?:/[1-9][0-9]*)?)"  # w², a decimal number or a fraction
_HALF = r"\*\*\((?:([0-9]{1,4}/[1-9][0-9]{0,3})|(\{\w+\})/2)\)"  # half the power of |u|
_SMOOTHED = re.compile(rf"(\bsqrt)?\(({_SQUARES}) ?\+ ?{_NUMBER}\)(?:{_HALF})?")  # of |u|
_EVEN = r"\*\*([0-9]?[02468])"  # an even power
_CUBED = re.compile(rf"(?<![\w.])(?:(\w+)|\(({_INSIDE})\)){_EVEN}\*abs\((?:\1|\2)\)")  # u² |u|


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


def smoothing_widths(findings: Iterable[Finding]) -> tuple[float, ...]:
    """The widths in which absolute values of velocities were smoothed; empty if none were.

    Examples
    --------
    >>> smoothing_widths([find("friction-smoothed", ["x_dot", "y_dot"], widths=[0.03, 0.5])])
    (0.03, 0.5)
    """
    found = [f.values.get("widths") for f in findings if f.code == "friction-smoothed"]
    lists = [widths for widths in found if isinstance(widths, (list, tuple))]
    return tuple(float(w) for widths in lists for w in widths if isinstance(w, (int, float)))


def as_given(text: str, widths: Sequence[float]) -> str:
    """Write √(u² + w²) as abs(u) where u is a velocity and w one of the widths, in terms and in sentences.

    Examples
    --------
    >>> as_given("sqrt((x_dot - y_dot)**2 + 1/625), sqrt(x_dot**2 + 1)", [0.04])
    'abs(x_dot - y_dot), sqrt(x_dot**2 + 1)'
    >>> as_given("x_dot**2*sqrt(x_dot**2 + 1/625)/3 + (x_dot**2 + 1/625)**({n}/2)", [0.04])
    'abs(x_dot)**3/3 + abs(x_dot)**{n}'
    """

    def absolute(found: re.Match[str]) -> str:
        root, squares, number, power, exponent = found.groups()
        over, _, under = number.partition("/")
        size = float(over) / float(under or 1)
        known = any(math.isclose(size, width**2, rel_tol=1e-9) for width in widths)
        if not known or "_dot" not in squares or bool(root) == bool(power or exponent):
            return found[0]
        u = re.sub(rf"({_FACTOR})\*\*2", r"\1", squares)
        u = u[1:-1] if re.fullmatch(rf"\({_INSIDE}\)", u) else u
        shown = f"abs({as_given(u, widths)})"
        twice = exponent or (str(2 * Fraction(power)) if power else "")
        return f"{shown}**({twice})" if "/" in twice else f"{shown}**{twice}" if twice else shown

    if not widths:
        return text
    return _CUBED.sub(
        lambda found: f"abs({found[1] or found[2]})**{int(found[3]) + 1}", _SMOOTHED.sub(absolute, text)
    )


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
