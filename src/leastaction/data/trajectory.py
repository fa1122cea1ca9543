"""One trajectory: measured coordinates and rates over time, checked on creation."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from leastaction.data.shown import ShownRuns
from leastaction.data.validation import (
    FloatArray,
    check_forces,
    check_name,
    check_rates,
    check_samples,
    check_times,
    listed,
    real_array,
)
from leastaction.errors import InputError
from leastaction.findings import Finding
from leastaction.identifiers import check_coordinate_names, quoted

__all__ = ["FIELDS", "RATES", "Rate", "Stated", "Trajectory", "common_units"]

RATES = ("velocities", "accelerations")
"""Fields of a trajectory that hold derivatives 1, 2, ... of the coordinates."""

FIELDS = ("t", "q", "forces", *RATES)
"""Fields of a trajectory that hold arrays."""

Stated = tuple[tuple[str, str, str], ...]
"""Units that a file states: quantity (position or force), coordinate, unit of SI."""


@dataclass(frozen=True, eq=False)
class Rate:
    """One measured channel beside the positions: a derivative of one coordinate, over all trajectories.

    Attributes
    ----------
    coordinate : int
        Index of the coordinate.
    derivative : int
        1 velocity, 2 acceleration.
    values : tuple of (n_times,) arrays
        One for each trajectory; NaN if not measured.
    """

    coordinate: int
    derivative: int
    values: tuple[FloatArray, ...]

    def label(self, coordinates: Sequence[str]) -> str:
        """Measured quantity and coordinate, in words.

        Examples
        --------
        >>> Rate(1, 2, ()).label(("x", "theta"))
        'acceleration of theta'
        """
        return f"{self.quantity} of {coordinates[self.coordinate]}"

    @property
    def quantity(self) -> str:
        """Measured quantity: ``"velocity"`` or ``"acceleration"``."""
        return ("velocity", "acceleration")[self.derivative - 1]


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Trajectory(ShownRuns):
    """One continuous recording: coordinates, measured rates and known forces at increasing times.

    The arrays are float64 copies and read-only.

    Parameters
    ----------
    t : array_like, shape (n_times,)
        Times in seconds, finite and strictly increasing. They need not be uniform.
    q : array_like, shape (n_times, n_dof)
        Coordinates. NaN marks a missing sample, per coordinate. Shape (n_times,) is accepted for one
        coordinate.
    forces : array_like, shape (n_times, n_dof), optional
        Known generalised external forces, finite; zero for a coordinate that is not driven. None: no forces.
    coordinates : sequence of str, optional
        Names of the coordinates, kept as a tuple; ``("q1", "q2", ...)`` by default.
    name : str
        Name of the trial, used in messages and files.
    velocities, accelerations : array_like, shape (n_times, n_dof), optional
        Measured q̇ and q̈ (tachometer, gyroscope, ...), in the coordinate's unit per second and per second
        squared; NaN if not measured, which may be whole columns. They must come from separate sensors,
        because differences of the positions repeat the noise of the positions.
    findings : iterable of Finding
        Changes that the reader made to the data, such as converting units. `discover` adds these findings to
        those of the fit.

    Raises
    ------
    InputError
        If a shape, a name, a time or a value is not as described.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 2.0, 201)
    >>> trajectory = Trajectory(t, np.cos(t), coordinates=["theta"], name="first")
    >>> trajectory.n_times, trajectory.n_dof, trajectory.duration
    (201, 1, 2.0)
    >>> Trajectory(t, np.cos(t), coordinates=["theta"], velocities=-np.sin(t))
    <Trajectory '': theta; 201 times, 2 s, velocities>
    """

    t: FloatArray
    q: FloatArray
    forces: FloatArray | None
    coordinates: tuple[str, ...]
    name: str
    velocities: FloatArray | None
    accelerations: FloatArray | None
    findings: tuple[Finding, ...]
    stated_units: Stated = dataclasses.field(default=(), init=False)

    def __init__(
        self,
        t: ArrayLike,
        q: ArrayLike,
        forces: ArrayLike | None = None,
        coordinates: Sequence[str] | None = None,
        name: str = "",
        *,
        velocities: ArrayLike | None = None,
        accelerations: ArrayLike | None = None,
        findings: Iterable[Finding] = (),
    ) -> None:
        name = check_name(name)
        where = f"trajectory {quoted(name)}: " if name else ""
        times = check_times(real_array(t, f"{where}t"), where)
        samples = check_samples(real_array(q, f"{where}q"), times.size, where)
        driving = None
        if forces is not None:
            driving = check_forces(real_array(forces, f"{where}forces"), samples.shape, where)
        n_dof = samples.shape[1]
        names = (
            tuple(f"q{i + 1}" for i in range(n_dof))
            if coordinates is None
            else check_coordinate_names(coordinates)
        )
        if len(names) != n_dof:
            raise InputError(
                f"{where}q has {n_dof} column(s), but there are {len(names)} coordinate(s) "
                f"({', '.join(names)}); give one name for each column"
            )
        fields = {"t": times, "q": samples, "forces": driving}
        for field, given in zip(RATES, (velocities, accelerations), strict=True):
            label = f"{where}{field}"
            fields[field] = (
                None if given is None else check_rates(real_array(given, label), samples.shape, label)
            )
        for field, value in fields.items():
            if value is not None:
                value.flags.writeable = False
            object.__setattr__(self, field, value)
        object.__setattr__(self, "coordinates", names)
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "findings", _checked(findings, where))

    @classmethod
    def of(
        cls,
        arrays: Mapping[str, FloatArray],
        coordinates: tuple[str, ...],
        name: str,
        findings: tuple[Finding, ...] = (),
    ) -> Trajectory:
        """Create a trajectory from read-only arrays that were checked before. They are shared, not copied.

        Examples
        --------
        >>> checked = Trajectory([0.0, 1.0], [0.1, 0.2])
        >>> Trajectory.of({"t": checked.t, "q": checked.q}, checked.coordinates, "again")
        <Trajectory 'again': q1; 2 times, 1 s>
        """
        new = object.__new__(cls)
        for field in FIELDS:
            object.__setattr__(new, field, arrays.get(field))
        object.__setattr__(new, "coordinates", coordinates)
        object.__setattr__(new, "name", name)
        object.__setattr__(new, "findings", findings)
        return new

    @property
    def n_times(self) -> int:
        """Number of times."""
        return int(self.t.size)

    @property
    def n_dof(self) -> int:
        """Number of coordinates."""
        return int(self.q.shape[1])

    @property
    def duration(self) -> float:
        """Last time minus first time, in seconds."""
        return float(self.t[-1] - self.t[0])

    @property
    def n_samples(self) -> int:
        """Number of measured positions: finite entries of `q`, over all coordinates."""
        return int(np.isfinite(self.q).sum())

    @property
    def driven(self) -> bool:
        """Whether any known force is not zero."""
        return self.forces is not None and bool(np.any(self.forces))

    def rates(self, field: str) -> FloatArray | None:
        """``velocities`` or ``accelerations`` if any is measured, otherwise None."""
        values = getattr(self, field)
        return values if values is not None and np.isfinite(values).any() else None

    def changed(self, **fields: Any) -> Trajectory:
        """Return this trajectory with some fields replaced and checked.

        Examples
        --------
        >>> Trajectory([0.0, 1.0], [0.1, 0.2]).changed(name="b").name
        'b'
        """
        names = (*FIELDS, "coordinates", "name", "findings")
        new = Trajectory(**{name: getattr(self, name) for name in names} | fields)
        for name in set(FIELDS) - set(fields):  # read-only: shared, not copied
            object.__setattr__(new, name, getattr(self, name))
        return new.stating(self.stated_units)

    def stating(self, units: Stated) -> Trajectory:
        """Return this trajectory with the units that its file states, which a model keeps for exports.

        Parameters
        ----------
        units : tuple of (str, str, str)
            Quantity, ``"position"`` or ``"force"``, coordinate, and the unit of SI that the numbers have.

        Examples
        --------
        >>> Trajectory([0.0, 1.0], [0.1, 0.2]).stating((("position", "q1", "m"),)).stated_units
        (('position', 'q1', 'm'),)
        """
        new = object.__new__(Trajectory)
        new.__dict__.update(self.__dict__, stated_units=units)
        return new

    def rows(self, chosen: Any) -> Trajectory:
        """Return some of the samples: a slice, an array of increasing indices, or a boolean array.

        Examples
        --------
        >>> Trajectory([0.0, 1.0, 2.0], [0.1, 0.2, 0.3]).rows(slice(1, None)).t.tolist()
        [1.0, 2.0]
        """
        arrays = {name: getattr(self, name) for name in FIELDS}
        return self.changed(**{k: None if array is None else array[chosen] for k, array in arrays.items()})

    def __reduce__(self) -> tuple[Any, ...]:
        # Unpickled arrays are writable; the constructor makes them read-only again.
        given = (
            self.t,
            self.q,
            self.forces,
            self.coordinates,
            self.name,
            self.velocities,
            self.accelerations,
            self.findings,
        )
        return (_restored, given, {"stated_units": self.stated_units})

    def __repr__(self) -> str:
        extras = "".join(
            f", {what}"
            for what, there in (
                ("driven", self.driven),
                *((field, self.rates(field) is not None) for field in RATES),
            )
            if there
        )
        return (
            f"<Trajectory {self.name!r}: {', '.join(self.coordinates)}; "
            f"{self.n_times} times, {self.duration:g} s{extras}>"
        )


def _checked(findings: Iterable[object], where: str) -> tuple[Finding, ...]:
    checked: list[Finding] = []
    for item in findings:
        if not isinstance(item, Finding):
            raise InputError(f"{where}findings hold {quoted(item)}; expected objects of the class Finding")
        checked.append(item)
    return tuple(checked)


def common_units(trajectories: Iterable[Trajectory]) -> dict[str, dict[str, str]]:
    """Units that every file states, by quantity and coordinate.

    Examples
    --------
    >>> silent = Trajectory([0.0, 1.0], [0.1, 0.2])
    >>> measured = silent.stating((("position", "q1", "m"),))
    >>> common_units([measured]), common_units([measured, silent])
    ({'position': {'q1': 'm'}}, {})
    """
    stated = [dict.fromkeys(item.stated_units) for item in trajectories]
    units: dict[str, dict[str, str]] = {}
    for quantity, coordinate, unit in stated[0] if stated else ():
        if all((quantity, coordinate, unit) in others for others in stated):
            units.setdefault(quantity, {})[coordinate] = unit
    return units


def _restored(
    t: FloatArray,
    q: FloatArray,
    forces: FloatArray | None,
    coordinates: tuple[str, ...],
    name: str,
    velocities: FloatArray | None,
    accelerations: FloatArray | None,
    findings: tuple[Finding, ...] = (),
) -> Trajectory:
    rates = {"velocities": velocities, "accelerations": accelerations}
    return Trajectory(t, q, forces, coordinates, name, findings=findings, **rates)


def check_items(trajectories: Iterable[object]) -> tuple[Trajectory, ...]:
    """Return the trajectories, if there is one and all have the same coordinates."""
    cure = "pass a Trajectory or a sequence of them, e.g. [Trajectory(t, q)]"
    try:
        items = tuple(trajectories)
    except TypeError:
        raise InputError(f"{type(trajectories).__name__} is not a sequence of trajectories; {cure}") from None
    if not items:
        raise InputError("there is no trajectory; at least one is needed")
    checked: list[Trajectory] = []
    for position, item in enumerate(items):
        if not isinstance(item, Trajectory):
            raise InputError(f"item {position} is of type {type(item).__name__}, not Trajectory; {cure}")
        checked.append(item)
        if item.coordinates != checked[0].coordinates:
            raise InputError(
                f"trajectory {position} has the coordinates {listed(item.coordinates)}, but trajectory 0 has "
                f"{listed(checked[0].coordinates)}; all must have the same, in the same order"
            )
    return tuple(checked)
