"""What a generated library makes of a law that it does not hold: one case, what is kept of it, and
the tables.

A result is wrong if its accelerations are off by more than 5 % where the motion was recorded.  The terms do
not count: no choice of them is right.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np

import leastaction as la
from leastaction import systems
from studies._tables import (
    Records,
    Table,
    binomial,
    cells,
    codes_in,
    median,
    number,
    percent,
    results,
    title_of,
)
from studies.case import Case, attempt
from studies.law import error_of_acceleration, motions
from studies.laws import KEPT_ASIDE, LAWS

__all__ = ["OFF", "is_wrong", "pose", "solve", "tables"]

OFF = 0.05


def pose(case: Case) -> tuple[tuple[systems.TrueMotion, ...], la.Trajectories, la.Library]:
    """Return the motions, their recordings, and the candidates of ``--library auto``.

    Who knows that there is friction gives it as a candidate, as by ``--dissipation "x_dot**2/2"``.
    """
    law = LAWS[case.system]
    truth = motions(law, case.trajectories, case.duration, case.rate, case.seed)
    data = systems.measure(law, truth, systems.noise_std(law, truth, case.noise), case.seed)
    library = la.Library.mechanical(law.coordinates, law.angles, dissipation=law.dissipation)
    return truth, data, library


def solve(case: Case) -> dict:
    """Return what is kept of one discovery; an error of the user's kind is an answer too."""
    law = LAWS[case.system]
    truth, data, library = pose(case)
    model, kept = attempt(data, library, dict(law.known))
    if model is None:
        return kept
    errors = error_of_acceleration(law, model, truth)
    error = float(np.max(errors))
    return {
        **kept,
        # no number for what is not finite: a mass that vanishes, say
        "acceleration_error": error if np.isfinite(error) else None,
        "terms": {t.expression: _written(t) for t in model.terms},
        "dissipation": {t.expression: _written(t) for t in model.dissipation},
        "chi2_per_sample": model.fit.chi2_per_sample,
    }


def _written(term) -> dict:
    if term.known:
        return {"coefficient": term.coefficient, "known": True}
    return {"coefficient": term.coefficient, "standard_error": term.standard_error}


def is_wrong(result: Mapping) -> bool:
    """Tell whether the accelerations of a model are off by more than 5 %.

    >>> is_wrong({"status": "ok", "acceleration_error": 0.01}), is_wrong({"acceleration_error": None})
    (False, True)
    """
    error = result["acceleration_error"]
    return error is None or error > OFF


# -------------------------------------------------------------------------------------- the tables

_COUNTS = (
    *("n", "ok", "ok, off by more", "usable", "usable, off by more", "doubtful", "doubtful, off by less"),
    *("no model", "failed", "median error of q̈", "median CPU s"),
)
_NOTE = (
    f"Off by more, by less: than {percent(OFF)} of the rms of q̈, in the coordinate where it is most, at the "
    "exact states of the recordings. Failed: crashed or took too long."
)


def tables(records: Records) -> Iterator[Table]:
    """Totals, then a row for each law and noise level, laws kept aside by themselves, and what was wrong."""
    yield Table("Totals", ("laws", "noise", "trajectories", *_COUNTS), list(_totals(records)), _NOTE)
    for title, some in _sets(records):
        groups = cells(some, lambda c: (c["system"], c["noise"])).items()
        rows = [(_title(law), percent(noise), *_row(group)) for (law, noise), group in groups]
        yield Table(f"By law and noise: {title}", ("law", "noise", *_COUNTS), rows)
    yield _wrong(records)


def _title(name: str) -> str:
    return LAWS[name].title if name in LAWS else title_of(name)


def _sets(records: Records) -> list[tuple[str, Records]]:
    aside = [r for r in records if r["config"]["system"] in KEPT_ASIDE]
    seen = [r for r in records if r["config"]["system"] not in KEPT_ASIDE]
    return [("laws that rules are made on", seen), ("laws kept aside", aside)]


def _totals(records: Records) -> Iterator[tuple[str, ...]]:
    for title, some in _sets(records):
        groups = cells(some, lambda c: (c["noise"], c["trajectories"]))
        for noise, trajectories in sorted(groups):
            group = groups[noise, trajectories]
            yield title, percent(noise), str(trajectories), *_row(group)
        yield title, "all", "all", *_row(some)
    yield "all", "all", "all", *_row(records)


def _row(records: Records) -> tuple[str, ...]:
    run = [r["result"] for r in records]
    models = [r for r in results(records) if "acceleration_error" in r]
    count = Counter((r["status"], is_wrong(r)) for r in models)
    ok, usable, doubtful = ((count[s, False], count[s, True]) for s in ("ok", "usable", "doubtful"))
    return (
        str(len(run)),
        *(str(sum(ok)), str(ok[1]), str(sum(usable)), str(usable[1])),
        *(str(sum(doubtful)), str(doubtful[0])),
        str(sum(r["status"] == "no model" for r in run)),
        str(sum(not r["finished"] for r in run)),
        number(median(r["acceleration_error"] for r in models), ".3f"),
        number(median(r["cpu_s"] for r in models), ".1f"),
    )


def _wrong(records: Records) -> Table:
    """Return every run that is said to be ok or usable and is off by more."""
    rows = []
    for r in records:
        config, result = r["config"], r["result"]
        if (
            result["status"] not in ("ok", "usable")
            or "acceleration_error" not in result
            or not is_wrong(result)
        ):
            continue
        found = {**result["terms"], **{f"ψ {k}": t for k, t in result["dissipation"].items()}}
        rows.append(
            (
                *(_title(config["system"]), percent(config["noise"])),
                *(str(config["trajectories"]), str(config["seed"]), result["status"]),
                number(result["acceleration_error"], ".3f"),
                " ".join(f"{t['coefficient']:+.4g} `{text}`" for text, t in found.items()),
                ", ".join(codes_in(result)) or "–",
            )
        )
    n = len(records)
    share = f"{len(rows)} of {n} = {binomial(len(rows), n)} %"
    head = ("law", "noise", "trajectories", "seed", "status", "error of q̈", "model", "findings")
    return Table(f"Not doubtful, and off by more than {percent(OFF)} ({share})", head, rows)
