"""Measured arms: forecasts of a driven double pendulum, and torques of an arm with a log of your own.

    python benchmarks/measured_arm.py                 # trials 3 and 12 left out
    python benchmarks/measured_arm.py --each          # every trial left out in turn, some minutes
    python benchmarks/measured_arm.py --each --form  # with the terms of the published form only
    python benchmarks/measured_arm.py --data FILE    # another machine of this kind

Free runs of 0.4 s, one after the other, begin in two ways: at the smoothed measurement, and where the model
itself follows 0.04 s before best (`model.validate`).  Root mean square errors in rad.  Beside the law that is
found stand the published numbers, and the published form fitted to free runs of 0.4 s of the same trials.

    python benchmarks/measured_arm.py --log LOG.csv --dh TABLE.csv --split 10.5

fits the part of a log before the split (in seconds) and predicts the torques of the rest, beside `PEERS` on
the same split.  The log has the columns t, q1.., v1.., tau1..; the table a, d, alpha (modified
Denavit-Hartenberg, in m and rad).  Errors in % of the torque's rms and of its standard deviation, and of free
runs of 0.5 s.

All peers but MuJoCo use angles behind a Butterworth filter and their differences.  Weights are by joint.
*Instrumental variables*: the regressor along a motion that MuJoCo simulates with the last estimate.  It
follows the filtered log under a controller of ours, because logs hold no commands; Janot, Vandanjon & Gautier
2014 (IEEE Transactions on Control Systems Technology 22:132) use that of the robot.  *FIGAROH*: its
regressor, QR decomposition and weighted least squares.  *MuJoCo*: `mujoco.sysid` on free runs of 0.25 s, from
the bodies of least squares.  The last three need the packages mujoco, figaroh and pin.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction import arms
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Structure
from leastaction.estimation.simulation_error import minimise_simulation_error
from leastaction.threads import single_threaded

PATH = Path(__file__).parents[1] / "examples" / "data" / "driven_double_pendulum.csv.gz"
HORIZON, WINDOW = 0.4, 0.04
FRICTION = ("q1_dot**2/2", "q2_dot**2/2", "abs(q1_dot)", "abs(q2_dot)")
PUBLISHED = {
    "q1_dot**2": 0.0673,
    "q1_dot**2*cos(q2)": 0.0333,
    "q1_dot*q2_dot": 0.0235,
    "q1_dot*q2_dot*cos(q2)": 0.0333,
    "q2_dot**2": 0.01335,
    "cos(q1)": 3.4248,
    "cos(q1+q2)": 1.0895,
}
PUBLISHED_FRICTION = {"sqrt(q1_dot**2 + 1/2500)": 0.146, "sqrt(q2_dot**2 + 9/2500)": 0.1225}


def published(like: la.LagrangianModel) -> la.LagrangianModel:
    """The published law, as a model."""
    return model_of(like, PUBLISHED, PUBLISHED_FRICTION)


def fitted_to_free_runs(like: la.LagrangianModel, kept: la.Trajectories) -> la.LagrangianModel:
    """The published form with the numbers whose free runs stay nearest to the smoothed measurements."""
    setup = build_problem(kept, Request(la.Library(PUBLISHED, kept.coordinates), {}, FRICTION[2:]))
    texts = [term.text for term in setup.problem.terms]
    sizes = [*PUBLISHED.values(), *PUBLISHED_FRICTION.values()]
    grid = Grid.lay(setup.searched, setup.scales.per_second)
    structure = Structure(range(len(texts)))
    found = minimise_simulation_error(grid, setup.scales.smooth, structure, np.array(sizes), HORIZON)
    assert found is not None
    values, n = dict(zip(texts, found.estimates.tolist(), strict=True)), len(PUBLISHED)
    return model_of(like, {t: values[t] for t in texts[:n]}, {t: values[t] for t in texts[n:]})


def model_of(
    like: la.LagrangianModel, law: dict[str, float], friction: dict[str, float]
) -> la.LagrangianModel:
    """Given numbers, as a model."""

    def terms(values: dict[str, float]) -> list[dict]:
        return [
            {"expression": e, "coefficient": c, "standard_error": 0.0, "known": True}
            for e, c in values.items()
        ]

    parts = {"terms": terms(law), "dissipation": terms(friction), "covariance": []}
    return la.LagrangianModel.from_dict({**like.to_dict(), **parts})


def from_smoothed(model: la.LagrangianModel, data: la.Trajectories) -> np.ndarray:
    """Squared errors, (n_runs, n_dof), of free runs that begin at the smoothed measurement."""
    out = []
    for trajectory, motion in zip(data, la.smooth(data), strict=True):
        steps = round(HORIZON / float(np.median(np.diff(trajectory.t))))
        begin = int(np.searchsorted(trajectory.t, trajectory.t[0] + WINDOW))
        for k in range(begin, trajectory.n_times - steps, steps):
            rows = slice(k, k + steps + 1)
            run = model.simulate(
                motion.q[k], motion.qdot[k], trajectory.t[rows], trajectory.forces[rows], rtol=1e-6, atol=1e-8
            )
            out.append(np.mean((run.q - trajectory.q[rows]) ** 2, axis=0))
    return np.array(out)


def compare(data: la.Trajectories, left_out: list[str], form: bool) -> dict[tuple[str, str], np.ndarray]:
    """Fit the other trials; squared errors of each model and each way to begin."""
    kept = data.select([name for name in data.names if name not in left_out])
    held = data.select(left_out)
    library = la.Library.mechanical(data.coordinates, data.coordinates, size="compact")
    library = library.replace(terms=PUBLISHED) if form else library
    found = la.discover(kept, library, dissipation=FRICTION)
    click.echo(found.format_table())
    out = {}
    models = {"found": found, "published": published(found), "free runs": fitted_to_free_runs(found, kept)}
    for name, model in models.items():
        traces = model.validate(held, horizon=HORIZON, window=WINDOW).traces
        out[name, "smoothed"] = from_smoothed(model, held)
        out[name, "validate"] = np.array([trace.rms for trace in traces]) ** 2
        for way in ("smoothed", "validate"):
            errors = np.sqrt(out[name, way].mean(axis=0))
            click.echo(f"{','.join(left_out)} left out, {name}, {way}: {errors.round(4).tolist()}")
    return out


def filtered(run: la.Trajectory, cut: float) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Times, q, q̇, q̈ and torques behind a filter of ``cut`` Hz, (n_times, n_dof) each, every 5 ms."""
    step = float(np.median(np.diff(run.t)))
    times = np.arange(run.t[0], run.t[-1], step)
    low = butter(4, 2.0 * cut * step, output="sos")
    q, torques = (
        sosfiltfilt(low, np.stack([np.interp(times, run.t, column) for column in values.T], 1), axis=0)
        for values in (run.q, run.forces)
    )
    qdot = np.gradient(q, step, axis=0)
    inside = slice(round(0.3 / step), -round(0.3 / step), max(1, round(0.005 / step)))
    states = [a[inside] for a in (q, qdot, np.gradient(qdot, step, axis=0))]
    return times[inside], states, torques[inside]


