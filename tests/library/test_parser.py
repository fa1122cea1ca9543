"""Expressions of users are parsed by a whitelist, and reduced."""

from __future__ import annotations

import itertools
import keyword
import math
import time

import numpy as np
import pytest
import sympy
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import leastaction as la
from helpers import assert_refused_in_one_line
from leastaction import arms
from leastaction.errors import InputError
from leastaction.identifiers import FUNCTION_NAMES, RESERVED_NAMES, check_coordinate_names, quoted
from leastaction.library import (
    Library,
    Term,
    alike,
    exchanges,
    format_expression,
    make_term,
    parse_expression,
    shape_names,
    shape_symbol,
    tangent,
)
from leastaction.library.jets import Jets, Points
from leastaction.library.reduction import find_redundant, same_functions
from leastaction.library.scanner import FUNCTIONS

NAMES = ["theta", "theta_dot", "x", "x_dot", "φ", "φ_dot"]
VALUES = {"theta": 0.61, "theta_dot": -1.3, "x": 1.7, "x_dot": 0.45, "φ": -0.8, "φ_dot": 0.9}
X, THETA = sympy.Symbol("x", real=True), sympy.Symbol("theta", real=True)


def read(text: str, **parameters: float) -> sympy.Expr:
    return parse_expression(text, NAMES, parameters)


def value(expr: sympy.Expr) -> float:
    result = expr.evalf(17, subs={sympy.Symbol(name, real=True): v for name, v in VALUES.items()})
    return float(result) if result.is_Float or result.is_Rational else math.nan


# --- what it reads -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x", X),
        (" x ** 2 ", X**2),
        ("-x**2", -(X**2)),
        ("0.5*x", X / 2),
        ("1e-3", sympy.Rational(1, 1000)),
        (".25 + 1.", sympy.Rational(5, 4)),
        ("1/3", sympy.Rational(1, 3)),
        ("x**-2", X**-2),
        ("x**2**3", X**8),
        ("2-3-4", sympy.Integer(-5)),
        ("12/3/2*x", 2 * X),
        ("x**0.5", sympy.sqrt(X)),
        ("sqrt(x**2)", abs(X)),
        ("sin (theta)", sympy.sin(THETA)),
        ("tan(x + pi/2)", -1 / sympy.tan(X)),
        ("abs(exp(sqrt(x)))", sympy.exp(sympy.sqrt(X))),
        ("x--+x", 2 * X),
        ("x\n + 1", X + 1),
    ],
)
def test_reads(text, expected):
    assert read(text) == expected


def test_symbols_are_real_and_unicode_is_normalised():
    assert read("φ_dot") == sympy.Symbol("φ_dot", real=True)
    # mathematical italic theta and full-width digits are compatibility forms
    assert parse_expression("𝜃*２", ["θ"]) == 2 * sympy.Symbol("θ", real=True)


def test_parameters_become_exact_numbers():
    assert read("m*x**2/2", m=3) == sympy.Rational(3, 2) * X**2
    assert read("g*x", g=9.81) == sympy.Rational(981, 100) * X
    assert read("x**n", n=2) == X**2
    with pytest.raises(InputError, match="parameter 'm'"):
        read("m*x", m=math.inf)
    with pytest.raises(InputError, match="parameter 'm'"):
        read("m*x", m="a")  # type: ignore[arg-type]


def test_long_decimals_become_floats_and_short_ones_are_exact():
    assert read("0.1 + 0.2") == sympy.Rational(3, 10)
    assert read("0.12345678901234567").is_Float


def test_functions_are_those_of_the_name_check():
    assert set(FUNCTIONS) == FUNCTION_NAMES
    for name in FUNCTIONS:
        read(f"{name}(x)")


# --- what it refuses ---------------------------------------------------------------------------------

REFUSED = [
    ("", "empty expression"),
    ("  ", "empty expression"),
    ("x^2", r"column 2.*use \*\* for powers"),
    ("x²", r"column 2.*use \*\* for powers"),
    ("x×2", r"use \* to multiply"),
    ("x−1", "use - for minus"),
    ("2x", r"column 2: an operator is missing; write \* to multiply"),
    ("x y", "column 3: an operator is missing"),
    ("thta", "unknown name 'thta'; did you mean 'theta'"),
    ("theta_dt**2", "did you mean 'theta_dot'"),
    ("foo", "unknown name 'foo'; expected a coordinate"),
    ("ln(x)", "did you mean 'log'"),
    ("Sin(x)", "did you mean 'sin'"),
    ("gamma(x)", "unknown function 'gamma'; expected one of the functions"),
    ("x(2)", "is not a function"),
    ("cos", "cos needs an argument"),
    ("cos()", r"unexpected '\)'"),
    ("cos(x, x)", "takes one argument"),
    ("cos(x=1)", "not an equation"),
    ("(x", "never closed"),
    ("x)", "never opened"),
    ("x+", "column 3: it ends too early"),
    ("*x", r"unexpected '\*'"),
    ("x//2", "unexpected '/'"),
    ("012", "leading zeros"),
    ("0x10", "operator is missing"),
    ("1j", "operator is missing"),
    ("1/0", "column 3: division by zero"),
    ("x/(1-1)", "division by zero"),
    ("x/(x-x)", "division by zero"),
    ("0**-1", "division by zero"),
    ("log(0)", "not a finite real number"),
    ("log(-2)", "not a finite real number"),
    ("sqrt(-1)*x", "not a finite real number"),
    ("sqrt(-x**2)", "not a finite real number"),
    ("tan(pi/2)", "not a finite real number"),
    ("x**x", "exponent must be a number"),
    ("2**theta", "exponent must be a number"),
    ("x**33", r"exponent is out of range; expected \|n\| <= 32"),
    ("(x**32)**2", "power is out of range"),
    ("1e13", "number is out of range"),
    ("1e-31", "number is out of range"),
    ("1e400", "number is out of range"),
    ("1e10*x*1e10", "out of range"),
    ("(1e6*x)**32", "out of range"),
    ("exp(100)", "out of range"),
    ("__import__('os')", "unknown function '__import__'"),
    ("x.real", "column 2: unexpected '.'"),
    ("x[0]", "unexpected"),
    ("lambda: 1", "unknown name 'lambda'"),
    ("x if 1 else 2", "'if' is not allowed"),
    ("'x'", "unexpected"),
    ("x\x00", "unexpected"),
    ("x < 1", "unexpected '<'"),
    ("True", "unknown name 'True'"),
    ("nan", "unknown name 'nan'"),
    ("x" * 3000, "at most 2000"),
]


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_refuses_in_one_line(text, message):
    with pytest.raises(InputError, match=message) as caught:
        read(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "text",
    [
        "2**9999999",
        "9**9**9**9**9",
        "x**2**2**2**2**2**2**2",
        "exp(10**12*log(2))",
        "exp(x + 10**12*log(2))",
        "exp(10**12*log(2*x))",
        "exp(exp(exp(exp(10))))",
        "((2*x)**32)**32",
        "(" * 900 + "x" + ")" * 900,
        "sin(" * 400 + "x" + ")" * 400,
        "-" * 1900 + "x",
        "x" + "+x" * 900,
        "x" + "**-x" * 450,
        "9" * 1990,
        "(" * 1999,
    ],
)
def test_refuses_bombs_quickly(text):
    start = time.perf_counter()
    with pytest.raises(InputError):
        read(text)
    assert time.perf_counter() - start < 2.0


