"""Forecasts of the measured driven double pendulum: found against published, on trials left out.

    python benchmarks/measured_arm.py                 # trials 3 and 12 left out
    python benchmarks/measured_arm.py --each          # every trial left out in turn, some minutes

Free runs of 0.4 s, one after the other, begin in two ways: at the smoothed measurement, and where the model
itself follows 0.04 s before best (`model.validate`).  Root mean square errors in rad.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

import leastaction as la

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

    def terms(values: dict[str, float]) -> list[dict]:
        return [
            {"expression": e, "coefficient": c, "standard_error": 0.0, "known": True}
            for e, c in values.items()
        ]

    parts = {"terms": terms(PUBLISHED), "dissipation": terms(PUBLISHED_FRICTION), "covariance": []}
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


def compare(data: la.Trajectories, left_out: list[str]) -> dict[tuple[str, str], np.ndarray]:
    """Fit the other trials; squared errors of each model and each way to begin."""
    kept = data.select([name for name in data.names if name not in left_out])
    held = data.select(left_out)
    library = la.Library.mechanical(data.coordinates, data.coordinates, size="compact")
    found = la.discover(kept, library, dissipation=FRICTION)
    click.echo(found.format_table())
    out = {}
    for name, model in (("found", found), ("published", published(found))):
        traces = model.validate(held, horizon=HORIZON, window=WINDOW).traces
        out[name, "smoothed"] = from_smoothed(model, held)
        out[name, "validate"] = np.array([trace.rms for trace in traces]) ** 2
        for way in ("smoothed", "validate"):
            errors = np.sqrt(out[name, way].mean(axis=0))
            click.echo(f"{','.join(left_out)} left out, {name}, {way}: {errors.round(4).tolist()}")
    return out


@click.command()
@click.option("--each", is_flag=True, help="Leave out every trial in turn.")
def main(each: bool) -> None:
    """Print the errors."""
    forces = {"q1": "tau1", "q2": "tau2"}
    data = la.read_csv(PATH, coordinates=["q1", "q2"], time="t", forces=forces, trial="trial")
    folds = [compare(data, [name]) for name in data.names] if each else [compare(data, ["3", "12"])]
    for key in folds[0]:
        means = np.mean([np.sqrt(fold[key].mean(axis=0)) for fold in folds], axis=0)
        click.echo(f"mean over {len(folds)} choices, {', '.join(key)}: {means.round(4).tolist()}")


if __name__ == "__main__":
    main()
