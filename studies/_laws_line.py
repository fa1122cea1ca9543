"""Laws of one coordinate for `laws.py`: wells, barriers, contacts, curved wires, gears, a crank."""

from __future__ import annotations

import math

from leastaction import systems
from studies._law import law

__all__ = ["LAWS"]

_G = 9.81
_HALF_TURN = (-math.pi, math.pi)


def _on_a_line() -> list[systems.MechanicalSystem]:
    """Forces that depend on one position; L = ½ẋ² − V(x) but where the mass depends on x or ẋ."""
    wide = (-4.0, 4.0)
    return [
        law(
            *("barrier_in_bowl", "Gaussian barrier in a parabola", ["x"]),
            {"x_dot**2": 0.5, "x**2": -1.0, "exp(-2*x**2)": -2.5},
            start=[(-1.5, 1.5)],
            rates=[(-1.0, 1.0)],
            push=[2.0],
            friction=0.1,
            within=[wide],
        ),
        law(
            *("exponential_mass", "Mass that falls with the way", ["x"]),
            {"x_dot**2*exp(-x)": 0.5, "x**2": -2.0},
            start=[(-0.8, 0.8)],
            rates=[(-1.0, 1.0)],
            push=[1.5],
            within=[wide],
        ),
        law(
            *("gaussian_well", "Gaussian well", ["x"]),
            {"x_dot**2": 0.5, "exp(-x**2/2)": 3.0},
            start=[(-1.6, 1.6)],
            rates=[(-0.8, 0.8)],
            within=[wide],
        ),
        law(
            *("hertz_contact", "Ball between two elastic walls", ["x"]),
            {"x_dot**2": 0.5, "abs(x)**2.5": -4.0},
            start=[(-1.0, 1.0)],
            rates=[(-1.5, 1.5)],
            push=[3.0],
            friction=0.15,
            within=[wide],
        ),
        law(
            *("isotonic_oscillator", "Spring with a centrifugal barrier", ["x"]),
            {"x_dot**2": 0.5, "x**2": -1.0, "1/x**2": -1.0},
            start=[(0.6, 1.8)],
            rates=[(-0.8, 0.8)],
            within=[(0.2, 4.0)],
        ),
        law(
            *("lennard_jones_line", "Lennard-Jones pair on a line", ["x"]),
            {"x_dot**2": 0.5, "1/x**12": -6.0, "1/x**6": 6.0},
            start=[(1.05, 1.4)],
            rates=[(-0.5, 0.5)],
            within=[(0.9, 3.0)],
        ),
        law(
            *("log_well", "Logarithmic well", ["x"]),
            {"x_dot**2": 0.5, "log(x**2+1/5)": -2.0},
            start=[(-1.6, 1.6)],
            rates=[(-1.0, 1.0)],
            within=[wide],
        ),
        law(
            *("modulus_spring", "Spring that stiffens with the modulus", ["x"]),
            {"x_dot**2": 0.5, "x**2": -1.0, "abs(x)**3": -1.5},
            start=[(-1.2, 1.2)],
            rates=[(-1.0, 1.0)],
            push=[2.0],
            friction=0.1,
            within=[wide],
        ),
        law(
            *("morse_line", "Morse pair on a line", ["x"]),
            {"x_dot**2": 0.5, "exp(-2.4*x)": -3.0, "exp(-1.2*x)": 6.0},
            start=[(-0.35, 1.0)],
            rates=[(-0.5, 0.5)],
            within=[(-1.0, 4.0)],
        ),
        law(
            *("poschl_teller", "Pöschl–Teller well", ["x"]),
            {"x_dot**2": 0.5, "1/(exp(x)+exp(-x))**2": 16.0},
            start=[(-0.9, 0.9)],
            rates=[(-1.0, 1.0)],
            push=[0.8],
            friction=0.2,
            within=[(-2.5, 2.5)],
        ),
        law(
            *("power_well", "Well with the power 3/2", ["x"]),
            {"x_dot**2": 0.5, "abs(x)**1.5": -3.0},
            start=[(-1.2, 1.2)],
            rates=[(-1.0, 1.0)],
            push=[1.0],
            within=[wide],
        ),
        law(
            *("rail_spring", "Mass on a rail, spring to a point beside it", ["x"]),
            {"x_dot**2": 0.5, "x**2": -4.0, "sqrt(x**2+1/4)": 8.0},
            start=[(-1.6, 1.6)],
            rates=[(-1.0, 1.0)],
            within=[wide],
        ),
        law(
            *("relativistic_oscillator", "Spring on a relativistic mass", ["x"]),
            {"sqrt(1-x_dot**2/4)": -4.0, "x**2": -1.5},
            start=[(-1.2, 1.2)],
            rates=[(-0.5, 0.5)],
            push=[0.8],
            within=[wide],
        ),
        law(
            *("soft_coulomb", "Charge before a ring", ["x"]),
            {"x_dot**2": 0.5, "1/sqrt(x**2+1/4)": 2.0},
            start=[(-1.5, 1.5)],
            rates=[(-0.8, 0.8)],
            within=[wide],
        ),
        law(
            *("toda_wall", "Exponential wall and a constant force", ["x"]),
            {"x_dot**2": 0.5, "exp(3*x/2)": -2.0, "x": 3.0},
            start=[(-1.0, 0.5)],
            rates=[(-0.8, 0.8)],
            friction=0.05,
            within=[wide],
        ),
    ]


