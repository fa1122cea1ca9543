"""Exports agree with the model: Python, C, SymPy, LaTeX, CasADi, and MATLAB.

MATLAB and Octave may be missing where the tests run. A small interpreter checks the grammar of the function
file and its numbers, by the rules of MATLAB (``^`` binds from the left, arrays start at 1, a backslash
solves). It reads a whitelist; anything else is an error. Octave runs the file if it is there.
"""

from __future__ import annotations

import ctypes
import itertools
import re
import shutil
import subprocess
from collections.abc import Callable
from xml.etree import ElementTree

import numpy as np
import pytest
import sympy as sp
from click.testing import CliRunner

import leastaction as la
from helpers import COMPILER, MODELS, finite_difference, states, timed
from leastaction.cli import program
from leastaction.errors import InputError
from leastaction.exporters import FORMATS
from leastaction.exporters.chains import chain_of
from leastaction.exporters.write import export
from leastaction.findings import find
from leastaction.library import format_expression
from leastaction.model.model import FitSummary, LagrangianModel, ModelTerm


@pytest.fixture(params=MODELS, scope="module")
def model(request):
    return MODELS[request.param]()


def test_python_agrees(model):
    namespace = {}
    exec(export(model, "python"), namespace)
    for q, v, f in states(model):
        a = namespace["acceleration"](q.tolist(), v.tolist(), f.tolist())
        np.testing.assert_allclose(a, model.acceleration(q, v, f), rtol=1e-12, atol=1e-12)
        a = namespace["acceleration"](q.tolist(), v.tolist())
        np.testing.assert_allclose(a, model.acceleration(q, v), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(namespace["energy"](q, v), model.energy(q, v), rtol=1e-12, atol=1e-12)


def compiled(model, folder):
    source, library = folder / "model.c", folder / "model.so"
    export(model, "c", source)
    assert source.read_text("ascii").startswith("/*\n * Equations of motion")
    options = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    subprocess.run(
        [COMPILER, *options, "-o", library, source, "-lm"], check=True, capture_output=True, timeout=60
    )
    library = ctypes.CDLL(str(library))
    library.leastaction_energy.restype = ctypes.c_double
    return library


def pointer(array):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_c_agrees(model, tmp_path):
    library = compiled(model, tmp_path)
    for q, v, f in states(model):
        a = np.empty(model.n_dof)
        library.leastaction_acceleration(pointer(q), pointer(v), pointer(f), pointer(a))
        np.testing.assert_allclose(a, model.acceleration(q, v, f), rtol=1e-12, atol=1e-12)
        library.leastaction_acceleration(pointer(q), pointer(v), None, pointer(a))
        np.testing.assert_allclose(a, model.acceleration(q, v), rtol=1e-12, atol=1e-12)
        energy = library.leastaction_energy(pointer(q), pointer(v))
        np.testing.assert_allclose(energy, model.energy(q, v), rtol=1e-12, atol=1e-12)


def test_a_law_that_holds_the_time_takes_it_behind_the_state():
    model, namespace = timed(), {}
    exec(export(model, "python"), namespace)
    for k, (q, v, f) in enumerate(states(model)):
        close, t = {"rtol": 1e-12, "atol": 1e-12}, 0.7 * k - 1.0
        given = q.tolist(), v.tolist(), t
        expected = model.acceleration(q, v, f, t)
        np.testing.assert_allclose(namespace["acceleration"](*given, f.tolist()), expected, **close)
        np.testing.assert_allclose(namespace["energy"](*given), model.energy(q, v, t), **close)
    script = {}
    exec(export(model, "sympy"), script)
    assert sp.simplify(script["lagrangian"] - model.lagrangian) == 0
    assert sp.simplify(script["dissipation_function"] - model.dissipation_function) == 0
    assert "\\cos{\\left(3 t \\right)}" in export(model, "latex")


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_c_takes_the_time(tmp_path):
    model, library = timed(), compiled(timed(), tmp_path)
    for k, (q, v, f) in enumerate(states(model)):
        a, t = np.empty(model.n_dof), 0.7 * k - 1.0
        library.leastaction_acceleration(pointer(q), pointer(v), ctypes.c_double(t), pointer(f), pointer(a))
        np.testing.assert_allclose(a, model.acceleration(q, v, f, t), rtol=1e-12, atol=1e-12)
        energy = library.leastaction_energy(pointer(q), pointer(v), ctypes.c_double(t))
        np.testing.assert_allclose(energy, model.energy(q, v, t), rtol=1e-12, atol=1e-12)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_singular_mass_matrix_gives_nan(tmp_path):
    model = LagrangianModel(["x", "y"], [ModelTerm("x**2*x_dot**2", 1.0), ModelTerm("y_dot**2", 1.0)])
    namespace = {}
    exec(export(model, "python"), namespace)
    assert np.isnan(namespace["acceleration"]([0.0, 0.0], [0.0, 0.0])).all()
    zero, a = np.zeros(2), np.zeros(2)
    compiled(model, tmp_path).leastaction_acceleration(pointer(zero), pointer(zero), None, pointer(a))
    assert np.isnan(a).all()


def test_sympy_reads_back_equal(model):
    namespace = {}
    exec(export(model, "sympy"), namespace)
    assert sp.simplify(namespace["lagrangian"] - model.lagrangian) == 0
    assert sp.simplify(namespace["dissipation_function"] - model.dissipation_function) == 0


def test_sympy_script_with_names_of_its_own():
    model = LagrangianModel(["sympy", "lagrangian"], [ModelTerm("sympy_dot**2*cos(lagrangian/3)", 0.5)])
    namespace = {}
    exec(export(model, "sympy"), namespace)
    assert namespace["lagrangian_"] == model.lagrangian


TEX = shutil.which("pdflatex") or shutil.which("lualatex") or shutil.which("tectonic")


@pytest.mark.skipif(TEX is None, reason="no TeX engine (Debian: apt-get install texlive-latex-base)")
@pytest.mark.parametrize("name", ["odd", "driven", "timed"])
def test_latex_can_be_typeset(name, tmp_path):
    text = export(timed() if name == "timed" else MODELS[name](), "latex")
    document = (
        f"\\documentclass{{article}}\n\\usepackage{{amsmath}}\n\\begin{{document}}\n{text}\\end{{document}}\n"
    )
    (tmp_path / "law.tex").write_text(document, encoding="utf-8")
    options = [] if TEX.endswith("tectonic") else ["-interaction=nonstopmode", "-halt-on-error"]
    done = subprocess.run([TEX, *options, "law.tex"], cwd=tmp_path, capture_output=True, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (tmp_path / "law.pdf").stat().st_size > 1000


def test_latex():
    text = export(MODELS["free"](), "latex")
    assert text == "% Written by leastaction; needs amsmath.\n\\[\nL = 1.5 \\, \\dot{x}^{2}\n\\]\n"


@pytest.mark.parametrize("format", [name for name in FORMATS if not name.startswith("fmu")])
def test_text_is_written_to_the_path(format, tmp_path):
    text = export(MODELS["single"](), format, tmp_path / "out.m")
    assert (tmp_path / "out.m").read_bytes().decode() == text
    assert text.endswith("\n")


def test_every_format_has_a_line_in_the_help():
    result = CliRunner().invoke(program, ["export", "--help"])
    assert result.exit_code == 0
    listed = [
        line.split()[0] for line in result.output.splitlines() if line.split()[:1] and line[:4] == "    "
    ]
    assert [name for name in listed if name in FORMATS] == list(FORMATS)


def test_wrong_use():
    with pytest.raises(
        InputError, match=r"expected one of sympy, latex, python, c, .* did you mean 'python'"
    ):
        export(MODELS["free"](), "Pythn")
    with pytest.raises(InputError, match="expected a LagrangianModel"):
        export("model.json", "c")
    with pytest.raises(InputError, match="a path is expected, not 3"):
        export(MODELS["free"](), "matlab", 3)


# -------------------------------------------------------------- CasADi: a file, and functions at once
@pytest.fixture
def casadi():
    return pytest.importorskip("casadi")


def functions_of_file(model, folder):
    """Functions of the exported module, imported as a user would."""
    path = folder / "exported.py"
    la.export(model, "casadi", path)
    namespace = {}
    exec(compile(path.read_text(encoding="ascii"), str(path), "exec"), namespace)
    return [namespace[name] for name in ("acceleration", "energy", "mass_matrix")]


def test_file_and_functions_of_casadi_agree_with_the_model(casadi, model, tmp_path):
    for acceleration, energy, mass_matrix in (functions_of_file(model, tmp_path), la.casadi.functions(model)):
        for q, v, f in states(model):
            close = {"rtol": 1e-10, "atol": 1e-10}
            np.testing.assert_allclose(
                acceleration(q, v, f).full()[:, 0], model.acceleration(q, v, f), **close
            )
            np.testing.assert_allclose(float(energy(q, v)), model.energy(q, v), **close)
            np.testing.assert_allclose(mass_matrix(q, v).full(), model.mass_matrix(q, v), **close)


def test_casadi_takes_the_time(casadi, tmp_path):
    model = timed()
    for acceleration, energy, mass_matrix in (functions_of_file(model, tmp_path), la.casadi.functions(model)):
        assert acceleration.name_in() == ["q", "qdot", "t", "forces"]
        for k, (q, v, f) in enumerate(states(model)):
            close, t = {"rtol": 1e-10, "atol": 1e-10}, 0.7 * k - 1.0
            found = acceleration(q, v, t, f).full()[:, 0]
            np.testing.assert_allclose(found, model.acceleration(q, v, f, t), **close)
            np.testing.assert_allclose(float(energy(q, v, t)), model.energy(q, v, t), **close)
            np.testing.assert_allclose(mass_matrix(q, v, t).full(), model.mass_matrix(q, v, t), **close)


def test_names_of_arguments(casadi):
    f = la.casadi.functions(MODELS["driven"]())
    assert f.acceleration.name_in() == ["q", "qdot", "forces"]
    assert f.acceleration.name_out() == ["qddot"]
    called = f.energy(q=[0.3, 0.1], qdot=[1.0, 0.0])
    assert float(called["energy"]) == pytest.approx(float(MODELS["driven"]().energy([0.3, 0.1], [1.0, 0.0])))


def test_derivatives_are_those_of_the_model(casadi):
    """What CasADi is there for: exact derivatives."""
    model = MODELS["driven"]()
    acceleration = la.casadi.functions(model).acceleration
    q = casadi.SX.sym("q", 2)
    v, f = np.array([0.7, -0.4]), np.array([0.1, 0.2])
    jacobian = casadi.Function("J", [q], [casadi.jacobian(acceleration(q, v, f), q)])
    at = np.array([0.4, -0.9])
    expected = finite_difference(lambda x: model.acceleration(x, v, f), at, 1e-3)
    np.testing.assert_allclose(jacobian(at).full(), expected, rtol=1e-7)


def test_mass_matrix_that_is_singular_everywhere(casadi, tmp_path):
    model = LagrangianModel(["x", "y"], [ModelTerm("x_dot**2", 1.0), ModelTerm("x*y", 1.0)])
    for acceleration, *_ in (functions_of_file(model, tmp_path), la.casadi.functions(model)):
        assert np.isnan(acceleration([1.0, 1.0], [0.0, 0.0], [0.0, 0.0]).full()).all()


def test_casadi_wants_a_model(casadi):
    with pytest.raises(InputError, match="expected a LagrangianModel"):
        la.casadi.functions("model.json")


# -------------------------------------------------------------- JAX, Julia, Modelica
def jax_module(model, stand_in=None):
    """The exported module, over jax.numpy or over NumPy in its place."""
    source, namespace = export(model, "jax"), {}
    if stand_in is not None:
        source = source.replace("import jax.numpy as jnp", "")
        namespace["jnp"] = stand_in
    exec(source, namespace)
    return namespace


def check_jax(model, module):
    t = (0.7,) if model.timed else ()
    for q, v, f in states(model):
        expected = model.acceleration(q, v, f, *t)
        close = {"rtol": 1e-11, "atol": 1e-11}
        np.testing.assert_allclose(module["acceleration"](q, v, *t, f), expected, **close)
        derivative = module["state_derivative"](0.7, np.concatenate([q, v]), f)
        np.testing.assert_allclose(derivative, [*v, *expected], **close)
        np.testing.assert_allclose(module["energy"](q, v, *t), model.energy(q, v, *t), **close)
        np.testing.assert_allclose(module["mass_matrix"](q, v, *t), model.mass_matrix(q, v, *t), **close)


@pytest.mark.parametrize("name", [*MODELS, "timed"])
def test_functions_for_jax_agree(name):
    model = timed() if name == "timed" else MODELS[name]()
    check_jax(model, jax_module(model, np))


def test_jax_itself_agrees_and_differentiates():
    jax = pytest.importorskip("jax")
    model = MODELS["driven"]()
    jax.config.update("jax_enable_x64", True)
    module = jax_module(model)
    check_jax(model, module)
    q, v = np.array([0.4, -0.9]), np.array([0.7, -0.4])
    found = jax.jit(jax.jacobian(module["acceleration"]))(q, v)
    expected = finite_difference(lambda x: model.acceleration(x, v), q, 1e-3)
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    with np.errstate(all="ignore"):
        flat = LagrangianModel(["x", "y"], [ModelTerm("x_dot**2", 1.0), ModelTerm("x*y", 1.0)])
        assert not np.isfinite(jax_module(flat)["acceleration"](q, v)).all()


_GIVEN = {"sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sign", "q", "qdot", "t"}
_PART = r"\d+\.?\d*(?:e[+-]?\d+)?|\w+|[-+*/^()\[\], ]"


def run_statements(lines, sign, given):
    """Run assignments of scalar code that writes powers with ^ and counts from 1; anything else fails."""
    scope = {name: getattr(np, name) for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sign")}
    scope |= {k: v if np.isscalar(v) else np.concatenate([[np.nan], v]) for k, v in given.items()}
    for line in lines:
        name, found, code = line.strip().rstrip(";").partition(f" {sign} ")
        assert found, line
        assert re.fullmatch(rf"(?:{_PART})+", code), code
        names = set(re.findall(r"(?<![\w.])[A-Za-z_]\w*", code))
        assert names <= _GIVEN | set(scope) | {"reshape"}, names
        scope[name] = eval(code.replace("^", "**"), {"__builtins__": {}}, scope)
    return scope


def between(text, start, stop):
    lines = text.partition(f"{start}\n")[2].partition(f"\n{stop}")[0].splitlines()
    assert lines, start
    return lines


@pytest.mark.parametrize("name", [*MODELS, "timed"])
def test_julia_and_modelica_agree(name):
    """Their scalar code is read by rules that both languages share; neither runs where the tests run."""
    model = timed() if name == "timed" else MODELS[name]()
    n, close = model.n_dof, {"rtol": 1e-11, "atol": 1e-11}
    t = {"t": 0.7} if model.timed else {}
    julia, modelica = export(model, "julia"), export(model, "modelica")
    arguments = ", ".join(["q", "qdot", *t])
    assert julia.count("\nfunction ") == julia.count("\nend\n") - 1 == 4
    assert len(re.findall(r"^ *function ", modelica, re.M)) == 3
    for q, v, f in states(model):
        given = {"q": q, "qdot": v, **t}
        expected = model.mass_matrix(q, v, **t), model.acceleration(q, v, f, **t)
        body = between(julia, f"function _equations({arguments})", "    return")
        body = [re.sub(r"reshape\(\[(.*)\], \d+, \d+\)$", r"[\1]", line) for line in body]
        scope = run_statements(body, "=", given)
        mass = np.reshape(scope["mass"], (n, n), order="F")
        np.testing.assert_allclose(mass, expected[0], **close)
        np.testing.assert_allclose(np.linalg.solve(mass, np.array(scope["right"]) + f), expected[1], **close)
        body = between(julia, f"function energy({arguments})", "end")
        body[-1] = body[-1].replace("return ", "energy = ")
        np.testing.assert_allclose(
            run_statements(body, "=", given)["energy"], model.energy(q, v, **t), **close
        )
        found = {}
        for part in ("mass_matrix", "right_side", "energy"):
            whole = modelica.partition(f"  function {part} ")[2].partition(f"  end {part};")[0]
            body = whole.partition("  algorithm\n")[2].replace("{", "[").replace("}", "]").splitlines()
            found |= run_statements(body, ":=", given)
        np.testing.assert_allclose(found["mass"], expected[0], **close)
        np.testing.assert_allclose(np.linalg.solve(mass, np.array(found["right"]) + f), expected[1], **close)
        np.testing.assert_allclose(found["stored"], model.energy(q, v, **t), **close)


@pytest.mark.parametrize("name", [*MODELS, "timed"])
def test_parsers_of_julia_and_modelica_read_the_files(name):
    tree_sitter = pytest.importorskip("tree_sitter")
    grammar = pytest.importorskip("tree_sitter_julia")
    modelica = pytest.importorskip("pymoca.parser")
    model = timed() if name == "timed" else MODELS[name]()
    reader = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
    source = export(model, "julia")
    assert not reader.parse(source.encode()).root_node.has_error
    assert reader.parse(source.replace("reshape([", "reshape((").encode()).root_node.has_error
    package = modelica.parse(export(model, "modelica")).classes["LeastactionModel"]
    assert list(package.classes) == ["mass_matrix", "right_side", "energy", "Motion"]
    inputs = [
        name for name, symbol in package.classes["energy"].symbols.items() if "input" in symbol.prefixes
    ]
    assert inputs == ["q", "qdot", *(["t"] if model.timed else [])]


JULIA = shutil.which("julia")


@pytest.mark.skipif(JULIA is None, reason="no Julia")
@pytest.mark.parametrize("name", ["driven", "timed"])
def test_julia_itself_agrees(name, tmp_path):
    model = timed() if name == "timed" else MODELS[name]()
    export(model, "julia", tmp_path / "model.jl")
    (q, v, f), t = next(iter(states(model))), ", 0.7" if model.timed else ""
    n = model.n_dof
    script = f"""
        include("model.jl")
        using .LeastactionModel
        q, v, f = {q.tolist()}, {v.tolist()}, {f.tolist()}
        dx = zeros({2 * n})
        state_derivative!(dx, [q; v], f, 0.7)
        println(join([dx; acceleration(q, v{t}); energy(q, v{t}); vec(mass_matrix(q, v{t}))], " "))
    """
    (tmp_path / "script.jl").write_text(script, encoding="utf-8")
    command = [JULIA, "--startup-file=no", "script.jl"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=True)
    t = {"t": 0.7} if model.timed else {}
    expected = [
        *v,
        *model.acceleration(q, v, f, **t),
        *model.acceleration(q, v, **t),
        model.energy(q, v, **t),
    ]
    expected += model.mass_matrix(q, v, **t).ravel().tolist()
    np.testing.assert_allclose([float(x) for x in run.stdout.split()], expected, rtol=1e-11, atol=1e-11)


# -------------------------------------------------------------- chains of links: MJCF and URDF
def chain_models():
    """The double pendulum measured from down; upright with joint friction; three links, relative angles."""
    double = MODELS["driven"]()
    friction = [ModelTerm("(theta2_dot-theta1_dot)**2/2", 0.07), ModelTerm("theta1_dot**2/2", 0.04)]
    upright = [
        ModelTerm(t.expression, -t.coefficient if t.expression.startswith("cos") else t.coefficient)
        for t in double.terms
    ]
    single = LagrangianModel(["phi"], [ModelTerm("phi_dot**2", 1.0), ModelTerm("cos(phi)", 128.0)])
    a, b, c = sp.symbols("a b c", real=True)
    va, vb, vc = sp.symbols("a_dot b_dot c_dot", real=True)
    angles, rates = (a, a + b, a + b + c), (va, va + vb, va + vb + vc)
    x = y = vx = vy = 0
    whole = sp.Integer(0)
    for angle, rate, mass, length in zip(angles, rates, (1.2, 0.9, 0.5), (0.4, 0.3, 0.25), strict=True):
        x, y = x + length * sp.sin(angle), y - length * sp.cos(angle)
        vx, vy = vx + length * sp.cos(angle) * rate, vy + length * sp.sin(angle) * rate
        whole += mass * (vx**2 + vy**2) / 2 + sp.Rational(1, 100) * rate**2 - mass * 9.81 * y
    whole = sp.expand(sp.fu(sp.expand(whole)))
    terms = [
        ModelTerm(format_expression(p.as_coeff_Mul()[1]), float(p.as_coeff_Mul()[0]))
        for p in sp.Add.make_args(whole)
    ]
    three = LagrangianModel(["a", "b", "c"], terms, [ModelTerm("b_dot**2/2", 0.02)])
    return {
        "single": single,
        "double": LagrangianModel(double.coordinates, double.terms, friction),
        "upright": LagrangianModel(double.coordinates, upright, friction[1:]),
        "three": three,
    }


@pytest.mark.parametrize("name", ["single", "double", "upright", "three"])
def test_a_chain_of_links_moves_as_the_model(name):
    """In MuJoCo, from the MJCF and from the URDF: the same accelerations, with the joints' own angles."""
    mujoco = pytest.importorskip("mujoco")
    model = chain_models()[name]
    relative = name == "three"
    for format in ("mjcf", "urdf"):
        world = mujoco.MjModel.from_xml_string(export(model, format))
        world.opt.gravity[:] = 0.0, 0.0, -9.81
        state = mujoco.MjData(world)
        for q, v, f in states(model):
            state.qpos[:] = q if relative else np.diff(q, prepend=0.0)
            state.qvel[:] = v if relative else np.diff(v, prepend=0.0)
            # torques of joints act on a link and back on the one before
            joint_torque = f if relative else np.cumsum(f[::-1])[::-1]
            state.qfrc_applied[:] = joint_torque
            mujoco.mj_forward(world, state)
            found = state.qacc if relative else np.cumsum(state.qacc)
            np.testing.assert_allclose(found, model.acceleration(q, v, f), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "name", ["single", "double", "upright", pytest.param("three", marks=pytest.mark.thorough)]
)
def test_masses_of_a_chain_have_the_coefficients_of_the_law(name):
    model = chain_models()[name]
    chain = chain_of(model)
    assert chain.upright == (name == "upright")
    assert chain.relative == (name == "three")
    assert chain.left_out == ()
    assert all(link.mass > 0 and link.inertia > 0 and link.length > 0 for link in chain.links)
    names = model.coordinates
    angles, rates = ([sp.Symbol(f"{c}{end}", real=True) for c in names] for end in ("", "_dot"))
    if chain.relative:
        angles, rates = (list(itertools.accumulate(group)) for group in (angles, rates))
    y = vx = vy = sp.Integer(0)
    whole, sign = sp.Integer(0), -1 if chain.upright else 1
    for link, angle, rate in zip(chain.links, angles, rates, strict=True):
        centre = y - sign * link.centre * sp.cos(angle)
        cx, cy = vx + link.centre * sp.cos(angle) * rate, vy + link.centre * sp.sin(angle) * rate
        whole += link.mass * (cx**2 + cy**2) / 2 + link.inertia * rate**2 / 2 - link.mass * 9.81 * centre
        vx, vy = vx + link.length * sp.cos(angle) * rate, vy + link.length * sp.sin(angle) * rate
        y -= sign * link.length * sp.cos(angle)
    difference = sp.lambdify([*sorted(whole.free_symbols, key=str)], whole - model.lagrangian)
    rng = np.random.default_rng(3)
    values = [float(difference(*rng.uniform(-2, 2, len(whole.free_symbols)))) for _ in range(5)]
    np.testing.assert_allclose(
        values, values[0], atol=1e-9 * float(abs(model.lagrangian.as_coefficients_dict()[1]) + 100)
    )
    root = ElementTree.fromstring(export(model, "urdf"))
    assert [joint.get("type") for joint in root.iter("joint")] == ["continuous"] * len(names)


def test_comments_show_dry_friction_as_it_was_given():
    """The code has the root that was fitted, and a comment says how wide it is."""
    friction = [ModelTerm("sqrt(a_dot**2 + 1/2500)", 0.2)]
    fit = FitSummary(findings=[find("friction-smoothed", ["a_dot"], widths=[0.02])])
    terms = [ModelTerm("a_dot**2", 1.0), ModelTerm("cos(a)", 9.0)]
    smoothed = LagrangianModel(["a"], terms, friction, fit=fit)
    note = "abs() of velocities is smoothed near zero (a_dot below 0.02)"
    for format in ("python", "c", "julia", "mjcf", "latex"):
        text = export(smoothed, format)
        assert text.count(note) == 1
        assert "sqrt(a_dot**2 + 1/2500)" not in text
    assert "friction abs(a_dot)" in export(smoothed, "mjcf")
    assert r"\left|{\dot{a}}\right|" in export(smoothed, "latex")
    namespace = {}
    exec(export(smoothed, "python"), namespace)
    for rate in (0.0, 0.01, 1.0):  # inside the width, the force rises linearly
        found = namespace["acceleration"]([0.3], [rate])
        np.testing.assert_allclose(found, smoothed.acceleration([0.3], [rate]), rtol=1e-14)
        friction_force = -0.2 * rate / np.sqrt(rate**2 + 1 / 2500)
        np.testing.assert_allclose(2.0 * found[0], friction_force - 9.0 * np.sin(0.3), rtol=1e-12)


def test_what_is_no_chain_says_so():
    for name in ("passive", "spherical", "free", "swapped", "odd"):
        with pytest.raises(InputError, match="not a chain of links in a plane"):
            export(MODELS[name](), "mjcf")
    dry = LagrangianModel(
        ["a"], [ModelTerm("a_dot**2", 1.0), ModelTerm("cos(a)", 9.0)], [ModelTerm("abs(a_dot)", 0.2)]
    )
    assert chain_of(dry).left_out == ("abs(a_dot)",)
    assert "Left out, because a joint cannot have it: friction abs(a_dot)" in export(dry, "mjcf")


# ------------------------------------------ the little of MATLAB that an exported file uses, on NumPy columns
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z][A-Za-z0-9_]*)"
    r"|(?P<text>'[^']*')|(?P<op>[-+*/\\^()\[\],;:@.]))"
)
_DEFINITION = re.compile(
    r"function (?:\[(?P<many>[\w, ]+)\]|(?P<one>\w+)) = (?P<name>\w+)\((?P<args>[\w, ]*)\)"
)
_ASSIGNMENT = re.compile(r"(?:\[(?P<many>[\w, ]+)\]|(?P<one>\w+(?:\.\w+)?)) = (?P<value>.+);")


