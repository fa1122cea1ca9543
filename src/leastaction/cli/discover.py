"""``leastaction discover``: from data files to a model and its report."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from leastaction.cli.failures import stoppable
from leastaction.cli.options import (
    DataOptions,
    blame,
    check_known,
    data_options,
    expression_list,
    force_offsets,
    known_coefficients,
    method_options,
    name_list,
)
from leastaction.cli.output import check_folder, write_together
from leastaction.cli.shape_options import (
    length_option,
    lengths_of_links,
    relevance_option,
    relevance_share,
    shape_option,
    shape_ranges,
    size_option,
    term_option,
    with_terms,
)
from leastaction.cli.show import live_progress, say, show_forecast, show_model, warn, warn_of_doubts
from leastaction.cli.text import complete_file, complete_folder, shown
from leastaction.errors import InputError
from leastaction.identifiers import quoted

if TYPE_CHECKING:
    from leastaction import LagrangianModel, Library, Trajectories
    from leastaction.simulation.forecast import ForecastResult

__all__ = ["OUTPUTS", "command_line", "discover", "groups_of_trials", "write_outputs"]

OUTPUTS = ("model.json", "report.html")

_EPILOG = """\b
Example:
  leastaction discover run.csv --coordinates theta1,theta2 --angles theta1,theta2 \\
    --known "cos(theta1)=9.81" --dissipation "theta1_dot**2/2" --hold-out 1 --output found
"""


@click.command(epilog=_EPILOG)
@data_options(coordinates_required=True)
@click.option(
    "--library",
    default="auto",
    show_default=True,
    metavar="FILE|auto|symbolic",
    shell_complete=complete_file,
    help="Candidates for L: a text file with one expression a line, # starts a comment; "
    "auto: what mechanical systems are usually made of; symbolic: more kinds of terms, grown by a grammar.",
)
@size_option
@click.option(
    "--gyroscopic",
    is_flag=True,
    help="With --library auto: also candidates linear in the velocities (spinning rotors, rotating frames, "
    "charges in magnetic fields).",
)
@term_option
@shape_option
@click.option(
    "--known",
    multiple=True,
    metavar="EXPR=VALUE",
    help="A coefficient that is known; may be given several times. Without known forces, one is needed.",
)
@click.option(
    "--dissipation",
    metavar="EXPR,EXPR|auto",
    help="Candidates for friction, e.g. 'x_dot**2/2, abs(x_dot)'; auto: viscous and dry friction of every "
    "coordinate, and between neighbouring angles and lengths.",
)
@length_option
@click.option(
    "--force-offset",
    metavar="A,B|A=SECONDS",
    help="Coordinates on which an unknown force may act, the bias of an actuator or sensor: constant, or "
    "changing within so many seconds.",
)
@click.option(
    "--prescribed",
    metavar="A,B",
    help="Coordinates that are measured but moved by forces nobody measured, such as a trolley under its "
    "drive: their equations are not used.",
)
@click.option(
    "--group",
    metavar="COLUMN",
    help="Column that tells groups of trials apart, with and without a payload for example: which "
    "coefficients differ between them is found.",
)
@click.option(
    "--keep-outliers",
    is_flag=True,
    help="Fit samples that are far off the motion, too; otherwise they are left out and counted.",
)
@click.option(
    "--method",
    default="gauss-newton",
    show_default=True,
    metavar="NAME",
    help="How to fit: gauss-newton, or adam, the paper's own method, for comparison.",
)
@click.option(
    "--option",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A setting of --method adam, e.g. threshold=0.05; may be given several times.",
)
@relevance_option
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Of the simulated noise that the search weighs supports with.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Processes that share the trials of long recordings, above 100,000 measured values (default: 1).",
)
@click.option(
    "--hold-out",
    multiple=True,
    metavar="N|P%|NAMES",
    help="Not fitted but forecast in the report: the last N trials; the last 20% of them, or of a single "
    "trial its end; or trials by name (a,b; a number is a name with a comma behind it: 7,). May be given "
    "several times with names.",
)
@click.option(
    "--output",
    required=True,
    metavar="DIR",
    shell_complete=complete_folder,
    help="Directory for model.json and report.html.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print one JSON object instead of tables: model, forecast errors (or null), paths of the files.",
)
@click.option("-q", "--quiet", is_flag=True, help="Print the paths of the files only; warnings remain.")
@click.option(
    "-v", "--verbose", is_flag=True, help="Print every step of the search, with its numbers, on stderr."
)
@click.pass_context
def discover(
    ctx: click.Context,
    data: Callable[..., DataOptions],
    library: str,
    size: str | None,
    gyroscopic: bool,
    terms: tuple[str, ...],
    shapes: tuple[str, ...],
    known: tuple[str, ...],
    dissipation: str | None,
    lengths: tuple[str, ...],
    force_offset: str | None,
    prescribed: str | None,
    group: str | None,
    keep_outliers: bool,
    method: str,
    settings: tuple[str, ...],
    relevance: str,
    seed: int,
    workers: int | None,
    hold_out: tuple[str, ...],
    output: str,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Find the Lagrangian behind measured coordinates.

    DATA are CSV, Parquet, NPZ or MAT files, or ROS 2 bags. Writes DIR/model.json and DIR/report.html
    and prints the table of terms. A model that does not hold is written too, marked as doubtful.
    """
    folder = check_folder(output, OUTPUTS)
    with blame("--option"):
        chosen = method_options(settings)
    share = relevance_share(relevance)
    options = data()
    with blame("--force-offset"):
        offsets = force_offsets(force_offset) if force_offset else ()
    with blame("--known"):
        given = known_coefficients(known)
    with blame("--length"):
        links = lengths_of_links(lengths)
    everything = options.read()
    fitted, held_out = _split(everything, hold_out)
    groups = {} if group is None else groups_of_trials(options, group, everything.names)
    _check_groups(groups, fitted, held_out)
    ranges = shape_ranges(shapes)
    candidates = with_terms(_library(library, size, gyroscopic, options, dissipation), terms)
    with blame("--known"):
        check_known(given, candidates)
    _check_scale(given, fitted, candidates)
    import leastaction

    with live_progress("prepare", verbose) as shown_progress, stoppable(shown_progress) as progress:
        model = leastaction.discover(
            fitted,
            candidates,
            known=given,
            force_offset=offsets,
            prescribed=list(dict.fromkeys([*options.inputs, *(name_list(prescribed) if prescribed else ())])),
            robust=not keep_outliers,
            method=method,
            seed=seed,
            options=chosen,
            relevance=share,
            shapes=ranges,
            groups={name: groups[name] for name in fitted.names} if groups else None,
            progress=progress,
            workers=workers,
        )
        progress("forecast", {})
        forecast = _forecast(model, held_out, groups)
        progress("report", {})
        write_outputs(folder, model, forecast, command_line(ctx))
    if as_json:
        _print_json(folder, model, forecast)
    else:
        _show(folder, model, forecast, links, quiet)


