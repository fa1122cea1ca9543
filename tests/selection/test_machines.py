"""Machines: friction chosen by free runs, motion of few samples a period, forces that are as fast."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import leastaction as la
from helpers import _machine, _pendulum
from leastaction.curve.knots import lay_knots
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.forces import curve_between, fast_forces_act
from leastaction.estimation.simulation_error import LinearRuns
from leastaction.selection.free_run_terms import _Choice
from leastaction.selection.search import run_search
from leastaction.selection.search_state import Search, begin_search
from leastaction.simulation.integrate import rk4

# ---------------------------------------------------------------------- forces between samples
RATE = 100.0
T = np.arange(0.0, 4.0, 1.0 / RATE)
INSIDE = np.linspace(1.0, 3.0, 401)


@pytest.mark.parametrize(
    ("between", "delay", "power"), [("band-limited", 0, 0), ("held", 0.5, 1), ("linear", 0, 2)]
)
@pytest.mark.parametrize("hertz", [3.0, 20.0, 33.0])
def test_a_wave_between_its_samples(between, delay, power, hertz):
    """A box of one interval and a triangle of two multiply it by sinc(f h) and its square."""
    wave = curve_between(T, np.sin(2 * np.pi * hertz * T)[:, None], between)(INSIDE)[:, 0]
    true = np.sinc(hertz / RATE) ** power * np.sin(2 * np.pi * hertz * (INSIDE - delay / RATE))
    np.testing.assert_allclose(wave, true, atol=2e-3)


@pytest.mark.parametrize("between", ["held", "linear", "band-limited"])
def test_a_constant_force_stays_constant_to_the_ends(between):
    curve = curve_between(T, np.full((T.size, 2), 1.5), between)
    np.testing.assert_allclose(curve(T), 1.5, rtol=1e-9)


# ------------------------------------------------------------------- nine samples a period
def resonator(seed: int, held: bool = False, noise: float = 0.003) -> la.Trajectories:
    """m q̈ + c q̇ + k q + 0.4 q³ = f at nine samples a period, driven by noise up to a third of the rate."""
    rng, n, fine = np.random.default_rng(seed), 400, 16
    shape = np.fft.rfft(rng.normal(size=n))
    shape[int(n * 0.33) :] = 0.0
    force = 0.1 * np.fft.irfft(shape, n)
    padded = np.concatenate([np.fft.rfft(force), np.zeros(n * fine // 2 - n // 2)])
    acting = np.repeat(force, fine) if held else fine * np.fft.irfft(padded, n * fine)
    fine_t = np.arange(n * fine) / fine
    w = 2.0 * np.pi / 9.0
    q, _ = rk4(
        lambda q, v, f: f - 0.05 * w * v - w**2 * (q + 0.4 * q**3),
        [0.0],
        [0.0],
        fine_t,
        substeps=1,
        forces=lambda times: acting[np.minimum((times * fine + 1e-6).astype(int), acting.size - 1)][:, None],
    )
    q = q[::fine]
    seen = q + noise * q.std() * rng.normal(size=q.shape)
    t = np.arange(n, dtype=float)
    return la.Trajectories([la.Trajectory(t, seen, forces=force[:, None], coordinates=["q"])])


LAW = {"q_dot**2": 0.5, "q**2": -0.5 * (2 * np.pi / 9) ** 2, "q**4": -0.1 * (2 * np.pi / 9) ** 2}
CANDIDATES = ["q_dot**2", "q", "q**2", "q**3", "q**4"]


@cache
def found(held: bool) -> Search:
    data = resonator(2 if held else 1, held)
    return run_search(begin_search(build_problem(data, Request(CANDIDATES, {}, ["q_dot**2/2"]))))


@pytest.mark.parametrize(("held", "between"), [(False, "band-limited"), (True, "held")])
def test_a_resonator_at_nine_samples_a_period(held, between):
    search = found(held)
    fit = search.found
    assert search.problem.between == between
    texts = [fit.problem.terms[k].text for k in fit.structure]
    assert texts == [*LAW, "q_dot**2/2"]
    np.testing.assert_allclose(fit.estimates[:3], list(LAW.values()), rtol=0.02)
    assert [f.code for f in search.findings] == ["fast-forces"]


def test_narrow_band_motion_is_no_noise():
    knots = lay_knots(resonator(1), 5)
    assert knots.per_second > 1.0  # a sample
    assert 8.0 < knots.period < 13.0


def test_noise_alone_does_not_ask_for_finer_knots():
    rng, t = np.random.default_rng(0), np.arange(0.0, 20.0, 0.05)
    values = np.sin(t)[:, None] + 0.5 * rng.normal(size=(t.size, 1))
    assert lay_knots(la.Trajectories([la.Trajectory(t, values)]), 5).per_second < 10.0


def fast(data: la.Trajectories) -> bool:
    return fast_forces_act([r.t for r in data], [r.q for r in data], [r.forces for r in data])


def test_which_forces_are_followed():
    assert fast(resonator(3))
    data = _pendulum(3, viscous=0.2)
    rng = np.random.default_rng(1)
    noisy = [r.changed(forces=r.forces + rng.normal(0.0, 1.0, r.forces.shape)) for r in data]
    assert not fast(la.Trajectories(noisy))
    assert not fast(data)


# --------------------------------------------------------------------- friction by free runs
def linear(rng, n_runs=200, noise=1.0, here=(1.0, 0.0)) -> LinearRuns:
    """Errors of runs that the first column explains, if at all."""
    slopes = rng.normal(size=(n_runs, 5, 1, 2))
    errors = slopes @ (np.array(here) - [1.0, 0.0]) + noise * rng.normal(size=(n_runs, 5, 1))
    return LinearRuns(errors, slopes, np.array(here), np.ones(2), np.zeros((n_runs, 5, 1, 0)))


def test_columns_are_the_best_of_their_size(rng):
    runs = linear(rng, here=(1.3, 0.2))
    both, one = runs.with_columns([0, 1]), runs.with_columns([0])
    np.testing.assert_allclose(both.estimates, [1.0, 0.0], atol=0.15)
    assert both.squares <= one.squares
    assert both.z[0] > 10.0 > 4.0 > abs(both.z[1])


def test_absent_friction_is_added_once_in_a_thousand(rng):
    """200 looks at friction that is not there, chosen by chance alone: any share is enough."""
    added = 0
    for _ in range(200):
        choice = _Choice(linear(rng), np.array([False, True]), 0.0, np.zeros(2, bool))
        added += choice.added([0]) != [0]
    assert added <= 2


def test_dry_friction_of_a_machine_is_found():
    data, request, _ = _machine(_pendulum(4, dry=0.5, pushed=5.0, noise=1e-4))
    search = run_search(begin_search(build_problem(data, request)))
    friction = [search.problem.terms[k].text for k in search.found.structure]
    assert sum("sqrt(" in text for text in friction) == 1
    assert "theta_dot**2/2" not in friction


def test_the_terms_of_a_machine_without_friction_stay():
    data, request, _ = _machine(_pendulum(5, pushed=2.0, noise=1e-4))
    search = run_search(begin_search(build_problem(data, request)))
    assert [search.problem.terms[k].text for k in search.found.structure] == ["theta_dot**2", "cos(theta)"]


# ------------------------------------------------------------------------------- friction by name
def rubbing(seed: int, friction) -> la.Trajectories:
    """A driven pendulum, 0.4 q̇² + 6 cos q, with friction as a function of q and q̇."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 6.0, 0.005)
    force = np.zeros((t.size, 4, 1))
    for w in rng.uniform(0.5, 6.0, (4, 4, 1)):
        force += 2.4 * rng.normal(size=(4, 1)) * np.sin(w * t[:, None, None] + rng.uniform(0.0, 6.3, (4, 1)))
    curves = CubicSpline(t, force)
    q, _ = rk4(
        lambda q, v, f: (f - 6.0 * np.sin(q) - friction(q, v)) / 0.8,
        rng.uniform(-1.0, 1.0, (4, 1)),
        rng.normal(0.0, 0.3, (4, 1)),
        t,
        substeps=8,
        forces=curves,
    )
    q += rng.normal(0.0, 1e-3, q.shape)
    return la.Trajectories(
        [la.Trajectory(t, q[:, k], forces=force[:, k], coordinates=["q"]) for k in range(4)]
    )


