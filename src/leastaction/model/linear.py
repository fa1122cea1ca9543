r"""Equilibria of a law, and its small motions about one: natural frequencies, damping ratios, mode shapes.

At an equilibrium r(q) + f = 0, where M q̈ = r(q, q̇) + f are the equations of motion and q̇ = 0. Small
deviations δ from it obey

.. math:: M \ddot δ + C \dot δ + K δ = δf, \qquad C = −∂r/∂\dot q, \quad K = −∂r/∂q

(Meirovitch, Fundamentals of Vibrations, 2001, ch. 7). M, C and K scale with L. In a linear law without known
forces, the scale of each mode is arbitrary. Frequencies, damping ratios and shapes do not depend on it.

Standard errors are those of the delta method with the covariance of coefficients and shape parameters; the
equilibrium moves with them. M, C, K and the equilibrium are differentiated along the principal directions of
the covariance, poles and shapes by the perturbation theory of eigenvalues.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh

from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.model.checks import checked_start
from leastaction.model.modes import ZERO, Matrices, Mode, find_modes, state_matrix
from leastaction.model.notation import rounded
from leastaction.model.rest import RestLaw, checked_forces, find_rests, periodic

if TYPE_CHECKING:
    from leastaction.model.model import LagrangianModel

__all__ = ["Equilibrium", "Linearisation", "Resting"]

Stability = Literal["stable", "neutral", "unstable", "undecided"]

_ORDER: tuple[Stability, ...] = ("stable", "neutral", "undecided", "unstable")
_NEAR = 1e-3  # largest distance between a given state and its equilibrium: allows for rounding


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A state in which a system can rest.

    Attributes
    ----------
    q : ndarray, shape (n_dof,)
    standard_error : ndarray, shape (n_dof,)
        NaN for a coordinate along which the equilibrium can be shifted, or if not available.
    stability : {"stable", "neutral", "unstable", "undecided"}
        From the poles of the linear system, or a minimum of the potential. Neutral: stable except for shifts
        that no force opposes. Undecided: neglected terms decide, or the mass matrix is singular.
    isolated : bool
        Whether it has no adjacent equilibria. A line or surface of equilibria is represented by one of them.
    recorded : bool or None
        Whether the recording reached it in each coordinate, angles modulo 2π. None: unknown.
    """

    q: np.ndarray
    standard_error: np.ndarray
    stability: Stability
    isolated: bool
    recorded: bool | None

    @property
    def standing(self) -> str:
        """Stability, and whether the recording reached it, as text."""
        return f"{self.stability}{', beyond the recording' if self.recorded is False else ''}"

    def place(self, names: Sequence[str]) -> str:
        """Coordinates as text."""
        pairs = zip(names, self.q.tolist(), self.standard_error.tolist(), strict=True)
        return ", ".join(f"{name} = {rounded(q, error, uncertainty=True)}" for name, q, error in pairs)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The linear system of small deviations δ from an equilibrium, M δ̈ + C δ̇ + K δ = δf.

    Attributes
    ----------
    coordinates : tuple of str
        The free coordinates. Those prescribed in the discovery are held fixed.
    q, standard_error : ndarray, shape (n_dof,)
        The equilibrium, and its standard errors.
    forces : ndarray, shape (n_dof,)
        Constant forces that act there.
    mass, damping, stiffness : ndarray, shape (n_free, n_free)
        M, C (damping is its symmetric part, gyroscopic the other) and K.
    poles : ndarray, shape (2 n_free,), complex
        Eigenvalues of `a` in 1/s, by increasing magnitude.
    modes : tuple of Mode
        By increasing natural frequency.
    stability : {"stable", "neutral", "unstable", "undecided"}
        As of `Equilibrium`.
    left_out : tuple of str
        Terms of dry friction, which has no derivative at rest. With it, the system may also rest next to the
        equilibrium, and oscillations die out in finite time.

    Examples
    --------
    >>> from leastaction import LagrangianModel
    >>> from leastaction.model.term import ModelTerm
    >>> pendulum = LagrangianModel("theta", [ModelTerm("theta_dot**2", 0.5),
    ...                                      ModelTerm("cos(theta)", 9.81, 0.04)])
    >>> system = pendulum.linearise([0.0])
    >>> print(system.modes[0].natural_frequency, system.stability)
    3.1321(64) stable
    """

    coordinates: tuple[str, ...]
    q: np.ndarray
    standard_error: np.ndarray
    forces: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    poles: np.ndarray
    modes: tuple[Mode, ...]
    stability: Stability
    left_out: tuple[str, ...] = ()

    @property
    def a(self) -> np.ndarray:
        """(2 n_free, 2 n_free) of ẋ = A x + B δf with x = (δ, δ̇)."""
        return state_matrix(self.mass, self.damping, self.stiffness)

    @property
    def b(self) -> np.ndarray:
        """(2 n_free, n_free) of ẋ = A x + B δf."""
        return np.concatenate([np.zeros_like(self.mass), np.linalg.inv(self.mass)])


class Resting:
    """Equilibria of a model and small motions about them."""

    @cached_property
    def _law(self) -> RestLaw:
        return RestLaw(cast("LagrangianModel", self))

    def equilibria(
        self,
        within: Mapping[str, tuple[float, float]] | None = None,
        *,
        forces: ArrayLike | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> tuple[Equilibrium, ...]:
        """States in which the system can rest: r(q) + f = 0, solved from many starts.

        For a smooth law in few coordinates, many starts usually find all equilibria. This is not guaranteed.
        Dry friction is left out; with it, the system may also rest next to an equilibrium.

        Parameters
        ----------
        within : mapping of str to (float, float), optional
            Range of the search, by coordinate. By default a full turn if the law is periodic in the
            coordinate, otherwise the range of the recording.
        forces : array_like, shape (n_dof,), optional
            Constant forces; none by default.
        inputs : mapping of str to float, optional
            Positions of all `prescribed` coordinates.

        Returns
        -------
        tuple of Equilibrium
            Angles in (−π, π].

        Raises
        ------
        InputError
            If a range is missing or wrong, or the law is `timed`.

        Examples
        --------
        >>> from leastaction import LagrangianModel
        >>> from leastaction.model.term import ModelTerm
        >>> terms = [ModelTerm("theta_dot**2", 0.5), ModelTerm("cos(theta)", 9.81)]
        >>> pendulum = LagrangianModel("theta", terms)
        >>> [(rest.q.round(6).tolist(), rest.stability) for rest in pendulum.equilibria()]
        [([0.0], 'stable'), ([3.141593], 'unstable')]
        """
        model, law = cast("LagrangianModel", self), self._law
        push, ranges = checked_forces(law, forces), _ranges(model)
        found = find_rests(law, within or {}, push, inputs or {}, ranges)
        return tuple(_equilibrium(law, q, push, ranges)[0] for q in found)

    @cached_property
    def small_motions(self) -> tuple[tuple[Equilibrium, Linearisation | None], ...]:
        """Every equilibrium with the linear system about it, stable ones first.

        They are the `equilibria` found without arguments, with `prescribed` coordinates held at the middle of
        the recording. The linear system is None if the mass matrix is singular. The result is empty if the
        law is `timed`, or if the range of a coordinate is unknown.
        """
        model = cast("LagrangianModel", self)
        ranges = _ranges(model)
        if model.timed or (ranges is None and model.prescribed):
            return ()
        law, push = self._law, np.zeros(model.n_dof)
        held = (
            {} if ranges is None else dict(zip(model.coordinates, ranges.mean(axis=1).tolist(), strict=True))
        )
        inputs = {name: held[name] for name in model.prescribed}
        try:
            found = find_rests(law, {}, push, inputs, ranges)
        except InputError:  # no recording, and a coordinate that is not an angle
            return ()
        pairs = [_equilibrium(law, q, push, ranges) for q in found]
        return tuple(sorted(pairs, key=lambda pair: _ORDER.index(pair[0].stability)))

    def linearise(self, q: ArrayLike, forces: ArrayLike | None = None) -> Linearisation:
        """Small motions about an equilibrium: frequencies, damping ratios and mode shapes with their errors.

        Parameters
        ----------
        q : array_like, shape (n_dof,)
            The equilibrium to within about 0.001; it is refined. `prescribed` coordinates are held.
        forces : array_like, shape (n_dof,), optional
            Constant forces that act there; none by default.

        Returns
        -------
        Linearisation

        Raises
        ------
        InputError
            If there is no equilibrium, the equations have no derivative there, or the law is `timed`.

        Examples
        --------
        >>> from leastaction import LagrangianModel
        >>> from leastaction.model.term import ModelTerm
        >>> terms = [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0, 0.01)]
        >>> (mode,) = LagrangianModel("x", terms, [ModelTerm("x_dot**2/2", 0.4)]).linearise([0.0]).modes
        >>> print(mode.natural_frequency, mode.damping_ratio)  # rad/s
        2.0000(50) 0.10000(25)
        """
        return linearise(self._law, q, forces)


def _ranges(model: LagrangianModel) -> np.ndarray | None:
    """(n_dof, 2) of the recorded positions, or of the estimated motion of a hidden coordinate."""
    if model.diagnostics is None:
        return None
    spans = np.array([[np.nanmin(q, 0), np.nanmax(q, 0)] for q in model.diagnostics.positions])
    return np.stack([spans[:, 0].min(axis=0), spans[:, 1].max(axis=0)], axis=1)


def _equilibrium(
    law: RestLaw, q: np.ndarray, forces: np.ndarray, ranges: np.ndarray | None
) -> tuple[Equilibrium, Linearisation | None]:
    recorded = None
    if ranges is not None:
        low, high = ranges.T
        seen = q + 2.0 * np.pi * np.ceil((low - q) / (2.0 * np.pi)) * periodic(law)
        recorded = bool(np.all(((seen >= low) & (seen <= high))[law.free]))
    try:
        system = _about(law, q, forces)
    except InputError:  # a singular mass matrix
        return Equilibrium(q, np.full(len(q), np.nan), "undecided", False, recorded), None
    isolated = not _open_directions(system.stiffness).any()
    return Equilibrium(q, system.standard_error, system.stability, isolated, recorded), system


def linearise(law: RestLaw, q: ArrayLike, forces: ArrayLike | None = None) -> Linearisation:
    """The linear system about the equilibrium at a state; see `LagrangianModel.linearise`."""
    given, push = checked_start(law.names, q, "q"), checked_forces(law, forces)
    law.check_smooth(given)
    found = law.settled(given, push)
    if not np.all(np.abs(found - given) <= _NEAR * (1.0 + np.abs(given))):
        lacking = 0.0 - law.right(given)
        hint = ""
        if np.isfinite(lacking).all():
            held = np.zeros(len(given))
            held[law.free] = lacking
            hint = f", or hold it there by forces = {[float(f'{x:.4g}') for x in held]}"
        raise InputError(f"q = {quoted(given.tolist())} is not an equilibrium; equilibria() finds them{hint}")
    return _about(law, found, push)


def _about(law: RestLaw, q: np.ndarray, forces: np.ndarray) -> Linearisation:
    law.check_smooth(q)
    here = law.matrices(q)
    regular = all(np.isfinite(part).all() for part in here)
    if not regular or np.linalg.cond(here[0]) > 1e12:
        raise InputError(
            f"the equations cannot be linearised at q = {quoted(q.tolist())}: the mass matrix is singular or "
            "a function is not defined there; choose another state"
        )
    changes = law.changes(q, forces)
    modes, poles = find_modes(here, None if changes is None else [change[:3] for change in changes])
    moved = np.array([change[3] for change in changes or ()]).reshape(-1, len(q))
    error = np.full(len(q), np.nan) if changes is None else np.sqrt(np.sum(moved**2, axis=0))
    error[[i for i, x in zip(law.free, _open_directions(here[2]), strict=True) if x]] = np.nan
    return Linearisation(
        tuple(law.names[i] for i in law.free),
        q,
        error,
        forces,
        *here,
        poles,
        modes,
        _stability(here, poles),
        law.left_out,
    )


def _open_directions(stiffness: np.ndarray) -> np.ndarray:
    """Whether a shift that no force opposes moves each coordinate."""
    _, sizes, rows = np.linalg.svd(stiffness)
    null = rows[sizes <= 1e-10 * max(sizes.max(initial=0.0), 1e-300)]
    return np.any(np.abs(null) > 1e-9, axis=0) if len(null) else np.zeros(len(stiffness), dtype=bool)


def _stability(here: Matrices, poles: np.ndarray) -> Stability:
    mass, damping, stiffness = here
    largest = float(np.abs(poles).max(initial=0.0))
    if np.any(np.real(poles) > ZERO * largest):
        return "unstable"
    if np.all(np.real(poles) < -ZERO * largest):
        return "stable"
    symmetric = np.allclose(stiffness, stiffness.T, rtol=1e-9, atol=1e-12 * np.abs(stiffness).max())
    friction = 0.5 * (damping + damping.T)
    rubs, masses = np.linalg.eigvalsh(friction), np.linalg.eigvalsh(mass)
    if not symmetric or masses[0] <= 0.0 or rubs[0] < -1e-9 * np.abs(rubs).max():
        return "undecided"
    springs = eigh(stiffness, mass, eigvals_only=True)
    slack = ZERO**2 * max(np.abs(springs).max(), largest**2)
    if springs[0] < -slack:
        return "undecided"
    return "stable" if springs[0] > slack else "neutral"
