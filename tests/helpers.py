"""Oracles and small problems shared by the tests of the numerical core."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_lsq_spline

from leastaction import systems
from leastaction.curve.bspline import SplineGrid, SplineSpace
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.findings import Finding
from leastaction.identifiers import names_in_terms
from leastaction.library import Term
from leastaction.library.term import make_term
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.simulation.integrate import simulate

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
