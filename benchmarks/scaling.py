"""Processor time and peak memory of discover() against the number of coordinates and of candidates.

    python benchmarks/scaling.py                      # all cases, 600 s each at most
    python benchmarks/scaling.py --only links         # cases whose name holds a word
    python benchmarks/scaling.py --measured FILE      # with a measured triple pendulum (t, theta1..3 a trial)

The systems are planar chains of n driven links with point masses, simulated here from their mass matrix in
absolute angles φ_i,

    L = Σ_ij ½ a_ij φ̇_i φ̇_j cos(φ_i − φ_j) + Σ_i b_i cos φ_i,      a_ij = Σ_{k ≥ max(i, j)} m_k,

with viscous friction in the joints.  Relative angles q_i = φ_i − φ_{i−1} are those of an arm.  Every case
runs in a process of its own with one thread, so that time and memory are its own.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import click
import numpy as np

_NOISE = 0.01
_GRAVITY, _FRICTION = 9.81, 1.0
_PASSED = 200  # trials of one pass, 20 s at 100 Hz each


@click.command()
@click.option("--only", default="", help="Run the cases whose name holds this.")
@click.option("--limit", default=600.0, show_default=True, help="Seconds a case.")
@click.option("--measured", type=click.Path(path_type=Path), help="CSV of a measured triple pendulum.")
@click.option("--case", help="Run one case, given as JSON, in this process (used by the program itself).")
@click.option("--output", type=click.Path(path_type=Path), default=Path("benchmarks/results/scaling.jsonl"))
def main(only: str, limit: float, measured: Path | None, case: str | None, output: Path) -> None:
    """Print a table; write one line of JSON a case."""
    if case is not None:
        click.echo(json.dumps(measure(**json.loads(case))))
        return
    output.parent.mkdir(parents=True, exist_ok=True)
    for name, config in cases(measured).items():
        if only in name:
            record = {"case": name, **run(config, limit)}
            with output.open("a") as file:
                file.write(json.dumps(record, sort_keys=True) + "\n")
            click.echo(row(record))


def cases(measured: Path | None) -> dict[str, dict]:
    """Name → arguments of :func:`measure`."""
    chains = {f"links {n}": {"system": "chain", "links": n} for n in range(1, 8)}
    arms = {f"arm links {n}": {"system": "arm", "links": n} for n in range(2, 8)}
    sizes = {f"candidates {k}": {"system": "chain", "links": 2, "extra": k} for k in (10, 20, 40, 80, 160)}
    generated = {f"generated {n}": {"system": "generated", "links": n} for n in (1, 2, 3, 4)}
    lengths = {f"rows {n}": {"system": "rows", "rows": n} for n in (10_000, 100_000, 1_000_000)}
    out = {**chains, **arms, **sizes, **generated, **lengths, "fifty-one": {"system": "large"}}
    if measured is not None:
        out["measured triple pendulum"] = {"system": "measured", "path": str(measured)}
    return out


def run(config: dict, limit: float) -> dict:
    """Measure one case in another process."""
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    command = [sys.executable, __file__, "--case", json.dumps(config)]
    begun = time.perf_counter()
    try:
        done = subprocess.run(
            command, env={**os.environ, **threads}, capture_output=True, text=True, timeout=limit
        )
    except subprocess.TimeoutExpired:
        return {**config, "failed": f"no answer in {limit:g} s"}
    if done.returncode:
        return {**config, "failed": done.stderr.strip().splitlines()[-1]}
    answer = json.loads(done.stdout.splitlines()[-1])
    return {**config, **answer, "wall_s": round(time.perf_counter() - begun, 2)}


def row(record: dict) -> str:
    """One line of the table."""
    if "failed" in record:
        return f"{record['case']:<26} {record['failed']}"
    return (
        f"{record['case']:<26} {record['candidates']:>4} candidates  {record['cpu_s']:>7.1f} s  "
        f"{record['peak_mb']:>6.0f} MB  {record['right']:>2} of {record['own']:>2} terms, "
        f"{record['others']} others, {record['status']}"
    )


# ------------------------------------------------------------------------------------------ one case
def measure(system: str, **config) -> dict:
    """Discover once in this process; time is the processor's, without import and simulation."""
    import leastaction as la

    makers = {"chain": chain, "arm": arm, "generated": generated, "rows": rows, "large": large}
    data, library, keywords, own = {**makers, "measured": measured_triple}[system](**config)
    used = time.process_time()
    model = la.discover(data, library, **keywords)
    cpu = time.process_time() - used
    found = {term.expression for term in (*model.terms, *model.dissipation)}
    return {
        "cpu_s": round(cpu, 2),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0),
        "candidates": int(model.provenance["n_candidates"]),
        "own": len(own),
        "right": len(found & own),
        "others": len(found - own),
        "status": model.fit.status,
        "stages_s": {k: round(v, 2) for k, v in model.diagnostics.timings.items()},
    }


