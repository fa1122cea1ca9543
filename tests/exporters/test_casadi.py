from __future__ import annotations

import numpy as np
import pytest

import leastaction as la
from export_models import MODELS, states
from helpers import finite_difference
from leastaction.errors import InputError
from leastaction.model.model import LagrangianModel, ModelTerm

casadi = pytest.importorskip("casadi")


@pytest.fixture(params=MODELS, scope="module")
def model(request):
    return MODELS[request.param]()


def from_file(model, folder):
    """Functions of the exported module, imported as a user would."""
    path = folder / "exported.py"
    la.export(model, "casadi", path)
    namespace = {}
    exec(compile(path.read_text(encoding="ascii"), str(path), "exec"), namespace)
    return [namespace[name] for name in ("acceleration", "energy", "mass_matrix")]


def test_file_and_functions_agree_with_the_model(model, tmp_path):
    for acceleration, energy, mass_matrix in (from_file(model, tmp_path), la.casadi.functions(model)):
        for q, v, f in states(model):
            close = {"rtol": 1e-10, "atol": 1e-10}
            np.testing.assert_allclose(
                acceleration(q, v, f).full()[:, 0], model.acceleration(q, v, f), **close
            )
            np.testing.assert_allclose(float(energy(q, v)), model.energy(q, v), **close)
            np.testing.assert_allclose(mass_matrix(q, v).full(), model.mass_matrix(q, v), **close)


def test_names_of_arguments():
    f = la.casadi.functions(MODELS["driven"]())
    assert f.acceleration.name_in() == ["q", "qdot", "forces"]
    assert f.acceleration.name_out() == ["qddot"]
    called = f.energy(q=[0.3, 0.1], qdot=[1.0, 0.0])
    assert float(called["energy"]) == pytest.approx(float(MODELS["driven"]().energy([0.3, 0.1], [1.0, 0.0])))


def test_derivatives_are_those_of_the_model():
    """What CasADi is there for: exact derivatives."""
    model = MODELS["driven"]()
    acceleration = la.casadi.functions(model).acceleration
    q = casadi.SX.sym("q", 2)
    v, f = np.array([0.7, -0.4]), np.array([0.1, 0.2])
    jacobian = casadi.Function("J", [q], [casadi.jacobian(acceleration(q, v, f), q)])
    at = np.array([0.4, -0.9])
    expected = finite_difference(lambda x: model.acceleration(x, v, f), at, 1e-3)
    np.testing.assert_allclose(jacobian(at).full(), expected, rtol=1e-7)


def test_mass_matrix_that_is_singular_everywhere(tmp_path):
    model = LagrangianModel(["x", "y"], [ModelTerm("x_dot**2", 1.0), ModelTerm("x*y", 1.0)])
    for acceleration, *_ in (from_file(model, tmp_path), la.casadi.functions(model)):
        assert np.isnan(acceleration([1.0, 1.0], [0.0, 0.0], [0.0, 0.0]).full()).all()


def test_wrong_use():
    with pytest.raises(InputError, match="expected a LagrangianModel"):
        la.casadi.functions("model.json")
