"""Where is the minimum of the paper's loss, and does Adam get there?

    python -m benchmarks.paper loss --noise 0.1
    python -m benchmarks.paper minimum --noise 0.1

``loss``, for each system: the loss J where Adam ends, with the settings of the tables, and the smallest J
that the true terms allow, found by Gauss–Newton from the exact motion on the same spline grid; and the ℓ2
error of the coefficients at both.  Where J is smaller at the second, neither the loss nor the library is to
blame: the descent has not arrived.

``minimum``, over all candidates, for each system, weight γ of the equations and density of knots: the ℓ2
error of the coefficients at the minimum of J that Gauss–Newton reaches from where Adam begins (smoothing
spline, regression along it), from the exact motion with the true coefficients, and with the true terms alone;
nothing is thresholded.  The penalty on accelerations, which J hardly weighs, is left out.  Where the first
two are near the law, the loss leads there and a descent that ends elsewhere has not arrived.
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
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.gauss_newton import JointFit, fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics, Weights
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points
from reproduction.methods.adam import discover, settings_for
from reproduction.problem import Case, Problem, pose

RESULTS = Path(__file__).parent / "results"
DEGREE = 3
TOLERANCE, MOST_STEPS = 1e-4, 200


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


def minima(case: Case, physics_weight: float, finer: float) -> dict:
    """ℓ2 error and J at the minima reached from Adam's start, from the truth, and with the true terms."""
    problem = pose(case)
    request = Request(problem.library, problem.known, degree=DEGREE, robust=False)
    setup = build_problem(problem.data, request)
    per_second = finer * setup.scales.per_second
    grid = Grid.lay(setup.problem, per_second)
    columns, true, free = grid.problem.candidates, _true(problem, grid), ~grid.problem.is_known
    noisy = grid.smooth().control_points
    exact = smooth(grid.spline, grid.times, [m.q for m in problem.truth]).control_points
    samples, duration = len(np.concatenate(grid.times)), float(grid.spline.weights.sum())
    forces = None if grid.forces is None else grid.forces.values
    n = problem.data.n_dof
    weights = Weights(np.ones(n), np.full(n, physics_weight * samples / duration), np.zeros(n))

    def outcome(points: np.ndarray, start: np.ndarray, keep: np.ndarray) -> dict:
        physics = Physics(columns.subset(np.flatnonzero(keep).tolist()), free[keep], forces)
        fit: JointFit = fit_joint(
            grid.observations,
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
        "from_start": outcome(noisy, _regression(grid, noisy), everything),
        "from_truth": outcome(exact, true, everything),
        "true_terms": outcome(exact, true, (true != 0.0) | ~free),
    }


def _true(problem: Problem, grid: Grid) -> np.ndarray:
    """True coefficients of all columns."""
    places = {problem.library.index(term.text): k for k, term in enumerate(grid.problem.terms)}
    out = np.zeros(len(grid.problem.terms))
    for text, value in problem.true_coefficients.items():
        out[places[problem.library.index(text)]] = value
    return out


def _regression(grid: Grid, control_points: np.ndarray) -> np.ndarray:
    """Free coefficients by least squares along a curve, known ones in place."""
    known, states = grid.problem.known, grid.spline.at_quadrature(control_points)
    strong = grid.problem.candidates.strong(Points(*(s[:, 0] for s in states)))
    free = np.isnan(known)
    target = 0.0 if grid.forces is None else grid.forces.values[:, 0].T
    target = target - np.tensordot(known[~free], strong[~free], 1)
    out = np.where(free, 0.0, known)
    rows = strong[free].reshape(free.sum(), -1).T
    out[free] = np.linalg.lstsq(rows, np.broadcast_to(target, strong.shape[1:]).ravel(), rcond=None)[0]
    return out


@click.group()
def main() -> None:
    """Say where the minimum of the paper's loss is."""


@main.command()
@click.option("--system", "names", multiple=True, help="Default: all seven.")
@click.option("--noise", "levels", multiple=True, type=float, default=(0.1,), show_default=True)
@click.option("--results", type=click.Path(path_type=Path), default=RESULTS / "paper_loss")
def loss(names, levels, results: Path) -> None:
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


@main.command()
@click.option("--system", "names", multiple=True, help="Default: all seven.")
@click.option("--noise", "levels", multiple=True, type=float, default=(0.01, 0.1), show_default=True)
@click.option("--physics-weight", "gammas", multiple=True, type=float, default=(0.1, 1.0, 10.0))
@click.option("--finer", multiple=True, type=float, default=(1.0, 2.0), help="Times the default knots.")
@click.option("--trial", default=0, show_default=True, help="Number of the data set.")
@click.option("--results", type=click.Path(path_type=Path), default=RESULTS / "paper_minimum")
def minimum(names, levels, gammas, finer, trial: int, results: Path) -> None:
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
