"""Further mechanisms: pendulums, arms, a pendulum on a cart, masses in a row, and the double well."""

from __future__ import annotations

import math

from leastaction.systems._system import MechanicalSystem, TwoSines, Uniform, Within

_REFERENCE = "Goldstein, Poole & Safko, Classical Mechanics, 3rd edition, chapters 1 and 8"
_NO_WHIRL = (-math.pi, math.pi)
_LINKS = ("x1", "(x2-x1)", "(x3-x2)", "(x4-x3)", "x4")  # springs of a row


def triple_pendulum(
    m1: float = 1.0,
    m2: float = 1.0,
    m3: float = 1.0,
    l1: float = 1.0,
    l2: float = 1.0,
    l3: float = 1.0,
    g: float = 9.81,
) -> MechanicalSystem:
    """Three point masses on massless rods, driven by three generalised torques.

    Start: |θ₁|, |θ₂|, |θ₃| < 1, rates within ±1; all angles stay below π.
    """
    return MechanicalSystem(
        name="triple_pendulum",
        title="Triple pendulum",
        coordinates=("theta1", "theta2", "theta3"),
        angles=("theta1", "theta2", "theta3"),
        parameters={"m1": m1, "m2": m2, "m3": m3, "l1": l1, "l2": l2, "l3": l3, "g": g},
        lagrangian={
            "theta1_dot**2": 0.5 * (m1 + m2 + m3) * l1**2,
            "theta2_dot**2": 0.5 * (m2 + m3) * l2**2,
            "theta3_dot**2": 0.5 * m3 * l3**2,
            "theta1_dot*theta2_dot*cos(theta1-theta2)": (m2 + m3) * l1 * l2,
            "theta1_dot*theta3_dot*cos(theta1-theta3)": m3 * l1 * l3,
            "theta2_dot*theta3_dot*cos(theta2-theta3)": m3 * l2 * l3,
            "cos(theta1)": (m1 + m2 + m3) * g * l1,
            "cos(theta2)": (m2 + m3) * g * l2,
            "cos(theta3)": m3 * g * l3,
        },
        library=(
            "theta1_dot**2",
            "theta2_dot**2",
            "theta3_dot**2",
            "theta1_dot*theta2_dot",
            "theta1_dot*theta3_dot",
            "theta2_dot*theta3_dot",
            "theta1_dot*theta2_dot*cos(theta1-theta2)",
            "theta1_dot*theta3_dot*cos(theta1-theta3)",
            "theta2_dot*theta3_dot*cos(theta2-theta3)",
            "theta1_dot**2*cos(theta1)",
            "theta3_dot**2*cos(theta3)",
            "cos(theta1)",
            "cos(theta2)",
            "cos(theta3)",
            "sin(theta1)",
            "sin(theta2)",
            "sin(theta3)",
            "cos(theta1)**2",
            "cos(theta1-theta2)",
            "cos(theta2-theta3)",
        ),
        initial=Uniform(q=((-1.0, 1.0),) * 3, qdot=((-1.0, 1.0),) * 3),
        accept=Within((_NO_WHIRL,) * 3),
        forcing=TwoSines((3.0, 3.0, 3.0)),
        reference=_REFERENCE,
    )


def robot_arm(
    m1: float = 2.0,
    m2: float = 1.0,
    l1: float = 0.6,
    l2: float = 0.5,
    inertia: float = 0.3,
    c: float = 0.1,
    g: float = 9.81,
) -> MechanicalSystem:
    """Arm on a turning column, driven in all joints and with viscous friction in them.

    There are masses at the elbow and at the tip. φ turns the column, whose moment of inertia is `inertia`;
    α and β are the angles of upper arm and forearm from the downward vertical (motors with belts: friction
    acts on φ̇, α̇ and β̇).

    Start: |φ| < 1, α, β in (−1.2, 1.2), rates within ±1; α and β stay below π.
    """
    return MechanicalSystem(
        name="robot_arm",
        title="Robot arm",
        coordinates=("phi", "alpha", "beta"),
        angles=("phi", "alpha", "beta"),
        parameters={"m1": m1, "m2": m2, "l1": l1, "l2": l2, "inertia": inertia, "c": c, "g": g},
        lagrangian={
            "phi_dot**2": 0.5 * inertia,
            "phi_dot**2*sin(alpha)**2": 0.5 * (m1 + m2) * l1**2,
            "phi_dot**2*sin(alpha)*sin(beta)": m2 * l1 * l2,
            "phi_dot**2*sin(beta)**2": 0.5 * m2 * l2**2,
            "alpha_dot**2": 0.5 * (m1 + m2) * l1**2,
            "beta_dot**2": 0.5 * m2 * l2**2,
            "alpha_dot*beta_dot*cos(alpha-beta)": m2 * l1 * l2,
            "cos(alpha)": (m1 + m2) * g * l1,
            "cos(beta)": m2 * g * l2,
        },
        dissipation={"phi_dot**2/2": c, "alpha_dot**2/2": c, "beta_dot**2/2": c},
        library=(
            "phi_dot**2",
            "phi_dot**2*sin(alpha)**2",
            "phi_dot**2*sin(alpha)*sin(beta)",
            "phi_dot**2*sin(beta)**2",
            "phi_dot**2*cos(alpha)",
            "phi_dot**2*cos(beta)",
            "phi_dot*alpha_dot",
            "phi_dot*beta_dot",
            "alpha_dot**2",
            "beta_dot**2",
            "alpha_dot*beta_dot",
            "alpha_dot*beta_dot*cos(alpha-beta)",
            "alpha_dot**2*cos(beta)",
            "beta_dot**2*cos(alpha)",
            "cos(alpha)",
            "cos(beta)",
            "sin(alpha)",
            "sin(beta)",
            "cos(alpha-beta)",
            "cos(phi)",
        ),
        initial=Uniform(q=((-1.0, 1.0), (-1.2, 1.2), (-1.2, 1.2)), qdot=((-1.0, 1.0),) * 3),
        accept=Within((None, _NO_WHIRL, _NO_WHIRL)),
        forcing=TwoSines((1.5, 3.0, 1.0)),
        reference="Siciliano et al., Robotics: Modelling, Planning and Control, chapter 7",
    )


