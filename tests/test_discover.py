"""discover(): systems found again from noisy recordings, whatever the units, gaps and sequence of terms.

The motions come from accelerations written out by hand, so that nothing of the package is its own oracle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import leastaction as la
from helpers import assert_finds, coefficients_of, record

DUFFING_LIBRARY = ["x_dot**2", "x**2", "x**4", "x", "x**3", "x**2*x_dot**2", "x**6", "x_dot**4"]
DUFFING_TRUTH = {"x_dot**2": 0.5, "x**2": -0.5, "x**4": -0.2}
KINETIC = {"x_dot**2": 0.5}

PENDULUM_LIBRARY = [
    "theta_dot**2",
    "cos(theta)",
    "sin(theta)",
    "cos(2*theta)",
    "theta_dot**2*cos(theta)",
    "theta_dot**4",
]
FRICTION = ["theta_dot**2/2", "theta_dot**4"]

CART_LIBRARY = [
    "x_dot**2",
    "theta_dot**2",
    "x_dot*theta_dot*cos(theta)",
    "cos(theta)",
    "x**2",
    "x",
    "theta**2",
    "x_dot*theta_dot",
    "theta_dot**2*cos(theta)",
    "x_dot**2*cos(theta)",
    "sin(theta)",
    "x*theta",
]
CART_TRUTH = {
    "x_dot**2": 1.5,
    "theta_dot**2": 0.5,
    "x_dot*theta_dot*cos(theta)": 1.0,
    "cos(theta)": 9.81,
    "x**2": -5.0,
}


def duffing(noise=0.01, seed=0, **options) -> la.Trajectories:
    """ẍ = −x − 0.8 x³."""
    starts = [([1.8], [0.0]), ([0.4], [2.5])]
    return record(
        lambda q, v, f: -q - 0.8 * q**3, starts, ["x"], duration=8.0, noise=noise, seed=seed, **options
    )


def pendulum(viscous=0.15, coulomb=0.0, speed=2.0, noise=0.01, driven=True, trials=2) -> la.Trajectories:
    """θ̈ = −9.81 sin θ − c θ̇ − μ sign θ̇ + τ, the sign rounded off below a millimetre a second."""

    def acceleration(q, v, f):
        push = 0.0 if f is None else f
        return -9.81 * np.sin(q) - viscous * v - coulomb * v / np.sqrt(v**2 + 1e-6) + push

    def torque(k, t):
        return (2.0 * np.sin(1.7 * t + k) + 1.5 * np.sin(4.1 * t + 2 * k))[:, None]

    starts = [([1.2], [speed]), ([-0.5], [2.0]), ([0.3], [-2.0])][:trials]
    forcing = torque if driven else None
    return record(acceleration, starts, ["theta"], duration=8.0, rate=60.0, noise=noise, forcing=forcing)


def cart(driven=True) -> la.Trajectories:
    """Cart (2 kg) on a spring with a pendulum (1 kg, 1 m); the force acts on the cart only."""

    def acceleration(q, v, f):
        s, c = np.sin(q[1]), np.cos(q[1])
        mass = np.array([[3.0, c], [c, 1.0]])
        push = np.array([s * v[1] ** 2 - 10.0 * q[0], -9.81 * s])
        return np.linalg.solve(mass, push if f is None else push + f)

    def force(k, t):
        return np.column_stack([4.0 * np.sin(2.1 * t + k) + 3.0 * np.cos(3.7 * t - k), 0.0 * t])

    starts = [([0.3, 0.8], [0.0, 0.0]), ([-0.2, -0.5], [0.5, 1.0])]
    options = dict(duration=8.0, rate=60.0, noise=[0.005, 0.01], forcing=force if driven else None)
    return record(acceleration, starts, ["x", "theta"], **options)


def changed(data: la.Trajectories, **functions) -> la.Trajectories:
    """The recordings with t, q or forces put through functions."""
    return la.Trajectories(
        [
            replace(
                d,
                **{
                    name: None if getattr(d, name) is None else f(getattr(d, name))
                    for name, f in functions.items()
                },
            )
            for d in data
        ]
    )


def assert_same_model(a, b, factors=None, *, rtol=2e-3, of_error=0.05) -> None:
    """Coefficients of b are those of a times the factors, to a small part of their standard errors."""
    factors = factors or {}
    assert set(coefficients_of(a)) == set(coefficients_of(b))
    others = {t.expression: t for t in (*b.terms, *b.dissipation)}
    for term in (*a.terms, *a.dissipation):
        factor, other = factors.get(term.expression, 1.0), others[term.expression]
        slack = of_error * abs(factor) * term.standard_error + 1e-9 * abs(factor * term.coefficient)
        assert abs(other.coefficient - factor * term.coefficient) <= slack, term.expression
        assert other.standard_error == pytest.approx(abs(factor) * term.standard_error, rel=0.02, abs=0.0)
    assert a.fit.status == b.fit.status


# ------------------------------------------------------------------------------ round trips
@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.01, 0.05])
def test_duffing_oscillator(noise):
    model = la.discover(duffing(noise), DUFFING_LIBRARY, KINETIC)
    if noise:
        assert_finds(model, DUFFING_TRUTH)
        np.testing.assert_allclose(model.noise_std, noise, rtol=0.1)
        np.testing.assert_allclose(model.fit.chi2_per_sample, 1.0, atol=0.15)
    else:
        found = coefficients_of(model)
        assert found == pytest.approx(DUFFING_TRUTH, rel=1e-4)
    assert model.fit.status == "ok"
    assert model.fit.warnings == ()


def test_another_term_may_be_the_known_one():
    model = la.discover(duffing(), DUFFING_LIBRARY, {"x**4": -0.2})
    assert_finds(model, DUFFING_TRUTH)


def test_coupled_oscillators():
    """Two masses, three springs, one of them hardening."""

    def acceleration(q, v, f):
        x, y = q
        return np.array([-4.0 * x - (x - y) - 0.5 * x**3, 0.5 * (-6.0 * y - (y - x))])

    starts = [([1.0, -0.5], [0.0, 0.0]), ([0.2, 1.0], [1.0, -1.0]), ([-1.0, 0.4], [0.5, 1.0])]
    data = record(acceleration, starts, ["x", "y"], duration=6.0, rate=60.0, noise=0.005)
    library = [
        "x_dot**2",
        "y_dot**2",
        "x_dot*y_dot",
        "x**2",
        "y**2",
        "x*y",
        "x**4",
        "y**4",
        "x",
        "y",
        "x**2*y**2",
        "x*y**3",
    ]
    truth = {"x_dot**2": 0.5, "y_dot**2": 1.0, "x**2": -2.5, "y**2": -3.5, "x*y": 1.0, "x**4": -0.125}
    model = la.discover(data, library, {"x_dot**2": 0.5})
    assert_finds(model, truth, relative=0.1)
    assert model.fit.status == "ok"


def test_pendulum_with_friction_and_a_known_torque():
    model = la.discover(pendulum(), PENDULUM_LIBRARY, dissipation=FRICTION)
    assert_finds(model, {"theta_dot**2": 0.5, "cos(theta)": 9.81, "theta_dot**2/2": 0.15}, relative=0.03)
    assert [t.expression for t in model.dissipation] == ["theta_dot**2/2"]
    assert model.fit.status == "ok"


def test_viscous_and_coulomb_friction_are_told_apart():
    data = pendulum(viscous=0.1, coulomb=0.25, noise=0.005, trials=3)
    model = la.discover(data, PENDULUM_LIBRARY, dissipation=[*FRICTION, "abs(theta_dot)"])
    assert {t.expression for t in model.terms} == {"theta_dot**2", "cos(theta)"}
    assert model.fit.status == "ok"
    viscous, coulomb = sorted(model.dissipation, key=lambda t: "sqrt" in t.expression)
    assert viscous.expression == "theta_dot**2/2"
    assert viscous.coefficient == pytest.approx(0.1, abs=4.0 * viscous.standard_error)
    # |v| is smoothed near v = 0, and the text says so
    assert coulomb.expression.startswith("sqrt(theta_dot**2 + ")
    assert coulomb.coefficient == pytest.approx(0.25, abs=4.0 * coulomb.standard_error)
    assert coulomb.standard_error < 0.02
    assert any("smoothed" in note for note in model.diagnostics.notes)


def test_friction_is_not_invented():
    model = la.discover(pendulum(viscous=0.0), PENDULUM_LIBRARY, dissipation=[*FRICTION, "abs(theta_dot)"])
    assert_finds(model, {"theta_dot**2": 0.5, "cos(theta)": 9.81})


def test_force_on_one_coordinate_only():
    model = la.discover(cart(), CART_LIBRARY)
    assert_finds(model, CART_TRUTH, relative=0.01)
    assert not any(t.known for t in model.terms)
    assert model.fit.status == "ok"


def test_passive_cart_with_a_known_coefficient():
    model = la.discover(cart(driven=False), CART_LIBRARY, {"cos(theta)": 9.81})
    assert_finds(model, CART_TRUTH, relative=0.02)


def test_found_model_forecasts_a_motion_it_has_not_seen():
    model = la.discover(duffing(1e-3), DUFFING_LIBRARY, KINETIC)
    unseen = record(lambda q, v, f: -q - 0.8 * q**3, [([-1.0], [1.7])], ["x"], duration=10.0, noise=0.0)[0]
    forecast = model.simulate([-1.0], [1.7], unseen.t)
    np.testing.assert_allclose(forecast.q, unseen.q, rtol=0, atol=0.02)


# ----------------------------------------------------------------------------- invariances
@pytest.fixture(scope="module")
def duffing_model():
    return la.discover(duffing(), DUFFING_LIBRARY, KINETIC)


@pytest.fixture(scope="module")
def pendulum_model():
    return la.discover(pendulum(), PENDULUM_LIBRARY, dissipation=FRICTION)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_unit_of_the_coordinate(duffing_model, unit):
    model = la.discover(changed(duffing(), q=lambda q: unit * q), DUFFING_LIBRARY, KINETIC)
    assert_same_model(duffing_model, model, {"x**4": unit**-2.0})
    np.testing.assert_allclose(model.noise_std, unit * duffing_model.noise_std, rtol=1e-3)


@pytest.mark.parametrize("unit", [1.0 / 60.0, 1e3])
def test_unit_and_origin_of_time(duffing_model, unit):
    model = la.discover(changed(duffing(), t=lambda t: unit * (t + 100.0)), DUFFING_LIBRARY, KINETIC)
    assert_same_model(duffing_model, model, {"x**2": unit**-2.0, "x**4": unit**-2.0})


@pytest.mark.parametrize("factor", [1e-4, 1e5])
def test_scale_of_the_known_coefficient(duffing_model, factor):
    model = la.discover(duffing(), DUFFING_LIBRARY, {"x_dot**2": 0.5 * factor})
    assert_same_model(duffing_model, model, dict.fromkeys(DUFFING_TRUTH, factor))


@pytest.mark.parametrize("factor", [1e-4, 1e5])
def test_unit_of_the_forces(pendulum_model, factor):
    data = changed(pendulum(), forces=lambda f: factor * f)
    model = la.discover(data, PENDULUM_LIBRARY, dissipation=FRICTION)
    assert_same_model(pendulum_model, model, dict.fromkeys(coefficients_of(model), factor))


def test_factors_in_the_candidates(duffing_model):
    library = [f"1000*{text}" if k % 2 else f"{text}/1000" for k, text in enumerate(DUFFING_LIBRARY)]
    model = la.discover(duffing(), library, {"x_dot**2/1000": 500.0})
    expected = [0.5e3, duffing_model.terms[1].coefficient / 1e3, duffing_model.terms[2].coefficient * 1e3]
    assert [t.expression for t in model.terms] == ["x_dot**2/1000", "1000*x**2", "x**4/1000"]
    np.testing.assert_allclose([t.coefficient for t in model.terms], expected, rtol=1e-3)


@pytest.mark.parametrize("seed", [0, 1])
def test_sequence_of_candidates(duffing_model, seed):
    library = np.random.default_rng(seed).permutation(DUFFING_LIBRARY).tolist()
    model = la.discover(duffing(), library, KINETIC)
    assert_same_model(duffing_model, model)
    assert [t.expression for t in model.terms] == [t for t in library if t in DUFFING_TRUTH]


def test_sequence_of_coordinates():
    a = la.discover(cart(), CART_LIBRARY)
    data = [
        la.Trajectory(d.t, d.q[:, ::-1], forces=d.forces[:, ::-1], coordinates=["theta", "x"]) for d in cart()
    ]
    b = la.discover(data, CART_LIBRARY)
    assert_same_model(a, b)
    np.testing.assert_allclose(b.noise_std[::-1], a.noise_std, rtol=1e-3)


def test_sequence_of_trajectories(duffing_model):
    model = la.discover(list(duffing())[::-1], DUFFING_LIBRARY, KINETIC)
    assert_same_model(duffing_model, model)


def test_null_and_repeated_candidates_are_dropped_and_named(duffing_model):
    extra = ["x*x_dot", "x**2*x_dot", "1", "x_dot", "2*x**2"]
    model = la.discover(duffing(), [*DUFFING_LIBRARY, *extra], KINETIC)
    assert_same_model(duffing_model, model)
    assert {d.term.text for d in model.diagnostics.dropped} == set(extra)


def test_total_time_derivatives_within_candidates_change_nothing(duffing_model):
    """Gauge: x_dot**2 + 3 x x_dot is the same physics as x_dot**2."""
    library = ["x_dot**2+3*x*x_dot", "x**2+x_dot", "x**4-x_dot*x**3", *DUFFING_LIBRARY[3:]]
    model = la.discover(duffing(), library, {library[0]: 0.5})
    assert [t.expression for t in model.terms] == library[:3]
    np.testing.assert_allclose(
        [t.coefficient for t in model.terms], [t.coefficient for t in duffing_model.terms], rtol=1e-6
    )


def test_mirror_image_turns_the_sign_of_odd_terms():
    def acceleration(q, v, f):
        return -q - 0.6 * q**2 - 0.8 * q**3

    data = record(acceleration, [([1.5], [0.0]), ([0.4], [2.0])], ["x"], duration=8.0)
    a = la.discover(data, DUFFING_LIBRARY, KINETIC)
    b = la.discover(changed(data, q=np.negative), DUFFING_LIBRARY, KINETIC)
    assert_finds(a, {**DUFFING_TRUTH, "x**3": -0.2})
    assert_same_model(a, b, {"x**3": -1.0})


def test_time_reversal_leaves_mechanics_and_turns_friction_round():
    a = la.discover(pendulum(driven=False), PENDULUM_LIBRARY, {"theta_dot**2": 0.5}, FRICTION)
    data = changed(pendulum(driven=False), q=lambda q: q[::-1])
    b = la.discover(data, PENDULUM_LIBRARY, {"theta_dot**2": 0.5}, FRICTION)
    assert_finds(a, {"theta_dot**2": 0.5, "cos(theta)": 9.81, "theta_dot**2/2": 0.15})
    for name, sign in {"theta_dot**2": 1, "cos(theta)": 1, "theta_dot**2/2": -1}.items():
        assert coefficients_of(b)[name] == pytest.approx(sign * coefficients_of(a)[name], rel=1e-3)
    # friction that feeds energy in is not believed
    assert a.fit.status == "ok"
    assert b.fit.status == "doubtful"
    assert any("negative" in warning for warning in b.fit.warnings)


def test_wrapped_angles_are_unwrapped():
    data = pendulum(speed=7.0)  # goes over the top
    assert max(np.abs(d.q).max() for d in data) > np.pi
    wrapped = changed(data, q=lambda q: (q + np.pi) % (2 * np.pi) - np.pi)
    a = la.discover(data, PENDULUM_LIBRARY, dissipation=FRICTION)
    b = la.discover(wrapped, PENDULUM_LIBRARY, dissipation=FRICTION, angles=["theta"])
    assert_finds(a, {"theta_dot**2": 0.5, "cos(theta)": 9.81, "theta_dot**2/2": 0.15})
    assert_same_model(a, b)
    assert any("jumps of 2π removed from theta" in note for note in b.diagnostics.notes)


# ------------------------------------------------------------------------------ imperfect data
def test_missing_samples_and_gaps():
    def holes(q):
        q = q.copy()
        q[np.random.default_rng(1).random(q.shape) < 0.2] = np.nan
        q[150:165] = np.nan
        return q

    model = la.discover(changed(duffing(), q=holes), DUFFING_LIBRARY, KINETIC)
    assert_finds(model, DUFFING_TRUTH)
    assert model.fit.status == "ok"


def test_samples_missing_in_one_coordinate_only():
    def holes(q):
        q = q.copy()
        q[::2, 1] = np.nan
        q[100:110, 0] = np.nan
        return q

    model = la.discover(changed(cart(), q=holes), CART_LIBRARY)
    assert_finds(model, CART_TRUTH)


def test_irregular_times():
    model = la.discover(duffing(irregular=True), DUFFING_LIBRARY, KINETIC)
    assert_finds(model, DUFFING_TRUTH)


def test_trajectories_of_different_length_and_rate():
    a, b = duffing(), duffing(seed=5)
    data = [
        la.Trajectory(a[0].t[::2], a[0].q[::2], coordinates=["x"]),
        la.Trajectory(b[1].t[:250] + 3.0, b[1].q[:250], coordinates=["x"]),
    ]
    assert_finds(la.discover(data, DUFFING_LIBRARY, KINETIC), DUFFING_TRUTH)


def test_one_trajectory_is_enough_when_it_moves_enough():
    """At one energy kinetic terms of degree four could not be told apart from the others."""
    data = record(lambda q, v, f: -q - 0.8 * q**3, [([1.8], [0.0])], ["x"], duration=16.0, noise=0.005)
    library = ["x_dot**2", "x**2", "x**4", "x", "x**3", "x**6"]
    assert_finds(la.discover(data[0], library, KINETIC), DUFFING_TRUTH)


# -------------------------------------------------------------------------- what cannot be found
def test_missing_spring_term_is_doubtful():
    model = la.discover(duffing(), ["x_dot**2", "x**2", "x"], KINETIC)
    assert model.fit.status == "doubtful"
    assert any("cannot explain x" in warning for warning in model.fit.warnings)


def test_missing_friction_is_doubtful():
    data = pendulum(viscous=0.1, coulomb=0.5, noise=0.005)
    model = la.discover(data, PENDULUM_LIBRARY)
    assert model.fit.status == "doubtful"
    assert any("friction" in warning for warning in model.fit.warnings)


def test_force_that_was_not_recorded_is_doubtful():
    data = changed(pendulum(), forces=lambda f: None)
    model = la.discover(data, PENDULUM_LIBRARY, {"theta_dot**2": 0.5}, FRICTION)
    assert model.fit.status == "doubtful"


def test_candidates_that_the_data_cannot_tell_apart_are_doubtful():
    """On x > 0 the candidates x**2 and x abs(x) are the same function: either would do."""
    data = changed(duffing(), q=lambda q: q + 5.0)
    library = ["x_dot**2", "x**2", "x", "x*abs(x)", "x**3", "x**4"]
    model = la.discover(data, library, KINETIC)
    assert len(model.terms) == 5
    assert model.fit.status == "doubtful"


def test_small_motions_determine_the_frequency_only():
    """A pendulum of 3°: nothing but a harmonic oscillator can be seen, in one free term."""
    acceleration = lambda q, v, f: -9.81 * np.sin(q)  # noqa: E731
    data = record(acceleration, [([0.05], [0.0]), ([0.0], [0.1])], ["theta"], duration=8.0, noise=5e-4)
    model = la.discover(data, ["theta_dot**2", "cos(theta)", "theta**2", "theta**4"], {"theta_dot**2": 0.5})
    (found,) = (t for t in model.terms if not t.known)
    stiffness = {"cos(theta)": 1.0, "theta**2": -2.0}[found.expression] * found.coefficient
    assert stiffness == pytest.approx(9.81, rel=5e-3)


@pytest.mark.parametrize("seed", range(3))
def test_pure_noise_gives_no_confident_model(seed):
    rng = np.random.default_rng(seed)
    data = la.Trajectory(np.arange(400) / 50.0, rng.standard_normal((400, 1)), coordinates=["x"])
    try:
        model = la.discover(data, DUFFING_LIBRARY, KINETIC)
    except la.DataError:
        return
    assert model.fit.status == "doubtful"


# ------------------------------------------------------------------------------ wrong use
def test_passive_system_without_a_known_coefficient():
    with pytest.raises(la.InputError, match=r"L = 0 solves every equation.*known="):
        la.discover(duffing(), DUFFING_LIBRARY)
    at_rest = changed(pendulum(), forces=np.zeros_like)
    with pytest.raises(la.InputError, match="no force acts"):
        la.discover(at_rest, PENDULUM_LIBRARY)


def test_constant_coordinate():
    with pytest.raises(la.DataError, match="'x' is constant"):
        la.discover(changed(duffing(), q=lambda q: 0.0 * q + 2.0), DUFFING_LIBRARY, KINETIC)


def test_too_few_samples():
    data = la.Trajectory(np.arange(12.0), np.sin(np.arange(12.0))[:, None], coordinates=["x"])
    with pytest.raises(la.DataError, match="12 samples"):
        la.discover(data, DUFFING_LIBRARY, KINETIC)


@pytest.mark.parametrize(
    ("known", "message"),
    [
        ({"x_dot**2": np.nan}, "finite number"),
        ({"x_dot**2": True}, "finite number"),
        ({"x_dot**2": "0.5"}, "finite number"),
        ({"x_dot**2": 0.0}, "zero"),
        ({"cos(x)": 1.0}, "not among the 9"),
        ({"x*x_dot": 1.0}, "no effect"),
        (dict.fromkeys(DUFFING_LIBRARY, 1.0), "nothing is left to find"),
    ],
)
def test_bad_known_coefficients(known, message):
    with pytest.raises(la.InputError, match=message):
        la.discover(duffing(), [*DUFFING_LIBRARY, "x*x_dot"], known)


def test_other_wrong_arguments():
    with pytest.raises(la.InputError, match="method 'magic'"):
        la.discover(duffing(), DUFFING_LIBRARY, KINETIC, method="magic")
    with pytest.raises(la.InputError, match="y, but the data have x"):
        la.discover(duffing(), la.Library(["y_dot**2", "y**2"], ["y"]), {"y_dot**2": 1.0})
    with pytest.raises(ValueError, match="degree 2"):
        la.discover(duffing(), DUFFING_LIBRARY, KINETIC, degree=2)
    with pytest.raises(la.InputError, match=r"__import__|unknown|expected"):
        la.discover(duffing(), ["__import__('os')"], KINETIC)


def test_candidate_that_is_undefined_along_the_data_is_named():
    with pytest.raises(la.DataError, match=r"sqrt\(x\)"):
        la.discover(duffing(), [*DUFFING_LIBRARY, "sqrt(x)"], KINETIC)


def test_wrong_sign_of_the_known_kinetic_energy_is_explained():
    """L and −L have the same motions, but a negative mass is worth a word, whatever comes out."""
    try:
        model = la.discover(duffing(), DUFFING_LIBRARY[:4], {"x_dot**2": -0.5})
        reasons = "; ".join(model.fit.warnings)
        assert model.fit.status == "doubtful"
    except la.DataError as error:
        reasons = str(error)
    assert "mass matrix" in reasons or "sign" in reasons


# ------------------------------------------------------------------------------ the result
@pytest.mark.parametrize("degree", [3, 4, 6])
def test_other_spline_degrees(degree):
    model = la.discover(duffing(), DUFFING_LIBRARY, KINETIC, degree=degree)
    assert_finds(model, DUFFING_TRUTH)
    assert model.diagnostics.grid.degree == degree


def test_same_input_same_output(duffing_model):
    again = la.discover(duffing(), DUFFING_LIBRARY, KINETIC)
    assert coefficients_of(again) == coefficients_of(duffing_model)
    np.testing.assert_array_equal(again.covariance, duffing_model.covariance)


def test_covariance_follows_the_free_terms(pendulum_model):
    free = [t for t in (*pendulum_model.terms, *pendulum_model.dissipation) if not t.known]
    np.testing.assert_allclose(np.sqrt(np.diag(pendulum_model.covariance)), [t.standard_error for t in free])
    assert np.linalg.eigvalsh(pendulum_model.covariance)[0] > 0
    np.testing.assert_allclose(pendulum_model.covariance, pendulum_model.covariance.T)


def test_known_terms_have_no_error(duffing_model):
    known = [t for t in duffing_model.terms if t.known]
    assert [(t.expression, t.coefficient, t.standard_error) for t in known] == [("x_dot**2", 0.5, 0.0)]
    assert duffing_model.covariance.shape == (2, 2)


def test_progress_is_reported_and_data_are_left_alone():
    data = duffing()
    before = [(d.t.copy(), d.q.copy()) for d in data]
    stages = []
    la.discover(
        data, DUFFING_LIBRARY, KINETIC, progress=lambda stage, details: stages.append((stage, details))
    )
    assert {"prepare", "search", "verify"} <= {stage for stage, _ in stages}
    assert all(isinstance(details, dict) for _, details in stages)
    for d, (t, q) in zip(data, before, strict=True):
        np.testing.assert_array_equal(d.t, t)
        np.testing.assert_array_equal(d.q, q)


def test_diagnostics_describe_the_fit(duffing_model):
    diagnostics = duffing_model.diagnostics
    curves = diagnostics.curve()
    for d, curve in zip(diagnostics.trajectories, curves, strict=True):
        assert np.std(d.q - curve) == pytest.approx(duffing_model.noise_std[0], rel=0.15)
    (chosen,) = (p for p in diagnostics.path if p.chosen)
    assert set(chosen.expressions) == {"x**2", "x**4"}
    assert chosen.bic == 0.0
    assert all(p.bic >= 0.0 for p in diagnostics.path)
    assert duffing_model.provenance["data"] == duffing().digest()


def test_standard_errors_hold_over_the_whole_pipeline():
    """Structure found and |z| < 2 as often as it should be, over eight noise realisations."""
    z = []
    for seed in range(8):
        model = la.discover(duffing(0.02, seed=seed), DUFFING_LIBRARY, KINETIC)
        assert set(coefficients_of(model)) == set(DUFFING_TRUTH), seed
        z += [
            (t.coefficient - DUFFING_TRUTH[t.expression]) / t.standard_error
            for t in model.terms
            if not t.known
        ]
    assert np.mean(np.abs(z) < 2.0) >= 0.75
    assert np.abs(z).max() < 4.5
