"""Figures of the model: selection path, energy, forecasts, a whisker for each coefficient."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np
from markupsafe import Markup
from scipy.interpolate import PchipInterpolator

from leastaction.model.diagnostics import HiddenMotion, PathPoint
from leastaction.model.notation import interval_text, rounded
from leastaction.model.term import INTERVAL_RISE, ModelTerm, ShapeParameter
from leastaction.report.axes import HALF, Axes, thin_line
from leastaction.report.series import Energy
from leastaction.report.text import plain, signed
from leastaction.report.ticks import Folded, Linear
from leastaction.simulation.forecast import ForecastTrace

__all__ = [
    "draw_forecast",
    "draw_path",
    "energy_of_trial",
    "energy_of_trials",
    "forecast_panel",
    "pareto_figure",
    "path_axes",
    "path_figure",
    "profile_figure",
    "whisker",
    "whisker_axis",
]

_MOST_TRIALS = 60
_OTHER_POINTS = 200  # of a trial in a panel of many trials


def path_figure(path: Sequence[PathPoint]) -> Markup:
    """ΔBIC and −2 Δ log likelihood against the number of terms."""
    chosen = next(p for p in path if p.chosen)
    best: dict[int, PathPoint] = {}
    for point in path:
        best.setdefault(point.n_terms, point)
    best[chosen.n_terms] = chosen
    sizes = sorted(best)
    rest = [p for p in path if p is not best[p.n_terms]]
    axes = path_axes((HALF[0], 320.0))
    draw_path(axes, [best[n] for n in sizes])
    axes.dots(np.array([p.n_terms for p in rest]), np.array([p.bic for p in rest]), "fit", 4.0, opacity=0.55)
    axes.label("number of free terms", "difference from the chosen structure")
    said = ", ".join(f"{n}: {signed(best[n].bic)}" for n in sizes if n != chosen.n_terms)
    return axes.svg(
        "path",
        f"ΔBIC against the number of free terms; {chosen.n_terms} are chosen",
        f"BIC of the best structure of each size, from the chosen one: {said or 'no other size'}",
    )


def pareto_figure(points: Sequence[PathPoint]) -> Markup:
    """−2 Δ log likelihood against description length, of structures that no shorter one fits equally well."""
    axes = Axes((HALF[0], 320.0), x=Linear(room=45.0), y=Folded())
    bits, cost = np.array([[p.length, p.cost] for p in points]).T
    chosen = np.array([p.chosen for p in points])
    axes.line(bits, cost, "fit", 1.5)
    axes.dots(bits, cost, "fit", 7.0)
    axes.dots(bits[chosen], cost[chosen], "forecast", 12.0, above=True)
    axes.label("description length (bits)", "−2 Δ log-likelihood, from the chosen structure")
    said = ", ".join(f"{p.length:.1f} bits: {signed(p.cost)}" for p in points if not p.chosen)
    length = ", ".join(f"{x:.1f}" for x in bits[chosen])
    return axes.svg(
        "pareto",
        f"Likelihood against description length; the chosen structure takes {length} bits",
        f"−2 Δ log-likelihood of the structures, from the chosen one: {said or 'no other structure'}",
    )


def profile_figure(shape: ShapeParameter) -> Markup:
    """−2 log likelihood about a shape parameter, its parabola, and the 95 % interval."""
    places, rise = np.array(shape.profile).T
    roots = np.where(places < shape.value, -1.0, 1.0) * np.sqrt(rise)
    x = np.linspace(places[0], places[-1], 121)
    axes = Axes(HALF)
    axes.band(x=(shape.lower, shape.upper))
    axes.rule(INTERVAL_RISE, "muted", 1.0, dashes="4 3")
    parabola = ((x - shape.value) / shape.standard_error) ** 2
    axes.line(x, parabola, "measured", 1.2, dashes="5 4")
    axes.line(x, PchipInterpolator(places, roots)(x) ** 2, "fit")
    axes.dots(places, rise, "fit", 4.0, above=True)
    axes.limit(y=(0.0, 1.15 * max(float(rise.max()), INTERVAL_RISE)))
    axes.label(shape.name, "rise of −2 log likelihood")
    interval = interval_text(shape.as_term())
    return axes.svg(
        f"profile-{shape.name}",
        f"Profile likelihood of {shape.name}",
        f"Lowest at {plain(shape.value, full=True)}; the 95 % interval is {interval}",
    )


def path_axes(size: tuple[float, float]) -> Axes:
    """Axes of a selection path: integer numbers of terms, and differences of any size and sign."""
    return Axes(size, x=Linear(room=45.0, whole=True), y=Folded())


def draw_path(axes: Axes, best: Sequence[PathPoint]) -> None:
    """Draw the criterion and the misfit of the best structure of each size, and mark the chosen one."""
    sizes = np.array([point.n_terms for point in best])
    cost, bic = (np.array([getattr(point, key) for point in best]) for key in ("cost", "bic"))
    axes.line(sizes, cost, "measured", 1.2, dashes="4.8 3.6")
    axes.dots(sizes, cost, "measured", 6.0)
    axes.line(sizes, bic, "fit", 1.5)
    axes.dots(sizes, bic, "fit", 7.0)
    chosen = np.array([point.chosen for point in best])
    axes.dots(sizes[chosen], bic[chosen], "forecast", 12.0, above=True)
    axes.limit(x=(sizes[0] - 0.5, sizes[-1] + 0.5))


def energy_of_trial(energy: Energy, balance: bool) -> Markup:
    """Kinetic and potential energy and their sum, counted from the lowest potential energy."""
    axes = Axes((HALF[0], 270.0))
    floor = float(energy.potential.min())
    total = energy.total - floor
    if balance:
        # A band below the line of the total; if the balance holds, the line lies in it.
        axes.line(*thin_line(energy.t, energy.expected - floor), "measured", 5.0)
    axes.line(*thin_line(energy.t, energy.kinetic), "forecast", 1.2)
    axes.line(*thin_line(energy.t, energy.potential - floor), "fit", 1.2)
    axes.line(*thin_line(energy.t, total), "ink", 1.6)
    axes.limit(y_from=0.0)
    axes.label("t (s)", "energy (units of L)")
    said = f"The total goes from {plain(float(total[0]))} to {plain(float(total[-1]))}, in units of L"
    return axes.svg("energy", "Kinetic, potential and total energy along the fitted curve", said)


def energy_of_trials(energies: Sequence[Energy], shown: int) -> Markup:
    """Total energy of every trial; the trial of the other panel in full colour."""
    axes = Axes((HALF[0], 270.0))
    floor = min(float(e.potential.min()) for e in energies)
    for k, energy in enumerate(energies[:_MOST_TRIALS]):
        t, total = thin_line(energy.t - energy.t[0], energy.total - floor, _OTHER_POINTS)
        bold = k == shown
        axes.line(t, total, "ink" if bold else "measured", 1.8 if bold else 1.1)
    axes.limit(y_from=0.0)
    axes.label("time from the start of the trial (s)", "total energy (units of L)")
    starts = [float(e.total[0]) - floor for e in energies]
    said = f"{len(energies)} trials, which begin between {plain(min(starts))} and {plain(max(starts))}"
    return axes.svg("energies", "Total energy along the fitted curves of all trials", said)


def forecast_panel(trace: ForecastTrace, i: int, name: str, unit: str, key: str) -> Markup:
    """Measured samples and the free run of one coordinate, and below them the difference."""
    axes = Axes((HALF[0], HALF[1] - 18.0))
    reach = None if trace.reach is None else trace.reach[:, i]
    draw_forecast(axes, trace.t, trace.measured[:, i], trace.forecast[:, i])
    if reach is not None:
        axes.strip(trace.t, trace.forecast[:, i] - reach, trace.forecast[:, i] + reach, "forecast")
    errors = _errors_of_forecast(trace, i, reach, (name, unit), f"{key}e")
    axes.label("" if errors else "t (s)", name, y_unit=unit)  # one axis of time for both
    far = "no error known" if np.isnan(trace.rms[i]) else f"rms error {plain(float(trace.rms[i]))} {unit}"
    title = f"{name} of trial {trace.trial} from {trace.origin:.4g} s: forecast and samples"
    said = f"Measured samples, and the free run as a line; {far}"
    return axes.svg(key, title, said) + errors


def _errors_of_forecast(
    trace: ForecastTrace, i: int, reach: np.ndarray | None, label: tuple[str, str], key: str
) -> Markup:
    """Measured − forecast while it is small, in the band that should hold 95 % of the samples."""
    axes, error = Axes((HALF[0], 130.0)), trace.measured[:, i] - trace.forecast[:, i]
    there = np.isfinite(error)
    if not there.any():
        return Markup("")
    known = np.zeros(0) if reach is None else reach[np.isfinite(reach)]
    most = max(float(np.quantile(np.abs(error[there]), 0.99)), float(known.max(initial=0.0)))
    if reach is not None:
        axes.strip(trace.t, -reach, reach, "forecast")
    axes.rule(0.0, "forecast", 1.2)
    axes.samples(trace.t, error, 2.4)
    axes.limit(x=(trace.t[0], trace.t[-1]), y=(-1.1 * most or -1.0, 1.1 * most or 1.0))
    axes.label("t (s)", "measured − forecast", y_unit=label[1])
    title = f"{label[0]} of trial {trace.trial} from {trace.origin:.4g} s: measured minus forecast"
    return axes.svg(key, title, f"Errors of the forecast as dots, in units of {label[1] or 'the coordinate'}")


def draw_forecast(
    axes: Axes, t: np.ndarray, measured: np.ndarray, run: np.ndarray, estimate: HiddenMotion | None = None
) -> None:
    """Draw samples, or the estimate if there are none, and over them the free run while it is near them."""
    if estimate is None:
        axes.samples(t, measured, 4.6)
    else:
        measured = estimate.q
        axes.strip(t, measured - estimate.reach, measured + estimate.reach, "fit")
        axes.line(*thin_line(t, measured), "fit", 2.6, dashes="7 5")
    there = np.isfinite(run)
    seen = measured[np.isfinite(measured)]
    if seen.size:
        # A run that leaves the data must not determine the scale.
        low, high = seen.min(), seen.max()
        reach = max(float(high - low), 1e-12)
        there &= (run > low - 20 * reach) & (run < high + 20 * reach)
        ends = np.concatenate([seen, np.clip(run[there], low - reach, high + reach)])
        pad = 0.06 * max(float(np.ptp(ends)), 1e-12)
        axes.limit(y=(ends.min() - pad, ends.max() + pad))
    axes.line(*thin_line(t[there], run[there]), "forecast", 1.3)
    axes.limit(x=(t[0], t[-1]))


# Dot and whisker of a coefficient, px.
_WIDTH, _HEIGHT = 240, 20
_ZERO, _FOUND = 20.0, 120.0  # px: the coefficient is found at 1, in units of itself
_LOW, _HIGH = 4.0, 236.0


def whisker(term: ModelTerm, key: str) -> Markup:
    """Draw the interval in units of the coefficient, so that all rows share one axis from zero.

    Parameters
    ----------
    term : ModelTerm
    key : str
        Unique on the page.

    Returns
    -------
    Markup
        One ``<svg>``: without a standard error only the dot, for a known coefficient a hollow square.
    """
    half = term.upper - term.coefficient
    share = half / abs(term.coefficient) if term.coefficient else math.inf
    middle = _HEIGHT / 2
    parts = [f'<path class="zero" d="M{_ZERO:g} 0v{_HEIGHT}"/>']
    if term.known:
        text, kind = "given, not estimated", "given"
        parts.append(f'<rect class="dot" x="{_FOUND - 4:g}" y="{middle - 4:g}" width="8" height="8"/>')
    else:
        text, kind = _in_words(share), "weak" if share >= 1.0 else "sure"
        if not math.isnan(share):
            parts.append(f'<path class="bar" d="{_bar(share, middle)}"/>')
        parts.append(f'<circle class="dot" cx="{_FOUND:g}" cy="{middle:g}" r="3.5"/>')
    return Markup(
        f'<svg class="whisker {kind}" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-labelledby="{key}">'
        f'<title id="{key}">{escape(text)}</title>{"".join(parts)}</svg>'
    )


def whisker_axis() -> Markup:
    """Labels of the two marks of the axis; the heading of the table repeats them for screen readers."""
    return Markup(
        f'<svg class="whisker" viewBox="0 0 {_WIDTH} {_HEIGHT}" aria-hidden="true">'
        f'<text class="tick" text-anchor="middle" x="{_ZERO:g}" y="15">0</text>'
        f'<text class="tick" text-anchor="middle" x="{_FOUND:g}" y="15">coefficient</text></svg>'
    )


def _bar(share: float, y: float) -> str:
    """Path of the whisker, with an arrow head at an end outside of the figure."""
    reach = share * (_FOUND - _ZERO) if math.isfinite(share) else math.inf
    path = ""
    for edge, side in ((_LOW, -1), (_HIGH, 1)):
        x = _FOUND + side * reach
        if (x - edge) * side > 0:
            path += f"M{_FOUND:g} {y:g}H{edge:g}m{-side * 5} -4l{side * 5} 4l{-side * 5} 4"
        else:
            path += f"M{_FOUND:g} {y:g}H{x:.1f}"
    return path


def _in_words(share: float) -> str:
    if math.isnan(share):
        return "no standard error"
    if share >= 1.0:
        return "the 95 % interval includes zero"
    return f"the 95 % interval ends {rounded(100 * share, digits=2)} % of the coefficient to either side"
