"""Smoothing by REML: exactness, honesty about noise, units, gaps, a dense mixed-model oracle; outliers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

import leastaction as la
from helpers import (
    DUFFING_LIBRARY,
    DUFFING_TRUTH,
    KINETIC,
    assert_finds,
    changed,
    dense_from_lower_band,
    duffing,
    findings_of,
    random_breakpoints,
    uniform_grid,
)
from leastaction import systems
from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.curve.outliers import leave_out_outliers
from leastaction.curve.smoothing import banded_gram, smooth


def motion(t: np.ndarray) -> np.ndarray:
    return np.column_stack(
        [np.sin(2.0 * t) + 0.3 * np.cos(5.0 * t), 0.2 * t + np.exp(-0.3 * t) * np.cos(3.0 * t)]
    )


def noisy(times, sigma, seed=0):
    rng = np.random.default_rng(seed)
    return [motion(t) + sigma * rng.standard_normal((t.size, 2)) for t in times]


@pytest.mark.parametrize("degree", [3, 5])
def test_exact_on_quadratics(degree):
    """The penalty is blind to quadratics: they come back whatever the smoothing parameter."""
    grid = uniform_grid([3.0, 2.0], 8.0, degree)
    times = [np.linspace(0.0, 3.0, 120), np.linspace(0.0, 2.0, 77)]
    polynomials = [np.polynomial.Polynomial([1.0, -2.0, 0.7]), np.polynomial.Polynomial([-5.0, 0.1, -3.0])]
    result = smooth(grid, times, [p(t)[:, None] for p, t in zip(polynomials, times, strict=True)])
    for nu in range(3):
        curves = grid.evaluate(result.control_points, times, nu)
        for p, t, curve in zip(polynomials, times, curves, strict=True):
            expected = p.deriv(nu)(t) if nu else p(t)
            np.testing.assert_allclose(curve[:, 0], expected, rtol=0, atol=1e-5 * 10.0**nu)
    assert result.noise_std[0] < 1e-5


@pytest.mark.parametrize("sigma", [1e-4, 1e-2, 0.1, 0.5])
@pytest.mark.parametrize("degree", [3, 5])
def test_noise_is_estimated_within_five_per_cent(sigma, degree):
    grid = uniform_grid([10.0, 10.0], 12.0, degree)
    times = [np.linspace(0.0, 10.0, 1501)] * 2
    result = smooth(grid, times, noisy(times, np.array([sigma, 2.0 * sigma]), seed=3))
    np.testing.assert_allclose(result.noise_std, [sigma, 2.0 * sigma], rtol=0.05)
    # and the curve is closer to the truth than the data are
    error = np.concatenate(grid.evaluate(result.control_points, times)) - np.concatenate(
        [motion(t) for t in times]
    )
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 0.4 * np.array([sigma, 2.0 * sigma]))


def test_units_of_the_coordinate_do_not_matter():
    grid = uniform_grid([6.0], 10.0, 5)
    times = [np.linspace(0.0, 6.0, 301)]
    values = noisy(times, 0.05)
    a = smooth(grid, times, values)
    b = smooth(grid, times, [1e4 * v for v in values])
    np.testing.assert_allclose(b.control_points, 1e4 * a.control_points, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(b.noise_std, 1e4 * a.noise_std, rtol=1e-8)
    np.testing.assert_allclose(b.penalty, a.penalty, rtol=1e-5)


@pytest.mark.parametrize("unit", [1e-3, 60.0])
def test_units_of_time_do_not_matter(unit):
    grid = uniform_grid([6.0], 10.0, 5)
    times = [np.linspace(0.0, 6.0, 301)]
    values = noisy(times, 0.05)
    a = smooth(grid, times, values)
    scaled = SplineGrid([SplineSpace(5, unit * grid.spaces[0].breakpoints)])
    b = smooth(scaled, [unit * times[0]], values)
    np.testing.assert_allclose(b.control_points, a.control_points, rtol=0, atol=1e-6)
    np.testing.assert_allclose(b.noise_std, a.noise_std, rtol=1e-6)
    np.testing.assert_allclose(b.penalty, unit**5 * a.penalty, rtol=1e-4)


def test_shift_of_origin_does_not_matter():
    grid = uniform_grid([6.0], 10.0, 5)
    times = [np.linspace(0.0, 6.0, 301)]
    values = noisy(times, 0.05)
    a = smooth(grid, times, values)
    b = smooth(grid, times, [v + np.array([40.0, -7.0]) for v in values])
    np.testing.assert_allclose(b.control_points - [40.0, -7.0], a.control_points, rtol=0, atol=1e-6)
    np.testing.assert_allclose(b.noise_std, a.noise_std, rtol=1e-5)


def test_missing_samples_are_left_out():
    """NaN in one coordinate: the same as never having had the sample, and no effect on the other one."""
    grid = uniform_grid([6.0], 10.0, 5)
    times = [np.linspace(0.0, 6.0, 301)]
    values = noisy(times, 0.05)
    full = smooth(grid, times, values)
    keep = np.random.default_rng(1).random(301) > 0.3
    keep[100:121] = False  # a gap of four knot intervals
    holes = values[0].copy()
    holes[~keep, 0] = np.nan
    result = smooth(grid, times, [holes])
    fewer = smooth(grid, [times[0][keep]], [values[0][keep]])
    np.testing.assert_allclose(result.control_points[:, 0], fewer.control_points[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.noise_std[0], fewer.noise_std[0], rtol=1e-9)
    np.testing.assert_array_equal(result.control_points[:, 1], full.control_points[:, 1])
    bridged = grid.evaluate(result.control_points, times)[0][100:121, 0]
    np.testing.assert_allclose(bridged, motion(times[0][100:121])[:, 0], rtol=0, atol=0.25)


def test_a_gap_at_the_end_is_extrapolated_without_failure():
    grid = uniform_grid([6.0], 20.0, 5)
    t = np.linspace(0.0, 6.0, 301)
    values = noisy([t], 0.02)[0]
    values[280:] = np.nan
    result = smooth(grid, [t], [values])
    assert np.isfinite(result.control_points).all()
    np.testing.assert_allclose(result.noise_std, 0.02, rtol=0.15)


def reml_oracle(space: SplineSpace, t, y, kappas) -> tuple[np.ndarray, np.ndarray]:
    """−2 log restricted likelihood (σ profiled out) and σ̂, by dense algebra on the covariance of y.

    y = X β + Z b + noise with b ~ N(0, σ²/κ D⁺): the textbook mixed model, X the unpenalised directions.
    """
    n_ctrl, p = space.n_ctrl, space.degree
    nodes, weights = np.polynomial.legendre.leggauss(p)
    penalty = np.zeros((n_ctrl, n_ctrl))
    for a, b in zip(space.breakpoints[:-1], space.breakpoints[1:], strict=True):
        x = 0.5 * (a + b) + 0.5 * (b - a) * nodes
        third = BSpline(space.knots, np.eye(n_ctrl), p)(x, nu=3)
        penalty += third.T @ (0.5 * (b - a) * weights[:, None] * third)
    design = BSpline.design_matrix(t, space.knots, p).toarray()
    values, vectors = np.linalg.eigh(penalty)
    smooth_part = design @ vectors[:, 3:] / np.sqrt(values[3:])
    free_part = design @ vectors[:, :3]
    scores, sigmas = [], []
    for kappa in kappas:
        covariance = np.eye(t.size) + smooth_part @ smooth_part.T / kappa
        inverse = np.linalg.inv(covariance)
        information = free_part.T @ inverse @ free_part
        projected = inverse - inverse @ free_part @ np.linalg.solve(information, free_part.T @ inverse)
        sigma2 = y @ projected @ y / (t.size - 3)
        logdets = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1]
        scores.append((t.size - 3) * np.log(sigma2) + logdets)
        sigmas.append(np.sqrt(sigma2))
    return np.array(scores), np.array(sigmas)


@pytest.mark.parametrize(
    ("degree", "kind", "sigma"), [(3, "uniform", 0.1), (5, "random", 0.1), (5, "uniform", 0.02)]
)
def test_agrees_with_a_dense_mixed_model(degree, kind, sigma):
    rng = np.random.default_rng(11)
    points = np.linspace(0.0, 4.0, 21) if kind == "uniform" else random_breakpoints(rng, 20, 0.0, 4.0)
    space = SplineSpace(degree, points)
    t = np.sort(rng.uniform(0.0, 4.0, 90))
    y = motion(t)[:, 0] + sigma * rng.standard_normal(t.size)
    result = smooth(SplineGrid([space]), [t], [y[:, None]])
    grid = result.penalty[0] * 10.0 ** np.linspace(-2.0, 2.0, 81)
    scores, _ = reml_oracle(space, t, y, grid)
    (here,), (noise,) = reml_oracle(space, t, y, result.penalty)
    assert here <= scores.min() + 0.02  # as good as the best of the scan
    np.testing.assert_allclose(result.noise_std, noise, rtol=1e-6)
    assert abs(np.log10(grid[np.argmin(scores)] / result.penalty[0])) < 0.2


def test_banded_gram_equals_dense_product():
    grid = uniform_grid([1.0, 2.0], 5.0, 4)
    times = [np.linspace(0.0, 1.0, 30), np.linspace(0.0, 2.0, 40)]
    design = grid.design(times)
    dense = design.toarray()
    np.testing.assert_allclose(
        dense_from_lower_band(banded_gram(design, 4)), dense.T @ dense, rtol=0, atol=1e-12
    )


# --------------------------------------------------------- outliers are left out, and nothing else is
SHARE, SIZE = 0.02, 10.0


def spoiled(seed: int, noise: float = 0.02):
    """Recordings of a cart with a spring, and masks of the samples that are ten standard deviations off."""
    system = systems.get("cart_spring_pendulum")
    motions = systems.simulate_truth(system, 2, 15.0, 100.0, seed)
    sigma = systems.noise_std(system, motions, noise)
    clean = systems.measure(system, motions, sigma, seed)
    rng = np.random.default_rng(seed)
    masks = [rng.random(t.q.shape) < SHARE for t in clean]
    off = [SIZE * sigma * m * rng.choice((-1.0, 1.0), m.shape) for m in masks]
    data = [
        la.Trajectory(t.t, t.q + o, t.forces, t.coordinates, t.name) for t, o in zip(clean, off, strict=True)
    ]
    return la.Trajectories(data), masks, clean


@pytest.mark.parametrize("seed", range(3))
def test_the_outliers_are_found(seed):
    data, masks, _ = spoiled(seed)
    kept, notes = leave_out_outliers(data, 5)
    out = np.concatenate([np.isnan(t.q) for t in kept])
    planted = np.concatenate(masks)
    assert (out & planted).sum() > 0.98 * planted.sum()
    assert (out & ~planted).sum() <= 1
    assert [note.subject for note in notes] == [(name,) for name in data.coordinates]
    assert [note.values["count"] for note in notes] == out.sum(axis=0).tolist()


def test_the_outliers_of_a_long_recording_are_those_of_its_trials():
    """Smoothness and noise from pieces; where outliers are is seen trial by trial."""
    data, _, _ = spoiled(1)
    whole, _ = leave_out_outliers(data, 5)
    found, notes = leave_out_outliers(data, 5, data.n_samples // 2)
    one, other = (np.concatenate([np.isnan(t.q) for t in kept]) for kept in (whole, found))
    assert (one != other).sum() <= 2
    assert [note.values["count"] for note in notes] == other.sum(axis=0).tolist()
    clean = systems.generate("double_pendulum", noise=0.01, trials=2, duration=20.0, seed=7)
    assert leave_out_outliers(clean, 5, clean.n_samples // 2)[0] is clean


@pytest.mark.parametrize("noise", [0.0, 1e-4, 0.01, 0.3])
@pytest.mark.parametrize("name", ["double_pendulum", "magnetic_pendulum", "spherical_spring_pendulum"])
def test_good_samples_stay(name, noise):
    """Also where the curve through them cannot follow the fastest turns."""
    data = systems.generate(name, noise=noise, trials=2, duration=20.0, seed=7)
    kept, notes = leave_out_outliers(data, 5)
    assert sum(int(np.isnan(t.q).sum()) for t in kept) <= 1
    if not notes:
        assert kept is data


def test_heavy_tails_are_not_outliers():
    """An encoder that is off by a count in a tenth of its samples: that is its noise."""
    data = systems.generate("cart_spring_pendulum", noise=0.001, trials=2, duration=15.0, seed=0)
    rng = np.random.default_rng(0)
    count = 6.0 * 0.001 * np.std(data[0].q, axis=0)
    noisy = [
        la.Trajectory(t.t, t.q + count * (rng.random(t.q.shape) < 0.1), t.forces, t.coordinates) for t in data
    ]
    kept, notes = leave_out_outliers(la.Trajectories(noisy), 5)
    assert not notes
    assert sum(int(np.isnan(t.q).sum()) for t in kept) == 0


def test_what_was_unwrapped_is_remembered():
    t = np.arange(400) * 0.05
    rng = np.random.default_rng(0)
    q = np.mod(1.5 * t + 0.3 * np.sin(t) + 0.001 * rng.standard_normal(t.size), 2 * np.pi)
    q[100] += 0.5
    data = la.Trajectories([la.Trajectory(t, q, coordinates=["theta"])]).unwrap(["theta"])
    kept, notes = leave_out_outliers(data, 5)
    assert len(notes) == 1
    assert kept.wraps_removed == data.wraps_removed != {"theta": 0}


def test_discovery_is_as_good_as_without_them():
    def glitches(q):
        q = q.copy()
        hit = np.random.default_rng(2).random(q.shape) < SHARE
        q[hit] += 20.0 * 0.01 * np.random.default_rng(3).choice((-1.0, 1.0), int(hit.sum()))
        return q

    model = la.discover(changed(duffing(), q=glitches), DUFFING_LIBRARY, KINETIC)
    assert_finds(model, DUFFING_TRUTH)
    assert model.fit.status == "ok"
    assert findings_of(model, "outliers-left-out")
    kept = la.discover(changed(duffing(), q=glitches), DUFFING_LIBRARY, KINETIC, robust=False)
    assert not findings_of(kept, "outliers-left-out")
    assert kept.noise_std[0] > 1.3 * model.noise_std[0]