def test_limits_leave_room_for_real_expressions():
    assert read("(" * 50 + "x" + ")" * 50) == X
    assert read("+".join(["x"] * 250)) == 250 * X
    assert read("-" * 50 + "x") == X
    nested = "x"
    for _ in range(28):
        nested = f"sin({nested} + 1)"
    assert read(nested).free_symbols == {X}


def test_not_text():
    with pytest.raises(InputError, match="expected an expression as text"):
        parse_expression(3, NAMES)  # type: ignore[arg-type]


# --- random expressions ------------------------------------------------------------------------------

numbers = st.one_of(
    st.integers(0, 999).map(str), st.decimals(0, 50, places=3).map(str), st.sampled_from(["1e-3", "2.5E2"])
)
atoms = st.one_of(
    st.sampled_from(NAMES).map(lambda name: (name, VALUES[name])),
    st.just(("pi", math.pi)),
    numbers.map(lambda text: (text, float(text))),
)
REAL = {
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "exp": math.exp,
    "log": math.log,
    "sqrt": math.sqrt,
    "abs": abs,
}


def _apply(function, *arguments):
    try:
        result = function(*arguments)
        return result if isinstance(result, float) and abs(result) < 1e100 else math.nan
    except (ValueError, OverflowError, ZeroDivisionError):
        return math.nan


def _call(name: str, argument: float) -> float:
    # rounding of a large argument is an error of the phase: at 1e6 it is 1e-10
    if name in ("sin", "cos", "tan") and abs(argument) > 1e6:
        return math.nan
    return _apply(REAL[name], argument)


def _extend(children):
    sums = st.tuples(children, st.sampled_from("+-*/"), children).map(
        lambda p: (f"({p[0][0]}){p[1]}({p[2][0]})", _apply(_BINARY[p[1]], p[0][1], p[2][1]))
    )
    calls = st.tuples(st.sampled_from(sorted(REAL)), children).map(
        lambda p: (f"{p[0]}({p[1][0]})", _call(p[0], p[1][1]))
    )
    powers = st.tuples(children, st.sampled_from([-3, -1, 0.5, 1.5, 2, 3])).map(
        lambda p: (f"({p[0][0]})**{p[1]}", _apply(math.pow, p[0][1], p[1]))
    )
    negatives = children.map(lambda p: (f"-({p[0]})", -p[1]))
    return st.one_of(sums, calls, powers, negatives)


_BINARY = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
}
expressions = st.recursive(atoms, _extend, max_leaves=8)
relaxed = settings(
    max_examples=150, suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much]
)


@relaxed
@given(expressions)
def test_value_agrees_with_direct_evaluation(case):
    text, expected = case
    assume(math.isfinite(expected) and abs(expected) < 1e8)
    try:
        expr = read(text)
    except InputError:
        return  # a constant part that is out of range, or has no real value
    assert value(expr) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@relaxed
@given(expressions)
def test_what_is_written_reads_back(case):
    try:
        expr = read(case[0])
    except InputError:
        return
    again = parse_expression(format_expression(expr), NAMES)
    # SymPy has two forms of a few constants, such as sqrt(10)*10**(1/4): equal numbers are enough there.
    assert again == expr or same_functions(again, [expr], NAMES[::2]) == [0]
    assert parse_expression(format_expression(again), NAMES) == again


def read_or_refused(text: str) -> bool:
    try:
        return isinstance(parse_expression(text, ["x", "x_dot", "θ", "θ_dot"]), sympy.Expr)
    except InputError as error:
        return "\n" not in str(error)


@relaxed
@given(st.text(alphabet="xyθ_dot0123456789.eE+-*/()^,= sincoexplg\u00b2\n'[]", max_size=60))
def test_any_text_is_read_or_refused(text):
    assert read_or_refused(text)


@settings(max_examples=150)
@given(st.text(max_size=100))
def test_unicode_noise_is_read_or_refused(text):
    assert read_or_refused(text)


# --- writing -----------------------------------------------------------------------------------------


def test_format_spells_our_grammar():
    assert format_expression(abs(X) ** 3) == "x**2*abs(x)"
    assert format_expression(sympy.E * X) == "exp(1)*x"
    assert format_expression(sympy.Float(0.1) * X) == "x/10"


@pytest.mark.parametrize("expr", [sympy.sinh(X), sympy.I * X, sympy.oo * X, X**X, sympy.nan, sympy.sign(X)])
def test_format_refuses_what_the_grammar_lacks(expr):
    with pytest.raises(InputError, match="cannot write"):
        format_expression(expr)


# --------------------------------------------------------------------------------------- names of coordinates
def test_good_names_come_back_in_order():
    names = ["theta1", "x", "θ", "φ_2", "größe", "x_ddot", "match", "a" * 64]
    assert check_coordinate_names(names) == tuple(names)
    assert check_coordinate_names("theta") == ("theta",)


def test_names_are_normalised():
    assert check_coordinate_names(["ϑ", "θ₁"]) == ("θ", "θ1")
    with pytest.raises(InputError, match="occurs twice"):
        check_coordinate_names(["ϑ", "θ"])


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("", "is not a name"),
        ("1x", "is not a name"),
        ("_x", "is not a name"),
        ("__class__", "is not a name"),
        ("a b", "is not a name"),
        ("a-b", "is not a name"),
        ("x;import os", "is not a name"),
        ("x'", "is not a name"),
        ('x"', "is not a name"),
        ("<script>", "is not a name"),
        ("x\n", "is not a name"),
        ("x\0", "is not a name"),
        ("q\u0307", "is not a name"),  # q with a combining dot
        ("x\u202e", "is not a name"),  # right-to-left override
        ("٣", "is not a name"),  # a digit, but no ASCII one
        ("a" * 65, "too long"),
        ("x" * 10**6, "too long"),
        ("lambda", "keyword"),
        ("None", "keyword"),
        ("sin", "function"),
        ("abs", "function"),
        ("pi", "reserved"),
        ("t", "reserved"),
        ("E", "reserved"),
        ("I", "reserved"),
        ("theta_dot", "velocity"),
        (3, "not text"),
        (None, "not text"),
    ],
)
def test_bad_names_are_refused_in_one_short_line(name, reason):
    with pytest.raises(InputError, match=reason) as caught:
        check_coordinate_names([name])
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 200


