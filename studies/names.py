"""The law from the names of the coordinates alone: one case, what is kept of it, and the tables.

A result is exact if its accelerations are off by less than 1 % where the motion was recorded, and if it says
so in no more terms than the textbook does: the terms themselves may be others, since equal laws can be
written in several ways.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import numpy as np

import leastaction as la
from leastaction import systems
from studies._tables import Records, Table, cells, codes_in, median, number, percent, results, share, title_of
from studies.case import Case, attempt
from studies.law import error_of_acceleration

__all__ = ["COULOMB", "OFF", "friction_candidates", "is_exact", "pose", "solve", "tables"]

COULOMB = re.compile(r"sqrt\((\w+_dot)\*\*2 ?\+ ?[^()]*\)")
"""Dry friction of the systems, rounded near zero velocity."""
OFF = 0.01


def friction_candidates(system: systems.MechanicalSystem) -> list[str]:
    """Viscous and Coulomb friction in every coordinate, as a user would write them."""
    coulomb = {COULOMB.sub(r"abs(\1)", text): text for text in system.dissipation}
    own = [coulomb.get(f"abs({v})", f"abs({v})") for v in system.velocities]
    return [*(f"{v}**2/2" for v in system.velocities), *own]


def pose(case: Case) -> tuple[tuple[systems.TrueMotion, ...], la.Trajectories, la.Library]:
    """Return the motions, their recordings, and the candidates of ``--library symbolic``.

    Who knows that there is friction gives it as a candidate, viscous and dry for each coordinate.
    """
    system = systems.get(case.system)
    truth = systems.simulate_truth(system, case.trajectories, case.duration, case.rate, case.seed)
    data = systems.measure(system, truth, systems.noise_std(system, truth, case.noise), case.seed)
    library = la.Library.symbolic(system.coordinates, system.angles)
    if system.dissipation:
        library = library.with_dissipation(friction_candidates(system))
    return truth, data, library


def solve(case: Case) -> dict:
    """Return what is kept of one discovery; an error of the user's kind is an answer too."""
    system = systems.get(case.system)
    truth, data, library = pose(case)
    model, kept = attempt(data, library, dict(system.known))
    if model is None:
        return kept
    error = float(np.max(error_of_acceleration(system, model, truth)))
    return {
        **kept,
        "acceleration_error": error if np.isfinite(error) else None,
        "n_terms": len(model.terms),
        "n_terms_of_law": len(system.lagrangian),
        "terms": {term.expression: term.coefficient for term in model.terms},
        "dissipation": {term.expression: term.coefficient for term in model.dissipation},
    }


def is_exact(result: Mapping) -> bool:
    """Tell whether accelerations are right within 1 %, in no more terms than the textbook needs.

    >>> is_exact({"acceleration_error": 0.002, "n_terms": 3, "n_terms_of_law": 3})
    True
    """
    error = result.get("acceleration_error")
    return error is not None and error < OFF and result["n_terms"] <= result["n_terms_of_law"]


# -------------------------------------------------------------------------------------- the tables

_HEAD = (
    *("system", "noise", "candidates", "exact", "ok", "ok and not exact", "terms, of the law"),
    *("largest error of q̈", "median CPU s", "longest CPU s"),
)
_NOTE = (
    f"Exact: q̈ is off by less than {percent(OFF)} of its rms in every coordinate at the exact states of the "
    "recordings, in no more terms than the textbook's."
)


def tables(records: Records) -> Iterator[Table]:
    """One row a system and noise level, one for all of a noise level, and what was not exact."""
    groups = cells(records, lambda c: (c["system"], c["noise"])).items()
    rows = [(title_of(name), percent(noise), *_row(group)) for (name, noise), group in groups]
    levels = sorted(cells(records, lambda c: (c["noise"],)).items())
    rows += [("all", percent(noise), *_row(group)) for (noise,), group in levels]
    yield Table("Laws from names alone", _HEAD, rows, _NOTE)
    yield _not_exact(records)


def _row(records: Records) -> tuple[str, ...]:
    found, run = results(records), [r["result"] for r in records]
    one = len({r["config"]["system"] for r in records}) == 1
    spent = [r["cpu_s"] for r in run if "cpu_s" in r]
    return (
        number(median(r.get("n_candidates") for r in found), ".0f") if one else "",
        share(is_exact(r) for r in run),
        share(r["status"] == "ok" for r in run),
        str(sum(r["status"] == "ok" and not is_exact(r) for r in run)),
        f"{number(median(r.get('n_terms') for r in found), '.0f')}, {_of_law(records)}" if one else "",
        number(max((r.get("acceleration_error") or float("inf") for r in found), default=None), ".2g"),
        number(median(spent), ".1f"),
        number(max(spent, default=None), ".1f"),
    )


def _of_law(records: Records) -> str:
    return number(median(r.get("n_terms_of_law") for r in results(records)), ".0f")


def _not_exact(records: Records) -> Table:
    rows = []
    for r in records:
        config, result = r["config"], r["result"]
        if is_exact(result):
            continue
        terms = result["terms"] if "n_terms" in result else {}
        law = " ".join(f"{x:+.4g} `{text}`" for text, x in terms.items())
        rows.append(
            (
                *(title_of(config["system"]), percent(config["noise"]), str(config["seed"])),
                *(result["status"], number(result.get("acceleration_error"))),
                *(law or result.get("reason", ""), ", ".join(codes_in(result)) or "–"),
            )
        )
    head = ("system", "noise", "seed", "status", "error of q̈", "law", "findings")
    return Table(f"Not exact ({len(rows)} of {len(records)})", head, rows)
