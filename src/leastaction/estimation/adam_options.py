"""Settings of the paper's method."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Literal

from leastaction.errors import InputError

__all__ = ["AdamOptions"]


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
        The most; the learning rates fall along a cosine over this length.
    learning_rate_curve, learning_rate_coefficients : float
        First step of Adam in control points and in coefficients.
    tolerance : float
        The descent has converged when the relative change of J between two checks is smaller.
    collocation : float
        Random collocation times for each sample, N_c / N_m.
    batch : int
        Collocation times used in an iteration.
    knots_per_second : float or None
        None: from the time scale of the data, as many as the default method begins with.
    start_curve : {"smooth", "samples"}
        Control points at the start: those of a penalised smoothing spline, or the samples (linearly
        interpolated at the knot averages).
    start_coefficients : {"regression", "ones"} or mapping of str to float
        Least squares along the starting curve; one for every candidate; or given values, a thousandth for
        every other candidate.
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
        """Complete a mapping of names to values."""
        if options is None or isinstance(options, AdamOptions):
            return options or cls()
        known = [field.name for field in fields(cls)]
        for name in options:
            if name not in known:
                raise InputError(f"option {name!r} is unknown; method 'adam' has {', '.join(known)}")
        return cls(**options)  # type: ignore[arg-type]