def _guided() -> list[systems.MechanicalSystem]:
    """Beads on wires, pendulums with more than gravity, a crank."""
    return [
        law(
            *("bead_on_catenary", "Bead on a catenary", ["x"]),
            {"x_dot**2*(exp(x)+exp(-x))**2": 0.125, "exp(x)+exp(-x)": -0.5 * _G},
            start=[(-1.2, 1.2)],
            rates=[(-1.0, 1.0)],
            push=[3.0],
            within=[(-3.0, 3.0)],
        ),
        law(
            *("bead_on_cosine", "Bead in a trough of a cosine", ["x"]),
            {"x_dot**2": 0.5, "x_dot**2*sin(1.5*x)**2": 0.18, "cos(1.5*x)": 0.4 * _G},
            start=[(-1.6, 1.6)],
            rates=[(-0.5, 0.5)],
            within=[(-2.05, 2.05)],
        ),
        law(
            *("bead_on_quartic", "Bead on a wire of degree four", ["x"]),
            {"x_dot**2": 0.5, "x_dot**2*x**6": 0.5, "x**4": -0.25 * _G},
            start=[(-1.1, 1.1)],
            rates=[(-1.0, 1.0)],
            push=[2.0],
            friction=0.1,
            within=[(-2.0, 2.0)],
        ),
        law(
            *("geared_pendulum", "Pendulum with a second one on a gear of 5:2", ["theta"]),
            {"theta_dot**2": 0.5, "cos(theta)": 6.0, "cos(2.5*theta)": 1.2},
            angles=["theta"],
            start=[(-1.5, 1.5)],
            rates=[(-1.0, 1.0)],
            push=[2.0],
            within=[_HALF_TURN],
        ),
        law(
            *("pendulum_and_spring", "Pendulum with a spring to a fixed point", ["theta"]),
            {
                "theta_dot**2": 0.5,
                "cos(theta)": _G - 1.8,
                "sin(theta)": 7.2,
                "sqrt(2.53-2.4*sin(theta)+0.6*cos(theta))": 4.8,
            },
            angles=["theta"],
            start=[(-1.6, 1.6)],
            rates=[(-1.0, 1.0)],
            within=[_HALF_TURN],
        ),
        law(
            *("pendulum_over_magnet", "Pendulum over a magnet that repels it", ["theta"]),
            {"theta_dot**2": 0.5, "cos(theta)": _G, "1/sqrt(41/16-5/2*cos(theta))": -1.2},
            angles=["theta"],
            start=[(-1.8, 1.8)],
            rates=[(-1.0, 1.0)],
            push=[2.0],
            friction=0.05,
            within=[_HALF_TURN],
        ),
        law(
            *("slider_crank", "Crank with a rod and a heavy piston", ["theta"]),
            {
                "theta_dot**2": 0.3,
                "theta_dot**2*(sin(theta)+sin(theta)*cos(theta)/sqrt(4-sin(theta)**2))**2": 0.25,
                "cos(theta)": -_G,
                "sqrt(4-sin(theta)**2)": -_G,
            },
            angles=["theta"],
            start=[(1.2, 5.0)],
            rates=[(-1.0, 1.0)],
            friction=0.05,
            within=[(0.0, 2.0 * math.pi)],
        ),
    ]


LAWS = (*_on_a_line(), *_guided())
