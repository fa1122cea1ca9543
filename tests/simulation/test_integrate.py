"""One motion and many at once, and what the data leave open of a law."""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp

import leastaction as la
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.estimation.error_spectrum import _bands
from leastaction.library import Library
from leastaction.mechanics.equations import Mechanics
from leastaction.model.model import FitSummary, LagrangianModel, ModelTerm
from leastaction.simulation.integrate import rk4, simulate
from leastaction.simulation.law import Law, Spectrum, compiled_step

T = np.linspace(0.0, 2.0, 21)


def spring(q, qdot, forces):
    return -q if forces is None else forces - q


@pytest.fixture(autouse=True)
def _warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_rk4_integrates_a_batch_with_error_of_fourth_degree():
    q0 = np.array([[1.0], [2.0], [-0.5]])
    errors = []
    for substeps in (1, 2):
        q, qdot = rk4(spring, q0, 0 * q0, T, substeps)
        assert q.shape == qdot.shape == (21, 3, 1)
        errors.append(np.abs(q[..., 0] - np.cos(T)[:, None] * q0[:, 0]).max())
    assert errors[1] < 1e-6
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1)


def test_rk4_with_forces_and_uneven_times():
    t = np.sort(np.random.default_rng(0).uniform(0, 2, 30))
    q, qdot = rk4(spring, [0.0], [1.0], t, 8, forces=lambda times: np.sin(2 * times)[:, None])
    # q̈ + q = sin 2t from q(t0) = 0, q̇(t0) = 1
    s = t - t[0]
    particular, rate = -np.sin(2 * t) / 3, -2 * np.cos(2 * t) / 3
    exact = particular - particular[0] * np.cos(s) + (1 - rate[0]) * np.sin(s)
    assert np.abs(q[:, 0] - exact).max() < 1e-8
    assert qdot[0, 0] == 1.0


def test_rk4_keeps_single_precision_and_integrates_all_else_in_double():
    single, double = (np.array([[1.0], [0.3]], dtype) for dtype in (np.float32, np.float64))
    push = lambda times: np.sin(times)[:, None, None]  # noqa: E731
    forced = lambda q, v, f, t: f - q * t[:, None].astype(q.dtype)  # noqa: E731
    clock = np.array([0.0, 1.0])
    few = rk4(forced, single, 0 * single, T, 2, push, clock)
    many = rk4(forced, double, 0 * double, T, 2, push, clock)
    assert {part.dtype for part in few} == {np.dtype(np.float32)}
    np.testing.assert_allclose(few, many, atol=1e-5)
    for whole in (np.int16, np.float16):
        assert rk4(spring, np.array([1], whole), [0.0], T)[0].dtype == np.float64


def test_rk4_does_not_raise_when_a_motion_diverges():
    q, _ = rk4(lambda q, v, f: q**5, [[1.0], [30.0]], [[0.0], [0.0]], np.linspace(0, 0.5, 6), 5)
    assert np.isfinite(q[:, 0]).all()
    assert not np.isfinite(q[-1, 1]).all()


def test_rk4_backward_in_time_returns_to_the_start():
    def driven(q, qdot, force, clock):
        return force - q - 0.3 * qdot + 0.1 * np.cos(clock)[..., None]

    def push(times):
        return np.sin(2 * times)[:, None, None]

    t, clock = np.linspace(0.0, 2.0, 41) ** 1.5, np.array([0.0, 5.0])
    q, qdot = rk4(driven, [[0.2], [1.0]], [[1.0], [0.0]], t, 4, push, clock)
    back, back_rate = rk4(driven, q[-1], qdot[-1], t[::-1], 4, push, clock)
    assert np.abs(back[::-1] - q).max() < 1e-7
    assert np.abs(back_rate[::-1] - qdot).max() < 1e-7


@pytest.mark.parametrize(
    "bad", [[], [0.0, 0.0], [0.0, 1.0, 0.5], [1.0, 0.0, 0.5], [0.0, np.nan], [[0.0, 1.0]]]
)
def test_times_are_checked(bad):
    with pytest.raises(InputError, match="t "):
        rk4(spring, [1.0], [0.0], bad)
    with pytest.raises(InputError, match="t "):
        simulate(spring, [1.0], [0.0], bad)


def test_a_simulation_does_not_run_backward():
    with pytest.raises(InputError, match="strictly increasing"):
        simulate(spring, [1.0], [0.0], [1.0, 0.5])


