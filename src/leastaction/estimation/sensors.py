"""Measured columns that are functions of the coordinates: y = h(q, q̇, q̈; κ) + noise.

Near a curve P and calibration numbers κ, the residual of a sample changes by

    δ(y − h) = −Σ_ν ∂h/∂q^(ν) N^(ν) δP − ∂h/∂κ δκ.

The first part couples the control points near a sample, so that the matrix of the curve stays banded. The
second part adds a column for each number to the border of the coefficients.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from leastaction.curve.bspline import SplineGrid
from leastaction.data.trajectories import Rate
from leastaction.errors import InputError
from leastaction.estimation.elimination import NormalEquations
from leastaction.estimation.observations import RELATIVE_FLOOR, Observations
from leastaction.identifiers import TIME, check_coordinate_names, quoted
from leastaction.library.parser import format_expression, parse_expression, shape_symbol

__all__ = ["SensorFunctions", "SensorObservations", "Sensors"]

_START = re.compile(r"\{\s*(\w+)\s*=\s*([^{}]*)\}")
_CHUNK = 4096  # knot intervals handled at once


@dataclass(frozen=True, eq=False)
class SensorFunctions:
    """Measurement functions h of some columns; make them by :meth:`parse`.

    Attributes
    ----------
    columns : tuple of str
        Names of the measured columns.
    expressions : tuple of sympy.Expr
    coordinates : tuple of str
    names : tuple of str
        Of the calibration numbers, in the sequence in which they occur.
    starts : mapping of str to float
        Values that the user gave, as in ``{s=800}``.
    """

    columns: tuple[str, ...]
    expressions: tuple[sp.Expr, ...]
    coordinates: tuple[str, ...]
    names: tuple[str, ...]
    starts: Mapping[str, float]

    @classmethod
    def parse(cls, texts: Iterable[str], coordinates: Sequence[str]) -> SensorFunctions:
        """Read ``"u = {s}*x + {u0}"``: a column, and an expression of the library's grammar.

        Beside coordinates and velocities it may hold accelerations, ``x_ddot``, and the time.

        Raises
        ------
        InputError
            When a text cannot be read, names a coordinate as the column, or a column twice.
        """
        allowed = [f"{name}{rate}" for rate in ("", "_dot", "_ddot") for name in coordinates]
        columns: list[str] = []
        expressions: list[sp.Expr] = []
        starts: dict[str, float] = {}
        for text in texts:
            column, found, right = str(text).partition("=")
            if not found:
                raise InputError(f"measure holds {text!r}; expected a column and a function, 'u = {{s}}*x'")
            (column,) = check_coordinate_names([column.strip()])
            if column in coordinates:
                raise InputError(
                    f"measure gives a function for {quoted(column)}, which is a coordinate; a column is "
                    "either a coordinate or a function of coordinates"
                )
            if column in columns:
                raise InputError(f"measure gives two functions for {quoted(column)}; leave one out")
            starts |= {name: _number(text, name, value) for name, value in _START.findall(right)}
            try:
                expr = parse_expression(_START.sub(r"{\1}", right.strip()), [*allowed, TIME], shapes=True)
            except InputError as error:
                raise InputError(f"measurement function of {quoted(column)}: {error}") from None
            if not {symbol.name for symbol in expr.free_symbols} & set(allowed):
                raise InputError(f"the measurement function {text!r} holds no coordinate")
            columns.append(column)
            expressions.append(expr)
        symbols = {s.name[1:-1] for e in expressions for s in e.free_symbols if s.name.startswith("{")}
        order = " ".join(map(str, texts))
        names = sorted(symbols, key=lambda name: re.search(rf"\{{\s*{name}\W", order).start())  # type: ignore[union-attr]
        return cls(tuple(columns), tuple(expressions), tuple(coordinates), tuple(names), starts)

    def fixed(self, values: Mapping[str, float], columns: Container[str]) -> SensorFunctions:
        """The functions of some columns, with values of all calibration numbers in place."""
        numbers = {shape_symbol(name): values[name] for name in self.names}
        pairs = zip(self.columns, self.expressions, strict=True)
        kept = {name: expr.subs(numbers) for name, expr in pairs if name in columns}
        return replace(self, columns=(*kept,), expressions=(*kept.values(),), names=(), starts={})

    @cached_property
    def _compiled(self) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """h of every column; and h, its slopes in q, q̇, q̈ and in κ, column after column."""
        rates = ("", "_dot", "_ddot")
        state = [sp.Symbol(f"{q}{rate}", real=True) for rate in rates for q in self.coordinates]
        numbers = [shape_symbol(name) for name in self.names]
        inputs = [*state, sp.Symbol(TIME, real=True), *numbers]
        wanted: list[sp.Expr] = []
        for expr in self.expressions:
            wanted += [expr, *(sp.diff(expr, s) for s in (*state, *numbers))]
        values, slopes = (
            sp.lambdify(inputs, list(w), modules="numpy", cse=True, dummify=True)
            for w in (self.expressions, wanted)
        )
        return values, slopes

    @property
    def texts(self) -> tuple[str, ...]:
        """The functions as text, without start values."""
        pairs = zip(self.columns, self.expressions, strict=True)
        return tuple(f"{column} = {format_expression(expr)}" for column, expr in pairs)

    @property
    def degrees(self) -> tuple[int, ...]:
        """Highest derivative of a coordinate that occurs in each function."""
        rates = {f"{q}{end}": nu for q in self.coordinates for nu, end in enumerate(("", "_dot", "_ddot"))}
        return tuple(max(rates.get(s.name, 0) for s in expr.free_symbols) for expr in self.expressions)

    def values(self, states: np.ndarray, times: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """(n_columns, n_points) values of h; see `evaluate`."""
        return self._evaluated(0, states, times, numbers)

    def _evaluated(
        self, which: int, states: np.ndarray, times: np.ndarray, numbers: np.ndarray
    ) -> np.ndarray:
        inputs = [*states.transpose(0, 2, 1).reshape(-1, times.size), times, *numbers]
        with np.errstate(all="ignore"):
            found: list[np.ndarray | float] = self._compiled[which](*inputs)
        return np.stack([np.broadcast_to(np.asarray(value), times.shape) for value in found])

    def evaluate(
        self, states: np.ndarray, times: np.ndarray, numbers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """h, ∂h/∂(q, q̇, q̈) and ∂h/∂κ at some points.

        Parameters
        ----------
        states : (3, n_points, n_dof) array
        times : (n_points,) array
        numbers : (n_numbers,) or (n_numbers, n_points) array

        Returns
        -------
        tuple of arrays
            (n_columns, n_points), (n_columns, 3, n_dof, n_points), (n_columns, n_numbers, n_points)
        """
        n, points = len(self.coordinates), times.size
        out = self._evaluated(1, states, times, numbers).reshape(len(self.columns), -1, points)
        return out[:, 0], out[:, 1 : 1 + 3 * n].reshape(-1, 3, n, points), out[:, 1 + 3 * n :]


def _number(text: str, name: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"the start value of {{{name}}} in {text!r} is {value!r}; expected a number")
    return number


@dataclass(frozen=True, eq=False)
class Sensors:
    """Measured columns, their functions, and start values of the calibration numbers.

    Attributes
    ----------
    functions : SensorFunctions
    samples : list of (n_times, n_columns) arrays
        Samples of each trajectory; NaN where missing.
    direct : list of (n_times, n_dof) arrays
        Samples of the coordinates themselves, NaN where there are none.
    noise_std, direct_std : (n_columns,) and (n_dof,) arrays
        Noise of the columns and of these samples, by a smooth curve through each; one where there are none.
    numbers : (n_numbers,) array
        κ.
    ranges : mapping of str to (float, float)
        Ranges of some of these, from the user.
    """

    functions: SensorFunctions
    samples: list[np.ndarray]
    direct: list[np.ndarray]
    noise_std: np.ndarray
    direct_std: np.ndarray
    numbers: np.ndarray
    ranges: Mapping[str, tuple[float, float]]

    @property
    def seen(self) -> np.ndarray:
        """(n_dof,) whether a coordinate has samples, or a column that depends on no rate depends on it."""
        pairs = zip(self.functions.expressions, self.functions.degrees, strict=True)
        used = {symbol.name for expr, degree in pairs if not degree for symbol in expr.free_symbols}
        direct = np.isfinite(np.concatenate(self.direct)).any(axis=0)
        return direct | np.isin(self.functions.coordinates, list(used))

    def at(self, numbers: np.ndarray) -> Sensors:
        """The sensors with other calibration numbers."""
        return replace(self, numbers=numbers)

    def static(self) -> Sensors:
        """The sensors without weight for columns that depend on velocities or accelerations."""
        moving = np.array(self.functions.degrees) > 0
        return replace(self, noise_std=np.where(moving, np.inf, self.noise_std))

    def weighted(
        self, trial: int, states: np.ndarray, times: np.ndarray, numbers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """h − y, ∂h/∂q and ∂h/∂κ at the samples of a trial, over the noise; zero where missing.

        Parameters
        ----------
        states : (3, n_times, n_dof) array
            q, q̇ and q̈.

        Returns
        -------
        tuple of arrays
            (n_times, n_columns), (n_times, n_columns, n_dof), (n_times, n_columns, n_numbers)
        """
        h, slopes, own = self.functions.evaluate(states, times, numbers)
        error = np.nan_to_num((h.T - self.samples[trial]) / self.noise_std)
        seen = (np.isfinite(self.samples[trial]) / self.noise_std)[..., None]
        return error, slopes[:, 0].transpose(2, 0, 1) * seen, own.transpose(2, 0, 1) * seen


@dataclass(frozen=True, eq=False)
class _Sight:
    """The samples of one column about a point.

    Attributes
    ----------
    first : (n_samples,) int array
        First control point that each sample depends on.
    rows : (n_samples, degree + 1, n_dof) array
        ∂h/∂P.
    border : (n_samples, 1 + n_numbers) array
        h − y, then ∂h/∂κ.
    """

    first: np.ndarray
    rows: np.ndarray
    border: np.ndarray


class SensorObservations(Observations):
    """Samples of coordinates, and columns that are functions of them; see `Observations`.

    Channels are the positions of the coordinates, rates, and the columns.

    Attributes
    ----------
    calibration : (n_numbers,) array
        Start value of κ; after :meth:`at`, κ at that point.
    directions : (n_numbers, n_directions) array
        Directions in which κ may move; by default all.
    """

    def __init__(
        self, grid: SplineGrid, times: Sequence[np.ndarray], sensors: Sensors, rates: Sequence[Rate] = ()
    ) -> None:
        super().__init__(grid, times, sensors.direct, rates)
        self.functions: SensorFunctions = sensors.functions
        self.calibration: np.ndarray | None = sensors.numbers
        self.directions: np.ndarray = np.eye(len(sensors.functions.names))
        self._times, self._y = np.concatenate(times), np.concatenate(sensors.samples).T
        self._valid = np.isfinite(self._y)
        designs = [grid.design(times, nu) for nu in range(max(self.functions.degrees) + 1)]
        width = grid.degree + 1
        self._first = designs[0].indices[::width]
        self._bases = [design.data.reshape(-1, width) for design in designs]
        self._sights: tuple[_Sight, ...] = ()
        spread = np.array([np.std(y[good]) for y, good in zip(self._y, self._valid, strict=True)])
        self.counts: np.ndarray = np.concatenate([self.counts, self._valid.sum(axis=1)])
        self.floors: np.ndarray = np.concatenate(
            [self.floors, np.where(spread > 0.0, RELATIVE_FLOOR * spread, 1.0)]
        )

    def along(self, directions: np.ndarray) -> SensorObservations:
        """The observations with calibration numbers that move in some directions only."""
        other = copy(self)
        other.directions = directions
        return other

    def at(self, control_points: np.ndarray, calibration: np.ndarray | None = None) -> SensorObservations:
        """The observations, linearised about a curve and calibration numbers."""
        here = copy(self)
        numbers = self.calibration if calibration is None else calibration
        assert numbers is not None
        here.calibration = numbers
        local = control_points[self._first[:, None] + np.arange(self.grid.degree + 1)]
        states = np.zeros((3, self._times.size, self.n_dof))
        for nu, basis in enumerate(self._bases):
            states[nu] = np.einsum("sa,sai->si", basis, local)
        h, slopes, own = self.functions.evaluate(states, self._times, numbers)
        sights: list[_Sight] = []
        for c, good in enumerate(self._valid):
            rows = sum(
                basis[good, :, None] * slopes[c, nu].T[good, None, :] for nu, basis in enumerate(self._bases)
            )
            border = np.column_stack([h[c] - self._y[c], (self.directions.T @ own[c]).T])
            sights.append(_Sight(self._first[good], np.asarray(rows), border[good]))
        here._sights = tuple(sights)
        return here

    @property
    def slopes(self) -> np.ndarray:
        """(n_columns, n_directions) root mean squares of ∂h/∂κ at the point of linearisation."""
        return np.stack([np.sqrt(np.mean(sight.border[:, 1:] ** 2, axis=0)) for sight in self._sights])

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]:
        """y − h of each channel at the point of linearisation, valid samples only."""
        return [*super().residuals(control_points), *(-sight.border[:, 0] for sight in self._sights)]

    def gradient(self, control_points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The gradient of channels that are linear in P, see `Observations`, and the squares of all."""
        gradient, squares = super().gradient(control_points)
        more = [sight.border[:, 0] @ sight.border[:, 0] for sight in self._sights]
        return gradient, np.append(squares, more)

    def add_gram(self, rows: np.ndarray, noise_std: np.ndarray) -> None:
        """Add JᵀJ / σ² of every channel to (n_ctrl, n_dof, …) block rows."""
        super().add_gram(rows, noise_std[: self.coordinates.size])
        n, width = self.n_dof, self.grid.degree + 1
        first, scaled, _ = self._scaled(noise_std)
        for a in range(width):
            for b in range(a, width):
                for i in range(n):
                    for j in range(n):
                        sums = np.bincount(first, scaled[:, a, i] * scaled[:, b, j], self.grid.n_ctrl)
                        rows[a:, i, (b - a) * n + j] += sums[: self.grid.n_ctrl - a]

    def joined(self, normal: NormalEquations, noise_std: np.ndarray) -> NormalEquations:
        """The normal equations with the gradient of the columns, and a border column for each κ."""
        n, width = self.n_dof, self.grid.degree + 1
        first, scaled, values = self._scaled(noise_std)
        border = np.zeros((self.grid.n_ctrl, n, values.shape[1]))
        for a in range(width):
            for i in range(n):
                for k in range(values.shape[1]):
                    sums = np.bincount(first, scaled[:, a, i] * values[:, k], self.grid.n_ctrl)
                    border[a:, i, k] += sums[: self.grid.n_ctrl - a]
        border = border.reshape(-1, values.shape[1])
        moments, size = values.T @ values, normal.gradient.size
        corner = np.zeros((size + len(moments) - 1,) * 2)
        corner[:size, :size], corner[size:, size:] = normal.corner, moments[1:, 1:]
        wide = np.column_stack([normal.border, border[:, 1:]])
        wide[:, 0] += border[:, 0]
        return NormalEquations(normal.rows, wide, np.append(normal.gradient, moments[1:, 0]), corner)

    def traces(self, inverse_rows: np.ndarray, noise_std: np.ndarray) -> np.ndarray:
        """(n_channels,) degrees of freedom that each channel uses."""
        n, begin = self.n_dof, self.coordinates.size
        out = [*super().traces(inverse_rows, noise_std[:begin]), *(0.0 for _ in self._sights)]
        for chunk in self.grid.chunks(_CHUNK):
            local = self.grid.local_gram(inverse_rows, chunk)
            for a in range(0, local.shape[1], n):  # each pair of different control points counts twice
                local[:, a : a + n, a + n :] *= 2.0
            for c, sight in enumerate(self._sights):
                interval = np.searchsorted(self.grid.first, sight.first) - chunk.start
                own = (interval >= 0) & (interval < len(local))
                rows = sight.rows[own].reshape(np.count_nonzero(own), -1)
                out[begin + c] += np.einsum("sk,skl,sl->", rows, local[interval[own]], rows, optimize=True)
        out[begin:] /= noise_std[begin:] ** 2
        return np.array(out)

    def _scaled(self, noise_std: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """First control points, ∂h/∂P, and [h − y, ∂h/∂κ] of all samples, over their noise."""
        pairs = list(zip(self._sights, noise_std[self.coordinates.size :], strict=True))
        return (
            np.concatenate([sight.first for sight, _ in pairs]),
            np.concatenate([sight.rows / sigma for sight, sigma in pairs]),
            np.concatenate([sight.border / sigma for sight, sigma in pairs]),
        )