def chain(links: int, extra: int = 20):
    """A driven chain in absolute angles with its own terms and some others."""
    names = [f"a{i}" for i in range(1, links + 1)]
    own = [f"{a}_dot**2" for a in names]
    own += [f"{a}_dot*{b}_dot*cos({a}-{b})" for a, b in combinations(names, 2)]
    own += [f"cos({a})" for a in names]
    return _library(links, names, own, _others(names, extra), relative=False)


def arm(links: int):
    """A driven arm in relative angles: its own terms of L and frictions, and as many others."""
    names = [f"q{i}" for i in range(1, links + 1)]
    sums = ["+".join(names[: i + 1]) for i in range(links)]
    rates = ["(" + "+".join(f"{name}_dot" for name in names[: i + 1]) + ")" for i in range(links)]
    own = [f"{rate}**2" for rate in rates]
    own += [
        f"{rates[i]}*{rates[j]}*cos({'+'.join(names[i + 1 : j + 1])})"
        for i, j in combinations(range(links), 2)
    ]
    own += [f"cos({angle})" for angle in sums]
    return _library(links, names, own, _others(names, len(own) + links), relative=True)


def _others(names: list[str], count: int) -> list[str]:
    """Candidates that a mechanical library may hold besides the law, the simplest first."""
    pairs = list(combinations(names, 2))
    pool = [f"sin({a})" for a in names]
    pool += [f"{a}_dot*{b}_dot" for a, b in pairs]
    pool += [f"cos({a}-{b})" for a, b in pairs]
    pool += [f"cos({a})**2" for a in names]
    pool += [f"{a}_dot**2*cos({b})" for a in names for b in names]
    pool += [f"{a}_dot*{b}_dot*sin({c})" for a, b in pairs for c in names]
    pool += [f"sin({k}*{a})" for k in (2, 3, 4, 5, 6) for a in names]
    pool += [f"cos({k}*{a})" for k in (3, 4, 5, 6, 7) for a in names]
    pool += [f"{a}_dot**2*cos({k}*{b})" for k in range(2, 30) for a in names for b in names]
    return pool[:count]


def _library(links: int, names: list[str], own: list[str], others: list[str], relative: bool):
    import leastaction as la

    data = simulate(links, names, relative)
    friction = [f"{a}_dot**2/2" for a in names] if relative else []
    if not relative:  # in the joints, between neighbours
        friction = [f"{names[0]}_dot**2/2", *(f"({b}_dot-{a}_dot)**2/2" for a, b in pairwise(names))]
    library = la.Library([*own, *others], names, angles=names, dissipation=friction)
    texts = {term.text for term in library.terms[: len(own)]} | {t.text for t in library.dissipation}
    return data, library, {}, texts


def generated(links: int):
    """A chain with the generated standard library."""
    import leastaction as la

    _, library, _, own = chain(links, 0)
    names = list(library.coordinates)
    wide = la.Library.mechanical(names, angles=names, dissipation=library.dissipation)
    return simulate(links, names, False), wide, {}, own