def test_simulate_is_accurate_and_complete():
    result = simulate(spring, [1.0], [0.0], T, rtol=1e-11, atol=1e-11)
    assert (result.status, result.reason, result.complete) == ("complete", "", True)
    assert np.abs(result.q[:, 0] - np.cos(T)).max() < 1e-9
    assert np.abs(result.qdot[:, 0] + np.sin(T)).max() < 1e-9
    assert result.stop_time == T[-1]


def test_a_single_time_returns_the_start():
    result = simulate(spring, [1.0], [0.5], [3.0], forces=[[0.0]])
    assert result.complete
    assert (result.q.tolist(), result.qdot.tolist()) == ([[1.0]], [[0.5]])


def test_force_samples_are_joined_by_a_spline():
    t = np.linspace(0.0, 2.0, 101)
    from_samples = simulate(spring, [0.0], [0.0], t, np.sin(3 * t)[:, None])
    from_function = simulate(spring, [0.0], [0.0], t, lambda time: [np.sin(3 * time)])
    assert np.abs(from_samples.q - from_function.q).max() < 1e-7


def test_blow_up_in_finite_time_stops_with_what_was_reached():
    result = simulate(lambda q, v, f: 6 * q**2, [1.0], [2.0], np.linspace(0, 2, 41))  # q = 1/(1-t)²
    assert result.status == "stopped"
    assert result.reason.startswith("blow-up")
    assert 0.9 < result.t[-1] < 1.0
    assert np.isfinite(result.q).all()
    assert len(result.t) == len(result.q) == len(result.qdot)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_acceleration_that_is_not_finite_stops(value):
    result = simulate(lambda q, v, f: np.full(1, value), [1.0], [0.0], T)
    assert result.reason.startswith("blow-up")
    assert len(result.t) == 1
    later = simulate(lambda q, v, f: np.where(q < 0, value, -q), [1.0], [0.0], T)
    assert later.reason.startswith("blow-up")
    assert later.t[-1] == pytest.approx(1.5)


def test_step_limit_bounds_the_evaluations():
    result = simulate(lambda q, v, f: -1e8 * q, [1.0], [0.0], T, max_steps=50)
    assert result.reason.startswith("step limit")
    assert result.n_evaluations <= 16 * 50 + 1


def test_singular_mass_matrix_stops():
    def mass(q, qdot):
        return np.array([[0.5 - q[0]]])

    def acceleration(q, v, f):
        return np.linalg.solve(mass(q, v), np.array([1.0]))

    result = simulate(acceleration, [0.0], [1.0], T, mass_matrix=mass)
    assert result.status == "stopped"
    at_start = simulate(acceleration, [0.5], [1.0], T, mass_matrix=mass)
    assert at_start.reason.startswith("singular mass matrix")
    raised = simulate(acceleration, [0.5], [1.0], T)  # numpy raises LinAlgError inside
    assert raised.reason.startswith("singular mass matrix")
    # A step may jump over the singular place: the determinant changes its sign.
    jumped = simulate(spring, [0.0], [1.0], T, mass_matrix=mass)
    assert jumped.reason.startswith("singular mass matrix")


def test_the_earliest_event_stops_the_motion():
    def leaves(t, q, qdot):
        return q[0] - 0.5

    result = simulate(spring, [1.0], [0.0], T, events=[lambda t, q, v: q[0], leaves])
    assert result.reason == f"event leaves at t = {np.arccos(0.5):.6g}"
    assert result.stop_time == pytest.approx(np.arccos(0.5), abs=1e-8)
    assert result.t[-1] == pytest.approx(1.0)
    assert simulate(spring, [1.0], [0.0], T, events=leaves).reason == result.reason
    named = simulate(spring, [1.0], [0.0], T, events={"too far": leaves})
    assert "event too far" in named.reason


@pytest.mark.parametrize(
    ("q0", "qdot0", "forces"),
    [([1.0], [0.0, 1.0], None), ([np.nan], [0.0], None), (1.0, 0.0, None), ([1.0], [0.0], np.zeros((5, 1)))],
)
def test_wrong_shapes_are_refused(q0, qdot0, forces):
    with pytest.raises(InputError, match="expected"):
        simulate(spring, q0, qdot0, T, forces)


