"""Records of a study → its tables: printed, and written to studies/tables/<study>.md.

python -m studies.collate structure
python -m studies.collate            # every study that has records
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import click

import leastaction as la
from runner.origin import ROOT
from runner.store import RecordError, Store
from studies._study_tables import tables
from studies.case import Case
from studies.plans import PLANS
from studies.run import RESULTS

TABLES = ROOT / "studies" / "tables"


def read(results: Path, study: str) -> list[dict]:
    """Return the records of a study, in the sequence of its systems, set-ups and noise levels."""
    place = {(c.system, c.setup): k for k, c in reversed([*enumerate(PLANS[study].first)])}

    def key(record: dict) -> tuple:
        c = record["config"]
        shape = (c["library"], -c["rate"])
        return (*shape, place.get((c["system"], c["setup"]), 10**6), c["noise"], c["trial"])

    return sorted(Store(results, Case.from_dict).read(study), key=key)


def page(study: str, records: list[dict]) -> str:
    """Return the Markdown page of a study."""
    parts = [f"# Study: {study}", _origin(records)]
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


@click.command(help=__doc__.split("\n\n")[0])
@click.argument("studies", nargs=-1, type=click.Choice(list(PLANS)))
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), default=RESULTS)
@click.option("--output", type=click.Path(file_okay=False, path_type=Path), default=TABLES)
def main(studies: tuple[str, ...], results: Path, output: Path) -> None:
    made = 0
    for study in studies or PLANS:
        try:
            records = read(results, study)
        except RecordError as error:
            raise click.ClickException(str(error)) from None
        if not records:
            continue
        text = page(study, records)
        la.io.write_text(output / f"{study}.md", text)
        click.echo(text)
        made += 1
    if not made:
        raise click.ClickException(
            f"{results} holds no such records; make some by python -m studies.run STUDY"
        )


if __name__ == "__main__":
    main()