def rows(rows: int):
    """Long recordings of the double pendulum with a compact library, made in another process."""
    from multiprocessing import get_context

    from leastaction import systems

    with get_context("spawn").Pool(1) as pool:  # the simulation takes more memory than the search
        data = pool.apply(_long_recordings, (rows,))
    return data, systems.compact_library("double_pendulum"), {}, _own("double_pendulum")


def _long_recordings(rows: int):
    from leastaction import systems

    trials = max(1, round(rows / 2000))
    shape = {"trials": trials, "duration": rows / trials / 100.0, "rate": 100.0, "seed": 0}
    return systems.generate("double_pendulum", noise=0.1, **shape)


def large():
    """The double pendulum with 51 candidates."""
    from leastaction import systems

    data = systems.generate("double_pendulum", noise=0.1, trials=10, duration=20.01, rate=100.0, seed=0)
    return data, systems.large_library("double_pendulum"), {}, _own("double_pendulum")


def _own(name: str) -> set[str]:
    """The law's terms, as a model writes them."""
    import leastaction as la
    from leastaction import systems

    system = systems.get(name)
    return {term.text for term in la.Library(list(system.lagrangian), system.coordinates).terms}


def measured_triple(path: str):
    """A measured triple pendulum with the generated library and six friction terms."""
    import leastaction as la
    from leastaction.io import read_csv

    names = [f"theta{i}" for i in (1, 2, 3)]
    data = read_csv(path, names, trial="trial", angles=names)
    friction = [f"{a}_dot**2/2" for a in names] + [f"abs({a}_dot)" for a in names]
    library = la.Library.mechanical(names, angles=names, dissipation=friction)
    own = {f"{a}_dot**2" for a in names} | {f"cos({a})" for a in names}
    own |= {f"{a}_dot*{b}_dot*cos({a}-{b})" for a, b in combinations(names, 2)}
    return (
        data,
        library,
        {"known": {"theta1_dot**2": 1.0}},
        {str(la.Library([t], names)[0].text) for t in own},
    )


# ---------------------------------------------------------------------------------------- simulation
def simulate(links: int, names: list[str], relative: bool, trials: int = 5, duration: float = 10.0):
    """Trials of a driven chain at 100 Hz with white noise of one per cent of each coordinate's spread."""
    import leastaction as la

    rng = np.random.default_rng([links, int(relative)])
    out, turn = [], np.tril(np.ones((links, links)))  # φ = turn q
    for _ in range(trials):
        t, phi, torque = _trial(links, duration, rng)
        q = np.linalg.solve(turn, phi.T).T if relative else phi
        forces = torque if relative else np.linalg.solve(turn.T, torque.T).T
        noisy = q + _NOISE * q.std(axis=0) * rng.standard_normal(q.shape)
        out.append(la.Trajectory(t, noisy, forces, names))
    return la.Trajectories(out)


def _trial(links: int, duration: float, rng: np.random.Generator):
    """Times, absolute angles, and torques of the joints."""
    from scipy.integrate import solve_ivp

    masses = 1.0 + 0.3 * np.cos(np.arange(links))
    below = np.cumsum(masses[::-1])[::-1]
    inertia = below[np.maximum.outer(np.arange(links), np.arange(links))]
    turn = np.tril(np.ones((links, links)))
    amplitude, frequency = 2.0 * below[:, None], rng.uniform(1.0, 6.0, (links, 2))
    phase = rng.uniform(0.0, 2.0 * np.pi, (links, 2))

    def torque(t):
        return (amplitude * np.sin(frequency * np.asarray(t)[..., None, None] + phase)).sum(axis=-1)

    def slope(t, state):
        phi, rate = np.split(state, 2)
        gap = np.subtract.outer(phi, phi)
        relative = np.linalg.solve(turn, rate)
        push = np.linalg.solve(turn.T, torque(t) - _FRICTION * relative)
        push -= (inertia * np.sin(gap)) @ rate**2 + _GRAVITY * below * np.sin(phi)
        return np.concatenate([rate, np.linalg.solve(inertia * np.cos(gap), push)])

    t = np.arange(0.0, duration, 0.01)
    start = np.concatenate([rng.uniform(-0.8, 0.8, links), np.zeros(links)])
    path = solve_ivp(slope, (0.0, duration), start, t_eval=t, rtol=1e-9, atol=1e-9, method="DOP853")
    return t, path.y[:links].T, torque(t)


