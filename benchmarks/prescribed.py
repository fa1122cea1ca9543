"""Coordinates that unknown forces move: how often the structure is exact, how well intervals hold.

Three machines, of each many data sets (three recordings of 8 s at 100 Hz, the prescribed motion a sum of four
sines): a crane whose drive is not measured, a pendulum on a shaken support, an arm with one torque sensor of
two.  Candidates are those of `Library.mechanical`, friction in the moved joint.

    python -m benchmarks.prescribed --sets 20
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import leastaction as la
from leastaction.model.model import ModelTerm


@dataclass(frozen=True)
class Machine:
    """A law, which of its coordinates is prescribed, and how far and fast (rad/s) that moves."""

    names: tuple[str, str]
    lagrangian: dict[str, float]
    friction: dict[str, float]
    known: tuple[str, ...]
    angles: tuple[str, ...]
    reach: float
    fastest: float
    push: float = 0.0  # known force on the other coordinate

    def law(self) -> la.LagrangianModel:
        terms = [ModelTerm(k, v) for k, v in self.lagrangian.items()]
        psi = [ModelTerm(k, v) for k, v in self.friction.items()]
        return la.LagrangianModel(
            self.names, terms, psi, provenance={"options": {"prescribed": [self.names[0]]}}
        )

    def data(self, number: int, noise: float) -> list[la.Trajectory]:
        """Three recordings; the noise is the same in all, a share of the coordinates' spread."""
        runs = [self._run(3 * number + k) for k in range(3)]
        rng, spread = np.random.default_rng(number), np.concatenate([q for _, q, _ in runs]).std(axis=0)
        return [
            la.Trajectory(t, q + noise * spread * rng.normal(size=q.shape), f, self.names) for t, q, f in runs
        ]

    def _run(self, seed: int):
        rng, t = np.random.default_rng(seed), np.arange(0.0, 8.0, 0.01)
        size = self.reach * rng.normal(size=4) / 2.0
        rate, phase = rng.uniform(0.2, 1.0, 4) * self.fastest, rng.uniform(0.0, 6.0, 4)

        def motion(when: float, nu: int) -> float:
            return float((size * rate**nu * np.sin(rate * when + phase + nu * np.pi / 2)).sum())

        def force(when: float) -> float:
            return self.push * float(np.sin(5.0 * when + seed))

        run = self.law().simulate(
            [motion(0.0, 0), 0.7], [motion(0.0, 1), 0.0], t, lambda x: np.array([motion(x, 2), force(x)])
        )
        return t, run.q, np.array([[0.0, force(x)] for x in t]) if self.push else None


PENDULUM = {"theta_dot**2": 0.5, "cos(theta)": 9.81}
MACHINES = {
    "crane": Machine(
        ("x", "theta"),
        {**PENDULUM, "x_dot*theta_dot*cos(theta)": 1.0},
        {"theta_dot**2": 0.05},
        ("theta_dot**2",),
        ("theta",),
        reach=0.5,
        fastest=7.0,
    ),
    "shaken pendulum": Machine(
        ("y", "theta"),
        {**PENDULUM, "y_dot*theta_dot*sin(theta)": 1.0},
        {"theta_dot**2": 0.05},
        ("theta_dot**2",),
        ("theta",),
        reach=0.05,
        fastest=25.0,
    ),
    "arm, one torque": Machine(
        ("a", "b"),
        {"b_dot**2": 0.5, "a_dot*b_dot*cos(a-b)": 1.0, "cos(b)": 9.81},
        {"b_dot**2": 0.05},
        (),
        ("a", "b"),
        reach=0.4,
        fastest=5.0,
        push=1.5,
    ),
}


def fits(machine: Machine, noise: float, sets: int) -> Iterator[tuple[bool, bool, list[float], float]]:
    """For each data set: exact, ok, errors in standard errors, seconds of the processor."""
    library = la.Library.mechanical(machine.names, machine.angles)
    truth = {("lagrangian", k): v for k, v in machine.lagrangian.items() if k not in machine.known}
    truth |= {("dissipation", k): v for k, v in machine.friction.items()}
    for number in range(sets):
        data = machine.data(number, noise)
        start = time.process_time()
        model = la.discover(
            data,
            library,
            {k: machine.lagrangian[k] for k in machine.known},
            list(machine.friction),
            prescribed=[machine.names[0]],
        )
        spent = time.process_time() - start
        found = {("lagrangian", t.expression): t for t in model.terms if not t.known}
        found |= {("dissipation", t.expression): t for t in model.dissipation}
        exact = set(found) == set(truth)
        z = [(found[k].coefficient - v) / found[k].standard_error for k, v in truth.items()] if exact else []
        yield exact, model.fit.status == "ok", z, spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.01, 0.05])
    given = parser.parse_args()
    print("machine           noise  exact  ok and wrong  doubtful  inside 95 %  mean z  rms z  seconds")
    for name, machine in MACHINES.items():
        for noise in given.noise:
            rows = list(fits(machine, noise, given.sets))
            z = np.concatenate([row[2] for row in rows])
            wrong = sum(ok and not exact for exact, ok, *_ in rows)
            print(
                f"{name:<16} {100 * noise:4.0f} % {sum(row[0] for row in rows):6d} {wrong:13d} "
                f"{sum(not row[1] for row in rows):9d} {100 * np.mean(np.abs(z) < 1.96):9.0f} % "
                f"{z.mean():7.2f} {np.sqrt(np.mean(z**2)):6.2f} {np.median([row[3] for row in rows]):8.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
