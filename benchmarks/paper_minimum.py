"""Where is the minimum of the paper's loss, over all candidates?

    python -m benchmarks.paper_minimum --noise 0.1

For each system, weight γ of the equations and density of knots: the ℓ2 error of the coefficients at the
minimum of J that Gauss–Newton reaches from where Adam begins (smoothing spline, regression along it), from
the exact motion with the true coefficients, and with the true terms alone; nothing is thresholded.  The
penalty on accelerations, which J hardly weighs, is left out.  Where the first two are near the law, the loss
leads there and a descent that ends elsewhere has not arrived.
"""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np

import leastaction as la
from leastaction import systems
from leastaction.curve.smoothing import smooth
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.workspace import Workspace
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points
from leastaction.selection.prepare import prepare
from reproduction.problem import Case, Problem, pose

RESULTS = Path(__file__).parent / "results" / "paper_minimum"
DEGREE = 3
TOLERANCE, MOST_STEPS = 1e-4, 200


def minima(case: Case, physics_weight: float, finer: float) -> dict:
    """ℓ2 error and J at the minima reached from Adam's start, from the truth, and with the true terms."""
    problem = pose(case)
    prepared = prepare(problem.data, problem.library, problem.known, (), None, DEGREE, None, (), False)
    columns = EulerLagrange(prepared.columns, prepared.library.coordinates)
    per_second = finer * prepared.knots.per_second
    space = Workspace(prepared.trajectories, columns, prepared.known, per_second, DEGREE)
    true, free = _true(problem, space), np.isnan(space.known)
    noisy = smooth(space.grid, space.times, space.values).control_points
    exact = smooth(space.grid, space.times, [m.q for m in problem.truth]).control_points
    samples, duration = len(np.concatenate(space.times)), float(space.grid.weights.sum())
    n = problem.data.n_dof
    weights = Weights(np.ones(n), np.full(n, physics_weight * samples / duration), np.zeros(n))

    def outcome(points: np.ndarray, start: np.ndarray, keep: np.ndarray) -> dict:
        physics = Physics(columns.subset(np.flatnonzero(keep).tolist()), free[keep], space.forces)
        fit: JointFit = fit_joint(
            space.observations,
            physics,
            weights,
            points,
            start[keep],
            tolerance=TOLERANCE,
            max_steps=MOST_STEPS,
        )
        off = (fit.coefficients - true[keep])[free[keep]]
        size = np.linalg.norm(true[free])
        loss = fit.linearisation.cost(weights) / samples
        return {"l2": float(np.linalg.norm(off) / size), "loss": loss, "status": fit.status}

    everything = np.ones(free.size, dtype=bool)
    return {
        **case.as_dict(),
        "physics_weight": physics_weight,
        "knots_per_second": per_second,
        "from_start": outcome(noisy, _regression(space, noisy), everything),
        "from_truth": outcome(exact, true, everything),
        "true_terms": outcome(exact, true, (true != 0.0) | ~free),
    }


def _true(problem: Problem, space: Workspace) -> np.ndarray:
    """True coefficients of all columns."""
    places = {problem.library.index(term.text): k for k, term in enumerate(space.columns.terms)}
    out = np.zeros(len(space.columns))
    for text, value in problem.true_coefficients.items():
        out[places[problem.library.index(text)]] = value
    return out


def _regression(space: Workspace, control_points: np.ndarray) -> np.ndarray:
    """Free coefficients by least squares along a curve, known ones in place."""
    states = space.grid.at_quadrature(control_points)
    strong = space.columns.strong(Points(*(s[:, 0] for s in states)))
    free = np.isnan(space.known)
    target = 0.0 if space.forces is None else space.forces[:, 0].T
    target = target - np.tensordot(space.known[~free], strong[~free], 1)
    out = np.where(free, 0.0, space.known)
    rows = strong[free].reshape(free.sum(), -1).T
    out[free] = np.linalg.lstsq(rows, np.broadcast_to(target, strong.shape[1:]).ravel(), rcond=None)[0]
    return out


@click.command()
@click.option("--system", "names", multiple=True, help="Default: all seven.")
@click.option("--noise", "levels", multiple=True, type=float, default=(0.01, 0.1), show_default=True)
@click.option("--physics-weight", "gammas", multiple=True, type=float, default=(0.1, 1.0, 10.0))
@click.option("--finer", multiple=True, type=float, default=(1.0, 2.0), help="Times the default knots.")
@click.option("--trial", default=0, show_default=True, help="Number of the data set.")
@click.option("--results", type=click.Path(path_type=Path), default=RESULTS)
def main(names, levels, gammas, finer, trial: int, results: Path) -> None:
    """Compute what has not been computed, and print it."""
    grid = [(s, n, f, g) for n in levels for s in names or systems.names() for f in finer for g in gammas]
    for name, noise, factor, gamma in grid:
        case = Case(name, noise, "adam", trial=trial)
        path = results / f"{name}-{noise:g}-{factor:g}-{gamma:g}-trial{trial}.json"
        if not path.exists():
            la.io.write_text(path, json.dumps(minima(case, gamma, factor), indent=1) + "\n")
        r = json.loads(path.read_text())
        l2 = ", ".join(
            f"{k.replace('_', ' ')} {r[k]['l2']:.4f}" for k in ("from_start", "from_truth", "true_terms")
        )
        click.echo(f"{name} {noise:g}, {factor:g} x knots, gamma {gamma:g}: l2 {l2}")


if __name__ == "__main__":
    main()
