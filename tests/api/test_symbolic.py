"""Discovery from the names of the coordinates alone."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

import leastaction as la
from helpers import findings_of
from leastaction import systems
from leastaction.cli import program


@pytest.mark.parametrize("name", ["single_pendulum", "cart_spring_pendulum"])
def test_the_law_is_found_from_names_alone(name, tmp_path):
    system = systems.get(name)
    data = systems.generate(name, noise=0.02, trials=2, duration=10.0, seed=4)
    library = la.Library.symbolic(system.coordinates, system.angles)
    model = la.discover(data, library, known=system.known)
    assert {term.expression for term in model.terms} == {
        library[library.index(text)].text for text in system.lagrangian
    }
    truth = {library.index(text): value for text, value in system.lagrangian.items()}
    for term in model.terms:
        error = 4.5 * term.standard_error
        assert term.coefficient == pytest.approx(truth[library.index(term.expression)], abs=error)
    assert model.fit.status == "ok"
    curve = model.diagnostics.pareto
    (chosen,) = (point for point in curve if point.chosen)
    lengths = [library.lengths[library.index(text)] for text in chosen.expressions]
    assert chosen.length == pytest.approx(sum(lengths) / np.log(2.0))
    assert len(curve) > 1
    assert all(a.length < b.length for a, b in pairwise(curve))
    assert all(a.cost > b.cost for a, b in pairwise(curve))
    model.save(tmp_path / "model.json")
    assert la.load(tmp_path / "model.json").to_dict() == model.to_dict()


@pytest.mark.thorough
def test_a_distance_to_an_unknown_point_grows_from_names_alone():
    """1/sqrt((x-0.6)**2+(y+0.3)**2+0.25) beside a spring: no plain term of the grammar can say it."""
    t, rng, runs = np.arange(0.0, 8.0, 0.02), np.random.default_rng(3), []

    def rates(_, state):
        x, y, u, v = state
        pull = ((x - 0.6) ** 2 + (y + 0.3) ** 2 + 0.25) ** -1.5
        return [u, v, -x - pull * (x - 0.6), -y - pull * (y + 0.3)]

    for start in ([1.2, 0.0, 0.0, 0.6], [-0.8, 0.5, 0.4, -0.3], [0.1, -1.0, -0.7, 0.2]):
        q = solve_ivp(rates, (0.0, t[-1]), start, t_eval=t, rtol=1e-10, atol=1e-10).y[:2].T
        runs.append(la.Trajectory(t, q + rng.normal(0.0, 2e-3, q.shape), coordinates=["x", "y"]))
    model = la.discover(runs, la.Library.symbolic(["x", "y"]), known={"x_dot**2": 0.5})
    assert model.fit.status == "ok", model.fit.warnings
    assert len(model.terms) == 5
    found = {shape.name: shape for shape in model.shapes}
    for name, truth in {"p": 0.6, "r": -0.3, "h": 0.5}.items():
        assert abs(abs(found[name].value) - abs(truth)) < 4.5 * found[name].standard_error


def test_what_is_undefined_along_the_data_is_left_out_and_said():
    data = systems.generate("double_well", noise=0.01, trials=2, duration=8.0, seed=2)
    assert min(run.q.min() for run in data) < 0.0
    library = la.Library.symbolic("x").with_dissipation(list(systems.get("double_well").dissipation))
    model = la.discover(data, library)
    (left,) = findings_of(model, "undefined-candidates")
    assert left.subject == ("1/x", "log(x)", "sqrt(x)", "1/x**2")
    assert left.severity == "note"


def test_a_known_term_that_is_undefined_is_still_an_error():
    t = np.arange(0.0, 8.0, 0.02)
    data = la.Trajectory(t, np.cos(t), coordinates=["x"])
    with pytest.raises(la.DataError, match=r"sqrt\(x\) is undefined somewhere along the data"):
        la.discover(data, la.Library.symbolic("x"), known={"sqrt(x)": 1.0})


def test_on_the_command_line(tmp_path):
    data = systems.generate("single_pendulum", noise=0.01, trials=2, duration=6.0, seed=1)
    la.write_csv(tmp_path / "run.csv", data)
    options = [
        "--coordinates",
        "theta",
        "--angles",
        "theta",
        "--forces",
        "theta_force",
        "--library",
        "symbolic",
    ]
    where = ["--output", str(tmp_path / "out")]
    result = CliRunner().invoke(program, ["discover", str(tmp_path / "run.csv"), *options, *where])
    assert result.exit_code == 0, result.output
    model = la.load(tmp_path / "out" / "model.json")
    assert [term.expression for term in model.terms] == ["theta_dot**2", "cos(theta)"]
    more = [*options, "--size", "large", *where]
    result = CliRunner().invoke(program, ["discover", str(tmp_path / "run.csv"), *more])
    assert result.exit_code == 2
    assert "--size goes with --library auto; neither a file nor symbolic has sizes" in result.output
