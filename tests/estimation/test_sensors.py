"""Columns that are functions of the coordinates: rows, start values, the joint fit, and its result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import leastaction as la
from leastaction import systems
from leastaction.errors import DataError, InputError
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.estimation.linkage import _circle
from leastaction.estimation.protocols import linearise
from leastaction.estimation.sensors import SensorFunctions
from leastaction.estimation.structure import Structure

STIFFNESS = 9.81 / 0.62  # g/l
CAMERA = ["u = {u0} + {a}*sin(theta + {tilt})", "v = {v0} + {a}*cos(theta + {tilt})"]
TRUTH = {"u0": 320.0, "v0": 100.0, "a": 200.0, "tilt": -0.03}
LIBRARY = la.Library(["theta_dot**2", "cos(theta)"], ["theta"], angles=["theta"])
KNOWN = {"theta_dot**2": 0.5}


def swing(amplitude: float, seconds: float, rate: float = 60.0):
    """Times, angle, rate, and acceleration of a pendulum."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    motion = solve_ivp(
        lambda _, s: [s[1], -STIFFNESS * np.sin(s[0])],
        (0.0, seconds),
        [amplitude, 0.0],
        t_eval=t,
        rtol=1e-11,
        atol=1e-11,
    )
    return t, motion.y[0], motion.y[1], -STIFFNESS * np.sin(motion.y[0])


def recorded(columns, names, noise, seconds: float = 6.0, amplitudes=(0.9, 0.5), seed: int = 0):
    """What sensors measure of two swings."""
    rng = np.random.default_rng(seed)
    runs = []
    for amplitude in amplitudes:
        t, *motion = swing(amplitude, seconds)
        exact = np.column_stack(columns(*motion))
        runs.append(
            la.Trajectory(t, exact + np.asarray(noise) * rng.standard_normal(exact.shape), coordinates=names)
        )
    return la.Trajectories(runs)


def pixels(q, *_):
    seen = q + TRUTH["tilt"]
    return TRUTH["u0"] + TRUTH["a"] * np.sin(seen), TRUTH["v0"] + TRUTH["a"] * np.cos(seen)


def filmed(noise: float, **more):
    return recorded(pixels, ["u", "v"], noise, **more)


def deviations(model: la.LagrangianModel, truth: dict[str, float]) -> np.ndarray:
    """Calibration numbers less the truth, in standard errors."""
    numbers = {n.name: n for n in model.calibration.numbers}
    return np.array([(numbers[k].value - x) / numbers[k].standard_error for k, x in truth.items()])


# ---------------------------------------------------------------- functions
def test_slopes_are_those_of_differences() -> None:
    functions = SensorFunctions.parse(
        ["u = {s=3}*x*sin(theta) + {o}", "g = {k}*theta_ddot + x_dot**2*{s}"], ["x", "theta"]
    )
    assert functions.names == ("s", "o", "k")
    assert functions.starts == {"s": 3.0}
    assert functions.degrees == (0, 2)
    rng = np.random.default_rng(1)
    states, times, numbers = rng.normal(size=(3, 4, 2)), np.zeros(4), rng.normal(size=3)
    h, slopes, own = functions.evaluate(states, times, numbers)
    assert np.allclose(h, functions.values(states, times, numbers), rtol=1e-14)
    step = 1e-6
    for nu, i in np.ndindex(3, 2):
        moved = states.copy()
        moved[nu, :, i] += step
        there, back = (functions.values(s, times, numbers) for s in (moved, 2.0 * states - moved))
        assert np.allclose((there - back) / (2 * step), slopes[:, nu, i], atol=1e-7)
    for k in range(3):
        move = step * np.eye(3)[k]
        there, back = (functions.values(states, times, numbers + m) for m in (move, -move))
        assert np.allclose((there - back) / (2 * step), own[:, k], atol=1e-7)


@pytest.mark.parametrize(
    ("measure", "message"),
    [
        (["u"], "expected a column"),
        (["theta = {s}*theta"], "is a coordinate"),
        (["u = theta", "u = {s}*theta"], "two functions"),
        (["u = {s}*phi"], "unknown name 'phi'"),
        (["u = {s}"], "holds no coordinate"),
        (["u = {s=1e}*theta"], "expected a number"),
        (["w = {s}*theta", "u = theta", "v = theta"], "not a column of the data"),
        (["u = {s}*theta"], "neither a coordinate"),
        (["u = {s}*__import__('os')", "v = theta"], "cannot read"),
    ],
)
def test_misuse_is_refused(measure, message) -> None:
    with pytest.raises(InputError, match=message):
        la.discover(filmed(1.0, seconds=1.0), LIBRARY, KNOWN, measure=measure)


