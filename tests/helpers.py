"""Oracles, small problems and varied discoveries that tests share."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import CancelledError, Future
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_lsq_spline
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction import systems
from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.data.trajectories import Rate, Trajectories, Trajectory
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.exact_limit import towards_exact
from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.protocols import linearise
from leastaction.estimation.simulation_error import minimise_simulation_error
from leastaction.findings import Finding
from leastaction.identifiers import names_in_terms
from leastaction.library import Term
from leastaction.library.term import make_term
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.model.model import LagrangianModel, ModelTerm
from leastaction.selection.search import run_search
from leastaction.selection.search_state import Search, begin_search
from leastaction.simulation.integrate import rk4, simulate

Acceleration = Callable[[np.ndarray, np.ndarray, "np.ndarray | None"], np.ndarray]


# ---------------------------------------------------------------------------------------- splines
def naive_basis(knots: Sequence[float], degree: int, i: int, x: float, nu: int = 0) -> float:
    """Return one B-spline or its derivative, by the textbook recursion, 0/0 = 0; last interval closed."""
    if nu > 0:
        left, right = knots[i + degree] - knots[i], knots[i + degree + 1] - knots[i + 1]
        value = 0.0
        if left > 0:
            value += degree / left * naive_basis(knots, degree - 1, i, x, nu - 1)
        if right > 0:
            value -= degree / right * naive_basis(knots, degree - 1, i + 1, x, nu - 1)
        return value
    if degree == 0:
        at_end = x == knots[-1] and knots[i] < knots[i + 1] == knots[-1]
        return float(knots[i] <= x < knots[i + 1] or at_end)
    left, right = knots[i + degree] - knots[i], knots[i + degree + 1] - knots[i + 1]
    value = 0.0
    if left > 0:
        value += (x - knots[i]) / left * naive_basis(knots, degree - 1, i, x)
    if right > 0:
        value += (knots[i + degree + 1] - x) / right * naive_basis(knots, degree - 1, i + 1, x)
    return value


def random_breakpoints(rng: np.random.Generator, n_intervals: int, start=0.0, stop=1.0) -> np.ndarray:
    """Breakpoints whose intervals differ by up to a factor of ten."""
    widths = rng.uniform(0.1, 1.0, n_intervals)
    points = np.concatenate([[0.0], np.cumsum(widths)])
    return start + (stop - start) * points / points[-1]


def uniform_grid(
    durations: Iterable[float], knots_per_second: float, degree: int, n_quadrature=3
) -> SplineGrid:
    spaces = [SplineSpace(degree, np.linspace(0.0, d, round(d * knots_per_second) + 1)) for d in durations]
    return SplineGrid(spaces, n_quadrature)


def interpolate(grid: SplineGrid, functions: Sequence[Callable[[np.ndarray], np.ndarray]]) -> np.ndarray:
    """Control points of the curves closest to one function t -> (n_times, n_dof) per trajectory."""
    parts = []
    for space, function in zip(grid.spaces, functions, strict=True):
        t = np.linspace(space.breakpoints[0], space.breakpoints[-1], 6 * space.n_ctrl)
        parts.append(make_lsq_spline(t, function(t), space.knots, space.degree).c)
    return np.concatenate(parts)


# ------------------------------------------------------------------------------------ linear algebra
def dense_from_lower_band(banded: np.ndarray) -> np.ndarray:
    """Symmetric matrix from LAPACK's lower banded storage."""
    n = banded.shape[1]
    out = np.zeros((n, n))
    for k in range(min(len(banded), n)):
        out += np.diag(banded[k, : n - k], -k)
        if k:
            out += np.diag(banded[k, : n - k], k)
    return out


def finite_difference(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray, steps) -> np.ndarray:
    """Jacobian by fourth-degree central differences, (…, n)."""
    steps = np.broadcast_to(steps, x.shape)
    columns = []
    for k, h in enumerate(steps):
        e = np.zeros_like(x)
        e[k] = h
        near = np.asarray(function(x + e)) - np.asarray(function(x - e))
        far = np.asarray(function(x + 2 * e)) - np.asarray(function(x - 2 * e))
        columns.append((8.0 * near - far) / (12.0 * h))
    return np.stack(columns, axis=-1)


