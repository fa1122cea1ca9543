"""``leastaction generate``: recordings of systems whose Lagrangian is known."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

import click

from leastaction.cli.output import check_file
from leastaction.cli.show import say
from leastaction.cli.text import complete_file, shown
from leastaction.cli.values import blame, number
from leastaction.errors import InputError
from leastaction.identifiers import counted

if TYPE_CHECKING:
    from leastaction.systems import MechanicalSystem

__all__ = ["FURTHER", "SYSTEMS", "generate"]

# As systems.names() and further_names(), which would take a second to import for --help.
SYSTEMS = (
    "single_pendulum",
    "double_pendulum",
    "spherical_pendulum",
    "chaotic_pendulum",
    "cart_spring_pendulum",
    "spherical_spring_pendulum",
    "magnetic_pendulum",
)
FURTHER = (
    "triple_pendulum",
    "robot_arm",
    "rotary_pendulum",
    "elastic_pendulum_cart",
    "spring_chain",
    "toda_chain",
    "double_well",
    "henon_heiles",
    "kepler_orbit",
    "morse_molecule",
)

_MAX_SAMPLES = 5_000_000


@click.command(
    epilog="""\b
Example:
  leastaction generate double_pendulum --noise 0.05 --trials 3 -o double.csv
"""
)
@click.argument(
    "system",
    metavar="SYSTEM",
    shell_complete=lambda ctx, param, incomplete: [
        n for n in (*SYSTEMS, *FURTHER) if n.startswith(incomplete)
    ],
)
@click.option("--noise", default="0.1", show_default=True, metavar="LEVEL", help="Noise, e.g. 0.1 or 10%.")
@click.option(
    "--noise-convention",
    type=click.Choice(["relative", "absolute"]),
    default="relative",
    show_default=True,
    help="Relative: LEVEL times the standard deviation of each coordinate. Absolute: in its unit.",
)
@click.option(
    "--trials", type=click.IntRange(1, 10_000), default=5, show_default=True, help="Number of trials."
)
@click.option(
    "--duration", default="20", show_default=True, metavar="SECONDS", help="Duration of each trial."
)
@click.option("--rate", default="100", show_default=True, metavar="HZ", help="Samples per second.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed; the same seed gives the same data.",
)
@click.option(
    "--missing",
    default="0",
    show_default=True,
    metavar="FRACTION",
    help="Fraction of samples missing at random.",
)
@click.option("--irregular", is_flag=True, help="Sample at irregular times.")
@click.option(
    "-o", "--output", required=True, metavar="FILE", shell_complete=complete_file, help="CSV file to write."
)
def generate(
    system: str, output: str, noise: str, duration: str, rate: str, missing: str, **options: Any
) -> None:
    """Generate noisy recordings of a system with a known Lagrangian.

    SYSTEM is one of single_pendulum, double_pendulum, spherical_pendulum (driven), chaotic_pendulum,
    cart_spring_pendulum, spherical_spring_pendulum and magnetic_pendulum (free); or one of the further
    systems triple_pendulum, robot_arm, rotary_pendulum, double_well (driven), elastic_pendulum_cart,
    spring_chain, toda_chain, henon_heiles, kepler_orbit and morse_molecule (free).
    """
    file = check_file(output)
    values: dict[str, Any] = dict(options)
    texts = {"noise": noise, "duration": duration, "rate": rate, "missing": missing}
    for option, text in texts.items():
        with blame(f"--{option}"):
            values[option] = _share(text) if option in ("noise", "missing") else number(text)
    if noise.rstrip().endswith("%") and values["noise_convention"] == "absolute":
        raise InputError(f"--noise {noise}: a percentage is relative; give the noise in the unit of the data")
    if abs(values["trials"] * values["duration"] * values["rate"]) > _MAX_SAMPLES:
        raise InputError(
            f"--trials times --duration times --rate is more than {_MAX_SAMPLES} samples; choose less"
        )
    from leastaction import systems
    from leastaction.io import write_csv

    source = systems.get(system)
    data = systems.generate(source, **values)
    write_csv(file, data)
    made = counted(len(data), "trial")
    say(f"{made} of the {source.title.lower()}, {data.n_samples} samples: {shown(output)}")
    say(f"next: {_next_command(source, output)}")


def _share(text: str) -> float:
    """A number, which may be written as a percentage."""
    plain = text.rstrip().removesuffix("%")
    return number(plain) / (1.0 if plain == text.rstrip() else 100.0)


def _next_command(system: MechanicalSystem, path: str) -> str:
    names = ",".join(system.coordinates)
    words = ["leastaction", "discover", path, "--coordinates", names]
    if system.forcing is not None:
        words += ["--forces", ",".join(f"{name}_force" for name in system.coordinates)]
    if system.angles:
        words += ["--angles", ",".join(system.angles)]
    for expression, value in system.known.items():
        words += ["--known", f"{expression}={value:.12g}"]
    if system.dissipation:
        words += ["--dissipation", ", ".join(system.dissipation)]
    return shown(shlex.join([*words, "--output", "found"]))
