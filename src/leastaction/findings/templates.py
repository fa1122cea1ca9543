"""Templates for the sentences of findings, and the wording of reasons."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from leastaction.findings.finding import Audience, fill
from leastaction.findings.stated import groups_differ

__all__ = [
    "REASONS",
    "UNITS",
    "another_structure",
    "because",
    "competing_remedy",
    "converted_units",
    "correlated",
    "equations_off",
    "equations_off_remedy",
    "friction",
    "gravity_remedy",
    "hardly_determined",
    "hidden_coordinate",
    "hidden_motion_open",
    "imitated_remedy",
    "late_forces",
    "late_forces_remedy",
    "missing_term",
    "missing_term_remedy",
    "perhaps_angle_remedy",
    "rate_scaled",
    "slow_force",
    "smoothed",
    "time_dependent",
    "time_dependent_remedy",
    "time_unit",
    "trials_differ",
    "trials_differ_remedy",
    "wrong_known",
    "wrong_known_remedy",
    "zero_offset",
]

_MORE_THAN_NOISE = 1.05  # of the residual: less is the noise


def time_unit(f: dict[str, Any]) -> str:
    """State how times were converted."""
    if f["unit"] == "s":
        return f"the times in {f['column']!r} were read as seconds" + _instead(f)
    return f"the times in {f['column']!r} were converted from {f['unit']} to seconds" + _instead(f)


def converted_units(f: dict[str, Any]) -> str:
    """State how a column was converted."""
    what = "" if f["quantity"] == "position" else f"{f['quantity']} of "
    if f["unit"] == f["to"]:
        return fill(f"{what}{{subject}} was read as {{unit}}", f) + _instead(f)
    return fill(f"{what}{{subject}} was converted from {{unit}} to {{to}}", f) + _instead(f)


def _instead(f: dict[str, Any]) -> str:
    return f", as requested, instead of {f['instead_of']}" if f["instead_of"] else ""


# units in which a rate may have been recorded
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
    "not-worth-its-terms": "its additional terms improve the fit by less than their penalty",
    "irrelevant": "each of its additional terms removes less than {share} of the equation error",
    "no-fit": "its own fit does not converge",
    "fit-is-worse": "its own fit does not confirm the prediction of the quadratic model",
    "fit-is-better": "the search ended before it was reached, although its own fit is better",
    "not-fitted": "only the quadratic model prefers it, and it was not fitted",
}
"""Why a structure of the trade-off curve was not chosen: code → clause that follows "because".

