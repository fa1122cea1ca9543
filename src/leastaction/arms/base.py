"""Base parameters of an arm, estimates of all parameters with priors, and physically consistent bodies.

Torques determine only some combinations of the inertial parameters, the base parameters (Gautier & Khalil
1990, IEEE Transactions on Robotics and Automation 6:368)

    β = B x,        B = (1  K) after sorting,

where x holds all parameters.  A parameter whose column is a combination of earlier columns is left out; its
contribution moves to their parameters.

A body can exist if its pseudo-inertia, the 4 × 4 matrix of the second moments of its mass, is positive
definite (Wensing, Kim & Slotine 2018, IEEE Robotics and Automation Letters 3:60). A distance between two such
matrices that contains log |P| keeps P positive definite and makes the problem convex (Lee, Wensing & Park
2020, IEEE Transactions on Robotics 36:348).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from leastaction.errors import InputError
from leastaction.library.tree import KinematicTree
from leastaction.mechanics import Points
from leastaction.mechanics.arm_columns import ArmColumns
from leastaction.mechanics.arm_terms import EXTRA, ArmTerm

__all__ = [
    "BALL",
    "TREE_SHARE",
    "BaseParameters",
    "Bodies",
    "Posterior",
    "Row",
    "assumed",
    "can_exist",
    "find_base",
    "fit_bodies",
    "inertial_prior",
    "table_of",
    "tree_prior",
    "with_prior",
    "with_tree",
]

TREE_SHARE = 0.3
"""Standard deviation of the tree's inertias, as a share of each link's mass and size."""
_STATES = 40  # random states at which dependences are determined
# Files state angles such as 1.5708.  What depends on the rest of π/2 is undetermined by any log.
_DEPENDENT = 1e-4  # largest independent part of a dependent column, relative to its length
_CLEAN = 1e-5  # smaller parts of a dependent column count as zero, relative to its length
_ROUNDING = 1e-9  # of a coefficient that is whole
_FREE = ("inertia", "rotor", "spring", "offset", *EXTRA)  # kinds among which dependences exist
_MASS, _SIZE = 2.0, 0.1  # kg and m, assumed for a link without inertia in the tree
BALL = f"{_MASS:g} kg and {_SIZE:g} m"
"""The ball that stands for a link without inertia in the tree, in words."""
_ROTOR = 1e-3  # kg m², assumed for a rotor
_NEWTON = 200  # limit on steps
_LEAST = 1e-12  # relative curvature, where terms act alike and have no prior


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The combinations of parameters that torques depend on.

    Attributes
    ----------
    terms : tuple of ArmTerm
        All candidates.
    members : tuple of int
        Candidates that stand for one base parameter each.
    matrix : (n_base, n_terms) array
        B.
    """

    terms: tuple[ArmTerm, ...]
    members: tuple[int, ...]
    matrix: np.ndarray

    def text(self, row: int) -> str:
        """A base parameter in symbols."""
        parts: list[str] = []
        for k in (self.members[row], *np.flatnonzero(self.matrix[row]).tolist()):
            value = float(self.matrix[row, k])
            if parts and k == self.members[row]:
                continue
            size = "" if abs(abs(value) - 1.0) < 1e-12 else f"{abs(value):.4g}*"
            sign = ("-" if value < 0 else "") if not parts else (" - " if value < 0 else " + ")
            parts.append(f"{sign}{size}{self.terms[k].text}")
        return "".join(parts)

    def words(self, row: int, tree: KinematicTree) -> str:
        """A base parameter in words."""
        own = self.members[row]
        others = [k for k in np.flatnonzero(self.matrix[row]).tolist() if k != own]
        text = self.terms[own].said(tree)
        if not others:
            return text
        links = dict.fromkeys(self._place(k, tree) for k in others)
        return f"{text}, with what acts alike in {', '.join(links)}"

    def _place(self, k: int, tree: KinematicTree) -> str:
        term = self.terms[k]
        if term.kind in EXTRA:
            return tree.extra[term.place].text
        return tree.links[term.place] if term.kind == "inertia" else f"joint {tree.coordinates[term.place]}"

    def in_joints(self, values: np.ndarray, inertias: np.ndarray) -> list[tuple[ArmTerm, float]]:
        """Parameters of joints that, beside given inertias of the links, have base parameters as given."""
        given = np.nan_to_num(inertias)
        links = np.array([given[t.place, t.component] if t.kind == "inertia" else 0.0 for t in self.terms])
        of_joints = [k for k, t in enumerate(self.terms) if t.kind != "inertia" and self.matrix[:, k].any()]
        left = values - self.matrix @ links
        found: np.ndarray = np.linalg.lstsq(self.matrix[:, of_joints], left, rcond=None)[0]
        return [(self.terms[k], float(value)) for k, value in zip(of_joints, found, strict=True)]

    def subset(self, kept: Sequence[int]) -> BaseParameters:
        """The base parameters without some members that depend on no others, such as friction."""
        rows = [row for row, k in enumerate(self.members) if k in set(kept)]
        return BaseParameters(self.terms, tuple(self.members[r] for r in rows), self.matrix[rows])


