"""The argument DATA and the options that say what its columns mean."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, wraps
from typing import TYPE_CHECKING, Any

import click

from leastaction.cli.show import warn
from leastaction.cli.text import complete_file
from leastaction.cli.values import blame, column_map, name_list, number, pairs
from leastaction.errors import DataWarning, InputError
from leastaction.identifiers import measured_columns, quoted

if TYPE_CHECKING:
    from leastaction import Trajectories

__all__ = ["DataOptions", "by_name", "data_options", "table_options"]


@dataclass(frozen=True)
class DataOptions:
    """Where the data are: files, and which columns mean what."""

    paths: tuple[str, ...]
    coordinates: dict[str, str]
    time: str
    trial: str | None
    forces: dict[str, str]
    angles: tuple[str, ...]
    velocities: dict[str, str] = field(default_factory=dict)
    accelerations: dict[str, str] = field(default_factory=dict)
    force_delay: float = 0.0
    inputs: tuple[str, ...] = ()
    time_unit: str | None = None
    units: dict[str, str] | str = "SI"
    hidden: tuple[str, ...] = ()
    measure: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, given: Mapping[str, Any], default: Sequence[str] = (), law: Sequence[str] = ()
    ) -> DataOptions:
        """Check the texts of the options by name.

        ``default`` are the coordinates where none are given. ``law`` are those of a model whose columns
        measure functions of them.
        """
        from leastaction.identifiers import check_coordinate_names

        coordinates, angles, forces = given["coordinates"], given["angles"], given["forces"]
        with blame("--coordinates"):
            columns = by_name(coordinates) if coordinates is not None else {c: c for c in default}
            check_coordinate_names(columns)
        with blame("--input"):
            moved = by_name(given["input"]) if given.get("input") else {}
            for name in {*moved} & {*columns}:
                raise InputError(f"{quoted(name)} is named in --coordinates, too; name it in one of the two")
            names = check_coordinate_names([*columns, *moved])
        with blame("--hidden"):
            unseen = tuple(name for name in law if name not in names)
            unseen = check_coordinate_names(name_list(given["hidden"])) if given.get("hidden") else unseen
            for name in {*unseen} & {*names}:
                raise InputError(
                    f"{quoted(name)} has a column, too: leave it out of --coordinates and --input"
                )
        columns |= moved
        columns = dict(zip(names, columns.values(), strict=True))
        with blame("--angles"):
            turning = check_coordinate_names(name_list(angles)) if angles else ()
            try:
                _check_are_coordinates(turning, [*names, *unseen])
            except InputError as error:
                hint = "; name coordinates without a column in --hidden" if given.get("measure") else ""
                raise InputError(f"{error}{hint}") from None
        functions = tuple(given.get("measure") or ())
        with blame("--measure"):
            for column in measured_columns(functions):
                if column not in names:
                    raise InputError(f"{quoted(column)} has no column; name it in --coordinates")
        with blame("--forces"):
            acted = law or _of_the_law(names, unseen, functions)
            driving = _force_columns(forces, acted) if forces else {}
        rates = []
        for option in ("velocity", "acceleration"):
            with blame(f"--{option}"):
                rates.append(dict(pairs(given[option] or (), "NAME=COLUMN, e.g. theta=gyro")))
                _check_are_coordinates(rates[-1], names)
        with blame("--force-delay"):
            delay = 0.0 if given["force_delay"] is None else number(given["force_delay"])
            if delay and not driving:
                raise InputError("there are no forces to shift; name their columns with --forces")
        with blame("--units"):
            units = _units(given.get("units") or "SI")
        files, time, trial = tuple(given["data"]), given["time"], given["trial"]
        inputs = names[len(names) - len(moved) :]
        said = (given.get("time_unit"), units, unseen, functions)
        return cls(files, columns, time, trial, driving, turning, rates[0], rates[1], delay, inputs, *said)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates that have columns."""
        return tuple(self.coordinates)

    @property
    def all_names(self) -> tuple[str, ...]:
        """Names of the coordinates of the law, those without a column last."""
        sensors = measured_columns(self.measure)
        return (*(name for name in self.coordinates if name not in sensors), *self.hidden)

    @property
    def _read(self) -> dict[str, str | None]:
        """Coordinate -> its column; None for those without one on which forces act."""
        return self.coordinates | {name: None for name in self.hidden if name in self.forces}

    def in_order_of(self, names: Sequence[str]) -> DataOptions:
        """Return the same with the columns in another order; some of the names may have none."""
        if {*self.names} - {*names}:
            raise InputError(
                f"--coordinates: the model has {', '.join(names)}, not {', '.join(self.names)}; if the "
                "columns have other names, write name=column"
            )
        ordered = {name: self.coordinates[name] for name in names if name in self.coordinates}
        return replace(self, coordinates=ordered)

    def read(self) -> Trajectories:
        """Read the files, and pass on what was done to the data."""
        from leastaction.io import read

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", DataWarning)
            data = read(
                self.paths,
                self._read,
                self.time,
                self.forces or None,
                self.trial,
                tuple(name for name in self.angles if name not in self.hidden),
                self.velocities or None,
                self.accelerations or None,
                time_unit=self.time_unit,
                units=self.units,
            )
        for item in caught:
            warn(str(item.message))
        if not self.force_delay:
            return data
        from leastaction.delay import shift_forces

        with blame("--force-delay"):
            return shift_forces(data, self.force_delay)