def like(tree: arms.KinematicTree, width: float = 1e-2) -> arms.ArmModel:
    """A model with the parameters of the textbook, whatever their values."""
    n = len(tree)
    unit = dict.fromkeys(("rotor", "offset", "viscous", "dry"), np.ones(n))
    return arms.ArmModel.of_tree(tree.with_inertias(np.ones((n, 10))), unit, width=width)


def solved(
    tree: arms.KinematicTree,
    states: list[np.ndarray],
    torques: np.ndarray,
    instruments: list[np.ndarray] | None = None,
    rounds: int = 4,
) -> arms.ArmModel:
    """Least squares, or instrumental variables; more than one round weights by the errors of each joint."""
    model, n = like(tree), len(tree)
    columns = model.columns(*states)
    design, target = columns.reshape(len(columns), -1).T, torques.T.ravel()
    other = design if instruments is None else model.columns(*instruments).reshape(len(columns), -1).T
    weights, scale = np.ones(n), np.linalg.norm(other, axis=0)
    for _ in range(rounds):
        rows = np.repeat(weights, len(states[0]))[:, None] ** 2
        normal = (other / scale).T @ (rows * design / scale)
        inverse = np.linalg.pinv(normal, rcond=1e-14)
        values = inverse @ ((other / scale).T @ (rows[:, 0] * target)) / scale
        weights = 1.0 / (target - design @ values).reshape(n, -1).std(axis=1)
    covariance = inverse / np.outer(scale, scale)
    covariance = (covariance + covariance.T) / 2.0
    return arms.ArmModel(tree, model.base, values, covariance, model.reference, model.facts)


