"""Reduction (null terms, duplicates, dependencies) against SymPy's derivatives; shape parameters in terms."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from leastaction.errors import InputError
from leastaction.library import (
    Library,
    Term,
    alike,
    exchanges,
    make_term,
    parse_expression,
    shape_names,
    shape_symbol,
    tangent,
)
from leastaction.library.jets import Jets, Points
from leastaction.library.reduction import find_redundant


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
    with pytest.raises(InputError, match="a velocity <coordinate>_dot, the time t, a parameter or pi"):
        Library(["zzz"], "x")


# ----------------------------------------- shape parameters: reading braces, numbers in their place, tangents
NAMES = ["x", "y", "x_dot", "y_dot"]
X, Y = (np.linspace(0.4, 1.9, 7), np.linspace(-1.2, 0.7, 7))
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
numbers = st.floats(-5.0, 5.0).filter(lambda v: abs(v) > 1e-6)


def values_of(expr: sympy.Expr) -> np.ndarray:
    symbols = sympy.symbols(NAMES, real=True)
    with np.errstate(all="ignore"):
        out = sympy.lambdify(symbols, expr, modules="numpy")(X, Y, 0.7 * X, 1.3 * Y)
    return np.broadcast_to(np.asarray(out, dtype=float), X.shape)


# ------------------------------------------------------------------------------------- reading
def test_braces_name_a_number_that_is_no_coordinate():
    term = make_term("sqrt((x-{p})**2 + (y-{r})**2)", NAMES)
    assert term.text == "sqrt((x-{p})**2+(y-{r})**2)"
    assert term.shapes == ("p", "r")
    assert shape_symbol("p") in term.expr.free_symbols
    assert make_term("cos(x)", NAMES).shapes == ()
    assert make_term("cos({ k } * x)", NAMES).text == "cos({k}*x)"
    assert shape_names([term, make_term("cos({k}*x)", NAMES), make_term("x", NAMES)]) == ("k", "p", "r")


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
    assert make_term(library[1].text, NAMES).expr == library[1].expr


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
        make_term(text, NAMES)


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
@given(a=numbers, b=numbers)
def test_text_and_expression_are_the_same_with_any_numbers(text, a, b):
    term = make_term(text, NAMES)
    put = term.at({"a": a, "b": b})
    assert "{" not in put.text
    assert not [s for s in put.expr.free_symbols if s.name.startswith("{")]
    assert put.shapes == term.shapes
    read = values_of(parse_expression(put.text, NAMES))
    by_hand = values_of(term.expr.xreplace({shape_symbol("a"): a, shape_symbol("b"): b}))
    for found in (values_of(put.expr), read):
        np.testing.assert_allclose(found, by_hand, rtol=1e-8, atol=1e-9, equal_nan=True)


def test_minus_signs_are_taken_up():
    def text(template: str, a: float) -> str:
        return make_term(template, NAMES).at({"a": a}).text

    assert text("exp(-{a}*x)", 0.5) == "exp(-0.5*x)"
    assert text("exp(-{a}*x)", -0.5) == "exp(0.5*x)"
    assert text("cos(x-{a})", -0.5) == "cos(x+0.5)"
    assert text("cos(x+{a})", -0.5) == "cos(x-0.5)"
    assert text("x**{a}", -2.0) == "x**(-2.0)"
    assert text("x-{a}**2*x**2", -2.0) == "x-(-2.0)**2*x**2"


def test_a_number_keeps_twelve_digits():
    assert make_term("exp(-{a}*x)", NAMES).at({"a": 1 / 3}).text == "exp(-0.333333333333*x)"


def test_numbers_can_be_changed_one_by_one():
    term = make_term("sqrt((x-{a})**2+(y-{b})**2)", NAMES)
    first = term.at({"a": 1.0, "b": 2.0})
    moved = first.at({"b": 3.0})
    assert moved == term.at({"a": 1.0, "b": 3.0})
    assert moved.template is not None
    assert moved.template.term is term
    assert dict(moved.template.values) == {"a": 1.0, "b": 3.0}
    plain = make_term("cos(x)", NAMES)
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
    library = [make_term(t, NAMES) for t in texts]
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
    decay = make_term("exp(-{a}*x)", NAMES)
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
    kinds = alike([make_term(text, NAMES) for text in texts])
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
    terms = [make_term(text, NAMES) for text in texts]
    assert alike(terms) == [{k: {}} for k in range(len(terms))]
    assert exchanges(terms) == []


def test_terms_of_energy_and_of_dissipation_are_no_exchange():
    pair = [
        make_term("x_dot**2*exp(-{a}*x)", NAMES),
        make_term("x_dot**2*exp(-{b}*x)", NAMES, kind="dissipation"),
    ]
    assert alike(pair) == [{0: {}}, {1: {}}]
    assert exchanges(pair) == []
