"""What is moved or pushed from outside: prescribed coordinates, and measured forces with noise and steps."""

from __future__ import annotations

from importlib.resources import as_file, files

import numpy as np
import pytest
import sympy as sp
from click.testing import CliRunner

import leastaction as la
from helpers import findings_of
from leastaction import systems
from leastaction.cli import program
from leastaction.cli.demo import DEMOS
from leastaction.curve.bspline import uniform_grid
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.forces import forces_on
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.structure import Structure
from leastaction.estimation.weights import evidence, fit_weights
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points
from leastaction.model.model import ModelTerm

NAMES = ("x", "theta")
KNOWN = {"theta_dot**2": 0.5}
CRANE = {"x_dot*theta_dot*cos(theta)": 1.0, "cos(theta)": 9.81}
FRICTION = {"theta_dot**2": 0.05}
PROVENANCE = {"options": {"prescribed": ["x"], "angles": ["theta"]}}


def crane(friction: bool = True) -> la.LagrangianModel:
    """A pendulum of length one below a trolley."""
    terms = [ModelTerm("theta_dot**2", 0.5, known=True), *(ModelTerm(k, v) for k, v in CRANE.items())]
    psi = [ModelTerm(k, v) for k, v in FRICTION.items()] if friction else []
    return la.LagrangianModel(NAMES, terms, psi, provenance=PROVENANCE)


def drive(seed: int):
    """Position, velocity and acceleration of the trolley as functions of time."""
    rng = np.random.default_rng(seed)
    size, rate, phase = 0.25 * rng.normal(size=4), rng.uniform(1.0, 7.0, 4), rng.uniform(0.0, 6.0, 4)
    return [
        lambda t, k=k: float((size * rate**k * np.sin(rate * t + phase + k * np.pi / 2)).sum())
        for k in range(3)
    ]


def record(seed: int, noise: float, model: la.LagrangianModel | None = None, duration: float = 8.0):
    x, v, a = drive(seed)
    t = np.arange(0.0, duration, 0.01)
    run = (model or crane()).simulate([x(0.0), 0.7], [v(0.0), 0.0], t, lambda time: np.array([a(time), 0.0]))
    assert run.complete
    assert np.abs(run.q[:, 0] - [x(time) for time in t]).max() < 1e-6
    rng = np.random.default_rng(seed)
    return la.Trajectory(t, run.q + noise * run.q.std(axis=0) * rng.normal(size=run.q.shape), None, NAMES)


@pytest.fixture(scope="module")
def data():
    return [record(seed, 0.01) for seed in range(3)]


@pytest.fixture(scope="module")
def model(data):
    library = la.Library.mechanical(NAMES, ["theta"])
    return la.discover(data, library, KNOWN, ["theta_dot**2", "x_dot**2"], prescribed=["x"])


def found(model: la.LagrangianModel):
    return {t.expression: t for t in model.terms if not t.known}, {t.expression: t for t in model.dissipation}


def test_law_is_found_and_what_only_the_trolley_has_is_left_out(model):
    lagrangian, friction = found(model)
    assert model.fit.status == "ok", model.fit.warnings
    for truth, here in ((CRANE, lagrangian), (FRICTION, friction)):
        assert set(truth) == set(here)
        for name, value in truth.items():
            assert abs(here[name].coefficient - value) < 4.0 * here[name].standard_error
            assert here[name].standard_error < 0.03 * value
    left_out = {d.term.text: d.because for d in model.diagnostics.dropped}
    assert "not prescribed" in left_out["x_dot**2"]
    assert np.isnan(model.fit.physics_weight[0])
    assert np.isnan(model.diagnostics.equation_error[0])
    assert np.isfinite(model.diagnostics.equation_error[1])


