"""Does the verdict sort?  Simulated machines of varied faults, with right and with wrong set-ups.

    python -m benchmarks.sorting --count 40             # of each kind; killed, it goes on where it was
    python -m benchmarks.sorting --count 0              # only the table

The machines are those of `benchmarks.machines`: short recordings of one or two joints, with vibration,
gear ripple, encoder steps and held, late, noisy torques, of the usual size or of a hundredth of it.
Half of the set-ups are wrong: a term of L that the library lacks, friction that is not offered, a force that
is not in the table, a torque of a wrong scale (or far too late, where there is one joint only), a known
coefficient that is 1.3 times too large, a joint without a column (a missing term, where there is only one).
Five of eight trials are held out, with their forces as the user has them.

Two kinds are aside: no rule was set on them.  A structure is wrong if it differs from that of the
machine, and materially wrong if accelerations along a held-out trial are off by more than 5 %, too.  A
result is as good as the truth if its forecasts of the held-out trials are off by at most a tenth more than
those of the true law with the true numbers.  Stated errors are asked three times: whether twice the stated
error covers all held-out trials together, whether twice that of the worst fitted trial covers each of them,
and whether the band of the forecasts of a trial does, twice its root mean square.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

import leastaction as la
from benchmarks.machines import KINDS, Extent, Machine, draw
from leastaction.selection.settings import SELECTION
from leastaction.threads import single_threaded
from runner.store import Store

ASIDE = ("rotary", "crane")
EXTENT = Extent(trials=8, duration=3.0, rate=100.0)
FITTED = 3  # trials; the others are held out
SETUPS = (
    *("sound", "lacking", "sound", "known", "sound", "unseen"),
    *("sound", "pushed", "sound", "scaled", "sound", "rubbing"),
)
SIZES = (1.0, 0.01)
MATERIAL, AS_GOOD = 0.05, 1.1
_PUSH, _SCALE, _LATE = 0.3, 1.3, 5  # of the torques, of one torque or known coefficient, samples


@dataclass(frozen=True)
class Case:
    """One machine; what is wrong follows from its number."""

    kind: str
    seed: int

    @property
    def key(self) -> str:
        return f"{self.kind}-{self.seed:05d}"

    @property
    def part(self) -> str:
        return "sorting"

    @property
    def setup(self) -> str:
        return SETUPS[self.seed % len(SETUPS)]

    @property
    def size(self) -> float:
        return SIZES[self.seed // len(SETUPS) % len(SIZES)]


def posed(case: Case) -> tuple[Machine, Machine]:
    """The machine, and what the user asks of it."""
    machine = draw(case.kind, case.seed, EXTENT, case.size)
    rng, asked = np.random.default_rng([case.seed, 7]), machine
    n, setup = machine.data.n_dof, case.setup
    if setup == "unseen" and n > 1:
        return machine, _seen(machine)
    if setup in ("lacking", "unseen"):
        gone = rng.choice([text for text in machine.law if text[-3:] != "**2" or "_dot" not in text])
        kept = [term for term in machine.library if term.text.replace(" ", "") != gone]
        asked = replace(machine, library=machine.library.replace(terms=kept))
    if setup == "rubbing":
        asked = replace(machine, offered=())
    if setup in ("pushed", "scaled"):
        asked = replace(machine, data=la.Trajectories([_told(t, setup, n, rng) for t in machine.data]))
    return machine, asked


def _seen(machine: Machine) -> Machine:
    """What is left to ask without the last joint: terms and friction of the others."""
    names = machine.data.coordinates[:-1]
    data = [
        la.Trajectory(t.t, t.q[:, :-1], forces=np.array(t.forces)[:, :-1], coordinates=list(names), name=name)
        for name, t in zip(machine.data.names, machine.data, strict=True)
    ]
    gone = machine.data.coordinates[-1]
    angles = [name for name in machine.library.angles if name != gone]
    library = la.Library.mechanical(names, angles, size="standard")
    offered = tuple(text for text in machine.offered if gone not in text)
    return replace(machine, data=la.Trajectories(data), library=library, offered=offered)


def _told(trajectory: la.Trajectory, setup: str, n: int, rng: np.random.Generator) -> la.Trajectory:
    forces = np.array(trajectory.forces)
    if setup == "pushed":
        size = forces[:, -1].std()
        forces[:, -1] -= (
            _PUSH * size * np.sqrt(2) * np.sin(rng.uniform(2, 6) * trajectory.t + rng.uniform(0, 6))
        )
    elif n > 1:
        forces[:, -1] *= _SCALE
    else:
        forces = np.roll(forces, _LATE, axis=0)
    return trajectory.changed(forces=forces)


def carried_out(case: Case) -> dict:
    """Discover, and compare with the truth on the trials that were held out."""
    machine, asked = posed(case)
    names = list(asked.data.names)
    fitted, held = asked.data.select(names[:FITTED]), machine.data.select(names[FITTED:])
    begun = time.process_time()
    known = {term: _SCALE * machine.law[term] for term in list(machine.law)[:1] if case.setup == "known"}
    model = la.discover(fitted, asked.library, known=known, dissipation=asked.offered)
    seconds = time.process_time() - begun
    codes = "forecasts", "forecasts-fail"
    stated: dict[str, Any] = next(({**f.values} for f in model.fit.findings if f.code in codes), {})
    horizon = stated.get("horizon", 0.5)
    spread = np.sqrt(np.mean([np.nanvar(t.q, axis=0) for t in fitted], axis=0))
    truth = _truth(model, machine) if model.n_dof == machine.data.n_dof else None
    measured, bands, inside = _errors(model, asked.data.select(names[FITTED:]), horizon, spread)
    terms = {_plain(t.expression) for t in model.terms}
    found, true = {_plain(t.expression) for t in model.dissipation}, {_plain(t) for t in machine.friction}
    return {
        "finished": True,
        "status": model.fit.status,
        "codes": sorted({f.code for f in model.fit.findings if f.severity == "warning"}),
        "law": terms == {_plain(text) for text in machine.law},
        "missed": sorted(true - found),
        "spurious": sorted(found - true),
        "there": len(true),
        "absent": len(machine.offered) - len(true),
        "off": 1.0 if truth is None else _off(model, truth, held),
        "stated": [stated["error"], stated["worst"]] if stated else None,
        "left_out": [stated["left_out"], stated["worst_left_out"]] if "left_out" in stated else None,
        "measured": measured,  # with the forces as told
        "bands": bands,
        "inside": inside,
        "truth": None if truth is None else _errors(truth, held, horizon, spread)[0],
        "terms": sorted([*terms, *found]),
        "seconds": round(seconds, 2),
    }


def _truth(like: la.LagrangianModel, machine: Machine) -> la.LagrangianModel:
    def terms(values: Mapping[str, float]) -> list[dict]:
        rows = values.items()
        return [{"expression": e, "coefficient": c, "standard_error": 0.0, "known": True} for e, c in rows]

    friction = {
        f"sqrt({text[4:-1]}**2 + 1/10000)" if text.startswith("abs") else text: value
        for text, value in machine.friction.items()
    }
    parts = {"terms": terms(machine.law), "dissipation": terms(friction), "covariance": []}
    return la.LagrangianModel.from_dict({**like.to_dict(), **parts, "shapes": []})


def _plain(text: str) -> str:
    """A term as it was offered: dry friction is smoothed in a search."""
    text = text.replace(" ", "")
    return (
        f"abs({text[5:].split('**2+')[0].strip('()')})"
        if text.startswith("sqrt(")
        else text.replace("abs((", "abs(")
    )


def _errors(
    model: la.LagrangianModel, held: la.Trajectories, horizon: float, spread: np.ndarray
) -> tuple[list[float], list[float] | None, float]:
    """Of each trial: error of forecasts, and what their bands say, both rms; and what the bands cover.

    As the stated error is made: from states found in a short window, lost runs counted as one.
    """
    horizon = min(horizon, 0.4 * held[0].duration)
    window = max(SELECTION.window * horizon, 8 * held.sampling_interval)
    result = model.validate(held, horizon=horizon, window=window)
    parts = [part.traces for part in result.by_trial().values()]
    off = [_rms([trace.rms / spread for trace in part]) for part in parts]
    if result.traces[0].reach is None:
        return off, None, float("nan")
    stds = [[trace.std for trace in part if trace.std is not None] for part in parts]
    bands = [_rms([np.sqrt(np.mean(std**2, axis=0)) / spread for std in part]) for part in stds]
    return off, bands, float(np.nanmin(result.coverage))


def _rms(errors: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.minimum(np.nan_to_num(errors, nan=1.0), 1.0) ** 2)))


def _off(model: la.LagrangianModel, truth: la.LagrangianModel, held: la.Trajectories) -> float:
    """Largest relative error of accelerations along a trial, over coordinates."""
    motion, force = la.smooth(held[:1])[0], held[0].forces
    one, other = (np.asarray(m.acceleration(motion.q, motion.qdot, force)) for m in (model, truth))
    size = np.sqrt(np.mean(other**2, axis=0))
    return float(np.nanmax(np.sqrt(np.mean((one - other) ** 2, axis=0)) / size))


def table(records: Iterable[dict]) -> list[str]:
    """What is asked of a verdict, for the kinds that rules were set on and for those aside."""
    done = [(Case(**r["config"]), r["result"]) for r in records if r["result"]["finished"]]
    halves = {"kinds with rules": [x for x in done if x[0].kind not in ASIDE]}
    halves["kinds aside"] = [x for x in done if x[0].kind in ASIDE]
    return [line for name, part in halves.items() if part for line in (f"{name}:", *_lines(part))]


def _exact(result: dict) -> bool:
    return result["law"] and not result["missed"] and not result["spurious"]


def _all(errors: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def _stated(result: dict) -> list[float]:
    """Stated error of trials left out, and of the worst; in older records, of fitted ones."""
    return result.get("left_out") or result["stated"]


def _as_good(results: list[dict]) -> str:
    """How many are as good as the truth, and how many of these are doubted."""
    good = [r for r in results if r["truth"] and _all(r["measured"]) <= AS_GOOD * _all(r["truth"])]
    return f"{len(good)}, doubtful {sum(r['status'] == 'doubtful' for r in good)}"


def _lines(part: list[tuple[Case, dict]]) -> Iterable[str]:
    results, sound = [r for _, r in part], [r for case, r in part if case.setup == "sound"]
    ok, usable, doubtful = ([r for r in results if r["status"] == s] for s in ("ok", "usable", "doubtful"))
    wrong = [r for r in ok if not _exact(r)]
    yield f"  {len(part)} machines, structure exact in {sum(map(_exact, results))}"
    for size in SIZES:
        some = Counter(
            ("sound" if case.setup == "sound" else "wrong", r["status"])
            for case, r in part
            if case.size == size
        )
        if some:
            yield f"  faults of size {size}: " + ", ".join(
                f"{a} {b} {n}" for (a, b), n in sorted(some.items())
            )
    yield f"  ok: {len(ok)}, wrong {len(wrong)}, materially {sum(r['off'] > MATERIAL for r in wrong)}"
    within = sum(_all(r["measured"]) <= 2.0 * _stated(r)[0] for r in usable)
    trials = [e <= 2.0 * _stated(r)[1] for r in usable for e in r["measured"]]
    yield f"  usable: {len(usable)}, forecasts within twice the stated error {within}"
    yield f"  usable: trials within twice the error of the worst {sum(trials)} of {len(trials)}"
    bands = [(e, b) for r in usable + ok for e, b in zip(r["measured"], r["bands"] or (), strict=True)]
    inside = sum(e <= 2.0 * b for e, b in bands)
    yield f"  ok, usable: trials within twice their band {inside} of {len(bands)}"
    yield f"  as good as the truth: {_as_good(results)}; of sound set-ups {_as_good(sound)}"
    missed, spurious = (sum(len(r[name]) for r in sound) for name in ("missed", "spurious"))
    there, absent = (sum(r[name] for r in sound) for name in ("there", "absent"))
    yield f"  sound set-ups: {len(sound)}, friction missed {missed}/{there}, spurious {spurious}/{absent}"
    for name, some in (("ok", ok), ("usable", usable), ("doubtful", doubtful)):
        if some:
            # JSON has no infinity: accelerations of a mass that vanishes
            median = 100.0 * np.median([np.inf if r["off"] is None else r["off"] for r in some])
            yield f"  {name}: accelerations off by {median:.1f} % (median of {len(some)})"


@click.command()
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS), default=KINDS)
@click.option("--first", default=3000, show_default=True, help="Number of the first machine of a kind.")
@click.option("--count", default=40, show_default=True, help="Machines of each kind.")
@click.option(
    "--records", default="sorting", show_default=True, type=click.Path(path_type=Path), help="Folder."
)
@single_threaded()
def main(kinds: tuple[str, ...], first: int, count: int, records: Path) -> None:
    """Run the machines that have no record yet, and print the table."""
    store = Store(records, lambda config: Case(**config))
    done = {store.key(record) for record in store.read()} if records.exists() else set()
    for seed in range(first, first + count):
        for kind in kinds:
            case = Case(kind, seed)
            if case.key in done:
                continue
            try:
                result = carried_out(case)
            except la.DataError as error:
                result = {"finished": False, "status": type(error).__name__, "reason": str(error)}
            store.append({"config": asdict(case), "result": result})
            said = {k: v for k, v in result.items() if k != "terms"}
            click.echo(f"{case.key} {case.setup} {case.size}: {said}")
    click.echo("\n".join(table(store.read())))


if __name__ == "__main__":
    main()
