"""payload(): mass, centre and inertia of the load of an identified arm, from a second log.

A body that is fixed to a link adds its ten inertial parameters δ to those of the link.  With the base
parameters of the arm alone, β₁ ± Σ₁, and with the load, β₂ ± Σ₂,

    β₂ − β₁ = B δ + error,        covariance Σ₁ + Σ₂,

where B holds the columns of that link, and generalised least squares gives δ.  Friction and constant torques
may differ between the logs: they are left out of the difference.  Khalil, Gautier & Lemoine 2007 (IEEE
International Conference on Robotics and Automation) compare ways to identify a load.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2, norm

from leastaction.arms.base import BaseParameters, fit_bodies
from leastaction.arms.identify import identify
from leastaction.arms.model import ArmModel
from leastaction.arms.signals import Recording
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.library.robot_xml import about_centre, moved
from leastaction.library.tree import INERTIAL, Joint, KinematicTree, rpy_matrix
from leastaction.mechanics.arm_terms import inertial_terms

__all__ = ["Payload", "payload"]

_DETERMINED = 1e-9  # largest share of a parameter in directions that do not affect the torques
_CHANGED = 1e-3  # p-value below which the arm itself appears to have changed
_STEP = 1e-6  # of a parameter's error, for derivatives


@dataclass(frozen=True, eq=False)
class Payload:
    """The load of an arm.

    Attributes
    ----------
    parameters, covariance : (10,) and (10, 10) arrays
        Mass (kg), mass times centre of mass (kg m), and inertia about the origin of the frame (kg m²): see
        `rows` for their names. NaN where the arm's torques do not depend on a parameter alone.
    chi_squared, n_degrees : float and int
        Misfit of the difference of the base parameters, and its degrees of freedom.
    notes : tuple of str
    """

    parameters: np.ndarray
    covariance: np.ndarray
    chi_squared: float
    n_degrees: int
    notes: tuple[str, ...] = ()

    @property
    def mass(self) -> float:
        """In kg."""
        return float(self.parameters[0])

    @property
    def centre(self) -> np.ndarray:
        """(3,) centre of mass in m."""
        return self.parameters[1:4] / self.parameters[0]

    @property
    def inertia(self) -> np.ndarray:
        """(3, 3) about the centre of mass, in kg m², along the axes of the frame."""
        return about_centre(self.parameters)[1]

    @property
    def values(self) -> np.ndarray:
        """(10,) mass, centre, and xx, xy, xz, yy, yz, zz of the inertia about the centre."""
        return _derived(self.parameters)

    @cached_property
    def standard_errors(self) -> np.ndarray:
        """(10,) of `values`, to first order in the errors of the parameters."""
        steps = _STEP * np.sqrt(np.diag(self.covariance))
        slope = np.stack(
            [
                (_derived(self.parameters + row) - _derived(self.parameters - row)) / (2.0 * step)
                for row, step in zip(np.diag(steps), steps.tolist(), strict=True)
            ],
            axis=1,
        )
        return np.sqrt(np.diag(slope @ self.covariance @ slope.T))

    def intervals(self, level: float = 0.95) -> np.ndarray:
        """(10, 2) lower and upper ends of the intervals of `values`.

        They belong to the estimate without physical consistency and are centred at `values`.
        """
        if not 0.0 < level < 1.0:
            raise InputError(f"level is {level}; give a probability such as 0.95")
        half = norm.isf((1.0 - level) / 2.0) * self.standard_errors
        return np.stack([self.values - half, self.values + half], axis=1)

    def rows(self) -> list[tuple[str, float, float, str]]:
        """Name, value, standard error and unit of mass, centre, and inertia about the centre."""
        names = ("mass", "x", "y", "z", *INERTIAL[4:])
        units = ("kg", *["m"] * 3, *["kg m²"] * 6)
        given = self.values.tolist(), self.standard_errors.tolist()
        return list(zip(names, *given, units, strict=True))

    def __str__(self) -> str:
        lines = [f"{'payload':8} {'value':>12} {'std. error':>11}"]
        lines += [
            f"{name:8} {value:>12.5g} {error:>11.2g}  {unit}" for name, value, error, unit in self.rows()
        ]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])


def payload(
    arm: ArmModel,
    loaded: ArmModel | Trajectory | Trajectories | Iterable[Trajectory],
    *,
    link: str | None = None,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    rpy: ArrayLike = (0.0, 0.0, 0.0),
    consistent: bool = False,
) -> Payload:
    """Find the mass, centre of mass and inertia of a payload.

    Parameters
    ----------
    arm : ArmModel
        The arm without load, as `identify` returns it; not the result of ``bodies()``.
    loaded : Trajectory, Trajectories, iterable of Trajectory, or ArmModel
        Log of the arm with the load, or the result of `identify` for it. Gains that were found for the arm
        are used for the log, without their errors.
    link : str, optional
        The link that carries the load; by default the last one.
    origin, rpy : array_like, shape (3,)
        Pose, in that link, of the frame of the result, such as the flange: m and rad.
    consistent : bool
        Whether the load must be physically consistent. A note then gives the increase of χ².

    Returns
    -------
    Payload
        The intervals are valid only if the arm itself is the same in both logs. A note warns if the
        difference is not that of a single body.

    Raises
    ------
    InputError
        If the link is unknown, or the models are not of the same arm.
    """
    tree = arm.tree
    if link is not None and link not in tree.links:
        raise InputError(f"link is {quoted(link)}; the arm has {', '.join(tree.links)}")
    place = len(tree) - 1 if link is None else tree.links.index(link)
    if not isinstance(loaded, ArmModel):
        kinds = {arm.base.terms[k].kind for k in arm.base.members}
        gains = dict(zip(tree.coordinates, arm.facts.gains, strict=True)) if arm.facts.gains else None
        loaded = identify(
            loaded,
            tree,
            rotors="rotor" in kinds,
            offsets="offset" in kinds,
            springs="spring" in kinds,
            recording=Recording(gains=gains, unmeasured=arm.facts.unmeasured),
        )
    names, difference, covariance = _difference(arm, loaded)
    columns = [k for k, term in enumerate(arm.base.terms) if term.kind == "inertia" and term.place == place]
    turned = rpy_matrix(rpy)
    shift = np.asarray(origin, dtype=float)
    into_link = np.stack([moved(row, turned, shift) for row in np.eye(10)], axis=1)
    matrix = arm.base.matrix[np.ix_(names, columns)] @ into_link
    inverse = np.linalg.inv(covariance)
    gram = matrix.T @ inverse @ matrix
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    spread = scale[:, None] * np.linalg.pinv(gram * np.outer(scale, scale), hermitian=True) * scale
    found = spread @ (matrix.T @ (inverse @ difference))
    rest = difference - matrix @ found
    left = float(rest @ inverse @ rest)
    rank = int(np.linalg.matrix_rank(matrix))
    notes = _doubts(left, len(names) - rank)
    if consistent:
        body, price = _body(matrix, difference, covariance)
        notes.append(f"a physically consistent body: chi-squared rises by {max(price - left, 0.0):.3g}")
        found = body
    else:
        open_ = _undetermined(matrix)
        found, spread = np.where(open_, np.nan, found), np.where(open_[:, None] | open_, np.nan, spread)
        if open_.any():
            said = ", ".join(np.array(INERTIAL)[open_].tolist())
            notes.append(
                f"the torques of this arm do not determine {said} alone; consistent=True fills them in"
            )
    return Payload(found, spread, left, len(names) - rank, tuple(notes))


def _difference(arm: ArmModel, loaded: ArmModel) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Rows of the base parameters of inertia in the first model, their differences, and the covariance."""
    numbers: list[list[int]] = []
    texts: list[list[str]] = []
    for model in (arm, loaded):
        kinds = [model.base.terms[k].kind for k in model.base.members]
        numbers.append([row for row, kind in enumerate(kinds) if kind in ("inertia", "rotor", "spring")])
        texts.append([model.base.text(row) for row in numbers[-1]])
    if texts[0] != texts[1]:
        raise InputError(
            "the two models have different base parameters; identify both logs with one tree and the same "
            "rotors, offsets and springs"
        )
    if not np.diag(arm.covariance).all() or not np.diag(loaded.covariance).all():
        raise InputError("a model has no errors; give models that identify found, not those of a tree")
    values = [m.coefficients[rows] for m, rows in zip((arm, loaded), numbers, strict=True)]
    spreads = [m.covariance[np.ix_(rows, rows)] for m, rows in zip((arm, loaded), numbers, strict=True)]
    return numbers[0], values[1] - values[0], spreads[0] + spreads[1]


