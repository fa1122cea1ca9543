"""Time and peak memory of discover() on long recordings, with one worker and with more.

    python benchmarks/long_recordings.py                         # 10⁵ and 10⁶ samples, one and two workers
    python benchmarks/long_recordings.py --samples 1e7 --workers 1
    python benchmarks/long_recordings.py --pass                  # one Gauss–Newton pass alone

The recordings are of the driven double pendulum at 100 Hz, 20 s a trial, with 10 % noise and the compact
library; every case runs in a process of its own, and the recording is written to a file by another one.  Wall
time tells of workers only on a machine that does nothing else.  Two figures do not depend on others' load:
``main_s`` is the processor time of the thread that hands out the work, which no worker can take over, and
``--pass`` compares threads with as many processes that share nothing, in turn.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import click
import numpy as np

_SYSTEM, _TRIAL, _RATE = "double_pendulum", 20.0, 100.0
_BATCH = 500  # trials simulated at once: the simulation must not take more memory than the search


@click.command()
@click.option("--samples", multiple=True, type=float, help="Rows; may be given several times.")
@click.option("--workers", multiple=True, type=int, help="May be given several times.")
@click.option("--pass", "one_pass", is_flag=True, help="One Gauss–Newton pass: threads, processes.")
@click.option("--case", help="Run one case, given as JSON, in this process (used by the program itself).")
@click.option("--output", type=click.Path(path_type=Path), default=Path("benchmarks/results/long.jsonl"))
def main(
    samples: tuple[float, ...], workers: tuple[int, ...], one_pass: bool, case: str | None, output: Path
) -> None:
    """Print a table; write one line of JSON a case."""
    if case is not None:
        click.echo(json.dumps(measure(**json.loads(case))))
        return
    if one_pass:
        compare_passes()
        return
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for count in samples or (1e5, 1e6):
            path = Path(folder) / f"{int(count)}.npz"
            in_another_process({"make": str(path), "samples": int(count)})
            for number in workers or (1, 2):
                record = in_another_process({"make": None, "path": str(path), "workers": number})
                record = {"samples": int(count), "workers": number, **record}
                with output.open("a") as file:
                    file.write(json.dumps(record, sort_keys=True) + "\n")
                click.echo(
                    f"{record['samples']:>9} samples  {number} workers  wall {record['wall_s']:>7.1f} s  "
                    f"processor {record['cpu_s']:>7.1f} s ({record['main_s']:.1f} s in the main thread)  "
                    f"peak {record['peak_mb']:>5} MB  {record['status']}"
                )


def in_another_process(config: dict) -> dict:
    """Run one case with one BLAS thread, so that time and memory are its own."""
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    command = [sys.executable, __file__, "--case", json.dumps(config)]
    done = subprocess.run(command, env={**os.environ, **threads}, capture_output=True, text=True)
    if done.returncode:
        raise click.ClickException(done.stderr.strip().splitlines()[-1])
    return json.loads(done.stdout.splitlines()[-1])


def measure(make: str | None, samples: int = 0, path: str = "", workers: int = 1) -> dict:
    """Simulate, or discover once."""
    import leastaction as la
    from leastaction import systems

    if make is not None:
        trials = max(1, round(samples / (_TRIAL * _RATE)))
        parts = [
            systems.generate(_SYSTEM, noise=0.1, trials=min(_BATCH, trials - a), duration=_TRIAL, seed=a)
            for a in range(0, trials, _BATCH)
        ]
        columns = {"t": [x.t for p in parts for x in p], "q": [x.q for p in parts for x in p]}
        np.savez(make, **columns, forces=[x.forces for p in parts for x in p])
        return {}
    data = recording(path, systems.get(_SYSTEM).coordinates)
    used, begun, alone = time.process_time(), time.perf_counter(), time.thread_time()
    model = la.discover(data, systems.compact_library(_SYSTEM), workers=workers)
    return {
        "wall_s": round(time.perf_counter() - begun, 2),
        "cpu_s": round(time.process_time() - used, 2),
        "main_s": round(time.thread_time() - alone, 2),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0),
        "status": model.fit.status,
        "terms": len(model.terms),
        "stages_s": {k: round(v, 2) for k, v in model.diagnostics.timings.items()},
    }


def recording(path: str, names: tuple[str, ...]):
    """The trials of a file; nothing else of it stays in memory."""
    import leastaction as la

    with np.load(path) as file:
        columns = zip(file["t"], file["q"], file["forces"], strict=True)
        return la.Trajectories([la.Trajectory(t, q, forces, names) for t, q, forces in columns])


# ------------------------------------------------------------------------------- one pass, alone
def compare_passes(repeats: int = 20) -> None:
    """Two blocks of a motion linearised, eliminated and traced: in turn, by threads, by processes."""
    from leastaction.threads import single_threaded

    with single_threaded():
        blocks = [block(k) for k in range(4)]
        work(blocks[0])
        walls: dict[str, list[float]] = {"one": [], "two threads": [], "two processes": []}
        with ThreadPoolExecutor(2) as pool:
            for _ in range(repeats):
                for name, run in (
                    ("one", lambda: [work(b) for b in blocks]),
                    ("two threads", lambda: list(pool.map(work, blocks))),
                    ("two processes", lambda: in_processes(blocks)),
                ):
                    begun = time.perf_counter()
                    run()
                    walls[name].append(time.perf_counter() - begun)
    for name, times in walls.items():
        click.echo(f"{name:<14} least {min(times):.3f} s  median {float(np.median(times)):.3f} s")


def block(number: int):
    """The observations of a long trial, its equations, and a curve."""
    from leastaction import systems
    from leastaction.curve.bspline import uniform_grid
    from leastaction.estimation.joint import Observations, Physics
    from leastaction.mechanics.euler_lagrange import EulerLagrange

    t = np.arange(0.0, 500.0, 1.0 / _RATE)
    rng = np.random.default_rng(number)
    q = np.column_stack([np.sin(2.3 * t), 0.7 * np.cos(3.1 * t)]) + 0.01 * rng.standard_normal((t.size, 2))
    library = systems.compact_library(_SYSTEM)
    columns = EulerLagrange(library.terms[:6], library.coordinates)
    grid = uniform_grid([t], 28.0, 5, 2)
    control = rng.standard_normal((grid.n_ctrl, 2))
    return Observations(grid, [t], [q]), Physics(columns, np.ones(6, bool), None), control


def work(given) -> None:
    """What a Gauss–Newton step and an update of the weights do with a block."""
    from leastaction.estimation.joint import Weights, linearise

    seen, physics, control = given
    weights = Weights(np.full(2, 0.01), np.ones(2), np.ones(2))
    at = linearise(seen, physics, control, np.ones(6))
    at.normal(weights).eliminate(1e-3).curve_step(np.zeros(6))
    at.freedom(weights)


def in_processes(blocks: list) -> None:
    """Half of the blocks in each of two processes."""
    children = []
    for share in (blocks[::2], blocks[1::2]):
        child = os.fork()
        if not child:
            for one in share:
                work(one)
            os._exit(0)
        children.append(child)
    for child in children:
        os.waitpid(child, 0)


if __name__ == "__main__":
    main()