def test_no_names_and_no_sequence():
    with pytest.raises(InputError, match="is empty"):
        check_coordinate_names([])
    with pytest.raises(InputError, match="sequence of names"):
        check_coordinate_names(5)


@given(st.text(max_size=80))
def test_any_text_is_accepted_as_a_safe_identifier_or_refused(text):
    message = ""
    try:
        (name,) = check_coordinate_names([text])
    except InputError as error:
        message = str(error)
    if message:
        assert message.isprintable()
        return
    assert name.isidentifier()
    assert not keyword.iskeyword(name)
    assert name not in FUNCTION_NAMES | RESERVED_NAMES
    assert len(name) <= 64
    assert check_coordinate_names([name]) == (name,)


def test_quoted_survives_objects_that_print_badly():
    assert quoted(10**5000) == "<int>"
    assert "\n" not in quoted(np.zeros((3, 3)))


@given(st.text(), st.integers(8, 60))
def test_quoted_is_printable_and_never_longer_than_asked(text, limit):
    result = quoted(text, limit)
    assert len(result) <= limit
    assert result.isprintable()


# -------------- kinematic trees in place of a library: MJCF against hand and round trip, and what is refused
MJCF = """<mujoco model="pair"><compiler eulerseq="zyX"/><option gravity="0 1 -9"/>
<default><joint damping="0.2"/>
  <default class="slow"><joint armature="0.3" axis="0 1 0"/></default></default>
<worldbody><body name="stand" pos="0 0 1" euler="10 20 30"><geom size="0.1"/>
  <body name="upper" pos="0.1 0.2 0.3" axisangle="1 2 0 40" childclass="slow">
    <inertial pos="0.1 0 0" mass="2" diaginertia="0.02 0.03 0.025" quat="1 0.2 0.1 0.3"/>
    <joint name="j 1" pos="0.05 0 0.1" ref="25" range="-90 80" actuatorfrcrange="-9 8"/>
    <joint name="j2" type="slide" axis="1 1 0" ref="0.2" class="main" stiffness="3" springref="0.1"/>
    <body name="plate" pos="0.3 0 0" xyaxes="0 1 0 1 0 1">
      <inertial pos="0 0.1 0" mass="0.5" fullinertia="0.01 0.012 0.011 0.001 0.002 -0.001"/>
      <frame pos="0 0.1 0" euler="0 0 15"><body name="hand" zaxis="1 1 0.5">
        <joint name="j3" axis="1 0 0.2"/><site/>
        <inertial pos="0 0 0.2" mass="1" diaginertia="0.01 0.01 0.01"/></body></frame></body></body>
  <body name="side" pos="0 0.4 0"><joint name="j4" frictionloss="0.1" axis="1 0 0" damping="0"/>
    <inertial pos="0.2 0 0.1" mass="1.2" diaginertia="0.01 0.02 0.015"/></body>
</body></worldbody></mujoco>"""

# From MuJoCo 4.0.0, of the file above: mass matrix and bias (gravity, Coriolis) at this state.
STATE = [[0.3, -0.4, 0.7, 0.2], [0.5, 0.1, -0.8, 0.9]]
FROM_MUJOCO = {
    "mass": [
        [0.67083990188, -0.246330958017, 0.0238461825771, 0],
        [-0.246330958017, 3.5, -0.113323053494, 0],
        [0.0238461825771, -0.113323053494, 0.348461538462, 0],
        [0, 0, 0, 0.022],
    ],
    "bias": [5.66131131196, 0.0854191375698, 0.102970847064, -0.611848935096],
}


def axis_turn(axis, angle: float) -> np.ndarray:
    """A rotation as the exponential of its generator, by its series."""
    x, y, z = np.array(axis, float) / np.linalg.norm(axis)
    step = angle * np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out, term = np.eye(3), np.eye(3)
    for k in range(1, 40):
        term = term @ step / k
        out = out + term
    return out


def test_mjcf_agrees_with_mujoco(file):
    tree = la.Library.from_mjcf(file(MJCF, "arm.xml"))
    assert tree.coordinates == ("j_1", "j2", "j3", "j4")
    dynamics = tree.dynamics
    np.testing.assert_allclose(dynamics["rotor"], [0.3, 0.0, 0.3, 0.0])
    np.testing.assert_allclose(dynamics["viscous"], [0.2, 0.2, 0.2, 0.0])
    np.testing.assert_allclose(dynamics["offset"], [0.0, -0.3, 0.0, 0.0])
    np.testing.assert_allclose(tree.limits[0], [-np.pi / 2, np.deg2rad(80.0), np.nan, 8.0])
    model = arms.ArmModel.of_tree(tree, {"rotor": dynamics["rotor"]})
    q, qdot = np.array(STATE)
    np.testing.assert_allclose(model.mass_matrix(q)[0], FROM_MUJOCO["mass"], atol=1e-9)
    np.testing.assert_allclose(model.torques(q, qdot, 0.0 * q)[0], FROM_MUJOCO["bias"], atol=1e-9)


