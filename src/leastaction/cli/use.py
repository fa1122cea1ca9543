"""``leastaction show``, ``simulate``, ``validate`` and ``export``: what one does with a model file."""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from leastaction.cli.discover import groups_of_trials
from leastaction.cli.options import DataOptions, data_options
from leastaction.cli.output import check_file
from leastaction.cli.shape_options import length_option, lengths_of_links
from leastaction.cli.show import live_progress, say, show_forecast, show_model, warn, warn_of_doubts
from leastaction.cli.text import complete_file, one_line, shown
from leastaction.cli.values import assignments, blame, number
from leastaction.errors import DataError, InputError
from leastaction.exporters import FORMATS, check_format
from leastaction.identifiers import quoted

if TYPE_CHECKING:
    from leastaction import LagrangianModel, Trajectories
    from leastaction.simulation.results import ForecastResult

__all__ = ["export", "show", "simulate", "validate"]

_MAX_SAMPLES = 5_000_000
_FOLLOWED, _MUCH_LESS = 0.1, 0.2  # error over standard deviation, and share of it with angles in degrees
_GROUP = click.option(
    "--group",
    metavar="NAME",
    help="Group of trials whose law is used, for models with groups. Default: the first group.",
)


def _loaded(path: str, group: str | None) -> LagrangianModel:
    """The model of a file, or the law of one of its groups."""
    import leastaction

    found = leastaction.load(path)
    if group is None:
        return found
    with blame("--group"):
        return found.of_group(group)


@click.command(
    epilog="""\b
Example:
  leastaction show found/model.json
"""
)
@click.argument("model", metavar="MODEL", shell_complete=complete_file)
@_GROUP
@length_option
def show(model: str, group: str | None, lengths: tuple[str, ...]) -> None:
    """Print the law of a model file with its errors and verdict.

    MODEL is a model.json written by discover. The report, not this file, has the alternatives of the search.
    """
    with blame("--length"):
        given = lengths_of_links(lengths)
    show_model(_loaded(model, group), given)


@click.command(
    epilog="""\b
Example:
  leastaction simulate found/model.json --initial "theta1=1, theta1_dot=0" --duration 10 --rate 100 -o run.csv
"""
)
@click.argument("model", metavar="MODEL", shell_complete=complete_file)
@click.option(
    "--initial",
    required=True,
    metavar="NAME=VALUE,...",
    help="Coordinates and velocities at time 0. Default: 0.",
)
@click.option(
    "--initial-std",
    metavar="NAME=VALUE,...",
    help="Standard deviations of --initial; default 0. The file then has columns NAME_std with the standard "
    "deviation of each coordinate due to the errors of start, coefficients and equations.",
)
@click.option("--duration", required=True, metavar="SECONDS", help="Duration of the simulation.")
@click.option("--rate", required=True, metavar="HZ", help="Samples per second.")
@click.option(
    *("-o", "--output"),
    required=True,
    metavar="FILE",
    shell_complete=complete_file,
    help="CSV file to write: t, coordinates, velocities.",
)
@_GROUP
def simulate(
    model: str,
    initial: str,
    initial_std: str | None,
    duration: str,
    rate: str,
    output: str,
    group: str | None,
) -> None:
    """Simulate a model without external forces.

    MODEL is a model.json written by discover. If the integration cannot reach the end (the motion diverges,
    or the mass matrix becomes singular), nothing is written. The message says when and why, and the exit code
    is 1.
    """
    from leastaction.io import write_bytes

    file = check_file(output)
    times = _sample_times(duration, rate)
    found = _loaded(model, group)
    with blame("--initial"):
        q0, qdot0, missing = _initial_state(assignments(initial), found.coordinates)
    if missing:
        click.echo(f"note: {', '.join(missing)} not given in --initial: 0", err=True)
    std = None
    if initial_std is not None:
        with blame("--initial-std"):
            std = _initial_state(assignments(initial_std), found.coordinates)[:2]
    if found.fit.status != "ok":
        warn_of_doubts("the model", found)
    if found.prescribed:
        names = ", ".join(found.prescribed)
        warn(f"the motion of {names} was prescribed: it is uniform here; in Python, give its acceleration")
    with blame("--initial-std"):
        run = found.simulate(q0, qdot0, times, start_std=std)
    if not run.complete:
        raise DataError(
            f"the motion stops: {run.reason}; nothing was written; with this start, "
            f"choose a --duration below {run.stop_time:.3g}"
        )
    data = _csv(found.coordinates, run).encode()
    write_bytes(file, gzip.compress(data, mtime=0) if file.suffix.lower() == ".gz" else data)
    say(f"{len(run.t)} samples over {run.t[-1]:g} s: {shown(output)}")


