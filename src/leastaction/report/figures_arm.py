"""Figures of an identified arm: torques, spectra, friction, and its links with their centres of mass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from markupsafe import Markup
from scipy.signal import welch

from leastaction.arms.base import TREE_SHARE, Posterior, assumed, tree_prior, with_prior
from leastaction.arms.compare import SHORTEST, TorqueErrors, TorqueRun, torque_errors
from leastaction.arms.model import ArmModel
from leastaction.mechanics.arm_terms import FRICTION
from leastaction.mechanics.rigid_bodies import Motion
from leastaction.report.axes import HALF, THIRD, Axes, thin_line
from leastaction.report.svg import Colour
from leastaction.report.text import plural
from leastaction.report.ticks import Log

__all__ = ["FROM_LOG", "ArmFigures", "density", "sides"]

_MOST_DRAWN = 8  # joints with figures
_POINTS = 4000  # of all lines of one kind, which bounds the size of the page
_DOTS = 500  # of a panel of friction
FROM_LOG = 0.5
"""Share from which on a parameter counts as known from the log."""
_BINS = 20  # of a decade of frequency
_WINDOW = 4.0  # s of one periodogram
_UNITS = {"revolute": ("N m", "rad"), "prismatic": ("N", "m")}


@dataclass(frozen=True, eq=False)
class ArmFigures:
    """Draws an arm and its torques.

    Attributes
    ----------
    model, solid : ArmModel
        The arm as identified, and with physically consistent links, which predict.
    fitted, held : tuple of TorqueRun
        Predictions of the fitted and the held-out log.
    """

    model: ArmModel
    solid: ArmModel
    fitted: tuple[TorqueRun, ...]
    held: tuple[TorqueRun, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return self.model.coordinates

    def unit(self, i: int) -> tuple[str, str]:
        """Of the torque and of the coordinate of a joint."""
        return _UNITS[self.model.tree.joints[i].kind]

    @cached_property
    def errors(self) -> tuple[TorqueErrors | None, TorqueErrors | None]:
        """Of the fitted and of the held-out log; None without a run that is long enough."""
        enough = ([r for r in runs if r.t[-1] - r.t[0] > SHORTEST] for runs in (self.fitted, self.held))
        first, second = (torque_errors(self.names, runs) if runs else None for runs in enough)
        return first, second

    @cached_property
    def shown(self) -> list[tuple[TorqueRun, Colour]]:
        """The longest runs in their colours: both parts of a log whose end was held out, else one run."""
        longest = [max(runs, key=lambda run: run.t.size) for runs in (self.fitted, self.held) if runs]
        colours: list[Colour] = ["fit", "forecast"]
        if len(longest) == 2 and longest[1].t[0] < longest[0].t[-1]:
            return [(longest[1], "forecast")]
        return list(zip(longest, colours, strict=False))

    @cached_property
    def drawn(self) -> list[int]:
        """The joints with figures: all with a measured torque, or those with the largest errors."""
        errors = self.errors[1] or self.errors[0]
        size = np.zeros(len(self.names)) if errors is None else errors.by_joint[0]
        known = [i for i, name in enumerate(self.names) if name not in self.model.facts.unmeasured]
        return sorted(sorted(known, key=lambda i: -float(size[i]))[:_MOST_DRAWN])

    @cached_property
    def posture(self) -> np.ndarray:
        """(n_dof,) middle of the range of each joint."""
        q = np.concatenate([run.q for run in self.fitted])
        return (q.min(axis=0) + q.max(axis=0)) / 2.0

    @cached_property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Means and standard deviations of all parameters without the log, see `tree_prior`."""
        tree, share = assumed(self.model.tree, TREE_SHARE)
        return tree_prior(tree, self.model.base, share)

    @cached_property
    def posterior(self) -> Posterior:
        """All parameters, from the log and the prior."""
        model = self.model
        return with_prior(model.base, model.coefficients, model.covariance, *self.prior)

    @property
    def from_log(self) -> np.ndarray:
        """(n_links, 10) share of each parameter that comes from the log."""
        return self.posterior.from_data[: 10 * len(self.names)].reshape(-1, 10)

    def torque(self, i: int) -> Markup:
        """Measured and predicted torque of a joint, and below them the difference."""
        axes, below = Axes((HALF[0], 190.0)), Axes((HALF[0], 124.0))
        most, name, unit = 0.0, self.names[i], self.unit(i)[0]
        n_points = _POINTS // len(self.drawn) // len(self.shown)
        for run, colour in self.shown:
            error = run.measured[:, i] - run.predicted[:, i]
            if colour == "forecast" and len(self.shown) > 1:
                for part in (axes, below):
                    part.band(x=(run.t[0], run.t[-1]))
            axes.samples(run.t, run.measured[:, i], 3.4)
            axes.line(*thin_line(run.t, run.predicted[:, i], n_points), colour, 1.1)
            below.samples(run.t, error, 1.6)
            most = max(most, 1.2 * float(np.quantile(np.abs(error), 0.998)))
        ends = float(self.shown[0][0].t[0]), float(self.shown[-1][0].t[-1])
        axes.limit(x=ends)
        below.limit(x=ends, y=(-most or -1.0, most or 1.0))
        below.rule(0.0, "ink", 0.8)
        axes.label("", name, y_unit=unit)
        below.label("t (s)", "measured − predicted", y_unit=unit)
        said = f"Samples of the torque in {unit}, and the prediction as a line"
        axes.align(below)
        above = axes.svg(f"torque{i}", f"Torque of {name}, measured and predicted", said)
        return above + below.svg(f"error{i}", f"{name}: measured minus predicted", f"Differences in {unit}")

    def densities(self, i: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, Colour]]:
        """Frequencies, and amplitude densities of torque and error, of each run that is shown."""
        out: list[tuple[np.ndarray, np.ndarray, np.ndarray, Colour]] = []
        for run, colour in self.shown:
            f, torque = density(run.t, run.measured[:, i])
            out.append((f, torque, density(run.t, run.measured[:, i] - run.predicted[:, i])[1], colour))
        return out

    def spectrum(self, i: int) -> Markup:
        """Amplitude densities of torque and error."""
        axes, name, unit = Axes(THIRD, x=Log(room=60.0), y=Log(room=36.0)), self.names[i], self.unit(i)[0]
        for k, (f, torque, error, colour) in enumerate(self.densities(i)):
            if k == 0:
                axes.line(f, torque, "measured", 1.8)
            axes.line(f, error, colour, 1.4)
        axes.label("frequency (Hz)", name, y_unit=f"{unit}/√Hz")
        said = f"Amplitude density in {unit}/√Hz over the frequency, both on logarithmic axes"
        return axes.svg(f"spectrum{i}", f"Spectra of the torque of {name} and of its error", said)

    @cached_property
    def _rubbing(self) -> np.ndarray:
        """(n_times, n_dof) friction of the model along the first run that is shown."""
        solid, run = self.solid, self.shown[0][0]
        kept = np.where([term.kind in FRICTION for term in solid.terms], solid.coefficients, 0.0)
        alone = ArmModel(solid.tree, solid.base, kept, solid.covariance, solid.reference, solid.facts)
        return alone.torques(run.q, run.qdot, run.qddot, successive=True)

    def friction(self, i: int) -> Markup:
        """What the rigid arm leaves of the torque against velocity, and the friction of the model."""
        axes, (unit, own), run = Axes(THIRD), self.unit(i), self.shown[0][0]
        left = (run.measured - run.predicted + self._rubbing)[:, i]
        some = slice(None, None, max(1, run.t.size // _DOTS))
        axes.dots(run.qdot[some, i], left[some], "measured", 2.6, opacity=0.7)
        speeds = np.zeros((241, len(self.names)))
        speeds[:, i] = np.linspace(run.qdot[:, i].min(), run.qdot[:, i].max(), len(speeds))
        curve = self.solid.friction(np.broadcast_to(self.posture, speeds.shape), speeds)[:, i]
        axes.line(speeds[:, i], curve, "fit", 1.8)
        axes.label(f"velocity ({own}/s)", self.names[i], y_unit=unit)
        said = f"Dots: measured torque minus that of the rigid arm, in {unit}. Line: friction of the model"
        return axes.svg(f"friction{i}", f"Friction of {self.names[i]} against velocity", said)

    def views(self) -> list[Markup]:
        """The arm and the centres of mass of its links from two sides, in one scale."""
        tree, rest = self.solid.tree, np.zeros((1, len(self.names)))
        motion = Motion.at(tree, self.posture[None], rest, rest)
        joints = np.array([origin[0] for origin in motion.origins])
        turned = zip(motion.rotations, tree.inertias, strict=True)
        centres = joints + np.array([turn[0] @ (row[1:4] / row[0]) for turn, row in turned])
        out: list[Markup] = []
        for k, (name, along, up) in enumerate(sides(tree.gravity)):
            axes = Axes((HALF[0], 420.0))
            across, down = joints @ along, joints @ up
            for i, joint in enumerate(tree.joints):
                start = joints[joint.parent] if joint.parent >= 0 else np.zeros(3)
                link, arm = np.array([start, joints[i]]), np.array([joints[i], centres[i]])
                axes.line(link @ along, link @ up, "measured", 5.0)
                axes.line(arm @ along, arm @ up, "muted", 1.0, dashes="3 3")
            axes.dots(across, down, "ink", 7.0)
            self._masses(axes, centres @ along, centres @ up)
            axes.same_scale()
            axes.label(f"{name} (m)", "height", y_unit="m")
            said = f"{plural(len(joints), 'link', 'links')}, numbered from the base, with centres of mass"
            out.append(axes.svg(f"view{k}", f"The arm in the middle of its motion, along {name}", said))
        return out

    def _masses(self, axes: Axes, across: np.ndarray, up: np.ndarray) -> None:
        """Dots whose area is the mass, with the number of the link."""
        masses, known = self.solid.tree.inertias[:, 0], self.from_log
        for i, size in enumerate(np.clip(24.0 * np.sqrt(masses / masses.max()), 7.0, None).tolist()):
            colour: Colour = "fit" if known[i, 1:4].mean() > FROM_LOG else "forecast"
            axes.dots(across[i : i + 1], up[i : i + 1], colour, size, above=True)
            side = 1.0 if i % 2 else -1.0  # neighbours may be close
            axes.words(float(across[i]), float(up[i]), str(i + 1), side * (size / 2.0 + 2.0))


def sides(gravity: np.ndarray) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Two horizontal directions with their names, and the one against gravity, in the frame of the base."""
    size = float(np.linalg.norm(gravity))
    up = -gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    flat = np.argsort(np.abs(up), kind="stable").tolist()[:2]
    out: list[tuple[str, np.ndarray, np.ndarray]] = []
    for k in sorted(flat):
        along = np.eye(3)[k] - up[k] * up
        out.append(("xyz"[k], along / np.linalg.norm(along), up))
    return out


def density(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz, and amplitude density, averaged over bins of equal ratio."""
    step = float(np.median(np.diff(t)))
    times = np.arange(t[0], t[-1], step)
    length = min(times.size, max(256, int(_WINDOW / step)))
    f, power = welch(np.interp(times, t, values), 1.0 / step, nperseg=length)
    bins = np.floor(_BINS * np.log10(f[1:])).astype(int)
    _, where, count = np.unique(bins, return_inverse=True, return_counts=True)
    middle, mean = (np.bincount(where, weights=column[1:]) / count for column in (f, power))
    return middle, np.sqrt(mean)
