"""MechanicalSystem: a system whose Lagrangian is known, to learn and to test with; draws of its motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike

from leastaction.errors import InputError
from leastaction.library import parse_expression
from leastaction.simulation.integrate import SimulationResult, simulate
from leastaction.simulation.law import compiled_step

Forces = Callable[[np.ndarray], np.ndarray]


def _finite(q: np.ndarray) -> bool:
    return bool(np.isfinite(q).all())


@dataclass(frozen=True, eq=False)
class MechanicalSystem:
    """A mechanical system with a known Lagrangian L(q, q̇) and dissipation function ψ(q, q̇).

    The equations of motion are  d/dt ∂L/∂q̇ − ∂L/∂q = f − ∂ψ/∂q̇ ; they are derived by SymPy when first needed.

    Attributes
    ----------
    name, title : str
    coordinates : tuple of str
    angles : tuple of str
        The coordinates that are angles, in radians.
    lagrangian, dissipation : dict
        Term text -> true coefficient.
    known : dict
        Terms whose coefficient must be given to a discovery (passive systems); ``{}`` for active systems.
    library : tuple of str
        11 to 24 candidate terms including the true ones. None is null or depends on the others.
    initial : callable
        ``initial(rng) -> (q0, qdot0)``, each of shape (n_dof,).
    forcing : callable or None
        ``forcing(rng)`` -> callable of times (m,) -> forces (m, n_dof); ``None`` if the system is passive.
    accept : callable
        ``accept(q)`` with q of shape (n_times, n_dof): whether a motion is accepted. Others are redrawn.
    parameters : dict
        Named physical parameters (SI) from which the coefficients were computed.
    reference : str

    Examples
    --------
    >>> from leastaction import systems
    >>> pendulum = systems.get("single_pendulum")
    >>> pendulum.acceleration([0.5], [0.0]).round(4)
    array([-4.7032])
    """

    name: str
    title: str
    coordinates: tuple[str, ...]
    lagrangian: Mapping[str, float]
    library: tuple[str, ...]
    initial: Callable[[np.random.Generator], tuple[np.ndarray, np.ndarray]]
    angles: tuple[str, ...] = ()
    known: Mapping[str, float] = field(default_factory=dict)
    dissipation: Mapping[str, float] = field(default_factory=dict)
    forcing: Callable[[np.random.Generator], Forces] | None = None
    accept: Callable[[np.ndarray], bool] = _finite
    parameters: Mapping[str, float] = field(default_factory=dict)
    reference: str = ""

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions cannot be pickled; another process derives them again.
        return {k: v for k, v in self.__dict__.items() if k in self.__dataclass_fields__}

    @property
    def n_dof(self) -> int:
        """Number of degrees of freedom."""
        return len(self.coordinates)

    @property
    def velocities(self) -> tuple[str, ...]:
        """Names of the velocities, ``<coordinate>_dot``."""
        return tuple(f"{c}_dot" for c in self.coordinates)

    @property
    def free(self) -> tuple[str, ...]:
        """True terms with unknown coefficients (Lagrangian, then dissipation)."""
        return tuple(k for k in (*self.lagrangian, *self.dissipation) if k not in self.known)

    def with_dissipation(self, dissipation: Mapping[str, float]) -> MechanicalSystem:
        """Return the same system with other dissipation terms, e.g. ``{"x_dot**2/2": 0.2}``."""
        return replace(self, dissipation=dict(dissipation))

    def parse(self, text: str) -> sp.Expr:
        """Return the SymPy expression of a term written in this system's coordinates."""
        return parse_expression(text, (*self.coordinates, *self.velocities))

    @cached_property
    def symbols(self) -> tuple[list[sp.Symbol], list[sp.Symbol]]:
        """Real symbols of the coordinates and of the velocities."""
        return (
            [sp.Symbol(c, real=True) for c in self.coordinates],
            [sp.Symbol(v, real=True) for v in self.velocities],
        )

    @cached_property
    def lagrangian_expression(self) -> sp.Expr:
        """L(q, q̇) with its numbers."""
        return sp.Add(*(sp.Float(c, 17) * self.parse(k) for k, c in self.lagrangian.items()))

    @cached_property
    def dissipation_expression(self) -> sp.Expr:
        """ψ(q, q̇) with its numbers."""
        return sp.Add(*(sp.Float(c, 17) * self.parse(k) for k, c in self.dissipation.items()))

    @cached_property
    def _momentum(self) -> list[sp.Expr]:
        return [sp.diff(self.lagrangian_expression, s) for s in self.symbols[1]]

    @cached_property
    def _equations(self) -> list[sp.Expr]:
        """Upper triangle of the mass matrix, row by row, then the right-hand side."""
        q, v = self.symbols
        lagrangian, momentum, n = self.lagrangian_expression, self._momentum, self.n_dof
        mass = [sp.diff(momentum[i], v[j]) for i in range(n) for j in range(i, n)]
        right = [
            sp.diff(lagrangian, q[i])
            - sp.diff(self.dissipation_expression, v[i])
            - sum(sp.diff(momentum[i], q[j]) * v[j] for j in range(n))
            for i in range(n)
        ]
        return [*mass, *right]

    @cached_property
    def _compiled(self):
        """The equations as a function of arrays q..., q̇...."""
        return sp.lambdify([*self.symbols[0], *self.symbols[1]], self._equations, "numpy", cse=True)

    @cached_property
    def _compiled_energy(self):
        q, v = self.symbols
        energy = sum(p * s for p, s in zip(self._momentum, v, strict=True)) - self.lagrangian_expression
        return sp.lambdify([*q, *v], energy, "numpy", cse=True)

    @cached_property
    def step(self) -> Callable[..., list[float]]:
        """A Runge–Kutta step of one motion, compiled: see `leastaction.simulation.law.compiled_step`."""
        n, entries = self.n_dof, iter(self._equations)
        mass = sp.zeros(n, n)
        for i, j in combinations_with_replacement(range(n), 2):
            mass[i, j] = mass[j, i] = next(entries)
        return compiled_step(mass.tolist(), list(entries), [*self.symbols[0], *self.symbols[1]])

    def mass_and_force(self, q: np.ndarray, qdot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return M, shape (..., n_dof, n_dof), and M q̈ without external forces, shape (..., n_dof)."""
        n = self.n_dof
        values = iter(self._compiled(*(q[..., i] for i in range(n)), *(qdot[..., i] for i in range(n))))
        mass, right = np.empty((*q.shape, n)), np.empty(q.shape)
        for i in range(n):
            for j in range(i, n):
                mass[..., i, j] = mass[..., j, i] = next(values)
        for i in range(n):
            right[..., i] = next(values)
        return mass, right

    def acceleration(self, q: ArrayLike, qdot: ArrayLike, forces: ArrayLike | None = None) -> np.ndarray:
        """Return q̈, the solution of M q̈ = f − ∂ψ/∂q̇ + ∂L/∂q − (∂²L/∂q̇∂q) q̇.

        Parameters
        ----------
        q, qdot : array_like, shape (..., n_dof)
        forces : array_like, shape (..., n_dof), optional

        Raises
        ------
        numpy.linalg.LinAlgError
            If a mass matrix is exactly singular.
        """
        q, qdot = self._states(q, qdot)
        mass, right = self.mass_and_force(q, qdot)
        if forces is not None:
            right = right + np.asarray(forces)
        return np.linalg.solve(mass, right[..., None])[..., 0]

    def mass_matrix(self, q: ArrayLike, qdot: ArrayLike | None = None) -> np.ndarray:
        """Return ∂²L/∂q̇², shape (..., n_dof, n_dof)."""
        return self.mass_and_force(*self._states(q, np.zeros(np.shape(q)) if qdot is None else qdot))[0]

    def energy(self, q: ArrayLike, qdot: ArrayLike) -> np.ndarray:
        """Return q̇·∂L/∂q̇ − L, shape (...): conserved if nothing drives or damps the system."""
        q, qdot = self._states(q, qdot)
        values = self._compiled_energy(*np.moveaxis(q, -1, 0), *np.moveaxis(qdot, -1, 0))
        return np.broadcast_to(values, q.shape[:-1]).copy()

    def simulate(
        self,
        q0: ArrayLike,
        qdot0: ArrayLike,
        t: ArrayLike,
        forces: ArrayLike | Callable[[float], Any] | None = None,
        **options: Any,
    ) -> SimulationResult:
        """Integrate one motion with `leastaction.simulation.integrate.simulate` (DOP853)."""
        options.setdefault("mass_matrix", self.mass_matrix)
        return simulate(self.acceleration, q0, qdot0, t, forces, **options)

    def _states(self, q: ArrayLike, qdot: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        q, qdot = np.asarray(q, dtype=float), np.asarray(qdot, dtype=float)
        if q.shape != qdot.shape:
            q, qdot = np.broadcast_arrays(q, qdot)
        if q.ndim == 0 or q.shape[-1] != self.n_dof:
            raise InputError(
                f"q has shape {q.shape}; the last axis must hold {self.n_dof} coordinates {self.coordinates}"
            )
        return q, qdot


# --------- draws of initial conditions and of known forcing, and acceptance rules, as small picklable objects
@dataclass(frozen=True)
class Uniform:
    """Initial conditions uniform in a box; ``q`` and ``qdot`` hold one (low, high) per coordinate.

    Coordinates in ``mirrored`` (indices) get a rate of random sign, so that a range away from zero
    covers both senses of rotation.
    """

    q: tuple[tuple[float, float], ...]
    qdot: tuple[tuple[float, float], ...]
    mirrored: tuple[int, ...] = ()

    def __call__(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        q0 = rng.uniform(*np.transpose(self.q))
        qdot0 = rng.uniform(*np.transpose(self.qdot))
        for i in self.mirrored:
            qdot0[i] *= rng.choice((-1.0, 1.0))
        return q0, qdot0


@dataclass(frozen=True)
class Within:
    """Takes a motion if every coordinate stays strictly inside its (low, high); ``None`` leaves it free."""

    bounds: tuple[tuple[float, float] | None, ...]

    def __call__(self, q: np.ndarray) -> bool:
        if not np.isfinite(q).all():
            return False
        return all(
            bound is None or (q[:, i].min() > bound[0] and q[:, i].max() < bound[1])
            for i, bound in enumerate(self.bounds)
        )


@dataclass(frozen=True, eq=False)
class Sines:
    """fᵢ(t) = Σⱼ amplitude[j, i] sin(frequency[j, i] t + phase[j, i]); arrays of shape (n_sines, n_dof)."""

    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def __call__(self, t) -> np.ndarray:
        """Return the forces at times of any shape, (..., n_dof)."""
        t = np.asarray(t, dtype=float)[..., None, None]
        return (self.amplitude * np.sin(self.frequency * t + self.phase)).sum(axis=-2)


@dataclass(frozen=True)
class TwoSines:
    """Draws the known forcing of one motion: two sines a coordinate whose amplitudes add up to about `total`.

    Each amplitude is uniform in total·[0.3, 0.7], each frequency uniform in `band` (rad/s), each phase
    uniform on the circle.
    """

    total: tuple[float, ...]
    band: tuple[float, float] = (1.0, 5.0)

    def __call__(self, rng: np.random.Generator) -> Sines:
        shape = (2, len(self.total))
        return Sines(
            amplitude=np.array(self.total) * rng.uniform(0.3, 0.7, shape),
            frequency=rng.uniform(*self.band, shape),
            phase=rng.uniform(0.0, 2.0 * np.pi, shape),
        )
