"""What half and twice of every setting does, on set-ups that no rule was made for.

    python -m benchmarks.thresholds [--package diagnosis] [--field noise_ratio] [--every-setup]

Set-ups: the further systems, and wrong ones of the study of faults with seeds that no record has; 3 × 8 s at
50 Hz, one data set each.  A row says how many structures are exact, how many results are ok, how many are ok
and wrong, and which changed: structure, status or the codes of the findings; for settings of measured
velocities, which of 32 channels are doubted; of outliers, which samples are left out; of simulations, what
becomes of three machines; of shape parameters and of prescribed coordinates, what becomes of six recordings
each; of imitations, which of nine laws are doubtful; of parts without a sensor, which of 54 machines are said
to have one.  Ratios (a value near one) are taken at half and twice their distance from one.  Settings of the
diagnosis need no new search and are tried on all set-ups, those of the causes on the wrong ones; settings of
the search on the quicker set-ups.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import product
from time import process_time

import click
import numpy as np

import leastaction as la
from benchmarks import ablations, intervals
from benchmarks.unmeasured_parts import WITH, WITHOUT, discovered
from leastaction import systems
from leastaction.assembly import assemble_model
from leastaction.curve.knots import lay_knots
from leastaction.curve.outliers import leave_out_outliers
from leastaction.curve.settings import CURVE
from leastaction.curve.smoothing import Smooth
from leastaction.diagnosis import verdict
from leastaction.diagnosis.rates import doubts_about_rates
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.settings import ESTIMATION
from leastaction.selection import significance
from leastaction.selection.alternatives import find_alternatives
from leastaction.selection.search import run_search
from leastaction.selection.search_state import begin_search
from leastaction.selection.settings import SELECTION
from leastaction.threads import single_threaded
from studies import names, shapes, unlisted
from studies.case import Case
from studies.solve import pose, score

_PACKAGES = {"curve": CURVE, "estimation": ESTIMATION, "selection": SELECTION, "diagnosis": DIAGNOSIS}
_RATIOS = (
    *("mostly_regular", "solvable", "clearly", "finer", "grown", "noise_ratio", "finest", "shape_scales"),
    *("samples_per_knot", "part_explains"),
)
_SHAPE = {"trial": 500, "trajectories": 3, "duration": 8.0, "rate": 50.0}
_FURTHER = ("rotary_pendulum", "double_well", "henon_heiles", "kepler_orbit", "morse_molecule")
_SLOWER = ("robot_arm", "elastic_pendulum_cart", "toda_chain")
_FAULTS = (
    ("term-missing", "single_pendulum", 0.1),
    ("friction-1", "double_pendulum", 0.01),
    ("known-1.2", "single_pendulum", 0.01),
    ("force-delay", "single_pendulum", 0.01),
    ("friction-5", "cart_spring_pendulum", 0.1),
    ("friction-0.2", "chaotic_pendulum", 0.01),
    ("known-1.2", "double_pendulum", 0.1),
    ("known-2", "cart_spring_pendulum", 0.1),
    ("force-delay", "double_pendulum", 0.1),
    ("force-scale-known", "single_pendulum", 0.01),
    ("force-sign-one", "double_pendulum", 0.1),
    ("sampling", "double_pendulum", 0.01),
    ("degrees", "single_pendulum", 0.1),
    ("excitation", "single_pendulum", 0.01),
    ("excitation", "chaotic_pendulum", 0.1),
)
_UNLISTED = ("barrier_in_bowl", "bead_on_cosine", "isotonic_oscillator", "morse_line")
_UNLISTED += ("power_well", "soft_coulomb")
_POLYNOMIALS = ("double_well", "henon_heiles", "elastic_pendulum_cart")
_SHAPED = ("morse_line", "spring_at_anchor", "lennard_jones_line")  # the quicker laws of the study
_QUICK = 4  # of them
# what a cause is looked for with; all others leave the causes of a search as they are
_OF_CAUSES = ("certain", "force_share", "half_a_sample", "slight", "part_of_error", "follows")


def _cases(faults) -> list[Case]:
    return [Case("faults", name, noise, setup, **_SHAPE) for setup, name, noise in faults]


def _further(names, levels) -> list[Case]:
    return [Case("faults", name, noise, **_SHAPE) for name in names for noise in levels]


_NOISE = [Case("noise", "single_pendulum", 0.03, kind, **_SHAPE) for kind in ("coloured", "forces 100 %")]
QUICK = [*_further(_FURTHER[1:], (0.1,)), *_cases(_FAULTS[:_QUICK])]
WRONG = _cases(_FAULTS[_QUICK:-3])
ALL = [*_further(_FURTHER, (0.01, 0.1)), *_further(_SLOWER, (0.1,)), *_NOISE, *_cases(_FAULTS)]


@dataclass(frozen=True)
class Outcome:
    """What a discovery said."""

    exact: bool
    status: str
    said: tuple[str, ...]


@contextmanager
def changed(settings, **values: float) -> Iterator[None]:
    """Other values in every module that holds these settings."""
    other = replace(settings, **values)
    held = [
        (module, name)
        for key, module in list(sys.modules.items())
        if key.startswith("leastaction") or key == __name__
        for name, value in vars(module).items()
        if value is settings and name.isupper()
    ]
    for module, name in held:
        setattr(module, name, other)
    try:
        yield
    finally:
        for module, name in held:
            setattr(module, name, settings)


@cache
def _question(case: Case):
    return pose(case)[0]


def _searched(case: Case):
    question = _question(case)
    setup = build_problem(la.Trajectories.coerce(question.data), Request(question.library, question.known))
    search = run_search(begin_search(setup))
    return setup, search, *find_alternatives(search.found, search.relevance)


_kept = cache(_searched)


def outcome(case: Case, searched) -> Outcome:
    """Judge what a search has found."""
    setup, search, alternatives, curvature = searched
    findings = doubts_about_rates(setup.searched.trajectories, setup.scales.smooth)
    setup = replace(setup, findings=(*setup.findings, *findings))
    judged = verdict.verify(search, alternatives, curvature)
    model = assemble_model(setup, search, judged, alternatives, {}, {})
    codes = sorted(f"{finding.code} {' '.join(finding.subject)}" for finding in model.fit.findings)
    terms = sorted(term.expression for term in (*model.terms, *model.dissipation))
    return Outcome(score(case, _question(case), model)["exact"], model.fit.status, (*terms, *codes))


# what is done to the measured velocity of a coordinate: factor, offset in rms, noise in rms; is it wrong?
_CHANNELS = {
    "as it is": (1.0, 0.0, 0.02, False),
    "noisy": (1.0, 0.0, 1.0, False),
    "3 % off": (1.03, 0.0, 0.02, False),
    "10 % off": (1.1, 0.0, 0.02, True),
    "10 % off, noisy": (1.1, 0.0, 0.5, True),
    "reversed": (-1.0, 0.0, 0.1, True),
    "with an offset": (1.0, 0.2, 0.1, True),
    "something else": (0.0, 0.0, 1.0, True),
}


@cache
def _channels(system: str, noise: float) -> list[tuple[bool, la.Trajectories, Smooth]]:
    """Recordings with velocities, and whether these are wrong."""
    truth = systems.simulate_truth(system, 2, 30.0, 50.0, seed=1500)
    data = systems.measure(system, truth, systems.noise_std(system, truth, noise), seed=1500)
    rms, rng = np.sqrt(np.mean([np.mean(m.qdot**2, axis=0) for m in truth], axis=0)), np.random.default_rng(0)
    out = []
    for factor, offset, spread, wrong in _CHANNELS.values():
        pairs = zip(data, truth, strict=True)
        scatter = (spread * rng.standard_normal(m.qdot.shape) for m in truth)
        runs = [
            t.changed(velocities=factor * m.qdot + rms * (offset + s))
            for (t, m), s in zip(pairs, scatter, strict=True)
        ]
        recorded = la.Trajectories(runs)
        out.append((wrong, recorded, lay_knots(la.Trajectories(list(data)), 5).smooth))
    return out


def _rates_judged() -> str:
    """How many channels that are wrong are named, and how many that are right."""
    found = [
        (wrong, bool(doubts_about_rates(recorded, smooth)))
        for system in ("single_pendulum", "henon_heiles")
        for noise in (0.01, 0.1)
        for wrong, recorded, smooth in _channels(system, noise)
    ]
    wrong = sum(wrong for wrong, _ in found)
    named = sum(wrong and doubted for wrong, doubted in found)
    right = sum(doubted and not wrong for wrong, doubted in found)
    return f"{named} of {wrong} wrong channels named, {right} of {len(found) - wrong} right ones"


def _outliers_judged() -> str:
    """How many samples that are far off are left out, and how many good ones."""
    far = found = good = 0
    for system, (kind, share) in product(
        ("single_pendulum", "henon_heiles"), (("gaussian", 0.0), ("gaussian", 0.02), ("student3", 0.0))
    ):
        case = Case("noise", system, 0.03, kind, trial=500, trajectories=2, duration=20.0, rate=50.0)
        clean, rng = _question(case).data, np.random.default_rng(0)
        hit = [rng.random(t.q.shape) < share for t in clean]
        size = 10.0 * 0.03 * np.std(np.concatenate([t.q for t in clean]), axis=0)
        data = la.Trajectories([t.changed(q=t.q + h * size) for t, h in zip(clean, hit, strict=True)])
        left, _ = leave_out_outliers(data, 5)
        out = np.concatenate([~np.isfinite(t.q) for t in left])
        far += int(np.concatenate(hit).sum())
        found += int((out & np.concatenate(hit)).sum())
        good += int((out & ~np.concatenate(hit)).sum())
    return f"{found} of {far} outliers left out, and {good} samples that are none"


def _machines_judged() -> str:
    """Structures and coefficients of machines that are pushed by what nobody measured."""
    found = [
        ablations.outcome("machines", name) for name in ("pushed", "pushed hard", "pushed, dry friction")
    ]
    errors = ", ".join(f"{100 * one.error:.2g}" for one in found)
    return f"{sum(one.exact for one in found)} of {len(found)} exact, coefficients off by {errors} %"


def _scatter(z: list[float]) -> str:
    return f"rms z {np.sqrt(np.mean(np.square(z))):.3f}" if z else "no z"


def _prescribed_judged() -> str:
    """Structures and errors of machines one coordinate of which is moved by what nobody measured."""
    found = [
        row
        for one in intervals.MACHINES.values()
        for noise in (0.01, 0.05)
        for row in intervals.machine_fits(one, noise, 1)
    ]
    z = [z for row in found for z in row[2]]
    exact, ok = (sum(row[k] for row in found) for k in (0, 1))
    return f"{exact} of {len(found)} exact, {ok} ok, {_scatter(z)}"


def _biased(seed: int, size: float) -> tuple[la.Trajectories, np.ndarray]:
    """A driven pendulum whose torque was recorded without a bias that drifts, and that bias."""
    data = systems.generate("single_pendulum", noise=0.01, trials=3, duration=15.0, seed=seed)
    rng, runs, all_of_it = np.random.default_rng(seed), [], []
    for run in data:
        bias = size * (rng.normal() + np.sin(2.0 * np.pi * run.t / rng.uniform(10, 20) + rng.uniform(0, 6)))
        runs.append(run.changed(forces=run.forces - bias[:, None]))
        all_of_it.append(bias)
    return la.Trajectories(runs), np.concatenate(all_of_it)


def _bias_judged() -> str:
    """Slow forces: structures, how far off they are, and whether it is said where there is hardly any."""
    library, exact, told, errors = systems.compact_library("single_pendulum"), 0, 0, []
    begun = process_time()
    for seed, size in product((11, 12, 13), (0.0, 0.3, 1.5)):
        data, bias = _biased(seed, size)
        model = la.discover(data, library, force_offset={"theta": 2.5})
        exact += {t.expression for t in model.terms} == {"theta_dot**2", "cos(theta)"}
        errors.append(np.std(np.concatenate(model.diagnostics.force_offset["theta"]) - bias))
        slow = [f for f in model.fit.findings if f.code == "slow-force"]
        told += bool(slow) and slow[0].values["hardly_any"] == (size == 0.0)
    off, seconds = np.sqrt(np.mean(np.square(errors))), process_time() - begun
    return f"{exact} of 9 exact, forces off by {off:.4f} N m, {told} told rightly, {seconds:.0f} s"


def _shapes_judged() -> str:
    """Laws with numbers inside terms: structures, and errors of the numbers."""
    cases = [Case("shapes", name, noise, **_SHAPE) for name in _SHAPED for noise in (0.01, 0.1)]
    begun, found = process_time(), [shapes.solve(case) for case in cases]
    exact = [one for one in found if one["exact"]]
    z = [row["z"] for one in exact for what, row in one["terms"].items() if what[0] == "{"]
    ok = sum(one["status"] == "ok" for one in found)
    wrong = sum(one["status"] == "ok" and not one["exact"] for one in found)
    seconds = process_time() - begun
    return (
        f"{len(exact)} of {len(found)} exact, {ok} ok, {wrong} ok and wrong, {_scatter(z)}, {seconds:.0f} s"
    )


def _imitations_judged() -> str:
    """Laws that the candidates lack, and laws of polynomials that they hold: how many are not doubtful."""
    wrong = [unlisted.solve(Case("unlisted", name, 0.01, **_SHAPE))["status"] for name in _UNLISTED]
    right = [outcome(case, _searched(case)).status for case in _further(_POLYNOMIALS, (0.01,))]
    told = [f"{len(some) - some.count('doubtful')} of {len(some)}" for some in (wrong, right)]
    return f"not doubtful: {told[0]} laws that are not in the library, {told[1]} that are"


def _grown_judged() -> str:
    """Laws from names alone: how many are exact, and the processor time of those that the grammar holds."""
    seen = {name: [] for name in ("morse_molecule", "double_well", "kepler_orbit")}
    for (name, results), trial in product(seen.items(), range(3)):
        case = Case("names", name, 0.1, "plain", "symbolic", trial, 5, 20.0, 100.0)
        results.append(names.solve(case))
    exact = ", ".join(f"{sum(map(names.is_exact, some))} of {len(some)} {n}" for n, some in seen.items())
    seconds = sum(result["cpu_s"] for result in seen["double_well"] + seen["kepler_orbit"])
    return f"exact: {exact}; the last two take {seconds:.0f} s"


def _parts_judged() -> str:
    """Machines with a part without a sensor, and without: how many are said to have one."""
    found = ([discovered(k, s)[2] for k in some for s in (300, 301)] for some in (WITH, WITHOUT))
    with_it, without = ([one is not None for one in some] for some in found)
    return f"{sum(with_it)} of {len(with_it)} parts noticed, {sum(without)} of {len(without)} where none is"


_SHAPE_FIELDS = [f.name for f in (*fields(SELECTION), *fields(ESTIMATION)) if f.name.startswith("shape_")]
_OF_DATA = {
    **dict.fromkeys(("rate_factor", "rate_follows", "rate_clear", "rate_width"), _rates_judged),
    **dict.fromkeys(("outlier", "outlier_alone", "most_outliers"), _outliers_judged),
    **dict.fromkeys(("simulated", "horizon", "clearly", "window"), _machines_judged),
    **dict.fromkeys(("small_error", "no_error"), _prescribed_judged),
    **dict.fromkeys(("bias_settled", "bias_stalled", "no_bias"), _bias_judged),
    **dict.fromkeys(("not_followed", "mirrored", "shape_far", "shape_far_log"), _shapes_judged),
    **dict.fromkeys(_SHAPE_FIELDS, _shapes_judged),
    **dict.fromkeys(("lowest_exponent", "plain_terms", "cancelling"), _imitations_judged),
    "plain_terms_grown": _grown_judged,
    **{
        f"part_{n}": _parts_judged for n in ("explains", "few_turns", "certain", "agrees", "turns", "fastest")
    },
}


@contextmanager
def _causes_looked_for_once(used: tuple[str, ...]) -> Iterator[None]:
    """Keep the causes of a search while what they depend on stays the same: they take most of the time."""
    find, kept = verdict._likely_causes, {}

    def once(search, effects, off, suspect):
        values = tuple(getattr(verdict.DIAGNOSIS, name) for name in used)
        any_error = bool((effects.left > verdict.DIAGNOSIS.worth_knowing).any())
        key = (id(search), off, suspect, any_error, significance.SELECTION.false_alarm, values)
        if key not in kept:
            # the search is held, so that no other one gets its id
            kept[key] = (search, find(search, effects, off, suspect))
        return kept[key][1]

    verdict._likely_causes = once
    try:
        yield
    finally:
        verdict._likely_causes = find


def _sides(name: str, value: float) -> Mapping[str, float]:
    """The setting at half and twice its value."""
    if name in _RATIOS:
        return {"half": 1.0 + 0.5 * (value - 1.0), "twice": 1.0 + 2.0 * (value - 1.0)}
    if isinstance(value, int):
        return {"half": -(-value // 2), "twice": 2 * value}
    return {"half": 0.5 * value, "twice": 2.0 * value}


def _row(label: str, found: list[Outcome], before: list[Outcome], seconds: float) -> str:
    ok = [one for one in found if one.status == "ok"]
    wrong = sum(not one.exact for one in ok)
    moved = [(a, b) for a, b in zip(before, found, strict=True) if a != b]
    judged = sum((a.exact, a.status) != (b.exact, b.status) for a, b in moved)
    return (
        f"{label}: {sum(one.exact for one in found)} exact, {len(ok)} ok, {wrong} ok and wrong "
        f"of {len(found)}; "
        f"{len(moved)} changed, {judged} of them in structure or status; {seconds:.0f} s"
    )


@click.command()
@click.option(
    "--package", "packages", multiple=True, type=click.Choice(list(_PACKAGES)), help="Default: all."
)
@click.option("--field", "names", multiple=True, help="Default: all.")
@click.option("--every-setup", is_flag=True, help="Try the settings of the search on all set-ups, too.")
@click.option("--show", is_flag=True, help="Print which set-ups changed.")
@single_threaded()
def main(packages, names, every_setup: bool, show: bool) -> None:
    """Print a row for each value of each setting."""
    for package in packages or _PACKAGES:
        settings = _PACKAGES[package]
        wanted = [field.name for field in fields(settings) if not names or field.name in names]
        with _causes_looked_for_once(_OF_CAUSES):
            for name in wanted:
                if name in _OF_DATA:
                    click.echo(f"{name} ({getattr(settings, name):g}): {_OF_DATA[name]()}")
                    for side, value in _sides(name, getattr(settings, name)).items():
                        with changed(settings, **{name: value}):
                            click.echo(f"    {side} ({value:g}): {_OF_DATA[name]()}")
                    continue
                judged = package == "diagnosis" or name == "false_alarm"
                find = _kept if judged else _searched
                cases = ALL if every_setup or judged else QUICK
                cases = WRONG if name in _OF_CAUSES and not every_setup else cases
                before = [outcome(case, _kept(case)) for case in cases]
                click.echo(_row(f"{name} ({getattr(settings, name):g})", before, before, 0.0))
                for side, value in _sides(name, getattr(settings, name)).items():
                    begun = process_time()
                    with changed(settings, **{name: value}):
                        found = [outcome(case, find(case)) for case in cases]
                    click.echo(_row(f"    {side} ({value:g})", found, before, process_time() - begun))
                    for case, a, b in zip(cases, before, found, strict=True):
                        if show and a != b:
                            gone, new = set(a.said) - set(b.said), set(b.said) - set(a.said)
                            click.echo(
                                f"        {case.key}: {a.exact} {a.status} → {b.exact} {b.status}, "
                                f"without {sorted(gone)}, with {sorted(new)}"
                            )


if __name__ == "__main__":
    main()
