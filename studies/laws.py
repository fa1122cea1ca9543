"""Laws that no generated library holds: on a line, on wires; springs, fields, atoms in a plane and in space.

Half of the laws are driven by known forces, half are free and one coefficient is known; a third has viscous
friction.

Every second law in alphabetical order is kept aside: no rule is made, tuned or looked at on it, so that a
rule made on the others can be judged on these.  The split was written down before there was any result.
"""

from __future__ import annotations

import math

from leastaction import systems
from studies.law import law

__all__ = ["KEPT_ASIDE", "LAWS"]

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


_PLANE = {"x_dot**2": 0.5, "y_dot**2": 0.5}
_POLAR = {"r_dot**2": 0.5, "r**2*phi_dot**2": 0.5}
_SPACE = {**_PLANE, "z_dot**2": 0.5}
_XY = ["x", "y"]
_BOX = [(-4.0, 4.0)] * 2


def _springs() -> list[systems.MechanicalSystem]:
    """½k(d − l)² = ½k d² − k l d + …, with d a distance."""
    return [
        law(
            *("elastic_pendulum", "Elastic pendulum in x and y", _XY),
            {**_PLANE, "x**2": -15.0, "y**2": -15.0, "y": -_G, "sqrt(x**2+y**2)": 30.0},
            start=[(-1.0, 1.0), (-1.6, -1.0)],
            rates=[(-0.5, 0.5)] * 2,
            within=_BOX,
        ),
        law(
            *("spring_at_anchor", "Spring with a rest length, anchor beside the origin", _XY),
            {
                **_PLANE,
                **{"x**2": -4.0, "y**2": -4.0, "x": 5.6, "y": -8.8},
                "sqrt((x-7/10)**2+(y+11/10)**2)": 8.0,
            },
            start=[(-0.8, 2.2), (-2.6, 0.4)],
            rates=[(-1.0, 1.0)] * 2,
            friction=0.1,
            within=_BOX,
        ),
        law(
            *("spring_at_origin", "Spring with a rest length, anchor at the origin", _XY),
            {**_PLANE, "x**2": -5.0, "y**2": -5.0, "sqrt(x**2+y**2)": 8.0},
            start=[(-1.3, 1.3)] * 2,
            rates=[(-1.0, 1.0)] * 2,
            push=[1.5, 1.5],
            within=_BOX,
        ),
        law(
            *("cart_and_ball", "Ball on a spring under a cart", ["s", "x", "y"]),
            {
                **{"s_dot**2": 0.5, "x_dot**2": 0.25, "y_dot**2": 0.25, "y": -0.5 * _G},
                **{"s**2": -2.0 - 7.5, "s*x": 15.0, "x**2": -7.5, "y**2": -7.5},
                "sqrt((x-s)**2+y**2)": 15.0,
            },
            start=[(-0.5, 0.5), (-0.9, 0.9), (-1.6, -1.0)],
            rates=[(-0.5, 0.5)] * 3,
            push=[2.0, 0.5, 0.5],
            friction=0.05,
            within=[(-4.0, 4.0)] * 3,
        ),
        law(
            *("spring_in_space", "Elastic pendulum in x, y and z", ["x", "y", "z"]),
            {
                **{**_SPACE, "x**2": -10.0, "y**2": -10.0, "z**2": -10.0, "z": -_G},
                "sqrt(x**2+y**2+z**2)": 20.0,
            },
            start=[(-0.9, 0.9), (-0.9, 0.9), (-1.8, -1.1)],
            rates=[(-0.8, 0.8)] * 3,
            within=[(-4.0, 4.0)] * 3,
        ),
    ]