def by_name(text: str) -> dict[str, str]:
    """Return coordinate -> column; a coordinate without ``=column`` has the name of its column."""
    parts = [tuple(side.strip() for side in part.split("=", 1)) for part in text.split(",")]
    names = name_list(",".join(part[0] for part in parts))
    for part in parts:
        if not part[-1]:
            raise InputError(f"the column of {quoted(part[0])} is missing; write name=column")
        if len(part) == 1:
            _check_own_name(part[0])
    return {name: part[-1] for name, part in zip(names, parts, strict=True)}


def _check_own_name(column: str) -> None:
    """Refuse a column whose name no coordinate can have."""
    from leastaction.identifiers import check_coordinate_names

    try:
        check_coordinate_names([column])
    except InputError as error:
        raise InputError(f'{error}; for a column of that name, write "theta1={column}"') from None


def _units(text: str) -> dict[str, str] | str:
    """``SI``, ``as-written``, or coordinate or column -> unit."""
    if "=" not in text:
        if text.casefold() not in ("si", "as-written"):
            raise InputError(f"{quoted(text)} is neither SI nor as-written, nor of the form NAME=UNIT")
        return text
    return dict(pairs(text.split(","), "NAME=UNIT, e.g. theta=deg"))


def _of_the_law(names: Sequence[str], unseen: Sequence[str], functions: Sequence[str]) -> Sequence[str]:
    """Coordinates on which forces may act: with measurement functions, those that columns measure."""
    if not functions:
        return names
    sensors = measured_columns(functions)
    return [*(name for name in names if name not in sensors), *unseen]


def _force_columns(text: str, names: Sequence[str]) -> dict[str, str]:
    given = column_map(text)
    if isinstance(given, dict):
        _check_are_coordinates(given, names)
        return given
    if len(given) > len(names):
        raise InputError(
            f"{len(given)} columns for {len(names)} coordinate(s) ({', '.join(names)}); give at most one each"
        )
    # An empty place is a coordinate that is not driven: ",tau2".
    return {name: column for name, column in zip(names, given, strict=False) if column}


def _check_are_coordinates(given: Iterable[str], names: Sequence[str]) -> None:
    for name in given:
        if name not in names:
            raise InputError(f"{quoted(name)} is not a coordinate; the coordinates are {', '.join(names)}")


