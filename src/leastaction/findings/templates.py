"""How a finding reads, a severity and templates over its subject and figures; and words for reasons."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from string import Formatter
from typing import Any, Literal

from leastaction.findings.finding import Finding, Severity

__all__ = [
    "REASONS",
    "UNITS",
    "Audience",
    "Message",
    "Text",
    "another_structure",
    "because",
    "converted_units",
    "correlated",
    "equations_off",
    "equations_off_remedy",
    "fill",
    "friction",
    "groups_differ",
    "imitated_remedy",
    "late_forces",
    "missing_term",
    "missing_term_remedy",
    "rate_scaled",
    "smoothed",
    "statements",
    "time_dependent",
    "time_dependent_remedy",
    "time_unit",
    "wrong_known",
    "wrong_known_remedy",
    "zero_offset",
]

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
    on_command_line, on_page : str or callable
        What to do, for those who use the command line or the app; empty: the same.
    """

    severity: Severity
    message: Text
    remedy: Text = ""
    on_command_line: Text = ""
    on_page: Text = ""


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


_MORE_THAN_NOISE = 1.05  # of the residual: less is the noise


def fill(text: Text, fields: Mapping[str, Any]) -> str:
    """A text with its fields filled in."""
    return text(dict(fields)) if callable(text) else _Template().vformat(text, (), fields)


def time_unit(f: dict[str, Any]) -> str:
    """Words for times that were not in seconds."""
    if f["unit"] == "s":
        return f"the times in {f['column']!r} were taken to be in seconds" + _instead(f)
    return f"the times in {f['column']!r} were converted from {f['unit']} to seconds" + _instead(f)


def converted_units(f: dict[str, Any]) -> str:
    """Words for a column whose numbers were converted."""
    what = "" if f["quantity"] == "position" else f"{f['quantity']} of "
    if f["unit"] == f["to"]:
        return fill(f"{what}{{subject}} was taken to be in {{unit}}", f) + _instead(f)
    return fill(f"{what}{{subject}} was converted from {{unit}} to {{to}}", f) + _instead(f)


def _instead(f: dict[str, Any]) -> str:
    return f", as asked for, not in {f['instead_of']}" if f["instead_of"] else ""


# words of the units in which a rate may have been recorded
UNITS = {
    "deg/s": "degrees per second",
    "rpm": "revolutions per minute",
    "rev/s": "revolutions per second",
    "deg/s^2": "degrees per second squared",
    "g": "multiples of g",
    "1/1000": "thousandths of the coordinate's unit",
    "1/100": "hundredths of the coordinate's unit",
}

REASONS = {
    "chosen": "",
    "fits-worse": "it fits the data worse",
    "not-worth-its-terms": "its further terms improve the fit by less than their price",
    "irrelevant": "its further terms remove less than {share} of the equation error each",
    "no-fit": "its own fit does not converge",
    "fit-is-worse": "its own fit does not bear out what the quadratic model promises",
    "fit-is-better": "the search ended before it: by its own fit it is the better one",
    "not-fitted": "only the quadratic model prefers it, and its own fit was not made",
}
"""Why a structure of the trade-off curve was not chosen: code → words, as they follow "because".

The codes are those of `leastaction.selection.alternatives.Alternative`.
"""


def because(reason: str, relevance: float | None = None) -> str:
    """Words for a reason; empty for a code that nobody knows.

    Parameters
    ----------
    reason : str
        One of `REASONS`.
    relevance : float, optional
        Share of the equation error that a term had to remove to stay.

    Examples
    --------
    >>> because("fits-worse")
    'it fits the data worse'
    >>> because("irrelevant", 0.05)
    'its further terms remove less than 5 % of the equation error each'
    """
    share = "the relevant share"
    if relevance is not None and math.isfinite(relevance):
        share = f"{100.0 * relevance:g} %"
    return REASONS.get(reason, "").format(share=share)


def another_structure(f: dict[str, Any]) -> str:
    """Words for a structure that was taken by hand."""
    why = because(f["reason"], f["relevance"])
    return "this structure was taken from the trade-off curve by hand; it was not chosen" + (
        f", because {why}" if why else ""
    )


def rate_scaled(f: dict[str, Any]) -> str:
    """Words for a rate that was recorded in another unit."""
    text = "the measured {quantity} of {subject} is {factor:.3g} times the derivative of its coordinate"
    opposite = f["factor"] < 0.0
    if f["unit"] in UNITS:
        text += f" ({UNITS[f['unit']]}{', with the opposite sign' if opposite else ''}?)"
    elif opposite:
        text += " (the opposite sign?)" if f["unit"] == "1" else " (with the opposite sign?)"
    return fill(text, f)


