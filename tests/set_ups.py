"""Small problems that tests share: discoveries with a fresh fit of each, and short trials in blocks."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from helpers import euler_lagrange, interpolate, uniform_grid
from leastaction import systems
from leastaction.data.trajectories import Rate
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.exact_limit import towards_exact
from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.problem import Problem
from leastaction.estimation.simulation_error import minimise_simulation_error
from leastaction.estimation.structure import Structure
from leastaction.selection.search import run_search
from leastaction.selection.search_state import Search, begin_search
from leastaction.simulation.integrate import rk4


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
FRICTION = ["theta_dot**2/2", "abs(theta_dot)"]


def _machine(data: la.Trajectories, slow=None, **request):
    return data, Request(PENDULUM, **{"dissipation": FRICTION, **request}), slow or {}


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


SMALL = 20 * 2 * 4 * 6
"""Numbers in the Jacobian of 20 knot intervals of two coordinates: a block holds one of the trials or two."""


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
