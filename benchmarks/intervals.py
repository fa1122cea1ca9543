"""How often the structure is exact and how well intervals hold: systems, groups, prescribed, hidden motion.

    python -m benchmarks.intervals systems --sets 3 --noise 0 0.01 0.1 --library large
    python -m benchmarks.intervals groups --sets 20
    python -m benchmarks.intervals prescribed --sets 20
    python -m benchmarks.intervals hidden --sets 10 --noise 0.01 0.1 --library terms

``systems``: the seven simulated systems (five recordings of 20 s at 100 Hz) with their own candidates or many
more, optionally with samples missing and at jittered times.  The error of the coefficients is relative to
their norm, and compared with the Cramér–Rao bound.

``groups``: systems of which a mass, a spring or a magnet differs between groups of three recordings (10 s at
100 Hz, one sensor), of each many data sets, and the same systems with nothing changed.  Candidates are those
of the systems.

``prescribed``: three machines, of each many data sets (three recordings of 8 s at 100 Hz, the prescribed
motion a sum of four sines): a crane whose drive is not measured, a pendulum on a shaken support, an arm with
one torque sensor of two.  Candidates are those of `Library.mechanical`, friction in the moved joint.

``hidden``: the simulated systems of two and three coordinates, each coordinate without a sensor in turn (five
recordings of 20 s at 100 Hz).  Candidates are the terms of the law (``--library terms``) or those of the
systems, of which the terms are then selected.

Noise is a share of the spread of each coordinate.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import leastaction as la
from leastaction import systems
from leastaction.metrics import cramer_rao_bound
from leastaction.model.model import ModelTerm
from leastaction.systems import MechanicalSystem, measure, noise_std, simulate_truth

# ------------------------------------------------------------------------------------- groups of trials
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


def group_fits(case: Case, noise: float, sets: int) -> Iterator[Result]:
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


def groups(given: argparse.Namespace) -> None:
    """Print a row for each case and level of noise."""
    print(f"{'case':<28} noise  named  structure  ok  inside 95 %  of  mean z  rms z  seconds")
    for name in given.cases:
        for noise in given.noise:
            rows = list(group_fits(CASES[name], noise, given.sets))
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


# ------------------------------------------------------------------------------- prescribed coordinates
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


def machine_fits(
    machine: Machine, noise: float, sets: int
) -> Iterator[tuple[bool, bool, list[float], float]]:
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


def prescribed(given: argparse.Namespace) -> None:
    """Print a row for each machine and level of noise."""
    print("machine           noise  exact  ok and wrong  doubtful  inside 95 %  mean z  rms z  seconds")
    for name, machine in MACHINES.items():
        for noise in given.noise:
            rows = list(machine_fits(machine, noise, given.sets))
            z = np.concatenate([row[2] for row in rows])
            wrong = sum(ok and not exact for exact, ok, *_ in rows)
            print(
                f"{name:<16} {100 * noise:4.0f} % {sum(row[0] for row in rows):6d} {wrong:13d} "
                f"{sum(not row[1] for row in rows):9d} {100 * np.mean(np.abs(z) < 1.96):9.0f} % "
                f"{z.mean():7.2f} {np.sqrt(np.mean(z**2)):6.2f} {np.median([row[3] for row in rows]):8.1f}",
                flush=True,
            )


# ---------------------------------------------------------------------------------------- seven systems
def offered(system: MechanicalSystem, library: str) -> la.Library:
    """The terms of the law, the candidates of the system, or many more."""
    if library == "terms":
        return la.Library([*system.lagrangian], system.coordinates, angles=system.angles)
    return (systems.large_library if library == "large" else systems.compact_library)(system)


def system_fit(name: str, noise: float, number: int, given: argparse.Namespace) -> dict:
    """One data set: structure, relative error, its ratio to the bound, intervals that hold, seconds."""
    system = systems.get(name)
    shape = {"trials": 5, "duration": 20.0, "rate": 100.0, "seed": number, "irregular": given.irregular}
    data = systems.generate(system, noise=noise, missing=given.missing, **shape)
    library = offered(system, given.library)
    start = time.process_time()
    model = la.discover(data, library, known=system.known)
    spent = time.process_time() - start
    known = {library.index(text) for text in system.known}
    free = {k: value for k, value in systems.truth_for(system, library).items() if k not in known}
    found = {library.index(term.expression): term for term in model.terms if not term.known}
    values = {k: term.coefficient for k, term in found.items()}
    off = sum((values.get(k, 0.0) - free.get(k, 0.0)) ** 2 for k in {*values, *free})
    error = float(np.sqrt(off / sum(v**2 for v in free.values())))
    motions = simulate_truth(system, **shape)
    # without noise there is no bound
    bound = (
        cramer_rao_bound(system, motions, noise_std(system, motions, noise), observed=data) if noise else None
    )
    inside = [found[k].lower <= v <= found[k].upper for k, v in free.items() if k in found]
    return {
        "exact": found.keys() == free.keys(),
        "ok": model.fit.status == "ok",
        "error": error,
        "ratio": error / bound.relative if bound else np.nan,
        "inside": inside,
        "seconds": spent,
    }


def of_systems(given: argparse.Namespace) -> None:
    """Print a row for each system and level of noise."""
    print("system                   noise  exact  ok  median error  over the bound  inside 95 %  seconds")
    for name in systems.names():
        for noise in given.noise:
            rows = [system_fit(name, noise, number, given) for number in range(given.sets)]
            inside = [held for row in rows for held in row["inside"]]
            error, ratio, spent = (
                np.median([row[key] for row in rows]) for key in ("error", "ratio", "seconds")
            )
            print(
                f"{name:<24} {100 * noise:3.0f} % {sum(row['exact'] for row in rows):6d} "
                f"{sum(row['ok'] for row in rows):3d} {error:13.2e} {ratio:15.2f} "
                f"{sum(inside):6d}/{len(inside):<3d} {spent:10.1f}",
                flush=True,
            )


# ---------------------------------------------------------------------------- coordinates without a sensor
# Another coefficient that must be known, because otherwise the scale of the coordinate is open.
SCALED = {
    ("cart_spring_pendulum", "x"): ("x_dot*theta_dot*cos(theta)",),
    ("spherical_spring_pendulum", "x"): ("x_dot**2",),
    ("spherical_spring_pendulum", "phi"): ("x**2*sin(theta)**2*phi_dot**2",),
}
# The zero of the hidden cart is open, and this is the law about that of fewest terms.
SIMPLER = {("cart_spring_pendulum", "x"): {"x": 0.0}}


def hidden_fit(name: str, hidden: str, noise: float, number: int, library: str = "terms") -> dict:
    """One data set: errors in standard errors, relative error and the bound on it, exact terms, seconds."""
    system = systems.get(name)
    truth = {**system.lagrangian, **SIMPLER.get((name, hidden), {})}
    known = {k: truth[k] for k in (*system.known, *SCALED.get((name, hidden), ()))}
    free = {k: v for k, v in truth.items() if k not in known and v}
    motions = simulate_truth(system, trials=5, duration=20.0, rate=100.0, seed=number)
    sigma = noise_std(system, motions, noise)
    data = []
    for run in measure(system, motions, sigma, seed=number):
        q = run.q.copy()
        q[:, system.coordinates.index(hidden)] = np.nan
        data.append(run.changed(q=q))
    bound = cramer_rao_bound(system, motions, sigma, unknown=[*free], observed=la.Trajectories(data))
    candidates = offered(system, library)
    start = time.process_time()
    model = la.discover(data, candidates, known=known, hidden=[hidden])
    spent = time.process_time() - start
    found = {term.expression: term for term in model.terms if not term.known}
    size = np.linalg.norm([*free.values()])
    wrong = [(found[k].coefficient if k in found else 0.0) - free.get(k, 0.0) for k in {*free, *found}]
    error = float(np.linalg.norm(wrong) / size)
    z = [(found[k].coefficient - v) / found[k].standard_error for k, v in free.items() if k in found]
    out = {"ok": model.fit.status == "ok", "z": z, "exact": {*found} == {*free}}
    return out | {"error": error, "bound": bound.relative, "seconds": spent}


def of_hidden(given: argparse.Namespace) -> None:
    """Print a row for each system, coordinate and level of noise; errors are those of results that are ok."""
    print(
        "system                     hidden  noise  ok  exact  error    bound    ratio  inside 95 %  seconds"
    )
    for name in (n for n in systems.names() if systems.get(n).n_dof > 1):
        for hidden in systems.get(name).coordinates:
            for noise in given.noise:
                rows = [hidden_fit(name, hidden, noise, k, given.library) for k in range(given.sets)]
                held = [row for row in rows if row["ok"]]
                error, bound, spent = (
                    np.array([row[key] for row in held]) for key in ("error", "bound", "seconds")
                )
                z = np.abs([z for row in held for z in row["z"]])
                error, bound = (np.sqrt(np.mean(values**2)) for values in (error, bound))
                print(
                    f"{name:<26} {hidden:<7} {100 * noise:3.0f} % {len(held):3d} "
                    f"{sum(row['exact'] for row in rows):6d}  {error:.2e} {bound:.2e} {error / bound:5.2f} "
                    f"{np.sum(z < 1.96):7d}/{z.size:<4d} {np.median(spent):8.1f}",
                    flush=True,
                )


STUDIES = {"systems": of_systems, "groups": groups, "prescribed": prescribed, "hidden": of_hidden}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("study", choices=[*STUDIES])
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.01, 0.05])
    parser.add_argument("--cases", nargs="+", choices=[*CASES], default=[*CASES], help="of the groups")
    sizes = ["terms", "compact", "large"]
    parser.add_argument("--library", choices=sizes, default="compact", help="of systems and hidden motion")
    parser.add_argument("--missing", type=float, default=0.0, help="share of samples of the systems")
    parser.add_argument("--irregular", action="store_true", help="sampling times of the systems")
    given = parser.parse_args()
    STUDIES[given.study](given)


if __name__ == "__main__":
    main()