def equations_off(f: dict[str, Any]) -> str:
    """Words for an equation that does not hold; noise is named only where the fit leaves more than that."""
    more = f["residual_ratio"] > _MORE_THAN_NOISE
    residual = ", the residual is {residual_ratio:.2f} times the noise" if more else ""
    text = "the library cannot explain {subject} (the equation is off by {equation_error:.1f%} of its forces"
    return fill(f"{text}{residual})", f)


def equations_off_remedy(f: dict[str, Any], prescribed: str = "prescribed=['{subject}']") -> str:
    """What to look for; the argument or option for motion that nobody explains."""
    text = (
        "a term of L, friction or a force may be missing, columns may be swapped, or a known value or sign "
        "be wrong"
    )
    if f["cause_named"]:
        return f"{text}; see the likely cause below"
    unmeasured = f"; if forces that were not measured move {{subject}}, give {prescribed}"
    return text + (fill(unmeasured, f) if f["may_be_prescribed"] else "")


def missing_term(f: dict[str, Any]) -> str:
    """Words for terms that the library lacks."""
    it = "it" if len(f["subject"]) == 1 else "them"
    instead = f" instead of {f['free_terms_before']}" if "free_terms_before" in f else ""
    gain = f.get("gain")
    by = f", -2 log likelihood {gain:.0f}, the price of the terms included" if gain is not None else ""
    better = " better" if instead else ""
    lacking = fill("the library seems to lack {subject}", f)
    it += fill(", {numbers}", f) if f.get("numbers") else ""
    terms, explain = ("term", "explains") if f["free_terms"] == 1 else ("terms", "explain")
    return f"{lacking} (with {it}, {f['free_terms']} free {terms}{instead} {explain} the motion{better}{by})"


def missing_term_remedy(f: dict[str, Any], on_command_line: bool = False) -> str:
    """Where to add them."""
    it = "it" if len(f["subject"]) == 1 else "them"
    how, offset = "", "force_offset=['{constant_force}']"
    if on_command_line:
        how, offset = f", {_term_options(f['subject'])}", "--force-offset {constant_force}"
    force = f"; in L, {{constant_force}} by itself is a constant force on it ({offset})"
    return f"add {it} to the candidates{how}" + (fill(force, f) if f["constant_force"] else "")


def time_dependent(f: dict[str, Any]) -> str:
    """Words for a law that holds with terms of the time."""
    terms, explain = ("term", "explains") if f["free_terms"] == 1 else ("terms", "explain")
    numbers = fill(" ({numbers})", f) if f["numbers"] else ""
    return fill("the law seems to depend on time: with {subject}", f) + (
        f"{numbers}, {f['free_terms']} free {terms} {explain} the motion"
    )


def time_dependent_remedy(f: dict[str, Any]) -> str:
    """What to do about it on the command line."""
    return f"add {_term_options(f['subject'])}, or measure what moves it (--input)"


def _term_options(terms: Iterable[str]) -> str:
    return " ".join(f'--term "{term}"' for term in terms)


def imitated_remedy(f: dict[str, Any], on_command_line: bool = False) -> str:
    """What the library may lack, if that could be told."""
    if not f.get("family"):
        example = "--term 'exp(-{a}*x)'" if on_command_line else "exp(-{a}*x)"
        return f"offer other candidates; unknown numbers in them stand in braces, as in {example}"
    how = f", {_term_options(f['family'])}" if on_command_line else ""
    return fill("add {family} to the candidates", f) + how + fill("; the motion agrees with {numbers}", f)


def friction(f: dict[str, Any]) -> str:
    """Words for friction, or a drive, along velocities that no candidate describes."""
    what = "energy seems to be fed in along" if f["coefficient"] < 0.0 else "friction seems to act on"
    size = [f"coefficient about {f['coefficient']:.2g}"]
    size += [fill("{share:.2g%} of the forces", f)] if f.get("share") is not None else []
    size += [f"-2 log likelihood {f['gain']:.0f}"] if f.get("gain") is not None else []
    return fill(f"{what} {{velocities}} ({', '.join(size)})", f)


def late_forces(f: dict[str, Any]) -> str:
    """Words for forces that act later, or earlier, than recorded."""
    when = "later" if f["delay"] > 0.0 else "earlier"
    half = ", half a sample; are they held from one sample to the next?" if f["half_a_sample"] else ""
    return (
        f"the forces seem to act about {1e3 * abs(f['delay']):.2g} ms {when} than recorded "
        f"(-2 log likelihood {f['gain']:.0f}{half})"
    )


def wrong_known(f: dict[str, Any]) -> str:
    """Words for a known coefficient that the data contradict."""
    fewer = f"{f['fewer_terms']} terms fewer" if f["fewer_terms"] > 1 else "the other terms"
    return fill(
        "the known coefficient of {subject} may be wrong (set free it becomes {estimate:.3g} instead of "
        f"{{given:.3g}}, and {fewer} explain the motion better)",
        f,
    )


