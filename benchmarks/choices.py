"""The numbers of docs/choose.md: sampling rate, length, number of runs, degree."""

from __future__ import annotations

import leastaction as la
from leastaction import systems

SYSTEM = systems.get("double_pendulum")
LIBRARY = la.Library.mechanical(SYSTEM.coordinates, angles=SYSTEM.angles)


def row(label: str, *, degree: int = 5, **recording) -> None:
    data = systems.generate(SYSTEM, seed=1, **recording)
    model = la.discover(data, LIBRARY, degree=degree)
    found = {term.expression: term.coefficient for term in model.terms}
    exact = la.metrics.exact_support(found, SYSTEM.lagrangian)
    if exact:
        error = max(100 * term.standard_error / abs(term.coefficient) for term in model.terms)
        print(f"| {label} | {model.fit.status} | {error:.2f} % |")
    else:
        print(f"| {label} | {model.fit.status} | wrong terms |")


def main() -> None:
    for rate in (5.0, 10.0, 20.0, 50.0, 100.0, 200.0):
        row(f"{rate:g} Hz", noise=0.05, trials=3, duration=10.0, rate=rate)
    for duration in (2.0, 5.0, 10.0, 20.0):
        row(f"1 × {duration:g} s", noise=0.05, trials=1, duration=duration)
    for trials in (2, 4, 8):
        row(f"{trials} × 2.5 s", noise=0.05, trials=trials, duration=2.5)
    for degree in (3, 4, 5, 7):
        row(f"degree {degree}", degree=degree, noise=0.01, trials=3, duration=10.0)


if __name__ == "__main__":
    main()
