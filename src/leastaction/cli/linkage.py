"""``leastaction linkage``: constraints between tracked points, and the coordinates that remain."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from leastaction.cli.options import DataOptions, by_name, table_options
from leastaction.cli.show import say
from leastaction.cli.values import blame
from leastaction.errors import InputError
from leastaction.identifiers import quoted

if TYPE_CHECKING:
    from leastaction.measure import Linkage

__all__ = ["linkage"]


@click.command(
    short_help="Find the constraints between tracked points.",
    epilog="""\b
Example:
  leastaction linkage markers.csv --point x1,y1 --point x2,y2
""",
)
@table_options()
@click.option(
    "--point",
    "points",
    multiple=True,
    required=True,
    metavar="X,Y",
    help="Columns of a tracked point, horizontal and vertical, in the same unit; use name=column if a column "
    "has another name. Repeatable.",
)
def linkage(data: Callable[..., DataOptions], points: tuple[str, ...]) -> None:
    """Find what ties tracked points in a plane: rods, sliders and points at rest.

    It prints the constraints with their deviations, and the options of leastaction discover that describe the
    points by as few coordinates as possible.
    """
    with blame("--point"):
        given = [_point(text) for text in points]
        columns = {name: column for point in given for name, column in point.items()}
        options = replace(data(default=columns), coordinates=columns)
        try:
            tracks = options.read()
        except InputError as error:
            raise InputError(str(error).partition("; give its column")[0]) from None
        from leastaction.measure import linkage as constraints

        found = constraints(tracks, [(x, y) for x, y in given])
    for line in found.ties or ["no constraint ties these points"]:
        say(line)
    if found.constant:
        say(f"at rest, left out: {', '.join(found.constant)}")
    say()
    say(_command(found, options))


def _point(text: str) -> dict[str, str]:
    """Name -> column of both components."""
    columns = by_name(text)
    if len(columns) != 2:
        raise InputError(f"{quoted(text)} is not a point; give two columns, horizontal and vertical: x1,y1")
    return columns


def _command(found: Linkage, options: DataOptions) -> str:
    """The command that fits a law in these coordinates; candidates and what is known are the user's."""
    columns, time, trial = options.coordinates, options.time, options.trial
    sensors = [text.partition("=")[0].strip() for text in found.measure]
    own = [name for name in found.coordinates if name in columns and name not in sensors]
    unseen = [name for name in found.coordinates if name not in own]
    given = [name if columns[name] == name else f"{name}={columns[name]}" for name in (*sensors, *own)]
    parts = [
        "leastaction discover",
        *map(shlex.quote, options.paths),
        "--coordinates",
        shlex.quote(",".join(given)),
    ]
    parts += ["--hidden", ",".join(unseen)] if unseen else []
    parts += ["--angles", ",".join(found.angles)] if found.angles else []
    parts += ["--time", shlex.quote(time)] if time != "t" else []
    parts += ["--trial", shlex.quote(trial)] if trial else []
    lines = [" ".join(parts), *(f'--measure "{text}"' for text in found.measure)]
    return " \\\n    ".join([*lines, "--library TERMS.txt --known TERM=VALUE"])