def _sample_times(duration: str, rate: str):
    import numpy as np

    values = []
    for option, text in (("--duration", duration), ("--rate", rate)):
        with blame(option):
            value = number(text)
            if value <= 0:
                raise InputError(f"{quoted(text)} is not positive")
            values.append(value)
    length, frequency = values
    if length * frequency > _MAX_SAMPLES:
        raise InputError(f"--duration times --rate is more than {_MAX_SAMPLES} samples; choose less")
    # A little more than the last interval, so that 0.3 s at 10 Hz are 4 samples; never beyond --duration.
    count = int(length * frequency * (1 + 1e-12) + 1e-9) + 1
    if count < 2:
        raise InputError(
            f"--duration {duration} at --rate {rate} has no second sample; choose more of either"
        )
    return np.arange(count) / frequency


def _initial_state(given: dict[str, float], coordinates: tuple[str, ...]):
    velocities = tuple(f"{name}_dot" for name in coordinates)
    names = (*coordinates, *velocities)
    for name in given:
        if name not in names:
            raise InputError(f"{quoted(name)} is not in the model; it has {', '.join(names)}")
    missing = [name for name in names if name not in given]
    return [given.get(c, 0.0) for c in coordinates], [given.get(v, 0.0) for v in velocities], missing


def _csv(coordinates: tuple[str, ...], run) -> str:
    import numpy as np

    header = ["t", *coordinates, *(f"{name}_dot" for name in coordinates)]
    columns = [run.t[:, None], run.q, run.qdot]
    if run.std is not None:
        header += [f"{name}_std" for name in coordinates]
        columns.append(run.std)
    lines = (",".join(map(repr, row)) for row in np.hstack(columns).tolist())
    return "\n".join([",".join(header), *lines]) + "\n"