def rotary_pendulum(
    inertia: float = 0.5,
    m: float = 0.5,
    r: float = 0.5,
    l: float = 0.6,
    viscous: float = 0.02,
    coulomb: float = 0.1,
    g: float = 9.81,
) -> MechanicalSystem:
    """Furuta's pendulum, hanging: an arm of radius r carries a pendulum that swings sideways.

    Only the arm φ is driven. It has Coulomb friction, smoothed below 0.01 rad/s; the pendulum θ, measured
    from the downward vertical, has viscous friction.

    Start: |φ| < 1, |θ| < 2, rates within ±1; θ stays below π.
    """
    return MechanicalSystem(
        name="rotary_pendulum",
        title="Rotary pendulum",
        coordinates=("phi", "theta"),
        angles=("phi", "theta"),
        parameters={
            "inertia": inertia,
            "m": m,
            "r": r,
            "l": l,
            "viscous": viscous,
            "coulomb": coulomb,
            "g": g,
        },
        lagrangian={
            "phi_dot**2": 0.5 * (inertia + m * r**2),
            "phi_dot**2*sin(theta)**2": 0.5 * m * l**2,
            "phi_dot*theta_dot*cos(theta)": m * r * l,
            "theta_dot**2": 0.5 * m * l**2,
            "cos(theta)": m * g * l,
        },
        dissipation={"theta_dot**2/2": viscous, "sqrt(phi_dot**2+1/10000)": coulomb},
        library=(
            "phi_dot**2",
            "theta_dot**2",
            "phi_dot*theta_dot",
            "phi_dot**2*sin(theta)**2",
            "phi_dot**2*cos(theta)",
            "phi_dot*theta_dot*cos(theta)",
            "phi_dot*theta_dot*sin(theta)",
            "theta_dot**2*cos(theta)",
            "theta_dot**2*sin(theta)**2",
            "cos(theta)",
            "sin(theta)",
            "cos(theta)**2",
            "cos(phi)",
            "sin(phi)",
            "phi**2",
        ),
        initial=Uniform(q=((-1.0, 1.0), (-2.0, 2.0)), qdot=((-1.0, 1.0),) * 2),
        accept=Within((None, _NO_WHIRL)),
        forcing=TwoSines((1.5, 0.0)),
        reference="Furuta, Yamakita & Kobayashi, Proc. Inst. Mech. Eng. I 206 (1992) 263",
    )


def elastic_pendulum_cart(
    M: float = 2.0,
    m: float = 1.0,
    k: float = 40.0,
    d: float = 1.0,
    K: float = 10.0,
    g: float = 9.81,
) -> MechanicalSystem:
    """Mass on a spring of length r that swings below a cart held by another spring; r cos θ is known.

    Start: x in (−0.5, 0.5), r in (0.9, 1.5), |θ| < 1.2, rates within ±1; r stays in (0.3, 4) and |θ| below π.
    """
    return MechanicalSystem(
        name="elastic_pendulum_cart",
        title="Elastic pendulum on a cart",
        coordinates=("x", "r", "theta"),
        angles=("theta",),
        parameters={"M": M, "m": m, "k": k, "d": d, "K": K, "g": g},
        lagrangian={
            "x_dot**2": 0.5 * (M + m),
            "r_dot**2": 0.5 * m,
            "r**2*theta_dot**2": 0.5 * m,
            "x_dot*r_dot*sin(theta)": m,
            "x_dot*theta_dot*r*cos(theta)": m,
            "r*cos(theta)": m * g,
            "r**2": -0.5 * k,
            "r": k * d,
            "x**2": -0.5 * K,
        },
        known={"r*cos(theta)": m * g},
        library=(
            "x_dot**2",
            "r_dot**2",
            "theta_dot**2",
            "r**2*theta_dot**2",
            "r*theta_dot**2",
            "x_dot*r_dot",
            "x_dot*r_dot*sin(theta)",
            "x_dot*r_dot*cos(theta)",
            "x_dot*theta_dot*cos(theta)",
            "x_dot*theta_dot*r*cos(theta)",
            "r_dot*theta_dot",
            "r",
            "r**2",
            "r**3",
            "r*cos(theta)",
            "cos(theta)",
            "x",
            "x**2",
            "x**4",
            "x*r",
        ),
        initial=Uniform(q=((-0.5, 0.5), (0.9, 1.5), (-1.2, 1.2)), qdot=((-1.0, 1.0),) * 3),
        accept=Within((None, (0.3, 4.0), _NO_WHIRL)),
        reference=_REFERENCE,
    )


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
