"""Candidate libraries of the systems, and the true coefficients in any given library."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np
import sympy as sp

from leastaction.errors import InputError
from leastaction.library import Library
from leastaction.systems._registry import further_names, resolve
from leastaction.systems._system import MechanicalSystem
from leastaction.systems._variational import euler_lagrange

# Residual, relative to the term, up to which a representation counts as exact.
_EXACT = 1e-9
# Terms of Library.mechanical that a large library may take, and how new the effect of one must be
_MOST_GENERATED = 105
_NEW = 1e-3


def compact_library(system: str | MechanicalSystem) -> Library:
    """Return the 11 to 24 candidates of a system as a `Library`.

    The true dissipation terms, if the system has any, are the library's dissipation terms.

    Examples
    --------
    >>> from leastaction import systems
    >>> len(systems.compact_library("double_pendulum"))
    18
    """
    system = resolve(system)
    return Library(
        system.library, system.coordinates, angles=system.angles, dissipation=tuple(system.dissipation)
    )


def large_library(system: str | MechanicalSystem) -> Library:
    """Return 50 to 120 generated candidates of a system as a `Library`.

    For the seven systems of `names`, they are products of velocities with simple functions of the
    coordinates, and potentials. For those of `further_names`, they are those of `Library.mechanical` and of
    the compact library.
    The true Lagrangian is in their span; `truth_for` gives its coefficients. For the double pendulum these
    are 51 terms, where θ̇₁θ̇₂cos(θ₁−θ₂) appears as two products.

    Examples
    --------
    >>> from leastaction import systems
    >>> library = systems.large_library("double_pendulum")
    >>> len(library)
    51
    >>> for index, coefficient in systems.truth_for("double_pendulum", library).items():
    ...     print(library[index].text, coefficient)
    theta1_dot**2 1.0
    theta2_dot**2 0.5
    theta1_dot*theta2_dot*cos(theta1)*cos(theta2) 1.0
    theta1_dot*theta2_dot*sin(theta1)*sin(theta2) 1.0
    cos(theta2) 9.81
    cos(theta1) 19.62
    """
    system = resolve(system)
    if system.name not in (*_LARGE, *further_names()):
        raise InputError(
            f"there is no large library for {system.name!r}; there is for "
            f"{', '.join((*_LARGE, *further_names()))}"
        )
    if system.name not in _LARGE:
        return _generated(system)
    terms = dict.fromkeys(_LARGE[system.name](system))
    return Library(terms, system.coordinates, angles=system.angles, dissipation=tuple(system.dissipation))


def _generated(system: MechanicalSystem) -> Library:
    """Return the compact candidates and those of `Library.mechanical` that they can not nearly write."""
    library = compact_library(system)
    lengths = [c not in system.angles for c in system.coordinates]
    positive = bool((_points(system)[0][:, lengths] > 0).all())
    sizes = {
        size: Library.mechanical_size(system.coordinates, system.angles, size=size)
        for size in ("compact", "standard", *(["large"] if positive else []))  # which has 1/x and log(x)
    }
    size = max((s for s, n in sizes.items() if n <= _MOST_GENERATED), key=lambda s: sizes[s])
    more = list(Library.mechanical(system.coordinates, system.angles, size=size))
    if system.name in _MORE:
        more += list(library.replace(terms=_MORE[system.name](system)))
    columns = _columns(system, [*library, *more], "lagrangian")
    columns = columns / np.linalg.norm(columns, axis=0)
    basis = np.linalg.qr(columns[:, : len(library)])[0]
    terms = list(library)
    for term, column in zip(more, columns.T[len(library) :], strict=True):
        rest = column - basis @ (basis.T @ column)
        if np.linalg.norm(rest) > _NEW:
            terms.append(term)
            rest -= basis @ (basis.T @ rest)
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
    return library.replace(terms=terms)


def _times(*factors: Iterable[str]) -> list[str]:
    """Return all products of one member of each group; the member "1" leaves no trace."""
    products = ("*".join(f for f in choice if f != "1") or "1" for choice in product(*factors))
    return list(dict.fromkeys(products))


def _potentials(functions: Iterable[str]) -> list[str]:
    return [f for f in functions if f != "1"]


def _single(system) -> list[str]:
    functions = [
        *("1", "theta", "theta**2", "theta**3", "cos(theta)", "sin(theta)", "cos(theta)**2"),
        *("sin(theta)*cos(theta)", "cos(theta)**3", "cos(theta)**2*sin(theta)"),
    ]
    velocities = ["theta_dot**2", "theta_dot**3", "theta_dot**4", "theta_dot**5"]
    return [*_times(velocities, functions), *_potentials(functions), "theta**4", "theta*cos(theta)"]


def _in_x(system) -> list[str]:
    return [term.replace("theta", "x") for term in _single(system)]


def _in_plane(system) -> list[str]:
    velocities = ("x_dot**2", "y_dot**2", "x_dot*y_dot")
    higher = ("x_dot**4", "y_dot**4", "x_dot**2*y_dot**2", "x_dot**2*y", "x_dot*y**2", "x**2*y_dot")
    return [*_times(velocities, ("x**3", "y**3", "x**2*y")), *higher, *_potentials(_monomials("x", "y", 6))]


def _double(system) -> list[str]:
    velocities = ["theta1_dot**2", "theta2_dot**2", "theta1_dot*theta2_dot"]
    functions = [
        *_times(("1", "cos(theta1)", "sin(theta1)"), ("1", "cos(theta2)", "sin(theta2)")),
        *("cos(theta1)**2", "sin(theta1)*cos(theta1)", "cos(theta2)**2", "sin(theta2)*cos(theta2)"),
    ]
    return [*_times(velocities, functions), *_potentials(functions)]


def _spherical(system) -> list[str]:
    polar = ("1", "cos(theta)", "sin(theta)", "sin(theta)**2", "sin(theta)*cos(theta)")
    functions = _times(polar, ("1", "cos(phi)", "sin(phi)"))
    return [*_times(("theta_dot**2", "phi_dot**2", "theta_dot*phi_dot"), functions), *_potentials(functions)]


def _cart(system) -> list[str]:
    functions = _times(
        ("1", "x", "x**2"), ("1", "cos(theta)", "sin(theta)", "cos(theta)**2", "sin(theta)*cos(theta)")
    )
    velocities = ("x_dot**2", "x_dot*theta_dot", "theta_dot**2")
    return [*_times(velocities, functions), *_potentials(functions), "x**3", "x**4"]


def _spherical_spring(system) -> list[str]:
    functions = _times(("1", "x", "x**2"), ("1", "cos(theta)", "sin(theta)", "sin(theta)**2"))
    squares = ("x_dot**2", "theta_dot**2", "phi_dot**2")
    mixed = ("x_dot*theta_dot", "x_dot*phi_dot", "theta_dot*phi_dot")
    sideways = _times(("x", "x**2"), ("cos(phi)", "sin(phi)"))
    return [*_times((*squares, *mixed), functions), *_potentials(functions), "x**3", "x**4", *sideways]


def _magnetic(system) -> list[str]:
    magnets = [k for k in system.lagrangian if "sqrt" in k]
    distances = [k.removeprefix("1/sqrt(")[:-1] for k in magnets]
    return [
        *_times(("x_dot**2", "y_dot**2", "x_dot*y_dot"), _monomials("x", "y", 2)),
        *("x*y_dot", "x**2*y_dot", "x_dot*y**2", "x_dot**4", "y_dot**4", "x_dot**2*y_dot**2"),
        *_potentials(_monomials("x", "y", 4)),
        *magnets,
        *(f"1/({d})" for d in distances),
        *(f"1/({d})**2" for d in distances),
        *(f"log({d})" for d in distances),
    ]


def _monomials(x: str, y: str, degree: int) -> list[str]:
    def power(name: str, k: int) -> str:
        return "1" if k == 0 else name if k == 1 else f"{name}**{k}"

    pairs = [(i, k - i) for k in range(degree + 1) for i in range(k, -1, -1)]
    return [f for i, j in pairs for f in _times([power(x, i)], [power(y, j)])]


_LARGE = {
    "single_pendulum": _single,
    "double_pendulum": _double,
    "spherical_pendulum": _spherical,
    "chaotic_pendulum": _double,
    "cart_spring_pendulum": _cart,
    "spherical_spring_pendulum": _spherical_spring,
    "magnetic_pendulum": _magnetic,
}

# systems that have few candidates otherwise
_MORE = {"double_well": _in_x, "henon_heiles": _in_plane}


def truth_for(system: str | MechanicalSystem, library: Library, kind: str = "lagrangian") -> dict[int, float]:
    """Return the coefficients that express the true Lagrangian in a library, up to null terms.

    True terms that are in the library keep their coefficients. Any other one is expressed as a combination of
    candidates with the same Euler–Lagrange expression at random points. If there are several, a short one is
    used.

    Parameters
    ----------
    system : str or MechanicalSystem
    library : Library
    kind : {"lagrangian", "dissipation"}
        Which function, and which of the library's two lists; for the dissipation ∂ψ/∂q̇ is compared.

    Returns
    -------
    dict
        Index in the library (in ``library.dissipation`` for that kind) -> coefficient, sorted by index.

    Raises
    ------
    InputError
        If the library cannot express the truth. The message names the first true term that fails.

    Examples
    --------
    >>> from leastaction import systems
    >>> from leastaction.library import Library
    >>> library = Library(["theta", "sin(theta/2)**2", "theta_dot**2"], ["theta"])
    >>> systems.truth_for("single_pendulum", library)
    {1: -19.62, 2: 0.5}
    """
    system = resolve(system)
    if kind not in ("lagrangian", "dissipation"):
        raise InputError(f"kind={kind!r}; expected 'lagrangian' or 'dissipation'")
    if tuple(library.coordinates) != system.coordinates:
        raise InputError(
            f"the library is over {library.coordinates}; expected {system.coordinates}, as in {system.name}"
        )
    true = system.lagrangian if kind == "lagrangian" else system.dissipation
    terms = library.terms if kind == "lagrangian" else library.dissipation
    columns: np.ndarray | None = None
    coefficients: dict[int, float] = {}
    for text, value in true.items():
        expression = system.parse(text)
        share = {k: 1.0 for k, term in enumerate(terms) if term.expr == expression}
        if not share:
            columns = _columns(system, terms, kind) if columns is None else columns
            share = _represent(_column(system, expression, kind, _points(system)), columns)
            if share is None:
                raise InputError(f"the library cannot write the true term {text!r}; add it")
        for k, c in share.items():
            coefficients[k] = coefficients.get(k, 0.0) + c * value
    return {k: coefficients[k] for k in sorted(coefficients) if coefficients[k] != 0.0}


def _points(system: MechanicalSystem, n_points: int = 300) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(0)
    q, v = np.moveaxis(np.array([system.initial(rng) for _ in range(n_points)]), 1, 0)
    return q, v, rng.normal(scale=3.0, size=q.shape)


def _columns(system, terms, kind: str) -> np.ndarray:
    points = _points(system)
    return np.stack([_column(system, term.expr, kind, points) for term in terms], axis=1)


def _column(system, expression: sp.Expr, kind: str, points) -> np.ndarray:
    """Return what a term does to the equations of motion at the points, as one column."""
    q, v = system.symbols
    a = sp.symbols(f"a0:{system.n_dof}", real=True)
    parts = (
        euler_lagrange(expression, q, v, a) if kind == "lagrangian" else [sp.diff(expression, s) for s in v]
    )
    function = sp.lambdify([*q, *v, *a], parts, "numpy", cse=True)
    with np.errstate(all="ignore"):
        values = function(*(x[:, i] for x in points for i in range(system.n_dof)))
    return np.concatenate([np.broadcast_to(value, len(points[0])) for value in values])


def _represent(wanted: np.ndarray, columns: np.ndarray) -> dict[int, float] | None:
    """Return a short combination of columns equal to `wanted`, or None if there is none."""
    size = np.linalg.norm(columns, axis=0)
    usable = np.flatnonzero(np.isfinite(size) & (size > 0))
    scaled = columns[:, usable] / size[usable]
    chosen: list[int] = []
    for _ in range(min(6, len(usable))):
        # Forward search finds the short identities (addition theorems, expanded squares) exactly.
        errors = [np.linalg.lstsq(scaled[:, [*chosen, k]], wanted)[0] for k in range(len(usable))]
        residuals = [np.linalg.norm(scaled[:, [*chosen, k]] @ x - wanted) for k, x in enumerate(errors)]
        chosen.append(int(np.argmin(residuals)))
        if residuals[chosen[-1]] <= _EXACT * np.linalg.norm(wanted):
            break
    for support in (chosen, range(len(usable))):
        x = np.linalg.lstsq(scaled[:, list(support)], wanted)[0]
        keep = [k for k, c in zip(support, x, strict=True) if abs(c) > 1e-8 * np.abs(x).max()]
        x = np.linalg.lstsq(scaled[:, keep], wanted)[0]
        if np.linalg.norm(scaled[:, keep] @ x - wanted) <= _EXACT * np.linalg.norm(wanted):
            found = x / size[usable[keep]]
            return {int(usable[k]): _tidy(c) for k, c in zip(keep, found, strict=True)}
    return None


def _tidy(value: float) -> float:
    """Take off the rounding of the least squares where a short number is meant."""
    short = round(float(value), 9)
    return short if abs(short - value) <= 1e-9 * abs(value) else float(value)
