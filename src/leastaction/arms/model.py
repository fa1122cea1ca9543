"""ArmModel: the parameters of an arm with standard errors, their predictions and exports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from leastaction.arms.base import (
    BaseParameters,
    Posterior,
    can_exist,
    find_base,
    fit_bodies,
    inertial_prior,
    with_prior,
)
from leastaction.arms.log import TorqueErrors, prepared, torque_errors
from leastaction.curve.bspline import uniform_grid
from leastaction.curve.smoothing import smooth
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError, MissingPackageError
from leastaction.identifiers import quoted
from leastaction.library.mjcf import write_mjcf
from leastaction.library.tree import KinematicTree
from leastaction.library.urdf import write_urdf
from leastaction.mechanics import Points
from leastaction.mechanics.arm_columns import (
    FRICTION,
    ArmColumns,
    ArmTerm,
    JointScales,
    inertial_terms,
    joint_terms,
    presliding,
)
from leastaction.threads import single_threaded

__all__ = ["ArmModel", "FitFacts"]

_BANDS = (5.0, 10.0)  # Hz


@dataclass(frozen=True)
class FitFacts:
    """Facts of the fit of a model.

    Attributes
    ----------
    trials : tuple of str
        Names of the trajectories.
    noise_std : tuple of float
        Standard deviation of the noise of each coordinate.
    torque_density : tuple of float
        Spectral density of the error of each equation, in torque² seconds.
    knots_per_second : float
    status : str
        Outcome of the solver.
    notes : tuple of str
        Changes to the log, and checks that failed.
    """

    trials: tuple[str, ...]
    noise_std: tuple[float, ...]
    torque_density: tuple[float, ...]
    knots_per_second: float
    status: str
    notes: tuple[str, ...] = ()


class Row(NamedTuple):
    """One row of the table of parameters."""

    parameter: str
    meaning: str
    value: float
    standard_error: float


class ArmModel:
    """An identified arm.

    Attributes
    ----------
    tree : KinematicTree
    base : BaseParameters
        Combinations of parameters that torques depend on; see `rows`.
    coefficients, covariance : (n_base,) and (n_base, n_base) arrays
        Of the base parameters, in SI units. The covariance accounts for correlated residuals.
    reference : (n_links, 10) array
        Inertial parameters from which the load of the joints is computed, if friction depends on it.
    facts : FitFacts
    """

    def __init__(
        self,
        tree: KinematicTree,
        base: BaseParameters,
        coefficients: np.ndarray,
        covariance: np.ndarray,
        reference: np.ndarray,
        facts: FitFacts,
    ) -> None:
        self.tree, self.base, self.facts = tree, base, facts
        self.coefficients, self.covariance, self.reference = coefficients, covariance, reference

    @classmethod
    def of_tree(
        cls,
        tree: KinematicTree,
        joints: Mapping[str, ArrayLike] | None = None,
        *,
        distance: ArrayLike = 0.0,
        width: ArrayLike = 1e-3,
    ) -> ArmModel:
        """The model of a tree with inertias, without standard errors, for comparison or simulation.

        Parameters
        ----------
        tree : KinematicTree
            With inertias for every link.
        joints : mapping of str to array_like, shape (n_dof,)
            Coefficients of each joint, by kind: "rotor", "spring", "offset", "viscous", "dry", "quadratic" or
            "asymmetric".
        distance, width : array_like, shape (n_dof,)
            Distance over which dry friction reverses, and speed below which it decreases.

        Examples
        --------
        >>> import numpy as np
        >>> tree = KinematicTree.from_dh([{}], modified=True, gravity=(9.81, 0.0, 0.0))
        >>> rod = tree.with_inertias([[1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1 / 3, 0.0, 1 / 3]])
        >>> model = ArmModel.of_tree(rod, {"viscous": [0.1]})
        >>> model.torques([[np.pi / 2]], [[1.0]], [[3.0]])
        array([[6.005]])
        """
        if np.isnan(tree.inertias).any():
            raise InputError("the tree has links without inertia; give them with tree.with_inertias(...)")
        known = ("rotor", "spring", "offset", "viscous", "dry", "quadratic", "asymmetric")
        for kind in joints or ():
            if kind not in known:
                raise InputError(f"joints hold {quoted(kind)}; expected {', '.join(known)}")
        n = len(tree)
        widths, ways = (np.broadcast_to(np.asarray(x, float), n) for x in (width, distance))
        kinds = list(joints or ())
        terms = (*inertial_terms(tree), *joint_terms(tree, kinds, JointScales(widths, widths, ways)))
        values = [tree.inertias.ravel()]
        values += [np.broadcast_to(np.asarray(x, float), n) for x in (joints or {}).values()]
        base = find_base(tree, terms)
        size = len(base.members)
        facts = FitFacts((), (0.0,) * n, (0.0,) * n, 50.0, "given")
        coefficients = base.matrix @ np.concatenate(values)
        return cls(tree, base, coefficients, np.zeros((size, size)), tree.inertias, facts)

    def __repr__(self) -> str:
        return f"<ArmModel of {self.tree.name!r}: {len(self.coefficients)} base parameters>"

    def __str__(self) -> str:
        rows = self.rows()
        width = max(len(_short(row.parameter)) for row in rows)
        lines = [f"{'parameter':{width}} {'value':>12} {'std. error':>11}  meaning"]
        lines += [
            f"{_short(r.parameter):{width}} {r.value:>12.5g} {r.standard_error:>11.2g}  {r.meaning}"
            for r in rows
        ]
        return "\n".join([*lines, *(f"note: {note}" for note in self.facts.notes)])

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.tree.coordinates

    @property
    def terms(self) -> tuple[ArmTerm, ...]:
        """Candidates that stand for one base parameter each."""
        return tuple(self.base.terms[k] for k in self.base.members)

    @property
    def standard_errors(self) -> np.ndarray:
        """(n_base,) of the coefficients."""
        return np.sqrt(np.diag(self.covariance))

    def rows(self) -> list[Row]:
        """Base parameters in symbols and words, with value and standard error."""
        given = zip(self.coefficients.tolist(), self.standard_errors.tolist(), strict=True)
        return [
            Row(self.base.text(k), self.base.words(k, self.tree), value, error)
            for k, (value, error) in enumerate(given)
        ]

    def table(self) -> Any:
        """`rows` as a data frame; needs pandas."""
        try:
            import pandas
        except ImportError:
            raise MissingPackageError("ArmModel.table()", "pandas", "pandas", "use rows()") from None
        return pandas.DataFrame(self.rows(), columns=list(Row._fields))

    @cached_property
    def _columns(self) -> ArmColumns:
        return ArmColumns(self.tree, self.terms, self.reference)

    def torques(
        self, q: ArrayLike, qdot: ArrayLike, qddot: ArrayLike, *, successive: bool = False
    ) -> np.ndarray:
        """Inverse dynamics.

        Parameters
        ----------
        q, qdot, qddot : array_like, shape (n_times, n_dof)
        successive : bool
            Whether the states are a time series that resolves reversals. Dry friction then reverses over its
            distance; otherwise it follows the sign of the velocity.

        Returns
        -------
        (n_times, n_dof) array
        """
        states = [np.atleast_2d(np.asarray(a, dtype=float)) for a in (q, qdot, qddot)]
        for name, state in zip(("q", "qdot", "qddot"), states, strict=True):
            if state.shape != states[0].shape or state.shape[1:] != (len(self.tree),):
                raise InputError(
                    f"{name} has the shape {state.shape}; expected (n_times, {len(self.tree)}), as for the "
                    f"joints {', '.join(self.coordinates)}"
                )
        columns, points = self._columns, Points(*states)
        if successive:
            ways = np.zeros((2, len(states[0]), 1, len(self.tree)))
            for term in self.terms:
                if term.kind == "dry" and term.distance:
                    ways[:, :, 0, term.place] = presliding(states[0][:, term.place], term.distance)
            columns = ArmColumns(self.tree, self.terms, self.reference, (), ways)
            points = Points(*states, intervals=slice(0, len(states[0])))
        return np.tensordot(self.coefficients, columns.strong(points), 1).T

    def columns(self, q: np.ndarray, qdot: np.ndarray, qddot: np.ndarray) -> np.ndarray:
        """(n_base, n_dof, n_times) regressor: the torques for a unit of each base parameter."""
        return self._columns.strong(Points(q, qdot, qddot))

    def mass_matrix(self, q: ArrayLike) -> np.ndarray:
        """(n_times, n_dof, n_dof), rotors included."""
        q = np.atleast_2d(np.asarray(q, dtype=float))
        return self._columns.mass_matrix(Points(q, np.zeros_like(q), np.zeros_like(q)), self.coefficients)

    def gravity(self, q: ArrayLike) -> np.ndarray:
        """(n_times, n_dof) torques that hold the arm still, without friction and constant torques."""
        q = np.atleast_2d(np.asarray(q, dtype=float))
        inertial = self._only("inertia")
        columns = self._columns.strong(Points(q, np.zeros_like(q), np.zeros_like(q)))
        return np.tensordot(inertial, columns, 1).T

    def friction(self, q: ArrayLike, qdot: ArrayLike) -> np.ndarray:
        """(n_times, n_dof) torques of friction alone, for compensation."""
        q, qdot = (np.atleast_2d(np.asarray(a, dtype=float)) for a in (q, qdot))
        kept = np.where([term.kind in FRICTION for term in self.terms], self.coefficients, 0.0)
        return np.tensordot(kept, self.columns(q, qdot, np.zeros_like(q)), 1).T

    def acceleration(self, q: ArrayLike, qdot: ArrayLike, torques: ArrayLike) -> np.ndarray:
        """(n_times, n_dof) accelerations under given torques."""
        q, qdot = np.atleast_2d(np.asarray(q, float)), np.atleast_2d(np.asarray(qdot, float))
        rest = self.torques(q, qdot, np.zeros_like(q))
        right = np.atleast_2d(np.asarray(torques, float)) - rest
        return np.linalg.solve(self.mass_matrix(q), right[..., None])[..., 0]

    def _only(self, kind: str) -> np.ndarray:
        keep = np.array([term.kind == kind for term in self.terms])
        return np.where(keep, self.coefficients, 0.0)

    def parameters(self, share: float = 0.3) -> Posterior:
        """All parameters; the inertias of the tree serve as priors.

        Parameters
        ----------
        share : float
            Standard deviation of the inertias of the tree, as a share of each link's mass and size.

        Raises
        ------
        InputError
            If a link has no inertia in the tree.
        """
        means, spreads = inertial_prior(self.tree, share)
        for link, row in zip(self.tree.links, spreads, strict=True):
            if not np.isfinite(row).all():
                raise InputError(
                    f"{link} has no inertia in the tree, so that there is no prior for it; use bodies(), or "
                    "tree.with_inertias(...)"
                )
        n = len(self.base.terms)
        prior, spread = np.zeros(n), np.full(n, np.inf)
        for k, term in enumerate(self.base.terms):
            if term.kind == "inertia":
                prior[k], spread[k] = means[term.place, term.component], spreads[term.place, term.component]
            elif term.kind in ("rotor", "spring", "offset") and k not in self.base.members:
                spread[k] = max(float(np.max(spreads[term.place])), 1e-3)
        return with_prior(self.base, self.coefficients, self.covariance, prior, spread)

    @single_threaded()
    def bodies(self) -> ArmModel:
        """The same arm with physically consistent links: positive mass, positive definite pseudo-inertia.

        The links agree with the base parameters within their errors. Parameters that the torques do not
        determine stay near the inertias of the tree, or near balls of 2 kg and 0.1 m. The tree of the result
        holds the inertias, and a note gives the increase of χ².
        """
        found = fit_bodies(self.tree, self.base, self.coefficients, self.covariance)
        values = found.values[: 10 * len(self.tree)].reshape(-1, 10)
        note = (
            f"bodies that can exist: chi-squared of the {len(self.coefficients)} base parameters rises by "
            f"{found.price:.3g}"
        )
        facts = replace(self.facts, notes=(*self.facts.notes, note))
        tree = self.tree.with_inertias(values)
        coefficients = self.base.matrix @ found.values
        return ArmModel(tree, self.base, coefficients, self.covariance, self.reference, facts)

    @property
    def can_exist(self) -> np.ndarray:
        """(n_links,) whether the inertias in the tree are physically consistent."""
        return can_exist(np.nan_to_num(self.tree.inertias))

    @single_threaded()
    def validate(
        self,
        trajectories: Trajectory | Trajectories | Iterable[Trajectory],
        *,
        bands: tuple[float, ...] = _BANDS,
    ) -> TorqueErrors:
        """Predict the torques of another log from its angles and compare them with the measured ones.

        Parameters
        ----------
        trajectories
            As for `identify`. 0.3 s at both ends are left out of the comparison.
        bands : tuple of float
            Frequencies in Hz. Torques are compared below each of them, and unfiltered.
        """
        data, _ = prepared(Trajectories.coerce(trajectories), self.tree)
        pairs = [(run.t, self._predicted(run), run.forces) for run in data if run.forces is not None]
        return torque_errors(self.coordinates, pairs, bands)

    def _predicted(self, run: Trajectory) -> np.ndarray:
        """(n_times, n_dof) torques along a smoothed run."""
        grid = uniform_grid([run.t], self.facts.knots_per_second, 5)
        points = smooth(grid, [run.t], [run.q]).control_points
        states = [grid.evaluate(points, [run.t], nu)[0] for nu in range(3)]
        return self.torques(*states, successive=True)

    def to_urdf(self, source: str | Path, path: str | Path) -> None:
        """Write the inertias of the tree into a copy of the URDF that it was read from; see `bodies`."""
        write_urdf(self.tree, source, path)

    def to_mjcf(self, path: str | Path) -> None:
        """Write the tree as a MuJoCo model, with rotors, viscous and dry friction and springs; see `bodies`.

        Joints of MuJoCo have no other friction and no constant torques: these are left out.
        """
        values = np.zeros((4, len(self.tree)))
        kinds = ("rotor", "viscous", "dry", "spring")
        for term, value in zip(self.terms, self.coefficients.tolist(), strict=True):
            if term.kind in kinds:
                values[kinds.index(term.kind), term.place] = value
        write_mjcf(self.tree, path, dict(zip(kinds, values, strict=True)))

    def save(self, path: str | Path) -> None:
        """Write the model to a JSON file; `load` reads it."""
        from leastaction.arms import file

        file.save(self, path)

    def to_python(self, path: str | Path) -> None:
        """Write a module with ``torques``, ``gravity`` and ``friction``, in NumPy alone."""
        from leastaction.arms import code

        code.write_python(self, path)

    def to_c(self, path: str | Path) -> None:
        """Write C99 code with ``arm_torques``, ``arm_gravity`` and ``arm_friction``; needs math.h alone."""
        from leastaction.arms import code

        code.write_c(self, path)

    def to_casadi(self) -> dict[str, Any]:
        """``torques(q, qdot, qddot)``, ``gravity(q)`` and ``friction(qdot)`` as CasADi functions, by name."""
        from leastaction.arms import code

        return code.casadi_functions(self)


def _short(text: str, most: int = 34) -> str:
    """The text of a combination, cut at a sign."""
    if len(text) <= most:
        return text
    return text[: text.rfind(" ", 0, most - 2)].rstrip(" +-") + " ..."
