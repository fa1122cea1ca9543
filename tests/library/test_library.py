"""Libraries: construction, files, families, look-up, smoothing of |u|; and generated candidates."""

from __future__ import annotations

import math
import pickle
import time

import numpy as np
import pytest
import sympy
import sympy as sp

from leastaction import InputError, systems
from leastaction.estimation.domains import undefined_along
from leastaction.library import Library, Term, make_term, parse_expression, smooth_abs
from leastaction.library.chains import runs, runs_after
from leastaction.library.families import ALL_SIZES, SIZES, choose_size, mechanical_terms
from leastaction.library.friction import FRICTION, has_direction
from leastaction.library.grammar import grown_terms, size_of

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


# --------------- generated candidates: chains of links, derived with SymPy, and those grown from names alone
# ---------------------------------------- chains: the generated libraries can write their Lagrangians
NAMES = ("a", "b", "c", "d", "e", "f", "g")


def symbols(n: int, first: int = 0):
    names = NAMES[first : first + n]
    return [sp.Symbol(x, real=True) for x in names], [sp.Symbol(f"{x}_dot", real=True) for x in names]


def rate(expr, q, v):
    return sum((sp.diff(expr, x) * y for x, y in zip(q, v, strict=True)), sp.Integer(0))


def planar_chain(n: int, relative: bool, gravity: bool, offset: float = 0.0, cart: bool = False):
    """T − V of links with unlike lengths and masses; `offset`: centres of mass off the line, as an angle."""
    q, v = symbols(n)
    x, x_dot = sp.symbols("x x_dot", real=True)
    point = sp.Matrix([x if cart else 0, 0])
    coordinates, rates = ([x, *q], [x_dot, *v]) if cart else (q, v)
    total = 2 * x_dot**2 if cart else sp.Integer(0)
    for k in range(n):
        angle = sum(q[: k + 1]) if relative else q[k]
        length, mass, inertia = 1.0 + 0.3 * k, 2.0 - 0.2 * k, 0.1 + 0.05 * k
        centre = point + 0.6 * length * sp.Matrix([sp.sin(angle + offset), -sp.cos(angle + offset)])
        point = point + length * sp.Matrix([sp.sin(angle), -sp.cos(angle)])
        moves = [rate(part, coordinates, rates) for part in centre]
        total += mass * (moves[0] ** 2 + moves[1] ** 2) / 2 + inertia * rate(angle, q, v) ** 2 / 2
        total -= (mass * 9.81 * centre[1]) if gravity else 0
    return total, coordinates, rates


def arm_on_turning_base(n: int):
    """A vertical first joint, then n − 1 links in the plane it turns, in relative angles."""
    q, v = symbols(n)
    total, reach, height = sp.Rational(1, 5) * v[0] ** 2, sp.Integer(0), sp.Integer(0)
    for k in range(1, n):
        angle, length, mass = sum(q[1 : k + 1]), 1.0 + 0.3 * k, 2.0 - 0.2 * k
        r, z = reach + 0.4 * length * sp.cos(angle), height + 0.4 * length * sp.sin(angle)
        reach, height = reach + length * sp.cos(angle), height + length * sp.sin(angle)
        speed = rate(r, q, v) ** 2 + (r * v[0]) ** 2 + rate(z, q, v) ** 2
        total += mass * speed / 2 + 0.1 * rate(angle, q, v) ** 2 - mass * 9.81 * z
    return total, q, v


def unexplained(expr, coordinates, rates, library) -> float:
    """Relative residual of T − V on the candidates and a constant, at random states."""
    rng = np.random.default_rng(0)
    states = rng.uniform(-3.0, 3.0, (2 * len(coordinates), len(library) + 60))
    everything = [*coordinates, *rates]
    columns = [sp.lambdify(everything, t.expr, "numpy")(*states) for t in library]
    columns = np.column_stack([*columns, np.ones(states.shape[1])])
    wanted = sp.lambdify(everything, expr, "numpy")(*states)
    rest = wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=1e-12)[0]
    return float(np.linalg.norm(rest) / np.linalg.norm(wanted))


