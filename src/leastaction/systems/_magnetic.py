"""The magnetic pendulum in its plane: three magnets below, a restoring force to the middle, nothing else."""

from __future__ import annotations

from leastaction.systems._draw import Uniform, Within
from leastaction.systems._system import MechanicalSystem

_REFERENCE = "Zhang & Sun, Differentiable Sparse Identification of Lagrangian Dynamics, arXiv 2511.10706"

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
