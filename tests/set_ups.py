"""Varied discoveries, small enough for a test, and a fresh fit of what each of them reports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction import systems
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.exact_limit import towards_exact
from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Problem
from leastaction.estimation.simulation_error import minimise_simulation_error
from leastaction.estimation.structure import Structure
from leastaction.selection.search import run_search
from leastaction.selection.search_state import Search, begin_search
from leastaction.simulation.integrate import rk4


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
