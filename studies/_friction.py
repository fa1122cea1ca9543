"""Friction as a user would offer it: viscous and dry, in every coordinate."""

from __future__ import annotations

import re

from leastaction import systems

__all__ = ["COULOMB", "friction_candidates"]

COULOMB = re.compile(r"sqrt\((\w+_dot)\*\*2 ?\+ ?[^()]*\)")
"""Dry friction of the systems, rounded near zero velocity."""


def friction_candidates(system: systems.MechanicalSystem) -> list[str]:
    """Viscous and Coulomb friction in every coordinate, as a user would write them."""
    coulomb = {COULOMB.sub(r"abs(\1)", text): text for text in system.dissipation}
    own = [coulomb.get(f"abs({v})", f"abs({v})") for v in system.velocities]
    return [*(f"{v}**2/2" for v in system.velocities), *own]