# --------------------------------------------- one pass, one arm: run.py workers --pass, run.py workers --arm
def compare_on_an_arm(seconds: float, repeats: int = 3) -> None:
    """Identify an arm with one and with two workers, in turn."""
    from benchmarks.arms import chain
    from leastaction import arms
    from leastaction.threads import single_threaded

    made, walls = chain(1, seconds, 0.001), {1: [], 2: []}
    with single_threaded():
        for _ in range(repeats):
            for number, times in walls.items():
                begun = time.perf_counter()
                arms.identify(made.log, made.true.tree, workers=number)
                times.append(time.perf_counter() - begun)
    one, two = (float(np.median(times)) for times in walls.values())
    click.echo(f"log of {seconds:g} s: one worker {one:.1f} s, two {two:.1f} s, ratio {one / two:.2f}")


def compare_passes(repeats: int = 10) -> None:
    """One pass along a motion: alone, by two workers, and its halves in two processes that share nothing."""
    from leastaction.estimation.crew import employ
    from leastaction.threads import single_threaded

    walls: dict[str, list[float]] = {"alone": [], "two workers": [], "nothing shared": []}
    with single_threaded(), employ(2) as crew:
        alone, shared, halves = one_pass(_PASSED), one_pass(_PASSED, crew), [one_pass(_PASSED // 2)] * 2
        shared()  # children start
        for _ in range(repeats):
            for name, run in (
                ("alone", alone),
                ("two workers", shared),
                ("nothing shared", lambda: in_processes(halves)),
            ):
                begun = time.perf_counter()
                run()
                walls[name].append(time.perf_counter() - begun)
    for name, times in walls.items():
        ratio = np.median(walls["alone"]) / np.median(times)
        click.echo(f"{name:<14} median {np.median(times):.3f} s  ratio {ratio:.2f}")


def one_pass(trials: int, crew: Any = None) -> Callable[[], object]:
    """What a Gauss–Newton step does with so many trials, from the smoothed samples."""
    from leastaction import systems
    from leastaction.curve.bspline import uniform_grid
    from leastaction.curve.smoothing import smooth
    from leastaction.estimation.blocks import observe
    from leastaction.estimation.joint import Physics, Weights
    from leastaction.mechanics.euler_lagrange import EulerLagrange

    t, rng = np.arange(0.0, 20.0, 0.01), np.random.default_rng(0)
    motion = np.column_stack([np.sin(2.3 * t), 0.7 * np.cos(3.1 * t)])
    library = systems.compact_library("double_pendulum")
    columns = EulerLagrange(library.terms[:6], library.coordinates)
    grid = uniform_grid([t] * trials, 100.0, 5, 2)
    noisy = [motion + 0.01 * rng.standard_normal(motion.shape) for _ in range(trials)]
    seen = observe(grid, [t] * trials, noisy, crew=crew)
    control = smooth(grid, [t] * trials, noisy).control_points
    physics = Physics(columns, np.ones(6, bool), None)
    weights = Weights(np.full(2, 0.01), np.ones(2), np.ones(2))
    return lambda: seen.linearise(physics, control, np.ones(6), weights).normal(weights).eliminate()


def in_processes(halves: Iterable[Callable[[], object]]) -> None:
    """Each in a process of its own."""
    children = []
    for run in halves:
        child = os.fork()
        if not child:
            run()
            os._exit(0)
        children.append(child)
    for child in children:
        os.waitpid(child, 0)


if __name__ == "__main__":
    main()
