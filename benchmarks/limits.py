"""The examples of docs/limits.md: set-ups that are wrong on purpose, and what comes back.

python benchmarks/limits.py
"""

from __future__ import annotations

import numpy as np

import leastaction as la
from leastaction import systems


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


def main() -> None:
    double = systems.get("double_pendulum")
    data = systems.generate(double, noise=0.05, trials=3, duration=10.0, seed=3)
    show("coupling term missing", la.discover(data, [t for t in double.library if "theta1-theta2" not in t]))
    show("sign of the torques wrong", la.discover(changed(data, forces=np.negative), double.library))
    show("angles swapped", la.discover(changed(data, q=lambda q: q[:, ::-1]), double.library))

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
    main()
