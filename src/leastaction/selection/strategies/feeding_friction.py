"""Leave out dissipation with a negative coefficient: friction cannot feed energy in.

Such a candidate is ruled out in the problem itself, so that no later fit or search holds it. What comes in
for it must be relevant, too.

Cost: a fit, and a search on its quadratic model, for each round.
Without it (`docs/ablations.md`) a machine that is fed energy is ok, with negative friction.
"""

from __future__ import annotations

from leastaction.estimation.fit import Fit
from leastaction.selection.likelihood_refinement import refine
from leastaction.selection.search_state import Search
from leastaction.selection.significance import normal_cutoff
from leastaction.selection.strategies import irrelevant_terms

__all__ = ["negative_friction", "run"]

_ROUNDS = 4  # at most, each with fits


def run(search: Search) -> Search:
    """Exclude negative friction until there is none; those significantly negative are remembered."""
    fit, feeding = search.found, search.feeding
    while fit.usable:
        negative = negative_friction(fit)
        if not negative:
            break
        certain = normal_cutoff(len(negative))
        feeding += tuple(m for m, z in negative.items() if -z > certain)
        grid = fit.grid.posed(fit.problem.excluding(list(negative)))
        structure = fit.structure.without(negative)
        # what held to rounding with it may not without: at those weights a fit ends anywhere
        noise = fit.weights.noise_std[: fit.grid.observations.n_dof]
        start = grid.start(structure, fit.control_points, fit.coefficients, noise)
        fit = refine(grid.fit(structure, start), search.report, _ROUNDS)
    found = search.now(fit, feeding=feeding)
    return found if fit.problem is search.found.problem else irrelevant_terms.run(found)


def negative_friction(fit: Fit) -> dict[int, float]:
    """Candidates of dissipation with a negative coefficient → their z."""
    friction = [fit.problem.terms[m].kind == "dissipation" for m in fit.structure]
    return {m: z for m, z, f in zip(fit.structure, fit.z, friction, strict=True) if f and z < 0.0}
