"""Do some trials follow the law with other coefficients?  A table may hold two machines, or two loads.

The coefficients of every trial are fitted by themselves (`leastaction.selection.groups`), and trials whose
coefficients agree form a group. The groups are named if the equations hold with them and there are at most
half as many of them as trials: a law that is imitated may need other coefficients for every motion.

Cost: where the equations do not hold, a search in the longest trial; if they hold there, a search in each of
the others and some fits of all.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from leastaction.diagnosis.smooth_changes import doubts_about_the_form
from leastaction.estimation.fit import Fit
from leastaction.estimation.groups import GroupedColumns, Grouping, GroupTerm, laws
from leastaction.findings import Finding, find
from leastaction.selection.groups import compared, law_alone
from leastaction.selection.progress import silent
from leastaction.selection.search_state import Search, explains
from leastaction.selection.significance import chi_square_cutoff

__all__ = ["differences", "differing_trials"]

_MOST_TRIALS = 20  # each is searched by itself


def differing_trials(search: Search) -> list[Finding]:
    """Name the terms whose coefficients differ, and the groups of trials; nothing if none do."""
    fit, data = search.found, search.problem.trajectories
    names = data.names
    if not (2 < len(names) <= _MOST_TRIALS and fit.converged and np.isfinite(fit.evidence)):
        return []
    if search.problem.ranges or search.problem.sensors:  # groups have no numbers beside coefficients
        return []
    search = replace(search, report=silent)
    trials = range(len(names))
    laws_of: dict[int, Fit] = {}
    for k in sorted(trials, key=lambda k: (data[k].driven, len(data[k].t)), reverse=True):
        laws_of[k] = law_alone(search, data.select([k]), fit.grid.knots_per_second)
        if len(laws_of) == 1 and not explains(laws_of[k], laws_of[k].evidence):
            return []
    apart = compared(search, Grouping(names, tuple(trials)), search, [laws_of[k] for k in trials])
    groups = _alike(apart, len(names), search.relevance) if explains(apart, apart.evidence) else []
    if not 1 < len({*groups}) <= (len(names) + 1) // 2:
        return []
    labels = [chr(ord("A") + list(dict.fromkeys(groups)).index(g)) for g in groups]
    best = compared(search, Grouping.of(labels, data), search)
    if not explains(best, best.evidence) or doubts_about_the_form(best, search.relevance):
        return []
    return [] if _sorted_by_amplitude(best) else _as_finding(best)


def _alike(fit: Fit, n_trials: int, relevance: float) -> list[int]:
    """The group of each trial: in a group, coefficients differ by no more than chance and equation error."""
    own = [fit.problem.terms[m] for m in fit.structure]
    differing, _ = differences(fit)
    if not differing:
        return [0] * n_trials
    # deviations of every trial from the first, and where their columns are
    columns = np.full((n_trials, len(differing)), -1)
    for place, term in enumerate(own):
        if isinstance(term, GroupTerm):
            columns[term.group, differing.index(term.whole.text)] = place
    values = np.append(fit.estimates, 0.0)[columns]
    spread = np.pad(fit.covariance, (0, 1))
    limit = chi_square_cutoff(len(differing), n_trials * (n_trials - 1) // 2) + fit.relevant_gain(relevance)
    distances = np.zeros((n_trials, n_trials))
    for i in range(n_trials):
        for j in range(i):
            a, b = columns[i], columns[j]
            shared = spread[np.ix_(a, b)]
            covariance = spread[np.ix_(a, a)] + spread[np.ix_(b, b)] - shared - shared.T
            step = values[i] - values[j]
            distances[i, j] = distances[j, i] = step @ np.linalg.pinv(covariance, hermitian=True) @ step
    found: list[int] = fcluster(linkage(squareform(distances), "complete"), limit, "distance").tolist()
    return found


def _sorted_by_amplitude(fit: Fit) -> bool:
    """Whether free motions of one coordinate have other amplitudes in every group.

    Each has one energy, and an imitation that is right there is another law for every energy.
    """
    data = fit.problem.trajectories
    if data.n_dof > 1 or data.driven:
        return False
    sizes = [float(np.ptp(curve)) for curve in fit.curves()]
    spans = sorted((min(own), max(own)) for own in ([sizes[k] for k in trials] for trials, *_ in laws(fit)))
    return all(low > high for (_, high), (low, _) in pairwise(spans))


def _as_finding(fit: Fit) -> list[Finding]:
    """The terms whose coefficients differ between the groups of a fit."""
    differing, figures = differences(fit)
    groups, names = [trials for trials, *_ in laws(fit)], fit.problem.trajectories.names
    sorted_trials = {
        "trials": [names[k] for trials in groups for k in trials],
        "places": [place for place, trials in enumerate(groups) for _ in trials],
    }
    return [find("trials-differ", differing, **figures, **sorted_trials)] if differing else []


def differences(fit: Fit) -> tuple[list[str], dict[str, list[Any]]]:
    """Terms whose coefficients differ between the groups of a fit, and the figures of these differences."""
    columns = fit.problem.candidates
    assert isinstance(columns, GroupedColumns)
    rows = zip(fit.structure, fit.estimates.tolist(), fit.standard_errors.tolist(), strict=True)
    own = [(fit.problem.terms[k], *numbers) for k, *numbers in rows]
    differing = [(term, *numbers) for term, *numbers in own if isinstance(term, GroupTerm)]
    subject = list(dict.fromkeys(term.whole.text for term, *_ in differing))
    shared = [term.text for term, *_ in own if not isinstance(term, GroupTerm)]
    return subject, {
        "groups": list(columns.names),
        "terms": [term.text for term, *_ in differing],
        "differences": [value for _, value, _ in differing],
        "standard_errors": [error for *_, error in differing],
        "alike": [text for text in shared if text not in subject],
    }