def _real(function: Callable, low: float) -> Callable:
    def call(x):
        if np.min(x) < low:
            raise ValueError("produced complex result")
        return function(x)

    return call


def _realpow(x, y):
    if x < 0 and y != int(y):
        raise ValueError("realpow: produced complex result")
    return x**y


BUILT_IN: dict[str, Callable] = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "exp": np.exp,
    "abs": np.abs,
    "sign": np.sign,
    "realsqrt": _real(np.sqrt, 0.0),
    "reallog": _real(np.log, 0.0),
    "realpow": _realpow,
    "zeros": lambda n, m: np.zeros((int(n), int(m))),
    "isa": lambda x, kind: callable(x) and kind == "function_handle",
}


class Program:
    """The functions of one file; `call` runs one."""

    def __init__(self, source: str) -> None:
        self.functions: dict[str, tuple[list[str], list[str], list[str]]] = {}
        lines = [line.strip() for line in source.splitlines()]
        lines = [line for line in lines if line and not line.startswith("%")]
        body: list[str] | None = None
        depth = 0
        for line in lines:
            found = _DEFINITION.fullmatch(line)
            if found:
                assert depth == 0, f"function inside a function: {line}"
                body, depth = [], 1
                outputs = _names(found["many"] or found["one"])
                assert found["name"] not in self.functions
                self.functions[found["name"]] = (outputs, _names(found["args"]), body)
                continue
            assert body is not None, f"outside of a function: {line}"
            depth += line.startswith("if ") - (line == "end")
            if depth:
                body.append(line)
        assert depth == 0, "an end is missing"
        self.main = next(iter(self.functions))

    def call(self, name: str, *args):
        outputs, parameters, body = self.functions[name]
        assert len(args) <= len(parameters), f"too many arguments for {name}"
        scope = dict(zip(parameters, args, strict=False))
        self._run(body, scope, len(args))
        values = tuple(scope[output] for output in outputs)
        return values[0] if len(values) == 1 else values

    def _run(self, body: list[str], scope: dict, nargin: int) -> None:
        place = 0
        while place < len(body):
            if body[place].startswith("if "):
                stop, parts = _branches(body, place)
                for condition, lines in parts:
                    if condition is None or self._true(condition, scope, nargin):
                        self._run(lines, scope, nargin)
                        break
                place = stop + 1
                continue
            found = _ASSIGNMENT.fullmatch(body[place])
            assert found, f"not a statement of the subset: {body[place]}"
            value = Expression(found["value"], scope, self).value()
            if found["many"]:
                scope.update(zip(_names(found["many"]), value, strict=True))
            elif "." in found["one"]:
                whole, part = found["one"].split(".")
                scope.setdefault(whole, {})[part] = value
            else:
                # The first of several results, as in MATLAB.
                scope[found["one"]] = value[0] if isinstance(value, tuple) else value
            place += 1

    def _true(self, condition: str, scope: dict, nargin: int) -> bool:
        found = re.fullmatch(r"nargin ([<>]) (\d)", condition)
        if found:
            return nargin < int(found[2]) if found[1] == "<" else nargin > int(found[2])
        return bool(Expression(condition, scope, self).value())


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _branches(body: list[str], start: int):
    """Place of the end, and (condition, lines) of if, elseif, else."""
    parts, depth = [(body[start][3:], [])], 0
    for place in range(start + 1, len(body)):
        line = body[place]
        if depth == 0 and line == "end":
            return place, parts
        if depth == 0 and line.startswith("elseif "):
            parts.append((line[7:], []))
        elif depth == 0 and line == "else":
            parts.append((None, []))
        else:
            depth += line.startswith("if ") - (line == "end")
            parts[-1][1].append(line)
    raise AssertionError("an end is missing")