def test_a_joint_turns_about_its_own_point_from_its_reference(file):
    text = (
        '<mujoco><worldbody><body pos="1 0 0"><joint pos="0 2 0" axis="0 0 1" ref="30"/>'
        '<inertial pos="0.5 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    tree = arms.read_mjcf(file(text, "a.xml"), gravity=(0.0, -10.0, 0.0))
    angle = 0.9
    lever = axis_turn((0, 0, 1), angle - np.pi / 6) @ [0.5, -2.0, 0.0]
    torque = arms.ArmModel.of_tree(tree).gravity([[angle]])[0, 0]
    assert torque == pytest.approx(2.0 * 10.0 * lever[0])


def test_trees_survive_urdf_and_mjcf(file, tmp_path, rng):
    """URDF → tree → MJCF → tree: the same torques, friction and limits."""
    urdf = """<robot name="r"><link name="base"/><link name="a"><inertial>
      <origin xyz="0.1 0 0.2" rpy="1 0 2"/><mass value="2"/>
      <inertia ixx="0.03" iyy="0.02" izz="0.025"/></inertial></link>
      <link name="b"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.02" izz="0.02"/></inertial></link>
      <joint name="one" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 3 1"/>
        <origin xyz="0 0 0.2" rpy="0.3 -0.2 3"/><limit lower="-2" upper="1" effort="9" velocity="3"/>
        <dynamics damping="0.4" friction="0.1"/></joint>
      <joint name="two" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
        <origin xyz="0.3 0.1 0" rpy="3.1 0 1"/></joint></robot>"""
    first = la.Library.from_urdf(file(urdf, "r.urdf"), gravity=(0.0, 3.0, -9.0))
    arms.write_mjcf(first, tmp_path / "r.xml")
    again = la.Library.from_mjcf(tmp_path / "r.xml")
    assert (again.coordinates, again.links) == (first.coordinates, first.links)
    states = rng.normal(size=(3, 10, 2))
    smooth = [{k: v for k, v in t.dynamics.items() if k == "viscous"} for t in (first, again)]
    torques = [
        arms.ArmModel.of_tree(tree, kinds).torques(*states)
        for tree, kinds in zip((first, again), smooth, strict=True)
    ]
    np.testing.assert_allclose(*torques, atol=1e-9)
    np.testing.assert_allclose(again.dynamics["dry"], [0.1, 0.0])
    np.testing.assert_allclose(again.limits[0], [-2.0, 1.0, np.nan, 9.0])  # MuJoCo has no limit of speed
    np.testing.assert_allclose(first.limits[0, 2], 3.0)
    np.testing.assert_allclose(again.inertias, first.inertias, atol=1e-9)


def test_a_body_with_two_joints_survives_its_file(file, tmp_path, rng):
    tree = arms.read_mjcf(file(MJCF, "arm.xml"))
    arms.write_mjcf(tree, tmp_path / "out.xml")
    again = arms.read_mjcf(tmp_path / "out.xml")
    states = rng.normal(size=(3, 10, 4))
    torques = [arms.ArmModel.of_tree(t).torques(*states) for t in (tree, again)]
    np.testing.assert_allclose(*torques, atol=1e-9)


def test_named_joints_move_and_the_others_stay(file, rng):
    path = file(MJCF, "arm.xml")
    whole, part = arms.read_mjcf(path), arms.read_mjcf(path, joints=["j3", "j4"])
    assert part.coordinates == ("j3", "j4")
    q = rng.normal(size=(5, 2))
    at_reference = np.column_stack([np.full((5, 1), np.deg2rad(25.0)), np.full((5, 1), 0.2), q])
    torques = [
        arms.ArmModel.of_tree(whole).gravity(at_reference)[:, 2:],
        arms.ArmModel.of_tree(part).gravity(q),
    ]
    np.testing.assert_allclose(*torques, atol=1e-12)


def test_mass_that_geoms_would_give_is_unknown(file):
    text = MJCF.replace('<inertial pos="0 0 0.2" mass="1" diaginertia="0.01 0.01 0.01"/>', '<geom size="1"/>')
    tree = arms.read_mjcf(file(text, "arm.xml"))
    assert np.isnan(tree.inertias[2]).all()
    with pytest.raises(la.InputError, match="without inertia"):
        arms.write_mjcf(tree, "never.xml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<mujoco", "<!DOCTYPE x [<!ENTITY a 'b'>]><mujoco", "remove them"),
        ("<worldbody>", '<include file="x.xml"/><worldbody>', "mj_saveLastXML"),
        ("<site/>", "<composite/>", "holds <composite>"),
        ("<site/>", "<freejoint/>", "floats"),
        ('name="j3"', 'name="j3" type="ball"', "hinge and slide are supported"),
        ('name="j3"', 'name="j2"', "two joints 'j2'"),
        ('name="j3"', 'name="j3" class="fast"', "'fast', which no <default> defines"),
        ('name="j3"', 'name="j3" wobble="1"', "'wobble'"),
        ('name="j3"', 'name="j3" springdamper="1 2"', "stiffness and damping"),
        ('axis="1 0 0.2"', 'axis="0 0 0"', "without length"),
        ('eulerseq="zyX"', 'eulerseq="zyq"', "three of x"),
        ('eulerseq="zyX"', 'coordinate="global"', "global"),
        ('eulerseq="zyX"', 'settotalmass="3"', "changes masses"),
        ('xyaxes="0 1 0 1 0 1"', 'xyaxes="0 1 0 0 2 0"', "parallel"),
        ('zaxis="1 1 0.5"', 'zaxis="0 0 0"', "no length"),
        ('zaxis="1 1 0.5"', 'zaxis="1 1 0.5" quat="1 0 0 0"', "keep one"),
        ('mass="1"', 'mass="heavy"', "1 finite number"),
        ('name="side"', 'name="side" gravcomp="1"', "gravcomp"),
        ("</worldbody>", '</worldbody><equality><joint joint1="j3" joint2="j4"/></equality>', "couples"),
        ("</worldbody>", '</worldbody><equality><connect body1="hand"/></equality>', "closes a loop"),
        ("</worldbody>", '</worldbody><tendon><fixed stiffness="2"/></tendon>', "remove the tendon"),
        ("mujoco", "robot", "for from_urdf"),
    ],
)
def test_what_is_not_supported_is_refused_in_one_line(file, old, new, words):
    assert old in MJCF
    assert_refused_in_one_line(arms.read_mjcf, file(MJCF.replace(old, new), "arm.xml"), words)


def test_a_library_has_the_names_of_the_geometry():
    table = [{"a": 0.3}, {"a": 0.2, "alpha": 0.4}]
    ours = la.Library.from_joints(table, modified=True)
    theirs = arms.KinematicTree.from_dh(table, modified=True)
    for a, b in zip(ours.joints, theirs.joints, strict=True):
        np.testing.assert_array_equal(a.rotation, b.rotation)
    axes = la.Library.from_joints(
        [{"axis": (0, 1, 0)}, {"kind": "prismatic"}], base_rpy=(0.0, np.pi / 2, 0.0)
    )
    np.testing.assert_allclose(axes.gravity, [9.81, 0.0, 0.0], atol=1e-12)
    log = la.Trajectory(np.arange(5.0), np.zeros((5, 2)), coordinates=axes.coordinates)
    with pytest.raises(la.InputError, match="leastaction"):
        la.discover(log, axes)  # pyright: ignore[reportArgumentType]


# -------------------------------------------------------------------------------------------------- reduction
def symbols(coordinates):
    q = [sympy.Symbol(c, real=True) for c in coordinates]
    qdot = [sympy.Symbol(f"{c}_dot", real=True) for c in coordinates]
    qddot = [sympy.Symbol(f"{c}_dot_dot", real=True) for c in coordinates]
    return q, qdot, qddot


def euler_lagrange(term: Term, coordinates) -> list[sympy.Expr]:
    """Independent of the package: symbolic derivatives."""
    q, qdot, qddot = symbols(coordinates)
    if term.kind == "dissipation":
        return [sympy.diff(term.expr, v) for v in qdot]
    out = []
    for x, v in zip(q, qdot, strict=True):
        momentum = sympy.diff(term.expr, v)
        rate = sum(sympy.diff(momentum, b) * c for b, c in zip(qdot, qddot, strict=True))
        rate += sum(sympy.diff(momentum, a) * b for a, b in zip(q, qdot, strict=True))
        out.append(rate - sympy.diff(term.expr, x))
    return out


