"""Pendulums with springs, free of forces: on a cart held by a spring, and on a spring that swings in space.

A spring −½k(x − d)² is written by its terms x² and x; the constant carries no physics.
"""

from __future__ import annotations

import math

from leastaction.systems._draw import Uniform, Within
from leastaction.systems._system import MechanicalSystem

_REFERENCE = "Zhang & Sun, Differentiable Sparse Identification of Lagrangian Dynamics, arXiv 2511.10706"


def cart_spring_pendulum(
    M: float = 2.0,
    m: float = 1.0,
    l: float = 1.0,
    k: float = 10.0,
    d: float = 0.5,
    g: float = 9.81,
) -> MechanicalSystem:
    """Pendulum on a cart that a spring holds at x = d; cos θ is known.

    Start: x in (−0.5, 1.5), |θ| < 2, rates within ±1; |θ| stays below π.
    """
    return MechanicalSystem(
        name="cart_spring_pendulum",
        title="Cart spring pendulum",
        coordinates=("x", "theta"),
        angles=("theta",),
        parameters={"M": M, "m": m, "l": l, "k": k, "d": d, "g": g},
        lagrangian={
            "x_dot**2": 0.5 * (M + m),
            "x_dot*theta_dot*cos(theta)": m * l,
            "theta_dot**2": 0.5 * m * l**2,
            "cos(theta)": m * g * l,
            "x**2": -0.5 * k,
            "x": k * d,
        },
        known={"cos(theta)": m * g * l},
        library=(
            "x_dot**2",
            "theta_dot**2",
            "x_dot*theta_dot",
            "x_dot*theta_dot*cos(theta)",
            "x_dot*theta_dot*sin(theta)",
            "x_dot**2*cos(theta)",
            "theta_dot**2*cos(theta)",
            "theta_dot**2*x",
            "cos(theta)",
            "sin(theta)",
            "cos(theta)**2",
            "x",
            "x**2",
            "x**3",
            "x**4",
            "x*cos(theta)",
            "x*sin(theta)",
        ),
        initial=Uniform(q=((-0.5, 1.5), (-2.0, 2.0)), qdot=((-1.0, 1.0),) * 2),
        accept=Within((None, (-math.pi, math.pi))),
        reference=_REFERENCE,
    )


def spherical_spring_pendulum(
    m: float = 1.0, k: float = 40.0, d: float = 1.0, g: float = 9.81
) -> MechanicalSystem:
    """Mass on a spring that swings in space; x cos θ is known.

    x is the length of the spring, θ is measured from the downward vertical.

    Start: x in (0.9, 1.5), θ in (0.5, 1.5), φ in (−π, π), |ẋ|, |θ̇| < 1, |φ̇| in (1.5, 3) of either sign;
    θ stays in (0.2, π − 0.2) and x in (0.3, 4), away from the poles of the coordinates.
    """
    return MechanicalSystem(
        name="spherical_spring_pendulum",
        title="Spherical spring pendulum",
        coordinates=("x", "theta", "phi"),
        angles=("theta", "phi"),
        parameters={"m": m, "k": k, "d": d, "g": g},
        lagrangian={
            "x_dot**2": 0.5 * m,
            "x**2*theta_dot**2": 0.5 * m,
            "x**2*sin(theta)**2*phi_dot**2": 0.5 * m,
            "x*cos(theta)": m * g,
            "x**2": -0.5 * k,
            "x": k * d,
        },
        known={"x*cos(theta)": m * g},
        library=(
            "x_dot**2",
            "theta_dot**2",
            "phi_dot**2",
            "x_dot*theta_dot",
            "x_dot*phi_dot",
            "theta_dot*phi_dot",
            "x*theta_dot**2",
            "x**2*theta_dot**2",
            "x**2*phi_dot**2",
            "x**2*sin(theta)**2*phi_dot**2",
            "sin(theta)**2*phi_dot**2",
            "x",
            "x**2",
            "x**3",
            "cos(theta)",
            "x*cos(theta)",
            "x*sin(theta)",
            "x**2*cos(theta)",
            "x*sin(theta)*cos(phi)",
        ),
        initial=Uniform(
            q=((0.9, 1.5), (0.5, 1.5), (-math.pi, math.pi)),
            qdot=((-1.0, 1.0), (-1.0, 1.0), (1.5, 3.0)),
            mirrored=(2,),
        ),
        accept=Within(((0.3, 4.0), (0.2, math.pi - 0.2), None)),
        reference=_REFERENCE,
    )
