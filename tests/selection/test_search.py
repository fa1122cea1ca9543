"""Searches: what they try first, and what they end with: a fit of its own structure, and its rivals."""

from __future__ import annotations

import time
from itertools import combinations, islice, product

import numpy as np
import pytest
import scipy.linalg

import leastaction as la
from leastaction import systems
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.selection.kinetic_seeds import cheapest_combinations
from leastaction.selection.likelihood_search import QuadraticModel, search_subsets, term_penalty
from leastaction.selection.weak_backward import backward_search
from leastaction.selection.weak_form import WeakGram
from leastaction.selection.weak_proposals import weak_grams
from leastaction.selection.weak_search import noise_ratio, support_score
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
# Every third in `make test`, all under other kernels.
_FITTED = [pytest.param(n, marks=[pytest.mark.thorough] if k % 3 else []) for k, n in enumerate(SET_UPS)]


@pytest.mark.parametrize("name", _FITTED)
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
@pytest.mark.thorough
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


# ----------------------------------- backward on the weak form, against brute force and on recordings
PENALTY, N_ROWS = 12.0, 1000.0


def planted(seed: int, n: int, size: int, correlation: float, noise: float = 0.02, n_rows: int = 3000):
    """(I + V) λ = 0 on some columns, all of them mixed with common factors; every entry is noisy."""
    rng = np.random.default_rng([seed, n, size])
    factors = rng.standard_normal((n_rows, max(5, n // 10)))
    inertial, potential = (
        (1 - correlation) * rng.standard_normal((n_rows, n + 1))
        + correlation * factors @ rng.standard_normal((factors.shape[1], n + 1)) / np.sqrt(factors.shape[1])
        for _ in range(2)
    )
    members = sorted(rng.choice(n, size, replace=False).tolist())
    truth = rng.choice([-1.0, 1.0], size) * rng.uniform(0.5, 2.0, size)
    potential[:, -1] = -inertial[:, -1] - (inertial + potential)[:, members] @ truth
    rows = inertial + potential + noise * rng.standard_normal((n_rows, n + 1))
    parts = 0.5 * (inertial.T @ inertial + potential.T @ potential)
    return WeakGram(rows.T @ rows, n_rows * noise**2 * np.eye(n + 1), parts, n_rows), tuple(members)


def ratio_oracle(gram: WeakGram, members, error: float) -> float:
    index = np.ix_([*members, -1], [*members, -1])
    reference = gram.noise + error * gram.size
    return float(scipy.linalg.eigh(gram.residual[index], reference[index], eigvals_only=True)[0])


def best_of(levels, penalty=PENALTY, n_rows=N_ROWS, noise=1.0):
    return min((s for level in levels for s in level), key=lambda s: support_score(s, penalty, n_rows, noise))


@pytest.mark.parametrize("seed", range(6))
def test_equals_brute_force(seed):
    gram, members = planted(seed, 8, 3, 0.6, noise=0.3)
    levels = backward_search(gram, 1e-4, PENALTY, N_ROWS, width=70)
    assert [len(level[0].members) for level in levels] == list(range(1, 9))
    for size, level in enumerate(levels, start=1):
        supports = combinations(range(8), size)
        best, which = min((ratio_oracle(gram, s, 1e-4), s) for s in supports)
        assert level[0].members == which
        assert level[0].ratio == pytest.approx(best, rel=1e-6)
        for support in level:
            assert support.ratio == pytest.approx(ratio_oracle(gram, support.members, 1e-4), rel=1e-6)
    assert best_of(levels).members == members


def test_removing_a_term_never_explains_more():
    gram, _ = planted(3, 30, 8, 0.8)
    ratios = [level[0].ratio for level in backward_search(gram, 1e-6, PENALTY, N_ROWS)]
    assert np.all(np.diff(ratios) <= 1e-9 * np.abs(ratios[:-1]))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.thorough)])
def test_fifty_correlated_terms_of_150(seed):
    gram, members = planted(seed, 150, 50, 0.9)
    assert best_of(backward_search(gram, 1e-7, PENALTY, N_ROWS)).members == members


def test_hundreds_of_candidates_take_seconds():
    gram, members = planted(0, 300, 45, 0.7)
    begin = time.process_time()
    levels = backward_search(gram, 1e-7, PENALTY, N_ROWS)
    assert time.process_time() - begin < 15.0  # 2.4 s on a quiet machine
    assert best_of(levels).members == members


@pytest.mark.parametrize("system", ["triple_pendulum", "double_pendulum"])
@pytest.mark.thorough
def test_law_of_a_recording_among_a_large_library(system):
    """Noise of one per cent, one trial: the forward search takes one to four terms too many."""
    wanted = systems.get(system)
    data = systems.generate(system, noise=0.01, trials=1, seed=1)
    setup = build_problem(data, Request(systems.large_library(system), wanted.known))
    grid = Grid.lay(setup.problem, setup.scales.per_second)
    place = {int(k): p for p, k in enumerate(setup.problem.free)}
    truth = tuple(sorted(place[k] for k in systems.truth_for(wanted, setup.library) if k in place))
    for gram in weak_grams(grid, setup.scales.smooth, 0):
        n_rows = gram.n_rows / 3.0
        penalty = term_penalty(int(n_rows), len(place))
        levels = backward_search(gram, 1e-7, penalty, n_rows)
        assert best_of(levels, penalty, n_rows).members == truth


def test_noise_that_was_overestimated():
    """ρ of the law is then below one, and supports with ρ up to one are not as good."""
    gram, members = planted(1, 40, 12, 0.7)
    double = WeakGram(gram.residual, 2.0 * gram.noise, gram.size, gram.n_rows)
    levels = backward_search(double, 1e-9, PENALTY, N_ROWS)
    noise = noise_ratio(levels[-1][0].ratio, 40, N_ROWS)
    assert noise == pytest.approx(0.5, rel=0.1)
    assert best_of(levels, noise=noise).members == members
    assert noise_ratio(3.0, 40, 1000.0) == 1.0  # the library lacks something: no reason to lower the limit
    assert noise_ratio(0.1, 40, 60.0) == 1.0  # too few rows to tell


def test_dependent_columns_do_no_harm():
    gram, _ = planted(2, 6, 2, 0.5)
    index = np.ix_([0, 1, 2, 3, 4, 5, 3, 6], [0, 1, 2, 3, 4, 5, 3, 6])
    doubled = WeakGram(gram.residual[index], gram.noise[index], gram.size[index], gram.n_rows)
    levels = backward_search(doubled, 1e-4, PENALTY, N_ROWS)
    assert all(np.isfinite(s.ratio) for level in levels for s in level)
    assert len(levels[0][0].members) == 1