@pytest.mark.parametrize("gravity", [True, False])
@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize("n", [2, 3, pytest.param(4, marks=pytest.mark.thorough)])
def test_planar_chains_are_in_standard_and_chain(n, relative, gravity):
    names = NAMES[:n]
    for size, offset in (("standard", 0.4), ("chain", 0.0)):
        truth = planar_chain(n, relative, gravity, offset)
        assert unexplained(*truth, Library.mechanical(names, names, size=size)) < 1e-10


def test_the_sums_are_needed():
    """Without them, a relative chain of three links leaves its coupling of the outer links unexplained."""
    names = NAMES[:3]
    library = Library.mechanical(names, names, size="standard")
    without = library.replace(terms=[t for t in library if "dot" not in t.text or "+" not in t.text])
    assert unexplained(*planar_chain(3, True, True), without) > 1e-3


@pytest.mark.parametrize("relative", [True, False])
def test_chain_on_a_cart(relative):
    for size in ("standard", "chain"):
        library = Library.mechanical(["x", "a", "b"], ["a", "b"], size=size)
        assert unexplained(*planar_chain(2, relative, True, cart=True), library) < 1e-10


@pytest.mark.parametrize("n", [2, 3, 4])
def test_arms_on_a_turning_base_are_in_standard(n):
    assert (
        unexplained(*arm_on_turning_base(n), Library.mechanical(NAMES[:n], NAMES[:n], size="standard"))
        < 1e-10
    )


@pytest.mark.parametrize("n", [2, 3, 5])
def test_masses_in_a_row_are_in_chain(n):
    names = [f"x{k}" for k in range(n)]
    library = Library.mechanical(names, size="chain")
    for text in ("(x0-x1)**2", "(x0-x1)**4", "x0**3", f"x{n - 1}_dot**2"):
        library.index(text)
    assert not library.reduced().dropped


@pytest.mark.parametrize(
    ("coordinates", "angles", "size", "most"),
    [
        ("a", "a", "standard", 10),
        ("xa", "a", "standard", 60),
        ("abc", "abc", "standard", 150),
        ("xab", "ab", "standard", 150),
        ("xyz", "", "standard", 150),
        ("wxyz", "", "standard", 250),
        ("abcd", "abcd", "chain", 250),
        ("xabc", "abc", "chain", 250),
        ("vwxyz", "", "compact", 250),
        ("abcde", "abcde", "chain", 250),
        ("abcdefg", "abcdefg", "chain", 500),
    ],
)
def test_size_chosen_by_itself(coordinates, angles, size, most):
    assert choose_size(coordinates, angles) == size
    for name in (None, "auto"):
        terms = mechanical_terms(coordinates, angles, name)
        assert terms == mechanical_terms(coordinates, angles, size)
        assert len(terms) <= most
    # the user's word counts
    assert mechanical_terms(coordinates, angles, "compact") != mechanical_terms(coordinates, angles, "large")


@pytest.mark.parametrize("coordinates", ["abcd", "xabc", "xyab", "abcde"])
def test_chain_has_nothing_to_drop(coordinates):
    angles = [name for name in coordinates if name in "abcde"]
    library = Library.mechanical(list(coordinates), angles, size="chain")
    assert [str(d) for d in library.reduced().dropped] == []


def test_runs():
    assert list(runs("abc")) == [("a",), ("b",), ("c",), ("a", "b"), ("b", "c"), ("a", "b", "c")]
    assert list(runs_after("a", "c", "abc")) == [("b",), ("c",), ("b", "c")]
    assert list(runs_after("c", "c", "abc")) == []
    assert list(runs_after("x", "b", "ab")) == list(runs("ab"))
    assert list(runs_after("x", "y", "ab")) == []
    assert "chain" in ALL_SIZES


def test_products_of_sums_of_rates_are_recognised_at_once():
    """Ten monomials make one product of sums; the check over all terms once took minutes here."""
    rates = ["a_dot", "(a_dot+b_dot)", "(a_dot+b_dot+c_dot)", "(a_dot+b_dot+c_dot+d_dot)"]
    names = NAMES[:4]
    grouped = [
        f"{rates[i]}*{rates[j]}*cos({'+'.join(names[i + 1 : j + 1])})" if i < j else f"{rates[i]}**2"
        for i in range(4)
        for j in range(i, 4)
    ]
    generated = Library.mechanical(names, names, size="standard")
    both = Library([*grouped, *generated], names)
    begin = time.process_time()
    reduced = both.reduced(keep=grouped)
    assert time.process_time() - begin < 20.0  # 0.3 s on a quiet machine
    # a_dot**2 is one term in both; the others each put one monomial out
    assert len(reduced) == len(generated)
    assert {t.text for t in reduced} >= set(grouped)


