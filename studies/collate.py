"""Records of a study → its tables: printed, and written to its section of studies/tables.md.

python -m studies.collate structure
python -m studies.collate            # every study that has records
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import click

import leastaction as la
from runner.machine import ROOT
from runner.store import RecordError, Store
from studies._study_tables import tables
from studies.case import Case
from studies.plans import PLANS
from studies.run import RESULTS

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