@click.command(
    short_help="Forecast measured trials with a model.",
    epilog="""\b
Example:
  leastaction validate found/model.json other.csv --horizon 2 --json errors.json
""",
)
@click.argument("model", metavar="MODEL", shell_complete=complete_file)
@data_options(coordinates_required=False)
@click.option("--horizon", metavar="SECONDS", help="Length of the forecasts. Default: about 1 s.")
@click.option(
    "--group",
    metavar="COLUMN",
    help="Column with the group of each trial, whose law is used. Default: the first group.",
)
@click.option(
    "--json",
    "json_file",
    metavar="FILE",
    shell_complete=complete_file,
    help="Also write the errors to a JSON file.",
)
def validate(
    model: str,
    data: Callable[..., DataOptions],
    horizon: str | None,
    group: str | None,
    json_file: str | None,
) -> None:
    """Forecast measured trials with a model, and print the errors.

    MODEL is a model.json written by discover. Forecasts start at regular intervals in every trial, from the
    state that best fits the preceding samples. Coordinates without a column, and columns of --measure, are
    treated as in the discovery. Errors are given in the units of the coordinates, next to
    those of an exact model, and relative to the noise and the standard deviation of the data.
    """
    import leastaction
    from leastaction.findings import sentence
    from leastaction.io import write_text
    from leastaction.model.checks import columns_of

    file = None if json_file is None else check_file(json_file)
    length = None
    if horizon is not None:
        with blame("--horizon"):
            length = number(horizon)
            if length <= 0:
                raise InputError(f"{quoted(horizon)} is not positive")
    found = leastaction.load(model)
    law = found.coordinates if found.calibration is not None else ()
    options = data(default=_measured(found), law=law).in_order_of(columns_of(found))
    trajectories = options.read()
    groups = None if group is None else groups_of_trials(options, group, trajectories.names)
    if not trajectories.driven and not any(term.known for term in found.terms):
        # the scale of the model came from forces
        warn("the model was found with known forces; without --forces, none act in the forecast")
    with live_progress("forecast"):
        result = found.validate(trajectories, length, groups=groups)
        degrees = _in_degrees(found, trajectories, result, groups)
    if degrees:
        units = ",".join(f"{name}=deg" for name in degrees)
        named = ", ".join(degrees)
        warn(f"{named}: the forecasts follow these data if they are in degrees; give --units {units}")
    if found.fit.status != "ok":
        warn_of_doubts("the model", found)
    if file is not None:
        write_text(file, json.dumps(result.to_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    for finding in trajectories.findings:
        say(f"note: {one_line(sentence(finding, 'command line'))}")
    without = [name for name in found.coordinates if name not in options.names]
    if without:
        verb = "has" if len(without) == 1 else "have"
        say(f"note: {', '.join(without)} {verb} no column: the motion follows from the other columns")
    show_forecast(result)
    if file is not None:
        say(f"errors: {shown(file)}")


def _measured(model: LagrangianModel) -> tuple[str, ...]:
    """Columns that the model was found from: coordinates that had samples, and sensors."""
    from leastaction.model.checks import columns_of

    noise = dict(zip(model.coordinates, model.noise_std.tolist(), strict=True))
    return tuple(name for name in columns_of(model) if math.isfinite(noise.get(name, 0.0)))


def _in_degrees(
    model: LagrangianModel, data: Trajectories, result: ForecastResult, groups: dict[str, str] | None
) -> list[str]:
    """Angles that forecasts do not follow as they are, and do if they are taken as degrees."""
    import numpy as np

    if result.coordinates != model.coordinates:
        return []
    off = np.flatnonzero(result.rms_over_std > _FOLLOWED).tolist()
    doubted = [i for i in off if model.coordinates[i] in model.angles]
    if not doubted:
        return []
    factors = np.ones(len(model.coordinates))
    factors[doubted] = np.pi / 180.0
    try:
        other = model.validate([t.changed(q=t.q * factors) for t in data], result.horizon, groups=groups)
    except DataError:
        return []
    better = np.all(other.rms_over_std[doubted] < _MUCH_LESS * result.rms_over_std[doubted])
    return [model.coordinates[i] for i in doubted] if better else []


_EXPORT_HELP = """Write a model for other programs.

MODEL is a model.json written by discover. The output does not depend on leastaction. Formats:

\b
""" + "\n".join(f"  {name:<10}{text}" for name, text in FORMATS.items())


@click.command(
    help=_EXPORT_HELP,
    short_help="Write a model for other programs: C, MATLAB, FMU, ...",
    epilog="""\b
Example:
  leastaction export found/model.json --format fmu3 --output pendulum.fmu
""",
)
@click.argument("model", metavar="MODEL", shell_complete=complete_file)
@click.option(
    "--format",
    "kind",
    required=True,
    metavar="FORMAT",
    shell_complete=lambda ctx, param, incomplete: [name for name in FORMATS if name.startswith(incomplete)],
    help="One of the formats above.",
)
@click.option(
    "-o", "--output", required=True, metavar="PATH", shell_complete=complete_file, help="File to write."
)
@_GROUP
def export(model: str, kind: str, output: str, group: str | None) -> None:
    """Write a model for other programs."""
    import leastaction

    with blame("--format"):
        check_format(kind)
    file = check_file(output)
    leastaction.export(_loaded(model, group), kind, file)
    say(f"{kind}: {shown(output)}")
