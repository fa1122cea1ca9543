"""Measured arms: forecasts of a driven double pendulum, and torques of an arm with a log of your own.

    python benchmarks/measured_arm.py                 # trials 3 and 12 left out
    python benchmarks/measured_arm.py --each          # every trial left out in turn, some minutes
    python benchmarks/measured_arm.py --each --form  # with the terms of the published form only
    python benchmarks/measured_arm.py --data FILE    # another machine of this kind

Free runs of 0.4 s, one after the other, begin in two ways: at the smoothed measurement, and where the model
itself follows 0.04 s before best (`model.validate`).  Root mean square errors in rad.  Beside the law that is
found stand the published numbers, and the published form fitted to free runs of 0.4 s of the same trials.

    python benchmarks/measured_arm.py --log LOG.csv --dh TABLE.csv --split 10.5

fits the part of a log before the split (in seconds) and predicts the torques of the rest, beside textbook
least squares on the same split: Butterworth filter, differences, viscous and dry friction, offsets, rotors,
weighted by joint.  The log has the columns t, q1.., v1.., tau1..; the table a, d, alpha (modified
Denavit-Hartenberg, in m and rad).  Errors in % of the torque's rms, and of its standard deviation.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction import arms
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.estimation.simulation_error import minimise_simulation_error
from leastaction.estimation.structure import Structure
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


def textbook(run: la.Trajectory, tree: arms.KinematicTree, cut: float) -> arms.ArmModel:
    """Least squares on filtered differences; ``cut`` is that of the filter, in Hz."""
    step = float(np.median(np.diff(run.t)))
    times = np.arange(run.t[0], run.t[-1], step)
    low = butter(4, 2.0 * cut * step, output="sos")

    def filtered(values: np.ndarray) -> np.ndarray:
        even = np.stack([np.interp(times, run.t, column) for column in values.T], axis=1)
        return sosfiltfilt(low, even, axis=0)

    q, torques = filtered(run.q), filtered(run.forces)
    qdot = np.gradient(q, step, axis=0)
    inside = slice(round(0.3 / step), -round(0.3 / step), max(1, round(0.005 / step)))
    states = [a[inside] for a in (q, qdot, np.gradient(qdot, step, axis=0))]
    n = len(tree)
    unit = dict.fromkeys(("rotor", "offset", "viscous", "dry"), np.ones(n))
    like = arms.ArmModel.of_tree(tree.with_inertias(np.ones((n, 10))), unit, width=1e-2)
    columns = like.columns(*states)
    design, target = columns.reshape(len(columns), -1).T, torques[inside].T.ravel()
    weights = np.ones(n)
    for _ in range(3):
        rows = np.repeat(weights, len(states[0]))
        scale = np.linalg.norm(rows[:, None] * design, axis=0)
        values = np.linalg.lstsq(rows[:, None] * design / scale, rows * target, rcond=1e-9)[0] / scale
        weights = 1.0 / (target - design @ values).reshape(n, -1).std(axis=1)
    return arms.ArmModel(tree, like.base, values, np.eye(values.size), like.reference, like.facts)


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
    found = arms.identify(first, tree)
    models = {f"textbook, {cut:g} Hz": textbook(first, tree, cut) for cut in (3.0, 5.0, 10.0)}
    models |= {"identify": found, "identify, bodies": found.bodies()}
    for name, model in models.items():
        errors = model.validate(rest)
        click.echo(f"{name}\n{errors}\nof the standard deviation: {(100 * errors.of_spread).round(2)} %")


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
