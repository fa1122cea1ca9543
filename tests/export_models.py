"""Models that the exports are tried with, and states to try them at."""

from __future__ import annotations

import shutil

import numpy as np

from leastaction import systems
from leastaction.model.model import LagrangianModel, ModelTerm

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def pendulum(name):
    system = systems.get(name)
    damping = [ModelTerm(f"{c}_dot**2*abs({c}_dot)", 0.1) for c in system.coordinates]
    return LagrangianModel(
        system.coordinates, [ModelTerm(k, c) for k, c in system.lagrangian.items()], damping
    )


def passive(name):
    system = systems.get(name)
    return LagrangianModel(system.coordinates, [ModelTerm(k, c) for k, c in system.lagrangian.items()])


def driven():
    """Double pendulum with Coulomb friction, smoothed as `discover` does, and viscous friction."""
    system = systems.get("double_pendulum")
    friction = [ModelTerm("sqrt(theta1_dot**2 + 9/10000)", 0.2), ModelTerm("theta2_dot**2/2", 0.05)]
    return LagrangianModel(
        system.coordinates, [ModelTerm(k, c) for k, c in system.lagrangian.items()], friction
    )


def odd():
    """Every function of the grammar, Greek names, and names that occur in generated code."""
    names = ["θ1", "math", "n"]
    terms = [
        ModelTerm("(θ1_dot**2 + math_dot**2 + n_dot**2)*exp(sin(θ1)/3)", 1 / 3),
        ModelTerm("θ1_dot*n_dot*tan(θ1/2)*sqrt(2)/10", 0.1),
        ModelTerm("log(2 + cos(math))*sqrt(1 + n**2)*exp(1)", -1.7),
        ModelTerm("(1 + n**2)**(-3/2)*abs(θ1)**2.5", 0.7),
        ModelTerm("abs(math)*pi*θ1**5/(1 + math**4)", 123456.789e-5),
    ]
    return LagrangianModel(names, terms, [ModelTerm("abs(n_dot) + sqrt(1 + n_dot**2)", 0.3)])


def rubbing():
    """Every family of friction that has a name, smoothed as `discover` does."""
    speed = "sqrt(a_dot**2 + 1/10000)"
    terms = [
        speed,
        f"-0.3*exp(-{speed}/0.3)",
        f"{speed}*abs(cos(a))",
        f"a_dot*{speed}/2",
        "a_dot",
        "a_dot**2/2",
    ]
    friction = [
        ModelTerm(text, size) for text, size in zip(terms, [0.4, 0.5, 0.2, -0.1, 0.05, 0.3], strict=True)
    ]
    return LagrangianModel(["a"], [ModelTerm("a_dot**2", 0.4), ModelTerm("cos(a)", 6.0)], friction)


MODELS = {
    "rubbing": rubbing,
    "odd": odd,
    "single": lambda: pendulum("single_pendulum"),
    "chaotic": lambda: pendulum("chaotic_pendulum"),
    "spherical": lambda: pendulum("spherical_spring_pendulum"),
    "magnetic": lambda: pendulum("magnetic_pendulum"),
    "passive": lambda: passive("cart_spring_pendulum"),
    "driven": lambda: driven(),
    # The diagonal is zero: elimination without pivoting would fail.
    "swapped": lambda: LagrangianModel(["x", "y"], [ModelTerm("x_dot*y_dot", 1.0), ModelTerm("x*y", 2.0)]),
    "free": lambda: LagrangianModel(["x"], [ModelTerm("x_dot**2", 1.5)]),
}


def states(model):
    return np.random.default_rng(4).uniform(0.2, 1.5, size=(5, 3, model.n_dof))


def timed():
    """A pendulum that is rocked, with a mass that leaks: the time is everywhere, the mass matrix included."""
    terms = [
        ModelTerm("theta_dot**2*exp(-t/4)", 0.5),
        ModelTerm("x_dot**2", 0.7),
        ModelTerm("theta_dot*x_dot*cos(theta - t)", 0.2),
        ModelTerm("cos(theta)*cos(3*t)", 4.0),
        ModelTerm("x**2*t**2", -0.1),
    ]
    return LagrangianModel(["theta", "x"], terms, [ModelTerm("x_dot**2*(2 + sin(t))", 0.1)])