def test_a_coordinate_that_nothing_shows_is_refused() -> None:
    library = la.Library(["theta_dot**2", "cos(theta)", "x_dot**2", "x**2"], ["theta", "x"], angles=["theta"])
    with pytest.raises(InputError, match="no measurement function"):
        la.discover(filmed(1.0, seconds=1.0), library, KNOWN, measure=CAMERA)


def test_groups_and_adam_are_refused() -> None:
    data = filmed(1.0, seconds=1.0)
    for more in ({"groups": ["a", "b"]}, {"method": "adam"}):
        with pytest.raises(InputError, match="measurement functions do not go with"):
            la.discover(data, LIBRARY, KNOWN, measure=CAMERA, **more)


def test_a_column_of_few_samples_is_refused() -> None:
    short = la.Trajectories([run.rows(slice(0, 10)) for run in filmed(1.0, amplitudes=(0.9,))])
    with pytest.raises(DataError, match="10 samples"):
        la.discover(short, LIBRARY, KNOWN, measure=CAMERA)


# ---------------------------------------------------------------- the joint problem
@pytest.fixture(scope="module")
def joint():
    """Observations, physics, and a point beside the optimum of a filmed pendulum."""
    setup = build_problem(filmed(1.0, seconds=2.0), Request(LIBRARY, KNOWN, measure=CAMERA))
    grid = Grid.lay(setup.problem, 12.0)
    structure = Structure(setup.problem.free)
    curve = grid.smooth().control_points
    start = grid.start(structure, curve, np.array([0.5, 14.0]), np.ones(1))
    return grid, grid.physics(structure)[0], start


def test_gradients_are_those_of_the_cost(joint) -> None:
    grid, physics, start = joint
    rng = np.random.default_rng(2)
    weights = replace(start.weights, slack=np.zeros(1))
    coefficients = grid.problem.completed(start.coefficients)[grid.physics(Structure(grid.problem.free))[1]]

    def cost(points, lam, kappa):
        return linearise(grid.observations, physics, points, lam, replace(weights, calibration=kappa)).cost(
            weights
        )

    here = linearise(grid.observations, physics, start.control_points, coefficients, weights).normal(weights)
    shift = 1e-3 * rng.normal(size=start.control_points.shape)
    kappa, move = weights.calibration, 1e-4 * rng.normal(size=weights.calibration.size)
    ends = [cost(start.control_points + s * shift, coefficients, kappa + s * move) for s in (1e-2, -1e-2)]
    slope = 2.0 * (here.border[:, 0] @ shift.ravel() + here.gradient[physics.n_free :] @ move)
    assert (ends[0] - ends[1]) / 2e-2 == pytest.approx(slope, rel=1e-4)


def test_traces_are_the_sensitivity_of_log_det_h(joint) -> None:
    grid, physics, start = joint
    coefficients = grid.problem.completed(start.coefficients)[grid.physics(Structure(grid.problem.free))[1]]
    at = linearise(grid.observations, physics, start.control_points, coefficients, start.weights)

    def logdet(channel: int, factor: float) -> float:
        noise = start.weights.noise_std.copy()
        noise[channel] *= np.exp(-0.5 * factor)
        return at.normal(replace(start.weights, noise_std=noise)).eliminate().logdet

    _, used = at.freedom(start.weights)
    for channel in (1, 2):
        slope = (logdet(channel, 1e-3) - logdet(channel, -1e-3)) / 2e-3
        assert used[channel] == pytest.approx(slope, rel=1e-4)


# ---------------------------------------------------------------- results
def test_a_filmed_pendulum_gives_its_law_and_the_camera(tmp_path) -> None:
    model = la.discover(filmed(1.0), LIBRARY, KNOWN, measure=CAMERA)
    assert model.fit.status == "ok"
    found = model.terms[1]
    assert abs(found.coefficient - STIFFNESS) < 4.0 * found.standard_error
    assert np.all(np.abs(deviations(model, TRUTH)) < 4.0)
    assert np.allclose(model.calibration.noise_std, 1.0, atol=0.15)
    assert "{tilt}" in model.format_table()
    model.save(tmp_path / "model.json")
    again = la.load(tmp_path / "model.json")
    q = np.linspace(-0.5, 0.5, 5)[:, None]
    assert np.array_equal(again.calibration.evaluate(q), model.calibration.evaluate(q))
    assert np.allclose(model.calibration.evaluate(q), np.column_stack(pixels(q[:, 0])), atol=1.0)
    assert len(model.calibration.covariance) == 1 + 4


def test_without_noise_everything_is_recovered() -> None:
    model = la.discover(filmed(0.0, seconds=4.0), LIBRARY, KNOWN, measure=CAMERA)
    assert model.terms[1].coefficient == pytest.approx(STIFFNESS, rel=1e-4)
    values = {n.name: n.value for n in model.calibration.numbers}
    assert values == pytest.approx(TRUTH, rel=1e-4)