# ------------------------------------------------------------------------------------------- terms
def terms(texts: Iterable[str], coordinates: Sequence[str], kind: str = "lagrangian") -> list[Term]:
    names = names_in_terms(coordinates)
    return [make_term(text, names, None, kind) for text in texts]


def euler_lagrange(
    lagrangian: Iterable[str], coordinates: Sequence[str], dissipation: Iterable[str] = ()
) -> EulerLagrange:
    both = [*terms(lagrangian, coordinates), *terms(dissipation, coordinates, "dissipation")]
    return EulerLagrange(both, coordinates)


# -------------------------------------------------------------------------------------------- data
def record(
    acceleration: Acceleration,
    starts: Sequence[tuple[Sequence[float], Sequence[float]]],
    coordinates: Sequence[str],
    *,
    duration: float = 6.0,
    rate: float = 50.0,
    noise: float | Sequence[float] = 0.01,
    forcing: Callable[[int, np.ndarray], np.ndarray] | None = None,
    irregular: bool = False,
    seed: int = 0,
) -> Trajectories:
    """Noisy recordings of a motion whose acceleration is written out by hand.

    ``forcing(k, t)`` gives the known forces of trajectory k, (n_times, n_dof).
    """
    rng = np.random.default_rng(seed)
    out = []
    for k, (q0, qdot0) in enumerate(starts):
        t = np.linspace(0.0, duration, round(duration * rate) + 1)
        if irregular:
            t[1:-1] += rng.uniform(-0.4, 0.4, t.size - 2) / rate
        push = None if forcing is None else (lambda time, k=k: forcing(k, np.array([time]))[0])
        motion = simulate(acceleration, q0, qdot0, t, push, rtol=1e-10, atol=1e-10)
        assert motion.complete, motion.reason
        q = motion.q + np.asarray(noise) * rng.standard_normal(motion.q.shape)
        forces = None if forcing is None else forcing(k, t)
        out.append(Trajectory(t, q, forces=forces, coordinates=coordinates))
    return Trajectories(out)


def findings_of(model, code: str) -> list[Finding]:
    """Findings of a model with this code."""
    return [finding for finding in model.fit.findings if finding.code == code]


def coefficients_of(model) -> dict[str, float]:
    """Expression -> coefficient, of L and of the dissipation function."""
    return {term.expression: term.coefficient for term in (*model.terms, *model.dissipation)}


def assert_finds(model, truth: dict[str, float], *, z: float = 4.5, relative: float | None = None) -> None:
    """The model has exactly these terms, each within z standard errors of the truth."""
    found = coefficients_of(model)
    assert set(found) == set(truth), (sorted(found), model.fit.warnings)
    for term in (*model.terms, *model.dissipation):
        error = abs(term.coefficient - truth[term.expression])
        allowed = 1e-12 * abs(truth[term.expression]) if term.known else z * term.standard_error
        assert error <= allowed, (term.expression, term.coefficient, term.standard_error)
        if relative is not None:
            assert error <= relative * abs(truth[term.expression]), (term.expression, term.coefficient)


# ------------------------------------------------------- systems for discover(), none of the seven
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


def duffing(noise=0.01, seed=0, **options) -> Trajectories:
    """ẍ = −x − 0.8 x³."""
    starts = [([1.8], [0.0]), ([0.4], [2.5])]
    return record(
        lambda q, v, f: -q - 0.8 * q**3, starts, ["x"], duration=8.0, noise=noise, seed=seed, **options
    )


