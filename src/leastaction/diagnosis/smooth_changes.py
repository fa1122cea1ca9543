"""Would a smooth change of the law, of no particular form, explain the data better?

Where a library lacks the law, its terms imitate it along the data, and leave nothing that a test of any one
term must find.  So L is tried with a sum of bumps added,

    δL = Σ_k a_k exp(−Σ_i ((q_i − c_ki) / w_i)²),    or q̇_i² times such a sum, or both,

with centres over the recorded motion and all a_k free.  The quadratic model of the likelihood about the fit
says how far −2 log L falls (for the true law χ²), and what the best a_k would make of the accelerations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate, chain, product

import numpy as np

from leastaction.data.validation import FloatArray
from leastaction.diagnosis.effects import compared_accelerations
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.estimation.shapes import with_tangents
from leastaction.findings import Finding, find
from leastaction.identifiers import names_in_terms
from leastaction.library import Term, make_term
from leastaction.selection.families import looks_imitated
from leastaction.selection.significance import chi_square_cutoff

__all__ = ["SmoothChange", "doubts_about_the_form", "smooth_changes"]

_VISITS = 20_000  # points of the motion that are looked at: its range and its centres need no more
_ENDS = (0.01, 0.99)  # quantiles of the motion that the centres span
_DEPENDENT = 1e-7  # of the greatest eigenvalue: directions that hardly differ from others
_BOTH = "potential and kinetic"


@dataclass(frozen=True)
class SmoothChange:
    """What a smooth change of one kind ("potential", "kinetic", "potential and kinetic") would do.

    Attributes
    ----------
    kind : str
    gain, freedom : float, int
        By how much −2 log likelihood would fall, and degrees of freedom of the change.
    shift, spread : float
        Rms change of q̈, and rms standard deviation of it, relative to q̈, where they are greatest.
    """

    kind: str
    gain: float
    freedom: int
    shift: float
    spread: float

    @property
    def open(self) -> float:
        """Root mean square by which q̈ may be off, relative to it."""
        return float(np.hypot(self.shift, self.spread))


def doubts_about_the_form(fit: Fit, relevance: float, *, exact: bool = False) -> list[Finding]:
    """A change that explains the data better, or accelerations that the data leave open.

    Where equations are ``exact``, but the law looks like an imitation or the motion has one energy, changes
    of both energies of one coordinate count; they may leave q̈ open by 5 %, 19 in 20.
    """
    bound = exact and (looks_imitated(fit) or _one_energy(fit))
    changes = [change for change in smooth_changes(fit) if bound or change.kind != _BOTH]
    for change in changes:
        least = chi_square_cutoff(change.freedom, len(changes)) + fit.relevant_gain(relevance)
        if change.gain > least and change.shift > DIAGNOSIS.form_matters:
            figures = {"gain": change.gain, "freedom": change.freedom, "shift": change.shift}
            return [find("form-imitated", kind=change.kind, **figures, family=[], numbers=[])]
        if change.open > DIAGNOSIS.form_open / (DIAGNOSIS.form_bound if change.kind == _BOTH else 1.0):
            return [find("form-open", kind=change.kind, open=change.open)]
    return []


def _one_energy(fit: Fit) -> bool:
    """Whether the motion is one recording of one conservative coordinate, which has one energy throughout."""
    # kinetic and potential energy may then change together and leave this motion as it is
    problem, forces = fit.problem, fit.grid.forces
    single = len(problem.coordinates) == len(problem.trajectories) == 1
    return single and forces is None and all(problem.terms[k].kind == "lagrangian" for k in fit.structure)


def smooth_changes(fit: Fit) -> list[SmoothChange]:
    """Changes of the potential and, of one coordinate, of the kinetic energy and of both."""
    if not (fit.converged and np.isfinite(fit.evidence)):
        return []
    names, kinds = fit.problem.coordinates, {"potential": list(_bumps(fit, DIAGNOSIS.bumps_alone, ""))}
    if len(names) == 1:
        kinds["kinetic"] = list(_bumps(fit, DIAGNOSIS.bumps_each, f"{names[0]}_dot**2*"))
    return list(_changes(fit, {kind: terms for kind, terms in kinds.items() if terms}))


def _bumps(fit: Fit, count: int, factor: str) -> Iterator[Term]:
    """Bumps over the motion: of the plane for two coordinates, along each for others."""
    names = fit.problem.coordinates
    motion = np.stack(fit.points(_VISITS).columns[: len(names)], axis=1)
    for group in [(0, 1)] if len(names) == 2 else [(i,) for i in range(len(names))]:
        number = DIAGNOSIS.bumps_each if len(group) == 2 else count
        ends = np.quantile(motion[:, group], _ENDS, axis=0)
        widths = DIAGNOSIS.bump_width * (ends[1] - ends[0]) / (number - 1)
        text = "".join(f"-(({names[i]}-{{c{i}}})/{{w{i}}})**2" for i in group)
        template = make_term(f"{factor}exp({text})", names_in_terms(names))
        width = {f"w{i}": w for i, w in zip(group, widths.tolist(), strict=True)}
        places = [np.linspace(float(a), float(b), number).tolist() for a, b in zip(*ends, strict=True)]
        for centre in product(*places):
            if np.mean(np.all(np.abs(motion[:, group] - centre) < widths, axis=1)) > DIAGNOSIS.bump_visited:
                yield template.at(width | {f"c{i}": c for i, c in zip(group, centre, strict=True)})


def _changes(fit: Fit, kinds: Mapping[str, list[Term]]) -> Iterator[SmoothChange]:
    """Of each kind, and of all together where there are several; all are scored at once."""
    names = fit.problem.shapes_of(fit.structure)  # they can move
    wide, _ = with_tangents(fit.problem, fit.structure, fit.coefficients, names)
    own = [wide.terms[k] for k in (*fit.structure, *range(len(fit.problem.terms), len(wide.terms)))]
    n, ends = len(own), list(accumulate(map(len, kinds.values()), initial=len(own)))
    places = {kind: range(a, b) for kind, a, b in zip(kinds, ends[:-1], ends[1:], strict=True)}
    if len(kinds) > 1:
        places[_BOTH] = range(n, ends[-1])
    candidates = fit.problem.candidates.of([*own, *chain(*kinds.values())])
    quadratic = fit.score(candidates)
    scale = 1.0 / np.sqrt(np.clip(np.diag(quadratic.matrix), 1e-300, None))
    matrix, gradient = quadratic.matrix * np.outer(scale, scale), quadratic.gradient * scale
    points, size = compared_accelerations(fit)
    change = -np.linalg.solve(fit.mass_matrix(points), candidates.strong(points).transpose(2, 1, 0))
    change[:, list(fit.problem.prescribed)] = 0.0  # they move as they do
    before, root = _explained(matrix[:n, :n], gradient[:n])
    for kind, changed in places.items():
        part = [*range(n), *changed]
        after, wider = _explained(matrix[np.ix_(part, part)], gradient[part])
        step, moves = -wider @ (wider.T @ gradient[part]), change[..., part] * scale[part]
        shift = np.sqrt(np.mean((moves @ step) ** 2, axis=0)) / size
        spread = np.sqrt(np.mean(np.sum((moves @ wider) ** 2, axis=2), axis=0)) / size
        worst = int(np.argmax(np.nan_to_num(np.hypot(shift, spread), posinf=0.0)))
        freedom = max(wider.shape[1] - root.shape[1], 1)
        yield SmoothChange(kind, after - before, freedom, float(shift[worst]), float(spread[worst]))


def _explained(matrix: FloatArray, gradient: FloatArray) -> tuple[float, FloatArray]:
    """gᵀ A⁻¹ g and a root R of A⁻¹ = R Rᵀ, over the directions that differ."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > _DEPENDENT * values.max(initial=0.0)  # there may be no free term
    root = vectors[:, kept] / np.sqrt(values[kept])
    return float(np.sum((root.T @ gradient) ** 2)), root
