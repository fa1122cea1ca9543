"""The paper's method: gradient descent on spline and coefficients together, thresholding in the loop.

With q = N P, q̇ = Ṅ P and q̈ = N̈ P (Zhang & Sun 2026) the loss is

    J = α/N_m Σ ‖y − q‖² + γ/N_c Σ ‖Σ_k λ_k E[φ_k] − f‖² + β/N_c Σ ‖q̈‖²,

with the data at N_m samples, and the Euler–Lagrange residual and the curvature at N_c random collocation
times. Every iteration uses a batch of these.  Adam (Kingma & Ba 2015) updates P and λ:

    m ← b₁ m + (1 − b₁) g,   v ← b₂ v + (1 − b₂) g²,   x ← x − η m̂ / (√v̂ + 10⁻⁸),

where m̂ and v̂ are corrected for their start at zero, and η falls along a cosine to a hundredth of its first
value.  At regular intervals, coefficients with |λ_k| < ε are set to zero permanently.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from leastaction.curve.bspline import SplineGrid
from leastaction.errors import DataError, InputError
from leastaction.estimation.joint import Physics
from leastaction.mechanics.euler_lagrange import Points

__all__ = ["AdamFit", "AdamOptions", "AdamProblem", "descend"]


@dataclass(frozen=True)
class AdamOptions:
    """Settings of ``discover(method="adam")``, the method of Zhang & Sun (2026) as published.

    Parameters
    ----------
    data_weight, curvature_weight, physics_weight : float
        α, β and γ in J = α mean ‖y − q‖² + β mean ‖q̈‖² + γ mean ‖Σ λ_k E[φ_k] − f‖².
    threshold : float
        ε: smaller coefficients are set to zero permanently. In the units of the coefficients.
    threshold_from, check_every : int
        First iteration with thresholding, and the interval at which thresholds and convergence are checked.
    iterations : int
        Largest number of iterations; the learning rates fall along a cosine over this length.
    learning_rate_curve, learning_rate_coefficients : float
        First step of Adam in control points and in coefficients.
    tolerance : float
        The descent has converged if the relative change of J between two checks is smaller.
    collocation : float
        Random collocation times for each sample, N_c / N_m.
    batch : int
        Collocation times used in an iteration.
    knots_per_second : float or None
        None: from the time scale of the data, as in the first grid of the default method.
    start_curve : {"smooth", "samples"}
        Control points at the start: those of a penalised smoothing spline, or the samples (linearly
        interpolated at the knot averages).
    start_coefficients : {"regression", "ones"} or mapping of str to float
        Least squares along the starting curve; one for every candidate; or given values, and 0.001 for every
        other candidate.
    pin_ends : bool
        Tie both ends of every curve to the first and the last sample, as the paper does.

    Raises
    ------
    InputError
        If a value is invalid.

    Examples
    --------
    >>> from leastaction import AdamOptions
    >>> AdamOptions(threshold=0.01).iterations
    30000
    """

    data_weight: float = 1.0
    curvature_weight: float = 1e-7
    physics_weight: float = 0.1
    threshold: float = 0.03
    threshold_from: int = 15_000
    check_every: int = 1000
    iterations: int = 30_000
    learning_rate_curve: float = 3e-5
    learning_rate_coefficients: float = 3e-3
    tolerance: float = 1e-5
    collocation: float = 5.0
    batch: int = 1024
    knots_per_second: float | None = None
    start_curve: Literal["smooth", "samples"] = "smooth"
    start_coefficients: Literal["regression", "ones"] | Mapping[str, float] = "regression"
    pin_ends: bool = False

    def __post_init__(self) -> None:
        for name in ("data_weight", "curvature_weight", "physics_weight", "threshold", "tolerance"):
            self._check(name, 0.0, False)
        for name in ("learning_rate_curve", "learning_rate_coefficients", "collocation"):
            self._check(name, 0.0, True)
        for name in ("threshold_from", "check_every", "iterations", "batch"):
            self._check(name, 0.0, name != "threshold_from")
            if int(getattr(self, name)) != getattr(self, name):
                raise InputError(f"option {name} is {getattr(self, name)!r}; expected a whole number")
            object.__setattr__(self, name, int(getattr(self, name)))
        if self.knots_per_second is not None:
            self._check("knots_per_second", 0.0, True)
        for name, choices in (
            ("start_curve", ("smooth", "samples")),
            ("start_coefficients", ("regression", "ones")),
            ("pin_ends", (True, False)),
        ):
            if name == "start_coefficients" and isinstance(self.start_coefficients, Mapping):
                continue
            if getattr(self, name) not in choices:
                raise InputError(
                    f"option {name} is {getattr(self, name)!r}; choose one of {', '.join(map(repr, choices))}"
                )

    def _check(self, name: str, least: float, strict: bool) -> None:
        value = getattr(self, name)
        number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        if not number or value < least or (strict and value == least):
            bound = "above" if strict else "of at least"
            raise InputError(f"option {name} is {value!r}; expected a finite number {bound} {least:g}")

    @classmethod
    def of(cls, options: AdamOptions | Mapping[str, object] | None) -> AdamOptions:
        """Return options with the values of a mapping, and defaults for all others."""
        if options is None or isinstance(options, AdamOptions):
            return options or cls()
        known = [field.name for field in fields(cls)]
        for name in options:
            if name not in known:
                raise InputError(f"option {name!r} is unknown; method 'adam' has {', '.join(known)}")
        return cls(**options)  # type: ignore[arg-type]


# ------------------------------------------------------------------------------------------ gradient descent
_MOMENTS = (0.9, 0.999)  # Kingma and Ba's
_LAST_RATE = 0.01  # learning rate at the end of the cosine, relative to the first
_CHUNK = 16384  # collocation times handled at once


@dataclass(frozen=True, eq=False)
class AdamFit:
    """Result of the descent.

    Attributes
    ----------
    control_points : (n_ctrl, n_dof) array
    coefficients : (n_columns,) array
        Known ones included; zero where thresholded.
    loss : float
        J over all collocation times.
    iterations : int
    converged : bool
        Whether the descent converged before the last iteration.
    """

    control_points: np.ndarray
    coefficients: np.ndarray
    loss: float
    iterations: int
    converged: bool


Force = Callable[[int, np.ndarray], np.ndarray]


class AdamProblem:
    """The loss J and its gradients.

    Parameters
    ----------
    grid : SplineGrid
    times, values : lists of arrays, one per trajectory
        Samples; NaN are left out.
    physics : Physics
        Columns, and which of their coefficients are free; its forces are not used.
    force : callable or None
        ``force(trajectory number, times) -> (n_times, n_dof)``.
    options : AdamOptions
    rng : numpy.random.Generator
        Draws the collocation times.
    """

    def __init__(
        self,
        grid: SplineGrid,
        times: Sequence[np.ndarray],
        values: Sequence[np.ndarray],
        physics: Physics,
        force: Force | None,
        options: AdamOptions,
        rng: np.random.Generator,
    ) -> None:
        self.grid: SplineGrid = grid
        self.physics: Physics = physics
        self.options: AdamOptions = options
        self.n_dof: int = values[0].shape[1]
        stacked = np.concatenate(values)
        self.observed: np.ndarray = np.isfinite(stacked)
        self.y: np.ndarray = np.where(self.observed, stacked, 0.0)
        self.design = grid.design(times)
        self.transposed = self.design.T.tocsr()
        self.ends: np.ndarray = np.concatenate([grid.offsets[:-1], grid.offsets[1:] - 1])
        self._collocate(times, force, rng)

    def _collocate(self, times: Sequence[np.ndarray], force: Force | None, rng: np.random.Generator) -> None:
        """Draw collocation times, uniform in each trajectory, and evaluate the basis there."""
        firsts: list[np.ndarray] = []
        bases: list[np.ndarray] = []
        forces: list[np.ndarray] = []
        drawn: list[np.ndarray] = []
        for k, (space, t) in enumerate(zip(self.grid.spaces, times, strict=True)):
            count = int(np.ceil(self.options.collocation * t.size))
            at = rng.uniform(t[0], t[-1], count)
            firsts.append(space.local_basis(at)[0] + self.grid.offsets[k])
            bases.append(np.stack([space.local_basis(at, nu)[1] for nu in range(3)]))
            drawn.append(at)
            if force is not None:
                forces.append(force(k, at))
        local = np.arange(self.grid.degree + 1)
        self.index: np.ndarray = np.concatenate(firsts)[:, None] + local
        self.basis: np.ndarray = np.concatenate(bases, axis=1)
        self.times: np.ndarray = np.concatenate(drawn)
        self.forces: np.ndarray | None = np.concatenate(forces) if forces else None
        self.n_collocation: int = len(self.index)

    def data_part(self, control_points: np.ndarray) -> tuple[float, np.ndarray]:
        """α/N_m Σ ‖y − N P‖² and its gradient in P."""
        scale = self.options.data_weight / self.observed.any(axis=1).sum()
        residual = np.where(self.observed, self.design @ control_points - self.y, 0.0)
        return scale * float((residual**2).sum()), 2.0 * scale * (self.transposed @ residual)

    def equation_part(
        self, control_points: np.ndarray, coefficients: np.ndarray, batch: np.ndarray | slice
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Physics and curvature parts over some collocation times, with gradients in P and λ."""
        index, basis = self.index[batch], self.basis[:, batch]
        local = control_points[index]
        states = [np.einsum("pb,pbi->pi", b, local) for b in basis]
        points = Points(*states, times=self.times[batch])
        active = np.flatnonzero(coefficients)
        columns = self.physics.columns.subset(active.tolist())
        strong = columns.strong(points)
        residual = np.tensordot(coefficients[active], strong, 1)
        if self.forces is not None:
            residual -= self.forces[batch].T
        count, acceleration = len(index), states[2]
        weight, curvature = self.options.physics_weight / count, self.options.curvature_weight / count
        loss = weight * float((residual**2).sum()) + curvature * float((acceleration**2).sum())

        slope = np.zeros((3, count, self.n_dof))
        for (nu, i, j), value in columns.jacobian(points, coefficients[active]).items():
            slope[nu, :, j] += weight * residual[i] * value
        slope[2] += curvature * acceleration
        by_coefficient = np.zeros_like(coefficients)
        by_coefficient[active] = 2.0 * weight * np.einsum("kip,ip->k", strong, residual)
        return loss, 2.0 * self._scatter(index, basis, slope), by_coefficient

    def _scatter(self, index: np.ndarray, basis: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Gradient in P from that in q, q̇ and q̈."""
        local = np.einsum("npb,npi->pbi", basis, slope)
        flat = index.ravel()
        columns = [
            np.bincount(flat, weights=local[:, :, i].ravel(), minlength=self.grid.n_ctrl)
            for i in range(self.n_dof)
        ]
        return np.stack(columns, axis=1)

    def loss(self, control_points: np.ndarray, coefficients: np.ndarray) -> float:
        """J over all samples and collocation times."""
        total = 0.0
        for start in range(0, self.n_collocation, _CHUNK):
            part = slice(start, min(start + _CHUNK, self.n_collocation))
            share = (part.stop - part.start) / self.n_collocation
            total += share * self.equation_part(control_points, coefficients, part)[0]
        return total + self.data_part(control_points)[0]

    def regress(self, control_points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """The free coefficients that minimise J for a given curve, by linear least squares."""
        free = self.physics.free
        gram, moment = 0.0, 0.0
        for start in range(0, self.n_collocation, _CHUNK):
            part = slice(start, start + _CHUNK)
            local = control_points[self.index[part]]
            states = [np.einsum("pb,pbi->pi", b, local) for b in self.basis[:, part]]
            strong = self.physics.columns.strong(Points(*states, times=self.times[part])).reshape(
                free.size, -1
            )
            target = -coefficients[~free] @ strong[~free]
            if self.forces is not None:
                target += self.forces[part].T.ravel()
            gram = gram + strong[free] @ strong[free].T
            moment = moment + strong[free] @ target
        out = coefficients.copy()
        out[free] = np.linalg.lstsq(gram, moment, rcond=None)[0]
        return out


def descend(
    problem: AdamProblem,
    control_points: np.ndarray,
    coefficients: np.ndarray,
    rng: np.random.Generator,
    report: Callable[[dict[str, Any]], None],
) -> AdamFit:
    """Run Adam from a start; ``report`` is called with the state at every check."""
    options, free = problem.options, problem.physics.free.copy()
    points, values = control_points.copy(), coefficients.copy()
    moments = [np.zeros_like(a) for a in (points, points, values, values)]
    before, converged, loss, step = np.inf, False, np.nan, 0
    batch_size = min(options.batch, problem.n_collocation)
    for step in range(1, options.iterations + 1):
        batch = rng.integers(0, problem.n_collocation, batch_size)
        _, by_point = problem.data_part(points)
        _, more, by_value = problem.equation_part(points, values, batch)
        by_point += more
        if options.pin_ends:
            by_point[problem.ends] = 0.0
        by_value[~free] = 0.0
        fade = 0.5 * (1.0 + np.cos(np.pi * step / options.iterations))
        fade = _LAST_RATE + (1.0 - _LAST_RATE) * fade
        points -= options.learning_rate_curve * fade * _direction(moments[0], moments[1], by_point, step)
        move = options.learning_rate_coefficients * fade * _direction(moments[2], moments[3], by_value, step)
        values -= np.where(free, move, 0.0)
        if step % options.check_every and step < options.iterations:
            continue
        changed = False
        if step >= options.threshold_from:
            small = free & (np.abs(values) < options.threshold)
            changed = bool(small.any())
            values[small], free[small] = 0.0, False
        loss = float(problem.loss(points, values))
        report({"iteration": step, "loss": loss, "terms": int(free.sum()), "coefficients": values.copy()})
        if not free.any():
            raise DataError(
                f"every coefficient fell below the threshold {options.threshold:g} of method='adam': lower "
                "it, or use the default method, which needs none"
            )
        if not np.isfinite(loss):
            break
        converged = not changed and step > options.threshold_from and _settled(before, loss, options)
        before = loss
        if converged:
            break
    return AdamFit(points, values, loss, step, converged)


def _settled(before: float, loss: float, options: AdamOptions) -> bool:
    return abs(before - loss) < options.tolerance * abs(loss)


def _direction(first: np.ndarray, second: np.ndarray, gradient: np.ndarray, step: int) -> np.ndarray:
    """Adam's direction; updates both moments in place."""
    b1, b2 = _MOMENTS
    first += (1.0 - b1) * (gradient - first)
    second += (1.0 - b2) * (gradient**2 - second)
    return first / (1.0 - b1**step) / (np.sqrt(second / (1.0 - b2**step)) + 1e-8)