@cache
def pendulum(viscous=0.15, coulomb=0.0, speed=2.0, noise=0.01, driven=True, trials=2) -> Trajectories:
    """θ̈ = −9.81 sin θ − c θ̇ − μ sign θ̇ + τ, the sign rounded off below a millimetre a second."""

    def acceleration(q, v, f):
        push = 0.0 if f is None else f
        return -9.81 * np.sin(q) - viscous * v - coulomb * v / np.sqrt(v**2 + 1e-6) + push

    def torque(k, t):
        return (2.0 * np.sin(1.7 * t + k) + 1.5 * np.sin(4.1 * t + 2 * k))[:, None]

    starts = [([1.2], [speed]), ([-0.5], [2.0]), ([0.3], [-2.0])][:trials]
    forcing = torque if driven else None
    return record(acceleration, starts, ["theta"], duration=8.0, rate=60.0, noise=noise, forcing=forcing)


@cache
def cart(driven=True) -> Trajectories:
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


def changed(data: Trajectories, **functions) -> Trajectories:
    """The recordings with t, q or forces put through functions."""
    return Trajectories(
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


def free_motions(
    force: Callable[..., float],
    starts: Iterable[float] = (0.5, 0.9, 1.3),
    noise: float = 0.02,
    seed: int = 0,
    *,
    timed: bool = False,
) -> list[Trajectory]:
    """Measured motions of ẍ = force(x), or force(x, t), from rest; noise relative to the spread of each."""
    rng, times = np.random.default_rng(seed), np.linspace(0.0, 15.0, 751)
    out: list[Trajectory] = []
    for start in starts:
        run = solve_ivp(
            lambda t, y: [y[1], force(y[0], t) if timed else force(y[0])],
            (0.0, times[-1]),
            [start, 0.0],
            t_eval=times,
            rtol=1e-9,
            atol=1e-9,
        )
        x = run.y[0][:, None]
        out.append(Trajectory(times, x + noise * x.std() * rng.normal(size=x.shape), coordinates=["x"]))
    return out


# ------------------------------------------------------------------------------- measured rates
def with_rates(system, truth, noise_std, velocity=None, acceleration=None, seed: int = 0) -> Trajectories:
    """Noisy positions of simulated motions, and velocities and accelerations with noise of their own.

    ``velocity`` and ``acceleration`` are noise over the spread of the channel; None where it is not measured.
    """
    rng = np.random.default_rng([seed, 77])
    exact = {
        "velocities": (velocity, [m.qdot for m in truth]),
        "accelerations": (acceleration, [system.acceleration(m.q, m.qdot, m.forces) for m in truth]),
    }
    out = []
    for k, run in enumerate(systems.measure(system, truth, noise_std, seed=seed)):
        fields = {
            name: rates[k] + level * np.std(np.concatenate(rates), axis=0) * rng.standard_normal(run.q.shape)
            for name, (level, rates) in exact.items()
            if level is not None
        }
        out.append(run.changed(**fields))
    return Trajectories(out)


# --------- small problems that tests share: discoveries with a fresh fit of each, and short trials in blocks
# ------------------ varied discoveries, small enough for a test, and a fresh fit of what each of them reports
def _system(name: str, noise: float = 0.01, friction: bool = False, library: str = "compact", **options):
    settings = {"trials": 2, "duration": 6.0, "seed": 1, **options}
    data = systems.generate(name, noise=noise, **settings)
    of = systems.compact_library if library == "compact" else systems.large_library
    rates = [f"{c}_dot" for c in data.coordinates]
    absent = [text for v in rates for text in (f"{v}**2/2", f"abs({v})")] if friction else []
    return data, Request(of(name), systems.get(name).known, absent), {}


def _pendulum(
    seed: int,
    viscous: float = 0.0,
    dry: float = 0.0,
    offset: float = 0.0,
    drift: float = 0.0,
    pushed: float = 0.0,
    noise: float = 1e-3,
    sign: float = 1.0,
) -> la.Trajectories:
    """A driven pendulum, ½ θ̇² + 9.81 cos θ, with what a machine adds."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 8.0, 0.01)
    drawn = []
    for _ in range(2):
        known = 4.0 * sum(rng.normal() * np.sin(w * t + rng.uniform(0.0, 6.3)) for w in (0.7, 1.9, 2.8, 4.1))
        fast = sosfiltfilt(butter(2, [0.06, 0.2], "band", output="sos"), rng.normal(size=t.size))
        slow = offset + drift * np.sin(2.0 * np.pi * t / 20.0)
        forces = known + slow + pushed * fast / fast.std()
        drawn.append((known, forces, *rng.normal(0.0, 1.0, (2, 1)), rng.normal(0.0, noise, (t.size, 1))))
    motions, _ = rk4(
        lambda q, v, f: f - 9.81 * np.sin(q) - viscous * v - dry * np.tanh(v / 0.02),
        [d[2] for d in drawn],
        [d[3] for d in drawn],
        t,
        forces=lambda times: np.stack([np.interp(times, t, d[1]) for d in drawn], axis=1)[..., None],
    )
    return la.Trajectories(
        [
            la.Trajectory(t, motions[:, k] + error, forces=sign * known[:, None], coordinates=["theta"])
            for k, (known, *_, error) in enumerate(drawn)
        ]
    )


PENDULUM = ["theta_dot**2", "cos(theta)", "sin(theta)", "theta**2", "theta", "theta_dot**2*cos(theta)"]
DAMPING = ["theta_dot**2/2", "abs(theta_dot)"]


def _machine(data: la.Trajectories, slow=None, **request):
    return data, Request(PENDULUM, **{"dissipation": DAMPING, **request}), slow or {}


def _prescribed():
    data, request, _ = _system("cart_spring_pendulum")
    return data, replace(request, prescribed=["x"]), {}


def _more_known():
    data, request, _ = _system("cart_spring_pendulum")
    return data, replace(request, known={**request.known, "x_dot**2": 1.5}), {}


def _measured_velocity():
    data, request, _ = _system("single_pendulum")
    rng = np.random.default_rng(0)
    out = []
    for run in data:
        rate = np.gradient(run.q, run.t, axis=0)
        out.append(run.changed(velocities=rate + rng.normal(0.0, 0.02, rate.shape)))
    return la.Trajectories(out), request, {}


SET_UPS: dict[str, Callable[[], tuple]] = {
    **{name: lambda name=name: _system(name) for name in systems.names()},
    **{
        f"{name}, absent friction": lambda name=name: _system(name, friction=True)
        for name in ("single_pendulum", "double_pendulum", "cart_spring_pendulum", "chaotic_pendulum")
    },
    **{
        f"{name}, 10 %": lambda name=name: _system(name, 0.1, trials=3)
        for name in ("single_pendulum", "chaotic_pendulum", "magnetic_pendulum")
    },
    **{
        f"{name}, no noise": lambda name=name: _system(name, 0.0)
        for name in ("single_pendulum", "cart_spring_pendulum")
    },
    **{
        f"{name}, large library": lambda name=name: _system(name, library="large")
        for name in ("single_pendulum", "cart_spring_pendulum")
    },
    "missing samples": lambda: _system("double_pendulum", missing=0.1),
    "irregular times": lambda: _system("cart_spring_pendulum", irregular=True),
    "measured velocity": _measured_velocity,
    "prescribed coordinate": _prescribed,
    "two known terms": _more_known,
    "viscous friction": lambda: _machine(_pendulum(2, viscous=0.2)),
    "dry friction": lambda: _machine(_pendulum(3, dry=0.5)),
    "known friction": lambda: _machine(_pendulum(4, viscous=0.2), known={"theta_dot**2/2": 0.2}),
    "constant offset": lambda: _machine(_pendulum(5, offset=0.5), force_offset=["theta"]),
    "slow offset": lambda: _machine(_pendulum(6, drift=0.5), {0: 4.0}),
    "energy fed in": lambda: _machine(_pendulum(7, viscous=-0.15)),
    "forces reversed": lambda: _machine(_pendulum(8, viscous=0.2, sign=-1.0)),
    "pushed a little": lambda: _machine(_pendulum(9, viscous=0.2, pushed=0.3)),
    "pushed": lambda: _machine(_pendulum(10, viscous=0.2, pushed=2.0, noise=1e-4)),
    "pushed hard": lambda: _machine(_pendulum(11, viscous=0.2, pushed=5.0, noise=1e-4)),
    "pushed very hard": lambda: _machine(_pendulum(21, viscous=0.3, pushed=20.0, noise=1e-4)),
    "pushed, no friction": lambda: _machine(_pendulum(12, pushed=2.0, noise=1e-4)),
    "double_well": lambda: _system("double_well"),
    "toda_chain": lambda: _system("toda_chain"),
}


def searched(name: str) -> Search:
    """What a search finds in a set-up."""
    data, request, slow = SET_UPS[name]()
    return run_search(begin_search(build_problem(data, request), slow))


def fresh(search: Search) -> Fit:
    """A fit of the reported structure alone: other candidates never existed, and the start is new.

    The grid is that of the report; the curve begins as the smoothed samples, the coefficients some per cent
    off.
    """
    fit = search.found
    problem = fit.problem
    index = [*fit.structure, *np.flatnonzero(problem.is_known)]
    alone = Problem(
        problem.trajectories, problem.candidates.subset(index), problem.known[index], problem.degree
    )
    grid = Grid.lay(alone, fit.grid.knots_per_second)
    structure = Structure(range(len(fit.structure)))
    curve = grid.smooth()
    off = np.random.default_rng(0).uniform(0.97, 1.03, len(index))
    start = grid.start(structure, curve.control_points, off * fit.coefficients[index], curve.noise_std)
    for _ in range(3):
        start, _ = grid.fit_curve(structure, start)
    again = towards_exact(grid.fit(structure, start))
    if "coefficients-of-free-runs" not in [finding.code for finding in search.findings]:
        return again
    on = Grid.lay(alone.on(search.searched.trajectories), search.scales.per_second)
    found = minimise_simulation_error(
        on, search.scales.smooth, structure, again.coefficients, 0.25 * search.scales.period
    )
    assert found is not None
    coefficients = again.coefficients.copy()
    coefficients[list(structure)] = found.estimates
    return again.grid.held(again, coefficients, found.covariance)


# ---------------------------------------- five short trials as a problem for blocks, and a cluster that fails
DURATIONS = (2.0, 1.5, 3.0, 0.8, 2.2)
TERMS = ["x_dot**2", "y_dot**2", "x_dot*y_dot*cos(y)", "cos(y)", "x**2"]
MORE = [*TERMS, "x*y", "x**4"]
VALUES = np.array([1.5, 0.6, 1.1, 9.81, -5.0])
WEIGHTS = Weights(np.array([0.02, 0.03, 0.1]), np.array([4.0, 9.0]), np.array([7.0, 3.0]), 0.01)


def motion(t):
    return np.column_stack([0.5 * np.sin(2.3 * t) + 0.2, 0.7 * np.cos(3.1 * t)])


def problem():
    """Five trials of different lengths, with missing samples, a velocity, and forces."""
    grid = uniform_grid(DURATIONS, 6.0, 5, 2)
    rng = np.random.default_rng(5)
    times = [np.sort(rng.uniform(0.0, d, 60)) for d in DURATIONS]
    values = [motion(t) + 0.02 * rng.standard_normal((t.size, 2)) for t in times]
    values[1][5:9, 0] = np.nan
    values[3][:, 1] = np.nan  # not measured at all in this trial
    rates = (Rate(1, 1, tuple(-0.7 * 3.1 * np.sin(3.1 * t) for t in times)),)
    forces = rng.standard_normal((*grid.points.shape, 2))
    physics = Physics(euler_lagrange(TERMS, ["x", "y"]), np.array([True, True, True, False, True]), forces)
    control = interpolate(grid, [motion] * len(DURATIONS)) + 0.01 * rng.standard_normal((grid.n_ctrl, 2))
    return grid, (times, values, rates), physics, control


def close(found, expected, tolerance=1e-9):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * max(float(scale), 1e-300))


def linearised_alike(whole, parts, physics, control):
    """The problem in one piece and in parts, linearised at one point where their sums are the same."""
    for mine, others in zip(parts.residuals(control), whole.residuals(control), strict=True):
        np.testing.assert_allclose(mine, others, atol=1e-12)
    here, there = (linearise(seen, physics, control, VALUES) for seen in (whole, parts))
    for name in ("squares", "equation", "volume"):
        close(getattr(there, name), getattr(here, name), 1e-12)
    assert there.log_volume == pytest.approx(here.log_volume, rel=1e-12)
    assert there.regular == pytest.approx(here.regular, rel=1e-12)
    assert there.cost(WEIGHTS) == pytest.approx(here.cost(WEIGHTS), rel=1e-12)
    for mine, others in zip(there.freedom(WEIGHTS), here.freedom(WEIGHTS), strict=True):
        close(mine, others)
    return here, there


SMALL = 20 * 2 * 4 * 6
"""Numbers in the Jacobian of 20 knot intervals of two coordinates: a block holds one of the trials or two."""


def assert_refused_in_one_line(read: Callable[..., object], given: object, words: str) -> None:
    """A reader refuses what it is given, with a message of one line that holds some words."""
    with pytest.raises(la.InputError) as caught:
        read(given)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def assert_same(one, other, tolerance: float = 1e-6):
    """Terms, coefficients within a millionth of a standard error, and the verdict."""
    assert [t.expression for t in one.terms] == [t.expression for t in other.terms]
    for a, b in zip(one.terms, other.terms, strict=True):
        assert abs(a.coefficient - b.coefficient) <= tolerance * a.standard_error
        assert b.standard_error == pytest.approx(a.standard_error, rel=1e-5)
    assert one.fit.status == other.fit.status
    assert [f.code for f in one.fit.findings] == [f.code for f in other.fit.findings]


class Cluster:
    """The methods of Dask's client that are used, computing at once; every so often a result is lost."""

    def __init__(self, lost_every: int, gone_after: int = 10**9) -> None:
        self.lost_every, self.gone_after, self.submitted = lost_every, gone_after, 0

    def scheduler_info(self, n_workers: int = 5) -> dict:
        return {"workers": {"a": {}, "b": {}}}

    def submit(self, function, *given, pure=True) -> Future:
        self.submitted += 1
        if self.submitted > self.gone_after:
            raise OSError("the scheduler is gone")
        out: Future = Future()
        try:
            if self.submitted % self.lost_every == 0:
                raise CancelledError
            out.set_result(function(*(x.result() if isinstance(x, Future) else x for x in given)))
        except BaseException as error:
            out.set_exception(error)
        return out


# ------------------------------------------ models that the exports are tried with, and states to try them at
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def rubbed(name):
    system = systems.get(name)
    damping = [ModelTerm(f"{c}_dot**2*abs({c}_dot)", 0.1) for c in system.coordinates]
    return LagrangianModel(
        system.coordinates, [ModelTerm(k, c) for k, c in system.lagrangian.items()], damping
    )


def passive(name):
    system = systems.get(name)
    return LagrangianModel(system.coordinates, [ModelTerm(k, c) for k, c in system.lagrangian.items()])


def driven():
    """Double pendulum with Coulomb friction, smoothed as `discover` does, and viscous friction."""
    system = systems.get("double_pendulum")
    friction = [ModelTerm("sqrt(theta1_dot**2 + 9/10000)", 0.2), ModelTerm("theta2_dot**2/2", 0.05)]
    return LagrangianModel(
        system.coordinates, [ModelTerm(k, c) for k, c in system.lagrangian.items()], friction
    )


def odd():
    """Every function of the grammar, Greek names, and names that occur in generated code."""
    names = ["θ1", "math", "n"]
    terms = [
        ModelTerm("(θ1_dot**2 + math_dot**2 + n_dot**2)*exp(sin(θ1)/3)", 1 / 3),
        ModelTerm("θ1_dot*n_dot*tan(θ1/2)*sqrt(2)/10", 0.1),
        ModelTerm("log(2 + cos(math))*sqrt(1 + n**2)*exp(1)", -1.7),
        ModelTerm("(1 + n**2)**(-3/2)*abs(θ1)**2.5", 0.7),
        ModelTerm("abs(math)*pi*θ1**5/(1 + math**4)", 123456.789e-5),
    ]
    return LagrangianModel(names, terms, [ModelTerm("abs(n_dot) + sqrt(1 + n_dot**2)", 0.3)])


def rubbing():
    """Every family of friction that has a name, smoothed as `discover` does."""
    speed = "sqrt(a_dot**2 + 1/10000)"
    terms = [
        speed,
        f"-0.3*exp(-{speed}/0.3)",
        f"{speed}*abs(cos(a))",
        f"a_dot*{speed}/2",
        "a_dot",
        "a_dot**2/2",
    ]
    friction = [
        ModelTerm(text, size) for text, size in zip(terms, [0.4, 0.5, 0.2, -0.1, 0.05, 0.3], strict=True)
    ]
    return LagrangianModel(["a"], [ModelTerm("a_dot**2", 0.4), ModelTerm("cos(a)", 6.0)], friction)


MODELS = {
    "rubbing": rubbing,
    "odd": odd,
    "single": lambda: rubbed("single_pendulum"),
    "chaotic": lambda: rubbed("chaotic_pendulum"),
    "spherical": lambda: rubbed("spherical_spring_pendulum"),
    "magnetic": lambda: rubbed("magnetic_pendulum"),
    "passive": lambda: passive("cart_spring_pendulum"),
    "driven": lambda: driven(),
    # The diagonal is zero: elimination without pivoting would fail.
    "swapped": lambda: LagrangianModel(["x", "y"], [ModelTerm("x_dot*y_dot", 1.0), ModelTerm("x*y", 2.0)]),
    "free": lambda: LagrangianModel(["x"], [ModelTerm("x_dot**2", 1.5)]),
}


def states(model):
    return np.random.default_rng(4).uniform(0.2, 1.5, size=(5, 3, model.n_dof))


def timed():
    """A pendulum that is rocked, with a mass that leaks: the time is everywhere, the mass matrix included."""
    terms = [
        ModelTerm("theta_dot**2*exp(-t/4)", 0.5),
        ModelTerm("x_dot**2", 0.7),
        ModelTerm("theta_dot*x_dot*cos(theta - t)", 0.2),
        ModelTerm("cos(theta)*cos(3*t)", 4.0),
        ModelTerm("x**2*t**2", -0.1),
    ]
    return LagrangianModel(["theta", "x"], terms, [ModelTerm("x_dot**2*(2 + sin(t))", 0.1)])


_BALL = '<collision><origin xyz="{x} 0 0"/><geometry>{shape}</geometry></collision>'
_SPHERE = '<sphere radius="0.05"/>'


def folding(shape: str = _SPHERE, at: float = 0.3, axis: str = "0 0 1") -> str:
    """A URDF of three links of 0.3 m about parallel axes, with a shape at the end of each and on the base."""
    links = [f"<link name='base'>{_BALL.format(x=0.0, shape=_SPHERE)}</link>"]
    for k in range(3):
        inertia = "<inertia ixx='.01' ixy='0' ixz='0' iyy='.01' iyz='0' izz='.01'/>"
        body = f"<inertial><origin xyz='.15 0 0'/><mass value='1'/>{inertia}</inertial>"
        links.append(f"<link name='l{k}'>{body}{_BALL.format(x=at, shape=shape)}</link>")
        above = f"l{k - 1}" if k else "base"
        where = f"<parent link='{above}'/><child link='l{k}'/><axis xyz='{axis}'/>"
        bound = "<limit lower='-3' upper='3' velocity='2' effort='50'/>"
        at_end = f"<origin xyz='{0.3 if k else 0.0} 0 0'/>"
        links.append(f"<joint name='q{k + 1}' type='revolute'>{where}{at_end}{bound}</joint>")
    return f"<robot name='folding'>{''.join(links)}</robot>"
