r"""``leastaction demo``: a discovery on measured data, beside what their authors published.

The recordings are in ``leastaction/datasets`` (its README gives source and licence). They are consecutive
pieces of one decaying swing, so every third piece is held out: fitted and forecast pieces then span the same
amplitudes. Angles are measured from upright, so with height h = a cos θ the gravity term of L = T − V is
−m g a cos θ. A passive system fixes L only up to a factor; here the coefficient of the first squared
velocity is 1. The candidates are those one would write down without knowing the answer: products of two
velocities with cosines and sines of the angles and of their difference, the first harmonics of the
potential, and viscous and dry (Coulomb) friction in both joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from leastaction.cli.discover import OUTPUTS, command_line, write_outputs
from leastaction.cli.output import check_folder
from leastaction.cli.show import live_progress, say, show_fit, show_table, with_error
from leastaction.cli.text import complete_folder, shown
from leastaction.identifiers import counted

if TYPE_CHECKING:
    from leastaction import LagrangianModel, Trajectories
    from leastaction.simulation.forecast import ForecastResult

__all__ = ["DEMOS", "HELD_OUT", "Demo", "demo", "load_demo_data", "published_model"]


HELD_OUT = slice(2, None, 3)
"""Trials that are not fitted but forecast."""


@dataclass(frozen=True)
class Demo:
    """One measured pendulum.

    Attributes
    ----------
    title, file : str
        What it is; name of the file in ``leastaction/datasets``.
    coordinates : tuple of str
        All of them angles, from upright.
    candidates, dissipation : tuple of str
        For L and for the dissipation function.
    known : dict
        The coefficient that sets the scale of L.
    published, published_dissipation : dict
        Expression -> coefficient by the authors of the data, on the same scale.
    """

    title: str
    file: str
    coordinates: tuple[str, ...]
    candidates: tuple[str, ...]
    dissipation: tuple[str, ...]
    known: Mapping[str, float]
    published: Mapping[str, float]
    published_dissipation: Mapping[str, float]


def _single() -> Demo:
    # Without theta_dot**2*cos(theta): with one coordinate and little friction it hardly differs from a
    # change of cos(theta) and cos(2*theta) together.
    m, a, inertia, k, g = 0.147755, 0.147585, 1.0912e-4, 2.2394e-4, 9.81001
    scale = (inertia + m * a**2) / 2
    return Demo(
        title="single pendulum",
        file="single_pendulum.csv.gz",
        coordinates=("theta",),
        candidates=(
            "theta_dot**2",
            "theta_dot**2*sin(theta)",
            "theta_dot**4",
            "cos(theta)",
            "sin(theta)",
            "cos(2*theta)",
            "sin(2*theta)",
            "cos(3*theta)",
        ),
        dissipation=("theta_dot**2/2", "abs(theta_dot)"),
        known={"theta_dot**2": 1.0},
        published={"theta_dot**2": 1.0, "cos(theta)": -m * g * a / scale},
        published_dissipation={"theta_dot**2/2": k / scale},
    )


def _double() -> Demo:
    m1, m2, a1, length1, inertia1 = 0.0938440, 0.137596, 0.108565, 0.172719, 4.37529e-4
    k1, k2 = 2.37143e-4, 1e-5
    scale = (inertia1 + m1 * a1**2 + m2 * length1**2) / 2
    return Demo(
        title="double pendulum",
        file="double_pendulum.csv.gz",
        coordinates=("theta1", "theta2"),
        candidates=(
            "theta1_dot**2",
            "theta2_dot**2",
            "theta1_dot*theta2_dot*cos(theta1-theta2)",
            "theta1_dot*theta2_dot*sin(theta1-theta2)",
            "theta1_dot*theta2_dot",
            "theta1_dot**2*cos(theta1)",
            "theta2_dot**2*cos(theta2)",
            "theta1_dot**2*cos(theta1-theta2)",
            "theta2_dot**2*cos(theta1-theta2)",
            "cos(theta1)",
            "cos(theta2)",
            "sin(theta1)",
            "sin(theta2)",
            "cos(theta1-theta2)",
            "cos(2*theta1)",
            "cos(2*theta2)",
        ),
        dissipation=(
            "theta1_dot**2/2",
            "theta2_dot**2/2",
            "(theta2_dot-theta1_dot)**2/2",
            "abs(theta1_dot)",
            "abs(theta2_dot-theta1_dot)",
        ),
        known={"theta1_dot**2": 1.0},
        published={
            "theta1_dot**2": 1.0,
            "theta2_dot**2": 0.55684,
            "theta1_dot*theta2_dot*cos(theta1-theta2)": 0.98270,
            "cos(theta1)": -117.922,
            "cos(theta2)": -55.806,
        },
        # Friction of the second joint goes with the angle between the links.
        published_dissipation={"theta1_dot**2/2": k1 / scale, "(theta2_dot-theta1_dot)**2/2": k2 / scale},
    )


DEMOS: dict[str, Demo] = {"double": _double(), "single": _single()}
"""Name of the system on the command line -> demonstration."""


@click.command(
    short_help="Find the Lagrangian of a measured pendulum.",
    epilog="""\b
