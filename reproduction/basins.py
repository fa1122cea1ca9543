"""Basins of attraction of the damped magnetic pendulum: at which magnet does a mass released at rest end?

All starts are followed at once by the classical Runge–Kutta method with a fixed step. A motion is settled,
for certain, once its energy is below that of every point at which it could cross from one magnet's sector
into another's: damping only takes energy away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import sympy as sp
from sympy.printing.numpy import NumPyPrinter

from reproduction.problem import Answer, Problem

__all__ = ["MAGNETS", "Basins", "Field", "agreement", "damping", "field_of", "lagrangian_of", "map_basins"]

Progress = Callable[[float], None]

# positions (x, y), on the unit circle at 0 and ±120 degrees
MAGNETS = np.array([[1.0, 0.0], [-0.5, np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)]])
UNDECIDED = -1
_AT_ONCE = 8192  # motions in the working set: their arrays stay in the processor's cache
_LOOK = 0.1  # seconds between two looks at the energy
_LONGEST = 60.0  # seconds after which a motion is given up as undecided


@dataclass(frozen=True)
class Field:
    """What a motion in the plane needs: ``acceleration(x, y, vx, vy)`` -> (ax, ay), and its ``energy``."""

    acceleration: Callable[..., tuple[np.ndarray, np.ndarray]]
    energy: Callable[..., np.ndarray]


@dataclass(frozen=True, eq=False)
class Basins:
    """Where motions end.

    Attributes
    ----------
    magnet : (n, n) int array
        Row: y, rising; column: x.  Index into `MAGNETS`, or -1 where the motion did not settle.
    time : (n, n) array
        Seconds until the motion is captured.
    extent : float
        The starts are the centres of n × n square pixels that fill (-extent, extent)².
    step : float
        Of the integration, in seconds.
    """

    magnet: np.ndarray
    time: np.ndarray
    extent: float
    step: float


def damping(problem: Problem, strength: float) -> sp.Expr:
    """Return ψ = ½ · strength · Σ q̇², a friction of the same strength along all coordinates."""
    return sp.Float(strength) / 2 * sp.Add(*(v**2 for v in problem.system.symbols[1]))


def lagrangian_of(problem: Problem, answer: Answer) -> sp.Expr:
    """Return the L that a method found, the known terms included."""
    if answer.coefficients is None:
        raise ValueError(f"{problem.case.method} gave no Lagrangian for {problem.case.system}")
    coefficients = {**problem.known, **answer.coefficients}
    return sp.Add(*(sp.Float(c, 17) * problem.system.parse(term) for term, c in coefficients.items()))


def field_of(lagrangian: sp.Expr, dissipation: sp.Expr, problem: Problem) -> Field:
    """Derive and compile the equations of motion M q̈ = ∂L/∂q − ∂ψ/∂q̇ − (∂²L/∂q̇∂q) q̇ of two coordinates."""
    q, v = problem.system.symbols
    momentum = [sp.diff(lagrangian, s) for s in v]
    mass = sp.Matrix(2, 2, lambda i, j: sp.diff(momentum[i], v[j]))
    right = sp.Matrix(
        [
            sp.diff(lagrangian, q[i])
            - sp.diff(dissipation, v[i])
            - sum(sp.diff(momentum[i], q[j]) * v[j] for j in range(2))
            for i in range(2)
        ]
    )
    solved = mass.adjugate() * right / mass.det()
    energy = sp.expand_mul(sum(p * s for p, s in zip(momentum, v, strict=True)) - lagrangian)
    printer = _Printer({"fully_qualified_modules": False, "inline": True, "allow_unknown_functions": True})
    compiled = (sp.lambdify([*q, *v], e, "numpy", printer=printer, cse=True) for e in (tuple(solved), energy))
    return Field(*compiled)


class _Printer(NumPyPrinter):
    """NumPy code with whole powers as products: NumPy's own are many times slower."""

    def _print_Pow(self, expr, rational=False):
        power = int(expr.exp) if expr.exp.is_Integer else 0
        if not 2 <= abs(power) <= 8:
            return super()._print_Pow(expr, rational)
        product = "*".join([f"({self._print(expr.base)})"] * abs(power))
        return f"({product})" if power > 0 else f"(1.0/({product}))"


