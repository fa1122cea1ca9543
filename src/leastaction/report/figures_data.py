"""Figures of the data: overview, samples and curve, residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from leastaction.model.mathml import Notation
from leastaction.report.axes import HALF, Axes, thin_line
from leastaction.report.series import Series
from leastaction.report.text import plain

__all__ = ["DataFigures"]

_POINTS, _ZOOM_POINTS = 3200, 960  # of all panels of one kind, which bounds the size of the page


@dataclass(frozen=True, eq=False)
class DataFigures:
    """Draws figures of the data; `units` holds "rad" or "units" for each coordinate."""

    series: Series
    notation: Notation
    units: tuple[str, ...]

    def overview(self, i: int) -> Markup:
        """The whole trial: samples and curve; the stretch of the zoom is shaded."""
        name, trial = self._name(i), self.series.shown
        axes = Axes(HALF)
        start, stop = self.series.zoom
        axes.band(x=(start, stop))
        axes.samples(trial.t, trial.q[:, i], 4.4)
        t = _sample_times(trial.t[0], trial.t[-1], 4 * trial.n_times)
        axes.line(*thin_line(t, self.series.curve(t)[:, i], self._share(_POINTS)), "fit", 1.1)
        axes.label("t (s)", name, y_unit=self._unit(i))
        title = f"{name} over the whole trial {trial.name}"
        if i in self.series.measured:
            said = f"{trial.n_samples} samples, the fitted curve as a line. {self._range(trial.q[:, i], i)}"
            return axes.svg(f"overview{i}", title, said)
        return axes.svg(f"overview{i}", title, "The estimated curve as a line") + self._band(i)

    def _band(self, i: int) -> Markup:
        """The 95 % band about the estimate, in a separate panel, because it is thin."""
        name, motion = self._name(i), self.series.estimate(i)
        reach = motion.reach
        axes = Axes((HALF[0], 130.0))
        axes.strip(motion.t, -reach, reach, "fit")
        axes.rule(0.0, "fit", 1.2)
        most = 1.1 * float(np.max(reach)) or 1.0
        axes.limit(x=(motion.t[0], motion.t[-1]), y=(-most, most))
        axes.label("t (s)", "95 % band about the estimate", y_unit=self._unit(i))
        return axes.svg(f"band{i}", f"95 % band of {name}", f"At most ± {plain(most / 1.1)} {self._unit(i)}")

    def zoom(self, i: int, derivative: int) -> Markup:
        """A stretch of the curve, or of its derivative, with the samples of the coordinate."""
        name, trial = self._name(i, derivative), self.series.shown
        start, stop = self.series.zoom
        axes = Axes(HALF)
        t = _sample_times(start, stop, self._share(_ZOOM_POINTS))
        if derivative == 0:
            inside = (trial.t >= start) & (trial.t <= stop)
            axes.samples(trial.t[inside], trial.q[inside, i], 4.4)
        curve = self.series.curve(t, derivative)[:, i]
        axes.line(t, curve, "fit", 1.3)
        axes.label("t (s)", name, y_unit=self._unit(i, derivative))
        what = "Samples and the fitted curve" if derivative == 0 else "The fitted curve"
        said = f"{what}. {self._range(curve, i, derivative)}"
        return axes.svg(f"zoom{i}{derivative}", f"{name} from {start:.3g} to {stop:.3g} s", said)

    def residuals(self, i: int) -> Markup:
        """Residuals of the shown trial over time, with the band that should hold 95 % of them."""
        name, trial = self._name(i), self.series.shown
        sigma = float(self.series.model.noise_std[i])
        axes = Axes()
        axes.samples(trial.t, self.series.residuals[self.series.trial][:, i], 2.2)
        for end in (-1.96 * sigma, 1.96 * sigma):
            axes.rule(end, "fit", 1.0, dashes="4 3")
        axes.limit(x=(trial.t[0], trial.t[-1]))
        axes.label("t (s)", f"{name}, measured − fitted", y_unit=self._unit(i))
        said = f"95 % of normal noise lies between the dashed lines; σ is {plain(sigma)} {self._unit(i)}"
        return axes.svg(f"residual{i}", f"Residuals of {name} over time", said)

    def histogram(self, i: int) -> Markup:
        """Residuals of all trials in units of σ against the normal density."""
        sigma = max(float(self.series.model.noise_std[i]), 1e-300)
        z = self.series.all_residuals(i) / sigma
        axes = Axes()
        edges = np.linspace(-4.5, 4.5, 46)
        counts, _ = np.histogram(z, edges)
        density = counts / max(z.size, 1) / np.diff(edges)
        axes.bars(density, edges, "measured", 0.45)
        x = np.linspace(-4.5, 4.5, 61)
        axes.line(x, np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi), "fit")
        axes.limit(y=(0.0, None))
        axes.label("residual / σ", f"density, {self._name(i)}")
        said = f"With the normal density; {100 * float(np.mean(np.abs(z) > 3)):.2f} % lie beyond 3 σ"
        return axes.svg(f"histogram{i}", f"Histogram of the residuals of {self._name(i)} over σ", said)

    def correlation(self, i: int) -> Markup:
        """Autocorrelation of the residuals, with the band of white noise."""
        values = self.series.correlation(i)
        bound = 1.96 / np.sqrt(max(self.series.all_residuals(i).size, 1))
        axes = Axes()
        axes.band(y=(-bound, bound))
        axes.rule(0.0, "muted", 0.8)
        lags = np.arange(1, values.size + 1)
        ends = np.column_stack([np.zeros(values.size), np.nan_to_num(values), np.full(values.size, np.nan)])
        axes.line(np.repeat(lags, 3), ends.ravel(), "measured", 3.0, cap="butt")
        reach = max(0.25, 1.1 * float(np.max(np.abs(np.nan_to_num(values)), initial=0.0)))
        axes.limit(x=(0.0, max(values.size, 1) + 1.0), y=(-reach, reach))
        axes.label("lag (samples)", f"autocorrelation, {self._name(i)}")
        said = f"Lags of 1 to {values.size} samples; white noise stays within {bound:.2g} of zero"
        return axes.svg(f"correlation{i}", f"Autocorrelation of the residuals of {self._name(i)}", said)

    def _share(self, points: int) -> int:
        """Points of one panel; fewer if there are many coordinates."""
        return points // min(max(len(self.units), 4), 6)

    def _range(self, values: np.ndarray, i: int, derivative: int = 0) -> str:
        there = values[np.isfinite(values)]
        if not there.size:
            return "Nothing measured"
        return f"From {plain(float(there.min()))} to {plain(float(there.max()))} {self._unit(i, derivative)}"

    def _name(self, i: int, derivative: int = 0) -> str:
        return self.notation.text(self.series.model.coordinates[i], derivative)

    def _unit(self, i: int, derivative: int = 0) -> str:
        return self.units[i] + ("", "/s", "/s²")[derivative]


def _sample_times(start: float, stop: float, n_times: int) -> np.ndarray:
    """Equal steps, at most 20 000."""
    return np.linspace(start, stop, int(min(max(n_times, 2), 20_000)))
