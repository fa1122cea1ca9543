"""Laws of two and three coordinates for `laws.py`: springs with a rest length, magnets, atoms, galaxies."""

from __future__ import annotations

import math

from leastaction import systems
from studies._law import law

__all__ = ["LAWS"]

_G = 9.81
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


LAWS = (*_springs(), *_fields(), *_atoms())
