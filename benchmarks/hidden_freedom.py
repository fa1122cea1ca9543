"""How often a degree of freedom without a sensor is noticed, and how often one is seen that is not there.

A machine is a pendulum that carries another, a cart with a hook, a box with a mass inside, two links with an
elastic joint, a pendulum with a sloshing load, or a crane with a hook, driven, of random size. Nothing
measures the last coordinate. The same machines with that coordinate locked have one fault each: friction that
is not offered, vibration from outside, a term that is not in the library, forces that act late, or forces
of another size.

    python -m benchmarks.hidden_freedom --first 3000 --count 17 [--whole]

The method was chosen, and its thresholds set, on pendulums, carts and boxes with seeds below 12 and from 200
to 214. Judge it by the other kinds, and by other seeds. Without ``--whole`` only the check runs, not the
other causes of an equation error.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import click
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction.diagnosis.hidden_freedom import hidden_freedom
from leastaction.diagnosis.verdict import verify
from leastaction.estimation.build import Request, build_problem
from leastaction.selection.search import run_search
from leastaction.selection.search_state import begin_search, equations_hold
from leastaction.simulation.integrate import rk4
from leastaction.systems import MechanicalSystem
from leastaction.threads import single_threaded

RULE, ASIDE = ("pendulum", "cart", "box"), ("joint", "slosh", "crane")
FAULTS = ("friction", "vibration", "library", "delay", "scale")
TRIALS, DURATION, RATE, FINE = 4, 8.0, 100.0, 1000.0
_G = 9.81


@dataclass(frozen=True)
class Plant:
    """L of all coordinates, the hidden one last; what locks it; friction; and the size of the motion."""

    names: tuple[str, ...]
    law: dict[str, float]
    locked: dict[str, float]
    friction: dict[str, float]
    drive: tuple[float, ...]
    start: tuple[float, ...]
    angles: tuple[str, ...]
    fault: str


def _pendulum(rng: np.random.Generator) -> Plant:
    m1, m2, l1 = rng.uniform(0.5, 1.5), rng.uniform(0.1, 0.6), rng.uniform(0.3, 0.6)
    m2, l2 = m1 * m2, l1 * rng.uniform(0.2, 0.8)
    law = {
        "theta_dot**2": 0.5 * (m1 + m2) * l1**2,
        "z_dot**2": 0.5 * m2 * l2**2,
        "theta_dot*z_dot*cos(theta-z)": m2 * l1 * l2,
        "cos(theta)": (m1 + m2) * _G * l1,
        "cos(z)": m2 * _G * l2,
    }
    locked = {"theta_dot**2": 0.5 * (m1 + m2) * l1**2, "cos(theta)": (m1 + m2) * _G * l1}
    damping = 2.0 * rng.uniform(0.01, 0.15) * np.sqrt(_G / l2) * m2 * l2**2
    size = law["cos(theta)"]
    friction = {"theta_dot**2/2": rng.uniform(0.02, 0.1) * size * np.sqrt(l1 / _G)}
    friction["(z_dot-theta_dot)**2/2"] = damping
    return Plant(
        ("theta", "z"), law, locked, friction, (0.3 * size,), (1.0,), ("theta", "z"), "sin(theta)**3"
    )


def _cart(rng: np.random.Generator) -> Plant:
    m, hook, length, k = (
        rng.uniform(1, 3),
        rng.uniform(0.1, 0.6),
        rng.uniform(0.15, 0.8),
        rng.uniform(10, 60),
    )
    hook = m * hook
    law = {
        "x_dot**2": 0.5 * (m + hook),
        "z_dot**2": 0.5 * hook * length**2,
        "x_dot*z_dot*cos(z)": hook * length,
        "cos(z)": hook * _G * length,
        "x**2": -0.5 * k,
    }
    locked = {"x_dot**2": 0.5 * (m + hook), "x**2": -0.5 * k}
    friction = {
        "x_dot**2/2": rng.uniform(0.02, 0.1) * np.sqrt(k * m),
        "z_dot**2/2": 2.0 * rng.uniform(0.01, 0.15) * np.sqrt(_G / length) * hook * length**2,
    }
    return Plant(("x", "z"), law, locked, friction, (0.3 * k,), (0.3,), ("z",), "exp(-2*x)")


def _box(rng: np.random.Generator) -> Plant:
    m, inner, k = rng.uniform(0.5, 2.0), rng.uniform(0.1, 0.6), rng.uniform(10.0, 80.0)
    inner = m * inner
    own = inner * k / m * rng.uniform(0.7, 3.0) ** 2
    law = {"x_dot**2": 0.5 * m, "z_dot**2": 0.5 * inner, "x**2": -0.5 * k, "(z-x)**2": -0.5 * own}
    locked = {"x_dot**2": 0.5 * (m + inner), "x**2": -0.5 * k}
    friction = {
        "x_dot**2/2": rng.uniform(0.02, 0.1) * np.sqrt(k * m),
        "(z_dot-x_dot)**2/2": 2.0 * rng.uniform(0.01, 0.2) * np.sqrt(own * inner),
    }
    return Plant(("x", "z"), law, locked, friction, (0.5 * k,), (0.5,), (), "abs(x)**3")


def _joint(rng: np.random.Generator) -> Plant:
    m1, m2, l1, l2 = *rng.uniform(0.4, 1.2, 2), *rng.uniform(0.25, 0.5, 2)
    a, b, c = (m1 + m2) * l1**2, m2 * l2**2, m2 * l1 * l2
    rotor = b * rng.uniform(0.3, 1.5)
    stiff = b * (rng.uniform(2.0, 6.0) * 2.0 * np.pi) ** 2 / (1.0 + b / rotor)
    g1, g2 = (m1 + m2) * _G * l1, m2 * _G * l2
    law = {
        "q1_dot**2": 0.5 * a,
        "z_dot**2": 0.5 * b,
        "q1_dot*z_dot*cos(q1-z)": c,
        "q2_dot**2": 0.5 * rotor,
        "(z-q2)**2": -0.5 * stiff,
        "cos(q1)": g1,
        "cos(z)": g2,
    }
    locked = {
        "q1_dot**2": 0.5 * a,
        "q2_dot**2": 0.5 * (b + rotor),
        "q1_dot*q2_dot*cos(q1-q2)": c,
        "cos(q1)": g1,
        "cos(q2)": g2,
    }
    friction = {
        "q1_dot**2/2": rng.uniform(0.02, 0.1) * g1 * np.sqrt(l1 / _G),
        "q2_dot**2/2": rng.uniform(0.02, 0.1) * g2 * np.sqrt(l2 / _G),
        "(z_dot-q2_dot)**2/2": 2.0 * rng.uniform(0.01, 0.1) * np.sqrt(stiff * b),
    }
    return Plant(
        ("q1", "q2", "z"),
        law,
        locked,
        friction,
        (0.3 * g1, 0.5 * g2),
        (1.0, 1.0),
        ("q1", "q2", "z"),
        "sin(q2)**3",
    )


def _slosh(rng: np.random.Generator) -> Plant:
    m1, m2, length = rng.uniform(0.5, 1.5), rng.uniform(0.1, 0.6), rng.uniform(0.3, 0.8)
    m2 = m1 * m2
    own = m2 * (rng.uniform(0.8, 3.0) * np.sqrt(_G / length)) ** 2
    size = (m1 + m2) * _G * length
    law = {
        "theta_dot**2": 0.5 * (m1 + m2) * length**2,
        "z_dot**2": 0.5 * m2,
        "theta_dot*z_dot": m2 * length,
        "z**2*theta_dot**2": 0.5 * m2,
        "cos(theta)": size,
        "z*sin(theta)": -m2 * _G,
        "z**2": -0.5 * own,
    }
    locked = {"theta_dot**2": 0.5 * (m1 + m2) * length**2, "cos(theta)": size}
    friction = {
        "theta_dot**2/2": rng.uniform(0.02, 0.1) * size * np.sqrt(length / _G),
        "z_dot**2/2": 2.0 * rng.uniform(0.01, 0.15) * np.sqrt(own * m2),
    }
    return Plant(("theta", "z"), law, locked, friction, (0.3 * size,), (1.0,), ("theta",), "sin(theta)**3")


def _crane(rng: np.random.Generator) -> Plant:
    m, load, l1, k = rng.uniform(1.0, 3.0), rng.uniform(0.3, 1.0), rng.uniform(0.4, 0.8), rng.uniform(10, 40)
    hook, l2 = load * rng.uniform(0.2, 0.8), l1 * rng.uniform(0.2, 0.7)
    both = load + hook
    law = {
        "x_dot**2": 0.5 * (m + both),
        "theta_dot**2": 0.5 * both * l1**2,
        "z_dot**2": 0.5 * hook * l2**2,
        "x_dot*theta_dot*cos(theta)": both * l1,
        "x_dot*z_dot*cos(z)": hook * l2,
        "theta_dot*z_dot*cos(theta-z)": hook * l1 * l2,
        "x**2": -0.5 * k,
        "cos(theta)": both * _G * l1,
        "cos(z)": hook * _G * l2,
    }
    locked = {text: value for text, value in law.items() if "z" not in text}
    friction = {
        "x_dot**2/2": rng.uniform(0.02, 0.1) * np.sqrt(k * m),
        "theta_dot**2/2": rng.uniform(0.02, 0.1) * both * np.sqrt(_G * l1) * l1,
        "(z_dot-theta_dot)**2/2": 2.0 * rng.uniform(0.01, 0.1) * np.sqrt(_G / l2) * hook * l2**2,
    }
    drive = (0.3 * k, 0.3 * both * _G * l1)
    return Plant(
        ("x", "theta", "z"), law, locked, friction, drive, (0.3, 1.0), ("theta", "z"), "sin(theta)**3"
    )


_PLANTS: dict[str, Callable[[np.random.Generator], Plant]] = {
    "pendulum": _pendulum,
    "cart": _cart,
    "box": _box,
    "joint": _joint,
    "slosh": _slosh,
    "crane": _crane,
}


@dataclass(frozen=True)
class Machine:
    """Recordings, what is asked, and what is true."""

    data: la.Trajectories
    library: la.Library
    friction: tuple[str, ...]
    hidden: bool
    fault: str = ""
    frequency: float = np.nan


def _law(plant: Plant, hidden: bool, fault: str, rng: np.random.Generator) -> MechanicalSystem:
    """The machine as a system, its hidden coordinate locked or free, with a fault of its law."""
    names = plant.names if hidden else plant.names[:-1]
    law = dict(plant.law if hidden else plant.locked)
    friction = {k: v for k, v in plant.friction.items() if hidden or "z" not in k}
    if fault == "library":
        sign = -1.0 if "x" in plant.fault else rng.choice([-1.0, 1.0])  # a well has to hold a length
        law[plant.fault] = float(sign * rng.uniform(0.1, 0.5) * plant.drive[-1])
    if fault == "friction":
        pushed = f"{names[-1]}_dot"
        size = rng.uniform(0.1, 0.4) * plant.drive[-1]
        friction[f"sqrt({pushed}**2+1e-4)"] = size
    return MechanicalSystem(
        "machine", "", names, law, (), lambda _: (np.zeros(1), np.zeros(1)), dissipation=friction
    )


def _given(plant: Plant, fine: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(trials, n_fine, n_measured) forces of four sines each."""
    n, out = len(plant.names) - 1, np.zeros((TRIALS, fine.size, len(plant.names) - 1))
    for w in rng.uniform(0.5, 12.0, (4, TRIALS, 1, n)):
        phase = rng.uniform(0.0, 2.0 * np.pi, (TRIALS, 1, n))
        out += rng.normal(size=(TRIALS, 1, n)) * np.sin(w * fine[:, None] + phase)
    return 0.5 * np.array(plant.drive) * out


