"""Checks of the parts of a model, and of the states that its methods take."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike

from leastaction.data.coerce import arranged
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.data.validation import real_array
from leastaction.errors import DataError, InputError
from leastaction.estimation.calibration import calibrate
from leastaction.estimation.sensors import SensorFunctions
from leastaction.identifiers import check_coordinate_names, names_in_terms, quoted
from leastaction.kinds import is_list, is_mapping
from leastaction.library import make_term, parse_expression
from leastaction.model.groups import Groups
from leastaction.model.term import FitSummary, ModelTerm, ShapeParameter
from leastaction.simulation.forecast import Sight
from leastaction.simulation.law import Law

if TYPE_CHECKING:
    from leastaction.model.diagnostics import Diagnostics
    from leastaction.model.model import LagrangianModel

_DEGREE = 5  # of the splines through sensor columns
_LONG = 2.0  # horizons: the state of a coordinate without a sensor follows from the motion of others

__all__ = [
    "angles_in",
    "check_force_function",
    "checked_fields",
    "checked_inputs",
    "checked_start",
    "checked_start_std",
    "checked_states",
    "checked_times",
    "columns_of",
    "held_out",
    "prescribed_in",
]


def checked_fields(model: LagrangianModel) -> dict[str, Any]:
    """Return the checked and normalised fields of a new model, and the parsed ``_expressions``.

    Raises
    ------
    InputError
        Naming the field, what was expected and the cure.
    """
    coordinates = check_coordinate_names(model.coordinates)
    terms = _terms(model.terms, "terms")
    dissipation = _terms(model.dissipation, "dissipation")
    if not terms:
        raise InputError("terms is empty; a Lagrangian needs at least one term")
    expressions = (_parsed(terms, "terms", coordinates), _parsed(dissipation, "dissipation", coordinates))
    shapes = _shapes(model.shapes, (*terms, *dissipation), coordinates)
    n_free = sum(not term.known for term in (*terms, *dissipation)) + len(shapes)
    _check_fit(model.fit)
    n_weights = len(model.fit.physics_weight)
    if n_weights not in (0, len(coordinates)):
        raise InputError(
            f"fit: physics_weight has {n_weights} entries; expected one for each of {', '.join(coordinates)}"
        )
    spectrum = model.fit.error_spectrum
    if spectrum and len(spectrum[0]) != 1 + len(coordinates):
        raise InputError(
            f"fit: error_spectrum has rows of {len(spectrum[0])} numbers; expected a frequency and one "
            f"for each of {', '.join(coordinates)}"
        )
    _check_provenance(model.provenance)
    _check_groups(model.groups, n_free)
    return {
        "coordinates": coordinates,
        "terms": terms,
        "dissipation": dissipation,
        "covariance": _covariance(model.covariance, n_free),
        "noise_std": _noise_std(model.noise_std, coordinates),
        "provenance": dict(model.provenance),
        "diagnostics": _with_findings(model.diagnostics, model.fit),
        "shapes": shapes,
        "_expressions": expressions,
    }


def _check_fit(fit: object) -> None:
    if not isinstance(fit, FitSummary):
        raise InputError(f"fit is of type {type(fit).__name__}; expected a FitSummary")


def _check_groups(groups: object, n_free: int) -> None:
    if groups is None:
        return
    if not isinstance(groups, Groups):
        raise InputError(f"groups is {quoted(groups)}; expected Groups or None")
    size = n_free + len(groups.differences)
    if groups.covariance is not None and len(groups.covariance) != size:
        raise InputError(
            f"groups has a covariance of {len(groups.covariance)} rows; expected {size}, one for each free "
            "coefficient and each difference"
        )


def _check_provenance(provenance: object) -> None:
    if not is_mapping(provenance):
        raise InputError(f"provenance is {quoted(provenance)}; expected a dictionary")


def _shapes(
    shapes: Sequence[ShapeParameter], terms: Sequence[ModelTerm], coordinates: Sequence[str]
) -> tuple[ShapeParameter, ...]:
    """The shape parameters, which must be those of the templates."""
    items = tuple(_shape(item, i) for i, item in enumerate(shapes))
    names = names_in_terms(coordinates)
    used = [make_term(term.template, names).shapes for term in terms if term.template]
    lacking = {name for shapes_of in used for name in shapes_of} ^ {item.name for item in items}
    if lacking or len(items) > len({item.name for item in items}):
        raise InputError(
            f"shapes has {', '.join(item.name for item in items) or 'nothing'}; expected every shape "
            "parameter of the templates once, and no other"
        )
    return items


def _shape(item: object, place: int) -> ShapeParameter:
    if not isinstance(item, ShapeParameter):
        raise InputError(f"shapes[{place}] is {quoted(item)}; expected a ShapeParameter")
    return item


def _with_findings(diagnostics: Diagnostics | None, fit: FitSummary) -> Diagnostics | None:
    """The diagnostics with the findings of the fit."""
    if diagnostics is None or diagnostics.findings == fit.findings:
        return diagnostics
    return replace(diagnostics, findings=fit.findings)


def _terms(terms: Iterable[object], label: str) -> tuple[ModelTerm, ...]:
    try:
        items = tuple(terms)
    except TypeError:
        raise InputError(f"{label} is {quoted(terms)}; expected a sequence of ModelTerm") from None
    checked: list[ModelTerm] = []
    for i, term in enumerate(items):
        if not isinstance(term, ModelTerm):
            raise InputError(
                f"{label}[{i}] is {quoted(term)}; expected a ModelTerm, e.g. ModelTerm('x_dot**2', 0.5)"
            )
        checked.append(term)
    return tuple(checked)


def _parsed(terms: Sequence[ModelTerm], label: str, coordinates: Sequence[str]) -> tuple[sp.Expr, ...]:
    names = names_in_terms(coordinates)
    seen: dict[sp.Expr, int] = {}
    for i, term in enumerate(terms):
        try:
            expr = parse_expression(term.expression, names)
        except InputError as error:
            raise InputError(f"{label}[{i}]: {error}") from None
        if expr in seen:
            raise InputError(
                f"{label}[{i}] {quoted(term.expression)} is the same as {label}[{seen[expr]}]; "
                "merge them into one"
            )
        seen[expr] = i
    return tuple(seen)


def _covariance(value: ArrayLike | None, n_free: int) -> np.ndarray | None:
    if value is None:
        return None
    covariance = real_array(value, "covariance")
    if covariance.size == 0 and n_free == 0:
        covariance = np.zeros((0, 0))
    if covariance.shape != (n_free, n_free):
        raise InputError(
            f"covariance has shape {covariance.shape}; expected {(n_free, n_free)}, a row for each "
            "coefficient that is not known and each shape parameter"
        )
    variance = covariance.diagonal()
    if not np.isfinite(covariance).all() or (variance < 0).any():
        raise InputError(
            "covariance must be finite with a diagonal of at least 0; leave it out if there is none"
        )
    scale = np.sqrt(np.outer(variance, variance))
    if (np.abs(covariance - covariance.T) > 1e-6 * scale).any():
        raise InputError("covariance is not symmetric; expected covariance[i, j] == covariance[j, i]")
    covariance.flags.writeable = False
    return covariance


def _noise_std(value: ArrayLike | None, coordinates: Sequence[str]) -> np.ndarray:
    n_dof = len(coordinates)
    noise = np.full(n_dof, np.nan) if value is None else real_array(value, "noise_std")
    if noise.shape != (n_dof,):
        raise InputError(
            f"noise_std has shape {noise.shape}; expected {(n_dof,)}, one number for each of "
            f"{', '.join(coordinates)}"
        )
    noise[~np.isfinite(noise)] = np.nan
    if (noise < 0).any():
        raise InputError(f"noise_std is {quoted(noise.tolist())}; expected numbers of at least 0")
    noise.flags.writeable = False
    return noise


def checked_states(coordinates: Sequence[str], arrays: Mapping[str, ArrayLike | None]) -> list[Any]:
    """Return the arrays as float64 of one shape (..., n_dof), None for one that is not given.

    Raises
    ------
    InputError
        If a last axis does not hold one number per coordinate, or the shapes cannot be broadcast.
    """
    given = {label: real_array(x, label) for label, x in arrays.items() if x is not None}
    n_dof = len(coordinates)
    for label, array in given.items():
        if array.ndim == 0 or array.shape[-1] != n_dof:
            raise InputError(
                f"{label} has shape {array.shape}; expected (..., {n_dof}), the last axis for "
                f"{', '.join(coordinates)}"
            )
    try:
        whole = dict(zip(given, np.broadcast_arrays(*given.values()), strict=True))
        return [whole.get(label) for label in arrays]
    except ValueError:
        shapes = ", ".join(f"{label} {array.shape}" for label, array in given.items())
        raise InputError(f"the shapes cannot be broadcast: {shapes}; make them equal") from None


def checked_times(t: ArrayLike | None, shape: tuple[int, ...]) -> np.ndarray:
    """Return times in seconds that can be broadcast to a shape.

    Raises
    ------
    InputError
        If times are missing, or they cannot be broadcast.
    """
    if t is None:
        raise InputError("the law depends on time: give t, the time of each state in seconds")
    times = real_array(t, "t")
    try:
        return np.broadcast_to(times, shape)
    except ValueError:
        raise InputError(f"t has shape {times.shape}; expected {shape}, a time for each state") from None


def checked_start_std(value: ArrayLike, n_dof: int, law: Law) -> np.ndarray:
    """Standard deviations of q and q̇ at the start of a simulation with standard errors, (2, n_dof)."""
    if law.openness is None:
        raise InputError(
            "with start_std the simulation states its error, but the model lacks a physics weight or the "
            "standard error of a coefficient; leave start_std out, or use a model from a discovery"
        )
    given = real_array(value, "start_std")
    try:
        std = np.broadcast_to(given, (2, n_dof)).copy()
    except ValueError:
        std = np.full((2, n_dof), np.nan)
    if not (np.isfinite(std) & (std >= 0.0)).all():
        raise InputError(
            f"start_std is {quoted(given.tolist())}; expected standard deviations of q0 and qdot0: finite, "
            f"at least 0, of shape (2, {n_dof})"
        )
    return std


def checked_start(coordinates: Sequence[str], value: ArrayLike, label: str) -> np.ndarray:
    """Return one finite number per coordinate, shape (n_dof,)."""
    start = real_array(value, label)
    if start.shape != (len(coordinates),) or not np.isfinite(start).all():
        raise InputError(
            f"{label} is {quoted(value)}; expected {len(coordinates)} finite number(s), for "
            f"{', '.join(coordinates)}"
        )
    return start


def check_force_function(coordinates: Sequence[str], forces: Callable[[float], Any], t: ArrayLike) -> None:
    """Check that ``forces(time)`` has one number per coordinate, at the first of the times."""
    times = np.ravel(real_array(t, "t"))
    shape = np.shape(forces(float(times[0]))) if times.size else (len(coordinates),)
    if shape != (len(coordinates),):
        raise InputError(
            f"forces(time) has shape {shape}; expected {(len(coordinates),)}, one per coordinate"
        )


def checked_inputs(
    coordinates: Sequence[str], prescribed: Sequence[str], inputs: Mapping[str, ArrayLike]
) -> dict[int, ArrayLike]:
    """Return the indices of coordinates whose motion is given; only prescribed ones are allowed."""
    for name in inputs:
        if name not in prescribed:
            listing = ", ".join(prescribed) or "no coordinate"
            raise InputError(
                f"inputs gives the motion of {quoted(name)}; only a coordinate that was prescribed in the "
                f"discovery is allowed, here {listing}"
            )
    return {coordinates.index(name): values for name, values in inputs.items()}


def columns_of(model: LagrangianModel) -> tuple[str, ...]:
    """Names of all columns that a table may have: the coordinates, then the columns of the calibration."""
    return (*model.coordinates, *(() if model.calibration is None else model.calibration.columns))


def held_out(
    model: LagrangianModel, trajectories: Trajectory | Sequence[Trajectory]
) -> tuple[Trajectories, np.ndarray, Sight | None]:
    """Return the channels to forecast, their noise, and how they see the motion.

    The channels are the coordinates of the model, with the angles of its discovery unwrapped, some of them
    (others have no sensor), or columns of its `calibration`.
    """
    data, names, every = Trajectories.coerce(trajectories), model.coordinates, columns_of(model)
    given = {*data.coordinates}
    if not given <= {*every} or (given == {*names} and data.coordinates != names):
        raise InputError(
            f"the trajectories have the coordinates {', '.join(data.coordinates)}; the model has "
            f"{', '.join(every)}; give the same names in the same order"
        )
    angles = angles_in(names, model.provenance)
    seen = [c for i, c in enumerate(data.coordinates) if any(np.isfinite(t.q[:, i]).any() for t in data)]
    if not seen:
        raise InputError(f"the trajectories have no samples of {', '.join(data.coordinates)}")
    if {*seen} == {*names}:
        return data.unwrap(angles) if angles else data, model.noise_std, None
    return _seen_in_part(model, data, seen, angles)


def _seen_in_part(
    model: LagrangianModel, data: Trajectories, seen: Sequence[str], angles: Sequence[str]
) -> tuple[Trajectories, np.ndarray, Sight]:
    """Some coordinates, and columns that are functions of them, with the calibration of the model."""
    names, calibration = model.coordinates, model.calibration
    direct = [name for name in names if name in seen]
    unmeasured = [name for name in model.prescribed if name not in direct]
    if unmeasured:
        raise InputError(f"{quoted(unmeasured[0])} is prescribed and has no samples; measure it")
    data = data.unwrap([name for name in angles if name in direct])
    columns = () if calibration is None else [c for c in calibration.columns if c in seen]
    if calibration is not None and columns:
        numbers = {number.name: number.value for number in calibration.numbers}
        functions = SensorFunctions.parse(calibration.functions, names).fixed(numbers, columns)
        try:
            motion = calibrate(data, functions, angles, _DEGREE, {}).trajectories
        except DataError as error:
            raise InputError(f"no motion explains the columns: {error}") from None
        kept = [k for k, degree in enumerate(functions.degrees) if degree < 2]  # no accelerations
        own = dict(zip(calibration.columns, calibration.noise_std, strict=True))
    else:
        functions, kept, own = None, list[int](), dict[str, float]()
        whole = arranged(data, names)
        motion = Trajectories([t.changed(q=np.where(np.isin(names, direct), t.q, 0.0)) for t in whole])
    places = [names.index(name) for name in direct]
    channels = [*(columns[k] for k in kept), *direct]
    if not channels:
        raise InputError(
            f"{', '.join(columns)} depend on accelerations, which are not forecast; add a column"
        )
    noise = np.array([*(own[name] for name in channels[: len(kept)]), *model.noise_std[places]])
    extent = np.nanstd(np.concatenate([t.q for t in motion]), axis=0)
    extent = np.where(extent > 0.0, extent, extent.max() or 1.0)

    def observe(q: np.ndarray, qdot: np.ndarray, t: np.ndarray) -> np.ndarray:
        if functions is None:
            return q[..., places]
        states = np.stack([q, qdot, np.zeros_like(q)]).reshape(3, -1, len(names))
        found = functions.values(states, t.ravel(), np.zeros(0))[kept].T.reshape(*t.shape, len(kept))
        return np.concatenate([found, q[..., places]], axis=-1)

    table = Trajectories([t.changed(forces=None) for t in arranged(data.without_rates(), channels)])
    sight = Sight(motion, observe, extent, np.isin(names, angles))
    return table, noise, replace(sight, window=_LONG) if functions is None else sight


def angles_in(coordinates: Sequence[str], provenance: Mapping[str, Any]) -> list[str]:
    """Coordinates that were declared angles in the discovery."""
    return _listed(coordinates, provenance, "angles")


def prescribed_in(coordinates: Sequence[str], provenance: Mapping[str, Any]) -> tuple[str, ...]:
    """Coordinates that were prescribed in the discovery; never all of them, even if a file lists all."""
    found = _listed(coordinates, provenance, "prescribed")
    return tuple(found) if len(found) < len(coordinates) else ()


def _listed(coordinates: Sequence[str], provenance: Mapping[str, Any], option: str) -> list[str]:
    """Coordinates that an option of the discovery names; entries of a file are checked."""
    options = provenance.get("options")
    names = options.get(option) if is_mapping(options) else None
    return [c for c in coordinates if c in names] if is_list(names) else []