def test_max_steps_is_checked():
    with pytest.raises(InputError, match="max_steps"):
        simulate(spring, [1.0], [0.0], T, max_steps=0)
    with pytest.raises(InputError, match="substeps"):
        rk4(spring, [1.0], [0.0], T, substeps=0)


def forced(q, qdot, forces, t):
    """ẍ = −x + cos 2t, whatever the forces."""
    return -q + np.cos(2.0 * np.asarray(t))[..., None]


def forced_from_rest(t, begin):
    """The solution that rests at zero at the time ``begin``."""
    particular = [-np.cos(2.0 * time) / 3.0 for time in (t, begin)]
    slope = 2.0 * np.sin(2.0 * begin) / 3.0
    return particular[0] - particular[1] * np.cos(t - begin) - slope * np.sin(t - begin)


def test_simulate_passes_the_time():
    t = np.linspace(1.5, 6.0, 40)
    run = simulate(lambda *a: forced(*a), [0.0], [0.0], t, timed=True, mass_matrix=lambda q, v, t: np.eye(1))
    assert run.complete
    np.testing.assert_allclose(run.q[:, 0], forced_from_rest(t, 1.5), atol=1e-7)
    run = simulate(forced, [0.0], [0.0], t, timed=True, mass_matrix=lambda q, v, t: np.eye(1) * (t - 3.0))
    assert run.reason.startswith("singular mass matrix at t = 3.")


LAWS = {
    "dry friction": (["x"], ["x_dot**2/2", "x**2"], ["abs(x_dot)", "sqrt(x_dot**2+1/100)"], ()),
    "time": (["x", "y"], ["x_dot**2/2", "y_dot**2", "x*y*cos(3*t)", "t*y"], ["y_dot**2/2"], ()),
    "prescribed": (["x", "b"], ["x_dot**2", "b_dot**2/2", "x_dot*b_dot*cos(b)", "cos(b)"], [], (0,)),
    "roots": (["r", "b", "c"], ["r_dot**2", "(r**2+1)*b_dot**2", "b_dot*c_dot", "2*c_dot**2", "1/r"], [], ()),
    "no mass": (["x", "y"], ["x_dot**2", "x*y"], [], ()),
    "crossed masses": (["x", "y"], ["x_dot*y_dot", "x*y"], [], ()),
}


@pytest.mark.parametrize("shape", [(), (4,), (2, 4)])
@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize("name", LAWS)
def test_a_compiled_step_computes_what_arrays_do(name, forced, shape):
    coordinates, terms, friction, prescribed = LAWS[name]
    library = Library(terms, coordinates, dissipation=friction)
    values = [sp.Rational(7 + k, 10) for k in range(len(library.terms))]
    law = Law.of(Mechanics.of_terms(library.terms, values, coordinates, prescribed=prescribed))
    q, v = np.random.default_rng(1).uniform(0.6, 1.4, (2, *shape, len(coordinates)))
    each = np.arange(1.0, 5.0) if shape else np.ones(())  # of the last axis of motions
    given = {"substeps": 3, "clock": each if law.timed else None}
    if forced:
        given["forces"] = lambda t: np.multiply.outer(np.sin(t), np.multiply.outer(each, [1.0] * q.shape[-1]))
    t = np.array([0.0, 0.1, 0.15, 0.3])
    slow, fast = (rk4(law.acceleration, q, v, t, step=step, **given) for step in (None, law.step))
    assert np.allclose(slow, fast, rtol=1e-12, atol=1e-13, equal_nan=True)
    assert np.isfinite(fast).all() == (name != "no mass")


def test_a_compiled_step_eliminates_more_coordinates():
    masses = sp.Matrix(5, 5, lambda i, j: sp.Rational(1, 1 + i + j) + int(i == j))
    symbols = [sp.Symbol(f"z{k}", real=True) for k in range(10)]
    right = [sp.sin(symbols[i]) - symbols[(i + 1) % 5] * symbols[5 + i] for i in range(5)]
    step = compiled_step(masses.tolist(), right, symbols)
    function, matrix = sp.lambdify(symbols, right), np.array(masses, dtype=float)

    def acceleration(q, v, forces):
        return np.linalg.solve(matrix, np.array(function(*q, *v), dtype=float))

    q, v = np.random.default_rng(2).normal(size=(2, 5))
    slow, fast = (rk4(acceleration, q, v, [0.0, 0.1], 2, step=some) for some in (None, step))
    assert np.allclose(slow, fast, rtol=1e-12, atol=0.0)


