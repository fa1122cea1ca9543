"""Was something left out that the user did not ask about?  Friction, and known coefficients that are wrong.

Both are likelihood-ratio tests on the final fit, by the means of the selection: friction that is not among
the candidates is scored beside the chosen terms, and a known coefficient is set free to see whether fewer
terms then say the same.
"""

from __future__ import annotations

import copy

import numpy as np

from leastaction._euler_lagrange import EulerLagrange
from leastaction._fit.gauss_newton import score_candidates
from leastaction._fit.workspace import Workspace
from leastaction._library import Library
from leastaction._selection import Refiner, Selection
from leastaction._subsets import QuadraticModel

__all__ = ["hidden_friction", "wrong_known"]

_DECISIVE = 30.0  # −2 log likelihood: one in ten million by chance
_BETTER = 10.0  # the same, beyond the price of every term
_RELEVANT = 0.05  # share of the equation error's variance, as in the selection
_MOST_RELEASED = 3


def hidden_friction(workspace: Workspace, selection: Selection) -> list[str]:
    """Viscous friction that is not among the candidates and would explain much of the equation error."""
    structure, columns = selection.structure, workspace.columns
    given = {term.expr.as_coeff_Mul()[1] for term in columns.terms if term.kind == "dissipation"}
    library = Library(
        [columns.terms[0].text],
        columns.coordinates,
        dissipation=[f"{name}_dot**2/2" for name in columns.coordinates],
    )
    tested = [term for term in library.dissipation if term.expr.as_coeff_Mul()[1] not in given]
    if not tested:
        return []
    free = [columns.terms[m] for m in structure.members]
    candidates = EulerLagrange([*free, *tested], columns.coordinates)
    physics, _ = workspace.physics(structure.members)
    quadratic = score_candidates(workspace.observations, physics, structure.fit, candidates)
    here = np.concatenate([structure.estimates, np.zeros(len(tested))])
    model, base = QuadraticModel(quadratic.matrix, quadratic.gradient, here), tuple(range(len(free)))
    cost = model.best({base}, 1)[0].cost
    threshold = _DECISIVE + _RELEVANT * float(structure.fit.weights.slack.sum())
    out = []
    for k, term in enumerate(tested, start=len(free)):
        gain = cost - model.best({(*base, k)}, 1)[0].cost
        if gain < threshold:
            continue
        value = model.solution((*base, k))[k]
        (rate,) = term.expr.free_symbols
        if value > 0.0:
            out.append(
                f"friction seems to act on {rate} (coefficient about {value:.2g}, -2 log likelihood "
                f"{gain:.0f}): give {term.text} as a candidate for dissipation"
            )
        else:
            out.append(
                f"energy seems to be fed in along {rate} (friction of about {value:.2g}): check the sign of "
                "forces and of known coefficients, and whether a driving force is missing"
            )
    return out


def wrong_known(workspace: Workspace, selection: Selection) -> list[str]:
    """Known coefficients without which the motion is explained better, or by fewer terms.

    Where no force acts and one coefficient is known there is nothing to test: it sets the scale.
    """
    known = np.flatnonzero(~np.isnan(workspace.known))
    if not known.size or (workspace.forces is None and known.size < 2):
        return []
    structure = selection.structure
    refiner = Refiner(workspace, lambda stage, details: None)
    before, out = refiner.value(structure), []
    for k in known[:_MOST_RELEASED]:
        released = copy.copy(workspace)
        released.known = workspace.known.copy()
        released.known[k] = np.nan
        other = Refiner(released, lambda stage, details: None)
        members = tuple(sorted((*structure.members, int(k))))
        found = other.refine(released.fit(members, structure.start))
        gain = 2.0 * (other.value(found) - before)
        if not gain > _BETTER:
            continue
        value, text = found.coefficients[k], workspace.columns.terms[int(k)].text
        fewer = len(structure.members) + 1 - len(found.members)
        scaled = workspace.forces is not None and value / workspace.known[k] > 0.0
        units = f", or the forces are {value / workspace.known[k]:.3g} times too large" if scaled else ""
        out.append(
            f"the known coefficient of {text} may be wrong: set free it becomes {value:.3g} instead of "
            f"{workspace.known[k]:.3g}, and "
            + (f"{fewer} terms fewer" if fewer > 1 else "the other terms")
            + f" explain the motion better{units}"
        )
    return out
