"""The tables of the study of laws from names alone."""

from __future__ import annotations

from collections.abc import Iterator

from studies._tables import Records, Table, cells, median, number, percent, results, share, title_of
from studies.names import OFF, is_exact
from studies.said import codes_in

__all__ = ["tables"]

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