def sign(v: np.ndarray) -> np.ndarray:
    return np.tanh(v / 0.005)


def friction_of(data: la.Trajectories, *families: str) -> dict[str, float]:
    """What is found: candidates as offered → coefficients."""
    library = la.Library.mechanical(["q"], ["q"], size="compact")
    search = run_search(begin_search(build_problem(data, Request(library, {}, families))))
    fit, terms = search.found, search.problem.terms
    assert [terms[k].text for k in fit.structure if terms[k].kind == "lagrangian"] == ["q_dot**2", "cos(q)"]
    friction = [k for k in fit.structure if terms[k].kind == "dissipation"]
    texts = [re.sub(r"sqrt\(q_dot\*\*2 \+ [\d/]+\)", "abs(q_dot)", terms[k].text) for k in friction]
    return dict(zip(texts, fit.coefficients[friction].tolist(), strict=True))


def test_friction_that_differs_between_directions_is_found_with_its_sign():
    found = friction_of(rubbing(1, lambda q, v: np.where(v > 0.0, 0.1, 0.4) * v), "asymmetric")
    assert list(found) == ["q_dot**2/2", "q_dot*abs(q_dot)/2"]
    np.testing.assert_allclose([*found.values()], [0.25, -0.15], rtol=0.02)


def test_friction_that_does_not_differ_between_directions_is_not_found_to():
    found = friction_of(rubbing(1, lambda q, v: 0.3 * v + 0.3 * sign(v)), "asymmetric")
    assert list(found) == ["q_dot**2/2", "abs(q_dot)"]


