"""Measured columns as functions of the coordinates, with estimated calibration numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from leastaction.errors import InputError
from leastaction.estimation.sensors import SensorFunctions
from leastaction.model.term import ShapeParameter

__all__ = ["Calibration"]


@dataclass(frozen=True, eq=False)
class Calibration:
    """Dependence of the measured columns on the motion: y = h(q, q̇, q̈; κ) + noise.

    Attributes
    ----------
    coordinates : tuple of str
    functions : tuple of str
        Such as ``"u = {s}*x + {u0}"``, one for each column.
    noise_std : tuple of float
        Estimated standard deviation of the noise of each column.
    numbers : tuple of ShapeParameter
        The calibration numbers κ in the braces, with standard errors.
    covariance : ndarray or None
        Covariance of the model's free coefficients, then of the calibration numbers.

    Raises
    ------
    InputError
        If a function cannot be read, or its numbers are not those in the braces.

    Notes
    -----
    Numbers that the data do not determine have large standard errors, and the model has the finding
    ``calibration-open``.

    Examples
    --------
    >>> camera = Calibration(("x",), ("u = {s}*x + {u0}",), (1.0,),
    ...                      (ShapeParameter("s", 500.0, 0.2), ShapeParameter("u0", 320.0, 0.1)))
    >>> camera.evaluate([[0.0], [0.1]]).tolist()
    [[320.0], [370.0]]
    """

    coordinates: tuple[str, ...]
    functions: tuple[str, ...]
    noise_std: tuple[float, ...]
    numbers: tuple[ShapeParameter, ...] = ()
    covariance: np.ndarray | None = None

    def __post_init__(self) -> None:
        names = tuple(number.name for number in self.numbers)
        if sorted(names) != sorted(self._parsed.names) or len(self.noise_std) != len(self.functions):
            raise InputError(
                f"the calibration has the numbers {', '.join(names) or 'none'} and {len(self.noise_std)} "
                f"noise levels; expected {', '.join(self._parsed.names) or 'none'} and one for each column"
            )

    @cached_property
    def _parsed(self) -> SensorFunctions:
        return SensorFunctions.parse(self.functions, self.coordinates)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the measured columns."""
        return self._parsed.columns

    def evaluate(
        self,
        q: ArrayLike,
        qdot: ArrayLike | None = None,
        qddot: ArrayLike | None = None,
        t: ArrayLike | None = None,
    ) -> np.ndarray:
        """Values of the measured columns, without noise.

        Parameters
        ----------
        q, qdot, qddot : array_like, shape (n_times, n_dof)
            Coordinates and their derivatives, for example from a simulation. Derivatives that no function
            depends on may be omitted.
        t : array_like, shape (n_times,), optional
            Times in seconds; required if a function depends on time.

        Returns
        -------
        ndarray, shape (n_times, n_columns)

        Raises
        ------
        InputError
            If the shapes differ, or a derivative is missing.
        """
        first = np.asarray(q, dtype=float)
        given = [first, *(None if x is None else np.asarray(x, dtype=float) for x in (qdot, qddot))]
        if first.ndim != 2 or any(x is not None and x.shape != first.shape for x in given):
            raise InputError(
                f"q has the shape {first.shape}; expected (n_times, {len(self.coordinates)}), like its rates"
            )
        for nu, name in enumerate(("q", "qdot", "qddot")):
            if given[nu] is None and nu <= max(self._parsed.degrees):
                raise InputError(f"a measurement function depends on {name}; give it")
        states = np.stack([np.zeros_like(first) if x is None else x for x in given])
        values = {number.name: number.value for number in self.numbers}
        times = np.zeros(len(first)) if t is None else np.asarray(t, dtype=float)
        return self._parsed.values(states, times, np.array([values[n] for n in self._parsed.names])).T

    def to_dict(self) -> dict[str, Any]:
        """As an object of ``model.json``."""
        numbers = [
            {
                "name": n.name,
                "value": n.value,
                "standard_error": n.standard_error if n.standard_error == n.standard_error else None,
            }
            for n in self.numbers
        ]
        out: dict[str, Any] = {"functions": [*self.functions], "noise_std": [*self.noise_std]}
        out["numbers"] = numbers
        return out if self.covariance is None else {**out, "covariance": self.covariance.tolist()}

    @classmethod
    def from_dict(cls, value: Any, coordinates: tuple[str, ...]) -> Calibration:
        """From an object of ``model.json``.

        Raises
        ------
        InputError
        """
        try:
            numbers = tuple(
                ShapeParameter(
                    n["name"], n["value"], np.nan if n["standard_error"] is None else n["standard_error"]
                )
                for n in value["numbers"]
            )
            noise = tuple(float(x) for x in value["noise_std"])
            covariance = np.array(value["covariance"], dtype=float) if "covariance" in value else None
            return cls(coordinates, tuple(map(str, value["functions"])), noise, numbers, covariance)
        except (KeyError, TypeError, ValueError) as problem:
            kind = "entry" if isinstance(problem, KeyError) else "problem"
            raise InputError(f"calibration: {kind} {problem}; the file may be cut short") from None