def columns(terms, coordinates, seed=3, n_points=60) -> np.ndarray:
    """Normalised columns of all terms at random positive states, (rows, terms)."""
    q, qdot, qddot = symbols(coordinates)
    states = np.random.default_rng(seed).uniform(0.3, 2.0, (3 * len(coordinates), n_points))
    out = []
    for term in terms:
        function = sympy.lambdify([*q, *qdot, *qddot], euler_lagrange(term, coordinates), "numpy")
        out.append(np.concatenate([np.broadcast_to(v, n_points) for v in function(*states)]))
    matrix = np.array(out, dtype=float).T
    return matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)


def reduced(texts, coordinates, **options):
    library = Library(texts, coordinates).reduced(**options)
    kept = [term.text for term in library]
    return kept, {d.term.text: (d.reason, d.because) for d in library.dropped}


# --- derivatives -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "x_dot**2*y",
        "x*y_dot*sin(x*y)",
        "exp(-x*y_dot)/x",
        "log(x**2+1)*y_dot**3",
        "sqrt(x_dot**2+y_dot**2+1)",
        "tan(x/3)*x_dot*y_dot",
        "abs(x-y)*x_dot**2",
        "cos(x-2*y)*x**-2.5*y_dot**2",
        "exp(1)*pi*x_dot**2/7",
        "(x+y_dot)**pi",
    ],
)
@pytest.mark.parametrize("kind", ["lagrangian", "dissipation"])
@pytest.mark.parametrize("digits", [None, 40])
def test_jets_agree_with_symbolic_derivatives(text, kind, digits, rng):
    coordinates = ["x", "y"]
    term = Term(text, Library([text], coordinates)[0].expr, kind)
    states = rng.uniform(0.3, 2.0, (3, 2, 5))
    points = Points(*states)
    effect = Jets(coordinates, points if digits is None else points.with_digits(digits)).effect(term)
    q, qdot, qddot = symbols(coordinates)
    for i, expected in enumerate(euler_lagrange(term, coordinates)):
        function = sympy.lambdify([*q, *qdot, *qddot], expected.doit(), "numpy")
        np.testing.assert_allclose(
            effect[i].astype(float), function(*states.reshape(6, 5)), rtol=1e-9, atol=1e-11
        )


# --- null terms --------------------------------------------------------------------------------------


def test_null_terms():
    texts = ["a_dot**2", "1", "sin(1)", "a_dot", "a*a_dot", "a_dot*cos(a)", "a_dot*b+a*b_dot", "a_dot*b"]
    texts += ["sin(a)**2+cos(a)**2", "b_dot/b", "2*a*b*a_dot+a**2*b_dot"]
    kept, dropped = reduced(texts, ["a", "b"])
    assert kept == ["a_dot**2", "a_dot*b"]
    assert dropped["1"] == ("null", "constant")
    assert dropped["sin(a)**2+cos(a)**2"] == ("null", "constant")
    assert dropped["a_dot*cos(a)"] == ("null", "total time derivative")
    assert {reason for reason, _ in dropped.values()} == {"null"}


@settings(max_examples=40)
@given(
    st.sampled_from(["x**3*y", "sin(x-y)", "exp(x)*cos(y)", "log(x)*y", "sqrt(x+y)", "x/y", "tan(x)*y**2"])
)
def test_every_total_derivative_is_null(potential):
    q, qdot, _ = symbols(["x", "y"])
    function = Library([potential], ["x", "y"])[0].expr
    derivative = sum(sympy.diff(function, a) * b for a, b in zip(q, qdot, strict=True))
    library = Library([derivative, "x_dot**2", derivative + q[0]], ["x", "y"]).reduced()
    assert library.dropped[0].reason == "null"
    assert library.index("x_dot**2") == 0
    assert len(library) == 2


def test_nothing_left():
    with pytest.raises(InputError, match="no term of the library has an effect"):
        Library(["1", "x_dot"], ["x"]).reduced()


# --- duplicates and dependencies ---------------------------------------------------------------------


def test_duplicates_up_to_a_factor():
    kept, dropped = reduced(["cos(x)", "2*cos(x)", "1-cos(x)", "x_dot**2/2", "-x_dot**2", "x", "x+3"], ["x"])
    assert kept == ["cos(x)", "x_dot**2/2", "x"]
    assert dropped["2*cos(x)"] == ("duplicate", "equals 2*cos(x)")
    assert dropped["1-cos(x)"] == ("duplicate", "equals -cos(x) up to a null term")
    assert dropped["-x_dot**2"] == ("duplicate", "equals -2*x_dot**2/2")
    assert dropped["x+3"] == ("duplicate", "equals x up to a null term")


@pytest.mark.parametrize("seed", range(5))
def test_constant_forces_need_no_luck(seed):
    terms = Library(["x", "x+pi", "y_dot**2", "y"], ["x", "y"]).terms
    assert list(find_redundant(terms, ["x", "y"], seed=seed)) == [1]


def test_dependencies():
    texts = ["a_dot**2", "a_dot**2*sin(a)**2", "a_dot**2*cos(a)**2", "cos(2*a)", "sin(a)**2", "cos(a)**2"]
    kept, dropped = reduced(texts, ["a"])
    assert kept == ["a_dot**2", "a_dot**2*sin(a)**2", "cos(2*a)"]
    assert dropped["a_dot**2*cos(a)**2"] == ("dependent", "equals a_dot**2 - a_dot**2*sin(a)**2")
    assert dropped["cos(a)**2"] == ("duplicate", "equals (1/2)*cos(2*a) up to a null term")


def test_integration_by_parts():
    kept, dropped = reduced(["x*y_dot", "y*x_dot", "x*y_dot-y*x_dot", "x_dot*x*y", "x**2*y_dot"], ["x", "y"])
    assert kept == ["x*y_dot", "x_dot*x*y"]
    assert dropped["y*x_dot"] == ("duplicate", "equals -x*y_dot up to a null term")
    assert dropped["x**2*y_dot"] == ("duplicate", "equals -2*x_dot*x*y up to a null term")


def test_addition_theorems_and_brackets_in_messages():
    texts = ["cos(a)*cos(b)", "sin(a)*sin(b)", "cos(a-b)", "x**2+cos(a)", "x**2", "2*cos(a)"]
    kept, dropped = reduced(texts, ["a", "b", "x"])
    assert kept == texts[:2] + texts[3:5]
    assert dropped["cos(a-b)"][1] == "equals cos(a)*cos(b) + sin(a)*sin(b)"
    assert dropped["2*cos(a)"][1] == "equals 2*(x**2+cos(a)) - 2*x**2"


