"""The systems by name."""

from __future__ import annotations

from functools import cache

from leastaction.errors import InputError
from leastaction.systems import _arms, _pendulums, _potentials
from leastaction.systems._system import MechanicalSystem

_MAKERS = {
    "single_pendulum": _pendulums.single_pendulum,
    "double_pendulum": _pendulums.double_pendulum,
    "spherical_pendulum": _pendulums.spherical_pendulum,
    "chaotic_pendulum": _pendulums.chaotic_pendulum,
    "cart_spring_pendulum": _pendulums.cart_spring_pendulum,
    "spherical_spring_pendulum": _pendulums.spherical_spring_pendulum,
    "magnetic_pendulum": _pendulums.magnetic_pendulum,
}
_FURTHER = {
    "triple_pendulum": _arms.triple_pendulum,
    "robot_arm": _arms.robot_arm,
    "rotary_pendulum": _arms.rotary_pendulum,
    "elastic_pendulum_cart": _arms.elastic_pendulum_cart,
    "spring_chain": _arms.spring_chain,
    "toda_chain": _arms.toda_chain,
    "double_well": _arms.double_well,
    "henon_heiles": _potentials.henon_heiles,
    "kepler_orbit": _potentials.kepler_orbit,
    "morse_molecule": _potentials.morse_molecule,
}
_ALL = _MAKERS | _FURTHER


def names() -> tuple[str, ...]:
    """Return the names of the seven systems.

    Examples
    --------
    >>> names()[:2]
    ('single_pendulum', 'double_pendulum')
    """
    return tuple(_MAKERS)


def further_names() -> tuple[str, ...]:
    """Return the names of further systems: more degrees of freedom, friction, other potentials.

    Examples
    --------
    >>> further_names()[:2]
    ('triple_pendulum', 'robot_arm')
    """
    return tuple(_FURTHER)


def get(name: str, **parameters: float) -> MechanicalSystem:
    """Return a system by name, with other physical parameters if given.

    Parameters
    ----------
    name : str
        One of `names()` or `further_names()`.
    **parameters : float
        Physical parameters that differ from the defaults; see ``get(name).parameters``.

    Raises
    ------
    InputError
        If there is no such system or parameter.

    Examples
    --------
    >>> get("single_pendulum", m=2.0).lagrangian
    {'theta_dot**2': 1.0, 'cos(theta)': 19.62}
    """
    if name not in _ALL:
        raise InputError(f"there is no system {name!r}; the systems are {', '.join(_ALL)}")
    system = _default(name)
    wrong = [p for p in parameters if p not in system.parameters]
    if wrong:
        raise InputError(f"{name} has no parameter {wrong[0]!r}; it has {', '.join(system.parameters)}")
    return _ALL[name](**parameters) if parameters else system


@cache
def _default(name: str) -> MechanicalSystem:
    # One object per name, so that its equations are derived and compiled once per process.
    return _ALL[name]()


def resolve(system: str | MechanicalSystem) -> MechanicalSystem:
    """Return the system meant by a name or by itself."""
    return system if isinstance(system, MechanicalSystem) else get(system)


def is_default(system: MechanicalSystem) -> bool:
    """Whether this is the very object that `get` returns for its name."""
    return system.name in _ALL and _default(system.name) is system
