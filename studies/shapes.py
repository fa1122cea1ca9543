"""Numbers inside terms: are they found, and how often do their intervals hold the truth?

Laws of `laws.py` with their numbers left open, and further terms beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import leastaction as la
from leastaction import systems
from leastaction.model.term import Z95
from studies._tables import (
    Records,
    Table,
    binomial,
    cells,
    failures,
    median,
    number,
    percent,
    results,
    title_of,
)
from studies.case import Case, attempt
from studies.law import motions
from studies.laws import LAWS

__all__ = ["SHAPED", "Shaped", "pose", "solve", "tables"]


@dataclass(frozen=True)
class Shaped:
    """A law of `laws.py` whose numbers are to be found.

    Attributes
    ----------
    terms : mapping of str to float
        Free terms of L as a user writes them → true coefficient.
    numbers : mapping of str to float
        Shape parameter → truth.
    others : sequence of str
        Candidates that are no part of the law.
    """

    terms: Mapping[str, float]
    numbers: Mapping[str, float]
    others: Sequence[str]


SHAPED = {
    "morse_line": Shaped(
        {"exp(-{a}*x)": 6.0, "exp(-2*{a}*x)": -3.0}, {"a": 1.2}, ("x", "x**2", "x**3", "x_dot**2*x")
    ),
    "spring_at_anchor": Shaped(
        {"x**2": -4.0, "y**2": -4.0, "x": 5.6, "y": -8.8, "sqrt((x-{p})**2+(y-{q})**2)": 8.0},
        {"p": 0.7, "q": -1.1},
        ("x*y", "x**3", "y**3", "x_dot*y_dot"),
    ),
    # exchangeable terms: the smaller number has the first name
    "lennard_jones_line": Shaped(
        {"x**{m}": -6.0, "x**{n}": 6.0}, {"m": -12.0, "n": -6.0}, ("x", "x**2", "x**3", "x_dot**2*x")
    ),
    "three_magnets": Shaped(
        {
            **{"x**2": -0.5, "y**2": -0.5, "1/sqrt((x-{p})**2+(y-{q})**2+{h}**2)": 1.0},
            "1/sqrt((x-{p1})**2+(y-{q1})**2+{h}**2)": 1.0,
            "1/sqrt((x-{p2})**2+(y-{q2})**2+{h}**2)": 1.0,
        },
        {"p": -0.6, "q": 0.8, "h": 0.4, "p1": -0.3, "q1": -0.9, "p2": 1.0, "q2": 0.2},
        ("x", "y", "x*y", "x_dot*y_dot"),
    ),
}


def pose(case: Case) -> tuple[la.Trajectories, la.Library]:
    """Return recordings of a law, and candidates among which it is written with open numbers."""
    law, shaped = LAWS[case.system], SHAPED[case.system]
    truth = motions(law, case.trajectories, case.duration, case.rate, case.seed)
    data = systems.measure(law, truth, systems.noise_std(law, truth, case.noise), case.seed)
    kinetic = [f"{name}_dot**2" for name in law.coordinates]
    texts = [*kinetic, *shaped.others, *shaped.terms]
    return data, la.Library(texts, law.coordinates, dissipation=list(law.dissipation))


def solve(case: Case) -> dict:
    """Return what is kept of one discovery; an error of the user's kind is an answer too."""
    law = LAWS[case.system]
    model, kept = attempt(*pose(case), dict(law.known))
    return kept | ({"exact": False} if model is None else score(case, model))


def score(case: Case, model: la.LagrangianModel) -> dict:
    """Compare terms and numbers, {a}, with the truth; known coefficients are left out."""
    law, shaped = LAWS[case.system], SHAPED[case.system]
    kinetic = {text: value for text, value in law.lagrangian.items() if "_dot" in text}
    true = {**kinetic, **shaped.terms, **{f"ψ {t}": c for t, c in law.dissipation.items()}}
    free = {text: value for text, value in true.items() if text not in law.known}
    found = {t.written: t for t in model.terms if not t.known}
    found |= {f"ψ {t.written}": t for t in model.dissipation}
    exact = set(found) == set(free)
    rows = {text: _compared(t.coefficient, free[text], t) for text, t in found.items() if text in free}
    for shape in model.shapes:
        if shape.name in shaped.numbers:
            rows[f"{{{shape.name}}}"] = _compared(shape.value, shaped.numbers[shape.name], shape)
    off = np.array([(row["estimate"] - row["true"], row["true"]) for row in rows.values()]).reshape(-1, 2)
    size = float(np.linalg.norm(off[:, 1]))
    return {
        "exact": exact,
        "found": sorted(found),
        "l2": float(np.linalg.norm(off[:, 0])) / size if size else 1.0,
        "terms": rows,
    }


def _compared(estimate: float, true: float, one) -> dict:
    """Whether the interval holds the truth, and that of the standard error alone."""
    error = one.standard_error
    usable = error is not None and error > 0.0
    return {
        "true": true,
        "estimate": estimate,
        "standard_error": error,
        "z": (estimate - true) / error if usable else None,
        "covered": bool(one.lower <= true <= one.upper) if usable else False,
        "covered_by_error": bool(abs(estimate - true) <= Z95 * error) if usable else False,
    }


# -------------------------------------------------------------------------------------- the tables
def tables(records: Records) -> Iterator[Table]:
    """A row for each law and noise level, then one for each number and coefficient of it."""
    groups = cells(records, lambda c: (c["system"], c["noise"]))
    rows = [(_title(name), percent(noise), *_law_row(group)) for (name, noise), group in groups.items()]
    head = ("law", "noise", "runs", "terms exact, %", "doubtful", "median s")
    yield Table("Laws with numbers inside terms", head, rows)
    rows = [
        (_title(name), percent(noise), f"`{what}`", *row)
        for (name, noise), group in groups.items()
        for what, row in _rows(group)
    ]
    head = (
        *("law", "noise", "parameter", "n", "covered by its interval, %"),
        *("by 1.96 standard errors, %", "mean z", "rms z", "true", "mean estimate"),
    )
    note = (
        "Of runs with exactly the terms of the law. Intervals of shape parameters are those of the profile."
    )
    yield Table("Intervals of numbers and coefficients", head, rows, note)
    yield failures(records)


def _title(name: str) -> str:
    return LAWS[name].title if name in LAWS else title_of(name)


def _law_row(records: Records) -> tuple[str, ...]:
    found = results(records)
    return (
        str(len(records)),
        binomial(sum(bool(r.get("exact")) for r in found), len(records)),
        str(sum(r["status"] == "doubtful" for r in found)),
        number(median(r["wall_s"] for r in found), ".1f"),
    )


def _rows(records: Records) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Parameter → how its estimates scatter about the truth."""
    exact = [r for r in results(records) if r.get("exact")]
    for what in sorted({text for r in exact for text in r["terms"]}, key=lambda text: (text[0] != "{", text)):
        seen = [r["terms"][what] for r in exact if what in r["terms"]]
        z = [one["z"] for one in seen if one["z"] is not None]
        yield (
            what,
            (
                str(len(seen)),
                binomial(sum(one["covered"] for one in seen), len(seen)),
                binomial(sum(one.get("covered_by_error", False) for one in seen), len(seen)),
                number(np.mean(z) if z else None, "+.2f"),
                number(np.sqrt(np.mean(np.square(z))) if z else None, ".2f"),
                number(seen[0]["true"], ".6g"),
                number(np.mean([one["estimate"] for one in seen]), ".6g"),
            ),
        )
