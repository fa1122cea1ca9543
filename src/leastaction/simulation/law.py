"""A law for simulation, its uncertainty, motions drawn from it, and its compiled step.

A motion obeys M q̈ = r(q, q̇; c) + f + e.  The coefficients c have a covariance, and the equation errors e a
spectral density.  Drawn motions give the error of q even if it is large, where linear error propagation would
grow without bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike
from scipy.fft import next_fast_len
from scipy.interpolate import make_interp_spline
from sympy.printing.pycode import PythonCodePrinter

from leastaction.errors import InputError
from leastaction.mechanics.equations import Mechanics
from leastaction.simulation.integrate import check_times, force_function, rk4
from leastaction.simulation.results import SimulationResult

__all__ = [
    "MEMBERS",
    "Acceleration",
    "CodeMixin",
    "Drawn",
    "Law",
    "Openness",
    "PythonPrinter",
    "Spectrum",
    "compiled_step",
    "follow",
    "spread_of",
    "standard_deviation",
]

Acceleration = Callable[..., np.ndarray]
Step = Callable[..., list[float]]

# Motions drawn for each forecast, and for a simulation: the standard deviation is exact to 12 % and 6 %.
MEMBERS, _MEMBERS_OF_ONE = 32, 128
# Largest share of drawn motions that may diverge; above it, the standard deviation is infinite.
_FEW_LOST = 0.05
# Degree of the spline through an input, whose second derivative is smooth.
_DEGREE = 5
# Tolerance of the steps, relative to the range of the motion; and largest number of steps.
_NEAR, _MOST_STEPS = 1e-3, 20_000


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Spectral density of errors of equations, constant between frequencies.

    ``density[k]``, (n_bands, n_dof), holds from the frequency ``begins[k]`` on, (n_bands,) in Hz, to the
    next, the last without end; it is two-sided: white errors have the variance ``density`` over the time step
    at which they are drawn.
    """

    begins: np.ndarray
    density: np.ndarray

    @classmethod
    def white(cls, density: np.ndarray) -> Spectrum:
        """That of a density for all frequencies, (n_dof,)."""
        return cls(np.zeros(1), density[None])

    def rows(self) -> list[list[float]]:
        """Rows of a frequency and the densities from there."""
        return np.column_stack([self.begins, self.density]).tolist()

    def draw(self, shape: tuple[int, int], steps: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Errors at the ends of steps, (n_steps + 1, *shape, n_dof)."""
        n_dof = self.density.shape[1]
        if len(self.begins) == 1:
            about = np.convolve(steps, [0.5, 0.5])  # of the steps to both sides of their ends
            about[[0, -1]] *= 2.0
            white = rng.standard_normal((steps.size + 1, *shape, n_dof))
            return white * np.sqrt(self.density[0] / about[:, None, None, None])
        # at equal steps over a period that is longer, so that its end knows nothing of its begin
        total = float(steps.sum())
        step = max(float(steps.min()), total / _MOST_STEPS)
        size = next_fast_len(int(np.ceil((total + 1.0 / self.begins[1]) / step)) + 1, real=True)
        frequencies = np.fft.rfftfreq(size, step)
        band = np.searchsorted(self.begins, frequencies, side="right") - 1
        root = np.sqrt(self.density[band] * (0.5 * size / step))
        parts = rng.standard_normal((2, frequencies.size, *shape, n_dof)) * root[:, None, None, :]
        parts[0, 0] *= np.sqrt(2.0)  # a real number
        errors = np.fft.irfft(parts[0] + 1j * parts[1], size, axis=0)
        at = np.concatenate([[0.0], np.cumsum(steps)]) / step
        k = np.minimum(at.astype(int), size - 2)
        share = (at - k)[:, None, None, None]
        return errors[k] + share * (errors[k + 1] - errors[k])


@dataclass(frozen=True, eq=False)
class Openness:
    """A law with uncertain coefficients and equations.

    ``acceleration(q, qdot, forces, t, numbers)`` takes ``numbers`` of shapes that broadcast to (...).
    ``directions``, (n_numbers, n_directions): Σ d dᵀ is the covariance of the ``numbers``, (n_numbers,).
    ``spectrum`` is that of the equation errors.
    """

    acceleration: Callable[..., np.ndarray]
    numbers: np.ndarray
    directions: np.ndarray
    spectrum: Spectrum

    def draw(self, size: int, steps: np.ndarray, n_motions: int, rng: np.random.Generator) -> Drawn:
        """``size`` laws, each with errors for all ``steps``, (n_steps,) in seconds, of ``n_motions``."""
        factors = rng.standard_normal((self.directions.shape[1], size))
        numbers = self.numbers[:, None] + self.directions @ factors
        ends = self.spectrum.draw((size, n_motions), steps, rng)
        errors = np.empty((2 * steps.size + 1, *ends.shape[1:]))
        errors[::2] = ends
        errors[1::2] = 0.5 * (ends[:-1] + ends[1:])
        return Drawn(self, numbers[..., None], errors)


@dataclass(frozen=True, eq=False)
class Drawn:
    """Laws with drawn coefficients, (n_numbers, n_laws, 1), and errors of their equations.

    ``errors``, (2 n_steps + 1, n_laws, n_motions, n_dof), are those at the ends and in the middle of steps.
    """

    openness: Openness
    numbers: np.ndarray
    errors: np.ndarray

    @property
    def size(self) -> int:
        """Number of laws."""
        return self.numbers.shape[1]

    def acceleration(
        self, q: np.ndarray, qdot: np.ndarray, forces: np.ndarray, t: np.ndarray | None = None
    ) -> np.ndarray:
        """q̈ of the motions, (n_laws, n_motions, n_dof), each by its own law."""
        return self.openness.acceleration(q, qdot, forces, t, self.numbers)


def standard_deviation(squares: np.ndarray, lost: np.ndarray, drawn: int) -> np.ndarray:
    """Standard deviation from sums of squares over drawn motions, and the number of diverged ones."""
    with np.errstate(all="ignore"):
        spread = np.sqrt(squares / (drawn - lost))
    return np.where(lost > _FEW_LOST * drawn, np.inf, spread)


@dataclass(frozen=True, eq=False)
class Law:
    """The law of a forecast.

    ``acceleration(q, qdot, forces)`` is vectorised, and NaN if undefined; if the law is ``timed``, it takes
    the time as its last argument.  The force on a ``prescribed`` coordinate is its acceleration.
    """

    acceleration: Acceleration
    prescribed: Sequence[int] = ()
    timed: bool = False
    openness: Openness | None = None
    mechanics: Mechanics | None = None

    @classmethod
    def of(cls, mechanics: Mechanics, openness: Openness | None = None) -> Law:
        """The law of these mechanics."""
        return cls(mechanics.acceleration, mechanics.prescribed, mechanics.timed, openness, mechanics)

    @cached_property
    def step(self) -> Step | None:
        """The `compiled_step` of the mechanics; None above three coordinates, which may need pivoting."""
        law = self.mechanics
        if law is None or law.n_dof > 3:
            return None
        return compiled_step(law.mass, law.right, law.state)


def spread_of(
    law: Law,
    run: SimulationResult,
    qdot0: np.ndarray,
    start_std: np.ndarray,
    forces: Callable[[float], np.ndarray | None],
) -> np.ndarray:
    """Standard deviation (n_times, n_dof) of one motion of a law with an `openness`.

    Parameters
    ----------
    law : Law
    run : SimulationResult
        The motion without errors; steps are halved until they reproduce it.
    qdot0 : ndarray, shape (n_dof,)
    start_std : ndarray, shape (2, n_dof)
        Standard deviations of q and q̇ at ``t[0]``, assumed to be independent.
    forces : callable
        ``forces(time)`` -> (n_dof,), or None.
    """
    assert law.openness is not None
    rng, n_dof, t, motion = np.random.default_rng(0), qdot0.size, run.t, run.q
    off = start_std[:, None, None] * rng.standard_normal((2, _MEMBERS_OF_ONE, 1, n_dof))
    if t.size == 1:
        return np.sqrt((off[:1, :, 0] ** 2).mean(axis=1))
    clock = np.zeros(1) if law.timed else None

    def known(times: np.ndarray) -> np.ndarray:
        rows = [forces(float(time)) for time in times]
        return np.array([np.zeros(n_dof) if row is None else row for row in rows])[:, None, None]

    substeps, near = 1, _NEAR * np.ptp(motion, axis=0)
    begin = motion[0][None, None], qdot0[None, None]
    while True:
        base = rk4(law.acceleration, *begin, t, substeps, known, clock)[0]
        close = np.abs(base[:, 0, 0] - motion) <= near
        if close.all() or 2 * substeps * t.size > _MOST_STEPS:
            break
        substeps *= 2
    drawn = law.openness.draw(_MEMBERS_OF_ONE, np.repeat(np.diff(t) / substeps, substeps), 1, rng)
    starts = begin[0] + off[0], begin[1] + off[1]
    q, _ = rk4(drawn.acceleration, *starts, t, substeps, lambda x: known(x) + drawn.errors, clock)
    away = (q - base)[:, :, 0]
    there = np.isfinite(away)
    squares = (np.where(there, away, 0.0) ** 2).sum(axis=1)
    return standard_deviation(squares, (~there).sum(axis=1), _MEMBERS_OF_ONE)


def follow(
    inputs: Mapping[int, ArrayLike],
    q0: np.ndarray,
    qdot0: np.ndarray,
    t: ArrayLike,
    forces: ArrayLike | Callable[[float], Any] | None,
) -> tuple[np.ndarray, np.ndarray, Callable[[float], np.ndarray]]:
    """Start and forces for which some prescribed coordinates move as given.

    Parameters
    ----------
    inputs : mapping of int to array_like, shape (n_times,)
        Indices of coordinates, and their positions at `t`, interpolated by a spline of degree five.
    q0, qdot0, t, forces
        See `simulate`; the start values of those coordinates are ignored.

    Raises
    ------
    InputError
        If the number of positions differs from that of the times, or not all are finite.

    Examples
    --------
    >>> t = np.linspace(0.0, 1.0, 11)
    >>> q0, qdot0, forces = follow({0: t**2}, np.zeros(2), np.zeros(2), t, None)
    >>> q0, qdot0.round(9), forces(0.5).round(9)
    (array([0., 0.]), array([0., 0.]), array([2., 0.]))
    """
    times, q0, qdot0 = check_times(t), q0.copy(), qdot0.copy()
    others = force_function(forces, times, q0.size)
    curves = {}
    for k, values in inputs.items():
        samples = np.asarray(values, dtype=float)
        if samples.shape != times.shape or not np.isfinite(samples).all():
            raise InputError(
                f"an input has shape {samples.shape}; expected finite numbers of shape {times.shape}, as t"
            )
        curves[k] = make_interp_spline(times, samples, k=min(_DEGREE, times.size - 1))
        q0[k], qdot0[k] = samples[0], float(curves[k](times[0], 1))

    def moved(time: float) -> np.ndarray:
        given = others(time)
        out = np.zeros(q0.size) if given is None else np.array(given)
        for k, curve in curves.items():
            out[k] = curve(time, 2)
        return out

    return q0, qdot0, moved


class CodeMixin:
    """Common part of the printers of Python and C: all digits of the numbers."""

    def _print_Float(self, expr):
        return repr(float(expr))

    def _print_NumberSymbol(self, expr):
        return repr(float(expr))

    _print_Pi = _print_Exp1 = _print_NumberSymbol

    def _print_RealSign(self, expr):
        argument = self._print(expr.args[0])  # type: ignore[attr-defined]
        return f"(({argument} > 0) - ({argument} < 0))"


class PythonPrinter(CodeMixin, PythonCodePrinter):
    """Code of Python for numbers, over `math`."""

    def __init__(self) -> None:
        super().__init__({"fully_qualified_modules": True})  # type: ignore[call-arg]

    def _print_RealAbs(self, expr):
        return f"abs({self._print(expr.args[0])})"

    def _print_Pow(self, expr, rational=False):
        if expr.exp.is_Integer or abs(expr.exp) == sp.S.Half:
            return super()._print_Pow(expr, rational)
        # A negative number to such a power must not give a complex number.
        return f"math.pow({self._print(expr.base)}, {self._print(expr.exp)})"


def compiled_step(
    mass: Sequence[Sequence[sp.Expr]], right: Sequence[sp.Expr], state: Sequence[sp.Symbol]
) -> Step:
    """A step of the classical Runge–Kutta method for M q̈ = r + f, as one function of numbers.

    ``step(h, q..., q̇..., f..., t...)`` returns q..., q̇... after h seconds.  The forces f, and the times t if
    the ``state`` holds one, are those at the beginning, middle and end of the step.  A step takes some
    10 μs; NumPy takes 200 μs for arrays, however few motions they hold.
    """
    n = len(right)
    program, forces, solved = _solution(mass, right)
    lines: list[tuple[sp.Symbol, sp.Expr]] = []

    def let(value: sp.Expr) -> sp.Expr:
        if not value.is_Atom:
            lines.append((sp.Symbol(f"_line{len(lines)}"), value))
            value = lines[-1][0]
        return value

    def rates(at: Sequence[sp.Expr], pushes: Sequence[sp.Symbol], time: Sequence[sp.Symbol]) -> list[sp.Expr]:
        swap = dict(zip([*state, *forces], [*at, *time, *pushes], strict=True))
        for symbol, value in program:
            swap[symbol] = let(value.xreplace(swap))
        return [*at[n:], *(let(value.xreplace(swap)) for value in solved)]

    h, start = sp.Symbol("_h"), [sp.Symbol(f"_start{i}") for i in range(2 * n)]
    pushes = [[sp.Symbol(f"_push{k}_{i}") for i in range(n)] for k in range(3)]
    times = [[sp.Symbol(f"_time{k}") for _ in state[2 * n :]] for k in range(3)]
    slopes = [rates(start, pushes[0], times[0])]
    for share, k in ((h / 2, 1), (h / 2, 1), (h, 2)):
        reached = [let(y + share * slope) for y, slope in zip(start, slopes[-1], strict=True)]
        slopes.append(rates(reached, pushes[k], times[k]))
    ends = [y + h / 6 * (a + 2 * (b + c) + d) for y, a, b, c, d in zip(start, *slopes, strict=True)]
    arguments = [h, *start, *(x for some in (*pushes, *times) for x in some)]
    return sp.lambdify(
        arguments, ends, [{"math": math}], printer=PythonPrinter(), cse=lambda _: (lines, ends)
    )


def _solution(
    mass: Sequence[Sequence[sp.Expr]], right: Sequence[sp.Expr]
) -> tuple[list[tuple[sp.Symbol, sp.Expr]], list[sp.Symbol], list[sp.Expr]]:
    """Lines of a program, the symbols of the forces in it, and the accelerations that it finds."""
    n, forces = len(right), [sp.Symbol(f"_force{i}") for i in range(len(right))]
    values = [*(entry for row in mass for entry in row), *right]
    program, values = sp.cse(values, symbols=sp.numbered_symbols("_shared"))
    names: dict[sp.Expr, sp.Symbol] = {}

    def named(value: sp.Expr) -> sp.Expr:
        if value.is_Atom:
            return value
        if value not in names:
            names[value] = sp.Symbol(f"_entry{len(names)}")
            program.append((names[value], value))
        return names[value]

    rows = [[named(value) for value in values[n * i : n * (i + 1)]] for i in range(n)]
    sides = [named(value + force) for value, force in zip(values[n * n :], forces, strict=True)]
    if n <= 3:  # by Cramer's rule, which takes masses of any sign
        matrix = sp.Matrix(rows)
        below = named(matrix.det())
        tops = [named(top) for top in matrix.adjugate() * sp.Matrix(sides)]
        return program, forces, [top / below if below != 0 else sp.nan for top in tops]
    for k in range(n):
        for i in range(k + 1, n):
            factor = named(rows[i][k] / rows[k][k])
            rows[i] = [named(a - factor * b) for a, b in zip(rows[i], rows[k], strict=True)]
            sides[i] = named(sides[i] - factor * sides[k])
    for k in reversed(range(n)):
        known = sp.Add(*(a * b for a, b in zip(rows[k][k + 1 :], sides[k + 1 :], strict=True)))
        sides[k] = named((sides[k] - known) / rows[k][k])
    return program, forces, sides
