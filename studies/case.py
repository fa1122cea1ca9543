"""One run of a study, named completely: the same case always poses the same problem; one discovery in it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import leastaction as la

__all__ = ["Case", "attempt"]


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes
    ----------
    study : str
        Decides what is done to the data and what is kept of the run.
    system : str
        A name that ``leastaction.systems.get`` knows, or in the studies ``unlisted`` and ``shapes`` one of
        ``laws.py``.
    noise : float
        Level, times the standard deviation of each coordinate.
    setup : str
        What is done to the data or the question ("plain": nothing): see ``solve.py`` and ``faults.py``.
    library : {"compact", "large", "auto", "symbolic"}
    trial : int
        New initial conditions, forcing and noise each.
    trajectories : int
    duration, rate : float
        Seconds, samples a second.
    """

    study: str
    system: str
    noise: float
    setup: str = "plain"
    library: str = "compact"
    trial: int = 0
    trajectories: int = 5
    duration: float = 20.0
    rate: float = 100.0

    @property
    def seed(self) -> int:
        """Of motions and noise: the same for all noise levels, libraries and set-ups."""
        return 1000 + self.trial

    @property
    def key(self) -> str:
        """Name of the run."""
        shape = f"{self.trajectories}x{self.duration:g}s-{self.rate:g}Hz"
        parts = [self.setup, f"{self.noise:g}", self.library, shape, f"trial{self.trial}"]
        return f"{self.study}/{self.system}/" + "-".join(parts)

    @property
    def part(self) -> str:
        """Name of the file that holds the run's record."""
        return self.study

    def as_dict(self) -> dict:
        return {**asdict(self), "seed": self.seed}

    @classmethod
    def from_dict(cls, config: Mapping) -> Case:
        return cls(**{name: value for name, value in config.items() if name != "seed"})


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
