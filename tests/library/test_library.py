"""Libraries: construction, files, generated families, look-up, smoothing of |u|."""

from __future__ import annotations

import pickle
import time

import pytest
import sympy

from leastaction.errors import InputError
from leastaction.library import Library, Term, make_term, parse_expression, smooth_abs
from leastaction.library.families import SIZES

X, X_DOT = sympy.symbols("x x_dot", real=True)


# --- construction ------------------------------------------------------------------------------------


def test_terms_keep_text_and_order():
    library = Library([" x_dot ** 2 ", "cos( x )", "x"], ["x"])
    assert [term.text for term in library] == ["x_dot**2", "cos(x)", "x"]
    assert [term.kind for term in library] == ["lagrangian"] * 3
    assert library.coordinates == ("x",)
    assert library.velocities == ("x_dot",)
    assert library.n_dof == 1
    assert library[0] is library.terms[0]
    assert [term.text for term in library[1:]] == ["cos(x)", "x"]


def test_repeated_expressions_keep_the_first():
    library = Library(["x**2", "cos(x)", "x*x", "cos(-x)"], ["x"])
    assert [term.text for term in library] == ["x**2", "cos(x)"]
    assert [str(d) for d in library.dropped] == ["x*x: equals x**2", "cos(-x): equals cos(x)"]
    assert {d.reason for d in library.dropped} == {"duplicate"}


def test_accepts_sympy_and_terms():
    plain = sympy.Symbol("x")  # not declared real: taken by its name
    library = Library([X_DOT**2 / 2, sympy.cos(plain), Term("x", X)], ["x"])
    assert [term.text for term in library] == ["x_dot**2/2", "cos(x)", "x"]
    assert library[1].expr == sympy.cos(X)
    with pytest.raises(InputError, match="sinh"):
        Library([sympy.sinh(X)], ["x"])
    with pytest.raises(InputError, match="unknown name 'y'"):
        Library([sympy.Symbol("y")], ["x"])
    with pytest.raises(InputError, match="unknown name 'x'"):
        Library([Term("x", X)], ["y"])


def test_parameters_are_put_into_the_text():
    library = Library(["m*x_dot**2/2", "x"], ["x"], parameters={"m": 3.0})
    assert library[0].text == "3*x_dot**2/2"
    assert parse_expression(library[0].text, ["x", "x_dot"]) == library[0].expr
    with pytest.raises(InputError, match="parameter 'x_dot' has the name of something else"):
        Library(["x"], ["x"], parameters={"x_dot": 1.0})


def test_angles_are_coordinates():
    assert Library(["a", "b"], ["a", "b"], angles=["b", "a"]).angles == ("a", "b")
    assert Library(["a"], "a", angles="a").angles == ("a",)
    with pytest.raises(InputError, match="angle 'c' is not a coordinate"):
        Library(["a"], ["a"], angles=["c"])


@pytest.mark.parametrize(
    ("terms", "coordinates", "message"),
    [
        ([], ["x"], "no terms"),
        ("x", ["x"], "expected a list"),
        (["x", "y"], ["x"], "unknown name 'y'"),
        (5, ["x"], "expected a list of lagrangian terms, got 5"),
        ([3], ["x"], "expected an expression as text"),
        (["x"], ["sin"], "name of a function"),
        ([Term("x_dot", X_DOT, "dissipation")], ["x"], "dissipation term; expected a lagrangian term"),
    ],
)
def test_misuse(terms, coordinates, message):
    with pytest.raises(InputError, match=message):
        Library(terms, coordinates)


def test_dissipation():
    library = Library(["x_dot**2"], ["x"], dissipation=["x_dot**2/2"])
    assert library.dissipation[0].kind == "dissipation"
    # the same expression is another term when it is of another kind
    assert library.with_dissipation(["x_dot**2", "x_dot**2/2"]).dissipation[1].text == "x_dot**2"
    with pytest.raises(InputError, match="expected a list"):
        library.with_dissipation("x_dot**2")


def test_equality_hash_pickle_repr():
    a = Library(["x_dot**2", "x"], ["x"], angles=["x"])
    b = Library(["x_dot*x_dot", "x"], ["x"], angles=["x"])
    assert a == b
    assert hash(a) == hash(b)
    assert a != Library(["x_dot**2", "x"], ["x"])
    assert a != "x"
    assert pickle.loads(pickle.dumps(a)) == a
    assert repr(a) == "Library(['x_dot**2', 'x'], coordinates=['x'], angles=['x'])"
    assert "38 terms" in repr(Library.mechanical(["x", "a"], ["a"]))


