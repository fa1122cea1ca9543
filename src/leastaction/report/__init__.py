"""Reports, one HTML file each: a law with its checks, or an identified robot arm."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.io import write_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from leastaction.arms.model import ArmModel
    from leastaction.data.trajectories import Trajectories, Trajectory
    from leastaction.model.model import LagrangianModel
    from leastaction.simulation.forecast import ForecastResult

__all__ = ["write_arm_report", "write_report"]


def write_report(
    model: LagrangianModel,
    path: str | os.PathLike[str],
    *,
    validation: ForecastResult | None = None,
    command: str | None = None,
    names: Mapping[str, str] | None = None,
) -> Path:
    """Write a report on a discovered model: one HTML file without scripts or external content.

    It shows L = Σ λ_k φ_k and ψ = Σ c_k ψ_k with their errors, data against the fitted curve and its
    derivatives, the residuals, the selection path, the energy along the motion, forecasts, the data and
    the noise, the candidates that were dropped, and the command that reproduces the result.

    Parameters
    ----------
    model : LagrangianModel
        Result of `discover`, with its diagnostics.
    path : path
        File to write, all or nothing.
    validation : ForecastResult, optional
        Forecasts of held-out trials, from `LagrangianModel.validate`.
    command : str, optional
        Command that reproduces the model, for example the command line.
    names : mapping of str to str, optional
        Coordinate -> its name in sentences and figures, for example ``{"Upper_arm": "Upper arm"}``.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If the model has no diagnostics because it was loaded from a file, an argument is of the wrong
        kind, the forecasts are of other coordinates, or the file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from leastaction import discover, systems
    >>> pendulum = systems.get("single_pendulum")
    >>> data = systems.generate("single_pendulum", noise=0.01, trials=2, duration=6.0, seed=0)
    >>> model = discover(data[:1], pendulum.library)
    >>> with TemporaryDirectory() as folder:
    ...     page = write_report(model, f"{folder}/report.html", validation=model.validate(data[1:]))
    ...     page.read_text(encoding="utf-8")[:15]
    '<!DOCTYPE html>'
    """
    # Imported here, because the import is slow and --help does not need it.
    from leastaction.model.checks import columns_of
    from leastaction.model.model import LagrangianModel
    from leastaction.report.page import render
    from leastaction.simulation.forecast import ForecastResult

    if not isinstance(model, LagrangianModel):
        raise InputError(f"model is {quoted(model)}; expected a LagrangianModel from discover()")
    if model.diagnostics is None:
        raise InputError(
            "the model has no diagnostics: a model file contains neither the fitted curve nor the selection "
            "path; run discover() again on the data and write the report from its result"
        )
    if validation is not None and not isinstance(validation, ForecastResult):
        text = f"validation is {quoted(validation)}; expected the result of model.validate(trajectories)"
        raise InputError(text)
    if validation is not None and not {*validation.coordinates} <= {*columns_of(model)}:
        raise InputError(
            f"validation is for the coordinates {', '.join(validation.coordinates)}, but the model has "
            f"{', '.join(columns_of(model))}; use the result of validate() of this model"
        )
    _check_command(command)
    return write_text(path, render(model, validation, command, names or {}))


def write_arm_report(
    model: ArmModel,
    path: str | os.PathLike[str],
    log: Trajectory | Trajectories | Iterable[Trajectory],
    *,
    held_out: Trajectory | Trajectories | Iterable[Trajectory] | None = None,
    command: str | None = None,
) -> Path:
    """Write a report on an identified robot arm: one HTML file without scripts or external content.

    It shows measured and predicted torques, the spectra of their differences, friction against velocity, the
    arm with the centres of mass of its links, the base parameters with intervals, and how much of each
    parameter comes from the log. Torques are predicted by the physically consistent links of
    ``model.bodies()``.

    Parameters
    ----------
    model : ArmModel
        Result of `leastaction.arms.identify`.
    path : path
        File to write, all or nothing.
    log : Trajectory, Trajectories or iterable of Trajectory
        The log to which the model was fitted.
    held_out : Trajectory, Trajectories or iterable of Trajectory, optional
        A log, or a part of it, that was not fitted.
    command : str, optional
        Command that reproduces the model, for example the command line.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If an argument is of the wrong kind, a log does not fit the arm, or the file cannot be written.
    """
    from leastaction.arms.model import ArmModel
    from leastaction.data.trajectories import Trajectories
    from leastaction.report.arms import render_arm

    if not isinstance(model, ArmModel):
        raise InputError(f"model is {quoted(model)}; expected an ArmModel from arms.identify()")
    _check_command(command)
    rest = None if held_out is None else Trajectories.coerce(held_out)
    return write_text(path, render_arm(model, Trajectories.coerce(log), rest, command))


def _check_command(command: object) -> None:
    if command is not None and not isinstance(command, str):
        raise InputError(f"command is {quoted(command)}; expected text, e.g. the command line")
