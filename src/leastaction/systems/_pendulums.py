"""Pendulums: single, double, spherical (these three driven); chaotic compound and magnetic one (free).

And two on springs, free of forces: on a cart held by a spring, and on a spring that swings in space.  A
spring −½k(x − d)² is written by its terms x² and x; the constant carries no physics.
"""

from __future__ import annotations

import math

from leastaction.systems._system import MechanicalSystem, TwoSines, Uniform, Within

_REFERENCE = "Zhang & Sun, Differentiable Sparse Identification of Lagrangian Dynamics, arXiv 2511.10706"
_NO_WHIRL = (-math.pi, math.pi)


def single_pendulum(m: float = 1.0, l: float = 1.0, g: float = 9.81) -> MechanicalSystem:
    """Point mass on a massless rod, driven by a torque. Start: |θ| < 2, |θ̇| < 1.5; |θ| stays below π."""
    return MechanicalSystem(
        name="single_pendulum",
        title="Single pendulum",
        coordinates=("theta",),
        angles=("theta",),
        parameters={"m": m, "l": l, "g": g},
        lagrangian={"theta_dot**2": 0.5 * m * l**2, "cos(theta)": m * g * l},
        library=(
            "theta_dot**2",
            "theta_dot**3",
            "theta_dot**4",
            "theta_dot**2*sin(theta)",
            "theta_dot**2*cos(theta)",
            "theta_dot**2*cos(theta)**2",
            "theta_dot**2*theta**2",
            "cos(theta)",
            "sin(theta)",
            "cos(theta)**2",
            "sin(theta)*cos(theta)",
            "theta",
            "theta**2",
        ),
        initial=Uniform(q=((-2.0, 2.0),), qdot=((-1.5, 1.5),)),
        accept=Within((_NO_WHIRL,)),
        forcing=TwoSines((1.5,)),
        reference=_REFERENCE,
    )


_DOUBLE_LIBRARY = (
    "theta1_dot**2",
    "theta2_dot**2",
    "theta1_dot*theta2_dot",
    "theta1_dot*theta2_dot*cos(theta1-theta2)",
    "theta1_dot*theta2_dot*sin(theta1-theta2)",
    "theta1_dot*theta2_dot*cos(theta1+theta2)",
    "theta1_dot**2*cos(theta1-theta2)",
    "theta2_dot**2*cos(theta1-theta2)",
    "theta1_dot**2*cos(theta1)",
    "theta2_dot**2*cos(theta2)",
    "cos(theta1)",
    "cos(theta2)",
    "sin(theta1)",
    "sin(theta2)",
    "cos(theta1)**2",
    "cos(theta2)**2",
    "cos(theta1)*cos(theta2)",
    "cos(theta1-theta2)",
)


def double_pendulum(
    m1: float = 1.0, m2: float = 1.0, l1: float = 1.0, l2: float = 1.0, g: float = 9.81
) -> MechanicalSystem:
    """Two point masses on massless rods, driven by two generalised torques.

    Start: |θ₁|, |θ₂| < 1.5, rates within ±1; both angles stay below π.
    """
    return MechanicalSystem(
        name="double_pendulum",
        title="Double pendulum",
        coordinates=("theta1", "theta2"),
        angles=("theta1", "theta2"),
        parameters={"m1": m1, "m2": m2, "l1": l1, "l2": l2, "g": g},
        lagrangian={
            "theta1_dot**2": 0.5 * (m1 + m2) * l1**2,
            "theta2_dot**2": 0.5 * m2 * l2**2,
            "theta1_dot*theta2_dot*cos(theta1-theta2)": m2 * l1 * l2,
            "cos(theta1)": (m1 + m2) * g * l1,
            "cos(theta2)": m2 * g * l2,
        },
        library=_DOUBLE_LIBRARY,
        initial=Uniform(q=((-1.5, 1.5),) * 2, qdot=((-1.0, 1.0),) * 2),
        accept=Within((_NO_WHIRL,) * 2),
        forcing=TwoSines((1.5, 1.5)),
        reference=_REFERENCE,
    )