def _acting(given: np.ndarray, plant: Plant, fault: str, rng: np.random.Generator) -> np.ndarray:
    """What really pushes, where it is not what was recorded."""
    drive = np.array(plant.drive)
    if fault == "delay":
        lag = int(rng.uniform(0.01, 0.04) * FINE)
        return np.concatenate(
            [np.repeat(given[:, :1], lag, axis=1), given[:, : given.shape[1] - lag]], axis=1
        )
    if fault == "scale":
        return given * rng.choice([0.7, 0.8, 1.25, 1.5], size=drive.size)
    if fault == "vibration":
        low = rng.uniform(0.5, 12.0)
        if rng.random() < 0.3:  # a tone
            t, phase = np.arange(given.shape[1]) / FINE, rng.uniform(0, 6.3, (TRIALS, 1, drive.size))
            fast = np.sqrt(2.0) * np.sin(2.0 * np.pi * low * t[:, None] + phase)
        else:
            band = np.array([low, low * rng.uniform(1.2, 3.0)]) / (FINE / 2.0)
            fast = sosfiltfilt(butter(2, band, "band", output="sos"), rng.normal(size=given.shape), axis=1)
            fast /= fast.std()
        return given + rng.uniform(0.05, 0.5) * drive * fast
    return given


def draw(kind: str, seed: int, hidden: bool) -> Machine:
    """The machine of a seed, with its recordings."""
    rng = np.random.default_rng([seed, tuple(_PLANTS).index(kind), int(hidden)])
    plant = _PLANTS[kind](rng)
    fault = "" if hidden else FAULTS[seed % len(FAULTS)]
    system = _law(plant, hidden, fault, rng)
    n, fine, step = len(plant.names) - 1, np.arange(0.0, DURATION, 1.0 / FINE), round(FINE / RATE)
    t = fine[::step]
    given = _given(plant, fine, rng)
    pushed = np.zeros((TRIALS, fine.size, system.n_dof))
    pushed[..., :n] = _acting(given, plant, fault, rng)
    start = rng.uniform(-1.0, 1.0, (TRIALS, n)) * np.array(plant.start)
    q0 = np.concatenate([start, start[:, -1:]], axis=1)[:, : system.n_dof]
    if hidden and kind in ("cart", "slosh"):
        q0[:, -1] = 0.0
    between = CubicSpline(fine, pushed.transpose(1, 0, 2))
    q, _ = rk4(system.acceleration, q0, rng.normal(0.0, 0.3, q0.shape), t, substeps=5, forces=between)
    seen = q[..., :n] if q.shape[0] == t.size else q.transpose(1, 0, 2)[..., :n]
    names = list(plant.names[:-1])
    largest = [1.0 if name in plant.angles else np.inf for name in names]  # a turn is no measure of noise
    size = np.minimum(seen.std(axis=(0, 1)), largest)
    seen = seen + rng.uniform(0.0005, 0.01) * size * rng.normal(size=seen.shape)
    data = la.Trajectories(
        [la.Trajectory(t, seen[:, k], forces=given[k, ::step], coordinates=names) for k in range(TRIALS)]
    )
    angles = [name for name in plant.angles if name in names]
    library = la.Library.mechanical(names, angles, size="compact" if kind != "joint" else "standard")
    offered = tuple(f"{name}_dot**2/2" for name in names) if fault != "friction" else ()
    return Machine(data, library, offered, hidden, fault, _frequency(plant) if hidden else np.nan)


