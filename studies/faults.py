"""Set-ups that are wrong on purpose, one change each, and the findings that would name it.

A fault takes a `Question`, what a user would pass to ``discover()``, and returns it with one thing wrong.
Coefficients are chosen so that a fault is of a size that matters; where the data cannot show it at all, the
title says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

import leastaction as la
from leastaction import systems
from leastaction.findings import Finding

__all__ = ["CAUSES", "FAULTS", "SETUPS", "Fault", "Question", "causes_named"]

_DELAY = 0.05  # seconds
_SCALE = 1.3
_SAMPLES_A_PERIOD = 3.0
_SMALL = 0.01  # times the usual initial conditions and forces
_REST = {"cart_spring_pendulum": (0.5, 0.0)}  # where a system stays, if not at zero


@dataclass(frozen=True, eq=False)
class Question:
    """What a user passes to discover(), and the exact motions behind it."""

    system: systems.MechanicalSystem
    truth: tuple[systems.TrueMotion, ...]
    data: la.Trajectories
    library: la.Library
    known: dict[str, float] = field(default_factory=dict)

    def measured_again(self, q=lambda q: q, forces=lambda m, f: f, every: int = 1) -> Question:
        """Return the question with other columns of the table; every so-and-so-many-th row only."""
        changed = []
        for motion, t in zip(self.truth, self.data, strict=True):
            push = None if t.forces is None else np.asarray(forces(motion, t.forces))[::every]
            changed.append(la.Trajectory(t.t[::every], q(t.q[::every]), push, t.coordinates, t.name))
        return replace(self, data=la.Trajectories(changed))


@dataclass(frozen=True, eq=False)
class Fault:
    """A set-up.

    Attributes
    ----------
    title : str
    systems : tuple of str
    cause : str
        One of `CAUSES`; "": nothing is wrong, or the data cannot show it.
    ask : callable
        Question → question with the fault.
    nature : callable
        System → the system that really moves (friction, small motions).
    given : dict
        System → true coefficients that the user passes as known, beside those of a passive system.
    """

    title: str
    systems: tuple[str, ...]
    cause: str
    ask: Callable[[Question], Question] = lambda question: question
    nature: Callable[[systems.MechanicalSystem], systems.MechanicalSystem] = lambda system: system
    given: dict[str, tuple[str, ...]] = field(default_factory=dict)


CAUSES = (
    *("term", "friction", "known", "sign", "delay", "scale", "force", "columns"),
    *("sampling", "wrapped", "excitation", "units", "singular"),
)

# The causes that a finding names, to a reader of its remedy; one may name several.
_NAMED = {
    "equations-off": ("term", "friction", "known", "sign", "force", "columns"),
    "missing-term": ("term",),
    "unmodelled-friction": ("friction",),
    "energy-fed-in": ("friction", "known", "sign", "force"),
    "negative-dissipation": ("term", "friction", "known", "sign", "force"),
    "wrong-known-coefficient": ("known",),
    "late-forces": ("delay",),
    "scaled-forces": ("scale",),
    "swapped-forces": ("columns",),
    "rate-unrelated": ("columns",),
    "rate-scaled": ("units",),
    "looks-like-noise": ("sampling",),
    "slow-sampling": ("sampling",),
    "knots-not-settled": ("sampling",),
    "undeclared-angle": ("wrapped",),
    "angle-unwrapped": ("wrapped",),
    "angle-in-degrees": ("units",),
    "motion-in-noise": ("excitation",),
    "hardly-determined": ("excitation",),
    "competing-structures": ("excitation",),
    "mass-matrix-not-positive": ("term", "known", "sign", "force"),
    "mass-matrix-not-finite": ("singular",),
    "equation-error": ("term", "friction"),
}


def causes_named(findings: Iterable[Finding]) -> list[str]:
    """Return the causes that some finding names.

    >>> from leastaction.findings import find
    >>> causes_named([find("mass-matrix-not-positive", share=1.0)])
    ['term', 'known', 'sign', 'force']
    """
    named = {cause for finding in findings for cause in _causes_of(finding)}
    return [cause for cause in CAUSES if cause in named]


def _causes_of(finding: Finding) -> tuple[str, ...]:
    named = _NAMED.get(finding.code, ())
    forces = finding.code == "wrong-known-coefficient" and finding.values.get("force_factor") is not None
    return (*named, "scale") if forces else named


def _without(terms: dict[str, str]) -> Callable[[Question], Question]:
    def ask(question: Question) -> Question:
        lost = question.library.index(terms[question.system.name])
        left = [term for k, term in enumerate(question.library) if k != lost]
        return replace(question, library=question.library.replace(terms=left))

    return ask


def _with_pole(question: Question) -> Question:
    """Add 1/q of a coordinate that passes zero: finite at every sample, and infinite between them."""
    pole = f"1/{question.system.coordinates[0]}"
    return replace(question, library=question.library.replace(terms=[*question.library, pole]))


def _friction(loss: float) -> Callable[[systems.MechanicalSystem], systems.MechanicalSystem]:
    """Viscous friction in every coordinate that takes about this share of the energy in each period.

    With ψ = Σ cᵢ q̇ᵢ²/2, cᵢ = loss · Mᵢᵢ/T and ⟨q̇·M q̇⟩ = E, as for a linear oscillator, dE/dt = −loss · E/T.
    """

    def nature(system: systems.MechanicalSystem) -> systems.MechanicalSystem:
        motions = systems.simulate_truth(system, 2, 20.0, 100.0, seed=1)
        q, qdot = (np.concatenate([getattr(m, k) for m in motions]) for k in ("q", "qdot"))
        mass = np.mean(np.diagonal(system.mass_matrix(q, qdot), axis1=1, axis2=2), axis=0)
        rates = np.sqrt(np.mean(qdot**2, axis=0)) / q.std(axis=0) / (2.0 * np.pi)
        coefficients = np.round(loss * mass * np.max(rates), 6)
        return system.with_dissipation(
            {f"{v}**2/2": float(c) for v, c in zip(system.velocities, coefficients, strict=True)}
        )

    return nature


def _known_times(factor: float, terms: dict[str, str]) -> Callable[[Question], Question]:
    def ask(question: Question) -> Question:
        text = terms[question.system.name]
        return replace(question, known={**question.known, text: factor * question.system.lagrangian[text]})

    return ask


def _forces(change) -> Callable[[Question], Question]:
    return lambda question: question.measured_again(forces=change)


def _one_sign(motion, forces):
    return forces * np.where(np.arange(forces.shape[1]) == 0, -1.0, 1.0)


def _one_missing(motion, forces):
    return forces * (np.arange(forces.shape[1]) != forces.shape[1] - 1)


def _too_slow(question: Question) -> Question:
    """Keep three samples in a period of the fastest coordinate's velocity."""
    qdot, qddot = (np.concatenate([getattr(m, k) for m in question.truth]) for k in ("qdot", "qddot"))
    rate = np.max(np.sqrt(np.mean(qddot**2, axis=0) / np.mean(qdot**2, axis=0))) / (2.0 * np.pi)
    step = question.truth[0].t[1] - question.truth[0].t[0]
    return question.measured_again(every=max(1, round(1.0 / (_SAMPLES_A_PERIOD * rate * step))))


