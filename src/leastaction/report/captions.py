"""Captions of the report, which state the content of each figure; some are shared with the app."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from leastaction.model.constants import SimpleConstants
from leastaction.model.diagnostics import HiddenMotion, PathPoint
from leastaction.model.linear import Equilibrium, Linearisation
from leastaction.model.mathml import Notation
from leastaction.model.symmetries import Symmetry
from leastaction.model.term import ShapeParameter
from leastaction.model.text import CONSERVED, agreement
from leastaction.report.series import Series
from leastaction.report.text import listed, percent, plain, plural, signed, typeset_all
from leastaction.simulation.forecast import ForecastResult

__all__ = [
    "MOTION_HEAD",
    "MOTION_TITLE",
    "NO_MOTIONS",
    "NO_SYMMETRIES",
    "SIMPLE_HEAD",
    "SIMPLE_TITLE",
    "SYMMETRY_HEAD",
    "SYMMETRY_TITLE",
    "curve_title",
    "departures",
    "energy_title",
    "estimate_title",
    "forecast_title",
    "motion_note",
    "motion_summary",
    "pareto_title",
    "path_title",
    "placed",
    "profile_title",
    "residual_title",
    "simple_note",
    "symmetry_note",
    "symmetry_summary",
    "zoom_title",
]

# Headings are pairs of a text and a class, "n" for columns of numbers.
SIMPLE_TITLE = "Simple numbers inside the intervals"
SIMPLE_HEAD = (
    ("coefficient of, or ratio of", ""),
    ("estimate", "n"),
    ("simple number", "n"),
    ("by chance", "n"),
)
SYMMETRY_TITLE = "Symmetries and conserved quantities"
SYMMETRY_HEAD = (("symmetry", ""), ("holds", ""), ("quantity", ""), ("along the recording", ""))
MOTION_TITLE = "Equilibria and small motions"
MOTION_HEAD = (("equilibrium", ""), ("it is", ""), ("small motions", ""), ("shape", ""))
NO_MOTIONS = (
    "None within the recorded range and a full turn of angles. Not computed if the law depends on time."
)
NO_SYMMETRIES = "Not computed if the law depends on time."

_PI = re.compile(r"(?<![\d.])3\.14159(?!\d)")  # to the digits of an equilibrium
_AS_NOISE = 0.15  # |rms / σ − 1|
_LAG_ONE = 0.1
_SLOW = 0.05
_EVEN = 1.2  # ratio of the two halves of an interval
_TAIL = 0.01  # share beyond 3 σ; 0.0027 for normal noise


def forecast_title(result: ForecastResult) -> str:
    """Error of the free runs."""
    over = plain(result.horizon)
    if result.n_diverged:
        starts = plural(result.n_starts, "forecast", "forecasts")
        return f"{result.n_diverged} of {starts} over {over} s diverged"
    if np.isnan(result.rms_over_std).all():
        return f"Forecasts over {over} s, without samples to compare them with"
    worst = int(np.nanargmax(result.rms_over_std))
    share, ratio = float(result.rms_over_std[worst]), float((result.rms / result.expected_rms)[worst])
    text = f"Forecasts over {over} s are off by {percent(share)} of the spread (rms"
    text += ", worst coordinate)" if len(result.coordinates) > 1 else ")"
    if not math.isfinite(ratio):
        return text
    if ratio < 1.5:
        return f"{text}: as for an exact model"
    if np.isfinite(result.coverage).any():
        inside = percent(float(np.nanmin(result.coverage)))
        return f"{text}; {inside} of the samples are in the 95 % band"
    times = f"{ratio:.0f}" if 10 <= ratio < 1e4 else plain(ratio, 2)
    return f"{text}: {times} times the error of an exact model"


def curve_title(series: Series, i: int, name: str) -> str:
    """Agreement of curve and samples."""
    if i not in series.measured:
        return estimate_title(series.estimate(i), name)
    ratio = _ratio(series, i)
    if math.isnan(ratio):
        return f"{name}: samples and fitted curve"
    if abs(ratio - 1.0) <= _AS_NOISE:
        return f"{name}: the distance between curve and samples agrees with the noise ({ratio:.2f} σ rms)"
    size = "smaller" if ratio < 1.0 else "larger"
    return f"{name}: the distance between curve and samples is {size} than the noise ({ratio:.2f} σ rms)"


def estimate_title(motion: HiddenMotion, name: str) -> str:
    """Accuracy of the motion of a coordinate without a sensor."""
    largest = plain(float(np.max(motion.reach)), 2)
    return f"{name}: not measured, but estimated from the equations (95 % band: at most ± {largest})"


def zoom_title(series: Series, name: str) -> str:
    """The stretch that is drawn."""
    start, stop = series.zoom
    return f"{name} from {plain(start, 4)} to {plain(stop, 4)} s, with its velocity and acceleration"


def _ratio(series: Series, i: int) -> float:
    sigma = float(series.model.noise_std[i])
    return float(np.sqrt(np.mean(series.all_residuals(i) ** 2))) / sigma if sigma > 0 else math.nan


def departures(series: Series, i: int) -> list[str]:
    """Ways in which the residuals of a coordinate differ from white, normal noise; the verdict reads them.

    None for a prescribed coordinate: no equation constrains its curve, so the curve follows part of the
    noise, and correlated residuals are no sign of a fault.
    """
    if i not in series.measured or series.model.coordinates[i] in series.model.prescribed:
        return []
    residuals, lags = series.all_residuals(i), series.correlation(i)
    sigma = max(float(series.model.noise_std[i]), 1e-300)
    findings: list[str] = []
    chance = 4.0 / math.sqrt(max(residuals.size, 1))
    if lags.size and abs(lags[0]) > _LAG_ONE + chance:
        findings.append(f"correlated from sample to sample ({signed(float(lags[0]), 2)})")
    elif lags.size > 1 and np.nanmax(np.abs(lags[1:]), initial=0.0) > _SLOW + chance:
        lag = 2 + int(np.nanargmax(np.abs(lags[1:])))
        findings.append(f"correlated at a lag of {lag} samples ({signed(float(lags[lag - 1]), 2)})")
    beyond = float(np.mean(np.abs(residuals) > 3 * sigma))
    if beyond > _TAIL:
        findings.append(f"{percent(beyond)} of them lie beyond 3 σ (0.27 % for normal noise)")
    return findings


def residual_title(series: Series, i: int, name: str) -> str:
    """Whether the residuals resemble white, normal noise."""
    if series.model.coordinates[i] in series.model.prescribed:
        return f"{name}: no equation constrains the curve, so it follows part of the noise"
    findings = departures(series, i)
    if not findings:
        return f"{name}: the residuals resemble white, normal noise"
    return f"{name}: the residuals are not white, normal noise: {'; '.join(findings)}"


def profile_title(shapes: Sequence[ShapeParameter]) -> str:
    """Whether the intervals of shape parameters are symmetric."""
    reach = {s.name: (s.upper - s.value) / (s.value - s.lower) for s in shapes}
    skewed = [name for name, ratio in reach.items() if not 1.0 / _EVEN < ratio < _EVEN]
    if not skewed:
        return "The likelihood is symmetric about every shape parameter"
    texts = [
        f"of {name} extends {max(reach[name], 1.0 / reach[name]):.1f} times as far "
        f"{'up as down' if reach[name] > 1.0 else 'down as up'}"
        for name in skewed
    ]
    return f"The 95 % interval {listed(texts)}"


def simple_note(found: SimpleConstants) -> str:
    """Explanation of the table of simple numbers, and the test of all of them together."""
    text = (
        "These are proposals; the coefficients above are estimates. In brackets: the standard error of the "
        "last digits. By chance: the expected number of entries of the short list of simple numbers in an "
        "interval of this width."
    )
    return (
        f"{text} All together: {agreement(found).replace('chi2', 'χ²')}." if len(found.offers) > 1 else text
    )


def symmetry_note(symmetries: Sequence[Symmetry]) -> str:
    """Explanation of the words that occur in the table of symmetries."""
    parts = (
        (
            any(s.holds == "in form" for s in symmetries),
            "In form: for any coefficients.",
        ),
        (
            any(s.holds == "within errors" for s in symmetries),
            "Within the error bars: the coefficients satisfy the symmetry (χ² at a false-alarm rate of "
            "0.001); in brackets, the relative standard error of this test.",
        ),
        (
            any(s.kind not in CONSERVED for s in symmetries),
            "A reversal of time or an exchange has no conserved quantity.",
        ),
        (
            any(s.kind in CONSERVED and math.isfinite(s.drift) and not s.obstacles for s in symmetries),
            "“Conserved to”: the rms deviation from the mean of a trial along the fitted curve, relative to "
            "the sizes of the addends, in the worst trial.",
        ),
    )
    return " ".join(text for present, text in parts if present)


def motion_note(left_out: Sequence[str], notation: Notation) -> Markup:
    """Explanation of the table of small motions; `left_out` are terms of dry friction."""
    text = Markup(
        "In brackets: the standard error of the last digits, from that of the coefficients. Frequencies, "
        "damping ratios and shapes do not depend on the scale of L. A shape lists deviations relative to the "
        "largest, each in the unit of its coordinate; an angle is the phase by which a coordinate leads."
    )
    if left_out:
        terms = Markup(", ").join(map(notation.term, left_out))
        text += Markup(" Dry friction is left out, because it has no derivative at rest: {}.").format(terms)
    return text


def symmetry_summary(symmetries: Sequence[Symmetry]) -> str:
    """Number of symmetries, and conserved quantities."""
    text = plural(len(symmetries), "symmetry", "symmetries")
    constant = [CONSERVED[s.kind] for s in symmetries if s.kind in CONSERVED and not s.obstacles]
    return f"{text}; conserved: {', '.join(dict.fromkeys(constant)) or 'nothing'}"


def motion_summary(motions: Sequence[tuple[Equilibrium, Linearisation | None]], notation: Notation) -> str:
    """Natural frequencies about the first stable equilibrium; empty without oscillations."""
    for rest, system in motions:
        paces = () if system is None else [m.pace.partition(",")[0] for m in system.modes if m.pole.imag]
        if rest.stability != "unstable" and paces:
            names = [notation.text(name) for name in notation.coordinates]
            several = "Natural frequencies" if len(paces) > 1 else "Natural frequency"
            place = placed(rest.place(names))
            return f"{several} about {place} ({rest.standing}): {typeset_all(listed(paces))}."
    return ""


def placed(text: str) -> str:
    """Coordinates of an equilibrium, for display.

    Examples
    --------
    >>> placed("θ = 3.14159, x -0.5")
    'θ = π, x −0.5'
    """
    return typeset_all(_PI.sub("π", text))


def energy_title(energy: dict[str, Any]) -> str:
    """Changes of the energy."""
    if energy["driven"] and energy["friction"]:
        text = "Forces and friction change the energy"
    elif energy["driven"]:
        text = "Known forces change the energy"
    elif energy["friction"]:
        ends = f"from {energy['start']} to {energy['stop']}"
        text = f"Friction lowers the energy {ends} on trial {energy['shown']}"
    else:
        text = f"No force or friction acts: the energy should stay at {energy['start']}"
    if energy["imbalance"]:
        text += f"; {energy['imbalance']} of the mean kinetic energy is unexplained (worst trial)"
    return text


def path_title(path: Sequence[PathPoint]) -> str:
    """Differences of the neighbouring structures from the chosen one."""
    chosen = next(point for point in path if point.chosen)
    rivals = [p.bic for p in path if not p.chosen and p.n_terms == chosen.n_terms]
    smaller = [p.bic for p in path if p.n_terms == chosen.n_terms - 1]
    larger = [p.bic for p in path if p.n_terms == chosen.n_terms + 1]
    cases = (("one term less", smaller), ("one more", larger), ("best competing structure", rivals))
    parts = [f"{what} {signed(min(values))}" for what, values in cases if values]
    text = f"{plural(chosen.n_terms, 'free term', 'free terms')}"
    return f"{text}; difference in BIC: {', '.join(parts)}" if parts else f"{text}, with no alternative"


def pareto_title(points: Sequence[PathPoint]) -> str:
    """Differences of the next shorter and the next longer structure."""
    place = next(k for k, point in enumerate(points) if point.chosen)
    here = points[place].length
    sides = (("shorter", points[max(place - 1, 0) : place]), ("longer", points[place + 1 : place + 2]))
    parts = [f"{abs(p.length - here):.1f} bits {what} {signed(p.cost)}" for what, side in sides for p in side]
    text = f"The chosen law takes {here:.1f} bits"
    return f"{text}; difference in −2 log-likelihood: {', '.join(parts)}" if parts else text
