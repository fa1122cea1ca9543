"""Was something left out that the user did not ask about?  Friction, late forces, wrong known coefficients.

All are likelihood-ratio tests on the final fit, by the means of the selection: friction that is not among
the candidates is scored beside the chosen terms, and so is what a delay of the forces would leave; a known
coefficient is set free to see whether fewer terms then say the same.
"""

from __future__ import annotations

import numpy as np

from leastaction._euler_lagrange import EulerLagrange
from leastaction._fit.forces import WithPushes
from leastaction._fit.gauss_newton import score_candidates
from leastaction._fit.workspace import StructureFit, Workspace
from leastaction._library import Library
from leastaction._refinement import silent
from leastaction._selection import Refiner, Selection
from leastaction._subsets import QuadraticModel

__all__ = ["hidden_friction", "late_forces", "wrong_known"]

_DECISIVE = 30.0  # −2 log likelihood: one in ten million by chance
_BETTER = 10.0  # the same, beyond the price of every term
_RELEVANT = 0.05  # share of the equation error's variance, as in the selection
_MOST_RELEASED = 3
_HALF = 0.15  # of a sample


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
    out = []
    for term, (gain, value) in zip(tested, _beside(workspace, structure, candidates), strict=True):
        if not gain:
            continue
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


class _Late:
    """What forces that act later leave in the equations: f(t − τ) ≈ f − τ ḟ."""

    def __init__(self, rates: np.ndarray) -> None:
        self.rates = rates

    def __len__(self) -> int:
        return 1

    def on(self, intervals: slice, n_dof: int) -> np.ndarray:
        return self.rates[intervals].transpose(2, 1, 0).reshape(1, n_dof, -1)


def late_forces(workspace: Workspace, selection: Selection) -> list[str]:
    """Forces that act later, or earlier, than their times say."""
    structure = selection.structure
    if workspace.force_rates is None:
        return []
    chosen = workspace.columns.subset(structure.members)
    ((gain, delay),) = _beside(workspace, structure, WithPushes(chosen, _Late(workspace.force_rates)))
    if not gain:
        return []
    held = abs(delay / workspace.trajectories.sampling_interval - 0.5) < _HALF
    when = "later" if delay > 0.0 else "earlier"
    hint = ", half a sample (are they held from one sample to the next?)" if held else ""
    return [
        f"the forces seem to act about {1e3 * abs(delay):.2g} ms {when} than recorded{hint}: find the delay "
        f"with la.delay.estimate, or give --force-delay (-2 log likelihood {gain:.0f})"
    ]


def _beside(
    workspace: Workspace, structure: StructureFit, candidates: EulerLagrange
) -> list[tuple[float, float]]:
    """(gain, coefficient) of each candidate after the chosen terms; no gain unless it is decisive."""
    physics, _ = workspace.physics(structure.members)
    quadratic = score_candidates(workspace.observations, physics, structure.fit, candidates)
    chosen = len(structure.members)
    here = np.concatenate([structure.estimates, np.zeros(len(candidates) - chosen)])
    model, base = QuadraticModel(quadratic.matrix, quadratic.gradient, here), tuple(range(chosen))
    cost = model.best({base}, 1)[0].cost
    threshold = _DECISIVE + _RELEVANT * float(structure.fit.weights.slack.sum())
    out = []
    for k in range(chosen, len(candidates)):
        gain = cost - model.best({(*base, k)}, 1)[0].cost
        out.append((gain if gain >= threshold else 0.0, float(model.solution((*base, k))[k])))
    return out


def wrong_known(workspace: Workspace, selection: Selection) -> list[str]:
    """Known coefficients without which the motion is explained better, or by fewer terms.

    Where no force acts and one coefficient is known there is nothing to test: it sets the scale.
    """
    known = np.flatnonzero(~np.isnan(workspace.known))
    if not known.size or (workspace.forces is None and known.size < 2):
        return []
    structure = selection.structure
    before, out = Refiner(workspace, silent).value(structure), []
    for k in known[:_MOST_RELEASED]:
        released = workspace.changed(np.where(np.arange(workspace.known.size) == k, np.nan, workspace.known))
        other = Refiner(released, silent)
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