def _wrapped(question: Question) -> Question:
    angles = np.array([c in question.system.angles for c in question.system.coordinates])
    wrap = question.measured_again(q=lambda q: np.where(angles, np.angle(np.exp(1j * q)), q))
    library = question.library
    return replace(wrap, library=la.Library(list(library), library.coordinates))  # no coordinate is an angle


def _in_degrees(question: Question) -> Question:
    factor = np.where([c in question.system.angles for c in question.system.coordinates], 180.0 / np.pi, 1.0)
    return question.measured_again(q=lambda q: q * factor)


def _exchanged(question: Question) -> Question:
    return question.measured_again(q=lambda q: q[:, ::-1])


def _small(system: systems.MechanicalSystem) -> systems.MechanicalSystem:
    rest = np.array(_REST.get(system.name, np.zeros(system.n_dof)))

    def initial(rng):
        q, qdot = system.initial(rng)
        return rest + _SMALL * (q - rest), _SMALL * qdot

    def forcing(rng):
        drive = system.forcing(rng)
        return lambda t: _SMALL * drive(t)

    return replace(system, initial=initial, forcing=None if system.forcing is None else forcing)


_DRIVEN = ("single_pendulum", "double_pendulum", "spherical_pendulum")
_FREE = ("chaotic_pendulum", "cart_spring_pendulum", "magnetic_pendulum")
_ALL = (*_DRIVEN, *_FREE, "spherical_spring_pendulum")
_INERTIA = {
    "single_pendulum": "theta_dot**2",
    "double_pendulum": "theta1_dot**2",
    "spherical_pendulum": "theta_dot**2",
}
# A coefficient that is wrong beside one that is right: driven systems, or a second one of a free system.
_SECOND = {**_INERTIA, "chaotic_pendulum": "theta1_dot**2", "cart_spring_pendulum": "x_dot**2"}
_ONLY = {"chaotic_pendulum": "cos(theta1)", "cart_spring_pendulum": "cos(theta)"}
_COUPLING = {
    "single_pendulum": "cos(theta)",
    "double_pendulum": "theta1_dot*theta2_dot*cos(theta1-theta2)",
    "spherical_pendulum": "phi_dot**2*sin(theta)**2",
    "chaotic_pendulum": "cos(theta2)",
    "cart_spring_pendulum": "x_dot*theta_dot*cos(theta)",
    "magnetic_pendulum": "1/sqrt((x-1)**2+y**2+0.09)",
}
_GIVEN = {k: (v,) for k, v in _INERTIA.items()}