class Expression:
    """Recursive descent; numbers are floats or columns of shape (n, m)."""

    def __init__(self, text: str, scope: dict, program: Program) -> None:
        self.scope, self.program, self.tokens, place = scope, program, [], 0
        while place < len(text.rstrip()):
            found = _TOKEN.match(text, place)
            assert found, f"not in the subset: {text[place:]}"
            self.tokens.append((found.lastgroup, found[found.lastgroup]))
            place = found.end()
        self.tokens.append(("end", ""))
        self.place = 0

    def value(self):
        result = self.sum()
        assert self.tokens[self.place][0] == "end", f"left over: {self.tokens[self.place :]}"
        return result

    def take(self, *operators: str) -> str | None:
        kind, text = self.tokens[self.place]
        if kind == "op" and text in operators:
            self.place += 1
            return text
        return None

    def need(self, operator: str) -> None:
        assert self.take(operator), f"{operator} expected before {self.tokens[self.place :]}"

    def sum(self):
        result = self.product()
        while operator := self.take("+", "-"):
            right = self.product()
            result = result + right if operator == "+" else result - right
        return result

    def product(self):
        result = self.signed()
        while operator := self.take("*", "/", "\\"):
            right = self.signed()
            if operator == "\\":
                result = np.linalg.solve(np.atleast_2d(result), np.atleast_2d(right))
            else:
                # Elementwise and matrix operations agree only where one side is a scalar.
                assert np.ndim(result) == 0 or np.ndim(right) == 0
                result = result * right if operator == "*" else result / right
        return result

    def signed(self):
        if operator := self.take("-", "+"):
            inner = self.signed()
            return -inner if operator == "-" else inner
        return self.power()

    def power(self):
        result = self.postfix()
        while self.take("^"):  # from the left, and the exponent may have a sign
            sign = -1.0 if self.take("-") else 1.0
            result = np.float64(result) ** (sign * self.postfix())
        return result

    def postfix(self):
        kind, text = self.tokens[self.place]
        self.place += 1
        if kind == "number":
            return np.float64(text)
        if kind == "text":
            return text[1:-1]
        if kind == "op" and text == "(":
            result = self.sum()
            self.need(")")
            return result
        if kind == "op" and text == "[":
            return self.matrix()
        if kind == "op" and text == "@":
            self.place += 1
            name = self.tokens[self.place - 1][1]
            assert name in self.program.functions
            return lambda *args: self.program.call(name, *args)
        assert kind == "name", f"not expected: {text}"
        return self.named(text)

    def named(self, name: str):
        if not self.take("("):
            return self.scope[name]
        if name in self.scope and self.take(":"):
            self.need(")")
            return np.reshape(self.scope[name], (-1, 1), order="F")
        args = [self.sum()]
        if self.take(":"):
            last = self.sum()
            self.need(")")
            flat = np.ravel(self.scope[name], order="F")
            return flat[int(args[0]) - 1 : int(last)].reshape(-1, 1)
        while self.take(","):
            args.append(self.sum())
        self.need(")")
        if name in self.scope and not callable(self.scope[name]):
            (index,) = args
            assert 1 <= index <= np.size(self.scope[name])
            return np.ravel(self.scope[name], order="F")[int(index) - 1]
        if name in self.scope:
            return self.scope[name](*args)
        if name in self.program.functions:
            return self.program.call(name, *args)
        return BUILT_IN[name](*args)

    def matrix(self):
        rows = [[self.sum()]]
        while not self.take("]"):
            if self.take(","):
                rows[-1].append(self.sum())
            else:
                self.need(";")
                rows.append([self.sum()])
        return np.vstack([np.hstack([np.atleast_2d(x) for x in row]) for row in rows])


# --------------------------------------------------------------------------------- the exported function file
OCTAVE = shutil.which("octave-cli") or shutil.which("octave")


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


def test_matlab_takes_the_time_behind_the_state():
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
        ("3springs.m", "is not a name of a MATLAB function"),
        ("my-spring.m", "is not a name of a MATLAB function"),
        ("while.m", "not a keyword"),
        ("θ.m", "is not a name"),
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
