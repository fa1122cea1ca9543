"""Searches: what they try first, and what they end with: a fit of its own structure, and its rivals."""

from __future__ import annotations

import time
from itertools import islice, product

import numpy as np
import pytest

import leastaction as la
from leastaction.selection.kinetic_seeds import cheapest_combinations
from set_ups import SET_UPS, fresh, searched
from studies import solve
from studies.case import Case


# ------------------------------------------------ combinations of kinetic terms, the cheapest first
def some_options(seed: int, n: int, most: int):
    """Costs with many ties; some coordinates are held up by a known term, which costs nothing."""
    rng = np.random.default_rng(seed)
    free = iter(rng.permutation(n * most).tolist())
    out = []
    for _ in range(n):
        each = [(int(rng.integers(1, 4)), (next(free),)) for _ in range(int(rng.integers(1, most + 1)))]
        out.append(sorted(each + [(0, ())] * int(rng.integers(0, 2))))
    return out


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_sequence_is_that_of_sorting_all(seed, n):
    options = some_options(seed, n, 5)
    everything = sorted(
        (sum(cost for cost, _ in parts), sum((m for _, m in parts), ())) for parts in product(*options)
    )
    assert list(cheapest_combinations(options)) == [members for _, members in everything]


def test_ten_coordinates_cost_little():
    """8**10 combinations: sorting them all is out of the question."""
    options = [[(1 + c // 2, (8 * i + c,)) for c in range(8)] for i in range(10)]
    begin = time.process_time()
    first = list(islice(cheapest_combinations(options), 60))
    assert time.process_time() - begin < 1.0
    assert len(set(first)) == 60
    assert first[0] == tuple(range(0, 80, 8))
    costs = [sum(1 + m % 8 // 2 for m in members) for members in first]
    assert costs == sorted(costs)
    assert costs[-1] == 10  # 2**10 combinations have the lowest cost


# ------------------------------------------------------------------------- the fit that is reported
@pytest.mark.parametrize("name", SET_UPS)
def test_a_report_equals_a_fresh_fit_of_its_structure(name):
    """Nothing of the search is left in its numbers."""
    search = searched(name)
    fit = search.found
    again = fresh(search)
    assert fit.converged
    assert again.converged
    moved = np.abs(again.estimates - fit.estimates) / fit.standard_errors
    assert moved.max() < 0.05, dict(zip(fit.structure, moved, strict=True))
    np.testing.assert_allclose(fit.coefficients[list(fit.problem.excluded)], 0.0)
    known = fit.problem.is_known
    np.testing.assert_array_equal(fit.coefficients[known], fit.problem.known[known])


# ------------------------------------------------------------------------- structures beside it
@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_small_motion_leaves_rivals_although_terms_that_cancel_the_known_one_fit_best(noise):
    """With small θ cos θ₂ and cos² θ₂ are one; cos² θ₁ alone cancels the known cos θ₁."""
    case = Case("faults", "chaotic_pendulum", noise, "excitation", "compact", 0)
    question, _ = solve.pose(case)
    model = la.discover(question.data, question.library, known=question.known)
    assert model.fit.status == "doubtful"
    assert "competing-structures" in {finding.code for finding in model.fit.findings}