def test_asymmetry_that_would_feed_energy_in_is_left_out():
    """A constant force without any friction."""
    request = Request(["theta_dot**2", "cos(theta)"], {}, ["asymmetric"])
    search = run_search(begin_search(build_problem(_pendulum(1, offset=0.3, noise=1e-4), request)))
    kinds = {search.problem.terms[k].kind for k in search.found.structure}
    assert kinds == {"lagrangian"}


def test_friction_that_grows_with_the_load_is_found():
    found = friction_of(rubbing(1, lambda q, v: (0.2 + 0.4 * abs(np.cos(q))) * sign(v)), "load")
    assert list(found) == ["abs(q_dot)", "abs(q_dot)*abs(cos(q))"]
    np.testing.assert_allclose([*found.values()], [0.2, 0.4], rtol=0.1)


@pytest.mark.thorough
def test_stribeck_friction_is_found_with_its_speed():
    """Beside it dry friction, whose worth shows only where the speed may give way."""
    data = rubbing(2, lambda q, v: sign(v) * (0.4 + 0.5 * np.exp(-abs(v) / 0.3)) + 0.2 * v)
    library = la.Library.mechanical(["q"], ["q"], size="compact")
    model = la.discover(data, library, dissipation=["auto", "stribeck"])
    assert model.fit.status == "ok"
    (speed,) = model.shapes
    assert speed.name == "q_stribeck"
    assert speed.value == pytest.approx(0.3, abs=3.0 * speed.standard_error)
    sizes = [term.coefficient for term in model.dissipation]
    np.testing.assert_allclose(sizes, [0.2, 0.4, 0.5], rtol=0.1)


def test_dry_friction_alone_is_no_stribeck_friction():
    found = friction_of(rubbing(1, lambda q, v: 0.5 * sign(v)), "auto", "stribeck")
    assert list(found) == ["abs(q_dot)"]