_INPUT = click.option(
    "--input",
    metavar="A,B",
    help="Columns of measured inputs without an equation of their own, such as a shaken support or a reeled "
    "rope. Candidates may contain them and their velocities. Same as naming them in --coordinates and "
    "--prescribed.",
)
_HIDDEN = click.option(
    "--hidden",
    metavar="A,B",
    help="Coordinates without a sensor: they occur in the candidates and have no column. Their motion is "
    "estimated, too. Needs a library of few terms (FILE).",
)
_MEASURE = click.option(
    "--measure",
    multiple=True,
    metavar="COLUMN=EXPR",
    help="A column that measures a function of the coordinates, which --hidden names, e.g. "
    "'u={u0}+{s}*sin(theta)'. Numbers in braces are estimated; {s=500} gives a start. Repeatable.",
)
_DATA_PARAMETERS = (
    *("data", "coordinates", "time", "time_unit", "units", "trial", "forces", "force_delay", "angles"),
    *("velocity", "acceleration", "input", "hidden", "measure"),
)


_TABLE = (
    click.argument("data", nargs=-1, required=True, metavar="DATA...", shell_complete=complete_file),
    click.option(
        "--time",
        default="t",
        show_default=True,
        metavar="COLUMN",
        help="Column of the times: seconds, a unit in the name (time_ms, 't [us]'), or dates. Also found "
        "as Time, timestamp, 'Zeit [s]', ...",
    ),
    click.option(
        "--time-unit",
        metavar="UNIT",
        help="Unit of the times, overriding the file: s, ms, us, ns, min or h.",
    ),
    click.option(
        "--units",
        default="SI",
        show_default=True,
        metavar="SI|as-written|A=UNIT",
        help="SI: convert columns with a unit in or below their name (angle [deg]) to rad, m, N, N m. "
        "as-written: keep all numbers. A=deg,B=mm: use these units, overriding the file.",
    ),
    click.option(
        "--trial",
        metavar="COLUMN",
        help="Column with the name of the trial. Default: the column 'trial', if there is one.",
    ),
)
_COLUMNS = (
    click.option(
        "--forces",
        metavar="TAU1,TAU2",
        help="Columns of the known generalised forces, in the order of the coordinates; or a=tau1.",
    ),
    click.option(
        "--force-delay",
        metavar="SECONDS",
        help="Delay of the forces after their time stamps; half a sampling interval if a controller holds "
        "them between samples.",
    ),
    click.option("--angles", metavar="A,B", help="Coordinates that are angles, in radians."),
    click.option(
        "--velocity",
        multiple=True,
        metavar="NAME=COLUMN",
        help="A measured velocity, e.g. theta=gyro (not differences of positions). Repeatable.",
    ),
    click.option(
        "--acceleration",
        multiple=True,
        metavar="NAME=COLUMN",
        help="A measured second derivative of a coordinate. Repeatable.",
    ),
)


def data_options(coordinates_required: bool) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that adds the argument DATA and the options that say what its columns mean.

    The command gets them as one parameter ``data``, a function that checks them: `DataOptions.of`, of which
    only ``default`` and ``law`` may be left to give.
    """
    where = "" if coordinates_required else " Default: those of the model."
    coordinates = click.option(
        "--coordinates",
        required=coordinates_required,
        metavar="A,B",
        help=f"Columns of the coordinates; use name=column if the column has another name.{where}",
    )
    argument, *table = _TABLE
    more = (_INPUT, _HIDDEN, _MEASURE) if coordinates_required else ()
    return _gathered((argument, coordinates, *table, *_COLUMNS, *more))


def table_options() -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator as `data_options` does, without options that say what columns mean."""
    return _gathered(_TABLE)


def _gathered(decorators: Sequence[Callable[..., Any]]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_data(*args: Any, **given: Any) -> Any:
            own = {name: given.pop(name, None) for name in _DATA_PARAMETERS}
            return command(*args, data=partial(DataOptions.of, own), **given)

        for decorator in reversed(decorators):
            with_data = decorator(with_data)
        return with_data

    return decorate
