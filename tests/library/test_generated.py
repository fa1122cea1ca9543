"""Generated candidates: chains of links, derived with SymPy, and those grown from names alone."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
import sympy as sp

from leastaction import InputError, Library, systems
from leastaction.estimation.domains import undefined_along
from leastaction.library.chains import runs, runs_after
from leastaction.library.families import ALL_SIZES, choose_size, mechanical_terms
from leastaction.library.friction import FRICTION, has_direction
from leastaction.library.grammar import grown_terms, size_of
from leastaction.library.term import make_term

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
@pytest.mark.parametrize("n", [2, 3, 4])
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
