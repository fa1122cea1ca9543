"""Backward search on the weak form, against brute force and on recordings."""

from __future__ import annotations

import time
from itertools import combinations

import numpy as np
import pytest
import scipy.linalg

from leastaction import systems
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.selection.likelihood_search import term_penalty
from leastaction.selection.weak_backward import backward_search
from leastaction.selection.weak_form import WeakGram
from leastaction.selection.weak_proposals import weak_grams
from leastaction.selection.weak_search import noise_ratio, support_score

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


@pytest.mark.parametrize("seed", range(2))
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