def chaotic_pendulum(
    m1: float = 1.0, m2: float = 1.0, l1: float = 1.0, l2: float = 1.0, g: float = 9.81
) -> MechanicalSystem:
    """Two compound bars, free of forces; cos θ₁ is known.

    Start: |θ₁|, |θ₂| < 2, rates within ±1; both angles stay below π.
    """
    return MechanicalSystem(
        name="chaotic_pendulum",
        title="Chaotic pendulum",
        coordinates=("theta1", "theta2"),
        angles=("theta1", "theta2"),
        parameters={"m1": m1, "m2": m2, "l1": l1, "l2": l2, "g": g},
        lagrangian={
            "theta1_dot**2": m1 * l1**2 / 24 + m2 * l1**2 / 8,
            "theta2_dot**2": m2 * l2**2 / 18,
            "theta1_dot*theta2_dot*cos(theta1-theta2)": m2 * l1 * l2 / 12,
            "cos(theta1)": 0.5 * m2 * g * l1,
            "cos(theta2)": m2 * g * l2 / 6,
        },
        known={"cos(theta1)": 0.5 * m2 * g * l1},
        library=_DOUBLE_LIBRARY,
        initial=Uniform(q=((-2.0, 2.0),) * 2, qdot=((-1.0, 1.0),) * 2),
        accept=Within((_NO_WHIRL,) * 2),
        reference=_REFERENCE,
    )


def spherical_pendulum(m: float = 1.0, l: float = 1.0, g: float = 9.81) -> MechanicalSystem:
    """Point mass on a massless rod that swings in space, driven in both angles; θ from the downward vertical.

    Start: θ in (0.6, 1.8), φ in (−π, π), |θ̇| < 1, |φ̇| in (1.5, 3) of either sign, which keeps the mass
    away from the poles of the coordinates; θ stays in (0.25, π − 0.25).
    """
    return MechanicalSystem(
        name="spherical_pendulum",
        title="Spherical pendulum",
        coordinates=("theta", "phi"),
        angles=("theta", "phi"),
        parameters={"m": m, "l": l, "g": g},
        lagrangian={
            "theta_dot**2": 0.5 * m * l**2,
            "phi_dot**2*sin(theta)**2": 0.5 * m * l**2,
            "cos(theta)": m * g * l,
        },
        library=(
            "theta_dot**2",
            "phi_dot**2",
            "theta_dot*phi_dot",
            "phi_dot**2*sin(theta)**2",
            "phi_dot**2*sin(theta)",
            "phi_dot**2*cos(theta)",
            "theta_dot**2*sin(theta)",
            "theta_dot**2*cos(theta)",
            "theta_dot**2*sin(theta)**2",
            "theta_dot*phi_dot*sin(theta)",
            "theta_dot*phi_dot*cos(theta)",
            "cos(theta)",
            "sin(theta)",
            "cos(theta)**2",
            "cos(phi)",
            "sin(phi)",
            "sin(theta)*cos(phi)",
            "sin(theta)*sin(phi)",
        ),
        initial=Uniform(q=((0.6, 1.8), (-math.pi, math.pi)), qdot=((-1.0, 1.0), (1.5, 3.0)), mirrored=(1,)),
        accept=Within(((0.25, math.pi - 0.25), None)),
        forcing=TwoSines((1.5, 1.5)),
        reference=_REFERENCE,
    )


# On the unit circle at 0 and ±120 degrees, as text so that the exact root goes into the term.
_OFFSETS = ("(x-1)**2+y**2", "(x+1/2)**2+(y-sqrt(3)/2)**2", "(x+1/2)**2+(y+sqrt(3)/2)**2")


def magnetic_pendulum(
    m: float = 1.0, C: float = 0.5, magnet: float = 1.0, d: float = 0.3
) -> MechanicalSystem:
    """Mass over three magnets, free of forces; ẋ² is known.

    L = ½m(ẋ² + ẏ²) + Σᵢ Cᵢ/√((xᵢ−x)² + (yᵢ−y)² + d²) − ½C(x² + y²).
    Start: x, y in (−1.5, 1.5), rates within ±1; x and y stay within ±4.
    """
    height = f"{d**2:.12g}"
    distances = [f"{offset}+{height}" for offset in _OFFSETS]
    magnets = [f"1/sqrt({distance})" for distance in distances]
    return MechanicalSystem(
        name="magnetic_pendulum",
        title="Magnetic pendulum",
        coordinates=("x", "y"),
        parameters={"m": m, "C": C, "magnet": magnet, "d": d},
        lagrangian={
            "x_dot**2": 0.5 * m,
            "y_dot**2": 0.5 * m,
            **dict.fromkeys(magnets, magnet),
            "x**2": -0.5 * C,
            "y**2": -0.5 * C,
        },
        known={"x_dot**2": 0.5 * m},
        library=(
            "x_dot**2",
            "y_dot**2",
            "x_dot*y_dot",
            "x*y_dot",
            *magnets,
            *(f"1/({distance})" for distance in distances),
            "x",
            "y",
            "x**2",
            "y**2",
            "x*y",
            "x**4",
            "y**4",
            "x**2*y**2",
        ),
        initial=Uniform(q=((-1.5, 1.5),) * 2, qdot=((-1.0, 1.0),) * 2),
        accept=Within(((-4.0, 4.0),) * 2),
        reference=_REFERENCE,
    )


# -------------------------------------------------------------------------------- pendulums with springs


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
