"""Doubts: measured rates that are no derivatives, and laws of another form."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import leastaction as la
from benchmarks.unmeasured_parts import asked, draw
from helpers import findings_of, free_motions, with_rates
from leastaction import InputError, Trajectories, Trajectory, delay, discover, smooth, systems
from leastaction.curve.knots import excerpt, lay_knots
from leastaction.diagnosis import families, far_parts, smooth_changes
from leastaction.diagnosis import unmeasured_part as parts
from leastaction.diagnosis.rates import doubts_about_rates
from leastaction.diagnosis.unmeasured_part import unmeasured_part
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Structure
from leastaction.findings import Finding, find
from leastaction.metrics import cramer_rao_bound
from leastaction.selection.search import run_search
from leastaction.selection.search_state import begin_search


@pytest.fixture(autouse=True)
def _warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def run(n: int = 40, **fields) -> Trajectory:
    t = np.linspace(0.0, 4.0, n)
    q = np.column_stack([np.sin(t), np.cos(2.0 * t)])
    given = {
        "velocities": np.column_stack([np.cos(t), np.full(n, np.nan)]),
        "accelerations": -np.column_stack([np.sin(t), 4.0 * np.cos(2.0 * t)]),
    }
    return Trajectory(t, q, np.ones_like(q), ["x", "theta"], "one", **{**given, **fields})


# -------------------------------------------------------------------------------- trajectories
@pytest.mark.parametrize(
    ("rates", "text"),
    [
        (np.zeros((39, 2)), "velocities has 39 rows, but t has 40 times"),
        (np.zeros((40, 3)), r"velocities has 3 column\(s\), but q has 2.*NaN where nothing is measured"),
        (np.zeros((2, 40)), "it looks transposed"),
        (np.full((40, 2), np.inf), r"'one': velocities\[0, 0\] is infinite; use NaN"),
        (np.full((40, 2), "1"), "real numbers are expected"),
    ],
)
def test_wrong_rates_are_refused(rates, text):
    with pytest.raises(InputError, match=text):
        run(velocities=rates)


def test_rates_are_read_only_copies_and_given_by_keyword_only():
    given = np.zeros((40, 2))
    item = run(velocities=given)
    given += 1.0
    assert item.velocities is not None
    assert not item.velocities.any()
    with pytest.raises(ValueError, match="read-only"):
        item.velocities[0, 0] = 1.0
    with pytest.raises(TypeError):
        Trajectory(item.t, item.q, None, None, "", given)  # type: ignore[misc]
    assert Trajectory([0.0, 1.0], [0.0, 1.0], velocities=[1.0, 1.0]).velocities.shape == (2, 1)  # type: ignore[union-attr]


def same(one: Trajectory, other: Trajectory, rows=slice(None)) -> None:
    for field in ("t", "velocities", "accelerations"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field)[rows], err_msg=field)


def test_rates_stay_with_their_trajectory():
    item = run()
    same(pickle.loads(pickle.dumps(item)), item)
    set_ = Trajectories([item, item.changed(name="two")])
    same(set_[1:][0], item)
    same(set_.select("two")[0], item)
    same(set_.unwrap("theta")[0], item)
    same(item.rows(slice(3, 9)), item, slice(3, 9))
    same(delay.shift_forces(item, 0.3)[0], item, item.t >= 0.3)
    long = run(4000)
    pieces = excerpt(Trajectories([long]), 2000)
    assert len(pieces) > 1
    for piece in pieces:
        same(piece, long, np.isin(long.t, piece.t))


def test_channels_of_a_set():
    item = run()
    plain = item.changed(velocities=None, accelerations=None, name="two")
    rates = Trajectories([item, plain]).rates
    assert [r.label(item.coordinates) for r in rates] == [
        "velocity of x",
        "acceleration of x",
        "acceleration of theta",
    ]
    assert [np.isfinite(v).sum() for v in rates[0].values] == [40, 0]
    assert Trajectories([plain]).rates == ()
    assert "velocities, accelerations" in repr(item)
    assert "velocities" not in repr(item.changed(velocities=np.full((40, 2), np.nan)))


def test_digest_counts_rates_that_are_measured():
    item, nothing = run(), np.full((40, 2), np.nan)
    bare = item.changed(velocities=None, accelerations=None)
    digests = [
        Trajectories([x]).digest()
        for x in (bare, item, item.changed(accelerations=None), item.changed(velocities=item.accelerations))
    ]
    assert len(set(digests)) == 4
    assert Trajectories([bare.changed(velocities=nothing)]).digest() == digests[0]
    swapped = bare.changed(velocities=item.accelerations), bare.changed(accelerations=item.accelerations)
    assert Trajectories([swapped[0]]).digest() != Trajectories([swapped[1]]).digest()


# ------------------------------------------------------------------------------------- the fit
def estimates(model):
    free = [term for term in model.terms if not term.known]
    return {t.expression: t.coefficient for t in free}, {t.expression: t.standard_error for t in free}


@pytest.mark.thorough
def test_rates_that_are_not_measured_change_nothing():
    system = systems.get("double_pendulum")
    data = systems.generate(system, noise=0.05, trials=2, duration=6.0, seed=2)
    blank = Trajectories(x.changed(velocities=x.q * np.nan, accelerations=x.q * np.nan) for x in data)
    one, other = (discover(d, system.library) for d in (data, blank))
    assert one.diagnostics is not None
    assert other.diagnostics is not None
    assert estimates(one) == estimates(other)
    assert one.provenance == other.provenance
    np.testing.assert_array_equal(one.diagnostics.control_points, other.diagnostics.control_points)
    assert other.diagnostics.rate_noise_std == {}


@pytest.mark.thorough
def test_velocities_reach_the_bound_without_bias():
    """Standard errors shrink by the factor that the Cramér–Rao bound allows, and tell the truth."""
    system = systems.get("cart_spring_pendulum")
    scores = []
    for seed in range(4):
        truth = systems.simulate_truth(system, trials=2, duration=6.0, seed=seed)
        sigma = systems.noise_std(system, truth, 0.05)
        spread = np.std(np.concatenate([m.qdot for m in truth]), axis=0)
        data = with_rates(system, truth, sigma, velocity=0.01, seed=seed)
        model = discover(data, system.library, known=system.known)
        found, errors = estimates(model)
        assert model.fit.status == "ok", model.fit.warnings
        assert set(found) == set(system.free)
        bound = cramer_rao_bound(system, truth, sigma, velocity_noise_std=0.01 * spread)
        alone = cramer_rao_bound(system, truth, sigma)
        assert np.all(bound.standard_errors < 0.5 * alone.standard_errors)
        found_errors = np.array([errors[k] for k in bound.terms])
        np.testing.assert_allclose(found_errors, bound.standard_errors, rtol=0.15)
        scores.append([(found[k] - system.lagrangian[k]) / errors[k] for k in found])
        assert model.diagnostics is not None
        noise = np.array(list(model.diagnostics.rate_noise_std.values()))
        np.testing.assert_allclose(noise, 0.01 * spread, rtol=0.1)
        np.testing.assert_allclose(model.noise_std, sigma, rtol=0.15)
        assert model.fit.chi2_per_sample == pytest.approx(1.0, abs=0.1)
        found_noise = [f.values["noise"] for f in findings_of(model, "rate-noise")]
        assert found_noise == noise.tolist()
    assert np.sqrt(np.mean(np.square(scores))) < 1.6


@pytest.mark.thorough
def test_accelerations_are_fitted_too():
    system = systems.get("magnetic_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=10.0, seed=1)
    sigma = systems.noise_std(system, truth, 0.1)
    models = [
        discover(with_rates(system, truth, sigma, acceleration=level, seed=1), system.library, system.known)
        for level in (None, 0.02)
    ]
    (_, wide), (found, narrow) = map(estimates, models)
    assert models[1].fit.status == "ok", models[1].fit.warnings
    assert set(found) == set(system.free)
    assert all(narrow[k] < 0.5 * wide[k] for k in found if k in wide)
    assert np.sqrt(np.mean([((found[k] - system.lagrangian[k]) / narrow[k]) ** 2 for k in found])) < 2.0


def thinned(item: Trajectory, keep_every: int) -> Trajectory:
    rows = np.arange(item.n_times) % keep_every == 0
    return item.changed(q=np.where(rows[:, None], item.q, np.nan))


@pytest.mark.thorough
def test_a_slow_camera_and_a_fast_gyroscope():
    """Positions twice a second show nothing of the motion; with fast velocities they are enough."""
    system = systems.get("cart_spring_pendulum")
    truth = systems.simulate_truth(system, trials=2, duration=10.0, seed=1)
    data = with_rates(system, truth, systems.noise_std(system, truth, 0.02), velocity=0.02, seed=1)
    slow = Trajectories(x.changed(velocities=None).rows(slice(None, None, 50)) for x in data)
    alone = discover(slow, system.library, known=system.known)
    assert alone.fit.status == "doubtful"
    assert set(estimates(alone)[0]) != set(system.free)
    model = discover(Trajectories(thinned(x, 50) for x in data), system.library, known=system.known)
    found, errors = estimates(model)
    assert model.fit.status == "ok", model.fit.warnings
    assert set(found) == set(system.free)
    assert all(errors[k] < 0.01 * abs(found[k]) for k in found)
    assert all(abs(found[k] - system.lagrangian[k]) < 5.0 * errors[k] for k in found)


def test_the_papers_method_says_that_it_leaves_rates_out():
    system = systems.get("single_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=4.0, seed=0)
    data = with_rates(system, truth, 0.01, velocity=0.01)
    options = {"iterations": 200, "check_every": 100, "threshold": 0.0}
    models = [
        discover(d, system.library, method="adam", options=options) for d in (data, data.without_rates())
    ]
    assert estimates(models[0])[0] == estimates(models[1])[0]
    assert [len(findings_of(m, "rates-unused")) for m in models] == [1, 0]


# --------------------------------------------------------------------------------- smoothing
def test_smoothing_follows_rates_and_finds_their_noise(rng):
    t = np.linspace(0.0, 10.0, 1001)
    q = np.sin(2.0 * t) + 0.2 * rng.standard_normal(t.size)
    v = 2.0 * np.cos(2.0 * t) + 0.02 * rng.standard_normal(t.size)
    plain, rated = (smooth(Trajectory(t, q, **given))[0] for given in ({}, {"velocities": v}))
    errors = [np.std(m.qdot[:, 0] - 2.0 * np.cos(2.0 * t)) for m in (plain, rated)]
    assert errors[1] < 0.1 * errors[0]
    assert rated.noise_std[0] == pytest.approx(0.2, rel=0.1)
    found = lay_knots(Trajectories([Trajectory(t, q, velocities=v)]), 5).smooth
    assert found.rate_std == pytest.approx([0.02], rel=0.1)


def test_replicates_of_a_curve_with_rates_scatter_as_it_errs(rng):
    t = np.linspace(0.0, 10.0, 501)
    exact = np.sin(2.0 * t)
    q, v = exact + 0.2 * rng.standard_normal(501), 2.0 * np.cos(2.0 * t) + 0.1 * rng.standard_normal(501)
    found = lay_knots(Trajectories([Trajectory(t, q, velocities=v)]), 5).smooth
    design = found.grid.design([t])
    again = np.array([design @ p[:, 0] for p in found.replicates(40, rng, np.zeros(1))])
    error = np.std(design @ found.control_points[:, 0] - exact)
    assert 0.4 < error / np.mean(again.std(axis=0)) < 2.5


# ------------------------------------------------------------------------------- plausibility
def doubts(data: Trajectories) -> list[Finding]:
    return doubts_about_rates(data, lay_knots(data, 5).smooth)


@pytest.fixture(scope="module")
def two_arms() -> Trajectories:
    system = systems.get("double_pendulum")
    truth = systems.simulate_truth(system, trials=2, duration=8.0, seed=3)
    return with_rates(system, truth, systems.noise_std(system, truth, 0.05), 0.03, 0.05, seed=3)


def altered(data: Trajectories, field: str, change) -> Trajectories:
    out = []
    for item in data:
        rates = getattr(item, field).copy()
        rates[:, 0] = change(rates[:, 0])
        out.append(item.changed(**{field: rates}))
    return Trajectories(out)


@pytest.mark.parametrize(
    ("field", "change", "code", "figures"),
    [
        ("velocities", np.degrees, "rate-scaled", {"factor": 57.3, "unit": "deg/s"}),
        ("velocities", np.negative, "rate-scaled", {"factor": -1.0, "unit": "1"}),
        ("velocities", lambda v: -np.degrees(v), "rate-scaled", {"factor": -57.3, "unit": "deg/s"}),
        ("velocities", lambda v: 1.1 * v, "rate-scaled", {"factor": 1.1, "unit": ""}),
        ("velocities", lambda v: v + 0.5, "rate-offset", {"offset": 0.5}),
        ("accelerations", lambda a: a / 9.81, "rate-scaled", {"factor": 1.0 / 9.81, "unit": "g"}),
    ],
)
def test_a_channel_that_is_no_derivative_is_named(two_arms, field, change, code, figures):
    (found,) = doubts(altered(two_arms, field, change))
    quantity = {"velocities": "velocity", "accelerations": "acceleration"}[field]
    assert (found.code, found.subject, found.values["quantity"]) == (code, ("theta1",), quantity)
    for name, value in figures.items():
        assert found.values[name] == (value if isinstance(value, str) else pytest.approx(value, rel=0.05))


def test_a_channel_of_other_times_is_named(two_arms):
    (found,) = doubts(altered(two_arms, "velocities", lambda v: np.roll(v, 180)))
    assert found.code in ("rate-unrelated", "rate-scaled")
    assert found.subject == ("theta1",)


def test_a_channel_that_is_one_is_not_doubted(two_arms):
    assert doubts(two_arms) == []
    assert doubts(altered(two_arms, "velocities", lambda v: 1.03 * v)) == []
    sign = np.random.default_rng(0).choice([-1, 0, 1], 801, p=[0.005, 0.99, 0.005])  # glitches
    assert doubts(altered(two_arms, "velocities", lambda v: np.where(sign, 50.0 * sign, v))) == []
    assert doubts(two_arms.without_rates()) == []


def test_a_dead_sensor_is_named(two_arms):
    dead = altered(two_arms, "velocities", lambda v: 0.0 * v)
    assert doubts(dead) == [find("rate-constant", "theta1", quantity="velocity")]
    model = discover(dead, systems.get("double_pendulum").library)
    assert model.fit.status == "doubtful"
    assert set(estimates(model)[0]) == set(systems.get("double_pendulum").free)


@pytest.mark.parametrize("name", ["spherical_spring_pendulum", "spherical_pendulum", "magnetic_pendulum"])
@pytest.mark.parametrize("noise", [0.0, pytest.param(0.1, marks=pytest.mark.thorough), 0.5])
def test_violent_motions_and_noise_are_no_reason_for_doubt(name, noise):
    """A smoothed curve would be too flat where these turn."""
    system = systems.get(name)
    truth = systems.simulate_truth(system, trials=2, duration=8.0, seed=1)
    assert (
        doubts(with_rates(system, truth, systems.noise_std(system, truth, noise), 0.01, 0.05, seed=1)) == []
    )


@pytest.mark.thorough
def test_a_wrong_unit_makes_the_model_doubtful_and_no_worse(two_arms):
    library = systems.get("double_pendulum").library
    wrong = Trajectories(x.changed(velocities=np.degrees(x.velocities), accelerations=None) for x in two_arms)
    model, plain = (discover(d, library) for d in (wrong, two_arms.without_rates()))
    assert model.fit.status == "doubtful"
    assert [f.values["unit"] for f in findings_of(model, "rate-scaled")] == ["deg/s", "deg/s"]
    (found, errors), (expected, _) = estimates(model), estimates(plain)
    assert found.keys() == expected.keys()
    assert all(abs(found[k] - expected[k]) < errors[k] for k in found)


# ---------------------------------------------------------------------------------- the bound
def test_bound_from_velocities():
    system = systems.get("single_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=3.0, rate=50.0, seed=1)
    both = cramer_rao_bound(system, truth, 0.05, velocity_noise_std=0.02)
    none = cramer_rao_bound(system, truth, 0.05, velocity_noise_std=np.inf)
    alone = cramer_rao_bound(system, truth, 0.05)
    np.testing.assert_array_equal(none.covariance, alone.covariance)
    assert np.linalg.eigvalsh(alone.covariance - both.covariance).min() > 0.0
    # the same velocities twice are velocities with half the variance
    halved = cramer_rao_bound(system, truth, 1e6, velocity_noise_std=0.02 / np.sqrt(2.0))
    once = cramer_rao_bound(system, truth, 1e6, velocity_noise_std=0.02)
    np.testing.assert_allclose(2.0 * halved.covariance, once.covariance, rtol=1e-6)
    (motion,) = truth
    seen = Trajectory(motion.t, motion.q, velocities=np.where(motion.t[:, None] < 1.5, motion.qdot, np.nan))
    part = cramer_rao_bound(system, truth, 0.05, velocity_noise_std=0.02, observed=Trajectories([seen]))
    assert np.all(both.standard_errors < part.standard_errors)
    assert np.all(part.standard_errors < alone.standard_errors)
    with pytest.raises(InputError, match="velocity_noise_std"):
        cramer_rao_bound(system, truth, 0.05, velocity_noise_std=0.0)


def test_velocity_bound_agrees_with_finite_differences():
    system = systems.get("cart_spring_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=2.0, rate=50.0, seed=2)
    (motion,), n, terms = truth, system.n_dof, system.free

    def seen(change):
        step = dict(zip(terms, change[2 * n :], strict=True))
        other = replace(system, lagrangian={k: c + step.get(k, 0.0) for k, c in system.lagrangian.items()})
        start = np.concatenate([motion.q[0], motion.qdot[0]]) + change[: 2 * n]
        result = other.simulate(start[:n], start[n:], motion.t, motion.drive, rtol=1e-12, atol=1e-12)
        return np.concatenate([result.q / 0.1, result.qdot / 0.05], axis=1).ravel()

    steps = 1e-5 * np.eye(2 * n + len(terms))
    jacobian = np.stack([(seen(s) - seen(-s)) / 2e-5 for s in steps], axis=1)
    expected = np.linalg.inv(jacobian.T @ jacobian)[2 * n :, 2 * n :]
    bound = cramer_rao_bound(system, truth, 0.1, velocity_noise_std=0.05)
    np.testing.assert_allclose(bound.covariance, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


# ----------------- the form of the law: terms with unknown numbers that would help, and smooth changes of it
POWERS = ["x_dot**2", "x", "x**2", "x**3", "x**4"]
STARTS = (0.5, 0.9, 1.6)


def morse(x):
    return 6.0 * (np.exp(-2.4 * x) - np.exp(-1.2 * x))


# ------------------------------ families: they are named, and lead to the law when they are added
def _named(model: la.LagrangianModel) -> tuple[str, ...]:
    """Candidates with unknown numbers that the findings propose."""
    for finding in model.fit.findings:
        texts = finding.subject if finding.code == "missing-term" else finding.values.get("family", ())
        if any("{" in text for text in texts):
            return tuple(texts)
    return ()


@pytest.mark.parametrize(
    ("force", "starts", "texts", "numbers"),
    [
        (
            morse,
            STARTS,
            ("exp(-{a}*x)", "exp(-2*{a}*x)"),
            {"a": 1.2},
        ),
        (
            lambda x: -2.0 * x / (x**2 + 0.04) ** 1.5,
            STARTS,
            ("1/sqrt((x-{p})**2+{h}**2)",),
            {"p": 0.0, "h": 0.2},
        ),
    ],
    ids=["Morse", "soft Coulomb"],
)
@pytest.mark.thorough
def test_the_terms_that_are_named_lead_to_the_law(force, starts, texts, numbers):
    runs = free_motions(force, starts)
    doubtful = la.discover(runs, POWERS, known={"x_dot**2": 0.5})
    assert doubtful.fit.status == "doubtful"
    assert _named(doubtful) == texts
    assert all(text in " ".join(doubtful.fit.warnings) for text in texts)
    model = la.discover(runs, ["x_dot**2", "x", *texts], known={"x_dot**2": 0.5})
    # what the data leave open beyond the law may still be told
    assert {f.code for f in model.fit.findings if f.severity == "warning"} <= {"form-open"}
    assert {shape.name for shape in model.shapes} == {*numbers}
    for shape in model.shapes:
        assert abs(abs(shape.value) - numbers[shape.name]) < 4.0 * shape.standard_error
    assert {term.written for term in model.terms} == {"x_dot**2", *texts}


@pytest.fixture(scope="module")
def helped():
    """What a search of powers for a Morse oscillator was asked for, and what it tried."""
    asked: list[tuple[Any, ...]] = []
    tried: dict[str, list[Any]] = {"helpful_families": [], "searched_with": []}
    real = families._helpful
    with pytest.MonkeyPatch.context() as patch:

        def helpful(search, kinetic):
            asked.append((search, kinetic))
            return real(search, kinetic)

        patch.setattr(families, "_helpful", helpful)
        for name, kept in tried.items():
            patch.setattr(families, name, recorded(getattr(families, name), kept))
        model = la.discover(free_motions(morse, STARTS), POWERS, known={"x_dot**2": 0.5})
    assert _named(model)
    return asked[-1], tried


def recorded(function, kept: list[Any]):
    """A function that keeps its answers; families come one after another and are listed."""
    all_at_once = function is families.helpful_families

    def run(*args):
        found = function(*args)
        kept.append(list(found) if all_at_once else found)
        return kept[-1]

    return run


def replay(tried, monkeypatch) -> None:
    """Let the functions of `helped` give the same answers again, in the same sequence."""
    for name, kept in tried.items():
        again, real = iter(kept), getattr(families, name)
        monkeypatch.setattr(families, name, lambda *args, _a=again, _r=real: next(_a, None) or _r(*args))


@pytest.mark.parametrize(
    ("condition", "answer"),
    [
        (None, None),
        ("equations_hold", lambda fit: False),
        ("doubts_about_the_form", lambda *_, **__: [find("form-open", kind="potential", open=0.2)]),
        ("value", lambda fit: 0.0),
    ],
    ids=["all are met", "equations do not hold", "form still open", "no likelier"],
)
def test_nothing_is_named_where_no_family_helps(condition, answer, helped, monkeypatch):
    """Each condition by itself keeps a family from being named that is named otherwise."""
    asked, tried = helped
    replay(tried, monkeypatch)
    if condition is not None:
        monkeypatch.setattr(families, condition, answer)
    assert (families._helpful(*asked) is None) == (condition is not None)


@pytest.mark.parametrize(("sure", "named"), [(0.0, True), (np.inf, False)])
def test_a_likelier_law_counts_even_if_its_form_is_doubtful(sure, named, helped, monkeypatch):
    """It is not the law, but it is likelier than what was found, if that is no chance."""
    asked, tried = helped
    replay(tried, monkeypatch)
    monkeypatch.setattr(
        families, "doubts_about_the_form", lambda *_: [find("form-open", kind="potential", open=0.2)]
    )
    monkeypatch.setattr(families, "looks_imitated", lambda _: True)
    monkeypatch.setattr(families, "_difference", lambda *_: 0.1)
    monkeypatch.setattr(families, "chance", lambda *_: sure)
    found = families.simpler_form(asked[0])
    assert [f.values["imitated"] for f in found] == named * ["a law like it"]
    assert all("found seem to imitate a law like it" in f.message for f in found)


# -------------------------------------- several coordinates: a short law instead of its long imitation
def orbits(potential_slope, starts, noise: float = 1e-3) -> la.Trajectories:
    """Motions of a point of mass one in the plane under a central force."""
    t, rng, out = np.arange(0.0, 8.0, 0.02), np.random.default_rng(5), []

    def rates(_, state):
        r = np.hypot(state[0], state[1])
        return [state[2], state[3], *(-potential_slope(r) * state[:2] / r)]

    for start in starts:
        states = solve_ivp(rates, (0.0, t[-1]), start, t_eval=t, rtol=1e-10, atol=1e-10).y.T
        out.append(
            la.Trajectory(t, states[:, :2] + rng.normal(0.0, noise, (t.size, 2)), coordinates=["x", "y"])
        )
    return la.Trajectories(out)


@pytest.mark.thorough
def test_a_long_law_of_several_coordinates_is_compared_with_a_short_one():
    """A well, 3 exp(-r**2/2) in L, that many powers imitate."""
    starts = [(1.1, 0.0, 0.2, 0.9), (0.4, 0.6, -1.0, 0.4), (-0.9, 0.8, 0.3, 0.1)]
    runs = orbits(lambda r: 3.0 * r * np.exp(-0.5 * r**2), starts)
    library = la.Library.mechanical(["x", "y"])
    search = run_search(begin_search(build_problem(runs, Request(library, {"x_dot**2": 0.5}))))
    (finding,) = families.simpler_form(search)
    assert finding.values["family"] == ("exp(-{a}*(x**2+y**2))",)
    assert finding.values["free_terms"] < finding.values["instead_of"]
    (number,) = finding.values["numbers"]
    assert float(number.removeprefix("a = ")) == pytest.approx(0.5, rel=0.05)


# ---------------------------- time: a law that depends on it is named as such, and only such a law
@pytest.mark.parametrize(
    ("force", "texts", "numbers"),
    [
        (lambda x, t: -4.0 * x + 1.5 * np.cos(3.3 * t), {"x*cos({w}*t)"}, {"w": 3.3}),
        (lambda x, t: -4.0 * x * (1.0 + 0.3 * np.sin(3.1 * t)), {"x**2*sin({w}*t)"}, {"w": 3.1}),
        (lambda x, t: -4.0 * x * np.exp(-0.05 * t), {"x**2*exp(-{a}*t)"}, {"a": 0.05}),
        (
            lambda x, t: -4.0 * x + np.cos(3.3 * t) + 0.8 * np.cos(5.2 * t),
            {"x*cos({w}*t)", "x*cos({w1}*t)"},
            {"w": 3.3, "w1": 5.2},
        ),
    ],
    ids=["forced", "parametric", "softening", "two frequencies"],
)
@pytest.mark.thorough
def test_a_law_that_depends_on_time_is_named(force, texts, numbers):
    runs = free_motions(force, STARTS, timed=True)
    doubtful = la.discover(runs, POWERS, known={"x_dot**2": 0.5})
    (finding,) = [f for f in doubtful.fit.findings if f.code == "time-dependent"]
    found = dict(pair.split(" = ") for pair in finding.values["numbers"])
    # the frequencies are named in the sequence in which they are found
    assert sorted(map(float, found.values())) == pytest.approx(sorted(numbers.values()), rel=0.01)
    assert {*finding.subject} == texts
    model = la.discover(runs, ["x_dot**2", "x**2", *texts], known={"x_dot**2": 0.5})
    assert {term.written for term in model.terms if "t)" in term.written} == texts


@pytest.mark.thorough
def test_a_law_that_lacks_a_term_is_not_said_to_depend_on_time():
    """What is missing repeats with the motion, and so does a wave; it leaves a doubt about the form."""
    runs = free_motions(lambda x: -9.0 * x**3 * np.exp(-x * x) - 2.0 * np.sin(3.0 * x), (0.6, 1.0, 1.6))
    model = la.discover(runs, POWERS, known={"x_dot**2": 0.5})
    assert model.fit.status == "doubtful"
    assert "time-dependent" not in {f.code for f in model.fit.findings}


# ------------------- smooth changes: right laws pass, and laws that the library cannot write do not
def _codes(model: la.LagrangianModel) -> list[str]:
    return [f.code for f in model.fit.findings if f.code.startswith("form-")]


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_a_right_law_passes(noise):
    runs = free_motions(lambda x: -2.0 * x - 4.0 * x**3, noise=noise)
    model = la.discover(runs, la.Library.mechanical("x"), known={"x_dot**2": 0.5})
    assert {t.expression for t in model.terms} == {"x_dot**2", "x**2", "x**4"}
    assert model.fit.status == "ok", model.fit.warnings


@pytest.mark.thorough
def test_an_imitation_is_not_ok():
    """√|x| cannot be written by powers: they imitate it."""
    runs = free_motions(lambda x: -4.5 * np.sign(x) * np.sqrt(abs(x)), noise=0.03)
    model = la.discover(runs, ["x_dot**2", "x**2", "x**4"], known={"x_dot**2": 0.5})
    assert model.fit.status == "doubtful"


def test_data_that_leave_the_form_open_are_told(monkeypatch: pytest.MonkeyPatch):
    """The whole motion is within the noise of a parabola: what the force is beyond it, nobody knows."""
    runs = free_motions(lambda x: -np.sin(3.0 * x), noise=0.1, starts=(0.9,))
    held: list[Fit] = []
    real = smooth_changes.smooth_changes
    monkeypatch.setattr(smooth_changes, "smooth_changes", lambda fit: (held.append(fit), real(fit))[1])
    la.discover(runs, ["x_dot**2", "cos(3*x)"], known={"x_dot**2": 0.5})
    few = real(held[0])[0]
    held.clear()
    la.discover(
        free_motions(lambda x: -np.sin(3.0 * x), noise=0.001, starts=(0.5, 0.7, 0.9)),
        ["x_dot**2", "cos(3*x)"],
        known={"x_dot**2": 0.5},
    )
    many = real(held[0])[0]
    assert many.spread < 0.05 * few.spread


def test_one_energy_leaves_open_what_several_tell_apart():
    """Along one conservative motion, kinetic and potential energy can change together."""
    codes = []
    for starts in ((1.2,), (1.2, 0.9, 0.6, 1.5)):
        runs = free_motions(lambda x: -2.0 * x + 0.75 * x**2, noise=0.1, starts=starts)
        model = la.discover(runs, ["x_dot**2", "x**2", "x**3"], known={"x_dot**2": 0.5})
        codes.append([f.code for f in model.fit.findings if f.severity == "warning"])
    assert codes == [["form-open"], []]


def test_for_the_true_law_the_gain_is_no_more_than_chance():
    """−2 log likelihood falls by χ² with the degrees of freedom of the change, or by less."""
    gains, freedom = [], []
    held: list[Fit] = []
    for seed in range(6):
        runs = free_motions(lambda x: -2.0 * x, noise=0.05, starts=(1.0,), seed=seed)
        held.clear()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                "leastaction.diagnosis.verdict.doubts_about_the_form",
                lambda fit, *_, **__: held.append(fit) or [],
            )
            la.discover(runs, ["x_dot**2", "x**2"], known={"x_dot**2": 0.5})
        for change in smooth_changes.smooth_changes(held[0]):
            gains.append(change.gain)
            freedom.append(change.freedom)
    ratio = sum(gains) / sum(freedom)
    assert 0.1 < ratio < 1.6  # above: five standard deviations of a mean over 78 degrees of freedom
    assert all(gain < 35.0 for gain in gains)


def test_a_law_without_unknown_terms_is_compared_with_smooth_changes():
    """What the changes explain counts from zero, and the true force is a change that explains much."""
    runs = free_motions(lambda x: -2.0 * x, noise=0.03, starts=(1.0,))
    setup = build_problem(runs, Request(la.Library(["x_dot**2", "x**2"], ["x"]), {"x_dot**2": 0.5}))
    grid, curve = Grid.lay(setup.problem, setup.scales.per_second), setup.scales.smooth
    start = grid.start(Structure([]), curve.control_points, np.zeros(2), curve.noise_std)
    fit = replace(grid.fit(Structure([]), start), status="converged")
    changes = smooth_changes.smooth_changes(fit)
    assert [change.kind for change in changes] == ["potential", "kinetic", "potential and kinetic"]
    assert changes[0].gain > 5.0 * changes[0].freedom


def test_a_shape_parameter_takes_up_a_change_of_its_own_kind():
    """With the right family no smooth change is left, however many bumps are offered."""
    runs = free_motions(lambda x: -3.0 * (np.exp(-x) - np.exp(-2.0 * x)), noise=0.03)
    terms = ["x_dot**2", "exp(-{a}*x)", "exp(-2*{a}*x)"]
    model = la.discover(runs, terms, known={"x_dot**2": 0.5})
    assert model.fit.status == "ok", model.fit.warnings
    assert not _codes(model)


# ------------------------------------------------------------------------------------ a part without a sensor
def searched(kind: str, seed: int):
    """A search of a machine of the benchmark, and the truth."""
    data, machine = draw(kind, seed)
    return run_search(begin_search(build_problem(data, Request(*asked(data))))), machine


@pytest.mark.parametrize(
    "kind",
    ["absorber", *(pytest.param(kind, marks=pytest.mark.thorough) for kind in ("elastic", "chain", "free"))],
)
def test_a_part_without_a_sensor_is_noticed_by_its_resonance(kind):
    search, machine = searched(kind, 0)
    (found,) = unmeasured_part(search)
    assert found.subject == (machine.names[-1],)
    frequency = found.values.get("frequency")
    if search.problem.trajectories.driven:
        assert frequency == pytest.approx(machine.part / (2.0 * np.pi), rel=0.15)
    else:  # another spring goes with another resonance
        assert frequency is None
    assert found.values["explained"] > 0.7
    assert found.values["terms"] == ("h_dot**2", f"({machine.names[-1]}-h)**2")


@pytest.mark.parametrize(
    ("kind", "seed", "coupling"),
    [
        ("crane, large swings", 1, "x_dot*h_dot*cos(h)"),
        pytest.param(
            "pendulums, large swings", 0, "theta_dot*h_dot*cos(theta-h)", marks=pytest.mark.thorough
        ),
        pytest.param("box, large swings", 3, "h**2*theta_dot**2", marks=pytest.mark.thorough),
    ],
)
def test_a_part_that_moves_far_is_noticed(kind, seed, coupling):
    """No resonator explains half of what these do, and one of them a seventh."""
    search, machine = searched(kind, seed)
    (found,) = unmeasured_part(search)
    assert found.values["frequency"] == pytest.approx(machine.part / (2.0 * np.pi), rel=0.05)
    assert found.values["explained"] > 0.85
    assert found.values["terms"][1] == coupling


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "seed", "hidden_in"), [("pendulums, large swings", 704, 1.0), ("box, large swings", 703, 0.25)]
)
def test_a_part_is_noticed_in_the_band_where_it_shows(kind, seed, hidden_in, monkeypatch):
    """Noise hides the first in the upper band; the second is faster than the lower one."""
    search, machine = searched(kind, seed)
    (found,) = unmeasured_part(search)
    assert found.values["frequency"] == pytest.approx(machine.part / (2.0 * np.pi), rel=0.05)
    monkeypatch.setattr(parts, "_BANDS", (hidden_in,))
    assert unmeasured_part(search) == []


@pytest.mark.parametrize(
    ("form", "turn", "weights"),
    [
        (far_parts.LOAD, "b*z", ["1/(2*b**2)", "1/b", "w/b**2"]),
        (far_parts.SECOND, "z", ["1/(2*b)", "1", "w/b"]),
        (far_parts.SLIDE, "z", ["1/2", "1/2", "-b", "-w/2"]),
    ],
)
def test_parts_that_move_far_obey_the_law_that_is_offered(form, turn, weights):
    """Their Lagrangian has the acceleration of the form, and its force but for terms of q alone."""
    t, names = sp.Symbol("t"), sp.symbols("w b z u c q v a")
    z, q = sp.Function("z")(t), sp.Function("q")(t)
    h = sp.sympify(turn, {"z": z})
    own = {"q": q, "q_dot": q.diff(t), "h": h, "h_dot": h.diff(t)}
    terms = [sp.sympify(text.format(q="q", h="h"), own) for text in form.terms]
    law = sum(sp.sympify(x) * term for x, term in zip(weights, terms, strict=True))
    derivatives = [z.diff(t, 2), q.diff(t, 2), z.diff(t), q.diff(t), z, q]
    plain = list(zip(derivatives, sp.symbols("c a u v z q"), strict=True))
    of_z, of_q = (sp.lambdify(names, (law.diff(x.diff(t)).diff(t) - law.diff(x)).subs(plain)) for x in (z, q))
    for w, b, q0, v, a, *states in np.random.default_rng(0).uniform(0.3, 1.4, (5, 9)):
        forces = list[float]()
        for z0, u in np.reshape(states, (2, 2)):
            c = form.acceleration(w, b, z0, q0, v, a)
            assert of_z(w, b, z0, u, c, q0, v, a) == pytest.approx(0.0, abs=1e-12)
            forces.append(of_q(w, b, z0, u, c, q0, v, a) + form.force(w, b, z0, u, c, q0, v, a))
        assert forces[0] == pytest.approx(forces[1], abs=1e-12)


@pytest.mark.thorough
def test_two_parts_are_noticed_by_their_resonances():
    search, machine = searched("two parts", 403)
    (found,) = unmeasured_part(search)
    values = found.values
    assert values["frequency"] == pytest.approx(2.0 * machine.part / (2.0 * np.pi), rel=0.1)
    assert values["second_frequency"] == pytest.approx(machine.part / (2.0 * np.pi), rel=0.02)
    assert values["explained"] > 0.95
    assert values["hidden"] == "h, h1"
    assert values["terms"] == ("h_dot**2", "(x-h)**2", "h1_dot**2", "(x-h1)**2")


@pytest.mark.thorough
def test_a_part_is_noticed_where_a_wrong_law_has_bent_the_curve():
    search, machine = searched("elastic", 832)
    assert unmeasured_part(search) == []
    (found,) = unmeasured_part(search, suspect=True)
    assert found.values["frequency"] == pytest.approx(machine.part / (2.0 * np.pi), rel=0.02)


def part_that_leaves(share: float, omegas: list[float]) -> parts._Part:
    """Parts that leave some share of an equation error."""
    left = np.tile([1.0, -1.0], 200)
    part = np.full(400, np.sqrt(1.0 / share - 1.0))
    return parts._Part(0, np.array([part + left, part]), np.array([[omega, 0.05] for omega in omegas]))


@pytest.mark.parametrize(
    ("share", "turns", "omegas", "contested", "holds"),
    [
        (0.4, 13.0, [10.0], False, True),
        (0.5, 13.0, [10.0], False, False),
        (0.4, 11.0, [10.0], False, False),
        (0.2, 11.0, [10.0], False, True),
        (0.2, 13.0, [10.0], True, False),
        (0.05, 13.0, [10.0], True, True),
        (0.2, 13.0, [10.0, 15.0], False, False),
        (0.05, 13.0, [10.0, 15.0], False, True),
        (0.05, 13.0, [10.0, 60.0], False, False),
        (0.05, 13.0, [4.0], False, False),
    ],
)
def test_how_much_a_part_has_to_explain(share, turns, omegas, contested, holds):
    part = part_that_leaves(share, omegas)
    assert part.left == pytest.approx(share)
    assert part.holds((1.0, 5.0), turns * 2.0 * np.pi / min(omegas), contested) is holds


def test_a_part_has_to_act_in_every_quarter():
    part = part_that_leaves(0.05, [10.0])
    assert part.holds((1.0, 5.0), 60.0, False)
    whole, force = part.errors
    weak = replace(part, errors=np.array([np.where(np.arange(whole.size) < 100, 0.5 * force, whole), force]))
    assert weak.left < 0.15
    assert weak.size == pytest.approx(0.5)
    assert not weak.holds((1.0, 5.0), 60.0, False)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["late", "stop", "dry", "clock", "drag"])
def test_what_is_no_part_is_not_taken_for_one(kind):
    assert unmeasured_part(searched(kind, 0)[0]) == []


@pytest.mark.thorough
def test_few_rows_say_nothing_of_a_part():
    search, _ = searched("absorber", 0)
    data = search.problem.trajectories
    short = Trajectories([t.rows(slice(0, 40)) for t in data])
    again = run_search(begin_search(build_problem(short, Request(la.Library.mechanical(["x"]), {}, ()))))
    assert unmeasured_part(again) == []


@pytest.mark.thorough
def test_a_part_that_is_noticed_can_be_declared_as_the_remedy_says():
    data, machine = draw("absorber", 0)
    library = la.Library.mechanical(["x"])
    model = discover(data, library, dissipation=["x_dot**2/2"])
    (found,) = findings_of(model, "unmeasured-part")
    assert model.fit.status != "ok"
    values = found.values
    again = discover(
        data,
        la.Library([*(term.text for term in library), *values["terms"]], ["x", values["hidden"]]),
        dissipation=["x_dot**2/2", values["friction"]],
        hidden=[values["hidden"]],
    )
    assert again.fit.status == "ok"
    numbers = {term.expression: term.coefficient for term in again.terms}
    mass, spring = (numbers[text] for text in values["terms"])
    assert np.sqrt(-spring / mass) == pytest.approx(machine.part, rel=0.02)


@pytest.mark.thorough
def test_a_load_that_swings_far_can_be_declared_as_the_remedy_says():
    data, machine = draw("crane, large swings", 1)
    model = discover(data, la.Library.mechanical(["x"]), dissipation=["x_dot**2/2"])
    (found,) = findings_of(model, "unmeasured-part")
    values = found.values
    again = discover(
        data,
        la.Library(["x_dot**2", "x**2", *values["terms"]], ["x", values["hidden"]]),
        dissipation=["x_dot**2/2", values["friction"]],
        hidden=[values["hidden"]],
    )
    assert again.fit.status == "ok"
    numbers = {term.expression: term.coefficient for term in again.terms}
    assert np.sqrt(numbers["cos(h)"] / (2.0 * numbers["h_dot**2"])) == pytest.approx(machine.part, rel=0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("number", [2, 703])
def test_a_part_is_looked_for_where_cancelling_terms_hide_the_error(number):
    """The terms of these pendulums grow, and the error beside them seems small.

    Rounding decides whether such a fit converges, and to which terms; the part is found in any case.
    """
    data, _ = draw("pendulums", number)
    library, known, friction = asked(data)
    model = discover(data, library, known=known, dissipation=friction)
    assert len(findings_of(model, "unmeasured-part")) == 1
