"""Shape parameters in candidates: reading braces, numbers in their place, tangents."""

from __future__ import annotations

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
    with pytest.raises(InputError, match="has its place in a library; write a number"):
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
    with pytest.raises(InputError, match="no number for the shape parameter 'b'"):
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
