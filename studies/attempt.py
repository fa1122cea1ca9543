"""One discovery of a study, and what every study keeps of it."""

from __future__ import annotations

import time
from collections.abc import Mapping

import leastaction as la

__all__ = ["attempt"]


def attempt(
    data: la.Trajectories, library: la.Library, known: Mapping[str, float]
) -> tuple[la.LagrangianModel | None, dict]:
    """Return the model, and outcome and cost; where the user is told of an error there is no model."""
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        model = la.discover(data, library, known=known)
    except (la.InputError, la.DataError) as error:
        model, kept = None, {"status": "no model", "reason": str(error), "findings": []}
    else:
        kept = {
            "status": model.fit.status,
            "findings": [finding.to_dict() for finding in model.fit.findings],
            "n_candidates": model.provenance.get("n_candidates"),
            "seconds": model.diagnostics.timings if model.diagnostics else None,
        }
    return model, kept | {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