def test_the_identity_gives_the_model_of_the_column_itself() -> None:
    data = recorded(lambda q, *_: (q,), ["theta"], 0.01)
    plain = la.discover(data, LIBRARY, KNOWN)
    columns = la.Trajectories([run.changed(coordinates=("y",)) for run in data])
    seen = la.discover(columns, LIBRARY, KNOWN, measure=["y = theta"])
    a, b = plain.terms[1], seen.terms[1]
    assert abs(a.coefficient - b.coefficient) < 0.1 * a.standard_error
    assert b.standard_error == pytest.approx(a.standard_error, rel=0.05)
    assert seen.fit.status == plain.fit.status == "ok"


def test_numbers_that_only_their_product_shows_are_open() -> None:
    measure = [text.replace("{a}", "{s}*{l}") for text in CAMERA]
    model = la.discover(filmed(1.0, seconds=3.0), LIBRARY, KNOWN, measure=measure)
    open_numbers = {f.subject[0] for f in model.fit.findings if f.code == "calibration-open"}
    assert open_numbers == {"s", "l"}
    assert model.fit.status == "doubtful"


def test_a_wrong_function_is_not_ok() -> None:
    measure = ["u = {u0} + {a}*theta", "v = {v0} + {b}*theta**2"]  # for small angles only
    model = la.discover(filmed(1.0, seconds=4.0), LIBRARY, KNOWN, measure=measure)
    assert model.fit.status != "ok"


def test_a_gyroscope_alone_gives_law_gain_and_bias() -> None:
    data = recorded(lambda q, v, w: (1.03 * v + 0.02,), ["g"], 0.02, seconds=10.0, amplitudes=(0.9, 0.5, 1.2))
    model = la.discover(data, LIBRARY, KNOWN, measure=["g = {k}*theta_dot + {b}"])
    assert model.fit.status == "ok"
    assert abs(model.terms[1].coefficient - STIFFNESS) < 4.0 * model.terms[1].standard_error
    assert np.all(np.abs(deviations(model, {"k": 1.03, "b": 0.02})) < 4.0)


@pytest.mark.thorough
def test_an_accelerometer_with_a_gyroscope_gives_its_place() -> None:
    def board(q, v, w):
        return 0.3 * w + 9.81 * np.sin(q) + 0.05, 0.3 * v**2 + 9.81 * np.cos(q) + 0.03, v + 0.01

    data = recorded(board, ["at", "ar", "g"], [0.05, 0.05, 0.02], 10.0, (0.9, 0.5, 1.2))
    measure = la.measure.imu("theta", tangential="at", radial="ar", gyroscope="g")
    model = la.discover(data, LIBRARY, KNOWN, measure=measure)
    assert model.fit.status == "ok"
    truth = {"r": 0.3, "at_bias": 0.05, "ar_bias": 0.03, "g_bias": 0.01}
    assert np.all(np.abs(deviations(model, truth)) < 4.0)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [0, 1])
def test_a_filmed_double_pendulum_gives_lengths_and_tilt(seed) -> None:
    pendulum = systems.get("chaotic_pendulum")
    truth = {"x0": 410.0, "y0": 300.0, "l1": 180.0, "l2": 150.0, "tilt": 0.6}
    rng = np.random.default_rng(100 + seed)
    runs = []
    for motion in systems.simulate_truth(pendulum, trials=3, duration=8.0, rate=60.0, seed=seed):
        seen = motion.q + truth["tilt"]
        x1, y1 = truth["x0"] + 180.0 * np.sin(seen[:, 0]), truth["y0"] + 180.0 * np.cos(seen[:, 0])
        exact = np.column_stack([x1, y1, x1 + 150.0 * np.sin(seen[:, 1]), y1 + 150.0 * np.cos(seen[:, 1])])
        runs.append(
            la.Trajectory(
                motion.t, exact + rng.standard_normal(exact.shape), coordinates=["u1", "v1", "u2", "v2"]
            )
        )
    library = la.Library(list(pendulum.lagrangian), pendulum.coordinates, angles=pendulum.angles)
    measure = la.measure.camera(pendulum.coordinates, [("u1", "v1"), ("u2", "v2")])
    model = la.discover(runs, library, pendulum.known, measure=measure)
    assert model.fit.status == "ok"
    for term in model.terms:
        if not term.known:
            exact = pendulum.lagrangian[term.expression]
            assert abs(term.coefficient - exact) < 4.0 * term.standard_error
    assert np.all(np.abs(deviations(model, truth)) < 4.0)


# ---------------------------------------------------------------- linkages
TIMES = np.linspace(0.0, 8.0, 800)
SWING, OTHER, SLIDE = 0.8 * np.sin(3.0 * TIMES), 1.1 * np.sin(4.1 * TIMES + 0.4), 0.3 * np.cos(2.2 * TIMES)


