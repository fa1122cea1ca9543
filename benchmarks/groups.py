"""Groups of trials: how often what differs is named exactly, and how well the intervals hold.

Systems of which a mass, a spring or a magnet differs between groups of three recordings (10 s at 100 Hz, one
sensor), of each many data sets, and the same systems with nothing changed.  Noise is a share of the spread of
each coordinate; candidates are those of the systems.

    python -m benchmarks.groups --sets 20
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import leastaction as la
from leastaction import systems
from leastaction.systems import MechanicalSystem, measure, noise_std, simulate_truth

TRIALS, DURATION = 3, 10.0


@dataclass(frozen=True)
class Case:
    """A system, and of every further group the coefficients that are not those of the first."""

    system: str
    changed: Sequence[dict[str, float]]

    def group(self, number: int) -> MechanicalSystem:
        """The system of one group."""
        system = systems.get(self.system)
        changed = ({}, *self.changed)[number]
        return replace(system, lagrangian={**system.lagrangian, **changed})

    @property
    def truth(self) -> dict[tuple[str, str], float]:
        """Term and group → difference from the first."""
        before = systems.get(self.system).lagrangian
        terms = {term for changed in self.changed for term in changed}
        return {
            (term, f"group {n}"): changed.get(term, before[term]) - before[term]
            for n, changed in enumerate(self.changed, start=1)
            for term in terms
        }

    def data(self, number: int, noise: float) -> tuple[la.Trajectories, list[str]]:
        """Recordings of all groups with one noise, and the group of each."""
        count = 1 + len(self.changed)
        seeds = [
            count * number + n + round(1e6 * noise) for n in range(count)
        ]  # of each level its own motions
        motions = [simulate_truth(self.group(n), TRIALS, DURATION, seed=seed) for n, seed in enumerate(seeds)]
        sigma = noise_std(self.system, [motion for part in motions for motion in part], noise)
        runs = [
            run.changed(name=f"{n}-{k}")
            for n, part in enumerate(motions)
            for k, run in enumerate(measure(self.group(n), part, sigma, seed=seeds[n]))
        ]
        return la.Trajectories(runs), [f"group {n}" for n in range(count) for _ in range(TRIALS)]


CASES = {
    "pendulum, payload 1 kg": Case("single_pendulum", [{"theta_dot**2": 1.0, "cos(theta)": 19.62}]),
    "pendulum, payload 0.1 kg": Case("single_pendulum", [{"theta_dot**2": 0.55, "cos(theta)": 10.791}]),
    "pendulum, the same": Case("single_pendulum", [{}]),
    "double, load on link 1": Case("double_pendulum", [{"theta1_dot**2": 1.25, "cos(theta1)": 24.525}]),
    "double, the same": Case("double_pendulum", [{}]),
    "spherical, payload": Case(
        "spherical_pendulum", [{"theta_dot**2": 0.75, "phi_dot**2*sin(theta)**2": 0.75, "cos(theta)": 14.715}]
    ),
    "chaotic, inertia": Case("chaotic_pendulum", [{"theta1_dot**2": 0.25}]),
    "cart, three springs": Case("cart_spring_pendulum", [{"x**2": -7.0, "x": 7.0}, {"x**2": -4.0, "x": 4.0}]),
    "cart, the same three times": Case("cart_spring_pendulum", [{}, {}]),
    "spherical, other spring": Case("spherical_spring_pendulum", [{"x**2": -25.0, "x": 50.0}]),
    "magnets, one stronger": Case("magnetic_pendulum", [{"1/sqrt((x-1)**2+y**2+0.09)": 1.3}]),
}


@dataclass(frozen=True)
class Result:
    """Of one data set: whether all is right, errors of the differences in standard errors, seconds."""

    named: bool
    structure: bool
    ok: bool
    z: list[float]
    seconds: float


def fits(case: Case, noise: float, sets: int) -> Iterator[Result]:
    """One result for each data set."""
    system = systems.get(case.system)
    for number in range(sets):
        data, groups = case.data(number, noise)
        start = time.process_time()
        model = la.discover(data, system.library, known=system.known, groups=groups)
        spent = time.process_time() - start
        assert model.groups is not None
        found = {(d.expression, d.group): d for d in model.groups.differences}
        named = {*found} == {*case.truth}
        z = (
            [(found[k].difference - v) / found[k].standard_error for k, v in case.truth.items()]
            if named
            else []
        )
        structure = {t.expression for t in model.terms} == {*system.lagrangian}
        yield Result(named, structure, model.fit.status == "ok", z, spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.01, 0.05])
    parser.add_argument("--cases", nargs="+", choices=[*CASES], default=[*CASES])
    given = parser.parse_args()
    print(f"{'case':<28} noise  named  structure  ok  inside 95 %  of  mean z  rms z  seconds")
    for name in given.cases:
        for noise in given.noise:
            rows = list(fits(CASES[name], noise, given.sets))
            z = np.concatenate([row.z for row in rows])
            inside = " " * 31
            if z.size:
                inside = (
                    f"{100 * np.mean(np.abs(z) < 1.96):10.1f} % {z.size:4d} {z.mean():7.2f} "
                    f"{np.sqrt(np.mean(z**2)):6.2f}"
                )
            print(
                f"{name:<28} {100 * noise:3.0f} % {sum(r.named for r in rows):6d} "
                f"{sum(r.structure for r in rows):10d} {sum(r.ok for r in rows):3d} "
                f"{inside} {np.median([r.seconds for r in rows]):8.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