def _doubts(left: float, n_degrees: int) -> list[str]:
    if n_degrees > 0 and chi2.sf(left, n_degrees) < _CHANGED:
        return [
            f"the difference is not that of one body on this link: chi-squared is {left:.3g} for {n_degrees} "
            "degrees of freedom; the arm itself has changed, or its standard errors are too small"
        ]
    return []


def _undetermined(matrix: np.ndarray) -> np.ndarray:
    """(10,) whether each parameter changes along directions that do not affect the torques."""
    _, sizes, directions = np.linalg.svd(matrix)
    sizes = np.concatenate([sizes, np.zeros(len(directions) - len(sizes))])
    hidden = directions[sizes < 1e-9 * sizes.max()]
    return np.sum(hidden**2, axis=0) > _DETERMINED


def _body(matrix: np.ndarray, difference: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, float]:
    """The body that fits the difference best, and χ²."""
    alone = KinematicTree((Joint("load", "load", "revolute", -1, np.eye(3), np.zeros(3), np.eye(3)[2]),))
    terms = inertial_terms(alone)
    base = BaseParameters(terms, tuple(range(len(difference))), matrix)
    fitted = fit_bodies(alone, base, difference, covariance)
    return fitted.values, fitted.price


def _derived(parameters: np.ndarray) -> np.ndarray:
    """(10,) mass, centre, and inertia about the centre."""
    centre, about = about_centre(parameters)
    return np.concatenate([parameters[:1], centre, about[np.triu_indices(3)]])