def capture_level(field: Field, reach: float = 4.0) -> float:
    """Return the lowest energy at which a mass can stand on a border between two magnets' sectors.

    The sector of a magnet is where it is the nearest one; the borders run from the middle outwards.
    """
    radius = np.linspace(0.0, reach, 4001)
    angle = np.radians([60.0, 180.0, 300.0])[:, None]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return float(np.min(field.energy(x, y, 0.0 * x, 0.0 * y)))


def nearest_magnet(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the index of the magnet next to each point."""
    # All three are at the same distance from the middle: the nearest is the one most in line.
    return np.argmax(MAGNETS @ np.stack([x, y]), axis=0)


def centres(pixels: int, extent: float) -> np.ndarray:
    """Return the coordinates of the pixels' centres along one side."""
    return extent * ((2 * np.arange(pixels) + 1) / pixels - 1)


def map_basins(
    field: Field, pixels: int, extent: float = 2.0, step: float = 0.01, progress: Progress | None = None
) -> Basins:
    """Release a mass at rest in the centre of each of pixels × pixels squares and see where it ends.

    Parameters
    ----------
    field : Field
        With damping.
    pixels : int
    extent : float
        Half the side of the square of starts.
    step : float
        Of the integration, in seconds; 0.1 s must be a whole multiple of it.
    progress : callable, optional
        Called with the share of the motions that have settled.
    """
    side = centres(pixels, extent)
    x0, y0 = (grid.ravel() for grid in np.meshgrid(side, side))
    magnet = np.full(x0.size, UNDECIDED, dtype=np.int8)
    time = np.full(x0.size, np.inf)
    level = capture_level(field)
    states, looks, who = np.empty((4, 0)), np.empty(0, dtype=int), np.empty(0, dtype=int)
    started = 0
    while True:
        # New motions take the places of settled ones, each with its own clock.
        new = np.arange(started, min(started + _AT_ONCE - who.size, x0.size))
        started += new.size
        fresh = np.stack([x0[new], y0[new], 0.0 * x0[new], 0.0 * y0[new]])
        states = np.hstack([states, fresh])
        looks, who = np.append(looks, np.zeros_like(new)), np.append(who, new)
        if not who.size:
            return Basins(magnet.reshape(pixels, -1), time.reshape(pixels, -1), extent, step)
        settled = field.energy(*states) < level
        magnet[who[settled]] = nearest_magnet(*states[:2, settled])
        time[who[settled]] = _LOOK * looks[settled]
        # A state that is not a number never settles.
        going = ~settled & (_LOOK * looks < _LONGEST) & np.isfinite(states).all(axis=0)
        states, looks, who = states[:, going], looks[going] + 1, who[going]
        states = _advance(field, states, step, round(_LOOK / step))
        if progress is not None:
            progress((started - who.size) / x0.size)


def _advance(field: Field, states: np.ndarray, step: float, times: int) -> np.ndarray:
    """Take several steps of the classical Runge–Kutta method of degree 4."""
    x, y, vx, vy = states
    half, sixth = step / 2, step / 6
    with np.errstate(all="ignore"):
        for _ in range(times):
            ax0, ay0 = field.acceleration(x, y, vx, vy)
            vx1, vy1 = vx + half * ax0, vy + half * ay0
            ax1, ay1 = field.acceleration(x + half * vx, y + half * vy, vx1, vy1)
            vx2, vy2 = vx + half * ax1, vy + half * ay1
            ax2, ay2 = field.acceleration(x + half * vx1, y + half * vy1, vx2, vy2)
            vx3, vy3 = vx + step * ax2, vy + step * ay2
            ax3, ay3 = field.acceleration(x + step * vx2, y + step * vy2, vx3, vy3)
            # The stage velocities in terms of the accelerations: fewer operations than the textbook form.
            x = x + step * (vx + sixth * (ax0 + ax1 + ax2))
            y = y + step * (vy + sixth * (ay0 + ay1 + ay2))
            vx = vx + sixth * (ax0 + 2.0 * (ax1 + ax2) + ax3)
            vy = vy + sixth * (ay0 + 2.0 * (ay1 + ay2) + ay3)
    return np.stack([x, y, vx, vy])


def agreement(one: Basins, other: Basins) -> float:
    """Return the fraction of the starts that settle, in both maps, at the same magnet."""
    return float(np.mean((one.magnet == other.magnet) & (one.magnet != UNDECIDED)))
