"""The systems by name."""

from __future__ import annotations

from functools import cache

from leastaction._errors import InputError
from leastaction.systems import _magnetic, _pendulums, _springs
from leastaction.systems._system import MechanicalSystem

_MAKERS = {
    "single_pendulum": _pendulums.single_pendulum,
    "double_pendulum": _pendulums.double_pendulum,
    "spherical_pendulum": _pendulums.spherical_pendulum,
    "chaotic_pendulum": _pendulums.chaotic_pendulum,
    "cart_spring_pendulum": _springs.cart_spring_pendulum,
    "spherical_spring_pendulum": _springs.spherical_spring_pendulum,
    "magnetic_pendulum": _magnetic.magnetic_pendulum,
}


def names() -> tuple[str, ...]:
    """Return the names of the seven systems.

    Examples
    --------
    >>> names()[:2]
    ('single_pendulum', 'double_pendulum')
    """
    return tuple(_MAKERS)


def get(name: str, **parameters: float) -> MechanicalSystem:
    """Return a system by name, with other physical parameters if given.

    Parameters
    ----------
    name : str
        One of `names()`.
    **parameters : float
        Physical parameters that differ from the usual ones, see ``get(name).parameters``.

    Raises
    ------
    InputError
        If there is no such system or parameter.

    Examples
    --------
    >>> get("single_pendulum", m=2.0).lagrangian
    {'theta_dot**2': 1.0, 'cos(theta)': 19.62}
    """
    if name not in _MAKERS:
        raise InputError(f"there is no system {name!r}; the systems are {', '.join(_MAKERS)}")
    system = _default(name)
    wrong = [p for p in parameters if p not in system.parameters]
    if wrong:
        raise InputError(f"{name} has no parameter {wrong[0]!r}; it has {', '.join(system.parameters)}")
    return _MAKERS[name](**parameters) if parameters else system


@cache
def _default(name: str) -> MechanicalSystem:
    # One object per name, so that its equations are derived and compiled once per process.
    return _MAKERS[name]()


def resolve(system: str | MechanicalSystem) -> MechanicalSystem:
    """Return the system meant by a name or by itself."""
    return system if isinstance(system, MechanicalSystem) else get(system)


def is_default(system: MechanicalSystem) -> bool:
    """Whether this is the very object that `get` returns for its name."""
    return system.name in _MAKERS and _default(system.name) is system
