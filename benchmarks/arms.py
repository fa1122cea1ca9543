"""Simulated arms with seven joints: coverage of intervals, errors of the model, and reported contacts.

    python -m benchmarks.arms --logs 100                      # resumes where it was interrupted
    python -m benchmarks.arms --kind pushed --logs 40
    python -m benchmarks.arms --kind panda --logs 20          # needs mujoco and example-robot-data
    python -m benchmarks.arms --summary                       # of the records that exist
    python -m benchmarks.arms --thresholds --logs 12          # of the rule for contacts

Each log has its own arm, motion, friction and noise, drawn from its number.

chain   links like ellipsoids, 16 s at 500 Hz, encoder steps of 24 µrad, torques with 2 % noise; dry friction
        reverses over 2 mrad.
pushed  the same with other numbers, and one push: a torque in one joint, or a force at the hand, of random
        size, direction and duration.
panda   the Panda of example-robot-data, its inertias off by up to 30 %, in MuJoCo: forward dynamics at 4 kHz
        under a controller, torques held for 1 ms, 20 s at 1 kHz, encoder steps of 12 µrad, 1 % noise.

Viscous and dry friction are missing in a quarter of the joints.  A record holds the errors of the mass matrix
and of gravity over random states, z = (estimate - truth) / standard error of every base parameter, friction
that was missed or is not there, and notes.  Weighted least squares (`benchmarks.measured_arm`) runs on the
same logs, and other peers by --peer.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import click
import numpy as np

import leastaction as la
from benchmarks.measured_arm import PEERS, textbook
from leastaction import arms
from leastaction.arms.log import PUSHED, contact_notes
from leastaction.mechanics.arm_terms import FRICTION
from leastaction.mechanics.rigid_bodies import Motion
from leastaction.threads import single_threaded

RECORDS = Path(__file__).parents[1] / "build" / "arms.jsonl"
QUARTER = np.pi / 2.0
CHAIN = arms.KinematicTree.from_dh(
    [
        {"d": 0.34},
        {"alpha": -QUARTER},
        {"alpha": QUARTER, "d": 0.4},
        {"alpha": QUARTER},
        {"alpha": -QUARTER, "d": 0.4},
        {"alpha": -QUARTER},
        {"alpha": QUARTER, "d": 0.126},
    ],
    modified=True,
)
SIZE = np.array([1.0, 1.0, 0.6, 0.6, 0.3, 0.2, 0.15])  # of friction; rotors go with its square
PANDA = "panda_description/urdf/panda.urdf"


class Log(NamedTuple):
    """A log, its arm, what acts in the joints, and a push: start, duration, size relative to the noise."""

    log: la.Trajectory
    true: arms.ArmModel
    acting: dict[str, np.ndarray]
    push: tuple[float, float, float] | None = None


def joints(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """What acts in the joints; viscous and dry friction are missing in a quarter of them."""
    viscous, dry = rng.uniform(0.5, 1.5, (2, 7)) * (rng.uniform(size=(2, 7)) > 0.25)
    rotor = 0.3 * SIZE**2 * rng.uniform(0.5, 1.5, 7)
    return {"rotor": rotor, "viscous": 0.5 * SIZE * viscous, "dry": 0.8 * SIZE * dry}


def ellipsoids(rng: np.random.Generator) -> np.ndarray:
    """(7, 10) inertial parameters, lighter towards the hand."""
    out = []
    for k in range(7):
        mass = 4.0 * 0.72**k * rng.uniform(0.8, 1.2)
        centre, size = rng.normal(0.0, 0.05, 3), rng.uniform(0.04, 0.1, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        second = mass * (turn @ np.diag(size**2) @ turn.T + np.outer(centre, centre))
        inertia = np.trace(second) * np.eye(3) - second
        out.append([mass, *(mass * centre), *inertia[np.triu_indices(3)]])
    return np.array(out)


def waves(
    t: np.ndarray, rng: np.random.Generator, n: int, base: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sums of eight sines and their derivatives, (n_times, n) each."""
    q, qdot, qddot = np.zeros((3, t.size, n))
    for k in range(1, 9):
        w = 2.0 * np.pi * base * k
        a, b = rng.normal(0.0, 0.5 / np.sqrt(k) / (1.0 + 0.15 * k), (2, n))
        sine, cosine = np.sin(w * t)[:, None], np.cos(w * t)[:, None]
        q += a * sine + b * cosine
        qdot += w * (a * cosine - b * sine)
        qddot -= w**2 * (a * sine + b * cosine)
    return q, qdot, qddot