def test_equation_agrees_with_sympy_for_a_motion_put_into_the_lagrangian():
    """The oracle knows no prescribed coordinates: x(t) stands in L as a function of time."""
    t, x = sp.Symbol("t"), sp.Function("x")
    theta = sp.Function("theta")(t)
    motion = 0.3 * sp.sin(2 * t)
    lagrangian = theta.diff(t) ** 2 / 2 + x(t).diff(t) * theta.diff(t) * sp.cos(theta) + 9.81 * sp.cos(theta)
    (equation,) = sp.calculus.euler.euler_equations(lagrangian.subs(x(t), motion).doit(), theta, t)
    expected = sp.lambdify([t, theta, theta.diff(t)], sp.solve(equation, theta.diff(t, 2))[0])
    for time, angle, rate in ((0.3, 0.8, -1.0), (2.0, -2.5, 3.0)):
        place, speed, push = (float(motion.diff(t, k).subs(t, time)) for k in range(3))
        q̈ = crane(friction=False).acceleration([place, angle], [speed, rate], [push, 0.0])
        assert q̈ == pytest.approx([push, expected(time, angle, rate)], rel=1e-12)


def test_equations_name_the_acceleration_of_the_trolley_and_have_none_for_it():
    (equation,) = crane().equations_of_motion(forces=True)
    assert str(equation.lhs) == "theta_dot_dot"
    assert {str(s) for s in equation.rhs.free_symbols} == {"x_dot_dot", "theta", "theta_dot", "theta_force"}


def test_forecast_moves_the_trolley_as_it_was_measured(model):
    result = model.validate([record(7, 0.01)], horizon=1.0)
    assert result.n_diverged == 0
    assert np.all(result.rms < 2.0 * result.expected_rms)


def test_forces_on_a_prescribed_coordinate_are_left_out(data, model):
    pushed = [la.Trajectory(d.t, d.q, np.column_stack([np.sin(d.t), 0.0 * d.t]), NAMES) for d in data]
    library = la.Library([*KNOWN, *CRANE, "sin(theta)"], NAMES)
    again = la.discover(pushed, library, KNOWN, ["theta_dot**2"], prescribed="x")
    assert [finding.subject for finding in findings_of(again, "forces-unused")] == [("x",)]
    assert again.fit.status == "ok"
    with pytest.raises(ValueError, match="no force acts and no coefficient is known"):
        la.discover(pushed, library, prescribed=["x"])


@pytest.mark.thorough
def test_a_force_on_the_other_coordinate_sets_the_scale():
    """An arm with one torque sensor: the first joint moves as it likes."""
    names = ("a", "b")
    terms = {"b_dot**2": 0.5, "a_dot*b_dot*cos(a-b)": 1.0, "cos(b)": 9.81}
    arm = la.LagrangianModel(
        names, [ModelTerm(k, v) for k, v in terms.items()], provenance={"options": {"prescribed": ["a"]}}
    )
    data, t = [], np.arange(0.0, 8.0, 0.01)
    for seed in range(3):
        x, v, a = drive(seed)
        push = np.array([[0.0, 2.0 * np.sin(5.0 * time + seed)] for time in t])
        moved = np.column_stack([[a(time) for time in t], push[:, 1]])
        q = arm.simulate([x(0.0), 0.2], [v(0.0), 0.0], t, moved).q
        rng = np.random.default_rng(seed)
        data.append(la.Trajectory(t, q + 0.01 * q.std(axis=0) * rng.normal(size=q.shape), push, names))
    result = la.discover(data, la.Library.mechanical(names, names, size="compact"), prescribed=["a"])
    assert result.fit.status == "ok", result.fit.warnings
    lagrangian, _ = found(result)
    assert set(lagrangian) == set(terms)
    for name, value in terms.items():
        assert abs(lagrangian[name].coefficient - value) < 4.0 * lagrangian[name].standard_error