def wrong_known_remedy(f: dict[str, Any]) -> str:
    """What to do about it."""
    forces = f.get("force_factor")
    units = f"; or the forces are {forces:.3g} times too large" if forces is not None else ""
    return f"correct it, or leave it free{units}"


def undetermined(f: dict[str, Any]) -> str:
    """Words for a shape parameter that is open, or went to where its terms lose their shape."""
    if "low" in f:
        where = "the shape parameter {subject} went to {value:.3g}, far from where the data could tell it "
        return fill(where + "({low:.3g} to {high:.3g}): there its terms are no more than powers", f)
    text = "these data hardly determine the shape parameter {subject} ({value:.3g} ± {standard_error:.2g})"
    return fill(text, f)


def undetermined_remedy(f: dict[str, Any]) -> str:
    """What to do about it."""
    other = fill("; it cannot be told apart from {with_it}", f) if f["with_it"] else ""
    simpler = "powers of the coordinate in place of its terms" if "low" in f else "a simpler term"
    return f"record motions of another size, write {simpler}, or give a number{other}"


def zero_offset(f: dict[str, Any]) -> str:
    """Words for an angle whose zero is off."""
    size = "large" if f["offset"] > 0 else "small"
    text = f"{{term}} with its sine reads as a zero offset: {{subject}} is too {size} by "
    return fill(text, f) + f"{1e3 * abs(f['offset']):.2g} mrad"


_STRUCTURES = {
    "not found": ("not-converged", "stopped-early", "mass-matrix-not-finite", "mass-matrix-not-positive"),
    "not among the candidates": (
        *("missing-term", "time-dependent", "form-imitated", "simpler-form", "wrong-known-coefficient"),
        *("energy-fed-in", "negative-dissipation", "swapped-forces"),
    ),
    "not determined by these data": (
        *("hardly-determined", "scale-open", "form-open", "motion-in-noise"),
        *("shape-undetermined", "shape-at-bound", "shape-not-settled"),
    ),
    "one of several that explain the data": ("competing-structures", "another-structure"),
}
"""What findings say of the structure, the worst first."""
_LITTLE = 1e-3  # of the forces: smaller equation errors have no finding


def statements(findings: Iterable[Finding]) -> dict[str, str]:
    """What findings say of structure, equations and forecast, in words.

    Examples
    --------
    >>> statements([])
    {'structure': 'determined', 'equations': 'hold to 0.1 % of the forces', 'forecast': 'not tested'}
    """
    found = tuple(findings)
    codes = {finding.code for finding in found}
    structure = next((words for words, some in _STRUCTURES.items() if codes & {*some}), "determined")
    followed = next((finding.values for finding in found if finding.code == "forecasts"), None)
    if structure == "determined" and "equations-off" in codes and followed is None:
        structure = "in doubt, since the equations do not hold"
    left = [
        fill("{equation_error:.2g%} of the forces (", finding.values) + ", ".join(finding.subject) + ")"
        for finding in found
        if "equation_error" in finding.values
    ]
    forecast = "not tested"
    if followed is not None:
        forecast = fill("free runs over {horizon:.2g} s are off by {error:.2g%} of the spread", followed)
    equations = ", ".join(left) or fill("{left:g%} of the forces", {"left": _LITTLE})
    return {"structure": structure, "equations": f"hold to {equations}", "forecast": forecast}


def smoothed(f: dict[str, Any]) -> str:
    """Where the absolute values of velocities have no kink."""
    below = [f"{name} below {width:g}" for name, width in zip(f["subject"], f["widths"], strict=True)]
    return f"abs() of velocities is smoothed ({', '.join(below)})"


def correlated(f: dict[str, Any]) -> str:
    """Words for residuals that are no white noise."""
    what = "{subject}" if f["quantity"] == "position" else "{quantity} of {subject}"
    return fill(f"residuals of {what} are correlated from sample to sample ({{correlation:+.2f}})", f)


def groups_differ(f: dict[str, Any]) -> str:
    """By how much each differs, and how many do not."""
    numbers = zip(f["terms"], f["differences"], f["standard_errors"], strict=True)
    changes = ", ".join(f"{term} by {value:+.3g} ± {error:.2g}" for term, value, error in numbers)
    same = f"; {len(f['alike'])} others do not" if f["alike"] else ""
    what = (
        "the coefficient of {subject} differs"
        if len(f["subject"]) == 1
        else "the coefficients of {subject} differ"
    )
    return fill(
        what + " between the groups {groups} ({changes}){same}", {**f, "changes": changes, "same": same}
    )