def chain(number: int, duration: float = 16.0, interval: float = 0.002) -> Log:
    """A log of a chain of links."""
    rng = np.random.default_rng([22, number])
    links, acting = ellipsoids(rng), joints(rng)
    true = arms.ArmModel.of_tree(CHAIN.with_inertias(links), acting, distance=2e-3)
    t = np.arange(0.0, duration, interval)
    q, qdot, qddot = waves(t, rng, 7, 0.12)
    torques = true.torques(q, qdot, qddot, successive=True)
    torques += 0.02 * torques.std(axis=0) * rng.normal(size=torques.shape)
    step = 2.0 * np.pi / 2**18
    return Log(la.Trajectory(t, step * np.rint(q / step), torques, CHAIN.coordinates), true, acting)


def pushed(number: int) -> Log:
    """A log of a chain with a push; its size is relative to the noise of torques averaged over 0.1 s."""
    made, rng = chain(10_000 + number), np.random.default_rng([24, number])
    log, tree = made.log, made.true.tree
    assert log.forces is not None
    torque, begin, duration = push(log, tree, rng, number % 2 == 1)
    size = size_of(torque, log)
    return made._replace(log=log.changed(forces=log.forces - torque), push=(begin, duration, size))


def push(
    log: la.Trajectory, tree: arms.KinematicTree, rng: np.random.Generator, single: bool
) -> tuple[np.ndarray, float, float]:
    """Torques of a push in a single joint, or by a force at the hand; its start and duration."""
    assert log.forces is not None
    begin, duration = rng.uniform(2.0, 12.0), np.exp(rng.uniform(*np.log([0.1, 1.5])))
    ramp = np.clip(np.minimum(log.t - begin, begin + duration - log.t) / 0.03, 0.0, 1.0)
    if single:
        torque = np.zeros_like(log.forces)
        i = int(rng.integers(7))
        torque[:, i] = np.exp(rng.uniform(*np.log([0.01, 0.3]))) * log.forces[:, i].std()
    else:
        force = rng.normal(size=3)
        force *= np.exp(rng.uniform(*np.log([1.0, 40.0]))) / np.linalg.norm(force)
        motion = Motion.at(tree, log.q, np.zeros_like(log.q), np.zeros_like(log.q))
        hand = motion.origins[-1] + motion.rotations[-1] @ np.array([0.0, 0.0, 0.1])
        axes = [turn @ joint.axis for turn, joint in zip(motion.rotations, tree.joints, strict=True)]
        arm = [np.cross(hand - origin, force) for origin in motion.origins]
        torque = np.stack([np.sum(a * b, axis=1) for a, b in zip(axes, arm, strict=True)], axis=1)
    return torque * ramp[:, None], begin, duration


def size_of(torque: np.ndarray, log: la.Trajectory) -> float:
    """A push relative to the noise of torques averaged over 0.1 s."""
    assert log.forces is not None
    noise = 0.02 * log.forces.std(axis=0) / np.sqrt(50.0)
    return float(np.max(np.abs(torque).max(axis=0) / noise))


