"""Leave out dissipation with a negative coefficient: friction cannot feed energy in.

Such a candidate is ruled out in the problem itself, so that no later fit or search holds it. What comes in
for it must be relevant, too.

Cost: a fit, and a search on its quadratic model, for each round.
Without it (`docs/ablations.md`) a machine that is fed energy is ok, with negative friction.
"""

from __future__ import annotations

import numpy as np

from leastaction.estimation.fit import Fit
from leastaction.library import has_direction
from leastaction.selection.likelihood_refinement import refine
from leastaction.selection.search_state import Search
from leastaction.selection.significance import normal_cutoff
from leastaction.selection.strategies import irrelevant_terms

__all__ = ["negative_friction", "run"]

_ROUNDS = 4  # at most, each with fits
_STATES = 2000  # along the motion, at which power is taken
_ROUNDING = 1e-9  # of the greatest power


def run(search: Search) -> Search:
    """Exclude negative friction until there is none; those significantly negative are remembered."""
    fit, feeding = search.found, search.feeding
    while fit.usable:
        negative = negative_friction(fit)
        if not negative:
            break
        certain = normal_cutoff(len(negative))
        if _feeds(fit):
            feeding += tuple(m for m, z in negative.items() if -z > certain)
        grid = fit.grid.posed(fit.problem.excluding(list(negative)))
        structure = fit.structure.without(negative)
        # equations exact with the term may not be so without it: those weights are no start
        noise = fit.weights.noise_std[: fit.grid.observations.n_dof]
        start = grid.start(structure, fit.control_points, fit.coefficients, noise)
        fit = refine(grid.fit(structure, start), search.report, _ROUNDS)
    found = search.now(fit, feeding=feeding)
    return found if fit.problem is search.found.problem else irrelevant_terms.run(found)


def negative_friction(fit: Fit) -> dict[int, float]:
    """Candidates of dissipation that cannot be: those with a negative coefficient → their z.

    One that says by how much directions differ may be negative, as long as friction as a whole dissipates
    in both: z is that of its power in the direction where it is less.
    """
    members = [m for m in fit.structure if fit.problem.terms[m].kind == "dissipation"]
    sided = [m for m in members if has_direction(fit.problem.terms[m])]
    z = dict(zip(fit.structure, fit.z.tolist(), strict=True))
    out = {m: z[m] for m in members if m not in sided and z[m] < 0.0}
    if sided and not out:
        index, power = [list(fit.structure).index(m) for m in members], _powers(fit, members)
        covariance = fit.covariance[np.ix_(index, index)]
        for m in sided:
            sign = np.sign(power[members.index(m)])
            means = [power[:, sign == s].mean(axis=1) for s in (-1.0, 1.0) if np.any(sign == s)]
            scores = [
                a @ fit.estimates[index] / max(float(np.sqrt(a @ covariance @ a)), 1e-300) for a in means
            ]
            if min(scores) < -normal_cutoff(2 * len(sided)):
                out[m] = float(min(scores))
    return out


def _powers(fit: Fit, members: list[int]) -> np.ndarray:
    """(n_members, n_points) what friction with a coefficient of one takes up along the motion."""
    points = fit.points(_STATES)
    rates = np.stack(points.columns[points.n_dof : 2 * points.n_dof])
    return np.einsum("kip,ip->kp", fit.problem.candidates.strong(points, members), rates)


def _feeds(fit: Fit) -> bool:
    """Whether friction as a whole feeds energy in somewhere: an excess at low speed may be negative."""
    members = [m for m in fit.structure if fit.problem.terms[m].kind == "dissipation"]
    power = fit.coefficients[members] @ _powers(fit, members)
    return bool(power.min() < -_ROUNDING * np.abs(power).max())
