"""Every sentence that a check can say: code → severity, what is so, what to do.

Checks compute codes and figures; nothing outside this file words them, and nothing reads the words back.
A text is a template over ``subject`` and the figures, or a function of both where it depends on them.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

from leastaction.findings.finding import Finding
from leastaction.findings.templates import (
    Audience,
    Message,
    Text,
    another_structure,
    converted_units,
    correlated,
    equations_off,
    equations_off_remedy,
    fill,
    friction,
    groups_differ,
    imitated_remedy,
    late_forces,
    missing_term,
    missing_term_remedy,
    rate_scaled,
    smoothed,
    time_dependent,
    time_dependent_remedy,
    time_unit,
    undetermined,
    undetermined_remedy,
    wrong_known,
    wrong_known_remedy,
    zero_offset,
)

__all__ = ["CODES", "Audience", "Message", "find", "sentence"]


def _hardly_determined(f: dict[str, Any]) -> str:
    text = "these data hardly determine {subject}"
    if f["scale_open"]:
        text += " (all coefficients can grow together: the scale of L is open)"
    elif f["combination"]:
        text += " (open to {open:.0f%}: the combination {combination})"
    return fill(text, f)


def _competing_remedy(f: dict[str, Any]) -> str:
    at = [f"{name} = {value:.2g}" for name, value in zip(f["at_names"], f["at_values"], strict=True)]
    where = f", e.g. through {', '.join(at)}" if at else ""
    return f"record motions in which they differ{where}, or leave one of them out"


def _slow_force(f: dict[str, Any]) -> str:
    return fill(
        "a force on {subject} that changes within {seconds:g} s was looked for: between {lowest:.3g} and "
        "{highest:.3g}, ± {standard_error:.2g}" + (": hardly any" if f["hardly_any"] else ""),
        f,
    )


CODES: dict[str, Message] = {
    # the equations do not hold
    "not-converged": Message(
        "warning", "the solver did not converge ({reason})", "try fewer candidates or longer data"
    ),
    "equations-off": Message(
        "warning",
        equations_off,
        equations_off_remedy,
        on_command_line=partial(equations_off_remedy, prescribed="--prescribed {subject}"),
    ),
    # a likely cause
    "missing-term": Message(
        "warning",
        missing_term,
        missing_term_remedy,
        on_command_line=partial(missing_term_remedy, on_command_line=True),
    ),
    "time-dependent": Message(
        "warning",
        time_dependent,
        "add {subject} to the candidates, or measure what moves it",
        on_command_line=time_dependent_remedy,
    ),
    "unmodelled-friction": Message(
        "warning",
        friction,
        "give {subject} as a candidate for dissipation",
        on_command_line="add {subject} to --dissipation",
    ),
    "energy-fed-in": Message(
        "warning",
        "energy seems to be fed in along {velocities} (friction of about {coefficient:.2g})",
        "check the sign of forces and of known coefficients, and whether a driving force is missing",
    ),
    "wrong-known-coefficient": Message("warning", wrong_known, wrong_known_remedy),
    "late-forces": Message(
        "warning",
        late_forces,
        "find the delay with la.delay.estimate",
        on_command_line="give --force-delay {delay:.2g}, or that of the device",
    ),
    "slight-friction": Message(
        "note",
        friction,
        "with {subject} among the candidates for dissipation it would be in the model",
        on_command_line="with {subject} in --dissipation it would be in the model",
    ),
    "slight-delay": Message(
        "note",
        late_forces,
        "too little to matter; la.delay.estimate finds it",
        on_command_line="too little to matter; --force-delay {delay:.2g} allows for it",
    ),
    "scaled-forces": Message(
        "warning",
        "the forces seem to be {factor:.2g} times those given ({share:.0f%} of the equation error)",
        "check their units and scale",
    ),
    "swapped-forces": Message(
        "warning",
        "the forces on {subject} seem to be swapped: exchanged, they lead to equations that hold",
        "check the sequence of the columns",
    ),
    # no particular term is missing
    "form-imitated": Message(
        "warning",
        "the candidates seem to imitate a law that they cannot write: a smooth change of the {kind} energy "
        "explains the motion better (-2 log likelihood {gain:.0f}, for {freedom} numbers more) and changes "
        "the accelerations by {shift:.1f%}",
        imitated_remedy,
        on_command_line=partial(imitated_remedy, on_command_line=True),
    ),
    "form-open": Message(
        "warning",
        "other smooth {kind} energies explain the motion as well, with accelerations that differ by "
        "{open:.1f%}",
        "record longer, or with less noise",
    ),
    # shape parameters
    "shape-undetermined": Message(
        "warning",
        undetermined,
        undetermined_remedy,
    ),
    "shape-at-bound": Message(
        "warning",
        "the shape parameter {subject} is at the end of its range ({value:.3g} of {low:.3g} to {high:.3g})",
        "widen the range, or leave it out",
        on_command_line="widen the range of --shape {subject}, or leave it out",
    ),
    "shape-not-settled": Message(
        "warning",
        "the shape parameter {subject} did not settle ({value:.3g})",
        "give a range around the number that you expect with shapes={{'{subject}': (low, high)}}",
        on_command_line="give a range around the number that you expect with --shape {subject}=LOW..HIGH",
    ),
    # the data
    "rate-unexplained": Message(
        "warning",
        "the library cannot explain the measured {quantity} of {subject} (its residual is "
        "{residual_ratio:.2f} times the noise)",
        "is it a sensor of its own, at the same times as the positions?",
    ),
    "rate-constant": Message("warning", "the measured {quantity} of {subject} is constant", "leave it out"),
    "rate-unrelated": Message(
        "warning",
        "the measured {quantity} of {subject} hardly follows the derivative of its coordinate",
        "check the column, and that times are the same",
    ),
    "rate-scaled": Message("warning", rate_scaled, "convert it, or leave it out"),
    "rate-offset": Message(
        "warning",
        "the measured {quantity} of {subject} has an offset of {offset:.3g} from the derivative of its "
        "coordinate",
        "subtract it, it is what the sensor shows at rest",
    ),
    "looks-like-noise": Message(
        "warning",
        "{share:.0f%} of the spread of {subject} looks like noise",
        "if the sensor is better than that, sampling is too slow for the motion, so sample faster",
    ),
    "angle-in-degrees": Message(
        "warning",
        "{subject} covers {span:.3g} within a recording",
        "sines and cosines want radians; if it is in degrees, read it with units={{'{subject}': 'deg'}}",
        on_command_line="sines and cosines want radians; if it is in degrees, give --units {subject}=deg",
        on_page="sines and cosines want radians; if it is in degrees, mark {subject} as such",
    ),
    "undeclared-angle": Message(
        "warning",
        "{subject} jumps by about 2π {jumps} times, which was undone",
        "if it is an angle, say so with angles=['{subject}']",
        on_command_line="if it is an angle, say so with --angles {subject}",
        on_page="if it is an angle, mark {subject} as an angle",
    ),
    "slow-sampling": Message(
        "warning",
        "sampling is slow ({samples_per_period:.1f} samples a period of the fastest motion, where at least "
        "{needed:g} are needed)",
        "what is faster looks slow, so sample faster",
    ),
    "motion-in-noise": Message(
        "warning",
        "the motion of {subject} ({motion:.2g}) hardly shows above its noise ({noise:.2g})",
        "record larger motions",
    ),
    # the structure and its coefficients
    "hardly-determined": Message(
        "warning",
        _hardly_determined,
        "record larger or different motions, or fix one of the coefficients with known={{...}}",
        on_command_line="record larger or different motions, or fix one of the coefficients with --known",
    ),
    "competing-structures": Message(
        "warning", "these data cannot tell {subject} from {others}", _competing_remedy
    ),
    "slight-terms": Message(
        "note",
        "these data hardly determine {subject}, but what is unexplained matters more",
        "leave it out of the candidates for a simpler law",
    ),
    "slight-rival": Message(
        "note",
        "these data cannot tell {subject} from {others}, but what is unexplained matters more",
        "leave them out of the candidates for a simpler law",
    ),
    "scale-open": Message(
        "warning",
        "nothing known reaches {subject}: the coefficients of its terms may all be multiplied by one number",
        "give one of these coefficients with known={{...}}",
        on_command_line="give one of these coefficients with --known",
    ),
    "mass-matrix-not-finite": Message(
        "warning",
        "the mass matrix is not finite along the data",
        "a term divides by something that vanishes there: shift the coordinate, or leave the term out",
    ),
    "mass-matrix-not-positive": Message(
        "warning",
        "the mass matrix is not positive definite along {share:.0f%} of the data",
        "a kinetic term is missing, or the sign of forces or of a known coefficient is wrong",
    ),
    "negative-dissipation": Message(
        "warning",
        "the dissipation term {subject} came out negative and was left out, since it would feed energy in",
        "check the sign of forces and known coefficients, or a missing term",
    ),
    "another-structure": Message(
        "warning",
        another_structure,
        "compare its forecasts of held-out trials with those of the chosen structure",
    ),
    # what was done to data and library
    "time-unit": Message("note", time_unit),
    "dates": Message("note", "the dates in '{column}' became seconds from the first one of each file"),
    "converted-units": Message("note", converted_units),
    "units-row": Message("note", "the row below the header was read as units: {units}"),
    "decimal-comma": Message("note", "numbers were read with a decimal comma"),
    "first-sheet": Message("note", "the sheet '{sheet}' was read, and no other: {others}"),
    "text-encoding": Message("note", "the text is not UTF-8 and was read as {encoding}"),
    "angle-unwrapped": Message("note", "{jumps} jumps of 2π removed from {subject}"),
    "forces-unused": Message("note", "forces on {subject} were left out: the motion there is prescribed"),
    "rates-unused": Message(
        "note", "method='adam' fits positions alone: measured velocities and accelerations were left out"
    ),
    "outliers-left-out": Message(
        "note",
        "{count} samples of {subject} ({share:.2g%}) are outliers, more than {far:g} standard deviations off "
        "the motion and alone there; they are left out",
    ),
    "friction-smoothed": Message("note", smoothed),
    "undefined-candidates": Message(
        "note", "candidates that are undefined somewhere along the data were left out: {subject}"
    ),
    # what is worth knowing
    "scatter-of-forces": Message(
        "note",
        "the equation of {subject} is off by {equation_error:.1f%} of its forces, no more than the scatter "
        "of those that were given leaves",
        "quieter forces would narrow the intervals",
    ),
    "equation-error": Message(
        "note",
        "the equation of {subject} leaves {equation_error:.2g%} of its forces unexplained",
        "little on hardware; in a simulation a small term or friction is missing",
    ),
    "correlated-residuals": Message(
        "note",
        correlated,
        "coloured noise, encoder steps or filtered data; intervals may be too narrow or too wide",
    ),
    "mode-scale": Message(
        "note",
        "L is not unique: the motion is so nearly linear that {open} of the scales of its {modes} modes may "
        "be any number, with the same accelerations",
        "natural frequencies, damping ratios and mode shapes do not depend on it (model.linearise); a known "
        "coefficient or force for each mode fixes it",
        on_command_line="natural frequencies, damping ratios and mode shapes do not depend on it; --known or "
        "--forces for each mode fixes it",
    ),
    "groups-differ": Message("note", groups_differ),
    "groups-alike": Message("note", "no coefficient differs between the groups {groups}, within its error"),
    "groups-known": Message(
        "note",
        "in {groups} no force is known, and {subject} was taken to have one coefficient in all groups: "
        "differences are relative to it, and what multiplies every coefficient of a group does not show",
    ),
    "zero-offset": Message("note", zero_offset),
    "stopped-early": Message(
        "warning",
        "the search was stopped: this is the best law so far, and likely causes were not looked for",
        "let the search run to its end",
    ),
    "knots-not-settled": Message(
        "note",
        "coefficients still moved when the knots were refined for the last time",
        "sample faster",
    ),
    "coefficients-of-free-runs": Message(
        "note",
        "the equations hold to some per cent only, so the coefficients are those of the best free runs over "
        "{horizon:.2g} s, and their intervals allow for what the library cannot explain",
    ),
    "fast-forces": Message(
        "note",
        "coordinates follow forces of few samples a period, so all of the forces acts; between samples they "
        "are {between}",
    ),
    "forecasts": Message(
        "note",
        "free runs from states along the data, over {horizon:.2g} s or about a period, are off by "
        "{error:.2g%} of the spread",
        "compare forecasts of held-out trials with what you need",
    ),
    "slow-force": Message("note", _slow_force),
    "rate-noise": Message("note", "{quantity} of {subject}: noise {noise:.3g}"),
}


def find(code: str, subject: str | Iterable[str] = (), /, **values: Any) -> Finding:
    """Return the finding of a code, with its sentences.

    Parameters
    ----------
    code : str
        A key of `CODES`.
    subject : str or iterable of str
        Coordinates or terms that it is about.
    **values
        The figures that its texts need, and others worth keeping.

    Examples
    --------
    >>> print(find("motion-in-noise", "x", motion=0.011, noise=0.05))
    the motion of x (0.011) hardly shows above its noise (0.05): record larger motions
    """
    row = CODES[code]
    about = (subject,) if isinstance(subject, str) else tuple(subject)
    fields = {"subject": about, **values}
    return Finding(code, row.severity, about, values, fill(row.message, fields), fill(row.remedy, fields))


def sentence(finding: Finding, audience: Audience = "python") -> str:
    """Return a finding as text, its remedy in the words of the command line or of the app.

    Examples
    --------
    >>> print(sentence(find("undeclared-angle", "theta", jumps=3), "command line"))
    theta jumps by about 2π 3 times, which was undone: if it is an angle, say so with --angles theta
    """
    remedy = _other_remedies(audience).get(finding.code)
    if not remedy:
        return str(finding)
    try:
        return f"{finding.message}: {fill(remedy, {**finding.values, 'subject': finding.subject})}"
    except (KeyError, TypeError, ValueError):  # figures of another version, from a file
        return str(finding)


def _other_remedies(audience: Audience) -> dict[str, Text]:
    if audience == "python":
        return {}
    rows = CODES.items()
    return {code: row.on_command_line if audience == "command line" else row.on_page for code, row in rows}