def panda(number: int, late: float = 0.0, stiff: bool = True) -> Log:
    """A log of the Panda, simulated by MuJoCo; torques are recorded ``late`` seconds after they act."""
    from importlib.util import find_spec

    import mujoco

    found = find_spec("cmeel")
    assert found is not None
    assert found.origin is not None
    root = Path(found.origin).parents[1] / "cmeel.prefix/share/example-robot-data/robots"
    rng = np.random.default_rng([23, number])
    tree = arms.read_urdf(root / PANDA, joints=[f"panda_joint{k}" for k in range(1, 8)])
    tree = tree.with_inertias(tree.inertias * rng.uniform(0.7, 1.3, (7, 1)))
    acting = joints(rng)
    true = arms.ArmModel.of_tree(tree, acting)
    with TemporaryDirectory() as folder:
        true.to_mjcf(Path(folder) / "panda.xml")
        model = mujoco.MjModel.from_xml_path(str(Path(folder) / "panda.xml"))
    model.opt.timestep = 2.5e-4
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if stiff:
        model.dof_solref[:] = 2.0 * model.opt.timestep, 1.0
    data = mujoco.MjData(model)
    t = np.arange(0.0, 20.0, 0.001)
    limits = np.array([joint.limits for joint in tree.joints])
    middle, room = limits[:, :2].mean(axis=1), limits[:, 1] - limits[:, 0]
    unit = waves(t, rng, 7, 0.1)
    share = np.minimum(0.4 * room / np.abs(unit[0]).max(axis=0), 0.8 * limits[:, 2] / np.abs(unit[1]).max(0))
    wanted, speed, pull = middle + share * unit[0], share * unit[1], share * unit[2]
    forward = true.torques(wanted, speed, pull)
    data.qpos[:], data.qvel[:] = wanted[0], speed[0]
    gain = 400.0 * SIZE
    q, torques = np.empty((2, t.size, 7))
    for k in range(t.size):
        q[k] = data.qpos
        torques[k] = forward[k] + gain * (wanted[k] - data.qpos) + 0.1 * gain * (speed[k] - data.qvel)
        data.qfrc_applied[:] = torques[k]
        mujoco.mj_step(model, data, 4)
    seen = np.stack([np.interp(t - late, t, column) for column in torques.T], axis=1)
    seen += 0.01 * torques.std(axis=0) * rng.normal(size=torques.shape)
    step = 12e-6
    return Log(la.Trajectory(t, step * np.rint(q / step), seen, tree.coordinates), true, acting)


KINDS: dict[str, Callable[[int], Log]] = {"chain": chain, "pushed": pushed, "panda": panda}


def truth_of(found: arms.ArmModel, made: Log) -> np.ndarray:
    """The true base parameters in the combinations of another model."""
    links, acting = made.true.tree.inertias, made.acting
    x = [
        float(links[t.place, t.component])
        if t.kind == "inertia"
        else float(acting.get(t.kind, np.zeros(7))[t.place])
        for t in found.base.terms
    ]
    return found.base.matrix @ np.array(x)


def off(found: arms.ArmModel, true: arms.ArmModel, q: np.ndarray) -> list[float]:
    """Relative errors of the mass matrix and of gravity."""
    pairs = [(found.mass_matrix(q), true.mass_matrix(q)), (found.gravity(q), true.gravity(q))]
    return [float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in pairs]


def overlaps(note: str, push: tuple[float, float, float]) -> bool:
    """Whether a note on a contact names the time of a push."""
    first, last = map(float, re.findall(r"from ([\d.]+) to ([\d.]+) s", note)[0])
    return first < push[0] + push[1] and last > push[0]


