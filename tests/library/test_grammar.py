"""Candidates grown from names: complete, each once, measured, and pruned to the shortest forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from leastaction import InputError, Library, systems
from leastaction.estimation.domains import undefined_along
from leastaction.library.grammar import grown_terms, size_of
from leastaction.library.term import make_term

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
