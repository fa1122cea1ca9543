"""Records of runs → the tables, as Markdown.

    python -m reproduction.collate --results reproduction/results --output reproduction/tables

Everything is computed from the records, the paper's numbers (``paper.json``) and, where a reason needs
judgement, from ``remarks.json``: key of a finding, or its beginning up to a slash → text.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import click

import leastaction as la
from reproduction._findings import Finding, findings
from reproduction._render import Page, Section, markdown
from reproduction._results import Results, read
from reproduction._speed import speed
from reproduction._tables import ablation, experiments, group_tables
from reproduction._without_candidates import without_candidates

HERE = Path(__file__).resolve().parent
LEAD = (
    "The tables of Zhang & Sun, Differentiable Sparse Identification of Lagrangian Dynamics (AAAI 2026), "
    "with the methods run here on the same data and the paper's published numbers beside them. In each row "
    "the best value is marked. Made by python -m reproduction.collate from the records of the runs."
)


def page(results: Results, paper: dict, remarks: dict[str, str]) -> Page:
    """Return all tables of all groups of runs that the records hold."""
    sections = []
    for group in results.groups:
        tables = group_tables(results, group, paper)
        if tables:
            told = experiments(results, group, paper)
            tables += [told] if told else []
            sections.append(Section(group.title, tables, findings(results, group, paper, remarks)))
    for group in results.groups:
        table = ablation(results, group, paper)
        if table:
            sections.append(Section(f"Second table. {group.title}", [table]))
    for group in results.groups:
        tables = without_candidates(results, group, paper)
        if tables:
            sections.append(Section(f"Without candidates. {group.title}", tables))
    pace = speed(results)
    if pace:
        sections.append(Section("Speed", pace))
    return Page("Reproduction: tables", LEAD, sections, origin(results))


def origin(results: Results) -> list[tuple[str, str]]:
    """Return commits, machines, versions and dates of the records."""
    records = results.records
    dates = sorted(r["date"] for r in records)
    machines = Counter(_machine(r["machine"]) for r in records)
    commits = Counter(r["commit"][:12] + r["commit"][40:] or "unknown" for r in records)
    packages: dict[str, set[str]] = {}
    for r in records:
        for name, version in r["versions"].items():
            packages.setdefault(name, set()).add(version)
    failed = len(results.failed)
    return [
        ("Runs", f"{len(records)}, of which {failed} without an answer"),
        ("Dates", dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"),
        ("Commits", _counted(commits)),
        ("Machines", _counted(machines)),
        ("Versions", ", ".join(f"{n} {'/'.join(sorted(v))}" for n, v in sorted(packages.items()))),
    ]


def _machine(machine: dict) -> str:
    cores, parallel = machine["cores"], machine["parallel_runs"]
    runs = "one run" if parallel == 1 else f"{parallel} runs"
    return f"{machine['processor']}, {cores} cores, {machine['system']}, {runs} at a time"


def _counted(counts: Counter[str]) -> str:
    return "; ".join(f"{name} ({n} run{'s' * (n != 1)})" for name, n in counts.most_common())


def unexplained(sections: tuple[Section, ...] | list[Section]) -> list[Finding]:
    """Return the findings that no remark explains."""
    return [f for section in sections for f in section.findings if not f.remark]


def mixed_settings(results: Results) -> list[str]:
    """Return the cells of the paper's method whose runs were made with different searched settings."""
    seen: dict[str, set[str]] = {}
    for r in (r for r in results.where(method="adam").records if r["result"]["finished"]):
        config = r["config"]
        name = " ".join(f"adam {config['variant']} {config['system']} {config['noise']:g}".split())
        searched = {k: v for k, v in r["result"].get("settings", {}).items() if k != "start_coefficients"}
        seen.setdefault(name, set()).add(json.dumps(searched, sort_keys=True))
    return [name for name, settings in seen.items() if len(settings) > 1]


@click.command(help=__doc__.split("\n\n")[0])
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), default=HERE / "results")
@click.option("--output", type=click.Path(file_okay=False, path_type=Path), default=HERE / "tables")
@click.option("--remarks", type=click.Path(dir_okay=False, path_type=Path), default=HERE / "remarks.json")
def main(results: Path, output: Path, remarks: Path) -> None:
    try:
        found = read(results)
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    if not found.records:
        raise click.ClickException(f"{results} holds no records; make some by python -m reproduction.run")
    paper = json.loads((HERE / "paper.json").read_text(encoding="utf-8"))
    words = json.loads(remarks.read_text(encoding="utf-8")) if remarks.exists() else {}
    whole = page(found, paper, words)
    la.io.write_text(output / "tables.md", markdown(whole))
    click.echo(output / "tables.md")
    for finding in unexplained(whole.sections):
        click.echo(f"no remark for {finding.key}", err=True)
    for name in mixed_settings(found):
        click.echo(f"runs with different settings: {name}; remove the older records and run again", err=True)


if __name__ == "__main__":
    main()