class Row(NamedTuple):
    """One row of the table of parameters."""

    parameter: str
    meaning: str
    value: float
    standard_error: float


def table_of(rows: Sequence[Row]) -> str:
    """Rows as a table in plain text."""
    width = max(len(_short(row.parameter)) for row in rows)
    lines = [f"{'parameter':{width}} {'value':>12} {'std. error':>11}  meaning"]
    lines += [
        f"{_short(r.parameter):{width}} {r.value:>12.5g} {r.standard_error:>11.2g}  {r.meaning}" for r in rows
    ]
    return "\n".join(lines)


def _short(text: str, most: int = 34) -> str:
    """The text of a combination, cut at a sign."""
    if len(text) <= most:
        return text
    return text[: text.rfind(" ", 0, most - 2)].rstrip(" +-") + " ..."


def find_base(
    tree: KinematicTree, terms: Sequence[ArmTerm], unmeasured: Sequence[int] = ()
) -> BaseParameters:
    """The combinations of terms that some motion of the tree can determine.

    Parameters
    ----------
    unmeasured : sequence of int
        Joints whose torques are unknown.
    """
    rng = np.random.default_rng(0)  # the result does not depend on the states
    n = len(tree)
    q, qdot, qddot = rng.uniform(-3.0, 3.0, (3, _STATES, n))
    linear = [k for k, term in enumerate(terms) if term.kind in _FREE]
    columns = ArmColumns(tree, [terms[k] for k in linear], None, unmeasured).strong(Points(q, qdot, qddot))
    columns = columns.reshape(len(linear), -1)
    length = np.linalg.norm(columns, axis=1)
    found: list[int] = []
    basis = np.zeros((0, columns.shape[1]))
    for row, column in enumerate(columns):
        rest = column.copy()
        for _ in range(2):  # a second pass restores orthogonality
            rest -= basis.T @ (basis @ rest)
        if np.linalg.norm(rest) > _DEPENDENT * max(length[row], 1e-3):
            found.append(row)
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
    shares = np.linalg.lstsq(columns[found].T, columns.T, rcond=None)[0]
    shares[np.abs(shares) * length[found, None] < _CLEAN * length] = 0.0
    whole = np.rint(shares)
    shares = np.where(np.abs(shares - whole) < _ROUNDING, whole, shares)
    alone = [k for k, term in enumerate(terms) if term.kind not in _FREE]
    members = sorted([*(linear[row] for row in found), *alone])
    matrix = np.zeros((len(members), len(terms)))
    place = {k: row for row, k in enumerate(members)}
    for row, values in zip(found, shares, strict=True):
        matrix[place[linear[row]], linear] = values
    for k in alone:
        matrix[place[k], k] = 1.0
    return BaseParameters(tuple(terms), tuple(members), matrix)


class Posterior(NamedTuple):
    """All parameters, estimated from base parameters and a prior.

    Attributes
    ----------
    values, standard_errors : (n_terms,) arrays
    from_data : (n_terms,) array
        Share of each that comes from the data: 1 − posterior variance / prior variance.
    """

    values: np.ndarray
    standard_errors: np.ndarray
    from_data: np.ndarray