def scored(kind: str, number: int, peers: tuple[str, ...]) -> dict[str, Any]:
    """The record of a log."""
    made = KINDS[kind](number)
    tree, n = made.true.tree, len(made.true.tree)
    log = made.log
    q = np.random.default_rng(number).uniform(log.q.min(axis=0), log.q.max(axis=0), (200, n))
    began = time.process_time()
    found = arms.identify(log, tree)
    seconds = time.process_time() - began
    friction = {t.text for t in found.terms if t.kind in FRICTION}
    names = tree.coordinates
    acts = {f"{k}[{names[i]}]" for k in ("viscous", "dry") for i in np.flatnonzero(made.acting[k])}
    z = (found.coefficients - truth_of(found, made)) / found.standard_errors
    solid = found.bodies()
    errors = {"identify": off(found, made.true, q), "bodies": off(solid, made.true, q)}
    ways = {f"weighted least squares, {cut:g} Hz": (textbook, cut) for cut in (5.0, 10.0, 20.0)}
    ways |= {f"{name}, 10 Hz": (PEERS[name], 10.0) for name in peers}
    for name, (peer, cut) in ways.items():
        try:
            errors[name] = off(peer(log, tree, cut), made.true, q)
        except ImportError as error:
            click.echo(f"{name}: not run, {error}")
    contacts = [note for note in found.facts.notes if "contact" in note]
    reported = [made.push is not None and overlaps(note, made.push) for note in contacts]
    return {
        "kind": kind,
        "number": number,
        "seconds": round(seconds, 2),
        "errors": errors,
        "z": {t.text: round(float(value), 3) for t, value in zip(found.terms, z, strict=True)},
        "missed": sorted(acts - friction),
        "spurious": sorted(friction - acts),
        "price": float(solid.facts.notes[-1].rsplit(" ", 1)[1]),
        "notes": list(found.facts.notes),
        "push": made.push,
        "reported": any(reported),
        "false_contacts": len(reported) - sum(reported),
        "knots": found.facts.knots_per_second,
    }