@pytest.mark.thorough
def test_either_equation_of_the_measured_double_pendulum_gives_the_published_law():
    demo = DEMOS["double"]
    with as_file(files("leastaction") / "datasets" / demo.file) as path:
        data = la.io.read_csv(path, coordinates=list(demo.coordinates), trial="trial")
    fitted = data.select([name for k, name in enumerate(data.names) if k % 3 != 2])
    library = la.Library(demo.candidates, demo.coordinates, angles=demo.coordinates)
    scale = {"theta2_dot**2": demo.published["theta2_dot**2"]}
    result = la.discover(fitted, library, scale, demo.dissipation, prescribed=["theta1"])
    assert result.fit.status == "ok", result.fit.warnings
    lagrangian, _ = found(result)
    assert set(lagrangian) == {"theta1_dot*theta2_dot*cos(theta1-theta2)", "cos(theta2)"}
    for name, term in lagrangian.items():
        assert term.coefficient == pytest.approx(demo.published[name], rel=0.005)
        assert term.standard_error < 0.001 * abs(term.coefficient)


def test_a_missing_coupling_is_doubted(data):
    result = la.discover(data, [*KNOWN, "cos(theta)", "sin(theta)"], KNOWN, prescribed=["x"])
    assert result.fit.status == "doubtful"
    (missing,) = findings_of(result, "missing-term")
    assert missing.subject == ("x_dot*theta_dot*cos(theta)",)


@pytest.mark.thorough
def test_without_being_told_the_result_is_doubtful(data):
    library = la.Library([*KNOWN, *CRANE, "x_dot**2", "x**2"], NAMES)
    assert la.discover(data, library, KNOWN, ["theta_dot**2"]).fit.status == "doubtful"


def test_columns_have_no_rows_of_prescribed_coordinates():
    library = la.Library([*KNOWN, *CRANE, "x_dot**2"], NAMES)
    all_of_it = EulerLagrange(library.terms, NAMES)
    some = EulerLagrange(library.terms, NAMES, [0])
    rng = np.random.default_rng(0)
    states = rng.normal(size=(3, 7, 2))
    points, coefficients = Points(*states), np.arange(1.0, 5.0)
    assert np.all(some.strong(points)[:, 0] == 0.0)
    assert np.array_equal(some.strong(points)[:, 1], all_of_it.strong(points)[:, 1])
    assert np.all(some.weak(points)[:, :, 0] == 0.0)
    assert {i for _, i, _ in some.jacobian(points, coefficients)} == {1}
    mass = some.mass_matrix(points, coefficients)
    assert np.all(mass == np.array([[1.0, 0.0], [0.0, 2.0]]))
    assert some.subset([0, 1]).prescribed == (0,)


def test_terms_that_agree_in_the_equations_left_are_dependent():
    library = la.Library(
        ["theta_dot**2", "x_dot**2*cos(theta)**2", "x_dot**2*sin(theta)**2", "sin(x)"], NAMES
    )
    assert len(library.reduced()) == 4
    reduced = library.reduced(prescribed=["x"])
    assert [t.text for t in reduced] == ["theta_dot**2", "x_dot**2*cos(theta)**2"]
    reasons = {d.term.text: d.reason for d in reduced.dropped}
    assert reasons == {"x_dot**2*sin(theta)**2": "duplicate", "sin(x)": "null"}