def test_a_motion_beyond_the_range_of_numbers_ends_there():
    """Numbers raise errors where arrays hold inf and NaN."""
    library = Library(["x_dot**2/2", "exp(x)"], ["x"])
    law = Law.of(Mechanics.of_terms(library.terms, [sp.Integer(1), sp.Integer(1)], ["x"]))
    q, _ = rk4(law.acceleration, [[0.0], [6.0]], [[0.0], [9.0]], np.linspace(0, 1, 11), step=law.step)
    assert np.isfinite(q[:, 0]).all()
    assert np.isnan(q[-1, 1]).all()


def test_rk4_gives_each_motion_its_own_time():
    t, begin = np.linspace(0.0, 4.0, 81), np.array([0.0, 0.7, 11.3])
    q, _ = rk4(forced, np.zeros((3, 1)), np.zeros((3, 1)), t, clock=begin)
    for k, start in enumerate(begin):
        np.testing.assert_allclose(q[:, k, 0], forced_from_rest(t + start, start), atol=1e-7)


# ------------------------ what is left open, against linear systems whose statistics are known
OMEGA = 2.0


def oscillator(k_error: float = 0.0, density: float = 1e-12, **more) -> LagrangianModel:
    """ẍ = −k x with k = 4 ± `k_error`, and white equation errors of this spectral density."""
    terms = [
        ModelTerm("x_dot**2", 0.5, known=True),
        ModelTerm("x**2", -0.5 * OMEGA**2, 0.5 * k_error),
    ]
    fit = FitSummary("ok", 1.0, [1.0 / density])
    return LagrangianModel("x", terms, fit=fit, noise_std=[more.pop("noise", 1e-6)], **more)


def test_white_errors_of_an_oscillator_spread_as_theory_says():
    """Var x = S/(2 ω²) (t − sin 2ωt / 2ω) of ẍ + ω² x = white noise of density S."""
    t = np.linspace(0.0, 10.0, 201)
    run = oscillator(density=1e-4).simulate([1.0], [0.0], t, start_std=0.0)
    expected = np.sqrt(1e-4 / (2 * OMEGA**2) * (t - np.sin(2 * OMEGA * t) / (2 * OMEGA)))
    ratio = run.std[20:, 0] / expected[20:]
    assert ratio.min() > 0.75  # 128 motions
    assert ratio.max() < 1.3


def test_the_spread_does_not_depend_on_the_times_asked_for():
    model, last = oscillator(density=1e-4), []
    for step in (0.01, 0.05, 0.25):
        t = np.arange(0.0, 6.0 + step / 2, step)
        last.append(model.simulate([1.0], [0.0], t, start_std=0.0).std[-1, 0])
    expected = np.sqrt(1e-4 / (2 * OMEGA**2) * (6.0 - np.sin(12.0 * OMEGA) / (2 * OMEGA)))
    np.testing.assert_allclose(last, expected, rtol=0.2)


def test_errors_of_start_and_coefficients_are_carried_along():
    t = np.linspace(0.0, 5.0, 101)
    start = oscillator().simulate([1.0], [0.0], t, start_std=[[0.01], [0.06]]).std[:, 0]
    expected = np.hypot(0.01 * np.cos(OMEGA * t), 0.03 * np.sin(OMEGA * t))
    np.testing.assert_allclose(start, expected, atol=0.25 * 0.03)
    number = oscillator(k_error=0.08).simulate([1.0], [0.0], t, start_std=0.0).std[:, 0]
    np.testing.assert_allclose(number, 0.02 * t * np.abs(np.sin(OMEGA * t)), atol=0.25 * 0.1)


def test_a_start_that_is_all_there_is():
    run = oscillator().simulate([1.0], [0.0], [0.0], start_std=[[0.1], [0.2]])
    assert run.std.shape == (1, 1)
    assert 0.06 < run.std[0, 0] < 0.14


def test_forces_and_prescribed_coordinates_are_as_given():
    terms = [ModelTerm("x_dot**2", 0.5, 0.01), ModelTerm("y_dot**2", 0.5, known=True)]
    model = LagrangianModel(
        ["x", "y"],
        [*terms, ModelTerm("x*y", 1.0, known=True)],
        fit=FitSummary("ok", 1.0, [np.nan, 1e12]),
        provenance={"options": {"prescribed": ["x"]}},
    )
    t = np.linspace(0.0, 2.0, 41)
    run = model.simulate([0.0, 0.0], [0.0, 0.0], t, forces=np.ones((41, 2)), start_std=0.0)
    np.testing.assert_allclose(run.q[:, 0], 0.5 * t**2, atol=1e-9)
    assert run.std[:, 0].max() < 1e-9
    assert 0.0 < run.std[-1, 1] < 1e-4