def _frequency(plant: Plant) -> float:
    """Of the hidden coordinate at rest, the others held, in hertz."""
    inertia = 2.0 * plant.law["z_dot**2"]
    stiffness = {"cos(z)": 1.0, "z**2": -2.0, "(z-x)**2": -2.0, "(z-q2)**2": -2.0}
    return float(np.sqrt(sum(f * plant.law.get(text, 0.0) for text, f in stiffness.items()) / inertia)) / (
        2.0 * np.pi
    )


@dataclass(frozen=True)
class Result:
    """What was said of a machine; seconds of processor time."""

    noticed: bool
    holds: bool
    codes: tuple[str, ...]
    frequency: tuple[float, float]
    seconds: float
    of_check: float


def judge(machine: Machine, whole: bool) -> Result:
    """Search for a law, and check what is left of its equations."""
    begun = time.process_time()
    setup = build_problem(machine.data, Request(machine.library, {}, machine.friction))
    search = run_search(begin_search(setup))
    seconds, begun = time.process_time() - begun, time.process_time()
    holds = equations_hold(search.found)
    if whole:
        findings = [] if holds else list(verify(search, ()).findings)
    else:
        findings = [] if holds else hidden_freedom(search)
    said = [f for f in findings if f.code == "hidden-freedom"]
    values = (said[0].values["frequency"], said[0].values["error"]) if said else (np.nan, np.nan)
    codes = tuple(f.code for f in findings if f.severity == "warning")
    return Result(bool(said), holds, codes, values, seconds, time.process_time() - begun)