def test_evidence_levels_off_where_the_equations_hold(data):
    """A weight that grows without bound leaves the likelihood of an exact model where it is.

    With two points an interval the equations would take more directions of the curves than there are
    equations, and the likelihood would fall by hundreds.
    """
    request = Request([*KNOWN, *CRANE], KNOWN, ["theta_dot**2"], prescribed=["x"])
    setup = build_problem(data, request)
    grid = Grid.lay(setup.problem, 30.0)
    smoothed = grid.smooth(setup.scales.smooth.penalty)
    members = Structure(setup.problem.free)
    truth = {**KNOWN, **CRANE}
    coefficients = np.array([truth[t.text] if t.kind == "lagrangian" else 0.05 for t in setup.problem.terms])
    start = grid.start(members, smoothed.control_points, coefficients, smoothed.noise_std)
    start, _ = grid.fit_curve(members, start)
    physics, index = grid.physics(members)
    begin = type(start)(start.control_points, start.coefficients[index], start.weights)
    best = fit_weights(grid.observations, physics, begin)
    values = []
    for factor in (1.0, 10.0, 100.0):
        weights = best.weights.__class__(
            best.weights.noise_std, best.weights.physics * [1.0, factor], best.weights.slack
        )
        fit = fit_joint(
            grid.observations, physics, weights, best.control_points, best.coefficients, tolerance=1e-3
        )
        values.append(evidence(grid.observations, fit))
    assert np.ptp(values) < 1.0


@pytest.mark.parametrize("degree", [3, 4, 5])
def test_points_of_collocation_see_the_fastest_spline(degree):
    grid = uniform_grid([np.linspace(0.0, 1.0, 50)], 20.0, degree, 1)
    fastest = (-1.0) ** np.arange(grid.n_ctrl)[:, None]
    inside = slice(degree, grid.n_intervals - degree)
    values = np.abs(grid.at_quadrature(fastest)[2][inside])
    assert values.min() > 0.5 * values.max() > 0.0


def test_model_file_keeps_what_is_prescribed(tmp_path, model):
    model.save(tmp_path / "crane.json")
    again = la.load(tmp_path / "crane.json")
    assert again.prescribed == ("x",)
    state = [[0.1, 0.5], [0.3, -1.0], [2.0, 0.0]]
    assert np.array_equal(again.acceleration(*state), model.acceleration(*state))
    for odd in (["x", "theta"], "x", 3, None, ["y"], [["x"]]):
        document = {**model.to_dict(), "provenance": {"options": {"prescribed": odd}}}
        assert la.LagrangianModel.from_dict(document).prescribed == ()


def test_exported_python_takes_the_acceleration_as_force(tmp_path, model):
    la.export(model, "python", tmp_path / "crane.py")
    source = (tmp_path / "crane.py").read_text()
    assert "its motion is prescribed: its force is its acceleration" in source
    module: dict = {}
    exec(source, module)
    state = [0.1, 0.5], [0.3, -1.0], [2.0, 0.1]
    assert module["acceleration"](*state) == pytest.approx(model.acceleration(*state), rel=1e-12)


def test_report_says_that_there_is_no_balance(tmp_path, model):
    la.write_report(model, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert "the forces that move x are unknown" in text
    assert "nan" not in text.lower().replace("finance", "")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"prescribed": ["y"]}, "prescribed names 'y', which is not a coordinate"),
        ({"prescribed": ["x", "theta"]}, "every coordinate is prescribed"),
        ({"prescribed": ["x"], "force_offset": ["x"]}, "force_offset names 'x', which is prescribed"),
    ],
)
def test_misuse_is_named(data, given, message):
    with pytest.raises(ValueError, match=message):
        la.discover(data, [*KNOWN, *CRANE], KNOWN, **given)


def test_a_motion_that_is_given_is_followed():
    """Samples of the trolley do what its acceleration does; forces on the rest still act."""
    x, v, a = drive(1)
    t = np.arange(0.0, 4.0, 0.01)
    model, push = crane(), lambda time: np.array([0.0, 0.3 * np.sin(time)])
    given = model.simulate([0.0, 0.7], [0.0, 0.0], t, push, inputs={"x": [x(time) for time in t]})
    forces = np.array([[a(time), push(time)[1]] for time in t])
    known = model.simulate([x(0.0), 0.7], [v(0.0), 0.0], t, forces)
    assert np.abs(given.q - known.q).max() < 1e-6
    with pytest.raises(la.InputError, match=r"inputs gives the motion of 'theta'; .* is allowed, here x"):
        model.simulate([0.0, 0.7], [0.0, 0.0], t, inputs={"theta": t})
    with pytest.raises(la.InputError, match=r"an input has shape \(3,\); expected finite numbers of shape"):
        model.simulate([0.0, 0.7], [0.0, 0.0], t, inputs={"x": t[:3]})