# ------------------ grown from names: complete, each once, measured, and pruned to the shortest forms
# what no grammar without exponentials and unknown numbers can write
BEYOND = ("magnetic_pendulum", "toda_chain", "morse_molecule")
WITHIN = sorted({*systems.names(), *systems.further_names()} - {*BEYOND})


@pytest.mark.parametrize("name", WITHIN)
def test_laws_of_the_systems_are_in_the_grammar(name):
    system = systems.get(name)
    library = Library.symbolic(system.coordinates, system.angles)
    for text in system.lagrangian:
        library.index(text)  # raises InputError where the term is not there


@pytest.mark.parametrize("names", [(["x"], []), (["x", "y", "z"], []), (["x", "a", "b"], ["a", "b"])])
def test_every_text_parses_back_and_comes_once(names):
    coordinates, angles = names
    terms = grown_terms(coordinates, angles)
    known = [*coordinates, *(f"{name}_dot" for name in coordinates)]
    assert len({term.expr for term in terms}) == len(terms)
    assert all(make_term(term.text, known).expr == term.expr for term in terms)
    sizes = [size_of(term.expr) for term in terms]
    assert sizes == sorted(sizes)


def test_lengths_are_those_of_a_code():
    library = Library.symbolic(["x", "theta"], ["theta"])
    assert sum(math.exp(-length) for length in library.lengths) == pytest.approx(1.0)
    of = dict(zip((term.text for term in library), library.lengths, strict=True))
    assert of["x_dot**2"] < of["x_dot*theta_dot*cos(theta)"]


def test_lengths_stay_with_their_terms_and_others_have_none():
    library = Library.symbolic(["x"])
    before = dict(zip(library.terms, library.lengths, strict=True))
    more = library.with_dissipation(["x_dot**2/2"]).replace(terms=[*library.terms, "x_dot**4"]).reduced()
    after = dict(zip(more.terms, more.lengths, strict=True))
    assert after.pop(more[more.index("x_dot**4")]) is None
    assert all(before[term] == length for term, length in after.items())
    assert set(Library.mechanical(["x"]).lengths) == {None}


def test_reduction_keeps_the_shortest_of_equal_forms():
    library = Library.symbolic(["theta", "phi"], ["theta", "phi"]).reduced()
    left = {dropped.term.text: dropped for dropped in library.dropped}
    assert left["cos(2*theta)"].because == "equals -2*sin(theta)**2 up to a null term"
    sizes = {term.text: size_of(term.expr) for term in library}
    assert {"cos(theta-phi)", "cos(theta+phi)"} <= set(sizes)
    assert max(sizes.values()) <= max(size_of(dropped.term.expr) for dropped in library.dropped)


def test_domains_are_those_of_the_motion():
    library = Library.symbolic(["x", "y"])
    t = np.linspace(0.0, 6.0, 50)
    motion = {"x": 1.5 + np.cos(t), "y": -2.0 + np.sin(t), "x_dot": t, "y_dot": t}
    left = {term.text for term in undefined_along(library, motion)}
    assert left == {"log(y)", "sqrt(y)"}
    both = {**motion, "x": np.cos(t)}
    left = {term.text for term in undefined_along(library, both)}
    assert left == {"log(y)", "sqrt(y)", "log(x)", "sqrt(x)", "1/x", "1/x**2"}
    kept = undefined_along(library, both, [library[library.index("log(x)")]])
    assert "log(x)" not in {term.text for term in kept}
    assert undefined_along(Library(["x_dot**2", "y_dot**2", "log(y)"], ["x", "y"]), motion) == ()


def test_too_many_coordinates_are_refused():
    with pytest.raises(InputError, match=r"would have \d+ terms; expected at most 1500: use Library.mech"):
        Library.symbolic(list("abcdef"), list("abcdef"))


