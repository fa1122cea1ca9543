"""What the commands print: tables, the model, a line that says what is going on."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from leastaction.cli.text import in_options, one_line
from leastaction.identifiers import counted

if TYPE_CHECKING:
    from leastaction import LagrangianModel
    from leastaction.model.term import ModelTerm
    from leastaction.simulation.forecast import ForecastResult

__all__ = ["live_progress", "say", "show_forecast", "show_model", "show_table", "warn", "warn_of_doubts"]

Rows = Sequence[Sequence[str]]

_STAGES = {
    "prepare": "preparing",
    "search": "searching the weak form",
    "shapes": "looking for shape parameters",
    "select": "choosing terms",
    "knots": "refining knots",
    "coarse": "comparing with a coarser spline",
    "confirm": "confirming on the whole recording",
    "drift": "following drifting forces",
    "descent": "descending",
    "verify": "verifying",
    "forecast": "forecasting",
    "report": "writing the report",
}

_LONGEST_LAW = 100  # characters of a law on the way


def _law(coefficients: Mapping[str, float]) -> str:
    """The law so far: coefficients and terms in the sequence of the library."""
    text = ", ".join(f"{value:.3g} {name}" for name, value in coefficients.items())
    return text if len(text) <= _LONGEST_LAW else text[: _LONGEST_LAW - 1] + "…"


_DETAILS: dict[str, Callable[[Any], str]] = {
    "terms": partial(counted, noun="term"),
    "evidence": "evidence {:.1f}".format,
    "knots_per_second": "{:.0f} knots per second".format,
    "coefficients": _law,
    "forecast_error": "forecasts off by {:.2g} of the spread".format,
    "before": "{:.2g} before".format,
}


def _named(name: str, value: Any) -> str:
    """A number that has no words of its own, such as the slow force on a coordinate."""
    return f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"


def say(text: str = "", **style: Any) -> None:
    """Print a line on stdout."""
    click.secho(text, **style)


def warn(text: str) -> None:
    """Print a warning on stderr."""
    click.secho(f"warning: {one_line(in_options(text))}", err=True, fg="yellow")


def warn_of_doubts(what: str, model: LagrangianModel) -> None:
    """Print the warnings of a model that is not ok on stderr."""
    warn(f"{what} is {model.fit.status}: {'; '.join(model.fit.sentences('warning', 'command line'))}")


@contextmanager
def live_progress(stage: str, every: bool = False) -> Iterator[Callable[[str, dict], None]]:
    """Give a function that shows the stage and its numbers in one line of the terminal, if there is one.

    With ``every`` each has a line of its own on stderr, in a file, too.
    """
    if every:
        yield lambda stage, details: click.echo(describe(stage, details), err=True)
        return
    if not sys.stderr.isatty():
        yield lambda stage, details: None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(describe(stage, {}))
        yield lambda stage, details: progress.update(task, description=describe(stage, details))


def describe(stage: str, details: dict[str, Any]) -> str:
    """Return a stage of `discover` and its numbers in words.

    Examples
    --------
    >>> describe("select", {"terms": 5, "evidence": 1234.567})
    'choosing terms: 5 terms, evidence 1234.6'
    """
    parts = [
        _DETAILS[name](value) if name in _DETAILS else _named(name, value)
        for name, value in details.items()
        if not isinstance(value, float) or math.isfinite(value)
    ]
    return _STAGES.get(stage, stage) + (": " + ", ".join(parts) if parts else "")


def show_table(rows: Rows, headings: Mapping[int, str] | None = None) -> None:
    """Print a table whose first row is the header.

    In a terminal that is wide enough for its numbers it is laid out to fit; elsewhere every row is one line
    of plain text. `headings` maps the number of a row to a line before it.
    """
    if sys.stdout.isatty():
        from rich.console import Console

        console = Console(file=sys.stdout)
        # Beside the first column, which folds, nothing may be cut: a number without its end is wrong.
        numbers = sum(max(len(row[i]) for row in rows) + 2 for i in range(1, len(rows[0])))
        if console.width >= numbers + 16:
            console.print(_rich_table(rows, headings or {}))
            return
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for k, row in enumerate(rows):
        if headings and k in headings:
            say(headings[k])
        say("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def _rich_table(rows: Rows, headings: Mapping[int, str]):
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    for i, name in enumerate(rows[0]):
        table.add_column(Text(name), no_wrap=i > 0, overflow="fold")
    for k, row in enumerate(rows[1:], start=1):
        if k in headings:
            table.add_row(Text(headings[k], style="italic"))
        table.add_row(*(Text(cell) for cell in row))
    return table


def with_error(term: ModelTerm) -> str:
    """Return a coefficient and its standard error, both to the second digit of the error."""
    from leastaction.model.notation import rounded

    value = rounded(term.coefficient, term.standard_error)
    if term.known:
        return f"{value} (known)"
    if not term.standard_error > 0:
        return value
    return f"{value} ± {rounded(term.standard_error, term.standard_error)}"


def show_model(
    model: LagrangianModel,
    lengths: Mapping[str, float] | None = None,
    forecast: ForecastResult | None = None,
) -> None:
    """Print Lagrangian, table, status, warnings, and what was left out before the fit.

    With lengths of links, also gravity. With a forecast of held-out trials, the verdict gives its error.
    """
    from leastaction.findings import as_given
    from leastaction.model.notation import interval_text, plain_sum, z_text
    from leastaction.model.text import resting_lines, simple_lines, symmetry_lines

    widths = model.fit.smoothing_widths
    say(f"L = {plain_sum(model.terms, model.expressions, widths=widths)}")
    if model.dissipation:
        say(f"psi = {plain_sum(model.dissipation, model.dissipation_expressions, widths=widths)}")
    say()
    rows = [("term", "coefficient", "95 % interval", "z")]
    rows += [
        (as_given(term.written, widths), with_error(term), interval_text(term), z_text(term.z))
        for term in (*model.terms, *model.dissipation)
    ]
    headings = {len(model.terms) + 1: "friction, psi:"} if model.dissipation else {}
    calibrated = model.calibration.numbers if model.calibration else ()
    for heading, shapes in (("shape parameters:", model.shapes), ("calibration numbers:", calibrated)):
        headings |= {len(rows): heading} if shapes else {}
        numbers = (shape.as_term() for shape in shapes)
        rows += [(number.written, with_error(number), interval_text(number), "") for number in numbers]
    for heading, differences in _differences(model):
        headings[len(rows)] = heading
        rows += [
            (as_given(d.expression, widths), with_error(d), interval_text(d), z_text(d.z))
            for d in differences
        ]
    show_table(rows, headings)
    say()
    for line in simple_lines(model):
        say(line)
    for line in symmetry_lines(model):
        say(f"symmetry: {line}")
    for line in resting_lines(model):
        say(f"equilibrium: {line}")
    show_gravity(model, lengths)
    show_fit(model, forecast)


def show_gravity(model: LagrangianModel, lengths: Mapping[str, float] | None) -> None:
    """Print g/l of links, or g where lengths are given."""
    from leastaction.errors import InputError

    found = {f.code for f in model.fit.findings} & {"gravity-off", "length-unused"}
    try:
        ratios = model.gravity(lengths)
    except InputError as problem:
        if not found:
            warn(str(problem))
        ratios = model.gravity()
    for ratio in ratios:
        if ratio.clock is None:
            say(f"gravity: {ratio}")
        elif not found:  # else among the warnings of the fit
            say(f"WARNING: {ratio}", bold=True, fg="yellow")


def _differences(model: LagrangianModel) -> Iterator[tuple[str, list[ModelTerm]]]:
    """What differs in each further group of trials, below a heading."""
    groups = model.groups
    for name in groups.names[1:] if groups else ():
        differences = [d.as_term() for d in groups.of(name)] if groups else []
        if groups and differences:
            yield f"differences of {name} from {groups.names[0]}:", differences


def show_fit(model: LagrangianModel, forecast: ForecastResult | None = None) -> None:
    """Print the status of the fit, its warnings, and what was done to library and data."""
    from leastaction.findings import with_held_out

    doubts = model.fit.status != "ok"
    status = model.fit.status.upper() if doubts else "ok"
    color = "yellow" if doubts else "green"
    chi2 = f"chi2 per sample {model.fit.chi2_per_sample:.3g} ({model.fit.chi2_note})"
    say(f"fit: {status}, {chi2}", bold=True, fg=color)
    for name, text in with_held_out(model.fit.statements, forecast).items():
        say(f"{name}: {one_line(text)}")
    for text in model.fit.sentences("warning", "command line"):
        say(f"WARNING: {one_line(text)}", bold=True, fg="yellow")
    if doubts and not sys.stdout.isatty():
        # Where stdout goes to a file, whoever started the command still has to see this.
        warn_of_doubts("the fit", model)
    if model.diagnostics is None:
        return
    dropped = Counter(d.reason for d in model.diagnostics.dropped)
    if dropped:
        kinds = {"null": "without effect", "duplicate": "repeated", "dependent": "equal to others in effect"}
        parts = ", ".join(f"{count} {kinds.get(reason, reason)}" for reason, count in dropped.items())
        total = counted(sum(dropped.values()), "candidate")
        say(f"left out before the fit: {total} ({parts}); the report names them")
    for note in _notes(model):
        say(f"note: {one_line(note)}")


def _notes(model: LagrangianModel) -> Iterator[str]:
    """Notes that the statements and the law do not contain already; those of one kind in one sentence."""
    from leastaction.findings import STATED, alike, as_given, sentence
    from leastaction.model.text import smoothing_notes

    notes = [f for f in model.fit.findings if f.severity == "note" and f.code not in STATED]
    widths = model.fit.smoothing_widths
    if not smoothing_notes(model):
        notes = [f for f in notes if f.code != "friction-smoothed"]
    for *others, last in alike(notes):
        yield as_given("; ".join([*(f.message for f in others), sentence(last, "command line")]), widths)


def show_forecast(forecast: ForecastResult) -> None:
    """Print the errors of forecasts."""
    trials = counted(len(forecast.by_trial()), "trial")
    say(
        f"forecasts over {forecast.horizon:g} s: {counted(forecast.n_starts, 'start')} in {trials}, "
        f"{forecast.n_diverged} diverged; within tolerance for {forecast.valid_time:.3g} s (median)"
    )
    show_table(forecast.format_rows())
    for name, reason in forecast.skipped:
        say(f"note: trial {one_line(name)} skipped, {reason}")