def _fields() -> list[systems.MechanicalSystem]:
    """Magnets, hills and central forces in a plane."""
    return [
        law(
            *("bowl_with_hill", "Bowl with a Gaussian hill", _XY),
            {**_PLANE, "x**2": -1.5, "y**2": -1.5, "exp(-2*(x**2+y**2))": -2.0},
            start=[(-1.3, 1.3)] * 2,
            rates=[(-1.0, 1.0)] * 2,
            push=[1.5, 1.5],
            friction=0.1,
            within=_BOX,
        ),
        law(
            *("central_power", "Central force r^0.4", _XY),
            {**_PLANE, "(x**2+y**2)**0.7": -2.0},
            start=[(-1.4, 1.4)] * 2,
            rates=[(-1.0, 1.0)] * 2,
            within=_BOX,
        ),
        law(
            *("galaxy", "Logarithmic potential of a flattened galaxy", _XY),
            {**_PLANE, "log(x**2+y**2/0.64+0.1)": -1.5},
            start=[(-1.4, 1.4)] * 2,
            rates=[(-1.0, 1.0)] * 2,
            within=_BOX,
        ),
        law(
            *("magnet_pair", "Two magnets that repel, in a bowl", _XY),
            {
                **{**_PLANE, "x**2": -1.5, "y**2": -1.5},
                "1/sqrt((x-0.6)**2+(y-0.4)**2+0.09)": -0.4,
                "1/sqrt((x+0.7)**2+(y+0.2)**2+0.09)": -0.4,
            },
            start=[(-1.4, 1.4)] * 2,
            rates=[(-1.0, 1.0)] * 2,
            push=[1.5, 1.5],
            within=_BOX,
        ),
        law(
            *("soft_kepler", "Softened attraction, driven", _XY),
            {**_PLANE, "1/sqrt(x**2+y**2+1/5)": 3.0},
            start=[(-1.2, 1.2)] * 2,
            rates=[(-1.0, 1.0)] * 2,
            push=[0.6, 0.6],
            friction=0.1,
            within=_BOX,
        ),
        law(
            *("three_magnets", "Three magnets at unequal places", _XY),
            {
                **{**_PLANE, "x**2": -0.5, "y**2": -0.5},
                "1/sqrt((x-1)**2+(y-0.2)**2+0.16)": 1.0,
                "1/sqrt((x+0.6)**2+(y-0.8)**2+0.16)": 1.0,
                "1/sqrt((x+0.3)**2+(y+0.9)**2+0.16)": 1.0,
            },
            start=[(-1.5, 1.5)] * 2,
            rates=[(-1.0, 1.0)] * 2,
            within=_BOX,
        ),
    ]


def _atoms() -> list[systems.MechanicalSystem]:
    """Pairs in polar coordinates, and chains."""
    turn = (-math.pi, math.pi)
    return [
        law(
            *("frenkel_kontorova", "Two coupled atoms over a periodic ground", _XY),
            {**_PLANE, "cos(2*x)": 1.5, "cos(2*y)": 1.5, "x**2": -1.0, "x*y": 2.0, "y**2": -1.0},
            start=[(-1.5, 1.5)] * 2,
            rates=[(-1.0, 1.0)] * 2,
            push=[1.0, 1.0],
            friction=0.1,
            within=_BOX,
        ),
        law(
            *("lennard_jones_pair", "Lennard-Jones pair in polar coordinates", ["r", "phi"]),
            {**_POLAR, "1/r**12": -8.0, "1/r**6": 8.0},
            angles=["phi"],
            start=[(1.05, 1.35), turn],
            rates=[(-0.4, 0.4), (-0.6, 0.6)],
            push=[0.6, 0.4],
            within=[(0.9, 3.0), None],
        ),
        law(
            *("yukawa_orbit", "Screened attraction in polar coordinates", ["r", "phi"]),
            {**_POLAR, "exp(-2*r/3)/r": 6.0},
            angles=["phi"],
            start=[(0.8, 1.4), turn],
            rates=[(-0.5, 0.5), (1.2, 2.0)],
            within=[(0.15, 4.0), None],
        ),
        law(
            *("toda_chain", "Toda chain of three between walls", ["x", "y", "z"]),
            {**_SPACE, "exp(-x)": -1.0, "exp(x-y)": -1.0, "exp(y-z)": -1.0, "exp(z)": -1.0},
            start=[(-1.5, 1.5)] * 3,
            rates=[(-1.0, 1.0)] * 3,
            within=[(-5.0, 5.0)] * 3,
        ),
    ]


_ALL = (*_on_a_line(), *_guided(), *_springs(), *_fields(), *_atoms())  # by kind
LAWS = {law.name: law for law in sorted(_ALL, key=lambda law: law.name)}
KEPT_ASIDE = frozenset(tuple(LAWS)[1::2])
