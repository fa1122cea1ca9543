"""LagrangianModel: the result of a discovery, for computation, plots and files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike

from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.io import write_text
from leastaction.mechanics.equations import Mechanics
from leastaction.model import checks
from leastaction.model import file as model_file
from leastaction.model import text as model_text
from leastaction.model.calibration import Calibration
from leastaction.model.constants import SimpleConstants, find_simple_constants
from leastaction.model.groups import Grouped, Groups
from leastaction.model.linear import Resting
from leastaction.model.shown import ShownModel
from leastaction.model.symmetries import Symmetry, find_symmetries
from leastaction.model.term import FitSummary, ModelTerm, ShapeParameter
from leastaction.simulation.forecast import forecast
from leastaction.simulation.integrate import force_function, simulate
from leastaction.simulation.law import follow, spread_of
from leastaction.simulation.results import ForecastResult, SimulationResult
from leastaction.threads import single_threaded

if TYPE_CHECKING:
    from leastaction.model.diagnostics import Diagnostics

__all__ = ["FitSummary", "LagrangianModel", "ModelTerm", "ShapeParameter"]


@dataclass(frozen=True, eq=False, repr=False)
class LagrangianModel(model_text.Written, ShownModel, Resting, Grouped):
    r"""A Lagrangian L(q, q̇, t) and a dissipation function ψ(q, q̇, t), with coefficients and their errors.

    The motion obeys d/dt ∂L/∂q̇ − ∂L/∂q = f − ∂ψ/∂q̇; without forces, a common factor is arbitrary.

    Parameters
    ----------
    coordinates : sequence of str
    terms, dissipation : sequence of ModelTerm
        L = Σ coefficient · expression, at least one term; and the same for ψ, which may be empty.
    covariance : array_like, shape (n_free, n_free), optional
        Of the coefficients of `terms` and `dissipation` that are not known, then of the `shapes`.
    noise_std : array_like, shape (n_dof,), optional
        Standard deviation of the measurement noise; NaN: not available.
    fit : FitSummary
        The verdict and the findings.
    provenance : mapping
        Origin of the model: version, options, hash of the data. Must be JSON.
    diagnostics : Diagnostics, optional
        Data, curve and trade-off curve of the discovery. Not saved.
    shapes : sequence of ShapeParameter
        Estimated numbers inside terms. The expressions already contain them.
    groups, calibration : Groups and Calibration, optional
        Differences between groups of trials (`of_group`), and columns that are functions of the coordinates.

    Raises
    ------
    InputError
        If a name, an expression, a number or a shape is not as described.

    Examples
    --------
    >>> pendulum = LagrangianModel(["theta"], [ModelTerm("theta_dot**2", 0.5, 0.0009),
    ...                                        ModelTerm("cos(theta)", 9.81, known=True)])
    >>> pendulum.lagrangian
    0.5*theta_dot**2 + 9.81*cos(theta)
    >>> pendulum.acceleration([[0.1], [0.2]], [[0.0], [0.0]]).round(3).tolist()
    [[-0.979], [-1.949]]
    >>> pendulum.equations_of_motion()[0].rhs
    -9.81*sin(theta)
    """

    coordinates: tuple[str, ...]
    terms: tuple[ModelTerm, ...]
    dissipation: tuple[ModelTerm, ...] = ()
    covariance: np.ndarray | None = None
    noise_std: np.ndarray = None  # type: ignore[assignment]
    fit: FitSummary = field(default_factory=FitSummary)
    provenance: Mapping[str, Any] = field(default_factory=dict[str, Any])
    diagnostics: Diagnostics | None = None
    shapes: tuple[ShapeParameter, ...] = ()
    groups: Groups | None = None
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        for name, value in checks.checked_fields(self).items():
            object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, Any]:
        # compiled functions cannot be pickled; they are compiled again when needed
        kept = {*self.__dataclass_fields__, "_expressions", "symmetries", "simple_constants"}
        return {k: v for k, v in self.__dict__.items() if k in kept}

    @property
    def n_dof(self) -> int:
        """Number of degrees of freedom."""
        return len(self.coordinates)

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """SymPy expressions of `terms`, without coefficients."""
        return self.__dict__["_expressions"][0]

    @property
    def dissipation_expressions(self) -> tuple[sp.Expr, ...]:
        """SymPy expressions of `dissipation`, without coefficients."""
        return self.__dict__["_expressions"][1]

    @cached_property
    def lagrangian(self) -> sp.Expr:
        """L with all digits, over real SymPy symbols; `formula` rounds it for reading."""
        return model_text.weighted_sum(self.terms, self.expressions)

    @cached_property
    def dissipation_function(self) -> sp.Expr:
        """ψ with its numbers; 0 if there is no dissipation."""
        return model_text.weighted_sum(self.dissipation, self.dissipation_expressions)

    @property
    def prescribed(self) -> tuple[str, ...]:
        """Coordinates moved by unknown forces (`provenance`): their entries of forces are accelerations."""
        return checks.prescribed_in(self.coordinates, self.provenance)

    @property
    def angles(self) -> tuple[str, ...]:
        """Coordinates that were declared angles in the discovery (`provenance`)."""
        return tuple(checks.angles_in(self.coordinates, self.provenance))

    @cached_property
    def mechanics(self) -> Mechanics:
        """Symbolic and compiled equations of motion."""
        places = [self.coordinates.index(name) for name in self.prescribed]
        return Mechanics(self.lagrangian, self.dissipation_function, self.coordinates, prescribed=places)

    @cached_property
    def symmetries(self) -> tuple[Symmetry, ...]:
        """Changes of variables that leave L unchanged, in form or within errors, and conserved quantities."""
        return find_symmetries(self)

    @cached_property
    def simple_constants(self) -> SimpleConstants:
        """Simple numbers, such as 1/2 or π, inside intervals that are too narrow to hold one by chance."""
        return find_simple_constants(self)

    def equations_of_motion(self, forces: bool = False) -> tuple[sp.Eq, ...]:
        """Equations of motion as SymPy equations.

        Parameters
        ----------
        forces : bool
            Add a symbol ``<coordinate>_force`` for the generalised force on each coordinate.

        Returns
        -------
        tuple of sympy.Eq
            One per coordinate that is not `prescribed`. Up to three coordinates, they are solved: the left
            sides are the symbols ``<coordinate>_dot_dot``. For more coordinates the solution would fill
            pages, and the i-th equation reads Σ_j M_ij q̈_j = r_i.
        """
        return self.mechanics.equations(forces)

    @property
    def timed(self) -> bool:
        """Whether L or ψ depends explicitly on time; methods that take a state then need `t` as well."""
        return self.mechanics.timed

    def acceleration(
        self, q: ArrayLike, qdot: ArrayLike, forces: ArrayLike | None = None, t: ArrayLike | None = None
    ) -> np.ndarray:
        """q̈, the solution of M q̈ = f − ∂ψ/∂q̇ + ∂L/∂q − (∂²L/∂q̇∂q) q̇ − ∂²L/∂q̇∂t.

        Parameters
        ----------
        q, qdot : array_like, shape (..., n_dof)
            They are broadcast against each other, and so are `forces`.
        forces : array_like, shape (..., n_dof), optional
        t : array_like, shape (...), optional
            Times in seconds, required for a `timed` model.

        Returns
        -------
        ndarray, shape (..., n_dof)
            NaN where the mass matrix is singular.

        Raises
        ------
        InputError
            If the last axis does not hold one number per coordinate, or times are missing.
        """
        return self.mechanics.acceleration(*self._states(t, q=q, qdot=qdot, forces=forces))

    def energy(self, q: ArrayLike, qdot: ArrayLike, t: ArrayLike | None = None) -> np.ndarray:
        """q̇·∂L/∂q̇ − L, conserved if nothing drives or damps the system and L does not depend on time.

        Parameters
        ----------
        q, qdot : array_like, shape (..., n_dof)
        t : array_like, shape (...), optional
            As for `acceleration`.

        Returns
        -------
        ndarray, shape (...)
        """
        return self.mechanics.energy(*self._states(t, q=q, qdot=qdot))

    def mass_matrix(
        self, q: ArrayLike, qdot: ArrayLike | None = None, t: ArrayLike | None = None
    ) -> np.ndarray:
        """∂²L/∂q̇∂q̇.

        Parameters
        ----------
        q : array_like, shape (..., n_dof)
        qdot : array_like, shape (..., n_dof), optional
            Zero by default; it matters only if L is not quadratic in the velocities.
        t : array_like, shape (...), optional
            As for `acceleration`.

        Returns
        -------
        ndarray, shape (..., n_dof, n_dof)
        """
        qdot = np.zeros(self.n_dof) if qdot is None else qdot
        return self.mechanics.mass_matrix(*self._states(t, q=q, qdot=qdot))

    @single_threaded()
    def simulate(
        self,
        q0: ArrayLike,
        qdot0: ArrayLike,
        t: ArrayLike,
        forces: Any = None,
        *,
        inputs: Mapping[str, ArrayLike] | None = None,
        start_std: ArrayLike | None = None,
        **limits: Any,
    ) -> SimulationResult:
        """Integrate one motion with an adaptive method of order 8 (DOP853).

        Parameters
        ----------
        q0, qdot0 : array_like, shape (n_dof,)
            Start, at ``t[0]``.
        t : array_like, shape (n_times,)
            Times in seconds, strictly increasing.
        forces : array_like, shape (n_times, n_dof), or callable, optional
            Generalised forces at `t`, or ``forces(time) -> (n_dof,)``; for `prescribed` coordinates, q̈.
        inputs : mapping of str to array_like, shape (n_times,), optional
            Positions of `prescribed` coordinates at `t`, without noise. They start there and need no force.
        start_std : array_like, shape (2, n_dof) or broadcastable to it, optional
            Standard deviations of `q0` and `qdot0`, 0 if exact. The result then has `std`, the standard
            deviation of q, from 128 motions with errors of start, coefficients and equations (white noise as
            in the fit).
        **limits
            ``events``, ``max_steps``, ``rtol``, ``atol``: see `leastaction.simulation.integrate.Limits`.

        Returns
        -------
        SimulationResult
            With ``status="stopped"`` and a reason if the integration cannot reach the end, for example
            because the mass matrix becomes singular. A numerical failure raises no exception.

        Raises
        ------
        InputError
            If shapes, times or numbers are invalid, or the model has no standard errors for `start_std`.

        Examples
        --------
        >>> spring = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
        >>> run = spring.simulate([1.0], [0.0], np.linspace(0.0, np.pi, 5))
        >>> run.status, run.q[:, 0].round(6).tolist()
        ('complete', [1.0, 0.0, -1.0, 0.0, 1.0])
        """
        q0, qdot0 = (checks.checked_start(self.coordinates, x, k) for k, x in (("q0", q0), ("qdot0", qdot0)))
        if callable(forces):
            checks.check_force_function(self.coordinates, forces, t)
        if inputs:
            places = checks.checked_inputs(self.coordinates, self.prescribed, inputs)
            q0, qdot0, forces = follow(places, q0, qdot0, t, forces)
        std = None if start_std is None else checks.checked_start_std(start_std, self.n_dof, self._open_law)
        limits = {"mass_matrix": self.mechanics.mass_matrix, "timed": self.timed, **limits}
        run = simulate(self.mechanics.acceleration, q0, qdot0, t, forces, **limits)
        run = replace(run, coordinates=self.coordinates, angles=self.angles)
        if std is not None:
            pushed = force_function(forces, np.asarray(t, dtype=float), self.n_dof)
            run = replace(run, std=spread_of(self._open_law, run, qdot0, std, pushed))
        return run

    @single_threaded()
    def validate(
        self,
        trajectories: Trajectory | Trajectories | Sequence[Trajectory],
        horizon: float | None = None,
        *,
        window: float | None = None,
        tolerance: float = 0.4,
        groups: Mapping[str, object] | Iterable[object] | None = None,
    ) -> ForecastResult:
        """Forecast held-out measurements and compare.

        A forecast starts every `horizon` seconds. Its initial state comes from the motion of the model that
        best fits the data in the `window` before (least squares). From there, the model is simulated with the
        known forces of the trajectories. Coordinates that were angles in the discovery (provenance) are
        unwrapped first; `prescribed` coordinates follow their smoothed measurements.

        Parameters
        ----------
        trajectories : Trajectory, Trajectories or sequence of Trajectory
            Of the same coordinates in the same order, without some, or of columns of the `calibration`.
        horizon : float, optional
            Length of the simulations in seconds. By default 1 s, at least 20 sampling intervals, at most half
            of the shortest trial.
        window : float, optional
            Length of the data from which the initial state is found. By default half of the horizon (twice
            if a coordinate has no sensor) or less in a short trial, but at least 8 sampling intervals.
        tolerance : float
            A forecast is valid until the error of a coordinate exceeds `tolerance` times its standard
            deviation plus three times the noise.
        groups : iterable, or mapping of str, optional
            The group of each trajectory, as for `discover`. By default, all belong to the first one.

        Returns
        -------
        ForecastResult
            Errors in the units of the coordinates and relative to noise and spread, and the errors of an
            exact model. A simulation that diverges is recorded as such.

        Raises
        ------
        InputError
            If the coordinates are others, no trial is long enough for one forecast, or no group has the name.
        """
        data, noise, sight = checks.held_out(self, trajectories)
        if groups is not None:
            trials = Trajectories.coerce(trajectories)
            run = self.forecast_groups(trials, groups, (horizon, window, tolerance))
        else:
            run = forecast(self._open_law, data, noise, horizon, window, tolerance, sight)
        return replace(run, angles=self.angles)

    def _states(self, t: ArrayLike | None, **arrays: ArrayLike | None) -> list[Any]:
        states = checks.checked_states(self.coordinates, arrays)
        return [*states, checks.checked_times(t, states[0].shape[:-1]) if self.timed else None]

    def to_dict(self) -> dict[str, Any]:
        """Return the model as JSON types, as in the file of `save`. null means "not available"."""
        return model_file.encode(self)

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], source: str = "model") -> LagrangianModel:
        """Create a model from the output of `to_dict`, after checking all of it.

        Parameters
        ----------
        document : mapping
        source : str
            Origin for messages, e.g. the file name.

        Raises
        ------
        InputError
            Naming the source, the place, what was expected and the cure.
        """
        try:
            return cls(**model_file.fields(document))
        except InputError as error:
            raise InputError(f"{source}: {error}") from None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to a JSON file, all or nothing. `load` reads it. Diagnostics are not saved.

        Raises
        ------
        InputError
            If the file cannot be written, or the provenance is not JSON.

        Examples
        --------
        >>> from tempfile import TemporaryDirectory
        >>> spring = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
        >>> from leastaction import load
        >>> with TemporaryDirectory() as folder:
        ...     spring.save(f"{folder}/spring.json")
        ...     load(f"{folder}/spring.json")
        <LagrangianModel of x: L = 0.5*x_dot**2 - 2*x**2; fit ok>
        """
        write_text(path, model_file.to_text(self.to_dict()))
