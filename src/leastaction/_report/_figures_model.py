"""Figures of the model: selection path, energy, forecasts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from leastaction._diagnostics import PathPoint
from leastaction._forecast import ForecastTrace
from leastaction._report._series import Energy, legible_samples, thin_line
from leastaction._report._svg import COLOURS, HALF, dots, inline, label, panel
from leastaction._report._text import plain, signed

__all__ = [
    "energy_of_trial",
    "energy_of_trials",
    "folded",
    "forecast_panel",
    "frame_path",
    "path_figure",
    "unfolded",
]

_LINEAR = 10.0  # the axis of the path is linear within this and logarithmic beyond
_MOST_TRIALS = 60
_OTHER_POINTS = 200  # of a trial that is one line among many


def path_figure(path: Sequence[PathPoint]) -> Markup:
    """ΔBIC and −2 Δ log likelihood against the number of terms."""
    axes = panel((HALF[0], 320.0))
    chosen = next(p for p in path if p.chosen)
    best: dict[int, PathPoint] = {}
    for point in path:
        best.setdefault(point.n_terms, point)
    best[chosen.n_terms] = chosen
    sizes = np.array(sorted(best))
    cost, bic = (folded(np.array([getattr(best[n], key) for n in sizes])) for key in ("cost", "bic"))
    rest = [p for p in path if p is not best[p.n_terms]]
    axes.plot(sizes, cost, color=COLOURS["measured"], lw=1.2, dashes=(4, 3))
    dots(axes, sizes, cost, "measured", 6.0)
    axes.plot(sizes, bic, color=COLOURS["fit"], lw=1.5)
    dots(axes, sizes, bic, "fit", 7.0)
    dots(axes, np.array([p.n_terms for p in rest]), folded(np.array([p.bic for p in rest])), "fit", 4.0, 0.55)
    dots(axes, np.array([chosen.n_terms]), np.zeros(1), "forecast", 12.0, above=True)
    frame_path(axes, sizes, np.concatenate([cost, bic]), 7)
    label(axes, "number of free terms", "difference from the chosen structure")
    said = ", ".join(f"{n}: {signed(best[n].bic)}" for n in sizes if n != chosen.n_terms)
    return inline(
        axes,
        "path",
        f"ΔBIC against the number of free terms; {chosen.n_terms} are chosen",
        f"BIC of the best structure of each size, from the chosen one: {said or 'no other size'}",
    )


def frame_path(axes: Axes, sizes: np.ndarray, values: np.ndarray, n_ticks: int) -> None:
    """Axes of a selection path: whole numbers of terms, and folded differences written in full."""
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.set_xlim(sizes[0] - 0.5, sizes[-1] + 0.5)
    low, high = float(values.min()), float(values.max())
    ticks = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    every = max(1, len(ticks) // n_ticks)
    axes.yaxis.set_major_locator(FixedLocator([k for k in ticks if k % every == 0]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: unfolded(round(v))))
    axes.set_ylim(low - 0.3, high + 0.3)


def folded(value: np.ndarray) -> np.ndarray:
    """±1 for ±10, ±2 for ±100, …; linear in between."""
    size = np.abs(value)
    return np.sign(value) * np.where(
        size <= _LINEAR, size / _LINEAR, 1.0 + np.log10(np.maximum(size, _LINEAR) / _LINEAR)
    )


def unfolded(level: int) -> str:
    if abs(level) <= 3:
        return f"{'−' if level < 0 else ''}{10 ** abs(level) if level else 0}"
    return (
        f"{'−' if level < 0 else ''}10{str(abs(level)).translate(str.maketrans('0123456789', '⁰¹²³⁴⁵⁶⁷⁸⁹'))}"
    )


def energy_of_trial(energy: Energy, balance: bool) -> Markup:
    """Kinetic and potential energy and their sum, counted from the lowest potential energy."""
    axes = panel((HALF[0], 270.0))
    floor = float(energy.potential.min())
    total = energy.total - floor
    if balance:
        # A band below the line of the total: where the balance holds, the line lies in it.
        axes.plot(*thin_line(energy.t, energy.expected - floor), color=COLOURS["measured"], lw=5.0)
    for values, colour, width in (
        (energy.kinetic, "forecast", 1.2),
        (energy.potential - floor, "fit", 1.2),
        (total, "ink", 1.6),
    ):
        axes.plot(*thin_line(energy.t, values), color=COLOURS[colour], lw=width)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    label(axes, "t (s)", "energy (units of L)")
    said = f"The total goes from {plain(float(total[0]))} to {plain(float(total[-1]))}, in units of L"
    return inline(axes, "energy", "Kinetic, potential and total energy along the fitted curve", said)


def energy_of_trials(energies: Sequence[Energy], shown: int) -> Markup:
    """Total energy of every trial; the one of the other panel in full colour."""
    axes = panel((HALF[0], 270.0))
    floor = min(float(e.potential.min()) for e in energies)
    for k, energy in enumerate(energies[:_MOST_TRIALS]):
        t, total = thin_line(energy.t - energy.t[0], energy.total - floor, _OTHER_POINTS)
        bold = k == shown
        axes.plot(t, total, color=COLOURS["ink" if bold else "measured"], lw=1.8 if bold else 1.1)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    label(axes, "time from the start of the trial (s)", "total energy (units of L)")
    starts = [float(e.total[0]) - floor for e in energies]
    said = f"{len(energies)} trials, which begin between {plain(min(starts))} and {plain(max(starts))}"
    return inline(axes, "energies", "Total energy along the fitted curves of all trials", said)


def forecast_panel(trace: ForecastTrace, i: int, noise_std: float, name: str, unit: str, key: str) -> Markup:
    """Measured samples and the free run of one coordinate."""
    axes = panel()
    t_seen, some, quiet = legible_samples(trace.t, trace.measured[:, i], noise_std)
    dots(axes, t_seen, some, "measured", 4.5 if quiet else 3.2, above=quiet)
    run = trace.forecast[:, i]
    there = np.isfinite(run)
    seen = trace.measured[np.isfinite(trace.measured[:, i]), i]
    if seen.size:
        # A run that leaves the data must not flatten them.
        low, high = seen.min(), seen.max()
        reach = 1.0 * max(high - low, 1e-12)
        there &= (run > low - 20 * reach) & (run < high + 20 * reach)
        ends = np.concatenate([seen, np.clip(run[there], low - reach, high + reach)])
        pad = 0.06 * max(float(np.ptp(ends)), 1e-12)
        axes.set_ylim(ends.min() - pad, ends.max() + pad)
    axes.plot(*thin_line(trace.t[there], run[there]), color=COLOURS["forecast"])
    axes.set_xlim(trace.t[0], trace.t[-1])
    label(axes, "t (s)", name, y_unit=unit)
    far = "no error known" if np.isnan(trace.rms[i]) else f"rms error {plain(float(trace.rms[i]))} {unit}"
    title = f"{name} of trial {trace.trial} from {trace.origin:.4g} s: forecast and samples"
    return inline(axes, key, title, f"Measured samples as dots, the free run as a line; {far}")