def with_prior(
    base: BaseParameters, estimates: np.ndarray, covariance: np.ndarray, prior: np.ndarray, spread: np.ndarray
) -> Posterior:
    """All parameters, with independent normal priors of mean ``prior`` and standard deviation ``spread``.

    A parameter with infinite ``spread`` has no prior and must be a base parameter of its own.
    """
    open_ = ~np.isfinite(spread)
    scale = np.where(open_, 1e6 * np.maximum(np.abs(base.matrix.T @ estimates), 1.0), spread)
    gain = base.matrix * scale**2
    inner = gain @ base.matrix.T + covariance
    solved = np.linalg.solve(inner, gain)
    mean = np.where(open_, 0.0, prior)
    values = mean + solved.T @ (estimates - base.matrix @ mean)
    variance = np.clip(scale**2 - np.einsum("bk,bk->k", gain, solved), 0.0, None)
    return Posterior(values, np.sqrt(variance), 1.0 - variance / scale**2)


def with_tree(
    tree: KinematicTree, base: BaseParameters, estimates: np.ndarray, covariance: np.ndarray, share: float
) -> Posterior:
    """All parameters, with the inertias of the tree as priors.

    Raises
    ------
    InputError
        If a link has no inertia in the tree.
    """
    return with_prior(base, estimates, covariance, *tree_prior(tree, base, share))