def test_a_length_that_is_reeled_in_is_an_input():
    """L = l² θ̇²/2 + g l cos θ with l measured: the terms hold an input that changes."""
    t, rng = np.linspace(0.0, 8.0, 801), np.random.default_rng(3)
    length = 1.0 + 0.3 * np.sin(1.7 * t) + 0.1 * np.sin(0.6 * t)
    terms = [ModelTerm("l**2*theta_dot**2", 0.5), ModelTerm("l*cos(theta)", 9.81)]
    law = la.LagrangianModel(("theta", "l"), terms, provenance={"options": {"prescribed": ["l"]}})
    motions = [law.simulate([start, 0.0], [0.0, 0.0], t, inputs={"l": length}) for start in (0.5, 1.0)]
    noise = 0.005 * rng.normal(size=(2, t.size, 2))
    runs = [la.Trajectory(t, m.q + e, None, ("theta", "l")) for m, e in zip(motions, noise, strict=True)]
    library = la.Library.mechanical(["theta", "l"], ["theta"], size="compact")
    model = la.discover(runs, library, {"l*cos(theta)": 9.81}, prescribed=["l"])
    assert model.fit.status == "ok"
    assert {term.expression for term in model.terms} == {"l*cos(theta)", "theta_dot**2*l**2"}


def test_estimator_passes_it_on(data):
    pytest.importorskip("sklearn")
    estimator = la.SparseLagrangian(
        [*KNOWN, *CRANE], KNOWN, ["theta_dot**2"], coordinates=NAMES, prescribed=["x"]
    )
    assert estimator.fit(data[:2]).model_.prescribed == ("x",)
    assert estimator.score(data[2:]) > 0.9


def test_the_papers_method_leaves_the_equation_out_too(data):
    options = {"iterations": 200, "check_every": 100, "threshold_from": 200}
    result = la.discover(data, [*KNOWN, *CRANE], KNOWN, method="adam", prescribed=["x"], options=options)
    lagrangian, _ = found(result)
    assert lagrangian["cos(theta)"].coefficient == pytest.approx(9.81, rel=0.1)


@pytest.mark.thorough
def test_command_line(tmp_path, data):
    la.io.write_csv(tmp_path / "crane.csv", la.Trajectories(data))
    library = tmp_path / "library.txt"
    library.write_text("\n".join([*KNOWN, *CRANE, "sin(theta)"]))
    common = ["--coordinates", "x,theta", "--angles", "theta", "--trial", "trial", "--library", str(library)]
    given = ["--prescribed", "x", "--known", "theta_dot**2=0.5", "--dissipation", "theta_dot**2"]
    out = tmp_path / "out"
    ran = CliRunner().invoke(
        program, ["discover", str(tmp_path / "crane.csv"), *common, *given, "--output", str(out)]
    )
    assert ran.exit_code == 0, ran.output
    assert la.load(out / "model.json").prescribed == ("x",)
    as_input = ["--coordinates", "theta", "--input", "x", *common[2:], *given[2:]]
    ran = CliRunner().invoke(
        program, ["discover", str(tmp_path / "crane.csv"), *as_input, "--output", str(tmp_path / "other")]
    )
    assert ran.exit_code == 0, ran.output
    other = la.load(tmp_path / "other" / "model.json")
    assert (other.coordinates, other.prescribed) == (("theta", "x"), ("x",))
    written = {term.expression: term.coefficient for term in other.terms}
    for term in la.load(out / "model.json").terms:
        assert written[term.expression] == pytest.approx(term.coefficient, rel=1e-6)
    free = ["--initial", "theta=1", "--duration", "1", "--rate", "50", "-o", str(tmp_path / "run.csv")]
    ran = CliRunner().invoke(program, ["simulate", str(out / "model.json"), *free])
    assert ran.exit_code == 0
    assert "the motion of x was prescribed: it is uniform here" in ran.output


