r"""Export of a chain of links in a plane as MJCF (MuJoCo) and URDF.

With absolute angles θ_i from down, a chain of links under gravity has

    L = ½ Σ_i A_ii θ̇_i² + Σ_{i<j} A_ij θ̇_i θ̇_j cos(θ_i − θ_j) + Σ_i b_i cos θ_i,
    A_ii = I_i + m_i a_i² + l_i² Σ_{k>i} m_k,   A_ij = l_i c_j,
    b_i = g c_i,   c_i = m_i a_i + l_i Σ_{k>i} m_k,

where l is the length of a link and a the distance of its centre of mass from its joint. These are base
parameters: the motion depends on the masses only through such combinations. With g, the lengths follow. The
masses are then chosen from the last link on, each slightly above the smallest for which its inertia is
positive.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
import sympy as sp

from leastaction.errors import InputError
from leastaction.exporters.shared import about
from leastaction.findings import as_given
from leastaction.mechanics.equations import state_symbols
from leastaction.model.model import LagrangianModel

__all__ = ["Chain", "Link", "chain_of", "write_mjcf", "write_urdf"]

GRAVITY = 9.81  # m/s²: determines only how L splits into masses and lengths
_MOST_LINKS = 7
_MARGINS = (0.25, 0.05, 0.01, 1e-3)  # of a mass above the smallest possible one
_STATES = 20  # at which L is compared
_APART = 0.01  # largest relative difference between products A_ij and l_i c_j


@dataclass(frozen=True)
class Link:
    """One link.

    Attributes
    ----------
    mass, centre, inertia : float
        Centre of mass from the joint along the link, and moment of inertia about it.
    length : float
        To the next joint; for the last link, twice the distance to its centre.
    damping : float
        Viscous friction of its joint.
    """

    mass: float
    centre: float
    inertia: float
    length: float
    damping: float


@dataclass(frozen=True)
class Chain:
    """Links from the fixed joint on.

    Attributes
    ----------
    links : tuple of Link
    upright : bool
        Whether angles are measured from upright instead of from down.
    relative : bool
        Whether the model measures each angle from the previous link, as a joint does.
    left_out : tuple of str
        Friction that a joint cannot have.
    apart : float
        Largest relative difference of a coefficient from that of the law.
    """

    links: tuple[Link, ...]
    upright: bool
    relative: bool
    left_out: tuple[str, ...]
    apart: float

    def placed(self) -> Iterator[tuple[int, Link, float, float]]:
        """Number from 1, link, height of its joint above the previous one, and 1 (up) or −1 (down)."""
        way, sign = 0.0, 1.0 if self.upright else -1.0
        for number, link in enumerate(self.links, 1):
            yield number, link, sign * way, sign
            way = link.length


def chain_of(model: LagrangianModel) -> Chain:
    """The chain of links whose L is that of a model.

    Raises
    ------
    InputError
        If it is not a chain, with the reason.
    """
    n = model.n_dof
    if n > _MOST_LINKS or model.timed or model.prescribed:
        raise _no_chain("it has too many coordinates, depends on time, or has a prescribed motion")
    angles, rates, _ = state_symbols(model.coordinates)
    for relative in (False, True) if n > 1 else (False,):
        swap = {}
        if relative:  # q_k = θ_k − θ_{k−1}
            for group in (angles, rates):
                swap |= {group[k]: group[k] - group[k - 1] for k in range(1, n)}
        found = _base_parameters(model.lagrangian.xreplace(swap), angles, rates)
        if found is not None:
            inertia, gravity = found
            if (gravity > 0).any() and (gravity < 0).any():
                raise _no_chain("some of its links hang and others stand upright")
            damping, left_out = _dampers(model, relative)
            links, apart = _links(inertia, np.abs(gravity) / GRAVITY, damping)
            return Chain(links, bool(gravity[0] < 0), relative, left_out, apart)
    raise _no_chain(
        "L must be a sum of squared velocities, of products of two velocities with the cosine of the angle "
        "between their links, and of a cosine for each link"
    )


def _no_chain(why: str) -> InputError:
    return InputError(f"this law is not a chain of links in a plane: {why}; export another format")


def _base_parameters(
    expr: sp.Expr, angles: list[sp.Symbol], rates: list[sp.Symbol]
) -> tuple[np.ndarray, np.ndarray] | None:
    """A, shape (n, n), and b, shape (n,), of L in absolute angles; None if it has another form.

    They follow from derivatives at one state. L is then compared at other states, because two equal
    trigonometric expressions may look different.
    """
    n, state = len(angles), [*angles, *rates]
    second = [sp.diff(expr, rates[i], rates[j]) for i in range(n) for j in range(n)]
    slopes = [sp.diff(expr, angle) for angle in angles]
    if (expr.free_symbols - set(state)) or expr.has(sp.zoo, sp.nan):
        return None
    law = sp.lambdify(state, [expr, *second, *slopes], modules="numpy", cse=True)
    with np.errstate(all="ignore"):
        inertia = np.array(law(*np.zeros(2 * n))[1 : 1 + n * n], dtype=float).reshape(n, n)
        quarter = np.concatenate([np.full(n, 0.5 * np.pi), np.zeros(n)])
        gravity = -np.array(law(*quarter)[1 + n * n :], dtype=float)
        states = np.random.default_rng(0).uniform(-2.0, 2.0, (_STATES, 2 * n))
        values = np.array([float(law(*one)[0]) for one in states])
    q, qdot = states[:, :n], states[:, n:]
    between = np.cos(q[:, :, None] - q[:, None, :])
    chain = 0.5 * np.einsum("ti,ij,tij,tj->t", qdot, inertia, between, qdot) + np.cos(q) @ gravity
    off, size = np.ptp(values - chain), np.abs(inertia).max() + np.abs(gravity).max()
    fits = off <= 1e-9 * size and (gravity != 0).all() and (np.diag(inertia) > 0).all()
    return (inertia, gravity) if fits else None


def _dampers(model: LagrangianModel, relative: bool) -> tuple[np.ndarray, tuple[str, ...]]:
    """Viscous friction of each joint, and the other terms of ψ."""
    n, rates = model.n_dof, state_symbols(model.coordinates)[1]
    joints = [rates[k] - rates[k - 1] if k and not relative else rates[k] for k in range(n)]
    damping, left_out = np.zeros(n), []
    for term, expr in zip(model.dissipation, model.dissipation_expressions, strict=True):
        for k, joint in enumerate(joints):
            ratio = sp.simplify(expr / (joint**2 / 2))
            if not ratio.free_symbols:
                damping[k] += term.coefficient * float(ratio)
                break
        else:
            left_out.append(as_given(term.written, model.fit.smoothing_widths))
    return damping, tuple(left_out)


def _links(inertia: np.ndarray, moments: np.ndarray, damping: np.ndarray) -> tuple[tuple[Link, ...], float]:
    """Links with these base parameters, and their error if a chain has fewer parameters than the law."""
    n = len(moments)
    lengths = np.zeros(n)
    for i in range(n - 1):
        ahead = moments[i + 1 :]
        lengths[i] = inertia[i, i + 1 :] @ ahead / (ahead @ ahead)
    product = np.outer(lengths, moments)
    upper = np.triu_indices(n, 1)
    apart = float(np.max(np.abs(product[upper] / inertia[upper] - 1.0), initial=0.0)) if n > 1 else 0.0
    if not apart <= _APART or (lengths[:-1] <= 0).any():
        raise _no_chain(f"its coefficients imply lengths that differ by {apart:.1%}")
    for margin in _MARGINS:
        found: list[Link] = []
        for i in reversed(range(n)):
            beyond = sum(link.mass for link in found)
            moment = moments[i] - lengths[i] * beyond
            about_joint = inertia[i, i] - lengths[i] ** 2 * beyond
            if about_joint <= 0:
                break
            least = 0.01 * about_joint / lengths[i] ** 2 if lengths[i] else 0.0
            mass = max((1.0 + margin) * moment**2 / about_joint, least)
            centre = moment / mass
            spin = about_joint - moment * centre
            numbers = (mass, centre, spin, lengths[i] or 2.0 * centre, damping[i])
            found.insert(0, Link(*map(float, numbers)))
        if len(found) == n:
            return tuple(found), apart
    raise _no_chain("no positive masses and inertias have these coefficients")


def _words(model: LagrangianModel, chain: Chain) -> str:
    """Comments of the file."""
    lines = about(model)
    start = "upright" if chain.upright else "hanging"
    lines.append(
        f"Joint 1 is measured from {start}, in the plane of x and z; each other joint from the previous link."
    )
    if not chain.relative and len(chain.links) > 1:
        lines.append("The angles of the model are absolute: joint k is angle k minus angle k-1.")
    lines.append(f"Gravity is {GRAVITY:g}. Other masses and inertias with the same L give the same motion.")
    if chain.apart > 1e-9:
        lines.append(f"Coefficients of the couplings are matched to {100 * chain.apart:.2g} %.")
    lines += [f"Left out, because a joint cannot have it: friction {text}" for text in chain.left_out]
    return "\n".join(["", *(f"  {line}" for line in lines), ""]).replace("--", "- -")


def write_mjcf(model: LagrangianModel) -> str:
    """Return a model for MuJoCo.

    Raises
    ------
    InputError
        If the law is no chain.
    """
    chain = chain_of(model)
    root = ET.Element("mujoco", {"model": "leastaction_model"})
    root.append(ET.Comment(_words(model, chain)))
    ET.SubElement(root, "compiler", {"angle": "radian"})
    ET.SubElement(root, "option", {"gravity": f"0 0 {-GRAVITY!r}", "timestep": "0.001", "integrator": "RK4"})
    body = ET.SubElement(root, "worldbody")
    for k, link, height, sign in chain.placed():
        body = ET.SubElement(body, "body", {"name": f"link{k}", "pos": f"0 0 {height!r}"})
        joint = {"name": f"joint{k}", "type": "hinge", "axis": "0 -1 0", "damping": repr(link.damping)}
        ET.SubElement(body, "joint", joint)
        spin = " ".join([repr(link.inertia)] * 3)
        inertial = {"pos": f"0 0 {sign * link.centre!r}", "mass": repr(link.mass), "diaginertia": spin}
        ET.SubElement(body, "inertial", inertial)
        end = {
            "type": "capsule",
            "fromto": f"0 0 0 0 0 {sign * link.length!r}",
            "size": repr(link.length / 20),
        }
        ET.SubElement(body, "geom", {**end, "contype": "0", "conaffinity": "0"})
    return _text(root)


def write_urdf(model: LagrangianModel) -> str:
    """Return a robot description.

    Raises
    ------
    InputError
        If the law is no chain.
    """
    chain = chain_of(model)
    root = ET.Element("robot", {"name": "leastaction_model"})
    root.append(ET.Comment(_words(model, chain)))
    ET.SubElement(root, "link", {"name": "base"})
    for k, link, height, sign in chain.placed():
        part = ET.SubElement(root, "link", {"name": f"link{k}"})
        inertial = ET.SubElement(part, "inertial")
        ET.SubElement(inertial, "origin", {"xyz": f"0 0 {sign * link.centre!r}"})
        ET.SubElement(inertial, "mass", {"value": repr(link.mass)})
        spin = dict.fromkeys(("ixx", "iyy", "izz"), repr(link.inertia))
        ET.SubElement(inertial, "inertia", {**spin, **dict.fromkeys(("ixy", "ixz", "iyz"), "0")})
        joint = ET.SubElement(root, "joint", {"name": f"joint{k}", "type": "continuous"})
        ET.SubElement(joint, "parent", {"link": f"link{k - 1}" if k > 1 else "base"})
        ET.SubElement(joint, "child", {"link": f"link{k}"})
        ET.SubElement(joint, "origin", {"xyz": f"0 0 {height!r}"})
        ET.SubElement(joint, "axis", {"xyz": "0 -1 0"})
        ET.SubElement(joint, "dynamics", {"damping": repr(link.damping), "friction": "0"})
    return _text(root)


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