def test_kept_terms_stay_where_there_is_a_choice():
    texts = ["a_dot**2", "a_dot**2*sin(a)**2", "a_dot**2*cos(a)**2", "cos(a)", "3*cos(a)"]
    kept, dropped = reduced(texts, ["a"], keep=["a_dot**2*cos(a)**2", "3*cos(a)"])
    assert kept == ["a_dot**2", "a_dot**2*cos(a)**2", "3*cos(a)"]
    assert dropped["cos(a)"] == ("duplicate", "equals (1/3)*3*cos(a)")
    assert reduced(texts, ["a"], keep="3*cos(a)")[0][-1] == "3*cos(a)"
    with pytest.raises(InputError, match="not among"):
        reduced(texts, ["a"], keep=["a"])


def test_absolute_values_are_not_what_they_are_on_one_side():
    kept, _ = reduced(["x_dot**2", "x", "abs(x)", "x**2", "x*abs(x)", "abs(x_dot)*x_dot"], ["x"])
    assert len(kept) == 6


def test_domains():
    # log(x) and log(-x) share no states, and log(x-9) has none at all among the random ones
    texts = ["x_dot**2", "log(x)", "log(x**2)", "sqrt(x)", "log(x-9)", "log(-x)", "x", "2*log(-x)"]
    kept, dropped = reduced(texts, ["x"])
    assert list(dropped) == ["log(x**2)", "2*log(-x)"]
    assert "log(x-9)" in kept


def test_overflow_is_no_trouble():
    texts = [
        "exp(283*x)",
        "x",
        "x**32",
        "x**32*exp(20*x)",
        "2*exp(283*x)",
        "x_dot**2/x**30",
        "exp(exp(exp(x)))",
    ]
    assert list(reduced(texts, ["x"])[1]) == ["2*exp(283*x)"]


def test_dissipation_is_examined_with_the_rest():
    library = Library(
        ["v_dot**2", "v**2"],
        ["v"],
        dissipation=["v_dot**2", "v_dot**2/2", "v", "v*v_dot", "abs(v_dot)", "v_dot**2*v**2"],
    ).reduced(keep=["v_dot**2/2"])
    # v*v_dot is the force v, which a spring gives too
    assert [term.text for term in library.dissipation] == ["v_dot**2/2", "abs(v_dot)", "v_dot**2*v**2"]
    because = {dropped.term.text: dropped.because for dropped in library.dropped}
    assert because == {
        "v_dot**2": "equals 2*v_dot**2/2",
        "v": "no force: it does not depend on a velocity",
        "v*v_dot": "gives the same equations as -(1/2)*v**2",
    }


# --- nearly collinear families -----------------------------------------------------------------------


def test_powers_beside_log_and_inverse_powers_all_stay():
    texts = ["x_dot**2", "log(x)", "exp(x)", "exp(-x)", "sqrt(x)"]
    texts += [f"x**{n}" for n in range(1, 7)] + [f"x**-{n}" for n in range(1, 7)]
    assert reduced(texts, ["x"])[1] == {}


def test_harmonics_beside_even_powers_all_stay():
    texts = ["x_dot**2"] + [f"cos({n}*x)" for n in range(1, 9)] + [f"x**{2 * n}" for n in range(1, 9)]
    assert reduced(texts, ["x"])[1] == {}


@pytest.mark.thorough
def test_true_dependencies_are_found_among_nearly_collinear_terms():
    texts = [f"cos({n}*x)" for n in range(1, 12)] + [f"x**{n}" for n in range(1, 11)]
    texts += [f"exp({n}*x)" for n in range(1, 8)] + [f"cos(x)**{n}" for n in range(2, 12)]
    kept, dropped = reduced(texts, ["x"])
    assert list(dropped) == [f"cos(x)**{n}" for n in range(2, 12)]
    assert len(kept) == 28
    assert dropped["cos(x)**3"][1] == "equals (3/4)*cos(1*x) + (1/4)*cos(3*x)"


def test_smoothed_friction_beside_the_sharp_one():
    library = Library(["x_dot**2"], ["x"], dissipation=["abs(x_dot)", "sqrt(x_dot**2+1e-10)"])
    assert len(library.reduced().dissipation) == 2


# --- against linear algebra --------------------------------------------------------------------------

ANGLE_FACTORS = ["1", "cos(a)", "sin(a)", "cos(a)**2", "sin(a)**2", "cos(2*a)", "sin(2*a)", "sin(a)*cos(a)"]
CANDIDATES = [f"{v}*{f}" for v in ("a_dot**2", "a_dot*x_dot", "x_dot**2", "x_dot") for f in ANGLE_FACTORS]
CANDIDATES += [*ANGLE_FACTORS, "x*a_dot", "a*x_dot", "x", "x+1", "2*x", "x**2", "(x-1)**2", "x*x_dot"]


@settings(max_examples=30)
@given(st.lists(st.sampled_from(CANDIDATES), min_size=2, max_size=20, unique=True))
def test_rest_is_independent_and_spans_the_same(texts):
    library = Library([*texts, "a_dot**4"], ["a", "x"])
    small = library.reduced()
    full_rank = np.linalg.matrix_rank(columns(library.terms, library.coordinates), tol=1e-9)
    small_rank = np.linalg.matrix_rank(columns(small.terms, small.coordinates), tol=1e-9)
    assert small_rank == len(small) == full_rank
    assert len(small) + len(small.dropped) == len(texts) + 1
    assert small.reduced() == small


