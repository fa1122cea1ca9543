"""The law from the names of the coordinates alone: one case, and what is kept of it.

A result is exact if its accelerations are off by less than 1 % where the motion was recorded, and if it says
so in no more terms than the textbook does: the terms themselves may be others, since equal laws can be
written in several ways.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

import leastaction as la
from leastaction import systems
from studies._friction import friction_candidates
from studies.case import Case
from studies.laws import error_of_acceleration

__all__ = ["OFF", "is_exact", "pose", "solve"]

OFF = 0.01


def pose(case: Case) -> tuple[tuple[systems.TrueMotion, ...], la.Trajectories, la.Library]:
    """Return the motions, their recordings, and the candidates of ``--library symbolic``.

    Who knows that there is friction gives it as a candidate, viscous and dry for each coordinate.
    """
    system = systems.get(case.system)
    truth = systems.simulate_truth(system, case.trajectories, case.duration, case.rate, case.seed)
    data = systems.measure(system, truth, systems.noise_std(system, truth, case.noise), case.seed)
    library = la.Library.symbolic(system.coordinates, system.angles)
    if system.dissipation:
        library = library.with_dissipation(friction_candidates(system))
    return truth, data, library


def solve(case: Case) -> dict:
    """Return what is kept of one discovery; an error of the user's kind is an answer too."""
    system = systems.get(case.system)
    truth, data, library = pose(case)
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        model = la.discover(data, library, known=dict(system.known))
    except (la.InputError, la.DataError) as error:
        said = {"status": "no model", "reason": str(error), "findings": []}
        return said | {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    cost = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    error = float(np.max(error_of_acceleration(system, model, truth)))
    return {
        "status": model.fit.status,
        "findings": [finding.to_dict() for finding in model.fit.findings],
        "acceleration_error": error if np.isfinite(error) else None,
        "n_terms": len(model.terms),
        "n_terms_of_law": len(system.lagrangian),
        "terms": {term.expression: term.coefficient for term in model.terms},
        "dissipation": {term.expression: term.coefficient for term in model.dissipation},
        "n_candidates": model.provenance.get("n_candidates"),
        "seconds": model.diagnostics.timings if model.diagnostics else None,
        **cost,
    }


def is_exact(result: Mapping) -> bool:
    """Tell whether accelerations are right within 1 %, in no more terms than the textbook needs.

    >>> is_exact({"acceleration_error": 0.002, "n_terms": 3, "n_terms_of_law": 3})
    True
    """
    error = result.get("acceleration_error")
    return error is not None and error < OFF and result["n_terms"] <= result["n_terms_of_law"]
