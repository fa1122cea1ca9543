"""``leastaction arm``: from a torque log and a kinematic tree to an identified arm."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from leastaction.cli.discover import command_line
from leastaction.cli.options import DataOptions, data_options
from leastaction.cli.output import check_folder, write_together
from leastaction.cli.show import live_progress, say
from leastaction.cli.text import complete_file, complete_folder, one_line, shown
from leastaction.cli.values import assignments, blame, expression_list, name_list
from leastaction.errors import InputError
from leastaction.identifiers import TIME, quoted

if TYPE_CHECKING:
    from pathlib import Path

    from leastaction import Trajectories
    from leastaction.arms import ArmModel, KinematicTree

__all__ = ["arm", "arm_files"]

_DH_NUMBERS = ("a", "d", "alpha", "theta")
_DH_TEXTS = ("kind", "name", "link")


@click.command(
    short_help="Identify a robot arm from a torque log and its URDF.",
    epilog="""\b
Example:
  leastaction arm log.csv --urdf robot.urdf --forces tau1,tau2,tau3 --hold-out 20% --output found
""",
)
@data_options(coordinates_required=False)
@click.option("--urdf", metavar="FILE", shell_complete=complete_file, help="URDF of the arm.")
@click.option("--mjcf", metavar="FILE", shell_complete=complete_file, help="MuJoCo model instead.")
@click.option(
    "--dh",
    metavar="FILE",
    shell_complete=complete_file,
    help="Denavit-Hartenberg table instead: a CSV file with a row for each joint and the columns a, d, alpha "
    "and, if wanted, theta, kind (revolute or prismatic), name and link; in m and rad.",
)
@click.option(
    "--convention",
    type=click.Choice(["modified", "standard"]),
    help="Convention of the --dh table: modified (Craig) or standard.",
)
@click.option(
    "--joints", metavar="A,B", help="Joints of the file that move; the others stay where it places them."
)
@click.option(
    "--gravity",
    type=float,
    nargs=3,
    metavar="X Y Z",
    help="Gravity vector in the world frame, in m/s² (default: that of the MuJoCo model, or 0 0 -9.81).",
)
@click.option(
    "--base-rpy",
    type=float,
    nargs=3,
    default=(0.0, 0.0, 0.0),
    metavar="R P Y",
    help="Roll, pitch and yaw of the base in the world, in rad: how the arm is mounted (default: 0 0 0).",
)
@click.option(
    "--term",
    "terms",
    multiple=True,
    metavar="EXPR",
    help="Candidate of L beside the links, in the names of the joints: a coupling of two motors "
    "(q5_dot*q6_dot), a spring that compensates gravity (cos(2*q2)). Repeatable.",
)
@click.option(
    "--dissipation",
    metavar="EXPR,...",
    help="Candidates of the dissipation function beside the friction of single joints, such as that of "
    "coupled motors: '(q5_dot+q6_dot)**2/2, abs(q5_dot+q6_dot)'.",
)
@click.option(
    "--gains",
    metavar="A=X,B=Y",
    help="The columns of torques are motor currents. Torque per ampere of the joints for which it is known, "
    "at least one; the others are estimated.",
)
@click.option(
    "--unmeasured",
    metavar="A,B",
    help="Joints whose torque is not in the log; their motion is used, their friction remains unknown.",
)
@click.option(
    "--hold-out",
    metavar="N|P%|NAMES",
    help="Trials to predict instead of fitting: the last N; the last 20% (of a single trial, its end); "
    "or by name.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Processes that share the work; a further one takes a second to start (default: 1).",
)
@click.option(
    "--output",
    required=True,
    metavar="DIR",
    shell_complete=complete_folder,
    help="Directory for arm.json, report.html, inverse_dynamics.py, and arm.urdf or arm.xml.",
)
@click.pass_context
def arm(
    ctx: click.Context,
    data: Callable[..., DataOptions],
    terms: tuple[str, ...],
    dissipation: str | None,
    gains: str | None,
    unmeasured: str | None,
    hold_out: str | None,
    output: str,
    workers: int | None,
    urdf: str | None,
    mjcf: str | None,
    **geometry: Any,
) -> None:
    """Identify the inertial parameters and the friction of a robot arm.

    DATA are logs of joint angles and torques: tables, or bags of ROS 2. Columns that --coordinates and
    --forces do not name are recognised by the names that ROS, libfranka and the RTDE of Universal Robots
    give them, or by names such as q1 and tau1, and listed. Prints the combinations of parameters that the log
    determines, with standard errors, and writes the arm: arm.json, a report with figures, Python code of its
    inverse dynamics, and with --urdf a copy with the inertias found, or with --mjcf a MuJoCo model. The links
    that are written are physically consistent, as close to the data as possible. Give logged velocities with
    --velocity NAME=COLUMN: they show the clock of the robot where the stamps of the log scatter.
    """
    from leastaction import arms, write_arm_report

    robots = (*(("arm.urdf",) if urdf else ()), *(("arm.xml",) if mjcf else ()))
    folder = check_folder(output, ("arm.json", "report.html", "inverse_dynamics.py", *robots))
    tree = _with_terms(_tree(urdf, mjcf, **geometry), terms, dissipation)
    log = _recognised(data(default=tree.coordinates), tree, currents=gains is not None).read()
    fitted, rest = _split(log, hold_out)
    with blame("--unmeasured"):
        without = [] if unmeasured is None else name_list(unmeasured)
    recording = arms.Recording(None if gains is None else _gains(gains), unmeasured=without)
    with live_progress("verify"):
        found = arms.identify(fitted, tree, recording=recording, workers=workers)
        solid = found.bodies()
        errors = None if rest is None else solid.validate(rest)
    report = partial(write_arm_report, found, log=fitted, held_out=rest, command=command_line(ctx))
    writers = {"report.html": report, **arm_files(solid, urdf=urdf, mjcf=mjcf is not None)}
    write_together(folder, writers)
    say(str(found))
    for note in solid.facts.notes[len(found.facts.notes) :]:
        say(f"note: {one_line(note)}")
    if errors is not None:
        say(f"\nheld out, with physically consistent bodies:\n{errors}")
    say("\n" + "\n".join(shown(folder / name) for name in writers))


def arm_files(
    solid: ArmModel, *, urdf: str | None = None, mjcf: bool = False
) -> dict[str, Callable[[Path], object]]:
    """Name -> function that writes an arm whose links can exist: JSON, Python code, and for other programs.

    `urdf` is the file whose inertias are replaced.
    """
    out: dict[str, Callable[[Path], object]] = {"arm.json": solid.save}
    if not any(term.kind == "load" for term in solid.terms):
        out["inverse_dynamics.py"] = solid.to_python
    if urdf is not None:
        out["arm.urdf"] = partial(solid.to_urdf, urdf)
    if mjcf:
        out["arm.xml"] = solid.to_mjcf
    return out


def _recognised(options: DataOptions, tree: KinematicTree, *, currents: bool) -> DataOptions:
    """The columns of torques, and others that were not named, by the names that common loggers give them."""
    from leastaction import arms

    if options.forces:
        return options
    try:
        found = arms.log_columns(options.paths, tree)
    except InputError as error:
        raise InputError(f"--forces is missing, and {error}") from None
    if not found.torques:
        raise InputError("--forces is missing; name the columns of joint torques, e.g. --forces tau1,tau2")
    if found.currents and not currents:
        raise InputError(
            f"{', '.join(found.torques.values())} seem to be motor currents; give the torque per ampere of "
            f"at least one joint, e.g. --gains {tree.coordinates[0]}=10.5, or name torques with --forces"
        )
    say(f"columns: {one_line(str(found))}")
    named = options.coordinates != {name: name for name in tree.coordinates}
    return replace(
        options,
        coordinates=options.coordinates if named else found.positions,
        forces=found.torques,
        velocities=options.velocities or found.velocities,
        time=found.time if options.time == TIME else options.time,
        time_unit=options.time_unit or found.time_unit,
    )


def _tree(
    urdf: str | None,
    mjcf: str | None,
    dh: str | None,
    convention: str | None,
    joints: str | None,
    gravity: tuple[float, float, float] | None,
    base_rpy: tuple[float, float, float],
) -> KinematicTree:
    from leastaction import arms

    if [urdf, mjcf, dh].count(None) != 2:
        raise InputError("give the arm's geometry with one of --urdf, --mjcf and --dh")
    with blame("--joints"):
        chosen = None if joints is None else name_list(joints)
    if mjcf is not None:
        return arms.read_mjcf(mjcf, joints=chosen, gravity=gravity, base_rpy=base_rpy)
    down = gravity or (0.0, 0.0, -9.81)
    if urdf is not None:
        return arms.read_urdf(urdf, joints=chosen, gravity=down, base_rpy=base_rpy)
    if convention is None:
        raise InputError(
            "--convention is missing; say whether the table of --dh is modified (Craig) or standard"
        )
    assert dh is not None
    craig = convention == "modified"
    return arms.KinematicTree.from_dh(_table(dh), modified=craig, gravity=down, base_rpy=base_rpy)


def _with_terms(tree: KinematicTree, terms: Sequence[str], dissipation: str | None) -> KinematicTree:
    """The tree with further candidates."""
    with blame("--term"):
        tree = tree.with_terms(terms)
    with blame("--dissipation"):
        return tree if dissipation is None else tree.with_terms(dissipation=expression_list(dissipation))


def _table(path: str) -> list[dict[str, Any]]:
    """The rows of a Denavit-Hartenberg table."""
    from leastaction.data.formats.atomic import check_path, read_bytes

    try:
        lines = read_bytes(check_path(path)).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{shown(path)} is not text in UTF-8; give a CSV file") from None
    out: list[dict[str, Any]] = []
    for number, row in enumerate(csv.DictReader(lines), 2):
        given = {str(key).strip(): str(value or "").strip() for key, value in row.items()}
        for key in given:
            if key not in (*_DH_NUMBERS, *_DH_TEXTS):
                known = ", ".join((*_DH_NUMBERS, *_DH_TEXTS))
                raise InputError(f"{shown(path)} has the column {quoted(key)}; expected {known}")
        one: dict[str, Any] = {key: given[key] for key in _DH_TEXTS if given.get(key)}
        for key in _DH_NUMBERS:
            if given.get(key):
                try:
                    one[key] = float(given[key])
                except ValueError:
                    one[key] = math.nan
                if not math.isfinite(one[key]):
                    raise InputError(
                        f"{shown(path)}, line {number}: {key} is {quoted(given[key])}; expected a number"
                    )
        out.append(one)
    return out


def _gains(text: str) -> dict[str, float]:
    """Torque per ampere of each joint that is named."""
    try:
        return assignments(text)
    except InputError as error:
        raise InputError(f"--gains: {error}; expected JOINT=NUMBER, e.g. q1=10.5") from None


def _split(log: Trajectories, hold_out: str | None) -> tuple[Trajectories, Trajectories | None]:
    if hold_out is None:
        return log, None
    try:
        return log.hold_out(hold_out)
    except InputError as error:
        raise InputError(f"--hold-out: {error}") from None
