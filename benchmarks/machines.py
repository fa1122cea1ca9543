"""Friction on simulated machines: how often it is found, and how often found where there is none.

A machine is a pendulum, a double pendulum with a relative angle, a cart with a pendulum, a mass on a spring
that stiffens, a rotary pendulum or a pendulum of variable length, all driven, of random size and friction
(none, viscous, dry or both in each joint), with what real machines add: vibration that nobody measures,
ripple of a gear, encoders with steps, torques that are held between the ticks of a controller, noisy, late.
Viscous and dry friction of each joint are offered, for pairs of angles also
those of the relative (or absolute) rate.

    python -m benchmarks.machines --first 0 --count 20 --kind pendulum

Seeds below 1100 were looked at while the rules were made; judge by others.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import click
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction.estimation.build import Request, build_problem
from leastaction.selection.search import run_search
from leastaction.selection.search_state import begin_search
from leastaction.simulation.integrate import rk4
from leastaction.threads import single_threaded

KINDS = ("pendulum", "arm", "cart", "resonator", "rotary", "crane")
TRIALS, DURATION, RATE, FINE = 4, 6.0, 200.0, 2000.0
_G, _SMOOTH = 9.81, 0.01


@dataclass(frozen=True)
class Plant:
    """Names, size of the torques, ranges of the start, and M(q) q̈ = r(q, q̇) + f without friction."""

    names: tuple[str, ...]
    law: dict[str, float]
    drive: tuple[float, ...]
    start: tuple[float, ...]
    accelerate: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    angles: tuple[str, ...]
    size: str = "compact"
    rest: tuple[float, ...] = (0.0,)


@dataclass(frozen=True)
class Extent:
    """How much is recorded."""

    trials: int = TRIALS
    duration: float = DURATION
    rate: float = RATE


@dataclass(frozen=True)
class Machine:
    """Recordings of a machine, what is asked, and what is true."""

    data: la.Trajectories
    library: la.Library
    law: dict[str, float]
    friction: dict[str, float]
    offered: tuple[str, ...]
    faults: dict[str, float] = field(default_factory=dict)


def _pendulum(rng: np.random.Generator) -> Plant:
    inertia, weight = rng.uniform(0.3, 1.5), rng.uniform(3.0, 12.0)

    def accelerate(q: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
        return (f - weight * np.sin(q)) / inertia

    law = {"q1_dot**2": inertia / 2.0, "cos(q1)": weight}
    return Plant(("q1",), law, (0.6 * weight,), (1.0,), accelerate, ("q1",))


def _arm(rng: np.random.Generator) -> Plant:
    m1, m2, l1, l2 = *rng.uniform(0.4, 1.2, 2), *rng.uniform(0.25, 0.5, 2)
    a, b, c = (m1 + m2) * l1**2, m2 * l2**2, m2 * l1 * l2
    g1, g2 = (m1 + m2) * _G * l1, m2 * _G * l2

    def accelerate(q: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
        (q1, q2), (v1, v2) = np.moveaxis(q, -1, 0), np.moveaxis(v, -1, 0)
        cos, sin = np.cos(q2), np.sin(q2)
        m11, m12, m22 = a + b + 2.0 * c * cos, b + c * cos, b
        r1 = f[..., 0] + c * sin * (2.0 * v1 * v2 + v2**2) - g1 * np.sin(q1) - g2 * np.sin(q1 + q2)
        r2 = f[..., 1] - c * sin * v1**2 - g2 * np.sin(q1 + q2)
        det = m11 * m22 - m12**2
        return np.stack([(m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det], axis=-1)

    law = {
        "q1_dot**2": (a + b) / 2.0,
        "q1_dot**2*cos(q2)": c,
        "q1_dot*q2_dot": b,
        "q1_dot*q2_dot*cos(q2)": c,
        "q2_dot**2": b / 2.0,
        "cos(q1)": g1,
        "cos(q1+q2)": g2,
    }
    return Plant(("q1", "q2"), law, (0.5 * g1, 0.5 * g2), (1.0, 1.0), accelerate, ("q1", "q2"))


def _cart(rng: np.random.Generator) -> Plant:
    cart, m, length, k = (
        rng.uniform(1.0, 3.0),
        rng.uniform(0.3, 1.0),
        rng.uniform(0.3, 0.7),
        rng.uniform(8, 30),
    )

    def accelerate(q: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
        (x, q2), v2 = np.moveaxis(q, -1, 0), v[..., 1]
        cos, sin = np.cos(q2), np.sin(q2)
        r1 = f[..., 0] + m * length * sin * v2**2 - k * x
        r2 = f[..., 1] - m * _G * length * sin
        m11, m12, m22 = cart + m, m * length * cos, m * length**2
        det = m11 * m22 - m12**2
        return np.stack([(m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det], axis=-1)

    law = {
        "q1_dot**2": (cart + m) / 2.0,
        "q1_dot*q2_dot*cos(q2)": m * length,
        "q2_dot**2": m * length**2 / 2.0,
        "cos(q2)": m * _G * length,
        "q1**2": -k / 2.0,
    }
    return Plant(("q1", "q2"), law, (0.5 * k, 0.3 * m * _G * length), (0.5, 1.0), accelerate, ("q2",))


def _resonator(rng: np.random.Generator) -> Plant:
    mass, k, cubic = rng.uniform(0.5, 2.0), rng.uniform(10.0, 60.0), rng.uniform(10.0, 100.0)

    def accelerate(q: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
        return (f - k * q - cubic * q**3) / mass

    law = {"q1_dot**2": mass / 2.0, "q1**2": -k / 2.0, "q1**4": -cubic / 4.0}
    return Plant(("q1",), law, (0.5 * k,), (0.5,), accelerate, (), "standard")


def _rotary(rng: np.random.Generator) -> Plant:
    inertia, m, arm, length = rng.uniform(0.02, 0.1), *rng.uniform(0.2, 0.5, 3)
    a, b, c, weight = inertia + m * arm**2, m * length**2, m * arm * length, m * _G * length

    def accelerate(q: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
        q2, (v1, v2) = q[..., 1], np.moveaxis(v, -1, 0)
        cos, sin = np.cos(q2), np.sin(q2)
        r1 = f[..., 0] - 2.0 * b * sin * cos * v1 * v2 + c * sin * v2**2
        r2 = f[..., 1] + b * sin * cos * v1**2 - weight * sin
        m11, m12, m22 = a + b * sin**2, c * cos, b
        det = m11 * m22 - m12**2
        return np.stack([(m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det], axis=-1)

    law = {
        "q1_dot**2": a / 2.0,
        "q1_dot**2*sin(q2)**2": b / 2.0,
        "q1_dot*q2_dot*cos(q2)": c,
        "q2_dot**2": b / 2.0,
        "cos(q2)": weight,
    }
    return Plant(("q1", "q2"), law, (0.5 * weight, 0.3 * weight), (1.0, 1.0), accelerate, ("q1", "q2"))


def _crane(rng: np.random.Generator) -> Plant:
    m, k, length = rng.uniform(0.5, 2.0), rng.uniform(40.0, 120.0), rng.uniform(0.8, 1.5)

    def accelerate(q: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
        (r, q2), (v1, v2) = np.moveaxis(q, -1, 0), np.moveaxis(v, -1, 0)
        a1 = (f[..., 0] + m * _G * np.cos(q2) - k * (r - length)) / m + r * v2**2
        a2 = (f[..., 1] - m * r * (2.0 * v1 * v2 + _G * np.sin(q2))) / (m * r**2)
        return np.stack([a1, a2], axis=-1)

    law = {
        "q1_dot**2": m / 2.0,
        "q2_dot**2*q1**2": m / 2.0,
        "q1*cos(q2)": m * _G,
        "q1**2": -k / 2.0,
        "q1": k * length,
    }
    drive = (0.1 * k, 0.3 * m * _G * length)
    rest = (length + m * _G / k, 0.0)
    return Plant(("q1", "q2"), law, drive, (0.1, 1.0), accelerate, ("q2",), rest=rest)


_PLANTS = dict(zip(KINDS, (_pendulum, _arm, _cart, _resonator, _rotary, _crane), strict=True))


def _friction(rng: np.random.Generator, plant: Plant, rates: np.ndarray) -> dict[str, float]:
    """Of each joint none, viscous, dry or both, each of 10 to 40 % of the torques' size at usual rates."""
    out: dict[str, float] = {}
    for name, size, rate in zip(plant.names, plant.drive, rates, strict=True):
        kind = rng.integers(0, 4)
        if kind & 1:
            out[f"{name}_dot**2/2"] = float(rng.uniform(0.1, 0.4) * size / rate)
        if kind & 2:
            out[f"abs({name}_dot)"] = float(rng.uniform(0.1, 0.4) * size)
    return out