def end_of(angle, length: float):
    """From the pivot to the end of a link, as a complex number: right, and down."""
    return length * (np.sin(angle) + 1j * np.cos(angle))


def rocker(crank):
    """The far joint of a four-bar linkage about pivots 0 and 0.9, by its two rods of 0.8 and 0.7."""
    away = 0.9 - crank
    middle = crank + away * (0.5 + (0.8**2 - 0.7**2) / (2.0 * abs(away) ** 2))
    return middle + 1j * away / abs(away) * np.sqrt(0.8**2 - abs(middle - crank) ** 2)


CRANK = end_of(2.0 * TIMES - 8.0, 0.3)
LINKAGES = {
    "double pendulum": (
        [0.3 + end_of(SWING, 0.5), 0.3 + end_of(SWING, 0.5) + end_of(OTHER, 0.4)],
        {"theta": SWING, "theta2": OTHER},
        ["turns", "turns"],
    ),
    "marks on one link": (
        [end_of(SWING, 0.5), end_of(SWING + 0.2, 0.8), end_of(SWING, 0.3)],
        {"theta": SWING},
        ["turns", "turns with", "turns with"],
    ),
    "cart, mark beside the pivot": (
        [SLIDE + 0.2j, SLIDE + 0.1 + 0.3j + end_of(OTHER, 0.4)],
        {"x0": SLIDE, "theta": OTHER},
        ["slides", "turns"],
    ),
    "inclined slider": (
        [SLIDE * (1.0 + 0.5j) + 0.2j, SLIDE * (1.0 + 0.5j) + 0.2j + end_of(OTHER, 0.4)],
        {"x0": SLIDE, "theta": OTHER},
        ["slides", "turns"],
    ),
    "four-bar linkage": (
        [CRANK, rocker(CRANK)],
        {"theta": 2.0 * TIMES - 8.0},
        ["turns", "closes"],
    ),
    "rod that flies": (
        [SLIDE + 1j * SWING, SLIDE + 1j * SWING + end_of(OTHER, 0.4)],
        {"x0": SLIDE, "y0": SWING, "theta": OTHER},
        ["turns"],
    ),
    "support": ([0.1 + 0.0j * SWING, 0.1 + end_of(SWING, 0.5)], {"theta": SWING}, ["fixed", "turns"]),
}


@pytest.mark.parametrize("name", LINKAGES)
def test_a_linkage_is_found_and_its_functions_give_the_tracks(name) -> None:
    points, motion, kinds = LINKAGES[name]
    noise, rng = 1e-3, np.random.default_rng(2)
    exact = np.column_stack([part for p in points for part in (p.real, p.imag)])
    names = [f"{axis}{k}" for k in range(len(points)) for axis in "xy"]
    run = la.Trajectory(TIMES, exact + noise * rng.standard_normal(exact.shape), coordinates=names)
    found = la.measure.linkage(run, [(f"x{k}", f"y{k}") for k in range(len(points))])
    assert [constraint.kind for constraint in found.constraints] == kinds
    assert all(0.7 < constraint.deviation < 1.5 for constraint in found.constraints)
    assert set(found.coordinates) == set(motion)
    assert found.loops == 0
    functions = SensorFunctions.parse(found.measure, found.coordinates)
    assert {*functions.columns, *found.coordinates, *found.constant} >= set(names)
    q = np.column_stack([motion[c] for c in found.coordinates])
    numbers = np.array([functions.starts[n] for n in functions.names])
    seen = functions.values(np.stack([q, 0.0 * q, 0.0 * q]), TIMES, numbers)
    there = np.array([names.index(column) for column in functions.columns])
    assert np.abs(seen - exact.T[there]).max() < 5.0 * noise


def test_noise_does_not_bias_a_radius() -> None:
    """The radius of the best algebraic circle is too small by noise² / arc², unless corrected."""
    rng, noise = np.random.default_rng(0), 0.05
    angle = rng.uniform(-0.6, 0.6, 40_000)
    track = np.column_stack([np.sin(angle), np.cos(angle)]) + noise * rng.standard_normal((angle.size, 2))
    design = np.column_stack([track, np.ones(angle.size)])
    a, b, c = np.linalg.lstsq(design, (track**2).sum(axis=1), rcond=None)[0]
    assert np.sqrt(c + (a**2 + b**2) / 4.0) < 0.9
    found = _circle((), track, np.full(2, noise**2), given=False)
    assert found.radius == pytest.approx(1.0, abs=0.03)
    assert found.excess == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ([], "empty"),
        ([("u",)], "two"),
        ([("u", "w")], "not a column"),
        ([("u", "u")], "twice"),
    ],
)
def test_bodies_that_are_no_pairs_of_columns_are_refused(bodies, message) -> None:
    with pytest.raises(InputError, match=message):
        la.measure.linkage(filmed(1.0, seconds=1.0), bodies)
