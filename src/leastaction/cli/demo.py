r"""The measured pendulums of ``leastaction demo``: candidates, what is held out, published parameters.

The recordings are in ``leastaction/datasets`` (its README gives source and licence). They are consecutive
pieces of one decaying swing, so every third piece is held out: fitted and forecast pieces then span the same
amplitudes. Angles are measured from upright, so with height h = a cos θ the gravity term of L = T − V is
−m g a cos θ. A passive system fixes L only up to a factor; here the coefficient of the first squared
velocity is 1. The candidates are those one would write down without knowing the answer: products of two
velocities with cosines and sines of the angles and of their difference, the first harmonics of the
potential, and viscous and dry (Coulomb) friction in both joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["DEMOS", "HELD_OUT", "Demo"]

HELD_OUT = slice(2, None, 3)
"""Trials that are not fitted but forecast."""


@dataclass(frozen=True)
class Demo:
    """One measured pendulum.

    Attributes
    ----------
    title, file : str
        What it is; name of the file in ``leastaction/datasets``.
    coordinates : tuple of str
        All of them angles, from upright.
    candidates, dissipation : tuple of str
        For L and for the dissipation function.
    known : dict
        The coefficient that sets the scale of L.
    published, published_dissipation : dict
        Expression -> coefficient by the authors of the data, on the same scale.
    """

    title: str
    file: str
    coordinates: tuple[str, ...]
    candidates: tuple[str, ...]
    dissipation: tuple[str, ...]
    known: Mapping[str, float]
    published: Mapping[str, float]
    published_dissipation: Mapping[str, float]


def _single() -> Demo:
    # Without theta_dot**2*cos(theta): with one coordinate and little friction it hardly differs from a
    # change of cos(theta) and cos(2*theta) together.
    m, a, inertia, k, g = 0.147755, 0.147585, 1.0912e-4, 2.2394e-4, 9.81001
    scale = (inertia + m * a**2) / 2
    return Demo(
        title="single pendulum",
        file="single_pendulum.csv.gz",
        coordinates=("theta",),
        candidates=(
            "theta_dot**2",
            "theta_dot**2*sin(theta)",
            "theta_dot**4",
            "cos(theta)",
            "sin(theta)",
            "cos(2*theta)",
            "sin(2*theta)",
            "cos(3*theta)",
        ),
        dissipation=("theta_dot**2/2", "abs(theta_dot)"),
        known={"theta_dot**2": 1.0},
        published={"theta_dot**2": 1.0, "cos(theta)": -m * g * a / scale},
        published_dissipation={"theta_dot**2/2": k / scale},
    )


def _double() -> Demo:
    m1, m2, a1, length1, inertia1 = 0.0938440, 0.137596, 0.108565, 0.172719, 4.37529e-4
    k1, k2 = 2.37143e-4, 1e-5
    scale = (inertia1 + m1 * a1**2 + m2 * length1**2) / 2
    return Demo(
        title="double pendulum",
        file="double_pendulum.csv.gz",
        coordinates=("theta1", "theta2"),
        candidates=(
            "theta1_dot**2",
            "theta2_dot**2",
            "theta1_dot*theta2_dot*cos(theta1-theta2)",
            "theta1_dot*theta2_dot*sin(theta1-theta2)",
            "theta1_dot*theta2_dot",
            "theta1_dot**2*cos(theta1)",
            "theta2_dot**2*cos(theta2)",
            "theta1_dot**2*cos(theta1-theta2)",
            "theta2_dot**2*cos(theta1-theta2)",
            "cos(theta1)",
            "cos(theta2)",
            "sin(theta1)",
            "sin(theta2)",
            "cos(theta1-theta2)",
            "cos(2*theta1)",
            "cos(2*theta2)",
        ),
        dissipation=(
            "theta1_dot**2/2",
            "theta2_dot**2/2",
            "(theta2_dot-theta1_dot)**2/2",
            "abs(theta1_dot)",
            "abs(theta2_dot-theta1_dot)",
        ),
        known={"theta1_dot**2": 1.0},
        published={
            "theta1_dot**2": 1.0,
            "theta2_dot**2": 0.55684,
            "theta1_dot*theta2_dot*cos(theta1-theta2)": 0.98270,
            "cos(theta1)": -117.922,
            "cos(theta2)": -55.806,
        },
        # Friction of the second joint goes with the angle between the links.
        published_dissipation={"theta1_dot**2/2": k1 / scale, "(theta2_dot-theta1_dot)**2/2": k2 / scale},
    )


DEMOS: dict[str, Demo] = {"double": _double(), "single": _single()}
"""Name of the system on the command line -> demonstration."""
