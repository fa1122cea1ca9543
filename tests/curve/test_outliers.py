"""Outliers are left out, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from helpers import DUFFING_LIBRARY, DUFFING_TRUTH, KINETIC, assert_finds, changed, duffing, findings_of
from leastaction import systems
from leastaction.curve.outliers import leave_out_outliers

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