def tree_prior(
    tree: KinematicTree, base: BaseParameters, share: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(n_terms,) means and standard deviations of all parameters, from the inertias of the tree.

    Parameters without a prior have the mean 0 and an infinite standard deviation.

    Raises
    ------
    InputError
        If a link has no inertia in the tree.
    """
    means, spreads = inertial_prior(tree, share)
    for link, row in zip(tree.links, spreads, strict=True):
        if not np.isfinite(row).all():
            raise InputError(
                f"{link} has no inertia in the tree, so that there is no prior for it; use bodies(), or "
                "tree.with_inertias(...)"
            )
    n = len(base.terms)
    prior, spread = np.zeros(n), np.full(n, np.inf)
    for k, term in enumerate(base.terms):
        if term.kind == "inertia":
            prior[k], spread[k] = means[term.place, term.component], spreads[term.place, term.component]
        elif term.kind in _FREE and k not in base.members:
            reached = spreads if term.kind in EXTRA else spreads[term.place]
            spread[k] = max(float(np.max(reached)), 1e-3)
    return prior, spread


def inertial_prior(tree: KinematicTree, share: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n_links, 10) inertias that the tree states, and standard deviations.

    These are a ``share`` of mass and size, one for all links or (n_links,) of each.
    """
    means = tree.inertias
    spreads = np.full(means.shape, np.inf)
    for i, (row, part) in enumerate(zip(means, np.broadcast_to(share, len(means)), strict=True)):
        if np.isnan(row).any() or row[0] <= 0.0:
            continue
        size = np.sqrt(max((row[4] + row[7] + row[9]) / 2.0 / row[0], 1e-6))
        spreads[i] = part * row[0] * np.array([1.0, *[size] * 3, *[size**2] * 6])
    return np.nan_to_num(means), spreads


def assumed(tree: KinematicTree, share: float) -> tuple[KinematicTree, np.ndarray]:
    """The tree with balls where it states no inertia, and (n_links,) uncertainties: 1 for a ball."""
    missing = np.isnan(tree.inertias[:, 0])
    balls = np.array([_parameters(_prior_body(row)) for row in tree.inertias])
    filled = np.where(missing[:, None], balls, tree.inertias)
    return tree.with_inertias(filled), np.where(missing, 1.0, share)


class Bodies(NamedTuple):
    """Parameters of physically consistent bodies.

    Attributes
    ----------
    values : (n_terms,) array
    price : float
        Increase of χ² of the base parameters.
    """

    values: np.ndarray
    price: float


def fit_bodies(
    tree: KinematicTree, base: BaseParameters, estimates: np.ndarray, covariance: np.ndarray
) -> Bodies:
    """Physically consistent bodies that are nearest to the base parameters.

    Newton's method minimises the convex function

        ½ (B x − β)ᵀ Σ⁻¹ (B x − β) + Σ_links tr(P P₀⁻¹) − log |P| + Σ_rotors r/r₀ − log r,

    where P is the pseudo-inertia of a link, and P₀ that of the tree, or of a ball if the tree states none.
    """
    n = len(tree)
    inertial = [k for k, term in enumerate(base.terms) if term.kind == "inertia"]
    rotors = [k for k, term in enumerate(base.terms) if term.kind == "rotor"]
    values, vectors = np.linalg.eigh(covariance)  # the covariance may be nearly singular
    root = (vectors / np.sqrt(np.maximum(values, 1e-14 * values[-1]))).T
    matrix, target = root @ base.matrix, root @ estimates
    gram, pull = matrix.T @ matrix, matrix.T @ target
    priors = np.array([_prior_body(row) for row in tree.inertias])
    pulled = np.linalg.inv(priors)
    known = dict(zip(base.members, estimates.tolist(), strict=True))
    sizes = np.array([max(known.get(k, 0.0), _ROTOR) for k in rotors])
    x = np.zeros(len(base.terms))
    x[inertial] = np.array([_parameters(body) for body in priors]).ravel()
    x[rotors] = sizes

    def value(x: np.ndarray) -> float:
        bodies = np.array([_pseudo_inertia(row) for row in x[inertial].reshape(n, 10)])
        if np.linalg.eigvalsh(bodies).min() <= 0.0 or np.any(x[rotors] <= 0.0):
            return np.inf
        near = np.einsum("nij,nji->", bodies, pulled) - np.linalg.slogdet(bodies)[1].sum()
        wheels = np.sum(x[rotors] / sizes - np.log(x[rotors]))
        return float(0.5 * np.sum((matrix @ x - target) ** 2) + near + wheels)

    here = value(x)
    for _ in range(_NEWTON):
        gradient, curvature = gram @ x - pull, gram.copy()
        for i, row in enumerate(x[inertial].reshape(n, 10)):
            own = inertial[10 * i : 10 * i + 10]
            turned = np.linalg.inv(_pseudo_inertia(row)) @ _BASIS
            gradient[own] += np.einsum("kij,ji->k", _BASIS, pulled[i]) - np.einsum("kii->k", turned)
            curvature[np.ix_(own, own)] += np.einsum("kij,lji->kl", turned, turned)
        gradient[rotors] += 1.0 / sizes - 1.0 / x[rotors]
        curvature[rotors, rotors] += 1.0 / x[rotors] ** 2
        unused = np.diag(curvature) == 0.0  # friction that was left out
        curvature[unused, unused] = 1.0
        scale = 1.0 / np.sqrt(np.diag(curvature))
        scaled = curvature * np.outer(scale, scale) + _LEAST * np.eye(len(x))
        step = -scale * np.linalg.solve(scaled, scale * gradient)
        promised, share = -float(gradient @ step), 1.0
        while (there := value(x + share * step)) > here - 0.1 * share * promised and share > 1e-10:
            share *= 0.5
        x, gained, here = x + share * step, here - there, there
        if gained < 1e-6:
            break
    return Bodies(x, float(np.sum((matrix @ x - target) ** 2)))


def _prior_body(row: np.ndarray) -> np.ndarray:
    """Pseudo-inertia that the tree states, or that of a ball."""
    ball = _MASS * np.diag([_SIZE**2] * 3 + [1.0])
    if not np.isfinite(row).all():
        return ball
    said = _pseudo_inertia(row)
    return said if np.linalg.eigvalsh(said).min() > 1e-6 * _SIZE**2 * max(row[0], 0.0) else ball


def _pseudo_inertia(row: np.ndarray) -> np.ndarray:
    """(4, 4) second moments of the mass."""
    mass, first, (xx, xy, xz, yy, yz, zz) = row[0], row[1:4], row[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    out = np.empty((4, 4))
    out[:3, :3] = np.trace(inertia) / 2.0 * np.eye(3) - inertia
    out[:3, 3] = out[3, :3] = first
    out[3, 3] = mass
    return out


def _parameters(body: np.ndarray) -> np.ndarray:
    """(10,) inertial parameters of a pseudo-inertia."""
    second = body[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    return np.concatenate([body[3, 3:], body[:3, 3], inertia[np.triu_indices(3)]])


_BASIS = np.array([_pseudo_inertia(row) for row in np.eye(10)])  # the pseudo-inertia is linear


def can_exist(parameters: np.ndarray) -> np.ndarray:
    """Which of (n, 10) inertial parameters are physically consistent: a positive definite pseudo-inertia."""
    return np.array([np.linalg.eigvalsh(_pseudo_inertia(row)).min() > 0.0 for row in parameters])