def test_a_model_without_errors_states_none():
    bare = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
    t = np.linspace(0.0, 1.0, 11)
    assert bare.simulate([1.0], [0.0], t).std is None
    with pytest.raises(la.InputError, match="with start_std the simulation states its error"):
        bare.simulate([1.0], [0.0], t, start_std=0.0)
    result = bare.validate(
        Trajectory(np.arange(400) / 100, np.cos(2 * np.arange(400) / 100), coordinates="x")
    )
    assert result.traces[0].std is None
    assert result.traces[0].reach is None
    assert np.isnan(result.coverage).all()
    assert result.to_dict()["coverage"] == [None]


@pytest.mark.parametrize("value", [-1.0, np.nan, [1.0, 2.0, 3.0], [[[0.0]]], np.zeros((3, 1))])
def test_standard_deviations_that_make_no_sense(value):
    with pytest.raises(la.InputError, match=r"start_std is .*shape \(2, 1\)"):
        oscillator().simulate([1.0], [0.0], [0.0, 1.0], start_std=value)


def pushed(
    density: float, noise: float, n_trials: int, rate: float = 100.0, slow: float = np.inf
) -> Trajectories:
    """Oscillators under noise, white or below `slow` (Hz), exactly (a recursion), and of measurement."""
    rng, h = np.random.default_rng(5), 1.0 / (20 * rate)
    step = 20
    c, s = np.cos(OMEGA * h), np.sin(OMEGA * h)
    turn = np.array([[c, s / OMEGA], [-OMEGA * s, c]])
    trials = []
    for _ in range(n_trials):
        state, q, error, kept = np.array([1.0, 0.0]), [], 0.0, np.exp(-2.0 * np.pi * slow * h)
        for k in range(int(8 * rate) * step):
            if k % step == 0:
                q.append(state[0])
            error = kept * error + (1.0 - kept) * rng.standard_normal()
            state = turn @ state + [0.0, np.sqrt(density * h) * error]
        q = np.array(q) + noise * rng.standard_normal(len(q))
        trials.append(Trajectory(np.arange(q.size) / rate, q, coordinates=["x"]))
    return Trajectories(trials)


def test_bands_hold_where_the_equation_holds_within_its_error():
    """The start of each forecast is fitted under the same errors, which its band must count, too."""
    model = oscillator(density=1e-3, noise=1e-3)
    result = model.validate(pushed(1e-3, 1e-3, 6), horizon=2.0)
    assert result.rms[0] > 10 * result.expected_rms[0]
    assert 0.88 < result.coverage[0] < 0.99


SLOW = 0.3
"""Hz: half of the density of a slow force."""


def slow_rows(density: float) -> np.ndarray:
    """Table of the density of a first-order low-pass of white noise."""
    begins = np.concatenate([[0.0], np.geomspace(0.05, 20.0, 40)])
    middle = 0.5 * (begins + np.append(begins[1:], 30.0))
    return np.column_stack([begins, density / (1.0 + (middle / SLOW) ** 2)])


@pytest.mark.parametrize("steps", [np.full(400, 0.01), np.tile([0.005, 0.015], 200)])
def test_drawn_errors_have_the_density_of_their_spectrum(steps):
    rows = np.array([[0.0, 4.0, 0.0], [2.0, 1.0, 0.0], [10.0, 0.0, 9.0]])
    errors = Spectrum(rows[:, 0], rows[:, 1:]).draw((200, 2), steps, np.random.default_rng(0))
    assert errors.shape == (401, 200, 2, 2)
    even = errors[:-1:2] if steps[0] < 0.01 else errors[:-1]
    n, step = len(even), 4.0 / len(even)
    taper = np.sqrt(2.0) * np.sin(np.pi * (np.arange(n) + 0.5) / n)[:, None, None, None]
    density = np.mean(np.abs(np.fft.rfft(even * taper, axis=0)) ** 2, axis=(1, 2)) * step / n
    frequencies = np.fft.rfftfreq(n, step)
    slow, middle = (frequencies < 1.0), (frequencies > 3.0) & (frequencies < 9.0)
    np.testing.assert_allclose(density[slow, 0].mean(), 4.0, rtol=0.1)
    np.testing.assert_allclose(density[middle, 0].mean(), 1.0, rtol=0.1)
    assert density[frequencies > 12.0, 0].max() < 0.02
    if len(even) == 400:  # else what is faster than half of the sampling rate adds to it
        np.testing.assert_allclose(density[frequencies > 12.0, 1].mean(), 9.0, rtol=0.1)
        assert density[middle, 1].max() < 0.02


