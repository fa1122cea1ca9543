"""The numbers of docs/choose.md and the examples of docs/limits.md.

python benchmarks/pages.py choose limits
"""

from __future__ import annotations

import sys

import numpy as np

import leastaction as la
from leastaction import systems

DOUBLE = systems.get("double_pendulum")
LIBRARY = la.Library.mechanical(DOUBLE.coordinates, angles=DOUBLE.angles)


def row(label: str, *, degree: int = 5, **recording) -> None:
    data = systems.generate(DOUBLE, seed=1, **recording)
    model = la.discover(data, LIBRARY, degree=degree)
    found = {term.expression: term.coefficient for term in model.terms}
    exact = la.metrics.exact_support(found, DOUBLE.lagrangian)
    if exact:
        error = max(100 * term.standard_error / abs(term.coefficient) for term in model.terms)
        print(f"| {label} | {model.fit.status} | {error:.2f} % |")
    else:
        print(f"| {label} | {model.fit.status} | wrong terms |")


def choose() -> None:
    """Sampling rate, length, number of runs, degree."""
    for rate in (5.0, 10.0, 20.0, 50.0, 100.0, 200.0):
        row(f"{rate:g} Hz", noise=0.05, trials=3, duration=10.0, rate=rate)
    for duration in (2.0, 5.0, 10.0, 20.0):
        row(f"1 × {duration:g} s", noise=0.05, trials=1, duration=duration)
    for trials in (2, 4, 8):
        row(f"{trials} × 2.5 s", noise=0.05, trials=trials, duration=2.5)
    for degree in (3, 4, 5, 7):
        row(f"degree {degree}", degree=degree, noise=0.01, trials=3, duration=10.0)


def show(title: str, model: la.LagrangianModel) -> None:
    terms = ", ".join(term.expression for term in (*model.terms, *model.dissipation))
    print(f"{title}: {model.fit.status}\n    {terms}")
    for text in (*model.fit.warnings, *(model.diagnostics.notes if model.diagnostics else ())):
        print(f"    - {text}")


def changed(data: la.Trajectories, q=lambda q: q, forces=lambda f: f) -> la.Trajectories:
    """The same recordings with other columns."""
    pushed = [None if t.forces is None else forces(t.forces) for t in data]
    return la.Trajectories(
        [la.Trajectory(t.t, q(t.q), f, t.coordinates) for t, f in zip(data, pushed, strict=True)]
    )


def limits() -> None:
    """Set-ups that are wrong on purpose, and what comes back."""
    data = systems.generate(DOUBLE, noise=0.05, trials=3, duration=10.0, seed=3)
    show("coupling term missing", la.discover(data, [t for t in DOUBLE.library if "theta1-theta2" not in t]))
    show("sign of the torques wrong", la.discover(changed(data, forces=np.negative), DOUBLE.library))
    show("angles swapped", la.discover(changed(data, q=lambda q: q[:, ::-1]), DOUBLE.library))

    for strength in (0.4, 0.04):
        friction = {"x_dot**2/2": strength, "theta_dot**2/2": strength / 4}
        cart = systems.get("cart_spring_pendulum").with_dissipation(friction)
        data = systems.generate(cart, noise=0.02, trials=3, duration=10.0, seed=3)
        show(f"friction {strength} not modelled", la.discover(data, cart.library, known=cart.known))
        candidates = [*friction, "abs(x_dot)"]
        show(f"friction {strength} modelled", la.discover(data, cart.library, cart.known, candidates))

    t = np.arange(0.0, 10.0, 0.01)
    noise = 0.002 * np.random.default_rng(0).standard_normal(t.size)
    small = la.Trajectory(t, 0.02 * np.cos(3.13 * t) + noise, coordinates=["theta"])
    library = ["theta_dot**2", "cos(theta)", "cos(theta)**2", "theta_dot**2*cos(theta)"]
    show("swing of 0.02 rad", la.discover(small, library, known={"theta_dot**2": 0.5}))


if __name__ == "__main__":
    for name in sys.argv[1:] or ("choose", "limits"):
        {"choose": choose, "limits": limits}[name]()
