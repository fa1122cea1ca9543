"""Records of a study → its tables: printed, and written to its section of studies/tables.md.

python -m studies.collate structure
python -m studies.collate            # every study that has records
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import click
import numpy as np

import leastaction as la
from runner.machine import ROOT
from runner.store import RecordError, Store
from studies import names, shapes, unlisted
from studies._tables import (
    Records,
    Table,
    binomial,
    causes_in,
    cells,
    codes_in,
    failures,
    median,
    number,
    percent,
    results,
    sentences_in,
    share,
    short,
    support_table,
    title_of,
)
from studies.case import Case
from studies.faults import FAULTS
from studies.run import PLANS, RESULTS

# ----------------------------------------------------------------------------------- the tables of each study

# ok with the right terms and coefficients within this of the truth: as good as right
_RIGHT = 0.05
_STATUSES = ("ok", "usable", "doubtful")


def tables(study: str, records: Records) -> list[Table]:
    """Return all tables of a study."""
    special = {"calibration": _calibration, "faults": _faults, "noise": _noise}
    special |= {"unlisted": unlisted.tables, "names": names.tables, "shapes": shapes.tables}
    return list(special.get(study, _structure)(records))


def _structure(records: Records) -> Iterator[Table]:
    for (library, trajectories, duration, rate), group in cells(
        records, lambda c: (c["library"], c["trajectories"], c["duration"], c["rate"])
    ).items():
        trials = "trajectory" if trajectories == 1 else "trajectories"
        title = f"{library} library, {trajectories} {trials} of {duration:g} s at {rate:g} Hz"
        yield support_table(title[0].upper() + title[1:], group)
        levels = cells(group, lambda c: (c["noise"],)).items()
        by_level = [(percent(noise), *_outcome(some)) for (noise,), some in levels]
        head = ("noise", "exact, 95 % interval", f"{' / '.join(_STATUSES)} if exact", "if wrong")
        yield Table(f"{title[0].upper() + title[1:]}: by noise", head, by_level)
    yield failures(records)


def _outcome(records: Records) -> tuple[str, ...]:
    run = [r["result"] for r in records]
    exact = [r for r in run if r.get("exact")]
    wrong = [r for r in run if not r.get("exact")]
    return (
        f"{len(exact)}/{len(run)} = {binomial(len(exact), len(run))} %",
        *(
            " / ".join(str(sum(r["status"] == status for r in some)) for status in _STATUSES)
            for some in (exact, wrong)
        ),
    )


def _spread(z: list[float]) -> str:
    return number(np.sqrt(np.mean(np.square(z))) if z else None, ".2f")


def _terms(found: list[dict]) -> list[dict]:
    return [t for r in found for t in r["terms"].values()]


def _z(terms: list[dict]) -> list[float]:
    return [t["z"] for t in terms if t["z"] is not None]


def _calibration(records: Records) -> Iterator[Table]:
    head = (
        *("system", "noise", "fits", "coverage of 95 % intervals, %", "rms z", "P(spurious), %"),
        *("P(missed), %", "ok", "noise found / true", "median s"),
    )
    groups = cells(records, lambda c: (c["system"], c["noise"]))
    rows = [(title_of(s), percent(n), *_calibration_row(group)) for (s, n), group in groups.items()]
    rows.append(("all", "", *_calibration_row(records)))
    note = "Coverage and z: of all true terms that were found. Brackets: 95 % interval of the share itself."
    yield Table("Calibration", head, rows, note)
    head = ("system", "noise", "term", "n", "coverage, %", "mean z", "rms z", "true", "mean estimate")
    rows = []
    for (system, noise), group in groups.items():
        by_term: dict[str, list[dict]] = {}
        for result in results(group):
            for place, term in result["terms"].items():
                by_term.setdefault(place, []).append(term)
        for place, terms in by_term.items():
            z = _z(terms)
            rows.append(
                (
                    *(title_of(system), percent(noise), f"`{place}`", str(len(terms))),
                    binomial(sum(t["covered"] for t in terms), len(terms)),
                    number(np.mean(z) if z else None, "+.2f"),
                    _spread(z),
                    number(terms[0]["true"], ".6g"),
                    number(np.mean([t["estimate"] for t in terms]), ".6g"),
                )
            )
    yield Table("Calibration of each coefficient", head, rows)
    yield failures(records)


def _calibration_row(records: Records) -> tuple[str, ...]:
    found = results(records)
    terms = _terms(found)
    ratios = [x for r in found if r["noise_ratio"] for x in r["noise_ratio"]]
    return (
        str(len(records)),
        binomial(sum(t["covered"] for t in terms), len(terms)) + f" of {len(terms)}",
        _spread(_z(terms)),
        binomial(sum(bool(r["spurious"]) for r in found), len(found)),
        binomial(sum(bool(r["missed"]) for r in found), len(found)),
        share(r["result"]["status"] == "ok" for r in records),
        f"{number(median(ratios), '.3f')} ± {number(np.std(ratios) if ratios else None, '.3f')}",
        number(median(r["wall_s"] for r in found), ".1f"),
    )


def _noise(records: Records) -> Iterator[Table]:
    head = (
        *("noise", "level", "exact", "ok", "ok and wrong", "median ℓ2", "coverage of 95 % intervals, %"),
        *("rms z", "noise found / true", "median s", "commonest remark"),
    )
    rows = [
        (kind, percent(level), *_noise_row(group))
        for (kind, level), group in cells(records, lambda c: (c["setup"], c["noise"])).items()
    ]
    yield Table("Noise that is not white and Gaussian, over all systems", head, rows)
    head = ("system", *head)
    keys = cells(records, lambda c: (c["system"], c["setup"], c["noise"])).items()
    rows = [(title_of(s), kind, percent(level), *_noise_row(group)) for (s, kind, level), group in keys]
    yield Table("The same by system", head, rows)
    yield failures(records)


def _noise_row(records: Records) -> tuple[str, ...]:
    found, run = results(records), [r["result"] for r in records]
    terms = _terms(found)
    ratios = [x for r in found if r["noise_ratio"] for x in r["noise_ratio"]]
    said = Counter(code for r in found for code in codes_in(r))
    commonest = said.most_common(1)
    return (
        share(r.get("exact", False) for r in run),
        share(r["status"] == "ok" for r in run),
        str(sum(r["status"] == "ok" and not r["exact"] for r in run)),
        number(median(r["l2"] for r in found)),
        binomial(sum(t["covered"] for t in terms), len(terms)),
        _spread(_z(terms)),
        number(median(ratios), ".2f"),
        number(median(r["wall_s"] for r in found), ".1f"),
        f"{commonest[0][0]} ({commonest[0][1]}×)" if commonest else "–",
    )


def _is_right(result: dict) -> bool:
    return bool(result.get("exact")) and result["l2"] <= _RIGHT


def _verdict(result: dict, cause: str) -> str:
    if not result["finished"]:
        return "failed"
    if result["status"] == "no model":
        return "no model"
    if result["status"] == "ok":
        return "right" if _is_right(result) else "wrong"
    return "named" if cause and cause in causes_in(result, "warning") else "unnamed"


def _faults(records: Records) -> Iterator[Table]:
    head = (
        *("set-up", "runs", "ok, right", "ok, wrong", "not ok, cause named", "not ok, not named"),
        *("no model", "failed", "causes named (mean)", "ok, a note names it", "covered if ok", "median s"),
    )
    order = {name: k for k, name in enumerate(FAULTS)}
    for noises, title in ((None, "all noise levels"), *_levels(records)):
        some = [r for r in records if noises is None or r["config"]["noise"] == noises]
        groups = sorted(cells(some, lambda c: (c["setup"],)).items(), key=lambda item: order[item[0][0]])
        rows = [(FAULTS[setup].title, *_fault_row(group, FAULTS[setup].cause)) for (setup,), group in groups]
        note = (
            f"Right: exactly the true terms of L and ℓ2 ≤ {percent(_RIGHT)} against the truth. One "
            "warning may name several causes; their mean number is given. Covered: 95 % intervals that "
            "hold the truth."
        )
        yield Table(f"Set-ups that are wrong on purpose: {title}", head, rows, note)
    yield _what_was_said(records, order)


def _levels(records: Records) -> list[tuple[float, str]]:
    levels = sorted({r["config"]["noise"] for r in records})
    return [(x, f"noise {percent(x)}") for x in levels] if len(levels) > 1 else []


def _fault_row(records: Records, cause: str) -> tuple[str, ...]:
    run = [r["result"] for r in records]
    counts = Counter(_verdict(r, cause) for r in run)
    doubtful = [r for r in run if r["status"] == "doubtful"]
    quiet = [r for r in run if r["status"] == "ok"]
    seconds = [r["wall_s"] for r in run if "wall_s" in r]
    return (
        str(len(run)),
        *(str(counts[k]) for k in ("right", "wrong", "named", "unnamed", "no model", "failed")),
        number(np.mean([len(causes_in(r, "warning")) for r in doubtful]) if doubtful else None, ".1f"),
        str(sum(bool(cause) and cause in causes_in(r, "note") for r in quiet)),
        f"{sum(r['covered'] for r in quiet)}/{sum(len(r['terms']) for r in quiet)}",
        number(median(seconds), ".1f"),
    )


def _what_was_said(records: Records, order: dict[str, int]) -> Table:
    rows = []
    groups = cells(records, lambda c: (c["setup"], c["system"], c["noise"]))
    for (setup, system, noise), group in sorted(groups.items(), key=lambda item: order[item[0][0]]):
        said = Counter(short(w, 160) for r in group for w in sentences_in(r["result"], "warning"))
        hints = Counter(short(w, 160) for r in group for w in sentences_in(r["result"], "note"))
        verdicts = Counter(_verdict(r["result"], FAULTS[setup].cause) for r in group)
        rows.append(
            (
                *(setup, title_of(system), percent(noise)),
                ", ".join(f"{n} {k}" for k, n in verdicts.items()),
                number(median(r["result"].get("l2") for r in group)),
                said.most_common(1)[0][0] if said else "–",
                hints.most_common(1)[0][0] if hints else "–",
            )
        )
    head = ("set-up", "system", "noise", "outcome", "median ℓ2", "commonest warning", "commonest note")
    return Table("What was said", head, rows)


# --------------------------------------------------------------------------------------------------- the page
TABLES = ROOT / "studies" / "tables.md"
_HEADING = "# Study: "


def read(results: Path, study: str) -> list[dict]:
    """Return the records of a study, in the sequence of its systems, set-ups and noise levels."""
    place = {(c.system, c.setup): k for k, c in reversed([*enumerate(PLANS[study].first)])}

    def key(record: dict) -> tuple:
        c = record["config"]
        shape = (c["library"], -c["rate"])
        return (*shape, place.get((c["system"], c["setup"]), 10**6), c["noise"], c["trial"])

    return sorted(Store(results, Case.from_dict).read(study), key=key)


def section(study: str, records: list[dict]) -> str:
    """Return the section of a study in Markdown."""
    parts = [f"{_HEADING}{study}", _origin(records)]
    parts += [table.markdown() for table in tables(study, records)]
    return "\n\n".join(parts) + "\n"


def _origin(records: list[dict]) -> str:
    commits = Counter(r["commit"][:12] + r["commit"][40:] or "unknown" for r in records)
    machines = Counter(
        f"{m['processor']}, {m['cores']} cores, {m['parallel_runs']} at a time"
        for m in (r["machine"] for r in records)
    )
    dates = sorted(r["date"] for r in records)
    versions = records[0]["versions"]
    return (
        f"{len(records)} runs, {dates[0]} to {dates[-1]}. Commits: "
        + "; ".join(f"{name} ({n})" for name, n in commits.most_common())
        + ". Machines: "
        + "; ".join(f"{name} ({n})" for name, n in machines.most_common())
        + ". Versions: "
        + ", ".join(f"{name} {number}" for name, number in versions.items())
        + ". Made by `python -m studies.collate` from the records; never edited."
    )


def updated(page: str, sections: Mapping[str, str]) -> str:
    """Return a page with new sections of some studies; those of the others stay as they are."""
    kept = [part.strip() + "\n" for part in re.split(f"^(?={_HEADING})", page, flags=re.MULTILINE) if part]
    named = {part.splitlines()[0].removeprefix(_HEADING): part for part in kept} | dict(sections)
    return "\n".join(named[study] for study in PLANS if study in named)


@click.command(help=__doc__.split("\n\n")[0])
@click.argument("studies", nargs=-1, type=click.Choice(list(PLANS)))
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), default=RESULTS)
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), default=TABLES)
def main(studies: tuple[str, ...], results: Path, output: Path) -> None:
    made: dict[str, str] = {}
    for study in studies or PLANS:
        try:
            records = read(results, study)
        except RecordError as error:
            raise click.ClickException(str(error)) from None
        if not records:
            continue
        made[study] = section(study, records)
        click.echo(made[study])
    if not made:
        raise click.ClickException(
            f"{results} holds no such records; make some by python -m studies.run STUDY"
        )
    before = output.read_text(encoding="utf-8") if output.exists() else ""
    la.io.write_text(output, updated(before, made))


if __name__ == "__main__":
    main()