FAULTS = {
    "correct": Fault("correct", _ALL, ""),
    "correct-known": Fault("correct, one coefficient known beside the forces", _DRIVEN, "", given=_GIVEN),
    "term-missing": Fault("a needed term is not in the library", (*_COUPLING,), "term", _without(_COUPLING)),
    "friction-5": Fault(
        "friction not modelled, 5 % of the energy a period",
        ("double_pendulum", *_FREE),
        "friction",
        nature=_friction(0.05),
    ),
    "friction-1": Fault("the same, 1 %", ("double_pendulum", *_FREE), "friction", nature=_friction(0.01)),
    "friction-0.2": Fault(
        "the same, 0.2 %", ("double_pendulum", *_FREE), "friction", nature=_friction(0.002)
    ),
    "known-1.2": Fault("known coefficient 20 % too large", (*_SECOND,), "known", _known_times(1.2, _SECOND)),
    "known-2": Fault(
        "known coefficient twice the true one", (*_SECOND,), "known", _known_times(2.0, _SECOND)
    ),
    "known-sign": Fault("known coefficient of wrong sign", (*_SECOND,), "known", _known_times(-1.0, _SECOND)),
    "only-known-2": Fault(
        "the only known coefficient, nothing driven, twice the true one (scales L: cannot show)",
        (*_ONLY,),
        "",
        _known_times(2.0, _ONLY),
    ),
    "only-known-sign": Fault(
        "the only known coefficient, nothing driven, of wrong sign",
        (*_ONLY,),
        "known",
        _known_times(-1.0, _ONLY),
    ),
    "force-sign": Fault("all forces of wrong sign", _DRIVEN, "sign", _forces(lambda m, f: -f)),
    "force-sign-known": Fault(
        "the same, one coefficient known", _DRIVEN, "sign", _forces(lambda m, f: -f), given=_GIVEN
    ),
    "force-sign-one": Fault("one of two forces of wrong sign", _DRIVEN[1:], "sign", _forces(_one_sign)),
    "force-delay": Fault(
        "forces recorded 50 ms late", _DRIVEN, "delay", _forces(lambda m, f: m.drive(m.t - _DELAY))
    ),
    "force-scale": Fault(
        "forces 1.3 times too large, nothing known (scales L: cannot show)",
        _DRIVEN,
        "",
        _forces(lambda m, f: _SCALE * f),
    ),
    "force-scale-known": Fault(
        "forces 1.3 times too large, one coefficient known",
        _DRIVEN,
        "scale",
        _forces(lambda m, f: _SCALE * f),
        given=_GIVEN,
    ),
    "force-missing": Fault("one of two forces recorded as zero", _DRIVEN[1:], "force", _forces(_one_missing)),
    "columns": Fault(
        "columns of two coordinates swapped",
        ("double_pendulum", "cart_spring_pendulum"),
        "columns",
        _exchanged,
    ),
    "columns-named": Fault(
        "the same, where both coordinates have the same candidates (names them anew: cannot show)",
        ("chaotic_pendulum",),
        "",
        _exchanged,
    ),
    "sampling": Fault(
        "three samples in a period of the fastest motion",
        ("double_pendulum", *_FREE),
        "sampling",
        _too_slow,
    ),
    "wrapped": Fault(
        "angle that goes round, wrapped to ±π and not declared an angle",
        ("spherical_pendulum", "spherical_spring_pendulum"),
        "wrapped",
        _wrapped,
    ),
    "degrees": Fault(
        "angles in degrees", ("single_pendulum", "double_pendulum", "chaotic_pendulum"), "units", _in_degrees
    ),
    "pole": Fault(
        "a candidate 1/q of a coordinate that passes zero",
        ("single_pendulum", "cart_spring_pendulum", "henon_heiles"),
        "singular",
        _with_pole,
    ),
    "excitation": Fault(
        "motions a hundred times too small to be nonlinear",
        ("single_pendulum", "double_pendulum", "chaotic_pendulum", "cart_spring_pendulum"),
        "excitation",
        nature=_small,
    ),
}

SETUPS = {name: fault.systems for name, fault in FAULTS.items()}
