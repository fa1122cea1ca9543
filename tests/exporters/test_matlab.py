"""The exported function file, run by a small interpreter (`matlab_subset`), and by Octave if there is one."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest

from export_models import MODELS, states, timed
from leastaction.errors import InputError
from leastaction.exporters.write import export
from leastaction.model.model import LagrangianModel, ModelTerm
from matlab_subset import Program

OCTAVE = shutil.which("octave-cli") or shutil.which("octave")


@pytest.fixture(params=MODELS, scope="module")
def model(request):
    return MODELS[request.param]()


def handles(model):
    program = Program(export(model, "matlab"))
    assert program.main == "leastaction_model"
    return program.call(program.main)


def column(x):
    return np.reshape(np.asarray(x, dtype=float), (-1, 1))


def test_numbers_agree(model):
    made = handles(model)
    assert list(made) == ["acceleration", "state_derivative", "energy", "mass_matrix"]
    close = {"rtol": 1e-11, "atol": 1e-11}
    for q, v, f in states(model):
        qddot = made["acceleration"](column(q), column(v), column(f))
        np.testing.assert_allclose(qddot, column(model.acceleration(q, v, f)), **close)
        np.testing.assert_allclose(
            made["acceleration"](column(q), column(v)), column(model.acceleration(q, v)), **close
        )
        np.testing.assert_allclose(made["energy"](column(q), column(v)), model.energy(q, v), **close)
        np.testing.assert_allclose(
            made["mass_matrix"](column(q), column(v)), model.mass_matrix(q, v), **close
        )
        np.testing.assert_allclose(made["mass_matrix"](column(q)), model.mass_matrix(q), **close)


def test_a_law_that_holds_the_time_takes_it_behind_the_state():
    model = timed()
    made = handles(model)
    for k, (q, v, f) in enumerate(states(model)):
        close, t = {"rtol": 1e-11, "atol": 1e-11}, 0.7 * k - 1.0
        free, driven = (column(model.acceleration(q, v, force, t)) for force in (None, f))
        given = column(q), column(v), t
        np.testing.assert_allclose(made["acceleration"](*given), free, **close)
        np.testing.assert_allclose(made["acceleration"](*given, column(f)), driven, **close)
        np.testing.assert_allclose(made["energy"](*given), model.energy(q, v, t), **close)
        np.testing.assert_allclose(made["mass_matrix"](*given), model.mass_matrix(q, v, t), **close)
        state = column([*q, *v])
        np.testing.assert_allclose(made["state_derivative"](t, state)[2:], free, **close)
        np.testing.assert_allclose(made["state_derivative"](t, state, column(f))[2:], driven, **close)


def test_state_derivative(model):
    made = handles(model)
    for q, v, f in states(model):
        state = column([*q, *v])
        free, driven = ([*v, *model.acceleration(q, v, force)] for force in (None, f))
        close = {"rtol": 1e-11, "atol": 1e-11}
        np.testing.assert_allclose(made["state_derivative"](0.0, state), column(free), **close)
        np.testing.assert_allclose(made["state_derivative"](0.0, state, column(f)), column(driven), **close)
        held = made["state_derivative"](0.5, state, lambda t, f=f: column(f) * t * 2.0)
        np.testing.assert_allclose(held, column(driven), **close)


def test_the_interpreter_knows_the_rules_of_matlab():
    """What it is trusted with: precedence, and refusal of everything else."""

    def value(text):
        return Program(f"function y = f(x)\ny = {text};\nend\n").call("f", column([2.0, 5.0]))

    assert value("-2^2") == -4.0
    assert value("2^3^2") == 64.0
    assert value("2^-1") == 0.5
    assert value("8/4/2") == 1.0
    assert value("x(2) - x(1)*2 - 1") == 0.0
    assert value("[2, 0; 0, 5] \\ x").tolist() == [[1.0], [1.0]]
    for text in ("realsqrt(-1)", "reallog(-1)", "realpow(-2, 0.5)"):
        with pytest.raises(ValueError, match="complex"):
            value(text)
    for text in ("x(3)", "system(1)", "x'", "1 +", "2 ** 3", "x.^2", "(1"):
        with pytest.raises((AssertionError, KeyError)):
            value(text)


def test_name_of_the_file_is_that_of_the_function(tmp_path):
    export(MODELS["free"](), "matlab", tmp_path / "my_spring.m")
    assert Program((tmp_path / "my_spring.m").read_text(encoding="ascii")).main == "my_spring"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("spring.c", "does not end in .m"),
        ("spring", "does not end in .m"),
        ("3springs.m", "cannot be called in MATLAB"),
        ("my-spring.m", "cannot be called in MATLAB"),
        ("while.m", "no keyword"),
        ("θ.m", "cannot be called"),
    ],
)
def test_names_that_matlab_cannot_call(name, says, tmp_path):
    with pytest.raises(InputError, match=says):
        export(MODELS["free"](), "matlab", tmp_path / name)
    assert not (tmp_path / name).exists()


def test_outside_of_its_domain_it_stops_and_is_not_complex():
    model = LagrangianModel(["x"], [ModelTerm("x_dot**2", 0.5), ModelTerm("log(x)*sqrt(x)", 1.0)])
    with pytest.raises(ValueError, match="complex"):
        handles(model)["acceleration"](column([-1.0]), column([0.0]))


@pytest.mark.skipif(OCTAVE is None, reason="no Octave")
def test_octave_agrees(tmp_path):
    for number, make in enumerate(MODELS.values()):
        model = make()
        export(model, "matlab", tmp_path / f"found{number}.m")
        q, v, f = states(model)[0]
        vectors = ", ".join("[" + "; ".join(map(repr, x.tolist())) + "]" for x in (q, v, f))
        script = f"m = found{number}(); printf('%.17g ', m.acceleration({vectors}));"
        done = subprocess.run(
            [OCTAVE, "--eval", script], cwd=tmp_path, capture_output=True, timeout=60, check=True
        )
        found = [float(x) for x in done.stdout.split()]
        np.testing.assert_allclose(found, model.acceleration(q, v, f), rtol=1e-11)
