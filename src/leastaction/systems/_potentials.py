"""Further systems that move freely in a plane: Hénon–Heiles, Kepler, Morse."""

from __future__ import annotations

import math

from leastaction.systems._system import MechanicalSystem, Uniform, Within


def henon_heiles(m: float = 1.0, k: float = 1.0, c: float = 1.0) -> MechanicalSystem:
    """Hénon and Heiles' model of a star in a galaxy, free of forces; ẋ² is known.

    L = ½m(ẋ² + ẏ²) − ½k(x² + y²) − c(x²y − y³/3). A run of 20 s holds three periods of the small motion.
    Start: x, y in (−0.45, 0.45), rates within ±0.3; motions that leave the triangle of its bound states
    (y < 1, |x| < 0.9) are drawn again.
    """
    return MechanicalSystem(
        name="henon_heiles",
        title="Hénon–Heiles system",
        coordinates=("x", "y"),
        parameters={"m": m, "k": k, "c": c},
        lagrangian={
            "x_dot**2": 0.5 * m,
            "y_dot**2": 0.5 * m,
            "x**2": -0.5 * k,
            "y**2": -0.5 * k,
            "x**2*y": -c,
            "y**3": c / 3.0,
        },
        known={"x_dot**2": 0.5 * m},
        library=(
            "x_dot**2",
            "y_dot**2",
            "x_dot*y_dot",
            "x*y_dot",
            "x",
            "y",
            "x**2",
            "x*y",
            "y**2",
            "x**3",
            "x**2*y",
            "x*y**2",
            "y**3",
            "x**4",
            "x**2*y**2",
            "y**4",
        ),
        initial=Uniform(q=((-0.45, 0.45),) * 2, qdot=((-0.3, 0.3),) * 2),
        accept=Within(((-0.9, 0.9), (-0.6, 1.0))),
        reference="Hénon & Heiles, Astronomical Journal 69 (1964) 73",
    )


def kepler_orbit(m: float = 1.0, gravity: float = 4.0) -> MechanicalSystem:
    """Planet around a fixed sun in polar coordinates r, φ, free of forces; ṙ² is known.

    L = ½m(ṙ² + r²φ̇²) + m·gravity/r. Start: r in (0.8, 1.3), |ṙ| < 0.5, |φ̇| in (1.3, 2.2) of either sign;
    r stays in (0.25, 4).
    """
    return MechanicalSystem(
        name="kepler_orbit",
        title="Kepler orbit",
        coordinates=("r", "phi"),
        angles=("phi",),
        parameters={"m": m, "gravity": gravity},
        lagrangian={"r_dot**2": 0.5 * m, "r**2*phi_dot**2": 0.5 * m, "1/r": m * gravity},
        known={"r_dot**2": 0.5 * m},
        library=(
            "r_dot**2",
            "phi_dot**2",
            "r_dot*phi_dot",
            "r*phi_dot**2",
            "r**2*phi_dot**2",
            "r**2*r_dot**2",
            "1/r",
            "1/r**2",
            "log(r)",
            "r",
            "r**2",
            "cos(phi)",
            "sin(phi)",
            "r*cos(phi)",
        ),
        initial=Uniform(q=((0.8, 1.3), (-math.pi, math.pi)), qdot=((-0.5, 0.5), (1.3, 2.2)), mirrored=(1,)),
        accept=Within(((0.25, 4.0), None)),
        reference="Landau & Lifshitz, Mechanics, section 15",
    )


def morse_molecule(m: float = 1.0, depth: float = 4.0, r0: float = 1.5) -> MechanicalSystem:
    """Two atoms bound by Morse's potential that turn in a plane, free of forces; ṙ² is known.

    L = ½m(ṙ² + r²φ̇²) − depth·(exp(−2(r−r₀)) − 2 exp(−(r−r₀))), m the reduced mass. Start: r in (1.2, 2.2),
    |ṙ| < 2, |φ̇| in (0.3, 1) of either sign; r stays in (0.5, 8).
    """
    return MechanicalSystem(
        name="morse_molecule",
        title="Morse molecule",
        coordinates=("r", "phi"),
        angles=("phi",),
        parameters={"m": m, "depth": depth, "r0": r0},
        lagrangian={
            "r_dot**2": 0.5 * m,
            "r**2*phi_dot**2": 0.5 * m,
            "exp(-2*r)": -depth * math.exp(2.0 * r0),
            "exp(-r)": 2.0 * depth * math.exp(r0),
        },
        known={"r_dot**2": 0.5 * m},
        library=(
            "r_dot**2",
            "phi_dot**2",
            "r_dot*phi_dot",
            "r*phi_dot**2",
            "r**2*phi_dot**2",
            "exp(-r)",
            "exp(-2*r)",
            "exp(-3*r)",
            "1/r",
            "1/r**6",
            "r",
            "r**2",
            "cos(phi)",
        ),
        initial=Uniform(q=((1.2, 2.2), (-math.pi, math.pi)), qdot=((-2.0, 2.0), (0.3, 1.0)), mirrored=(1,)),
        accept=Within(((0.5, 8.0), None)),
        reference="Morse, Physical Review 34 (1929) 57",
    )