@click.command()
@click.option("--kind", "kinds", multiple=True, type=click.Choice([*RULE, *ASIDE]), default=[*RULE, *ASIDE])
@click.option("--first", default=3000, show_default=True, help="Seed of the first machine.")
@click.option("--count", default=17, show_default=True, help="Machines of each kind, with and without.")
@click.option("--whole", is_flag=True, help="Run all checks of a result, not this one alone.")
@single_threaded()
def main(kinds: tuple[str, ...], first: int, count: int, whole: bool) -> None:
    """Print a line for each machine, and how many hidden coordinates were noticed."""
    totals: Counter[tuple[str, bool, str]] = Counter()
    seconds = np.zeros(2)
    for kind in kinds:
        for seed in range(first, first + count):
            for hidden in (True, False):
                machine = draw(kind, seed, hidden)
                result = judge(machine, whole)
                group = "rule" if kind in RULE else "aside"
                totals[group, hidden, "all"] += 1
                totals[group, hidden, "noticed"] += result.noticed
                totals[group, hidden, "holds"] += result.holds
                seconds += (result.seconds, 0.0 if result.holds else result.of_check)
                what = "hidden" if hidden else machine.fault
                hertz, error = result.frequency
                click.echo(
                    f"{kind} {seed} {what}: {'noticed' if result.noticed else '-'}"
                    f"{', equations hold' if result.holds else ''} {' '.join(result.codes)} "
                    f"{hertz:.2f} ± {error:.2f} Hz (true {machine.frequency:.2f}), "
                    f"{result.seconds:.1f} + {result.of_check:.2f} s"
                )
    for group, hidden in sorted({key[:2] for key in totals}):
        all_of, noticed, hold = (totals[group, hidden, what] for what in ("all", "noticed", "holds"))
        click.echo(
            f"kinds {'of the rule' if group == 'rule' else 'kept aside'}, "
            f"{'with' if hidden else 'without'} a hidden coordinate: {noticed} of {all_of} noticed "
            f"({hold} with equations that hold)"
        )
    click.echo(f"searches {seconds[0]:.0f} s, checks {seconds[1]:.1f} s of processor time")


if __name__ == "__main__":
    main()
