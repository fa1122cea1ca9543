"""The systems, against derivations by hand and SymPy's; and the metrics that compare a model with them."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from sympy.calculus.euler import euler_equations
from sympy.physics.mechanics import LagrangesMethod, ReferenceFrame, dynamicsymbols

from leastaction import discover, systems
from leastaction import metrics as _metrics
from leastaction.errors import DataError, InputError
from leastaction.library import Library
from leastaction.metrics import (
    cramer_rao_bound,
    exact_support,
    forecast_horizon,
    l2_error,
    precision,
    recall,
)
from leastaction.simulation.integrate import rk4
from leastaction.systems._system import TwoSines, Uniform

NAMES = systems.names()
FURTHER = systems.further_names()
EVERY = (*NAMES, *FURTHER)
PASSIVE = [n for n in EVERY if systems.get(n).forcing is None]
# The seven in `make test`; the further ones, whose equations are longer, with the other numeric tests.
SEVEN_FIRST = [*NAMES, *(pytest.param(n, marks=pytest.mark.thorough) for n in FURTHER)]


@pytest.fixture(autouse=True)
def _warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def states(system, n_points, seed):
    rng = np.random.default_rng(seed)
    return np.moveaxis(np.array([system.initial(rng) for _ in range(n_points)]), 1, 0)


def in_time(system):
    """The Lagrangian as a function of functions of time, and these functions."""
    t = dynamicsymbols._t
    functions = [sp.Function(c)(t) for c in system.coordinates]
    q, v = system.symbols
    swap = {
        **dict(zip(v, [f.diff(t) for f in functions], strict=True)),
        **dict(zip(q, functions, strict=True)),
    }
    return system.lagrangian_expression.subs(swap, simultaneous=True), functions, t


@pytest.mark.parametrize("name", EVERY)
def test_acceleration_solves_sympys_euler_equations(name):
    system = systems.get(name).with_dissipation({})
    lagrangian, functions, t = in_time(system)
    left = [equation.lhs for equation in euler_equations(lagrangian, functions, t)]  # ∂L/∂q − d/dt ∂L/∂q̇
    n = system.n_dof
    plain = sp.symbols(f"z0:{3 * n}", real=True)
    swap = {f.diff(t, k): plain[k * n + i] for k in (2, 1, 0) for i, f in enumerate(functions)}
    left = [
        sp.sympify(e).doit().subs({k: v for k, v in swap.items() if k.is_Derivative}).subs(swap) for e in left
    ]
    residual = sp.lambdify(plain, left)
    q, v = states(system, 4, seed=1)
    forces = np.random.default_rng(2).normal(size=q.shape)
    a = system.acceleration(q, v, forces)
    for i in range(len(q)):
        assert np.allclose(np.array(residual(*q[i], *v[i], *a[i])) + forces[i], 0, atol=1e-9)


def test_dissipation_agrees_with_sympys_lagranges_method():
    friction = {"theta1_dot**2/2": 0.3, "(theta1_dot-theta2_dot)**2/2": 0.2}
    system = systems.get("double_pendulum").with_dissipation(friction)
    lagrangian, (one, two), t = in_time(system)
    d1, d2 = one.diff(t), two.diff(t)
    frame = ReferenceFrame("N")
    torques = [-0.3 * d1 - 0.2 * (d1 - d2), 0.2 * (d1 - d2)]
    # Torques as (frame, torque) along z with angular velocities that project on the two rates.
    bodies = [ReferenceFrame(f"B{i}") for i in range(2)]
    for body, rate in zip(bodies, (d1, d2), strict=True):
        body.set_ang_vel(frame, rate * frame.z)
    loads = [(body, torque * frame.z) for body, torque in zip(bodies, torques, strict=True)]
    method = LagrangesMethod(lagrangian, [one, two], forcelist=loads, frame=frame)
    method.form_lagranges_equations()
    values = dict(zip((d1, d2, one, two), (0.7, -1.2, 0.4, -0.9), strict=True))
    mass = np.array(method.mass_matrix.subs(values), dtype=float)
    force = np.array(method.forcing.subs(values), dtype=float)[:, 0]
    assert np.allclose(system.acceleration([0.4, -0.9], [0.7, -1.2]), np.linalg.solve(mass, force))
    assert np.allclose(system.mass_matrix([0.4, -0.9]), mass)


def cartesian(name):
    """Lagrangians put together from positions of the masses: an independent way to the same equations."""
    system = systems.get(name)
    q, v = system.symbols

    def energy(mass, position):
        speed = [sum(sp.diff(x, a) * b for a, b in zip(q, v, strict=True)) for x in position]
        return mass * sum(s**2 for s in speed) / 2

    def spring(k, x, d):
        return k * (x - d) ** 2 / 2

    def ball(r, theta, phi):
        return r * sp.sin(theta) * sp.cos(phi), r * sp.sin(theta) * sp.sin(phi), -r * sp.cos(theta)

    p, g = system.parameters, 9.81
    if name in FURTHER:
        return further(name, q, v, p, energy, spring)
    if name == "single_pendulum":
        place = (sp.sin(q[0]), -sp.cos(q[0]))
        return energy(1, place) - g * place[1]
    if name == "double_pendulum":
        one = (sp.sin(q[0]), -sp.cos(q[0]))
        two = (one[0] + sp.sin(q[1]), one[1] - sp.cos(q[1]))
        return energy(1, one) + energy(1, two) - g * (one[1] + two[1])
    if name == "spherical_pendulum":
        place = ball(1, *q)
        return energy(1, place) - g * place[2]
    if name == "cart_spring_pendulum":
        place = (q[0] + sp.sin(q[1]), -sp.cos(q[1]))
        return energy(p["M"], (q[0],)) + energy(1, place) - g * place[1] - spring(p["k"], q[0], p["d"])
    if name == "spherical_spring_pendulum":
        place = ball(*q)
        return energy(1, place) - g * place[2] - spring(40, q[0], 1)
    if name == "magnetic_pendulum":
        at = [(sp.cos(a), sp.sin(a)) for a in (0, 2 * sp.pi / 3, -2 * sp.pi / 3)]
        pull = sum(1 / sp.sqrt((x - q[0]) ** 2 + (y - q[1]) ** 2 + 0.09) for x, y in at)
        return energy(1, q) + pull - sp.Rational(1, 4) * (q[0] ** 2 + q[1] ** 2)
    one, two, d1, d2 = *q, *v  # the chaotic pendulum, whose bars are not points: its formula
    return (
        d1**2 * (sp.Rational(1, 24) + sp.Rational(1, 8))
        + d2**2 / 18
        + d1 * d2 * sp.cos(one - two) / 12
        + g * (sp.cos(one) / 2 + sp.cos(two) / 6)
    )


def further(name, q, v, p, energy, spring):
    """The same for the further systems."""
    g = 9.81
    if name == "triple_pendulum":
        places, at = [], (0, 0)
        for angle in q:
            at = (at[0] + sp.sin(angle), at[1] - sp.cos(angle))
            places.append(at)
        return sum(energy(1, place) - g * place[1] for place in places)
    if name == "robot_arm":
        phi, alpha, beta = q

        def in_space(out, up):
            return out * sp.cos(phi), out * sp.sin(phi), up

        elbow = (p["l1"] * sp.sin(alpha), -p["l1"] * sp.cos(alpha))
        tip = (elbow[0] + p["l2"] * sp.sin(beta), elbow[1] - p["l2"] * sp.cos(beta))
        masses = ((p["m1"], elbow), (p["m2"], tip))
        column = p["inertia"] * v[0] ** 2 / 2
        return column + sum(energy(m, in_space(*place)) - m * g * place[1] for m, place in masses)
    if name == "rotary_pendulum":
        phi, theta = q
        side, down = p["l"] * sp.sin(theta), -p["l"] * sp.cos(theta)
        place = (p["r"] * sp.cos(phi) - side * sp.sin(phi), p["r"] * sp.sin(phi) + side * sp.cos(phi), down)
        return p["inertia"] * v[0] ** 2 / 2 + energy(p["m"], place) - p["m"] * g * down
    if name == "elastic_pendulum_cart":
        x, r, theta = q
        place = (x + r * sp.sin(theta), -r * sp.cos(theta))
        springs = spring(p["k"], r, p["d"]) + spring(p["K"], x, 0)
        return energy(p["M"], (x,)) + energy(p["m"], place) - p["m"] * g * place[1] - springs
    if name in ("spring_chain", "toda_chain"):
        stretch = [b - a for a, b in zip((0, *q), (*q, 0), strict=True)]
        if name == "toda_chain":
            return energy(1, q) - sum(p["a"] * (sp.exp(-u) + u) for u in stretch)
        kinetic = sum(energy(p[f"m{i}"], (x,)) for i, x in enumerate(q, start=1))
        return kinetic - sum(p["k"] * u**2 / 2 + p["beta"] * u**4 / 4 for u in stretch)
    if name == "double_well":
        return energy(1, q) - (q[0] ** 2 - 2) ** 2 / 4
    if name == "henon_heiles":
        x, y = q
        return energy(1, q) - (x**2 + y**2) / 2 - x**2 * y + y**3 / 3
    r, phi = q
    place = (r * sp.cos(phi), r * sp.sin(phi))
    if name == "kepler_orbit":
        return energy(1, place) + p["gravity"] / r
    return energy(1, place) - p["depth"] * (1 - sp.exp(-(r - p["r0"]))) ** 2


@pytest.mark.parametrize("name", EVERY)
def test_truth_is_the_physics_up_to_a_constant(name):
    system = systems.get(name)
    q, v = system.symbols
    difference = sp.lambdify([*q, *v], cartesian(name) - system.lagrangian_expression, "numpy")
    values = difference(*np.concatenate(states(system, 20, seed=3), axis=1).T)
    assert np.ptp(np.broadcast_to(values, 20)) < 1e-10


@pytest.mark.parametrize("name", PASSIVE)
def test_energy_is_conserved(name):
    system = systems.get(name)
    (motion,) = systems.simulate_truth(system, trials=1, duration=3.0, seed=4)
    energy = system.energy(motion.q, motion.qdot)
    assert np.ptp(energy) < 1e-7
    damped = system.with_dissipation({f"{v}**2/2": 0.02 for v in system.velocities})
    lost = damped.energy(*_end(damped.simulate(motion.q[0], motion.qdot[0], [0.0, 1.0])))
    assert lost < energy[0] - 1e-4


def _end(result):
    return result.q[-1], result.qdot[-1]


@pytest.mark.parametrize("name", SEVEN_FIRST)
def test_fixed_step_agrees_with_adaptive_integrator(name):
    system = systems.get(name)
    for motion in systems.simulate_truth(system, trials=2, duration=3.0, seed=5):
        result = system.simulate(motion.q[0], motion.qdot[0], motion.t, motion.drive, rtol=1e-12, atol=1e-12)
        assert result.complete
        assert np.abs(result.q - motion.q).max() < 1e-7
        assert np.allclose(motion.qddot, system.acceleration(motion.q, motion.qdot, motion.forces))


@pytest.mark.parametrize("name", SEVEN_FIRST)
def test_a_step_of_numbers_is_a_step_of_arrays(name):
    system = systems.get(name)
    system = system.with_dissipation({f"{v}**2/2": 0.1 for v in system.velocities})
    drive = TwoSines((1.0,) * system.n_dof)(np.random.default_rng(7))
    for q, qdot in zip(*states(system, 3, seed=7), strict=True):
        ends = rk4(system.acceleration, q, qdot, [0.0, 0.01], substeps=1, forces=drive)
        step = system.step(0.01, *q, *qdot, *drive([0.0, 0.005, 0.01]).ravel())
        assert np.allclose(step, np.concatenate([end[1] for end in ends]), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("term", ["exp(x)", "log(x)", "x**2.5"])
def test_a_motion_that_leaves_the_range_of_the_law_is_drawn_again(term):
    """It runs to infinity, or to x < 0, where Python raises an error."""
    initial = Uniform(((-1.0, 1.0),), ((-3.0, 3.0),))
    law = {"x_dot**2/2": 1.0, term: -30.0 if term == "x**2.5" else 30.0}
    system = systems.MechanicalSystem("fall", "Fall", ("x",), law, tuple(law), initial)
    motions = systems.simulate_truth(system, trials=9, duration=0.3)
    assert all(np.isfinite(motion.q).all() for motion in motions)


@pytest.mark.parametrize("name", EVERY)
def test_system_is_well_formed(name):
    system = systems.get(name)
    assert 10 <= len(system.library) <= (20 if name in NAMES else 24)
    assert set(system.lagrangian) <= set(system.library)
    assert set(system.known.items()) <= set(system.lagrangian.items())
    assert bool(system.known) == (system.forcing is None)
    assert set(system.angles) <= set(system.coordinates)
    compact = systems.compact_library(name)
    truth = systems.truth_for(system, compact)
    assert {compact[k].text: c for k, c in truth.items()} == dict(system.lagrangian)
    copy = pickle.loads(pickle.dumps(system))
    q, v = states(copy, 3, seed=6)
    assert np.array_equal(copy.acceleration(q, v), system.acceleration(q, v))
    with pytest.raises(InputError, match="last axis"):
        system.acceleration([0.1] * 5, [0.1] * 5)


@pytest.mark.parametrize("make", [systems.compact_library, systems.large_library])
@pytest.mark.parametrize("name", SEVEN_FIRST)
def test_no_candidate_is_null_or_dependent(name, make):
    system, library = systems.get(name), make(name)
    columns = systems._libraries._columns(system, library.terms, "lagrangian")
    size = np.linalg.norm(columns, axis=0)
    assert (size > 0).all()
    singular = np.linalg.svd(columns / size, compute_uv=False)
    assert singular[-1] > 1e-7 * singular[0]
    assert library.dropped == ()


@pytest.mark.parametrize("name", SEVEN_FIRST)
def test_large_library_spans_the_truth(name):
    system, library = systems.get(name), systems.large_library(name)
    assert 50 <= len(library) <= (100 if name in NAMES else 120)
    truth = systems.truth_for(name, library)
    other = replace(system, lagrangian={library[k].text: c for k, c in truth.items()})
    q, v = states(system, 5, seed=7)
    assert np.allclose(other.acceleration(q, v), system.acceleration(q, v), rtol=1e-10)


def test_double_pendulum_has_six_true_terms_among_51():
    library = systems.large_library("double_pendulum")
    truth = systems.truth_for("double_pendulum", library)
    assert len(library) == 51
    assert {library[k].text: c for k, c in truth.items()} == {
        "theta1_dot**2": 1.0,
        "theta2_dot**2": 0.5,
        "theta1_dot*theta2_dot*cos(theta1)*cos(theta2)": 1.0,
        "theta1_dot*theta2_dot*sin(theta1)*sin(theta2)": 1.0,
        "cos(theta1)": 19.62,
        "cos(theta2)": 9.81,
    }


def test_truth_for_uses_identities_and_null_terms_or_refuses():
    pendulum = systems.get("single_pendulum")
    library = Library(["(theta_dot+cos(theta))**2", "cos(theta)**2", "sin(theta/2)**2", "1+theta"], ["theta"])
    assert systems.truth_for(pendulum, library) == pytest.approx({0: 0.5, 1: -0.5, 2: -19.62})
    with pytest.raises(InputError, match=r"cannot write the true term 'cos\(theta\)'"):
        systems.truth_for(pendulum, Library(["theta_dot**2", "theta**2"], ["theta"]))
    with pytest.raises(InputError, match="expected"):
        systems.truth_for(pendulum, Library(["x_dot**2"], ["x"]))
    damped = pendulum.with_dissipation({"theta_dot**2/2": 0.2})
    library = Library(["cos(theta)"], ["theta"], dissipation=["theta", "theta_dot**2"])
    assert systems.truth_for(damped, library, kind="dissipation") == {1: 0.1}


def test_names_and_parameters_are_checked():
    with pytest.raises(InputError, match="single_pendulum"):
        systems.get("quadruple_pendulum")
    with pytest.raises(InputError, match="no parameter 'mass'"):
        systems.get("single_pendulum", mass=2.0)
    heavy = systems.get("cart_spring_pendulum", M=3.0)
    assert heavy.lagrangian["x_dot**2"] == 2.0
    assert systems.get("cart_spring_pendulum").lagrangian["x_dot**2"] == 1.5


def test_recordings_are_reproducible_and_share_their_motions():
    options = {"duration": 1.0, "seed": 8}
    first = systems.generate("double_pendulum", noise=0.1, trials=3, **options)
    again = systems.generate("double_pendulum", noise=0.1, trials=3, **options)
    truth = systems.simulate_truth("double_pendulum", trials=3, **options)
    louder = systems.generate("double_pendulum", noise=0.3, trials=3, **options)
    alone = systems.generate("double_pendulum", noise=0.0, trials=1, **options)
    other = systems.generate("double_pendulum", noise=0.0, trials=1, duration=1.0, seed=9)
    assert all(np.array_equal(a.q, b.q) for a, b in zip(first, again, strict=True))
    for a, b, motion in zip(first, louder, truth, strict=True):
        assert np.allclose(b.q - motion.q, 3 * (a.q - motion.q))
        assert np.array_equal(a.forces, motion.forces)
        assert np.abs(a.forces).max() < 2.2
    assert np.array_equal(alone[0].q, truth[0].q)
    assert not np.allclose(other[0].q, truth[0].q)
    assert systems.generate("magnetic_pendulum", trials=1, duration=0.1)[0].forces is None


def test_noise_has_the_asked_size():
    options = {"trials": 2, "duration": 20.0, "seed": 0}
    truth = systems.simulate_truth("spherical_pendulum", **options)
    q = np.concatenate([m.q for m in truth])
    assert np.ptp(q[:, 1]) > 2 * np.pi  # φ is not wrapped in the data
    wrapped = np.angle(np.exp(1j * q))
    sigma = systems.noise_std("spherical_pendulum", truth, 0.1)
    assert np.allclose(sigma, 0.1 * wrapped.std(axis=0))
    noisy = systems.generate("spherical_pendulum", 0.1, **options)
    measured = np.concatenate([a.q for a in noisy]) - q
    assert np.allclose(measured.std(axis=0), sigma, rtol=0.05)
    assert np.allclose(measured.mean(axis=0), 0, atol=0.1 * sigma)
    absolute = systems.generate("spherical_pendulum", 0.02, "absolute", **options)
    assert np.allclose((np.concatenate([a.q for a in absolute]) - q).std(axis=0), 0.02, rtol=0.05)


def test_missing_samples_and_irregular_times():
    options = {"trials": 1, "duration": 4.0, "seed": 1, "noise": 0.0}
    full = systems.generate("cart_spring_pendulum", **options)[0]
    holes = systems.generate("cart_spring_pendulum", missing=0.05, **options)[0]
    assert np.isnan(holes.q).sum(axis=0).tolist() == [20, 20]
    seen = np.isfinite(holes.q)
    assert np.array_equal(holes.q[seen], full.q[seen])
    for name in ("cart_spring_pendulum", "double_pendulum"):
        system = systems.get(name)
        (motion,) = systems.simulate_truth(system, trials=1, duration=2.0, seed=1, irregular=True)
        steps = np.diff(motion.t)
        assert 0.002 < steps.min() < 0.005 < 0.015 < steps.max() < 0.018
        assert (motion.t[0], motion.t[-1]) == (0.0, 2.0)
        result = system.simulate(motion.q[0], motion.qdot[0], motion.t, motion.drive, rtol=1e-11, atol=1e-11)
        assert np.abs(result.q - motion.q).max() < 1e-8
        assert np.abs(result.qdot - motion.qdot).max() < 1e-6


def test_slow_sampling_keeps_the_motion():
    fast = systems.simulate_truth("double_pendulum", trials=1, duration=2.0, rate=100.0, seed=2)[0]
    slow = systems.simulate_truth("double_pendulum", trials=1, duration=2.0, rate=10.0, seed=2)[0]
    assert len(slow.t) == 21
    assert np.allclose(slow.q, fast.q[::10], atol=1e-12)


@pytest.mark.parametrize(
    "options",
    [
        {"trials": 0},
        {"duration": 0.0},
        {"rate": np.nan},
        {"noise": -0.1},
        {"noise_convention": "loud"},
        {"missing": 1.0},
    ],
)
def test_wrong_arguments_are_refused(options):
    with pytest.raises(InputError, match="expected"):
        systems.generate("single_pendulum", **{"trials": 1, "duration": 0.1, **options})


def test_an_unknown_option_is_named():
    with pytest.raises(TypeError, match="'lost'; expected 'missing' or 'irregular'"):
        systems.generate("single_pendulum", trials=1, duration=0.1, lost=0.1)


def test_whirling_motions_are_drawn_again():
    wild = replace(
        systems.get("single_pendulum"), initial=lambda rng: (rng.uniform(-3, 3, 1), rng.uniform(-9, 9, 1))
    )
    for motion in systems.simulate_truth(wild, trials=4, duration=2.0, seed=3):
        assert np.abs(motion.q).max() < np.pi
    never = replace(wild, accept=lambda q: False)
    with pytest.raises(InputError, match="shorter duration"):
        systems.simulate_truth(never, trials=1, duration=0.02)


_SPEED = {"double_well": [], "kepler_orbit": [], "rotary_pendulum": [pytest.mark.thorough]}


@pytest.mark.parametrize("name", [pytest.param(n, marks=_SPEED.get(n, [pytest.mark.slow])) for n in FURTHER])
def test_further_systems_are_found_from_little_data(name):
    system, library = systems.get(name), systems.compact_library(name)
    data = systems.generate(name, noise=0.01, trials=3, duration=10.0, seed=0)
    model = discover(data, library, known=system.known)
    assert {library.index(t.expression) for t in model.terms} == set(systems.truth_for(system, library))
    assert len(model.dissipation) == len(system.dissipation)
    # the arm hardly swings in 10 s: that its inertia about the column is not told from its cosine is right
    warnings = {finding.code for finding in model.fit.findings if finding.severity == "warning"}
    assert warnings <= {"competing-structures"}


# ---------------------------------------------------------------------------------------------------- metrics
def test_l2_error_over_the_union_of_supports():
    true = {"a": 3.0, "b": 4.0}
    assert l2_error(true, true) == 0.0
    assert l2_error({}, true) == 1.0
    assert l2_error({"a": 3.0, "c": 5.0}, true) == pytest.approx(np.sqrt(16 + 25) / 5)
    assert l2_error({"x_dot * y": 1.0}, {"x_dot*y": 2.0}) == 0.5
    assert l2_error([3.0, 0.0, 1.0], [3.0, 4.0, 0.0]) == pytest.approx(np.sqrt(17) / 5)
    assert l2_error({"a": 9.0, "b": 4.4}, true, exclude=["a"]) == pytest.approx(0.1)
    with pytest.raises(InputError, match="all zero"):
        l2_error({"a": 1.0}, {"a": 0.0})


def test_precision_and_recall():
    true = {"a": 1.0, "b": 2.0, "c": 0.0}
    found = {"a": 0.9, "c": 0.1, "d": 0.2, "e": 0.0}
    assert precision(found, true) == pytest.approx(1 / 3)
    assert recall(found, true) == 0.5
    assert (precision({}, true), recall({}, true)) == (0.0, 0.0)
    assert recall(found, {}) == 1.0
    assert precision(found, true, exclude=["d"]) == 0.5
    assert not exact_support(found, true)
    assert exact_support({"a": 5.0, "b": 1.0}, true)
    assert exact_support([0.0, 1.0], [0.0, 3.0])


def test_forecast_horizon():
    t = np.arange(5) * 0.5
    true = np.column_stack([np.zeros(5), np.arange(5.0)])
    predicted = true + np.array([[0, 0], [0.1, 0], [0, 0.3], [0, 0], [0, 0]])
    assert forecast_horizon(t, predicted, true, 0.2) == 0.5
    assert forecast_horizon(t, predicted, true, [0.05, 1.0]) == 0.0
    assert forecast_horizon(t, predicted, true, 1.0) == 2.0
    assert forecast_horizon(t, predicted[:4], true, 1.0) == 1.5  # a simulation that stopped
    unknown = true.copy()
    unknown[2, 1] = np.nan
    assert forecast_horizon(t, predicted, unknown, 0.2) == 2.0
    assert forecast_horizon(t, predicted + np.array([0, 2 * np.pi]), true, 0.4, periodic=[1]) == 2.0
    with pytest.raises(InputError, match="shapes"):
        forecast_horizon(t, predicted[:, :1], true, 1.0)


def by_differences(system, truth, sigma, terms, seen):
    """The bound from central differences of simulated motions: no variational equations, no filter."""
    n, p = system.n_dof, len(terms)
    information = np.zeros((p, p))
    for motion, mask in zip(truth, seen, strict=True):
        start = np.concatenate([motion.q[0], motion.qdot[0]])

        def positions(change, motion=motion, mask=mask, start=start):
            def moved(coefficients):
                step = dict(zip(terms, change[2 * n :], strict=True))
                return {k: c + step.get(k, 0.0) for k, c in coefficients.items()}

            other = replace(
                system, lagrangian=moved(system.lagrangian), dissipation=moved(system.dissipation)
            )
            y0 = start + change[: 2 * n]
            result = other.simulate(y0[:n], y0[n:], motion.t, motion.drive, rtol=1e-12, atol=1e-12)
            return (result.q / sigma)[mask]

        steps = 1e-5 * np.eye(2 * n + p)
        jacobian = np.stack([(positions(s) - positions(-s)) / 2e-5 for s in steps], axis=1)
        fisher = jacobian.T @ jacobian
        state, mixed = fisher[: 2 * n, : 2 * n], fisher[: 2 * n, 2 * n :]
        information += fisher[2 * n :, 2 * n :] - mixed.T @ np.linalg.pinv(state, rcond=1e-9) @ mixed
    return np.linalg.inv(information)


@pytest.mark.parametrize(
    ("name", "friction"),
    [
        ("single_pendulum", {"theta_dot**2/2": 0.1}),
        pytest.param("cart_spring_pendulum", {}, marks=pytest.mark.thorough),
        pytest.param("magnetic_pendulum", {"(x_dot**2+y_dot**2)/2": 0.05}, marks=pytest.mark.thorough),
    ],
)
def test_bound_agrees_with_finite_differences(name, friction):
    system = systems.get(name).with_dissipation(friction)
    truth = systems.simulate_truth(system, trials=2, duration=2.0, rate=50.0, seed=1)
    sigma = systems.noise_std(system, truth, 0.1)
    observed = systems.measure(system, truth, sigma, seed=1, missing=0.2)
    bound = cramer_rao_bound(system, truth, sigma, observed=observed)
    seen = [np.isfinite(trajectory.q) for trajectory in observed]
    expected = by_differences(system, truth, sigma, system.free, seen)
    assert bound.terms == system.free
    assert not set(bound.terms) & set(system.known)
    assert np.allclose(bound.covariance, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())
    scale = np.linalg.norm([{**system.lagrangian, **friction}[k] for k in system.free])
    assert bound.relative == pytest.approx(np.sqrt(np.trace(expected)) / scale, rel=1e-4)
    assert np.allclose(bound.standard_errors**2, np.diag(expected), rtol=1e-3)


@pytest.mark.thorough
def test_bound_when_a_cyclic_angle_is_not_measured():
    system = systems.get("spherical_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=4.0, rate=50.0, seed=2)
    observed = systems.measure(system, truth, 0.05)
    blind = [replace_q(observed[0], [1.0, np.nan])]
    bound = cramer_rao_bound(system, truth, 0.05, observed=blind)
    expected = by_differences(system, truth, 0.05, system.free, [np.isfinite(blind[0].q)])
    assert np.allclose(bound.covariance, expected, rtol=1e-3)


def replace_q(trajectory, factor):
    return type(trajectory)(
        trajectory.t,
        trajectory.q * factor,
        forces=trajectory.forces,
        coordinates=trajectory.coordinates,
    )


def test_bound_scales_with_noise_and_falls_with_data():
    system = systems.get("single_pendulum")
    truth = systems.simulate_truth(system, trials=3, duration=4.0, seed=0)
    small, large = (cramer_rao_bound(system, truth, s).relative for s in (0.01, 0.02))
    assert large == pytest.approx(2 * small)
    assert cramer_rao_bound(system, truth[:1], 0.01).relative > small
    holes = systems.generate("single_pendulum", trials=3, duration=4.0, seed=0, missing=0.5)
    assert cramer_rao_bound(system, truth, 0.01, observed=holes).relative > 1.2 * small


@pytest.mark.parametrize(
    "name", ["double_pendulum", pytest.param("magnetic_pendulum", marks=pytest.mark.thorough)]
)
def test_bound_survives_chaos(name, monkeypatch):
    truth = systems.simulate_truth(name, trials=1, duration=20.0, seed=0)
    bound = cramer_rao_bound(systems.get(name), truth, 0.05).relative
    for joint, segment in ((1e5, 0.2), (1e12, 0.2), (1e8, 0.05), (1e8, 0.5)):
        monkeypatch.setattr(_metrics, "_JOINT", joint)
        monkeypatch.setattr(_metrics, "_SEGMENT", segment)
        other = cramer_rao_bound(systems.get(name), truth, 0.05).relative
        assert other == pytest.approx(bound, rel=2e-3)


def test_bound_says_when_data_do_not_determine_the_terms():
    system = systems.get("magnetic_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=2.0, seed=0)
    with pytest.raises(DataError, match="do not determine"):
        cramer_rao_bound(system, truth, 0.1, unknown=tuple(system.lagrangian))
    assert cramer_rao_bound(system, truth, 0.1, unknown=["x**2"]).covariance.shape == (1, 1)


@pytest.mark.parametrize(
    "options",
    [
        {"noise_std": 0.0},
        {"noise_std": [0.1, np.nan]},
        {"unknown": []},
        {"unknown": ["x**7"]},
        {"observed": []},
    ],
)
def test_bound_refuses_wrong_arguments(options):
    system = systems.get("magnetic_pendulum")
    truth = systems.simulate_truth(system, trials=1, duration=0.1, seed=0)
    with pytest.raises(InputError):
        cramer_rao_bound(system, truth, **{"noise_std": 0.1, **options})