# -------------------------------------------------- measured forces: noise, and steps of a digital controller
TRUTH = {"theta_dot**2": 0.5, "cos(theta)": 9.81}


# ------------------------------------------------------------------------------------- on the grid


def test_a_polynomial_of_the_degree_of_the_spline_is_kept():
    t = np.linspace(0.0, 4.0, 401)
    force = np.column_stack([t**5 - 3.0 * t, 2.0 - t**2])
    grid = uniform_grid([t], 5.0, 5)
    found = forces_on(grid, [t], [force])
    x = grid.points
    assert np.allclose(found.values, np.stack([x**5 - 3.0 * x, 2.0 - x**2], axis=-1), atol=1e-8)
    assert np.all(found.density < 1e-16)


@pytest.mark.parametrize("knots", [2.0, 8.0, 30.0, 200.0])
def test_density_is_that_of_white_noise(knots):
    rng = np.random.default_rng(1)
    times = [np.linspace(0.0, 20.0, 2001), np.linspace(0.0, 10.0, 501)]
    noise = [rng.normal(0.0, [0.3, 0.0], (t.size, 2)) for t in times]
    found = forces_on(uniform_grid(times, knots, 5), times, noise)
    expected = 0.3**2 * (2001 * 0.01 + 501 * 0.02) / 2502
    assert found.density[0] == pytest.approx(expected, rel=0.15)
    assert found.density[1] == 0.0


def test_noise_falls_with_the_number_of_samples_an_interval():
    t = np.linspace(0.0, 40.0, 8001)
    noise = np.random.default_rng(2).normal(0.0, 1.0, (t.size, 1))
    sizes = [np.std(forces_on(uniform_grid([t], k, 5), [t], [noise]).values) for k in (4.0, 16.0)]
    assert sizes[1] / sizes[0] == pytest.approx(2.0, rel=0.25)


def test_gaps_and_few_samples():
    t = np.concatenate([np.linspace(0.0, 4.0, 201), np.linspace(6.0, 10.0, 201)])
    grid = uniform_grid([t], 6.0, 5)
    found = forces_on(grid, [t], [np.sin(t)[:, None]]).values[..., 0]
    measured = (grid.points < 4.0) | (grid.points > 6.0)
    assert np.allclose(found[measured], np.sin(grid.points)[measured], atol=0.02)
    few = np.linspace(0.0, 1.0, 6)
    grid = uniform_grid([few], 20.0, 5)
    found = forces_on(grid, [few], [few[:, None] ** 3])
    assert np.allclose(found.values[..., 0], grid.points**3)
    assert found.density.tolist() == [0.0]


def test_nothing_acts():
    t = np.linspace(0.0, 1.0, 101)
    grid = uniform_grid([t, t], 8.0, 5)
    assert forces_on(grid, [t, t], [None, None]) is None
    found = forces_on(grid, [t, t], [None, np.ones((101, 1))])
    assert np.all(found.values[grid.owner == 0] == 0.0)
    assert np.allclose(found.values[grid.owner == 1], 1.0)


# ---------------------------------------------------------------------------------------- the law


def within(model, sigmas: float) -> bool:
    assert {t.expression for t in model.terms} == set(TRUTH)
    return all(abs(t.coefficient - TRUTH[t.expression]) < sigmas * t.standard_error for t in model.terms)


def noisy(share: float, seed: int) -> la.Trajectories:
    data = systems.generate("single_pendulum", noise=0.01, trials=5, duration=20.0, seed=seed)
    size = share * np.std(np.concatenate([run.forces for run in data]))
    rng = np.random.default_rng(seed)
    return data.with_forces([run.forces + size * rng.normal(size=run.forces.shape) for run in data])


