"""Figures of the data: overview, samples against the curve, residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from leastaction._report._mathml import Notation
from leastaction._report._series import Series, legible_samples, sample_times, thin_line, thin_points
from leastaction._report._svg import COLOURS, dots, inline, label, panel

__all__ = ["DataFigures"]

_WIDE = (1040, 150)


@dataclass(frozen=True, eq=False)
class DataFigures:
    """Draws what the data show; `units` holds "rad" or "units" for each coordinate."""

    series: Series
    notation: Notation
    units: tuple[str, ...]

    def overview(self, i: int) -> Markup:
        """The whole trial: samples and curve; the stretch of the zoom is shaded."""
        name, trial = self._name(i), self.series.shown
        axes = panel(*_WIDE)
        start, stop = self.series.zoom
        axes.axvspan(start, stop, color=COLOURS["shade"], lw=0, zorder=0)
        dots(axes, *thin_points(trial.t, trial.q[:, i]), "measured", 2.6)
        t = sample_times(trial.t[0], trial.t[-1], 4 * trial.n_times)
        axes.plot(*thin_line(t, self.series.curve(t)[:, i], 1600), color=COLOURS["fit"], lw=1.1)
        label(axes, "t (s)", name, y_unit=self._unit(i))
        alt = f"{name} over the whole trial: {trial.n_samples} samples as dots, the fitted curve as a line"
        return inline(axes, f"overview{i}", alt)

    def zoom(self, i: int, derivative: int) -> Markup:
        """A stretch of the curve, or of its derivative, with the samples of the coordinate."""
        name, trial = self._name(i, derivative), self.series.shown
        start, stop = self.series.zoom
        axes = panel()
        t = sample_times(start, stop, 400)
        if derivative == 0:
            inside = (trial.t >= start) & (trial.t <= stop)
            noise = float(self.series.model.noise_std[i])
            seen_t, seen, quiet = legible_samples(trial.t[inside], trial.q[inside, i], noise)
            dots(axes, seen_t, seen, "measured", 4.5 if quiet else 3.2, above=quiet)
        axes.plot(t, self.series.curve(t, derivative)[:, i], color=COLOURS["fit"])
        label(axes, "t (s)", name, y_unit=self._unit(i, derivative))
        what = "samples as dots and the fitted curve" if derivative == 0 else "the fitted curve"
        return inline(axes, f"zoom{i}{derivative}", f"{name} from {start:.3g} to {stop:.3g} s: {what}")

    def residuals(self, i: int) -> Markup:
        """Residuals of the shown trial over time, with the band that should hold 95 % of them."""
        name, trial = self._name(i), self.series.shown
        sigma = float(self.series.model.noise_std[i])
        axes = panel()
        dots(axes, *thin_points(trial.t, self.series.residuals[self.series.trial][:, i]), "measured", 2.2)
        for end in (-1.96 * sigma, 1.96 * sigma):
            axes.axhline(end, color=COLOURS["fit"], lw=1.0, dashes=(4, 3))
        axes.set_xlim(trial.t[0], trial.t[-1])
        label(axes, "t (s)", f"{name}, measured − fitted", y_unit=self._unit(i))
        return inline(axes, f"residual{i}", f"Residuals of {name} over time with the ±1.96 σ band")

    def histogram(self, i: int) -> Markup:
        """Residuals of all trials in units of σ against the normal density."""
        sigma = max(float(self.series.model.noise_std[i]), 1e-300)
        z = self.series.all_residuals(i) / sigma
        axes = panel()
        edges = np.linspace(-4.5, 4.5, 46)
        counts, _ = np.histogram(z, edges)
        density = counts / max(z.size, 1) / np.diff(edges)
        axes.stairs(density, edges, fill=True, color=COLOURS["measured"], alpha=0.45, lw=0)
        x = np.linspace(-4.5, 4.5, 120)
        axes.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi), color=COLOURS["fit"])
        axes.set_ylim(bottom=0)
        label(axes, "residual / σ", f"density, {self._name(i)}")
        alt = (
            f"Histogram of the residuals of {self._name(i)} in units of the noise, beside the normal density"
        )
        return inline(axes, f"histogram{i}", alt)

    def correlation(self, i: int) -> Markup:
        """Autocorrelation of the residuals, with the band of white noise."""
        values = self.series.correlation(i)
        bound = 1.96 / np.sqrt(max(self.series.all_residuals(i).size, 1))
        axes = panel()
        axes.axhspan(-bound, bound, color=COLOURS["shade"], lw=0, zorder=0)
        axes.axhline(0.0, color=COLOURS["muted"], lw=0.8)
        lags = np.arange(1, values.size + 1)
        ends = np.column_stack([np.zeros(values.size), np.nan_to_num(values), np.full(values.size, np.nan)])
        axes.plot(np.repeat(lags, 3), ends.ravel(), color=COLOURS["measured"], lw=3.0, solid_capstyle="butt")
        reach = max(0.25, 1.1 * float(np.max(np.abs(np.nan_to_num(values)), initial=0.0)))
        axes.set_ylim(-reach, reach)
        axes.set_xlim(0, max(values.size, 1) + 1)
        label(axes, "lag (samples)", f"autocorrelation, {self._name(i)}")
        return inline(axes, f"correlation{i}", f"Autocorrelation of the residuals of {self._name(i)}")

    def _name(self, i: int, derivative: int = 0) -> str:
        return self.notation.text(self.series.model.coordinates[i], derivative)

    def _unit(self, i: int, derivative: int = 0) -> str:
        return self.units[i] + ("", "/s", "/s²")[derivative]