def followed(model: arms.ArmModel, times: np.ndarray, states: list[np.ndarray]) -> list[np.ndarray]:
    """q, q̇ and q̈ of a simulation of the model that follows a motion."""
    import mujoco

    with TemporaryDirectory() as folder:
        model.to_mjcf(Path(folder) / "arm.xml")
        simulated = mujoco.MjModel.from_xml_path(str(Path(folder) / "arm.xml"))
    simulated.opt.timestep = float(times[1] - times[0]) / 5.0
    simulated.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    simulated.jnt_limited[:] = 0
    simulated.jnt_actfrclimited[:] = 0
    data = mujoco.MjData(simulated)
    simulated.dof_damping[:] = np.maximum(simulated.dof_damping, 0.0)
    simulated.dof_frictionloss[:] = np.maximum(simulated.dof_frictionloss, 0.0)
    masses, forward = model.mass_matrix(states[0]), model.torques(*states)
    out = np.empty((3, *states[0].shape))
    data.qpos[:], data.qvel[:] = states[0][0], states[1][0]
    for k in range(len(times)):
        error, rate = states[0][k] - data.qpos, states[1][k] - data.qvel
        data.qfrc_applied[:] = forward[k] + masses[k] @ (400.0 * error + 40.0 * rate)
        mujoco.mj_forward(simulated, data)
        out[:, k] = data.qpos, data.qvel, data.qacc
        mujoco.mj_step(simulated, data, 5)
    return list(out)


def textbook(run: la.Trajectory, tree: arms.KinematicTree, cut: float, rounds: int = 4) -> arms.ArmModel:
    """Weighted least squares; ordinary with one round."""
    return solved(tree, *filtered(run, cut)[1:], rounds=rounds)


def instrumental(run: la.Trajectory, tree: arms.KinematicTree, cut: float) -> arms.ArmModel:
    """Instrumental variables, three rounds of simulation."""
    times, states, torques = filtered(run, cut)
    model = solved(tree, states, torques)
    for _ in range(3):
        model = solved(tree, states, torques, followed(model.bodies(), times, states))
    return model


def figaroh(run: la.Trajectory, tree: arms.KinematicTree, cut: float) -> arms.ArmModel:
    """The weighted least squares of FIGAROH, written in our base parameters."""
    import pinocchio
    from figaroh.identification.identification_tools import weigthed_least_squares
    from figaroh.tools.qrdecomposition import get_baseParams
    from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate

    n, arm = len(tree), pinocchio.Model()
    arm.gravity.linear = tree.gravity
    for joint in tree.joints:
        place = pinocchio.SE3(joint.rotation, joint.origin)
        moves = pinocchio.JointModelRevoluteUnaligned(joint.axis)
        arm.addJoint(joint.parent + 1, moves, place, joint.name)
    robot = pinocchio.RobotWrapper(arm)
    config = dict.fromkeys(("has_friction", "has_actuator_inertia", "has_joint_offset"), True)
    config["act_idxv"] = range(n)
    _, states, torques = filtered(run, cut)
    kept = slice(None, None, 4)  # its weights are a dense matrix
    whole = build_regressor_basic(robot, *(a[kept] for a in states), config)
    without, left = get_index_eliminate(whole, {str(k): 0.0 for k in range(whole.shape[1])})
    reduced = build_regressor_reduced(whole, without)
    _, _, base = get_baseParams(reduced, left)
    design, target = reduced[:, base], torques[kept].T.ravel()
    first = np.linalg.lstsq(design, target, rcond=None)[0]
    config["idx_tau_stop"] = len(torques[kept]) * np.arange(1, n + 1)
    values = weigthed_least_squares(robot, first, design, target, design @ first, config)
    rng = np.random.default_rng(0)
    some = list(rng.uniform(0.5, 3.0, (3, 400, n)) * rng.choice([-1.0, 1.0], (3, 400, n)))
    there = build_regressor_reduced(build_regressor_basic(robot, *some, config), without)[:, base]
    ours = like(tree, width=1e-7).columns(*some)
    found = np.linalg.lstsq(ours.reshape(len(ours), -1).T, there @ values, rcond=None)[0]
    model = like(tree)
    return arms.ArmModel(tree, model.base, found, 0.0 * model.covariance, model.reference, model.facts)