The codes are those of `leastaction.selection.alternatives.Alternative`.
"""


def because(reason: str, relevance: float | None = None) -> str:
    """Return the wording of a reason; empty for an unknown code.

    Parameters
    ----------
    reason : str
        One of `REASONS`.
    relevance : float, optional
        Share of the equation error that a term had to remove in order to stay.

    Examples
    --------
    >>> because("fits-worse")
    'it fits the data worse'
    >>> because("irrelevant", 0.05)
    'each of its additional terms removes less than 5 % of the equation error'
    """
    share = "the required share"
    if relevance is not None and math.isfinite(relevance):
        share = f"{100.0 * relevance:g} %"
    return REASONS.get(reason, "").format(share=share)


def another_structure(f: dict[str, Any]) -> str:
    """State that a structure was picked by hand, and why the search rejected it."""
    why = because(f["reason"], f["relevance"])
    return "this structure was taken from the trade-off curve by hand; the search did not choose it" + (
        f", because {why}" if why else ""
    )


def rate_scaled(f: dict[str, Any]) -> str:
    """State the apparent scale of a measured rate."""
    text = "the measured {quantity} of {subject} is {factor:.3g} times the derivative of its coordinate"
    opposite = f["factor"] < 0.0
    if f["unit"] in UNITS:
        text += f" ({UNITS[f['unit']]}{', with the opposite sign' if opposite else ''}?)"
    elif opposite:
        text += " (the opposite sign?)" if f["unit"] == "1" else " (with the opposite sign?)"
    return fill(text, f)


def equations_off(f: dict[str, Any]) -> str:
    """State that an equation does not hold; mention the residual only where it exceeds the noise."""
    off = ["its equation is off by {equation_error:.1f%} of the forces"] if f["equation_error"] > 5e-4 else []
    more = f["residual_ratio"] > _MORE_THAN_NOISE or not off
    residual = ["the residual is {residual_ratio:.2f} times the noise"] if more else []
    return fill(f"the model does not explain {{subject}} ({'; '.join(off + residual)})", f)


def equations_off_remedy(f: dict[str, Any], prescribed: str = "prescribed=['{subject}']") -> str:
    """What to check; the argument or option for motion caused by unmeasured forces."""
    text = (
        "check for a missing term, friction or force, swapped columns, and a wrong sign or known coefficient"
    )
    if f["cause_named"]:
        return f"{text}; see the likely cause below"
    unmeasured = f"; if unmeasured forces move {{subject}}, use {prescribed}"
    return text + (fill(unmeasured, f) if f["may_be_prescribed"] else "")


def missing_term(f: dict[str, Any]) -> str:
    """State which terms appear to be missing."""
    it = "it" if len(f["subject"]) == 1 else "them"
    instead = f" instead of {f['free_terms_before']}" if "free_terms_before" in f else ""
    gain = f.get("gain")
    by = f"; -2 log likelihood is lower by {gain:.0f}, penalty included" if gain is not None else ""
    better = " better" if instead else ""
    what = "a term appears" if len(f["subject"]) == 1 else "terms appear"
    lacking = fill(f"{what} to be missing: {{subject}}", f)
    it += fill(", {numbers}", f) if f.get("numbers") else ""
    terms, explain = ("term", "explains") if f["free_terms"] == 1 else ("terms", "explain")
    return f"{lacking} (with {it}, {f['free_terms']} free {terms}{instead} {explain} the motion{better}{by})"


def missing_term_remedy(f: dict[str, Any], audience: Audience = "python") -> str:
    """How to add the missing terms."""
    it = "it" if len(f["subject"]) == 1 else "them"
    how = f", {_term_options(f['subject'])}" if audience == "command line" else ""
    offset = {
        "python": "force_offset=['{constant_force}']",
        "command line": "--force-offset {constant_force}",
        "page": "tick it under “Unknown constant force”",
    }[audience]
    force = f"; the term {{constant_force}} in L is a constant force on that coordinate ({offset})"
    angles = f"; or, {_declared(f['angles'], audience)}" if f.get("angles") else ""
    return f"add {it} to the candidates{how}" + (fill(force, f) if f["constant_force"] else "") + angles


def time_dependent(f: dict[str, Any]) -> str:
    """State that the law appears to depend on time."""
    terms, explain = ("term", "explains") if f["free_terms"] == 1 else ("terms", "explain")
    numbers = fill(" ({numbers})", f) if f["numbers"] else ""
    return fill("the law appears to depend on time: with {subject}", f) + (
        f"{numbers}, {f['free_terms']} free {terms} {explain} the motion"
    )


def time_dependent_remedy(f: dict[str, Any]) -> str:
    """What to do about a law that depends on time, on the command line."""
    return f"add {_term_options(f['subject'])}, or measure the input that drives the system (--input)"


def _term_options(terms: Iterable[str]) -> str:
    return " ".join(f'--term "{term}"' for term in terms)


def imitated_remedy(f: dict[str, Any], audience: Audience = "python") -> str:
    """Which candidates to add, if that is known."""
    on_command_line = audience == "command line"
    if not f.get("family"):
        example = "--term 'exp(-{a}*x)'" if on_command_line else "exp(-{a}*x)"
        return f"offer other candidates; write unknown numbers in braces, as in {example}"
    how = f", {_term_options(f['family'])}" if on_command_line else ""
    numbers = fill("; the data are consistent with {numbers}", f)
    return fill("add {family} to the candidates", f) + how + numbers


def friction(f: dict[str, Any]) -> str:
    """State that friction, or a drive, acts without a candidate for it."""
    fed_in = f["coefficient"] < 0.0
    what = "energy appears to be fed in through" if fed_in else "friction appears to act on"
    size = [f"coefficient about {f['coefficient']:.2g}"]
    size += [fill("{share:.2g%} of the forces", f)] if f.get("share") is not None else []
    size += [f"-2 log likelihood lower by {f['gain']:.0f}"] if f.get("gain") is not None else []
    return fill(f"{what} {{velocities}} ({', '.join(size)})", f)


def late_forces(f: dict[str, Any]) -> str:
    """State that forces act later, or earlier, than recorded."""
    when = "later" if f["delay"] > 0.0 else "earlier"
    half = "; this is half a sample: are the forces held between samples?" if f["half_a_sample"] else ""
    return (
        f"the forces appear to act about {_milliseconds(f['delay'])} {when} than recorded "
        f"(-2 log likelihood lower by {f['gain']:.0f}{half})"
    )


def late_forces_remedy(f: dict[str, Any]) -> str:
    """How to estimate the delay, over a range that contains it."""
    return f"estimate it with la.delay.estimate(..., max_delay={2.0 * abs(f['delay']):.1g})"


def _milliseconds(seconds: float) -> str:
    """Two digits, without an exponent."""
    return f"{float(f'{1e3 * abs(seconds):.2g}'):g} ms"


def wrong_known(f: dict[str, Any]) -> str:
    """State that the data contradict a known coefficient."""
    fewer = f"{f['fewer_terms']} fewer terms" if f["fewer_terms"] > 1 else "the remaining terms"
    return fill(
        "the known coefficient of {subject} may be wrong (left free, it is {estimate:.3g} instead of "
        f"{{given:.3g}}, and {fewer} explain the motion better)",
        f,
    )


def wrong_known_remedy(f: dict[str, Any]) -> str:
    """What to do about a wrong known coefficient."""
    forces = f.get("force_factor")
    units = f"; or the recorded forces are {forces:.3g} times the true ones" if forces is not None else ""
    return f"correct it, or leave it free{units}"


def hardly_determined(f: dict[str, Any]) -> str:
    """State that the data barely determine terms."""
    text = "these data barely determine {subject}"
    if f["scale_open"]:
        text += " (all coefficients can grow together: the scale of L is undetermined)"
    elif f["combination"]:
        text += " (the combination {combination} is uncertain by {open:.0f%})"
    return fill(text, f)


def competing_remedy(f: dict[str, Any]) -> str:
    """How to distinguish competing structures."""
    at = [f"{name} = {value:.2g}" for name, value in zip(f["at_names"], f["at_values"], strict=True)]
    where = f", e.g. through {', '.join(at)}" if at else ""
    return f"record motions in which they differ{where}, or remove one of them from the candidates"


def slow_force(f: dict[str, Any]) -> str:
    """State the range of an estimated slow force."""
    return fill(
        "the estimated slow force on {subject} (time scale {seconds:g} s) lies between {lowest:.3g} and "
        "{highest:.3g}, ± {standard_error:.2g}"
        + (": not distinguishable from zero" if f["hardly_any"] else ""),
        f,
    )


def undetermined(f: dict[str, Any]) -> str:
    """State that the data do not determine a shape parameter."""
    if "low" in f:
        where = "the shape parameter {subject} went to {value:.3g}, far outside the range in which the data "
        return fill(where + "can determine it ({low:.3g} to {high:.3g}): there its terms reduce to powers", f)
    text = "these data barely determine the shape parameter {subject} ({value:.3g} ± {standard_error:.2g})"
    return fill(text, f)


def undetermined_remedy(f: dict[str, Any]) -> str:
    """What to do about an undetermined shape parameter."""
    other = fill("; it cannot be distinguished from {with_it}", f) if f["with_it"] else ""
    simpler = "powers of the coordinate instead" if "low" in f else "a simpler term"
    return f"record motions of a different amplitude, use {simpler}, or fix the parameter{other}"


def perhaps_angle_remedy(f: dict[str, Any], audience: Audience = "python") -> str:
    """How to declare coordinates that may be angles."""
    return _declared(f["subject"], audience)


def _declared(names: Sequence[str], audience: Audience) -> str:
    if audience == "page":
        what = "is an angle, mark it as one" if len(names) == 1 else "are angles, mark them as such"
        return f"if {' and '.join(names)} {what}"
    how = f"--angles {','.join(names)}" if audience == "command line" else f"angles={[*names]}"
    what = "is an angle, declare it" if len(names) == 1 else "are angles, declare them"
    return f"if {' and '.join(names)} {what}: {how}"


def zero_offset(f: dict[str, Any]) -> str:
    """State the zero offset that a cosine and a small sine amount to."""
    size = "large" if f["offset"] > 0 else "small"
    text = f"{{term}} and its sine together indicate a zero offset: {{subject}} is too {size} by "
    return fill(text, f) + f"{1e3 * abs(f['offset']):.2g} mrad"


def smoothed(f: dict[str, Any]) -> str:
    """State where the absolute values of velocities are rounded."""
    below = [f"{name} below {width:g}" for name, width in zip(f["subject"], f["widths"], strict=True)]
    return f"abs() of velocities is smoothed near zero ({', '.join(below)})"


def correlated(f: dict[str, Any]) -> str:
    """State that residuals are not white."""
    what = "{subject}" if f["quantity"] == "position" else "{quantity} of {subject}"
    return fill(f"residuals of {what} are correlated from sample to sample ({{correlation:+.2f}})", f)


def gravity_remedy(f: dict[str, Any]) -> str:
    """What g that is not that of the Earth may come from."""
    if f["unit"]:
        return f"{f['unit']}; correct the unit"
    text = "check the times (a second of the recording may be {clock:.4g} s), the length, and whether the "
    return fill(text + "plane of motion is inclined", f)


def trials_differ(f: dict[str, Any]) -> str:
    """State which trials have other coefficients, and by how much these differ."""
    placed = list(zip(f["trials"], f["places"], strict=True))
    machines = [
        f"{group} ({', '.join(name for name, place in placed if place == k)})"
        for k, group in enumerate(f["groups"])
    ]
    text = f"the trials appear to be of {len(machines)} machines or loads, " + " and ".join(machines)
    return f"{text}: {groups_differ(f)}"


def trials_differ_remedy(f: dict[str, Any]) -> str:
    """How to declare the groups."""
    own = {name: f["groups"][place] for name, place in zip(f["trials"], f["places"], strict=True)}
    return f"compare them with groups={own!r}, or discover each by itself"


def unmeasured_part(f: dict[str, Any]) -> str:
    """Parts without a sensor, and their resonances, which only known forces determine."""
    one = "a part that no sensor measures appears to act on {subject}: a resonance ", "explains"
    two = "two parts that no sensor measures appear to act on {subject}: resonances ", "explain"
    text, explain = two if ", " in f["hidden"] else one
    text += "at {frequency:.3g} Hz (damping ratio {damping_ratio:.2g}) " if "frequency" in f else ""
    text += "and {second_frequency:.3g} Hz ({second_damping_ratio:.2g}) " if "second_frequency" in f else ""
    return fill(text + explain + " {explained:.2g%} of what no other term explains", f)


def unmeasured_part_remedy(f: dict[str, Any], audience: Audience = "python") -> str:
    """How to declare the parts; what is to be typed is in quotes."""
    names, friction = f["hidden"].split(", "), f["friction"].split(", ")
    if audience == "page":
        as_what = "coordinates" if len(names) > 1 else "a coordinate"
        return fill(f"name {{hidden}} as {as_what} without a sensor, and offer {{terms}} and {{friction}}", f)
    if audience == "command line":
        options = (
            f'--hidden {",".join(names)} {_term_options(f["terms"])}, and "{f["friction"]}" to --dissipation'
        )
        return f"add {options}, with a --library FILE of the few terms that you expect"
    terms, losses = (", ".join(f"'{text}'" for text in texts) for texts in (f["terms"], friction))
    offer = f"offer {terms} beside the few terms that you expect, with the dissipation {losses}"
    return f"declare {'them' if len(names) > 1 else 'it'} with hidden={names!r}, and {offer}"


def hidden_coordinate(f: dict[str, Any]) -> str:
    """What is known of a coordinate without a sensor, and what is arbitrary."""
    text = "{subject} was not measured: its motion is estimated from the equations "
    text += "(standard error {standard_error:.2g})"
    choices = {
        "sign": "its sign",
        "half a turn": "its zero up to half a turn",
        "sign and half a turn": "its sign, together with half a turn of its zero,",
    }
    kinds = [kind for kind in f["gauge"] if kind != "sign and half a turn"] or f["gauge"]
    named = " and ".join(choices[kind] for kind in kinds)
    verb = "are" if len(kinds) > 1 else "is"
    text += f"; {named} {verb} arbitrary and fixed by convention" if named else ""
    if f.get("factor", 0.0) > 1.05:
        text += "; a sensor for it would reduce standard errors by up to a factor of {factor:.2g} ({term})"
    return fill(text, f)


def hidden_motion_open(f: dict[str, Any]) -> str:
    """In how many trials the motion of a hidden coordinate is uncertain."""
    where = "" if f["of"] == 1 else " in {trials} of {of} trials"
    return fill("the motion of {subject} is hardly determined" + where + " (standard error {error:.2g})", f)
