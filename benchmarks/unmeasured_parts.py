"""Is a part without a sensor noticed, and how often is there said to be one where there is none?

    python -m benchmarks.unmeasured_parts --first 200 --count 10                # 10 machines of each kind
    python -m benchmarks.unmeasured_parts --kind crane --kind clock

Each machine is recorded four times for 6 s at 100 Hz, driven by five sines a coordinate unless it swings
freely, with noise of 0.2, 1 or 3 % of the spread.  Candidates are those of `Library.mechanical` with viscous
friction.  Machines of ``WITH`` have a part that is not in the table.  Those of ``WITHOUT`` have none, but are
not described by the candidates either: another force, friction, clock, late or missing drive.

Swings are about a quarter of a radian, large ones a whole one.  The rule was set on machines 400 to 403, 703
to 706, 810 to 820 and 830 to 833; none from 840 on was used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import click
import numpy as np
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction.findings import Finding
from leastaction.simulation.integrate import rk4
from leastaction.threads import single_threaded

TRIALS, DURATION, RATE, FINE = 4, 6.0, 100.0, 1000.0
NOISE = (0.002, 0.01, 0.03)
G = 9.81
Accelerate = Callable[..., np.ndarray]


@dataclass(frozen=True)
class Machine:
    """Measured coordinates, which come first, their drive, and q̈(q, q̇, f, t) of all.

    ``start`` are ranges of the angles and positions, ``pace`` is a usual rate in rad/s, and ``part`` the
    natural frequency of the part without a sensor.
    """

    names: tuple[str, ...]
    start: tuple[float, ...]
    drive: tuple[float, ...]
    pace: float
    accelerate: Accelerate
    part: float = np.nan


def _parts(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
    return (*np.moveaxis(q, -1, 0), *np.moveaxis(v, -1, 0))


def _solved(m11, m12, m22, r1, r2) -> np.ndarray:
    det = m11 * m22 - m12**2
    return np.stack([(m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det], axis=-1)


# --------------------------------------------------------------------------- with a part without a sensor
def _absorber(rng: np.random.Generator, driven: bool = True, count: int = 1) -> Machine:
    """A mass on a spring that carries masses on springs."""
    m, k = rng.uniform(0.8, 2.0), rng.uniform(10.0, 60.0)
    pace = np.sqrt(k / m)
    c = (rng.uniform(0.02, 0.2) if driven else 0.02) * pace * m
    m2 = m * rng.uniform(0.1, 0.5, count) / count
    w2, z2 = pace * rng.uniform(0.6, 2.5, count), rng.uniform(0.01, 0.12, count)

    def accelerate(q, v, f, t):
        pull = m2 * (w2**2 * (q[:, 1:] - q[:, :1]) + 2.0 * z2 * w2 * (v[:, 1:] - v[:, :1]))
        own = (f[:, 0] - k * q[:, 0] - c * v[:, 0] + pull.sum(axis=1)) / m
        return np.column_stack([own, -pull / m2])

    size = 0.4 if driven else 1.0
    return Machine(("x",), (size,) * (1 + count), (0.5 * k * driven,), pace, accelerate, float(w2[0]))


def _crane(rng: np.random.Generator, size: float) -> Machine:
    """A cart on a spring with a load that swings."""
    cart, m, length, k, c = (
        rng.uniform(low, high) for low, high in ((1, 3), (0.3, 1), (0.3, 0.9), (5, 40), (0.2, 1))
    )
    pace = np.sqrt(G / length)
    d = rng.uniform(0.01, 0.1) * m * length**2 * pace

    def accelerate(q, v, f, t):
        x, angle, speed, rate = _parts(q, v)
        pull = f[:, 0] + m * length * np.sin(angle) * rate**2 - k * x - c * speed
        turn = -m * G * length * np.sin(angle) - d * rate
        return _solved(cart + m, m * length * np.cos(angle), m * length**2, pull, turn)

    return Machine(("x",), (0.7 * size, size), (0.4 * size * k,), pace, accelerate, pace)


def _pendulums(rng: np.random.Generator, size: float) -> Machine:
    """A pendulum that carries another one."""
    m1, m2, l1, l2 = *rng.uniform(0.4, 1.2, 2), *rng.uniform(0.25, 0.5, 2)
    a, b, c = (m1 + m2) * l1**2, m2 * l2**2, m2 * l1 * l2
    g1, g2, d1, d2 = (m1 + m2) * G * l1, m2 * G * l2, 0.3 * a, rng.uniform(0.03, 0.3) * b

    def accelerate(q, v, f, t):
        q1, q2, v1, v2 = _parts(q, v)
        sin = np.sin(q1 - q2)
        r1 = f[:, 0] - c * sin * v2**2 - g1 * np.sin(q1) - d1 * v1
        return _solved(a, c * np.cos(q1 - q2), b, r1, c * sin * v1**2 - g2 * np.sin(q2) - d2 * v2)

    return Machine(("theta",), (size, size), (0.4 * size * g1,), np.sqrt(G / l1), accelerate, np.sqrt(G / l2))


def _elastic(rng: np.random.Generator) -> Machine:
    """A motor that turns a link through an elastic gear."""
    motor, link, w2 = rng.uniform(0.05, 0.2), rng.uniform(0.05, 0.3), rng.uniform(8.0, 30.0)
    z2, c, weight = rng.uniform(0.01, 0.1), rng.uniform(0.1, 0.6), rng.uniform(0.0, 2.0)

    def accelerate(q, v, f, t):
        q1, q2, v1, v2 = _parts(q, v)
        pull = link * (w2**2 * (q2 - q1) + 2.0 * z2 * w2 * (v2 - v1))
        return np.stack([(f[:, 0] - c * v1 + pull) / motor, (-pull - weight * np.sin(q2)) / link], axis=-1)

    return Machine(("theta",), (0.5, 0.0), (1.5,), 0.6 * w2, accelerate, w2)


def _chain(rng: np.random.Generator, first: bool = False) -> Machine:
    """Three masses in a row; the last one, or one on the first of two, has no sensor."""
    m, k, c = rng.uniform(0.5, 1.5, 3), rng.uniform(20.0, 60.0, 3), rng.uniform(0.05, 0.4, 3)

    def accelerate(q, v, f, t):
        at = [0, 1, 0 if first else 1]
        stretch = np.stack([q[:, 0], q[:, 1] - q[:, 0], q[:, 2] - q[:, at[2]]], axis=-1)
        rate = np.stack([v[:, 0], v[:, 1] - v[:, 0], v[:, 2] - v[:, at[2]]], axis=-1)
        pull, force = k * stretch + c * rate, np.zeros_like(q)
        force[:, :2] = f[:, :2]
        force -= pull
        force[:, 0] += pull[:, 1]
        force[:, at[2]] += pull[:, 2]
        return force / m

    return Machine(("x", "y"), (0.3,) * 3, (8.0, 8.0), 6.0, accelerate, float(np.sqrt(k[2] / m[2])))


def _box(rng: np.random.Generator, size: float) -> Machine:
    """A pendulum with a mass that slides across its rod on a spring."""
    inertia, weight, m = rng.uniform(0.3, 1.0), rng.uniform(3.0, 9.0), rng.uniform(0.1, 0.4)
    length, w2, z2 = rng.uniform(0.4, 0.9), rng.uniform(3.0, 14.0), rng.uniform(0.01, 0.15)

    def accelerate(q, v, f, t):
        angle, s, rate, speed = _parts(q, v)
        swing = weight * np.sin(angle) + m * G * (length * np.sin(angle) + s * np.cos(angle))
        r1 = f[:, 0] - 2.0 * m * s * speed * rate - swing - 0.1 * rate
        r2 = m * (s * rate**2 - G * np.sin(angle) - w2**2 * s - 2.0 * z2 * w2 * speed)
        return _solved(inertia + m * (length**2 + s**2), m * length, m, r1, r2)

    return Machine(("theta",), (size, 0.0), (0.5 * size * weight,), np.sqrt(weight / inertia), accelerate, w2)


WITH: dict[str, Callable[[np.random.Generator], Machine]] = {
    "absorber": _absorber,
    "free": lambda rng: _absorber(rng, driven=False),
    "crane": lambda rng: _crane(rng, 0.07),
    "pendulums": lambda rng: _pendulums(rng, 0.07),
    "elastic": _elastic,
    "chain": _chain,
    "box": lambda rng: _box(rng, 0.15),
    "two parts": lambda rng: _absorber(rng, count=2),
    "beside": lambda rng: _chain(rng, first=True),
    "crane, large swings": lambda rng: _crane(rng, 0.3),
    "box, large swings": lambda rng: _box(rng, 0.6),
    "pendulums, large swings": lambda rng: _pendulums(rng, 0.3),
}


# ------------------------------------------------------------------------ without, but not as the user thinks
def _plain(rng: np.random.Generator, more: Callable[..., np.ndarray], turning: bool) -> Machine:
    """A mass on a spring or a pendulum, and what the user does not know, in units of its largest force."""
    m, k = rng.uniform(0.5, 2.0), rng.uniform(10.0, 60.0)
    pace, u, size = np.sqrt(k / m), rng.uniform(size=6), 1.6 if turning else 1.0

    def accelerate(q, v, f, t):
        pull = np.sin(q[:, 0]) if turning else q[:, 0]
        unknown = more(q[:, 0] / size, v[:, 0] / (size * pace), pace * t, u)
        return ((f[:, 0] - k * pull - 0.05 * np.sqrt(k * m) * v[:, 0] + k * unknown) / m)[:, None]

    return Machine(("theta",) if turning else ("x",), (0.5 * size,), (0.45 * k,), pace, accelerate)


def _away(x: np.ndarray, edge: float) -> np.ndarray:
    return np.sign(x) * np.maximum(np.abs(x) - edge, 0.0)


UNKNOWN: dict[str, Callable[..., np.ndarray]] = {
    "fifth power": lambda x, v, t, u: -(20.0 + 50.0 * u[0]) * x**5,
    "stop": lambda x, v, t, u: -4.0 * _away(x, 0.2 + 0.2 * u[0]),
    "play": lambda x, v, t, u: -0.2 * np.sign(x) * (np.abs(x) > 0.1 + 0.2 * u[0]),
    "exponential": lambda x, v, t, u: -0.1 * (np.exp(2.5 * x) - 1.0),
    "dry": lambda x, v, t, u: -0.06 * np.tanh(v / 0.01) * (1.0 + 1.5 * np.exp(-((v / 0.1) ** 2))),
    "drag": lambda x, v, t, u: -(0.3 + 0.5 * u[0]) * v * np.abs(v),
    "ripple": lambda x, v, t, u: 0.1 * np.sin((15.0 + 30.0 * u[0]) * x),
    "clock": lambda x, v, t, u: 0.15 * np.cos((0.5 + 2.0 * u[0]) * t + 6.0 * u[1]),
    "pumped": lambda x, v, t, u: -0.3 * x * np.cos((0.5 + 2.0 * u[0]) * t),
    "magnet": lambda x, v, t, u: 0.05 / (1.6 + x) ** 2,
    "one-sided": lambda x, v, t, u: -(0.3 + u[0]) * np.maximum(x, 0.0),
}
WITHOUT = (*UNKNOWN, "vibration", "late", "unknown drive", "saturated")


def draw(kind: str, seed: int) -> tuple[la.Trajectories, Machine]:
    """Recordings of a machine."""
    rng = np.random.default_rng([seed, *kind.encode()])
    if kind in WITH:
        machine = WITH[kind](rng)
    else:
        turning = bool(seed % 2)
        machine = _plain(rng, UNKNOWN.get(kind, lambda x, v, t, u: 0.0 * x), turning)
    free = kind == "free" or (kind in UNKNOWN and seed % 4 > 1)
    names, t = machine.names, np.arange(0.0, DURATION, 1.0 / FINE)
    told = _drive(rng, machine, t)
    acting = told
    if kind == "vibration":
        low = machine.pace / (2.0 * np.pi) * rng.uniform(0.8, 2.5)
        band = np.array([low, low * rng.uniform(1.2, 1.8)]) / (FINE / 2.0)
        noise = sosfiltfilt(butter(2, band, "band", output="sos"), rng.normal(size=told.shape), axis=1)
        acting = told + rng.uniform(0.2, 0.6) * told.std() * noise / noise.std()
    elif kind == "late":
        acting = np.roll(told, int(rng.uniform(20, 120)), axis=1)
    elif kind == "unknown drive":
        acting = told + 0.4 * _drive(rng, machine, t)
    elif kind == "saturated":
        acting = np.clip(told, -told.std(), told.std())
    acting, told = (0.0 * acting, None) if free else (acting, told)
    table, size = acting.transpose(1, 0, 2), np.array(machine.start) * (2.0 if free else 1.0)

    def forces(when: np.ndarray) -> np.ndarray:
        return table[np.minimum((when * FINE + 1e-6).astype(int), t.size - 1)]

    shape = TRIALS, len(machine.start)
    start = rng.uniform(-1.0, 1.0, shape) * size, rng.normal(0.0, 0.3, shape) * size * machine.pace
    step = round(FINE / RATE)
    motion, _ = rk4(machine.accelerate, *start, t, substeps=1, forces=forces, clock=np.zeros(TRIALS))
    seen = motion[::step, :, : len(names)]
    seen = seen + rng.choice(NOISE) * seen.std(axis=(0, 1)) * rng.normal(size=seen.shape)
    given = [None] * TRIALS if told is None else told[:, ::step]
    trials = [
        la.Trajectory(t[::step], seen[:, k], forces=given[k], coordinates=list(names)) for k in range(TRIALS)
    ]
    return la.Trajectories(trials), machine


def asked(data: la.Trajectories) -> tuple[la.Library, dict[str, float], tuple[str, ...]]:
    """What the user offers and knows: candidates, known coefficients, friction."""
    names = data.coordinates
    known = {} if data.driven else {f"{names[0]}_dot**2": 0.5}
    library = la.Library.mechanical(names, [name for name in names if name == "theta"])
    return library, known, tuple(f"{name}_dot**2/2" for name in names)


def _drive(rng: np.random.Generator, machine: Machine, t: np.ndarray) -> np.ndarray:
    """(n_trials, n_times, n_dof) five sines a coordinate."""
    shape = TRIALS, 1, len(machine.names)
    out = np.zeros((TRIALS, t.size, shape[2]))
    for _ in range(5):
        phase = rng.uniform(0.3, 2.5, shape) * machine.pace * t[:, None] + rng.uniform(0.0, 6.3, shape)
        out += 0.6 * rng.normal(size=shape) * np.sin(phase)
    return out * np.array(machine.drive)


def discovered(kind: str, seed: int) -> tuple[Machine, la.Model, Finding | None]:
    """A machine, the law of its recordings, and what is said of a part without a sensor."""
    data, machine = draw(kind, seed)
    library, known, friction = asked(data)
    model = la.discover(data, library, known=known, dissipation=friction)
    return machine, model, next((f for f in model.fit.findings if f.code == "unmeasured-part"), None)


@click.command()
@click.option("--kind", "kinds", multiple=True, default=(*WITH, *WITHOUT), help="May be given several times.")
@click.option("--first", default=200, show_default=True, help="Seed of the first machine of a kind.")
@click.option("--count", default=10, show_default=True, help="Machines of each kind.")
@single_threaded()
def main(kinds: tuple[str, ...], first: int, count: int) -> None:
    """Print a line for each machine and each kind."""
    for kind in kinds:
        noticed = in_doubt = 0
        for seed in range(first, first + count):
            machine, model, found = discovered(kind, seed)
            noticed += found is not None
            in_doubt += model.fit.status != "ok"
            codes = [f.code for f in model.fit.findings if f.severity == "warning"]
            rate = None if found is None else found.values.get("frequency")
            said = "" if rate is None else f"{rate:.3g} Hz, "
            truth = machine.part / (2.0 * np.pi)
            click.echo(f"  {kind} {seed}: {model.fit.status} {said}true {truth:.3g} Hz {codes}")
        click.echo(f"{kind}: noticed {noticed} of {count}; not ok {in_doubt}")


if __name__ == "__main__":
    main()