@pytest.mark.parametrize("n_dof", [2, 3])
def test_large_libraries_take_a_moment(n_dof):
    names = ["a", "b", "c"][:n_dof]
    factors = ["1", *(f"{g}({c})**{n}" for g in ("sin", "cos") for c in names for n in (1, 2))]
    factors += [f"{g}({c}-{d})" for g in ("sin", "cos") for c, d in itertools.combinations(names, 2)]
    factors += [
        f"{g}({c})*{h}({d})"
        for c, d in itertools.combinations(names, 2)
        for g in ("sin", "cos")
        for h in ("sin", "cos")
    ]
    texts = [
        f"{u}_dot*{v}_dot*{f}" for u, v in itertools.combinations_with_replacement(names, 2) for f in factors
    ]
    library = Library(texts, names)
    start = time.process_time()
    small = library.reduced()
    assert time.process_time() - start < 2.0  # 0.1 s on an idle core
    # per pair of velocities: cos(c)**2 for each c, and two of the six products for each pair of angles
    n_pairs = n_dof * (n_dof + 1) // 2
    assert len(small.dropped) == n_pairs * (n_dof + 2 * n_dof * (n_dof - 1) // 2)


def test_terms_with_the_time_are_told_from_functions_of_the_time_alone():
    texts = ["x_dot**2", "cos(3*t)", "t", "x*cos(3*t)", "x_dot*sin(3*t)", "t*x", "x**2*cos(3*t)", "x*x_dot*t"]
    library = Library([*texts, "x**2", "x_dot**2*exp(-t/2)", "x*cos({w}*t)", "x_dot*sin({w}*t)"], "x")
    small = library.reduced()
    left_out = {d.term.text: (d.reason, d.because) for d in small.dropped}
    assert left_out == {
        "cos(3*t)": ("null", "total time derivative"),
        "t": ("null", "total time derivative"),
        "x_dot*sin(3*t)": ("duplicate", "equals -3*x*cos(3*t) up to a null term"),
        "x**2": ("duplicate", "equals -2*x*x_dot*t up to a null term"),
        "x_dot*sin({w}*t)": ("duplicate", left_out["x_dot*sin({w}*t)"][1]),
    }
    assert small.index("x*cos(-3*t)") == 1


def test_the_time_is_no_parameter_and_no_shape():
    with pytest.raises(InputError, match="parameter 't' has the name of something else"):
        Library(["x_dot**2"], "x", parameters={"t": 1.0})
    with pytest.raises(InputError, match="'t' is the name of something else"):
        Library(["x*{t}"], "x")
    with pytest.raises(InputError, match="the exponent must be a number"):
        Library(["x**t"], "x")
    with pytest.raises(
        InputError, match=r"<coordinate>_dot, the time t, a shape parameter in braces such as \{a\}, or pi"
    ):
        Library(["zzz"], "x")


# ----------------------------------------- shape parameters: reading braces, numbers in their place, tangents
PLANE = ["x", "y", "x_dot", "y_dot"]
XS, Y = (np.linspace(0.4, 1.9, 7), np.linspace(-1.2, 0.7, 7))
TEMPLATES = [
    "exp(-{a}*x)",
    "exp({a}*x)",
    "exp(-2*{a}*x)",
    "x**{a}",
    "x**-{a}",
    "x**(-{a})",
    "x/(x+{a}**2)",
    "cos(x-{a})*y",
    "cos(-{a}+x)",
    "sqrt((x-{a})**2+(y+{b})**2)",
    "sqrt((x-{a})**2+(y-{b})**2+1)*x_dot",
    "-{a}**2*x+x**2",
    "x*x+{a}*x",
    "(-{a}+y)**2*x+{a}*{b}*x*y",
    "exp(-(x-{a})**2/(2*{b}**2))",
    "1/(1+exp(-{a}*(x-{b})))",
    "x_dot*sin({ a } * x - { b })",
    "sin(x+-{a})",
    "sin(x*-{a})",
]
not_small = st.floats(-5.0, 5.0).filter(lambda v: abs(v) > 1e-6)


def values_of(expr: sympy.Expr) -> np.ndarray:
    symbols = sympy.symbols(PLANE, real=True)
    with np.errstate(all="ignore"):
        out = sympy.lambdify(symbols, expr, modules="numpy")(XS, Y, 0.7 * XS, 1.3 * Y)
    return np.broadcast_to(np.asarray(out, dtype=float), XS.shape)


# ------------------------------------------------------------------------------------- reading
def test_braces_name_a_number_that_is_no_coordinate():
    term = make_term("sqrt((x-{p})**2 + (y-{r})**2)", PLANE)
    assert term.text == "sqrt((x-{p})**2+(y-{r})**2)"
    assert term.shapes == ("p", "r")
    assert shape_symbol("p") in term.expr.free_symbols
    assert make_term("cos(x)", PLANE).shapes == ()
    assert make_term("cos({ k } * x)", PLANE).text == "cos({k}*x)"
    assert shape_names([term, make_term("cos({k}*x)", PLANE), make_term("x", PLANE)]) == ("k", "p", "r")


def test_equal_functions_of_shapes_are_one_term():
    library = Library(["x_dot**2", "exp(-{a}*x)", "exp(-x*{a})", "exp(-{b}*x)"], ["x"])
    assert [t.text for t in library] == ["x_dot**2", "exp(-{a}*x)", "exp(-{b}*x)"]
    assert library.shapes == ("a", "b")
    assert library.index("exp(-x*{b})") == 2
    with pytest.raises(InputError, match="not among the 3 lagrangian terms"):
        library.index("exp(-{c}*x)")


def test_numbers_of_the_user_stand_beside_shapes():
    library = Library(["m*x_dot**2/2", "exp(-m*{a}*x)"], ["x"], parameters={"m": 3.0})
    assert [t.text for t in library] == ["3*x_dot**2/2", "exp(-3*x*{a})"]
    assert make_term(library[1].text, PLANE).expr == library[1].expr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("exp(-{x}*x)", "'x' is the name of something else"),
        ("exp(-{x_dot}*x)", "'x_dot' is the name of something else"),
        ("exp(-{sin}*x)", "'sin' is the name of something else"),
        ("exp(-{pi}*x)", "'pi' is the name of something else"),
        ("exp(-{2}*x)", "braces hold the name of a shape parameter"),
        ("exp(-{}*x)", "braces hold the name of a shape parameter"),
        ("exp(-{a b}*x)", "braces hold the name of a shape parameter"),
        ("exp(-{a*x)", "braces hold the name of a shape parameter"),
        ("exp(-a}*x)", "unknown name 'a'"),
        ("exp({a}x)", "an operator is missing"),
        ("x{a}", "an operator is missing"),
        ("x**x", "the exponent must be a number"),
        ("x**({a}*y)", "the exponent must be a number"),
        ("x**33", "the exponent is out of range"),
    ],
)
def test_what_cannot_be_read_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        make_term(text, PLANE)


def test_braces_belong_to_libraries_only():
    with pytest.raises(InputError, match="is allowed in a library only; write a number"):
        parse_expression("exp(-{a}*x)", ["x"])


@pytest.mark.parametrize(
    "text", ["{a}*x", "{a}*x**2*x_dot", "exp({a}+x)", "x/{a}", "({a}*x)**2", "x**2*{a}**3"]
)
def test_a_number_that_only_scales_is_refused(text):
    with pytest.raises(InputError, match=r"\{a\} only scales the term"):
        Library(["x_dot**2", text], ["x"])


@pytest.mark.parametrize("text", ["x**2+{a}*x", "x**{a}", "cos({a}*x)", "({a}+x)**3", "exp(x-{a}*x_dot)"])
def test_a_number_that_changes_the_form_is_kept(text):
    assert Library(["x_dot**2", text], ["x"]).shapes == ("a",)


