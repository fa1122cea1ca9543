"""ArmModel: the parameters of an arm with standard errors, their predictions and exports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from leastaction.arms.base import (
    BALL,
    TREE_SHARE,
    BaseParameters,
    Bodies,
    Posterior,
    Row,
    can_exist,
    find_base,
    fit_bodies,
    table_of,
    with_tree,
)
from leastaction.arms.compare import BANDS, FreeRuns, TorqueErrors, TorqueRun, free_runs, torque_errors
from leastaction.arms.log import FitFacts, prepared
from leastaction.arms.signals import Recording, Signals
from leastaction.curve.bspline import uniform_grid
from leastaction.curve.smoothing import smooth
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError, MissingPackageError
from leastaction.identifiers import quoted
from leastaction.library.mjcf import write_mjcf
from leastaction.library.tree import KinematicTree
from leastaction.library.urdf import write_urdf
from leastaction.mechanics import Points
from leastaction.mechanics.arm_columns import ArmColumns, dry_history
from leastaction.mechanics.arm_terms import FRICTION, STILL, ArmTerm, JointScales, parameter_terms
from leastaction.threads import single_threaded

__all__ = ["ArmModel"]

_CHUNK = 4096  # states whose columns are in memory at once


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
        self.tree: KinematicTree = tree
        self.base: BaseParameters = base
        self.coefficients: np.ndarray = coefficients
        self.covariance: np.ndarray = covariance
        self.reference: np.ndarray = reference
        self.facts: FitFacts = facts

    @classmethod
    def of_tree(
        cls,
        tree: KinematicTree,
        joints: Mapping[str, ArrayLike] | None = None,
        *,
        extra: ArrayLike = 0.0,
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
        extra : array_like, shape (n_extra,)
            Coefficients of expressions; see `KinematicTree.with_terms`.
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
        joints = dict(joints or {})
        for kind in joints:
            if kind not in known:
                raise InputError(f"joints hold {quoted(kind)}; expected {', '.join(known)}")
        n = len(tree)
        widths, ways = (np.broadcast_to(np.asarray(x, float), n) for x in (width, distance))
        terms = parameter_terms(tree, list(joints), JointScales(widths, widths, ways))
        each = [np.broadcast_to(np.asarray(x, float), n) for x in joints.values()]
        each.append(np.broadcast_to(np.asarray(extra, float), len(tree.extra)))
        base = find_base(tree, terms)
        facts = FitFacts((), (0.0,) * n, (0.0,) * n, 50.0, "given")
        coefficients = base.matrix @ np.concatenate([tree.inertias.ravel(), *each])
        return cls(tree, base, coefficients, np.zeros((len(coefficients),) * 2), tree.inertias, facts)

    def __repr__(self) -> str:
        return f"<ArmModel of {self.tree.name!r}: {len(self.coefficients)} base parameters>"

    def __str__(self) -> str:
        return "\n".join([table_of(self.rows()), *(f"note: {note}" for note in self.facts.notes)])

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
        columns = self._columns
        if successive:
            history = dry_history(self.terms, *states[:2])
            columns = ArmColumns(self.tree, self.terms, self.reference, (), history)
        out = np.empty_like(states[0])
        for begin in range(0, len(out), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            points = Points(*(state[part] for state in states), intervals=part)
            out[part] = np.tensordot(self.coefficients, columns.strong(points), 1).T
        return out

    def columns(self, q: np.ndarray, qdot: np.ndarray, qddot: np.ndarray) -> np.ndarray:
        """(n_base, n_dof, n_times) regressor: the torques for a unit of each base parameter."""
        return self._columns.strong(Points(q, qdot, qddot))

    def mass_matrix(self, q: ArrayLike) -> np.ndarray:
        """(n_times, n_dof, n_dof), rotors included."""
        q = np.atleast_2d(np.asarray(q, dtype=float))
        return self._columns.mass_matrix(Points(q, np.zeros_like(q), np.zeros_like(q)), self.coefficients)

    def gravity(self, q: ArrayLike) -> np.ndarray:
        """(n_times, n_dof) torques of weight, springs and added potentials that hold the arm still."""
        q = np.atleast_2d(np.asarray(q, dtype=float))
        columns = self._columns.strong(Points(q, np.zeros_like(q), np.zeros_like(q)))
        kept = np.where([t.kind in STILL for t in self.terms], self.coefficients, 0.0)
        return np.tensordot(kept, columns, 1).T

    def friction(self, q: ArrayLike, qdot: ArrayLike) -> np.ndarray:
        """(n_times, n_dof) torques of friction alone, for compensation."""
        q, qdot = (np.atleast_2d(np.asarray(a, dtype=float)) for a in (q, qdot))
        kept = np.where([t.kind in (*FRICTION, "loss") for t in self.terms], self.coefficients, 0.0)
        return np.tensordot(kept, self.columns(q, qdot, np.zeros_like(q)), 1).T

    def acceleration(self, q: ArrayLike, qdot: ArrayLike, torques: ArrayLike) -> np.ndarray:
        """(n_times, n_dof) accelerations under given torques."""
        q, qdot = np.atleast_2d(np.asarray(q, float)), np.atleast_2d(np.asarray(qdot, float))
        rest = self.torques(q, qdot, np.zeros_like(q))
        right = np.atleast_2d(np.asarray(torques, float)) - rest
        return np.linalg.solve(self.mass_matrix(q), right[..., None])[..., 0]

    def parameters(self, share: float = TREE_SHARE) -> Posterior:
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
        return with_tree(self.tree, self.base, self.coefficients, self.covariance, share)

    @cached_property
    def consistent(self) -> Bodies:
        """Parameters of physically consistent links, and the increase of χ² that they cost; see `bodies`."""
        return fit_bodies(self.tree, self.base, self.coefficients, self.covariance)

    @single_threaded()
    def bodies(self) -> ArmModel:
        """The same arm with physically consistent links: positive mass, positive definite pseudo-inertia.

        The links agree with the base parameters within their errors. Parameters that the torques do not
        determine stay near the inertias of the tree, or near balls of 2 kg and 0.1 m. The tree of the result
        holds the inertias, and a note gives the increase of χ².
        """
        found = self.consistent
        values = found.values[: 10 * len(self.tree)].reshape(-1, 10)
        notes: list[str] = []
        unknown = [
            x for x, own in zip(self.tree.links, self.tree.inertias, strict=True) if np.isnan(own).any()
        ]
        if unknown:
            notes.append(
                f"the tree has no inertia for {', '.join(unknown)}: what the log leaves open there is as in "
                f"balls of {BALL}; add the manufacturer's values to the file or by with_inertias(...)"
            )
        notes.append(
            f"physically consistent bodies: chi-squared of the {len(self.coefficients)} base parameters "
            f"rises by {found.price:.3g}"
        )
        facts = replace(self.facts, notes=(*self.facts.notes, *notes))
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
        bands: tuple[float, ...] = BANDS,
    ) -> TorqueErrors:
        """Predict the torques of another log from its angles and compare them with the measured ones.

        Parameters
        ----------
        trajectories
            As for `identify`. 0.3 s at both ends are left out of the comparison.
        bands : tuple of float
            Frequencies in Hz. Torques are compared below each of them, and unfiltered.
        """
        return torque_errors(self.coordinates, self.predict(trajectories), bands)

    @single_threaded()
    def predict(
        self, trajectories: Trajectory | Trajectories | Iterable[Trajectory]
    ) -> tuple[TorqueRun, ...]:
        """Predict the torques of a log from its angles, beside the measured ones; one result for each run.

        Parameters
        ----------
        trajectories
            As for `identify`.
        """
        out: list[TorqueRun] = []
        for run in self._calibrated(trajectories):
            assert run.forces is not None
            q, qdot, qddot = self._smoothed(run)
            predicted = self.torques(q, qdot, qddot, successive=True)
            measured = np.where(np.isin(run.coordinates, self.facts.unmeasured), np.nan, run.forces)
            out.append(TorqueRun(run.name, run.t, q, qdot, qddot, predicted, measured))
        return tuple(out)

    @single_threaded()
    def free_runs(
        self, trajectories: Trajectory | Trajectories | Iterable[Trajectory], *, horizon: float = 0.5
    ) -> FreeRuns:
        """Simulate pieces of another log under its measured torques, and compare the angles.

        Parameters
        ----------
        trajectories
            As for `identify`.
        horizon : float
            Length of a piece in s. Pieces follow each other; each begins at the smoothed log.
        """
        data = self._calibrated(trajectories)
        return free_runs(self, data, [self._smoothed(run) for run in data], horizon)

    def _calibrated(self, trajectories: Trajectory | Trajectories | Iterable[Trajectory]) -> Trajectories:
        """The log with torques on time and in N m, by the delays and gains of the fitted log."""
        none, n = Recording(unmeasured=self.facts.unmeasured).places(self.tree), len(self.tree)
        data = prepared(Trajectories.coerce(trajectories), self.tree, none)[0]
        delays, gains = self.facts.delays or [0.0] * n, self.facts.gains or [1.0] * n
        return Signals(np.array(delays), np.array(gains), False, ()).torques(data)

    def _smoothed(self, run: Trajectory) -> list[np.ndarray]:
        grid = uniform_grid([run.t], self.facts.knots_per_second, 5)
        points = smooth(grid, [run.t], [run.q]).control_points
        return [grid.evaluate(points, [run.t], nu)[0] for nu in range(3)]

    def to_urdf(self, source: str | Path, path: str | Path) -> None:
        """Write the inertias of the tree into a copy of the URDF that it was read from; see `bodies`."""
        write_urdf(self.tree, source, path)

    def to_mjcf(self, path: str | Path) -> None:
        """Write the tree as a MuJoCo model, with rotors, viscous and dry friction and springs; see `bodies`.

        Joints of MuJoCo have no other friction and no constant torques: these are left out, and so are
        expressions that the tree adds.
        """
        values = {kind: np.zeros(len(self.tree)) for kind in ("rotor", "viscous", "dry", "spring")}
        for term, value in self.in_joints():
            if term.kind in values:
                values[term.kind][term.place] = value
        values["rotor"] = np.maximum(values["rotor"], 0.0)  # without bodies() links may have too much inertia
        write_mjcf(self.tree, path, values)

    def in_joints(self) -> list[tuple[ArmTerm, float]]:
        """Rotors, friction, springs, constant torques and expressions, beside the inertias; see `bodies`.

        A base parameter of a link may hold a rotor: it is what the inertias of the tree leave of it.
        """
        return self.base.in_joints(self.coefficients, self.tree.inertias)

    def save(self, path: str | Path) -> None:
        """Write the model to a JSON file; `load` reads it."""
        from leastaction.arms import files

        files.save(self, path)

    def to_python(self, path: str | Path) -> None:
        """Write a module with ``torques``, ``gravity`` and ``friction``, in NumPy alone."""
        from leastaction.arms import files

        files.write_python(self, path)

    def to_c(self, path: str | Path) -> None:
        """Write C99 code with ``arm_torques``, ``arm_gravity`` and ``arm_friction``; needs math.h alone."""
        from leastaction.arms import files

        files.write_c(self, path)

    def to_casadi(self) -> dict[str, Any]:
        """``torques(q, qdot, qddot)``, ``gravity(q)`` and ``friction(qdot)`` as CasADi functions, by name."""
        from leastaction.arms import files

        return files.casadi_functions(self)