@pytest.mark.parametrize(("share", "seed"), [(0.3, 300), (1.0, 301), (1.0, 302)])
@pytest.mark.thorough
def test_noise_of_the_forces_does_not_bias_the_scale(share, seed):
    model = la.discover(noisy(share, seed), systems.compact_library("single_pendulum"))
    assert model.fit.status == "ok", model.fit.warnings
    assert within(model, 4.0)
    gravity = next(t for t in model.terms if t.expression == "cos(theta)")
    assert gravity.coefficient == pytest.approx(9.81, rel=0.03)
    if share == 1.0:
        assert findings_of(model, "scatter-of-forces")


@pytest.mark.thorough
def test_noise_of_the_forces_excuses_no_missing_term():
    library = [t.text for t in systems.compact_library("single_pendulum").terms if t.text != "cos(theta)"]
    assert la.discover(noisy(0.3, 300), library).fit.status == "doubtful"


def held(seed: int, rate: float = 100.0, duration: float = 20.0) -> list[la.Trajectory]:
    """Pendulums whose torque jumps now and then, as a switching controller's does."""
    rng, substeps, runs = np.random.default_rng(seed), 4, []
    for _ in range(5):
        n = int(duration * rate)
        lengths = rng.uniform(0.3, 1.5, 80)
        jumps = np.searchsorted(np.cumsum(lengths), np.arange(n + 1) / rate)
        torque = rng.choice([-3.0, 0.0, 3.0], 81)[jumps]
        y, path, h = np.array([rng.uniform(-1.0, 1.0), 0.0]), [], 1.0 / rate / substeps
        for u in torque:
            path.append(y[0])

            def slope(y, u=u):
                return np.array([y[1], u - 9.81 * np.sin(y[0])])

            for _ in range(substeps):
                k1 = slope(y)
                k2 = slope(y + 0.5 * h * k1)
                k3 = slope(y + 0.5 * h * k2)
                y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + slope(y + h * k3))
        q = np.array(path)
        measured = q + 0.01 * q.std() * rng.normal(size=q.size)
        t = np.arange(n + 1) / rate
        runs.append(la.Trajectory(t, measured, torque[:, None], coordinates=["theta"]))
    return runs


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_forces_that_jump(seed):
    library = la.Library([*TRUTH, "theta_dot**4", "sin(theta)", "cos(2*theta)", "theta"], ["theta"])
    model = la.discover(held(seed), library)
    assert model.fit.status == "ok", model.fit.warnings
    assert within(model, 4.0)


def stamped_late(seed: int) -> la.Trajectories:
    """Torques stamped one sample, 10 ms, after they acted."""
    data = systems.generate("single_pendulum", noise=0.003, trials=4, duration=20.0, seed=seed)
    return la.Trajectories([run.rows(slice(1, None)).changed(forces=run.forces[:-1]) for run in data])


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [4, 5])
def test_a_delay_that_friction_could_hide_is_named(seed):
    library, friction = systems.compact_library("single_pendulum"), ["theta_dot**2/2"]
    model = la.discover(stamped_late(seed), library, dissipation=friction)
    assert model.fit.status == "usable"
    (late,) = findings_of(model, "late-forces")
    assert late.values["delay"] == pytest.approx(-0.01, rel=0.2)
    assert not late.values["half_a_sample"]
    cured = la.delay.shift_forces(stamped_late(seed), -0.01)
    assert la.discover(cured, library, dissipation=friction).fit.status == "ok"


@pytest.mark.thorough
def test_a_half_sample_reads_as_held():
    data = systems.generate("single_pendulum", noise=0.001, trials=4, duration=20.0, seed=6)
    early = la.delay.shift_forces(data, -0.005)
    model = la.discover(early, systems.compact_library("single_pendulum"))
    (late,) = findings_of(model, "late-forces")
    assert late.values["half_a_sample"]
