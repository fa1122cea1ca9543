"""Where is the minimum of the paper's loss, and does Adam get there?

    python -m benchmarks.paper_loss --noise 0.1

For each system: the loss J where Adam ends, with the settings of the tables, and the smallest J that the
true terms allow, found by Gauss–Newton from the exact motion on the same spline grid; and the ℓ2 error of the
coefficients at both.  Where J is smaller at the second, neither the loss nor the library is to blame: the
descent has not arrived.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

import leastaction as la
from leastaction import systems
from leastaction.curve.smoothing import smooth
from leastaction.estimation import problem as estimation
from leastaction.estimation.adam import AdamProblem
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights
from leastaction.mechanics.euler_lagrange import EulerLagrange
from reproduction.methods.adam import discover, settings_for
from reproduction.problem import Case, Problem, pose

RESULTS = Path(__file__).parent / "results" / "paper_loss"


def compare(case: Case) -> dict:
    """J and ℓ2 where Adam ends, and at the minimum that the true terms allow."""
    problem = pose(case)
    options = settings_for(problem)
    ends: list[dict] = []
    model = discover(problem, options, lambda _, details: ends.append(details) if "loss" in details else None)
    found = {problem.library[problem.library.index(t.expression)].text: t.coefficient for t in model.terms}
    loss, minimum = _minimum(problem, model, options)

    def error(coefficients: dict[str, float]) -> float:
        return la.metrics.l2_error(coefficients, problem.true_coefficients, exclude=list(problem.known))

    return {
        **case.as_dict(),
        "loss_adam": ends[-1]["loss"],
        "l2_adam": error(found),
        "loss_minimum": loss,
        "l2_minimum": error(minimum),
        "physics_weight": options.physics_weight,
    }


def _minimum(problem: Problem, model, options: la.AdamOptions) -> tuple[float, dict[str, float]]:
    """Gauss–Newton on J over curve and true terms; curvature, which J hardly weighs, in the value only."""
    true, data = problem.true_coefficients, model.diagnostics.trajectories
    terms = [problem.library[problem.library.index(name)] for name in true]
    columns = EulerLagrange(terms, problem.library.coordinates)
    known = np.array([problem.known.get(name, np.nan) for name in true])
    knots, degree = model.provenance["knots_per_second"], model.diagnostics.grid.degree
    grid = Grid.lay(estimation.Problem(data, columns, known, degree), knots)
    exact = smooth(grid.spline, grid.times, [m.q for m in problem.truth])
    samples, duration = len(np.concatenate(grid.times)), float(grid.spline.weights.sum())
    ratio = options.physics_weight / duration / (options.data_weight / samples)
    n = data.n_dof
    weights = Weights(np.ones(n), np.full(n, ratio), np.zeros(n))
    physics = Physics(columns, np.isnan(known), None if grid.forces is None else grid.forces.values)
    start = np.array(list(true.values()))
    fit = fit_joint(
        grid.observations, physics, weights, exact.control_points, start, tolerance=1e-6, max_steps=100
    )
    rng = np.random.default_rng(problem.case.seed)
    force = grid.force_at if grid.forces is not None else None
    values = [trajectory.q for trajectory in data]
    loss = AdamProblem(grid.spline, grid.times, values, replace(physics, forces=None), force, options, rng)
    value = loss.loss(fit.control_points, fit.coefficients)
    return value, dict(zip(true, fit.coefficients.tolist(), strict=True))


@click.command()
@click.option("--system", "names", multiple=True, help="Default: all seven.")
@click.option("--noise", "levels", multiple=True, type=float, default=(0.1,), show_default=True)
@click.option("--results", type=click.Path(path_type=Path), default=RESULTS)
def main(names, levels, results: Path) -> None:
    """Compare what has not been compared, and print it."""
    for noise in levels:
        for name in names or systems.names():
            case = Case(name, noise, "adam")
            path = results / f"{case.key}.json"
            if not path.exists():
                la.io.write_text(path, json.dumps(compare(case), indent=1) + "\n")
            r = json.loads(path.read_text())
            click.echo(
                f"{name} {noise:g}: Adam ends at J {r['loss_adam']:.4g} (l2 {r['l2_adam']:.3g}); the true "
                f"terms allow {r['loss_minimum']:.4g} (l2 {r['l2_minimum']:.3g})"
            )


if __name__ == "__main__":
    main()