def sysid(run: la.Trajectory, tree: arms.KinematicTree, cut: float) -> arms.ArmModel:
    """MuJoCo's system identification: bodies, rotors, friction and offsets that free runs follow best."""
    import mujoco
    from mujoco import sysid as m

    begin = textbook(run, tree, cut).bodies()
    with TemporaryDirectory() as folder:
        begin.to_mjcf(Path(folder) / "arm.xml")
        spec = mujoco.MjSpec.from_file(str(Path(folder) / "arm.xml"))
    spec.option.timestep, spec.option.integrator = 2e-3, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint in spec.joints:
        joint.solref_friction[:2] = 4e-3, 1.0
        joint.limited = joint.actfrclimited = False
        motor = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        sensor = spec.add_sensor(name=f"{joint.name}_at", type=mujoco.mjtSensor.mjSENS_JOINTPOS)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_JOINT, joint.name
    model, free = spec.compile(), m.ParameterDict()
    for body, name in zip(tree.links, tree.coordinates, strict=True):
        free.add(m.body_inertia_param(spec, model, body, m.InertiaType.Pseudo, modifier=_body(body)))
        for place in PLACES.values():
            start = max(float(np.ravel(getattr(spec.joint(name), place))[0]), 1e-3)
            change = _joint(name, place)
            free.add(m.Parameter(f"{place} {name}", start, 0.0, 10.0 * start + 0.1, modifier=change))
        free.add(m.Parameter(f"offset {name}", 0.0, -9.0, 9.0, modifier=_joint(name, "")))
    (times, states, _), length, sequences = filtered(run, 20.0), 0.25, []
    for t in np.arange(times[0], times[-1] - length, length).tolist():
        k = int(np.searchsorted(times, t))
        rows = (run.t >= times[k]) & (run.t <= times[k] + length)
        own, state = run.t[rows] - times[k], m.create_initial_state(model, states[0][k], states[1][k])
        control = m.TimeSeries(own, run.forces[rows])
        seen = m.TimeSeries.from_names(own, run.q[rows], model)
        sequences.append(m.ModelSequences("arm", spec, f"{t:g}", state, control, seen))
    found, _ = m.optimize(
        free, m.build_residual_fn(models_sequences=sequences), verbose=False, max_iters=ITERATIONS
    )
    solid = m.apply_param_modifiers_spec(found, spec)
    solid.compile()
    with TemporaryDirectory() as folder:
        (Path(folder) / "arm.xml").write_text(solid.to_xml())
        links = arms.read_mjcf(Path(folder) / "arm.xml").inertias
    values = {
        kind: [found[f"{place} {name}"].value[0] for name in tree.coordinates]
        for kind, place in {**PLACES, "offset": "offset"}.items()
    }
    return arms.ArmModel.of_tree(tree.with_inertias(links), values, width=1e-2)


def _body(name: str) -> Callable[[Any, Any], None]:
    """What `sysid` does with the log-Cholesky parameters of a body; its own way fails without geoms."""
    import mujoco
    from mujoco.sysid import model_modifier

    def change(spec: Any, parameter: Any) -> None:
        row, body, quaternion = model_modifier.pi_from_theta(parameter.value), spec.body(name), np.empty(4)
        centre, about = row[1:4] / row[0], row[4:].reshape(3, 3)
        about = about - row[0] * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        sizes, axes = np.linalg.eigh(about)
        mujoco.mju_mat2Quat(quaternion, (axes * np.sign(np.linalg.det(axes))).ravel())
        body.mass, body.ipos, body.inertia, body.iquat = row[0], centre, sizes, quaternion
        body.fullinertia = np.full(6, np.nan)

    return change