def test_hundred_terms_are_built_quickly():
    texts = [f"a_dot**{i}*b_dot*cos({j}*a-b)*sin(b)**{i}" for i in range(1, 11) for j in range(2, 12)]
    start = time.perf_counter()
    assert len(Library(texts, ["a", "b"])) == 100
    assert time.perf_counter() - start < 1.0  # 0.03 s on an idle core


# --- look-up -----------------------------------------------------------------------------------------


def test_index_by_meaning():
    library = Library(["x_dot**2", "1-cos(x)**2", "(x-1)**2", "sqrt(x)"], ["x"], dissipation=["abs(x_dot)"])
    assert library.index("x_dot*x_dot") == 0
    assert library.index("sin(x)**2") == 1
    assert library.index("x**2-2*x+1") == 2
    assert library.index(X**0.5) == 3
    assert library.index(library[2]) == 2
    assert library.index("sqrt(x_dot**2)", kind="dissipation") == 0
    assert library.index(library.dissipation[0]) == 0


def test_index_lists_near_matches():
    library = Library(["theta_dot**2", "cos(theta)"], ["theta"])
    with pytest.raises(
        InputError, match=r"'2\*cos\(theta\)' is not among the 2 .*near matches: cos\(theta\)"
    ):
        library.index("2*cos(theta)")
    with pytest.raises(InputError, match="did you mean"):
        library.index("cos(thet)")


def test_index_does_not_confuse_close_functions():
    library = Library(["sqrt(x_dot**2+1e-10)", "abs(x_dot)"], ["x"])
    assert library.index("abs(x_dot)") == 1


# --- files -------------------------------------------------------------------------------------------


def test_from_file(tmp_path):
    path = tmp_path / "library.txt"
    path.write_bytes("\ufeff# kinetic\r\nm*x_dot**2 # comment\r\n\r\ncos(x)\r\n".encode())
    library = Library.from_file(path, ["x"], angles=["x"], parameters={"m": 2}, dissipation=["x_dot**2"])
    assert [term.text for term in library] == ["2*x_dot**2", "cos(x)"]
    assert library.angles == ("x",)
    assert len(library.dissipation) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"x\n\n# fine\ncos(y)\n", r"library\.txt:4: cannot read 'cos\(y\)' at column 5"),
        (b"", "no expressions found"),
        (b"# only a comment\n", "no expressions found"),
        (b"x\n\xff\n", r"library\.txt:2: not UTF-8"),
    ],
)
def test_file_errors_name_file_and_line(tmp_path, content, message):
    path = tmp_path / "library.txt"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        Library.from_file(path, ["x"])


def test_unreadable_files(tmp_path):
    with pytest.raises(InputError, match="cannot read the library"):
        Library.from_file(tmp_path / "missing.txt", ["x"])
    with pytest.raises(InputError, match="cannot read the library"):
        Library.from_file(tmp_path, ["x"])


# --- generated families ------------------------------------------------------------------------------

TRUTHS = {
    "single pendulum": (["a"], ["a"], "a_dot**2; cos(a)"),
    "double pendulum": (
        ["a", "b"],
        ["a", "b"],
        "a_dot**2; b_dot**2; a_dot*b_dot*cos(a-b); cos(a); cos(b)",
    ),
    "spherical pendulum": (["a", "b"], ["a", "b"], "a_dot**2; b_dot**2*sin(a)**2; cos(a)"),
    "cart pendulum": (["x", "a"], ["a"], "x_dot**2; a_dot**2; x_dot*a_dot*cos(a); cos(a); x; x**2"),
    "elastic pendulum": (["x", "a"], ["a"], "x_dot**2; x**2*a_dot**2; x*cos(a); x; x**2"),
    "spherical elastic pendulum": (
        ["x", "a", "b"],
        ["a", "b"],
        "x_dot**2; x**2*a_dot**2; x**2*sin(a)**2*b_dot**2; x*cos(a); x; x**2",
    ),
    "robot arm": (
        ["a", "b"],
        ["a", "b"],
        "a_dot**2; b_dot**2; a_dot*b_dot; a_dot**2*cos(b); a_dot*b_dot*cos(b); cos(a); cos(a+b)",
    ),
    "oscillators": (["x", "y"], [], "x_dot**2; y_dot**2; x**2; y**2; x**4; y**4; x*y; x**2*y**2; x**2*y"),
    "three link arm": (["a", "b", "c"], ["a", "b", "c"], "a_dot**2*cos(b); cos(a+b+c); cos(a-c)"),
}


