"""Candidates of a kinematic tree, and their names.

These are the inertial parameters of links, what acts in single joints, and expressions that the tree adds
(:meth:`leastaction.library.tree.KinematicTree.with_terms`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from leastaction.library.tree import INERTIAL, KinematicTree

__all__ = [
    "EXTRA",
    "FRICTION",
    "HISTORIES",
    "STILL",
    "ArmTerm",
    "JointScales",
    "inertial_terms",
    "joint_terms",
    "parameter_terms",
]


class JointScales(NamedTuple):
    """(n_dof,) each: ε and v_s in the joint's unit per second, δ in its unit."""

    width: np.ndarray
    stribeck: np.ndarray
    distance: np.ndarray


FRICTION = ("viscous", "dry", "stribeck", "load", "quadratic", "asymmetric")
"""Kinds of friction."""
EXTRA = ("extra", "loss")
"""Kinds of expressions that the tree adds: to L, and to the dissipation function."""
STILL = ("inertia", "spring", "extra")
"""Kinds that act on an arm at rest, beside constant torques."""
HISTORIES = ("dry", "turn", "delay", "gain", "start")
"""Kinds that depend on the motion, not on the state; after the last comes the number of the run."""
_KINDS = {
    "rotor": "inertia of the rotor of joint {}, through the gear",
    "viscous": "viscous friction of joint {}",
    "dry": "dry friction of joint {}",
    "stribeck": "excess of dry friction of joint {} at low speed",
    "load": "friction of joint {} in proportion to its load",
    "quadratic": "friction of joint {} that grows with the square of its speed",
    "asymmetric": "viscous friction of joint {} that differs between the directions",
    "spring": "spring of joint {}",
    "offset": "constant torque in joint {}",
    "delay": "error of the delay of the torque of joint {}",
    "gain": "relative error of the gain of the torque of joint {}",
    "start": "friction of joint {} when a run begins",
    "turn": "relative error of the distance, or speed, over which dry friction of joint {} reverses",
}


@dataclass(frozen=True)
class ArmTerm:
    """One candidate of an arm.

    Attributes
    ----------
    text : str
        Its name, such as ``"mx[link3]"`` or ``"dry[q2]"``.
    kind : str
        "inertia", one of the kinds of `joint_terms`, or of `EXTRA`.
    place : int
        Number of the link or joint, or among the expressions of the tree.
    component : int
        Of the inertial parameters; or number of the run of a "start".
    width : float
        ε, in the joint's unit per second.
    speed : float
        v_s of a Stribeck term.
    distance : float
        δ of dry friction, in the joint's unit; 0 if it follows the sign of the velocity at once. A "turn" is
        the derivative of unit friction in log δ, or in log ε if δ is zero.
    """

    text: str
    kind: str
    place: int
    component: int = 0
    width: float = 0.0
    speed: float = 0.0
    distance: float = 0.0

    def said(self, tree: KinematicTree) -> str:
        """The term in words."""
        if self.kind in EXTRA:
            whole = "L" if self.kind == "extra" else "the dissipation function"
            return f"coefficient of {tree.extra[self.place].text} in {whole}"
        if self.kind != "inertia":
            return _KINDS[self.kind].format(tree.coordinates[self.place])
        name, link = INERTIAL[self.component], tree.links[self.place]
        if name == "m":
            return f"mass of {link}"
        if name.startswith("m"):
            return f"mass of {link} times {name[1]} of its centre"
        word = "moment" if name[1] == name[2] else "product"
        return f"{word} of inertia {name[1:]} of {link}"


def inertial_terms(tree: KinematicTree) -> tuple[ArmTerm, ...]:
    """Ten for each link."""
    return tuple(
        ArmTerm(f"{name}[{link}]", "inertia", i, k)
        for i, link in enumerate(tree.links)
        for k, name in enumerate(INERTIAL)
    )


def joint_terms(
    tree: KinematicTree, kinds: Iterable[str], scales: JointScales, without: Sequence[int] = ()
) -> tuple[ArmTerm, ...]:
    """One of each kind for each joint, except those in ``without``."""
    return tuple(
        ArmTerm(
            f"{kind}[{name}]",
            kind,
            i,
            width=float(scales.width[i]),
            speed=float(scales.stribeck[i]) if kind == "stribeck" else 0.0,
            distance=float(scales.distance[i]) if kind in ("dry", "turn") else 0.0,
        )
        for kind in kinds
        for i, name in enumerate(tree.coordinates)
        if i not in without
    )


def parameter_terms(
    tree: KinematicTree, kinds: Iterable[str], scales: JointScales, without: Sequence[int] = ()
) -> tuple[ArmTerm, ...]:
    """Inertial parameters, terms of each kind for each joint, and the expressions that the tree adds."""
    names = {"lagrangian": ("L", "extra"), "dissipation": ("psi", "loss")}
    extra = (
        ArmTerm(f"{names[term.kind][0]}[{term.text}]", names[term.kind][1], k)
        for k, term in enumerate(tree.extra)
    )
    return (*inertial_terms(tree), *joint_terms(tree, kinds, scales, without), *extra)