def _joint(name: str, place: str) -> Callable[[Any, Any], None]:
    """How a parameter of a joint changes the model of `sysid`; a constant torque acts in the motor."""

    def change(spec: Any, parameter: Any) -> None:
        value = float(parameter.value[0])
        if not place:
            spec.actuator(name).biasprm[0] = -value
        else:
            setattr(spec.joint(name), place, [value, 0.0, 0.0] if place == "damping" else value)

    return change


PLACES = {"rotor": "armature", "viscous": "damping", "dry": "frictionloss"}
ITERATIONS = 8  # of `sysid`
PEERS: dict[str, Callable[[la.Trajectory, arms.KinematicTree, float], arms.ArmModel]] = {
    "ordinary least squares": partial(textbook, rounds=1),
    "weighted least squares": textbook,
    "instrumental variables": instrumental,
    "FIGAROH": figaroh,
    "MuJoCo sysid": sysid,
}


def predict(log: str, table: str, split: float) -> None:
    """Fit the first part of a log, predict the rest."""
    rows = np.atleast_1d(np.genfromtxt(table, delimiter=",", names=True))
    tree = arms.KinematicTree.from_dh(
        [{key: float(row[key]) for key in ("a", "d", "alpha")} for row in rows], modified=True
    )
    data = np.genfromtxt(log, delimiter=",", names=True)
    q, v, tau = (
        np.stack([data[f"{name}{i + 1}"] for i in range(len(tree))], 1) for name in ("q", "v", "tau")
    )
    run = la.Trajectory(data["t"], q, tau, tree.coordinates, velocities=v)
    first, rest = run.rows(run.t < split), run.rows(run.t >= split)
    ways = {f"{name}, {cut:g} Hz": (peer, cut) for cut in (5.0, 10.0) for name, peer in PEERS.items()}
    del ways["MuJoCo sysid, 10 Hz"]  # the filter makes its start only
    for name, way in {"identify": None, **ways}.items():
        began = time.process_time()
        try:
            found = arms.identify(first, tree) if way is None else way[0](first, tree, way[1])
        except ImportError as error:
            click.echo(f"{name}: not run, {error}")
            continue
        seconds = time.process_time() - began
        models = {name: found} | ({f"{name}, bodies": found.bodies()} if found.covariance.any() else {})
        for label, model in models.items():
            errors = model.validate(rest)
            click.echo(f"{label}, {seconds:.1f} s\n{errors}\n{model.free_runs(rest)}")
            click.echo(f"of the standard deviation: {(100 * errors.of_spread).round(2)} %")


@click.command()
@click.option("--each", is_flag=True, help="Leave out every trial in turn.")
@click.option("--form", is_flag=True, help="Offer the terms of the published form only.")
@click.option("--data", "path", default=str(PATH), help="Recordings of the double pendulum.")
@click.option("--every", default=1, help="Take every so-and-so-many-th sample.")
@click.option("--log", help="Torque log of an arm, instead of the double pendulum.")
@click.option("--dh", help="Its Denavit-Hartenberg table.")
@click.option("--split", default=10.0, help="Seconds of the log that are fitted.")
@single_threaded()
def main(
    each: bool, form: bool, path: str, every: int, log: str | None, dh: str | None, split: float
) -> None:
    """Print the errors."""
    if log is not None and dh is not None:
        predict(log, dh, split)
        return
    forces = {"q1": "tau1", "q2": "tau2"}
    data = la.read_csv(path, coordinates=["q1", "q2"], time="t", forces=forces, trial="trial")
    data = la.Trajectories([t.rows(np.arange(t.n_times) % every == 0) for t in data])
    left_out = [[name] for name in data.names] if each else [["3", "12"]]
    folds = [compare(data, names, form) for names in left_out]
    for key in folds[0]:
        means = np.mean([np.sqrt(fold[key].mean(axis=0)) for fold in folds], axis=0)
        click.echo(f"mean over {len(folds)} choices, {', '.join(key)}: {means.round(4).tolist()}")


if __name__ == "__main__":
    main()