@pytest.mark.parametrize("system", TRUTHS)
@pytest.mark.parametrize("size", SIZES)
def test_generated_library_holds_the_truth(system, size):
    coordinates, angles, truth = TRUTHS[system]
    degree = 4 if system == "oscillators" else None
    library = Library.mechanical(coordinates, angles, size=size, degree=degree)
    assert len(library) == Library.mechanical_size(coordinates, angles, size=size, degree=degree)
    assert not library.dropped
    for text in truth.split("; "):
        library.index(text)


@pytest.mark.parametrize(("size", "gyroscopic"), [*((size, False) for size in SIZES), ("large", True)])
@pytest.mark.parametrize("kinds", ["x", "a", "xx", "xa", "aa", "xxx", "xxa", "xaa", "aaa"])
def test_generated_library_has_nothing_to_drop(kinds, size, gyroscopic):
    coordinates = [f"{kind}{k}" for k, kind in enumerate(kinds)]
    angles = [name for name in coordinates if name[0] == "a"]
    library = Library.mechanical(coordinates, angles, size=size, gyroscopic=gyroscopic)
    assert [str(dropped) for dropped in library.reduced().dropped] == []
    assert len(library) == Library.mechanical_size(coordinates, angles, size=size, gyroscopic=gyroscopic)
    if size == "standard":
        low, high = {1: (5, 12), 2: (25, 60), 3: (60, 150)}[len(kinds)]
        assert low <= len(library) <= high


def test_gyroscopic_terms():
    plain, with_them = (
        Library.mechanical(["x", "y", "a"], ["a"], size="compact", gyroscopic=on) for on in (False, True)
    )
    more = {term.text for term in with_them} - {term.text for term in plain}
    waves = {f"{v}_dot*{wave}(a)" for v in "xy" for wave in ("cos", "sin")}
    assert more == {"x*y_dot", "x*a_dot", "y*a_dot", *waves}


def test_sizes_are_nested():
    sizes = [
        Library.mechanical(["x", "a", "b"], ["a", "b"], size=s) for s in ("compact", "standard", "large")
    ]
    texts = [{term.text for term in library} for library in sizes]
    assert texts[0] < texts[1] < texts[2]


def test_mechanical_misuse():
    with pytest.raises(InputError, match="size 'huge' is unknown"):
        Library.mechanical(["x"], size="huge")
    with pytest.raises(InputError, match="degree 0"):
        Library.mechanical(["x"], degree=0)
    with pytest.raises(InputError, match=r"would have \d+ terms"):
        Library.mechanical([f"a{k}" for k in range(9)], [f"a{k}" for k in range(9)], size="standard")
    with pytest.raises(InputError, match="too many to generate"):
        Library.mechanical([f"a{k}" for k in range(40)])


def test_summary_counts():
    library = Library.mechanical(["x"], dissipation=["x_dot**2"])
    assert library.summary() == "7 terms in x: 3 with velocities, 4 without; 1 of dissipation"
    assert Library(["x", "x"], ["x"]).summary().endswith("; 1 left out")


# --- smoothing ---------------------------------------------------------------------------------------


def test_smooth_abs_of_velocities_only():
    names = ["x", "x_dot", "y", "y_dot"]
    term = make_term("abs(x_dot)*abs(x)", names, kind="dissipation")
    smooth = smooth_abs(term, {"x_dot": 0.1})
    assert smooth.text == "sqrt(x_dot**2 + 1/100)*abs(x)"
    assert smooth.kind == "dissipation"
    assert parse_expression(smooth.text, names) == smooth.expr
    pair = smooth_abs(make_term("abs(x_dot-y_dot)", names), {"x_dot": 0.1, "y_dot": 0.2})
    assert pair.expr == parse_expression("sqrt((x_dot-y_dot)**2+0.04)", names)
    untouched = make_term("abs(x)", names)
    assert smooth_abs(untouched, {}) is untouched
    with pytest.raises(InputError, match="needs a positive scale for 'x_dot'"):
        smooth_abs(term, {"y_dot": 0.1})


def test_smooth_abs_of_a_library():
    library = Library(["x_dot**2", "abs(x)"], ["x"], angles=["x"], dissipation=["abs(x_dot)", "x_dot**2"])
    smooth = smooth_abs(library, {"x_dot": 1.2345678901e-3})
    assert smooth.terms == library.terms
    assert smooth.angles == ("x",)
    assert smooth.dissipation[1] == library.dissipation[1]
    assert not smooth.dissipation[0].expr.has(sympy.Abs)
    assert smooth_abs(smooth, {}) is smooth
