"""What every method is given, and what it gives back: the protocol of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

import leastaction as la
from leastaction import systems

__all__ = ["Answer", "Case", "Problem", "acceleration_of", "inputs", "names", "pose"]

DURATION, RATE = 20.0, 100.0  # seconds and samples a second

Acceleration = Callable[[np.ndarray, np.ndarray, "np.ndarray | None"], np.ndarray]


@dataclass(frozen=True)
class Case:
    """One run, named completely: the same case always poses the same problem.

    Attributes
    ----------
    system : str
        One of ``systems.names()``.
    noise : float
        Level: times the standard deviation of each coordinate, or in rad and m.
    noise_convention : {"relative", "absolute"}
    library : {"compact", "large"}
    method : str
        One of ``methods.NAMES``.
    variant : str
        What the method is asked to do differently, in the method's own words; "" as a rule.
    trial : int
        New initial conditions, forcing and noise each.
    trajectories : int
    missing : float
        Share of the samples left out at random.
    """

    system: str
    noise: float
    method: str
    trial: int = 0
    noise_convention: str = "relative"
    library: str = "compact"
    variant: str = ""
    trajectories: int = 5
    missing: float = 0.0

    @property
    def seed(self) -> int:
        """Of motions and noise: the same for all methods and noise levels."""
        return 1000 + self.trial

    @property
    def key(self) -> str:
        """Name of the run."""
        parts = [self.method, self.variant, self.system, f"{self.noise:g}", self.noise_convention]
        parts += [self.library, f"{self.trajectories}x", f"missing{self.missing:g}", f"trial{self.trial}"]
        return "-".join(p for p in parts if p)

    @property
    def part(self) -> str:
        """The part of the records that the run belongs to: those of its method."""
        return self.method

    def as_dict(self) -> dict:
        return {**asdict(self), "seed": self.seed}

    @classmethod
    def from_dict(cls, config: Mapping) -> Case:
        return cls(**{name: value for name, value in config.items() if name != "seed"})


@dataclass(frozen=True, eq=False)
class Problem:
    """The data of a case.

    Attributes
    ----------
    data : Trajectories
        What a user has: times, noisy positions, known forces.
    truth : tuple of TrueMotion
        The exact motions.  Only for methods whose authors gave them velocities and accelerations
        (exact ones plus noise), and for scoring.
    noise_std : (n_dof,) array
        Of the positions.
    library : Library
        The package's own reduction has not been applied.
    known : dict
        Term → coefficient that is given; empty for active systems.
    true_coefficients : dict
        Term → coefficient, the known ones included; for scoring only.
    """

    case: Case
    system: systems.MechanicalSystem
    data: la.Trajectories
    truth: tuple[systems.TrueMotion, ...]
    noise_std: np.ndarray
    library: la.Library
    known: Mapping[str, float]
    true_coefficients: Mapping[str, float]

    def free(self, values: Mapping[str, float]) -> dict[str, float]:
        """Those of the free terms, by the texts of the library, which a model may write another way."""
        known = {self.library.index(text) for text in self.known}
        places = {self.library.index(text): value for text, value in values.items()}
        return {self.library[k].text: value for k, value in places.items() if k not in known}


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method found.

    Attributes
    ----------
    coefficients : dict or None
        Term text of the library → coefficient of L, found terms only and without the known ones;
        None when the method does not give a Lagrangian.
    acceleration : callable or None
        ``acceleration(q, qdot, forces)`` of (n, n_dof) arrays (forces None if passive) → (n, n_dof);
        may return NaN where it fails.  Scored by equation error and forecast horizon.
    status : str
        "ok", or in one line what the method says of its own result.
    settings : dict
        Everything that was chosen, so that the run can be repeated; JSON values only.
    errors : dict or None
        Term → standard error, where the method gives one.
    expression : str
        The found law as the method prints it, when it is not a combination of the library's terms.
    history : list of (seconds, dict of coefficients)
        For methods that iterate: what had been found when, for time to a given error.
    child_mb : float
        Largest resident memory of a process that the method has started, in MB.
    """

    coefficients: Mapping[str, float] | None
    acceleration: Acceleration | None
    status: str = "ok"
    settings: Mapping[str, object] = field(default_factory=dict)
    errors: Mapping[str, float] | None = None
    expression: str = ""
    history: list[tuple[float, Mapping[str, float]]] = field(default_factory=list)
    child_mb: float = 0.0