# ----------------------------------------------------------------------------------- numbers in place
@pytest.mark.parametrize("text", TEMPLATES)
@settings(max_examples=8)  # every template has its own
@given(a=not_small, b=not_small)
def test_text_and_expression_are_the_same_with_any_numbers(text, a, b):
    term = make_term(text, PLANE)
    put = term.at({"a": a, "b": b})
    assert "{" not in put.text
    assert not [s for s in put.expr.free_symbols if s.name.startswith("{")]
    assert put.shapes == term.shapes
    read = values_of(parse_expression(put.text, PLANE))
    by_hand = values_of(term.expr.xreplace({shape_symbol("a"): a, shape_symbol("b"): b}))
    for found in (values_of(put.expr), read):
        np.testing.assert_allclose(found, by_hand, rtol=1e-8, atol=1e-9, equal_nan=True)


def test_minus_signs_are_taken_up():
    def text(template: str, a: float) -> str:
        return make_term(template, PLANE).at({"a": a}).text

    assert text("exp(-{a}*x)", 0.5) == "exp(-0.5*x)"
    assert text("exp(-{a}*x)", -0.5) == "exp(0.5*x)"
    assert text("cos(x-{a})", -0.5) == "cos(x+0.5)"
    assert text("cos(x+{a})", -0.5) == "cos(x-0.5)"
    assert text("x**{a}", -2.0) == "x**(-2.0)"
    assert text("x-{a}**2*x**2", -2.0) == "x-(-2.0)**2*x**2"


def test_a_number_keeps_twelve_digits():
    assert make_term("exp(-{a}*x)", PLANE).at({"a": 1 / 3}).text == "exp(-0.333333333333*x)"


def test_numbers_can_be_changed_one_by_one():
    term = make_term("sqrt((x-{a})**2+(y-{b})**2)", PLANE)
    first = term.at({"a": 1.0, "b": 2.0})
    moved = first.at({"b": 3.0})
    assert moved == term.at({"a": 1.0, "b": 3.0})
    assert moved.template is not None
    assert moved.template.term is term
    assert dict(moved.template.values) == {"a": 1.0, "b": 3.0}
    plain = make_term("cos(x)", PLANE)
    assert plain.at({"a": 1.0}) is plain
    with pytest.raises(KeyError, match="b"):
        term.at({"a": 1.0})


def test_a_library_with_numbers():
    library = Library(["x_dot**2", "exp(-{a}*x)"], ["x"], dissipation=["exp(-{b}*x)*x_dot**2"])
    assert library.shapes == ("a", "b")
    put = library.at({"a": 0.5, "b": 2.0})
    assert [t.text for t in (*put, *put.dissipation)] == ["x_dot**2", "exp(-0.5*x)", "exp(-2.0*x)*x_dot**2"]
    with pytest.raises(InputError, match="shape parameter 'b' of the library has no value"):
        library.at({"a": 0.5})


# ------------------------------------------------------------------------------------------ tangents
@pytest.mark.parametrize("name", ["a", "b"])
def test_tangent_is_the_derivative_by_the_number(name):
    texts = ["exp(-{a}*x)", "cos(x-{b})*exp({a}*y)", "y**2", "x**{a}", "sqrt((x-{a})**2+(y-{b})**2)"]
    library = [make_term(t, PLANE) for t in texts]
    at = {"a": 0.7, "b": -0.4}
    weights = [1.5, -2.0, 3.0, 0.3, -0.8]

    def total(step: float) -> np.ndarray:
        moved = [t.at({**at, name: at[name] + step}) for t in library]
        return sum(w * values_of(t.expr) for w, t in zip(weights, moved, strict=True))

    found = tangent([t.at(at) for t in library], weights, name)
    expected = (total(1e-4) - total(-1e-4)) / 2e-4
    np.testing.assert_allclose(values_of(found.expr), expected, rtol=1e-6, atol=1e-8)
    assert found.kind == "lagrangian"


def test_the_template_of_a_tangent_serves_every_step():
    decay = make_term("exp(-{a}*x)", PLANE)
    one, other = (tangent([decay.at({"a": a})], [w], "a") for a, w in ((0.5, 3.0), (0.8, -1.0)))
    assert one.template is not None
    assert other.template is not None
    assert one.template.term == other.template.term
    assert one != other


# ----------------------------------------------------------------------------------------- reduction
def test_reduction_looks_through_shapes():
    """What is redundant for any numbers goes, what is so for some numbers only stays."""
    texts = [
        "x_dot**2",
        "x",
        "x**2",
        "exp(-{a}*x)",
        "3*exp(-{a}*x)",
        "exp(-{b}*x)",
        "x**{n}",
        "(x-{p})**2",
        "{p}*x*x_dot+x_dot",
    ]
    library = Library(texts, ["x"])
    reduced = library.reduced()
    assert [t.text for t in reduced] == ["x_dot**2", "x", "x**2", "exp(-{a}*x)", "exp(-{b}*x)", "x**{n}"]
    assert {d.term.text: d.reason for d in reduced.dropped} == {
        "3*exp(-{a}*x)": "duplicate",
        "(x-{p})**2": "dependent",
        "{p}*x*x_dot+x_dot": "null",
    }


def test_terms_with_shapes_may_be_kept():
    library = Library(["x_dot**2", "x", "x**2", "(x-{p})**2"], ["x"])
    kept = library.reduced(keep=["(x-{p})**2"])
    assert "(x-{p})**2" in [t.text for t in kept]
    assert isinstance(kept[0], Term)


# --------------------------------------------------------------- terms that differ in names alone
CENTRE = "1/sqrt((x-{{{}}})**2+(y-{{{}}})**2+{{h}}**2)"


def test_three_centres_are_one_kind():
    texts = [CENTRE.format("p", "q"), "exp(-{a}*x)", CENTRE.format("r", "s"), CENTRE.format("u", "v")]
    kinds = alike([make_term(text, PLANE) for text in texts])
    assert kinds == [
        {0: {"p": "p", "q": "q"}, 2: {"p": "r", "q": "s"}, 3: {"p": "u", "q": "v"}},
        {1: {}},
    ]


@pytest.mark.parametrize(
    "texts",
    [
        ["x**{m}", "y**{n}"],  # other coordinates
        ["x**{m}", "x_dot**2*x**{m}", "x**{n}"],  # m stands elsewhere, too
        ["sin({a}*x)", "cos({b}*x)"],
    ],
)
def test_other_terms_are_kinds_of_their_own(texts):
    terms = [make_term(text, PLANE) for text in texts]
    assert alike(terms) == [{k: {}} for k in range(len(terms))]
    assert exchanges(terms) == []


def test_terms_of_energy_and_of_dissipation_are_no_exchange():
    pair = [
        make_term("x_dot**2*exp(-{a}*x)", PLANE),
        make_term("x_dot**2*exp(-{b}*x)", PLANE, kind="dissipation"),
    ]
    assert alike(pair) == [{0: {}}, {1: {}}]
    assert exchanges(pair) == []
