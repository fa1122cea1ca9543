"""All sentences of the checks: code → severity, statement, remedy.

Checks return codes and figures. Their wording is defined here only, and no code parses it.
A text is a template over ``subject`` and the figures, or a function of both where wording depends on them.
"""

from __future__ import annotations

from functools import partial

from leastaction.findings import stated, templates
from leastaction.findings.finding import Message

__all__ = ["CODES"]


CODES: dict[str, Message] = {
    # the equations do not hold
    "not-converged": Message(
        "warning", "the solver did not converge ({reason})", stated.not_converged_remedy
    ),
    "equations-off": Message(
        "warning",
        templates.equations_off,
        templates.equations_off_remedy,
        on_command_line=partial(templates.equations_off_remedy, prescribed="--prescribed {subject}"),
        on_page=partial(templates.equations_off_remedy, prescribed="“Moved by unmeasured forces”"),
    ),
    # a likely cause
    "missing-term": Message(
        "warning",
        templates.missing_term,
        templates.missing_term_remedy,
        on_command_line=partial(templates.missing_term_remedy, audience="command line"),
        on_page=partial(templates.missing_term_remedy, audience="page"),
    ),
    "time-dependent": Message(
        "warning",
        templates.time_dependent,
        "add {subject} to the candidates, or measure the input that drives the system",
        on_command_line=templates.time_dependent_remedy,
    ),
    "trials-differ": Message(
        "warning",
        templates.trials_differ,
        templates.trials_differ_remedy,
        on_command_line="name the machine or load of each trial in a column, and give it with --group",
        on_page="discover each group by itself, or compare them in Python or on the command line",
    ),
    "unmeasured-part": Message(
        "warning",
        templates.unmeasured_part,
        templates.unmeasured_part_remedy,
        on_command_line=partial(templates.unmeasured_part_remedy, audience="command line"),
        on_page=partial(templates.unmeasured_part_remedy, audience="page"),
    ),
    "unmodelled-friction": Message(
        "warning",
        templates.friction,
        "offer {subject} as a dissipation candidate",
        on_command_line="add {subject} to --dissipation",
    ),
    "energy-fed-in": Message(
        "warning",
        "energy appears to be fed in through {velocities} (apparent friction {coefficient:.2g})",
        "check the signs of forces and known coefficients, and whether a driving force is missing",
    ),
    "wrong-known-coefficient": Message("warning", templates.wrong_known, templates.wrong_known_remedy),
    "late-forces": Message(
        "warning",
        templates.late_forces,
        templates.late_forces_remedy,
        on_command_line="use --force-delay {delay:.2g}, or the delay stated for the device",
        on_page="give it, or the delay stated for the device, under “Delay of the forces”",
    ),
    "slight-friction": Message(
        "note",
        templates.friction,
        "too small to affect the verdict; offer {subject} as a dissipation candidate to include it",
        on_command_line="too small to affect the verdict; add {subject} to --dissipation to include it",
    ),
    "slight-delay": Message(
        "note",
        templates.late_forces,
        "too small to affect the verdict; la.delay.estimate measures it",
        on_command_line="too small to affect the verdict; --force-delay {delay:.2g} corrects it",
        on_page="too small to affect the verdict; “Delay of the forces” corrects it",
    ),
    "scaled-forces": Message(
        "warning",
        "the forces appear to be {factor:.2g} times the recorded values (this explains {share:.0f%} of the "
        "equation error)",
        "check their units and scale",
    ),
    "swapped-forces": Message(
        "warning",
        "the forces on {subject} appear to be swapped: with the columns exchanged, the equations hold",
        "check the order of the columns",
    ),
    # no particular term is missing
    "form-imitated": Message(
        "warning",
        "the true law is probably not among the candidates: a smooth change of the {kind} energy explains "
        "the motion better (-2 log likelihood lower by {gain:.0f} with {freedom} more parameters) and "
        "changes the accelerations by {shift:.1f%}",
        templates.imitated_remedy,
        on_command_line=partial(templates.imitated_remedy, audience="command line"),
    ),
    "form-open": Message(
        "warning",
        "other smooth {kind} energies explain the motion equally well, with accelerations that differ by "
        "{open:.1f%}",
        "record for longer, or with less noise",
    ),
    "simpler-form": Message(
        "warning",
        "a law with {family} explains the motion with higher evidence (log evidence {gain:.0f} higher), in "
        "{free_terms} terms instead of {instead_of}, and its accelerations differ by {shift:.1f%}; the terms "
        "found seem to imitate {imitated}",
        templates.imitated_remedy,
        on_command_line=partial(templates.imitated_remedy, audience="command line"),
    ),
    # shape parameters
    "shape-undetermined": Message("warning", templates.undetermined, templates.undetermined_remedy),
    "shape-at-bound": Message(
        "warning",
        "the shape parameter {subject} is at the end of its range ({value:.3g}, range {low:.3g} to "
        "{high:.3g})",
        "widen the range, or remove it",
        on_command_line="widen the range of --shape {subject}, or remove it",
    ),
    "shape-not-settled": Message(
        "warning",
        "the shape parameter {subject} did not converge ({value:.3g})",
        "bound it around the value that you expect: shapes={{'{subject}': (low, high)}}",
        on_command_line="bound it around the value that you expect: --shape {subject}=LOW..HIGH",
        on_page="write the value that you expect in its place, or offer other candidates",
    ),
    # coordinates without a sensor
    "hidden-coordinate": Message("note", templates.hidden_coordinate),
    "hidden-gauge": Message(
        "warning",
        "the candidates do not fix the choice of the coordinate {subject} ({changes}): after such a change "
        "the same terms describe the same motion",
        "give the coefficient of a term with {subject} as known, or leave out a candidate",
    ),
    "hidden-start-unconfirmed": Message(
        "note",
        "no law tried as a start for {subject} follows the motion closely, or clearly better than others",
        "if the fit is doubtful, offer fewer candidates, give coefficients as known, or record for longer",
    ),
    "hidden-motion-open": Message(
        "warning", templates.hidden_motion_open, "record more of the motion that {subject} acts on"
    ),
    # columns that are functions of the coordinates
    "column-unexplained": Message(
        "warning",
        "model and measurement function do not explain the column {subject} (residual {residual_ratio:.2f} "
        "times the noise)",
        "check the function, or give start values of its numbers, such as {{s=800}}",
    ),
    "calibration-open": Message("warning", stated.calibration_open, stated.calibration_remedy),
    # the data
    "rate-unexplained": Message(
        "warning",
        "the model does not explain the measured {quantity} of {subject} (residual {residual_ratio:.2f} "
        "times the noise)",
        "check that it comes from a sensor of its own, with the same time stamps as the positions",
    ),
    "rate-constant": Message(
        "warning", "the measured {quantity} of {subject} is constant", "leave this channel out"
    ),
    "rate-unrelated": Message(
        "warning",
        "the measured {quantity} of {subject} does not follow the derivative of its coordinate",
        "check the column and the time stamps",
    ),
    "rate-scaled": Message("warning", templates.rate_scaled, "convert it, or leave it out"),
    "rate-offset": Message(
        "warning",
        "the measured {quantity} of {subject} is offset by {offset:.3g} from the derivative of its "
        "coordinate",
        "subtract what the sensor reads at rest",
    ),
    "looks-like-noise": Message(
        "warning",
        "{share:.0f%} of the spread of {subject} looks like noise",
        "if the sensor is better than that, the sampling rate is too low for the motion: sample faster",
    ),
    "angle-in-degrees": Message(
        "warning",
        "{subject} spans {span:.3g} within one recording",
        "sines and cosines expect radians; if it is in degrees, read it with units={{'{subject}': 'deg'}}",
        on_command_line="sines and cosines expect radians; if it is in degrees, give --units {subject}=deg",
        on_page="sines and cosines expect radians; if {subject} is in degrees, mark it as such",
    ),
    "undeclared-angle": Message(
        "warning",
        "{subject} jumps by about 2π {jumps} times; the jumps were removed",
        "if it is an angle, declare it with angles=['{subject}']",
        on_command_line="if it is an angle, declare it with --angles {subject}",
        on_page="if it is an angle, mark {subject} as an angle",
    ),
    "slow-sampling": Message(
        "warning",
        "the sampling rate is too low ({samples_per_period:.1f} samples per period of the fastest motion; at "
        "least {needed:g} are needed)",
        "sample faster: aliasing makes fast motion look slow",
    ),
    "motion-in-noise": Message(
        "warning",
        "the motion of {subject} ({motion:.2g}) barely exceeds its noise ({noise:.2g})",
        "record larger motions",
    ),
    # the structure and its coefficients
    "hardly-determined": Message(
        "warning",
        templates.hardly_determined,
        "record larger or more varied motions, or fix one of the coefficients with known={{...}}",
        on_command_line="record larger or more varied motions, or fix one of the coefficients with --known",
        on_page="record larger or more varied motions, or give one of the “Known coefficients”",
    ),
    "competing-structures": Message(
        "warning", "these data cannot distinguish {subject} from {others}", templates.competing_remedy
    ),
    "slight-terms": Message(
        "note",
        "these data barely determine {subject}, but the effect is smaller than the equation error",
        "for a simpler law, leave out such candidates",
    ),
    "slight-rival": Message(
        "note",
        "these data cannot distinguish {subject} from {others}, but the difference is smaller than the "
        "equation error",
        "remove them from the candidates for a simpler law",
    ),
    "cancelling-terms": Message(
        "note",
        "{subject} nearly cancel: the largest of their forces is {factor:.0f} times the sum",
        "such terms often imitate another law: offer other candidates, or measure from a rest position",
    ),
    "highest-power": Message(
        "note", "{subject} is the highest power offered", "offer higher ones, or terms of another form"
    ),
    "scale-open": Message(
        "warning",
        "neither a force nor a known coefficient sets the scale of {subject}: all coefficients of its terms "
        "can be multiplied by a common factor",
        "give one of these coefficients with known={{...}}",
        on_command_line="give one of these coefficients with --known",
        on_page="give one of these coefficients under “Known coefficients”",
    ),
    "mass-matrix-not-finite": Message(
        "warning",
        "the mass matrix is not finite along the data",
        "a term divides by a quantity that vanishes there: shift the coordinate, or remove the term",
    ),
    "mass-matrix-not-positive": Message(
        "warning",
        "the mass matrix is not positive definite along {share:.0f%} of the data",
        "a kinetic term may be missing, or the forces or a known coefficient may have the wrong sign",
    ),
    "negative-dissipation": Message(
        "warning",
        "the dissipation term {subject} came out negative, which would feed energy in, and was left out",
        "check the signs of forces and known coefficients, and whether a term is missing",
    ),
    "another-structure": Message(
        "warning",
        templates.another_structure,
        "compare its forecasts of held-out trials with those of the chosen structure",
    ),
    # what was done to data and library
    "time-unit": Message("note", templates.time_unit),
    "time-column": Message("note", "the times were read from the column '{column}'"),
    "long-time-step": Message(
        "note",
        "the samples are {step:.3g} s apart if the times in '{column}' are seconds",
        "if they are not, give their unit, e.g. time_unit='ms'",
        on_command_line="if they are not, give their unit, e.g. --time-unit ms",
        on_page="if they are not, choose their unit",
    ),
    "dates": Message(
        "note", "the dates in '{column}' were converted to seconds since the first date of each file"
    ),
    "converted-units": Message("note", templates.converted_units),
    "units-row": Message("note", "the row below the header was read as units: {units}"),
    "decimal-comma": Message("note", "numbers were read with a decimal comma"),
    "first-sheet": Message("note", "only the sheet '{sheet}' was read; the others are {others}"),
    "text-encoding": Message("note", "the text is not UTF-8 and was read as {encoding}"),
    "angle-unwrapped": Message("note", "{jumps} jumps of 2π were removed from {subject}"),
    "forces-unused": Message("note", "forces on {subject} were ignored, because its motion is prescribed"),
    "rates-unused": Message(
        "note", "method='adam' fits positions only; measured velocities and accelerations were ignored"
    ),
    "outliers-left-out": Message(
        "note",
        "{count} samples of {subject} ({share:.2g%}) were left out as outliers: each is isolated and more "
        "than {far:g} standard deviations off the motion",
    ),
    "friction-smoothed": Message("note", templates.smoothed),
    "undefined-candidates": Message(
        "note",
        "candidates that are undefined or nearly singular somewhere along the data were left out: {subject}",
    ),
    # what is worth knowing
    "scatter-of-forces": Message(
        "note",
        "the equation of {subject} is off by {equation_error:.1f%} of its forces; the noise of the recorded "
        "forces accounts for this",
        "less noisy forces would narrow the intervals",
    ),
    "equation-error": Message(
        "note",
        "the equation of {subject} leaves {equation_error:.2g%} of its forces unexplained",
        "small for hardware; in simulated data, a small term or friction is missing",
    ),
    "correlated-residuals": Message(
        "note",
        templates.correlated,
        "typical of coloured noise, encoder steps or filtered data; intervals may be too narrow or too wide",
    ),
    "mode-scale": Message(
        "note",
        "L is not unique: other laws of the candidates, with another scale of {open} of the {modes} modes, "
        "give indistinguishable accelerations along these data",
        "natural frequencies, damping ratios and mode shapes are not affected (model.linearise); a known "
        "coefficient or force for each mode fixes its scale",
        on_command_line="natural frequencies, damping ratios and mode shapes are not affected; --known or "
        "--forces for each mode fixes its scale",
        on_page="natural frequencies, damping ratios and mode shapes are not affected; a known coefficient "
        "or force for each mode fixes its scale",
    ),
    "groups-differ": Message("note", stated.groups_differ),
    "groups-alike": Message("note", "no coefficient differs significantly between the groups {groups}"),
    "groups-known": Message(
        "note",
        "no force is known in {groups}, so {subject} was assumed to be the same in all groups: differences "
        "are relative to it, and a factor common to all coefficients of a group is undetectable",
    ),
    "perhaps-angle": Message(
        "note",
        "no candidate holds a sine or cosine of {subject}",
        templates.perhaps_angle_remedy,
        on_command_line=partial(templates.perhaps_angle_remedy, audience="command line"),
        on_page="if this is an angle, mark it as one",
    ),
    "zero-offset": Message("note", templates.zero_offset),
    "stopped-early": Message(
        "warning",
        "the search was stopped early: this is the best law so far, and likely causes were not examined",
        "let the search run to its end",
    ),
    "knots-not-settled": Message(
        "note", "the coefficients still changed at the last refinement of the knots", "sample faster"
    ),
    "coefficients-of-free-runs": Message(
        "note",
        "the equations hold only to a few per cent, so the coefficients are those with the smallest "
        "simulation error over {horizon:.2g} s; their intervals allow for what the library cannot explain",
    ),
    "fast-forces": Message(
        "note",
        "coordinates follow forces that have few samples per period, so the whole force acts; between "
        "samples, forces are {between}",
    ),
    "forecasts": Message(
        "note", stated.followed, "compare forecasts of held-out trials with the accuracy that you need"
    ),
    "forecasts-fail": Message(
        "warning",
        stated.failed,
        "record more or longer trials with more varied motions, or offer fewer candidates",
    ),
    "forecast-reach": Message(
        "note", stated.reach, "estimated from the intervals: forecast a trial that was held out"
    ),
    "gravity-off": Message(
        "warning",
        "{potential} over {coupling} and the length of {subject} ({length:g} m) give g = {gravity:.4g} m/s², "
        "not that of the Earth",
        templates.gravity_remedy,
    ),
    "length-implausible": Message(
        "note",
        "if {potential} is gravity, {potential} over {coupling} means a length of {on_earth:.2g} m on Earth",
        "check that the times are in seconds",
        on_command_line="check that the times are in seconds (--time-unit)",
    ),
    "length-unused": Message(
        "note",
        "the length of {subject} was not used, because L lacks the potential or coupling that determines g",
    ),
    "slow-force": Message("note", templates.slow_force),
    "rate-noise": Message("note", "{quantity} of {subject}: noise {noise:.3g}"),
}