def _check_scale(known: Mapping[str, float], fitted: Trajectories, candidates: Library) -> None:
    if not known and not fitted.driven:
        raise InputError(
            "no force acts and no coefficient is known: then L = 0 solves every equation; give one "
            f'coefficient, which sets the units of L, e.g. --known "{candidates[0].text}=1", or --forces'
        )


def _print_json(folder: Path, model: LagrangianModel, forecast: ForecastResult | None) -> None:
    """The result as one object; paths as they are, for the program that reads it."""
    if model.fit.status != "ok":
        warn_of_doubts("the fit", model)
    document = {
        "model": model.to_dict(),
        "forecast": None if forecast is None else forecast.to_dict(),
        "files": {name.partition(".")[0]: str(folder / name) for name in OUTPUTS},
    }
    say(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False))


def _show(
    folder: Path,
    model: LagrangianModel,
    forecast: ForecastResult | None,
    lengths: Mapping[str, float],
    quiet: bool,
) -> None:
    if quiet:
        if model.fit.status != "ok":
            warn_of_doubts("the fit", model)
    else:
        show_model(model, lengths)
        if forecast is not None:
            say()
            show_forecast(forecast)
        say()
    for name in OUTPUTS:
        say(f"{name.partition('.')[0]}: {shown(folder / name)}")


def write_outputs(
    folder: Path, model: LagrangianModel, forecast: ForecastResult | None, command: str
) -> None:
    """Write model.json and report.html, both or none."""
    from leastaction import write_report

    write_together(
        folder,
        {
            "model.json": model.save,
            "report.html": lambda path: write_report(model, path, validation=forecast, command=command),
        },
    )


def command_line(ctx: click.Context) -> str:
    """Return the command as it could be typed again."""
    return shlex.join(["leastaction", *(ctx.find_root().obj or [])])


def _library(
    source: str, size: str | None, gyroscopic: bool, options: DataOptions, dissipation: str | None
) -> Library:
    from leastaction import Library

    if size is not None and source != "auto":
        raise InputError("--size goes with --library auto; neither a file nor symbolic has sizes")
    if gyroscopic and source != "auto":
        raise InputError(
            "--gyroscopic goes with --library auto; add such terms by --term or in the file, e.g. x*y_dot"
        )
    with blame("--library"):
        if source == "auto":
            library = Library.mechanical(options.names, options.angles, size=size, gyroscopic=gyroscopic)
        elif source == "symbolic":
            library = Library.symbolic(options.names, options.angles)
        else:
            library = Library.from_file(source, options.names, angles=options.angles)
    if dissipation is None:
        return library
    with blame("--dissipation"):
        return library.with_dissipation(expression_list(dissipation))


def _split(trajectories: Trajectories, hold_out: Sequence[str]) -> tuple[Trajectories, Trajectories | None]:
    """Trials to fit, and trials to forecast."""
    if not hold_out:
        return trajectories, None
    names = [name.strip() for text in hold_out for name in text.strip().removesuffix(",").split(",")]
    with blame("--hold-out"):
        return trajectories.hold_out(hold_out[0] if len(hold_out) == 1 else names)


def groups_of_trials(options: DataOptions, column: str, names: Sequence[str]) -> dict[str, str]:
    """The group of each trial, by name."""
    from leastaction.io import read_groups

    with blame("--group"):
        found = read_groups(options.paths, column, options.coordinates, options.time, options.trial)
    return dict(zip(names, found, strict=True))


def _check_groups(groups: Mapping[str, str], fitted: Trajectories, held_out: Trajectories | None) -> None:
    """Refuse a single group, and trials held out from a group of which none is fitted."""
    if not groups:
        return
    there = {groups[name] for name in fitted.names}
    for name in held_out.names if held_out else ():
        if groups[name] not in there:
            raise InputError(f"--hold-out: no trial of the group {quoted(groups[name])} is left to fit")
    if len(there) < 2:
        raise InputError(
            f"--group: every trial is in the group {quoted(next(iter(there)))}; leave the option out"
        )


def _forecast(
    model: LagrangianModel, held_out: Trajectories | None, groups: Mapping[str, str]
) -> ForecastResult | None:
    if held_out is None:
        return None
    try:
        return model.validate(held_out, groups={n: groups[n] for n in held_out.names} if groups else None)
    except InputError as error:
        # The model is found by now: no reason to lose it.
        warn(f"no forecast of the trials held out: {error}")
        return None