# ------------------------------------------------------------------------------------------ friction
def test_usual_friction_of_joints_and_between_them():
    """Two links and a slide: neighbours of one kind, absolute rates and relative ones."""
    library = Library.mechanical(["a", "b", "x"], ["a", "b"], size="compact", dissipation="auto")
    rates = ["a_dot", "b_dot", "x_dot", "a_dot-b_dot"]
    texts = [text for rate in rates for text in (f"({rate})**2/2", f"abs({rate})")]
    offered = Library(["x"], ["a", "b", "x"], dissipation=texts)
    assert library.dissipation == offered.dissipation
    assert library.reduced().dissipation == library.dissipation  # none repeats others


def test_usual_friction_among_others_is_offered_once():
    library = Library(["x_dot**2"], ["x"], dissipation=["abs(x_dot)", "auto", "abs(x_dot)**3/3"])
    assert [term.text for term in library.dissipation] == ["abs(x_dot)", "x_dot**2/2", "abs(x_dot)**3/3"]
    assert Library(["x_dot**2"], ["x"]).with_dissipation("auto").dissipation == library.dissipation[1::-1]


@pytest.mark.parametrize("family", FRICTION)
def test_families_of_friction_dissipate(family, rng):
    """In any state; those with a direction change sign with it, so that no power is left of both ways."""
    moved = ["a", "b", "x"]
    library = Library(["a_dot**2"], moved, angles=["a", "b"], dissipation=family)
    assert library == Library(["a_dot**2"], moved, angles=["a", "b"], dissipation=[family, family])
    names = [*moved, *(f"{name}_dot" for name in moved)]
    for term in library.dissipation:
        assert make_term(term.text, names, kind="dissipation") == term
        rates = [sp.Symbol(f"{name}_dot", real=True) for name in moved]
        expr = term.at(dict.fromkeys(term.shapes, 0.4)).expr
        power = sum(rate * sp.diff(expr, rate) for rate in rates)
        function = sp.lambdify([sp.Symbol(name, real=True) for name in names], power, "numpy")
        q, v = rng.normal(size=(3, 200)), rng.normal(size=(3, 200))
        ahead, back = (np.broadcast_to(function(*q, *(s * v)), 200) for s in (1.0, -1.0))
        if has_direction(term):
            np.testing.assert_allclose(ahead, -back)
        else:
            assert min(ahead.min(), back.min()) >= 0.0 < ahead.max()
    assert any(map(has_direction, library.dissipation)) == (family == "asymmetric")


def test_stribeck_friction_decays_from_the_static_to_the_sliding_value():
    dry, excess = Library(["x"], ["x"], dissipation="stribeck").dissipation
    force = sp.diff(2.0 * dry.expr + 0.5 * excess.at({"x_stribeck": 0.3}).expr, sp.Symbol("x_dot", real=True))
    at = sp.lambdify(sp.Symbol("x_dot", real=True), force, "numpy")
    np.testing.assert_allclose([at(1e-9), at(0.3), at(-9.0)], [2.5, 2.0 + 0.5 / np.e, -2.0], rtol=1e-6)


def test_what_is_no_family_is_an_expression():
    with pytest.raises(InputError, match="unknown name 'coulomb'"):
        Library(["x_dot**2"], ["x"], dissipation="auto").with_dissipation(["coulomb"])
    both = Library(["x_dot**2"], ["x"], dissipation=["stribeck", "load"]).dissipation
    assert [term.text for term in both][::2] == ["abs(x_dot)", "abs(x_dot)*abs(x)"]


def test_a_singularity_that_accelerations_do_not_show_is_left_out():
    """1/r stays for a comet that nearly hits the sun, and goes for springs that pass the same point."""
    library, anomaly = Library.symbolic(["x", "y"]), np.linspace(0.0, 2.0 * np.pi, 20_000)
    e = 0.999
    x, y, r = np.cos(anomaly) - e, np.sqrt(1.0 - e * e) * np.sin(anomaly), 1.0 - e * np.cos(anomaly)
    comet = {"x": x, "y": y, "x_dot_dot": -x / r**3, "y_dot_dot": -y / r**3}
    assert not {"1/sqrt(x**2+y**2)", "log(x**2+y**2)"} & {t.text for t in undefined_along(library, comet)}
    springs = comet | {"x_dot_dot": -x, "y_dot_dot": -y}
    assert {"1/sqrt(x**2+y**2)", "1/(x**2+y**2)"} <= {t.text for t in undefined_along(library, springs)}