Example:
  leastaction demo --system single --output single-pendulum
""",
)
@click.option(
    "--system",
    type=click.Choice(list(DEMOS)),
    default="double",
    show_default=True,
    help="Measured pendulum to analyse.",
)
@click.option(
    "--output",
    default="leastaction-demo",
    show_default=True,
    metavar="DIR",
    shell_complete=complete_folder,
    help="Directory for model.json and report.html.",
)
@click.pass_context
def demo(ctx: click.Context, system: str, output: str) -> None:
    """Find the Lagrangian of a measured pendulum that is included in the package.

    Some pieces of the recording are held out. Coefficients and forecasts are compared with those of the
    parameters that the authors of the data published.
    """
    folder = check_folder(output, OUTPUTS)
    chosen = DEMOS[system]
    data = load_demo_data(chosen)
    held_out = data[HELD_OUT]
    fitted = data.select([name for name in data.names if name not in held_out.names])
    say(
        f"Measured {chosen.title}: {len(data)} trials, {data.n_samples} samples, "
        f"{counted(len(held_out), 'trial')} held out; "
        f"{len(chosen.candidates)} candidates for L, {len(chosen.dissipation)} for friction."
    )
    import leastaction

    library = leastaction.Library(
        chosen.candidates, chosen.coordinates, angles=chosen.coordinates, dissipation=chosen.dissipation
    )
    with live_progress("prepare") as progress:
        model = leastaction.discover(fitted, library, known=chosen.known, progress=progress)
        progress("forecast", {})
        published = published_model(chosen, model)
        forecasts = {"found": model.validate(held_out), "published": published.validate(held_out)}
        progress("report", {})
        write_outputs(folder, model, forecasts["found"], command_line(ctx))
    say()
    _show_coefficients(chosen, model)
    say()
    show_fit(model, forecasts["found"])
    say()
    _show_forecasts(forecasts)
    say()
    for name in OUTPUTS:
        say(f"{name.partition('.')[0]}: {shown(folder / name)}")


def load_demo_data(chosen: Demo) -> Trajectories:
    """Read the recording from the package."""
    from importlib.resources import as_file, files

    from leastaction.io import read_csv

    with as_file(files("leastaction") / "datasets" / chosen.file) as path:
        return read_csv(path, chosen.coordinates, angles=chosen.coordinates)


def published_model(chosen: Demo, like: LagrangianModel) -> LagrangianModel:
    """Return the model with the published parameters, judged by the noise of another one."""
    from leastaction.model.model import LagrangianModel
    from leastaction.model.term import ModelTerm

    def terms(values: Mapping[str, float]) -> tuple[ModelTerm, ...]:
        return tuple(ModelTerm(text, value, known=True) for text, value in values.items())

    return LagrangianModel(
        chosen.coordinates,
        terms(chosen.published),
        terms(chosen.published_dissipation),
        noise_std=like.noise_std,
    )


def _show_coefficients(chosen: Demo, model: LagrangianModel) -> None:
    """Print the coefficients, found and published; "-" where a term is not in a model.

    Friction that two models divide among different terms is not compared coefficient by coefficient.
    """
    from leastaction.findings import as_given

    rows = [("term", "found", "published", "difference", "z")]
    headings = {}
    widths = model.fit.smoothing_widths
    texts = {term: as_given(term.expression, widths) for term in (*model.terms, *model.dissipation)}
    same_friction = {texts[term] for term in model.dissipation} == {*chosen.published_dissipation}
    kinds = (
        ("", model.terms, chosen.published, True),
        ("friction, psi:", model.dissipation, chosen.published_dissipation, same_friction),
    )
    for heading, terms, published, alike in kinds:
        headings |= {len(rows): heading} if heading else {}
        for term in terms:
            there = published.get(texts[term])
            z = "" if term.known else f"{term.z:.0f}"
            if there is None or not there:
                rows.append((texts[term], with_error(term), "-", "", z))
            else:
                off = f"{100 * (term.coefficient / there - 1):+.2f} %" if alike and not term.known else ""
                rows.append((texts[term], with_error(term), f"{there:.5g}", off, z))
        found = {texts[term] for term in terms}
        rows += [
            (text, "-", f"{value:.5g}", "", "") for text, value in published.items() if text not in found
        ]
    show_table(rows, headings)
    if not same_friction:
        say("The published model has other friction terms; single coefficients of friction do not compare.")


def _show_forecasts(forecasts: dict[str, ForecastResult]) -> None:
    """Print the errors of the forecasts of each model."""
    some = next(iter(forecasts.values()))
    starts = f"{counted(some.n_starts, 'start')} in {counted(len(some.by_trial()), 'trial')}"
    say(f"Forecasts of the trials held out: {starts}, each over {some.horizon:g} s.")
    rows = [("rms error", *(f"{name} (rad)" for name in some.coordinates), "over std", "diverged")]
    for name, result in forecasts.items():
        errors = (f"{value:.2g}" for value in result.rms)
        over = ", ".join(f"{value:.2g}" for value in result.rms_over_std)
        rows.append((f"{name} model", *errors, over, str(result.n_diverged)))
    show_table(rows)