def read(path: Path) -> list[dict[str, Any]]:
    """The records that exist; a line that was cut off is left out."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]


def wilson(hits: int, n: int) -> str:
    """A share with its 95 % interval, in per cent."""
    p, c = hits / n, 1.96**2 / n
    middle, half = (p + c / 2) / (1 + c), 1.96 * np.sqrt(p * (1 - p) / n + c / (4 * n)) / (1 + c)
    return f"{100 * p:.1f} % [{100 * (middle - half):.1f}, {100 * (middle + half):.1f}] of {n}"


def summary(records: list[dict[str, Any]]) -> str:
    """What the records of one kind say."""
    ours = ("viscous", "dry", "stribeck", "load", "quadratic", "asymmetric")
    rigid = [v for r in records for name, v in r["z"].items() if name.split("[")[0] not in ours]
    rubbing = [v for r in records for name, v in r["z"].items() if name.split("[")[0] in ours[:2]]
    lines = [f"{len(records)} logs, {np.mean([r['seconds'] for r in records]):.1f} s of processor time each"]
    for name, values in (("base parameters", rigid), ("friction", rubbing)):
        z = np.abs(values)
        rms = np.sqrt(np.mean(z**2))
        held = wilson(int(np.sum(z < 1.96)), z.size)
        lines.append(f"{name}: within 95 % intervals {held}, rms z {rms:.2f}")
    exact = sum(not (r["missed"] or r["spurious"]) for r in records)
    lines.append(f"friction exact {wilson(exact, len(records))}")
    lines.append(f"logs with a contact that is not there: {sum(r['false_contacts'] > 0 for r in records)}")
    lines += pushes([r for r in records if r["push"]])
    for name in records[0]["errors"]:
        values = np.array([r["errors"][name] for r in records if name in r["errors"]]) * 100.0
        middle, worst = np.median(values, axis=0), values.max(axis=0)
        lines.append(
            f"{name}: mass matrix off by {middle[0]:.3f} % (at most {worst[0]:.3f}), gravity by "
            f"{middle[1]:.3f} % (at most {worst[1]:.3f})"
        )
    return "\n".join(lines)


def pushes(records: list[dict[str, Any]]) -> list[str]:
    """How many pushes were reported, by duration and size, and what the others cost."""
    lines: list[str] = []
    for short, long in ((0.0, 0.3), (0.3, 0.5), (0.5, 2.0)):
        for small, large in ((0.0, 5.0), (5.0, 10.0), (10.0, 20.0), (20.0, np.inf)):
            own = [r for r in records if short <= r["push"][1] < long and small <= r["push"][2] < large]
            if own:
                found = sum(r["reported"] for r in own)
                missed = [r["errors"]["identify"] for r in own if not r["reported"]]
                cost = [f"{100 * x:.2f} %" for x in np.max(missed, axis=0)] if missed else ["-", "-"]
                lines.append(
                    f"pushes of {short:g} to {long:g} s, {small:g} to {large:g} times the noise: {found} of "
                    f"{len(own)} reported; mass matrix and gravity of the others off by at most "
                    f"{cost[0]}, {cost[1]}"
                )
    return lines


def thresholds(logs: int, each: int = 40) -> str:
    """Half and twice the first threshold of the rule for contacts, on residuals to which pushes are added.

    What the base parameters absorb of a push is removed from it, as if the arm were identified again.
    """
    rows = {share * PUSHED[1]: {**PUSHED, 1: share * PUSHED[1]} for share in (0.5, 1.0, 2.0)}
    kinds = [(s, z) for s in ("below 0.2 s", "longer") for z in ("below 10", "10 to 20", "above 20")]
    found = {first: dict.fromkeys([*kinds, "wrong", "clean"], 0) for first in rows}
    total = dict.fromkeys(kinds, 0)
    for number in range(logs):
        made, rng = chain(20_000 + number), np.random.default_rng([25, number])
        model = arms.identify(made.log, CHAIN)
        (run,) = model.predict(made.log)
        left, owners = run.measured - run.predicted, np.zeros(run.t.size, int)
        weights = 1.0 / left.std(axis=0)
        columns = model.columns(run.q[::10], run.qdot[::10], run.qddot[::10])
        design = (columns * weights[:, None]).reshape(len(columns), -1).T
        for k in range(each + 1):
            torque, begin, duration = push(made.log, CHAIN, rng, k % 2 == 1)
            size = size_of(torque, made.log)
            absorbed = np.linalg.lstsq(design, (torque[::10] * weights).T.ravel(), rcond=None)[0]
            rest = torque - model.columns(run.q, run.qdot, run.qddot).T @ absorbed if k else 0.0 * torque
            kind = (
                "below 0.2 s" if duration < 0.2 else "longer",
                "below 10" if size < 10.0 else "10 to 20" if size < 20.0 else "above 20",
            )
            total[kind] += int(k > 0)
            for first, least in rows.items():
                notes = contact_notes(CHAIN, run.t, owners, left - rest, ("log",), least)
                right = k > 0 and any(overlaps(note, (begin, duration, size)) for note in notes)
                key = kind if right else "wrong" if k else "clean"
                found[first][key] += int(bool(notes))
    lines = [f"{logs} logs, {logs * each} pushes"]
    for first, counts in found.items():
        shares = ", ".join(f"{s}, {z}: {counts[s, z]} of {total[s, z]}" for s, z in kinds)
        lines.append(
            f"first threshold {first:g}: {sum(counts[k] for k in kinds)} found ({shares}), {counts['wrong']} "
            f"at a wrong time; {counts['clean']} of {logs} logs without a push reported"
        )
    return "\n".join(lines)


@click.command(help=__doc__.split("\n\n")[0])
@click.option("--kind", type=click.Choice(list(KINDS)), default="chain", show_default=True)
@click.option("--logs", type=click.IntRange(1), default=100, show_default=True)
@click.option("--records", type=click.Path(dir_okay=False, path_type=Path), default=RECORDS)
@click.option("--peer", "peers", type=click.Choice(list(PEERS)), multiple=True, help="Run it, too.")
@click.option("--thresholds", "vary", is_flag=True, help="Only: half and twice a threshold for contacts.")
@click.option("--summary", "only", is_flag=True, help="Run nothing.")
@single_threaded()
def main(kind: str, logs: int, records: Path, peers: tuple[str, ...], vary: bool, only: bool) -> None:
    """Run what has no record, then print the summary."""
    if vary:
        click.echo(thresholds(logs))
        return
    known = {(r["kind"], r["number"]) for r in read(records)}
    records.parent.mkdir(parents=True, exist_ok=True)
    for number in () if only else range(logs):
        if (kind, number) not in known:
            line = json.dumps(scored(kind, number, peers))
            with records.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
    for name in KINDS:
        own = [r for r in read(records) if r["kind"] == name]
        if own:
            click.echo(f"{name}: {summary(own)}")


if __name__ == "__main__":
    main()