def names(problem: Problem) -> list[str]:
    """Return the names of what q̈ is regressed on: coordinates, velocities, forces where they act."""
    system = problem.system
    driven = () if problem.data[0].forces is None else (f"f_{c}" for c in system.coordinates)
    return [*system.coordinates, *system.velocities, *driven]


def inputs(q: np.ndarray, qdot: np.ndarray, forces: np.ndarray | None) -> np.ndarray:
    """Return coordinates, velocities and forces side by side, the columns of `names`."""
    return np.column_stack([q, qdot] if forces is None else [q, qdot, forces])


def pose(case: Case) -> Problem:
    """Simulate the motions of a case and measure them."""
    system = systems.get(case.system)
    truth = systems.simulate_truth(system, case.trajectories, DURATION, RATE, case.seed)
    sigma = systems.noise_std(system, truth, case.noise, case.noise_convention)
    data = systems.measure(system, truth, sigma, case.seed, case.missing)
    make = {"compact": systems.compact_library, "large": systems.large_library}[case.library]
    library = make(system)
    found = systems.truth_for(system, library)
    coefficients = {library[k].text: float(value) for k, value in found.items()}
    known = {library[library.index(text)].text: float(value) for text, value in system.known.items()}
    return Problem(case, system, data, truth, sigma, library, known, coefficients)


# ------------------------------- accelerations from coefficients, for methods that give no model of their own
_WORST_CONDITION = 1e12  # of a mass matrix that is still inverted


def acceleration_of(library: la.Library, coefficients: Mapping[str, float]) -> Acceleration:
    """Return ``acceleration(q, qdot, forces)`` of L = Σ_k λ_k φ_k.

    The Euler–Lagrange expression is linear in q̈: its value at q̈ = 0 is the right-hand side, and what it gains
    at unit q̈ are the columns of the mass matrix.

    Parameters
    ----------
    library : Library
    coefficients : dict
        Term text → coefficient, the known ones included.

    Returns
    -------
    callable
        Of (n, n_dof) arrays, forces None if passive; NaN where the mass matrix is singular.
    """
    terms = [library[library.index(text)] for text, value in coefficients.items() if value != 0.0]
    values = np.array([value for value in coefficients.values() if value != 0.0])
    if not terms:
        return lambda q, qdot, forces=None: np.full(np.shape(q), np.nan)
    reduced = la.Library(terms, library.coordinates)
    units = np.vstack([np.zeros(library.n_dof), np.eye(library.n_dof)])

    def acceleration(q, qdot, forces=None):
        q, qdot = np.asarray(q, dtype=float), np.asarray(qdot, dtype=float)
        n, n_dof = q.shape
        tiled = [np.tile(a, (len(units), 1)) for a in (q, qdot)]
        columns = la.euler_lagrange(reduced, *tiled, np.repeat(units, n, axis=0))
        # far from the data a term may overflow
        with np.errstate(over="ignore", invalid="ignore"):
            at_rest, *at_unit = (columns @ values).reshape(len(units), n, n_dof)
            mass = np.stack([a - at_rest for a in at_unit], axis=-1)
            force = -at_rest if forces is None else forces - at_rest
        return _solved(mass, force)

    return acceleration


def _solved(mass: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Solve M q̈ = force, (n, d, d) and (n, d); NaN where M is singular or not finite."""
    out = np.full(force.shape, np.nan)
    good = np.isfinite(mass).all(axis=(1, 2)) & np.isfinite(force).all(axis=1)
    good[good] = np.linalg.cond(mass[good]) < _WORST_CONDITION
    out[good] = np.linalg.solve(mass[good], force[good][..., None])[..., 0]
    return out
