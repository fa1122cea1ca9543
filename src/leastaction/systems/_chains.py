"""Further systems on a line: the double well, and masses in a row with quartic and exponential springs."""

from __future__ import annotations

from leastaction.systems._system import MechanicalSystem, TwoSines, Uniform

_LINKS = ("x1", "(x2-x1)", "(x3-x2)", "(x4-x3)", "x4")


def double_well(
    m: float = 1.0, a: float = 2.0, b: float = 1.0, viscous: float = 0.1, coulomb: float = 0.15
) -> MechanicalSystem:
    """Duffing's oscillator with two wells, driven, with viscous and Coulomb friction.

    L = ½mẋ² + ½ax² − ¼bx⁴; the Coulomb friction is smoothed below 0.01 m/s. Start: |x| < 2, rates within ±1.
    """
    return MechanicalSystem(
        name="double_well",
        title="Double well",
        coordinates=("x",),
        parameters={"m": m, "a": a, "b": b, "viscous": viscous, "coulomb": coulomb},
        lagrangian={"x_dot**2": 0.5 * m, "x**2": 0.5 * a, "x**4": -0.25 * b},
        dissipation={"x_dot**2/2": viscous, "sqrt(x_dot**2+1/10000)": coulomb},
        library=(
            "x_dot**2",
            "x_dot**4",
            "x_dot**2*x",
            "x_dot**2*x**2",
            "x",
            "x**2",
            "x**3",
            "x**4",
            "x**5",
            "x**6",
            "cos(x)",
        ),
        initial=Uniform(q=((-2.0, 2.0),), qdot=((-1.0, 1.0),)),
        forcing=TwoSines((2.0,)),
        reference="Guckenheimer & Holmes, Nonlinear Oscillations, section 2.2",
    )


def spring_chain(
    m1: float = 1.0,
    m2: float = 1.5,
    m3: float = 1.0,
    m4: float = 0.5,
    k: float = 10.0,
    beta: float = 20.0,
) -> MechanicalSystem:
    """Four masses between two walls, in a row of five springs with the energies ½ku² + ¼βu⁴; ẋ₁² is known.

    The x are displacements from rest. Start: displacements and rates within ±1.
    """
    return MechanicalSystem(
        name="spring_chain",
        title="Spring chain",
        coordinates=("x1", "x2", "x3", "x4"),
        parameters={"m1": m1, "m2": m2, "m3": m3, "m4": m4, "k": k, "beta": beta},
        lagrangian={
            **{f"x{i}_dot**2": 0.5 * m for i, m in enumerate((m1, m2, m3, m4), start=1)},
            **{f"{link}**2": -0.5 * k for link in _LINKS},
            **{f"{link}**4": -0.25 * beta for link in _LINKS},
        },
        known={"x1_dot**2": 0.5 * m1},
        library=(
            *(f"x{i}_dot**2" for i in range(1, 5)),
            *(f"x{i}_dot*x{i + 1}_dot" for i in range(1, 4)),
            *(f"{link}**{power}" for power in (2, 3, 4) for link in _LINKS),
            "x2**2",
            "x3**2",
        ),
        initial=Uniform(q=((-1.0, 1.0),) * 4, qdot=((-1.0, 1.0),) * 4),
        reference="Fermi, Pasta, Ulam & Tsingou, Studies of nonlinear problems, LA-1940 (1955)",
    )


def toda_chain(m: float = 1.0, a: float = 4.0) -> MechanicalSystem:
    """Three masses between two walls, in a row of four springs with the energy a·exp(−u); ẋ₁² is known.

    u is the stretch of a spring; the linear parts of their energies add up to a constant.
    Start: displacements within ±1, rates within ±2.
    """
    return MechanicalSystem(
        name="toda_chain",
        title="Toda chain",
        coordinates=("x1", "x2", "x3"),
        parameters={"m": m, "a": a},
        lagrangian={
            **{f"x{i}_dot**2": 0.5 * m for i in range(1, 4)},
            **dict.fromkeys(("exp(-x1)", "exp(x1-x2)", "exp(x2-x3)", "exp(x3)"), -a),
        },
        known={"x1_dot**2": 0.5 * m},
        library=(
            *(f"x{i}_dot**2" for i in range(1, 4)),
            "x1_dot*x2_dot",
            "x2_dot*x3_dot",
            *("exp(-x1)", "exp(x1-x2)", "exp(x2-x3)", "exp(x3)"),
            *("x1", "x2", "x3"),
            *("x1**2", "(x1-x2)**2", "(x2-x3)**2", "x3**2"),
            *("x1**4", "(x1-x2)**4", "(x2-x3)**4", "x3**4"),
        ),
        initial=Uniform(q=((-1.0, 1.0),) * 3, qdot=((-2.0, 2.0),) * 3),
        reference="Toda, Journal of the Physical Society of Japan 22 (1967) 431",
    )
