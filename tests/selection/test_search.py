"""Searches: what they try first, and what they end with: a fit of its own structure, and its rivals."""

from __future__ import annotations

import time
from itertools import islice, product

import numpy as np
import pytest

import leastaction as la
from leastaction.selection.kinetic_seeds import cheapest_combinations
from leastaction.selection.likelihood_search import QuadraticModel, search_subsets, term_penalty
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
def test_small_motion_leaves_rivals_although_terms_that_cancel_the_known_one_fit_best():
    """With small θ cos θ₂ and cos² θ₂ are one; cos² θ₁ alone cancels the known cos θ₁."""
    case = Case("faults", "chaotic_pendulum", 0.1, "excitation", "compact", 0)
    question, _ = solve.pose(case)
    model = la.discover(question.data, question.library, known=question.known)
    assert model.fit.status == "doubtful"
    assert "competing-structures" in {finding.code for finding in model.fit.findings}


# ---------------------------------------------------------------------------- steps to neighbouring supports
def model_of(n: int, seed: int, correlated: float = 0.0, dearest: float = 0.0) -> QuadraticModel:
    rng = np.random.default_rng([n, seed])
    x = rng.standard_normal((3 * n, n))
    x[:, 1::2] += correlated * x[:, : n - n % 2 : 2]
    x *= 10.0 ** rng.uniform(-3, 3, n)
    about = rng.standard_normal(n) / np.linalg.norm(x, axis=0) * 30.0
    about[rng.random(n) < 0.5] = 0.0
    gradient = 3.0 * x.T @ rng.standard_normal(3 * n)
    return QuadraticModel(x.T @ x, gradient, about, rng.uniform(-dearest, dearest, n))


@pytest.mark.parametrize("size", [0, 1, 4, 9])
@pytest.mark.parametrize("correlated", [0.0, 100.0])
@pytest.mark.parametrize(("seed", "dearest"), [(0, 0.0), (1, 0.0), (2, 20.0)])
def test_prices_of_all_steps_equal_a_solve_for_each(size, correlated, seed, dearest):
    model = model_of(11, seed, correlated, dearest)
    members = tuple(sorted(np.random.default_rng(seed).permutation(11)[:size].tolist()))
    near = model.neighbours(members)

    def cost(support) -> float:
        return float(model.costs(np.array([sorted(support)], dtype=int))[0])

    rest = [k for k in range(11) if k not in members]
    atol = 1e-6 * max(1.0, abs(cost(members)))
    np.testing.assert_allclose(near.added[rest], [cost((*members, k)) for k in rest], rtol=1e-6, atol=atol)
    assert np.isinf(near.added[list(members)]).all()
    without = [[m for m in members if m != out] for out in members]
    np.testing.assert_allclose(near.removed, [cost(w) for w in without], rtol=1e-6, atol=atol)
    for row, fewer in zip(near.swapped, without, strict=True):
        np.testing.assert_allclose(row[rest], [cost((*fewer, k)) for k in rest], rtol=1e-6, atol=atol)
        assert np.isinf(row[list(members)]).all()


def test_surcharges_decide_between_equals():
    """Two columns that are the same: the support with the shorter name is the cheaper one."""
    x = np.random.default_rng(0).standard_normal((40, 4))
    x[:, 3] = x[:, 1]
    for cheap, dear in ((1, 3), (3, 1)):
        surcharges = np.where(np.arange(4) == dear, 2.0, 0.0)
        model = QuadraticModel(x.T @ x, -50.0 * x.T @ x[:, 1], np.zeros(4), surcharges)
        best = min(search_subsets(model, (0,), 8.0).values(), key=lambda level: level[0].criterion(8.0))[0]
        assert best.members == (cheap,)


def test_the_ridge_counts_where_coefficients_are_many_standard_errors():
    """Without noise a coefficient may be 1e7 of its standard errors: 1e-11 of its square is not small."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((30, 6))
    x[:, 1] += 30.0 * x[:, 0]
    model = QuadraticModel(1e14 * x.T @ x, 1e7 * x.T @ rng.standard_normal(30), rng.standard_normal(6))
    near = model.neighbours((0, 2, 5))
    exact = model.costs(np.array([[2, 5], [0, 5], [0, 2]]))
    np.testing.assert_allclose(near.removed, exact, rtol=1e-7)
    exact = model.costs(np.array([[0, 1, 2, 5], [0, 2, 3, 5], [0, 2, 4, 5]]))
    np.testing.assert_allclose(near.added[[1, 3, 4]], exact, rtol=1e-7, atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_levels_are_closed_under_swaps(seed):
    """No swap of one member betters the best support of any size: brute force over all of them."""
    model = model_of(14, seed, 3.0)
    levels = search_subsets(model, (0, 3, 5), term_penalty(100, 14))
    for size, level in levels.items():
        best = level[0]
        swaps = [
            [*(m for m in best.members if m != out), k]
            for out in best.members
            for k in range(14)
            if k not in best.members
        ]
        if swaps:
            assert model.costs(np.sort(swaps, axis=1)).min() >= best.cost - 2e-3, size
        assert [c.cost for c in level] == sorted(c.cost for c in level)
        assert len({c.members for c in level}) == len(level)
