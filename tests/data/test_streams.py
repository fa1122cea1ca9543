"""Long files in pieces: the same trajectories as from the whole, from a file instead of memory."""

from __future__ import annotations

import gzip
import pickle
import tracemalloc

import numpy as np
import pytest

import leastaction as la
from leastaction import io
from leastaction.data.formats import text as text_module
from leastaction.errors import DataError, InputError

pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")


def runs(trials: int = 5, rows: int = 40) -> la.Trajectories:
    rng = np.random.default_rng(0)
    items = []
    for k in range(trials):
        t = np.sort(rng.uniform(0.0, 4.0, rows + k))
        q = np.column_stack([3.0 * np.sin(t), rng.standard_normal(t.size)])
        forces = np.cos(q)
        q[k, 1] = np.nan
        items.append(la.Trajectory(t, q, forces, ["a", "b"], f"run {k}", velocities=2.0 * q))
    return la.Trajectories(items)


LAYOUT = {
    "forces": {"a": "a_force", "b": "b_force"},
    "velocities": {"a": "a_dot", "b": "b_dot"},
}


def same(one: la.Trajectories, other: la.Trajectories) -> None:
    assert one.digest() == other.digest()
    assert one.names == other.names
    assert one.wraps_removed == other.wraps_removed


@pytest.fixture(params=["csv", "csv.gz", "parquet"])
def file(request, tmp_path, monkeypatch):
    """The runs in a file whose pieces end anywhere."""
    data = runs()
    path = io.write_csv(tmp_path / f"runs.{request.param.replace('parquet', 'csv')}", data)
    monkeypatch.setattr(text_module, "_PIECE", 1000)
    if request.param == "parquet":
        import pandas as pd

        path = tmp_path / "runs.parquet"
        table = pa.Table.from_pandas(pd.read_csv(tmp_path / "runs.csv"))
        parquet.write_table(table, path, row_group_size=33)
    return path


def test_a_stream_is_the_same_as_the_file_read_whole(file):
    streamed = la.stream(file, ["a", "b"], **LAYOUT)
    same(streamed, la.read(file, ["a", "b"], **LAYOUT))
    turned = la.stream(file, ["a", "b"], angles=["a"], **LAYOUT)
    same(turned, la.read(file, ["a", "b"], angles=["a"], **LAYOUT))


def test_the_samples_are_in_a_file_and_stay_as_they_are(file):
    streamed = la.stream(file, ["a", "b"], **LAYOUT)
    held = streamed[2].q
    while isinstance(held, np.ndarray):
        assert not held.flags.writeable
        held = held.base
    assert type(held).__name__ in ("mmap", "memoryview")
    assert la.Trajectories(list(pickle.loads(pickle.dumps(streamed)))).digest() == streamed.digest()
    last = streamed[4].rows(slice(5, None))
    del streamed
    assert np.isfinite(last.q[:, 0]).all()


def test_several_files_are_trials_of_one_system(tmp_path):
    data = runs(3)
    first = io.write_csv(tmp_path / "first.csv", data[:2])
    second = io.write_csv(tmp_path / "second.csv", data[2:])
    same(la.stream([first, second], ["a", "b"]), la.read([first, second], ["a", "b"]))


def test_a_file_without_trials_is_one(tmp_path, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 50)
    rows = "".join(f"\n{k},{np.sin(k)}" for k in range(30))
    (tmp_path / "one.csv").write_text("# made by hand\nt,x" + rows)
    same(la.stream(tmp_path / "one.csv", ["x"]), la.read(tmp_path / "one.csv", ["x"]))


def test_a_cell_may_hold_line_ends_and_a_piece_does_not_cut_it(tmp_path, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 40)
    rows = "".join(f'\n{k},{k / 7},"a note\nof two lines"' for k in range(12))
    (tmp_path / "one.csv").write_text("t,x,note" + rows)
    same(la.stream(tmp_path / "one.csv", ["x"]), la.read(tmp_path / "one.csv", ["x"]))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["a,0,1"] * 5, r"line 3, column 't': time 0.0 repeats"),
        ([f"{'aabab'[k // 6]},{k},1" for k in range(30)], "goes on after another trial .it began at line 2"),
        (
            [f"{'ab'[k // 6]},{k},{'x' if k == 11 else 1}" for k in range(12)],
            r"line 13, column 'x': 'x'",
        ),
        ([f"a,{k},{k}" for k in range(8)] + ["b,8"], r"line 10: there are 2 cells"),
        ([], "no data lines"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, monkeypatch, lines, message):
    monkeypatch.setattr(text_module, "_PIECE", 20)
    (tmp_path / "run.csv").write_text("\n".join(["trial,t,x", *lines]) + "\n")
    with pytest.raises(InputError, match=message):
        la.stream(tmp_path / "run.csv", ["x"])


def test_files_that_cannot_be_streamed(tmp_path):
    with pytest.raises(InputError, match="cannot be read in pieces"):
        la.stream(tmp_path / "run.npz", ["x"])
    with pytest.raises(InputError, match="no such file"):
        la.stream(tmp_path / "run.csv", ["x"])
    (tmp_path / "run.csv").write_text("trial,t,x" + "".join(f"\na,{k},1" for k in range(3)))
    with pytest.raises(DataError, match="only 3 sample"):
        la.stream(tmp_path / "run.csv", ["x"])
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(b"t,x\n" + b"0,1\n" * 50)[:-12])
    with pytest.raises(InputError, match="cannot be read to its end"):
        la.stream(tmp_path / "run.csv.gz", ["x"])
    (tmp_path / "latin.csv").write_bytes(b"t,x\n0,\xe9\n")
    with pytest.raises(InputError, match="line 2, column 'x': 'é' is not a number"):
        la.stream(tmp_path / "latin.csv", ["x"])


def test_memory_does_not_grow_with_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 20_000)
    peaks = []
    for trials in (5, 40):
        path = io.write_csv(tmp_path / f"{trials}.csv", runs(trials, 400))
        la.stream(path, ["a", "b"], **LAYOUT)  # what is imported on the way
        tracemalloc.start()
        la.stream(path, ["a", "b"], **LAYOUT)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


def test_a_law_is_found_on_a_stream(tmp_path, monkeypatch):
    data = la.systems.generate("single_pendulum", noise=0.05, trials=4, duration=10.0, seed=0)
    path = io.write_csv(tmp_path / "pendulum.csv", data)
    monkeypatch.setattr("leastaction.estimation.streamed._LONG", 1)
    monkeypatch.setattr("leastaction.api.ENOUGH_SAMPLES", data.n_samples // 2)
    options = {"library": la.systems.compact_library("single_pendulum")}
    streamed = la.stream(path, ["theta"], forces={"theta": "theta_force"})
    one, other = la.discover(data, **options), la.discover(streamed, **options)
    assert [t.expression for t in one.terms] == [t.expression for t in other.terms]
    assert [t.coefficient for t in one.terms] == [t.coefficient for t in other.terms]
