"""Mechanical systems with a known Lagrangian, for learning and testing (see README.md in this folder).

Examples
--------
>>> from leastaction import systems
>>> systems.names()[:2]
('single_pendulum', 'double_pendulum')
>>> data = systems.generate("cart_spring_pendulum", noise=0.01, trials=2, duration=0.5, seed=1)
>>> data.coordinates, len(data), data[0].q.shape
(('x', 'theta'), 2, (51, 2))
"""

from __future__ import annotations

from leastaction.systems._generate import (
    SamplingOptions,
    TrueMotion,
    generate,
    measure,
    noise_std,
    simulate_truth,
)
from leastaction.systems._libraries import compact_library, large_library, truth_for
from leastaction.systems._registry import further_names, get, names
from leastaction.systems._system import MechanicalSystem

__all__ = [
    "MechanicalSystem",
    "SamplingOptions",
    "TrueMotion",
    "compact_library",
    "further_names",
    "generate",
    "get",
    "large_library",
    "measure",
    "names",
    "noise_std",
    "simulate_truth",
    "truth_for",
]