def _faults(rng: np.random.Generator) -> dict[str, float]:
    """What a machine adds, in shares of the torques, radians, and samples."""
    return {
        "vibration": float(rng.uniform(0.1, 1.0)),
        "from_hz": float(rng.uniform(8.0, 25.0)),
        "ripple": float(rng.uniform(0.0, 0.05)),
        "teeth": float(rng.integers(20, 80)),
        "encoder": float(2.0 * np.pi / rng.choice([2000, 4096, 8192, 16384])),
        "held": float(rng.choice([1, 1, 2, 4])),
        "noise": float(rng.uniform(0.0, 0.05)),
        "late": float(rng.choice([0.0, 0.0, 0.5, 1.0, 2.0])),
    }


def draw(kind: str, seed: int, extent: Extent | None = None, less: float = 1.0) -> Machine:
    """The machine of a seed, with its recordings; faults, and how torques are held, may be less."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    plant, extent = _PLANTS[kind](rng), extent or Extent()
    faults = _faults(rng)
    faults |= {name: less * faults[name] for name in ("vibration", "ripple", "encoder", "noise", "late")}
    n, drive, trials = len(plant.names), np.array(plant.drive), extent.trials
    fine, step = np.arange(0.0, extent.duration, 1.0 / FINE), round(FINE / extent.rate)
    t = fine[::step]
    given = np.zeros((trials, t.size, n))  # what the controller asks for
    for w in rng.uniform(0.5, 6.0, (4, trials, 1, n)):
        given += rng.normal(size=(trials, 1, n)) * np.sin(
            w * t[:, None] + rng.uniform(0, 6.3, (trials, 1, n))
        )
    given *= 0.5 * drive
    tick = np.arange(t.size) // int(faults["held"]) * int(faults["held"])
    told = given + min(less, 1.0) * (given[:, tick] - given)
    smooth = CubicSpline(t, given, axis=1)(fine)
    acting = smooth + min(less, 1.0) * (np.repeat(told, step, axis=1)[:, : fine.size] - smooth)
    lag = round(faults["late"] * step)
    acting = np.concatenate([np.repeat(acting[:, :1], lag, axis=1), acting[:, : fine.size - lag]], axis=1)
    band = np.array([faults["from_hz"], 2.0 * faults["from_hz"]]) / (FINE / 2.0)
    fast = sosfiltfilt(butter(2, band, "band", output="sos"), rng.normal(size=acting.shape), axis=1)
    acting = acting + faults["vibration"] * drive * fast / fast.std()
    table = acting.transpose(1, 0, 2)
    start = rng.uniform(-1.0, 1.0, (trials, n)) * np.array(plant.start), rng.normal(0.0, 0.3, (trials, n))
    start[0][...] += plant.rest

    def motion(friction: dict[str, float], times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        viscous = np.array([friction.get(f"{name}_dot**2/2", 0.0) for name in plant.names])
        dry = np.array([friction.get(f"abs({name}_dot)", 0.0) for name in plant.names])

        def accelerate(q: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
            ripple = faults["ripple"] * drive * np.sin(faults["teeth"] * q)
            return plant.accelerate(q, v, f + ripple - viscous * v - dry * np.tanh(v / _SMOOTH))

        def forces(when: np.ndarray) -> np.ndarray:
            return table[np.minimum((when * FINE + 1e-6).astype(int), fine.size - 1)]

        return rk4(accelerate, *start, times, substeps=1, forces=forces)

    free = motion(
        {f"abs({name}_dot)": 0.1 * size for name, size in zip(plant.names, drive, strict=True)}, fine
    )
    friction = _friction(rng, plant, np.sqrt(np.mean(free[1] ** 2, axis=(0, 1))))
    recorded, _ = motion(friction, fine)
    seen = np.round(recorded[::step] / faults["encoder"]) * faults["encoder"]
    told = told + faults["noise"] * drive * rng.normal(size=given.shape)
    data = la.Trajectories(
        [la.Trajectory(t, seen[:, k], forces=told[k], coordinates=list(plant.names)) for k in range(trials)]
    )
    library = la.Library.mechanical(plant.names, plant.angles, size=plant.size)
    return Machine(data, library, plant.law, friction, offered(plant), faults)


def offered(plant: Plant) -> tuple[str, ...]:
    """Candidates for friction."""
    rates = [f"{name}_dot" for name in plant.names]
    if len(plant.angles) > 1:
        rates.append("(q1_dot+q2_dot)")
    return tuple(text for v in rates for text in (f"{v}**2/2", f"abs({v})"))


@dataclass(frozen=True)
class Result:
    """What was found of a machine."""

    missed: tuple[str, ...]
    spurious: tuple[str, ...]
    law: bool
    seconds: float
    worst: float


def judge(machine: Machine) -> Result:
    """Search, and compare."""
    begun = time.process_time()
    fit = run_search(
        begin_search(build_problem(machine.data, Request(machine.library, {}, machine.offered)))
    ).found
    seconds = time.process_time() - begun
    texts = {k: _plain(fit.problem.terms[k].text) for k in fit.structure}
    found = {t for k, t in texts.items() if fit.problem.terms[k].kind == "dissipation"}
    law = {_key(t) for k, t in texts.items() if fit.problem.terms[k].kind != "dissipation"}
    true = {_plain(text): value for text, value in machine.friction.items()}
    values = {t: float(fit.coefficients[k]) for k, t in texts.items()}
    off = [abs(values[t] / v - 1.0) for t, v in true.items() if t in values]
    return Result(
        tuple(sorted({*true} - found)),
        tuple(sorted(found - {*true})),
        law == {_key(text) for text in machine.law},
        seconds,
        max(off, default=0.0),
    )


def _plain(text: str) -> str:
    """Friction as it was offered: dry friction is smoothed in a search."""
    text = text.replace(" ", "")
    if not text.startswith("sqrt("):
        return text
    rate = text.removeprefix("sqrt(").split("**2")[0]
    return f"abs({rate.strip('()')})" if rate.startswith("(") else f"abs({rate})"


def _key(text: str) -> str:
    return text.replace(" ", "")


@click.command()
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS), default=KINDS)
@click.option("--first", default=2000, show_default=True, help="Seed of the first machine.")
@click.option("--count", default=20, show_default=True, help="Machines of each kind.")
@single_threaded()
def main(kinds: tuple[str, ...], first: int, count: int) -> None:
    """Print a line for each machine, and how much of the friction was found."""
    totals: Counter[str] = Counter()
    for kind in kinds:
        for seed in range(first, first + count):
            machine = draw(kind, seed)
            result = judge(machine)
            there = len(machine.friction)
            totals.update(
                machines=1,
                there=there,
                found=there - len(result.missed),
                absent=len(machine.offered) - there,
                spurious=len(result.spurious),
                law=result.law,
                all_right=not (result.missed or result.spurious),
            )
            faults = ", ".join(f"{name} {value:.3g}" for name, value in machine.faults.items())
            click.echo(
                f"{kind} {seed}: missed {list(result.missed)}, spurious {list(result.spurious)}, "
                f"L {'exact' if result.law else 'other'}, off {100 * result.worst:.0f} %, "
                f"{result.seconds:.1f} s ({faults})"
            )
    click.echo(
        f"{totals['machines']} machines: {totals['found']} of {totals['there']} frictions found, "
        f"{totals['spurious']} spurious of {totals['absent']} absent; "
        f"friction right in {totals['all_right']}, "
        f"L exact in {totals['law']}"
    )


if __name__ == "__main__":
    main()