def test_bands_hold_where_the_error_of_the_equation_is_slow():
    data, rows = pushed(0.3, 1e-3, 6, slow=SLOW), slow_rows(0.3)
    model = oscillator(density=0.03, noise=1e-3)
    coverage = {}
    for name, table in (("white", ()), ("slow", rows)):
        fit = replace(model.fit, error_spectrum=table)
        coverage[name] = replace(model, fit=fit).validate(data, horizon=2.0).coverage[0]
    assert 0.88 < coverage["slow"] < 0.99
    assert coverage["white"] < coverage["slow"] - 0.05


@pytest.mark.thorough
def test_the_density_of_a_slow_force_is_found():
    data = pushed(0.3, 1e-3, 3, slow=SLOW)
    model = la.discover(data, ["x_dot**2", "x**2"], known={"x_dot**2": 0.5})
    found = np.array(model.fit.error_spectrum)
    again = la.LagrangianModel.from_dict(model.to_dict())
    assert np.array_equal(np.array(again.fit.error_spectrum), found)
    begins, density = found.T
    middle = 0.5 * (begins[:-1] + begins[1:])
    seen = middle < 3.0
    assert np.count_nonzero(seen) >= 4
    ratio = density[:-1][seen] * (1.0 + (middle[seen] / SLOW) ** 2) / 0.3
    assert np.all(np.abs(np.log(ratio)) < np.log(3.0))
    assert abs(np.log(ratio).mean()) < np.log(1.5)


@pytest.mark.parametrize("n_samples", range(20, 400, 4))
def test_every_band_of_frequencies_has_transforms(n_samples):
    steps = 0.01 * np.array([1.0, 1.0, 1.0, 1.0, 1.0 - 1e-7])  # equal but for their rounding
    frequencies = [np.fft.rfftfreq(n_samples, step) for step in steps]
    edges = _bands(frequencies)
    every = np.concatenate(frequencies)
    assert edges[-1] == min(f[-1] for f in frequencies)
    assert np.all(np.diff(edges) > 0.0)
    numbers = [
        np.where(every[(every >= low) & (every < high)] > 0.0, 2, 1).sum() for low, high in pairwise(edges)
    ]
    assert all(n >= 8 for n in numbers[:-1])
    assert numbers[-1] >= (8 if len(numbers) > 1 else 1)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ([[0.1, 1.0]], "rising from zero"),
        ([[0.0, 1.0], [0.0, 1.0]], "rising from zero"),
        ([[0.0, 1.0], [1.0]], "not a table"),
        ([[]], "not a table"),
        ([[0.0, -1.0]], "at least 0"),
        ([[0.0, 1.0, 1.0]], "expected a frequency and one for each of x"),
        ([0.0, 1.0], "expected a sequence of rows"),
    ],
)
def test_tables_of_densities_are_checked(table, message):
    with pytest.raises(InputError, match=message):
        replace(oscillator(), fit=replace(oscillator().fit, error_spectrum=table))


@pytest.mark.thorough
def test_bands_of_an_exact_law_are_those_of_noise_and_coefficients():
    data = la.systems.generate("double_pendulum", noise=0.05, trials=5, duration=8.0, seed=3)
    library = la.Library.mechanical(data.coordinates, angles=data.coordinates)
    model = la.discover(data.select([0, 1, 2]), library)
    result = model.validate(data.select([3, 4]), horizon=2.0)
    assert (np.abs(result.coverage - 0.95) < 0.03).all()
    heavier = [
        replace(term, coefficient=1.1 * term.coefficient) if term.expression == "cos(theta2)" else term
        for term in model.terms
    ]
    assert replace(model, terms=heavier).validate(data.select([3, 4]), horizon=2.0).coverage.min() < 0.85
