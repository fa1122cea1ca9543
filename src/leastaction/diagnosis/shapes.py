"""Whether the data determine the shape parameters of a fit, and which laws with other numbers they allow."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from math import comb

import numpy as np

from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit, ShapeEstimate
from leastaction.findings import Finding, find
from leastaction.selection.other_numbers import differing_terms
from leastaction.selection.significance import chi_square_cutoff

__all__ = ["chance", "doubts_about_shapes", "laws_in_play"]

_AT_END = 1e-6  # of the range


def doubts_about_shapes(fit: Fit) -> list[Finding]:
    """Parameters that are open, at the end of what the user allowed, or still moving.

    One that still moves far from where the data could tell it is open.
    """
    found = fit.shapes
    if found is None:
        return []
    out: list[Finding] = []
    for k, (name, value, error) in enumerate(
        zip(found.names, found.values.tolist(), found.standard_errors.tolist(), strict=True)
    ):
        where = fit.problem.ranges[name]
        size = 0.5 * (where.high - where.low) if where.spacing == "linear" else abs(value)
        if where.bounded and min(value - where.low, where.high - value) <= _AT_END * (where.high - where.low):
            out.append(find("shape-at-bound", name, value=value, low=where.low, high=where.high))
            continue
        # exp(−a x) of a small a, or 1/|x − p| of a far p, is a sum of few powers
        most = DIAGNOSIS.shape_far_log if where.spacing == "log" else DIAGNOSIS.shape_far
        far = abs(where.share(value) - 0.5) > most
        if not found.settled and not far:
            out.append(find("shape-not-settled", name, value=value))
        elif not found.settled or not error < DIAGNOSIS.indistinct * size:
            ends = {"low": where.low, "high": where.high} if far else {}
            other = _partner(fit, found, k)
            out.append(
                find("shape-undetermined", name, value=value, standard_error=error, with_it=other, **ends)
            )
    return out


def _partner(fit: Fit, found: ShapeEstimate, k: int) -> str:
    """The term or parameter that is most correlated with a parameter; empty if none is."""
    spread = np.sqrt(np.clip(np.diag(found.covariance), 1e-300, None))
    place = len(fit.structure) + k
    together = np.abs(found.covariance[place] / (spread[place] * spread))
    together[place] = 0.0
    best = int(np.argmax(together))
    if not together[best] > DIAGNOSIS.one_and_the_same:
        return ""
    names = [fit.problem.terms[m].offered for m in fit.structure] + list(found.names)
    return names[best]


def laws_in_play(fit: Fit, others: Sequence[Fit]) -> Iterator[tuple[Fit, list[int], list[int]]]:
    """Laws with other shape parameters that the data do not exclude.

    Yields each with the terms that only the fit has and those that only the law has; a term with another
    number is another term. By chance, a law loses no more than the fit's own terms gain, see
    `rival_warnings`. A law with more parameters than the fit is left out.
    """
    for other in others:
        mine, theirs = differing_terms(fit, other), differing_terms(other, fit)
        larger = other.problem.parameters_of(other.structure) > fit.problem.parameters_of(fit.structure)
        if larger or not (mine and theirs and other.converged):
            continue
        if 2.0 * (fit.evidence - other.evidence) < chance(fit, mine):
            yield other, mine, theirs


def chance(fit: Fit, members: Collection[int]) -> float:
    """−2 log likelihood that terms of a fit, with their shape parameters, gain by chance."""
    count, outside = len(members), fit.problem.free.size - len(fit.structure)
    numbers = {name for m in members for name in fit.problem.terms[m].shapes}
    return chi_square_cutoff(count + len(numbers), comb(max(outside, count), count))
